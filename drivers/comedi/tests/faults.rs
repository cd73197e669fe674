//! Faults by plan on the double: busy, late, short, frozen, restarted, unplugged and back. Each is
//! answered with the error that says what to do, counted, and never with a wrong value.

mod rig;

use rig::{
    ANALOG_IN_SUBDEVICE, COUNTERS_SUBDEVICE, CYCLE_PERIOD, LINES_SUBDEVICE, SharedDouble, advance,
    codes_out, lines_out, robot_config,
};
use taktil_drivers_comedi::{Halves, Statistics};
use taktil_drivers_comedi_double::Double;
use taktil_hal::fault::{Fault, FaultPlan};
use taktil_hal::{
    CHANNELS, Counts, DacCode, Encoders, Error, ErrorKind, LinesIn, LinesOut, Nanos, Reading,
};

fn rig(bits: u32) -> (SharedDouble, Halves) {
    let double = SharedDouble::new(Double::robot_board(bits));
    let halves = double.open(&robot_config()).unwrap();
    (double, halves)
}

fn encoders(halves: &mut Halves) -> &mut dyn Encoders {
    halves.encoders.as_deref_mut().unwrap()
}

fn sampled(halves: &mut Halves, at: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
    encoders(halves).sample(at)
}

#[test]
fn counts_are_carried_across_wraps_of_each_width_both_ways() {
    for bits in [16, 24, 32] {
        let (double, mut halves) = rig(bits);
        let step = 1_i64 << (bits - 2);
        for cycle in 1..40_i64 {
            double.look().set_count(COUNTERS_SUBDEVICE, 0, step * cycle);
            double.look().set_count(COUNTERS_SUBDEVICE, 1, -step * cycle);
            let counts = sampled(&mut halves, CYCLE_PERIOD * cycle).unwrap().value;
            let due = [(step * cycle) as i32, (-step * cycle) as i32];
            assert_eq!([counts[0].0, counts[1].0], due, "{bits} bits");
        }
        let reach = encoders(&mut halves).index_pulse_reach();
        assert_eq!(reach, i32::MAX >> (32 - bits));
    }
}

#[test]
fn the_counters_were_armed() {
    let double = SharedDouble::new(Double::robot_board(24));
    double.look().set_count(COUNTERS_SUBDEVICE, 0, 500);
    let mut halves = double.open(&robot_config()).unwrap();
    double.look().set_count(COUNTERS_SUBDEVICE, 0, 700);
    assert_eq!(sampled(&mut halves, CYCLE_PERIOD).unwrap().value[0], Counts(200));
}

#[test]
fn one_list_a_release_serves_all_input_halves() {
    let (double, mut halves) = rig(24);
    double.look().set_sample(ANALOG_IN_SUBDEVICE, 0, 0x9000);
    sampled(&mut halves, CYCLE_PERIOD).unwrap();
    double.look().set_sample(ANALOG_IN_SUBDEVICE, 0, 0xa000);
    let analog_in = halves.analog_in.as_mut().unwrap();
    assert_eq!(analog_in.sample(CYCLE_PERIOD).unwrap().value[0].0, 0x1000);
    assert_eq!(analog_in.sample(CYCLE_PERIOD * 2).unwrap().value[0].0, 0x2000);
}

#[test]
fn a_broken_wire_reads_false() {
    let (double, mut halves) = rig(24);
    let lines = halves.digital_in.as_mut().unwrap();
    assert_eq!(lines.sample(Nanos::ZERO).unwrap().value, LinesIn::default());
    for channel in 0..3 {
        double.look().set_level(LINES_SUBDEVICE, channel, Some(false));
    }
    let all = LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: true };
    assert_eq!(lines.sample(CYCLE_PERIOD).unwrap().value, all);
    double.look().set_level(LINES_SUBDEVICE, 1, None);
    let cut = LinesIn { estop_a_closed: false, ..all };
    assert_eq!(lines.sample(CYCLE_PERIOD * 2).unwrap().value, cut);
}

#[test]
fn a_busy_board_is_transient_and_counted() {
    let (double, mut halves) = rig(24);
    double.plan(&["kind=silence at=0.01 for=0.01"]);
    advance(&double, CYCLE_PERIOD * 4);
    let error = sampled(&mut halves, CYCLE_PERIOD * 4).unwrap_err();
    assert_eq!((error.kind, error.device), (ErrorKind::Transient, "comedi.encoders"));
    // The same release is not tried again by another half.
    let other = halves.analog_in.as_mut().unwrap().sample(CYCLE_PERIOD * 4).unwrap_err();
    assert_eq!((other.kind, other.device), (ErrorKind::Transient, "comedi.analog_in"));
    let due = Statistics { lists_refused: 1, ..Statistics::default() };
    assert_eq!(halves.monitor.statistics(), Some(due));
    let out = halves.analog_out.as_mut().unwrap();
    assert_eq!(out.safe().unwrap_err().kind, ErrorKind::Transient);
    assert_eq!(halves.monitor.statistics().unwrap().lists_refused, 4);
    advance(&double, CYCLE_PERIOD * 8);
    sampled(&mut halves, CYCLE_PERIOD * 8).unwrap();
}

#[test]
fn a_short_list_is_no_reading() {
    let (double, mut halves) = rig(24);
    double.plan(&["kind=truncation value=1 for=0.005"]);
    for cycle in 0..2 {
        let error = sampled(&mut halves, CYCLE_PERIOD * cycle).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Transient);
    }
    let codes = [DacCode(5); CHANNELS];
    let error = halves.analog_out.as_mut().unwrap().commit(Nanos::ZERO, &codes).unwrap_err();
    assert_eq!(error.kind, ErrorKind::Transient);
    assert_eq!(halves.monitor.statistics().unwrap().lists_short, 3);
    advance(&double, CYCLE_PERIOD * 2);
    halves.analog_out.as_mut().unwrap().commit(Nanos::ZERO, &codes).unwrap();
    assert_eq!(codes_out(&double)[..6], codes[..6]);
}

#[test]
fn safe_values_get_through_to_a_board_that_times_out_now_and_then() {
    let (double, mut halves) = rig(24);
    double.plan(&["kind=loss value=0.3"]);
    let codes = [DacCode(9_000); CHANNELS];
    let (mut refused, mut unsafe_left) = (0, 0);
    for cycle in 0..400 {
        let out = halves.analog_out.as_mut().unwrap();
        refused += usize::from(out.commit(CYCLE_PERIOD * cycle, &codes).is_err());
        let answer = out.safe();
        let safe = codes_out(&double)[..6] == [DacCode(0); 6];
        assert!(safe || answer.is_err(), "safe() claimed what it did not do");
        unsafe_left += usize::from(!safe);
    }
    // 0.3 of 400; after three attempts 0.027 of 400, and the bounds are four sigmas away.
    assert!((83..157).contains(&refused), "{refused}");
    assert!(unsafe_left < 24, "{unsafe_left}");
}

#[test]
fn frozen_inputs_stand_still_and_move_on_afterwards() {
    let (double, mut halves) = rig(24);
    double.plan(&["kind=frozen at=0.01 for=0.01"]);
    let mut seen = Vec::new();
    for cycle in 1..=9 {
        advance(&double, CYCLE_PERIOD * cycle);
        seen.push(sampled(&mut halves, CYCLE_PERIOD * cycle).unwrap().value[5].0);
    }
    assert_eq!(seen, [2_000, 4_000, 6_000, 6_000, 6_000, 6_000, 6_000, 16_000, 18_000]);
}

#[test]
fn an_unplugged_board_is_lost_for_good_and_opens_anew_on_its_return() {
    let (double, mut halves) = rig(24);
    double.plan(&["kind=unplugged at=0.01 for=0.01"]);
    advance(&double, CYCLE_PERIOD * 4);
    let kind = |halves: &mut Halves, at| sampled(halves, at).unwrap_err().kind;
    assert_eq!(kind(&mut halves, CYCLE_PERIOD * 4), ErrorKind::Lost);
    let out = halves.analog_out.as_mut().unwrap();
    assert_eq!(out.safe().unwrap_err().kind, ErrorKind::Lost);
    let lines = halves.digital_out.as_mut().unwrap();
    assert_eq!(lines.commit(Nanos::ZERO, &LinesOut::SAFE).unwrap_err().kind, ErrorKind::Lost);
    assert!(double.node().is_err());
    // It is back, and a half that has been lost stays so.
    advance(&double, CYCLE_PERIOD * 9);
    assert_eq!(kind(&mut halves, CYCLE_PERIOD * 9), ErrorKind::Lost);
    let analog = halves.analog_in.as_mut().unwrap().sample(CYCLE_PERIOD * 9);
    assert_eq!(analog.unwrap_err().kind, ErrorKind::Lost);
    drop(halves);
    let mut halves = double.open(&robot_config()).unwrap();
    sampled(&mut halves, CYCLE_PERIOD * 9).unwrap();
    assert_eq!((codes_out(&double)[0], lines_out(&double)), (DacCode(0), LinesOut::SAFE));
}

#[test]
fn a_fault_without_a_meaning_here_is_refused() {
    let mut double = Double::robot_board(24);
    for kind in ["corruption value=1", "delay value=1", "duplication value=1"] {
        let fault: Fault = format!("kind={kind}").parse().unwrap();
        let bad = double.set_plan(FaultPlan::new(vec![fault]), 0).unwrap_err();
        assert_eq!(bad.place, "kind");
        assert!(bad.remedy.contains("loss, truncation, silence"), "{bad}");
    }
    let other: Fault = "kind=delay value=1 target=mesa".parse().unwrap();
    double.set_plan(FaultPlan::new(vec![other]), 0).unwrap();
}

#[test]
fn a_gauge_at_an_end_of_its_converter_is_over_range_whatever_calibration_makes_of_it() {
    let double = SharedDouble::new(Double::robot_board(24));
    let mut config = robot_config();
    config.force_torque[4].gain = 0.9;
    let mut halves = double.open(&config).unwrap();
    let samples = [0, 1, 0x8000, 0xfffe, 0xffff, 0xffff];
    for (channel, sample) in (8..).zip(samples) {
        double.look().set_sample(ANALOG_IN_SUBDEVICE, channel, sample);
    }
    let read = halves.force_torque.as_mut().unwrap().sample(CYCLE_PERIOD).unwrap().value;
    assert_eq!(read.over_range, [true, false, false, false, true, true]);
    assert!(read.codes[4] < read.codes[5], "calibration has taken the code off the end: {read:?}");
}

#[test]
fn two_lanes_at_once_read_right_or_answer_transient() {
    let (double, mut halves) = rig(24);
    double.look().set_sample(ANALOG_IN_SUBDEVICE, 0, 0x9000);
    let mut wrist = halves.force_torque.take().unwrap();
    let thread = std::thread::spawn(move || {
        let releases = (0..20_000).map(|at| Nanos::from_micros(at * 1_000));
        releases.filter(|at| wrist.sample(*at).is_err()).count()
    });
    let analog_in = halves.analog_in.as_mut().unwrap();
    let mut refused = 0;
    for cycle in 0..8_000 {
        match analog_in.sample(CYCLE_PERIOD * cycle) {
            Ok(reading) => assert_eq!(reading.value[0].0, 0x1000),
            Err(error) => {
                assert_eq!(error.kind, ErrorKind::Transient);
                refused += 1;
            }
        }
    }
    let refused = refused + thread.join().unwrap();
    // What one lane could not add to the counts is added at its next exchange.
    let counted = halves.monitor.statistics().unwrap().contentions as usize;
    assert!(counted <= refused, "{counted} of {refused}");
}
