//! Defines the command line and its exit codes: 0 success, 1 failure, 2 invalid input. The work is
//! done in other modules.

use std::io::{BufReader, BufWriter, IsTerminal};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use taktil_lab_check_task::command::{self as check_task, CheckTaskArgs};
use taktil_lab_experiment::Experiments;
use taktil_lab_host::doctor;
use taktil_lab_host::jitter::{self, JitterArgs};
use taktil_lab_identify::Identify;
use taktil_lab_identify::calibrate::{self, Calibrate};
use taktil_lab_plot::PlotArgs;
use taktil_lab_storm::command::{self as storm, StormArgs};
use taktil_machine::operator::SERVICE_SOCKET;
use taktil_machine::own::{self, OwnTask};
use taktil_machine::source::Located;
use taktil_machine_boards::{self as boards, Driver};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_machine_page::process::{self, DashboardArgs};

use crate::arm::{self, ArmArgs};
use crate::bench::{self, Bench};
use crate::commission::{self, CommissionArgs};
use crate::hal::{self, Hal};
use crate::log::{self, LogCommand};
use crate::new_crate::{self, NewCrateArgs};
use crate::observe::{self, ScopeArgs, WatchArgs};
use crate::pages::{self, CompletionArgs, ManualArgs};
use crate::run::{self, Options, Rehearsal};
use crate::scenes::{self, SceneArgs};
use crate::sim::{self, Sim};
use crate::{diff, keys, postmortem, replay, tell};

/// Exit code for invalid input.
const BAD_INPUT: u8 = 2;

/// Hard real-time robot control with touch: run the stack on a simulated robot, look at what
/// happened, use its mathematics.
#[derive(Parser, Debug)]
#[command(
    name = "taktil",
    version = env!("TAKTIL_VERSION"),
    after_help = "\
Start here:
  taktil run sim/scenes/roll-pin.toml                a PUMA 260 rolls a pin by touch, live, 10 s
  taktil run sim/scenes/roll-pin.toml --fast         in virtual time, repeatable bit for bit
  taktil run sim/scenes/roll-pin.toml --report out   and a page with pictures: out/report.html
  echo '{\"op\":\"fk\",\"q\":[0,0.7,-2.7,-3.1,1.2,3.1]}' | taktil calc

Exit codes: 0 ok, 1 it failed or the answer is no, 2 bad input, 130 ended by a second Ctrl-C;
what else they mean stands in the help of each command."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Run the whole stack on the simulated robot of a scene.
    ///
    /// Live by default: one SCHED_FIFO thread a lane, on the kernel's clock. Where the right to
    /// SCHED_FIFO is missing the run says so, marks every timing figure and goes on. With --fast
    /// all lanes share one thread in virtual time: same values, same digest. Exit code 0: no fault,
    /// also when Ctrl-C ended it; 1: a fault was latched, a task hung, the contract did not hold,
    /// or what was asked for could not be written; 2: bad input.
    Run(Options),
    /// Run a scene in real time without an end, for an operator at a socket.
    ///
    /// The same words and answers as those of the service over boards, on the simulated robot:
    /// `taktil tell`, `taktil move` and `taktil keys` practise there. Ends by Ctrl-C. Exit codes as
    /// those of `run`.
    Rehearse {
        /// Scene file (TOML); see sim/scenes
        scene: PathBuf,
        /// Socket; `taktil-operator.sock` in $XDG_RUNTIME_DIR or in the folder for temporary files
        /// when absent
        #[arg(long, value_name = "SOCKET")]
        at: Option<PathBuf>,
        /// Leave the scene's script out: the machine waits in START, as a service does
        #[arg(long)]
        no_script: bool,
        /// Seed instead of the scene's
        #[arg(long, value_name = "N")]
        seed: Option<u64>,
        /// Write an MCAP log
        #[arg(long, value_name = "F.mcap")]
        log: Option<PathBuf>,
        /// Keep the newest records in this file in memory, for `taktil postmortem`
        #[arg(long, value_name = "FILE")]
        flight: Option<PathBuf>,
        /// Serve the page on the loopback, at this port or at one that is free
        #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "0")]
        page: Option<u16>,
    },
    /// List, print and copy scenes, check scene files without running them; print what may stand in
    /// one.
    Scene(SceneArgs),
    /// Make a crate with a task of one's own: law, ports, tests and a scene that runs it.
    NewTask(NewCrateArgs),
    /// Make a crate with a driver of one's own and its tests.
    NewDriver(NewCrateArgs),
    /// Drive one task of one's own alone, with made-up inputs, and look for what no lane may bear.
    ///
    /// A million steps in virtual time with plausible, extreme, stale, missing and late inputs, and
    /// a thousand starts. What failed is told with the task's inputs and the command that repeats
    /// it. Exit code 0: sound; 1: it is not, or something could not be checked; 2: bad input.
    CheckTask(CheckTaskArgs),
    /// Digests of simulated runs, and the world of a log at any instant.
    #[command(subcommand)]
    Sim(Sim),
    /// Draw a log as SVG figures, or write its signals as CSV.
    ///
    /// Without --what every view that the log allows is made: features, positions, angles,
    /// tracking, torques, truth, arm, image, timing. A signal such as sense.joints, or one of its
    /// fields such as sense.joints.q_rad, is a view too. Exit code 0: drawn; 2: no such log, view
    /// or place.
    Plot {
        /// Log file (MCAP) of a run
        log: PathBuf,
        /// Views or signals, separated by commas
        #[arg(long, value_name = "NAME", value_delimiter = ',')]
        what: Vec<String>,
        /// Tables (t_s and one column a signal) instead of pictures
        #[arg(long)]
        csv: bool,
        /// Folder to write to, `-` for standard output; a folder beside the log when absent
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Compare two logs: the first place where they part, with tick, time, task, field, values.
    ///
    /// Signals are compared message by message and bit for bit. Exit code 0: equal; 1: different,
    /// or equal only as far as a damaged file can be read; 2: not a log.
    Diff {
        /// First log (MCAP)
        a: PathBuf,
        /// Second log
        b: PathBuf,
        /// One JSON object instead of sentences
        #[arg(long)]
        json: bool,
    },
    /// What a flight recorder kept of a process that has ended, however it ended.
    ///
    /// Last jobs and the task that was running, mode, faults, last values. Exit code 0: read; 2: no
    /// flight recording.
    Postmortem {
        /// The recorder's file, or a copy of it
        file: PathBuf,
        /// Write all its records as a log too, for plot and diff
        #[arg(long, value_name = "F.mcap")]
        log: Option<PathBuf>,
        /// Put them behind the messages of this log of the same run
        #[arg(long, value_name = "RUN.mcap")]
        join: Option<PathBuf>,
        /// One JSON object instead of sentences
        #[arg(long)]
        json: bool,
    },
    /// Recordings as files: what is in one, its messages, new ones made of old ones.
    #[command(subcommand)]
    Log(LogCommand),
    /// Run what a log records again, and compare every value, decision and state bit for bit.
    ///
    /// Devices answer from the log, and lanes do what they did then: jobs left out and values that
    /// came late included. Exit code 0: equal; 1: different, with the first place; 2: not a log
    /// that can be replayed, or one that is not whole.
    Replay {
        /// Log file (MCAP) of `taktil run --log` or `taktild --log`
        log: PathBuf,
        /// One JSON object instead of sentences
        #[arg(long)]
        json: bool,
        /// Write the repeated run to this MCAP file
        #[arg(long, value_name = "F.mcap")]
        out: Option<PathBuf>,
    },
    /// Whether this host is fit for real time: what is expected, what was found, what helps.
    ///
    /// Changes nothing. Exit code 0: fine; 1: warnings; 2: not fit for motion.
    Doctor {
        /// One JSON object instead of the table
        #[arg(long)]
        json: bool,
        /// Judge a recorded tree of /proc and /sys instead of this host; nothing is tried
        #[arg(long, value_name = "DIR")]
        root: Option<PathBuf>,
        /// CPUs that the lanes are to use, such as 2,3; without it the isolated ones
        #[arg(long, value_name = "LIST")]
        cpus: Option<String>,
        /// Print a shell script of the remedies instead of the table; it is never run
        #[arg(long, conflicts_with = "json")]
        fix_script: bool,
    },
    /// How late this machine releases jobs: empty lanes on the real executor, beside cyclictest.
    ///
    /// Exit code 0 however late it is; 2: an option that cannot be used, or no cyclictest.
    Jitter(JitterArgs),
    /// Type a move to a running machine: `joint`, `to` or `by`, and numbers.
    ///
    /// The machine is in TRAJECTORY/USER (`taktil tell trajectory_user`). Angles in degrees,
    /// lengths in mm; `to` takes x y z and, if wanted, yaw pitch roll of the downward tool. The
    /// whole move is looked at before it counts; it is joined to one of its kind under way without
    /// a stop. Options behind the numbers: `straight`, `in SECONDS`, `now` (instead of what is
    /// under way). Exit code 0: found good (--wait: done); 1: refused, with joint and time; 2: bad
    /// input.
    Move {
        /// Socket of the run or the service
        #[arg(long, value_name = "SOCKET", default_value = SERVICE_SOCKET)]
        at: PathBuf,
        /// Come back when the moves are done
        #[arg(long)]
        wait: bool,
        /// Such as: by 0 0 20 straight in 2
        #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
    /// Say something to a running machine, in words, or line by line from standard input.
    ///
    /// Words: enable, calibrate, idle, stop and the other verbs of the state machine; move, pause,
    /// resume, clear, wait; state; with --for, jog FRAME A1 .. A6. A script ends at the first line
    /// that is refused. Exit code 0: all granted; 1: something was refused; 2: bad input.
    Tell {
        /// Socket of the run or the service
        #[arg(long, value_name = "SOCKET", default_value = SERVICE_SOCKET)]
        at: PathBuf,
        /// Hold the keys of `jog` for so many seconds, at most 60, then let go
        #[arg(long = "for", value_name = "S", allow_hyphen_values = true)]
        held_s: Option<f64>,
        /// Such as: trajectory_user. None: lines from standard input
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
    /// Signals of a running machine by their names, at a rate, as lines or as a table.
    ///
    /// Without a name every signal is listed. Exit code 0: ended; 1: the machine has gone; 2: no
    /// machine, or no such signal.
    Watch(WatchArgs),
    /// A capture of signals around an event, at their full rate, as an oscilloscope makes it.
    ///
    /// Exit code 0: captured; 1: the event did not come, or the machine has gone; 2: bad input.
    Scope(ScopeArgs),
    /// The page of a running machine, for browsers on this host.
    ///
    /// As the program taktil-dashboard: a page may watch and stop; to command it has to be given
    /// the control token, which lies in a file that is named at start. Exit code 0: ended by a
    /// signal; 2: an option that cannot be used.
    Dashboard(DashboardArgs),
    /// A keyboard or a gamepad as the operator's hand: hold to run, unplug is release.
    ///
    /// Held keys are said to the machine every 10 ms; it lets go when it has not heard them for 40.
    /// A gamepad moves nothing unless its dead-man's switch is held. --list prints the key map.
    /// Exit code 0: ended by Ctrl-C or the end of the input; 1: the last device or the machine has
    /// gone; 2: bad input.
    Keys(keys::KeysArgs),
    /// Boards: what this program can drive, and emulated ones that serve the simulated robot.
    #[command(subcommand)]
    Hal(Hal),
    /// The first power-up of a robot: channels, directions and scales of its joints, at low torque.
    ///
    /// One joint after another is moved, at first by single pulses that no joint follows for more
    /// than a degree before its direction is known; then to its stops and to and fro. What is found
    /// is printed as the section `[joints]` of a machine file, with residuals.
    Commission(CommissionArgs),
    /// The experiments of the thesis over laws and seeds, side by side.
    #[command(subcommand)]
    Experiment(Experiments),
    /// Numbers of the robot from the log of a run.
    #[command(subcommand)]
    Identify(Identify),
    /// Numbers of its sensors from the log of a run.
    #[command(subcommand)]
    Calibrate(Calibrate),
    /// What parts of this program cost, in time and instructions.
    #[command(subcommand)]
    Bench(Bench),
    /// Storms of seeded faults over the whole stack in virtual time, judged by rules of safety.
    ///
    /// Each seed draws a scene, an operator and faults; the production code runs as with `run
    /// --fast`. What failed is told with the command that repeats it, and with the least plan that
    /// still does. Exit code 0: no rule was broken; 1: one was; 2: bad input.
    Storm(StormArgs),
    /// What an arm from a URDF file is taken for, and how its inverse fares on random poses.
    ///
    /// Exit code 1: a closed form missed a pose; 2: the file describes no serial chain.
    Arm(ArmArgs),
    /// The mathematics as a filter: one JSON request a line on stdin, one JSON answer a line on
    /// stdout.
    Calc {
        /// Print every operation with its fields, units and defaults
        #[arg(long)]
        list: bool,
    },
    /// Print what makes a shell complete this command line: bash, zsh, fish and others.
    ///
    /// The Debian package installs those of the first three.
    Completions(CompletionArgs),
    /// Write a manual page for each program and subcommand into a folder, for packages.
    #[command(hide = true)]
    Manual(ManualArgs),
}

/// The definition of the command line: subcommands, options and their help.
#[must_use]
pub fn definition() -> clap::Command {
    Cli::command()
}

/// Runs the command line of this process; `tasks` and `drivers` are wired like those of Taktil
/// itself.
#[must_use]
pub fn main(tasks: &'static [OwnTask], drivers: &'static [Driver]) -> ExitCode {
    if let Err(bad) = own::register(tasks).and_then(|()| boards::register(drivers)) {
        out::warn(bad);
        return ExitCode::from(BAD_INPUT);
    }
    let cli = Cli::parse();
    match dispatch(cli.command) {
        Ok(code) => code,
        Err(error) => complain(&error),
    }
}

fn complain(error: &anyhow::Error) -> ExitCode {
    if let Some(located) = error.downcast_ref::<Located>() {
        out::warn(located);
        return ExitCode::from(BAD_INPUT);
    }
    out::complain(error);
    ExitCode::from(if error.is::<BadOption>() { BAD_INPUT } else { 1 })
}

fn dispatch(command: Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Run(options) => run::run(&options),
        Command::Rehearse { scene, at, no_script, seed, log, flight, page } => {
            let rehearsal = Some(Rehearsal { without_script: no_script });
            let options =
                Options { scene, seed, log, flight, page, rehearsal, ..Options::default() };
            run::rehearse(options, at)
        }
        Command::Scene(arguments) => scenes::run(&arguments),
        Command::NewTask(arguments) => new_crate::new_task(&arguments),
        Command::NewDriver(arguments) => new_crate::new_driver(&arguments),
        Command::CheckTask(arguments) => check_task::run(&arguments),
        Command::Completions(arguments) => pages::print_completions(&arguments, definition()),
        Command::Manual(arguments) => pages::write_manual(&arguments, definition()),
        Command::Sim(what) => sim::run(&what),
        Command::Move { at, wait, words } => {
            let typed = format!("move {}", words.join(" "));
            let lines = [typed, "wait".to_owned()];
            tell::send_lines(&at, lines.into_iter().take(1 + usize::from(wait)))
        }
        Command::Watch(arguments) => observe::watch(&arguments),
        Command::Scope(arguments) => observe::scope(&arguments),
        Command::Dashboard(arguments) => process::run(&arguments),
        Command::Keys(arguments) => keys::run(&arguments),
        Command::Tell { at, held_s, words } => tell::run(&at, held_s, &words.join(" ")),
        Command::Plot { log, what, csv, out } => {
            let arguments = PlotArgs { log, what, csv, out };
            // All errors of this command are about the log, a name or the output path, which are
            // input.
            taktil_lab_plot::run(&arguments, &mut std::io::stdout().lock())
                .map_err(|error| BadOption(format!("{error:#}")))?;
            Ok(ExitCode::SUCCESS)
        }
        Command::Doctor { json, root, cpus, fix_script } => {
            doctor::run(&doctor::Options { json, root, cpus, fix_script })
        }
        Command::Diff { a, b, json } => diff::run(&diff::Options { a, b, json }),
        Command::Postmortem { file, log, join, json } => {
            postmortem::run(&postmortem::Options { file, log, join, json })
        }
        Command::Log(what) => log::run(&what),
        Command::Replay { log, json, out } => replay::run(&replay::Options { log, json, out }),
        Command::Jitter(arguments) => jitter::run(&arguments),
        Command::Hal(what) => hal::run(&what),
        Command::Commission(arguments) => commission::run(&arguments),
        Command::Experiment(what) => taktil_lab_experiment::run(&what),
        Command::Identify(what) => taktil_lab_identify::run(&what),
        Command::Calibrate(what) => calibrate::run(&what),
        Command::Bench(bench) => bench::run(&bench),
        Command::Storm(arguments) => storm::run(&arguments),
        Command::Arm(arguments) => arm::run(&arguments),
        Command::Calc { list: true } => {
            out::text(taktil_lab_calc::list())?;
            Ok(ExitCode::SUCCESS)
        }
        Command::Calc { list: false } => {
            if std::io::stdin().is_terminal() {
                out::warn("one JSON request a line, then Ctrl-D; `taktil calc --list` shows them");
            }
            let mut input = BufReader::new(std::io::stdin().lock());
            let mut output = BufWriter::new(std::io::stdout().lock());
            taktil_lab_calc::filter(&mut input, &mut output).map(|()| ExitCode::SUCCESS)
        }
    }
}
