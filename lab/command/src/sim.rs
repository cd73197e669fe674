//! `taktil sim`: digests and faults of whole runs in virtual time, for one seed or many, one after
//! the other or in parallel; and the world of a log at any instant. Equal digests mean equal runs.

mod seek;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::mpsc;

use taktil_machine_console::out;
use taktil_rtcore::{Nanos, linux};

use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::{self, Scene};
use taktil_lab_scene::{RunOutcome, outcome_of_run};
use taktil_machine_console::option::BadOption;

/// Largest number of scenes that are simulated at the same time.
const THREADS_MAX: usize = 64;

/// The subcommands.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Sim {
    /// Print the digest of a scene's run in virtual time, the one that `taktil run --fast` prints
    /// and the tests pin: one line a seed.
    ///
    /// Equal seeds give equal lines: debug or release, today or next year, alone or side by side. A
    /// run that ends with faults names them in its line. Exit code 0: none did; 1: some did; 2: bad
    /// input.
    Hash(HashArgs),
    /// What really happened at an instant of a recorded run: the world is built anew from the log's
    /// scene and seed and moved on by the log's own D/A words and lines.
    ///
    /// Every state on the way is compared with the recorded one, bit for bit. Exit code 0: equal;
    /// 1: the world went another way than in the log; 2: a log that cannot be used.
    Seek(seek::SeekArgs),
}

/// Which runs.
#[derive(Clone, Debug, clap::Args)]
pub struct HashArgs {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Seed instead of the scene's
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Simulated seconds, instead of the scene's
    #[arg(long = "for", value_name = "S", allow_negative_numbers = true)]
    for_s: Option<f64>,
    /// This many seeds, counted up from the first
    #[arg(long, value_name = "N", default_value_t = 1)]
    seeds: u64,
    /// Simulate this many scenes at the same time, each on a thread of its own
    #[arg(long, value_name = "N", default_value_t = 1)]
    beside: usize,
}

/// Simulates and prints the result.
///
/// # Errors
/// A scene that cannot be run, located; [`BadOption`].
pub fn run(what: &Sim) -> anyhow::Result<ExitCode> {
    let arguments = match what {
        Sim::Hash(arguments) => arguments,
        Sim::Seek(arguments) => return seek::run(arguments),
    };
    let scene = Scene::load(&arguments.scene)?;
    let until = match arguments.for_s {
        None => scene.duration,
        Some(seconds) => scene::duration(seconds, "--for")
            .map_err(|bad| BadOption(format!("--for {seconds}: {}; {}", bad.what, bad.remedy)))?,
    };
    if !(1..=THREADS_MAX).contains(&arguments.beside) {
        let what = format!("--beside {}: give 1 to {THREADS_MAX}", arguments.beside);
        return Err(BadOption(what).into());
    }
    let first = arguments.seed.unwrap_or(scene.seed);
    let Some(end) = first.checked_add(arguments.seeds).filter(|end| *end > first) else {
        let what = format!("--seeds {}: give at least 1, and seeds below 2^64", arguments.seeds);
        return Err(BadOption(what).into());
    };
    let begin = linux::monotonic();
    let mut with_faults = 0;
    let heard = run_seeds(&scene, first..end, arguments.beside, until, |seed, run| {
        with_faults += u64::from(!run.faults.is_empty());
        let faults: String = run.faults.iter().map(|fault| format!("  {fault:?}")).collect();
        out::line(format_args!("{}  seed {seed}{faults}", run.digest))
    })?;
    let code = ExitCode::from(u8::from(with_faults > 0));
    if !heard {
        return Ok(code);
    }
    let wall_s = (linux::monotonic() - begin).as_secs_f64();
    let simulated_s = arguments.seeds as f64 * until.as_secs_f64();
    out::warn(format_args!(
        "{} runs of {} s in {wall_s:.1} s: {:.1} x real time, {} at a time; {} with faults",
        arguments.seeds,
        until.as_secs_f64(),
        simulated_s / wall_s,
        arguments.beside,
        with_faults
    ));
    Ok(code)
}

/// Runs one seed in virtual time.
///
/// # Errors
/// A scene that cannot be run, located; a task that does not start.
pub fn run_seed(scene: &Scene, seed: u64, until: Nanos) -> anyhow::Result<RunOutcome> {
    let mut machine = Assembly::new(scene).with_seed(seed).build()?;
    outcome_of_run(&mut machine, until)
}

/// Runs several seeds, `beside` of them in parallel, and passes what became of them to `tell` in
/// the order of the seeds until it returns false. Returns whether it returned true to the end.
///
/// # Errors
/// As [`run_seed`], for the first seed that fails; the errors of `tell`.
pub fn run_seeds(
    scene: &Scene,
    seeds: std::ops::Range<u64>,
    beside: usize,
    until: Nanos,
    mut tell: impl FnMut(u64, &RunOutcome) -> anyhow::Result<bool>,
) -> anyhow::Result<bool> {
    let (results, found) = mpsc::channel();
    std::thread::scope(|threads| {
        for turn in 0..beside {
            let (results, own) = (results.clone(), seeds.clone().skip(turn).step_by(beside));
            threads.spawn(move || {
                for seed in own {
                    if results.send((seed, run_seed(scene, seed, until))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(results);
        let mut waiting = std::collections::BTreeMap::new();
        let mut due = seeds.start;
        for (seed, run) in found {
            waiting.insert(seed, run);
            while let Some(run) = waiting.remove(&due) {
                if !tell(due, &run?)? {
                    return Ok(false);
                }
                due += 1;
            }
        }
        Ok(true)
    })
}
