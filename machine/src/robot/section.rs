//! The numbers of `[arm]`: limits in place of the URDF file's, and what drives the joints. Lists of
//! another length and numbers that no joint or motor has are errors at their place.

use taktil_hal::CHANNELS;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::Invalid;
use taktil_signal::per_joint;

use super::ArmConfig;
use crate::urdf::{ACCELERATION_TIME_S, ArmDescription};

/// Widest limit of a joint in the machine file (deg).
const LIMIT_MAX_DEG: f64 = 3600.0;
/// Largest number in the table of a motor.
const MOTOR_VALUE_MAX: f64 = 1e6;
/// Largest number of counts in one joint turn: with more, the counts of ten joint turns would not
/// fit 32 bits.
const COUNTS_PER_JOINT_TURN_MAX: f64 = 1e8;

/// Puts the section's limits in place of the file's.
///
/// # Errors
/// Lists of another length, numbers that are no limits, and what neither file says.
pub(super) fn set_limits<const N: usize>(
    config: &ArmConfig,
    described: &mut ArmDescription,
) -> Result<(), Invalid> {
    let label = |i: usize| format!("joint {} (`{}`)", i + 1, described.names[i]);
    let refusal = |place: String, i: usize, what: &str, remedy: &str| {
        Invalid::new(place, format!("{what} for {}", label(i)), remedy)
    };
    let mut joints = described.joints.clone();
    if let Some(limits) = &config.limits_deg {
        if limits.len() != N {
            let what = format!("{} pairs where {N} are needed", limits.len());
            return Err(Invalid::new("limits_deg", what, "give lower and upper of each joint"));
        }
        for (i, [lower, upper]) in limits.iter().enumerate() {
            let sound = |x: &f64| x.abs() <= LIMIT_MAX_DEG;
            if !(sound(lower) && sound(upper) && lower < upper) {
                let (place, what) = (format!("limits_deg[{i}]"), format!("{lower} to {upper}"));
                return Err(refusal(place, i, &what, "give lower and upper, at most 3600 degrees"));
            }
            (joints[i].q_min, joints[i].q_max) = (lower.to_radians(), upper.to_radians());
        }
    }
    let positive = |place: &str, list: &[f64], most: f64| {
        let numbers = per_joint::<N>(place, list)?;
        match numbers.iter().position(|x| !(1e-6..=most).contains(x)) {
            None => Ok(numbers),
            Some(i) => Err(refusal(
                format!("{place}[{i}]"),
                i,
                &numbers[i].to_string(),
                &format!("give a number above 0, at most {most}"),
            )),
        }
    };
    if let Some(speeds) = &config.speed_deg_s {
        let speeds = positive("speed_deg_s", speeds, MOTOR_VALUE_MAX)?;
        for ((joint, speed), lacks) in joints.iter_mut().zip(speeds).zip(&described.lacks) {
            // The time in which a joint gets to its speed stays.
            let time_s = match lacks.speed {
                true => ACCELERATION_TIME_S,
                false => joint.speed_max / joint.acceleration_max,
            };
            joint.speed_max = speed.to_radians();
            joint.acceleration_max = joint.speed_max / time_s;
        }
    }
    if let Some(efforts) = &config.effort_nm {
        for (joint, effort) in joints.iter_mut().zip(positive("effort_nm", efforts, 1e9)?) {
            joint.effort_max = effort;
        }
    }
    for (i, lacks) in described.lacks.iter().enumerate() {
        let what = "the URDF file says none";
        if lacks.range && config.limits_deg.is_none() {
            return Err(refusal(
                "limits_deg".into(),
                i,
                what,
                "give lower and upper of each joint",
            ));
        }
        if lacks.speed && config.speed_deg_s.is_none() {
            return Err(refusal("speed_deg_s".into(), i, what, "give the speed of each joint"));
        }
    }
    described.joints = joints;
    Ok(())
}

/// The checked lists of the section.
pub(super) struct Motors<const N: usize> {
    pub(super) gear: JointVector<N>,
    pub(super) counts: JointVector<N>,
    pub(super) constant: JointVector<N>,
    pub(super) current: JointVector<N>,
    pub(super) rotor_kg_m2: JointVector<N>,
    pub(super) coulomb: JointVector<N>,
    pub(super) viscous: JointVector<N>,
}

impl<const N: usize> Motors<N> {
    pub(super) fn from_config(config: &ArmConfig, names: &[String]) -> Result<Motors<N>, Invalid> {
        const { assert!(N <= CHANNELS, "a board has so many channels") };
        if !(2..=24).contains(&config.dac_bits) {
            let what = format!("{} bits", config.dac_bits);
            return Err(Invalid::new("dac_bits", what, "give 2 to 24"));
        }
        let list = |place: &str, list: &[f64], sound: &dyn Fn(f64) -> bool, remedy: &str| {
            let numbers = per_joint::<N>(place, list)?;
            match numbers.iter().position(|x| !sound(*x)) {
                None => Ok(JointVector::from(numbers)),
                Some(i) => {
                    let what = format!("{} for joint {} (`{}`)", numbers[i], i + 1, names[i]);
                    Err(Invalid::new(format!("{place}[{i}]"), what, remedy))
                }
            }
        };
        let size = |x: f64| (1e-9..=MOTOR_VALUE_MAX).contains(&x);
        let positive = |place: &str, numbers: &[f64]| {
            list(place, numbers, &size, "give a number above 0, at most 1000000")
        };
        let or_none = |place: &str, numbers: &Option<Vec<f64>>| match numbers {
            None => Ok(JointVector::zeros()),
            Some(numbers) => {
                let sound = |x: f64| (0.0..=MOTOR_VALUE_MAX).contains(&x);
                list(place, numbers, &sound, "give 0 or more, at most 1000000")
            }
        };
        let turns = |x: f64| (1e-3..=MOTOR_VALUE_MAX).contains(&x.abs());
        let gear = "give motor turns in one joint turn, negative for a motor that runs backwards";
        let motors = Motors {
            gear: list("gear", &config.gear, &turns, gear)?,
            counts: positive("counts_per_rev", &config.counts_per_rev)?,
            constant: positive("torque_constant_nm_a", &config.torque_constant_nm_a)?,
            current: positive("current_max_a", &config.current_max_a)?,
            rotor_kg_m2: or_none("rotor_inertia_kg_m2", &config.rotor_inertia_kg_m2)?,
            coulomb: or_none("coulomb_nm", &config.coulomb_nm)?,
            viscous: or_none("viscous_nms_rad", &config.viscous_nms_rad)?,
        };
        let counts_per_turn = motors.gear.component_mul(&motors.counts).abs();
        if let Some(i) = (0..N).find(|i| counts_per_turn[*i] > COUNTS_PER_JOINT_TURN_MAX) {
            let what = format!(
                "{} counts in one turn of joint {} (`{}`)",
                counts_per_turn[i],
                i + 1,
                names[i]
            );
            let remedy = "counts of ten turns have to fit 32 bits: give fewer";
            return Err(Invalid::new(format!("counts_per_rev[{i}]"), what, remedy));
        }
        Ok(motors)
    }
}
