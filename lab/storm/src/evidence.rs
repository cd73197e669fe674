//! What a run leaves behind, tick by tick: the words that went to the boards and their answers, the
//! records of the tasks, the truth of the simulator. It is collected from the records alone, so
//! that the checkers see what a log would show.

use taktil_lab_world::WorldTruth;
use taktil_machine::tape::name;
use taktil_machine::tape::{AnalogWord, DigitalEntry, DigitalWord, EncoderEntry};
use taktil_rtcore::record::{Catalog, Observer, Record, Signal};
use taktil_rtcore::status::LaneHealth;
use taktil_rtcore::{Nanos, Payload};
use taktil_signal::{
    Applied, ControlState, Desired, Features, JogCommand, JointState, Lines, Request, Torque,
};

/// The records of one job of the servo lane; `None` where nothing was written.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tick {
    /// Number of the job.
    pub tick: u64,
    /// Its release.
    pub release: Nanos,
    /// The word of the supervisor.
    pub control: Option<ControlState>,
    /// The newest request of the operator.
    pub request: Option<Request>,
    /// The keys that it holds.
    pub jog: Option<JogCommand>,
    /// What the encoders answered.
    pub encoders: Option<EncoderEntry<8>>,
    /// What the input lines answered.
    pub lines_in: Option<DigitalEntry>,
    /// The word to the D/A converters.
    pub analog: Option<AnalogWord<8>>,
    /// The word to the output lines.
    pub lines_out: Option<DigitalWord>,
    /// Measured joints.
    pub joints: Option<JointState>,
    /// The lines as tasks know them.
    pub lines: Option<Lines>,
    /// Desired joints.
    pub desired: Option<Desired>,
    /// Torque of the servo.
    pub torque: Option<Torque>,
    /// Torque that was applied.
    pub applied: Option<Applied>,
    /// Features of a new image.
    pub features: Option<Features>,
    /// Health of the lane.
    pub health: Option<LaneHealth>,
}

/// What one job of the touch lane left.
#[derive(Clone, Copy, Debug, Default)]
pub struct Touch {
    /// Its release.
    pub release: Nanos,
    /// Whether the array answered, and with a new frame.
    pub answered: bool,
    /// Whether the frame was new.
    pub new: bool,
    /// Number of the scan.
    pub sequence: u32,
    /// Whether the task published an image.
    pub image: bool,
    /// Health of the lane.
    pub faults: u64,
}

/// What a checker is told of, as it happens.
pub trait Witness {
    /// A job of the servo lane is complete.
    fn tick(&mut self, tick: &Tick);
    /// A job of the touch lane is complete.
    fn touch(&mut self, touch: &Touch);
    /// The world has gone on.
    fn truth(&mut self, truth: &WorldTruth);
}

/// Numbers of the signals that are looked at; absent ones are not in the machine.
#[derive(Clone, Debug)]
struct Signals {
    control: Option<usize>,
    request: Option<usize>,
    jog: Option<usize>,
    encoders: Option<usize>,
    lines_in: Option<usize>,
    analog: Option<usize>,
    lines_out: Option<usize>,
    joints: Option<usize>,
    lines: Option<usize>,
    desired: Option<usize>,
    torque: Option<usize>,
    applied: Option<usize>,
    features: Option<usize>,
    health: Option<usize>,
    truth: Option<usize>,
    tactile: Option<usize>,
    image: Option<usize>,
    touch_health: Option<usize>,
}

/// Where a field begins in the record of a signal; 0 without such a field.
fn offset_of(signal: &Signal, name: &str) -> usize {
    let mut end = 0;
    for field in signal.fields.iter() {
        let begin = usize::next_multiple_of(end, field.kind.size());
        if field.name == name {
            return begin;
        }
        end = field.end_after(end);
    }
    0
}

/// Collects the evidence and hands it to a witness.
pub struct Evidence<W> {
    signals: Signals,
    now: Tick,
    begun: bool,
    touch: Touch,
    touch_begun: bool,
    /// Where sequence, arrival and outcome stand in the record of a frame.
    frame_offsets: [usize; 3],
    /// Whoever judges it.
    pub witness: W,
}

impl<W: Witness> Evidence<W> {
    /// For the signals of a machine.
    #[must_use]
    pub fn new(catalog: &Catalog, witness: W) -> Evidence<W> {
        let find = |name: &str| catalog.find(name);
        let signals = Signals {
            control: find("supervisor.control"),
            request: find("operator.request"),
            jog: find("operator.jog"),
            encoders: find(name::ENCODERS),
            lines_in: find(name::DIGITAL_IN),
            analog: find(name::ANALOG_OUT),
            lines_out: find(name::DIGITAL_OUT),
            joints: find("sense.joints"),
            lines: find("sense.lines"),
            desired: find("setpoint.desired"),
            torque: find("joint_servo.torque"),
            applied: find("actuate.applied"),
            features: find("tactile_servo.features"),
            health: find("servo.health"),
            truth: find("world.truth"),
            tactile: find(&name::tactile(taktil_hal::TACTILE)),
            image: find("tactile_scan.image"),
            touch_health: find("touch.health"),
        };
        let frame = signals.tactile.map(|index| &catalog.signals[index]);
        let frame_offsets =
            ["sequence", "new", "outcome"].map(|name| frame.map_or(0, |of| offset_of(of, name)));
        let (now, touch) = (Tick::default(), Touch::default());
        Evidence { signals, now, begun: false, touch, touch_begun: false, frame_offsets, witness }
    }

    /// Hands out what is left when the run has ended.
    pub fn finish(&mut self) {
        self.hand_out();
    }

    /// Hands out the jobs that are complete. A job of the touch lane comes before one of the servo
    /// lane that was released later, which has read its image, and behind one released with it.
    fn hand_out(&mut self) {
        let touch = core::mem::take(&mut self.touch_begun).then_some(self.touch);
        let before = |touch: &Touch| !self.begun || touch.release < self.now.release;
        let early = touch.filter(before);
        let late = touch.filter(|_| early.is_none());
        if let Some(touch) = early {
            self.witness.touch(&touch);
        }
        if core::mem::take(&mut self.begun) {
            self.witness.tick(&self.now);
        }
        if let Some(touch) = late {
            self.witness.touch(&touch);
        }
    }

    /// Begins a new job of the servo lane when the record is of one.
    fn turn(&mut self, record: &Record<'_>) {
        if !self.begun || self.now.tick != record.tick {
            if self.begun {
                self.witness.tick(&self.now);
            }
            self.begun = true;
            self.now = Tick { tick: record.tick, release: record.release, ..Tick::default() };
        }
    }

    fn touch_record(&mut self, record: &Record<'_>) -> bool {
        let signal = Some(record.signal);
        let signals = &self.signals;
        if ![signals.tactile, signals.image, signals.touch_health].contains(&signal) {
            return false;
        }
        if !self.touch_begun || self.touch.release != record.release {
            if self.touch_begun {
                self.witness.touch(&self.touch);
            }
            self.touch_begun = true;
            self.touch = Touch { release: record.release, ..Touch::default() };
        }
        if signal == self.signals.tactile {
            let number = |offset: usize, bytes: usize| {
                let mut word = [0; 4];
                word[..bytes].copy_from_slice(record.body.get(offset..offset + bytes)?);
                Some(u32::from_le_bytes(word))
            };
            let [sequence, new, outcome] = self.frame_offsets;
            self.touch.answered = number(outcome, 2) == Some(0);
            self.touch.new = number(new, 2) == Some(1);
            self.touch.sequence = number(sequence, 4).unwrap_or_default();
        } else if signal == self.signals.image {
            self.touch.image = true;
        } else if let Some(health) = LaneHealth::decode(record.body) {
            self.touch.faults = health.faults;
        }
        true
    }
}

impl<W: Witness> Observer for Evidence<W> {
    fn record(&mut self, record: &Record<'_>) {
        let signal = Some(record.signal);
        if signal == self.signals.truth {
            // All records of a job come together: what the world does next is not about it.
            self.hand_out();
            if let Some(truth) = WorldTruth::decode(record.body) {
                self.witness.truth(&truth);
            }
            return;
        }
        if self.touch_record(record) {
            return;
        }
        macro_rules! take {
            ($($field:ident),*) => {
                $(if signal == self.signals.$field {
                    self.turn(record);
                    self.now.$field = Payload::decode(record.body);
                    return;
                })*
            };
        }
        take!(
            control, request, jog, encoders, lines_in, analog, lines_out, joints, lines, desired,
            torque, applied, features, health
        );
    }
}
