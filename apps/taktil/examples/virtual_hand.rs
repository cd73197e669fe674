//! A virtual keyboard and a virtual gamepad that are connected through /dev/uinput, and the check
//! of the arm's motion. It needs a host or a guest with the kernel modules `uinput` and `evdev`;
//! `tests/rt-guest/keys` boots one.
//!
//!     virtual_hand act SOCKET > events    beside `taktil run .. --operator SOCKET --log LOG`
//!     virtual_hand judge LOG EVENTS [MS]  after the run; as if keys had gone up MS earlier
//!
//! `act` prints the time of each press, release and disconnection by the monotonic clock. `judge`
//! finds them in the log. It fails when a joint does not move while its key is held, or still moves
//! later than [`DELAY_MAX_MS`] after the key was released or its device disconnected.

use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use evdev::uinput::VirtualDevice;
use evdev::{AbsInfo, AbsoluteAxisCode, AttributeSet, InputEvent, KeyCode, UinputAbsSetup};
use taktil_machine_console::out;
use taktil_record::{Log, METADATA_RESULT};
use taktil_rtcore::linux;

/// Largest time from the press to the first motion, and from the release or the unplugging to the
/// last motion (ms).
const DELAY_MAX_MS: f64 = 100.0;
/// Smallest motion of the measured joint while its key is held (deg).
const MOTION_MIN_DEG: f64 = 1.0;
/// Time for which a key is held, and time between two presses.
const PRESS_TIME: Duration = Duration::from_millis(500);
/// The stick that pushes joint 3.
const JOINT_3_STICK: AbsoluteAxisCode = AbsoluteAxisCode::ABS_RY;

fn main() -> anyhow::Result<ExitCode> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["act", socket] => act(socket).map(|()| ExitCode::SUCCESS),
        ["judge", log, events] => judge(Path::new(log), Path::new(events), 0.0),
        ["judge", log, events, ms] => judge(Path::new(log), Path::new(events), ms.parse()?),
        _ => bail!("say `virtual_hand act SOCKET` or `virtual_hand judge LOG EVENTS [MS]`"),
    }
}

/// Prints an event with its time.
fn print_event(what: &str, device: &str, joint: usize) -> anyhow::Result<()> {
    out::line(format_args!("{what} {device} {joint} {}", linux::monotonic().0))?;
    Ok(())
}

/// Sends words to the machine and returns its answer.
fn send(socket: &str, words: &str) -> anyhow::Result<String> {
    let mut command = Command::new("taktil");
    let said = command.args(["tell", "--at", socket, words]).output()?;
    Ok(String::from_utf8_lossy(&said.stdout).into_owned())
}

fn keyboard() -> std::io::Result<VirtualDevice> {
    let mut keys = AttributeSet::<KeyCode>::new();
    [KeyCode::KEY_J, KeyCode::KEY_3, KeyCode::KEY_G].into_iter().for_each(|key| keys.insert(key));
    VirtualDevice::builder()?.name("taktil keyboard").with_keys(&keys)?.build()
}

fn gamepad() -> std::io::Result<VirtualDevice> {
    let mut keys = AttributeSet::<KeyCode>::new();
    keys.insert(KeyCode::BTN_TL);
    let way = UinputAbsSetup::new(JOINT_3_STICK, AbsInfo::new(0, -128, 127, 0, 0, 1));
    let builder = VirtualDevice::builder()?.name("taktil gamepad");
    builder.with_keys(&keys)?.with_absolute_axis(&way)?.build()
}

/// `taktil keys` with these devices.
fn reader(socket: &str, devices: &mut [&mut VirtualDevice]) -> anyhow::Result<Child> {
    let mut command = Command::new("taktil");
    command.args(["keys", "--at", socket]).stdout(Stdio::null());
    for device in devices {
        let path = device.enumerate_dev_nodes_blocking()?.find_map(Result::ok);
        command.arg("--device").arg(path.context("the kernel made no device")?);
    }
    Ok(command.spawn()?)
}

fn act(socket: &str) -> anyhow::Result<()> {
    let ready = |_: &u32| matches!(send(socket, "state"), Ok(said) if said.contains("CALIBRATED"));
    let mut looks = (0..100).inspect(|_| std::thread::sleep(Duration::from_millis(100)));
    looks.find(ready).context("the machine does not get to IDLE/CALIBRATED")?;
    let (mut keyboard, mut pad) = (keyboard()?, gamepad()?);
    let mut reader = reader(socket, &mut [&mut keyboard, &mut pad])?;
    let key = |key: KeyCode, value: i32| InputEvent::new(1, key.0, value);
    let pause = || std::thread::sleep(PRESS_TIME);
    pause();
    for once in [KeyCode::KEY_J, KeyCode::KEY_3] {
        keyboard.emit(&[key(once, 1)])?;
        pause();
        keyboard.emit(&[key(once, 0)])?;
    }
    // The stick alone moves nothing, because its dead-man's switch is up.
    pad.emit(&[InputEvent::new(3, JOINT_3_STICK.0, -128)])?;
    pause();
    for last in [false, true] {
        print_event("press", "keyboard", 5)?;
        keyboard.emit(&[key(KeyCode::KEY_G, 1)])?;
        pause();
        if !last {
            print_event("release", "keyboard", 5)?;
            keyboard.emit(&[key(KeyCode::KEY_G, 0)])?;
            pause();
        }
    }
    print_event("pull", "keyboard", 5)?;
    drop(keyboard);
    pause();
    for last in [false, true] {
        print_event("press", "gamepad", 3)?;
        pad.emit(&[key(KeyCode::BTN_TL, 1)])?;
        pause();
        if !last {
            print_event("release", "gamepad", 3)?;
            pad.emit(&[key(KeyCode::BTN_TL, 0)])?;
            pause();
        }
    }
    print_event("pull", "gamepad", 3)?;
    drop(pad);
    let code = reader.wait()?.code();
    ensure!(code == Some(1), "`taktil keys` ended with {code:?} when no device was left");
    Ok(())
}

/// A press of a key and how it ended, in ns of the monotonic clock.
struct KeyPress {
    device: String,
    joint: usize,
    ended: String,
    from_ns: f64,
    until_ns: f64,
}

fn events(path: &Path) -> anyhow::Result<Vec<KeyPress>> {
    let text = std::fs::read_to_string(path)?;
    let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(' ').collect()).collect();
    let pair = |pair: &[Vec<&str>]| match (&pair[0][..], &pair[1][..]) {
        (["press", device, joint, from], [ended, same, _, until]) if device == same => {
            Ok(KeyPress {
                device: (*device).to_owned(),
                joint: joint.parse()?,
                ended: (*ended).to_owned(),
                from_ns: from.parse()?,
                until_ns: until.parse()?,
            })
        }
        other => bail!("no press and its end: {other:?}"),
    };
    ensure!(lines.len().is_multiple_of(2), "a press without an end");
    lines.chunks(2).map(pair).collect()
}

/// The time of the monotonic clock at the log's zero (ns).
fn zero_ns(log: &Log) -> anyhow::Result<f64> {
    let clock = log.metadata().get(METADATA_RESULT).and_then(|result| result.get("clock"));
    let clock: serde_json::Value = serde_json::from_str(clock.context("no clock in the log")?)?;
    let number = |key: &str| clock[key].as_f64().context("no such number in the log's clock");
    ensure!(number("slipped_ns")?.abs() < 1e6, "the simulation was late: {clock}");
    number("monotonic_ns")
}

fn judge(log: &Path, said: &Path, earlier_ms: f64) -> anyhow::Result<ExitCode> {
    let (log, presses) = (Log::open(log)?, events(said)?);
    let zero_ns = zero_ns(&log)?;
    let wanted = log.series("setpoint.desired").context("no setpoint.desired in the log")?;
    let measured = log.series("sense.joints").context("no sense.joints in the log")?;
    let angle = wanted.column("q_rad").context("no q_rad")?;
    let moves = |row: &usize| angle.row(*row) != angle.row(*row - 1);
    let rows = |low_s: f64, high_s: f64| {
        let row = |t_s: f64| wanted.t_s.partition_point(|t| *t < t_s).max(1);
        row(low_s)..row(high_s)
    };
    let at = |ns: f64| (ns - zero_ns) / 1e9;
    let begin_s = presses.first().map_or(0.0, |first| at(first.from_ns));
    // Before the first press the stick was moved while its dead-man's switch was up.
    let mut passed = presses.len() == 4 && !rows(begin_s - 0.4, begin_s).any(|row| moves(&row));
    for (number, held) in presses.iter().enumerate() {
        let (from_s, until_s) = (at(held.from_ns), at(held.until_ns - earlier_ms * 1e6));
        let next_s = presses.get(number + 1).map_or(f64::MAX, |next| at(next.from_ns));
        let first = rows(from_s, until_s).find(moves).map(|row| wanted.t_s[row]);
        let last = rows(until_s, next_s).rfind(moves).map_or(until_s, |row| wanted.t_s[row]);
        let way = |t_s: f64| {
            let row = measured.row_at(t_s)?;
            measured.column("q_rad")?.row(row).get(held.joint - 1).copied()
        };
        let rest_at_s = (last + 0.2).min(next_s);
        let moved_deg = way(rest_at_s).zip(way(from_s)).map_or(0.0, |(a, b)| (a - b).to_degrees());
        let starts_ms = first.map_or(f64::INFINITY, |t_s| 1e3 * (t_s - from_s));
        let rest_ms = 1e3 * (last - until_s);
        let held_on = rows(from_s + DELAY_MAX_MS / 1e3, until_s).all(|row| moves(&row));
        let good = starts_ms <= DELAY_MAX_MS
            && held_on
            && rest_ms <= DELAY_MAX_MS
            && moved_deg.abs() > MOTION_MIN_DEG;
        passed &= good;
        let KeyPress { device, ended, joint, .. } = held;
        out::line(format_args!(
            "rt-guest check=keys device={device} ended_by={ended} joint={joint} \
             held_ms={:.1} starts_ms={starts_ms:.1} rest_ms={rest_ms:.1} limit_ms={DELAY_MAX_MS} \
             moved_deg={moved_deg:.2} verdict={}",
            1e3 * (until_s - from_s),
            if good { "pass" } else { "fail" }
        ))?;
    }
    Ok(if passed { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
