//! Ratios against an earlier run.

use std::collections::BTreeMap;
use std::path::Path;

use super::rows::{read_array, Row};
use crate::error::BadInput;

/// Milliseconds per step of an earlier run, by label.
pub struct Earlier {
    best: BTreeMap<String, f64>,
}

impl Earlier {
    /// Reads the bench.json of an earlier run.
    pub fn read(path: &Path) -> Result<Self, BadInput> {
        let bad = |problem: String| {
            BadInput::new(problem)
                .place(format!("--compare {}", path.display()))
                .allowed("the bench.json of an earlier `hydrograd bench`: an array of rows")
        };
        let rows = read_array(path, "row", bad, |value| {
            let row: Row = serde_json::from_value(value).map_err(|error| error.to_string())?;
            match row.ms_per_step > 0.0 {
                true => Ok(row),
                false => Err(format!("ms_per_step = {} is not above 0", row.ms_per_step)),
            }
        })?;
        if rows.is_empty() {
            return Err(bad("it has no rows".into()));
        }
        Ok(Self { best: rows.iter().map(|row| (row.label(), row.ms_per_step)).collect() })
    }

    /// New time over old; `None` if the earlier run lacks the row.
    pub fn ratio(&self, row: &Row) -> Option<f64> {
        self.best.get(&row.label()).map(|old| row.ms_per_step / old)
    }

    /// One line with the number of common rows, the geometric mean of their ratios and the largest one.
    pub fn summary(&self, rows: &[Row]) -> String {
        let ratios: Vec<(f64, String)> = rows.iter().filter_map(|row| Some((self.ratio(row)?, row.label()))).collect();
        let (old, both) = (self.best.len(), ratios.len());
        let counts = format!("{both} of {} rows are in the earlier run, which has {old}", rows.len());
        let Some((worst, label)) = ratios.iter().max_by(|a, b| a.0.total_cmp(&b.0)) else { return counts };
        let mean = (ratios.iter().map(|(ratio, _)| ratio.ln()).sum::<f64>() / both as f64).exp();
        format!("{counts}; new/old: geometric mean {mean:.3}, largest {worst:.3} ({label})")
    }
}
