//! Whatever comes back from an EtherCAT segment that is open: frames that are lost, cut, doubled,
//! altered or made up. The driver's lane never panics, works in bounds, and withholds a reading
//! unless every device has served it. While a segment is opened frames are only lost or doubled:
//! what the library makes of altered ones there is not ours.
#![no_main]

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex};

use libfuzzer_sys::fuzz_target;
use taktil_drivers_ethercat::{
    Config, DeviceConfig, ExchangeTimes, Halves, Kind, Line, LineKind, LinesOutConfig, Port,
    Segment, SyncConfig,
};
use taktil_drivers_ethercat_emulator as emulator;
use taktil_drivers_ethercat_emulator::Model;
use taktil_fuzz::Numbers;
use taktil_hal::{
    AnalogOut, BoardClock, CHANNELS, DacCode, DigitalOut, DriveCommand, DriveIn, DriveOut,
    DriveRequest, Encoders, ErrorKind, LinesOut, Nanos,
};

/// Most frames of a job: two exchanges, and a request of a state with its answer.
const FRAMES_MAX: usize = 8;
/// The period of the jobs.
const JOB_PERIOD: Nanos = Nanos::from_millis(1);
/// Jobs of a segment.
const JOBS_COUNT: usize = 32;

/// A segment in virtual time, with what befalls its next answers.
struct Wire {
    segment: emulator::Segment,
    now: Nanos,
    end: Nanos,
    arrived: VecDeque<Vec<u8>>,
    faults: VecDeque<u8>,
    is_open: bool,
    sent: usize,
}

impl Wire {
    fn deliver(&mut self, mut answer: Vec<u8>) {
        let fault = self.faults.pop_front().unwrap_or(0);
        let count = usize::from(fault >> 3);
        match fault & 7 {
            1 => return,
            2 => self.arrived.push_back(answer.clone()),
            3 if self.is_open => answer.truncate(answer.len() * count / 32),
            4 if self.is_open => answer.resize(answer.len() + count, 0),
            5 if self.is_open => {
                let at = count * answer.len() / 32;
                let others = self.faults.len().min(6);
                for (byte, other) in answer[at..].iter_mut().zip(self.faults.drain(..others)) {
                    *byte ^= other;
                }
            }
            6 if self.is_open => self.arrived.push_back(self.faults.iter().copied().collect()),
            _ => {}
        }
        self.arrived.push_back(answer);
    }
}

#[derive(Clone)]
struct Link(Arc<Mutex<Wire>>);

impl Port for Link {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let mut wire = self.0.lock().expect("one thread");
        wire.sent += 1;
        wire.now += Nanos::from_micros(20);
        let now = wire.now;
        wire.segment.receive(now, frame);
        let mut answers = Vec::new();
        wire.segment.poll(now, &mut answers);
        answers.into_iter().for_each(|answer| wire.deliver(answer));
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        let mut wire = self.0.lock().expect("one thread");
        wire.end = wire.now + wait;
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        let mut wire = self.0.lock().expect("one thread");
        let Some(frame) = wire.arrived.pop_front() else {
            wire.now = wire.now.max(wire.end);
            return None;
        };
        let count = frame.len().min(buffer.len());
        buffer[..count].copy_from_slice(&frame[..count]);
        Some(count)
    }

    fn elapsed(&mut self) -> Nanos {
        self.0.lock().expect("one thread").now
    }
}

fn config(kind: u8) -> Config {
    let (vendor, product) = (emulator::DRIVE_VENDOR_ID, emulator::DRIVE_PRODUCT_ID);
    let drive = || DeviceConfig {
        vendor: Some(vendor),
        product: Some(product),
        ..DeviceConfig::of(Kind::Drive)
    };
    let enable = Line { at: LineKind::Drives, device: 0, channel: 0, inverted: false };
    let devices = vec![DeviceConfig::of(Kind::Ek1100), drive(), drive()];
    let lines = LinesOutConfig { enable, brake_release: None, watchdog_feed: None };
    Config {
        devices,
        lines_out: (kind & 1 == 0).then_some(lines),
        sync: (kind & 2 != 0).then(SyncConfig::default),
        exchange: if kind & 8 != 0 { ExchangeTimes::Pipelined } else { ExchangeTimes::Twice },
        ..Config::default()
    }
}

fn job(halves: &mut Halves, release: Nanos, step: usize, as_drives: bool) {
    if let Some(half) = &mut halves.encoders {
        match half.sample(release) {
            // It is new, or a job old where answers are collected a cycle later.
            Ok(reading) => {
                let age = release - reading.acquired;
                assert!((Nanos::ZERO..=JOB_PERIOD).contains(&age), "{age}");
            }
            Err(error) => assert_ne!(error.kind, ErrorKind::OutOfRange),
        }
    }
    let _ = halves.drive_in.as_mut().map(|half| half.sample(release));
    if let Some(half) = &mut halves.board_clock
        && let Ok(reading) = half.sample(release)
    {
        assert!(2 * reading.value.0.abs() <= half.cycle().0);
    }
    if as_drives && let Some(half) = &mut halves.drive_out {
        let request = DriveRequest::ALL[step / 8 % DriveRequest::ALL.len()];
        let command = DriveCommand { targets: [5; CHANNELS], request, reset: step % 3 == 0 };
        let _ = half.commit(release, &command);
    } else if let Some(half) = &mut halves.analog_out {
        let _ = half.commit(release, &[DacCode(100); CHANNELS]);
    }
    if let Some(half) = &mut halves.digital_out {
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: step % 2 == 0 };
        let _ = half.commit(release, &lines);
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut numbers = Numbers::new(bytes);
    let kind = numbers.byte();
    let faults = (0..numbers.byte() % 8).map(|_| numbers.byte()).collect();
    let models = [Model::Coupler, Model::Drive, Model::Drive];
    let devices = models.into_iter().map(emulator::Description::from).collect();
    let wire = Wire {
        segment: emulator::Segment::new(devices, emulator::idle_motors()),
        now: Nanos(1),
        end: Nanos::ZERO,
        arrived: VecDeque::new(),
        faults,
        is_open: false,
        sent: 0,
    };
    let link = Link(Arc::new(Mutex::new(wire)));
    let mut halves = match Segment::attach(Box::new(link.clone()), &config(kind)) {
        Ok(halves) => halves,
        Err(refused) => {
            let text = refused.to_string();
            assert!(!refused.place().is_empty() && text.contains("; "), "{text}");
            return;
        }
    };
    for step in 0..JOBS_COUNT {
        {
            let mut wire = link.0.lock().expect("one thread");
            (wire.is_open, wire.sent) = (true, 0);
            wire.now += Nanos::from_micros(900);
            let now = wire.now;
            wire.segment.advance(now);
            if numbers.any() {
                let count = numbers.byte() % 24;
                wire.faults.extend((0..count).map(|_| numbers.byte()));
            }
        }
        let release = JOB_PERIOD * (1 + step as i64);
        job(&mut halves, release, step, kind & 4 != 0);
        assert!(link.0.lock().expect("one thread").sent <= FRAMES_MAX);
    }
    let seen = halves.monitor.diagnostics();
    assert!(seen.answers + seen.timeouts + seen.wrong_counters <= 2 * seen.exchanges, "{seen:?}");
});
