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
