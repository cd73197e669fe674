//! `taktil experiment held`: checks any scenes, not only those of the thesis, against the bounds
//! that a touch law has to keep without being tuned for them. Each scene is judged by its worst
//! seed, so that no failure is averaged away.

use std::fmt::Write as _;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use taktil_machine_console::out;

use super::evaluation::{Evaluation, TRACE_COLUMNS, Trace};
use super::run_table::{RunRow, RunTable};
use super::{SEEDS_MAX, evaluated_run, laws_by_name, run_parallel, with_law};
use taktil_lab_plot::axis::format_number;
use taktil_lab_scene::scene::Scene;
use taktil_lab_scene::targets;
use taktil_machine_console::option::BadOption;

/// Largest root mean square of the force error, as a fraction of the set point.
const FORCE_ERROR_SHARE_MAX: f64 = 0.1;
/// Largest yaw of the pin on the sensor.
const YAW_ERROR_MAX_DEG: f64 = 2.0;
/// Largest tilt of the finger against the pin.
const TILT_ERROR_MAX_DEG: f64 = 1.0;

/// Options of `taktil experiment held`.
#[derive(Args, Debug)]
pub struct HeldOptions {
    /// Scenes, or folders of them
    #[arg(required = true, value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Machine file in the place of those that the scenes name: another arm
    #[arg(long, value_name = "MACHINE")]
    arm: Option<PathBuf>,
    /// The law
    #[arg(long, default_value = "model")]
    law: String,
    /// Seeds 1 to N
    #[arg(long, default_value_t = 1, value_name = "N")]
    seeds: u64,
    /// Only this seed
    #[arg(long, value_name = "K")]
    seed: Option<u64>,
    /// Samples of the first run, as a table with commas
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Every run as a table with commas
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Threads; one a processor when absent
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// The worst value of each figure over the seeds of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct WorstSeed {
    faults: u32,
    losses: u32,
    force_share: f64,
    yaw_deg: f64,
    yaw_rms_deg: f64,
    tilt_deg: f64,
    slip_mm_s: f64,
    strokes: u32,
}

impl WorstSeed {
    fn from_evaluations(verdicts: &[&Evaluation], set_point_n: f64) -> WorstSeed {
        let most = |of: &dyn Fn(&Evaluation) -> Option<f64>| {
            verdicts.iter().map(|v| of(v).unwrap_or(f64::INFINITY)).fold(0.0, f64::max)
        };
        WorstSeed {
            faults: verdicts.iter().filter(|v| !v.figures.faults.is_empty()).count() as u32,
            losses: verdicts.iter().map(|v| v.figures.contact_lost).sum(),
            force_share: most(&|v| v.force_n.rms()) / set_point_n,
            yaw_deg: most(&|v| v.yaw_deg.peak()),
            yaw_rms_deg: most(&|v| v.yaw_deg.rms()),
            tilt_deg: most(&|v| v.tilt_deg.peak()),
            slip_mm_s: most(&|v| v.figures.slip_mm_s),
            strokes: verdicts.iter().map(|v| v.figures.strokes).min().unwrap_or(0),
        }
    }

    fn is_within_bounds(&self) -> bool {
        self.faults == 0
            && self.losses == 0
            && self.force_share <= FORCE_ERROR_SHARE_MAX
            && self.yaw_deg <= YAW_ERROR_MAX_DEG
            && self.tilt_deg <= TILT_ERROR_MAX_DEG
    }
}

/// Whether one run is within the bounds.
pub(crate) fn holds(verdict: &Evaluation, set_point_n: f64) -> bool {
    WorstSeed::from_evaluations(&[verdict], set_point_n).is_within_bounds()
}

/// The named scene files, in order.
pub(super) fn scene_files(named: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut out = Vec::new();
    for path in named {
        if !path.is_dir() {
            out.push(path.clone());
            continue;
        }
        let entries = std::fs::read_dir(path)
            .map_err(|error| BadOption(format!("{}: {error}", path.display())))?;
        let mut inside: Vec<PathBuf> = entries
            .filter_map(|entry| entry.ok().map(|entry| entry.path()))
            .filter(|path| path.extension().is_some_and(|ending| ending == "toml"))
            .collect();
        inside.sort();
        out.append(&mut inside);
    }
    if out.is_empty() {
        return Err(BadOption("no scene in what was named".to_owned()).into());
    }
    Ok(out)
}

fn trace_csv(trace: &Trace) -> String {
    let mut out = format!("t_s,{}\n", TRACE_COLUMNS.join(","));
    for (index, t_s) in trace.t_s.iter().enumerate() {
        let _ = write!(out, "{t_s}");
        for column in &trace.columns {
            let _ = write!(out, ",{}", column[index]);
        }
        out.push('\n');
    }
    out
}

/// Writes the samples of a run, if it came to its end.
fn write_trace(path: &Path, run: Option<&Evaluation>) -> anyhow::Result<()> {
    let shown = path.display();
    let Some(run) = run else {
        out::warn(format_args!("{shown}: not written, its run was interrupted"));
        return Ok(());
    };
    std::fs::write(path, trace_csv(&run.trace)).with_context(|| format!("cannot write {shown}"))
}

fn scene_name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Runs the scenes and prints the result.
///
/// # Errors
/// Invalid input as [`BadOption`], or a located error of a scene.
pub fn run(options: &HeldOptions) -> anyhow::Result<ExitCode> {
    let law = laws_by_name(std::slice::from_ref(&options.law))?[0];
    if options.seeds == 0 || options.seeds > SEEDS_MAX {
        let text = format!("--seeds {}: give 1 to {SEEDS_MAX}", options.seeds);
        return Err(BadOption(text).into());
    }
    let seeds = options.seed.map_or(1..=options.seeds, |seed| seed..=seed);
    let mut scenes = Vec::new();
    for path in scene_files(&options.scenes)? {
        let scene = match &options.arm {
            Some(machine) => Scene::load_with_machine(&path, machine)?,
            None => Scene::load(&path)?,
        };
        let scene = with_law(&scene, law);
        scenes.push((path, scene));
    }
    let traced = options.trace.is_some();
    let plan: Vec<(usize, u64)> =
        (0..scenes.len()).flat_map(|i| seeds.clone().map(move |seed| (i, seed))).collect();
    let table = options.csv.as_deref().map(RunTable::create).transpose()?;
    let verdicts = run_parallel(options.threads, &plan, |(i, seed)| {
        let (path, scene) = &scenes[*i];
        let verdict = evaluated_run(scene, *seed, traced && *i == 0)?;
        if let Some(table) = &table {
            let name = path.display().to_string();
            table.append(&RunRow::new(&name, law.text(), *seed, &verdict))?;
        }
        Ok(verdict)
    })?;
    if let Some(path) = &options.trace {
        write_trace(path, verdicts.first().and_then(Option::as_ref))?;
    }
    let each = plan.len() / scenes.len();
    out::line(format_args!(
        "| scene | holds | force rms / set point | yaw peak (rms), deg | tilt peak, deg | slip, \
         mm/s | contact losses | faults | strokes |\n|{}",
        "---|".repeat(9)
    ))?;
    let (mut failed, mut whole) = (0, 0);
    for ((path, scene), verdicts) in scenes.iter().zip(verdicts.chunks(each.max(1))) {
        // A scene with a missing seed has no worst seed.
        let Some(verdicts) = verdicts.iter().map(Option::as_ref).collect::<Option<Vec<_>>>() else {
            continue;
        };
        whole += 1;
        let targets = targets(scene);
        let worst = WorstSeed::from_evaluations(&verdicts, targets.m0 / targets.counts_per_n);
        failed += u32::from(!worst.is_within_bounds());
        out::line(format_args!(
            "| {} | {} | {} | {} ({}) | {} | {} | {} | {} | {} |",
            scene_name(path),
            if worst.is_within_bounds() { "yes" } else { "no" },
            format_number(worst.force_share),
            format_number(worst.yaw_deg),
            format_number(worst.yaw_rms_deg),
            format_number(worst.tilt_deg),
            format_number(worst.slip_mm_s),
            worst.losses,
            worst.faults,
            worst.strokes
        ))?;
    }
    let law = law.text();
    out::line(format_args!("\n{whole} scenes with `{law}`: {failed} did not hold"))?;
    let left = scenes.len() - whole;
    if left > 0 {
        out::warn(format_args!("interrupted: {left} scenes were not tried with every seed"));
    }
    Ok(if failed == 0 && left == 0 { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
