//! Keyboards and gamepads through the kernel's event devices, or the same events through a pipe.
//! Read without waiting; a read that fails, and the end of a pipe, is a device that is gone. A pipe
//! cannot tell a key that is held from a writer that hangs: one that is silent lets everything go.
//! Refuses devices that have no key and no stick of the map.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use evdev::{Device, KeyCode};
use nix::errno::Errno;
use nix::fcntl::OFlag;
use taktil_rtcore::Nanos;

use super::events::{Decoder, EVENT_BYTES, Happened};
use super::hand::Hand;
use super::map::Map;

/// Events that are read at once.
const AT_ONCE: usize = 64;
/// Reads in one look at most: what is left waits for the next.
const READS_PER_POLL_MAX: usize = 8;
/// Time without a byte after which a pipe is silent, and after a press, when a keyboard waits for a
/// quarter of a second before it begins to repeat.
const SILENCE_TIMEOUT: Nanos = Nanos::from_millis(100);
const SILENT_PRESSED: Nanos = Nanos::from_millis(300);
/// Half the way of a stick that comes through a pipe, which says nothing of it: sixteen bits.
const PIPE_WAY: f64 = 32_768.0;

/// Where events come from.
enum Wire {
    Kernel(Box<Device>),
    Pipe(File),
}

impl AsFd for Wire {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Wire::Kernel(device) => device.as_fd(),
            Wire::Pipe(file) => file.as_fd(),
        }
    }
}

/// An open device.
pub struct Input {
    wire: Wire,
    decoder: Decoder,
    /// Something has come: the end of a pipe to which nobody has written yet is no end.
    begun: bool,
    /// When the newest byte came.
    heard: Nanos,
    /// The key that was pressed last and has neither repeated nor come up, and when.
    pressed: Option<(u16, Nanos)>,
    /// It fell silent, and everything was let go.
    silent: bool,
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
    /// Opens an event device for this program alone, so that what is typed goes nowhere else; or a
    /// named pipe, whether somebody writes to it already or not.
    ///
    /// # Errors
    /// The kernel's, and a device without anything of the map.
    pub fn open(path: &Path, map: &Map) -> std::io::Result<Input> {
        let (wire, ways) = match std::fs::metadata(path)?.file_type().is_fifo() {
            true => {
                // A pipe that is opened so does not wait for a writer.
                let flags = OFlag::O_NONBLOCK.bits();
                let pipe = File::options().read(true).custom_flags(flags).open(path)?;
                (Wire::Pipe(pipe), through_a_pipe(map))
            }
            false => kernel(path, map)?,
        };
        Ok(Input::over(wire, path.to_owned(), ways))
    }

    fn over(wire: Wire, path: PathBuf, ways: Ways) -> Input {
        Input {
            wire,
            decoder: Decoder::default(),
            begun: false,
            heard: Nanos::ZERO,
            pressed: None,
            silent: true,
            path,
            ways,
        }
    }

    /// Whether it has a key; whoever writes to a pipe may have any.
    #[must_use]
    pub fn has(&self, code: u16) -> bool {
        match &self.wire {
            Wire::Kernel(device) => {
                device.supported_keys().is_some_and(|keys| keys.contains(KeyCode(code)))
            }
            Wire::Pipe(_) => false,
        }
    }

    /// Takes in what has happened on it up to `now`, a time that does not run backwards. When the
    /// kernel's buffer has overflowed, everything is up, and then what the device says is held.
    /// When a pipe is silent, everything is up until it is pressed, moved or repeated again.
    pub fn look(&mut self, number: usize, hand: &mut Hand, now: Nanos) -> Looked {
        let mut said = Vec::new();
        let mut buffer = [0; AT_ONCE * EVENT_BYTES];
        for _ in 0..READS_PER_POLL_MAX {
            let read = match nix::unistd::read(&self.wire, &mut buffer) {
                Ok(0) if self.begun => return Looked::Gone,
                Ok(0) => break,
                Ok(read) => read,
                Err(Errno::EAGAIN) => break,
                Err(Errno::EINTR) => continue,
                Err(_) => return Looked::Gone,
            };
            (self.begun, self.heard, self.silent) = (true, now, false);
            for happened in self.decoder.feed(&buffer[..read]) {
                self.wait_for_repeats(&happened, now);
                match happened {
                    Happened::Key(code, down) => said.extend(hand.key(number, code, down)),
                    Happened::Repeats(code) => said.extend(hand.still_held(number, code)),
                    Happened::Stick(code, value) => self.stick(number, hand, code, value),
                    Happened::Lost => hand.let_go(number),
                    Happened::Ask => match self.ask(number, hand) {
                        Ok(lost) => said.extend(lost),
                        Err(_) => return Looked::Gone,
                    },
                }
            }
        }
        let repeats_by = self.pressed.map_or(Nanos::ZERO, |(_, at)| at + SILENT_PRESSED);
        let over = now >= repeats_by.max(self.heard + SILENCE_TIMEOUT);
        if matches!(self.wire, Wire::Pipe(_)) && over && !self.silent {
            self.silent = true;
            hand.let_go(number);
        }
        Looked::There(said)
    }

    /// A key that is held is quiet between its press and its first repeat, whatever else comes.
    fn wait_for_repeats(&mut self, happened: &Happened, now: Nanos) {
        match *happened {
            Happened::Key(code, true) => self.pressed = Some((code, now)),
            Happened::Repeats(_) => self.pressed = None,
            Happened::Key(code, false) if self.pressed.is_some_and(|key| key.0 == code) => {
                self.pressed = None;
            }
            _ => {}
        }
    }

    fn stick(&self, number: usize, hand: &mut Hand, code: u16, value: i32) {
        if let Some((middle, way)) = self.ways.get(&code) {
            hand.stick(number, code, (f64::from(value) - middle) / way);
        }
    }

    /// Asks the device what is held; what is to be said of presses that were lost. A pipe cannot be
    /// asked: there everything stays up.
    fn ask(&self, number: usize, hand: &mut Hand) -> std::io::Result<Vec<String>> {
        let Wire::Kernel(device) = &self.wire else { return Ok(Vec::new()) };
        let keys = device.get_key_state()?;
        let said = keys.iter().filter_map(|key| hand.still_held(number, key.0)).collect();
        hand.all_told(number);
        for (code, about) in device.get_absinfo()? {
            self.stick(number, hand, code.0, about.value());
        }
        Ok(said)
    }
}

type Ways = BTreeMap<u16, (f64, f64)>;

fn kernel(path: &Path, map: &Map) -> std::io::Result<(Wire, Ways)> {
    let mut device = Device::open(path)?;
    let keys = device.supported_keys();
    let has_key =
        map.keys.keys().any(|code| keys.is_some_and(|keys| keys.contains(KeyCode(*code))));
    let mut ways = Ways::new();
    if device.supported_absolute_axes().is_some() {
        for (code, about) in device.get_absinfo()? {
            let (low, high) = (f64::from(about.minimum()), f64::from(about.maximum()));
            if map.sticks.contains_key(&code.0) && high > low {
                ways.insert(code.0, (0.5 * (low + high), 0.5 * (high - low)));
            }
        }
    }
    let mut what = "it has no key and no stick of the map";
    let holds = |code: &u16| keys.is_some_and(|keys| keys.contains(KeyCode(*code)));
    if !ways.is_empty() && !map.hold.is_empty() && !map.hold.iter().any(holds) {
        // They could never move anything.
        what = "it has sticks and none of the keys under `hold`: name one of its buttons there";
        ways.clear();
    }
    if !has_key && ways.is_empty() {
        return Err(std::io::Error::new(ErrorKind::Unsupported, what));
    }
    device.set_nonblocking(true)?;
    device.grab()?;
    Ok((Wire::Kernel(Box::new(device)), ways))
}

fn through_a_pipe(map: &Map) -> Ways {
    map.sticks.keys().map(|code| (*code, (0.0, PIPE_WAY))).collect()
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

#[cfg(test)]
mod tests {
    use super::super::events::bytes;
    use super::super::map::{DEFAULT, MapFile};
    use super::*;
    use nix::fcntl::{FcntlArg, fcntl};
    use std::io::Write;

    /// Looks once every 10 ms, by a clock of its own.
    struct Looks(Nanos);

    const POLL_PERIOD: Nanos = Nanos::from_millis(10);

    impl Looks {
        fn at(&mut self, input: &mut Input, hand: &mut Hand) -> Looked {
            self.0 += POLL_PERIOD;
            input.look(0, hand, self.0)
        }

        /// For how long of so many looks something was pushed; nothing is said.
        fn pushing(&mut self, input: &mut Input, hand: &mut Hand, times: u32) -> Nanos {
            let held = (0..times).filter(|_| {
                assert_eq!(self.at(input, hand), Looked::There(vec![]));
                hand.push().is_some()
            });
            POLL_PERIOD * i64::try_from(held.count()).unwrap()
        }
    }

    /// A pipe as a device, the end that is written to, and a hand that it moves.
    fn piped() -> (Input, File, Hand) {
        let map = toml::from_str::<MapFile>(DEFAULT).unwrap().check().unwrap();
        let (read, write) = nix::unistd::pipe().unwrap();
        fcntl(&read, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
        let pipe = Wire::Pipe(File::from(read));
        let input = Input::over(pipe, PathBuf::from("pipe"), through_a_pipe(&map));
        let mut hand = Hand::new(map);
        hand.plugged(0, |code| input.has(code));
        (input, File::from(write), hand)
    }

    const EVENT_KEY: u16 = 1;
    const EVENT_AXIS: u16 = 3;

    #[test]
    fn keys_are_held_from_event_to_event_and_words_said_once() {
        let (mut input, mut wire, mut hand) = piped();
        let mut looks = Looks(Nanos::ZERO);
        assert_eq!(looks.at(&mut input, &mut hand), Looked::There(vec![]));
        wire.write_all(&bytes(EVENT_KEY, KeyCode::KEY_J.0, 1)).unwrap();
        wire.write_all(&bytes(EVENT_KEY, KeyCode::KEY_E.0, 1)[..7]).unwrap();
        assert_eq!(looks.at(&mut input, &mut hand), Looked::There(vec!["manual_joint".into()]));
        assert!(hand.push().is_none(), "half an event is none yet");
        wire.write_all(&bytes(EVENT_KEY, KeyCode::KEY_E.0, 1)[7..]).unwrap();
        looks.at(&mut input, &mut hand);
        assert!(hand.push().is_some());
        wire.write_all(&bytes(EVENT_KEY, KeyCode::KEY_E.0, 0)).unwrap();
        looks.at(&mut input, &mut hand);
        assert!(hand.push().is_none());
        wire.write_all(&bytes(EVENT_AXIS, evdev::AbsoluteAxisCode::ABS_X.0, i32::MIN)).unwrap();
        looks.at(&mut input, &mut hand);
        assert!(hand.push().is_none(), "its dead-man's switch is up");
        wire.write_all(&bytes(EVENT_KEY, KeyCode::BTN_TL.0, 1)).unwrap();
        looks.at(&mut input, &mut hand);
        assert!(hand.push().is_some_and(|(axes, _)| axes.iter().all(|axis| axis.abs() <= 1.0)));
    }

    #[test]
    fn an_overflow_lets_go_and_so_does_the_end() {
        let (mut input, mut wire, mut hand) = piped();
        let mut looks = Looks(Nanos::ZERO);
        wire.write_all(&bytes(EVENT_KEY, KeyCode::KEY_E.0, 1)).unwrap();
        looks.at(&mut input, &mut hand);
        assert!(hand.push().is_some());
        // SYN_DROPPED: the release of the key may be among what was lost.
        wire.write_all(&bytes(0, 3, 0)).unwrap();
        looks.at(&mut input, &mut hand);
        assert!(hand.push().is_none());
        wire.write_all(&[bytes(0, 0, 0), bytes(EVENT_KEY, KeyCode::KEY_E.0, 1)].concat()).unwrap();
        assert_eq!(looks.at(&mut input, &mut hand), Looked::There(vec![]));
        assert!(hand.push().is_some());
        drop(wire);
        assert_eq!(looks.at(&mut input, &mut hand), Looked::Gone);
    }

    #[test]
    fn a_pipe_that_stalls_lets_go_and_only_what_comes_anew_pushes_again() {
        let (mut input, mut wire, mut hand) = piped();
        let mut looks = Looks(Nanos::ZERO);
        let e = |value: i32| bytes(EVENT_KEY, KeyCode::KEY_E.0, value);
        // Until the keyboard would repeat, and from one repeat to the next.
        wire.write_all(&e(1)).unwrap();
        assert_eq!(looks.pushing(&mut input, &mut hand, 100), SILENT_PRESSED);
        for _ in 0..5 {
            wire.write_all(&e(2)).unwrap();
            assert_eq!(looks.pushing(&mut input, &mut hand, 4), POLL_PERIOD * 4, "repeats hold it");
        }
        assert_eq!(looks.pushing(&mut input, &mut hand, 100), SILENCE_TIMEOUT - POLL_PERIOD * 4);
        // What comes with a press or after it does not shorten the wait for the first repeat.
        wire.write_all(&e(1)).unwrap();
        assert_eq!(looks.pushing(&mut input, &mut hand, 1), POLL_PERIOD);
        wire.write_all(&[0; EVENT_BYTES]).unwrap();
        assert_eq!(looks.pushing(&mut input, &mut hand, 100), SILENT_PRESSED - POLL_PERIOD);
        // Reports without anything in them say that the writer lives, not what is held.
        wire.write_all(&e(1)).unwrap();
        for _ in 0..20 {
            wire.write_all(&[0; EVENT_BYTES]).unwrap();
            assert_eq!(looks.pushing(&mut input, &mut hand, 5), POLL_PERIOD * 5);
        }
        assert_eq!(looks.pushing(&mut input, &mut hand, 100), SILENCE_TIMEOUT - POLL_PERIOD * 5);
        wire.write_all(&[0; EVENT_BYTES]).unwrap();
        assert_eq!(looks.pushing(&mut input, &mut hand, 5), Nanos::ZERO);
        // Words are said once for one press, before a stall and after.
        wire.write_all(&bytes(EVENT_KEY, KeyCode::KEY_J.0, 1)).unwrap();
        assert_eq!(looks.at(&mut input, &mut hand), Looked::There(vec!["manual_joint".into()]));
        assert_eq!(looks.pushing(&mut input, &mut hand, 50), Nanos::ZERO);
        wire.write_all(&bytes(EVENT_KEY, KeyCode::KEY_J.0, 2)).unwrap();
        assert_eq!(looks.at(&mut input, &mut hand), Looked::There(vec![]));
    }

    #[test]
    fn a_flood_does_not_keep_the_reader() {
        let (mut input, mut wire, mut hand) = piped();
        let mut looks = Looks(Nanos::ZERO);
        fcntl(&wire, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
        let event = bytes(EVENT_KEY, KeyCode::KEY_E.0, 2);
        while wire.write_all(&event).is_ok() {}
        assert!(matches!(looks.at(&mut input, &mut hand), Looked::There(_)));
        assert!(wire.write_all(&event).is_ok(), "something was read");
    }
}
