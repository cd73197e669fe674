//! What people are told of each fault: what causes it, what the evidence is, and what ends it. The
//! page of the manual is made of it ([`table`]).

use core::fmt::Write as _;

use super::{Class, FaultCode};

/// What is to be known about a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// What is usually behind it.
    pub cause: &'static str,
    /// How it is recognised.
    pub evidence: &'static str,
    /// What a person does before resetting it.
    pub clearing: &'static str,
}

const fn explained(
    cause: &'static str,
    evidence: &'static str,
    clearing: &'static str,
) -> Explanation {
    Explanation { cause, evidence, clearing }
}

/// The explanation of each fault.
const EXPLANATIONS: &[(FaultCode, Explanation)] = &[
    (
        FaultCode::EncoderJump,
        explained(
            "lost or doubled counts, a loose cable, a board that restarted",
            "a step of a joint over 1.5 times its largest speed times the time between \
             two readings",
            "check cable and counter; calibrate anew",
        ),
    ),
    (
        FaultCode::EncoderLost,
        explained(
            "board gone, cable pulled, the lane of the readings stopped",
            "failed reads in a row, or joints older than `supervisor.input_stale_s`",
            "restore the board; calibrate anew where its counts were lost",
        ),
    ),
    (
        FaultCode::AnalogOutLost,
        explained(
            "board gone, cable pulled",
            "a write that is lost, or transient failures beyond `actuate.failures_max`; \
             enable and brakes go with it in the same job",
            "restore the board",
        ),
    ),
    (
        FaultCode::DigitalLost,
        explained(
            "board gone, cable pulled",
            "failed reads or writes, or lines older than `supervisor.input_stale_s`",
            "restore the board",
        ),
    ),
    (
        FaultCode::TactileLost,
        explained(
            "array gone, line pulled",
            "failed reads in a row",
            "restore the array; motion by touch has ended by itself",
        ),
    ),
    (
        FaultCode::TactileStale,
        explained(
            "an array or a line that is too slow",
            "no frame for longer than the task allows",
            "restore the array; motion by touch has ended by itself after \
             `supervisor.tactile_hold_s`",
        ),
    ),
    (
        FaultCode::TactileGarbled,
        explained(
            "noise on the line, a wrong format",
            "checksum, length, sequence or range of a frame",
            "nothing: the frame was dropped",
        ),
    ),
    (
        FaultCode::FollowingError,
        explained(
            "load too heavy, gains too low, an obstacle",
            "distance of desired and measured angle over `following_floor_deg` plus \
             `following_gain_s` times the desired speed",
            "free the joint, lighten the load or ask for less speed",
        ),
    ),
    (
        FaultCode::SoftLimit,
        explained(
            "a source of motion that leaves the range of a joint",
            "a desired angle outside the limits of the arm",
            "plan a motion inside the limits",
        ),
    ),
    (
        FaultCode::SetpointJump,
        explained(
            "a source of motion that jumps",
            "a desired angle that steps over 1.5 times the largest speed",
            "mend the source",
        ),
    ),
    (
        FaultCode::NotFinite,
        explained(
            "an error in a law",
            "NaN or infinity in a value that a task wrote; the last good value was kept",
            "mend the task",
        ),
    ),
    (
        FaultCode::TaskPanicked,
        explained(
            "an error in a task",
            "a panic that the lane caught; the task was stopped and taken out",
            "start the program anew: a task that was taken out does not come back",
        ),
    ),
    (
        FaultCode::Overrun,
        explained(
            "a job that took too long, a host that is not made for real time",
            "end of a job after its deadline",
            "nothing; `taktil doctor` says what the host lacks",
        ),
    ),
    (
        FaultCode::OverrunStorm,
        explained(
            "the same, again and again",
            "the misses of a lane fill its bucket",
            "give the lanes what they need; see misses.md",
        ),
    ),
    (
        FaultCode::DrivePowerLost,
        explained(
            "a supply or a fuse",
            "the line of drive power is low while torque is wanted",
            "restore the supply",
        ),
    ),
    (
        FaultCode::EmergencyStop,
        explained("somebody pressed it", "a channel of the emergency stop is open", "release it"),
    ),
    (
        FaultCode::EmergencyStopDisagrees,
        explained(
            "a broken contact or wire",
            "the two channels differ for longer than `supervisor.estop_discrepancy_s`",
            "mend the circuit: it does not protect",
        ),
    ),
    (
        FaultCode::Unreachable,
        explained(
            "a goal outside the arm's reach",
            "inverse kinematics finds no joints within the limits",
            "ask for another goal",
        ),
    ),
    (
        FaultCode::Singular,
        explained(
            "a motion through a singularity",
            "the scaled distance from a singularity is too small for the law",
            "ask for another path",
        ),
    ),
    (
        FaultCode::NotBumpless,
        explained(
            "a source of motion that starts elsewhere",
            "the first goal of a source is too far from the desired joints",
            "start the motion where the arm is",
        ),
    ),
    (
        FaultCode::MoveRefused,
        explained(
            "a move that cannot be carried out",
            "the check of whole moves",
            "ask for another move; `trajectory.check` says why",
        ),
    ),
    (
        FaultCode::LaneSilent,
        explained(
            "a thread that starves or hangs",
            "a lane that ends no job, or a value that stays away for longer than a job",
            "find what holds the thread; see misses.md",
        ),
    ),
    (
        FaultCode::DeadlineMissed,
        explained(
            "as `Overrun`, in a lane with `late_policy = \"fault\"`",
            "one miss, or one job left out",
            "give the lane what it needs",
        ),
    ),
    (
        FaultCode::OutOfRange,
        explained(
            "an error in a law",
            "a value outside the range that its output declares; the last good value was kept",
            "mend the task",
        ),
    ),
    (
        FaultCode::WristLost,
        explained("sensor gone, cable pulled", "failed reads in a row", "restore the sensor"),
    ),
    (
        FaultCode::Overload,
        explained(
            "the arm is not where it says, or the finger is driven into something",
            "load on the array far above its set point",
            "raise the finger; calibrate anew",
        ),
    ),
    (
        FaultCode::IndexMissing,
        explained(
            "a joint has not turned far enough since power-up",
            "calibration asked for without an index pulse",
            "turn each joint past a pulse, then calibrate",
        ),
    ),
    (
        FaultCode::IndexFar,
        explained(
            "the arm does not stand in its home pose",
            "distance from the nearest index pulse over `sense.index.distance_max_rev`",
            "go to the home pose, then calibrate",
        ),
    ),
    (
        FaultCode::AnalogLost,
        explained("board gone, cable pulled", "failed reads in a row", "restore the board"),
    ),
    (
        FaultCode::MonitorSilent,
        explained(
            "a thread beside the lanes that hangs",
            "its heartbeat stands still",
            "start the program anew",
        ),
    ),
    (
        FaultCode::WristOverRange,
        explained(
            "a force beyond the sensor, a broken gauge",
            "a gauge at an end of its range for several readings",
            "take the load away",
        ),
    ),
    (
        FaultCode::ForceUnknown,
        explained(
            "the same, while a law controls the force",
            "no force in contact that can be trusted",
            "take the load away",
        ),
    ),
    (
        FaultCode::Runaway,
        explained(
            "motor or encoder reversed, a wire exchanged; a blow against the arm looks alike",
            "a motor departs from its desired angle ever faster against its torque; \
             drives off in the same job",
            "check polarity with `taktil commission`; calibrate anew",
        ),
    ),
    (
        FaultCode::StuckEncoder,
        explained(
            "a dead encoder, a brake that does not open, a joint that is held fast",
            "50 ms of torque beyond gravity and friction towards the desired angle, with \
             at most 1 count",
            "check encoder and brake; calibrate anew",
        ),
    ),
    (
        FaultCode::JointLimit,
        explained(
            "wrong home pose, a limit that was overrun",
            "a measured, calibrated angle over `actuate.limit_margin_deg` beyond its limit",
            "move the arm back by hand or uncalibrated; calibrate in the home pose",
        ),
    ),
    (
        FaultCode::StopFailed,
        explained(
            "a drive without control, a joint that falls",
            "in a controlled stop the way of the fastest joint does not shrink from one \
             tenth of `supervisor.stop_time_max_s` to the next",
            "find which drive does not obey",
        ),
    ),
    (
        FaultCode::DriveFault,
        explained(
            "overcurrent, overload, a lost encoder, a following error of the drive's own loop, a \
             host that fell silent",
            "`sense.drives` has state 4 and the drive's code in `fault_code`, after CiA 402 that \
             of object 603F; the status names drive and code",
            "read the code in the drive's manual and remove the cause",
        ),
    ),
    (
        FaultCode::DriveLost,
        explained(
            "cable, supply, a drive that was left out of operation",
            "a read or a word to the drives failed more often than `failures_max`, or a drive did \
             not follow within the time that its driver allows",
            "look at the drive's own display and at what the device has counted",
        ),
    ),
];

/// What is told of a fault without a row; a test finds none.
const UNEXPLAINED_FAULT: Explanation = explained("", "", "");

impl FaultCode {
    /// Cause, evidence and what ends the fault.
    #[must_use]
    pub fn explanation(self) -> Explanation {
        let row = EXPLANATIONS.iter().find(|(fault, _)| *fault == self);
        row.map_or(UNEXPLAINED_FAULT, |(_, told)| *told)
    }
}

impl Class {
    /// The reaction in words.
    #[must_use]
    pub const fn reaction(self) -> &'static str {
        match self {
            Class::Note => "none; counted",
            Class::Degrade => "last value held, motion by touch ends",
            Class::ControlledStop => "controlled stop, then drives off",
            Class::DriveOff => "drives off and brakes on at once",
        }
    }

    /// What ends the fault besides what its row says.
    const fn reset(self) -> &'static str {
        match self {
            Class::Note => "",
            Class::Degrade => "; `reset`",
            Class::ControlledStop | Class::DriveOff => "; `reset`, then `enable`",
        }
    }
}

/// All faults as a table in Markdown, in the order of their codes.
#[must_use]
pub fn table() -> String {
    let mut text = String::from(
        "| code | fault | what it says | usual cause | evidence | reaction | what ends it |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for fault in FaultCode::ALL {
        let Explanation { cause, evidence, clearing } = fault.explanation();
        let (code, says, class) = (*fault as u16, fault.text(), fault.class());
        let (reaction, reset) = (class.reaction(), class.reset());
        // A string takes everything that is written to it.
        let _ = writeln!(
            text,
            "| {code} | `{fault:?}` | {says} | {cause} | {evidence} | {reaction} | \
             {clearing}{reset} |",
        );
    }
    text
}
