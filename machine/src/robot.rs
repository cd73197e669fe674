//! The arm of a machine: the PUMA 260, or a chain from a URDF file with the motors that the machine
//! file's `[arm]` describes. Numbers that neither file gives (gears, counts, currents) are not
//! guessed. Sliding joints and arms with other than 6 or 7 joints are errors, because the tasks
//! cannot drive them.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::Deserialize;
use taktil_mechanics::Pose;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::chain::JointKind;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::robot::{ChainRobot, Robot};
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_rtcore::Invalid;
use taktil_signal::{JOINTS_MAX, per_joint};

use crate::source::{FileKind, Located, Source};
use crate::urdf::{self, ArmDescription};

/// Largest number in the table of a motor.
const MOTOR_VALUE_MAX: f64 = 1e6;
/// Largest number of counts in one joint turn: with more, the counts of ten joint turns would not
/// fit 32 bits.
const COUNTS_PER_JOINT_TURN_MAX: f64 = 1e8;

taktil_rtcore::explained! {
    /// `[arm]`: an arm from a URDF file, and what drives it. Lists have one number for each moving
    /// joint, in the order of the file.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct ArmConfig {
        /// URDF file, relative to the file in which this stands. It gives the kinematics, the
        /// masses, and for each joint the limits of angle, speed, effort and, where it is there,
        /// acceleration.
        pub urdf: String,
        /// Link at the end of the chain, whose frame is the tool's; needed where the file has
        /// several.
        pub tip: Option<String>,
        /// Joint angles of the home pose, where the counts are initialised (deg).
        pub home_deg: Vec<f64>,
        /// Motor turns in one joint turn; negative where the motor runs the other way.
        pub gear: Vec<f64>,
        /// Encoder counts of one motor turn, after quadrature.
        pub counts_per_rev: Vec<f64>,
        /// Torque constants of the motors (N m/A).
        pub torque_constant_nm_a: Vec<f64>,
        /// Currents at the converter's full scale (A).
        pub current_max_a: Vec<f64>,
        /// Width of the converter's code. Default 12.
        #[serde(default = "default_dac_bits")]
        pub dac_bits: u32,
        /// Inertia of the rotors (kg m^2). Default 0: what the URDF says is all.
        pub rotor_inertia_kg_m2: Option<Vec<f64>>,
        /// Coulomb friction at the joints (N m): what the servo may compensate and the simulator
        /// does. Default 0.
        pub coulomb_nm: Option<Vec<f64>>,
        /// Viscous friction at the joints (N m s/rad). Default 0.
        pub viscous_nms_rad: Option<Vec<f64>>,
    }
}

fn default_dac_bits() -> u32 {
    12
}

/// An arm that the tasks can drive.
#[derive(Clone, Debug)]
pub enum AnyRobot {
    /// The PUMA 260 of the reference.
    Puma260(Box<Robot>),
    /// A chain of six joints.
    Six(Box<ChainRobot<6>>),
    /// A chain of seven joints.
    Seven(Box<ChainRobot<7>>),
}

/// The frames of an arm at joint values zero: all that a drawing of it needs.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmFrames {
    /// The pose of each joint's frame, whose z axis is the axis of the joint, in the frame of the
    /// joint before it, or in the base frame for the first joint (m).
    pub joint_origins: Vec<Pose>,
    /// The pose of the tool in the frame of the last joint (m).
    pub tool: Pose,
}

/// Evaluates one expression with the robot of an [`AnyRobot`], whose type then has a known number
/// of joints; or one expression for the PUMA 260 and another one for a chain of any length.
#[macro_export]
macro_rules! with_robot {
    ($any:expr, puma260: $puma:ident => $one:expr, chain: $robot:ident => $other:expr) => {
        match $any {
            $crate::robot::AnyRobot::Puma260($puma) => $one,
            $crate::robot::AnyRobot::Six($robot) => $other,
            $crate::robot::AnyRobot::Seven($robot) => $other,
        }
    };
    ($any:expr, $robot:ident => $what:expr) => {
        $crate::with_robot!($any, puma260: $robot => $what, chain: $robot => $what)
    };
}

impl AnyRobot {
    /// The PUMA 260.
    #[must_use]
    pub fn puma260() -> AnyRobot {
        AnyRobot::Puma260(Box::new(Robot::puma260()))
    }

    /// Whether this is the PUMA 260, the only arm with tactile and wrist sensors.
    #[must_use]
    pub fn is_puma260(&self) -> bool {
        matches!(self, AnyRobot::Puma260(_))
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        with_robot!(self, robot => robot.home_rad.len())
    }

    /// The name of a joint, counted from 0.
    #[must_use]
    pub fn joint_label(&self, index: usize) -> String {
        with_robot!(self, robot => robot.joint_label(index))
    }

    /// Joints of the home pose (rad).
    #[must_use]
    pub fn home_rad(&self) -> Vec<f64> {
        with_robot!(self, robot => robot.home_rad.as_slice().to_vec())
    }

    /// Smallest and largest angle of each joint (rad).
    #[must_use]
    pub fn limits_rad(&self) -> Vec<(f64, f64)> {
        with_robot!(self, robot => {
            let (low, high) = (robot.arm.q_min(), robot.arm.q_max());
            low.as_slice().iter().copied().zip(high.as_slice().iter().copied()).collect()
        })
    }

    /// Largest torque of each joint (N m).
    #[must_use]
    pub fn torque_max_nm(&self) -> Vec<f64> {
        with_robot!(self, robot => robot.torque_max_nm.as_slice().to_vec())
    }

    /// The tool frame in the base frame; `None` for another number of joints.
    #[must_use]
    pub fn tool_pose(&self, q: &[f64]) -> Option<Pose> {
        with_robot!(self, robot => Some(robot.arm.tool_pose(&joint_vector(q)?)))
    }

    /// The frames of the arm at joint values zero.
    #[must_use]
    pub fn frames(&self) -> ArmFrames {
        with_robot!(self,
            puma260: robot => {
                let along_approach = robot.arm.tool_z_m * DVec3::Z;
                ArmFrames {
                    joint_origins: robot.arm.joint_origins().to_vec(),
                    tool: Pose::new(DMat3::IDENTITY, along_approach),
                }
            },
            chain: robot => ArmFrames {
                joint_origins: robot.arm.joint_origins().to_vec(),
                tool: *robot.arm.tool(),
            }
        )
    }

    /// Torques that hold the arm against gravity (N m); `None` for another number of joints.
    #[must_use]
    pub fn gravity_nm(&self, q: &[f64]) -> Option<Vec<f64>> {
        with_robot!(self, robot => {
            let torque = robot.dynamics.gravity_torque(&joint_vector(q)?);
            Some(torque.as_slice().to_vec())
        })
    }

    /// Checks that joint angles (deg) are valid for this arm; `place` locates the error.
    ///
    /// # Errors
    /// A wrong number of angles, or an angle outside the limits; the joint is named.
    pub fn check_pose(&self, place: &str, degrees: &[f64]) -> Result<(), Invalid> {
        with_robot!(self, robot => checked_pose(place, degrees, robot).map(|_| ()))
    }
}

fn joint_vector<const N: usize>(q: &[f64]) -> Option<JointVector<N>> {
    <[f64; N]>::try_from(q).ok().map(JointVector::from)
}

/// Joint angles within the limits (rad).
fn checked_pose<const N: usize, A: Arm<N>>(
    place: &str,
    degrees: &[f64],
    robot: &Robot<N, A>,
) -> Result<JointVector<N>, Invalid> {
    let degrees = per_joint::<N>(place, degrees)?;
    let q = JointVector::from(degrees.map(f64::to_radians));
    for i in 0..N {
        let (low, high) = (robot.arm.q_min()[i], robot.arm.q_max()[i]);
        if !(low <= q[i] && q[i] <= high) {
            let what = format!("{} is outside the limits of {}", degrees[i], robot.joint_label(i));
            let remedy =
                format!("give {:.1} to {:.1} degrees", low.to_degrees(), high.to_degrees());
            return Err(Invalid::new(format!("{place}[{i}]"), what, remedy));
        }
    }
    Ok(q)
}

/// The robot of a machine file, from its `[arm]` section and the URDF file that it names.
///
/// # Errors
/// An error in `[arm]`, located there; an error in the URDF file is an [`ArmError::File`].
pub fn build(config: &ArmConfig, urdf: &Source) -> Result<AnyRobot, ArmError> {
    let described = urdf::read(&urdf.text, config.tip.as_deref())
        .map_err(|bad| ArmError::File(Box::new(urdf::locate(urdf, bad))))?;
    let of_file = |bad| ArmError::File(Box::new(urdf::locate(urdf, bad)));
    for (name, joint) in described.names.iter().zip(&described.joints) {
        if joint.kind == JointKind::Prismatic {
            let what = "slides: the tasks drive turning joints";
            return Err(of_file(Invalid::new(name, what, "fix it, or name a tip before it")));
        }
    }
    let robot = match described.joints.len() {
        6 => chain::<6>(config, &described, &of_file).map(|robot| AnyRobot::Six(Box::new(robot))),
        7 => chain::<7>(config, &described, &of_file).map(|robot| AnyRobot::Seven(Box::new(robot))),
        n => {
            let what = format!("has {n} moving joints on the way to `{}`", described.tip);
            let remedy = "the tasks drive arms of 6 and of 7 joints: name another tip or arm";
            return Err(of_file(Invalid::new("", what, remedy)));
        }
    };
    robot.map_err(|bad| match bad {
        ArmError::Section(bad) => ArmError::Section(bad.within("arm")),
        ArmError::File(bad) => ArmError::File(bad),
    })
}

/// An error of an arm: in its section, or in its file.
#[derive(Clone, Debug)]
pub enum ArmError {
    /// The place is within the machine file.
    Section(Invalid),
    /// Located in the URDF.
    File(Box<Located>),
}

fn chain<const N: usize>(
    config: &ArmConfig,
    described: &ArmDescription,
    of_file: &dyn Fn(Invalid) -> ArmError,
) -> Result<ChainRobot<N>, ArmError> {
    let motors = Motors::<N>::from_config(config, &described.names).map_err(ArmError::Section)?;
    let mut driven = described.clone();
    for (i, joint) in driven.joints.iter_mut().enumerate() {
        joint.reflected_inertia = motors.rotor_kg_m2[i] * motors.gear[i] * motors.gear[i];
    }
    let arm = driven.chain::<N>().map_err(of_file)?;
    let gears = Transmission::uncoupled(&motors.gear, &motors.counts);
    let drive = Drive {
        torque_constant_nm_a: motors.constant,
        current_max_a: motors.current,
        dac_bits: config.dac_bits,
    };
    let peak = drive.peak_joint_torque(&gears);
    let mut robot = Robot {
        dynamics: arm,
        torque_max_nm: peak.inf(&arm.limits().effort_max),
        arm,
        gears,
        drive,
        friction: Friction { coulomb_nm: motors.coulomb, viscous_nms_rad: motors.viscous },
        home_rad: JointVector::zeros(),
        nominal_rad: JointVector::zeros(),
        joint_names: described.names.clone(),
    };
    let home = checked_pose("home_deg", &config.home_deg, &robot).map_err(ArmError::Section)?;
    (robot.home_rad, robot.nominal_rad) = (home, home);
    let gravity_nm = arm.gravity_torque(&home);
    if let Some(i) = (0..N).find(|i| gravity_nm[*i].abs() > robot.torque_max_nm[*i]) {
        let what = format!(
            "{} cannot hold itself at home: gravity asks for {:.2} N m, it has {:.2}",
            robot.joint_label(i),
            gravity_nm[i].abs(),
            robot.torque_max_nm[i]
        );
        let remedy = "look at its mass, effort, gear, torque constant and current";
        return Err(ArmError::Section(Invalid::new(format!("current_max_a[{i}]"), what, remedy)));
    }
    Ok(robot)
}

/// The checked lists of the section.
struct Motors<const N: usize> {
    gear: JointVector<N>,
    counts: JointVector<N>,
    constant: JointVector<N>,
    current: JointVector<N>,
    rotor_kg_m2: JointVector<N>,
    coulomb: JointVector<N>,
    viscous: JointVector<N>,
}

impl<const N: usize> Motors<N> {
    fn from_config(config: &ArmConfig, names: &[String]) -> Result<Motors<N>, Invalid> {
        const { assert!(N <= JOINTS_MAX, "the signals carry eight joints") };
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

/// Reads the robot of a machine file in the folder `folder`; also returns the text of its URDF
/// file.
///
/// # Errors
/// As [`build`], and a file that does not exist.
pub fn load(
    config: Option<&ArmConfig>,
    folder: &Path,
) -> Result<(AnyRobot, Option<Source>), ArmError> {
    let Some(config) = config else { return Ok((AnyRobot::puma260(), None)) };
    let source = Source::read(&folder.join(&config.urdf), FileKind::Arm)
        .map_err(|bad| ArmError::Section(Invalid::new("arm.urdf", bad.what, bad.remedy)))?;
    build(config, &source).map(|robot| (robot, Some(source)))
}
