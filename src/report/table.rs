//! Small tables as text: aligned for the terminal, or as markdown.
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
        let widths = safe.widths(1, |cell| cell.to_owned());
        let rule = widths.iter().map(|&width| "-".repeat(width)).collect();
        let lines = [safe.headers.clone(), rule].into_iter().chain(safe.rows.iter().cloned());
        lines
            .map(|cells| {
                let padded = safe.padded(&cells, &widths);
                format!("{}\n", padded.join("  ").trim_end())
            })
            .collect()
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

    /// As markdown; vertical bars in cells are escaped.
    pub fn to_markdown(&self) -> String {
        let escape = |cell: &str| cell.replace('|', "\\|");
        let widths = self.widths(4, escape);
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| escape(cell)).collect();
            format!("| {} |\n", self.padded(&cells, &widths).join(" | "))
        };
        let rule: Vec<String> = (0..widths.len())
            .map(|column| match self.is_numeric(column) {
                true => format!("{}:", "-".repeat(widths[column] - 1)),
                false => "-".repeat(widths[column]),
            })
            .collect();
        let mut text = line(&self.headers);
        text.push_str(&format!("| {} |\n", rule.join(" | ")));
        text.extend(self.rows.iter().map(|row| line(row)));
        text
    }

    /// Width of each column in characters, at least `least`.
    fn widths(&self, least: usize, shown: impl Fn(&str) -> String) -> Vec<usize> {
        (0..self.headers.len())
            .map(|column| {
                self.rows
                    .iter()
                    .chain([&self.headers])
                    .map(|row| shown(&row[column]).chars().count())
                    .fold(least, usize::max)
            })
            .collect()
    }

    fn padded(&self, cells: &[String], widths: &[usize]) -> Vec<String> {
        cells
            .iter()
            .zip(widths)
            .enumerate()
            .map(|(column, (cell, &width))| match self.is_numeric(column) {
                true => format!("{cell:>width$}"),
                false => format!("{cell:<width$}"),
            })
            .collect()
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
