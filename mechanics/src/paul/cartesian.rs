//! Paul's Cartesian motion: the tool moves along straight lines between poses, rounded at the
//! corners by the same quartic as joint paths. Its orientation rotates by Paul's drive transform or
//! about one axis (Paul 1981, chapter 5). Whether an arm can follow the path is checked elsewhere
//! ([`feasibility`](crate::feasibility)).
//!
//! With Paul's own blend the direction psi of the rotation changes at a constant rate through a
//! corner, so that the angular velocity steps by `2 sin(theta/2) dpsi / (2 tau)` where a transition
//! begins and ends. With [`Blend::Smooth`] and [`Blend::So3`] it is continuous.

use glam::{DMat3, DVec3};

use super::drive_transform::{DriveTransform, align_directions};
use super::timing::{PathPhase, Timing, check_counts};
use super::{MAX_POINTS, PathError};
use crate::spatial::{Pose, rotation_from_vector, rotation_vector};

/// Largest difference of an element of `R^T R` of a point from that of the identity (1).
const ROTATION_TOLERANCE: f64 = 1e-6;

/// The blend of the orientation at a corner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blend {
    /// As published: psi changes linearly through the transition, and the angular velocity steps.
    Paul,
    /// psi changes with `h^3 (10 - 15 h + 6 h^2)`, so that the angular velocity is continuous.
    #[default]
    Smooth,
    /// Rotation vectors before and after the corner are weighted by the quartic, and each segment
    /// rotates about one axis. The orientation is twice continuously differentiable and never
    /// rotates further than needed.
    So3,
}

/// A setpoint of the tool, in the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSetpoint {
    /// Desired pose of the tool frame.
    pub pose: Pose,
    /// Velocity of the origin of the tool frame (m/s).
    pub velocity_m_s: DVec3,
    /// Angular velocity of the tool frame (rad/s).
    pub angular_rad_s: DVec3,
}

impl PoseSetpoint {
    /// The setpoint at rest at `pose`.
    #[must_use]
    pub fn rest(pose: &Pose) -> PoseSetpoint {
        PoseSetpoint { pose: *pose, velocity_m_s: DVec3::ZERO, angular_rad_s: DVec3::ZERO }
    }
}

/// The rotation through the transition at one corner, in the axes of the corner's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
enum CornerRotation {
    /// psi at the start of the transition and its change (rad); the drive transforms to the point
    /// tau before the corner and to the point tau after it.
    TwoAngle { psi: f64, psi_change: f64, before: DriveTransform, after: DriveTransform },
    /// Rotation vectors to the point tau before the corner and to the point tau after it (rad).
    RotationVectors { before: DVec3, after: DVec3 },
}

/// The rotation along one segment, in the axes of its first point.
#[derive(Clone, Copy, Debug, PartialEq)]
enum SegmentRotation {
    TwoAngle(DriveTransform),
    RotationVector(DVec3),
}

/// A path of the tool, of fixed size. With one pose it is a rest that lasts two tau.
#[derive(Clone, Debug, PartialEq)]
pub struct CartesianPath {
    points: [Pose; MAX_POINTS],
    corner_rotations: [CornerRotation; MAX_POINTS],
    segment_rotations: [SegmentRotation; MAX_POINTS],
    timing: Timing,
    blend: Blend,
}

/// The quartic of a transition at one instant: the weights of the displacements to the point before
/// and to the point after the corner, and the rates of the weights (1/s). `fraction` is the elapsed
/// part of the transition, 0 to 1.
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
    /// A path through the tool poses `poses` (base frame), where segment i takes `t_s[i]` (s) and
    /// every pose has a transition of half time `tau_s` (s). The tool rests before the first and
    /// after the last pose.
    ///
    /// # Errors
    /// [`PathError`]. A segment without length is allowed: it is a wait or a rotation on the spot.
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

    /// A path of one pose, at rest at `pose` (base frame), to which poses can be appended.
    ///
    /// # Errors
    /// Those of [`CartesianPath::restart`].
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

    /// Replaces the path in place by a rest at `pose` (base frame).
    ///
    /// # Errors
    /// [`PathError::InvalidPose`], [`PathError::TransitionTime`].
    pub fn restart(&mut self, pose: &Pose, tau_s: f64, blend: Blend) -> Result<(), PathError> {
        self.timing.restart(tau_s)?;
        self.blend = blend;
        self.set_point(0, pose)?;
        self.corner_rotations[0] = self.corner_rotation(0);
        Ok(())
    }

    /// Appends, in place, a segment that reaches `pose` (base frame) after `time_s` (s) and ends
    /// there. The transition at the corner before it is computed again, because the path now goes
    /// on there.
    ///
    /// # Errors
    /// [`PathError`] where the path is full, the pose is not a pose, or the time is not positive or
    /// too short for two transitions. The path must not be used after an error.
    pub fn push(&mut self, pose: &Pose, time_s: f64) -> Result<(), PathError> {
        let point = self.timing.point_count();
        self.set_point(point, pose)?;
        // Below 16 rad, which is more than two and a half turns, lie all angles of an orientation:
        // its drive transform and the change of psi together.
        let distance = (pose.translation - self.points[point - 1].translation).length().max(16.0);
        self.timing.push(time_s, distance)?;
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

    /// The rotation along segment `segment`.
    fn segment_rotation(&self, segment: usize) -> SegmentRotation {
        let (from, to) = (&self.points[segment].rotation, &self.points[segment + 1].rotation);
        match self.blend {
            Blend::Paul | Blend::Smooth => {
                SegmentRotation::TwoAngle(DriveTransform::between(from, to))
            }
            Blend::So3 => SegmentRotation::RotationVector(rotation_vector(from, to)),
        }
    }

    /// The rotation through the transition at corner `corner`.
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
        let (psi, psi_change) = align_directions(before.as_mut(), after.as_ref());
        let mut after = after.unwrap_or_default();
        if !last {
            after.theta *= share(corner);
            after.phi *= share(corner);
        }
        CornerRotation::TwoAngle { psi, psi_change, before: before.unwrap_or_default(), after }
    }

    /// The orientation after the part `r` of a segment, and the change of orientation per whole
    /// segment at that place as a vector in the base frame (rad).
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

    /// Duration of the move (s): all segments and two tau.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.timing.duration_s()
    }

    /// Times of the corners (s).
    #[must_use]
    pub fn corners_s(&self) -> &[f64] {
        self.timing.corners_s()
    }

    /// Half time tau of the transitions (s).
    #[must_use]
    pub fn tau_s(&self) -> f64 {
        self.timing.tau_s()
    }

    /// The poses of the path (base frame).
    #[must_use]
    pub fn points(&self) -> &[Pose] {
        &self.points[..self.timing.point_count()]
    }

    /// The setpoint at `t_s` (s). Before the start, and for NaN, it is the first pose at rest; from
    /// the end on it is the last pose at rest.
    #[must_use]
    pub fn at(&self, t_s: f64) -> PoseSetpoint {
        match self.timing.phase(t_s) {
            PathPhase::BeforeStart => PoseSetpoint::rest(&self.points[0]),
            PathPhase::AfterEnd => PoseSetpoint::rest(&self.points[self.timing.point_count() - 1]),
            PathPhase::Transition(corner, since) => self.transition(corner, since),
            PathPhase::Segment(corner, since) => self.segment(corner, since),
        }
    }

    /// The setpoint on a segment, `since` (s) after the corner where it starts.
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

    /// The setpoint on the transition at a corner, `since` (s) after the corner, from -tau to tau.
    fn transition(&self, corner: usize, since: f64) -> PoseSetpoint {
        let tau = self.timing.tau_s();
        let weights = TransitionBlend::at(since, tau);
        let here = &self.points[corner];
        let speed_before = if corner == 0 { DVec3::ZERO } else { self.velocity_after(corner - 1) };
        let (before, after) = (speed_before * -tau, self.velocity_after(corner) * tau);
        let (turn, rate) =
            transition_rotation(&self.corner_rotations[corner], &weights, tau, self.blend);
        PoseSetpoint {
            pose: Pose::new(
                here.rotation * turn,
                here.translation + before * weights.weight_before + after * weights.weight_after,
            ),
            velocity_m_s: before * weights.rate_before + after * weights.rate_after,
            angular_rad_s: here.rotation * rate,
        }
    }

    /// Velocity of the segment that starts at a corner (m/s); 0 at the last corner.
    fn velocity_after(&self, corner: usize) -> DVec3 {
        if corner + 1 >= self.timing.point_count() {
            return DVec3::ZERO;
        }
        let displacement = self.points[corner + 1].translation - self.points[corner].translation;
        displacement / self.timing.segment_time_s(corner)
    }
}

/// The rotation and the angular velocity (rad/s) inside a transition, in the axes of the corner's
/// frame.
fn transition_rotation(
    corner: &CornerRotation,
    weights: &TransitionBlend,
    tau: f64,
    blend: Blend,
) -> (DMat3, DVec3) {
    match corner {
        CornerRotation::RotationVectors { before, after } => {
            let out = rotation_from_vector(*before * weights.weight_before);
            let angular = *before * weights.rate_before + out * (*after * weights.rate_after);
            (out * rotation_from_vector(*after * weights.weight_after), angular)
        }
        CornerRotation::TwoAngle { psi, psi_change, before, after } => {
            let h = weights.fraction;
            let (part, rate) = match blend {
                Blend::Paul => (h, 0.5 / tau),
                Blend::Smooth | Blend::So3 => {
                    let rest = h * (1.0 - h);
                    (h * h * h * (10.0 - 15.0 * h + 6.0 * h * h), 15.0 * rest * rest / tau)
                }
            };
            let now = DriveTransform {
                psi: psi + psi_change * part,
                theta: before.theta * weights.weight_before + after.theta * weights.weight_after,
                phi: before.phi * weights.weight_before + after.phi * weights.weight_after,
            };
            let rates = DriveTransform {
                psi: psi_change * rate,
                theta: before.theta * weights.rate_before + after.theta * weights.rate_after,
                phi: before.phi * weights.rate_before + after.phi * weights.rate_after,
            };
            (now.rotation(), now.angular_velocity(&rates))
        }
    }
}

/// Whether a pose is finite and its matrix a rotation, within [`ROTATION_TOLERANCE`].
fn is_rigid_transform(pose: &Pose) -> bool {
    let r = pose.rotation;
    let off = r.transpose() * r - DMat3::IDENTITY;
    let small = off.to_cols_array().iter().all(|x| x.abs() <= ROTATION_TOLERANCE);
    pose.is_finite() && small && r.determinant() > 0.0
}
