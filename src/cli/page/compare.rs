//! `hydrograd compare`: several runs of a kind on one page, and the page of a folder whose run has several parts.

use super::designs::{is_steady, verification, wall_chart, wall_line};
use super::folder::{figure, percent, Folder};
use super::names::{label, sized};
use super::tables;
use crate::cli::arguments::check_text;
use crate::cli::files::read_config;
use crate::cli::guard::warn;
use crate::cli::machine;
use crate::cli::run_folder::{is_finished, kind_of};
use crate::design::objectives::Figure;
use crate::error::BadInput;
use crate::report::page::{link, Body, Cell, Chart, Page, Series, Table, GENERATOR, PAGE};
use crate::report::text::shown;
use crate::scene::record::{Record, Search, FIGURES};
use clap::Args;
use serde_json::{json, Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Put several runs of a command side by side in one page.
///
/// Their figures, what differs in their configurations, their curves over each other and, of optimize, their best walls.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd compare runs/optimize-heated-channel runs/optimize-heated-channel-2
      two searches
  hydrograd compare runs/starts/flat runs/starts/sine runs/starts/random --out starts.html
      some of the starts of `hydrograd optimize --start all --out runs/starts`")]
pub struct CompareArguments {
    /// Folders of two or more finished runs of one command.
    #[arg(value_name = "DIR", required = true, num_args = 1..)]
    pub folders: Vec<PathBuf>,
    /// The page; an earlier page of this kind is replaced.
    #[arg(long, value_name = "FILE", default_value = "runs/compare.html")]
    pub out: PathBuf,
}

/// Largest number of runs on a page; more lines could not be told apart.
const MOST: usize = 12;

pub fn run(arguments: CompareArguments) -> anyhow::Result<()> {
    let out = &arguments.out;
    check_out(out)?;
    let mut runs = arguments.runs()?;
    let base = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(base).map_err(|source| crate::io::FileError::write(base, source))?;
    let mut page = beside(&mut runs, base, None)?;
    page.title = format!("{} runs of {}", runs.len(), runs[0].folder.kind);
    page.subtitle = runs.iter().map(|run| run.name.as_str()).collect::<Vec<_>>().join(", ");
    page.warnings = runs.iter().flat_map(|run| run.folder.damage()).collect();
    page.warnings.iter().for_each(|note| warn(&note.problem, &note.advice));
    page.write(out)?;
    println!("{}", page.lead);
    println!("page: {}", out.display());
    let of_run = |run: &Compared| json!({ "name": run.name, "folder": machine::path(&run.folder.path), "figures": run.folder.json("summary.json") });
    machine::answer(&json!({
        "page": machine::path(out),
        "command": runs[0].folder.kind,
        "lead": page.lead,
        "runs": runs.iter().map(of_run).collect::<Vec<_>>(),
    }));
    Ok(())
}

struct Compared {
    /// The name that distinguishes it from the others.
    name: String,
    folder: Folder,
    summary: Record,
    /// Of a search that has found something.
    search: Option<Search>,
}

impl Compared {
    fn new(name: String, folder: Folder) -> Self {
        Self { name, folder, summary: Record::default(), search: None }
    }

    fn read(&mut self) -> anyhow::Result<()> {
        self.summary = self.folder.record("summary.json");
        if self.folder.kind == "optimize" {
            self.search = self.summary.search(Figure::of_config(&read_config(&self.folder.path)?.config));
        }
        Ok(())
    }
}

impl CompareArguments {
    fn runs(&self) -> Result<Vec<Compared>, BadInput> {
        let folders = &self.folders;
        let given = |path: &Path| path.display().to_string();
        let allowed = "folders of two or more finished runs of one command";
        if folders.len() < 2 {
            return Err(BadInput::new("one run has nothing to be compared with")
                .place(given(&folders[0]))
                .allowed(allowed)
                .advice(format!("another folder, or open {}", folders[0].join(PAGE).display())));
        }
        if folders.len() > MOST {
            return Err(BadInput::new(format!("{} runs are too many to be told apart", folders.len()))
                .allowed(format!("2 to {MOST} folders")));
        }
        let mut runs = Vec::new();
        for path in folders {
            let bad = |problem: &str| BadInput::new(problem).place(given(path)).allowed(allowed);
            if !path.is_dir() {
                return Err(bad("there is no such folder"));
            }
            let Some(kind) = kind_of(path) else {
                return Err(
                    bad("the folder holds no run of hydrograd").advice("the folder that a command named with --out")
                );
            };
            let folder = Folder::new(path, &kind);
            let has_figures = MAIN.iter().any(|file| folder.has(file));
            if !has_figures {
                let state = if is_finished(path) { "it has no figures to compare" } else { "the run is not finished" };
                return Err(bad(&format!("{state}: none of {}", MAIN.join(", ")))
                    .advice(format!("hydrograd {kind} --resume {}", path.display())));
            }
            runs.push(Compared::new(shown(&folder.name()), folder));
        }
        let first = &runs[0].folder.kind;
        if let Some(other) = runs.iter().find(|run| run.folder.kind != *first) {
            let (one, two, kind) = (given(&runs[0].folder.path), given(&other.folder.path), &other.folder.kind);
            return Err(BadInput::new(format!(
                "runs of different commands: {one} is of `hydrograd {first}`, {two} of `hydrograd {kind}`"
            ))
            .place(given(&other.folder.path))
            .allowed("runs of one command")
            .advice(format!("only those of `hydrograd {first}`")));
        }
        let symbols: Vec<Option<&str>> = runs.iter().map(|run| objective(&run.folder)).collect();
        if let Some(k) = symbols.iter().position(|symbol| *symbol != symbols[0]) {
            let name = |k: usize| format!("{} of {}", symbols[k].unwrap_or("nothing"), given(&runs[k].folder.path));
            return Err(BadInput::new(format!("searches for different objectives: {} and {}", name(0), name(k)))
                .place(given(&runs[k].folder.path))
                .allowed("searches with the same objective.kind"));
        }
        // Folders with the same name are distinguished by their paths.
        let names: Vec<String> = runs.iter().map(|run| run.name.clone()).collect();
        for run in &mut runs {
            if names.iter().filter(|name| **name == run.name).count() > 1 {
                run.name = given(&run.folder.path);
            }
        }
        Ok(runs)
    }
}

/// The symbol of a search's objective; none for other runs.
fn objective(folder: &Folder) -> Option<&'static str> {
    let config = read_config(&folder.path).ok().filter(|_| folder.kind == "optimize")?.config;
    Some(Figure::of_config(&config).symbol)
}

/// Files with a run's figures.
const MAIN: [&str; 7] = [
    "summary.json",
    "evaluation.json",
    "validation.json",
    "gradient_check.json",
    "stress.json",
    "validation.csv",
    "verification.json",
];

/// Returns an error if a file exists that is not a page of ours.
fn check_out(out: &Path) -> Result<(), BadInput> {
    check_text(out)?;
    let bad = |problem: &str| {
        BadInput::new(problem)
            .place(format!("--out {}", out.display()))
            .allowed("a new file, or an earlier page of hydrograd's")
            .advice("--out runs/compare.html")
    };
    if out.is_dir() {
        return Err(bad("it is a folder"));
    }
    match std::fs::read(out) {
        Ok(bytes) if !String::from_utf8_lossy(&bytes).contains(GENERATOR) => Err(bad("it is a file of something else")),
        _ => Ok(()),
    }
}

/// The page of a folder with one run in each subfolder.
pub fn parts(folder: &Folder) -> anyhow::Result<Page> {
    let parts = folder.parts("optimize").into_iter();
    let mut runs: Vec<Compared> = parts.map(|part| Compared::new(part.name(), part)).collect();
    let summary = folder.record("summary.json");
    let mut page = beside(&mut runs, &folder.path, Some(&summary))?;
    if let Some(run) = runs.first() {
        let loaded = read_config(&run.folder.path)?;
        let symbol = Figure::of_config(&loaded.config).symbol;
        let title = "Does the gain of the best hold?";
        page.tables.extend(verification(title, symbol, &summary, is_steady(&loaded.for_search()?.config)));
    }
    let rows: Vec<Value> = summary
        .0
        .iter()
        .filter_map(|(key, value)| {
            let mut row = Map::new();
            row.insert("way".into(), key.strip_prefix("compared: ")?.into());
            row.extend(value.as_object()?.clone());
            Some(Value::Object(row))
        })
        .collect();
    page.tables.extend(tables::of_objects("Ways to search", &rows));
    page.pictures = folder.pictures(|stem| ["compare", "horizons"].contains(&stem));
    Ok(page)
}

/// Keys of a file, those of nested tables behind their names and dots, and their values.
type Values = BTreeMap<String, String>;

/// Sections of a configuration, and keys, that say what the problem is: what flows where, what drives it, what is held.
const OF_PROBLEM: [&str; 7] =
    ["scene", "fluid.", "channel.", "region.", "heat.", "wall.hot_temperature", "objective.kind"];
/// Keys there that say how it is solved.
const OF_SOLUTION: [&str; 3] = ["fluid.reference_velocity", "fluid.sound_speed_factor", "channel.wall_rows"];

/// The problem of a run: figures of runs of different problems must not be ranked.
fn problem(folder: &Folder) -> Values {
    let mut found = flat(&folder.config());
    found.retain(|key, _| OF_PROBLEM.iter().any(|of| key.starts_with(of)) && !OF_SOLUTION.contains(&key.as_str()));
    if let Some(scores) = evaluation(folder) {
        found.extend(["data", "split"].map(|key| (key.to_string(), scores[key].to_string())));
        found.insert("steps of a rollout".into(), scores["scores"][0]["steps"].to_string());
    }
    found
}

/// The scores of the models of a run.
fn evaluation(folder: &Folder) -> Option<Value> {
    let text = std::fs::read_to_string(folder.path.join("evaluation.json")).ok()?;
    serde_json::from_str(&text).ok()
}

/// The keys of [`problem`] whose values differ between runs.
fn unlike(runs: &[Compared]) -> Vec<String> {
    let problems: Vec<Values> = runs.iter().map(|run| problem(&run.folder)).collect();
    let found: Vec<String> = differing(&problems).into_iter().map(|(key, _)| key.to_string()).collect();
    // Different scenes differ in further keys.
    match found.iter().any(|key| key == "scene") {
        true => vec!["scene".into()],
        false => found,
    }
}

/// The keys whose values are not the same in all of them, and these values.
fn differing(all: &[Values]) -> Vec<(&str, Vec<Option<&str>>)> {
    let keys: BTreeSet<&String> = all.iter().flat_map(BTreeMap::keys).collect();
    let of = |key| all.iter().map(|values| values.get(key).map(String::as_str)).collect::<Vec<_>>();
    let found = keys.into_iter().map(|key| (key.as_str(), of(key)));
    found.filter(|(_, values)| values.iter().any(|value| *value != values[0])).collect()
}

/// Runs of one kind side by side. `together` has their common figures, if they are parts of one run. Links are relative
/// to the folder `base`.
fn beside(runs: &mut [Compared], base: &Path, together: Option<&Record>) -> anyhow::Result<Page> {
    let mut page = Page { body: Body::Compare, ..Page::default() };
    runs.iter_mut().try_for_each(Compared::read)?;
    // Only one part was checked, against the flat wall.
    let verified = together.and_then(|all| Some((all.text("verified_start")?, all.0.get("gain_survives")?)));
    if let Some((name, gain)) = verified {
        let checked = runs.iter_mut().filter(|run| run.name == name).filter_map(|run| run.search.as_mut());
        checked.for_each(|search| search.survives = gain.as_f64());
    }
    let runs = &*runs;
    let unlike = unlike(runs);
    let header = || std::iter::once(String::new()).chain(runs.iter().map(|run| run.name.clone()));
    let flat = together.and_then(|_| runs.iter().find(|run| run.name == "flat")?.search.as_ref());
    let flat = flat.map(|search| search.first);
    page.lead = lead(runs, &unlike, flat);
    if !unlike.is_empty() {
        page.remark = format!("Not the same in all of them: {}. So none is the best.", unlike.join(", "));
    }
    let mut table = Table::new("Figures side by side", header());
    let page_of = |run: &Compared| page_link(&run.folder, base);
    let pages = runs.iter().map(|run| match page_of(run) {
        Some(link) => Cell { link: Some(link), ..Cell::text("page") },
        None => Cell::text("-"),
    });
    table.row("the run's own page", pages);
    let searches: Vec<&Search> = runs.iter().filter_map(|run| run.search.as_ref()).collect();
    if !searches.is_empty() && searches.len() == runs.len() {
        add_searches(&mut table, &searches, unlike.is_empty(), flat);
        page.charts.push(over_epochs(runs, &searches));
        page.charts.extend(best_walls(runs));
    } else {
        page.charts.extend(histories(runs));
    }
    let mut rest = Table::new("All other figures", header());
    add_figures([&mut table, &mut rest], runs);
    page.tables.push(table);
    page.tables.extend(differences(runs, header().collect()));
    page.more.extend((!rest.rows.is_empty()).then_some(rest));
    Ok(page)
}

/// The address of a run's page relative to the folder `base`; none if it has no page.
fn page_link(folder: &Folder, base: &Path) -> Option<String> {
    let (base, page) = (base.canonicalize().ok()?, folder.path.canonicalize().ok()?.join(PAGE));
    let common = base.components().zip(page.components()).take_while(|(a, b)| a == b).count();
    let up = base.components().skip(common).map(|_| "..".to_string());
    let down = page.components().skip(common).map(|part| part.as_os_str().to_string_lossy().into_owned());
    if !page.is_file() {
        return None;
    }
    Some(link(&up.chain(down).collect::<Vec<_>>().join("/")))
}

fn lead(runs: &[Compared], unlike: &[String], flat: Option<f64>) -> String {
    let kind = runs.first().map_or("", |run| run.folder.kind.as_str());
    let plain = format!("{} runs of hydrograd {kind} side by side", runs.len());
    if !unlike.is_empty() {
        return format!("{plain}: of different problems, not to be ranked.");
    }
    let searches = runs.iter().filter_map(|run| Some((&run.name, run.search.as_ref()?)));
    if let Some((name, search)) = searches.max_by(|a, b| a.1.best.total_cmp(&b.1.best)) {
        // Each started with another wall; all are compared with the flat one, if it is among them.
        let (gain, over) = match flat {
            Some(flat) => (search.best / flat - 1.0, "the flat wall"),
            None => (search.gain(), "its own start"),
        };
        let (all, symbol, best, gain) = (runs.len(), search.figure.symbol, figure(search.best), 100.0 * gain);
        return format!("Best of {all} searches: {name}, with {symbol} = {best} ({gain:+.2}\u{a0}% over {over}).");
    }
    let named = |of: &dyn Fn(&Compared) -> Option<f64>| -> Option<Vec<(&String, f64)>> {
        runs.iter().map(|run| Some((&run.name, of(run)?))).collect()
    };
    let most = named(&|run| run.summary.number("q")).and_then(|all| all.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)));
    if let Some((name, q)) = most {
        return format!("Of {} runs {name} carries out the most heat: Q = {}.", runs.len(), figure(q));
    }
    // Of the evaluated model, which is the first one with scores.
    let error = |run: &Compared| evaluation(&run.folder)?["scores"][0]["mse"].as_f64();
    let least = named(&error).and_then(|all| all.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)));
    if let Some((name, mse)) = least {
        return format!("Of {} models that of {name} has the least position error: MSE {mse:.2e}.", runs.len());
    }
    format!("{plain}.")
}

/// Rows of the results of searches, with the best marked if they have one problem.
fn add_searches(table: &mut Table, searches: &[&Search], is_ranked: bool, flat: Option<f64>) {
    let Some(symbol) = searches.first().map(|search| search.figure.symbol) else { return };
    let mut row = |name: String, cells: Vec<(Cell, Option<f64>)>, has_best: bool| {
        let best = cells.iter().filter_map(|(_, value)| *value).reduce(f64::max).filter(|_| has_best && is_ranked);
        let is_best = |value: Option<f64>| value.is_some() && value == best;
        table.row(name, cells.into_iter().map(|(cell, value)| Cell { is_marked: is_best(value), ..cell }));
    };
    let numbers = |of: fn(&Search) -> f64| {
        searches.iter().map(|search| (Cell::shown(figure(of(search)), of(search)), Some(of(search)))).collect()
    };
    row(format!("{symbol} of the first design"), numbers(|search| search.first), false);
    row(format!("{symbol} of the best"), numbers(|search| search.best), true);
    let gains = |of: &dyn Fn(&Search) -> f64| searches.iter().map(|search| (percent(of(search)), None)).collect();
    if let Some(flat) = flat {
        row("gain over the flat wall".into(), gains(&|search| search.best / flat - 1.0), false);
    }
    // Not marked: the worst start has the largest gain.
    row("gain over its own first design".into(), gains(&Search::gain), false);
    if searches.iter().any(|search| search.survives.is_some()) {
        let survives = |search: &&Search| (search.survives.map_or(Cell::text("not checked"), percent), None);
        row("gain that survives the checks".into(), searches.iter().map(survives).collect(), false);
    }
    let count = |value: usize| (Cell::number(value as f64), None);
    row("epochs".into(), searches.iter().map(|search| count(search.values.len())).collect(), false);
    row("best epoch".into(), searches.iter().map(|search| count(search.best_epoch.saturating_add(1))).collect(), false);
}

/// Figures that come first, after [`FIGURES`].
const FIRST: [&str; 9] = [
    "kinetic_energy",
    "exact_kinetic_energy",
    "velocity_error",
    "temperature_error",
    "nusselt",
    "particles",
    "steps",
    "wall_seconds",
    "peak_memory_bytes",
];
/// Figures of a search that are already shown under other names.
const SAID: [&str; 4] = ["q", "q_first", "best_epoch", "gain_survives"];

/// Rows of the figures in the runs' files: the most important ones, and the rest.
fn add_figures([table, rest]: [&mut Table; 2], runs: &[Compared]) {
    let mut all: Vec<Vec<(String, Cell)>> = Vec::new();
    for run in runs {
        let mut found = tables::scalars(&run.summary.0);
        if run.summary.0.is_empty() {
            for file in MAIN.iter().filter(|file| file.ends_with(".json")) {
                if let Some(map) = run.folder.json(file) {
                    found.extend(tables::scalars(&map));
                    let models = map.get("scores").and_then(Value::as_array).into_iter().flatten();
                    for (k, model) in models.filter_map(Value::as_object).enumerate() {
                        // The first model is the evaluated one, whatever its file's name; the others are baselines.
                        let own = model.get("model").and_then(Value::as_str).filter(|_| k > 0);
                        let name = own.unwrap_or("model");
                        let scores = tables::scalars(model).into_iter().filter(|(key, _)| key != "model");
                        found.extend(scores.map(|(key, cell)| (format!("{name}: {key}"), cell)));
                    }
                }
            }
            // The last row of a training's validation.
            for (column, values) in run.folder.columns("validation.csv") {
                let last = values.iter().rev().copied().find(|value| value.is_finite());
                found.extend(last.map(|last| (column, Cell::number(last))));
            }
        }
        all.push(found);
    }
    let mut names: Vec<String> = Vec::new();
    let known = FIGURES.iter().map(|(key, _)| *key).chain(FIRST).map(str::to_string);
    let others = all.iter().flatten().map(|(name, _)| name.clone());
    // Figures of the first design are in the files; they are rarely needed here.
    for name in known.chain(others).filter(|name| !name.starts_with("before.")) {
        // Figures that no run has are left out.
        let is_known = |(other, cell): &(String, Cell)| *other == name && cell.text != "-";
        if !names.contains(&name) && all.iter().flatten().any(is_known) {
            names.push(name);
        }
    }
    let is_search = runs.iter().all(|run| run.folder.kind == "optimize");
    for name in names.into_iter().filter(|name| !(is_search && SAID.contains(&name.as_str()))) {
        let of = |found: &Vec<(String, Cell)>| {
            let cell = found.iter().find(|(other, _)| *other == name).map(|(_, cell)| cell.clone());
            cell.map_or_else(|| Cell::text("-"), |cell| sized(&name, cell))
        };
        let is_first = FIGURES.iter().any(|(key, _)| *key == name) || FIRST.contains(&name.as_str());
        let has_place = is_first || runs.iter().all(|run| run.summary.0.is_empty());
        let into = if has_place { &mut *table } else { &mut *rest };
        into.row(label(&name), all.iter().map(of));
    }
}

/// Keys of `config.toml` whose values differ between runs; none for commands without this file.
fn differences(runs: &[Compared], header: Vec<String>) -> Option<Table> {
    if !runs.iter().any(|run| run.folder.has("config.toml")) {
        return None;
    }
    let mut table = Table::new("What differs in their configurations", header);
    let all: Vec<Values> = runs.iter().map(|run| flat(&run.folder.config())).collect();
    for (key, values) in differing(&all) {
        table.row(key, values.into_iter().map(|value| Cell::text(value.map_or("-", shortened))));
    }
    if table.rows.is_empty() {
        table.header.clear();
        table.note = "Nothing: their files config.toml say the same.".into();
    }
    Some(table)
}

/// Long lists are cut; the files have them in full.
fn shortened(value: &str) -> &str {
    const LONGEST: usize = 60;
    match value.char_indices().nth(LONGEST) {
        Some((end, _)) => value[..end].rsplit_once(',').map_or(&value[..end], |(kept, _)| kept),
        None => value,
    }
}

fn flat(table: &toml::Table) -> Values {
    let mut found = Values::new();
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) => {
                found.extend(flat(inner).into_iter().map(|(name, value)| (format!("{key}.{name}"), value)));
            }
            value => drop(found.insert(key.clone(), value.to_string())),
        }
    }
    found
}

/// The objective by epoch.
fn over_epochs(runs: &[Compared], searches: &[&Search]) -> Chart {
    let figure = searches[0].figure;
    let lines = runs.iter().zip(searches);
    let series = lines.map(|(run, search)| Series::by_epoch(&run.name, search.values.iter().copied())).collect();
    let title = format!("{}, {}, by epoch", figure.symbol, figure.quantity);
    Chart::by_epoch(title, format!("{} ({})", figure.symbol, figure.unit), series)
}

/// The best walls in one chart; those over x and z are on their own pages.
fn best_walls(runs: &[Compared]) -> Vec<Chart> {
    let mut charts = Vec::new();
    for (side, title) in [("offset", "Best walls"), ("top", "Best top walls")] {
        let mut series = Vec::new();
        for run in runs {
            let columns = run.folder.columns("shape.csv");
            // A series without points keeps the colours of the runs the same in every chart.
            series.push(wall_line(&columns, &run.name, side).unwrap_or_else(|| Series::new(&run.name, [])));
        }
        if series.iter().any(|line: &Series| !line.points.is_empty()) {
            charts.push(wall_chart(title, series));
        }
    }
    charts
}

/// A chart for each column of the runs' histories, with a line for each run.
fn histories(runs: &[Compared]) -> Vec<Chart> {
    let mut charts: Vec<Chart> = Vec::new();
    for file in ["history.csv", "validation.csv"] {
        for run in runs {
            let columns = run.folder.columns(file);
            let falls = |name: &str| name.contains("mse") || name == "loss";
            for chart in tables::charts(&columns, falls) {
                let line = chart.series.into_iter().next().map(|line| Series { name: run.name.clone(), ..line });
                let chart = Chart { series: vec![], ..chart };
                match charts.iter_mut().find(|other| other.title == chart.title && other.x == chart.x) {
                    Some(other) => other.series.extend(line),
                    None => charts.push(Chart { series: line.into_iter().collect(), ..chart }),
                }
            }
        }
    }
    charts
}
