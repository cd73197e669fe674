//! Tests contact in motion: sliding at the Coulomb limit, rolling without drift, balance of forces,
//! momentum and energy; and the image of a pin in three dimensions.

mod common;

use common::{at, bench, load_of, meeting_height, nominal, over, seconds};
use glam::DVec3;
use taktil_hal::{Arrival, TactileFrame};
use taktil_mechanics::tactile::{Features, Image, features, moments};
use taktil_sim::fidelity::ContactModel;
use taktil_sim::scene::{Axis, Motion};
use taktil_sim::{ArrayGeometry, Carriage, FloatingGuide, Truth, World, WorldConfig};

const GRAVITY_M_S2: f64 = 9.81;

#[test]
fn pushed_past_the_limit_it_slides_at_exactly_mu_times_the_load() {
    let mut config = WorldConfig::default();
    config.finger.friction = 0.1;
    let z = meeting_height(&config) + 1e-4;
    // The push is along the pin's axis, so that the pin cannot roll out of the way.
    let knots = vec![(0.5, over(z)), (1.5, over(z) + DVec3::new(0.0, 0.01, 0.0))];
    let (mut world, _devices) =
        bench(&config, Carriage { axes: nominal(), knots, float: load_of(15.0) });
    for i in 0..50 {
        let truth = at(&mut world, 0.8 + 0.01 * f64::from(i));
        let (across, along) = truth.finger_tangential_n;
        let size = (across * across + along * along).sqrt();
        let due = 0.1 * truth.finger_normal_n;
        assert!((size / due - 1.0).abs() < 1e-9, "{size} {due}");
        assert!(truth.finger_slip_m_s > 1e-3 && truth.table_slip_m_s == 0.0);
    }
}

/// Drift of rolling (m) and largest creepage over a stroke of 10 mm, with the rubbers' moduli
/// multiplied by a factor.
fn stroke(factor: f64) -> (f64, f64) {
    let mut config = WorldConfig::default();
    config.finger.rubber.youngs_mpa *= factor;
    config.table.rubber.youngs_mpa *= factor;
    let z = meeting_height(&config) + 1e-4;
    let knots = vec![(0.5, over(z)), (1.5, over(z) + DVec3::new(0.01, 0.0, 0.0))];
    let (mut world, _devices) =
        bench(&config, Carriage { axes: nominal(), knots, float: load_of(15.0) });
    let start = at(&mut world, 0.5);
    let mut creepage = 0.0_f64;
    for i in 1..100 {
        let truth = at(&mut world, 0.5 + 0.01 * f64::from(i));
        let (finger, table) = truth.creepage.unwrap_or((0.0, 0.0));
        creepage = creepage.max(finger.abs()).max(table.abs());
    }
    let end = at(&mut world, 1.7);
    let finger = end.tool.x - start.tool.x;
    let rolled = 1e-3 * config.pin.radius_mm * (end.pin_roll_rad - start.pin_roll_rad);
    let drift = (end.pin.x - start.pin.x - 0.5 * finger).abs();
    (drift.max((rolled.abs() - 0.5 * finger).abs()), creepage)
}

#[test]
fn rolling_does_not_drift_and_creepage_is_reported() {
    let (drift, creepage) = stroke(100.0);
    println!("stiffness x 100: drift {drift:.2e} m, creepage up to {creepage:.2e}");
    assert!(drift < 1e-6, "{drift:e}");
    let (drift, creepage) = stroke(1.0);
    println!("physical stiffness: drift {drift:.2e} m, creepage up to {creepage:.2e}");
    assert!(drift < 5e-5 && creepage > 0.0 && creepage < 0.1, "{drift:e} {creepage:e}");
}

#[test]
fn forces_balance_at_rest_to_a_nanonewton() {
    for contact in [ContactModel::Line, ContactModel::Layer2d, ContactModel::Layer3d] {
        let mut config = WorldConfig::default();
        config.fidelity.contact = contact;
        let z = meeting_height(&config) + 1e-4;
        let knots = vec![(0.0, over(z))];
        let carriage = Carriage { axes: nominal(), knots, float: load_of(15.0) };
        let (mut world, _devices) = bench(&config, carriage);
        let weight = config.pin.mass_kg * GRAVITY_M_S2;
        let mut worst = [0.0_f64; 3];
        // Forces are compared at images, which are made every 5 ms, and between them.
        for i in 0..60 {
            let truth = at(&mut world, 2.0 + 0.0037 * f64::from(i));
            let sideways = truth.finger_tangential_n.0 + truth.table_tangential_n.0;
            let off =
                [truth.finger_normal_n - 15.0, truth.table_normal_n - 15.0 - weight, sideways];
            worst = core::array::from_fn(|i| worst[i].max(off[i].abs()));
        }
        assert!(worst.iter().all(|off| *off < 1e-9), "{contact:?}: {worst:?}");
    }
}

#[test]
fn momentum_changes_by_the_forces_from_outside_alone() {
    // The table falls away; a finger that is pushed down with 15 N catches the falling pin and
    // pushes it on, so that their mutual forces cancel.
    let mut config = WorldConfig::default();
    config.pin.fixture = false;
    config.table.motion = vec![Motion::ramp(Axis::Height, -1000.0, 0.0, 1.5)];
    let z = meeting_height(&config) + 1e-3;
    let float = Some(FloatingGuide { mass_kg: 1.0, load_n: 15.0, damping_n_s_m: 0.0 });
    let knots = vec![(0.0, over(z))];
    let (mut world, _devices) = bench(&config, Carriage { axes: nominal(), knots, float });
    let momentum = |t: &Truth| t.tool_velocity.z + config.pin.mass_kg * t.pin_velocity.z;
    let start = at(&mut world, 0.005);
    let (mut touched, mut worst) = (false, 0.0_f64);
    for i in 1..60 {
        let t_s = 0.001 * f64::from(i);
        let truth = at(&mut world, 0.005 + t_s);
        assert_eq!(truth.table_normal_n, 0.0);
        touched |= truth.in_contact;
        let due = -(15.0 + config.pin.mass_kg * GRAVITY_M_S2) * t_s;
        worst = worst.max((momentum(&truth) - momentum(&start) - due).abs());
    }
    println!("momentum: off by {worst:.1e} kg m/s at most");
    assert!(touched && worst < 1e-7, "{worst:e}");
}

/// Largest gain and loss of the whole energy, relative to the energy of the drop, of a pin that is
/// dropped by 2 mm on undamped rubber and bounces twenty times.
fn bounces(substep_us: f64) -> (f64, f64) {
    let mut config = WorldConfig { substep_us, ..WorldConfig::default() };
    config.pin.fixture = false;
    config.table.rubber.relaxation_ms = 0.0;
    config.table.motion = vec![Motion::ramp(Axis::Height, -1000.0, 0.0, 0.002)];
    let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(-0.1))], float: None };
    let (mut world, _devices) = bench(&config, carriage);
    let mut whole = |t_s: f64| {
        at(&mut world, t_s);
        world.energy_j() + world.rubber_energy_j()
    };
    let start = whole(0.005);
    let drop_j = config.pin.mass_kg * GRAVITY_M_S2 * 2e-3;
    let (mut gain, mut loss) = (0.0_f64, 0.0_f64);
    for i in 1..800 {
        let change = (whole(0.005 + 1.25e-3 * f64::from(i)) - start) / drop_j;
        (gain, loss) = (gain.max(change), loss.max(-change));
    }
    (gain, loss)
}

#[test]
fn energy_is_kept_with_the_order_of_the_steps() {
    let (coarse, fine) = (bounces(160.0), bounces(40.0));
    println!("energy gained and lost over the drop's: {coarse:?} at 160 us, {fine:?} at 40 us");
    assert!(fine.0 < 1e-3 && coarse.0 < 0.01, "gained {coarse:?} {fine:?}");
    assert!(fine.1 < 0.05 && fine.1 < 0.5 * coarse.1, "lost {coarse:?} {fine:?}");
}

fn observed(
    world: &mut World,
    devices: &mut taktil_hal::Devices,
    t_s: f64,
) -> (Truth, f64, Features) {
    let truth = at(world, t_s);
    let mut frame = TactileFrame::new(16, 16);
    assert_eq!(
        devices.tactile.get_mut("tactile").unwrap().sample(seconds(t_s), &mut frame),
        Ok(Arrival::New)
    );
    let values: Vec<f32> = frame.values.iter().map(|v| (f64::from(*v) - 300.0) as f32).collect();
    let moments = moments(&Image::new(16, 16, &values, None).unwrap(), 0.0);
    (truth, moments.m0, features(&moments))
}

/// The array's image of a short pin of the reference's size and rubber, pressed by a finger.
#[test]
fn a_short_pin_is_imaged_whole_at_its_place() {
    for (yaw_deg, x_mm, y_mm) in [(0.0, 0.0, 0.0), (20.0, 2.0, -1.5), (-15.0, -3.0, 2.0)] {
        let mut config = WorldConfig::default();
        config.fidelity.contact = ContactModel::Layer3d;
        config.finger.rubber.youngs_mpa = 27.58;
        (config.pin.length_mm, config.pin.yaw_deg) = (12.0, yaw_deg);
        (config.pin.x_mm, config.pin.y_mm) = (x_mm, y_mm);
        config.tactile.noise_counts = 0.0;
        config.tactile.bits = 16;
        let z = meeting_height(&config) + 1e-4;
        let knots = vec![(0.0, over(z))];
        let carriage = Carriage { axes: nominal(), knots, float: load_of(40.0) };
        let (mut world, mut devices) = bench(&config, carriage);
        let (truth, m0, found) = observed(&mut world, &mut devices, 1.0);
        let force = m0 * 4.0 / 65535.0;
        assert!((force / truth.finger_normal_n - 1.0).abs() < 0.01, "{force}");
        // The sensor's x is opposite to x0; the pin is where the scene puts it.
        let column = |mm: f64| 8.5 + mm / (1e3 * ArrayGeometry::THESIS.pitch_x_m);
        let (dx, dy) = ((found.x_c.unwrap() - column(-x_mm)), (found.y_c.unwrap() - column(y_mm)));
        let off_mm = 1e3 * ArrayGeometry::THESIS.pitch_x_m * dx.abs().max(dy.abs());
        assert!(off_mm < 0.02, "centroid off by {off_mm} mm");
        let theta = found.theta_z_rad.unwrap() - truth.pin_yaw_rad;
        assert!(theta.abs().to_degrees() < 0.2, "{theta}");
        assert!(world.statistics().spatial_solutions > 100);
    }
}

#[test]
fn parts_that_are_not_named_are_not_computed() {
    let mut config = WorldConfig::default();
    config.pin.present = false;
    let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(-0.1))], float: None };
    let (mut world, _devices) = bench(&config, carriage.clone());
    world.advance(seconds(1.0));
    let work = world.statistics();
    assert_eq!(
        (work.contact_evaluations, work.tactile_images, work.spatial_solutions),
        (0, 0, 0),
        "{work:?}"
    );
    config.pin.present = true;
    let (mut world, _devices) = bench(&config, carriage);
    world.advance(seconds(1.0));
    assert!(
        world.statistics().contact_evaluations > 0 && world.statistics().spatial_solutions == 0,
        "{:?}",
        world.statistics()
    );
}
