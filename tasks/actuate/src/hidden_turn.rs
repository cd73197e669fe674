//! Detects encoders that do not count by the load on the pad that turns: a motor that turns the
//! finger about the sensor's normal turns a long load on the pad the other way. Where the load has
//! turned, the encoders say nothing of it, and the torque of a motor that does not count points to
//! where the finger must have turned, its encoder is dead.
//!
//! A motor whose axis is far from the fingertip takes it along, off what it touches: only those
//! whose axis passes near it are looked at.
//!
//! What is touched may turn itself, by a hand or by a table, while friction holds the motor. A law
//! that follows it then asks for a torque to the same side, and the load turns to that side, too: a
//! dead encoder shows the opposite. The torque may therefore be smaller than in
//! [`crate::hidden_motion`], where it alone has to tell that the motor must have moved.

use core::f64::consts::{FRAC_PI_2, PI};

use taktil_mechanics::arm::Arm;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::Transmission;

use crate::hidden_motion::{FLICKER_COUNTS, Reading, ToolPose, Touch};
use crate::runaway::Load;
use crate::stuck_encoder::LEVER_MAX_M;

/// Torque that points to a side, over what friction and the error of gravity may take: a third is
/// half of the model's friction.
const PULL_SHARE_MIN: f64 = 0.33;
/// Smallest turn of the load on the pad that is one (rad).
const TURN_MIN_RAD: f64 = 0.09;
/// The smoothed turn must be so many times what the load's direction changes by from one image to
/// the next, on the mean of some images: six standard deviations.
const NOISE_FACTOR: f64 = 3.0;
/// Share that an image has in that mean.
const NOISE_SHARE: f64 = 0.05;
/// Largest such change of a load that has a direction (rad): that of a round one is any.
const NOISE_MAX_RAD: f64 = 0.15;
/// What it is taken for until there are images (rad).
const NOISE_INITIAL_RAD: f64 = 0.4;
/// Number of images in a row that have to tell of a turn.
const CONFIRMING_IMAGES: u32 = 4;
/// Time constant by which the load's direction is smoothed (s): four images.
const DIRECTION_FILTER_S: f64 = 0.02;
/// For how long a contact has to last (s): until then the load finds its place on the pad.
const CONTACT_SETTLED_S: f64 = 0.3;
/// Time within which the load has to turn (s): what is touched may turn slowly by itself.
const TURN_WITHIN_S: f64 = 0.5;
/// Share of a motor's turn of the finger that has to be about the sensor's normal.
const NORMAL_SHARE_MIN: f64 = 0.7;
/// Turn of a joint by which the motion of the tool is found (rad), in the direction of these counts
/// of a motor.
const PROBE_RAD: f64 = 1e-3;
const PROBE_COUNTS: i32 = 1000;

/// A motor since its encoder counted last, its torque changed its side, or some time has passed.
#[derive(Clone, Copy, Debug)]
struct Standing<const N: usize> {
    place: i32,
    /// Joint angles at that time (rad).
    q_rad: [f64; N],
    /// Direction of the load on the pad at that time (rad).
    yaw_rad: f64,
    /// Side to which the torque points.
    side: f64,
    stood_s: f64,
    /// Images in a row that have told of its turn.
    images: u32,
}

/// The direction of a long load on the pad, followed over turns of any size.
#[derive(Clone, Copy, Debug, Default)]
struct LoadDirection {
    /// For how long it has been known (s).
    known_s: f64,
    /// Last image (rad, between plus and minus a quarter turn).
    image_rad: f64,
    /// Continuous direction, and the same smoothed (rad).
    followed_rad: f64,
    smooth_rad: f64,
    /// Mean change from one image to the next (rad).
    noise_rad: f64,
}

impl LoadDirection {
    /// Takes a reading; true with a new image.
    fn update(&mut self, yaw_rad: f64, after_s: f64) -> bool {
        if self.known_s == 0.0 {
            *self = LoadDirection {
                known_s: after_s,
                image_rad: yaw_rad,
                followed_rad: yaw_rad,
                smooth_rad: yaw_rad,
                noise_rad: NOISE_INITIAL_RAD,
            };
            return true;
        }
        self.known_s += after_s;
        let is_new = yaw_rad != self.image_rad;
        if is_new {
            // A load looks the same after half a turn.
            let change = (yaw_rad - self.image_rad + FRAC_PI_2).rem_euclid(PI) - FRAC_PI_2;
            self.image_rad = yaw_rad;
            self.followed_rad += change;
            self.noise_rad += NOISE_SHARE * (change.abs() - self.noise_rad);
        }
        let part = (after_s / DIRECTION_FILTER_S).min(1.0);
        self.smooth_rad += part * (self.followed_rad - self.smooth_rad);
        is_new
    }
}

/// The detector with its memory, which is no part of the digest of a run: it follows from values
/// that are.
#[derive(Debug)]
pub struct HiddenTurnDetector<const N: usize = 6> {
    tool_pose: ToolPose<N>,
    gears: Transmission<N>,
    motors: [Option<Standing<N>>; N],
    load: LoadDirection,
}

impl<const N: usize> HiddenTurnDetector<N> {
    /// A detector that has seen nothing, of an arm with these gears.
    #[must_use]
    pub fn new<A: Arm<N>>(arm: &A, gears: &Transmission<N>) -> HiddenTurnDetector<N> {
        HiddenTurnDetector {
            tool_pose: ToolPose::new(arm),
            gears: *gears,
            motors: [None; N],
            load: LoadDirection::default(),
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        self.motors = [None; N];
        self.load.known_s = 0.0;
    }

    /// Takes a reading under a load of the motors. The first motor that has turned the finger and
    /// has not counted is returned, 0 the first.
    pub fn update(&mut self, reading: &Reading<'_, N>, load: &Load<N>) -> Option<usize> {
        let Touch::Contact { yaw_rad: Some(yaw_rad), .. } = reading.touch else {
            self.reset();
            return None;
        };
        let is_new_image = self.load.update(yaw_rad, reading.after_s);
        let is_settled =
            self.load.known_s >= CONTACT_SETTLED_S && self.load.noise_rad <= NOISE_MAX_RAD;
        if !(reading.calibrated && is_settled) {
            self.motors = [None; N];
            return None;
        }
        let turn_min = TURN_MIN_RAD.max(NOISE_FACTOR * self.load.noise_rad);
        let mut found = None;
        for i in 0..N {
            let share = load.pull_share(i, reading.torque_nm[i]);
            if share.abs() < PULL_SHARE_MIN {
                self.motors[i] = None;
                continue;
            }
            let anew = Standing {
                place: reading.counts[i],
                q_rad: *reading.q_rad,
                yaw_rad: self.load.smooth_rad,
                side: share.signum(),
                stood_s: 0.0,
                images: 0,
            };
            let mut motor = self.motors[i].unwrap_or(anew);
            let moved = reading.counts[i].wrapping_sub(motor.place);
            let counted = !(-FLICKER_COUNTS..=FLICKER_COUNTS).contains(&moved);
            motor.stood_s += reading.after_s;
            if counted || motor.side != anew.side || motor.stood_s > TURN_WITHIN_S {
                motor = anew;
            }
            let turned_rad = self.load.smooth_rad - motor.yaw_rad;
            if turned_rad.abs() < turn_min {
                motor.images = 0;
            } else if is_new_image {
                let hidden_rad = self.hidden_turn_rad(i, &motor, reading.q_rad);
                motor.images = if hidden_rad >= turn_min { motor.images + 1 } else { 0 };
            }
            if motor.images >= CONFIRMING_IMAGES {
                found = found.or(Some(i));
            }
            self.motors[i] = Some(motor);
        }
        found
    }

    /// By how much the finger has turned about the sensor's normal beyond what the encoders say
    /// (rad), positive to the side to which the torque of motor `i` turns it; 0 where that motor
    /// turns it about other axes, or takes it along.
    fn hidden_turn_rad(&self, i: usize, motor: &Standing<N>, q_rad: &[f64; N]) -> f64 {
        let now = JointVector::from(*q_rad);
        let tool = (self.tool_pose.0)(&now);
        let before = (self.tool_pose.0)(&JointVector::from(motor.q_rad));
        let mut counts = [0; N];
        counts[i] = PROBE_COUNTS;
        let joints = self.gears.joints(&counts);
        let probe = joints * (motor.side * PROBE_RAD / joints.amax().max(f64::MIN_POSITIVE));
        let turned = (self.tool_pose.0)(&(now + probe));
        // A small rotation's vector is the antisymmetric part of its matrix.
        let small = tool.rotation.transpose() * turned.rotation;
        let (about_x, about_y, about_z) = (
            small.y_axis.z - small.z_axis.y,
            small.z_axis.x - small.x_axis.z,
            small.x_axis.y - small.y_axis.x,
        );
        let all = (about_x * about_x + about_y * about_y + about_z * about_z).sqrt();
        let lever_m = (turned.translation - tool.translation).length() / PROBE_RAD;
        if about_z.abs() < NORMAL_SHARE_MIN * all || lever_m > LEVER_MAX_M {
            return 0.0;
        }
        // The turn about the normal of a rotation that may have others.
        let since = before.rotation.transpose() * tool.rotation;
        let by_encoders_rad =
            libm::atan2(since.x_axis.y - since.y_axis.x, since.x_axis.x + since.y_axis.y);
        let on_pad_rad = self.load.smooth_rad - motor.yaw_rad;
        (-on_pad_rad - by_encoders_rad) * about_z.signum()
    }
}

#[cfg(test)]
mod tests;
