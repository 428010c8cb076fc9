//! `simulate` of fixed particles around shapes whose flow goes on in time.

use super::around_shapes::{fastest, of_objective};
use super::files;
use super::page;
use super::run_folder::{Earlier, RunFolder};
use super::simulate_report::{print_dimensionless, warn};
use crate::io::csv::{write_table, Cell};
use crate::io::vtk::VtkSeries;
use crate::io::FileError;
use crate::numerics::threads::{count, in_words};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::around_in_time::{Course, History};
use crate::scene::around_shapes::AroundShapes;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::record::Record;
use crate::sph::cloud::figures::Figure;
use serde_json::{json, Value};
use std::path::Path;
use std::time::Instant;

/// Ticks of the progress bar.
const TICKS: f64 = 1000.0;

fn course_json(figure: &str, course: &Course) -> Value {
    json!({ "figure": figure, "mean": course.mean, "least": course.least, "most": course.most, "frequency": course.frequency })
}

/// `hydrograd simulate`: the flow to `time.end`, its figures over time, and frames for ParaView.
pub fn simulate(loaded: &Loaded, folder: &Path, earlier: Earlier) -> anyhow::Result<()> {
    let config = &loaded.config;
    let clock = Instant::now();
    let around = AroundShapes::new(config)?;
    let own = RunFolder::take(folder, "simulate", earlier)?;
    files::write_config(folder, loaded)?;
    let mut series = VtkSeries::new(&folder.join("particles"), "particles")?;
    let (end, frames) = (config.time.end, config.output.frames);
    let bar = Progress::new(TICKS as u64, "simulate");
    // Frames are written after the run, whose errors are of another kind.
    let mut kept = vec![];
    let mut next = 1;
    let mut speed: f64 = 0.0;
    let (history, last) = around.march(&around.first(), None, &mut |moment, solution| {
        bar.set_position((TICKS * moment.time / end) as u64);
        if frames > 0 && moment.time >= end * next as f64 / frames as f64 * (1.0 - 1e-12) {
            kept.push(ParticleFields { time: moment.time, ..around.fields(solution) });
            next = (moment.time / end * frames as f64 * (1.0 + 1e-12)) as usize + 1;
        }
        speed = speed.max(fastest(solution));
        Ok(())
    })?;
    bar.finish();
    let seconds = clock.elapsed().as_secs_f64();
    for fields in &kept {
        fields.with_frame(|frame| series.write(frame))?;
    }
    let fields = ParticleFields { time: end, step: history.sizes.len(), ..around.fields(&last) };
    fields.write(folder, config, &loaded.text)?;
    let heat = files::plot_flow_and_heat(folder, &[("end", &fields)], config.resolution.dx)?;
    write_history(folder, &history)?;
    let from = around.window();
    let record = record(loaded, &around, &history, from, speed, seconds);
    files::write_summary(folder, &record)?;
    around.write_grid(folder, &last, end)?;
    let (least, most) = history.sizes.iter().fold((f64::MAX, 0.0f64), |(a, b), x| (a.min(*x), b.max(*x)));
    println!(
        "{} fixed particles, {} steps of {least:.2e} to {most:.2e} in {seconds:.2} s on {} ({:.2} ms a step)",
        around.flow.cloud.particles(),
        history.sizes.len(),
        in_words(count()),
        1e3 * seconds / history.sizes.len() as f64
    );
    print_courses(&history, from, end);
    if around.has_objective() {
        println!("objective           {:.6}   {}, mean of the window", history.objective(from), of_objective(config));
    }
    print_dimensionless(config, speed);
    println!(
        "files in {}: report.html, summary.json, history.csv, flow.png{}, state.h5, particles/particles.pvd (ParaView)",
        folder.display(),
        if heat { ", temperature.png" } else { "" }
    );
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

fn print_courses(history: &History, from: f64, end: f64) {
    let mut table = Table::new([format!("t = {from} ... {end}").as_str(), "mean", "least", "most", "frequency"]);
    for (k, (name, _)) in history.figures.iter().enumerate() {
        let Course { mean, least, most, frequency } = history.of(from, k);
        let frequency = frequency.map_or(String::new(), |frequency| format!("{frequency:.5}"));
        table.row([name.clone(), format!("{mean:.6}"), format!("{least:.6}"), format!("{most:.6}"), frequency]);
    }
    println!("{}", table.to_text());
}

/// The summary of a flow in time: means over the window, and the course of each figure there.
fn record(loaded: &Loaded, around: &AroundShapes, history: &History, from: f64, fastest: f64, seconds: f64) -> Record {
    let mut record = Record::of_steady(loaded, fastest, seconds);
    record.put("particles", around.flow.cloud.particles());
    record.put("steps", history.sizes.len());
    record.put("factorisations", history.factorisations);
    record.put("window_begins", from);
    let mut shapes = vec![json!({}); loaded.config.shapes.len()];
    let mut all = vec![];
    for (k, (name, figure)) in history.figures.iter().enumerate() {
        let course = history.of(from, k);
        all.push(course_json(name, &course));
        match *figure {
            Figure::Force { shape, along } => {
                if along == 0 {
                    shapes[shape]["force"] = json!([course.mean, 0.0]);
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
        let objective = history.course(from, &|moment| moment.objective);
        record.put("objective_kind", loaded.config.objective.kind);
        record.put("objective", objective.mean);
        all.push(course_json("objective", &objective));
        record.put("objective_at_end", history.moments.last().map(|moment| moment.objective));
    }
    record.put("courses", all);
    record
}
