//! `taktil hal drivers`: the drivers of this program, what their halves ask of the kernel within a
//! job, and the keys of their sections, each with meaning and range, as a machine file may state
//! them below `[device.NAME]`.

use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_hal::SystemCall;
use taktil_hal::explain::{Explain, Key};
use taktil_machine::device::{HALVES, SIMULATOR, ThreadConfig};
use taktil_machine_boards::{Driver, drivers, find, left_out};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;

/// Width of the text of a key, in characters.
const TEXT_COLUMNS: usize = 76;
/// Indentation of what is said of a key.
const TEXT_INDENT: &str = "      ";

/// Which driver is explained.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  taktil hal drivers             names, how many keys each has, and system calls in a job
  taktil hal drivers serial      what may stand in a section with driver = \"serial\"
  taktil hal drivers mesa --json

Exit codes: 0 printed, 2 there is no such driver.")]
pub struct DriversArgs {
    /// Driver whose keys are printed; all drivers by name when absent
    #[arg(value_name = "NAME")]
    name: Option<String>,
    /// One JSON object instead of text
    #[arg(long)]
    json: bool,
}

/// Prints what the drivers take.
///
/// # Errors
/// [`BadOption`] for a driver that is not in this program; an output that cannot be written.
pub fn run(arguments: &DriversArgs) -> anyhow::Result<ExitCode> {
    let text = match (&arguments.name, arguments.json) {
        (None, false) => list(),
        (None, true) => {
            let all: Vec<Value> = drivers().map(as_json).collect();
            format!("{:#}\n", json!({ "drivers": all, "common": keys_as_json(&common_keys()) }))
        }
        (Some(name), is_json) => {
            let driver = find(name).ok_or_else(|| unknown(name))?;
            if is_json { format!("{:#}\n", as_json(driver)) } else { section(driver) }
        }
    };
    out::text(text)?;
    Ok(ExitCode::SUCCESS)
}

fn unknown(name: &str) -> BadOption {
    let names: Vec<&str> = drivers().map(|driver| driver.name).collect();
    let names = names.join(", ");
    if name == SIMULATOR {
        let text = "the simulated robot takes no keys: keys of another driver may stand beside it";
        return BadOption(format!("{SIMULATOR}: {text}; name one of: {names}"));
    }
    if let Some(remedy) = left_out(name) {
        return BadOption(format!("there is no driver `{name}` here; {remedy}"));
    }
    BadOption(format!("there is no driver `{name}`; drivers are: {names}"))
}

/// The keys that every section of a device has beside those of its driver.
fn common_keys() -> Vec<Key> {
    let key = |path: &str, about: &str| Key {
        path: path.to_owned(),
        about: about.to_owned(),
        range: None,
        words: &[],
    };
    let halves = HALVES.join(", ");
    let serves = format!(
        "Halves of the robot that the device serves: {halves}, tactile_NAME. Default all that it \
         has."
    );
    let mut keys =
        vec![key("driver", "Name of the driver. It has no default."), key("serves", &serves)];
    ThreadConfig::list("thread", "", None, &mut keys);
    keys
}

fn list() -> String {
    let mut text = String::from("driver     keys  system calls in a job\n");
    for driver in drivers() {
        let calls: Vec<&str> = driver.system_calls.iter().map(|call| call.name).collect();
        let calls = if calls.is_empty() { "none".to_owned() } else { calls.join(", ") };
        text += &format!("{:<10} {:>4}  {calls}\n", driver.name, (driver.keys)().len());
    }
    text += "\nKeys of every section [device.NAME]:\n";
    text += &keys_as_text(&common_keys());
    text + "\n`taktil hal drivers NAME` prints the keys of one driver.\n"
}

fn section(driver: &Driver) -> String {
    let mut text = format!("[device.NAME]\ndriver = \"{}\"\n", driver.name);
    text += "# `serves` and `thread` are explained by `taktil hal drivers`.\n\n";
    text += &keys_as_text(&(driver.keys)());
    if driver.system_calls.is_empty() {
        return text + "\nIts halves make no system call in a job.\n";
    }
    text += "\nSystem calls that its halves make in a job:\n";
    for call in driver.system_calls {
        text += &format!("  {}\n", call.name);
        for line in wrapped(call.about, TEXT_COLUMNS) {
            text += &format!("{TEXT_INDENT}{line}\n");
        }
    }
    text
}

fn keys_as_text(keys: &[Key]) -> String {
    let mut text = String::new();
    for key in keys.iter().filter(|key| !key.path.is_empty()) {
        let range = key.range.map_or(String::new(), |(low, high)| format!("  [{low}, {high}]"));
        text += &format!("  {}{range}\n", key.path);
        for line in wrapped(&key.about, TEXT_COLUMNS) {
            text += &format!("{TEXT_INDENT}{line}\n");
        }
        for word in key.words {
            for (number, line) in wrapped(word, TEXT_COLUMNS - 2).into_iter().enumerate() {
                let bullet = if number == 0 { "-" } else { " " };
                text += &format!("{TEXT_INDENT}{bullet} {line}\n");
            }
        }
    }
    text
}

/// A text as lines of at most these many characters; a longer word has a line of its own.
fn wrapped(text: &str, columns: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= columns => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn as_json(driver: &Driver) -> Value {
    let call = |call: &SystemCall| json!({ "name": call.name, "about": call.about });
    let calls: Vec<Value> = driver.system_calls.iter().map(call).collect();
    let keys = keys_as_json(&(driver.keys)());
    json!({ "name": driver.name, "keys": keys, "system_calls": calls })
}

fn keys_as_json(keys: &[Key]) -> Value {
    let key = |key: &Key| {
        json!({
            "path": key.path,
            "about": key.about.split_whitespace().collect::<Vec<_>>().join(" "),
            "range": key.range.map(|(low, high)| [low, high]),
            "words": key.words,
        })
    };
    keys.iter().filter(|key| !key.path.is_empty()).map(key).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_driver_explains_every_key_of_its_section() {
        for driver in drivers() {
            let keys = (driver.keys)();
            assert!(keys.len() > 1, "{}", driver.name);
            // An element of a list may say what it is through its list.
            let silent = |key: &&Key| key.about.is_empty() && !key.path.ends_with(['*', ']']);
            let silent = keys.iter().skip(1).find(silent);
            assert!(silent.is_none(), "{}: {silent:?}", driver.name);
        }
    }

    #[test]
    fn a_section_shows_range_and_words_of_its_keys() {
        let text = section(find("serial").unwrap());
        assert!(text.contains("  rate_hz  [10, 1000]\n"), "{text}");
        assert!(text.contains("- Weiss WTS over USB."), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= 90), "{text}");
        let value = as_json(find("mesa").unwrap());
        let encoders = value["keys"].as_array().unwrap().iter();
        let encoders = encoders.clone().find(|key| key["path"] == "encoders").unwrap();
        assert_eq!(encoders["range"][0], 0.0);
    }

    #[test]
    fn a_driver_tells_what_its_halves_ask_of_the_kernel() {
        let text = section(find("mesa").unwrap());
        assert!(text.contains("in a job:\n  send\n"), "{text}");
        assert!(section(find("regmap").unwrap()).ends_with("make no system call in a job.\n"));
        assert_eq!(as_json(find("comedi").unwrap())["system_calls"][0]["name"], "ioctl");
        assert!(list().lines().any(|line| line.starts_with("serial") && line.ends_with("none")));
    }

    #[test]
    fn an_unknown_driver_is_answered_with_the_known_ones() {
        let all = unknown("messa").0;
        let [before, after] = ["drivers are: can, comedi, ", "mesa, netft, regmap, serial"];
        assert!(all.contains(before) && all.contains(after), "{all}");
        let has_segments = find("ethercat").is_some();
        assert_eq!(all.contains("ethercat"), has_segments, "{all}");
        assert_eq!(unknown("ethercat").0.contains("--features ethercat"), !has_segments);
        assert!(unknown("simulator").0.contains("takes no keys"));
    }

    #[test]
    fn lines_break_between_words() {
        assert_eq!(wrapped("one two\n three", 7), ["one two", "three"]);
        assert_eq!(wrapped("", 7), Vec::<String>::new());
    }
}
