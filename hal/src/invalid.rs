//! The error of a configuration that cannot be used. Every crate that checks a configuration
//! returns this one type, so that the program can prepend the file and the enclosing tables to the
//! place without any conversion.
//!
//! ```
//! use taktil_hal::Invalid;
//!
//! let bad = Invalid::new("counter_bits", "40 is out of bounds", "give 8 to 32").within("board");
//! assert_eq!(bad.to_string(), "board.counter_bits: 40 is out of bounds; give 8 to 32");
//! ```

use core::fmt;

use crate::printable::{PART_BYTES_MAX, excerpt};

/// A configuration that cannot be used: where, what and the way out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Invalid {
    /// Dotted path inside the configuration, such as `joint_servo.bandwidth_rad_s[2]`; empty for
    /// the whole.
    pub place: String,
    /// What is wrong, with the value found.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
}

impl Invalid {
    /// A complaint of its three parts.
    pub fn new(
        place: impl Into<String>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Invalid {
        Invalid { place: place.into(), what: what.into(), remedy: remedy.into() }
    }

    /// The same complaint seen from an enclosing table: `place` is put in front of the path.
    #[must_use]
    pub fn within(mut self, outer: &str) -> Invalid {
        self.place = match (outer.is_empty(), self.place.is_empty()) {
            (true, _) => self.place,
            (false, true) => outer.to_owned(),
            (false, false) => format!("{outer}.{}", self.place),
        };
        self
    }
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [place, what, remedy] =
            [&self.place, &self.what, &self.remedy].map(|part| excerpt(part, PART_BYTES_MAX));
        write!(f, "{place}: {what}; {remedy}")
    }
}

impl std::error::Error for Invalid {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_enclosing_table_stands_in_front_of_the_place() {
        let place = |inner: &str, outer: &str| Invalid::new(inner, "", "").within(outer).place;
        assert_eq!(place("period_us", "lane.control"), "lane.control.period_us");
        assert_eq!(place("", "lane.control"), "lane.control");
        assert_eq!(place("period_us", ""), "period_us");
    }

    #[test]
    fn text_from_outside_is_shown_short_and_without_characters_of_control() {
        let long = "\u{1b}[2J".repeat(100_000);
        let shown = Invalid::new(&*long, &*long, &*long).to_string();
        assert!(shown.len() <= 3 * PART_BYTES_MAX + 4, "{}", shown.len());
        assert!(shown.starts_with("\\u001b[2J") && !shown.contains('\u{1b}'), "{shown}");
    }
}
