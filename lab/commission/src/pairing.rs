//! Which motor turns which encoder, and what joint they are. The torques of all motors grow
//! together, so that the joints that need least are found first. What has not answered by several
//! times the torque that its joint needs does not answer at all, and until then no pulse is so
//! strong, and so long, that a joint whose encoder does not count could jump ([`crate::unseen`]).

use crate::assignment::pairs;
use crate::probe::{PULSE_COUNTS, Pair, Ramp, Response, pulse, response};
use crate::procedure::{Commissioning, Identified};
use crate::stop::Stop;
use crate::unseen::UnseenBounds;
use crate::witness::{Answer, Shown};

/// Times that a witness may ask to see a pulse again.
const LOOKS_MAX: i32 = 10;

/// Counts of a motor's own encoder, on average, by which it has one, while pulses have to be short:
/// an encoder that does not count has none.
const FEW_ANSWER_COUNTS: f64 = 1.5;
/// Pulses by which a joint goes back to where it began: 24 counts away, it takes four of seven.
const RETURNS_MAX: i32 = 6;
/// Least torque that moves a motor, in parts of what short pulses needed.
const REFINED_SHARE_MIN: f64 = 0.5;
/// Largest torque that is tried for it: a little more, so that pulses of another length find it.
const REFINED_RATIO_MAX: f64 = 1.5;

/// A motor that was seen to move a joint.
#[derive(Clone, Copy, Debug)]
struct SeenMotor {
    response: Response,
    /// Whether code and angle grow together: 1 or -1.
    code: f64,
}

impl Commissioning<'_, '_> {
    /// The pairs of motors and encoders, by joint.
    pub(crate) fn identified(&mut self) -> Result<Vec<Identified>, Stop> {
        let bounds = UnseenBounds::new(self.model, self.options.brake_s);
        let code_max = self.cell.code_max;
        let mut ramps: Vec<Ramp> =
            (0..self.cell.motors).map(|motor| Ramp::new(motor, code_max)).collect();
        let mut seen: Vec<Option<SeenMotor>> = vec![None; self.model.joints];
        while seen.iter().any(Option::is_none) {
            let unseen: Vec<usize> =
                (0..seen.len()).filter(|joint| seen[*joint].is_none()).collect();
            let doubtful = self.doubtful(&seen);
            let lowest = (0..ramps.len())
                .min_by(|one, other| ramps[*one].level.total_cmp(&ramps[*other].level));
            let Some(next) = lowest else { return Err(self.unanswered(&ramps, &unseen)) };
            let level = ramps[next].level;
            let longest_s = bounds.longest_s(level, &doubtful);
            let limits = self.limits().bounded(&bounds, &doubtful);
            let most = bounds.code_max(&unseen, self.options.friction_ratio_max);
            let allowed = self.options.torque_share_max * f64::from(code_max);
            if level > allowed.min(most) || longest_s < self.cell.period_s() {
                // A weak motor on a coarse encoder answers with no more than a few counts.
                let most = (0..ramps.len()).max_by_key(|ramp| ramps[*ramp].few_counts());
                let Some(most) = most.filter(|ramp| ramps[*ramp].few_counts() > 0) else {
                    return Err(self.unanswered(&ramps, &unseen));
                };
                let mut ramp = ramps[most];
                ramp.accept_few();
                let Some(response) = response(self.cell, &ramp, limits)? else {
                    return Err(self.unanswered(&ramps, &unseen));
                };
                if !self.add(response, (&bounds, &doubtful), &mut seen)? {
                    return Err(self.unanswered(&ramps, &unseen));
                }
                ramps.remove(most);
                continue;
            }
            if !ramps[next].has_begun {
                let motor = ramps[next].motor;
                let what = format!("single pulses of torque on motor channel {motor}");
                self.allowed(motor, &what)?;
            }
            if !ramps[next].step(self.cell, limits)? {
                continue;
            }
            let ramp = ramps.remove(next);
            if let Some(response) = response(self.cell, &ramp, limits)?
                && !self.add(response, (&bounds, &doubtful), &mut seen)?
            {
                let remedy = "lay a finger on the joints and feel; look at the encoders' cables: \
                              what counts may be moved along by a joint whose encoder does not";
                return Err(Stop::new("nobody saw which joint moves", remedy));
            }
        }
        let mut seen: Vec<SeenMotor> = seen.into_iter().flatten().collect();
        // Every motor has an encoder that counts: no pulse has to be short any more.
        let pairs = self.paired(&seen, FEW_ANSWER_COUNTS)?;
        self.refine_short(&pairs, &mut seen)?;
        let identified = self.paired(&seen, 0.5 * PULSE_COUNTS as f64)?;
        for Identified { pair, .. } in &identified {
            let against = if pair.gain < 0.0 { ", against each other" } else { "" };
            (self.progress)(&format!(
                "motor channel {} turns encoder channel {}{against}",
                pair.motor, pair.encoder
            ));
        }
        Ok(identified)
    }

    /// Measures anew each motor whose pulses had to be short, from where the joints began.
    fn refine_short(&mut self, pairs: &[Identified], seen: &mut [SeenMotor]) -> Result<(), Stop> {
        for at in 0..seen.len() {
            if seen[at].response.is_short {
                self.return_to_start(pairs, seen)?;
                self.refine(&mut seen[at].response)?;
            }
        }
        Ok(())
    }

    /// Moves the joints back to where they began by pulses of their own motors: one that was left
    /// to a side would end each pulse that throws it along a little farther, and two that were left
    /// to opposite sides would end all of them.
    fn return_to_start(&mut self, pairs: &[Identified], seen: &[SeenMotor]) -> Result<(), Stop> {
        for (Identified { pair, .. }, SeenMotor { response, .. }) in pairs.iter().zip(seen) {
            let own = pair.encoder;
            for time in 0..RETURNS_MAX {
                let here = self.cell.counts()[own];
                if here.abs() / self.cell.fineness[own] < PULSE_COUNTS {
                    break;
                }
                let most = self.options.torque_share_max * f64::from(self.cell.code_max);
                let [forth, back] = response.shown_codes(most, time);
                let is_back = here as f64 * pair.gain > 0.0;
                let code = if is_back { back } else { forth };
                pulse(self.cell, response.motor, code, self.limits())?;
            }
        }
        Ok(())
    }

    /// Finds the torque that moves a motor anew, and its gain, by pulses that need not be short.
    fn refine(&mut self, response: &mut Response) -> Result<(), Stop> {
        let (mut ramp, limits) = (Ramp::below(response), self.limits());
        let [up, down] = response.levels;
        while ramp.level <= REFINED_RATIO_MAX * up.max(down) {
            if !ramp.step(self.cell, limits)? {
                continue;
            }
            let Some(better) = crate::probe::response(self.cell, &ramp, limits)? else {
                continue;
            };
            // What moved at much less was let go, not driven, unless it moves so both ways again.
            let is_enough = better.breakaway >= REFINED_SHARE_MIN * response.breakaway;
            if is_enough || better.is_driven {
                *response = better;
                return Ok(());
            }
            ramp = ramp.begun_anew();
        }
        Ok(())
    }

    /// The joints that may still hold an encoder that does not count: those that nobody has seen
    /// move by a motor of their own, and those whose gears are coupled to them. A witness may take
    /// a joint that is moved along for the one that is driven.
    fn doubtful(&self, seen: &[Option<SeenMotor>]) -> Vec<usize> {
        let coupled = |one: usize, other: usize| {
            self.model.coupling(one, other) != 0.0 || self.model.coupling(other, one) != 0.0
        };
        let is_doubtful = |joint: &usize| {
            (0..seen.len()).any(|other| seen[other].is_none() && coupled(*joint, other))
        };
        (0..seen.len()).filter(is_doubtful).collect()
    }

    /// Adds a motor that moves something to the joint that it is seen to move; false where nobody
    /// sees one.
    fn add(
        &mut self,
        response: Response,
        bounds: (&UnseenBounds, &[usize]),
        seen: &mut [Option<SeenMotor>],
    ) -> Result<bool, Stop> {
        let Some((joint, code)) = self.look_at(&response, bounds)? else { return Ok(false) };
        let label = self.model.label(joint);
        let slot = seen.get_mut(joint).ok_or_else(|| {
            Stop::new(format!("the arm has no joint {}", joint + 1), "count them again")
        })?;
        if let Some(other) = slot {
            let what = format!(
                "{label} is moved by motor channels {} and {}",
                other.response.motor, response.motor
            );
            let remedy = "look again: each motor moves one joint; if it is so, the cable of one of \
                          these motors goes to another joint";
            return Err(Stop::new(what, remedy));
        }
        *slot = Some(SeenMotor { response, code });
        Ok(true)
    }

    /// Gives each motor its encoder.
    fn paired(&self, seen: &[SeenMotor], counts_min: f64) -> Result<Vec<Identified>, Stop> {
        let responses: Vec<Response> = seen.iter().map(|motor| motor.response).collect();
        let pairs: Vec<Pair> = pairs(&responses, self.cell.encoders, counts_min)?;
        let identify = |(pair, motor): (Pair, &SeenMotor)| Identified {
            pair,
            counts: motor.code * pair.gain.signum(),
            code: motor.code,
        };
        Ok(pairs.into_iter().zip(seen).map(identify).collect())
    }

    /// What is said when the torque may not grow any more and joints are left.
    fn unanswered(&self, ramps: &[Ramp], unseen: &[usize]) -> Stop {
        let joints: Vec<String> = unseen.iter().map(|joint| self.model.label(*joint)).collect();
        let motors: Vec<String> = ramps.iter().map(|ramp| ramp.motor.to_string()).collect();
        let level = ramps.iter().map(|ramp| ramp.level).fold(f64::INFINITY, f64::min);
        let found = self.model.joints - unseen.len();
        let what = format!(
            "{found} motor channels move an encoder, the arm has {} joints: {} did not answer up \
             to {:.0} % of the largest code",
            self.model.joints,
            joints.join(", "),
            100.0 * level / f64::from(self.cell.code_max)
        );
        let remedy = format!(
            "look at amplifier, brake and cable of motor channels {}, and at the cables of the \
             encoders that did not count; turn the joint by hand and see that its count changes; \
             only if it is stiff raise --friction-ratio or --torque-share",
            motors.join(", ")
        );
        Stop::new(what, remedy)
    }

    /// Which joint a motor moves, and whether its angle grows with the code, by what the witness
    /// sees; `None` where nobody sees any.
    fn look_at(
        &mut self,
        response: &Response,
        (bounds, unseen): (&UnseenBounds, &[usize]),
    ) -> Result<Option<(usize, f64)>, Stop> {
        let most = self.options.torque_share_max * f64::from(self.cell.code_max);
        let encoder = response.own;
        // The first pulse goes back, wherever those before have left the joint.
        self.cell.left_share[response.motor] = 0.0;
        for time in 0..LOOKS_MAX {
            let [forward, back] = response.shown_codes(most, time);
            self.asked(|witness| Ok(witness.look()?.then_some(())))?;
            // The motion that is looked at goes back to where the encoder began.
            let here = self.cell.rest(0.02)?.counts[encoder] as f64;
            let sign = if here * response.own_gain() > 0.0 { -1.0 } else { 1.0 };
            let (first, second) = if sign > 0.0 { (forward, back) } else { (back, forward) };
            let limits = self.limits().bounded(bounds, unseen).shown();
            let forth = pulse(self.cell, response.motor, first, limits)?;
            let counts = forth.moved[encoder];
            let shown = Shown { motor_channel: response.motor, encoder_channel: encoder, counts };
            // Nobody is asked about a motion that was none, or that the gears let go.
            let is_driven = counts as f64 * f64::from(first) * response.own_gain() > 0.0;
            let answer = match is_driven && forth.is_seen(encoder, response.is_few) {
                true => self.asked(|witness| witness.seen(&shown)),
                false => Ok(Answer::Again),
            };
            pulse(self.cell, response.motor, second, limits)?;
            match answer? {
                Answer::Again => {}
                Answer::Moved { joint, grew } => {
                    let (direction, label) =
                        (if grew { "+" } else { "-" }, self.model.label(joint));
                    (self.progress)(&format!("{label} ({direction}): motor {}", response.motor));
                    return Ok(Some((joint, if grew { sign } else { -sign })));
                }
            }
        }
        Ok(None)
    }
}
