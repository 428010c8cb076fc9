//! `hydrograd optimize`: searches for the best wall.

use super::arguments::{
    given, name_of, option, CommonArguments, ExplainArgument, GradientArguments, OverwriteArgument, ResumeArgument,
};
use super::explain::explain;
use super::optimize_report::Outcome;
use super::optimize_search::{follow, has_its_epochs, one, Begin, KIND};
use super::optimize_starts::{check_begun, every_start, share_of_starts, starts_of_rank, StartName, STARTS};
use super::prepare::{open_device, use_threads_of};
use super::ranks::check_design;
use super::run_folder::{earlier, is_finished, Earlier, RunFolder};
use super::shard::{Shard, ShardArgument};
use super::{around_optimize, figure_errors, files, optimize_compare, page, verify};
use crate::config::layers::Setting;
use crate::config::scene::{DynamicsName, Family, Trust};
use crate::error::{BadInput, Error};
use crate::numerics::interrupt;
use crate::numerics::ranks::Ranks;
use crate::report::progress::Tasks;
use crate::scene::load::Loaded;
use crate::scene::verification::Verification;
use clap::Args;
use std::path::PathBuf;

/// Shape the hot wall so that the fluid carries out more heat (the main job).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd optimize
      the heated channel from a flat wall, in less than a minute on two cores
  hydrograd optimize --start all --out runs/starts
      from four start shapes, compared in one plot
  hydrograd optimize --start all --out runs/starts --shard 0/4
      the first start alone, perhaps on another machine with the same disk; `hydrograd optimize --start all --resume
      runs/starts` then compares all (`hydrograd slurm optimize --start all` writes a job array of it)
  hydrograd optimize --preset report --start random --seed 7
      the original report's settings, from a random wall
  hydrograd optimize --no-verify
      without the checks of the gain that follow (`hydrograd verify` makes them later)
  hydrograd optimize --memory 20MB --explain
      the schedule that fits into 20 MB, with its storage and the steps run again
  hydrograd optimize --dynamics surrogate --trust check=4
      a learned model judges the walls (B-splines then, unless told otherwise), the solver every fourth of them
  hydrograd optimize --dynamics surrogate --trust region --epochs 8
      the solver judges what the corrected model proposes near the best wall so far
  hydrograd optimize --compare --out runs/compared
      solver, surrogate, both, a trust region and CMA-ES: gain, steps of the solver, time, memory, gradients
  hydrograd optimize data/scenes/examples/cylinder.toml
      a scene of your own: the numbers of its shapes that its `variables` name
  hydrograd optimize --resume runs/optimize-heated-channel --epochs 80
      go on with a run, up to 80 epochs in all")]
pub struct OptimizeArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub resume: ResumeArgument,
    #[command(flatten)]
    pub overwrite: OverwriteArgument,
    #[command(flatten)]
    pub explain: ExplainArgument,
    #[command(flatten)]
    pub gradient: GradientArguments,
    /// Start shape (design.shape); `all` runs flat, random, linear and sine, as many at once as there are threads, and compares
    /// them.
    #[arg(long, value_enum)]
    pub start: Option<StartName>,
    /// How the next wall is found: l-bfgs-b or adam (optimise.method).
    #[arg(long, visible_alias = "optimizer", value_name = "NAME")]
    pub optimiser: Option<String>,
    /// Length of the optimiser's steps (optimise.learning_rate).
    #[arg(long, value_name = "X", allow_hyphen_values = true)]
    pub learning_rate: Option<String>,
    /// How far the wall may move, up and down (design.bound).
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    pub bound: Option<String>,
    /// Optimiser steps (optimise.epochs).
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
    /// Who judges walls while the optimiser searches (optimise.dynamics). What is found is judged by the solver in any case.
    #[arg(long, value_enum)]
    pub dynamics: Option<DynamicsName>,
    /// A surrogate of `hydrograd train` [default: the built-in one, see models/heated-channel] (surrogate.model).
    #[arg(long, value_name = "FILE")]
    pub model: Option<String>,
    /// How the surrogate is kept honest: none; check=N, the solver judges every N-th wall (default 5); region, a trust region, in
    /// which the solver judges what the corrected surrogate proposes in each epoch (surrogate.trust).
    #[arg(long, value_name = "none|check[=N]|region", value_parser = parse_trust)]
    pub trust: Option<(Trust, Option<usize>)>,
    /// Run every way to search (solver, surrogate, checked surrogate, trust region, both, CMA-ES without gradients) and compare them.
    #[arg(long, conflicts_with_all = ["dynamics", "trust", "start"])]
    pub compare: bool,
    /// Do not check the gain at another spacing, with other particles, over a longer time and from another seed.
    #[arg(long)]
    pub no_verify: bool,
    /// Choose the spacing at which the error of the first design's figure is at most this share of it, such as 0.2%.
    #[arg(long, value_name = "SHARE", value_parser = figure_errors::share, conflicts_with_all = ["resume", "shard"])]
    pub accuracy: Option<f64>,
    #[command(flatten)]
    pub shard: ShardArgument,
}

impl OptimizeArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        self.common.require_design()?;
        let mut options = self.gradient.settings();
        options.extend(given([
            ("--optimiser", "optimise.method", &self.optimiser),
            ("--learning-rate", "optimise.learning_rate", &self.learning_rate),
            ("--bound", "design.bound", &self.bound),
        ]));
        options.extend(self.epochs.map(|value| option("optimise.epochs", value)));
        options.extend(self.start.and_then(StartName::setting));
        options.extend(self.dynamics.map(|value| option("optimise.dynamics", name_of(value))));
        options.extend(self.model.as_ref().map(|file| option("surrogate.model", format!("{file:?}"))));
        if let Some((trust, every)) = self.trust {
            options.push(option("surrogate.trust", name_of(trust)));
            options.extend(every.map(|every| Setting::option("--trust", "surrogate.check_every", every)));
        }
        let loaded = self.common.load(self.resume.resume.as_deref(), vec![], options)?;
        if loaded.config.scene == Family::Custom && (self.compare || self.start == Some(StartName::All)) {
            let option = if self.compare { "--compare" } else { "--start all" };
            return Err(BadInput::new(format!("{option} of a scene of one's own, whose shapes begin as they are"))
                .place(option)
                .allowed("a scene with a hot wall: heated-channel")
                .into());
        }
        Ok(loaded)
    }

    pub fn folder(&self, loaded: &Loaded) -> Result<PathBuf, Error> {
        self.common.folder(self.resume.resume.as_deref(), "optimize", loaded)
    }

    /// The requested share of the starts; none for a single search, also in a job array.
    fn share(&self) -> Result<Option<Shard>, BadInput> {
        let bad = |problem: &str, allowed: &str| Err(BadInput::new(problem).place("--shard").allowed(allowed));
        match (self.kind(), self.shard.shard) {
            (STARTS, _) if self.overwrite.overwrite && self.shard.share()?.is_some() => bad(
                "--overwrite of one share would lose those of the others",
                "a new folder, or one that the shares began",
            ),
            (STARTS, _) => self.shard.share(),
            (_, Some(_)) => bad("a single search has no shares", "--start all, whose starts are shared out"),
            (_, None) => Ok(None),
        }
    }

    /// The given folder, or if it was not named and has a finished run, one with the next number.
    pub(super) fn free(&self, folder: PathBuf) -> PathBuf {
        if self.common.out.is_some() || self.resume.resume.is_some() || self.overwrite.overwrite {
            return folder;
        }
        let numbered = |k: usize| PathBuf::from(format!("{}-{k}", folder.display()));
        std::iter::once(folder.clone()).chain((2..).map(numbered)).find(|free| !is_finished(free)).unwrap_or(folder)
    }

    pub(super) fn kind(&self) -> &'static str {
        match self.start {
            _ if self.compare => "optimize --compare",
            Some(StartName::All) => STARTS,
            _ => KIND,
        }
    }
}

fn parse_trust(text: &str) -> Result<(Trust, Option<usize>), String> {
    match (text, text.strip_prefix("check=").map(str::parse)) {
        ("none", _) => Ok((Trust::None, None)),
        ("region", _) => Ok((Trust::Region, None)),
        ("check", _) => Ok((Trust::Check, None)),
        (_, Some(Ok(every))) if every > 0 => Ok((Trust::Check, Some(every))),
        _ => Err("allowed: none, check, check=N with a whole number N >= 1, region".into()),
    }
}

/// Checks that several ranks can share a search.
pub(super) fn check_shared(loaded: &Loaded, arguments: &OptimizeArguments) -> Result<(), Error> {
    let alone = |place: &str, problem: &str| {
        let bad = BadInput::new(format!("{problem} over several ranks")).place(place);
        Err(bad.allowed("one search, judged by the solver").advice("start it without mpirun").into())
    };
    if arguments.compare {
        return alone("--compare", "a comparison of searches");
    }
    if arguments.accuracy.is_some() {
        return alone("--accuracy", "the choice of a spacing");
    }
    if arguments.shard.share()?.is_some() {
        return alone("--shard", "a share of the starts");
    }
    if arguments.start == Some(StartName::All) {
        // Each makes whole searches.
        return Ok(());
    }
    if loaded.config.optimise.dynamics != DynamicsName::Solver {
        return alone("optimise.dynamics", "a surrogate");
    }
    let searched = loaded.for_search()?;
    if loaded.config.method.facts().moves && !searched.config.method.facts().moves {
        let problem = "a search by fixed particles over several ranks: one matrix of the whole flow is solved";
        let bad = BadInput::new(problem).key("optimise.search").allowed("scene: by the particles of the scene");
        return Err(loaded.located(bad.advice("optimise.search=scene, or start it without mpirun")).into());
    }
    Ok(check_design(&searched)?)
}

pub fn run(loaded: Loaded, arguments: OptimizeArguments, ranks: &Ranks) -> anyhow::Result<()> {
    if ranks.size() > 1 {
        check_shared(&loaded, &arguments)?;
    }
    let share = arguments.share()?;
    let folder = match share {
        // All shares use the same folder.
        Some(_) => arguments.folder(&loaded)?,
        None => arguments.free(arguments.folder(&loaded)?),
    };
    use_threads_of(ranks, loaded.config.run.threads);
    if ranks.rank() > 0 {
        interrupt::listen_quietly()?;
        return match arguments.kind() {
            STARTS => starts_of_rank(&loaded, &folder, ranks),
            _ => follow(&loaded, ranks),
        };
    }
    open_device(&loaded)?;
    if arguments.explain.explain {
        return explain(&loaded.for_search()?, true);
    }
    let resume = arguments.resume.resume.as_deref();
    // A share also continues what other shares started.
    let otherwise = Earlier::of_options(share.is_some(), arguments.overwrite.overwrite);
    let (kind, earlier) = (arguments.kind(), earlier(&folder, resume, otherwise));
    RunFolder::check(&folder, kind, earlier)?;
    let of_share = share.map_or(String::new(), |shard| format!(" --shard {}/{}", shard.index, shard.count));
    interrupt::listen(format!("hydrograd {kind} --resume {}{of_share}", folder.display()))?;
    let loaded = match arguments.accuracy {
        None => loaded,
        Some(accuracy) => {
            let at = figure_errors::Spacings::default().accurate(&loaded.for_search()?, accuracy)?;
            loaded.with(&figure_errors::at_spacing(&loaded, at.config.resolution.dx))?
        }
    };
    if kind != KIND {
        if share.is_some() {
            check_begun(&folder, &loaded)?;
        }
        // A finished comparison of all parts stays as it is. (Others that wait for this rank end with its error.)
        if earlier == Earlier::Resumed && is_finished(&folder) {
            let epochs = files::read_config(&folder)?.config.optimise.epochs;
            if loaded.config.optimise.epochs <= epochs {
                let option = if share.is_some() { "--shard" } else { "--resume" };
                return Err(has_its_epochs(epochs).place(option).into());
            }
        }
        if let Some(shard) = share {
            return share_of_starts(&loaded, &folder, shard);
        }
        let earlier = match ranks.size() {
            1 => earlier,
            several => {
                println!("{several} ranks: each searches from starts of its own");
                starts_of_rank(&loaded, &folder, ranks)?;
                Earlier::Resumed
            }
        };
        let own = RunFolder::take(&folder, kind, earlier)?;
        // The parts are finished only after all of them, because the comparison uses each.
        let parts = match arguments.compare {
            true => optimize_compare::run(&loaded, &folder, earlier)?,
            false => every_start(&loaded, &folder, earlier, !arguments.no_verify)?,
        };
        parts.iter().try_for_each(|part| page::write(part.folder()))?;
        page::write(&folder)?;
        own.finish()?;
        return parts.iter().try_for_each(RunFolder::finish);
    }
    let searched = loaded.for_search()?;
    if searched.config.is_around_shapes() {
        return around_optimize::run(&searched, &folder, earlier, !arguments.no_verify);
    }
    let begin = Begin { folder: &folder, resume, earlier, name: "", tasks: &Tasks::default(), ranks: Some(ranks) };
    let (own, outcome) = one(&loaded, begin)?;
    println!("{}", outcome.text);
    println!(
        "next: hydrograd simulate {} --set resolution.dx={} --out runs/finer    runs the best design at a finer spacing",
        folder.join(files::BEST).display(),
        loaded.config.finer_spacing()
    );
    if !arguments.no_verify {
        let Outcome { first, best, record, .. } = outcome;
        verify::of_search(&folder, record, &Verification::of_search(&loaded, Some(first), best)?)?;
    }
    page::write(&folder)?;
    own.finish()
}
