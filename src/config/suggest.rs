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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_is_near_or_nothing() {
        let known = ["height", "length", "dx", "memory"];
        // Two swapped letters are one error.
        assert_eq!(nearest("heigth", &known), Some("height"));
        assert_eq!(nearest("xd", &["dy", "dx"]), Some("dx"));
        assert_eq!(nearest("memory_mb", &known), Some("memory"));
        assert_eq!(nearest("viscosity", &known), None);
        assert_eq!(nearest("qq", &known), None);
    }
}
