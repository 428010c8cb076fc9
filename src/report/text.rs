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
