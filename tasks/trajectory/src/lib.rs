//! Carries out the queue of pre-programmed moves at 400 Hz: Paul's joint motion, and his straight
//! motion of the tool. Refuses to start from joints that are not calibrated, and a queue that the
//! arm could not follow: the whole of it is looked at first, and `check` says which move, joint and
//! time.
//!
//! When the state becomes TRAJECTORY the path is laid from the joints desired at that moment and
//! looked at, for as many jobs as that takes, and then only followed; when the state is left early
//! the goal becomes invalid, and the next entry starts anew. A queue that cannot be run ends at
//! once: the goal is invalid and done.
//!
//! A program can be brought to rest on its path, and go on, by the words that do so for typed
//! moves. In TRAJECTORY/USER those come one by one, as they are typed ([`online`]).

pub mod clock;
pub mod config;
pub mod law;
pub mod online;
pub mod program;
pub mod typed;

pub use config::{BlendName, Config, Move, ToolGoal};

use online::Online;
use program::{Outcome, Plan, Program};
use taktil_mechanics::arm::Arm;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Output, Payload, Ports, StateHash, Task,
};
use taktil_signal::{
    ControlState, Desired, Goal, JointState, MoveCheck, MoveKind, State, Typed, TypedMove,
};

/// Where the task is with its queue.
#[derive(Clone, Copy, Debug)]
enum Progress {
    /// Another state has the arm.
    Idle,
    /// The program is under way, from joints of this datum; the word that was looked at last.
    Under { datum: u32, heard: u32 },
    /// Moves are taken as they are typed, from joints of this datum.
    Online { datum: u32 },
    /// The queue was refused in this stay.
    Refused,
}

/// The task.
pub struct Trajectory<const N: usize = 6, A: Arm<N> = Puma260> {
    control: Input<ControlState>,
    desired: Input<Desired<N>>,
    joints: Input<JointState<N>>,
    moves: Input<TypedMove>,
    goal: Output<Goal<N>>,
    check: Output<MoveCheck>,
    typed: Output<Typed>,
    plan: Plan<N, A>,
    program: Program<N, A>,
    online: Online<N, A>,
    progress: Progress,
    /// When the present stay in TRAJECTORY began.
    entered_ns: i64,
}

/// Nothing is wanted, and nothing is left to do.
fn over<const N: usize>() -> Goal<N> {
    Goal { done: 1, ..Goal::ZERO }
}

impl<const N: usize, A: Arm<N>> Trajectory<N, A> {
    /// Declares `control`, `desired`, `joints`, `moves`, `goal`, `check` and `typed`.
    ///
    /// # Errors
    /// What [`Config::steps`] refuses.
    pub fn new(
        config: Config,
        robot: &Robot<N, A>,
        ports: &mut Ports,
    ) -> Result<Trajectory<N, A>, Invalid> {
        let steps = config.steps(robot)?;
        let plan = Plan::new(&config, robot, steps);
        let roomless =
            |_| Invalid::new("tau_s", format!("{} s allows no path", config.tau_s), "give more");
        let program = Program::room(&plan).map_err(roomless)?;
        let online = Online::room(&plan).map_err(roomless)?;
        Ok(Trajectory {
            plan,
            program,
            online,
            control: ports.input("control"),
            desired: ports.input_delayed("desired"),
            joints: ports.input("joints"),
            moves: ports.input("moves"),
            goal: ports.output("goal"),
            check: ports.output("check"),
            typed: ports.output("typed"),
            progress: Progress::Idle,
            entered_ns: 0,
        })
    }

    /// Begins with the queue of a stay that begins in this job, or with moves to be typed; `word`
    /// is what was typed last before.
    fn enter(
        &mut self,
        tick_s: f64,
        desired: Option<Desired<N>>,
        joints: Option<JointState<N>>,
        (typing, word): (bool, Option<TypedMove>),
    ) -> Result<(), (FaultCode, Option<MoveCheck>)> {
        self.progress = Progress::Refused;
        let start = desired.filter(|desired| desired.valid == 1);
        let (Some(start), Some(joints)) = (start, joints.filter(|j| j.calibrated == 1)) else {
            return Err((FaultCode::MoveRefused, None));
        };
        let start = JointVector::from(start.q_rad);
        if typing {
            self.online.begin(&mut self.plan, &start, tick_s, word);
            self.progress = Progress::Online { datum: joints.datum };
            return Ok(());
        }
        self.program
            .begin(&mut self.plan, &start, tick_s)
            .map_err(|check| (fault_of(&check), Some(check)))?;
        let heard = word.map_or(0, |word| word.sequence);
        self.progress = Progress::Under { datum: joints.datum, heard };
        Ok(())
    }

    /// The goal of this job, and what the check says if it has something to say.
    fn proceed(
        &mut self,
        tick: u64,
        word: Option<TypedMove>,
    ) -> (Goal<N>, Option<MoveCheck>, Result<(), FaultCode>) {
        match self.progress {
            Progress::Idle => return (Goal::ZERO, None, Ok(())),
            Progress::Refused => return (over(), None, Ok(())),
            Progress::Online { .. } => return self.go_on(word),
            Progress::Under { .. } => self.hear(word),
        }
        let looking = self.program.check().verdict == 1;
        let outcome = self.program.step(&self.plan, tick);
        let check = *self.program.check();
        match outcome {
            Outcome::At(at, done) => {
                let (q_rad, qd_rad_s) = (at.q.into(), at.qd.into());
                let goal = Goal { q_rad, qd_rad_s, valid: 1, done: u32::from(done) };
                (goal, looking.then_some(check), Ok(()))
            }
            Outcome::Refused => {
                self.progress = Progress::Refused;
                (over(), Some(check), Err(fault_of(&check)))
            }
        }
    }

    /// Pauses the program, or lets it go on, when a word says so.
    fn hear(&mut self, word: Option<TypedMove>) {
        let Progress::Under { heard, .. } = &mut self.progress else { return };
        let Some(word) = word.filter(|word| word.sequence != *heard) else { return };
        *heard = word.sequence;
        let paused = match MoveKind::from_code(word.kind) {
            Some(MoveKind::Pause) => true,
            Some(MoveKind::Resume) => false,
            _ => return,
        };
        self.program.pause(paused);
        self.online.note(word.sequence, paused);
    }

    /// The same with moves that are typed. A move that is refused is no fault: the arm goes on with
    /// those before it.
    fn go_on(
        &mut self,
        word: Option<TypedMove>,
    ) -> (Goal<N>, Option<MoveCheck>, Result<(), FaultCode>) {
        let at = self.online.step(&self.plan, word);
        let said = self.online.said();
        let Some(at) = at else {
            self.progress = Progress::Refused;
            return (over(), said, Err(FaultCode::Unreachable));
        };
        let goal = Goal { q_rad: at.q.into(), qd_rad_s: at.qd.into(), valid: 1, done: 0 };
        (goal, said, Ok(()))
    }
}

fn fault_of(check: &MoveCheck) -> FaultCode {
    if check.reason == 2 { FaultCode::Unreachable } else { FaultCode::MoveRefused }
}

impl<const N: usize, A: Arm<N>> Task for Trajectory<N, A> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable();
        let joints = io.read(&self.joints).usable();
        let word = io.read(&self.moves).usable();
        let mut outcome = Ok(());
        let mut check = None;
        let state = control.and_then(|control| State::from_code(control.state));
        let typing = state == Some(State::TrajectoryUser);
        match control.filter(|_| typing || state == Some(State::Trajectory)) {
            None => {
                if matches!(self.progress, Progress::Under { .. }) {
                    self.online.note(self.online.typed().taken, false);
                }
                self.progress = Progress::Idle;
            }
            Some(control) => {
                let stays = !matches!(self.progress, Progress::Idle)
                    && control.entered_ns == self.entered_ns;
                let datum = match self.progress {
                    Progress::Under { datum, .. } | Progress::Online { datum } => Some(datum),
                    Progress::Idle | Progress::Refused => None,
                };
                let moved = datum.is_some() && datum != joints.map(|joints| joints.datum);
                if !stays {
                    self.entered_ns = control.entered_ns;
                    let tick_s = cycle.dt.as_secs_f64();
                    let entered = self.enter(tick_s, desired, joints, (typing, word));
                    outcome = entered.map_err(|(fault, said)| {
                        check = said;
                        fault
                    });
                } else if moved {
                    // The zero of the joints moved under the path.
                    self.progress = Progress::Refused;
                    outcome = Err(FaultCode::MoveRefused);
                }
            }
        }
        let (goal, said, proceeded) = self.proceed(cycle.tick, word);
        io.write(&self.goal, goal);
        io.write(&self.typed, *self.online.typed());
        if let Some(check) = said.or(check) {
            io.write(&self.check, check);
        }
        outcome.and(proceeded)
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.entered_ns);
        match &self.progress {
            Progress::Idle => {
                hash.word(0);
            }
            Progress::Under { datum, heard } => {
                hash.word(1).add(datum).add(heard);
                self.program.fold(hash);
            }
            Progress::Online { datum } => {
                hash.word(3).add(datum);
                self.online.fold(hash);
            }
            Progress::Refused => {
                hash.word(2);
            }
        }
    }

    fn stop(&mut self) {
        self.progress = Progress::Idle;
    }
}
