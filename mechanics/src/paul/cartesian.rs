//! Paul's Cartesian motion: the tool runs straight lines between poses, rounded at the corners by
//! the same quartic as joint paths; its orientation turns by Paul's two-angle drive or about one
//! axis (Paul 1981, chapter 5). Refuses, at construction, paths it could not follow; whether an arm
//! can is not its question.
//!
//! With Paul's own blend the direction psi of the turn moves at a constant rate through a corner,
//! so that the angular velocity steps by `2 sin(theta/2) dpsi / (2 tau)` where a transition begins
//! and ends. [`Blend::Smooth`] and [`Blend::So3`] do not step.

use glam::{DMat3, DVec3};

use super::drive_transform::{DriveTransform, align_directions};
use super::timing::{PathPhase, Timing, check_counts};
use super::{MAX_POINTS, PathError};
use crate::spatial::{Pose, rotation_from_vector, rotation_vector};

/// How far `R R^T` of a point may be from the identity.
const ROTATION_TOLERANCE: f64 = 1e-6;

/// How the orientation passes a corner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blend {
    /// As published: psi moves linearly through the transition; the angular velocity steps.
    Paul,
    /// psi moves with `h^3 (10 - 15 h + 6 h^2)`: no step.
    #[default]
    Smooth,
    /// Rotation vectors before and after the corner fade out and in; segments turn about one axis.
    /// Twice continuously differentiable, and it never turns further than needed.
    So3,
}

/// A setpoint of the tool, all in the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSetpoint {
    /// Where the tool is to be.
    pub pose: Pose,
    /// Velocity of its origin (m/s).
    pub velocity_m_s: DVec3,
    /// Its angular velocity (rad/s).
    pub angular_rad_s: DVec3,
}

impl PoseSetpoint {
    /// At rest at `pose`.
    #[must_use]
    pub fn rest(pose: &Pose) -> PoseSetpoint {
        PoseSetpoint { pose: *pose, velocity_m_s: DVec3::ZERO, angular_rad_s: DVec3::ZERO }
    }
}

/// How the orientation goes through one corner, seen from the corner's own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
enum CornerRotation {
    /// psi from where it starts by a sweep; theta and phi before the corner, and after it per tau.
    TwoAngle { psi: f64, sweep: f64, before: DriveTransform, after: DriveTransform },
    /// Rotation vectors to the point tau before the corner and to the one tau after it.
    RotationVectors { before: DVec3, after: DVec3 },
}

/// How the orientation goes along one segment, seen from its first point.
#[derive(Clone, Copy, Debug, PartialEq)]
enum SegmentRotation {
    TwoAngle(DriveTransform),
    RotationVector(DVec3),
}

/// A path of the tool, of fixed size. With one pose it is a rest of two tau.
#[derive(Clone, Debug, PartialEq)]
pub struct CartesianPath {
    points: [Pose; MAX_POINTS],
    corner_rotations: [CornerRotation; MAX_POINTS],
    segment_rotations: [SegmentRotation; MAX_POINTS],
    timing: Timing,
    blend: Blend,
}

/// The quartic of a transition: the parts of the way from before and to after the corner, and
/// their rates (1/s).
struct TransitionBlend {
    fraction: f64,
    weight_after: f64,
    weight_before: f64,
    rate_after: f64,
    rate_before: f64,
}

impl TransitionBlend {
    fn at(since: f64, tau: f64) -> TransitionBlend {
        let h = (since + tau) / (2.0 * tau);
        let part_in = (2.0 - h) * h * h * h;
        let rate_in = (3.0 - 2.0 * h) * h * h / tau;
        TransitionBlend {
            fraction: h,
            weight_after: part_in,
            weight_before: 1.0 - 2.0 * h + part_in,
            rate_after: rate_in,
            rate_before: rate_in - 1.0 / tau,
        }
    }
}

impl CartesianPath {
    /// A path through tool `poses`, segment i taking `t_s[i]` (s), transitions of half time `tau_s`
    /// (s) at every point, rest before the first and after the last.
    ///
    /// # Errors
    /// See [`PathError`]. A segment of no length is allowed: it is a wait or a turn on the spot.
    pub fn new(
        poses: &[Pose],
        t_s: &[f64],
        tau_s: f64,
        blend: Blend,
    ) -> Result<CartesianPath, PathError> {
        check_counts(poses.len(), t_s.len())?;
        let mut path = CartesianPath::rest(&poses[0], tau_s, blend)?;
        for (pose, time_s) in poses[1..].iter().zip(t_s) {
            path.push(pose, *time_s)?;
        }
        Ok(path)
    }

    /// A rest at `pose`, to be laid on from there.
    ///
    /// # Errors
    /// As [`CartesianPath::restart`].
    pub fn rest(pose: &Pose, tau_s: f64, blend: Blend) -> Result<CartesianPath, PathError> {
        let none = CornerRotation::RotationVectors { before: DVec3::ZERO, after: DVec3::ZERO };
        let mut path = CartesianPath {
            points: [Pose::IDENTITY; MAX_POINTS],
            corner_rotations: [none; MAX_POINTS],
            segment_rotations: [SegmentRotation::RotationVector(DVec3::ZERO); MAX_POINTS],
            timing: Timing::new(tau_s)?,
            blend,
        };
        path.restart(pose, tau_s, blend)?;
        Ok(path)
    }

    /// Forgets the path and rests at `pose`, in place.
    ///
    /// # Errors
    /// A pose that is none, a `tau_s` (s) that is not positive.
    pub fn restart(&mut self, pose: &Pose, tau_s: f64, blend: Blend) -> Result<(), PathError> {
        self.timing.restart(tau_s)?;
        self.blend = blend;
        self.set_point(0, pose)?;
        self.corner_rotations[0] = self.corner_rotation(0);
        Ok(())
    }

    /// Goes on to `pose` in `time_s` (s) and ends there, in place: the corner before is laid anew,
    /// now that the way goes on from it.
    ///
    /// # Errors
    /// A full path, a pose that is none, a time that is not positive or leaves no room for two
    /// transitions. The path is spoilt then.
    pub fn push(&mut self, pose: &Pose, time_s: f64) -> Result<(), PathError> {
        let point = self.timing.point_count();
        self.set_point(point, pose)?;
        // Orientations turn by two and a half turns at most, drives and their sweeps together.
        let way = (pose.translation - self.points[point - 1].translation).length().max(16.0);
        self.timing.push(time_s, way)?;
        self.segment_rotations[point - 1] = self.segment_rotation(point - 1);
        self.corner_rotations[point - 1] = self.corner_rotation(point - 1);
        self.corner_rotations[point] = self.corner_rotation(point);
        Ok(())
    }

    fn set_point(&mut self, point: usize, pose: &Pose) -> Result<(), PathError> {
        if !is_rigid_transform(pose) {
            return Err(PathError::InvalidPose { point });
        }
        let full = PathError::TooManyPoints { points: point + 1 };
        *self.points.get_mut(point).ok_or(full)? = *pose;
        Ok(())
    }

    fn segment_rotation(&self, segment: usize) -> SegmentRotation {
        let (from, to) = (&self.points[segment].rotation, &self.points[segment + 1].rotation);
        match self.blend {
            Blend::Paul | Blend::Smooth => {
                SegmentRotation::TwoAngle(DriveTransform::between(from, to))
            }
            Blend::So3 => SegmentRotation::RotationVector(rotation_vector(from, to)),
        }
    }

    fn corner_rotation(&self, corner: usize) -> CornerRotation {
        let tau = self.timing.tau_s();
        let here = &self.points[corner].rotation;
        let share = |segment: usize| tau / self.timing.segment_time_s(segment);
        let (first, last) = (corner == 0, corner + 1 == self.timing.point_count());
        if self.blend == Blend::So3 {
            let before = |segment| {
                let from = &self.points[corner - 1].rotation;
                rotation_vector(from, here) * -share(segment)
            };
            let after = |segment| {
                let to = &self.points[corner + 1].rotation;
                rotation_vector(here, to) * share(segment)
            };
            return CornerRotation::RotationVectors {
                before: if first { DVec3::ZERO } else { before(corner - 1) },
                after: if last { DVec3::ZERO } else { after(corner) },
            };
        }
        let mut before = (!first).then(|| {
            let reached = self.rotation_along(corner - 1, 1.0 - share(corner - 1)).0;
            DriveTransform::between(here, &reached)
        });
        let after =
            (!last).then(|| DriveTransform::between(here, &self.points[corner + 1].rotation));
        let (psi, sweep) = align_directions(before.as_mut(), after.as_ref());
        let mut after = after.unwrap_or_default();
        if !last {
            after.theta *= share(corner);
            after.phi *= share(corner);
        }
        CornerRotation::TwoAngle { psi, sweep, before: before.unwrap_or_default(), after }
    }

    /// Orientation at the part `r` of a segment, and its change over the whole segment as a vector
    /// in the base frame (rad).
    fn rotation_along(&self, segment: usize, r: f64) -> (DMat3, DVec3) {
        let from = &self.points[segment].rotation;
        match &self.segment_rotations[segment] {
            SegmentRotation::TwoAngle(drive) => {
                let now =
                    DriveTransform { psi: drive.psi, theta: drive.theta * r, phi: drive.phi * r };
                let rate = DriveTransform { psi: 0.0, ..*drive };
                (*from * now.rotation(), *from * now.angular_velocity(&rate))
            }
            SegmentRotation::RotationVector(vector) => {
                (*from * rotation_from_vector(*vector * r), *from * *vector)
            }
        }
    }

    /// How long the move takes (s): all segments and two tau.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.timing.duration_s()
    }

    /// When each corner is (s).
    #[must_use]
    pub fn corners_s(&self) -> &[f64] {
        self.timing.corners_s()
    }

    /// The half time of the transitions (s).
    #[must_use]
    pub fn tau_s(&self) -> f64 {
        self.timing.tau_s()
    }

    /// The poses.
    #[must_use]
    pub fn points(&self) -> &[Pose] {
        &self.points[..self.timing.point_count()]
    }

    /// The setpoint at `t_s`: the first pose at rest before the start (NaN counts as before), the
    /// last pose at rest from the end on.
    #[must_use]
    pub fn at(&self, t_s: f64) -> PoseSetpoint {
        match self.timing.phase(t_s) {
            PathPhase::BeforeStart => PoseSetpoint::rest(&self.points[0]),
            PathPhase::AfterEnd => PoseSetpoint::rest(&self.points[self.timing.point_count() - 1]),
            PathPhase::Transition(corner, since) => self.transition(corner, since),
            PathPhase::Segment(corner, since) => self.segment(corner, since),
        }
    }

    fn segment(&self, corner: usize, since: f64) -> PoseSetpoint {
        let time = self.timing.segment_time_s(corner);
        let (rotation, change) = self.rotation_along(corner, since / time);
        let velocity_m_s = self.velocity_after(corner);
        let translation = self.points[corner].translation + velocity_m_s * since;
        PoseSetpoint {
            pose: Pose::new(rotation, translation),
            velocity_m_s,
            angular_rad_s: change / time,
        }
    }

    fn transition(&self, corner: usize, since: f64) -> PoseSetpoint {
        let tau = self.timing.tau_s();
        let fade = TransitionBlend::at(since, tau);
        let here = &self.points[corner];
        let speed_before = if corner == 0 { DVec3::ZERO } else { self.velocity_after(corner - 1) };
        let (before, after) = (speed_before * -tau, self.velocity_after(corner) * tau);
        let (turn, rate) =
            transition_rotation(&self.corner_rotations[corner], &fade, tau, self.blend);
        PoseSetpoint {
            pose: Pose::new(
                here.rotation * turn,
                here.translation + before * fade.weight_before + after * fade.weight_after,
            ),
            velocity_m_s: before * fade.rate_before + after * fade.rate_after,
            angular_rad_s: here.rotation * rate,
        }
    }

    /// Velocity of the segment that starts at a corner (m/s); 0 at the last.
    fn velocity_after(&self, corner: usize) -> DVec3 {
        if corner + 1 >= self.timing.point_count() {
            return DVec3::ZERO;
        }
        let way = self.points[corner + 1].translation - self.points[corner].translation;
        way / self.timing.segment_time_s(corner)
    }
}

/// The turn inside a transition and its angular velocity (rad/s), in the corner's frame.
fn transition_rotation(
    corner: &CornerRotation,
    fade: &TransitionBlend,
    tau: f64,
    blend: Blend,
) -> (DMat3, DVec3) {
    match corner {
        CornerRotation::RotationVectors { before, after } => {
            let out = rotation_from_vector(*before * fade.weight_before);
            let angular = *before * fade.rate_before + out * (*after * fade.rate_after);
            (out * rotation_from_vector(*after * fade.weight_after), angular)
        }
        CornerRotation::TwoAngle { psi, sweep, before, after } => {
            let h = fade.fraction;
            let (part, rate) = match blend {
                Blend::Paul => (h, 0.5 / tau),
                Blend::Smooth | Blend::So3 => {
                    let rest = h * (1.0 - h);
                    (h * h * h * (10.0 - 15.0 * h + 6.0 * h * h), 15.0 * rest * rest / tau)
                }
            };
            let now = DriveTransform {
                psi: psi + sweep * part,
                theta: before.theta * fade.weight_before + after.theta * fade.weight_after,
                phi: before.phi * fade.weight_before + after.phi * fade.weight_after,
            };
            let rates = DriveTransform {
                psi: sweep * rate,
                theta: before.theta * fade.rate_before + after.theta * fade.rate_after,
                phi: before.phi * fade.rate_before + after.phi * fade.rate_after,
            };
            (now.rotation(), now.angular_velocity(&rates))
        }
    }
}

fn is_rigid_transform(pose: &Pose) -> bool {
    let r = pose.rotation;
    let off = r.transpose() * r - DMat3::IDENTITY;
    let small = off.to_cols_array().iter().all(|x| x.abs() <= ROTATION_TOLERANCE);
    pose.is_finite() && small && r.determinant() > 0.0
}
