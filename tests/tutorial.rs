//! The tutorial: its files are written and its commands run as a reader would, in their order in one folder, and what it shows is what
//! the program prints. The settings of the page itself are coarse, so that this takes about half a minute of a core in a release build.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A fenced block: what stands behind the three backticks, and its lines.
struct Block {
    info: String,
    lines: Vec<String>,
}

fn blocks(page: &str) -> Vec<Block> {
    let (mut blocks, mut open): (Vec<Block>, Option<Block>) = (vec![], None);
    for line in page.lines() {
        match (line.strip_prefix("```"), open.take()) {
            (Some(_), Some(block)) => blocks.push(block),
            (Some(info), None) => open = Some(Block { info: info.to_string(), lines: vec![] }),
            (None, Some(mut block)) => {
                block.lines.push(line.to_string());
                open = Some(block);
            }
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a fenced block does not end");
    blocks
}

/// Runs a line with bash, which finds `hydrograd` where the tests' own is, on one thread (as `support::program` does).
fn run(folder: &Path, line: &str) -> Output {
    let program = assert_cmd::cargo::cargo_bin("hydrograd");
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
    let mut bash = Command::new("bash");
    bash.args(["-c", line]).current_dir(folder).env("PATH", path).env("CANDLE_NUM_THREADS", "1").output().unwrap()
}

/// The words of a line that have no digit: numbers depend on the processor and on the time it took.
fn words(line: &str) -> Vec<&str> {
    line.split_whitespace().filter(|word| !word.contains(|c: char| c.is_ascii_digit())).collect()
}

/// Files under runs/ that the page names between backticks.
fn named_files(page: &str) -> Vec<PathBuf> {
    let outside = page.split("```").step_by(2).collect::<String>();
    outside.split('`').skip(1).step_by(2).filter(|text| text.starts_with("runs/")).map(PathBuf::from).collect()
}

/// The words that `scripts/pictures.py` put into a picture of the pages.
fn words_of_picture(name: &str) -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/pictures").join(name);
    let bytes = std::fs::read(file).unwrap();
    let begin = b"iTXtwords\0\0\0\0\0";
    let at = bytes.windows(begin.len()).position(|some| some == begin);
    let at = at.unwrap_or_else(|| panic!("{name} has no words; make it with scripts/figures.py pictures"));
    // A chunk begins with its length, before its kind.
    let length = u32::from_be_bytes(bytes[at - 4..at].try_into().unwrap()) as usize;
    String::from_utf8(bytes[at + begin.len()..at + 4 + length].to_vec()).unwrap()
}

/// The words of a drawing of a run.
fn words_of_drawing(file: &Path) -> String {
    let text = std::fs::read_to_string(file).unwrap();
    let drawing = roxmltree::Document::parse(&text).unwrap();
    let texts = drawing.descendants().filter(|node| node.has_tag_name("text")).filter_map(|node| node.text());
    texts.map(str::trim).collect::<Vec<_>>().join("\n")
}

/// A file of a run.
fn summary(folder: &Path, run: &str) -> serde_json::Value {
    let text = std::fs::read_to_string(folder.join("runs").join(run).join("summary.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// What a reader does to have the program; not done here.
const BUILDING: [&str; 4] = ["sudo apt-get ", "cargo build ", "export PATH=", "mkdir -p ~/flows "];

#[test]
fn the_tutorial_is_what_happens() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cli/TUTORIAL.md");
    let page = std::fs::read_to_string(file).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (mut ran, mut written, mut shown, mut printed) = (0, 0, 0, String::new());
    for Block { info, lines } in blocks(&page) {
        let text = lines.join("\n") + "\n";
        let (kind, rest) = info.split_once(' ').unwrap_or((&info, ""));
        match kind {
            "toml" => {
                let (name, earlier) = match rest.strip_prefix(">> ") {
                    Some(name) => (name, std::fs::read_to_string(folder.path().join(name)).unwrap()),
                    None => (rest, String::new()),
                };
                std::fs::write(folder.path().join(name), earlier + &text).unwrap();
                written += 1;
            }
            "sh" => {
                let code = rest.strip_prefix("exit ").map_or(0, |code| code.parse().unwrap());
                printed.clear();
                for line in lines.iter().filter(|line| !BUILDING.iter().any(|begin| line.starts_with(begin))) {
                    assert!(line.starts_with("hydrograd "), "`{line}` is no command of hydrograd");
                    let output = run(folder.path(), line);
                    let error = String::from_utf8_lossy(&output.stderr);
                    assert_eq!(output.status.code(), Some(code), "`{line}`: {error}");
                    printed += &(String::from_utf8(output.stdout).unwrap() + &error);
                    ran += 1;
                }
            }
            "text" => {
                // What the page shows, in the order of what the last command printed; "..." leaves lines out.
                let mut left = printed.lines();
                for line in lines.iter().filter(|line| *line != "...") {
                    assert!(left.any(|other| words(other) == words(line)), "no line like `{line}` in\n{printed}");
                    shown += 1;
                }
            }
            _ => panic!("a block of kind `{info}`"),
        }
    }
    assert!(ran >= 14 && written >= 4 && shown >= 20, "{ran} commands, {written} files, {shown} lines");
    let named = named_files(&page);
    assert!(named.len() >= 7, "{named:?}");
    for file in named {
        assert!(folder.path().join(&file).exists(), "the tutorial names {}", file.display());
    }
    // Shipped pictures are of runs of this program, and the pages quote such a run.
    for (picture, drawing) in [
        ("optimize-shapes.png", "optimize-heated-channel/shapes.svg"),
        ("optimize-temperature.png", "optimize-heated-channel/temperature.svg"),
        ("pin.png", "pin/temperature.svg"),
    ] {
        let drawn = words_of_drawing(&folder.path().join("runs").join(drawing));
        assert_eq!(words_of_picture(picture), drawn, "{picture}: /usr/bin/python3 scripts/figures.py pictures");
    }
    let found = summary(folder.path(), "optimize-heated-channel");
    let (first, best) = (found["q_first"].as_f64().unwrap(), found["q"].as_f64().unwrap());
    let (epoch, epochs) = (found["best_epoch"].as_u64().unwrap() + 1, found["q_per_epoch"].as_array().unwrap().len());
    let gain = 100.0 * (best / first - 1.0);
    let quoted = format!("Q {first:.6} -> {best:.6} ({gain:+.2} %) in epoch {epoch} of {epochs}, ");
    for page in [page.as_str(), include_str!("../README.md")] {
        assert!(page.contains(&quoted), "a page does not say `{quoted}`");
    }
    // What the page says of its own design.
    let summary = summary(folder.path(), "pin");
    let (first, best) = (summary["q_first"].as_f64(), summary["q"].as_f64());
    let gain = best.unwrap() / first.unwrap() - 1.0;
    assert!(gain > 0.05 && gain < 0.15, "a gain of {gain}");
    let survives = summary["gain_survives"].as_f64().unwrap();
    assert!(survives < 0.7 * gain && summary["proved"] == (survives > 0.0), "{survives} of {gain} survives");
    let (parts, time) = (&summary["gain_error_parts"], summary["gain_error_parts"]["iteration"].as_f64().unwrap());
    assert!(time > parts["discretisation"].as_f64().unwrap(), "{parts}");
}
