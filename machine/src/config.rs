//! The description of a machine in one readable file: lanes, wiring, and the configuration of each
//! task. The devices and the scene are given by the caller that assembles the machine.

use std::collections::BTreeMap;
use std::path::Path;

use crate::device::DeviceSection;
use crate::insert::{InsertConfig, LaneTasks};
use crate::joints::JointsConfig;
use crate::own::Section;
use crate::robot::ArmConfig;
use serde::Deserialize;
use taktil_rtcore::schedule::silent_after;
use taktil_rtcore::{
    Allowance, Guard, Invalid, LaneSpec, LatePolicy, LeakyBucket, Nanos, Policy, Recording,
};

taktil_rtcore::explained! {
    /// A machine file, or the part of a scene that replaces some of its sections.
    #[derive(Clone, Debug, Default, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct MachineConfig {
        /// Lanes by name; a section of a scene replaces the lane of that name.
        pub lane: BTreeMap<String, LaneConfig>,
        /// Tasks that are added to lanes, by name; a section of a scene replaces the one of that
        /// name.
        pub insert: BTreeMap<String, InsertConfig>,
        /// What the analysis of the schedule allows for besides the declared budgets.
        pub schedule: Option<ScheduleConfig>,
        /// What leaves the lanes for observers and logs: `full` (default), `decisions`, `values`.
        pub record: Option<RecordName>,
        /// Which signal each input reads: `"task.port" = "task.port"`; a line of a scene replaces
        /// the line of that input.
        pub wiring: BTreeMap<String, String>,
        /// The arm, from a URDF file; the PUMA 260 when absent.
        pub arm: Option<ArmConfig>,
        /// How the joints are wired to their encoders and converters, where it is not as the arm
        /// has it.
        pub joints: Option<JointsConfig>,
        /// Boards by name, each with the halves of the robot that it serves.
        pub device: BTreeMap<String, DeviceSection>,
        /// Counts to joint angles.
        pub sense: Option<taktil_tasks_sense::Config>,
        /// Torque to D/A words.
        pub actuate: Option<taktil_tasks_actuate::Config>,
        /// Choice among the sources of motion.
        pub setpoint: Option<taktil_tasks_setpoint::Config>,
        /// Position servo.
        pub joint_servo: Option<taktil_tasks_joint_servo::Config>,
        /// Motion by hand.
        pub jog: Option<taktil_tasks_jog::Config>,
        /// Programmed moves.
        pub trajectory: Option<taktil_tasks_trajectory::Config>,
        /// Tactile frames to images.
        pub tactile_scan: Option<taktil_tasks_tactile_scan::Config>,
        /// Tactile frames of the opposed fingertip's array to images, for `opposed_scan`.
        pub opposed_scan: Option<taktil_tasks_tactile_scan::Config>,
        /// As `tactile_scan`, for further arrays by name: `[scan.palm]` is for the task
        /// `palm_scan`, which reads the array `tactile_palm`.
        pub scan: BTreeMap<String, taktil_tasks_tactile_scan::Config>,
        /// Codes of the A/D board to values.
        pub analog_scan: Option<taktil_tasks_analog_scan::Config>,
        /// Gauges of the wrist to a wrench.
        pub wrist_scan: Option<taktil_tasks_wrist_scan::Config>,
        /// The releases of all lanes follow the clock of a board, for `clock_lock`.
        pub clock_lock: Option<taktil_tasks_clock_lock::Config>,
        /// Motion by touch.
        #[serde(deserialize_with = "taktil_tasks_tactile_servo::Config::deserialize_section")]
        pub tactile_servo: Option<taktil_tasks_tactile_servo::Config>,
        /// The grasp of a hand.
        pub grasp: Option<taktil_tasks_grasp::Config>,
        /// The state machine.
        pub supervisor: Option<taktil_tasks_supervisor::Config>,
        /// Sections of the program's own tasks, by name; a section of a scene replaces the one of
        /// that name.
        pub own: BTreeMap<String, Section>,
    }
}

taktil_rtcore::explained! {
    /// What leaves the lanes, each with all of the ones after it.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum RecordName {
        /// The hash of each task's state after each job.
        Full,
        /// How each job came about: enough to replay the run.
        Decisions,
        /// Every value that is written, and what the devices answered.
        Values,
    }
}

impl RecordName {
    /// As the core calls it.
    #[must_use]
    pub fn recording(self) -> Recording {
        match self {
            RecordName::Full => Recording::Full,
            RecordName::Decisions => Recording::Decisions,
            RecordName::Values => Recording::Values,
        }
    }
}

taktil_rtcore::explained! {
    /// What is allowed for when the schedule is analysed, besides the declared budgets.
    #[derive(Clone, Copy, Debug, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ScheduleConfig {
        /// From a release to the start of its job at most, when nobody else runs, us. Default 100.
        pub release_jitter_us: i64,
        /// The executor's own work in each job, us. Default 5.
        pub overhead_us: i64,
    }
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
    /// The allowances of the analysis.
    ///
    /// # Errors
    /// A number outside its range. The place is `schedule.FIELD`.
    pub fn allowance(&self) -> Result<Allowance, Invalid> {
        let duration_at =
            |place: &str, us: i64| duration(place, us).map_err(|bad| bad.within("schedule"));
        Ok(Allowance {
            release_jitter: duration_at("release_jitter_us", self.release_jitter_us)?,
            overhead: duration_at("overhead_us", self.overhead_us)?,
        })
    }
}

taktil_rtcore::explained! {
    /// One lane in a machine file.
    #[derive(Clone, Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct LaneConfig {
        /// Time between releases, us.
        pub period_us: i64,
        /// Release of job 0, us. Default 0.
        #[serde(default)]
        pub phase_us: i64,
        /// From release to the instant at which other lanes see this lane's values, us; one period
        /// when absent.
        pub delivery_us: Option<i64>,
        /// From release to the latest end that is not a miss, us; `delivery_us` when absent. In a
        /// scene, for the lane that actuates, no later than its words act.
        pub deadline_us: Option<i64>,
        /// How the lane's thread is scheduled: `fifo` (default) or `deadline`.
        #[serde(default)]
        pub policy: PolicyName,
        /// `SCHED_FIFO` priority, 1 to 99, needed with the policy `fifo`; a lane scheduled by
        /// deadline has none.
        pub priority: Option<i64>,
        /// CPU to run on; any when absent.
        pub cpu: Option<usize>,
        /// Wakes early and spins to the release. Where it is left out, a lane that names a CPU
        /// gets one of a fifth of that CPU, or a tenth, if the schedule bears it.
        pub guard: Option<GuardConfig>,
        /// What the lane does about superseded jobs: `skip` (default), `catch_up` or `fault`.
        #[serde(default)]
        pub late_policy: LateName,
        /// Superseded jobs in a row that a lane that catches up still runs, 1 to 1000; then it
        /// skips the rest. Default 4.
        pub catch_up_max: Option<u32>,
        /// How many misses the lane bears before the machine is stopped. Default: 5, one of them
        /// forgotten after 100 jobs without.
        #[serde(default)]
        pub misses: BucketConfig,
        /// Standing still for longer than this means that the lane is silent, us; ten periods and
        /// at least 50 ms when absent.
        pub stall_limit_us: Option<i64>,
        /// Tasks in the order in which they run.
        pub tasks: Vec<String>,
        /// Longest processor time of one step of each task, us. All tasks or none: a lane with gaps
        /// is not analysed.
        #[serde(default)]
        pub budget_us: BTreeMap<String, i64>,
    }
}

taktil_rtcore::explained! {
    /// How a lane's thread is scheduled.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum PolicyName {
        /// `SCHED_FIFO` at the lane's priority.
        #[default]
        Fifo,
        /// `SCHED_DEADLINE`, with what its tasks declare.
        Deadline,
    }
}

taktil_rtcore::explained! {
    /// What a lane does about superseded jobs.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum LateName {
        /// Leaves them out.
        #[default]
        Skip,
        /// Runs up to `catch_up_max` of them in a row, then leaves out the rest.
        CatchUp,
        /// Leaves them out and stops the machine.
        Fault,
    }
}

/// Number of superseded jobs that a lane catches up with by default.
const CATCH_UP_DEFAULT_JOBS: u32 = 4;
/// Largest number of superseded jobs that a lane may catch up with.
const CATCH_UP_LIMIT_JOBS: u32 = 1000;

taktil_rtcore::explained! {
    /// The bucket of a lane: `full` misses stop the machine.
    #[derive(Clone, Copy, Debug, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct BucketConfig {
        /// Misses that fill it. Default 5.
        pub bucket: u32,
        /// Jobs in a row without a miss that take one out. Default 100.
        pub leak_jobs: u32,
    }
}

impl Default for BucketConfig {
    fn default() -> BucketConfig {
        let LeakyBucket { capacity, leak_jobs } = LeakyBucket::default();
        BucketConfig { bucket: capacity, leak_jobs }
    }
}

taktil_rtcore::explained! {
    /// The release guard of a lane.
    #[derive(Clone, Copy, Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct GuardConfig {
        /// Largest share of a processor that may be spent spinning, at most 0.5; 0 for no guard.
        pub cpu_share_max: f64,
    }
}

/// Largest duration in microseconds; a larger one is an error and could overflow.
const DURATION_MAX_US: i64 = 1_000_000_000_000;

fn duration(place: &str, us: i64) -> Result<Nanos, Invalid> {
    if (-DURATION_MAX_US..=DURATION_MAX_US).contains(&us) {
        return Ok(Nanos::from_micros(us));
    }
    let remedy = "give microseconds that a robot could mean";
    Err(Invalid::new(place, format!("{us} us is out of range"), remedy))
}

impl LaneConfig {
    /// The lane's specification.
    ///
    /// # Errors
    /// A number outside its range; places are relative to the lane.
    pub fn spec(&self, name: &str) -> Result<LaneSpec, Invalid> {
        let period = duration("period_us", self.period_us)?;
        let delivery = self.delivery_us.map_or(Ok(period), |us| duration("delivery_us", us))?;
        let (policy, priority) = self.policy_and_priority()?;
        let guard = self.guard(period).map_err(|invalid| invalid.within("guard"))?;
        let mut budgets = BTreeMap::new();
        for (task, us) in &self.budget_us {
            budgets.insert(task.clone(), duration(&format!("budget_us.{task}"), *us)?);
        }
        Ok(LaneSpec {
            name: name.to_owned(),
            period,
            phase: duration("phase_us", self.phase_us)?,
            delivery,
            deadline: self.deadline_us.map_or(Ok(delivery), |us| duration("deadline_us", us))?,
            policy,
            priority,
            cpu: self.cpu,
            late: self.late_policy()?,
            misses: LeakyBucket { capacity: self.misses.bucket, leak_jobs: self.misses.leak_jobs },
            silent_after: self
                .stall_limit_us
                .map_or(Ok(silent_after(period)), |us| duration("stall_limit_us", us))?,
            budgets,
            guard,
        })
    }
}

impl LaneConfig {
    /// The requested guard; without a request, a guard on a named CPU if the schedule permits it.
    fn guard(&self, period: Nanos) -> Result<Option<Guard>, Invalid> {
        match self.guard {
            None => Ok(self.cpu.map(|_| Guard::when_schedulable(period))),
            Some(GuardConfig { cpu_share_max: 0.0 }) => Ok(None),
            Some(GuardConfig { cpu_share_max }) => {
                Guard::from_cpu_share(cpu_share_max, period).map(Some)
            }
        }
    }

    /// Policy and priority; a lane that is scheduled by deadline gets the highest priority, which
    /// no lane can request.
    fn policy_and_priority(&self) -> Result<(Policy, u8), Invalid> {
        let bad = |what: String, remedy: &str| Err(Invalid::new("priority", what, remedy));
        match (self.policy, self.priority) {
            (PolicyName::Deadline, None) => Ok((Policy::Deadline, 99)),
            (PolicyName::Deadline, Some(priority)) => bad(
                format!("{priority} for a lane that is scheduled by deadline"),
                "take the line away, or the policy",
            ),
            (PolicyName::Fifo, Some(priority)) => match u8::try_from(priority) {
                Ok(priority) => Ok((Policy::Fifo, priority)),
                Err(_) => bad(
                    format!("{priority} is not a SCHED_FIFO priority"),
                    "give 1 (lowest) to 99 (highest)",
                ),
            },
            (PolicyName::Fifo, None) => {
                bad("is missing".to_owned(), "give 1 (lowest) to 99 (highest)")
            }
        }
    }

    fn late_policy(&self) -> Result<LatePolicy, Invalid> {
        let bad = |what: String, remedy: &str| Err(Invalid::new("catch_up_max", what, remedy));
        match (self.late_policy, self.catch_up_max) {
            (LateName::Skip, None) => Ok(LatePolicy::Skip),
            (LateName::Fault, None) => Ok(LatePolicy::Fault),
            (LateName::CatchUp, most) => match most.unwrap_or(CATCH_UP_DEFAULT_JOBS) {
                at_most @ 1..=CATCH_UP_LIMIT_JOBS => Ok(LatePolicy::CatchUp { at_most }),
                most => {
                    bad(format!("{most} jobs are no bounded catching up"), "give 1 to 1000 jobs")
                }
            },
            (_, Some(most)) => bad(
                format!("{most} jobs are to be caught up by a lane that leaves them out"),
                "take the line away, or write late_policy = \"catch_up\"",
            ),
        }
    }
}

impl MachineConfig {
    /// Whether the arm carries a fingertip: the PUMA 260 does, others where `[arm.fingertip]` says
    /// so.
    #[must_use]
    pub fn has_fingertip(&self) -> bool {
        self.arm.as_ref().is_none_or(|arm| arm.fingertip.is_some())
    }

    /// Says in which folder the file stands from which this was read: sections of devices take
    /// relative paths from there.
    pub fn set_folder(&mut self, folder: &Path) {
        for section in self.device.values_mut() {
            section.set_folder(folder);
        }
    }

    /// This machine with each section replaced that `over` has; wiring is merged line by line.
    #[must_use]
    pub fn overridden_by(mut self, over: MachineConfig) -> MachineConfig {
        self.lane.extend(over.lane);
        self.insert.extend(over.insert);
        self.wiring.extend(over.wiring);
        self.own.extend(over.own);
        self.scan.extend(over.scan);
        self.device.extend(over.device);
        MachineConfig {
            lane: self.lane,
            insert: self.insert,
            schedule: over.schedule.or(self.schedule),
            record: over.record.or(self.record),
            wiring: self.wiring,
            arm: over.arm.or(self.arm),
            joints: over.joints.or(self.joints),
            device: self.device,
            sense: over.sense.or(self.sense),
            actuate: over.actuate.or(self.actuate),
            setpoint: over.setpoint.or(self.setpoint),
            joint_servo: over.joint_servo.or(self.joint_servo),
            jog: over.jog.or(self.jog),
            trajectory: over.trajectory.or(self.trajectory),
            tactile_scan: over.tactile_scan.or(self.tactile_scan),
            opposed_scan: over.opposed_scan.or(self.opposed_scan),
            scan: self.scan,
            analog_scan: over.analog_scan.or(self.analog_scan),
            wrist_scan: over.wrist_scan.or(self.wrist_scan),
            clock_lock: over.clock_lock.or(self.clock_lock),
            tactile_servo: over.tactile_servo.or(self.tactile_servo),
            grasp: over.grasp.or(self.grasp),
            supervisor: over.supervisor.or(self.supervisor),
            own: self.own,
        }
    }
    /// This machine with every task of `[insert]` in its lane, in the order of their names.
    ///
    /// # Errors
    /// A lane or a neighbour that does not exist, a neighbour that is not given or given twice, a
    /// task that runs already, a budget that is missing. The place is `insert.NAME` or a key of it.
    pub fn with_insertions(mut self) -> Result<MachineConfig, Invalid> {
        for (name, insertion) in std::mem::take(&mut self.insert) {
            let outer = format!("insert.{name}");
            self.insert_task(&name, insertion).map_err(|bad| bad.within(&outer))?;
        }
        Ok(self)
    }

    fn insert_task(&mut self, name: &str, insertion: InsertConfig) -> Result<(), Invalid> {
        let mut lanes = self.lane.iter();
        if let Some((lane, _)) = lanes.find(|(_, lane)| lane.tasks.iter().any(|t| t == name)) {
            let what = format!("`{name}` runs in lane `{lane}` already");
            return Err(Invalid::new("", what, "leave one of them out"));
        }
        let lane_name = insertion.lane.clone();
        let names: Vec<&str> = self.lane.keys().map(String::as_str).collect();
        let remedy = format!("lanes are: {}", names.join(", "));
        let Some(lane) = self.lane.get_mut(&lane_name) else {
            return Err(Invalid::new("lane", format!("there is no lane `{lane_name}`"), remedy));
        };
        let LaneConfig { tasks, budget_us, .. } = lane;
        insertion.insert(name, LaneTasks { name: &lane_name, tasks, budget_us })
    }
}

#[cfg(test)]
mod tests;
