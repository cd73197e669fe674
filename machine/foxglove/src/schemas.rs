//! Describes the well-known messages in protobuf's own terms: a set of file descriptors that a
//! reader needs to decode them. Fields that are never written here are left out.

use crate::protobuf::Message;

/// Types of fields as `google.protobuf.FieldDescriptorProto.Type` numbers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FieldType {
    Double = 1,
    Int64 = 3,
    Int32 = 5,
    Fixed32 = 7,
    Bool = 8,
    Text = 9,
    Message = 11,
    Bytes = 12,
}

/// A field of a message: name, number, type, the message that it holds, and whether it stands there
/// any number of times.
struct FieldRow(&'static str, u32, FieldType, &'static str, bool);

/// A message with its fields.
struct MessageRow(&'static str, &'static [FieldRow]);

const TIMESTAMP_TYPE: &str = ".google.protobuf.Timestamp";

const fn plain(name: &'static str, number: u32, kind: FieldType) -> FieldRow {
    FieldRow(name, number, kind, "", false)
}

const fn nested(name: &'static str, number: u32, message: &'static str) -> FieldRow {
    FieldRow(name, number, FieldType::Message, message, false)
}

const fn list(name: &'static str, number: u32, message: &'static str) -> FieldRow {
    FieldRow(name, number, FieldType::Message, message, true)
}

/// `google.protobuf.Timestamp`.
const TIMESTAMP_MESSAGES: [MessageRow; 1] = [MessageRow(
    "Timestamp",
    &[plain("seconds", 1, FieldType::Int64), plain("nanos", 2, FieldType::Int32)],
)];

/// The messages of the package `foxglove`, with the numbers of its public definitions.
const FOXGLOVE_MESSAGES: [MessageRow; 13] = [
    MessageRow(
        "Vector3",
        &[
            plain("x", 1, FieldType::Double),
            plain("y", 2, FieldType::Double),
            plain("z", 3, FieldType::Double),
        ],
    ),
    MessageRow(
        "Quaternion",
        &[
            plain("x", 1, FieldType::Double),
            plain("y", 2, FieldType::Double),
            plain("z", 3, FieldType::Double),
            plain("w", 4, FieldType::Double),
        ],
    ),
    MessageRow(
        "Pose",
        &[
            nested("position", 1, ".foxglove.Vector3"),
            nested("orientation", 2, ".foxglove.Quaternion"),
        ],
    ),
    MessageRow(
        "Color",
        &[
            plain("r", 1, FieldType::Double),
            plain("g", 2, FieldType::Double),
            plain("b", 3, FieldType::Double),
            plain("a", 4, FieldType::Double),
        ],
    ),
    MessageRow(
        "FrameTransform",
        &[
            nested("timestamp", 1, TIMESTAMP_TYPE),
            plain("parent_frame_id", 2, FieldType::Text),
            plain("child_frame_id", 3, FieldType::Text),
            nested("translation", 4, ".foxglove.Vector3"),
            nested("rotation", 5, ".foxglove.Quaternion"),
        ],
    ),
    MessageRow("FrameTransforms", &[list("transforms", 1, ".foxglove.FrameTransform")]),
    MessageRow(
        "JointState",
        &[
            plain("name", 1, FieldType::Text),
            plain("position", 2, FieldType::Double),
            plain("velocity", 3, FieldType::Double),
            plain("effort", 5, FieldType::Double),
        ],
    ),
    MessageRow(
        "JointStates",
        &[nested("timestamp", 1, TIMESTAMP_TYPE), list("joints", 2, ".foxglove.JointState")],
    ),
    MessageRow(
        "RawImage",
        &[
            nested("timestamp", 1, TIMESTAMP_TYPE),
            plain("width", 2, FieldType::Fixed32),
            plain("height", 3, FieldType::Fixed32),
            plain("encoding", 4, FieldType::Text),
            plain("step", 5, FieldType::Fixed32),
            plain("data", 6, FieldType::Bytes),
            plain("frame_id", 7, FieldType::Text),
        ],
    ),
    MessageRow(
        "CubePrimitive",
        &[
            nested("pose", 1, ".foxglove.Pose"),
            nested("size", 2, ".foxglove.Vector3"),
            nested("color", 3, ".foxglove.Color"),
        ],
    ),
    MessageRow(
        "CylinderPrimitive",
        &[
            nested("pose", 1, ".foxglove.Pose"),
            nested("size", 2, ".foxglove.Vector3"),
            plain("bottom_scale", 3, FieldType::Double),
            plain("top_scale", 4, FieldType::Double),
            nested("color", 5, ".foxglove.Color"),
        ],
    ),
    MessageRow(
        "SceneEntity",
        &[
            nested("timestamp", 1, TIMESTAMP_TYPE),
            plain("frame_id", 2, FieldType::Text),
            plain("id", 3, FieldType::Text),
            plain("frame_locked", 5, FieldType::Bool),
            list("cubes", 8, ".foxglove.CubePrimitive"),
            list("cylinders", 10, ".foxglove.CylinderPrimitive"),
        ],
    ),
    MessageRow("SceneUpdate", &[list("entities", 2, ".foxglove.SceneEntity")]),
];

/// The label of a field: it stands there at most once, or any number of times.
const LABEL_OPTIONAL_NUMBER: u64 = 1;
const LABEL_REPEATED_NUMBER: u64 = 3;

impl FieldRow {
    /// As `google.protobuf.FieldDescriptorProto`.
    fn descriptor(&self) -> Message {
        let FieldRow(name, number, kind, message, is_list) = self;
        let label = if *is_list { LABEL_REPEATED_NUMBER } else { LABEL_OPTIONAL_NUMBER };
        let field = Message::default()
            .bytes(1, name)
            .integer(3, u64::from(*number))
            .integer(4, label)
            .integer(5, *kind as u64);
        if message.is_empty() { field } else { field.bytes(6, message) }
    }
}

impl MessageRow {
    /// As `google.protobuf.DescriptorProto`.
    fn descriptor(&self) -> Message {
        let MessageRow(name, fields) = self;
        Message::default().bytes(1, name).repeated(2, fields.iter().map(FieldRow::descriptor))
    }
}

/// As `google.protobuf.FileDescriptorProto`.
fn file(name: &str, package: &str, needs: &[&str], messages: &[MessageRow]) -> Message {
    let file = Message::default().bytes(1, name).bytes(2, package);
    let file = needs.iter().fold(file, |file, needed| file.bytes(3, needed));
    file.repeated(4, messages.iter().map(MessageRow::descriptor)).bytes(12, "proto3")
}

/// The description of all messages, as `google.protobuf.FileDescriptorSet`: the content of a schema
/// record whose encoding is `protobuf`.
pub fn descriptor_set() -> Vec<u8> {
    let timestamp = "google/protobuf/timestamp.proto";
    let files = [
        file(timestamp, "google.protobuf", &[], &TIMESTAMP_MESSAGES),
        file("foxglove/taktil.proto", "foxglove", &[timestamp], &FOXGLOVE_MESSAGES),
    ];
    Message::default().repeated(1, files).into_bytes()
}
