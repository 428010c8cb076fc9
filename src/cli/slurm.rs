//! `hydrograd slurm`: job files for Slurm, for any command whose work can be divided or resumed.
//!
//! A job is an array if the command has shares (see `shard.rs`); another job merges them after all have
//! succeeded. Every job may be stopped and requeued at any time: its results are kept, and it continues with the rest.

use super::arguments::{at_least_one, check_text};
use super::files::CHECKPOINT;
use super::optimize::OptimizeArguments;
use super::optimize_starts::{StartName, STARTS};
use super::run_folder::{holds_results, Earlier, RunFolder, MARKER};
use super::{files, machine, optimize, program, simulate, Cli, Command};
use crate::error::{BadInput, Error};
use crate::io::atomic::write_bytes_atomically;
use clap::error::ErrorKind;
use clap::{Args, Parser};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process;

/// Write job files for Slurm: an array of shares and a job that puts them together, or one job; all of them go on when requeued.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
An array: generate, stress, study, validate, optimize --start all. One job: simulate, train, optimize. A minute before its
time limit (or by `scancel --signal=TERM --batch JOB`) a job keeps what there is, is queued again, and goes on. `scancel JOB`
ends it.

Examples:
  hydrograd slurm --tasks 20 --time 02:00:00 generate heated-channel --out data/heated
      slurm-generate.sh, an array of twenty tasks, and slurm-generate-merge.sh, which merges what they made
  hydrograd slurm --submit --partition long stress --out runs/stress
      the same of maps, and into the queue with both
  hydrograd slurm --cpus 8 --memory 16G --time 1-00 train --data data/heated --steps 200000 --out runs/gns
      one job of eight cores
  hydrograd slurm --option=--account=project --option=--mail-type=END optimize --start all --out runs/starts
      with other options of sbatch's
  hydrograd slurm --print validate --quick
      what it would write")]
pub struct SlurmArguments {
    /// The job file [default: slurm-COMMAND.sh]; the one that puts shares together has -merge in its name.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print the job files and write none.
    #[arg(long, conflicts_with_all = ["out", "submit"])]
    pub print: bool,
    /// Give the jobs to Slurm, too.
    #[arg(long)]
    pub submit: bool,
    /// Tasks of an array [default: as many as there are pieces of work, at most 8].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub tasks: Option<usize>,
    /// Time limit of each job and task; what is not done then is gone on with.
    #[arg(long, value_name = "HH:MM:SS", default_value = "01:00:00", value_parser = time)]
    pub time: String,
    /// Cores of each job, task or rank, and the command's --threads unless it has that option.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = at_least_one)]
    pub cpus: usize,
    /// Partition [default: the cluster's].
    #[arg(long, value_name = "NAME", value_parser = name)]
    pub partition: Option<String>,
    /// Memory of each job or task [default: the cluster's].
    #[arg(long, value_name = "SIZE", value_parser = memory)]
    pub memory: Option<String>,
    /// Processes of a training, a simulation or a search that is shared out by MPI.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub ranks: Option<usize>,
    /// Another option of sbatch's, e.g. `--option=--qos=long`; may be repeated, and wins over those above.
    #[arg(long = "option", value_name = "OPTION", allow_hyphen_values = true, value_parser = sbatch_option)]
    pub options: Vec<String>,
    /// The command as it would be typed without Slurm.
    #[arg(value_name = "COMMAND", required = true, trailing_var_arg = true, allow_hyphen_values = true)]
    pub command: Vec<String>,
}

/// Default largest number of tasks of an array.
const USUAL_TASKS: usize = 8;
/// Seconds before the time limit at which a job is signalled, and the shortest time limit: Slurm may be a minute early.
const NOTICE: u64 = 60;
const SHORTEST: u64 = 3 * NOTICE;
/// Number of requeues after which a job is given up.
const MOST_RESTARTS: usize = 100;
/// The mark of our job files, which may be overwritten.
const OURS: &str = "# Written by `hydrograd slurm`";

/// A job: its command, and how it is resumed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Job {
    /// The job's name without `hydrograd-`.
    pub name: String,
    /// Number of tasks of an array.
    pub tasks: Option<usize>,
    /// Number of MPI processes.
    pub ranks: Option<usize>,
    /// The command without `hydrograd`, and for an array without the share.
    pub command: Vec<String>,
    /// If this file exists, the job is resumed with this command.
    pub resumed: Option<(PathBuf, Vec<String>)>,
    /// If this file says that the run is finished, nothing is left to do.
    pub marker: Option<PathBuf>,
}

/// Resources and settings of the jobs.
#[derive(Debug, Clone, PartialEq)]
pub struct Wanted {
    pub time: String,
    pub cpus: usize,
    pub partition: Option<String>,
    pub memory: Option<String>,
    pub options: Vec<String>,
    /// The words that start this program.
    pub program: Vec<String>,
    /// The working directory of the command, to which its paths are relative.
    pub folder: String,
}

pub fn run(arguments: &SlurmArguments) -> anyhow::Result<()> {
    arguments.out.as_deref().map_or(Ok(()), check_text)?;
    let Some((main, merge)) = jobs(arguments)? else { return Ok(()) };
    let wanted = Wanted {
        time: arguments.time.clone(),
        cpus: arguments.cpus,
        partition: arguments.partition.clone(),
        memory: arguments.memory.clone(),
        options: arguments.options.clone(),
        program: program::words()?.iter().map(|word| word.display().to_string()).collect(),
        folder: std::env::current_dir()?.display().to_string(),
    };
    let file = arguments.out.clone().unwrap_or_else(|| PathBuf::from(format!("slurm-{}.sh", main.name)));
    let mut scripts = vec![(file.clone(), main.text(&wanted, &file)?)];
    if let Some(merge) = &merge {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let file = file.with_file_name(format!("{stem}-merge.sh"));
        scripts.push((file.clone(), merge.text(&wanted, &file)?));
    }
    if arguments.print {
        let all: String = scripts.iter().map(|(_, text)| text.as_str()).collect();
        let of_file = |(file, text): &(PathBuf, String)| json!({ "file": machine::path(file), "text": text });
        let files: Vec<_> = scripts.iter().map(of_file).collect();
        machine::answer(&json!({ "files": files, "tasks": main.tasks }));
        return Ok(files::print(all.as_bytes())?);
    }
    scripts.iter().try_for_each(|(file, _)| check_ours(file))?;
    for (file, text) in &scripts {
        write_bytes_atomically(file, text.as_bytes())?;
    }
    let names: Vec<String> = scripts.iter().map(|(file, _)| file.display().to_string()).collect();
    let tasks = main.tasks.map_or(String::new(), |tasks| format!(", an array of {tasks} tasks"));
    println!("files: {}{tasks}", names.join(" and "));
    let line = next(&scripts);
    let mut numbers = Vec::new();
    if arguments.submit {
        for (file, _) in &scripts {
            numbers.push(submit(file, numbers.first())?);
        }
        println!("jobs: {}", numbers.join(" and then "));
        println!("next: squeue --job {}    scancel ends a job", numbers.join(","));
    } else {
        println!("next: {line}");
    }
    machine::answer(&json!({ "files": names, "tasks": main.tasks, "jobs": numbers, "submit": line }));
    Ok(())
}

/// The shell command that submits the jobs.
pub fn next(scripts: &[(PathBuf, String)]) -> String {
    let words: Vec<String> = scripts.iter().map(|(file, _)| quoted(&file.display().to_string())).collect();
    match &words[..] {
        [main, merge] => format!("job=$(sbatch --parsable {main}) && sbatch --dependency=afterok:$job {merge}"),
        words => format!("sbatch {}", words.join(" ")),
    }
}

/// Submits a job, to start after another one has succeeded, and returns its number.
fn submit(file: &Path, after: Option<&String>) -> anyhow::Result<String> {
    let advice = "where the cluster's sbatch is, or without --submit";
    let mut sbatch = process::Command::new("sbatch");
    sbatch.arg("--parsable").args(after.map(|job| format!("--dependency=afterok:{job}"))).arg(file);
    let output = sbatch.output().map_err(|error| Error::run(format!("can not start sbatch: {error}"), advice))?;
    let (said, number) = (String::from_utf8_lossy(&output.stderr), String::from_utf8_lossy(&output.stdout));
    // The output is `12;cluster` if there are several clusters.
    let number = number.trim().split(';').next().unwrap_or_default().to_string();
    match output.status.success() && !number.is_empty() {
        true => Ok(number),
        false => Err(Error::run(format!("sbatch {}: {}", file.display(), said.trim()), advice).into()),
    }
}

/// Checks that a file to be overwritten is one of our job files.
fn check_ours(file: &Path) -> Result<(), BadInput> {
    match std::fs::read_to_string(file) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Ok(text) if text.contains(OURS) => Ok(()),
        _ => Err(BadInput::new(format!("{} is there, and no job file of `hydrograd slurm`", file.display()))
            .place(format!("--out {}", file.display()))
            .allowed("a new file, or one that it wrote")
            .advice("another --out")),
    }
}

/// The job of the command, and the job that merges its shares. None if only help was requested.
pub fn jobs(arguments: &SlurmArguments) -> anyhow::Result<Option<(Job, Option<Job>)>> {
    let mut typed = arguments.command.as_slice();
    if typed.first().is_some_and(|word| word == "hydrograd") {
        typed = &typed[1..];
    }
    let line = || format!("hydrograd {}", typed.join(" "));
    let cli = match Cli::try_parse_from(std::iter::once("hydrograd").chain(typed.iter().map(String::as_str))) {
        Ok(cli) => cli,
        Err(error) if [ErrorKind::DisplayHelp, ErrorKind::DisplayVersion].contains(&error.kind()) => {
            files::print(error.to_string().as_bytes())?;
            return Ok(None);
        }
        Err(error) => {
            return Err(BadInput::new(error.to_string().trim().trim_start_matches("error: "))
                .place(line())
                .allowed("a command as it would be typed without Slurm")
                .into());
        }
    };
    for (option, why) in [
        ("--shard", "each task of the array has a share of its own"),
        ("--overwrite", "a job that goes on would lose what it has"),
        ("--list", "it only prints"),
        ("--explain", "it only prints"),
        ("--print-config", "it only prints"),
    ] {
        if has(typed, option) {
            return Err(BadInput::new(format!("{option} in a job: {why}"))
                .place(line())
                .allowed("the command without it")
                .into());
        }
    }
    let Shares { mut main, merge, pieces } = shares(&cli, Words { typed, cpus: arguments.cpus, json: cli.json })?;
    main.ranks = arguments.ranks;
    match (main.ranks, &cli.command) {
        (None, _) | (_, Command::Train(_)) => {}
        (_, Command::Simulate(own)) => simulate::check_shared(&own.load()?, own)?,
        (_, Command::Optimize(own)) if merge.is_none() => optimize::check_shared(&own.load()?, own)?,
        (Some(ranks), _) => {
            return Err(BadInput::new(format!("a job of {} has no ranks", line()))
                .place(format!("--ranks {ranks}"))
                .allowed("train, simulate, optimize from one start")
                .advice("--tasks for what has shares")
                .into());
        }
    }
    let bad = |tasks: usize, problem: String, allowed: &str| {
        Err(BadInput::new(problem).place(format!("--tasks {tasks}")).allowed(allowed).into())
    };
    main.tasks = match arguments.tasks {
        None => merge.is_some().then_some(pieces.min(USUAL_TASKS)),
        Some(tasks) if merge.is_none() => {
            let allowed = "of generate, stress, study, validate and optimize --start all";
            return bad(tasks, format!("{} is one run, without shares", line()), allowed);
        }
        Some(tasks) if tasks > pieces => {
            return bad(tasks, format!("there are {pieces} pieces of work"), &format!("1 ... {pieces}"));
        }
        tasks => tasks,
    };
    Ok(Some((main, merge)))
}

/// Whether an option is given, as `--option value` or `--option=value`.
fn has(words: &[String], option: &str) -> bool {
    words.iter().any(|word| word.strip_prefix(option).is_some_and(|rest| rest.is_empty() || rest.starts_with('=')))
}

/// The words of a command as typed, and what it is given besides.
#[derive(Clone, Copy)]
struct Words<'a> {
    typed: &'a [String],
    cpus: usize,
    json: bool,
}

impl Words<'_> {
    /// The words as typed, with the common folder and the number of threads added.
    fn whole(&self, folder: &Path) -> Vec<String> {
        let mut words = self.typed.to_vec();
        for (option, value) in [("--out", folder.display().to_string()), ("--threads", self.cpus.to_string())] {
            if !has(&words, option) {
                words.extend([option.into(), value]);
            }
        }
        words
    }

    /// The words of another command that continues what this one started in a folder.
    fn other<'w>(&self, words: impl IntoIterator<Item = &'w str>, folder: &Path) -> Vec<String> {
        let words = words.into_iter().map(str::to_string).chain([folder.display().to_string()]);
        words.chain(self.json.then(|| "--json".to_string())).collect()
    }
}

/// How a command is divided into shares.
struct Shares {
    main: Job,
    /// None for a command without shares.
    merge: Option<Job>,
    /// Number of pieces of its work.
    pieces: usize,
}

impl Shares {
    /// An array, and the job that merges its shares.
    fn array(name: &str, pieces: usize, command: Vec<String>, merge: Vec<String>) -> Self {
        let main = Job { name: name.into(), command, ..Job::default() };
        let merge = Job { name: format!("{name}-merge"), command: merge, ..Job::default() };
        Self { main, merge: Some(merge), pieces }
    }

    fn single(main: Job) -> Self {
        Self { main, merge: None, pieces: 1 }
    }
}

/// Returns an error if a job would continue a run without `--resume`.
fn check_new(folder: &Path, kind: &'static str, resumes: bool) -> Result<(), BadInput> {
    RunFolder::check(folder, kind, Earlier::Resumed)?;
    match resumes || !holds_results(folder) {
        true => Ok(()),
        false => Err(BadInput::new(format!("{} holds a run of `hydrograd {kind}` already", folder.display()))
            .place(format!("--out {}", folder.display()))
            .allowed("a new folder, or --resume, which goes on with what is there")
            .advice("another --out")),
    }
}

/// The shares of each command. All errors of the command are found here, before it is queued.
fn shares(cli: &Cli, words: Words<'_>) -> anyhow::Result<Shares> {
    let also = |mut words: Vec<String>, option: &str| {
        if !has(&words, option) {
            words.push(option.into());
        }
        words
    };
    let with_resume = |kind: &'static str, folder: &Path, resumes: bool, pieces: usize| {
        check_new(folder, kind, resumes)?;
        let whole = words.whole(folder);
        Ok::<_, BadInput>(Shares::array(kind, pieces, whole.clone(), also(whole, "--resume")))
    };
    Ok(match &cli.command {
        Command::Generate(own) => {
            let loaded = own.common.load(None, vec![], vec![])?;
            let (recipe, folder) = (own.recipe(&loaded)?, own.common.folder(None, "generate", &loaded)?);
            recipe.check(&loaded)?;
            RunFolder::check(&folder, "generate", Earlier::Replaced)?;
            let merge = words.other(["merge"], &folder);
            Shares::array("generate", recipe.jobs().len(), words.whole(&folder), merge)
        }
        Command::Stress(own) => with_resume("stress", &own.out, own.resume, own.jobs(&own.maps()?)?.len())?,
        Command::Validate(own) => with_resume("validate", &own.out, own.resume, own.cases()?.len())?,
        Command::Study(own) => {
            let (_, points, _) = own.study()?;
            let whole = words.whole(&own.out);
            Shares::array("study", points.len(), whole.clone(), whole)
        }
        Command::Optimize(own) => optimize(own, words)?,
        Command::Simulate(own) => {
            let loaded = own.load()?;
            let from = own.resume.resume.as_deref();
            let folder = own.common.folder(from, "simulate", &loaded)?;
            let again = ["simulate"].into_iter().chain(own.recover.then_some("--recover")).chain(["--resume"]);
            one_run("simulate", "simulate", &folder, from, words, words.other(again, &folder))?
        }
        Command::Train(own) => {
            check_new(&own.out, "train", own.resume)?;
            let whole = words.whole(&own.out);
            let job = Job { name: "train".into(), ..Job::default() };
            Shares::single(match own.resume {
                true => Job { command: whole, ..job },
                // A run that ended before its first checkpoint may be overwritten.
                false => Job {
                    command: also(whole.clone(), "--overwrite"),
                    resumed: Some((own.out.join("last.safetensors"), also(without_value(whole, "--init"), "--resume"))),
                    marker: Some(own.out.join(MARKER)),
                    ..job
                },
            })
        }
        _ => {
            let typed = words.typed.join(" ");
            return Err(BadInput::new(format!("`hydrograd {typed}` has no shares, and can not go on"))
                .allowed("generate, stress, study, validate, optimize, simulate, train")
                .advice(format!("sbatch --wrap {}", quoted(&format!("hydrograd {typed}"))))
                .into());
        }
    })
}

/// A single search, or all starts.
fn optimize(own: &OptimizeArguments, words: Words<'_>) -> anyhow::Result<Shares> {
    let loaded = own.load()?;
    let folder = own.free(own.folder(&loaded)?);
    let (kind, from) = (own.kind(), own.resume.resume.as_deref());
    let again = kind.split(' ').chain(own.no_verify.then_some("--no-verify")).chain(["--resume"]);
    let again = words.other(again, &folder);
    if kind != STARTS {
        return one_run("optimize", kind, &folder, from, words, again);
    }
    check_new(&folder, kind, from.is_some_and(|from| from == folder))?;
    let whole = words.whole(&folder);
    let mut shares = Shares::array("optimize", StartName::EACH.len(), whole.clone(), whole);
    if let (None, Some(merge)) = (from, &mut shares.merge) {
        merge.command = again;
        merge.marker = Some(folder.join(MARKER));
        shares.main.marker = merge.marker.clone();
    }
    Ok(shares)
}

/// A run of `simulate` or `optimize` with its configuration in its folder; `again` resumes it.
fn one_run(
    name: &str,
    kind: &'static str,
    folder: &Path,
    from: Option<&Path>,
    words: Words<'_>,
    again: Vec<String>,
) -> anyhow::Result<Shares> {
    let goes_on = from.is_some_and(|from| from == folder);
    check_new(folder, kind, goes_on)?;
    let job = Job { name: name.into(), command: words.whole(folder), ..Job::default() };
    // Several searches have checkpoints in their own folders.
    let begun = if kind == "optimize --compare" { "config.toml" } else { CHECKPOINT };
    Ok(Shares::single(match goes_on {
        // The command itself has the new end.
        true => job,
        false => Job { resumed: Some((folder.join(begun), again)), marker: Some(folder.join(MARKER)), ..job },
    }))
}

/// The words without an option and its value.
fn without_value(words: Vec<String>, option: &str) -> Vec<String> {
    let is_value = |k: usize| k > 0 && words[k - 1] == option;
    let is_kept = |k: &usize| !is_value(*k) && !has(&words[*k..=*k], option);
    (0..words.len()).filter(is_kept).map(|k| words[k].clone()).collect()
}

impl Job {
    /// The text of the job file.
    pub fn text(&self, wanted: &Wanted, file: &Path) -> Result<String, BadInput> {
        let is_array = self.tasks.is_some();
        let log = file.with_extension("").display().to_string().replace('%', "%%");
        let mut options = vec![format!("--job-name=hydrograd-{}", self.name)];
        options.extend(self.tasks.map(|tasks| format!("--array=0-{}", tasks - 1)));
        options.extend([
            format!("--ntasks={}", self.ranks.unwrap_or(1)),
            format!("--cpus-per-task={}", wanted.cpus),
            format!("--time={}", wanted.time),
        ]);
        options.extend(wanted.memory.as_ref().map(|size| format!("--mem={size}")));
        options.extend(wanted.partition.as_ref().map(|name| format!("--partition={name}")));
        options.extend([
            format!("--chdir={}", wanted.folder),
            format!("--output={log}-{}.log", if is_array { "%A_%a" } else { "%j" }),
            "--open-mode=append".to_string(),
            "--requeue".to_string(),
            format!("--signal=B:TERM@{NOTICE}"),
        ]);
        if self.name.ends_with("-merge") {
            // A failed task must not leave the merging job waiting.
            options.push("--kill-on-invalid-dep=yes".into());
        }
        options.extend(wanted.options.iter().cloned());
        let mut text = String::from("#!/bin/bash\n");
        for option in &options {
            text += &format!("#SBATCH {}\n", one_line(&of_sbatch(option))?);
        }
        let share = self.tasks.map_or(String::new(), |tasks| format!(" --shard \"$SLURM_ARRAY_TASK_ID/{tasks}\""));
        let (launch, forward) = match self.ranks {
            // srun does not use all cores of the job by default, and would kill the processes at a signal that does not
            // go through Slurm.
            Some(_) => (
                format!("srun --mpi=pmix --kill-on-bad-exit --cpus-per-task={} ", wanted.cpus),
                "scancel --signal=TERM \"$job\"",
            ),
            None => (String::new(), "kill -TERM \"$child\" 2>/dev/null"),
        };
        let call = |words: &[String]| -> Result<String, BadInput> {
            let words: Vec<String> = wanted.program.iter().chain(words).map(|word| quoted(word)).collect();
            one_line(&format!("set -- {launch}{}{share}", words.join(" ")))
        };
        text += &format!("{OURS} {}, which writes it anew.\n", files::VERSION);
        text += match is_array {
            // One of the tasks has the number of the whole array, so this is the task's own number.
            true => "job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID\n\n",
            false => "job=$SLURM_JOB_ID\n\n",
        };
        if let Some(marker) = &self.marker {
            let marker = one_line(&quoted(&marker.display().to_string()))?;
            text += &format!("if [ \"$(sed -n 2p {marker} 2>/dev/null)\" = finished ]; then\n");
            text += "    echo \"nothing is left to do\"\n    exit 0\nfi\n";
        }
        match &self.resumed {
            None => text += &format!("{}\n", call(&self.command)?),
            Some((begun, resumed)) => {
                let begun = one_line(&quoted(&begun.display().to_string()))?;
                text += &format!("if [ -e {begun} ]; then\n    {}\n", call(resumed)?);
                text += &format!("else\n    {}\nfi\n", call(&self.command)?);
            }
        }
        Ok(text + &BODY.replace("{forward}", forward).replace("{most_restarts}", &MOST_RESTARTS.to_string()))
    }
}

/// The common part of all jobs: runs the command, forwards SIGTERM to it, and requeues the job.
const BODY: &str = include_str!("slurm_job.sh");

/// Quotes a word for a shell.
fn quoted(word: &str) -> String {
    match !word.is_empty() && word.chars().all(|c| c.is_ascii_alphanumeric() || "-_=./,:+@%".contains(c)) {
        true => word.to_string(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

/// Quotes an option for sbatch in a file.
fn of_sbatch(option: &str) -> String {
    match option.split_once('=') {
        Some((name, value)) if !is_plain(value) => {
            format!("{name}=\"{}\"", value.replace('\\', r"\\").replace('"', "\\\""))
        }
        _ => option.to_string(),
    }
}

/// Checks that a text is a single line.
fn one_line(text: &str) -> Result<String, BadInput> {
    match text.contains(['\n', '\r', '\0']) {
        false => Ok(text.to_string()),
        true => Err(BadInput::new(format!("a line break in {text:?}")).allowed("words and names of files of one line")),
    }
}

/// Slurm's notations of a time: `MM`, `MM:SS`, `HH:MM:SS`, `D-HH`, `D-HH:MM`, `D-HH:MM:SS`.
fn time(text: &str) -> Result<String, String> {
    let (days, rest) = text.split_once('-').map_or((None, text), |(days, rest)| (Some(days), rest));
    let numbers: Option<Vec<u64>> = days.into_iter().chain(rest.split(':')).map(|part| part.parse().ok()).collect();
    const UNITS: [u64; 4] = [86_400, 3_600, 60, 1];
    let seconds = numbers.and_then(|numbers| {
        let units = match (days.is_some(), numbers.len()) {
            (true, 2..=4) => &UNITS[..],
            (false, 1 | 2) => &UNITS[2..],
            (false, 3) => &UNITS[1..],
            _ => return None,
        };
        units.iter().zip(numbers).map(|(unit, number)| unit.checked_mul(number)).sum::<Option<u64>>()
    });
    let allowed = "minutes, HH:MM:SS or D-HH:MM:SS, and at least 00:03:00: a job is told to stop a minute before";
    checked(text, seconds.is_some_and(|seconds| seconds >= SHORTEST), allowed)
}

fn memory(text: &str) -> Result<String, String> {
    let number = text.strip_suffix(['K', 'M', 'G', 'T']).unwrap_or(text).parse::<u64>();
    checked(text, number.is_ok_and(|size| size > 0), "a whole number with K, M, G or T behind it, such as 4G")
}

fn name(text: &str) -> Result<String, String> {
    checked(text, !text.is_empty() && is_plain(text), "a name without spaces and quotes, as sinfo prints it")
}

fn sbatch_option(text: &str) -> Result<String, String> {
    let is_option = text.starts_with('-') && !text.contains(char::is_control);
    checked(text, is_option, "an option of sbatch's, such as --option=--qos=long")
}

fn checked(text: &str, is_allowed: bool, allowed: &str) -> Result<String, String> {
    match is_allowed {
        true => Ok(text.to_string()),
        false => Err(format!("allowed: {allowed}")),
    }
}

/// Whether sbatch takes a text without quotes.
fn is_plain(text: &str) -> bool {
    text.chars().all(|c| c.is_ascii_graphic() && !"\"'\\#".contains(c))
}
