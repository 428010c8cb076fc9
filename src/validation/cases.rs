//! The table of cases.

use super::Measure;

/// A scene with a known answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    pub name: &'static str,
    /// What the error is of, in words.
    pub quantity: &'static str,
    /// What it is compared with.
    pub reference: &'static str,
    pub scene: &'static str,
    /// What every run sets, `section.key=value`.
    pub settings: &'static [&'static str],
    pub measure: Measure,
    /// From coarse to fine.
    pub levels: Vec<Level>,
}

/// One resolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    pub settings: &'static [&'static str],
    /// Largest error in either precision.
    pub tolerance: f64,
    /// Whether the quick run has it.
    pub is_quick: bool,
}

fn quick(settings: &'static [&'static str], tolerance: f64) -> Level {
    Level { settings, tolerance, is_quick: true }
}

fn full(settings: &'static [&'static str], tolerance: f64) -> Level {
    Level { settings, tolerance, is_quick: false }
}

const PROFILE: &str = "velocity, L2 / centre line";
const FEM: &str = "finite elements";

/// Every case. Tolerances are what is asked of the method (50 a side: 0.0015 at half life, 0.0025 at t = 1), and at other
/// resolutions a quarter to a half above what was measured.
pub fn all() -> Vec<Case> {
    vec![
        Case {
            name: "taylor-green-half",
            quantity: "velocity at t = 0.44, relative L2",
            reference: "exact (Taylor and Green 1937)",
            scene: "taylor-green",
            settings: &["time.end=0.44"],
            measure: Measure::Velocity,
            levels: vec![
                quick(&["resolution.dx=0.03125"], 2.2e-3),
                quick(&["resolution.dx=0.02"], 1.5e-3),
                full(&["resolution.dx=0.01"], 1.2e-3),
            ],
        },
        Case {
            name: "taylor-green",
            quantity: "velocity at t = 1, relative L2",
            reference: "exact (Taylor and Green 1937)",
            scene: "taylor-green",
            settings: &["time.end=1"],
            measure: Measure::Velocity,
            levels: vec![
                quick(&["resolution.dx=0.03125"], 3.2e-3),
                quick(&["resolution.dx=0.02"], 2.5e-3),
                full(&["resolution.dx=0.01"], 1.8e-3),
            ],
        },
        Case {
            name: "taylor-green-lattice",
            quantity: "velocity at t = 1 from an exact lattice, relative L2",
            reference: "exact (Taylor and Green 1937)",
            scene: "taylor-green",
            settings: &["time.end=1", "time.jitter=0"],
            measure: Measure::Velocity,
            levels: vec![quick(&["resolution.dx=0.02"], 2.5e-3)],
        },
        Case {
            name: "taylor-green-order",
            quantity: "velocity at t = 1, sound speed as 1/dx, relative L2",
            reference: "exact (Taylor and Green 1937)",
            scene: "taylor-green",
            settings: &["time.end=1"],
            measure: Measure::Velocity,
            levels: vec![
                full(&["resolution.dx=0.04", "fluid.sound_speed_factor=10"], 6e-3),
                full(&["resolution.dx=0.02", "fluid.sound_speed_factor=20"], 2e-3),
                full(&["resolution.dx=0.01", "fluid.sound_speed_factor=40"], 5e-4),
            ],
        },
        Case {
            name: "taylor-green-3d",
            quantity: "kinetic energy to t = 5, relative",
            reference: "Fourier-Galerkin, 48 modes",
            scene: "taylor-green-3d",
            settings: &["time.end=5"],
            measure: Measure::KineticEnergy,
            levels: vec![
                quick(&["resolution.dx=0.39269908169872414"], 0.06),
                full(&["resolution.dx=0.19634954084936207"], 0.015),
            ],
        },
        Case {
            name: "poiseuille",
            quantity: PROFILE,
            reference: "series (Morris, Fox and Zhu 1997)",
            scene: "poiseuille",
            settings: &["time.end=0.00125"],
            measure: Measure::Profile,
            levels: vec![quick(&["resolution.dx=0.05"], 1e-3), quick(&["resolution.dx=0.03333333333333333"], 1e-3)],
        },
        Case {
            name: "couette",
            quantity: "velocity at t = 0.05, L2 / moving wall",
            reference: "series (Morris, Fox and Zhu 1997)",
            scene: "couette",
            settings: &["time.end=0.05"],
            measure: Measure::Profile,
            levels: vec![quick(&["resolution.dx=0.03333333333333333"], 1e-3)],
        },
        Case {
            name: "slab",
            quantity: "temperature at t = 0.1, L2 / walls' difference",
            reference: "series (Carslaw and Jaeger 1959)",
            scene: "slab",
            settings: &["time.end=0.1"],
            measure: Measure::Temperature,
            levels: vec![quick(&["resolution.dx=0.02"], 5e-4)],
        },
        Case {
            name: "slab-two-materials",
            quantity: "temperature at t = 0.1, conductivities 1 : 1000",
            reference: "series (Carslaw and Jaeger 1959)",
            scene: "slab",
            settings: &["time.end=0.1", "heat.conductivity_ratio=1000", "heat.capacity_ratio=1000"],
            measure: Measure::Temperature,
            levels: vec![quick(&["resolution.dx=0.02"], 5e-3)],
        },
        Case {
            name: "nusselt",
            quantity: "Nusselt number between two warm walls",
            reference: "exact, 7.54 (Shah and London 1978)",
            scene: "isothermal-channel",
            settings: &[],
            measure: Measure::Nusselt,
            levels: vec![full(&["resolution.dx=0.05"], 0.01)],
        },
        Case {
            name: "nusselt-one-wall",
            quantity: "Nusselt number, upper wall adiabatic",
            reference: "exact, 4.86 (Shah and London 1978)",
            scene: "isothermal-channel",
            settings: &["heat.upper_wall=adiabatic", "channel.length=7", "time.end=25"],
            measure: Measure::Nusselt,
            levels: vec![full(&["resolution.dx=0.05"], 0.01)],
        },
        Case {
            name: "reverse-poiseuille",
            quantity: PROFILE,
            reference: "series (Morris, Fox and Zhu 1997)",
            scene: "reverse-poiseuille",
            settings: &["time.end=1"],
            measure: Measure::Profile,
            levels: vec![quick(&["resolution.dx=0.05"], 5e-3), full(&["resolution.dx=0.025"], 2e-3)],
        },
        Case {
            name: "lid-driven-cavity",
            quantity: "extrema on the centre lines",
            reference: "finite differences, Re = 100",
            scene: "lid-driven-cavity",
            settings: &["time.end=20"],
            measure: Measure::CentreLines,
            levels: vec![
                quick(&["resolution.dx=0.04"], 0.03),
                full(&["resolution.dx=0.02"], 0.02),
                full(&["resolution.dx=0.01"], 0.015),
            ],
        },
        Case {
            name: "lid-driven-cavity-3d",
            quantity: "about the extrema on the centre lines",
            reference: "finite differences, Re = 100",
            scene: "lid-driven-cavity-3d",
            settings: &["time.end=12"],
            measure: Measure::CentreLines,
            levels: vec![full(&["resolution.dx=0.0625"], 0.06), full(&["resolution.dx=0.04"], 0.04)],
        },
        Case {
            name: "hydrostatic-pressure",
            quantity: "pressure at t = 10, largest error / bottom's",
            reference: "exact",
            scene: "hydrostatic-tank",
            settings: &["time.end=10"],
            measure: Measure::HydrostaticPressure,
            levels: vec![quick(&["resolution.dx=0.05"], 0.03), full(&["resolution.dx=0.025"], 0.03)],
        },
        Case {
            name: "hydrostatic-rest",
            quantity: "fastest particle to t = 10 / sqrt(g H)",
            reference: "exact",
            scene: "hydrostatic-tank",
            settings: &["time.end=10"],
            measure: Measure::Rest,
            levels: vec![quick(&["resolution.dx=0.05"], 1e-3), full(&["resolution.dx=0.025"], 1e-3)],
        },
        Case {
            // Water that is let go at once runs ahead of the experiment's, whose gate takes its time: finer ones further.
            name: "dam-break",
            quantity: "front to T = 5, mean relative error",
            reference: "Martin and Moyce (1952)",
            scene: "dam-break",
            settings: &[
                "water.length=1",
                "water.height=2",
                "tank.length=8",
                "tank.height=3",
                "time.end=3.6",
                "fluid.reference_velocity=2",
            ],
            measure: Measure::Front,
            levels: vec![
                quick(&["resolution.dx=0.1"], 0.1),
                full(&["resolution.dx=0.05"], 0.1),
                full(&["resolution.dx=0.025"], 0.1),
            ],
        },
        Case {
            name: "heated-channel",
            quantity: "outflowing heat, flat wall",
            reference: FEM,
            scene: "heated-channel",
            settings: &["time.end=3"],
            measure: Measure::Outflow,
            levels: vec![quick(&["resolution.dx=0.02"], 2e-3), full(&["resolution.dx=0.01"], 2e-3)],
        },
        Case {
            name: "heated-channel-shapes",
            quantity: "outflowing heat, four walls",
            reference: FEM,
            scene: "heated-channel",
            settings: &["time.end=3"],
            measure: Measure::Shapes,
            levels: vec![quick(&["resolution.dx=0.02"], 8e-3)],
        },
        Case {
            name: "heated-channel-gradient",
            quantity: "1 - cosine of dQ / d wall",
            reference: FEM,
            scene: "heated-channel",
            settings: &["time.end=3"],
            measure: Measure::Gradient,
            levels: vec![quick(&["resolution.dx=0.02"], 0.03), full(&["resolution.dx=0.01"], 0.01)],
        },
    ]
}
