//! The closing table that is printed when a run has ended, from its summary. A dash stands for an
//! absent value; a mark stands at timing figures that do not represent the machine.

use std::fmt::Write;

use taktil_record::summary::{
    ContactCounts, ErrorFigures, HoldFigures, LaneSummary, Percentiles, PhaseSummary, Range,
    RunMode, Summary,
};

use crate::{budgets, moves};

/// The mark at every timing figure of a run whose timing is not representative.
const NOT_REPRESENTATIVE_MARK: &str = " *";

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".into(), |n| format!("{n:.digits$}"))
}

fn range(ends: Option<Range>, digits: usize) -> String {
    ends.map_or_else(|| "-".into(), |[low, high]| format!("{low:.digits$} .. {high:.digits$}"))
}

fn width(ends: Option<Range>, digits: usize) -> String {
    number(ends.map(|[low, high]| high - low), digits)
}

fn error(rms: Option<f64>, peak: Option<f64>, digits: usize) -> String {
    format!("error rms {}, peak {}", number(rms, digits), number(peak, digits))
}

fn spread(rms: Option<f64>, peak: Option<f64>, digits: usize) -> String {
    format!("rms {}, peak {}", number(rms, digits), number(peak, digits))
}

/// The whole table.
#[must_use]
pub fn text(summary: &Summary) -> String {
    let mut out = String::new();
    head(&mut out, summary);
    if summary.rolled {
        rolling(&mut out, summary);
    } else if summary.touched {
        let _ = writeln!(out, "rolling by touch");
        row(&mut out, "strokes (reversals)", "0", "the force never reached its set point");
    }
    if summary.hold.finger_error_mm.mean.is_some() {
        hold(&mut out, &summary.hold);
    }
    if let Some(counts) = &summary.truth.layer {
        contacts(&mut out, counts);
    }
    phases(&mut out, &summary.phases);
    tracking(&mut out, &summary.tracking_deg);
    lanes(&mut out, summary);
    ending(&mut out, summary);
    out
}

fn row(out: &mut String, name: &str, value: &str, note: &str) {
    let line = format!("  {name:<26} {value:<24} {note}");
    let _ = writeln!(out, "{}", line.trim_end());
}

fn head(out: &mut String, s: &Summary) {
    let _ = writeln!(out, "\n{}", s.title);
    let speed = match s.wall_s {
        wall_s if wall_s > 0.0 => format!("{:.1} x real time", s.sim_s / wall_s),
        _ => "-".into(),
    };
    let mode = match s.mode {
        RunMode::Live => "live",
        RunMode::Fast => "virtual time",
    };
    row(out, "run", &format!("{:.2} s, {mode}", s.sim_s), &speed);
    row(out, "state at the end", &s.state, "");
}

fn rolling(out: &mut String, s: &Summary) {
    let (f, t) = (&s.features, &s.truth);
    let _ = writeln!(out, "rolling by touch");
    row(out, "strokes (reversals)", &s.strokes.to_string(), "");
    row(out, "x_c, column", &range(s.x_c, 2), &format!("span {}", width(s.x_c, 2)));
    row(out, "p_x, mm", &range(s.p_x_mm, 2), &format!("span {}", width(s.p_x_mm, 2)));
    row(out, "finger / contact travel", &number(s.rolling_ratio, 3), "2 when nothing slips");
    row(out, "p_z, mm", &range(s.p_z_mm, 2), &format!("span {}", width(s.p_z_mm, 2)));
    row(out, "theta_xx, deg", &range(s.theta_xx_deg, 2), "");
    row(out, "theta_zz, deg", &range(s.theta_zz_deg, 2), "");
    let errors = |e: &ErrorFigures, digits| error(e.rms_error, e.peak_error, digits);
    let m0 = format!("mean {}", number(f.m0.mean, 0));
    row(out, "M0, counts", &m0, &error(f.m0.rms_error, f.m0.peak_error, 0));
    row(out, "M_x, counts x row", "set point 0", &errors(&f.m_x, 0));
    row(out, "theta_z, deg", "set point 0", &errors(&f.theta_z, 2));
    row(out, "x_c against truth", "", &errors(&f.x_c, 3));
    let force = &t.normal_force_n;
    let mean = format!("{} of {}", number(force.mean, 2), number(force.set_point, 2));
    row(out, "true normal force, N", &mean, &error(force.rms_error, force.peak_error, 2));
    let (yaw, tilt, height) = (&t.pin_yaw_error_deg, &t.pin_tilt_error_deg, &t.height_error_mm);
    row(out, "pin yaw on sensor, deg", &spread(yaw.rms, yaw.peak, 2), "");
    row(out, "finger tilt on pin, deg", &spread(tilt.rms, tilt.peak, 3), "");
    row(out, "height about its mean, mm", &spread(height.rms, height.peak, 3), "");
    let lost = format!("contact lost {} times", t.contact_lost);
    row(out, "fastest slip, mm/s", &number(t.slip_mm_s, 2), &lost);
}

/// The phases of a touch task: when each began, and what the one before came to.
fn phases(out: &mut String, phases: &[PhaseSummary]) {
    if phases.is_empty() {
        return;
    }
    let _ = writeln!(out, "phases of the touch task");
    for (index, change) in phases.iter().enumerate() {
        let [x, y, z, ..] = change.moved;
        let note = match index {
            0 => String::new(),
            _ => format!(
                "{} after {:.2} s, ({x:.2}, {y:.2}, {z:.2}) mm, {:.0} counts",
                change.cause, change.time_s, change.m0
            ),
        };
        row(out, &change.phase, &format!("from {:.2} s", change.at_s), &note);
    }
}

/// Whether the contacts were solved in the way that the scene requests.
fn contacts(out: &mut String, counts: &ContactCounts) {
    let _ = writeln!(out, "contact in three dimensions");
    row(out, "contacts solved for images", &counts.spatial_solutions.to_string(), "");
    let note = if counts.spatial_failures > 0 {
        "the solution was lacking or not believed there"
    } else {
        ""
    };
    row(out, "rows on their own", &counts.spatial_failures.to_string(), note);
}

fn hold(out: &mut String, hold: &HoldFigures) {
    let _ = writeln!(out, "holding in IDLE/CALIBRATED");
    let finger = &hold.finger_error_mm;
    let text = format!("mean {}, peak {}", number(finger.mean, 3), number(finger.peak, 3));
    row(out, "finger off its place, mm", &text, "");
    row(out, "joint droop, deg", &joints(hold.joint_error_deg.iter().copied(), 4), "");
    if let Some(gravity) = hold.gravity_over_kp_deg.as_ref().filter(|list| !list.is_empty()) {
        row(out, "gravity / Kp, deg", &joints(gravity.iter().copied(), 4), "");
    }
}

/// One number for each joint.
fn joints(values: impl Iterator<Item = Option<f64>>, digits: usize) -> String {
    values.map(|value| number(value, digits)).collect::<Vec<_>>().join(" ")
}

fn tracking(out: &mut String, errors: &[ErrorFigures]) {
    let _ = writeln!(out, "joint tracking error, joints 1 to {}", errors.len());
    row(out, "rms, deg", &joints(errors.iter().map(|error| error.rms_error), 3), "");
    row(out, "peak, deg", &joints(errors.iter().map(|error| error.peak_error), 3), "");
}

fn lanes(out: &mut String, s: &Summary) {
    let marked = !s.representative_timing;
    let mark = if marked { NOT_REPRESENTATIVE_MARK } else { "" };
    let _ = writeln!(
        out,
        "lanes{:<8} {:>6}  {:>33}  {:>26}  {:>6} {:>5} {:>5}",
        "",
        "jobs",
        "release late us p50 / p99 / max",
        "job us p50 / p99 / max",
        "misses",
        "alloc",
        "fault"
    );
    let percentiles =
        |time: &Percentiles| format!("{:.1} / {:.1} / {:.1}{mark}", time.p50, time.p99, time.max);
    for lane in &s.lanes {
        let _ = writeln!(
            out,
            "  {:<10} {:>6}  {:>33}  {:>26}  {:>6} {:>5} {:>5}",
            lane.name,
            lane.jobs,
            percentiles(&lane.release_late_us),
            percentiles(&lane.exec_us),
            lane.missed(),
            lane.allocations.map_or_else(|| "-".into(), |n| n.to_string()),
            lane.page_faults,
        );
        losses(out, lane);
        budgets::append_tasks(out, lane, mark);
    }
    if let Some(slipped_s) = s.slipped_s.filter(|slipped_s| *slipped_s > 0.0) {
        let _ = writeln!(
            out,
            "  the machine stalled: {slipped_s:.4} s in all, for which the simulated world waited"
        );
    }
    if marked {
        let why = match s.mode {
            RunMode::Live => "no PREEMPT_RT kernel, a virtual machine, or rights not granted",
            RunMode::Fast => "virtual time: nobody waits, jobs share one thread",
        };
        let _ = writeln!(out, "  * not representative: {why}");
    }
}

/// The causes of misses, and lost records; no line when there are none.
fn losses(out: &mut String, lane: &LaneSummary) {
    let missed = lane.misses.iter().filter(|(_, count)| **count != 0);
    let mut words: Vec<String> =
        missed.map(|(cause, count)| format!("{count} {}", cause.replace('_', " "))).collect();
    for (count, text) in [
        (lane.skipped, "jobs skipped"),
        (lane.records_dropped, "records lost"),
        (lane.values_dropped, "values lost"),
    ] {
        if count > 0 {
            words.push(format!("{count} {text}"));
        }
    }
    if lane.storms > 0 {
        words.push("on a board these misses would have stopped the machine".to_owned());
    }
    if !words.is_empty() {
        let _ = writeln!(out, "    {}", words.join(", "));
    }
}

fn ending(out: &mut String, s: &Summary) {
    for fault in &s.faults {
        let _ = writeln!(out, "FAULT {}: {}", fault.name, fault.text);
    }
    if s.faults.is_empty() {
        row(out, "faults", "none", "");
    }
    if let Some(check) = &s.moves {
        let (verdict, note) = moves::verdict_and_note(check);
        row(out, "moves", &verdict, &note);
    }
    if s.refused_requests > 0 {
        row(out, "refused requests", &s.refused_requests.to_string(), "");
    }
    if s.interrupted {
        row(out, "ended by", "Ctrl-C, outputs left safe", "");
    }
    row(out, "seed", &s.seed.to_string(), &format!("digest {}", s.digest));
    row(out, "repeat", &s.repeat, "");
}
