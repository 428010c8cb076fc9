//! Scenes of one's own: a box, the shapes in it, what the fluid begins with.

use crate::config::formula::Formula;
use crate::config::scene::{Config, Formulation, GradientMode, ObjectiveKind};
use crate::error::BadInput;
use serde::{Deserialize, Serialize};

/// The box.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Region {
    /// Lengths along x, y (and z): as many as there are dimensions. The corner is at 0.
    pub size: Vec<f64>,
    /// Whether what leaves at one side comes in at the other; a side that is not periodic is a wall.
    pub periodic: Vec<bool>,
    /// Body force per mass.
    pub acceleration: Vec<f64>,
    /// Fluid at x below this is reset to `fluid.inlet_temperature`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inlet_until: Option<f64>,
    /// Fluid at x above this does not conduct.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outlet_from: Option<f64>,
}

impl Default for Region {
    fn default() -> Self {
        Self {
            size: vec![1.0, 0.4],
            periodic: vec![true, false],
            acceleration: vec![0.0, 0.0],
            inlet_until: None,
            outlet_from: None,
        }
    }
}

/// What the fluid begins with.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Initial {
    /// Components of the velocity; none: at rest.
    pub velocity: Vec<Formula>,
    /// None: the scene has no heat.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature: Option<Formula>,
}

/// A part of space, and what fills it. Of two shapes that overlap the later one counts.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShapeEntry {
    pub kind: Kind,
    pub fill: Fill,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lower: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub upper: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub centre: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<Axis>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<Vec<[f64; 2]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thickness: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub positive: Option<Formula>,
    /// Of a wall: what its surface moves with. None: at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<Vec<Formula>>,
    /// Of a wall. None: no heat flows through it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature: Option<Formula>,
}

/// A number of a shape that an optimiser may change, and how far.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VariableEntry {
    /// Its key, such as `shapes[0].centre[1]`.
    pub number: String,
    pub lower: f64,
    pub upper: f64,
}

/// Which number of which shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShapeNumber {
    pub shape: usize,
    pub part: Part,
}

/// Which number of a shape: of vectors the component, of points the point and its component.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    Lower(usize),
    Upper(usize),
    Centre(usize),
    Radius,
    Point(usize, usize),
    Thickness,
}

impl ShapeNumber {
    /// Those that shape number `shape` has.
    fn all(shape: usize, entry: &ShapeEntry) -> Vec<Self> {
        let vector = |vector: &Option<Vec<f64>>| 0..vector.as_ref().map_or(0, Vec::len);
        let points = 0..entry.points.as_ref().map_or(0, Vec::len);
        let parts = vector(&entry.lower).map(Part::Lower);
        let parts = parts.chain(vector(&entry.upper).map(Part::Upper)).chain(vector(&entry.centre).map(Part::Centre));
        let parts = parts.chain(entry.radius.map(|_| Part::Radius));
        let parts = parts.chain(points.flat_map(|point| [Part::Point(point, 0), Part::Point(point, 1)]));
        parts.chain(entry.thickness.map(|_| Part::Thickness)).map(|part| Self { shape, part }).collect()
    }

    /// The number itself; none if there is no such one.
    pub fn of<'a>(&self, shapes: &'a mut [ShapeEntry]) -> Option<&'a mut f64> {
        let entry = shapes.get_mut(self.shape)?;
        match self.part {
            Part::Lower(d) => entry.lower.as_mut()?.get_mut(d),
            Part::Upper(d) => entry.upper.as_mut()?.get_mut(d),
            Part::Centre(d) => entry.centre.as_mut()?.get_mut(d),
            Part::Radius => entry.radius.as_mut(),
            Part::Point(point, d) => entry.points.as_mut()?.get_mut(point)?.get_mut(d),
            Part::Thickness => entry.thickness.as_mut(),
        }
    }
}

impl std::fmt::Display for ShapeNumber {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "shapes[{}].", self.shape)?;
        match self.part {
            Part::Lower(d) => write!(out, "lower[{d}]"),
            Part::Upper(d) => write!(out, "upper[{d}]"),
            Part::Centre(d) => write!(out, "centre[{d}]"),
            Part::Radius => write!(out, "radius"),
            Part::Point(point, d) => write!(out, "points[{point}][{d}]"),
            Part::Thickness => write!(out, "thickness"),
        }
    }
}

/// Kinds of shapes, each with keys of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Between two corners: `lower`, `upper`.
    #[default]
    Box,
    /// `centre`, `radius`; a ball in three dimensions.
    Disc,
    /// Three dimensions: `centre`, `radius`, along `axis` from end to end.
    Cylinder,
    /// Within half a `thickness` of the line through `points` (x, y); along all of z.
    Polyline,
    /// Inside the closed line through `points` (x, y); along all of z.
    Polygon,
    /// Where a formula is above 0: `positive`.
    Where,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fill {
    #[default]
    Wall,
    Fluid,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    X,
    Y,
    #[default]
    Z,
}

impl Axis {
    /// 0, 1, 2 for x, y, z.
    pub fn direction(self) -> usize {
        match self {
            Self::X => 0,
            Self::Y => 1,
            Self::Z => 2,
        }
    }
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Disc => "disc",
            Self::Cylinder => "cylinder",
            Self::Polyline => "polyline",
            Self::Polygon => "polygon",
            Self::Where => "where",
        }
    }

    /// Keys that a shape of this kind must have.
    fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Box => &["lower", "upper"],
            Self::Disc => &["centre", "radius"],
            Self::Cylinder => &["centre", "radius", "axis"],
            Self::Polyline => &["points", "thickness"],
            Self::Polygon => &["points"],
            Self::Where => &["positive"],
        }
    }
}

impl ShapeEntry {
    /// One with every key, for the list of keys.
    pub fn complete() -> Self {
        Self {
            lower: Some(vec![]),
            upper: Some(vec![]),
            centre: Some(vec![]),
            radius: Some(1.0),
            axis: Some(Axis::Z),
            points: Some(vec![]),
            thickness: Some(1.0),
            positive: Some(1.0.into()),
            velocity: Some(vec![]),
            temperature: Some(1.0.into()),
            ..Self::default()
        }
    }

    /// The first thing wrong with shape number `place`.
    fn check(&self, place: usize, dimension: usize, has_heat: bool) -> Result<(), BadInput> {
        let key = |name: &str| format!("shapes[{place}].{name}");
        let bad = |name: &str, problem: String| BadInput::new(format!("{}: {problem}", key(name))).key(key(name));
        let kind = self.kind;
        let given = [
            ("lower", self.lower.is_some()),
            ("upper", self.upper.is_some()),
            ("centre", self.centre.is_some()),
            ("radius", self.radius.is_some()),
            ("axis", self.axis.is_some()),
            ("points", self.points.is_some()),
            ("thickness", self.thickness.is_some()),
            ("positive", self.positive.is_some()),
        ];
        let allowed = format!("a {} has {}", kind.name(), kind.keys().join(", "));
        for (name, is_given) in given {
            let wanted = kind.keys().contains(&name);
            if wanted != is_given {
                let problem = if wanted { "is missing" } else { "has no meaning here" };
                return Err(bad(name, format!("{problem} (kind = {})", kind.name())).allowed(allowed));
            }
        }
        if kind == Kind::Cylinder && dimension == 2 {
            return Err(bad("kind", "a cylinder in two dimensions".into()).allowed("disc").advice("kind = \"disc\""));
        }
        let vectors = [("lower", &self.lower), ("upper", &self.upper), ("centre", &self.centre)];
        for (name, vector) in vectors {
            let Some(vector) = vector else { continue };
            if vector.len() != dimension || vector.iter().any(|x| !x.is_finite()) {
                return Err(bad(name, format!("{vector:?}")).allowed(format!("{dimension} finite numbers")));
            }
        }
        for (name, length) in [("radius", self.radius), ("thickness", self.thickness)] {
            if let Some(length) = length.filter(|length| !(*length > 0.0 && length.is_finite())) {
                return Err(bad(name, format!("{length}")).allowed("a length above 0"));
            }
        }
        if let (Some(lower), Some(upper)) = (&self.lower, &self.upper) {
            if lower.iter().zip(upper).any(|(low, high)| low >= high) {
                return Err(bad("upper", format!("{upper:?} with lower = {lower:?}"))
                    .allowed("upper above lower in each direction"));
            }
        }
        let least = if kind == Kind::Polygon { 3 } else { 2 };
        if let Some(points) = self
            .points
            .as_ref()
            .filter(|points| points.len() < least || points.iter().flatten().any(|x| !x.is_finite()))
        {
            return Err(bad("points", format!("{points:?}")).allowed(format!("at least {least} points [x, y]")));
        }
        if let Some(formula) = &self.positive {
            formula.function(&key("positive"), dimension)?;
        }
        let is_wall = self.fill == Fill::Wall;
        if let Some(velocity) = &self.velocity {
            if !is_wall {
                return Err(bad("velocity", "of fluid".into()).allowed("initial.velocity for the fluid's"));
            }
            check_vector(&key("velocity"), velocity, dimension)?;
        }
        if let Some(temperature) = &self.temperature {
            if !is_wall {
                return Err(bad("temperature", "of fluid".into()).allowed("initial.temperature for the fluid's"));
            }
            if !has_heat {
                return Err(bad("temperature", "in a scene without heat".into())
                    .allowed("with initial.temperature, which gives the scene its heat")
                    .advice("initial.temperature=1.0"));
            }
            temperature.function(&key("temperature"), dimension)?;
        }
        Ok(())
    }
}

/// Formulas of a vector.
fn check_vector(key: &str, vector: &[Formula], dimension: usize) -> Result<(), BadInput> {
    if vector.len() != dimension {
        let texts: Vec<&str> = vector.iter().map(|formula| formula.0.as_str()).collect();
        return Err(BadInput::new(format!("{key} = [{}] has {} components", texts.join(", "), vector.len()))
            .key(key)
            .allowed(format!("{dimension} numbers or formulas, as region.size")));
    }
    for (d, formula) in vector.iter().enumerate() {
        formula.function(&format!("{key}[{d}]"), dimension)?;
    }
    Ok(())
}

impl Config {
    /// Whether anything in a scene of one's own is a wall.
    pub fn has_walls(&self) -> bool {
        self.region.periodic.contains(&false) || self.shapes.iter().any(|shape| shape.fill == Fill::Wall)
    }

    /// A scene of one's own: lengths of vectors, whole numbers of spacings, shapes, formulas.
    pub(super) fn check_custom(&self) -> Result<(), BadInput> {
        let (region, initial) = (&self.region, &self.initial);
        let bad = |key: &str, problem: String| BadInput::new(format!("{key} = {problem}")).key(key);
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
        if !initial.velocity.is_empty() {
            check_vector("initial.velocity", &initial.velocity, d)?;
        }
        if let Some(temperature) = &initial.temperature {
            temperature.function("initial.temperature", d)?;
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

    /// The numbers of all shapes.
    fn all_shape_numbers(&self) -> Vec<ShapeNumber> {
        self.shapes.iter().enumerate().flat_map(|(place, entry)| ShapeNumber::all(place, entry)).collect()
    }

    /// The numbers that `variables` names, in their order; those of a checked configuration.
    pub fn shape_numbers(&self) -> Vec<ShapeNumber> {
        let all = self.all_shape_numbers();
        let named = |variable: &VariableEntry| all.iter().find(|number| number.to_string() == variable.number).copied();
        self.variables.iter().filter_map(named).collect()
    }

    /// What an optimiser may change: numbers that there are, between limits that the shapes allow, and what it is judged by.
    pub(super) fn check_variables(&self) -> Result<(), BadInput> {
        let (dimension, has_heat) = (self.dimension(), self.initial.temperature.is_some());
        let numbers = self.all_shape_numbers();
        for (k, variable) in self.variables.iter().enumerate() {
            let VariableEntry { number, lower, upper } = variable;
            let bad = |name: &str, problem: String| {
                let key = format!("variables[{k}].{name}");
                BadInput::new(format!("{key} = {problem}")).key(key)
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
        if self.fluid.formulation == Formulation::Standard {
            return Err(BadInput::new("variables in the standard formulation, whose walls are cells of the lattice")
                .key("fluid.formulation")
                .allowed("consistent with them")
                .advice("fluid.formulation=consistent"));
        }
        if self.optimise.gradient == GradientMode::Steady {
            return Err(BadInput::new("optimise.gradient = steady with particles that move")
                .key("optimise.gradient")
                .allowed("differences, segments, taped, truncated")
                .advice("optimise.gradient=differences"));
        }
        let (objective, along) = (&self.objective, self.region.size[0]);
        if !has_heat && objective.kind != ObjectiveKind::FlowRate {
            return Err(BadInput::new("objective.kind is about heat, and the scene has none")
                .key("objective.kind")
                .allowed("flow-rate; the others with initial.temperature")
                .advice("objective.kind=flow-rate, or initial.temperature=1.0"));
        }
        if objective.target_x > along {
            return Err(BadInput::new(format!("objective.target_x = {} is outside the box", objective.target_x))
                .key("objective.target_x")
                .allowed(format!("0 ... {along}, region.size[0]")));
        }
        self.check_clip()?;
        self.check_store()
    }

    /// dx divides the box, which is large enough and not too large.
    fn check_cells(&self) -> Result<(), BadInput> {
        let (region, dx) = (&self.region, self.resolution.dx);
        let bad = |problem: String| BadInput::new(problem).key("resolution.dx");
        let particles: f64 = region.size.iter().map(|x| x / dx).product();
        if particles > super::validate::MAX_PARTICLES {
            return Err(bad(format!("resolution.dx = {dx} makes {particles:.1e} particles"))
                .allowed(format!("at most {:.0e} particles", super::validate::MAX_PARTICLES)));
        }
        let support = self.support();
        for (k, (size, periodic)) in region.size.iter().zip(&region.periodic).enumerate() {
            let key = format!("region.size[{k}]");
            let count = (size / dx).round();
            if !super::validate::is_whole(size / dx) {
                return Err(bad(format!("resolution.dx = {dx} does not divide {key} = {size}"))
                    .allowed("a whole number of spacings along each side")
                    .advice(format!("{key} = {}", count.max(1.0) * dx)));
            }
            // Periodic images: a particle may see each neighbour once only.
            let fewest = if *periodic { 2.0 * (support + self.time.skin) } else { 1.0 };
            if count < fewest {
                return Err(bad(format!("resolution.dx = {dx} is too coarse for {key} = {size}"))
                    .allowed(format!("at least {fewest:.1} spacings along a periodic side"))
                    .advice(format!("resolution.dx={}", size / fewest.ceil())));
            }
        }
        Ok(())
    }
}
