//! Describes in words what is wrong with a binding: the place, and the bindings that would fit.

use std::collections::BTreeMap;

use super::draft::{NO_TASK, SignalOrigin};
use taktil_hal::Invalid;

use crate::lane::Lane;
use crate::port::InputDeclaration;
use crate::record::Catalog;
use crate::trace::REMOTE_MAX;

pub(super) fn mismatch(
    place: &str,
    signal: &str,
    input: &InputDeclaration,
    origin: &SignalOrigin,
) -> Invalid {
    Invalid::new(
        format!("wiring.{place}"),
        format!(
            "input `{place}` takes {}, but `{signal}` carries {}",
            input.type_name, origin.type_name
        ),
        format!("bind it to a signal of type {}", input.type_name),
    )
}

pub(super) fn unknown(
    place: &str,
    signal: &str,
    input: &InputDeclaration,
    catalog: &Catalog,
) -> Invalid {
    let fitting: Vec<String> = catalog
        .signals
        .iter()
        .filter(|candidate| carries(&candidate.type_name, input.type_name))
        .map(|candidate| candidate.name.clone())
        .collect();
    let remedy = if fitting.is_empty() {
        format!("add a task that produces {} to a lane", input.type_name)
    } else {
        format!("signals of type {}: {}", input.type_name, fitting.join(", "))
    };
    Invalid::new(
        format!("wiring.{place}"),
        format!("nobody produces `{signal}`: missing producer of `{place}`"),
        remedy,
    )
}

/// Whether a signal of the type `type_name` fits an input of the type `wanted`: the name of an
/// array payload may have its lengths behind it.
fn carries(type_name: &str, wanted: &str) -> bool {
    let base = type_name.trim_end_matches(|c: char| c.is_ascii_digit() || c == 'x');
    type_name == wanted || base == wanted
}

fn nearest(name: &str, known: &[String]) -> String {
    let task = name.split('.').next().unwrap_or(name);
    let same: Vec<&str> = known
        .iter()
        .filter(|input| input.split('.').next() == Some(task))
        .map(String::as_str)
        .collect();
    if same.is_empty() {
        format!("no task `{task}` with inputs stands in a lane; remove the line or add the task")
    } else {
        format!("inputs of `{task}`: {}", same.join(", "))
    }
}

/// Refuses an input that is bound to nothing, and a binding of an input that there is not.
pub(super) fn check_bindings(
    inputs: &[String],
    bindings: &BTreeMap<String, String>,
) -> Result<(), Invalid> {
    if let Some(name) = inputs.iter().find(|name| !bindings.contains_key(*name)) {
        return Err(Invalid::new(
            format!("wiring.{name}"),
            format!("input `{name}` is bound to nothing: missing producer"),
            format!("add `\"{name}\" = \"task.port\"` to [wiring]"),
        ));
    }
    match bindings.keys().find(|name| !inputs.contains(name)) {
        None => Ok(()),
        Some(name) => Err(Invalid::new(
            format!("wiring.{name}"),
            format!("there is no input `{name}`"),
            nearest(name, inputs),
        )),
    }
}

/// Refuses two signals of one name: a task's port beside a tape or a lane's own record.
pub(super) fn check_catalog(catalog: &Catalog) -> Result<(), Invalid> {
    if catalog.signals.len() > usize::from(u16::MAX) {
        return Err(Invalid::new("", "too many signals", "use fewer tasks"));
    }
    for (index, signal) in catalog.signals.iter().enumerate() {
        if catalog.signals[..index].iter().any(|other| other.name == signal.name) {
            return Err(Invalid::new(
                format!("lane.{}", catalog.lanes[signal.lane].name),
                format!("two signals are called `{}`: two producers", signal.name),
                "a lane's own are `health`, `state` and `decision`; rename the task or the lane",
            ));
        }
    }
    Ok(())
}

/// Refuses a lane that reads more signals of other lanes than a decision has room for.
pub(super) fn check_remotes(lanes: &[Lane]) -> Result<(), Invalid> {
    for lane in lanes {
        let remote = lane.ports.trace.remote.len();
        if remote > REMOTE_MAX {
            return Err(Invalid::new(
                format!("lane.{}", lane.plan.spec.name),
                format!("it reads {remote} signals of other lanes; {REMOTE_MAX} can be recorded"),
                "put tasks that talk much to each other into one lane",
            ));
        }
    }
    Ok(())
}

pub(super) fn check_edge(
    place: &str,
    signal: &str,
    input: &InputDeclaration,
    task: usize,
    lane: usize,
    origin: &SignalOrigin,
) -> Result<(), Invalid> {
    if input.type_id != origin.type_id {
        return Err(mismatch(place, signal, input, origin));
    }
    let later = origin.lane == lane && origin.task != NO_TASK && origin.task >= task;
    let own_health = origin.lane == lane && origin.task == NO_TASK;
    if (later || own_health) && !input.delayed {
        return Err(Invalid::new(
            format!("wiring.{place}"),
            format!("`{signal}` is written after `{place}` reads it in the same lane: a loop"),
            "put the producer earlier, or bind an input that is declared one tick delayed",
        ));
    }
    Ok(())
}
