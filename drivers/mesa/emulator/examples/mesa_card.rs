//! A card of its own process on a UDP socket of this machine: prints the address it listens on and
//! answers until its standard input ends. Behind it stand motors whose speed follows the volts.
//!
//! `mesa_card [--firmware 7i77|three-7i77|pwm] [--listen ADDRESS] [--seed N]
//! [--fault "kind=..."]...`

use std::io::{Read, Write};
use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use taktil_drivers_mesa_emulator::{Emulator, Firmware, Inputs, Outputs, serve};
use taktil_hal::fault::{Fault, FaultPlan};
use taktil_hal::{Clock, Nanos};
use taktil_rtcore::linux::MonotonicClock;

/// How fast a motor turns for a volt (counts a second).
const COUNTS_PER_VOLT_S: f64 = 2_000.0;

/// Motors whose speed follows the volts at once; field input n reads field output n, power is on.
fn motors() -> impl FnMut(Nanos, &Outputs) -> Inputs + Send {
    let (mut last, mut discs) = (None, [0.0; 6]);
    move |now, outputs| {
        let span = now - last.replace(now).unwrap_or(now);
        for (motor, disc) in discs.iter_mut().enumerate() {
            let pwm = outputs.pwm.get(motor).map_or(0.0, |duty| 10.0 * duty);
            *disc += COUNTS_PER_VOLT_S * (outputs.volts[motor] + pwm) * span.as_secs_f64();
        }
        Inputs {
            counts: discs.iter().map(|disc: &f64| disc.floor() as i64).collect(),
            field: u32::from(outputs.field) | 0x0700_0000,
            pins: vec![0x0700_0000 >> 8; 3],
            ..Inputs::default()
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut firmware, mut listen) = (Firmware::with_7i77(), "127.0.0.1:0".to_owned());
    let (mut seed, mut faults) = (1, Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or("an option lacks its value")?;
        match name.as_str() {
            "--firmware" if value == "pwm" => firmware = Firmware::with_pwm(),
            "--firmware" if value == "three-7i77" => firmware = Firmware::with_three_7i77(),
            "--firmware" if value == "7i77" => {}
            "--listen" => listen = value,
            "--seed" => seed = value.parse()?,
            "--fault" => faults.push(value.parse::<Fault>()?),
            _ => return Err(format!("{name} {value} is not known").into()),
        }
    }
    let socket = UdpSocket::bind(listen)?;
    println!("{}", socket.local_addr()?);
    std::io::stdout().flush()?;
    let ended = Arc::new(AtomicBool::new(false));
    let flag = ended.clone();
    std::thread::spawn(move || {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        flag.store(true, Ordering::Relaxed);
    });
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    clock.sleep_until(Nanos::ZERO);
    let mut emulator = Emulator::new(firmware, 4_000, Box::new(motors())).with_faults(
        FaultPlan::new(faults),
        "mesa",
        seed,
    );
    serve(&mut emulator, &socket, &clock, &mut || !ended.load(Ordering::Relaxed))?;
    println!("bites {} overruns {}", emulator.bites(), emulator.overrun_commands());
    Ok(())
}
