//! The channels that viewers may subscribe to, made from what the machine tells of its arm and its
//! signals.

use data_encoding::BASE64;
use serde_json::{Map, Value, json};
use taktil_machine_foxglove::view::{
    BODIES_TOPIC, DESCRIPTION_FIELDS, DESCRIPTION_SCHEMA, DESCRIPTION_TOPIC, FRAMES_TOPIC,
    JOINTS_SIGNAL, JOINTS_TOPIC, LINKS_TOPIC, image_topic,
};
use taktil_machine_foxglove::{MESSAGE_ENCODING, descriptor_set};

/// What the messages of a channel are made of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Content {
    /// Angles, speeds and torques of the joints.
    Joints,
    /// The frames of the links, and of pin and table.
    Frames,
    /// Pin, table and array; told once.
    Bodies,
    /// The links of the arm; told once.
    Links,
    /// The arm in URDF; told once.
    Description,
    /// The image of a signal.
    Image(String),
    /// A signal with all its fields.
    Signal(String),
}

impl Content {
    /// Whether a viewer is told once and when it changes, instead of at a rate.
    pub(super) fn is_told_once(&self) -> bool {
        matches!(self, Content::Bodies | Content::Links | Content::Description)
    }

    /// What has to be asked of the machine beyond what every page gets.
    pub(super) fn wanted(&self) -> Option<String> {
        match self {
            Content::Joints => Some(format!("{JOINTS_SIGNAL}.qd_rad_s")),
            Content::Signal(signal) => Some(signal.clone()),
            _ => None,
        }
    }
}

/// A channel as it is advertised.
#[derive(Clone, Debug)]
pub(super) struct ViewChannel {
    /// Its number, which is not given twice by a server.
    pub(super) id: u32,
    pub(super) content: Content,
    about: Value,
}

/// The topic of a signal, as recordings name it: `task.port` is `/task/port`.
fn topic(signal: &str) -> String {
    let letter = |c: char| match c {
        '.' => '/',
        c if c.is_ascii_alphanumeric() => c,
        _ => '_',
    };
    std::iter::once('/').chain(signal.chars().map(letter)).collect()
}

/// The fields of a signal as a schema of JSON.
fn json_schema(signal: &str, fields: &[Value]) -> String {
    let property = |field: &Value| {
        let is_list = field["count"].as_u64().is_some_and(|count| count > 1);
        let number = json!({ "type": "number" });
        let kind = if is_list { json!({ "type": "array", "items": number }) } else { number };
        (field["name"].as_str().unwrap_or_default().to_owned(), kind)
    };
    let properties: Map<String, Value> = fields.iter().map(property).collect();
    json!({ "title": signal, "type": "object", "properties": properties }).to_string()
}

/// All channels of a machine, by its list of signals; numbers begin at `first`.
pub(super) fn channels(signals: &Value, first: u32) -> Vec<ViewChannel> {
    let schema = BASE64.encode(&descriptor_set());
    let known = |content: Content, topic: &str, name: &str| {
        let about = json!({
            "topic": topic,
            "encoding": MESSAGE_ENCODING,
            "schemaName": format!("foxglove.{name}"),
            "schema": schema,
            "schemaEncoding": MESSAGE_ENCODING,
        });
        (content, about)
    };
    let description = json!({
        "topic": DESCRIPTION_TOPIC,
        "encoding": "cdr",
        "schemaName": DESCRIPTION_SCHEMA,
        "schema": DESCRIPTION_FIELDS,
        "schemaEncoding": "ros2msg",
    });
    let mut all = vec![
        known(Content::Joints, JOINTS_TOPIC, "JointStates"),
        known(Content::Frames, FRAMES_TOPIC, "FrameTransforms"),
        known(Content::Bodies, BODIES_TOPIC, "SceneUpdate"),
        known(Content::Links, LINKS_TOPIC, "SceneUpdate"),
        (Content::Description, description),
    ];
    let none = Map::new();
    let signals = signals.as_object().unwrap_or(&none);
    let fields_of = |fields: &Value| fields.as_array().cloned().unwrap_or_default();
    for (signal, fields) in signals {
        let fields = fields_of(fields);
        let has = |name: &str| fields.iter().any(|field| field["name"] == name);
        if signal.ends_with(".image") && ["rows", "cols", "counts"].into_iter().all(has) {
            let content = Content::Image(signal.clone());
            all.push(known(content, &image_topic(&topic(signal)), "RawImage"));
        }
        let about = json!({
            "topic": topic(signal),
            "encoding": "json",
            "schemaName": signal,
            "schema": json_schema(signal, &fields),
            "schemaEncoding": "jsonschema",
        });
        all.push((Content::Signal(signal.clone()), about));
    }
    let numbered = (first..).zip(all);
    numbered.map(|(id, (content, about))| ViewChannel { id, content, about }).collect()
}

/// The message that tells viewers of channels.
pub(super) fn advertisement(channels: &[ViewChannel]) -> String {
    let one = |channel: &ViewChannel| {
        let mut about = channel.about.clone();
        about["id"] = json!(channel.id);
        about
    };
    json!({ "op": "advertise", "channels": channels.iter().map(one).collect::<Value>() })
        .to_string()
}

/// The message that takes channels back.
pub(super) fn withdrawal(channels: &[u32]) -> String {
    json!({ "op": "unadvertise", "channelIds": channels }).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_signal_is_a_channel_and_images_are_two() {
        let field = |name: &str, count: u32| json!({ "name": name, "count": count });
        let signals = json!({
            "tactile_scan.image": [field("rows", 1), field("cols", 1), field("counts", 256)],
            "sense.joints": [field("q_rad", 6)],
        });
        let all = channels(&signals, 20);
        let told: Value = serde_json::from_str(&advertisement(&all)).unwrap();
        let told = told["channels"].as_array().unwrap();
        let topics: Vec<&str> = told.iter().map(|one| one["topic"].as_str().unwrap()).collect();
        assert_eq!(
            topics,
            [
                "/viewer/joints",
                "/viewer/frames",
                "/viewer/scene",
                "/viewer/arm",
                "/robot_description",
                "/sense/joints",
                "/viewer/tactile_scan/image",
                "/tactile_scan/image",
            ]
        );
        assert_eq!((told[0]["id"].as_u64(), told[7]["id"].as_u64()), (Some(20), Some(27)));
        let schema: Value = serde_json::from_str(told[7]["schema"].as_str().unwrap()).unwrap();
        assert_eq!(schema["properties"]["counts"]["type"], "array");
        assert_eq!(schema["properties"]["rows"]["type"], "number");
        assert_eq!(told[0]["schemaEncoding"], "protobuf");
        // Without any signal the arm is offered all the same.
        assert_eq!(channels(&Value::Null, 1).len(), 5);
    }
}
