//! Scenes: geometries, initial states and wall shapes.
//!
//! `data/scenes` has the values of a scene family. The code here says what distinguishes it (lattice, walls, forces, start,
//! exact solution), from which [`assembly`] makes a [`Scene`]. A new verification flow needs its TOML and an arm in
//! [`flows`].
pub mod accuracy;
pub mod around_bodies;
pub mod around_flow;
pub mod around_grid;
pub mod around_in_time;
pub mod around_shapes;
pub mod assembly;
pub mod checkpoint;
pub mod composite_slab;
pub mod custom;
pub mod custom_shape;
pub mod developed;
pub mod distance;
pub mod exact;
pub mod field_map;
pub mod figure_error;
pub mod figures;
mod flaws;
pub mod flow_of_bodies;
pub mod flow_of_shapes;
pub mod flows;
pub mod heated_channel;
pub mod history;
mod lattice;
pub mod load;
pub mod observers;
mod over_relief;
pub mod particle_fields;
pub mod particle_grid;
pub mod periodic_box;
pub mod periodic_flow;
pub mod periods;
pub mod plausible;
pub mod record;
pub mod shape_heat;
pub mod shape_search;
pub mod solution_error;
pub mod start_field;
mod surface;
pub mod tank;
pub mod verification;
pub mod warnings;

pub use exact::Exact;

use self::shape_heat::{ShapeHeat, ShapeHeats};
use crate::config::builtin::SCENES;
use crate::config::scene::{Config, Family};
use crate::design::diagnostics::{Measurement, Section};
use crate::design::shape::Shape;
use crate::design::Problem;
use crate::error::{BadInput, Error};
use crate::sph::laws::body_force::BodyForce;
use crate::sph::solver::Snapshot;
use crate::sph::{Model, Sweeps};

/// A scene ready to run.
#[derive(Debug, Clone)]
pub struct Scene<R> {
    pub name: &'static str,
    pub model: Model<R>,
    pub start: Snapshot<R>,
    pub steps: usize,
    pub spacing: f64,
    /// The lower corner of the box that includes the walls.
    pub corner: [f64; 3],
    /// The range of the fluid along each direction, between undeformed walls at the ends of the box.
    pub inside: [[f64; 2]; 3],
    pub reference_velocity: f64,
    pub exact: Exact,
    /// The design problem of scenes with a design.
    pub design: Option<Problem<R>>,
    /// Where and when a custom scene is measured; none if neither fluid passes it nor heat is in it.
    pub section: Option<Section>,
}

impl<R: Sweeps> Scene<R> {
    pub fn from_config(config: &Config) -> Result<Self, Error> {
        let scene = match config.scene {
            Family::HeatedChannel | Family::HeatedChannel3d => heated_channel::build(config)?,
            Family::Custom => custom::build(config)?,
            scene if scene.has_surface() => tank::build(config),
            _ => flows::build(config),
        };
        log::info!(
            "built {}: {} particles, {} steps of {:.4e}",
            scene.name,
            scene.model.particles(),
            scene.steps,
            scene.model.dt
        );
        Ok(scene)
    }

    /// The design problem of a checked configuration; none without a design.
    pub fn problem(config: &Config) -> Result<Option<Problem<R>>, Error> {
        Ok(match config.scene {
            Family::Custom if config.variables.is_empty() => None,
            Family::Custom => Some(custom::problem(config)?),
            _ => Self::from_config(config)?.design,
        })
    }

    /// The measurement of a run, of scenes with figures beside their energy.
    pub fn measurement(&self) -> Option<Measurement<'_, R>> {
        match (&self.design, &self.section) {
            (Some(design), _) => Some(Measurement::of(design)),
            (None, section) => section.clone().map(|section| Measurement::new(&self.model, section)),
        }
    }

    /// The heat of its shapes at the same steps, of custom scenes.
    ///
    /// # Errors
    /// Formulas that cannot be read.
    pub fn shape_heats(&self, config: &Config) -> Result<Option<ShapeHeats<'_, R>>, Error> {
        let Some(section) = self.section.as_ref().filter(|_| config.scene == Family::Custom) else { return Ok(None) };
        let found = ShapeHeat::of_config(config)?;
        Ok(found.map(|of| ShapeHeats { of, model: &self.model, steps: section.steps.clone(), samples: vec![] }))
    }

    /// Number of steps at the end over which a run is measured; 0 without a measurement.
    pub fn window(&self) -> usize {
        match (&self.design, &self.section) {
            (Some(design), _) => design.window,
            (None, Some(section)) => section.steps.first().map_or(0, |first| self.steps - first),
            (None, None) => 0,
        }
    }

    /// The same particles with their initial disorder, without velocity and driving forces.
    pub fn at_rest(config: &Config) -> Result<Self, Error> {
        let mut scene = Self::from_config(config)?;
        // Its design holds a model with the driving forces.
        scene.design = None;
        let (n, d) = (scene.model.particles(), scene.model.dimension());
        scene.start.state[d * n..2 * d * n].fill(R::default());
        scene.model =
            scene.model.with(|flow| (flow.body_force, flow.buoyancy, flow.drive) = (BodyForce::None, None, None));
        Ok(scene)
    }

    /// Speed of sound, c = sqrt(dp/drho).
    pub fn sound_speed(&self) -> f64 {
        let state = &self.model.equation_of_state;
        state.slope(state.reference_density).sqrt()
    }
}

/// Returns an error for a scene without a design.
pub fn require_design(config: &Config) -> Result<(), BadInput> {
    if config.has_design() {
        return Ok(());
    }
    if config.scene == Family::Custom {
        return Err(BadInput::at("variables", "the scene names no number of a shape that may change")
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

/// The design problem of a configuration, and its initial shape.
pub fn build_design<R: Sweeps>(config: &Config) -> Result<(Problem<R>, Shape), Error> {
    require_design(config)?;
    let design = Scene::problem(config)?;
    let design = design.ok_or_else(|| Error::run("a scene with a design has none", "report this"))?;
    let shape = design.first_wall();
    Ok((design, shape))
}
