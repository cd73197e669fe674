//! Keyboards and gamepads through the kernel's event devices. Read without waiting; a read that
//! fails is a device that is gone. Refuses devices that have no key and no stick of the map.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use evdev::{Device, EventSummary, KeyCode};

use super::hand::Hand;
use super::map::Map;

/// An open device.
pub struct Input {
    device: Device,
    /// Where it was found.
    pub path: PathBuf,
    /// Middle and half the way of each stick.
    ways: BTreeMap<u16, (f64, f64)>,
}

/// What a look at a device came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Looked {
    /// It is there; what is to be said to the machine.
    There(Vec<String>),
    /// It is gone.
    Gone,
}

impl Input {
    /// Opens an event device for this program alone, so that what is typed goes nowhere else.
    ///
    /// # Errors
    /// The kernel's, and a device without anything of the map.
    pub fn open(path: &Path, map: &Map) -> std::io::Result<Input> {
        let mut device = Device::open(path)?;
        let keys = device.supported_keys();
        let has_key =
            map.keys.keys().any(|code| keys.is_some_and(|keys| keys.contains(KeyCode(*code))));
        let mut ways = BTreeMap::new();
        if device.supported_absolute_axes().is_some() {
            for (code, about) in device.get_absinfo()? {
                let (low, high) = (f64::from(about.minimum()), f64::from(about.maximum()));
                if map.sticks.contains_key(&code.0) && high > low {
                    ways.insert(code.0, (0.5 * (low + high), 0.5 * (high - low)));
                }
            }
        }
        if !has_key && ways.is_empty() {
            let what = "it has no key and no stick of the map";
            return Err(std::io::Error::new(ErrorKind::Unsupported, what));
        }
        device.set_nonblocking(true)?;
        device.grab()?;
        Ok(Input { device, path: path.to_owned(), ways })
    }

    /// Whether it has a key.
    #[must_use]
    pub fn has(&self, code: u16) -> bool {
        self.device.supported_keys().is_some_and(|keys| keys.contains(KeyCode(code)))
    }

    /// Takes in what has happened on it. The kernel's buffer may have overflowed; the reader
    /// resynchronises then by itself.
    pub fn look(&mut self, number: usize, hand: &mut Hand) -> Looked {
        let mut said = Vec::new();
        let events = match self.device.fetch_events() {
            Ok(events) => events,
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Looked::There(said),
            Err(_) => return Looked::Gone,
        };
        for event in events {
            match event.destructure() {
                EventSummary::Key(_, code, value) => {
                    said.extend(hand.key(number, code.0, value != 0));
                }
                EventSummary::AbsoluteAxis(_, code, value) => {
                    if let Some((middle, way)) = self.ways.get(&code.0) {
                        hand.stick(number, code.0, (f64::from(value) - middle) / way);
                    }
                }
                _ => {}
            }
        }
        Looked::There(said)
    }
}

/// Every event device of this host that can be used, and why the others cannot.
#[must_use]
pub fn all(folder: &Path, map: &Map) -> (Vec<Input>, Vec<String>) {
    let (mut inputs, mut others) = (Vec::new(), Vec::new());
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
        if !name.is_some_and(|name| name.starts_with("event")) {
            continue;
        }
        match Input::open(&path, map) {
            Ok(input) => inputs.push(input),
            Err(error) => others.push(format!("{}: {error}", path.display())),
        }
    }
    (inputs, others)
}
