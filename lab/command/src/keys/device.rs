//! Keyboards and gamepads through the kernel's event devices, or the same events through a pipe.
//! Reads do not block. A failed read or the end of a pipe means that the device is gone. A pipe
//! cannot tell a key that is held from a writer that hangs, so a silent pipe releases all its keys.
//! A device without any key or stick of the map is an error.

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

use super::events::{Decoder, EVENT_BYTES, InputEvent};
use super::input_state::InputState;
use super::map::Map;

/// Largest number of events in one read.
const EVENTS_PER_READ: usize = 64;
/// Largest number of reads in one poll; events that are left wait for the next poll.
const READS_PER_POLL_MAX: usize = 8;
/// Time without a byte after which a pipe counts as silent and all its keys are released.
const PIPE_TIMEOUT: Nanos = Nanos::from_millis(100);
/// Timeout after a press: a keyboard waits a quarter of a second before it begins to repeat.
const PIPE_TIMEOUT_AFTER_PRESS: Nanos = Nanos::from_millis(300);
/// Half the range of a stick behind a pipe, which does not report its range: sixteen bits.
const PIPE_STICK_HALF_RANGE: f64 = 32_768.0;

/// The source of the events.
enum EventSource {
    Kernel(Box<Device>),
    Pipe(File),
}

impl AsFd for EventSource {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            EventSource::Kernel(device) => device.as_fd(),
            EventSource::Pipe(file) => file.as_fd(),
        }
    }
}

/// An open device.
pub struct Input {
    source: EventSource,
    decoder: Decoder,
    /// A byte has been read. Before the first byte, the end of a pipe only means that it has no
    /// writer yet.
    has_data: bool,
    /// Time of the newest byte.
    last_byte_at: Nanos,
    /// The key that was pressed last and has neither repeated nor been released, and the time of
    /// its press.
    pressed: Option<(u16, Nanos)>,
    /// The pipe fell silent, and all its keys were released.
    silent: bool,
    /// Path of the device.
    pub path: PathBuf,
    /// Middle and half range of each stick.
    stick_ranges: BTreeMap<u16, (f64, f64)>,
}

/// The result of a poll.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PollOutcome {
    /// The device is present; the commands to send to the machine.
    Present(Vec<String>),
    /// The device is gone.
    Gone,
}

impl Input {
    /// Opens an event device exclusively, so that no other program receives its keys; or a named
    /// pipe, with or without a writer.
    ///
    /// # Errors
    /// The kernel's errors, and a device without any key or stick of the map.
    pub fn open(path: &Path, map: &Map) -> std::io::Result<Input> {
        let (source, stick_ranges) = match std::fs::metadata(path)?.file_type().is_fifo() {
            true => {
                // With this flag, opening a pipe does not wait for a writer.
                let flags = OFlag::O_NONBLOCK.bits();
                let pipe = File::options().read(true).custom_flags(flags).open(path)?;
                (EventSource::Pipe(pipe), pipe_stick_ranges(map))
            }
            false => open_event_device(path, map)?,
        };
        Ok(Input::from_source(source, path.to_owned(), stick_ranges))
    }

    fn from_source(source: EventSource, path: PathBuf, stick_ranges: StickRanges) -> Input {
        Input {
            source,
            decoder: Decoder::default(),
            has_data: false,
            last_byte_at: Nanos::ZERO,
            pressed: None,
            silent: true,
            path,
            stick_ranges,
        }
    }

    /// Whether the device reports this key. A pipe reports none, although its writer may send any.
    #[must_use]
    pub fn has(&self, code: u16) -> bool {
        match &self.source {
            EventSource::Kernel(device) => {
                device.supported_keys().is_some_and(|keys| keys.contains(KeyCode(code)))
            }
            EventSource::Pipe(_) => false,
        }
    }

    /// Processes the events up to `now`, a time that does not run backwards. After an overflow of
    /// the kernel's buffer all keys are released, and then those that the device reports as held
    /// are pressed again. A silent pipe releases all keys until they are pressed, moved or repeated
    /// again.
    pub fn poll(&mut self, number: usize, input_state: &mut InputState, now: Nanos) -> PollOutcome {
        let mut said = Vec::new();
        let mut buffer = [0; EVENTS_PER_READ * EVENT_BYTES];
        for _ in 0..READS_PER_POLL_MAX {
            let read = match nix::unistd::read(&self.source, &mut buffer) {
                Ok(0) if self.has_data => return PollOutcome::Gone,
                Ok(0) => break,
                Ok(read) => read,
                Err(Errno::EAGAIN) => break,
                Err(Errno::EINTR) => continue,
                Err(_) => return PollOutcome::Gone,
            };
            (self.has_data, self.last_byte_at, self.silent) = (true, now, false);
            for happened in self.decoder.feed(&buffer[..read]) {
                self.wait_for_repeats(&happened, now);
                match happened {
                    InputEvent::Key(code, down) => said.extend(input_state.key(number, code, down)),
                    InputEvent::KeyRepeat(code) => {
                        said.extend(input_state.confirm_key(number, code))
                    }
                    InputEvent::Stick(code, value) => self.stick(number, input_state, code, value),
                    InputEvent::EventsLost => input_state.release_all(number),
                    InputEvent::Resynchronise => match self.resynchronise(number, input_state) {
                        Ok(lost) => said.extend(lost),
                        Err(_) => return PollOutcome::Gone,
                    },
                }
            }
        }
        let repeats_by = self.pressed.map_or(Nanos::ZERO, |(_, at)| at + PIPE_TIMEOUT_AFTER_PRESS);
        let over = now >= repeats_by.max(self.last_byte_at + PIPE_TIMEOUT);
        if matches!(self.source, EventSource::Pipe(_)) && over && !self.silent {
            self.silent = true;
            input_state.release_all(number);
        }
        PollOutcome::Present(said)
    }

    /// Records the press, because a held key sends nothing between its press and its first repeat.
    fn wait_for_repeats(&mut self, happened: &InputEvent, now: Nanos) {
        match *happened {
            InputEvent::Key(code, true) => self.pressed = Some((code, now)),
            InputEvent::KeyRepeat(_) => self.pressed = None,
            InputEvent::Key(code, false) if self.pressed.is_some_and(|key| key.0 == code) => {
                self.pressed = None;
            }
            _ => {}
        }
    }

    fn stick(&self, number: usize, input_state: &mut InputState, code: u16, value: i32) {
        if let Some((middle, way)) = self.stick_ranges.get(&code) {
            input_state.stick(number, code, (f64::from(value) - middle) / way);
        }
    }

    /// Asks the device which keys are held, and returns the commands of presses that were lost. A
    /// pipe cannot be asked, so all its keys stay released.
    fn resynchronise(
        &self,
        number: usize,
        input_state: &mut InputState,
    ) -> std::io::Result<Vec<String>> {
        let EventSource::Kernel(device) = &self.source else { return Ok(Vec::new()) };
        let keys = device.get_key_state()?;
        let said = keys.iter().filter_map(|key| input_state.confirm_key(number, key.0)).collect();
        input_state.end_resynchronisation(number);
        for (code, about) in device.get_absinfo()? {
            self.stick(number, input_state, code.0, about.value());
        }
        Ok(said)
    }
}

type StickRanges = BTreeMap<u16, (f64, f64)>;

fn open_event_device(path: &Path, map: &Map) -> std::io::Result<(EventSource, StickRanges)> {
    let mut device = Device::open(path)?;
    let keys = device.supported_keys();
    let has_key =
        map.keys.keys().any(|code| keys.is_some_and(|keys| keys.contains(KeyCode(*code))));
    let mut stick_ranges = StickRanges::new();
    if device.supported_absolute_axes().is_some() {
        for (code, about) in device.get_absinfo()? {
            let (low, high) = (f64::from(about.minimum()), f64::from(about.maximum()));
            if map.sticks.contains_key(&code.0) && high > low {
                stick_ranges.insert(code.0, (0.5 * (low + high), 0.5 * (high - low)));
            }
        }
    }
    let mut what = "it has no key and no stick of the map";
    let holds = |code: &u16| keys.is_some_and(|keys| keys.contains(KeyCode(*code)));
    if !stick_ranges.is_empty() && !map.hold.is_empty() && !map.hold.iter().any(holds) {
        // Without a dead-man's switch these sticks could never move anything.
        what = "it has sticks and none of the keys under `hold`: name one of its buttons there";
        stick_ranges.clear();
    }
    if !has_key && stick_ranges.is_empty() {
        return Err(std::io::Error::new(ErrorKind::Unsupported, what));
    }
    device.set_nonblocking(true)?;
    device.grab()?;
    Ok((EventSource::Kernel(Box::new(device)), stick_ranges))
}

fn pipe_stick_ranges(map: &Map) -> StickRanges {
    map.sticks.keys().map(|code| (*code, (0.0, PIPE_STICK_HALF_RANGE))).collect()
}

/// Every usable event device of this host, and why the others cannot be used.
#[must_use]
pub fn open_all(folder: &Path, map: &Map) -> (Vec<Input>, Vec<String>) {
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
    use super::super::map::{DEFAULT_MAP, MapFile};
    use super::*;
    use nix::fcntl::{FcntlArg, fcntl};
    use std::io::Write;

    /// Polls every 10 ms of a simulated clock.
    struct PollClock(Nanos);

    const POLL_INTERVAL: Nanos = Nanos::from_millis(10);

    impl PollClock {
        fn at(&mut self, input: &mut Input, input_state: &mut InputState) -> PollOutcome {
            self.0 += POLL_INTERVAL;
            input.poll(0, input_state, self.0)
        }

        /// Polls `times` times and returns how long an axis was deflected; no command may be sent.
        fn pushing(
            &mut self,
            input: &mut Input,
            input_state: &mut InputState,
            times: u32,
        ) -> Nanos {
            let held = (0..times).filter(|_| {
                assert_eq!(self.at(input, input_state), PollOutcome::Present(vec![]));
                input_state.deflection().is_some()
            });
            POLL_INTERVAL * i64::try_from(held.count()).unwrap()
        }
    }

    /// A pipe as a device, its writing end, and the state of its keys.
    fn pipe_input() -> (Input, File, InputState) {
        let map = toml::from_str::<MapFile>(DEFAULT_MAP).unwrap().check().unwrap();
        let (read, write) = nix::unistd::pipe().unwrap();
        fcntl(&read, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
        let pipe = EventSource::Pipe(File::from(read));
        let input = Input::from_source(pipe, PathBuf::from("pipe"), pipe_stick_ranges(&map));
        let mut input_state = InputState::new(map);
        input_state.connect(0, |code| input.has(code));
        (input, File::from(write), input_state)
    }

    const EV_KEY: u16 = 1;
    const EV_ABS: u16 = 3;

    #[test]
    fn keys_are_held_between_events_and_commands_are_sent_once() {
        let (mut input, mut writer, mut input_state) = pipe_input();
        let mut clock = PollClock(Nanos::ZERO);
        assert_eq!(clock.at(&mut input, &mut input_state), PollOutcome::Present(vec![]));
        writer.write_all(&bytes(EV_KEY, KeyCode::KEY_J.0, 1)).unwrap();
        writer.write_all(&bytes(EV_KEY, KeyCode::KEY_E.0, 1)[..7]).unwrap();
        assert_eq!(
            clock.at(&mut input, &mut input_state),
            PollOutcome::Present(vec!["manual_joint".into()])
        );
        assert!(input_state.deflection().is_none(), "half an event is none yet");
        writer.write_all(&bytes(EV_KEY, KeyCode::KEY_E.0, 1)[7..]).unwrap();
        clock.at(&mut input, &mut input_state);
        assert!(input_state.deflection().is_some());
        writer.write_all(&bytes(EV_KEY, KeyCode::KEY_E.0, 0)).unwrap();
        clock.at(&mut input, &mut input_state);
        assert!(input_state.deflection().is_none());
        writer.write_all(&bytes(EV_ABS, evdev::AbsoluteAxisCode::ABS_X.0, i32::MIN)).unwrap();
        clock.at(&mut input, &mut input_state);
        assert!(input_state.deflection().is_none(), "its dead-man's switch is up");
        writer.write_all(&bytes(EV_KEY, KeyCode::BTN_TL.0, 1)).unwrap();
        clock.at(&mut input, &mut input_state);
        assert!(
            input_state
                .deflection()
                .is_some_and(|(axes, _)| axes.iter().all(|axis| axis.abs() <= 1.0))
        );
    }

    #[test]
    fn an_overflow_and_the_end_release_all_keys() {
        let (mut input, mut writer, mut input_state) = pipe_input();
        let mut clock = PollClock(Nanos::ZERO);
        writer.write_all(&bytes(EV_KEY, KeyCode::KEY_E.0, 1)).unwrap();
        clock.at(&mut input, &mut input_state);
        assert!(input_state.deflection().is_some());
        // After SYN_DROPPED, the release of the key may be among the lost events.
        writer.write_all(&bytes(0, 3, 0)).unwrap();
        clock.at(&mut input, &mut input_state);
        assert!(input_state.deflection().is_none());
        writer.write_all(&[bytes(0, 0, 0), bytes(EV_KEY, KeyCode::KEY_E.0, 1)].concat()).unwrap();
        assert_eq!(clock.at(&mut input, &mut input_state), PollOutcome::Present(vec![]));
        assert!(input_state.deflection().is_some());
        drop(writer);
        assert_eq!(clock.at(&mut input, &mut input_state), PollOutcome::Gone);
    }

    #[test]
    fn a_stalled_pipe_releases_its_keys_until_new_events_arrive() {
        let (mut input, mut writer, mut input_state) = pipe_input();
        let mut clock = PollClock(Nanos::ZERO);
        let e = |value: i32| bytes(EV_KEY, KeyCode::KEY_E.0, value);
        // The key stays held until the keyboard would repeat, and from one repeat to the next.
        writer.write_all(&e(1)).unwrap();
        assert_eq!(clock.pushing(&mut input, &mut input_state, 100), PIPE_TIMEOUT_AFTER_PRESS);
        for _ in 0..5 {
            writer.write_all(&e(2)).unwrap();
            assert_eq!(
                clock.pushing(&mut input, &mut input_state, 4),
                POLL_INTERVAL * 4,
                "repeats hold it"
            );
        }
        assert_eq!(
            clock.pushing(&mut input, &mut input_state, 100),
            PIPE_TIMEOUT - POLL_INTERVAL * 4
        );
        // Events with or after a press do not shorten the wait for the first repeat.
        writer.write_all(&e(1)).unwrap();
        assert_eq!(clock.pushing(&mut input, &mut input_state, 1), POLL_INTERVAL);
        writer.write_all(&[0; EVENT_BYTES]).unwrap();
        assert_eq!(
            clock.pushing(&mut input, &mut input_state, 100),
            PIPE_TIMEOUT_AFTER_PRESS - POLL_INTERVAL
        );
        // Empty reports show that the writer is alive, not which keys are held.
        writer.write_all(&e(1)).unwrap();
        for _ in 0..20 {
            writer.write_all(&[0; EVENT_BYTES]).unwrap();
            assert_eq!(clock.pushing(&mut input, &mut input_state, 5), POLL_INTERVAL * 5);
        }
        assert_eq!(
            clock.pushing(&mut input, &mut input_state, 100),
            PIPE_TIMEOUT - POLL_INTERVAL * 5
        );
        writer.write_all(&[0; EVENT_BYTES]).unwrap();
        assert_eq!(clock.pushing(&mut input, &mut input_state, 5), Nanos::ZERO);
        // A command is sent once for each press, before a stall and after it.
        writer.write_all(&bytes(EV_KEY, KeyCode::KEY_J.0, 1)).unwrap();
        assert_eq!(
            clock.at(&mut input, &mut input_state),
            PollOutcome::Present(vec!["manual_joint".into()])
        );
        assert_eq!(clock.pushing(&mut input, &mut input_state, 50), Nanos::ZERO);
        writer.write_all(&bytes(EV_KEY, KeyCode::KEY_J.0, 2)).unwrap();
        assert_eq!(clock.at(&mut input, &mut input_state), PollOutcome::Present(vec![]));
    }

    #[test]
    fn a_flood_of_events_does_not_block_the_reader() {
        let (mut input, mut writer, mut input_state) = pipe_input();
        let mut clock = PollClock(Nanos::ZERO);
        fcntl(&writer, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
        let event = bytes(EV_KEY, KeyCode::KEY_E.0, 2);
        while writer.write_all(&event).is_ok() {}
        assert!(matches!(clock.at(&mut input, &mut input_state), PollOutcome::Present(_)));
        assert!(writer.write_all(&event).is_ok(), "something was read");
    }
}
