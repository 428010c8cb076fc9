//! `hydrograd bench`: measures time and memory of steps and gradients, in groups of comparable cases.
//!
//! Each row is measured in its own process, which answers in JSON. The modules depend on each other as follows:
//!
//! ```text
//! case  <-  arguments, needs, surrogate, accuracy, rows  <-  cases, child, plots, runner  <-  tables  <-  run
//! ```

pub mod accuracy;
mod arguments;
pub mod case;
mod cases;
pub mod child;
mod needs;
mod plots;
pub mod rows;
mod runner;
pub mod surrogate;
mod tables;

pub use arguments::BenchArguments;

use super::arguments::check_writable;
use super::files::write_json;
use super::machine;
use super::page;
use super::prepare::compute;
use super::run_folder::{self, RunFolder};
use crate::config::device::DeviceName;
use crate::error::{BadInput, Error};
use crate::report::progress::Progress;
use accuracy::ComparedRun;
use case::Group;
use cases::Cases;
use rows::{Earlier, Row};
use serde_json::json;
use std::path::PathBuf;

pub fn run(arguments: BenchArguments) -> anyhow::Result<()> {
    if let Some(case) = &arguments.case {
        return child::run(case);
    }
    let (groups, scene) = arguments.groups_and_scene()?;
    check_writable(&arguments.out)?;
    let earlier = arguments.compare.as_deref().map(Earlier::read).transpose()?;
    if arguments.device != DeviceName::Cpu && groups.contains(&Group::Accuracy) {
        return Err(BadInput::new("the group accuracy runs on the CPU")
            .place(format!("--device {}", arguments.device))
            .advice("the other groups, or --device cpu")
            .into());
    }
    compute(arguments.kernels, arguments.device)?;
    let cases = Cases::new(&arguments, scene);
    let mut work = vec![];
    for &group in &groups {
        work.push((group, cases.of(group)?));
    }
    let peers = match &arguments.peers {
        Some(path) if !groups.contains(&Group::Accuracy) => {
            return Err(BadInput::new("only the group accuracy draws other codes' points")
                .place(format!("--peers {}", path.display()))
                .advice("hydrograd bench accuracy --peers FILE")
                .into());
        }
        Some(path) => accuracy::read(path)?,
        None => vec![],
    };
    let runs: usize = work.iter().flat_map(|(_, families)| families).map(Vec::len).sum();
    if runs == 0 && !groups.contains(&Group::Accuracy) {
        return Err(BadInput::new("no row has a label that contains this")
            .place(format!("--filter {}", arguments.filter))
            .allowed("a part of group/scene/particles/precision/threads/kind/mode, e.g. step/heated-channel-report/950/f64/2/forward")
            .into());
    }
    let _own = RunFolder::take(&arguments.out, "bench", run_folder::Earlier::Replaced)?;
    let file = arguments.out.join("bench.json");
    let mut all: Vec<Row> = vec![];
    let (mut all_left_out, mut measured, mut pictures) = (vec![], None, vec![]);
    let bar = Progress::new((runs * arguments.repeats()) as u64, "bench");
    for (group, families) in &work {
        if *group == Group::Accuracy {
            let (points, drawn) = run_accuracy(&arguments, &peers)?;
            measured = Some(points);
            pictures.extend(drawn);
            continue;
        }
        let (mut found, mut left_out) = (vec![], vec![]);
        for family in families {
            let (rows, without) = runner::run(family, arguments.repeats(), &bar)?;
            found.extend(rows);
            left_out.extend(without);
        }
        all.extend(found.iter().cloned());
        // Writes after each group, so that measurements are kept if a later group fails.
        write_json(&file, &json!(all))?;
        let plots = plots::draw(&arguments.out, *group, &found)?;
        if !found.is_empty() {
            println!("\n{}", tables::text(*group, &found, earlier.as_ref()));
        }
        for (label, reason) in &left_out {
            println!("left out: {label}: {reason}");
        }
        all_left_out.append(&mut left_out);
        // Each plot is a PNG and an SVG.
        for picture in plots.iter().step_by(2) {
            println!("picture: {}", picture.display());
        }
        pictures.extend(plots);
        check_plans(&found)?;
    }
    bar.finish();
    if let Some(earlier) = &earlier {
        println!("{}", earlier.summary(&all));
    }
    page::write(&arguments.out)?;
    let of_case = |(label, reason): &runner::LeftOut| json!({ "case": label, "reason": reason });
    machine::answer(&json!({
        "folder": machine::path(&arguments.out),
        "rows": all,
        "accuracy": measured,
        "left_out": all_left_out.iter().map(of_case).collect::<Vec<_>>(),
        "pictures": pictures.iter().map(|picture| machine::path(picture)).collect::<Vec<_>>(),
    }));
    if runs > 0 {
        println!("rows: {}", file.display());
    }
    Ok(())
}

/// Measures run time against error with the last number of `--threads`; returns the points and their plots.
fn run_accuracy(arguments: &BenchArguments, peers: &[ComparedRun]) -> anyhow::Result<(Vec<ComparedRun>, Vec<PathBuf>)> {
    let mut points = runner::accuracy(arguments.quick, arguments.last_threads())?;
    points.retain(|point| point.label().contains(&arguments.filter));
    points.retain(|point| arguments.precisions().contains(&point.precision));
    let file = arguments.out.join("accuracy.json");
    write_json(&file, &json!(points))?;
    let own = points.clone();
    points.extend(peers.iter().cloned());
    println!("{}", accuracy::text(&points));
    let pictures = accuracy::draw(&arguments.out, &points)?;
    for picture in pictures.iter().step_by(2) {
        println!("picture: {}", picture.display());
    }
    println!("points: {}", file.display());
    Ok((own, pictures))
}

/// Returns an error if a plan changes the result.
fn check_plans(rows: &[Row]) -> Result<(), Error> {
    for row in rows {
        // They agree to rounding.
        let limit = if row.precision == "f32" { 1e-3 } else { 1e-9 };
        if let Some(difference) = row.difference.filter(|found| found.is_nan() || *found > limit) {
            let problem = format!("{}: differs from the plan by {difference:.1e}, above {limit:.0e}", row.label());
            return Err(Error::run(problem, "this is a bug in the plan or in an operator: please report it"));
        }
    }
    Ok(())
}
