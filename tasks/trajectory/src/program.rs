//! A queue on its way: first every leg is looked at, a few ticks in each job, then the legs are
//! run one after another. Refuses to move before the last leg was looked at, and to go on where the
//! arm cannot follow.

use core::ops::ControlFlow;
use taktil_mechanics::Joints;

use taktil_mechanics::dynamics::Dynamics;
use taktil_mechanics::paul::Setpoint;
use taktil_mechanics::preview::{Inspection, Preview, Refusal, Route, Terms, Verdict};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::follow::{Follower, Lost};
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_rtcore::{Payload, StateHash};
use taktil_signal::MoveCheck;

use crate::config::{Config, MAX_MOVES, Step};
use crate::law::{self, Pace, leg};

/// Ticks looked at in one job: four times as fast as they will be run, and one look at the torque.
const LOOKED_A_JOB: u32 = 4;

/// Everything about a queue that does not change.
pub struct Plan {
    arm: Puma260,
    steps: Vec<Step>,
    pace: Pace,
    terms: Terms,
}

impl Plan {
    /// The plan of a checked queue, looked at every `tick_s` (s).
    #[must_use]
    pub fn new(config: &Config, arm: &Puma260, steps: Vec<Step>) -> Plan {
        let torque_max_nm = Drive::reference().peak_joint_torque(&Transmission::reference());
        let terms = Terms {
            arm: *arm,
            dynamics: Dynamics::reference(),
            torque_max_nm,
            off_max_m: config.off_path_mm * 1e-3,
            off_max_rad: config.off_path_deg.to_radians(),
            // The lane's period; known with the first job.
            tick_s: 0.0,
        };
        Plan { arm: *arm, steps, pace: Pace::of(config), terms }
    }
}

/// Where a leg begins.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Begin {
    /// Number of its first step.
    step: usize,
    /// Joints (rad).
    q: Joints,
}

#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one, and the lane has no heap")]
enum Stage {
    /// The leg at hand is being looked at.
    Looking(Inspection),
    /// The leg at hand is being run, since this job; joints at the last one (rad).
    Running { route: Route, follower: Follower, since: u64, last: u64 },
}

/// A queue on its way.
#[derive(Clone, Copy, Debug)]
pub struct Program {
    begins: [Begin; MAX_MOVES + 1],
    /// Legs looked at so far.
    legs: usize,
    /// The leg at hand.
    leg: usize,
    /// The step after the leg at hand.
    next_step: usize,
    stage: Stage,
    /// Where the arm is wanted now (rad).
    q: Joints,
    check: MoveCheck,
}

/// What a job of a program comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The setpoint, and whether all is done.
    At(Setpoint, bool),
    /// The queue is refused, or the arm cannot follow; the check says why.
    Refused,
}

impl Program {
    /// Begins at joints `start` (rad), where the arm is wanted; `tick_s` is the lane's period (s).
    ///
    /// # Errors
    /// The check, with its reason.
    pub fn new(plan: &mut Plan, start: &Joints, tick_s: f64) -> Result<Program, MoveCheck> {
        plan.terms.tick_s = tick_s;
        let check = MoveCheck { verdict: 1, singular: [1.0; 3], ..MoveCheck::ZERO };
        let (inspection, next_step) =
            look(plan, start, 0).map_err(|why| refused(check, 0, &why))?;
        let begin = Begin { step: 0, q: *start };
        Ok(Program {
            begins: [begin; MAX_MOVES + 1],
            legs: 0,
            leg: 0,
            next_step,
            stage: Stage::Looking(inspection),
            q: *start,
            check,
        })
    }

    /// How the check stands.
    #[must_use]
    pub fn check(&self) -> &MoveCheck {
        &self.check
    }

    /// Folds what the next job depends on.
    pub fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.legs).add(&self.leg).add(&self.next_step).add(self.q.as_slice());
        hash.add(&self.check);
        match &self.stage {
            Stage::Looking(inspection) => hash.word(0).add(inspection.joints().as_slice()),
            Stage::Running { follower, since, last, .. } => {
                hash.word(1).add(follower.joints().as_slice()).add(since).add(last)
            }
        };
    }

    /// One job, number `tick`.
    pub fn step(&mut self, plan: &Plan, tick: u64) -> Outcome {
        if let Stage::Looking(inspection) = &mut self.stage {
            match inspection.advance(LOOKED_A_JOB, &plan.terms) {
                Verdict::Open => return Outcome::At(Setpoint::rest(&self.q), false),
                Verdict::Refused(why) => return self.refuse(plan, &Why::Cannot(why)),
                Verdict::Passed(preview) => {
                    if let ControlFlow::Break(outcome) = self.passed(plan, &preview, tick) {
                        return outcome;
                    }
                }
            }
        }
        self.run(plan, tick)
    }

    /// A leg was found good: looks at the next, or starts the first.
    fn passed(&mut self, plan: &Plan, preview: &Preview, tick: u64) -> ControlFlow<Outcome> {
        note(&mut self.check, preview);
        self.check.moves = self.next_step as u32;
        self.legs += 1;
        if self.next_step < plan.steps.len() {
            let begin = Begin { step: self.next_step, q: preview.end };
            self.begins[self.legs] = begin;
            match look(plan, &begin.q, begin.step) {
                Ok((inspection, next_step)) => {
                    (self.stage, self.next_step) = (Stage::Looking(inspection), next_step);
                    return ControlFlow::Break(Outcome::At(Setpoint::rest(&self.q), false));
                }
                Err(why) => return ControlFlow::Break(self.refuse_at(begin.step, &why)),
            }
        }
        self.check.verdict = 2;
        self.enter(plan, 0, tick)
    }

    /// Starts a leg in this job.
    fn enter(&mut self, plan: &Plan, number: usize, tick: u64) -> ControlFlow<Outcome> {
        let begin = self.begins[number];
        match leg(&plan.arm, &begin.q, &plan.steps, begin.step, &plan.pace) {
            Ok((route, count)) => {
                let follower = Follower::new(&plan.arm, &begin.q);
                (self.leg, self.next_step) = (number, begin.step + count);
                self.q = begin.q;
                self.stage = Stage::Running { route, follower, since: tick, last: tick };
                ControlFlow::Continue(())
            }
            Err(why) => ControlFlow::Break(self.refuse_at(begin.step, &Why::Planned(why))),
        }
    }

    fn run(&mut self, plan: &Plan, tick: u64) -> Outcome {
        let over = match &self.stage {
            Stage::Running { route, since, .. } => {
                seconds(tick - since, plan.terms.tick_s) >= route.duration_s()
            }
            Stage::Looking(_) => false,
        };
        if over
            && self.leg + 1 < self.legs
            && let ControlFlow::Break(outcome) = self.enter(plan, self.leg + 1, tick)
        {
            return outcome;
        }
        let Stage::Running { route, follower, since, last } = &mut self.stage else {
            return Outcome::At(Setpoint::rest(&self.q), false);
        };
        let t_s = seconds(tick - *since, plan.terms.tick_s);
        let done = self.leg + 1 == self.legs && t_s >= route.duration_s();
        let setpoint = match route {
            Route::Joints(path) => Ok(path.at(t_s)),
            Route::Tool(_) if tick == *last => Ok(Setpoint::rest(&self.q)),
            Route::Tool(path) => {
                let dt_s = seconds(tick - *last, plan.terms.tick_s);
                let got = follower.step(&path.at(t_s).pose, dt_s);
                got.map(|got| Setpoint {
                    q: got.q,
                    qd: (got.q - self.q) / dt_s,
                    qdd: Joints::zeros(),
                })
            }
        };
        *last = tick;
        match setpoint {
            Ok(setpoint) => {
                self.q = setpoint.q;
                Outcome::At(setpoint, done)
            }
            Err(why) => self.refuse(plan, &Why::Cannot(Refusal::Lost { why, t_s })),
        }
    }

    fn refuse(&mut self, plan: &Plan, why: &Why) -> Outcome {
        // The move at hand is known to its leg only; a leg of one move is named exactly.
        let number = if matches!(self.stage, Stage::Looking(_)) { self.legs } else { self.leg };
        self.refuse_at(self.begins[number].step.min(plan.steps.len()), why)
    }

    fn refuse_at(&mut self, step: usize, why: &Why) -> Outcome {
        self.check = refused(self.check, step, why);
        Outcome::Refused
    }
}

/// Why a queue is refused.
enum Why {
    Planned(law::Refusal),
    Cannot(Refusal),
}

/// Plans the leg that begins with `step` and starts to look at it; also the step after it.
fn look(plan: &Plan, start: &Joints, step: usize) -> Result<(Inspection, usize), Why> {
    let (route, count) =
        leg(&plan.arm, start, &plan.steps, step, &plan.pace).map_err(Why::Planned)?;
    let inspection = Inspection::new(&route, start, &plan.terms).map_err(Why::Cannot)?;
    Ok((inspection, step + count))
}

#[expect(clippy::cast_precision_loss, reason = "jobs of a run stay far below 2^53")]
fn seconds(ticks: u64, tick_s: f64) -> f64 {
    ticks as f64 * tick_s
}

fn note(check: &mut MoveCheck, preview: &Preview) {
    let most = |peaks: &[taktil_mechanics::preview::Peak; 6]| {
        peaks.iter().fold(0.0, |most: f64, peak| most.max(peak.value))
    };
    check.duration_s += preview.duration_s;
    check.speed_share = check.speed_share.max(most(&preview.speed));
    check.torque_share = check.torque_share.max(most(&preview.torque));
    check.off_path_m = check.off_path_m.max(preview.off_m.value);
    check.off_path_rad = check.off_path_rad.max(preview.off_rad.value);
    for (least, peak) in check.singular.iter_mut().zip(&preview.singular) {
        *least = least.min(peak.value);
    }
}

fn refused(check: MoveCheck, step: usize, why: &Why) -> MoveCheck {
    let (moves, reason, joint, t_s, ratio) = match why {
        Why::Planned(law::Refusal::Unreachable { index }) => (index + 1, 2, 0, 0.0, 0.0),
        Why::Planned(law::Refusal::Limits) | Why::Cannot(Refusal::Start { .. } | Refusal::Tick) => {
            (step + 1, 6, 0, 0.0, 0.0)
        }
        Why::Cannot(Refusal::Lost { why, t_s }) => match why {
            Lost::Limit { joint } => (step + 1, 1, joint + 1, *t_s, 0.0),
            Lost::TooFast { joint, ratio } => (step + 1, 3, joint + 1, *t_s, *ratio),
            _ => (step + 1, 2, 0, *t_s, 0.0),
        },
        Why::Cannot(Refusal::Torque { joint, ratio, t_s }) => {
            (step + 1, 4, joint + 1, *t_s, *ratio)
        }
        Why::Cannot(Refusal::Off { t_s, .. }) => (step + 1, 5, 0, *t_s, 0.0),
        Why::Cannot(_) => (step + 1, 6, 0, 0.0, 0.0),
    };
    #[expect(clippy::cast_possible_truncation, reason = "moves and joints are few")]
    let (moves, joint) = (moves as u32, joint as u32);
    MoveCheck { verdict: 3, moves, reason, joint, t_s, ratio, ..check }
}
