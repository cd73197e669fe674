//! How the machine stands, gathered from its records for people who are not in a lane. Refuses to
//! guess: what has not been written yet is not there.

use taktil_rtcore::record::{Catalog, Record};
use taktil_rtcore::{Mode, Payload};
use taktil_signal::{
    ControlState, Desired, JogState, JogWhy, MoveCheck, MoveKind, State, Typed, TypedMove,
};

/// The reasons of [`MoveCheck::reason`], from 1.
pub const REASONS: [&str; 7] = [
    "would leave its limits",
    "out of reach",
    "would be too fast",
    "would need more torque than it has",
    "the tool would leave its path past the wrist singularity",
    "it cannot be planned from here",
    "would not bring the tool to its goal in time past the wrist singularity",
];

/// The newest values of what an operator wants to know.
#[derive(Clone, Debug, Default)]
pub struct Status {
    signals: [Option<usize>; 5],
    /// What the supervisor decided.
    pub control: ControlState,
    /// How the typed moves stand.
    pub typed: Typed,
    /// The last verdict about moves.
    pub check: MoveCheck,
    /// What is in the way of the keys.
    pub jog: JogState,
    /// Where the joints are wanted (rad); empty before anybody said so.
    pub desired_rad: Vec<f64>,
}

impl Status {
    /// Nothing known yet of the machine with this catalog.
    #[must_use]
    pub fn new(catalog: &Catalog) -> Status {
        let names = [
            "supervisor.control",
            "trajectory.typed",
            "trajectory.check",
            "jog.state",
            "setpoint.desired",
        ];
        Status { signals: names.map(|name| catalog.find(name)), ..Status::default() }
    }

    /// Takes a record in, if it is one of those.
    pub fn record(&mut self, record: &Record<'_>) {
        let Some(which) = self.signals.iter().position(|id| *id == Some(record.signal)) else {
            return;
        };
        match which {
            0 => take(&mut self.control, record.body),
            1 => take(&mut self.typed, record.body),
            2 => take(&mut self.check, record.body),
            3 => take(&mut self.jog, record.body),
            _ => self.desired_rad = angles(record.body),
        }
    }

    /// State and mode in words.
    #[must_use]
    pub fn place(&self) -> String {
        let state = State::from_code(self.control.state).map_or("?", State::name);
        format!("{state} (mode {})", self.mode())
    }

    fn mode(&self) -> String {
        let mode = Mode::from_code(self.control.mode);
        mode.map_or_else(|| "?".to_owned(), |mode| format!("{mode:?}").to_uppercase())
    }

    /// True in TRAJECTORY/USER.
    #[must_use]
    pub fn takes_moves(&self) -> bool {
        self.control.state == State::TrajectoryUser as u32 && self.control.mode() == Mode::Moving
    }

    /// True where keys move the arm.
    #[must_use]
    pub fn takes_keys(&self) -> bool {
        use State::{ManualCartesian, ManualJoint, ManualUncalibrated};
        let state = State::from_code(self.control.state);
        matches!(state, Some(ManualUncalibrated | ManualJoint | ManualCartesian))
    }

    /// What is in the way of the keys, in words; `name` says what a joint is called, 0 the first.
    #[must_use]
    pub fn obstacle(&self, name: impl Fn(usize) -> String) -> Option<String> {
        if !self.takes_keys() {
            return None;
        }
        let index = usize::try_from(self.jog.joint).ok().and_then(|joint| joint.checked_sub(1));
        let joint = index.map_or_else(|| "a joint".to_owned(), name);
        let why = match JogWhy::from_code(self.jog.why)? {
            JogWhy::None => return None,
            JogWhy::Limit => format!("{joint} is at its limit"),
            JogWhy::Reach => "the tool is at the edge of the arm's reach".to_owned(),
            JogWhy::Branch => format!("{joint} could not come back: stretched, or beside its axis"),
            JogWhy::Singular => format!("beside a singularity {joint} cannot follow"),
            JogWhy::Line => "the tool would leave its line; push another way".to_owned(),
            JogWhy::Frame => {
                "joints are pushed in MANUAL/JOINT, the tool in MANUAL/CARTESIAN".into()
            }
            JogWhy::Silent => "the hand fell silent with keys held; let go and push again".into(),
        };
        Some(format!("{}: {why}", if self.jog.stands == 1 { "stands" } else { "slow" }))
    }

    /// True where a word that is typed is heard: any in TRAJECTORY/USER, a pause and its end while
    /// a program runs.
    #[must_use]
    pub fn takes(&self, word: &TypedMove) -> bool {
        heard(&self.control, word)
    }

    /// One line about everything.
    #[must_use]
    pub fn line(&self) -> String {
        let degrees: Vec<String> =
            self.desired_rad.iter().map(|q| format!("{:.2}", q.to_degrees())).collect();
        let moves = match (self.typed.paused, self.typed.moving, self.typed.queued) {
            (1, _, queued) => format!("paused, {queued} moves left"),
            (_, 1, queued) => format!("moving, {queued} moves left"),
            _ => "at rest".to_owned(),
        };
        format!("{}; joints {} deg; {moves}", self.place(), degrees.join(" "))
    }
}

fn take<T: Payload>(value: &mut T, body: &[u8]) {
    if let Some(new) = T::decode(body) {
        *value = new;
    }
}

/// Whether the machine hears what is typed; see [`Status::takes`].
#[must_use]
pub fn heard(control: &ControlState, word: &TypedMove) -> bool {
    let pause = matches!(MoveKind::from_code(word.kind), Some(MoveKind::Pause | MoveKind::Resume));
    control.mode() == Mode::Moving
        && match State::from_code(control.state) {
            Some(State::TrajectoryUser) => true,
            Some(State::Trajectory) => pause,
            _ => false,
        }
}

/// The angles of a payload `Desired` of any arm.
fn angles(body: &[u8]) -> Vec<f64> {
    let six = Desired::<6>::decode(body).map(|desired| desired.q_rad.to_vec());
    let seven = || Desired::<7>::decode(body).map(|desired| desired.q_rad.to_vec());
    six.or_else(seven).unwrap_or_default()
}

/// Why a check refused, in words: joint, reason, time. `name` says what a joint is called, 0 the
/// first.
#[must_use]
pub fn refusal(check: &MoveCheck, name: impl Fn(usize) -> String) -> String {
    let index = usize::try_from(check.joint).ok().and_then(|joint| joint.checked_sub(1));
    let joint = index.map_or_else(String::new, |index| format!("{} ", name(index)));
    let index = usize::try_from(check.reason).ok().and_then(|reason| reason.checked_sub(1));
    let why = index.and_then(|n| REASONS.get(n)).unwrap_or(&"no reason given");
    let by = if check.ratio > 0.0 { format!(" by {:.2}", check.ratio) } else { String::new() };
    let when = if check.t_s > 0.0 { format!(", {:.2} s on", check.t_s) } else { String::new() };
    format!("{joint}{why}{by}{when}")
}
