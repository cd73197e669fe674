//! What a segment does beside answering: states that are refused, watchdogs, process data that are
//! mapped anew, faults by plan, and frames that no host would send.

mod rig;

use proptest::prelude::*;
use rig::{Host, STATION_ADDRESS, hex};
use taktil_drivers_ethercat_emulator::{Description, Model, Segment, State, idle_motors};
use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultKind, FaultPlan};

fn host_of(model: Model) -> Host {
    let devices = vec![Model::Coupler.into(), model.into()];
    Host::new(Segment::new(devices, idle_motors()))
}

/// A drive in OP with its process data at logical 0: 13 bytes to it, 15 from it.
fn drive() -> Host {
    let mut host = host_of(Model::Drive);
    host.prepare(2, STATION_ADDRESS);
    host.write(STATION_ADDRESS, 0x0810, &hex("0011 0d00 64 00 01 00"));
    host.write(STATION_ADDRESS, 0x0818, &hex("8011 0f00 20 00 01 00"));
    host.write(STATION_ADDRESS, 0x0600, &hex("00000000 0d00 00 07 0011 00 02 01 000000"));
    host.write(STATION_ADDRESS, 0x0610, &hex("0d000000 0f00 00 07 8011 00 01 01 000000"));
    host.write(STATION_ADDRESS, 0x0120, &[4, 0]);
    host.write(STATION_ADDRESS, 0x0120, &[8, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (8, 0));
    host
}

/// One cycle with a controlword, a torque and the mode of cyclic torque; statusword and counter.
fn cycle(host: &mut Host, control: u16, torque: i16) -> (u16, u16) {
    let mut image = control.to_le_bytes().to_vec();
    image.extend([0; 8]);
    image.extend(torque.to_le_bytes());
    image.push(10);
    image.resize(28, 0);
    let (data, counter) = host.datagram(12, 0, &image);
    (u16::from_le_bytes([data[13], data[14]]), counter)
}

#[test]
fn a_state_is_reached_step_by_step_and_refusals_have_codes() {
    let mut host = host_of(Model::AnalogOutput);
    host.prepare(2, STATION_ADDRESS);
    host.write(STATION_ADDRESS, 0x0120, &[8, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (0x12, 0x11), "a state is left out");
    host.write(STATION_ADDRESS, 0x0120, &[4, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (0x12, 0x11), "the error is not acknowledged");
    host.write(STATION_ADDRESS, 0x0120, &[0x14, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (0x12, 0x1d), "no sync manager has outputs");
    host.write(STATION_ADDRESS, 0x0120, &[0x13, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (0x12, 0x13));
    host.write(STATION_ADDRESS, 0x0120, &[0x17, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (0x12, 0x12));
    host.write(STATION_ADDRESS, 0x0120, &[0x11, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (1, 0));
}

#[test]
fn accesses_that_are_refused_do_not_count() {
    let mut host = host_of(Model::AnalogOutput);
    host.prepare(2, STATION_ADDRESS);
    assert_eq!(host.read(STATION_ADDRESS, 0x1080, 128).1, 0, "an empty mailbox");
    assert_eq!(host.write(STATION_ADDRESS, 0x1080, &[0; 128]), 0, "the wrong direction");
    assert_eq!(host.write(STATION_ADDRESS, 0x0130, &[8, 0]), 0, "a register that is read only");
    assert_eq!(host.read(0x1234, 0x0130, 2).1, 0, "nobody has this address");
}

#[test]
fn a_drive_is_enabled_turns_and_loses_its_host() {
    let mut host = drive();
    assert_eq!(cycle(&mut host, 6, 0).1, 3);
    let words = [6, 7, 15, 15].map(|word| cycle(&mut host, word, 500).0 & 0x6f);
    assert_eq!(words, [0x21, 0x21, 0x23, 0x27], "each word shows in the answer after its own");
    assert_eq!(host.segment.enabled_drives(), [true]);
    assert_eq!(host.segment.outputs().torques, [0.5]);
    // The watchdog of outputs was left at 100 ms.
    host.now += Nanos::from_millis(99);
    host.segment.advance(host.now);
    assert_eq!(host.segment.enabled_drives(), [true]);
    host.now += Nanos::from_millis(2);
    host.segment.advance(host.now);
    assert_eq!((host.segment.enabled_drives(), host.segment.bites()), (vec![false], 1));
    assert_eq!(host.state(STATION_ADDRESS), (0x14, 0x1b));
    let (status, counter) = cycle(&mut host, 15, 500);
    assert!(status & 8 != 0 && counter == 3, "{status:04x}: a fault, and memory still counts");
    assert!(host.segment.outputs().torques[0] <= 0.0, "nothing but a brake");
}

#[test]
fn the_watchdog_bites_after_the_time_that_the_host_has_set() {
    let mut host = drive();
    host.write(STATION_ADDRESS, 0x0420, &50_u16.to_le_bytes());
    cycle(&mut host, 6, 0);
    host.now += Nanos::from_micros(4_900);
    host.segment.advance(host.now);
    assert_eq!(host.segment.bites(), 0);
    host.now += Nanos::from_micros(200);
    host.segment.advance(host.now);
    assert_eq!(host.segment.bites(), 1);
}

#[test]
fn process_data_are_mapped_anew_in_preop_only() {
    let mut host = host_of(Model::Drive);
    host.prepare(2, STATION_ADDRESS);
    let write = |host: &mut Host, index: u16, subindex: u8, bytes: &[u8]| {
        let mut message = hex("0a00 0000 00 03 0020");
        message.push(0x23 | (4 - bytes.len() as u8) << 2);
        message.extend(index.to_le_bytes());
        message.push(subindex);
        message.extend(bytes);
        host.mail(STATION_ADDRESS, &message).expect("an answer")[8]
    };
    for (index, mapping) in [(0x1600, 0x6040_0010_u32), (0x1a00, 0x6041_0010)] {
        assert_eq!(write(&mut host, index, 0, &[0]), 0x60);
        assert_eq!(write(&mut host, index, 1, &mapping.to_le_bytes()), 0x60);
        assert_eq!(write(&mut host, index, 0, &[1]), 0x60);
    }
    host.write(STATION_ADDRESS, 0x0810, &hex("0011 0200 64 00 01 00"));
    host.write(STATION_ADDRESS, 0x0818, &hex("8011 0200 20 00 01 00"));
    host.write(STATION_ADDRESS, 0x0120, &[4, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (4, 0));
    assert_eq!(write(&mut host, 0x1600, 0, &[0]), 0x80, "not any more");
}

#[test]
fn digital_terminals_share_a_byte_of_the_image_bit_by_bit() {
    let models = [Model::Coupler, Model::DigitalOutput, Model::DigitalInput];
    let mut host = Host::new(Segment::new(models.map(Description::from).to_vec(), idle_motors()));
    for position in 0..3_u16 {
        let address = u32::from(position.wrapping_neg()) | 0x0010 << 16;
        host.datagram(2, address, &(0x1000 + position).to_le_bytes());
    }
    host.write(0x1001, 0x0800, &hex("000f 0100 44 00 01 00"));
    host.write(0x1002, 0x0800, &hex("0010 0100 20 00 01 00"));
    // Four lines from the bit 2 of the image's first byte on, and six from its bit 6.
    host.write(0x1001, 0x0600, &hex("00000000 0100 02 05 000f 00 02 01 000000"));
    host.write(0x1002, 0x0600, &hex("00000000 0200 06 03 0010 00 01 01 000000"));
    for state in [2, 4, 8] {
        for station in [0x1001, 0x1002] {
            host.write(station, 0x0120, &[state, 0]);
            assert_eq!(host.state(station), (u16::from(state), 0));
        }
    }
    host.datagram(12, 0, &[0b1010_0100, 0]);
    let (data, counter) = host.datagram(12, 0, &[0b1010_0100, 0]);
    assert_eq!((host.segment.outputs().lines, counter), (vec![0b1001], 3));
    assert_eq!(data, [0b0110_0100, 0b0000_0010], "the inputs read what the outputs put out");
}

#[test]
fn faults_happen_at_their_time_and_to_their_device() {
    let faults = [
        "kind=unplugged target=bus.3 at=1 for=1",
        "kind=silence target=bus at=3 for=1",
        "kind=loss target=bus at=5 for=1 value=1",
        "kind=restart target=bus.2 at=7 for=0.1",
    ];
    let plan = faults.map(|text| text.parse::<Fault>().unwrap()).to_vec();
    let models = [Model::Coupler, Model::AnalogOutput, Model::Drive];
    let segment = Segment::new(models.map(Description::from).to_vec(), idle_motors());
    let segment = segment.with_faults(FaultPlan::new(plan), "bus", 1).unwrap();
    let mut host = Host::new(segment);
    host.prepare(3, STATION_ADDRESS);
    let mut count = |seconds: i64| {
        host.now = Nanos::from_secs(seconds) + Nanos::from_millis(500);
        host.exchange(&hex("0d1007000000000001000000000000")).map(|answer| answer[13])
    };
    assert_eq!(
        [0, 1, 2, 3, 4, 5, 6].map(&mut count),
        [Some(3), Some(2), Some(3), None, Some(3), None, Some(3)]
    );
    let put_in = host.segment.traffic().faults;
    assert_eq!(put_in.of(FaultKind::Unplugged), 1, "a frame that turned back early counts as well");
    assert_eq!(host.segment.states()[1], State::PreOperational);
    host.segment.advance(Nanos::from_secs(7));
    assert_eq!(host.segment.states()[1], State::Init);
    let faults = host.segment.traffic().faults;
    assert_eq!((faults.of(FaultKind::Silence), faults.of(FaultKind::Restart)), (1, 1));
}

#[test]
fn a_drive_fails_by_plan_with_its_code() {
    let fault = "kind=failing target=bus.2 at=0.5 for=0.1 value=1".parse().unwrap();
    let mut host = drive();
    let plan = FaultPlan::new(vec![fault]);
    host.segment = std::mem::replace(
        &mut host.segment,
        Segment::new(vec![Model::Coupler.into()], idle_motors()),
    )
    .with_faults(plan, "bus", 1)
    .unwrap();
    for word in [6, 7, 15] {
        cycle(&mut host, word, 0);
    }
    assert_eq!(host.segment.enabled_drives(), [true]);
    host.write(STATION_ADDRESS, 0x0420, &[0, 0]);
    host.now = Nanos::from_millis(501);
    let (status, _) = cycle(&mut host, 15, 0);
    assert!(status & 8 != 0, "{status:04x}");
}

#[test]
fn a_plan_that_no_segment_can_execute_is_refused() {
    let refused = |text: &str| {
        let segment = Segment::new(vec![Model::Coupler.into()], idle_motors());
        let plan = FaultPlan::new(vec![text.parse().unwrap()]);
        segment.with_faults(plan, "bus", 1).unwrap_err().place
    };
    assert_eq!(refused("kind=torn target=bus value=1"), "kind");
    assert_eq!(refused("kind=unplugged target=bus.2"), "target");
}

proptest! {
    #[test]
    fn no_frame_makes_it_panic_or_grow(
        content in proptest::collection::vec(any::<u8>(), 0..200),
        commands in proptest::collection::vec((0_u8..16, any::<u32>(), 0_usize..64), 0..8),
    ) {
        let mut host = drive();
        let mut frame = vec![0xff; 12];
        frame.extend([0x88, 0xa4]);
        frame.extend(&content);
        host.segment.receive(host.now, &frame);
        let mut answers = Vec::new();
        host.segment.poll(host.now, &mut answers);
        prop_assert!(answers.iter().all(|answer| answer.len() == frame.len()));
        for (command, address, count) in commands {
            let address = address & 0x1fff_ffff;
            let (data, _) = host.datagram(command, address, &vec![0xa5; count]);
            prop_assert_eq!(data.len(), count);
        }
    }

    #[test]
    fn no_message_makes_the_mailbox_panic(
        message in proptest::collection::vec(any::<u8>(), 0..64),
        starts in any::<bool>(),
    ) {
        let mut host = host_of(Model::Drive);
        host.prepare(2, STATION_ADDRESS);
        let mut full = message.clone();
        if starts {
            let mut head = hex("0a00 0000 00 03 0020");
            head.extend(&message);
            full = head;
        }
        let _ = host.mail(STATION_ADDRESS, &full);
        while host.collect(STATION_ADDRESS).is_some() {}
        let asked = hex("0a000000001300204018100100000000");
        prop_assert!(host.mail(STATION_ADDRESS, &asked).is_some());
    }
}
