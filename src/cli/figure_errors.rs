//! `simulate --error` and `--accuracy`: the same scene at coarser spacings, what this says of the error of every figure, and the spacing at
//! which an error is as small as it is asked to be. Where one solution tells its errors, the same run does.

use super::files::write_summary;
use super::{page, program};
use crate::config::layers::Setting;
use crate::config::scene::Family;
use crate::error::{BadInput, Error};
use crate::numerics::interrupt;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::figure_error::{errors, is_told_alone, length_in, main_figure, order, FigureError};
use crate::scene::load::Loaded;
use crate::scene::record::Record;
use crate::scene::verification::with_its_wall;
use clap::Args;
use std::path::Path;
use std::process::Stdio;
use std::time::Instant;

/// Coarser spacings over the scene's, those that are wanted most first: one of the first and one of the second list.
const RATIOS: [&[f64]; 2] = [&[1.25, 1.34, 1.42, 1.2], &[1.67, 2.0, 1.75, 1.5]];
/// A finer spacing, in the scene's.
const FINER: f64 = 0.8;
/// Two spacings that differ by less than this share are the same.
const SAME: f64 = 0.04;
/// How often `--accuracy` tries another spacing.
const TRIES: usize = 4;
/// The error that a new spacing is to have, in the error that is asked for.
const AIM: f64 = 0.8;
/// The smallest spacing that is tried, in the scene's.
const FINEST: f64 = 1.0 / 8.0;

/// The options of errors.
#[derive(Debug, Clone, Args)]
pub struct ErrorArguments {
    /// Find the error of every figure: the scene runs at two coarser spacings, too, which takes about as long again at most. A steady flow
    /// of fixed particles around shapes in the plane tells its errors itself, and error.png where they come from. Around bodies in three
    /// dimensions it is a finer spacing, which takes three times as long, where coarser ones leave no room for a surface around a body.
    #[arg(long)]
    pub error: bool,
    /// Choose the spacing at which the error of the first figure (Q, or the objective) is at most this share of it, such as 0.1%.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub accuracy: Option<f64>,
}

/// `0.1%` or `0.001`.
pub fn share(text: &str) -> Result<f64, String> {
    let (number, unit) = match text.strip_suffix('%') {
        Some(number) => (number.trim(), 0.01),
        None => (text, 1.0),
    };
    match number.parse::<f64>().map(|number| unit * number) {
        Ok(share) if share > 0.0 && share < 1.0 => Ok(share),
        _ => Err("allowed: a share between 0 and 1, such as 0.1% or 0.001".into()),
    }
}

/// Runs of one scene at several spacings; each is made once.
#[derive(Default)]
pub struct Spacings {
    known: Vec<(f64, Result<Record, String>)>,
}

impl Spacings {
    /// The record of a run.
    fn run(&mut self, loaded: &Loaded) -> anyhow::Result<Result<Record, String>> {
        let dx = loaded.config.resolution.dx;
        if let Some((_, found)) = self.known.iter().find(|(known, _)| (known / dx - 1.0).abs() < 1e-9) {
            return Ok(found.clone());
        }
        let folder = tempfile::tempdir()?;
        let (scene, out) = (folder.path().join("scene.toml"), folder.path().join("run"));
        std::fs::write(&scene, &loaded.text)?;
        let mut command = program::command(&program::words()?);
        command.arg("simulate").arg(&scene).arg("--out").arg(&out).args(["--set", "output.frames=0"]);
        if loaded.config.knows_its_errors() {
            command.arg("--error");
        }
        let log = tempfile::NamedTempFile::new()?;
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log.reopen()?);
        let status = program::attended(&mut command)?;
        interrupt::check()?;
        let found = match status.success() {
            true => Ok(summary_of(&out)?),
            false => Err(std::fs::read_to_string(log.path())?.trim().to_string()),
        };
        self.known.push((dx, found.clone()));
        Ok(found)
    }

    /// The records at two coarser spacings that suit the scene, and at a finer one if those tell a figure of the scene's by other sums.
    fn others(&mut self, loaded: &Loaded, record: &Record) -> anyhow::Result<Vec<(f64, Record)>> {
        let own = coarser_spacings(&with_its_wall(loaded)?);
        let bar = Progress::new(own.len() as u64, "coarser spacings");
        let (mut found, mut failure) = (vec![], None);
        for one in &own {
            match self.run(one)? {
                Ok(record) => found.push((one.config.resolution.dx, record)),
                Err(why) => failure = Some(why),
            }
            bar.done(1);
        }
        bar.finish();
        if loaded.config.is_around_bodies() && is_told_alone(record, &found) {
            let bar = Progress::new(1, "a finer spacing");
            if let Ok(finer) = loaded.with(&at_spacing(loaded, FINER * loaded.config.resolution.dx)) {
                found.extend(self.run(&finer)?.ok().map(|record| (finer.config.resolution.dx, record)));
            }
            bar.finish();
        }
        if found.is_empty() {
            let why = failure.map_or(String::new(), |why| format!(": {}", first_line(&why)));
            let problem = format!("no error is known, for the scene cannot be run at a coarser spacing{why}");
            let config = &loaded.config;
            return Err(Error::run(problem, config.finer(0.5 * config.resolution.dx)).into());
        }
        Ok(found)
    }

    /// The errors of the figures of a run.
    fn errors(&mut self, loaded: &Loaded, record: &Record) -> anyhow::Result<Vec<FigureError>> {
        if loaded.config.knows_its_errors() {
            return Ok(serde_json::from_value(record.0.get("errors").cloned().unwrap_or_default())?);
        }
        let others = self.others(loaded, record)?;
        Ok(errors(&loaded.config, record, &others))
    }

    /// The scene with the largest spacing that was found at which the first figure has no larger relative error than `accuracy`.
    ///
    /// # Errors
    /// There is none down to an eighth of the scene's spacing.
    pub fn accurate(&mut self, loaded: &Loaded, accuracy: f64) -> anyhow::Result<Loaded> {
        let (mut at, mut best) = (loaded.clone(), None::<Loaded>);
        let same = with_its_wall(loaded)?;
        let mut last = f64::NAN;
        for _ in 0..TRIES {
            let dx = at.config.resolution.dx;
            let record = self.run(&at)?.map_err(|why| {
                let problem = format!("the scene does not run at a spacing of {dx}: {}", first_line(&why));
                Error::run(problem, "another resolution.dx to begin with")
            })?;
            let all = self.errors(&at, &record)?;
            let name = main_figure(&record);
            let Some(main) = all.iter().find(|one| Some(&one.name) == name.as_ref()) else {
                let problem = "the scene has no figure whose error could be as small as that";
                return Err(BadInput::new(problem).place("--accuracy").allowed("scenes with an objective").into());
            };
            last = main.error / main.value.abs();
            let unsettled = main.parts.iteration / main.value.abs();
            let of_window = unsettled + main.parts.sampling / main.value.abs();
            if of_window >= accuracy {
                return Err(out_of_reach(&at, main, accuracy, unsettled >= 0.5 * of_window).into());
            }
            println!("spacing {dx:.6}: {} {:.6} +- {:.1e} ({:.2} %)", main.name, main.value, main.error, 100.0 * last);
            let is_coarser = best.as_ref().is_none_or(|best| dx > best.config.resolution.dx);
            if last <= accuracy && is_coarser {
                best = Some(at.clone());
            }
            let order = order(&at.config, &main.name);
            let share = AIM * (accuracy - of_window) / (last - of_window);
            let next = (dx * share.powf(1.0 / order)).max(FINEST * loaded.config.resolution.dx);
            // A larger one saves time only if it is much larger.
            if best.is_some() && next < 1.2 * dx {
                break;
            }
            let next = loaded.config.spacing_up_to(next).unwrap_or(next);
            match same.with(&at_spacing(&same, next)) {
                Ok(other) if (next / dx - 1.0).abs() > SAME => at = other,
                _ => break,
            }
        }
        best.ok_or_else(|| {
            let problem = format!(
                "an accuracy of {:.2} % was not reached: the last error is {:.2} %",
                100.0 * accuracy,
                100.0 * last
            );
            Error::run(problem, format!("--accuracy {:.1}%, or a smaller resolution.dx to begin with", 100.0 * last))
                .into()
        })
    }
}

/// An error of a figure that no spacing makes smaller: of its distance from what it goes to, or of the scatter of samples.
fn out_of_reach(loaded: &Loaded, main: &FigureError, accuracy: f64, goes_on: bool) -> Error {
    let (config, percent) = (&loaded.config, |part: f64| 100.0 * part / main.value.abs());
    let (why, advice) = match goes_on {
        true => {
            let problem = format!("it still has {:.2} % to go when the run ends", percent(main.parts.iteration));
            (problem, format!("time.end={:.3}", 2.0 * config.duration()))
        }
        false => {
            let problem = format!("the scatter of its samples makes {:.2} %", percent(main.parts.sampling));
            (problem, format!("objective.window={:.3}", 2.0 * config.objective.window))
        }
    };
    let wanted = 100.0 * accuracy;
    Error::run(format!("no spacing gives {} to {wanted:.2} %: {why}", main.name), advice)
}

/// The record of a finished run.
fn summary_of(folder: &Path) -> anyhow::Result<Record> {
    Ok(serde_json::from_slice(&std::fs::read(folder.join("summary.json"))?)?)
}

fn first_line(text: &str) -> &str {
    text.lines().next().unwrap_or_default()
}

/// The settings of another spacing, also on surfaces, over the same time.
pub fn at_spacing(loaded: &Loaded, dx: f64) -> Vec<Setting> {
    let spacings = loaded.config.spacings_at(dx).map(|(key, spacing)| Setting::set(&format!("{key}={spacing}")));
    spacings.chain(loaded.same_time()).collect()
}

/// The settings of a heated channel with so many rows, whatever its height: where no coarser spacing divides both height and length, the
/// length is the next one that it divides, and the outlet begins where it did. (What lies behind the section where the heat is measured
/// hardly changes it; 13 rows of 0.02 become 10 of 0.026 and a length of 0.988.)
fn at_rows(loaded: &Loaded, rows: f64) -> Option<(f64, Vec<Setting>)> {
    let (channel, dx) = (&loaded.config.channel, loaded.config.channel.height / rows);
    let length = length_in(channel.length, dx);
    let outlet = channel.outlet_length + length - channel.length;
    (loaded.config.scene == Family::HeatedChannel).then(|| {
        let own = [format!("channel.length={length}"), format!("channel.outlet_length={outlet}")];
        (dx, at_spacing(loaded, dx).into_iter().chain(own.map(|own| Setting::set(&own))).collect())
    })
}

/// The scene at up to two coarser spacings that it allows.
fn coarser_spacings(loaded: &Loaded) -> Vec<Loaded> {
    let config = &loaded.config;
    let dx = config.resolution.dx;
    let mut found: Vec<Loaded> = vec![];
    for ratios in RATIOS {
        let largest = found.last().map_or(dx, |last| last.config.resolution.dx);
        let allowed = |spacing: f64, settings: Vec<Setting>| {
            (spacing > (1.0 + 2.0 * SAME) * largest).then(|| loaded.with(&settings).ok()).flatten()
        };
        let one = ratios.iter().find_map(|ratio| {
            // A lattice fits some spacings only.
            let near = config.spacing_up_to((ratio + SAME) * dx).filter(|_| !config.is_around_shapes());
            let spacing = near.unwrap_or(ratio * dx);
            allowed(spacing, at_spacing(loaded, spacing))
        });
        found.extend(one.or_else(|| {
            let stretched = ratios.iter().filter_map(|ratio| at_rows(loaded, (config.rows() as f64 / ratio).round()));
            stretched.into_iter().find_map(|(spacing, settings)| allowed(spacing, settings))
        }));
    }
    found
}

/// Adds the errors of the figures to a finished run, and prints them.
pub fn add(loaded: &Loaded, folder: &Path, spacings: &mut Spacings) -> anyhow::Result<()> {
    let clock = Instant::now();
    let mut record = summary_of(folder)?;
    let found = spacings.errors(loaded, &record)?;
    put(&mut record, &found);
    record.put("error_seconds", clock.elapsed().as_secs_f64());
    write_summary(folder, &record)?;
    page::refresh(folder)?;
    tell(&found);
    Ok(())
}

/// Prints errors.
pub fn tell(found: &[FigureError]) {
    match found.is_empty() {
        true => println!("\nerrors: no figure changes with the spacing"),
        false => println!("\nerrors (19 of 20 are smaller)\n{}", table(found).to_text()),
    }
}

/// Adds errors to a record: all of them, and those of Q and the objective under names of their own.
pub fn put(record: &mut Record, found: &[FigureError]) {
    for one in found.iter().filter(|one| ["q", "objective"].contains(&one.name.as_str())) {
        record.put(&format!("{}_error", one.name), one.error);
        record.put(&format!("{}_error_parts", one.name), one.parts);
    }
    record.put("errors", found);
}

fn table(found: &[FigureError]) -> Table {
    // One solution shows no order.
    let has_order = found.iter().any(|one| one.observed_order.is_some());
    let mut header = vec!["figure", "value", "+-", "share", "of which"];
    header.extend(has_order.then_some("order seen"));
    let mut table = Table::new(header);
    for FigureError { name, value, error, parts, observed_order } in found {
        let mut row = vec![
            name.clone(),
            format!("{value:.6}"),
            format!("{error:.1e}"),
            // Of a figure that is zero but for its error.
            match error / value.abs() {
                share if share < 1.0 => format!("{:.2} %", 100.0 * share),
                _ => "> 100 %".into(),
            },
            parts.told(),
        ];
        row.extend(has_order.then(|| observed_order.map_or("none".into(), |order| format!("{order:.1}"))));
        table.row(row);
    }
    table
}
