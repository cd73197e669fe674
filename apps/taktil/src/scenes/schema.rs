//! The scene file as JSON Schema (2020-12): keys, types and which keys are needed are what the
//! parser asks for, ranges and meanings of `[world]` what its check reads. Refuses to state
//! anything twice: what stands here is asked of the declarations when it is printed.

use serde_json::{Map, Value, json};
use taktil_sim::WorldConfig;
use taktil_sim::scene::section::Key;
use taktild::contract::{Items, WORDS};

use super::probe::{self, Field, Shape};
use crate::run::scene;

/// The schema of a scene file.
///
/// # Errors
/// A declaration that cannot be asked.
pub fn schema() -> Result<Value, String> {
    let mut keys = WorldConfig::keys();
    for key in &mut keys {
        key.path = format!("world.{}", key.path);
    }
    let mut schema = of(&scene::shape()?, "", &keys)?;
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
            let items = of(&probe::shape::<Items>()?, path, keys)?;
            json!({ "anyOf": [{ "enum": WORDS }, items] })
        }
        // What it takes is known to the program that has the task.
        Shape::Any if path.ends_with(".own.*.*") => json!({}),
        Shape::Any => return Err(format!("{path}: what may stand there is stated nowhere")),
    };
    if let Some(key) = keys.iter().find(|key| key.path == path) {
        if !key.about.is_empty() {
            let words: Vec<_> = key.about.split_whitespace().collect();
            schema["description"] = json!(words.join(" "));
        }
        if let Some((low, high)) = key.range {
            schema["minimum"] = json!(low);
            schema["maximum"] = json!(high);
        }
    }
    Ok(schema)
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
