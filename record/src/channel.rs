//! A channel as it stands in a log: what a writer makes of a signal, and what a reader found.

use std::collections::BTreeMap;

use taktil_rtcore::record::{Catalog, Signal};

use crate::schema::{schema_text, topic};

/// A channel as it stands in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ChannelSource {
    /// Name of the schema.
    pub(crate) schema: String,
    /// Text of the schema.
    pub(crate) fields: String,
    pub(crate) topic: String,
    /// Signal, lane, period and so on.
    pub(crate) about: BTreeMap<String, String>,
    /// Bytes of a body; of a channel that was read with the padding in front of its CRC.
    pub(crate) size: usize,
    pub(crate) padded: bool,
}

impl ChannelSource {
    /// The channels of all signals of a machine.
    pub(crate) fn of_catalog(catalog: &Catalog) -> Vec<ChannelSource> {
        let channel = |signal: &Signal| {
            let mut about = BTreeMap::from([("signal".to_owned(), signal.name.clone())]);
            if let Some(lane) = catalog.lanes.get(signal.lane) {
                about.insert("lane".to_owned(), lane.name.clone());
                about.insert("period_ns".to_owned(), lane.period.0.to_string());
                about.insert("phase_ns".to_owned(), lane.phase.0.to_string());
                if signal.name == format!("{}.state", lane.name) {
                    about.insert("elements".to_owned(), lane.tasks.join(","));
                } else if signal.name == format!("{}.decision", lane.name) {
                    about.insert("elements".to_owned(), lane.reads.join(","));
                }
            }
            ChannelSource {
                schema: format!("taktil/msg/{}", signal.type_name),
                fields: schema_text(&signal.fields),
                topic: topic(&signal.name),
                about,
                size: signal.size,
                padded: false,
            }
        };
        catalog.signals.iter().map(channel).collect()
    }
}
