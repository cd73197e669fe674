//! Carries out the queue of pre-programmed moves: Paul's joint motion, evaluated at 400 Hz. Refuses
//! to start from joints that are not calibrated, and a queue that would leave the arm's limits;
//! refuses Cartesian motion between goals (goals may be tool poses, the way there is in joint
//! space).
//!
//! When the state becomes TRAJECTORY the path is laid from the joints desired at that moment and
//! then only followed; when the state is left early the goal becomes invalid, and the next entry
//! starts anew. A queue that cannot be run ends at once: the goal is invalid and done.

pub mod config;
pub mod law;

pub use config::{Config, Move, ToolGoal};

use config::Step;
use law::{Refusal, plan};
use taktil_mechanics::Joints;
use taktil_mechanics::paul::JointPath;
use taktil_mechanics::puma260::Puma260;
use taktil_rtcore::{Cycle, FaultCode, Input, Invalid, Io, Output, Payload, Ports, Task};
use taktil_signal::{ControlState, Desired, Goal, JointState, State};

/// Where the task is with its queue.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one, and the lane has no heap")]
enum Progress {
    /// Another state has the arm.
    Idle,
    /// On the way since the job with number `since`.
    Running { path: JointPath, since: u64, datum: u32 },
    /// The queue was refused in this stay.
    Refused,
}

/// The task.
pub struct Trajectory {
    control: Input<ControlState>,
    desired: Input<Desired>,
    joints: Input<JointState>,
    goal: Output<Goal>,
    arm: Puma260,
    steps: Vec<Step>,
    tau_s: f64,
    speed: f64,
    progress: Progress,
    /// When the present stay in TRAJECTORY began.
    entered_ns: i64,
}

impl Trajectory {
    /// Declares `control`, `desired`, `joints` and `goal`.
    ///
    /// # Errors
    /// What [`Config::steps`] refuses.
    pub fn new(config: Config, ports: &mut Ports) -> Result<Trajectory, Invalid> {
        let arm = Puma260::reference();
        Ok(Trajectory {
            steps: config.steps(&arm)?,
            tau_s: config.tau_s,
            speed: config.speed,
            arm,
            control: ports.input("control"),
            desired: ports.input_delayed("desired"),
            joints: ports.input("joints"),
            goal: ports.output("goal"),
            progress: Progress::Idle,
            entered_ns: 0,
        })
    }

    /// Lays the path of a stay that begins in this job.
    fn enter(
        &mut self,
        tick: u64,
        desired: Option<Desired>,
        joints: Option<JointState>,
    ) -> Result<(), FaultCode> {
        self.progress = Progress::Refused;
        let start = desired.filter(|desired| desired.valid == 1);
        let (Some(start), Some(joints)) = (start, joints.filter(|j| j.calibrated == 1)) else {
            return Err(FaultCode::MoveRefused);
        };
        let start = Joints::from(start.q_rad);
        let path = plan(&self.arm, &start, &self.steps, self.tau_s, self.speed);
        let path = path.map_err(|refusal| match refusal {
            Refusal::Unreachable { .. } => FaultCode::Unreachable,
            Refusal::Limits => FaultCode::MoveRefused,
        })?;
        self.progress = Progress::Running { path, since: tick, datum: joints.datum };
        Ok(())
    }

    fn goal(&self, cycle: &Cycle) -> Goal {
        match &self.progress {
            Progress::Idle => Goal::ZERO,
            Progress::Refused => Goal { done: 1, ..Goal::ZERO },
            Progress::Running { path, since, .. } => {
                let t_s = seconds(cycle, cycle.tick - since);
                let at = path.at(t_s);
                Goal {
                    q_rad: at.q.into(),
                    qd_rad_s: at.qd.into(),
                    valid: 1,
                    done: u32::from(t_s >= path.duration_s()),
                }
            }
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "jobs of a run stay far below 2^53")]
fn seconds(cycle: &Cycle, ticks: u64) -> f64 {
    ticks as f64 * cycle.dt.as_secs_f64()
}

impl Task for Trajectory {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable();
        let joints = io.read(&self.joints).usable();
        let mut outcome = Ok(());
        match control.filter(|control| control.state == State::Trajectory as u32) {
            None => self.progress = Progress::Idle,
            Some(control) => {
                let stays = !matches!(self.progress, Progress::Idle)
                    && control.entered_ns == self.entered_ns;
                let moved = matches!(self.progress, Progress::Running { datum, .. }
                    if joints.is_none_or(|joints| joints.datum != datum));
                if !stays {
                    self.entered_ns = control.entered_ns;
                    outcome = self.enter(cycle.tick, desired, joints);
                } else if moved {
                    // The zero of the joints moved under the path.
                    self.progress = Progress::Refused;
                    outcome = Err(FaultCode::MoveRefused);
                }
            }
        }
        io.write(&self.goal, self.goal(cycle));
        outcome
    }

    fn stop(&mut self) {
        self.progress = Progress::Idle;
    }
}
