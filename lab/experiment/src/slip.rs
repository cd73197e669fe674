//! `taktil experiment slip`: bodies that slide over the pad at drawn instants, and a pin that is
//! rolled and does not. The delay of the detection stands beside the bound that the noise of the
//! frames and the time between them set, and the false alarms of rolling beside the allowed rate.

mod draws;
mod shape;
mod table;
mod watch;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use clap::Args;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_rtcore::record::Observer;
use taktil_rtcore::{Machine, Nanos, virtual_time};
use taktil_tasks_tactile_servo::config::law_name::LawName;
use taktil_tasks_tactile_servo::config::slip::SlipConfig;

use super::{run_parallel, with_law};
use draws::{SlidingDraw, sliding_draw};
use shape::ShapeWatch;
use watch::{SlipFindings, SlipWatch};

/// Largest number of draws for each speed.
const DRAWS_MAX: u64 = 10_000;
/// Largest number of rolling runs.
const ROLLS_MAX: u64 = 10_000;
/// Longest rolling run (s).
const ROLL_MAX_S: f64 = 3_600.0;
/// A slip at 20 mm/s has to be noticed within this time (s), in this share of the draws.
const DELAY_MAX_S: f64 = 0.020;
const DETECTED_SHARE_MIN: f64 = 0.95;
/// The speed for which that is required (mm/s).
const REQUIRED_SPEED_MM_S: f64 = 20.0;

/// Options of `taktil experiment slip`.
#[derive(Args, Debug)]
pub struct SlipOptions {
    /// Speeds of sliding (mm/s), separated by commas
    #[arg(long, value_delimiter = ',', default_value = "2,5,20,50", value_name = "MM_S")]
    speeds: Vec<f64>,
    /// Draws of sliding for each speed
    #[arg(long, default_value_t = 20, value_name = "N")]
    draws: u64,
    /// Runs of rolling, seeds 1 to N
    #[arg(long, default_value_t = 2, value_name = "N")]
    rolls: u64,
    /// Duration of each run of rolling (s)
    #[arg(long, default_value_t = 20.0, value_name = "S")]
    roll_s: f64,
    /// Law with which the pin is rolled
    #[arg(long, default_value = "model")]
    law: String,
    /// Scene of a finger that presses on a body
    #[arg(long, default_value = "sim/scenes/slip.toml", value_name = "FILE")]
    scene: PathBuf,
    /// Scene of a pin that is rolled
    #[arg(long, default_value = "sim/scenes/roll-pin.toml", value_name = "FILE")]
    roll_scene: PathBuf,
    /// Folder for slip.md, slip.csv and slip.json
    #[arg(long, default_value = "slip", value_name = "DIR")]
    out: PathBuf,
    /// Threads; one a processor when absent
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// One run: of a body that slides, or of a pin that is rolled.
enum Plan {
    Sliding(Box<Scene>, SlidingDraw),
    Rolling(Box<Scene>, u64),
}

/// What a run was of, and what came of it.
pub(crate) struct SlipRun {
    /// The draw; none for a run of rolling.
    draw: Option<SlidingDraw>,
    seed: u64,
    findings: SlipFindings,
}

fn check(options: &SlipOptions) -> Result<(), BadOption> {
    if options.draws > DRAWS_MAX || options.rolls > ROLLS_MAX {
        let text = format!("--draws, --rolls: give at most {DRAWS_MAX} and {ROLLS_MAX}");
        return Err(BadOption(text));
    }
    if options.draws == 0 && options.rolls == 0 {
        return Err(BadOption("--draws 0 --rolls 0: nothing to do; give one of them".to_owned()));
    }
    if !(5.0..=ROLL_MAX_S).contains(&options.roll_s) {
        return Err(BadOption(format!("--roll-s {}: give 5 to {ROLL_MAX_S}", options.roll_s)));
    }
    match options.speeds.iter().find(|speed| !(0.5..=200.0).contains(*speed)) {
        Some(speed) => Err(BadOption(format!("--speeds {speed}: give 0.5 to 200 mm/s"))),
        None if options.speeds.is_empty() => Err(BadOption("--speeds: none given".to_owned())),
        None => Ok(()),
    }
}

fn plan(options: &SlipOptions) -> anyhow::Result<Vec<Plan>> {
    let law = LawName::ALL.into_iter().find(|law| law.text() == options.law);
    let Some(law) = law else {
        let known = LawName::ALL.map(LawName::text).join(", ");
        return Err(BadOption(format!("--law {}: there are {known}", options.law)).into());
    };
    let mut plan = Vec::new();
    if options.draws > 0 {
        let base = Scene::load(&options.scene)?;
        for speed in &options.speeds {
            plan.extend((1..=options.draws).map(|number| {
                let (scene, draw) = sliding_draw(&base, *speed, number);
                Plan::Sliding(Box::new(scene), draw)
            }));
        }
    }
    if options.rolls > 0 {
        let mut base = with_law(&Scene::load(&options.roll_scene)?, law);
        base.machine.tactile_servo.get_or_insert_default().slip = Some(SlipConfig::default());
        #[expect(clippy::cast_possible_truncation, reason = "at most an hour of nanoseconds")]
        let duration = Nanos((options.roll_s * 1e9).round() as i64);
        base.duration = duration;
        plan.extend((1..=options.rolls).map(|seed| Plan::Rolling(Box::new(base.clone()), seed)));
    }
    Ok(plan)
}

fn observe(scene: &Scene, machine: &mut Machine, watch: &mut dyn Observer) -> anyhow::Result<()> {
    let stop = AtomicBool::new(false);
    virtual_time::run(machine, scene.duration, &stop, watch)
        .map_err(|(task, fault)| anyhow::anyhow!("task `{task}`: {}", fault.text()))?;
    Ok(())
}

fn observed(scene: &Scene, seed: u64, draw: Option<&SlidingDraw>) -> anyhow::Result<SlipFindings> {
    let mut machine = Assembly::new(scene).with_seed(seed).build()?;
    let mut watch = SlipWatch::new(machine.catalog(), draw.map(|draw| draw.from));
    observe(scene, &mut machine, &mut watch)?;
    let mut findings = watch.findings();
    if let Some(draw) = draw {
        // The same once more without noise.
        let mut quiet = scene.clone();
        quiet.world.tactile.noise_counts = 0.0;
        let mut machine = Assembly::new(&quiet).with_seed(seed).build()?;
        let mut shape = ShapeWatch::new(machine.catalog(), draw.from);
        observe(&quiet, &mut machine, &mut shape)?;
        findings.place_bound_mm = shape.place_bound_mm(scene.world.tactile.noise_counts);
    }
    Ok(findings)
}

/// Runs the draws and prints the tables.
///
/// # Errors
/// Invalid input as [`BadOption`], or a located error of a scene.
pub fn run(options: &SlipOptions) -> anyhow::Result<ExitCode> {
    check(options)?;
    let plan = plan(options)?;
    taktil_machine_console::option::create_folder("--out", &options.out)?;
    let rows = table::RunRows::create(&options.out.join("slip.csv"))?;
    let done = run_parallel(options.threads, &plan, |one| {
        let run = match one {
            Plan::Sliding(scene, draw) => SlipRun {
                draw: Some(draw.clone()),
                seed: draw.seed,
                findings: observed(scene, draw.seed, Some(draw))?,
            },
            Plan::Rolling(scene, seed) => {
                SlipRun { draw: None, seed: *seed, findings: observed(scene, *seed, None)? }
            }
        };
        rows.append(&run)?;
        Ok(run)
    })?;
    let left = done.iter().filter(|run| run.is_none()).count();
    let runs: Vec<SlipRun> = done.into_iter().flatten().collect();
    table::write_json(&options.out.join("slip.json"), &runs)?;
    let text = table::markdown(&options.speeds, &runs);
    table::write_text(&options.out.join("slip.md"), &text)?;
    out::line(&text)?;
    if left > 0 {
        out::warn(format_args!("interrupted: {left} runs were not made"));
    }
    let lacks = table::shortfalls(&runs);
    for lack in &lacks {
        out::warn(lack);
    }
    Ok(if left == 0 && lacks.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
