//! Pages that a browser opens from disk: one file each, which asks for nothing outside of itself.
//!
//! The templates stand beside this file: `base.html` is what all pages have in common, `run.html` and `compare.html` fill it,
//! `page.css` and `page.js` go into each page. Everything that is text is escaped where it is put in; numbers for the script
//! are JSON in an element of their own.

mod particles;

pub use particles::{Fields, Quantity, RawFrame, RawPanel};

use crate::error::Error;
use crate::io::atomic::write_bytes_atomically;
use crate::report::text::{shown, shown_within};
use crate::report::VERSION;
use base64::Engine;
use minijinja::syntax::SyntaxConfig;
use minijinja::value::Serde;
use minijinja::{context, escape_formatter, AutoEscape, Environment, HtmlEscape, Value};
use serde::Serialize;
use std::path::Path;

/// The name of a run's page in its folder.
pub const PAGE: &str = "report.html";

/// What every page of ours says of its maker, and by which a file is known to be one.
pub const GENERATOR: &str = "<meta name=\"generator\" content=\"hydrograd ";

/// Characters of a line of a text that is quoted whole, at most.
const LONGEST_LINE: usize = 20_000;

/// Which template fills the page.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Body {
    /// One run.
    #[default]
    Run,
    /// Several of one kind.
    Compare,
}

/// Everything that a page shows; what is empty is left out.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Page {
    #[serde(skip)]
    pub body: Body,
    pub title: String,
    /// What made it: a command, and a scene or what else it was given.
    pub subtitle: String,
    /// The result, in one sentence.
    pub lead: String,
    /// What the result means, or how sure it is.
    pub remark: String,
    pub facts: Vec<Fact>,
    pub warnings: Vec<Note>,
    pub walls: Option<Walls>,
    pub charts: Vec<Chart>,
    pub fields: Option<Fields>,
    pub tables: Vec<Table>,
    pub pictures: Vec<Picture>,
    /// Tables that most readers do not need.
    pub more: Vec<Table>,
    pub texts: Vec<Text>,
    pub files: Vec<File>,
}

/// A number in large letters.
#[derive(Debug, Clone, Serialize)]
pub struct Fact {
    pub name: String,
    pub cell: Cell,
}

impl Fact {
    pub fn new(name: &str, cell: Cell) -> Self {
        Self { name: name.into(), cell }
    }
}

/// Something that a reader should know, and what to do.
#[derive(Debug, Clone, Serialize)]
pub struct Note {
    pub problem: String,
    pub advice: String,
}

/// A text, and the number that it stands for.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Cell {
    pub text: String,
    /// With every digit.
    pub value: Option<String>,
    /// Whether it is to be found at a glance.
    pub is_marked: bool,
    pub link: Option<String>,
}

impl Cell {
    pub fn text(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// A number as it is shown, and as it is.
    pub fn shown(text: impl Into<String>, value: f64) -> Self {
        Self { text: text.into(), value: Some(format!("{value:?}")), ..Self::default() }
    }

    /// A number with six digits.
    pub fn number(value: f64) -> Self {
        Self::shown(short(value), value)
    }

    /// The number that it stands for.
    pub fn number_shown(&self) -> Option<f64> {
        self.value.as_ref()?.parse().ok()
    }
}

/// A number with at most six digits that count.
pub fn short(value: f64) -> String {
    let size = value.abs();
    match value {
        _ if value.is_nan() => "-".into(),
        _ if value == 0.0 => "0".into(),
        _ if value.fract() == 0.0 && size < 1e9 => format!("{value}"),
        _ if !(1e-4..1e6).contains(&size) => format!("{value:.4e}"),
        _ => {
            let digits = (5 - size.log10().floor() as i32).max(0) as usize;
            let text = format!("{value:.digits$}");
            match text.contains('.') {
                true => text.trim_end_matches('0').trim_end_matches('.').to_string(),
                false => text,
            }
        }
    }
}

/// A table; its first column names the rows.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Table {
    pub title: String,
    pub note: String,
    pub header: Vec<String>,
    pub rows: Vec<Vec<Cell>>,
    /// What each column holds, found when the page is made.
    pub columns: Vec<Column>,
}

/// What a column of a table holds, by which it is aligned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Column {
    /// Numbers, to the right.
    Numbers,
    /// Words, to the left.
    Text,
    /// Words with lines to be broken.
    Words,
}

impl Table {
    /// What its columns hold: most of a column's cells say it, so that all of them are aligned alike.
    pub fn found_columns(&self) -> Vec<Column> {
        const LONG: usize = 28;
        let of = |k: usize| {
            let cells = || {
                self.rows.iter().filter_map(|row| row.get(k)).filter(|cell| !["", "-"].contains(&cell.text.as_str()))
            };
            let texts = || cells().filter(|cell| cell.value.is_none());
            match 2 * texts().count() > cells().count() {
                true if texts().any(|cell| cell.text.chars().count() > LONG) => Column::Words,
                true => Column::Text,
                false => Column::Numbers,
            }
        };
        (0..self.header.len()).map(of).collect()
    }

    pub fn new<T: Into<String>>(title: &str, header: impl IntoIterator<Item = T>) -> Self {
        let header = header.into_iter().map(Into::into).collect();
        Self { title: title.into(), header, ..Self::default() }
    }

    pub fn row(&mut self, name: impl Into<String>, cells: impl IntoIterator<Item = Cell>) {
        self.rows.push(std::iter::once(Cell::text(name)).chain(cells).collect());
    }
}

/// Lines over numbers, drawn by the page's script.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Chart {
    pub title: String,
    pub x: String,
    pub y: String,
    /// Whether y has a logarithmic axis.
    pub log: bool,
    /// Whether x is the epoch of the walls' slider.
    pub by_epoch: bool,
    pub series: Vec<Series>,
}

impl Chart {
    pub fn new(title: impl Into<String>, x: &str, y: impl Into<String>, series: Vec<Series>) -> Self {
        Self { title: title.into(), x: x.into(), y: y.into(), series, ..Self::default() }
    }

    /// Over the epochs of a search.
    pub fn by_epoch(title: impl Into<String>, y: impl Into<String>, series: Vec<Series>) -> Self {
        Self { by_epoch: true, ..Self::new(title, "epoch", y, series) }
    }
}

/// A line of a chart; no number: a gap.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Series {
    pub name: String,
    pub points: Vec<(f64, Option<f64>)>,
}

impl Series {
    pub fn new(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let points = points.into_iter().map(|(x, y)| (x, y.is_finite().then_some(y))).collect();
        Self { name: name.into(), points }
    }

    /// Values by epoch, counted from one as on the screen.
    pub fn by_epoch(name: impl Into<String>, values: impl IntoIterator<Item = Option<f64>>) -> Self {
        Self { name: name.into(), points: (1..).map(f64::from).zip(values).collect() }
    }
}

/// Walls by epoch, or one after the other, for a slider.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Walls {
    pub nodes: Vec<f64>,
    /// z of the nodes, of walls over x and z.
    pub across: Option<Vec<f64>>,
    pub sides: Vec<Side>,
    /// What each is called, where they are not those of epochs: then none of them is the best, and there are no values.
    pub names: Vec<String>,
    /// Counted from zero.
    pub best: usize,
    /// What was to be made large, by epoch; none where a wall was rejected.
    pub values: Vec<Option<f64>>,
    pub symbol: String,
}

#[derive(Debug, Clone, Default, Serialize)]
pub struct Side {
    pub name: String,
    /// Height of the wall that is not shaped, and what an offset of 1 adds to it.
    pub base: f64,
    pub sign: f64,
    /// By epoch (or one after the other), of each node.
    pub offsets: Vec<Vec<f64>>,
}

/// A drawing that is part of the page.
#[derive(Debug, Clone, Serialize)]
pub struct Picture {
    pub title: String,
    /// Of the file beside the page.
    pub file: String,
    /// Where it is, as an address relative to the page.
    pub link: String,
    /// `data:` and the picture.
    pub source: String,
}

impl Picture {
    /// From the text of an SVG file.
    pub fn svg(title: impl Into<String>, file: impl Into<String>, svg: &[u8]) -> Self {
        let encoded = base64::engine::general_purpose::STANDARD.encode(svg);
        let file = file.into();
        let link = link(&file);
        Self { title: title.into(), file, link, source: format!("data:image/svg+xml;base64,{encoded}") }
    }
}

/// A text as a terminal would show it.
#[derive(Debug, Clone, Serialize)]
pub struct Text {
    pub title: String,
    pub text: String,
}

/// A file beside the page.
#[derive(Debug, Clone, Serialize)]
pub struct File {
    pub name: String,
    /// Where it is, as an address relative to the page.
    pub link: String,
    pub size: String,
    pub what: String,
}

/// A path as part of an address: what has a meaning there is written as `%` and two digits.
pub fn link(path: &str) -> String {
    let keeps = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~/".contains(&byte);
    let of = |byte: u8| if keeps(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    path.bytes().map(of).collect()
}

const TEMPLATES: [(&str, &str); 6] = [
    ("base.html", include_str!("base.html")),
    ("run.html", include_str!("run.html")),
    ("compare.html", include_str!("compare.html")),
    ("parts.html", include_str!("parts.html")),
    ("page.css", include_str!("page.css")),
    ("page.js", include_str!("page.js")),
];

/// What the page's script draws.
#[derive(Serialize)]
struct Data<'a> {
    walls: Option<&'a Walls>,
    charts: &'a [Chart],
    fields: Option<&'a Fields>,
}

impl Page {
    pub fn to_html(&self) -> Result<String, Error> {
        // A template that does not fit is a bug.
        let failed =
            |error: minijinja::Error| Error::run(format!("the page could not be made: {error:#}"), "report this");
        let mut environment = Environment::new();
        // The two that are no HTML hold nothing that is put in.
        environment.set_auto_escape_callback(|_| AutoEscape::Html);
        let syntax = SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build().map_err(failed)?;
        environment.set_syntax(syntax);
        // What comes from files may be anything.
        environment.set_formatter(|out, state, value| match value.as_str().filter(|_| !value.is_safe()) {
            Some(text) => escape_formatter(out, state, &Value::from(shown(text))),
            None => escape_formatter(out, state, value),
        });
        environment.add_filter("whole", |text: &str| {
            let text = shown_within(&text.replace('\t', "    "), LONGEST_LINE);
            Value::from_safe_string(HtmlEscape(&text).to_string())
        });
        for (name, text) in TEMPLATES {
            environment.add_template(name, text).map_err(failed)?;
        }
        let body = match self.body {
            Body::Run => "run.html",
            Body::Compare => "compare.html",
        };
        let data = Data { walls: self.walls.as_ref(), charts: &self.charts, fields: self.fields.as_ref() };
        let aligned = |tables: &[Table]| {
            let tables = tables.iter().map(|table| Table { columns: table.found_columns(), ..table.clone() });
            Value::from(Serde(tables.collect::<Vec<_>>()))
        };
        let (page, data) = (Value::from(Serde(self)), Value::from(Serde(data)));
        let (tables, more, version) = (aligned(&self.tables), aligned(&self.more), VERSION);
        let template = environment.get_template(body).map_err(failed)?;
        template.render(context! { page, tables, more, data, version }).map_err(failed)
    }

    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        Ok(write_bytes_atomically(path, self.to_html()?.as_bytes())?)
    }
}
