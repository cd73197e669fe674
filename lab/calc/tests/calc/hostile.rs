//! Every wrong value of every field of `contact_3d`: each yields one error line that names the
//! field and the remedy, and the filter goes on. The values of the answers are tested elsewhere.

use serde_json::{Value, json};

use crate::ask::ask_text;

/// Name and value of each wrong input; the value is JSON text that need not be valid.
const INVALID_VALUES: [(&str, &str); 15] = [
    ("minus", "-1"),
    ("zero", "0"),
    ("half", "0.5"),
    ("huge", "1e300"),
    ("tiny", "1e-300"),
    ("word", "\"much\""),
    ("empty", "\"\""),
    ("list", "[1]"),
    ("object", "{\"more\":1}"),
    ("truth", "true"),
    ("null", "null"),
    ("nan", "NaN"),
    ("infinity", "1e999"),
    ("cut", ""),
    ("absent", ABSENT),
];
const ABSENT: &str = "absent";
/// Placeholder in a request that is replaced by the value.
const PLACEHOLDER: &str = "@@";

/// Fields by shape, and the values of [`INVALID_VALUES`] that are valid there.
const FIELDS: &[(&str, &str, &str)] = &[
    ("sphere", "shape", ""),
    ("sphere", "shape.sphere", ""),
    ("sphere", "shape.sphere.radius_mm", "half"),
    ("sphere", "shape.sphere.x_mm", "minus zero half tiny absent"),
    ("sphere", "shape.sphere.y_mm", "minus zero half tiny absent"),
    ("sphere", "shape.sphere.tilt_rad", "absent"),
    ("cylinder", "shape.cylinder.radius_mm", "half"),
    ("cylinder", "shape.cylinder.length_mm", "half null absent"),
    ("cylinder", "shape.cylinder.x_mm", "minus zero half tiny absent"),
    ("cylinder", "shape.cylinder.y_mm", "minus zero half tiny absent"),
    ("cylinder", "shape.cylinder.rot_rad", "minus zero half tiny absent"),
    ("cylinder", "shape.cylinder.tilt_rad", "zero tiny absent"),
    ("bar", "shape.bar.width_mm", "half"),
    ("bar", "shape.bar.length_mm", "half null absent"),
    ("bar", "shape.bar.rot_rad", "minus zero half tiny absent"),
    ("bar", "shape.bar.tilt_rad", "zero tiny absent"),
    ("edge", "shape.edge.length_mm", "half null absent"),
    ("edge", "shape.edge.x_mm", "minus zero half tiny absent"),
    ("edge", "shape.edge.rot_rad", "minus zero half tiny absent"),
    ("sphere", "t_mm", "half"),
    ("sphere", "nu", "zero half tiny"),
    ("sphere", "youngs_mpa", "half absent"),
    ("sphere", "force_n", "zero half"),
    ("cylinder", "force_n", "zero half"),
    ("bar", "force_n", "zero half"),
    ("edge", "force_n", "zero half"),
    ("sphere", "rows", "absent"),
    ("sphere", "cols", "absent"),
    ("sphere", "pitch_mm", "half absent"),
    ("sphere", "sampling", "absent"),
    ("sphere", "part", "absent"),
    ("sphere", "level", "absent"),
    ("sphere", "start", "absent"),
    ("sphere", "repeat", "absent"),
    ("sphere", "timing", "truth absent"),
    ("sphere", "depth_mm", "absent"),
];

fn good(shape: &str) -> Value {
    let inner = match shape {
        "sphere" => json!({"radius_mm": 10}),
        "cylinder" => json!({"radius_mm": 23, "length_mm": 5}),
        "bar" => json!({"width_mm": 2, "length_mm": 5}),
        _ => json!({"length_mm": 5}),
    };
    json!({
        "op": "contact_3d", "shape": {shape: inner}, "t_mm": 0.8, "nu": 0.45, "force_n": 0.5,
        "rows": 2, "cols": 2, "level": "fast",
    })
}

/// The request with one field replaced.
fn with(mut request: Value, path: &str, value: &str) -> String {
    let mut at = &mut request;
    let mut parts = path.split('.').peekable();
    while let Some(part) = parts.next() {
        if parts.peek().is_some() {
            at = &mut at[part];
        } else if value == ABSENT {
            at.as_object_mut().unwrap().remove(part);
        } else {
            at[part] = json!(PLACEHOLDER);
        }
    }
    request.to_string().replace(&json!(PLACEHOLDER).to_string(), value)
}

/// The complaint about an answer to an invalid field; `None` when the answer is a correct error.
fn answer_complaint(answer: &Value, path: &str, value: &str) -> Option<String> {
    let error = &answer["error"];
    let text = |name: &str| error[name].as_str().unwrap_or("").to_owned();
    let (code, field, message) = (text("code"), text("field"), text("message"));
    if answer["ok"] != false || code.is_empty() || code == "internal" {
        return Some(answer.to_string());
    }
    // Invalid JSON has no fields.
    if ["NaN", "1e999", ""].contains(&value) {
        return (code != "bad_json").then(|| answer.to_string());
    }
    let within = |inner: &str, outer: &str| inner.starts_with(&format!("{outer}."));
    let inside = path == field || within(&field, path) || within(path, &field);
    let named = inside && message.contains(&format!("`{field}`"));
    let advised = ["wanted: ", "known: ", "; ", "is missing: ", "exactly one", "give "];
    let advised = advised.iter().any(|words| message.contains(words));
    (!named || !advised).then(|| answer.to_string())
}

#[test]
fn every_invalid_field_is_an_error_and_the_filter_goes_on() {
    let (mut text, mut cases) = (String::new(), Vec::new());
    for (shape, path, sound) in FIELDS {
        for (name, value) in INVALID_VALUES {
            let sound = sound.split(' ').any(|word| word == name);
            let request = with(good(shape), path, value);
            text.push_str(&format!("{request}\n{}\n", good(shape)));
            cases.push((request, *path, value, sound));
        }
    }
    let answers = ask_text(text.as_bytes());
    assert_eq!(answers.len(), 2 * cases.len(), "one line each");
    let mut faults = Vec::new();
    for ((request, path, value, sound), pair) in cases.iter().zip(answers.chunks_exact(2)) {
        assert_eq!(pair[1]["ok"], true, "the filter goes on after {request}");
        if *sound {
            if pair[0]["ok"] != true {
                faults.push(format!("{request}: refused: {}", pair[0]));
            }
        } else if let Some(fault) = answer_complaint(&pair[0], path, value) {
            faults.push(format!("{request}: {fault}"));
        }
    }
    assert!(faults.is_empty(), "{} of {}:\n{}", faults.len(), cases.len(), faults.join("\n"));
}
