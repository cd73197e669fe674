//! Writes the file: the messages of the recording with their own bytes, and those for viewers at
//! the jobs that they belong to.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Context;
use glam::{DMat3, DVec3};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use taktil_mechanics::Pose;
use taktil_record::{CDR_HEADER_BYTES, Channel, Log, METADATA_RUN, Message, TIME_BASE_KEY};
use taktil_rtcore::Nanos;

use crate::arm::{ArmDrawing, BASE, TOOL};
use crate::messages::{
    Body, Colour, Entity, GreyImage, JointReading, Transform, WallTime, joint_states, scene,
    transforms,
};
use crate::schemas::descriptor_set;
use crate::truth::{BenchInstant, numbers, scalar};

/// The signal with the measured joints.
const JOINTS_SIGNAL: &str = "sense.joints";
/// The signal with the torques that were applied.
const TORQUE_SIGNAL: &str = "actuate.applied";
/// The signal with what the simulator knows.
const TRUTH_SIGNAL: &str = "world.truth";
/// The payload of tactile images.
const IMAGE_TYPE: &str = "TactileImage";
/// The frames of pin and table.
const PIN_FRAME: &str = "pin";
const TABLE_FRAME: &str = "table";
/// How long the pin is drawn (m).
const PIN_LENGTH_M: f64 = 0.12;
/// How large the table is drawn (m).
const TABLE_SIZE_M: DVec3 = DVec3::new(0.4, 0.3, 0.01);
/// How large a tactile array is drawn at the tool (m).
const ARRAY_SIZE_M: DVec3 = DVec3::new(0.0254, 0.0254, 0.003);
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
    description: u16,
    /// The channel for viewers of each signal with tactile images.
    images: BTreeMap<usize, u16>,
}

/// A file that is being written.
struct Export<'a> {
    log: &'a Log,
    arm: &'a ArmDrawing,
    options: ExportOptions,
    writer: Writer<BufWriter<File>>,
    /// Channel of each signal.
    signals: Vec<u16>,
    views: ViewChannels,
    /// Brightest tactel of each signal with images (counts).
    brightest: BTreeMap<usize, f64>,
    /// Radius of the pin (m), if the run has one that was touched.
    pin_radius_m: Option<f64>,
    done: Exported,
}

/// The newest values while the messages pass.
#[derive(Default)]
struct Newest {
    torque_nm: Vec<f64>,
    bench: Option<BenchInstant>,
    /// Where the pin was at first, base frame (m).
    first_pin_m: Option<DVec3>,
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
        let mut signals = Vec::new();
        for channel in 0..log.channels().len() {
            let source = log.channel_schema(channel).context("a channel has no schema")?;
            let schema = writer.add_schema(source.name, "ros2msg", source.text.as_bytes())?;
            signals.push(writer.add_channel(schema, source.topic, "cdr", source.about)?);
        }
        let views = ViewChannels::add(&mut writer, log)?;
        let (mut brightest, mut pin_radius_m) = (BTreeMap::new(), None);
        for message in log.messages() {
            let channel = &log.channels()[message.channel];
            if views.images.contains_key(&message.channel) {
                let most = numbers(channel, "counts", message.data);
                let most = most.into_iter().filter(|n| n.is_finite()).fold(1.0, f64::max);
                let known: &mut f64 = brightest.entry(message.channel).or_insert(1.0);
                *known = known.max(most);
            } else if pin_radius_m.is_none() && channel.signal == TRUTH_SIGNAL {
                pin_radius_m = BenchInstant::of(channel, message.data).and_then(|b| b.reach_m);
            }
        }
        let done = Exported::default();
        let mut export =
            Export { log, arm, options, writer, signals, views, brightest, pin_radius_m, done };
        export.describe_robot()?;
        Ok(export)
    }

    /// Writes the description of the robot as an attachment and as a message.
    fn describe_robot(&mut self) -> anyhow::Result<()> {
        let text = self.arm.urdf();
        let at = self.wall_time(0);
        self.writer.attach(&Attachment {
            log_time: at.0,
            create_time: at.0,
            name: "robot.urdf".to_owned(),
            media_type: "application/xml".to_owned(),
            data: Cow::Borrowed(text.as_bytes()),
        })?;
        // A text in CDR: its length with the zero that ends it, and its bytes.
        let length = u32::try_from(text.len() + 1).context("the description is too long")?;
        let body = [&CDR_LITTLE_ENDIAN[..], &length.to_le_bytes(), text.as_bytes(), &[0]].concat();
        self.write_view(self.views.description, at, &body)
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
                newest.bench = BenchInstant::of(channel, message.data);
                if let (None, Some(bench)) = (newest.first_pin_m, newest.bench) {
                    newest.first_pin_m = Some(bench.pin_m);
                    self.show_bodies(at)?;
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
        let names = self.arm.joint_names();
        let readings: Vec<JointReading<'_>> = names
            .iter()
            .zip(&q)
            .enumerate()
            .map(|(joint, (name, position_rad))| JointReading {
                name,
                position_rad: *position_rad,
                speed_rad_s: speed.get(joint).copied(),
                torque_nm: newest.torque_nm.get(joint).copied(),
            })
            .collect();
        self.write_view(self.views.joints, at, &joint_states(at, &readings))?;
        let frames = self.arm.frame_names();
        let mut places: Vec<Transform<'_>> = self
            .arm
            .steps(&q)
            .into_iter()
            .zip(frames.windows(2))
            .map(|(pose, pair)| Transform { parent: &pair[0], child: &pair[1], pose })
            .collect();
        if let (Some(bench), Some(below)) = (newest.bench, newest.first_pin_m) {
            let radius = self.pin_radius_m.unwrap_or(0.0);
            places.push(Transform { parent: BASE, child: PIN_FRAME, pose: bench.pin() });
            let table = bench.table(radius, below);
            places.push(Transform { parent: BASE, child: TABLE_FRAME, pose: table });
        }
        self.write_view(self.views.frames, at, &transforms(at, &places))
    }

    /// Writes pin, table and array once: they keep their places in their frames.
    fn show_bodies(&mut self, at: WallTime) -> anyhow::Result<()> {
        let below = |size: DVec3| Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, -size.z / 2.0));
        let mut bodies = vec![
            Entity {
                name: TABLE_FRAME,
                frame: TABLE_FRAME,
                place: below(TABLE_SIZE_M),
                body: Body::Cuboid(TABLE_SIZE_M),
                colour: Colour([0.55, 0.48, 0.38, 1.0]),
            },
            Entity {
                name: "array",
                frame: TOOL,
                place: below(ARRAY_SIZE_M),
                body: Body::Cuboid(ARRAY_SIZE_M),
                colour: Colour([0.13, 0.13, 0.15, 1.0]),
            },
        ];
        if let Some(radius_m) = self.pin_radius_m {
            bodies.push(Entity {
                name: PIN_FRAME,
                frame: PIN_FRAME,
                place: Pose::IDENTITY,
                body: Body::Cylinder { radius_m, length_m: PIN_LENGTH_M },
                colour: Colour([0.88, 0.48, 0.1, 1.0]),
            });
        }
        self.write_view(self.views.bodies, at, &scene(at, &bodies))
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
        let (rows, cols) = (rows as u32, cols as u32);
        let tactels = rows as usize * cols as usize;
        // Only a damaged message says that it has more tactels than counts.
        if tactels == 0 || tactels > counts.len() {
            return Ok(());
        }
        let white = self.brightest.get(&message.channel).copied().unwrap_or(1.0);
        let grey = |count: &f64| (255.0 * count / white).clamp(0.0, 255.0) as u8;
        let pixels: Vec<u8> = counts.iter().take(tactels).map(grey).collect();
        let image = GreyImage { frame: TOOL, cols, rows, pixels: &pixels };
        self.write_view(view, at, &image.message(at))
    }
}

impl ViewChannels {
    fn add(writer: &mut Writer<BufWriter<File>>, log: &Log) -> anyhow::Result<ViewChannels> {
        let descriptors = descriptor_set();
        let about = BTreeMap::new();
        let mut add = |schema: &str, topic: &str| -> anyhow::Result<u16> {
            let name = format!("foxglove.{schema}");
            let schema = writer.add_schema(&name, "protobuf", &descriptors)?;
            Ok(writer.add_channel(schema, topic, "protobuf", &about)?)
        };
        let joints = add("JointStates", "/viewer/joints")?;
        let frames = add("FrameTransforms", "/viewer/frames")?;
        let bodies = add("SceneUpdate", "/viewer/scene")?;
        let mut images = BTreeMap::new();
        for (index, channel) in log.channels().iter().enumerate() {
            if channel.type_name == IMAGE_TYPE {
                let topic = format!("/viewer{}", channel.topic);
                images.insert(index, add("RawImage", &topic)?);
            }
        }
        let schema = writer.add_schema("std_msgs/msg/String", "ros2msg", b"string data\n")?;
        let description = writer.add_channel(schema, "/robot_description", "cdr", &about)?;
        Ok(ViewChannels { joints, frames, bodies, description, images })
    }
}
