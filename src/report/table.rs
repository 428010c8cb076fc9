//! Small tables as text, aligned for the terminal.
//!
//! Crates such as `comfy-table` would only take over the padding of cells, twenty lines: which columns are numbers, what
//! may be shown on a terminal, and the table as JSON would stay here.

use super::text::shown;

/// A table of text cells; columns that hold only numbers are aligned to the right.
#[derive(Clone, Debug, Default)]
pub struct Table {
    headers: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    pub fn new<S: Into<String>>(headers: impl IntoIterator<Item = S>) -> Self {
        Self { headers: headers.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row; missing cells stay empty, cells beyond the headers are dropped.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) -> &mut Self {
        let mut row: Vec<String> = cells.into_iter().map(Into::into).collect();
        row.resize(self.headers.len(), String::new());
        self.rows.push(row);
        self
    }

    /// For the terminal: headers, a rule, rows; two spaces between columns, no spaces at line ends.
    pub fn to_text(&self) -> String {
        let safe = |cells: &Vec<String>| cells.iter().map(|cell| shown(cell)).collect::<Vec<_>>();
        let safe = Self { headers: safe(&self.headers), rows: self.rows.iter().map(safe).collect() };
        let all = || [&safe.headers].into_iter().chain(&safe.rows);
        let width = |column: usize| all().map(|cells| cells[column].chars().count()).fold(1, usize::max);
        let columns: Vec<_> = (0..safe.headers.len()).map(|column| (width(column), safe.is_numeric(column))).collect();
        let padded = |(cell, &(width, is_numeric)): (&String, &(usize, bool))| match is_numeric {
            true => format!("{cell:>width$}"),
            false => format!("{cell:<width$}"),
        };
        let line = |cells: &Vec<String>| {
            let cells: Vec<String> = cells.iter().zip(&columns).map(padded).collect();
            format!("{}\n", cells.join("  ").trim_end())
        };
        let rule = columns.iter().map(|&(width, _)| "-".repeat(width)).collect();
        [&safe.headers, &rule].into_iter().chain(&safe.rows).map(line).collect()
    }

    /// A list of objects, a row each: numbers where a cell is one.
    pub fn to_json(&self) -> serde_json::Value {
        let cell = |text: &String| match text.parse::<f64>() {
            Ok(number) if number.is_finite() => serde_json::from_str(text).unwrap_or_else(|_| number.into()),
            _ => serde_json::Value::from(text.as_str()),
        };
        let row = |cells: &Vec<String>| -> serde_json::Value {
            self.headers.iter().zip(cells).map(|(header, text)| (header.clone(), cell(text))).collect()
        };
        self.rows.iter().map(row).collect()
    }

    /// True if the column has numbers (units and percent signs may follow) and else only blanks or dashes.
    fn is_numeric(&self, column: usize) -> bool {
        let cells = || self.rows.iter().map(|row| row[column].trim());
        let number = |cell: &str| {
            let first = cell.split_whitespace().next().unwrap_or_default();
            first.trim_end_matches(['%', 'x']).parse::<f64>().is_ok()
        };
        cells().any(number) && cells().all(|cell| number(cell) || ["", "-"].contains(&cell))
    }
}

impl std::fmt::Display for Table {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.to_text())
    }
}
