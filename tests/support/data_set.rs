//! Small data sets made in a test.

use hydrograd::dataset::{kind, Metadata, Split, Trajectory};
use std::path::Path;

/// A box [0, 1] x [0, height], periodic in x (and in y if `closed` is false); one time unit per frame.
pub fn metadata(closed: bool) -> Metadata {
    serde_json::from_value(serde_json::json!({
        "dim": 2, "dx": 0.05, "dt": 0.001, "write_every": 100, "num_particles_max": 400,
        "periodic_boundary_conditions": [true, !closed],
        "bounds": [[0.0, 1.0], [0.0, 1.0]],
        "default_connectivity_radius": 0.0725,
        "vel_mean": [0.0, 0.0], "vel_std": [0.01, 0.01], "acc_mean": [0.0, 0.0], "acc_std": [0.001, 0.001],
    }))
    .unwrap()
}

/// As [`metadata`], with the heated channel's numbers.
pub fn heated_metadata() -> Metadata {
    let mut metadata = metadata(true);
    metadata.heat = Some(
        serde_json::from_value(serde_json::json!({
            "temperature_mean": 1.05, "temperature_std": 0.05, "change_mean": 0.0, "change_std": 0.01,
            "inlet_length": 0.1, "inlet_temperature": 1.0, "target_x": 0.9, "diffusivity": 0.02,
            "conductivity": 6.0, "heat_capacity": 300.0, "outlet_length": 0.05,
        }))
        .unwrap(),
    );
    metadata
}

/// A lattice of fluid, its lowest row a wall at rest; each fluid particle with the velocity (per frame) that `velocity`
/// gives for its start, wrapped into the box.
pub fn trajectory(name: &str, frames: usize, velocity: impl Fn(f64, f64) -> [f64; 2]) -> Trajectory {
    let side = 10;
    let start = |i: usize| [(i % side) as f64 / 10.0 + 0.05, (i / side) as f64 / 10.0 + 0.05];
    let particles = side * side;
    let mut position = Vec::new();
    for frame in 0..frames {
        for i in 0..particles {
            let [x, y] = start(i);
            let v = if i < side { [0.0, 0.0] } else { velocity(x, y) };
            position.extend([x + v[0] * frame as f64, y + v[1] * frame as f64].map(|p| p.rem_euclid(1.0) as f32));
        }
    }
    let kind = (0..particles).map(|i| if i < side { kind::SOLID_WALL } else { kind::FLUID }).collect();
    Trajectory { name: name.into(), frames, particles, position, kind, ..Trajectory::default() }
}

/// Temperatures of a trajectory, of frame and x: held at 1 at the inlet.
pub fn heat(trajectory: &mut Trajectory, temperature: impl Fn(usize, f64) -> f64) {
    let frames = 0..trajectory.frames;
    let of = |frame: usize, i: usize| {
        let x = f64::from(trajectory.position_of(frame)[2 * i]);
        if x < 0.1 {
            1.0
        } else {
            temperature(frame, x) as f32
        }
    };
    let particles = trajectory.particles;
    trajectory.temperature =
        Some(frames.flat_map(|frame| (0..particles).map(move |i| (frame, i))).map(|(f, i)| of(f, i)).collect());
}

/// Writes one split as `dataset` reads it.
pub fn write(folder: &Path, metadata: &Metadata, split: Split, trajectories: &[Trajectory]) {
    metadata.write(folder).unwrap();
    // HDF5 locks the file it writes, and a process that another test starts meanwhile inherits the lock and holds it as
    // long as it lives. So what is read later is a copy that nobody ever wrote through HDF5.
    let written = folder.join("written.h5");
    let file = hdf5::File::create(&written).unwrap();
    for t in trajectories {
        let group = file.create_group(&t.name).unwrap();
        let write = |name: &str, shape: &[usize], values: &[f32]| {
            group.new_dataset::<f32>().shape(shape).create(name).unwrap().write_raw(values).unwrap();
        };
        write("position", &[t.frames, t.particles, 2], &t.position);
        group.new_dataset::<i32>().shape([t.particles]).create("particle_type").unwrap().write_raw(&t.kind).unwrap();
        if let Some(temperature) = &t.temperature {
            write("temperature", &[t.frames, t.particles], temperature);
        }
    }
    file.close().unwrap();
    std::fs::copy(&written, split.path(folder)).unwrap();
    std::fs::remove_file(&written).unwrap();
}

/// Takes the checksum off an HDF5 file of ours, which is to be changed on purpose.
pub fn without_checksum(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    assert!(bytes.starts_with(b"hydrograd"));
    bytes[0] = 0;
    std::fs::write(path, bytes).unwrap();
}
