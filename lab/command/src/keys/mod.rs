//! `taktil keys`: a keyboard or a gamepad as the operator's input. Held keys are sent again every
//! few milliseconds, and the machine stops the motion when they no longer arrive. Any failure on
//! the way (a device disconnect, this program killed, a socket that stalls) therefore ends the
//! motion.

pub mod device;
pub mod events;
pub mod input_state;
pub mod map;
mod terminal;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::bail;
use taktil_machine::operator::SERVICE_SOCKET;
use taktil_machine::source::{FileKind, Source};
use taktil_machine_console::out;
use taktil_machine_console::signals::{self, StopRequest};
use taktil_rtcore::linux;

use crate::tell::OperatorConnection;
use device::{Input, PollOutcome};
use input_state::InputState;
use map::{DEFAULT_MAP, Map, MapFile};
use taktil_machine_console::option::BadOption;
use terminal::Terminal;

/// Period in which the devices are polled and held keys are sent: a quarter of the jog's default
/// dead-man's time.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// The arguments of the command line.
#[derive(Clone, Debug, clap::Args)]
pub struct KeysArgs {
    /// Socket of the run or the service
    #[arg(long, value_name = "SOCKET", default_value = SERVICE_SOCKET)]
    at: PathBuf,
    /// Event device, or a named pipe that gives such events; may be said again. Without it, every
    /// one that has keys of the map
    #[arg(long, value_name = "/dev/input/eventN")]
    device: Vec<PathBuf>,
    /// Characters from standard input instead: each counts as held for 0.15 s
    #[arg(long, conflicts_with = "device")]
    stdin: bool,
    /// Key map instead of the default one
    #[arg(long, value_name = "F.toml")]
    map: Option<PathBuf>,
    /// Print the default key map and end
    #[arg(long)]
    list: bool,
}

/// Reads keys until the devices or the machine are gone or a stop is requested.
///
/// # Errors
/// [`BadOption`] for what cannot be used; a lost connection to the machine.
pub fn run(arguments: &KeysArgs) -> anyhow::Result<ExitCode> {
    if arguments.list {
        out::text(DEFAULT_MAP)?;
        return Ok(ExitCode::SUCCESS);
    }
    let map = read_map(arguments.map.as_deref())?;
    let mut line = OperatorConnection::connect(&arguments.at)?;
    let stop = signals::stop_request()?;
    let mut input_state = InputState::new(map.clone());
    if arguments.stdin {
        let terminal = Terminal::open()?;
        return run_terminal(&mut line, &mut input_state, &terminal, &stop);
    }
    let inputs = open(&arguments.device, &map)?;
    for (number, input) in inputs.iter().enumerate() {
        out::line(input.path.display())?;
        input_state.connect(number, |code| input.has(code));
    }
    run_devices(&mut line, &mut input_state, inputs, &stop)
}

fn read_map(path: Option<&Path>) -> anyhow::Result<Map> {
    let Some(path) = path else {
        let file: MapFile = toml::from_str(DEFAULT_MAP)?;
        return file.check().map_err(|bad| anyhow::anyhow!("{}: {}", bad.place, bad.what));
    };
    let source = Source::read(path, FileKind::Keys)?;
    let file: MapFile = source.parse()?;
    Ok(file.check().map_err(|bad| source.locate(bad))?)
}

fn open(paths: &[PathBuf], map: &Map) -> anyhow::Result<Vec<Input>> {
    let mut inputs = Vec::new();
    for path in paths {
        let input = Input::open(path, map);
        let shown = path.display();
        inputs.push(input.map_err(|error| BadOption(format!("--device {shown}: {error}")))?);
    }
    if !paths.is_empty() {
        return Ok(inputs);
    }
    let folder = Path::new("/dev/input");
    let (found, others) = device::open_all(folder, map);
    if found.is_empty() {
        let why = if folder.is_dir() {
            format!("no event device can be used: {}", others.join("; "))
        } else {
            "this host has no /dev/input".to_owned()
        };
        bail!(BadOption(format!("{why}; name one with --device, or type with --stdin")));
    }
    Ok(found)
}

/// Polls the event devices and sends their commands until a stop is requested.
fn run_devices(
    line: &mut OperatorConnection,
    input_state: &mut InputState,
    inputs: Vec<Input>,
    stop: &StopRequest,
) -> anyhow::Result<ExitCode> {
    let mut inputs: Vec<(usize, Input)> = inputs.into_iter().enumerate().collect();
    let mut sender = CommandSender::default();
    while !stop.is_set() {
        let mut said = Vec::new();
        inputs.retain_mut(|(number, input)| {
            match input.poll(*number, input_state, linux::monotonic()) {
                PollOutcome::Present(words) => {
                    said.extend(words);
                    true
                }
                PollOutcome::Gone => {
                    input_state.disconnect(*number);
                    out::warn(format_args!(
                        "{} is gone: its keys are released",
                        input.path.display()
                    ));
                    false
                }
            }
        });
        sender.send(line, input_state, &said)?;
        if inputs.is_empty() {
            out::warn("error: no device is left");
            return Ok(ExitCode::from(1));
        }
        std::thread::sleep(POLL_INTERVAL);
    }
    Ok(ExitCode::SUCCESS)
}

/// Reads characters from the terminal and sends their commands.
fn run_terminal(
    line: &mut OperatorConnection,
    input_state: &mut InputState,
    terminal: &Terminal,
    stop: &StopRequest,
) -> anyhow::Result<ExitCode> {
    input_state.connect(0, |_| false);
    let mut sender = CommandSender::default();
    let mut presses = terminal::TimedPresses::default();
    while !stop.is_set() {
        let characters = terminal.characters();
        let said = presses.take(characters.as_deref().unwrap_or_default(), input_state);
        sender.send(line, input_state, &said)?;
        if characters.is_none() && !presses.is_any_held() {
            break;
        }
        std::thread::sleep(POLL_INTERVAL);
    }
    Ok(ExitCode::SUCCESS)
}

/// Sends the state of the keys to the machine.
#[derive(Default)]
struct CommandSender {
    pushing: bool,
    /// The last answer to a jog command.
    last_answer: String,
}

impl CommandSender {
    /// Sends the commands of pressed keys, then the deflection of the held keys.
    fn send(
        &mut self,
        line: &mut OperatorConnection,
        input_state: &InputState,
        said: &[String],
    ) -> anyhow::Result<()> {
        for words in said {
            let answer = exchange(line, words)?;
            out::line(format_args!("{words}: {answer}\r"))?;
        }
        match input_state.deflection() {
            Some((axes, frame)) => {
                let axes: Vec<String> = axes.iter().map(|axis| format!("{axis:.4}")).collect();
                let words = format!("jog {} {}", frame.name(), axes.join(" "));
                let answer = exchange(line, &words)?;
                // The reason why the arm does not move is printed once.
                if answer != "ok" && answer != self.last_answer {
                    out::line(format_args!("{answer}\r"))?;
                }
                (self.pushing, self.last_answer) = (true, answer);
            }
            None if self.pushing => {
                exchange(line, "release")?;
                (self.pushing, self.last_answer) = (false, String::new());
            }
            None => {}
        }
        Ok(())
    }
}

fn exchange(line: &mut OperatorConnection, words: &str) -> anyhow::Result<String> {
    line.send(words)?;
    line.answer()
}
