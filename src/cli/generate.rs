//! `hydrograd generate` and `hydrograd merge`: data sets of trajectories for the surrogate.

use super::arguments::CommonArguments;
use super::files::VERSION;
use super::machine;
use super::page;
use super::prepare::{difference, open_device, share_out, threads_of, use_threads, workers};
use super::run_folder::{Earlier, RunFolder};
use super::shard::{Shard, ShardArgument};
use crate::config::scene::{Config, DesignWalls, DriveName, Precision, ShapeName};
use crate::dataset::objective::objective;
use crate::dataset::recipe::{Job, Pace, Recipe, Starts};
use crate::dataset::record::{record, shared_particles};
use crate::dataset::store::{Begun, Provenance, Store};
use crate::dataset::trajectory::Split;
use crate::dataset::walls::{read_walls, Walls};
use crate::dataset::Metadata;
use crate::error::{BadInput, Error};
use crate::io::hdf5_file::open;
use crate::io::FileError;
use crate::numerics::interrupt;
use crate::numerics::ranks::Ranks;
use crate::report::page::PAGE;
use crate::report::progress::Progress;
use crate::report::text::bytes;
use crate::scene::load::Loaded;
use clap::Args;
use serde_json::{json, Value};
use std::path::PathBuf;
use std::time::Instant;

/// Make a data set of trajectories, to train a surrogate with (LagrangeBench's layout, with temperature).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Frames are --every reference steps apart, the first one after --skip of them. A reference step is that of JAX-SPH at its
Courant number (0.25; 0.22 for LagrangeBench's flows): 4.5e-4 in the heated channel. The run itself takes larger ones, as
large as time.cfl allows, and gives the same physical times; --set time.cfl=0.25 takes the reference's own.

Each trajectory is a file in DIR/parts until all are there; then they are merged into train.h5, valid.h5, test.h5 and
metadata.json. A run that was stopped goes on where it was: give the same command again. The same seed gives the same
bytes whatever the shards and threads.

Examples:
  hydrograd generate heated-channel --out data/heated
      100/50/50 trajectories of the heated channel, each with a wall of its own
  hydrograd generate heated-channel --trajectories 8/2/2 --frames 60 --walls smooth --set design.bound=0.04
      fewer, with smooth random walls up to 0.04
  hydrograd generate heated-channel --set design.file=shape.csv --out data/one-wall
      one wall for all, from a file (or --set design.offsets=[0.0,0.01,...])
  hydrograd generate heated-channel --walls-file walls.csv --trajectories 4/1/1 --out data/given
      six walls of your own: six lines of 25 offsets
  hydrograd generate heated-channel --pairs 0.004 --trajectories 800/40/40 --frames 50 --set design.bound=0.03 --out data/pairs
      walls in pairs, to train a model on what a change of the wall does (objective.weight of a training)
  hydrograd generate taylor-green --seed 7
      LagrangeBench's 2D Taylor-Green vortices
  hydrograd generate heated-channel --out data/heated --shard 0/4
      the first of four shares, perhaps on another machine with the same disk; in a Slurm job array
      (sbatch --array=0-3) --shard follows from the array")]
pub struct GenerateArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    /// Trajectories for training, validation and test [default: 100/50/50 for the heated channel].
    #[arg(long, value_name = "TRAIN/VALID/TEST", value_parser = parse_trajectories)]
    pub trajectories: Option<[usize; 3]>,
    /// Frames per trajectory [default: 147 for the heated channel].
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Reference steps from frame to frame [default: 100].
    #[arg(long, value_name = "N")]
    pub every: Option<usize>,
    /// Reference steps before the first frame [default: 300 for the heated channel].
    #[arg(long, value_name = "N")]
    pub skip: Option<usize>,
    /// Flows: reference steps in which a random start comes to rest before time 0 [default: 5000 where LagrangeBench has
    /// them].
    #[arg(long, value_name = "N")]
    pub relax: Option<usize>,
    /// Walls of the heated channel [default: mix, or scene where the scene's own design is given].
    #[arg(long, value_enum)]
    pub walls: Option<Walls>,
    /// How the heated channel's flows begin.
    #[arg(long, value_enum, default_value_t)]
    pub starts: Starts,
    /// Walls from a file: a line per wall, its offsets at the design's nodes, separated by commas; trajectories take them in
    /// turns.
    #[arg(long, value_name = "FILE", conflicts_with = "walls")]
    pub walls_file: Option<PathBuf>,
    /// Trajectories in pairs: every second one is the one before it over a neighbouring wall, whose nodes differ by at most
    /// this (with --walls-file every line has its pair). For `hydrograd train --set objective.weight=1`.
    #[arg(long, value_name = "LENGTH", default_value_t = 0.0, hide_default_value = true)]
    pub pairs: f64,
    /// Also write the heat that flows out of the steady flow over each wall and its derivative by the nodes (datasets
    /// `objective` and `objective_gradient`), by fixed particles.
    #[arg(long)]
    pub objective: bool,
    #[command(flatten)]
    pub shard: ShardArgument,
}

/// Put the trajectories of all shards together (`generate` does it itself when the last one is there).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd merge data/heated
      train.h5, valid.h5, test.h5 and metadata.json from data/heated/parts")]
pub struct MergeArguments {
    /// The --out of `hydrograd generate`.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

impl GenerateArguments {
    /// The scene's recipe with the given options.
    pub fn recipe(&self, loaded: &Loaded) -> Result<Recipe, Error> {
        let design = &loaded.config.design;
        if design.walls == DesignWalls::Both {
            return Err(BadInput::new("design.walls = both: a data set of channels with two shaped walls")
                .key("design.walls")
                .allowed("bottom: what a data set says of a wall is the bottom one's")
                .into());
        }
        if loaded.config.fluid.drive != DriveName::BodyForce {
            return Err(BadInput::new("fluid.drive: a data set of flows with a force that is found")
                .key("fluid.drive")
                .allowed("body-force: a data set has one force for all of its flows")
                .into());
        }
        let usual = Recipe::of(loaded.config.scene);
        let own = design.offsets.is_some() || design.shape != ShapeName::Flat;
        let given = match self.walls_file.as_deref() {
            Some(path) => read_walls(path).map_err(|bad| bad.place(format!("--walls-file {}", path.display())))?,
            None => Vec::new(),
        };
        Ok(Recipe {
            trajectories: self.trajectories.unwrap_or(usual.trajectories),
            frames: self.frames.unwrap_or(usual.frames),
            every: self.every.unwrap_or(usual.every),
            skip: self.skip.unwrap_or(usual.skip),
            relax: self.relax.unwrap_or(usual.relax),
            walls: match self.walls {
                None if self.walls_file.is_some() => Walls::File,
                None if own => Walls::Scene,
                walls => walls.unwrap_or(usual.walls),
            },
            starts: self.starts,
            pairs: self.pairs,
            objective: self.objective,
            given,
        })
    }
}

/// Keys that do not change what is in a data set.
const FREE: [&str; 3] = ["output", "run.threads", "optimise"];

const KIND: &str = "generate";

/// Whether this process goes on, as the first of all ranks says.
fn goes_on(ranks: &Ranks, wanted: bool) -> bool {
    ranks.all(&[f64::from(u8::from(wanted))])[0] > 0.0
}

pub fn run(arguments: GenerateArguments, ranks: &Ranks) -> anyhow::Result<()> {
    let loaded = arguments.common.load(None, vec![], vec![])?;
    let recipe = arguments.recipe(&loaded)?;
    recipe.check(&loaded).map_err(|bad| bad.located(|key| Some(option_of(&recipe, key))))?;
    let shard = arguments.shard.share()?.unwrap_or(Shard::ALL);
    // Errors in a trajectory's configuration are found before anything is written.
    for (line, job) in recipe.jobs().into_iter().take(recipe.given.len().max(1)).enumerate() {
        let of_line = |error| match error {
            Error::Input(bad) if recipe.walls == Walls::File => {
                Error::from(bad.place(format!("--walls-file, wall {}", line + 1)))
            }
            other => other,
        };
        recipe.ready(&loaded, job).map_err(of_line)?;
    }
    let folder = arguments.common.folder(None, KIND, &loaded)?;
    let store = Store::new(&folder);
    let who = Who::of(&loaded, &recipe, ranks)?;
    let work = Work { store: &store, loaded: &loaded, recipe: &recipe, ranks, who };
    let of_rank = match who {
        Who::Together { .. } => Shard::ALL,
        Who::Apart => Shard { index: ranks.rank(), count: ranks.size() },
    };
    let mine: Vec<Job> = of_rank.of(&shard.of(&recipe.jobs()).copied().collect::<Vec<_>>()).copied().collect();
    if ranks.rank() > 0 {
        // The first rank has begun the folder.
        if goes_on(ranks, true) {
            interrupt::listen_quietly()?;
            let is_told = |error: &anyhow::Error| matches!(error.downcast_ref(), Some(Error::Diverged { .. }));
            match (work.share(&mine), who) {
                // All have it, and the first rank tells it.
                (Err(error), Who::Together { .. }) if is_told(&error) => {}
                (shared, _) => {
                    shared?;
                }
            }
        }
        return Ok(());
    }
    RunFolder::check(&folder, KIND, Earlier::Replaced)?;
    check_same(&store, &loaded, &recipe)?;
    let jobs = recipe.jobs();
    if store.is_complete() {
        goes_on(ranks, false);
        println!("{} is complete: {} trajectories", folder.display(), jobs.len());
        // The run ended during the last steps of the merge, or is of an earlier version.
        if !folder.join(PAGE).is_file() || store.parts().exists() {
            let own = RunFolder::share(&folder, KIND)?;
            store.merge(&loaded.config, &recipe)?;
            page::write(&folder)?;
            own.finish()?;
        }
        machine::answer(&summary(&store, &recipe, Made { kept: jobs.len(), ..Made::default() })?);
        return Ok(());
    }
    open_device(&loaded)?;
    // Shards write there together; nothing of an earlier run of the same data set is discarded.
    let own = RunFolder::share(&folder, KIND)?;
    if store.begun()?.is_none() {
        store.begin(&loaded.text, &Begun { recipe: recipe.clone(), version: VERSION.into() })?;
    }
    std::fs::create_dir_all(store.parts()).map_err(|source| FileError::write(&store.parts(), source))?;
    goes_on(ranks, true);
    interrupt::listen("the same command again: finished trajectories are kept")?;
    if ranks.size() > 1 {
        match who {
            Who::Apart => println!("{} ranks: each makes whole flows of its own", ranks.size()),
            Who::Together { particles } => println!("{} ranks share every flow of {particles} particles", ranks.size()),
        }
    }
    let made = work.share(&mine)?;
    let Made { made: count, kept, seconds, workers } = made;
    let each = seconds * workers as f64 / count.max(1) as f64;
    println!(
        "{count} trajectories made in {seconds:.1} s by {workers} workers ({each:.2} s of a worker each), {kept} kept \
         from before"
    );
    let Pace { every, dt, reference, .. } = recipe.pace(&loaded.config);
    println!(
        "{} frames each, {:.5} apart: {every} steps of {dt:.3e} ({} reference steps of {reference:.3e})",
        recipe.frames,
        every as f64 * dt,
        recipe.every
    );
    let missing = store.missing(&recipe).len();
    let is_last = missing == 0 || store.is_complete();
    if is_last {
        finish(&store, &loaded.config, &recipe)?;
    } else {
        println!("{missing} of {} trajectories are left to other shards; the last one merges", jobs.len());
        println!("next: hydrograd merge {}    if none does", folder.display());
    }
    machine::answer(&summary(&store, &recipe, made)?);
    if is_last {
        own.finish()
    } else {
        Ok(())
    }
}

/// Flows of so many particles are shared by ranks: a flow takes 1.6 kB a particle, and every rank of a machine would have one.
const LARGE: usize = 200_000;

/// Who makes a trajectory: one of the ranks, or all of them together.
#[derive(Clone, Copy)]
enum Who {
    Apart,
    Together { particles: usize },
}

impl Who {
    /// Flows are shared where they are large, or where there are fewer of them than ranks. It depends on the data set and the number of
    /// ranks only, so that a set which was interrupted goes on in the same way.
    fn of(loaded: &Loaded, recipe: &Recipe, ranks: &Ranks) -> Result<Self, Error> {
        if ranks.size() == 1 {
            return Ok(Self::Apart);
        }
        let is_sharing_worth = |&particles: &usize| particles >= LARGE || recipe.jobs().len() < ranks.size();
        let particles = shared_particles(&loaded.config, ranks)?.filter(is_sharing_worth);
        Ok(particles.map_or(Self::Apart, |particles| Self::Together { particles }))
    }
}

/// The trajectories of a data set, and who makes them.
struct Work<'a> {
    store: &'a Store,
    loaded: &'a Loaded,
    recipe: &'a Recipe,
    ranks: &'a Ranks,
    who: Who,
}

impl Work<'_> {
    /// Makes those of the given trajectories that are not there yet. All ranks do so, and know of all when they are done.
    fn share(&self, mine: &[Job]) -> anyhow::Result<Made> {
        let clock = Instant::now();
        let own = self.missing_of(mine);
        if let Who::Together { .. } = self.who {
            return own.map(|own| Made { seconds: clock.elapsed().as_secs_f64(), ..own });
        }
        let numbers = own.as_ref().map_or([0.0; 3], |own| [own.made, own.kept, own.workers].map(|count| count as f64));
        // Also where this one was stopped: the others wait here.
        let all = self.ranks.sum(&numbers);
        own?;
        let [made, kept, workers] = [0, 1, 2].map(|k| all[k] as usize);
        Ok(Made { made, kept, workers, seconds: clock.elapsed().as_secs_f64() })
    }

    /// This rank's part of [`Self::share`].
    fn missing_of(&self, mine: &[Job]) -> anyhow::Result<Made> {
        let store = self.store;
        let todo: Vec<Job> = mine.iter().copied().filter(|&job| !store.part(job).is_file()).collect();
        for &job in mine.iter().filter(|job| !todo.contains(job)) {
            open(&store.part(job), "trajectory").map_err(|error| {
                BadInput::new(error.to_string())
                    .place(format!("--out {}", store.folder.display()))
                    .allowed("trajectories as they were written")
                    .advice(format!("remove {} and give the same command again", store.part(job).display()))
            })?;
        }
        let workers = self.make(&todo)?;
        Ok(Made { made: todo.len(), kept: mine.len() - todo.len(), workers, ..Made::default() })
    }

    /// Makes trajectories with as many workers as threads, or one after the other with all ranks; returns the number of workers.
    fn make(&self, jobs: &[Job]) -> anyhow::Result<usize> {
        let threads = threads_of(self.ranks, self.loaded.config.run.threads);
        let bar = Progress::new((jobs.len() * self.recipe.frames) as u64, "generate");
        let (workers, made) = match self.who {
            Who::Together { .. } => {
                use_threads(threads);
                // All ranks have looked for what is missing before the first one writes any of it.
                self.ranks.wait();
                (self.ranks.size(), jobs.iter().try_for_each(|&job| self.one(job, &bar, self.ranks)))
            }
            Who::Apart => {
                // Workers are independent; operators with several threads would only wait for each other.
                use_threads(1);
                let workers = workers(threads, jobs.len());
                (workers, share_out(workers, jobs, |&job| self.one(job, &bar, &Ranks::ALONE)).map(drop))
            }
        };
        bar.finish();
        made.map(|()| workers)
    }

    fn one(&self, job: Job, bar: &Progress, ranks: &Ranks) -> anyhow::Result<()> {
        let Self { store, loaded, recipe, .. } = self;
        let ready = recipe.ready(loaded, job)?;
        let progress = || bar.done(1);
        let trajectory = match ready.config.run.precision {
            Precision::F32 => record::<f32>(&ready, &progress, ranks)?,
            Precision::F64 => record::<f64>(&ready, &progress, ranks)?,
        };
        let Some(mut trajectory) = trajectory else { return Ok(()) };
        if recipe.objective {
            let (value, by_nodes) = objective(loaded, &trajectory.wall_offset)?;
            (trajectory.objective, trajectory.objective_gradient) = (Some(value), by_nodes);
        }
        let provenance = Provenance {
            configuration: ready.config.recorded()?,
            seed: ready.config.run.seed,
            version: VERSION.into(),
            wall: ready.wall,
        };
        match store.write_part(job, &trajectory, &provenance) {
            // Another process has made and merged all of them.
            Err(_) if store.is_complete() => {}
            result => result?,
        }
        bar.message(job.to_string());
        Ok(())
    }
}

/// The trajectories that all processes of a command made or found.
#[derive(Default)]
struct Made {
    made: usize,
    kept: usize,
    seconds: f64,
    workers: usize,
}

/// The answer to `--json`, for a finished or unfinished data set.
fn summary(store: &Store, recipe: &Recipe, Made { made, kept, seconds, workers }: Made) -> anyhow::Result<Value> {
    let folder = &store.folder;
    let is_complete = store.is_complete();
    let missing = if is_complete { 0 } else { store.missing(recipe).len() };
    let metadata = is_complete.then(|| Metadata::read(folder)).transpose()?;
    let [train, valid, test] = recipe.trajectories;
    Ok(json!({
        "folder": machine::path(folder),
        "complete": is_complete,
        "missing": missing,
        "trajectories": { "train": train, "valid": valid, "test": test },
        "frames": recipe.frames,
        "particles": metadata.as_ref().map(|metadata| metadata.num_particles_max),
        "files": machine::paths_in(folder, ["train.h5", "valid.h5", "test.h5", "metadata.json", PAGE]),
        "metadata": metadata,
        "made": made,
        "kept": kept,
        "seconds": seconds,
        "workers": workers,
    }))
}

/// The command-line option of a number of the recipe.
fn option_of(recipe: &Recipe, key: &str) -> String {
    match key {
        "frames" => format!("--frames {}", recipe.frames),
        "every" => format!("--every {}", recipe.every),
        "relax" => format!("--relax {}", recipe.relax),
        _ => format!("--{key}"),
    }
}

pub fn merge(arguments: MergeArguments) -> anyhow::Result<()> {
    let store = Store::new(&arguments.folder);
    let Some(begun) = store.begun()? else {
        return Err(BadInput::new(format!("no file {}", store.begun_path().display()))
            .place(arguments.folder.display().to_string())
            .allowed("the --out of `hydrograd generate`")
            .into());
    };
    let config = Config::load(Some(&store.config_path().to_string_lossy()), None, &[])?.config;
    let own = RunFolder::share(&arguments.folder, KIND)?;
    let is_merged = store.is_complete();
    finish(&store, &config, &begun.recipe)?;
    let kept = begun.recipe.jobs().len();
    let mut answer = summary(&store, &begun.recipe, Made { kept, ..Made::default() })?;
    answer["merged_before"] = is_merged.into();
    machine::answer(&answer);
    own.finish()
}

fn finish(store: &Store, config: &Config, recipe: &Recipe) -> anyhow::Result<()> {
    store.merge(config, recipe)?;
    page::write(&store.folder)?;
    let size = |split: Split| std::fs::metadata(split.path(&store.folder)).map_or(0, |file| file.len());
    let sizes = Split::ALL.map(|split| format!("{} {}", split.name(), bytes(size(split) as usize))).join(", ");
    let folder = store.folder.display();
    println!("files in {folder}: train.h5, valid.h5, test.h5, metadata.json ({sizes}), {PAGE}");
    println!("next: hydrograd dataset inspect {folder}");
    Ok(())
}

/// Returns an error if the folder was started with other settings, or has other content.
fn check_same(store: &Store, loaded: &Loaded, recipe: &Recipe) -> Result<(), Error> {
    let place = format!("--out {}", store.folder.display());
    let Some(begun) = store.begun()? else {
        if Split::ALL.iter().any(|split| split.path(&store.folder).exists()) {
            return Err(BadInput::new("the folder holds a data set that `hydrograd generate` did not make")
                .place(place)
                .allowed("a new folder, or one that `hydrograd generate` began")
                .advice("another --out")
                .into());
        }
        return Ok(());
    };
    let theirs = Config::load(Some(&store.config_path().to_string_lossy()), None, &[])?.config;
    let (before, now) = (json!(begun.recipe), json!(recipe));
    let other_key = || before.as_object()?.iter().find(|(key, value)| now.get(*key) != Some(*value));
    let of_recipe = || other_key().map(|(key, value)| format!("{key} = {value}, not {}", now[key]));
    let of_version = || (begun.version != VERSION).then(|| format!("version {}, not {VERSION}", begun.version));
    let what = difference(&theirs, &loaded.config, &FREE).or_else(of_recipe).or_else(of_version);
    what.map_or(Ok(()), |what| {
        Err(BadInput::new(format!("the folder was begun with {what}"))
            .place(place)
            .allowed("the same scene, settings, seed, trajectories, frames, every, skip, relax and walls; shards and threads may differ")
            .advice("another --out, or remove the folder")
            .into())
    })
}

pub fn parse_trajectories(text: &str) -> Result<[usize; 3], String> {
    let counts: Option<Vec<usize>> = text.split('/').map(|part| part.parse().ok()).collect();
    let counts = counts.and_then(|counts| counts.try_into().ok());
    counts.ok_or_else(|| "allowed: TRAIN/VALID/TEST, three whole numbers, for example 100/50/50".to_string())
}
