//! The arm of a machine: the PUMA 260, or a chain from a URDF file with the motors that the machine
//! file's `[arm]` describes. Numbers that neither file gives (gears, counts, currents) are not
//! guessed. Sliding joints and arms with other than 6 or 7 joints are errors, because the tasks
//! cannot drive them. A hand is two or three tips of one file, with three joints each (`hand`)
//! behind a fixed palm or behind an arm of six joints.

mod base;
mod fingertip;
mod hand;
mod section;

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DMat3, DVec3};
use serde::Deserialize;
use taktil_mechanics::Pose;
use taktil_mechanics::arm::{Arm, ArmDynamics};
use taktil_mechanics::chain::{Chain, JointKind};
use taktil_mechanics::friction::Friction;
use taktil_mechanics::hand::{Hand, ThreeFingers, ThreeFingersOnArm};
use taktil_mechanics::robot::{ChainRobot, Robot};
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_rtcore::Invalid;
use taktil_signal::per_joint;

use self::base::placed;
pub use self::fingertip::FingertipConfig;
use self::fingertip::check_mount;
use self::section::{Motors, set_limits};
use crate::source::{FileKind, Located, Source};
use crate::urdf::{self, ArmDescription, Selection};

/// A joint with less inertia than that moves nothing (kg m^2).
const INERTIA_MIN: f64 = 1e-12;

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
        /// Where the arm's base stands in the frame in which tools and tables are placed (mm).
        /// Default 0: that frame is the arm's own.
        pub base_mm: Option<[f64; 3]>,
        /// Turn of the arm's base about the vertical in that frame (deg). Default 0.
        pub base_yaw_deg: Option<f64>,
        /// The fingertip that the arm carries. Default: none, and the arm moves without touch.
        pub fingertip: Option<FingertipConfig>,
        /// Links at the ends of a hand's fingers, whose frames are those of the fingertips' arrays:
        /// two or three, each with three joints of its own, in place of `tip`. Joints that all of
        /// them have before those are the arm's that carries the palm: six, or none.
        #[serde(default)]
        pub tips: Vec<String>,
        /// Joints that do not move, and where they stay (rad, or m for sliding ones, as in the URDF
        /// file): a gripper, a torso. What is behind them is welded there.
        #[serde(default)]
        pub hold: BTreeMap<String, f64>,
        /// Holds all joints beside and behind the chain that `hold` does not name, each as near to
        /// zero as its limits let it: a second arm, legs. Default false: they are errors.
        #[serde(default)]
        pub hold_others: bool,
        /// Lower and upper end of the joints (deg), in place of what the URDF file says.
        pub limits_deg: Option<Vec<[f64; 2]>>,
        /// Largest speeds of the joints (deg/s), in place of what the URDF file says.
        pub speed_deg_s: Option<Vec<f64>>,
        /// Largest torques of the joints (N m), in place of what the URDF file says. Where neither
        /// says one, motor, gear and current alone limit the torque.
        pub effort_nm: Option<Vec<f64>>,
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
    /// A hand of two fingers on a fixed palm.
    TwoFingers(Box<Robot<6, Hand<2, 6>>>),
    /// A hand of three fingers on a fixed palm.
    ThreeFingers(Box<Robot<9, ThreeFingers>>),
    /// A hand of two fingers on an arm of six joints.
    TwoFingersOnArm(Box<Robot<12, Hand<2, 12>>>),
    /// A hand of three fingers on an arm of six joints.
    ThreeFingersOnArm(Box<Robot<15, ThreeFingersOnArm>>),
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
/// of joints; or one expression for the PUMA 260, another one for a chain of any length, and one
/// for a hand of any number of fingers.
#[macro_export]
macro_rules! with_robot {
    (
        $any:expr,
        puma260: $puma:ident => $one:expr,
        chain: $robot:ident => $other:expr,
        hand: $hand:ident => $third:expr
    ) => {
        match $any {
            $crate::robot::AnyRobot::Puma260($puma) => $one,
            $crate::robot::AnyRobot::Six($robot) => $other,
            $crate::robot::AnyRobot::Seven($robot) => $other,
            $crate::robot::AnyRobot::TwoFingers($hand) => $third,
            $crate::robot::AnyRobot::ThreeFingers($hand) => $third,
            $crate::robot::AnyRobot::TwoFingersOnArm($hand) => $third,
            $crate::robot::AnyRobot::ThreeFingersOnArm($hand) => $third,
        }
    };
    ($any:expr, $robot:ident => $what:expr) => {
        $crate::with_robot!($any,
            puma260: $robot => $what, chain: $robot => $what, hand: $robot => $what)
    };
}

impl AnyRobot {
    /// The PUMA 260.
    #[must_use]
    pub fn puma260() -> AnyRobot {
        AnyRobot::Puma260(Box::new(Robot::puma260()))
    }

    /// Whether this is a hand, whose fingertips have arrays.
    #[must_use]
    pub fn is_hand(&self) -> bool {
        with_robot!(self, puma260: _robot => false, chain: _robot => false, hand: _robot => true)
    }

    /// Whether this is the PUMA 260, the only arm whose model has a wrist sensor.
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

    /// Joints (rad) inside the limits that bring the tool to `tool` (base frame), from the home
    /// pose by the shortest steps; none where these do not lead there.
    #[must_use]
    pub fn joints_near_home(&self, tool: &Pose) -> Option<Vec<f64>> {
        with_robot!(self, robot => {
            let q = robot.arm.inverse_kinematics_near(tool, &robot.home_rad)?;
            Some(q.as_slice().to_vec())
        })
    }

    /// The frames of the arm at joint values zero; of a hand those of its first finger, behind
    /// those of the arm that carries it.
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
            chain: robot => frames_of(&robot.arm),
            hand: robot => match robot.arm.carrier() {
                Some(carrier) => frames_of(&carrier.chains()[0]),
                None => frames_of(&robot.arm.fingers()[0]),
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

fn frames_of<const N: usize>(chain: &Chain<N>) -> ArmFrames {
    ArmFrames { joint_origins: chain.joint_origins().to_vec(), tool: *chain.tool() }
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
    let of_file = |bad| ArmError::File(Box::new(urdf::locate(urdf, bad)));
    check_held_names(config, urdf).map_err(|bad| bad.within("arm"))?;
    if !config.tips.is_empty() {
        return hand::build(config, urdf, &of_file).map_err(|bad| bad.within("arm"));
    }
    check_mount(config, urdf).map_err(|bad| bad.within("arm"))?;
    let mut described = urdf::read(&urdf.text, &config.selection()).map_err(of_file)?;
    if let Some(fingertip) = &config.fingertip {
        let mount = fingertip.pose().map_err(|bad| bad.within("arm.fingertip"));
        described.tool = described.tool.compose(&mount.map_err(ArmError::Section)?);
    }
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
    robot.map_err(|bad| bad.within("arm"))
}

/// What is remarkable about the arm of a machine file: what of it is held, and what its URDF file
/// does not say and the section does not give, a line each. Nothing about files that [`build`]
/// refuses.
#[must_use]
pub fn remarks(config: &ArmConfig, urdf: &Source) -> Vec<String> {
    if !config.tips.is_empty() {
        return Vec::new();
    }
    let Ok(mut described) = urdf::read(&urdf.text, &config.selection()) else {
        return Vec::new();
    };
    for lacks in &mut described.lacks {
        lacks.range &= config.limits_deg.is_none();
        lacks.speed &= config.speed_deg_s.is_none();
        lacks.effort &= config.effort_nm.is_none();
    }
    described.massless.clear();
    described.remarks()
}

/// That the file has the joints that the section holds.
fn check_held_names(config: &ArmConfig, urdf: &Source) -> Result<(), ArmError> {
    if config.hold.is_empty() {
        return Ok(());
    }
    let names = urdf::joint_names(&urdf.text)
        .map_err(|bad| ArmError::File(Box::new(urdf::locate(urdf, bad))))?;
    match config.hold.keys().find(|held| !names.contains(held)) {
        None => Ok(()),
        Some(unknown) => {
            let what = format!("`{}` has no joint of this name", config.urdf);
            let remedy = "name joints as the file does; `taktil arm` shows them";
            Err(ArmError::Section(Invalid::new(format!("hold.{unknown}"), what, remedy)))
        }
    }
}

impl ArmConfig {
    /// What of the URDF file is wanted.
    #[must_use]
    pub fn selection(&self) -> Selection {
        let mount = self.fingertip.as_ref().and_then(|fingertip| fingertip.link.clone());
        Selection {
            tip: mount.or_else(|| self.tip.clone()),
            hold: self.hold.clone(),
            hold_others: self.hold_others,
            ..Selection::default()
        }
    }
}

impl ArmError {
    /// The same, in a section of that name.
    fn within(self, section: &str) -> ArmError {
        match self {
            ArmError::Section(bad) => ArmError::Section(bad.within(section)),
            ArmError::File(bad) => ArmError::File(bad),
        }
    }
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
    set_limits::<N>(config, &mut driven).map_err(ArmError::Section)?;
    for (i, joint) in driven.joints.iter_mut().enumerate() {
        joint.reflected_inertia = motors.rotor_kg_m2[i] * motors.gear[i] * motors.gear[i];
    }
    let arm = driven.chain::<N>().map_err(of_file)?;
    let arm = placed(config, &arm).map_err(ArmError::Section)?;
    let robot = driven_robot(config, &motors, arm, &arm.limits().effort_max, &described.names);
    checked_robot(config, robot)
}

/// The robot of an arm that these motors drive; its home is not set yet.
fn driven_robot<const N: usize, A: Arm<N, Dynamics = A>>(
    config: &ArmConfig,
    motors: &Motors<N>,
    arm: A,
    effort_max: &JointVector<N>,
    names: &[String],
) -> Robot<N, A> {
    let gears = Transmission::uncoupled(&motors.gear, &motors.counts);
    let drive = Drive {
        torque_constant_nm_a: motors.constant,
        current_max_a: motors.current,
        dac_bits: config.dac_bits,
    };
    let peak = drive.peak_joint_torque(&gears);
    Robot {
        dynamics: arm,
        torque_max_nm: peak.inf(effort_max),
        arm,
        gears,
        drive,
        friction: Friction { coulomb_nm: motors.coulomb, viscous_nms_rad: motors.viscous },
        home_rad: JointVector::zeros(),
        nominal_rad: JointVector::zeros(),
        joint_names: names.to_vec(),
    }
}

/// The robot at its home pose, where every joint has to move something and to hold itself.
fn checked_robot<const N: usize, A: Arm<N>>(
    config: &ArmConfig,
    mut robot: Robot<N, A>,
) -> Result<Robot<N, A>, ArmError> {
    let home = checked_pose("home_deg", &config.home_deg, &robot).map_err(ArmError::Section)?;
    (robot.home_rad, robot.nominal_rad) = (home, home);
    let inertia = robot.dynamics.mass_matrix(&home);
    if let Some(i) = (0..N).find(|i| inertia[(*i, *i)] <= INERTIA_MIN) {
        let what = format!("{} moves nothing: the URDF file gives no mass", robot.joint_label(i));
        let remedy = "its torque depends on it: give masses there, or rotor_inertia_kg_m2";
        return Err(ArmError::Section(Invalid::new("urdf", what, remedy)));
    }
    let gravity_nm = robot.dynamics.gravity_torque(&home);
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
