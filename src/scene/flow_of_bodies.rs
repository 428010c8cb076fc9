//! The flow around the bodies of a configuration in three dimensions, steady or in time, and its summary.

use super::around_bodies::AroundBodies;
use super::around_flow::Around;
use super::around_in_time::{Marching, View};
use super::around_shapes::{no_solution, Judged};
use super::history::{Derivative, History, Of, Watch};
use super::particle_fields::ParticleFields;
use crate::config::custom::Part;
use crate::config::scene::{Config, ObjectiveKind};
use crate::error::Error;
use crate::numerics::threads;
use crate::sph::cloud::conditions::Conditions;
use crate::sph::cloud::figures::Figure;
use crate::sph::cloud::fit::COEFFICIENTS_3D;
use crate::sph::cloud::fits::Fits;
use crate::sph::cloud::problem::NoSolution;
use crate::sph::cloud::sound::Medium;
use crate::sph::cloud::space::equations::Bar;
use crate::sph::cloud::space::figures::Rate;
use crate::sph::cloud::space::march::March;
use crate::sph::cloud::space::particles::{Cloud, Shaped};
use crate::sph::cloud::space::problem::Solution;
use crate::sph::cloud::steady::Held;
use crate::sph::cloud::unsteady::Reached;
use crate::sph::cloud::unsteady_adjoint::MEMORY;
use serde_json::{json, Value};
use std::sync::Arc;

impl Around for AroundBodies {
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
        let ((shape, number), ground) = (self.wanted[variable], &self.flow.cloud.ground);
        (ground.surfaces[shape].parts[number], ground.surfaces[shape].size())
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

    fn measured(&self, solution: &Solution, figure: Figure) -> f64 {
        self.flow.measures.value(figure, &self.flow.at(solution))
    }

    fn probes(&self) -> Vec<&[f64]> {
        self.probes.iter().map(|place| &place[..]).collect()
    }

    fn judged_shapes(&self) -> Vec<usize> {
        (0..self.config().shapes.len()).collect()
    }

    fn gradient(&mut self, solution: &Solution, terms: &[(Figure, f64)]) -> Result<Derivative, Error> {
        let wanted = self.wanted.clone();
        let found = self.flow.gradient(solution, terms, &wanted).map_err(|why| no_solution(self.config(), &why))?;
        Derivative::of_steady(self.config(), found)
    }

    fn of_shapes(&self, kind: ObjectiveKind, shapes: &[usize], variables: &[f64]) -> Option<Judged> {
        if kind != ObjectiveKind::Volume {
            return None;
        }
        let (numbers, cloud) = (self.numbers(variables), &self.flow.cloud);
        let chosen = if shapes.is_empty() { (0..self.config().shapes.len()).collect() } else { shapes.to_vec() };
        let slope = |&(shape, number): &(usize, usize)| match chosen.contains(&shape) {
            true => cloud.volume_of(shape, &numbers[shape], Some(number)).slope,
            false => 0.0,
        };
        let by_variables = self.wanted.iter().map(slope).collect();
        let value = chosen.iter().map(|&shape| cloud.volume_of(shape, &numbers[shape], None).value).sum();
        Some(Judged { value, by_variables })
    }

    fn fastest(&self, solution: &Solution) -> f64 {
        let speed = |i: usize| solution.state.velocity(i).iter().map(|u| u * u).sum::<f64>().sqrt();
        (0..self.flow.cloud.particles()).map(speed).fold(0.0, f64::max)
    }

    fn fields(&self, solution: &Solution) -> ParticleFields {
        self.particle_fields(solution)
    }
}

impl Marching<3, 5, COEFFICIENTS_3D> for AroundBodies {
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
        (0..self.config().shapes.len()).collect()
    }

    fn shaped(&self, variables: &[f64]) -> Result<Shaped, Error> {
        let found = self.flow.cloud.shaped(&self.numbers(variables));
        found.map_err(|why| no_solution(self.config(), &NoSolution::from(why)))
    }

    fn view(shaped: &Shaped) -> View<'_, 3> {
        View { numbers: &shaped.numbers, position: &shaped.position, conditions: &shaped.conditions }
    }

    fn scheme<'a>(&'a self, shaped: &'a Shaped) -> March<'a> {
        let cloud = &self.flow.cloud;
        let rate = Rate { measures: &self.flow.measures, shaped };
        let held = self.flow.held.as_ref().map(|held| (held, &rate as _));
        March::new(cloud.equations(shaped), &cloud.places.place, &shaped.operators, held, threads::count())
    }

    fn medium<'a>(&'a self, shaped: &'a Shaped) -> Medium<'a, 3, COEFFICIENTS_3D> {
        let cloud = &self.flow.cloud;
        Medium {
            fits: Arc::clone(&cloud.fits),
            operators: &shaped.operators,
            position: &shaped.position,
            inside: cloud.places.inside,
            spacing: &cloud.places.spacing,
            conditions: &shaped.conditions,
            smoothing: cloud.smoothing(shaped),
            fluid: cloud.fluid,
            sound: self.config().sound_speed(),
            threads: threads::count(),
            by_pairs: Fits::<3>::pull_back_pairs,
        }
    }

    fn seen(&self, shaped: &Arc<Shaped>, time: f64, Reached { state, .. }: Reached<'_, 5>) -> Solution {
        let (cloud, read_at) = (&self.flow.cloud, self.flow.measures.read_at());
        let conditions = match cloud.has_time() {
            false => shaped.conditions.clone(),
            true => {
                let normals = shaped.conditions.iter().map(|condition| condition.normal);
                cloud.conditions_at(&shaped.position, normals, time, &shaped.numbers)
            }
        };
        let derivatives = self.flow.solver.equations.derivatives_at(&shaped.operators, state, read_at);
        Solution { shaped: Arc::clone(shaped), conditions, state: state.clone(), derivatives }
    }

    fn pull_back(&self, figure: Figure, solution: &Solution, weight: f64, bar: &mut Bar) {
        self.flow.measures.pull_back(figure, &self.flow.at(solution), weight, bar);
    }

    fn by_variables(&self, shaped: &Shaped, position: &[Vec<f64>; 3], bar: &Bar) -> Result<Vec<f64>, Error> {
        let found = self.flow.cloud.by_numbers(shaped, position, bar, &self.wanted, None);
        found.map_err(|why| no_solution(self.config(), &NoSolution::from(why)))
    }
}

impl AroundBodies {
    /// The figures of a flow by name, for its summary.
    pub fn summary(&self, solution: &Solution) -> Vec<(&'static str, Value)> {
        let has_heat = self.config().initial.temperature.is_some();
        let (at, measures, fluid) = (self.flow.at(solution), &self.flow.measures, &self.config().fluid);
        let value = |figure: Figure| self.value(solution, figure);
        let capacity = fluid.density * fluid.heat_capacity;
        let shapes = (0..self.config().shapes.len()).map(|shape| {
            let mut record = serde_json::Map::new();
            let force: Vec<f64> = (0..3).map(|along| value(Figure::Force { shape, along })).collect();
            let of_surface: Vec<f64> =
                (0..3).map(|along| fluid.density * measures.surface_force(&at, shape, along)).collect();
            record.insert("force".into(), json!(force));
            record.insert("force_by_surface".into(), json!(of_surface));
            record.insert("torque".into(), json!(value(Figure::Torque { shape })));
            if has_heat {
                record.insert("heat".into(), json!(value(Figure::Heat { shape })));
                record.insert("heat_by_surface".into(), json!(capacity * measures.surface_heat(&at, shape)));
            }
            record.insert("told_by".into(), json!(measures.told_by(&at, shape)));
            Value::Object(record)
        });
        let mut all = vec![
            ("particles", json!(self.flow.cloud.particles())),
            ("flow_rate", json!(value(Figure::FlowRate))),
            ("shapes", shapes.collect::<Value>()),
            ("pressure_drop", json!(value(Figure::PressureDrop))),
            ("body_force", json!(self.config().region.acceleration[0] + solution.state.drive)),
            ("volume", json!(solution.shaped.volume)),
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
        all.push(("iterations", json!(counts.iterations)));
        all.push(("volume_rest", json!(solution.state.lambda)));
        all
    }

    /// What of the flow rate continuity has left over.
    pub fn rest(&self, solution: &Solution) -> f64 {
        let rate = self.flow.measures.value(Figure::FlowRate, &self.flow.at(solution)).abs();
        let [_, width, depth] = self.flow.cloud.ground.region.size;
        let through = rate.max(0.02 * self.fastest(solution) * width * depth).max(f64::MIN_POSITIVE);
        (solution.state.lambda * solution.shaped.volume / through).abs()
    }
}
