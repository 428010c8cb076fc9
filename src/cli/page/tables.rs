//! Tables of a page from JSON and from columns.

use super::folder::{words, Columns};
use crate::report::page::{short, Cell, Chart, Series, Table};
use serde_json::{Map, Value};

/// Rows of a table that a page shows at once; more are in the file.
const MOST_ROWS: usize = 400;

/// Text or number as a cell; nothing for what is neither.
pub fn cell(value: &Value) -> Option<Cell> {
    match value {
        Value::Number(number) => match number.as_f64() {
            Some(_) if number.is_u64() || number.is_i64() => {
                Some(Cell { text: number.to_string(), value: Some(number.to_string()), ..Cell::default() })
            }
            Some(float) => Some(Cell { text: short(float), value: Some(number.to_string()), ..Cell::default() }),
            None => None,
        },
        Value::String(text) => Some(Cell::text(text)),
        Value::Bool(true) => Some(Cell::text("yes")),
        Value::Bool(false) => Some(Cell::text("no")),
        Value::Null => Some(Cell::text("-")),
        _ => None,
    }
}

/// Every single figure of an object, those of objects in it behind their name.
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

/// Names and figures, one below the other.
pub fn of_scalars(title: &str, map: &Map<String, Value>) -> Table {
    let mut table = Table::new(title, ["", ""]);
    // What is unknown is no figure.
    let known = scalars(map).into_iter().filter(|(_, cell)| cell.text != "-");
    table.rows = known.map(|(name, cell)| vec![Cell::text(name), cell]).collect();
    table
}

/// Objects as rows, their single figures as columns; none if nothing of them is one.
pub fn of_objects(title: &str, objects: &[Value]) -> Option<Table> {
    let rows: Vec<Vec<(String, Cell)>> = objects.iter().filter_map(Value::as_object).map(scalars).collect();
    let mut header: Vec<String> = Vec::new();
    for (name, _) in rows.iter().flatten() {
        if !header.contains(name) {
            header.push(name.clone());
        }
    }
    if header.is_empty() {
        return None;
    }
    let mut table = Table::new(title, header.iter().map(|name| name.replace('_', " ")));
    let of = |row: &Vec<(String, Cell)>, name: &String| {
        row.iter().find(|(other, _)| other == name).map_or_else(|| Cell::text(""), |(_, cell)| cell.clone())
    };
    table.rows = rows.iter().take(MOST_ROWS).map(|row| header.iter().map(|name| of(row, name)).collect()).collect();
    if rows.len() > MOST_ROWS {
        table.note = format!("The first {MOST_ROWS} of {} rows.", rows.len());
    }
    Some(table)
}

/// A CSV file as it is.
pub fn of_text(title: &str, header: &[String], rows: &[Vec<String>]) -> Table {
    let mut table = Table::new(title, header.iter().map(|name| name.replace('_', " ")));
    let cell = |text: &String| match text.parse::<f64>() {
        Ok(number) => Cell { text: short(number), value: Some(text.clone()), ..Cell::default() },
        Err(_) => Cell::text(text),
    };
    table.rows = rows.iter().take(MOST_ROWS).map(|row| row.iter().map(cell).collect()).collect();
    if rows.len() > MOST_ROWS {
        table.note = format!("The first {MOST_ROWS} of {} rows.", rows.len());
    }
    table
}

/// What a series of points over the first column is, of columns that a chart has beside each other: the exact answer of a
/// column stands with it.
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
        let y = if name.len() == 1 { name.to_uppercase() } else { name.replace('_', " ") };
        Chart { title: format!("{} by {x}", words(&y)), x: x.clone(), y, log: log(name), series, ..Chart::default() }
    };
    shown.map(chart).collect()
}
