//! Tests a pin between two pads with the contact model of the simulator's pads. The Jacobian is
//! compared with differences of the features.

use glam::{DMat3, DVec3};
use nalgebra::{Matrix4, Vector4};
use taktil_contact::cylinder::LineContact;
use taktil_contact::layer::Layer;
use taktil_mechanics::Pose;
use taktil_signal::TactileImage;

use super::*;
use crate::law::model::jacobian::{ContactModel, displacement};
use crate::perception::line::{LineParameters, LoadProfile, line};
use crate::perception::touch_features;

const PITCH_MM: f64 = 1.5875;
const M0_COUNTS: f64 = 15_000.0;
const COUNTS_PER_N: f64 = 4095.0 / 4.0;

fn pad(thickness_mm: f64, mpa: f64) -> LineContact {
    LineContact::new(&Layer::new(thickness_mm, mpa, 0.49).unwrap(), 23.0, 0.2 * thickness_mm)
        .unwrap()
}

/// Even load of 15000 counts at column 8.5 with the pin turned by `theta` on the sensor.
fn even(theta: f64) -> Line {
    Line {
        features: [8.5, M0_COUNTS, 0.0, theta],
        variance: [1e-3, 2e5, 4e6, 1e-4],
        weighted: [M0_COUNTS, 0.0],
        weighted_variance: [2e5, 4e6],
        y_c: 8.5,
        rows: [M0_COUNTS / 16.0; 64],
        saturated: 0,
        interpolated: 0,
    }
}

/// The finger over an opposed fingertip that looks up, turned by `yaw` about z0.
fn over(yaw: f64) -> Pose {
    let down = DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z);
    Pose::new(DMat3::from_rotation_z(yaw) * down, DVec3::new(0.3, -0.1, 0.0))
}

/// Counts of `newton` under a pin at `column`.
fn pressed(contact: &LineContact, newton: f64, column: f64) -> [f64; 16] {
    let shares = contact.base_shares(contact.penetration_mm(newton / (16.0 * PITCH_MM)));
    core::array::from_fn(|col| {
        let from = (col as f64 + 0.5 - column) * PITCH_MM;
        newton * COUNTS_PER_N * (shares.left_of(from + PITCH_MM) - shares.left_of(from))
    })
}

#[test]
fn the_squeeze_is_read_wherever_the_pin_is_and_wherever_its_weight_lay() {
    let (config, thick) = (Config::default(), pad(3.0, 0.6));
    let opposed = OpposedFingertip { pin_weight_n: 2.0, ..OpposedFingertip::default() };
    let sight = ArrayResponse::new(&opposed, &config.model, M0_COUNTS).unwrap();
    let untold =
        ArrayResponse::new(&OpposedFingertip::default(), &config.model, M0_COUNTS).unwrap();
    let squeeze_n = M0_COUNTS / COUNTS_PER_N;
    for lay in [4.0, 8.5, 13.3] {
        for place in 0..27 {
            let column = 2.0 + 0.5 * f64::from(place);
            let load = pressed(&thick, squeeze_n + 2.0, column);
            let rest = pressed(&thick, 2.0, lay);
            let mut image = TactileImage {
                valid: vec![1; 256].into(),
                baseline_ready: 1,
                ..TactileImage::new(16, 16)
            };
            for (i, counts) in image.counts.iter_mut().enumerate() {
                *counts = ((load[i % 16] - rest[i % 16]) / 16.0) as f32;
            }
            let known = LineParameters {
                profile: LoadProfile::EVEN_LOAD,
                noise_counts: 5.0,
                speed_cols_s: 0.0,
            };
            let plain = line(
                &image,
                &config.array,
                &touch_features(&image, &config.array, 15.0, 1000.0),
                &known,
            )
            .unwrap();
            let found = sight.squeezing_line(&plain, lay).features[1];
            // At the array's end the line itself is drawn inwards.
            let bound = if (2.5..=14.5).contains(&column) { 0.05 } else { 0.06 };
            assert!((found - M0_COUNTS).abs() < bound * M0_COUNTS, "{column} on {lay}: {found}");
            if (column - lay).abs() > 4.5 && (3.0..=14.0).contains(&column) {
                let found = untold.squeezing_line(&plain, lay).features[1];
                assert!(found > 1.08 * M0_COUNTS, "the weight untold, {column} on {lay}: {found}");
            }
        }
    }
}

/// Features M0 and M_x of both pads with the finger `z` mm down and turned by `tilt` mrad: pin and
/// finger where their forces and moments balance, on an arm of 20 N/mm and 30 N m/rad.
fn balanced(thin: &LineContact, thick: &LineContact, z: f64, tilt: f64) -> [f64; 4] {
    let arm = (20.0 * COUNTS_PER_N, 30.0 * COUNTS_PER_N / PITCH_MM);
    let arms: [f64; 16] = core::array::from_fn(|row| row as f64 - 7.5);
    let sums = |contact: &LineContact, depth: f64, turn: f64| {
        arms.iter().fold([0.0; 2], |[m0, m_x], y| {
            let depth = (depth + 1e-3 * turn * y * PITCH_MM).max(0.0);
            let counts = contact.load_n_mm(depth) * PITCH_MM * COUNTS_PER_N;
            [m0 + counts, m_x + y * counts]
        })
    };
    // Unknown: how deep the pin is in the other pad (mm), its tilt (mrad), and the finger's give.
    let out = |v: &Vector4<f64>| {
        let own = sums(thin, z - v[2] - v[0], tilt - v[3] - v[1]);
        (own, sums(thick, v[0], v[1]))
    };
    let off = |v: &Vector4<f64>| {
        let (own, other) = out(v);
        Vector4::new(
            own[0] - other[0],
            own[1] - other[1],
            own[0] - arm.0 * v[2],
            own[1] - arm.1 * v[3],
        )
    };
    let mut v = Vector4::new(0.3 * z, 0.0, 0.5 * z, 0.0);
    for _ in 0..60 {
        let now = off(&v);
        let slope = Matrix4::from_fn(|i, j| {
            let mut beside = v;
            beside[j] += 1e-6;
            (off(&beside)[i] - now[i]) / 1e-6
        });
        v -= slope.lu().solve(&now).unwrap() * 0.8;
    }
    let (own, other) = out(&v);
    assert!(off(&v).amax() < 1.0, "{}", off(&v));
    [own[0], own[1], other[0], other[1]]
}

#[test]
fn force_and_moment_of_both_pads_change_as_both_jacobians_say() {
    let (thin, thick) = (pad(0.8, 2.0), pad(3.0, 0.6));
    // Where 15000 counts are borne, and what arm and other pad give there.
    let (mut low, mut high) = (0.0, 5.0);
    for _ in 0..50 {
        let z = 0.5 * (low + high);
        if balanced(&thin, &thick, z, 0.0)[0] < M0_COUNTS { low = z } else { high = z }
    }
    let even_mm = thick.penetration_mm(M0_COUNTS / COUNTS_PER_N / (16.0 * PITCH_MM));
    let step = 1e-4;
    let k = (thick.load_n_mm(even_mm + step) - thick.load_n_mm(even_mm - step)) / (2.0 * step);
    // N/mm, and N m/rad of sixteen rows.
    let other = (16.0 * PITCH_MM * k, PITCH_MM * PITCH_MM * PITCH_MM * 340.0 * k * 1e-3);
    let mut config = Config::default();
    config.model.support_n_mm = 1.0 / (1.0 / 20.0 + 1.0 / other.0);
    config.model.support_nm_rad = 1.0 / (1.0 / 30.0 + 1.0 / other.1);
    let own =
        ContactModel::new(&config.model, &config.array, M0_COUNTS).unwrap().jacobian(&even(0.0));
    let felt = measurement(&OpposedFingertip::default(), &config, &even(0.0), &own, &over(0.0));
    let at = |z: f64, tilt: f64| balanced(&thin, &thick, low + z, tilt);
    let by_z = [0, 1, 2, 3].map(|i| (at(1e-3, 0.0)[i] - at(-1e-3, 0.0)[i]) / 2e-3);
    let by_tilt = [0, 1, 2, 3].map(|i| (at(0.0, 0.1)[i] - at(0.0, -0.1)[i]) / 0.2);
    for (what, jacobian, from) in [("own", &own, 0), ("other", &felt.jacobian, 2)] {
        let (m0, m_x) = (jacobian[(1, 1)], jacobian[(2, 2)]);
        assert!((m0 / by_z[from] - 1.0).abs() < 0.03, "{what}: {m0} and {by_z:?}");
        assert!((m_x / by_tilt[from + 1] - 1.0).abs() < 0.03, "{what}: {m_x} and {by_tilt:?}");
        assert!(jacobian[(1, 2)].abs() < 1e-3 * m_x && by_z[from + 1].abs() < 1e-3 * m0);
    }
}

#[test]
fn a_roll_and_a_turn_of_the_finger_are_seen_by_the_other_as_geometry_has_it() {
    let config = Config::default();
    let own =
        ContactModel::new(&config.model, &config.array, M0_COUNTS).unwrap().jacobian(&even(0.0));
    let opposed = OpposedFingertip { yaw_deg: 10.0, ..OpposedFingertip::default() };
    let x_of_other = DMat3::from_rotation_z(10.0_f64.to_radians()).x_axis;
    let felt = measurement(&opposed, &config, &even(0.0), &own, &over(10.0_f64.to_radians()));
    assert_eq!(felt.error, [0.0, 0.0, 0.0, felt.error[3]]);
    assert!(felt.error[3].abs() < 1e-9, "both look along the pin: {}", felt.error[3]);
    // The pin's middle goes half of the way of the finger, which goes 1 mm along its own x.
    let way = over(10.0_f64.to_radians()).rotation.x_axis;
    let columns = 0.5 * way.dot(x_of_other) / PITCH_MM;
    assert!((felt.jacobian[(0, 0)] - columns).abs() < 1e-12);
    // A pin that lies turned by 20 mrad on the other, to the right hand about z0.
    let pin = even(0.02);
    let theta = |yaw: f64| theta_z_rad(&opposed, &pin, &over(10.0_f64.to_radians() + yaw));
    assert!((theta(0.0) + 0.02).abs() < 1e-9, "the finger looks down: {}", theta(0.0));
    // A turn of the finger about its own z is one against z0.
    let slope = (theta(-1e-3) - theta(1e-3)) / 2e-3;
    assert!((slope - felt.jacobian[(3, 3)]).abs() < 1e-9, "{slope}");
    assert!((theta(core::f64::consts::PI * 2.0) + 0.02).abs() < 1e-9, "a whole turn is none");
}

#[test]
fn two_fingers_say_the_same_with_half_the_variance_and_the_surer_one_more() {
    let config = Config::default();
    let contact = ContactModel::new(&config.model, &config.array, M0_COUNTS).unwrap();
    let found = Line { features: [8.0, 14_000.0, 2_000.0, 0.01], ..even(0.0) };
    let error = [0.5, 1_000.0, -2_000.0, -10.0];
    let mut variance = found.variance;
    variance[3] *= 1e6;
    let one = FeatureMeasurement { jacobian: contact.jacobian(&found), error, variance };
    let (way, spread) = displacement([&one]);
    let (both, halved) = displacement([&one, &one]);
    for i in 0..4 {
        assert!((way[i] - both[i]).abs() < 0.05 * way[i].abs(), "{i}: {way:?} {both:?}");
        assert!((halved[i] / spread[i] - 0.5).abs() < 0.05, "{i}: {spread:?} {halved:?}");
    }
    let blind = FeatureMeasurement {
        error: [-4.0, 9e3, 9e4, 300.0],
        variance: variance.map(|v| 1e9 * v),
        ..one
    };
    let (led, _) = displacement([&one, &blind]);
    for i in 0..4 {
        assert!((way[i] - led[i]).abs() < 1e-3 * way[i].abs() + 1e-6, "{i}: {way:?} {led:?}");
    }
}

#[test]
fn bad_numbers_are_refused_with_their_place() {
    let place = |change: &dyn Fn(&mut OpposedFingertip)| {
        let mut opposed = OpposedFingertip::default();
        change(&mut opposed);
        opposed.check().unwrap_err().place
    };
    assert_eq!(OpposedFingertip::default().check(), Ok(()));
    for bad in [f64::NAN, f64::INFINITY, -200.0] {
        assert_eq!(place(&|o| o.yaw_deg = bad), "yaw_deg");
        assert_eq!(place(&|o| o.pad_mpa = bad), "pad_mpa");
        assert_eq!(place(&|o| o.pin_weight_n = bad), "pin_weight_n");
    }
}
