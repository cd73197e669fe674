//! Moves one joint by its motor's encoder, with the motors that are coupled to it following: to a
//! stop, or back to a place. What the joints need of each other's gears is known by then, because
//! the outer joints come first.

use taktil_hal::CHANNELS;

use crate::cell::{Cell, Drive, Sample};
use crate::model::Model;
use crate::servo::{Axis, codes};
use crate::stop::Stop;

/// Speed until the counts of a turn are known, and afterwards (rad/s, by what is known of the
/// joint's scale).
const SLOW_RAD_S: f64 = 0.14;
const TRAVEL_RAD_S: f64 = 0.7;
/// Largest speed of a motor that follows a coupling (rad/s of its joint).
const FOLLOWING_RAD_S: f64 = 1.2;
/// How far a motor may be from where it is to be: so many times the largest error that drives it,
/// and so many counts.
const AWAY_LEADS: f64 = 1.5;
const AWAY_COUNTS: f64 = 20.0;
/// A joint that gets no farther than a tenth of its way in this time stands at a stop (s).
const STALL_S: f64 = 0.3;
/// Time in which a motion comes up to its speed (s).
const BEGIN_S: f64 = 0.6;
/// Torque in breakaway torques by which a joint moves that is not at a stop, however its loop held
/// it before.
const BEGIN_BREAKAWAYS: f64 = 3.0;
/// Turns of a joint after which there is no stop.
const TURNS_MAX: f64 = 4.0;

/// A joint as far as it is known: its loop, its scale.
#[derive(Clone, Debug)]
pub(crate) struct Scale {
    /// Counts for one rad of the joint, with the direction in which they grow; an estimate at
    /// first.
    pub(crate) counts_per_rad: f64,
    /// Counts in a motor turn, once the index pulses have told.
    pub(crate) counts_per_rev: Option<f64>,
}

/// The motors in their loops, with what is known of the joints; all lists are by joint.
pub(crate) struct Loops<'a> {
    pub(crate) axes: Vec<Axis>,
    pub(crate) scales: Vec<Scale>,
    pub(crate) model: &'a Model,
    /// Largest code.
    pub(crate) code_max: f64,
    /// The codes of the latest cycle, by channel.
    pub(crate) last_codes: [i32; CHANNELS],
    /// Where each motor stood when the joint that moves now began to (counts).
    bases: Vec<f64>,
    origin: f64,
}

/// The pulses of one encoder while its motor turned one way.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pulses {
    last: Option<i64>,
    /// Pulses that came while the loop looked, in order.
    pub(crate) places: Vec<i64>,
}

impl Pulses {
    fn look(&mut self, sample: &Sample, encoder: usize) {
        let now = sample.pulses[encoder];
        if now != self.last {
            self.last = now;
            self.places.extend(now);
        }
    }

    /// Counts between two neighbouring pulses.
    pub(crate) fn spacings(&self) -> impl Iterator<Item = i64> {
        self.places.windows(2).map(|two| (two[1] - two[0]).abs())
    }
}

/// Watches whether a joint on its way to a stop stands still.
struct Standstill {
    /// Counts at the start, and counts and codes of the latest cycles.
    start: f64,
    before: Vec<f64>,
    driven: Vec<f64>,
    cycle: usize,
    /// The cycle from which on it is to move.
    began: usize,
    /// Whether it has moved, or had torque enough for that: the loop that held it may have pulled
    /// the other way, and has to change its mind first.
    has_begun: bool,
}

impl Standstill {
    fn new(start: f64, memory: usize) -> Standstill {
        let (before, driven) = (vec![start; memory], vec![0.0; memory]);
        Standstill { start, before, driven, cycle: 0, began: 0, has_begun: false }
    }

    /// Takes the counts and the code of a cycle, of a joint that is to move at `speed` (counts/s)
    /// and does so by `code_enough`; returns the code before the standstill if it stands still.
    fn look(
        &mut self,
        here: f64,
        code: f64,
        speed: f64,
        code_enough: f64,
        begin: usize,
    ) -> Option<f64> {
        let slot = self.cycle % self.before.len();
        let moved = (here - std::mem::replace(&mut self.before[slot], here)).abs();
        let code_then = std::mem::replace(&mut self.driven[slot], code);
        let little = 0.1 * speed.abs() * STALL_S;
        if !self.has_begun {
            let is_driven = code.abs() >= code_enough;
            self.has_begun = (here - self.start) * speed.signum() > little || is_driven;
            self.began = self.cycle;
        }
        let is_due = self.cycle - self.began > begin.max(self.before.len());
        self.cycle += 1;
        (is_due && moved < little).then_some(code_then)
    }
}

impl<'a> Loops<'a> {
    /// The motors at rest where they are.
    pub(crate) fn new(
        axes: Vec<Axis>,
        scales: Vec<Scale>,
        model: &'a Model,
        code_max: f64,
    ) -> Self {
        let bases = axes.iter().map(|axis| axis.reference).collect();
        Loops { axes, scales, model, code_max, last_codes: [0; CHANNELS], bases, origin: 0.0 }
    }

    /// The joint `joint` is the one that moves from now on.
    fn begin(&mut self, joint: usize) {
        self.bases = self.axes.iter().map(|axis| axis.reference).collect();
        self.origin = self.axes[joint].reference;
    }

    /// One cycle: the coupled motors follow joint `joint`, all loops are closed.
    pub(crate) fn cycle(&mut self, cell: &mut Cell<'_>, joint: usize) -> Result<Sample, Stop> {
        let sample = cell.sample()?;
        self.commit(cell, joint, &sample)?;
        Ok(sample)
    }

    fn commit(&mut self, cell: &mut Cell<'_>, joint: usize, now: &Sample) -> Result<(), Stop> {
        let period_s = cell.period_s();
        let turned = (self.axes[joint].reference - self.origin) / self.scales[joint].counts_per_rad;
        for motor in 0..self.axes.len() {
            let coupling = self.model.coupling(motor, joint);
            if motor == joint || coupling == 0.0 {
                continue;
            }
            let scale = self.scales[motor].counts_per_rad;
            let most = FOLLOWING_RAD_S * scale.abs() * period_s;
            let axis = &mut self.axes[motor];
            let step = self.bases[motor] + scale * coupling * turned - axis.reference;
            let step = step.clamp(-most, most);
            axis.reference += step;
            axis.speed = step / period_s;
        }
        for (i, axis) in self.axes.iter().enumerate() {
            let away = axis.reference - now.counts[axis.pair.encoder] as f64;
            if away.abs() > AWAY_LEADS * axis.braking_lead() + AWAY_COUNTS {
                return Err(cell.fail(runs_away(&self.model.label(i))));
            }
        }
        self.last_codes = codes(&mut self.axes, &now.counts, period_s, self.code_max);
        cell.commit(Drive::Codes(self.last_codes))
    }

    /// Stands still for a while, with all loops closed.
    pub(crate) fn settle(&mut self, cell: &mut Cell<'_>, time_s: f64) -> Result<Sample, Stop> {
        for axis in &mut self.axes {
            axis.speed = 0.0;
        }
        self.begin(0);
        let mut sample = self.cycle(cell, 0)?;
        for _ in 1..cell.cycles(time_s) {
            sample = self.cycle(cell, 0)?;
        }
        Ok(sample)
    }

    /// Moves a joint towards growing (`+1`) or falling (`-1`) angles until it stands at a stop;
    /// returns all counts there.
    pub(crate) fn seek_stop(
        &mut self,
        cell: &mut Cell<'_>,
        joint: usize,
        direction: f64,
        pulses: &mut Pulses,
    ) -> Result<[i64; CHANNELS], Stop> {
        let (encoder, period_s) = (self.axes[joint].pair.encoder, cell.period_s());
        self.begin(joint);
        self.axes[joint].gentle = true;
        let memory = cell.cycles(STALL_S).max(2);
        let pair = self.axes[joint].pair;
        let mut standstill: Option<Standstill> = None;
        let code_enough = (BEGIN_BREAKAWAYS * pair.breakaway).min(self.code_max - 1.0);
        *pulses = Pulses { last: pulses.last, places: Vec::new() };
        let mut travelled = 0.0;
        loop {
            let sample = cell.sample()?;
            pulses.look(&sample, encoder);
            let here = sample.counts[encoder] as f64;
            let watch = standstill.get_or_insert_with(|| Standstill::new(here, memory));
            if self.learn_turn(joint, pulses) {
                // From here on it goes faster; what it did before is no measure.
                watch.began = watch.cycle;
            }
            let scale = self.scales[joint].counts_per_rad;
            let known = self.scales[joint].counts_per_rev.is_some();
            let speed = direction * scale * if known { TRAVEL_RAD_S } else { SLOW_RAD_S };
            let (code, begin) = (f64::from(self.last_codes[pair.motor]), cell.cycles(BEGIN_S));
            if let Some(code_then) = watch.look(here, code, speed, code_enough, begin) {
                // At a stop the torque grows only after the joint has stood still; one that is too
                // weak gave all it has before.
                if code_then.abs() >= self.code_max - 1.0 {
                    return Err(cell.fail(too_weak(&self.model.label(joint))));
                }
                self.axes[joint].speed = 0.0;
                self.axes[joint].reference = here;
                self.axes[joint].gentle = false;
                self.commit(cell, joint, &sample)?;
                return Ok(sample.counts);
            }
            let axis = &mut self.axes[joint];
            let lead = axis.lead();
            axis.speed = speed;
            let next = axis.reference + speed * period_s;
            axis.reference =
                if speed > 0.0 { next.min(here + lead) } else { next.max(here - lead) };
            travelled += (speed * period_s / scale).abs();
            self.commit(cell, joint, &sample)?;
            if travelled > TURNS_MAX * core::f64::consts::TAU {
                let what = format!("{} met no stop in {TURNS_MAX} turns", self.model.label(joint));
                let remedy = "is it the joint that the witness named? is its coupling engaged?";
                return Err(cell.fail(Stop::new(what, remedy)));
            }
        }
    }

    /// Takes the counts of a turn from the first two pulses, and with them a better estimate of the
    /// joint's scale; whether it did so now.
    fn learn_turn(&mut self, joint: usize, pulses: &Pulses) -> bool {
        let scale = &mut self.scales[joint];
        if scale.counts_per_rev.is_some() {
            return false;
        }
        let Some(turn) = pulses.spacings().next() else { return false };
        let turn = turn as f64;
        scale.counts_per_rev = Some(turn);
        let per_rad = turn * self.model.gear[joint] / core::f64::consts::TAU;
        scale.counts_per_rad = per_rad.copysign(scale.counts_per_rad);
        true
    }

    /// Moves a joint to a count and waits until it is there.
    pub(crate) fn move_to(
        &mut self,
        cell: &mut Cell<'_>,
        joint: usize,
        counts: f64,
    ) -> Result<(), Stop> {
        let period_s = cell.period_s();
        self.begin(joint);
        let scale = self.scales[joint].counts_per_rad.abs();
        let most = TRAVEL_RAD_S * scale * period_s;
        let start = self.axes[joint].reference;
        let encoder = self.axes[joint].pair.encoder;
        let expected = (counts - start).abs() / most;
        let mut cycle = 0;
        while (self.axes[joint].reference - counts).abs() > 1e-9 {
            let sample = cell.sample()?;
            let here = sample.counts[encoder] as f64;
            let axis = &mut self.axes[joint];
            let lead = axis.lead();
            let step = (counts - axis.reference).clamp(-most, most);
            axis.speed = if step.abs() < most { 0.0 } else { step / period_s };
            axis.reference = (axis.reference + step).clamp(here - lead, here + lead);
            self.commit(cell, joint, &sample)?;
            cycle += 1;
            if f64::from(cycle) > 4.0 * expected + 4000.0 {
                let what = format!("{} does not come back", self.model.label(joint));
                let remedy = "look whether something is in its way";
                return Err(cell.fail(Stop::new(what, remedy)));
            }
        }
        self.settle(cell, 0.5)?;
        Ok(())
    }

    /// Takes the gain of a loop from the torque of one code at its joint (N m) and the inertia of
    /// the arm's model. A torque that makes no sense changes nothing.
    pub(crate) fn take_gain(&mut self, joint: usize, nm_per_code: f64) {
        let still = vec![0.0; self.model.joints];
        let mut unit = still.clone();
        unit[joint] = 1.0;
        let home = &self.model.home_rad;
        let resting = self.model.torque_nm(home, &still, &still)[joint];
        let inertia = self.model.torque_nm(home, &still, &unit)[joint] - resting;
        let gain = nm_per_code / inertia * self.scales[joint].counts_per_rad.abs();
        if gain.is_finite() && gain > 0.0 {
            let axis = &mut self.axes[joint];
            axis.pair.gain = gain.copysign(axis.pair.gain);
        }
    }

    /// Whether a positive code drives the joint towards growing angles: 1 or -1.
    pub(crate) fn motor_sign(&self, joint: usize) -> f64 {
        self.axes[joint].pair.gain.signum() * self.scales[joint].counts_per_rad.signum()
    }

    /// The angles of all joints at these counts (rad), with the joints of unknown scale at home.
    pub(crate) fn angles(&self, counts: &[i64; CHANNELS], known_from: usize) -> Vec<f64> {
        let mut q = self.model.home_rad.clone();
        for motor in known_from..q.len() {
            let encoder = self.axes[motor].pair.encoder;
            let turned = counts[encoder] as f64 / self.scales[motor].counts_per_rad;
            let home = &self.model.home_rad;
            let inner = q.iter().zip(home).take(motor).enumerate();
            let coupled: f64 = inner
                .map(|(joint, (q, home))| self.model.coupling(motor, joint) * (q - home))
                .sum();
            q[motor] += turned - coupled;
        }
        q
    }
}

fn too_weak(label: &str) -> Stop {
    let what = format!("{label} stands still at the largest torque that is allowed");
    let remedy = "allow more with --torque-share if gravity holds it; otherwise look what does";
    Stop::new(what, remedy)
}

fn runs_away(label: &str) -> Stop {
    let what = format!("{label} is not where its loop wants it");
    let remedy =
        "look what pushes or holds it; allow more torque with --torque-share if it is weak";
    Stop::new(what, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEED_COUNTS_S: f64 = 1000.0;
    const MEMORY_CYCLES: usize = 120;
    const BEGIN_CYCLES: usize = 240;
    const CODE_ENOUGH: f64 = 600.0;

    /// The cycle in which a joint that stands at these counts, driven by these codes, is said to
    /// stand still, of the first thousand.
    fn stood_still(here: fn(u32) -> f64, code: fn(u32) -> f64) -> Option<u32> {
        let mut watch = Standstill::new(here(0), MEMORY_CYCLES);
        (0..1000).find(|i| {
            watch.look(here(*i), code(*i), SPEED_COUNTS_S, CODE_ENOUGH, BEGIN_CYCLES).is_some()
        })
    }

    #[test]
    fn a_joint_whose_loop_still_pulls_the_other_way_is_not_at_a_stop() {
        let slowly = |i: u32| f64::from(i) - 300.0;
        assert_eq!(stood_still(|_| -102.0, |i| f64::from(i.min(500))), None);
        // It breaks loose late, and goes on.
        let late = |i: u32| 2.5 * f64::from(i.saturating_sub(300));
        assert_eq!(stood_still(late, slowly), None);
    }

    #[test]
    fn a_joint_that_moved_or_had_torque_enough_stands_still_at_its_stop() {
        // It stands at a stop from the first: a motion would have begun after the torque came.
        assert_eq!(stood_still(|_| 0.0, |i| 3.0 * f64::from(i)), Some(200 + 241));
        // It goes for 400 cycles, and stands; its first 30 counts took 13 of them.
        let stops = |i: u32| 2.5 * f64::from(i.min(400));
        let found = stood_still(stops, |_| 200.0);
        assert!(found.is_some_and(|cycle| (500..=520).contains(&cycle)), "{found:?}");
    }
}
