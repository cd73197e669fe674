//! `[joint_servo]`: gains and options, checked. Gains that are not positive and finite are refused.

use serde::Deserialize;
use taktil_mechanics::arm::{Arm, ArmDynamics};
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::Invalid;
use taktil_signal::{check_degrees, per_joint};

use crate::friction::LearnedFriction;
use crate::law::{Gains, Pd};
use crate::notch::{Notch, NotchShape};
use crate::observer::Observer;

taktil_rtcore::explained! {
    /// Gains and options. Every key has a default.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Natural frequency of each joint (rad/s). Default 60: at 400 Hz with half a tick of
        /// actuation delay it keeps a phase margin against stiff contact.
        pub bandwidth_rad_s: Option<Vec<f64>>,
        /// Damping ratio of each joint. Default 1.
        pub damping: Option<Vec<f64>>,
        /// Inertia that the gains are computed for (kg m^2). Default: the diagonal of the arm's
        /// mass matrix, rotors included, at `inertia_pose_deg`.
        pub inertia_kg_m2: Option<Vec<f64>>,
        /// Pose of the mass matrix that the gains are computed for (deg). Default: where the arm is
        /// at work (PUMA 260: 0, 40, -153, -180, 67, 180, the finger over a pin), its home pose
        /// where nothing else is known.
        pub inertia_pose_deg: Option<Vec<f64>>,
        /// Torque per angle (N m/rad); replaces what bandwidth and inertia give. Default none.
        pub kp_nm_rad: Option<Vec<f64>>,
        /// Torque per rate of the error (N m s/rad); replaces what bandwidth, damping and inertia
        /// give. Default none.
        pub kd_nms_rad: Option<Vec<f64>>,
        /// Corner of the low-pass on the rate of the error (Hz). Default 60.
        pub derivative_filter_hz: f64,
        /// Takes the rate of the error from an observer with its poles at so many Hz instead:
        /// without the filter's lag and the half tick of a difference, for more noise. Default
        /// none.
        pub observer_hz: Option<f64>,
        /// Puts a notch on the error with its middle at so many Hz: where the arm swings on what it
        /// touches and the servo, late as it is, would stir it. Default none.
        pub notch_hz: Option<f64>,
        /// Joints (from 1) whose error the notch is on: those that move the finger along the
        /// contact's swing. Below the notch its lag takes damping from the others. Default all.
        pub notch_joints: Option<Vec<u32>>,
        /// Damping ratio of the notch's poles: how wide it is. Default 0.3.
        pub notch_width: f64,
        /// What the notch leaves in its middle, 0 to 1. Default 0.15.
        pub notch_depth: f64,
        /// Adds the torque that holds the arm against gravity at the desired joints, once they are
        /// calibrated. Default true; false is the thesis's plain PD, whose finger droops by
        /// millimetres.
        pub gravity: bool,
        /// Share of the friction model that is added along the desired motion, 0 to 1. Default 0.
        /// Less than all of it leaves room for what the model does not know.
        pub friction: f64,
        /// Desired speed at which half of Coulomb's friction is added (rad/s): below it the
        /// direction of the motion is in doubt. Default 0.01.
        pub friction_speed_rad_s: f64,
        /// Share of each joint's Coulomb friction, as learned from its own turns, that is added
        /// along the desired way, 0 to 1. Default 0.
        pub adaptive_friction: f64,
        /// Desired way over which the learned friction turns from one side to the other (rad).
        /// Default 5e-4.
        pub friction_reversal_rad: f64,
        /// Share of the torque that the desired acceleration takes, inertia and Coriolis, 0 to 1.
        /// Default 0.
        pub acceleration: f64,
        /// Pose in which the arm is taken to stand at power-up (deg): before calibration the
        /// gravity term is that of this pose plus the motion since. Default none: no gravity term
        /// before calibration; in a scene, where its arm starts. Give it only where the arm is
        /// posed by hand before power comes on.
        pub assumed_pose_deg: Option<Vec<f64>>,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            bandwidth_rad_s: None,
            damping: None,
            inertia_kg_m2: None,
            inertia_pose_deg: None,
            kp_nm_rad: None,
            kd_nms_rad: None,
            derivative_filter_hz: 60.0,
            observer_hz: None,
            notch_hz: None,
            notch_joints: None,
            notch_width: 0.3,
            notch_depth: 0.15,
            gravity: true,
            friction: 0.0,
            friction_speed_rad_s: 0.01,
            adaptive_friction: 0.0,
            friction_reversal_rad: 5e-4,
            acceleration: 0.0,
            assumed_pose_deg: None,
        }
    }
}

/// Natural frequency of a joint where the configuration gives none (rad/s).
const DEFAULT_BANDWIDTH_RAD_S: f64 = 60.0;
/// A joint's friction is at most the torque of the servo for this error (rad).
const FRICTION_ERROR_MAX_RAD: f64 = 5e-3;
/// Largest number that the table may hold, whatever its unit.
const VALUE_MAX: f64 = 1e6;

impl Config {
    /// # Errors
    /// A number that is not finite, not positive or huge.
    pub fn check(&self) -> Result<(), Invalid> {
        let lists = [
            ("bandwidth_rad_s", self.bandwidth_rad_s.as_ref()),
            ("damping", self.damping.as_ref()),
            ("inertia_kg_m2", self.inertia_kg_m2.as_ref()),
            ("kp_nm_rad", self.kp_nm_rad.as_ref()),
            ("kd_nms_rad", self.kd_nms_rad.as_ref()),
        ];
        for (name, list) in lists {
            for (joint, value) in list.into_iter().flatten().enumerate() {
                positive(&format!("{name}[{joint}]"), *value)?;
            }
        }
        let poses = [
            ("inertia_pose_deg", self.inertia_pose_deg.as_ref()),
            ("assumed_pose_deg", self.assumed_pose_deg.as_ref()),
        ];
        let angles = poses.into_iter().flat_map(|(name, pose)| {
            pose.into_iter().flatten().enumerate().map(move |(joint, value)| (name, joint, value))
        });
        for (name, joint, value) in angles {
            if !(value.is_finite() && value.abs() <= 720.0) {
                return Err(Invalid::new(
                    format!("{name}[{joint}]"),
                    format!("{value} is no joint angle"),
                    "give degrees between -720 and 720",
                ));
            }
        }
        for (name, pose) in poses {
            check_degrees(name, pose.map(Vec::as_slice).unwrap_or_default())?;
        }
        let shares = [
            ("friction", self.friction),
            ("adaptive_friction", self.adaptive_friction),
            ("acceleration", self.acceleration),
            ("notch_depth", self.notch_depth),
        ];
        for (name, share) in shares {
            if !(0.0..=1.0).contains(&share) {
                let what = format!("{share} is no share of a model");
                return Err(Invalid::new(name, what, "give 0 (none) to 1 (all of it)"));
            }
        }
        for (name, hz) in [("observer_hz", self.observer_hz), ("notch_hz", self.notch_hz)] {
            if let Some(hz) = hz.filter(|hz| !(*hz > 0.0 && *hz < 200.0)) {
                let what = format!("{hz} Hz is no place for poles at 400 Hz");
                return Err(Invalid::new(name, what, "give more than 0 and less than 200"));
            }
        }
        positive("notch_width", self.notch_width)?;
        positive("friction_reversal_rad", self.friction_reversal_rad)?;
        positive("friction_speed_rad_s", self.friction_speed_rad_s)?;
        positive("derivative_filter_hz", self.derivative_filter_hz)
    }

    /// What the table stands for on an arm.
    ///
    /// # Errors
    /// A list of another length than the arm.
    pub fn tuning<const N: usize, A: Arm<N>>(
        &self,
        robot: &Robot<N, A>,
    ) -> Result<Tuning<N>, Invalid> {
        let list = |place: &str, list: &Option<Vec<f64>>| {
            list.as_ref().map(|list| per_joint::<N>(place, list)).transpose()
        };
        let bandwidth = list("bandwidth_rad_s", &self.bandwidth_rad_s)?;
        let damping = list("damping", &self.damping)?;
        let pose = radians(list("inertia_pose_deg", &self.inertia_pose_deg)?);
        let inertia = match list("inertia_kg_m2", &self.inertia_kg_m2)? {
            Some(inertia) => JointVector::from(inertia),
            None => robot.dynamics.mass_matrix(&pose.unwrap_or(robot.nominal_rad)).diagonal(),
        };
        Ok(Tuning {
            bandwidth_rad_s: bandwidth.unwrap_or([DEFAULT_BANDWIDTH_RAD_S; N]),
            damping: damping.unwrap_or([1.0; N]),
            inertia_kg_m2: inertia,
            kp_nm_rad: list("kp_nm_rad", &self.kp_nm_rad)?,
            kd_nms_rad: list("kd_nms_rad", &self.kd_nms_rad)?,
            filter_hz: self.derivative_filter_hz,
            observer_hz: self.observer_hz,
            notch: match self.notch_hz {
                None => None,
                Some(hz) => {
                    let (width, depth) = (self.notch_width, self.notch_depth);
                    Some((NotchShape { hz, width, depth }, self.notch_joints()?))
                }
            },
            assumed_rad: radians(list("assumed_pose_deg", &self.assumed_pose_deg)?),
        })
    }

    /// Which joints the notch is on.
    fn notch_joints<const N: usize>(&self) -> Result<[bool; N], Invalid> {
        let Some(joints) = &self.notch_joints else { return Ok([true; N]) };
        let mut on = [false; N];
        for (place, joint) in joints.iter().enumerate() {
            let index = (*joint as usize).checked_sub(1).filter(|index| *index < N);
            let Some(index) = index else {
                let what = format!("the arm has no joint {joint}");
                let remedy = format!("give numbers from 1 to {N}");
                return Err(Invalid::new(format!("notch_joints[{place}]"), what, remedy));
            };
            on[index] = true;
        }
        Ok(on)
    }

    /// What learns the friction of joints with this tuning, where a share of it is wanted: none is
    /// taken for more than the torque that the servo makes of 5 mrad.
    #[must_use]
    pub fn friction_learner<const N: usize>(
        &self,
        tuning: &Tuning<N>,
    ) -> Option<LearnedFriction<N>> {
        let most_nm = tuning.gains().kp_nm_rad * FRICTION_ERROR_MAX_RAD;
        let learned =
            LearnedFriction::new(self.adaptive_friction, self.friction_reversal_rad, most_nm);
        (self.adaptive_friction > 0.0).then_some(learned)
    }
}

fn radians<const N: usize>(degrees: Option<[f64; N]>) -> Option<JointVector<N>> {
    degrees.map(|degrees| JointVector::from(degrees.map(f64::to_radians)))
}

/// The table for an arm, complete.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuning<const N: usize = 6> {
    /// Natural frequencies (rad/s).
    pub bandwidth_rad_s: [f64; N],
    /// Damping ratios.
    pub damping: [f64; N],
    /// Inertia that the gains are computed for (kg m^2).
    pub inertia_kg_m2: JointVector<N>,
    /// Torque per angle (N m/rad), in place of what bandwidth and inertia give.
    pub kp_nm_rad: Option<[f64; N]>,
    /// Torque per rate of the error (N m s/rad), likewise.
    pub kd_nms_rad: Option<[f64; N]>,
    /// Corner of the rate's low-pass (Hz).
    pub filter_hz: f64,
    /// Poles of the observer (Hz), where there is one.
    pub observer_hz: Option<f64>,
    /// The notch, where there is one, and the joints that it is on.
    pub notch: Option<(NotchShape, [bool; N])>,
    /// Where the arm is taken to stand before it is calibrated (rad).
    pub assumed_rad: Option<JointVector<N>>,
}

impl<const N: usize> Tuning<N> {
    /// The gains.
    #[must_use]
    pub fn gains(&self) -> Gains<N> {
        let placed = Gains::from_bandwidth(
            &self.inertia_kg_m2,
            &JointVector::from(self.bandwidth_rad_s),
            &JointVector::from(self.damping),
        );
        Gains {
            kp_nm_rad: self.kp_nm_rad.map_or(placed.kp_nm_rad, JointVector::from),
            kd_nms_rad: self.kd_nms_rad.map_or(placed.kd_nms_rad, JointVector::from),
        }
    }

    /// The law.
    #[must_use]
    pub fn law(&self) -> Pd<N> {
        let law = Pd::new(self.gains(), self.filter_hz)
            .with_notch(self.notch.map(|(shape, joints)| Notch::new(shape, joints)));
        match self.observer_hz {
            Some(hz) => law.with_observer(Observer::new(&self.inertia_kg_m2, hz)),
            None => law,
        }
    }
}

fn positive(place: &str, value: f64) -> Result<(), Invalid> {
    if value > 0.0 && value <= VALUE_MAX {
        return Ok(());
    }
    Err(Invalid::new(
        place,
        format!("{value} is not a positive, finite number of sensible size"),
        format!("give more than 0 and at most {VALUE_MAX}"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl FnOnce(&mut Config)) -> String {
        let mut config = Config::default();
        change(&mut config);
        config.check().unwrap_err().place
    }

    #[test]
    fn a_notch_is_on_the_joints_that_are_named() {
        let robot = Robot::puma260();
        let on = |joints: Option<Vec<u32>>| {
            let config = Config { notch_hz: Some(34.0), notch_joints: joints, ..Config::default() };
            config.tuning(&robot).map(|tuning| tuning.notch.unwrap().1)
        };
        assert_eq!(on(None).unwrap(), [true; 6]);
        assert_eq!(on(Some(vec![5, 2])).unwrap(), [false, true, false, false, true, false]);
        assert_eq!(on(Some(vec![2, 0])).unwrap_err().place, "notch_joints[1]");
        assert_eq!(on(Some(vec![7])).unwrap_err().place, "notch_joints[0]");
    }

    #[test]
    fn bad_numbers_are_refused_with_their_place() {
        assert_eq!(Config::default().check(), Ok(()));
        for bad in [f64::NAN, -0.1, 1.1, f64::INFINITY] {
            assert_eq!(refused(|c| c.friction = bad), "friction");
            assert_eq!(refused(|c| c.acceleration = bad), "acceleration");
            assert_eq!(refused(|c| c.adaptive_friction = bad), "adaptive_friction");
            assert_eq!(refused(|c| c.notch_depth = bad), "notch_depth");
        }
        assert_eq!(refused(|c| c.notch_hz = Some(200.0)), "notch_hz");
        assert_eq!(refused(|c| c.friction_speed_rad_s = 0.0), "friction_speed_rad_s");
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e7] {
            assert_eq!(
                refused(|c| c.bandwidth_rad_s = Some(vec![1.0, 1.0, bad])),
                "bandwidth_rad_s[2]"
            );
            assert_eq!(refused(|c| c.damping = Some(vec![bad])), "damping[0]");
            assert_eq!(refused(|c| c.derivative_filter_hz = bad), "derivative_filter_hz");
            assert_eq!(refused(|c| c.observer_hz = Some(bad)), "observer_hz");
            assert_eq!(refused(|c| c.notch_hz = Some(bad)), "notch_hz");
            assert_eq!(refused(|c| c.notch_width = bad), "notch_width");
            assert_eq!(refused(|c| c.friction_reversal_rad = bad), "friction_reversal_rad");
            assert_eq!(
                refused(|c| c.kp_nm_rad = Some(vec![1.0, 1.0, 1.0, 1.0, 1.0, bad])),
                "kp_nm_rad[5]"
            );
            assert_eq!(refused(|c| c.kd_nms_rad = Some(vec![bad; 6])), "kd_nms_rad[0]");
            assert_eq!(refused(|c| c.inertia_kg_m2 = Some(vec![bad; 6])), "inertia_kg_m2[0]");
        }
        assert_eq!(
            refused(|c| c.inertia_pose_deg = Some(vec![0.0, f64::NAN])),
            "inertia_pose_deg[1]"
        );
        let far = Some(vec![0.0, 0.0, 0.0, 0.0, 0.0, -721.0]);
        assert_eq!(refused(|c| c.assumed_pose_deg = far), "assumed_pose_deg[5]");
    }

    #[test]
    fn gains_come_from_the_mass_matrix_unless_given() {
        let robot = Robot::puma260();
        let gains = Config::default().tuning(&robot).unwrap().gains();
        for joint in 0..6 {
            let inertia = gains.kp_nm_rad[joint] / 3600.0;
            assert!(
                inertia > robot.dynamics.reflected_inertia_kg_m2[joint],
                "joint {joint}: {inertia}"
            );
            let kd = gains.kd_nms_rad[joint];
            assert!((kd - 120.0 * inertia).abs() < 1e-12 * kd);
        }
        let given = Config {
            kp_nm_rad: Some(vec![7.0; 6]),
            inertia_kg_m2: Some(vec![2.0; 6]),
            ..Config::default()
        };
        let gains = given.tuning(&robot).unwrap().gains();
        assert_eq!(gains.kp_nm_rad, JointVector::<6>::repeat(7.0));
        assert_eq!(gains.kd_nms_rad, JointVector::<6>::repeat(240.0));
        type Set = fn(&mut Config, Vec<f64>);
        let lists: [(&str, Set); 7] = [
            ("bandwidth_rad_s", |c, x| c.bandwidth_rad_s = Some(x)),
            ("damping", |c, x| c.damping = Some(x)),
            ("inertia_kg_m2", |c, x| c.inertia_kg_m2 = Some(x)),
            ("inertia_pose_deg", |c, x| c.inertia_pose_deg = Some(x)),
            ("kp_nm_rad", |c, x| c.kp_nm_rad = Some(x)),
            ("kd_nms_rad", |c, x| c.kd_nms_rad = Some(x)),
            ("assumed_pose_deg", |c, x| c.assumed_pose_deg = Some(x)),
        ];
        for (place, set) in lists {
            for length in [0, 5, 7] {
                let mut config = Config::default();
                set(&mut config, vec![1.0; length]);
                assert_eq!(config.tuning(&robot).unwrap_err().place, place, "{length}");
            }
        }
    }
}
