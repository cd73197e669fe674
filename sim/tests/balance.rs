//! Checks that forces balance, that nothing pulls, that no energy is created, and that steps
//! converge.

mod common;

use common::{at, bench, load_of, meeting_height, nominal, over, seconds, stroke};
use glam::DVec3;
use taktil_sim::fidelity::Integrator;
use taktil_sim::scene::{Axis, Motion};
use taktil_sim::{Carriage, WorldConfig};

const GRAVITY_M_S2: f64 = 9.81;

fn lifted() -> Carriage {
    Carriage { axes: nominal(), knots: vec![(0.0, over(-0.1))], float: None }
}

#[test]
fn a_pin_at_rest_stays_and_the_table_carries_its_weight() {
    let mut config = WorldConfig::default();
    config.pin.fixture = false;
    let (mut world, _devices) = bench(&config, lifted());
    let before = world.truth();
    for i in 1..=100 {
        let truth = at(&mut world, 0.01 * f64::from(i));
        let weight = config.pin.mass_kg * GRAVITY_M_S2;
        assert!((truth.table_normal_n / weight - 1.0).abs() < 1e-6, "{}", truth.table_normal_n);
        assert!((truth.pin - before.pin).length() < 1e-9);
        assert!(truth.pin_velocity.length() < 1e-9 && truth.pin_roll_rad.abs() < 1e-9);
    }
}

#[test]
fn pressing_and_lifting_never_pulls_and_leaves_nothing() {
    let config = WorldConfig::default();
    let z = meeting_height(&config);
    let knots = vec![
        (0.0, over(z + 1e-3)),
        (0.5, over(z - 2e-4)),
        (0.6, over(z - 2e-4)),
        (0.7, over(z + 5e-3)),
    ];
    let (mut world, _devices) = bench(&config, Carriage { axes: nominal(), knots, float: None });
    let mut most = 0.0_f64;
    for i in 1..=1000 {
        let truth = at(&mut world, 1.25e-3 * f64::from(i));
        assert!(truth.finger_normal_n >= 0.0 && truth.table_normal_n >= 0.0);
        assert!(truth.tool_wrench[2] <= 0.0, "the pin pushes the finger back along -z_s");
        assert_eq!(truth.in_contact, truth.finger_normal_n > 0.0);
        most = most.max(truth.finger_normal_n);
    }
    assert!(most > 5.0, "{most}");
    let end = world.truth();
    assert_eq!((end.finger_normal_n, end.contact_x_tactels), (0.0, None));
    assert!((end.table_normal_n / (config.pin.mass_kg * GRAVITY_M_S2) - 1.0).abs() < 1e-6);
}

#[test]
fn under_load_the_table_carries_finger_and_pin() {
    let config = WorldConfig::default();
    let z = meeting_height(&config) + 1e-4;
    let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(z))], float: load_of(15.0) };
    let (mut world, _devices) = bench(&config, carriage);
    let truth = at(&mut world, 2.0);
    assert!((truth.finger_normal_n - 15.0).abs() < 1e-6, "{}", truth.finger_normal_n);
    assert!((truth.table_normal_n - 15.0 - config.pin.mass_kg * GRAVITY_M_S2).abs() < 1e-6);
    assert!((truth.tool_wrench[2] + 15.0).abs() < 1e-6, "{}", truth.tool_wrench);
    assert!(!truth.fixture_active && truth.released.is_some());
    assert!(!truth.beyond_small_strain);
}

#[test]
fn a_dropped_pin_bounces_lower_and_lower() {
    for relaxation_ms in [0.0, 0.3] {
        let mut config = WorldConfig::default();
        config.pin.fixture = false;
        config.table.rubber.relaxation_ms = relaxation_ms;
        // The table falls away in an instant and the pin drops on it.
        config.table.motion = vec![Motion::ramp(Axis::Height, -1000.0, 0.0, 0.002)];
        let (mut world, _devices) = bench(&config, lifted());
        let (start, mut falling, mut tops) = (world.truth().pin.z, true, Vec::new());
        for i in 1..4000 {
            let truth = at(&mut world, 5e-4 * f64::from(i));
            let up = truth.pin_velocity.z > 0.0;
            if falling && up {
                falling = false;
            } else if !falling && !up {
                falling = true;
                tops.push(start - truth.pin.z);
            }
        }
        assert!(tops.len() > 5, "it bounces: {tops:?}");
        if relaxation_ms > 0.0 {
            assert!(tops.windows(2).all(|two| two[1] >= two[0]), "lower and lower: {tops:?}");
        } else {
            // Without damping each bounce keeps the energy to the order of the scheme, and the
            // errors do not add up: 3 % of the 2 mm drop over some fifty bounces.
            assert!(tops.iter().all(|depth| *depth > -6e-5), "{tops:?}");
        }
    }
}

#[test]
fn a_rolling_pin_left_alone_does_not_speed_up() {
    // The table tilts, the pin starts to roll, the table is level again.
    let tilt = |rate, from_s| Motion::ramp(Axis::TiltY, rate, from_s, from_s + 0.1);
    let mut config = WorldConfig::default();
    config.pin.fixture = false;
    config.table.motion = vec![tilt(50.0, 0.1), tilt(-50.0, 0.5)];
    let (mut world, _devices) = bench(&config, lifted());
    let start = at(&mut world, 0.8);
    assert!(start.pin_velocity.x < -0.05, "it rolls: {}", start.pin_velocity);
    let rim = start.pin_velocity.x * 0.8;
    let mut energy = f64::MAX;
    for i in 0..60 {
        at(&mut world, 0.8 + 0.05 * f64::from(i));
        let now = world.energy_j();
        assert!(now <= energy + 1e-9, "{energy} grew to {now}");
        energy = now;
    }
    // The rubber dissipates little of the energy.
    assert!(world.truth().pin_velocity.x < rim, "{}", world.truth().pin_velocity);
}

#[test]
fn steps_converge_with_the_order_of_their_integrator() {
    let run = |integrator, substep_us: f64| {
        let mut config = WorldConfig { substep_us, ..WorldConfig::default() };
        config.fidelity.integrator = integrator;
        let z = meeting_height(&config) + 1e-4;
        let knots = vec![(0.05, over(z)), (0.25, over(z) + DVec3::new(0.004, 0.0, 0.0))];
        let (mut world, _devices) =
            bench(&config, Carriage { axes: nominal(), knots, float: load_of(15.0) });
        world.advance(seconds(0.15));
        world.truth()
    };
    let exact = run(Integrator::Implicit, 10.0);
    let errors = |integrator, steps_us: [f64; 3]| {
        steps_us.map(|us| {
            let truth = run(integrator, us);
            let place = (truth.pin - exact.pin).length();
            (place, (truth.finger_normal_n - exact.finger_normal_n).abs())
        })
    };
    let euler = errors(Integrator::Euler, [80.0, 40.0, 20.0]);
    println!("euler at 80, 40, 20 us: place (m), force (N) {euler:?}");
    for pair in euler.windows(2) {
        assert!((1.6..2.8).contains(&(pair[0].0 / pair[1].0)), "place: {euler:?}");
    }
    assert!(euler[0].0 < 2e-6 && euler[0].1 < 1e-6, "{euler:?}");
    let implicit = errors(Integrator::Implicit, [1250.0, 625.0, 312.5]);
    println!("implicit at 1250, 625, 312.5 us: place (m), force (N) {implicit:?}");
    assert!(implicit[1].0 < 1e-7 && implicit[1].1 < 1e-4, "{implicit:?}");
}

#[test]
fn tangential_forces_stay_inside_the_cone() {
    let mut config = WorldConfig::default();
    config.finger.friction = 0.02;
    let (_, after) = stroke(&config, nominal(), 0.006);
    let (across, along) = after.finger_tangential_n;
    let size = (across * across + along * along).sqrt();
    assert!(size <= 0.02 * after.finger_normal_n * (1.0 + 1e-12), "{size}");
}

#[test]
fn the_fixture_holds_the_pin_on_a_slope_until_the_finger_presses() {
    let mut config = WorldConfig::default();
    config.table.tilt_y_deg = 8.0;
    let (mut world, _devices) = bench(&config, lifted());
    let (before, after) = (world.truth(), at(&mut world, 1.0));
    assert!(after.fixture_active && (after.pin - before.pin).length() < 1e-3);
    config.pin.fixture = false;
    let (mut world, _devices) = bench(&config, lifted());
    let after = at(&mut world, 0.5);
    assert!(after.pin.x < before.pin.x - 0.05, "it rolls down: {}", after.pin.x - before.pin.x);
    let due = 0.5 * (2.0 / 3.0) * GRAVITY_M_S2 * libm::sin(8.0_f64.to_radians()) * 0.25;
    let way = (after.pin - before.pin).length();
    assert!((way / due - 1.0).abs() < 0.02, "a solid cylinder rolls with 2/3 g sin: {way} {due}");
}

#[test]
fn violent_motions_stay_finite() {
    let config = WorldConfig::default();
    let z = meeting_height(&config);
    let knots = vec![
        (0.05, over(z + 0.02)),
        (0.10, over(z - 0.02)),
        (0.15, over(z - 0.02) + DVec3::new(0.05, 0.05, 0.0)),
        (0.20, over(z + 0.1)),
    ];
    let (mut world, _devices) = bench(&config, Carriage { axes: nominal(), knots, float: None });
    let mut deep = false;
    for i in 1..=300 {
        let truth = at(&mut world, 1e-3 * f64::from(i));
        deep |= truth.beyond_small_strain;
        assert!(
            truth.pin.is_finite() && truth.pin_velocity.is_finite() && truth.pin_axis.is_finite()
        );
        assert!(truth.finger_normal_n.is_finite() && world.energy_j().is_finite());
    }
    assert!(deep, "it says that the theory was left");
}
