//! What makes the numbers of a finished run doubtful, said beside them.
//!
//! Nothing here stops a run. Everything is read from what the run has measured anyway, so it costs nothing.

use super::figures::FlowFigures;
use crate::config::scene::Config;
use crate::design::diagnostics::Diagnostics;
use serde::Serialize;

/// What is doubtful, and what to try.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Warning {
    pub problem: String,
    pub advice: String,
}

/// A flow may be this much faster than its reference velocity: the sound speed allows for it.
const FASTER: f64 = 1.5;
/// Above this Mach number a flow is not weakly compressible any more: densities change by its square.
const MACH: f64 = 0.3;
/// A mean density may be so far from the reference.
const DENSER: f64 = 0.02;
/// A heat balance may be so far open, of the walls' heat.
const OPEN: f64 = 0.05;
/// What is averaged may change so much over the window, of itself.
const DRIFT: f64 = 0.01;

fn warning(problem: String, advice: impl Into<String>) -> Warning {
    Warning { problem, advice: advice.into() }
}

/// A flow that is faster than was said.
fn speed(config: &Config, fastest: f64) -> Option<Warning> {
    let (reference, sound) = (config.fluid.reference_velocity, config.sound_speed());
    let mach = fastest / sound;
    let advice = format!("fluid.reference_velocity={fastest:.3}, which makes the sound speed follow");
    if mach > MACH {
        let problem = format!("the flow reaches Mach {mach:.2} ({fastest:.4} of a sound speed of {sound:.4}): it is not weakly compressible");
        return Some(warning(problem, advice));
    }
    (fastest > FASTER * reference).then(|| {
        let problem = format!(
            "the flow is {:.1} times as fast as fluid.reference_velocity = {reference}: Mach {mach:.2}",
            fastest / reference
        );
        warning(problem, advice)
    })
}

/// Of a verification flow or a scene of one's own: its largest velocity by the history's rows (time, energy, velocity) too.
pub fn of_flow(config: &Config, found: &FlowFigures, history: &[Vec<f64>]) -> Vec<Warning> {
    if found.wall_flux.is_some() {
        return Vec::new();
    }
    let fastest = history.iter().filter_map(|row| row.get(2)).fold(found.largest_velocity, |most, u| most.max(*u));
    speed(config, fastest).into_iter().collect()
}

/// Of a channel: its averages over the window, and the history's rows (time, Q).
pub fn of_channel(config: &Config, found: &Diagnostics, history: &[Vec<f64>]) -> Vec<Warning> {
    let mut all: Vec<Warning> = speed(config, found.u_max).into_iter().collect();
    let density = found.mean_density / config.fluid.density - 1.0;
    if density.abs() > DENSER {
        let problem = format!("the mean density is {:+.1} % off fluid.density", 100.0 * density);
        all.push(warning(
            problem,
            "a larger fluid.sound_speed_factor, or wall.mass=column-area in the standard formulation",
        ));
    }
    if found.energy_imbalance.abs() > OPEN {
        let problem = format!(
            "the heat balance is {:+.0} % open: walls give {:.4}, {:.4} flows out, {:+.4} is stored",
            100.0 * found.energy_imbalance,
            found.wall_heat_flux,
            found.q,
            found.stored_heat_rate
        );
        all.push(warning(problem, format!("time.end={:.3}, or a smaller resolution.dx", 2.0 * config.duration())));
    }
    all.extend(drift(config, history));
    all
}

/// Q that still changes: its means over both halves of the window.
fn drift(config: &Config, history: &[Vec<f64>]) -> Option<Warning> {
    let (end, window) = (history.last()?[0], config.objective.window);
    let inside: Vec<f64> = history.iter().filter(|row| row[0] > end - window).map(|row| row[1]).collect();
    let half = inside.len() / 2;
    if half < 2 {
        return None;
    }
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    let change = mean(&inside[half..]) / mean(&inside[..half]) - 1.0;
    (change.abs() > DRIFT).then(|| {
        let problem = format!(
            "Q is not steady: it changes by {:+.1} % from the first half of its window to the second",
            100.0 * change
        );
        warning(problem, format!("time.end={:.3}, or time.start=developed", 2.0 * config.duration()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quiet(config: &Config) -> Diagnostics {
        Diagnostics {
            q: 0.0235,
            wall_heat_flux: 0.0235,
            mean_density: config.fluid.density,
            u_max: config.fluid.reference_velocity,
            ..Diagnostics::default()
        }
    }

    #[test]
    fn a_run_that_can_be_trusted_gets_no_warning() {
        let config = Config::default();
        let history: Vec<Vec<f64>> = (0..100).map(|k| vec![0.02 * k as f64, 0.0235]).collect();
        assert_eq!(of_channel(&config, &quiet(&config), &history), []);
    }

    #[test]
    fn each_doubt_has_its_warning() {
        let config = Config::default();
        let (reference, sound) = (config.fluid.reference_velocity, config.sound_speed());
        let of = |change: &dyn Fn(&mut Diagnostics)| {
            let mut found = quiet(&config);
            change(&mut found);
            of_channel(&config, &found, &[])
        };
        for (found, part) in [
            (of(&|found| found.u_max = 2.0 * reference), "2.0 times as fast as fluid.reference_velocity"),
            (of(&|found| found.u_max = 0.4 * sound), "Mach 0.40"),
            (of(&|found| found.mean_density *= 1.19), "+19.0 %"),
            (of(&|found| found.energy_imbalance = 3.55), "+355 % open"),
        ] {
            assert_eq!(found.len(), 1, "{found:?}");
            assert!(found[0].problem.contains(part) && !found[0].advice.is_empty(), "{found:?}");
        }
        // Q that falls by 4 % within the window, and one that swings about a mean.
        let end = 4.0;
        let history = |q: &dyn Fn(f64) -> f64| -> Vec<Vec<f64>> {
            (0..=400).map(|k| 0.01 * k as f64).map(|t| vec![t, q(t)]).collect()
        };
        let window = config.objective.window;
        let falling =
            of_channel(&config, &quiet(&config), &history(&|t| 0.0235 * (1.0 - 0.04 * (t - end + window) / window)));
        assert!(falling.len() == 1 && falling[0].problem.contains("not steady: it changes by -2.0 %"), "{falling:?}");
        let swinging = of_channel(&config, &quiet(&config), &history(&|t| 0.0235 * (1.0 + 0.02 * (40.0 * t).sin())));
        assert_eq!(swinging, []);
    }
}
