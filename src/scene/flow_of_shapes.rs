//! The flow around the shapes of a configuration in two dimensions, steady or in time, and its summary.

use super::around_flow::Around;
use super::around_in_time::{Marching, View};
use super::around_shapes::{no_solution, AroundShapes, Judged};
use super::history::{Derivative, History, Of, Watch};
use super::particle_fields::ParticleFields;
use crate::config::custom::Part;
use crate::config::scene::{Config, ObjectiveKind};
use crate::error::Error;
use crate::numerics::grid_field::GridVelocity;
use crate::numerics::threads;
use crate::sph::cloud::equations::{Bar, State};
use crate::sph::cloud::figures::{Figure, Rate};
use crate::sph::cloud::fit::COEFFICIENTS;
use crate::sph::cloud::fits::Fits;
use crate::sph::cloud::march::March;
use crate::sph::cloud::particles::{Cloud, Shaped};
use crate::sph::cloud::problem::{NoSolution, Solution};
use crate::sph::cloud::sound::Medium;
use crate::sph::cloud::steady::Held;
use crate::sph::cloud::unsteady::Reached;
use crate::sph::cloud::unsteady_adjoint::MEMORY;
use serde_json::{json, Value};
use std::f64::consts::PI;
use std::sync::Arc;

/// Flows around bodies are stable below this Reynolds number by the fastest particle. (Vortices begin behind a cylinder at 46 by the
/// stream far away, which is slower.)
const STABLE: f64 = 40.0;

impl Around for AroundShapes {
    type Solution = Solution;

    fn config(&self) -> &Config {
        self.config()
    }

    fn first(&self) -> Vec<f64> {
        self.first()
    }

    fn particles(&self) -> usize {
        self.flow.cloud.particles()
    }

    fn surface(&self) -> f64 {
        self.flow.cloud.ground.surface
    }

    fn part(&self, variable: usize) -> (Part, f64) {
        let ((shape, number), cloud) = (self.wanted[variable], &self.flow.cloud);
        (cloud.ground.outlines[shape].parts[number], (cloud.places.polygons[shape].area() / PI).sqrt())
    }

    fn solve(&mut self, variables: &[f64]) -> Result<Solution, Error> {
        self.check_steady()?;
        let numbers = self.numbers(variables);
        self.flow.solve(&numbers).map_err(|why| no_solution(self.config(), &why))
    }

    fn march(
        &self,
        variables: &[f64],
        sizes: Option<&[f64]>,
        watch: Watch<'_, Solution>,
    ) -> Result<(History, Solution), Error> {
        self.go(variables, sizes, watch)
    }

    fn march_gradient(&self, variables: &[f64], history: &History, of: Of<'_>) -> Result<Derivative, Error> {
        self.go_back(variables, history, of, MEMORY)
    }

    fn velocity_on_grid(&self, solution: &Solution) -> Option<Vec<f64>> {
        self.grid_velocity(solution)
    }

    fn measured(&self, solution: &Solution, figure: Figure) -> f64 {
        self.flow.value(solution, figure)
    }

    fn probes(&self) -> Vec<&[f64]> {
        self.probes.iter().map(|place| &place[..]).collect()
    }

    fn judged_shapes(&self) -> Vec<usize> {
        let places = &self.flow.cloud.places;
        if places.bodies.is_empty() {
            places.touching.clone()
        } else {
            places.bodies.clone()
        }
    }

    fn gradient(&mut self, solution: &Solution, terms: &[(Figure, f64)]) -> Result<Derivative, Error> {
        let wanted = self.wanted.clone();
        let found = self.flow.gradient(solution, terms, &wanted).map_err(|why| no_solution(self.config(), &why))?;
        Derivative::of_steady(self.config(), found)
    }

    fn of_shapes(&self, kind: ObjectiveKind, shapes: &[usize], variables: &[f64]) -> Option<Judged> {
        self.of_outlines(kind, shapes, variables)
    }

    fn fastest(&self, solution: &Solution) -> f64 {
        let [u, v, ..] = &solution.state.fields;
        u.iter().zip(v).map(|(u, v)| u.hypot(*v)).fold(0.0, f64::max)
    }

    fn fields(&self, solution: &Solution) -> ParticleFields {
        self.particle_fields(solution)
    }
}

impl Marching<2, 4, COEFFICIENTS> for AroundShapes {
    type Cloud = Cloud;
    type Shaped = Shaped;
    type March<'a> = March<'a>;

    fn cloud(&self) -> &Cloud {
        &self.flow.cloud
    }

    fn wanted(&self) -> &[(usize, usize)] {
        &self.wanted
    }

    fn by_viscosity(&self) -> bool {
        self.by_viscosity
    }

    fn spacing(&self) -> &[f64] {
        &self.flow.cloud.places.spacing
    }

    fn held(&self) -> Option<&Held> {
        self.flow.held.as_ref()
    }

    fn shapes_of_history(&self) -> Vec<usize> {
        self.flow.cloud.places.touching.clone()
    }

    fn start(&self) -> Option<&GridVelocity> {
        self.start.as_ref()
    }

    fn grid_back(&self, shaped: &Arc<Shaped>, state: &State, by: &[f64], bar: &mut Bar) {
        let derivatives = self.flow.solver.equations.derivatives(&shaped.operators, state, true);
        self.grid_velocity_back(
            &Solution { shaped: Arc::clone(shaped), state: state.clone(), derivatives, first: None, defect: None },
            by,
            bar,
        );
    }

    fn shaped(&self, variables: &[f64]) -> Result<Shaped, Error> {
        let found = self.flow.cloud.shaped(&self.numbers(variables));
        found.map_err(|why| no_solution(self.config(), &NoSolution::from(why)))
    }

    fn view(shaped: &Shaped) -> View<'_, 2> {
        View { numbers: &shaped.numbers, position: &shaped.position, conditions: &shaped.conditions }
    }

    fn scheme<'a>(&'a self, shaped: &'a Shaped) -> March<'a> {
        let cloud = &self.flow.cloud;
        let rate = Rate { measures: &self.flow.measures, shaped };
        let held = self.flow.held.as_ref().map(|held| (held, &rate as _));
        March::new(cloud.equations(shaped), &cloud.places.place, &shaped.operators, held, threads::count())
            .corrected(cloud.lagged(shaped))
    }

    fn medium<'a>(&'a self, shaped: &'a Shaped) -> Medium<'a, 2, COEFFICIENTS> {
        let cloud = &self.flow.cloud;
        Medium {
            fits: Arc::clone(&cloud.fits),
            operators: &shaped.operators,
            position: &shaped.position,
            inside: cloud.places.inside,
            spacing: &cloud.places.spacing,
            conditions: &shaped.conditions,
            smoothing: &[],
            fluid: cloud.fluid,
            sound: self.config().sound_speed(),
            threads: threads::count(),
            by_pairs: Fits::<2>::pull_back_pairs,
        }
    }

    fn seen(&self, shaped: &Arc<Shaped>, _: f64, Reached { state, defect }: Reached<'_, 4>) -> Solution {
        let (equations, read_at) = (&self.flow.solver.equations, self.flow.measures.read_at());
        let derivatives = equations.derivatives_at(&shaped.operators, state, read_at);
        let defect = defect.cloned();
        Solution { shaped: Arc::clone(shaped), state: state.clone(), derivatives, first: None, defect }
    }

    fn pull_back(&self, figure: Figure, solution: &Solution, weight: f64, bar: &mut Bar) {
        self.flow.measures.pull_back(figure, &self.flow.at(solution), weight, bar);
    }

    fn by_variables(&self, shaped: &Shaped, position: &[Vec<f64>; 2], bar: &Bar) -> Result<Vec<f64>, Error> {
        Ok(self.flow.cloud.by_numbers(shaped, position, bar, &self.wanted, None))
    }
}

impl AroundShapes {
    /// The figures of a flow by name, for its summary.
    pub fn summary(&self, solution: &Solution) -> Vec<(&'static str, Value)> {
        let has_heat = self.config().initial.temperature.is_some();
        let at = self.flow.at(solution);
        let measures = &self.flow.measures;
        let value = |figure: Figure| self.value(solution, figure);
        let fluid = &self.config().fluid;
        let capacity = fluid.density * fluid.heat_capacity;
        let shapes = (0..self.config().shapes.len()).map(|shape| {
            let mut record = serde_json::Map::new();
            let force: Vec<f64> = (0..2).map(|along| value(Figure::Force { shape, along })).collect();
            let of_surface: Vec<f64> =
                (0..2).map(|along| fluid.density * measures.surface_force(&at, shape, along)).collect();
            record.insert("force".into(), json!(force));
            record.insert("force_by_surface".into(), json!(of_surface));
            record.insert("torque".into(), json!(value(Figure::Torque { shape })));
            if has_heat {
                record.insert("heat".into(), json!(value(Figure::Heat { shape })));
                record.insert("heat_by_surface".into(), json!(capacity * measures.surface_heat(&at, shape)));
                record.insert("largest_heat_flux".into(), json!(capacity * measures.largest_heat_flux(&at, shape)));
            }
            Value::Object(record)
        });
        let mut all = vec![
            ("particles", json!(self.flow.cloud.particles())),
            ("flow_rate", json!(value(Figure::FlowRate))),
            ("shapes", shapes.collect::<Value>()),
            ("pressure_drop", json!(value(Figure::PressureDrop))),
            ("dissipation", json!(value(Figure::Dissipation))),
            ("body_force", json!(self.config().region.acceleration[0] + solution.state.drive)),
        ];
        if has_heat {
            all.push(("heat_outflow", json!(value(Figure::HeatOutflow))));
        }
        if self.has_objective() {
            all.push(("objective_kind", self.config().objective.recorded_kind()));
            all.push(("objective", json!(self.objective(solution).0)));
        }
        let counts = self.flow.solver.counts;
        all.push(("newton_steps", json!(counts.steps)));
        all.push(("factorisations", json!(counts.factorisations)));
        all.push(("volume_rest", json!(solution.state.lambda)));
        all
    }

    /// The growth rate and angular frequency of the disturbance that grows fastest, and the Reynolds number by the largest body and the
    /// fastest particle; none below a Reynolds number at which flows around bodies are known to be stable.
    ///
    /// # Errors
    /// A matrix without factors.
    pub fn growth(&mut self, solution: &Solution, fastest: f64) -> Result<Option<(f64, f64)>, Error> {
        let cloud = &self.flow.cloud;
        let across = cloud.places.bodies.iter().map(|&body| 2.0 * cloud.ground.outlines[body].radius());
        let size = across.fold(0.0, f64::max);
        if size == 0.0 || fastest * size / self.config().kinematic_viscosity() < STABLE {
            return Ok(None);
        }
        // The angular frequency of vortices behind a cylinder is about this.
        let rate = 1.2 * fastest / size;
        self.flow.growth(solution, rate).map_err(|why| no_solution(self.config(), &why))
    }
}
