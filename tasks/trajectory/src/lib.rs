//! The task that carries out moves: a queue that the configuration gives, or moves that the
//! operator types one by one. Moves follow Paul's joint motion or his straight motion of the tool.
//!
//! - In: `control`, `desired`, `joints`, `moves`.
//! - Out: `goal`, `check`, `queue`.
//! - Rate: every job of the servo lane, 400 Hz.
//! - Source: R. P. Paul, *Robot Manipulators*, MIT Press, 1981, for the paths and their
//!   transitions.
//!
//! When the state becomes TRAJECTORY, the task plans the path from the joints that are desired at
//! that moment and checks it, over as many jobs as that takes; only then does the arm move. `check`
//! says which move, joint and time a refusal is about. The task does not start from joints that are
//! not calibrated. When the state is left early the goal becomes invalid, and the next entry starts
//! anew. A queue that cannot be run ends at once: the goal is then invalid and done.
//!
//! A program can be brought to rest on its path and continued by the commands that do so for typed
//! moves. In TRAJECTORY/USER the moves come one by one, as the operator types them ([`online`]).

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
    ControlState, Desired, Goal, JointState, MoveCheck, MoveKind, MoveQueue, OperatorMove, State,
};

/// The state of the task.
#[derive(Clone, Copy, Debug)]
enum Progress {
    /// The machine is not in the state TRAJECTORY.
    Idle,
    /// A program is carried out, from joints of this datum; the command that was handled last.
    Program { datum: u32, last_command: u32 },
    /// Moves are taken as the operator types them, from joints of this datum.
    Online { datum: u32 },
    /// The queue was refused since the state was entered.
    Refused,
}

/// The task.
pub struct Trajectory<const N: usize = 6, A: Arm<N> = Puma260> {
    control: Input<ControlState>,
    desired: Input<Desired<N>>,
    joints: Input<JointState<N>>,
    moves: Input<OperatorMove>,
    goal: Output<Goal<N>>,
    check: Output<MoveCheck>,
    typed: Output<MoveQueue>,
    plan: Plan<N, A>,
    program: Program<N, A>,
    online: Online<N, A>,
    progress: Progress,
    /// When the present stay in TRAJECTORY began.
    entered_ns: i64,
}

/// A goal that is invalid and done.
fn finished_goal<const N: usize>() -> Goal<N> {
    Goal { done: 1, ..Goal::ZERO }
}

impl<const N: usize, A: Arm<N>> Trajectory<N, A> {
    /// Declares `control`, `desired`, `joints`, `moves`, `goal`, `check` and `queue`.
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
        let program = Program::empty(&plan).map_err(roomless)?;
        let online = Online::empty(&plan).map_err(roomless)?;
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
            typed: ports.output("queue"),
            progress: Progress::Idle,
            entered_ns: 0,
        })
    }

    /// Begins with the queue when the state is entered in this job, or with typed moves; `word` is
    /// the last message typed before.
    fn enter(
        &mut self,
        tick_s: f64,
        desired: Option<Desired<N>>,
        joints: Option<JointState<N>>,
        typing: bool,
        word: Option<OperatorMove>,
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
        let last_command = word.map_or(0, |word| word.sequence);
        self.progress = Progress::Program { datum: joints.datum, last_command };
        Ok(())
    }

    /// The goal of this job, and the check if it has changed.
    fn proceed(
        &mut self,
        tick: u64,
        word: Option<OperatorMove>,
    ) -> (Goal<N>, Option<MoveCheck>, Result<(), FaultCode>) {
        match self.progress {
            Progress::Idle => return (Goal::ZERO, None, Ok(())),
            Progress::Refused => return (finished_goal(), None, Ok(())),
            Progress::Online { .. } => return self.proceed_online(word),
            Progress::Program { .. } => self.handle_pause(word),
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
                (finished_goal(), Some(check), Err(fault_of(&check)))
            }
        }
    }

    /// Pauses or continues the program when a message commands it.
    fn handle_pause(&mut self, word: Option<OperatorMove>) {
        let Progress::Program { last_command, .. } = &mut self.progress else { return };
        let Some(word) = word.filter(|word| word.sequence != *last_command) else { return };
        *last_command = word.sequence;
        let paused = match MoveKind::from_code(word.kind) {
            Some(MoveKind::Pause) => true,
            Some(MoveKind::Resume) => false,
            _ => return,
        };
        self.program.pause(paused);
        self.online.record_command(word.sequence, paused);
    }

    /// Does the same with typed moves. A move that is refused is no fault: the arm continues with
    /// those before it.
    fn proceed_online(
        &mut self,
        word: Option<OperatorMove>,
    ) -> (Goal<N>, Option<MoveCheck>, Result<(), FaultCode>) {
        let at = self.online.step(&self.plan, word);
        let reported = self.online.take_check();
        let Some(at) = at else {
            self.progress = Progress::Refused;
            return (finished_goal(), reported, Err(FaultCode::Unreachable));
        };
        let goal = Goal { q_rad: at.q.into(), qd_rad_s: at.qd.into(), valid: 1, done: 0 };
        (goal, reported, Ok(()))
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
                if matches!(self.progress, Progress::Program { .. }) {
                    self.online.record_command(self.online.typed().received, false);
                }
                self.progress = Progress::Idle;
            }
            Some(control) => {
                let stays = !matches!(self.progress, Progress::Idle)
                    && control.entered_ns == self.entered_ns;
                let datum = match self.progress {
                    Progress::Program { datum, .. } | Progress::Online { datum } => Some(datum),
                    Progress::Idle | Progress::Refused => None,
                };
                let moved = datum.is_some() && datum != joints.map(|joints| joints.datum);
                if !stays {
                    self.entered_ns = control.entered_ns;
                    let tick_s = cycle.dt.as_secs_f64();
                    let entered = self.enter(tick_s, desired, joints, typing, word);
                    outcome = entered.map_err(|(fault, reported)| {
                        check = reported;
                        fault
                    });
                } else if moved {
                    // The zero of the joints moved under the path.
                    self.progress = Progress::Refused;
                    outcome = Err(FaultCode::MoveRefused);
                }
            }
        }
        let (goal, reported, proceeded) = self.proceed(cycle.tick, word);
        io.write(&self.goal, goal);
        io.write(&self.typed, *self.online.typed());
        if let Some(check) = reported.or(check) {
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
            Progress::Program { datum, last_command } => {
                hash.word(1).add(datum).add(last_command);
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
