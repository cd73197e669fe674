//! `taktil hal list`: what is plugged in that a driver of this program could open. Nothing is
//! written to a device, and no port is opened unless that was asked for. Whatever could not be
//! looked at is listed with its cause.

mod card;
mod comedi;
mod memory;
mod network;
mod tty;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde_json::{Map, Value};
use taktil_hal::Nanos;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;

/// How long an answer of a card is waited for unless the option says otherwise (ms).
const WAIT_DEFAULT_MS: u32 = 20;

/// Where is looked.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  taktil hal list                        everything that can be seen without touching a board
  taktil hal list --udp 10.10.10.10      ask this address for a HostMot2 card, whatever its network
  taktil hal list --udev-rules > 70-taktil-serial.rules
  taktil hal list --open                 open each serial port for a moment: is it busy, is it slow?

Without --udp the two addresses that a card has as delivered are asked, 10.10.10.10 and
192.168.1.121 at port 27181, each only where this host has an address in its network. Nothing is
ever broadcast. Opening a serial port raises its control lines, by which some boards restart: that
is done with --open alone.

Exit codes: 0 looked, whatever was found; 2 an address or a folder that cannot be used.")]
pub struct ListArgs {
    /// Address of a HostMot2 card to ask, with or without a port; can be given several times
    #[arg(long, value_name = "ADDRESS[:PORT]")]
    udp: Vec<String>,
    /// Milliseconds that each answer of a card is waited for; a question is asked ten times
    #[arg(long, value_name = "MS", default_value_t = WAIT_DEFAULT_MS)]
    wait: u32,
    /// Open each serial port for a moment
    #[arg(long)]
    open: bool,
    /// Print rules for udev that let the group dialout use serial boards, and nothing else
    #[arg(long)]
    udev_rules: bool,
    /// One JSON object instead of text
    #[arg(long)]
    json: bool,
    /// Look at a recorded tree of /dev, /proc and /sys instead of this host; nothing is asked
    #[arg(long, value_name = "DIR", conflicts_with_all = ["udp", "open"])]
    root: Option<PathBuf>,
}

/// One thing that was found.
#[derive(Clone, Debug, Default, PartialEq)]
struct Found {
    /// Path or address, as a section of a machine file names it.
    name: String,
    /// What is known of it, in the order in which it is shown.
    facts: Vec<(&'static str, Value)>,
}

impl Found {
    fn new(name: impl Into<String>) -> Found {
        Found { name: name.into(), facts: Vec::new() }
    }

    fn add(&mut self, key: &'static str, value: impl Into<Value>) {
        self.facts.push((key, value.into()));
    }

    fn add_some(&mut self, key: &'static str, value: Option<impl Into<Value>>) {
        if let Some(value) = value {
            self.add(key, value);
        }
    }
}

/// What was found of one kind.
#[derive(Clone, Debug, Default, PartialEq)]
struct Group {
    /// Name in JSON.
    key: &'static str,
    /// Name for people, with the driver that opens such a thing.
    title: &'static str,
    found: Vec<Found>,
    /// What could not be looked at, and why.
    not_seen: Vec<String>,
}

/// Prints what is plugged in.
///
/// # Errors
/// [`BadOption`] for an address that is none, or a folder that is not there.
pub fn run(arguments: &ListArgs) -> anyhow::Result<ExitCode> {
    if arguments.udev_rules {
        out::text(taktil_drivers_serial::UDEV_RULES)?;
        return Ok(ExitCode::SUCCESS);
    }
    let is_recorded = arguments.root.is_some();
    let root = arguments.root.clone().unwrap_or_else(|| PathBuf::from("/"));
    if !root.is_dir() {
        return Err(BadOption(format!("--root {}: is no folder", root.display())).into());
    }
    let wait = Nanos::from_millis(i64::from(arguments.wait.clamp(1, 10_000)));
    let question = card::Question { named: card::addresses(&arguments.udp)?, wait, is_recorded };
    let groups = [
        tty::ports(&root, arguments.open),
        card::cards(&root, &question),
        comedi::nodes(&root, is_recorded),
        network::can_interfaces(&root),
        network::ethernet_interfaces(&root),
        memory::uio_devices(&root),
        memory::pci_devices(&root),
    ];
    out::text(if arguments.json { as_json(&groups) } else { as_text(&groups) })?;
    Ok(ExitCode::SUCCESS)
}

fn as_text(groups: &[Group]) -> String {
    let mut text = String::new();
    for group in groups {
        text += &format!("{}\n", group.title);
        for found in &group.found {
            text += &format!("  {}\n", found.name);
            for (key, value) in &found.facts {
                let value = shown(value);
                if !value.is_empty() {
                    text += &format!("    {:<14} {value}\n", key.replace('_', " "));
                }
            }
        }
        if group.found.is_empty() {
            text += "  none found\n";
        }
        for reason in &group.not_seen {
            text += &format!("  not seen: {reason}\n");
        }
    }
    text
}

/// A value for people: lists separated by commas.
fn shown(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Bool(yes) => if *yes { "yes" } else { "no" }.to_owned(),
        Value::Array(values) => values.iter().map(shown).collect::<Vec<_>>().join(", "),
        other => other.to_string(),
    }
}

fn as_json(groups: &[Group]) -> String {
    let mut all = Map::new();
    for group in groups {
        let found = |found: &Found| {
            let mut object = Map::new();
            object.insert("name".to_owned(), found.name.clone().into());
            for (key, value) in &found.facts {
                object.insert((*key).to_owned(), value.clone());
            }
            Value::Object(object)
        };
        let list: Vec<Value> = group.found.iter().map(found).collect();
        let entry = serde_json::json!({ "found": list, "not_seen": group.not_seen });
        all.insert(group.key.to_owned(), entry);
    }
    format!("{:#}\n", Value::Object(all))
}

/// The content of a small file, without the white space around it; `None` when it cannot be read or
/// is empty.
fn line_of(path: &Path) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    let text = text.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

/// The names in a folder, sorted by length and letter, so that 10 comes after 9.
fn names_in(folder: &Path) -> std::io::Result<Vec<String>> {
    let entries = std::fs::read_dir(folder)?.flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort_by_key(|name| (name.len(), name.clone()));
    Ok(names)
}

/// The last name of what a link points at.
fn target_name(link: &Path) -> Option<String> {
    let target = std::fs::read_link(link).ok()?;
    Some(target.file_name()?.to_string_lossy().into_owned())
}

/// Whether this process may read and write a path.
fn is_permitted(path: &Path) -> bool {
    let wanted = nix::unistd::AccessFlags::R_OK | nix::unistd::AccessFlags::W_OK;
    nix::unistd::access(path, wanted).is_ok()
}

/// A path of the tree without its root, as whoever runs on that host would write it.
fn below(root: &Path, path: &Path) -> String {
    let inner = path.strip_prefix(root).unwrap_or(path);
    Path::new("/").join(inner).display().to_string()
}

#[cfg(test)]
mod tests;
