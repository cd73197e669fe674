//! D/A to A/D: a ramp of codes is put out on a channel that the user has wired to an input, and the
//! straight line between both, with what the points are off it, is judged.

use std::str::FromStr;

use taktil_hal::{CHANNELS, DacCode};
use taktil_lab_plot::chart::{Line, Panel, StateStrip, stacked_panels};

use super::bench::Bench;
use super::findings::{Findings, Outcome};
use super::judge::Picture;
use super::spread::{Fit, Sample};

/// Codes of a ramp.
const RAMP_STEPS_COUNT: i32 = 33;
/// Cycles for which a code stands before the input is read.
const SETTLING_CYCLES: usize = 4;
/// Largest residual, root mean square, that a pair of good converters has (codes of the input).
const RESIDUAL_MAX_CODES: f64 = 2.0;
/// Height of the picture (px).
const PICTURE_HEIGHT_PX: f64 = 180.0;

/// A wire from an output to an input, channels from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Wire {
    output: usize,
    input: usize,
}

impl Wire {
    pub(super) fn output(self) -> usize {
        self.output
    }

    pub(super) fn input(self) -> usize {
        self.input
    }
}

impl FromStr for Wire {
    type Err = String;

    fn from_str(text: &str) -> Result<Wire, String> {
        let channel = |text: &str| text.trim().parse().ok().filter(|channel| *channel < CHANNELS);
        let ends = text.split_once('=').and_then(|(out, into)| channel(out).zip(channel(into)));
        let remedy = "give channels from 0, such as 3=0 for output 3 into input 0";
        ends.map(|(output, input)| Wire { output, input })
            .ok_or_else(|| format!("`{text}` is no wire; {remedy}"))
    }
}

/// Whether the halves of these ends are there.
pub(super) fn missing_end(wire: Wire, bench: &Bench<'_>) -> Option<String> {
    let outputs = bench.devices().analog_out.as_ref().map_or(0, |half| half.channels());
    let inputs = bench.devices().analog_in.as_ref().map_or(0, |half| half.channels());
    let Wire { output, input } = wire;
    if output >= outputs {
        return Some(format!("--loopback {output}={input}: there are {outputs} analog outputs"));
    }
    (input >= inputs)
        .then(|| format!("--loopback {output}={input}: there are {inputs} analog inputs"))
}

/// Ramps one output through `share` of its range about the safe value and judges the answer.
pub(super) fn check(
    wire: Wire,
    share: f64,
    bench: &mut Bench<'_>,
    findings: &mut Findings,
    pictures: &mut Vec<Picture>,
) {
    let about = format!("loop {}={}", wire.output, wire.input);
    let Some(half) = &bench.devices().analog_out else { return };
    let (safe, (low, high)) = (half.safe_value(), half.code_range());
    let reach = f64::from((high.0 - safe.0).min(safe.0 - low.0)) * share;
    let (mut points, mut lost) = (Vec::new(), 0);
    for step in 0..RAMP_STEPS_COUNT {
        let place = 2.0 * f64::from(step) / f64::from(RAMP_STEPS_COUNT - 1) - 1.0;
        #[expect(clippy::cast_possible_truncation, reason = "within the range of codes")]
        let code = safe.0 + (reach * place).round() as i32;
        bench.orders.codes[wire.output] = DacCode(code);
        bench.newest.codes_in = None;
        for _ in 0..SETTLING_CYCLES {
            bench.cycle();
        }
        match bench.newest.codes_in {
            Some(codes) => {
                points.push(Sample { put: f64::from(code), read: f64::from(codes[wire.input].0) })
            }
            None => lost += 1,
        }
    }
    bench.orders.codes[wire.output] = safe;
    bench.cycle();
    let Some(fit) = Fit::new(&points).filter(|_| lost <= RAMP_STEPS_COUNT / 4) else {
        let text = format!("{lost} of {RAMP_STEPS_COUNT} codes were not read back");
        findings.add(about, Outcome::Bad, text, "look at the errors of `analog_in`");
        return;
    };
    let residuals: Vec<f64> = points.iter().map(|point| fit.residual(point)).collect();
    let squares: f64 = residuals.iter().map(|residual| residual * residual).sum();
    let rms = (squares / residuals.len() as f64).sqrt();
    let worst = residuals.iter().fold(0.0_f64, |worst, residual| worst.max(residual.abs()));
    // Without a wire the input does not follow, and a level line fits it well.
    let follows = (fit.slope * reach).abs() > 10.0 * RESIDUAL_MAX_CODES;
    let text = format!(
        "gain {:.5}, offset {:.2} codes, residual {rms:.2} codes rms, {worst:.2} at most; {} \
         codes, {RESIDUAL_MAX_CODES} rms allowed{}",
        fit.slope,
        fit.offset,
        points.len(),
        if follows { "" } else { "; the input does not follow" }
    );
    let remedy = "check the wire, the channels and the grounds; the drives must be off this output";
    findings.add(about, Outcome::of(follows && rms <= RESIDUAL_MAX_CODES), text, remedy);
    pictures.push(picture(wire, &points, residuals));
}

/// What was read, and the residuals, over the code.
fn picture(wire: Wire, points: &[Sample], residuals: Vec<f64>) -> Picture {
    let line = |label: &str, values: Vec<f64>, colour: usize| Line {
        label: label.to_owned(),
        t_s: points.iter().map(|point| point.put).collect(),
        values,
        colour,
        dashed: false,
    };
    let panel = |title: &str, line: Line| Panel {
        title: title.to_owned(),
        lines: vec![line],
        ..Panel::default()
    };
    let read = points.iter().map(|point| point.read).collect();
    let panels = [
        panel("code read", line("input", read, 0)),
        panel("residual (codes)", line("residual", residuals, 1)),
    ];
    let title = format!("output {} into input {}, over the code", wire.output, wire.input);
    let figure = stacked_panels(&title, &panels, &StateStrip::default(), PICTURE_HEIGHT_PX);
    (format!("loop-{}-{}", wire.output, wire.input), figure)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wire_has_two_ends() {
        assert_eq!("3=0".parse(), Ok(Wire { output: 3, input: 0 }));
        for bad in ["3", "3=", "a=1", "32=0", "-1=0", "1=2=3"] {
            assert!(bad.parse::<Wire>().is_err(), "{bad}");
        }
    }
}
