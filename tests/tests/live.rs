//! The live executor over the whole stack gives the same bits as virtual time, with or without
//! misses, because the simulated world waits. No job makes a heap call.
#![expect(clippy::disallowed_types, reason = "a test keeps others away from the processors")]

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use taktil_lab_scene::scene::Scene;
use taktil_rtcore::live::{self, Contract, Pace, RunOptions};
use taktil_rtcore::{Machine, guard, virtual_time};
use taktil_tests::bench::{RecordedRun, SceneDraft, machine};

/// Live runs that are compared, and tries to get them from a busy machine.
const COMPARED_RUNS: usize = 4;
const LIVE_RUNS_MAX: usize = 12;

/// Images at 200 Hz with a servo at 400 Hz, and both at 1 kHz.
const SCENES: [&str; 2] = ["roll-pin.toml", "roll-pin-1khz.toml"];

fn short_scene(file: &str) -> Scene {
    SceneDraft::of(file).set("duration_s", 0.5).scene()
}

/// Every heap call that a lane counted, with the lane's name.
fn allocations(machine: &Machine) -> Vec<(String, u64)> {
    let found = machine.figures().filter(|(_, figures)| figures.allocations > 0);
    found.map(|(spec, figures)| (spec.name.clone(), figures.allocations)).collect()
}

/// Records that the observer was too slow to take; without them nothing can be compared.
fn lost_records(machine: &Machine) -> u64 {
    machine.figures().map(|(_, f)| f.records_dropped + f.values_dropped).sum()
}

fn run_live(scene: &Scene) -> (RecordedRun, u64) {
    let mut machine = machine(scene, 1);
    let mut kept = RecordedRun::new(&machine);
    let terms = RunOptions { until: scene.duration, contract: Contract::Soft, pace: Pace::Slip };
    let stop = AtomicBool::new(false);
    let account = live::run(&mut machine, terms, &stop, &mut kept).unwrap();
    assert!(guard::installed());
    assert_eq!(allocations(&machine), [], "heap calls inside jobs");
    for (spec, figures) in machine.figures() {
        assert_eq!(figures.jobs, spec.jobs_before(scene.duration), "lane {}", spec.name);
    }
    let misses: u64 = machine.figures().map(|(_, figures)| figures.misses.total()).sum();
    println!("live: {misses} misses, slipped by {}", account.slipped);
    (kept, lost_records(&machine))
}

/// Two live machines at once would spoil each other.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

#[test]
fn live_and_virtual_time_give_the_same_bits_whatever_the_host_does() {
    let _alone = ONE_AT_A_TIME.lock();
    for file in SCENES {
        compare(file);
    }
}

/// A few live runs of the beginning of a scene with one in virtual time.
fn compare(file: &str) {
    let scene = short_scene(file);
    let mut machine = machine(&scene, 1);
    let mut expected = RecordedRun::new(&machine);
    let stop = AtomicBool::new(false);
    virtual_time::run(&mut machine, scene.duration, &stop, &mut expected).unwrap();
    let mut compared = 0;
    for _ in 0..LIVE_RUNS_MAX {
        let (kept, lost) = run_live(&scene);
        if lost == 0 {
            assert_eq!(kept.difference(&expected, scene.duration), None, "{file}");
            compared += 1;
        }
        if compared == COMPARED_RUNS {
            return;
        }
    }
    let why = format_args!(
        "{file}: of {LIVE_RUNS_MAX} live runs a busy machine left {compared} to compare"
    );
    taktil_tests_script::report_skip(why);
}

#[test]
fn the_whole_task_allocates_nothing_in_virtual_time() {
    let _alone = ONE_AT_A_TIME.lock();
    for file in SCENES {
        let scene = SceneDraft::of(file).scene();
        let mut machine = machine(&scene, 1);
        let mut kept = RecordedRun::new(&machine);
        let stop = AtomicBool::new(false);
        virtual_time::run(&mut machine, scene.duration, &stop, &mut kept).unwrap();
        assert!(guard::installed());
        assert_eq!(allocations(&machine), [], "{file}");
        let jobs = |name: &str| machine.figures().find(|(s, _)| s.name == name).unwrap().1.jobs;
        println!("{file}: {} jobs of the servo, {} scans", jobs("servo"), jobs("touch"));
    }
}
