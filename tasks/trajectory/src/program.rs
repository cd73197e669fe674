//! The state machine of a queue of moves. First every leg is planned, one move a job, and checked,
//! a few ticks a job. Then the legs are run one after another, and the next leg is planned while
//! one is run. No job does more than its neighbours, however long the queue is. The arm does not
//! move before the last leg has passed its check, and the program ends where the arm cannot follow.

use taktil_mechanics::arm::{Arm, FollowError};
use taktil_mechanics::feasibility::{
    Extremum, FeasibilityCheck, FeasibilityCriteria, FeasibilityReport, FeasibilityStatus,
    Infeasible,
};
use taktil_mechanics::paul::Setpoint;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::tracking::{PathRef, PathTracker};
use taktil_rtcore::{Payload, StateHash};
use taktil_signal::MoveCheck;

use crate::clock::Clock;
use crate::config::{Config, MOVES_MAX, Step};
use crate::law::{self, Leg, PathTiming};

/// Ticks checked in one job: four times as fast as they will be run, and one check the torque.
pub(crate) const TICKS_CHECKED_PER_JOB: u32 = 4;

/// A pause at full speed takes this many times the shortest transition: it may fall into one.
pub(crate) const PAUSE_TRANSITION_FACTOR: f64 = 1.5;

/// Everything about a queue that does not change.
pub struct Plan<const N: usize = 6, A: Arm<N> = Puma260> {
    pub(crate) arm: A,
    steps: Vec<Step<N>>,
    pub(crate) pace: PathTiming,
    pub(crate) terms: FeasibilityCriteria<N, A>,
}

impl<const N: usize, A: Arm<N>> Plan<N, A> {
    /// The plan of a checked queue, checked every `tick_s` (s).
    #[must_use]
    pub fn new(config: &Config, robot: &Robot<N, A>, steps: Vec<Step<N>>) -> Plan<N, A> {
        let terms = FeasibilityCriteria {
            arm: robot.arm,
            dynamics: robot.dynamics.clone(),
            torque_max_nm: robot.torque_max_nm,
            position_error_max_m: config.path_error_max_mm * 1e-3,
            orientation_error_max_rad: config.path_error_max_deg.to_radians(),
            // The lane's period; known with the first job.
            tick_s: 0.0,
        };
        Plan { arm: robot.arm, steps, pace: PathTiming::of(config), terms }
    }
}

/// Where a leg begins.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LegStart<const N: usize> {
    /// Number of its first step.
    step: usize,
    /// Joints (rad).
    q: JointVector<N>,
}

#[derive(Clone, Copy, Debug)]
enum Stage {
    /// The present leg is being planned for its check.
    Planning,
    /// The present leg is being checked.
    Checking,
    /// Everything was checked, and the first leg is being planned again for execution.
    Replanning,
    /// The present leg has been executed since job `since`; `last` is its last job.
    Running { since: u64, last: u64 },
}

/// A queue that is being checked or executed. A leg takes some kB, so nothing in it is moved or
/// copied.
#[derive(Debug)]
pub struct Program<const N: usize = 6, A: Arm<N> = Puma260> {
    leg_starts: [LegStart<N>; MOVES_MAX + 1],
    /// Legs checked so far.
    legs: usize,
    /// The leg that is run.
    leg: usize,
    /// The present leg, and the one that is planned while it is executed.
    legs_in_use: [Leg<N>; 2],
    stage: Stage,
    inspection: FeasibilityCheck<N, A>,
    lead: PathTracker<N, A>,
    /// Desired joints now (rad).
    q: JointVector<N>,
    check: MoveCheck,
    /// Whether the arm is to stand on its path.
    paused: bool,
    /// The time of the present leg once it has been paused; before that, the leg runs in real time.
    clock: Option<Clock>,
}

/// Result of one job of a program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome<const N: usize = 6> {
    /// The setpoint, and whether all is done.
    At(Setpoint<N>, bool),
    /// The queue is refused, or the arm cannot follow; the check says why.
    Refused,
}

impl<const N: usize, A: Arm<N>> Program<N, A> {
    /// Room for a program, before the first is begun.
    ///
    /// # Errors
    /// Timing with which no path can be planned.
    pub fn empty(plan: &Plan<N, A>) -> Result<Program<N, A>, law::Infeasible> {
        let q = JointVector::zeros();
        let empty_leg = || Leg::empty(&plan.arm, &plan.pace);
        let legs_in_use = [empty_leg()?, empty_leg()?];
        let terms = FeasibilityCriteria { tick_s: 1.0, ..plan.terms.clone() };
        let inspection = FeasibilityCheck::new(legs_in_use[0].route(), &q, &terms);
        Ok(Program {
            leg_starts: [LegStart { step: 0, q }; MOVES_MAX + 1],
            legs: 0,
            leg: 0,
            legs_in_use,
            stage: Stage::Planning,
            inspection: inspection.map_err(|_| law::Infeasible::Limits)?,
            lead: PathTracker::new(&plan.arm, &q),
            q,
            check: MoveCheck::ZERO,
            paused: false,
            clock: None,
        })
    }

    /// Begins at joints `start` (rad), where the arm is wanted; `tick_s` is the lane's period (s).
    ///
    /// # Errors
    /// The check, with its reason.
    pub fn begin(
        &mut self,
        plan: &mut Plan<N, A>,
        start: &JointVector<N>,
        tick_s: f64,
    ) -> Result<(), MoveCheck> {
        plan.terms.tick_s = tick_s;
        self.check = MoveCheck { verdict: 1, singular: [1.0; 3], ..MoveCheck::ZERO };
        (self.legs, self.leg, self.q) = (0, 0, *start);
        (self.paused, self.clock) = (false, None);
        self.begin_leg(plan, 0, *start).map_err(|why| refusal_check(self.check, 0, &why))
    }

    /// The state of the check.
    #[must_use]
    pub fn check(&self) -> &MoveCheck {
        &self.check
    }

    /// Brings the arm to rest on its path, or continues from there, from the next job on. A program
    /// that has not started to move yet waits before its first move.
    pub fn pause(&mut self, paused: bool) {
        self.paused = paused;
    }

    /// Folds what the next job depends on.
    pub fn fold(&self, hash: &mut StateHash) {
        if self.paused || self.clock.is_some() {
            hash.add(&self.paused).add(&self.clock);
        }
        hash.add(&self.legs).add(&self.leg).add(self.q.as_slice()).add(&self.check);
        for leg in &self.legs_in_use {
            leg.fold(hash);
        }
        match &self.stage {
            Stage::Planning => hash.word(0),
            Stage::Checking => hash.word(1).add(self.inspection.report().end_q.as_slice()),
            Stage::Replanning => hash.word(2),
            Stage::Running { since, last } => {
                hash.word(3).add(self.lead.joints().as_slice()).add(since).add(last)
            }
        };
        if self.lead.settling_s() > 0.0 {
            hash.add(&self.lead.settling_s());
        }
    }

    /// One job, number `tick`: plans one move, checks a few ticks, or runs.
    pub fn step(&mut self, plan: &Plan<N, A>, tick: u64) -> Outcome<N> {
        let outcome = match self.stage {
            Stage::Planning => self.append_move(plan),
            Stage::Checking => self.inspect(plan, tick),
            Stage::Replanning => self.append_move_for_run(plan, 0, 0).map(|()| {
                if self.legs_in_use[0].is_whole() {
                    self.start(plan, tick);
                }
            }),
            Stage::Running { .. } => Ok(()),
        };
        match outcome {
            Err((step, why)) => self.refuse(step, &why),
            Ok(()) => match self.stage {
                Stage::Running { .. } => self.run(plan, tick),
                _ => Outcome::At(Setpoint::rest(&self.q), false),
            },
        }
    }

    /// The leg after those checked begins with `step` at `q`.
    fn begin_leg(
        &mut self,
        plan: &Plan<N, A>,
        step: usize,
        q: JointVector<N>,
    ) -> Result<(), Rejection> {
        self.leg_starts[self.legs] = LegStart { step, q };
        self.stage = Stage::Planning;
        self.legs_in_use[0]
            .begin(&plan.arm, &q, &plan.steps, step, &plan.pace)
            .map_err(Rejection::Planning)
    }

    /// Plans one move of the leg to be checked.
    fn append_move(&mut self, plan: &Plan<N, A>) -> Result<(), (usize, Rejection)> {
        let begin = &self.leg_starts[self.legs];
        let slot = &mut self.legs_in_use[0];
        let at_begin = |why| (begin.step, why);
        slot.append_move(&plan.arm, &plan.steps, &plan.pace)
            .map_err(|why| at_begin(Rejection::Planning(why)))?;
        if slot.is_whole() {
            self.inspection = FeasibilityCheck::new(slot.route(), &begin.q, &plan.terms)
                .map_err(|why| at_begin(Rejection::Inspection(why)))?;
            self.stage = Stage::Checking;
        }
        Ok(())
    }

    /// Checks a few ticks. After a leg that passed, the next leg is planned, or the program starts.
    fn inspect(&mut self, plan: &Plan<N, A>, tick: u64) -> Result<(), (usize, Rejection)> {
        let slot = &self.legs_in_use[0];
        match self.inspection.advance(TICKS_CHECKED_PER_JOB, slot.route(), &plan.terms) {
            FeasibilityStatus::InProgress => return Ok(()),
            // The check knows the leg but not the move in it; a leg of one move is reported
            // exactly.
            FeasibilityStatus::Infeasible(why) => {
                return Err((self.leg_starts[self.legs].step, Rejection::Inspection(why)));
            }
            FeasibilityStatus::Feasible => {}
        }
        let preview = self.inspection.report();
        record_peaks(&mut self.check, preview);
        let (next, end) = (slot.next_step(), preview.end_q);
        self.check.moves = next as u32;
        self.legs += 1;
        if next < plan.steps.len() {
            return self.begin_leg(plan, next, end).map_err(|why| (next, why));
        }
        self.check.verdict = 2;
        if self.legs == 1 {
            // The only leg is planned already.
            self.start(plan, tick);
            return Ok(());
        }
        self.stage = Stage::Replanning;
        self.begin_for_run(plan, 0, 0)
    }

    /// Begins to plan leg `number` at index `slot` for execution.
    fn begin_for_run(
        &mut self,
        plan: &Plan<N, A>,
        number: usize,
        slot: usize,
    ) -> Result<(), (usize, Rejection)> {
        let LegStart { step, q } = &self.leg_starts[number];
        let begun = self.legs_in_use[slot].begin(&plan.arm, q, &plan.steps, *step, &plan.pace);
        begun.map_err(|why| (*step, Rejection::Planning(why)))
    }

    /// Plans one move of leg `number` at index `slot` for execution.
    fn append_move_for_run(
        &mut self,
        plan: &Plan<N, A>,
        number: usize,
        slot: usize,
    ) -> Result<(), (usize, Rejection)> {
        let planned = self.legs_in_use[slot].append_move(&plan.arm, &plan.steps, &plan.pace);
        planned.map_err(|why| (self.leg_starts[number].step, Rejection::Planning(why)))
    }

    /// Starts the present leg in this job.
    fn start(&mut self, plan: &Plan<N, A>, tick: u64) {
        let begin = &self.leg_starts[self.leg];
        self.lead = PathTracker::new(&plan.arm, &begin.q);
        self.q = begin.q;
        self.stage = Stage::Running { since: tick, last: tick };
        self.clock = self.paused.then(|| Clock::new(false));
    }

    /// The time of the leg that is run, in job `tick` (s).
    fn time_s(&mut self, plan: &Plan<N, A>, since: u64, last: u64, tick: u64) -> f64 {
        let tick_s = plan.terms.tick_s;
        if self.paused && self.clock.is_none() {
            self.clock = Some(Clock::running_at(seconds(last - since, tick_s)));
        }
        let Some(clock) = &mut self.clock else { return seconds(tick - since, tick_s) };
        let room = plan.arm.speed_max().component_div(plan.arm.acceleration_max()).max();
        let tau_s = plan.pace.tau_s.max(PAUSE_TRANSITION_FACTOR * self.check.speed_share * room);
        clock.set_running(!self.paused);
        clock.advance(seconds(tick - last, tick_s), tau_s);
        clock.t_s()
    }

    /// Plans the leg after the present one, one move a job.
    fn prepare(&mut self, plan: &Plan<N, A>, first_job: bool) -> Result<(), (usize, Rejection)> {
        let (next, slot) = (self.leg + 1, (self.leg + 1) % 2);
        if next >= self.legs {
            return Ok(());
        }
        if first_job {
            self.begin_for_run(plan, next, slot)
        } else {
            self.append_move_for_run(plan, next, slot)
        }
    }

    fn run(&mut self, plan: &Plan<N, A>, tick: u64) -> Outcome<N> {
        let Stage::Running { since, last } = self.stage else {
            return Outcome::At(Setpoint::rest(&self.q), false);
        };
        let first_job = tick == since;
        let t_s = self.time_s(plan, since, last, tick);
        self.stage = Stage::Running { since, last: tick };
        let led = if tick == last {
            Ok(None)
        } else {
            self.next_setpoint(plan, t_s, tick - last).map(Some)
        };
        let (mut setpoint, over) = match led {
            Ok(None) => (Setpoint::rest(&self.q), false),
            Ok(Some(led)) => led,
            Err(why) => {
                let lost = Rejection::Inspection(Infeasible::NotFollowed { error: why, t_s });
                return self.refuse(self.leg_starts[self.leg].step, &lost);
            }
        };
        let last_leg = self.leg + 1 == self.legs;
        // After a very short leg the next one may not be planned yet; the arm then waits at the end
        // of the leg.
        let next = over && !last_leg && self.legs_in_use[(self.leg + 1) % 2].is_whole();
        if next {
            self.leg += 1;
            self.start(plan, tick);
            setpoint = Setpoint::rest(&self.q);
        }
        self.q = setpoint.q;
        match self.prepare(plan, first_job || next) {
            Ok(()) => Outcome::At(setpoint, over && last_leg),
            Err((step, why)) => self.refuse(step, &why),
        }
    }

    /// Advances along the present leg to its time `t_s` (s), a number of ticks after the last one:
    /// returns the setpoint, and whether the arm is at the end of the leg.
    fn next_setpoint(
        &mut self,
        plan: &Plan<N, A>,
        t_s: f64,
        ticks: u64,
    ) -> Result<(Setpoint<N>, bool), FollowError> {
        let route = self.legs_in_use[self.leg % 2].route();
        let dt_s = seconds(ticks, plan.terms.tick_s);
        let led = self.lead.step(&plan.arm, route, t_s, dt_s)?;
        let at = match (route, &self.clock) {
            (PathRef::Joint(_), Some(clock)) => clock.with_speed_of(&led.setpoint),
            _ => led.setpoint,
        };
        Ok((at, led.is_finished))
    }

    fn refuse(&mut self, step: usize, why: &Rejection) -> Outcome<N> {
        self.check = refusal_check(self.check, step, why);
        Outcome::Refused
    }
}

/// Why a queue is refused.
pub(crate) enum Rejection {
    Planning(law::Infeasible),
    Inspection(Infeasible),
}

#[expect(clippy::cast_precision_loss, reason = "jobs of a run stay far below 2^53")]
fn seconds(ticks: u64, tick_s: f64) -> f64 {
    ticks as f64 * tick_s
}

pub(crate) fn record_peaks<const N: usize>(check: &mut MoveCheck, preview: &FeasibilityReport<N>) {
    let most =
        |peaks: &[Extremum; N]| peaks.iter().fold(0.0, |most: f64, peak| most.max(peak.value));
    check.duration_s += preview.duration_s;
    check.speed_share = check.speed_share.max(most(&preview.speed_ratio));
    check.torque_share = check.torque_share.max(most(&preview.torque_ratio));
    check.path_error_m = check.path_error_m.max(preview.position_error_m.value);
    check.path_error_rad = check.path_error_rad.max(preview.orientation_error_rad.value);
    for (least, peak) in check.singular.iter_mut().zip(&preview.singularity) {
        *least = least.min(peak.value);
    }
}

pub(crate) fn refusal_check(check: MoveCheck, step: usize, why: &Rejection) -> MoveCheck {
    let (moves, reason, joint, t_s, ratio) = match why {
        Rejection::Planning(law::Infeasible::Unreachable { index }) => (index + 1, 2, 0, 0.0, 0.0),
        Rejection::Planning(law::Infeasible::Limits)
        | Rejection::Inspection(Infeasible::StartMismatch { .. } | Infeasible::InvalidTick) => {
            (step + 1, 6, 0, 0.0, 0.0)
        }
        Rejection::Inspection(Infeasible::NotFollowed { error: why, t_s }) => match why {
            FollowError::JointLimit { joint } => (step + 1, 1, joint + 1, *t_s, 0.0),
            FollowError::SpeedLimit { joint, ratio } => (step + 1, 3, joint + 1, *t_s, *ratio),
            FollowError::NotSettled { joint } => (step + 1, 7, joint + 1, *t_s, 0.0),
            _ => (step + 1, 2, 0, *t_s, 0.0),
        },
        Rejection::Inspection(Infeasible::Torque { joint, ratio, t_s }) => {
            (step + 1, 4, joint + 1, *t_s, *ratio)
        }
        Rejection::Inspection(Infeasible::PathDeviation { t_s, .. }) => (step + 1, 5, 0, *t_s, 0.0),
        Rejection::Inspection(_) => (step + 1, 6, 0, 0.0, 0.0),
    };
    #[expect(clippy::cast_possible_truncation, reason = "moves and joints are few")]
    let (moves, joint) = (moves as u32, joint as u32);
    MoveCheck { verdict: 3, moves, reason, joint, t_s, ratio, ..check }
}
