//! Tests an arm without masses: it is on its trajectory at every instant, whatever drives, brakes
//! and contacts do, and it feels the forces that a servoed finger would feel there.

mod common;

use common::{lowered, seconds};
use taktil_hal::{Devices, Nanos};
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::transmission::Transmission;
use taktil_sim::fidelity::{ArmModel, Integrator};
use taktil_sim::scene::ArmConfig;
use taktil_sim::{Timing, World, WorldConfig, build};

const HOME_DEG: [f64; 6] = [0.0, 46.790197, -160.621702, -180.0, 66.168495, 180.0];

fn point(t_s: f64, q_deg: [f64; 6]) -> [f64; 7] {
    let [a, b, c, d, e, f] = q_deg;
    [t_s, a, b, c, d, e, f]
}

fn kinematic(trajectory_deg: Vec<[f64; 7]>) -> WorldConfig {
    let arm = ArmConfig { trajectory_deg, ..ArmConfig::default() };
    let mut config = WorldConfig { arm, ..WorldConfig::default() };
    config.fidelity.arm = ArmModel::Kinematic;
    config
}

fn world(config: &WorldConfig) -> (World, Devices) {
    build(config, &Timing::default(), 1).unwrap()
}

#[test]
fn the_arm_follows_its_trajectory_at_every_instant_without_drives() {
    let mut turned = HOME_DEG;
    (turned[0], turned[4]) = (10.0, 60.0);
    let mut config = kinematic(vec![point(0.5, turned), point(1.0, HOME_DEG)]);
    config.pin.present = false;
    let (mut world, mut devices) = world(&config);
    world.advance(seconds(0.5));
    let truth = world.truth();
    assert!(truth.braked && !truth.enabled);
    for (i, turned) in turned.iter().enumerate() {
        assert!((truth.q[i] - turned.to_radians()).abs() < 1e-15, "joint {}", i + 1);
    }
    let tool = Puma260::reference().tool_pose(&truth.q).translation;
    assert!((truth.tool - tool).length() < 1e-15);
    let gears = Transmission::reference();
    let home = Joints::from_fn(|i, _| HOME_DEG[i].to_radians());
    let (now, then) = (gears.counts(&truth.q), gears.counts(&home));
    let seen = devices.encoders.as_mut().unwrap().sample(seconds(0.5)).unwrap().value;
    assert!((0..6).all(|i| seen[i].0 == now[i] - then[i]), "encoders tell the course");
    // At half of the time a symmetric motion is half-way, whatever the steps.
    world.advance(seconds(0.75));
    assert!((world.truth().q[0] - 5f64.to_radians()).abs() < 1e-12);
    world.advance(seconds(3.0));
    let end = world.truth();
    assert!((end.q - home).amax() < 1e-15 && end.qd == Joints::zeros());
    // Nothing touches the arm, so that nothing is computed.
    let work = world.statistics();
    assert_eq!(
        (work.newton_iterations, work.contact_evaluations, work.tactile_images),
        (0, 0, 0),
        "{work:?}"
    );
}

#[test]
fn contact_forces_do_not_move_a_prescribed_arm() {
    for integrator in [Integrator::Auto, Integrator::Euler] {
        let mut config = kinematic(vec![point(0.5, lowered(15.1))]);
        config.fidelity.integrator = integrator;
        if integrator == Integrator::Euler {
            config.substep_us = 80.0;
        }
        let (mut world, _devices) = world(&config);
        world.advance(seconds(2.0));
        let truth = world.truth();
        assert!(truth.in_contact && truth.finger_normal_n > 1.0, "{integrator:?}");
        for i in 0..6 {
            assert!((truth.q[i] - lowered(15.1)[i].to_radians()).abs() < 1e-12);
        }
        let weight_n = config.pin.mass_kg * 9.81;
        let left = truth.table_normal_n - truth.finger_normal_n - weight_n;
        assert!(left.abs() < 1e-6, "{integrator:?}: {left} N out of balance");
    }
}

#[test]
fn its_state_does_not_depend_on_the_division_of_time() {
    let config = kinematic(vec![point(0.5, lowered(15.2))]);
    let ((mut whole, _a), (mut cut, _b)) = (world(&config), world(&config));
    whole.advance(seconds(1.0));
    for i in 1..=400 {
        cut.advance(Nanos::from_micros(2500) * i);
    }
    assert_eq!(whole.truth().q, cut.truth().q);
    let (a, b) = (whole.truth().finger_normal_n, cut.truth().finger_normal_n);
    assert!((a - b).abs() < 1e-6, "{a} {b}");
}

#[test]
fn courses_that_cannot_be_followed_are_refused_with_their_place() {
    let place = |config: &WorldConfig| build(config, &Timing::default(), 1).unwrap_err().place;
    let mut far = HOME_DEG;
    far[1] = 400.0;
    assert_eq!(place(&kinematic(vec![point(1.0, far)])), "arm.trajectory_deg[0][2]");
    for t_s in [0.0, -1.0] {
        assert_eq!(place(&kinematic(vec![point(t_s, HOME_DEG)])), "arm.trajectory_deg[0]");
    }
    let back = vec![point(2.0, HOME_DEG), point(1.0, HOME_DEG)];
    assert_eq!(place(&kinematic(back)), "arm.trajectory_deg[1]");
    let nan = kinematic(vec![point(f64::NAN, HOME_DEG)]);
    assert!(place(&nan).starts_with("arm.trajectory_deg[0]"));
    let mut torques = kinematic(vec![point(1.0, HOME_DEG)]);
    torques.fidelity.arm = ArmModel::Rigid;
    assert_eq!(place(&torques), "arm.trajectory_deg");
}
