//! A hand from one URDF file: two or three tips, with three turning joints of its own before each.
//! Joints before those, which all tips share, are those of the arm that carries the palm: six, or
//! none for a palm that stands still. Lists of the machine file have one number for each joint, the
//! arm's first and then finger by finger in the order of the tips. A tip with another number of
//! joints is an error, and so is one whose way leaves the arm elsewhere than the others'.

use std::collections::BTreeSet;

use glam::DVec3;
use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, ChainError, JointKind, JointSpec};
use taktil_mechanics::hand::{CARRIER_JOINTS, FINGER_JOINTS, Hand};
use taktil_mechanics::robot::Robot;
use taktil_rtcore::Invalid;

use super::base::base_place;
use super::section::{Motors, set_limits};
use super::{AnyRobot, ArmConfig, ArmError, checked_robot, driven_robot};
use crate::source::Source;
use crate::urdf::{self, ArmDescription, Selection};

/// What a hand is built from.
struct Sections<'a> {
    config: &'a ArmConfig,
    urdf: &'a Source,
    of_file: &'a dyn Fn(Invalid) -> ArmError,
}

/// The hand of a machine file whose `[arm]` names tips.
///
/// # Errors
/// Another number of tips than two or three; a tip or a fingertip beside them; a place of the base
/// where the palm stands still; joints that make no hand; what makes a finger unusable.
pub(super) fn build(
    config: &ArmConfig,
    urdf: &Source,
    of_file: &dyn Fn(Invalid) -> ArmError,
) -> Result<AnyRobot, ArmError> {
    let refuse = |place: &str, what: String, remedy: &str| {
        Err(ArmError::Section(Invalid::new(place, what, remedy)))
    };
    if config.tip.is_some() {
        let remedy = "name one tip of an arm, or the tips of a hand";
        return refuse("tip", "stands beside `tips`".to_owned(), remedy);
    }
    if config.fingertip.is_some() {
        let what = "stands beside `tips`, whose links carry the fingertips of a hand".to_owned();
        return refuse("fingertip", what, "leave it out");
    }
    let ways = Sections { config, urdf, of_file };
    let count = config.tips.len();
    if !(2..=3).contains(&count) {
        let what = format!("names {count} tips");
        return refuse("tips", what, "name the tips of two or of three fingers");
    }
    let fingers = config
        .tips
        .iter()
        .map(|tip| ways.described(tip, BTreeSet::new()))
        .collect::<Result<Vec<_>, _>>()?;
    let shared = shared_joints(config, &fingers).map_err(ArmError::Section)?;
    if shared == CARRIER_JOINTS {
        return Ok(match count {
            2 => AnyRobot::TwoFingersOnArm(Box::new(ways.on_arm::<2, 12>(&fingers)?)),
            _ => AnyRobot::ThreeFingersOnArm(Box::new(ways.on_arm::<3, 15>(&fingers)?)),
        });
    }
    let moved =
        [("base_mm", config.base_mm.is_some()), ("base_yaw_deg", config.base_yaw_deg.is_some())];
    if let Some((key, _)) = moved.into_iter().find(|(_, given)| *given) {
        let what = "stands beside `tips`: the palm of a hand is where its file has it";
        return refuse(key, what.to_owned(), "leave it out");
    }
    Ok(match count {
        2 => AnyRobot::TwoFingers(Box::new(ways.on_palm::<2, 6>(&fingers)?)),
        _ => AnyRobot::ThreeFingers(Box::new(ways.on_palm::<3, 9>(&fingers)?)),
    })
}

/// How many joints all ways to the tips have in common: those of the arm.
///
/// # Errors
/// Ways that part at different joints, an arm of another number of joints than six, fingers of
/// another number than three or with joints that slide.
fn shared_joints(config: &ArmConfig, fingers: &[ArmDescription]) -> Result<usize, Invalid> {
    let Some((first, others)) = fingers.split_first() else { return Ok(0) };
    let common = |a: &ArmDescription, b: &ArmDescription| {
        a.names.iter().zip(&b.names).take_while(|(a, b)| a == b).count()
    };
    let shared = others.first().map_or(0, |second| common(first, second));
    for (i, tip) in others.iter().enumerate() {
        let mut before = fingers.iter().take(i + 1).enumerate();
        if let Some((before, other)) = before.find(|(_, other)| common(other, tip) != shared) {
            let what = format!(
                "parts from the way to `{}` after {} joints, where `{}` and `{}` part after \
                 {shared}",
                config.tips[before],
                common(other, tip),
                config.tips[0],
                config.tips[1],
            );
            let remedy = "name tips of fingers whose ways part at one palm";
            return Err(Invalid::new(format!("tips[{}]", i + 1), what, remedy));
        }
    }
    if shared != 0 && shared != CARRIER_JOINTS {
        let what = format!(
            "share {shared} joints, of which `{}` is the first and `{}` the last",
            first.names[0],
            first.names[shared - 1]
        );
        let remedy = "name tips of fingers on an arm of six joints, or on a palm that stands \
                      still and no joint moves; [arm.hold] holds joints that are too many";
        return Err(Invalid::new("tips", what, remedy));
    }
    let slides = |joint: &JointSpec| joint.kind == JointKind::Prismatic;
    for (place, finger) in fingers.iter().enumerate() {
        let own = finger.joints.len() - shared;
        if own == FINGER_JOINTS && !finger.joints.iter().any(slides) {
            continue;
        }
        let tip = &config.tips[place];
        let what = match shared {
            0 => format!("has {own} joints before `{tip}`, or one that slides"),
            _ => format!("has {own} joints between the arm and `{tip}`, or one that slides"),
        };
        let remedy = "give each finger three turning joints, or name other tips";
        return Err(Invalid::new(format!("tips[{place}]"), what, remedy));
    }
    Ok(shared)
}

impl Sections<'_> {
    /// The description of the way to a link; other joints are held, and those that are left out
    /// carry nothing.
    fn described(
        &self,
        link: &str,
        left_out: BTreeSet<String>,
    ) -> Result<ArmDescription, ArmError> {
        let hold = self.config.hold.clone();
        let selection = Selection { tip: Some(link.to_owned()), hold, hold_others: true, left_out };
        urdf::read(&self.urdf.text, &selection).map_err(self.of_file)
    }

    /// Motors and joints of these descriptions one after the other, with the section's limits.
    fn driven<const N: usize>(
        &self,
        parts: &[&ArmDescription],
    ) -> Result<(Motors<N>, ArmDescription), ArmError> {
        let Some(first) = parts.first() else {
            return Err(ArmError::Section(Invalid::new("tips", "is empty", "name tips")));
        };
        let mut whole = ArmDescription {
            names: parts.iter().flat_map(|part| part.names.clone()).collect(),
            joints: parts.iter().flat_map(|part| part.joints.clone()).collect(),
            lacks: parts.iter().flat_map(|part| part.lacks.clone()).collect(),
            ..(*first).clone()
        };
        let config = self.config;
        let motors = Motors::<N>::from_config(config, &whole.names).map_err(ArmError::Section)?;
        set_limits::<N>(config, &mut whole).map_err(ArmError::Section)?;
        for (i, joint) in whole.joints.iter_mut().enumerate() {
            joint.reflected_inertia = motors.rotor_kg_m2[i] * motors.gear[i] * motors.gear[i];
        }
        Ok((motors, whole))
    }

    /// A hand whose palm stands still.
    fn on_palm<const F: usize, const N: usize>(
        &self,
        fingers: &[ArmDescription],
    ) -> Result<Robot<N, Hand<F, N>>, ArmError> {
        let (motors, whole) = self.driven::<N>(&fingers.iter().collect::<Vec<_>>())?;
        let mut chains: Vec<Chain<FINGER_JOINTS>> = Vec::new();
        for (finger, joints) in fingers.iter().zip(whole.joints.chunks_exact(FINGER_JOINTS)) {
            let own = ArmDescription { joints: joints.to_vec(), ..finger.clone() };
            chains.push(own.chain::<FINGER_JOINTS>().map_err(self.of_file)?);
        }
        let arm = <[Chain<FINGER_JOINTS>; F]>::try_from(chains.as_slice()).ok();
        let arm = arm.and_then(Hand::new).ok_or_else(|| wrong_number(fingers.len()))?;
        self.robot(&motors, arm, &whole)
    }

    /// A hand on an arm of six joints.
    fn on_arm<const F: usize, const N: usize>(
        &self,
        ways: &[ArmDescription],
    ) -> Result<Robot<N, Hand<F, N>>, ArmError> {
        let roots: Vec<&String> = ways.iter().map(|way| &way.names[CARRIER_JOINTS]).collect();
        let all_roots: BTreeSet<String> = roots.iter().map(|root| (*root).clone()).collect();
        let palm = urdf::link_before(&self.urdf.text, roots[0]).map_err(self.of_file)?;
        let palm = palm.unwrap_or_default();
        let arm = self.described(&palm, all_roots)?;
        let fingers = ways.iter().map(|way| finger_behind(&arm.tool, way)).collect::<Vec<_>>();
        let parts: Vec<&ArmDescription> = std::iter::once(&arm).chain(&fingers).collect();
        let (motors, whole) = self.driven::<N>(&parts)?;
        if let Some(unsound) = parts.iter().find_map(|part| part.unsound.first()) {
            return Err((self.of_file)(unsound.clone()));
        }
        let (of_arm, of_fingers) = whole.joints.split_at(CARRIER_JOINTS);
        let arm_joints = <[JointSpec; CARRIER_JOINTS]>::try_from(of_arm);
        let joints: Vec<[JointSpec; FINGER_JOINTS]> = of_fingers
            .chunks_exact(FINGER_JOINTS)
            .filter_map(|joints| joints.try_into().ok())
            .collect();
        let tips: Vec<Pose> = fingers.iter().map(|finger| finger.tool).collect();
        let (Ok(arm_joints), Ok(joints), Ok(tips)) = (
            arm_joints,
            <[[JointSpec; FINGER_JOINTS]; F]>::try_from(joints),
            <[Pose; F]>::try_from(tips),
        ) else {
            return Err(wrong_number(ways.len()));
        };
        let hand = Hand::on_arm(&arm_joints, &arm.tool, &joints, &tips);
        let hand = hand.map_err(|bad: ChainError| {
            let place = whole.names.get(bad.joint).map_or(palm.as_str(), String::as_str);
            (self.of_file)(Invalid::new(place, bad.what, "correct the joint or the link behind it"))
        })?;
        let (base_m, yaw_rad): (DVec3, f64) =
            base_place(self.config).map_err(ArmError::Section)?.unwrap_or_default();
        self.robot(&motors, hand.standing_at(base_m, yaw_rad), &whole)
    }

    fn robot<const F: usize, const N: usize>(
        &self,
        motors: &Motors<N>,
        hand: Hand<F, N>,
        whole: &ArmDescription,
    ) -> Result<Robot<N, Hand<F, N>>, ArmError> {
        let effort_max = *hand.effort_max();
        let robot = driven_robot(self.config, motors, hand, &effort_max, &whole.names);
        checked_robot(self.config, robot)
    }
}

fn wrong_number(fingers: usize) -> ArmError {
    let what = format!("has {fingers} fingers of another number of joints");
    ArmError::Section(Invalid::new("tips", what, "name as many tips as the hand has fingers"))
}

/// The joints of a finger behind the arm, described in the palm's frame, which stands at `palm` in
/// that of the arm's last joint.
fn finger_behind(palm: &Pose, way: &ArmDescription) -> ArmDescription {
    let mut finger = way.clone();
    finger.names.drain(..CARRIER_JOINTS);
    finger.joints.drain(..CARRIER_JOINTS);
    finger.lacks.drain(..CARRIER_JOINTS);
    if let Some(root) = finger.joints.first_mut() {
        root.origin = palm.inverse().compose(&root.origin);
    }
    finger
}
