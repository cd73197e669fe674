//! `[start]`: where the arm stands when power comes on, by the place of its finger or by its
//! joints. A place that the arm does not reach is an error.

use glam::{DMat3, DVec3};
use serde::Deserialize;
use taktil_machine::robot::AnyRobot;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::{Pose, rotation_x, rotation_y, rotation_z};
use taktil_rtcore::Invalid;
use taktil_sim::scene::WorldConfig;

use super::Scene;

taktil_rtcore::explained! {
    /// Where the finger stands when power comes on, which is also the home pose in which the counts
    /// are initialised.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub(super) struct Start {
        /// Tool point in the base frame, mm; for an arm with a fingertip.
        pub(super) finger_mm: Option<[f64; 3]>,
        /// Joint angles instead of `finger_mm`, deg, one a joint; for any arm.
        pub(super) joints_deg: Option<Vec<f64>>,
        /// Turn of the finger about y0, deg; along the table's own slope when absent, because touch
        /// cannot feel this angle and someone has to set it. 0 is level; a slope that rises towards
        /// +x0 is a negative turn.
        pitch_deg: Option<f64>,
        /// Turn of the finger about x0, deg. Default 0.
        #[serde(default)]
        roll_deg: f64,
        /// Turn of the finger about z0, deg. Default 0.
        #[serde(default)]
        yaw_deg: f64,
    }
}

impl Scene {
    /// Sets the start pose of the arm.
    pub(super) fn place_arm(&mut self, start: Option<&Start>) -> Result<(), Invalid> {
        let puma = self.robot.is_puma260();
        match start.map(|start| (start, &start.finger_mm, &start.joints_deg)) {
            None if puma => self.start_deg = self.world.arm.home_deg.to_vec(),
            None => {}
            Some((_, None, Some(joints_deg))) => self.start_deg.clone_from(joints_deg),
            Some((start, Some(finger_mm), None)) if puma => {
                self.start_deg = home(start, finger_mm, &self.world)?.to_vec();
            }
            Some((start, Some(finger_mm), None)) if self.machine.has_fingertip() => {
                self.start_deg = posture(start, finger_mm, &self.world, &self.robot)?;
            }
            Some((_, Some(_), None)) => {
                let what = "is a place for a finger, but this arm carries none";
                let remedy = "give joints_deg, one angle a joint, or say in [arm.fingertip] \
                              where on the arm the fingertip is";
                return Err(Invalid::new("start.finger_mm", what, remedy));
            }
            Some(_) => {
                let what = "has not exactly one of finger_mm and joints_deg";
                return Err(Invalid::new("start", what, "give one of them"));
            }
        }
        // Without angles in the section, the scene's own angles hold; the benchmark reads them.
        if start.is_some_and(|start| start.joints_deg.is_some()) {
            self.robot.check_pose("start.joints_deg", &self.start_deg)?;
        }
        if let (true, Ok(six)) = (puma, <[f64; 6]>::try_from(self.start_deg.as_slice())) {
            self.world.arm.home_deg = six;
        }
        Ok(())
    }
}

/// Joint angles (deg) of the start pose, on the branch of the rolling posture of the thesis.
fn home(start: &Start, finger_mm: &[f64; 3], world: &WorldConfig) -> Result<[f64; 6], Invalid> {
    let tool = finger_pose(start, finger_mm, world)?;
    let arm = Puma260::reference();
    let near = Joints::from_row_slice(&WorldConfig::default().arm.home_deg) * (1f64.to_radians());
    let branches = arm.inverse_kinematics(&arm.tool_to_wrist(&tool), Some(&near));
    let (_, q) = arm.nearest_branch(&branches, &near).ok_or_else(|| {
        Invalid::new(
            "start.finger_mm",
            format!("the arm cannot put its finger at {finger_mm:?} mm like this"),
            "the rolling place is about [325, -127, -149]",
        )
    })?;
    let mut deg = [0.0; 6];
    for (out, angle) in deg.iter_mut().zip(q.iter()) {
        *out = angle.to_degrees();
    }
    Ok(deg)
}

/// The pose of the finger at the start (base frame).
fn finger_pose(start: &Start, finger_mm: &[f64; 3], world: &WorldConfig) -> Result<Pose, Invalid> {
    let pitch_deg = start.pitch_deg.unwrap_or(-world.table.tilt_y_deg);
    let all = finger_mm.iter().chain([&pitch_deg, &start.roll_deg, &start.yaw_deg]);
    if all.clone().any(|value| !value.is_finite()) {
        let remedy = "give finite millimetres and degrees";
        return Err(Invalid::new("start", "a number is not finite", remedy));
    }
    let tilt = rotation_z(start.yaw_deg.to_radians())
        * rotation_y(pitch_deg.to_radians())
        * rotation_x(start.roll_deg.to_radians());
    let level = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0));
    Ok(Pose { rotation: tilt * level, translation: DVec3::from_array(*finger_mm) * 1e-3 })
}

/// Joint angles (deg) of the start pose of an arm from a URDF file, nearest to its home pose.
fn posture(
    start: &Start,
    finger_mm: &[f64; 3],
    world: &WorldConfig,
    robot: &AnyRobot,
) -> Result<Vec<f64>, Invalid> {
    let tool = finger_pose(start, finger_mm, world)?;
    let q = robot.joints_near_home(&tool).ok_or_else(|| {
        Invalid::new(
            "start.finger_mm",
            format!("the arm cannot put its fingertip at {finger_mm:?} mm like this"),
            "put the arm's base (arm.base_mm, arm.base_yaw_deg) where it reaches, or choose \
             arm.home_deg near to this posture",
        )
    })?;
    Ok(q.iter().map(|angle| angle.to_degrees()).collect())
}
