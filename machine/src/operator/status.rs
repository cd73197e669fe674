//! The state of the machine for people outside the lanes, collected from its records. A value that
//! has not been written yet is absent.

use taktil_rtcore::record::{Catalog, Record};
use taktil_rtcore::{Mode, Payload};
use taktil_signal::{
    ControlState, Desired, JogObstacle, JogState, MoveCheck, MoveKind, MoveQueue, OperatorMove,
    State,
};

/// Texts of the reasons in [`MoveCheck::reason`], which counts from 1.
pub const REFUSAL_REASONS: [&str; 7] = [
    "would leave its limits",
    "out of reach",
    "would be too fast",
    "would need more torque than it has",
    "the tool would leave its path past the wrist singularity",
    "it cannot be planned from here",
    "would not bring the tool to its goal in time past the wrist singularity",
];

/// The newest values that an operator needs.
#[derive(Clone, Debug, Default)]
pub struct Status {
    signals: [Option<usize>; 5],
    /// The state of the supervisor.
    pub control: ControlState,
    /// The state of the typed moves.
    pub typed: MoveQueue,
    /// The last check of a move.
    pub check: MoveCheck,
    /// The state of the jog task, with what prevents jog motion.
    pub jog: JogState,
    /// Desired joint angles (rad); empty before the first set point.
    pub desired_rad: Vec<f64>,
}

impl Status {
    /// The status of a machine with this catalog, before its first record.
    #[must_use]
    pub fn new(catalog: &Catalog) -> Status {
        let names = [
            "supervisor.control",
            "trajectory.queue",
            "trajectory.check",
            "jog.state",
            "setpoint.desired",
        ];
        Status { signals: names.map(|name| catalog.find(name)), ..Status::default() }
    }

    /// Takes over the value of a record that belongs to the status.
    pub fn record(&mut self, record: &Record<'_>) {
        let Some(which) = self.signals.iter().position(|id| *id == Some(record.signal)) else {
            return;
        };
        match which {
            0 => decode_into(&mut self.control, record.body),
            1 => decode_into(&mut self.typed, record.body),
            2 => decode_into(&mut self.check, record.body),
            3 => decode_into(&mut self.jog, record.body),
            _ => self.desired_rad = desired_angles(record.body),
        }
    }

    /// State and mode as text.
    #[must_use]
    pub fn state_text(&self) -> String {
        let state = State::from_code(self.control.state).map_or("?", State::name);
        format!("{state} (mode {})", self.mode_text())
    }

    fn mode_text(&self) -> String {
        let mode = Mode::from_code(self.control.mode);
        mode.map_or_else(|| "?".to_owned(), |mode| format!("{mode:?}").to_uppercase())
    }

    /// True in TRAJECTORY/USER.
    #[must_use]
    pub fn accepts_moves(&self) -> bool {
        self.control.state == State::TrajectoryUser as u32 && self.control.mode() == Mode::Moving
    }

    /// True where keys move the arm.
    #[must_use]
    pub fn accepts_jog(&self) -> bool {
        use State::{ManualCartesian, ManualJoint, ManualUncalibrated};
        let state = State::from_code(self.control.state);
        matches!(state, Some(ManualUncalibrated | ManualJoint | ManualCartesian))
    }

    /// What prevents jog motion, as text; `name` returns the name of a joint, counted from 0.
    #[must_use]
    pub fn jog_obstacle(&self, name: impl Fn(usize) -> String) -> Option<String> {
        if !self.accepts_jog() {
            return None;
        }
        let index = usize::try_from(self.jog.joint).ok().and_then(|joint| joint.checked_sub(1));
        let joint = index.map_or_else(|| "a joint".to_owned(), name);
        let why = match JogObstacle::from_code(self.jog.obstacle)? {
            JogObstacle::None => return None,
            JogObstacle::Limit => format!("{joint} is at its limit"),
            JogObstacle::Reach => "the tool is at the edge of the arm's reach".to_owned(),
            JogObstacle::Branch => {
                format!("{joint} could not come back: stretched, or beside its axis")
            }
            JogObstacle::Singular => format!("beside a singularity {joint} cannot follow"),
            JogObstacle::Line => "the tool would leave its line; push another way".to_owned(),
            JogObstacle::Frame => {
                "joints are pushed in MANUAL/JOINT, the tool in MANUAL/CARTESIAN".into()
            }
            JogObstacle::Silent => {
                "the hand fell silent with keys held; let go and push again".into()
            }
        };
        Some(format!("{}: {why}", if self.jog.stopped == 1 { "stopped" } else { "slow" }))
    }

    /// True when the machine accepts a typed move: any in TRAJECTORY/USER, a pause and its end
    /// while a program runs.
    #[must_use]
    pub fn accepts(&self, word: &OperatorMove) -> bool {
        is_accepted(&self.control, word)
    }

    /// The whole status in one line.
    #[must_use]
    pub fn summary(&self) -> String {
        let degrees: Vec<String> =
            self.desired_rad.iter().map(|q| format!("{:.2}", q.to_degrees())).collect();
        let moves = match (self.typed.paused, self.typed.moving, self.typed.queued) {
            (1, _, queued) => format!("paused, {queued} moves left"),
            (_, 1, queued) => format!("moving, {queued} moves left"),
            _ => "at rest".to_owned(),
        };
        format!("{}; joints {} deg; {moves}", self.state_text(), degrees.join(" "))
    }
}

fn decode_into<T: Payload>(value: &mut T, body: &[u8]) {
    if let Some(new) = T::decode(body) {
        *value = new;
    }
}

/// Whether the machine accepts a typed move; see [`Status::accepts`].
#[must_use]
pub fn is_accepted(control: &ControlState, word: &OperatorMove) -> bool {
    let pause = matches!(MoveKind::from_code(word.kind), Some(MoveKind::Pause | MoveKind::Resume));
    control.mode() == Mode::Moving
        && match State::from_code(control.state) {
            Some(State::TrajectoryUser) => true,
            Some(State::Trajectory) => pause,
            _ => false,
        }
}

/// The angles of a payload `Desired` of any arm.
fn desired_angles(body: &[u8]) -> Vec<f64> {
    let six = Desired::<6>::decode(body).map(|desired| desired.q_rad.to_vec());
    let seven = || Desired::<7>::decode(body).map(|desired| desired.q_rad.to_vec());
    six.or_else(seven).unwrap_or_default()
}

/// Why a check refused a move, as text with joint, reason and time. `name` returns the name of a
/// joint, counted from 0.
#[must_use]
pub fn refusal_text(check: &MoveCheck, name: impl Fn(usize) -> String) -> String {
    let index = usize::try_from(check.joint).ok().and_then(|joint| joint.checked_sub(1));
    let joint = index.map_or_else(String::new, |index| format!("{} ", name(index)));
    let index = usize::try_from(check.reason).ok().and_then(|reason| reason.checked_sub(1));
    let why = index.and_then(|n| REFUSAL_REASONS.get(n)).unwrap_or(&"no reason given");
    let by = if check.ratio > 0.0 { format!(" by {:.2}", check.ratio) } else { String::new() };
    let when = if check.t_s > 0.0 { format!(", {:.2} s on", check.t_s) } else { String::new() };
    format!("{joint}{why}{by}{when}")
}
