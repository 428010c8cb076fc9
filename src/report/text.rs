//! Text for people: sizes of memory, and what a file may have put into a message or a page.

/// Characters of a line of a message at most.
const LONGEST_LINE: usize = 2000;

/// A message as it may be shown, whatever a file has put into it: no control characters, with which a terminal would do something
/// else, and no line that fills the screen.
pub fn shown(text: &str) -> String {
    shown_within(text, LONGEST_LINE)
}

/// The same with lines of at most so many characters.
pub fn shown_within(text: &str, longest: usize) -> String {
    let line = |line: &str| -> String {
        let mut letters = line.chars();
        let plain = |c: char| if is_safe(c) { c.to_string() } else { c.escape_default().to_string() };
        let start: String = letters.by_ref().take(longest).map(plain).collect();
        start + if letters.next().is_some() { " ..." } else { "" }
    };
    text.split('\n').map(line).collect::<Vec<_>>().join("\n")
}

/// A number of bytes in the unit that suits it: `12.3 MB`.
pub fn bytes(count: usize) -> String {
    match count as f64 {
        b if b < 1e4 => format!("{b} B"),
        b if b < 1e6 => format!("{:.1} kB", b / 1e3),
        b if b < 1e10 => format!("{:.1} MB", b / 1e6),
        b => format!("{:.1} GB", b / 1e9),
    }
}

/// A count with its noun.
pub fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Neither a control character nor one that turns the direction of the text around it.
fn is_safe(c: char) -> bool {
    !c.is_control() && !matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_can_be_shown() {
        let plain = "error: bad\n  allowed: 0 ... 1, \u{e4}";
        assert_eq!(shown(plain), plain);
        assert_eq!(shown("a\u{1b}[2J\u{7}b\tc"), "a\\u{1b}[2J\\u{7}b\\tc");
        assert_eq!(shown("a\u{202e}b"), "a\\u{202e}b");
        let long = "x".repeat(9000) + "\nnext";
        assert_eq!(shown(&long), "x".repeat(LONGEST_LINE) + " ...\nnext");
        assert_eq!(shown_within("abcd", 3), "abc ...");
    }

    #[test]
    fn sizes_have_their_unit() {
        let sizes = [0, 9_999, 10_000, 164_904_960, 12_300_000_000].map(bytes);
        assert_eq!(sizes, ["0 B", "9999 B", "10.0 kB", "164.9 MB", "12.3 GB"]);
    }
}
