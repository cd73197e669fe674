//! Swings one joint about its place and finds the torque of its motor for one code and its friction
//! from the motion, with the masses of the arm's model as the scale.

use taktil_hal::CHANNELS;

use crate::cell::Cell;
use crate::fit::{HALF_WINDOW, Row, TorqueFit, parabola, torque_fit};
use crate::stop::Stop;
use crate::travel::Loops;

/// Amplitude of a swing at most (rad), and the share of the way to a stop that it takes.
const AMPLITUDE_RAD: f64 = 0.35;
const AMPLITUDE_SHARE: f64 = 0.6;
/// Periods of the swings (s): a slow and a faster one, so that friction at several speeds shows.
const PERIODS_S: [f64; 2] = [4.0, 1.6];
/// Swings of each period.
const SWING_COUNT: f64 = 2.0;
/// The first swing, from which the loop's gain is taken: its amplitude (rad) and period (s).
const FIRST_AMPLITUDE_RAD: f64 = 0.1;
const FIRST_PERIOD_S: f64 = 2.0;
/// Share of the largest speed below which friction is in transition and a row does not count.
const SPEED_SHARE: f64 = 0.25;

/// Torque of each joint's motor for one code, where it was found already (N m, at the joint).
pub(crate) type MotorTorques = [Option<f64>; CHANNELS];

/// The joint's record of a swing, cycle by cycle.
#[derive(Default)]
struct Swing {
    angles: Vec<Vec<f64>>,
    codes: Vec<[i32; CHANNELS]>,
    times_s: Vec<f64>,
    /// Cycles in which the code before did not act for one cycle, or the counts are not new.
    is_disturbed: Vec<bool>,
}

/// Swings joint `joint`; `None` where its motion cannot be told from its friction.
pub(crate) fn excite(
    cell: &mut Cell<'_>,
    loops: &mut Loops<'_>,
    joint: usize,
    known: &MotorTorques,
) -> Result<Option<TorqueFit>, Stop> {
    let amplitude = amplitude(loops, joint);
    let mut rows = Vec::new();
    for period_s in PERIODS_S {
        let swing = swing(cell, loops, joint, amplitude, period_s)?;
        rows.extend(analysed(&swing, loops, joint, known));
    }
    loops.settle(cell, 0.3)?;
    Ok(fitted(rows))
}

/// Swings joint `joint` a little and takes the gain of its loop from that, because single pulses
/// tell it roughly; returns the torque of its motor for one code (N m).
pub(crate) fn learn_gain(
    cell: &mut Cell<'_>,
    loops: &mut Loops<'_>,
    joint: usize,
    known: &MotorTorques,
) -> Result<Option<f64>, Stop> {
    let amplitude = FIRST_AMPLITUDE_RAD.min(amplitude(loops, joint));
    let mut learnt = None;
    // The second swing is in the hands of a better loop.
    for _ in 0..2 {
        let swing = swing(cell, loops, joint, amplitude, FIRST_PERIOD_S)?;
        let rows = analysed(&swing, loops, joint, known);
        if let Some(fit) = fitted(rows).filter(|fit| fit.nm_per_code > 0.0) {
            loops.take_gain(joint, fit.nm_per_code);
            learnt = Some(fit.nm_per_code);
        }
    }
    loops.settle(cell, 0.3)?;
    Ok(learnt)
}

/// How far a joint may swing from its home to both sides (rad).
fn amplitude(loops: &Loops<'_>, joint: usize) -> f64 {
    let model = loops.model;
    let home = model.home_rad[joint];
    let room = (home - model.low_rad[joint]).min(model.high_rad[joint] - home);
    AMPLITUDE_RAD.min(AMPLITUDE_SHARE * room)
}

/// The fit over the rows in which friction is not in transition.
fn fitted(mut rows: Vec<Row>) -> Option<TorqueFit> {
    let fastest = rows.iter().map(|row| row.speed_rad_s.abs()).fold(0.0, f64::max);
    rows.retain(|row| row.speed_rad_s.abs() > SPEED_SHARE * fastest);
    torque_fit(&rows)
}

fn swing(
    cell: &mut Cell<'_>,
    loops: &mut Loops<'_>,
    joint: usize,
    amplitude: f64,
    swing_s: f64,
) -> Result<Swing, Stop> {
    let start = loops.settle(cell, 0.3)?.counts[loops.axes[joint].pair.encoder] as f64;
    let scale = loops.scales[joint].counts_per_rad;
    let omega = core::f64::consts::TAU / swing_s;
    let cycles = cell.cycles(SWING_COUNT * swing_s);
    let mut record = Swing::default();
    for cycle in 0..=cycles {
        let t = cycle as f64 * cell.period_s();
        let axis = &mut loops.axes[joint];
        axis.reference = start + scale * amplitude * libm::sin(omega * t);
        axis.speed = scale * amplitude * omega * libm::cos(omega * t);
        let sample = loops.cycle(cell, joint)?;
        record.angles.push(loops.angles(&sample.counts, 0));
        record.codes.push(loops.last_codes);
        record.times_s.push(sample.at.as_secs_f64());
        record.is_disturbed.push(sample.is_disturbed);
    }
    loops.axes[joint].reference = start;
    Ok(record)
}

/// A row for each instant that has a whole window of counts around it, none of them disturbed.
fn analysed(swing: &Swing, loops: &Loops<'_>, joint: usize, known: &MotorTorques) -> Vec<Row> {
    let (n, width) = (loops.model.joints, 2 * HALF_WINDOW + 1);
    let mut rows = Vec::new();
    let mut series = vec![0.0; width];
    // A word acts one cycle after the counts on which it was decided, on average.
    for first in 1..swing.angles.len().saturating_sub(width) {
        if swing.is_disturbed[first - 1..first + width].iter().any(|disturbed| *disturbed) {
            continue;
        }
        let mut fitted = |value: &dyn Fn(usize) -> f64| {
            for (at, slot) in series.iter_mut().enumerate() {
                *slot = value(first + at);
            }
            parabola(&swing.times_s[first..first + width], &series)
        };
        let (mut q, mut qd, mut qdd) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        for j in 0..n {
            [q[j], qd[j], qdd[j]] = fitted(&|at| swing.angles[at][j]);
        }
        let mut torque_nm = loops.model.torque_nm(&q, &qd, &qdd)[joint];
        let sign = |j: usize| loops.motor_sign(j);
        for (other, known) in known.iter().enumerate().take(n) {
            let coupling = loops.model.coupling(other, joint);
            if other == joint || coupling == 0.0 {
                continue;
            }
            let motor = loops.axes[other].pair.motor;
            let [code, ..] = fitted(&|at| f64::from(swing.codes[at - 1][motor]));
            // A coupled motor turns so many times as far for this joint as for its own.
            torque_nm -= coupling * known.unwrap_or(0.0) * sign(other) * code;
        }
        let motor = loops.axes[joint].pair.motor;
        let [code, ..] = fitted(&|at| f64::from(swing.codes[at - 1][motor]));
        rows.push(Row { code: sign(joint) * code, torque_nm, speed_rad_s: qd[joint] });
    }
    rows
}
