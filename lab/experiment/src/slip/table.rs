//! The runs as CSV and JSON, a row each, and their summary as tables.

use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::Path;

use anyhow::Context;
use serde_json::json;
use taktil_lab_plot::axis::format_number;
use taktil_mechanics::slip::bound::{FrameLimits, delay_s, path_power};

use super::{DELAY_MAX_S, DETECTED_SHARE_MIN, REQUIRED_SPEED_MM_S, SlipRun};

/// Heading of the table of runs.
const HEADING: &str = "kind,speed_mm_s,number,seed,about,delay_s,sliding_delay_s,bound_s,\
best_share,velocity_mm_s,velocity_error_mm_s,place_bound_mm,false_alarms,ready_s,\
largest_ratio,faults\n";
/// Time between two images, and from an image to the job that acts by it (s): those of the machine
/// of the scenes.
const FRAME_S: f64 = 0.005;
const LATENCY_S: f64 = 0.0025;
/// False alarms in an hour for which bound and test are set.
const FALSE_ALARMS_PER_H: f64 = 1.0;

fn limits(run: &SlipRun) -> Option<FrameLimits> {
    Some(FrameLimits {
        place_mm: run.findings.place_bound_mm?,
        frame_s: FRAME_S,
        latency_s: LATENCY_S,
        false_alarms_per_h: FALSE_ALARMS_PER_H,
    })
}

/// The delay that no test beats in 95 % of the slips (s).
fn bound_s(run: &SlipRun) -> Option<f64> {
    Some(delay_s(&limits(run)?, run.draw.as_ref()?.speed_mm_s, DETECTED_SHARE_MIN))
}

/// The probability with which the best test had noticed this very slip within the time that is
/// required.
fn best_share(run: &SlipRun) -> Option<f64> {
    Some(path_power(&limits(run)?, run.findings.squares_mm2))
}

fn csv_line(run: &SlipRun) -> String {
    let cell = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    let (kind, speed, number, about) = match &run.draw {
        Some(draw) => ("sliding", Some(draw.speed_mm_s), draw.number, draw.about.as_str()),
        None => ("rolling", None, run.seed, ""),
    };
    let found = &run.findings;
    format!(
        "{kind},{},{number},{},\"{about}\",{},{},{},{},{},{},{},{},{},{},{}\n",
        cell(speed),
        run.seed,
        cell(found.delay_s),
        cell(found.sliding_delay_s),
        cell(bound_s(run)),
        cell(best_share(run)),
        cell(found.velocity_mm_s),
        cell(found.velocity_error_mm_s),
        cell(found.place_bound_mm),
        found.false_alarms,
        found.ready_s,
        found.largest_ratio,
        found.faults
    )
}

/// The table of runs, written row by row.
pub(super) struct RunRows(File);

impl RunRows {
    pub(super) fn create(path: &Path) -> anyhow::Result<RunRows> {
        let shown = path.display();
        let mut file = File::create(path).with_context(|| format!("cannot write {shown}"))?;
        file.write_all(HEADING.as_bytes()).with_context(|| format!("cannot write {shown}"))?;
        Ok(RunRows(file))
    }

    /// Appends a row by one write, so that rows of several threads do not mix.
    pub(super) fn append(&self, run: &SlipRun) -> anyhow::Result<()> {
        (&self.0).write_all(csv_line(run).as_bytes()).context("cannot write the table of runs")
    }
}

/// Writes all runs as JSON.
pub(super) fn write_json(path: &Path, runs: &[SlipRun]) -> anyhow::Result<()> {
    let rows: Vec<_> = runs
        .iter()
        .map(|run| {
            let (draw, found) = (run.draw.as_ref(), &run.findings);
            json!({
                "speed_mm_s": draw.map(|draw| draw.speed_mm_s),
                "number": draw.map(|draw| draw.number),
                "about": draw.map(|draw| draw.about.as_str()),
                "seed": run.seed,
                "delay_s": found.delay_s,
                "sliding_delay_s": found.sliding_delay_s,
                "bound_s": bound_s(run),
                "best_share": best_share(run),
                "velocity_mm_s": found.velocity_mm_s,
                "velocity_error_mm_s": found.velocity_error_mm_s,
                "place_bound_mm": found.place_bound_mm,
                "false_alarms": found.false_alarms,
                "ready_s": found.ready_s,
                "largest_ratio": found.largest_ratio,
                "faults": found.faults,
            })
        })
        .collect();
    write_text(path, &serde_json::to_string_pretty(&json!({ "runs": rows }))?)
}

/// Writes a text to a file.
pub(super) fn write_text(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// The value at a share of sorted numbers; infinite ones last.
fn quantile(mut all: Vec<f64>, share: f64) -> Option<f64> {
    all.sort_by(f64::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    let place = (share * all.len().saturating_sub(1) as f64).ceil() as usize;
    all.get(place).copied()
}

fn sliding(runs: &[SlipRun], speed_mm_s: f64) -> Vec<&SlipRun> {
    let is_of = |run: &&SlipRun| {
        run.draw.as_ref().is_some_and(|draw| draw.speed_mm_s.to_bits() == speed_mm_s.to_bits())
    };
    runs.iter().filter(is_of).collect()
}

/// Delays from the instant at which the body slides; infinite for a slip that was not noticed.
fn delays(of: &[&SlipRun]) -> Vec<f64> {
    of.iter().map(|run| run.findings.sliding_delay_s.unwrap_or(f64::INFINITY)).collect()
}

#[expect(clippy::cast_precision_loss, reason = "counts of runs")]
fn share_within(of: &[&SlipRun], most_s: f64) -> f64 {
    let soon = delays(of).into_iter().filter(|delay| *delay <= most_s).count();
    soon as f64 / of.len().max(1) as f64
}

fn ms(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), |value| match value.is_finite() {
        true => format!("{:.1}", 1e3 * value),
        false => "never".to_owned(),
    })
}

/// The tables.
#[expect(clippy::cast_precision_loss, reason = "counts of runs")]
pub(super) fn markdown(speeds: &[f64], runs: &[SlipRun]) -> String {
    let mut text = String::new();
    if runs.iter().any(|run| run.draw.is_some()) {
        text += "| slip, mm/s | draws | noticed | delay, ms: median | 95 % | bound for 95 %, ms: \
                 median | from the first motion, ms: 95 % | within 20 ms | by the best test | \
                 draws that it notices with 95 % | of these within 20 ms | velocity error, mm/s: \
                 median | false alarms |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";
    }
    for speed in speeds {
        let of = sliding(runs, *speed);
        if of.is_empty() {
            continue;
        }
        let noticed = of.iter().filter(|run| run.findings.delay_s.is_some()).count();
        let bounds = of.iter().filter_map(|run| bound_s(run)).collect();
        let best: f64 = of.iter().filter_map(|run| best_share(run)).sum();
        let is_possible =
            |run: &&&SlipRun| best_share(run).is_some_and(|best| best >= DETECTED_SHARE_MIN);
        let possible: Vec<&SlipRun> = of.iter().filter(is_possible).copied().collect();
        let first = of.iter().map(|run| run.findings.delay_s.unwrap_or(f64::INFINITY)).collect();
        let errors = of.iter().filter_map(|run| run.findings.velocity_error_mm_s.map(f64::abs));
        let errors = errors.collect();
        let alarms: u32 = of.iter().map(|run| run.findings.false_alarms).sum();
        let _ = writeln!(
            text,
            "| {} | {} | {noticed} | {} | {} | {} | {} | {:.1} % | {:.1} % | {} | {} | {} | \
             {alarms} |",
            format_number(*speed),
            of.len(),
            ms(quantile(delays(&of), 0.5)),
            ms(quantile(delays(&of), 0.95)),
            ms(quantile(bounds, 0.5)),
            ms(quantile(first, 0.95)),
            100.0 * share_within(&of, DELAY_MAX_S),
            100.0 * best / of.len() as f64,
            possible.len(),
            match possible.is_empty() {
                true => "-".to_owned(),
                false => format!("{:.1} %", 100.0 * share_within(&possible, DELAY_MAX_S)),
            },
            quantile(errors, 0.5).map_or("-".to_owned(), format_number),
        );
    }
    let rolling: Vec<&SlipRun> = runs.iter().filter(|run| run.draw.is_none()).collect();
    if !rolling.is_empty() {
        let (alarms, hours) = rolling_alarms(&rolling);
        let largest = rolling.iter().map(|run| run.findings.largest_ratio).fold(0.0, f64::max);
        let _ = write!(
            text,
            "\n| rolling, h | false alarms | largest statistic over the threshold |\n\
             |---|---|---|\n| {} | {alarms} | {} |\n",
            format_number(hours),
            format_number(largest)
        );
    }
    text
}

/// False alarms of rolling, and for how long the test was ready (h).
fn rolling_alarms(rolling: &[&SlipRun]) -> (u32, f64) {
    let alarms = rolling.iter().map(|run| run.findings.false_alarms).sum();
    let ready_s: f64 = rolling.iter().map(|run| run.findings.ready_s).sum();
    (alarms, ready_s / 3600.0)
}

/// What falls short of the requirement.
pub(super) fn shortfalls(runs: &[SlipRun]) -> Vec<String> {
    let mut lacks = Vec::new();
    let required = sliding(runs, REQUIRED_SPEED_MM_S);
    let share = share_within(&required, DELAY_MAX_S);
    if !required.is_empty() && share < DETECTED_SHARE_MIN {
        lacks.push(format!(
            "{:.0} % of the slips at {REQUIRED_SPEED_MM_S} mm/s were noticed within {} ms",
            100.0 * share,
            1e3 * DELAY_MAX_S
        ));
    }
    let rolling: Vec<&SlipRun> = runs.iter().filter(|run| run.draw.is_none()).collect();
    let (alarms, hours) = rolling_alarms(&rolling);
    if f64::from(alarms) > (FALSE_ALARMS_PER_H * hours).max(1.0) {
        lacks.push(format!("{alarms} false alarms in {} h of rolling", format_number(hours)));
    }
    let faults = runs.iter().filter(|run| run.findings.faults > 0).count();
    if faults > 0 {
        lacks.push(format!("{faults} runs ended with a fault"));
    }
    lacks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_take_the_later_of_two_and_put_what_never_comes_last() {
        let all = vec![3.0, f64::INFINITY, 1.0, 2.0];
        assert_eq!(quantile(all.clone(), 0.5), Some(3.0));
        assert_eq!(quantile(all, 0.95), Some(f64::INFINITY));
        assert_eq!(quantile(Vec::new(), 0.5), None);
        assert_eq!((ms(Some(f64::INFINITY)), ms(Some(0.0125))), ("never".into(), "12.5".into()));
    }
}
