//! The command `check-task`: finds the task and its scene, makes the checks, prints what was found.
//! Exit code 0: the task is sound; 1: it is not, or something could not be checked; 2: bad input.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_machine::own::{self, OwnTask};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_rtcore::guard;

use crate::drive::TestDriver;
use crate::lifecycle::{Lifecycle, RESTARTS_COMPARED};
use crate::plan::{self, Run};
use crate::progress::Progress;
use crate::report::{Check, CheckResult, Outcome, Report};
use crate::task_under_test::TaskUnderTest;
use crate::watchdog::{STEP_TIME_MAX, Watchdog};

/// Fewest and most steps.
const TICKS_RANGE: core::ops::RangeInclusive<usize> = 1000..=10_000_000;
/// Fewest and most starts.
const STARTS_RANGE: core::ops::RangeInclusive<usize> = 20..=1_000_000;

/// Options of the command.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
What is looked for, in steps of the one task with made-up inputs:
  heap calls    any in a step; needs taktil_rtcore::guard::CountingAllocator in the program
  panics        with values at the limits of their fields, absent, late and silent inputs
  not finite    NaN or an infinite number written to an output while all inputs are finite
  stale inputs  a twin gets other values where an input is stale, or its field `valid` is 0:
                outputs and folded state must be the same bit for bit
  ranges        with plausible inputs: Goal and Desired against the joints' limits and speeds,
                Torque against the drives, flags and numbers of enumerations in payloads of
                `signal`, and what an output declares by `output_within`
  budget        the step's own time, fold included, by the shortest of three to six repeats
  repeats       the same inputs again, in a fresh task and later: the same bits
  restart       a task that was stopped and started again does what a fresh one does
  leak          memory left by building, starting, stopping and dropping the task

Plausible inputs: joints in the middle half of their ranges and at up to half of their speeds, the
states and modes that there are; for other fields what the unit at the end of the name suggests.

Not checked: whether the law is right; jumps and speeds between steps; ranges of payloads of one's
own without `output_within`; state that is not folded and shows at no output; memory lost on other
threads, files and threads left open; the time that the first, cold step takes; what a step does
when other tasks answer to it.")]
pub struct CheckTaskArgs {
    /// Task of this program; may be left out when there is one
    task: Option<String>,
    /// Scene that runs it: lane, budget, wiring, section, arm
    #[arg(long, value_name = "FILE", default_value = "scene.toml")]
    scene: PathBuf,
    /// Steps, 1000 to 10000000
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    ticks: usize,
    /// Starts and stops, 20 to 1000000
    #[arg(long, value_name = "N", default_value_t = 1000)]
    starts: usize,
    /// Seed of all inputs
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Only this run of the plan, without starts and stops: what a failure names
    #[arg(long, value_name = "N")]
    run: Option<usize>,
    /// One JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// Options and files that cannot be used; a task that refuses to start.
pub fn run(arguments: &CheckTaskArgs) -> anyhow::Result<ExitCode> {
    let task = task_by_name(arguments.task.as_deref(), own::tasks())?;
    if !arguments.json && cfg!(debug_assertions) {
        out::warn(
            "this program was built without --release: step times are longer than they are there",
        );
    }
    let report = check(task, arguments, !arguments.json)?;
    match arguments.json {
        true => out::line(report.json())?,
        false => out::text(report.text())?,
    };
    Ok(ExitCode::from(u8::from(!report.is_sound())))
}

/// The task that is meant.
fn task_by_name(
    name: Option<&str>,
    tasks: &'static [OwnTask],
) -> Result<&'static OwnTask, BadOption> {
    let names = || tasks.iter().map(|task| task.name).collect::<Vec<_>>().join(", ");
    match (name, tasks) {
        (_, []) => {
            let what = "this program has no task of its own";
            Err(BadOption(format!("{what}; `new-task NAME` makes a crate with one")))
        }
        (None, [task]) => Ok(task),
        (None, _) => Err(BadOption(format!("name one of the tasks {}", names()))),
        (Some(name), tasks) => tasks.iter().find(|task| task.name == name).ok_or_else(|| {
            BadOption(format!("this program has no task `{name}` of its own; it has {}", names()))
        }),
    }
}

/// Checks a task as the command does; `shown` tells how far it is on standard error.
///
/// # Errors
/// As [`run`].
pub fn check(
    task: &'static OwnTask,
    arguments: &CheckTaskArgs,
    shown: bool,
) -> anyhow::Result<Report> {
    let CheckTaskArgs { ticks, starts, seed, .. } = *arguments;
    check_range("--ticks", ticks, &TICKS_RANGE)?;
    check_range("--starts", starts, &STARTS_RANGE)?;
    let scene = Scene::load(&arguments.scene)?;
    let machine = Assembly::new(&scene).build()?;
    let subject = TaskUnderTest::new(&scene, &machine, task)?;
    drop(machine);
    let again = command_line(task.name, arguments);
    let runs = runs_to_drive(plan::runs(seed, ticks), arguments.run)?;
    let steps = runs.iter().map(|run| run.steps).sum();
    let mut progress = Progress::new(!shown);
    let (name, repeat) = (task.name, again.clone());
    let watchdog = Watchdog::start(STEP_TIME_MAX, move |beat| {
        let run = beat.run.map_or_else(String::new, |run| format!(" of run {run}"));
        let only = beat.run.map_or_else(String::new, |run| format!(" --run {run}"));
        out::warn(format_args!(
            "FAILED: step {}{run} of `{name}` does not end\n  again: {repeat}{only}",
            beat.step
        ));
        // A step that hangs cannot be ended.
        std::process::exit(1);
    });
    let mut driver = TestDriver::new(&subject, steps, &watchdog, &mut progress)?;
    driver.drive(&runs)?;
    let (p999, worst) = driver.step_times();
    let ranges = driver.range_count();
    let mut findings = core::mem::take(&mut driver.findings);
    let repeats = !findings.failures.contains_key(&Check::Repeats);
    if arguments.run.is_none() {
        let findings = &mut findings;
        let (subject, progress) = (&subject, &mut progress);
        let mut lifecycle = Lifecycle { subject, seed, watchdog: &watchdog, progress, findings };
        if repeats {
            lifecycle.restart()?;
        }
        if guard::installed() {
            lifecycle.leak(starts)?;
        }
    }
    progress.finish();
    let mut lines = Vec::new();
    for check in Check::ALL {
        let only_steps = !matches!(check, Check::Restart | Check::Leak);
        if arguments.run.is_some() && !only_steps {
            continue;
        }
        let plan =
            Coverage { runs: &runs, starts, ranges, unusable_steps: findings.unusable_steps };
        let outcome = match findings.failures.remove(&check) {
            _ if !repeats && matches!(check, Check::StaleInputs | Check::Restart) => {
                Outcome::Skipped("not judged: the same inputs lead to other outputs".to_owned())
            }
            Some(failure) => Outcome::Failed(failure),
            None => plan.outcome(check, &subject),
        };
        lines.push(CheckResult { check, done: plan.done(check), outcome });
    }
    let budget = subject.budget();
    let about = about(&subject, arguments)?;
    Ok(Report { task: task.name.to_owned(), about, lines, p999, worst, budget, again })
}

fn check_range(
    option: &str,
    value: usize,
    range: &core::ops::RangeInclusive<usize>,
) -> Result<(), BadOption> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(BadOption(format!("{option} {value}: give {} to {}", range.start(), range.end())))
}

/// All runs, or the one that was asked for.
fn runs_to_drive(runs: Vec<Run>, only: Option<usize>) -> Result<Vec<Run>, BadOption> {
    let Some(only) = only else { return Ok(runs) };
    let Some(run) = runs.get(only) else {
        return Err(BadOption(format!("--run {only}: there are {} runs", runs.len())));
    };
    Ok(vec![Run { first: 0, ..*run }])
}

/// The command line that does the same again.
fn command_line(task: &str, arguments: &CheckTaskArgs) -> String {
    let program = std::env::args_os().next().unwrap_or_default();
    let program = PathBuf::from(program);
    let program = program.file_name().unwrap_or_default().to_string_lossy();
    let CheckTaskArgs { scene, ticks, starts, seed, .. } = arguments;
    let scene = scene.display();
    let task = format!("{program} check-task {task} --scene {scene}");
    format!("{task} --ticks {ticks} --starts {starts} --seed {seed}")
}

fn about(subject: &TaskUnderTest, arguments: &CheckTaskArgs) -> anyhow::Result<String> {
    let harness = subject.build()?;
    let of =
        |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    let budget =
        subject.budget().map_or("no budget".to_owned(), |budget| format!("budget {budget}"));
    Ok(format!(
        "{}, lane {}, period {}, {budget}; {}, {}, {}",
        arguments.scene.display(),
        subject.lane.name,
        subject.lane.period,
        of(harness.inputs().len(), "input"),
        of(harness.outputs().len(), "output"),
        of(harness.parameters().len(), "parameter"),
    ))
}

/// What was done, for the table.
struct Coverage<'a> {
    runs: &'a [Run],
    starts: usize,
    ranges: usize,
    unusable_steps: u64,
}

impl Coverage<'_> {
    fn steps(&self, kinds: &[plan::InputKind]) -> usize {
        let of_kinds = self.runs.iter().filter(|run| kinds.contains(&run.kind));
        of_kinds.map(|run| run.steps).sum()
    }

    fn done(&self, check: Check) -> String {
        use plan::InputKind::{Extreme, NotFinite, Plausible};
        let all = self.steps(&[Plausible, Extreme, NotFinite]);
        match check {
            Check::HeapCalls => format!("{all} steps"),
            Check::Panics => {
                let extreme = self.steps(&[Extreme, NotFinite]);
                format!("{} runs, {extreme} steps with extreme values", self.runs.len())
            }
            Check::NotFinite => {
                format!("{} steps with finite inputs", self.steps(&[Plausible, Extreme]))
            }
            Check::StaleInputs => {
                format!("twins, {} steps with unusable values", self.unusable_steps)
            }
            Check::Ranges => {
                let plausible = self.steps(&[Plausible]);
                format!("{plausible} steps with plausible inputs, {} limits", self.ranges)
            }
            Check::Budget => format!("{all} steps, each three times or more"),
            Check::Repeats => format!("{all} steps again"),
            Check::Restart => format!("{RESTARTS_COMPARED} stopped and started again"),
            Check::Leak => format!("{} starts and stops", self.starts),
        }
    }

    /// The outcome of a check that found nothing.
    fn outcome(&self, check: Check, subject: &TaskUnderTest) -> Outcome {
        match check {
            Check::HeapCalls | Check::Leak if !guard::installed() => {
                let what = "add `#[global_allocator] static A: CountingAllocator` to main.rs";
                Outcome::Unchecked(what.to_owned())
            }
            Check::StaleInputs if self.unusable_steps == 0 => {
                Outcome::Skipped("no input can be stale or invalid".to_owned())
            }
            Check::Budget if subject.budget().is_none() => {
                Outcome::Skipped("the scene declares no budget".to_owned())
            }
            _ => Outcome::Held,
        }
    }
}
