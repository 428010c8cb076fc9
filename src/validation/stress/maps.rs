//! The table of maps: what is varied, of which scene.

use crate::config::scene::Precision;

/// A value of an axis: what it is called, and what it sets.
#[derive(Debug, Clone, PartialEq)]
pub struct Value {
    pub label: String,
    pub settings: Vec<String>,
    /// Whether the quick run has it.
    pub is_quick: bool,
}

/// What is varied, from harmless to wild.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    pub name: &'static str,
    pub values: Vec<Value>,
    /// Which of them is the scene's own, or nearest to it.
    pub usual: usize,
}

/// Two things that are varied, in every formulation that the scene has and in both precisions.
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    pub scene: &'static str,
    pub name: &'static str,
    pub formulations: &'static [&'static str],
    /// What every run sets, and what the quick ones set besides.
    pub settings: &'static [&'static str],
    pub quick_settings: &'static [&'static str],
    pub x: Axis,
    pub y: Axis,
}

/// One formulation in one precision of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Panel {
    pub formulation: &'static str,
    pub precision: Precision,
}

impl Map {
    /// Unique, and a file's name.
    pub fn id(&self) -> String {
        format!("{}-{}", self.scene, self.name)
    }

    /// Formulation by formulation, f32 beside f64.
    pub fn panels(&self) -> Vec<Panel> {
        let both = |&formulation: &&'static str| {
            [Precision::F64, Precision::F32].map(|precision| Panel { formulation, precision })
        };
        self.formulations.iter().flat_map(both).collect()
    }
}

/// An axis of one key: its values, and the place of the usual one; the quick run has those at `quick`.
fn axis(name: &'static str, key: &str, values: &[&str], usual: usize, quick: &[usize]) -> Axis {
    let value = |(k, value): (usize, &&str)| Value {
        label: value.to_string(),
        settings: vec![format!("{key}={value}")],
        is_quick: quick.contains(&k),
    };
    Axis { name, values: values.iter().enumerate().map(value).collect(), usual }
}

/// An axis whose values set several keys.
fn axis_of(name: &'static str, values: &[(&str, &[&str], bool)], usual: usize) -> Axis {
    let value = |&(label, settings, is_quick): &(&str, &[&str], bool)| Value {
        label: label.into(),
        settings: settings.iter().map(|setting| setting.to_string()).collect(),
        is_quick,
    };
    Axis { name, values: values.iter().map(value).collect(), usual }
}

fn courant() -> Axis {
    axis("CFL", "time.cfl", &["0.5", "1", "1.25", "1.5", "1.75", "2", "2.5", "3"], 1, &[1, 3, 5, 7])
}

fn jitter() -> Axis {
    axis("jitter", "time.jitter", &["0", "0.05", "0.1", "0.2", "0.3"], 1, &[1, 4])
}

/// CFL numbers beside something else than noise.
fn few_courant() -> Axis {
    axis("CFL", "time.cfl", &["0.5", "1", "1.5", "2"], 1, &[1, 3])
}

const BOTH: &[&str] = &["consistent", "standard"];
const CONSISTENT: &[&str] = &["consistent"];
const CHANNEL: &[&str] = &["time.end=1.5"];
/// The plane channel keeps its speed, 1.15, with any viscosity: the cell Reynolds number is 1.15 dx / viscosity.
const VISCOSITIES: [(&str, &[&str], bool); 5] = [
    ("0.23", &["fluid.viscosity=0.1", "fluid.body_force=23.0"], false),
    ("2.3", &["fluid.viscosity=0.01", "fluid.body_force=2.3"], true),
    ("23", &["fluid.viscosity=0.001", "fluid.body_force=0.23"], false),
    ("115", &["fluid.viscosity=0.0002", "fluid.body_force=0.046"], false),
    ("1150", &["fluid.viscosity=0.00002", "fluid.body_force=0.0046"], true),
];
const SHAPES: [(&str, &[&str], bool); 3] = [
    ("sine, one period", &["design.shape=sine"], true),
    ("sine, three periods", &["design.shape=sine", "design.periods=3"], false),
    ("random nodes", &["design.shape=random"], true),
];

fn heated_channel() -> Vec<Map> {
    let (scene, formulations, quick_settings) = ("heated-channel", BOTH, CHANNEL);
    let map = |name, settings, x, y| Map { scene, name, formulations, settings, quick_settings, x, y };
    let amplitude = |values: &[&str]| axis("amplitude", "design.amplitude", values, 0, &[0, 2]);
    vec![
        map("step", &[], courant(), jitter()),
        map("wall", &[], amplitude(&["0.0025", "0.005", "0.01", "0.015", "0.02"]), axis_of("shape", &SHAPES, 0)),
        map(
            "resolution",
            &["design.bound=0.04", "design.shape=sine"],
            axis("dx", "resolution.dx", &["0.025", "0.02", "0.0125", "0.01"], 1, &[0, 1]),
            amplitude(&["0", "0.01", "0.02", "0.03", "0.04"]),
        ),
        map("viscosity", &[], few_courant(), axis_of("cell Reynolds number", &VISCOSITIES, 1)),
        map(
            "heat",
            &[],
            axis("hot temperature", "wall.hot_temperature", &["1.05", "1.23", "2", "5"], 1, &[1, 3]),
            axis("conductivity", "fluid.conductivity", &["7.313", "0.7313", "0.07313"], 0, &[0, 2]),
        ),
    ]
}

/// The heated channel with particles that do not move, with which walls are searched.
fn fixed_particles() -> Vec<Map> {
    let (scene, formulations, quick_settings) = ("heated-channel", CONSISTENT, CHANNEL);
    let map = |name, settings, x, y| Map { scene, name, formulations, settings, quick_settings, x, y };
    let amplitude = axis("amplitude", "design.amplitude", &["0", "0.01", "0.02", "0.03", "0.04"], 1, &[1, 4]);
    vec![
        map("fixed-step", &["method.name=fixed", "design.bound=0.04", "design.shape=sine"], courant(), amplitude),
        map(
            "fixed-wall",
            &["method.name=fixed"],
            axis("amplitude", "design.amplitude", &["0.005", "0.01", "0.015", "0.02"], 1, &[1, 3]),
            axis_of("shape", &SHAPES, 0),
        ),
    ]
}

/// In three dimensions: vortices, and the channel with a wall over x and z.
fn three_dimensions() -> Vec<Map> {
    let vortices = Map {
        scene: "taylor-green-3d",
        name: "step",
        formulations: BOTH,
        // 15 particles a side.
        settings: &["resolution.dx=0.41887902047863906", "time.end=3"],
        quick_settings: &["resolution.dx=0.6283185307179586", "time.end=1"],
        x: courant(),
        y: jitter(),
    };
    let channel = Map {
        scene: "heated-channel-3d",
        name: "step",
        formulations: CONSISTENT,
        settings: &["design.shape=random"],
        quick_settings: &["time.end=0.5", "objective.window=0.1"],
        x: courant(),
        y: axis("amplitude", "design.amplitude", &["0", "0.005", "0.01", "0.02"], 1, &[1, 3]),
    };
    vec![vortices, channel]
}

/// What periodic vortices and the cavity have in common.
fn flow(scene: &'static str, settings: &'static [&'static str], quick: &'static [&'static str]) -> Vec<Map> {
    let map = |name, x, y| Map { scene, name, formulations: BOTH, settings, quick_settings: quick, x, y };
    vec![
        map("step", courant(), jitter()),
        map("resolution", few_courant(), axis("dx", "resolution.dx", &["0.05", "0.04", "0.025", "0.02"], 1, &[0, 1])),
        map(
            "viscosity",
            few_courant(),
            axis("Reynolds number", "flow.reynolds", &["10", "100", "1000", "10000"], 1, &[1, 3]),
        ),
    ]
}

fn dam_break() -> Vec<Map> {
    let map = |name, x, y| Map {
        scene: "dam-break",
        name,
        formulations: &["standard"],
        settings: &["tank.length=5.4", "resolution.dx=0.05", "time.end=4"],
        quick_settings: &["resolution.dx=0.1", "time.end=2"],
        x,
        y,
    };
    let few_courant = || axis("CFL", "time.cfl", &["0.25", "0.5", "1", "1.5"], 0, &[0, 2]);
    let velocities = ["2", "1.4142135623730951", "0.7", "0.3"];
    let divided = [
        ("divided", &["time.adaptive=true", "time.cfl=1"] as &[&str], true),
        ("whole", &["time.adaptive=false", "time.cfl=1"], true),
    ];
    vec![
        map(
            "step",
            axis("CFL", "time.cfl", &["0.25", "0.5", "0.75", "1", "1.25", "1.5", "2", "3"], 0, &[0, 1, 3, 7]),
            jitter(),
        ),
        map("resolution", few_courant(), axis("dx", "resolution.dx", &["0.1", "0.05", "0.04"], 1, &[0, 1])),
        map(
            "viscosity",
            few_courant(),
            axis("artificial viscosity", "method.artificial_viscosity", &["0.5", "0.1", "0.02", "0.005"], 1, &[1, 3]),
        ),
        map(
            "speed",
            axis("reference velocity", "fluid.reference_velocity", &velocities, 1, &[1, 3]),
            axis_of("steps", &divided, 0),
        ),
    ]
}

/// Every map.
pub fn all() -> Vec<Map> {
    let mut maps = heated_channel();
    maps.extend(fixed_particles());
    // The dx axis comes behind these settings and wins over them.
    maps.extend(flow("taylor-green", &["resolution.dx=0.025"], &["resolution.dx=0.05", "time.end=0.5"]));
    maps.extend(flow(
        "lid-driven-cavity",
        &["resolution.dx=0.04", "time.end=4"],
        &["resolution.dx=0.05", "time.end=1"],
    ));
    maps.extend(dam_break());
    maps.extend(three_dimensions());
    maps
}
