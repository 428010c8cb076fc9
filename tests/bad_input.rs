//! Bad input: one clear message, exit code 2, nothing written.

use std::path::Path;

use crate::support::advice;
use crate::support::program::refused;
use assert_cmd::Command;
use tempfile::TempDir;

const STANDARD: &str = "method.name=standard";

/// A folder with files, and the command line run in it.
struct Case {
    folder: TempDir,
}

impl Case {
    fn new(files: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        Self { folder }
    }

    /// Runs `hydrograd`, expects exit code 2, exactly one error that has every part of `expected`, nothing on
    /// stdout, and no new file; returns the message.
    fn refuses(&self, arguments: &[&str], expected: &[&str]) -> String {
        let before = files(self.folder.path());
        let output =
            Command::cargo_bin("hydrograd").unwrap().current_dir(self.folder.path()).args(arguments).output().unwrap();
        let message = refused(arguments, &output, expected);
        assert!(output.stdout.is_empty());
        assert!(message.starts_with("error: "), "{message}");
        assert_eq!(files(self.folder.path()), before, "something was written");
        advice::are_followed(self.folder.path(), arguments, &message);
        message
    }

    /// The same for every run command with `--set` options.
    fn refuses_sets(&self, sets: &[&str], expected: &[&str]) {
        let mut arguments = vec!["simulate", "--out", "out"];
        sets.iter().for_each(|set| arguments.extend(["--set", set]));
        for command in ["simulate", "optimize", "check-gradient"] {
            arguments[0] = command;
            self.refuses(&arguments, expected);
        }
    }
}

fn files(folder: &Path) -> Vec<String> {
    let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
    let mut names: Vec<String> = names.map(|name| name.to_string_lossy().into()).collect();
    names.sort();
    names
}

fn refuses_sets(sets: &[&str], expected: &[&str]) {
    Case::new(&[]).refuses_sets(sets, expected);
}

fn refuses_file(text: &str, expected: &[&str]) {
    let case = Case::new(&[("mine.toml", text)]);
    case.refuses(&["optimize", "mine.toml", "--out", "out"], expected);
}

#[test]
fn memory_needs_a_unit_and_must_suffice() {
    let case = Case::new(&[("mine.toml", "[optimise]\nmemory = 300\n")]);
    let form = ["optimise.memory", "MiB", "200MB"];
    case.refuses(&["optimize", "--memory", "200"], &[&["--memory 200", "no unit"], &form[..]].concat());
    case.refuses(&["optimize", "--memory", "200 apples"], &[&["apples"], &form[..]].concat());
    case.refuses(&["check-gradient", "--memory", "-1MB"], &[&["out of range"], &form[..]].concat());
    case.refuses(&["bench", "--memory", "lots"], &["--memory", "not an amount", "MiB", "200MB"]);
    case.refuses(&["optimize", "mine.toml"], &[&["mine.toml", "line 2", "no unit"], &form[..]].concat());
    // What was memory_mb is found again.
    case.refuses(&["optimize", "--set", "optimise.memory_mb=3"], &["unknown field `memory_mb`", "`memory`"]);
    // Too small for any schedule: the least that works, which then does work.
    let moving = ["optimize", "--set", "optimise.search=scene"];
    for arguments in [&moving[..], &[&moving[..], &["--explain"]].concat()] {
        let message =
            case.refuses(&[arguments, &["--memory", "1KB"]].concat(), &["1KB", "too small", "at least", "MB"]);
        let least = message.split("at least ").nth(1).unwrap().split(' ').next().unwrap();
        let output =
            Command::cargo_bin("hydrograd").unwrap().args(moving).args(["--explain", "--memory", least]).output();
        let text = String::from_utf8(output.unwrap().stdout).unwrap();
        assert!(text.contains("binomial"), "{least}: {text}");
    }
    // A given length that does not fit.
    case.refuses(
        &["optimize", "--segment", "500", "--memory", "5MB"],
        &["500", "optimise.memory = 5MB", "--segment 0"],
    );
    // Rounded states.
    case.refuses(&["optimize", "--store", "f32", "--segment", "20"], &["--store f32", "every state is kept"]);
    case.refuses(&["optimize", "--store", "f32", "--memory", "10MB"], &["rounded to f32", "optimise.memory = 10MB"]);
}

#[test]
fn unknown_key() {
    let parts = ["mine.toml", "line 2", "heigth", "length", "wall_rows", "try: `height`"];
    refuses_file("[channel]\nheigth = 0.2\n", &parts);
    let parts = ["--set channel.heigth=0.2", "heigth", "wall_rows", "try: `height`"];
    refuses_sets(&["channel.heigth=0.2"], &parts);
}

#[test]
fn files_without_a_key() {
    for text in ["", "# nothing\n\n", "[channel]\n"] {
        refuses_file(text, &["mine.toml is a file without a key", "try: hydrograd scenes heated-channel"]);
    }
}

/// A key that nobody gave is not to blame.
#[test]
fn an_error_says_who_gave_the_value() {
    let given = "default of scene heated-channel with --set channel.height=0.6: the plane channel";
    Case::new(&[]).refuses(&["simulate", "--set", "channel.height=0.6"], &[given]);
    refuses_sets(&["fluid.reference_velocity=0.2"], &["error: --set fluid.reference_velocity=0.2: the plane channel"]);
    let custom = "scene = \"custom\"\n";
    refuses_file(&format!("{custom}qqqqq = 1\n"), &["`hydrograd scenes custom` prints every key"]);
    refuses_file(&format!("{custom}[initial]\nvelocity == 3\n"), &["`hydrograd scenes custom`"]);
}

#[test]
fn elements_of_what_is_given() {
    let text = "scene = \"custom\"\n[[shapes]]\nkind = \"disc\"\ncentre = [0.3, 0.2]\nradius = 0.1\n";
    let case = Case::new(&[("mine.toml", text)]);
    let refuses = |set: &str, parts: &[&str]| {
        case.refuses(
            &["simulate", "mine.toml", "--out", "out", "--set", set],
            &[&[&*format!("--set {set}")], parts].concat(),
        );
    };
    refuses("shapes[1].radius=0.1", &["there is no shapes[1]: shapes has 1 entries", "such as shapes[0].radius"]);
    refuses("shapes[0].raduis=0.1", &["unknown field `raduis`", "try: `radius`"]);
    refuses("shapes[0].radius=-1", &["shapes[0].radius: -1", "a length above 0"]);
    refuses("shapes[0].centre[2]=1", &["there is no shapes[0].centre[2]", "2 entries"]);
    refuses("shapes[0].radius[1]=1", &["shapes[0].radius is 0.1, without such a part"]);
    refuses("shapes[x].radius=1", &["`shapes[x].radius`: shapes is [", "without such a part"]);
    refuses("shaeps[0].radius=1", &["unknown field `shaeps`", "try: `shapes`"]);
    refuses("region.sides.top.knid=wall", &["unknown field `knid`", "try: `kind`"]);
    refuses("region.sides.top.kind=lid", &["unknown variant `lid`", "allowed: wall"]);
    refuses("region.size[1]=0.51", &["does not divide region.size[1] = 0.51", "--set region.size[1]=0.5"]);
}

#[cfg(unix)]
#[test]
fn a_folder_whose_name_is_no_text() {
    use std::os::unix::ffi::OsStrExt;
    let case = Case::new(&[]);
    let name = std::ffi::OsStr::from_bytes(b"out\xff");
    let commands: [(&str, &[&str]); 5] = [
        ("simulate", &[]),
        ("optimize", &[]),
        ("check-gradient", &[]),
        ("compare", &["a", "b"]),
        ("slurm", &["validate", "--quick"]),
    ];
    for (command, more) in commands {
        let mut line = Command::cargo_bin("hydrograd").unwrap();
        line.current_dir(case.folder.path()).args([command, "--out"]).arg(name).args(more);
        let output = line.output().unwrap();
        refused(&[command, "--out"], &output, &["--out out", "not text (UTF-8)", "allowed: a name of UTF-8 text"]);
        assert!(files(case.folder.path()).is_empty());
    }
}

#[test]
fn unknown_section() {
    let parts = ["mine.toml", "line 1", "optimize", "try: `optimise`"];
    refuses_file("[optimize]\nepochs = 2\n", &parts);
    refuses_sets(&["optimize.epochs=2"], &["--set optimize.epochs=2", "try: `optimise`"]);
}

#[test]
fn key_of_another_section() {
    refuses_file("[time]\nepochs = 2\n", &["line 2", "epochs", "try: `optimise.epochs`"]);
    refuses_sets(&["dx=0.01"], &["--set dx=0.01", "try: `resolution.dx`"]);
}

#[test]
fn unknown_value() {
    let parts = ["design.shape=sin", "`sine`", "cosine", "random", "try: `sine`"];
    refuses_sets(&["design.shape=sin"], &parts);
    refuses_file("[run]\nprecision = \"f16\"\n", &["line 2", "f16", "f32, f64"]);
}

#[test]
fn wrong_type() {
    let parts = ["mine.toml", "line 3", "epochs = \"ten\"", "a whole number", "optimise.epochs"];
    refuses_file("[optimise]\nsmoothing = 1\nepochs = \"ten\"\n", &parts);
    let parts = ["--set time.end=soon", "soon", "a number", "time.end", "> 0"];
    refuses_sets(&["time.end=soon"], &parts);
    refuses_sets(&["design.offsets=0.01"], &["--set design.offsets=0.01", "an array of numbers"]);
    refuses_sets(&["optimise.epochs=2.5"], &["2.5", "a whole number"]);
}

#[test]
fn section_that_is_a_value() {
    refuses_sets(&["channel=3"], &["--set channel=3", "section"]);
    refuses_file("resolution = [0.01]\n", &["mine.toml, line 1", "`resolution`", "section"]);
}

#[test]
fn not_toml() {
    refuses_file("[channel\nheight = 0.2\n", &["mine.toml", "line 1", "^"]);
    refuses_file("[channel]\nheight = 0.2\nheight = 0.3\n", &["mine.toml", "line 3", "duplicate key"]);
}

#[test]
fn out_of_range() {
    let parts =
        ["mine.toml, line 3", "time.cfl = 4.5", "0 < time.cfl <= 4", "--set time.cfl=1.5 (the built-in scene's)"];
    refuses_file("[time]\n\ncfl = 4.5\n", &parts);
    let cases = [
        ("resolution.dx=0", "resolution.dx > 0"),
        ("resolution.dx=-0.02", "resolution.dx > 0"),
        ("resolution.dx=nan", "resolution.dx > 0"),
        ("channel.wall_rows=1", "2 <= channel.wall_rows"),
        ("channel.inlet_length=-0.1", "channel.inlet_length >= 0"),
        ("fluid.viscosity=inf", "fluid.viscosity > 0, finite"),
        ("wall.hot_temperature=nan", "wall.hot_temperature: any finite number"),
        ("time.end=0", "time.end > 0"),
        ("time.end=-1", "time.end > 0"),
        ("time.diffusion_number=1.5", "0 < time.diffusion_number <= 1"),
        ("time.skin=0", "0 < time.skin <= 2"),
        ("objective.samples=0", "1 <= objective.samples"),
        ("optimise.epochs=0", "1 <= optimise.epochs"),
        ("optimise.learning_rate=0", "optimise.learning_rate > 0"),
        ("design.bound=-0.01", "design.bound >= 0"),
        ("run.threads=5000", "0 <= run.threads <= 1024"),
        ("resolution.smoothing_length=0.4", "0.5 <= resolution.smoothing_length <= 3"),
        ("method.shift_strength=-1", "0 <= method.shift_strength <= 10"),
        ("design.control_points=3", "4 <= design.control_points <= 1000"),
    ];
    for (set, allowed) in cases {
        let (key, value) = set.split_once('=').unwrap();
        let value = value.replace("nan", "NaN");
        refuses_sets(&[set], &[&format!("--set {set}"), &format!("{key} = {value}"), allowed]);
    }
}

#[test]
fn zero_or_negative_steps() {
    let case = Case::new(&[]);
    for command in ["simulate", "optimize"] {
        let run = |set: &str, parts: &[&str]| case.refuses(&[command, "--out", "out", "--set", set], parts);
        run("time.steps=0", &["--set time.steps=0", "time.steps = 0", "1 <= time.steps"]);
        run("time.steps=-5", &["--set time.steps=-5", "-5", "time.steps", ">= 1"]);
    }
    let parts = ["--steps 0", "time.steps = 0", "1 <= time.steps"];
    case.refuses(&["check-gradient", "--steps", "0", "--out", "out"], &parts);
    case.refuses(&["check-gradient", "--directions", "0"], &["--directions", "at least 1"]);
    case.refuses(&["optimize", "--epochs", "0"], &["--epochs 0", "1 <= optimise.epochs"]);
}

#[test]
fn spacing_does_not_divide() {
    let parts = [
        "--set resolution.dx=0.03",
        "resolution.dx = 0.03",
        "channel.length = 1",
        "try: --set resolution.dx=0.028571429 or --set resolution.dx=0.033333333\n",
    ];
    refuses_sets(&["resolution.dx=0.03"], &parts);
    let parts =
        ["error: --set channel.height=0.21: resolution.dx = 0.02", "channel.height = 0.21", "resolution.dx=0.01"];
    refuses_sets(&["channel.height=0.21"], &parts);
    refuses_sets(&["resolution.dx=1e-7"], &["resolution.dx = 0.0000001", "particles"]);
}

#[test]
fn channel_too_short_or_low() {
    let sets = [
        "channel.length=0.12",
        "channel.inlet_length=0",
        "channel.outlet_length=0",
        "channel.hot_from=0.02",
        "channel.hot_to=0.08",
        "objective.target_x=0.1",
        STANDARD,
    ];
    refuses_sets(&sets, &["channel.length = 0.12", "at least", "0.128"]);
    refuses_sets(&[STANDARD, "channel.height=0.1"], &["channel.height = 0.1", "six spacings", "0.12"]);
}

/// What follows from the kernel's support follows from its name and smoothing length.
#[test]
fn support_of_the_kernel() {
    let wide = "resolution.smoothing_length=1.5";
    refuses_sets(&[wide, "channel.wall_rows=3"], &["channel.wall_rows = 3", "4 <= channel.wall_rows"]);
    let standard = [STANDARD, wide, "channel.wall_rows=4"];
    refuses_sets(&standard, &["channel.wall_rows = 4", "5 <= channel.wall_rows"]);
    refuses_sets(&[wide, "channel.height=0.16"], &["channel.height = 0.16", "9 spacings", "0.18"]);
    refuses_sets(
        &["resolution.kernel=wendland"],
        &["wendland", "wendland-c2", "wendland-c6", "super-gaussian", "try: `wendland-c2`"],
    );
    let negative = "resolution.kernel=super-gaussian";
    refuses_sets(&[negative], &["super-gaussian", "positive weights", "try: --set resolution.kernel=gaussian"]);
    refuses_sets(&[STANDARD, negative, "channel.wall_rows=3"], &["super-gaussian", "with walls", "without walls"]);
    let case = Case::new(&[]);
    let run = ["simulate", "taylor-green", "--set", "resolution.dx=0.125", "--set", wide];
    case.refuses(&run, &["too coarse", "2 (4.5 + time.skin) spacings"]);
    let run = ["simulate", "poiseuille", "--set", "resolution.dx=0.125", "--set", wide];
    case.refuses(&run, &["too coarse", "9 spacings"]);
}

#[test]
fn sections_out_of_place() {
    refuses_sets(&["channel.hot_from=0.05"], &["channel.hot_from = 0.05", "channel.inlet_length", "0.06"]);
    refuses_sets(&["channel.hot_to=0.95"], &["channel.hot_to = 0.95", "channel.outlet_length", "0.94"]);
    refuses_sets(&["channel.hot_to=0.2"], &["channel.hot_from = 0.25", "channel.hot_to - dx"]);
    refuses_sets(&["objective.target_x=0.7"], &["objective.target_x = 0.7", "0.75 ... 0.94"]);
    refuses_sets(&["objective.target_x=0.95"], &["objective.target_x = 0.95", "0.75 ... 0.94"]);
}

#[test]
fn window_longer_than_the_run() {
    let case = Case::new(&[]);
    let run = |sets: &[&str], parts: &[&str]| {
        let mut arguments = vec!["optimize", "--out", "out"];
        sets.iter().for_each(|set| arguments.extend(["--set", set]));
        case.refuses(&arguments, parts);
    };
    let window = "objective.window=0.45";
    run(&["time.end=0.3", window], &["objective.window = 0.45", "0 (last step) ... 0.3"]);
    run(&["time.steps=100", window], &["objective.window = 0.45", "0.272727"]);
    run(&[STANDARD, "time.steps=100", window], &["objective.window = 0.45", "0.363636"]);
    run(&["objective.samples=300"], &["objective.samples = 300", "1 ... 184"]);
}

#[test]
fn no_time_step() {
    let sets = ["fluid.conductivity=1e300", "fluid.density=1e-300"];
    refuses_sets(&sets, &["time step of 0", "positive"]);
}

#[test]
fn bound_too_large() {
    refuses_sets(&[STANDARD, "design.bound=0.09", "channel.wall_rows=4"], &["design.bound = 0.09", "0 ... 0.08"]);
    refuses_sets(&[STANDARD, "design.bound=0.09"], &["design.bound = 0.09", "0 ... 0.08", "six spacings"]);
    let parts = ["design.bound = 0.11", "0 ... 0.1", "half the channel's height"];
    refuses_sets(&["design.bound=0.11", "channel.wall_rows=20", "resolution.dx=0.01"], &parts);
}

#[test]
fn offsets_of_the_wrong_length() {
    let parts = ["--set design.offsets=[0.0, 0.01]", "2 numbers for 25 nodes", "design.nodes"];
    refuses_sets(&["design.offsets=[0.0, 0.01]"], &parts);
    let parts = ["mine.toml, line 3", "3 numbers for 2 nodes"];
    refuses_file("[design]\nnodes = [0.3, 0.5]\noffsets = [0, 0, 0]\n", &parts);
    refuses_sets(&["design.nodes=[]", "design.offsets=[]"], &["design.nodes is empty", "at least one"]);
}

#[test]
fn offsets_out_of_bounds() {
    let nodes = "design.nodes=[0.3, 0.5, 0.7]";
    let parts = ["design.offsets[1] = -0.021", "-0.02 ... 0.02", "design.bound"];
    refuses_sets(&[nodes, "design.offsets=[0.02, -0.021, 0.0]"], &parts);
    let parts = ["design.offsets[0] = 0.03", "-0.02 ... 0.02", "design.amplitude"];
    refuses_sets(&["design.shape=uniform", "design.amplitude=0.03"], &parts);
}

#[test]
fn shape_too_steep() {
    let nodes = "design.nodes=[0.3, 0.5, 0.51]";
    let parts = ["too steep between [1] and [2]", "-0.01 to 0.02", "at most 0.02"];
    refuses_sets(&[nodes, "design.offsets=[0.0, -0.01, 0.02]"], &parts);
    let sets = ["design.shape=sine", "design.amplitude=0.02", "design.periods=13", "resolution.dx=0.01"];
    refuses_sets(&sets, &["--set design.shape=sine", "too steep", "design.periods"]);
}

#[test]
fn nodes_out_of_order_or_outside() {
    let offsets = "design.offsets=[0.0, 0.0]";
    refuses_sets(&["design.nodes=[0.5, 0.4]", offsets], &["design.nodes[1] = 0.4", "increasing"]);
    refuses_sets(&["design.nodes=[0.5, 0.5]", offsets], &["design.nodes[1] = 0.5", "increasing"]);
    refuses_sets(&["design.nodes=[0.2, 0.5]", offsets], &["design.nodes[0] = 0.2", "0.25 ... 0.75"]);
}

/// What is wrong is shown, not the whole of a long line.
#[test]
fn long_lines_are_cut() {
    for text in [format!("time = {}", "[".repeat(20_000)), format!("[time]\nend = \"{}\"\n", "x".repeat(20_000))] {
        let case = Case::new(&[("mine.toml", &text)]);
        let message = case.refuses(&["simulate", "mine.toml", "--out", "out"], &["mine.toml"]);
        assert!(message.len() < 3000, "{} bytes: {message:.400}", message.len());
    }
}

#[test]
fn not_a_number_in_an_array() {
    let nodes = "design.nodes=[0.3, 0.5]";
    let parts = ["--set design.offsets=[0.0, nan]", "design.offsets[1] = NaN", "finite"];
    refuses_sets(&[nodes, "design.offsets=[0.0, nan]"], &parts);
    let parts = ["design.nodes[0] = inf", "finite"];
    refuses_sets(&["design.nodes=[inf, 0.5]", "design.offsets=[0.0, 0.0]"], &parts);
    refuses_file("[design]\noffsets = [0.0, nan]\n", &["mine.toml, line 2", "design.offsets[1] = NaN"]);
}

#[test]
fn missing_scene_file() {
    let case = Case::new(&[]);
    for command in ["simulate", "optimize", "check-gradient"] {
        let parts = ["no such file: mine.toml", "heated-channel", "hydrograd scenes"];
        case.refuses(&[command, "mine.toml", "--out", "out"], &parts);
    }
    let parts = ["heated-chanel", "allowed", "try: `heated-channel`"];
    case.refuses(&["optimize", "heated-chanel"], &parts);
    case.refuses(&["optimize", "."], &["`.` is a folder", "heated-channel"]);
    case.refuses(&["scenes", "heated-chanel"], &["heated-chanel", "try: `heated-channel`"]);
}

#[test]
fn scene_file_that_is_not_text() {
    let case = Case::new(&[]);
    std::fs::write(case.folder.path().join("frame.h5"), [0x89, b'H', 0xff, 0xfe]).unwrap();
    case.refuses(&["optimize", "frame.h5", "--out", "out"], &["frame.h5 is not a text file"]);
}

#[test]
fn malformed_set() {
    refuses_sets(&["time.end"], &["--set time.end", "`=`", "section.key=value"]);
    refuses_sets(&["=3"], &["--set =3", "section.key=value"]);
    refuses_sets(&["time.end="], &["--set time.end=", "no value"]);
    refuses_sets(&["design.offsets=[0.0, 0.1"], &["[0.0, 0.1", "not a complete TOML value"]);
    refuses_sets(&["time.end.x=3"], &["--set time.end.x=3"]);
}

#[test]
fn what_is_held_and_which_walls_need_the_consistent_formulation() {
    let standard = "method.name=standard";
    refuses_sets(
        &["fluid.drive=flow-rate", standard],
        &["fluid.drive", "body-force; flow-rate with method.name = consistent"],
    );
    refuses_sets(&["design.walls=both", standard], &["design.walls", "method.name = consistent"]);
    refuses_sets(&["objective.kind=wall-heat", standard], &["objective.kind", "method.name = consistent"]);
    refuses_sets(&["fluid.flow_rate=0.1"], &["fluid.flow_rate", "try: --set fluid.drive=flow-rate"]);
    refuses_sets(&["fluid.drive=flow-rate", "fluid.pumping_power=1"], &["fluid.pumping_power", "pumping-power"]);
    refuses_sets(&["fluid.drive=flow-rate", "fluid.flow_rate=-1"], &["fluid.flow_rate = -1", "> 0"]);
    refuses_sets(&["fluid.drive=pumping-power", "fluid.body_force=0"], &["fluid.drive", "a body force above 0"]);
    refuses_sets(
        &["channel.height=0.6"],
        &["as fast as 10.350", "sound speed of 10.000", "fluid.reference_velocity=10.4"],
    );
    for (key, value) in [("design.walls", "both"), ("fluid.drive", "flow-rate")] {
        let set = format!("{key}={value}");
        Case::new(&[]).refuses(&["generate", "--set", &set, "--out", "out"], &[key, "a data set of"]);
    }
    // Both walls alone would not do: there are more nodes than offsets.
    refuses_sets(&["design.top_offsets=[0]"], &["design.top_offsets", "allowed: design.walls = both"]);
    let shaped = ["design.nodes=[0.4, 0.5]", "design.offsets=[0, 0]", "design.top_offsets=[0, 0]"];
    refuses_sets(&shaped, &["design.top_offsets", "try: --set design.walls=both"]);
    let top = ["design.walls=both", "design.nodes=[0.4, 0.5]", "design.offsets=[0, 0]"];
    refuses_sets(&[&top[..], &["design.top_offsets=[0]"]].concat(), &["design.top_offsets", "1 numbers for 2 nodes"]);
    refuses_sets(&[&top[..], &["design.top_offsets=[0, 0.03]"]].concat(), &["design.top_offsets", "0.03"]);
}

#[test]
fn unknown_preset() {
    let case = Case::new(&[]);
    let parts = ["--preset reprot", "allowed: report, report-jax-sph", "try: `report`"];
    case.refuses(&["optimize", "--preset", "reprot", "--out", "out"], &parts);
}

#[test]
fn nothing_to_resume() {
    let case = Case::new(&[]);
    for command in ["simulate", "optimize"] {
        case.refuses(&[command, "--resume", "runs/none"], &["--resume runs/none", "config.toml", "earlier run"]);
    }
}

#[test]
fn bad_shape_files() {
    let case = Case::new(&[
        ("empty.csv", ""),
        ("header.csv", "x,offset\n"),
        ("columns.csv", "x,height\n0.3,0.0\n"),
        ("text.csv", "x,offset\n0.3,0.0\n0.4,high\n"),
        ("nan.csv", "x,offset\n0.3,0.0\n\n0.4,nan\n"),
        ("cells.csv", "x,offset\n0.3\n"),
        ("bound.csv", "x,offset\n0.3,0.05\n"),
        ("outside.csv", "x,offset\n0.1,0.0\n"),
    ]);
    let cases: [(&str, &[&str]); 9] = [
        ("none.csv", &["none.csv", "no such file", "--set design.file=none.csv"]),
        ("empty.csv", &["empty.csv", "empty", "x,offset"]),
        ("header.csv", &["header.csv", "no lines", "x,offset"]),
        ("columns.csv", &["columns.csv, line 1", "no column `offset`", "x,height"]),
        ("text.csv", &["text.csv, line 3", "`high`", "finite"]),
        ("nan.csv", &["nan.csv, line 4", "`nan`", "finite"]),
        ("cells.csv", &["cells.csv, line 2", "1 cells", "header 2"]),
        ("bound.csv", &["bound.csv", "design.offsets[0] = 0.05", "-0.02 ... 0.02"]),
        ("outside.csv", &["outside.csv", "design.nodes[0] = 0.1", "0.25 ... 0.75"]),
    ];
    for (file, parts) in cases {
        case.refuses_sets(&[&format!("design.file={file}")], parts);
    }
    let sets = ["design.file=bound.csv", "design.nodes=[0.3]"];
    case.refuses_sets(&sets, &["design.file", "design.nodes", "one of them"]);
}

#[test]
fn output_folder_that_can_not_be_one() {
    let case = Case::new(&[("results", "")]);
    for command in ["simulate", "optimize", "check-gradient"] {
        let parts = ["--out results", "is a file", "allowed: a folder"];
        case.refuses(&[command, "--out", "results"], &parts);
        case.refuses(&[command, "--out", "results/a/b"], &["--out results/a/b", "results is a file"]);
        // Nobody may create files there, root included.
        case.refuses(&[command, "--out", "/proc/results"], &["--out /proc/results", "can not write"]);
    }
}

#[test]
fn unknown_command_or_option() {
    let case = Case::new(&[]);
    case.refuses(&["optimse"], &["optimse", "optimize"]);
    case.refuses(&["optimize", "--presision", "f32"], &["--presision", "--precision"]);
    case.refuses(&["optimize", "--precision", "f16"], &["f16", "f32", "f64"]);
    let message = case.refuses(&["optimize", "--momentum", "3"], &["--momentum"]);
    assert!(!message.contains("-- --"), "{message}");
    case.refuses(&["optimize", "heated-channel", "--resume", "x"], &["--resume", "SCENE"]);
}

#[test]
fn scenes_prints_a_complete_scene() {
    let run = |arguments: &[&str]| {
        let output = Command::cargo_bin("hydrograd").unwrap().args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(0));
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(run(&["scenes"]).contains("heated-channel"));
    assert!(run(&["--version"]).contains(env!("CARGO_PKG_VERSION")));
    let case = Case::new(&[("mine.toml", &run(&["scenes", "heated-channel", "--preset", "report"]))]);
    let file = case.folder.path().join("mine.toml");
    let loaded = hydrograd::config::scene::Config::load(file.to_str(), None, &[]).unwrap();
    let preset = hydrograd::config::scene::Config::load(None, Some("report"), &[]).unwrap();
    assert_eq!(loaded.config, preset.config);
}

/// The settings of a training have the same messages, by the same loader.
#[test]
fn settings_of_a_training() {
    let case = Case::new(&[
        ("range.toml", "steps = 5\n[model]\n\nlatent = 0\n"),
        ("type.toml", "noise = \"a lot\"\n"),
        ("broken.toml", "[model\n"),
    ]);
    let set = |set: &str, parts: &[&str]| case.refuses(&["train", "--print-config", "--set", set], parts);
    set("model.latentt=8", &["--set model.latentt=8", "unknown field `latentt`", "rounds", "try: `latent`"]);
    set("latent=8", &["--set latent=8", "try: `model.latent`"]);
    set("model.kind=gsn", &["--set model.kind=gsn", "gns, egnn", "try: `gns`"]);
    set("noise=much", &["--set noise=much", "a number", "Standard deviation of the position noise"]);
    set("clip=-1", &["--set clip=-1: clip = -1", "clip >= 0", "try: --set clip=0 (the default)"]);
    set(
        "pushforward.after=[-1]",
        &["--set pushforward.after=[-1]", "three lists", "--set pushforward.unrolls=[0] --set"],
    );
    let file = |file: &str, parts: &[&str]| case.refuses(&["train", "--print-config", "--config", file], parts);
    file("range.toml", &["range.toml, line 4: model.latent = 0", "1 <= model.latent <= 4096"]);
    file("type.toml", &["type.toml", "line 1", "noise = \"a lot\"", "a number"]);
    file("broken.toml", &["broken.toml", "line 1", "hydrograd help train"]);
    file("none.toml", &["cannot read none.toml", "settings of a training"]);
    case.refuses(&["train", "--steps", "0"], &["--steps 0: steps = 0", "steps >= 1"]);
}

#[test]
fn settings_of_a_training_are_printed_with_comments_and_read_back() {
    let run = |arguments: &[&str]| {
        let output = Command::cargo_bin("hydrograd").unwrap().args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(0));
        String::from_utf8(output.stdout).unwrap()
    };
    assert_eq!(run(&["train", "--print-config"]), hydrograd::config::training::TRAINING);
    let text = run(&["train", "--print-config", "--set", "model.radius=1.45", "--seed", "3"]);
    assert!(text.contains("\nradius = 1.45\n") && text.contains("\nseed = 3\n"), "{text}");
    let case = Case::new(&[("mine.toml", &text)]);
    let file = case.folder.path().join("mine.toml");
    assert_eq!(run(&["train", "--print-config", "--config", file.to_str().unwrap()]), text);
}

#[test]
fn keys_that_a_scene_does_not_have() {
    let case = Case::new(&[
        ("vortices.toml", "scene = \"taylor-green\"\n[channel]\nheight = 0.2\n"),
        ("channel.toml", "[flow]\nreynolds = 50\n"),
    ]);
    let run = ["simulate", "taylor-green", "--out", "out", "--set"];
    let refuses = |set: &str, parts: &[&str]| case.refuses(&[&run[..], &[set]].concat(), parts);
    refuses(
        "fluid.viscosity=0.1",
        &["--set fluid.viscosity=0.1", "not a key of scene taylor-green", "fluid.sound_speed_factor"],
    );
    refuses(
        "wall.hot_temperature=2",
        &["--set wall.hot_temperature=2", "not a key", "resolution, flow, fluid", "heated-channel"],
    );
    refuses("design.shape=sine", &["--set design.shape=sine", "taylor-green, which has no design"]);
    refuses("time.start=rest", &["not a key of scene taylor-green", "time.jitter"]);
    refuses(
        "scene=poiseuille",
        &["--set scene=poiseuille", "taylor-green already", "try: hydrograd simulate poiseuille"],
    );
    case.refuses(&["simulate", "vortices.toml"], &["vortices.toml, line 3", "`channel.height`", "scene taylor-green"]);
    let parts = [
        "channel.toml, line 2",
        "`flow.reynolds`",
        "scene heated-channel",
        "taylor-green, taylor-green-3d, poiseuille",
    ];
    case.refuses(&["simulate", "channel.toml"], &parts);
    case.refuses(&["simulate", "poiseuille", "--preset", "report"], &["preset report", "scene poiseuille"]);
}

#[test]
fn numbers_of_the_flows() {
    let case = Case::new(&[]);
    let refuses = |scene: &str, set: &str, parts: &[&str]| {
        case.refuses(&["simulate", scene, "--out", "out", "--set", set], parts)
    };
    refuses("taylor-green", "flow.reynolds=0", &["flow.reynolds = 0", "flow.reynolds > 0", "=100"]);
    refuses("taylor-green", "resolution.dx=0.03", &["does not divide 1", "try: --set resolution.dx=0.030303"]);
    refuses("taylor-green-3d", "resolution.dx=0.3", &["does not divide 2 pi", "try: --set resolution.dx=0.2991"]);
    refuses(
        "taylor-green",
        "resolution.dx=0.25",
        &["too coarse", "2 (2.4 + time.skin)", "try: --set resolution.dx=0.166666"],
    );
    refuses("poiseuille", "resolution.dx=0.2", &["too coarse", "six spacings"]);
    refuses("taylor-green-3d", "resolution.dx=0.01", &["particles", "at most 1e8"]);
    refuses("slab", "resolution.dx=0.03", &["does not divide 0.5", "try: --set resolution.dx=0.0294"]);
    refuses("slab", "resolution.dx=0.1", &["too coarse", "8 spacings"]);
    refuses("slab", "heat.conductivity_ratio=0", &["heat.conductivity_ratio = 0", "0.000001", "=1"]);
    refuses("slab", "flow.reynolds=1", &["not a key of scene slab"]);
    refuses("poiseuille", "heat.prandtl=2", &["not a key of scene poiseuille", "isothermal-channel"]);
    refuses("isothermal-channel", "channel.length=5.02", &["channel.length = 5.02", "try: --set channel.length=5"]);
    refuses("isothermal-channel", "channel.hot_from=0.2", &["channel.hot_from = 0.2", "channel.inlet_length"]);
    refuses("reverse-poiseuille-3d", "resolution.dx=0.04", &["does not divide 0.5, the depth"]);
    case.refuses(
        &["simulate", "slab", "--set", "heat.conductivity_ratio=10", "--set", "method.name=consistent"],
        &["heat.conductivity_ratio = 10", "try: --set method.name=standard"],
    );
    case.refuses(&["generate", "slab", "--out", "data"], &["no data sets of scene slab", "generate heated-channel"]);
    refuses("poiseuille", "time.end=1e9", &["time.end = 1000000000", "steps"]);
}

#[test]
fn scenes_without_a_design() {
    let case = Case::new(&[("mine.toml", "scene = \"poiseuille\"\n")]);
    for command in ["optimize", "check-gradient"] {
        for (scene, name) in
            [("taylor-green", "taylor-green"), ("taylor-green-3d", "taylor-green-3d"), ("mine.toml", "poiseuille")]
        {
            let parts = [
                &format!("scene {name} has no design"),
                "allowed: a scene with a design: heated-channel",
                "try: hydrograd simulate",
            ];
            case.refuses(&[command, scene, "--out", "out"], &parts);
        }
    }
    case.refuses(&["optimize", "taylor-green", "--epochs", "3", "--start", "sine"], &["taylor-green has no design"]);
}

/// A key of another method names the methods that have it, wherever it was given; today's and those of before.
#[test]
fn keys_of_another_method() {
    let case = Case::new(&[
        ("mine.toml", "[method]\nname = \"fixed\"\nshift = \"rows\"\n"),
        ("unknown.toml", "[time]\nend = 1\n[method]\nname = \"standard\"\nfluxx = \"delta\"\n"),
        ("wrong.toml", "[method]\nshift_strength = \"much\"\n"),
        ("before.toml", "scene = \"poiseuille\"\n[fluid]\nflux = \"delta\"\n"),
    ]);
    let refuses =
        |arguments: &[&str], parts: &[&str]| case.refuses(&[&["simulate", "--out", "out"], arguments].concat(), parts);
    refuses(
        &["mine.toml"],
        &[
            "mine.toml, line 3: method.shift is a key of the method consistent",
            "is fixed",
            "pressure_diffusion",
            "leave",
        ],
    );
    refuses(&["unknown.toml"], &["unknown.toml, line 5", "`fluxx`", "try: `flux`"]);
    refuses(&["wrong.toml"], &["wrong.toml, line 2", "method.shift_strength: Strength of the shift"]);
    refuses(&["--set", "method.flux=delta"], &["--set method.flux=delta: `method.flux` is not a key of scene"]);
    refuses(
        &["--set", "method.transport_velocity=1"],
        &["--set method.transport_velocity=1", "of the method standard", "shift_strength", "method.name=standard"],
    );
    refuses(
        &["--set", "method.name=wcsph"],
        &["--set method.name=wcsph", "wcsph", "allowed: consistent, standard, fixed"],
    );
    refuses(&["taylor-green", "--set", "method.name=fixed"], &["can not solve this scene", "consistent, standard"]);
    refuses(&["before.toml"], &["before.toml, line 3: fluid.flux is a key of the method standard"]);
    refuses(
        &["--set", "fluid.motion=fixed", "--set", "fluid.formulation=standard"],
        &["--set fluid.formulation=standard", "the method is fixed"],
    );
    refuses(&["--set", "fluid.formulation=wcsph"], &["fluid.formulation = wcsph", "consistent or standard"]);
    refuses(
        &["--set", "method.name=standard", "--set", "time.integrator=verlet"],
        &["--set time.integrator=verlet", "time.integrator is a key of the method consistent"],
    );
}

#[test]
fn methods_and_tanks_that_do_not_fit() {
    let case = Case::new(&[]);
    let refuses = |scene: &str, sets: &[&str], parts: &[&str]| {
        let mut arguments = vec!["simulate", scene, "--out", "out"];
        sets.iter().for_each(|set| arguments.extend(["--set", set]));
        case.refuses(&arguments, parts)
    };
    let evolves = "method.density_equation=evolution";
    refuses(
        "poiseuille",
        &[evolves],
        &["density_equation is a key of the method standard", "the method is consistent"],
    );
    let renormalised = [STANDARD, "method.density_renormalisation=true"];
    refuses("poiseuille", &renormalised, &["summed", &format!("try: --set {evolves}")]);
    let gradient = [STANDARD, "method.density_gradient=jax-sph"];
    refuses("poiseuille", &gradient, &["without diffusion of density", "method.flux=delta"]);
    let riemann = [STANDARD, "method.flux=riemann", "method.transport_velocity=1"];
    refuses("taylor-green", &riemann, &["method.transport_velocity", "Riemann", "transport_velocity=0"]);
    let exponent = [STANDARD, "method.equation_of_state_exponent=1.5"];
    refuses("poiseuille", &exponent, &["= 1.5 is no whole number", "1 ... 20"]);
    refuses("poiseuille", &[STANDARD, "method.artificial_viscosity_pairs=all"], &["without an artificial viscosity"]);
    refuses("poiseuille", &["method.flux=delat"], &["delat", "delta"]);
    refuses("dam-break", &["method.name=consistent"], &["consistent can not solve this scene", "allowed: standard"]);
    refuses(
        "dam-break",
        &["resolution.dx=0.03"],
        &["does not divide tank.length = 5.36", "try: --set tank.length=5.37"],
    );
    refuses("dam-break", &["water.height=2.4"], &["reaches out of the tank", "tank.height"]);
    refuses("dam-break", &["fluid.gravity=[0.0, -1.0, 0.5]"], &["no acceleration of this tank", "the last one 0"]);
    refuses("dam-break-3d", &["tank.depth=0.2"], &["tank.depth = 0.2 is too short", "skin"]);
    refuses("hydrostatic-tank", &["fluid.gravity=[0.0, 1.0, 0.0]"], &["downwards"]);
    refuses("falling-block", &["water.x=0.8"], &["reaches out of the tank"]);
    refuses("falling-block", &["tank.height=0.2"], &["tank.height = 0.2 is too small", "six spacings"]);
}

#[test]
fn threads_are_refused_alike_everywhere() {
    for command in [
        &["simulate"][..],
        &["train", "--data", "x"],
        &["study", "--data", "x", "--grid", "seed=1", "--steps", "1"],
        &["evaluate", "--data", "x", "--model", "y"],
        &["calibrate", "--data", "x"],
        &["validate"],
        &["verify", "x"],
        &["bench"],
    ] {
        for threads in ["5000", "-1", "two"] {
            let arguments = [command, &["--threads", threads]].concat();
            let parts = [
                &format!("'{threads}'"),
                "--threads",
                "allowed: whole numbers from 0 (every core that the process may use) to 1024",
            ];
            Case::new(&[]).refuses(&arguments, &parts);
        }
    }
}

#[test]
fn tiny_steps_are_not_blamed_on_the_time() {
    let case = Case::new(&[]);
    let run = |set: &str, parts: &[&str]| case.refuses(&["simulate", "--out", "out", "--set", set], parts);
    run("time.cfl=1e-9", &["--set time.cfl=1e-9: time.cfl = 0.000000001", "at most 1e9 steps"]);
    run("time.end=1e12", &["--set time.end=1e12: time.end = 1000000000000", "at most 1e9 steps"]);
    run("time.step=1", &["--set time.step=1: time.step = 1 is too large", "steps of at most"]);
    run("time.step=0", &["time.step = 0"]);
}

/// Said before anything is read or written, by every command that has the option.
#[test]
fn devices_that_are_not_there() {
    let case = Case::new(&[("mine.toml", "[run]\ndevice = \"cuda:77\"\n")]);
    let why = if cfg!(feature = "cuda") {
        "no device cuda:77: "
    } else {
        "no device cuda:77: this hydrograd was built without CUDA"
    };
    for command in [
        &["simulate"][..],
        &["simulate", "taylor-green", "--kernels", "fused"],
        &["optimize"],
        &["check-gradient"],
        &["generate", "--trajectories", "1/1/1"],
        &["scenes", "check"],
        &["train", "--data", "x"],
        &["evaluate", "--data", "x", "--model", "linear"],
        &["rollout", "--data", "x", "--model", "linear"],
        &["bench", "step"],
    ] {
        let arguments = [command, &["--device", "cuda:77", "--out", "out"]].concat();
        case.refuses(&arguments, &["error: --device cuda:77: ", why, "allowed: ", "try: --device cpu"]);
        let arguments = [command, &["--device", "gpu"]].concat();
        case.refuses(&arguments, &["`gpu` is not a device", "--device", "cuda:N"]);
    }
    case.refuses(&["simulate", "mine.toml", "--out", "out"], &["mine.toml, line 2: ", why, "try: --device cpu"]);
    refuses_sets(&["run.device=cuda:77"], &["--set run.device=cuda:77: ", why, "try: --device cpu"]);
    refuses_sets(&["run.device=cuda:"], &["--set run.device=cuda:: ", "`cuda:` is not a device", "cuda:N"]);
    refuses_file("[run]\ndevice = 0\n", &["mine.toml", "line 2", "cuda:N"]);
    case.refuses(&["bench", "accuracy", "--device", "cuda:77"], &["the group accuracy runs on the CPU"]);
    case.refuses(&["recover", "--device", "cuda:0", "--out", "out"], &["--device cuda:0: recover runs on the CPU"]);
}
