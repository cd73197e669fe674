//! Any chain as planning and leading see an arm: poses are reached by damped steps from where the
//! arm is, tick by tick. Refuses a path that it cannot follow to a tenth of a nanometre, unless the
//! miss is small: then the miss is told, and whoever leads decides.
//!
//! A redundant arm takes the shortest way in its joints from tick to tick; where it stands after a
//! closed path of the tool depends on that path.

use super::{Chain, Effort};
use crate::arm::{Arm, Follow, Followed, Links, Lost};
use crate::spatial::{JointMatrix, JointVector, Pose};

/// What a lane may spend on one pose: a few starts, about half a millisecond when all of them fail.
const LANE: Effort = Effort { starts: 4, steps: 40, reached_m: 1e-10, reached_rad: 1e-10 };
/// Rounding that a limit forgives, relative.
const SLACK: f64 = 1e-9;
/// A miss beyond these is no path any more (m, rad).
const LARGEST_MISS: (f64, f64) = (0.05, 0.3);

impl<const N: usize> Arm<N> for Chain<N> {
    type Follower = Follower<N>;
    type Links = Chain<N>;

    fn q_min(&self) -> &JointVector<N> {
        &self.limits.q_min
    }

    fn q_max(&self) -> &JointVector<N> {
        &self.limits.q_max
    }

    fn speed_max(&self) -> &JointVector<N> {
        &self.limits.speed_max
    }

    fn acceleration_max(&self) -> &JointVector<N> {
        &self.limits.acceleration_max
    }

    fn with_speed_max(&self, speed_max: &JointVector<N>) -> Chain<N> {
        let mut other = *self;
        other.limits.speed_max = *speed_max;
        other
    }

    fn tool_pose(&self, q: &JointVector<N>) -> Pose {
        Chain::tool_pose(self, q)
    }

    fn reach(&self, tool: &Pose, before: &JointVector<N>) -> Option<JointVector<N>> {
        self.search(tool, before, &LANE).ok().map(|found| found.q)
    }

    fn may_reach(&self, tool: &Pose) -> bool {
        #[expect(clippy::cast_precision_loss, reason = "at most eight")]
        let longest = self.scale_m * N as f64;
        let slides: f64 = (0..N).map(|i| self.links[i].longest_slide(&self.limits, i)).sum();
        tool.is_finite() && tool.translation.length() <= (longest + slides) * (1.0 + SLACK)
    }

    fn can_reach(&self, tool: &Pose) -> bool {
        let middle = (self.limits.q_min + self.limits.q_max) * 0.5;
        self.search(tool, &middle, &Effort::default()).is_ok()
    }

    fn singular(&self, q: &JointVector<N>) -> [f64; 3] {
        let Some(wrist) = &self.wrist else { return [self.singular_values(q)[5]; 3] };
        let six = crate::spatial::Joints::from_fn(|i, _| q[i]);
        let distance = wrist.singular_distance(&six);
        [distance.shoulder.abs(), distance.elbow.abs(), distance.wrist.abs()]
    }

    fn follower(&self, q: &JointVector<N>) -> Follower<N> {
        Follower { arm: *self, q: *q }
    }
}

impl<const N: usize> Links<N> for Chain<N> {
    fn mass_matrix(&self, q: &JointVector<N>) -> JointMatrix<N> {
        Chain::mass_matrix(self, q)
    }

    fn bias(&self, q: &JointVector<N>, qd: &JointVector<N>) -> JointVector<N> {
        Chain::bias(self, q, qd)
    }

    fn gravity(&self, q: &JointVector<N>) -> JointVector<N> {
        Chain::gravity(self, q)
    }
}

/// Follows a path of tool poses from where it was last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower<const N: usize> {
    arm: Chain<N>,
    q: JointVector<N>,
}

impl<const N: usize> Follower<N> {
    /// Where a pose that was not reached leaves the arm: at a limit, out of reach, or near enough.
    fn missed(&self, near: &super::NotFound<N>) -> Result<(), Lost> {
        let limits = &self.arm.limits;
        let at_limit = |i: &usize| {
            let rounding = SLACK * (1.0 + near.q[*i].abs());
            near.q[*i] <= limits.q_min[*i] + rounding || near.q[*i] >= limits.q_max[*i] - rounding
        };
        if let Some(joint) = (0..N).find(at_limit) {
            return Err(Lost::Limit { joint });
        }
        // A NaN is not below.
        let small = near.off_m < LARGEST_MISS.0 && near.off_rad < LARGEST_MISS.1;
        if small { Ok(()) } else { Err(Lost::OutOfReach) }
    }
}

impl<const N: usize> Follow<N> for Follower<N> {
    fn joints(&self) -> &JointVector<N> {
        &self.q
    }

    fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<Followed<N>, Lost> {
        let got = match self.arm.search(tool, &self.q, &Effort::TICK) {
            Ok(found) => Followed { q: found.q, off_m: found.off_m, off_rad: found.off_rad },
            Err(near) => {
                self.missed(&near)?;
                Followed { q: near.q, off_m: near.off_m, off_rad: near.off_rad }
            }
        };
        let mut worst = (0, 0.0);
        for joint in 0..N {
            let way = (got.q[joint] - self.q[joint]).abs();
            let ratio = way / (self.arm.limits.speed_max[joint] * dt_s);
            if ratio > worst.1 {
                worst = (joint, ratio);
            }
        }
        if worst.1 > 1.0 + SLACK {
            return Err(Lost::TooFast { joint: worst.0, ratio: worst.1 });
        }
        self.q = got.q;
        Ok(got)
    }
}
