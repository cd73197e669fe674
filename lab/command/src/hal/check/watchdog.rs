//! The watchdog's bite: nothing is committed for longer than the device promises to bear, and the
//! outputs must have gone safe by themselves. A bite shows in an input that follows an output, in
//! the line of the drives' supply, or in the answer to the next commit.

use taktil_hal::{DacCode, Nanos};

use super::bench::Bench;
use super::findings::{Findings, Outcome};
use super::loopback::Wire;
use super::spread::Spread;

/// Cycles in which the outputs are fed before the silence.
const FED_CYCLES: usize = 40;
/// What is allowed beyond the promised time: cycles until a drop is seen.
const SEEING_CYCLES: i64 = 2;
/// Change of a looped-back input that is no noise (codes).
const CHANGE_MIN_CODES: f64 = 8.0;
/// Longest promise that is waited for.
const SILENCE_MAX: Nanos = Nanos::from_secs(30);

/// Where a bite was seen, and how long after the newest commit.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Seen {
    Input(Nanos),
    DrivePower(Nanos),
    /// A commit after the silence was refused; when it happened is not known.
    Refusal,
    Nothing,
}

/// Feeds the outputs, stops, and looks for the bite. With a looped-back wire its output stands at
/// `share` of its range meanwhile.
pub(super) fn check(
    wire: Option<Wire>,
    share: f64,
    bench: &mut Bench<'_>,
    findings: &mut Findings,
) {
    let devices = bench.devices();
    let promises = [
        devices.analog_out.as_ref().map(|half| half.longest_silence()),
        devices.digital_out.as_ref().map(|half| half.longest_silence()),
    ];
    let Some(promise) = promises.into_iter().flatten().max() else {
        let text = "there are no outputs that a watchdog could take off";
        findings.add("watchdog", Outcome::Bad, text, "name a device that serves outputs");
        return;
    };
    let promise = promise.min(SILENCE_MAX);
    let code = wire.and_then(|wire| raised_code(wire, share, bench));
    if let (Some(wire), Some(code)) = (wire, code) {
        bench.orders.codes[wire.output()] = code;
    }
    let mut level = Spread::default();
    for cycle in 0..FED_CYCLES {
        bench.cycle();
        if let (Some(wire), Some(codes)) = (wire, bench.newest.codes_in)
            && 2 * cycle > FED_CYCLES
        {
            level.add(f64::from(codes[wire.input()].0));
        }
    }
    let seen = silence(wire.filter(|_| code.is_some()), &level, promise, bench);
    bench.orders.codes = bench.safe_codes();
    for _ in 0..FED_CYCLES {
        bench.cycle();
    }
    let limit = promise + bench.period() * SEEING_CYCLES;
    let ms = |time: Nanos| time.as_secs_f64() * 1e3;
    let (outcome, text) = match seen {
        Seen::Input(after) => {
            let text = format!("the looped-back output dropped {:.1} ms after it", ms(after));
            (Outcome::of(after <= limit), text)
        }
        Seen::DrivePower(after) => {
            let text = format!("the drives' supply dropped {:.1} ms after it", ms(after));
            (Outcome::of(after <= limit), text)
        }
        Seen::Refusal => {
            (Outcome::Good, "the board told of its bite at the next commit".to_owned())
        }
        Seen::Nothing => (Outcome::Bad, "nothing was seen to drop".to_owned()),
    };
    let text = format!("nothing was put out for {:.1} ms: {text}", ms(silent_time(promise)));
    let text = format!("{text}; promised within {:.1} ms", ms(promise));
    let remedy = "give --loopback OUT=IN to see an output drop, or measure it; a board without a \
                  watchdog needs a relay (docs/guides/bring-up.md)";
    findings.add("watchdog", outcome, text, remedy);
}

/// Half as long again as is promised.
fn silent_time(promise: Nanos) -> Nanos {
    Nanos(promise.0 + promise.0 / 2)
}

fn raised_code(wire: Wire, share: f64, bench: &Bench<'_>) -> Option<DacCode> {
    let half = bench.devices().analog_out.as_ref()?;
    let (safe, (_, high)) = (half.safe_value(), half.code_range());
    (wire.output() < half.channels()).then(|| {
        #[expect(clippy::cast_possible_truncation, reason = "within the range of codes")]
        let step = (f64::from(high.0 - safe.0) * share).round() as i32;
        DacCode(safe.0 + step)
    })
}

/// Samples without a commit for half as long again as the promise, then commits.
fn silence(wire: Option<Wire>, level: &Spread, promise: Nanos, bench: &mut Bench<'_>) -> Seen {
    let last = bench.release - bench.period();
    let powered = bench.newest.lines.is_some_and(|lines| lines.drive_power);
    bench.orders.silent = true;
    let (mut seen, end) = (Seen::Nothing, last + silent_time(promise));
    let threshold = CHANGE_MIN_CODES.max(0.5 * level.mean.abs());
    while bench.release < end {
        let now = bench.release;
        bench.cycle();
        if seen != Seen::Nothing {
            continue;
        }
        if let (Some(wire), Some(codes)) = (wire, bench.newest.codes_in)
            && level.count > 0
            && (f64::from(codes[wire.input()].0) - level.mean).abs() >= threshold
        {
            seen = Seen::Input(now - last);
        }
        if powered && bench.newest.lines.is_some_and(|lines| !lines.drive_power) {
            seen = Seen::DrivePower(now - last);
        }
    }
    bench.orders.silent = false;
    bench.cycle();
    if seen == Seen::Nothing && bench.newest.commit_failed { Seen::Refusal } else { seen }
}
