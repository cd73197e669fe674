//! Tests forward kinematics, Jacobians, singularities and damped least squares.

use crate::derivative;
use crate::lcg::Lcg;
use crate::table::{joints, list, number, rows, toml};
use nalgebra::Vector6;
use taktil_mechanics::dls::{
    damped_least_squares, damping_squared, scale_to_speed_limits, singular_values,
};
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::{Dynamics, LINKS, TOOL};
use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_mechanics::{Joints, Matrix6};

fn radians(degrees: &Joints) -> Joints {
    degrees.map(f64::to_radians)
}

#[test]
fn the_parameters_are_those_of_the_file() {
    let file = toml("kinematics/puma260_params.toml");
    let section = |name: &str| file[name].as_table().unwrap().clone();
    let arm = Puma260::reference();
    let (dh, limits, drive) = (section("dh"), section("limits"), section("drive"));
    assert_eq!(list(&dh, "a"), [0.0, arm.a2_m, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(list(&dh, "d"), [0.0, 0.0, arm.d3_m, arm.d4_m, 0.0, 0.0]);
    assert_eq!(number(&section("frames")["tool_z"]), arm.tool_z_m);
    assert_eq!(radians(&joints(&limits, "q_min_deg")), arm.q_min_rad);
    assert_eq!(radians(&joints(&limits, "q_max_deg")), arm.q_max_rad);
    assert_eq!(radians(&joints(&limits, "v_max_deg_s")), arm.speed_max_rad_s);
    assert_eq!(radians(&joints(&limits, "a_max_deg_s2")), arm.acceleration_max_rad_s2);

    let gears = Transmission::reference();
    assert_eq!(gears.gear_matrix().diagonal(), joints(&drive, "gear_ratio"));
    let coupling = [(4, 3, "c54"), (5, 3, "c64"), (5, 4, "c65")];
    assert!(coupling.iter().all(|&(r, c, key)| gears.gear_matrix()[(r, c)] == number(&drive[key])));
    let amplifiers = Drive::reference();
    assert_eq!(amplifiers.torque_constant_nm_a, joints(&drive, "torque_constant"));
    assert_eq!(amplifiers.current_max_a, joints(&drive, "current_max"));
    assert_eq!(f64::from(amplifiers.dac_bits), number(&drive["dac_bits"]));

    let friction = Friction::reference();
    assert_eq!(friction.coulomb_nm, joints(&drive, "coulomb"));
    assert_eq!(friction.viscous_nms_rad, joints(&drive, "viscous"));
    let gear = joints(&drive, "gear_ratio");
    let reflected = joints(&drive, "motor_inertia").component_mul(&gear).component_mul(&gear);
    assert!((Dynamics::reference().reflected_inertia_kg_m2 - reflected).amax() < 1e-16);
    assert_eq!(list(&section("meta"), "gravity"), [0.0, 0.0, -GRAVITY_M_S2]);

    let links = file["link"].as_array().unwrap().iter().map(|l| l.as_table().unwrap().clone());
    let bodies = LINKS.iter().chain([&TOOL]);
    for (want, body) in links.chain([section("tool_body")]).zip(bodies) {
        assert_eq!(number(&want["mass"]), body.mass_kg);
        assert_eq!(list(&want, "com"), body.com_m.to_array());
        let inertia = &body.inertia_kg_m2;
        assert_eq!(list(&want, "inertia"), [inertia.x_axis.x, inertia.y_axis.y, inertia.z_axis.z]);
    }
}

#[test]
fn forward_kinematics_match_the_reference() {
    let arm = Puma260::reference();
    let file = rows("kinematics/fk.csv");
    assert_eq!(file.len(), 200);
    for row in file {
        let q = row.joints("q");
        let (got, want) = (arm.wrist_pose(&q), row.pose());
        assert!(got.rotation.abs_diff_eq(want.rotation, 1e-12), "row {}", row.word("id"));
        assert!((got.translation - want.translation).length() < 1e-12, "row {}", row.word("id"));
        let tool = arm.tool_pose(&q);
        let point = glam::DVec3::new(row.num("tool_px"), row.num("tool_py"), row.num("tool_pz"));
        assert!((tool.translation - point).length() < 1e-12, "row {}", row.word("id"));
        let back = arm.tool_to_wrist(&tool);
        assert!((back.translation - got.translation).length() < 1e-15);
    }
}

#[test]
fn jacobians_and_determinants_match_the_reference() {
    let arm = Puma260::reference();
    let q: Vec<Joints> = rows("kinematics/fk.csv").iter().map(|r| r.joints("q")).collect();
    for (row, q) in rows("kinematics/jacobian_base.csv").iter().zip(&q) {
        let j = arm.jacobian_base(q);
        assert!((j - row.matrix()).amax() < 2e-12, "row {}", row.word("id"));
        assert!((arm.jacobian_determinant(q) - row.num("det")).abs() < 1e-12);
        assert!((j.determinant() - row.num("det")).abs() < 1e-12);
        let sigma = singular_values(&j);
        assert!((sigma[0] - row.num("sigma_max")).abs() < 1e-11);
        assert!((sigma[5] - row.num("sigma_min")).abs() < 1e-12);
    }
    let tool = rows("kinematics/jacobian_tool.csv");
    assert_eq!(tool.len(), 60);
    for (row, q) in tool.iter().zip(&q) {
        assert!((arm.jacobian_tool(q) - row.matrix()).amax() < 2e-12, "row {}", row.word("id"));
    }
}

#[test]
fn the_jacobian_is_the_derivative_of_the_pose() {
    let arm = Puma260::reference();
    let mut lcg = Lcg::new(3);
    for _ in 0..300 {
        let q = lcg.joints(&arm);
        let (base, tool) = (arm.jacobian_base(&q), arm.jacobian_tool(&q));
        derivative::check(&q, &lcg.six(1.0), |q| arm.tool_pose(q), base, tool);
    }
}

#[test]
fn singularities_have_their_names() {
    let arm = Puma260::reference();
    let mut lcg = Lcg::new(4);
    for _ in 0..1000 {
        let q = lcg.joints(&arm);
        let d = arm.singularity_distance(&q);
        let product = arm.a2_m * arm.d4_m * (arm.a2_m + arm.d4_m) * d.shoulder * d.elbow * d.wrist;
        assert!((product - arm.jacobian_determinant(&q)).abs() < 1e-16);
        assert!(d.smallest() <= d.elbow.abs() && d.shoulder.abs() <= 1.0);
    }
    let half = core::f64::consts::FRAC_PI_2;
    let stretched = Joints::new(0.1, 0.4, -half, 0.3, 0.8, 0.2);
    assert!(arm.singularity_distance(&stretched).elbow.abs() < 1e-15);
    assert!(arm.singularity_distance(&stretched).wrist > 0.7);
    assert!(arm.singularity_distance(&Joints::zeros()).wrist == 0.0);
    let overhead = Joints::new(0.1, half, 0.0, 0.0, 1.0, 0.0);
    assert!((arm.singularity_distance(&overhead).shoulder + 0.5).abs() < 1e-15);
}

#[test]
fn damped_least_squares_match_the_reference() {
    let arm = Puma260::reference();
    let file = rows("kinematics/dls.csv");
    assert_eq!(file.len(), 30);
    for row in file {
        let j = arm.jacobian_base(&row.joints("q"));
        let twist =
            Vector6::from_iterator(["vx", "vy", "vz", "wx", "wy", "wz"].map(|c| row.num(c)));
        let qd = damped_least_squares(&j, &twist, row.num("lambda")).unwrap();
        let error = (qd - row.joints("qd")).amax();
        assert!(error < 1e-9, "row {}: {error:e}", row.word("id"));
        assert!(((j * qd - twist).norm() - row.num("residual_norm")).abs() < 1e-9);
    }
}

#[test]
fn damping_refuses_what_has_no_answer_and_limits_the_rest() {
    let arm = Puma260::reference();
    let j = arm.jacobian_base(&Joints::zeros());
    let twist = Vector6::new(0.1, 0.0, 0.0, 0.0, 0.2, 0.0);
    assert_eq!(damped_least_squares(&j, &twist, 0.0), None);
    assert_eq!(damped_least_squares(&Matrix6::zeros(), &twist, 0.0), None);
    assert_eq!(damped_least_squares(&(j * f64::NAN), &twist, 0.1), None);
    assert_eq!(damped_least_squares(&j, &(twist * f64::INFINITY), 0.1), None);
    let slow = damped_least_squares(&j, &twist, 1e3).unwrap();
    assert!(slow.amax() < 1e-6 && slow.amax() > 0.0);
    assert_eq!(damped_least_squares(&j, &twist, -1e3), Some(slow));

    assert_eq!(damping_squared(0.2, 0.1, 0.5), 0.0);
    assert_eq!(damping_squared(f64::NAN, 0.1, 0.5), 0.25);
    assert!((damping_squared(-0.05, 0.1, 0.5) - 0.1875).abs() < 1e-15);
    assert_eq!(damping_squared(0.0, 0.0, 0.5), 0.0);

    let fast = Joints::new(1.0, -30.0, 2.0, 0.0, 0.0, 5.0);
    let (slow, factor) = scale_to_speed_limits(&fast, &arm.speed_max_rad_s);
    assert!(
        (slow[1] + arm.speed_max_rad_s[1]).abs() < 1e-15 && (slow - fast * factor).amax() == 0.0
    );
    assert_eq!(
        scale_to_speed_limits(&Joints::repeat(0.1), &arm.speed_max_rad_s),
        (Joints::repeat(0.1), 1.0)
    );
    assert_eq!(
        scale_to_speed_limits(&Joints::repeat(f64::NAN), &arm.speed_max_rad_s),
        (Joints::zeros(), 0.0)
    );
    assert!(singular_values(&(j * f64::NAN)).iter().all(|s| s.is_nan()));
    let _ = singular_values(&(j * 1e306));
}

#[test]
fn numbers_that_are_not_finite_come_out_as_nan() {
    let arm = Puma260::reference();
    let lost = Joints::new(0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0);
    assert!(!arm.wrist_pose(&lost).is_finite());
    assert!(arm.jacobian_determinant(&lost).is_nan() && !arm.within_limits(&lost));
    let huge = Joints::repeat(1e300);
    assert!(
        arm.wrist_pose(&huge).is_finite() && arm.jacobian_tool(&huge).iter().all(|x| x.is_finite())
    );
}
