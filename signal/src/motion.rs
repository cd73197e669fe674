//! Joint-space payloads: measured, desired, asked for, applied.

use taktil_rtcore::payload;

/// Number of joints of the arm.
pub const JOINTS: usize = 6;

payload! {
    /// Measured joints, from `sense`.
    pub struct JointState {
        /// Joint angles in the arm's zero convention once calibrated; relative to power-up before.
        pub q_rad: [f64; 6],
        /// Joint speeds by differencing over one tick; acts half a tick late.
        pub qd_rad_s: [f64; 6],
        /// Motor counts as read from the board.
        pub counts: [i32; 6],
        /// Increases by one each time the zero of `q_rad` moves: followers re-base instead of
        /// jumping.
        pub datum: u32,
        /// 1 once the counts were initialised at the home pose.
        pub calibrated: u32,
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
    pub struct Desired {
        /// Joint angles.
        pub q_rad: [f64; 6],
        /// Joint speeds belonging to them.
        pub qd_rad_s: [f64; 6],
        /// The [`crate::State`] whose source was chosen.
        pub source: u32,
        /// 1 while the angles are a position to be held, 0 before the first measurement.
        pub valid: u32,
    }
}

payload! {
    /// Where one source of motion wants the joints to be, from `trajectory`, `tactile_servo` and
    /// later jog.
    pub struct Goal {
        /// Joint angles.
        pub q_rad: [f64; 6],
        /// Joint speeds belonging to them.
        pub qd_rad_s: [f64; 6],
        /// 1 when the source is at work and the angles mean something.
        pub valid: u32,
        /// 1 when the source has nothing left to do.
        pub done: u32,
    }
}

payload! {
    /// Joint torque asked for by the servo.
    pub struct Torque {
        /// Torque at the joints.
        pub tau_nm: [f64; 6],
        /// Desired minus measured angle.
        pub error_rad: [f64; 6],
    }
}

payload! {
    /// What `actuate` sent to the board.
    pub struct Applied {
        /// Torque at the joints that the D/A words stand for.
        pub tau_nm: [f64; 6],
        /// D/A words, channel by channel.
        pub dac: [i32; 8],
        /// 1 when the mode let torque through.
        pub gate_open: u32,
        /// Bit j is set when joint j was limited.
        pub limited: u32,
    }
}
