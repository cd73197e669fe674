//! The schema of scenes and their parser agree on every scene, and on scenes with one error. The
//! validator here supports only the keywords that the schema uses; another keyword is a failure.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use taktil_lab_scene::assembly::load_checked_scene;
use taktil_lab_scene::scene::Scene;
use taktil_lab_scene::schema::schema;
use taktil_machine::source::{FileKind, Source};
use taktil_signal::{JogFrame, Verb};

/// The first place at which a value violates a schema.
fn violation(schema: &Value, value: &Value, place: &str) -> Option<String> {
    let rules = schema.as_object().expect("a schema is an object");
    rules.iter().find_map(|(word, rule)| match word.as_str() {
        "type" => (!is_type(rule.as_str().unwrap(), value)).then(|| place.to_owned()),
        "enum" => (!rule.as_array().unwrap().contains(value)).then(|| place.to_owned()),
        "minimum" => (value.as_f64()? < rule.as_f64().unwrap()).then(|| place.to_owned()),
        "maximum" => (value.as_f64()? > rule.as_f64().unwrap()).then(|| place.to_owned()),
        "minItems" | "maxItems" => {
            (value.as_array()?.len() as u64 != rule.as_u64().unwrap()).then(|| place.to_owned())
        }
        "items" => value
            .as_array()?
            .iter()
            .enumerate()
            .find_map(|(i, item)| violation(rule, item, &format!("{place}[{i}]"))),
        "anyOf" => {
            let any = rule.as_array().unwrap();
            any.iter().all(|one| violation(one, value, place).is_some()).then(|| place.to_owned())
        }
        "required" => rule.as_array().unwrap().iter().find_map(|key| {
            let key = key.as_str().unwrap();
            value.as_object()?.get(key).is_none().then(|| format!("{place}.{key}"))
        }),
        "properties" => value.as_object()?.iter().find_map(|(key, inner)| {
            rule.get(key).and_then(|rule| violation(rule, inner, &format!("{place}.{key}")))
        }),
        "additionalProperties" => value.as_object()?.iter().find_map(|(key, inner)| {
            let known = rules.get("properties").and_then(|known| known.get(key)).is_some();
            let place = format!("{place}.{key}");
            match rule {
                Value::Bool(false) => (!known).then_some(place),
                rule => violation(rule, inner, &place),
            }
        }),
        "description" | "title" | "$schema" => None,
        other => panic!("{place}: the schema uses `{other}`, which this validator does not know"),
    })
}

fn is_type(name: &str, value: &Value) -> bool {
    match name {
        "number" => value.is_number(),
        "integer" => value.is_i64() || value.is_u64(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        other => panic!("a type `{other}`"),
    }
}

fn scenes() -> Vec<PathBuf> {
    scenes_in("")
}

fn scenes_in(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes").join(folder);
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut scenes: Vec<_> =
        files.filter(|path| path.extension().is_some_and(|ext| ext == "toml")).collect();
    scenes.sort();
    assert!(scenes.len() >= 9, "{scenes:?}");
    scenes
}

fn value_of(text: &str) -> Value {
    serde_json::to_value(text.parse::<toml::Table>().unwrap()).unwrap()
}

#[test]
fn every_scene_keeps_the_schema_and_can_be_run() {
    let schema = schema().unwrap();
    for path in ["", "held", "hard", "two-fingers"].into_iter().flat_map(scenes_in) {
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(violation(&schema, &value_of(&text), ""), None, "{}", path.display());
        load_checked_scene(&path).unwrap_or_else(|bad| panic!("{bad}"));
    }
}

/// The machine of a scene that names none.
const DEFAULT_MACHINE: &str = "machine/puma260.toml";

/// Whether the parser and its checks accept a text for a machine, with motions and arms from the
/// folder of the scenes.
fn accepted(text: String, machine: &str) -> bool {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes");
    let read =
        |name: &str| Source::read(&folder.join(name), FileKind::Motion).map_err(|bad| bad.what);
    let machine = Source::read(&folder.join(machine), FileKind::Machine).unwrap();
    Scene::of(Source { path: "scene.toml".into(), text }, Some(machine), &read).is_ok()
}

/// Paths of all leaves and tables of a value.
fn places(value: &toml::Value, here: &[String], found: &mut Vec<Vec<String>>) {
    found.push(here.to_vec());
    let mut into = |key: String, inner: &toml::Value| {
        let mut path = here.to_vec();
        path.push(key);
        places(inner, &path, found);
    };
    match value {
        toml::Value::Table(table) => table.iter().for_each(|(key, v)| into(key.clone(), v)),
        toml::Value::Array(list) => {
            list.iter().enumerate().for_each(|(i, v)| into(i.to_string(), v));
        }
        _ => {}
    }
}

fn at<'a>(value: &'a mut toml::Value, path: &[String]) -> &'a mut toml::Value {
    path.iter().fold(value, |value, key| match value {
        toml::Value::Array(list) => &mut list[key.parse::<usize>().unwrap()],
        table => &mut table[key.as_str()],
    })
}

#[test]
fn the_schema_and_the_parser_reject_the_same_scenes() {
    let schema = schema().unwrap();
    let mut tried = 0;
    for path in scenes() {
        let whole: toml::Value =
            std::fs::read_to_string(&path).unwrap().parse::<toml::Table>().map(Into::into).unwrap();
        let machine = whole["machine"].as_str().unwrap_or(DEFAULT_MACHINE);
        let mut all = Vec::new();
        places(&whole, &[], &mut all);
        for place in all {
            let mut changed = whole.clone();
            let spot = at(&mut changed, &place);
            match spot {
                // The two changes are a wrong type and an unknown key.
                toml::Value::Table(table) => {
                    // Names of lanes, wires and parameters are free.
                    table.insert("no_such_key".into(), toml::Value::Boolean(true));
                }
                toml::Value::String(_) => *spot = toml::Value::Boolean(false),
                toml::Value::Array(_) => *spot = toml::Value::Integer(1),
                _ => *spot = toml::Value::String("wide".into()),
            }
            let text = toml::to_string(&changed).unwrap();
            let sound = violation(&schema, &value_of(&text), "").is_none();
            assert_eq!(sound, accepted(text, machine), "{} {place:?}", path.display());
            assert!(!sound, "{} {place:?}: a change that changes nothing", path.display());
            tried += 1;
        }
    }
    assert!(tried > 300, "{tried}");
}

#[test]
fn every_stated_range_is_the_parsers() {
    let schema = schema().unwrap();
    let world = &schema["properties"]["world"]["properties"];
    let mut tried = 0;
    for section in ["arm", "finger", "pin", "table", "tactile"] {
        for (key, rule) in world[section]["properties"].as_object().unwrap() {
            let (Some(low), Some(high)) = (rule["minimum"].as_f64(), rule["maximum"].as_f64())
            else {
                continue;
            };
            for bad in [low - 1.0 - low.abs(), high + 1.0 + high.abs()] {
                let value = if rule["type"] == "integer" {
                    format!("{bad:.0}")
                } else {
                    format!("{bad:?}")
                };
                let text = format!("title = \"x\"\n[world.{section}]\n{key} = {value}\n");
                assert!(violation(&schema, &value_of(&text), "").is_some(), "{text}");
                assert!(!accepted(text.clone(), DEFAULT_MACHINE), "{text}");
                tried += 1;
            }
        }
    }
    assert!(tried > 40, "{tried}");
    assert_eq!(world["pin"]["properties"]["radius_mm"]["minimum"], json!(1.0));
}

/// Every property of a schema, with its path.
fn properties<'a>(schema: &'a Value, path: &str, found: &mut Vec<(String, &'a Value)>) {
    for (name, inner) in schema["properties"].as_object().into_iter().flatten() {
        let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
        found.push((path.clone(), inner));
        properties(inner, &path, found);
    }
    for one in schema["anyOf"].as_array().into_iter().flatten() {
        properties(one, path, found);
    }
    for (key, mark) in [("items", "[]"), ("additionalProperties", ".*")] {
        if schema[key].is_object() {
            properties(&schema[key], &format!("{path}{mark}"), found);
        }
    }
}

#[test]
fn every_key_says_what_it_means() {
    let schema = schema().unwrap();
    let mut all = Vec::new();
    properties(&schema, "", &mut all);
    assert!(all.len() >= 400, "{}", all.len());
    let about = |rule: &Value| rule["description"].as_str().unwrap_or_default().to_owned();
    let silent: Vec<_> = all.iter().filter(|(_, rule)| about(rule).len() < 5).collect();
    assert!(silent.is_empty(), "{silent:?}");
    for (path, rule) in &all {
        let about = about(rule);
        // Links in doc comments lead nowhere in an editor.
        assert!(!about.contains("[`") && !about.contains("::"), "{path}: {about}");
        for word in rule["enum"].as_array().into_iter().flatten() {
            let line = format!("\n- `{}`: ", word.as_str().unwrap());
            let (_, told) = about.split_once(&line).unwrap_or_else(|| panic!("{path}: {line}"));
            assert!(told.starts_with(char::is_alphanumeric) || told.starts_with('`'), "{told}");
        }
    }
}

#[test]
fn a_key_is_described_in_the_words_of_its_declaration() {
    let schema = schema().unwrap();
    let mut all = Vec::new();
    properties(&schema, "", &mut all);
    let about = |path: &str| {
        let (_, rule) = all.iter().find(|(at, _)| at == path).expect(path);
        rule["description"].as_str().and_then(|about| about.lines().next()).expect(path)
    };
    let declared = [
        ("seed", "lab/scene/src/scene.rs", "seed: u64,"),
        ("operator[].half_cycles", "lab/scene/src/scene/script.rs", "half_cycles: Option<u32>,"),
        ("contract.fifo", "machine/src/contract.rs", "fifo: Option<WeightName>,"),
        ("robot.lane.*.phase_us", "machine/src/config.rs", "pub phase_us: i64,"),
        ("robot.lane.*.misses.bucket", "machine/src/config.rs", "pub bucket: u32,"),
        ("robot.jog.key_timeout_s", "tasks/jog/src/lib.rs", "pub key_timeout_s: f64,"),
        (
            "robot.opposed_scan.response.exponent",
            "tasks/tactile_scan/src/response.rs",
            "pub exponent: f64,",
        ),
        (
            "robot.tactile_servo.task_frame.feature[].jacobian",
            "tasks/tactile_servo/src/config/task_frame.rs",
            "pub jacobian: Vec<f64>,",
        ),
        ("world.tactile.driver_ohm", "sim/src/scene/tactile.rs", "driver_ohm: f64 [0.0, 1e6],"),
    ];
    for (path, file, field) in declared {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(file);
        let text = std::fs::read_to_string(file).unwrap();
        let mut above: Vec<_> = text
            .lines()
            .take_while(|line| line.trim() != field)
            .map(str::trim)
            .filter(|line| !line.starts_with("#["))
            .collect();
        let from = above.iter().rposition(|line| !line.starts_with("///")).unwrap();
        let comment: Vec<_> =
            above.split_off(from + 1).iter().map(|line| line[3..].trim()).collect();
        assert_eq!(about(path), comment.join(" "), "{path}");
    }
    // The description names every word of a key that accepts one of several words.
    for verb in &Verb::ALL[1..] {
        assert!(about("operator[].verb").contains(&format!("`{}`", verb.name())), "{verb:?}");
    }
    for frame in JogFrame::ALL {
        assert!(about("operator[].frame").contains(&format!("`{}`", frame.name())), "{frame:?}");
    }
}
