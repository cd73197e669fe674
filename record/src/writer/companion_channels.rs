//! Writes the channels and messages of a companion into a recording, beside those of the signals.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::Attachment;
use mcap::records::MessageHeader;
use taktil_rtcore::Nanos;

use super::{McapLog, header_time};
use crate::companion::{Companion, CompanionChannel};

impl<W: Write + Seek> McapLog<W> {
    /// Adds the channels of a companion, before the first message. From then on the times
    /// in headers are `time_base` ahead of those in stamps, as [`crate::TIME_BASE_KEY`] has to say.
    pub(crate) fn add_companion(&mut self, companion: &dyn Companion, time_base: Nanos) {
        if let Err(error) = self.try_add_companion(companion, time_base) {
            self.fail(error);
        }
    }

    fn try_add_companion(
        &mut self,
        companion: &dyn Companion,
        time_base: Nanos,
    ) -> mcap::McapResult<()> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        self.time_base = time_base;
        for channel in companion.channels() {
            let CompanionChannel { topic, schema, schema_encoding, schema_bytes, encoding } =
                channel;
            let schema = writer.add_schema(&schema, schema_encoding, &schema_bytes)?;
            self.companion_channels.push(writer.add_channel(
                schema,
                &topic,
                encoding,
                &BTreeMap::new(),
            )?);
        }
        Ok(())
    }

    /// Attaches the files of a companion, behind the first messages: an attachment ends a chunk,
    /// and viewers take one without a message for one of the year 1970.
    pub(crate) fn attach_companion_files(&mut self, companion: &dyn Companion) {
        let at = u64::try_from(self.time_base.0).unwrap_or(0);
        let (None, Some(writer)) = (&self.failed, &mut self.writer) else { return };
        let attached = companion.files().into_iter().try_for_each(|file| {
            writer.attach(&Attachment {
                log_time: at,
                create_time: at,
                name: file.name,
                media_type: file.media_type,
                data: file.data.into(),
            })
        });
        if let Err(error) = attached {
            self.fail(error);
        }
    }

    /// Writes a message of a companion's channel, by the channel's place, that belongs to a job's
    /// release.
    pub(crate) fn write_companion(&mut self, channel: usize, release: Nanos, body: &[u8]) {
        let Some(channel_id) = self.companion_channels.get(channel).copied() else { return };
        let (None, Some(writer)) = (&self.failed, &mut self.writer) else { return };
        let time = header_time(self.time_base, release);
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        match writer.write_to_known_channel(&header, body) {
            Ok(()) => {
                self.chunk.bytes += body.len();
                self.bytes += body.len() as u64;
            }
            Err(error) => self.fail(error),
        }
    }
}
