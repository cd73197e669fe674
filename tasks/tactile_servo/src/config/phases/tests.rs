//! Task files that are read, and each kind that is refused.

use super::super::law_name::LawName;
use super::super::slip::SlipConfig;
use super::super::task_frame::Feature;
use super::*;

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

fn condition(quantity: Quantity) -> Condition {
    Condition { quantity, above: None, below: None, near: None, within: None }
}

fn press() -> PhaseConfig {
    let frame = TaskFrame::default();
    PhaseConfig {
        state: frame.state,
        feature: frame.feature,
        r#else: Some(END_NAME.to_owned()),
        ..phase("press", PhaseKind::Regulate)
    }
}

/// Seeks, presses until the load is there, and ends.
fn task() -> TouchTask {
    let seek = PhaseConfig {
        velocity_per_s: [0.0, 0.0, 6.0, 0.0, 0.0, 0.0],
        until: vec![condition(Quantity::Contact)],
        within_mm: Some(60.0),
        r#else: Some(END_NAME.to_owned()),
        ..phase("seek", PhaseKind::Approach)
    };
    let near = Condition { near: Some(15_000.0), within: Some(500.0), ..condition(Quantity::M0) };
    let press = PhaseConfig { until: vec![near], then: Some(END_NAME.to_owned()), ..press() };
    TouchTask { title: String::new(), first: None, phase: vec![seek, press] }
}

fn refused(change: impl Fn(&mut TouchTask)) -> Invalid {
    let mut task = task();
    change(&mut task);
    task.check(&Config::default()).unwrap_err()
}

/// The place and the whole text of what is refused.
fn told(change: impl Fn(&mut TouchTask)) -> (String, String) {
    let bad = refused(change);
    (bad.place, format!("{}; {}", bad.what, bad.remedy))
}

#[test]
fn a_sound_task_passes_and_is_needed_by_its_law_alone() {
    assert_eq!(task().check(&Config::default()), Ok(()));
    let config = Config { law: LawName::Phases, phases: Some(task()), ..Config::default() };
    assert_eq!(config.check(), Ok(()));
    assert_eq!(config.load_counts(), 15_000.0);
    let place = |config: Config| config.check().unwrap_err().place;
    assert_eq!(place(Config { phases: None, ..config.clone() }), "law");
    assert_eq!(place(Config { law: LawName::Model, ..config.clone() }), "phases");
    let unread = Config { phases: None, task_file: Some("a.toml".into()), ..config };
    assert_eq!(place(unread), "task_file");
}

#[test]
fn a_task_without_phases_or_with_too_many_is_refused() {
    assert_eq!(refused(|t| t.phase.clear()).place, "phase");
    let many = |t: &mut TouchTask| {
        t.phase = (0..=PHASES_MAX).map(|i| phase(&format!("p{i}"), PhaseKind::Hold)).collect();
    };
    assert_eq!(refused(many).place, "phase");
}

#[test]
fn names_that_are_odd_twice_or_unknown_are_refused_with_those_that_there_are() {
    assert_eq!(refused(|t| t.phase[0].name.clear()).place, "phase[0].name");
    assert_eq!(refused(|t| t.phase[1].name = "x".repeat(33)).place, "phase[1].name");
    assert_eq!(refused(|t| t.phase[1].name = "end".into()).place, "phase[1].name");
    assert_eq!(refused(|t| t.phase[1].name = "seek".into()).place, "phase[1].name");
    let (place, text) = told(|t| t.phase[0].r#else = Some("sek".into()));
    assert_eq!(place, "phase[0].else");
    assert!(text.contains("`sek`") && text.contains("seek, press, end"), "{text}");
    assert_eq!(refused(|t| t.phase[1].then = Some("no".into())).place, "phase[1].then");
    assert_eq!(refused(|t| t.first = Some("no".into())).place, "first");
    assert_eq!(refused(|t| t.first = Some("end".into())).place, "first");
}

#[test]
fn a_phase_that_cannot_be_observed_is_refused_with_its_condition_number() {
    let two = |rows: [[f64; 2]; 2]| {
        move |t: &mut TouchTask| {
            let press = &mut t.phase[1];
            press.state = vec![Motion::Z, Motion::ThetaX];
            let mut second = press.feature[0].clone();
            (second.name, second.desired) = (Feature::MX, None);
            press.feature.push(second);
            for (feature, row) in press.feature.iter_mut().zip(rows) {
                feature.jacobian = row.to_vec();
            }
        }
    };
    assert_eq!(
        {
            let mut sound = task();
            two([[14e3, 0.0], [0.0, 2e5]])(&mut sound);
            sound.check(&Config::default())
        },
        Ok(())
    );
    for rows in [[[14e3, 1e3], [14e4, 1e4]], [[14e3, 0.0], [14e3, 0.0]], [[0.0; 2], [1.0, 1.0]]] {
        let (place, text) = told(two(rows));
        assert_eq!(place, "phase[1].feature");
        assert!(text.contains("condition number"), "{text}");
    }
    assert_eq!(
        refused(|t| t.phase[1].state = vec![Motion::Z, Motion::X]).place,
        "phase[1].feature[0].jacobian"
    );
    assert_eq!(refused(|t| t.phase[1].state.clear()).place, "phase[1].feature[0].jacobian");
}

#[test]
fn conditions_that_are_never_met_are_refused_with_the_reason() {
    let until = |quantity: Quantity, low: Option<f64>, high: Option<f64>| {
        move |t: &mut TouchTask| {
            t.phase[1].until = vec![Condition { above: low, below: high, ..condition(quantity) }];
        }
    };
    for (quantity, low, high, why) in [
        (Quantity::M0, Some(40_000.0), None, "Overload"),
        (Quantity::M0, None, Some(0.0), "Overload"),
        (Quantity::M0, Some(16_000.0), None, "holds the feature at 15000"),
        (Quantity::M0, None, Some(15_000.0), "holds the feature at 15000"),
        (Quantity::XC, Some(16.0), None, "no other columns"),
        (Quantity::YC, None, Some(1.0), "no other rows"),
        (Quantity::ThetaZ, Some(1600.0), None, "quarter turn"),
        (Quantity::Slip, Some(5.0), None, "slip is not observed"),
        (Quantity::WristForce, Some(2e3), None, "no finger bears"),
    ] {
        let (place, text) = told(until(quantity, low, high));
        assert_eq!(place, "phase[1].until[0]", "{text}");
        assert!(text.contains("never met") && text.contains(why), "{quantity:?}: {text}");
    }
    // What the phase's own bounds end before.
    let bounded = |quantity: Quantity, above: f64| {
        move |t: &mut TouchTask| {
            (t.phase[0].within_mm, t.phase[0].within_s) = (Some(10.0), Some(2.0));
            t.phase[0].until = vec![Condition { above: Some(above), ..condition(quantity) }];
        }
    };
    assert_eq!(refused(bounded(Quantity::Way, 10.0)).place, "phase[0].until[0]");
    assert_eq!(refused(bounded(Quantity::Time, 2.0)).place, "phase[0].until[0]");
    let mut sound = task();
    bounded(Quantity::Way, 9.0)(&mut sound);
    assert_eq!(sound.check(&Config::default()), Ok(()));
    // Two that exclude each other, and a way where nothing moves.
    let both = |t: &mut TouchTask| {
        let of = |above, below| Condition { above, below, ..condition(Quantity::XC) };
        t.phase[1].until = vec![of(Some(9.0), None), of(None, Some(8.0))];
    };
    assert_eq!(refused(both).place, "phase[1].until[1]");
    let still = |t: &mut TouchTask| {
        let way = Condition { above: Some(1.0), ..condition(Quantity::Way) };
        let hold = phase("hold", PhaseKind::Hold);
        t.phase[1] = PhaseConfig { until: vec![way], then: Some("end".into()), ..hold };
    };
    assert_eq!(refused(still).place, "phase[1].until[0]");
    // One row shows no direction.
    let mut config = Config::default();
    config.array.rows = 1;
    let mut turned = task();
    until(Quantity::ThetaZ, Some(1.0), None)(&mut turned);
    assert_eq!(turned.check(&config).unwrap_err().place, "phase[1].until[0]");
    // With the test for slip its condition is sound.
    let slip = Config { slip: Some(SlipConfig::default()), ..Config::default() };
    let mut slides = task();
    slides.phase[1].until = vec![condition(Quantity::Slip)];
    assert_eq!(slides.check(&slip), Ok(()));
}

#[test]
fn conditions_of_a_wrong_form_are_refused() {
    let until =
        |condition: Condition| move |t: &mut TouchTask| t.phase[1].until = vec![condition.clone()];
    let of = condition;
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let above = Condition { above: Some(odd), ..of(Quantity::XC) };
        assert_eq!(refused(until(above)).place, "phase[1].until[0].above");
        let near = Condition { near: Some(8.0), within: Some(odd), ..of(Quantity::XC) };
        assert_eq!(refused(until(near)).place, "phase[1].until[0].within");
    }
    let near = Condition { near: Some(8.0), within: Some(0.0), ..of(Quantity::XC) };
    assert_eq!(refused(until(near)).place, "phase[1].until[0].within");
    let half = Condition { near: Some(8.0), ..of(Quantity::XC) };
    assert_eq!(refused(until(half)).place, "phase[1].until[0]");
    let reversed = Condition { above: Some(9.0), below: Some(8.0), ..of(Quantity::XC) };
    assert_eq!(refused(until(reversed)).place, "phase[1].until[0].above");
    assert_eq!(refused(until(of(Quantity::XC))).place, "phase[1].until[0].quantity");
    let number = Condition { above: Some(0.5), ..of(Quantity::Contact) };
    assert_eq!(refused(until(number)).place, "phase[1].until[0].quantity");
    let many = |t: &mut TouchTask| t.phase[1].until = vec![condition(Quantity::Contact); 5];
    assert_eq!(refused(many).place, "phase[1].until");
}

#[test]
fn keys_that_do_not_belong_to_what_a_phase_does_are_refused() {
    assert_eq!(refused(|t| t.phase[0].velocity_per_s = [0.0; 6]).place, "phase[0].velocity_per_s");
    assert_eq!(
        refused(|t| t.phase[0].velocity_per_s[2] = f64::NAN).place,
        "phase[0].velocity_per_s[2]"
    );
    assert_eq!(refused(|t| t.phase[0].until.clear()).place, "phase[0].until");
    assert_eq!(refused(|t| t.phase[0].within_mm = None).place, "phase[0].does");
    assert_eq!(refused(|t| t.phase[0].within_mm = Some(f64::NAN)).place, "phase[0].within_mm");
    assert_eq!(refused(|t| t.phase[0].slew_s = Some(0.1)).place, "phase[0].slew_s");
    assert_eq!(refused(|t| t.phase[0].state = vec![Motion::Z]).place, "phase[0].state");
    assert_eq!(refused(|t| t.phase[0].feature = press().feature).place, "phase[0].feature");
    assert_eq!(refused(|t| t.phase[1].feature.clear()).place, "phase[1].feature");
    assert_eq!(refused(|t| t.phase[1].velocity_per_s[0] = 1.0).place, "phase[1].velocity_per_s");
    assert_eq!(refused(|t| t.phase[1].unheld = vec![Motion::X]).place, "phase[1].unheld");
    assert_eq!(refused(|t| t.phase[1].for_s = f64::INFINITY).place, "phase[1].for_s");
    assert_eq!(refused(|t| t.phase[1].visits_max = Some(0)).place, "phase[1].visits_max");
    // Servoed and moved at once.
    let both = |t: &mut TouchTask| {
        t.phase[1].does = PhaseKind::Move;
        t.phase[1].velocity_per_s[2] = 1.0;
    };
    assert_eq!(refused(both).place, "phase[1].velocity_per_s[2]");
}

#[test]
fn where_a_phase_leads_to_has_to_be_said_and_to_be_possible() {
    assert_eq!(refused(|t| t.phase[0].r#else = None).place, "phase[0].else");
    assert_eq!(refused(|t| t.phase[1].r#else = None).place, "phase[1].else");
    assert_eq!(refused(|t| t.phase[1].keeps_contact = Some(false)).place, "phase[1].else");
    assert_eq!(refused(|t| t.phase[1].then = None).place, "phase[1].then");
    assert_eq!(refused(|t| t.phase[1].until.clear()).place, "phase[1].then");
    let (place, text) = told(|t| t.phase.push(phase("lost", PhaseKind::Hold)));
    assert!(place == "phase[2].name" && text.contains("never entered"), "{place}: {text}");
}

#[test]
fn a_circle_without_a_way_out_is_refused_and_one_with_a_bound_is_not() {
    let circle = |visits_max: Option<u32>| {
        let mut task = task();
        let hold = |name: &str, then: &str| PhaseConfig {
            until: vec![condition(Quantity::Contact)],
            then: Some(then.to_owned()),
            ..phase(name, PhaseKind::Hold)
        };
        let first = PhaseConfig {
            visits_max,
            r#else: visits_max.map(|_| END_NAME.to_owned()),
            ..hold("one", "two")
        };
        task.phase = vec![first, hold("two", "one")];
        task.check(&Config::default())
    };
    let bad = circle(None).unwrap_err();
    assert!(bad.place == "phase[0].then" && bad.what.contains("without a way out"), "{bad:?}");
    assert_eq!(circle(Some(3)), Ok(()));
}
