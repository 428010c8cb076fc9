//! Pages of `optimize` and `simulate`.

use super::folder::{column, figure, percent, warnings, Columns, Folder};
use super::leads::{number, text};
use super::names::rounded;
use super::{series, tables};
use crate::cli::explain::plan_of;
use crate::cli::files::{read_config, AFTER, BEFORE, CHECKPOINT};
use crate::config::scene::{Config, Family, GradientMode};
use crate::design::objectives::Figure;
use crate::design::shape::Shape;
use crate::io::tensor_file::TensorFile;
use crate::report::page::{short, Cell, Chart, Fact, Page, Series, Side, Table, Text, Walls};
use crate::report::text::counted;
use crate::scene::record::{relative_change, Record, Search, FIGURES};
use crate::scene::Scene;

pub fn optimize(folder: &Folder) -> anyhow::Result<Page> {
    let loaded = read_config(&folder.path)?;
    let config = &loaded.config;
    let summary = folder.record("summary.json");
    let mut page = Page { warnings: warnings(&summary), ..Page::default() };
    let searched = loaded.for_search()?.config;
    if searched.is_around_shapes() {
        return Ok(around_shapes(folder, config, &summary, page));
    }
    page.texts.push(plan(&searched, true)?);
    let Some(search) = summary.search(Figure::of_config(config)) else {
        page.lead = match folder.damage().is_empty() {
            true => "This search has no result yet.".into(),
            false => "What this search found cannot be read; the warnings say why.".into(),
        };
        return Ok(page);
    };
    let Figure { symbol, quantity, unit, .. } = search.figure;
    let epochs = search.values.len();
    let (first, best, gain) = (search.first, search.best, search.gain());
    page.lead = match search.best_epoch {
        0 => {
            format!("No design that was tried is better than the first: {symbol}, the {quantity}, is {}.", figure(best))
        }
        epoch => {
            let (way, from, to) = (if best >= first { "rose" } else { "fell" }, figure(first), figure(best));
            let (gain, epoch) = (100.0 * gain, epoch.saturating_add(1));
            format!(
                "{symbol}, the {quantity}, {way} from {from} to {to} ({gain:+.2}\u{a0}%) in epoch {epoch} of {epochs}."
            )
        }
    };
    page.remark = remark(&search, &summary);
    let mut fact = |name: &str, cell: Cell| page.facts.push(Fact::new(name, cell));
    fact(&format!("{symbol} before"), Cell::shown(figure(first), first));
    fact(&format!("{symbol} after"), Cell::shown(figure(best), best));
    fact("gain", percent(gain));
    if let Some(survives) = search.survives {
        fact("gain that survives the checks", percent(survives));
    }
    fact("epochs", Cell::number(epochs as f64));
    if let Some(seconds) = summary.number("wall_seconds") {
        fact("seconds of search", Cell::shown(format!("{seconds:.1}"), seconds));
    }
    let shapes = shapes(&searched, &folder.unless_damaged(CHECKPOINT, variables(folder)).unwrap_or_default())?;
    if config.scene == Family::Custom {
        page.tables.extend(summary.rows("variables").and_then(|all| tables::of_objects("Numbers of shapes", all)));
        page.charts.extend(course_of_shapes(&summary, &shapes));
    } else {
        page.walls = walls(&searched, &search, &shapes);
    }
    page.charts.insert(0, course(&search, &summary, &format!("{symbol} ({unit})")));
    if let Some(norms) = summary.per_epoch("gradient_norm_per_epoch") {
        let series = vec![Series::by_epoch("", norms)];
        let chart = Chart::by_epoch("Norm of the gradient by epoch", "|gradient of the loss|", series);
        page.charts.insert(1, Chart { log: true, ..chart });
    }
    let of = |name: &str| folder.path.join(name).join("particles.pvd");
    let panels = [("before", vec![of(BEFORE)]), ("after", vec![of(AFTER)])];
    page.fields = series::fields(folder, &panels, config.resolution.dx);
    if page.fields.is_none() {
        page.pictures = folder.pictures(|stem| ["temperature", "flow"].contains(&stem));
    }
    page.tables.insert(0, before_and_after(&search, &summary));
    let is_steady = is_steady(&searched);
    page.tables.extend(verification("Does the gain hold?", symbol, &summary, is_steady));
    let later = folder.record("verification.json");
    page.tables.extend(verification("Checked again by hydrograd verify", symbol, &later, is_steady));
    page.more.push(tables::of_scalars("All figures (summary.json)", &summary.0));
    Ok(page)
}

/// The page of a search with fixed particles around shapes.
fn around_shapes(folder: &Folder, config: &Config, summary: &Record, mut page: Page) -> Page {
    let name = Figure::key_of(config);
    let number = |key: &str| summary.number(key);
    let (Some(first), Some(best)) = (number(&format!("{name}_first")), number(&name)) else {
        page.lead = "This search has no result yet.".into();
        return page;
    };
    let epochs = summary.rows("seconds_per_epoch").map_or(0, Vec::len);
    page.lead = format!(
        "The objective, {name}, went from {} to {} ({:+.2}\u{a0}%) in {}.",
        figure(first),
        figure(best),
        100.0 * relative_change(first, best),
        counted(epochs, "epoch")
    );
    page.remark = number("gain_survives")
        .map_or(String::new(), |gain| format!("{:+.2}\u{a0}% survives, the gain less its error.", 100.0 * gain));
    for (key, title) in [
        ("flow_rate", "flow rate"),
        ("particles", "particles"),
        ("rounds", "clouds"),
        ("jump", "largest jump between clouds"),
    ] {
        if let Some(cell) = summary.0.get(key).and_then(tables::cell) {
            page.facts.push(Fact::new(title, cell));
        }
    }
    page.charts = tables::charts(&folder.columns("history.csv"), |_| false);
    let of = |name: &str| folder.path.join(name).join("particles.pvd");
    page.fields =
        series::fields(folder, &[("before", vec![of(BEFORE)]), ("after", vec![of(AFTER)])], config.resolution.dx);
    page.tables.extend(summary.rows("variables").and_then(|all| tables::of_objects("Numbers of shapes", all)));
    page.tables.extend(
        summary.rows("shapes").and_then(|all| tables::of_objects("Shapes at the end, in the order of the file", all)),
    );
    page.tables.extend(verification("Does the gain hold?", &name, summary, false));
    page.tables.extend(verification(
        "Checked again by hydrograd verify",
        &name,
        &folder.record("verification.json"),
        false,
    ));
    page.more.push(tables::of_scalars("All figures (summary.json)", &summary.0));
    page
}

/// How reliable a gain is.
fn remark(search: &Search, summary: &Record) -> String {
    let checks = summary.rows("verification").map_or(0, Vec::len);
    match search.survives {
        Some(gain) if gain > 0.0 => {
            format!(
                "{:+.2}\u{a0}% survives: the gain less its error, by {} at another spacing, with other particles and \
                 over a longer time.",
                100.0 * gain,
                counted(checks, "check")
            )
        }
        Some(_) => "But the gain is not proved: it is not larger than its error.".into(),
        None if checks > 0 => "Its error is not known: checks could not be run.".into(),
        None => "The gain was not checked: hydrograd verify with this folder does that.".into(),
    }
}

/// The objective by epoch, with the prediction of a learned model beside the solver's values.
fn course(search: &Search, summary: &Record, y: &str) -> Chart {
    let Figure { symbol, quantity, .. } = search.figure;
    let name = symbol.to_lowercase();
    let of = |key: &str| summary.per_epoch(&format!("{name}_{key}_per_epoch"));
    let series = match (of("predicted"), of("solver")) {
        (Some(predicted), Some(solver)) => {
            vec![Series::by_epoch("predicted by the learned model", predicted), Series::by_epoch("solver", solver)]
        }
        _ => vec![Series::by_epoch("", search.values.iter().copied())],
    };
    Chart::by_epoch(format!("{symbol}, {quantity}, by epoch"), y, series)
}

/// The variables of each epoch's design; empty without a checkpoint.
fn variables(folder: &Folder) -> anyhow::Result<Vec<Vec<f64>>> {
    let path = folder.path.join(CHECKPOINT);
    if !path.is_file() {
        return Ok(vec![]);
    }
    let file = TensorFile::read(&path)?;
    let (shape, all) = file.numbers("history.offsets")?;
    let count = shape.last().copied().unwrap_or(0).max(1);
    Ok(all.chunks_exact(count).map(<[f64]>::to_vec).collect())
}

/// The shapes of each epoch's variables; empty if these do not fit the configuration.
fn shapes(config: &Config, variables: &[Vec<f64>]) -> anyhow::Result<Vec<Shape>> {
    let Some(design) = Scene::<f64>::problem(config)? else { return Ok(vec![]) };
    let count = design.parametrisation.variables();
    let fits = variables.iter().all(|of_epoch| of_epoch.len() == count);
    let sampled = |of_epoch: &Vec<f64>| design.parametrisation.sampled(of_epoch);
    Ok(variables.iter().filter(|_| fits).map(sampled).collect())
}

fn walls(config: &Config, search: &Search, shapes: &[Shape]) -> Option<Walls> {
    let first = shapes.first()?;
    let is_both = first.top.is_some();
    let name = if is_both { "bottom wall" } else { "the wall" };
    let offsets = shapes.iter().map(|shape| shape.offsets.clone()).collect();
    let mut sides = vec![Side { name: name.into(), base: 0.0, sign: 1.0, offsets }];
    if is_both {
        let offsets = shapes.iter().map(|shape| shape.top.clone().unwrap_or_default()).collect();
        sides.push(Side { name: "top wall".into(), base: config.channel.height, sign: -1.0, offsets });
    }
    Some(Walls {
        nodes: first.nodes.clone(),
        across: first.across.clone(),
        sides,
        best: search.best_epoch.min(shapes.len() - 1),
        values: search.values.clone(),
        symbol: search.figure.symbol.into(),
        ..Walls::default()
    })
}

/// The numbers of shapes by epoch, relative to their bounds.
fn course_of_shapes(summary: &Record, shapes: &[Shape]) -> Option<Chart> {
    let all = summary.rows("variables")?;
    let series = all.iter().enumerate().filter_map(|(k, one)| {
        let (low, high) = (one.get("lower")?.as_f64()?, one.get("upper")?.as_f64()?);
        let share = |shape: &Shape| shape.offsets.get(k).map(|value| (value - low) / (high - low));
        Some(Series::by_epoch(one.get("number")?.as_str()?, shapes.iter().map(share)))
    });
    let (title, y) = ("Numbers of shapes by epoch", "between the bounds: 0 lower, 1 upper");
    Some(Chart::by_epoch(title, y, series.collect()))
}

fn before_and_after(search: &Search, summary: &Record) -> Table {
    let before = summary.before();
    let mut table = Table::new("Before and after", ["", "before", "after", "change"]);
    let mut row = |name: String, b: f64, a: f64, has_change: bool| {
        let change = if has_change && b != 0.0 { percent(a / b - 1.0) } else { Cell::default() };
        // Small residuals need fewer digits.
        let cell = |x: f64| if x.abs() < 1e-3 { rounded(Cell::number(x), 4) } else { Cell::number(x) };
        table.row(name, [cell(b), cell(a), change]);
    };
    let Figure { symbol, quantity, .. } = search.figure;
    row(format!("{symbol}, {quantity}"), search.first, search.best, true);
    if let (Some(b), Some(a)) = (summary.number("q_scene_before"), summary.number("q_scene")) {
        row("Q of the same flow with the scene's own particles".into(), b, a, true);
    }
    for (key, name) in FIGURES {
        // The first row has this figure.
        if key == symbol.to_lowercase() || (key == "flow_rate" && symbol == "V") {
            continue;
        }
        if let (Some(b), Some(a)) = (before.number(key), summary.number(key)) {
            row(name.into(), b, a, !["stored_heat_rate", "energy_imbalance"].contains(&key));
        }
    }
    table.note = "In the scene's own units, averaged over the objective's window.".into();
    table
}

/// Whether the search evaluated walls by the steady state of their flow, see [`crate::scene::load::Loaded::for_search`].
pub fn is_steady(searched: &Config) -> bool {
    searched.optimise.gradient == GradientMode::Steady
}

/// The checks of a gain; none if there were none.
pub fn verification(title: &str, symbol: &str, summary: &Record, is_steady: bool) -> Option<Table> {
    let checks = summary.rows("verification")?;
    let header = ["check".into(), format!("{symbol} reference"), format!("{symbol} best"), "gain".into()];
    let mut table = Table::new(title, header);
    let name = symbol.to_lowercase();
    for check in checks {
        let figure = |key: &str| number(check, &format!("{name}_{key}")).map_or(Cell::text("-"), Cell::number);
        let failed = || Cell::text(format!("failed: {}", text(check, "error")));
        let gain = number(check, "gain").map_or_else(failed, percent);
        table.row(text(check, "check"), [figure("reference"), figure("best"), gain]);
    }
    let reference = summary.text("verification_reference").unwrap_or_default();
    let survives = summary.number("gain_survives");
    let least = survives.map_or("not known".into(), |gain| format!("{:+.2}\u{a0}%", 100.0 * gain));
    let error = summary.number("gain").zip(summary.number("gain_error")).map_or(String::new(), |(gain, error)| {
        format!(" Gain: {:+.2} \u{b1} {:.2}\u{a0}%.", 100.0 * gain, 100.0 * error)
    });
    table.note = format!(
        "Both walls again, each time with one thing changed.{error} Gain that survives its error: {least}. Reference: {reference}."
    );
    if is_steady {
        table.note.push_str(&format!(
            " The search judged walls by {symbol} of their steady flow; a check takes the mean of {symbol} over the end of a run, \
             which is not yet quite steady: so \u{201c}as optimised\u{201d} may differ a little from the headline."
        ));
    }
    Some(table)
}

/// The output of `--explain`.
fn plan(config: &Config, gradient: bool) -> anyhow::Result<Text> {
    let title = match gradient {
        true => "The plan of a step and the schedule of the gradient (as --explain prints them)",
        false => "The plan of a step (as --explain prints it)",
    };
    let plan = plan_of(config, gradient)?;
    Ok(Text { title: title.into(), text: format!("{} steps\n{plan}", config.steps()) })
}

pub fn simulate(folder: &Folder) -> anyhow::Result<Page> {
    let loaded = read_config(&folder.path)?;
    let config = &loaded.config;
    let summary = folder.record("summary.json");
    let mut page = Page { warnings: warnings(&summary), ..Page::default() };
    (page.lead, page.remark) = said(config, &folder.scene(), &summary);
    for (key, name) in [
        ("q", "outflowing heat Q"),
        ("flow_rate", "flow rate"),
        ("mean_outlet_temperature", "outlet temperature"),
        ("energy_imbalance", "energy imbalance"),
        ("kinetic_energy", "kinetic energy"),
        ("velocity_error", "velocity error"),
        ("temperature_error", "temperature error"),
        ("nusselt", "Nusselt number"),
        ("steps", "steps"),
        ("wall_seconds", "seconds"),
    ] {
        if let Some(cell) = summary.0.get(key).filter(|value| !value.is_null()).and_then(tables::cell) {
            page.facts.push(Fact::new(name, cell));
        }
    }
    page.charts = tables::charts(&folder.columns("history.csv"), |_| false);
    page.charts.extend(wall(folder));
    page.fields = series::fields(folder, &[("over time", series::lists(&folder.path))], config.resolution.dx);
    let has_fields = page.fields.is_some();
    page.pictures = folder.pictures(|stem| match stem {
        "profile" | "wall" | "error" => true,
        "temperature" | "flow" => !has_fields,
        _ => false,
    });
    if let Some(recovered) = summary.rows("recovered").filter(|all| !all.is_empty()) {
        page.tables.extend(tables::of_objects("Where the run diverged, and went on", recovered));
    }
    page.tables.extend(errors(&summary));
    page.tables.push(tables::of_scalars("Figures", &summary.0));
    page.tables
        .extend(summary.rows("shapes").and_then(|all| tables::of_objects("Shapes, in the order of the file", all)));
    if !config.is_around_shapes() {
        page.texts.push(plan(config, false)?);
    }
    Ok(page)
}

/// Figures with their errors; none if these were not asked for.
fn errors(summary: &Record) -> Option<Table> {
    let errors = summary.rows("errors").filter(|errors| !errors.is_empty())?;
    let mut table = Table::new("Errors of figures", ["figure", "value", "\u{b1}", "share"]);
    for one in errors {
        if let (Some(value), Some(error)) = (number(one, "value"), number(one, "error")) {
            // Of a figure that is zero but for its error.
            let share = match error / value.abs() {
                share if share < 1.0 => percent(share),
                _ => Cell::text("> 100\u{a0}%"),
            };
            table.row(text(one, "name"), [Cell::number(value), rounded(Cell::number(error), 2), share]);
        }
    }
    table.note = "19 of 20 are smaller, as far as coarser spacings, or the residual of the solution, show.".into();
    Some(table)
}

/// A constant wall as a chart.
fn wall(folder: &Folder) -> Option<Chart> {
    let columns = folder.columns("shape.csv");
    let top = wall_line(&columns, "top", "top");
    let bottom = wall_line(&columns, if top.is_some() { "bottom" } else { "" }, "offset")?;
    Some(wall_chart("Wall", std::iter::once(bottom).chain(top).collect()))
}

/// A wall of `shape.csv`, `side` of its columns; none if it is over x and z.
pub fn wall_line(columns: &Columns, name: &str, side: &str) -> Option<Series> {
    let (x, y) = (column(columns, "x")?, column(columns, side)?);
    column(columns, "z").is_none().then(|| Series::new(name, x.iter().copied().zip(y.iter().copied())))
}

pub fn wall_chart(title: &str, series: Vec<Series>) -> Chart {
    Chart::new(title, "x (scene units)", "offset (positive narrows)", series)
}

/// The result of a run in one sentence, and a remark.
fn said(config: &Config, scene: &str, summary: &Record) -> (String, String) {
    let number = |key: &str| summary.number(key);
    if let Some(q) = number("q") {
        let more = match (number("flow_rate"), number("mean_outlet_temperature")) {
            (Some(rate), Some(warm)) => {
                format!(": {} of fluid, mixed at a temperature of {}", short(rate), short(warm))
            }
            _ => String::new(),
        };
        let lead = format!("The flow carries out Q = {} of heat per time{more}.", figure(q));
        let remark = number("energy_imbalance").map_or(String::new(), |share| {
            format!("The heat balance is open by {:+.2}\u{a0}% of what the walls give.", 100.0 * share)
        });
        return (lead, remark);
    }
    if config.is_around_shapes() && !config.is_periodic_box() {
        let figure = |key: &str, name: &str| number(key).map(|x| format!("{name} {}", short(x)));
        let all = [
            figure("flow_rate", "flow rate"),
            figure("heat_outflow", "heat outflow"),
            figure("objective", "objective"),
        ];
        let all: Vec<String> = all.into_iter().flatten().collect();
        let particles = number("particles").unwrap_or_default();
        return (
            format!("The steady flow around the shapes: {}.", all.join(", ")),
            format!("By Newton's method, with {particles} fixed particles. In the scene's own units."),
        );
    }
    let time = short(number("time").unwrap_or_default());
    let name = if scene.is_empty() { config.scene.name() } else { scene };
    let lead = match (number("velocity_error"), number("temperature_error"), number("kinetic_energy")) {
        (Some(error), _, _) => {
            format!("{name}: the velocity is {} off the exact answer at t = {time}, in root mean square.", off(error))
        }
        (None, Some(error), _) => {
            format!("{name}: the temperature is {} off the exact answer at t = {time}.", off(error))
        }
        (None, None, Some(energy)) => format!("{name}: at t = {time} the kinetic energy is {}.", short(energy)),
        _ => format!("{name}, until t = {time}."),
    };
    (lead, "In the scene's own units.".into())
}

fn off(error: f64) -> String {
    if error < 1e-4 {
        format!("{error:.1e}")
    } else {
        format!("{:.2}\u{a0}%", 100.0 * error)
    }
}
