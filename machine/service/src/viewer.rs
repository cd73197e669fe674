//! Channels for common viewers in the recordings of a machine: joints, frames of the links, tactile
//! images and the bodies of a simulated bench in the well-known messages of the package `foxglove`,
//! and the robot in URDF. The recorder's thread makes them of the same records that it writes.

use taktil_machine::robot::AnyRobot;
use taktil_machine_foxglove::view::{
    BODIES_TOPIC, DESCRIPTION_FIELDS, DESCRIPTION_FILE, DESCRIPTION_MEDIA_TYPE, DESCRIPTION_SCHEMA,
    DESCRIPTION_TOPIC, FRAMES_TOPIC, IMAGE_TYPE, JOINTS_SIGNAL, JOINTS_TOPIC, LINKS_TOPIC,
    TORQUE_SIGNAL, TRUTH_SIGNAL, description_message, image_topic, tactile_image,
};
use taktil_machine_foxglove::{
    ArmDrawing, BenchInstant, JointValues, MESSAGE_ENCODING, RobotView, WallTime, descriptor_set,
};
use taktil_record::companion::{Companion, CompanionChannel, CompanionFile, record_fields};
use taktil_record::{FieldInfo, topic};
use taktil_rtcore::Nanos;
use taktil_rtcore::record::{Catalog, Record};

/// Time between two messages with joints and frames: what the eye follows.
const FRAMES_PERIOD: Nanos = Nanos::from_millis(20);
/// Places of the channels that every machine has.
const JOINTS_CHANNEL: usize = 0;
const FRAMES_CHANNEL: usize = 1;
const BODIES_CHANNEL: usize = 2;
const LINKS_CHANNEL: usize = 3;
const DESCRIPTION_CHANNEL: usize = 4;
/// Place of the first channel with images.
const FIRST_IMAGE_CHANNEL: usize = 5;

/// The arm as viewers draw it.
#[must_use]
pub fn drawing(robot: &AnyRobot) -> ArmDrawing {
    let frames = robot.frames();
    let name = if robot.is_puma260() { "puma260" } else { "arm" };
    ArmDrawing {
        name: name.to_owned(),
        joint_origins: frames.joint_origins,
        tool: frames.tool,
        limits_rad: robot.limits_rad(),
    }
}

/// What a signal is to viewers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ViewerSignal {
    Joints,
    Torque,
    Truth,
    /// Tactile images, by the place of their channel.
    Image(usize),
    /// Nothing that is drawn.
    Other,
}

/// Makes the messages for viewers of a machine's records.
#[derive(Debug)]
pub struct ViewerChannels {
    view: RobotView,
    viewer_signals: Vec<ViewerSignal>,
    fields: Vec<Vec<FieldInfo>>,
    image_topics: Vec<String>,
    /// The largest load of each channel with images so far (counts): white.
    brightest: Vec<f64>,
    torque_nm: Vec<f64>,
    bench: Option<BenchInstant>,
    /// Release from which joints and frames are due.
    due: Option<Nanos>,
}

impl ViewerChannels {
    /// The channels of a machine with this arm and these signals.
    #[must_use]
    pub fn new(arm: ArmDrawing, catalog: &Catalog) -> ViewerChannels {
        let mut image_topics = Vec::new();
        let mut viewer_signals = Vec::with_capacity(catalog.signals.len());
        for signal in &catalog.signals {
            viewer_signals.push(match &*signal.name {
                JOINTS_SIGNAL => ViewerSignal::Joints,
                TORQUE_SIGNAL => ViewerSignal::Torque,
                TRUTH_SIGNAL => ViewerSignal::Truth,
                _ if signal.type_name == IMAGE_TYPE => {
                    image_topics.push(image_topic(&topic(&signal.name)));
                    ViewerSignal::Image(image_topics.len() - 1)
                }
                _ => ViewerSignal::Other,
            });
        }
        ViewerChannels {
            view: RobotView::new(arm),
            viewer_signals,
            fields: record_fields(catalog),
            brightest: vec![1.0; image_topics.len()],
            image_topics,
            torque_nm: Vec::new(),
            bench: None,
            due: None,
        }
    }

    /// The numbers of a field of a record; empty where its signal has no such field.
    fn numbers(&self, record: &Record<'_>, field: &str) -> Vec<f64> {
        let fields = self.fields.get(record.signal).map_or(&[][..], Vec::as_slice);
        let found = fields.iter().find(|info| info.name == field);
        found.map_or_else(Vec::new, |info| info.numbers(record.body))
    }

    fn append_joints(
        &mut self,
        record: &Record<'_>,
        at: WallTime,
        append: &mut dyn FnMut(usize, &[u8]),
    ) {
        if self.due.is_some_and(|due| record.release < due) {
            return;
        }
        self.due = Some(record.release + FRAMES_PERIOD);
        let q_rad = self.numbers(record, "q_rad");
        let qd_rad_s = self.numbers(record, "qd_rad_s");
        let joints = JointValues { q_rad: &q_rad, qd_rad_s: &qd_rad_s, tau_nm: &self.torque_nm };
        append(JOINTS_CHANNEL, &self.view.joints(at, joints));
        append(FRAMES_CHANNEL, &self.view.frames(at, &q_rad, self.bench.as_ref()));
    }

    fn append_image(
        &mut self,
        channel: usize,
        record: &Record<'_>,
        at: WallTime,
        append: &mut dyn FnMut(usize, &[u8]),
    ) {
        let size = |field: &str| self.numbers(record, field).first().map(|size| *size as usize);
        let (Some(rows), Some(cols)) = (size("rows"), size("cols")) else { return };
        let counts = self.numbers(record, "counts");
        let white = &mut self.brightest[channel];
        *white = counts.iter().copied().fold(*white, f64::max);
        if let Some(image) = tactile_image(at, rows, cols, &counts, *white) {
            append(FIRST_IMAGE_CHANNEL + channel, &image);
        }
    }
}

/// An instant of the wall clock as messages have it.
fn wall_time(at: Nanos) -> WallTime {
    WallTime(u64::try_from(at.0).unwrap_or(0))
}

impl Companion for ViewerChannels {
    fn channels(&self) -> Vec<CompanionChannel> {
        let schema_bytes = descriptor_set();
        let known = |topic: &str, name: &str| CompanionChannel {
            topic: topic.to_owned(),
            schema: format!("foxglove.{name}"),
            schema_encoding: MESSAGE_ENCODING,
            schema_bytes: schema_bytes.clone(),
            encoding: MESSAGE_ENCODING,
        };
        let description = CompanionChannel {
            topic: DESCRIPTION_TOPIC.to_owned(),
            schema: DESCRIPTION_SCHEMA.to_owned(),
            schema_encoding: "ros2msg",
            schema_bytes: DESCRIPTION_FIELDS.as_bytes().to_vec(),
            encoding: "cdr",
        };
        let mut all = vec![
            known(JOINTS_TOPIC, "JointStates"),
            known(FRAMES_TOPIC, "FrameTransforms"),
            known(BODIES_TOPIC, "SceneUpdate"),
            known(LINKS_TOPIC, "SceneUpdate"),
            description,
        ];
        all.extend(self.image_topics.iter().map(|topic| known(topic, "RawImage")));
        all
    }

    fn files(&self) -> Vec<CompanionFile> {
        vec![CompanionFile {
            name: DESCRIPTION_FILE.to_owned(),
            media_type: DESCRIPTION_MEDIA_TYPE.to_owned(),
            data: self.view.arm().urdf().into_bytes(),
        }]
    }

    fn begin(&mut self, at: Nanos, append: &mut dyn FnMut(usize, &[u8])) {
        let at = wall_time(at);
        if let Some(description) = description_message(&self.view.arm().urdf()) {
            append(DESCRIPTION_CHANNEL, &description);
        }
        append(LINKS_CHANNEL, &self.view.links(at));
        append(BODIES_CHANNEL, &self.view.bodies(at));
    }

    fn record(&mut self, record: &Record<'_>, at: Nanos, append: &mut dyn FnMut(usize, &[u8])) {
        let at = wall_time(at);
        match self.viewer_signals.get(record.signal).copied().unwrap_or(ViewerSignal::Other) {
            ViewerSignal::Other => {}
            ViewerSignal::Joints => self.append_joints(record, at, append),
            ViewerSignal::Torque => self.torque_nm = self.numbers(record, "tau_nm"),
            ViewerSignal::Image(channel) => self.append_image(channel, record, at, append),
            ViewerSignal::Truth => {
                self.bench = BenchInstant::from_fields(|field| self.numbers(record, field));
                if let Some(bench) = &self.bench
                    && self.view.observe(bench)
                {
                    append(BODIES_CHANNEL, &self.view.bodies(at));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use std::time::Duration;

    use taktil_record::recorder::{LogConfig, Recorder};
    use taktil_record::{Log, METADATA_RUN, TIME_BASE_KEY};
    use taktil_rtcore::linux::wall_clock;
    use taktil_rtcore::record::{LaneInfo, Observer, Signal};
    use taktil_rtcore::{Payload, payload};

    payload! {
        /// Joints of an arm with six.
        pub struct SixJoints {
            /// Angles.
            pub q_rad: [f64; 6],
            /// Speeds.
            pub qd_rad_s: [f64; 6],
        }
    }
    payload! {
        /// A tactile image of two tactels.
        pub struct TactileImage {
            /// Loads.
            pub counts: [f32; 2],
            /// Rows.
            pub rows: u32,
            /// Columns.
            pub cols: u32,
        }
    }

    fn catalog() -> Catalog {
        let signal = |name: &str, type_name: &'static str, fields: &'static [_], size| Signal {
            name: name.into(),
            lane: 0,
            type_name: type_name.into(),
            fields: fields.into(),
            size,
        };
        let signals = vec![
            signal(JOINTS_SIGNAL, SixJoints::NAME, SixJoints::FIELDS, SixJoints::SIZE),
            signal("scan.image", TactileImage::NAME, TactileImage::FIELDS, TactileImage::SIZE),
        ];
        Catalog { signals, lanes: vec![LaneInfo::default()] }
    }

    fn body<T: Payload>(value: &T) -> Vec<u8> {
        let mut bytes = vec![0; T::SIZE];
        value.encode(&mut bytes);
        bytes
    }

    /// A second at 400 Hz.
    fn append_second(recorder: &mut dyn Observer) {
        let joints = body(&SixJoints { q_rad: [0.1; 6], qd_rad_s: [0.0; 6] });
        let image = body(&TactileImage { counts: [3.0, 9.0], rows: 1, cols: 2 });
        for tick in 1..=400_u64 {
            let release = Nanos::from_micros(2500 * tick.cast_signed());
            for (signal, body) in [(0, &joints), (1, &image)] {
                recorder.record(&Record { signal, tick, release, body });
            }
        }
    }

    #[test]
    fn a_recording_with_channels_for_viewers_keeps_its_own_and_has_the_wall_clock() {
        let folder = std::env::temp_dir().join(format!("taktil-viewer-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        let options = LogConfig::at("run.mcap".into()).options(&folder).unwrap();
        let catalog = catalog();
        let channels = ViewerChannels::new(drawing(&AnyRobot::puma260()), &catalog);
        let companion = Box::new(channels);
        let mut recorder =
            Recorder::start_with_companion(options, &catalog, BTreeMap::new(), companion).unwrap();
        append_second(&mut recorder);
        recorder.finish(BTreeMap::new(), Duration::from_secs(20)).unwrap();
        let log = Log::open(&folder.join("run.mcap")).unwrap();
        assert!(log.damage().is_none());
        assert_eq!(log.messages().count(), 800, "the machine's own messages");
        let joints = log.series(JOINTS_SIGNAL).unwrap();
        assert_eq!((joints.t_s[0], joints.values("q_rad", 5)[0]), (0.0025, 0.1));
        let base: i64 = log.metadata()[METADATA_RUN][TIME_BASE_KEY].parse().unwrap();
        let hour_ns = 3_600_000_000_000;
        assert!((wall_clock().0 - base).abs() < hour_ns, "{base} is no wall clock");
        // Fifty of joints and of frames, an image for each record, links, bodies and description.
        assert_eq!(log.foreign_messages(), 50 + 50 + 400 + 3);
        let bytes = std::fs::read(folder.join("run.mcap")).unwrap();
        let has = |text: &[u8]| bytes.windows(text.len()).any(|at| at == text);
        assert!(has(b"robot.urdf") && has(b"foxglove.FrameTransforms") && has(b"<robot name="));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
