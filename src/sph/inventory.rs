//! Descriptions of what a step computes, reads and leaves out, for [`super::plan`].

use serde::Serialize;

/// An operator of a step. Its bytes are an estimate in which each input row, output row and list entry is transferred
/// once; `bytes_gathered` is what pairs read from their neighbours, mostly from the cache.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Operator {
    pub name: &'static str,
    pub does: Vec<String>,
    /// Number of particles that it computes.
    pub rows: usize,
    /// Number of directed pairs that it sums over.
    pub pairs: usize,
    pub bytes_read: usize,
    pub bytes_written: usize,
    pub bytes_gathered: usize,
}

impl Operator {
    pub fn new(
        name: &'static str,
        does: Vec<String>,
        [rows, pairs]: [usize; 2],
        [bytes_read, bytes_written, bytes_gathered]: [usize; 3],
    ) -> Self {
        Self { name, does, rows, pairs, bytes_read, bytes_written, bytes_gathered }
    }

    /// The check whether a neighbour list is still valid, in these many dimensions.
    pub fn neighbours<R>(particles: usize, dimension: usize) -> Self {
        let does = words(&[(true, "largest move since the list was built; a new list at half the skin")]);
        Self::new("neighbours", does, [particles, 0], [2 * dimension * particles * std::mem::size_of::<R>(), 0, 0])
    }
}

/// Those words that are wanted.
pub fn words(parts: &[(bool, &str)]) -> Vec<String> {
    parts.iter().filter(|(wanted, _)| *wanted).map(|(_, text)| text.to_string()).collect()
}

/// A packed tensor `[rows, N]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Field {
    pub name: &'static str,
    pub rows: Vec<String>,
    pub bytes: usize,
}

impl Field {
    /// A field of type R with these rows.
    pub fn of<R>(name: &'static str, rows: Vec<String>, particles: usize) -> Self {
        Self { name, bytes: rows.len() * particles * std::mem::size_of::<R>(), rows }
    }
}

/// Something that is left out because the scene does not need it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dropped {
    pub what: String,
    pub why: String,
}

pub fn dropped(what: impl Into<String>, why: impl Into<String>) -> Dropped {
    Dropped { what: what.into(), why: why.into() }
}
