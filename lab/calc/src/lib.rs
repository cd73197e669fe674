//! The mathematics as a filter: JSON lines in, JSON lines out, one answer for each request, in
//! order. An unknown operation, an unknown field, a wrong type and a wrong length are errors that
//! name the operation or the field; a bad line never stops the filter.
//!
//! Numbers are printed so that they read back bit for bit, and are read with correct rounding. One
//! table for each subject names every field with its type, unit and default; the parser, the checks
//! and [`list`] all use it.

mod answer;
mod body;
mod cells;
mod column;
mod contact;
mod differences;
mod dynamics;
mod field;
mod indent;
mod indenter;
mod jacobian;
mod kinematics;
mod meshed;
mod motion;
mod nodes;
mod path;
mod plane;
mod recover;
mod refusal;
mod request;
mod runs;
mod solved;
mod space;
mod touch;
mod unique_keys;

use std::io::{BufRead, Read, Write};

use serde_json::Value;
use taktil_machine_console::out;

use answer::Answer;
use field::{COMMON, Failure, Field, Kind};
use request::Args;

/// Notes on an operation that [`list`] prints below its fields.
const OPERATION_NOTES: &[(&str, &[&str])] = &[("contact_2d", indent::NOTES)];

/// Longest line of a request (bytes); a longer one is an error.
const LINE_MAX: u64 = 64 << 20;

/// One operation of the filter.
struct Operation {
    name: &'static str,
    doc: &'static str,
    fields: &'static [Field],
    /// Name, shape and unit of each answer.
    answers: &'static [(&'static str, &'static str)],
    run: fn(&Args) -> Result<Answer, Failure>,
}

/// Every operation, subject by subject.
fn operations() -> impl Iterator<Item = &'static Operation> {
    [kinematics::OPERATIONS, dynamics::OPERATIONS, motion::OPERATIONS]
        .into_iter()
        .chain([touch::OPERATIONS, contact::OPERATIONS, plane::OPERATIONS, space::OPERATIONS])
        .chain([path::OPERATIONS, jacobian::OPERATIONS, recover::OPERATIONS])
        .flatten()
}

/// Answers every request line of `input` on `output`, until the input ends or the reader of the
/// answers is gone.
///
/// # Errors
/// An error while reading the input or writing the output.
pub fn filter(input: &mut dyn BufRead, output: &mut dyn Write) -> anyhow::Result<()> {
    let mut line = Vec::new();
    loop {
        line.clear();
        if Read::take(&mut *input, LINE_MAX + 1).read_until(b'\n', &mut line)? == 0 {
            return Ok(());
        }
        let text = line.trim_ascii();
        let too_long = line.len() as u64 > LINE_MAX;
        if text.is_empty() && !too_long {
            continue;
        }
        let mut reply = if too_long {
            if !line.ends_with(b"\n") {
                input.skip_until(b'\n')?;
            }
            let what = format!("a request line may have {LINE_MAX} bytes");
            answer::refusal(&Value::Null, &Failure::new("line_too_long", None, what))
        } else {
            answer(text)
        };
        reply.push('\n');
        // The answer is flushed at once, because the sender may wait for it before the next
        // request.
        if !out::deliver(output, &reply)? {
            return Ok(());
        }
    }
}

/// The answer to one request, without a line end.
fn answer(text: &[u8]) -> String {
    let request = match serde_json::from_slice(text) {
        Ok(unique_keys::UniqueKeys(request)) => request,
        Err(error) => {
            let failure = Failure::new("bad_json", None, format!("not a JSON value: {error}"));
            return answer::refusal(&Value::Null, &failure);
        }
    };
    let id = request.get("id").cloned().unwrap_or(Value::Null);
    match evaluate(&request) {
        Ok(body) => answer::success(&id, &body),
        Err(failure) => answer::refusal(&id, &failure),
    }
}

fn evaluate(request: &Value) -> Result<Answer, Failure> {
    let object = request.as_object().ok_or_else(|| {
        Failure::new("not_an_object", None, "a request is an object {\"op\": ..., ...}")
    })?;
    let name = match object.get("op") {
        Some(Value::String(name)) => name.as_str(),
        Some(other) => {
            let what = format!("`op` is {}; wanted: a text", request::kind_name(other));
            return Err(Failure::new("wrong_type", Some("op"), what));
        }
        None => {
            let what = "`op` is missing: the name of an operation, a text";
            return Err(Failure::new("missing_field", Some("op"), what));
        }
    };
    let operation = operations().find(|operation| operation.name == name).ok_or_else(|| {
        let known: Vec<&str> = operations().map(|operation| operation.name).collect();
        let what = format!("unknown operation `{name}`; known: {}", known.join(", "));
        Failure::new("unknown_op", Some("op"), what)
    })?;
    let args = Args::from_request(object, operation.fields)?;
    let mut body = (operation.run)(&args)?;
    if let Some(field) = body.first_not_finite() {
        let what = format!("the answer's `{field}` is not a finite number; give smaller numbers");
        return Err(Failure::new("not_finite", None, what));
    }
    if let Some(ns) = args.best_ns() {
        body.integer("ns", ns);
    }
    Ok(body)
}

/// What `taktil calc --list` prints: every operation with its fields, types, units and defaults.
#[must_use]
pub fn list() -> String {
    let mut out = String::from(
        "One JSON object a line on stdin, one a line on stdout.\n\
         Units: m, rad, s, kg, N m; contact: mm, N/mm, MPa.\n\
         \nevery operation\n",
    );
    let name_width = |fields: &[Field]| fields.iter().map(|f| f.name.len()).max().unwrap_or(0);
    push_fields(&mut out, COMMON, name_width(COMMON));
    for operation in operations() {
        out.push_str(&format!("\n{}: {}\n", operation.name, operation.doc));
        push_fields(&mut out, operation.fields, name_width(operation.fields));
        out.push_str("  answers: ");
        let answers: Vec<String> =
            operation.answers.iter().map(|(name, about)| format!("{name} {about}")).collect();
        out.push_str(&answers.join(", "));
        out.push('\n');
        let notes = OPERATION_NOTES.iter().filter(|(name, _)| *name == operation.name);
        for note in notes.flat_map(|(_, notes)| *notes) {
            out.push_str(&format!("  note: {note}\n"));
        }
    }
    out
}

fn push_fields(out: &mut String, fields: &'static [Field], width: usize) {
    for field in fields {
        let (kind, unit) = (field.kind.description(), field.unit);
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        let need = field.presence.description();
        out.push_str(&format!("  {:width$}  {kind}{unit}; {need}. {}\n", field.name, field.doc));
        push_inner(out, field, 4);
    }
}

/// Prints the fields of an object and, recursively, those of the objects in it.
fn push_inner(out: &mut String, field: &'static Field, indent: usize) {
    let (Kind::Table(inner) | Kind::Tables(inner) | Kind::ChoiceOrTable(_, inner)) = field.kind
    else {
        return;
    };
    for field in inner {
        let (kind, need, unit, doc) =
            (field.kind.description(), field.presence.description(), field.unit, field.doc);
        let name = field.name;
        out.push_str(&format!("{:indent$}.{name}  {kind} {unit}; {need}. {doc}\n", ""));
        push_inner(out, field, indent + 2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_every_default_passes_its_own_check() {
        let mut names: Vec<&str> = operations().map(|operation| operation.name).collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
        for operation in operations() {
            for field in operation.fields.iter().chain(COMMON) {
                assert!(request::is_default_valid(field), "{}.{}", operation.name, field.name);
            }
        }
    }

    #[test]
    fn the_list_names_every_field() {
        let text = list();
        for operation in operations() {
            assert!(text.contains(&format!("\n{}: ", operation.name)));
            for field in operation.fields {
                assert!(text.contains(&format!("  {}", field.name)), "{}", field.name);
            }
        }
        // The list covers nested objects too.
        assert!(text.contains("      .height_mm  number mm; default 6.35."), "{text}");
        for (name, notes) in OPERATION_NOTES {
            assert!(operations().any(|operation| operation.name == *name));
            assert!(notes.iter().all(|note| text.contains(note)));
        }
    }
}
