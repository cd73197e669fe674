//! `taktil experiment campaign`: any scenes with any laws over many seeds. Interrupted, it goes on
//! where it was; in the end it writes every run and a page that compares the laws.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use serde_json::{Value, json};
use taktil_lab_plot::axis::format_number;
use taktil_lab_scene::scene::Scene;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_tasks_tactile_servo::config::law_name::LawName;

use super::chapter6::MEASURES;
use super::comparison::{self, LEGEND};
use super::held::scene_files;
use super::run_table::{RunRow, RunTable, write_json};
use super::{SEEDS_MAX, evaluated_run, laws_by_name, run_parallel, with_law};

/// The measure by which a seed is the worst one.
const WORST_MEASURE: &str = "force error rms (N)";

/// Options of `taktil experiment campaign`.
#[derive(Args, Debug)]
pub struct CampaignOptions {
    /// Scenes, or folders of them
    #[arg(required = true, value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Laws, separated by commas; the first is what others are compared with
    #[arg(long, value_delimiter = ',', default_value = "thesis,model")]
    law: Vec<String>,
    /// Seeds 1 to N
    #[arg(long, default_value_t = 20, value_name = "N")]
    seeds: u64,
    /// Folder for the tables and the page
    #[arg(long, default_value = "campaign", value_name = "DIR")]
    out: PathBuf,
    /// Threads; one a processor when absent
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// One scene of a campaign.
struct CampaignScene {
    name: String,
    scene: Scene,
}

/// A run that is to be made.
struct PlannedRun {
    scene: usize,
    law: LawName,
    seed: u64,
}

impl CampaignOptions {
    fn scenes(&self) -> anyhow::Result<Vec<CampaignScene>> {
        let load = |path: PathBuf| -> anyhow::Result<CampaignScene> {
            let scene = Scene::load(&path)?;
            Ok(CampaignScene { name: path.display().to_string(), scene })
        };
        scene_files(&self.scenes)?.into_iter().map(load).collect()
    }

    /// What makes two campaigns the same, everything that their runs are made of: a folder with
    /// another one is not gone on with.
    fn identity(&self, scenes: &[CampaignScene]) -> Value {
        let about = |planned: &CampaignScene| {
            let scene = &planned.scene;
            let files: Vec<_> = scene.recorded().collect();
            json!({
                "scene": planned.name, "text": scene.source.text,
                "machine": scene.machine_text(), "files": files,
            })
        };
        let scenes: Vec<Value> = scenes.iter().map(about).collect();
        let version = env!("CARGO_PKG_VERSION");
        json!({ "taktil": version, "laws": self.law, "seeds": self.seeds, "scenes": scenes })
    }

    fn command(&self) -> String {
        let scenes: Vec<String> = self.scenes.iter().map(|s| s.display().to_string()).collect();
        let (scenes, law) = (scenes.join(" "), self.law.join(","));
        format!("taktil experiment campaign {scenes} --law {law} --seeds {}", self.seeds)
    }
}

/// Begins the table of runs, or goes on with that of an interrupted campaign; its rows.
fn table(folder: &Path, identity: &Value) -> anyhow::Result<(RunTable, Vec<RunRow>)> {
    let (plan, rows) = (folder.join("plan.json"), folder.join("partial.csv"));
    if rows.exists() {
        let before = std::fs::read_to_string(&plan).unwrap_or_default();
        if serde_json::from_str::<Value>(&before).ok().as_ref() == Some(identity) {
            return RunTable::resume(&rows);
        }
        let shown = rows.display();
        return Err(BadOption(format!(
            "--out {}: {shown} is of another campaign that was interrupted; give its options to go \
             on with it, remove it, or name another folder",
            folder.display()
        ))
        .into());
    }
    let text = serde_json::to_string_pretty(identity)?;
    std::fs::write(&plan, text).with_context(|| format!("cannot write {}", plan.display()))?;
    Ok((RunTable::create(&rows)?, Vec::new()))
}

/// Runs what is left of the campaign and writes its tables and its page.
///
/// # Errors
/// Invalid input as [`BadOption`], a located error of a scene, a file that cannot be written.
pub fn run(options: &CampaignOptions) -> anyhow::Result<ExitCode> {
    let laws = laws_by_name(&options.law)?;
    if options.seeds == 0 || options.seeds > SEEDS_MAX {
        let text = format!("--seeds {}: give 1 to {SEEDS_MAX}", options.seeds);
        return Err(BadOption(text).into());
    }
    let scenes = options.scenes()?;
    taktil_machine_console::option::create_folder("--out", &options.out)?;
    let identity = options.identity(&scenes);
    let (table, mut rows) = table(&options.out, &identity)?;
    let is_done = |run: &PlannedRun| {
        let of = |row: &RunRow| {
            (&*row.scene, &*row.law, row.seed)
                == (&*scenes[run.scene].name, run.law.text(), run.seed)
        };
        rows.iter().any(of)
    };
    let all = (0..scenes.len()).flat_map(|scene| {
        let laws = laws.iter();
        laws.flat_map(move |law| {
            (1..=options.seeds).map(move |seed| PlannedRun { scene, law: *law, seed })
        })
    });
    let (done, left): (Vec<PlannedRun>, Vec<PlannedRun>) = all.partition(is_done);
    let planned = done.len() + left.len();
    if !done.is_empty() {
        out::warn(format_args!("{} of {planned} runs were done before", done.len()));
    }
    let made = run_parallel(options.threads, &left, |run| {
        let scene = &scenes[run.scene];
        let verdict = evaluated_run(&with_law(&scene.scene, run.law), run.seed, false)?;
        let row = RunRow::new(&scene.name, run.law.text(), run.seed, &verdict);
        table.append(&row)?;
        Ok(row)
    })?;
    rows.extend(made.into_iter().flatten());
    if rows.len() < planned {
        out::warn(format_args!(
            "interrupted: {} of {planned} runs were done; the same command goes on",
            rows.len()
        ));
        return Ok(ExitCode::from(1));
    }
    finish(options, &identity, &scenes, &laws, rows)
}

/// Writes runs.csv, runs.json and campaign.md.
fn finish(
    options: &CampaignOptions,
    identity: &Value,
    scenes: &[CampaignScene],
    laws: &[LawName],
    mut rows: Vec<RunRow>,
) -> anyhow::Result<ExitCode> {
    // Threads end in any order; the table is in that of scene, law and seed.
    let place = |row: &RunRow| {
        let scene = scenes.iter().position(|scene| scene.name == row.scene);
        let law = laws.iter().position(|law| law.text() == row.law);
        (scene, law, row.seed)
    };
    rows.sort_by_key(place);
    let folder = &options.out;
    let [csv, json, page] = ["runs.csv", "runs.json", "campaign.md"].map(|name| folder.join(name));
    let sorted = RunTable::create(&csv)?;
    for row in &rows {
        sorted.append(row)?;
    }
    write_json(&json, identity.clone(), &rows)?;
    let text = markdown_page(&options.command(), scenes, laws, &rows);
    std::fs::write(&page, text).with_context(|| format!("cannot write {}", page.display()))?;
    for name in ["partial.csv", "plan.json"] {
        let path = folder.join(name);
        std::fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
    }
    for path in [&page, &csv, &json] {
        out::line(path.display())?;
    }
    let faults = MEASURES.iter().position(|measure| measure.what == "faults").unwrap_or(0);
    let bad = rows.iter().filter(|row| row.values[faults].is_some_and(|n| n > 0.0)).count();
    if bad > 0 {
        out::warn(format_args!("{bad} runs ended with a fault; see the tables"));
        return Ok(ExitCode::from(1));
    }
    Ok(ExitCode::SUCCESS)
}

fn markdown_page(
    command: &str,
    scenes: &[CampaignScene],
    laws: &[LawName],
    rows: &[RunRow],
) -> String {
    let names: Vec<&str> = laws.iter().map(|law| law.text()).collect();
    let mut out = format!("# Laws side by side\n\n`{command}`\n\n{LEGEND}\n");
    for scene in scenes {
        out += &format!("\n## {}\n\n`{}`\n\n", scene.scene.title, scene.name);
        let of_law = |law: &&str| {
            let runs = rows.iter().filter(|row| row.scene == scene.name && row.law == **law);
            let runs: Vec<&RunRow> = runs.collect();
            let measure = |m: usize| runs.iter().map(|row| row.values[m]).collect();
            (0..MEASURES.len()).map(measure).collect::<Vec<_>>()
        };
        let values: Vec<_> = names.iter().map(of_law).collect();
        let head = comparison::heading(&names);
        out += &comparison::markdown(&head, &comparison::rows(&values));
        out.push('\n');
        for law in &names {
            if let Some(text) = worst_seed(scene, law, rows) {
                out += &text;
            }
        }
    }
    out
}

/// The worst seed of a law, with the command that repeats it.
fn worst_seed(scene: &CampaignScene, law: &str, rows: &[RunRow]) -> Option<String> {
    let measure = MEASURES.iter().position(|measure| measure.what == WORST_MEASURE)?;
    let runs = rows.iter().filter(|row| row.scene == scene.name && row.law == law);
    let measured = runs.filter_map(|row| Some((row.seed, row.values[measure]?)));
    let (seed, value) = measured.max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(format!(
        "Worst seed of `{law}` by {WORST_MEASURE}: {seed}, {}: `taktil experiment held {} --law \
         {law} --seed {seed}`\n\n",
        format_number(value),
        scene.name
    ))
}
