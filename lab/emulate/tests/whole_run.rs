//! A whole run of the rolling scene through the production drivers in virtual time: every signal of
//! every task has the bits that it has over the simulator's own halves with the same bits, scales
//! and delays, the digest of the run included.

mod common;

use common::cell::{Motors, emulated, simulated};
use std::path::Path;
use taktil_drivers_ethercat::ExchangeTimes;
use taktil_drivers_mesa_emulator::EXCHANGE_TIME;
use taktil_drivers_serial::{BoardKind as SerialKind, Config as SerialConfig};
use taktil_hal::{Devices, Nanos};
use taktil_lab_emulate::BoardKind;
use taktil_lab_scene::operator::Operator;
use taktil_lab_scene::run_virtual;
use taktil_lab_scene::scene::Scene;
use taktil_machine::wiring;
use taktil_record::digest::Digest;
use taktil_rtcore::Machine;
use taktil_rtcore::record::{Catalog, Observer, Record};

fn scene(name: &str) -> Scene {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes");
    Scene::load(&scenes.join(name)).unwrap()
}

/// The machine of a scene over some devices, with the scene's script as its operator.
fn machine(scene: &Scene, devices: Devices) -> Machine {
    let script = scene.script.clone();
    let operator: wiring::OperatorBuilder<'_> =
        Box::new(move |ports| Ok(Box::new(Operator::new(script, ports)?)));
    let builder = wiring::assemble(scene.machine.clone(), &scene.robot, devices, operator);
    builder.unwrap().build().unwrap()
}

/// Tick, release and bytes of a record.
type TracedRecord = (u64, Nanos, Box<[u8]>);

/// All records of a run, by signal, and its digest.
struct Trace {
    digest: Digest,
    names: Vec<String>,
    signals: Vec<Vec<TracedRecord>>,
}

impl Trace {
    fn of(machine: &mut Machine, until: Nanos) -> Trace {
        let catalog: &Catalog = machine.catalog();
        let names: Vec<String> = catalog.signals.iter().map(|signal| signal.name.clone()).collect();
        let digest = Digest::new(catalog);
        let mut trace = Trace { digest, signals: vec![Vec::new(); names.len()], names };
        run_virtual(machine, until, &mut trace).unwrap();
        trace
    }

    /// The first record of each signal that differs, and how many do.
    fn differences(&self, other: &Trace) -> Vec<String> {
        let mut found = Vec::new();
        for ((name, mine), theirs) in self.names.iter().zip(&self.signals).zip(&other.signals) {
            let differing: Vec<_> =
                mine.iter().zip(theirs).filter(|(mine, theirs)| mine != theirs).collect();
            if let Some(((tick, release, mine), (_, _, theirs))) = differing.first() {
                let at = mine.iter().zip(theirs).position(|(a, b)| a != b);
                let count = differing.len();
                found.push(format!("{name}: {count}, first tick {tick} at {release}, byte {at:?}"));
            }
            if mine.len() != theirs.len() {
                found.push(format!("{name}: {} and {} records", mine.len(), theirs.len()));
            }
        }
        found
    }
}

impl Observer for Trace {
    fn record(&mut self, record: &Record<'_>) {
        self.digest.record(record);
        self.signals[record.signal].push((record.tick, record.release, record.body.into()));
    }
}

/// Runs a scene once through card and tactile board, once over the simulator's halves, and
/// compares all that was recorded and the world at the end. How far the pin has rolled (rad), and
/// the scans that came.
fn compared(mut scene: Scene, board: BoardKind, config: &SerialConfig, until: Nanos) -> (f64, u64) {
    let (cell, devices) = emulated(&scene, Motors::Card, board, config, &[]);
    let mut first = machine(&scene, devices);
    let through_boards = Trace::of(&mut first, until);
    // Smart serial takes its time to the outputs, a scan its time to the host.
    scene.actuation_delay = EXCHANGE_TIME;
    scene.world.tactile.delay_scans = 1;
    let (world, devices) = simulated(&scene, cell.lock().unwrap().scans_before);
    let mut second = machine(&scene, devices);
    let directly = Trace::of(&mut second, until);
    assert_eq!(through_boards.names, directly.names);
    let differences = through_boards.differences(&directly);
    assert!(differences.is_empty(), "{differences:#?}");
    assert_eq!(through_boards.digest.hex(), directly.digest.hex());
    let mut world = world.lock().unwrap();
    world.advance(until);
    assert_eq!(cell.lock().unwrap().world_hash(until), world.state_hash());
    let scans = cell.lock().unwrap().session.health().scans;
    let rolled = world.truth().pin_roll_rad;
    println!("{board}: digest {}, {scans} scans, rolled {rolled:.3} rad", directly.digest.hex());
    drop((first, second));
    (rolled.abs(), scans)
}

/// Through a card and a Myrmex pad of 200 scans a second, whose rows are read one after the other.
fn myrmex(until: Nanos) -> (f64, u64) {
    let mut scene = scene("roll-pin.toml");
    let config = SerialConfig { rate_hz: 200.0, ..SerialConfig::default() };
    let row_period = config.geometry().row_period;
    scene.world.tactile.row_us = row_period.as_micros_f64();
    compared(scene, BoardKind::Myrmex, &config, until)
}

/// Through a card and a FlexiTac pad of 16 x 32 tactels of 8 bits, 100 scans a second.
fn flexitac(until: Nanos) -> (f64, u64) {
    let scene = scene("flexitac-16x32.toml");
    let config = SerialConfig {
        board: SerialKind::Flexitac,
        rows: 16,
        cols: 32,
        rate_hz: 100.0,
        // 16 rows in 0.6 ms each, as the scene has them.
        scan_us: 9_600,
        ..SerialConfig::default()
    };
    compared(scene, BoardKind::Flexitac, &config, until)
}

#[test]
fn a_rolling_run_has_the_digest_that_it_has_over_the_simulator_s_own_halves() {
    let (rolled, scans) = myrmex(Nanos::from_secs(12));
    assert!(rolled > 0.1 && scans > 2_390, "{rolled} rad, {scans} scans");
}

#[test]
fn a_pin_rolls_under_16_by_32_tactels_at_the_rate_of_the_board() {
    let (rolled, scans) = flexitac(Nanos::from_secs(12));
    assert!(rolled > 0.1 && scans > 1_190, "{rolled} rad, {scans} scans");
}

/// How far the pin rolls (rad) in 12 s with drives on a segment, and the digest of the run.
fn over_a_segment(exchange: ExchangeTimes, faults: &[&str]) -> (f64, String) {
    let mut scene = scene("roll-pin.toml");
    let config = SerialConfig { rate_hz: 200.0, ..SerialConfig::default() };
    scene.world.tactile.row_us = config.geometry().row_period.as_micros_f64();
    // Three frames that are lost in a row take two readings or two writes.
    scene.machine.sense.get_or_insert_default().failures_max = 3;
    scene.machine.actuate.get_or_insert_default().failures_max = 3;
    let motors = Motors::Drives(exchange);
    let (cell, devices) = emulated(&scene, motors, BoardKind::Myrmex, &config, faults);
    let mut machine = machine(&scene, devices);
    let trace = Trace::of(&mut machine, Nanos::from_secs(12));
    let rolled = cell.lock().unwrap().robot.lock().unwrap().world().truth().pin_roll_rad;
    let digest = trace.digest.hex();
    println!("ethercat {exchange:?} {faults:?}: digest {digest}, rolled {rolled:.3} rad");
    (rolled.abs(), digest)
}

#[test]
fn the_pin_rolls_with_drives_on_an_ethercat_segment() {
    let (rolled, digest) = over_a_segment(ExchangeTimes::Twice, &[]);
    assert!(rolled > 0.1, "{rolled} rad");
    let again = over_a_segment(ExchangeTimes::Twice, &[]);
    assert_eq!(again, (rolled, digest), "the same frames at the same instants");
}

#[test]
fn the_pin_rolls_over_a_segment_whose_answers_are_collected_a_cycle_later() {
    let (rolled, _) = over_a_segment(ExchangeTimes::Pipelined, &[]);
    assert!(rolled > 0.1, "{rolled} rad");
}

#[test]
fn the_pin_rolls_on_while_frames_of_a_segment_are_lost() {
    let faults = [
        "kind=loss target=ethercat at=6 for=5 value=0.01",
        "kind=silence target=ethercat at=11.5 for=0.00375",
    ];
    let (rolled, digest) = over_a_segment(ExchangeTimes::Twice, &faults);
    let (without, other) = over_a_segment(ExchangeTimes::Twice, &[]);
    assert_ne!(digest, other, "frames were lost");
    assert!((rolled - without).abs() < 0.05, "{rolled} rad, {without} rad without loss");
}

#[test]
#[ignore = "a minute: cargo test --release -p taktil-lab-emulate --test whole_run -- --ignored"]
fn a_minute_of_rolling_has_that_digest_too() {
    let (_, scans) = myrmex(Nanos::from_secs(60));
    assert!(scans > 11_990, "{scans} scans");
    let (_, scans) = flexitac(Nanos::from_secs(60));
    assert!(scans > 5_990, "{scans} scans");
}
