//! Data sets: layout, statistics, the same bytes whatever the shards, going on after a stop, bad input.

use crate::support::program::{printed, refused};
use assert_cmd::Command;
use hydrograd::config::scene::Config;
use hydrograd::config::schema::Schema;
use hydrograd::dataset::store::{read_provenance, Store};
use hydrograd::dataset::walls::{wall, Section, Walls};
use hydrograd::dataset::{kind, read_split, Metadata, Split, Trajectory};
use hydrograd::design::shape::{default_nodes, Shape};
use hydrograd::numerics::random::numbered;
use hydrograd::scene::load::check_shape;
use std::path::Path;

/// Small: 200 particles, 3 frames of 4 coarse steps.
const SMALL: [&str; 12] = [
    "generate",
    "heated-channel",
    "--trajectories",
    "4/1/1",
    "--frames",
    "4",
    "--every",
    "30",
    "--skip",
    "20",
    "--set",
    "resolution.dx=0.025",
];

fn hydrograd(folder: &Path, arguments: &[&str], slurm: &[(&str, &str)]) -> std::process::Output {
    let mut command = Command::cargo_bin("hydrograd").unwrap();
    command.current_dir(folder).args(arguments).envs(slurm.iter().copied()).output().unwrap()
}

fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    printed(arguments, hydrograd(folder, arguments, &[]))
}

fn refuses(folder: &Path, arguments: &[&str], slurm: &[(&str, &str)], expected: &[&str]) {
    refused(arguments, &hydrograd(folder, arguments, slurm), expected);
    assert!(!folder.join("unwritten").exists(), "something was written");
}

fn small<'a>(more: &[&'a str]) -> Vec<&'a str> {
    // Three rows of dummy particles and nothing on the surface: what the expectations below are of.
    [&SMALL[..], &["--set", "method.name=standard"], more].concat()
}

fn bytes(folder: &Path) -> Vec<Vec<u8>> {
    let files = ["train.h5", "valid.h5", "test.h5", "metadata.json"];
    files.iter().map(|file| std::fs::read(folder.join(file)).unwrap()).collect()
}

fn mean_and_deviation(values: &[f64]) -> [f64; 2] {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    [mean, (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()]
}

/// Displacements of a fluid particle along a direction, frame by frame.
fn steps(metadata: &Metadata, trajectory: &Trajectory, i: usize, d: usize) -> Vec<f64> {
    let at = |frame: usize| f64::from(trajectory.position_of(frame)[i * metadata.dim + d]);
    (1..trajectory.frames)
        .map(|frame| {
            let step = at(frame) - at(frame - 1);
            match metadata.periodic()[d] {
                true if step > 0.5 * metadata.size()[d] => step - metadata.size()[d],
                true if step < -0.5 * metadata.size()[d] => step + metadata.size()[d],
                _ => step,
            }
        })
        .collect()
}

#[test]
fn layout_statistics_and_provenance() {
    let folder = tempfile::tempdir().unwrap();
    let text = succeeds(folder.path(), &small(&["--out", "data"]));
    assert!(text.contains("6 trajectories made") && text.contains("train.h5"), "{text}");
    let data = folder.path().join("data");
    assert!(!data.join("parts").exists() && !data.join("merge.lock").exists());
    let metadata = Metadata::read(&data).unwrap();
    let splits = Split::ALL.map(|split| read_split(&data, &metadata, split).unwrap());
    assert_eq!(splits.each_ref().map(Vec::len), [4, 1, 1]);
    let config = Config::load(data.join("config.toml").to_str(), None, &[]).unwrap().config;
    let n = 40 * (8 + 6);
    assert_eq!((metadata.num_particles_max, metadata.write_every, metadata.dim), (n, 30, 2));
    assert!((metadata.dt - 0.25 * 0.025 / 11.0).abs() < 1e-15);
    assert!((metadata.default_connectivity_radius - 1.45 * 0.025).abs() < 1e-15);
    assert_eq!(metadata.periodic_boundary_conditions, [true, false]);
    let fluid = |t: &Trajectory| (0..n).filter(|&i| t.kind[i] == kind::FLUID).collect::<Vec<_>>();
    for (split, trajectories) in Split::ALL.iter().zip(&splits) {
        let path = split.path(&data);
        let file = hdf5::File::open(&path).unwrap();
        for (index, trajectory) in trajectories.iter().enumerate() {
            assert_eq!((trajectory.name.as_str(), trajectory.frames), (format!("{index:05}").as_str(), 4));
            assert_eq!(fluid(trajectory).len(), 40 * 8);
            assert!(trajectory.kind.iter().all(|k| [kind::FLUID, kind::SOLID_WALL].contains(k)));
            for frame in 0..4 {
                for (place, &x) in trajectory.position_of(frame).iter().enumerate() {
                    let [low, high] = metadata.bounds[place % 2];
                    assert!((low..=high).contains(&f64::from(x)));
                }
            }
            let set = trajectory.wall_temperature.as_ref().unwrap();
            let hot: Vec<usize> = (0..n).filter(|&i| set[i].is_finite()).collect();
            assert_eq!(hot.len(), 3 * 20, "three rows of half a channel");
            let temperature = trajectory.temperature.as_ref().unwrap();
            assert!(temperature.iter().all(|t| (0.999..1.24).contains(t)));
            assert!(hot.iter().all(|&i| set[i] == 1.23 && trajectory.temperature_of(2).unwrap()[i] == 1.23));
            // The configuration in the file is the trajectory's own, and its wall is within the limits.
            let provenance = read_provenance(&path, &file.group(&trajectory.name).unwrap()).unwrap();
            let own: Config = toml::from_str(&provenance.configuration).unwrap();
            assert_eq!((own.run.seed, provenance.version.as_str()), (provenance.seed, env!("CARGO_PKG_VERSION")));
            assert_eq!(own.design.offsets.as_ref().unwrap(), &trajectory.wall_offset);
            let shape = Shape::new(trajectory.wall_x.clone(), trajectory.wall_offset.clone(), 0.25, 0.75).unwrap();
            shape.check_bound(config.design.bound).unwrap();
            own.check().unwrap();
            check_shape(&own).unwrap();
            // 30 reference steps at CFL 0.25 are 4 at CFL 1.875.
            let frame = 4.0 * own.time_step();
            assert!((frame - 30.0 * metadata.dt).abs() < 1e-12, "{frame}");
        }
    }
    let all = [&splits[0][..], &splits[1], &splits[2]].concat();
    for (i, one) in all.iter().enumerate() {
        assert!(all[..i].iter().all(|other| other.position != one.position), "trajectory {i} comes twice");
    }
    // Statistics: of the fluid of the training split.
    for d in 0..2 {
        let (mut velocity, mut acceleration) = (vec![], vec![]);
        for trajectory in &splits[0] {
            for i in fluid(trajectory) {
                let steps = steps(&metadata, trajectory, i, d);
                acceleration.extend(steps.windows(2).map(|pair| pair[1] - pair[0]));
                velocity.extend(steps);
            }
        }
        let found = [metadata.vel_mean[d], metadata.vel_std[d], metadata.acc_mean[d], metadata.acc_std[d]];
        let expected = [mean_and_deviation(&velocity), mean_and_deviation(&acceleration)].concat();
        for (a, b) in found.iter().zip(&expected) {
            assert!((a - b).abs() < 1e-12, "{found:?} {expected:?}");
        }
    }
    let heat = metadata.heat.as_ref().unwrap();
    let (mut temperature, mut change) = (vec![], vec![]);
    for trajectory in &splits[0] {
        for i in fluid(trajectory) {
            let t: Vec<f64> = (0..4).map(|f| f64::from(trajectory.temperature_of(f).unwrap()[i])).collect();
            let x: Vec<f64> = (0..4).map(|f| f64::from(trajectory.position_of(f)[2 * i])).collect();
            let inside = (1..4).filter(|&f| x[f] >= heat.inlet_length && x[f] > x[f - 1] - 0.5);
            change.extend(inside.map(|f| t[f] - t[f - 1]));
            temperature.extend(t);
        }
    }
    let found = [heat.temperature_mean, heat.temperature_std, heat.change_mean, heat.change_std];
    let expected = [mean_and_deviation(&temperature), mean_and_deviation(&change)].concat();
    assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?} {expected:?}");
    assert!((heat.diffusivity - 7.313 / 305.27).abs() < 1e-12);

    let text = succeeds(folder.path(), &["dataset", "inspect", "data", "--frames", "2"]);
    for part in ["train", "320 fluid (0)", "240 solid wall (1)", "60 particles of set temperature", "columns", "seed 0"]
    {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    assert!(data.join("frames.png").is_file());
}

#[test]
fn same_bytes_whatever_the_shards_and_after_a_stop() {
    let folder = tempfile::tempdir().unwrap();
    succeeds(folder.path(), &small(&["--out", "whole", "--threads", "1", "--seed", "5"]));
    let whole = bytes(&folder.path().join("whole"));

    // Three shards, the last by Slurm's variables, with different numbers of workers.
    let shard = |more: &[&str]| small(&[&["--out", "shards", "--seed", "5"], more].concat()).join(" ");
    let run = |line: String, slurm: &[(&str, &str)]| {
        let output = hydrograd(folder.path(), &line.split(' ').collect::<Vec<_>>(), slurm);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(run(shard(&["--shard", "2/3", "--threads", "3"]), &[]).contains("4 of 6 trajectories are left"));
    run(shard(&["--shard", "0/3"]), &[]);
    let shards = folder.path().join("shards");
    refuses(folder.path(), &["dataset", "inspect", "shards"], &[], &["4 of 6 trajectories are there"]);
    let output = hydrograd(folder.path(), &["merge", "shards"], &[]);
    assert_eq!(output.status.code(), Some(1), "parts are missing");
    let array = [("SLURM_ARRAY_TASK_ID", "11"), ("SLURM_ARRAY_TASK_MIN", "10"), ("SLURM_ARRAY_TASK_COUNT", "3")];
    assert!(run(shard(&[]), &array).contains("train.h5"));
    assert!(bytes(&shards) == whole, "other bytes from shards");

    // Stopped: one part is gone, one file is left half written under a temporary name, others stay as they are.
    let line = small(&["--out", "stopped", "--seed", "5", "--shard", "0/2"]);
    succeeds(folder.path(), &line);
    let stopped = folder.path().join("stopped");
    let parts = Store::new(&stopped).parts();
    std::fs::remove_file(parts.join("train-00000.h5")).unwrap();
    std::fs::write(parts.join(".tmpabc.h5"), "half").unwrap();
    let kept = std::fs::metadata(parts.join("train-00002.h5")).unwrap().modified().unwrap();
    let text = succeeds(folder.path(), &line);
    assert!(text.contains("1 trajectories made") && text.contains("2 kept from before"), "{text}");
    assert_eq!(std::fs::metadata(parts.join("train-00002.h5")).unwrap().modified().unwrap(), kept);
    succeeds(folder.path(), &small(&["--out", "stopped", "--seed", "5", "--shard", "1/2"]));
    assert!(bytes(&stopped) == whole, "other bytes after a stop");
    assert!(succeeds(folder.path(), &line).contains("is complete"));
    assert!(bytes(&stopped) == whole);
    succeeds(folder.path(), &["merge", "stopped"]);

    // A damaged trajectory is not merged.
    succeeds(folder.path(), &small(&["--out", "damaged", "--shard", "0/2"]));
    let part = folder.path().join("damaged/parts/train-00002.h5");
    std::fs::write(&part, "half").unwrap();
    let output = hydrograd(folder.path(), &small(&["--out", "damaged", "--shard", "1/2"]), &[]);
    let error = String::from_utf8_lossy(&output.stderr).to_string();
    assert!(output.status.code() == Some(1) && error.contains("train-00002.h5"), "{error}");
    assert!(!folder.path().join("damaged/train.h5").exists() && !folder.path().join("damaged/metadata.json").exists());
}

#[test]
fn killed_runs_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let line = small(&["--out", "data", "--frames", "60", "--threads", "1"]);
    let line: Vec<&str> = line.into_iter().collect();
    // The later --frames would be a second one: leave out the first.
    let line: Vec<&str> = [&line[..4], &line[6..]].concat();
    let program = assert_cmd::cargo::cargo_bin("hydrograd");
    let mut child = std::process::Command::new(program)
        .current_dir(folder.path())
        .args(&line)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let first = folder.path().join("data/parts/train-00000.h5");
    for _ in 0..3000 {
        if first.is_file() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    succeeds(folder.path(), &line);
    let again = [&line[..], &["--seed", "0"]].concat();
    let again: Vec<&str> = again.into_iter().map(|word| if word == "data" { "again" } else { word }).collect();
    succeeds(folder.path(), &again);
    assert!(bytes(&folder.path().join("data")) == bytes(&folder.path().join("again")));
}

#[test]
fn flows_make_data_sets() {
    let folder = tempfile::tempdir().unwrap();
    let common = ["--trajectories", "2/1/1", "--frames", "3", "--skip", "10", "--every", "20", "--relax", "50"];
    let cases: [(&str, &str, usize, &[i32]); 4] = [
        ("taylor-green", "resolution.dx=0.05", 400, &[0]),
        ("reverse-poiseuille", "resolution.dx=0.05", 800, &[0]),
        // LagrangeBench's 2708 particles at its spacing.
        ("lid-driven-cavity", "resolution.dx=0.02", 2708, &[0, 1, 2]),
        ("poiseuille", "resolution.dx=0.05", 12 * 26, &[0, 1]),
    ];
    for (scene, dx, particles, kinds) in cases {
        // There the lid's particles move with it, as in LagrangeBench's data.
        let standard = ["--set", "method.name=standard"];
        let standard = if scene == "lid-driven-cavity" { &standard[..] } else { &[] };
        succeeds(folder.path(), &[&["generate", scene, "--out", scene, "--set", dx], &common[..], standard].concat());
        let data = folder.path().join(scene);
        let metadata = Metadata::read(&data).unwrap();
        let train = read_split(&data, &metadata, Split::Train).unwrap();
        assert_eq!((train.len(), train[0].particles, train[0].frames), (2, particles, 3), "{scene}");
        assert!(kinds.iter().all(|kind| train[0].kind.contains(kind)), "{scene}");
        assert!(train[0].kind.iter().all(|kind| kinds.contains(kind)), "{scene}");
        assert!(metadata.heat.is_none() && train[0].temperature.is_none());
        assert_ne!(train[0].position, train[1].position, "{scene}: starts differ");
        succeeds(folder.path(), &["dataset", "inspect", scene]);
        if scene == "lid-driven-cavity" {
            // The lid moves by its velocity.
            let i = train[0].kind.iter().position(|&kind| kind == kind::MOVING_WALL).unwrap();
            let expected = 20.0 * metadata.dt;
            let steps = steps(&metadata, &train[0], i, 0);
            assert!(steps.iter().all(|step| (step - expected).abs() < 1e-6), "{steps:?}");
        }
    }
}

#[test]
fn damaged_trajectories_are_named_and_halves_removed() {
    let folder = tempfile::tempdir().unwrap();
    succeeds(folder.path(), &small(&["--out", "data", "--shard", "0/6"]));
    let data = folder.path().join("data");
    let part = data.join("parts/train-00000.h5");
    let whole = std::fs::read(&part).unwrap();
    std::fs::write(&part, &whole[..whole.len() / 2]).unwrap();
    refuses(folder.path(), &small(&["--out", "data"]), &[], &["cut short", "remove data/parts/train-00000.h5"]);
    std::fs::remove_file(&part).unwrap();
    // As a merge leaves it that was killed.
    let half = data.join(".valid.partial-aB3.h5");
    std::fs::write(&half, "half").unwrap();
    succeeds(folder.path(), &small(&["--out", "data"]));
    assert!(!half.exists() && data.join("valid.h5").exists());
    // As it is left by one that was killed while it wrote the page, or before it removed the parts.
    let (page, half) = (data.join("report.html"), data.join(".report.partial-aB3.html"));
    std::fs::rename(&page, &half).unwrap();
    std::fs::create_dir(data.join("parts")).unwrap();
    succeeds(folder.path(), &small(&["--out", "data"]));
    assert!(!half.exists() && page.exists() && !data.join("parts").exists());
}

#[test]
fn walls_from_a_file_are_taken_in_turns() {
    let folder = tempfile::tempdir().unwrap();
    let wall = |level: &str| vec![level; 20].join(", ");
    std::fs::write(folder.path().join("walls.csv"), [wall("0.0"), wall("0.01"), wall("-0.005")].join("\n\n")).unwrap();
    succeeds(folder.path(), &small(&["--walls-file", "walls.csv", "--out", "data"]));
    let offsets = |split: &str, name: &str| {
        let file = hdf5::File::open(folder.path().join("data").join(format!("{split}.h5"))).unwrap();
        let group = file.group(name).unwrap();
        group.dataset("wall_offset").unwrap().read_raw::<f64>().unwrap()
    };
    let turns = [
        ("train", "00000", 0.0),
        ("train", "00001", 0.01),
        ("train", "00002", -0.005),
        ("train", "00003", 0.0),
        ("valid", "00000", 0.01),
        ("test", "00000", -0.005),
    ];
    for (split, name, level) in turns {
        assert_eq!(offsets(split, name), vec![level; 20], "{split} {name}");
    }
    // Another table is another data set.
    std::fs::write(folder.path().join("walls.csv"), wall("0.002")).unwrap();
    let again = small(&["--walls-file", "walls.csv", "--out", "data"]);
    refuses(folder.path(), &again, &[], &["begun with given", "another --out"]);
}

#[test]
fn bad_input_is_explained_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = ["--out", "unwritten"];
    let cases: [(&[&str], &[&str]); 13] = [
        (&["--trajectories", "4/1"], &["--trajectories", "TRAIN/VALID/TEST"]),
        (&["--trajectories", "0/1/1"], &["no training trajectory", "4/2/2"]),
        (&["--frames", "2"], &["--frames 2", "at least 3"]),
        (&["--every", "0"], &["--every 0", "at least 1"]),
        (&["--shard", "3/3"], &["--shard", "I = 0 ... N - 1"]),
        (&["--shard", "1"], &["--shard", "0/4"]),
        (&["--walls", "square"], &["--walls", "smooth"]),
        (&["--relax", "10"], &["--relax 10", "--skip"]),
        (&["--set", "time.steps=10"], &["length of a trajectory", "--frames"]),
        (&["--set", "time.end=1"], &["length of a trajectory", "--frames"]),
        (&["--set", "design.offsets=[0.5]"], &["design.offsets", "25 offsets"]),
        (&["--walls", "scene", "--set", "design.shape=uniform", "--set", "design.amplitude=0.03"], &["design.bound"]),
        (&["--set", "design.bound=0.5"], &["design.bound = 0.5"]),
    ];
    for (arguments, expected) in cases {
        refuses(folder.path(), &[&["generate", "heated-channel"], arguments, &out].concat(), &[], expected);
    }
    let flow: [&str; 5] = ["generate", "taylor-green", "--walls", "smooth", "--out"];
    refuses(
        folder.path(),
        &[&flow[..], &["unwritten"]].concat(),
        &[],
        &["taylor-green has no walls", "heated-channel"],
    );
    let slurm = [("SLURM_ARRAY_TASK_ID", "1")];
    refuses(folder.path(), &small(&out), &slurm, &["SLURM_ARRAY_TASK_COUNT", "--shard"]);
    let slurm = [("SLURM_ARRAY_TASK_ID", "7"), ("SLURM_ARRAY_TASK_COUNT", "4")];
    refuses(folder.path(), &small(&out), &slurm, &["task 7", "4 tasks"]);
    refuses(folder.path(), &["merge", "unwritten"], &[], &["generate.json"]);
    refuses(folder.path(), &["dataset", "inspect", "unwritten"], &[], &["metadata.json", "hydrograd generate"]);

    // Walls from a file: every line is looked at before anything is written.
    let table = |name: &str, lines: &[&str]| std::fs::write(folder.path().join(name), lines.join("\n")).unwrap();
    let flat = vec!["0.0"; 20].join(",");
    table("short.csv", &[&flat, "0.0,0.01"]);
    table("text.csv", &[&flat, &flat.replacen("0.0", "up", 1)]);
    table("high.csv", &[&flat, &flat.replacen("0.0", "0.03", 1)]);
    table("empty.csv", &["", " "]);
    for (file, parts) in [
        ("short.csv", ["2 numbers for 20 nodes", "--walls-file, wall 2"]),
        ("text.csv", ["line 2: `up`", "--walls-file text.csv"]),
        ("high.csv", ["offsets[0] = 0.03", "--walls-file, wall 2"]),
        ("empty.csv", ["no wall", "a line per wall"]),
        ("none.csv", ["cannot read", "none.csv"]),
    ] {
        refuses(folder.path(), &small(&["--walls-file", file, "--out", "unwritten"]), &[], &parts);
    }

    // A folder that was begun with something else.
    succeeds(folder.path(), &small(&["--out", "data", "--shard", "0/6"]));
    let others: [(&[&str], &str); 3] =
        [(&["--seed", "1"], "run.seed"), (&["--set", "time.cfl=1"], "time.cfl"), (&["--walls", "smooth"], "walls")];
    for (other, part) in others {
        let line = small(&[&["--out", "data"], other].concat());
        refuses(folder.path(), &line, &[], &["begun with", part, "another --out"]);
    }
    let foreign = folder.path().join("foreign");
    std::fs::create_dir(&foreign).unwrap();
    std::fs::write(foreign.join("train.h5"), "theirs").unwrap();
    refuses(folder.path(), &small(&["--out", "foreign"]), &[], &["did not make", "another --out"]);
    assert_eq!(std::fs::read(foreign.join("train.h5")).unwrap(), b"theirs");
}

#[test]
fn every_wall_is_within_the_limits() {
    for (bound, dx) in [(0.02, 0.02), (0.06, 0.02), (0.0, 0.02), (0.1, 0.01)] {
        let nodes = default_nodes(0.25, 0.75, dx);
        let section = Section { nodes: &nodes, hot_from: 0.25, hot_to: 0.75, bound };
        for walls in [Walls::Mix, Walls::Report, Walls::Columns, Walls::Smooth] {
            for index in 0..60 {
                let mut rng = numbered(3, "wall", index);
                let (name, offsets) = wall(walls, Split::Valid, index as usize, &mut rng, section).unwrap();
                let shape = Shape::new(nodes.clone(), offsets, 0.25, 0.75).unwrap();
                shape.check_bound(bound).unwrap_or_else(|bad| panic!("{name}: {bad}"));
            }
        }
    }
}

#[test]
fn the_report_s_functions_are_ten() {
    let nodes = default_nodes(0.25, 0.75, 0.02);
    let section = Section { nodes: &nodes, hot_from: 0.25, hot_to: 0.75, bound: 0.02 };
    let all: Vec<Vec<f64>> = (0..10)
        .map(|i| wall(Walls::Report, Split::Train, i, &mut numbered(0, "wall", 0), section).unwrap().1)
        .collect();
    for (i, one) in all.iter().enumerate() {
        assert!(all[..i].iter().all(|other| other != one), "function {i} comes twice");
    }
    assert!(all[0].iter().all(|o| *o == 0.0) && all[1].iter().all(|o| *o == 0.02));
}
