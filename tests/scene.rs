//! Loading of scenes and the wall shape.

use hydrograd::config::builtin::{PRESETS, SCENES};
use hydrograd::config::layers::Setting;
use hydrograd::config::memory_size::MemorySize;
use hydrograd::config::scene::{
    BodyForceRegion, Config, KernelName, Method, ObjectiveKind, OptimiserName, ParametrisationName, ShapeName,
    Standard, Start,
};
use hydrograd::config::schema::{described, description, known_keys};
use hydrograd::design::shape::{default_nodes, HotSection, Shape};
use hydrograd::scene::load::Source;
use hydrograd::scene::observers::EvenSteps;
use hydrograd::scene::Scene;
use hydrograd::sph::kernels::Kernel;
use hydrograd::sph::laws::ArtificialViscosity;
use hydrograd::sph::rows::Quantity;
use hydrograd::sph::Model;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn load(sets: &[&str]) -> hydrograd::scene::load::Loaded {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    Config::load(None, None, &sets).unwrap_or_else(|error| panic!("{error}"))
}

fn read(text: &str) -> Config {
    toml::from_str(text).unwrap()
}

#[test]
fn built_in_scene_is_the_default_configuration() {
    assert_eq!(read(SCENES[0].text()), Config::default());
    let loaded = Config::load(Some("heated-channel"), None, &[]).unwrap();
    assert_eq!(loaded.config, Config::default());
    assert_eq!(loaded.text, SCENES[0].text());
    assert_eq!(loaded.source, Source::BuiltIn("heated-channel"));
}

#[test]
fn every_key_is_described_in_the_built_in_scene() {
    let keys = known_keys::<Config>();
    assert!(keys.len() > 50, "only {} keys", keys.len());
    for key in keys {
        let text = description::<Config>(&key).unwrap_or_else(|| panic!("{key} has no comment"));
        assert!(text.ends_with(['.', ')']) && text.len() > 20, "{key}: {text}");
    }
}

#[test]
fn a_search_lasts_as_long_as_the_scene() {
    for sets in [&["time.steps=500"][..], &["time.steps=300", "objective.window=0.81"], &["time.end=1.7"]] {
        let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
        let loaded = Config::load(None, None, &sets).unwrap();
        let search = loaded.for_search().unwrap().config;
        let (scene, step) = (loaded.config.duration(), search.time_step());
        assert!((search.duration() - scene).abs() <= step, "{sets:?}: {} instead of {scene}", search.duration());
        assert_ne!(step, loaded.config.time_step());
        assert_eq!(search.objective.window, loaded.config.objective.window);
    }
}

#[test]
fn report_preset() {
    let consistent = Config::load(None, Some("report"), &[]).unwrap().config;
    assert_eq!(consistent.method.name(), "consistent");
    let config = Config::load(None, Some("report-jax-sph"), &[]).unwrap().config;
    assert_eq!(config.channel.height, 0.26);
    assert_eq!(config.columns() * (config.rows() + 2 * config.channel.wall_rows), 950);
    // What does not belong to the equations is the same.
    assert_eq!((consistent.time.steps, consistent.time.cfl), (config.time.steps, config.time.cfl));
    assert_eq!((&consistent.time.start, consistent.channel.height), (&config.time.start, config.channel.height));
    assert_eq!(
        (consistent.optimise.learning_rate, consistent.optimise.epochs, consistent.optimise.smoothing),
        (config.optimise.learning_rate, config.optimise.epochs, config.optimise.smoothing)
    );
    assert_eq!((config.time.steps, config.time.cfl, config.time.start), (Some(2000), 0.25, Start::Rest));
    assert_eq!((config.objective.window, config.optimise.segment), (0.0, 0));
    assert_eq!((config.optimise.learning_rate, config.optimise.smoothing), (2e-2, 5e-2));
    assert_eq!(config.optimise.epochs, 10);
    // JAX-SPH's equations, kernel and optimiser.
    assert_eq!((config.method.name(), config.optimise.method), ("standard", OptimiserName::Adam));
    assert_eq!((config.support(), config.channel.wall_rows), (3.0, 3));
    for preset in PRESETS {
        Config::load(None, Some(preset.name), &[]).unwrap_or_else(|error| panic!("{}: {error}", preset.name));
    }
}

#[test]
fn later_layers_win_and_comments_stay() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mine.toml");
    let text = "channel.height = 0.24\n[optimise]\nepochs = 3 # few\n[fluid]\nbody_force = 1\nviscosity = 0.02\n";
    std::fs::write(&file, text).unwrap();
    let sets = ["fluid.viscosity=0.03".to_string(), "time.end=1.0".into()];
    let loaded = Config::load(file.to_str(), Some("report"), &sets).unwrap();

    let mut expected = Config::load(None, Some("report"), &[]).unwrap().config;
    expected.channel.height = 0.24;
    expected.optimise.epochs = 3;
    expected.fluid.body_force = 1.0;
    expected.fluid.viscosity = 0.03;
    // `--set time.end` replaces the preset's number of steps.
    expected.time.end = 1.0;
    expected.time.steps = None;
    assert_eq!(loaded.config, expected);
    assert_eq!(loaded.source.name(), "mine");
    assert_eq!(read(&loaded.text), loaded.config);
    let comments = |text: &str| -> Vec<String> {
        let lines = text.lines().filter(|line| line.starts_with('#'));
        lines.map(str::to_string).collect()
    };
    assert_eq!(comments(&loaded.text), comments(SCENES[0].text()));
}

#[test]
fn resolved_text_reads_back_to_the_bit() {
    // Numbers with every bit in use, tiny and huge exponents, and arrays.
    let number = 0.1 + 0.2;
    let sets = [
        format!("optimise.smoothing={}", number * 1e-17),
        "optimise.memory=1.5GiB".to_string(),
        "optimise.learning_rate=.5".to_string(),
        format!("fluid.viscosity={}", std::f64::consts::PI / 100.0),
        "design.nodes=[0.3, 0.4000000000000001, 0.6]".into(),
        "design.offsets=[1e-3,-0.010000000000000002, 0]".into(),
        "time.steps=300".into(),
        "time.cfl=2".into(),
    ];
    let loaded = Config::load(None, None, &sets).unwrap();
    assert_eq!(loaded.config.optimise.smoothing, number * 1e-17);
    assert_eq!(loaded.config.optimise.memory, MemorySize(3 << 29));
    assert_eq!(loaded.config.optimise.learning_rate, 0.5);
    assert_eq!(loaded.config.design.offsets, Some(vec![1e-3, -0.010000000000000002, 0.0]));
    assert_eq!(read(&loaded.text), loaded.config);

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("config.toml");
    std::fs::write(&file, &loaded.text).unwrap();
    let again = Config::load(file.to_str(), None, &[]).unwrap();
    assert_eq!(again.config, loaded.config);
    assert_eq!(again.text, loaded.text);
}

#[test]
fn words_need_no_quotes() {
    assert_eq!(load(&["design.shape=sine"]).config.design.shape, ShapeName::Sine);
    assert_eq!(load(&["design.shape = \"cosine\""]).config.design.shape, ShapeName::Cosine);
    assert_eq!(load(&["scene=heated-channel"]).config, Config::default());
    assert_eq!(
        load(&["fluid.body_force_region=original-channel"]).config.fluid.body_force_region,
        BodyForceRegion::OriginalChannel
    );
}

#[test]
fn a_later_shape_replaces_an_earlier_array() {
    let array = "design.offsets=[0.0, 0.01]";
    let nodes = "design.nodes=[0.3, 0.6]";
    assert!(load(&[nodes, array]).config.design.offsets.is_some());
    assert!(load(&[nodes, array, "design.shape=flat"]).config.design.offsets.is_none());
    let loaded = load(&[nodes, array]).with(&[Setting::set("design.shape=linear")]).unwrap();
    assert_eq!(loaded.config.design.offsets, None);
    assert_eq!(loaded.config.design.nodes, Some(vec![0.3, 0.6]));
    assert_eq!(read(&loaded.text), loaded.config);
}

#[test]
fn shape_file_is_copied_into_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let csv = "# best\nx,first,offset\n0.3,9,0.01\n\n0.45, 9, -0.005\n0.7,9,2e-2\n";
    std::fs::write(folder.path().join("shape.csv"), csv).unwrap();
    let file = folder.path().join("mine.toml");
    // Relative to the TOML file, not to the current folder.
    std::fs::write(&file, "[design]\nfile = \"shape.csv\"\n").unwrap();
    let loaded = Config::load(file.to_str(), None, &[]).unwrap();
    assert_eq!(loaded.config.design.file, None);
    assert_eq!(loaded.config.design.nodes, Some(vec![0.3, 0.45, 0.7]));
    assert_eq!(loaded.config.design.offsets, Some(vec![0.01, -0.005, 0.02]));
    assert_eq!(read(&loaded.text), loaded.config);
    // A file given later replaces the nodes of an earlier one.
    std::fs::write(folder.path().join("two.csv"), "x,offset\n0.5,0.01\n").unwrap();
    let two = folder.path().join("two.csv");
    let set = Setting::set(&format!("design.file={}", two.display()));
    assert_eq!(loaded.with(&[set]).unwrap().config.design.offsets, Some(vec![0.01]));
}

#[test]
fn default_nodes_are_the_reference_columns() {
    let shape = Shape::from_config(&Config::default()).unwrap();
    assert_eq!(shape.nodes.len(), 25);
    for (k, x) in shape.nodes.iter().enumerate() {
        assert!((x - (0.26 + 0.02 * k as f64)).abs() < 1e-15);
    }
    assert!(shape.offsets.iter().all(|offset| *offset == 0.0));
    assert_eq!(default_nodes(0.25, 0.75, 0.01).len(), 50);
    // A node that would lie on the end of the section is left out: 0.25 + 2.5 * 0.2 = 0.75.
    assert_eq!(default_nodes(0.25, 0.75, 0.2).len(), 2);
}

#[test]
fn named_shapes() {
    let shape = |sets: &[&str]| Shape::from_config(&load(sets).config).unwrap();
    let uniform = shape(&["design.shape=uniform", "design.amplitude=-0.015"]);
    assert!(uniform.offsets.iter().all(|offset| *offset == -0.015));
    let sine = shape(&["design.shape=sine", "design.periods=2", "design.nodes=[0.3125, 0.4375]"]);
    assert!((sine.offsets[0] - 0.01).abs() < 1e-15 && (sine.offsets[1] + 0.01).abs() < 1e-15);
    let cosine = shape(&["design.shape=cosine", "design.nodes=[0.25, 0.5, 0.75]"]);
    assert!((cosine.offsets[0] - 0.01).abs() < 1e-15 && (cosine.offsets[1] + 0.01).abs() < 1e-15);
    let linear = shape(&["design.shape=linear", "design.nodes=[0.25, 0.375, 0.75]"]);
    assert!((linear.offsets[0] + 0.01).abs() < 1e-15);
    assert!((linear.offsets[1] + 0.005).abs() < 1e-15);
    assert!((linear.offsets[2] - 0.01).abs() < 1e-15);
}

#[test]
fn random_shape_follows_the_seed() {
    let shape = |seed: &str| Shape::from_config(&load(&["design.shape=random", seed]).config).unwrap().offsets;
    let (a, b) = (shape("run.seed=1"), shape("run.seed=2"));
    assert_eq!(a, shape("run.seed=1"));
    // Pinned: figures that name a seed must stay reproducible.
    assert_eq!(a[..2], [0.007038243216883704, -0.008981732679959439]);
    assert_ne!(a, b);
    for offsets in [a, b] {
        assert!(offsets.iter().all(|offset| offset.abs() <= 0.01));
        // Uniform in +-0.01: of 25 numbers some are beyond half way on either side.
        assert!(offsets.iter().any(|offset| *offset > 0.005) && offsets.iter().any(|offset| *offset < -0.005));
    }
}

/// Shapes with nodes of several spacings that are none of the particles' spacings, regular and irregular.
fn random_shapes() -> Vec<Shape> {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut uniform = move || (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
    let mut shapes = vec![];
    for (from, to) in [(0.25, 0.75), (0.26, 0.74), (0.2137, 0.7003), (0.251, 0.2699)] {
        for count in [1, 2, 7, 25, 93] {
            let width = (to - from) / count as f64;
            let nodes: Vec<f64> = (0..count).map(|k| from + (k as f64 + 0.05 + 0.9 * uniform()) * width).collect();
            let mut offsets = vec![0.02 * (uniform() - 0.5)];
            for pair in nodes.windows(2) {
                let step = 2.0 * (pair[1] - pair[0]) * (2.0 * uniform() - 1.0);
                offsets.push(offsets.last().unwrap() + step);
            }
            shapes.push(Shape::new(nodes, offsets, from, to).unwrap());
        }
        // Nodes at the very ends.
        shapes.push(Shape::new(vec![from, to], vec![0.01, 0.012], from, to).unwrap());
    }
    shapes
}

fn hot_share(shape: &Shape, dx: f64) -> Vec<f64> {
    HotSection { from: shape.hot_from, to: shape.hot_to, dx, length: 1.0 }.share()
}

const SPACINGS: [f64; 5] = [0.02, 0.01, 0.005, 0.03333, 1.0 / 30.0];

fn averages(shape: &Shape, dx: f64) -> Vec<f64> {
    let average = |row: &Vec<(usize, f64)>| row.iter().map(|(node, weight)| weight * shape.offsets[*node]).sum();
    shape.column_weights(dx, 1.0).iter().map(average).collect()
}

#[test]
fn weights_sum_to_the_hot_share() {
    for shape in random_shapes() {
        for dx in SPACINGS {
            let (weights, share) = (shape.column_weights(dx, 1.0), hot_share(&shape, dx));
            assert_eq!(weights.len(), (1.0 / dx).round() as usize);
            assert_eq!(share.len(), weights.len());
            for (row, share) in weights.iter().zip(&share) {
                let sum: f64 = row.iter().map(|(_, weight)| weight).sum();
                assert!((sum - share).abs() < 1e-15);
                assert!(row.iter().all(|(node, weight)| *weight > 0.0 && *node < shape.nodes.len()));
                assert!(row.windows(2).all(|pair| pair[0].0 + 1 == pair[1].0), "{row:?}");
            }
            let hot: f64 = share.iter().map(|share| share * dx).sum();
            assert!((hot - (shape.hot_to - shape.hot_from)).abs() < 1e-14);
        }
    }
}

#[test]
fn hot_share_counts_cut_columns() {
    let shape = Shape::from_config(&Config::default()).unwrap();
    // The columns 0.24 ... 0.26 and 0.74 ... 0.76 are half hot.
    let share = hot_share(&shape, 0.02);
    assert!((share[12] - 0.5).abs() < 1e-12 && (share[37] - 0.5).abs() < 1e-12);
    assert_eq!((share[11], share[13], share[36], share[38]), (0.0, 1.0, 1.0, 0.0));
    // At 0.01 and 0.005 its ends are on column edges: no slivers.
    for dx in [0.01, 0.005] {
        let share = hot_share(&shape, dx);
        assert!(share.iter().all(|share| *share == 0.0 || *share == 1.0));
        assert_eq!(share.iter().sum::<f64>() * dx, 0.5);
    }
    // 3 * 0.1 is a little more than 0.3.
    let shape = Shape::new(vec![0.5], vec![0.01], 0.3, 0.7).unwrap();
    assert_eq!(hot_share(&shape, 0.1), [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
}

#[test]
fn uniform_shape_is_uniform() {
    let mut shape = Shape::from_config(&Config::default()).unwrap();
    shape.offsets.fill(0.013);
    for dx in SPACINGS {
        for (average, share) in averages(&shape, dx).iter().zip(hot_share(&shape, dx)) {
            assert!((average - 0.013 * share).abs() < 1e-16);
        }
    }
}

#[test]
fn area_is_exact_at_every_spacing() {
    for shape in random_shapes() {
        let (x, o) = (&shape.nodes, &shape.offsets);
        let last = x.len() - 1;
        let mut exact = o[0] * (x[0] - shape.hot_from) + o[last] * (shape.hot_to - x[last]);
        for i in 0..last {
            exact += 0.5 * (o[i] + o[i + 1]) * (x[i + 1] - x[i]);
        }
        for dx in SPACINGS {
            let area: f64 = averages(&shape, dx).iter().map(|average| average * dx).sum();
            assert!((area - exact).abs() < 1e-15, "dx {dx}: {area} instead of {exact}");
        }
    }
}

/// Each column's average against the midpoint rule on y(x): the right area in the right place.
#[test]
fn column_averages_follow_the_height() {
    let points = 4000;
    for shape in random_shapes() {
        for dx in SPACINGS {
            for (column, average) in averages(&shape, dx).iter().enumerate() {
                let at = |k: usize| shape.height((column as f64 + (k as f64 + 0.5) / points as f64) * dx);
                let sampled = (0..points).map(at).sum::<f64>() / points as f64;
                // Each jump at an end of the section costs at most half a point.
                let largest = shape.offsets.iter().fold(0.0_f64, |most, o| most.max(o.abs()));
                assert!((average - sampled).abs() < 1.1 * largest / points as f64 + 1e-9);
            }
        }
    }
}

#[test]
fn height_at_nodes_between_and_outside() {
    let shape = Shape::new(vec![0.3, 0.5, 0.6], vec![0.01, -0.01, 0.02], 0.25, 0.75).unwrap();
    let expected = [
        (0.0, 0.0),
        (0.25, 0.0),
        (0.2501, 0.01),
        (0.3, 0.01),
        (0.4, 0.0),
        (0.5, -0.01),
        (0.55, 0.005),
        (0.6, 0.02),
        (0.7499, 0.02),
        (0.75, 0.0),
        (0.9, 0.0),
    ];
    for (x, y) in expected {
        assert!((shape.height(x) - y).abs() < 1e-15, "y({x}) = {}", shape.height(x));
    }
}

#[test]
fn defaults_give_way_to_what_is_given() {
    let load = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        Config::load(None, None, &sets).unwrap()
    };
    let short = load(&["time.end=0.04"]);
    assert_eq!(short.config.objective.window, 0.01);
    assert_eq!(short.config.objective.samples, 4, "dt = 0.04 / 15");
    assert_eq!(toml::from_str::<Config>(&short.text).unwrap(), short.config);
    // The wall has no steps that dummy particles would have to fill.
    assert_eq!(load(&["resolution.dx=0.005"]).config.channel.wall_rows, 2);
    assert_eq!(load(&["design.bound=0.04"]).config.channel.wall_rows, 2);
    // The dummy particles fill the kernel's support, of a particle half a spacing away.
    let wide = load(&["resolution.smoothing_length=1.5"]);
    assert_eq!((wide.config.support(), wide.config.channel.wall_rows), (4.5, 4));
    assert_eq!(wide.place("channel.wall_rows"), Some("the kernel's support"));
    assert_eq!(load(&["resolution.smoothing_length=1.5", "channel.wall_rows=7"]).config.channel.wall_rows, 7);
    assert_eq!(load(&["resolution.kernel=wendland-c2"]).config.channel.wall_rows, 2);
}

#[test]
fn the_standard_method_has_defaults_of_its_own() {
    let standard = |sets: &[&str]| load(&[&["method.name=standard"], sets].concat());
    let loaded = standard(&[]);
    let mut expected = Config { method: Method::named("standard").unwrap(), ..Config::default() };
    expected.resolution.smoothing_length = 1.0;
    expected.channel.wall_rows = 3;
    expected.time.cfl = 2.0;
    expected.optimise.smoothing = 5.0;
    assert_eq!(loaded.config, expected);
    assert_eq!(read(&loaded.text), expected);
    assert_eq!(loaded.place("time.cfl"), Some("method.name = standard"));
    // What is given stays.
    let given = standard(&["time.cfl=1", "resolution.smoothing_length=1.1", "optimise.smoothing=0.1"]).config;
    assert_eq!((given.time.cfl, given.resolution.smoothing_length, given.optimise.smoothing), (1.0, 1.1, 0.1));
    assert_eq!(given.channel.wall_rows, 4);

    let short = standard(&["time.end=0.04"]);
    assert_eq!(short.config.objective.window, 0.01);
    assert_eq!(short.config.objective.samples, 3, "dt = 0.04 / 12");
    assert_eq!(standard(&["resolution.dx=0.005"]).config.channel.wall_rows, 4);
    assert_eq!(standard(&["design.bound=0.04"]).config.channel.wall_rows, 3);
    // The dummy particles fill the kernel's support.
    let wide = standard(&["resolution.smoothing_length=1.5"]);
    assert_eq!((wide.config.support(), wide.config.channel.wall_rows), (4.5, 5));
    assert_eq!(wide.place("channel.wall_rows"), Some("the kernel's support"));
    assert_eq!(standard(&["resolution.smoothing_length=1.5", "channel.wall_rows=7"]).config.channel.wall_rows, 7);
    assert_eq!(standard(&["resolution.kernel=wendland-c2"]).config.channel.wall_rows, 2);
}

#[test]
fn kernels_laws_and_designs_have_names() {
    let sets = [
        "method.name=standard",
        "resolution.kernel=wendland-c2",
        "method.artificial_viscosity=0.1",
        "optimise.method=adam",
        "objective.kind=outlet-temperature",
        "design.parametrisation=b-spline",
        "design.control_points=6",
    ];
    let loaded = load(&sets);
    let mut expected = Config::default();
    expected.resolution.kernel = KernelName::WendlandC2;
    expected.method = Method::Standard(Standard { artificial_viscosity: 0.1, ..Standard::default() });
    expected.optimise.method = OptimiserName::Adam;
    // The standard method's own.
    (expected.resolution.smoothing_length, expected.time.cfl, expected.optimise.smoothing) = (1.0, 2.0, 5.0);
    expected.objective.kind = ObjectiveKind::OutletTemperature;
    expected.design.parametrisation = ParametrisationName::BSpline;
    expected.design.control_points = 6;
    assert_eq!(loaded.config, expected);
    assert_eq!(read(&loaded.text), expected);
    assert_eq!((expected.support(), expected.smoothing_length()), (2.0, 0.02));
}

#[test]
fn every_family_has_its_built_in_scene() {
    for built_in in SCENES {
        let loaded = Config::load(Some(built_in.name), None, &[]).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(loaded.text, built_in.text());
        assert_eq!(loaded.config.scene.built_in().name, built_in.name);
        let keys = described::<Config>(built_in.text());
        for (key, comment) in &keys {
            assert!(comment.ends_with(['.', ')']) && comment.len() > 20, "{}: {key}: {comment}", built_in.name);
        }
        // Every line that sets something is one of them.
        let lines = built_in.text().lines().filter(|line| !line.starts_with('#') && line.contains('='));
        assert!(lines.count() <= keys.len() && keys.len() > 15);
    }
}

/// Keys of before there was a section `[method]`, in settings, short files and complete ones.
#[test]
fn keys_of_before_are_read() {
    let sets = |sets: &[&str]| -> Vec<String> { sets.iter().map(|set| set.to_string()).collect() };
    let load = |scene: &str, text: &[&str]| Config::load(Some(scene), None, &sets(text)).unwrap().config;
    let same: [(&str, &[&str], &[&str]); 9] = [
        ("heated-channel", &["fluid.formulation=consistent", "fluid.motion=moving"], &[]),
        ("heated-channel", &["fluid.formulation=standard"], &["method.name=standard"]),
        ("heated-channel", &["fluid.motion=fixed"], &["method.name=fixed"]),
        ("heated-channel", &["fluid.motion=fixed", "fluid.formulation=consistent"], &["method.name=fixed"]),
        ("heated-channel", &["method.name=fixed", "fluid.motion=moving"], &[]),
        // They had no effect.
        ("heated-channel", &["fluid.formulation=standard", "fluid.shift=isotropic"], &["method.name=standard"]),
        (
            "taylor-green",
            &["fluid.flux=riemann", "fluid.transport_velocity=0", "fluid.formulation=standard"],
            &["method.name=standard", "method.flux=riemann", "method.transport_velocity=0"],
        ),
        ("taylor-green", &["time.integrator=symplectic-euler"], &["method.integrator=symplectic-euler"]),
        ("dam-break", &["fluid.artificial_viscosity=0.05"], &["method.artificial_viscosity=0.05"]),
    ];
    for (scene, before, today) in same {
        assert_eq!(load(scene, before), load(scene, today), "{scene} {before:?}");
    }

    let fluid = |choice: &str| {
        format!(
            "scene = \"taylor-green\"\n[fluid]\nsound_speed_factor = 12.0\nbackground_pressure_factor = 0.02\n\
             transport_velocity = 0.5\nartificial_viscosity = 0.0\nartificial_viscosity_pairs = \"approaching\"\n\
             density_equation = \"summation\"\ndensity_renormalisation = false\nflux = \"pair\"\ndensity_diffusion = 0.1\n\
             density_gradient = \"renormalised\"\nvelocity_diffusion = 0.01\nriemann_limiter = 3.0\n\
             equation_of_state_exponent = 1.0\n{choice}\nshift = \"isotropic\"\nshift_strength = 1.5\n\
             pressure_diffusion = 0.2\n[resolution]\nsmoothing_length = 0.9\n[time]\nintegrator = \"verlet\"\n"
        )
    };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("config.toml");
    let own = ["method.shift_strength=1.5", "method.pressure_diffusion=0.2"];
    let standard = ["method.name=standard", "method.background_pressure_factor=0.02", "method.transport_velocity=0.5"];
    let common = ["fluid.sound_speed_factor=12", "resolution.smoothing_length=0.9"];
    for (choice, today) in [
        ("formulation = \"consistent\"\nmotion = \"moving\"", &own[..]),
        ("formulation = \"standard\"\nmotion = \"moving\"", &standard[..]),
    ] {
        let text = fluid(choice);
        std::fs::write(&file, &text).unwrap();
        let expected = load("taylor-green", &[&common[..], today].concat());
        assert_eq!(load(file.to_str().unwrap(), &[]), expected, "{choice}");
        // What a run, a data set and a model record has every key.
        let recorded = Config::from_record(&text).unwrap();
        assert_eq!(recorded.method, expected.method);
        assert_eq!(recorded.fluid.sound_speed_factor, 12.0);
    }
    // The other method on top of a complete file has what the file has for it.
    let other = load(file.to_str().unwrap(), &["method.name=consistent"]);
    assert_eq!(other.method, load("taylor-green", &own).method);
    // Older still: no choice of equations.
    let oldest = Config::from_record("[fluid]\nbackground_pressure_factor = 0.02\n").unwrap();
    let method = Method::Standard(Standard { background_pressure_factor: 0.02, ..Standard::default() });
    assert_eq!((oldest.method, oldest.resolution.smoothing_length), (method, 1.0));
    assert_eq!(oldest.optimise.method, OptimiserName::Adam);
}

/// The text of a scene has its method's keys, those of the others in comments, and becomes another method's when that is chosen.
#[test]
fn texts_have_the_keys_of_every_method() {
    let own = Config::load(Some("taylor-green"), None, &[]).unwrap().text;
    let sets = ["method.name=standard".to_string(), "method.flux=delta".into()];
    let other = Config::load(Some("taylor-green"), None, &sets).unwrap().text;
    for (text, live, commented) in [
        (own, "\nname = \"consistent\"\n", "\n# name = \"standard\"\n"),
        (other.clone(), "\nname = \"standard\"\n", "\n# name = \"consistent\"\n"),
    ] {
        assert!(text.contains(live) && text.contains(commented), "{text}");
    }
    assert!(other.contains("\nflux = \"delta\"\n") && other.contains("\n# shift = \"isotropic\"\n"), "{other}");
    let (method, time) = (other.find("\n[method]\n"), other.find("\n[time]\n"));
    assert!(method < time && method > other.find("\n[fluid]\n"), "{other}");
}

#[test]
fn flows_follow_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mine.toml");
    std::fs::write(&file, "scene = \"taylor-green-3d\"\n[flow]\nreynolds = 20\n[time]\nend = 0.5\n").unwrap();
    let dx = std::f64::consts::TAU / 12.0;
    let sets = [format!("resolution.dx={dx}"), "time.cfl=0.25".into()];
    let loaded = Config::load(file.to_str(), None, &sets).unwrap();
    assert_eq!(read(&loaded.text), loaded.config);
    let flow = Scene::<f64>::from_config(&loaded.config).unwrap();
    assert_eq!((flow.model.particles(), flow.model.dimension()), (1728, 3));
    assert_eq!(flow.model.rows.row(Quantity::TransportAcceleration), None);
    assert_eq!(flow.model.viscosity, 0.05);
    assert_eq!((flow.model.dt, loaded.config.steps()), (0.5 / 43.0, 43), "0.25 dx / 11 = 0.0119");
    let poiseuille = Config::load(Some("poiseuille"), None, &["time.steps=7".into()]).unwrap().config;
    let flow = Scene::<f32>::from_config(&poiseuille).unwrap();
    // 40 rows, three in each wall, and points on the walls' surfaces.
    assert_eq!(flow.model.particles(), 12 * 46 + 24);
    assert!((flow.model.dt - 0.25 * 0.025 * 0.025 * 0.0125).abs() < 1e-18);
    assert!(flow.design.is_none() && Scene::<f64>::from_config(&Config::default()).unwrap().design.is_some());
}

fn scene_of(name: &str, sets: &[&str]) -> Scene<f64> {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    let loaded = Config::load(Some(name), None, &sets).unwrap_or_else(|error| panic!("{name}: {error}"));
    Scene::from_config(&loaded.config).unwrap()
}

/// The method for this test, because other methods have no artificial viscosity.
const STANDARD: &str = "method.name=standard";

fn artificial_viscosity(model: &Model<f64>) -> Option<ArtificialViscosity> {
    model.of_type::<hydrograd::sph::standard::Standard<f64>>().unwrap().laws.further.0
}

#[test]
fn configured_kernels_and_laws_reach_every_scene() {
    // The slab is at rest, without artificial viscosity, and one scene does not support the standard method.
    for built_in in SCENES.iter().filter(|built_in| !["slab", "heated-channel-3d"].contains(&built_in.name)) {
        let usual = scene_of(built_in.name, &[STANDARD]);
        assert_eq!(usual.name, built_in.name);
        assert_eq!(artificial_viscosity(&usual.model).is_some(), built_in.name.starts_with("dam-break"));
        assert_eq!(usual.model.kernel.smoothing_length, usual.spacing);
        let sets = ["resolution.kernel=\"wendland-c2\"", "resolution.smoothing_length=1.5"];
        let other = scene_of(built_in.name, &[STANDARD, sets[0], sets[1], "method.artificial_viscosity=0.1"]);
        let kernel = Kernel::new(KernelName::WendlandC2, other.model.dimension(), 1.5 * other.spacing);
        assert_eq!(other.model.kernel, kernel);
        let artificial = artificial_viscosity(&other.model).unwrap();
        assert_eq!((artificial.alpha, artificial.smoothing_length), (0.1, 1.5 * other.spacing));
        assert!((artificial.sound_speed - other.sound_speed()).abs() < 1e-12 * artificial.sound_speed);
        assert_eq!(other.model.tags, usual.model.tags);
    }
}

#[test]
fn walls_are_as_thick_as_the_kernel_needs() {
    let wide = ["resolution.smoothing_length=1.3"];
    let particles = |name: &str| scene_of(name, &wide).model.particles();
    assert_eq!((particles("poiseuille"), particles("lid-driven-cavity")), (12 * (40 + 8) + 2 * 12, 58 * 58 + 4 * 50));
    assert_eq!(scene_of("heated-channel", &[STANDARD, wide[0]]).model.particles(), 50 * (10 + 8));
    // A particle half a spacing from the wall has four rows in reach; 250 points are on the walls' surfaces.
    assert_eq!(particles("heated-channel"), 50 * (10 + 8) + 250);
    assert_eq!(scene_of("poiseuille", &wide).corner, [0.0, -0.1, 0.0]);
}

#[test]
fn observed_steps_are_even_and_end_with_the_last() {
    let of = |steps: usize, count: usize| {
        let even = EvenSteps::new(steps, count);
        (0..=steps).filter(|&step| even.contains(step)).collect::<Vec<usize>>()
    };
    assert_eq!(of(10, 4), [0, 3, 6, 9, 10]);
    assert_eq!(of(3, 100), [0, 1, 2, 3]);
    assert_eq!(of(5, 0), [0; 0]);
}
