//! Tests hard cases: the physics may lose accuracy, but it never diverges, pulls, or gives a number
//! that is not finite.

mod common;

use common::{at, bench, load_of, meeting_height, nominal, over};
use glam::DVec3;
use taktil_hal::Nanos;
use taktil_sim::scene::{Axis, Motion};
use taktil_sim::{Carriage, Timing, Truth, World, WorldConfig, build_with_carriage};

/// A carriage that presses with 15 N, rolls the pin by 4 mm and back, and lifts.
fn journey(config: &WorldConfig) -> Carriage {
    let z = meeting_height(config) + 1e-4;
    let dx = DVec3::new(0.004, 0.0, 0.0);
    let knots = vec![(0.3, over(z)), (0.7, over(z) + dx), (1.1, over(z))];
    Carriage { axes: nominal(), knots, float: load_of(15.0) }
}

fn sound(truth: &Truth) {
    let vectors = [truth.pin, truth.pin_velocity, truth.pin_axis, truth.tool, truth.tool_velocity];
    assert!(vectors.iter().all(|v| v.is_finite()), "{truth:?}");
    assert!(truth.tool_wrench.iter().all(|x| x.is_finite()));
    assert!(truth.finger_normal_n >= 0.0 && truth.table_normal_n >= 0.0, "nothing pulls");
    assert!(truth.pin_velocity.length() < 5.0, "it explodes: {}", truth.pin_velocity);
    assert!((truth.pin_axis.length() - 1.0).abs() < 1e-9);
}

/// Runs for a time and checks the truth every millisecond; returns the last truth and the world.
fn watched(config: &WorldConfig, carriage: Carriage, until_s: f64) -> (Truth, World) {
    let (mut world, _devices) = bench(config, carriage);
    for i in 1..=(1000.0 * until_s) as i32 {
        sound(&at(&mut world, 1e-3 * f64::from(i)));
    }
    (world.truth(), world)
}

/// Runs the journey and returns the truth at its turning point.
fn rolls(name: &str, config: &WorldConfig) -> Truth {
    let (_, mut world) = watched(config, journey(config), 0.3);
    let start = world.truth();
    let half = at(&mut world, 0.7);
    sound(&half);
    let moved = (half.pin.x - start.pin.x) / (half.tool.x - start.tool.x);
    let end = at(&mut world, 1.3);
    sound(&end);
    let work = world.statistics();
    println!(
        "{name}: pin/finger {moved:.4}, force {:.4} N, back within {:.1e} m, {} steps, \
         {} halved, {} unsettled, step error {:.1e} m",
        half.finger_normal_n,
        (end.pin - start.pin).length(),
        work.steps,
        work.halved_steps,
        work.unconverged_steps,
        world.step_error_m(),
    );
    assert!((half.finger_normal_n - 15.0).abs() < 0.5, "{name}: {}", half.finger_normal_n);
    half
}

#[test]
fn rubber_a_hundred_times_stiffer_and_softer() {
    for factor in [100.0, 0.01] {
        let mut config = WorldConfig::default();
        config.finger.rubber.youngs_mpa *= factor;
        // The softest that a scene may have is 0.01 MPa.
        config.table.rubber.youngs_mpa = (factor * config.table.rubber.youngs_mpa).max(0.01);
        let truth = rolls(&format!("rubber x {factor}"), &config);
        assert_eq!(truth.beyond_small_strain, factor < 1.0, "and it says when it is too soft");
    }
}

#[test]
fn pins_of_a_gram_and_of_ten_kilograms() {
    for mass_kg in [0.001, 10.0] {
        let mut config = WorldConfig::default();
        config.pin.mass_kg = mass_kg;
        rolls(&format!("pin of {mass_kg} kg"), &config);
    }
}

#[test]
fn a_gram_between_rubbers_a_hundred_times_stiffer() {
    let mut config = WorldConfig::default();
    config.pin.mass_kg = 0.001;
    config.finger.rubber.youngs_mpa *= 100.0;
    config.table.rubber.youngs_mpa *= 100.0;
    rolls("a gram on rubber x 100", &config);
}

#[test]
fn steps_ten_times_longer_degrade_and_do_not_explode() {
    let config = WorldConfig { substep_us: 12_500.0, ..WorldConfig::default() };
    let slow = Timing {
        control_period: Nanos::from_micros(25_000),
        actuation_delay: Nanos::from_micros(12_500),
        scan_period: Nanos::from_micros(50_000),
    };
    let (mut world, _devices) = build_with_carriage(&config, &slow, 1, journey(&config)).unwrap();
    let start = at(&mut world, 0.3);
    let half = at(&mut world, 0.7);
    sound(&half);
    let ratio = (half.pin.x - start.pin.x) / (half.tool.x - start.tool.x);
    println!("12.5 ms steps: pin/finger {ratio:.5}, {:?}", world.statistics());
    assert!((ratio - 0.5).abs() < 5e-3, "{ratio}");
}

#[test]
fn grazing_contact_begins_and_ends_without_a_jump() {
    let config = WorldConfig::default();
    let z = meeting_height(&config);
    // The pin sinks by its weight; the finger passes over at a fiftieth of a micrometre.
    let sunk = {
        let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(-0.1))], float: None };
        let (world, _devices) = bench(&config, carriage);
        world.truth().pin.z + 1e-3 * config.pin.radius_mm
    };
    assert!(sunk < z);
    let dx = DVec3::new(0.01, 0.0, 0.0);
    let knots = vec![(0.0, over(sunk - 2e-8) - dx), (1.0, over(sunk - 2e-8) + dx)];
    let (end, world) = watched(&config, Carriage { axes: nominal(), knots, float: None }, 1.0);
    assert!(end.finger_normal_n < 0.2, "{}", end.finger_normal_n);
    assert_eq!(world.statistics().unconverged_steps, 0);
}

#[test]
fn the_pin_leaves_the_pads_edge_and_is_found_again() {
    let config = WorldConfig::default();
    let z = meeting_height(&config) - 1e-4;
    let away = DVec3::new(0.05, 0.0, 0.0);
    let knots = vec![
        (0.2, over(z + 1e-3)),
        (0.3, over(z)),
        (1.3, over(z) + away),
        (1.5, over(z) + away),
        (2.5, over(z)),
    ];
    let (mut world, _devices) = bench(&config, Carriage { axes: nominal(), knots, float: None });
    let (mut lost, mut held) = (false, false);
    for i in 1..=2700 {
        let truth = at(&mut world, 1e-3 * f64::from(i));
        sound(&truth);
        held |= i < 500 && truth.in_contact;
        lost |= held && !truth.in_contact;
    }
    assert!(held && lost, "pressed {held}, lost {lost}");
}

#[test]
fn a_dropped_pin_comes_to_rest() {
    let mut config = WorldConfig::default();
    config.pin.fixture = false;
    // The table falls away by 20 mm faster than the pin can follow.
    config.table.motion = vec![Motion::ramp(Axis::Height, -1000.0, 0.0, 0.02)];
    let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(-0.1))], float: None };
    let (end, world) = watched(&config, carriage, 3.0);
    let weight = config.pin.mass_kg * 9.81;
    println!("dropped 20 mm: {:?}", world.statistics());
    assert!((end.table_normal_n / weight - 1.0).abs() < 1e-3, "{}", end.table_normal_n);
    assert!(end.pin_velocity.length() < 1e-4, "{}", end.pin_velocity);
}

#[test]
fn a_finger_slammed_down_at_half_a_metre_per_second() {
    let config = WorldConfig::default();
    let z = meeting_height(&config);
    // The smooth start and stop reach 0.5 m/s in the middle, where the finger meets the pin.
    let knots = vec![(0.1, over(z + 2.5e-3)), (0.1 + 1.5 * 5e-3 / 0.5, over(z - 2.5e-3))];
    let (end, world) = watched(&config, Carriage { axes: nominal(), knots, float: None }, 0.5);
    println!("slammed: {:.0} N at the end, {:?}", end.finger_normal_n, world.statistics());
    assert!(end.in_contact && end.beyond_small_strain, "it says that the theory was left");
    let z = meeting_height(&config) + 0.01;
    let knots = vec![(0.1, over(z)), (0.2, over(z))];
    let mut carriage = Carriage { axes: nominal(), knots, float: load_of(15.0) };
    // A finger of 1 kg falls on the pin with 0.5 m/s and bounces.
    carriage.float = carriage.float.map(|f| taktil_sim::FloatingGuide { damping_n_s_m: 5.0, ..f });
    let (end, _) = watched(&config, carriage, 3.0);
    assert!((end.finger_normal_n - 15.0).abs() < 0.1, "{}", end.finger_normal_n);
}

#[test]
fn a_table_shaken_at_twenty_hertz() {
    let mut config = WorldConfig::default();
    // A triangle of 1 mm either way; ramps add up, two for each half period and sixteen in all.
    config.table.motion = (0..16)
        .map(|i| {
            Motion::ramp(
                if i % 2 == 0 { Axis::Slide } else { Axis::Height },
                if (i / 2) % 2 == 0 { 40.0 } else { -40.0 },
                0.5 + 0.025 * f64::from(i / 2),
                0.5 + 0.025 * f64::from(i / 2 + 1),
            )
        })
        .collect();
    let z = meeting_height(&config) + 1e-4;
    let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(z))], float: load_of(15.0) };
    let (end, world) = watched(&config, carriage, 1.5);
    println!("shaken: {:.4} N at the end, {:?}", end.finger_normal_n, world.statistics());
    assert!((end.finger_normal_n - 15.0).abs() < 1e-3 && end.pin.is_finite());
}

#[test]
fn without_any_friction() {
    let mut config = WorldConfig::default();
    (config.finger.friction, config.table.friction) = (0.0, 0.0);
    let (_, mut world) = watched(&config, journey(&config), 0.3);
    let start = world.truth();
    let half = at(&mut world, 0.7);
    sound(&half);
    assert_eq!((half.finger_tangential_n, half.table_tangential_n), ((0.0, 0.0), (0.0, 0.0)));
    assert!((half.pin.x - start.pin.x).abs() < 1e-6, "the pin stays: {}", half.pin.x);
}

#[test]
fn a_disc_that_is_tipped_over_lies_on_the_table() {
    let mut config = WorldConfig::default();
    (config.pin.length_mm, config.pin.mass_kg) = (6.0, 0.02);
    config.pin.fixture = false;
    let z = meeting_height(&config) - 2e-4;
    let along = DVec3::new(0.0, 0.06, 0.0);
    let knots = vec![
        (0.1, over(z + 1e-3)),
        (0.2, over(z)),
        (0.5, over(z) + along),
        (0.6, over(z + 0.05) + along),
    ];
    let (end, _) = watched(&config, Carriage { axes: nominal(), knots, float: None }, 2.0);
    let table_m = 1e-3 * config.table_height_mm();
    assert!(end.pin_axis.z.abs() > 0.9, "it stands: {}", end.pin_axis);
    // The disc is half as thick as it is long, on soft rubber.
    let above = end.pin.z - table_m;
    assert!((0.002..0.006).contains(&above), "{above}");
}
