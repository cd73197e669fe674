//! The way through phases, by conditions, bounds and lost contact.

use super::*;
use crate::config::law_name::LawName;
use crate::config::phases::{Condition, END_NAME};
use crate::config::task_frame::TaskFrame;

const DT_S: f64 = 0.0025;

fn phase(name: &str, does: PhaseKind) -> PhaseConfig {
    PhaseConfig {
        name: name.to_owned(),
        does,
        velocity_per_s: [0.0; MOTIONS_MAX],
        state: Vec::new(),
        feature: Vec::new(),
        slew_s: None,
        unheld: Vec::new(),
        until: Vec::new(),
        for_s: 0.0,
        then: None,
        r#else: None,
        within_s: None,
        within_mm: None,
        keeps_contact: None,
        visits_max: None,
    }
}

fn until(quantity: Quantity, above: Option<f64>) -> Vec<Condition> {
    vec![Condition { quantity, above, below: None, near: None, within: None }]
}

fn approach(name: &str, then: &str, otherwise: &str) -> PhaseConfig {
    PhaseConfig {
        velocity_per_s: [0.0, 0.0, 6.0, 0.0, 0.0, 0.0],
        until: until(Quantity::Contact, None),
        then: Some(then.to_owned()),
        within_mm: Some(3.0),
        r#else: Some(otherwise.to_owned()),
        ..phase(name, PhaseKind::Approach)
    }
}

fn press(otherwise: &str) -> PhaseConfig {
    let frame = TaskFrame::default();
    PhaseConfig {
        state: frame.state,
        feature: frame.feature,
        r#else: Some(otherwise.to_owned()),
        ..phase("press", PhaseKind::Regulate)
    }
}

fn law(phases: Vec<PhaseConfig>) -> PhasesLaw {
    let task = TouchTask { title: String::new(), first: None, phase: phases };
    let config = Config { law: LawName::Phases, phases: Some(task), ..Config::default() };
    PhasesLaw::new(&config).unwrap()
}

fn touch(m0: f64) -> TouchFeatures {
    let contact = m0 > 1000.0;
    let centre = contact.then_some(8.5);
    TouchFeatures { trusted: true, contact, m0, x_c: centre, y_c: centre, ..Default::default() }
}

/// Advances by a job; every motion is taken as carried out.
fn job(law: &mut PhasesLaw, m0: f64) -> PhaseEvents {
    let touch = touch(m0);
    let events = law.advance(&Sensed { touch: &touch, slip_mm_s: None, wrist_n: None }, DT_S);
    if let Some(step) = law.unservoed_step(DT_S) {
        law.add_motion(&step, 1.0);
    }
    events
}

/// Jobs until the next change of phase, at most 2000.
fn change(law: &mut PhasesLaw, m0: f64) -> (PhaseChange, u32) {
    for jobs in 1..=2000 {
        if let Some(change) = job(law, m0).change {
            return (change, jobs);
        }
    }
    panic!("no change");
}

#[test]
fn a_task_goes_from_phase_to_phase_and_says_why() {
    let mut law = law(vec![approach("seek", "press", END_NAME), press(END_NAME)]);
    let (start, _) = change(&mut law, 0.0);
    assert_eq!((start.phase, start.before, start.cause), (1, 0, phase_cause::TASK_STARTED));
    for _ in 0..40 {
        assert_eq!(job(&mut law, 0.0), PhaseEvents::default());
    }
    let (found, jobs) = change(&mut law, 4000.0);
    assert_eq!(
        (found.phase, found.before, found.cause, jobs),
        (2, 1, phase_cause::CONDITIONS_MET, 1)
    );
    assert!((found.moved[2] - 41.0 * 6.0 * DT_S).abs() < 1e-9 && found.m0 == 4000.0, "{found:?}");
    assert_eq!(law.unservoed_step(DT_S), None, "the law presses now");
    let (lost, _) = change(&mut law, 0.0);
    assert_eq!((lost.phase, lost.cause), (0, phase_cause::CONTACT_LOST));
    assert!(law.is_ended());
    assert_eq!(job(&mut law, 9000.0), PhaseEvents::default(), "after the end nothing happens");
}

#[test]
fn a_way_and_a_time_have_their_ends_and_a_finger_that_is_held_up_gives_up() {
    let rest = phase("rest", PhaseKind::Hold);
    let mut far = law(vec![approach("seek", END_NAME, "rest"), rest.clone()]);
    change(&mut far, 0.0);
    let (given_up, jobs) = change(&mut far, 0.0);
    assert_eq!((given_up.phase, given_up.cause), (2, phase_cause::TOO_FAR));
    assert!((200..=201).contains(&jobs), "3 mm at 6 mm/s: {jobs}");
    // Nothing of what is asked for is carried out: three times as long and a tenth of a second.
    let mut blocked = law(vec![approach("seek", END_NAME, "rest"), rest.clone()]);
    let free = touch(0.0);
    let sensed = Sensed { touch: &free, slip_mm_s: None, wrist_n: None };
    let jobs = (0..2000)
        .take_while(|_| blocked.advance(&sensed, DT_S).change.is_none_or(|c| c.phase == 1));
    assert!((630..=650).contains(&jobs.count()));
    let late =
        PhaseConfig { within_s: Some(0.05), within_mm: None, ..approach("seek", END_NAME, "rest") };
    let mut late = law(vec![late, rest]);
    change(&mut late, 0.0);
    let (timed_out, jobs) = change(&mut late, 0.0);
    assert_eq!(timed_out.cause, phase_cause::TIME_OUT);
    assert!((20..=21).contains(&jobs), "{jobs}");
}

#[test]
fn conditions_have_to_hold_for_their_time_and_an_undefined_feature_meets_none() {
    let wait = PhaseConfig {
        until: vec![Condition {
            near: Some(8.5),
            within: Some(0.5),
            ..until(Quantity::XC, None).remove(0)
        }],
        for_s: 0.1,
        then: Some(END_NAME.to_owned()),
        ..phase("wait", PhaseKind::Hold)
    };
    let mut law = law(vec![wait]);
    change(&mut law, 0.0);
    for _ in 0..30 {
        assert_eq!(job(&mut law, 5000.0).change, None);
    }
    assert_eq!(job(&mut law, 0.0).change, None, "no centroid: the time begins anew");
    let (done, jobs) = change(&mut law, 5000.0);
    assert_eq!((done.phase, done.cause), (0, phase_cause::CONDITIONS_MET));
    assert!((39..=41).contains(&jobs), "{jobs}");
}

#[test]
fn a_phase_that_is_entered_too_often_leads_to_its_else() {
    let again = PhaseConfig {
        visits_max: Some(3),
        until: until(Quantity::Time, Some(0.01)),
        then: Some("back".to_owned()),
        r#else: Some(END_NAME.to_owned()),
        ..phase("again", PhaseKind::Hold)
    };
    let back = PhaseConfig {
        until: until(Quantity::Time, Some(0.01)),
        then: Some("again".to_owned()),
        ..phase("back", PhaseKind::Hold)
    };
    let mut law = law(vec![again, back]);
    let mut visits = Vec::new();
    let last = loop {
        let (change, _) = change(&mut law, 0.0);
        if law.is_ended() {
            break change;
        }
        visits.push((change.phase, change.visits));
    };
    assert_eq!(visits, [(1, 1), (2, 1), (1, 2), (2, 2), (1, 3), (2, 3)]);
    assert_eq!((last.phase, last.before, last.cause), (0, 2, phase_cause::TOO_OFTEN));
}

#[test]
fn images_that_are_not_trusted_change_nothing() {
    let mut law = law(vec![approach("seek", END_NAME, END_NAME)]);
    let blind = TouchFeatures::default();
    for _ in 0..5000 {
        let sensed = Sensed { touch: &blind, slip_mm_s: None, wrist_n: None };
        assert_eq!(law.advance(&sensed, DT_S), PhaseEvents::default());
    }
    assert!(!law.is_ended());
}

#[test]
fn what_is_done_about_a_lost_contact_is_reported_as_by_the_other_laws() {
    let still = PhaseConfig {
        within_s: Some(0.02),
        r#else: Some("search".to_owned()),
        until: until(Quantity::Contact, None),
        then: Some("press".to_owned()),
        ..phase("still", PhaseKind::Hold)
    };
    let retract = PhaseConfig {
        velocity_per_s: [0.0, 0.0, -6.0, 0.0, 0.0, 0.0],
        within_mm: Some(5.0),
        r#else: Some("rest".to_owned()),
        ..phase("retract", PhaseKind::Move)
    };
    let mut law = law(vec![
        approach("seek", "press", "rest"),
        press("still"),
        still,
        approach("search", "press", "retract"),
        retract,
        phase("rest", PhaseKind::Hold),
    ]);
    job(&mut law, 0.0);
    let mut kinds = Vec::new();
    for m0 in [5000.0, 0.0] {
        for _ in 0..1500 {
            kinds.extend(job(&mut law, m0).contact.map(|contact| contact.kind));
        }
    }
    let due = [contact::GAINED, contact::LOST, contact::SOUGHT, contact::RETRACTED];
    assert_eq!(kinds, [&due[..], &[contact::GIVEN_UP]].concat());
}

#[test]
fn slip_and_the_wrist_end_phases_too() {
    let guard = |quantity, above| PhaseConfig {
        until: until(quantity, above),
        then: Some(END_NAME.to_owned()),
        ..phase("wait", PhaseKind::Hold)
    };
    let touch = touch(5000.0);
    let mut pushed = law(vec![guard(Quantity::WristForce, Some(3.0))]);
    for (wrist_n, ends) in [(None, false), (Some(2.9), false), (Some(3.1), true)] {
        pushed.advance(&Sensed { touch: &touch, slip_mm_s: None, wrist_n }, DT_S);
        pushed.advance(&Sensed { touch: &touch, slip_mm_s: None, wrist_n }, DT_S);
        assert_eq!(pushed.is_ended(), ends, "{wrist_n:?}");
    }
}
