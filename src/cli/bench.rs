//! `hydrograd bench`: how long a step takes, and its gradient, in each mode.

use super::prepare::{build, set_threads};
use super::BenchArguments;
use crate::adjoint::schedule::Schedule;
use crate::adjoint::segments::{gradient, Sph};
use crate::design::diagnostics::start;
use crate::design::optimise;
use crate::error::Error;
use crate::lanes::{InstructionSet, Real};
use crate::report::memory::{peak_memory_bytes, reset_peak_memory};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::config::Precision;
use crate::scene::load::Loaded;
use crate::solver::Solver;

pub fn run(loaded: Loaded, arguments: BenchArguments) -> anyhow::Result<()> {
    set_threads(&loaded.config);
    match loaded.config.run.precision {
        Precision::F32 => go::<f32>(&loaded, &arguments),
        Precision::F64 => go::<f64>(&loaded, &arguments),
    }
}

fn go<R: Real>(loaded: &Loaded, arguments: &BenchArguments) -> anyhow::Result<()> {
    let config = &loaded.config;
    let (channel, shape) = build::<R>(config)?;
    let n = channel.model.particles();
    let steps = channel.steps;
    let dynamics = Sph { model: channel.model.clone(), kernels: config.run.kernels };
    let costs = optimise::costs(config, &channel)?;
    let chosen = optimise::schedule(config, &channel)?;
    let first = start(&channel, &shape.offsets);
    let least = Schedule::least_memory(steps, costs);
    let horizon = config.optimise.horizon.min(steps);
    let mut modes = vec![
        (format!("--memory {}: {chosen}", config.optimise.memory), chosen),
        (format!("segments of {least} (least memory)"), Schedule::segments(steps, least)),
        ("every state".to_string(), Schedule::segments(steps, 1)),
        ("every state, rounded to f32".to_string(), Schedule::every_state(steps, 0, true)),
        ("segments of 4".to_string(), Schedule::segments(steps, 4)),
        ("segments of 10".to_string(), Schedule::segments(steps, 10)),
        ("segments of 200".to_string(), Schedule::segments(steps, 200)),
        (Schedule::two_level(steps, 0, steps.isqrt()).to_string(), Schedule::two_level(steps, 0, steps.isqrt())),
        (Schedule::binomial(steps, 0, 20).to_string(), Schedule::binomial(steps, 0, 20)),
        (Schedule::binomial(steps, 0, 5).to_string(), Schedule::binomial(steps, 0, 5)),
        (format!("truncated, horizon {horizon}"), Schedule::truncated(steps, horizon, least)),
        ("taped".to_string(), Schedule::taped(steps)),
    ];
    modes.retain(|(_, schedule)| (schedule.memory(costs) as f64) < arguments.memory_gb * 1e9);
    let bar = Progress::new((arguments.repeats * (modes.len() + 1)) as u64, "bench");
    let mut table = Table::new([
        "work",
        "ms per step, best",
        "median",
        "ns per particle-step",
        "seconds",
        "peak MB",
        "kept and taped MB",
        "predicted MB",
    ]);
    let failed = |e: crate::solver::SolverError| Error::run(e.to_string(), "--set time.cfl=0.5");
    let base = peak_memory_bytes();

    let mut row =
        |name: &str, predicted: Option<usize>, work: &mut dyn FnMut() -> Result<usize, Error>| -> Result<(), Error> {
            reset_peak_memory();
            let mut seconds = Vec::new();
            let mut held = 0;
            for _ in 0..arguments.repeats {
                let clock = std::time::Instant::now();
                held = work()?;
                seconds.push(clock.elapsed().as_secs_f64());
                bar.advance(1);
            }
            seconds.sort_by(f64::total_cmp);
            let per_step = |s: f64| 1e3 * s / steps as f64;
            table.row([
                name.to_string(),
                format!("{:.4}", per_step(seconds[0])),
                format!("{:.4}", per_step(seconds[seconds.len() / 2])),
                format!("{:.0}", 1e6 * per_step(seconds[0]) / n as f64),
                format!("{:.3}", seconds[0]),
                format!("{:.0}", peak_memory_bytes() as f64 / 1e6),
                predicted.map_or("".into(), |_| format!("{:.1}", held as f64 / 1e6)),
                predicted.map_or("".into(), |p| format!("{:.1}", p as f64 / 1e6)),
            ]);
            Ok(())
        };
    row("forward", None, &mut || {
        let mut solver = Solver::restore(channel.model.clone(), &first).map_err(failed)?;
        while solver.step < steps {
            solver.advance().map_err(failed)?;
        }
        solver.check_finite().map_err(failed).map(|_| 0)
    })?;
    for (name, schedule) in &modes {
        row(&format!("gradient, {name}"), Some(schedule.storage(costs)), &mut || {
            gradient(&dynamics, &first, schedule, &channel.objective, &mut |_| ()).map_err(failed).map(|g| g.storage)
        })?;
    }
    bar.finish();
    println!(
        "{n} particles, {steps} steps of {:.3e}, {} in {:?}, {} threads; the process itself: {:.0} MB",
        channel.model.dt,
        if std::mem::size_of::<R>() == 4 { "f32" } else { "f64" },
        InstructionSet::detect(),
        candle_core::utils::barrier_pool().n_workers() + 1,
        base as f64 / 1e6
    );
    println!("{}", table.to_text());
    Ok(())
}
