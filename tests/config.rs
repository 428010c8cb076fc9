//! Keys and their values: ranges, formulas, amounts of memory, devices; what follows from them; differences between scenes and trainings.

use hydrograd::config::builtin::SCENES;
use hydrograd::config::checks::channel::nearest_spacings;
use hydrograd::config::custom::{Side, SideKind};
use hydrograd::config::device::{Compute, DeviceName};
use hydrograd::config::difference::{difference, differences, Difference};
use hydrograd::config::formula::Formula;
use hydrograd::config::memory_size::MemorySize;
use hydrograd::config::range::Range;
use hydrograd::config::scene::{Config, Family, KernelName, Kernels, Method, Standard};
use hydrograd::config::schema::{values, Schema};
use hydrograd::config::suggest::nearest;
use hydrograd::config::training::Settings;
use serde::{Deserialize, Serialize};

#[test]
fn families_and_their_scenes_have_the_same_name() {
    for built_in in SCENES {
        let family = built_in.family();
        assert_eq!(family.name(), built_in.name);
        assert_eq!(family.built_in(), built_in);
        assert_eq!(family.defaults().scene, family);
        assert_eq!(toml::Value::try_from(family).unwrap().as_str(), Some(built_in.name), "as the key `scene` has it");
    }
}

#[test]
fn nearest_spacings_divide_both() {
    let near = |dx: f64, across: &[f64]| nearest_spacings(dx, &[&[1.0], across].concat());
    assert_eq!(near(0.03, &[0.2]), [0.028571429, 0.033333333]);
    assert_eq!(near(0.021, &[0.26]), [0.02]);
    assert_eq!(near(0.03, &[0.2, 0.25]), [0.025, 0.05]);
    assert!(near(0.02, &[std::f64::consts::FRAC_1_PI]).is_empty());
}

#[test]
fn elements_of_arrays_and_shapes_are_set() {
    let shapes = "shapes=[{ kind = \"disc\", centre = [0.3, 0.2], radius = 0.1 }, \
                  { kind = \"polygon\", points = [[0.6, 0.2], [0.7, 0.2], [0.7, 0.3]] }]";
    let set = ["shapes[0].radius=0.05", "shapes[1].points[2][0]=0.8", "shapes[0].centre[1]=0.25", "region.size[1]=0.6"];
    let sets: Vec<String> = std::iter::once(shapes).chain(set).map(String::from).collect();
    let loaded = Config::load(Some("custom"), None, &sets).unwrap();
    let config = &loaded.config;
    assert_eq!((config.shapes[0].radius, config.shapes[0].centre.clone()), (Some(0.05), Some(vec![0.3, 0.25])));
    assert_eq!(config.shapes[1].points.as_ref().unwrap()[2], [0.8, 0.3]);
    assert_eq!(config.region.size, [1.0, 0.6]);
    // Each has its own place, and what is set as a whole replaces all.
    assert_eq!(loaded.place("shapes[0].radius"), Some("shapes[0].radius=0.05"));
    let again = Config::load(Some("custom"), None, &[&sets[..], &[shapes.to_string()]].concat()).unwrap();
    assert_eq!((again.config.shapes[0].radius, again.place("shapes[0].radius")), (Some(0.1), None));
    assert_eq!(loaded.with(&[]).unwrap().config, loaded.config);
}

#[test]
fn a_part_of_a_side_is_set_and_the_other_sides_stay() {
    let sets = [
        "region.periodic=[false,false]",
        "region.sides={ left = { kind = \"inflow\", velocity = [1, 0] }, right = { kind = \"outflow\" } }",
        "region.sides.top.kind=symmetry",
        "region.sides.left.velocity[0]=2",
        "method.name=fixed",
    ];
    let loaded = Config::load(Some("custom"), None, &sets.map(String::from)).unwrap();
    let sides = &loaded.config.region.sides;
    let kind = |side: &Option<Side>| side.as_ref().map(|side| side.kind);
    let kinds = [&sides.left, &sides.right, &sides.bottom, &sides.top].map(kind);
    assert_eq!(kinds, [Some(SideKind::Inflow), Some(SideKind::Outflow), None, Some(SideKind::Symmetry)]);
    let velocity = sides.left.as_ref().and_then(|side| side.velocity.clone()).unwrap();
    assert_eq!(velocity.iter().map(|formula| formula.0.as_str()).collect::<Vec<_>>(), ["2", "0"]);
    assert_eq!(loaded.place("region.sides.top.kind"), Some("region.sides.top.kind=symmetry"));
}

#[test]
fn the_time_step_is_that_of_the_report() {
    // JAX-SPH's resolved configuration of the heated channel has dt = 0.00045454545454545455.
    let mut config = Config::default();
    config.time.cfl = 0.25;
    config.time.steps = Some(2000);
    assert!((config.time_step() - 4.5454545454545455e-4).abs() < 1e-18);
    assert_eq!(config.steps(), 2000);
}

#[test]
fn a_run_ends_exactly() {
    let mut config = Config::default();
    for end in [0.001, 0.5, 2.0, 1.7] {
        config.time.end = end;
        assert!((config.duration() - end).abs() < 1e-14);
        assert!(config.time_step() <= config.time_step_limit() * (1.0 + 1e-8));
        let one_fewer = config.steps() - 1;
        assert!(one_fewer == 0 || end / one_fewer as f64 > config.time_step_limit());
    }
}

#[test]
fn support_follows_kernel_and_smoothing_length() {
    let mut config = Config::default();
    assert!((config.support() - 2.4).abs() < 1e-15 && (config.smoothing_length() - 0.016).abs() < 1e-17);
    // Half a spacing of the support is in the fluid.
    assert_eq!(config.least_wall_rows(), 2);
    config.resolution.smoothing_length = 1.1;
    assert_eq!(config.least_wall_rows(), 3);
    config.method = Method::named("standard").unwrap();
    config.resolution.smoothing_length = 1.0;
    assert_eq!((config.support(), config.smoothing_length(), config.least_wall_rows()), (3.0, 0.02, 3));
    config.resolution.smoothing_length = 1.1;
    assert!((config.support() - 3.3).abs() < 1e-15 && (config.smoothing_length() - 0.022).abs() < 1e-17);
    assert_eq!(config.least_wall_rows(), 4);
    config.resolution.kernel = KernelName::WendlandC2;
    config.resolution.smoothing_length = 1.5;
    assert_eq!((config.support(), config.least_wall_rows()), (3.0, 3));
}

#[test]
fn artificial_viscosity_limits_the_step() {
    let mut config = Family::TaylorGreen.defaults();
    config.method = Method::Standard(Standard { artificial_viscosity: 4.0, ..Standard::default() });
    config.resolution.smoothing_length = 1.0;
    // The artificial viscosity is 4 h c / 8 with h = 0.02 and c = 10, in addition to 1 / Re = 0.01.
    assert!((config.time_step_limits().diffusive - 0.25 * 4e-4 / 0.11).abs() < 1e-15);
    let mut config = Family::TaylorGreen3d.defaults();
    config.method = Method::Standard(Standard { artificial_viscosity: 1.0, ..Standard::default() });
    config.resolution.smoothing_length = 1.0;
    let dx = config.resolution.dx;
    assert!((config.artificial_kinematic_viscosity() - dx).abs() < 1e-15, "h c / 10");
}

#[test]
fn the_diffusive_limit_takes_over_at_fine_spacing() {
    let mut config = Config::default();
    config.resolution.dx = 0.001;
    let diffusive = 0.25 * 1e-6 / (7.313 / 305.27);
    assert!((config.time_step_limit() / diffusive - 1.0).abs() < 1e-12);
}

#[test]
fn names_of_devices_read_back() {
    for (text, device) in [("cpu", DeviceName::Cpu), ("cuda:0", DeviceName::Cuda(0)), ("cuda:13", DeviceName::Cuda(13))]
    {
        assert_eq!(text.parse(), Ok(device));
        assert_eq!(device.to_string(), text);
    }
    assert_eq!("cuda".parse(), Ok(DeviceName::Cuda(0)));
}

#[test]
fn what_is_no_device_is_refused() {
    for text in ["", "gpu", "CPU", "cuda:", "cuda:-1", "cuda:+1", "cuda:x", "cuda:99999", "cuda 0", "cpu:0"] {
        let error = text.parse::<DeviceName>().unwrap_err();
        assert!(error.contains(&format!("`{text}`")) && error.contains("cuda:N"), "{error}");
    }
}

#[test]
fn on_the_cpu_kernels_are_those_that_were_asked_for() {
    for kernels in [Kernels::Fused, Kernels::Composed] {
        let compute = Compute::from(kernels);
        assert!(compute.kernels() == kernels && compute.device().is_cpu());
    }
}

#[test]
fn scenes_differ_where_it_counts() {
    let before = Config::default();
    let mut now = before.clone();
    assert_eq!(difference(&before, &now, &[]), None);
    now.time.steps = Some(7);
    now.output.frames = 3;
    now.run.threads = 2;
    now.run.seed = 1;
    let found = differences(&before, &now, &["output", "run.threads"]);
    let words: Vec<String> = found.iter().map(Difference::to_string).collect();
    assert_eq!(words, ["run.seed = 0, not 1", "time.steps = nothing, not 7"]);
    now.scene = Family::TaylorGreen;
    let words = difference(&before, &now, &["output", "run", "time"]);
    assert_eq!(words.as_deref(), Some("scene = \"heated-channel\", not \"taylor-green\""));
}

#[test]
fn trainings_differ_key_by_key() {
    let before = Settings::default();
    let mut now = before.clone();
    now.steps += 1;
    now.model.latent = 8;
    let found = differences(&before, &now, &["steps"]);
    assert_eq!(found, [Difference { key: "model.latent".into(), before: "64".into(), now: "8".into() }]);
}

fn value(text: &str, place: [f64; 3]) -> f64 {
    Formula(text.into()).function("key", 3).unwrap_or_else(|bad| panic!("{bad}")).at(place)
}

#[test]
fn formulas_are_what_they_look_like() {
    let p = [0.5, -2.0, 3.0];
    for (text, expected) in [
        ("3", 3.0),
        ("-1.5e-3", -1.5e-3),
        ("x", 0.5),
        ("z - y - x", 4.5),
        ("z/x/2*y", -6.0),
        ("2 + 3*x^2", 2.75),
        ("1.5*y*(1 - y)", -9.0),
        ("sin(PI*x)", 1.0),
        ("max(min(x, z), 0)", 0.5),
        ("exp(-((x-0.5)^2 + y^2))", (-4.0f64).exp()),
        ("1 + (signum(y) + 1)/2", 1.0),
        ("0 - x^2", -0.25),
    ] {
        assert!((value(text, p) - expected).abs() < 1e-14, "{text}: {} is not {expected}", value(text, p));
    }
    // As documented.
    assert_eq!(value("-x^2", p), 0.25);
    assert!(value("sqrt(y)", p).is_nan() && value("1/(x - 0.5)", p).is_infinite());
}

#[test]
fn what_is_no_formula_is_an_error_that_shows_it() {
    for text in ["", "1 +", "sni(x)", "(x", "x)", "2 x", "a*x", "x = 3", "t", "x;y", "\"", "1,2", "sin()", "max(1,2,3)"]
    {
        let bad = Formula(text.into()).function("initial.velocity[1]", 2).map(|_| ()).expect_err(text);
        let message = bad.to_string();
        assert!(message.starts_with(&format!("initial.velocity[1] = \"{text}\"")), "{message}");
        assert!(message.contains("allowed: a number, or a formula"), "{message}");
        assert!(bad.is_about("initial.velocity[1]"));
    }
    let flat = Formula("z".into()).function("k", 2).unwrap_err().to_string();
    assert!(flat.contains("`z` is unknown; a place in 2 dimensions has x, y"), "{flat}");
}

/// The parser may reject a text, but must not panic.
#[test]
fn no_text_panics() {
    let parts =
        ["x", "y", "(", ")", "+", "-", "*", "/", "^", "sin", "max", ",", "1", ".", "e", "PI", " ", "é", "{", "}"];
    let mut seed = 1_u64;
    let mut read = 0;
    for _ in 0..20_000 {
        let mut text = String::new();
        for _ in 0..seed % 9 {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            text.push_str(parts[(seed >> 33) as usize % parts.len()]);
        }
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407) ^ (seed >> 17);
        if let Ok(function) = Formula(text).function("k", 3) {
            function.at([0.1, 0.2, 0.3]);
            read += 1;
        }
    }
    assert!(read > 100, "only {read} of them are formulas");
}

#[test]
fn numbers_stay_numbers() {
    #[derive(Serialize, Deserialize, PartialEq, Debug)]
    struct Holder {
        a: Vec<Formula>,
    }
    let holder: Holder = toml::from_str("a = [1, 0.25, \"x\", \"0.10\"]").unwrap();
    let text = toml::to_string(&holder).unwrap();
    assert_eq!(text.trim(), "a = [1.0, 0.25, \"x\", \"0.10\"]");
    assert_eq!(toml::from_str::<Holder>(&text).unwrap(), holder);
    assert!(toml::from_str::<Holder>("a = [true]").unwrap_err().to_string().contains("a number or a formula"));
}

#[test]
fn units_of_memory_are_read() {
    for (text, bytes) in [
        ("200MB", 200_000_000),
        ("1.5 GiB", 3 << 29),
        ("300mb", 300_000_000),
        (" 2KiB ", 2048),
        ("1e3B", 1000),
        ("0.5KB", 500),
    ] {
        assert_eq!(text.parse(), Ok(MemorySize(bytes)), "{text}");
    }
}

#[test]
fn what_is_no_amount_of_memory_is_refused() {
    for (text, word) in [
        ("200", "no unit"),
        ("1e9", "no unit"),
        ("200 apples", "unknown unit"),
        ("MB", "not an amount"),
        ("", "not an amount"),
        ("-1MB", "out of range"),
        ("0B", "out of range"),
        ("1e40GB", "out of range"),
        ("nanMB", "not an amount"),
        ("infGB", "not an amount"),
    ] {
        let error = text.parse::<MemorySize>().unwrap_err();
        assert!(error.contains(word) && error.contains("MiB"), "{text}: {error}");
    }
}

#[test]
fn amounts_of_memory_read_back() {
    for bytes in [1, 1000, 1024, 300_000_000, 200 << 20, 1_500_000_000, 123_456_789, 1 << 40] {
        let size = MemorySize(bytes);
        assert_eq!(size.to_string().parse(), Ok(size), "{size}");
    }
    assert_eq!(MemorySize(300_000_000).to_string(), "300MB");
}

#[test]
fn a_recorded_scene_reads_back() {
    for name in Method::names() {
        let config = Config { method: Method::named(name).unwrap(), ..Config::default() };
        assert_eq!(Config::from_record(&config.recorded().unwrap()).unwrap(), config);
    }
}

#[test]
fn ends_of_ranges_belong_or_not() {
    assert!(Range::Within(0.0, 1.0).contains(0.0) && Range::Within(0.0, 1.0).contains(1.0));
    assert!(!Range::Above(0.0, 1.0).contains(0.0) && Range::Above(0.0, 1.0).contains(1.0));
    assert!(Range::Below(0.0, 1.0).contains(0.0) && !Range::Below(0.0, 1.0).contains(1.0));
    assert!(Range::AtLeast(2.0).contains(2.0) && !Range::AtLeast(2.0).contains(1.0));
    assert!(!Range::Positive.contains(0.0) && Range::NotNegative.contains(0.0));
    for value in [f64::NAN, f64::INFINITY] {
        assert!(!Range::Finite.contains(value) && !Range::AtLeast(0.0).contains(value));
    }
}

/// Checks that every number has a range, except for the seed. A key without one would never be checked.
fn every_number_has_a_range<S: Schema>(seed: &str) {
    for complete in S::complete() {
        let numbers = complete.numbers();
        let with_range: Vec<&str> = numbers.iter().map(|(key, _, _)| *key).collect();
        let mut expected = Vec::new();
        for (path, value) in values(&complete) {
            if (value.is_integer() || value.is_float()) && path != seed {
                assert!(with_range.contains(&path.as_str()), "{path} has no range");
                expected.push(path);
            }
        }
        assert_eq!(expected.len(), with_range.len(), "a key is there twice, or is none");
    }
    S::default().check().unwrap();
}

#[test]
fn every_number_of_a_scene_has_a_range() {
    every_number_has_a_range::<Config>("run.seed");
}

#[test]
fn every_number_of_a_training_has_a_range() {
    every_number_has_a_range::<Settings>("seed");
}

#[test]
fn the_nearest_key_is_near_or_nothing() {
    let known = ["height", "length", "dx", "memory"];
    // Two swapped letters are one error.
    assert_eq!(nearest("heigth", &known), Some("height"));
    assert_eq!(nearest("xd", &["dy", "dx"]), Some("dx"));
    assert_eq!(nearest("memory_mb", &known), Some("memory"));
    assert_eq!(nearest("viscosity", &known), None);
    assert_eq!(nearest("qq", &known), None);
}
