//! The law of a task that is a sequence of phases: a state machine over a table that is compiled
//! when the task is read. In a phase with features the law is that of
//! [`task_frame`](super::task_frame) with the phase's own Jacobian and gains; a phase without
//! features moves at its velocity or stands still. Nothing here allocates after the table is made.
//!
//! Source: the thesis, section 5.2: a task as an ordered sequence of states, each characterised by
//! features of the tactile image. The exploratory procedures that it is meant to express are those
//! of Lederman and Klatzky, Cognitive Psychology 19, 1987.

use taktil_mechanics::Pose;
use taktil_rtcore::{Fold, Invalid, StateHash};
use taktil_signal::{Contact, PhaseChange, contact, phase_cause};

use super::task_frame::{TaskFrameGains, TaskFrameState, displacement};
use super::{Law, Observation};
use crate::config::Config;
use crate::config::array::Array;
use crate::config::phases::{
    CONDITIONS_MAX, Next, PHASES_MAX, PhaseConfig, PhaseKind, Quantity, TouchTask,
};
use crate::config::task_frame::{Feature, MOTIONS_MAX, Motion};
use crate::encoder_hold::{EncoderMotions, UnfeltMotion};
use crate::perception::TouchFeatures;

/// A way is given up after this many times the time that it takes at its speed: the finger may be
/// held up by something that the array does not see.
const WAY_TIME_FACTOR: f64 = 3.0;
/// Time that is added to it for the start of the motion (s).
const WAY_TIME_MARGIN_S: f64 = 0.1;

/// What the conditions of a phase go by in one job.
#[derive(Clone, Copy, Debug)]
pub struct Sensed<'a> {
    /// Features of the newest image.
    pub touch: &'a TouchFeatures,
    /// Speed of slip (mm/s); absent where none is detected.
    pub slip_mm_s: Option<f64>,
    /// Force along the finger's z by the wrist (N); absent where it is not known.
    pub wrist_n: Option<f64>,
}

/// What happened in a job.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhaseEvents {
    /// Contact was gained or lost, or something was done about it.
    pub contact: Option<Contact>,
    /// The task went on to another phase.
    pub change: Option<PhaseChange>,
}

/// A condition: the quantity has to lie in this open interval.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Guard {
    quantity: Quantity,
    low: f64,
    high: f64,
}

/// A phase as the state machine needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CompiledPhase {
    kind: PhaseKind,
    velocity_per_s: [f64; MOTIONS_MAX],
    gains: Option<TaskFrameGains>,
    /// Motions in which drift is left.
    unheld: [bool; MOTIONS_MAX],
    until: [Option<Guard>; CONDITIONS_MAX],
    for_s: f64,
    done: Option<Next>,
    failed: Option<Next>,
    within_s: f64,
    within_mm: f64,
    /// Time after which a bounded way is given up (s).
    way_time_s: f64,
    needs_contact: bool,
    visits_max: u32,
}

impl CompiledPhase {
    fn new(
        phase: &PhaseConfig,
        done: Option<Next>,
        failed: Option<Next>,
        array: &Array,
    ) -> Result<CompiledPhase, Invalid> {
        let gains = phase.task_frame().map(|frame| TaskFrameGains::new(&frame, array));
        let mut until = [None; CONDITIONS_MAX];
        for (guard, condition) in until.iter_mut().zip(&phase.until) {
            let (low, high) = condition.interval();
            *guard = Some(Guard { quantity: condition.quantity, low, high });
        }
        let mut unheld = [false; MOTIONS_MAX];
        phase.unheld.iter().for_each(|motion| unheld[*motion as usize] = true);
        let way: f64 = phase.velocity_per_s[..3].iter().map(|speed| speed * speed).sum();
        let within_mm = phase.within_mm.unwrap_or(f64::INFINITY);
        let way_time_s = match way > 0.0 {
            true => WAY_TIME_FACTOR * within_mm / way.sqrt() + WAY_TIME_MARGIN_S,
            false => f64::INFINITY,
        };
        Ok(CompiledPhase {
            kind: phase.does,
            velocity_per_s: phase.velocity_per_s,
            gains: gains.transpose()?,
            unheld,
            until,
            for_s: phase.for_s,
            done,
            failed,
            within_s: phase.within_s.unwrap_or(f64::INFINITY),
            within_mm,
            way_time_s,
            needs_contact: phase.needs_contact(),
            visits_max: phase.visits_max.unwrap_or(u32::MAX),
        })
    }
}

/// The state machine: which phase the task is in, and since when.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PhaseMachine {
    /// The phase; none before the first job and after the end.
    current: Option<usize>,
    is_ended: bool,
    time_s: f64,
    /// How long the conditions have held (s).
    met_s: f64,
    /// Motion in the phase (mm, mrad).
    moved: [f64; MOTIONS_MAX],
    visits: [u32; PHASES_MAX],
    in_contact: bool,
    gained: u32,
    lost: u32,
}

impl PhaseMachine {
    const START: PhaseMachine = PhaseMachine {
        current: None,
        is_ended: false,
        time_s: 0.0,
        met_s: 0.0,
        moved: [0.0; MOTIONS_MAX],
        visits: [0; PHASES_MAX],
        in_contact: false,
        gained: 0,
        lost: 0,
    };

    fn way_mm(&self) -> f64 {
        self.moved[..3].iter().map(|part| part * part).sum::<f64>().sqrt()
    }

    /// Whether the quantity of a condition lies in its interval; one that is not defined does not.
    fn is_met(&self, guard: &Guard, sensed: &Sensed<'_>) -> bool {
        let touch = sensed.touch;
        let value = match guard.quantity {
            Quantity::M0 => Some(touch.m0),
            Quantity::MX => touch.contact.then_some(touch.m_x),
            Quantity::XC => touch.x_c,
            Quantity::YC => touch.y_c,
            Quantity::ThetaZ => touch.theta_z_rad.map(|theta| 1e3 * theta),
            Quantity::Contact => touch.contact.then_some(1.0),
            Quantity::Slip => sensed.slip_mm_s,
            Quantity::WristForce => sensed.wrist_n,
            Quantity::Way => Some(self.way_mm()),
            Quantity::Time => Some(self.time_s),
        };
        value.is_some_and(|value| guard.low < value && value < guard.high)
    }

    /// Where the phase leads to in this job, and why.
    fn outcome(
        &mut self,
        phase: &CompiledPhase,
        sensed: &Sensed<'_>,
        dt_s: f64,
    ) -> Option<(Option<Next>, u32)> {
        if phase.done.is_some() {
            let mut guards = phase.until.iter().flatten();
            let met = guards.all(|guard| self.is_met(guard, sensed));
            self.met_s = if met { self.met_s + dt_s } else { 0.0 };
            if met && (phase.for_s <= 0.0 || self.met_s >= phase.for_s) {
                return Some((phase.done, phase_cause::CONDITIONS_MET));
            }
        }
        let cause = if phase.needs_contact && !sensed.touch.contact {
            phase_cause::CONTACT_LOST
        } else if self.time_s >= phase.within_s {
            phase_cause::TIME_OUT
        } else if self.way_mm() >= phase.within_mm || self.time_s > phase.way_time_s {
            phase_cause::TOO_FAR
        } else {
            return None;
        };
        Some((phase.failed, cause))
    }
}

/// The law of the module.
#[derive(Clone, Debug, PartialEq)]
pub struct PhasesLaw {
    table: Box<[CompiledPhase]>,
    first: usize,
    machine: PhaseMachine,
    state: TaskFrameState,
}

impl PhasesLaw {
    /// Compiles the task of a configuration; allocates.
    ///
    /// # Errors
    /// A configuration without a task, and what [`TouchTask::check`] refuses.
    pub fn new(config: &Config) -> Result<PhasesLaw, Invalid> {
        let Some(task) = &config.phases else {
            let remedy = "name a file in task_file, or write [[tactile_servo.phases.phase]]";
            return Err(Invalid::new("law", "is `phases`, but there is no task", remedy));
        };
        PhasesLaw::of_task(task, config).map_err(|bad| bad.within("phases"))
    }

    fn of_task(task: &TouchTask, config: &Config) -> Result<PhasesLaw, Invalid> {
        task.check(config)?;
        let compiled = |(index, phase): (usize, &PhaseConfig)| {
            let place = format!("phase[{index}]");
            let (done, failed) = task.successors(index)?;
            let compiled = CompiledPhase::new(phase, done, failed, &config.array);
            compiled.map_err(|bad| bad.within(&place))
        };
        let table: Vec<CompiledPhase> =
            task.phase.iter().enumerate().map(compiled).collect::<Result<_, _>>()?;
        Ok(PhasesLaw {
            table: table.into(),
            first: task.first_index()?,
            machine: PhaseMachine::START,
            state: TaskFrameState::default(),
        })
    }

    fn phase(&self) -> Option<&CompiledPhase> {
        self.machine.current.and_then(|index| self.table.get(index))
    }

    /// Whether the task has come to its end.
    #[must_use]
    pub fn is_ended(&self) -> bool {
        self.machine.is_ended
    }

    /// Advances by one job of `dt_s`; one change of phase at most. Images that are not trusted
    /// change nothing.
    pub fn advance(&mut self, sensed: &Sensed<'_>, dt_s: f64) -> PhaseEvents {
        if !sensed.touch.trusted || self.machine.is_ended {
            return PhaseEvents::default();
        }
        let machine = &mut self.machine;
        machine.time_s += dt_s;
        let touch = sensed.touch;
        let mut kind = match (machine.in_contact, touch.contact) {
            (false, true) => Some(contact::GAINED),
            (true, false) => Some(contact::LOST),
            _ => None,
        };
        machine.in_contact = touch.contact;
        machine.gained += u32::from(kind == Some(contact::GAINED));
        machine.lost += u32::from(kind == Some(contact::LOST));
        let leads = match machine.current {
            None => Some((Some(Next::Phase(self.first)), phase_cause::TASK_STARTED)),
            Some(index) => machine.outcome(&self.table[index], sensed, dt_s),
        };
        let mut change = None;
        if let Some((next, cause)) = leads {
            change = Some(self.enter(next.unwrap_or(Next::End), cause, touch.m0));
            if !touch.contact && cause != phase_cause::TASK_STARTED {
                kind = kind.or_else(|| self.contact_kind());
            }
        }
        let PhaseMachine { gained, lost, .. } = self.machine;
        let contact = kind.map(|kind| Contact {
            kind,
            gained,
            lost,
            m0: touch.m0,
            ..taktil_rtcore::Payload::ZERO
        });
        PhaseEvents { contact, change }
    }

    /// What the phase that was entered without contact does about it.
    fn contact_kind(&self) -> Option<u32> {
        let Some(phase) = self.phase() else { return Some(contact::GIVEN_UP) };
        match phase.kind {
            PhaseKind::Approach => Some(contact::SOUGHT),
            PhaseKind::Move if phase.velocity_per_s[Motion::Z as usize] < 0.0 => {
                Some(contact::RETRACTED)
            }
            PhaseKind::Hold if phase.failed.is_none() => Some(contact::GIVEN_UP),
            _ => None,
        }
    }

    /// Goes on to another phase. A phase that was entered too often leads to what follows its
    /// failure; that ends after as many steps as there are phases.
    fn enter(&mut self, mut next: Next, mut cause: u32, m0: f64) -> PhaseChange {
        let before = self.machine;
        for _ in 0..=self.table.len() {
            let Next::Phase(index) = next else { break };
            let visits = &mut self.machine.visits[index];
            *visits = visits.saturating_add(1);
            if *visits <= self.table[index].visits_max {
                break;
            }
            (next, cause) = (self.table[index].failed.unwrap_or(Next::End), phase_cause::TOO_OFTEN);
        }
        let current = match next {
            Next::Phase(index) if self.machine.visits[index] <= self.table[index].visits_max => {
                Some(index)
            }
            _ => None,
        };
        let same = match (self.phase(), current.map(|index| &self.table[index])) {
            (Some(old), Some(new)) => has_same_features(old, new),
            _ => false,
        };
        self.state.begin_phase(same);
        self.machine.current = current;
        self.machine.is_ended = current.is_none();
        (self.machine.time_s, self.machine.met_s) = (0.0, 0.0);
        self.machine.moved = [0.0; MOTIONS_MAX];
        let number = |index: Option<usize>| index.map_or(0, |index| index as u32 + 1);
        PhaseChange {
            at_ns: 0,
            time_s: before.time_s,
            moved: before.moved,
            m0,
            phase: number(current),
            before: number(before.current),
            cause,
            visits: current.map_or(0, |index| self.machine.visits[index]),
        }
    }

    /// The motion of one job of `dt_s` in a phase that moves without features (mm, mrad).
    pub fn unservoed_step(&mut self, dt_s: f64) -> Option<[f64; MOTIONS_MAX]> {
        let phase = self.phase().filter(|phase| phase.gains.is_none())?;
        let step = phase.velocity_per_s.map(|speed| speed * dt_s);
        if step.iter().all(|part| *part == 0.0) {
            return None;
        }
        self.state.commanded_y = [step[1], step[4]];
        Some(step)
    }

    /// The motion that the newest answer of a phase with features asks for along y and about it
    /// (mm, mrad).
    #[must_use]
    pub fn commanded_y(&self) -> [f64; 2] {
        self.state.commanded_y
    }

    /// Adds a motion that was carried out (mm, mrad).
    pub fn add_motion(&mut self, step: &[f64; MOTIONS_MAX], share: f64) {
        for (sum, part) in self.machine.moved.iter_mut().zip(step) {
            *sum += part * share;
        }
    }
}

/// Whether both phases servo the same features, so that their integrals mean the same.
fn has_same_features(old: &CompiledPhase, new: &CompiledPhase) -> bool {
    let names = |phase: &CompiledPhase| -> [Option<Feature>; MOTIONS_MAX] {
        phase.gains.map_or([None; MOTIONS_MAX], |gains| gains.feature_names())
    };
    names(old) == names(new)
}

impl Fold for PhasesLaw {
    fn fold(&self, hash: &mut StateHash) {
        let machine = &self.machine;
        hash.add(&self.state).add(&machine.current.map_or(u32::MAX, |index| index as u32));
        hash.add(&machine.is_ended).add(&machine.time_s).add(&machine.met_s);
        hash.add(&machine.moved[..]).add(&machine.in_contact);
        hash.add(&machine.gained).add(&machine.lost);
        for visits in &machine.visits[..self.table.len()] {
            hash.add(visits);
        }
    }
}

impl Law for PhasesLaw {
    fn reset(&mut self, _config: &Config) {
        (self.machine, self.state) = (PhaseMachine::START, TaskFrameState::default());
    }

    fn observe(
        &mut self,
        config: &Config,
        observation: &Observation<'_>,
        _x_c_desired: f64,
    ) -> Option<[f64; 4]> {
        let Some(gains) = self.phase().and_then(|phase| phase.gains) else {
            self.state.begin_rest();
            return None;
        };
        let ([x, _, z, theta_x, _, theta_z], next) =
            displacement(config, &gains, &self.state, observation.features);
        self.state = next;
        Some([x, z, theta_x, theta_z])
    }

    /// Leaves to the encoders what the phase does not move.
    fn encoder_motions(&mut self, config: &Config, tool: &Pose, span_s: f64) -> EncoderMotions {
        let drift = self.state.drift_along_x(tool);
        let hold_x_m = drift.correction(config.drift_correction_per_s, span_s).0;
        let [x, y, theta_y] = match self.phase() {
            Some(CompiledPhase { gains: Some(gains), .. }) => gains.is_moved(),
            Some(phase) => [Motion::X, Motion::Y, Motion::ThetaY].map(|motion| {
                let index = motion as usize;
                phase.velocity_per_s[index] != 0.0 || phase.unheld[index]
            }),
            None => [false; 3],
        };
        let commanded = self.state.commanded_y.map(|part| 1e-3 * part);
        let motion = |moved: bool, commanded: f64| {
            if moved { UnfeltMotion::Commanded(commanded) } else { UnfeltMotion::Held }
        };
        EncoderMotions {
            x_m: (!x).then_some(hold_x_m),
            y: motion(y, commanded[0]),
            theta_y: motion(theta_y, commanded[1]),
        }
    }
}

#[cfg(test)]
mod tests;
