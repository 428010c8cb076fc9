//! `simulate` of fixed particles around shapes whose flow goes on in time, in two or three dimensions.

use super::around_shapes::{of_objective, suggest_search};
use super::files;
use super::page;
use super::run_folder::{Earlier, RunFolder};
use super::simulate_report::{print_dimensionless, warn};
use crate::config::scene::Config;
use crate::error::Error;
use crate::io::csv::{write_table, Cell};
use crate::io::vtk::VtkSeries;
use crate::io::FileError;
use crate::numerics::threads::{count, in_words};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_flow::Around;
use crate::scene::around_shapes::AroundShapes;
use crate::scene::history::{Course, History, Moment};
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::periods::Window;
use crate::scene::record::Record;
use crate::scene::warnings::{self, Warning};
use crate::sph::cloud::figures::Figure;
use crate::sph::cloud::problem::Solution;
use crate::sph::cloud::space;
use serde_json::{json, Value};
use std::path::Path;
use std::time::Instant;

/// Ticks of the progress bar.
const TICKS: f64 = 1000.0;

fn course_json(figure: &str, course: &Course) -> Value {
    json!({ "figure": figure, "mean": course.mean, "least": course.least, "most": course.most, "frequency": course.frequency })
}

/// Lengths and means of periods in a window may differ by this share before there is a warning.
const PERIODIC: f64 = 0.01;

/// A flow around shapes that can be drawn.
pub trait Drawn: Around {
    /// Draws flows, each with a label, side by side. Returns whether a picture of the temperature was drawn.
    ///
    /// # Errors
    /// Files that cannot be written.
    fn draw(&self, folder: &Path, panels: &[(&str, &Self::Solution)]) -> anyhow::Result<bool>;
    /// Writes a flow on `output.grid`, if there is one.
    ///
    /// # Errors
    /// Files that cannot be written.
    fn write_on_grid(&self, folder: &Path, solution: &Self::Solution, time: f64) -> anyhow::Result<()>;
    /// The pictures that are always drawn.
    const PICTURES: &'static str;
}

impl Drawn for AroundShapes {
    fn draw(&self, folder: &Path, panels: &[(&str, &Solution)]) -> anyhow::Result<bool> {
        let maps: Vec<_> = panels.iter().map(|(label, solution)| (*label, self.map(solution))).collect();
        let maps: Vec<_> = maps.iter().map(|(label, map)| (*label, map)).collect();
        files::plot_maps(folder, &maps, true)
    }

    fn write_on_grid(&self, folder: &Path, solution: &Solution, time: f64) -> anyhow::Result<()> {
        self.write_grid(folder, solution, time)?;
        Ok(())
    }

    const PICTURES: &'static str = "flow.png, vorticity.png";
}

impl Drawn for AroundBodies {
    fn draw(&self, folder: &Path, panels: &[(&str, &space::problem::Solution)]) -> anyhow::Result<bool> {
        let fields: Vec<_> = panels.iter().map(|(label, solution)| (*label, self.fields(solution))).collect();
        let fields: Vec<_> = fields.iter().map(|(label, fields)| (*label, fields)).collect();
        files::plot_flow_and_heat(folder, &fields, self.config().resolution.dx)
    }

    // `output.grid` is refused in three dimensions.
    fn write_on_grid(&self, _: &Path, _: &space::problem::Solution, _: f64) -> anyhow::Result<()> {
        Ok(())
    }

    const PICTURES: &'static str = "flow.png";
}

/// A flow in time, and the part of it that figures are averaged over.
pub struct Run<S> {
    history: History,
    pub last: S,
    window: Window,
    warnings: Vec<Warning>,
    fastest: f64,
    seconds: f64,
}

impl<S> Run<S> {
    /// `watch` gets every moment with its flow.
    ///
    /// # Errors
    /// Those of [`Around::march`].
    pub fn take(around: &impl Around<Solution = S>, watch: &mut dyn FnMut(&Moment, &S)) -> Result<Self, Error> {
        let (clock, first) = (Instant::now(), around.first());
        let mut speed: f64 = 0.0;
        let (history, last) = around.march(&first, None, &mut |moment, solution| {
            watch(moment, solution);
            speed = speed.max(around.fastest(solution));
            Ok(())
        })?;
        let seconds = clock.elapsed().as_secs_f64();
        let config = around.config();
        let mut warnings: Vec<Warning> =
            warnings::speed(config, speed).filter(|_| config.has_sound()).into_iter().collect();
        // A run of minutes is not lost because its flow is not as expected.
        let window = around.window(&first, &history).unwrap_or_else(|error| {
            let (problem, advice) = match error {
                Error::Run { problem, advice } => (problem, advice),
                other => (other.to_string(), String::new()),
            };
            let problem = format!("{problem}; figures are means over the last half of the run instead");
            warnings.push(Warning::new("no-periods", [f64::NAN; 2], problem, advice));
            around.last_half(&history)
        });
        let objective = history.values(&|moment| moment.objective);
        if let Some([lengths, means]) = window.irregularity(&history.times(), &objective) {
            if lengths.max(means) > PERIODIC {
                let problem = format!(
                    "the flow is not periodic: lengths of the periods that are averaged over differ by {:.2} %, and the means \
                     of the objective in them by {:.2} %",
                    100.0 * lengths,
                    100.0 * means
                );
                let advice = format!("time.end={}, or other objective.periods", 2.0 * around.config().time.end);
                warnings.push(Warning::new("not-periodic", [lengths.max(means), PERIODIC], problem, advice));
            }
        }
        Ok(Self { history, last, window, warnings, fastest: speed, seconds })
    }

    /// The fields at the end.
    pub fn fields(&self, around: &impl Around<Solution = S>) -> ParticleFields {
        ParticleFields { time: around.config().time.end, step: self.history.sizes.len(), ..around.fields(&self.last) }
    }

    /// Prints the mean, extremes and frequency of every figure, and the objective.
    pub fn print(&self, config: &Config, has_objective: bool) {
        print_courses(&self.history, &self.window);
        if has_objective {
            let over = match self.window.periods.len() {
                0 => "mean of the window".to_string(),
                count => format!("mean of {} whole periods of {:.6}", count - 1, self.period()),
            };
            println!(
                "objective           {:.6}   {}, {over}",
                self.history.objective(&self.window),
                of_objective(config)
            );
        }
    }

    fn period(&self) -> f64 {
        (self.window.to - self.window.from) / (self.window.periods.len() as f64 - 1.0)
    }
}

/// `hydrograd simulate`: the flow to `time.end`, its figures over time, and frames for ParaView.
pub fn simulate<A: Drawn>(loaded: &Loaded, around: &A, folder: &Path, earlier: Earlier) -> anyhow::Result<()> {
    let config = &loaded.config;
    let own = RunFolder::take(folder, "simulate", earlier)?;
    files::write_config(folder, loaded)?;
    let mut series = VtkSeries::new(&folder.join("particles"), "particles")?;
    let (end, frames) = (config.time.end, config.output.frames);
    let bar = Progress::new(TICKS as u64, "simulate");
    // Frames are written after the run, whose errors are of another kind.
    let mut kept = vec![];
    let mut next = 1;
    let run = Run::take(around, &mut |moment, solution| {
        bar.set_position((TICKS * moment.time / end) as u64);
        if frames > 0 && moment.time >= end * next as f64 / frames as f64 * (1.0 - 1e-12) {
            kept.push(ParticleFields { time: moment.time, ..around.fields(solution) });
            next = (moment.time / end * frames as f64 * (1.0 + 1e-12)) as usize + 1;
        }
    })?;
    bar.finish();
    for fields in &kept {
        fields.with_frame(|frame| series.write(frame))?;
    }
    let fields = run.fields(around);
    fields.write(folder, config, &loaded.text)?;
    let heat = around.draw(folder, &[(&format!("t = {end}"), &run.last)])?;
    let Run { ref history, seconds, fastest, .. } = run;
    write_history(folder, history)?;
    let record = record(loaded, around, &run, seconds);
    files::write_summary(folder, &record)?;
    around.write_on_grid(folder, &run.last, end)?;
    let (least, most) = history.sizes.iter().fold((f64::MAX, 0.0f64), |(a, b), x| (a.min(*x), b.max(*x)));
    println!(
        "{} fixed particles, {} steps of {least:.2e} to {most:.2e} in {seconds:.2} s on {} ({:.2} ms a step)",
        around.particles(),
        history.sizes.len(),
        in_words(count()),
        1e3 * seconds / history.sizes.len() as f64
    );
    run.print(config, around.has_objective());
    print_dimensionless(config, fastest);
    println!(
        "files in {}: report.html, summary.json, history.csv, {}{}, state.h5, particles/particles.pvd (ParaView)",
        folder.display(),
        A::PICTURES,
        if heat { ", temperature.png" } else { "" }
    );
    suggest_search(loaded);
    warn(&record.warnings());
    page::write(folder)?;
    own.finish()
}

fn write_history(folder: &Path, history: &History) -> Result<(), FileError> {
    let mut header = vec!["time"];
    header.extend(history.figures.iter().map(|(name, _)| name.as_str()));
    let has_objective = history.moments.iter().any(|moment| !moment.objective.is_nan());
    header.extend(has_objective.then_some("objective"));
    let rows: Vec<Vec<Cell>> = history
        .moments
        .iter()
        .map(|moment| {
            let mut row = vec![moment.time];
            row.extend(&moment.values);
            row.extend(has_objective.then_some(moment.objective));
            row.into_iter().map(Cell::from).collect()
        })
        .collect();
    write_table(&folder.join("history.csv"), &header, &rows)
}

fn print_courses(history: &History, window: &Window) {
    let span = format!("t = {:.6} ... {:.6}", window.from, window.to);
    let mut table = Table::new([span.as_str(), "mean", "least", "most", "frequency"]);
    for (k, (name, _)) in history.figures.iter().enumerate() {
        let Course { mean, least, most, frequency } = history.of(window, k);
        let frequency = frequency.map_or(String::new(), |frequency| format!("{frequency:.5}"));
        table.row([name.clone(), format!("{mean:.6}"), format!("{least:.6}"), format!("{most:.6}"), frequency]);
    }
    println!("{}", table.to_text());
}

/// The summary of a flow in time: means over the window, and the course of each figure there.
pub fn record<S>(loaded: &Loaded, around: &impl Around<Solution = S>, run: &Run<S>, seconds: f64) -> Record {
    let Run { history, window, .. } = run;
    let mut record = Record::of_steady(loaded, run.fastest, seconds);
    record.put("particles", around.particles());
    record.put("steps", history.sizes.len());
    record.put("factorisations", history.factorisations);
    record.put("window_begins", window.from);
    if !window.periods.is_empty() {
        record.put("window_ends", window.to);
        record.put("period", run.period());
    }
    let mut shapes = vec![json!({}); loaded.config.shapes.len()];
    let mut all = vec![];
    for (k, (name, figure)) in history.figures.iter().enumerate() {
        let course = history.of(window, k);
        all.push(course_json(name, &course));
        match *figure {
            Figure::Force { shape, along } => {
                if along == 0 {
                    shapes[shape]["force"] = json!(vec![course.mean; loaded.config.dimension()]);
                }
                shapes[shape]["force"][along] = json!(course.mean);
            }
            Figure::Torque { shape } => shapes[shape]["torque"] = json!(course.mean),
            Figure::Heat { shape } => shapes[shape]["heat"] = json!(course.mean),
            _ => record.put(name, course.mean),
        }
    }
    record.put("shapes", shapes);
    if around.has_objective() {
        let objective = history.course(window, &|moment| moment.objective);
        record.put("objective_kind", loaded.config.objective.recorded_kind());
        record.put("objective", objective.mean);
        all.push(course_json("objective", &objective));
        record.put("objective_at_end", history.moments.last().map(|moment| moment.objective));
    }
    record.put("courses", all);
    record.put_warnings(loaded, run.warnings.clone());
    record
}
