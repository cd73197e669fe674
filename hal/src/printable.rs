//! Text from outside as people may see it: without characters that a terminal would obey, and of
//! bounded length.
//!
//! ```
//! use taktil_hal::printable::{escaped, excerpt};
//!
//! assert_eq!(escaped("no\u{1b}[2J"), "no\\u001b[2J");
//! assert_eq!(excerpt(&"0123456789".repeat(9), 40), "012 ... (86 more) ... 9");
//! ```

use std::borrow::Cow;
use std::fmt::Write as _;

/// Longest place, finding or remedy of a complaint that is shown (bytes): with a file's name and
/// the line it makes 2 KB at most.
pub const PART_BYTES_MAX: usize = 560;
/// Bytes of the words that stand for what is left out, with the largest number.
const OMISSION_BYTES_MAX: usize = 36;

/// The text with each character of control, and each that turns the direction of writing, as four
/// hexadecimal digits after `\u`, as strings of JSON have them. Ends of lines and tabulators stay.
#[must_use]
pub fn escaped(text: &str) -> Cow<'_, str> {
    let Some(first) = text.find(is_obeyed) else { return Cow::Borrowed(text) };
    let mut out = String::with_capacity(text.len() + 8);
    out.push_str(&text[..first]);
    for character in text[first..].chars() {
        if is_obeyed(character) {
            // A string takes everything that is written to it.
            let _ = write!(out, "\\u{:04x}", u32::from(character));
        } else {
            out.push(character);
        }
    }
    Cow::Owned(out)
}

/// One line of at most `bytes_max` bytes: [`escaped`], with ends of lines as spaces. The middle of
/// a longer one is left out.
#[must_use]
pub fn excerpt(text: &str, bytes_max: usize) -> String {
    let line = escaped(text).replace(['\n', '\t'], " ");
    if line.len() <= bytes_max {
        return line;
    }
    let room = bytes_max.saturating_sub(OMISSION_BYTES_MAX);
    let (head, tail) = (&line[..line.floor_char_boundary(room - room / 3)], room / 3);
    let tail = &line[line.ceil_char_boundary(line.len() - tail)..];
    format!("{head} ... ({} more) ... {tail}", line.len() - head.len() - tail.len())
}

/// Whether a terminal would do something else than show a character. Ends of lines and tabulators
/// are shown.
#[must_use]
pub fn is_obeyed(character: char) -> bool {
    let turns = matches!(character, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || (character.is_control() && !matches!(character, '\n' | '\t'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_would_obey_is_escaped_and_the_rest_stays() {
        assert!(matches!(escaped("Gr\u{f6}\u{df}e\n\t1"), Cow::Borrowed(_)));
        for (text, shown) in [
            ("\u{1b}]0;x\u{7}", "\\u001b]0;x\\u0007"),
            ("a\r\0b\u{7f}", "a\\u000d\\u0000b\\u007f"),
            ("\u{9b}2J\u{202e}", "\\u009b2J\\u202e"),
        ] {
            assert_eq!(escaped(text), shown);
        }
    }

    #[test]
    fn an_excerpt_is_one_line_and_never_longer_than_its_bound() {
        assert_eq!(excerpt("two\nlines", 40), "two lines");
        for text in ["x", "\u{1b}", "\u{20ac}", "a\u{20ac}\n"] {
            for (count, bytes_max) in [(1, 60), (60, 60), (1000, 60), (100_000, 600), (1000, 36)] {
                let shown = excerpt(&text.repeat(count), bytes_max);
                assert!(shown.len() <= bytes_max, "{} of {bytes_max}: {shown}", shown.len());
                assert!(!shown.contains(['\n', '\u{1b}']), "{shown}");
            }
        }
    }
}
