//! Checks that rolling, slipping and climbing result from the contact forces: ratios and slopes
//! follow from geometry.

mod common;

use common::{at, bench, contact_travel, load_of, meeting_height, nominal, over, stroke};
use glam::{DMat3, DVec3};
use taktil_mechanics::spatial::{rotation_x, rotation_y, rotation_z};
use taktil_sim::scene::{Axis, Motion};
use taktil_sim::{Carriage, WorldConfig};

fn tilted(deg: f64) -> WorldConfig {
    let mut config = WorldConfig::default();
    config.table.tilt_y_deg = deg;
    config
}

#[test]
fn the_finger_travels_twice_the_contact() {
    for radius_mm in [15.0, 23.0, 35.0] {
        let mut config = WorldConfig::default();
        config.pin.radius_mm = radius_mm;
        let (before, after) = stroke(&config, nominal(), 0.020);
        // The contact line moves back over the finger, towards -x0, which is +x of the sensor.
        let ratio = (after.tool.x - before.tool.x) / contact_travel(&before, &after);
        println!("radius {radius_mm} mm: ratio {ratio:.4}");
        assert!((ratio - 2.0).abs() < 0.02, "radius {radius_mm}: {ratio}");
        let roll = after.pin_roll_rad - before.pin_roll_rad;
        let pin = after.pin.x - before.pin.x;
        assert!((pin - 0.010).abs() < 1e-4, "the pin went {pin}");
        assert!((roll * 1e-3 * radius_mm - pin).abs() < 1e-4, "rolled {roll} rad");
        assert_eq!((after.finger_slip_m_s, after.table_slip_m_s), (0.0, 0.0));
        assert!((after.finger_normal_n - 15.0).abs() < 0.05, "{}", after.finger_normal_n);
    }
}

#[test]
fn without_friction_the_pin_stays_and_the_finger_slides() {
    let mut config = WorldConfig::default();
    (config.finger.friction, config.table.friction) = (0.0, 0.0);
    let (before, after) = stroke(&config, nominal(), 0.008);
    let ratio = (after.tool.x - before.tool.x) / contact_travel(&before, &after);
    println!("no friction: ratio {ratio:.4}");
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    assert!(after.pin_roll_rad.abs() < 1e-9 && (after.pin.x - before.pin.x).abs() < 1e-6);
}

#[test]
fn a_little_friction_on_one_side_makes_the_pin_slip_there() {
    let mut config = WorldConfig::default();
    (config.finger.friction, config.table.friction) = (0.0, 0.8);
    let (before, after) = stroke(&config, nominal(), 0.008);
    let ratio = (after.tool.x - before.tool.x) / contact_travel(&before, &after);
    assert!((ratio - 1.0).abs() < 0.02, "a slippery finger cannot roll the pin: {ratio}");
}

#[test]
fn a_finger_parallel_to_a_tilted_table_climbs_with_its_slope() {
    for deg in [-8.0, 4.0, 8.0_f64] {
        let axes = rotation_y(-deg.to_radians()) * nominal();
        // The contact starts R tan(tilt) off the pad's middle, so that a longer stroke would leave
        // the pad.
        let (before, after) = stroke(&tilted(deg), axes, 0.014);
        let slope = (after.tool.z - before.tool.z) / (after.tool.x - before.tool.x);
        let due = libm::tan(deg.to_radians());
        println!("parallel, {deg} deg: slope {slope:.5}, tan {due:.5}");
        assert!((slope / due - 1.0).abs() < 0.02, "{deg} deg: {slope}, {due}");
    }
}

#[test]
fn a_level_finger_on_a_tilted_table_climbs_with_half_the_angle() {
    for deg in [4.0, 8.0_f64] {
        let (before, after) = stroke(&tilted(deg), nominal(), 0.020);
        let slope = (after.tool.z - before.tool.z) / (after.tool.x - before.tool.x);
        let due = libm::tan(0.5 * deg.to_radians());
        println!("level, {deg} deg: slope {slope:.5}, tan of half {due:.5}");
        assert!((slope / due - 1.0).abs() < 0.05, "{deg} deg: {slope}, {due}");
    }
}

#[test]
fn strokes_there_and_back_return_the_pin() {
    let config = WorldConfig::default();
    let z = meeting_height(&config) + 1e-4;
    let knots = vec![
        (0.5, over(z)),
        (2.0, over(z) + DVec3::new(0.015, 0.0, 0.0)),
        (5.0, over(z) - DVec3::new(0.015, 0.0, 0.0)),
        (6.5, over(z)),
    ];
    let (mut world, _devices) =
        bench(&config, Carriage { axes: nominal(), knots, float: load_of(15.0) });
    let (before, after) = (at(&mut world, 0.5), at(&mut world, 7.0));
    assert!((after.pin - before.pin).length() < 5e-5, "{} {}", before.pin, after.pin);
    assert!(after.pin_yaw_rad.abs() < 1e-6, "{}", after.pin_yaw_rad);
}

#[test]
fn a_table_that_slides_or_rises_carries_the_pin() {
    let slide = |axis, rate| {
        let mut config = WorldConfig::default();
        config.table.motion = vec![Motion::ramp(axis, rate, 1.0, 2.0)];
        let z = meeting_height(&config) + 1e-4;
        let knots = vec![(0.0, over(z))];
        let carriage = Carriage { axes: nominal(), knots, float: load_of(15.0) };
        let (mut world, _devices) = bench(&config, carriage);
        (at(&mut world, 1.0), at(&mut world, 2.5))
    };
    let (before, after) = slide(Axis::Slide, 10.0);
    let moved = after.pin.x - before.pin.x;
    assert!((moved - 0.005).abs() < 1e-4, "table 10 mm, finger fixed: pin {moved}");
    let (before, after) = slide(Axis::Height, 3.0);
    let moved = after.tool.z - before.tool.z;
    assert!((moved - 0.003).abs() < 1e-5, "finger rises with the table: {moved}");
}

#[test]
fn yaw_and_tilt_have_the_stated_signs() {
    let mut config = WorldConfig::default();
    config.pin.yaw_deg = 3.0;
    let z = meeting_height(&config) + 1e-4;
    let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(z))], float: load_of(15.0) };
    let (mut world, _devices) = bench(&config, carriage);
    let truth = at(&mut world, 1.0);
    // x_s = -x0 mirrors angles: turned by +3 deg about z0, the axis is at -3 deg about z_s = -z0.
    assert!((truth.pin_yaw_rad + 3.0_f64.to_radians()).abs() < 1e-3, "{}", truth.pin_yaw_rad);

    let axes = nominal() * rotation_x(0.2_f64.to_radians());
    let config = WorldConfig::default();
    let carriage = Carriage { axes, knots: vec![(0.0, over(z))], float: load_of(15.0) };
    let (mut world, _devices) = bench(&config, carriage);
    let truth = at(&mut world, 1.0);
    assert!(truth.tilt_rad > 0.5 * 0.2_f64.to_radians(), "{}", truth.tilt_rad);
    // Rows of high number are at +y_s = +y0; when they are pressed more, the moment about x_s is
    // negative.
    assert!(truth.tool_wrench[3] < -0.01, "{}", truth.tool_wrench);
}

#[test]
fn a_finger_that_turns_about_its_axis_turns_the_pin_by_friction_alone() {
    let yaw = |friction: f64| {
        let mut config = WorldConfig::default();
        // The finger alone acts on the pin: the table is slippery, the pin starts turned by 5 deg.
        (config.finger.friction, config.table.friction) = (friction, 0.0);
        config.pin.fixture = false;
        config.pin.yaw_deg = 5.0;
        config.table.motion = Vec::new();
        let z = meeting_height(&config) + 1e-4;
        let knots = vec![(0.5, over(z)), (2.0, over(z) + DVec3::new(0.0, 0.003, 0.0))];
        let carriage = Carriage { axes: nominal(), knots, float: load_of(15.0) };
        let (mut world, _devices) = bench(&config, carriage);
        let (before, after) = (at(&mut world, 0.5), at(&mut world, 2.5));
        after.pin.y - before.pin.y
    };
    assert!((yaw(0.8) - 0.003).abs() < 2e-4, "dragged along its axis: {}", yaw(0.8));
    assert!(yaw(0.0).abs() < 1e-6, "left behind: {}", yaw(0.0));
}

#[test]
fn a_pressed_pin_on_a_panned_table_is_torn_between_table_and_finger() {
    let turned = |friction: f64| {
        let mut config = WorldConfig::default();
        config.finger.friction = friction;
        config.table.motion = vec![Motion::ramp(Axis::Pan, 2.0, 0.5, 1.5)];
        let z = meeting_height(&config) + 1e-4;
        let knots = vec![(0.0, over(z))];
        let carriage = Carriage { axes: nominal(), knots, float: load_of(15.0) };
        let (mut world, _devices) = bench(&config, carriage);
        let truth = at(&mut world, 2.0);
        (-truth.pin_yaw_rad.to_degrees(), truth.tool_wrench[5])
    };
    let ((free, no_moment), (held, moment)) = (turned(0.0), turned(0.8));
    println!("panned by 2 deg: pin {free:.3} deg on its own, {held:.3} deg held, {moment:.4} N m");
    assert!((free - 2.0).abs() < 0.02 && no_moment.abs() < 1e-6, "{free} {no_moment}");
    assert!(held < 1.98 && held > 0.2, "{held}");
    // The pin turns the finger along with the table, about +z0, which is -z_s.
    assert!(moment < -1e-3, "{moment}");
}

#[test]
fn a_panned_table_turns_a_pin_that_is_not_pressed() {
    let mut config = WorldConfig::default();
    config.table.motion = vec![Motion::ramp(Axis::Pan, 5.0, 0.5, 2.5)];
    let carriage = Carriage { axes: nominal(), knots: vec![(0.0, over(-0.1))], float: None };
    let (mut world, _devices) = bench(&config, carriage);
    let truth = at(&mut world, 3.5);
    let due = rotation_z(10.0_f64.to_radians()).y_axis;
    assert!((truth.pin_axis - due).length() < 1e-3, "{} {due}", truth.pin_axis);
    assert_eq!(DMat3::IDENTITY.y_axis, DVec3::Y);
}
