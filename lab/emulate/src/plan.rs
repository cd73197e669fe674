//! Plans of faults as texts: a TOML file, faults written one by one, or a seed that draws some.

use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultPlan, FaultTarget};
use taktil_machine::fault_plan::read_faults;
use taktil_machine_console::option::BadOption;

pub use taktil_machine::fault_plan::faults_of_text;

use crate::board::BoardKind;
use crate::robot::board_names;

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
            faults.extend(read_faults(text)?);
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

#[cfg(test)]
mod tests {
    use super::*;

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
