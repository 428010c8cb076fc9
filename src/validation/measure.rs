//! What is compared with what is known.

use super::benchmark::{nusselt, Benchmark};
use super::found::{Curve, Found, Progress};
use super::{probe, reference};
use crate::adjoint::run::run;
use crate::config::layers::Setting;
use crate::config::scene::{Config, Kernels};
use crate::design::diagnostics::Measurement;
use crate::scene::load::Loaded;
use crate::scene::shape_heat::ShapeHeat;
use crate::scene::Scene;
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;
use anyhow::{anyhow, bail};

/// Samples of a steady flow, over the last quarter of its run.
const SAMPLES: usize = 50;
/// Places on a centre line.
const PLACES: usize = 127;

/// The quantity of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// Relative L2 error of the velocity at the end: (sum |u - u_exact|^2 / sum |u_exact|^2)^(1/2) over the particles.
    Velocity,
    /// Root mean square of the velocity's error at the end over [`crate::scene::Exact::amplitude`].
    Profile,
    /// Root mean square of the temperature's error at the end, over the walls' difference.
    Temperature,
    /// Relative error of the Nusselt number at the end.
    Nusselt,
    /// Largest relative error of the mean kinetic energy on the way.
    KineticEnergy,
    /// Largest relative error of the extrema of u on x = 1/2 and of v on y = 1/2 of the steady cavity; of a cubic one, on z = 1/2, that of the
    /// values of [`reference::CUBIC_CAVITY`].
    CentreLines,
    /// Relative error of the mean Nusselt number of the heated cavity with moving particles: the heat of its hot wall, over the last quarter of
    /// the run.
    CavityHeat,
    /// Relative error of the outflowing heat over a flat wall.
    Outflow,
    /// Largest relative error of the outflowing heat over four walls that are not flat.
    Shapes,
    /// Largest error of the pressure of still water at the end, over that at the bottom.
    HydrostaticPressure,
    /// Fastest particle of still water over the last quarter of the run, over (g H)^(1/2).
    Rest,
    /// Mean relative error of the front of a collapsing column of water at the experiment's times.
    Front,
    /// Largest relative error of published figures.
    Published(Benchmark),
    /// 1 - cosine between the gradient of the outflowing heat over a flat wall and that of finite elements, the two nodes at each
    /// end of the hot section summed: kernels smear its edge between them.
    Gradient,
}

/// Walls of [`Measure::Shapes`], by their names in the reference, with an amplitude of 0.02.
const SHAPES: [&str; 4] = ["up", "sin1", "cos2", "Wcen"];

impl Measure {
    /// Runs a scene and measures it.
    ///
    /// # Errors
    /// A run that does not get to its end.
    pub fn take<R: Sweeps>(self, loaded: &Loaded, scene: &Scene<R>, progress: Progress) -> anyhow::Result<Found> {
        match self {
            Self::Velocity | Self::Profile => self.velocity(scene, progress),
            Self::Temperature | Self::Nusselt => self.warmth(scene, progress),
            Self::KineticEnergy => kinetic_energy(scene, progress),
            Self::CentreLines => centre_lines(scene, progress),
            Self::CavityHeat => cavity_heat(&loaded.config, scene, progress),
            Self::Outflow => {
                let exact = reference::heated_channel_outflow("flat", 0.0);
                let exact = exact.ok_or_else(|| anyhow!("the reference has no flat wall"))?;
                Ok(Found { error: (outflow(scene, progress)? / exact - 1.0).abs(), curves: vec![] })
            }
            Self::HydrostaticPressure | Self::Rest => self.still_water(&loaded.config, scene, progress),
            Self::Front => front(&loaded.config, scene, progress),
            Self::Shapes => shapes::<R>(loaded, progress),
            Self::Gradient => gradient::<R>(loaded, progress),
            Self::Published(benchmark) => Ok(benchmark.take(&loaded.config, progress)?.found),
        }
    }

    /// What the curves' axes are.
    pub fn axes(self) -> (&'static str, &'static str) {
        match self {
            Self::Velocity | Self::Profile => ("y", "velocity"),
            Self::Temperature => ("y", "temperature"),
            Self::Nusselt => ("x", "Nusselt number"),
            Self::KineticEnergy => ("time", "mean kinetic energy"),
            Self::CentreLines => ("place on the line", "velocity"),
            Self::CavityHeat => ("time", "Nusselt number"),
            Self::HydrostaticPressure => ("pressure / (density g H)", "y / H"),
            Self::Rest => ("time", "fastest particle / (g H)^(1/2)"),
            Self::Front => ("t (2 g / a)^(1/2)", "front / a"),
            Self::Outflow | Self::Shapes => ("wall", "outflowing heat Q"),
            Self::Gradient => ("x", "1000 dQ / d offset"),
            Self::Published(_) => ("time", "lift"),
        }
    }

    fn warmth<R: Sweeps>(self, scene: &Scene<R>, progress: Progress) -> anyhow::Result<Found> {
        let solver = watched(scene, progress, &mut |_| ())?;
        let found = scene.figures(&solver.state, scene.steps as f64 * scene.model.dt);
        let error = match self {
            Self::Temperature => found.temperature_error,
            _ => found.nusselt.zip(found.exact_nusselt).map(|(found, exact)| (found / exact - 1.0).abs()),
        };
        let error = error.ok_or_else(|| anyhow::anyhow!("scene {} has no such answer", scene.name))?;
        Ok(Found { error, curves: vec![] })
    }

    fn velocity<R: Sweeps>(self, scene: &Scene<R>, progress: Progress) -> anyhow::Result<Found> {
        let solver = watched(scene, progress, &mut |_| ())?;
        let time = solver.step as f64 * scene.model.dt;
        let figures = scene.figures(&solver.state, time);
        let amplitude = scene.exact.amplitude(time);
        let (Some(error), Some(amplitude), Some(energy)) =
            (figures.velocity_error, amplitude, figures.exact_kinetic_energy)
        else {
            bail!("the flow has no exact solution");
        };
        let fluid = (0..scene.model.particles()).filter(|&i| scene.model.is_fluid(i)).count() as f64;
        let mean_square = 2.0 * energy / (scene.model.mass * fluid);
        let error = match self {
            Self::Velocity => error * amplitude / mean_square.sqrt(),
            _ => error,
        };
        let Some(height) = scene.exact.profile_height() else { return Ok(Found { error, curves: vec![] }) };
        let (n, l) = (scene.model.particles(), scene.model.rows);
        let mut points: Vec<(f64, f64)> = (0..n)
            .filter(|&i| scene.model.is_fluid(i))
            .map(|i| (solver.state[n + i].f64(), solver.state[l.velocity() * n + i].f64()))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let exact = (0..=200)
            .map(|k| height * k as f64 / 200.0)
            .filter_map(|y| Some((y, scene.exact.velocity([0.0, y, 0.0], time)?[0])));
        Ok(Found::beside(error, points, "exact", exact.collect()))
    }

    fn still_water<R: Sweeps>(self, config: &Config, scene: &Scene<R>, progress: Progress) -> anyhow::Result<Found> {
        let (height, gravity, density) = (config.water.height, -config.fluid.gravity[1], config.fluid.density);
        let (n, l) = (scene.model.particles(), scene.model.rows);
        let fluid: Vec<usize> = (0..n).filter(|&i| scene.model.is_fluid(i)).collect();
        let mut speeds = Vec::new();
        let mut solver = watched(scene, progress, &mut |solver| {
            if solver.step.is_multiple_of(20) {
                let square = |i: usize| {
                    (0..l.dimension).map(|d| solver.state[(l.velocity() + d) * n + i].f64().powi(2)).sum::<f64>()
                };
                let fastest = largest(fluid.iter().map(|&i| square(i)));
                speeds.push((solver.step as f64 * scene.model.dt, (fastest / (gravity * height)).sqrt()));
            }
        })?;
        if self == Self::Rest {
            let end = speeds.last().map_or(0.0, |last| last.0);
            let late = speeds.iter().filter(|(time, _)| *time >= 0.75 * end).map(|point| point.1);
            return Ok(Found { error: largest(late), curves: vec![Curve::new("hydrograd", speeds)] });
        }
        solver.look()?;
        let place = |&i: &usize| {
            let y = solver.state[n + i].f64();
            let pressure =
                scene.model.equation_of_state.pressure(solver.looked.density[i]).f64() / (density * gravity * height);
            (pressure, y / height)
        };
        let points: Vec<(f64, f64)> = fluid.iter().map(place).collect();
        let error = largest(points.iter().map(|(pressure, y)| (pressure - (1.0 - y)).abs()));
        Ok(Found::beside(error, points, "exact", vec![(1.0, 0.0), (0.0, 1.0)]))
    }
}

fn front<R: Sweeps>(config: &Config, scene: &Scene<R>, progress: Progress) -> anyhow::Result<Found> {
    let (width, gravity) = (config.water.length, -config.fluid.gravity[1]);
    let n = scene.model.particles();
    let mut points = Vec::new();
    watched(scene, progress, &mut |solver| {
        let fluid = (0..n).filter(|&i| scene.model.is_fluid(i));
        let front = fluid.map(|i| solver.state[i].f64()).fold(f64::NEG_INFINITY, f64::max) + 0.5 * scene.spacing;
        let time = solver.step as f64 * scene.model.dt;
        points.push((time * (2.0 * gravity / width).sqrt(), front / width));
    })?;
    let table = reference::dam_break_front();
    let end = points.last().map_or(0.0, |last| last.0);
    let seen: Vec<(f64, f64)> =
        table.column("T").into_iter().zip(table.column("Z")).filter(|(time, _)| *time <= end).collect();
    if seen.is_empty() {
        bail!("the run ends before the experiment's first time");
    }
    let error: f64 = errors(&points, &seen).iter().sum();
    Ok(Found::beside(error / seen.len() as f64, points, "Martin and Moyce (1952)", seen))
}

/// Relative errors at the reference's times; ours are close enough together to be joined by lines.
fn errors(ours: &[(f64, f64)], theirs: &[(f64, f64)]) -> Vec<f64> {
    let (t, x): (Vec<f64>, Vec<f64>) = ours.iter().copied().unzip();
    theirs.iter().map(|(time, exact)| (reference::between(&t, &x, *time) / exact - 1.0).abs()).collect()
}

/// The largest of numbers that are not below 0; not a number if one is none, which `max` would hide.
fn largest(numbers: impl IntoIterator<Item = f64>) -> f64 {
    numbers.into_iter().fold(0.0_f64, |most, x| if most.is_nan() || x <= most { most } else { x })
}

/// Runs a scene to its end.
fn watched<R: Sweeps>(
    scene: &Scene<R>,
    progress: Progress,
    see: &mut dyn FnMut(&Solver<R>),
) -> anyhow::Result<Solver<R>> {
    let dynamics = Sph::new(scene.model.clone(), Kernels::Fused);
    let mut watch = |_: &Sph<R>, solver: &mut Solver<R>| -> anyhow::Result<()> {
        progress(solver.step as f64 / scene.steps as f64);
        see(solver);
        Ok(())
    };
    run(&dynamics, &scene.start, scene.steps, &mut [&mut watch])
}

fn kinetic_energy<R: Sweeps>(scene: &Scene<R>, progress: Progress) -> anyhow::Result<Found> {
    let table = reference::taylor_green_3d();
    let volume: f64 = scene.model.domain.size[..scene.model.dimension()].iter().product();
    let density = scene.model.equation_of_state.reference_density;
    let mut points = Vec::new();
    watched(scene, progress, &mut |solver| {
        let time = solver.step as f64 * scene.model.dt;
        let energy = scene.figures(&solver.state, time).kinetic_energy;
        points.push((time, energy / (density * volume)));
    })?;
    let end = points.last().map_or(0.0, |last| last.0);
    let exact = table.column("time").into_iter().zip(table.column("kinetic_energy"));
    let exact: Vec<(f64, f64)> = exact.filter(|(time, _)| *time <= end + 1e-9).collect();
    Ok(Found::beside(largest(errors(&points, &exact)), points, "spectral", exact))
}

fn centre_lines<R: Sweeps>(scene: &Scene<R>, progress: Progress) -> anyhow::Result<Found> {
    // Walls are as thick on both sides of the unit square or cube.
    let wall = |d: usize| 0.5 * (scene.model.domain.size[d] - 1.0);
    let every = (scene.steps / 4 / SAMPLES).max(1);
    let (mut u, mut v, mut count) = (vec![0.0; PLACES], vec![0.0; PLACES], 0.0);
    let mut missing = 0;
    watched(scene, progress, &mut |solver| {
        if solver.step < scene.steps - scene.steps / 4 || !solver.step.is_multiple_of(every) {
            return;
        }
        count += 1.0;
        for k in 0..PLACES {
            let s = (k + 1) as f64 / (PLACES + 1) as f64;
            let at = |x: f64, y: f64| {
                let place = [x + wall(0), y + wall(1), 0.5 + wall(2)];
                probe::velocity(&scene.model, &solver.state, place)
            };
            match (at(0.5, s), at(s, 0.5)) {
                (Some(across), Some(along)) => {
                    u[k] += across[0];
                    v[k] += along[1];
                }
                _ => missing += 1,
            }
        }
    })?;
    if missing > 0 || count == 0.0 {
        bail!("{missing} places of the centre lines have too few particles around");
    }
    let table = match scene.model.dimension() {
        2 => reference::lid_driven_cavity(),
        _ => reference::lid_driven_cavity_3d(),
    };
    let least = |x: &[f64]| x.iter().copied().fold(f64::INFINITY, f64::min);
    let most = |x: &[f64]| x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (exact_u, exact_v) = (table.column("u"), table.column("v"));
    let (u, v): (Vec<f64>, Vec<f64>) = (u.iter().map(|x| x / count).collect(), v.iter().map(|x| x / count).collect());
    let places = || (0..PLACES).map(|k| (k + 1) as f64 / (PLACES + 1) as f64);
    let pairs = match scene.model.dimension() {
        2 => [(least(&u), least(&exact_u)), (most(&v), most(&exact_v)), (least(&v), least(&exact_v))],
        _ => {
            let (places, values) = (places().collect::<Vec<_>>(), reference::CUBIC_CAVITY);
            [0, 1, 2].map(|k| (reference::between(&places, if k == 0 { &u } else { &v }, values[k].0), values[k].1))
        }
    };
    let error = pairs.iter().map(|(found, exact)| (found / exact - 1.0).abs()).fold(0.0, f64::max);
    let s = table.column("s");
    let curves = vec![
        Curve::new("u on x = 1/2", places().zip(u).collect()),
        Curve::new("v on y = 1/2", places().zip(v).collect()),
        Curve::new("u, finite differences", s.iter().copied().zip(exact_u).collect()),
        Curve::new("v, finite differences", s.iter().copied().zip(exact_v).collect()),
    ];
    Ok(Found { error, curves })
}

fn cavity_heat<R: Sweeps>(config: &Config, scene: &Scene<R>, progress: Progress) -> anyhow::Result<Found> {
    let surface = ShapeHeat::of_config(config)?.ok_or_else(|| anyhow!("the scene has no warm walls"))?;
    let every = (scene.steps / 4 / SAMPLES).max(1);
    let mut points = Vec::new();
    watched(scene, progress, &mut |solver| {
        if solver.step.is_multiple_of(every) {
            let time = solver.step as f64 * scene.model.dt;
            points.extend(surface.of_state(&scene.model, &solver.state).map(|heat| (time, heat[0])));
        }
    })?;
    let end = scene.steps as f64 * scene.model.dt;
    let late: Vec<f64> = points.iter().filter(|(time, _)| *time >= 0.75 * end).map(|point| point.1).collect();
    let (mean, exact) = (late.iter().sum::<f64>() / late.len() as f64, nusselt(config));
    log::info!("Nusselt number: {mean:.6}, known {exact}");
    // What the first particles do beside walls that are suddenly warm would hide all else.
    points.retain(|(time, _)| *time > 0.1 * end);
    Ok(Found::beside(
        (mean / exact - 1.0).abs(),
        points,
        "de Vahl Davis (1983)",
        vec![(0.1 * end, exact), (end, exact)],
    ))
}

/// Q.
fn outflow<R: Sweeps>(scene: &Scene<R>, progress: Progress) -> anyhow::Result<f64> {
    let Some(design) = &scene.design else { bail!("the scene has no outflowing heat") };
    let dynamics = Sph::new(scene.model.clone(), Kernels::Fused);
    let mut measured = Measurement::of(design);
    let mut watch = |_: &Sph<R>, solver: &mut Solver<R>| -> anyhow::Result<()> {
        progress(solver.step as f64 / scene.steps as f64);
        Ok(())
    };
    run(&dynamics, &scene.start, scene.steps, &mut [&mut measured, &mut watch])?;
    Ok(measured.diagnostics().q)
}

fn shapes<R: Sweeps>(loaded: &Loaded, progress: Progress) -> anyhow::Result<Found> {
    let table = reference::heated_channel();
    let (names, amplitudes) = (table.texts("shape"), table.column("A"));
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for (number, shape) in SHAPES.iter().enumerate() {
        let row = (0..names.len()).find(|&k| names[k] == *shape && amplitudes[k] == 0.02);
        let missing = || anyhow!("the reference has no wall {shape}");
        let (row, exact) =
            (row.ok_or_else(missing)?, reference::heated_channel_outflow(shape, 0.02).ok_or_else(missing)?);
        let offsets: Vec<f64> = (0..25).map(|k| table.column(&format!("o{k}"))[row]).collect();
        let wall = loaded.with(&[Setting::set(&nodes()), Setting::set(&format!("design.offsets={offsets:?}"))])?;
        let scene = Scene::<R>::from_config(&wall.config)?;
        let before = number as f64;
        let q = outflow(&scene, &mut |part| progress((before + part) / SHAPES.len() as f64))?;
        ours.push((before, q));
        theirs.push((before, exact));
    }
    let error =
        largest(ours.iter().zip(&theirs).map(|(ours, theirs): (&(_, f64), &(_, f64))| (ours.1 / theirs.1 - 1.0).abs()));
    Ok(Found::beside(error, ours, "finite elements", theirs))
}

/// The columns that the finite elements' walls are given at.
fn nodes() -> String {
    let nodes: Vec<f64> = (0..25).map(|k| (26 + 2 * k) as f64 / 100.0).collect();
    format!("design.nodes={nodes:?}")
}

fn gradient<R: Sweeps>(loaded: &Loaded, progress: Progress) -> anyhow::Result<Found> {
    let search = loaded.with(&[Setting::set(&nodes())])?.for_search()?;
    let scene = Scene::<R>::from_config(&search.config)?;
    let Some(problem) = &scene.design else { bail!("the scene has no design") };
    let schedule = problem.schedule(&search.config.optimise, search.config.run.precision)?;
    let found = problem.differentiate(&problem.first, &schedule, progress)?;
    let summed = |g: &[f64]| -> Vec<f64> {
        let last = g.len() - 1;
        [&[g[0] + g[1]], &g[2..last - 1], &[g[last - 1] + g[last]]].concat()
    };
    let (ours, theirs) = (summed(&found.by_variables), summed(&reference::HEATED_CHANNEL_GRADIENT));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let cosine = dot(&ours, &theirs) / (dot(&ours, &ours) * dot(&theirs, &theirs)).sqrt();
    let at = |g: &[f64]| g.iter().enumerate().map(|(k, g)| (0.26 + 0.02 * k as f64, *g)).collect();
    let scaled: Vec<f64> = found.by_variables.iter().map(|g| 1e3 * g).collect();
    let theirs = at(&reference::HEATED_CHANNEL_GRADIENT);
    Ok(Found::beside(1.0 - cosine, at(&scaled), "finite elements", theirs))
}
