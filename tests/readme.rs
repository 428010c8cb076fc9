//! The pages: their links lead somewhere, their commands and keys exist, their figures have a script.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::Parser;
use hydrograd::cli::{Cli, Command};
use hydrograd::config::scene::Config;
use hydrograd::config::schema::known_keys;
use hydrograd::config::training::Settings;

/// Most lines of the first page.
const MOST_LINES: usize = 150;

/// A page and its text.
struct Page {
    path: PathBuf,
    text: String,
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// All markdown of the repository, without what a run or a build leaves.
fn pages() -> Vec<Page> {
    let mut folders: Vec<PathBuf> =
        ["src", "tests", "scripts", "models", "data", ".github"].map(|name| root().join(name)).to_vec();
    let mut paths = vec![root().join("README.md")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                folders.push(entry);
            } else if entry.extension().is_some_and(|extension| extension == "md") {
                paths.push(entry);
            }
        }
    }
    let page = |path: PathBuf| Page { text: std::fs::read_to_string(&path).unwrap(), path };
    paths.into_iter().map(page).collect()
}

impl Page {
    fn name(&self) -> String {
        self.path.strip_prefix(root()).unwrap().display().to_string()
    }

    /// Lines in fenced blocks and lines outside of them.
    fn parts(&self) -> (Vec<&str>, Vec<&str>) {
        let (mut inside, mut outside, mut fenced) = (vec![], vec![], false);
        for line in self.text.lines() {
            match line.trim_start().starts_with("```") {
                true => fenced = !fenced,
                false if fenced => inside.push(line),
                false => outside.push(line),
            }
        }
        assert!(!fenced, "{}: a fenced block does not end", self.name());
        (inside, outside)
    }

    /// Texts between single backticks; a bar is escaped in tables.
    fn quoted(&self) -> Vec<String> {
        let outside = self.parts().1.join("\n");
        outside.split('`').skip(1).step_by(2).map(|text| text.replace("\\|", "|").replace('\n', " ")).collect()
    }

    /// Targets of links and pictures.
    fn links(&self) -> Vec<String> {
        let outside = self.parts().1.join("\n");
        let after = outside.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
        after.map(|(target, _)| target.to_string()).collect()
    }
}

/// The name by which a link finds a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Words of a command line as a shell makes them, up to a comment, a redirection or another command.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote, mut open) = (vec![], String::new(), None, false);
    for c in line.chars().chain([' ']) {
        match (c, quote) {
            (c, Some(q)) if c == q => quote = None,
            ('"' | '\'', None) => (quote, open) = (Some(c), true),
            (' ', None) => {
                if open {
                    words.push(std::mem::take(&mut word));
                }
                open = false;
            }
            (c, _) => {
                word.push(c);
                open = true;
            }
        }
    }
    let end = words.iter().position(|word| word.starts_with('#') || [">", "&&", "|", ";"].contains(&word.as_str()));
    words.truncate(end.unwrap_or(words.len()));
    words
}

/// What is wrong with a command line of hydrograd, if anything. A line in running text may leave required options out.
fn problem(line: &str, whole: bool) -> Option<String> {
    let error = match Cli::try_parse_from(words(line)) {
        // The command in a job is one, too.
        Ok(Cli { command: Command::Slurm(job), .. }) => {
            return problem(&format!("hydrograd {}", job.command.join(" ")), whole)
        }
        parsed => parsed.err()?,
    };
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => None,
        ErrorKind::MissingRequiredArgument | ErrorKind::MissingSubcommand if !whole => None,
        _ => Some(error.to_string()),
    }
}

#[test]
fn the_first_page_is_short() {
    let lines = std::fs::read_to_string(root().join("README.md")).unwrap().lines().count();
    assert!(lines <= MOST_LINES, "README.md has {lines} lines, more than {MOST_LINES}");
}

#[test]
fn the_version_is_the_same_everywhere() {
    let version = env!("CARGO_PKG_VERSION");
    let places = [
        ("README.md", format!("version = {{{version}}}")),
        (".github/CITATION.cff", format!("\nversion: {version}\n")),
        (".github/CONTRIBUTING.md", format!("`v{version}`")),
    ];
    for (name, text) in places {
        let page = std::fs::read_to_string(root().join(name)).unwrap();
        assert!(page.contains(&text), "{name} has no {text:?}");
    }
    // The newest version of the change log is the first one.
    let log = std::fs::read_to_string(root().join("src/cli/CHANGES.md")).unwrap();
    let newest = log.lines().find_map(|line| line.strip_prefix("## ")).unwrap();
    assert_eq!(newest.split(' ').next(), Some(version));
}

#[test]
fn links_lead_somewhere() {
    let mut seen = 0;
    for page in pages() {
        for link in page.links().into_iter().filter(|link| !link.contains("://")) {
            let (file, heading) = link.split_once('#').unwrap_or((&link, ""));
            let target = match file {
                "" => page.path.clone(),
                _ => page.path.parent().unwrap().join(file),
            };
            assert!(target.exists(), "{}: {link} does not exist", page.name());
            assert!(!Path::new(file).is_absolute(), "{}: {link} is not relative", page.name());
            if !heading.is_empty() {
                let text = std::fs::read_to_string(&target).unwrap();
                let found = text.lines().filter(|line| line.starts_with('#')).any(|line| anchor(line) == heading);
                assert!(found, "{}: {file} has no heading {heading}", page.name());
            }
            seen += 1;
        }
    }
    assert!(seen > 40, "only {seen} links were found");
}

#[test]
fn files_named_in_the_tree_exist() {
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let named = readme
        .split_whitespace()
        .filter(|word| ["src/", "tests/", "scripts/", "models/", "data/"].iter().any(|f| word.starts_with(f)));
    for word in named {
        assert!(root().join(word.trim_end_matches([',', ';', '.', ')'])).exists(), "README.md names {word}");
    }
}

#[test]
fn commands_parse() {
    let (mut seen, mut wrong) = (0, vec![]);
    for page in pages() {
        let inside = page.parts().0.join("\n").replace("\\\n", " ");
        let begins = ["hydrograd ", "cargo run --release -- "];
        let lines = inside.lines().filter_map(|line| {
            let at = begins.iter().filter_map(|begin| Some((line.find(begin)?, *begin))).min()?;
            // Behind another command, as in `apt-get install ... && cargo run`.
            (at.0 == 0 || line[..at.0].ends_with("&& ")).then(|| line[at.0..].replacen(at.1, "hydrograd ", 1))
        });
        for line in lines {
            seen += 1;
            wrong.extend(problem(&line, true).map(|problem| format!("{}: `{line}`: {problem}", page.name())));
        }
        for line in page.quoted().iter().filter(|text| text.starts_with("hydrograd ") && !text.contains("...")) {
            seen += 1;
            wrong.extend(problem(line, false).map(|problem| format!("{}: `{line}`: {problem}", page.name())));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen > 40, "only {seen} commands were found");
}

#[test]
fn configuration_keys_exist() {
    let known: BTreeSet<String> = [known_keys::<Config>(), known_keys::<Settings>()].concat().into_iter().collect();
    let sections: BTreeSet<&str> = known.iter().filter_map(|key| Some(key.split_once('.')?.0)).collect();
    let is_key = |text: &str| text.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || "_.*".contains(c));
    let (mut seen, mut wrong) = (0, vec![]);
    for page in pages() {
        for text in page.quoted() {
            for word in text.split(' ').map(|word| word.split('=').next().unwrap_or_default()) {
                let Some((section, key)) = word.split_once('.') else { continue };
                // `model.safetensors` and `data.toml` are files.
                let file = ["toml", "json", "csv", "h5", "safetensors", "rs", "md", "png", "py", "vtp"].contains(&key);
                if file || !is_key(word) || !sections.contains(section) {
                    continue;
                }
                seen += 1;
                if key != "*" && !known.contains(word) {
                    wrong.push(format!("{}: there is no key {word}", page.name()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen > 30, "only {seen} keys were found");
}

#[test]
fn figures_have_one_place_and_a_script() {
    let scripts =
        ["figures.py", "speed.py"].map(|name| std::fs::read_to_string(root().join("scripts").join(name)).unwrap());
    let mut seen = BTreeSet::new();
    for page in pages() {
        let begins: Vec<&str> = page.parts().1.into_iter().filter(|line| line.starts_with("<!-- figures: ")).collect();
        let ends = page.parts().1.iter().filter(|line| **line == "<!-- end -->").count();
        assert_eq!(begins.len(), ends, "{}: each place begins and ends", page.name());
        for line in begins {
            let name = line.trim_start_matches("<!-- figures: ").trim_end_matches(" -->").to_string();
            let printed = scripts
                .iter()
                .any(|text| text.contains(&format!("\"{name}\":")) || text.contains(&format!("def {name}():")));
            assert!(printed, "{}: no script prints {name}", page.name());
            assert!(seen.insert(name.clone()), "{}: a second place for {name}", page.name());
        }
    }
    assert!(seen.len() > 10, "{seen:?}");
}

#[test]
fn pictures_have_a_script_and_a_page() {
    let script = std::fs::read_to_string(root().join("scripts/pictures.py")).unwrap();
    let shown: Vec<String> = pages().iter().flat_map(Page::links).collect();
    for entry in std::fs::read_dir(root().join("data/pictures")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(script.contains(&name), "scripts/pictures.py does not make {name}");
        assert!(shown.iter().any(|link| link.ends_with(&format!("/{name}"))), "no page shows {name}");
    }
}

#[test]
fn words_are_those_of_a_shell() {
    let line = r#"hydrograd train --set "pushforward.after=[-1, 2]" --out runs/x  # not this"#;
    assert_eq!(words(line), ["hydrograd", "train", "--set", "pushforward.after=[-1, 2]", "--out", "runs/x"]);
    assert_eq!(words("hydrograd scenes heated-channel > my.toml"), ["hydrograd", "scenes", "heated-channel"]);
    assert_eq!(anchor("## Walls that are not flat"), "walls-that-are-not-flat");
    assert!(problem("hydrograd optimize --no-such-option", false).is_some());
    assert!(problem("hydrograd slurm --tasks 2 optimize --no-such-option", false).is_some());
    assert!(problem("hydrograd evaluate", false).is_none() && problem("hydrograd evaluate", true).is_some());
}
