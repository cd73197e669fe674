//! Plans of faults as texts: a TOML file with a `[[fault]]` for each, or faults one by one.

use std::path::Path;

use serde::Deserialize;
use taktil_hal::fault::{Fault, FaultKind};
use taktil_hal::{Invalid, explained};

use crate::source::{FileKind, Located, Source};

explained! {
    /// A plan of faults.
    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct PlanFile {
        /// The faults; they may overlap.
        fault: Vec<FaultSection>,
    }
}

explained! {
    /// One fault.
    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct FaultSection {
        /// What goes wrong: of a link `loss`, `duplication`, `reordering`, `delay`, `corruption`,
        /// `truncation`, `silence`, `unplugged`, `restart` or `frozen`; of a half also `jump`,
        /// `inversion`, `lost_counts`, `dead`, `hot`, `clipped`, `failing`, `torn` or `bounce`; of
        /// a lane `lateness`, `overrun` or `silence`; of the clock `clock_gap`; of a task `panic`
        /// or `not_finite`; of an operator `flood`, `silence` or `unplugged`; of the records `full`
        /// or `delay`.
        kind: String,
        /// Name of the board or half that it befalls, with a channel behind a full stop where it is
        /// one of them (`encoders.3`). Default every board.
        #[serde(default)]
        target: String,
        /// When it begins, since the start of the run (s). Default 0.
        #[serde(default)]
        at: f64,
        /// How long it lasts (s). Default for good.
        #[serde(rename = "for")]
        for_s: Option<f64>,
        /// How strong it is: a probability, a part, seconds or counts; left out where the kind has
        /// no strength.
        value: Option<f64>,
    }
}

impl FaultSection {
    fn fault(&self) -> Result<Fault, Invalid> {
        let kind = FaultKind::from_name(&self.kind);
        let kind = kind.ok_or_else(|| {
            let words = FaultKind::words(&FaultKind::ALL);
            let what = format!("`{}` is no fault", self.kind);
            Invalid::new("kind", what, format!("it is one of: {words}"))
        })?;
        Fault::new(kind, &self.target, self.at, self.for_s, self.value)
    }
}

/// The faults that a text names: a fault (`kind=loss value=0.01`), or a TOML file.
///
/// # Errors
/// An error in a file, located; a fault that cannot be read, at its text.
pub fn read_faults(text: &str) -> Result<Vec<Fault>, Located> {
    if !text.contains('=') {
        return faults_of_text(&Source::read(Path::new(text), FileKind::Faults)?);
    }
    let source = Source { path: text.into(), text: String::new() };
    text.parse::<Fault>().map(|fault| vec![fault]).map_err(|bad| source.locate(bad))
}

/// The faults of a file.
///
/// # Errors
/// The first fault that cannot be read, located.
pub fn faults_of_text(source: &Source) -> Result<Vec<Fault>, Located> {
    let file: PlanFile = source.parse()?;
    let fault = |(index, section): (usize, &FaultSection)| {
        section.fault().map_err(|bad| source.locate(bad.within(&format!("fault[{index}]"))))
    };
    file.fault.iter().enumerate().map(fault).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Fault>, Located> {
        faults_of_text(&Source { path: "plan.toml".into(), text: text.to_owned() })
    }

    #[test]
    fn a_file_says_what_the_short_form_says() {
        let faults = read(
            "[[fault]]\nkind = \"loss\"\ntarget = \"mesa\"\nat = 2.0\nfor = 0.5\nvalue = 0.01\n\
             [[fault]]\nkind = \"frozen\"\n",
        );
        let short = ["kind=loss target=mesa at=2 for=0.5 value=0.01", "kind=frozen"];
        assert_eq!(faults.unwrap(), short.map(|text| text.parse().unwrap()));
    }

    #[test]
    fn what_is_wrong_in_a_file_is_shown_in_its_line() {
        for (text, line, says) in [
            ("[[fault]]\nkind = \"los\"\n", 2, "`los` is no fault"),
            ("[[fault]]\nkind = \"loss\"\nvalue = 2.0\n", 3, "2 for `loss`"),
            ("[[fault]]\nkind = \"silence\"\nfrom = 2.0\n", 3, "unknown field `from`"),
        ] {
            let bad = read(text).unwrap_err();
            assert_eq!(bad.mark.as_ref().map(|mark| mark.line), Some(line), "{bad}");
            assert!(bad.what.contains(says), "{bad}");
        }
    }
}
