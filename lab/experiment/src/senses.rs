//! `taktil experiment senses`: which sense a task needs. Four tasks, each rolled by touch alone, by
//! the wrist's force/torque sensor alone, and by both, over the same seeds; a law can do a task
//! when it keeps the bounds of [`held`](super::held) with every seed. The thesis names this
//! comparison as future work (section 7.3.2): tasks for touch alone, for force control alone, for
//! either and for both.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use taktil_lab_scene::scene::Scene;
use taktil_lab_scene::targets;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_tasks_tactile_servo::config::law_name::LawName;

use super::comparison::{LEGEND, SeedValues, difference_cell, markdown, median_cell};
use super::evaluation::Evaluation;
use super::held::{holds, scene_files};
use super::run_table::{RunRow, RunTable};
use super::{SEEDS_MAX, evaluated_run, run_parallel, with_law};

/// The laws in the order of the tables: touch alone, force alone, both. Differences are taken to
/// the last one.
pub const LAWS: [LawName; 3] = [LawName::Model, LawName::HybridForce, LawName::HybridForceTouch];
/// What the laws feel by, in the same order.
const SENSES: [&str; 3] = ["touch alone", "force alone", "both"];

/// Options of `taktil experiment senses`.
#[derive(Args, Debug)]
pub struct SensesOptions {
    /// Tasks: scenes, or folders of them
    #[arg(default_value = "sim/scenes/senses", value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Seeds 1 to N
    #[arg(long, default_value_t = 20, value_name = "N")]
    seeds: u64,
    /// Folder for senses.md and runs.csv
    #[arg(long, default_value = "senses", value_name = "DIR")]
    out: PathBuf,
    /// Threads; one a processor when absent
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// What a task turned out to need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needed {
    /// Touch alone can do it, and so can force alone.
    Either,
    /// Touch alone can do it, force alone cannot.
    Touch,
    /// Force alone can do it, touch alone cannot.
    Force,
    /// Neither can do it alone, both together can.
    Both,
    /// No law can do it.
    More,
}

impl Needed {
    /// What a task needs that these laws can do, in the order of [`LAWS`].
    #[must_use]
    pub fn from_able([touch, force, both]: [bool; 3]) -> Needed {
        match (touch, force) {
            (true, true) => Needed::Either,
            (true, false) => Needed::Touch,
            (false, true) => Needed::Force,
            (false, false) if both => Needed::Both,
            (false, false) => Needed::More,
        }
    }

    /// In words.
    #[must_use]
    pub fn text(self) -> &'static str {
        match self {
            Needed::Either => "either sense can do it",
            Needed::Touch => "touch can do it, force cannot",
            Needed::Force => "force can do it, touch cannot",
            Needed::Both => "neither can do it alone, both together can",
            Needed::More => "no law here can do it",
        }
    }
}

/// All runs of a task.
pub struct TaskRuns {
    /// Scene file.
    pub path: PathBuf,
    /// Title of the scene.
    pub title: String,
    /// Load that is to be held (N).
    pub set_point_n: f64,
    /// Runs by law in the order of [`LAWS`], then by seed.
    pub runs: [Vec<Evaluation>; 3],
}

impl TaskRuns {
    /// Number of seeds with which each law kept the bounds.
    #[must_use]
    pub fn held(&self) -> [usize; 3] {
        let count =
            |runs: &Vec<Evaluation>| runs.iter().filter(|run| holds(run, self.set_point_n)).count();
        [0, 1, 2].map(|law| count(&self.runs[law]))
    }

    /// What the task needs, judged by the law's worst seed.
    #[must_use]
    pub fn needed(&self) -> Needed {
        let held = self.held();
        Needed::from_able([0, 1, 2].map(|law| held[law] == self.runs[law].len()))
    }
}

/// Runs tasks over seeds 1 to `seeds`; `told` hears of each run. `None` when it was interrupted.
///
/// # Errors
/// A scene that cannot be read or assembled, and what `told` returns.
pub fn run_tasks(
    paths: &[PathBuf],
    seeds: u64,
    threads: Option<NonZeroUsize>,
    told: impl Fn(&RunOf<'_>) -> anyhow::Result<()> + Sync,
) -> anyhow::Result<Option<Vec<TaskRuns>>> {
    let scenes: Vec<Scene> =
        paths.iter().map(|path| Scene::load(path)).collect::<Result<_, _>>()?;
    let mut plan = Vec::new();
    for task in 0..scenes.len() {
        for law in LAWS {
            plan.extend((1..=seeds).map(|seed| (task, law, seed)));
        }
    }
    let done = run_parallel(threads, &plan, |(task, law, seed)| {
        let verdict = evaluated_run(&with_law(&scenes[*task], *law), *seed, false)?;
        told(&RunOf { path: &paths[*task], law: *law, seed: *seed, verdict: &verdict })?;
        Ok(verdict)
    })?;
    let Some(done) = done.into_iter().collect::<Option<Vec<Evaluation>>>() else {
        return Ok(None);
    };
    let mut done = done.into_iter();
    let mut next = || done.by_ref().take(seeds as usize).collect();
    let tasks = paths.iter().zip(&scenes).map(|(path, scene)| {
        let targets = targets(scene);
        TaskRuns {
            path: path.clone(),
            title: scene.title.clone(),
            set_point_n: targets.m0 / targets.counts_per_n,
            runs: [next(), next(), next()],
        }
    });
    Ok(Some(tasks.collect()))
}

/// A run that is done.
pub struct RunOf<'a> {
    path: &'a Path,
    law: LawName,
    seed: u64,
    verdict: &'a Evaluation,
}

/// What it takes, for the head of the page.
const BOUNDS: &str = "A law can do a task when every seed keeps the bounds: no contact lost, force \
    within 10 % rms, yaw within 2 deg, tilt within 1 deg.";

/// A column of the tables.
struct Column {
    what: &'static str,
    of: fn(&Evaluation) -> Option<f64>,
}

const COLUMNS: [Column; 4] = [
    Column { what: "force error rms (N)", of: |v| v.force_n.rms() },
    Column { what: "yaw rms (deg)", of: |v| v.yaw_deg.rms() },
    Column { what: "yaw peak (deg)", of: |v| v.yaw_deg.peak() },
    Column { what: "tilt peak (deg)", of: |v| v.tilt_deg.peak() },
];

/// The page in Markdown.
#[must_use]
pub fn page(tasks: &[TaskRuns], command: &str) -> String {
    let mut out = format!("# Which sense a task needs\n\n`{command}`\n\n{BOUNDS} {LEGEND}\n");
    let head = ["task", "touch alone", "force alone", "both", "verdict"].map(str::to_owned);
    let row = |task: &TaskRuns| {
        let held = task.held();
        let share = |law: usize| format!("{} of {}", held[law], task.runs[law].len());
        let verdict = task.needed().text().to_owned();
        vec![task.title.clone(), share(0), share(1), share(2), verdict]
    };
    let rows: Vec<Vec<String>> = tasks.iter().map(row).collect();
    out += &format!("\nSeeds that hold:\n\n{}", markdown(&head, &rows));
    tasks.iter().for_each(|task| out += &task_section(task));
    out
}

fn task_section(task: &TaskRuns) -> String {
    let mut head = vec!["sense (law)".to_owned()];
    head.extend(COLUMNS.iter().map(|column| format!("{}: median (least .. most)", column.what)));
    head.extend(
        COLUMNS[..2].iter().map(|column| format!("{} less both: mean [95 %]", column.what)),
    );
    let values = |law: usize, column: &Column| -> SeedValues {
        task.runs[law].iter().map(column.of).collect()
    };
    let row = |law: usize| {
        let mut row = vec![format!("{} (`{}`)", SENSES[law], LAWS[law].text())];
        row.extend(COLUMNS.iter().map(|column| median_cell(&values(law, column))));
        let difference = |column: &Column| match law {
            2 => String::new(),
            _ => difference_cell(&values(2, column), &values(law, column)),
        };
        row.extend(COLUMNS[..2].iter().map(difference));
        row
    };
    let rows: Vec<Vec<String>> = (0..LAWS.len()).map(row).collect();
    let (title, shown) = (&task.title, task.path.display());
    format!("\n## {title}\n\n`{shown}`\n\n{}", markdown(&head, &rows))
}

/// Runs the tasks and writes the page.
///
/// # Errors
/// Invalid input as [`BadOption`], a located error of a scene, a file that cannot be written.
pub fn run(options: &SensesOptions) -> anyhow::Result<ExitCode> {
    if options.seeds == 0 || options.seeds > SEEDS_MAX {
        let text = format!("--seeds {}: give 1 to {SEEDS_MAX}", options.seeds);
        return Err(BadOption(text).into());
    }
    let paths = scene_files(&options.scenes)?;
    taktil_machine_console::option::create_folder("--out", &options.out)?;
    let table = RunTable::create(&options.out.join("runs.csv"))?;
    let tasks = run_tasks(&paths, options.seeds, options.threads, |run| {
        let name = run.path.display().to_string();
        table.append(&RunRow::new(&name, run.law.text(), run.seed, run.verdict))
    })?;
    let Some(tasks) = tasks else {
        out::warn("interrupted: the runs that were done stand in runs.csv");
        return Ok(ExitCode::from(1));
    };
    let scenes: Vec<String> = options.scenes.iter().map(|s| s.display().to_string()).collect();
    let command =
        format!("taktil experiment senses {} --seeds {}", scenes.join(" "), options.seeds);
    let path = options.out.join("senses.md");
    std::fs::write(&path, page(&tasks, &command))
        .with_context(|| format!("cannot write {}", path.display()))?;
    out::line(path.display())?;
    for task in &tasks {
        out::line(format_args!("{}: {}", task.title, task.needed().text()))?;
    }
    let able = tasks.iter().all(|task| task.needed() != Needed::More);
    Ok(if able { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
