//! Computes the closing summary of a run from its score and from the counts of its lanes. Nothing
//! is rounded, and values that were not measured are absent.

use taktil_record::granted::{Grants, misses_by_cause};
use taktil_record::summary::{
    ContactCounts, DistanceFigures, ErrorFigures, FaultSummary, FeatureErrors, ForceFigures,
    GuardSummary, HeightFigures, HoldFigures, LaneSummary, LevelFigures, PhaseSummary, Range,
    RunMode, SpreadFigures, Summary, TruthFigures,
};
use taktil_rtcore::live::{Attestation, RunReport};
use taktil_rtcore::{Figures as LaneFigures, LaneSpec, guard};
use taktil_signal::{PhaseChange, phase_cause};

use super::budgets::task_summaries;
use super::moves::move_summary;
use super::score::{Figures, Span, Spread};
use super::statistics::{bins_us, finite, percentiles_us};

/// A run that has ended, and the sources of its figures.
pub struct FinishedRun<'a> {
    /// Path of the scene as it was given.
    pub scene: String,
    /// One line for people.
    pub title: &'a str,
    /// Seed of the run's random numbers.
    pub seed: u64,
    /// Account of the executor; absent in virtual time.
    pub account: Option<&'a RunReport>,
    /// Duration of the run in simulated seconds.
    pub sim_s: f64,
    /// Wall seconds from the first job to the last.
    pub wall_s: f64,
    /// Digest of all records.
    pub digest: String,
    /// The figures of the score.
    pub figures: &'a Figures,
    /// Set point of the true force (N).
    pub force_set_point_n: f64,
    /// Lanes and their counts.
    pub lanes: Vec<(&'a LaneSpec, &'a LaneFigures)>,
    /// Places where jobs panicked, the first of each lane.
    pub panics: Vec<&'a str>,
    /// Log file.
    pub log: Option<String>,
    /// True when a person ended the run.
    pub interrupted: bool,
    /// The command that repeats this run.
    pub repeat: String,
}

impl FinishedRun<'_> {
    /// The summary of the run.
    #[must_use]
    pub fn summary(&self) -> Summary {
        let f = self.figures;
        let attestation = self.account.map(|account| &account.attestation);
        let representative = attestation.is_some_and(Attestation::is_representative);
        Summary {
            ok: f.faults.is_empty(),
            scene: self.scene.clone(),
            title: self.title.to_owned(),
            seed: self.seed,
            mode: if attestation.is_some() { RunMode::Live } else { RunMode::Fast },
            sim_s: self.sim_s,
            wall_s: self.wall_s,
            panics: self.panics.iter().map(|&place| place.to_owned()).collect(),
            slipped_s: self.account.map(|account| account.slipped.as_secs_f64()),
            digest: self.digest.clone(),
            interrupted: self.interrupted,
            attested: Grants::new(attestation),
            representative_timing: representative,
            touched: f.touched,
            rolled: f.rolled,
            strokes: f.strokes,
            x_c: range(f.x_c),
            p_x_mm: range(f.p_x_mm),
            p_z_mm: range(f.p_z_mm),
            theta_xx_deg: range(f.theta_xx_deg),
            theta_zz_deg: range(f.theta_zz_deg),
            rolling_ratio: rolling_ratio(f).and_then(finite),
            features: feature_errors(f),
            truth: self.truth_figures(),
            tracking_deg: f.tracking_deg.iter().map(error_figures).collect(),
            hold: hold_figures(f),
            lanes: self
                .lanes
                .iter()
                .map(|(spec, lane)| lane_summary(spec, lane, representative))
                .collect(),
            faults: f.faults.iter().map(FaultSummary::from).collect(),
            state: f.state.name().to_owned(),
            refused_requests: f.refused,
            moves: f.moves.as_ref().map(|check| move_summary(check, &f.names)),
            phases: f.phases.iter().map(|change| phase_summary(change, &f.phase_names)).collect(),
            log: self.log.clone(),
            repeat: self.repeat.clone(),
        }
    }

    fn truth_figures(&self) -> TruthFigures {
        let f = self.figures;
        let height = f.height_error_mm();
        TruthFigures {
            normal_force_n: ForceFigures {
                mean: f.force_n.mean().and_then(finite),
                rms_error: f.force_error_n.rms().and_then(finite),
                peak_error: f.force_error_n.peak().and_then(finite),
                set_point: finite(self.force_set_point_n),
            },
            pin_yaw_error_deg: spread_figures(&f.yaw_error_deg),
            pin_tilt_error_deg: spread_figures(&f.tilt_error_deg),
            height_error_mm: HeightFigures {
                rms: height.and_then(|(rms, _)| finite(rms)),
                peak: height.and_then(|(_, peak)| finite(peak)),
            },
            slip_mm_s: f.slip_mm_s.and_then(finite),
            contact_lost: f.contact_lost,
            layer: f.layer.map(|(spatial_solutions, spatial_failures)| ContactCounts {
                spatial_solutions,
                spatial_failures,
            }),
        }
    }
}

/// A change of phase with names in the place of numbers.
fn phase_summary(change: &PhaseChange, names: &[String]) -> PhaseSummary {
    let cause = match change.cause {
        phase_cause::TASK_STARTED => "the task began",
        phase_cause::CONDITIONS_MET => "its conditions were met",
        phase_cause::TIME_OUT => "it took too long",
        phase_cause::CONTACT_LOST => "contact was lost",
        phase_cause::TOO_FAR => "too far, or held up",
        phase_cause::TOO_OFTEN => "entered too often",
        _ => "unknown",
    };
    let phase = match change.phase {
        0 => "end".to_owned(),
        number => names.get(number as usize - 1).cloned().unwrap_or_else(|| number.to_string()),
    };
    PhaseSummary {
        at_s: 1e-9 * change.at_ns as f64,
        phase,
        cause: cause.to_owned(),
        time_s: change.time_s,
        moved: change.moved,
        m0: change.m0,
    }
}

/// Ratio of finger travel to contact travel; it is 2 when nothing slips.
fn rolling_ratio(f: &Figures) -> Option<f64> {
    let contact_mm = f.x_c.width()? * f.pitch_x_mm;
    (contact_mm > 0.0).then(|| f.p_x_mm.width().map(|travel| travel / contact_mm)).flatten()
}

fn range(span: Span) -> Option<Range> {
    span.0.map(|(low, high)| [low, high]).filter(|ends| ends.iter().all(|end| end.is_finite()))
}

fn error_figures(error: &Spread) -> ErrorFigures {
    ErrorFigures {
        rms_error: error.rms().and_then(finite),
        peak_error: error.peak().and_then(finite),
        unit: None,
    }
}

fn feature_errors(f: &Figures) -> FeatureErrors {
    FeatureErrors {
        x_c: error_figures(&f.x_c_error),
        m0: LevelFigures {
            mean: f.m0.mean().and_then(finite),
            rms_error: f.m0_error.rms().and_then(finite),
            peak_error: f.m0_error.peak().and_then(finite),
        },
        m_x: error_figures(&f.m_x_error),
        theta_z: ErrorFigures {
            unit: Some("deg".to_owned()),
            ..error_figures(&f.theta_z_error_deg)
        },
    }
}

fn hold_figures(f: &Figures) -> HoldFigures {
    let gravity = f.droop_expected_deg.as_ref();
    HoldFigures {
        finger_error_mm: DistanceFigures {
            mean: f.hold_error_mm.mean().and_then(finite),
            peak: f.hold_error_mm.peak().and_then(finite),
            steady: f.hold_error_mm.steady().and_then(finite),
        },
        joint_error_deg: f.hold_error_deg.iter().map(|e| e.steady().and_then(finite)).collect(),
        gravity_over_kp_deg: gravity.map(|joints| joints.iter().map(|deg| finite(*deg)).collect()),
    }
}

fn spread_figures(spread: &Spread) -> SpreadFigures {
    SpreadFigures {
        rms: spread.rms().and_then(finite),
        peak: spread.peak().and_then(finite),
        steady: spread.steady().and_then(finite),
    }
}

fn lane_summary(spec: &LaneSpec, lane: &LaneFigures, representative: bool) -> LaneSummary {
    LaneSummary {
        name: spec.name.clone(),
        period_ns: spec.period.0,
        deadline_ns: spec.deadline.0,
        priority: spec.priority,
        jobs: lane.jobs,
        skipped: lane.skipped,
        release_late_us: percentiles_us(&lane.lateness_ns),
        exec_us: percentiles_us(&lane.execution_ns),
        awake_us: percentiles_us(&lane.awake_ns),
        guard: lane
            .guard
            .map(|guard| GuardSummary { margin_ns: guard.margin.0, cpu_share: guard.share() }),
        tasks: task_summaries(lane, representative),
        release_late_bins: bins_us(&lane.lateness_ns),
        exec_bins: bins_us(&lane.execution_ns),
        misses: misses_by_cause(&lane.misses),
        storms: lane.storms,
        allocations: guard::installed().then_some(lane.allocations),
        page_faults: lane.page_faults,
        records_dropped: lane.records_dropped,
        values_dropped: lane.values_dropped,
    }
}
