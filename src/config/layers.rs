//! Layers of configuration: texts and `key=value` settings that override a complete text. Each is first checked alone,
//! so that an error points to what the user wrote. Scenes and trainings use the same code, see [`Schema`].

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use toml_edit::{Array, Document, DocumentMut, InlineTable, Item, Table, Value};

use crate::config::before;
use crate::config::method::Method;
use crate::config::schema::{description, flatten, known_keys, value_of, values, Schema};
use crate::config::suggest;
use crate::error::BadInput;

/// An assignment `key=value`, or an option that stands for one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// What the user wrote, for messages.
    pub label: String,
    /// `key=value` or `section.key=value`. The value is TOML; a single word needs no quotes.
    pub assignment: String,
}

impl Setting {
    /// A setting from an assignment, which is its own label.
    pub fn set(assignment: &str) -> Self {
        Self { label: assignment.to_string(), assignment: assignment.to_string() }
    }

    /// A setting from an option, such as `--threads 2` for `run.threads=2`.
    pub fn option(option: &str, key: &str, value: impl std::fmt::Display) -> Self {
        Self { label: format!("{option} {value}"), assignment: format!("{key}={value}") }
    }
}

/// A key, its value, and where the user wrote it.
#[derive(Debug, Clone)]
struct Entry {
    path: String,
    value: Value,
    place: String,
    /// The element of the value that the user wrote, such as `shapes[0].radius`; none if it is the whole value.
    element: Option<String>,
    /// The key that the user wrote, if it is an old one (see [`before`]).
    before: Option<String>,
    /// Whether the entry is ignored if the chosen method has no such key.
    lenient: bool,
}

impl Entry {
    fn new(path: String, value: Value, place: String) -> Self {
        match before::today(&path) {
            None => Self { path, value, place, element: None, before: None, lenient: false },
            Some(today) => {
                let lenient = before::had_no_effect(&path, value.as_str().unwrap_or_default());
                Self { path: today, value, place, element: None, before: Some(path), lenient }
            }
        }
    }

    /// Whether the key is in the section `[method]`, whose keys depend on the method.
    fn is_of_method(&self) -> bool {
        self.path.starts_with("method.")
    }

    /// Checks that the entry alone can be read as a configuration. An old key that chooses a method is checked later.
    fn read_alone<S: Schema>(&self) -> Result<(), toml::de::Error> {
        if self.before.is_some() && self.path == "method.name" {
            return Ok(());
        }
        let keys: Vec<&str> = self.path.split('.').collect();
        toml::from_str::<S>(&document(&keys, self.value.clone()).to_string()).map(|_| ())
    }
}

/// Checked entries of one text or option.
#[derive(Debug, Clone)]
pub struct Layer {
    entries: Vec<Entry>,
}

impl Layer {
    /// Reads a whole TOML text; `name` is the file's name for messages.
    ///
    /// # Errors
    /// Invalid TOML, an unknown key, or a value of the wrong type, with file and line.
    pub fn from_text<S: Schema>(name: &str, text: &str) -> Result<Self, BadInput> {
        let spanned = Document::parse(text)
            .map_err(|error| BadInput::new(cut(&error.to_string())).place(name).advice(S::HELP))?;
        let spans: Vec<Option<Range<usize>>> =
            flatten(spanned.as_table()).iter().map(|(_, item)| item.span()).collect();
        // Values cloned from a spanned document would refer to its text; the mutable form owns them.
        let owned = spanned.into_mut();
        let found = flatten(owned.as_table());
        let entry = |((path, item), span): (&(String, &Item), &Option<Range<usize>>)| {
            let start = span.as_ref().map_or(0, |span| span.start);
            let place = format!("{name}, line {}", text[..start].matches('\n').count() + 1);
            Some(Entry::new(path.clone(), value_of(item)?, place))
        };
        let written: Vec<Entry> = found.iter().zip(&spans).filter_map(entry).collect();
        if let Err(error) = toml::from_str::<S>(text) {
            if !written.iter().any(Entry::is_of_method) {
                let at = error.span().unwrap_or_default();
                let inside = |span: &Option<Range<usize>>| span.as_ref().is_some_and(|span| span.contains(&at.start));
                let key = spans.iter().position(inside).map(|place| found[place].0.as_str());
                return Err(explain::<S>(&error, &error.to_string(), key).place(name));
            }
            // Whether keys and method are consistent is checked when all layers are known.
            for entry in &written {
                entry
                    .read_alone::<S>()
                    .map_err(|error| explain::<S>(&error, error.message(), Some(&entry.path)).place(&entry.place))?;
            }
        }
        let mut layer = Self::of_keys::<S>(written)?;
        if before::is_complete(&found.iter().map(|(path, _)| path.as_str()).collect::<Vec<_>>()) {
            layer.entries.iter_mut().for_each(|entry| entry.lenient |= entry.before.is_some());
        }
        Ok(layer)
    }

    /// Checks that each entry is a key, not a section. (Serde would also read a section from an array by position.)
    fn of_keys<S: Schema>(entries: Vec<Entry>) -> Result<Self, BadInput> {
        let known = known_keys::<S>();
        let Some(wrong) = entries.iter().find(|entry| !known.contains(&entry.path)) else {
            return Ok(Self { entries });
        };
        let path = wrong.before.as_ref().unwrap_or(&wrong.path);
        let bad = BadInput::new(format!("`{path}` is a section, not a value")).place(&wrong.place);
        Err(bad.allowed(format!("[{path}] with one line per key")))
    }

    /// Reads one assignment.
    pub fn from_setting<S: Schema>(setting: &Setting) -> Result<Self, BadInput> {
        let bad = |problem: String| BadInput::new(problem).place(&setting.label);
        let Some((path, text)) = setting.assignment.split_once('=') else {
            return Err(bad("there is no `=`".into()).allowed(S::FORM));
        };
        let keys: Vec<&str> = path.split('.').map(str::trim).collect();
        if keys.iter().any(|key| key.is_empty()) {
            return Err(bad(format!("`{path}` is not a key")).allowed(S::FORM));
        }
        let value = parse_value(text.trim()).map_err(|problem| bad(problem).allowed("a TOML value"))?;

        let entry = Entry::new(keys.join("."), value, setting.label.clone());
        entry
            .read_alone::<S>()
            .map_err(|error| explain::<S>(&error, error.message(), Some(&entry.path)).place(&setting.label))?;
        // A setting may be a section's table.
        let document = document(&keys, entry.value);
        let found = flatten(document.as_table()).into_iter();
        let entry = |(path, item)| Some(Entry::new(path, value_of(item)?, setting.label.clone()));
        Self::of_keys::<S>(found.filter_map(entry).collect())
    }

    /// The values of a configuration that differ from the defaults, with `place` as their origin.
    pub fn from_value<S: Schema>(config: &S, place: &str) -> Self {
        let usual: BTreeMap<String, String> =
            values(&S::default()).into_iter().map(|(path, value)| (path, value.to_string())).collect();
        let differs = |(path, value): &(String, Value)| usual.get(path) != Some(&value.to_string());
        let entries = values(config).into_iter().filter(differs);
        Self { entries: entries.map(|(path, value)| Entry::new(path, value, place.to_string())).collect() }
    }

    /// Changes the text of a key, such as a path relative to its file.
    pub fn change(mut self, path: &str, change: impl Fn(&str) -> String) -> Self {
        for entry in self.entries.iter_mut().filter(|entry| entry.path == path) {
            if let Some(text) = entry.value.as_str() {
                entry.value = change(text).into();
            }
        }
        self
    }

    /// Changes the value of a key, if this layer has it.
    pub fn change_value(
        &mut self,
        path: &str,
        change: impl FnOnce(&mut Value) -> Result<(), BadInput>,
    ) -> Result<(), BadInput> {
        self.entries.iter_mut().find(|entry| entry.path == path).map_or(Ok(()), |entry| change(&mut entry.value))
    }

    /// The text of a key in this layer.
    pub fn string(&self, path: &str) -> Option<&str> {
        self.entries.iter().find(|entry| entry.path == path).and_then(|entry| entry.value.as_str())
    }

    /// The keys of the layer and where each was written.
    pub fn keys(&self) -> impl Iterator<Item = (&str, &str)> {
        self.entries.iter().map(|entry| (entry.path.as_str(), entry.place.as_str()))
    }

    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    fn has(&self, path: &str) -> bool {
        self.entries.iter().any(|entry| entry.path == path)
    }
}

/// The tables that the section `[method]` of a scene may have, by method. Each has the method's keys, and those of the
/// other methods as comments.
pub type Methods = Vec<(&'static str, Table)>;

/// Layers merged into a complete text with its comments, and where each key was set.
#[derive(Debug, Clone)]
pub struct Merged {
    document: DocumentMut,
    places: BTreeMap<String, String>,
    methods: Methods,
    /// The entries of layers for the section `[method]`, in order.
    of_method: Vec<Entry>,
    /// The error in these entries, if any.
    misfit: Option<BadInput>,
}

impl Merged {
    /// Starts from a complete text, a built-in or a resolved one.
    pub fn new(text: &str) -> Self {
        Self::with_methods(text.parse().expect("a complete text is valid TOML"), vec![])
    }

    /// Starts from a complete document, in which the section `[method]` may be replaced by another of `methods`.
    pub fn with_methods(document: DocumentMut, methods: Methods) -> Self {
        Self { document, places: BTreeMap::new(), methods, of_method: vec![], misfit: None }
    }

    /// Applies a layer. Of alternative keys those of the last layer that has one remain.
    pub fn apply<S: Schema>(&mut self, layer: &Layer) {
        for (given, replaced) in S::ALTERNATIVES {
            if given.iter().any(|path| layer.has(path)) {
                let not_given = replaced.iter().filter(|path| !layer.has(path));
                not_given.for_each(|path| self.remove(path));
            }
        }
        for entry in &layer.entries {
            let (path, place) = (&entry.path, &entry.place);
            match &entry.element {
                _ if entry.is_of_method() && !self.methods.is_empty() => self.of_method.push(entry.clone()),
                Some(element) => {
                    let of_rest = self.places.get(path).unwrap_or(place).clone();
                    self.set(path, entry.value.clone(), &of_rest);
                    self.places.insert(element.clone(), place.clone());
                }
                None => {
                    self.places.retain(|old, _| !old.strip_prefix(path).is_some_and(|rest| rest.starts_with('[')));
                    self.set(path, entry.value.clone(), place);
                }
            }
        }
        self.fit_method();
    }

    /// Reads an assignment to a key, or to an element of the value that a key has: `shapes[0].radius=0.1`, `region.sides.top.kind=wall`.
    pub fn layer<S: Schema>(&self, setting: &Setting) -> Result<Layer, BadInput> {
        let (path, text) = setting.assignment.split_once('=').unwrap_or_default();
        let path = path.trim();
        let ends = [path.find('['), path.match_indices('.').nth(1).map(|(at, _)| at)];
        let Some((key, rest)) = ends.into_iter().flatten().min().map(|at| path.split_at(at)) else {
            return Layer::from_setting::<S>(setting);
        };
        let bad = |problem: String| BadInput::new(problem).place(&setting.label);
        let nothing = |rest: &str| match rest.starts_with('[') {
            true => Value::from(Array::new()),
            false => InlineTable::new().into(),
        };
        // An unknown key has its own error.
        let assignment = format!("{key}={}", nothing(rest));
        Layer::from_setting::<S>(&Setting { label: setting.label.clone(), assignment })?;
        let (section, name) = key.split_once('.').unwrap_or(("", key));
        let table = if section.is_empty() { Some(self.document.as_item()) } else { self.document.get(section) };
        let mut whole = table.and_then(|table| table.get(name)).and_then(value_of).unwrap_or_else(|| nothing(rest));
        let (mut at, mut shown) = (&mut whole, key.to_string());
        // `[0].centre[1]` has the parts `[0]`, `.centre` and `[1]`.
        let mut begins: Vec<usize> = rest.match_indices(['[', '.']).map(|(begin, _)| begin).collect();
        begins.push(rest.len());
        for (part, end) in begins.windows(2).map(|pair| (&rest[pair[0]..pair[1]], pair[1])) {
            let number = part.strip_prefix('[').and_then(|inside| inside.strip_suffix(']')?.trim().parse().ok());
            at = match (number, part.strip_prefix('.'), at) {
                (Some(number), _, Value::Array(all)) => {
                    let count = all.len();
                    let missing = format!("there is no {shown}[{number}]: {shown} has {count} entries");
                    all.get_mut(number).ok_or_else(|| bad(missing).allowed(ELEMENT))?
                }
                (_, Some(name), Value::InlineTable(table)) => table.get_or_insert(name, nothing(&rest[end..])),
                (_, _, other) => {
                    let problem = format!("`{path}`: {shown} is {}, without such a part", other.to_string().trim());
                    return Err(bad(problem).allowed(ELEMENT));
                }
            };
            shown += part;
        }
        *at = parse_value(text.trim()).map_err(|problem| bad(problem).allowed("a TOML value"))?;
        let entry = Entry { element: Some(path.into()), ..Entry::new(key.into(), whole, setting.label.clone()) };
        entry
            .read_alone::<S>()
            .map_err(|error| explain::<S>(&error, error.message(), Some(key)).place(&setting.label))?;
        Ok(Layer { entries: vec![entry] })
    }

    /// Chooses a method if none was chosen.
    pub fn choose(&mut self, method: &str, place: &str) {
        self.of_method.push(Entry::new("method.name".into(), method.into(), place.into()));
        self.fit_method();
    }

    /// Allows later layers to choose another method; keys that it lacks are then dropped.
    pub fn free_method(&mut self) {
        self.of_method.iter_mut().for_each(|entry| entry.lenient = true);
        self.fit_method();
    }

    /// Checks that the scene supports the chosen method and that the method has the given keys.
    ///
    /// # Errors
    /// The wrong key, its place, and the methods that have it.
    pub fn check_method(&self) -> Result<(), BadInput> {
        self.misfit.clone().map_or(Ok(()), Err)
    }

    /// Builds the section of the last chosen method with those given keys that it has. Values that equal the scene's do
    /// not count as given, because a complete file has them all.
    fn fit_method(&mut self) {
        let Some((own, _)) = self.methods.first().filter(|_| !self.of_method.is_empty()) else { return };
        let (mut name, mut place, mut wrong) = (own.to_string(), None, None);
        for entry in self.of_method.iter().filter(|entry| entry.path == "method.name") {
            let value = entry.value.as_str().unwrap_or_default();
            let chosen = match &entry.before {
                Some(key) => before::chosen(key, value, &name),
                None => Ok(value.to_string()),
            };
            match chosen {
                Ok(chosen) => (name, place) = (chosen, Some(entry.place.clone())),
                Err(bad) => wrong = Some(bad.place(&entry.place)),
            }
        }
        let table = self.methods.iter().find(|(method, _)| *method == name).map(|(_, table)| table.clone());
        let Some(table) = table else {
            let methods: Vec<&str> = self.methods.iter().map(|(method, _)| *method).collect();
            let bad = BadInput::new(format!("method.name = {name} can not solve this scene"))
                .place(place.unwrap_or_default());
            self.misfit = Some(bad.allowed(methods.join(", ")).advice(format!("method.name={}", methods[0])));
            return;
        };
        self.document["method"] = Item::Table(table);
        self.places.retain(|path, _| !path.starts_with("method."));
        for mut entry in self.of_method.clone() {
            let key = entry.path["method.".len()..].to_string();
            if key == "name" {
                entry.value = name.as_str().into();
            } else if !self.document["method"].as_table().is_some_and(|table| table.contains_key(&key)) {
                let usual = |(_, table): &(&str, Table)| {
                    let value = table.get(&key).and_then(Item::as_value);
                    value.is_some_and(|value| same(value, &entry.value))
                };
                if wrong.is_none() && !entry.lenient && !self.methods.iter().any(usual) {
                    let having = Method::having(&key);
                    let (first, having) = (having.first().copied().unwrap_or_default(), having.join(" or "));
                    let written = entry.before.as_ref().unwrap_or(&entry.path);
                    let bad =
                        BadInput::new(format!("{written} is a key of the method {having}, and the method is {name}"));
                    let allowed = Method::keys_of(&name).join(", ");
                    let bad = bad.place(&entry.place).allowed(format!("in [method] with name = {name}: {allowed}"));
                    wrong = Some(bad.advice(format!("method.name={first}, or leave {written} out")));
                }
                continue;
            }
            self.set(&entry.path, entry.value, &entry.place);
        }
        self.misfit = wrong;
    }

    /// Sets a key and keeps the comment above it.
    pub fn set(&mut self, path: &str, mut value: Value, place: &str) {
        let (table, key) = self.table_of(path);
        match table.get_mut(key).and_then(Item::as_value_mut) {
            Some(old) => {
                *value.decor_mut() = old.decor().clone();
                *old = value;
            }
            None => {
                value.decor_mut().clear();
                table.insert(key, Item::Value(value));
            }
        }
        self.places.insert(path.to_string(), place.to_string());
    }

    pub fn remove(&mut self, path: &str) {
        let (table, key) = self.table_of(path);
        table.remove(key);
        self.places.remove(path);
    }

    fn table_of<'a>(&mut self, path: &'a str) -> (&mut toml_edit::Table, &'a str) {
        match path.split_once('.') {
            None => (self.document.as_table_mut(), path),
            Some((section, key)) => {
                let table = self.document[section].as_table_mut();
                (table.expect("a complete text has every section"), key)
            }
        }
    }

    /// Whether a key has this text.
    pub fn is_text(&self, path: &str, text: &str) -> bool {
        let (section, key) = path.split_once('.').unwrap_or(("", path));
        self.document.get(section).and_then(|table| table.get(key)).and_then(Item::as_str) == Some(text)
    }

    /// The merged configuration, not yet checked.
    pub fn read<S: Schema>(&self) -> S {
        toml::from_str(&self.text()).expect("every layer was read alone, so their union can be read")
    }

    /// The merged configuration after checks of every number and their consistency, and then by `more`, which may use
    /// code that this module does not depend on.
    pub fn checked<S: Schema>(&self, more: impl Fn(&S) -> Result<(), BadInput>) -> Result<S, BadInput> {
        let config: S = self.read();
        let origin = config.origin();
        config.check().and_then(|()| more(&config)).map_err(|bad| {
            let text = bad.to_string();
            bad.located(|key| {
                // `shapes[0].radius` has its own place, or that of `shapes`.
                let ends = key.char_indices().filter(|(_, c)| "[.".contains(*c)).map(|(at, _)| &key[..at]);
                let own = std::iter::once(key).chain(ends.rev()).find_map(|part| self.places.get(part));
                // Of a default, a key that the message names too is to blame, or else what was given at all.
                let named = || self.places.iter().find(|(key, _)| text.contains(*key)).map(|(_, place)| place);
                let given: BTreeSet<&String> = self.places.values().collect();
                let given: Vec<&str> = given.into_iter().map(String::as_str).collect();
                Some(own.or_else(named).cloned().unwrap_or(match given.len() {
                    1..=3 => format!("{origin} with {}", given.join(", ")),
                    _ => origin.clone(),
                }))
            })
        })?;
        Ok(config)
    }

    /// The complete text with every key and the comments.
    pub fn text(&self) -> String {
        self.document.to_string()
    }

    pub fn places(&self) -> &BTreeMap<String, String> {
        &self.places
    }
}

/// The form of a key of an element, for messages.
const ELEMENT: &str = "an entry of what is given, such as shapes[0].radius or region.size[1]";

/// Whether two values are equal, in any notation.
fn same(one: &Value, other: &Value) -> bool {
    let number = |value: &Value| value.as_float().or_else(|| value.as_integer().map(|number| number as f64));
    match (number(one), number(other)) {
        (Some(one), Some(other)) => one == other,
        _ => one.clone().decorated("", "").to_string() == other.clone().decorated("", "").to_string(),
    }
}

/// A document with a single value.
fn document(keys: &[&str], value: Value) -> DocumentMut {
    let mut document = DocumentMut::new();
    let mut item: &mut Item = document.as_item_mut();
    for key in keys {
        item = &mut item[key];
    }
    *item = Item::Value(value);
    document
}

/// Parses a TOML value, a number such as `.5`, or a word without quotes.
fn parse_value(text: &str) -> Result<Value, String> {
    if let Ok(value) = text.parse::<Value>() {
        return Ok(value);
    }
    if text.is_empty() {
        return Err("there is no value after `=`".into());
    }
    if text.starts_with(['[', '{', '"', '\'']) {
        return Err(format!("`{text}` is not a complete TOML value"));
    }
    Ok(text.parse::<f64>().map_or_else(|_| Value::from(text), Value::from))
}

/// Length at which lines of a file are cut in messages.
const SHOWN: usize = 160;

/// Cuts long lines of a message.
fn cut(message: &str) -> String {
    let line = |line: &str| match line.char_indices().nth(SHOWN) {
        Some((at, _)) => format!("{} ...", &line[..at]),
        None => line.to_string(),
    };
    message.trim_end().lines().map(line).collect::<Vec<_>>().join("\n")
}

/// Converts serde's message to one for users: plain words for Rust's types, the key's description, a suggestion.
fn explain<S: Schema>(error: &toml::de::Error, text: &str, key: Option<&str>) -> BadInput {
    let mut text = cut(text);
    for (rust, plain) in [
        ("expected usize", "expected a whole number, 0 or more"),
        ("expected u64", "expected a whole number, 0 or more"),
        ("expected i64", "expected a whole number"),
        ("expected f64", "expected a number"),
        ("expected a sequence", "expected an array of numbers"),
        ("expected struct ", "expected a section, "),
    ] {
        text = text.replace(rust, plain);
    }
    let message = error.message();
    if !message.starts_with("unknown") {
        let bad = BadInput::new(text);
        return match key.and_then(|key| description::<S>(key).map(|what| format!("{key}: {what}"))) {
            Some(allowed) => bad.allowed(allowed),
            None => bad,
        };
    }
    // unknown field `given`, expected one of `a`, `b`
    let mut words = message.split('`').skip(1).step_by(2);
    let given = words.next().unwrap_or_default();
    let expected: Vec<&str> = words.collect();
    // The expected names are shown as allowed values.
    let problem = text.rsplit_once(", expected").map_or(text.as_str(), |(problem, _)| problem);
    let bad = BadInput::new(problem).allowed(expected.join(", "));
    let ends_with = format!(".{given}");
    let elsewhere = known_keys::<S>().into_iter().find(|path| path.ends_with(&ends_with));
    match (elsewhere, suggest::nearest(given, &expected)) {
        (Some(path), _) if message.starts_with("unknown field") => bad.advice(format!("`{path}`")),
        (_, Some(near)) => bad.advice(format!("`{near}`")),
        _ => bad.advice(S::HELP),
    }
}
