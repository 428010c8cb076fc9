//! `hydrograd slurm`: its job files, run by bash as Slurm runs them; what shares that run side by side leave, and what one process does.

use crate::support::program::{hydrograd, refused, succeeds};
use clap::Parser;
use hydrograd::cli::slurm::{jobs, next, Job, Wanted};
use hydrograd::cli::{self, Cli};
use hydrograd::io::tensor_file::TensorFile;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A task of an array, or (none) a job of its own, as Slurm starts it; programs in `bin` come before others of their name.
fn start(at: &Path, script: &str, task: Option<usize>) -> Child {
    let mut bash = Command::new("bash");
    bash.current_dir(at).arg(script).env("SLURM_JOB_ID", "7").env("CANDLE_NUM_THREADS", "1");
    let path = std::env::var("PATH").unwrap();
    bash.env("PATH", format!("{}:{path}", at.join("bin").display()));
    if let Some(task) = task {
        // The count of a part of an array that is given to Slurm again is not the number of shares.
        bash.env("SLURM_ARRAY_JOB_ID", "7")
            .env("SLURM_ARRAY_TASK_ID", task.to_string())
            .env("SLURM_ARRAY_TASK_COUNT", "1");
    }
    bash.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

#[track_caller]
fn ended_well(child: Child, what: &str) -> String {
    let Output { status, stdout, stderr } = child.wait_with_output().unwrap();
    let [out, error] = [stdout, stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    assert!(status.success(), "{what}: {status}: {out}{error}");
    out
}

/// A program that notes how it was called, and says something.
fn stand_in(at: &Path, name: &str, says: &str) {
    let file = at.join("bin").join(name);
    std::fs::create_dir_all(at.join("bin")).unwrap();
    let text = format!("#!/bin/sh\necho {name} \"$@\" >> '{}'\n{says}\n", at.join("calls").display());
    // By a process of its own: what another test starts while this one holds the file open would hold it, too, and it can not run.
    let mut install = std::process::Command::new("install")
        .args(["-m", "755", "/dev/stdin"])
        .arg(&file)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    install.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    assert!(install.wait().unwrap().success());
}

fn calls(at: &Path) -> String {
    std::fs::read_to_string(at.join("calls")).unwrap_or_default()
}

/// Without what differs from run to run: times, memory, names of folders.
fn strip(value: &mut serde_json::Value) {
    if let Some(map) = value.as_object_mut() {
        map.retain(|key, _| !key.contains("seconds") && !key.contains("memory"));
        map.values_mut().for_each(strip);
    }
    value.as_array_mut().into_iter().flatten().for_each(strip);
}

/// Columns that are no times.
fn columns(text: &str) -> String {
    // Commas within quotes are none.
    let cells = |line: &str| -> Vec<String> {
        let parts = line.split('"').enumerate();
        let plain: String =
            parts.map(|(k, part)| if k % 2 == 1 { part.replace(',', ";") } else { part.into() }).collect();
        plain.split(',').map(str::to_string).collect()
    };
    let header = text.lines().next().map(cells).unwrap_or_default();
    let line = |line: &str| {
        let kept = cells(line).into_iter().zip(&header).filter(|(_, name)| !name.contains("seconds"));
        kept.map(|(cell, _)| cell).collect::<Vec<_>>().join(",") + "\n"
    };
    text.lines().map(line).collect()
}

/// Every file of a folder by its name, as far as it is the same in every run: pages, logs and checkpoints have times in them.
fn results(folder: &Path, at: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(at).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(results(folder, &path));
            continue;
        }
        let bytes = std::fs::read(&path).unwrap();
        let text = || String::from_utf8(bytes.clone()).unwrap();
        let same = match path.extension().and_then(|extension| extension.to_str()).unwrap_or_default() {
            "html" | "txt" | "safetensors" => continue,
            _ if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("events.")) => continue,
            "json" => {
                let mut value = serde_json::from_str(&text()).unwrap();
                strip(&mut value);
                value.to_string().into_bytes()
            }
            "csv" => columns(&text()).into_bytes(),
            _ => bytes,
        };
        found.insert(path.strip_prefix(folder).unwrap().display().to_string(), same);
    }
    found
}

/// Runs a command as one process, and as an array whose tasks run side by side and are put together: the same comes of both.
#[track_caller]
fn shares_are_the_whole(at: &Path, tasks: usize, command: &[&str]) -> BTreeMap<String, Vec<u8>> {
    succeeds(at, &[command, &["--out", "whole", "--threads", "1"]].concat());
    let count = tasks.to_string();
    let slurm = ["slurm", "--tasks", &count, "--out", "job.sh"];
    let text = succeeds(at, &[&slurm, command, &["--out", "shares"]].concat());
    assert!(
        text.contains("next: job=$(sbatch --parsable job.sh) && sbatch --dependency=afterok:$job job-merge.sh"),
        "{text}"
    );
    let children: Vec<Child> = (0..tasks).map(|task| start(at, "job.sh", Some(task))).collect();
    for (task, child) in children.into_iter().enumerate() {
        ended_well(child, &format!("task {task}"));
    }
    // A task that was done is queued again, say as its node was lost: nothing comes of it.
    let before = modified(&at.join("shares"));
    ended_well(start(at, "job.sh", Some(0)), "a task again");
    ended_well(start(at, "job-merge.sh", None), "the merge");
    let (whole, shares) = (at.join("whole"), at.join("shares"));
    let (whole, shares) = (results(&whole, &whole), results(&shares, &shares));
    let names = |found: &BTreeMap<String, Vec<u8>>| found.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&whole), names(&shares));
    for (name, bytes) in &whole {
        assert!(shares[name] == *bytes, "{name} differs:\n{}\n{}", shown(bytes), shown(&shares[name]));
    }
    let after = modified(&at.join("shares"));
    let kept = before.iter().filter(|(name, time)| after.get(*name) == Some(*time)).count();
    assert!(kept > 0 || before.is_empty(), "what was there was made again: {before:?}");
    whole
}

fn shown(bytes: &[u8]) -> String {
    String::from_utf8_lossy(&bytes[..bytes.len().min(2000)]).into_owned()
}

/// When files of results were written, those of pieces of work.
fn modified(folder: &Path) -> BTreeMap<String, std::time::SystemTime> {
    let mut found = BTreeMap::new();
    for name in ["runs", "cases", "parts"] {
        for entry in std::fs::read_dir(folder.join(name)).into_iter().flatten() {
            let entry = entry.unwrap();
            let time = entry.metadata().unwrap().modified().unwrap();
            found.insert(entry.path().display().to_string(), time);
        }
    }
    found
}

const SET: [&str; 10] = [
    "generate",
    "heated-channel",
    "--trajectories",
    "3/1/1",
    "--frames",
    "12",
    "--skip",
    "20",
    "--set",
    "resolution.dx=0.025",
];

#[test]
fn data_sets() {
    let folder = TempDir::new().unwrap();
    let found = shares_are_the_whole(folder.path(), 3, &SET);
    assert!(found.contains_key("train.h5") && found.contains_key("metadata.json"));
}

#[test]
fn maps_of_stability() {
    let folder = TempDir::new().unwrap();
    let maps = ["stress", "taylor-green", "--filter", "viscosity", "--quick"];
    let found = shares_are_the_whole(
        folder.path(),
        2,
        &[&maps[..], &["--set", "time.end=0.1", "--set", "resolution.dx=0.1"]].concat(),
    );
    assert!(found.contains_key("stress.csv") && found.contains_key("taylor-green-viscosity.png"));
}

#[test]
fn validations() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let cases = ["validate", "--quick", "--filter", "poiseuille"];
    let found = shares_are_the_whole(at, 2, &cases);
    assert!(found.contains_key("validation.csv") && found.contains_key("cases/poiseuille.json"), "{:?}", found.keys());
    // Cases of other runs are not taken for these: at all resolutions it would be other ones.
    let file = at.join("shares/cases/poiseuille.json");
    let text = std::fs::read_to_string(&file).unwrap().replacen("resolution.dx=", "resolution.dx=1", 1);
    std::fs::write(&file, text).unwrap();
    let again = succeeds(at, &[&cases[..], &["--out", "shares", "--threads", "1", "--resume"]].concat());
    assert!(again.contains("2 of 2 cases, 1 kept from before"), "{again}");
    let again = succeeds(at, &[&cases[..], &["--out", "shares", "--threads", "1"]].concat());
    assert!(!again.contains("kept from before"), "{again}");
}

#[test]
fn studies() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &[&SET[..], &["--out", "data", "--threads", "1"]].concat());
    let study = ["study", "--data", "data", "--grid", "noise=1e-3,1e-4,1e-5", "--steps", "6"];
    let small = ["model.latent=8", "model.rounds=1", "validation_steps=2", "validation_windows=1", "validate_every=3"];
    let sets: Vec<&str> = small.iter().flat_map(|set| ["--set", set]).collect();
    let found = shares_are_the_whole(at, 2, &[&study[..], &sets].concat());
    assert!(found.contains_key("study.csv") && found.contains_key("noise=1e-5/validation.csv"), "{:?}", found.keys());
}

/// A search as short as can be.
const TINY: [&str; 8] =
    ["--epochs", "2", "--set", "time.end=0.1", "--set", "objective.window=0.05", "--set", "output.frames=2"];

#[test]
fn starts() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let all = [&["optimize", "--start", "all", "--no-verify"], &TINY[..]].concat();
    let found = shares_are_the_whole(at, 3, &all);
    assert!(found.contains_key("starts.png") && found.contains_key("sine/summary.json"), "{:?}", found.keys());
    // Shares of other settings, and of one search.
    let out = ["--out", "shares", "--shard", "1/3"];
    let other = [&all[..], &out, &["--set", "design.bound=0.015"]].concat();
    refused(&other, &hydrograd(at, &other), &["--out shares", "begun with", "design.bound"]);
    let single = ["optimize", "--shard", "0/2", "--out", "none"];
    refused(&single, &hydrograd(at, &single), &["--shard", "--start all"]);
    let lost = [&all[..], &["--out", "shares", "--shard", "0/2", "--overwrite"]].concat();
    refused(&lost, &hydrograd(at, &lost), &["--overwrite", "the others"]);
    assert!(!at.join("none").exists());
}

/// Sends SIGTERM to a job's shell once a file is there; its exit code and what it said.
fn told(file: &Path, child: Child) -> (Option<i32>, String) {
    let clock = Instant::now();
    while !file.exists() {
        assert!(clock.elapsed() < Duration::from_secs(60), "no {}", file.display());
        std::thread::sleep(Duration::from_millis(5));
    }
    // SAFETY: a signal to our own child, which has not been waited for.
    unsafe { libc::kill(child.id() as libc::pid_t, libc::SIGTERM) };
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    (output.status.code(), text)
}

#[test]
fn a_job_that_is_told_is_queued_again_and_goes_on() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    stand_in(at, "squeue", "cat state");
    stand_in(at, "scontrol", "");
    std::fs::write(at.join("state"), "RUNNING\n").unwrap();
    let long = ["simulate", "--out", "a run", "--set", "time.end=400", "--set", "output.frames=0"];
    succeeds(at, &[&["slurm", "--out", "job.sh"], &long[..]].concat());
    let step = || -> usize {
        let file = TensorFile::read(&at.join("a run/checkpoint.safetensors")).unwrap();
        file.text("step").unwrap().parse().unwrap()
    };
    let (code, text) = told(&at.join("a run/history.csv"), start(at, "job.sh", None));
    assert_eq!(code, Some(143), "{text}");
    assert!(text.contains("stopped by SIGTERM") && !text.contains("--resume a run\n=="), "{text}");
    assert_eq!(calls(at), "squeue --noheader --job 7 --format %T\nscontrol requeue 7\n");
    let first = step();
    assert!(first > 0);
    // The same file goes on, as long as a checkpoint says that there is something to go on with.
    std::fs::remove_file(at.join("calls")).unwrap();
    std::fs::write(at.join("state"), "COMPLETING\n").unwrap();
    std::fs::remove_file(at.join("a run/history.csv")).unwrap();
    let (code, text) = told(&at.join("a run/history.csv"), start(at, "job.sh", None));
    assert_eq!(code, Some(143), "{text}");
    assert!(text.contains("hydrograd simulate --resume a run"), "{text}");
    assert!(step() > first, "{} is not behind {first}", step());
    // One that was cancelled stays so.
    assert_eq!(calls(at), "squeue --noheader --job 7 --format %T\n");
}

#[test]
fn jobs_are_given_to_slurm() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    stand_in(at, "sbatch", "case \"$*\" in *--dependency*) echo '13;here';; *) echo '12;here';; esac");
    let slurm = |arguments: &[&str]| {
        let path = format!("{}:{}", at.join("bin").display(), std::env::var("PATH").unwrap());
        let mut command = assert_cmd::Command::cargo_bin("hydrograd").unwrap();
        command.current_dir(at).env("PATH", path).args(arguments).output().unwrap()
    };
    let line = ["slurm", "--submit", "--tasks", "4", "--json", "stress", "--quick", "--out", "maps"];
    let output = slurm(&line);
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["result"]["jobs"], serde_json::json!(["12", "13"]), "{found}");
    assert_eq!(
        calls(at),
        "sbatch --parsable slurm-stress.sh\nsbatch --parsable --dependency=afterok:12 slurm-stress-merge.sh\n"
    );
    // Written anew; but not over somebody else's file.
    assert!(slurm(&line).status.success());
    std::fs::write(at.join("slurm-stress.sh"), "mine").unwrap();
    refused(&line, &slurm(&line), &["slurm-stress.sh", "another --out"]);
    assert_eq!(std::fs::read_to_string(at.join("slurm-stress.sh")).unwrap(), "mine");
    // What is wrong is said now, and nothing is written.
    for (line, parts) in [
        (&["slurm", "stress", "tokamak"][..], &["tokamak", "dam-break"][..]),
        (&["slurm", "optimize", "--set", "time.cfl=99"], &["time.cfl"]),
        (&["slurm", "bench"], &["hydrograd bench", "generate, stress"]),
        (&["slurm", "--time", "60s", "simulate"], &["--time", "HH:MM:SS"]),
    ] {
        let output = slurm(line);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{line:?}: {error}");
        assert!(parts.iter().all(|part| error.contains(part)), "{line:?}: {error}");
    }
    let text = succeeds(at, &["slurm", "--print", "validate", "--quick"]);
    assert!(text.matches("#!/bin/bash").count() == 2 && text.contains("--array=0-7"), "{text}");
    assert!(!at.join("slurm-optimize.sh").exists() && !at.join("slurm-validate.sh").exists());
    // A run that is there is not gone on with unless somebody said so.
    succeeds(at, &["simulate", "--out", "run", "--set", "time.end=0.05", "--set", "output.frames=0", "--threads", "1"]);
    let line = ["slurm", "simulate", "--out", "run"];
    refused(&line, &hydrograd(at, &line), &["--out run", "already", "--resume"]);
    let longer = ["slurm", "--print", "simulate", "--resume", "run", "--set", "time.end=0.1"];
    let text = succeeds(at, &longer);
    assert!(text.contains("simulate --resume run --set time.end=0.1 --out run") && !text.contains("if [ -e"), "{text}");
    let stderr = slurm(&["slurm", "simulate", "--help"]);
    assert!(stderr.status.success() && String::from_utf8_lossy(&stderr.stdout).contains("--recover"));
}

fn wanted() -> Wanted {
    Wanted {
        time: "01:00:00".into(),
        cpus: 2,
        partition: None,
        memory: Some("4G".into()),
        options: vec!["--comment=two words".into()],
        program: vec!["/opt/my programs/hydrograd".into()],
        folder: "/home/a \"b\"".into(),
    }
}

fn words(line: &str) -> Vec<String> {
    line.split(' ').map(str::to_string).collect()
}

/// The jobs of a command line, in a folder without runs.
fn jobs_of(line: &str) -> anyhow::Result<(Job, Option<Job>)> {
    let typed = words(line);
    let cli = Cli::try_parse_from(["hydrograd", "slurm"].into_iter().chain(typed.iter().map(String::as_str)))?;
    let cli::Command::Slurm(arguments) = cli.command else { panic!("not slurm") };
    Ok(jobs(&arguments)?.unwrap())
}

/// The output of a script in bash.
fn bash(script: &str, variables: &[(&str, &str)]) -> String {
    let mut bash = Command::new("bash");
    let output = bash.arg("-c").arg(script).envs(variables.iter().copied()).output().unwrap();
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn an_array_is_written_as_sbatch_and_bash_read_it() {
    let job = Job { name: "generate".into(), tasks: Some(4), command: words("generate --out data"), ..Job::default() };
    let text = job.text(&wanted(), Path::new("jobs/a.sh")).unwrap();
    for line in [
        "#!/bin/bash",
        "#SBATCH --array=0-3",
        "#SBATCH --cpus-per-task=2",
        "#SBATCH --mem=4G",
        "#SBATCH --chdir=\"/home/a \\\"b\\\"\"",
        "#SBATCH --output=jobs/a-%A_%a.log",
        "#SBATCH --signal=B:TERM@60",
        "#SBATCH --requeue",
        "#SBATCH --open-mode=append",
        "#SBATCH --comment=\"two words\"",
        "set -- '/opt/my programs/hydrograd' generate --out data --shard \"$SLURM_ARRAY_TASK_ID/4\"",
    ] {
        assert!(text.lines().any(|own| own == line), "no `{line}` in {text}");
    }
    assert!(!text.contains("afterok") && !text.contains("kill-on-invalid-dep"), "{text}");
}

/// The words of a command reach it as typed, and its exit code is returned.
#[test]
fn words_reach_the_command() {
    let odd = ["%s\\n", "a b", "it's", "$HOME `date`", "", "\"x\"", "*"];
    let job = Job { command: odd.map(str::to_string).to_vec(), ..Job::default() };
    let text = job.text(&Wanted { program: vec!["printf".into()], ..wanted() }, Path::new("a.sh")).unwrap();
    let said = bash(&text, &[("SLURM_JOB_ID", "7")]);
    assert!(said.ends_with("a b\nit's\n$HOME `date`\n\n\"x\"\n*\n"), "{said}");
    let lines = Job { command: vec!["a\nb".into()], ..Job::default() }.text(&wanted(), Path::new("a.sh"));
    assert!(lines.unwrap_err().to_string().contains("line break"));
}

/// An existing run is resumed, and a finished one stays as it is.
#[test]
fn a_job_goes_on_with_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let job = Job {
        command: words("begin"),
        resumed: Some((at("it's begun"), words("again"))),
        marker: Some(at("marker")),
        ..Job::default()
    };
    let text = job.text(&Wanted { program: vec!["echo".into()], ..wanted() }, Path::new("a.sh")).unwrap();
    let last = || bash(&text, &[("SLURM_JOB_ID", "7")]).lines().last().unwrap().to_string();
    assert_eq!(last(), "begin");
    std::fs::write(at("it's begun"), "").unwrap();
    std::fs::write(at("marker"), "simulate\n").unwrap();
    assert_eq!(last(), "again");
    std::fs::write(at("marker"), "simulate\nfinished\n").unwrap();
    assert_eq!(last(), "nothing is left to do");
}

#[test]
fn ranks_are_started_and_told_by_slurm() {
    let (job, merge) = jobs_of("--ranks 3 --cpus 2 train --data data --init old.safetensors --out runs/none").unwrap();
    assert_eq!((job.ranks, job.tasks, merge), (Some(3), None, None));
    let text = job
        .text(
            &Wanted { program: vec!["python3".into(), "-m".into(), "hydrograd".into()], ..wanted() },
            Path::new("a.sh"),
        )
        .unwrap();
    let srun = "set -- srun --mpi=pmix --kill-on-bad-exit --cpus-per-task=2 python3 -m hydrograd train --data data";
    for line in [
        "#SBATCH --ntasks=3".to_string(),
        format!("    {srun} --init old.safetensors --out runs/none --threads 2 --overwrite"),
        // Parameters are taken over only once.
        format!("    {srun} --out runs/none --threads 2 --resume"),
        "trap 'scancel --signal=TERM \"$job\"' TERM".to_string(),
    ] {
        assert!(text.lines().any(|own| own == line), "no `{line}` in {text}");
    }
}

#[test]
fn a_flow_has_ranks_too() {
    let (job, _) = jobs_of("--ranks 4 --cpus 2 simulate taylor-green --out runs/none").unwrap();
    let wanted = Wanted { program: vec!["hydrograd".into()], ..wanted() };
    let text = job.text(&wanted, Path::new("a.sh")).unwrap();
    let srun = "srun --mpi=pmix --kill-on-bad-exit --cpus-per-task=2 hydrograd simulate";
    for part in ["#SBATCH --ntasks=4", &format!("{srun} taylor-green"), &format!("{srun} --resume runs/none")] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    let search = "--ranks 2 optimize --set optimise.search=scene --no-verify --out runs/none";
    assert_eq!(jobs_of(search).unwrap().0.ranks, Some(2));
}

#[test]
fn what_an_array_means_follows_from_the_command() {
    let command = |job: &Job| job.command.join(" ");
    let (main, merge) = jobs_of("generate --trajectories 3/1/1 --out runs/none").unwrap();
    assert_eq!((main.tasks, command(&merge.unwrap())), (Some(5), "merge runs/none".into()));
    assert_eq!(command(&main), "generate --trajectories 3/1/1 --out runs/none --threads 1");
    let (main, merge) = jobs_of("--tasks 3 --cpus 2 stress taylor-green --quick --out runs/none").unwrap();
    assert_eq!(main.tasks, Some(3));
    assert_eq!(command(&merge.unwrap()), "stress taylor-green --quick --out runs/none --threads 2 --resume");
    let (main, merge) = jobs_of("validate --quick --threads=0 --out runs/none").unwrap();
    assert_eq!((main.tasks, command(&main)), (Some(8), "validate --quick --threads=0 --out runs/none".into()));
    assert_eq!(command(&merge.unwrap()), "validate --quick --threads=0 --out runs/none --resume");
    let (main, merge) = jobs_of("optimise --start all --no-verify --out runs/none").unwrap();
    assert_eq!(main.tasks, Some(4));
    assert_eq!(command(&merge.unwrap()), "optimize --start all --no-verify --resume runs/none");
    let (main, merge) = jobs_of("simulate --recover --out runs/none --set time.end=1 --json").unwrap();
    assert_eq!((main.tasks, merge), (None, None));
    let (begun, again) = main.resumed.unwrap();
    assert_eq!(begun, Path::new("runs/none/checkpoint.safetensors"));
    assert_eq!(again.join(" "), "simulate --recover --resume runs/none --json");
    // Without a given folder, the job has the command's default one.
    let (main, _) = jobs_of("optimize --epochs 3").unwrap();
    assert!(command(&main).starts_with("optimize --epochs 3 --out runs/optimize-heated-channel"), "{main:?}");
}

#[test]
fn mistakes_are_told_before_the_queue() {
    for (line, parts) in [
        ("generate --no-such-option", ["--no-such-option", "hydrograd generate"]),
        ("generate --set time.cfl=99", ["time.cfl", "99"]),
        ("evaluate --model a --data b", ["no shares", "generate, stress, study"]),
        ("slurm generate", ["no shares", "sbatch --wrap"]),
        ("--tasks 2 simulate", ["--tasks 2", "generate, stress"]),
        ("--tasks 5 optimize --start all --out runs/none", ["--tasks 5", "1 ... 4"]),
        ("--ranks 2 generate --out runs/none", ["--ranks 2", "train, simulate"]),
        ("--ranks 2 optimize --start all --out runs/none", ["--ranks 2", "--tasks"]),
        ("--ranks 2 optimize --out runs/none", ["fixed particles over several ranks", "optimise.search=scene"]),
        (
            "--ranks 2 simulate --method fixed --out runs/none",
            ["method.name = fixed over several ranks", "without mpirun"],
        ),
        ("stress --shard 0/4", ["--shard", "share of its own"]),
        ("optimize --overwrite", ["--overwrite", "lose"]),
        ("study --data nowhere --grid noise=1 --steps 5", ["--data nowhere", "data set"]),
    ] {
        let message = jobs_of(line).unwrap_err().to_string();
        assert!(parts.iter().all(|part| message.contains(part)), "{line}: {message}");
    }
}

#[test]
fn times_and_sizes_are_slurms() {
    let typed = |option: &str, value: &str| {
        let cli = Cli::try_parse_from(["hydrograd", "slurm", &format!("--{option}={value}"), "generate"])?;
        let cli::Command::Slurm(arguments) = cli.command else { panic!("not slurm") };
        Ok::<_, clap::Error>(arguments)
    };
    for good in ["5", "03:00", "01:00:00", "1-0", "2-12:30", "7-00:00:00", "90"] {
        assert_eq!(typed("time", good).unwrap().time, good);
    }
    for bad in ["", "2", "00:02:59", "1h", "1-", "1:2:3:4", "-1", "99999999999999999999", "1 0"] {
        assert!(typed("time", bad).is_err(), "{bad}");
    }
    for good in ["4G", "512M", "1000"] {
        assert_eq!(typed("memory", good).unwrap().memory.as_deref(), Some(good));
    }
    assert!(["4GB", "0", "G", "-1G", "four"].iter().all(|size| typed("memory", size).is_err()));
    assert_eq!(typed("option", "--qos=long").unwrap().options, ["--qos=long"]);
    assert!(typed("option", "qos").is_err());
    assert_eq!(next(&[("a b.sh".into(), "".into())]), "sbatch 'a b.sh'");
}
