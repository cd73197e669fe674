//! Each kind of fault on the halves of drives, before, during and after it; an undisturbed half
//! keeps the promises of the traits.

use taktil_hal::conformance::{CycleDriver, check_drive_in, check_drive_out};
use taktil_hal::fault::{Fault, FaultKind, FaultPlan};
use taktil_hal::link::{Receiver, Sender, link};
use taktil_hal::{
    CHANNELS, Counts, Devices, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut,
    DriveRequest, DriveState, Error, ErrorKind, Nanos, Reading,
};
use taktil_machine_fault::{decorate, kinds_of_half};

const CYCLE_PERIOD: Nanos = Nanos::from_millis(1);

/// Drives that pass on what reaches them, and report a position that grows.
struct Bus(Sender<DriveCommand>);

impl DriveOut for Bus {
    fn channels(&self) -> usize {
        6
    }

    fn control_loop(&self) -> DriveLoop {
        DriveLoop::Position
    }

    fn target_range(&self) -> (i32, i32) {
        (-100_000, 100_000)
    }

    fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
        if let Some(bad) = command.targets[..6].iter().position(|target| target.abs() > 100_000) {
            return Err(Error::on_channel(ErrorKind::OutOfRange, "bus", bad as u16));
        }
        let _ = self.0.send(*command, release, release);
        Ok(())
    }

    fn safe(&mut self) -> Result<(), Error> {
        let _ = self.0.send(DriveCommand::SAFE, Nanos::ZERO, Nanos::ZERO);
        Ok(())
    }

    fn longest_silence(&self) -> Nanos {
        Nanos::from_millis(50)
    }
}

struct Reports;

impl DriveIn for Reports {
    fn channels(&self) -> usize {
        6
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        let mut value = [DriveActual::default(); CHANNELS];
        for drive in &mut value[..6] {
            drive.position = Counts(10 * (release.0 / CYCLE_PERIOD.0) as i32);
            drive.state = DriveState::Following;
        }
        Ok(Reading { value, acquired: release })
    }
}

/// A fault from cycle 10 to cycle 20.
fn faulty(
    kind: FaultKind,
    target: &str,
    channel: Option<u16>,
) -> (Devices, Receiver<DriveCommand>) {
    let value = if kind == FaultKind::Jump { 500.0 } else { 1.0 };
    let fault = Fault {
        kind,
        target: target.to_owned(),
        channel,
        at: CYCLE_PERIOD * 10,
        duration: CYCLE_PERIOD * 10,
        value,
    };
    let (to, from) = link(256);
    let devices = Devices {
        drive_out: Some(Box::new(Bus(to))),
        drive_in: Some(Box::new(Reports)),
        ..Devices::default()
    };
    (decorate(devices, &FaultPlan::new(vec![fault]), 1).unwrap(), from)
}

fn command(target: i32) -> DriveCommand {
    DriveCommand { targets: [target; CHANNELS], request: DriveRequest::Follow, reset: false }
}

#[test]
fn words_are_lost_latched_displaced_and_refused_as_the_plan_says() {
    for kind in kinds_of_half("drive_out") {
        let (mut devices, mut bus) = faulty(*kind, "drive_out", None);
        let half = devices.require_drive_out().unwrap();
        for cycle in 0..30 {
            let within = (10..20).contains(&cycle);
            let answer = half.commit(CYCLE_PERIOD * cycle, &command(cycle as i32));
            let got = bus.newest(Nanos::MAX).map(|word| word.value.targets[2]);
            let plain = Some(cycle as i32);
            let (due, reached) = match (kind, within) {
                (FaultKind::Failing, true) => (Err(ErrorKind::Transient), None),
                (FaultKind::Unplugged, true) => (Err(ErrorKind::Lost), None),
                (FaultKind::Loss, true) => (Ok(()), None),
                (FaultKind::Frozen, true) => (Ok(()), Some(9)),
                (FaultKind::Jump, true) => (Ok(()), Some(cycle as i32 + 500)),
                _ => (Ok(()), plain),
            };
            assert_eq!((answer.map_err(|bad| bad.kind), got), (due, reached), "{kind:?} {cycle}");
        }
    }
}

#[test]
fn reports_are_displaced_old_or_missing_and_a_dead_drive_has_a_fault() {
    for kind in kinds_of_half("drive_in") {
        let channel = matches!(kind, FaultKind::Dead | FaultKind::Frozen | FaultKind::Jump);
        let (mut devices, _bus) = faulty(*kind, "drive_in", channel.then_some(2));
        let half = devices.drive_in.as_mut().unwrap();
        for cycle in 0..30 {
            let within = (10..20).contains(&cycle);
            let answer = half.sample(CYCLE_PERIOD * cycle);
            assert_eq!(answer, half.sample(CYCLE_PERIOD * cycle), "the same release");
            let errors = [
                (FaultKind::Failing, ErrorKind::Transient),
                (FaultKind::Silence, ErrorKind::Stale),
                (FaultKind::Unplugged, ErrorKind::Lost),
            ];
            let error = errors.iter().find(|(of, _)| of == kind && within).map(|(_, error)| *error);
            if let Some(error) = error {
                assert_eq!(answer.unwrap_err().kind, error, "{kind:?} {cycle}");
                continue;
            }
            let drives = answer.unwrap().value;
            let plain = 10 * cycle as i32;
            assert_eq!((drives[0].position.0, drives[0].fault_code), (plain, 0));
            let due = match (kind, within) {
                (FaultKind::Frozen, true) => (90, DriveState::Following, 0),
                (FaultKind::Jump, true) => (plain + 500, DriveState::Following, 0),
                (FaultKind::Dead, true) => (plain, DriveState::Fault, 0xff00),
                _ => (plain, DriveState::Following, 0),
            };
            let drive = drives[1];
            assert_eq!((drive.position.0, drive.state, drive.fault_code), due, "{kind:?} {cycle}");
        }
    }
}

#[test]
fn outside_their_time_faults_keep_the_promises() {
    let late = "kind=jump target=drive_out.1 at=100 value=5".parse().unwrap();
    let other = "kind=dead target=drive_in.1 at=100".parse().unwrap();
    let (to, _from) = link(4096);
    let devices = Devices {
        drive_out: Some(Box::new(Bus(to))),
        drive_in: Some(Box::new(Reports)),
        ..Devices::default()
    };
    let mut devices = decorate(devices, &FaultPlan::new(vec![late, other]), 1).unwrap();
    let mut bench = CycleDriver::stationary();
    assert_eq!(check_drive_out(devices.drive_out.as_mut().unwrap().as_mut(), &mut bench), []);
    assert_eq!(check_drive_in(devices.drive_in.as_mut().unwrap().as_mut(), &mut bench), []);
}
