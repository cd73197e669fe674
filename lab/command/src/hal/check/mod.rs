//! `taktil hal check`: opens the boards of a configuration with the production drivers, runs cycles
//! over their halves and judges what is seen against what the drivers promise. Drives stay off, and
//! analog outputs at their safe values, unless the options say otherwise.

mod array;
mod bench;
mod findings;
mod judge;
mod loopback;
mod spread;
mod turn;
mod watchdog;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use serde_json::{Value, json};
use taktil_hal::{Clock, Nanos};
use taktil_machine::config::MachineConfig;
use taktil_machine_boards::RunningThread;
use taktil_machine_console::option::{BadOption, create_folder};
use taktil_machine_console::{out, signals};
use taktil_machine_service::boards::{OpenBoards, open_boards};
use taktil_rtcore::linux::MonotonicClock;

use bench::Bench;
use findings::{Findings, Outcome};
use judge::{Allowances, Picture};
use loopback::Wire;
use turn::Turn;

/// Cycles before anything is recorded: caches, first requests, filters of links.
const SETTLING_CYCLES: usize = 20;
/// Period where the machine has no lane (us).
const PERIOD_DEFAULT_US: u32 = 2_500;

/// What is checked.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  taktil hal check machine.toml                       times, errors, noise, arrays; drives off
  taktil hal check machine.toml --loopback 5=0        and a wire from output 5 into input 0
  taktil hal check machine.toml --turn 2 --turn 3-    and joints turned by hand, as it asks for
  taktil hal check /etc/taktil/taktild.toml --watchdog

With --drive the drives are enabled and the brakes lifted, at zero torque, for --loopback, --turn
and --watchdog: somebody has to hold the arm. Outputs named by --loopback are moved through --share
of their range, drives off or on.

Exit codes: 0 good, 1 something is out of its promise, 2 a configuration or option that cannot be
used.")]
pub struct CheckArgs {
    /// A service's configuration, or a machine file with [device.NAME]
    config: PathBuf,
    /// Seconds that are recorded
    #[arg(long = "for", value_name = "S", default_value_t = 5.0)]
    for_s: f64,
    /// Period of the cycles, us; the shortest of the machine's lanes when absent
    #[arg(long, value_name = "US")]
    period_us: Option<u32>,
    /// What a call may last beyond its declared wait, us: own work and wake-ups of this host
    #[arg(long, value_name = "US", default_value_t = 500)]
    slack_us: u32,
    /// Share of exchanges and frames that may be lost
    #[arg(long, value_name = "SHARE", default_value_t = 0.01)]
    loss_max: f64,
    /// Seconds that arrays have for their first frame
    #[arg(long, value_name = "S", default_value_t = 15.0)]
    start_s: f64,
    /// A wire from an analog output to an analog input, channels from 0; can be given several times
    #[arg(long, value_name = "OUT=IN")]
    loopback: Vec<Wire>,
    /// Share of an output's range through which --loopback moves it
    #[arg(long, value_name = "SHARE", default_value_t = 0.9)]
    share: f64,
    /// A joint, from 1, that is turned by hand in its positive direction; 3- for the other one
    #[arg(long, value_name = "JOINT", allow_hyphen_values = true)]
    turn: Vec<Turn>,
    /// Seconds for each joint
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    turn_s: f64,
    /// Stop feeding the outputs and see the board take them off
    #[arg(long)]
    watchdog: bool,
    /// Enable the drives and lift the brakes, at zero torque, for what follows the recording
    #[arg(long)]
    drive: bool,
    /// Folder for report.txt, report.json and the pictures
    #[arg(long, value_name = "DIR", default_value = "hal-check")]
    out: PathBuf,
    /// One JSON object instead of text
    #[arg(long)]
    json: bool,
}

/// Checks the boards.
///
/// # Errors
/// An error in the configuration, located; [`BadOption`] for an option that cannot be used; a
/// report that cannot be written.
pub fn run(arguments: &CheckArgs) -> anyhow::Result<ExitCode> {
    check_options(arguments)?;
    let OpenBoards { config, opened, .. } = open_boards(&arguments.config)?;
    let period = period(arguments, &config)?;
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    clock.sleep_until(Nanos::ZERO);
    opened.epoch.set(clock.origin());
    let mut findings = Findings::default();
    report_threads(&opened.threads, &mut findings);
    let mut bench = Bench::new(opened.devices, &clock, period);
    for wire in &arguments.loopback {
        if let Some(missing) = loopback::missing_end(*wire, &bench) {
            return Err(BadOption(missing).into());
        }
    }
    for joint in &arguments.turn {
        if let Some(missing) = turn::missing_joint(*joint, &bench) {
            return Err(BadOption(missing).into());
        }
    }
    create_folder("--out", &arguments.out)?;
    let mut pictures = Vec::new();
    let stopped = exercise(arguments, &mut bench, &mut findings, &mut pictures);
    bench.orders = bench::Orders { codes: bench.safe_codes(), ..bench::Orders::default() };
    let safe = bench.safe();
    let stopped = stopped?;
    findings.add(
        "outputs",
        Outcome::of(safe.is_ok()),
        safe.map_or_else(|error| error.to_string(), |()| "left at their safe values".to_owned()),
        "switch the cabinet off: the board did not take its safe values",
    );
    if stopped {
        let text = "ended by Ctrl-C: what was seen until then is judged";
        findings.add("check", Outcome::Noted, text, "");
    }
    let served = &opened.served;
    deliver(
        arguments,
        &findings,
        &pictures,
        &json!({ "served": served, "period_us": period.0 / 1_000 }),
    )?;
    Ok(if findings.is_good() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn check_options(arguments: &CheckArgs) -> Result<(), BadOption> {
    let within = |option: &str, value: f64, low: f64, high: f64| {
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(BadOption(format!("{option} {value}: give {low} to {high}")))
    };
    within("--for", arguments.for_s, 0.1, 86_400.0)?;
    within("--turn-s", arguments.turn_s, 0.1, 3_600.0)?;
    within("--start-s", arguments.start_s, 0.0, 3_600.0)?;
    within("--loss-max", arguments.loss_max, 0.0, 1.0)?;
    within("--share", arguments.share, 0.01, 1.0)
}

/// The period of the fastest lane, unless an option gives it.
fn period(arguments: &CheckArgs, config: &MachineConfig) -> Result<Nanos, BadOption> {
    let fastest = config.lane.values().map(|lane| lane.period_us).filter(|us| *us > 0).min();
    let us = arguments.period_us.map(i64::from).or(fastest);
    let us = us.unwrap_or(i64::from(PERIOD_DEFAULT_US));
    if (100..=1_000_000).contains(&us) {
        return Ok(Nanos::from_micros(us));
    }
    Err(BadOption(format!("--period-us {us}: give 100 to 1000000")))
}

fn report_threads(threads: &[RunningThread], findings: &mut Findings) {
    for thread in threads {
        if let Some(missing) = &thread.missing {
            findings.add(
                format!("thread {}", thread.device),
                Outcome::Noted,
                missing.text.clone(),
                "",
            );
        }
    }
}

fn seconds(seconds: f64) -> Nanos {
    #[expect(clippy::cast_possible_truncation, reason = "options are at most a day")]
    let nanos = (seconds * 1e9) as i64;
    Nanos(nanos)
}

/// Runs all cycles; whether Ctrl-C ended them.
fn exercise(
    arguments: &CheckArgs,
    bench: &mut Bench<'_>,
    findings: &mut Findings,
    pictures: &mut Vec<Picture>,
) -> anyhow::Result<bool> {
    let stop = signals::stop_request()?;
    let patience = bench.release + seconds(arguments.start_s);
    while !bench.has_all_frames() && bench.release < patience && !stop.is_set() {
        bench.cycle();
    }
    for _ in 0..SETTLING_CYCLES {
        bench.cycle();
    }
    let end = bench.release + seconds(arguments.for_s);
    bench.records = true;
    while bench.release < end && !stop.is_set() {
        bench.cycle();
    }
    bench.records = false;
    let slack = Nanos::from_micros(i64::from(arguments.slack_us));
    let allowed = Allowances { slack, loss_max: arguments.loss_max };
    judge::judge(bench, allowed, findings, pictures);
    pictures.extend(judge::rest_levels(bench));
    bench.orders.enable = arguments.drive;
    bench.orders.brake_release = arguments.drive;
    for wire in &arguments.loopback {
        if !stop.is_set() {
            loopback::check(*wire, arguments.share, bench, findings, pictures);
        }
    }
    for joint in &arguments.turn {
        if !stop.is_set() {
            turn::check(*joint, seconds(arguments.turn_s), bench, findings);
        }
    }
    if arguments.watchdog && !stop.is_set() {
        let wire = arguments.loopback.first().copied();
        watchdog::check(wire, arguments.share, bench, findings);
    }
    Ok(stop.is_set())
}

/// Prints the report and writes it with the pictures.
fn deliver(
    arguments: &CheckArgs,
    findings: &Findings,
    pictures: &[Picture],
    about: &Value,
) -> anyhow::Result<()> {
    let folder = &arguments.out;
    let mut names: Vec<String> = Vec::new();
    for (name, figure) in pictures {
        let name = format!("{name}.svg");
        write(folder, &name, &figure.svg_document())?;
        names.push(name);
    }
    let mut report = findings.as_json();
    report["about"] = about.clone();
    report["config"] = arguments.config.display().to_string().into();
    report["pictures"] = names.into();
    let text = findings.text();
    write(folder, "report.txt", &text)?;
    write(folder, "report.json", &format!("{report:#}\n"))?;
    if arguments.json {
        out::text(format_args!("{report:#}\n"))?;
        return Ok(());
    }
    out::text(&text)?;
    out::line(format_args!("report and pictures: {}", folder.display()))?;
    Ok(())
}

fn write(folder: &Path, name: &str, text: &str) -> anyhow::Result<()> {
    let path = folder.join(name);
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
}
