//! What is wrong with a binding, in words: the place, and which bindings would fit. Refuses nothing
//! itself.

use super::Home;
use crate::port::InputDeclaration;
use crate::record::Catalog;
use crate::task::Invalid;

pub(super) fn mismatch(
    place: &str,
    signal: &str,
    input: &InputDeclaration,
    home: &Home,
) -> Invalid {
    Invalid::new(
        format!("wiring.{place}"),
        format!(
            "input `{place}` takes {}, but `{signal}` carries {}",
            input.type_name, home.type_name
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
        .filter(|candidate| candidate.type_name == input.type_name)
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

pub(super) fn nearest(name: &str, known: &[String]) -> String {
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
