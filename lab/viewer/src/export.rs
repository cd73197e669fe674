//! Writes the file: the messages of the recording with their own bytes, and those for viewers at
//! the jobs that they belong to.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Context;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use taktil_lab_progress::Progress;
use taktil_machine_foxglove::view::{
    BODIES_TOPIC, DESCRIPTION_FIELDS, DESCRIPTION_FILE, DESCRIPTION_MEDIA_TYPE, DESCRIPTION_SCHEMA,
    DESCRIPTION_TOPIC, FRAMES_TOPIC, IMAGE_TYPE, JOINTS_SIGNAL, JOINTS_TOPIC, LINKS_TOPIC,
    TORQUE_SIGNAL, TRUTH_SIGNAL, description_message, image_topic, tactile_image,
};
use taktil_machine_foxglove::{
    ArmDrawing, BenchInstant, JointValues, MESSAGE_ENCODING, RobotView, WallTime, descriptor_set,
};
use taktil_record::{CDR_HEADER_BYTES, Channel, Log, METADATA_RUN, Message, TIME_BASE_KEY};
use taktil_rtcore::Nanos;

use crate::truth::{bench, numbers, scalar};

/// Messages between two looks at the clock.
const MESSAGES_TOLD_TOGETHER: usize = 1024;
/// A plain CDR body in little-endian order.
const CDR_LITTLE_ENDIAN: [u8; CDR_HEADER_BYTES] = [0, 1, 0, 0];

/// How a log for viewers is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExportOptions {
    /// The instant of the wall clock at which the run began, ns since 1970.
    pub began: Nanos,
    /// Time between two messages with joints and frames; every image is written.
    pub period: Nanos,
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Exported {
    /// Messages of the recording.
    pub messages: u64,
    /// Messages for viewers beside them.
    pub for_viewers: u64,
}

/// Numbers of the channels for viewers.
struct ViewChannels {
    joints: u16,
    frames: u16,
    bodies: u16,
    links: u16,
    description: u16,
    /// The channel for viewers of each signal with tactile images.
    images: BTreeMap<usize, u16>,
}

/// A file that is being written.
struct Export<'a> {
    log: &'a Log,
    view: RobotView,
    options: ExportOptions,
    writer: Writer<BufWriter<File>>,
    /// Channel of each signal.
    signals: Vec<u16>,
    views: ViewChannels,
    /// Brightest tactel of each signal with images (counts).
    brightest: BTreeMap<usize, f64>,
    done: Exported,
}

/// The newest values while the messages pass.
#[derive(Default)]
struct Newest {
    torque_nm: Vec<f64>,
    bench: Option<BenchInstant>,
    /// Whether the bodies of the bench were written.
    has_bodies: bool,
    due: Option<i64>,
}

/// Writes `log` to `path` as viewers want it, with `arm` drawn.
///
/// # Errors
/// A file that cannot be written; the text names it.
pub fn export(
    log: &Log,
    arm: &ArmDrawing,
    path: &Path,
    options: ExportOptions,
) -> anyhow::Result<Exported> {
    let place = || format!("cannot write {}", path.display());
    let file = File::create(path).with_context(place)?;
    let written = Export::begin(log, arm, BufWriter::new(file), options).and_then(Export::finish);
    written.with_context(place)
}

impl<'a> Export<'a> {
    /// Begins a file with metadata, schemas, channels and the description of the robot.
    fn begin(
        log: &'a Log,
        arm: &'a ArmDrawing,
        file: BufWriter<File>,
        options: ExportOptions,
    ) -> anyhow::Result<Export<'a>> {
        let library = concat!("taktil ", env!("CARGO_PKG_VERSION"));
        let write = WriteOptions::new().profile("ros2").library(library).compression(None);
        let mut writer = write.create(file)?;
        for (name, table) in log.metadata() {
            let mut metadata = table.clone();
            if name == METADATA_RUN {
                metadata.insert(TIME_BASE_KEY.to_owned(), options.began.0.to_string());
            }
            writer.write_metadata(&Metadata { name: name.clone(), metadata })?;
        }
        // Behind schemas and channels it would end a chunk without a message, and viewers
        // take that for one of the year 1970.
        let text = arm.urdf();
        let began = u64::try_from(options.began.0).unwrap_or(0);
        writer.attach(&Attachment {
            log_time: began,
            create_time: began,
            name: DESCRIPTION_FILE.to_owned(),
            media_type: DESCRIPTION_MEDIA_TYPE.to_owned(),
            data: Cow::Borrowed(text.as_bytes()),
        })?;
        let mut signals = Vec::new();
        for channel in 0..log.channels().len() {
            let source = log.channel_schema(channel).context("a channel has no schema")?;
            let schema = writer.add_schema(source.name, "ros2msg", source.text.as_bytes())?;
            signals.push(writer.add_channel(schema, source.topic, "cdr", source.about)?);
        }
        let views = ViewChannels::add(&mut writer, log)?;
        let (mut brightest, mut view) = (BTreeMap::new(), RobotView::new(arm.clone()));
        let mut pin_radius_m = None;
        for message in log.messages() {
            let channel = &log.channels()[message.channel];
            if views.images.contains_key(&message.channel) {
                let most = numbers(channel, "counts", message.data);
                let most = most.into_iter().filter(|n| n.is_finite()).fold(1.0, f64::max);
                let known: &mut f64 = brightest.entry(message.channel).or_insert(1.0);
                *known = known.max(most);
            } else if pin_radius_m.is_none() && channel.signal == TRUTH_SIGNAL {
                pin_radius_m = bench(channel, message.data).and_then(|bench| bench.reach_m);
            }
        }
        if let Some(radius_m) = pin_radius_m {
            view.set_pin_radius_m(radius_m);
        }
        let done = Exported::default();
        let mut export = Export { log, view, options, writer, signals, views, brightest, done };
        export.describe_robot()?;
        Ok(export)
    }

    /// Writes the description of the robot as a message, and its links.
    fn describe_robot(&mut self) -> anyhow::Result<()> {
        let text = self.view.arm().urdf();
        let at = self.wall_time(0);
        let body = description_message(&text).context("the description is too long")?;
        self.write_view(self.views.description, at, &body)?;
        self.write_view(self.views.links, at, &self.view.links(at))
    }

    /// The instant of the wall clock of a logical time (ns).
    fn wall_time(&self, release_ns: i64) -> WallTime {
        WallTime(u64::try_from(self.options.began.0.saturating_add(release_ns)).unwrap_or(0))
    }

    fn write_view(&mut self, channel_id: u16, at: WallTime, body: &[u8]) -> anyhow::Result<()> {
        let sequence = (self.done.for_viewers & u64::from(u32::MAX)) as u32;
        let header = MessageHeader { channel_id, sequence, log_time: at.0, publish_time: at.0 };
        self.writer.write_to_known_channel(&header, body)?;
        self.done.for_viewers += 1;
        Ok(())
    }

    /// Writes all messages and closes the file.
    fn finish(mut self) -> anyhow::Result<Exported> {
        let mut newest = Newest::default();
        let mut body = Vec::new();
        let mut progress = Progress::new("messages", self.log.messages().count());
        let mut untold = 0;
        for message in self.log.messages() {
            let at = self.wall_time(message.release_ns);
            body.clear();
            body.extend_from_slice(&CDR_LITTLE_ENDIAN);
            body.extend_from_slice(message.data);
            let header = MessageHeader {
                channel_id: self.signals[message.channel],
                sequence: (message.tick & u64::from(u32::MAX)) as u32,
                log_time: at.0,
                publish_time: at.0,
            };
            self.writer.write_to_known_channel(&header, &body)?;
            self.done.messages += 1;
            untold += 1;
            if untold == MESSAGES_TOLD_TOGETHER {
                progress.advance_by(std::mem::take(&mut untold));
            }
            self.show(&message, at, &mut newest)?;
        }
        self.writer.finish()?;
        Ok(self.done)
    }

    /// Writes what viewers draw of a message.
    fn show(
        &mut self,
        message: &Message<'_>,
        at: WallTime,
        newest: &mut Newest,
    ) -> anyhow::Result<()> {
        let log = self.log;
        let channel = &log.channels()[message.channel];
        if self.views.images.contains_key(&message.channel) {
            return self.show_image(channel, message, at);
        }
        match channel.signal.as_str() {
            TORQUE_SIGNAL => newest.torque_nm = numbers(channel, "tau_nm", message.data),
            TRUTH_SIGNAL => {
                newest.bench = bench(channel, message.data);
                if let (false, Some(bench)) = (newest.has_bodies, &newest.bench) {
                    newest.has_bodies = true;
                    self.view.observe(bench);
                    self.write_view(self.views.bodies, at, &self.view.bodies(at))?;
                }
            }
            JOINTS_SIGNAL if newest.due.is_none_or(|due| message.release_ns >= due) => {
                newest.due = Some(message.release_ns + self.options.period.0);
                self.show_joints(channel, message, at, newest)?;
            }
            _ => {}
        }
        Ok(())
    }

    /// Writes joints and frames.
    fn show_joints(
        &mut self,
        channel: &Channel,
        message: &Message<'_>,
        at: WallTime,
        newest: &Newest,
    ) -> anyhow::Result<()> {
        let q = numbers(channel, "q_rad", message.data);
        let speed = numbers(channel, "qd_rad_s", message.data);
        let values = JointValues { q_rad: &q, qd_rad_s: &speed, tau_nm: &newest.torque_nm };
        self.write_view(self.views.joints, at, &self.view.joints(at, values))?;
        let frames = self.view.frames(at, &q, newest.bench.as_ref());
        self.write_view(self.views.frames, at, &frames)
    }

    /// Writes a tactile image; black is no load, white the largest load of the whole log.
    fn show_image(
        &mut self,
        channel: &Channel,
        message: &Message<'_>,
        at: WallTime,
    ) -> anyhow::Result<()> {
        let (Some(rows), Some(cols), Some(view)) = (
            scalar(channel, "rows", message.data),
            scalar(channel, "cols", message.data),
            self.views.images.get(&message.channel).copied(),
        ) else {
            return Ok(());
        };
        let counts = numbers(channel, "counts", message.data);
        let white = self.brightest.get(&message.channel).copied().unwrap_or(1.0);
        match tactile_image(at, rows as usize, cols as usize, &counts, white) {
            Some(image) => self.write_view(view, at, &image),
            None => Ok(()),
        }
    }
}

impl ViewChannels {
    fn add(writer: &mut Writer<BufWriter<File>>, log: &Log) -> anyhow::Result<ViewChannels> {
        let descriptors = descriptor_set();
        let about = BTreeMap::new();
        let mut add = |schema: &str, topic: &str| -> anyhow::Result<u16> {
            let name = format!("foxglove.{schema}");
            let schema = writer.add_schema(&name, MESSAGE_ENCODING, &descriptors)?;
            Ok(writer.add_channel(schema, topic, MESSAGE_ENCODING, &about)?)
        };
        let joints = add("JointStates", JOINTS_TOPIC)?;
        let frames = add("FrameTransforms", FRAMES_TOPIC)?;
        let bodies = add("SceneUpdate", BODIES_TOPIC)?;
        let links = add("SceneUpdate", LINKS_TOPIC)?;
        let mut images = BTreeMap::new();
        for (index, channel) in log.channels().iter().enumerate() {
            if channel.type_name == IMAGE_TYPE {
                images.insert(index, add("RawImage", &image_topic(&channel.topic))?);
            }
        }
        let fields = DESCRIPTION_FIELDS.as_bytes();
        let schema = writer.add_schema(DESCRIPTION_SCHEMA, "ros2msg", fields)?;
        let description = writer.add_channel(schema, DESCRIPTION_TOPIC, "cdr", &about)?;
        Ok(ViewChannels { joints, frames, bodies, links, description, images })
    }
}
