//! A card in a process of its own: the test program starts itself again under the name of a test
//! that serves an emulated card over UDP.
#![allow(dead_code, reason = "each test program uses a part of it")]

use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};

use taktil_drivers_mesa::Config;
use taktil_drivers_mesa_emulator::{Emulator, Firmware, Inputs, Outputs, serve};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{Clock, Nanos};
use taktil_rtcore::linux::MonotonicClock;

/// The name under which a test program starts itself as a card.
const CARD_TEST: &str = "the_card_of_the_other_tests";
/// The variable that tells it the faults of its link.
const FAULTS_VARIABLE: &str = "MESA_CARD_FAULTS";
/// The variable that tells it what is wrong with its firmware.
const FIRMWARE_VARIABLE: &str = "MESA_CARD_FIRMWARE";

/// A card in a process of its own.
pub(crate) struct Card {
    process: Child,
    pub(crate) address: String,
}

impl Card {
    pub(crate) fn start(faults: &str) -> Card {
        Card::with_firmware("", faults)
    }

    /// A card whose firmware is that of a 7I92 with a 7I77, but for what `deviation` names.
    pub(crate) fn with_firmware(deviation: &str, faults: &str) -> Card {
        let mut process = Command::new(std::env::current_exe().unwrap())
            .args([CARD_TEST, "--exact", "--ignored", "--nocapture"])
            .env(FAULTS_VARIABLE, faults)
            .env(FIRMWARE_VARIABLE, deviation)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let line = lines.map_while(Result::ok).find_map(|line| {
            line.split_once("card at ").map(|(_, address)| address.trim().to_owned())
        });
        Card { process, address: line.expect("the card tells its address") }
    }

    pub(crate) fn config(&self) -> Config {
        // A shared machine: waits are generous, what they cost is not judged here.
        Config {
            address: self.address.clone(),
            period_us: 100_000,
            wait_share: 0.9,
            lost_ms: 10_000,
            watchdog_ms: 5_000,
            remote_watchdog_ms: 10_000,
            open_wait_ms: 1_000,
            ..Config::default()
        }
    }
}

impl Drop for Card {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Motors that turn by 100 counts a second for each volt.
fn motors() -> impl FnMut(Nanos, &Outputs) -> Inputs + Send {
    let (mut last, mut disc) = (None, 0.0);
    move |now, outputs: &Outputs| {
        let span = now - last.replace(now).unwrap_or(now);
        disc += 100.0 * outputs.volts[0] * span.as_secs_f64();
        Inputs { counts: vec![disc as i64; 6], pins: vec![0; 2], ..Inputs::default() }
    }
}

/// A firmware that deviates from that of a 7I92 with a 7I77.
fn firmware(deviation: &str) -> Firmware {
    let base = Firmware::with_7i77();
    let without = |tag| {
        let mut firmware = base.clone();
        firmware.modules.retain(|module| module.tag != tag);
        firmware
    };
    match deviation {
        "cookie" => Firmware { cookie: 0xdead_beef, ..base },
        "config" => Firmware { config_name: *b"SOMETHNG", ..base },
        "idrom" => Firmware { idrom_type: 9, ..base },
        "name" => Firmware { board_name: *b"MESA7I80", ..base },
        "no watchdog" => without(2),
        "no encoders" => without(12),
        "no serial" => without(193),
        "pins" => {
            // Smart serial has one channel only; what the second one had is free.
            let mut firmware = base;
            for pin in &mut firmware.pins {
                if pin.tag == 193 && pin.function & 0x0f > 1 {
                    *pin = taktil_drivers_mesa_emulator::PinEntry { primary: 3, ..*pin };
                    (pin.tag, pin.function) = (0, 0);
                }
            }
            firmware
        }
        "no remote" => Firmware { remotes: vec![([0; 4], 0); 3], ..base },
        "other remote" => Firmware { remotes: vec![(*b"7I76", 0x1400_0001); 3], ..base },
        _ => base,
    }
}

/// Serves a card for two minutes, in a process that was started for it; otherwise does nothing.
pub(crate) fn serve_card() {
    let Ok(faults) = std::env::var(FAULTS_VARIABLE) else { return };
    let plan = faults.split(';').filter(|text| !text.is_empty());
    let plan = FaultPlan::new(plan.map(|text| text.parse().unwrap()).collect());
    let firmware = firmware(&std::env::var(FIRMWARE_VARIABLE).unwrap_or_default());
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    println!("card at {}", socket.local_addr().unwrap());
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let mut emulator =
        Emulator::new(firmware, 1_000, Box::new(motors())).with_faults(plan, "mesa", 1);
    let mut goes_on = || clock.now() < Nanos::from_secs(120);
    serve(&mut emulator, &socket, &clock, &mut goes_on).unwrap();
}
