//! Checks the energy over ten seconds of free motion, and the order of each integrator.

use taktil_mechanics::puma260::dynamics::Dynamics;

use super::*;
use crate::arm::Arm;
use crate::scene::fidelity::ArmModel;
use crate::scene::{ArmConfig, TableConfig};

/// The arm alone, without sticking friction, in an arbitrary pose.
fn moving_arm(method: Method, step_us: i64, viscous: f64) -> Plant {
    plant_of(thrown_arm(viscous), method, step_us)
}

fn thrown_arm(viscous: f64) -> Arm {
    let model = if viscous > 0.0 { ArmModel::RigidMotors } else { ArmModel::Rigid };
    let config = ArmConfig { coulomb_scale: 0.0, viscous_scale: viscous, ..ArmConfig::default() };
    let mut arm = Arm::new(&config, model, 1).unwrap();
    arm.lines.braked = false;
    arm.state.q = Joints::new(0.430, 0.813, -1.776, -0.490, 0.606, 1.038);
    arm
}

fn plant_of(arm: Arm, method: Method, step_us: i64) -> Plant {
    Plant {
        finger: Box::new(arm),
        rolling: None,
        objects: None,
        table: Table::new(&TableConfig::default(), -195.0),
        method,
        substep: Nanos::from_micros(step_us),
        error_m: 0.0,
        statistics: StepStatistics::default(),
        warm_start: WarmStart::default(),
        contacts_current: false,
        room: StepRoom::new(method, None),
    }
}

/// Largest drift of the energy relative to the peak of the kinetic energy, in 10 s without hard
/// stops.
fn drift(step_us: i64) -> f64 {
    let mut arm = thrown_arm(0.0);
    arm.without_stops();
    let (mut plant, dynamics) = (plant_of(arm, Method::Rk4, step_us), Dynamics::reference());
    let start = plant.finger.energy_j();
    let (mut most, mut peak) = (0.0_f64, 0.0_f64);
    for i in 0..4000 {
        let tick = Nanos::from_micros(2500);
        plant.integrate(tick * i, tick * (i + 1));
        most = most.max((plant.finger.energy_j() - start).abs());
        let ArmState { q, qd, .. } = plant.finger.state();
        peak = peak.max(dynamics.kinetic_energy_j(q, qd));
    }
    most / peak
}

#[test]
fn free_motion_keeps_its_energy_for_ten_seconds() {
    let (servo, fine) = (drift(2500), drift(1000));
    println!("drift over peak kinetic energy: {servo:.1e} at 2.5 ms, {fine:.1e} at 1 ms");
    assert!(servo < 5e-8, "{servo:e}");
    assert!(fine < 1e-9, "{fine:e}");
}

#[test]
fn each_integrator_has_its_order() {
    let end = |method, step_us| {
        let mut plant = moving_arm(method, step_us, 1.0);
        plant.integrate(Nanos::ZERO, Nanos::from_millis(200));
        plant.finger.state().q
    };
    let exact = end(Method::Rk4, 100);
    for (method, order, from_us) in
        [(Method::Euler, 1.0, 500), (Method::Implicit, 2.0, 2000), (Method::Rk4, 4.0, 4000)]
    {
        let error = |us: i64| (end(method, us) - exact).amax();
        let errors = [error(from_us), error(from_us / 2), error(from_us / 4)];
        let orders = [errors[0] / errors[1], errors[1] / errors[2]].map(libm::log2);
        println!("{method:?}: errors {errors:?} rad, orders {orders:.2?}");
        assert!(
            orders.iter().all(|o| (o - order).abs() < 0.3),
            "{method:?}: {errors:?} {orders:?}"
        );
    }
}

#[test]
fn a_joint_that_meets_its_stop_stays_there() {
    for method in [Method::Rk4, Method::Implicit, Method::Euler] {
        let mut plant = moving_arm(method, 2500, 0.0);
        plant.finger.state_mut().qd[4] = 20.0;
        for i in 0..100 {
            let tick = Nanos::from_micros(2500);
            plant.integrate(tick * i, tick * (i + 1));
            assert!(!plant.finger.is_beyond_limits());
            assert!(plant.finger.state().qd.iter().all(|v| v.is_finite()));
        }
        assert!(
            method == Method::Euler || plant.statistics.halved_steps > 0,
            "{method:?}: {:?}",
            plant.statistics
        );
    }
}

/// The arm with compliant gears of one stiffness, without friction, its springs unloaded.
fn compliant_arm(step_us: i64, stiffness: Option<f64>) -> Plant {
    let mut config = ArmConfig { coulomb_scale: 0.0, viscous_scale: 0.0, ..ArmConfig::default() };
    config.gear_damping = 0.0;
    if let Some(stiffness) = stiffness {
        config.gear_stiffness_nm_rad = [stiffness; 6];
    }
    let mut arm = Arm::new(&config, ArmModel::Compliant, 1).unwrap();
    let q = thrown_arm(0.0).state.q;
    arm.lines.braked = false;
    (arm.state.q, arm.state.rotors.q) = (q, q);
    plant_of(arm, Method::Implicit, step_us)
}

fn after(mut plant: Plant, span: Nanos) -> Joints {
    plant.integrate(Nanos::ZERO, span);
    plant.finger.state().q
}

#[test]
fn nearly_rigid_gears_behave_as_rigid_ones() {
    let span = Nanos::from_millis(200);
    let rigid = after(moving_arm(Method::Implicit, 50, 0.0), span);
    let off = |k: f64| (after(compliant_arm(50, Some(k)), span) - rigid).amax();
    let (hard, soft) = (off(1e6), off(1e4));
    println!("off the rigid arm: {hard:.1e} rad at 1e6 N m/rad, {soft:.1e} at 1e4");
    assert!(hard < 1e-4 && soft > 5.0 * hard, "{hard:e} {soft:e}");
}

#[test]
fn an_arm_on_springs_keeps_its_energy_and_its_order() {
    let energies = |step_us: i64| {
        let mut plant = compliant_arm(step_us, None);
        let start = plant.finger.energy_j();
        let most = (0..200).map(|i| {
            let tick = Nanos::from_micros(2500);
            plant.integrate(tick * i, tick * (i + 1));
            (plant.finger.energy_j() - start).abs()
        });
        most.fold(0.0, f64::max)
    };
    let (coarse, fine) = (energies(100), energies(25));
    println!("energy off by {coarse:.1e} J at 100 us, {fine:.1e} J at 25 us");
    assert!(coarse < 1e-6 && fine < 1e-6, "{coarse:e} {fine:e}");
    let span = Nanos::from_millis(50);
    let exact = after(compliant_arm(5, None), span);
    let error = |us: i64| (after(compliant_arm(us, None), span) - exact).amax();
    let errors = [error(160), error(80), error(40)];
    let orders = [errors[0] / errors[1], errors[1] / errors[2]].map(libm::log2);
    println!("errors {errors:?} rad, orders {orders:.2?}");
    assert!(orders.iter().all(|order| *order > 1.6), "{errors:?} {orders:?}");
}
