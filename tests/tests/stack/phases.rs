//! Touch tasks as files of phases: those that were laws with a description give the same bits, and
//! exploratory procedures run from their first phase to their end.

use taktil_rtcore::Nanos;
use taktil_signal::{Contact, PhaseChange, State, contact, phase_cause};
use taktil_tests::bench::{RecordedRun, SceneDraft, run};

/// The scene in `phases`, with its task found from anywhere.
fn of_phases(scene: &str, task: &str) -> SceneDraft {
    let task = taktil_tests::root().join("sim/scenes/touch").join(task);
    SceneDraft::of(&format!("phases/{scene}"))
        .set("robot.tactile_servo.task_file", task.display().to_string())
}

/// Asserts that every signal of the run with a law of its own has the same bytes in the run by
/// phases, which has one signal more. What the servo lane's tasks keep to themselves differs: a law
/// of its own remembers other things than a table.
fn assert_same_bits(what: &str, by_law: &RecordedRun, by_phases: &RecordedRun) {
    let names: Vec<&str> = by_law.signals().collect();
    assert!(names.len() > 15, "{names:?}");
    for name in names.iter().filter(|name| **name != "servo.state") {
        let (a, b) = (by_law.bodies(name), by_phases.bodies(name));
        let differs = a.iter().zip(&b).position(|(a, b)| a != b);
        assert_eq!((a.len(), differs), (b.len(), None), "{what}: {name}");
    }
    let more: Vec<&str> = by_phases.signals().filter(|name| !names.contains(name)).collect();
    assert_eq!(more, ["tactile_servo.phase"], "{what}");
}

#[test]
fn the_six_tasks_of_touch_give_the_same_bits_as_files_of_phases() {
    for (scene, task) in [
        ("hold-contact.toml", "hold-contact.toml"),
        ("follow-edge.toml", "follow-edge.toml"),
        ("follow-arc.toml", "follow-edge.toml"),
        ("follow-corner.toml", "follow-edge.toml"),
        ("follow-surface.toml", "follow-surface.toml"),
        ("level-bar.toml", "level-bar.toml"),
    ] {
        let by_law = run(&SceneDraft::of(scene).set("duration_s", 6.0).scene(), 1);
        let by_phases = run(&of_phases(scene, task).set("duration_s", 6.0).scene(), 1);
        assert_same_bits(scene, &by_law, &by_phases);
        let changes: Vec<(Nanos, PhaseChange)> = by_phases.of("tactile_servo.phase");
        assert_eq!(changes[0].1.cause, phase_cause::TASK_STARTED, "{scene}");
        let last = changes.last().unwrap().1;
        assert_eq!(
            (last.phase, last.cause),
            (2, phase_cause::CONDITIONS_MET),
            "{scene}: {changes:?}"
        );
    }
}

/// The ball drops away by 20 mm: the finger holds, seeks, draws back and rests, by a law and by its
/// phases alike.
#[test]
fn a_lost_contact_is_sought_and_given_up_with_the_same_bits() {
    let fall = |draft: SceneDraft| {
        draft
            .set("duration_s", 6.0)
            .set("world.table.motion.axis", "height")
            .set("world.table.motion.amplitude_mm", 20.0)
            .set("world.table.motion.frequency_hz", 0.5)
            .set("world.table.motion.from_s", 3.0)
    };
    let by_law = run(&fall(SceneDraft::of("hold-contact.toml")).scene(), 1);
    let by_phases = run(&fall(of_phases("hold-contact.toml", "hold-contact.toml")).scene(), 1);
    assert_same_bits("a fall", &by_law, &by_phases);
    let events: Vec<(Nanos, Contact)> = by_phases.of("tactile_servo.contact");
    assert!(events.iter().any(|(_, event)| event.kind == contact::LOST), "{events:?}");
    let changes: Vec<(Nanos, PhaseChange)> = by_phases.of("tactile_servo.phase");
    assert!(changes.iter().any(|(_, change)| change.cause == phase_cause::CONTACT_LOST));
}

/// The hardness of a body by pressing: two loads, and the way of the finger between them.
#[test]
fn pressing_tells_hard_bodies_from_soft_ones_and_ends() {
    let ways = [0.5, 3.0].map(|youngs_mpa| {
        let draft = SceneDraft::of("phases/press.toml");
        let task = taktil_tests::root().join("sim/scenes/touch/press.toml");
        let draft = draft
            .set("robot.tactile_servo.task_file", task.display().to_string())
            .set("world.finger.rubber.thickness_mm", 0.8)
            .set("world.finger.rubber.youngs_mpa", youngs_mpa)
            .set("world.finger.rubber.poisson", 0.49)
            .set("world.finger.rubber.relaxation_ms", 0.3);
        let kept = run(&draft.scene(), 1);
        let changes: Vec<(Nanos, PhaseChange)> = kept.of("tactile_servo.phase");
        let last = changes.last().unwrap().1;
        assert_eq!((last.phase, last.cause), (0, phase_cause::CONDITIONS_MET), "{changes:?}");
        assert_eq!(kept.last_control().state, State::IdleCalibrated as u32);
        let pressed = changes.iter().find(|(_, change)| change.before == 3).unwrap().1;
        println!("{youngs_mpa} MPa: {:.3} mm", pressed.moved[2]);
        pressed.moved[2]
    });
    assert!(ways[0] > 1.05 * ways[1] && ways[1] > 0.0, "{ways:?}");
}

/// Lateral motion: the finger presses, is fed along x until the body slides, and ends.
#[test]
fn lateral_motion_ends_when_it_slides() {
    let task = taktil_tests::root().join("sim/scenes/touch/lateral.toml");
    let draft = SceneDraft::of("phases/lateral.toml")
        .set("robot.tactile_servo.task_file", task.display().to_string());
    let kept = run(&draft.scene(), 1);
    let changes: Vec<(Nanos, PhaseChange)> = kept.of("tactile_servo.phase");
    let slid = changes.iter().find(|(_, change)| change.before == 3).unwrap().1;
    assert_eq!((slid.phase, slid.cause), (4, phase_cause::CONDITIONS_MET), "{changes:?}");
    assert!(slid.moved[0] > 0.02 && slid.moved[0] < 4.0, "{slid:?}");
    assert_eq!(changes.last().unwrap().1.phase, 0, "{changes:?}");
}
