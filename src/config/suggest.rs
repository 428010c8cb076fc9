//! "Did you mean ...?"

use strsim::osa_distance;

/// The known word nearest to `word`, if it is near enough for a typing error: at most a third of its letters differ
/// (two for short words), or one begins with the other.
pub fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    let limit = (word.chars().count() / 3).max(2);
    known
        .iter()
        .copied()
        .map(|candidate| (osa_distance(word, candidate), candidate))
        .filter(|(distance, candidate)| {
            let prefix = word.len() >= 3 && (candidate.starts_with(word) || word.starts_with(candidate));
            prefix || (*distance <= limit && *distance < candidate.chars().count())
        })
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

/// The alternatives in a text of advice: `a=1, b=2 or less` has three. What is in brackets is not divided.
pub fn alternatives(advice: &str) -> Vec<&str> {
    let (mut all, mut from, mut depth) = (Vec::new(), 0, 0);
    for (at, c) in advice.char_indices() {
        match c {
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => depth -= 1,
            _ if depth > 0 || at < from => continue,
            _ => {}
        }
        if let Some(between) = [", or ", ", ", " or "].iter().find(|between| advice[at..].starts_with(**between)) {
            all.push(&advice[from..at]);
            from = at + between.len();
        }
    }
    all.push(&advice[from..]);
    all
}

/// The assignments `section.key=value` in a text, but for those behind an option, such as `--set`.
pub fn assignments(text: &str) -> Vec<&str> {
    let words = text.split(' ').map(|word| word.trim_matches(['(', ')', '`', ',', ';', ':']));
    let pairs = std::iter::once("").chain(words.clone()).zip(words);
    let is_one = |word: &str| word.split_once('=').is_some_and(|(key, _)| is_key(key) && key.contains('.'));
    pairs.filter(|(before, word)| !before.starts_with("--") && is_one(word)).map(|(_, word)| word).collect()
}

/// Whether a word has the form of a key.
pub fn is_key(word: &str) -> bool {
    let is_of_key = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "._[]".contains(c);
    word.starts_with(|c: char| c.is_ascii_lowercase()) && word.chars().all(is_of_key)
}

/// Advice whose alternatives with assignments are changed or, if there is nothing in their place, left out.
pub fn changed(advice: &str, change: impl Fn(&str, &[&str]) -> Option<String>) -> String {
    let all = alternatives(advice);
    let after = |one: &&str| match assignments(one) {
        none if none.is_empty() => Some(one.to_string()),
        assignments => change(one, &assignments),
    };
    let left: Vec<String> = all.iter().filter_map(after).collect();
    if left == all {
        advice.to_string()
    } else {
        left.join(", or ")
    }
}

/// The number with the fewest digits that is near `x` and accepted; `x` if no shorter one is.
pub fn shortest(x: f64, accepts: impl Fn(f64) -> bool) -> f64 {
    let rounded = |digits: usize| -> [f64; 2] {
        let unit = 10f64.powi(x.abs().log10().floor() as i32 - digits as i32);
        // Written and read again, so that the number is the decimal one.
        [(x / unit).round(), (x / unit).floor()].map(|count| {
            let text = format!("{:.*e}", digits, count * unit);
            text.parse().unwrap_or(x)
        })
    };
    (0..16).flat_map(rounded).find(|&short| accepts(short)).unwrap_or(x)
}

/// The smallest number that is not below `x`, but for rounding, and has no more decimals than three digits of `scale`.
pub fn at_least(x: f64, scale: f64) -> f64 {
    let unit = 10f64.powi(2 - scale.log10().floor() as i32);
    (x * unit - 1e-6).ceil() / unit
}
