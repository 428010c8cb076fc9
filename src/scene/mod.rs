//! Scenes: geometry, start states, wall shapes.
//!
//! A scene family is a file here that says what differs (lattice, walls, forces, start, exact solution); [`assembly`] makes
//! a [`Scene`] of it. A new one is such a file and an arm in [`Scene::from_config`].
pub mod accuracy;
pub mod assembly;
pub mod checkpoint;
pub mod couette;
pub mod custom;
pub mod dam_break;
mod distance;
pub mod exact;
pub mod falling_block;
pub mod figures;
pub mod heated_channel;
mod heated_channel_3d;
pub mod hydrostatic_tank;
pub mod isothermal_channel;
pub mod lid_driven_cavity;
pub mod load;
pub mod observers;
pub mod particle_fields;
pub mod plausible;
pub mod poiseuille;
pub mod reverse_poiseuille;
pub mod slab;
mod surface;
mod tank;
pub mod taylor_green;
pub mod verification;
pub mod warnings;

pub use exact::Exact;

use crate::config::builtin::SCENES;
use crate::config::scene::{Config, Family};
use crate::design::shape::Shape;
use crate::design::Problem;
use crate::error::{BadInput, Error};
use crate::numerics::lanes::Real;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::model::Model;
use crate::sph::solver::Snapshot;
use std::sync::Arc;

/// A scene ready to run.
#[derive(Debug, Clone)]
pub struct Scene<R> {
    pub name: &'static str,
    pub model: Arc<Model<R>>,
    /// The first state.
    pub start: Snapshot<R>,
    /// Of the run.
    pub steps: usize,
    /// Particle spacing.
    pub spacing: f64,
    /// The lower corner of the box, in front of the walls.
    pub corner: [f64; 3],
    /// Where its fluid is along each direction: between the walls at the box's ends, before one is shaped.
    pub inside: [[f64; 2]; 3],
    pub reference_velocity: f64,
    pub exact: Exact,
    /// What only a scene with a design has.
    pub design: Option<Problem<R>>,
}

impl<R: Real> Scene<R> {
    /// The scene of a checked configuration.
    ///
    /// # Errors
    /// A wall shape that its file or its numbers do not allow.
    pub fn from_config(config: &Config) -> Result<Self, Error> {
        let scene = Self::built(config)?;
        log::info!(
            "built {}: {} particles, {} steps of {:.4e}",
            config.scene.name(),
            scene.model.particles(),
            scene.steps,
            scene.model.dt
        );
        Ok(scene)
    }

    fn built(config: &Config) -> Result<Self, Error> {
        Ok(match config.scene {
            Family::HeatedChannel | Family::HeatedChannel3d => heated_channel::build(config)?,
            Family::TaylorGreen | Family::TaylorGreen3d => taylor_green::TaylorGreen::from_config(config).build(),
            Family::Poiseuille => poiseuille::Poiseuille::from_config(config).build(),
            Family::Couette => couette::Couette::from_config(config).build(),
            Family::ReversePoiseuille | Family::ReversePoiseuille3d => {
                reverse_poiseuille::ReversePoiseuille::from_config(config).build()
            }
            Family::LidDrivenCavity | Family::LidDrivenCavity3d => {
                lid_driven_cavity::LidDrivenCavity::from_config(config).build()
            }
            Family::Slab => slab::Slab::from_config(config).build(),
            Family::IsothermalChannel => isothermal_channel::IsothermalChannel::from_config(config).build(),
            Family::Custom => custom::build(config)?,
            Family::DamBreak | Family::DamBreak3d => dam_break::build(config),
            Family::FallingBlock => falling_block::build(config),
            Family::HydrostaticTank => hydrostatic_tank::build(config),
        })
    }

    /// What is optimised in the scene of a checked configuration; none without a design.
    ///
    /// # Errors
    /// As for [`Self::from_config`].
    pub fn problem(config: &Config) -> Result<Option<Problem<R>>, Error> {
        Ok(match config.scene {
            Family::Custom if config.variables.is_empty() => None,
            Family::Custom => Some(custom::problem(config)?),
            _ => Self::from_config(config)?.design,
        })
    }

    /// The same particles with nothing that moves them but their disorder.
    ///
    /// # Errors
    /// As for [`Self::from_config`].
    pub fn at_rest(config: &Config) -> Result<Self, Error> {
        let mut scene = Self::from_config(config)?;
        // Others hold the model of a design.
        scene.design = None;
        let (n, d) = (scene.model.particles(), scene.model.layout.dimension);
        scene.start.state[d * n..2 * d * n].fill(R::default());
        let model = Arc::get_mut(&mut scene.model);
        let model = model.ok_or_else(|| Error::run("a new scene is shared", "report this"))?;
        (model.body_force, model.drive) = (BodyForce::None, None);
        Ok(scene)
    }

    /// c = sqrt(dp/drho).
    pub fn sound_speed(&self) -> f64 {
        let state = &self.model.equation_of_state;
        state.slope(state.reference_density).sqrt()
    }
}

/// An error for scenes without a design.
pub fn require_design(config: &Config) -> Result<(), BadInput> {
    if config.has_design() {
        return Ok(());
    }
    if config.scene == Family::Custom {
        return Err(BadInput::new("the scene names no number of a shape that may change")
            .key("variables")
            .allowed("variables = [{ number = \"shapes[0].radius\", lower = 0.05, upper = 0.1 }] or the like, with objective.kind")
            .advice("data/scenes/examples/cylinder.toml, which has some"));
    }
    let with_design = SCENES.iter().filter(|built_in| built_in.family().has_design());
    let with_design: Vec<&str> = with_design.map(|built_in| built_in.name).collect();
    let name = config.scene.name();
    Err(BadInput::new(format!("scene {name} has no design, so there is nothing to differentiate or optimise"))
        .allowed(format!("a scene with a design: {}", with_design.join(", ")))
        .advice(format!("hydrograd simulate {name}")))
}

/// Builds a scene with a design, and its start shape.
pub fn build_design<R: Real>(config: &Config) -> Result<(Problem<R>, Shape), Error> {
    require_design(config)?;
    let design = Scene::problem(config)?;
    let design = design.ok_or_else(|| Error::run("a scene with a design has none", "report this"))?;
    let shape = design.first_wall();
    Ok((design, shape))
}
