//! Channels that stand in a recording beside those of the signals, in encodings of their own: what
//! common viewers draw without being told how. Their messages are made of records by the thread
//! that writes the log, never by a lane.

use taktil_rtcore::Nanos;
use taktil_rtcore::record::{Catalog, Record};

use crate::FieldInfo;
use crate::schema::{parse_schema, schema_text};

/// A channel beside those of the signals.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompanionChannel {
    /// Its topic, which no signal has.
    pub topic: String,
    /// Name of its schema.
    pub schema: String,
    /// Encoding of the schema, such as `protobuf`.
    pub schema_encoding: &'static str,
    /// The schema itself.
    pub schema_bytes: Vec<u8>,
    /// Encoding of its messages.
    pub encoding: &'static str,
}

/// A file that is attached to a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompanionFile {
    /// Its name.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// Its bytes.
    pub data: Vec<u8>,
}

/// Makes the messages of such channels. A recording with a companion has times of the wall clock in
/// the headers of all its messages; their stamps keep the logical time.
pub trait Companion: Send {
    /// The channels, by whose place messages are appended.
    fn channels(&self) -> Vec<CompanionChannel>;

    /// The files that are attached at the beginning.
    fn files(&self) -> Vec<CompanionFile>;

    /// A file begins at an instant of the wall clock (ns since 1970): appends what is told once, as
    /// [`Companion::record`] does.
    fn begin(&mut self, at: Nanos, append: &mut dyn FnMut(usize, &[u8]));

    /// Appends the messages that belong to a record at an instant of the wall clock, each as the
    /// place of its channel and its bytes.
    fn record(&mut self, record: &Record<'_>, at: Nanos, append: &mut dyn FnMut(usize, &[u8]));
}

/// The fields of each signal of a machine, with their places in the body of a record.
#[must_use]
pub fn record_fields(catalog: &Catalog) -> Vec<Vec<FieldInfo>> {
    let fields_of = |text: String| {
        // A schema that was just written is read back; its stamp and CRC are no part of a record.
        let Ok(fields) = parse_schema(&text) else { return Vec::new() };
        let payload = fields[2..fields.len() - 1].iter();
        let moved = |field: &FieldInfo| FieldInfo {
            offset: field.offset - crate::STAMP_BYTES,
            ..field.clone()
        };
        payload.map(moved).collect()
    };
    catalog.signals.iter().map(|signal| fields_of(schema_text(&signal.fields))).collect()
}
