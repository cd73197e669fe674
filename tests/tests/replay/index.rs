//! Replay of a run that finds home by index pulses: the pulses are an input like the counts, with a
//! tape of their own, and the runs here depend on them.

use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use taktil_lab_command::diff::Comparison;
use taktil_lab_command::replay;
use taktil_lab_scene::scene::Scene;
use taktil_machine::tape::IndexEntry;
use taktil_record::{Log, McapLog};
use taktil_rtcore::live::{self, Contract, Pace, RunOptions};
use taktil_rtcore::{Payload, virtual_time};
use taktil_signal::{HomeCheck, JointState};
use taktil_tests::bench::{SceneDraft, TemporaryFolder, machine};

use crate::alter::rewrite_as;
use crate::{Recorder, divergence, replay_outcome, run_metadata};

/// As far as the second calibration, which the pulses grant, and 50 ms of what follows from it.
fn scene() -> Scene {
    SceneDraft::of("home.toml").first_requests(7).set("duration_s", 4.0).scene()
}

/// Live runs until one is recorded whole: a machine that stands still for half a second loses
/// records.
const LIVE_RUNS_MAX: usize = 5;

/// The bytes of the run: in virtual time, or live and then maybe not whole, which is said.
fn record(live: bool) -> (Vec<u8>, bool) {
    let (scene, folder) = (scene(), TemporaryFolder::new());
    let path = folder.path().join("run.mcap");
    let mut machine = machine(&scene, 1);
    let about = run_metadata(&scene, if live { "live" } else { "fast" });
    let mut log = Recorder(McapLog::create(&path, machine.catalog(), &about).unwrap());
    let stop = AtomicBool::new(false);
    if live {
        let terms =
            RunOptions { until: scene.duration, contract: Contract::Soft, pace: Pace::Slip };
        live::run(&mut machine, terms, &stop, &mut log).unwrap();
    } else {
        virtual_time::run(&mut machine, scene.duration, &stop, &mut log).unwrap();
    }
    log.0.finish().unwrap();
    let whole = machine.figures().all(|(_, figures)| figures.records_dropped == 0);
    (std::fs::read(&path).unwrap(), whole)
}

/// The bytes of a run in virtual time, recorded once for all tests.
fn recorded_bytes() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| record(false).0)
}

/// All values of a signal, with their ticks.
fn values<T: Payload>(log: &Log, signal: &str) -> Vec<(u64, T)> {
    let channel = log.find(signal).unwrap_or_else(|| panic!("there is no `{signal}`"));
    let messages = log.messages().filter(|message| message.channel == channel);
    messages.map(|m| (m.tick, T::decode(&m.body[..T::SIZE]).unwrap())).collect()
}

/// The tick at which the pulses granted the home pose.
fn home_grant_tick(log: &Log) -> u64 {
    let told: Vec<(u64, HomeCheck)> = values(log, "sense.home");
    assert_eq!(told.len(), 2, "asked twice");
    assert!(told[0].1.refused != 0 && told[1].1.refused == 0, "denied, then granted");
    told[1].0
}

#[test]
fn a_live_run_that_finds_home_by_index_pulses_gives_its_bits_again() {
    let mut runs = (0..LIVE_RUNS_MAX).map(|_| record(true));
    let Some((bytes, _)) = runs.find(|(_, whole)| *whole) else {
        taktil_tests_script::report_skip("this machine lost records of every live run");
        return;
    };
    let log = Log::from_bytes(bytes).unwrap();
    let virtually = Log::from_bytes(recorded_bytes().to_vec()).unwrap();
    assert!(Comparison::new(&log, &virtually).equal(), "live and virtual time carry the same bits");
    let tick = home_grant_tick(&log);
    let pulses: Vec<(u64, IndexEntry)> = values(&log, "hal.index");
    assert!(pulses[0].1.seen.iter().all(|seen| *seen == 0), "none at power-up");
    assert!(pulses.iter().any(|row| row.0 == tick && row.1.seen[..6] == [1; 6]), "all by then");
    assert_eq!(values::<JointState>(&log, "sense.joints").last().unwrap().1.calibrated, 1);
    let (outcome, again) = replay::repeat(log).unwrap_or_else(|why| panic!("{why}"));
    assert!(outcome.equal() && outcome.gap.is_none(), "{}", replay::text(&outcome));
    assert!(outcome.comparison.compared.iter().any(|signal| signal.signal == "hal.index"));
    let again = Log::from_bytes(again).unwrap();
    assert_eq!(values::<IndexEntry>(&again, "hal.index"), pulses);
}

#[test]
fn a_pulse_that_was_altered_is_found_and_moves_the_home_pose() {
    let folder = TemporaryFolder::new();
    let (whole, path) = (folder.path().join("whole.mcap"), folder.path().join("altered.mcap"));
    std::fs::write(&whole, recorded_bytes()).unwrap();
    let tick = home_grant_tick(&Log::open(&whole).unwrap());
    let catalog = machine(&scene(), 1).catalog().clone();
    rewrite_as(&catalog, &whole, &path, None, |signal, at, body| {
        if signal == "hal.index" && at == tick {
            let mut entry = <IndexEntry>::decode(body).unwrap();
            entry.counts[4] += 1;
            entry.encode(body);
        }
        true
    });
    let outcome = replay_outcome(&path);
    assert!(!outcome.equal());
    let (signal, at, _, _) = divergence(&outcome.comparison);
    assert_eq!(at, tick);
    assert!(["sense.home", "sense.joints"].contains(&signal.as_str()), "{signal}");
    // Pulses that the log does not have are named.
    rewrite_as(&catalog, &whole, &path, None, |signal, at, _| signal != "hal.index" || at != 77);
    let lack = replay_outcome(&path).lack.map(|(tape, at)| (tape, at.0));
    assert_eq!(lack, Some(("hal.index", 77 * 2_500_000)));
}
