//! A box of its own process on a UDP socket of this machine: prints the address it listens on and
//! answers until its standard input ends. The force of its sensor swings about zero.
//!
//! `netft_box [--listen ADDRESS] [--rate HZ] [--seed N] [--fault "kind=..."]...`

use std::io::{Read, Write};
use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use taktil_drivers_netft_emulator::{Emulator, serve};
use taktil_hal::fault::{Fault, FaultPlan};
use taktil_hal::{Clock, Nanos};
use taktil_rtcore::linux::MonotonicClock;

/// Newtons and newton metres in counts.
const COUNTS_PER_UNIT: f64 = 1e6;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut listen, mut rate_hz) = ("127.0.0.1:0".to_owned(), 1_000);
    let (mut seed, mut faults) = (1, Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or("an option lacks its value")?;
        match name.as_str() {
            "--listen" => listen = value,
            "--rate" => rate_hz = value.parse()?,
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
    // A triangle of 5 N and 2 s along z.
    let sensor = |now: Nanos| {
        let phase = now.as_secs_f64() % 2.0;
        let force = 10.0 * (1.0 - phase).abs() - 5.0;
        [0, 0, (force * COUNTS_PER_UNIT) as i32, 0, 0, 0]
    };
    let mut emulator =
        Emulator::new(rate_hz, Box::new(sensor)).with_faults(FaultPlan::new(faults), "netft", seed);
    serve(&mut emulator, &socket, &clock, &mut || !ended.load(Ordering::Relaxed))?;
    println!("records {}", emulator.traffic().records);
    Ok(())
}
