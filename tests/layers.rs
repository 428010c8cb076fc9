//! The layers of the library: every module imports only from layers below its own (see `src/lib.rs`).

use std::collections::BTreeSet;
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
        for import in imports(&std::fs::read_to_string(&path).unwrap()) {
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
