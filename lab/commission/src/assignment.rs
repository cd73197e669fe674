//! The assignment of encoders to motors that fits the answers of all motors best.

use crate::probe::{Pair, Response};
use crate::stop::Stop;

/// Counts for an encoder that did not move, so that a product of responses stays a measure.
const NO_RESPONSE_COUNTS: f64 = 0.25;

/// Gives each motor the encoder on its shaft. Gears that are coupled let a motor move the encoders
/// of others; but never in a circle, so that only one choice leaves no motor without an answer. A
/// motor whose encoder moved by less than `counts_min` has none.
pub(crate) fn pairs(
    responses: &[Response],
    encoders: usize,
    counts_min: f64,
) -> Result<Vec<Pair>, Stop> {
    let mut best = Choice { measure: f64::NEG_INFINITY, encoders: Vec::new() };
    choose(responses, encoders, &mut Choice { measure: 0.0, encoders: Vec::new() }, &mut best);
    let mut pairs = Vec::new();
    for (response, encoder) in responses.iter().zip(&best.encoders) {
        if response.counts[*encoder].abs() < counts_min {
            let what = format!(
                "no encoder of its own follows motor channel {}: of those that are left channel \
                 {encoder} fits best, and moved by {:.1} counts",
                response.motor,
                response.counts[*encoder].abs()
            );
            let remedy = "look at the encoder's cable and at the counter's setting; if it counts \
                          when the joint is turned by hand, the pulses may be too short for this \
                          motor, which the file's gears and torque constants make so: correct \
                          those that are far from the truth";
            return Err(Stop::new(what, remedy));
        }
        pairs.push(Pair {
            motor: response.motor,
            encoder: *encoder,
            breakaway: response.breakaway,
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
