//! Joint-space payloads: measured and desired joints, goals, moves, commanded and applied torques.

use taktil_rtcore::{Invalid, payload};

/// The most joints that an arm of the tasks may have.
pub const JOINTS_MAX: usize = 8;

payload! {
    /// Measured joints, from `sense`.
    pub struct JointState<const N: usize = 6> {
        /// Joint angles in the arm's zero convention once calibrated; relative to power-up before.
        pub q_rad: [f64; N],
        /// Joint speeds by differencing over one tick; acts half a tick late.
        pub qd_rad_s: [f64; N],
        /// Motor counts as read from the board.
        pub counts: [i32; N],
        /// Increases by one each time the zero of `q_rad` moves: followers re-base instead of
        /// jumping.
        pub datum: u32,
        /// 1 once the counts were initialised at the home pose.
        pub calibrated: u32,
    }
}

payload! {
    /// The result of the index pulses for a calibration, from `sense`, once for each requested
    /// calibration on a board that reports pulses.
    pub struct HomeCheck<const N: usize = 6> {
        /// How far each joint stood past the home pose.
        pub error_rad: [f64; N],
        /// The same in motor counts; 0 for a motor without a pulse.
        pub error_counts: [i32; N],
        /// The fault for which it was refused, a [`taktil_rtcore::FaultCode`]; 0 when granted.
        pub refused: u32,
        /// The motor for which the calibration was refused, 1 the first; 0 for none.
        pub motor: u32,
    }
}

payload! {
    /// Digital input lines, from `sense`. 1 is true.
    pub struct Lines {
        /// Drive power is present.
        pub drive_power: u32,
        /// Channel A of the emergency stop is closed, which is its healthy state.
        pub estop_a_closed: u32,
        /// Channel B.
        pub estop_b_closed: u32,
    }
}

payload! {
    /// The machine's desired joints, from `setpoint`, their only producer.
    pub struct Desired<const N: usize = 6> {
        /// Joint angles.
        pub q_rad: [f64; N],
        /// Joint speeds belonging to them.
        pub qd_rad_s: [f64; N],
        /// The [`crate::State`] whose source was chosen.
        pub source: u32,
        /// 1 while the angles are a position to be held, 0 before the first measurement.
        pub valid: u32,
    }
}

payload! {
    /// The joints that one source of motion asks for, from `trajectory`, `tactile_servo` or `jog`.
    pub struct Goal<const N: usize = 6> {
        /// Joint angles.
        pub q_rad: [f64; N],
        /// Joint speeds belonging to them.
        pub qd_rad_s: [f64; N],
        /// 1 when the source is at work and the angles mean something.
        pub valid: u32,
        /// 1 when the source has nothing left to do.
        pub done: u32,
    }
}

payload! {
    /// The state of the check of whole moves in `trajectory`: written once a job while the check
    /// runs, and once with its verdict.
    pub struct MoveCheck {
        /// 1 while the check runs, 2 passed, 3 refused.
        pub verdict: u32,
        /// Number of the move with which the refused leg begins, 1 for the first; otherwise the
        /// number of moves checked so far.
        pub moves: u32,
        /// Why it was refused: 1 a limit, 2 out of reach, 3 too fast, 4 too much torque, 5 too far
        /// off the path past a wrist singularity, 6 it cannot be planned or does not start here,
        /// 7 not at rest on its goal in time past a wrist singularity.
        pub reason: u32,
        /// The joint that could not follow, 1 the first; 0 for none.
        pub joint: u32,
        /// When, from the start of the refused leg (s); 0 with reason 6.
        pub t_s: f64,
        /// Required speed or torque over the largest one, with reasons 3 and 4.
        pub ratio: f64,
        /// Duration of all checked legs (s).
        pub duration_s: f64,
        /// Largest share of a joint's speed that is used.
        pub speed_share: f64,
        /// Largest share of a joint's torque that is used, friction left out.
        pub torque_share: f64,
        /// Smallest scaled distances from the singularities of shoulder, elbow and wrist.
        pub singular: [f64; 3],
        /// Largest distance of the tool from its path (m).
        pub path_error_m: f64,
        /// Largest angle of the tool to its path (rad).
        pub path_error_rad: f64,
    }
}

/// The messages that an operator types while the machine is in TRAJECTORY/USER.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum MoveKind {
    /// Nothing.
    #[default]
    None = 0,
    /// A move to joint angles.
    Joints = 1,
    /// A move of the tool to a pose in the base frame.
    Tool = 2,
    /// A move of the tool point along the tool's own axes.
    By = 3,
    /// Come to rest on the path.
    Pause = 4,
    /// Go on along the path.
    Resume = 5,
    /// Come to rest on the path and forget the rest of it.
    Clear = 6,
}

impl MoveKind {
    /// Every kind.
    pub const ALL: [MoveKind; 7] = [
        MoveKind::None,
        MoveKind::Joints,
        MoveKind::Tool,
        MoveKind::By,
        MoveKind::Pause,
        MoveKind::Resume,
        MoveKind::Clear,
    ];

    /// The kind with this number.
    #[must_use]
    pub fn from_code(code: u32) -> Option<MoveKind> {
        MoveKind::ALL.get(code as usize).copied()
    }
}

payload! {
    /// A move typed on-line, or a command for the moves that are carried out. Counts as one while
    /// `sequence` stays the same.
    pub struct OperatorMove {
        /// Joint angles (rad, as many as there are joints); or a rotation row by row, then the tool
        /// point (m); or a displacement (m, the first three).
        pub values: [f64; 12],
        /// Time of the segment (s); 0 is as fast as the machine's own pace.
        pub t_s: f64,
        /// A [`MoveKind`].
        pub kind: u32,
        /// 1 when the tool runs straight.
        pub straight: u32,
        /// 1 when it takes the place of everything that was typed before: the arm comes to rest on
        /// its path first.
        pub now: u32,
        /// Increases with every move.
        pub sequence: u32,
    }
}

payload! {
    /// The state of the typed moves.
    pub struct MoveQueue {
        /// Sequence of the newest move that was received.
        pub received: u32,
        /// Sequence of the newest move whose check is complete.
        pub checked: u32,
        /// Sequence of the newest move that was refused; what was typed after it goes with it.
        pub refused: u32,
        /// Moves that are being checked or carried out, and moves that wait for their check.
        pub queued: u32,
        /// 1 while the arm stands, or comes to rest, because it was asked to.
        pub paused: u32,
        /// 1 while the arm moves.
        pub moving: u32,
    }
}

payload! {
    /// Joint torque asked for by the servo.
    pub struct Torque<const N: usize = 6> {
        /// Torque at the joints.
        pub tau_nm: [f64; N],
        /// Desired minus measured angle.
        pub error_rad: [f64; N],
    }
}

payload! {
    /// What drives that close a loop report, joint by joint, from `sense`; in their own units.
    pub struct Drives<const N: usize = 6> {
        /// Positions, as the encoders of the joints count.
        pub position_counts: [i32; N],
        /// Velocities (counts/s).
        pub velocity_counts_s: [i32; N],
        /// Torques in codes of the arm's converter.
        pub torque_codes: [i32; N],
        /// States of the power sections: 0 off, 1 enabling, 2 following, 3 stopping, 4 fault.
        pub state: [u16; N],
        /// The drives' own codes for their faults, 0 without one.
        pub fault_code: [u16; N],
    }
}

impl<const N: usize> Drives<N> {
    /// The number in [`Drives::state`] of a drive that follows its target.
    pub const FOLLOWING_STATE: u16 = 2;
    /// The number in [`Drives::state`] of a drive with a fault.
    pub const FAULT_STATE: u16 = 4;

    /// Whether every drive follows its target.
    #[must_use]
    pub fn all_follow(&self) -> bool {
        self.state.iter().all(|state| *state == Self::FOLLOWING_STATE)
    }

    /// Whether a drive has a fault.
    #[must_use]
    pub fn has_fault(&self) -> bool {
        self.state.contains(&Self::FAULT_STATE)
    }
}

payload! {
    /// What `actuate` sent to the board.
    pub struct Applied<const N: usize = 6> {
        /// Torque at the joints that the D/A words stand for; that which drives report when they
        /// close the loop of the velocity or of the position.
        pub tau_nm: [f64; N],
        /// D/A words, or targets of drives, joint by joint; of a robot with more joints those of
        /// the first eight.
        pub dac: [i32; JOINTS_MAX],
        /// 1 when the mode let torque through.
        pub gate_open: u32,
        /// Bit j is set when joint j was limited.
        pub limited: u32,
    }
}

/// A list of a configuration as one number for each joint.
///
/// # Errors
/// Another count of numbers than there are joints; the place is `place`.
pub fn per_joint<const N: usize>(place: &str, list: &[f64]) -> Result<[f64; N], Invalid> {
    <[f64; N]>::try_from(list).map_err(|_| {
        let what = format!("has {} numbers, the arm has {N} joints", list.len());
        Invalid::new(place, what, "give one number for each joint")
    })
}

/// How near to a multiple of an eighth of a turn, in radians, a number is one (rad): as near as
/// three figures are.
const ROUND_ANGLE_RAD: f64 = 2e-3;

/// Whether a list of joint angles that should be in degrees is in radians: all of them are at most
/// a turn, and one is a multiple of an eighth of a turn, such as 1.571 or -3.14.
#[must_use]
pub fn is_in_radians(list: &[f64]) -> bool {
    let eighth = core::f64::consts::FRAC_PI_4;
    let is_round = |x: &f64| {
        let nearest = (x / eighth).round();
        nearest != 0.0 && (x - nearest * eighth).abs() <= ROUND_ANGLE_RAD
    };
    let most = 8.0 * eighth + ROUND_ANGLE_RAD;
    list.iter().all(|x| x.abs() <= most) && list.iter().any(is_round)
}

/// Refuses joint angles that are in radians where degrees are asked for.
///
/// # Errors
/// A list as of [`is_in_radians`]; the place is `place`.
pub fn check_degrees(place: &str, list: &[f64]) -> Result<(), Invalid> {
    if !is_in_radians(list) {
        return Ok(());
    }
    let what = format!("{list:?} looks like radians");
    Err(Invalid::new(place, what, "give degrees: 90 for a quarter of a turn"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radians_are_told_from_degrees() {
        let pi = core::f64::consts::PI;
        for radians in [
            &[0.0, 0.0, -pi, 0.0, pi / 2.0, 0.0][..],
            &[0.0, 0.0, -pi, 0.0, 1.571, 0.0],
            &[0.3, 0.785, 0.0, 0.0, 0.0, 0.0],
            &[-1.57],
        ] {
            assert!(is_in_radians(radians), "{radians:?}");
        }
        for degrees in [
            &[0.0, 0.0, -180.0, 0.0, 90.0, 0.0][..],
            &[0.0; 6],
            &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
            &[1.571, 90.0],
            &[f64::NAN, 1.571],
            &[],
        ] {
            assert!(!is_in_radians(degrees), "{degrees:?}");
        }
        assert_eq!(check_degrees("home_deg", &[1.571]).unwrap_err().place, "home_deg");
    }
}
