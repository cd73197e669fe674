//! Gains of the whole stack edited while it rolls: the same bits live and in virtual time, the log
//! says what was changed, and nothing else moves.

use std::sync::atomic::AtomicBool;

use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_rtcore::live::{self, Contract, Pace, RunOptions};
use taktil_rtcore::parameter::Edit;
use taktil_rtcore::{Nanos, guard};
use taktil_signal::Torque;
use taktil_tests::bench::{RecordedRun, SceneDraft, machine, run};
use toml::{Table, Value};

/// The rolling scene, short, with damping, press speed and window edited at 0.4 s, damping again
/// later.
fn edited_scene() -> Scene {
    let edit = |at_s: f64, set: &[(&str, f64)]| {
        let set = set.iter().map(|(name, value)| ((*name).to_owned(), Value::from(*value)));
        let mut table = Table::new();
        table.insert("at_s".into(), at_s.into());
        table.insert("set".into(), Value::Table(set.collect()));
        Value::Table(table)
    };
    let edits = vec![
        edit(
            0.4,
            &[
                ("joint_servo.damping", 0.6),
                ("tactile_servo.press_mm_s", 2.0),
                ("actuate.following_gain_s", 0.1),
            ],
        ),
        edit(0.45, &[("joint_servo.damping[2]", 0.4)]),
    ];
    SceneDraft::roll_pin().set("duration_s", 0.6).set("edit", edits).scene()
}

#[test]
fn an_edit_takes_effect_from_its_instant_on_and_is_recorded() {
    let scene = edited_scene();
    let kept = run(&scene, 1);
    let edits = kept.of::<Edit>("servo.edit");
    let at: Vec<Nanos> = edits.iter().map(|(release, _)| *release).collect();
    assert_eq!(at, [Nanos::from_millis(400), Nanos::from_millis(450)]);
    let first = edits[0].1;
    assert_eq!(first.count, 8);
    let damping = [0.35, 0.35, 0.35, 0.5, 0.5, 0.5];
    assert_eq!(first.old[1..7], damping, "{first:?}");
    assert_eq!((edits[1].1.old[0], edits[1].1.new[0]), (0.6, 0.4));
    let plain = run(&SceneDraft::roll_pin().set("duration_s", 0.6).scene(), 1);
    let torque = |kept: &RecordedRun| kept.of::<Torque>("joint_servo.torque");
    let (edited, plain) = (torque(&kept), torque(&plain));
    let differs = edited.iter().zip(&plain).find(|(a, b)| a != b).expect("the gains matter");
    assert!(differs.0.0 >= Nanos::from_millis(400), "not before: {}", differs.0.0);
}

#[test]
fn edits_are_the_same_bits_live() {
    let scene = edited_scene();
    let expected = run(&scene, 1);
    let mut machine = machine(&scene, 1);
    let mut kept = RecordedRun::new(&machine);
    let terms = RunOptions { until: scene.duration, contract: Contract::Soft, pace: Pace::Slip };
    live::run(&mut machine, terms, &AtomicBool::new(false), &mut kept).unwrap();
    if machine.figures().any(|(_, figures)| figures.records_dropped > 0) {
        taktil_tests_script::report_skip("records were lost to a busy machine");
        return;
    }
    assert_eq!(kept.difference(&expected, scene.duration), None);
    assert!(!guard::installed() || machine.figures().all(|(_, f)| f.allocations == 0));
}

#[test]
fn edits_that_cannot_be_meant_are_refused_where_they_stand() {
    let refused = |at_s: f64, name: &str, value: f64| {
        let mut set = Table::new();
        set.insert(name.into(), value.into());
        let mut edit = Table::new();
        edit.insert("at_s".into(), at_s.into());
        edit.insert("set".into(), Value::Table(set));
        let scene = SceneDraft::roll_pin().set("edit", vec![Value::Table(edit)]).scene();
        Assembly::new(&scene).with_seed(1).build().err().expect("must be refused").to_string()
    };
    let text = refused(1.0, "joint_servo.damping", f64::NAN);
    assert!(text.contains("edit[0].set.joint_servo.damping: NaN is not within"), "{text}");
    assert!(text.contains("give 0.035 to 1.4"), "{text}");
    let text = refused(1.0, "joint_servo.dumping", 1.0);
    assert!(text.contains("parameters are: joint_servo.bandwidth_rad_s, joint_servo.damping"));
    let text = refused(1.0, "actuate.following_floor_deg", 1e9);
    assert!(text.contains("is not within the range of actuate.following_floor_deg[0]"), "{text}");
}
