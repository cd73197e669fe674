//! `[arm]`: the arm and its initial state. An angle beyond the range of its joint is an error.

use super::section::{Consistency, inside, section};
use super::{Invalid, POINTS_MAX, invalid};

section! {
    /// `[arm]`
    #[serde(default)]
    pub struct ArmConfig {
        /// Joint angles at power-up (deg), where the incremental encoders read zero. The default,
        /// (0, 46.8, -160.6, -180, 66.2, 180), puts the finger, pointing straight down, at (325,
        /// -127, -134) mm, 15 mm above the default pin.
        home_deg: [f64; 6] [-720.0, 720.0],
        /// Deviation of each joint from `home_deg` at power-up (deg), as after an inaccurate
        /// calibration. Default 0.
        zero_error_deg: [f64; 6] [-30.0, 30.0],
        /// Trajectory of the joints for the arm `kinematic`: rows of an instant (s) and six angles
        /// (deg, zero errors included). The joints move from `home_deg` at the start through these
        /// points with smooth speeds and rest at the last. Without meaning for other arms.
        trajectory_deg: Vec<[f64; 7]> [-1e6, 1e6],
        /// Factor on the joints' Coulomb friction; 0 means none. Default 1.
        coulomb_scale: f64 [0.0, 10.0],
        /// Factor on the joints' viscous friction. Default 1.
        viscous_scale: f64 [0.0, 100.0],
        /// Factors on mass and inertia of the links of the simulated arm; the controller's model
        /// stays the same. Default 1.
        link_mass_scale: [f64; 6] [0.1, 10.0],
        /// Factor on mass and inertia of the tool on link 6 (sensor, finger and array) of the
        /// simulated arm; the controller's model stays the same. Default 1.
        tool_mass_scale: f64 [0.1, 10.0],
        /// Stiffness between each motor and its joint, on the joint's side (N m/rad), for the arm
        /// `rigid+motors+compliance`. The default, (6000, 9000, 3000, 300, 300, 150), is an
        /// estimate: no figure for this arm is known.
        gear_stiffness_nm_rad: [f64; 6] [1.0, 1e7],
        /// Damping of a rotor on the spring of its gear, in parts of the critical one. Default 0.1.
        gear_damping: f64 [0.0, 2.0],
        /// Counts of the encoders in a motor turn over those of the arm's own encoders; the
        /// controller's value is `[robot.sense] encoder_scale`. Default 1.
        encoder_scale: f64 [0.01, 1000.0],
        /// Index pulses of the encoders, one a motor turn, which the board latches: for each joint
        /// the distance (counts) from the nearest pulse below the home pose to the home pose.
        /// Default: the board reports none.
        index_counts: Option<Vec<f64>> [-1e6, 1e6],
        /// When the drives' supply comes on (s after the start). Default 0.
        power_on_s: f64 [0.0, 1e6],
    }
}

impl Consistency for ArmConfig {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        let mut last_s = 0.0;
        for (i, point) in self.trajectory_deg.iter().enumerate() {
            let place = inside(place, &format!("trajectory_deg[{i}]"));
            if point[0] <= last_s {
                let what = format!("is at {} s, not after {last_s} s", point[0]);
                return Err(invalid(&place, what, "order the points by time, after the start"));
            }
            last_s = point[0];
        }
        if self.trajectory_deg.len() > POINTS_MAX {
            let what = format!("has {} points", self.trajectory_deg.len());
            let remedy = format!("give at most {POINTS_MAX}");
            return Err(invalid(&inside(place, "trajectory_deg"), what, &remedy));
        }
        Ok(())
    }
}

impl Default for ArmConfig {
    fn default() -> ArmConfig {
        ArmConfig {
            home_deg: [0.0, 46.790197, -160.621702, -180.0, 66.168495, 180.0],
            zero_error_deg: [0.0; 6],
            trajectory_deg: Vec::new(),
            coulomb_scale: 1.0,
            viscous_scale: 1.0,
            link_mass_scale: [1.0; 6],
            tool_mass_scale: 1.0,
            gear_stiffness_nm_rad: [6000.0, 9000.0, 3000.0, 300.0, 300.0, 150.0],
            gear_damping: 0.1,
            encoder_scale: 1.0,
            index_counts: None,
            power_on_s: 0.0,
        }
    }
}
