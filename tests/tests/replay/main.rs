//! Replay of logs: runs in virtual time, live on the simulated robot and over a board with overruns
//! give the recorded bits again. Whatever was altered, cut or left out is found or refused.

mod alter;
mod board;
mod index;
mod refusals;
mod renamed;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use alter::{Altered, rewrite};
use taktil_lab_command::diff::{Change, Comparison};
use taktil_lab_command::replay::{self, Outcome};
use taktil_lab_scene::scene::Scene;
use taktil_machine::tape::EncoderEntry;
use taktil_record::{Log, McapLog};
use taktil_rtcore::live::{self, Contract, Pace, RunOptions};
use taktil_rtcore::trace::Decision;
use taktil_rtcore::{Payload, virtual_time};
use taktil_tests::bench::{SceneDraft, TemporaryFolder, machine};

/// What `taktil run` says of itself in a log.
fn run_metadata(scene: &Scene, mode: &str) -> Altered {
    let mut about = Altered::new();
    about.insert("scene".into(), scene.source.path.display().to_string());
    about.insert("scene_text".into(), scene.source.text.clone());
    about.insert("machine_text".into(), scene.machine_text().to_owned());
    about.insert("seed".into(), "1".into());
    about.insert("mode".into(), mode.into());
    about.insert("taktil".into(), env!("CARGO_PKG_VERSION").into());
    about
}

fn scene(seconds: f64) -> Scene {
    SceneDraft::roll_pin().set("duration_s", seconds).scene()
}

/// One second of the rolling experiment in virtual time, recorded once for all tests.
fn recorded_run() -> &'static Path {
    static FOLDER: OnceLock<(TemporaryFolder, PathBuf)> = OnceLock::new();
    let make = || {
        let folder = TemporaryFolder::new();
        let path = folder.path().join("run.mcap");
        let scene = scene(1.0);
        let mut machine = machine(&scene, 1);
        let mut log =
            McapLog::create(&path, machine.catalog(), &run_metadata(&scene, "fast")).unwrap();
        virtual_time::run(&mut machine, scene.duration, &AtomicBool::new(false), &mut log).unwrap();
        log.finish().unwrap();
        (folder, path)
    };
    &FOLDER.get_or_init(make).1
}

fn replay_outcome(path: &Path) -> Outcome {
    let log = Log::open(path).unwrap();
    replay::repeat(log).unwrap_or_else(|why| panic!("{why}")).0
}

/// The first divergence as signal, tick, field and element.
fn divergence(comparison: &Comparison) -> (String, u64, String, Option<usize>) {
    let first = comparison.first().expect("they must differ");
    match &first.change {
        Change::Field { field, index, .. } => {
            (first.signal.clone(), first.tick, field.clone(), *index)
        }
        change => (first.signal.clone(), first.tick, format!("{change:?}"), None),
    }
}

#[test]
fn a_run_in_virtual_time_gives_its_bits_again() {
    let outcome = replay_outcome(recorded_run());
    assert!(outcome.equal() && outcome.gap.is_none(), "{}", replay::text(&outcome));
    assert_eq!(outcome.jobs, 400 + 400 + 200);
    assert_eq!(outcome.fed, ["operator", "world"]);
    assert!(outcome.rerun.contains(&"actuate".to_owned()));
    let names: Vec<&str> = outcome.comparison.compared.iter().map(|s| s.signal.as_str()).collect();
    for name in ["hal.encoders", "hal.tactile", "hal.analog_out", "servo.state", "servo.decision"] {
        assert!(names.contains(&name), "{name} was not compared");
    }
    let object = replay::object(&outcome);
    assert_eq!(object["equal"], true);
    assert_eq!(object["gap"], serde_json::Value::Null);
}

#[test]
fn a_live_run_on_the_simulated_robot_gives_its_bits_again() {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("live.mcap");
    let scene = scene(1.0);
    let mut machine = machine(&scene, 1);
    let mut log =
        Recorder(McapLog::create(&path, machine.catalog(), &run_metadata(&scene, "live")).unwrap());
    let terms = RunOptions { until: scene.duration, contract: Contract::Soft, pace: Pace::Slip };
    live::run(&mut machine, terms, &AtomicBool::new(false), &mut log).unwrap();
    log.0.finish().unwrap();
    let outcome = replay_outcome(&path);
    assert!(outcome.equal(), "{}", replay::text(&outcome));
    if outcome.gap.is_none() {
        let both = Comparison::new(&Log::open(&path).unwrap(), &Log::open(recorded_run()).unwrap());
        assert!(both.equal(), "live and virtual time carry the same bits");
    }
}

/// A log as the audience of a live run.
struct Recorder(McapLog);

impl taktil_rtcore::record::Observer for Recorder {
    fn record(&mut self, record: &taktil_rtcore::record::Record<'_>) {
        self.0.record(record);
    }
}

impl live::RunObserver for Recorder {}

#[test]
fn one_flipped_bit_of_a_recorded_input_is_found_with_its_tick_and_field() {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("altered.mcap");
    rewrite(recorded_run(), &path, None, |signal, tick, body| {
        if signal == "hal.encoders" && tick == 321 {
            let mut entry = <EncoderEntry>::decode(body).unwrap();
            entry.counts[2] ^= 1;
            entry.encode(body);
        }
        true
    });
    let [a, b] = [recorded_run(), &path].map(|path| Log::open(path).unwrap());
    let found = divergence(&Comparison::new(&a, &b));
    assert_eq!(found, ("hal.encoders".into(), 321, "counts".into(), Some(2)));
    // The replay takes the input as it stands: what follows from it is different.
    let outcome = replay_outcome(&path);
    assert!(!outcome.equal());
    let (signal, tick, field, _) = divergence(&outcome.comparison);
    assert_eq!((signal.as_str(), tick, field.as_str()), ("sense.joints", 321, "q_rad"));
    let first = outcome.comparison.first().unwrap();
    assert_eq!((first.lane.as_str(), first.task_and_port().0), ("servo", "sense"));
}

#[test]
fn a_byte_flipped_on_the_disk_is_found_with_its_tick_and_field_too() {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("flipped.mcap");
    let mut bytes = std::fs::read(recorded_run()).unwrap();
    let log = Log::open(recorded_run()).unwrap();
    let encoders = log.find("hal.encoders").unwrap();
    let message = log.messages().find(|m| m.channel == encoders && m.tick == 200).unwrap();
    let at = bytes.windows(message.data.len()).position(|window| window == message.data).unwrap();
    // Stamp, acquired_ns, then the counts: the second byte of the fourth.
    bytes[at + 16 + 8 + 3 * 4 + 1] ^= 0x10;
    std::fs::write(&path, &bytes).unwrap();
    let comparison = Comparison::new(&log, &Log::open(&path).unwrap());
    assert_eq!(divergence(&comparison), ("hal.encoders".into(), 200, "counts".into(), Some(3)));
    let outcome = replay_outcome(&path);
    let (why, until) = outcome.gap.as_ref().expect("it is not whole");
    assert!(why.contains("fails its CRC on /hal/encoders at tick 200"), "{why}");
    assert!(outcome.equal(), "{}", replay::text(&outcome));
    assert!((400_000_000..=500_000_000).contains(&until.0), "{until}");
}

#[test]
fn an_altered_decision_is_found() {
    let folder = TemporaryFolder::new();
    let altered = |name: &str, change: &dyn Fn(&mut Decision)| {
        let path = folder.path().join(name);
        rewrite(recorded_run(), &path, None, |signal, tick, body| {
            if signal == "servo.decision" && tick == 300 {
                let mut decision = Decision::decode(body).unwrap();
                change(&mut decision);
                decision.encode(body);
            }
            true
        });
        replay_outcome(&path)
    };
    let late = altered("late.mcap", &|decision| decision.lags[0] += 1);
    assert!(!late.equal());
    let first = late.comparison.first().unwrap();
    assert_eq!((first.lane.as_str(), first.tick), ("servo", 300));
    let told = altered("told.mcap", &|decision| decision.missed += 1);
    assert_eq!(divergence(&told.comparison), ("servo.health".into(), 300, "missed".into(), None));
    for (name, gapped) in [
        ("skipped.mcap", altered("skipped.mcap", &|decision| decision.skipped += 1)),
        ("lost.mcap", altered("lost.mcap", &|decision| decision.lost += 1)),
    ] {
        let (why, until) = gapped.gap.as_ref().unwrap_or_else(|| panic!("{name}"));
        assert!(why.contains("lane servo after tick 299"), "{why}");
        assert_eq!(until.0, 300 * 2_500_000);
        assert!(gapped.equal(), "before the gap all is well");
    }
}

#[test]
fn an_altered_state_names_its_task() {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("state.mcap");
    let log = Log::open(recorded_run()).unwrap();
    let tasks = &log.channels()[log.find("servo.state").unwrap()].elements;
    let place = tasks.iter().position(|task| task == "setpoint").unwrap();
    rewrite(recorded_run(), &path, None, |signal, tick, body| {
        if signal == "servo.state" && tick == 250 {
            body[8 * place] ^= 1;
        }
        true
    });
    let outcome = replay_outcome(&path);
    let first = outcome.comparison.first().unwrap();
    assert_eq!((first.tick, first.task_and_port()), (250, ("setpoint", "state")));
    assert!(replay::text(&outcome).contains("setpoint"), "{}", replay::text(&outcome));
}

#[test]
fn a_missing_answer_of_a_device_is_named() {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("lack.mcap");
    rewrite(recorded_run(), &path, None, |signal, tick, _| {
        !(signal == "hal.tactile" && tick == 77)
    });
    let outcome = replay_outcome(&path);
    assert_eq!(outcome.lack.map(|(tape, at)| (tape, at.0)), Some(("hal.tactile", 77 * 5_000_000)));
    assert!(!outcome.equal());
    let said = replay::text(&outcome);
    assert!(
        said.contains("tape hal.tactile holds no answer for the job released at 0.385"),
        "{said}"
    );
}

#[test]
fn a_cut_log_is_replayed_as_far_as_it_is_whole() {
    let folder = TemporaryFolder::new();
    let bytes = std::fs::read(recorded_run()).unwrap();
    for (part, name) in [(bytes.len() / 2, "half.mcap"), (bytes.len() * 9 / 10, "most.mcap")] {
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes[..part]).unwrap();
        let outcome = replay_outcome(&path);
        let (_, until) = outcome.gap.as_ref().expect("it is not whole");
        assert!(outcome.equal() && outcome.jobs > 300, "{}", replay::text(&outcome));
        assert!(outcome.reached < *until && until.0 < 1_000_000_000);
    }
    // Only what repeats the messages is missing: nothing is lost.
    let path = folder.path().join("summary.mcap");
    std::fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
    let outcome = replay_outcome(&path);
    assert!(outcome.gap.is_none() && outcome.flaw.is_some());
}
