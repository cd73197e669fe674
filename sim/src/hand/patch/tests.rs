//! Tests of one contact: its derivative, its limits, its image.

use super::*;
use crate::scene::WorldConfig;
use glam::{DMat3, DVec3};

fn pad(solid: &Solid) -> Pad {
    let rubber = WorldConfig::default().finger.rubber;
    let law = Foundation::new(&rubber, solid).unwrap();
    Pad { array: ArrayGeometry::THESIS, law, friction: 0.8 }
}

fn at(height_m: f64, twist: [f64; 6]) -> Relative {
    let pose = Pose::new(DMat3::IDENTITY, DVec3::new(0.001, -0.002, height_m));
    Relative { pose, twist: Joints::from(twist), h: 1e-3 }
}

/// Wrench after a step with this twist, from a place before it.
fn stepped(pad: &Pad, solid: &Solid, height_m: f64, twist: [f64; 6], from: &Bristle) -> Joints {
    let mut relative = at(height_m, twist);
    let h = relative.h;
    let (v, w) = (DVec3::new(twist[0], twist[1], twist[2]), DVec3::from_slice(&twist[3..]));
    let turn = taktil_mechanics::spatial::rotation_from_vector(h * w);
    relative.pose.translation = turn * relative.pose.translation + h * v;
    relative.pose.rotation = turn * relative.pose.rotation;
    pad.evaluate(solid, &relative, from).wrench
}

#[test]
fn the_derivative_is_that_of_the_wrench_while_it_sticks_and_while_it_slides() {
    let solid = Solid::Cuboid { half_m: DVec3::new(0.03, 0.03, 0.02) };
    let pad = pad(&solid);
    let height = 0.02 - 30e-6;
    for (bristle, slides) in
        [(Bristle::new(1.0, -0.5, 0.002), false), (Bristle::new(5000.0, -3000.0, 4.0), true)]
    {
        let base = [1e-4, 2e-4, -1e-4, 1e-3, -2e-3, 1e-3];
        let load = pad.evaluate(&solid, &at(height, base), &bristle);
        assert_eq!(load.effort > 1.0, slides, "{}", load.effort);
        let stated = load.derivative;
        for i in 0..6 {
            let step = if i < 3 { 1e-6 } else { 1e-5 };
            let (mut up, mut down) = (base, base);
            up[i] += step;
            down[i] -= step;
            let rise = (stepped(&pad, &solid, height, up, &bristle)
                - stepped(&pad, &solid, height, down, &bristle))
                / (2.0 * step);
            let scale = stated.column(i).norm();
            let off = (rise - stated.column(i)).norm() / scale;
            // Turns of the force with the pad are left out of the derivative, and so is how
            // the middle of the load moves.
            assert!(off < 0.05, "{slides} {i}: {off} {rise} {}", stated.column(i));
        }
    }
}

#[test]
fn friction_bears_no_more_than_its_limit_and_nothing_without_load() {
    let solid = Solid::Sphere { radius_m: 0.02 };
    let pad = pad(&solid);
    let free = pad.evaluate(&solid, &at(0.021, [0.1; 6]), &Bristle::new(9.0, 9.0, 9.0));
    assert_eq!((free.normal_n, free.bristle), (0.0, Bristle::zeros()));
    let pressed =
        pad.evaluate(&solid, &at(0.0199, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), &Bristle::zeros());
    let shear = pressed.wrench.fixed_rows::<2>(0).norm();
    assert!(pressed.normal_n > 1.0 && pressed.effort > 1.0);
    assert!((shear / (0.8 * pressed.normal_n) - 1.0).abs() < 1e-9, "{shear}");
    assert!(pressed.wrench[0] < 0.0 && pressed.slip_m_s == 1.0);
}

#[test]
fn an_image_has_the_load_and_the_middle_of_the_contact() {
    for solid in
        [Solid::Sphere { radius_m: 0.02 }, Solid::Cylinder { radius_m: 0.02, half_length_m: 0.02 }]
    {
        let (pad, relative) = (pad(&solid), at(0.0199, [0.0; 6]));
        let load = pad.evaluate(&solid, &relative, &Bristle::zeros());
        let mut forces = vec![1.0; 256];
        pad.image(&solid, &relative, &mut forces);
        let sum: f64 = forces.iter().sum();
        assert!((sum - load.normal_n).abs() < 1e-12 * sum, "{sum}");
        assert!(load.normal_n > 0.0 || matches!(solid, Solid::Cylinder { .. }));
    }
}

#[test]
fn a_load_hardly_depends_on_where_it_lies_among_the_tactels() {
    let upright = taktil_mechanics::spatial::rotation_x(core::f64::consts::FRAC_PI_2);
    for (solid, most) in [
        (Solid::Sphere { radius_m: 0.02 }, 1e-9),
        (Solid::Cylinder { radius_m: 0.02, half_length_m: 0.03 }, 1e-9),
    ] {
        let pad = pad(&solid);
        let (mut least, mut largest) = (f64::INFINITY, 0.0_f64);
        for i in 0..16 {
            let mut relative = at(0.0199, [0.0; 6]);
            relative.pose.rotation = upright;
            relative.pose.translation.z = 0.02 - 20e-6;
            relative.pose.translation.x += 1e-4 * f64::from(i);
            let load = pad.evaluate(&solid, &relative, &Bristle::zeros()).normal_n;
            (least, largest) = (least.min(load), largest.max(load));
        }
        let ripple = largest / least - 1.0;
        println!("ripple of {solid:?}: {:.2} % of {least:.2} N", 100.0 * ripple);
        assert!(ripple < most, "{least} {largest}");
    }
}

#[test]
fn numbers_that_are_none_press_nothing() {
    let solid = Solid::Sphere { radius_m: 0.02 };
    let pad = pad(&solid);
    let load = pad.evaluate(&solid, &at(f64::NAN, [0.0; 6]), &Bristle::zeros());
    assert_eq!(load.normal_n, 0.0);
}
