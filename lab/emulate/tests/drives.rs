//! The production drivers of CAN and Net F/T over the emulated robot in virtual time: torques turn
//! its motors, positions follow its discs, and the box shows what its wrist feels.

mod common;

#[expect(clippy::disallowed_types, reason = "test and drivers look at one robot")]
use std::sync::Mutex;
use std::sync::{Arc, MutexGuard};

use common::{CYCLE_PERIOD, pressed_scene};
use taktil_drivers_can::frame::FLEXIBLE_BYTES;
use taktil_drivers_can::{Config, Frame, Halves, NodeConfig, Port, SendError, attach};
use taktil_drivers_netft::{self as netft, Arrival, NetFt};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{
    AnalogOut, CHANNELS, DacCode, DigitalIn, DigitalOut, Encoders, ErrorKind, ForceTorque,
    LinesOut, Nanos,
};
use taktil_lab_emulate::{BoardKind, EmulatedRobot, Traffic};

/// The request by which a box begins to send.
const START_REQUEST: [u8; 8] = [0x12, 0x34, 0, 2, 0, 0, 0, 0];
/// A torque that moves joint 1 against its friction, in thousandths of full scale.
const PUSH_CODE: i32 = 340;

/// A robot behind drives and a box.
#[derive(Clone)]
#[expect(clippy::disallowed_types, reason = "test and drivers look at one robot")]
struct Robot(Arc<Mutex<EmulatedRobot>>);

impl Robot {
    #[expect(clippy::disallowed_types, reason = "test and drivers look at one robot")]
    fn new(faults: &[&str]) -> Robot {
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let boards = [BoardKind::Can, BoardKind::Netft];
        let robot = EmulatedRobot::new(&pressed_scene(""), &boards, &plan, 1).unwrap();
        Robot(Arc::new(Mutex::new(robot)))
    }

    fn lock(&self) -> MutexGuard<'_, EmulatedRobot> {
        self.0.lock().unwrap()
    }
}

/// The bus, which is the first of the robot's boards.
struct VirtualBus {
    robot: Robot,
    end: Nanos,
    frames: Vec<Frame>,
}

impl VirtualBus {
    fn collect(&mut self) -> Option<Frame> {
        let frames = &mut self.frames;
        let mut take = |bytes: &[u8]| frames.extend(Frame::read(bytes));
        self.robot.lock().deliver(0, &mut take);
        (!self.frames.is_empty()).then(|| self.frames.remove(0))
    }
}

impl Port for VirtualBus {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let mut bytes = [0; FLEXIBLE_BYTES];
        let count = frame.write(&mut bytes);
        self.robot.lock().receive(0, &bytes[..count]);
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        self.end = self.robot.lock().now() + wait;
    }

    fn receive(&mut self) -> Option<Frame> {
        loop {
            if let Some(frame) = self.collect() {
                return Some(frame);
            }
            let mut robot = self.robot.lock();
            if robot.now() >= self.end {
                return None;
            }
            let due = robot.next_due(0).min(self.end);
            robot.advance(due);
        }
    }

    fn receive_now(&mut self) -> Option<Frame> {
        self.collect()
    }
}

/// The box, which is the second one.
struct VirtualBox {
    robot: Robot,
    records: Vec<Vec<u8>>,
}

impl netft::Port for VirtualBox {
    fn send(&mut self, packet: &[u8]) -> std::io::Result<()> {
        self.robot.lock().receive(1, packet);
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Arrival {
        let records = &mut self.records;
        self.robot.lock().deliver(1, &mut |bytes| records.push(bytes.to_vec()));
        if self.records.is_empty() {
            return Arrival::Nothing;
        }
        let record = self.records.remove(0);
        let length = record.len().min(buffer.len());
        buffer[..length].copy_from_slice(&record[..length]);
        Arrival::Datagram(length)
    }
}

/// Drives, box and robot, cycle by cycle.
struct Lane {
    robot: Robot,
    drives: Halves,
    wrist: NetFt,
    release: Nanos,
    feed: bool,
}

impl Lane {
    fn new(faults: &[&str]) -> Lane {
        let robot = Robot::new(faults);
        let nodes = (1..=6).map(|id| NodeConfig { id, ..NodeConfig::default() }).collect();
        let config = Config { interface: "emulated".to_owned(), nodes, ..Config::default() };
        let bus = VirtualBus { robot: robot.clone(), end: Nanos::ZERO, frames: Vec::new() };
        let drives = attach(Box::new(bus), &config).unwrap();
        let mut link = VirtualBox { robot: robot.clone(), records: Vec::new() };
        netft::Port::send(&mut link, &START_REQUEST).unwrap();
        let config = netft::Config { rate_hz: 1_000, ..netft::Config::default() };
        let wrist = NetFt::new(Box::new(link), &config);
        let release = robot.lock().now() + CYCLE_PERIOD;
        Lane { robot, drives, wrist, release, feed: false }
    }

    /// The count of joint 1 after a cycle, and the codes of the wrist.
    fn cycle(&mut self, enable: bool, code: i32) -> (Result<i32, ErrorKind>, Option<[i32; 6]>) {
        let release = self.release;
        self.robot.lock().advance(release);
        let counts = self.drives.encoders.sample(release);
        let gauges = self.wrist.sample(release).ok();
        let mut codes = [DacCode(0); CHANNELS];
        codes[0] = DacCode(code);
        let _ = self.drives.analog_out.as_mut().unwrap().commit(release, &codes);
        self.feed = !self.feed;
        let lines = LinesOut { enable, brake_release: enable, watchdog_feed: self.feed };
        let _ = self.drives.digital_out.as_mut().unwrap().commit(release, &lines);
        self.release += CYCLE_PERIOD;
        let codes = gauges.map(|reading| reading.value.codes.map(|code| code.0));
        (counts.map(|reading| reading.value[0].0).map_err(|error| error.kind), codes)
    }
}

#[test]
fn torques_turn_the_motor_in_their_direction_and_positions_come_back() {
    for sign in [1, -1] {
        let mut lane = Lane::new(&[]);
        for _ in 0..40 {
            assert_eq!(lane.cycle(false, 0).0, Ok(0), "the brakes hold");
        }
        let lines = lane.drives.digital_in.sample(lane.release - CYCLE_PERIOD).unwrap().value;
        assert!(lines.drive_power && lines.estop_a_closed, "{lines:?}");
        let mut last = 0;
        for _ in 0..120 {
            last = lane.cycle(true, sign * PUSH_CODE).0.unwrap();
        }
        assert!(sign * last > 50, "{last} counts for {sign}");
    }
}

#[test]
fn a_finger_that_presses_shows_in_the_box() {
    let mut lane = Lane::new(&[]);
    let gauges: Vec<_> = (0..200).filter_map(|_| lane.cycle(false, 0).1).collect();
    assert!(gauges.len() > 190, "{} readings", gauges.len());
    // The load of a pressed pin, in codes: it is there, and it does not jump.
    let last = gauges[gauges.len() - 1];
    assert!(last.iter().any(|code| code.abs() > 10), "{last:?}");
    let Some(Traffic::Wrist(traffic)) = lane.robot.lock().traffic(1) else { panic!("a box") };
    assert!(traffic.records > 450, "{traffic:?}");
}

#[test]
fn a_fault_of_one_drive_stops_the_arm() {
    let mut lane = Lane::new(&["kind=failing target=can.3 value=1 at=0.5"]);
    let mut counts = Vec::new();
    for _ in 0..400 {
        counts.push(lane.cycle(true, PUSH_CODE).0.unwrap());
    }
    assert!(counts[180].abs() > 50, "{}", counts[180]);
    assert_eq!(counts[330], counts[399], "brakes on, motors without current");
    let lines = lane.drives.digital_in.sample(lane.release - CYCLE_PERIOD).unwrap().value;
    assert!(!lines.estop_a_closed && lines.drive_power);
}

#[test]
fn faults_of_drives_that_are_not_there_are_refused() {
    let scene = pressed_scene("");
    for fault in ["kind=silence target=can.7", "kind=torn value=1 target=can.1"] {
        let plan = FaultPlan::new(vec![fault.parse().unwrap()]);
        assert!(EmulatedRobot::new(&scene, &[BoardKind::Can], &plan, 1).is_err(), "{fault}");
    }
    let box_fault = FaultPlan::new(vec!["kind=loss value=1 target=netft.1".parse().unwrap()]);
    assert!(EmulatedRobot::new(&scene, &[BoardKind::Netft], &box_fault, 1).is_err());
}

#[test]
fn equal_bytes_give_equal_bits() {
    let run = || {
        let mut lane = Lane::new(&["kind=loss value=0.02 at=0.1"]);
        (0..200).map(|_| lane.cycle(true, PUSH_CODE)).collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}
