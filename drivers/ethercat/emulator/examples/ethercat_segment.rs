//! A segment of its own process on an interface of this machine, such as one end of a veth pair:
//! says so and answers until its standard input ends.
//!
//! `ethercat_segment INTERFACE [--devices ek1100,el4134,drive,...] [--product POSITION=NUMBER]
//! [--seed N] [--fault "kind=... target=ethercat"]...`

use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use taktil_drivers_ethercat_emulator::{
    Description, Model, RawSocket, Segment, idle_motors, serve,
};
use taktil_hal::fault::{Fault, FaultPlan};
use taktil_hal::{Clock, Nanos};
use taktil_rtcore::linux::MonotonicClock;

fn devices_of(names: &str) -> Result<Vec<Description>, String> {
    let model = |name: &str| {
        Model::from_name(name).map(Description::from).ok_or_else(|| format!("{name} is no model"))
    };
    names.split(',').map(model).collect()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let interface = arguments.next().ok_or("an interface is missing")?;
    let mut devices = devices_of("ek1100,el4134,el5101,el1008,el2008,drive")?;
    let (mut seed, mut faults) = (1, Vec::new());
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or("an option lacks its value")?;
        match name.as_str() {
            "--devices" => devices = devices_of(&value)?,
            "--product" => {
                let (position, number) = value.split_once('=').ok_or("POSITION=NUMBER")?;
                let number = u32::from_str_radix(number.trim_start_matches("0x"), 16)?;
                let device = devices.get_mut(position.parse::<usize>()?).ok_or("no such place")?;
                device.product = number;
            }
            "--seed" => seed = value.parse()?,
            "--fault" => faults.push(value.parse::<Fault>()?),
            _ => return Err(format!("{name} {value} is not known").into()),
        }
    }
    let plan = FaultPlan::new(faults);
    let mut segment = Segment::new(devices, idle_motors()).with_faults(plan, "ethercat", seed)?;
    let socket = RawSocket::open(&interface)?;
    println!("segment at {interface}");
    std::io::stdout().flush()?;
    let ended = Arc::new(AtomicBool::new(false));
    let flag = ended.clone();
    std::thread::spawn(move || {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        flag.store(true, Ordering::Relaxed);
    });
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    clock.sleep_until(Nanos::ZERO);
    serve(&mut segment, &socket, &clock, &mut |_, _| !ended.load(Ordering::Relaxed))?;
    let traffic = segment.traffic();
    println!(
        "frames {} cyclic {} bites {} states {:?} torques {:?}",
        traffic.frames,
        traffic.cyclic,
        segment.bites(),
        segment.states(),
        segment.outputs().torques
    );
    Ok(())
}
