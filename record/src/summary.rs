//! The closing summary of a run: the object that `taktil run --json` prints and that the run's log
//! keeps, and from which the closing table, the report and the pictures of the timing are drawn.
//! What was not measured is absent, and null in JSON.

use std::collections::BTreeMap;

use anyhow::Context;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use taktil_rtcore::FaultCode;

use crate::granted::Grants;
use crate::{Log, METADATA_RESULT};

/// Key of the closing metadata under which a log keeps the summary as JSON.
pub const SUMMARY_KEY: &str = "summary";

/// How time passed in a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RunMode {
    /// On real-time threads.
    #[default]
    Live,
    /// In virtual time.
    Fast,
}

/// Smallest and largest value.
pub type Range = [f64; 2];

/// The end of a run in numbers. Lengths and angles have their unit in the name; tactile features
/// are in counts and tactels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Summary {
    /// No fault that calls for a reaction was latched.
    pub ok: bool,
    /// Path of the scene as it was given.
    pub scene: String,
    /// One line for people.
    pub title: String,
    /// Seed of all chance.
    pub seed: u64,
    /// How time passed.
    pub mode: RunMode,
    /// Simulated seconds that were run.
    pub sim_s: f64,
    /// Wall seconds from the first job to the last.
    pub wall_s: f64,
    /// Where jobs panicked, the first place of each lane.
    pub panics: Vec<String>,
    /// For how long the simulated world waited for a machine that stalled (s).
    pub slipped_s: Option<f64>,
    /// Digest of all records.
    pub digest: String,
    /// A person ended the run.
    pub interrupted: bool,
    /// What the kernel granted.
    pub attested: Grants,
    /// Whether the timing says something about a real-time machine.
    pub representative_timing: bool,
    /// Touch had the arm at some time.
    pub touched: bool,
    /// The force reached its set point.
    pub rolled: bool,
    /// Reversals of the rolling direction.
    pub strokes: u32,
    /// Measured centroid in column numbers while rolling.
    pub x_c: Option<Range>,
    /// Finger position along x0 while rolling, from the encoders.
    pub p_x_mm: Option<Range>,
    /// Finger position along z0 while rolling, from the encoders.
    pub p_z_mm: Option<Range>,
    /// Angle of the sensor's x axis about z0 while rolling.
    pub theta_xx_deg: Option<Range>,
    /// Angle of the sensor's z axis about x0 while rolling.
    pub theta_zz_deg: Option<Range>,
    /// Finger travel over contact travel: 2 when nothing slips.
    pub rolling_ratio: Option<f64>,
    /// Tactile features against their set points.
    pub features: FeatureErrors,
    /// What the simulator knows and no sensor tells.
    pub truth: TruthFigures,
    /// Desired minus measured angle, joint by joint (deg).
    pub tracking_deg: Vec<ErrorFigures>,
    /// How still the arm held.
    pub hold: HoldFigures,
    /// Lanes and what they counted.
    pub lanes: Vec<LaneSummary>,
    /// Faults that call for a reaction.
    pub faults: Vec<FaultSummary>,
    /// State of the control program at the end.
    pub state: String,
    /// Requests that the supervisor refused.
    pub refused_requests: u32,
    /// What the check of the programmed moves said last.
    pub moves: Option<MoveSummary>,
    /// Changes of phase of a touch task, the first ones; empty without one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub phases: Vec<PhaseSummary>,
    /// Log file.
    pub log: Option<String>,
    /// The command that repeats this run.
    pub repeat: String,
}

impl Summary {
    /// The summary that a run left in its log.
    ///
    /// # Errors
    /// Metadata that are not a summary.
    pub fn from_log(log: &Log) -> anyhow::Result<Option<Summary>> {
        let text = log.metadata().get(METADATA_RESULT).and_then(|result| result.get(SUMMARY_KEY));
        let Some(text) = text else { return Ok(None) };
        serde_json::from_str(text).context("the log's closing summary is not JSON").map(Some)
    }

    /// The JSON object, whose keys are sorted.
    #[must_use]
    pub fn to_json(&self) -> Value {
        serde_json::to_value(self).unwrap_or_default()
    }
}

/// Tactile features against their set points while rolling.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FeatureErrors {
    /// Centroid minus the pin's contact line on the sensor, tactels.
    pub x_c: ErrorFigures,
    /// Sum of the counts, against its set point.
    pub m0: LevelFigures,
    /// Moment about the middle line, whose set point is 0.
    pub m_x: ErrorFigures,
    /// Direction of the pin, whose set point is 0.
    pub theta_z: ErrorFigures,
}

/// An error over a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ErrorFigures {
    /// Root mean square.
    pub rms_error: Option<f64>,
    /// Largest magnitude.
    pub peak_error: Option<f64>,
    /// Unit, where the key does not say it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
}

/// A value over a run, and its error against a set point.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LevelFigures {
    /// Mean of the value.
    pub mean: Option<f64>,
    /// Root mean square of the error.
    pub rms_error: Option<f64>,
    /// Largest magnitude of the error.
    pub peak_error: Option<f64>,
}

/// The true normal force (N).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ForceFigures {
    /// Mean force.
    pub mean: Option<f64>,
    /// Root mean square of force minus set point.
    pub rms_error: Option<f64>,
    /// Largest magnitude of force minus set point.
    pub peak_error: Option<f64>,
    /// Set point.
    pub set_point: Option<f64>,
}

/// A deviation over a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SpreadFigures {
    /// Root mean square.
    pub rms: Option<f64>,
    /// Largest magnitude.
    pub peak: Option<f64>,
    /// Average over about the last second.
    pub steady: Option<f64>,
}

/// The finger's height about its mean.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HeightFigures {
    /// Root mean square.
    pub rms: Option<f64>,
    /// Largest magnitude.
    pub peak: Option<f64>,
}

/// What the simulator knows and no sensor tells.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TruthFigures {
    /// Normal force between finger and pin.
    pub normal_force_n: ForceFigures,
    /// Yaw of the pin on the sensor.
    pub pin_yaw_error_deg: SpreadFigures,
    /// Tilt of the finger against the pin.
    pub pin_tilt_error_deg: SpreadFigures,
    /// Height of the finger about its mean.
    pub height_error_mm: HeightFigures,
    /// Fastest sliding at either side of the pin.
    pub slip_mm_s: Option<f64>,
    /// How often the finger parted from what it touches.
    pub contact_lost: u32,
    /// How contacts were solved; absent where no solution in three dimensions was asked for.
    pub layer: Option<ContactCounts>,
}

/// How contacts were solved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct ContactCounts {
    /// Contacts that were solved in three dimensions.
    pub spatial_solutions: u64,
    /// Contacts after which the rows of the pad stood on their own.
    pub spatial_failures: u64,
}

/// How still the arm held in IDLE/CALIBRATED.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HoldFigures {
    /// True tool point minus the desired one.
    pub finger_error_mm: DistanceFigures,
    /// Desired minus measured angle in the steady state, joint by joint.
    pub joint_error_deg: Vec<Option<f64>>,
    /// Gravity torque over Kp, joint by joint; absent with a gravity term or without holding.
    pub gravity_over_kp_deg: Option<Vec<Option<f64>>>,
}

/// A distance over a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DistanceFigures {
    /// Mean.
    pub mean: Option<f64>,
    /// Largest.
    pub peak: Option<f64>,
    /// Average over about the last second.
    pub steady: Option<f64>,
}

/// A lane and what it counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LaneSummary {
    /// Name.
    pub name: String,
    /// Period (ns).
    pub period_ns: i64,
    /// Deadline after the release (ns).
    pub deadline_ns: i64,
    /// `SCHED_FIFO` priority.
    pub priority: u8,
    /// Jobs that ran.
    pub jobs: u64,
    /// Jobs that were left out.
    pub skipped: u64,
    /// How late jobs started.
    pub release_late_us: Percentiles,
    /// Processor time of the jobs.
    pub exec_us: Percentiles,
    /// Time from waking to going to sleep again, without what the guard spun.
    pub awake_us: Percentiles,
    /// The guard that wakes the lane early; absent without one.
    pub guard: Option<GuardSummary>,
    /// The lane's tasks; empty when they were not timed.
    pub tasks: Vec<TaskSummary>,
    /// Histogram of the lateness: upper edges (us) and jobs.
    pub release_late_bins: Vec<(f64, u64)>,
    /// Histogram of the execution: upper edges (us) and jobs.
    pub exec_bins: Vec<(f64, u64)>,
    /// Missed deadlines by cause.
    pub misses: BTreeMap<String, u64>,
    /// Misses that would each have stopped a machine on a board, because they came too often.
    pub storms: u64,
    /// Memory allocations in jobs; absent where they are not counted.
    pub allocations: Option<u64>,
    /// Page faults in jobs.
    pub page_faults: u64,
    /// Records lost because the observer was slow.
    pub records_dropped: u64,
    /// Values lost because another lane stood still.
    pub values_dropped: u64,
}

impl LaneSummary {
    /// Missed deadlines of all causes.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.misses.values().sum()
    }
}

/// Percentiles of a time (us).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 90 %.
    pub p90: f64,
    /// 99 %.
    pub p99: f64,
    /// 99.9 %.
    pub p99_9: f64,
    /// Longest.
    pub max: f64,
}

/// The guard that wakes a lane before its release.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct GuardSummary {
    /// How long before (ns).
    pub margin_ns: i64,
    /// Share of one processor that was spent spinning.
    pub cpu_share: f64,
}

/// What a task took against what it declared.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TaskSummary {
    /// Name.
    pub name: String,
    /// Declared processor time of one step (us); absent where none was declared.
    pub budget_us: Option<i64>,
    /// Processor time of its steps.
    pub exec_us: Percentiles,
    /// A budget to declare (us); absent where nothing was measured.
    pub suggested_us: Option<u64>,
    /// From what the suggestion was computed, in words.
    pub suggested_from: String,
}

/// A latched fault.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FaultSummary {
    /// Code.
    pub code: u16,
    /// Name.
    pub name: String,
    /// What it means.
    pub text: String,
}

impl From<FaultCode> for FaultSummary {
    fn from(fault: FaultCode) -> FaultSummary {
        FaultSummary {
            code: fault as u16,
            name: format!("{fault:?}"),
            text: fault.text().to_owned(),
        }
    }
}

/// How the check of the programmed moves stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MoveVerdict {
    /// The run ended before all moves were looked at.
    #[default]
    Looking,
    /// All moves can be made.
    Passed,
    /// A move cannot be made.
    Refused,
}

/// A touch task went on to another phase.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PhaseSummary {
    /// When (s).
    pub at_s: f64,
    /// The phase that began; `end` after the last one.
    pub phase: String,
    /// Why, in words.
    pub cause: String,
    /// Time in the phase before (s).
    pub time_s: f64,
    /// Motion in the phase before, along x, y, z and about them (mm, mrad).
    pub moved: [f64; 6],
    /// Sum of the counts at the change.
    pub m0: f64,
}

/// What the check of the programmed moves said.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MoveSummary {
    /// How it stands.
    pub verdict: MoveVerdict,
    /// Number of the move with which the refused leg begins, 1 for the first; else moves that were
    /// looked at.
    pub moves: u32,
    /// Why it was refused, in words.
    pub reason: Option<String>,
    /// The joint that could not follow, 1 the first.
    pub joint: Option<u32>,
    /// What this joint is called.
    pub joint_name: Option<String>,
    /// When, from the start of the refused leg (s).
    pub t_s: f64,
    /// Speed or torque wanted over what there is.
    pub ratio: Option<f64>,
    /// Time that all legs take (s).
    pub duration_s: f64,
    /// Largest share of a joint's speed that is used.
    pub speed_share: f64,
    /// Largest share of a joint's torque that is used, friction left out.
    pub torque_share: f64,
    /// Smallest scaled distances from the singularities.
    pub singular_distance: SingularDistances,
    /// Largest distance of the tool from its path.
    pub path_error_mm: f64,
    /// Largest angle of the tool to its path.
    pub path_error_deg: f64,
}

/// Smallest scaled distances from the singularities of an arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SingularDistances {
    /// Distance from the shoulder singularity; none when it is not finite.
    pub shoulder: Option<f64>,
    /// Distance from the elbow singularity; none when it is not finite.
    pub elbow: Option<f64>,
    /// Distance from the wrist singularity; none when it is not finite.
    pub wrist: Option<f64>,
}
