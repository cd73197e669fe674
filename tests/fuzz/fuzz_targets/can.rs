//! Whatever is said on a CAN bus: frames of drives that are lost, cut, altered or made up, of all
//! three protocols. The driver opens or refuses with a place and a remedy, and runs with bounded
//! work; when its halves go safe, no emulated drive has torque.
#![no_main]

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use libfuzzer_sys::fuzz_target;
use taktil_drivers_can::frame::FLEXIBLE_BYTES;
use taktil_drivers_can::moteus::registers;
use taktil_drivers_can::{
    Config, DriveMode, Frame, Halves, NodeConfig, Port, Protocol, SendError, attach, sdo,
};
use taktil_drivers_can_emulator::{BusFrame, Emulator, Kind};
use taktil_fuzz::Numbers;
use taktil_hal::{
    AnalogOut, CHANNELS, DacCode, DigitalIn, DigitalOut, DriveCommand, DriveIn, DriveOut,
    DriveRequest, Encoders, LinesOut, Nanos,
};

/// Numbers of the drives.
const DRIVE_IDS: [u8; 2] = [1, 5];
/// Most frames of a job.
const FRAMES_MAX: usize = 24;
/// Jobs of a bus.
const JOBS_COUNT: usize = 24;
/// Identifiers that mean something here.
const FRAME_IDENTIFIERS: [u32; 12] =
    [0x081, 0x085, 0x181, 0x185, 0x281, 0x581, 0x701, 0x705, 0x029, 0x021, 0x17f, 0x8000_057f];

/// A bus in virtual time, with what befalls its next frames.
struct Wire {
    emulator: Emulator,
    now: Nanos,
    end: Nanos,
    inbox: VecDeque<Vec<u8>>,
    faults: VecDeque<u8>,
    sent: usize,
}

impl Wire {
    fn poll(&mut self) {
        let mut frames = Vec::new();
        self.emulator.poll(self.now, &mut frames);
        for mut bytes in frames {
            let fault = self.faults.pop_front().unwrap_or(0);
            match fault & 7 {
                1 => continue,
                2 => bytes.truncate(bytes.len() * usize::from(fault >> 3) / 32),
                3 => self.inbox.push_back(bytes.clone()),
                4 => {
                    let at = 8 + usize::from(fault >> 3) % 8;
                    let other = self.faults.pop_front().unwrap_or(0);
                    if let Some(byte) = bytes.get_mut(at) {
                        *byte ^= other;
                    }
                }
                _ => {}
            }
            self.inbox.push_back(bytes);
        }
    }

    /// Puts a frame on the bus as a node or the controller would.
    fn say(&mut self, numbers: &mut Numbers<'_>) {
        let kind = numbers.byte();
        let word = if kind & 1 == 0 {
            FRAME_IDENTIFIERS[usize::from(kind >> 1) % FRAME_IDENTIFIERS.len()]
        } else {
            u32::from_le_bytes([kind, numbers.byte(), numbers.byte(), numbers.byte()])
        };
        let (is_fd, most) = if kind & 0x80 == 0 { (false, 8) } else { (true, 64) };
        let count = usize::from(numbers.byte()) % (most + 1);
        let data = (0..count).map(|_| numbers.byte()).collect();
        let now = self.now;
        self.emulator.inject(now, &BusFrame { word, is_fd, data });
    }
}

#[derive(Clone)]
struct Link(Arc<Mutex<Wire>>);

impl Port for Link {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let mut wire = self.0.lock().expect("one thread");
        wire.sent += 1;
        wire.now += Nanos::from_micros(50);
        let mut bytes = [0; FLEXIBLE_BYTES];
        let count = frame.write(&mut bytes);
        let now = wire.now;
        wire.emulator.receive(now, &bytes[..count]);
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        let mut wire = self.0.lock().expect("one thread");
        wire.end = wire.now + wait;
    }

    fn receive(&mut self) -> Option<Frame> {
        let mut wire = self.0.lock().expect("one thread");
        for _ in 0..1_000 {
            while let Some(bytes) = wire.inbox.pop_front() {
                // The kernel gives whole frames only.
                if let Some(frame) = Frame::read(&bytes) {
                    return Some(frame);
                }
            }
            let (end, due) = (wire.end, wire.emulator.next_due());
            let due = due.filter(|due| *due <= end);
            wire.now = wire.now.max(due.unwrap_or(end));
            wire.poll();
            if due.is_none() && wire.inbox.is_empty() {
                return None;
            }
        }
        None
    }

    fn receive_now(&mut self) -> Option<Frame> {
        let mut wire = self.0.lock().expect("one thread");
        wire.poll();
        wire.inbox.pop_front().and_then(|bytes| Frame::read(&bytes))
    }
}

fn job(halves: &mut Halves, release: Nanos, step: usize, as_drives: bool) {
    let request = DriveRequest::ALL[step % DriveRequest::ALL.len()];
    let _ = halves.encoders.sample(release);
    let _ = halves.digital_in.sample(release);
    if let Ok(reading) = halves.drive_in.sample(release) {
        assert_eq!(reading.acquired, release);
    }
    if as_drives {
        let targets = [1_000; CHANNELS];
        let command = DriveCommand { targets, request, reset: step % 5 == 0 };
        let _ = halves.drive_out.commit(release, &command);
    } else if let Some(half) = &mut halves.analog_out {
        let _ = half.commit(release, &[DacCode(100); CHANNELS]);
    }
    if let Some(half) = &mut halves.digital_out {
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: step % 2 == 0 };
        let _ = half.commit(release, &lines);
    }
}

fuzz_target!(|bytes: &[u8]| {
    // What is no frame, and what a frame holds.
    if let Some(frame) = Frame::read(bytes) {
        let mut again = [0; FLEXIBLE_BYTES];
        let count = frame.write(&mut again);
        assert_eq!(Frame::read(&again[..count]), Some(frame));
        let _ = sdo::answer(&frame, 5, 0x6041, 0);
    }
    assert!(registers(bytes).count() <= bytes.len());
    let mut numbers = Numbers::new(bytes);
    let kind = numbers.byte();
    let (device, protocol) = [
        (Kind::CanOpen(1_000), Protocol::Canopen),
        (Kind::Moteus, Protocol::Moteus),
        (Kind::Odrive, Protocol::Odrive),
    ][usize::from(kind % 3)];
    let modes = [DriveMode::Torque, DriveMode::Velocity, DriveMode::Position];
    let place = if protocol == Protocol::Odrive { 0 } else { usize::from(kind >> 2) % 3 };
    let mode = modes[place];
    let faults = (0..numbers.byte() % 32).map(|_| numbers.byte()).collect();
    let wire = Wire {
        emulator: Emulator::new(device, &DRIVE_IDS),
        now: Nanos::ZERO,
        end: Nanos::ZERO,
        inbox: VecDeque::new(),
        faults,
        sent: 0,
    };
    let link = Link(Arc::new(Mutex::new(wire)));
    let node = |id| NodeConfig { id, ..NodeConfig::default() };
    let config = Config {
        interface: "fuzz".to_owned(),
        protocol,
        mode,
        velocity_max_counts_s: Some(100_000),
        nodes: DRIVE_IDS.map(node).to_vec(),
        ..Config::default()
    };
    let mut halves = match attach(Box::new(link.clone()), &config) {
        Ok(halves) => halves,
        Err(refused) => {
            let text = refused.to_string();
            assert!(!refused.place().is_empty() && text.contains("; "), "{text}");
            return;
        }
    };
    let as_drives = kind & 0x80 != 0;
    for step in 0..JOBS_COUNT {
        let release = {
            let mut wire = link.0.lock().expect("one thread");
            wire.sent = 0;
            wire.now = Nanos::from_micros(2_500) * (wire.now.0 / 2_500_000 + 1);
            if numbers.any() {
                wire.say(&mut numbers);
                let count = numbers.byte() % 16;
                wire.faults.extend((0..count).map(|_| numbers.byte()));
            }
            wire.now
        };
        job(&mut halves, release, step, as_drives);
        assert!(link.0.lock().expect("one thread").sent <= FRAMES_MAX);
    }
    let _ = halves.drive_out.safe();
    let _ = halves.analog_out.as_mut().map(|half| half.safe());
    let _ = halves.digital_out.as_mut().map(|half| half.safe());
    let mut wire = link.0.lock().expect("one thread");
    let now = wire.now;
    wire.emulator.advance(now);
    let is_on = (0..DRIVE_IDS.len()).any(|place| wire.emulator.outputs(place).is_enabled);
    assert!(!is_on, "a drive has torque after `safe`");
});
