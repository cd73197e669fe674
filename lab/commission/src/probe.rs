//! Which motor moves which encoder: single pulses of torque that grow until some encoder moves by a
//! few counts, with the brakes on before and after each.

use taktil_hal::CHANNELS;

use crate::cell::{Cell, Drive};
use crate::stop::Stop;

/// Counts at which a pulse ends: with the assumption of [`COUNTS_PER_DEG_MIN`] a third of a degree.
pub(crate) const PULSE_COUNTS: i64 = 8;
/// The same for a pulse that somebody is to see: at most six tenths of a degree.
const SHOWN_COUNTS: i64 = 14;
/// Counts from the start of an encoder at which any pulse ends.
const AWAY_COUNTS: i64 = 17;
/// Torque of such a pulse over the one that just moves something: little more, so that no other
/// joint is thrown along.
const SHOWN_RATIO: f64 = 1.3;
/// Counts that any encoder may be away from its start before directions are known.
pub(crate) const DRIFT_COUNTS_MAX: i64 = 24;
/// Coarsest encoder for which the limits above keep a joint within one degree (counts per degree of
/// the joint).
pub(crate) const COUNTS_PER_DEG_MIN: f64 = 24.0;
/// Longest pulse (s), and longest one that somebody is to see.
const PULSE_S: f64 = 0.05;
const SHOWN_S: f64 = 0.15;
/// An encoder that reaches the limit of a pulse in a shorter time is a fine one: within it no motor
/// at twice the torque that overcomes its friction moves a joint by a quarter of a degree (s).
const FINE_S: f64 = 0.02;
/// Largest factor on the limits for fine encoders.
const FINENESS_MAX: i64 = 4;
/// Pause after a pulse, with the brakes on (s).
const PAUSE_S: f64 = 0.02;
/// First level of the pulses, in parts of the largest code.
const FIRST_LEVEL: f64 = 0.01;
/// From one level to the next.
const LEVEL_RATIO: f64 = 1.25;
/// Largest ratio of the torques that move a joint one way and the other; gravity makes them differ,
/// but not so much in a pose in which the joint rests.
const LEVELS_RATIO_MAX: f64 = 4.0;
/// Counts for an encoder that did not move, so that a product of responses stays a measure.
const NO_RESPONSE_COUNTS: f64 = 0.25;
/// Share of the torque at which a motor broke loose that it needs to keep moving.
const SLIDING_SHARE: f64 = 0.9;

/// What a pulse moved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pulse {
    pub(crate) moved: [i64; CHANNELS],
    /// Counts at the end of the torque, and how long it acted (s).
    at_end: [i64; CHANNELS],
    acted_s: f64,
    reached: bool,
}

/// Settings of the pulses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PulseLimits {
    /// Largest torque, in parts of the largest code.
    pub(crate) share_max: f64,
    /// Time that brakes take to open (s).
    pub(crate) brake_s: f64,
    /// Counts at which a pulse ends, and its longest time (s).
    counts_max: i64,
    time_s: f64,
}

impl PulseLimits {
    /// Limits of pulses by which the robot is felt out.
    pub(crate) fn new(share_max: f64, brake_s: f64) -> PulseLimits {
        PulseLimits { share_max, brake_s, counts_max: PULSE_COUNTS, time_s: PULSE_S }
    }

    /// Limits of a pulse that somebody is to see.
    pub(crate) fn shown(self) -> PulseLimits {
        PulseLimits { counts_max: SHOWN_COUNTS, time_s: SHOWN_S, ..self }
    }
}

/// How the encoders answer one motor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Response {
    pub(crate) motor: usize,
    /// Code at which it breaks loose, and counts for a positive pulse.
    pub(crate) breakaway: f64,
    levels: [f64; 2],
    counts: [f64; CHANNELS],
    /// Acceleration for one code (counts/s^2).
    gain: [f64; CHANNELS],
}

impl Pair {
    /// Codes that show somebody the motion of this motor, forth and back.
    pub(crate) fn shown_codes(&self, most: f64) -> [i32; 2] {
        let [forth, back] = self.levels.map(|level| (SHOWN_RATIO * level).min(most));
        [whole(forth), whole(-back)]
    }
}

/// A motor with the encoder on its shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pair {
    pub(crate) motor: usize,
    pub(crate) encoder: usize,
    pub(crate) breakaway: f64,
    /// The same for positive and for negative codes: gravity makes them differ.
    levels: [f64; 2],
    /// Acceleration for one code, negative where they count and drive against each other
    /// (counts/s^2).
    pub(crate) gain: f64,
}

/// The farthest motion, in counts of the coarsest encoder.
fn largest(counts: &[i64; CHANNELS], fineness: &[i64; CHANNELS]) -> i64 {
    counts.iter().zip(fineness).map(|(count, fine)| count.abs() / fine).max().unwrap_or(0)
}

fn between(now: &[i64; CHANNELS], start: &[i64; CHANNELS]) -> [i64; CHANNELS] {
    core::array::from_fn(|i| now[i] - start[i])
}

/// Whether an encoder is far from its start and this pulse takes it farther.
fn goes_away(now: &[i64; CHANNELS], moved: &[i64; CHANNELS], fineness: &[i64; CHANNELS]) -> bool {
    let mut all = now.iter().zip(moved).zip(fineness);
    all.any(|((now, moved), fine)| now.abs() / fine >= AWAY_COUNTS && now * moved > 0)
}

/// One pulse of `code` on a motor; it ends early when any encoder has moved by the limit.
pub(crate) fn pulse(
    cell: &mut Cell<'_>,
    motor: usize,
    code: i32,
    limits: PulseLimits,
) -> Result<Pulse, Stop> {
    let start = cell.step(Drive::Safe)?.counts;
    let mut codes = [0; CHANNELS];
    let (opening, lasting) = (cell.cycles(limits.brake_s), cell.cycles(limits.time_s));
    let mut end =
        Pulse { moved: [0; CHANNELS], at_end: [0; CHANNELS], acted_s: 0.0, reached: false };
    for cycle in 0..=opening + lasting {
        let now = cell.sample()?.counts;
        let moved = between(&now, &start);
        end.reached = largest(&moved, &cell.fineness) >= limits.counts_max;
        let away = goes_away(&now, &moved, &cell.fineness);
        if end.reached || away || cycle == opening + lasting {
            // A word acts half a cycle after its release, so that the torque has acted that much
            // shorter.
            end.acted_s = (cycle as f64 - opening as f64 - 0.5).max(0.5) * cell.period_s();
            end.at_end = moved;
            cell.commit(Drive::Safe)?;
            break;
        }
        codes[motor] = if cycle < opening { 0 } else { code };
        cell.commit(Drive::Codes(codes))?;
    }
    let rested = cell.rest(PAUSE_S + limits.brake_s)?.counts;
    end.moved = between(&rested, &start);
    let far = |i: &usize| rested[*i].abs() / cell.fineness[*i] > DRIFT_COUNTS_MAX;
    if let Some(i) = (0..CHANNELS).find(far) {
        let what = format!(
            "encoder channel {i} is {} counts from its start, and nobody knows its direction yet",
            rested[i]
        );
        let remedy = "put the arm into a pose in which it rests by itself with the brakes lifted";
        return Err(cell.fail(Stop::new(what, remedy)));
    }
    Ok(end)
}

/// Lifts the brakes without torque: a robot that moves then cannot be commissioned in this pose.
pub(crate) fn rests(cell: &mut Cell<'_>, time_s: f64) -> Result<(), Stop> {
    let start = cell.rest(PAUSE_S)?.counts;
    for _ in 0..cell.cycles(time_s) {
        let now = cell.sample()?.counts;
        let moved = between(&now, &start);
        if let Some(i) = moved.iter().position(|count| count.abs() >= PULSE_COUNTS) {
            cell.commit(Drive::Safe)?;
            let what = format!("the arm moves without torque when its brakes lift: encoder {i}");
            let remedy = "put it into a pose in which it rests by itself, such as straight up";
            return Err(cell.fail(Stop::new(what, remedy)));
        }
        cell.commit(Drive::Loose)?;
    }
    cell.rest(PAUSE_S)?;
    Ok(())
}

/// Finds the torque that moves something and how the encoders answer; `None` for a motor that moves
/// nothing.
pub(crate) fn response(
    cell: &mut Cell<'_>,
    motor: usize,
    limits: PulseLimits,
) -> Result<Option<Response>, Stop> {
    let most = f64::from(cell.code_max);
    let mut level = (FIRST_LEVEL * most).max(1.0);
    let mut found: [Option<(f64, Pulse)>; 2] = [None; 2];
    // What the gears still hold from the motion before lets go first.
    pulse(cell, motor, 0, limits)?;
    while found.iter().any(Option::is_none) {
        if level > limits.share_max * most {
            return Ok(None);
        }
        for (direction, sign) in [1.0, -1.0].into_iter().enumerate() {
            if found[direction].is_none() {
                let pulse = pulse(cell, motor, whole(sign * level), limits)?;
                found[direction] = pulse.reached.then_some((level, pulse));
            }
        }
        if let [Some(up), Some(down)] = &mut found
            && up.0.max(down.0) > LEVELS_RATIO_MAX * up.0.min(down.0)
        {
            // What moved at so little torque was let go, not driven: it is tried again.
            let weaker = usize::from(down.0 < up.0);
            found[weaker] = None;
            level /= 2.0;
        }
        level *= LEVEL_RATIO;
    }
    let [Some(up), Some(down)] = found else { return Ok(None) };
    let breakaway = 0.5 * (up.0 + down.0);
    let counts = core::array::from_fn(|i| 0.5 * (up.1.moved[i] - down.1.moved[i]) as f64);
    let strong = (2.0 * breakaway).min(limits.share_max * most);
    let excess = (strong - SLIDING_SHARE * breakaway).max(1.0);
    let strong_code = whole(strong);
    let mut pushes =
        [pulse(cell, motor, strong_code, limits)?, pulse(cell, motor, -strong_code, limits)?];
    let mut own = 0;
    for i in 0..CHANNELS {
        if up.1.moved[i].abs() > up.1.moved[own].abs() {
            own = i;
        }
    }
    let was_quick = |push: &Pulse, fineness: i64| {
        push.acted_s < FINE_S && push.at_end[own].abs() / fineness >= PULSE_COUNTS
    };
    while pushes.iter().any(|push| was_quick(push, cell.fineness[own]))
        && cell.fineness[own] < FINENESS_MAX
    {
        cell.fineness[own] *= 2;
        pushes =
            [pulse(cell, motor, strong_code, limits)?, pulse(cell, motor, -strong_code, limits)?];
    }
    let mut gain = [0.0; CHANNELS];
    for (sign, pulse) in [1.0, -1.0].into_iter().zip(pushes) {
        for (gain, moved) in gain.iter_mut().zip(pulse.at_end) {
            let acceleration = 2.0 * moved as f64 / (pulse.acted_s * pulse.acted_s);
            *gain += 0.5 * sign * acceleration / excess;
        }
    }
    Ok(Some(Response { motor, breakaway, levels: [up.0, down.0], counts, gain }))
}

/// A code nearest to a number.
#[expect(clippy::cast_possible_truncation, reason = "codes have at most 24 bits")]
pub(crate) fn whole(code: f64) -> i32 {
    code.round() as i32
}

/// Gives each motor the encoder on its shaft. Gears that are coupled let a motor move the encoders
/// of others; but never in a circle, so that only one choice leaves no motor without an answer.
pub(crate) fn pairs(responses: &[Response], encoders: usize) -> Result<Vec<Pair>, Stop> {
    let mut best = Choice { measure: f64::NEG_INFINITY, encoders: Vec::new() };
    choose(responses, encoders, &mut Choice { measure: 0.0, encoders: Vec::new() }, &mut best);
    let mut pairs = Vec::new();
    for (response, encoder) in responses.iter().zip(&best.encoders) {
        if response.counts[*encoder].abs() < 0.5 * PULSE_COUNTS as f64 {
            let what = format!("no encoder of its own follows motor channel {}", response.motor);
            let remedy = "look at the encoder's cable and at the counter's setting";
            return Err(Stop::new(what, remedy));
        }
        pairs.push(Pair {
            motor: response.motor,
            encoder: *encoder,
            breakaway: response.breakaway,
            levels: response.levels,
            gain: response.gain[*encoder],
        });
    }
    Ok(pairs)
}

/// An encoder for each of the first motors, and the logarithm of the product of their answers.
#[derive(Clone)]
struct Choice {
    measure: f64,
    encoders: Vec<usize>,
}

fn choose(responses: &[Response], encoders: usize, chosen: &mut Choice, best: &mut Choice) {
    let Some(response) = responses.get(chosen.encoders.len()) else {
        if chosen.measure > best.measure {
            best.clone_from(chosen);
        }
        return;
    };
    for encoder in 0..encoders {
        if chosen.encoders.contains(&encoder) {
            continue;
        }
        let answer = libm::log(response.counts[encoder].abs().max(NO_RESPONSE_COUNTS));
        chosen.measure += answer;
        chosen.encoders.push(encoder);
        choose(responses, encoders, chosen, best);
        chosen.encoders.pop();
        chosen.measure -= answer;
    }
}
