//! The library names configuration keys; on the command line there are options for them.

/// Keys with an option of their own.
const OPTIONS: [(&str, &str); 6] = [
    ("optimise.memory", "--memory"),
    ("optimise.gradient", "--gradient"),
    ("optimise.segment", "--segment"),
    ("optimise.horizon", "--horizon"),
    ("optimise.store", "--store"),
    ("optimise.epochs", "--epochs"),
];

/// A message whose assignments `section.key=value`, in the lines of advice, are options: `--memory 20MB`,
/// `--set time.cfl=0.5`.
pub fn with_options(message: &str) -> String {
    let lines: Vec<String> = message
        .split('\n')
        .map(|line| match line.strip_prefix("  try: ") {
            Some(advice) => format!("  try: {}", options_in(advice)),
            None => line.to_string(),
        })
        .collect();
    lines.join("\n")
}

fn options_in(advice: &str) -> String {
    let mut last = "";
    let words: Vec<String> = advice
        .split(' ')
        .map(|word| {
            let after = std::mem::replace(&mut last, word);
            match word.split_once('=').filter(|(key, _)| is_key(key) && after != "--set") {
                Some((key, value)) => match OPTIONS.iter().find(|(known, _)| *known == key) {
                    Some((_, option)) => format!("{option} {value}"),
                    None => format!("--set {word}"),
                },
                None => word.to_string(),
            }
        })
        .collect();
    words.join(" ")
}

/// `section.key`, not the name of a file or an option.
fn is_key(text: &str) -> bool {
    let is_name = |name: &str| !name.is_empty() && name.chars().all(|c| c.is_ascii_lowercase() || c == '_');
    text.split_once('.').is_some_and(|(section, key)| is_name(section) && is_name(key))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_become_options() {
        let of = |advice: &str| with_options(&format!("bad: time.cfl=9\n  allowed: time.cfl=1\n  try: {advice}"));
        let begin = "bad: time.cfl=9\n  allowed: time.cfl=1\n  try: ";
        for (advice, expected) in [
            ("time.cfl=0.5, or a smaller design.bound", "--set time.cfl=0.5, or a smaller design.bound"),
            ("optimise.memory=16.3MB (no step is run twice)", "--memory 16.3MB (no step is run twice)"),
            ("optimise.gradient=segments optimise.segment=0", "--gradient segments --segment 0"),
            ("--set resolution.dx=0.02 or --out=a.b=c", "--set resolution.dx=0.02 or --out=a.b=c"),
        ] {
            assert_eq!(of(advice), format!("{begin}{expected}"));
        }
    }
}
