//! Tables of the HTML report, from a run's summary. A dash stands for a value that was not
//! measured; rows about events that did not occur are left out.

use taktil_lab_plot::axis::format_number;
use taktil_lab_plot::chart::format_range;
use taktil_lab_plot::svg::escape;
use taktil_lab_plot::timing::waits;
use taktil_lab_plot::views::ThesisRanges;
use taktil_record::summary::{ErrorFigures, LaneSummary, Range, Summary};

const DASH: &str = "\u{2013}";

fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| DASH.to_owned())
}

/// The result in one line: completed or stopped, duration, missing rights.
pub(super) fn verdict(summary: &Summary) -> String {
    let mut out = String::from("<p>");
    out.push_str(if summary.ok {
        "<span class=\"good\">No fault.</span>"
    } else {
        "<span class=\"bad\">Stopped by a fault.</span>"
    });
    if summary.interrupted {
        out.push_str(" <span class=\"bad\">Ended by hand.</span>");
    }
    let (sim_s, wall_s) = (summary.sim_s, summary.wall_s);
    let speed = if wall_s > 0.0 {
        format!(", {} times real time", format_number(sim_s / wall_s))
    } else {
        String::new()
    };
    out.push_str(&format!(
        " {} s of robot time in {} s{speed}.</p>\n",
        format_number(sim_s),
        format_number(wall_s)
    ));
    for fault in &summary.faults {
        let (name, text) = (escape(&fault.name), escape(&fault.text));
        out.push_str(&format!("<p class=\"warn\">Fault {name}: {text}.</p>\n"));
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

fn range_row(what: &'static str, range: Option<Range>, thesis: Range) -> Row {
    let value = range.map(|[low, high]| {
        format!(
            "{} <span class=\"dim\">({} wide)</span>",
            format_range(low, high),
            format_number(high - low)
        )
    });
    row(what, value, &format_range(thesis[0], thesis[1]))
}

fn rms_and_peak(rms: Option<f64>, peak: Option<f64>) -> Option<String> {
    Some(format!("{} rms, {} peak", format_number(rms?), format_number(peak?)))
}

fn rolling_rows(summary: &Summary, thesis: &ThesisRanges) -> Vec<Row> {
    let f = &summary.features;
    let m0 = f.m0.mean.map(|mean| {
        let error = rms_and_peak(f.m0.rms_error, f.m0.peak_error);
        let error = error.map(|text| format!(" <span class=\"dim\">(off by {text})</span>"));
        format!("{}{}", format_number(mean), error.unwrap_or_default())
    });
    let error = |e: &ErrorFigures| rms_and_peak(e.rms_error, e.peak_error);
    vec![
        row("reversals of rolling", Some(summary.strokes.to_string()), "3 in 10 s"),
        range_row("centroid x_c (tactels)", summary.x_c, thesis.x_c),
        range_row("finger p_x (mm)", summary.p_x_mm, thesis.p_x_mm),
        row(
            "finger travel over contact travel",
            summary.rolling_ratio.map(format_number),
            "2 without slip",
        ),
        range_row("finger p_z (mm)", summary.p_z_mm, thesis.p_z_mm),
        range_row("tilt theta_zz (deg)", summary.theta_zz_deg, thesis.theta_zz_deg),
        range_row("turn theta_xx (deg)", summary.theta_xx_deg, thesis.theta_xx_deg),
        row("sum M0 (counts)", m0, "near 15000, large spikes"),
        row("x_c read minus true (tactels)", error(&f.x_c), ""),
        row("moment M_x (counts tactels)", error(&f.m_x), ""),
        row("direction theta_z (deg)", error(&f.theta_z), "noise about \u{b1}5"),
    ]
}

fn truth_rows(summary: &Summary) -> Vec<Row> {
    let truth = &summary.truth;
    let force = &truth.normal_force_n;
    let force = force.mean.map(|mean| {
        let set_point = or_dash(force.set_point.map(format_number));
        let error = rms_and_peak(force.rms_error, force.peak_error);
        let error = error.or_else(|| Some(format!("{} rms", format_number(force.rms_error?))));
        let error = or_dash(error);
        format!(
            "{} for {set_point} <span class=\"dim\">(off by {error})</span>",
            format_number(mean)
        )
    });
    let (yaw, tilt) = (&truth.pin_yaw_error_deg, &truth.pin_tilt_error_deg);
    let height = &truth.height_error_mm;
    vec![
        row("true normal force (N)", force, ""),
        row("true yaw of the pin (deg)", rms_and_peak(yaw.rms, yaw.peak), ""),
        row("true tilt against the pin (deg)", rms_and_peak(tilt.rms, tilt.peak), ""),
        row("height over the pin (mm)", rms_and_peak(height.rms, height.peak), ""),
        row("times contact was lost", Some(truth.contact_lost.to_string()), ""),
    ]
}

fn tracking_row(joints: &[ErrorFigures]) -> Option<Row> {
    let worst = |figure: fn(&ErrorFigures) -> Option<f64>| {
        joints.iter().filter_map(figure).reduce(f64::max)
    };
    let (rms, peak) = (worst(|joint| joint.rms_error)?, worst(|joint| joint.peak_error)?);
    let value = format!("{} rms, {} peak", format_number(rms), format_number(peak));
    Some(row("worst joint behind its desired angle (deg)", Some(value), ""))
}

/// The closing table, without rows that have neither a value nor a statement of the thesis.
pub(super) fn closing(summary: &Summary, thesis: &ThesisRanges) -> String {
    let mut rows = rolling_rows(summary, thesis);
    rows.extend(tracking_row(&summary.tracking_deg));
    rows.extend(truth_rows(summary));
    let mut out = String::from("<table>\n<tr><th>what</th><th>this run</th><th>thesis</th></tr>\n");
    for row in rows.iter().filter(|row| row.value != DASH || !row.thesis.is_empty()) {
        let (what, value, thesis) = (row.what, &row.value, &row.thesis);
        out.push_str(&format!("<tr><td>{what}</td><td>{value}</td><td>{thesis}</td></tr>\n"));
    }
    out.push_str("</table>\n");
    out
}

/// The reasons why timing figures are not representative; empty when they are.
pub(super) fn timing_caution(summary: &Summary) -> String {
    if !waits(summary) {
        return "<p class=\"dim\">Virtual time: no job waits, so none is late; execution times are \
                those of this machine.</p>\n"
            .to_owned();
    }
    if summary.representative_timing {
        return String::new();
    }
    let missing = &summary.attested.missing;
    let why = if missing.is_empty() {
        String::new()
    } else {
        format!(" Missing: {}.", escape(&missing.join("; ")))
    };
    format!(
        "<p class=\"warn\">These figures are not representative of a real-time machine.{why}</p>\n"
    )
}

/// The items of the contract that were not met; empty when all were met, and in virtual time.
pub(super) fn contract(summary: &Summary) -> String {
    let mut out = String::new();
    for unmet in summary.attested.shortfalls.iter().flatten() {
        out.push_str("<tr>");
        for text in [&unmet.item, &unmet.weight, &unmet.found, &unmet.wanted, &unmet.remedy] {
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
pub(super) fn lanes(summary: &Summary) -> String {
    if summary.lanes.is_empty() {
        return String::new();
    }
    let mut out = String::from(LANE_HEAD);
    for lane in &summary.lanes {
        out.push_str(&format!("<tr><td>{}</td>", escape(&lane.name)));
        for cell in lane_cells(lane, waits(summary)) {
            out.push_str(&format!("<td class=\"num\">{cell}</td>"));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</table></div>\n");
    out
}

/// The cells of a lane's row after its name; lateness only where jobs wait for their releases.
#[expect(clippy::cast_precision_loss, reason = "counts and times of a run, for people")]
fn lane_cells(lane: &LaneSummary, waits: bool) -> [String; 13] {
    let (late, exec) = (&lane.release_late_us, &lane.exec_us);
    let lateness = |us: f64| if waits { format_number(us) } else { DASH.to_owned() };
    let count = |n: u64| format_number(n as f64);
    [
        format_number(lane.period_ns as f64 / 1e6),
        count(lane.jobs),
        lateness(late.p50),
        lateness(late.p99),
        lateness(late.p99_9),
        lateness(late.max),
        format_number(exec.p50),
        format_number(exec.p99),
        format_number(exec.max),
        lane.missed().to_string(),
        or_dash(lane.allocations.map(count)),
        count(lane.page_faults),
        count(lane.records_dropped),
    ]
}
