//! Custom scenes: a box, the shapes in it, and the initial fields.

use crate::config::formula::{Formula, Function, ReadFormula};
use crate::config::range::Range::NotNegative;
use crate::config::section::section;
use crate::config::suggest;
use crate::error::BadInput;
use serde::{Deserialize, Serialize};

section! {
    "region.": Region {
        size: Vec<f64> = vec![1.0, 0.4];
        periodic: Vec<bool> = vec![true, false];
        acceleration: Vec<f64> = vec![0.0, 0.0];
        #[serde(skip_serializing_if = "Option::is_none")]
        inlet_until: Option<f64> = None, NotNegative;
        #[serde(skip_serializing_if = "Option::is_none")]
        outlet_from: Option<f64> = None, NotNegative;
        #[serde(skip_serializing_if = "Sides::is_empty")]
        sides: Sides = Sides::default();
    }
}

/// The conditions on the sides of the box, for fixed particles.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sides {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left: Option<Side>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub right: Option<Side>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bottom: Option<Side>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub top: Option<Side>,
    /// Those at the lower and upper end of z.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub back: Option<Side>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub front: Option<Side>,
}

/// The condition on a side of the box.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Side {
    pub kind: SideKind,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<Vec<Formula>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature: Option<Formula>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heat_flux: Option<Formula>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SideKind {
    /// A wall, at rest unless it has a velocity; adiabatic unless it has a temperature or a heat flux.
    #[default]
    Wall,
    /// The velocity (and temperature) of what enters.
    Inflow,
    /// Where the fluid leaves: pressure 0, no change across the side.
    Outflow,
    /// No flow through the side, and no change across it.
    Symmetry,
    Periodic,
}

impl Sides {
    pub fn is_empty(&self) -> bool {
        self.all().iter().all(|(_, side)| side.is_none())
    }

    /// The sides in the order low x, high x, low y, high y, low z, high z, with their names.
    pub fn all(&self) -> [(&'static str, Option<&Side>); 6] {
        [
            ("left", self.left.as_ref()),
            ("right", self.right.as_ref()),
            ("bottom", self.bottom.as_ref()),
            ("top", self.top.as_ref()),
            ("back", self.back.as_ref()),
            ("front", self.front.as_ref()),
        ]
    }
}

/// Formulas of the fluid's fields: what it begins with (`[initial]`), and the exact solution, if there is one (`[exact]`).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Fields {
    /// Components of the velocity. None: at rest at the start; unknown in the exact solution.
    pub velocity: Vec<Formula>,
    /// None at the start: the scene has no heat; none in the exact solution: unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature: Option<Formula>,
    /// At the start: a file with the velocity of each particle of a periodic box instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
}

/// A region and what fills it. Of overlapping shapes the last one counts.
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
    /// Where a cylinder, or another shape that goes along all of z, begins and ends along its axis. None: it goes through the whole box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ends: Option<Vec<f64>>,
    /// Semi-axes of an ellipse.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axes: Option<Vec<f64>>,
    /// Degrees, counter-clockwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radii: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chord: Option<f64>,
    /// The four digits of a NACA section.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub digits: Option<String>,
    /// A CSV file with the points of a closed line; a loaded scene has the points themselves. Or an STL file with a closed surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<Vec<[f64; 2]>>,
    /// Factor of the lengths of an STL file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thickness: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub positive: Option<Formula>,
    /// p0, p1, ... in the formulas of velocity, temperature and heat flux.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub parameters: Vec<f64>,
    /// Velocity of a wall's surface; none: at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<Vec<Formula>>,
    /// Temperature of a wall; none: adiabatic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature: Option<Formula>,
    /// Heat that a wall gives to the fluid, per time and area.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heat_flux: Option<Formula>,
}

/// A number of a shape that an optimiser may change, and its limits.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VariableEntry {
    /// Key of the number, such as `shapes[0].centre[1]`.
    pub number: String,
    pub lower: f64,
    pub upper: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShapeNumber {
    pub shape: usize,
    pub part: Part,
}

/// Identifies a number within a shape: for vectors by component, for points by point and component.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    Lower(usize),
    Upper(usize),
    Centre(usize),
    Radius,
    /// Where it begins (0) and ends (1) along its axis.
    End(usize),
    /// Semi-axis of an ellipse.
    Axis(usize),
    /// Radius of a spline.
    Radii(usize),
    Point(usize, usize),
    Thickness,
    Scale,
    Chord,
    Angle,
    /// Of the formulas on its wall.
    Parameter(usize),
}

impl ShapeNumber {
    /// The numbers of shape number `shape`.
    pub fn all(shape: usize, entry: &ShapeEntry) -> Vec<Self> {
        let vector = |vector: &Option<Vec<f64>>| 0..vector.as_ref().map_or(0, Vec::len);
        let points = 0..entry.points.as_ref().map_or(0, Vec::len);
        let parts = vector(&entry.lower).map(Part::Lower);
        let parts = parts.chain(vector(&entry.upper).map(Part::Upper)).chain(vector(&entry.centre).map(Part::Centre));
        let parts = parts.chain(entry.radius.map(|_| Part::Radius)).chain(vector(&entry.ends).map(Part::End));
        let parts = parts.chain(vector(&entry.axes).map(Part::Axis)).chain(vector(&entry.radii).map(Part::Radii));
        let parts = parts.chain(points.flat_map(|point| [Part::Point(point, 0), Part::Point(point, 1)]));
        let parts = parts.chain(entry.thickness.map(|_| Part::Thickness)).chain(entry.chord.map(|_| Part::Chord));
        let parts = parts.chain(entry.scale.map(|_| Part::Scale)).chain(entry.angle.map(|_| Part::Angle));
        parts.chain((0..entry.parameters.len()).map(Part::Parameter)).map(|part| Self { shape, part }).collect()
    }

    pub fn of<'a>(&self, shapes: &'a mut [ShapeEntry]) -> Option<&'a mut f64> {
        let entry = shapes.get_mut(self.shape)?;
        match self.part {
            Part::Lower(d) => entry.lower.as_mut()?.get_mut(d),
            Part::Upper(d) => entry.upper.as_mut()?.get_mut(d),
            Part::Centre(d) => entry.centre.as_mut()?.get_mut(d),
            Part::Radius => entry.radius.as_mut(),
            Part::End(k) => entry.ends.as_mut()?.get_mut(k),
            Part::Axis(k) => entry.axes.as_mut()?.get_mut(k),
            Part::Radii(k) => entry.radii.as_mut()?.get_mut(k),
            Part::Chord => entry.chord.as_mut(),
            Part::Scale => entry.scale.as_mut(),
            Part::Angle => entry.angle.as_mut(),
            Part::Point(point, d) => entry.points.as_mut()?.get_mut(point)?.get_mut(d),
            Part::Thickness => entry.thickness.as_mut(),
            Part::Parameter(k) => entry.parameters.get_mut(k),
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
            Part::End(k) => write!(out, "ends[{k}]"),
            Part::Axis(k) => write!(out, "axes[{k}]"),
            Part::Radii(k) => write!(out, "radii[{k}]"),
            Part::Chord => write!(out, "chord"),
            Part::Scale => write!(out, "scale"),
            Part::Angle => write!(out, "angle"),
            Part::Point(point, d) => write!(out, "points[{point}][{d}]"),
            Part::Thickness => write!(out, "thickness"),
            Part::Parameter(k) => write!(out, "parameters[{k}]"),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A box between two corners: `lower`, `upper`.
    #[default]
    Box,
    /// A disc, or a ball in three dimensions: `centre`, `radius`.
    Disc,
    /// A cylinder along `axis` through the whole box, or between two `ends`, in three dimensions: `centre`, `radius`.
    Cylinder,
    /// A line through `points` (x, y) of a `thickness`, along all of z.
    Polyline,
    /// The inside of the closed line through `points` (x, y), along all of z.
    Polygon,
    /// An ellipse: `centre`, semi-`axes`, `angle`.
    Ellipse,
    /// A closed curve around `centre` whose radius over the angle is the periodic cubic spline through `radii`, the first on
    /// the x axis, counter-clockwise.
    Spline,
    /// A closed uniform cubic B-spline with `points` as control points.
    BSpline,
    /// A NACA four-digit section: `digits`, `centre` (the middle of its chord), `chord`, `angle`.
    Naca,
    /// The closed line through the points of a CSV `file`, which becomes a polygon when it is loaded; or, in three dimensions, the
    /// inside of the triangles of an STL `file`, whose `centre` of volume is there, times `scale`, turned by `angle` around z.
    File,
    /// The region where the formula `positive` is above 0.
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
    /// Index of the direction: 0, 1, 2 for x, y, z.
    pub fn direction(self) -> usize {
        self as usize
    }
}

impl Kind {
    /// The name in a configuration, and the keys that a shape of this kind must have.
    /// Whether it is a smooth curve in the plane.
    pub fn is_curve(self) -> bool {
        matches!(self, Self::Ellipse | Self::Spline | Self::BSpline | Self::Naca)
    }

    /// Whether it goes along an axis in three dimensions, and may have ends.
    pub fn has_axis(self) -> bool {
        self.is_curve() || matches!(self, Self::Cylinder | Self::Polyline | Self::Polygon)
    }

    /// Its name in files.
    pub fn shown(self) -> &'static str {
        self.facts().0
    }

    fn facts(self) -> (&'static str, &'static [&'static str]) {
        match self {
            Self::Box => ("box", &["lower", "upper"]),
            Self::Disc => ("disc", &["centre", "radius"]),
            Self::Cylinder => ("cylinder", &["centre", "radius", "axis"]),
            Self::Polyline => ("polyline", &["points", "thickness"]),
            Self::Polygon => ("polygon", &["points"]),
            Self::Ellipse => ("ellipse", &["centre", "axes", "angle"]),
            Self::Spline => ("spline", &["centre", "radii"]),
            Self::BSpline => ("b-spline", &["points"]),
            Self::Naca => ("naca", &["centre", "digits", "chord", "angle"]),
            Self::File => ("file", &["file", "centre", "scale", "angle"]),
            Self::Where => ("where", &["positive"]),
        }
    }
}

impl ShapeEntry {
    /// Assignments that make shape number `place` at least as thick as `size`, without `shapes[place].` in front; none for
    /// shapes of a formula.
    pub fn at_least(&self, place: usize, size: f64) -> Option<String> {
        let short = |x: f64| suggest::at_least(x, size);
        match self.kind {
            Kind::Polyline => Some(format!("thickness={}", short(size))),
            Kind::Disc | Kind::Cylinder => Some(format!("radius={}", short(0.5 * size))),
            Kind::Box => {
                let (lower, upper) = (self.lower.as_deref()?, self.upper.as_deref()?);
                let wider = lower.iter().zip(upper).map(|(a, b)| short(b.max(a + size)).to_string());
                Some(format!("upper=[{}]", wider.collect::<Vec<String>>().join(",")))
            }
            // Its outline, drawn with a line of that thickness.
            Kind::Polygon => Some(format!("kind=polyline shapes[{place}].thickness={}", short(size))),
            Kind::Where | Kind::Ellipse | Kind::Spline | Kind::BSpline | Kind::Naca | Kind::File => None,
        }
    }

    fn check_parameters(&self, key: &str, function: &Function) -> Result<(), BadInput> {
        let (needed, given) = (function.parameters(), self.parameters.len());
        if needed > given {
            let problem = format!("{key} has p{}, and the shape {given} parameters", needed - 1);
            return Err(BadInput::at(key, problem).allowed("p0, p1, ... with parameters = [..] in the same shape"));
        }
        Ok(())
    }

    /// Checks shape number `place`; returns the first error.
    pub fn check(&self, place: usize, dimension: usize, has_heat: bool, read: ReadFormula) -> Result<(), BadInput> {
        let key = |name: &str| format!("shapes[{place}].{name}");
        let bad = |name: &str, problem: String| BadInput::at(key(name), format!("{}: {problem}", key(name)));
        let kind = self.kind;
        let (shown, keys) = kind.facts();
        let given = toml::Table::try_from(self).unwrap_or_default();
        let all = [
            "lower", "upper", "centre", "radius", "axis", "axes", "angle", "radii", "chord", "digits", "file",
            "points", "scale",
        ];
        for name in all.into_iter().chain(["thickness", "positive"]) {
            // An angle is 0 if it is not given.
            let wanted = keys.contains(&name);
            if name == "angle" && wanted {
                continue;
            }
            if wanted != given.contains_key(name) {
                let problem = if wanted { "is missing" } else { "has no meaning here" };
                return Err(bad(name, format!("{problem} (kind = {shown})"))
                    .allowed(format!("a {shown} has {}", keys.join(", "))));
            }
        }
        if kind == Kind::Cylinder && dimension == 2 {
            return Err(bad("kind", "a cylinder in two dimensions".into()).allowed("disc").advice("kind = \"disc\""));
        }
        if let Some(ends) = &self.ends {
            if dimension == 2 || !kind.has_axis() {
                let allowed = "in three dimensions, of cylinder, polyline, polygon, ellipse, spline, b-spline, naca";
                return Err(bad("ends", format!("has no meaning here (kind = {shown})")).allowed(allowed));
            }
            if ends.len() != 2 || ends.iter().any(|x| !x.is_finite()) || ends[0] >= ends[1] {
                let allowed = "two finite numbers, the second above the first";
                return Err(bad("ends", format!("{ends:?}")).allowed(allowed));
            }
        }
        let vectors = [("lower", &self.lower), ("upper", &self.upper), ("centre", &self.centre)];
        for (name, vector) in vectors {
            let Some(vector) = vector else { continue };
            // What goes along all of z has its centre in the plane.
            let length = if kind.is_curve() { 2 } else { dimension };
            if vector.len() != length || vector.iter().any(|x| !x.is_finite()) {
                return Err(bad(name, format!("{vector:?}")).allowed(format!("{length} finite numbers")));
            }
        }
        for (name, vector, least) in [("axes", &self.axes, 2), ("radii", &self.radii, 4)] {
            let Some(vector) = vector else { continue };
            let count = if name == "axes" { vector.len() == 2 } else { vector.len() >= least };
            if !count || vector.iter().any(|x| !(*x > 0.0 && x.is_finite())) {
                let allowed = if name == "axes" { "two lengths above 0" } else { "at least 4 lengths above 0" };
                return Err(bad(name, format!("{vector:?}")).allowed(allowed));
            }
        }
        if let Some(angle) = self.angle.filter(|angle| !angle.is_finite()) {
            return Err(bad("angle", format!("{angle}")).allowed("a finite number of degrees"));
        }
        if let Some(digits) = self.digits.as_ref().filter(|d| d.len() != 4 || !d.bytes().all(|d| d.is_ascii_digit())) {
            return Err(bad("digits", format!("\"{digits}\"")).allowed("four digits, such as \"2412\""));
        }
        for (name, length) in
            [("radius", self.radius), ("thickness", self.thickness), ("chord", self.chord), ("scale", self.scale)]
        {
            if let Some(length) = length.filter(|length| !(*length > 0.0 && length.is_finite())) {
                return Err(bad(name, format!("{length}")).allowed(if name == "scale" {
                    "a number above 0"
                } else {
                    "a length above 0"
                }));
            }
        }
        if let (Some(lower), Some(upper)) = (&self.lower, &self.upper) {
            if lower.iter().zip(upper).any(|(low, high)| low >= high) {
                return Err(bad("upper", format!("{upper:?} with lower = {lower:?}"))
                    .allowed("upper above lower in each direction"));
            }
        }
        let least = match kind {
            Kind::Polygon => 3,
            Kind::BSpline => 4,
            _ => 2,
        };
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
            for function in functions(&key("velocity"), velocity, dimension, read)? {
                self.check_parameters(&key("velocity"), &function)?;
            }
        }
        for (name, formula) in [("temperature", &self.temperature), ("heat_flux", &self.heat_flux)] {
            let Some(formula) = formula else { continue };
            if !is_wall {
                return Err(bad(name, "of fluid".into()).allowed("initial.temperature for the fluid's"));
            }
            if !has_heat {
                return Err(bad(name, "in a scene without heat".into())
                    .allowed("with initial.temperature, which gives the scene its heat")
                    .advice("initial.temperature=1.0"));
            }
            self.check_parameters(&key(name), &read(formula, &key(name), dimension)?)?;
        }
        if let Some(wrong) = self.parameters.iter().find(|x| !x.is_finite()) {
            return Err(bad("parameters", format!("{wrong}")).allowed("finite numbers"));
        }
        if self.temperature.is_some() && self.heat_flux.is_some() {
            return Err(bad("heat_flux", "beside a temperature".into()).allowed("one of both"));
        }
        Ok(())
    }
}

/// Reads the components of a vector with `read`, as many as there are dimensions.
pub fn functions(
    key: &str,
    vector: &[Formula],
    dimension: usize,
    read: ReadFormula,
) -> Result<Vec<Function>, BadInput> {
    if vector.len() != dimension {
        let texts: Vec<&str> = vector.iter().map(|formula| formula.0.as_str()).collect();
        let problem = format!("{key} = [{}] has {} components", texts.join(", "), vector.len());
        return Err(BadInput::at(key, problem).allowed(format!("{dimension} numbers or formulas, as region.size")));
    }
    let component = |(d, formula): (usize, &Formula)| read(formula, &format!("{key}[{d}]"), dimension);
    vector.iter().enumerate().map(component).collect()
}

impl Fields {
    /// Reads the formulas of an exact solution: of the velocity's components, and of the temperature.
    pub fn of_time(&self, dimension: usize) -> Result<(Vec<Function>, Option<Function>), BadInput> {
        self.read("exact", dimension, Formula::function_of_time)
    }

    /// Reads the formulas of the fields at the start.
    pub fn at_start(&self, dimension: usize) -> Result<(Vec<Function>, Option<Function>), BadInput> {
        self.read("initial", dimension, Formula::function)
    }

    fn read(
        &self,
        section: &str,
        dimension: usize,
        read: fn(&Formula, &str, usize) -> Result<Function, BadInput>,
    ) -> Result<(Vec<Function>, Option<Function>), BadInput> {
        let velocity = match &self.velocity[..] {
            [] => vec![],
            velocity => functions(&format!("{section}.velocity"), velocity, dimension, read)?,
        };
        let temperature = self.temperature.as_ref();
        let temperature = temperature.map(|formula| read(formula, &format!("{section}.temperature"), dimension));
        Ok((velocity, temperature.transpose()?))
    }
}
