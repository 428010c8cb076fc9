//! Published flows around bodies, with fixed particles.

use super::found::{Curve, Found, Progress};
use crate::config::scene::Config;
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_flow::Around;
use crate::scene::around_shapes::AroundShapes;
use crate::scene::history::{History, Moment};
use crate::scene::periodic_box::PeriodicBox;
use crate::sph::cloud::figures::Figure;
use std::f64::consts::PI;

/// A flow whose figures are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Benchmark {
    /// Mean Nusselt number of a square cavity (de Vahl Davis 1983; Le Quere 1991).
    HeatedCavity,
    /// Cylinder in a channel (Schaefer and Turek 1996; John 2004 and Nabh 1998 have more digits).
    SchaeferTurek1,
    SchaeferTurek2,
    SchaeferTurek3,
    /// Drag of a sphere in a cubic array at a Reynolds number of 0 (Zick and Homsy 1982).
    SphereArray,
    /// Cylinder in an open stream at a Reynolds number of 100.
    VortexStreet,
    /// A flow in a periodic box without shapes, whose exact solution the configuration states.
    PeriodicBox,
}

/// A figure that was found, the known one, and how much the error of this one counts.
type Compared = (&'static str, f64, f64, f64);

/// Mean Nusselt numbers by Rayleigh number.
const NUSSELT: [(f64, f64); 4] = [(1e3, 1.1178), (1e4, 2.2448), (1e5, 4.5216), (1e6, 8.8252)];

/// The known mean Nusselt number of a heated cavity; not a number for an unknown Rayleigh number.
pub fn nusselt(config: &Config) -> f64 {
    let rayleigh = config.fluid.expansion / config.fluid.viscosity;
    let known = NUSSELT.iter().find(|(number, _)| (number / rayleigh - 1.0).abs() < 1e-3);
    known.map_or(f64::NAN, |(_, nusselt)| *nusselt)
}

/// What came of a benchmark.
pub struct Done {
    pub found: Found,
    pub particles: usize,
    pub steps: usize,
}

impl Benchmark {
    /// Runs a scene and compares its figures: the largest relative error.
    ///
    /// # Errors
    /// A flow that is not found.
    pub fn take(self, config: &Config, progress: Progress) -> anyhow::Result<Done> {
        if self == Self::PeriodicBox {
            return periodic_box(config, progress);
        }
        if self == Self::SphereArray {
            return sphere_array(config);
        }
        let mut around = AroundShapes::new(config)?;
        let particles = around.flow.cloud.particles();
        if config.unsteady().is_none() {
            let solution = around.solve(&around.first())?;
            let steps = around.flow.solver.counts.steps;
            let value = |figure: Figure| around.value(&solution, figure);
            let compared: Vec<Compared> = match self {
                Self::HeatedCavity => {
                    vec![("Nusselt number", value(Figure::Heat { shape: 0 }), nusselt(config), 1.0)]
                }
                _ => {
                    let force = |along: usize| value(Figure::Force { shape: 0, along }) / 0.002;
                    let pressures = around.objective(&solution).0;
                    // The lift is two hundredths of the drag.
                    vec![
                        ("drag", force(0), 5.579_535, 1.0),
                        ("lift", force(1), 0.010_618_9, 1.0 / 3.0),
                        ("pressures", pressures, 0.117_520, 1.0),
                    ]
                }
            };
            return Ok(Done { found: found(&compared, vec![]), particles, steps });
        }
        let end = config.time.end;
        let (history, _) = around.march(&around.first(), None, &mut |moment, _| {
            progress(moment.time / end);
            Ok(())
        })?;
        let window = around.window(&around.first(), &history)?;
        let from = window.from;
        let of = |name: &str| {
            let k = history.figures.iter().position(|(own, _)| own == name).unwrap_or(0);
            history.of(&window, k)
        };
        let (drag, lift) = (of("shapes[0].drag"), of("shapes[0].lift"));
        let frequency = lift.frequency.unwrap_or(f64::NAN);
        let compared: Vec<Compared> = match self {
            Self::VortexStreet => vec![
                ("Strouhal number", frequency, 0.165, 1.0),
                ("mean drag", drag.mean / 0.5, 1.34, 1.0),
                ("lift", 0.5 * (lift.most - lift.least) / 0.5, 0.33, 1.0),
            ],
            Self::SchaeferTurek2 => vec![
                ("drag", drag.most / 0.05, 3.23, 1.0),
                ("lift", lift.most / 0.05, 1.0, 1.0),
                ("Strouhal number", 0.1 * frequency, 0.30, 1.0),
                ("pressures", pressures_after(&history, from, 0.5 / frequency), 2.48, 1.0),
            ],
            _ => vec![
                ("drag", drag.most / 0.05, 2.950_922, 1.0),
                ("lift", lift.most / 0.05, 0.477_95, 1.0),
                ("pressures", history.moments.last().map_or(f64::NAN, |last| last.objective), -0.1116, 1.0),
            ],
        };
        let lift_of = |moment: &Moment| (moment.time, moment.values[1]);
        let line = history.moments.iter().filter(|moment| moment.time > 0.02 * end).map(lift_of).collect();
        let curves = vec![Curve { name: "lift".into(), points: line }];
        Ok(Done { found: found(&compared, curves), particles, steps: history.sizes.len() })
    }
}

/// The error of the velocity at the end.
fn periodic_box(config: &Config, progress: Progress) -> anyhow::Result<Done> {
    let own_box = PeriodicBox::new(config)?;
    let gone = own_box.run(0, &mut |moment, _| {
        progress(moment.time / config.time.end);
        Ok(())
    })?;
    let (particles, steps) = (own_box.particles(), gone.sizes.len());
    let fields = own_box.particle_fields(config.time.end, steps, &gone.last);
    let error = own_box.errors(&fields)?.0.unwrap_or(f64::NAN);
    Ok(Done { found: Found { error, curves: vec![] }, particles, steps })
}

/// The drag of a sphere in that of one alone, whose known value belongs to spheres that fill an eighth of space.
fn sphere_array(config: &Config) -> anyhow::Result<Done> {
    let mut around = AroundBodies::new(config)?;
    let solution = around.solve(&around.first())?;
    let rate = around.objective(&solution).0;
    let radius = config.shapes.first().and_then(|sphere| sphere.radius).unwrap_or(f64::NAN);
    let drag = 1.0 / (6.0 * PI * config.kinematic_viscosity() * radius * rate);
    let (particles, steps) = (around.flow.cloud.particles(), around.flow.solver.counts.steps);
    Ok(Done { found: found(&[("drag", drag, 4.292, 1.0)], vec![]), particles, steps })
}

/// The objective some time after the first largest lift of a window.
fn pressures_after(history: &History, from: f64, later: f64) -> f64 {
    let window = history.moments.iter().filter(|moment| moment.time >= from && moment.time < from + 2.1 * later);
    let peak = window.max_by(|a, b| a.values[1].total_cmp(&b.values[1])).map_or(f64::NAN, |moment| moment.time);
    let after = history.moments.windows(2).find(|pair| pair[1].time >= peak + later);
    after.map_or(f64::NAN, |pair| {
        let share = (peak + later - pair[0].time) / (pair[1].time - pair[0].time);
        pair[0].objective + share * (pair[1].objective - pair[0].objective)
    })
}

fn found(compared: &[Compared], curves: Vec<Curve>) -> Found {
    for (name, found, known, _) in compared {
        log::info!("{name}: {found:.6}, known {known}");
    }
    let errors = compared.iter().map(|(_, found, known, counts)| counts * (found / known - 1.0).abs());
    // A figure that is not a number must not be lost among others.
    let error = errors.fold(0.0, |most: f64, error| if error.is_nan() { error } else { most.max(error) });
    Found { error, curves }
}
