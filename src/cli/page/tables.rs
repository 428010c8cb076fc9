//! Tables of a page, from JSON and from columns.

use super::folder::{words, Columns};
use super::names::{label, rounded, sized};
use crate::report::page::{short, Cell, Chart, Series, Table};
use serde_json::{Map, Value};

/// Largest number of rows of a table on a page; the file has all.
const MOST_ROWS: usize = 400;

/// Text or number as a cell; none for other values.
pub fn cell(value: &Value) -> Option<Cell> {
    match value {
        Value::Number(number) => {
            let text = if number.is_f64() { short(number.as_f64()?) } else { number.to_string() };
            Some(Cell { value: Some(number.to_string()), ..Cell::text(text) })
        }
        Value::String(text) => Some(Cell::text(text)),
        Value::Bool(true) => Some(Cell::text("yes")),
        Value::Bool(false) => Some(Cell::text("no")),
        Value::Null => Some(Cell::text("-")),
        _ => None,
    }
}

/// Every scalar of an object. Those of nested objects are prefixed by their names.
pub fn scalars(map: &Map<String, Value>) -> Vec<(String, Cell)> {
    let mut found = Vec::new();
    for (key, value) in map {
        match value {
            Value::Object(inner) => {
                found.extend(scalars(inner).into_iter().map(|(name, cell)| (format!("{key}.{name}"), cell)));
            }
            value => found.extend(cell(value).map(|cell| (key.clone(), cell))),
        }
    }
    found
}

/// A table of names and scalars.
pub fn of_scalars(title: &str, map: &Map<String, Value>) -> Table {
    let mut table = Table::new(title, ["", ""]);
    // Unknown values are left out.
    for (name, cell) in scalars(map).into_iter().filter(|(_, cell)| cell.text != "-") {
        table.row(label(&name), [sized(&name, cell)]);
    }
    table
}

/// The columns of a table that come first, in order, and those that are left out.
#[derive(Debug, Clone, Default)]
pub struct Choice<'a> {
    pub first: Vec<&'a str>,
    pub dropped: Vec<&'a str>,
}

impl Choice<'_> {
    fn of(&self, names: Vec<String>) -> Vec<String> {
        let first = self.first.iter().map(|name| name.to_string()).filter(|name| names.contains(name));
        let rest = names.iter().filter(|name| !self.first.contains(&name.as_str())).cloned();
        first.chain(rest.filter(|name| !self.dropped.contains(&name.as_str()))).collect()
    }

    /// A cell, with fewer digits in tables with a choice of columns, which are wide.
    fn shown(&self, name: &str, cell: Cell) -> Cell {
        match self.first.is_empty() {
            true => sized(name, cell),
            false => sized(name, rounded(cell, 4)),
        }
    }

    fn note(&self, rows: usize, file: &str) -> String {
        let mut notes = Vec::new();
        if rows > MOST_ROWS {
            notes.push(format!("The first {MOST_ROWS} of {rows} rows."));
        }
        if !self.dropped.is_empty() {
            notes.push(format!("{file} has more of each row, and every digit."));
        }
        notes.join(" ")
    }
}

/// A table with objects as rows and their scalars as columns; none without scalars.
pub fn of_objects(title: &str, objects: &[Value]) -> Option<Table> {
    of_chosen(title, "", objects, Choice::default())
}

/// As [`of_objects`], for a choice of columns.
pub fn of_chosen(title: &str, file: &str, objects: &[Value], choice: Choice) -> Option<Table> {
    let rows: Vec<Vec<(String, Cell)>> = objects.iter().filter_map(Value::as_object).map(scalars).collect();
    let mut names: Vec<String> = Vec::new();
    for (name, _) in rows.iter().flatten() {
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
    // Columns without values are left out.
    let is_known = |name: &String| rows.iter().flatten().any(|(other, cell)| other == name && cell.text != "-");
    names.retain(is_known);
    let names = choice.of(names);
    if names.is_empty() {
        return None;
    }
    let mut table = Table::new(title, names.iter().map(|name| label(name)));
    let of = |row: &Vec<(String, Cell)>, name: &String| {
        let found = row.iter().find(|(other, _)| other == name);
        found.map_or_else(|| Cell::text(""), |(_, cell)| choice.shown(name, cell.clone()))
    };
    table.rows = rows.iter().take(MOST_ROWS).map(|row| names.iter().map(|name| of(row, name)).collect()).collect();
    table.note = choice.note(rows.len(), file);
    Some(table)
}

/// A table of a CSV file, with a choice of columns.
pub fn of_text(title: &str, header: &[String], rows: &[Vec<String>], choice: Choice) -> Table {
    let names = choice.of(header.to_vec());
    let mut table = Table::new(title, names.iter().map(|name| label(name)));
    let places: Vec<(&String, usize)> =
        names.iter().filter_map(|name| Some((name, header.iter().position(|other| other == name)?))).collect();
    let cell = |name: &str, text: &String| match text.parse::<f64>() {
        // Short numbers stay as written: settings are given as 3e-5.
        Ok(_) if text.len() <= 6 => {
            Cell { value: Some(text.clone()), ..Cell::text(text.strip_suffix(".0").unwrap_or(text)) }
        }
        Ok(number) => choice.shown(name, Cell { value: Some(text.clone()), ..Cell::text(short(number)) }),
        Err(_) => Cell::text(text),
    };
    let of = |row: &Vec<String>| places.iter().filter_map(|(name, k)| Some(cell(name, row.get(*k)?))).collect();
    table.rows = rows.iter().take(MOST_ROWS).map(of).collect();
    table.note = choice.note(rows.len(), "");
    table
}

/// Charts of the columns over the first one. The exact solution of a column is in its chart.
pub fn charts(columns: &Columns, log: impl Fn(&str) -> bool) -> Vec<Chart> {
    let Some(((x, at), others)) = columns.split_first() else { return vec![] };
    let find = |name: &str| others.iter().find(|(other, _)| other == name);
    let is_exact = |name: &str| name.strip_prefix("exact_").is_some_and(|of| find(of).is_some());
    let points = |values: &[f64]| at.iter().copied().zip(values.iter().copied()).collect::<Vec<_>>();
    let shown = others.iter().filter(|(name, values)| !is_exact(name) && values.iter().any(|value| value.is_finite()));
    let chart = |(name, values): &(String, Vec<f64>)| {
        let exact = find(&format!("exact_{name}")).filter(|(_, values)| values.iter().any(|value| value.is_finite()));
        let own = if exact.is_some() { "simulated" } else { "" };
        let mut series = vec![Series::new(own, points(values))];
        series.extend(exact.map(|(_, values)| Series::new("exact", points(values))));
        let y = if name.len() == 1 { name.to_uppercase() } else { label(name) };
        let across = if x == "time" { "time (scene units)" } else { x };
        Chart { log: log(name), ..Chart::new(format!("{} by {x}", words(&y)), across, y, series) }
    };
    shown.map(chart).collect()
}
