//! The scene file as JSON Schema (2020-12). Keys, types and required keys come from the parser,
//! meanings from the doc comments of the declarations, and ranges of `[world]` from its check.
//! Nothing is stated twice: the schema is derived from the declarations when it is printed.

use serde_json::{Map, Value, json};
use taktil_machine::contract::{CONTRACT_NAMES, Items};
use taktil_rtcore::explain::Key;

use super::probe::{self, Field, Shape};
use crate::scene;

/// The schema of a scene file.
///
/// # Errors
/// A declaration that cannot be probed.
pub fn schema() -> Result<Value, String> {
    let mut schema = of(&scene::shape()?, "", &scene::keys())?;
    if let Some(schema) = schema.as_object_mut() {
        schema.insert("$schema".into(), "https://json-schema.org/draft/2020-12/schema".into());
        schema.insert("title".into(), "Taktil scene".into());
    }
    Ok(schema)
}

fn of(shape: &Shape, path: &str, keys: &[Key]) -> Result<Value, String> {
    let mut schema = match shape {
        Shape::Number => json!({ "type": "number" }),
        Shape::Integer(true) => json!({ "type": "integer" }),
        Shape::Integer(false) => json!({ "type": "integer", "minimum": 0 }),
        Shape::Boolean => json!({ "type": "boolean" }),
        Shape::Text => json!({ "type": "string" }),
        Shape::Names(names) => json!({ "enum": names }),
        Shape::List(inner, length) => {
            let items = of(inner, &format!("{path}[]"), keys)?;
            let mut list = json!({ "type": "array", "items": items });
            if let Some(length) = length {
                list["minItems"] = json!(length);
                list["maxItems"] = json!(length);
            }
            list
        }
        Shape::Map(inner) => {
            let inner = of(inner, &format!("{path}.*"), keys)?;
            json!({ "type": "object", "additionalProperties": inner })
        }
        Shape::Section(fields) => section(fields, path, keys)?,
        Shape::Any if path == "contract" => {
            let Shape::Section(items) = probe::shape::<Items>()? else {
                return Err(format!("{path}: its items are no table"));
            };
            json!({ "anyOf": [{ "enum": CONTRACT_NAMES }, section(&items, path, keys)?] })
        }
        // Only the program that has the task knows the keys of its section.
        Shape::Any if [".own.*.*", ".device.*.*"].iter().any(|end| path.ends_with(end)) => {
            json!({})
        }
        Shape::Any => return Err(format!("{path}: what may stand there is stated nowhere")),
    };
    if let Some(key) = keys.iter().find(|key| key.path == path) {
        let about = about(key, shape);
        if !about.is_empty() {
            schema["description"] = json!(about);
        }
        if let Some((low, high)) = key.range {
            schema["minimum"] = json!(low);
            schema["maximum"] = json!(high);
        }
    }
    Ok(schema)
}

/// The description of a key in an editor: its meaning, then a line for each of its words.
fn about(key: &Key, shape: &Shape) -> String {
    let mut lines = vec![plain(&key.about)];
    if let Shape::Names(names) = shape {
        let named = names.iter().zip(key.words);
        lines.extend(named.map(|(name, about)| format!("- `{name}`: {}", plain(about))));
    }
    lines.retain(|line| !line.is_empty());
    lines.join("\n")
}

/// A doc comment on one line, with links replaced by their names.
fn plain(about: &str) -> String {
    let words: Vec<_> = about.split_whitespace().collect();
    words.join(" ").replace("[`", "`").replace("`]", "`")
}

fn section(fields: &[Field], path: &str, keys: &[Key]) -> Result<Value, String> {
    let mut properties = Map::new();
    for field in fields {
        let dot = if path.is_empty() { "" } else { "." };
        let inner = of(&field.shape, &format!("{path}{dot}{}", field.name), keys)?;
        properties.insert(field.name.to_owned(), inner);
    }
    let required: Vec<_> = fields.iter().filter(|f| f.required).map(|f| f.name).collect();
    let mut section =
        json!({ "type": "object", "properties": properties, "additionalProperties": false });
    if !required.is_empty() {
        section["required"] = json!(required);
    }
    Ok(section)
}
