//! A hand from one URDF file: two or three tips on one base, with three turning joints before each.
//! Lists of the machine file have one number for each joint, finger by finger in the order of the
//! tips. A tip with another number of joints is an error.

use taktil_mechanics::chain::{Chain, JointKind};
use taktil_mechanics::hand::{FINGER_JOINTS, Hand};
use taktil_mechanics::robot::Robot;
use taktil_rtcore::Invalid;

use super::section::{Motors, set_limits};
use super::{AnyRobot, ArmConfig, ArmError, checked_robot, driven_robot};
use crate::source::Source;
use crate::urdf::{self, ArmDescription, Selection};

/// The hand of a machine file whose `[arm]` names tips.
///
/// # Errors
/// Another number of tips than two or three, a tip beside them, and what makes a finger unusable.
pub(super) fn build(
    config: &ArmConfig,
    urdf: &Source,
    of_file: &dyn Fn(Invalid) -> ArmError,
) -> Result<AnyRobot, ArmError> {
    if config.tip.is_some() {
        let what = "stands beside `tips`";
        let remedy = "name one tip of an arm, or the tips of a hand";
        return Err(ArmError::Section(Invalid::new("tip", what, remedy)));
    }
    let fingers = config
        .tips
        .iter()
        .enumerate()
        .map(|(place, tip)| finger(config, urdf, place, tip, of_file))
        .collect::<Result<Vec<_>, _>>()?;
    match fingers.len() {
        2 => Ok(AnyRobot::TwoFingers(Box::new(hand::<2, 6>(config, &fingers, of_file)?))),
        3 => Ok(AnyRobot::ThreeFingers(Box::new(hand::<3, 9>(config, &fingers, of_file)?))),
        n => {
            let what = format!("names {n} tips");
            let remedy = "name the tips of two or of three fingers";
            Err(ArmError::Section(Invalid::new("tips", what, remedy)))
        }
    }
}

/// The description of one finger; the others are held.
fn finger(
    config: &ArmConfig,
    urdf: &Source,
    place: usize,
    tip: &str,
    of_file: &dyn Fn(Invalid) -> ArmError,
) -> Result<ArmDescription, ArmError> {
    let selection =
        Selection { tip: Some(tip.to_owned()), hold: config.hold.clone(), hold_others: true };
    let described = urdf::read(&urdf.text, &selection).map_err(of_file)?;
    let slides = |kind: &JointKind| *kind == JointKind::Prismatic;
    let joints = &described.joints;
    if joints.len() != FINGER_JOINTS || joints.iter().any(|joint| slides(&joint.kind)) {
        let what = format!("has {} joints before `{tip}`, or one that slides", joints.len());
        let remedy = "give each finger three turning joints, or name other tips";
        return Err(ArmError::Section(Invalid::new(format!("tips[{place}]"), what, remedy)));
    }
    Ok(described)
}

fn hand<const F: usize, const N: usize>(
    config: &ArmConfig,
    fingers: &[ArmDescription],
    of_file: &dyn Fn(Invalid) -> ArmError,
) -> Result<Robot<N, Hand<F, N>>, ArmError> {
    let Some(first) = fingers.first() else {
        return Err(ArmError::Section(Invalid::new("tips", "is empty", "name tips")));
    };
    let mut whole = ArmDescription {
        names: fingers.iter().flat_map(|finger| finger.names.clone()).collect(),
        joints: fingers.iter().flat_map(|finger| finger.joints.clone()).collect(),
        lacks: fingers.iter().flat_map(|finger| finger.lacks.clone()).collect(),
        ..first.clone()
    };
    let shared = (0..whole.names.len()).find(|i| whole.names[..*i].contains(&whole.names[*i]));
    if let Some(joint) = shared {
        let what = format!("share the joint `{}`", whole.names[joint]);
        let remedy = "name tips whose fingers have no joint in common";
        return Err(ArmError::Section(Invalid::new("tips", what, remedy)));
    }
    let motors = Motors::<N>::from_config(config, &whole.names).map_err(ArmError::Section)?;
    set_limits::<N>(config, &mut whole).map_err(ArmError::Section)?;
    for (i, joint) in whole.joints.iter_mut().enumerate() {
        joint.reflected_inertia = motors.rotor_kg_m2[i] * motors.gear[i] * motors.gear[i];
    }
    let mut chains: Vec<Chain<FINGER_JOINTS>> = Vec::new();
    for (finger, joints) in fingers.iter().zip(whole.joints.chunks_exact(FINGER_JOINTS)) {
        let own = ArmDescription { joints: joints.to_vec(), ..finger.clone() };
        chains.push(own.chain::<FINGER_JOINTS>().map_err(of_file)?);
    }
    let arm = <[Chain<FINGER_JOINTS>; F]>::try_from(chains.as_slice()).ok().and_then(Hand::new);
    let Some(arm) = arm else {
        let what = format!("has {} fingers, not {F}", fingers.len());
        return Err(ArmError::Section(Invalid::new("tips", what, "name as many tips")));
    };
    let effort_max = *arm.effort_max();
    checked_robot(config, driven_robot(config, &motors, arm, &effort_max, &whole.names))
}
