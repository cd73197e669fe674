//! `taktil-bench-ruckig`: joint moves between random poses by Paul's transitions and by rsruckig,
//! under the same limits of speed and acceleration. Printed for each: duration, peak acceleration
//! and jerk, how far the simulated arm is from its set points, and the time of a tick. Everything
//! but the time is the same on every machine.

mod follow;

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, anyhow};
use follow::{SERVO_PERIOD, TrackingError, follow};
use rsruckig::prelude::*;
use taktil_mechanics::Joints;
use taktil_mechanics::paul::{JointPath, segment_time_s};
use taktil_mechanics::puma260::Puma260;

/// Moves that are made.
const MOVES_MADE: usize = 24;
/// Share of the joints' largest speeds: a brisk programme.
const SPEED_SHARE: f64 = 0.5;
/// Paul's half transition (s): the tasks' default.
const TAU_S: f64 = 0.1;
/// Rounds of the timing; the best and the middle one are told.
const TIMING_ROUNDS: usize = 41;

/// Finds out all of a move at instants.
trait Way {
    /// Seconds.
    fn duration_s(&self) -> f64;
    /// Angles, speeds, accelerations.
    fn at(&mut self, t_s: f64) -> (Joints, Joints, Joints);
}

struct ByPaul(JointPath);

impl Way for ByPaul {
    fn duration_s(&self) -> f64 {
        self.0.duration_s()
    }

    fn at(&mut self, t_s: f64) -> (Joints, Joints, Joints) {
        let at = self.0.at(t_s);
        (at.q, at.qd, at.qdd)
    }
}

struct ByRuckig(Trajectory<6>);

impl Way for ByRuckig {
    fn duration_s(&self) -> f64 {
        self.0.get_duration()
    }

    fn at(&mut self, t_s: f64) -> (Joints, Joints, Joints) {
        let mut parts = [(); 4].map(|()| DataArrayOrVec::new(None, 0.0));
        let [q, qd, qdd, jerk] = &mut parts;
        let (q, qd, qdd) = (&mut Some(q), &mut Some(qd), &mut Some(qdd));
        self.0.at_time(t_s, q, qd, qdd, &mut Some(jerk), &mut None);
        let six = |part: &DataArrayOrVec<f64, 6>| Joints::from_fn(|i, _| part[i]);
        (six(&parts[0]), six(&parts[1]), six(&parts[2]))
    }
}

/// Where a move begins and ends, and Paul's way between.
struct Move {
    from: Joints,
    to: Joints,
    paul: JointPath,
}

/// The limits that a planner gets.
#[derive(Clone, Copy)]
struct Limits {
    speed: Joints,
    acceleration: Joints,
    jerk: Joints,
}

/// A generator of poses: which ones does not matter, that they repeat does.
struct Dice(u64);

impl Dice {
    fn share(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn moves() -> anyhow::Result<Vec<Move>> {
    let (arm, mut dice) = (Puma260::reference(), Dice(7));
    let speed = arm.speed_max_rad_s * SPEED_SHARE;
    let mut pose = || {
        Joints::from_fn(|i, _| {
            let (low, high) = (arm.q_min_rad[i], arm.q_max_rad[i]);
            low + (0.2 + 0.6 * dice.share()) * (high - low)
        })
    };
    (0..MOVES_MADE)
        .map(|_| {
            let (from, to) = (pose(), pose());
            let time_s = segment_time_s(&from, &to, &speed, TAU_S);
            let paul = JointPath::new(&[from, to], &[time_s], TAU_S)?;
            Ok(Move { from, to, paul })
        })
        .collect()
}

fn ruckig(one: &Move, limits: &Limits, sync: Synchronization) -> anyhow::Result<Trajectory<6>> {
    let mut input = InputParameter::<6>::new(None);
    input.synchronization = sync;
    for i in 0..6 {
        input.current_position[i] = one.from[i];
        input.target_position[i] = one.to[i];
        input.max_velocity[i] = limits.speed[i];
        input.max_acceleration[i] = limits.acceleration[i];
        input.max_jerk[i] = limits.jerk[i];
    }
    let mut otg = Ruckig::<6, ThrowErrorHandler>::new(None, SERVO_PERIOD.as_secs_f64());
    let mut way = Trajectory::new(None);
    otg.calculate(&input, &mut way).map_err(|bad| anyhow!("{bad}"))?;
    Ok(way)
}

/// What one way of moving came to, over all moves.
#[derive(Default)]
struct Row {
    duration_s: f64,
    acceleration: f64,
    jerk: f64,
    missed: TrackingError,
    square: f64,
}

fn measure(ways: &mut [Box<dyn Way>], limits: &Limits) -> anyhow::Result<Row> {
    let (dt_s, mut row) = (SERVO_PERIOD.as_secs_f64(), Row::default());
    for way in ways.iter_mut() {
        row.duration_s += way.duration_s() / MOVES_MADE as f64;
        // Jerk as the change of acceleration over a tenth of a tick, where it does not step.
        let fine = dt_s / 10.0;
        let mut last = way.at(0.0).2;
        for i in 1..=(way.duration_s() / fine) as i64 {
            let now = way.at(i as f64 * fine).2;
            let jerk = (now - last).abs() / fine;
            row.jerk = row.jerk.max(jerk.component_div(&limits.jerk).max());
            row.acceleration =
                row.acceleration.max(now.abs().component_div(&limits.acceleration).max());
            last = now;
        }
        let ticks = (way.duration_s() / dt_s).ceil() as i64;
        let points: Vec<_> = (0..=ticks)
            .map(|tick| {
                let (q, qd, _) = way.at((tick as f64 * dt_s).min(way.duration_s()));
                (q, if tick == ticks { Joints::zeros() } else { qd })
            })
            .collect();
        let missed = follow(&points)?;
        row.square += missed.rms_rad * missed.rms_rad / MOVES_MADE as f64;
        row.missed.peak_rad = row.missed.peak_rad.max(missed.peak_rad);
        row.missed.after_rad = row.missed.after_rad.max(missed.after_rad);
        row.missed.torque_share = row.missed.torque_share.max(missed.torque_share);
    }
    Ok(row)
}

/// Nanoseconds of one evaluation: best and median of rounds over all moves.
fn cost_ns(ways: &mut [Box<dyn Way>]) -> (f64, f64) {
    let mut rounds: Vec<f64> = (0..TIMING_ROUNDS)
        .map(|_| {
            let (begin, mut ticks) = (Instant::now(), 0);
            for way in ways.iter_mut() {
                let count = (way.duration_s() / SERVO_PERIOD.as_secs_f64()) as i64;
                for tick in 0..count {
                    black_box(way.at(black_box(tick as f64 * SERVO_PERIOD.as_secs_f64())));
                }
                ticks += count;
            }
            begin.elapsed().as_nanos() as f64 / ticks as f64
        })
        .collect();
    rounds.sort_by(f64::total_cmp);
    (rounds[0], rounds[TIMING_ROUNDS / 2])
}

/// Nanoseconds of laying one move: best and median.
fn lay_ns(mut lay: impl FnMut(&Move), moves: &[Move]) -> (f64, f64) {
    let mut rounds: Vec<f64> = (0..TIMING_ROUNDS)
        .map(|_| {
            let begin = Instant::now();
            moves.iter().for_each(&mut lay);
            begin.elapsed().as_nanos() as f64 / moves.len() as f64
        })
        .collect();
    rounds.sort_by(f64::total_cmp);
    (rounds[0], rounds[TIMING_ROUNDS / 2])
}

fn main() -> anyhow::Result<()> {
    let (arm, moves) = (Puma260::reference(), moves()?);
    let speed = arm.speed_max_rad_s * SPEED_SHARE;
    // What Paul's transitions ask for at most: of acceleration 3/4 dv/tau, of jerk 3/2 dv/tau^2.
    let like = Limits {
        speed,
        acceleration: speed * (0.75 / TAU_S),
        jerk: speed * (1.5 / (TAU_S * TAU_S)),
    };
    let full = Limits { acceleration: arm.acceleration_max_rad_s2, ..like };
    let harder = Limits { jerk: like.jerk * 4.0, ..full };
    let (time, phase) = (Synchronization::Time, Synchronization::Phase);
    let kinds: [(&str, Option<(Limits, Synchronization)>); 5] = [
        ("Paul, tau 0.1 s", None),
        ("rsruckig, Paul's acceleration and jerk", Some((like, phase.clone()))),
        ("rsruckig, the same, joints together in time only", Some((like, time))),
        ("rsruckig, the arm's acceleration, Paul's jerk", Some((full, phase.clone()))),
        ("rsruckig, the arm's acceleration, four times the jerk", Some((harder, phase))),
    ];
    println!(
        "{MOVES_MADE} moves between random poses at {SPEED_SHARE} of the joints' speeds; \
         acceleration and jerk in parts of Paul's largest\n"
    );
    println!(
        "| set points by | duration, s | acceleration | jerk | tracking rms, deg | peak, deg | \
         after, deg | torque, % | a move, ns | a tick, ns, best | median |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for (name, limits) in kinds {
        let mut ways: Vec<Box<dyn Way>> = Vec::new();
        for one in &moves {
            ways.push(match &limits {
                None => Box::new(ByPaul(one.paul.clone())),
                Some((limits, sync)) => {
                    let way = ruckig(one, limits, sync.clone());
                    Box::new(ByRuckig(way.with_context(|| name.to_owned())?))
                }
            });
        }
        let row = measure(&mut ways, &like)?;
        let (best, median) = cost_ns(&mut ways);
        let laid = match &limits {
            None => lay_ns(
                |one| {
                    let time_s = segment_time_s(&one.from, &one.to, &speed, TAU_S);
                    black_box(JointPath::new(&[one.from, one.to], &[time_s], TAU_S).is_ok());
                },
                &moves,
            ),
            Some((limits, sync)) => {
                lay_ns(|one| _ = black_box(ruckig(one, limits, sync.clone()).is_ok()), &moves)
            }
        };
        println!(
            "| {name} | {:.3} | {:.2} | {:.2} | {:.4} | {:.3} | {:.3} | {:.0} | {:.0} | \
             {best:.0} | {median:.0} |",
            row.duration_s,
            row.acceleration,
            row.jerk,
            row.square.sqrt().to_degrees(),
            row.missed.peak_rad.to_degrees(),
            row.missed.after_rad.to_degrees(),
            100.0 * row.missed.torque_share,
            laid.0,
        );
    }
    Ok(())
}
