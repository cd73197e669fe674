//! Chapter 6 as it was measured: the scenes whose titles begin with "E1 in 1994" to "E9 in 1994",
//! rolled by the thesis's law, against every number that the thesis prints. Writes a table with a
//! verdict a line, and the thesis's figures with its curves in one plot.

pub mod figures;
pub mod frames;
pub mod rows;
pub mod series;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use taktil_lab_plot::axis::format_fixed;
use taktil_lab_plot::svg::Figure;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_rtcore::virtual_time;
use taktil_tasks_tactile_servo::config::law_name::LawName;

use super::chapter6::EXPERIMENTS;
use super::comparison::markdown;
use super::statistics::median;
use super::{run_parallel, with_law};
use rows::{Measured, ROWS, Stated, ThesisRow};
use series::{Sampler, Series};

/// A scene of chapter 6 as it was measured.
pub struct MeasuredScene {
    /// E1 to E9.
    pub id: &'static str,
    /// The scene, with the thesis's law.
    pub scene: Scene,
}

/// The runs of one experiment, by seed.
pub struct MeasuredRuns {
    /// E1 to E9.
    pub id: &'static str,
    /// Title of the scene.
    pub title: String,
    /// A run for each seed from 1 on.
    pub runs: Vec<Series>,
}

/// The scenes among these whose titles say that they are of 1994, in the order of the thesis.
#[must_use]
pub fn measured_scenes(loaded: &[(PathBuf, Scene)]) -> Vec<MeasuredScene> {
    let of = |id: &'static str| {
        let head = format!("{id} in 1994:");
        let (_, scene) = loaded.iter().find(|(_, scene)| scene.title.starts_with(&head))?;
        Some(MeasuredScene { id, scene: with_law(scene, LawName::Thesis) })
    };
    EXPERIMENTS.iter().filter_map(|experiment| of(experiment.id)).collect()
}

/// Samples one run in virtual time.
///
/// # Errors
/// A scene that cannot be assembled, or a task that does not start.
pub fn sampled_run(scene: &Scene, seed: u64) -> anyhow::Result<Series> {
    let mut machine = Assembly::new(scene).with_seed(seed).build()?;
    let catalog = machine.catalog().clone();
    let mut sampler = Sampler::new(&catalog);
    let stop = AtomicBool::new(false);
    virtual_time::run(&mut machine, scene.duration, &stop, &mut sampler)
        .map_err(|(task, fault)| anyhow::anyhow!("task `{task}`: {}", fault.text()))?;
    Ok(sampler.series())
}

/// Runs the scenes over seeds 1 to `seeds`; `None` when it was interrupted.
///
/// # Errors
/// What [`sampled_run`] returns.
pub fn run_scenes(
    scenes: &[MeasuredScene],
    seeds: u64,
    threads: Option<NonZeroUsize>,
) -> anyhow::Result<Option<Vec<MeasuredRuns>>> {
    let plan: Vec<(usize, u64)> =
        (0..scenes.len()).flat_map(|i| (1..=seeds).map(move |seed| (i, seed))).collect();
    let done = run_parallel(threads, &plan, |(i, seed)| sampled_run(&scenes[*i].scene, *seed))?;
    let Some(done) = done.into_iter().collect::<Option<Vec<Series>>>() else { return Ok(None) };
    let mut done = done.into_iter();
    let of = |scene: &MeasuredScene| MeasuredRuns {
        id: scene.id,
        title: scene.scene.title.clone(),
        runs: done.by_ref().take(seeds as usize).collect(),
    };
    Ok(Some(scenes.iter().map(of).collect()))
}

/// A line with what the runs show.
pub struct Line {
    /// What is compared.
    pub row: &'static ThesisRow,
    /// The quantity with each seed, in their order.
    pub values: Vec<Option<f64>>,
}

impl Line {
    /// The median over the seeds; `None` when a seed has no value.
    #[must_use]
    pub fn ours(&self) -> Option<f64> {
        let values: Vec<f64> = self.values.iter().copied().collect::<Option<_>>()?;
        median(&values)
    }

    /// Whether the thesis's number, or its direction with every seed, is met.
    #[must_use]
    pub fn is_as_the_thesis(&self) -> bool {
        match self.row.stated {
            Stated::Number { value, within } => {
                self.ours().is_some_and(|ours| (ours - value).abs() <= within)
            }
            Stated::Positive(_) => {
                !self.values.is_empty() && self.values.iter().all(|v| v.is_some_and(|v| v > 0.0))
            }
        }
    }

    /// The verdict in words.
    #[must_use]
    pub fn verdict(&self) -> String {
        match (self.is_as_the_thesis(), self.row.why) {
            (true, _) => "as the thesis".to_owned(),
            (false, "") => "differs: not explained".to_owned(),
            (false, why) => format!("differs: {why}"),
        }
    }

    fn cells(&self) -> Vec<String> {
        let row = self.row;
        let decimals = match row.stated {
            Stated::Number { within, .. } if within < 1.0 => 2.0,
            Stated::Number { within, .. } if within < 100.0 => 1.0,
            _ => 0.0,
        };
        let text = |value: f64| format_fixed(value, decimals);
        let found = || self.values.iter().flatten().copied();
        let ours = self.ours().map_or("\u{2013}".to_owned(), |middle| {
            let (low, high) = found().fold((middle, middle), |(l, h), v| (l.min(v), h.max(v)));
            if self.values.len() < 2 {
                text(middle)
            } else {
                format!("{} ({} .. {})", text(middle), text(low), text(high))
            }
        });
        let positive = found().filter(|value| *value > 0.0).count();
        let (thesis, difference) = match row.stated {
            Stated::Number { value, within } => {
                let off = self.ours().map_or("\u{2013}".to_owned(), |ours| text(ours - value));
                (text(value), format!("{off} (within {within})"))
            }
            Stated::Positive(words) => {
                (words.to_owned(), format!("{positive} of {} seeds", self.values.len()))
            }
        };
        let head = [row.experiment, row.figure, row.what].map(str::to_owned);
        head.into_iter().chain([thesis, ours, difference, self.verdict()]).collect()
    }
}

/// The lines of the experiments that were run. Without E1 there are none, for it is what several
/// are compared with.
#[must_use]
pub fn lines(all: &[MeasuredRuns]) -> Vec<Line> {
    let of = |id: &str| all.iter().find(|runs| runs.id == id);
    let Some(level) = of("E1") else { return Vec::new() };
    let line = |row: &'static ThesisRow| {
        let runs = of(row.experiment)?;
        let both = runs.runs.iter().zip(&level.runs);
        let values = both.map(|(run, level)| (row.of)(&Measured { run, level })).collect();
        Some(Line { row, values })
    };
    ROWS.iter().filter_map(line).collect()
}

/// The table in Markdown.
#[must_use]
pub fn page(lines: &[Line], seeds: u64, command: &str) -> String {
    let same = lines.iter().filter(|line| line.is_as_the_thesis()).count();
    let head = [
        "",
        "figure",
        "quantity",
        "thesis",
        "ours: median (least .. most)",
        "difference",
        "verdict",
    ]
    .map(str::to_owned);
    let rows: Vec<Vec<String>> = lines.iter().map(Line::cells).collect();
    format!(
        "# Chapter 6 as it was measured\n\n`{command}`\n\nThe scenes of 1994 under the thesis's \
         law, seeds 1 to {seeds}. {same} of {} lines are as the thesis.\n\n{}",
        lines.len(),
        markdown(&head, &rows)
    )
}

/// Writes the table and the figures into a folder; the paths.
///
/// # Errors
/// A file that cannot be written.
pub fn write(
    folder: &Path,
    all: &[MeasuredRuns],
    seeds: u64,
    command: &str,
) -> anyhow::Result<PathBuf> {
    let put = |path: &Path, text: &str| {
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    let table = folder.join("thesis.md");
    put(&table, &page(&lines(all), seeds, command))?;
    let drawn = figures::figures(all);
    let frames = [("frames".to_owned(), frames::picture())];
    for (name, figure) in drawn.iter().chain(&frames) {
        let figure: &Figure = figure;
        put(&folder.join(format!("{name}.svg")), &figure.svg_document())?;
    }
    Ok(table)
}
