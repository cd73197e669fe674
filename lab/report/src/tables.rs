//! Tables of a report, from a run's summary. Refuses to invent: what the summary does not hold is
//! left out, what it holds as null is a dash.

use serde_json::Value;

use taktil_lab_plot::axis::plain;
use taktil_lab_plot::chart::shown;
use taktil_lab_plot::svg::escape;
use taktil_lab_plot::timing::waits;
use taktil_lab_plot::views::Stated;

const DASH: &str = "\u{2013}";

fn number(summary: &Value, path: &str) -> Option<f64> {
    summary.pointer(path).and_then(Value::as_f64)
}

fn pair(summary: &Value, path: &str) -> Option<(f64, f64)> {
    let value = summary.pointer(path)?;
    Some((value.get(0)?.as_f64()?, value.get(1)?.as_f64()?))
}

fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| DASH.to_owned())
}

/// One line of the verdict: done or stopped, how long, what was missing.
pub(super) fn verdict(summary: &Value) -> String {
    let mut out = String::from("<p>");
    let ok = summary.get("ok").and_then(Value::as_bool);
    match ok {
        Some(true) => out.push_str("<span class=\"good\">No fault.</span>"),
        Some(false) => out.push_str("<span class=\"bad\">Stopped by a fault.</span>"),
        None => {}
    }
    if summary.get("interrupted").and_then(Value::as_bool) == Some(true) {
        out.push_str(" <span class=\"bad\">Ended by hand.</span>");
    }
    if let (Some(sim), Some(wall)) = (number(summary, "/sim_s"), number(summary, "/wall_s")) {
        let speed = if wall > 0.0 {
            format!(", {} times real time", plain(sim / wall))
        } else {
            String::new()
        };
        out.push_str(&format!(" {} s of robot time in {} s{speed}.", plain(sim), plain(wall)));
    }
    out.push_str("</p>\n");
    let faults = summary.get("faults").and_then(Value::as_array);
    for fault in faults.into_iter().flatten() {
        let said = fault.get("text").and_then(Value::as_str).map(str::to_owned);
        let said = escape(&said.unwrap_or_else(|| fault.to_string()));
        let name = fault.get("name").and_then(Value::as_str).map(escape).unwrap_or_default();
        out.push_str(&format!("<p class=\"warn\">Fault {name}: {said}.</p>\n"));
    }
    out
}

struct Row {
    what: &'static str,
    value: String,
    thesis: String,
}

fn row(what: &'static str, value: Option<String>, thesis: &str) -> Row {
    Row { what, value: or_dash(value), thesis: thesis.to_owned() }
}

fn span_row(summary: &Value, what: &'static str, path: &str, thesis: Option<(f64, f64)>) -> Row {
    let value = pair(summary, path).map(|(low, high)| {
        format!("{} <span class=\"dim\">({} wide)</span>", shown(low, high), plain(high - low))
    });
    row(what, value, &thesis.map(|(low, high)| shown(low, high)).unwrap_or_default())
}

fn rms_peak(summary: &Value, path: &str, keys: [&str; 2], unit: &str) -> Option<String> {
    let [rms, peak] = keys.map(|key| number(summary, &format!("{path}/{key}")));
    let (rms, peak) = (rms?, peak?);
    Some(format!("{} rms, {} peak{unit}", plain(rms), plain(peak)))
}

const ERROR: [&str; 2] = ["rms_error", "peak_error"];
const SPREAD: [&str; 2] = ["rms", "peak"];

fn rolling_rows(summary: &Value, thesis: &Stated) -> Vec<Row> {
    let m0 = number(summary, "/features/m0/mean").map(|mean| {
        let spread = rms_peak(summary, "/features/m0", ERROR, "");
        let spread = spread.map(|text| format!(" <span class=\"dim\">(off by {text})</span>"));
        format!("{}{}", plain(mean), spread.unwrap_or_default())
    });
    let strokes = summary.get("strokes").and_then(Value::as_u64).map(|n| n.to_string());
    vec![
        row("reversals of rolling", strokes, "3 in 10 s"),
        span_row(summary, "centroid x_c (tactels)", "/x_c", Some(thesis.x_c)),
        span_row(summary, "finger p_x (mm)", "/p_x_mm", Some(thesis.p_x_mm)),
        row(
            "finger travel over contact travel",
            number(summary, "/rolling_ratio").map(plain),
            "2 without slip",
        ),
        span_row(summary, "finger p_z (mm)", "/p_z_mm", Some(thesis.p_z_mm)),
        span_row(summary, "tilt theta_zz (deg)", "/theta_zz_deg", Some(thesis.theta_zz_deg)),
        span_row(summary, "turn theta_xx (deg)", "/theta_xx_deg", Some(thesis.theta_xx_deg)),
        row("sum M0 (counts)", m0, "near 15000, large spikes"),
        row("x_c read minus true (tactels)", rms_peak(summary, "/features/x_c", ERROR, ""), ""),
        row("moment M_x (counts tactels)", rms_peak(summary, "/features/m_x", ERROR, ""), ""),
        row(
            "direction theta_z (deg)",
            rms_peak(summary, "/features/theta_z", ERROR, ""),
            "noise about \u{b1}5",
        ),
    ]
}

fn truth_rows(summary: &Value) -> Vec<Row> {
    let force = number(summary, "/truth/normal_force_n/mean").map(|mean| {
        let wish = or_dash(number(summary, "/truth/normal_force_n/set_point").map(plain));
        let error = rms_peak(summary, "/truth/normal_force_n", ERROR, "");
        let error = or_dash(error.or_else(|| {
            number(summary, "/truth/normal_force_n/rms_error")
                .map(|rms| format!("{} rms", plain(rms)))
        }));
        format!("{} for {wish} <span class=\"dim\">(off by {error})</span>", plain(mean))
    });
    let lost = summary.pointer("/truth/contact_lost").and_then(Value::as_u64);
    let spread = |path: &str| rms_peak(summary, path, SPREAD, "");
    vec![
        row("true normal force (N)", force, ""),
        row("true yaw of the pin (deg)", spread("/truth/pin_yaw_error_deg"), ""),
        row("true tilt against the pin (deg)", spread("/truth/pin_tilt_error_deg"), ""),
        row("height over the pin (mm)", spread("/truth/height_error_mm"), ""),
        row("times contact was lost", lost.map(|n| n.to_string()), ""),
    ]
}

fn tracking_row(summary: &Value) -> Option<Row> {
    let joints = summary.get("tracking_deg")?.as_array()?;
    let worst = |key: &str| {
        let all = joints.iter().filter_map(|joint| joint.get(key).and_then(Value::as_f64));
        all.fold(None, |most: Option<f64>, x| Some(most.map_or(x, |m| m.max(x))))
    };
    let (rms, peak) = (worst("rms_error")?, worst("peak_error")?);
    let value = format!("{} rms, {} peak", plain(rms), plain(peak));
    Some(row("worst joint behind its desired angle (deg)", Some(value), ""))
}

/// The closing table; rows that the summary knows nothing about are left out.
pub(super) fn closing(summary: &Value, thesis: &Stated) -> String {
    let mut rows = rolling_rows(summary, thesis);
    rows.extend(tracking_row(summary));
    rows.extend(truth_rows(summary));
    let mut out = String::from("<table>\n<tr><th>what</th><th>this run</th><th>thesis</th></tr>\n");
    for row in rows.iter().filter(|row| row.value != DASH || !row.thesis.is_empty()) {
        let (what, value, thesis) = (row.what, &row.value, &row.thesis);
        out.push_str(&format!("<tr><td>{what}</td><td>{value}</td><td>{thesis}</td></tr>\n"));
    }
    out.push_str("</table>\n");
    out
}

/// What keeps timing figures from being representative; empty when nothing does.
pub(super) fn timing_caution(summary: &Value) -> String {
    if !waits(summary) {
        return "<p class=\"dim\">Virtual time: no job waits, so none is late; execution times are \
                those of this machine.</p>\n"
            .to_owned();
    }
    if summary.get("representative_timing").and_then(Value::as_bool) != Some(false) {
        return String::new();
    }
    let missing = summary.pointer("/attested/missing").and_then(Value::as_array);
    let named = |item: &Value| item.as_str().map_or_else(|| item.to_string(), str::to_owned);
    let missing: Vec<String> = missing.into_iter().flatten().map(named).collect();
    let why = if missing.is_empty() {
        String::new()
    } else {
        format!(" Missing: {}.", escape(&missing.join("; ")))
    };
    format!(
        "<p class=\"warn\">These figures are not representative of a real-time machine.{why}</p>\n"
    )
}

/// What was not as the contract has it; empty when everything was, and in virtual time.
pub(super) fn contract(summary: &Value) -> String {
    let rows = summary.pointer("/attested/shortfalls").and_then(Value::as_array);
    let mut out = String::new();
    for short in rows.into_iter().flatten() {
        out.push_str("<tr>");
        for key in ["item", "weight", "found", "wanted", "remedy"] {
            let text = short.get(key).and_then(Value::as_str).unwrap_or(DASH);
            out.push_str(&format!("<td>{}</td>", escape(text)));
        }
        out.push_str("</tr>\n");
    }
    if out.is_empty() {
        return out;
    }
    format!(
        "<table>\n<tr><th>asked of the kernel</th><th>weight</th><th>found</th><th>wanted</th>\
         <th>remedy</th></tr>\n{out}</table>\n"
    )
}

/// Heading of the table of lanes, two rows.
const LANE_HEAD: &str = "<div class=\"wide\"><table class=\"tight\">\n\
    <tr><th rowspan=\"2\">lane</th><th class=\"num\" rowspan=\"2\">period<br/>(ms)</th>\
    <th class=\"num\" rowspan=\"2\">jobs</th>\
    <th class=\"mid\" colspan=\"4\">released late (\u{b5}s)</th>\
    <th class=\"mid\" colspan=\"3\">execution (\u{b5}s)</th>\
    <th class=\"num\" rowspan=\"2\">misses</th>\
    <th class=\"num\" rowspan=\"2\">allo-<br/>cations</th>\
    <th class=\"num\" rowspan=\"2\">page<br/>faults</th>\
    <th class=\"num\" rowspan=\"2\">records<br/>lost</th></tr>\n\
    <tr><th class=\"num\">p50</th><th class=\"num\">p99</th><th class=\"num\">p99.9</th>\
    <th class=\"num\">max</th><th class=\"num\">p50</th><th class=\"num\">p99</th>\
    <th class=\"num\">max</th></tr>\n";

/// Lanes and what they counted; empty without lanes.
pub(super) fn lanes(summary: &Value) -> String {
    let Some(lanes) = summary.get("lanes").and_then(Value::as_array) else { return String::new() };
    if lanes.is_empty() {
        return String::new();
    }
    let mut out = String::from(LANE_HEAD);
    for lane in lanes {
        let name = escape(lane.get("name").and_then(Value::as_str).unwrap_or("?"));
        out.push_str(&format!("<tr><td>{name}</td>"));
        let at = |path: &str| or_dash(number(lane, path).map(plain));
        let late = |path: &str| if waits(summary) { at(path) } else { DASH.to_owned() };
        let misses: Option<u64> = lane
            .get("misses")
            .and_then(Value::as_object)
            .map(|kinds| kinds.values().filter_map(Value::as_u64).sum());
        let cells = [
            or_dash(number(lane, "/period_ns").map(|ns| plain(ns / 1e6))),
            at("/jobs"),
            late("/release_late_us/p50"),
            late("/release_late_us/p99"),
            late("/release_late_us/p99_9"),
            late("/release_late_us/max"),
            at("/exec_us/p50"),
            at("/exec_us/p99"),
            at("/exec_us/max"),
            or_dash(misses.map(|n| n.to_string())),
            at("/allocations"),
            at("/page_faults"),
            at("/records_dropped"),
        ];
        for cell in cells {
            out.push_str(&format!("<td class=\"num\">{cell}</td>"));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</table></div>\n");
    out
}
