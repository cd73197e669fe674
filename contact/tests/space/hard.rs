//! Tests cases in which contact solvers tend to fail: incompressible rubber, layers much thinner or
//! thicker than the contact, a single tactel, no contact, indenters beside the array, contact in a
//! point, a thousand contacts made and broken, and numbers that are not finite.

use crate::{layer, max_difference, peak};
use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::infinite::InfiniteIndenter;
use taktil_contact::space::pin::{Pin, PlanarPose, Profile};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::sphere::Sphere;
use taktil_contact::space::surface::{Cells, Surface};
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};

const PIN: Shape = Shape::Cylinder { radius_mm: 23.0, length_mm: Some(20.0) };

fn scene(layer: &Layer, shape: Shape) -> Scene {
    Scene::new(layer, shape, &Array::THESIS, Sampling::Area, Accuracy::Default).unwrap()
}

fn image(scene: &Scene) -> Vec<f64> {
    let mut image = vec![0.0; scene.array().len()];
    scene.image(&mut image).unwrap();
    image
}

#[test]
fn incompressible_rubber_is_the_limit_of_nearly_incompressible_rubber() {
    let press = |nu: f64, shape: Shape, drive: Prescribed| {
        let mut scene = scene(&layer(0.8, nu), shape);
        let touch = scene.press(drive, Pose::default()).unwrap();
        assert!(touch.residual < 1e-3, "nu {nu}: {touch:?}");
        (touch.force_n, touch.penetration_mm.unwrap(), image(&scene))
    };
    let sphere = Shape::Sphere { radius_mm: 10.0 };
    for (shape, drive) in
        [(sphere, Prescribed::ForceN(5.0)), (PIN, Prescribed::PenetrationMm(0.02))]
    {
        let found = [0.4999, 0.499_999, 0.5].map(|nu| press(nu, shape, drive));
        let size = peak(&found[2].2);
        assert!(max_difference(&found[0].2, &found[2].2) < 5e-3 * size, "{shape:?}");
        assert!(max_difference(&found[1].2, &found[2].2) < 5e-5 * size, "{shape:?}");
        assert!((found[1].0 / found[2].0 - 1.0).abs() < 5e-5, "{shape:?}");
        assert!((found[1].1 / found[2].1 - 1.0).abs() < 5e-5, "{shape:?}");
    }
}

#[test]
fn layers_a_hundred_times_thinner_and_thicker_than_the_contact() {
    for nu in [0.3, 0.5] {
        // Contact radius about 1 mm on 0.01 mm of rubber.
        let thin = layer(0.01, nu);
        let mut sphere = Sphere::new(&thin, 200.0, Accuracy::Default).unwrap();
        let state = sphere.press(Prescribed::PenetrationMm(0.0015)).unwrap();
        assert!(state.contact_radius_mm > 75.0 * 0.01, "{state:?}");
        if nu == 0.3 {
            // Compressible and thin: springs of the confined modulus.
            let confined = thin.youngs_mpa * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu));
            let springs = core::f64::consts::PI * 200.0 * 0.0015 * 0.0015 * confined / 0.01;
            assert!((state.force_n / springs - 1.0).abs() < 0.05, "{state:?} {springs}");
        }
        let mut image = vec![0.0; 256];
        sphere.image(&Array::THESIS, Sampling::Area, [0.3, 0.4], &mut image).unwrap();
        let sum = image.iter().sum::<f64>() * 1.5875 * 1.5875;
        assert!((sum / -state.force_n - 1.0).abs() < 1e-5, "{sum} {state:?}");
    }
    for (t, delta) in [(0.02, 0.001), (50.0, 0.05)] {
        let profile = Profile::Cylinder { radius_mm: 200.0 };
        let mut cylinder = InfiniteIndenter::new(&layer(t, 0.49), profile, delta).unwrap();
        let state = cylinder.press(Prescribed::PenetrationMm(0.5 * delta)).unwrap();
        assert!(state.force_n_mm > 0.0 && state.residual < 1e-6, "{state:?}");
        let mut image = vec![0.0; 256];
        let planar = PlanarPose { x_mm: 0.2, y_mm: 0.0, rot_rad: 0.4 };
        cylinder.image(&Array::THESIS, Sampling::Area, planar, &mut image).unwrap();
        assert!(image.iter().all(|value| value.is_finite()));
    }
}

/// Sneddon's force of a rigid sphere on a half-space: delta = a artanh(a/R), F = E/(1 - nu^2) ((a^2
/// + R^2) artanh(a/R) - a R).
fn half_space(rubber: &Layer, radius: f64, delta: f64) -> f64 {
    let (mut low, mut high) = (0.0, 0.9 * radius);
    for _ in 0..100 {
        let a = 0.5 * (low + high);
        if a * libm::atanh(a / radius) < delta {
            low = a;
        } else {
            high = a;
        }
    }
    let modulus = rubber.youngs_mpa / (1.0 - rubber.poisson * rubber.poisson);
    modulus * ((low * low + radius * radius) * libm::atanh(low / radius) - low * radius)
}

/// Coefficient by which a bonded base reduces the displacement under a load, relative to
/// Boussinesq's half space: the integral of 1 - L, L = (2 k sinh 2s - 4 s)/(2 k cosh 2s + 1 + k^2 +
/// 4 s^2), k = 3 - 4 nu.
fn base_displacement_coefficient(nu: f64) -> f64 {
    let k = 3.0 - 4.0 * nu;
    let left = |s: f64| {
        let below = 2.0 * k * libm::cosh(2.0 * s) + 1.0 + k * k + 4.0 * s * s;
        1.0 - (2.0 * k * libm::sinh(2.0 * s) - 4.0 * s) / below
    };
    // Midpoints: the integrand is even and smooth, gone at 20.
    (0..2000).map(|n| 0.01 * left(0.01 * (f64::from(n) + 0.5))).sum()
}

/// The base sees a point load: szz = -F/(2 pi t^2) times the integral of s T(s) J0(s r/t), T the
/// base's transfer function, but for the tactel's and the contact's size, (1 mm/t)^2,
/// and what the level's table leaves of the force, 9e-6.
fn check_far_image(rubber: &Layer, sphere: &Sphere, force: f64) {
    let (t, transfer) = (rubber.thickness_mm, rubber.transfer());
    let mut image = vec![0.0; 256];
    sphere.image(&Array::THESIS, Sampling::Area, [0.0; 2], &mut image).unwrap();
    let point = |r: f64| {
        let part = |n: u32| {
            let s = 0.02 * (f64::from(n) + 0.5);
            s * transfer.base_normal(s) * libm::j0(s * r / t) * 0.02
        };
        -force / (2.0 * core::f64::consts::PI * t * t) * (0..2000).map(part).sum::<f64>()
    };
    for (n, value) in image.iter().enumerate().step_by(17) {
        let wanted = point(libm::hypot(Array::THESIS.x_mm(n % 16), Array::THESIS.y_mm(n / 16)));
        assert!((value / wanted - 1.0).abs() < 3.0 / (t * t) + 1e-5, "{t} {n}: {value} {wanted}");
    }
}

/// On a thick layer the contact of a sphere is that on a half space, except for the effect of the
/// base: it reduces the displacement by c F/(pi E' t) all over the contact, E' = E/(1 - nu^2). The
/// deviation from a constant is of the order (a/t)^3.
#[test]
fn a_layer_far_thicker_than_the_contact_is_a_half_space() {
    let (radius, delta) = (10.0, 0.1);
    for nu in [-0.5, 0.0, 0.3, 0.45, 0.5] {
        let taken = base_displacement_coefficient(nu) / core::f64::consts::PI;
        for thickness in [10.0, 50.0, 100.0, 400.0] {
            let rubber = layer(thickness, nu);
            let mut sphere = Sphere::new(&rubber, radius, Accuracy::Default).unwrap();
            let state = sphere.press(Prescribed::PenetrationMm(delta)).unwrap();
            let modulus = rubber.youngs_mpa / (1.0 - nu * nu);
            let mut wanted = half_space(&rubber, radius, delta);
            for _ in 0..50 {
                let less = taken * wanted / (modulus * thickness);
                wanted = half_space(&rubber, radius, delta + less);
            }
            let (off, part) =
                ((state.force_n / wanted - 1.0).abs(), state.contact_radius_mm / thickness);
            assert!(off < 0.8 * part * part * part + 1e-8, "{nu} {thickness}: {off:e}");
            if thickness >= 50.0 {
                check_far_image(&rubber, &sphere, state.force_n);
            }
        }
    }
}

#[test]
fn a_contact_within_one_tactel_loads_that_tactel() {
    let layer = layer(0.05, 0.49);
    let mut sphere = Sphere::new(&layer, 2.0, Accuracy::Default).unwrap();
    let state = sphere.press(Prescribed::ForceN(0.05)).unwrap();
    assert!(state.contact_radius_mm < 0.2, "{state:?}");
    let place = [Array::THESIS.x_mm(5), Array::THESIS.y_mm(11)];
    let mut image = vec![0.0; 256];
    sphere.image(&Array::THESIS, Sampling::Area, place, &mut image).unwrap();
    let area = 1.5875 * 1.5875;
    assert!((image[11 * 16 + 5] * area + 0.05).abs() < 1e-6);
    assert!(image.iter().enumerate().all(|(n, v)| n == 11 * 16 + 5 || v.abs() * area < 1e-7));
    let one = Array { rows: 1, cols: 1, pitch_mm: 25.4 };
    let mut image = [0.0];
    sphere.image(&one, Sampling::Area, place, &mut image).unwrap();
    assert!((image[0] * 25.4 * 25.4 + 0.05).abs() < 1e-6);
}

/// On a layer thicker than the whole array the tactels measure the same as within a larger array:
/// loads far beside them count.
#[test]
fn tactels_alone_on_a_thick_layer_see_all_that_presses() {
    let (t, pitch_mm) = (10.0, 0.8);
    let cylinder = Shape::Cylinder { radius_mm: 130.0, length_mm: Some(70.0) };
    let edge = Shape::Edge { length_mm: Some(60.0) };
    for (shape, drive) in
        [(cylinder, Prescribed::PenetrationMm(0.5)), (edge, Prescribed::ForceN(1.0))]
    {
        for (level, error) in [(Accuracy::Fast, 1e-2), (Accuracy::Default, 1e-4)] {
            let seen = |count: usize| {
                let array = Array { rows: count, cols: count, pitch_mm };
                let rubber = layer(t, 0.45);
                let mut scene = Scene::new(&rubber, shape, &array, Sampling::Area, level).unwrap();
                let planar = PlanarPose { x_mm: 0.2, y_mm: 0.1, rot_rad: -0.4 };
                scene.press(drive, Pose { planar, tilt_rad: 0.0 }).unwrap();
                image(&scene)[count * count / 2]
            };
            let (alone, among) = (seen(1), seen(41));
            assert!((alone / among - 1.0).abs() < error, "{shape:?} {level:?}: {alone} {among}");
        }
    }
}

#[test]
fn nothing_pressed_is_an_empty_image_and_unloading_is_complete() {
    let layer = layer(0.8, 0.49);
    let shapes = [
        Shape::Sphere { radius_mm: 10.0 },
        PIN,
        Shape::Cylinder { radius_mm: 23.0, length_mm: None },
        Shape::Bar { width_mm: 6.0, length_mm: Some(10.0) },
        Shape::Bar { width_mm: 6.0, length_mm: None },
    ];
    for shape in shapes {
        let mut scene = scene(&layer, shape);
        for drive in [
            Prescribed::ForceN(0.0),
            Prescribed::PenetrationMm(0.0),
            Prescribed::PenetrationMm(-0.3),
            Prescribed::PenetrationMm(0.01),
            Prescribed::PenetrationMm(-1e-9),
            Prescribed::ForceN(0.0),
        ] {
            let touch = scene.press(drive, Pose::default()).unwrap();
            let pressed = drive == Prescribed::PenetrationMm(0.01);
            assert_eq!(touch.force_n > 0.0, pressed, "{shape:?} {drive:?}: {touch:?}");
            assert_eq!(peak(&image(&scene)) > 0.0, pressed, "{shape:?} {drive:?}");
        }
        let pull = scene.press(Prescribed::ForceN(-1.0), Pose::default()).expect_err("refused");
        assert_eq!(pull.place, "force_n");
    }
}

#[test]
fn spheres_at_the_arrays_edge_and_off_it() {
    let mut sphere = Sphere::new(&layer(0.8, 0.49), 10.0, Accuracy::Default).unwrap();
    sphere.press(Prescribed::ForceN(5.0)).unwrap();
    let sum_at = |place: [f64; 2]| {
        let mut image = vec![0.0; 256];
        sphere.image(&Array::THESIS, Sampling::Area, place, &mut image).unwrap();
        assert!(image.iter().all(|value| value.is_finite()));
        image.iter().sum::<f64>() * 1.5875 * 1.5875
    };
    assert!((sum_at([0.0; 2]) + 5.0).abs() < 1e-3);
    // At the edge of the array half of the force is measured, at the corner a quarter.
    assert!((sum_at([12.7, 0.0]) + 2.5).abs() < 1e-3);
    assert!((sum_at([-12.7, 12.7]) + 1.25).abs() < 1e-3);
    assert!(sum_at([20.0, 0.0]).abs() < 0.05);
    assert!(sum_at([1e6, -1e9]).abs() < 1e-9);
    sphere.press(Prescribed::ForceN(5.0)).unwrap();
    let shares = Influence::new(&layer(0.8, 0.49))
        .and_then(|i| Shares::new(&i, &Array::THESIS, Sampling::Area, Fineness::DEFAULT))
        .unwrap();
    let mut image = vec![0.0; 256];
    for bad in [f64::NAN, f64::INFINITY, 1e300, -1e300] {
        shares.add(&mut image, [bad, 0.0], 1.0);
        shares.add(&mut image, [0.0, bad], 1.0);
    }
    shares.add(&mut image, [0.0; 2], f64::NAN);
    shares.add(&mut [], [0.0; 2], 1.0);
    assert_eq!(peak(&image), 0.0);
    shares.add(&mut image, [0.0; 2], 1.0);
    assert!((image.iter().sum::<f64>() * 1.5875 * 1.5875 + 1.0).abs() < 1e-3);
}

#[test]
fn a_pin_tilted_until_it_touches_in_a_point() {
    let mut scene = scene(&layer(0.8, 0.49), PIN);
    let mut before = f64::INFINITY;
    // The origin lifts while the end stays 0.02 mm deep.
    for tilt_rad in [0.0, 0.001, 0.002, 0.005, 0.01, 0.03, 0.1] {
        let lowest = 10.0 * libm::tan(tilt_rad);
        let drive = Prescribed::PenetrationMm(0.02 - lowest);
        let touch = scene.press(drive, Pose { tilt_rad, ..Pose::default() }).unwrap();
        assert!(touch.force_n > 0.0 && touch.force_n < before, "{tilt_rad}: {touch:?}");
        before = touch.force_n;
        let image = image(&scene);
        assert!(image.iter().all(|value| value.is_finite()), "{tilt_rad}");
    }
    // By then it is the corner of the end that touches: a hundredth of the pin's force.
    let whole = scene.press(Prescribed::PenetrationMm(0.02), Pose::default()).unwrap().force_n;
    assert!(before < 0.02 * whole, "{before} {whole}");
    let drive = Prescribed::PenetrationMm(-1.1);
    let touch = scene.press(drive, Pose { tilt_rad: 0.1, ..Pose::default() }).unwrap();
    assert_eq!(touch.force_n, 0.0);
    let steep = scene.press(drive, Pose { tilt_rad: 0.3, ..Pose::default() });
    assert_eq!(steep.expect_err("refused").place, "tilt_rad");
}

#[test]
fn a_thousand_makes_and_breaks_end_where_a_cold_start_ends() {
    let layer = layer(0.8, 0.49);
    let profile = Profile::Cylinder { radius_mm: 23.0 };
    let make = || Pin::new(&layer, profile, [-6.0, 6.0], 0.1, Accuracy::Fast).unwrap();
    let mut warm = make();
    let mut seed = 7_u64;
    let mut draw = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (seed >> 33) as f64 / (1_u64 << 31) as f64
    };
    for n in 0..1000 {
        let delta = 0.08 * draw() - 0.02;
        let tilt = 0.004 * draw() - 0.002;
        let by_force = n % 5 == 4;
        let drive = if by_force {
            Prescribed::ForceN(60.0 * draw())
        } else {
            Prescribed::PenetrationMm(delta)
        };
        let state = warm.press(drive, tilt).unwrap_or_else(|error| panic!("{n}: {error}"));
        if n % 50 != 0 {
            continue;
        }
        let cold = make().press(drive, tilt).unwrap();
        let off = (state.force_n - cold.force_n).abs();
        assert!(off < 5e-3 * cold.force_n + 1e-9, "{n}: {state:?} {cold:?}");
    }
    let mut sphere = Sphere::new(&layer, 10.0, Accuracy::Fast).unwrap();
    for n in 0..1000 {
        let force = if n % 2 == 0 { 20.0 * draw() } else { 0.0 };
        assert!((sphere.press(Prescribed::ForceN(force)).unwrap().force_n - force).abs() < 1e-9);
    }
}

#[test]
fn nan_is_refused_and_leaves_no_contact() {
    let layer = layer(0.8, 0.49);
    let mut scene = scene(&layer, PIN);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for drive in [Prescribed::ForceN(bad), Prescribed::PenetrationMm(bad)] {
            scene.press(Prescribed::PenetrationMm(0.02), Pose::default()).unwrap();
            assert!(scene.press(drive, Pose::default()).is_err(), "{drive:?}");
            assert_eq!(peak(&image(&scene)), 0.0);
        }
        let planar = PlanarPose { x_mm: bad, ..PlanarPose::default() };
        let pose = Pose { planar, tilt_rad: 0.0 };
        assert_eq!(scene.press(Prescribed::ForceN(1.0), pose).expect_err("refused").place, "x_mm");
        let pose = Pose { tilt_rad: bad, ..Pose::default() };
        assert_eq!(
            scene.press(Prescribed::ForceN(1.0), pose).expect_err("refused").place,
            "tilt_rad"
        );
    }
    for huge in [1e6, 1e30, 1e300] {
        assert_eq!(
            scene.press(Prescribed::ForceN(huge), Pose::default()).expect_err("refused").place,
            "force_n"
        );
        assert!(scene.press(Prescribed::PenetrationMm(huge), Pose::default()).is_err());
    }
    // After all these contacts the solver still works.
    assert!(scene.press(Prescribed::ForceN(10.0), Pose::default()).is_ok());
    for (rows, cols, pitch_mm) in
        [(0, 16, 1.0), (16, 0, 1.0), (16, 16, f64::NAN), (1 << 11, 1 << 11, 1.0)]
    {
        let array = Array { rows, cols, pitch_mm };
        assert!(Scene::new(&layer, PIN, &array, Sampling::Area, Accuracy::Fast).is_err());
    }
    for radius_mm in [0.0, -1.0, f64::NAN] {
        let shape = Shape::Sphere { radius_mm };
        let refused = Scene::new(&layer, shape, &Array::THESIS, Sampling::Area, Accuracy::Fast);
        assert_eq!(refused.expect_err("refused").place, "radius_mm");
    }
}

#[test]
fn sizes_beyond_sense_are_refused_at_once() {
    let rubber = layer(0.8, 0.49);
    for (length, place) in [(1e-6, "length_mm"), (1e6, "length_mm")] {
        let shape = Shape::Cylinder { radius_mm: 23.0, length_mm: Some(length) };
        let refused = scene(&rubber, shape).press(Prescribed::PenetrationMm(0.01), Pose::default());
        assert_eq!(refused.expect_err("refused").place, place);
    }
    let film = layer(1e-9, 0.3);
    let refused = Scene::new(&film, PIN, &Array::THESIS, Sampling::Area, Accuracy::Fast);
    assert_eq!(refused.expect_err("refused").place, "thickness_mm");
    // Tactels in one line whose cells would not fit in memory.
    let line = Array { rows: 1 << 20, cols: 1, pitch_mm: 1.5875 };
    let refused = Scene::new(&rubber, PIN, &line, Sampling::Area, Accuracy::Fast);
    assert_eq!(refused.map(|_| ()).expect_err("refused").place, "rows");
    // A line far longer than the array has the image of one that just covers it.
    let edge = |length| Shape::Edge { length_mm: Some(length) };
    let mut long = scene(&rubber, edge(1e9));
    long.press(Prescribed::ForceN(1e9), Pose::default()).unwrap();
    let mut endless = scene(&rubber, Shape::Edge { length_mm: None });
    endless.press(Prescribed::ForceN(1.0), Pose::default()).unwrap();
    assert!(max_difference(&image(&long), &image(&endless)) < 1e-12);
}

#[test]
fn cells_refuse_what_they_cannot_resolve() {
    let influence = Influence::new(&layer(0.8, 0.49)).unwrap();
    let cells = |columns, spacing_mm| Cells { columns, rows: 16, spacing_mm };
    assert_eq!(Surface::new(&influence, &cells(16, 0.5)).expect_err("").place, "spacing_mm");
    assert_eq!(Surface::new(&influence, &cells(3, 0.1)).expect_err("").place, "columns");
    assert_eq!(Surface::new(&influence, &cells(9999, 0.1)).expect_err("").place, "columns");
    let mut surface = Surface::new(&influence, &cells(16, 0.1)).unwrap();
    let flat = vec![0.0; 256];
    let border = surface.press(&flat, Prescribed::PenetrationMm(0.01)).expect_err("refused");
    assert_eq!(border.place, "columns");
    assert_eq!(peak(surface.pressure_mpa()), 0.0);
    assert!(surface.press(&flat[..9], Prescribed::PenetrationMm(0.01)).is_err());
    assert!(surface.press(&[f64::NAN; 256], Prescribed::PenetrationMm(0.01)).is_err());
    assert!(surface.press(&[f64::INFINITY; 256], Prescribed::PenetrationMm(0.01)).is_err());
    // A body of one cell.
    let mut heights = vec![f64::INFINITY; 256];
    heights[8 * 16 + 8] = 0.0;
    let state = surface.press(&heights, Prescribed::ForceN(0.01)).unwrap();
    assert!((state.force_n - 0.01).abs() < 1e-12 && state.area_mm2 < 0.011, "{state:?}");
    assert_eq!(surface.press(&heights, Prescribed::ForceN(0.0)).unwrap().force_n, 0.0);
}

#[test]
fn a_pin_longer_than_the_pad_is_cut_at_the_pad() {
    let rubber = layer(0.8, 0.49);
    let pose = Pose { tilt_rad: 5e-4, ..Pose::default() };
    let press = |length_mm: Option<f64>| {
        let mut scene = scene(&rubber, Shape::Cylinder { radius_mm: 23.0, length_mm });
        let touch = scene.press(Prescribed::PenetrationMm(0.02), pose).unwrap();
        (touch.force_n, image(&scene))
    };
    let (cut, endless) = (press(Some(25.4)), press(None));
    assert_eq!(cut, endless, "without ends it is cut at the array");
    let (force, long) = press(Some(60.0));
    // The part beyond the pad adds force, but little five thicknesses inside the edge of the pad.
    assert!(force > 1.5 * cut.0, "{force} {}", cut.0);
    let size = peak(&long);
    for (n, (a, b)) in long.iter().zip(&cut.1).enumerate() {
        let y = Array::THESIS.y_mm(n / 16).abs();
        assert!(y > 8.0 || (a - b).abs() < 1e-2 * size, "{n}: {a} {b}");
    }
}

#[test]
fn tactels_of_any_size_see_a_sphere() {
    // The flux through an edge is read within the table, however long the edge is.
    let rubber = layer(0.8, 0.49);
    for pitch_mm in [1e-6, 40.0, 1e9, 1e28] {
        let array = Array { rows: 3, cols: 4, pitch_mm };
        for level in [Accuracy::Fast, Accuracy::Default] {
            let shape = Shape::Sphere { radius_mm: 10.0 };
            let mut scene = Scene::new(&rubber, shape, &array, Sampling::Area, level).unwrap();
            let planar = PlanarPose { x_mm: 0.3 * pitch_mm.min(1.0), y_mm: 0.2, rot_rad: 0.0 };
            scene.press(Prescribed::ForceN(5.0), Pose { planar, tilt_rad: 0.0 }).unwrap();
            let mut image = vec![0.0; 12];
            scene.image(&mut image).unwrap();
            let sum: f64 = image.iter().map(|s| s * pitch_mm * pitch_mm).sum();
            let wanted = if pitch_mm > 1.0 { -5.0 } else { 0.0 };
            let close = if level == Accuracy::Fast { 5e-3 } else { 1e-4 };
            assert!((sum - wanted).abs() < close, "{pitch_mm} {level:?}: {sum}");
        }
    }
}

#[test]
fn the_faintest_contacts_follow_their_laws() {
    let rubber = layer(0.8, 0.49);
    let profile = Profile::Cylinder { radius_mm: 10.0 };
    let mut endless = InfiniteIndenter::new(&rubber, profile, 0.1).unwrap();
    let array = Array::THESIS;
    for force in [1e-3, 1e-5, 1e-6, 1e-9, 1e-20, 1e-30] {
        let found = endless.press(Prescribed::ForceN(force)).unwrap();
        assert!((found.force_n_mm / force - 1.0).abs() < 1e-7, "{found:?}");
        // Hertz in the plane: b^2 = 4 F R (1 - nu^2) / (pi E).
        let modulus = rubber.youngs_mpa / (1.0 - 0.49 * 0.49);
        let wide = (4.0 * force * 10.0 / (core::f64::consts::PI * modulus)).sqrt();
        assert!((found.half_width_mm / wide - 1.0).abs() < 2e-3, "{found:?} {wide}");
        let mut image = vec![0.0; 256];
        endless.image(&array, Sampling::Area, PlanarPose::default(), &mut image).unwrap();
        let per_mm: f64 = image[..16].iter().sum::<f64>() * array.pitch_mm;
        assert!((per_mm / -force - 1.0).abs() < 1e-4, "{per_mm} {force}");
        let back = endless.press(Prescribed::PenetrationMm(found.penetration_mm)).unwrap();
        assert!((back.force_n_mm / force - 1.0).abs() < 1e-5, "{back:?} {force}");
    }
    for level in [Accuracy::Fast, Accuracy::Default] {
        let mut sphere = Sphere::new(&rubber, 10.0, level).unwrap();
        let state = sphere.press(Prescribed::ForceN(1e-30)).unwrap();
        assert!((state.force_n / 1e-30 - 1.0).abs() < 1e-9 && state.residual < 1e-5, "{state:?}");
        let state = sphere.press(Prescribed::ForceN(1e-300)).unwrap();
        assert_eq!((state.force_n, state.residual), (0.0, 0.0));
    }
}

#[test]
fn an_end_through_the_base_is_refused_before_any_table() {
    let rubber = layer(0.8, 0.49);
    let long = Shape::Cylinder { radius_mm: 10.0, length_mm: Some(1000.0) };
    let pose = |tilt_rad: f64| Pose { tilt_rad, ..Pose::default() };
    let refused = |tilt: f64| {
        let told = scene(&rubber, long).press(Prescribed::PenetrationMm(0.03), pose(tilt));
        told.expect_err("refused")
    };
    let through = refused(0.01);
    assert_eq!(through.place, "penetration_mm");
    assert!(through.what.contains("deeper end"), "{through:?}");
    assert_eq!(refused(0.3).place, "tilt_rad");
    for (pitch_mm, place) in [(1e-9, "pitch_mm"), (1e9, "pitch_mm"), (1.5, "thickness_mm")] {
        let rubber = layer(if place == "pitch_mm" { 0.8 } else { 1e6 }, 0.49);
        let array = Array { rows: 4, cols: 4, pitch_mm };
        let made = Scene::new(&rubber, PIN, &array, Sampling::Area, Accuracy::Fast);
        assert_eq!(made.expect_err("refused").place, place);
    }
}
