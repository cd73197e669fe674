//! The phases of a task as a graph: every phase has to be entered from the first one, and from
//! every phase a way has to lead to an end, which is `end` or a phase without a condition.

use taktil_rtcore::Invalid;

use super::{Next, TouchTask};

/// Checks where the phases lead to.
///
/// # Errors
/// A name that no phase has, a phase that is never entered, a circle without a way out.
pub(super) fn check(task: &TouchTask) -> Result<(), Invalid> {
    let first = task.first_index()?;
    let edges: Vec<[Option<Next>; 2]> = (0..task.phase.len())
        .map(|index| task.successors(index).map(|(done, failed)| [done, failed]))
        .collect::<Result<_, _>>()?;
    let mut entered = vec![false; edges.len()];
    let mut open = vec![first];
    while let Some(index) = open.pop() {
        if !std::mem::replace(&mut entered[index], true) {
            open.extend(edges[index].iter().flatten().filter_map(|next| match next {
                Next::Phase(next) => Some(*next),
                Next::End => None,
            }));
        }
    }
    if let Some(index) = entered.iter().position(|entered| !entered) {
        let what = format!("`{}` is never entered", task.phase[index].name);
        let remedy = "name it in a `then` or an `else`, or leave it out";
        return Err(Invalid::new(format!("phase[{index}].name"), what, remedy));
    }
    // Backwards from the ends, until nothing changes.
    let mut ends: Vec<bool> = edges.iter().map(|[done, _]| done.is_none()).collect();
    for _ in 0..edges.len() {
        for index in 0..edges.len() {
            let leads = |next: &Next| match next {
                Next::Phase(next) => ends[*next],
                Next::End => true,
            };
            ends[index] |= edges[index].iter().flatten().any(leads);
        }
    }
    if let Some(index) = ends.iter().position(|ends| !ends) {
        let what =
            format!("`{}` stands in a circle of phases without a way out", task.phase[index].name);
        let remedy =
            "give a phase of it an `else` with within_s or visits_max, or let one lead to `end`";
        return Err(Invalid::new(format!("phase[{index}].then"), what, remedy));
    }
    Ok(())
}
