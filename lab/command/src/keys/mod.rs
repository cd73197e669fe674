//! `taktil keys`: a keyboard or a gamepad as the operator's hand. Held keys are said again every
//! few milliseconds, so that whatever goes wrong on the way (a device pulled, this program killed,
//! a socket that stalls) ends the motion: silence is release. Refuses to guess that a key is still
//! held.

pub mod device;
pub mod events;
pub mod hand;
pub mod map;
mod terminal;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::bail;
use taktil_machine::operator::socket::SERVICE_SOCKET;
use taktil_machine::source::{FileKind, Source};
use taktil_machine_console::out;
use taktil_machine_console::signals::{self, StopRequest};
use taktil_rtcore::linux;

use crate::tell::Line;
use device::{Input, Looked};
use hand::Hand;
use map::{DEFAULT, Map, MapFile};
use taktil_machine_console::option::BadOption;
use terminal::Terminal;

/// Time between two looks at the devices, and two confirmations of held keys: a quarter of the
/// jog's default dead-man's time.
const POLL_PERIOD: Duration = Duration::from_millis(10);

/// What the command line says.
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

/// Reads keys until the devices, the machine or the operator are gone.
///
/// # Errors
/// [`BadOption`] for what cannot be used; the machine is gone.
pub fn run(arguments: &KeysArgs) -> anyhow::Result<ExitCode> {
    if arguments.list {
        out::text(DEFAULT)?;
        return Ok(ExitCode::SUCCESS);
    }
    let map = read_map(arguments.map.as_deref())?;
    let mut line = Line::open(&arguments.at)?;
    let stop = signals::stop_request()?;
    let mut hand = Hand::new(map.clone());
    if arguments.stdin {
        let terminal = Terminal::open()?;
        return typed(&mut line, &mut hand, &terminal, &stop);
    }
    let inputs = open(&arguments.device, &map)?;
    for (number, input) in inputs.iter().enumerate() {
        out::line(input.path.display())?;
        hand.plugged(number, |code| input.has(code));
    }
    held(&mut line, &mut hand, inputs, &stop)
}

fn read_map(path: Option<&Path>) -> anyhow::Result<Map> {
    let Some(path) = path else {
        let file: MapFile = toml::from_str(DEFAULT)?;
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
    let (found, others) = device::all(folder, map);
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

/// The loop over event devices.
fn held(
    line: &mut Line,
    hand: &mut Hand,
    inputs: Vec<Input>,
    stop: &StopRequest,
) -> anyhow::Result<ExitCode> {
    let mut inputs: Vec<(usize, Input)> = inputs.into_iter().enumerate().collect();
    let mut speaker = Speaker::default();
    while !stop.is_set() {
        let mut said = Vec::new();
        inputs.retain_mut(|(number, input)| match input.look(*number, hand, linux::monotonic()) {
            Looked::There(words) => {
                said.extend(words);
                true
            }
            Looked::Gone => {
                hand.unplugged(*number);
                out::warn(format_args!("{} is gone: its keys are released", input.path.display()));
                false
            }
        });
        speaker.turn(line, hand, &said)?;
        if inputs.is_empty() {
            out::warn("error: no device is left");
            return Ok(ExitCode::from(1));
        }
        std::thread::sleep(POLL_PERIOD);
    }
    Ok(ExitCode::SUCCESS)
}

/// The loop over characters.
fn typed(
    line: &mut Line,
    hand: &mut Hand,
    terminal: &Terminal,
    stop: &StopRequest,
) -> anyhow::Result<ExitCode> {
    hand.plugged(0, |_| false);
    let mut speaker = Speaker::default();
    let mut presses = terminal::Presses::default();
    while !stop.is_set() {
        let characters = terminal.characters();
        let said = presses.take(characters.as_deref().unwrap_or_default(), hand);
        speaker.turn(line, hand, &said)?;
        if characters.is_none() && !presses.any() {
            break;
        }
        std::thread::sleep(POLL_PERIOD);
    }
    Ok(ExitCode::SUCCESS)
}

/// Says what the hand does.
#[derive(Default)]
struct Speaker {
    pushing: bool,
    /// The last answer to the keys.
    heard: String,
}

impl Speaker {
    /// One turn: words that were pressed, then the keys that are held.
    fn turn(&mut self, line: &mut Line, hand: &Hand, said: &[String]) -> anyhow::Result<()> {
        for words in said {
            let answer = exchange(line, words)?;
            out::line(format_args!("{words}: {answer}\r"))?;
        }
        match hand.push() {
            Some((axes, frame)) => {
                let axes: Vec<String> = axes.iter().map(|axis| format!("{axis:.4}")).collect();
                let words = format!("jog {} {}", frame.name(), axes.join(" "));
                let answer = exchange(line, &words)?;
                // Why the arm does not go as it is pushed, said once.
                if answer != "ok" && answer != self.heard {
                    out::line(format_args!("{answer}\r"))?;
                }
                (self.pushing, self.heard) = (true, answer);
            }
            None if self.pushing => {
                exchange(line, "release")?;
                (self.pushing, self.heard) = (false, String::new());
            }
            None => {}
        }
        Ok(())
    }
}

fn exchange(line: &mut Line, words: &str) -> anyhow::Result<String> {
    line.say(words)?;
    line.answer()
}
