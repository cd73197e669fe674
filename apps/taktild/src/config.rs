//! The description of a machine: lanes, wiring, and the configuration of each task. One readable
//! file. Refuses devices and scenes: those come from whoever assembles the machine.

use std::collections::BTreeMap;

use serde::Deserialize;
use taktil_rtcore::{Allowance, Guard, Invalid, LaneSpec, Late, Nanos};

/// A machine file, or the part of a scene that replaces some of its sections.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MachineConfig {
    /// Lanes by name; a section of a scene replaces the lane of that name.
    pub lane: BTreeMap<String, LaneConfig>,
    /// What the analysis of the schedule allows for.
    pub schedule: Option<ScheduleConfig>,
    /// Which signal each input reads: `"task.port" = "task.port"`.
    pub wiring: BTreeMap<String, String>,
    /// Counts to joint angles.
    pub sense: Option<taktil_tasks_sense::Config>,
    /// Torque to D/A words.
    pub actuate: Option<taktil_tasks_actuate::Config>,
    /// Choice among the sources of motion.
    pub setpoint: Option<taktil_tasks_setpoint::Config>,
    /// Position servo.
    pub joint_servo: Option<taktil_tasks_joint_servo::Config>,
    /// Programmed moves.
    pub trajectory: Option<taktil_tasks_trajectory::Config>,
    /// Tactile frames to images.
    pub tactile_scan: Option<taktil_tasks_tactile_scan::Config>,
    /// Motion by touch.
    pub tactile_servo: Option<taktil_tasks_tactile_servo::Config>,
    /// The state machine.
    pub supervisor: Option<taktil_tasks_supervisor::Config>,
}

/// What is allowed for when the schedule is analysed, besides the declared budgets.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScheduleConfig {
    /// From a release to the start of its job at most, when nobody else runs, us. Default 100.
    pub release_jitter_us: i64,
    /// The executor's own work in each job, us. Default 5.
    pub overhead_us: i64,
}

impl Default for ScheduleConfig {
    fn default() -> ScheduleConfig {
        let Allowance { release_jitter, overhead } = Allowance::default();
        ScheduleConfig {
            release_jitter_us: release_jitter.0 / 1000,
            overhead_us: overhead.0 / 1000,
        }
    }
}

impl ScheduleConfig {
    /// The allowance of the analysis.
    ///
    /// # Errors
    /// A number that cannot be meant. The place is `schedule.FIELD`.
    pub fn allowance(&self) -> Result<Allowance, Invalid> {
        let span = |place: &str, us: i64| span(place, us).map_err(|bad| bad.within("schedule"));
        Ok(Allowance {
            release_jitter: span("release_jitter_us", self.release_jitter_us)?,
            overhead: span("overhead_us", self.overhead_us)?,
        })
    }
}

/// One lane in a machine file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LaneConfig {
    /// Time between releases, us.
    pub period_us: i64,
    /// Release of job 0, us.
    #[serde(default)]
    pub phase_us: i64,
    /// From release to the instant at which other lanes see this lane's values, us; one period when
    /// absent.
    pub delivery_us: Option<i64>,
    /// From release to the latest end that is not a miss, us; `delivery_us` when absent.
    pub deadline_us: Option<i64>,
    /// `SCHED_FIFO` priority, 1..=99.
    pub priority: i64,
    /// CPU to run on; any when absent.
    pub cpu: Option<usize>,
    /// Wakes early and spins to the release; none sleeps to the release.
    pub guard: Option<GuardConfig>,
    /// Tasks in the order in which they run.
    pub tasks: Vec<String>,
    /// Longest processor time of one step of each task, us. All tasks or none: a lane with gaps is
    /// not analysed.
    #[serde(default)]
    pub budget_us: BTreeMap<String, i64>,
}

/// The release guard of a lane.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuardConfig {
    /// Largest share of a processor that may be spent spinning, above 0 and at most 0.5.
    pub cpu_share_max: f64,
}

/// Microseconds beyond this are refused before they could overflow.
const LONGEST_US: i64 = 1_000_000_000_000;

fn span(place: &str, us: i64) -> Result<Nanos, Invalid> {
    if (-LONGEST_US..=LONGEST_US).contains(&us) {
        return Ok(Nanos::from_micros(us));
    }
    let remedy = "give microseconds that a robot could mean";
    Err(Invalid::new(place, format!("{us} us is out of range"), remedy))
}

impl LaneConfig {
    /// The lane's specification.
    ///
    /// # Errors
    /// A number that cannot be meant; places are relative to the lane.
    pub fn spec(&self, name: &str) -> Result<LaneSpec, Invalid> {
        let period = span("period_us", self.period_us)?;
        let delivery = self.delivery_us.map_or(Ok(period), |us| span("delivery_us", us))?;
        let priority = u8::try_from(self.priority).map_err(|_| {
            Invalid::new(
                "priority",
                format!("{} is not a SCHED_FIFO priority", self.priority),
                "give 1 (lowest) to 99 (highest)",
            )
        })?;
        let guard = self.guard.map(|guard| Guard::of_share(guard.cpu_share_max, period));
        let guard = guard.transpose().map_err(|invalid| invalid.within("guard"))?;
        let mut budgets = BTreeMap::new();
        for (task, us) in &self.budget_us {
            budgets.insert(task.clone(), span(&format!("budget_us.{task}"), *us)?);
        }
        Ok(LaneSpec {
            name: name.to_owned(),
            period,
            phase: span("phase_us", self.phase_us)?,
            delivery,
            deadline: self.deadline_us.map_or(Ok(delivery), |us| span("deadline_us", us))?,
            priority,
            cpu: self.cpu,
            late: Late::Skip,
            budgets,
            guard,
        })
    }
}

impl MachineConfig {
    /// This machine with every section that `over` has put in its place; wiring is merged line by
    /// line.
    #[must_use]
    pub fn overridden_by(mut self, over: MachineConfig) -> MachineConfig {
        self.lane.extend(over.lane);
        self.wiring.extend(over.wiring);
        MachineConfig {
            lane: self.lane,
            schedule: over.schedule.or(self.schedule),
            wiring: self.wiring,
            sense: over.sense.or(self.sense),
            actuate: over.actuate.or(self.actuate),
            setpoint: over.setpoint.or(self.setpoint),
            joint_servo: over.joint_servo.or(self.joint_servo),
            trajectory: over.trajectory.or(self.trajectory),
            tactile_scan: over.tactile_scan.or(self.tactile_scan),
            tactile_servo: over.tactile_servo.or(self.tactile_servo),
            supervisor: over.supervisor.or(self.supervisor),
        }
    }
}
