//! No frames break the driver: what somebody else says on the bus, and what is no frame at all.

mod rig;

use proptest::prelude::*;
use rig::{Lane, Rig, config};
use taktil_drivers_can::moteus::registers;
use taktil_drivers_can::{Frame, Protocol, sdo};
use taktil_drivers_can_emulator::{BusFrame, Kind};
use taktil_hal::{AnalogOut, DigitalOut};

fn any_frame() -> impl Strategy<Value = BusFrame> {
    // Identifiers of the rig's drives, of SYNC and emergencies, and any others.
    let ids = prop_oneof![
        prop::sample::select(vec![0x081, 0x181, 0x185, 0x581, 0x701, 0x705, 0x17f, 0x57f, 0x029]),
        any::<u32>(),
    ];
    (ids, any::<bool>(), prop::collection::vec(any::<u8>(), 0..64)).prop_map(
        |(word, is_fd, data)| {
            let data = if is_fd { data } else { data.into_iter().take(8).collect() };
            BusFrame { word, is_fd, data }
        },
    )
}

proptest! {
    #[test]
    fn bytes_are_a_frame_or_none_and_are_written_as_they_were(
        bytes in prop::collection::vec(any::<u8>(), 0..80),
        whole in any::<bool>(),
    ) {
        let mut bytes = bytes;
        if whole {
            bytes.resize(16, 0);
            bytes[4] %= 9;
        }
        let frame = Frame::read(&bytes);
        prop_assert!(frame.is_some() || !whole);
        if let Some(frame) = frame {
            let mut again = [0; 72];
            let count = frame.write(&mut again);
            prop_assert_eq!(Frame::read(&again[..count]), Some(frame));
        }
    }

    #[test]
    fn registers_end_where_the_data_do(data in prop::collection::vec(any::<u8>(), 0..64)) {
        prop_assert!(registers(&data).count() <= data.len());
        let frame = Frame::flexible(0x585, &data, 0x50);
        let _ = sdo::answer(&frame, 5, 0x6041, 0);
    }

    #[test]
    fn no_frames_break_a_cycle(
        frames in prop::collection::vec(any_frame(), 0..40),
        protocol in 0_usize..3,
    ) {
        let all = [
            (Kind::CanOpen(1_000), Protocol::Canopen),
            (Kind::Moteus, Protocol::Moteus),
            (Kind::Odrive, Protocol::Odrive),
        ];
        let (kind, protocol) = all[protocol];
        let mut lane = Lane::new(&Rig::new(kind, &[]), &config(protocol));
        for frame in &frames {
            lane.rig.inject(frame);
            lane.cycle(true, 100);
        }
        // Whatever was said: torques off is what every drive hears and does.
        let _ = lane.halves.analog_out.as_mut().unwrap().safe();
        let _ = lane.halves.digital_out.as_mut().unwrap().safe();
        prop_assert_eq!(lane.enabled(), 0);
    }
}
