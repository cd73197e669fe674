//! Logs that cannot be replayed: one line each, with what is wrong.

use std::collections::BTreeMap;
use std::path::Path;

use taktil_lab_command::replay;
use taktil_record::{Log, METADATA_RUN, McapLog};
use taktil_rtcore::Recording;
use taktil_tests::bench::TemporaryFolder;

use crate::alter::{Altered, catalog, rewrite};
use crate::{recorded_run, run_metadata, scene};

fn refusal(path: &Path) -> String {
    let why = replay::repeat(Log::open(path).unwrap()).map(|_| ()).unwrap_err();
    assert_eq!(why.lines().count(), 1, "{why}");
    why
}

fn refusal_of_change(change: impl FnOnce(&mut Altered)) -> String {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("altered.mcap");
    let mut about = Log::open(recorded_run()).unwrap().metadata()[METADATA_RUN].clone();
    change(&mut about);
    rewrite(recorded_run(), &path, Some(about), |_, _, _| true);
    refusal(&path)
}

#[test]
fn metadata_that_do_not_say_what_ran_are_refused_in_one_line() {
    let none = refusal_of_change(BTreeMap::clear);
    assert!(none.contains("does not say what ran"), "{none}");
    let other = refusal_of_change(|about| drop(about.insert("taktil".into(), "0.0.9".into())));
    assert!(other.contains("taktil 0.0.9 wrote it, this is"), "{other}");
    let seed = refusal_of_change(|about| drop(about.insert("seed".into(), "many".into())));
    assert!(seed.contains("seed `many` is no number"), "{seed}");
    let scene =
        refusal_of_change(|about| drop(about.insert("scene_text".into(), "title = 3".into())));
    assert!(scene.contains("what it says of its run cannot be used"), "{scene}");
    let lacks = refusal_of_change(|about| drop(about.remove("scene_text")));
    assert!(lacks.contains("lack `scene_text`"), "{lacks}");
    let board = refusal_of_change(|about| drop(about.insert("mode".into(), "board".into())));
    assert!(board.contains("lack `service_text`"), "{board}");
}

#[test]
fn signals_that_do_not_fit_this_build_are_refused_by_name() {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("a.mcap");
    let about = run_metadata(&scene(1.0), "fast");
    let write = |change: &dyn Fn(&mut taktil_rtcore::record::Catalog)| {
        let mut catalog = catalog();
        change(&mut catalog);
        // A log is not replaced by one without records.
        let _ = std::fs::remove_file(&path);
        McapLog::create(&path, &catalog, &about).unwrap().finish().unwrap();
        refusal(&path)
    };
    let fewer = write(&|catalog| drop(catalog.signals.remove(0)));
    assert!(fewer.contains("it has no signal `hal."), "{fewer}");
    let other = write(&|catalog| catalog.signals[0].fields = catalog.signals[3].fields.clone());
    assert!(other.contains("has other fields"), "{other}");
    let empty = write(&|_| ());
    assert!(empty.contains("ended before its first job"), "{empty}");
    let stranger = write(&|catalog| {
        let mut signal = catalog.signals[0].clone();
        signal.name = "who.knows".into();
        catalog.signals.push(signal);
    });
    assert!(stranger.contains("`who.knows` is unknown here"), "{stranger}");
}

#[test]
fn a_run_without_decisions_is_reported_as_recorded_without_them() {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("values.mcap");
    let scene = taktil_tests::bench::SceneDraft::roll_pin().set("robot.record", "values").scene();
    let machine = taktil_tests::bench::machine(&scene, 1);
    assert!(machine.catalog().find("servo.decision").is_none());
    let log = McapLog::create(&path, machine.catalog(), &run_metadata(&scene, "fast")).unwrap();
    log.finish().unwrap();
    let why = refusal(&path);
    assert!(why.contains("the decisions of lane `servo` were not recorded"), "{why}");
    assert!(Recording::Values < Recording::Decisions);
}

#[test]
fn files_of_another_format_are_refused_before_that() {
    let folder = TemporaryFolder::new();
    let open = |bytes: &[u8]| {
        let path = folder.path().join("file");
        std::fs::write(&path, bytes).unwrap();
        format!("{:#}", Log::open(&path).unwrap_err())
    };
    assert!(open(b"").contains("it is empty"));
    assert!(open(b"tick,release\n").contains("not an MCAP file"));
    // A header and nothing behind it: a log, but of nothing.
    let path = folder.path().join("short");
    std::fs::write(&path, &std::fs::read(recorded_run()).unwrap()[..40]).unwrap();
    assert!(refusal(&path).contains("does not say what ran"));
}
