//! Checks of custom scenes and of their design variables.

use crate::config::custom::{Fill, ShapeNumber, VariableEntry};
use crate::config::range::{countable, is_whole, whole_spacings};
use crate::config::scene::{Config, ObjectiveKind};
use crate::error::BadInput;

impl Config {
    pub fn has_walls(&self) -> bool {
        self.region.periodic.contains(&false) || self.shapes.iter().any(|shape| shape.fill == Fill::Wall)
    }

    /// Checks a custom scene: lengths of vectors, whole numbers of spacings, shapes and formulas.
    pub(super) fn check_custom(&self) -> Result<(), BadInput> {
        let (region, initial) = (&self.region, &self.initial);
        let bad = |key: &str, problem: String| BadInput::at(key, format!("{key} = {problem}"));
        if !(2..=3).contains(&region.size.len()) || region.size.iter().any(|x| !(*x > 0.0 && x.is_finite())) {
            return Err(bad("region.size", format!("{:?}", region.size)).allowed("two or three lengths above 0"));
        }
        let d = region.size.len();
        let other = |key: &str, length: usize, shown: String| match length == d {
            true => Ok(()),
            false => Err(bad(key, shown).allowed(format!("{d} entries, as region.size"))),
        };
        other("region.periodic", region.periodic.len(), format!("{:?}", region.periodic))?;
        other("region.acceleration", region.acceleration.len(), format!("{:?}", region.acceleration))?;
        if region.acceleration.iter().any(|x| !x.is_finite()) {
            return Err(bad("region.acceleration", format!("{:?}", region.acceleration)).allowed("finite numbers"));
        }
        self.check_cells()?;
        let has_heat = initial.temperature.is_some();
        initial.at_start(d)?;
        let (_, exact_temperature) = self.exact.of_time(d)?;
        if exact_temperature.is_some() && !has_heat {
            let bad = BadInput::at("exact.temperature", "exact.temperature in a scene without heat");
            return Err(bad.allowed("with initial.temperature, which gives the scene its heat"));
        }
        for (key, x) in [("region.inlet_until", region.inlet_until), ("region.outlet_from", region.outlet_from)] {
            let Some(x) = x else { continue };
            if !has_heat {
                return Err(bad(key, format!("{x} in a scene without heat")).allowed("with initial.temperature"));
            }
            if !(0.0..=region.size[0]).contains(&x) {
                return Err(bad(key, format!("{x}")).allowed(format!("0 ... {}, region.size[0]", region.size[0])));
            }
        }
        if let (Some(inlet), Some(outlet)) = (region.inlet_until, region.outlet_from) {
            if inlet >= outlet {
                return Err(bad("region.outlet_from", format!("{outlet}"))
                    .allowed(format!("above region.inlet_until = {inlet}")));
            }
        }
        for (place, shape) in self.shapes.iter().enumerate() {
            shape.check(place, d, has_heat)?;
        }
        Ok(())
    }

    fn all_shape_numbers(&self) -> Vec<ShapeNumber> {
        self.shapes.iter().enumerate().flat_map(|(place, entry)| ShapeNumber::all(place, entry)).collect()
    }

    /// The numbers that `variables` names, in order, for a checked configuration.
    pub fn shape_numbers(&self) -> Vec<ShapeNumber> {
        let all = self.all_shape_numbers();
        let named = |variable: &VariableEntry| all.iter().find(|number| number.to_string() == variable.number).copied();
        self.variables.iter().filter_map(named).collect()
    }

    /// Checks the variables: the numbers exist, the shapes allow their limits, and there is an objective.
    pub(super) fn check_variables(&self) -> Result<(), BadInput> {
        let (dimension, has_heat) = (self.dimension(), self.initial.temperature.is_some());
        let numbers = self.all_shape_numbers();
        for (k, variable) in self.variables.iter().enumerate() {
            let VariableEntry { number, lower, upper } = variable;
            let bad = |name: &str, problem: String| {
                let key = format!("variables[{k}].{name}");
                BadInput::at(&key, format!("{key} = {problem}"))
            };
            let Some(found) = numbers.iter().find(|one| one.to_string() == *number) else {
                let names: Vec<String> = numbers.iter().map(ShapeNumber::to_string).collect();
                return Err(bad("number", format!("\"{number}\": no shape has such a number")).allowed(
                    if names.is_empty() { "those of shapes, and there are none".into() } else { names.join(", ") },
                ));
            };
            if self.variables[..k].iter().any(|other| other.number == *number) {
                return Err(bad("number", format!("\"{number}\" for the second time")).allowed("each number once"));
            }
            let mut shapes = self.shapes.clone();
            let now = found.of(&mut shapes).copied().unwrap_or(f64::NAN);
            if !(lower.is_finite() && upper.is_finite() && lower < upper) {
                return Err(
                    bad("upper", format!("{upper} with lower = {lower}")).allowed("finite numbers, upper above lower")
                );
            }
            if !(*lower..=*upper).contains(&now) {
                return Err(bad("number", format!("\"{number}\" is {now}, outside of its limits"))
                    .allowed(format!("{lower} ... {upper} (variables[{k}].lower ... variables[{k}].upper)")));
            }
            for limit in [lower, upper] {
                if let Some(it) = found.of(&mut shapes) {
                    *it = *limit;
                }
                shapes[found.shape].check(found.shape, dimension, has_heat).map_err(|wrong| {
                    let wrong = wrong.to_string();
                    let problem = wrong.lines().next().unwrap_or_default();
                    bad("number", format!("\"{number}\" may become {limit}, but {problem}"))
                        .allowed("limits between which the shape is one")
                })?;
            }
            let entry = &self.shapes[found.shape];
            let formulas = entry.velocity.iter().flatten().chain(&entry.temperature);
            if let Some(formula) = formulas.into_iter().find(|formula| formula.0.trim().parse::<f64>().is_err()) {
                return Err(bad(
                    "number",
                    format!("\"{number}\" moves a wall whose values are formulas: {}", formula.0),
                )
                .allowed("shapes whose velocity and temperature are numbers, or none"));
            }
        }
        if self.variables.is_empty() {
            return Ok(());
        }
        let facts = self.method.facts();
        if facts.wall_cells {
            return Err(BadInput::at(
                "method.name",
                format!("variables in the {} method, whose walls are cells of the lattice", facts.name),
            )
            .allowed("consistent with them")
            .advice("method.name=consistent"));
        }
        let (objective, along) = (&self.objective, self.region.size[0]);
        if !has_heat && objective.kind != ObjectiveKind::FlowRate {
            return Err(BadInput::at("objective.kind", "objective.kind is about heat, and the scene has none")
                .allowed("flow-rate; the others with initial.temperature")
                .advice("objective.kind=flow-rate, or initial.temperature=1.0"));
        }
        if objective.target_x > along {
            return Err(BadInput::at(
                "objective.target_x",
                format!("objective.target_x = {} is outside the box", objective.target_x),
            )
            .allowed(format!("0 ... {along}, region.size[0]")));
        }
        self.optimise.check(self.run.precision)
    }

    /// Checks that dx divides the box, and that the box is neither too small nor too large.
    pub(super) fn check_cells(&self) -> Result<(), BadInput> {
        let (region, dx) = (&self.region, self.resolution.dx);
        let bad = |problem: String| BadInput::at("resolution.dx", problem);
        let particles: f64 = region.size.iter().map(|x| x / dx).product();
        countable(dx, particles)?;
        let support = self.support();
        for (k, (size, periodic)) in region.size.iter().zip(&region.periodic).enumerate() {
            let key = format!("region.size[{k}]");
            let count = (size / dx).round();
            if !is_whole(size / dx) {
                return Err(bad(format!("resolution.dx = {dx} does not divide {key} = {size}"))
                    .allowed("a whole number of spacings along each side")
                    .advice(format!("{} or {key}={}", self.advised_spacings(dx), whole_spacings(*size, dx))));
            }
            // With periodic images, a particle must see each neighbour only once.
            let fewest = if *periodic { 2.0 * (support + self.time.skin) } else { 1.0 };
            if count < fewest {
                return Err(bad(format!("resolution.dx = {dx} is too coarse for {key} = {size}"))
                    .allowed(format!("at least {fewest:.1} spacings along a periodic side"))
                    .advice(self.finer(size / fewest)));
            }
        }
        Ok(())
    }
}
