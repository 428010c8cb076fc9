//! "Did you mean ...?"

/// Levenshtein distance: insertions, deletions and substitutions between two words.
pub fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, from) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, to) in b.iter().enumerate() {
            let substitute = diagonal + usize::from(from != *to);
            diagonal = row[j + 1];
            row[j + 1] = substitute.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    row[b.len()]
}

/// The known word nearest to `word`, if near enough to be a slip of the keyboard:
/// at most a third of its letters differ (two for short words), or one begins with the other.
pub fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    let limit = (word.chars().count() / 3).max(2);
    known
        .iter()
        .copied()
        .map(|candidate| (edit_distance(word, candidate), candidate))
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
    fn edit_distances() {
        assert_eq!(edit_distance("", "abc"), 3);
        assert_eq!(edit_distance("kitten", "sitting"), 3);
        assert_eq!(edit_distance("optimize", "optimise"), 1);
        assert_eq!(edit_distance("dx", "dx"), 0);
    }

    #[test]
    fn nearest_is_near_or_nothing() {
        let known = ["height", "length", "dx", "memory_mb"];
        assert_eq!(nearest("heigth", &known), Some("height"));
        assert_eq!(nearest("memory", &known), Some("memory_mb"));
        assert_eq!(nearest("viscosity", &known), None);
        assert_eq!(nearest("qq", &known), None);
    }
}
