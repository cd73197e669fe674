//! The closing table: what a person reads when a run has ended, drawn from the summary. Refuses to
//! hide what is missing: a dash stands for what did not happen, a mark for timing that says nothing
//! about the machine.

use std::fmt::Write;

use serde_json::Value;

use taktil_lab_scene::{budgets, moves};

/// The mark at every timing figure of a run whose timing is not representative.
const MARK: &str = " *";

fn number(value: &Value, digits: usize) -> String {
    value.as_f64().map_or_else(|| "-".into(), |n| format!("{n:.digits$}"))
}

fn span(value: &Value, digits: usize) -> String {
    match value {
        Value::Array(ends) if ends.len() == 2 => {
            format!("{} .. {}", number(&ends[0], digits), number(&ends[1], digits))
        }
        _ => "-".into(),
    }
}

fn width(value: &Value, digits: usize) -> String {
    let ends = value.as_array().and_then(|e| Some(e.get(1)?.as_f64()? - e.first()?.as_f64()?));
    ends.map_or_else(|| "-".into(), |w| format!("{w:.digits$}"))
}

/// The whole table.
#[must_use]
pub fn table(summary: &Value) -> String {
    let mut out = String::new();
    head(&mut out, summary);
    if summary["rolled"] == true {
        rolling(&mut out, summary);
    } else if summary["touched"] == true {
        let _ = writeln!(out, "rolling by touch");
        row(&mut out, "strokes (reversals)", "0", "the force never reached its set point");
    }
    if !summary["hold"]["finger_error_mm"]["mean"].is_null() {
        hold(&mut out, summary);
    }
    layer(&mut out, &summary["truth"]["layer"]);
    tracking(&mut out, summary);
    lanes(&mut out, summary);
    ending(&mut out, summary);
    out
}

fn row(out: &mut String, name: &str, value: &str, note: &str) {
    let line = format!("  {name:<26} {value:<24} {note}");
    let _ = writeln!(out, "{}", line.trim_end());
}

fn head(out: &mut String, s: &Value) {
    let title = s["title"].as_str().unwrap_or_default();
    let _ = writeln!(out, "\n{title}");
    let wall = s["wall_s"].as_f64().unwrap_or(0.0);
    let sim = s["sim_s"].as_f64().unwrap_or(0.0);
    let speed = if wall > 0.0 { format!("{:.1} x real time", sim / wall) } else { "-".into() };
    let mode = if s["mode"] == "live" { "live" } else { "virtual time" };
    row(out, "run", &format!("{sim:.2} s, {mode}"), &speed);
    row(out, "state at the end", s["state"].as_str().unwrap_or("-"), "");
}

fn rolling(out: &mut String, s: &Value) {
    let (f, t) = (&s["features"], &s["truth"]);
    let _ = writeln!(out, "rolling by touch");
    row(out, "strokes (reversals)", &s["strokes"].to_string(), "");
    row(out, "x_c, column", &span(&s["x_c"], 2), &format!("span {}", width(&s["x_c"], 2)));
    let p_x = format!("span {}", width(&s["p_x_mm"], 2));
    row(out, "p_x, mm", &span(&s["p_x_mm"], 2), &p_x);
    row(out, "finger / contact travel", &number(&s["rolling_ratio"], 3), "2 when nothing slips");
    row(out, "p_z, mm", &span(&s["p_z_mm"], 2), &format!("span {}", width(&s["p_z_mm"], 2)));
    row(out, "theta_xx, deg", &span(&s["theta_xx_deg"], 2), "");
    row(out, "theta_zz, deg", &span(&s["theta_zz_deg"], 2), "");
    let errors = |e: &Value, d: usize| {
        format!("error rms {}, peak {}", number(&e["rms_error"], d), number(&e["peak_error"], d))
    };
    let m0 = format!("mean {}", number(&f["m0"]["mean"], 0));
    row(out, "M0, counts", &m0, &errors(&f["m0"], 0));
    row(out, "M_x, counts x row", "set point 0", &errors(&f["m_x"], 0));
    row(out, "theta_z, deg", "set point 0", &errors(&f["theta_z"], 2));
    row(out, "x_c against truth", "", &errors(&f["x_c"], 3));
    let force = &t["normal_force_n"];
    let mean = format!("{} of {}", number(&force["mean"], 2), number(&force["set_point"], 2));
    row(out, "true normal force, N", &mean, &errors(force, 2));
    let spread = |e: &Value, d: usize| {
        format!("rms {}, peak {}", number(&e["rms"], d), number(&e["peak"], d))
    };
    row(out, "pin yaw on sensor, deg", &spread(&t["pin_yaw_error_deg"], 2), "");
    row(out, "finger tilt on pin, deg", &spread(&t["pin_tilt_error_deg"], 3), "");
    row(out, "height about its mean, mm", &spread(&t["height_error_mm"], 3), "");
    let lost = format!("contact lost {} times", t["contact_lost"]);
    row(out, "fastest slip, mm/s", &number(&t["slip_mm_s"], 2), &lost);
}

/// Whether the contacts were solved as the scene asks; nothing where it does not.
fn layer(out: &mut String, layer: &Value) {
    let (Some(solved), Some(plain)) = (layer["solved"].as_u64(), layer["plain"].as_u64()) else {
        return;
    };
    let _ = writeln!(out, "contact in three dimensions");
    row(out, "contacts solved for images", &solved.to_string(), "");
    let note = if plain > 0 { "the solution was lacking or not believed there" } else { "" };
    row(out, "rows on their own", &plain.to_string(), note);
}

fn hold(out: &mut String, s: &Value) {
    let _ = writeln!(out, "holding in IDLE/CALIBRATED");
    let e = &s["hold"]["finger_error_mm"];
    let text = format!("mean {}, peak {}", number(&e["mean"], 3), number(&e["peak"], 3));
    row(out, "finger off its place, mm", &text, "");
    let joints: Vec<String> = array(&s["hold"]["joint_error_deg"]).map(|j| number(j, 4)).collect();
    row(out, "joint droop, deg", &joints.join(" "), "");
    let expected: Vec<String> =
        array(&s["hold"]["gravity_over_kp_deg"]).map(|j| number(j, 4)).collect();
    if !expected.is_empty() {
        row(out, "gravity / Kp, deg", &expected.join(" "), "");
    }
}

fn array(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

fn tracking(out: &mut String, s: &Value) {
    let list = |key: &str| {
        let joints: Vec<String> = array(&s["tracking_deg"]).map(|j| number(&j[key], 3)).collect();
        joints.join(" ")
    };
    let joints = array(&s["tracking_deg"]).count();
    let _ = writeln!(out, "joint tracking error, joints 1 to {joints}");
    row(out, "rms, deg", &list("rms_error"), "");
    row(out, "peak, deg", &list("peak_error"), "");
}

fn lanes(out: &mut String, s: &Value) {
    let marked = s["representative_timing"] != true;
    let mark = if marked { MARK } else { "" };
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
    for lane in array(&s["lanes"]) {
        let three = |h: &Value| {
            let part = |key: &str| number(&h[key], 1);
            format!("{} / {} / {}{mark}", part("p50"), part("p99"), part("max"))
        };
        let misses: u64 = lane["misses"]
            .as_object()
            .map_or(0, |causes| causes.values().filter_map(Value::as_u64).sum());
        let _ = writeln!(
            out,
            "  {:<10} {:>6}  {:>33}  {:>26}  {:>6} {:>5} {:>5}",
            lane["name"].as_str().unwrap_or("-"),
            lane["jobs"].to_string(),
            three(&lane["release_late_us"]),
            three(&lane["exec_us"]),
            misses,
            lane["allocations"].as_u64().map_or_else(|| "-".into(), |n| n.to_string()),
            lane["page_faults"].to_string(),
        );
        causes(out, lane);
        budgets::lines(out, lane, mark);
    }
    if s["slipped_s"].as_f64().is_some_and(|slipped| slipped > 0.0) {
        let slipped = number(&s["slipped_s"], 4);
        let _ = writeln!(
            out,
            "  the machine stalled: {slipped} s in all, for which the simulated world waited"
        );
    }
    if marked {
        let why = if s["mode"] == "live" {
            "no PREEMPT_RT kernel, a virtual machine, or rights not granted"
        } else {
            "virtual time: nobody waits, jobs share one thread"
        };
        let _ = writeln!(out, "  * not representative: {why}");
    }
}

/// Why jobs missed, and what was lost, only when there is something to say.
fn causes(out: &mut String, lane: &Value) {
    let mut words = Vec::new();
    for (cause, count) in lane["misses"].as_object().into_iter().flatten() {
        if count.as_u64() != Some(0) {
            words.push(format!("{count} {}", cause.replace('_', " ")));
        }
    }
    for (key, text) in [
        ("skipped", "jobs skipped"),
        ("records_dropped", "records lost"),
        ("values_dropped", "values lost"),
    ] {
        if lane[key].as_u64().is_some_and(|n| n > 0) {
            words.push(format!("{} {text}", lane[key]));
        }
    }
    if lane["storms"].as_u64().is_some_and(|n| n > 0) {
        words.push("on a board these misses would have stopped the machine".to_owned());
    }
    if !words.is_empty() {
        let _ = writeln!(out, "    {}", words.join(", "));
    }
}

fn ending(out: &mut String, s: &Value) {
    for fault in array(&s["faults"]) {
        let (name, text) = (fault["name"].as_str(), fault["text"].as_str());
        let _ = writeln!(out, "FAULT {}: {}", name.unwrap_or_default(), text.unwrap_or_default());
    }
    if s["faults"].as_array().is_some_and(Vec::is_empty) {
        row(out, "faults", "none", "");
    }
    if let Some((what, note)) = moves::words(&s["moves"]) {
        row(out, "moves", &what, &note);
    }
    if s["refused_requests"].as_u64().is_some_and(|n| n > 0) {
        row(out, "refused requests", &s["refused_requests"].to_string(), "");
    }
    if s["interrupted"] == true {
        row(out, "ended by", "Ctrl-C, outputs left safe", "");
    }
    row(
        out,
        "seed",
        &s["seed"].to_string(),
        &format!("digest {}", s["digest"].as_str().unwrap_or("-")),
    );
    row(out, "repeat", s["repeat"].as_str().unwrap_or("-"), "");
}
