//! The double answers as the kernel does: by channel, range, lock and direction, and with the
//! errors of the system.

use proptest::prelude::*;
use taktil_drivers_comedi_double::{Call, Double, Kind, Subdevice, errno};
use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;

const READ_KIND: u32 = 0x0400_0000;
const WRITE_KIND: u32 = 0x0800_0001;
const BITS_KIND: u32 = 0x0c00_0002;
const CONFIG_KIND: u32 = 0x0c00_0003;

fn call(
    double: &mut Double,
    kind: u32,
    subdevice: u32,
    channel: u32,
    words: &mut [u32],
) -> Result<usize, i32> {
    double.execute(0, [Call { kind, subdevice, channel, words }].into_iter())
}

fn read(double: &mut Double, subdevice: u32, channel: u32) -> Result<u32, i32> {
    let mut words = [0];
    call(double, READ_KIND, subdevice, channel, &mut words).map(|_| words[0])
}

fn opened(mut double: Double) -> Double {
    assert_eq!(double.open(), Ok(0));
    double
}

#[test]
fn each_input_of_comedi_test_reads_the_output_of_its_number() {
    let mut double = opened(Double::comedi_test());
    assert_eq!(double.names(0).unwrap(), ["comedi_test", "comedi_test"]);
    assert_eq!(read(&mut double, 0, 5), Ok(0x7fff));
    for channel in 0..8 {
        let sample = 1_000 * channel;
        assert_eq!(call(&mut double, WRITE_KIND, 1, channel, &mut [sample]), Ok(1));
        assert_eq!(read(&mut double, 0, channel), Ok(sample));
        assert_eq!(read(&mut double, 1, channel), Ok(sample));
    }
    assert_eq!(double.ranges(0, 1).unwrap().len(), 2);
    assert_eq!(double.largest_samples(0, 0).unwrap(), [0xffff; 8]);
}

#[test]
fn what_a_board_does_not_have_is_an_invalid_argument() {
    let mut double = opened(Double::comedi_test());
    assert_eq!(read(&mut double, 2, 0), Err(errno::INVALID_ARGUMENT));
    assert_eq!(read(&mut double, 0, 8), Err(errno::INVALID_ARGUMENT));
    assert_eq!(read(&mut double, 0, 2 << 16), Err(errno::INVALID_ARGUMENT));
    assert_eq!(read(&mut double, 0, 1 << 16), Ok(0x7fff));
    let written = call(&mut double, WRITE_KIND, 1, 0, &mut [0x1_0000]);
    assert_eq!(written, Err(errno::INVALID_ARGUMENT));
    assert_eq!(call(&mut double, BITS_KIND, 0, 0, &mut [0, 0]), Err(errno::INVALID_ARGUMENT));
    assert_eq!(call(&mut double, 7, 0, 0, &mut []), Err(errno::INVALID_ARGUMENT));
}

#[test]
fn a_lock_keeps_other_nodes_out_until_its_node_is_closed() {
    let mut double = opened(Double::comedi_test());
    let other = double.open().unwrap();
    double.lock(other, 1).unwrap();
    assert_eq!(double.lock(0, 1), Err(errno::BUSY_DEVICE));
    assert_eq!(double.lock(other, 1), Err(errno::BUSY_DEVICE));
    assert_eq!(read(&mut double, 1, 0), Err(errno::ACCESS_DENIED));
    assert_eq!(read(&mut double, 0, 0), Ok(0x7fff));
    double.close(other);
    assert_eq!(read(&mut double, 1, 0), Ok(0x7fff));
}

#[test]
fn counters_wrap_and_follow_once_armed() {
    let mut double = opened(Double::robot_board(16));
    double.set_count(3, 0, 77);
    assert_eq!(read(&mut double, 3, 0), Ok(0));
    call(&mut double, CONFIG_KIND, 3, 0, &mut [34]).unwrap();
    call(&mut double, CONFIG_KIND, 3, 0, &mut [4097, 0]).unwrap();
    call(&mut double, CONFIG_KIND, 3, 0, &mut [31, 0]).unwrap();
    double.set_count(3, 0, 76);
    assert_eq!(read(&mut double, 3, 0), Ok(0xffff));
    double.set_count(3, 0, 77 + 0x1_0005);
    assert_eq!(read(&mut double, 3, 0), Ok(5));
    // As a quadrature encoder, preloaded.
    call(&mut double, CONFIG_KIND, 3, 1, &mut [1003, 0, 100, 0]).unwrap();
    double.set_count(3, 1, -1);
    assert_eq!(read(&mut double, 3, 1), Ok(99));
    let shape = call(&mut double, CONFIG_KIND, 3, 1, &mut [34, 0]);
    assert_eq!(shape, Err(errno::INVALID_ARGUMENT));
}

#[test]
fn lines_are_directed_in_groups_and_driven_by_mask() {
    let mut double = opened(Double::robot_board(24));
    call(&mut double, CONFIG_KIND, 2, 9, &mut [1]).unwrap();
    let mut query = [28, 0];
    call(&mut double, CONFIG_KIND, 2, 15, &mut query).unwrap();
    assert_eq!(query[1], 1);
    double.set_level(2, 0, Some(false));
    let mut words = [0x300, 0x200];
    call(&mut double, BITS_KIND, 2, 0, &mut words).unwrap();
    assert_eq!(words, [0x300, 0x00ff_02fe], "cut inputs are pulled up");
    assert_eq!([8, 9, 16].map(|at| double.level(2, at)), [Some(false), Some(true), None]);
    // From another base the same lines are other bits.
    let mut words = [1, 1];
    call(&mut double, BITS_KIND, 2, 8, &mut words).unwrap();
    assert_eq!(words[1] & 0xff, 3);
}

#[test]
fn a_restart_forgets_what_was_set() {
    let mut double = opened(Double::robot_board(24));
    call(&mut double, WRITE_KIND, 1, 0, &mut [0xffff]).unwrap();
    call(&mut double, CONFIG_KIND, 2, 9, &mut [1]).unwrap();
    call(&mut double, CONFIG_KIND, 3, 0, &mut [31, 0]).unwrap();
    let plan = FaultPlan::new(vec!["kind=restart at=1 for=1".parse().unwrap()]);
    double.set_plan(plan, 0).unwrap();
    double.advance(Nanos::from_millis(999));
    assert_eq!(double.sample(1, 0), 0xffff);
    double.advance(Nanos::from_secs(1));
    assert_eq!((double.sample(1, 0), double.level(2, 9)), (0x7fff, None));
    double.set_count(3, 0, 10);
    assert_eq!(read(&mut double, 3, 0), Ok(0));
    // It restarts once, not for as long as the fault lasts.
    call(&mut double, WRITE_KIND, 1, 0, &mut [9]).unwrap();
    double.advance(Nanos::from_millis(1_500));
    assert_eq!(double.sample(1, 0), 9);
}

#[test]
fn a_failing_list_has_acted_up_to_its_failure() {
    let mut double = opened(Double::comedi_test());
    let (mut first, mut bad, mut last) = ([1], [0x1_0000], [3]);
    let list = [(0, &mut first), (1, &mut bad), (2, &mut last)].map(|(channel, words)| Call {
        kind: WRITE_KIND,
        subdevice: 1,
        channel,
        words,
    });
    assert_eq!(double.execute(0, list.into_iter()), Err(errno::INVALID_ARGUMENT));
    assert_eq!([0, 1, 2].map(|channel| double.sample(1, channel)), [1, 0x7fff, 0x7fff]);
}

proptest! {
    #[test]
    fn no_instruction_is_a_panic(
        kind in prop::sample::select(vec![READ_KIND, WRITE_KIND, BITS_KIND, CONFIG_KIND, 9]),
        subdevice in 0..6_u32,
        channel in prop_oneof![0..40_u32, any::<u32>()],
        mut words in prop::collection::vec(prop_oneof![0..40_u32, any::<u32>()], 0..6),
    ) {
        let double = Double::robot_board(32).with(Subdevice::new(Kind::DigitalOut, 40, 1));
        let _ = call(&mut opened(double), kind, subdevice, channel, &mut words);
    }
}
