//! `metadata.json`: units, geometry and statistics of a data set; the statistics are those of the training split.

use crate::io::atomic::write_bytes_atomically;
use crate::io::FileError;
use crate::particles::Domain;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The keys of LagrangeBench and ours. Unknown keys of other programs are kept.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Metadata {
    pub dim: usize,
    /// Particle spacing.
    pub dx: f64,
    /// Time step of the simulation; `write_every` steps are between frames.
    pub dt: f64,
    pub write_every: usize,
    pub num_particles_max: usize,
    pub periodic_boundary_conditions: Vec<bool>,
    /// Lower and upper end of the box, `[D][2]`.
    pub bounds: Vec<[f64; 2]>,
    pub default_connectivity_radius: f64,
    /// `[D]`, per frame (dt = 1), over fluid particles of the training split; so are the following.
    pub vel_mean: Vec<f64>,
    pub vel_std: Vec<f64>,
    pub acc_mean: Vec<f64>,
    pub acc_std: Vec<f64>,
    /// Only for data with temperature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heat: Option<Heat>,
    #[serde(flatten)]
    pub other: serde_json::Map<String, serde_json::Value>,
}

/// Parameters and statistics of the temperature, in the units of the scene.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Heat {
    /// Mean and standard deviation of the fluid's temperature in the training split.
    pub temperature_mean: f64,
    pub temperature_std: f64,
    /// Those of its change between frames, without particles that the inlet reset.
    pub change_mean: f64,
    pub change_std: f64,
    /// Fluid at x < `inlet_length` is held at `inlet_temperature`.
    pub inlet_length: f64,
    pub inlet_temperature: f64,
    /// x at which the outflowing heat is measured.
    pub target_x: f64,
    /// Thermal diffusivity, conductivity/(density heat capacity).
    pub diffusivity: f64,
    pub conductivity: f64,
    pub heat_capacity: f64,
    /// Fluid at x > length - `outlet_length` does not conduct.
    pub outlet_length: f64,
}

impl Heat {
    /// Whether fluid that moved from x to `to` within a frame was reset by the inlet: it is there, or passed it around
    /// the periodic end (the fastest particles pass the inlet between two frames).
    pub fn resets(&self, from: f64, to: f64, bounds: [f64; 2]) -> bool {
        to < self.inlet_length || from - to > 0.5 * (bounds[1] - bounds[0])
    }
}

/// The external force per mass of a data set's flow, as in LagrangeBench.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ExternalForce {
    /// Along x, `magnitude` below the middle of the box and -`magnitude` above it (reverse Poiseuille flow).
    Opposed { magnitude: f64, middle: f64 },
    /// Along -y (a dam break).
    Down { magnitude: f64 },
}

impl ExternalForce {
    /// The force along each direction on a particle at height y.
    pub fn at(&self, y: f64) -> [f64; 3] {
        match *self {
            Self::Opposed { magnitude, middle } if y > middle => [-magnitude, 0.0, 0.0],
            Self::Opposed { magnitude, .. } => [magnitude, 0.0, 0.0],
            Self::Down { magnitude } => [0.0, -magnitude, 0.0],
        }
    }
}

/// Largest length of a box in spacings, which limits the number of its cells.
const MOST_SPACINGS: f64 = 1e6;

impl Metadata {
    /// The external force of the flow, if it has one that depends on the place or drives a free surface.
    pub fn external_force(&self) -> Option<ExternalForce> {
        let number = self.other.get("g_ext_magnitude").and_then(|number| number.as_f64());
        let magnitude = number.filter(|&magnitude| magnitude > 0.0)?;
        match self.other.get("case")?.as_str()? {
            "RPF" | "reverse-poiseuille" | "reverse-poiseuille-3d" => {
                let [low, high] = *self.bounds.get(1)?;
                Some(ExternalForce::Opposed { magnitude, middle: 0.5 * (low + high) })
            }
            "DAM" | "dam-break" | "dam-break-3d" => Some(ExternalForce::Down { magnitude }),
            _ => None,
        }
    }

    /// Reads `metadata.json` of a data set's folder.
    ///
    /// # Errors
    /// The file is missing, not JSON, or lacks a key.
    pub fn read(folder: &Path) -> Result<Self, FileError> {
        let path = folder.join("metadata.json");
        let text = std::fs::read_to_string(&path).map_err(|source| FileError::read(&path, source))?;
        let damaged = |what: String| FileError::Damaged {
            path: path.clone(),
            format: "metadata.json of a data set",
            what,
            hint: "it must be LagrangeBench's, or written by `hydrograd generate`",
        };
        let metadata: Self = serde_json::from_str(&text).map_err(|error| damaged(error.to_string()))?;
        let d = metadata.dim;
        let lengths = [
            ("periodic_boundary_conditions", metadata.periodic_boundary_conditions.len()),
            ("bounds", metadata.bounds.len()),
            ("vel_mean", metadata.vel_mean.len()),
            ("vel_std", metadata.vel_std.len()),
            ("acc_mean", metadata.acc_mean.len()),
            ("acc_std", metadata.acc_std.len()),
        ];
        if d != 2 && d != 3 {
            return Err(damaged(format!("dim is {d}, must be 2 or 3")));
        }
        for (name, length) in lengths {
            if length < d {
                return Err(damaged(format!("{name} has {length} entries, must have {d}")));
            }
        }
        let positive = |name: &str, values: &[f64]| match values.iter().find(|v| !(**v > 0.0 && v.is_finite())) {
            Some(value) => Err(damaged(format!("{name} is {value}, must be > 0"))),
            None => Ok(()),
        };
        positive("dx", &[metadata.dx])?;
        let finite = |name: &str, values: &[f64]| match values.iter().find(|v| !v.is_finite()) {
            Some(value) => Err(damaged(format!("{name} is {value}, must be a finite number"))),
            None => Ok(()),
        };
        finite("vel_mean", &metadata.vel_mean[..d])?;
        finite("acc_mean", &metadata.acc_mean[..d])?;
        positive("dt", &[metadata.dt])?;
        if metadata.write_every == 0 {
            return Err(damaged("write_every is 0, must be at least 1".into()));
        }
        for (k, bounds) in metadata.bounds[..d].iter().enumerate() {
            let size = bounds[1] - bounds[0];
            let most = MOST_SPACINGS * metadata.dx;
            if !(size > 0.0 && size <= most) {
                return Err(damaged(format!(
                    "bounds[{k}] is {bounds:?}, must go up, by at most {most:e} ({MOST_SPACINGS:e} dx)"
                )));
            }
        }
        if let Some(heat) = &metadata.heat {
            positive("heat.temperature_std", &[heat.temperature_std])?;
            positive("heat.change_std", &[heat.change_std])?;
            positive(
                "heat.diffusivity, .conductivity, .heat_capacity",
                &[heat.diffusivity, heat.conductivity, heat.heat_capacity],
            )?;
            finite("heat.temperature_mean", &[heat.temperature_mean])?;
            finite("heat.change_mean", &[heat.change_mean])?;
        }
        positive("default_connectivity_radius", &[metadata.default_connectivity_radius])?;
        positive("vel_std", &metadata.vel_std[..d])?;
        positive("acc_std", &metadata.acc_std[..d])?;
        Ok(metadata)
    }

    /// Writes `metadata.json` into a folder.
    pub fn write(&self, folder: &Path) -> Result<(), FileError> {
        let path = folder.join("metadata.json");
        let mut text = serde_json::to_string_pretty(self)
            .map_err(|error| FileError::input(&path, error.to_string(), "finite numbers"))?;
        text.push('\n');
        write_bytes_atomically(&path, text.as_bytes())
    }

    /// Position of the data's origin in the scene, `[D]`; only in our data.
    pub fn origin(&self) -> Option<Vec<f64>> {
        let origin: Vec<f64> = serde_json::from_value(self.other.get("origin")?.clone()).ok()?;
        (origin.len() == self.dim).then_some(origin)
    }

    /// Length of the box in each direction.
    pub fn size(&self) -> [f64; 3] {
        std::array::from_fn(|d| self.bounds.get(d).map_or(1.0, |b| b[1] - b[0]))
    }

    /// The box for the neighbour search.
    pub fn domain(&self) -> Domain {
        Domain { dimension: self.dim, size: self.size(), periodic: self.periodic() }
    }

    /// Whether each of the D directions is periodic.
    pub fn periodic(&self) -> [bool; 3] {
        std::array::from_fn(|d| d < self.dim && self.periodic_boundary_conditions[d])
    }
}
