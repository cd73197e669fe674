//! Transactions: what is refused, what stays as it was when one is, and when lanes take them.

use super::*;

fn ms(ms: i64) -> Nanos {
    Nanos::from_millis(ms)
}

fn parameter(name: &str, lane: usize, number: u32) -> Parameter {
    Parameter { name: name.into(), lane, number, initial: 1.0, low: 0.5, high: 2.0 }
}

fn registry() -> ParameterRegistry {
    let parameters = vec![
        parameter("servo.gain[0]", 0, 0),
        parameter("servo.gain[1]", 0, 1),
        parameter("servo.window", 0, 2),
        parameter("touch.gain", 1, 0),
    ];
    ParameterRegistry { parameters, apart: ms(5), latest: None }
}

fn lane(count: usize) -> (LaneParameters, rtrb::Producer<LaneEdit>) {
    LaneParameters::new(vec![1.0; count].into_boxed_slice())
}

fn edit(at: Nanos, set: &[(&str, f64)]) -> Transaction {
    Transaction { at, set: set.iter().map(|(name, value)| ((*name).into(), *value)).collect() }
}

fn refused(set: &[(&str, f64)]) -> Invalid {
    registry().split(&edit(ms(10), set)).err().unwrap_or_else(|| panic!("{set:?} was taken"))
}

#[test]
fn what_cannot_be_meant_is_refused_with_place_and_remedy() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.49, 2.01, -1.0] {
        let invalid = refused(&[("touch.gain", bad)]);
        assert_eq!(
            (invalid.place.as_str(), invalid.remedy.as_str()),
            ("set.touch.gain", "give 0.5 to 2")
        );
        assert_eq!(refused(&[("servo.window", 1.5), ("servo.gain", bad)]).place, "set.servo.gain");
    }
    assert_eq!(refused(&[]).place, "set");
    let unknown = refused(&[("servo.gian", 1.0)]);
    assert_eq!(unknown.remedy, "parameters are: servo.gain, servo.window");
    assert_eq!(
        refused(&[("nobody.gain", 1.0)]).remedy,
        "parameters are: servo.gain, servo.window, touch.gain"
    );
    for name in ["", "servo", "servo.", "servo.gai", "servo.gain[", "servo.gain[2]", "ervo.gain"] {
        assert_eq!(refused(&[(name, 1.0)]).what, "there is no such parameter", "`{name}`");
    }
    let twice = refused(&[("servo.gain", 1.0), ("servo.gain[1]", 1.5)]);
    assert_eq!(
        (twice.place.as_str(), twice.what.as_str()),
        ("set.servo.gain[1]", "is set twice in one edit")
    );
}

#[test]
fn one_refused_transaction_leaves_all_as_it_was() {
    let (mut registry, (mut a, _), (mut b, _)) = (registry(), lane(3), lane(1));
    let good = edit(ms(10), &[("touch.gain", 2.0)]);
    let bad = edit(ms(20), &[("servo.gain", 3.0)]);
    let invalid = plan(&mut registry, &[good.clone(), bad], &mut [&mut a, &mut b]).unwrap_err();
    assert_eq!(invalid.place, "edit[1].set.servo.gain");
    assert_eq!((registry.latest, b.apply(ms(1000)).is_none()), (None, true));
    let near = edit(ms(14), &[("touch.gain", 1.0)]);
    let invalid = plan(&mut registry, &[good.clone(), near], &mut [&mut a, &mut b]).unwrap_err();
    assert_eq!(invalid.place, "edit[1].at");
    let past = plan(&mut registry, &[edit(Nanos(-1), &good_set())], &mut [&mut a, &mut b]);
    assert_eq!(past.unwrap_err().place, "edit[0].at");
}

fn good_set() -> [(&'static str, f64); 1] {
    [("touch.gain", 2.0)]
}

#[test]
fn each_lane_takes_its_part_at_its_first_job_from_the_instant_on() {
    let (mut registry, (mut servo, _), (mut touch, _)) = (registry(), lane(3), lane(1));
    let both = edit(ms(10), &[("servo.gain", 2.0), ("touch.gain", 0.5), ("servo.window", 1.5)]);
    let later = edit(ms(15), &[("servo.gain[1]", 1.0)]);
    plan(&mut registry, &[both, later], &mut [&mut servo, &mut touch]).unwrap();
    assert_eq!(servo.apply(ms(9)), None);
    let edit = servo.apply(ms(10)).unwrap();
    assert_eq!((edit.at_ns, edit.count), (ms(10).0, 3));
    assert_eq!(edit.number[..3], [0, 1, 2]);
    assert_eq!(
        (edit.old[..3].to_vec(), edit.new[..3].to_vec()),
        (vec![1.0; 3], vec![2.0, 2.0, 1.5])
    );
    assert_eq!(*servo.values, [2.0, 2.0, 1.5]);
    assert_eq!(touch.apply(ms(12)).unwrap().new[0], 0.5);
    assert_eq!((servo.apply(ms(14)), touch.apply(ms(1000))), (None, None));
    assert_eq!(servo.apply(ms(15)).unwrap().old[0], 2.0);
    assert_eq!(*servo.values, [2.0, 1.0, 1.5]);
}

#[test]
fn a_running_machine_is_edited_ahead_of_time_or_not_at_all() {
    let ((mut servo, a), (mut touch, b)) = (lane(3), lane(1));
    let mut editor = Editor::new(registry(), vec![a, b]);
    assert_eq!(editor.earliest(ms(100)), ms(120));
    let set = [("servo.gain", 2.0), ("touch.gain", 2.0)];
    for at in [Nanos::ZERO, ms(100), ms(120) - Nanos(1)] {
        assert_eq!(editor.send(ms(100), &edit(at, &set)).unwrap_err().place, "at");
    }
    editor.send(ms(100), &edit(ms(120), &set)).unwrap();
    assert!(servo.apply(ms(119)).is_none() && touch.apply(ms(119)).is_none());
    assert!(servo.apply(ms(120)).is_some() && touch.apply(ms(120)).is_some());
    // A lane that takes nothing: the others get nothing either once its ring is full.
    let sent = (0..100).filter(|n| editor.send(ms(100), &edit(ms(200 + 5 * n), &set)).is_ok());
    assert_eq!(sent.count(), PENDING_EDITS_MAX);
    for n in 0..100 {
        let _ = servo.apply(ms(10_000 + n));
    }
    let full = editor.send(ms(100), &edit(ms(50_000), &set)).unwrap_err();
    assert!(full.what.contains("16 edits are under way"), "{full}");
    assert!(servo.apply(ms(60_000)).is_none(), "nothing reached the lane that has room");
}

#[test]
fn an_edit_of_too_many_values_is_refused() {
    let parameters = (0..17).map(|n| parameter(&format!("servo.gain[{n}]"), 0, n)).collect();
    let registry = ParameterRegistry { parameters, apart: ms(5), latest: None };
    let invalid = registry.split(&edit(ms(10), &[("servo.gain", 1.0)])).err().unwrap();
    assert_eq!(invalid.remedy, "make it two edits");
}

#[test]
fn a_parameter_that_cannot_be_is_refused_at_load() {
    let declared = |initial, low, high| Declaration { name: "gain".into(), initial, low, high };
    assert_eq!(declared(1.0, 1.0, 1.0).check(), Ok(()));
    for bad in [
        declared(f64::NAN, 0.0, 1.0),
        declared(1.0, f64::NAN, 1.0),
        declared(1.0, 0.0, f64::INFINITY),
        declared(1.0, 2.0, 0.0),
        declared(3.0, 0.0, 2.0),
    ] {
        assert_eq!(bad.check().unwrap_err().place, "gain", "{bad:?}");
    }
}
