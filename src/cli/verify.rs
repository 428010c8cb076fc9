//! `hydrograd verify`: checks whether the gain of a design is a property of its wall, also for `optimize`.

use super::arguments::{name_of, option, set_option, threads, with_options};
use super::files::{write_json, write_summary, VERSION};
use super::page;
use super::prepare::{open_device, require_design, use_threads};
use super::run_folder::{Earlier, RunFolder};
use crate::config::scene::{Config, Precision};
use crate::design::shape::{self, read_column, read_columns, read_surface, Columns, Shape};
use crate::error::{BadInput, Error};
use crate::numerics::interrupt;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::report::text::shown;
use crate::scene::load::Loaded;
use crate::scene::record::Record;
use crate::scene::verification::{Verification, Verified};
use clap::Args;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Evaluate a wall, or the shapes of a scene of one's own, again at half the spacing, with other particles, over twice the time and from another seed.
///
/// How much the gain changes under these is its error. What is left of it is a gain of the wall; the rest may be one of the
/// solver's error, which an optimiser finds as readily.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd verify runs/optimize-heated-channel
      the best wall of a run against its first, with the run's own configuration
  hydrograd verify runs/starts/sine --set time.end=4
      of one of several starts, over a longer time
  hydrograd verify wall.csv --scene my.toml --out runs/wall
      a wall of your own (columns x and offset, and top if both are shaped) against the flat one")]
pub struct VerifyArguments {
    /// Folder of a run of `optimize`, or a CSV file with columns x and offset (and, if it has them, top: the other
    /// wall, first and top_first: the reference).
    #[arg(value_name = "PATH")]
    pub path: PathBuf,
    /// Scene of a CSV file: built-in, or a TOML file [default: heated-channel].
    #[arg(long, value_name = "SCENE")]
    pub scene: Option<String>,
    /// Override a key of the scene, e.g. `--set time.end=1.5`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Folder for verification.json [default: that of the wall].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Floating-point type (run.precision).
    #[arg(long, value_enum)]
    pub precision: Option<Precision>,
    /// Worker threads, 0 for every core that the process may use (run.threads).
    #[arg(long, value_name = "N", value_parser = threads, allow_hyphen_values = true)]
    pub threads: Option<usize>,
}

/// The input of `verify`: the wall and its scene.
struct Given {
    wall: PathBuf,
    /// The first and the best numbers of shapes, if the search was for those.
    numbers: Option<[Shape; 2]>,
    scene: Option<String>,
    /// Default output folder.
    folder: PathBuf,
}

impl VerifyArguments {
    /// The files of the argument PATH.
    fn given(&self) -> Result<Given, BadInput> {
        let path = &self.path;
        let name = path.display();
        let bad = |problem: String| {
            let allowed = "the folder of a run of `hydrograd optimize`, or a CSV file with columns x and offset";
            BadInput::new(problem).allowed(allowed)
        };
        if !path.exists() {
            return Err(bad(format!("no such file or folder: {name}")));
        }
        if path.is_file() {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            let folder = folder.unwrap_or(Path::new(".")).to_path_buf();
            return Ok(Given { wall: path.clone(), numbers: None, scene: self.scene.clone(), folder });
        }
        let (config, wall) = (path.join("config.toml"), path.join("shape.csv"));
        // A search for the numbers of shapes has them in its summary.
        let summary = path.join("summary.json");
        let numbers = numbers_of(&summary);
        let wall = if numbers.is_some() { summary } else { wall };
        if let Some(file) = [&config, &wall].into_iter().find(|file| !file.is_file()) {
            let bad = bad(format!("{name} is not the folder of a run: no file {}", file.display()));
            return Err(match path.join("flat/shape.csv").is_file() {
                true => bad.advice(format!("one of its starts, such as {}", path.join("flat").display())),
                false => bad,
            });
        }
        if let Some(scene) = &self.scene {
            return Err(BadInput::new(format!("a scene for a run that has its own, {}", config.display()))
                .place(format!("--scene {scene}"))
                .allowed("--scene with a CSV file")
                .advice(format!("hydrograd verify {} --scene {scene}", wall.display())));
        }
        Ok(Given { wall, numbers, scene: Some(config.to_string_lossy().into()), folder: path.clone() })
    }

    fn load(&self, given: &Given) -> Result<Loaded, Error> {
        let scene = given.scene.as_deref();
        require_design(&Config::load_settings(scene, None, &[])?.config)?;
        let mut settings: Vec<_> = self.sets.iter().map(|text| set_option(text)).collect();
        settings.extend(self.precision.map(|value| option("run.precision", name_of(value))));
        settings.extend(self.threads.map(|value| option("run.threads", value)));
        Config::load_settings(scene, None, &settings)
    }
}

const KIND: &str = "verify";

/// The first and the best numbers of shapes in the summary of a search; none in other files.
fn numbers_of(file: &Path) -> Option<[Shape; 2]> {
    let record: Record = serde_json::from_slice(&std::fs::read(file).ok()?).ok()?;
    let rows = record.rows("variables")?;
    let of = |name: &str| -> Option<Shape> {
        rows.iter().map(|row| row.get(name)?.as_f64()).collect::<Option<Vec<f64>>>().map(Shape::of_numbers)
    };
    Some([of("first")?, of("best")?])
}

pub fn run(arguments: VerifyArguments) -> anyhow::Result<()> {
    let given = arguments.given()?;
    let loaded = arguments.load(&given)?;
    let folder = arguments.out.clone().unwrap_or_else(|| given.folder.clone());
    // The output goes to a separate folder, or to that of the verified run.
    let earlier = if folder == given.folder { Earlier::Visited } else { Earlier::Replaced };
    RunFolder::check(&folder, KIND, earlier)?;
    let (from, to) = (loaded.config.channel.hot_from, loaded.config.channel.hot_to);
    let located = |bad: BadInput| bad.located(|_| Some(given.wall.display().to_string()));
    let wall = |columns: Columns, top: &str| -> Result<Shape, BadInput> {
        let Columns { nodes, across, offsets } = columns;
        let shape = match across {
            Some(_) => Shape { nodes, across, offsets, top: None, hot_from: from, hot_to: to },
            None => {
                let top = read_column(&given.wall, top, false)?.map(|top| top.offsets);
                let shape = Shape::new(nodes, offsets, from, to).and_then(|shape| shape.with_top(top));
                shape.map_err(located)?
            }
        };
        shape.check_bound(loaded.config.design.bound).map_err(located)?;
        Ok(shape)
    };
    let is_surface = loaded.config.dimension() == 3;
    let (first, best) = match given.numbers.clone() {
        Some([first, best]) => (Some(first), best),
        None => {
            let columns = if is_surface { read_surface(&given.wall) } else { read_columns(&given.wall) };
            let best = wall(columns?, shape::TOP)?;
            let first = read_column(&given.wall, "first", is_surface)?;
            (first.map(|first| wall(first, "top_first")).transpose()?, best)
        }
    };
    use_threads(loaded.config.run.threads);
    open_device(&loaded)?;
    let verification = Verification::of_search(&loaded, first, best)?;
    let _own = RunFolder::take(&folder, KIND, earlier)?;
    let verified = verify(&verification)?;
    let mut record = verified.record();
    record.put("version", VERSION);
    record.put("wall", arguments.path.display().to_string());
    let file = folder.join("verification.json");
    write_json(&file, &json!(record))?;
    match earlier {
        Earlier::Visited => page::refresh(&folder)?,
        _ => page::write(&folder)?,
    }
    println!("{}", text_of(&verified));
    println!("file: {}", file.display());
    Ok(())
}

fn verify(verification: &Verification) -> Result<Verified, Error> {
    const UNITS: f64 = 1000.0;
    let bar = Progress::new(UNITS as u64, "verify");
    let verified = verification.run(&mut |share| bar.set_position((share * UNITS) as u64));
    bar.finish();
    verified
}

/// Checks the gain of a search, prints the remaining gain, and adds it to `summary.json`.
pub fn of_search(folder: &Path, mut record: Record, verification: &Verification) -> anyhow::Result<()> {
    let verified = verify(verification)?;
    // Otherwise a check that was interrupted would count as failed.
    interrupt::check()?;
    record.0.extend(verified.record().0);
    write_summary(folder, &record)?;
    println!("\nverification: both walls again, with one thing changed\n{}", text_of(&verified));
    let symbol = verified.figure.symbol;
    let values: Vec<f64> =
        record.per_epoch(&format!("{}_per_epoch", symbol.to_lowercase())).into_iter().flatten().flatten().collect();
    if let ([.., before, last], Some(error)) = (values.as_slice(), verified.error_of_best()) {
        let change = (last - before).abs();
        if change < error.total() {
            println!(
                "the last epoch changed {symbol} by {change:.1e}, less than its error: more epochs would gain nothing that could be proved"
            );
        }
    }
    Ok(())
}

/// The printed text: the table, the surviving gain, and warnings.
fn text_of(verified: &Verified) -> String {
    let symbol = verified.figure.symbol;
    let mut table = Table::new(["check", &format!("{symbol} reference"), &format!("{symbol} best"), "gain"]);
    for finding in &verified.checks {
        let [reference, best, gain] = match finding.figures {
            Ok((reference, best)) => {
                [format!("{reference:.6}"), format!("{best:.6}"), finding.gain().map_or("-".to_string(), percent)]
            }
            Err(_) => ["-", "-", "-"].map(String::from),
        };
        table.row([finding.check.clone(), reference, best, gain]);
    }
    let mut text = format!("{}\n", table.to_text());
    let reference = verified.reference_name;
    if let (Some(gain), Some(error)) = (verified.gain(), verified.error()) {
        let proved = if verified.is_proved() { "proved" } else { "NOT PROVED" };
        let told = error.times(100.0).told();
        let at = if verified.is_finer() { " at the finer spacing" } else { "" };
        text.push_str(&format!("gain: {} +- {:.2} %{at} ({told}), {proved}\n", percent(gain), 100.0 * error.total()));
    }
    if let (Some(value), Some(error)) = (verified.best(), verified.error_of_best()) {
        text.push_str(&format!("{symbol} of the best: {value:.6} +- {:.1e} ({})\n", error.total(), error.told()));
    }
    let survives = verified
        .survives()
        .map_or("not known".to_string(), |gain| format!("{}, the gain less its error", percent(gain)));
    text.push_str(&format!("gain that survives: {survives} (reference: {reference}; {:.1} s)", verified.seconds));
    for finding in verified.failed() {
        let why = finding.figures.as_ref().err().map_or("", String::as_str);
        text.push_str(&format!("\nWARNING: the check `{}` failed: {}", finding.check, shown(&with_options(why))));
    }
    match (verified.gain(), verified.survives()) {
        (Some(gain), _) if gain <= 0.0 => text.push_str(&format!(
            "\nWARNING: no gain survives: this wall is not better than {reference}, whatever the optimiser found"
        )),
        (_, Some(gain)) if gain <= 0.0 => {
            let parts = verified.error().unwrap_or_default();
            let remedy = match parts.discretisation >= parts.iteration.max(parts.sampling) {
                true => "a finer spacing (--dx)",
                false => "a longer run (--end)",
            };
            text.push_str(&format!(
                "\nWARNING: the gain is within its error: {remedy} would show whether there is one"
            ));
        }
        (_, Some(_)) => {}
        (Some(_), None) => {
            text.push_str("\nWARNING: the error of the gain is not known: the checks by which it is found did not run")
        }
        (None, None) => text.push_str("\nWARNING: no check could be run: nothing is known of this wall"),
    }
    text
}

fn percent(share: f64) -> String {
    format!("{:+.2} %", 100.0 * share)
}
