//! The driver on a CAN interface of the kernel, with the emulated drives in another process on the
//! same one. `TAKTIL_CAN` names it, such as `vcan0`; without an interface of this name the test
//! says that it was skipped. **Never with a robot on the bus**: torques go over their whole range.

use std::io::{self, Write};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use taktil_drivers_can::frame::FLEXIBLE_BYTES;
use taktil_drivers_can::{Config, Frame, Halves, NodeConfig, Port, Protocol, SocketPort, open};
use taktil_drivers_can_emulator::{Emulator, Kind, Link, serve};
use taktil_hal::conformance::{
    CycleDriver, check_analog_out, check_digital_in, check_digital_out, check_encoders,
};
use taktil_hal::{
    AnalogOut, CHANNELS, Clock, DacCode, DigitalOut, Encoders, LinesOut, Nanos, OpenError,
};
use taktil_rtcore::linux::MonotonicClock;

/// The variable that names the interface.
const INTERFACE_VARIABLE: &str = "TAKTIL_CAN";
/// The variable that makes this program the drives, and which ones.
const DRIVES_VARIABLE: &str = "TAKTIL_CAN_DRIVES";
const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);
const DRIVE_IDS: [u8; 3] = [1, 5, 9];
/// Cycles with the drives enabled.
const DRIVEN_CYCLES: i64 = 400;

/// Carries frames between the interface and the emulator, as they are.
struct Bridge(SocketPort);

impl Link for Bridge {
    fn receive(&mut self, bytes: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        self.0.start_wait(Nanos(wait.as_nanos() as i64));
        let Some(frame) = self.0.receive() else { return Ok(None) };
        let mut own = [0; FLEXIBLE_BYTES];
        let count = frame.write(&mut own);
        bytes[..count].copy_from_slice(&own[..count]);
        Ok(Some(count))
    }

    fn send(&mut self, bytes: &[u8]) {
        let _ = Frame::read(bytes).map(|frame| self.0.send(&frame));
    }
}

struct Drives(Child);

impl Drives {
    fn start(protocol: Protocol) -> Drives {
        let child = Command::new(std::env::current_exe().unwrap())
            .env(DRIVES_VARIABLE, format!("{protocol:?}"))
            .args(["--exact", "drives_on_an_interface_of_the_kernel_conform_and_turn"])
            .stdout(Stdio::null())
            .spawn();
        Drives(child.unwrap())
    }
}

impl Drop for Drives {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn config(interface: &str, protocol: Protocol) -> Config {
    let node = |id| NodeConfig { id, ..NodeConfig::default() };
    Config {
        interface: interface.to_owned(),
        protocol,
        nodes: DRIVE_IDS.map(node).to_vec(),
        // The other process may be kept from running for some cycles.
        lost_ms: 2_000,
        silence_ms: 1_000,
        open_wait_ms: 5_000,
        ..Config::default()
    }
}

fn be_the_drives(interface: &str, protocol: &str) {
    let kind = match protocol {
        "Moteus" => Kind::Moteus,
        "Odrive" => Kind::Odrive,
        _ => Kind::CanOpen(1_000),
    };
    let mut link = Bridge(SocketPort::open(interface).unwrap());
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    clock.sleep_until(Nanos::ZERO);
    let mut goes_on = || clock.now() < Nanos::from_secs(60);
    serve(&mut Emulator::new(kind, &DRIVE_IDS), &mut link, &clock, &mut goes_on).unwrap();
}

/// Enables the drives and turns them; readings, the last count, and the wait of the longest cycle.
fn drive(halves: &mut Halves, clock: &dyn Clock) -> (u64, i32, Nanos) {
    let start = clock.now();
    let (mut good, mut last, mut longest) = (0, 0, Nanos::ZERO);
    for cycle in 1..=DRIVEN_CYCLES {
        let release = start + CYCLE_PERIOD * cycle;
        clock.sleep_until(release);
        let begin = clock.now();
        if let Ok(reading) = halves.encoders.sample(release) {
            (good, last) = (good + 1, reading.value[0].0);
        }
        longest = longest.max(clock.now() - begin);
        let _ = halves.analog_out.as_mut().unwrap().commit(release, &[DacCode(300); CHANNELS]);
        let watchdog_feed = cycle % 2 == 1;
        // The first wish acknowledges what the suite's silence did to a watchdog.
        let enable = !(20..40).contains(&cycle);
        let lines = LinesOut { enable, brake_release: enable, watchdog_feed };
        let _ = halves.digital_out.as_mut().unwrap().commit(release, &lines);
    }
    (good, last, longest)
}

#[test]
fn drives_on_an_interface_of_the_kernel_conform_and_turn() {
    let interface = std::env::var(INTERFACE_VARIABLE).unwrap_or_else(|_| "vcan0".to_owned());
    if let Ok(protocol) = std::env::var(DRIVES_VARIABLE) {
        return be_the_drives(&interface, &protocol);
    }
    let say = |text: String| io::stderr().write_all(text.as_bytes()).unwrap();
    if let Err(error) = SocketPort::open(&interface) {
        return say(format!(
            "SKIPPED: needs the CAN interface {interface} ({error}); make a vcan and name it in \
             {INTERFACE_VARIABLE}\n"
        ));
    }
    for protocol in [Protocol::Canopen, Protocol::Moteus, Protocol::Odrive] {
        let _drives = Drives::start(protocol);
        let clock = MonotonicClock::since_boot();
        let mut opened: Result<Halves, OpenError> = open(&config(&interface, protocol));
        for _ in 0..5 {
            // The other process may not have come up.
            if opened.is_err() {
                opened = open(&config(&interface, protocol));
            }
        }
        let mut halves = opened.unwrap_or_else(|error| panic!("{protocol:?}: {error}"));
        let mut bench = CycleDriver::new(clock.now() + CYCLE_PERIOD, CYCLE_PERIOD, |release| {
            clock.sleep_until(release);
        });
        assert_eq!(check_encoders(&mut halves.encoders, &mut bench), [], "{protocol:?}");
        assert_eq!(check_digital_in(&mut halves.digital_in, &mut bench), [], "{protocol:?}");
        assert_eq!(
            check_analog_out(halves.analog_out.as_mut().unwrap(), &mut bench),
            [],
            "{protocol:?}"
        );
        assert_eq!(
            check_digital_out(halves.digital_out.as_mut().unwrap(), &mut bench),
            [],
            "{protocol:?}"
        );
        drop(bench);
        let (good, last, longest) = drive(&mut halves, &clock);
        let counts = halves.monitor.counts();
        say(format!(
            "{protocol:?}: {good} of {DRIVEN_CYCLES} cycles answered, {last} counts, longest \
             exchange {longest}\n"
        ));
        assert!(good > DRIVEN_CYCLES as u64 / 2 && last > 1_000, "{protocol:?}: {counts:?}");
    }
}
