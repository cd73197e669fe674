//! Writing recordings: MCAP files with one channel a signal, readable by ROS 2 tools and by the
//! Python `mcap` reader. Refuses compression and chunks: a run that is cut short loses nothing but
//! the record being cut.
//!
//! Every message is `tick`, `release_ns`, the payload's fields and a CRC-32 of the bytes before it.
//! Times in a file are logical releases in ns since the start of the run, so that two runs of one
//! seed write the same messages bit for bit.

pub mod flight;
pub mod granted;
mod reader;
pub mod schema;
pub mod series;
pub mod summary;
mod writer;

pub use reader::{Channel, Damage, Log, Message, bytes};
pub use schema::{FieldInfo, SchemaError, parse_schema, schema_text, topic};
pub use writer::McapLog;

/// Name of the metadata record that is written before the first message.
pub const METADATA_RUN: &str = "taktil.run";
/// Name of the metadata record that holds what the kernel granted; it precedes the first message.
pub const METADATA_ATTESTATION: &str = "taktil.attestation";
/// Name of the metadata record that [`McapLog::finish_with`] writes after the last message.
pub const METADATA_RESULT: &str = "taktil.result";

/// Bytes of the CDR encapsulation header in front of a body.
pub const CDR_HEADER: usize = 4;
/// Bytes of `tick` and `release_ns` in front of a payload.
pub const STAMP: usize = 16;
/// Bytes of the closing CRC.
pub const CRC: usize = 4;
