//! The laws of touch side by side on the same scenes and seeds, judged by the simulator's truth.

use taktil_lab_experiment::evaluation::Evaluation;
use taktil_lab_experiment::{LawName, evaluated_run, with_law};
use taktil_rtcore::FaultCode;
use taktil_tests::bench::SceneDraft;

/// A scene of the repository under a law.
fn run(scene: &str, law: LawName, seed: u64) -> Evaluation {
    let verdict =
        evaluated_run(&with_law(&SceneDraft::of(scene).scene(), law), seed, false).unwrap();
    let figures = &verdict.figures;
    assert!(figures.faults.is_empty() && figures.contact_lost == 0, "{scene} {law:?} {seed}");
    verdict
}

/// Root mean square of the force's error (N).
fn force(verdict: &Evaluation) -> f64 {
    verdict.force_n.rms().unwrap()
}

#[test]
fn on_a_level_table_the_model_holds_the_force_three_times_better_within_a_twentieth() {
    for seed in [1, 2] {
        let thesis = run("roll-pin.toml", LawName::Thesis, seed);
        let model = run("roll-pin.toml", LawName::Model, seed);
        let (old, new) = (force(&thesis), force(&model));
        assert!(new < 0.05 * 14.65 && new < old / 3.0, "seed {seed}: {new} N and {old} N");
        assert!(model.yaw_deg.rms().unwrap() < 0.7 && model.figures.strokes >= 3);
    }
}

#[test]
fn a_panning_table_is_followed_within_a_degree_where_the_thesis_s_law_falls_behind() {
    let thesis = run("panning.toml", LawName::Thesis, 1);
    let model = run("panning.toml", LawName::Model, 1);
    let lag = |verdict: &Evaluation| verdict.yaw_deg.peak().unwrap();
    assert!(lag(&thesis) > 5.0, "the weak loop: {} deg", lag(&thesis));
    assert!(lag(&model) < 1.0, "{} deg", lag(&model));
}

#[test]
fn a_tilting_table_is_followed_ten_times_closer() {
    let thesis = run("turning-x.toml", LawName::Thesis, 1);
    let model = run("turning-x.toml", LawName::Model, 1);
    let tilt = |verdict: &Evaluation| verdict.tilt_deg.rms().unwrap();
    assert!(tilt(&model) < 0.1 * tilt(&thesis), "{} and {}", tilt(&model), tilt(&thesis));
}

#[test]
fn projector_and_pid_rolls_too() {
    let verdict = run("roll-pin.toml", LawName::ProjectorPid, 1);
    assert!(verdict.figures.strokes >= 3, "{} strokes", verdict.figures.strokes);
}

#[test]
fn rolling_five_times_as_fast_the_model_keeps_its_bounds() {
    let verdict = run("held/fast-roll.toml", LawName::Model, 1);
    assert!(force(&verdict) < 0.05 * 14.65, "{} N", force(&verdict));
    assert!(verdict.yaw_deg.rms().unwrap() < 0.7 && verdict.figures.strokes >= 8);
}

#[test]
fn the_wrist_alone_cannot_follow_a_panning_table_and_with_touch_it_can() {
    let yaw = |law| run("panning.toml", law, 1).yaw_deg.rms().unwrap();
    let (alone, both) = (yaw(LawName::HybridForce), yaw(LawName::HybridForceTouch));
    assert!(alone > 10.0 && both < 1.5, "{alone} and {both} deg");
}

#[test]
fn an_arm_that_does_not_know_where_it_is_and_presses_too_hard_loses_its_power() {
    let fault: toml::Table = "kind = 'dead_encoder'\njoint = 2\nat_s = 5.0".parse().unwrap();
    let draft = SceneDraft::of("roll-pin.toml").set("world.fault", vec![fault]);
    let verdict = evaluated_run(&with_law(&draft.scene(), LawName::Model), 1, false).unwrap();
    let faults = &verdict.figures.faults;
    assert!(faults.contains(FaultCode::Overload), "{faults:?}");
}

#[test]
fn a_delay_that_the_law_cannot_remember_at_its_period_is_refused_with_its_place() {
    let refused = |scene: &str, delay_ms: f64| {
        let mut scene = with_law(&SceneDraft::of(scene).scene(), LawName::Model);
        scene.machine.tactile_servo.as_mut().expect("a section").model.delay_ms = delay_ms;
        taktil_lab_scene::assembly::Assembly::new(&scene)
            .with_seed(1)
            .build()
            .err()
            .map(|bad| format!("{bad:#}"))
    };
    assert_eq!(refused("roll-pin-1khz.toml", 30.0), None);
    assert_eq!(refused("roll-pin.toml", 40.0), None);
    let bad = refused("roll-pin-1khz.toml", 35.0).expect("35 jobs and an image");
    assert!(bad.contains("model.delay_ms") && bad.contains("at most 30"), "{bad}");
}
