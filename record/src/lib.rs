//! Writes and reads recordings: MCAP files with one channel for each signal, which ROS 2 tools and
//! the Python `mcap` reader can open. They are written in chunks of a tenth of a second with an
//! index at the end, not compressed; of a file that was cut every message up to the cut is read.
//!
//! Every message holds `tick`, `release_ns`, the payload's fields and a CRC-32 of the bytes before
//! it. Times in a file are logical releases in ns since the start of the run, so that two runs with
//! the same seed write the same messages bit for bit.
//!
//! This example writes one value of a signal and reads it back as a column of numbers:
//!
//! ```
//! use std::collections::BTreeMap;
//! use taktil_record::{Log, McapLog};
//! use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record, Signal};
//! use taktil_rtcore::{Nanos, Payload, payload};
//!
//! payload! {
//!     /// What a force sensor measures.
//!     pub struct Force {
//!         /// Normal force (N).
//!         pub normal_n: f64,
//!     }
//! }
//!
//! # fn main() -> anyhow::Result<()> {
//! // An executor gives the catalog and calls `record`; here both are made by hand.
//! let (name, type_name) = ("wrist.force".to_owned(), Force::NAME.into());
//! let (fields, size) = (Force::FIELDS.into(), Force::SIZE);
//! let signal = Signal { name, lane: 0, type_name, fields, size };
//! let catalog = Catalog { signals: vec![signal], lanes: vec![LaneInfo::default()] };
//! let mut body = vec![0; Force::SIZE];
//! Force { normal_n: 4.5 }.encode(&mut body);
//! let path = std::env::temp_dir().join(format!("record-example-{}.mcap", std::process::id()));
//! let mut writer = McapLog::create(&path, &catalog, &BTreeMap::new())?;
//! writer.record(&Record { signal: 0, tick: 1, release: Nanos::from_millis(5), body: &body });
//! writer.finish()?;
//!
//! let log = Log::open(&path)?;
//! let series = log.series("wrist.force").expect("the signal was recorded");
//! assert_eq!((series.t_s[0], series.values("normal_n", 0)), (0.005, vec![4.5]));
//! assert!(log.damage().is_none());
//! # std::fs::remove_file(&path)?;
//! # Ok(())
//! # }
//! ```

mod channel;
pub mod companion;
pub mod digest;
mod file;
pub mod flight;
mod gap;
pub mod granted;
pub mod joined;
mod reader;
pub mod recorder;
pub mod schema;
pub mod series;
pub mod summary;
mod writer;

pub use file::LogFile;
pub use gap::Gap;
pub use reader::{Channel, ChannelSchema, Damage, Log, Message, read_bytes};
pub use schema::{FieldInfo, SchemaError, parse_schema, schema_text, topic};
pub use writer::{CHUNK_SPAN, McapLog};

/// Name of the metadata record that is written before the first message.
pub const METADATA_RUN: &str = "taktil.run";
/// Key of [`METADATA_RUN`] in a log for viewers: what the times in the headers of messages are
/// ahead of those in their stamps (ns).
pub const TIME_BASE_KEY: &str = "time_base_ns";
/// Name of the metadata record that holds what the kernel granted; it precedes the first message.
pub const METADATA_ATTESTATION: &str = "taktil.attestation";
/// Name of the metadata record that stands where records are missing: a [`Gap`].
pub const METADATA_GAP: &str = "taktil.gap";
/// Name of the metadata record that says why a recorder ended a file before the run ended.
pub const METADATA_END: &str = "taktil.end";
/// Name of the metadata record that says of what damaged file a log was made.
pub const METADATA_RECOVERED: &str = "taktil.recovered";
/// Name of the metadata record that [`McapLog::finish_with`] writes after the last message.
pub const METADATA_RESULT: &str = "taktil.result";

/// Bytes of the CDR encapsulation header in front of a body.
pub const CDR_HEADER_BYTES: usize = 4;
/// Bytes of `tick` and `release_ns` in front of a payload.
pub const STAMP_BYTES: usize = 16;
/// Bytes of the closing CRC.
pub const CRC_BYTES: usize = 4;
