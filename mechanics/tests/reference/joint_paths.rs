//! Tests of Paul's joint moves against the reference tables.

use crate::table::{list, number, rows, toml};
use taktil_mechanics::Joints;
use taktil_mechanics::paul::{JointPath, MAX_POINTS, PathError, Setpoint, segment_time_s};
use taktil_mechanics::puma260::Puma260;

const TICK_S: f64 = 0.0025;

fn reference_path(name: &str) -> JointPath {
    let file = toml("kinematics/moves.toml");
    let table = file[name].as_table().unwrap();
    let points: Vec<Joints> = table["via"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| Joints::from_iterator(p.as_array().unwrap().iter().map(number)))
        .collect();
    JointPath::new(&points, &list(table, "T"), number(&table["tau"])).unwrap()
}

#[test]
fn moves_match_the_reference() {
    for (name, segments) in [("joint_move_1", 1), ("joint_move_2", 2), ("joint_move_3", 3)] {
        let path = reference_path(name);
        assert_eq!(path.points().len(), segments + 1);
        let file = rows(&format!("kinematics/{name}.csv"));
        for row in &file {
            let got = path.at(row.num("tick") * TICK_S);
            assert!((got.q - row.joints("q")).amax() < 1e-9, "{name} tick {}", row.word("tick"));
        }
        for row in rows(&format!("kinematics/{name}_deriv.csv")) {
            let got = path.at(row.num("tick") * TICK_S);
            assert!((got.qd - row.joints("qd")).amax() < 1e-9, "{name} tick {}", row.word("tick"));
            assert!(
                (got.qdd - row.joints("qdd")).amax() < 1e-8,
                "{name} tick {}",
                row.word("tick")
            );
        }
        let last = file.last().unwrap();
        assert!(last.num("tick") * TICK_S >= path.duration_s() - 1e-9);
        assert_eq!(path.at(1e9), Setpoint::rest(path.points().last().unwrap()));
    }
}

#[test]
fn position_speed_and_acceleration_never_jump() {
    for name in ["joint_move_1", "joint_move_2", "joint_move_3"] {
        let path = reference_path(name);
        let step = path.duration_s() / 50_000.0;
        let (mut speed, mut acceleration) = (Joints::zeros(), Joints::zeros());
        let mut before = path.at(0.0);
        for n in -10..50_010 {
            let now = path.at(f64::from(n) * step);
            speed = speed.sup(&now.qd.abs());
            acceleration = acceleration.sup(&now.qdd.abs());
            let mean = (now.qd + before.qd) * (0.5 * step);
            assert!((now.q - before.q - mean).amax() < 1e-8 * f64::from(n > -10) + 1e-12);
            let gain = (now.qdd + before.qdd) * (0.5 * step);
            assert!((now.qd - before.qd - gain).amax() < 1e-6);
            assert!((now.qdd - before.qdd).amax() < 0.05, "{name} at {n}");
            before = now;
        }
        assert!((speed - path.peak_speed()).amax() < 1e-6);
        assert!((acceleration - path.peak_acceleration()).amax() < 1e-4);
    }
}

#[test]
fn corners_are_rounded_by_three_sixteenths() {
    let path = reference_path("joint_move_2");
    let p = path.points();
    let dv = (p[2] - p[1]) / 0.68 - (p[1] - p[0]) / 0.7925;
    let corner = path.at(0.1 + 0.7925).q;
    assert!((corner - p[1] - dv * (3.0 / 16.0 * 0.1)).amax() < 1e-14);
}

#[test]
fn outside_the_move_the_arm_rests() {
    let path = reference_path("joint_move_1");
    for t in [0.0, -0.0, -1.0, f64::NEG_INFINITY, f64::NAN] {
        assert_eq!(path.at(t), Setpoint::rest(&path.points()[0]));
    }
    for t in [path.duration_s(), 1e300, f64::INFINITY] {
        assert_eq!(path.at(t), Setpoint::rest(&path.points()[1]));
    }
    assert!((path.duration_s() - 0.8775).abs() < 1e-15);
}

#[test]
fn paths_that_cannot_be_followed_are_refused() {
    let (a, b) = (Joints::zeros(), Joints::repeat(1.0));
    let many = [a; MAX_POINTS + 1];
    let times = [1.0; MAX_POINTS];
    assert_eq!(<JointPath>::new(&[], &[], 0.1), Err(PathError::TooFewPoints { points: 0 }));
    assert_eq!(JointPath::new(&[a], &[], 0.1), Err(PathError::TooFewPoints { points: 1 }));
    assert_eq!(JointPath::new(&many, &times, 0.1), Err(PathError::TooManyPoints { points: 33 }));
    assert!(JointPath::new(&many[1..], &times[1..], 0.1).is_ok());
    let count = PathError::SegmentCount { expected: 1, actual: 2 };
    assert_eq!(JointPath::new(&[a, b], &[1.0, 1.0], 0.1), Err(count));
    let mut lost = b;
    lost[3] = f64::NAN;
    let point = PathError::PointNotFinite { point: 1, joint: 3 };
    assert_eq!(JointPath::new(&[a, lost], &[1.0], 0.1), Err(point));
    for t in [0.0, -1.0, f64::INFINITY] {
        let refused = Err(PathError::SegmentTime { segment: 0, time_s: t });
        assert_eq!(JointPath::new(&[a, b], &[t], 0.1), refused);
        let refused = Err(PathError::TransitionTime { tau_s: t });
        assert_eq!(JointPath::new(&[a, b], &[1.0], t), refused);
    }
    // Its rates over zero ways would be no numbers.
    for tau_s in [f64::MIN_POSITIVE, 1e-310, 1e-160] {
        let refused = PathError::TransitionTime { tau_s };
        assert_eq!(<JointPath>::rest(&a, tau_s), Err(refused));
    }
    assert!(JointPath::new(&[a, b], &[f64::NAN], 0.1).is_err());
    assert!(JointPath::new(&[a, b], &[1.0], f64::NAN).is_err());
    let overlap = PathError::TransitionsOverlap { segment: 0, time_s: 1.0, tau_s: 0.51 };
    assert_eq!(JointPath::new(&[a, b], &[1.0], 0.51), Err(overlap));
    assert!(JointPath::new(&[a, b], &[1.0], 0.5).is_ok());
    assert!(overlap.to_string().contains("half"));
}

#[test]
fn segment_times_respect_the_slowest_joint() {
    let arm = Puma260::reference();
    let (a, mut b) = (Joints::zeros(), Joints::zeros());
    assert_eq!(segment_time_s(&a, &b, &arm.speed_max_rad_s, 0.1), 0.2);
    b[1] = -arm.speed_max_rad_s[1];
    assert_eq!(segment_time_s(&a, &b, &arm.speed_max_rad_s, 0.1), 1.0);
    let path = JointPath::new(&[a, b], &[1.0], 0.1).unwrap();
    assert!((path.peak_speed()[1] - arm.speed_max_rad_s[1]).abs() < 1e-15);
    assert_eq!(segment_time_s(&a, &b, &Joints::zeros(), 0.1), f64::INFINITY);
}

#[test]
fn what_has_no_finite_speed_is_refused_however_finite_its_points_are() {
    let (a, far) = (Joints::zeros(), Joints::repeat(1e9));
    let beyond = Err(PathError::Overflow { segment: 0 });
    assert_eq!(JointPath::new(&[a, far], &[1e-150], 1e-151), beyond);
    assert_eq!(JointPath::new(&[a, Joints::repeat(1e308)], &[1.0], 0.1), beyond);
    assert_eq!(JointPath::new(&[-far * 1e299, far * 1e299], &[1.0], 0.1), beyond);
    assert_eq!(JointPath::new(&[a, a], &[f64::MAX], f64::MAX / 2.0), beyond);
    // A full path takes no further point, and says so.
    let mut path = JointPath::rest(&a, 0.1).unwrap();
    for _ in 1..MAX_POINTS {
        path.push(&a, 1.0).unwrap();
    }
    let full = PathError::TooManyPoints { points: MAX_POINTS + 1 };
    assert_eq!(path.push(&a, 1.0), Err(full));
}
