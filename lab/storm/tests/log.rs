//! The log of a failing case: it is read whole, says what ran and what was broken, holds the run
//! that failed, and changes nothing of it. A folder that cannot take it is refused.

use std::path::PathBuf;

use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;
use taktil_lab_storm::campaign::StormPlan;
use taktil_lab_storm::case::{Campaign, Case, Scenes};
use taktil_lab_storm::log::{FAULTS_KEY, LogFolder, VIOLATIONS_KEY};
use taktil_lab_storm::run::run;
use taktil_record::summary::Summary;
use taktil_record::{Log, METADATA_RESULT, METADATA_RUN};
use taktil_rtcore::{Mode, Payload};
use taktil_signal::ControlState;

/// A fault that does not end, in a campaign after whose faults the machine has to come back.
const LASTING_FAULT: &str = "kind=dead target=digital_in.2 at=1";

fn case(faults: &str) -> Case {
    let plan = FaultPlan::new(vec![faults.parse().unwrap()]);
    let length = Some(Nanos::from_secs(2));
    let scenes = Scenes::built_in().unwrap();
    let storm =
        StormPlan { scenes, campaign: Campaign::Recoverable, plan: Some(plan), length, jobs: 1 };
    storm.case(3)
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("taktil-storm-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn a_failing_case_leaves_a_log_that_is_read_whole_and_holds_its_run() {
    let case = case(LASTING_FAULT);
    let outcome = run(&case).unwrap();
    assert!(!outcome.violations.is_empty(), "a machine that never has power did come back");
    let folder = folder("log");
    let logs = LogFolder::new(&folder).unwrap();
    // An older log gives way.
    std::fs::write(logs.file(&case), "an older one").unwrap();
    let path = logs.write(&case, "taktil storm --seeds 3".to_owned()).unwrap();
    assert_eq!(path, folder.join("recoverable-3.mcap"));
    let log = Log::open(&path).unwrap();
    assert_eq!(log.damage(), None);
    assert!(log.gaps().is_empty());
    let about = &log.metadata()[METADATA_RUN];
    assert_eq!(
        (&*about["seed"], &*about["mode"], &*about["campaign"]),
        ("3", "storm", "recoverable")
    );
    assert_eq!(about[FAULTS_KEY], case.plan.faults()[0].to_string());
    assert!(!about["scene_text"].is_empty() && !about["machine_text"].is_empty());
    let summary = Summary::from_log(&log).unwrap().unwrap();
    assert_eq!((summary.digest, summary.seed), (outcome.digest, 3));
    let broken = &log.metadata()[METADATA_RESULT][VIOLATIONS_KEY];
    assert_eq!(broken.lines().count(), outcome.violations.len(), "{broken}");
    assert!(broken.starts_with(outcome.violations[0].rule), "{broken}");
    let control = log.find("supervisor.control").unwrap();
    let modes: Vec<Mode> = log
        .messages()
        .filter(|message| message.channel == control)
        .map(|message| ControlState::decode(message.body).unwrap().mode())
        .collect();
    assert!(modes.contains(&Mode::Fault) || modes.contains(&Mode::Ready), "{modes:?}");
    let last = log.messages().map(|message| message.release_ns).max().unwrap();
    assert!(Nanos(last) > outcome.length - Nanos::from_millis(20), "{last}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_folder_that_is_not_there_or_takes_no_file_is_refused_with_a_remedy() {
    let folder = folder("refused");
    let refused = |path: PathBuf| LogFolder::new(&path).unwrap_err().0;
    let missing = refused(folder.join("a/b"));
    assert!(missing.contains("a/b: there is no such folder; name one that is there"), "{missing}");
    let file = folder.join("file");
    std::fs::write(&file, "").unwrap();
    let no_folder = refused(file);
    assert!(no_folder.contains("file: is no folder; "), "{no_folder}");
    // No user may make a file there.
    let closed = refused(PathBuf::from("/proc/self"));
    assert!(closed.starts_with("--log /proc/self: ") && closed.contains("; name a"), "{closed}");
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1, "something was left behind");
    std::fs::remove_dir_all(&folder).unwrap();
}
