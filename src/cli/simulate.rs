//! `hydrograd simulate`: runs a scene, with figures, plots and frames.

use super::arguments::{CommonArguments, ExplainArgument, ResumeArgument};
use super::explain::explain;
use super::figure_errors::{self, ErrorArguments, Spacings};
use super::files::{self, CHECKPOINT};
use super::guard;
use super::page;
use super::prepare::{open_device, use_threads_of};
use super::ranks::check_flow;
use super::run_folder::{earlier, is_unfinished, Earlier, RunFolder};
use super::simulate_report::{report_design, report_flow, Finished};
use super::{around_bodies, around_in_time, around_shapes, periodic_box};
use crate::adjoint::run::{run as run_to_the_end, Observer};
use crate::adjoint::{Dynamics, RunError};
use crate::config::layers::Setting;
use crate::config::scene::Precision;
use crate::design::shape::TOP;
use crate::error::{BadInput, Error};
use crate::numerics::interrupt;
use crate::numerics::ranks::Ranks;
use crate::numerics::threads::{count, in_words};
use crate::report::progress::Progress;
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_shapes::AroundShapes;
use crate::scene::load::Loaded;
use crate::scene::observers::{Checkpoints, EvenSteps, Frames, History, LastGood};
use crate::scene::particle_fields::ParticleFields;
use crate::scene::particle_grid::write_grid;
use crate::scene::plausible::Findings;
use crate::scene::record::Recovery;
use crate::scene::{checkpoint, Scene};
use crate::sph::divergence::{self, Divergence};
use crate::sph::dynamics::Sph;
use crate::sph::solver::Snapshot;
use crate::sph::spread::{self, Pieces};
use crate::sph::Sweeps;
use clap::Args;
use std::path::Path;
use std::time::Instant;

/// Simulate a scene with its start shape; writes figures, plots and ParaView frames.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd simulate
      the heated channel with a flat wall
  hydrograd simulate --set design.shape=sine --set design.amplitude=0.02 --out runs/sine
      with a sine-shaped wall
  hydrograd simulate --set design.file=runs/optimize-heated-channel/shape.csv --set resolution.dx=0.01
      the optimum of a run again, at half the spacing
  hydrograd simulate --explain
      what a step would do, and nothing is run
  hydrograd simulate taylor-green --set resolution.dx=0.01
      a flow with an exact solution (`hydrograd scenes` lists more), and how far from it the particles end
  hydrograd simulate --resume runs/simulate-heated-channel --set time.end=8
      a finished run made longer, to the bit as if it had been so long (an interrupted one goes on without --set)
  hydrograd simulate --set time.cfl=2 --recover
      steps that are too long: where it diverges it goes back and makes them shorter
  hydrograd simulate my.toml --set output.grid=[64,48]
      the flow at its end also on the points of a grid: grid.h5, grid.vti (scenes of your own)
  mpirun -n 4 hydrograd simulate my.toml
      one flow by four processes, on one machine or several (built with the feature mpi; particles that move)
  hydrograd simulate my.toml --precision f32 --threads 2
      a scene of your own: `hydrograd scenes heated-channel > my.toml` to begin with")]
pub struct SimulateArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub resume: ResumeArgument,
    #[command(flatten)]
    pub explain: ExplainArgument,
    /// Where the run diverges, go back to the last good state and on with steps of half the length; again, up to four times.
    #[arg(long)]
    pub recover: bool,
    #[command(flatten)]
    pub errors: ErrorArguments,
}

impl SimulateArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        let resume = self.resume.resume.as_deref();
        let loaded = self.common.load(resume, vec![], vec![])?;
        let Some(folder) = resume else { return Ok(loaded) };
        // Steps divide the run's time. When a run is extended, its time step must stay the same.
        let before = files::read_config(folder)?.config;
        let (time, earlier) = (&loaded.config.time, &before.time);
        let step = Setting::option("--resume", "time.step", format!("{:?}", before.time_step()));
        match (time.end, time.steps) == (earlier.end, earlier.steps) || time.step.is_some() {
            true => Ok(loaded),
            false => Ok(loaded.with(&[step])?),
        }
    }
}

/// Number of checkpoints per run, besides the one at the end.
const CHECKPOINTS: usize = 10;
/// Number of rows of history.csv.
const HISTORY: usize = 400;
const KIND: &str = "simulate";
/// A checkpoint of the last good state of a diverged run.
const LAST_GOOD: &str = "last-good.safetensors";
/// Number of times that steps are halved before a run is given up.
const HALVINGS: usize = 4;

pub fn run(mut loaded: Loaded, arguments: SimulateArguments, ranks: &Ranks) -> anyhow::Result<()> {
    let resume = arguments.resume.resume.as_deref();
    let folder = arguments.common.folder(resume, KIND, &loaded)?;
    use_threads_of(ranks, loaded.config.run.threads);
    open_device(&loaded)?;
    if arguments.explain.explain {
        return if ranks.rank() == 0 { explain(&loaded, false) } else { Ok(()) };
    }
    if ranks.size() > 1 {
        check_shared(&loaded, &arguments)?;
    }
    if ranks.rank() > 0 {
        interrupt::listen_quietly()?;
        return match loaded.config.run.precision {
            Precision::F32 => follow::<f32>(&loaded, &folder, resume, ranks),
            Precision::F64 => follow::<f64>(&loaded, &folder, resume, ranks),
        };
    }
    let halvings = if arguments.recover { HALVINGS } else { 0 };
    if arguments.recover && !loaded.config.method.facts().moves {
        return Err(BadInput::new("--recover with fixed particles, whose steps have one length")
            .allowed("a method whose particles move, such as method.name = consistent")
            .advice("time.cfl=0.6 from the beginning")
            .into());
    }
    RunFolder::check(&folder, KIND, earlier(&folder, resume, Earlier::Replaced))?;
    let ErrorArguments { error, accuracy } = arguments.errors;
    let mut spacings = Spacings::default();
    if let Some(accuracy) = accuracy {
        if resume.is_some() {
            let problem = "--accuracy chooses a spacing, and a run that goes on has one";
            return Err(BadInput::new(problem).place("--accuracy").allowed("without --resume").into());
        }
        interrupt::listen("hydrograd simulate --accuracy".to_string())?;
        loaded = spacings.accurate(&loaded, accuracy)?;
    }
    let asks_errors = error || accuracy.is_some();
    simulate(&loaded, &folder, resume, halvings, asks_errors, ranks)?;
    // A flow that knows its errors has told them.
    match asks_errors && !loaded.config.knows_its_errors() {
        true => figure_errors::add(&loaded, &folder, &mut spacings),
        false => Ok(()),
    }
}

/// Checks that several ranks can share a run, as far as options and the configuration tell.
pub(super) fn check_shared(loaded: &Loaded, arguments: &SimulateArguments) -> Result<(), BadInput> {
    let ErrorArguments { error, accuracy } = &arguments.errors;
    let options = [
        (
            "--recover",
            arguments.recover,
            "steps are made shorter by one process only",
            "--set time.cfl=0.5 from the beginning",
        ),
        ("--error", *error, "it makes several runs", "--error in one process, at the spacings that it can hold"),
        ("--accuracy", accuracy.is_some(), "it makes several runs", "--dx"),
    ];
    if let Some((option, _, why, advice)) = options.into_iter().find(|(_, is_given, ..)| *is_given) {
        return Err(BadInput::new(format!("{option} over several ranks: {why}"))
            .place(option)
            .allowed(format!("a run over several ranks without {option}, or one process"))
            .advice(advice));
    }
    check_flow(loaded)
}

/// The state that a run begins with.
fn first<R: Sweeps>(loaded: &Loaded, scene: &Scene<R>, resume: Option<&Path>) -> Result<Snapshot<R>, BadInput> {
    match resume {
        // The run ended before its first checkpoint.
        Some(from) if !from.join(CHECKPOINT).exists() && is_unfinished(from, KIND) => Ok(scene.start.clone()),
        Some(from) => checkpoint::read(&from.join(CHECKPOINT), &loaded.config, &scene.model),
        None => Ok(scene.start.clone()),
    }
}

/// Another rank's part of a run: its share of the particles.
fn follow<R: Sweeps>(loaded: &Loaded, folder: &Path, resume: Option<&Path>, ranks: &Ranks) -> anyhow::Result<()> {
    let scene = Scene::<R>::from_config(&loaded.config)?;
    let first = first(loaded, &scene, resume)?;
    let sharing = spread::sharing(&scene.model, ranks)?;
    let Scene { model, steps, .. } = scene;
    // Until no rank reads files of the folder any more, and then until the first one has made it.
    ranks.wait();
    ranks.wait();
    let mut frames = Frames::new(&folder.join(frames_of(first.step)), steps, loaded.config.output.frames)?;
    let pieces = frames.as_mut().map(|frames| frames as &mut dyn Pieces<R>);
    match spread::follow(model, first, pieces, (sharing, ranks)) {
        // The first rank tells it.
        Err(error) if error.is::<RunError>() => Ok(()),
        ended => ended,
    }
}

/// The folder of frames: a resumed run keeps those of its earlier part and adds to them.
fn frames_of(began: usize) -> String {
    if began > 0 {
        format!("particles-from-{began}")
    } else {
        "particles".to_string()
    }
}

/// Simulates into a folder.
fn simulate(
    loaded: &Loaded,
    folder: &Path,
    resume: Option<&Path>,
    halvings: usize,
    asks_errors: bool,
    ranks: &Ranks,
) -> anyhow::Result<()> {
    if loaded.config.is_around_shapes() {
        if loaded.config.unsteady().is_some() {
            interrupt::listen("hydrograd simulate".to_string())?;
            if loaded.config.is_periodic_box() {
                return periodic_box::simulate(loaded, folder, earlier(folder, resume, Earlier::Replaced));
            }
            let earlier = earlier(folder, resume, Earlier::Replaced);
            return match loaded.config.is_around_bodies() {
                true => around_in_time::simulate(loaded, &AroundBodies::new(&loaded.config)?, folder, earlier),
                false => around_in_time::simulate(loaded, &AroundShapes::new(&loaded.config)?, folder, earlier),
            };
        }
        // It is found anew in a moment.
        let earlier = earlier(folder, resume, Earlier::Replaced);
        return match loaded.config.is_around_bodies() {
            true => around_bodies::simulate(loaded, folder, earlier),
            false => around_shapes::simulate(loaded, folder, earlier, asks_errors),
        };
    }
    interrupt::listen(format!("hydrograd simulate --resume {}", folder.display()))?;
    match loaded.config.run.precision {
        Precision::F32 => go::<f32>(loaded, folder, resume, halvings, ranks),
        Precision::F64 => go::<f64>(loaded, folder, resume, halvings, ranks),
    }
}

fn go<R: Sweeps>(
    loaded: &Loaded,
    folder: &Path,
    resume: Option<&Path>,
    halvings: usize,
    ranks: &Ranks,
) -> anyhow::Result<()> {
    let config = &loaded.config;
    let scene = Scene::<R>::from_config(config)?;
    let first = first(loaded, &scene, resume)?;
    let sharing = (ranks.size() > 1).then(|| spread::sharing(&scene.model, ranks)).transpose()?;
    let dynamics = Sph::new(scene.model.clone(), config.run.compute()?);
    let began = first.step;
    check_unfinished(began, &scene)?;
    // A start without a neighbour list is told before anything is written; only the report of a design asks for its fields.
    let start = match (&scene.design, sharing) {
        (None, Some(_)) => None,
        (design, _) => {
            let start = dynamics.start(&first).map_err(|error| divergence::told(&error, &scene.model, &first));
            let mut start = start?;
            design.as_ref().map(|_| ParticleFields::of(&mut start)).transpose()?
        }
    };
    // Until no rank reads files of the folder any more.
    ranks.wait();
    let own = RunFolder::take(folder, KIND, earlier(folder, resume, Earlier::Replaced))?;
    files::write_config(folder, loaded)?;
    if let Some(design) = &scene.design {
        let wall = design.first_wall();
        let mut columns = vec![(wall.column(), wall.offsets.as_slice())];
        columns.extend(wall.top.as_deref().map(|top| (TOP, top)));
        files::write_shape(folder, &wall, &columns)?;
        if wall.across.is_some() {
            files::plot_relief(folder, "wall", config, &[("the wall", &wall)])?;
            files::write_wall(folder, config, &*design.parametrisation, &design.first)?;
        }
    }
    let part = frames_of(began);
    let mut frames = Frames::new(&folder.join(&part), scene.steps, config.output.frames)?;
    ranks.wait();
    let bar = Progress::new(scene.steps as u64, "simulate");
    let label = match (&scene.design, scene.history_columns()[1]) {
        (Some(_), _) => "Q",
        (None, "lower_wall_flux") => "flux through the lower wall",
        _ => "kinetic energy",
    };
    let mut show = |step: usize, row: &[f64]| {
        bar.set_position(step as u64);
        bar.message(format!("{label} {:.5}", row[1]));
    };
    let mut history = History::new(&scene, folder, HISTORY, &mut show);
    if let Some(from) = resume {
        history = history.continued(from, began);
    }
    let mut checkpoints = Checkpoints {
        path: folder.join(CHECKPOINT),
        configuration: &loaded.text,
        steps: EvenSteps::new(scene.steps, CHECKPOINTS),
        began,
        window: scene.window(),
    };
    let mut measurement = scene.measurement();
    let mut shape_heats = scene.shape_heats(config)?;
    let clock = Instant::now();
    let (mut from, mut recovered) = (first, Vec::<Recovery>::new());
    let (mut solver, shares) = loop {
        let mut good = LastGood::new(&from);
        let mut observers: Vec<&mut dyn Observer<Sph<R>>> = vec![&mut good];
        observers.extend(measurement.as_mut().map(|it| it as &mut dyn Observer<Sph<R>>));
        observers.extend(shape_heats.as_mut().map(|it| it as &mut dyn Observer<Sph<R>>));
        let (seen, pieces) = match sharing {
            None => (frames.as_mut(), None),
            Some(_) => (None, frames.as_mut()),
        };
        observers.extend(seen.map(|it| it as &mut dyn Observer<Sph<R>>));
        observers.push(&mut history);
        observers.push(&mut checkpoints);
        let ran = match sharing {
            None => run_to_the_end(&dynamics, &from, scene.steps, &mut observers).map(|solver| (solver, None)),
            Some(sharing) => {
                let pieces = pieces.map(|it| it as &mut dyn Pieces<R>);
                spread::lead(&dynamics, &from, scene.steps, &mut observers, pieces, (sharing, ranks))
                    .map(|(solver, shares)| (solver, Some(shares)))
            }
        };
        let error = match ran {
            Ok(ran) => break ran,
            Err(error) => error.downcast::<RunError>()?,
        };
        let good = good.state();
        let Some(mut found) = Divergence::of(&error, &scene.model, good) else {
            return Err(divergence::told(&error, &scene.model, good).into());
        };
        let own = Findings::of(config, &scene)?.cause(config, &found.cause, &found.position)?;
        found.cause = own.unwrap_or(found.cause);
        let path = folder.join(LAST_GOOD);
        checkpoint::write(&path, &scene.model, good, &loaded.text)?;
        if recovered.len() == halvings {
            let next = match halvings {
                0 => "--recover goes on from there with shorter steps".to_string(),
                _ => format!("given up after {halvings} halvings of the step"),
            };
            let kept = format!("\n  last good state: {} (step {}); {next}", path.display(), good.step);
            return Err(found.told(&kept).into());
        }
        from = Snapshot { least_parts: 2 * from.least_parts, ..good.clone() };
        let (step, parts) = (from.step, from.least_parts);
        history.go_back(step);
        measurement.iter_mut().for_each(|it| it.go_back(step));
        shape_heats.iter_mut().for_each(|it| it.go_back(step));
        frames.iter_mut().for_each(|it| it.go_back(step as f64 * scene.model.dt));
        bar.suspend(|| {
            let advice = format!("nothing, it goes on from step {step} with every step in {parts} parts");
            guard::warn(&error.to_string(), &advice);
        });
        recovered.push(Recovery { step: found.step, from_step: step, parts, cause: found.cause.why });
    };
    let seconds = clock.elapsed().as_secs_f64();
    let history = history.rows;
    bar.finish();
    let end = ParticleFields::of(&mut solver)?;
    end.write(folder, config, &loaded.text)?;
    let has_grid = write_grid(folder, config, &scene.model, &end)?;
    let (n, done, dt) = (scene.model.particles(), scene.steps - began, scene.model.dt);
    let each = 1e9 * seconds / (done * n) as f64;
    let on = match &shares {
        Some(shares) => format!("{} ranks with {} each", shares.ranks, in_words(count())),
        None => in_words(count()),
    };
    println!("{n} particles, {done} steps of {dt:.3e} in {seconds:.2} s on {on} ({each:.0} ns per particle and step)");
    if let Some(shares) = &shares {
        println!("{shares}");
    }
    let divided = solver.divided;
    if let Some(Recovery { from_step, parts, .. }) = recovered.last() {
        let times = if recovered.len() == 1 { "once".into() } else { format!("{} times", recovered.len()) };
        println!("recovered {times}; from step {from_step} on every step was made in {parts} parts");
    } else if divided.steps > 0 {
        println!(
            "{} steps in up to {} parts each: the flow was faster than fluid.reference_velocity = {}, or pushed harder",
            divided.steps, divided.most, config.fluid.reference_velocity
        );
    }
    let mut pictures = if frames.is_some() { format!(", {part}/particles.pvd (ParaView)") } else { String::new() };
    if has_grid {
        pictures.push_str(", grid.h5, grid.vti (ParaView)");
    }
    let finished = Finished {
        loaded,
        folder,
        scene: &scene,
        history: &history,
        end: &end,
        seconds,
        divided,
        recovered: &recovered,
        shares: shares.as_ref(),
        shape_heat: shape_heats.map_or(vec![], |it| it.mean()),
        pictures,
    };
    let measured = measurement.map(|it| it.diagnostics());
    match (&scene.design, &measured, &start) {
        (Some(design), Some(measured), Some(start)) => report_design(&finished, design, measured, start)?,
        _ => report_flow(&finished, &scene.figures(&solver.state, scene.steps as f64 * dt), measured.as_ref())?,
    }
    page::write(folder)?;
    // The checkpoint comes last, so that a run with it is complete: the averages of its end are in no checkpoint.
    checkpoint::write(&folder.join(CHECKPOINT), &scene.model, &solver.snapshot(), &loaded.text)?;
    own.finish()
}

/// Returns an error if a resumed run has nothing left to do, or not enough for the averages of its end.
fn check_unfinished<R: Sweeps>(step: usize, scene: &Scene<R>) -> Result<(), BadInput> {
    let (steps, window) = (scene.steps, scene.window());
    let time = |steps: usize| steps as f64 * scene.model.dt;
    let (problem, allowed) = if step >= steps {
        (
            format!("the run has its {step} steps already"),
            "a run that was interrupted, or a longer time.end".to_string(),
        )
    } else if step > 0 && step + window > steps {
        (
            "the last part of the run, whose averages are taken, began before what is to come".to_string(),
            format!("time.end of at least {:.6}: objective.window more than there is", time(step + window)),
        )
    } else {
        return Ok(());
    };
    let advice = format!("time.end={:.3}", 2.0 * time(step));
    Err(BadInput::new(problem).place("--resume").allowed(allowed).advice(advice))
}
