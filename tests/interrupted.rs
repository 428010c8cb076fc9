//! Runs that are ended on their way, as real processes: by SIGKILL at any moment nothing is damaged, and what is resumed ends to the
//! bit as if it had never stopped; SIGINT and SIGTERM keep what there is, and say how to go on.
//!
//! `HYDROGRAD_KILLS=200` kills so often per command; 6 times otherwise, of which every third falls among pictures and summaries.

use crate::support;
use crate::support::program::succeeds;
use hydrograd::io::{hdf5_file, tensor_file::TensorFile};
use std::io::BufRead;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Times that a run is killed.
fn kills() -> usize {
    std::env::var("HYDROGRAD_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(6)
}

/// Uniform numbers in 0 ... 1, the same in every run of the tests.
struct Moments(u64);

impl Moments {
    fn next(&mut self) -> f64 {
        // Knuth's multiplier; the upper bits are random enough for moments.
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn start(folder: &Path, arguments: &[&str]) -> Child {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("hydrograd"));
    command.current_dir(folder).env("CANDLE_NUM_THREADS", "1").args(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Every file below a folder, in order.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => found.push(path),
        }
    }
    found.sort();
    found
}

/// Every file that has its final name can be read.
#[track_caller]
fn all_whole(folder: &Path, when: &str) {
    for path in files(folder) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with('.') {
            continue;
        }
        let at = || format!("{} {when}", path.display());
        let text = || std::fs::read_to_string(&path).unwrap();
        match path.extension().and_then(|e| e.to_str()).unwrap_or_default() {
            "json" => {
                drop(serde_json::from_str::<serde_json::Value>(&text()).unwrap_or_else(|e| panic!("{}: {e}", at())))
            }
            "toml" => drop(text().parse::<toml::Table>().unwrap_or_else(|e| panic!("{}: {e}", at()))),
            "safetensors" => drop(TensorFile::read(&path).unwrap_or_else(|e| panic!("{}: {e}", at()))),
            // With the checksum of all bytes.
            "h5" => drop(hdf5_file::open(&path, "file").unwrap_or_else(|e| panic!("{}: {e}", at()))),
            "csv" => {
                let text = text();
                // Commas within quotes are none.
                let count =
                    |line: &str| 1 + line.split('"').step_by(2).map(|part| part.matches(',').count()).sum::<usize>();
                let columns = text.lines().next().map_or(0, count);
                let is_whole = text.ends_with('\n') && text.lines().all(|line| count(line) == columns);
                assert!(is_whole && columns > 0, "{}", at());
            }
            "vtp" | "pvd" => assert!(std::fs::read(&path).unwrap().ends_with(b"</VTKFile>\n"), "{}", at()),
            "png" => assert!(std::fs::read(&path).unwrap().ends_with(b"IEND\xaeB`\x82"), "{}", at()),
            "svg" => assert!(text().trim_end().ends_with("</svg>"), "{}", at()),
            "html" => assert!(text().trim_end().ends_with("</html>"), "{}", at()),
            _ => {}
        }
    }
}

/// What a run came to, without how long it took.
type Result = Vec<(String, Vec<u8>)>;

/// A command that is killed, and how it goes on.
struct Case<'a> {
    begin: Vec<&'a str>,
    resume: Vec<&'a str>,
    result: fn(&Path) -> Result,
}

/// Runs a case as a whole and killed, and compares.
fn survives(case: &Case, prepare: impl Fn(&Path), seed: u64) {
    let mut moments = Moments(seed);
    let whole = TempDir::new().unwrap();
    prepare(whole.path());
    let clock = Instant::now();
    succeeds(whole.path(), &case.begin);
    let length = clock.elapsed();
    let expected = (case.result)(&whole.path().join("run"));
    assert!(!expected.is_empty());
    for kill in 0..kills() {
        let folder = TempDir::new().unwrap();
        let at = folder.path();
        prepare(at);
        // Every third one among pictures and summaries.
        let moment = match kill % 3 {
            2 => length.saturating_sub(Duration::from_millis(200).mul_f64(moments.next())),
            _ => length.mul_f64(moments.next()),
        };
        let mut child = start(at, &case.begin);
        std::thread::sleep(moment);
        child.kill().unwrap();
        let ended = child.wait().unwrap();
        let when = format!("after a kill at {moment:?} of {length:?}");
        all_whole(&at.join("run"), &when);
        if !ended.success() {
            let output = support::program::hydrograd(at, &case.resume);
            // What was killed before it began, or when all was there but the last word, says so.
            let error = String::from_utf8_lossy(&output.stderr).into_owned();
            // Shown where something is wrong behind it.
            eprintln!("{when}: {:?} {error}", output.status.code());
            match output.status.code() {
                Some(0) => {}
                Some(2) if error.contains("already") => {}
                Some(2) if error.contains("no run to resume") || error.contains("train without --resume") => {
                    succeeds(at, &case.begin);
                }
                code => panic!("{when}: {code:?} {error}"),
            }
        }
        all_whole(&at.join("run"), &format!("{when} and resumed"));
        assert!((case.result)(&at.join("run")) == expected, "{when}: another result");
        let left: Vec<PathBuf> =
            files(&at.join("run")).into_iter().filter(|p| p.to_string_lossy().contains(".partial-")).collect();
        assert!(left.is_empty(), "{when}: {left:?}");
    }
}

/// Bytes of a file's tensors but for times.
fn tensors(path: &Path) -> Result {
    let bytes = std::fs::read(path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let mut all: Result = file
        .tensors()
        .into_iter()
        .filter(|(name, _)| !name.ends_with("seconds"))
        .map(|(name, tensor)| (name, tensor.data().to_vec()))
        .collect();
    all.sort();
    all
}

/// A summary but for times and memory.
fn summary(path: &Path) -> (String, Vec<u8>) {
    let mut value: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    fn strip(value: &mut serde_json::Value) {
        if let Some(map) = value.as_object_mut() {
            map.retain(|key, _| !key.contains("seconds") && !key.contains("memory"));
            map.values_mut().for_each(strip);
        }
        value.as_array_mut().into_iter().flatten().for_each(strip);
    }
    strip(&mut value);
    ("summary".into(), value.to_string().into_bytes())
}

fn bytes(folder: &Path, name: &str) -> (String, Vec<u8>) {
    (name.to_string(), std::fs::read(folder.join(name)).unwrap())
}

/// Columns of a table without `seconds`.
fn table(folder: &Path, name: &str) -> (String, Vec<u8>) {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    let seconds = text.lines().next().unwrap().split(',').position(|column| column == "seconds");
    let row = |line: &str| {
        let cells: Vec<&str> =
            line.split(',').enumerate().filter(|(k, _)| Some(*k) != seconds).map(|(_, c)| c).collect();
        cells.join(",") + "\n"
    };
    (name.to_string(), text.lines().map(row).collect::<String>().into_bytes())
}

/// A short, small run.
const SHORT: [&str; 10] = [
    "--out",
    "run",
    "--set",
    "time.end=0.4",
    "--set",
    "objective.window=0.1",
    "--set",
    "output.frames=2",
    "--threads",
    "1",
];

#[test]
fn simulate_survives_kills() {
    let result =
        |run: &Path| [tensors(&run.join("checkpoint.safetensors")), vec![summary(&run.join("summary.json"))]].concat();
    let begin = [&["simulate", "--set", "design.shape=sine", "--set", "time.end=2"], &SHORT[..2], &SHORT[4..]].concat();
    survives(&Case { begin, resume: vec!["simulate", "--resume", "run"], result }, |_| (), 1);
}

#[test]
fn optimize_survives_kills() {
    let result = |run: &Path| {
        [
            tensors(&run.join("checkpoint.safetensors")),
            vec![summary(&run.join("summary.json")), bytes(run, "shape.csv")],
        ]
        .concat()
    };
    let begin = [&["optimize", "--epochs", "5", "--set", "optimise.learning_rate=1e-3"], &SHORT[..]].concat();
    survives(&Case { begin, resume: vec!["optimize", "--resume", "run"], result }, |_| (), 2);
}

/// A data set that takes a moment.
const SET: [&str; 13] = [
    "generate",
    "heated-channel",
    "--set",
    "resolution.dx=0.025",
    "--trajectories",
    "4/1/1",
    "--frames",
    "12",
    "--skip",
    "20",
    "--threads",
    "1",
    "--out",
];

#[test]
fn generate_survives_kills() {
    let result =
        |run: &Path| ["train.h5", "valid.h5", "test.h5", "metadata.json"].map(|name| bytes(run, name)).to_vec();
    let again = [&SET[..], &["run"]].concat();
    survives(&Case { begin: again.clone(), resume: again, result }, |_| (), 3);
}

/// The folder of a data set, made once.
fn data() -> &'static Path {
    static FOLDER: std::sync::OnceLock<TempDir> = std::sync::OnceLock::new();
    let make = || {
        let folder = TempDir::new().unwrap();
        succeeds(folder.path(), &[&SET[..], &["data"]].concat());
        folder
    };
    FOLDER.get_or_init(make).path()
}

/// Settings of a training that takes a moment.
const SMALL: [&str; 14] = [
    "--set",
    "model.latent=8",
    "--set",
    "model.rounds=2",
    "--set",
    "validation_steps=4",
    "--set",
    "validation_windows=1",
    "--set",
    "validate_every=15",
    "--set",
    "store_every=7",
    "--set",
    "log_every=5",
];

fn link_data(at: &Path) {
    std::os::unix::fs::symlink(data().join("data"), at.join("data")).unwrap();
}

#[test]
fn train_survives_kills() {
    let result = |run: &Path| {
        let models = ["last.safetensors", "best.safetensors"].map(|name| tensors(&run.join(name)));
        [models.concat(), vec![table(run, "history.csv"), table(run, "validation.csv")]].concat()
    };
    let begin = [&["train", "--data", "data", "--out", "run", "--steps", "60", "--threads", "1"], &SMALL[..]].concat();
    let resume = vec!["train", "--data", "data", "--out", "run", "--resume"];
    survives(&Case { begin, resume, result }, link_data, 4);
}

#[test]
fn study_survives_kills() {
    let result = |run: &Path| {
        let models = ["noise=1e-3", "noise=1e-4"].map(|point| tensors(&run.join(point).join("last.safetensors")));
        [models.concat(), vec![table(run, "study.csv")]].concat()
    };
    let grid =
        ["study", "--data", "data", "--out", "run", "--steps", "40", "--threads", "1", "--grid", "noise=1e-3,1e-4"];
    let again = [&grid[..], &SMALL[..]].concat();
    survives(&Case { begin: again.clone(), resume: again, result }, link_data, 5);
}

#[test]
fn stress_survives_kills() {
    let result = |run: &Path| vec![summary(&run.join("stress.json"))];
    let maps = ["stress", "taylor-green", "--filter", "viscosity", "--quick", "--threads", "1", "--out", "run"];
    let short = ["--set", "time.end=0.2", "--set", "resolution.dx=0.1"];
    let begin = [&maps[..], &short[..]].concat();
    let resume = [&begin[..], &["--resume"]].concat();
    survives(&Case { begin, resume, result }, |_| (), 6);
}

/// The first asks, the second ends.
#[test]
fn a_second_signal_ends_at_once() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    // One epoch is many times as long as all this takes.
    let long = ["optimize", "--out", "opt", "--set", "optimise.clip=1e9"];
    let mut child = start(at, &[&long[..], &["--set", "time.end=60", "--threads", "1"]].concat());
    let clock = Instant::now();
    while !at.join("opt/config.toml").exists() {
        assert!(clock.elapsed() < Duration::from_secs(60), "no configuration");
        std::thread::sleep(Duration::from_millis(1));
    }
    // SAFETY: a signal to our own child, which has not been waited for.
    let send = |child: &Child| unsafe { libc::kill(child.id() as libc::pid_t, libc::SIGINT) };
    send(&child);
    // It says so once it has seen the first.
    let mut said = std::io::BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.starts_with("SIGINT") {
        line.clear();
        assert!(said.read_line(&mut line).unwrap() > 0, "it ended by the first signal");
    }
    send(&child);
    let ended = child.wait().unwrap();
    assert_eq!(ended.signal(), Some(libc::SIGINT), "{ended}");
}

/// A batch system tells a program, and the shell of its job, which tells it again: that is one signal.
#[test]
fn what_is_told_twice_at_once_is_told_once() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let mut child =
        start(at, &["optimize", "--out", "opt", "--epochs", "500", "--set", "optimise.method=adam", "--threads", "1"]);
    let clock = Instant::now();
    while !at.join("opt/checkpoint.safetensors").exists() {
        assert!(clock.elapsed() < Duration::from_secs(60), "no checkpoint");
        std::thread::sleep(Duration::from_millis(1));
    }
    // SAFETY: a signal to our own child, which has not been waited for.
    let send = |child: &Child| unsafe { libc::kill(child.id() as libc::pid_t, libc::SIGTERM) };
    send(&child);
    let mut said = std::io::BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    assert!(said.read_line(&mut line).unwrap() > 0 && line.starts_with("SIGTERM"), "{line}");
    send(&child);
    // It ends after its epoch, by itself.
    assert_eq!(child.wait().unwrap().code(), Some(143));
}

/// Sends a signal once a file is there; the exit code and what was said.
fn signalled(at: &Path, arguments: &[&str], file: &str, signal: libc::c_int) -> (Option<i32>, String) {
    let child = start(at, arguments);
    let clock = Instant::now();
    while !at.join(file).exists() {
        assert!(clock.elapsed() < Duration::from_secs(60), "no {file}");
        std::thread::sleep(Duration::from_millis(1));
    }
    // SAFETY: a signal to our own child, which has not been waited for.
    unsafe { libc::kill(child.id() as libc::pid_t, signal) };
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.signal(), None, "the signal was not handled");
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn signals_keep_what_there_is_and_say_how_to_go_on() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let step =
        |name: &str| -> usize { TensorFile::read(&at.join(name)).unwrap().text("step").unwrap().parse().unwrap() };
    // A simulation of many checkpoints' length: the one that is kept is of where it was stopped.
    let long = ["simulate", "--out", "long", "--set", "time.end=200", "--set", "output.frames=0", "--threads", "1"];
    let (code, error) = signalled(at, &long, "long/history.csv", libc::SIGINT);
    assert_eq!(code, Some(130), "{error}");
    assert!(error.contains("stopped by SIGINT") && error.contains("hydrograd simulate --resume long"), "{error}");
    let steps = step("long/checkpoint.safetensors");
    assert!(steps > 0 && !steps.is_multiple_of(1000), "{steps}");
    let epochs = ["optimize", "--out", "opt", "--epochs", "500", "--set", "optimise.method=adam", "--threads", "1"];
    let (code, error) = signalled(at, &epochs, "opt/checkpoint.safetensors", libc::SIGTERM);
    assert_eq!(code, Some(143), "{error}");
    assert!(error.contains("stopped by SIGTERM") && error.contains("hydrograd optimize --resume opt"), "{error}");
    link_data(at);
    let train =
        [&["train", "--data", "data", "--out", "net", "--steps", "100000", "--threads", "1"], &SMALL[..]].concat();
    let train = [&train[..], &["--set", "store_every=100000"]].concat();
    let (code, error) = signalled(at, &train, "net/history.csv", libc::SIGTERM);
    assert_eq!(code, Some(143), "{error}");
    assert!(error.contains("hydrograd train --data data --out net --resume"), "{error}");
    assert!(step("net/last.safetensors") >= 5);
    // Its training is told, and keeps what it has; then it goes on with it.
    let grid =
        ["study", "--data", "data", "--out", "grid", "--steps", "100000", "--threads", "1", "--grid", "noise=1e-3"];
    let grid = [&grid[..], &SMALL[..], &["--set", "store_every=100000"]].concat();
    let (code, error) = signalled(at, &grid, "grid/noise=1e-3/history.csv", libc::SIGTERM);
    assert_eq!(code, Some(143), "{error}");
    assert!(step("grid/noise=1e-3/last.safetensors") >= 5);
    // Finished runs are kept, and the one that was on its way is none of them.
    let map = ["stress", "heated-channel", "--filter", "step", "--out", "map", "--threads", "1"];
    let (code, error) = signalled(at, &map, "map/runs", libc::SIGINT);
    assert_eq!(code, Some(130), "{error}");
    assert!(error.contains("the same command with --resume"), "{error}");
    let cases = ["validate", "--filter", "taylor-green", "--out", "cases", "--threads", "1"];
    let (code, error) = signalled(at, &cases, "cases/cases", libc::SIGTERM);
    assert_eq!(code, Some(143), "{error}");
    assert!(error.contains("the same command with --resume") && !at.join("cases/validation.json").exists(), "{error}");
}

/// A log shows every epoch, not only what came of them.
#[test]
fn a_log_has_a_line_per_epoch() {
    let folder = TempDir::new().unwrap();
    let text = succeeds(folder.path(), &[&["optimize", "--no-verify", "--epochs", "3"], &SHORT[..]].concat());
    let lines: Vec<&str> = text.lines().filter(|line| line.starts_with("epoch ")).collect();
    assert!(lines.len() == 3 && lines[0].starts_with("epoch   1  Q 0."), "{text}");
    assert!(text.contains(" in epoch ") && text.contains(" of 3, "), "{text}");
}
