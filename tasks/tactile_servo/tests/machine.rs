//! Tests the task in a machine of two lanes in virtual time with scripted inputs: images at 200 Hz,
//! servo jobs at 400 Hz.

use taktil_mechanics::Joints;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::{FaultCode, FaultSet, LaneSpec, Payload};
use taktil_signal::{
    ControlState, Desired, Features, Goal, JointState, State, TactileImage, WRENCH_OVER_RANGE,
    WRENCH_SATURATED, Wrench, defined,
};
use taktil_tasks_tactile_servo::config::law_name::LawName;
use taktil_tasks_tactile_servo::{Config, TactileServo};
use taktil_tests_script::{Bench, SERVO_PERIOD};

/// Goals, features with their ticks, and faults.
struct Keep {
    goals: Vec<Goal>,
    features: Vec<(u64, Features)>,
    faults: FaultSet,
}

#[derive(Clone, Copy)]
struct Script {
    control: fn(u64) -> Option<ControlState>,
    desired: fn(u64) -> Option<Desired>,
    joints: fn(u64) -> Option<JointState>,
    /// By job of the touch lane.
    image: fn(u64) -> Option<TactileImage>,
    /// For a law that goes by the wrist.
    wrench: fn(u64) -> Option<Wrench>,
}

fn run(config: Config, script: &Script, ticks: i64) -> Keep {
    let mut bench = Bench::new();
    let servo = bench.servo();
    let touch = LaneSpec::new("touch", SERVO_PERIOD * 2, 75);
    let touch = bench.lane(LaneSpec { delivery: SERVO_PERIOD, deadline: SERVO_PERIOD, ..touch });
    let Script { control, desired, joints, image, wrench } = *script;
    let by_wrist = config.law.uses_wrench();
    bench.feed(servo, "control", control);
    bench.feed(servo, "joints", joints);
    if by_wrist {
        bench.feed(servo, "wrench", wrench);
    }
    bench.task(servo, "tactile_servo", |ports| TactileServo::new(config, &Robot::puma260(), ports));
    bench.feed(servo, "desired", desired);
    let images = (0..u64::try_from(ticks).unwrap()).map(image).collect();
    bench.array_feed(touch, "image", &TactileImage::new(16, 16), images);
    bench.bind_feeds("tactile_servo", &["control", "desired", "joints", "image"]);
    if by_wrist {
        bench.bind_feeds("tactile_servo", &["wrench"]);
    }
    let run = bench.run(SERVO_PERIOD * ticks);
    let (goals, features) =
        (run.of("tactile_servo.goal"), run.values_with_ticks("tactile_servo.features"));
    Keep { goals, features, faults: run.faults() }
}

const START_RAD: [f64; 6] = [0.0, 0.7, -2.68, -3.13, 1.17, 3.13];

fn in_touch_from_ten(tick: u64) -> Option<ControlState> {
    let state = if tick < 10 { State::IdleCalibrated } else { State::TactileServo };
    let entered_ns = if tick < 10 { 0 } else { 25_000_000 };
    Some(ControlState { state: state as u32, entered_ns, ..ControlState::ZERO })
}

fn calibrated(_: u64) -> Option<JointState> {
    Some(JointState { q_rad: START_RAD, calibrated: 1, ..JointState::ZERO })
}

fn still(_: u64) -> Option<Desired> {
    Some(Desired { q_rad: START_RAD, valid: 1, ..Desired::ZERO })
}

fn free(job: u64) -> TactileImage {
    TactileImage {
        acquired_ns: i64::try_from(job).unwrap() * SERVO_PERIOD.0 * 2,
        sequence: u32::try_from(job).unwrap(),
        valid: vec![1; 256].into(),
        baseline_ready: 1,
        ..TactileImage::new(16, 16)
    }
}

/// A line of 16 x 500 counts in column 8 or, with `turned`, in row 8.
fn line(job: u64, turned: bool) -> TactileImage {
    let mut image = free(job);
    for i in 0..16 {
        image.counts[if turned { 7 * 16 + i } else { i * 16 + 7 }] = 500.0;
    }
    image
}

const FREE: Script = Script {
    control: in_touch_from_ten,
    desired: still,
    joints: calibrated,
    image: |job| Some(free(job)),
    wrench: |_| Some(pressed(0.0, 0.0, 0.0)),
};

/// The wrench of a pin that presses with a force at a place of the face.
fn pressed(force_n: f64, x_mm: f64, y_mm: f64) -> Wrench {
    Wrench {
        force_n: [0.0, 0.0, -force_n],
        moment_nm: [-1e-3 * y_mm * force_n, 1e-3 * x_mm * force_n, 0.0],
        baseline_ready: 1,
        ..Wrench::ZERO
    }
}

fn q(goal: &Goal) -> Joints {
    Joints::from(goal.q_rad)
}

#[test]
fn it_starts_without_a_bump_and_seeks_along_the_approach_at_an_even_speed() {
    let keep = run(Config::default(), &FREE, 100);
    assert!(keep.faults.is_empty());
    assert!(keep.goals[..10].iter().all(|goal| *goal == Goal::ZERO));
    assert_eq!((keep.goals[10].q_rad, keep.goals[10].valid), (START_RAD, 1));
    let arm = taktil_mechanics::puma260::Puma260::reference();
    let from = arm.tool_pose(&Joints::from(START_RAD));
    let to = arm.tool_pose(&q(&keep.goals[99]));
    let way = from.rotation.transpose() * (to.translation - from.translation);
    // The image of job 5 of the touch lane is the first one read after the entry, at tick 11; 89
    // jobs of 6 mm/s.
    assert!((way.z - 89.0 * 6e-3 * 0.0025).abs() < 1e-7, "{way}");
    assert!(way.x.abs() < 1e-7 && way.y.abs() < 1e-7);
    assert!(to.rotation.abs_diff_eq(from.rotation, 1e-6));
    for pair in keep.goals[11..].windows(2) {
        let step = q(&pair[1]) - q(&pair[0]);
        assert!((step / 0.0025 - Joints::from(pair[1].qd_rad_s)).amax() < 1e-12);
        let before = Joints::from(pair[0].qd_rad_s);
        assert!((Joints::from(pair[1].qd_rad_s) - before).amax() < 1e-4, "no 200 Hz steps");
    }
}

#[test]
fn features_are_published_for_every_image_also_when_it_has_not_the_arm() {
    let script = Script { image: |job| Some(line(job, false)), ..FREE };
    let keep = run(Config::default(), &script, 40);
    // Image k of the touch lane is released at tick 2k and visible from tick 2k + 1.
    let ticks: Vec<u64> = keep.features.iter().map(|(tick, _)| *tick).collect();
    assert_eq!(ticks, (0..20).map(|k| 2 * k + 1).collect::<Vec<u64>>());
    for (tick, features) in &keep.features {
        assert_eq!(u64::from(features.sequence), (tick - 1) / 2);
        assert_eq!(
            (features.m0, features.x_c, features.y_c, features.m_x),
            (8000.0, 8.0, 8.5, 0.0)
        );
        assert_eq!(features.defined, defined::CONTACT | defined::CENTROID | defined::THETA_Z);
        assert_eq!((features.theta_z_rad, features.x_c_desired), (0.0, 2.0));
        assert_eq!(features.active, u32::from(*tick >= 10));
    }
}

/// The image of free air, changed.
fn free_but(job: u64, change: fn(&mut TactileImage)) -> Option<TactileImage> {
    let mut image = free(job);
    change(&mut image);
    Some(image)
}

#[test]
fn an_image_that_may_hide_a_load_says_so() {
    /// The image of a job.
    type Images = fn(u64) -> Option<TactileImage>;
    let cases: [(&str, Images, u32); 7] = [
        ("free", |job| Some(free(job)), 0),
        ("usual noise", |job| free_but(job, |image| image.noise_counts = 50.0), 0),
        (
            "five times the noise",
            |job| free_but(job, |image| image.noise_counts = 250.0),
            defined::CONTACT_UNCERTAIN,
        ),
        (
            "no baseline",
            |job| free_but(job, |image| image.baseline_ready = 0),
            defined::CONTACT_UNCERTAIN,
        ),
        ("half dead", |job| free_but(job, |image| image.valid[128..].fill(0)), 0),
        (
            "more than half dead",
            |job| free_but(job, |image| image.valid[127..].fill(0)),
            defined::CONTACT_UNCERTAIN,
        ),
        (
            "a load that is seen, however much else may hide",
            |job| Some(TactileImage { noise_counts: 150.0, ..line(job, false) }),
            defined::CONTACT | defined::CENTROID | defined::THETA_Z,
        ),
    ];
    for (case, image, due) in cases {
        let keep = run(Config::default(), &Script { image, ..FREE }, 40);
        assert!(!keep.features.is_empty(), "{case}");
        assert!(keep.features.iter().all(|(_, seen)| seen.defined == due), "{case}");
    }
}

#[test]
fn without_new_images_the_arm_stands_still() {
    let script = Script { image: |job| (job < 8).then(|| line(job, false)), ..FREE };
    let keep = run(Config::default(), &script, 60);
    // Job 7 is read at tick 15 and carried out by tick 16.
    assert_ne!(keep.goals[16].q_rad, keep.goals[15].q_rad);
    for goal in &keep.goals[17..] {
        assert_eq!((goal.q_rad, goal.qd_rad_s), (keep.goals[16].q_rad, [0.0; 6]));
    }
    // A law that predicts goes on for 50 ms, 20 jobs, and stands then.
    let keep = run(Config { law: LawName::Model, ..Config::default() }, &script, 60);
    assert_ne!(keep.goals[30].q_rad, keep.goals[29].q_rad);
    // What is left gives way to the script's joints, which never followed.
    for goal in &keep.goals[37..] {
        assert!(goal.qd_rad_s.iter().all(|speed| speed.abs() < 1e-7), "{goal:?}");
    }
}

#[test]
fn nothing_in_an_image_can_harm() {
    let script = Script {
        image: |job| {
            let mut image = line(job, job % 2 == 0);
            let odd = [f32::MIN_POSITIVE, f32::MAX, f32::MIN, 1e30, -0.0];
            image.counts[usize::try_from(job % 256).unwrap()] =
                odd[usize::try_from(job % 5).unwrap()];
            (image.rows, image.cols) = match job % 7 {
                0 => (u16::MAX, u16::MAX),
                1 => (0, 0),
                2 => (4, 64),
                _ => (16, 16),
            };
            image.baseline_ready = u32::from(job % 11 != 0);
            Some(image)
        },
        wrench: |tick| {
            let odd = [1e-300, 1e9, 1e30, -1e30, 0.0, 14.0];
            let one = odd[usize::try_from(tick % 6).unwrap()];
            (tick % 5 != 0).then(|| pressed(one, 1.0, -one))
        },
        ..FREE
    };
    for law in LawName::ALL.into_iter().chain([LawName::TaskFrame]) {
        let config = Config { law, ..Config::default() };
        let keep = run(config, &script, 2_000);
        assert!(keep.faults.is_empty(), "{law:?}: {:?}", keep.faults);
        assert_eq!((keep.goals.len(), keep.features.len()), (2_000, 1_000));
        assert!(keep.goals.iter().all(|goal| goal.q_rad.iter().all(|q| q.is_finite())));
    }
}

#[test]
fn laws_that_are_named_differ_and_each_answers_a_line() {
    // 14 400 counts of 15 000: near enough for no law to stand at its speed limit.
    let script = Script {
        image: |job| {
            let mut image = line(job, false);
            image.counts.iter_mut().for_each(|counts| *counts *= 1.8);
            Some(image)
        },
        wrench: |_| Some(pressed(13.5, -0.79, 1.0)),
        ..FREE
    };
    let ends = LawName::ALL.map(|law| {
        let keep = run(Config { law, ..Config::default() }, &script, 200);
        assert!(keep.faults.is_empty());
        // Every law presses, and rolls towards column 2 by +x.
        let arm = taktil_mechanics::puma260::Puma260::reference();
        let (from, to) = (arm.tool_pose(&q(&keep.goals[10])), arm.tool_pose(&q(&keep.goals[199])));
        let way = from.rotation.transpose() * (to.translation - from.translation);
        assert!(way.z > 1e-5 && way.x > 1e-4, "{law:?}: {way}");
        q(&keep.goals[199])
    });
    for (i, one) in ends.iter().enumerate() {
        for other in &ends[..i] {
            assert!((one - other).amax() > 1e-5, "{ends:?}");
        }
    }
}

#[test]
fn a_law_of_the_wrist_does_not_act_on_gauges_out_of_range_and_stops_in_contact_when_it_lasts() {
    /// In contact, with gauges that are marked in the jobs 100 to 109.
    fn marked(tick: u64, mark: u32) -> Option<Wrench> {
        let mark = if (100..110).contains(&tick) { mark } else { 1 };
        // The load that is marked is the largest that the gauges show: a law that believed it
        // would draw back.
        let force_n = if mark == 1 { 13.5 } else { 102.0 };
        Some(Wrench { baseline_ready: mark, ..pressed(force_n, -0.79, 1.0) })
    }
    let config = Config { law: LawName::HybridForce, ..Config::default() };
    let spike = Script { wrench: |tick| marked(tick, WRENCH_OVER_RANGE), ..FREE };
    let keep = run(config.clone(), &spike, 130);
    assert!(keep.faults.is_empty(), "{:?}", keep.faults);
    let step = |at: usize| (q(&keep.goals[at + 1]) - q(&keep.goals[at])).amax();
    assert!(step(90) > 0.0 && step(120) > 0.0, "the law drives before and after");
    assert!((101..108).all(|at| step(at) == 0.0), "and holds where the force is unknown");
    let lasting = Script { wrench: |tick| marked(tick, WRENCH_SATURATED), ..FREE };
    assert!(run(config.clone(), &lasting, 130).faults.contains(FaultCode::ForceUnknown));
    // A law that goes by touch does not care.
    let touch = Config { law: LawName::default(), ..config };
    let line = Script { image: |job| Some(line(job, false)), ..lasting };
    assert!(run(touch, &line, 130).faults.is_empty());
    // Without contact there is nothing to stop for.
    let free = Script {
        wrench: |_| Some(Wrench { baseline_ready: WRENCH_SATURATED, ..pressed(0.0, 0.0, 0.0) }),
        ..FREE
    };
    let config = Config { law: LawName::HybridForce, ..Config::default() };
    assert!(run(config, &free, 130).faults.is_empty());
}

#[test]
fn the_lead_over_the_measured_joints_is_bounded() {
    // The joints never move; the seek goes on for 2 s.
    let config = Config { max_lead_deg: 0.5, ..Config::default() };
    let keep = run(config, &FREE, 800);
    let lead = |goal: &Goal| (q(goal) - Joints::from(START_RAD)).amax().to_degrees();
    assert!(lead(&keep.goals[799]) > 0.499);
    assert!(keep.goals[10..].iter().all(|goal| lead(goal) <= 0.5 + 1e-9));
    // The bound of the way without contact.
    let config = Config { seek_max_mm: 1.0, ..Config::default() };
    let keep = run(config, &FREE, 800);
    let arm = taktil_mechanics::puma260::Puma260::reference();
    let height = |goal: &Goal| arm.tool_pose(&q(goal)).translation.z;
    let way = height(&keep.goals[10]) - height(&keep.goals[799]);
    assert!((way - 1e-3).abs() < 0.04e-3, "{way}");
}

/// The wrist's axes almost in line.
const STRAIGHT_WRIST_RAD: [f64; 6] = [0.0, 0.7, -2.68, -3.13, 0.01, 3.13];

#[test]
fn a_finger_that_touches_with_one_corner_evens_the_load_out() {
    // All load in row 16: the face at +y is to go back, a turn about x by less than nothing.
    let script = Script {
        image: |job| {
            let mut image = free(job);
            image.counts[15 * 16 + 7] = 1500.0;
            Some(image)
        },
        wrench: |_| Some(pressed(1.5, 0.0, 11.9)),
        ..FREE
    };
    for law in LawName::ALL {
        let keep = run(Config { law, ..Config::default() }, &script, 200);
        assert!(keep.faults.is_empty());
        let arm = taktil_mechanics::puma260::Puma260::reference();
        let (from, to) = (arm.tool_pose(&q(&keep.goals[10])), arm.tool_pose(&q(&keep.goals[199])));
        let turned = from.rotation.transpose() * to.rotation;
        let way = from.rotation.transpose() * (to.translation - from.translation);
        assert!(turned.y_axis.z < -1e-3 && way.z > 1e-4, "{law:?}: {turned} {way}");
    }
}

/// The line with six times its load in some jobs.
fn heavy(job: u64, when: core::ops::Range<u64>) -> TactileImage {
    let mut image = line(job, false);
    if when.contains(&job) {
        image.counts.iter_mut().for_each(|counts| *counts *= 6.0);
    }
    image
}

#[test]
fn a_load_far_above_its_set_point_is_a_fault_when_it_lasts() {
    let short = Script { image: |job| Some(heavy(job, 20..26)), ..FREE };
    let long = Script { image: |job| Some(heavy(job, 20..32)), ..FREE };
    assert!(run(Config::default(), &short, 120).faults.is_empty());
    assert!(run(Config::default(), &long, 120).faults.contains(FaultCode::Overload));
}

#[test]
fn near_a_singularity_it_holds_and_reports_it() {
    let script = Script {
        desired: |_| Some(Desired { q_rad: STRAIGHT_WRIST_RAD, valid: 1, ..Desired::ZERO }),
        joints: |_| {
            Some(JointState { q_rad: STRAIGHT_WRIST_RAD, calibrated: 1, ..JointState::ZERO })
        },
        ..FREE
    };
    let keep = run(Config::default(), &script, 60);
    assert!(keep.faults.contains(FaultCode::Singular));
    assert!(
        keep.goals[10..].iter().all(|goal| goal.q_rad == STRAIGHT_WRIST_RAD && goal.valid == 1)
    );
}

#[test]
fn it_starts_only_calibrated_and_stops_when_the_zero_moves() {
    let uncalibrated = Script {
        joints: |tick| calibrated(tick).map(|joints| JointState { calibrated: 0, ..joints }),
        ..FREE
    };
    let keep = run(Config::default(), &uncalibrated, 30);
    assert!(keep.faults.contains(FaultCode::MoveRefused));
    assert_eq!(keep.goals[10], Goal { done: 1, ..Goal::ZERO });
    assert!(keep.features.iter().all(|(_, features)| features.active == 0));
    let moved = Script {
        joints: |tick| {
            calibrated(tick).map(|joints| JointState { datum: u32::from(tick > 20), ..joints })
        },
        ..FREE
    };
    let keep = run(Config::default(), &moved, 30);
    assert!(keep.faults.contains(FaultCode::MoveRefused));
    assert_eq!((keep.goals[20].valid, keep.goals[21].valid, keep.goals[29].done), (1, 0, 1));
}

#[test]
fn the_turning_points_are_counted() {
    let script = Script {
        image: |job| {
            let mut image = line(job, false);
            let col = [7, 1, 14, 1][usize::try_from(job / 10 % 4).unwrap()];
            for row in 0..16 {
                image.counts.swap(row * 16 + 7, row * 16 + col);
            }
            Some(image)
        },
        ..FREE
    };
    let keep = run(Config::default(), &script, 80);
    let at = |job: usize| (keep.features[job].1.x_c_desired, keep.features[job].1.reversals);
    assert_eq!((at(9), at(10), at(19)), ((2.0, 0), (15.0, 1), (15.0, 1)));
    assert_eq!((at(20), at(29), at(30)), ((2.0, 2), (2.0, 2), (15.0, 3)));
}
