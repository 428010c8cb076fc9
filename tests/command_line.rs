//! The command line within the process: options and keys, shares, exit codes, how the program is started again.

use anyhow::Context;
use clap::{CommandFactory, Parser};
use hydrograd::cli::arguments::{with_options, OPTIONS};
use hydrograd::cli::{guarded, program, Cli, Command};
use hydrograd::config::memory_size::MemorySize;
use hydrograd::config::scene::{Config, GradientMode, Kernels, Precision, ShapeName};
use hydrograd::error::{BadInput, Error, EXIT_INTERNAL};
use std::ffi::OsString;
use std::path::Path;

#[test]
fn advice_about_keys_becomes_options() {
    for (advice, expected) in [
        ("resolution.dx=0.025 or resolution.dx=0.02", "--set resolution.dx=0.025 or --set resolution.dx=0.02"),
        ("optimise.memory=20MB, or a smaller resolution.dx", "--memory 20MB, or a smaller resolution.dx"),
        ("clipping (clip=1)", "clipping (--set clip=1)"),
        ("a data set with trajectories=4/2/2", "a data set with --trajectories 4/2/2"),
        ("seed=1 model.latent=8", "--set seed=1 --set model.latent=8"),
        ("region.size[1]=0.5", "--set region.size[1]=0.5"),
        ("--set time.cfl=1 or --memory 3MB", "--set time.cfl=1 or --memory 3MB"),
        ("the built-in scene's time.cfl = 2", "the built-in scene's time.cfl = 2"),
        ("`hydrograd scenes heated-channel` prints them", "`hydrograd scenes heated-channel` prints them"),
    ] {
        let message = |advice: &str| format!("a.toml: time.cfl=9 is bad\n  allowed: time.cfl=1\n  try: {advice}");
        assert_eq!(with_options(&message(advice)), message(expected));
    }
}

#[test]
fn options_name_keys() {
    let known = hydrograd::config::schema::known_keys::<Config>();
    assert!(OPTIONS.iter().all(|(_, key)| known.iter().any(|known| known == key)));
}

#[test]
fn exit_codes() {
    assert_eq!(guarded(|| Ok(())), 0);
    assert_eq!(guarded(|| Err(Error::run("disk full", "another disk").into())), 1);
    assert_eq!(guarded(|| Err(Error::diverged("diverged", "a smaller time.cfl").into())), 3);
    assert_eq!(guarded(|| Err(Error::diverged("diverged", "less")).context("in case 7")), 3);
    assert_eq!(guarded(|| Err(anyhow::anyhow!("disk full"))), 1);
    assert_eq!(guarded(|| Err(Error::from(BadInput::new("bad")).into())), 2);
    assert_eq!(guarded(|| Err(BadInput::new("bad")).context("while reading")), 2);
    assert_eq!(guarded(|| panic!("a bug")), EXIT_INTERNAL);
    assert_eq!(guarded(|| panic!("failed printing to stdout: Broken pipe")), 128 + 13);
}

#[test]
fn command_line_is_consistent() {
    Cli::command().debug_assert();
}

fn parse(line: &str) -> Command {
    Cli::try_parse_from(line.split(' ')).unwrap().command
}

#[test]
fn options_override_keys() {
    let line = "hydrograd optimize --precision f32 --threads 2 --seed 9 --kernels composed --gradient truncated \
                --segment 7 --memory 1.5GiB --store f32 --horizon 30 --epochs 3 --start random --set run.threads=5 --set time.end=1";
    let Command::Optimize(arguments) = parse(line) else { panic!("not optimize") };
    let loaded = arguments.load().unwrap();
    let mut expected = Config::default();
    expected.run.precision = Precision::F32;
    expected.run.threads = 2;
    expected.run.seed = 9;
    expected.run.kernels = Kernels::Composed;
    expected.optimise.gradient = GradientMode::Truncated;
    expected.optimise.segment = 7;
    expected.optimise.memory = MemorySize(3 << 29);
    expected.optimise.store = Precision::F32;
    expected.optimise.horizon = 30;
    expected.optimise.epochs = 3;
    expected.design.shape = ShapeName::Random;
    expected.time.end = 1.0;
    assert_eq!(loaded.config, expected);
    let folder = arguments.folder(&loaded).unwrap();
    assert_eq!(folder, Path::new("runs/optimize-heated-channel"));
}

#[test]
fn options_that_newcomers_try() {
    let line =
        "hydrograd optimize --method standard --dx 0.025 --end 1.5 --optimiser adam --learning-rate 1e-3 --bound 0.01";
    let Command::Optimize(arguments) = parse(line) else { panic!("not optimize") };
    let config = arguments.load().unwrap().config;
    let sets = ["method.name=standard", "resolution.dx=0.025", "time.end=1.5", "optimise.method=adam"];
    let sets = [&sets[..], &["optimise.learning_rate=1e-3", "design.bound=0.01"]].concat();
    let sets: Vec<String> = sets.into_iter().map(String::from).collect();
    assert_eq!(config, Config::load(None, None, &sets).unwrap().config);
    let Command::Simulate(arguments) = parse("hydrograd simulate --dx 0.03") else { panic!("not simulate") };
    let error = arguments.load().unwrap_err().to_string();
    assert!(error.starts_with("--dx 0.03: resolution.dx = 0.03 does not divide"), "{error}");
}

#[test]
fn check_gradient_takes_the_last_step_unless_told() {
    let Command::CheckGradient(arguments) = parse("hydrograd check-gradient --steps 20") else {
        panic!("not check-gradient")
    };
    let config = arguments.load().unwrap().config;
    assert_eq!((config.time.steps, config.objective.window), (Some(20), 0.0));
    let line = "hydrograd check-gradient --steps 200 --set objective.window=0.1";
    let Command::CheckGradient(arguments) = parse(line) else { panic!("not check-gradient") };
    let config = arguments.load().unwrap().config;
    assert_eq!((config.time.steps, config.objective.window), (Some(200), 0.1));
}

#[test]
fn resume_reads_the_run_and_stays_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let text = Config::load(None, None, &["run.seed=4".into()]).unwrap().text;
    std::fs::write(folder.path().join("config.toml"), text).unwrap();
    let line = format!("hydrograd optimize --epochs 40 --resume {}", folder.path().display());
    let Command::Optimize(arguments) = parse(&line) else { panic!("not optimize") };
    let loaded = arguments.load().unwrap();
    assert_eq!((loaded.config.run.seed, loaded.config.optimise.epochs), (4, 40));
    assert_eq!(arguments.folder(&loaded).unwrap(), folder.path());
}

#[test]
fn words_before_the_arguments_stay_there() {
    // Without other words it is the test itself.
    assert_eq!(program::words().unwrap(), [std::env::current_exe().unwrap().into_os_string()]);
    let words = ["echo", "-m", "hydrograd"].map(OsString::from);
    let output = program::command(&words).arg("study").output().unwrap();
    assert_eq!(String::from_utf8(output.stdout).unwrap().trim(), "-m hydrograd study");
}

#[test]
fn shares_are_all_pieces_once() {
    let all: Vec<usize> = (0..11).collect();
    for count in 1..14 {
        let mut found: Vec<usize> = Vec::new();
        for index in 0..count {
            let Command::Generate(arguments) = parse(&format!("hydrograd generate --shard {index}/{count}")) else {
                panic!("not generate")
            };
            let shard = arguments.shard.share().unwrap().unwrap();
            let own: Vec<usize> = shard.of(&all).copied().collect();
            assert!(all.iter().all(|&k| shard.has(k) == own.contains(&k)));
            found.extend(own);
        }
        found.sort_unstable();
        assert_eq!(found, all);
    }
}
