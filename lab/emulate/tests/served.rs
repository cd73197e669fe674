//! The production drivers of CAN and Net F/T over the sockets of a server in real time, as
//! `taktil hal emulate can netft` runs it.

mod common;

use common::pressed_scene;
use taktil_drivers_can::{Config, NodeConfig};
use taktil_drivers_netft as netft;
use taktil_hal::fault::FaultPlan;
use taktil_hal::{
    AnalogOut, CHANNELS, Clock, DacCode, DigitalOut, Encoders, ForceTorque, LinesOut, Nanos,
};
use taktil_lab_emulate::{BoardKind, EmulatedRobot, Places, Server};
use taktil_rtcore::linux::MonotonicClock;

/// How long the boards are served.
const SERVICE_TIME: Nanos = Nanos::from_secs(8);
const CYCLE_PERIOD: Nanos = Nanos::from_millis(5);
/// A torque that moves joint 1 against its friction, in thousandths of full scale.
const PUSH_CODE: i32 = 340;

#[test]
fn drives_and_wrist_are_served_over_sockets() {
    let boards = [BoardKind::Can, BoardKind::Netft];
    let robot = EmulatedRobot::new(&pressed_scene(""), &boards, &FaultPlan::default(), 1).unwrap();
    let path = std::env::temp_dir().join(format!("taktil-served-{}", std::process::id()));
    let places = Places { links: vec![path.clone()], ..Places::default() };
    let mut server = Server::open(robot, &places).unwrap();
    assert_eq!(server.place(0).unwrap(), path.display().to_string());
    let address = server.place(1).unwrap();
    let thread = std::thread::spawn(move || {
        let clock = MonotonicClock::since_boot();
        let mut is_over = |robot: &EmulatedRobot| robot.now() >= SERVICE_TIME;
        server.run(&clock, &mut is_over, &mut |_, _| ()).unwrap();
    });
    let nodes = (1..=6).map(|id| NodeConfig { id, ..NodeConfig::default() }).collect();
    // A shared machine: waits are generous, what they cost is not judged here.
    let config = Config {
        interface: path.display().to_string(),
        nodes,
        period_us: 100_000,
        wait_share: 0.5,
        lost_ms: 5_000,
        silence_ms: 4_000,
        open_wait_ms: 5_000,
        ..Config::default()
    };
    let mut drives = taktil_drivers_can::open(&config).unwrap();
    let config =
        netft::Config { address, rate_hz: 1_000, stale_ms: 1_000, ..netft::Config::default() };
    let mut wrist = netft::open(&config).unwrap();
    let clock = MonotonicClock::since_boot();
    let start = clock.now();
    let (mut counts, mut readings) = (0, 0);
    for cycle in 1..=200 {
        let release = start + CYCLE_PERIOD * cycle;
        clock.sleep_until(release);
        if let Ok(reading) = drives.encoders.sample(release) {
            counts = reading.value[0].0;
        }
        readings += u32::from(wrist.sample(release).is_ok());
        let mut codes = [DacCode(0); CHANNELS];
        codes[0] = DacCode(PUSH_CODE);
        let _ = drives.analog_out.as_mut().unwrap().commit(release, &codes);
        let watchdog_feed = cycle % 2 == 1;
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed };
        let _ = drives.digital_out.as_mut().unwrap().commit(release, &lines);
    }
    let seen = drives.monitor.counts();
    assert!(counts > 50, "{counts} counts: {seen:?}");
    assert!(readings > 150, "{readings} readings: {:?}", wrist.counts());
    drop((drives, wrist));
    thread.join().unwrap();
    assert!(!path.exists(), "the socket goes with the server");
}
