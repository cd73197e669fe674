//! Recordings read back; they are written by [`taktild::log`]. Refuses files of other programs.

mod reader;

pub use reader::{Channel, Damage, Log, Message, bytes};
pub use taktild::log::{
    FieldInfo, METADATA_ATTESTATION, METADATA_RESULT, METADATA_RUN, McapLog, SchemaError,
    parse_schema, schema_text, topic,
};
