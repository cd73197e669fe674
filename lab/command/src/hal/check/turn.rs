//! Encoders by hand: the user turns a joint, and direction and spacing of its index pulses are
//! judged.

use std::str::FromStr;

use taktil_hal::{CHANNELS, Nanos};
use taktil_machine_console::out;

use super::bench::Bench;
use super::findings::{Findings, Outcome};

/// Counts by which a joint has to move before its direction is believed.
const MOVED_COUNTS_MIN: i64 = 20;
/// By how much two turns between index pulses may differ (counts).
const INDEX_TOLERANCE_COUNTS: i64 = 1;
/// From one line on the terminal to the next.
const PROGRESS_PERIOD: Nanos = Nanos::from_millis(500);

/// A joint that is to be turned, and which way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Turn {
    /// From 0.
    joint: usize,
    grows: bool,
}

impl FromStr for Turn {
    type Err = String;

    fn from_str(text: &str) -> Result<Turn, String> {
        let (number, grows) = match (text.strip_suffix('-'), text.strip_suffix('+')) {
            (Some(number), _) => (number, false),
            (None, Some(number)) => (number, true),
            (None, None) => (text, true),
        };
        let digits = number.bytes().all(|byte| byte.is_ascii_digit());
        let joint = number.parse::<usize>().ok();
        let joint = joint.filter(|joint| digits && (1..=CHANNELS).contains(joint));
        let remedy = "give its number from 1, and - behind it to turn it the other way";
        joint
            .map(|joint| Turn { joint: joint - 1, grows })
            .ok_or_else(|| format!("`{text}` is no joint; {remedy}"))
    }
}

/// Whether the joint is there.
pub(super) fn missing_joint(turn: Turn, bench: &Bench<'_>) -> Option<String> {
    let joints = bench.devices().encoders.as_ref().map_or(0, |half| half.joints());
    (turn.joint >= joints)
        .then(|| format!("--turn {}: there are encoders of {joints} joints", turn.joint + 1))
}

/// Waits `time` while the user turns the joint, and judges what its encoder said.
pub(super) fn check(turn: Turn, time: Nanos, bench: &mut Bench<'_>, findings: &mut Findings) {
    let (number, sign) = (turn.joint + 1, if turn.grows { "+" } else { "-" });
    // Standard output is the report's.
    out::warn(format_args!(
        "turn joint {number} by hand in its {sign} direction, for {:.0} s",
        time.as_secs_f64()
    ));
    bench.cycle();
    let start = bench.newest.counts.map(|counts| i64::from(counts[turn.joint].0));
    let (end, mut told) = (bench.release + time, bench.release);
    let mut pulses: Vec<i64> = Vec::new();
    let first_pulse = bench.newest.pulses[turn.joint];
    let mut moved = 0;
    while bench.release < end {
        bench.cycle();
        if let Some((counts, start)) = bench.newest.counts.zip(start) {
            moved = i64::from(counts[turn.joint].0) - start;
        }
        if let Some(pulse) = bench.newest.pulses[turn.joint]
            && Some(pulse) != first_pulse
            && pulses.last() != Some(&i64::from(pulse.0))
        {
            pulses.push(i64::from(pulse.0));
        }
        if bench.release >= told {
            told += PROGRESS_PERIOD;
            let arrow = if moved >= 0 { "->" } else { "<-" };
            out::hint(format_args!("\r{arrow} {moved} counts, {} index pulses  ", pulses.len()));
        }
    }
    out::hint("\n");
    direction(turn, start.is_some(), moved, findings);
    index(number, bench, &pulses, findings);
}

fn direction(turn: Turn, is_read: bool, moved: i64, findings: &mut Findings) {
    let (about, sign) = (format!("joint {}", turn.joint + 1), if turn.grows { "+" } else { "-" });
    let text = format!("turned in its {sign} direction: {moved:+} counts");
    if !is_read || moved.abs() < MOVED_COUNTS_MIN {
        let text = format!("{text}, {MOVED_COUNTS_MIN} are needed to tell a direction");
        let remedy = "turn it further, or this encoder is not wired to this joint";
        findings.add(about, Outcome::Bad, text, remedy);
        return;
    }
    let remedy = "the encoder counts the other way: give -1 in `encoder_sign` of [joints]";
    findings.add(about, Outcome::of((moved > 0) == turn.grows), text, remedy);
}

/// The distances between pulses that follow each other in one direction.
fn spacings(pulses: &[i64]) -> Vec<i64> {
    let steps: Vec<i64> = pulses.windows(2).map(|two| two[1] - two[0]).collect();
    // The pulse at which the direction was reversed is seen twice, from both sides.
    let pairs = steps.iter().enumerate();
    pairs
        .filter(|(at, step)| *at == 0 || step.signum() == steps[at - 1].signum())
        .map(|(_, step)| step.abs())
        .collect()
}

fn index(number: usize, bench: &Bench<'_>, pulses: &[i64], findings: &mut Findings) {
    let about = format!("joint {number} index");
    if bench.devices().encoders.as_ref().is_none_or(|half| !half.has_index()) {
        findings.add(about, Outcome::Noted, "the board latches no index pulses", "");
        return;
    }
    let spacings = spacings(pulses);
    let (Some(low), Some(high)) = (spacings.iter().min(), spacings.iter().max()) else {
        let text = format!("{} pulses: turn further to see two turns of the motor", pulses.len());
        findings.add(about, Outcome::Noted, text, "");
        return;
    };
    let text = format!("{} pulses, {low} to {high} counts apart", pulses.len());
    let remedy = "counts are lost: look at cable, shield and the limit of the counter's frequency";
    findings.add(about, Outcome::of(high - low <= INDEX_TOLERANCE_COUNTS), text, remedy);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_is_named_from_one_with_its_direction() {
        assert_eq!("2".parse(), Ok(Turn { joint: 1, grows: true }));
        assert_eq!("6-".parse(), Ok(Turn { joint: 5, grows: false }));
        assert_eq!("1+".parse(), Ok(Turn { joint: 0, grows: true }));
        for bad in ["0", "", "x", "33", "+1-", "-1"] {
            assert!(bad.parse::<Turn>().is_err(), "{bad}");
        }
    }

    #[test]
    fn the_pulse_at_a_reversal_counts_for_no_turn() {
        assert_eq!(spacings(&[0, 1000, 2000, 1001, 1]), [1000, 1000, 1000]);
        assert_eq!(spacings(&[5]), [0; 0]);
    }

    #[test]
    fn a_direction_needs_motion_and_the_right_sign() {
        let outcome = |turn: &str, moved: i64| {
            let mut findings = Findings::default();
            direction(turn.parse().unwrap(), true, moved, &mut findings);
            findings.is_good()
        };
        assert!(outcome("2", 500) && outcome("2-", -500));
        assert!(!outcome("2", -500) && !outcome("2-", 500) && !outcome("2", 3));
    }
}
