//! Makes the messages of the channels from the newest values of the machine, each at most once
//! for all viewers, and stamps them with the wall clock.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};
use serde_json::{Value, json};
use taktil_machine_foxglove::view::{
    JOINTS_SIGNAL, TORQUE_SIGNAL, TRUTH_SIGNAL, description_message, tactile_image,
};
use taktil_machine_foxglove::{ArmDrawing, BenchInstant, JointValues, RobotView, WallTime};
use taktil_mechanics::Pose;
use taktil_rtcore::Nanos;

use super::channels::{Content, ViewChannel, channels};
use crate::feed::{Feed, MODEL_INDEX, SIGNALS_INDEX};

/// How far the stamps may be off the wall clock before they are set anew: a machine that is paced
/// by a clock of its own, or was begun anew.
const CLOCK_TOLERANCE_NS: i64 = 500_000_000;

/// A message with the instant of its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ViewMessage {
    pub(super) at: WallTime,
    pub(super) body: Vec<u8>,
}

/// What viewers are served from.
#[derive(Debug)]
pub(crate) struct ViewSource {
    /// Which run of the server this is, for viewers that connect anew.
    session: String,
    view: Option<RobotView>,
    pub(super) channels: Vec<ViewChannel>,
    /// Grows with every new list of channels; 0 before the first.
    pub(super) channels_version: u64,
    next_id: u32,
    model_version: u64,
    signals_version: u64,
    /// Version of the values that the messages are made of.
    pub(super) values_version: u64,
    values: Value,
    bench: Option<BenchInstant>,
    /// Grows when what is told once has changed.
    pub(super) told_version: u64,
    /// The wall clock at logical time zero (ns since 1970).
    zero_unix_ns: Option<i64>,
    at: WallTime,
    /// The largest load of each signal with images (counts): white.
    brightest: BTreeMap<String, f64>,
    /// Messages of the newest values by their channels.
    made: BTreeMap<u32, Option<ViewMessage>>,
}

impl ViewSource {
    /// Nothing is known of the machine yet. `wall` is the wall clock.
    pub(crate) fn new(wall: Nanos) -> ViewSource {
        ViewSource {
            session: format!("taktil {}", wall.0),
            view: None,
            channels: Vec::new(),
            channels_version: 0,
            next_id: 1,
            model_version: 0,
            signals_version: 0,
            values_version: 0,
            values: Value::Null,
            bench: None,
            told_version: 0,
            zero_unix_ns: None,
            at: WallTime(0),
            brightest: BTreeMap::new(),
            made: BTreeMap::new(),
        }
    }

    /// The first message of a connection.
    pub(super) fn server_info(&self) -> String {
        json!({
            "op": "serverInfo",
            "name": "Taktil",
            "capabilities": [],
            "supportedEncodings": [],
            "metadata": {},
            "sessionId": self.session,
        })
        .to_string()
    }

    /// Takes in what the machine has told. `wall` is the wall clock now.
    pub(crate) fn update(&mut self, feed: &Feed, wall: Nanos) {
        let [model, signals] = [MODEL_INDEX, SIGNALS_INDEX].map(|at| &feed.documents[at]);
        if model.version != self.model_version {
            self.model_version = model.version;
            if let Some(arm) = drawing(&feed.data(MODEL_INDEX)) {
                self.view = Some(RobotView::new(arm));
                self.told_version += 1;
            }
        }
        let has_both = self.view.is_some() && signals.version > 0;
        if has_both && signals.version != self.signals_version {
            self.signals_version = signals.version;
            self.channels = channels(&feed.data(SIGNALS_INDEX), self.next_id);
            self.next_id += u32::try_from(self.channels.len()).unwrap_or(0);
            self.channels_version += 1;
        }
        if feed.values.version != self.values_version {
            self.values_version = feed.values.version;
            self.made.clear();
            self.take_values(&feed.values.text, wall);
        }
    }

    fn take_values(&mut self, text: &str, wall: Nanos) {
        let Ok(mut event) = serde_json::from_str::<Value>(text) else { return };
        self.values = event["values"].take();
        let t_ns = event["t_ns"].as_i64().unwrap_or(0);
        let zero = wall.0.saturating_sub(t_ns);
        let known = self.zero_unix_ns.filter(|known| (zero - known).abs() <= CLOCK_TOLERANCE_NS);
        let zero = *self.zero_unix_ns.insert(known.unwrap_or(zero));
        self.at = WallTime(u64::try_from(zero.saturating_add(t_ns)).unwrap_or(0));
        let truth = &self.values[TRUTH_SIGNAL];
        self.bench = BenchInstant::from_fields(|field| numbers(&truth[field]));
        if let (Some(view), Some(bench)) = (&mut self.view, &self.bench)
            && view.observe(bench)
        {
            self.told_version += 1;
        }
    }

    /// The message of a channel for the newest values; `None` where there is none to tell.
    pub(super) fn message(&mut self, id: u32) -> Option<&ViewMessage> {
        if !self.made.contains_key(&id) {
            let content = self.channels.iter().find(|channel| channel.id == id)?.content.clone();
            let body = self.body(&content);
            self.made.insert(id, body.map(|body| ViewMessage { at: self.at, body }));
        }
        self.made.get(&id)?.as_ref()
    }

    fn body(&mut self, content: &Content) -> Option<Vec<u8>> {
        let view = self.view.as_ref()?;
        let values = |path: &str| numbers(&self.values[path]);
        let q_rad = || Some(values(&format!("{JOINTS_SIGNAL}.q_rad"))).filter(|q| !q.is_empty());
        match content {
            Content::Joints => {
                let (q, qd) = (q_rad()?, values(&format!("{JOINTS_SIGNAL}.qd_rad_s")));
                let tau = values(&format!("{TORQUE_SIGNAL}.tau_nm"));
                let joints = JointValues { q_rad: &q, qd_rad_s: &qd, tau_nm: &tau };
                Some(view.joints(self.at, joints))
            }
            Content::Frames => Some(view.frames(self.at, &q_rad()?, self.bench.as_ref())),
            Content::Bodies => Some(view.bodies(self.at)),
            Content::Links => Some(view.links(self.at)),
            Content::Description => description_message(&view.arm().urdf()),
            Content::Signal(signal) => {
                let value = &self.values[signal];
                value.is_object().then(|| value.to_string().into_bytes())
            }
            Content::Image(signal) => {
                let counts = values(&format!("{signal}.counts"));
                let size = |field: &str| {
                    let number = self.values[format!("{signal}.{field}")].as_u64()?;
                    usize::try_from(number).ok()
                };
                let (rows, cols) = (size("rows")?, size("cols")?);
                let known = self.brightest.entry(signal.clone()).or_insert(1.0);
                *known = counts.iter().copied().fold(*known, f64::max);
                tactile_image(self.at, rows, cols, &counts, *known)
            }
        }
    }
}

/// A number or a list of numbers; NaN for what is none.
fn numbers(value: &Value) -> Vec<f64> {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    match value {
        Value::Array(all) => all.iter().map(number).collect(),
        Value::Null => Vec::new(),
        one => vec![number(one)],
    }
}

/// The arm by the machine's answer to `model`.
fn drawing(model: &Value) -> Option<ArmDrawing> {
    let joints = model["joints"].as_array()?;
    let joint_origins = joints.iter().map(|joint| pose(&joint["origin"])).collect::<Option<_>>()?;
    let limit = |joint: &Value| Some((joint["low_rad"].as_f64()?, joint["high_rad"].as_f64()?));
    Some(ArmDrawing {
        name: model["arm"].as_str().unwrap_or("arm").to_owned(),
        joint_origins,
        tool: pose(&model["tool"])?,
        limits_rad: joints.iter().map_while(limit).collect(),
    })
}

/// A frame of twelve numbers: three rows of rotation and place (m).
fn pose(rows: &Value) -> Option<Pose> {
    let rows: [f64; 12] = numbers(rows).try_into().ok()?;
    let column = |at: usize| DVec3::new(rows[at], rows[4 + at], rows[8 + at]);
    Some(Pose::new(DMat3::from_cols(column(0), column(1), column(2)), column(3)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arm_is_read_from_what_the_machine_tells_and_anything_else_is_none() {
        let model = json!({
            "arm": "chain from URDF",
            "joints": [{ "origin": [0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3], "low_rad": -1,
                         "high_rad": 2 }],
            "tool": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.1],
        });
        let arm = drawing(&model).expect("an arm");
        let origin = &arm.joint_origins[0];
        assert_eq!(origin.translation, DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(origin.rotation * DVec3::X, DVec3::Y, "a quarter turn about z");
        assert_eq!(arm.limits_rad, [(-1.0, 2.0)]);
        for bad in [json!(null), json!({ "joints": [{}] }), json!({ "joints": [], "tool": [1] })] {
            assert!(drawing(&bad).is_none(), "{bad}");
        }
    }

    #[test]
    fn stamps_follow_the_machine_and_are_set_anew_when_it_was_begun_anew() {
        let mut source = ViewSource::new(Nanos(0));
        let mut at = |t_ns: i64, wall_ns: i64| {
            source.take_values(&json!({ "t_ns": t_ns, "values": {} }).to_string(), Nanos(wall_ns));
            source.at.0
        };
        let second = 1_000_000_000;
        assert_eq!(at(5 * second, 100 * second), 100_000_000_000);
        // A value that comes 0.1 s late keeps its own instant.
        assert_eq!(at(6 * second, 101 * second + second / 10), 101_000_000_000);
        assert_eq!(at(second, 110 * second), 110_000_000_000, "begun anew");
    }
}
