//! Training by several processes over MPI: the same training, whatever their number. (Feature `mpi`, and `mpirun`.)
#![cfg(feature = "mpi")]

use crate::support::program::succeeds;
use hydrograd::io::tensor_file::TensorFile;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// A data set of the heated channel, made once for all tests.
fn data() -> &'static Path {
    static FOLDER: std::sync::OnceLock<tempfile::TempDir> = std::sync::OnceLock::new();
    FOLDER
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let scene = ["heated-channel", "--set", "resolution.dx=0.025", "--skip", "20"];
            let size = ["--trajectories", "2/1/1", "--frames", "12", "--out", "data"];
            succeeds(folder.path(), &[&["generate"], &scene[..], &size[..]].concat());
            folder
        })
        .path()
}

/// `hydrograd train` by so many ranks; more of them than cores.
fn train(ranks: usize, out: &Path, more: &[&str]) -> Command {
    let program = assert_cmd::cargo::cargo_bin("hydrograd");
    let mut command = match ranks {
        0 => Command::new(&program),
        _ => {
            let mut command = Command::new("mpirun");
            // Tests run in containers, as root and with fewer cores than ranks.
            command.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
            command.args(["-n", &ranks.to_string(), "--oversubscribe", "--bind-to", "none"]).arg(&program);
            command
        }
    };
    command.args(["train", "--threads", "1", "--data"]).arg(data().join("data")).arg("--out").arg(out);
    for set in [
        "model.latent=8",
        "model.rounds=2",
        "validation_steps=4",
        "validation_windows=1",
        "validate_every=1000",
        "store_every=20",
        "log_every=1",
        "ema=0.9",
        "batch_size=4",
    ] {
        command.args(["--set", set]);
    }
    command.args(more);
    command
}

fn output(command: &mut Command) -> Output {
    command.stdin(Stdio::null()).output().unwrap()
}

fn run(ranks: usize, out: &Path, more: &[&str]) {
    let output = output(&mut train(ranks, out, more));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(said.matches("best validation at step").count(), 1, "one rank speaks: {said}");
}

fn losses(folder: &Path) -> Vec<f64> {
    let text = std::fs::read_to_string(folder.join("history.csv")).unwrap();
    text.lines().skip(1).map(|line| line.split(',').nth(2).unwrap().parse().unwrap()).collect()
}

fn tensors(folder: &Path) -> hydrograd::io::tensor_file::Tensors {
    TensorFile::read(&folder.join("last.safetensors")).unwrap().tensors
}

/// 200 steps by one process, two and four ranks: to the bit with the gradients added in the order of the batch, and the same
/// loss curve with MPI's own sums, which are as good as exact.
#[test]
fn the_number_of_ranks_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let steps = ["--steps", "200"];
    let alone = place("alone");
    run(0, &alone, &steps);
    let wanted = losses(&alone);
    assert_eq!(wanted.len(), 200);
    for ranks in [1, 2, 4] {
        let [ordered, fast] = ["ordered", "fast"].map(|how| place(&format!("{how}-{ranks}")));
        run(ranks, &ordered, &[&steps[..], &["--deterministic"]].concat());
        assert!(losses(&ordered) == wanted && tensors(&ordered) == tensors(&alone), "{ranks} ranks");
        run(ranks, &fast, &steps);
        let worst = losses(&fast).iter().zip(&wanted).fold(0.0f64, |most, (a, b)| most.max((a / b - 1.0).abs()));
        println!("{ranks} ranks: the loss differs by {worst:.1e} at most");
        assert!(worst <= 1e-6, "{ranks} ranks: {worst}");
    }
}

/// Begun by two ranks, gone on with by four, ended by one: as if nothing had happened.
#[test]
fn another_number_of_ranks_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, parts]: [PathBuf; 2] = ["whole", "parts"].map(|name| folder.path().join(name));
    run(0, &whole, &["--steps", "30"]);
    run(2, &parts, &["--steps", "10", "--deterministic"]);
    run(4, &parts, &["--steps", "20", "--deterministic", "--resume"]);
    run(0, &parts, &["--steps", "30", "--resume"]);
    assert_eq!(tensors(&whole), tensors(&parts));
}

/// The ranks that a mpirun has begun: the hydrograds among its children.
fn ranks_of(mpirun: &Child) -> Vec<i32> {
    let tasks = format!("/proc/{}/task", mpirun.id());
    let mut found = Vec::new();
    for task in std::fs::read_dir(tasks).into_iter().flatten().flatten() {
        let children = std::fs::read_to_string(task.path().join("children")).unwrap_or_default();
        found.extend(children.split_whitespace().map(|pid| pid.parse::<i32>().unwrap()));
    }
    found.retain(|pid| {
        std::fs::read_to_string(format!("/proc/{pid}/comm")).is_ok_and(|name| name.trim() == "hydrograd")
    });
    found.sort_unstable();
    found
}

/// Begins a long training by two ranks, and waits for its first checkpoint.
fn begun(out: &Path) -> Child {
    let mut command = train(2, out, &["--steps", "100000", "--deterministic"]);
    let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let limit = Instant::now() + Duration::from_secs(120);
    while !out.join("last.safetensors").exists() {
        assert!(Instant::now() < limit, "no checkpoint in two minutes");
        std::thread::sleep(Duration::from_millis(20));
    }
    child
}

fn signal(pid: i32, signal: i32) {
    // SAFETY: sends a signal to a process of this test's.
    assert_eq!(unsafe { libc::kill(pid, signal) }, 0);
}

/// A rank that is gone ends the others within ten seconds, with a message, and no more is lost than what came after the last
/// checkpoint.
#[test]
fn a_killed_rank_ends_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, killed]: [PathBuf; 2] = ["whole", "killed"].map(|name| folder.path().join(name));
    let child = begun(&killed);
    let ranks = ranks_of(&child);
    assert_eq!(ranks.len(), 2, "{ranks:?}");
    signal(ranks[1], libc::SIGKILL);
    let clock = Instant::now();
    let output = child.wait_with_output().unwrap();
    let took = clock.elapsed();
    assert!(took < Duration::from_secs(10) && !output.status.success(), "{took:?}, {:?}", output.status);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("signal 9"), "{said}");
    let steps: u64 = TensorFile::read(&killed.join("last.safetensors")).unwrap().text("step").unwrap().parse().unwrap();
    assert!(steps.is_multiple_of(20) && steps > 0, "{steps}");
    let end = (steps + 10).to_string();
    run(2, &killed, &["--steps", &end, "--deterministic", "--resume"]);
    run(0, &whole, &["--steps", &end]);
    assert_eq!(tensors(&whole), tensors(&killed));
}

/// A batch system's SIGTERM reaches mpirun: all ranks stop at the same step, and the first keeps what there is.
#[test]
fn all_ranks_stop_together() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let child = begun(&out);
    signal(i32::try_from(child.id()).unwrap(), libc::SIGTERM);
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    // mpirun has a code of its own then, and hands on no more of what its ranks say.
    assert!(!output.status.success());
    assert_eq!(said.matches("keeps what there is").count(), 1, "one rank speaks: {said}");
    let steps = TensorFile::read(&out.join("last.safetensors")).unwrap().text("step").unwrap().to_owned();
    let steps: u64 = steps.parse().unwrap();
    assert_eq!(losses(&out).len() as u64, steps, "kept where they stopped");
    run(2, &out, &["--steps", &(steps + 3).to_string(), "--resume"]);
}

#[test]
fn bad_input_is_told_once() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    for (more, text) in [
        (["--steps", "5", "--set", "batch_size=3"], "a batch of 3 cannot be shared out evenly among 2 ranks"),
        (["--steps", "5", "--set", "model.latnet=3"], "unknown field `latnet`"),
    ] {
        let output = output(&mut train(2, &out, &more));
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert_eq!(said.matches(text).count(), 1, "{said}");
        assert!(!out.exists());
    }
}
