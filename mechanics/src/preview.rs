//! The check of a whole move before it starts: the arm is led along it tick by tick, and the first
//! thing that it could not do is named with joint and time. Refuses nothing for being slow: what a
//! move costs (speed, torque, distance from singularities, deviation) comes back as figures.

use core::fmt;

use crate::dynamics::Dynamics;
use crate::paul::JointPath;
use crate::paul::cartesian::CartesianPath;
use crate::puma260::Puma260;
use crate::puma260::follow::{Follower, Lost};
use crate::spatial::Joints;

/// Most ticks that a preview walks.
const TICKS_MAX: f64 = 1e7;
/// Rounding that a limit forgives, relative.
const SLACK: f64 = 1e-9;

/// The arm, and what a move may ask of it.
#[derive(Clone, Debug)]
pub struct Terms {
    /// Limits of angle, speed and acceleration, and the tool.
    pub arm: Puma260,
    /// Links, tool and motors, for the torque.
    pub dynamics: Dynamics,
    /// Largest torque of each joint (N m); infinite where it does not matter.
    pub torque_max_nm: Joints,
    /// Largest distance of the tool point from its path (m), past a wrist singularity.
    pub off_max_m: f64,
    /// Largest angle between the tool and its path (rad), past a wrist singularity.
    pub off_max_rad: f64,
    /// Time between two looks: the control period (s).
    pub tick_s: f64,
}

/// A figure and when it was reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// The figure.
    pub value: f64,
    /// When, from the start of the move (s).
    pub t_s: f64,
}

/// What a move that can be made will cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preview {
    /// How long it takes (s).
    pub duration_s: f64,
    /// Largest speed of each joint over its limit.
    pub speed: [Peak; 6],
    /// Largest torque of each joint over its limit, 0 for a limit without end.
    pub torque: [Peak; 6],
    /// Smallest scaled distances from the singularities of shoulder, elbow and wrist, in size.
    pub singular: [Peak; 3],
    /// Largest distance of the tool point from its path (m).
    pub off_m: Peak,
    /// Largest angle between the tool and its path (rad).
    pub off_rad: Peak,
    /// Joints at the end (rad).
    pub end: Joints,
}

/// Why a move is not started.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Refusal {
    /// The arm cannot follow.
    Lost {
        /// Why.
        why: Lost,
        /// When (s).
        t_s: f64,
    },
    /// This joint (0 is the first) would need more torque than it has, by this ratio.
    Torque {
        /// Index of the joint.
        joint: usize,
        /// Torque wanted over the torque there is.
        ratio: f64,
        /// When (s).
        t_s: f64,
    },
    /// Past a wrist singularity the tool would leave its path by more than is allowed.
    Off {
        /// Distance of the tool point (m).
        off_m: f64,
        /// Angle of the tool (rad).
        off_rad: f64,
        /// When (s).
        t_s: f64,
    },
    /// The move does not start where the arm is.
    Start {
        /// Distance of the tool point (m) or, for a joint path, of the farthest joint (rad).
        off: f64,
    },
    /// The tick is not a positive time, or the move has more than ten million of them.
    Tick,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Refusal::Lost { why, t_s } => write!(f, "{why} after {t_s:.3} s of the move"),
            Refusal::Torque { joint, ratio, t_s } => write!(
                f,
                "joint {} would need {ratio:.2} times its torque after {t_s:.3} s of the move",
                joint + 1
            ),
            Refusal::Off { off_m, off_rad, t_s } => write!(
                f,
                "past the wrist singularity the tool would be {:.3} mm and {off_rad:.4} rad off \
                 its path after {t_s:.3} s of the move",
                off_m * 1e3
            ),
            Refusal::Start { off } => {
                write!(f, "the move starts {off:.4} m or rad from where the arm is")
            }
            Refusal::Tick => write!(f, "the time between two looks does not fit the move"),
        }
    }
}

impl core::error::Error for Refusal {}

/// How far the start of a move may be from the arm (m, rad).
const START_TOLERANCE: f64 = 1e-6;

/// Gathers figures along the way.
struct Walk<'a> {
    terms: &'a Terms,
    preview: Preview,
    /// Joints one and two ticks ago (rad).
    last: [Joints; 2],
}

impl<'a> Walk<'a> {
    fn new(terms: &'a Terms, start: &Joints, duration_s: f64) -> Walk<'a> {
        let least = Peak { value: 0.0, t_s: 0.0 };
        let preview = Preview {
            duration_s,
            speed: [least; 6],
            torque: [least; 6],
            singular: [Peak { value: f64::INFINITY, t_s: 0.0 }; 3],
            off_m: least,
            off_rad: least,
            end: *start,
        };
        Walk { terms, preview, last: [*start; 2] }
    }

    /// Takes in the joints at `t_s`: speed since the last tick, torque at the last tick.
    fn step(&mut self, q: &Joints, t_s: f64) -> Result<(), Refusal> {
        let Terms { arm, dynamics, torque_max_nm, tick_s, .. } = self.terms;
        let before = self.last[0];
        let speed = (q - before) / *tick_s;
        let velocity = (q - self.last[1]) / (2.0 * tick_s);
        let acceleration = (q - before * 2.0 + self.last[1]) / (tick_s * tick_s);
        let torque = dynamics.inverse(&before, &velocity, &acceleration);
        for joint in 0..6 {
            let share = speed[joint].abs() / arm.speed_max_rad_s[joint];
            raise(&mut self.preview.speed[joint], share, t_s);
            if share > 1.0 + SLACK {
                let why = Lost::TooFast { joint, ratio: share };
                return Err(Refusal::Lost { why, t_s });
            }
            let ratio = torque[joint].abs() / torque_max_nm[joint];
            raise(&mut self.preview.torque[joint], ratio, t_s);
            if ratio > 1.0 + SLACK {
                return Err(Refusal::Torque { joint, ratio, t_s });
            }
        }
        let distance = arm.singular_distance(q);
        let parts = [distance.shoulder, distance.elbow, distance.wrist];
        for (least, part) in self.preview.singular.iter_mut().zip(parts) {
            if part.abs() < least.value {
                *least = Peak { value: part.abs(), t_s };
            }
        }
        self.last = [*q, before];
        self.preview.end = *q;
        Ok(())
    }
}

fn raise(peak: &mut Peak, value: f64, t_s: f64) {
    if value > peak.value {
        *peak = Peak { value, t_s };
    }
}

fn ticks(duration_s: f64, tick_s: f64) -> Result<u32, Refusal> {
    let ticks = (duration_s / tick_s).ceil();
    if !(tick_s > 0.0 && ticks < TICKS_MAX) {
        return Err(Refusal::Tick);
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1e7")]
    let ticks = ticks as u32;
    // Two more, so that the deceleration is looked at from both sides.
    Ok(ticks + 2)
}

impl Preview {
    /// Walks a joint path from `start` (rad).
    ///
    /// # Errors
    /// The first thing that the arm cannot do.
    pub fn of_joints(path: &JointPath, start: &Joints, terms: &Terms) -> Result<Preview, Refusal> {
        let off = (path.points()[0] - start).amax();
        if off.is_nan() || off > START_TOLERANCE {
            return Err(Refusal::Start { off });
        }
        let mut walk = Walk::new(terms, start, path.duration_s());
        let (low, high) = (&terms.arm.q_min_rad, &terms.arm.q_max_rad);
        for tick in 1..=ticks(path.duration_s(), terms.tick_s)? {
            let t_s = f64::from(tick) * terms.tick_s;
            let q = path.at(t_s).q;
            if let Some(joint) = (0..6).find(|&i| q[i] < low[i] || q[i] > high[i]) {
                return Err(Refusal::Lost { why: Lost::Limit { joint }, t_s });
            }
            walk.step(&q, t_s)?;
        }
        Ok(walk.preview)
    }

    /// Walks a path of the tool from `start` (rad) on the branch of `start`.
    ///
    /// # Errors
    /// The first thing that the arm cannot do.
    pub fn of_tool(
        path: &CartesianPath,
        start: &Joints,
        terms: &Terms,
    ) -> Result<Preview, Refusal> {
        let here = terms.arm.tool_pose(start);
        let off = (path.points()[0].translation - here.translation).length();
        let turned = path.points()[0].rotation.transpose() * here.rotation;
        let square = turned.abs_diff_eq(glam::DMat3::IDENTITY, START_TOLERANCE);
        if !(off <= START_TOLERANCE && square) {
            return Err(Refusal::Start { off });
        }
        let mut walk = Walk::new(terms, start, path.duration_s());
        let mut follower = Follower::new(&terms.arm, start);
        for tick in 1..=ticks(path.duration_s(), terms.tick_s)? {
            let t_s = f64::from(tick) * terms.tick_s;
            let lost = |why| Refusal::Lost { why, t_s };
            let got = follower.step(&path.at(t_s).pose, terms.tick_s).map_err(lost)?;
            let (off_m, off_rad) = (got.off_m, got.off_rad);
            raise(&mut walk.preview.off_m, off_m, t_s);
            raise(&mut walk.preview.off_rad, off_rad, t_s);
            if off_m > terms.off_max_m || off_rad > terms.off_max_rad {
                return Err(Refusal::Off { off_m, off_rad, t_s });
            }
            walk.step(&got.q, t_s)?;
        }
        Ok(walk.preview)
    }
}
