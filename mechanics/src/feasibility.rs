//! The check of a whole move before it starts: the arm is led along it tick by tick until it rests
//! on its goal, and the first thing that it could not do is named with joint and time. Refuses
//! nothing for being slow: what a move costs (time, speed, torque, distance from singularities,
//! deviation) comes back as figures.
//!
//! [`Inspection`] does so a few ticks at a time, for a lane that has a deadline; [`Preview::of`]
//! does it at once.

use core::fmt;

use crate::arm::{Arm, Links, Lost};
use crate::puma260::Puma260;
use crate::spatial::JointVector;
use crate::tracking::{Lead, Route};

/// Most ticks that a preview walks.
const TICKS_MAX: f64 = 1e7;
/// The torque is looked at in one of so many ticks: it costs more than all the rest.
const TORQUE_EVERY: u32 = 4;
/// Rounding that a limit forgives, relative.
const SLACK: f64 = 1e-9;

/// The arm, and what a move may ask of it.
#[derive(Clone, Debug)]
pub struct Terms<const N: usize = 6, A: Arm<N> = Puma260> {
    /// Limits of angle, speed and acceleration, and the tool.
    pub arm: A,
    /// Links, tool and motors, for the torque.
    pub dynamics: A::Links,
    /// Largest torque of each joint (N m); infinite where it does not matter.
    pub torque_max_nm: JointVector<N>,
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
pub struct Preview<const N: usize = 6> {
    /// How long it takes (s), settling included.
    pub duration_s: f64,
    /// How long after the route's end the arm comes to rest on its goal (s); 0 unless it passed a
    /// wrist singularity shortly before.
    pub settle_s: f64,
    /// Largest speed of each joint over its limit.
    pub speed: [Peak; N],
    /// Largest torque of each joint over its limit, 0 for a limit without end.
    pub torque: [Peak; N],
    /// Smallest scaled distances from the singularities of shoulder, elbow and wrist, in size.
    pub singular: [Peak; 3],
    /// Largest distance of the tool point from its path (m).
    pub off_m: Peak,
    /// Largest angle between the tool and its path (rad).
    pub off_rad: Peak,
    /// Joints at the end (rad).
    pub end: JointVector<N>,
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

/// Refuses to start `route` anywhere but at joints `start` (rad).
fn check_start<const N: usize, A: Arm<N>>(
    route: Route<'_, N>,
    start: &JointVector<N>,
    arm: &A,
) -> Result<(), Refusal> {
    let (off, turned) = match route {
        Route::Joints(path) => ((path.points()[0] - start).amax(), false),
        Route::Tool(path) => {
            let (wanted, here) = (path.points()[0], arm.tool_pose(start));
            let turn = wanted.rotation.transpose() * here.rotation;
            let square = turn.abs_diff_eq(glam::DMat3::IDENTITY, START_TOLERANCE);
            ((wanted.translation - here.translation).length(), !square)
        }
    };
    if off.is_nan() || off > START_TOLERANCE || turned {
        return Err(Refusal::Start { off });
    }
    Ok(())
}

/// Gathers figures along the way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Walk<const N: usize> {
    preview: Preview<N>,
    /// Joints one tick ago (rad).
    before: JointVector<N>,
    /// Joints at the last look at the torque and the one before (rad).
    looks: [JointVector<N>; 2],
    /// Ticks since the last look at the torque.
    since: u32,
}

impl<const N: usize> Walk<N> {
    fn new(start: &JointVector<N>, duration_s: f64) -> Walk<N> {
        let least = Peak { value: 0.0, t_s: 0.0 };
        let preview = Preview {
            duration_s,
            settle_s: 0.0,
            speed: [least; N],
            torque: [least; N],
            singular: [Peak { value: f64::INFINITY, t_s: 0.0 }; 3],
            off_m: least,
            off_rad: least,
            end: *start,
        };
        Walk { preview, before: *start, looks: [*start; 2], since: 0 }
    }

    /// Takes in the joints at `t_s`: their speed since the last tick, now and then their torque.
    fn step<A: Arm<N>>(
        &mut self,
        q: &JointVector<N>,
        t_s: f64,
        terms: &Terms<N, A>,
    ) -> Result<(), Refusal> {
        let Terms { arm, tick_s, .. } = terms;
        let speed = (q - self.before) / *tick_s;
        for joint in 0..N {
            let share = speed[joint].abs() / arm.speed_max()[joint];
            raise(&mut self.preview.speed[joint], share, t_s);
            if share > 1.0 + SLACK {
                let why = Lost::TooFast { joint, ratio: share };
                return Err(Refusal::Lost { why, t_s });
            }
        }
        self.since += 1;
        if self.since == TORQUE_EVERY {
            self.since = 0;
            self.look_at_torque(q, t_s, terms)?;
        }
        for (least, part) in self.preview.singular.iter_mut().zip(arm.singular(q)) {
            if part < least.value {
                *least = Peak { value: part, t_s };
            }
        }
        self.before = *q;
        self.preview.end = *q;
        Ok(())
    }

    /// The torque at the last look, from the joints before, at and after it.
    fn look_at_torque<A: Arm<N>>(
        &mut self,
        q: &JointVector<N>,
        t_s: f64,
        terms: &Terms<N, A>,
    ) -> Result<(), Refusal> {
        let Terms { dynamics, torque_max_nm, tick_s, .. } = terms;
        let span_s = tick_s * f64::from(TORQUE_EVERY);
        let [at, before] = self.looks;
        let velocity = (q - before) / (2.0 * span_s);
        let acceleration = (q - at * 2.0 + before) / (span_s * span_s);
        // Not plain inverse dynamics of the links: the motors' own inertia counts too.
        let torque = dynamics.mass_matrix(&at) * acceleration + dynamics.bias(&at, &velocity);
        self.looks = [*q, at];
        for joint in 0..N {
            let ratio = torque[joint].abs() / torque_max_nm[joint];
            raise(&mut self.preview.torque[joint], ratio, t_s);
            if ratio > 1.0 + SLACK {
                return Err(Refusal::Torque { joint, ratio, t_s });
            }
        }
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
    // Two looks more, so that the deceleration is looked at from both sides.
    Ok(ticks + 2 * TORQUE_EVERY)
}

/// How far an inspection is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// There is more to look at.
    Open,
    /// The move can be made; [`Inspection::preview`] says at what cost.
    Passed,
    /// It cannot.
    Refused(Refusal),
}

/// How far a move has been looked at. The route stays with whoever holds it and is handed in each
/// time; it must be the one of the beginning.
#[derive(Clone, Debug, PartialEq)]
pub struct Inspection<const N: usize = 6, A: Arm<N> = Puma260> {
    walk: Walk<N>,
    lead: Lead<N, A>,
    /// The route's time before the first tick (s).
    from_s: f64,
    tick: u32,
    /// Ticks of the route, and a few more.
    ticks: u32,
    /// The tick from which on the arm rests on its goal.
    over: Option<u32>,
}

impl<const N: usize, A: Arm<N>> Inspection<N, A> {
    /// Begins to look at `route` from joints `start` (rad), a tool path on the branch of `start`.
    ///
    /// # Errors
    /// A route that starts elsewhere, and a tick that does not fit it.
    pub fn new(
        route: Route<'_, N>,
        start: &JointVector<N>,
        terms: &Terms<N, A>,
    ) -> Result<Inspection<N, A>, Refusal> {
        check_start(route, start, &terms.arm)?;
        Ok(Inspection {
            walk: Walk::new(start, route.duration_s()),
            lead: Lead::new(&terms.arm, start),
            from_s: 0.0,
            tick: 0,
            ticks: ticks(route.duration_s(), terms.tick_s)?,
            over: None,
        })
    }

    /// Begins to look at what is left of `route` from `from_s` (s) on, where the arm has been led
    /// by `lead`.
    ///
    /// # Errors
    /// A tick that does not fit the route.
    pub fn onward(
        route: Route<'_, N>,
        lead: &Lead<N, A>,
        from_s: f64,
        terms: &Terms<N, A>,
    ) -> Result<Inspection<N, A>, Refusal> {
        let q = lead.joints();
        let left_s = route.duration_s() - from_s;
        let mut walk = Walk::new(q, route.duration_s());
        walk.looks[1] = q - lead.speeds() * (terms.tick_s * f64::from(TORQUE_EVERY));
        let ticks = ticks(left_s, terms.tick_s)?;
        Ok(Inspection { walk, lead: *lead, from_s, tick: 0, ticks, over: None })
    }

    /// What has been found so far: the whole cost once the move has passed.
    #[must_use]
    pub fn preview(&self) -> &Preview<N> {
        &self.walk.preview
    }

    /// Looks at so many more ticks; `route` and `terms` are those of the beginning.
    pub fn advance(&mut self, ticks: u32, route: Route<'_, N>, terms: &Terms<N, A>) -> Verdict {
        for _ in 0..ticks {
            if self.is_whole() {
                break;
            }
            self.tick += 1;
            let t_s = self.from_s + f64::from(self.tick) * terms.tick_s;
            if let Err(refusal) = self.look(t_s, route, terms) {
                return Verdict::Refused(refusal);
            }
        }
        if self.is_whole() { Verdict::Passed } else { Verdict::Open }
    }

    /// True once the arm has rested on its goal for as long as it takes to have looked at the
    /// torque that brought it to rest.
    fn is_whole(&self) -> bool {
        let rested = |over| self.tick >= self.ticks.max(over + 2 * TORQUE_EVERY - 1);
        self.over.is_some_and(rested)
    }

    fn look(&mut self, t_s: f64, route: Route<'_, N>, terms: &Terms<N, A>) -> Result<(), Refusal> {
        let Inspection { walk, lead, over, .. } = self;
        if over.is_some() {
            let rest = walk.preview.end;
            return walk.step(&rest, t_s, terms);
        }
        let lost = |why| Refusal::Lost { why, t_s };
        let led = lead.step(&terms.arm, route, t_s, terms.tick_s).map_err(lost)?;
        let (q, off_m, off_rad) = (led.at.q, led.off_m, led.off_rad);
        match route {
            Route::Joints(_) => {
                let (low, high) = (terms.arm.q_min(), terms.arm.q_max());
                if let Some(joint) = (0..N).find(|&i| q[i] < low[i] || q[i] > high[i]) {
                    return Err(lost(Lost::Limit { joint }));
                }
            }
            Route::Tool(_) => {
                raise(&mut walk.preview.off_m, off_m, t_s);
                raise(&mut walk.preview.off_rad, off_rad, t_s);
                if off_m > terms.off_max_m || off_rad > terms.off_max_rad {
                    return Err(Refusal::Off { off_m, off_rad, t_s });
                }
            }
        }
        if led.over {
            *over = Some(self.tick);
            walk.preview.settle_s = led.late_s;
            walk.preview.duration_s += led.late_s;
        }
        walk.step(&q, t_s, terms)
    }
}

impl<const N: usize> Preview<N> {
    /// Walks a whole route from joints `start` (rad).
    ///
    /// # Errors
    /// The first thing that the arm cannot do.
    pub fn of<A: Arm<N>>(
        route: Route<'_, N>,
        start: &JointVector<N>,
        terms: &Terms<N, A>,
    ) -> Result<Preview<N>, Refusal> {
        let mut inspection = Inspection::new(route, start, terms)?;
        loop {
            match inspection.advance(u32::MAX, route, terms) {
                Verdict::Open => {}
                Verdict::Passed => return Ok(*inspection.preview()),
                Verdict::Refused(refusal) => return Err(refusal),
            }
        }
    }
}
