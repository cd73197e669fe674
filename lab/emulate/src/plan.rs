//! Plans of faults as texts: a TOML file, faults written one by one, or a seed that draws some.

use std::path::Path;

use serde::Deserialize;
use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultKind, FaultPlan, FaultTarget};
use taktil_hal::{Invalid, explained};
use taktil_machine::source::{FileKind, Located, Source};
use taktil_machine_console::option::BadOption;

use crate::board::BoardKind;
use crate::robot::board_names;

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
        /// What goes wrong: `loss`, `duplication`, `reordering`, `delay`, `corruption`,
        /// `truncation`, `silence`, `unplugged`, `restart` or `frozen`.
        kind: String,
        /// Name of the board that it befalls. Default every board.
        #[serde(default)]
        target: String,
        /// When it begins, since the start of the run (s). Default 0.
        #[serde(default)]
        at: f64,
        /// How long it lasts (s). Default for good.
        #[serde(rename = "for")]
        for_s: Option<f64>,
        /// How strong it is: a probability, or the seconds of a delay; left out where the kind has
        /// no strength.
        value: Option<f64>,
    }
}

impl FaultSection {
    fn fault(&self) -> Result<Fault, Invalid> {
        let kind = FaultKind::ALL.into_iter().find(|kind| kind.name() == self.kind);
        let kind = kind.ok_or_else(|| {
            let words = FaultKind::ALL.map(FaultKind::name).join(", ");
            let what = format!("`{}` is no fault", self.kind);
            Invalid::new("kind", what, format!("it is one of: {words}"))
        })?;
        Fault::new(kind, &self.target, self.at, self.for_s, self.value)
    }
}

/// The plan of all that was asked for. Each text of `given` is a fault (`kind=loss value=0.01`) or
/// the name of a TOML file with a `[[fault]]` for each; `seed` draws more faults of `boards` within
/// `length`.
///
/// # Errors
/// An error in a file, located; [`BadOption`] for a fault that cannot be read.
pub fn fault_plan(
    given: &[String],
    seed: Option<u64>,
    boards: &[BoardKind],
    length: Nanos,
) -> anyhow::Result<FaultPlan> {
    let mut faults = Vec::new();
    for text in given {
        if text.contains('=') {
            let fault = text.parse::<Fault>().map_err(|bad| {
                BadOption(format!("--fault {}: {}; {}", bad.place, bad.what, bad.remedy))
            })?;
            faults.push(fault);
        } else {
            faults.extend(faults_of_text(&Source::read(Path::new(text), FileKind::Faults)?)?);
        }
    }
    if let Some(seed) = seed {
        let names = board_names(boards);
        let targets: Vec<FaultTarget<'_>> = boards
            .iter()
            .zip(&names)
            .map(|(kind, name)| FaultTarget { name, kinds: kind.fault_kinds() })
            .collect();
        faults.extend(FaultPlan::draw(seed, &targets, length).faults().iter().cloned());
    }
    Ok(FaultPlan::new(faults))
}

/// The faults of a text with a `[[fault]]` for each.
///
/// # Errors
/// What the text has wrong, located.
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

    #[test]
    fn a_seed_draws_what_the_boards_can_have() {
        let boards = [BoardKind::Mesa, BoardKind::Myrmex];
        let given = ["kind=restart target=mesa".to_owned()];
        let plan = fault_plan(&given, Some(3), &boards, Nanos::from_secs(10)).unwrap();
        assert!(plan.faults().len() > 1);
        for board in boards {
            plan.check_kinds(board.name(), board.fault_kinds()).unwrap();
        }
        let none = fault_plan(&["kind=los".to_owned()], None, &boards, Nanos::ZERO).unwrap_err();
        assert!(none.is::<BadOption>(), "{none}");
    }
}
