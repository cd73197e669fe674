//! The scene file as JSON Schema (2020-12): keys, types and which keys are needed are what the
//! parser asks for, ranges and meanings of `[world]` what its check reads. Refuses to state anything
//! twice: what stands here is asked of the declarations when it is printed.

use serde_json::{Map, Value, json};
use taktil_sim::WorldConfig;
use taktil_sim::scene::section::Key;

use super::probe::{Field, Shape};
use crate::run::scene;

/// The schema of a scene file.
///
/// # Errors
/// A declaration that cannot be asked.
pub fn schema() -> Result<Value, String> {
    let keys = WorldConfig::keys();
    let mut schema = of(&scene::shape()?, "", &keys);
    if let Some(schema) = schema.as_object_mut() {
        schema.insert("$schema".into(), "https://json-schema.org/draft/2020-12/schema".into());
        schema.insert("title".into(), "Taktil scene".into());
    }
    Ok(schema)
}

fn of(shape: &Shape, path: &str, keys: &[Key]) -> Value {
    let key = path.strip_prefix("world.").and_then(|path| keys.iter().find(|key| key.path == path));
    let mut schema = match shape {
        Shape::Number => json!({ "type": "number" }),
        Shape::Integer(true) => json!({ "type": "integer" }),
        Shape::Integer(false) => json!({ "type": "integer", "minimum": 0 }),
        Shape::Boolean => json!({ "type": "boolean" }),
        Shape::Text => json!({ "type": "string" }),
        Shape::Names(names) => json!({ "enum": names }),
        Shape::List(inner, length) => {
            let mut list =
                json!({ "type": "array", "items": of(inner, &format!("{path}[]"), keys) });
            if let Some(length) = length {
                list["minItems"] = json!(length);
                list["maxItems"] = json!(length);
            }
            list
        }
        Shape::Map(inner) => {
            json!({ "type": "object", "additionalProperties": of(inner, &format!("{path}.*"), keys) })
        }
        Shape::Section(fields) => section(fields, path, keys),
    };
    if let Some(key) = key {
        if !key.about.is_empty() {
            schema["description"] =
                json!(key.about.split_whitespace().collect::<Vec<_>>().join(" "));
        }
        if let Some((low, high)) = key.range {
            schema["minimum"] = json!(low);
            schema["maximum"] = json!(high);
        }
    }
    schema
}

fn section(fields: &[Field], path: &str, keys: &[Key]) -> Value {
    let mut properties = Map::new();
    for field in fields {
        let inner =
            if path.is_empty() { field.name.to_owned() } else { format!("{path}.{}", field.name) };
        properties.insert(field.name.to_owned(), of(&field.shape, &inner, keys));
    }
    let required: Vec<_> = fields.iter().filter(|f| f.required).map(|f| f.name).collect();
    let mut section =
        json!({ "type": "object", "properties": properties, "additionalProperties": false });
    if !required.is_empty() {
        section["required"] = json!(required);
    }
    section
}
