//! The command `taktil storm`: runs the cases of a range of seeds, says what was found, and shrinks
//! what failed. Exit code 0: no rule was broken; 1: one was; 2: bad input.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Subcommand};
use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;
use taktil_lab_progress::Progress;
use taktil_lab_scene::assembly::load_checked_scene;
use taktil_machine::fault_plan::read_faults;
use taktil_machine_console::option::{BadOption, create_folder};
use taktil_machine_console::out;

use crate::campaign::{Batch, Failure, StormPlan};
use crate::case::{Campaign, Case, Scenes};
use crate::export::{self, Engine, batch_json, collect, part_file, write_part};
use crate::log::LogFolder;
use crate::shrink::shrink;

/// Runs between two lines of progress, for each thread.
const BATCH_RUNS: usize = 4;
/// Failing seeds that are shrunk; what follows is only told.
const SHRUNK_MAX: usize = 3;

/// Options of the command.
#[derive(Args, Debug)]
#[command(args_conflicts_with_subcommands = true)]
pub struct StormArgs {
    #[command(subcommand)]
    what: Option<StormCommand>,
    #[command(flatten)]
    options: StormOptions,
}

/// What is to be run.
#[derive(Args, Clone, Debug)]
pub struct StormOptions {
    /// Scene file of the PUMA 260 (TOML); the storm's own scenes when absent
    scene: Option<PathBuf>,
    /// Seeds, the end excluded, or one seed
    #[arg(long, value_name = "A..B", default_value = "0..200")]
    seeds: String,
    /// As many more seeds from the clock's, which are printed
    #[arg(long, value_name = "N", default_value_t = 0)]
    fresh: u64,
    /// Which faults are drawn
    #[arg(long, value_enum, default_value_t = Campaign::Recoverable)]
    campaign: Campaign,
    /// Faults instead of drawn ones: a TOML file with `[[fault]]`, or one as `kind=... target=...`;
    /// may be given several times
    #[arg(long, value_name = "F")]
    plan: Vec<String>,
    /// Time in which faults may begin, s; drawn for each seed when absent
    #[arg(long, value_name = "S")]
    length: Option<f64>,
    /// Threads; one for each processor when absent
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// One JSON object instead of sentences
    #[arg(long)]
    json: bool,
    /// Print the digest of each run
    #[arg(long)]
    digests: bool,
    /// Folder for the log of each failing seed, CAMPAIGN-SEED.mcap: its run with the least plan
    /// where that was sought, with the drawn one otherwise
    #[arg(long, value_name = "DIR")]
    log: Option<PathBuf>,
    /// Leave failing plans as they are
    #[arg(long)]
    no_shrink: bool,
    /// End at the first batch with a failure
    #[arg(long)]
    until_failure: bool,
    /// Run only this part of the seeds, of `--chunk` each, and leave its results in `--out`
    #[arg(long, value_name = "I", requires = "out")]
    index: Option<u64>,
    /// Seeds of a part
    #[arg(long, value_name = "N", default_value_t = 100)]
    chunk: u64,
    /// Folder for results of parts
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Subcommand, Debug)]
enum StormCommand {
    /// Write a script that runs the storm part by part elsewhere.
    Export {
        /// What runs the parts
        #[arg(long, value_enum)]
        engine: Engine,
        #[command(flatten)]
        options: StormOptions,
    },
    /// Put the results of parts together: what is missing, what failed, one digest.
    Collect {
        #[command(flatten)]
        options: StormOptions,
    },
}

impl StormOptions {
    fn seeds(&self) -> Result<Range<u64>, BadOption> {
        let bad = || BadOption(format!("--seeds {}: write A..B, or one seed", self.seeds));
        let number = |text: &str| text.parse::<u64>().map_err(|_| bad());
        let seeds = match self.seeds.split_once("..") {
            Some((first, end)) => number(first)?..number(end)?,
            None => {
                let seed = number(&self.seeds)?;
                seed..seed.saturating_add(1)
            }
        };
        if seeds.is_empty() { Err(bad()) } else { Ok(seeds) }
    }

    fn plan(&self) -> anyhow::Result<StormPlan> {
        let scenes = match &self.scene {
            Some(file) => Scenes::only(puma_scene(file)?),
            None => Scenes::built_in()?,
        };
        let mut faults = Vec::new();
        for text in &self.plan {
            faults.extend(read_faults(text)?);
        }
        let plan = (!self.plan.is_empty()).then(|| FaultPlan::new(faults));
        let length = match self.length {
            None => None,
            Some(length) if (0.1..=86_400.0).contains(&length) => {
                Some(Nanos((length * 1e9) as i64))
            }
            Some(length) => {
                return Err(BadOption(format!("--length {length}: give 0.1 to 86400 s")).into());
            }
        };
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let jobs = self.jobs.unwrap_or(processors).clamp(1, 1024);
        Ok(StormPlan { scenes, campaign: self.campaign, plan, length, jobs })
    }

    /// Where logs of failing seeds go.
    fn logs(&self) -> Result<Option<LogFolder>, BadOption> {
        self.log.as_deref().map(LogFolder::new).transpose()
    }

    /// The options of one seed, which draws its own faults.
    fn of_seed(&self, seed: u64) -> StormOptions {
        StormOptions { seeds: seed.to_string(), plan: Vec::new(), ..self.clone() }
    }

    /// The command that runs a seed with this plan.
    fn again(&self, seed: u64, plan: &FaultPlan) -> String {
        let faults = plan.faults().iter().map(|fault| format!(" --plan '{fault}'"));
        format!("taktil {}{}", self.of_seed(seed).words().join(" "), faults.collect::<String>())
    }

    /// How many parts the seeds have.
    fn parts(&self) -> Result<u64, BadOption> {
        let seeds = self.seeds()?;
        Ok((seeds.end - seeds.start).div_ceil(self.chunk.max(1)))
    }

    /// The options that another process needs for the same runs.
    fn words(&self) -> Vec<String> {
        let mut words = vec!["storm".to_owned()];
        words.extend(self.scene.iter().map(|scene| scene.display().to_string()));
        let mut add = |key: &str, value: String| words.extend([format!("--{key}"), value]);
        add("seeds", self.seeds.clone());
        add("campaign", self.campaign.name().to_owned());
        self.plan.iter().for_each(|plan| add("plan", plan.clone()));
        self.length.iter().for_each(|length| add("length", length.to_string()));
        words
    }
}

/// A scene of the arm whose limits the checkers know.
fn puma_scene(file: &Path) -> anyhow::Result<taktil_lab_scene::scene::Scene> {
    let scene = load_checked_scene(file)?;
    if !scene.robot.is_puma260() {
        let what = "the checkers of a storm know the PUMA 260 only; name a scene of it";
        return Err(BadOption(format!("{}: {what}", file.display())).into());
    }
    Ok(scene)
}

/// Runs the command.
///
/// # Errors
/// Options or files that cannot be used; results that cannot be written.
pub fn run(arguments: &StormArgs) -> anyhow::Result<ExitCode> {
    match &arguments.what {
        None if arguments.options.index.is_some() => run_part(&arguments.options),
        None => run_all(&arguments.options),
        Some(StormCommand::Export { engine, options }) => export_script(*engine, options),
        Some(StormCommand::Collect { options }) => collect_parts(options),
    }
}

fn export_script(engine: Engine, options: &StormOptions) -> anyhow::Result<ExitCode> {
    let folder = options.out.clone().unwrap_or_else(|| PathBuf::from("storm"));
    let mut words = options.words();
    let shown = folder.display().to_string();
    if let Some(logs) = &options.log {
        words.extend(["--log".to_owned(), logs.display().to_string()]);
    }
    words.extend(
        ["--chunk", &options.chunk.to_string(), "--out", &shown, "--jobs", "1"].map(str::to_owned),
    );
    let program =
        std::env::current_exe().map_or("taktil".to_owned(), |path| path.display().to_string());
    out::text(export::script(engine, &program, &words, options.parts()?))?;
    Ok(ExitCode::SUCCESS)
}

fn run_part(options: &StormOptions) -> anyhow::Result<ExitCode> {
    let (Some(index), Some(folder)) = (options.index, &options.out) else {
        return Err(BadOption("--index: needs --out".to_owned()).into());
    };
    create_folder("--out", folder)?;
    let logs = options.logs()?;
    let parts = options.parts()?;
    if index >= parts {
        return Err(BadOption(format!("--index {index}: there are {parts} parts")).into());
    }
    if part_file(folder, index).exists() {
        out::line(format_args!("part {index} is there already"))?;
        return Ok(ExitCode::SUCCESS);
    }
    let seeds = options.seeds()?;
    let chunk = options.chunk.max(1);
    let first = seeds.start + index * chunk;
    let seeds: Vec<u64> = (first..seeds.end.min(first + chunk)).collect();
    let batch = options.plan()?.run_batch(&seeds);
    for failure in &batch.failures {
        log_failure(options, logs.as_ref(), failure, &failure.case)?;
    }
    write_part(folder, index, &batch)?;
    out::line(format_args!("part {index}: {} runs, digest {}", seeds.len(), batch.digest()))?;
    Ok(ExitCode::from(u8::from(!batch.failures.is_empty())))
}

fn collect_parts(options: &StormOptions) -> anyhow::Result<ExitCode> {
    let folder = options.out.clone().unwrap_or_else(|| PathBuf::from("storm"));
    let all = collect(&folder, options.parts()?)?;
    for index in &all.missing {
        out::line(format_args!("part {index} is missing"))?;
    }
    for failure in &all.failures {
        out::line(failure)?;
    }
    out::line(format_args!(
        "{} runs, {:.2} simulated hours, {} failed, {} parts missing, digest {}",
        all.runs,
        all.simulated_s / 3600.0,
        all.failures.len(),
        all.missing.len(),
        all.digest
    ))?;
    Ok(ExitCode::from(u8::from(!all.failures.is_empty() || !all.missing.is_empty())))
}

/// Seeds that nobody has seen before.
fn fresh_seeds(count: u64) -> Range<u64> {
    if count == 0 {
        return 0..0;
    }
    // Nanoseconds of the monotonic clock and the process: good enough to differ from run to run.
    let clock = taktil_rtcore::linux::monotonic().0.unsigned_abs();
    let first = clock.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ u64::from(std::process::id());
    let first = 1_000_000 + (first >> 24);
    first..first + count
}

fn run_all(options: &StormOptions) -> anyhow::Result<ExitCode> {
    let logs = options.logs()?;
    let plan = options.plan()?;
    let fresh = fresh_seeds(options.fresh);
    let seeds: Vec<u64> = options.seeds()?.chain(fresh.clone()).collect();
    if !fresh.is_empty() && !options.json {
        out::line(format_args!("fresh seeds {}..{}", fresh.start, fresh.end))?;
    }
    let began = taktil_rtcore::linux::monotonic();
    let hours_per_hour = |simulated: Nanos| {
        simulated.as_secs_f64()
            / (taktil_rtcore::linux::monotonic() - began).as_secs_f64().max(1e-9)
    };
    let mut all = Batch::default();
    let mut progress = (!options.json).then(|| Progress::new("runs", seeds.len()));
    let batch_runs = if options.until_failure { 1 } else { BATCH_RUNS };
    for batch in seeds.chunks(batch_runs * plan.jobs) {
        let ran = plan.run_batch(batch);
        if options.digests {
            for (seed, digest) in &ran.digests {
                out::line(format_args!("seed {seed}: {digest}"))?;
            }
        }
        let failed = !ran.failures.is_empty();
        for (index, failure) in ran.failures.iter().enumerate() {
            tell_failure(options, failure)?;
            let is_early = all.failures.len() + index < SHRUNK_MAX;
            let shrinks = is_early && !options.no_shrink && !options.json;
            let case = shrunk(options, failure, shrinks)?;
            log_failure(options, logs.as_ref(), failure, &case)?;
        }
        all.append(ran);
        if let Some(progress) = &mut progress {
            progress.advance_by(batch.len());
        }
        if failed && options.until_failure {
            break;
        }
    }
    drop(progress);
    if options.json {
        out::line(batch_json(&all))?;
    } else {
        tell_coverage(&all)?;
        out::line(format_args!(
            "{}: {} runs, {:.2} simulated hours, {:.0} hours an hour, {} failed, digest {}",
            options.campaign.name(),
            all.digests.len(),
            all.simulated.as_secs_f64() / 3600.0,
            hours_per_hour(all.simulated),
            all.failures.len(),
            all.digest()
        ))?;
    }
    Ok(ExitCode::from(u8::from(!all.failures.is_empty())))
}

fn tell_coverage(all: &Batch) -> anyhow::Result<()> {
    out::text(all.coverage.table())?;
    for (text, count) in all.coverage.first_faults() {
        out::line(format_args!("  {count:>6}  {text}"))?;
    }
    let never = all.coverage.never();
    if !never.is_empty() {
        out::line(format_args!("never met: {}", never.join(", ")))?;
    }
    Ok(())
}

/// Says how a seed failed, and how to see it again.
fn tell_failure(options: &StormOptions, failure: &Failure) -> anyhow::Result<()> {
    if options.json {
        return Ok(());
    }
    let seed = failure.case.seed;
    let outcome = match &failure.outcome {
        Ok(outcome) => outcome,
        Err(why) => {
            out::line(format_args!("FAILED seed {seed}: {why}"))?;
            return Ok(());
        }
    };
    let scene = failure.case.scene.source.path.display();
    for violation in &outcome.violations {
        let at = violation.at.as_secs_f64();
        out::line(format_args!(
            "FAILED seed {seed} ({scene}): {} at {at:.4} s: {}",
            violation.rule, violation.what
        ))?;
    }
    let mut words = options.of_seed(seed).words();
    if !options.plan.is_empty() {
        words.extend(
            options.plan.iter().flat_map(|plan| ["--plan".to_owned(), format!("'{plan}'")]),
        );
    }
    out::line(format_args!("  again: taktil {}", words.join(" ")))?;
    for fault in failure.case.plan.faults() {
        out::line(format_args!("    {fault}"))?;
    }
    Ok(())
}

/// Seeks the least plan with which a failing seed still breaks its first rule, if it is to be
/// sought, and says it.
fn shrunk(options: &StormOptions, failure: &Failure, shrinks: bool) -> anyhow::Result<Case> {
    let first = failure.outcome.as_ref().ok().and_then(|outcome| outcome.violations.first());
    let (Some(first), true) = (first, shrinks) else { return Ok(failure.case.clone()) };
    let (least, runs) = shrink(&failure.case, first.rule);
    let again = options.again(failure.case.seed, &least);
    out::line(format_args!("  least, after {runs} runs: {again}"))?;
    Ok(failure.case.with_plan(least))
}

/// Writes the log of a failing seed, if logs are wanted; one that could not be run leaves none.
fn log_failure(
    options: &StormOptions,
    logs: Option<&LogFolder>,
    failure: &Failure,
    case: &Case,
) -> anyhow::Result<()> {
    let (Some(logs), Ok(_)) = (logs, &failure.outcome) else { return Ok(()) };
    let path = logs.write(case, options.again(case.seed, &case.plan))?;
    if !options.json {
        out::line(format_args!("  log: {}", path.display()))?;
    }
    Ok(())
}
