//! Configurations drawn at random: each is either refused with one clear error, or runs, or says that the run has diverged.
//! Nothing panics. `HYDROGRAD_RANDOM=60` draws so many of each scene (about a thousand in all).

use crate::support::advice;
use hydrograd::adjoint::run::run;
use hydrograd::adjoint::RunError;
use hydrograd::config::builtin::SCENES;
use hydrograd::config::range::Range;
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::config::schema::{described, Schema};
use hydrograd::error::Error;
use hydrograd::numerics::random::{numbered, uniform};
use hydrograd::scene::plausible::Findings;
use hydrograd::scene::Scene;
use hydrograd::sph::divergence::Divergence;
use hydrograd::sph::dynamics::Sph;
use rand_chacha::ChaCha8Rng;
use std::panic::{catch_unwind, AssertUnwindSafe};

fn count() -> u32 {
    std::env::var("HYDROGRAD_RANDOM").ok().and_then(|count| count.parse().ok()).unwrap_or(6)
}

fn below(random: &mut ChaCha8Rng, count: usize) -> usize {
    ((uniform(random) * count as f64) as usize).min(count - 1)
}

/// A value for a number: most are near the usual one, some at an end of what is allowed.
fn value(random: &mut ChaCha8Rng, usual: f64, range: Range) -> f64 {
    let near = if usual == 0.0 { uniform(random) } else { usual * 10f64.powf(2.0 * uniform(random) - 1.0) };
    let ends = match range {
        Range::Within(low, high) | Range::Above(low, high) | Range::Below(low, high) => [low, high],
        Range::Positive => [1e-12, 1e12],
        Range::NotNegative | Range::AtLeast(_) => [0.0, 1e12],
        Range::Finite => [-1e12, 1e12],
    };
    match below(random, 8) {
        0 => ends[0],
        1 => ends[1],
        2 => ends[0] + uniform(random) * (ends[1] - ends[0]),
        _ => near,
    }
}

/// What makes a scene large, or its run long: left as it is, or coarse.
const LEFT: [&str; 7] = [
    "time.end",
    "time.steps",
    "run.threads",
    "design.control_points",
    "design.control_points_across",
    "channel.length",
    "region.size",
];

fn coarse(scene: &str) -> &'static [&'static str] {
    match scene {
        "heated-channel" => &["resolution.dx=0.025"],
        "heated-channel-3d" => {
            &["resolution.dx=0.04", "channel.span=0.24", "design.bound=0.008", "design.amplitude=0.005"]
        }
        "dam-break" => &["resolution.dx=0.1"],
        "dam-break-3d" => &["resolution.dx=0.2"],
        "taylor-green-3d" | "lid-driven-cavity-3d" | "reverse-poiseuille-3d" => &["resolution.dx=0.1"],
        "falling-block" => &[],
        _ => &["resolution.dx=0.05"],
    }
}

/// Most particles times steps that are waited for.
const MOST: usize = 20_000;
const STEPS: usize = 20;

/// Whether the scene ran; what it did that it may not do.
fn attempt(scene: &str, sets: &[String]) -> Result<bool, String> {
    let loaded = match Config::load(Some(scene), None, sets) {
        Ok(loaded) => loaded,
        Err(Error::Input(bad)) if bad.to_string().len() < 4000 => return Ok(false),
        Err(error) => return Err(format!("another error than of bad input, or a very long one: {error}")),
    };
    let scene = match Scene::<f64>::from_config(&loaded.config) {
        Ok(scene) => scene,
        Err(Error::Input(_)) => return Ok(false),
        Err(error) => return Err(error.to_string()),
    };
    if scene.model.particles() * STEPS > 20 * MOST {
        return Ok(false);
    }
    let dynamics = Sph::new(scene.model.clone(), Kernels::Fused);
    let ended = run(&dynamics, &scene.start, STEPS, &mut []);
    Ok(ended.is_ok())
}

#[test]
fn random_numbers_run_or_are_refused() {
    let (mut ran, mut all) = (0, 0);
    for (place, scene) in SCENES.iter().enumerate() {
        let keys: Vec<String> = described::<Config>(scene.text()).into_iter().map(|(key, _)| key).collect();
        let usual = scene.family().defaults_with("consistent");
        let numbers: Vec<_> =
            usual.numbers().into_iter().filter(|(key, ..)| keys.iter().any(|own| own == key)).collect();
        let numbers: Vec<_> =
            numbers.into_iter().filter(|(key, ..)| !LEFT.contains(key) && *key != "resolution.dx").collect();
        for number in 0..count() {
            let mut random = numbered(9, "rand", (1000 * place) as u32 + number);
            let mut sets: Vec<String> = coarse(scene.name).iter().map(|set| set.to_string()).collect();
            sets.push(format!("time.steps={STEPS}"));
            if keys.iter().any(|key| key == "objective.window") {
                sets.push("objective.window=0".into());
            }
            for _ in 0..1 + below(&mut random, 3) {
                let (key, usual, range) = numbers[below(&mut random, numbers.len())];
                let x = value(&mut random, usual, range);
                let whole = usual.fract() == 0.0 && toml_is_whole(scene.text(), key);
                sets.push(if whole { format!("{key}={}", x.round() as i64) } else { format!("{key}={x:e}") });
            }
            if number % 3 == 0 && keys.iter().any(|key| key == "method.name") {
                sets.push("method.name=standard".into());
            }
            let outcome = catch_unwind(AssertUnwindSafe(|| attempt(scene.name, &sets)));
            match outcome {
                Ok(Ok(done)) => ran += usize::from(done),
                Ok(Err(problem)) => panic!("{} {sets:?}: {problem}", scene.name),
                Err(_) => panic!("{} {sets:?} panicked", scene.name),
            }
            all += 1;
        }
    }
    assert!(4 * ran > all, "only {ran} of {all} ran: they say little");
}

/// Values that are wrong by themselves or together: what the error suggests is taken.
#[test]
fn suggestions_for_wrong_numbers_can_be_followed() {
    let (mut taken, mut refused) = (0, 0);
    for (place, scene) in SCENES.iter().enumerate() {
        let keys: Vec<String> = described::<Config>(scene.text()).into_iter().map(|(key, _)| key).collect();
        let numbers = scene.family().defaults().numbers();
        for (number, (key, usual, _)) in
            numbers.into_iter().filter(|(key, ..)| keys.iter().any(|own| own == key)).enumerate()
        {
            let mut random = numbered(11, "wrong", (1000 * place + number) as u32);
            let near = usual * (0.5 + uniform(&mut random));
            for value in [-1.0, 0.0, 1e12, 0.37 * usual, 2.7 * usual, (1e3 * near).round() / 1e3] {
                let sets = [match toml_is_whole(scene.text(), key) {
                    true => format!("{key}={}", value.round() as i64),
                    false => format!("{key}={value:e}"),
                }];
                if let Err(Error::Input(bad)) = Config::load(Some(scene.name), None, &sets) {
                    refused += 1;
                    taken += advice::are_possible(scene.name, &sets, &bad.to_string());
                }
            }
        }
    }
    println!("{refused} refusals, {taken} suggestions");
    assert!(2 * taken > refused, "only {taken} suggestions of {refused} errors: they say little");
}

/// Whether a key's value in a scene's text is a whole number.
fn toml_is_whole(text: &str, key: &str) -> bool {
    let (section, name) = key.split_once('.').unwrap_or(("", key));
    let section = text.split(&format!("[{section}]\n")).nth(1).unwrap_or_default();
    let section = section.split("\n[").next().unwrap_or_default();
    let start = format!("{name} = ");
    let line = section.lines().map(|line| line.trim_start_matches("# ")).find(|line| line.starts_with(&start));
    line.is_some_and(|line| line[start.len()..].parse::<i64>().is_ok())
}

/// Texts of scenes with lines lost, doubled, or with other characters in them.
#[test]
fn mutilated_files_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    let mut refused = 0;
    let mut all = 0;
    for (place, scene) in SCENES.iter().enumerate() {
        let lines: Vec<&str> = scene.text().lines().filter(|line| !line.starts_with('#')).collect();
        for number in 0..10 * count() {
            let mut random = numbered(4, "mutt", (10_000 * place) as u32 + number);
            let mut lines: Vec<String> = lines.iter().map(|line| line.to_string()).collect();
            for _ in 0..1 + below(&mut random, 3) {
                let at = below(&mut random, lines.len());
                match below(&mut random, 4) {
                    0 => drop(lines.remove(at)),
                    1 => lines.insert(at, lines[at].clone()),
                    2 => {
                        let other = below(&mut random, lines.len());
                        lines.swap(at, other);
                    }
                    _ => {
                        let mut text: Vec<char> = lines[at].chars().collect();
                        const ODD: [char; 16] =
                            ['"', '[', ']', '=', '-', '.', '0', '9', 'e', '#', '{', '\'', ',', '\\', 'ü', '\u{0}'];
                        let odd = ODD[below(&mut random, ODD.len())];
                        match text.is_empty() {
                            true => text.push(odd),
                            false => text[below(&mut random, lines[at].chars().count())] = odd,
                        }
                        lines[at] = text.into_iter().collect();
                    }
                }
            }
            std::fs::write(&path, lines.join("\n")).unwrap();
            let found = catch_unwind(|| Config::load(path.to_str(), None, &[]));
            match found {
                Ok(Ok(_)) => {}
                Ok(Err(Error::Input(bad))) if bad.to_string().len() < 4000 => refused += 1,
                Ok(Err(error)) => panic!("{}, {number}: another or a very long error: {error}", scene.name),
                Err(_) => panic!("{}, {number}: panicked on\n{}", scene.name, lines.join("\n")),
            }
            all += 1;
        }
    }
    assert!(2 * refused > all, "only {refused} of {all} were refused");
}

/// A scene of one's own with up to three shapes at random places, small and thin ones too.
fn own_scene(random: &mut ChaCha8Rng) -> String {
    let mut text =
        "scene = \"custom\"\n[region]\nsize = [0.5, 0.4]\nacceleration = [1.0, 0.0]\n[resolution]\ndx = 0.025\n\
                    [objective]\nwindow = 0\n"
            .to_string();
    let viscosity = [0.001, 0.01, 0.1][below(random, 3)];
    let velocity = [0.3, 1.0][below(random, 2)];
    text += &format!("[fluid]\nviscosity = {viscosity}\nreference_velocity = {velocity}\n[time]\nsteps = 60\n");
    for _ in 0..1 + below(random, 3) {
        let [x, y] = [0.5, 0.4].map(|size| (1.2 * uniform(random) - 0.1) * size);
        let mut length = || 0.01 * 15f64.powf(uniform(random));
        let [a, b, c, d] = [length(), length(), length(), length()];
        text += "[[shapes]]\n";
        text += &match below(random, 4) {
            0 => format!("kind = \"box\"\nlower = [{x}, {y}]\nupper = [{}, {}]\n", x + a, y + b),
            1 => format!("kind = \"disc\"\ncentre = [{x}, {y}]\nradius = {a}\n"),
            2 => format!("kind = \"polyline\"\npoints = [[{x}, {y}], [0.25, 0.2]]\nthickness = {a}\n"),
            _ => {
                let points = [[x + a, y], [x, y + b], [x - c, y], [x, y - d]];
                format!("kind = \"polygon\"\npoints = {points:?}\n")
            }
        };
        if below(random, 4) == 0 {
            text += &format!("velocity = [{velocity}, 0.0]\n");
        }
    }
    text
}

/// Loads a scene's file and runs it; the error's text and its advice.
fn attempt_own(path: &str, sets: &[String]) -> Result<(), (String, String)> {
    let told = |error: &Error| {
        let text = error.to_string();
        (text.clone(), text.split("\n  try: ").nth(1).unwrap_or_default().to_string())
    };
    let loaded = Config::load(Some(path), None, sets).map_err(|error| told(&error))?;
    let scene = Scene::<f64>::from_config(&loaded.config).map_err(|error| told(&error))?;
    let dynamics = Sph::new(scene.model.clone(), Kernels::Fused);
    let Err(error) = run(&dynamics, &scene.start, scene.steps, &mut []) else { return Ok(()) };
    let error: RunError = error.downcast().expect("an error of the flow");
    let mut found = Divergence::of(&error, &scene.model, &scene.start).expect("an error of the flow");
    let findings = Findings::of(&loaded.config, &scene).unwrap();
    let own = findings.cause(&loaded.config, &found.cause, &found.position).unwrap();
    found.cause = own.unwrap_or(found.cause);
    assert!(!found.cause.is_open, "no cause is named: {}", found.told(""));
    Err((found.told("").to_string(), found.cause.advice))
}

/// Scenes of one's own run, or are refused, or diverge with a cause; what is suggested first, applied once, leads to a run
/// in nine of ten. (`scripts/random_scenes.py` draws more kinds of them, and longer runs.)
#[test]
fn random_scenes_of_ones_own_run_or_lead_to_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    let path = path.to_str().unwrap();
    let (mut ran, mut unhappy, mut led) = (0, 0, 0);
    for number in 0..5 * count() {
        let text = own_scene(&mut numbered(5, "ownn", number));
        std::fs::write(path, &text).unwrap();
        let outcome = catch_unwind(AssertUnwindSafe(|| attempt_own(path, &[])));
        let outcome = outcome.unwrap_or_else(|_| panic!("{number} panicked on\n{text}"));
        let Err((problem, advice)) = outcome else {
            ran += 1;
            continue;
        };
        assert!(!advice.is_empty(), "{number} suggests nothing: {problem}");
        unhappy += 1;
        let first = advice.split(", or ").next().unwrap_or_default();
        let words = first.split(' ').map(|word| word.trim_matches(['(', ')', ',']));
        let sets: Vec<String> = words.filter(|word| word.contains('=')).map(String::from).collect();
        match attempt_own(path, &sets) {
            Ok(()) => led += 1,
            Err((then, _)) => println!("{number}: {problem}\n{sets:?}: {then}\n{text}\n"),
        }
    }
    assert!(ran > 0 && unhappy > 0 && 10 * led >= 9 * unhappy, "{ran} ran, {led} of {unhappy} were led to a run");
}
