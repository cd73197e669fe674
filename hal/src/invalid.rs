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
        write!(f, "{}: {}; {}", self.place, self.what, self.remedy)
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
}
