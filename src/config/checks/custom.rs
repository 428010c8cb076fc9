//! Checks of custom scenes and of their design variables.

use crate::config::custom::{Fill, Kind, ShapeEntry, ShapeNumber, SideKind, VariableEntry};
use crate::config::formula::{Formula, ReadFormula};
use crate::config::method::fixed::{Fixed, FlowKind, PressureKind};
use crate::config::range::{countable, is_whole, whole_spacings};
use crate::config::scene::{Asked, Config, DriveName, Family, Goal, Method, ObjectiveKind};
use crate::error::BadInput;

/// The figures that fixed particles around shapes have.
const fn of_shapes(dimension: usize) -> &'static str {
    match dimension {
        2 => "flow-rate, drag, lift, lift-over-drag, torque, shape-heat, heat-outflow, pressure-drop, dissipation; pressure, temperature, velocity-x, velocity-y (at a point)",
        _ => "flow-rate, drag, lift, lift-over-drag, torque, shape-heat, heat-outflow, pressure-drop; pressure, temperature, velocity-x, velocity-y, velocity-z (at a point)",
    }
}

/// The first of some numbers that belongs to a curve.
fn numbers_of_curves(shapes: &[ShapeEntry], numbers: &[ShapeNumber]) -> Option<usize> {
    numbers.iter().position(|number| shapes[number.shape].kind.is_curve())
}

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
        if !self.is_around_shapes() || self.is_periodic_box() {
            self.check_cells()?;
        }
        let has_heat = initial.temperature.is_some();
        self.check_files_and_grid()?;
        initial.at_start(d)?;
        if self.fluid.expansion != 0.0 && !has_heat {
            return Err(BadInput::at("fluid.expansion", "fluid.expansion in a scene without heat")
                .allowed("with initial.temperature, which gives the scene its heat")
                .advice("initial.temperature=1.0"));
        }
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
            shape.check(place, d, has_heat, self.wall_formula())?;
            if shape.kind == Kind::File && !(d == 3 && self.is_around_shapes()) {
                let (key, file) = (format!("shapes[{place}].file"), shape.file.as_deref().unwrap_or_default());
                let allowed =
                    "three dimensions and method.name = fixed with triangles; a CSV file with columns x and y";
                let where_it_is = if d == 3 { "with particles that move" } else { "in two dimensions" };
                let bad = bad(&key, format!("{file}: triangles {where_it_is}")).allowed(allowed);
                return Err(if d == 3 { bad.advice("method.name=fixed") } else { bad });
            }
            if shape.ends.is_some() && !self.is_around_shapes() {
                let key = format!("shapes[{place}].ends");
                return Err(BadInput::at(&key, format!("{key} with particles that move"))
                    .allowed("with method.name = fixed; a box has ends with every method")
                    .advice("method.name=fixed"));
            }
            if d == 3 && shape.kind.is_curve() && !self.is_around_shapes() {
                let (key, shown) = (format!("shapes[{place}].kind"), shape.kind.shown());
                return Err(bad(&key, format!("{shown} in three dimensions")).allowed(
                    "box, disc, cylinder, polyline, polygon; where with particles that move; ellipse, spline, b-spline, naca, \
                     along all of z, with method.name = fixed",
                ));
            }
        }
        Ok(())
    }

    /// Whether particles are fixed around shapes, and the flow is steady.
    pub fn is_around_shapes(&self) -> bool {
        self.scene == Family::Custom && !self.method.facts().moves
    }

    /// The same in three dimensions, with bodies or walls.
    pub fn is_around_bodies(&self) -> bool {
        self.is_around_shapes() && self.region.size.len() == 3 && !self.is_periodic_box()
    }

    /// Whether particles are fixed on the lattice of a box that is periodic in all directions, without shapes, and the flow
    /// goes on in time.
    pub fn is_periodic_box(&self) -> bool {
        self.unsteady().is_some() && self.shapes.is_empty() && !self.region.periodic.contains(&false)
    }

    /// Checks what is read and written on grids.
    fn check_files_and_grid(&self) -> Result<(), BadInput> {
        const NEEDS: &str = "with method.name = fixed and method.flow = unsteady; in three dimensions in a box that is periodic along all axes, without shapes";
        let bad = |key: &str, problem: &str| BadInput::at(key, format!("{key} {problem}"));
        if self.initial.file.is_some() {
            if self.unsteady().is_none() || self.is_around_bodies() {
                return Err(bad("initial.file", "in a scene whose flow does not begin with it").allowed(NEEDS));
            }
            if !self.initial.velocity.is_empty() {
                return Err(bad("initial.file", "beside initial.velocity").allowed("one of both"));
            }
        }
        let grid = &self.output.grid;
        if grid.is_empty() {
            return Ok(());
        }
        let d = self.region.size.len();
        if grid.len() != d || grid.iter().any(|n| !(1..=4096).contains(n)) || grid.iter().product::<usize>() > 1 << 28 {
            return Err(bad("output.grid", &format!("= {grid:?}"))
                .allowed(format!("{d} whole numbers, 1 ... 4096, at most 2^28 points in all")));
        }
        Ok(())
    }

    /// The keys of fixed particles of a flow that goes on in time, if it does.
    pub fn unsteady(&self) -> Option<Fixed> {
        match self.method {
            Method::Fixed(fixed) if self.is_around_shapes() && fixed.flow == FlowKind::Unsteady => Some(fixed),
            _ => None,
        }
    }

    /// Whether one solution tells the errors of its figures ([`crate::scene::solution_error`]): steady flows around shapes in the plane do.
    pub fn knows_its_errors(&self) -> bool {
        self.is_around_shapes() && !self.is_around_bodies() && self.unsteady().is_none()
    }

    /// Whether the flow of fixed particles around shapes is corrected by slopes of third order.
    pub fn is_corrected(&self) -> bool {
        matches!(self.method, Method::Fixed(fixed) if fixed.deferred_correction)
    }

    /// Whether the pressure of a flow in time around shapes follows from a speed of sound.
    pub fn has_sound(&self) -> bool {
        !self.is_periodic_box()
            && self.unsteady().is_some_and(|fixed| fixed.pressure == PressureKind::WeaklyCompressible)
    }

    /// How formulas on walls are read: in a flow that goes on in time they may have it.
    pub fn wall_formula(&self) -> ReadFormula {
        match self.unsteady() {
            _ if !self.is_around_shapes() => Formula::function,
            Some(_) => Formula::function_of_all,
            None => Formula::function_of_parameters,
        }
    }

    /// Whether a scene of fixed particles around shapes asks for nothing that moving ones lack.
    pub fn counterpart_moves(&self) -> bool {
        let moving = Self { method: Method::default(), ..self.clone() };
        moving.check_no_figures_of_shapes().is_ok() && moving.check_cells().is_ok()
    }

    /// Checks that nothing is asked for that only fixed particles around shapes have.
    pub(super) fn check_no_figures_of_shapes(&self) -> Result<(), BadInput> {
        let (objective, needs) = (&self.objective, "with method.name = fixed");
        let bad = |key: &str, what: String| {
            Err(BadInput::at(key, format!("{key}{what} with method.name = {}", self.method.name()))
                .allowed(format!("leave it out, or {needs}"))
                .advice("method.name=fixed"))
        };
        // The heat of shapes is measured of moving particles too, but not differentiated.
        let is_measured = objective.kind == ObjectiveKind::ShapeHeat
            && self.variables.is_empty()
            && self.dimension() == 2
            && self.has_heat();
        if objective.kind.is_of_shapes() && !is_measured {
            return Err(BadInput::at(
                "objective.kind",
                format!("objective.kind with method.name = {}", self.method.name()),
            )
            .allowed(format!("flow-rate, heat-outflow, outlet-temperature or wall-heat; shape-heat in two dimensions and without variables; figures of shapes {needs}"))
            .advice("method.name=fixed, or objective.kind=flow-rate"));
        }
        let names_shapes = !objective.shapes.is_empty() && !is_measured;
        if names_shapes || !objective.terms.is_empty() || objective.goal != Goal::Larger {
            let key = match (!names_shapes, objective.terms.is_empty()) {
                (false, _) => "objective.shapes",
                (_, false) => "objective.terms",
                _ => "objective.goal",
            };
            return bad(key, String::new());
        }
        if let Some(wrong) = objective.shapes.iter().find(|&&k| k >= self.shapes.len()) {
            return bad("objective.shapes", format!(": there is no shape {wrong},"));
        }
        if !self.limits.is_empty() {
            return bad("limits", String::new());
        }
        if !self.region.sides.is_empty() {
            return bad("region.sides", String::new());
        }
        if self.resolution.surface.is_some() {
            return bad("resolution.surface", String::new());
        }
        if self.resolution.far.is_some() {
            return bad("resolution.far", String::new());
        }
        if self.resolution.growth.is_some() {
            return bad("resolution.growth", String::new());
        }
        if self.fluid.drive != DriveName::BodyForce {
            return bad("fluid.drive", " that holds something".into());
        }
        if let Some(k) = self.shapes.iter().position(|shape| !shape.parameters.is_empty()) {
            return bad(&format!("shapes[{k}].parameters"), String::new());
        }
        match self.shapes.iter().position(|shape| shape.heat_flux.is_some()) {
            Some(k) => bad(&format!("shapes[{k}].heat_flux"), String::new()),
            None => Ok(()),
        }
    }

    /// Checks a scene of fixed particles around shapes.
    pub(super) fn check_around_shapes(&self) -> Result<(), BadInput> {
        let (region, d) = (&self.region, self.dimension());
        let bad = |key: &str, problem: String| BadInput::at(key, format!("{key} {problem}"));
        if self.is_periodic_box() && self.fluid.drive != DriveName::BodyForce {
            return Err(bad("fluid.drive", "that holds something in a box without walls".into())
                .allowed("body-force")
                .advice("fluid.drive=body-force"));
        }
        if d == 3 && !self.is_periodic_box() {
            self.check_around_bodies()?;
        }
        for (k, shape) in self.shapes.iter().enumerate() {
            let key = format!("shapes[{k}]");
            if shape.kind == Kind::Where {
                return Err(bad(
                    &format!("{key}.kind"),
                    "= where: a formula has no outline that fixed particles could follow".into(),
                )
                .allowed("box, disc, ellipse, spline, b-spline, naca, polygon, polyline, file")
                .advice("method.name=consistent"));
            }
            if shape.fill == Fill::Fluid {
                return Err(bad(&format!("{key}.fill"), "= fluid with method.name = fixed".into())
                    .allowed("walls, which are united; what is cut out of a wall with moving particles")
                    .advice("method.name=consistent"));
            }
        }
        for (key, x) in [("region.inlet_until", region.inlet_until), ("region.outlet_from", region.outlet_from)] {
            if x.is_some() {
                return Err(bad(key, "with method.name = fixed, whose flow is steady everywhere".into()).allowed(
                    "region.sides with left = { kind = \"inflow\", velocity = [..], temperature = .. } and an outflow",
                ).advice("method.name=consistent"));
            }
        }
        let has_heat = self.initial.temperature.is_some();
        for (k, (name, side)) in region.sides.all().into_iter().enumerate() {
            let Some(side) = side else { continue };
            let key = |more: &str| format!("region.sides.{name}.{more}");
            let needs_velocity = side.kind == SideKind::Inflow;
            let may_velocity = matches!(side.kind, SideKind::Inflow | SideKind::Wall);
            if k / 2 >= d {
                return Err(bad(&format!("region.sides.{name}"), "in two dimensions".into())
                    .allowed("left, right, bottom, top; back and front in three dimensions"));
            }
            if needs_velocity && side.velocity.is_none() {
                return Err(bad(&key("velocity"), "is missing".into())
                    .allowed(format!("{d} formulas, such as [\"4*y*(1 - y)\", 0]")));
            }
            if !may_velocity && (side.velocity.is_some() || side.temperature.is_some() || side.heat_flux.is_some()) {
                return Err(bad(&key("kind"), "has neither velocity nor temperature nor heat_flux".into())
                    .allowed("those of inflow and wall"));
            }
            if needs_velocity && has_heat && side.temperature.is_none() {
                return Err(
                    bad(&key("temperature"), "is missing: what temperature enters?".into()).allowed("a formula")
                );
            }
            if !has_heat && (side.temperature.is_some() || side.heat_flux.is_some()) {
                return Err(bad(&key("temperature"), "in a scene without heat".into())
                    .allowed("with initial.temperature, which gives the scene its heat")
                    .advice("initial.temperature=1.0"));
            }
            if let Some(velocity) = &side.velocity {
                crate::config::custom::functions(&key("velocity"), velocity, d, self.wall_formula())?;
            }
            for (more, formula) in [("temperature", &side.temperature), ("heat_flux", &side.heat_flux)] {
                if let Some(formula) = formula {
                    self.wall_formula()(formula, &key(more), d)?;
                }
            }
            if (side.kind == SideKind::Periodic) != region.periodic[k / 2] {
                return Err(bad(&key("kind"), format!("and region.periodic = {:?} do not agree", region.periodic))
                    .allowed("region.periodic = true for both sides that are periodic, and false for all others"));
            }
        }
        if self.unsteady().is_some() && self.fluid.drive == DriveName::PumpingPower {
            return Err(bad("fluid.drive", "= pumping-power with method.flow = unsteady".into())
                .allowed("body-force, flow-rate; pumping-power with method.flow = steady")
                .advice("fluid.drive=body-force, or method.flow=steady"));
        }
        if self.has_sound() && self.fluid.drive == DriveName::FlowRate {
            return Err(bad("fluid.drive", "= flow-rate with method.pressure = weakly-compressible".into())
                .allowed("body-force; flow-rate with method.pressure = incompressible")
                .advice("fluid.drive=body-force, or method.pressure=incompressible"));
        }
        self.check_what_moves_and_heats(has_heat)?;
        self.check_objective_of_shapes(has_heat)
    }

    /// That something determines the flow, and the temperature of a steady one.
    fn check_what_moves_and_heats(&self, has_heat: bool) -> Result<(), BadInput> {
        let sides = || self.region.sides.all().into_iter().filter_map(|(_, side)| side);
        let (begins, is_steady) = (&self.initial, self.unsteady().is_none());
        let is_pushed = self.region.acceleration.iter().any(|&x| x != 0.0) || self.fluid.drive != DriveName::BodyForce;
        let has_velocity =
            sides().any(|side| side.velocity.is_some()) || self.shapes.iter().any(|shape| shape.velocity.is_some());
        let moves_at_first = !is_steady && (!begins.velocity.is_empty() || begins.file.is_some());
        if !has_heat && !is_pushed && !has_velocity && !moves_at_first {
            return Err(BadInput::at("region.acceleration", "nothing moves this fluid, and it carries no heat")
                .allowed(
                    "an acceleration, a velocity of a side or of a shape, or fluid.drive = flow-rate or pumping-power",
                )
                .advice(format!(
                    "region.acceleration={}",
                    if self.dimension() == 2 { "[1.0,0.0]" } else { "[1.0,0.0,0.0]" }
                )));
        }
        let has_temperature = sides().any(|side| side.temperature.is_some())
            || self.shapes.iter().any(|shape| shape.temperature.is_some());
        if has_heat && is_steady && !has_temperature {
            let problem = "initial.temperature: a steady flow with heat, but the temperature is given nowhere, so that any constant could be added to it";
            return Err(BadInput::at("initial.temperature", problem)
                .allowed("a temperature of a side (of what enters, or of a wall) or of a shape, beside those with a heat_flux or none")
                .advice("method.flow=unsteady, which begins with initial.temperature"));
        }
        Ok(())
    }

    /// What fixed particles do not have in three dimensions.
    fn check_around_bodies(&self) -> Result<(), BadInput> {
        let bad = |key: &str, problem: &str| BadInput::at(key, format!("{key} {problem} in three dimensions"));
        const IN_PLANE: &str = "a scene in two dimensions";
        if !self.output.grid.is_empty() {
            return Err(bad("output.grid", "with shapes").allowed(IN_PLANE));
        }
        for (key, x) in [("resolution.far", self.resolution.far), ("resolution.growth", self.resolution.growth)] {
            if x.is_some() {
                return Err(bad(key, "with method.name = fixed").allowed(IN_PLANE));
            }
        }
        let objective = &self.objective;
        let terms =
            objective.terms.iter().enumerate().map(|(k, term)| (format!("objective.terms[{k}].kind"), term.kind));
        let limits = self.limits.iter().enumerate().map(|(k, limit)| (format!("limits[{k}].kind"), limit.kind));
        for (key, kind) in terms.chain(limits).chain([("objective.kind".to_string(), objective.kind)]) {
            use ObjectiveKind::{Area, Dissipation, Distance};
            if matches!(kind, Dissipation | Area | Distance) {
                let shown = serde_json::to_value(kind).unwrap_or_default();
                return Err(bad(&key, &format!("= {}", shown.as_str().unwrap_or_default()))
                    .allowed(format!("{}; limits: volume too", of_shapes(3))));
            }
        }
        Ok(())
    }

    fn check_objective_of_shapes(&self, has_heat: bool) -> Result<(), BadInput> {
        let objective = &self.objective;
        let one = |key: &str, asked: &Asked, limit: bool| {
            let Asked { kind, ref shapes, ref at } = *asked;
            let (point, size) = if self.dimension() == 3 { ("[x, y, z]", 3) } else { ("[x, y]", 2) };
            let bad = |what: &str| BadInput::at(key, format!("{key}: {what}"));
            if kind.is_probe() != at.is_some() {
                return Err(match at {
                    None => bad("a probe without a place").allowed(format!("at = {point} beside the kind")),
                    Some(_) => bad("only probes are at a point")
                        .allowed(format!("at = {point} with pressure, temperature, velocity-x, velocity-y")),
                });
            }
            if let Some(place) = at {
                if place.len() != size {
                    return Err(bad(&format!("the point {place:?}")).allowed(format!("at = {point}")));
                }
                if place.iter().zip(&self.region.size).any(|(x, size)| !(*x >= 0.0 && x <= size)) {
                    let sides: Vec<String> = self.region.size.iter().map(|size| format!("0 ... {size}")).collect();
                    return Err(bad(&format!("the point {place:?} is outside of the box")).allowed(sides.join(" and ")));
                }
            }
            if kind == ObjectiveKind::VelocityZ && size == 2 {
                return Err(bad("velocity-z in two dimensions").allowed("velocity-x, velocity-y"));
            }
            if let Some(wrong) = shapes.iter().find(|&&k| k >= self.shapes.len()) {
                return Err(bad(&format!("there is no shape {wrong}")).allowed(format!(
                    "0 ... {}, the places of shapes in the file",
                    self.shapes.len().saturating_sub(1)
                )));
            }
            let about_heat =
                matches!(kind, ObjectiveKind::ShapeHeat | ObjectiveKind::HeatOutflow | ObjectiveKind::Temperature);
            if about_heat && !has_heat {
                return Err(bad("heat in a scene without it")
                    .allowed("with initial.temperature")
                    .advice("initial.temperature=0.0"));
            }
            match kind {
                ObjectiveKind::Area | ObjectiveKind::Distance | ObjectiveKind::Volume if !limit => {
                    Err(bad("area, distance and volume are for limits").allowed("[[limits]] with at_least or at_most"))
                }
                ObjectiveKind::Volume if self.dimension() == 2 => Err(bad("volume in two dimensions").allowed("area")),
                ObjectiveKind::OutletTemperature | ObjectiveKind::WallHeat => {
                    Err(bad("this figure belongs to moving particles")
                        .allowed(of_shapes(self.dimension()))
                        .advice("objective.kind=shape-heat"))
                }
                _ => Ok(()),
            }
        };
        // A scene without variables needs no objective, and the default is about heat.
        if !self.variables.is_empty() && objective.terms.is_empty() {
            one("objective.kind", &objective.asked(), false)?;
        }
        for (k, term) in objective.terms.iter().enumerate() {
            one(&format!("objective.terms[{k}]"), &term.asked(), false)?;
            if term.kind == ObjectiveKind::LiftOverDrag {
                let key = format!("objective.terms[{k}].kind");
                return Err(
                    BadInput::at(&key, format!("{key} = lift-over-drag, which is no sum")).allowed("objective.kind")
                );
            }
        }
        for (k, limit) in self.limits.iter().enumerate() {
            let key = format!("limits[{k}]");
            one(&key, &limit.asked(), true)?;
            if limit.at_least.is_none() && limit.at_most.is_none() {
                return Err(BadInput::at(&key, format!("{key} limits nothing")).allowed("at_least, at_most, or both"));
            }
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

    /// The values of these numbers.
    pub fn shape_values(&self) -> Vec<f64> {
        let mut shapes = self.shapes.clone();
        self.shape_numbers().iter().filter_map(|number| number.of(&mut shapes).copied()).collect()
    }

    /// The configuration with other values of these numbers.
    pub fn with_shape_values(&self, values: &[f64]) -> Self {
        let mut changed = self.clone();
        for (number, value) in self.shape_numbers().iter().zip(values) {
            if let Some(it) = number.of(&mut changed.shapes) {
                *it = *value;
            }
        }
        changed
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
                shapes[found.shape].check(found.shape, dimension, has_heat, self.wall_formula()).map_err(|wrong| {
                    let wrong = wrong.to_string();
                    let problem = wrong.lines().next().unwrap_or_default();
                    bad("number", format!("\"{number}\" may become {limit}, but {problem}"))
                        .allowed("limits between which the shape is one")
                })?;
            }
            let entry = &self.shapes[found.shape];
            let formulas = entry.velocity.iter().flatten().chain(&entry.temperature);
            let formulas = formulas.into_iter().filter(|_| !self.is_around_shapes());
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
        if self.is_around_shapes() {
            return self.optimise.check(self.run.precision);
        }
        if let Some(k) = numbers_of_curves(&self.shapes, &self.shape_numbers()) {
            return Err(BadInput::at(
                format!("variables[{k}].number"),
                format!(
                    "variables[{k}].number = \"{}\": points of moving particles do not follow curves",
                    self.variables[k].number
                ),
            )
            .allowed("numbers of boxes, discs, polylines and polygons; those of curves with method.name = fixed")
            .advice("method.name=fixed"));
        }
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
