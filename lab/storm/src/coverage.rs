//! What a storm has been through: each kind of fault at each target in each state, with the
//! reaction that followed; and what never came.

use std::collections::{BTreeMap, BTreeSet};

use taktil_hal::Nanos;
use taktil_hal::fault::FaultKind;
use taktil_rtcore::{FaultCode, Mode};
use taktil_signal::State;

use crate::case::{Case, fault_end};
use crate::check::PathPoint;
use crate::run::Outcome;

/// Time after the end of a fault within which a change counts as a reaction to it.
const REACTION_TIME: Nanos = Nanos::from_millis(200);

/// What followed a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reaction {
    /// The machine went on.
    None,
    /// It gave the motion back and held.
    Degrade,
    /// It came to rest on the servo.
    Stop,
    /// The drives went off.
    DriveOff,
}

impl Reaction {
    /// All of them, weakest first.
    pub const ALL: [Reaction; 4] =
        [Reaction::None, Reaction::Degrade, Reaction::Stop, Reaction::DriveOff];

    /// A word for tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Reaction::None => "none",
            Reaction::Degrade => "degrade",
            Reaction::Stop => "stop",
            Reaction::DriveOff => "off",
        }
    }
}

/// Counts of what was met.
#[derive(Clone, Debug, Default)]
pub struct Coverage {
    /// How often a kind met a target.
    met: BTreeMap<(FaultKind, String), u64>,
    /// How often a kind in a state was followed by a reaction.
    reactions: BTreeMap<(FaultKind, State, Reaction), u64>,
    /// How often each fault was latched first.
    first_faults: BTreeMap<u32, u64>,
    states: BTreeSet<State>,
    modes: BTreeSet<Mode>,
}

impl Coverage {
    /// Adds a case and what it came to.
    pub fn add(&mut self, case: &Case, outcome: &Outcome) {
        for fault in case.plan.faults() {
            *self.met.entry((fault.kind, fault.target.clone())).or_default() += 1;
            let end = Nanos(fault_end(fault).0.saturating_add(REACTION_TIME.0));
            let state = point_at(&outcome.path, fault.at).map_or(State::Start, |point| point.state);
            let reaction = reaction(&outcome.path, fault.at, end);
            *self.reactions.entry((fault.kind, state, reaction)).or_default() += 1;
        }
        let mut last = 0;
        for point in &outcome.path {
            self.states.insert(point.state);
            self.modes.insert(point.mode);
            if point.first_fault != last && point.first_fault != 0 {
                *self.first_faults.entry(point.first_fault).or_default() += 1;
            }
            last = point.first_fault;
        }
    }

    /// Adds what another thread has counted.
    pub fn merge(&mut self, other: Coverage) {
        for (key, count) in other.met {
            *self.met.entry(key).or_default() += count;
        }
        for (key, count) in other.reactions {
            *self.reactions.entry(key).or_default() += count;
        }
        for (key, count) in other.first_faults {
            *self.first_faults.entry(key).or_default() += count;
        }
        self.states.extend(other.states);
        self.modes.extend(other.modes);
    }

    /// A table of kinds against states; each cell has the numbers of reactions, weakest first.
    #[must_use]
    pub fn table(&self) -> String {
        let mut out = String::from("fault kind, and in which state: none/degrade/stop/off\n");
        let states: Vec<State> =
            State::ALL.into_iter().filter(|state| self.states.contains(state)).collect();
        out += &format!("  {:<12}", "");
        for state in &states {
            out += &format!(" {:>15}", short(*state));
        }
        out.push('\n');
        for kind in FaultKind::ALL {
            let count = |state: State, reaction| {
                self.reactions.get(&(kind, state, reaction)).copied().unwrap_or(0)
            };
            let row: Vec<String> = states
                .iter()
                .map(|state| {
                    let counts = Reaction::ALL.map(|reaction| count(*state, reaction));
                    let shown = counts.map(|count| count.to_string()).join("/");
                    if counts == [0; 4] { "-".to_owned() } else { shown }
                })
                .collect();
            if row.iter().all(|cell| cell == "-") {
                continue;
            }
            out += &format!("  {:<12}", kind.name());
            for cell in row {
                out += &format!(" {cell:>15}");
            }
            out.push('\n');
        }
        out
    }

    /// The faults that were latched first, with their counts.
    pub fn first_faults(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        self.first_faults.iter().map(|(code, count)| {
            let known = u16::try_from(*code).ok().and_then(FaultCode::from_code);
            (known.map_or("a fault of another version", FaultCode::text), *count)
        })
    }

    /// What was never met: kinds that nothing had, states, modes, and faults that were never first.
    #[must_use]
    pub fn never(&self) -> Vec<String> {
        let kinds: BTreeSet<FaultKind> = self.met.keys().map(|(kind, _)| *kind).collect();
        let kinds = FaultKind::ALL.into_iter().filter(|kind| !kinds.contains(kind));
        let states = State::ALL.into_iter().filter(|state| !self.states.contains(state));
        let modes = Mode::ALL.into_iter().filter(|mode| !self.modes.contains(mode));
        let faults = FaultCode::ALL.iter().filter(|fault| {
            fault.class() > taktil_rtcore::fault::Class::Note
                && !self.first_faults.contains_key(&u32::from(**fault as u16))
        });
        kinds
            .map(|kind| format!("fault kind {}", kind.name()))
            .chain(states.map(|state| format!("state {}", state.name())))
            .chain(modes.map(|mode| format!("mode {mode:?}")))
            .chain(faults.map(|fault| format!("fault {fault:?} first")))
            .collect()
    }
}

fn short(state: State) -> &'static str {
    match state {
        State::Start => "start",
        State::IdleUncalibrated => "idle uncal",
        State::ManualUncalibrated => "manual uncal",
        State::IdleCalibrated => "idle cal",
        State::ManualJoint => "manual joint",
        State::ManualCartesian => "manual cart",
        State::Trajectory => "trajectory",
        State::TrajectoryUser => "traj user",
        State::TactileServo => "tactile",
    }
}

/// Where the machine was at an instant.
fn point_at(path: &[PathPoint], at: Nanos) -> Option<&PathPoint> {
    path.iter().rev().find(|point| point.at <= at)
}

/// The strongest change within a span.
fn reaction(path: &[PathPoint], from: Nanos, to: Nanos) -> Reaction {
    let within = path.windows(2).filter(|pair| from <= pair[1].at && pair[1].at < to);
    let one = |pair: &[PathPoint]| match (pair[0].mode, pair[1].mode) {
        (was, Mode::Fault | Mode::Off) if was != pair[1].mode => Reaction::DriveOff,
        (was, Mode::Stopping) if was != Mode::Stopping => Reaction::Stop,
        (Mode::Moving, Mode::Hold) if pair[0].state == State::TactileServo => Reaction::Degrade,
        _ => Reaction::None,
    };
    within.map(one).max().unwrap_or(Reaction::None)
}
