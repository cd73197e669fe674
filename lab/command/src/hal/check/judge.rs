//! Judges the cycles of a check: times against declared waits, errors, noise of inputs, and the
//! tactile arrays; with the pictures of times and arrays.

use taktil_hal::Nanos;
use taktil_lab_plot::heat::heat_maps;
use taktil_lab_plot::histogram::{Histogram, log_histogram};
use taktil_lab_plot::svg::Figure;

use super::array::ArrayRecord;
use super::bench::{Bench, ERROR_KINDS, HalfRecord};
use super::findings::{Findings, Outcome};
use super::spread::Spread;

/// Share of calls that may last longer than declared, on a host that is not tuned.
const LATE_SHARE_MAX: f64 = 0.01;
/// Dead tactels that are listed one by one.
const LISTED_TACTELS_MAX: usize = 8;
/// Size of a histogram (px).
const HISTOGRAM_WIDTH_PX: f64 = 560.0;
/// Height of a histogram (px).
const HISTOGRAM_HEIGHT_PX: f64 = 260.0;

/// What is allowed beside what the halves declare.
#[derive(Clone, Copy, Debug)]
pub(super) struct Allowances {
    /// Own work of a call and the host's wake-ups.
    pub(super) slack: Nanos,
    /// Share of exchanges, and of frames, that may be lost.
    pub(super) loss_max: f64,
}

/// A picture with the name of its file.
pub(super) type Picture = (String, Figure);

/// Judges everything that was recorded.
pub(super) fn judge(
    bench: &Bench<'_>,
    allowed: Allowances,
    findings: &mut Findings,
    pictures: &mut Vec<Picture>,
) {
    for (name, half) in &bench.halves {
        times(name, half, allowed, findings);
        pictures.push((format!("time-{name}"), histogram(name, half)));
        errors(name, half, allowed, findings);
    }
    lines(bench, findings);
    for (what, spreads) in [
        ("encoders", &bench.still_counts),
        ("analog_in", &bench.inputs),
        ("force_torque", &bench.gauges),
    ] {
        noise(what, spreads, findings);
    }
    if bench.over_range_readings > 0 {
        let text = format!(
            "in {} readings a gauge stood at an end of its converter's range",
            bench.over_range_readings
        );
        let remedy = "look at the sensor's supply and cable, take the load off, or widen the range";
        findings.add("force_torque range", Outcome::Bad, text, remedy);
    }
    for (name, array) in &bench.arrays {
        tactels(name, array, allowed, findings);
        if array.frames > 0 {
            pictures.push((format!("noise-{name}"), maps(name, array)));
        }
    }
    if bench.skipped > 0 {
        let all = bench.cycles + bench.skipped;
        let text = format!("{} of {all} cycles began too late and were left out", bench.skipped);
        findings.add("host", Outcome::Noted, text, "");
    }
}

fn times(name: &str, half: &HalfRecord, allowed: Allowances, findings: &mut Findings) {
    let limit = half.declared + allowed.slack;
    let late = half.durations.share_above(limit);
    // What the host interrupted says nothing about the device.
    let text = format!(
        "{} calls: half within {:.1} us, 99 % within {:.1} us, longest {:.1} us ({} interrupted \
         by the host); declared wait {} + {} allowed",
        half.calls,
        half.durations.quantile_us(0.5),
        half.durations.quantile_us(0.99),
        half.longest.as_micros_f64(),
        half.preempted,
        half.declared,
        allowed.slack
    );
    let remedy = "give the lane a priority and a CPU of its own, look at `taktil doctor`, or the \
                  device is slower than its driver declares";
    findings.add(format!("{name} time"), Outcome::of(late <= LATE_SHARE_MAX), text, remedy);
}

fn errors(name: &str, half: &HalfRecord, allowed: Allowances, findings: &mut Findings) {
    let failed = half.failed();
    let share = failed as f64 / half.calls.max(1) as f64;
    let kinds: Vec<String> = ERROR_KINDS
        .iter()
        .zip(half.errors)
        .filter(|(_, count)| *count > 0)
        .map(|(kind, count)| format!("{count} {}", kind.name()))
        .collect();
    let kinds = if kinds.is_empty() { "no error".to_owned() } else { kinds.join(", ") };
    let mut text = format!("{kinds} in {} calls ({:.2} %)", half.calls, 100.0 * share);
    if half.is_input && half.ages.total > 0 {
        text += &format!(
            "; age {:.2} ms at most, half of them {:.2} ms",
            half.ages.longest.as_secs_f64() * 1e3,
            half.ages.quantile_us(0.5) * 1e-3
        );
    }
    let remedy = "look at cable, connector and supply, and at whatever else uses the link";
    let good = share <= allowed.loss_max && half.calls > 0;
    findings.add(format!("{name} errors"), Outcome::of(good), text, remedy);
}

fn lines(bench: &Bench<'_>, findings: &mut Findings) {
    if bench.devices().digital_in.is_none() {
        return;
    }
    let text = match bench.newest.lines {
        None => "could not be read".to_owned(),
        Some(lines) => {
            let on = |is_on: bool, yes: &str, no: &str| if is_on { yes } else { no }.to_owned();
            format!(
                "drive power {}, emergency stop A {}, B {}",
                on(lines.drive_power, "on", "off"),
                on(lines.estop_a_closed, "closed", "open"),
                on(lines.estop_b_closed, "closed", "open")
            )
        }
    };
    let differ = bench.newest.lines.is_some_and(|at| at.estop_a_closed != at.estop_b_closed);
    let outcome = if differ { Outcome::Bad } else { Outcome::Noted };
    let remedy = "both channels of one chain differ: look at the wiring of the emergency stop";
    findings.add("lines", outcome, text, remedy);
}

fn noise(what: &str, spreads: &[Spread], findings: &mut Findings) {
    let seen: Vec<String> = spreads
        .iter()
        .filter(|spread| spread.count > 0)
        .map(|spread| format!("{:.0}±{:.1}", spread.mean, spread.deviation()))
        .collect();
    if !seen.is_empty() {
        let text = format!("mean and deviation: {}", seen.join(" "));
        findings.add(format!("{what} noise"), Outcome::Noted, text, "");
    }
}

fn tactels(name: &str, array: &ArrayRecord, allowed: Allowances, findings: &mut Findings) {
    if array.frames == 0 {
        let remedy = "check power, cable and that `board` names what is plugged in";
        findings.add(format!("{name} frames"), Outcome::Bad, "no frame came", remedy);
        return;
    }
    let text = format!(
        "{} frames of {} x {}, {:.1} a second, interval {:.2} ms +- {:.2} ms; {} missing ({:.2} \
         %), {} not fetched in time",
        array.frames,
        array.rows,
        array.cols,
        array.rate_hz(),
        array.intervals.mean * 1e3,
        array.intervals.deviation() * 1e3,
        array.missing,
        100.0 * array.missing_share(),
        array.overtaken
    );
    let good = array.missing_share() <= allowed.loss_max;
    let remedy = "look at cable and adapter (`taktil hal list`), or lower `rate_hz`";
    findings.add(format!("{name} frames"), Outcome::of(good), text, remedy);
    let dead = array.dead();
    let mut text =
        format!("noise {:.2} counts; {} tactels do not answer", array.noise_counts(), dead.len());
    if !dead.is_empty() {
        let listed: Vec<&str> = dead.iter().take(LISTED_TACTELS_MAX).map(String::as_str).collect();
        text += &format!(" ({}", listed.join("; "));
        text += if dead.len() > LISTED_TACTELS_MAX { "; ...)" } else { ")" };
    }
    let remedy = "press them: one that stays dead is to be named in the machine file, a row or a \
                  column of them is a broken contact";
    findings.add(format!("{name} tactels"), Outcome::of(dead.is_empty()), text, remedy);
    if array.is_still() {
        let text = "no tactel changed: noise is below one count, or the array is frozen; press it";
        findings.add(format!("{name} tactels"), Outcome::Noted, text, "");
    }
}

fn histogram(name: &str, half: &HalfRecord) -> Figure {
    let call = if half.is_input { "sample" } else { "commit" };
    let mut marks = vec![(half.durations.longest.as_micros_f64(), "longest".to_owned())];
    if half.declared > Nanos::ZERO {
        marks.push((half.declared.as_micros_f64(), "declared wait".to_owned()));
    }
    let histogram = Histogram {
        title: format!("{name}: duration of {call} (us), {} calls", half.durations.total),
        bins: half.durations.bins(),
        marks,
        colour: usize::from(!half.is_input),
    };
    log_histogram(&histogram, HISTOGRAM_WIDTH_PX, HISTOGRAM_HEIGHT_PX)
}

fn maps(name: &str, array: &ArrayRecord) -> Figure {
    let title = format!("{name}: {} frames; tactels that do not answer are grey", array.frames);
    let noise = array.panel("deviation (counts)", Spread::deviation);
    heat_maps(&title, &[noise])
}

/// The rest level of an array, which has a scale of its own.
pub(super) fn rest_levels(bench: &Bench<'_>) -> Vec<Picture> {
    let seen = bench.arrays.iter().filter(|(_, array)| array.frames > 0);
    seen.map(|(name, array)| {
        let rest = array.panel("mean (counts)", |spread| spread.mean);
        (format!("rest-{name}"), heat_maps(&format!("{name}: rest level"), &[rest]))
    })
    .collect()
}
