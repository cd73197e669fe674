//! Motion of the tool under the operator's keys: the fastest step near the commanded one that the
//! joints can follow, and from which they can be braked. The search is bounded: each speed is tried
//! at most [`TRIALS_MAX`] times, and when that is not enough the joints are braked, which needs no
//! trial, and the next job continues from there. The search gives up speed, never the line, a limit
//! or an acceleration.

use glam::DVec3;
use taktil_mechanics::arm::{Arm, FollowError, PathFollower};
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::spatial::rotation_from_vector;
use taktil_mechanics::{Joints, Pose};
use taktil_signal::{JogFrame, JogObstacle};

use super::{DEVIATION_MAX_M, Law, Obstacle, Step, stoppable};

/// Most inverse kinematics for each of the two directions of speed that a job may try: that of the
/// ramp, and that of the last job.
pub(super) const TRIALS_MAX: u32 = 12;
/// Most reductions of the tool's speed for the sake of a joint in one job.
const SLOWDOWNS_MAX: u32 = 8;
/// Factor by which the reduction exceeds the needed one.
const SLOWDOWN_MARGIN: f64 = 1.02;
/// Below this share of its speed the tool stands.
const SPEED_SHARE_MIN: f64 = 1e-6;
/// How often the speed is corrected in one job until the joints' accelerations are those planned.
const REFINEMENTS_MAX: u32 = 4;
/// Share of each joint's largest acceleration with which it is braked before its edge, so that the
/// other joints, which the same tool moves, stay below theirs.
const BRAKE_SHARE: f64 = 0.4;
/// Share of a joint's acceleration that is planned with, because the arm's Jacobian changes within
/// a tick.
const PLANNED_SHARE: f64 = 0.75;

/// Error of the tool point that is allowed in one job, as a share of its way; further the error
/// that a rotation makes at the end of the tool's lever (m), and the error of rounding (m).
const POINT_ERROR_SHARE_MAX: f64 = 0.02;
const LEVER_M: f64 = 0.5;
const ROUNDING_M: f64 = 1e-8;
/// The tool moves only so fast that braking takes it at most [`DEVIATION_MAX_M`] off its line, and
/// at most this share of the braking distance.
const DEVIATION_SHARE_MAX: f64 = 0.02;
/// Least factor by which the tool is slowed down if it would deviate more than that.
const DEVIATION_SLOWDOWN_MIN: f64 = 1.1;
/// Below this share of the commanded speed the obstacle is reported as the reason.
const SLOWED_SPEED_SHARE: f64 = 0.98;

/// A speed of the tool that the arm can follow.
struct FeasibleMotion<const N: usize, F> {
    speed: Joints,
    follower: F,
    /// Speeds of the joints (rad/s).
    qd: JointVector<N>,
}

/// The number of trials that are left for one direction, and the obstacle of the last trial that
/// failed.
struct TrialBudget {
    left: u32,
    obstacle: Option<Obstacle>,
}

impl<const N: usize, A: Arm<N>> Law<N, A> {
    /// Moves the tool at the speed of the ramp or else at the speed that it had `before`, scaled as
    /// the joints' accelerations require.
    pub(super) fn tool(&mut self, before: &Joints, dt_s: f64) -> Step<N> {
        let ramped = self.speed;
        // If the command reverses the motion, the former speed is not continued.
        let along = if *before == Joints::zeros() { 0.0 } else { ramped.dot(before) };
        let share = if along > 0.0 { ramped.norm() / before.norm() } else { 0.0 };
        let (mut obstacle, mut spent) = (None, 0);
        for (speed, wanted) in [(ramped, 1.0), (*before, share)] {
            if speed == Joints::zeros() {
                if self.is_reachable(&JointVector::zeros(), dt_s) {
                    break;
                }
                continue;
            }
            let mut trials = TrialBudget { left: TRIALS_MAX, obstacle: None };
            let able = self.refined_motion(speed, wanted, dt_s, &mut trials);
            spent += TRIALS_MAX - trials.left;
            obstacle = obstacle.or(trials.obstacle);
            if let Some(able) = able {
                (self.speed, self.follower, self.qd) = (able.speed, able.follower, able.qd);
                self.q = *self.follower.joints();
                let slowed = self.speed.dot(&ramped) < SLOWED_SPEED_SHARE * ramped.norm_squared();
                let obstacle = obstacle.filter(|_| slowed);
                return Step { q: self.q, qd: self.qd, obstacle, trials: spent };
            }
        }
        Step { trials: spent, ..self.coast(dt_s, obstacle) }
    }

    /// If the tool can continue in neither direction, all joints are braked by the same share as
    /// fast as they can be; on this last part of the way the tool is not controlled.
    pub(super) fn coast(&mut self, dt_s: f64, obstacle: Option<Obstacle>) -> Step<N> {
        let mut left = 0.0f64;
        for joint in 0..N {
            let change = PLANNED_SHARE * self.arm.acceleration_max()[joint] * dt_s;
            left = left.max(1.0 - change / self.qd[joint].abs().max(change));
        }
        self.qd *= left;
        self.speed *= left;
        if left > 0.0 {
            let ahead = self.q + self.qd * dt_s;
            self.q = ahead.sup(self.arm.q_min()).inf(self.arm.q_max());
            self.follower = self.arm.follower(&self.q);
        } else {
            self.speed = Joints::zeros();
        }
        Step { q: self.q, qd: self.qd, obstacle, trials: 0 }
    }

    /// The motion at `wanted` times `speed`, or as near to it as the joints can be accelerated, and
    /// braked before their limits. `None` when that needs another direction or too many trials.
    fn refined_motion(
        &self,
        speed: Joints,
        wanted: f64,
        dt_s: f64,
        trials: &mut TrialBudget,
    ) -> Option<FeasibleMotion<N, A::Follower>> {
        let mut scale = 1.0;
        let mut tried = self.feasible_motion(speed, dt_s, trials)?;
        // The inverse kinematics is nonlinear, so the joints' step for a scaled motion is not
        // exactly the scaled step.
        for _ in 0..REFINEMENTS_MAX {
            let FeasibleMotion { speed: at, qd, .. } = &tried;
            let (least, most) = self.acceleration_range(qd, dt_s);
            if least > most {
                return None;
            }
            let (haste, edge) = self.edge_speed_ratio(&(self.q + qd * dt_s), dt_s);
            let unhurried = 1.0 / haste;
            if unhurried < wanted / scale {
                trials.obstacle = Some(edge);
            }
            let by = (wanted / scale).min(unhurried).max(least).min(most);
            if (by - 1.0).abs() < 1e-3 {
                break;
            }
            if trials.left == 0 {
                // A motion that is too slow is acceptable, one that is too fast is not.
                if by < 1.0 {
                    return None;
                }
                break;
            }
            scale *= by;
            tried = self.feasible_motion(at * by, dt_s, trials)?;
            if scale < SPEED_SHARE_MIN {
                break;
            }
        }
        // Otherwise no scale was found at which the joints can follow.
        self.is_reachable(&tried.qd, dt_s).then_some(tried)
    }

    /// The fastest motion that the arm can follow, with the joints' speeds. Near a singularity the
    /// tool slows down while the joint keeps its largest speed.
    fn feasible_motion(
        &self,
        mut speed: Joints,
        dt_s: f64,
        trials: &mut TrialBudget,
    ) -> Option<FeasibleMotion<N, A::Follower>> {
        for attempt in 0..SLOWDOWNS_MAX.min(trials.left) {
            trials.left -= 1;
            let lost = match self.trial(&speed, dt_s) {
                Ok((follower, q)) => {
                    return Some(FeasibleMotion { speed, follower, qd: (q - self.q) / dt_s });
                }
                Err(lost) => lost,
            };
            trials.obstacle = Some(lost.into());
            if let FollowError::SpeedLimit { ratio, .. } = lost {
                // At the edge of the workspace the joint angles change as the square root of the
                // tool's way, so a fraction of the speed is tried before the direction is given up.
                let late = attempt >= SLOWDOWNS_MAX / 2;
                let by = if late { (ratio * ratio).max(1.4) } else { ratio };
                speed /= by * SLOWDOWN_MARGIN;
            } else {
                speed *= 0.5;
            }
        }
        None
    }

    /// Joints after one job at this speed of the tool.
    fn trial(
        &self,
        speed: &Joints,
        dt_s: f64,
    ) -> Result<(A::Follower, JointVector<N>), FollowError> {
        let mut follower = self.follower;
        let got = follower.step(&self.displaced(speed, dt_s), dt_s)?;
        // A rotation moves the tool point by the length of its lever; a larger deviation means that
        // it slides along the edge of the workspace.
        let way_m = DVec3::new(speed[0], speed[1], speed[2]).length() * dt_s;
        if got.position_error_m
            > POINT_ERROR_SHARE_MAX * way_m + LEVER_M * got.orientation_error_rad + ROUNDING_M
        {
            return Err(FollowError::OutOfReach);
        }
        if got.orientation_error_rad > self.rates.off_max_rad {
            return Err(FollowError::SpeedLimit { joint: 3, ratio: 1.0 });
        }
        match self.deviation_limit(speed, &got.q, dt_s) {
            Some((joint, ratio)) => Err(FollowError::SpeedLimit { joint, ratio }),
            None => Ok((follower, got.q)),
        }
    }

    /// Checks what happens if the joints move to `q` (rad) in one job and are braked there
    /// ([`Law::coast`]). If the tool would then stop off its line or too late, returns the joint
    /// that takes longest to brake and the factor by which the tool has to be slower.
    fn deviation_limit(
        &self,
        speed: &Joints,
        q: &JointVector<N>,
        dt_s: f64,
    ) -> Option<(usize, f64)> {
        let qd = (q - self.q) / dt_s;
        let (mut slowest, mut jobs) = (0, 0.0);
        for joint in 0..N {
            let needed =
                qd[joint].abs() / (PLANNED_SHARE * self.arm.acceleration_max()[joint] * dt_s);
            if needed > jobs {
                (slowest, jobs) = (joint, needed);
            }
        }
        // In any case the arm has to be able to stop within the time that the operator may expect.
        if jobs * dt_s > self.rest_s {
            return Some((slowest, jobs * dt_s / self.rest_s.max(dt_s)));
        }
        // All joints lose the same share of their speed in each job: the speeds are 1 - 1/jobs, 1 -
        // 2/jobs ... of the first one.
        let whole = jobs.floor();
        let more = if whole > 0.0 { whole - 0.5 * whole * (whole + 1.0) / jobs } else { 0.0 };
        let rest = (q + qd * (dt_s * more)).sup(self.arm.q_min()).inf(self.arm.q_max());
        let here = self.arm.tool_pose(&self.q);
        let along = self.point_speed(speed, &here).normalize_or_zero();
        let moved = self.arm.tool_pose(&rest).translation - here.translation;
        let stray = self.deviation_m + moved - moved.dot(along) * along;
        let bound = DEVIATION_MAX_M + DEVIATION_SHARE_MAX * moved.length();
        let strays = stray.length() > bound && stray.length() > self.deviation_m.length();
        // The braking distance grows with the square of the speed.
        strays.then(|| (slowest, (stray.length() / bound).sqrt().max(DEVIATION_SLOWDOWN_MIN)))
    }

    /// Range of the factors on the speeds `qd` (rad/s) for which no joint exceeds its acceleration;
    /// the first is larger than the second when there is none.
    fn acceleration_range(&self, qd: &JointVector<N>, dt_s: f64) -> (f64, f64) {
        let (mut least, mut most) = (0.0f64, f64::INFINITY);
        for joint in 0..N {
            let change = PLANNED_SHARE * self.arm.acceleration_max()[joint] * dt_s;
            let (low, high) = (self.qd[joint] - change, self.qd[joint] + change);
            let speed = qd[joint];
            if speed != 0.0 {
                least = least.max((low / speed).min(high / speed));
                most = most.min((low / speed).max(high / speed));
            } else if low > 0.0 || high < 0.0 {
                return (1.0, 0.0);
            }
        }
        (least, most)
    }

    /// Whether the joints can have the speeds `qd` (rad/s) in one job.
    fn is_reachable(&self, qd: &JointVector<N>, dt_s: f64) -> bool {
        let change = self.arm.acceleration_max() * dt_s;
        (0..N).all(|joint| (qd[joint] - self.qd[joint]).abs() <= change[joint])
    }

    /// Largest ratio over the joints of the speed towards a limit to the speed from which the joint
    /// can still be braked before it, for a motion to `q` (rad) in `dt_s` (s), with the limit in
    /// question.
    fn edge_speed_ratio(&self, q: &JointVector<N>, dt_s: f64) -> (f64, Obstacle) {
        let (mut most, mut fastest, mut left) = (f64::MIN_POSITIVE, 0, 0.0);
        for joint in 0..N {
            let way = (q[joint] - self.q[joint]).abs();
            let brake = BRAKE_SHARE * self.arm.acceleration_max()[joint];
            let room = self.arm.remaining_travel(joint, &self.q, q);
            let allowed = stoppable(room, brake, dt_s) * dt_s;
            let haste = way / allowed.max(f64::MIN_POSITIVE);
            if haste > most {
                (most, fastest, left) = (haste, joint, room);
            }
        }
        let limit = left >= self.arm.travel_to_limit(fastest, &self.q, q).max(0.0);
        let kind = if limit { JogObstacle::Limit } else { JogObstacle::Branch };
        (most, Obstacle { kind, joint: Some(fastest) })
    }

    /// Pose of the tool after `span_s` (s) at `speed` (m/s, rad/s).
    fn displaced(&self, speed: &Joints, span_s: f64) -> Pose {
        let here = self.arm.tool_pose(&self.q);
        let line = DVec3::new(speed[0], speed[1], speed[2]) * span_s;
        let turn = rotation_from_vector(DVec3::new(speed[3], speed[4], speed[5]) * span_s);
        match self.frame {
            JogFrame::Tool => {
                Pose::new(here.rotation * turn, here.translation + here.rotation * line)
            }
            JogFrame::Base | JogFrame::Joints | JogFrame::Outer => {
                Pose::new(turn * here.rotation, here.translation + line)
            }
        }
    }
}
