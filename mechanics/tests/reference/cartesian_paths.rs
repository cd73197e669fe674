//! Tests Paul's Cartesian moves and their blends.

use core::f64::consts::TAU;

use crate::table::{list, number, rows, toml};
use glam::DVec3;
use taktil_mechanics::paul::cartesian::{Blend, CartesianPath, PoseSetpoint};
use taktil_mechanics::paul::{MAX_POINTS, PathError};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::{rotation_about, rotation_x, rotation_y, rotation_z, wrap_angle};
use taktil_mechanics::{Joints, Pose};

const TICK_S: f64 = 0.0025;

fn reference_poses(name: &str) -> (Vec<Pose>, Vec<f64>, f64) {
    let file = toml("kinematics/moves.toml");
    let table = file[name].as_table().unwrap();
    let pose = |value: &toml::Value| {
        let x: Vec<f64> = value.as_array().unwrap().iter().map(number).collect();
        let r = core::array::from_fn(|i| x[i]);
        Pose::from_rows(&r, &[x[9], x[10], x[11]])
    };
    let poses = table["via"].as_array().unwrap().iter().map(pose).collect();
    (poses, list(table, "T"), number(&table["tau"]))
}

fn reference_path(name: &str, blend: Blend) -> CartesianPath {
    let (poses, t_s, tau_s) = reference_poses(name);
    CartesianPath::new(&poses, &t_s, tau_s, blend).unwrap()
}

/// Angle between two orientations given as quaternions w x y z (rad).
fn angle_between(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    let dot: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
    let off: f64 =
        a.iter().zip(b).map(|(x, y)| (x - dot.signum() * y) * (x - dot.signum() * y)).sum();
    2.0 * off.sqrt()
}

/// Largest distance of two joint vectors, whole turns apart (rad).
fn turned(a: &Joints, b: &Joints) -> f64 {
    (a - b).map(wrap_angle).amax()
}

/// The whole turn of an angle that lies within a joint's limits (rad).
fn inside(angle: f64, arm: &Puma260, joint: usize) -> f64 {
    let fits = |q: &f64| (arm.q_min_rad[joint]..=arm.q_max_rad[joint]).contains(q);
    [angle, angle + TAU, angle - TAU].into_iter().find(fits).expect("some turn lies within")
}

#[test]
fn moves_match_the_reference() {
    let files = [
        ("cart_move_1", "cart_move_1", Blend::Paul),
        ("cart_move_2", "cart_move_2", Blend::Paul),
        ("cart_blend", "cart_blend_paul", Blend::Paul),
        ("cart_blend", "cart_blend_smooth", Blend::Smooth),
        ("cart_blend", "cart_blend_so3", Blend::So3),
    ];
    let arm = Puma260::reference();
    for (name, file, blend) in files {
        let path = reference_path(name, blend);
        let mut previous = None;
        for row in rows(&format!("kinematics/{file}.csv")) {
            let tick = row.num("tick");
            let got = path.at(tick * TICK_S).pose;
            let p = DVec3::new(row.num("px"), row.num("py"), row.num("pz"));
            assert!((got.translation - p).length() < 1e-9, "{file} tick {tick}");
            let q = ["qw", "qx", "qy", "qz"].map(|column| row.num(column));
            let off = angle_between(&got.quaternion_wxyz(), &q);
            assert!(off < 1e-9, "{file} tick {tick}: {off}");
            if blend != Blend::Paul {
                continue;
            }
            let wanted = row.joints("q");
            let branches = arm.inverse_kinematics(&arm.tool_to_wrist(&got), previous.as_ref());
            let start = Joints::from_fn(|i, _| inside(wanted[i], &arm, i));
            let from = previous.unwrap_or(start);
            let (_, joints) =
                arm.nearest_branch(&branches, &from).expect("the path is within the limits");
            // The file's angles lie in [-pi, pi), ours within the limits.
            let off = turned(&joints, &wanted);
            assert!(off < 1e-9, "{file} tick {tick}: {off}");
            previous = Some(joints);
        }
    }
}

/// Largest step of the angular velocity between neighbouring instants, and where it is.
fn largest_step(path: &CartesianPath, dt: f64) -> (f64, f64) {
    let mut largest = (0.0, 0.0);
    let mut t = dt;
    while t < path.duration_s() + dt {
        let step = (path.at(t).angular_rad_s - path.at(t - dt).angular_rad_s).length();
        if step > largest.0 {
            largest = (step, t);
        }
        t += dt;
    }
    largest
}

#[test]
fn pauls_blend_steps_by_his_formula_and_the_others_do_not_step() {
    let tau = 0.125;
    // 1e-6 s apart: a step stays, what is continuous shrinks to acceleration times 1e-6 s.
    let (step, at) = largest_step(&reference_path("cart_blend", Blend::Paul), 1e-6);
    let starts = [2.0 * tau + 0.6 - 2.0 * tau, 2.0 * tau + 0.6];
    assert!(starts.iter().any(|t| (at - t).abs() < 2e-6), "at {at} s");
    assert!((step - 0.157).abs() < 5e-4, "{step}");
    for blend in [Blend::Smooth, Blend::So3] {
        let (step, at) = largest_step(&reference_path("cart_blend", blend), 1e-6);
        assert!(step < 1e-4, "{blend:?} steps by {step} rad/s at {at} s");
    }
}

/// Turns and moves through poses that are hard for two angles: no turn, half turns, opposite turns.
fn hard_paths() -> Vec<(Vec<Pose>, &'static str)> {
    let at = |x: f64, r| Pose::new(r, DVec3::new(x, 0.1, -0.1));
    let id = glam::DMat3::IDENTITY;
    vec![
        (vec![at(0.1, id), at(0.2, id), at(0.3, id)], "translation only"),
        (vec![at(0.1, id), at(0.1, id), at(0.1, id)], "a wait"),
        (vec![at(0.1, id), at(0.2, id), at(0.3, rotation_x(0.7))], "no turn, then a turn"),
        (vec![at(0.1, rotation_y(0.4)), at(0.2, id), at(0.3, rotation_y(0.6))], "there and back"),
        (vec![at(0.1, rotation_z(1.0)), at(0.2, id), at(0.3, rotation_z(-2.0))], "about approach"),
        (
            vec![at(0.1, rotation_x(3.1)), at(0.2, id), at(0.3, rotation_y(3.1))],
            "nearly half turns",
        ),
        (vec![at(0.1, rotation_x(1e-10)), at(0.2, id), at(0.3, rotation_y(1e-8))], "tiny turns"),
        (vec![at(0.1, rotation_x(-1.0)), at(0.2, id), at(0.3, rotation_y(1.0))], "square turns"),
    ]
}

#[test]
fn poses_and_velocities_never_jump() {
    for (poses, what) in hard_paths() {
        for blend in [Blend::Paul, Blend::Smooth, Blend::So3] {
            let path = CartesianPath::new(&poses, &[0.5, 0.7], 0.1, blend).unwrap();
            let dt = path.duration_s() / 20_000.0;
            let mut before = path.at(0.0);
            for n in 0..20_010 {
                let now = path.at(f64::from(n) * dt);
                let mean = (now.velocity_m_s + before.velocity_m_s) * (0.5 * dt);
                let moved = now.pose.translation - before.pose.translation;
                assert!((moved - mean * f64::from(n.min(1))).length() < 1e-9, "{what} {blend:?}");
                assert!((now.velocity_m_s - before.velocity_m_s).length() < 1e-3, "{what}");
                // The turn between the two instants is the angular velocity in the middle.
                let middle = path.at((f64::from(n) - 0.5) * dt).angular_rad_s * dt;
                let angle = middle.length();
                let turned = if angle > 0.0 && n > 0 {
                    rotation_about(middle / angle, angle) * before.pose.rotation
                } else {
                    before.pose.rotation
                };
                let off = turned - now.pose.rotation;
                let worst = off.to_cols_array().iter().fold(0.0f64, |a, x| a.max(x.abs()));
                // A step of the angular velocity costs Paul's blend one interval.
                assert!(
                    worst < if blend == Blend::Paul { 1e-3 } else { 1e-6 },
                    "{what} {blend:?} {worst} at {n}"
                );
                before = now;
            }
        }
    }
}

#[test]
fn the_ends_are_hit_and_the_tool_rests_outside() {
    for blend in [Blend::Paul, Blend::Smooth, Blend::So3] {
        let path = reference_path("cart_blend", blend);
        let (first, last) = (path.points()[0], path.points()[2]);
        for t in [0.0, -1.0, f64::NAN, f64::NEG_INFINITY] {
            assert_eq!(path.at(t), PoseSetpoint::rest(&first));
        }
        for t in [path.duration_s(), 1e300, f64::INFINITY] {
            assert_eq!(path.at(t), PoseSetpoint::rest(&last));
        }
        let end = path.at(path.duration_s() - 1e-9);
        assert!((end.pose.translation - last.translation).length() < 1e-12);
        assert!(end.pose.rotation.abs_diff_eq(last.rotation, 1e-12), "{blend:?}");
        assert!((path.duration_s() - 1.55).abs() < 1e-12);
    }
}

#[test]
fn invalid_paths_are_refused() {
    let good = Pose::IDENTITY;
    let new = |poses: &[Pose], t_s: &[f64], tau| CartesianPath::new(poses, t_s, tau, Blend::So3);
    assert_eq!(new(&[good], &[], 0.1), Err(PathError::TooFewPoints { points: 1 }));
    let many = [good; MAX_POINTS + 1];
    assert_eq!(new(&many, &[1.0; MAX_POINTS], 0.1), Err(PathError::TooManyPoints { points: 33 }));
    let mut bad = [good; 4];
    bad[0].translation.x = f64::NAN;
    bad[1].rotation.x_axis *= 1.001;
    bad[2].rotation.z_axis *= -1.0;
    bad[3].rotation.y_axis.z = f64::INFINITY;
    for pose in bad {
        let refused = new(&[good, pose], &[1.0], 0.1).unwrap_err();
        assert_eq!(refused, PathError::InvalidPose { point: 1 });
        assert!(refused.to_string().contains("point 1"));
    }
    assert!(new(&[good, good], &[1.0], 0.6).is_err(), "tau");
    assert!(new(&[good, good], &[f64::NAN], 0.1).is_err(), "time");
}
