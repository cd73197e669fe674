//! `taktil experiment`: runs the experiments of the thesis over laws and seeds in virtual time, and
//! writes a page that sets them side by side. Every requested run is in the tables, faults and lost
//! contacts included.

pub mod campaign;
pub mod chapter6;
mod comparison;
pub mod evaluation;
mod free_fall;
pub mod hand;
pub mod held;

pub mod levels;
mod page;
pub mod robust;
mod run_table;
pub mod senses;
pub mod servo;
pub mod sim;
pub mod slip;
pub mod statistics;
pub mod thesis;
pub mod touch;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;

use anyhow::Context;
use clap::{Args, Subcommand};
use taktil_machine_console::out;
use taktil_machine_console::signals::{self, SecondSignal};
use taktil_rtcore::virtual_time;
/// The touch laws.
pub use taktil_tasks_tactile_servo::config::law_name::LawName;

use chapter6::{EXPERIMENTS, Experiment};
use evaluation::{Evaluation, Evaluator};
use run_table::{RunRow, RunTable};
use taktil_lab_progress::Progress;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_machine_console::option::BadOption;

/// Largest number of seeds in one call.
const SEEDS_MAX: u64 = 1_000;

/// The experiments of the command line.
#[derive(Subcommand, Debug)]
pub enum Experiments {
    /// Chapter 6 of the thesis, E1 to E9: laws side by side on the same seeds.
    ///
    /// Runs every scene of the folder whose title begins with E1 to E9, for each law and seed, and
    /// writes report.html and report.md with figures and tables, and runs.csv with a row a run.
    /// Scenes whose titles begin with "E1 in 1994" to "E9 in 1994" are run under the thesis's law
    /// and compared with what it prints, in thesis.md, with its figures as fig-6-9-to-6-12.svg to
    /// fig-6-27.svg and its frames as frames.svg.
    /// Until it is done the rows stand in partial.csv, each as soon as its run is done; Ctrl-C ends
    /// it with partial.html and partial.md, and a report of before stays. Exit code 0: done; 1: a
    /// run ended with a fault, an experiment has no scene, or it was interrupted; 2: bad input.
    Chapter6(Chapter6Options),
    /// The rolling scene with drawn pins, rubbers, frictions and tables: does a law hold?
    ///
    /// Exit code 0: every draw held; 1: at least one did not, and is listed; 2: bad input.
    Robust(robust::RobustOptions),
    /// Any scenes with any laws over many seeds; goes on where it was interrupted.
    ///
    /// Writes campaign.md with medians, differences seed by seed and their intervals, runs.csv and
    /// runs.json with every run. Ctrl-C ends it; the same command goes on. Exit code 0: done; 1: a
    /// run ended with a fault, or it was interrupted; 2: bad input.
    Campaign(campaign::CampaignOptions),
    /// Which sense a task needs: touch alone, force alone, either or both.
    ///
    /// Runs each task by touch, by the wrist and by both over the same seeds, and writes senses.md
    /// and runs.csv. Exit code 0: done; 1: a task that no law can do, or it was interrupted; 2: bad
    /// input.
    Senses(senses::SensesOptions),
    /// Any scenes against the bounds of held inputs: contact, force, yaw and tilt.
    ///
    /// Exit code 0: every scene held; 1: one did not; 2: bad input.
    Held(held::HeldOptions),
    /// Bodies that slide over the pad at drawn speeds, and a pin that rolls: when is slip noticed?
    ///
    /// Writes slip.md with the delays beside the bound that noise and frame time set, slip.csv and
    /// slip.json with every run. Exit code 0: slip at 20 mm/s was noticed within 20 ms in 95 % of
    /// the draws, with one false alarm an hour of rolling at most; 1: not so, or interrupted; 2:
    /// bad input.
    Slip(slip::SlipOptions),
    /// Drawn objects in a hand of three fingers under drawn pushes: held within the friction cones,
    /// and told beyond them?
    ///
    /// Exit code 0: every object was held and every push beyond told of; 1: not; 2: bad input.
    Hand(hand::HandOptions),
}

/// Options of `taktil experiment chapter6`.
#[derive(Args, Debug)]
pub struct Chapter6Options {
    /// Laws: thesis, projector-pid, model, hybrid-force, hybrid-force-touch; separated by commas,
    /// the first is what others are compared with
    #[arg(long, value_delimiter = ',', default_value = "thesis,model")]
    law: Vec<String>,
    /// Seeds 1 to N
    #[arg(long, default_value_t = 3, value_name = "N")]
    seeds: u64,
    /// Only these experiments, such as E1,E8
    #[arg(long, value_delimiter = ',', value_name = "IDS")]
    only: Vec<String>,
    /// Folder with the scenes
    #[arg(long, default_value = "sim/scenes", value_name = "DIR")]
    scenes: PathBuf,
    /// Noise of a tactel instead of the scenes' own (counts); 0 for runs without noise
    #[arg(long, value_name = "COUNTS")]
    noise: Option<f64>,
    /// Threshold of the laws instead of three standard deviations of the noise (counts); 0 for none
    #[arg(long, value_name = "COUNTS")]
    threshold: Option<f64>,
    /// Folder for the report
    #[arg(long, default_value = "chapter6", value_name = "DIR")]
    out: PathBuf,
    /// Threads; one a processor when absent
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

impl Chapter6Options {
    /// The scene with the requested noise and threshold.
    fn with_overrides(&self, mut scene: Scene) -> Scene {
        if let Some(counts) = self.noise {
            scene.world.tactile.noise_counts = counts;
        }
        if self.threshold.is_some() {
            let servo = scene.machine.tactile_servo.get_or_insert_default();
            servo.threshold_counts = self.threshold;
        }
        scene
    }
}

/// Laws by their names.
///
/// # Errors
/// A name that no law has, or an empty list.
pub(crate) fn laws_by_name(names: &[String]) -> Result<Vec<LawName>, BadOption> {
    let one = |text: &String| {
        LawName::ALL.into_iter().find(|name| name.text() == text).ok_or_else(|| {
            let known = LawName::ALL.map(LawName::text).join(", ");
            BadOption(format!("--law {text}: no such law; there are {known}"))
        })
    };
    let found: Vec<LawName> = names.iter().map(one).collect::<Result<_, _>>()?;
    if found.is_empty() {
        return Err(BadOption("--law: none given; name at least one".to_owned()));
    }
    Ok(found)
}

/// All runs of one experiment.
pub(crate) struct ExperimentRuns {
    pub(crate) experiment: &'static Experiment,
    pub(crate) scene: PathBuf,
    pub(crate) title: String,
    /// Results by law, then by seed; `None` for a run that an interruption prevented.
    pub(crate) verdicts: Vec<Vec<Option<Evaluation>>>,
}

/// Runs the requested experiment.
///
/// # Errors
/// Invalid input as [`BadOption`], or a located error of a scene.
pub fn run(what: &Experiments) -> anyhow::Result<ExitCode> {
    match what {
        Experiments::Chapter6(options) => chapter6(options),
        Experiments::Robust(options) => robust::run(options),
        Experiments::Campaign(options) => campaign::run(options),
        Experiments::Senses(options) => senses::run(options),
        Experiments::Held(options) => held::run(options),
        Experiments::Slip(options) => slip::run(options),
        Experiments::Hand(options) => hand::run(options),
    }
}

/// Removes the report of an interrupted run, if there is one, after a complete report was written.
fn remove_partial(folder: &Path) -> anyhow::Result<()> {
    for name in ["partial.html", "partial.md"] {
        let path = folder.join(name);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot remove {}", path.display()));
            }
            _ => {}
        }
    }
    Ok(())
}

fn chapter6(options: &Chapter6Options) -> anyhow::Result<ExitCode> {
    let laws = laws_by_name(&options.law)?;
    if options.seeds == 0 || options.seeds > SEEDS_MAX {
        let text = format!("--seeds {}: give 1 to {SEEDS_MAX}", options.seeds);
        return Err(BadOption(text).into());
    }
    let (found, missing) = experiment_scenes(&options.scenes, &options.only)?;
    taktil_machine_console::option::create_folder("--out", &options.out)?;
    let mut plan = Vec::new();
    for (e, (experiment, _, scene)) in found.iter().enumerate() {
        for law in &laws {
            let scene = options.with_overrides(with_law(scene, *law));
            plan.extend(
                (1..=options.seeds).map(|seed| (e, experiment.id, *law, scene.clone(), seed)),
            );
        }
    }
    let [unfinished, table] = ["partial.csv", "runs.csv"].map(|name| options.out.join(name));
    let rows = RunTable::create(&unfinished)?;
    let done = run_parallel(options.threads, &plan, |(_, id, law, scene, seed)| {
        let verdict = evaluated_run(scene, *seed, *seed == 1)?;
        rows.append(&RunRow::new(id, law.text(), *seed, &verdict))?;
        Ok(verdict)
    })?;
    let (ran, planned) = (done.iter().flatten().count(), plan.len());
    let mut verdicts = done.into_iter();
    let all: Vec<ExperimentRuns> = found
        .into_iter()
        .map(|(experiment, path, scene)| ExperimentRuns {
            experiment,
            scene: path,
            title: scene.title,
            verdicts: laws
                .iter()
                .map(|_| verdicts.by_ref().take(options.seeds as usize).collect())
                .collect(),
        })
        .collect();
    let mut lacks = Vec::new();
    let whole = ran == planned;
    if whole {
        let shown = table.display();
        std::fs::rename(&unfinished, &table).with_context(|| format!("cannot write {shown}"))?;
        remove_partial(&options.out)?;
    } else {
        lacks.push(format!("interrupted: {ran} of {planned} runs were done"));
    }
    if !missing.is_empty() {
        let folder = options.scenes.display();
        lacks.push(format!("not run: {}: no scene in {folder}", missing.join(", ")));
    }
    let about = page::PageContext { laws: &laws, command: &repeat_command(options), lacks: &lacks };
    let name = if whole { "report" } else { "partial" };
    let (html, markdown) = page::write((&options.out, name), &all, &about)?;
    out::line(format_args!("{}\n{}", html.display(), markdown.display()))?;
    if whole && !compare_with_thesis(options)? {
        lacks.push("interrupted: no table beside the thesis's numbers".to_owned());
    }
    let verdicts = all.iter().flat_map(|runs| &runs.verdicts).flatten().flatten();
    let bad = verdicts.filter(|verdict| !verdict.figures.faults.is_empty()).count();
    if bad > 0 {
        lacks.push(format!("{bad} runs ended with a fault; see the tables"));
    }
    for lack in &lacks {
        out::warn(lack);
    }
    Ok(if lacks.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// Runs the scenes of 1994 that the folder has and writes what they show beside the thesis's
/// numbers; `false` when it was interrupted.
fn compare_with_thesis(options: &Chapter6Options) -> anyhow::Result<bool> {
    let mut scenes = thesis::measured_scenes(&load_folder(&options.scenes)?);
    // Several lines compare with E1.
    let wanted = |id: &str| id == "E1" || options.only.iter().any(|o| o.eq_ignore_ascii_case(id));
    scenes.retain(|scene| options.only.is_empty() || wanted(scene.id));
    if scenes.is_empty() {
        return Ok(true);
    }
    let Some(all) = thesis::run_scenes(&scenes, options.seeds, options.threads)? else {
        return Ok(false);
    };
    let path = thesis::write(&options.out, &all, options.seeds, &repeat_command(options))?;
    out::line(path.display())?;
    Ok(true)
}

/// The command that repeats the experiment.
fn repeat_command(options: &Chapter6Options) -> String {
    let (law, scenes) = (options.law.join(","), options.scenes.display());
    let mut words = format!("taktil experiment chapter6 --law {law} --seeds {}", options.seeds);
    words += &format!(" --scenes {scenes}");
    if !options.only.is_empty() {
        words += &format!(" --only {}", options.only.join(","));
    }
    for (option, value) in [("noise", options.noise), ("threshold", options.threshold)] {
        words += &value.map_or(String::new(), |value| format!(" --{option} {value}"));
    }
    words
}

/// Declared processor time of a step of the task that reads the wrist, us.
const WRIST_BUDGET_US: i64 = 20;

/// The same scene with another law; a law that uses the wrist gets the task that reads it.
#[must_use]
pub fn with_law(scene: &Scene, law: LawName) -> Scene {
    let mut scene = scene.clone();
    let machine = &mut scene.machine;
    machine.tactile_servo.get_or_insert_default().law = law;
    let named = |name: &str, tasks: &[String]| tasks.iter().position(|task| task == name);
    let reads = machine.lane.values().any(|lane| named("wrist_scan", &lane.tasks).is_some());
    if !law.uses_wrench() || reads {
        return scene;
    }
    for lane in machine.lane.values_mut() {
        let Some(place) = named("tactile_servo", &lane.tasks) else { continue };
        lane.tasks.insert(place, "wrist_scan".to_owned());
        if !lane.budget_us.is_empty() {
            lane.budget_us.insert("wrist_scan".to_owned(), WRIST_BUDGET_US);
        }
    }
    machine.wiring.insert("tactile_servo.wrench".to_owned(), "wrist_scan.wrench".to_owned());
    scene
}

/// An experiment with its scene.
pub(crate) type ExperimentScene = (&'static Experiment, PathBuf, Scene);

/// All scenes of a folder, by name.
///
/// # Errors
/// A folder that cannot be read, a located error of a scene.
pub fn load_folder(folder: &Path) -> anyhow::Result<Vec<(PathBuf, Scene)>> {
    let entries = std::fs::read_dir(folder)
        .map_err(|error| BadOption(format!("--scenes {}: {error}", folder.display())))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.extension().is_some_and(|ending| ending == "toml"))
        .collect();
    files.sort();
    let loaded: Vec<(PathBuf, Scene)> = files
        .into_iter()
        .map(|path| Scene::load(&path).map(|scene| (path, scene)))
        .collect::<Result<_, _>>()?;
    Ok(loaded)
}

/// The scene of each experiment, and the experiments without one. The scene is the first by name
/// whose title begins with the id of the experiment.
///
/// # Errors
/// An experiment in `only` that has no scene; a folder without any.
pub(crate) fn experiment_scenes(
    folder: &Path,
    only: &[String],
) -> anyhow::Result<(Vec<ExperimentScene>, Vec<&'static str>)> {
    for id in only {
        if !EXPERIMENTS.iter().any(|e| e.id.eq_ignore_ascii_case(id)) {
            let text = format!("--only {id}: no such experiment; there are E1 to E9");
            return Err(BadOption(text).into());
        }
    }
    let loaded = load_folder(folder)?;
    let wanted = |id: &str| only.is_empty() || only.iter().any(|o| o.eq_ignore_ascii_case(id));
    let (mut out, mut missing) = (Vec::new(), Vec::new());
    for experiment in EXPERIMENTS.iter().filter(|experiment| wanted(experiment.id)) {
        let head = format!("{}:", experiment.id);
        match loaded.iter().find(|(_, scene)| scene.title.starts_with(&head)) {
            Some((path, scene)) => out.push((experiment, path.clone(), scene.clone())),
            None => missing.push(experiment.id),
        }
    }
    if !only.is_empty() && !missing.is_empty() {
        let text = format!("--only {}: no scene in {}", missing.join(","), folder.display());
        return Err(BadOption(text).into());
    }
    if out.is_empty() {
        let text = format!("--scenes {}: no scene of chapter 6", folder.display());
        return Err(BadOption(text).into());
    }
    Ok((out, missing))
}

/// Evaluates one run in virtual time; with samples for drawing when `traced`.
///
/// # Errors
/// A scene that cannot be assembled, or a task that does not start.
pub fn evaluated_run(scene: &Scene, seed: u64, traced: bool) -> anyhow::Result<Evaluation> {
    let mut machine = Assembly::new(scene).with_seed(seed).build()?;
    let catalog = machine.catalog().clone();
    let targets = taktil_lab_scene::targets(scene);
    let mut judge = Evaluator::new(&catalog, targets, &scene.robot, &scene.world, traced);
    let stop = AtomicBool::new(false);
    virtual_time::run(&mut machine, scene.duration, &stop, &mut judge)
        .map_err(|(task, fault)| anyhow::anyhow!("task `{task}`: {}", fault.text()))?;
    Ok(judge.verdict())
}

/// Works through a list on several threads. The results are in the order of the list; those that
/// Ctrl-C prevented are absent.
///
/// # Errors
/// The error of an item that failed.
pub(crate) fn run_parallel<P: Sync, T: Send>(
    threads: Option<NonZeroUsize>,
    plan: &[P],
    work: impl Fn(&P) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<Option<T>>> {
    let stop = signals::watch(SecondSignal::Exits)?;
    let threads = threads.map_or_else(
        || std::thread::available_parallelism().map_or(1, NonZeroUsize::get),
        NonZeroUsize::get,
    );
    let next = AtomicUsize::new(0);
    let (send, receive) = mpsc::channel();
    let done: Vec<(usize, anyhow::Result<T>)> = std::thread::scope(|scope| {
        let (stop, next, work) = (&stop, &next, &work);
        for _ in 0..threads.min(plan.len()) {
            let send = send.clone();
            scope.spawn(move || {
                while !stop.load(Ordering::SeqCst) {
                    let index = next.fetch_add(1, Ordering::SeqCst);
                    let Some(part) = plan.get(index) else { break };
                    // The receiver lives until the last worker has ended.
                    let _ = send.send((index, work(part)));
                }
            });
        }
        drop(send);
        let mut progress = Progress::new("runs", plan.len());
        receive.iter().inspect(|_| progress.advance()).collect()
    });
    let mut answers: Vec<Option<T>> = plan.iter().map(|_| None).collect();
    for (index, answer) in done {
        answers[index] = Some(answer.context("a run failed")?);
    }
    Ok(answers)
}
