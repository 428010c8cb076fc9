//! Training and simulating by several processes over MPI: the same result, whatever their number. (Feature `mpi`, and `mpirun`.)
#![cfg(feature = "mpi")]

use crate::support::program::succeeds;
use hydrograd::io::tensor_file::TensorFile;
use hydrograd::io::vtk::{read_frame, read_list, read_vtp};
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

/// `hydrograd` by so many ranks, more of them than cores; 0: without mpirun.
fn hydrograd(ranks: usize) -> Command {
    let program = assert_cmd::cargo::cargo_bin("hydrograd");
    if ranks == 0 {
        return Command::new(&program);
    }
    let mut command = Command::new("mpirun");
    // Tests run in containers, as root and with fewer cores than ranks.
    command.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    // Ranks that wait leave their core to other tests.
    command.env("OMPI_MCA_mpi_yield_when_idle", "1");
    command.args(["-n", &ranks.to_string(), "--oversubscribe", "--bind-to", "none"]).arg(&program);
    command
}

/// `hydrograd train` by so many ranks.
fn train(ranks: usize, out: &Path, more: &[&str]) -> Command {
    let mut command = hydrograd(ranks);
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

/// 100 steps by one process, two and four ranks: to the bit with the gradients added in the order of the batch, and the same
/// loss curve with MPI's own sums, which are as good as exact.
#[test]
fn the_number_of_ranks_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let steps = ["--steps", "100"];
    let alone = place("alone");
    run(0, &alone, &steps);
    let wanted = losses(&alone);
    assert_eq!(wanted.len(), 100);
    for ranks in [2, 4] {
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
    run(1, &parts, &["--steps", "30", "--resume"]);
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

/// A long training by two ranks.
fn long(out: &Path) -> Command {
    train(2, out, &["--steps", "100000", "--deterministic"])
}

/// Begins a long training, and waits for its first checkpoint.
fn begun(out: &Path) -> Child {
    started(&mut long(out), &out.join("last.safetensors"))
}

/// The same command over ranks that mpirun may be told to stop: their messages go to a file, because it hands on only some of them, and they have
/// time for their last step.
fn with_messages_in(file: &Path, command: &Command) -> Command {
    let program = assert_cmd::cargo::cargo_bin("hydrograd");
    let mut found = Command::new(command.get_program());
    found.envs(command.get_envs().filter_map(|(name, value)| Some((name, value?))));
    for argument in command.get_args() {
        if argument == program {
            found.args(["sh", "-c", "exec \"$@\" 2>> \"$0\""]).arg(file);
        }
        found.arg(argument);
    }
    // mpirun kills ranks a second after the signal; on a busy machine their last step may take as long. (It waits twice as long as told.)
    found.env("OMPI_MCA_odls_base_sigkill_timeout", "3");
    found
}

/// Begins a run, and waits for a file.
fn started(command: &mut Command, file: &Path) -> Child {
    let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let limit = Instant::now() + Duration::from_secs(120);
    while !file.exists() {
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
    assert!(said.contains("signal 9") && said.contains("go on from what was kept last: hydrograd train"), "{said}");
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
    let messages = folder.path().join("messages");
    let mut command = with_messages_in(&messages, &long(&out));
    let child = started(&mut command, &out.join("last.safetensors"));
    signal(i32::try_from(child.id()).unwrap(), libc::SIGTERM);
    // mpirun has a code of its own then.
    assert!(!child.wait_with_output().unwrap().status.success());
    let said = std::fs::read_to_string(&messages).unwrap();
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

/// `hydrograd simulate` by so many ranks.
fn simulate(ranks: usize, scene: &str, out: &Path) -> Command {
    let mut command = hydrograd(ranks);
    command.arg("simulate").args(scene.split(' ')).args(["--threads", "1", "--out"]).arg(out);
    command
}

/// The state at the end, `[F, N]`, and what was printed.
fn simulated(ranks: usize, scene: &str, out: &Path) -> (Vec<f64>, usize, String) {
    let output = output(&mut simulate(ranks, scene, out));
    assert!(output.status.success(), "{scene}: {}", String::from_utf8_lossy(&output.stderr));
    let file = TensorFile::read(&out.join("checkpoint.safetensors")).unwrap();
    let (shape, _) = &file.tensors["state"];
    let state = file.f64("state", shape).unwrap();
    (state.to_vec(), shape[1], String::from_utf8(output.stdout).unwrap())
}

/// Largest difference of two states, over the largest number of its row or 1.
fn difference(a: &[f64], b: &[f64], n: usize) -> f64 {
    assert_eq!(a.len(), b.len());
    let row = |(a, b): (&[f64], &[f64])| {
        let scale = a.iter().fold(1.0f64, |most, x| most.max(x.abs()));
        a.iter().zip(b).fold(0.0f64, |most, (a, b)| most.max((a - b).abs())) / scale
    };
    a.chunks_exact(n).zip(b.chunks_exact(n)).map(row).fold(0.0, f64::max)
}

/// Scenes of every kind: periodic, walled, with a free surface; in two and three dimensions; both methods that move particles; heat, a drive,
/// gravity, a transport velocity.
const SCENES: [&str; 16] = [
    "taylor-green --set time.cfl=0.25 --set time.steps=200",
    "taylor-green --method standard --set time.steps=200",
    "heated-channel --set time.steps=200 --set objective.window=0.05",
    "heated-channel --set fluid.drive=flow-rate --set time.steps=200 --set objective.window=0.05",
    "heated-channel --method standard --set method.transport_velocity=1 --set time.steps=200 --set objective.window=0.05",
    "lid-driven-cavity --dx 0.05 --set time.steps=200",
    "lid-driven-cavity --method standard --dx 0.05 --set time.cfl=0.25 --set time.steps=200",
    "dam-break --set tank.length=5.4 --dx 0.1 --set time.cfl=0.15 --set time.steps=200",
    "dam-break --set tank.length=5.4 --dx 0.1 --set time.cfl=0.15 --set time.steps=200 --set method.flux=delta",
    "dam-break --set tank.length=5.4 --dx 0.1 --set time.cfl=0.15 --set time.steps=200 --set method.flux=riemann",
    "dam-break --set tank.length=5.4 --dx 0.1 --set time.cfl=0.15 --set time.steps=200 --set method.density_renormalisation=true",
    "dam-break --set tank.length=5.4 --dx 0.1 --set time.cfl=0.15 --set time.steps=200 --set wall.slip=free-slip",
    "taylor-green --method standard --set time.steps=200 --set method.density_equation=evolution --set method.flux=delta",
    "heated-cavity --method consistent --dx 0.05 --set time.steps=200",
    "taylor-green-3d --set time.cfl=0.25 --set time.steps=200",
    "lid-driven-cavity-3d --dx 0.125 --set time.cfl=0.5 --set time.steps=200",
];

/// How many ranks share the scene or gradient of this number: by turns two and three.
fn sharing(number: usize) -> usize {
    2 + number % 2
}

/// 200 steps by two or three ranks are those of one process to 1e-12. (Vortices with the longest steps go through three turnovers, over which
/// rounding grows by 1e5 whatever makes it: fused and composed kernels of one process are 3e-11 apart. So neighbours are found in the same
/// order, and sums over all particles are those of twice the precision.)
#[test]
fn a_flow_over_ranks_is_that_of_one() {
    for (number, scene) in SCENES.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let [own, alone] = ["shared", "alone"].map(|name| folder.path().join(name));
        let ranks = sharing(number);
        let (wanted, n, _) = simulated(0, scene, &alone);
        let (state, _, said) = simulated(ranks, scene, &own);
        let worst = difference(&wanted, &state, n);
        println!("{scene}: {ranks} ranks, {worst:.1e}");
        assert!(worst <= 1e-12, "{scene}, {ranks} ranks: {worst}");
        assert_eq!(said.matches("a rank has ").count(), 1, "one rank speaks: {said}");
        for file in ["state.h5", "history.csv", "summary.json", "report.html", "config.toml"] {
            assert!(own.join(file).exists() && alone.join(file).exists(), "{scene}: {file}");
        }
    }
}

/// The same number of ranks makes the same bits, and f32 is as near as it can be.
#[test]
fn as_many_ranks_make_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let [once, again] = ["once", "again"].map(|name| simulated(3, SCENES[0], &place(name)).0);
    assert!(once == again);
    let single = format!("{} --precision f32", SCENES[0]);
    let (wanted, n, _) = simulated(0, &single, &place("single"));
    let worst = difference(&wanted, &simulated(2, &single, &place("single-2")).0, n);
    assert!(worst < 1e-4, "{worst}");
}

/// Begun by three ranks, ended by two, lengthened by one: as if nothing had happened.
#[test]
fn a_flow_goes_on_with_other_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, parts]: [PathBuf; 2] = ["whole", "parts"].map(|name| folder.path().join(name));
    let scene = "taylor-green --set time.step=0.001 --set time.end=";
    let (wanted, n, _) = simulated(0, &format!("{scene}0.2"), &whole);
    simulated(3, &format!("{scene}0.1"), &parts);
    let resumed = |end: &str| format!("--resume {} --set time.end={end}", parts.display());
    simulated(2, &resumed("0.15"), &parts);
    let worst = difference(&wanted, &simulated(0, &resumed("0.2"), &parts).0, n);
    assert!(worst <= 1e-12, "{worst}");
}

/// A rank that is gone ends the others, and the run goes on from its last checkpoint. So does one that was told to stop, and one that could
/// not write.
#[test]
fn a_flow_that_ended_early_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    // A tenth of it until the first checkpoint; what is left is much longer than what happens here.
    let scene = "taylor-green --set time.step=0.0005 --set time.end=5";
    for end in ["killed", "stopped", "one-stopped", "unwritable"] {
        let out = folder.path().join(end);
        let messages = folder.path().join(format!("{end}.messages"));
        let mut command = with_messages_in(&messages, &simulate(2, scene, &out));
        let child = started(&mut command, &out.join("checkpoint.safetensors"));
        match end {
            "killed" => signal(ranks_of(&child)[1], libc::SIGKILL),
            "stopped" => signal(i32::try_from(child.id()).unwrap(), libc::SIGTERM),
            "one-stopped" => signal(ranks_of(&child)[0], libc::SIGTERM),
            _ => {
                // The program may write it again in between.
                let made = (0..1000).any(|_| {
                    std::fs::remove_file(out.join("history.csv")).is_ok()
                        && std::fs::create_dir_all(out.join("history.csv/full")).is_ok()
                });
                assert!(made, "history.csv is written all the time");
            }
        }
        let clock = Instant::now();
        let output = child.wait_with_output().unwrap();
        let said = std::fs::read_to_string(&messages).unwrap() + &String::from_utf8_lossy(&output.stderr);
        let took = clock.elapsed();
        assert!(took < Duration::from_secs(20) && !output.status.success(), "{end}: {took:?}, {said}");
        match end {
            "killed" => {
                let told = "go on from what was kept last: hydrograd simulate --resume";
                assert!(said.contains("signal 9") && said.matches(told).count() == 1, "{said}");
            }
            "stopped" | "one-stopped" => {
                assert_eq!(said.matches("keeps what there is").count(), 1, "one rank speaks: {said}");
                assert!(!said.contains("does not answer"), "{said}");
            }
            _ => {
                assert_eq!((output.status.code(), said.matches("error: ").count()), (Some(1), 1), "{said}");
                std::fs::remove_dir_all(out.join("history.csv")).unwrap();
            }
        }
        let steps = || TensorFile::read(&out.join("checkpoint.safetensors")).unwrap().text("step").unwrap().to_owned();
        let kept: f64 = steps().parse().unwrap();
        let until = 0.0005 * (kept + 20.0);
        simulated(3, &format!("--resume {} --set time.end={until}", out.display()), &out);
        assert_eq!(steps(), (kept + 20.0).to_string());
    }
}

/// Frames in pieces, one of every rank, are those of one process: the same particles in the same order.
#[test]
fn frames_are_written_in_pieces() {
    let folder = tempfile::tempdir().unwrap();
    let scene = "heated-channel --set time.steps=40 --set objective.window=0.01 --set output.frames=4";
    let frames = |ranks: usize, name: &str| {
        let out = folder.path().join(name);
        simulated(ranks, scene, &out);
        let list = read_list(&out.join("particles/particles.pvd")).unwrap();
        list.into_iter().map(|(time, path)| (time, read_frame(&path).unwrap(), path)).collect::<Vec<_>>()
    };
    let (alone, shared) = (frames(0, "alone"), frames(3, "shared"));
    assert_eq!((alone.len(), shared.len()), (5, 5));
    for ((time, whole, _), (shared_time, joined, path)) in alone.iter().zip(&shared) {
        assert_eq!(time, shared_time);
        assert_eq!(path.extension().unwrap(), "pvtp");
        let pieces = ["_0.vtp", "_1.vtp", "_2.vtp"].map(|end| path.to_str().unwrap().replace(".pvtp", end));
        let counts = pieces.map(|piece| read_vtp(Path::new(&piece)).unwrap().position.len());
        assert!(counts.iter().sum::<usize>() == whole.position.len() && counts.iter().all(|&n| n > 100), "{counts:?}");
        assert!(joined.number.iter().enumerate().all(|(i, &number)| number == i as u64));
        assert_eq!(joined.tag, whole.tag);
        let apart = |a: &[[f64; 3]], b: &[[f64; 3]]| {
            assert_eq!(a.len(), b.len());
            a.iter().flatten().zip(b.iter().flatten()).fold(0.0f64, |most, (a, b)| most.max((a - b).abs()))
        };
        assert!(apart(&joined.position, &whole.position) < 1e-12 && apart(&joined.velocity, &whole.velocity) < 1e-11);
        assert!(joined.scalars.keys().eq(whole.scalars.keys()));
        for (name, values) in &whole.scalars {
            let most = values.iter().fold(0.0f64, |most, x| most.max(x.abs()));
            let worst = values.iter().zip(&joined.scalars[name]).fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs()));
            assert!(worst < 1e-11 * most.max(1.0), "{name}: {worst}");
        }
    }
}

/// A data set by `hydrograd generate` with so many ranks: its folder, and what was printed.
fn generated(ranks: usize, set: &str, out: PathBuf) -> (PathBuf, String) {
    let mut command = hydrograd(ranks);
    command.arg("generate").args(set.split(' ')).args(["--threads", "1", "--out"]).arg(&out);
    let output = output(&mut command);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    (out, said)
}

/// Where there are fewer flows than ranks, these share every flow, also the rest before it.
#[test]
fn a_data_set_of_shared_flows_is_that_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let set = "taylor-green --dx 0.04 --trajectories 1/1/0 --frames 5 --relax 200 --every 10 --precision f64";
    let make = |ranks: usize, name: &str| generated(ranks, set, folder.path().join(name));
    let ((alone, _), (shared, said)) = (make(0, "alone"), make(3, "shared"));
    assert!(said.contains("3 ranks share every flow of 625 particles"), "{said}");
    for split in ["train", "valid"] {
        let read = |folder: &Path| {
            let file = hdf5::File::open(folder.join(format!("{split}.h5"))).unwrap();
            file.dataset("00000/position").unwrap().read_raw::<f32>().unwrap()
        };
        let (a, b) = (read(&alone), read(&shared));
        assert_eq!(a.len(), 5 * 625 * 2);
        let worst = a.iter().zip(&b).fold(0.0f32, |worst, (a, b)| worst.max((a - b).abs()));
        assert!(worst < 1e-6, "{split}: {worst}");
    }
}

/// The report of `hydrograd check-gradient` by so many ranks.
fn checked(ranks: usize, scene: &str, out: &Path) -> serde_json::Value {
    let mut command = hydrograd(ranks);
    command
        .args(["check-gradient", "--directions", "1"])
        .args(scene.split(' '))
        .args(["--threads", "1", "--out"])
        .arg(out);
    let output = output(&mut command);
    assert!(output.status.success(), "{scene}: {}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(said.matches("PASSED").count(), 1, "one rank speaks: {said}");
    serde_json::from_str(&std::fs::read_to_string(out.join("gradient_check.json")).unwrap()).unwrap()
}

/// Runs long enough that particles are handed over (in every second step of the channel). Every kind of shift, both methods, a drive, both
/// precisions, segments and recomputed states, two and three dimensions.
const GRADIENTS: [&str; 10] = [
    "heated-channel --steps 30",
    "heated-channel --steps 80 --memory 5MB",
    "heated-channel --steps 80 --set optimise.segment=8",
    "heated-channel --steps 30 --set method.shift=isotropic",
    "heated-channel --steps 30 --set fluid.drive=flow-rate",
    // So tall that one of three ranks (it is shared by three) has no walls.
    "heated-channel --steps 12 --dx 0.025 --set method.shift=isotropic --set channel.length=0.5 --set channel.height=1.5 --set channel.hot_from=0.15 --set channel.hot_to=0.35 --set objective.target_x=0.42 --set fluid.body_force=0.03",
    "heated-channel --steps 30 --method standard",
    "heated-channel --steps 30 --method standard --set method.transport_velocity=1",
    "heated-channel --steps 40 --precision f32",
    "heated-channel-3d --steps 12 --dx 0.033333333",
];

/// The gradient by two or three ranks is that of one process, and that of differences of runs, which ranks make as well.
#[test]
fn a_gradient_over_ranks_is_that_of_one() {
    for (number, scene) in GRADIENTS.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let of = |report: &serde_json::Value, key: &str| -> Vec<f64> {
            report[key].as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
        };
        let growth = |report: &serde_json::Value| -> Vec<f64> {
            report["growth"].as_array().unwrap().iter().map(|at| at["norm"].as_f64().unwrap()).collect()
        };
        let alone = checked(0, scene, &folder.path().join("alone"));
        let wanted = of(&alone, "gradient");
        let ranks = sharing(number);
        let shared = checked(ranks, scene, &folder.path().join("shared"));
        let found = of(&shared, "gradient");
        assert_eq!(found.len(), wanted.len());
        let size = wanted.iter().map(|x| x * x).sum::<f64>().sqrt();
        let worst = found.iter().zip(&wanted).fold(0.0f64, |most, (a, b)| most.max((a - b).abs())) / size;
        println!("{scene}: {ranks} ranks, {worst:.1e}");
        let tolerance = if scene.contains("f32") { 1e-4 } else { 1e-10 };
        assert!(size > 0.0 && worst <= tolerance, "{scene}, {ranks} ranks: {worst}");
        // The lengths of cotangents of the state, too.
        for (a, b) in growth(&shared).iter().zip(growth(&alone)) {
            assert!((a / b - 1.0).abs() <= 10.0 * tolerance, "{scene}, {ranks} ranks: {a}, {b}");
        }
    }
}

/// A search by two ranks finds what one process finds, and goes on with another number of ranks.
#[test]
fn a_search_over_ranks_is_that_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let search = |ranks: usize, more: &str, out: &Path| -> serde_json::Value {
        let mut command = hydrograd(ranks);
        command.args("optimize --no-verify --threads 1".split(' ')).args(more.split(' ')).arg(out);
        let output = output(&mut command);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(String::from_utf8_lossy(&output.stdout).matches("next: hydrograd simulate").count(), 1);
        serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap()
    };
    let scene = "heated-channel --set optimise.search=scene --set resolution.dx=0.025 --set time.end=0.2 --set objective.window=0.1";
    let whole = search(0, &format!("{scene} --epochs 4 --out"), &place("alone"));
    search(2, &format!("{scene} --epochs 2 --out"), &place("parts"));
    let parts = search(3, "--epochs 4 --resume", &place("parts"));
    let [a, b] = [&whole, &parts].map(|summary| summary["q"].as_f64().or(summary["q_best"].as_f64()).unwrap());
    assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
}

/// Ranks make whole flows of a data set each: the same files as one process makes.
#[test]
fn a_data_set_by_ranks_is_that_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let set = "heated-channel --set resolution.dx=0.025 --skip 20 --trajectories 3/1/1 --frames 6";
    let make = |ranks: usize, name: &str| generated(ranks, set, folder.path().join(name));
    let ((alone, _), (shared, said)) = (make(0, "alone"), make(3, "shared"));
    assert!(said.contains("3 ranks: each makes whole flows") && said.contains("5 trajectories made"), "{said}");
    for split in ["train", "valid", "test"] {
        let open = |folder: &Path| hdf5::File::open(folder.join(format!("{split}.h5"))).unwrap();
        let (a, b) = (open(&alone), open(&shared));
        let names = |file: &hdf5::File| file.member_names().unwrap();
        assert_eq!(names(&a), names(&b));
        for name in names(&a) {
            let read =
                |file: &hdf5::File| file.dataset(&format!("{name}/position")).unwrap().read_raw::<f32>().unwrap();
            assert_eq!(read(&a), read(&b), "{split}, {name}");
        }
    }
    let (_, again) = make(2, "shared");
    assert!(again.contains("is complete: 5 trajectories"), "{again}");
}

/// From several starts every rank makes whole searches, and the first one compares them.
#[test]
fn starts_by_ranks_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let gains = |ranks: usize| {
        let out = folder.path().join(ranks.to_string());
        let mut command = hydrograd(ranks);
        command
            .args("optimize heated-channel --start all --epochs 2 --no-verify --threads 1 --out".split(' '))
            .arg(&out);
        let output = output(&mut command);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(said.contains("each searches from starts of its own"), ranks > 0, "{said}");
        let summary: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
        ["flat", "random", "linear", "sine"].map(|start| summary[start]["q"].as_f64().unwrap())
    };
    assert_eq!(gains(0), gains(3));
}

/// Designs that ranks cannot share.
#[test]
fn searches_that_ranks_cannot_share_are_told_once() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    for (what, text, advice) in [
        ("optimize heated-channel", "a search by fixed particles over several ranks", "optimise.search=scene"),
        ("optimize heated-channel --dynamics surrogate", "a surrogate over several ranks", "without mpirun"),
        ("optimize heated-channel --compare", "a comparison of searches over several ranks", "without mpirun"),
        ("check-gradient heated-channel --method fixed", "method.name = fixed over several ranks", "without mpirun"),
        ("check-gradient heated-channel --set optimise.clip=10", "a clipped gradient", "optimise.clip=0"),
        ("check-gradient heated-channel --set optimise.gradient=truncated", "not that of one whole run", "segments"),
        ("check-gradient heated-channel --set time.adaptive=true", "time.adaptive", "time.adaptive=false"),
    ] {
        let mut command = hydrograd(2);
        command.args(what.split(' ')).arg("--out").arg(&out);
        let output = output(&mut command);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{what}: {said}");
        assert_eq!(said.lines().filter(|line| line.starts_with("error: ")).count(), 1, "{what}: {said}");
        assert!(said.contains(text) && said.contains(advice), "{what}: {said}");
        assert!(!out.exists(), "{what}");
    }
}

#[test]
fn what_ranks_cannot_share_is_told_once() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    for (scene, text, advice) in [
        ("taylor-green --set time.clf=1", "unknown field `clf`", ""),
        ("taylor-green --recover", "--recover over several ranks", "time.cfl=0.5"),
        ("taylor-green --error", "--error over several ranks", "one process"),
        ("taylor-green --kernels composed", "composed kernels over several ranks", "without mpirun"),
        ("heated-channel --method fixed", "method.name = fixed over several ranks", "without mpirun"),
        ("vortex-street", "over several ranks", "without mpirun"),
        (
            "taylor-green --method standard --set method.density_equation=evolution --set method.flux=delta --set method.density_gradient=jax-sph",
            "these keys",
            "without mpirun",
        ),
        ("taylor-green --dx 0.1", "100 particles for 2 ranks", "fewer ranks"),
    ] {
        let output = output(&mut simulate(2, scene, &out));
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{scene}: {said}");
        assert_eq!(said.lines().filter(|line| line.starts_with("error: ")).count(), 1, "{scene}: {said}");
        assert!(said.contains(text) && said.contains(advice), "{scene}: {said}");
        assert!(!out.exists(), "{scene}");
    }
}

/// A run that diverges says so as one process does.
#[test]
fn a_flow_that_diverges_is_told_once() {
    let folder = tempfile::tempdir().unwrap();
    let scene = "heated-channel --set time.cfl=2 --set design.shape=sine --set design.amplitude=0.02 --set time.end=1 --set objective.window=0.2";
    let [alone, both] = [0, 2].map(|ranks| {
        let out = folder.path().join(ranks.to_string());
        let output = output(&mut simulate(ranks, scene, &out));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(3), "{said}");
        assert!(out.join("last-good.safetensors").exists(), "{said}");
        said.lines().find(|line| line.contains("error: ")).unwrap().to_owned()
    });
    assert_eq!(alone, both);
}

/// Commands that ranks do not share are refused once, before anything is written.
#[test]
fn other_commands_are_for_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = hydrograd(2);
    command.current_dir(folder.path()).args(["validate", "--quick", "--out", "unwritten"]);
    let output = output(&mut command);
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert_eq!(error.matches("2 processes, each of which would do all of this command").count(), 1, "{error}");
    assert!(!folder.path().join("unwritten").exists());
}
