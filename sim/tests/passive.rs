//! Checks a pin that nobody pushes: its kinetic and potential energy and the energy of rubber and
//! bristles never exceed together their value at the start, over a grid of masses, moduli,
//! relaxation times and steps. Table and finger stand still and do no work.

mod common;

use common::{at, bench, meeting_height, nominal, over};
use glam::DMat3;
use taktil_sim::scene::{Axis, Motion, RubberConfig};
use taktil_sim::{Carriage, World, WorldConfig};

const GRAVITY_M_S2: f64 = 9.81;

/// One point of the grid.
#[derive(Clone, Copy, Debug)]
struct Case {
    mass_kg: f64,
    youngs_mpa: f64,
    relaxation_ms: f64,
    substep_us: f64,
}

fn grid() -> Vec<Case> {
    let mut all = Vec::new();
    for mass_kg in [1e-3, 1.7e-3, 0.2, 10.0] {
        for youngs_mpa in [0.05, 2.0, 500.0] {
            for relaxation_ms in [0.0, 0.3, 10.0, 100.0] {
                for substep_us in [100.0, 1250.0] {
                    all.push(Case { mass_kg, youngs_mpa, relaxation_ms, substep_us });
                }
            }
        }
    }
    all
}

fn config(case: Case) -> WorldConfig {
    let mut config = WorldConfig { substep_us: case.substep_us, ..WorldConfig::default() };
    let Case { youngs_mpa, relaxation_ms, .. } = case;
    (config.pin.mass_kg, config.pin.fixture) = (case.mass_kg, false);
    config.finger.rubber = RubberConfig { youngs_mpa, relaxation_ms, ..config.finger.rubber };
    config.table.rubber = RubberConfig { youngs_mpa, relaxation_ms, ..config.table.rubber };
    (config.tactile.present, config.wrist.present) = (false, false);
    config
}

/// Largest gain over the energy at `from_s`, in 0.3 s (J).
fn gain_j(world: &mut World, from_s: f64) -> f64 {
    let whole = |world: &World| world.energy_j() + world.rubber_energy_j();
    at(world, from_s);
    let (start, mut gain) = (whole(world), f64::NEG_INFINITY);
    for i in 1..=120 {
        at(world, from_s + 2.5e-3 * f64::from(i));
        gain = gain.max(whole(world) - start);
    }
    gain
}

/// Largest gains with damped and with undamped rubber, relative to `scale_j` of each case.
fn worst(name: &str, run: impl Fn(Case) -> (f64, f64)) -> [f64; 2] {
    let mut worst = [f64::NEG_INFINITY; 2];
    for case in grid() {
        let (gain, scale) = run(case);
        assert!(gain.is_finite(), "{name} {case:?}");
        let part = gain / scale;
        let most = &mut worst[usize::from(case.relaxation_ms == 0.0)];
        if part > *most {
            println!("{name} {case:?}: {part:.1e}");
            *most = part;
        }
    }
    worst
}

#[test]
fn a_pin_dropped_on_a_slope_gains_nothing() {
    let [damped, undamped] = worst("dropped", |case| {
        let mut config = config(case);
        (config.pin.yaw_deg, config.table.tilt_y_deg, config.table.tilt_x_deg) = (30.0, 15.0, 5.0);
        // The table falls away faster than the pin can follow.
        config.table.motion = vec![Motion::ramp(Axis::Height, -1000.0, 0.0, 0.0025)];
        let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(-0.05))], float: None };
        let (mut world, _devices) = bench(&config, carriage);
        (gain_j(&mut world, 0.0025), case.mass_kg * GRAVITY_M_S2 * 2.5e-3)
    });
    // The bound is the rounding of sums over the whole height of the weight.
    assert!(damped < 1e-11, "{damped:e} of the drop's energy");
    assert!(undamped < 1e-11, "{undamped:e} of the drop's energy");
}

#[test]
fn a_pin_squeezed_out_takes_no_more_than_the_rubbers_held() {
    let [damped, undamped] = worst("squeezed", |case| {
        let mut config = config(case);
        config.pin.yaw_deg = 20.0;
        (config.finger.friction, config.table.friction) = (0.003, 0.003);
        let axes = nominal() * DMat3::from_rotation_x(0.002) * DMat3::from_rotation_y(0.02);
        let z = meeting_height(&config) - 5e-5;
        let carriage = Carriage { axes, knots: vec![(0.0, over(z))], float: None };
        let (mut world, _devices) = bench(&config, carriage);
        let held = world.rubber_energy_j();
        (gain_j(&mut world, 0.0), held)
    });
    assert!(damped < 1e-9, "{damped:e} of what they held");
    assert!(undamped < 1e-9, "{undamped:e} of what they held");
}
