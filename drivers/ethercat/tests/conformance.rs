//! Every half passes hal's conformance suite, seen from what the emulated devices put out.

mod rig;

use rig::{CYCLE_PERIOD, Lane, Rig, codes_of, lines_of, six_drives, terminals};
use taktil_drivers_ethercat::{Config, ExchangeTimes};
use taktil_hal::conformance::{
    CycleDriver, check_analog_in, check_analog_out_drop, check_analog_out_observed,
    check_digital_in, check_digital_out_drop, check_digital_out_observed, check_encoders,
};
use taktil_hal::{AnalogOut, CHANNELS, DacCode, LinesOut, Nanos};

/// A bench whose releases follow those of a lane that brought the segment to operation.
fn bench<'a>(rig: &'a Rig, lane: &Lane) -> CycleDriver<'a> {
    CycleDriver::new(lane.release + CYCLE_PERIOD, CYCLE_PERIOD, |release| {
        let step = release.0 / CYCLE_PERIOD.0;
        rig.set_counts(|joint| step * 1_700 * (joint as i64 + 1) - 40_000);
        let mut cell = rig::locked(&rig.cell);
        cell.volts = vec![step as f64 % 20.0 - 10.0; 4];
        cell.lines = vec![(step % 256) as u8];
        drop(cell);
        rig.pass(CYCLE_PERIOD);
    })
}

/// Commits of one half alone: the other one is not waited for any more.
fn commit_alone(lane: &mut Lane, rig: &Rig) {
    for _ in 0..2 {
        lane.release += CYCLE_PERIOD;
        let analog = lane.halves.analog_out.as_mut().unwrap();
        analog.commit(lane.release, &[DacCode(0); CHANNELS]).unwrap();
        rig.pass(CYCLE_PERIOD);
    }
}

/// Exchanges whose answers are waited for, and those that are collected a cycle later.
const EXCHANGES: [ExchangeTimes; 3] =
    [ExchangeTimes::Twice, ExchangeTimes::Once, ExchangeTimes::Pipelined];

/// The segment in operation.
fn operating(rig: &Rig, config: &Config) -> Lane {
    let mut lane = Lane::new(rig.open(config).unwrap());
    let is_pipelined = config.exchange == ExchangeTimes::Pipelined;
    lane.age = if is_pipelined { CYCLE_PERIOD } else { Nanos::ZERO };
    let last = lane.cycles(rig, 30, false, 0);
    assert!(last.counts.is_ok() && last.analog.is_ok() && last.lines.is_ok(), "{last:?}");
    lane
}

#[test]
fn inputs_conform() {
    let on_both = |exchange| [(exchange, terminals()), (exchange, six_drives())];
    for (exchange, (devices, config)) in EXCHANGES.into_iter().flat_map(on_both) {
        let config = Config { exchange, ..config };
        let rig = Rig::new(devices);
        let mut lane = operating(&rig, &config);
        let mut bench = bench(&rig, &lane);
        assert_eq!(check_encoders(lane.halves.encoders.as_mut().unwrap(), &mut bench), []);
        assert_eq!(check_digital_in(lane.halves.digital_in.as_mut().unwrap(), &mut bench), []);
        if let Some(half) = &mut lane.halves.analog_in {
            assert_eq!(check_analog_in(half, &mut bench), []);
        }
    }
}

#[test]
fn outputs_of_terminals_conform_as_the_cell_sees_them() {
    EXCHANGES.into_iter().for_each(check_terminal_outputs);
}

fn check_terminal_outputs(exchange: ExchangeTimes) {
    let (devices, config) = terminals();
    let config = Config { exchange, ..config };
    let rig = Rig::new(devices);
    let mut lane = operating(&rig, &config);
    commit_alone(&mut lane, &rig);
    let mut bench = bench(&rig, &lane);
    let mut codes = || codes_of(&rig.outputs().volts);
    let mut lines = || lines_of(&rig.outputs().lines);
    let analog = lane.halves.analog_out.as_mut().unwrap();
    assert_eq!(check_analog_out_observed(analog, &mut bench, &mut codes), []);
    let digital = lane.halves.digital_out.as_mut().unwrap();
    assert_eq!(check_digital_out_observed(digital, &mut bench, &mut lines), []);
    let analog = Box::new(lane.halves.analog_out.take().unwrap());
    assert_eq!(check_analog_out_drop(analog, &mut bench, &mut codes), []);
    let digital = Box::new(lane.halves.digital_out.take().unwrap());
    assert_eq!(check_digital_out_drop(digital, &mut bench, &mut lines), []);
}

#[test]
fn targets_of_drives_conform_while_they_follow() {
    EXCHANGES.into_iter().for_each(check_drive_targets);
}

fn check_drive_targets(exchange: ExchangeTimes) {
    let (devices, config) = six_drives();
    // The suite does not commit the lines: their silence must not end what it looks at.
    let config = Config { exchange, watchdog_ms: 5_000, ..config };
    let rig = Rig::new(devices);
    let mut lane = operating(&rig, &config);
    let last = lane.cycles(&rig, 20, true, 0);
    assert!(last.analog.is_ok(), "{last:?}");
    commit_alone(&mut lane, &rig);
    let mut bench = bench(&rig, &lane);
    let mut codes = || {
        let targets = rig.world().segment.target_torques();
        let code = |drive: usize| targets.get(drive).map_or(0, |code| i32::from(*code));
        core::array::from_fn::<DacCode, CHANNELS, _>(|drive| DacCode(code(drive)))
    };
    let analog = lane.halves.analog_out.as_mut().unwrap();
    assert_eq!(check_analog_out_observed(analog, &mut bench, &mut codes), []);
    let analog = Box::new(lane.halves.analog_out.take().unwrap());
    assert_eq!(check_analog_out_drop(analog, &mut bench, &mut codes), []);
}

#[test]
fn the_enable_of_drives_conforms_as_their_controlwords_show_it() {
    EXCHANGES.into_iter().for_each(check_drive_enable);
}

fn check_drive_enable(exchange: ExchangeTimes) {
    let (devices, config) = six_drives();
    let config = Config { exchange, ..config };
    let rig = Rig::new(devices);
    let mut lane = operating(&rig, &config);
    let mut bench = bench(&rig, &lane);
    // The feed and the brakes have no line here; whoever enables says the step that is due.
    let seen = std::cell::Cell::new(LinesOut::SAFE);
    let mut lines = || {
        let words = rig.world().segment.controls();
        let enable = words.iter().all(|word| *word & 6 == 6);
        assert!(enable || words.iter().all(|word| *word & 6 != 6), "{words:04x?}");
        LinesOut { enable, ..seen.get() }
    };
    let digital = lane.halves.digital_out.as_mut().unwrap();
    let found = check_digital_out_observed(digital, &mut bench, &mut lines);
    // Only what is not wired differs.
    let differs = found.iter().filter(|one| one.rule != "commit-reaches-output");
    assert_eq!(differs.count(), 0, "{found:?}");
    let digital = Box::new(lane.halves.digital_out.take().unwrap());
    assert_eq!(check_digital_out_drop(digital, &mut bench, &mut lines), []);
}
