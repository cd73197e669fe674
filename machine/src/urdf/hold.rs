//! Joints that are held: each becomes fixed where it stays, so that what is behind it is welded to
//! what is before it.

use std::collections::BTreeSet;

use glam::{DMat3, DVec3};
use taktil_mechanics::Pose;
use taktil_rtcore::Invalid;

use super::document::{Document, Joint, JointType};
use super::tree::Tree;
use super::{HeldJoint, Selection};

/// How far outside its limits a joint may be held, for the rounding of files (rad or m).
const LIMIT_TOLERANCE: f64 = 1e-6;
/// Joints that follow each other in a row.
const MIMIC_DEPTH_MAX: usize = 16;

/// Where joints stay: one place for each joint of the file, `None` where it moves or is fixed.
pub(super) struct Holder {
    places: Vec<Option<f64>>,
}

impl Holder {
    /// Finds which joints are held, and where.
    ///
    /// # Errors
    /// Joints that are not there, places that are none or outside the limits, a tree without the
    /// tip.
    pub(super) fn new(robot: &Document, selection: &Selection) -> Result<Holder, Invalid> {
        let mut places = vec![None; robot.joints.len()];
        for (name, at) in &selection.hold {
            let Some(index) = robot.joints.iter().position(|joint| joint.name == *name) else {
                let what = format!("there is no joint `{name}` to hold");
                let remedy = "name joints as the file does; `taktil arm` shows them";
                return Err(Invalid::new("", what, remedy));
            };
            check_place(&robot.joints[index], *at)?;
            places[index] = Some(*at);
        }
        let mut holder = Holder { places };
        if selection.hold_others {
            holder.hold_others(robot, selection)?;
        }
        Ok(holder)
    }

    /// Holds what is not on the way to the tip and is not held yet.
    fn hold_others(&mut self, robot: &Document, selection: &Selection) -> Result<(), Invalid> {
        let tree = Tree::new(robot)?;
        let tip = tree.tip(selection.tip.as_deref())?;
        let way: BTreeSet<&str> =
            tree.joints_to(tip).into_iter().map(|joint| joint.name.as_str()).collect();
        let others =
            |joint: &Joint| joint.kind != JointType::Fixed && !way.contains(joint.name.as_str());
        let places: Vec<Option<f64>> = (0..robot.joints.len())
            .map(|index| {
                let joint = &robot.joints[index];
                self.places[index]
                    .or_else(|| others(joint).then(|| self.place(robot, index, MIMIC_DEPTH_MAX)))
            })
            .collect();
        self.places = places;
        Ok(())
    }

    /// Where a joint stays that nothing names: with the joint that it follows, if that is held, and
    /// else as near to zero as its limits let it.
    fn place(&self, robot: &Document, index: usize, depth: usize) -> f64 {
        if let Some(at) = self.places[index] {
            return at;
        }
        let joint = &robot.joints[index];
        let [lower, upper] = joint.limit.range.unwrap_or([0.0, 0.0]);
        let nearest = 0_f64.clamp(lower, upper);
        let Some(mimic) = joint.mimic.as_ref().filter(|_| depth > 0) else { return nearest };
        let leader = robot.joints.iter().position(|joint| joint.name == mimic.joint);
        leader.map_or(nearest, |leader| {
            let at = mimic.multiplier * self.place(robot, leader, depth - 1) + mimic.offset;
            if at.is_finite() { at } else { nearest }
        })
    }

    /// Makes them fixed.
    pub(super) fn hold(self, robot: &mut Document) -> Vec<HeldJoint> {
        let mut held = Vec::new();
        for (joint, at) in robot.joints.iter_mut().zip(self.places) {
            let Some(at) = at else { continue };
            joint.origin = joint.origin.compose(&displacement(joint, at));
            joint.kind = JointType::Fixed;
            held.push(HeldJoint { name: joint.name.clone(), at });
        }
        held
    }
}

/// That a joint can be held at this place.
fn check_place(joint: &Joint, at: f64) -> Result<(), Invalid> {
    let refuse = |what: String, remedy: &str| Err(Invalid::new(&joint.name, what, remedy));
    if !at.is_finite() {
        return refuse(format!("is held at {at}"), "give a number of radians or metres");
    }
    let moves_by_axis = !matches!(joint.kind, JointType::Fixed | JointType::Several);
    if moves_by_axis && at != 0.0 && joint.axis.try_normalize().is_none() {
        return refuse("the axis needs a direction".to_owned(), "give <axis xyz>, or hold it at 0");
    }
    match joint.kind {
        JointType::Fixed if at != 0.0 => {
            refuse(format!("is fixed, and is to be held at {at}"), "leave it out of `hold`")
        }
        JointType::Several if at != 0.0 => refuse(
            format!("moves in several directions, and is to be held at {at}"),
            "it can be held at 0",
        ),
        JointType::Revolute | JointType::Prismatic => match joint.limit.range {
            Some([lower, upper])
                if !(lower - LIMIT_TOLERANCE..=upper + LIMIT_TOLERANCE).contains(&at) =>
            {
                let what = format!("is to be held at {at}, outside its limits");
                refuse(what, &format!("give {lower} to {upper}, in rad or m"))
            }
            _ => Ok(()),
        },
        _ => Ok(()),
    }
}

/// The displacement of a joint's frame by its own motion (rad or m).
fn displacement(joint: &Joint, at: f64) -> Pose {
    let axis = joint.axis.normalize_or_zero();
    match joint.kind {
        JointType::Revolute | JointType::Continuous if axis != DVec3::ZERO => {
            Pose::new(DMat3::from_axis_angle(axis, at), DVec3::ZERO)
        }
        JointType::Prismatic => Pose::new(DMat3::IDENTITY, axis * at),
        _ => Pose::IDENTITY,
    }
}
