//! The half passes hal's conformance suite.

mod rig;

use rig::{CYCLE_PERIOD, Rig, config};
use taktil_hal::Nanos;
use taktil_hal::conformance::{CycleDriver, check_force_torque};

#[test]
fn the_half_conforms_on_good_and_on_bad_links() {
    for faults in [
        &[][..],
        &["kind=loss value=0.3", "kind=duplication value=0.3", "kind=reordering value=0.3"],
        &["kind=delay value=0.004", "kind=failing value=0.5"],
        &["kind=unplugged at=0.02 for=0.03"],
    ] {
        for rate_hz in [200, 1000, 7000] {
            let rig = Rig::new(rate_hz, faults);
            let mut half = rig.open(&config(rate_hz));
            let mut bench =
                CycleDriver::new(Nanos::ZERO, CYCLE_PERIOD, |release| rig.advance(release));
            assert_eq!(check_force_torque(&mut half, &mut bench), [], "{rate_hz} {faults:?}");
        }
    }
}
