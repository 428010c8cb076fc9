//! Plots and tables. Set HYDROGRAD_PLOTS=folder to keep the pictures and look at them.

use hydrograd::io::FileError;
use hydrograd::report::memory::peak_from_status;
use hydrograd::report::plots::{colored_particles, compare, history, wall_shapes, HistoryPoint, TemperaturePanel};
use hydrograd::report::progress::{Progress, TEMPLATE};
use hydrograd::report::table::Table;
use hydrograd::report::text::{bytes, shown, shown_within};
use indicatif::ProgressStyle;
use std::path::{Path, PathBuf};

type TestResult = Result<(), Box<dyn std::error::Error>>;

/// A folder that goes away, or the one asked for.
struct Folder {
    path: PathBuf,
    _temporary: Option<tempfile::TempDir>,
}

fn folder() -> Folder {
    match std::env::var_os("HYDROGRAD_PLOTS") {
        Some(path) => {
            std::fs::create_dir_all(&path).unwrap();
            Folder { path: path.into(), _temporary: None }
        }
        None => {
            let temporary = tempfile::tempdir().unwrap();
            Folder { path: temporary.path().to_owned(), _temporary: Some(temporary) }
        }
    }
}

/// Both files are there and whole; the PNG is at least this large.
fn check_picture(paths: &[PathBuf; 2], least_width: u32, least_height: u32) -> TestResult {
    let png = std::fs::read(&paths[0])?;
    assert!(png.starts_with(b"\x89PNG\r\n\x1a\n"));
    assert!(png.ends_with(b"IEND\xaeB`\x82"));
    let number = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
    assert!(number(16) >= least_width && number(20) >= least_height, "{} x {}", number(16), number(20));
    let svg = std::fs::read_to_string(&paths[1])?;
    assert!(svg.starts_with("<svg width=\"") && svg.trim_end().ends_with("</svg>"));
    Ok(())
}

fn input_message<T: std::fmt::Debug>(result: Result<T, FileError>) -> String {
    match result {
        Err(error @ FileError::Input { .. }) => error.to_string(),
        other => panic!("expected an input error, got {other:?}"),
    }
}

#[test]
fn history_of_an_optimisation() -> TestResult {
    let folder = folder();
    let epochs: Vec<HistoryPoint> = (0..30)
        .map(|epoch| {
            let decay = (-0.15 * epoch as f64).exp();
            HistoryPoint {
                truth: f64::NAN,
                epoch,
                q: 0.0412 - 0.0093 * decay + 2e-4 * (epoch as f64).sin() * decay,
                loss: -0.0412 + 0.0093 * decay,
                gradient_norm: if epoch == 20 { f64::NAN } else { 0.08 * decay.powi(2) + 1e-5 },
            }
        })
        .collect();
    let paths = history(
        &folder.path.join("history"),
        &epochs,
        ("Q", "heat outflow Q"),
        Some(("finite elements: 0.0420", 0.042)),
    )?;
    check_picture(&paths, 2000, 1200)?;
    let svg = std::fs::read_to_string(&paths[1])?;
    for text in ["epoch", "heat outflow Q", "finite elements: 0.0420", "|gradient|", "0.040"] {
        assert!(svg.contains(text), "{text}");
    }
    // One epoch only, without reference: still a picture.
    let paths = history(&folder.path.join("history_one"), &epochs[..1], ("Q", "heat outflow Q"), None)?;
    check_picture(&paths, 2000, 1200)?;
    assert!(input_message(history(&folder.path.join("none"), &[], ("Q", "heat outflow Q"), None)).contains("no epoch"));
    Ok(())
}

fn shapes(count: usize, nodes: &[f64]) -> Vec<(String, Vec<f64>)> {
    (0..count)
        .map(|epoch| {
            let grown = 1.0 - (-(epoch as f64) / 6.0).exp();
            let offsets = nodes.iter().map(|x| -0.04 * grown * (12.0 * (x - 0.25)).sin().powi(2) * (1.0 + x));
            (format!("epoch {epoch}"), offsets.collect())
        })
        .collect()
}

#[test]
fn wall_shapes_over_epochs() -> TestResult {
    let folder = folder();
    let nodes: Vec<f64> = (0..25).map(|i| 0.26 + 0.02 * f64::from(i)).collect();
    let paths = wall_shapes(&folder.path.join("wall_many"), &nodes, &shapes(24, &nodes), Some(19), 0.06)?;
    check_picture(&paths, 2000, 1000)?;
    let svg = std::fs::read_to_string(&paths[1])?;
    assert!(svg.contains("best: epoch 19") && svg.contains("upper bound") && svg.contains("lower bound"));
    let few = shapes(4, &nodes);
    check_picture(&wall_shapes(&folder.path.join("wall_few"), &nodes, &few, None, 0.06)?, 2000, 1000)?;
    let stem = folder.path.join("bad");
    assert!(input_message(wall_shapes(&stem, &nodes[1..], &few, None, 0.06)).contains("25 offsets"));
    assert!(input_message(wall_shapes(&stem, &nodes, &few, Some(4), 0.06)).contains("0 to 3"));
    assert!(input_message(wall_shapes(&stem, &nodes, &[], None, 0.06)).contains("no wall shape"));
    Ok(())
}

/// A heated channel on a grid: position (component-major), temperature, tag.
fn channel(dx: f64, dip: f64) -> (Vec<f64>, Vec<f64>, Vec<u8>) {
    let (columns, rows, layers) = ((1.0 / dx) as usize, (0.26 / dx) as usize, 3);
    let mut points = Vec::new();
    for column in 0..columns {
        let x = (column as f64 + 0.5) * dx;
        let hot = (0.25..0.75).contains(&x);
        let floor = if hot { -dip * (std::f64::consts::TAU * (x - 0.25)).sin().powi(2) } else { 0.0 };
        for row in 0..rows + 2 * layers {
            let level = row as f64 - layers as f64 + 0.5;
            let tag = match level {
                l if l < 0.0 && hot => 3,
                l if l < 0.0 || l > rows as f64 => 1,
                _ => 0,
            };
            let y = if level < rows as f64 { floor + level * dx * (0.26 - floor).max(0.26) / 0.26 } else { level * dx };
            let warm = 1.0 + 0.23 * ((x - 0.25).max(0.0) * 1.6).min(1.0) * (-(y - floor) / 0.05).exp();
            points.push((x, y, warm, tag));
        }
    }
    let position = points.iter().map(|p| p.0).chain(points.iter().map(|p| p.1)).collect();
    (position, points.iter().map(|p| p.2).collect(), points.iter().map(|p| p.3).collect())
}

#[test]
fn particles_by_temperature() -> TestResult {
    let folder = folder();
    let (before, after) = (channel(0.02, 0.0), channel(0.02, 0.05));
    let panel = |title, (position, temperature, tag): &'static (Vec<f64>, Vec<f64>, Vec<u8>)| TemperaturePanel {
        title,
        position,
        temperature,
        tag,
        diameter: 0.02,
        diameters: None,
    };
    let panels = [
        panel("Before: flat wall, Q = 0.0319", Box::leak(Box::new(before))),
        panel("After 24 epochs, Q = 0.0412", Box::leak(Box::new(after))),
    ];
    let stem = folder.path.join("temperature");
    let start = std::time::Instant::now();
    let label = "temperature T (scene units)";
    let paths = colored_particles(&stem, label, &panels, (1.0, 1.23), (0.0, 1.0), (-0.12, 0.33))?;
    println!("temperature plot: {:?}", start.elapsed());
    check_picture(&paths, 2000, 1200)?;
    let svg = std::fs::read_to_string(&paths[1])?;
    let discs = svg.matches("<circle").count();
    // 50 columns of 13 + 6 particles, hot ones twice (outline), two panels, two legend entries of 1 and 2 discs.
    assert_eq!(discs, 2 * (50 * 19 + 25 * 3) + 3);
    assert!(svg.contains("temperature T"));

    // Equal scale on both axes: a square cavity is square, one panel is enough.
    let (position, temperature, tag) = channel(0.05, 0.0);
    let square = TemperaturePanel {
        title: "One panel",
        position: &position,
        temperature: &temperature,
        tag: &tag,
        diameter: 0.05,
        diameters: None,
    };
    let path = folder.path.join("temperature_square");
    let paths = colored_particles(&path, label, &[square], (1.0, 1.2), (0.0, 0.5), (-0.15, 0.35))?;
    check_picture(&paths, 1500, 1500)?;
    // 20 columns of 5 + 6 particles, of which 10 columns and all but the uppermost row are in the ranges; of the hot
    // ones (two discs each) 5 columns; 3 discs of the legend.
    let svg = std::fs::read_to_string(&paths[1])?;
    assert_eq!(svg.matches("<circle").count(), 10 * 10 + 5 * 3 + 3);

    let short = TemperaturePanel { temperature: &temperature[1..], ..square };
    let message = input_message(colored_particles(&stem, label, &[short], (1.0, 1.2), (0.0, 1.0), (0.0, 1.0)));
    assert!(message.contains("One panel"), "{message}");
    let message = input_message(colored_particles(&stem, label, &[square], (1.2, 1.2), (0.0, 1.0), (0.0, 1.0)));
    assert!(message.contains("temperature range is 1.2 to 1.2"), "{message}");
    Ok(())
}

#[test]
fn comparison_plots() -> TestResult {
    let folder = folder();
    let starts: Vec<(String, Vec<(f64, f64)>)> = ["flat", "wave", "bumps", "random (seed 3)"]
        .iter()
        .enumerate()
        .map(|(index, name)| {
            let rate = 0.1 + 0.05 * index as f64;
            let points =
                (0..25).map(|epoch| (f64::from(epoch), 0.0412 - 0.008 * (-rate * f64::from(epoch)).exp())).collect();
            ((*name).to_owned(), points)
        })
        .collect();
    let paths = compare(
        &folder.path.join("starts"),
        "The four starts",
        "epoch",
        "heat outflow Q (scene units)",
        &starts,
        false,
        false,
    )?;
    check_picture(&paths, 2000, 1000)?;

    let errors: Vec<(String, Vec<(f64, f64)>)> = ["f64, segment of 10 steps", "f32, segment of 10 steps"]
        .iter()
        .enumerate()
        .map(|(index, name)| {
            let floor = [1e-16, 6e-8][index];
            let points = (0..12).map(|i| 10_f64.powi(-i)).map(|h| (h, 0.3 * h * h + floor / h));
            ((*name).to_owned(), points.collect())
        })
        .collect();
    let paths = compare(
        &folder.path.join("gradient_check"),
        "Gradient check",
        "step of the difference quotient",
        "relative error",
        &errors,
        true,
        true,
    )?;
    check_picture(&paths, 2000, 1000)?;
    assert!(std::fs::read_to_string(&paths[1])?.contains("10⁻¹⁰"));

    let nothing = [("zero".to_owned(), vec![(0.0, 1.0), (f64::NAN, 1.0)])];
    let message = input_message(compare(Path::new("nowhere/x"), "", "", "", &nothing, true, false));
    assert!(message.contains("no series"), "{message}");
    Ok(())
}

#[test]
fn a_plot_into_a_missing_folder_says_so() {
    let nothing = [("a".to_owned(), vec![(1.0, 1.0)])];
    let error =
        compare(Path::new("/no-such-folder/plot"), "", "x", "y", &nothing, false, false).unwrap_err().to_string();
    assert!(error.contains("/no-such-folder/plot.png") && error.contains("its folder exists"), "{error}");
}

#[test]
fn tables_are_aligned() {
    let mut table = Table::new(["start", "Q", "gain"]);
    table.row(["flat", "0.031", "-"]).row(["wave|2", "12.5", "+30 %"]).row(["dip"]);
    let lines: Vec<String> = table.to_text().lines().map(str::to_owned).collect();
    assert_eq!(
        lines,
        ["start       Q   gain", "------  -----  -----", "flat    0.031      -", "wave|2   12.5  +30 %", "dip"]
    );
}

#[test]
fn peak_memory_is_read_of_linux() {
    let status = "VmPeak:\t  999 kB\nVmHWM:\t    1234 kB\nVmRSS:\t 7 kB\n";
    assert_eq!(peak_from_status(status), Some(1234 * 1024));
    assert_eq!(peak_from_status("VmRSS:\t 7 kB\n"), None);
    assert_eq!(peak_from_status("VmHWM:\t many kB\n"), None);
}

#[test]
fn the_bar_counts_while_hidden() {
    let progress = Progress::hidden(10);
    assert!(progress.is_hidden());
    progress.set_position(3);
    progress.done(2);
    assert_eq!(progress.position(), 5);
    assert_eq!(progress.suspend(|| 7), 7);
}

#[test]
fn the_template_is_valid() {
    assert!(ProgressStyle::with_template(TEMPLATE).is_ok());
}

#[test]
fn messages_can_be_shown() {
    let plain = "error: bad\n  allowed: 0 ... 1, \u{e4}";
    assert_eq!(shown(plain), plain);
    assert_eq!(shown("a\u{1b}[2J\u{7}b\tc"), "a\\u{1b}[2J\\u{7}b\\tc");
    assert_eq!(shown("a\u{202e}b"), "a\\u{202e}b");
    let long = "x".repeat(9000) + "\nnext";
    assert_eq!(shown(&long), "x".repeat(2000) + " ...\nnext");
    assert_eq!(shown_within("abcd", 3), "abc ...");
}

#[test]
fn sizes_of_memory_have_their_unit() {
    let sizes = [0, 9_999, 10_000, 164_904_960, 12_300_000_000].map(bytes);
    assert_eq!(sizes, ["0 B", "9999 B", "10.0 kB", "164.9 MB", "12.3 GB"]);
}
