//! The layers of the library: every module imports only from layers below its own (see `src/lib.rs`).

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// From the bottom up.
const LAYERS: [&str; 16] = [
    "error",
    "numerics",
    "io",
    "report",
    "config",
    "particles",
    "adjoint",
    "sph",
    "design",
    "scene",
    "dataset",
    "inverse",
    "validation",
    "surrogate",
    "cli",
    "python",
];

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => files(&path, found),
            false if path.extension().is_some_and(|e| e == "rs") => found.push(path),
            false => {}
        }
    }
}

/// The modules that `crate::` paths of a text name, comments left out.
fn imports(text: &str) -> BTreeSet<String> {
    let code: Vec<&str> = text.lines().map(|line| line.split("//").next().unwrap_or_default()).collect();
    let mut found = BTreeSet::new();
    for part in code.join("\n").split("crate::").skip(1) {
        // `crate::{a::b, c}` names several.
        match part.strip_prefix('{') {
            None => {
                found.insert(part.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default().into());
            }
            Some(group) => {
                let mut depth = 1;
                let mut name = String::new();
                for c in group.chars() {
                    match c {
                        '{' => depth += 1,
                        '}' => depth -= 1,
                        _ => {}
                    }
                    if depth == 1 && (c.is_alphanumeric() || c == '_') {
                        name.push(c);
                    } else if !name.is_empty() {
                        found.insert(std::mem::take(&mut name));
                    }
                    if depth == 0 {
                        break;
                    }
                }
            }
        }
    }
    found
}

#[test]
fn imports_go_only_downwards() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut all = Vec::new();
    files(&root, &mut all);
    assert!(all.len() > 100, "only {} files", all.len());
    let mut wrong = Vec::new();
    for path in all {
        let name = path.strip_prefix(&root).unwrap();
        let layer = name.components().next().unwrap().as_os_str().to_string_lossy().trim_end_matches(".rs").to_string();
        if layer == "lib" || layer == "main" {
            continue;
        }
        let own = LAYERS.iter().position(|l| *l == layer);
        let own = own.unwrap_or_else(|| panic!("{} belongs to no layer", name.display()));
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            !text.contains("#[test]"),
            "{}: a test that never runs, because tests belong into tests/",
            name.display()
        );
        for import in imports(&text) {
            match LAYERS.iter().position(|l| *l == import) {
                Some(other) if other > own => wrong.push(format!("{} imports {import}", name.display())),
                // Macros are at the root; everything else is a layer.
                _ => {}
            }
        }
    }
    assert!(wrong.is_empty(), "{} imports go upwards:\n{}", wrong.len(), wrong.join("\n"));
}

/// The library knows no command line: its messages name keys, and the command line makes options of them.
#[test]
fn the_library_quotes_no_option() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut all = Vec::new();
    files(&root, &mut all);
    let quotes = |line: &str| {
        let code = line.split("//").next().unwrap_or_default();
        let quoted: Vec<&str> = code.split('"').skip(1).step_by(2).collect();
        quoted
            .iter()
            .any(|text| text.split("--").skip(1).any(|rest| rest.starts_with(|c: char| c.is_ascii_lowercase())))
    };
    let mut wrong = Vec::new();
    for path in all.iter().filter(|path| !path.starts_with(root.join("cli"))) {
        for (number, line) in std::fs::read_to_string(path).unwrap().lines().enumerate() {
            if quotes(line) {
                wrong.push(format!("{}:{}: {}", path.display(), number + 1, line.trim()));
            }
        }
    }
    assert!(quotes("bad(\"--memory 20MB\")") && !quotes("// \"--memory\"") && !quotes("x -- y"));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The reader of imports itself: it must see what is there.
#[test]
fn imports_are_found() {
    let text = "use crate::sph::{a, b};\n// use crate::cli::x;\nuse crate::{io::csv::{read, write}, numerics};\nlet y = crate::design::z();";
    let found: Vec<String> = imports(text).into_iter().collect();
    assert!(["design", "io", "numerics", "sph"].iter().all(|name| found.contains(&name.to_string())), "{found:?}");
    assert!(!found.contains(&"cli".to_string()), "{found:?}");
}

/// Folders whose circles of files are still to be broken; nothing may be added here.
const ALLOWED: [&str; 0] = [];

/// Folders whose `mod.rs` is the list of what stands below it and chooses from it by name, while its traits are theirs.
const LISTS: [&str; 3] = ["cli", "design::optimisers", "scene"];

/// A word, `::`, or a sign of Rust's text.
fn tokens(text: &str) -> Vec<String> {
    let all: Vec<char> = text.chars().collect();
    let starts = |k: usize, what: &str| what.chars().enumerate().all(|(j, c)| all.get(k + j) == Some(&c));
    let (mut found, mut k) = (Vec::new(), 0);
    while k < all.len() {
        let is_word = |c: char| c.is_alphanumeric() || c == '_';
        if starts(k, "//") {
            while k < all.len() && all[k] != '\n' {
                k += 1;
            }
        } else if starts(k, "/*") {
            while k < all.len() && !starts(k, "*/") {
                k += 1;
            }
            k += 2;
        } else if all[k] == '"' {
            // Raw texts with quotes in them are rare enough to be read as two.
            let is_raw = found.last().is_some_and(|word| word == "r" || word == "br");
            k += 1;
            while k < all.len() && all[k] != '"' {
                k += if all[k] == '\\' && !is_raw { 2 } else { 1 };
            }
            k += 1;
        } else if all[k] == '\'' && (all.get(k + 2) == Some(&'\'') || all.get(k + 1) == Some(&'\\')) {
            k += if all[k + 1] == '\\' { 3 } else { 2 };
            while k < all.len() && all[k] != '\'' {
                k += 1;
            }
            k += 1;
        } else if is_word(all[k]) {
            let from = k;
            while k < all.len() && is_word(all[k]) {
                k += 1;
            }
            found.push(all[from..k].iter().collect());
        } else if starts(k, "::") {
            found.push("::".into());
            k += 2;
        } else {
            if !all[k].is_whitespace() {
                found.push(all[k].to_string());
            }
            k += 1;
        }
    }
    found
}

/// The place behind the bracket that closes the one at `open`.
fn behind(tokens: &[String], open: usize) -> usize {
    let mut depth = 0;
    for (k, token) in tokens.iter().enumerate().skip(open) {
        match token.as_str() {
            "{" | "[" => depth += 1,
            "}" | "]" => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return k + 1;
        }
    }
    tokens.len()
}

type Names = Vec<String>;

/// What a file takes by name, as words from the root of the crate on.
#[derive(Default)]
struct Source {
    /// Names that `use` brings, and what they stand for.
    aliases: BTreeMap<String, Names>,
    /// What is taken with all its names.
    globs: Vec<Names>,
    /// Everything that is named.
    paths: Vec<Names>,
    /// Names of what is defined here.
    items: BTreeSet<String>,
}

impl Source {
    /// Reads a file; `is_parent`: a `mod.rs`, which may declare and hand on what is below it.
    fn read(module: Names, text: &str, is_parent: bool) -> Self {
        let tokens = tokens(text);
        let is_child = |three: &&[String]| three[0] == "mod" && three[2] == ";";
        let children: BTreeSet<&String> = tokens.windows(3).filter(is_child).map(|three| &three[1]).collect();
        let mut source = Self::default();
        // Modules within the file, and where each ends.
        let mut inner: Vec<(String, usize)> = Vec::new();
        let mut k = 0;
        while k < tokens.len() {
            inner.retain(|(_, end)| k < *end);
            let own: Names = module.iter().cloned().chain(inner.iter().map(|(name, _)| name.clone())).collect();
            let word = tokens[k].as_str();
            let next = tokens.get(k + 1).map_or("", String::as_str);
            let defines = ["fn", "struct", "enum", "trait", "const", "static", "type", "union"];
            if defines.contains(&word) || (word == "macro_rules" && next == "!") {
                let name = tokens.get(if next == "!" { k + 2 } else { k + 1 });
                source.items.extend(name.cloned());
                k += 1;
            } else if word == "mod" && tokens.get(k + 2).is_some_and(|token| token == "{") {
                inner.push((next.to_string(), behind(&tokens, k + 2)));
                k += 3;
            } else if word == "use" {
                let end = tokens[k..].iter().position(|token| token == ";").map_or(tokens.len(), |offset| k + offset);
                let is_public = k > 0 && [")", "pub"].contains(&tokens[k - 1].as_str());
                let mut found = Vec::new();
                tree(&tokens[k + 1..end], &mut Vec::new(), &mut found);
                for (path, name) in found {
                    let Some(path) = absolute(&own, &path).or_else(|| relative(&own, &path, &children)) else {
                        continue;
                    };
                    let handed_on = is_public && is_parent && path.starts_with(&module);
                    if name == "*" {
                        // A module within the file knows what the file does.
                        let is_own = path == module || (!is_parent && path.starts_with(&module));
                        source.globs.extend((!is_own).then(|| path.clone()));
                    } else {
                        source.aliases.insert(name, path.clone());
                    }
                    if !handed_on {
                        source.paths.push(path);
                    }
                }
                k = end + 1;
            } else if word.starts_with(|c: char| c.is_alphabetic() || c == '_') {
                let mut path = vec![word.to_string()];
                while tokens.get(k + 1).is_some_and(|token| token == "::")
                    && tokens.get(k + 2).is_some_and(|token| token.starts_with(|c: char| c.is_alphabetic() || c == '_'))
                {
                    path.push(tokens[k + 2].clone());
                    k += 2;
                }
                source.paths.push(absolute(&own, &path).unwrap_or(path));
                k += 1;
            } else {
                k += 1;
            }
        }
        source
    }
}

/// `crate::`, `self::` and `super::` as words from the root on.
fn absolute(own: &Names, path: &[String]) -> Option<Names> {
    let mut from = own.clone();
    let mut k = 0;
    match path.first()?.as_str() {
        "crate" => {
            from.clear();
            from.push("crate".into());
            k = 1;
        }
        "self" => k = 1,
        "super" => {
            while path.get(k).is_some_and(|word| word == "super") {
                from.pop();
                k += 1;
            }
        }
        _ => return None,
    }
    Some(from.into_iter().chain(path[k..].iter().cloned()).collect())
}

/// What a `mod.rs` names without `self::`: its children.
fn relative(own: &Names, path: &[String], children: &BTreeSet<&String>) -> Option<Names> {
    children.contains(path.first()?).then(|| own.iter().chain(path).cloned().collect())
}

/// The paths of `a::{b, c::d as e}` and the names that they get.
fn tree(tokens: &[String], before: &mut Names, found: &mut Vec<(Names, String)>) {
    let mut path = before.clone();
    let mut k = 0;
    let mut name: Option<String> = None;
    let mut end = |path: &mut Names, name: &mut Option<String>| {
        if path.len() > before.len() || name.is_some() {
            if path.last().is_some_and(|word| word == "self") && path.len() > 1 {
                path.pop();
            }
            let last = path.last().cloned().unwrap_or_default();
            found.push((path.clone(), name.take().unwrap_or(last)));
        }
        *path = before.clone();
    };
    let mut groups = Vec::new();
    while k < tokens.len() {
        match tokens[k].as_str() {
            "," => end(&mut path, &mut name),
            "::" => {}
            "as" => {
                name = tokens.get(k + 1).cloned();
                k += 1;
            }
            "*" => {
                name = Some("*".into());
                end(&mut path, &mut name);
            }
            "{" => {
                let close = behind(tokens, k);
                groups.push((path.clone(), k + 1, close - 1));
                path = before.clone();
                k = close - 1;
            }
            word => path.push(word.to_string()),
        }
        k += 1;
    }
    end(&mut path, &mut name);
    for (mut path, from, to) in groups {
        tree(&tokens[from..to], &mut path, found);
    }
}

/// All files by module: which of the others each takes something from.
struct House {
    sources: BTreeMap<Names, Source>,
    /// Modules of a `mod.rs`.
    parents: BTreeSet<Names>,
}

impl House {
    fn new(files: &[(String, String)]) -> Self {
        let (mut sources, mut parents) = (BTreeMap::new(), BTreeSet::new());
        for (name, text) in files {
            let mut module: Names = vec!["crate".into()];
            module.extend(name.trim_end_matches(".rs").split('/').map(String::from));
            let is_parent = ["mod", "lib"].contains(&module.last().map_or("", String::as_str));
            if is_parent {
                module.pop();
                parents.insert(module.clone());
            }
            sources.insert(module.clone(), Source::read(module, text, is_parent));
        }
        Self { sources, parents }
    }

    /// The file in which something is defined.
    fn file_of(&self, path: &[String], depth: usize) -> Option<Names> {
        let mut module: Names = vec!["crate".into()];
        if path.first()? != "crate" || depth > 8 {
            return None;
        }
        for (k, word) in path.iter().enumerate().skip(1) {
            let mut below = module.clone();
            below.push(word.clone());
            if self.sources.contains_key(&below) {
                module = below;
                continue;
            }
            let source = self.sources.get(&module)?;
            if let Some(alias) = source.aliases.get(word).filter(|_| !source.items.contains(word)) {
                let rest = alias.iter().chain(&path[k + 1..]).cloned().collect::<Names>();
                return self.file_of(&rest, depth + 1);
            }
            if source.items.contains(word) {
                return Some(module);
            }
            for glob in &source.globs {
                let from: Names = glob.iter().chain(&path[k..]).cloned().collect();
                let found = self.file_of(&from, depth + 1);
                let defines = |found: &Names| self.sources[found].items.contains(word);
                if let Some(found) = found.filter(defines) {
                    return Some(found);
                }
            }
            return Some(module);
        }
        // The name of a folder alone takes nothing from its `mod.rs`.
        (!self.parents.contains(&module)).then_some(module)
    }

    fn arrows(&self) -> BTreeMap<Names, BTreeSet<Names>> {
        let mut all = BTreeMap::new();
        for (module, source) in self.sources.iter().filter(|(module, _)| module.len() > 1) {
            let mut of = BTreeSet::new();
            let is_list = LISTS.contains(&module[1..].join("::").as_str());
            for path in &source.paths {
                let whole = match (path[0].as_str(), source.aliases.get(&path[0])) {
                    ("crate", _) => path.clone(),
                    (_, Some(alias)) => alias.iter().chain(&path[1..]).cloned().collect(),
                    _ if path.len() > 1 => module.iter().chain(path).cloned().collect(),
                    _ => continue,
                };
                let file = self.file_of(&whole, 0).filter(|file| file != module && file.len() > 1);
                of.extend(file.filter(|file| !(is_list && file.starts_with(module))));
            }
            all.insert(module.clone(), of);
        }
        all
    }

    /// Files that reach each other, and the arrows between them.
    fn circles(&self) -> Vec<BTreeSet<Names>> {
        let arrows = self.arrows();
        let reached = |from: &Names| {
            let (mut seen, mut left) = (BTreeSet::new(), vec![from]);
            while let Some(file) = left.pop() {
                for next in arrows.get(file).into_iter().flatten() {
                    if seen.insert(next.clone()) {
                        left.push(next);
                    }
                }
            }
            seen
        };
        let all: BTreeMap<&Names, BTreeSet<Names>> = arrows.keys().map(|file| (file, reached(file))).collect();
        let mut circles: Vec<BTreeSet<Names>> = Vec::new();
        for (file, seen) in &all {
            if seen.contains(*file) && !circles.iter().any(|circle| circle.contains(*file)) {
                let back = |other: &&Names| all.get(other).is_some_and(|of| of.contains(*file));
                circles.push(seen.iter().filter(back).cloned().collect());
            }
        }
        circles
    }
}

/// Files of `src` take from each other in one direction, inside a folder too.
#[test]
fn no_files_import_each_other_in_a_circle() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut all = Vec::new();
    files(&root, &mut all);
    let name = |path: &Path| path.strip_prefix(&root).unwrap().to_string_lossy().into_owned();
    let texts: Vec<(String, String)> =
        all.iter().map(|path| (name(path), std::fs::read_to_string(path).unwrap())).collect();
    let house = House::new(&texts);
    let arrows = house.arrows();
    assert!(arrows.values().map(BTreeSet::len).sum::<usize>() > 1000, "too few arrows between files");
    let mut wrong = Vec::new();
    for circle in house.circles() {
        let is_allowed = |file: &Names| ALLOWED.contains(&file[1].as_str());
        if circle.iter().all(is_allowed) {
            continue;
        }
        wrong.push(format!("{} files:", circle.len()));
        for file in &circle {
            let others: Vec<String> = arrows[file].intersection(&circle).map(|other| other[1..].join("::")).collect();
            wrong.push(format!("  {} takes from {}", file[1..].join("::"), others.join(", ")));
        }
    }
    assert!(wrong.is_empty(), "circles of files:\n{}", wrong.join("\n"));
}

/// The reader of circles itself: what it must see, and what is none.
#[test]
fn circles_are_found() {
    let circles = |files: &[(&str, &str)]| -> Vec<String> {
        let files: Vec<(String, String)> =
            files.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect();
        let named =
            |circle: BTreeSet<Names>| circle.iter().map(|file| file[1..].join("::")).collect::<Vec<_>>().join(" ");
        House::new(&files).circles().into_iter().map(named).collect()
    };
    // By `super`, in a group, through what a parent hands on, and by a path in the code.
    let parent = ("a/mod.rs", "mod b; mod c;\npub use c::Thing;\n");
    assert_eq!(
        circles(&[
            parent,
            ("a/b.rs", "use super::Thing;\npub struct Other;"),
            ("a/c.rs", "use super::{b, d};\npub struct Thing(b::Other);")
        ]),
        ["a::b a::c"]
    );
    assert_eq!(
        circles(&[parent, ("a/b.rs", "fn f() { crate::a::c::g() }"), ("a/c.rs", "pub fn g() { super::b::f() }")]),
        ["a::b a::c"]
    );
    // What a parent defines itself is taken from it.
    let parent_with_code = ("a/mod.rs", "mod b;\npub struct Here;\npub fn f() { b::g() }");
    assert_eq!(circles(&[parent_with_code, ("a/b.rs", "use super::Here;\npub fn g() {}")]), ["a a::b"]);
    // Comments, texts, and a parent that only hands on make none.
    for text in ["// use super::b::X;", "const T: &str = \"super::b::X\";"] {
        let files = [
            ("a/mod.rs", "mod b;\nmod c;\npub use b::X;"),
            ("a/b.rs", "use super::c;\npub struct X;"),
            ("a/c.rs", text),
        ];
        assert!(circles(&files).is_empty(), "{text}");
    }
}
