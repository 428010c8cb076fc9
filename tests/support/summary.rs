//! The fields of `summary.json`, as `data/summary.toml` and the page say, and whether a run has them.

use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What is said of a field.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Field {
    /// The kinds of runs that have it, with blanks between them.
    #[serde(rename = "in")]
    pub kinds: String,
    pub unit: String,
    /// When these runs have it; without this they always do.
    pub when: Option<String>,
    pub what: String,
}

impl Field {
    pub fn is_in(&self, kind: &str) -> bool {
        self.kinds.split(' ').any(|other| other == kind)
    }
}

/// The fields of `data/summary.toml`.
pub fn known() -> BTreeMap<String, Field> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/summary.toml");
    let groups: BTreeMap<String, BTreeMap<String, Field>> =
        toml::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
    let count: usize = groups.values().map(BTreeMap::len).sum();
    let fields: BTreeMap<String, Field> = groups.into_values().flatten().collect();
    assert_eq!(fields.len(), count, "a field is in two groups");
    fields
}

/// The name of a field under the objective heat outflow: names of a search begin with the symbol of its objective.
fn of_heat(name: &str) -> String {
    let (list, name) = name.split_once("[].").map_or((None, name), |(list, name)| (Some(list), name));
    let ends = [
        "",
        "_first",
        "_per_epoch",
        "_predicted_per_epoch",
        "_solver_per_epoch",
        "_reference",
        "_best",
        "_error",
        "_error_parts",
    ];
    let own = ["t", "w", "v"].iter().find_map(|symbol| name.strip_prefix(symbol)).filter(|rest| ends.contains(rest));
    let name = own.map_or_else(|| name.to_string(), |rest| format!("q{rest}"));
    list.map_or(name.clone(), |list| format!("{list}[].{name}"))
}

/// The names of the fields of a file, those of lists of objects too. An object with names of this page, such as `before`, is
/// left out; see [`inner`].
fn names(summary: &Map<String, Value>) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (name, value) in summary {
        let name = if name.starts_with("compared: ") { "compared" } else { name };
        match value {
            Value::Object(fields) if name == "compared" => {
                found.extend(fields.keys().map(|field| format!("{name}.{field}")));
            }
            Value::Array(rows) => {
                let fields = rows.iter().filter_map(Value::as_object).flat_map(Map::keys);
                found.extend(fields.map(|field| of_heat(&format!("{name}[].{field}"))));
                found.insert(of_heat(name));
            }
            _ => drop(found.insert(of_heat(name))),
        }
    }
    found
}

/// The runs within a file: those of a search's first design, of the solver, of every start or way to search.
fn inner(summary: &Map<String, Value>) -> impl Iterator<Item = (&String, &Map<String, Value>)> {
    let objects = summary.iter().filter_map(|(name, value)| Some((name, value.as_object()?)));
    objects.filter(|(name, _)| !name.contains([':', '.']) && !name.ends_with("_parts"))
}

/// Checks the file of a run: it has no field that is not known, and all that such runs always have. Returns its fields.
#[track_caller]
pub fn check(kind: &str, summary: &Value) -> BTreeSet<String> {
    let (known, summary) = (known(), summary.as_object().unwrap());
    let has_parts = ["starts", "compare"].contains(&kind);
    let mut found = names(summary);
    for (name, part) in inner(summary) {
        if has_parts {
            found.remove(name);
            check("walls", &Value::Object(part.clone()));
        } else {
            found.extend(names(part));
        }
    }
    for name in &found {
        let field = known.get(name).unwrap_or_else(|| panic!("{kind}: data/summary.toml does not know {name}"));
        assert!(field.is_in(kind), "{kind}: data/summary.toml says that {name} is in the files of {}", field.kinds);
    }
    for (name, _) in known.iter().filter(|(_, field)| field.is_in(kind) && field.when.is_none()) {
        assert!(found.contains(name), "{kind}: the file has no {name}");
    }
    found
}
