//! The files of a data set during its generation: one per finished trajectory in `parts/`, and their merge.

use super::metadata::{Heat, Metadata};
use super::recipe::{Job, Recipe};
use super::record::Enclosure;
use super::statistics::Statistics;
use super::trajectory::{read_trajectory, Split, Trajectory};
use crate::config::scene::{Config, DensityEquation, Family, FluxName, Method, Slip, Standard};
use crate::error::{BadInput, Error};
use crate::io::atomic::write_bytes_atomically;
use crate::io::hdf5_file::{
    failed, open, read_number, read_text, write_attribute, write_chunked, write_file, write_text,
};
use crate::io::FileError;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Number of frames per compressed chunk, so that a window of a few frames can be read without the rest.
const CHUNK: usize = 8;

/// The provenance of a trajectory, as attributes of its group.
#[derive(Debug, Clone, PartialEq)]
pub struct Provenance {
    /// Configuration as TOML, with which `hydrograd simulate` runs it again.
    pub configuration: String,
    pub seed: u64,
    /// Version of the program.
    pub version: String,
    /// Name of the wall; empty if no wall is shaped.
    pub wall: String,
}

/// `generate.json`: the recipe with which a folder was started, beside `config.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Begun {
    #[serde(flatten)]
    pub recipe: Recipe,
    pub version: String,
}

/// A folder with a data set, finished or not.
#[derive(Debug, Clone)]
pub struct Store {
    pub folder: PathBuf,
}

impl Store {
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_path_buf() }
    }

    pub fn config_path(&self) -> PathBuf {
        self.folder.join("config.toml")
    }

    pub fn begun_path(&self) -> PathBuf {
        self.folder.join("generate.json")
    }

    pub fn parts(&self) -> PathBuf {
        self.folder.join("parts")
    }

    pub fn part(&self, job: Job) -> PathBuf {
        self.parts().join(format!("{job}.h5"))
    }

    /// Whether the data set is merged. `metadata.json` is written last.
    pub fn is_complete(&self) -> bool {
        self.folder.join("metadata.json").is_file() && Split::ALL.iter().all(|split| split.path(&self.folder).is_file())
    }

    /// The recipe with which the folder was started, if any.
    pub fn begun(&self) -> Result<Option<Begun>, BadInput> {
        let path = self.begun_path();
        let Ok(text) = std::fs::read_to_string(&path) else { return Ok(None) };
        serde_json::from_str(&text).map(Some).map_err(|error| {
            BadInput::new(format!("{} does not load: {error}", path.display()))
                .allowed("as `hydrograd generate` of this version wrote it")
                .advice("another folder")
        })
    }

    /// Writes `config.toml` and `generate.json`.
    pub fn begin(&self, configuration: &str, begun: &Begun) -> anyhow::Result<()> {
        std::fs::create_dir_all(self.parts()).map_err(|source| FileError::write(&self.parts(), source))?;
        write_bytes_atomically(&self.config_path(), configuration.as_bytes())?;
        let text = serde_json::to_string_pretty(begun)? + "\n";
        Ok(write_bytes_atomically(&self.begun_path(), text.as_bytes())?)
    }

    pub fn write_part(&self, job: Job, trajectory: &Trajectory, provenance: &Provenance) -> Result<(), FileError> {
        let path = &self.part(job);
        write_file(path, |file| write_trajectory(path, file, trajectory, provenance))
    }

    fn read_part(&self, job: Job, dimension: usize) -> Result<(Trajectory, Provenance), FileError> {
        let path = &self.part(job);
        let file = open(path, "trajectory")?;
        let name = job.group();
        let provenance = read_provenance(path, &file.group(&name).map_err(failed(path, "open")("the trajectory"))?)?;
        Ok((read_trajectory(path, &file, dimension, name)?, provenance))
    }

    /// The trajectories without a file.
    pub fn missing(&self, recipe: &Recipe) -> Vec<Job> {
        recipe.jobs().into_iter().filter(|&job| !self.part(job).is_file()).collect()
    }

    /// Merges the trajectories into `train.h5`, `valid.h5`, `test.h5`, then `metadata.json`, and removes `parts/`.
    ///
    /// # Errors
    /// Missing or damaged trajectories; system errors.
    pub fn merge(&self, config: &Config, recipe: &Recipe) -> anyhow::Result<()> {
        // Of shards that finish together one merges, and the others find it done.
        let lock_path = self.folder.join("merge.lock");
        let lock = std::fs::File::create(&lock_path).map_err(|source| FileError::write(&lock_path, source))?;
        // Where the file system has no locks, shards that finish together write the same bytes.
        let _ = lock.lock();
        if !self.is_complete() {
            let missing = self.missing(recipe);
            if let Some(first) = missing.first() {
                return Err(Error::run(
                    format!("{} of {} trajectories are missing, {first} first", missing.len(), recipe.jobs().len()),
                    format!("`hydrograd generate` into {} makes them", self.folder.display()),
                )
                .into());
            }
            let frame = Enclosure::of(config)?;
            let mut metadata = metadata(config, recipe, &frame);
            // Settings that do not change the data must not change their bytes.
            let (usual, mut recorded) = (config.scene.defaults(), config.clone());
            (recorded.run.threads, recorded.output) = (usual.run.threads, usual.output);
            (recorded.optimise, recorded.surrogate) = (usual.optimise, usual.surrogate);
            if recipe.pairs > 0.0 {
                metadata.other.insert("pairs".into(), recipe.pairs.into());
            }
            metadata.other.insert(CONFIGURATION.into(), recorded.recorded()?.into());
            let mut statistics = Statistics::default();
            for split in Split::ALL {
                let path = &split.path(&self.folder);
                write_file(path, |file| {
                    for job in recipe.jobs().into_iter().filter(|job| job.split == split) {
                        let (trajectory, provenance) = self.read_part(job, frame.dimension)?;
                        if split == Split::Train {
                            statistics.add(&metadata, &trajectory);
                        }
                        write_trajectory(path, file, &trajectory, &provenance)?;
                    }
                    Ok(())
                })?;
            }
            statistics.write_to(&mut metadata);
            metadata.write(&self.folder)?;
        }
        // Errors are ignored: the data set is complete.
        let _ = std::fs::remove_dir_all(self.parts());
        let _ = std::fs::remove_file(&lock_path);
        Ok(())
    }
}

fn write_trajectory(
    path: &Path,
    file: &hdf5::File,
    trajectory: &Trajectory,
    provenance: &Provenance,
) -> Result<(), FileError> {
    let group = file.create_group(&trajectory.name).map_err(failed(path, "create")(&trajectory.name))?;
    let (t, n) = (trajectory.frames, trajectory.particles);
    let (d, frames) = (trajectory.position.len() / (t * n), t.min(CHUNK));
    write_chunked(path, &group, "position", &[t, n, d], &[frames, n, d], &trajectory.position)?;
    write_chunked(path, &group, "particle_type", &[n], &[n], &trajectory.kind)?;
    if let Some(temperature) = &trajectory.temperature {
        write_chunked(path, &group, "temperature", &[t, n], &[frames, n], temperature)?;
    }
    if let Some(temperature) = &trajectory.wall_temperature {
        write_chunked(path, &group, "wall_temperature", &[n], &[n], temperature)?;
    }
    let objective: Vec<f64> = trajectory.objective.into_iter().collect();
    let of_wall = [
        ("wall_x", &trajectory.wall_x),
        ("wall_offset", &trajectory.wall_offset),
        ("objective", &objective),
        ("objective_gradient", &trajectory.objective_gradient),
    ];
    for (name, values) in of_wall {
        if !values.is_empty() {
            write_chunked(path, &group, name, &[values.len()], &[values.len()], values)?;
        }
    }
    write_text(path, &group, "configuration", &provenance.configuration)?;
    write_attribute(path, &group, "seed", &[], &[provenance.seed])?;
    write_text(path, &group, "version", &provenance.version)?;
    write_text(path, &group, "wall", &provenance.wall)
}

/// The provenance of a trajectory's group.
///
/// # Errors
/// A missing attribute: the data set was not made by `hydrograd generate`.
pub fn read_provenance(path: &Path, group: &hdf5::Group) -> Result<Provenance, FileError> {
    Ok(Provenance {
        configuration: read_text(path, group, "configuration")?,
        seed: read_number(path, group, "seed")?,
        version: read_text(path, group, "version")?,
        wall: read_text(path, group, "wall")?,
    })
}

/// The key of the metadata with the scene's configuration, as TOML.
pub const CONFIGURATION: &str = "configuration";

/// The metadata without statistics.
fn metadata(config: &Config, recipe: &Recipe, frame: &Enclosure) -> Metadata {
    let (d, dx, pace) = (frame.dimension, config.resolution.dx, recipe.pace(config));
    let (fluid, channel) = (&config.fluid, &config.channel);
    let heated = config.scene.has_design();
    // Other methods lack LagrangeBench's keys here; the values of the standard method are then defaults.
    let own = match [config.method, config.scene.defaults_with("standard").method] {
        [Method::Standard(own), _] | [_, Method::Standard(own)] => own,
        _ => Standard::default(),
    };
    let serde_json::Value::Object(other) = json!({
        "case": config.scene.name(),
        "solver": match own.flux {
            FluxName::Pair => "SPH",
            FluxName::Delta => "DELTA",
            FluxName::Riemann => "RIE",
        },
        "density_evolution": own.density_equation == DensityEquation::Evolution,
        "is_bc_trick": true,
        "free_slip": config.wall.slip == Slip::Free,
        "artificial_alpha": own.artificial_viscosity,
        "viscosity": if heated || config.scene == Family::Custom || config.scene.has_surface() { fluid.viscosity } else { 1.0 / config.flow.reynolds },
        "p_bg_factor": own.background_pressure_factor,
        "g_ext_magnitude": match config.scene {
            Family::HeatedChannel | Family::ReversePoiseuille | Family::ReversePoiseuille3d => fluid.body_force,
            Family::Poiseuille => 8.0 / config.flow.reynolds,
            Family::Custom => config.acceleration(),
            scene if scene.has_surface() => fluid.gravity.iter().map(|g| g * g).sum::<f64>().sqrt(),
            _ => 0.0,
        },
        "t_end": pace.reference * (recipe.every * (recipe.frames - 1)) as f64,
        "sequence_length_train": recipe.frames - 1,
        "num_trajs_train": recipe.trajectories[0],
        "sequence_length_test": recipe.frames - 1,
        "num_trajs_test": recipe.trajectories[2],
        "num_trajs_valid": recipe.trajectories[1],
        "skipped_steps": recipe.skip,
        "solver_dt": pace.dt,
        "solver_steps_per_frame": pace.every,
        "origin": frame.origin[..d],
        "seed": config.run.seed,
        "version": env!("CARGO_PKG_VERSION"),
    }) else {
        unreachable!("a JSON object")
    };
    Metadata {
        dim: d,
        dx,
        dt: pace.reference,
        write_every: recipe.every,
        num_particles_max: frame.particles,
        periodic_boundary_conditions: frame.periodic[..d].to_vec(),
        bounds: (0..d).map(|k| [0.0, frame.size[k]]).collect(),
        default_connectivity_radius: 1.45 * dx,
        heat: heated.then(|| Heat {
            inlet_length: channel.inlet_length,
            inlet_temperature: fluid.inlet_temperature,
            target_x: config.objective.target_x,
            diffusivity: config.thermal_diffusivity(),
            conductivity: fluid.conductivity,
            heat_capacity: fluid.heat_capacity,
            outlet_length: channel.outlet_length,
            ..Heat::default()
        }),
        other,
        ..Metadata::default()
    }
}
