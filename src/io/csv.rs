//! Tables as comma-separated text: one header line, then rows; numbers survive the round trip bit for bit.
//!
//! Lines are split here and not by the crate `csv` (1.4), because an error names its line: behind blank lines that crate
//! gives the number of another line, and a quote that is not closed takes all lines behind it into one cell.

use super::atomic::write_atomically;
use super::FileError;
use std::io::Write;
use std::path::Path;

#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Written with as few digits as bring the same f64 back.
    Number(f64),
    Integer(i64),
    Text(String),
}

impl From<f64> for Cell {
    fn from(value: f64) -> Self {
        Self::Number(value)
    }
}

impl From<usize> for Cell {
    fn from(value: usize) -> Self {
        // No table of ours counts beyond 2^63.
        Self::Integer(i64::try_from(value).unwrap_or(i64::MAX))
    }
}

impl From<&str> for Cell {
    fn from(value: &str) -> Self {
        Self::Text(value.to_owned())
    }
}

impl std::fmt::Display for Cell {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            // Debug, not Display: 1e-300 instead of three hundred zeros.
            Self::Number(value) => write!(formatter, "{value:?}"),
            Self::Integer(value) => write!(formatter, "{value}"),
            Self::Text(text) => formatter.write_str(&quoted(text)),
        }
    }
}

/// Writes a table atomically.
///
/// # Errors
/// [`FileError::Input`] if a row has not as many cells as the header, else system errors.
pub fn write_table(path: &Path, header: &[&str], rows: &[Vec<Cell>]) -> Result<(), FileError> {
    if let Some((index, row)) = rows.iter().enumerate().find(|(_, row)| row.len() != header.len()) {
        let problem = format!("row {} has {} cells", index + 1, row.len());
        return Err(FileError::input(path, problem, format!("{} cells, as in the header", header.len())));
    }
    write_atomically(path, |writer| {
        let names: Vec<String> = header.iter().map(|name| quoted(name)).collect();
        let rows = rows.iter().map(|row| row.iter().map(Cell::to_string).collect());
        std::iter::once(names).chain(rows).try_for_each(|cells: Vec<String>| writeln!(writer, "{}", cells.join(",")))
    })
}

pub fn write_rows(path: &Path, header: &[&str], rows: &[Vec<f64>]) -> Result<(), FileError> {
    let rows: Vec<Vec<Cell>> = rows.iter().map(|row| row.iter().map(|&x| Cell::from(x)).collect()).collect();
    write_table(path, header, &rows)
}

/// Writes columns of equal length as a table, atomically.
///
/// # Errors
/// [`FileError::Input`] if the lengths differ, else system errors.
pub fn write_columns(path: &Path, columns: &[(&str, &[f64])]) -> Result<(), FileError> {
    let length = columns.first().map_or(0, |(_, values)| values.len());
    if let Some((name, values)) = columns.iter().find(|(_, values)| values.len() != length) {
        let problem = format!("column `{name}` has {} values", values.len());
        return Err(FileError::input(path, problem, format!("{length} values, as in the first column")));
    }
    let header: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    let rows: Vec<Vec<Cell>> =
        (0..length).map(|row| columns.iter().map(|(_, values)| Cell::Number(values[row])).collect()).collect();
    write_table(path, &header, &rows)
}

/// Reads the named columns of a table, in the order asked for; other columns are ignored. Blank lines and lines
/// that start with `#` are skipped.
///
/// # Errors
/// Names file, line, column and value: missing or doubled column, a row of the wrong length, text that is no
/// number, NaN or infinity, a file without header or rows.
pub fn read_columns(path: &Path, names: &[&str]) -> Result<Vec<Vec<f64>>, FileError> {
    let text = read_text(path)?;
    let mut lines = lines(&text);
    let (_, header_line) = lines.next().ok_or_else(|| damaged(path, "it is empty".to_owned()))?;
    let header = split_line(header_line);
    let positions = names.iter().map(|name| column_position(path, &header, name));
    let positions = positions.collect::<Result<Vec<usize>, FileError>>()?;
    let mut columns = vec![Vec::new(); names.len()];
    for (line, content) in lines {
        let cells = split_line(content);
        if cells.len() != header.len() {
            return Err(FileError::Mismatch {
                path: path.to_owned(),
                name: format!("line {line}"),
                found: format!("{} cells (`{content}`)", cells.len()),
                allowed: format!("{} cells, as in the header", header.len()),
                hint: "add the missing cells, or write decimal points instead of commas",
            });
        }
        for ((column, &position), name) in columns.iter_mut().zip(&positions).zip(names) {
            column.push(parse_cell(path, line, name, &cells[position])?);
        }
    }
    if columns.first().is_some_and(Vec::is_empty) {
        return Err(damaged(path, "it has a header but no rows".to_owned()));
    }
    Ok(columns)
}

/// Names of columns, and rows of as many cells.
pub type TextTable = (Vec<String>, Vec<Vec<String>>);

/// Reads a table as it stands: the names of its columns, and its rows as text.
///
/// # Errors
/// A file that cannot be read or has no header. Rows of another length than the header are left out.
pub fn read_table(path: &Path) -> Result<TextTable, FileError> {
    let text = read_text(path)?;
    let mut rows = lines(&text).map(|(_, line)| split_line(line));
    let header = rows.next().ok_or_else(|| damaged(path, "it is empty".to_owned()))?;
    let rows = rows.filter(|row| row.len() == header.len()).collect();
    Ok((header, rows))
}

fn damaged(path: &Path, what: String) -> FileError {
    FileError::Damaged {
        path: path.to_owned(),
        format: "CSV table",
        what,
        hint: "give a text file with a header line and rows of numbers",
    }
}

fn read_text(path: &Path) -> Result<String, FileError> {
    let bytes = std::fs::read(path).map_err(|source| FileError::read(path, source))?;
    String::from_utf8(bytes).map_err(|error| damaged(path, format!("not UTF-8 text ({error})")))
}

/// Lines that say something, with their numbers from 1.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    // Spreadsheets put a byte-order mark in front.
    text.trim_start_matches('\u{feff}')
        .lines()
        .enumerate()
        .map(|(index, line)| (index + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// Where `name` stands in the header.
fn column_position(path: &Path, header: &[String], name: &str) -> Result<usize, FileError> {
    let mut matches = (0..header.len()).filter(|&index| header[index] == name);
    match (matches.next(), matches.next()) {
        (Some(position), None) => Ok(position),
        (Some(_), Some(_)) => Err(FileError::Mismatch {
            path: path.to_owned(),
            name: name.to_owned(),
            found: "the name of two columns".to_owned(),
            allowed: "the name of one column".to_owned(),
            hint: "rename one of them",
        }),
        (None, _) => Err(FileError::Missing {
            path: path.to_owned(),
            kind: "column",
            name: name.to_owned(),
            present: header.to_vec(),
            hint: "the first line must name the columns, separated by commas (not semicolons or tabs)",
        }),
    }
}

/// A finite number, or an error that says where it is not one.
fn parse_cell(path: &Path, line: usize, column: &str, value: &str) -> Result<f64, FileError> {
    let error = |what| FileError::Cell {
        path: path.to_owned(),
        line,
        column: column.to_owned(),
        value: value.to_owned(),
        what,
    };
    match value.parse::<f64>() {
        Ok(number) if number.is_nan() => Err(error("not a number (NaN)")),
        Ok(number) if number.is_infinite() => Err(error("infinite")),
        Ok(number) => Ok(number),
        Err(_) if value.is_empty() => Err(error("empty")),
        Err(_) => Err(error("not a number")),
    }
}

/// Quotes text that holds a separator, a quote or a line break (RFC 4180). Line breaks become spaces, because
/// the reader goes line by line.
fn quoted(text: &str) -> String {
    let text = text.replace(['\n', '\r'], " ");
    if text.contains([',', '"']) || text.starts_with('#') {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text
    }
}

/// Cells of one line, quotes undone, outer spaces removed.
fn split_line(line: &str) -> Vec<String> {
    let mut cells = vec![String::new()];
    let mut in_quotes = false;
    let mut characters = line.chars().peekable();
    while let Some(character) = characters.next() {
        let last = cells.len() - 1;
        match character {
            '"' if in_quotes && characters.peek() == Some(&'"') => {
                characters.next();
                cells[last].push('"');
            }
            '"' => in_quotes = !in_quotes,
            ',' if !in_quotes => cells.push(String::new()),
            other => cells[last].push(other),
        }
    }
    cells.iter().map(|cell| cell.trim().to_owned()).collect()
}
