//! MoveQueue moves while the arm is on its way. Each move is planned from the end of the moves
//! before
//! it and checked tick by tick before it counts. A move of the same kind as the one under way is
//! joined to it by Paul's transition, without a stop, if the check passes in time; else it starts
//! at rest. The arm can be brought to rest on its path and continue from there. A move that the arm
//! cannot make is refused together with everything typed after it; moves that passed their check
//! are carried out.

use taktil_mechanics::arm::Arm;
use taktil_mechanics::feasibility::{
    FeasibilityCheck, FeasibilityCriteria, FeasibilityReport, FeasibilityStatus, Infeasible,
};
use taktil_mechanics::paul::Setpoint;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::tracking::{PathRef, PathTracker, SETTLING_TIME_MAX_S, TrackerStep};
use taktil_rtcore::{Payload, StateHash};
use taktil_signal::{MoveCheck, MoveKind, MoveQueue, OperatorMove};

use crate::clock::Clock;
use crate::config::{MOVES_MAX, Step};
use crate::law::{self, Leg};
use crate::program::{
    PAUSE_TRANSITION_FACTOR, Plan, Rejection, TICKS_CHECKED_PER_JOB, record_peaks, refusal_check,
};
use crate::typed::decode;

/// Most moves in the queue.
pub const TYPED_MOVES_MAX: usize = 16;
/// Largest distance of the arm from the start of a checked move (rad). Beyond it the move is
/// checked again.
const START_TOLERANCE_RAD: f64 = 1e-9;
/// A move that waits for its verdict.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PendingMove<const N: usize> {
    step: Step<N>,
    sequence: u32,
}

/// How the move at the front of the queue would join what is before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Join {
    /// By a transition at the end of the leg that is run.
    Through,
    /// At rest, from the end of that leg, or from where the arm is.
    AtRest,
}

/// The use of the leg that is not being executed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum NextLeg<const N: usize> {
    /// Nothing.
    Free,
    /// It is checked.
    Checking(Join),
    /// It passed its check and waits for the end of the leg being executed; joints there (rad).
    Passed { start: JointVector<N>, end: JointVector<N>, stop_tau_s: f64 },
}

/// The leg being executed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RunningLeg<const N: usize, A: Arm<N>> {
    clock: Clock,
    lead: PathTracker<N, A>,
    /// Joints at its end (rad).
    end: JointVector<N>,
    /// Half the time of a pause (s).
    stop_tau_s: f64,
}

/// The queue of moves and the two legs: one is executed while the other one is planned. It is
/// allocated once.
#[derive(Debug)]
pub struct Online<const N: usize = 6, A: Arm<N> = Puma260> {
    queue: [PendingMove<N>; TYPED_MOVES_MAX],
    waiting: usize,
    legs_in_use: [Leg<N>; 2],
    /// Index of the leg that is executed; the other one is planned ahead.
    at: usize,
    run: Option<RunningLeg<N, A>>,
    next_leg: NextLeg<N>,
    inspection: FeasibilityCheck<N, A>,
    /// Whether the rest of the path is discarded once the arm stands.
    is_discarding: bool,
    setpoint: Setpoint<N>,
    typed: MoveQueue,
    check: MoveCheck,
    /// Whether the verdict has changed since it was last read.
    has_new_check: bool,
}

impl<const N: usize, A: Arm<N>> Online<N, A> {
    /// Room for moves, before the first is typed.
    ///
    /// # Errors
    /// Timing with which no path can be planned.
    pub fn empty(plan: &Plan<N, A>) -> Result<Online<N, A>, law::Infeasible> {
        let rest = JointVector::zeros();
        let empty_leg = || Leg::empty(&plan.arm, &plan.pace);
        let legs_in_use = [empty_leg()?, empty_leg()?];
        let terms = FeasibilityCriteria { tick_s: 1.0, ..plan.terms.clone() };
        let inspection = FeasibilityCheck::new(legs_in_use[0].route(), &rest, &terms);
        let step = Step { goal: crate::config::Goal::Joints(rest), straight: false, t_s: None };
        Ok(Online {
            queue: [PendingMove { step, sequence: 0 }; TYPED_MOVES_MAX],
            waiting: 0,
            legs_in_use,
            at: 0,
            run: None,
            next_leg: NextLeg::Free,
            inspection: inspection.map_err(|_| law::Infeasible::Limits)?,
            is_discarding: false,
            setpoint: Setpoint::rest(&rest),
            typed: MoveQueue::ZERO,
            check: MoveCheck::ZERO,
            has_new_check: false,
        })
    }

    /// Starts at joints `start` (rad); `last` is the newest command from before, which is ignored.
    pub fn begin(
        &mut self,
        plan: &mut Plan<N, A>,
        start: &JointVector<N>,
        tick_s: f64,
        last: Option<OperatorMove>,
    ) {
        plan.terms.tick_s = tick_s;
        let taken = last.map_or(0, |word| word.sequence);
        self.drop_pending();
        self.run = None;
        self.is_discarding = false;
        self.setpoint = Setpoint::rest(start);
        self.typed = MoveQueue { received: taken, checked: taken, ..MoveQueue::ZERO };
        self.has_new_check = false;
    }

    /// Records, while a program is executed instead, that a message was handled and whether the
    /// program is paused.
    pub fn record_command(&mut self, sequence: u32, paused: bool) {
        self.typed.received = sequence;
        self.typed.paused = u32::from(paused);
    }

    /// State of the moves.
    #[must_use]
    pub fn typed(&self) -> &MoveQueue {
        &self.typed
    }

    /// The newest verdict, once.
    pub fn take_check(&mut self) -> Option<MoveCheck> {
        core::mem::take(&mut self.has_new_check).then_some(self.check)
    }

    /// One job: the setpoint; `None` when the arm cannot follow a path that passed its check.
    pub fn step(&mut self, plan: &Plan<N, A>, word: Option<OperatorMove>) -> Option<Setpoint<N>> {
        if let Some(word) = word.filter(|word| word.sequence != self.typed.received) {
            self.take(&word);
        }
        if !self.is_discarding {
            self.inspect(plan);
        }
        let setpoint = self.proceed(plan);
        let left = self.run.map_or(0, |run| self.legs_in_use[self.at].moves_left(run.clock.t_s()));
        let good = usize::from(matches!(self.next_leg, NextLeg::Passed { .. }));
        #[expect(clippy::cast_possible_truncation, reason = "at most a few dozen")]
        let queued = (self.waiting + good + left) as u32;
        self.typed.queued = queued;
        self.typed.moving = u32::from(self.run.is_some_and(|run| !run.clock.is_at_rest()));
        setpoint
    }

    /// Handles one command.
    fn take(&mut self, word: &OperatorMove) {
        self.typed.received = word.sequence;
        if let Some(step) = decode(word) {
            if word.now == 1 {
                self.drop_path();
            }
            if self.waiting == TYPED_MOVES_MAX {
                self.refuse(word.sequence, &Rejection::Planning(law::Infeasible::Limits));
                return;
            }
            self.queue[self.waiting] = PendingMove { step, sequence: word.sequence };
            self.waiting += 1;
            return;
        }
        match MoveKind::from_code(word.kind) {
            Some(MoveKind::Pause) => self.pause(true),
            Some(MoveKind::Resume) => self.pause(false),
            Some(MoveKind::Clear) => self.drop_path(),
            _ => {}
        }
    }

    fn pause(&mut self, paused: bool) {
        self.typed.paused = u32::from(paused);
        if let Some(run) = self.run.as_mut().filter(|_| !self.is_discarding) {
            run.clock.set_running(!paused);
        }
    }

    /// Brings the arm to rest on the path and discards the rest of the path.
    fn drop_path(&mut self) {
        self.drop_pending();
        self.pause(false);
        if let Some(run) = &mut self.run {
            run.clock.set_running(false);
            self.is_discarding = true;
        }
    }

    /// Discards the moves that are not being executed yet.
    fn drop_pending(&mut self) {
        self.waiting = 0;
        self.next_leg = NextLeg::Free;
        self.typed.checked = self.typed.received;
    }

    fn refuse(&mut self, sequence: u32, why: &Rejection) {
        let check = MoveCheck { singular: [1.0; 3], ..MoveCheck::ZERO };
        self.check = refusal_check(check, 0, why);
        self.has_new_check = true;
        self.drop_pending();
        self.typed.refused = sequence;
    }

    /// Checks some ticks of the move at the front of the queue.
    fn inspect(&mut self, plan: &Plan<N, A>) {
        match self.next_leg {
            NextLeg::Passed { .. } => {}
            NextLeg::Free if self.waiting == 0 => {}
            NextLeg::Free => {
                let PendingMove { step, sequence } = self.queue[0];
                match self.append_move(plan, &step) {
                    Ok(join) => self.next_leg = NextLeg::Checking(join),
                    Err(why) => self.refuse(sequence, &why),
                }
            }
            NextLeg::Checking(join) => {
                let route = self.legs_in_use[1 - self.at].route();
                match self.inspection.advance(TICKS_CHECKED_PER_JOB, route, &plan.terms) {
                    FeasibilityStatus::InProgress => {}
                    FeasibilityStatus::Infeasible(why) => {
                        let sequence = self.queue[0].sequence;
                        self.refuse(sequence, &Rejection::Inspection(why));
                    }
                    FeasibilityStatus::Feasible => self.accept(plan, join),
                }
            }
        }
    }

    /// Plans a step in the free leg and begins to check it.
    fn append_move(&mut self, plan: &Plan<N, A>, step: &Step<N>) -> Result<Join, Rejection> {
        let Plan { arm, pace, terms, .. } = plan;
        let (running, free) = running_and_free(&mut self.legs_in_use, self.at);
        if let Some(run) = &self.run
            && running.continues_with(step)
            && let Some(from_s) = continuation_start_s(running.route(), run, pace.tau_s)
        {
            free.copy(running);
            match free.extend(arm, step, pace) {
                Ok(()) => {
                    let lead = match running.route() {
                        PathRef::Joint(path) => {
                            let at = path.at(from_s);
                            PathTracker::with_velocity(arm, &at.q, &at.qd, from_s)
                        }
                        PathRef::Cartesian(_) => run.lead,
                    };
                    let looking = FeasibilityCheck::remaining(free.route(), &lead, from_s, terms);
                    self.inspection = looking.map_err(Rejection::Inspection)?;
                    return Ok(Join::Through);
                }
                // A full path, or a corner too sharp to be taken without a stop.
                Err(law::Infeasible::Limits) => {}
                Err(why) => return Err(Rejection::Planning(why)),
            }
        }
        let start = self.run.map_or(self.setpoint.q, |run| run.end);
        free.begin(arm, &start, core::slice::from_ref(step), 0, pace)
            .map_err(Rejection::Planning)?;
        free.append_move(arm, core::slice::from_ref(step), pace).map_err(Rejection::Planning)?;
        self.inspection =
            FeasibilityCheck::new(free.route(), &start, terms).map_err(Rejection::Inspection)?;
        Ok(Join::AtRest)
    }

    /// Joins the move at the front, which passed its check, if there is still time.
    fn accept(&mut self, plan: &Plan<N, A>, join: Join) {
        let preview = *self.inspection.report();
        let stop_tau_s = stop_tau_s(plan, &preview);
        let begun = self.run.map_or(0.0, |run| run.clock.t_s());
        match (join, &mut self.run) {
            (Join::Through, Some(run)) => {
                let route = self.legs_in_use[self.at].route();
                if continuation_start_s(route, run, plan.pace.tau_s).is_none() {
                    // There is no time left for a transition, so the move starts from rest.
                    self.next_leg = NextLeg::Free;
                    return;
                }
                run.end = preview.end_q;
                run.stop_tau_s = run.stop_tau_s.max(stop_tau_s);
                self.at = 1 - self.at;
                self.next_leg = NextLeg::Free;
            }
            (Join::Through, None) => {
                self.next_leg = NextLeg::Free;
                return;
            }
            (Join::AtRest, _) => {
                let start = self.run.map_or(self.setpoint.q, |run| run.end);
                self.next_leg = NextLeg::Passed { start, end: preview.end_q, stop_tau_s };
            }
        }
        self.check = MoveCheck { verdict: 2, moves: 1, singular: [1.0; 3], ..MoveCheck::ZERO };
        record_peaks(&mut self.check, &preview);
        if join == Join::Through {
            self.check.duration_s -= begun;
        }
        self.has_new_check = true;
        self.typed.checked = self.queue[0].sequence;
        self.queue.copy_within(1.., 0);
        self.waiting -= 1;
    }

    /// Advances along the path by one tick.
    fn proceed(&mut self, plan: &Plan<N, A>) -> Option<Setpoint<N>> {
        let (dt_s, tau_s) = (plan.terms.tick_s, plan.pace.tau_s);
        let Some(run) = &mut self.run else {
            self.setpoint = Setpoint::rest(&self.setpoint.q);
            self.start(plan);
            return Some(self.setpoint);
        };
        run.clock.advance(dt_s, run.stop_tau_s.max(tau_s));
        let (t_s, stands) = (run.clock.t_s(), run.clock.is_at_rest());
        let route = self.legs_in_use[self.at].route();
        let TrackerStep { setpoint: at, is_finished: over, can_stop: still, .. } =
            match run.lead.step(&plan.arm, route, t_s, dt_s) {
                Ok(led) => led,
                Err(why) => {
                    self.run = None;
                    let lost = Rejection::Inspection(Infeasible::NotFollowed { error: why, t_s });
                    self.refuse(self.typed.received, &lost);
                    return None;
                }
            };
        self.setpoint = match route {
            PathRef::Joint(_) if stands => Setpoint::rest(&at.q),
            PathRef::Joint(_) => run.clock.with_speed_of(&at),
            PathRef::Cartesian(_) => at,
        };
        // Past a singularity the joints may have to come to rest after the path's time has.
        let given_up = stands && (still || run.lead.settling_s() > SETTLING_TIME_MAX_S);
        if over || (self.is_discarding && given_up) {
            self.run = None;
            self.is_discarding = false;
        }
        Some(self.setpoint)
    }

    /// Starts the leg that passed its check, if there is one; it moves from the next job on.
    fn start(&mut self, plan: &Plan<N, A>) {
        let NextLeg::Passed { start, end, stop_tau_s } = self.next_leg else { return };
        self.next_leg = NextLeg::Free;
        if (start - self.setpoint.q).amax() > START_TOLERANCE_RAD {
            // The arm came to rest elsewhere: a pause, or a singularity, on the way.
            self.run = None;
            self.refuse(
                self.typed.checked,
                &Rejection::Inspection(Infeasible::StartMismatch { distance: 0.0 }),
            );
            return;
        }
        self.at = 1 - self.at;
        self.run = Some(RunningLeg {
            clock: Clock::new(self.typed.paused == 0),
            lead: PathTracker::new(&plan.arm, &self.setpoint.q),
            end,
            stop_tau_s,
        });
    }

    /// Adds the state on which the next job depends to the digest.
    pub fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.waiting).add(&self.at).add(&self.is_discarding).add(&self.typed);
        hash.add(self.setpoint.q.as_slice()).add(self.setpoint.qd.as_slice());
        for leg in &self.legs_in_use {
            leg.fold(hash);
        }
        for waiting in &self.queue[..self.waiting] {
            hash.add(&waiting.sequence);
        }
        hash.add(&self.run.is_some());
        if let Some(run) = &self.run {
            hash.add(&run.clock).add(run.lead.joints().as_slice()).add(run.end.as_slice());
            if run.lead.settling_s() > 0.0 {
                hash.add(&run.lead.settling_s());
            }
        }
        match &self.next_leg {
            NextLeg::Free => hash.word(0),
            NextLeg::Checking(join) => {
                hash.word(1 + u64::from(*join == Join::AtRest));
                hash.add(self.inspection.report().end_q.as_slice())
            }
            NextLeg::Passed { end, .. } => hash.word(3).add(end.as_slice()),
        };
    }
}

/// The leg that is executed, and the other one.
fn running_and_free<const N: usize>(
    legs_in_use: &mut [Leg<N>; 2],
    at: usize,
) -> (&Leg<N>, &mut Leg<N>) {
    let [first, second] = legs_in_use;
    if at == 0 { (first, second) } else { (second, first) }
}

/// The path's time from which a continuation has to be checked: where the transition to rest
/// begins, for joints; from here on, for the tool, whose joints depend on the way. `None` when
/// there is no time left for one, or the tool's path is not run at its own pace.
fn continuation_start_s<const N: usize, A: Arm<N>>(
    route: PathRef<'_, N>,
    run: &RunningLeg<N, A>,
    tau_s: f64,
) -> Option<f64> {
    let corner_s = route.duration_s() - 2.0 * tau_s;
    let t_s = run.clock.t_s();
    match route {
        _ if t_s >= corner_s => None,
        PathRef::Joint(_) => Some(corner_s),
        PathRef::Cartesian(_) => run.clock.is_running().then_some(t_s),
    }
}

/// Half the time of a pause that every joint can bear at the largest speed of a leg.
fn stop_tau_s<const N: usize, A: Arm<N>>(plan: &Plan<N, A>, preview: &FeasibilityReport<N>) -> f64 {
    let Plan { arm, .. } = plan;
    let shortest = (0..N).map(|joint| {
        let speed = preview.speed_ratio[joint].value * arm.speed_max()[joint];
        PAUSE_TRANSITION_FACTOR * speed / arm.acceleration_max()[joint]
    });
    shortest.fold(0.0, f64::max)
}

const _: () = assert!(TYPED_MOVES_MAX < MOVES_MAX);
