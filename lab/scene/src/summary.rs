//! The end of a run in numbers: one JSON object, the contract of `taktil run --json`. The table and
//! the report are drawn from it. Refuses to round and to invent: what was not measured is null.

use hdrhistogram::Histogram;
use serde_json::{Value, json};
use taktil_rtcore::live::{Attestation, RunReport};
use taktil_rtcore::{FaultCode, Figures as LaneFigures, LaneSpec, guard};

use super::score::{Figures, Span, Spread};
use super::{budgets, moves};
use taktil_record::granted::{attested, misses_json};

/// Where the figures of one run come from.
pub struct Ending<'a> {
    /// Scene path as given.
    pub scene: String,
    /// One line for people.
    pub title: &'a str,
    /// Seed.
    pub seed: u64,
    /// None in virtual time.
    pub account: Option<&'a RunReport>,
    /// Simulated seconds that were run.
    pub sim_s: f64,
    /// Wall seconds from the first job to the last.
    pub wall_s: f64,
    /// Digest of all records.
    pub digest: String,
    /// What was judged.
    pub figures: &'a Figures,
    /// Set point of the true force, N.
    pub force_set_point_n: f64,
    /// Lanes and what they counted.
    pub lanes: Vec<(&'a LaneSpec, &'a LaneFigures)>,
    /// Where jobs panicked, the first place of each lane.
    pub panics: Vec<&'a str>,
    /// Log file.
    pub log: Option<String>,
    /// Ended by a person.
    pub interrupted: bool,
    /// The command that repeats this run.
    pub repeat: String,
}

/// Bins of a histogram in a report: two per octave.
const BINS_PER_OCTAVE: u32 = 2;

impl Ending<'_> {
    /// No fault that calls for a reaction was latched.
    #[must_use]
    pub fn ok(&self) -> bool {
        self.figures.faults.is_empty()
    }

    /// The JSON object.
    #[must_use]
    pub fn json(&self) -> Value {
        let f = self.figures;
        let attestation = self.account.map(|account| &account.attestation);
        let faults: Vec<Value> = f.faults.iter().map(fault_json).collect();
        json!({
            "ok": self.ok(),
            "scene": self.scene,
            "title": self.title,
            "seed": self.seed,
            "mode": if attestation.is_some() { "live" } else { "fast" },
            "sim_s": self.sim_s,
            "wall_s": self.wall_s,
            "panics": self.panics,
            "slipped_s": self.account.map(|account| account.slipped.as_secs_f64()),
            "digest": self.digest,
            "interrupted": self.interrupted,
            "attested": attested(attestation),
            "representative_timing": attestation.is_some_and(Attestation::is_representative),
            "touched": f.touched,
            "rolled": f.rolled,
            "strokes": f.strokes,
            "x_c": span(f.x_c),
            "p_x_mm": span(f.p_x_mm),
            "p_z_mm": span(f.p_z_mm),
            "theta_xx_deg": span(f.theta_xx_deg),
            "theta_zz_deg": span(f.theta_zz_deg),
            "rolling_ratio": rolling_ratio(f),
            "features": {
                "x_c": error(&f.x_c_error),
                "m0": {
                    "mean": f.m0.mean(),
                    "rms_error": f.m0_error.rms(),
                    "peak_error": f.m0_error.peak(),
                },
                "m_x": error(&f.m_x_error),
                "theta_z": error_deg(&f.theta_z_error_deg),
            },
            "truth": self.truth_json(),
            "tracking_deg": f.tracking_deg.iter().map(error).collect::<Vec<_>>(),
            "hold": {
                "finger_error_mm": {
                    "mean": f.hold_error_mm.mean(),
                    "peak": f.hold_error_mm.peak(),
                    "steady": f.hold_error_mm.steady(),
                },
                "joint_error_deg": f.hold_error_deg.iter().map(Spread::steady).collect::<Vec<_>>(),
                "gravity_over_kp_deg": f.droop_expected_deg,
            },
            "lanes": self.lanes_json(attestation.is_some_and(Attestation::is_representative)),
            "faults": faults,
            "state": f.state.name(),
            "refused_requests": f.refused,
            "moves": f.moves.as_ref().map(|check| moves::json(check, &f.names)),
            "log": self.log,
            "repeat": self.repeat,
        })
    }

    fn lanes_json(&self, representative: bool) -> Vec<Value> {
        self.lanes.iter().map(|(spec, lane)| lane_json(spec, lane, representative)).collect()
    }

    fn truth_json(&self) -> Value {
        let f = self.figures;
        json!({
            "normal_force_n": {
                "mean": f.force_n.mean(),
                "rms_error": f.force_error_n.rms(),
                "peak_error": f.force_error_n.peak(),
                "set_point": self.force_set_point_n,
            },
            "pin_yaw_error_deg": spread(&f.yaw_error_deg),
            "pin_tilt_error_deg": spread(&f.tilt_error_deg),
            "height_error_mm": {
                "rms": f.height_error_mm().map(|(rms, _)| rms),
                "peak": f.height_error_mm().map(|(_, peak)| peak),
            },
            "slip_mm_s": f.slip_mm_s,
            "contact_lost": f.contact_lost,
            "layer": f.layer.map(|(solved, plain)| json!({ "solved": solved, "plain": plain })),
        })
    }
}

/// Finger travel over contact travel: 2 when nothing slips.
fn rolling_ratio(f: &Figures) -> Option<f64> {
    let contact_mm = f.x_c.width()? * PITCH_MM;
    (contact_mm > 0.0).then(|| f.p_x_mm.width().map(|travel| travel / contact_mm)).flatten()
}

/// Distance between tactels.
pub const PITCH_MM: f64 = 1e3 * taktil_sim::PITCH_M;

fn span(span: Span) -> Value {
    span.0.map_or(Value::Null, |(low, high)| json!([low, high]))
}

fn error(spread: &Spread) -> Value {
    json!({ "rms_error": spread.rms(), "peak_error": spread.peak() })
}

fn error_deg(spread: &Spread) -> Value {
    json!({ "rms_error": spread.rms(), "peak_error": spread.peak(), "unit": "deg" })
}

fn spread(spread: &Spread) -> Value {
    json!({ "rms": spread.rms(), "peak": spread.peak(), "steady": spread.steady() })
}

fn fault_json(fault: FaultCode) -> Value {
    json!({ "code": fault as u16, "name": format!("{fault:?}"), "text": fault.text() })
}

pub(super) fn percentiles_us(histogram: &Histogram<u64>) -> Value {
    let at = |quantile: f64| micros(histogram.value_at_quantile(quantile));
    json!({
        "p50": at(0.5),
        "p90": at(0.9),
        "p99": at(0.99),
        "p99_9": at(0.999),
        "max": micros(histogram.max()),
    })
}

#[expect(clippy::cast_precision_loss, reason = "nanoseconds of a job")]
fn micros(ns: u64) -> f64 {
    ns as f64 / 1000.0
}

/// Upper edges (us) and counts, for a picture.
fn bins(histogram: &Histogram<u64>) -> Value {
    let mut bins: Vec<Value> = Vec::new();
    let mut below = 0;
    let mut edge = 100.0;
    let factor = libm::exp2(1.0 / f64::from(BINS_PER_OCTAVE));
    while below < histogram.len() {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive ns")]
        let upper = edge as u64;
        let count = histogram.count_between(0, upper).saturating_sub(below);
        bins.push(json!([micros(upper), count]));
        below += count;
        edge *= factor;
        if edge > 2e9 {
            break;
        }
    }
    Value::Array(bins)
}

fn lane_json(spec: &LaneSpec, lane: &LaneFigures, representative: bool) -> Value {
    json!({
        "name": spec.name,
        "period_ns": spec.period.0,
        "deadline_ns": spec.deadline.0,
        "priority": spec.priority,
        "jobs": lane.jobs,
        "skipped": lane.skipped,
        "release_late_us": percentiles_us(&lane.lateness_ns),
        "exec_us": percentiles_us(&lane.execution_ns),
        "awake_us": percentiles_us(&lane.awake_ns),
        "guard": lane.guard.map(|guard| json!({
            "margin_ns": guard.margin.0,
            "cpu_share": guard.share(),
        })),
        "tasks": budgets::json(lane, representative),
        "release_late_bins": bins(&lane.lateness_ns),
        "exec_bins": bins(&lane.execution_ns),
        "misses": misses_json(&lane.misses),
        "storms": lane.storms,
        "allocations": guard::installed().then_some(lane.allocations),
        "page_faults": lane.page_faults,
        "records_dropped": lane.records_dropped,
        "values_dropped": lane.values_dropped,
    })
}
