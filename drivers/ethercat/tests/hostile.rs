//! Frames that are damaged on their way, or come unasked: the driver does not panic, and does not
//! believe an exchange that not every device has served.

mod rig;

use proptest::prelude::*;
use rig::{CYCLE_PERIOD, Lane, Rig, six_drives};
use taktil_drivers_ethercat::ExchangeTimes;
use taktil_drivers_ethercat_emulator as emulator;
use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;

#[test]
fn damaged_frames_are_survived_by_a_lane() {
    let (devices, config) = six_drives();
    let rig = Rig::with_motors(devices);
    let mut lane = Lane::new(rig.open(&config).unwrap());
    lane.cycles(&rig, 40, false, 0);
    let at = rig.world().now.as_secs_f64();
    let damage = format!("kind=corruption target=ethercat at={at} for=1 value=0.3");
    let rig = rig.with_faults(&[&damage]);
    let mut failed = 0;
    for _ in 0..1_500 {
        let cycle = lane.cycle(&rig, false, 0);
        failed += usize::from(cycle.counts.is_err());
    }
    assert!(failed > 10, "{failed} readings were withheld");
    let last = lane.cycles(&rig, 20, false, 0);
    assert!(last.counts.is_ok() && last.lines.is_ok(), "{last:?}");
}

/// A word of a drive's information memory has another value: lengths that point beyond the end of
/// all addresses, identifications and addresses that no device has.
#[test]
fn a_damaged_information_memory_is_read_or_refused() {
    let (devices, config) = six_drives();
    let open = |word, value| {
        let rig = Rig::new(devices.clone());
        let segment = emulator::Segment::new(devices.clone(), emulator::idle_motors());
        rig.world().segment = segment.with_damaged_information(2, word, value);
        rig.open(&config).map(|_| ()).map_err(|bad| bad.to_string())
    };
    let of_first_categories = 0x40..0x68;
    let outcomes: Vec<_> = of_first_categories.map(|word| open(word, 0x7fff)).collect();
    assert!(outcomes.iter().any(Result::is_ok), "{outcomes:?}");
    let refusals = outcomes.iter().filter_map(|one| one.as_ref().err());
    assert!(refusals.clone().count() > 0, "{outcomes:?}");
    for text in refusals {
        assert!(text.contains("; "), "a remedy: {text}");
        assert!(!text.contains("no device answers"), "{text}");
    }
    // The length of the first category: addresses come round to where they were.
    let text = open(0x41, 0xfffe).unwrap_err();
    assert!(text.contains("what they say of themselves cannot be used"), "{text}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn a_segment_on_a_bad_cable_is_opened_or_refused(seed in any::<u64>(), part in 0.0..0.05_f64) {
        let (devices, config) = six_drives();
        let rig = Rig::new(devices.clone());
        let damage = format!("kind=corruption target=ethercat value={part}").parse().unwrap();
        let segment = emulator::Segment::new(
            devices,
            emulator::idle_motors(),
        );
        let plan = FaultPlan::new(vec![damage]);
        rig.world().segment = segment.with_faults(plan, "ethercat", seed).unwrap();
        if let Err(bad) = rig.open(&config) {
            prop_assert!(!bad.to_string().is_empty());
        }
    }

    #[test]
    fn no_frame_that_comes_unasked_harms(
        frames in proptest::collection::vec(
            proptest::collection::vec(any::<u8>(), 0..120),
            1..20,
        ),
        is_returned in any::<bool>(),
        is_pipelined in any::<bool>(),
    ) {
        let (devices, mut config) = six_drives();
        let mut age = Nanos::ZERO;
        if is_pipelined {
            (config.exchange, age) = (ExchangeTimes::Pipelined, CYCLE_PERIOD);
        }
        let rig = Rig::new(devices);
        let mut lane = Lane { age, ..Lane::new(rig.open(&config).unwrap()) };
        for frame in frames {
            let mut whole = vec![0xff; 6];
            whole.extend([if is_returned { 0x12 } else { 0x10 }; 6]);
            whole.extend([0x88, 0xa4]);
            whole.extend(&frame);
            rig.world().arrived.push_back(whole);
            rig.world().arrived.push_back(frame);
            lane.cycle(&rig, false, 0);
        }
        let last = lane.cycles(&rig, 5, false, 0);
        prop_assert!(last.counts.is_ok(), "{:?}", last);
    }
}
