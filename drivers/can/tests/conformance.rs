//! Every half passes hal's conformance suite, seen from the emulated drives.

mod rig;

use rig::{CYCLE_PERIOD, Lane, Rig, config};
use taktil_drivers_can::{CanDigitalOut, CanEncoders, Config, Protocol};
use taktil_drivers_can_emulator::Kind;
use taktil_hal::conformance::{
    CycleDriver, check_analog_out_drop, check_analog_out_observed, check_digital_in,
    check_digital_out, check_digital_out_drop, check_digital_out_observed, check_encoders,
};
use taktil_hal::{CHANNELS, DacCode, DigitalOut, Encoders, LinesOut, Nanos};

const ALL: [(Kind, Protocol); 3] = [
    (Kind::CanOpen(1_000), Protocol::Canopen),
    (Kind::Moteus, Protocol::Moteus),
    (Kind::Odrive, Protocol::Odrive),
];

fn bench(rig: &Rig, first: Nanos) -> CycleDriver<'_> {
    CycleDriver::new(first, CYCLE_PERIOD, |release| rig.advance(release))
}

/// A bench that samples positions and keeps the drives enabled.
fn enabling<'a>(
    rig: &'a Rig,
    first: Nanos,
    encoders: &'a mut CanEncoders,
    lines: &'a mut CanDigitalOut,
) -> CycleDriver<'a> {
    let mut feed = false;
    CycleDriver::new(first, CYCLE_PERIOD, move |release| {
        rig.advance(release);
        let _ = encoders.sample(release);
        feed = !feed;
        let wish = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
        lines.commit(release, &wish).unwrap();
    })
}

#[test]
fn inputs_conform() {
    for (kind, protocol) in ALL {
        let rig = Rig::new(kind, &[]);
        let mut halves = rig.open(&config(protocol)).unwrap();
        let mut bench = bench(&rig, rig.next_release());
        assert_eq!(check_encoders(&mut halves.encoders, &mut bench), [], "{kind:?}");
        assert_eq!(check_digital_in(&mut halves.digital_in, &mut bench), [], "{kind:?}");
    }
}

#[test]
fn inputs_conform_on_a_bad_bus() {
    for (kind, protocol) in ALL {
        let rig = Rig::new(kind, &["kind=loss value=0.1 at=0.1", "kind=duplication value=0.2"]);
        let mut halves = rig.open(&Config { lost_ms: 1_000, ..config(protocol) }).unwrap();
        let first = rig.next_release().max(Nanos::from_millis(100));
        let mut bench = bench(&rig, first);
        assert_eq!(check_encoders(&mut halves.encoders, &mut bench), [], "{kind:?}");
        assert_eq!(check_digital_in(&mut halves.digital_in, &mut bench), [], "{kind:?}");
    }
}

#[test]
fn torques_conform_as_the_drives_see_them() {
    for (kind, protocol) in ALL {
        let rig = Rig::new(kind, &[]);
        let mut lane = Lane::new(&rig, &config(protocol));
        lane.cycles(true, 0, 20);
        assert_eq!(lane.enabled(), 3, "{kind:?}");
        let Lane { mut halves, release, .. } = lane;
        let mut bench =
            enabling(&rig, release, &mut halves.encoders, halves.digital_out.as_mut().unwrap());
        let mut codes = || {
            core::array::from_fn::<DacCode, CHANNELS, _>(|place| {
                DacCode(i32::from(rig.outputs(place).target))
            })
        };
        let analog = halves.analog_out.as_mut().unwrap();
        assert_eq!(check_analog_out_observed(analog, &mut bench, &mut codes), [], "{kind:?}");
        let analog = Box::new(halves.analog_out.unwrap());
        assert_eq!(check_analog_out_drop(analog, &mut bench, &mut codes), [], "{kind:?}");
    }
}

#[test]
fn lines_conform_as_a_drive_sees_them() {
    let rig = Rig::new(Kind::CanOpen(1_000), &[]);
    let config = Config { brake_bit: Some(3), ..config(Protocol::Canopen) };
    let mut lane = Lane::new(&rig, &config);
    // The first word of a process has to be one with bit 7 at 0, and a status has to have come.
    lane.feeds = false;
    lane.cycles(false, 0, 2);
    let Lane { mut halves, release, .. } = lane;
    let mut bench = bench(&rig, release);
    let heard = rig.outputs(0).host_signs;
    let mut lines = || {
        let outputs = rig.outputs(0);
        LinesOut {
            enable: outputs.is_wanted,
            brake_release: outputs.digital & 8 != 0,
            watchdog_feed: (outputs.host_signs - heard) % 2 == 1,
        }
    };
    let digital = halves.digital_out.as_mut().unwrap();
    assert_eq!(check_digital_out_observed(digital, &mut bench, &mut lines), []);
    let digital = Box::new(halves.digital_out.unwrap());
    assert_eq!(check_digital_out_drop(digital, &mut bench, &mut lines), []);
}

#[test]
fn lines_conform_for_controllers_without_words_for_them() {
    for (kind, protocol) in &ALL[1..] {
        let rig = Rig::new(*kind, &[]);
        let mut halves = rig.open(&config(*protocol)).unwrap();
        let mut bench = bench(&rig, rig.next_release());
        assert_eq!(
            check_digital_out(halves.digital_out.as_mut().unwrap(), &mut bench),
            [],
            "{kind:?}"
        );
    }
}
