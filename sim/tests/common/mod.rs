//! Helpers that the tests of the bench share: fingers on rails and their motions.
#![allow(dead_code, unreachable_pub, reason = "every test file uses a part of it")]

use glam::{DMat3, DVec3};
use taktil_hal::{Devices, Nanos};
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_sim::{
    ArrayGeometry, Carriage, FloatingGuide, Timing, Truth, World, WorldConfig, build_with_carriage,
};

/// Sensor axes of the nominal rolling pose.
pub fn nominal() -> DMat3 {
    DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z)
}

/// The finger over the middle of the default table at a height (m).
pub fn over(z: f64) -> DVec3 {
    DVec3::new(0.325, -0.127, z)
}

/// Height at which an unpressed finger parallel to the table just meets the pin (m).
pub fn meeting_height(config: &WorldConfig) -> f64 {
    let slope = libm::cos(config.table.tilt_y_deg.to_radians());
    1e-3 * (config.table_height_mm() + 2.0 * config.pin.radius_mm / slope)
}

pub fn load_of(load_n: f64) -> Option<FloatingGuide> {
    Some(FloatingGuide { mass_kg: 1.0, load_n, damping_n_s_m: 200.0 })
}

pub fn bench(config: &WorldConfig, carriage: Carriage) -> (World, Devices) {
    build_with_carriage(config, &Timing::default(), 1, carriage).expect("the scene is sound")
}

pub fn seconds(s: f64) -> Nanos {
    Nanos((s * 1e9).round() as i64)
}

pub fn at(world: &mut World, t_s: f64) -> Truth {
    world.advance(seconds(t_s));
    world.truth()
}

/// Presses with 15 N for half a second, then moves the finger by `dx` (m) in two seconds and waits.
/// Returns the truth before and after.
pub fn stroke(config: &WorldConfig, axes: DMat3, dx: f64) -> (Truth, Truth) {
    let z = meeting_height(config) + 1e-4;
    let knots = vec![(0.5, over(z)), (2.5, over(z) + DVec3::new(dx, 0.0, 0.0))];
    let (mut world, _devices) = bench(config, Carriage { axes, knots, float: load_of(15.0) });
    (at(&mut world, 0.5), at(&mut world, 3.0))
}

/// Motion of the contact over the pad (m).
pub fn contact_travel(before: &Truth, after: &Truth) -> f64 {
    let x = |t: &Truth| t.contact_x_tactels.expect("finger and pin touch");
    (x(after) - x(before)) * ArrayGeometry::THESIS.pitch_x_m
}

/// Joint angles (deg) with the tool lowered by `mm` from home.
pub fn lowered(mm: f64) -> [f64; 6] {
    let home_deg = WorldConfig::default().arm.home_deg;
    let puma = Puma260::reference();
    let home = Joints::from_fn(|i, _| home_deg[i].to_radians());
    let start = puma.tool_pose(&home);
    let mut q = home;
    for _ in 0..20 {
        let pose = puma.tool_pose(&q);
        let mut miss = start.translation - pose.translation;
        miss.z -= 1e-3 * mm;
        let turn = 0.5
            * (pose.rotation.x_axis.cross(start.rotation.x_axis)
                + pose.rotation.y_axis.cross(start.rotation.y_axis)
                + pose.rotation.z_axis.cross(start.rotation.z_axis));
        let wanted = taktil_mechanics::spatial::spatial_vector(miss, turn);
        q += puma.jacobian_base(&q).lu().solve(&wanted).unwrap();
    }
    core::array::from_fn(|i| q[i].to_degrees())
}
