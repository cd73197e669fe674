//! `taktil run`: runs the whole stack on the simulated robot, live on `SCHED_FIFO` threads or in
//! virtual time, and prints the result.

mod page;
pub mod plan;
mod progress;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::bail;
use clap::Args;
use serde_json::json;
use taktil_machine::operator::OperatorReceiver;
use taktil_machine::operator::command::CommandContext;
use taktil_machine::wiring::OperatorBuilder;
use taktil_machine_console::out;
use taktil_machine_console::signals::{self, SecondSignal};
use taktil_machine_operator::{OperatorConfig, OperatorServer, ServerSetup};
use taktil_record::flight::FlightRecorderWriter;
use taktil_rtcore::live::{
    self, Attestation, Contract, Hang, Pace, RunObserver, RunOptions, RunReport,
};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{Invalid, Machine, Nanos, linux, virtual_time};

use progress::Progress;
use taktil_lab_report::closing_table;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::operator::Operator;
use taktil_lab_scene::scene::{self, Scene};
use taktil_lab_scene::score::Score;
use taktil_lab_scene::summary::FinishedRun;
use taktil_lab_scene::{RECORDED_FILE_PREFIX, targets};
use taktil_machine_console::option::{self, BadOption};
use taktil_record::digest::Digest;
use taktil_record::granted::Grants;
use taktil_record::summary::{SUMMARY_KEY, Summary};
use taktil_record::{Log, METADATA_ATTESTATION, McapLog};

/// The arguments of the command line.
#[derive(Args, Clone, Debug, Default)]
pub struct Options {
    /// Scene file (TOML); see sim/scenes
    pub scene: PathBuf,
    /// Virtual time: as fast as the processor allows, repeatable bit for bit
    #[arg(long)]
    pub fast: bool,
    /// Seed of all noise, instead of the scene's
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Simulated seconds, instead of the scene's
    #[arg(long = "for", value_name = "S", allow_negative_numbers = true)]
    pub for_s: Option<f64>,
    /// Record every port value to this MCAP file
    #[arg(long, value_name = "F.mcap")]
    pub log: Option<PathBuf>,
    /// Write report.html with figures into this folder (and run.mcap unless --log says where)
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Keep the newest ten seconds of every lane in this file in memory (/dev/shm, /run)
    #[arg(long, value_name = "FILE")]
    pub flight: Option<PathBuf>,
    /// Listen to an operator at this Unix-domain socket: `taktil tell`, `taktil move`
    #[arg(long, value_name = "SOCKET")]
    pub operator: Option<PathBuf>,
    /// Serve the page of the run on the loopback, at this port or at one that is free; the run
    /// begins when a browser has opened it
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "0")]
    pub page: Option<u16>,
    /// One JSON object on standard output instead of the table
    #[arg(long)]
    pub json: bool,
    /// Do not run: print when each lane is released and whether it can meet its deadline
    #[arg(long)]
    pub plan: bool,
    /// Run until a signal ends it, instead of for the scene's time.
    #[arg(skip)]
    pub rehearsal: Option<Rehearsal>,
}

/// A run without an end, for an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rehearsal {
    /// Leave the scene's script out.
    pub without_script: bool,
}

/// The socket of a rehearsal for which none is named.
fn rehearsal_socket() -> PathBuf {
    let folder = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let folder = folder.filter(|folder| folder.is_dir()).unwrap_or_else(std::env::temp_dir);
    folder.join("taktil-operator.sock")
}

/// Runs a scene until a signal ends it, and listens to an operator at `socket` or at a default
/// place.
///
/// # Errors
/// As [`run`].
pub fn rehearse(options: Options, socket: Option<PathBuf>) -> anyhow::Result<ExitCode> {
    let operator = Some(socket.unwrap_or_else(rehearsal_socket));
    run(&Options { operator, ..options })
}

/// All observers of a run.
struct RunWatcher {
    digest: Digest,
    score: Score,
    log: Option<McapLog>,
    flight_recorder: Option<FlightRecorderWriter>,
    server: Option<OperatorServer>,
    progress: Progress,
    now: Nanos,
    /// Time of the kernel's monotonic clock at the log's zero, as computed first and last.
    zero: Option<(Nanos, Nanos)>,
}

impl RunWatcher {
    /// The run is over.
    fn finish(&mut self) {
        self.progress.finish();
        self.score.finish();
    }

    fn has_operator_intervened(&self) -> bool {
        self.server.as_ref().is_some_and(OperatorServer::has_intervened)
    }
}

impl RunObserver for RunWatcher {
    fn on_attestation(&mut self, attestation: &Attestation) {
        if let Some(flight_recorder) = &mut self.flight_recorder {
            flight_recorder.write_attestation(attestation);
        }
        if let Some(log) = &mut self.log {
            log.write_metadata(
                METADATA_ATTESTATION,
                &Grants::new(Some(attestation)).to_json().to_string(),
            );
        }
        if let Some(server) = &self.server {
            server.set_attestation(Grants::new(Some(attestation)).to_json());
        }
        if !attestation.is_granted() {
            let missing = attestation.missing.join("; ");
            out::warn(format_args!(
                "not real time: {missing}; timing figures are marked, the simulated robot runs"
            ));
        }
    }

    fn on_time(&mut self, now: Nanos) {
        let zero = linux::monotonic() - now;
        self.zero = Some((self.zero.map_or(zero, |(first, _)| first), zero));
        self.now = now;
        if let Some(flight_recorder) = &mut self.flight_recorder {
            flight_recorder.write_wall_time(now);
        }
        if let Some(log) = &mut self.log {
            log.close_due_chunk(now);
        }
        if let Some(server) = &self.server {
            server.set_time(now);
        }
    }

    fn on_hang(&mut self, hang: &Hang) {
        self.progress.finish();
        out::warn(format_args!("error: {hang}; the run is over, outputs are safe"));
        if let Err(error) = close_hung(self.log.take(), hang) {
            out::warn(format_args!("error: {error:#}"));
        }
        // A thread that hangs cannot be joined.
        std::process::exit(1);
    }
}

/// Closes the log of a run with a hanging task, with a description of the hang.
///
/// # Errors
/// As [`McapLog::finish`].
pub fn close_hung(log: Option<McapLog>, hang: &Hang) -> anyhow::Result<()> {
    let Some(log) = log else { return Ok(()) };
    log.finish_with(&BTreeMap::from([("hung".to_owned(), hang.to_string())]))
}

impl Observer for RunWatcher {
    fn record(&mut self, record: &Record<'_>) {
        if let Some(flight_recorder) = &mut self.flight_recorder {
            flight_recorder.publish();
        }
        self.digest.record(record);
        self.score.record(record);
        if let Some(log) = &mut self.log {
            log.record(record);
        }
        if let Some(server) = &mut self.server {
            server.record(record);
        }
        self.progress.record(record);
    }
}

/// Runs a scene and prints the result; the exit code is 0 without faults, 1 with one.
///
/// # Errors
/// Bad input as [`Located`](taktil_machine::source::Located) or [`BadOption`]; anything else is a
/// failure of the run.
pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    run_operated(options, |scene| {
        let (endpoint, receiver) = operator_endpoint(options, scene)?;
        let is_unscripted = options.rehearsal.is_some_and(|rehearsal| rehearsal.without_script);
        let script = if is_unscripted { Vec::new() } else { scene.script.clone() };
        let operator: OperatorBuilder<'static> =
            Box::new(move |ports| Ok(Box::new(Operator::with(script, receiver, ports)?)));
        Ok((operator, endpoint))
    })
}

/// Like [`run`], with the given operator's task.
///
/// # Errors
/// As [`run`].
pub fn run_with(
    options: &Options,
    operator: impl FnOnce(&Scene) -> OperatorBuilder<'static>,
) -> anyhow::Result<ExitCode> {
    run_operated(options, |scene| Ok((operator(scene), None)))
}

/// Where an operator is listened to, and with what.
type Endpoint = (OperatorConfig, ServerSetup);

/// The builder of the operator's task, and where an operator is listened to, if one is.
type OperatorAndEndpoint = (OperatorBuilder<'static>, Option<Endpoint>);

/// Longest run without an end: ten years.
const ENDLESS_DURATION: Nanos = Nanos::from_secs(10 * 365 * 86_400);

/// Runs a scene with the given operator's task, and with the operator's server if there is one.
fn run_operated(
    options: &Options,
    operator: impl FnOnce(&Scene) -> anyhow::Result<OperatorAndEndpoint>,
) -> anyhow::Result<ExitCode> {
    let scene = Scene::load(&options.scene)?;
    scene.arm_remarks.iter().for_each(|remark| out::warn(format_args!("the arm: {remark}")));
    let seed = options.seed.unwrap_or(scene.seed);
    let until = end_of_run(options, &scene)?;
    if options.plan {
        let machine = Assembly::new(&scene).with_seed(seed).build()?;
        out::text(if options.json { plan::json(&machine) } else { plan::text(&machine) })?;
        return Ok(ExitCode::SUCCESS);
    }
    // Before the first thread: one that does not block the signals would be ended by them.
    let stop = signals::watch(SecondSignal::Exits)?;
    let (operator, endpoint) = operator(&scene)?;
    let mut machine = Assembly::new(&scene).with_seed(seed).with_operator(operator).build()?;
    let socket = endpoint.as_ref().map(|(config, _)| config.socket.clone());
    let server = endpoint.map(|endpoint| listen(endpoint, &mut machine)).transpose()?;
    let mut page = page::start(options.page, socket.as_deref())?;
    let log_path = log_path(options, &scene)?;
    let targets = targets(&scene);
    let force_set_point_n = targets.m0 / targets.counts_per_n;
    let catalog = machine.catalog().clone();
    let log = log_path.as_ref().map(|path| {
        let log = McapLog::create(path, &catalog, &metadata(&scene, seed, options));
        log.map_err(|error| BadOption(format!("{error:#}")))
    });
    let mut watch = RunWatcher {
        digest: Digest::new(&catalog),
        score: Score::new(&catalog, targets, scene.robot.clone()),
        log: log.transpose()?,
        flight_recorder: start_flight_recorder(&mut machine, &scene, options)?,
        server,
        progress: Progress::new(&catalog, until, options.json || options.rehearsal.is_some()),
        now: Nanos::ZERO,
        zero: None,
    };
    page::wait_for_browser(page.as_mut().filter(|_| options.rehearsal.is_none()), &stop);
    let begin = linux::monotonic();
    let (reached, account) =
        execute(&mut machine, (options.fast, scene.contract.contract()), until, &stop, &mut watch)?;
    let wall = linux::monotonic() - begin;
    watch.finish();
    let replay = watch.has_operator_intervened().then(|| replay_command(log_path.as_deref()));
    let run = FinishedRun {
        scene: options.scene.display().to_string(),
        title: &scene.title,
        seed,
        account: account.as_ref(),
        sim_s: reached.as_secs_f64(),
        wall_s: wall.as_secs_f64(),
        digest: watch.digest.hex(),
        figures: &watch.score.figures,
        force_set_point_n,
        lanes: machine.figures().collect(),
        panics: machine.panics().collect(),
        log: log_path.as_ref().map(|path| path.display().to_string()),
        interrupted: stop.load(Ordering::SeqCst),
        repeat: replay.unwrap_or_else(|| repeat_command(options, seed, until, &scene)),
    };
    let summary = run.summary();
    let closed =
        watch.log.take().map_or(Ok(()), |log| log.finish_with(&end_metadata(&summary, watch.zero)));
    // When the log cannot be closed, for example on a full disk, the table is still printed.
    finish(options, log_path.as_deref(), &summary)?;
    closed?;
    Ok(if summary.ok { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// When a run ends by itself.
fn end_of_run(options: &Options, scene: &Scene) -> anyhow::Result<Nanos> {
    match options.for_s {
        None if options.rehearsal.is_some() => Ok(ENDLESS_DURATION),
        None => Ok(scene.duration),
        Some(seconds) => Ok(scene::duration(seconds, "--for")
            .map_err(|bad| BadOption(format!("--for {seconds}: {}; {}", bad.what, bad.remedy)))?),
    }
}

/// The final metadata of a log: the summary, and for a live run the relation of its times to the
/// kernel's monotonic clock (CLOCK_MONOTONIC), within some us: the clock at the log's zero, and the
/// delay that a late simulation has added since.
fn end_metadata(summary: &Summary, zero: Option<(Nanos, Nanos)>) -> BTreeMap<String, String> {
    let clock = zero.map(|(first, newest)| {
        let clock = json!({ "monotonic_ns": first.0, "slipped_ns": (newest - first).0 });
        ("clock".to_owned(), clock.to_string())
    });
    [(SUMMARY_KEY.to_owned(), summary.to_json().to_string())].into_iter().chain(clock).collect()
}

/// Where an operator is listened to: at the socket that `--operator` names, or at one for the page.
fn operator_endpoint(
    options: &Options,
    scene: &Scene,
) -> anyhow::Result<(Option<Endpoint>, Option<OperatorReceiver>)> {
    let own = options.page.map(|_| page::run_socket());
    let Some(path) = options.operator.clone().or(own) else { return Ok((None, None)) };
    if options.fast {
        let what = "--operator, --page: virtual time does not wait for people; leave --fast out";
        bail!(BadOption(what.into()));
    }
    let (sender, receiver) = taktil_machine::operator::channel();
    let trajectory = scene.machine.trajectory.clone().unwrap_or_default();
    let setup = ServerSetup {
        sender,
        context: CommandContext { trajectory, robot: scene.robot.clone() },
        about: json!({
            "simulated": true,
            "scene": options.scene,
            "title": scene.title,
            "world": page::surroundings(scene),
        }),
        recording: None,
    };
    Ok((Some((OperatorConfig::at(path), setup)), Some(receiver)))
}

/// Listens to an operator.
fn listen((config, setup): Endpoint, machine: &mut Machine) -> anyhow::Result<OperatorServer> {
    let shown = config.socket.display();
    let server = OperatorServer::start(&config, setup, machine)
        .map_err(|bad| BadOption(format!("--operator: {}; {}", bad.what, bad.remedy)))?;
    out::warn(format_args!("an operator is listened to: taktil tell --at {shown} ..."));
    Ok(server)
}

/// Starts the flight recorder in the file that `--flight` names.
fn start_flight_recorder(
    machine: &mut Machine,
    scene: &Scene,
    options: &Options,
) -> anyhow::Result<Option<FlightRecorderWriter>> {
    let Some(path) = &options.flight else { return Ok(None) };
    let texts = [("scene_text", &*scene.source.text), ("machine_text", scene.machine_text())];
    let started = FlightRecorderWriter::start(
        machine,
        path,
        taktil_record::flight::DURATION_DEFAULT_S,
        &texts,
    );
    let bad = |bad: Invalid| BadOption(format!("--flight: {}; {}", bad.what, bad.remedy));
    Ok(Some(started.map_err(bad)?))
}

fn execute(
    machine: &mut Machine,
    (fast, contract): (bool, Contract),
    until: Nanos,
    stop: &AtomicBool,
    watch: &mut RunWatcher,
) -> anyhow::Result<(Nanos, Option<RunReport>)> {
    if fast {
        let reached = virtual_time::run(machine, until, stop, watch).map_err(|(task, fault)| {
            anyhow::anyhow!("task `{task}` refused to start: {}", fault.text())
        })?;
        return Ok((reached, None));
    }
    let terms = RunOptions { until, contract, pace: Pace::Slip };
    let account = live::run(machine, terms, stop, watch)?;
    Ok((watch.now.min(until), Some(account)))
}

/// Prints the result, then writes the report, because the report may fail.
fn finish(options: &Options, log: Option<&Path>, summary: &Summary) -> anyhow::Result<()> {
    let next = match (&options.report, log) {
        (Some(folder), _) => format!("report                     {}/report.html", folder.display()),
        (None, Some(log)) => format!("next                       taktil plot {}", log.display()),
        (None, None) => "next                       add --report out to see it drawn".to_owned(),
    };
    let told = if options.json {
        out::line(summary.to_json())
    } else {
        out::text(format_args!("{}  {next}\n", closing_table::text(summary)))
    };
    if let (Some(folder), Some(log)) = (&options.report, log) {
        taktil_lab_report::write(folder, &Log::open(log)?, summary)?;
    }
    told.map(drop)
}

/// The path of the log. A report needs a log: without `--log` it lies beside the report. Paths that
/// cannot be written, and paths of the run's own input, are errors before anything is written.
fn log_path(options: &Options, scene: &Scene) -> anyhow::Result<Option<PathBuf>> {
    if let Some(folder) = &options.report {
        if folder.exists() && !folder.is_dir() {
            bail!(BadOption(format!("--report {}: is a file; name a folder", folder.display())));
        }
        option::create_folder("--report", folder)?;
    }
    let beside = options.report.as_ref().map(|folder| folder.join("run.mcap"));
    let path = options.log.clone().or(beside);
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    if let Some(log) = path.as_deref().and_then(real)
        && scene.files().any(|file| real(file).as_ref() == Some(&log))
    {
        bail!(BadOption(format!("{} is what this run reads; name another log", log.display())));
    }
    Ok(path)
}

fn metadata(scene: &Scene, seed: u64, options: &Options) -> BTreeMap<String, String> {
    let recorded =
        scene.recorded().map(|(name, text)| (format!("{RECORDED_FILE_PREFIX}{name}"), text.into()));
    let about = BTreeMap::from([
        ("scene".to_owned(), options.scene.display().to_string()),
        ("scene_text".to_owned(), scene.source.text.clone()),
        ("machine_text".to_owned(), scene.machine_text().to_owned()),
        ("seed".to_owned(), seed.to_string()),
        ("mode".to_owned(), if options.fast { "fast" } else { "live" }.to_owned()),
        ("taktil".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
    ]);
    about.into_iter().chain(recorded).collect()
}

/// What repeats a run into which an operator has spoken: only its log has the words.
fn replay_command(log: Option<&Path>) -> String {
    match log {
        Some(log) => format!("taktil replay {}", log.display()),
        None => "no command: an operator intervened, and there is no log (--log)".to_owned(),
    }
}

/// A span in seconds as people write it: of all numbers that stand for it the shortest.
fn decimal_seconds(span: Nanos) -> f64 {
    span.0 as f64 / 1e9
}

fn repeat_command(options: &Options, seed: u64, until: Nanos, scene: &Scene) -> String {
    if options.rehearsal.is_some() {
        return format!("taktil rehearse {} --seed {seed}", options.scene.display());
    }
    let mut words = format!("taktil run {} --seed {seed}", options.scene.display());
    if until != scene.duration {
        words += &format!(" --for {}", decimal_seconds(until));
    }
    if options.fast {
        words += " --fast";
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_written_as_they_were_given() {
        for text in ["0.1", "0.3", "0.6", "0.7", "1.1", "2.3", "86399.999999999"] {
            let span = scene::duration(text.parse().unwrap(), "--for").unwrap();
            assert_eq!(decimal_seconds(span).to_string(), text);
        }
    }
}
