//! Halves on several threads: a collision is a transient error, and going safe is never lost.

mod rig;

use std::sync::atomic::{AtomicBool, Ordering};

use rig::{CYCLE_PERIOD, Rig, with_7i77};
use taktil_drivers_mesa_emulator::Firmware;
use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, Encoders, ErrorKind, LinesOut, Nanos};

#[test]
fn halves_on_two_threads_collide_without_harm_and_go_safe_for_sure() {
    let rig = Rig::new(Firmware::with_7i77());
    let halves = rig.open(&with_7i77()).unwrap();
    let (mut encoders, mut analog) = (halves.encoders.unwrap(), halves.analog_out.unwrap());
    let (mut digital, monitor) = (halves.digital_out.unwrap(), halves.monitor);
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut release = Nanos::from_millis(100);
            while !ended.load(Ordering::Relaxed) {
                release += Nanos(1);
                match encoders.sample(release) {
                    Ok(reading) => assert_eq!(reading.acquired, release),
                    Err(error) => assert_eq!(error.kind, ErrorKind::Transient),
                }
            }
        });
        for round in 0..500 {
            let release = Nanos::from_millis(100) + CYCLE_PERIOD * round;
            let lines =
                LinesOut { enable: true, brake_release: true, watchdog_feed: round % 2 == 0 };
            let _ = analog.commit(release, &[DacCode(100); CHANNELS]);
            let _ = digital.commit(release, &lines);
            // Whether this thread does it or the other one.
            let _ = analog.safe();
            let _ = digital.safe();
        }
        ended.store(true, Ordering::Relaxed);
    });
    let outputs = rig.outputs();
    assert_eq!((outputs.volts, outputs.analog_enabled, outputs.field & 1), ([0.0; 6], false, 0));
    assert!(monitor.diagnostics().collisions > 0, "{:?}", monitor.diagnostics());
}
