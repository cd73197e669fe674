//! Which motor moves which encoder: single pulses of torque that grow until some encoder moves by a
//! few counts, with the brakes on before and after each.

use taktil_hal::{CHANNELS, Nanos};

use crate::cell::{Cell, Drive};
use crate::stop::Stop;
use crate::unseen::UnseenBounds;

/// Counts at which a pulse ends: with the assumption of [`COUNTS_PER_DEG_MIN`] a third of a degree.
pub(crate) const PULSE_COUNTS: i64 = 7;
/// The same for a pulse that somebody is to see: at most half a degree.
const SHOWN_COUNTS: i64 = 12;
/// Counts from the start of an encoder at which any pulse ends.
const AWAY_COUNTS: i64 = 17;
/// Torque of such a pulse over the one that just moves something: little more, so that no other
/// joint is thrown along.
const SHOWN_RATIO: f64 = 1.3;
/// The same where the one before had to be short, and took more torque than the joint needs.
const SHOWN_SHORT_RATIO: f64 = 0.8;
/// From one such pulse to the next one, where nothing was seen.
const SHOWN_AGAIN_RATIO: f64 = 1.15;
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
/// Counts by which a joint answers whose pulses may not get longer, when its torque may not grow
/// any more: a weak motor moves a coarse encoder by no more within the bound for a strong one.
const FEW_COUNTS: i64 = 2;
/// Times that a pulse is given whose cycles are late or fail.
const REPEATS_MAX: usize = 20;
/// Pause after a pulse, with the brakes on (s).
const PAUSE_S: f64 = 0.02;
/// First level of the pulses, in parts of the largest code.
const FIRST_LEVEL: f64 = 0.01;
/// From one level to the next.
const LEVEL_RATIO: f64 = 1.25;
/// From the torque at which short pulses move something to one that moves nothing.
const SHORT_RATIO: f64 = 4.0;
/// Largest ratio of the torques that move a joint one way and the other; gravity makes them differ,
/// but not so much in a pose in which the joint rests.
const LEVELS_RATIO_MAX: f64 = 4.0;
/// Share of the torque at which a motor broke loose that it needs to keep moving.
const SLIDING_SHARE: f64 = 0.9;

/// What a pulse moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pulse {
    pub(crate) moved: [i64; CHANNELS],
    /// Counts at the end of the torque, and how long it acted (s).
    at_end: [i64; CHANNELS],
    acted_s: f64,
    reached: bool,
    /// It was ended because a cycle was late or failed, and is no measure.
    is_disturbed: bool,
}

impl Pulse {
    /// Whether an encoder moved so far that somebody sees it, or by the few counts that are all it
    /// moves by.
    pub(crate) fn is_seen(&self, encoder: usize, is_few: bool) -> bool {
        let least = if is_few { FEW_COUNTS } else { PULSE_COUNTS / 2 };
        self.moved[encoder].abs() >= least
    }

    /// Whether it moved the encoder that `other` moved most, and to the other side, so far that
    /// somebody sees it.
    fn follows(&self, other: &Pulse) -> bool {
        let most = (0..CHANNELS).max_by_key(|encoder| other.moved[*encoder].abs()).unwrap_or(0);
        let back = -self.moved[most] * other.moved[most].signum();
        back >= PULSE_COUNTS / 2
    }

    /// Whether it and `other` moved an encoder to opposite sides, both by what is an answer.
    fn moves_against(&self, other: &Pulse, encoder: usize) -> bool {
        let [one, other] = [self, other].map(|pulse| pulse.at_end[encoder]);
        one * other < 0 && one.abs().min(other.abs()) >= PULSE_COUNTS
    }

    /// Whether the encoder that it moved most has come back since: the pulse may be given again, so
    /// that those to the other side do not add up on a joint whose encoder does not count.
    fn is_undone(&self, cell: &Cell<'_>) -> bool {
        let most = (0..CHANNELS).max_by_key(|encoder| self.moved[*encoder].abs()).unwrap_or(0);
        let here = cell.counts()[most] / cell.fineness[most];
        here * self.moved[most].signum() <= 0
    }
}

/// Settings of the pulses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PulseLimits<'a> {
    /// Largest torque, in parts of the largest code.
    pub(crate) share_max: f64,
    /// Time that brakes take to open (s).
    pub(crate) brake_s: f64,
    /// Counts at which a pulse ends, and its longest time (s).
    counts_max: i64,
    time_s: f64,
    /// What bounds that time for each code, as long as these joints have not answered.
    unanswered: Option<(&'a UnseenBounds, &'a [usize])>,
}

impl<'a> PulseLimits<'a> {
    /// Limits of pulses by which the robot is felt out.
    pub(crate) fn new(share_max: f64, brake_s: f64) -> PulseLimits<'a> {
        PulseLimits {
            share_max,
            brake_s,
            counts_max: PULSE_COUNTS,
            time_s: PULSE_S,
            unanswered: None,
        }
    }

    /// The same limits while these joints have not answered.
    pub(crate) fn bounded(self, bounds: &'a UnseenBounds, unseen: &'a [usize]) -> PulseLimits<'a> {
        PulseLimits { unanswered: Some((bounds, unseen)), ..self }
    }

    /// Limits of a pulse that somebody is to see.
    pub(crate) fn shown(self) -> PulseLimits<'a> {
        PulseLimits { counts_max: SHOWN_COUNTS, time_s: SHOWN_S, ..self }
    }

    /// How long a pulse of this code may act by its bound; `None` where nothing bounds it.
    fn bound_s(&self, code: f64) -> Option<f64> {
        let (bounds, unseen) = self.unanswered?;
        Some(bounds.longest_s(code.abs(), unseen))
    }

    /// How long a pulse of this code may act, where those before have left the joint to one side
    /// (s). Its way grows with the square of its time.
    fn longest_s(&self, code: f64, left_share: f64) -> f64 {
        let Some(bound_s) = self.bound_s(code) else { return self.time_s };
        let left = (left_share * code.signum()).clamp(0.0, 1.0);
        (bound_s * libm::sqrt(1.0 - left)).min(self.time_s)
    }

    /// Whether a pulse of this code has to be shorter than it could be.
    fn is_short(&self, code: f64) -> bool {
        self.bound_s(code).is_some_and(|bound_s| bound_s < PULSE_S)
    }
}

/// How the encoders answer one motor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Response {
    pub(crate) motor: usize,
    /// Code at which it breaks loose, and counts for a positive pulse.
    pub(crate) breakaway: f64,
    pub(crate) levels: [f64; 2],
    pub(crate) counts: [f64; CHANNELS],
    /// Acceleration for one code (counts/s^2).
    pub(crate) gain: [f64; CHANNELS],
    /// The encoder that moved most.
    pub(crate) own: usize,
    /// Its pulses had to be short, so that they took more torque than the motor needs.
    pub(crate) is_short: bool,
    /// It moved its encoder by a few counts only.
    pub(crate) is_few: bool,
    /// Two more pulses moved its encoder to both sides: what the gears let go moves once.
    pub(crate) is_driven: bool,
}

impl Response {
    /// Acceleration of the encoder that moved most, for one code (counts/s^2).
    pub(crate) fn own_gain(&self) -> f64 {
        self.gain[self.own]
    }

    /// Codes that show somebody the motion of this motor, forth and back, the first time or another
    /// one: what was not seen gets a little more torque.
    pub(crate) fn shown_codes(&self, most: f64, time: i32) -> [i32; 2] {
        let ratio = if self.is_short { SHOWN_SHORT_RATIO } else { SHOWN_RATIO };
        let ratio = ratio * libm::pow(SHOWN_AGAIN_RATIO, f64::from(time));
        let [forth, back] = self.levels.map(|level| (ratio * level).min(most));
        [whole(forth), whole(-back)]
    }
}

/// A motor with the encoder on its shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pair {
    pub(crate) motor: usize,
    pub(crate) encoder: usize,
    pub(crate) breakaway: f64,
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

/// One pulse of `code` on a motor; it ends early when any encoder has moved by the limit. One whose
/// cycles were late is given again.
pub(crate) fn pulse(
    cell: &mut Cell<'_>,
    motor: usize,
    code: i32,
    limits: PulseLimits<'_>,
) -> Result<Pulse, Stop> {
    for _ in 0..REPEATS_MAX {
        let pulse = single_pulse(cell, motor, code, limits)?;
        if !pulse.is_disturbed {
            return Ok(pulse);
        }
        cell.punctuality.repeated_pulses += 1;
    }
    let what = format!("none of {REPEATS_MAX} pulses on motor channel {motor} kept its time");
    let remedy = "give this program a priority, such as with `chrt -f 60`, and a quieter host; \
                  look at the board's link with `taktil hal check`";
    Err(cell.fail(Stop::new(what, remedy)))
}

fn single_pulse(
    cell: &mut Cell<'_>,
    motor: usize,
    code: i32,
    limits: PulseLimits<'_>,
) -> Result<Pulse, Stop> {
    let start = cell.step(Drive::Safe)?.counts;
    let mut codes = [0; CHANNELS];
    let longest_s = limits.longest_s(f64::from(code), cell.left_share[motor]);
    // Times are those at which the cycles really began; half a cycle is left to their rounding.
    let (period_s, tolerance_s) = (cell.period_s(), 0.5 * cell.period_s());
    let (mut lifted, mut driven): (Option<Nanos>, Option<Nanos>) = (None, None);
    let mut end = Pulse {
        moved: [0; CHANNELS],
        at_end: [0; CHANNELS],
        acted_s: 0.0,
        reached: false,
        is_disturbed: false,
    };
    loop {
        let sample = cell.sample()?;
        let (now, moved) = (sample.counts, between(&sample.counts, &start));
        let since = |begin: Option<Nanos>| begin.map_or(0.0, |at| (sample.at - at).as_secs_f64());
        let acted_s = since(driven);
        end.reached = largest(&moved, &cell.fineness) >= limits.counts_max;
        end.is_disturbed = driven.is_some() && sample.is_disturbed;
        let over = driven.is_some() && acted_s + period_s > longest_s;
        if end.reached || end.is_disturbed || over || goes_away(&now, &moved, &cell.fineness) {
            // A word acts half a cycle after its release, so that the torque has acted that much
            // shorter.
            end.acted_s = (acted_s - 0.5 * period_s).max(0.5 * period_s);
            end.at_end = moved;
            cell.commit(Drive::Safe)?;
            break;
        }
        let opened = since(lifted) >= limits.brake_s - tolerance_s;
        lifted.get_or_insert(sample.at);
        if opened {
            driven.get_or_insert(sample.at);
        }
        codes[motor] = if opened { code } else { 0 };
        cell.commit(Drive::Codes(codes))?;
    }
    if let Some(bound_s) = limits.bound_s(f64::from(code)) {
        let share = (end.acted_s / bound_s) * (end.acted_s / bound_s);
        cell.left_share[motor] += f64::from(code.signum()) * share;
    }
    let rested = cell.rest(PAUSE_S + limits.brake_s)?.counts;
    end.moved = between(&rested, &start);
    let far = |i: &usize| rested[*i].abs() / cell.fineness[*i] > DRIFT_COUNTS_MAX;
    if let Some(i) = (0..CHANNELS).find(far) {
        let what = format!(
            "encoder channel {i} is {} counts from its start, and nobody knows its direction yet",
            rested[i]
        );
        let remedy = "put the arm into a pose in which it rests by itself with the brakes lifted; \
                      if it does, another joint is driven whose encoder does not count: look at \
                      the encoders' cables";
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

/// A motor on the way to the torque at which an encoder answers it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ramp {
    pub(crate) motor: usize,
    /// The code that is tried next.
    pub(crate) level: f64,
    /// The levels that moved something up and down, with their pulses.
    found: [Option<(f64, Pulse)>; 2],
    /// Its pulses of this level up and down, where they moved something by a few counts.
    few: [Option<(f64, Pulse)>; 2],
    /// They were taken for its answer.
    is_few: bool,
    /// The side to which its last pulse went: 1 or -1.
    last_sign: f64,
    pub(crate) has_begun: bool,
}

impl Ramp {
    /// At the first level.
    pub(crate) fn new(motor: usize, code_max: i32) -> Ramp {
        let level = (FIRST_LEVEL * f64::from(code_max)).max(1.0);
        Ramp {
            motor,
            level,
            found: [None; 2],
            few: [None; 2],
            is_few: false,
            last_sign: -1.0,
            has_begun: false,
        }
    }

    /// The motor that answered so, from well below its torque.
    pub(crate) fn below(response: &Response) -> Ramp {
        let level = response.levels[0].min(response.levels[1]) / SHORT_RATIO;
        let motor = response.motor;
        Ramp {
            motor,
            level,
            found: [None; 2],
            few: [None; 2],
            is_few: false,
            last_sign: -1.0,
            has_begun: false,
        }
    }

    /// The same motor at the level that comes next, without what has moved so far.
    pub(crate) fn begun_anew(self) -> Ramp {
        Ramp { found: [None; 2], few: [None; 2], ..self }
    }

    /// By how many counts some encoder follows the last short pulses, up and down; 0 where none
    /// does.
    pub(crate) fn few_counts(&self) -> i64 {
        let [Some((_, up)), Some((_, down))] = &self.few else { return 0 };
        let both = up.moved.iter().zip(&down.moved);
        let against = both.filter(|(up, down)| up.signum() * down.signum() < 0);
        against.map(|(up, down)| up.abs().min(down.abs())).max().unwrap_or(0)
    }

    /// Takes the few counts of its short pulses for an answer.
    pub(crate) fn accept_few(&mut self) {
        self.found = self.few;
        self.is_few = true;
    }

    /// Gives the pulses of this level and goes on to the next one; whether something has moved both
    /// ways.
    pub(crate) fn step(
        &mut self,
        cell: &mut Cell<'_>,
        limits: PulseLimits<'_>,
    ) -> Result<bool, Stop> {
        if !self.has_begun {
            // What the gears still hold from the motion before lets go first.
            pulse(cell, self.motor, 0, limits)?;
            self.has_begun = true;
        }
        for (direction, sign) in [1.0, -1.0].into_iter().enumerate() {
            if self.found[direction].is_some_and(|(_, pulse)| !pulse.is_undone(cell)) {
                continue;
            }
            // While nothing has answered, pulses to both sides are to cancel. Where one side has,
            // the other one may need more torque.
            if self.found != [None; 2] {
                cell.left_share[self.motor] = 0.0;
            }
            let pulse = pulse(cell, self.motor, whole(sign * self.level), limits)?;
            self.last_sign = sign;
            let moves_little = largest(&pulse.moved, &cell.fineness) >= FEW_COUNTS;
            let is_few = moves_little && limits.is_short(self.level);
            self.few[direction] = is_few.then_some((self.level, pulse));
            let found = pulse.reached.then_some((self.level, pulse));
            self.found[direction] = self.found[direction].or(found);
        }
        for direction in [0, 1] {
            // What follows to this side nearly as far as to the other one is driven, not let go.
            if let (Some((_, reached)), None, Some((_, few))) =
                (&self.found[1 - direction], &self.found[direction], &self.few[direction])
                && few.follows(reached)
            {
                self.found[direction] = self.few[direction];
            }
        }
        if let [Some(up), Some(down)] = &mut self.found
            && up.0.max(down.0) > LEVELS_RATIO_MAX * up.0.min(down.0)
        {
            // What moved at so little torque was let go, not driven: it is tried again.
            let weaker = usize::from(down.0 < up.0);
            self.found[weaker] = None;
            self.level /= 2.0;
        }
        self.level *= LEVEL_RATIO;
        Ok(self.found.iter().all(Option::is_some))
    }
}

/// How the encoders answer a motor that has moved something both ways; `None` for another one.
pub(crate) fn response(
    cell: &mut Cell<'_>,
    ramp: &Ramp,
    limits: PulseLimits<'_>,
) -> Result<Option<Response>, Stop> {
    let (motor, most) = (ramp.motor, f64::from(cell.code_max));
    let is_short = ramp.found.iter().flatten().any(|(level, _)| limits.is_short(*level));
    let [Some(up), Some(down)] = ramp.found else { return Ok(None) };
    let breakaway = 0.5 * (up.0 + down.0);
    let counts = core::array::from_fn(|i| 0.5 * (up.1.moved[i] - down.1.moved[i]) as f64);
    let strong = (2.0 * breakaway).min(limits.share_max * most);
    let excess = (strong - SLIDING_SHARE * breakaway).max(1.0);
    let strong_code = whole(strong);
    // Each pair begins with the way back.
    let push = |cell: &mut Cell<'_>| -> Result<[Pulse; 2], Stop> {
        let way_back = if ramp.last_sign > 0.0 { -strong_code } else { strong_code };
        let first = pulse(cell, motor, way_back, limits)?;
        let second = pulse(cell, motor, -way_back, limits)?;
        Ok(if way_back > 0 { [first, second] } else { [second, first] })
    };
    let mut pushes = push(cell)?;
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
        pushes = push(cell)?;
    }
    let mut gain = [0.0; CHANNELS];
    for (sign, pulse) in [1.0, -1.0].into_iter().zip(pushes) {
        for (gain, moved) in gain.iter_mut().zip(pulse.at_end) {
            let acceleration = 2.0 * moved as f64 / (pulse.acted_s * pulse.acted_s);
            *gain += 0.5 * sign * acceleration / excess;
        }
    }
    Ok(Some(Response {
        motor,
        breakaway,
        levels: [up.0, down.0],
        counts,
        gain,
        own,
        is_short,
        is_few: ramp.is_few,
        is_driven: pushes[0].moves_against(&pushes[1], own),
    }))
}

/// A code nearest to a number.
#[expect(clippy::cast_possible_truncation, reason = "codes have at most 24 bits")]
pub(crate) fn whole(code: f64) -> i32 {
    code.round() as i32
}
