//! "Did you mean ...?"

/// Insertions, deletions, substitutions and swaps of neighbours that turn one word into the other
/// (optimal string alignment).
pub fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    // distance[i][j]: between the first i letters of a and the first j of b.
    let mut distance = vec![vec![0; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            if i == 0 || j == 0 {
                distance[i][j] = i + j;
                continue;
            }
            let substitute = distance[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let insert_or_delete = distance[i - 1][j].min(distance[i][j - 1]) + 1;
            distance[i][j] = substitute.min(insert_or_delete);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                distance[i][j] = distance[i][j].min(distance[i - 2][j - 2] + 1);
            }
        }
    }
    distance[a.len()][b.len()]
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
        assert_eq!(edit_distance("heigth", "height"), 1);
        assert_eq!(edit_distance("dx", "dx"), 0);
    }

    #[test]
    fn nearest_is_near_or_nothing() {
        let known = ["height", "length", "dx", "memory"];
        assert_eq!(nearest("heigth", &known), Some("height"));
        assert_eq!(nearest("memory_mb", &known), Some("memory"));
        assert_eq!(nearest("viscosity", &known), None);
        assert_eq!(nearest("qq", &known), None);
    }
}
