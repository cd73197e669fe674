//! Compares pins and bars in any pose with a much finer solution: force, centroid and image at the
//! fast and the default accuracy. The example `pin_sweep` measures times over more poses.

use crate::draws::{Drawn, Draws};
use crate::{max_difference, peak};
use taktil_contact::Accuracy;
use taktil_contact::features::{Part, image_features};
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::{Pin, PlanarPose, Profile};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};

const AWAY_MM: f64 = 0.02;

fn centroid(image: &[f64]) -> [f64; 2] {
    let found = image_features(&Array::THESIS, image, Part::Full).expect("features");
    [found.xc.expect("x"), found.yc.expect("y")]
}

/// Errors: force over the reference, distance of the centroids, error of the image over its peak.
fn off(
    drawn: &Drawn,
    pin: &mut Pin,
    shares: &Shares,
    drive: Prescribed,
    (force, exact): (f64, &[f64]),
) -> [f64; 3] {
    pin.release();
    let state = pin.press(drive, drawn.pose.tilt_rad).expect("a contact");
    let mut image = vec![0.0; 256];
    pin.image(shares, drawn.pose.planar, &mut image);
    let away = max_difference(&centroid(&image), &centroid(exact));
    [(state.force_n / force - 1.0).abs(), away, max_difference(&image, exact) / peak(exact)]
}

#[test]
fn stated_errors_hold_in_any_pose() {
    let mut draws = Draws(5);
    let mut corners = 0;
    for _ in 0..3 {
        let rubber = draws.rubber();
        let influence = Influence::new(&rubber).expect("a layer");
        let [quick, shares] = [Fineness::FAST, Fineness::DEFAULT].map(|fineness| {
            Shares::new(&influence, &Array::THESIS, Sampling::Area, fineness).expect("tables")
        });
        for n in 0..10 {
            let drawn = draws.pin(rubber);
            corners += usize::from(drawn.on_corner());
            let mut exact = vec![0.0; 256];
            let force = drawn.reference_solution(Accuracy::Default, &shares, &mut exact);
            let truth = (force, &exact.clone()[..]);
            let deep = Prescribed::PenetrationMm(drawn.delta_mm);
            let mut pin = drawn.pin(Accuracy::Fast);
            let [force_off, away, image] = off(&drawn, &mut pin, &quick, deep, truth);
            assert!(force_off < 1e-2 && away < AWAY_MM, "{drawn:?}: {force_off:e} {away}");
            assert!(image < 2e-2, "{drawn:?}: {image:e}");
            let [force_off, away, _] =
                off(&drawn, &mut pin, &quick, Prescribed::ForceN(force), truth);
            assert!(force_off < 4e-3 && away < AWAY_MM, "by force {drawn:?}: {force_off:e} {away}");
            if n % 2 == 0 {
                let force = drawn.reference_solution(Accuracy::Fine, &shares, &mut exact);
                let mut pin = drawn.pin(Accuracy::Default);
                for drive in [deep, Prescribed::ForceN(force)] {
                    let truth = (force, &exact[..]);
                    let [force_off, away, image] = off(&drawn, &mut pin, &shares, drive, truth);
                    assert!(force_off < 1e-3 && away < 2e-3, "{drawn:?}: {force_off:e} {away}");
                    assert!(image < 1e-3, "{drawn:?}: {image:e}");
                }
            }
        }
    }
    assert!((5..25).contains(&corners), "{corners} of 30 on a corner");
}

/// Contacts far shallower than their tables were made for, by penetration and by force.
#[test]
fn shallow_contacts_have_the_stated_errors() {
    let mut draws = Draws(6);
    for _ in 0..3 {
        let rubber = draws.rubber();
        let influence = Influence::new(&rubber).expect("a layer");
        let [quick, shares] = [Fineness::FAST, Fineness::DEFAULT].map(|fineness| {
            Shares::new(&influence, &Array::THESIS, Sampling::Area, fineness).expect("tables")
        });
        for _ in 0..10 {
            let drawn = draws.shallow(rubber);
            let mut exact = vec![0.0; 256];
            let force = drawn.reference_solution(Accuracy::Default, &shares, &mut exact);
            let mut pin = drawn.pin(Accuracy::Fast);
            for drive in [Prescribed::PenetrationMm(drawn.delta_mm), Prescribed::ForceN(force)] {
                let [force_off, away, image] =
                    off(&drawn, &mut pin, &quick, drive, (force, &exact));
                assert!(force_off < 1e-2 && away < AWAY_MM, "{drawn:?}: {force_off:e} {away}");
                assert!(image < 2e-2, "{drawn:?}: {image:e}");
            }
        }
    }
}

/// The end of a tilted cylinder on a layer thicker than a tactel is wide, at the default level and
/// at the fine one.
#[test]
fn the_deeper_end_is_seen_at_its_place() {
    let layer = Layer::new(2.0, 27.58, 0.22).expect("a layer");
    let influence = Influence::new(&layer).expect("a layer");
    let made = Shares::new(&influence, &Array::THESIS, Sampling::Area, Fineness::DEFAULT);
    let shares = made.expect("tables");
    let profile = Profile::Cylinder { radius_mm: 40.0 };
    let planar = PlanarPose { x_mm: 5.75, y_mm: 2.5, rot_rad: -1.37 };
    let [found, exact] = [Accuracy::Default, Accuracy::Fine].map(|level| {
        let mut pin = Pin::new(&layer, profile, [-15.75, 15.75], 0.3, level).expect("a pin");
        pin.press(Prescribed::PenetrationMm(-0.02), -0.0104).expect("a contact");
        let mut image = vec![0.0; 256];
        pin.image(&shares, planar, &mut image);
        image
    });
    let off = max_difference(&found, &exact) / peak(&exact);
    assert!(off < 7e-4, "{off:e}");
}

/// Wide cylinders on an end of thin rubber that keeps its volume, a narrow bar on an end and a
/// cylinder that lies on two thirds of its length: the default level is a thousandth off at most,
/// most of it by the length of its slices; of a bar by the shortest waves that they feel.
#[test]
fn the_default_level_is_a_thousandth_off_at_most() {
    let cylinder = |radius_mm| Profile::Cylinder { radius_mm };
    let bar = Profile::Bar { width_mm: 0.557 };
    for (t, nu, profile, length_mm, made_mm, delta_mm, tilt_rad, places) in [
        (0.3, 0.5, cylinder(31.6), 23.6, 0.046, -0.1157, 0.01177, [-13.0, -2.0, -1.03]),
        (0.3, 0.5, cylinder(11.9), 13.35, 0.06, -0.0967, 0.01894, [-6.0, -1.0, -0.75]),
        (1.03, 0.39, cylinder(26.5), 29.1, 0.079, 0.0073, 0.00221, [-4.9, -5.8, -0.68]),
        // By force on a row longer than it has to be it was 1.1e-3 off.
        (1.97, 0.224, cylinder(40.17), 31.48, 0.287, -0.01964, -0.01036, [5.75, 2.5, -1.37]),
        // While what slices leave over at an end did not know that the pin leans it was 8.3e-4 off
        // here, 1.1e-3 of shorter slices.
        (
            2.2651,
            0.3353,
            cylinder(12.541),
            36.39,
            0.1832,
            -0.004659,
            0.005289,
            [-6.5, -7.11, -0.37],
        ),
        (0.73, 0.5, bar, 10.56, 0.121, -0.955, 0.19, [-0.56, -5.33, 0.45]),
    ] {
        let layer = Layer::new(t, 27.58, nu).expect("a layer");
        let influence = Influence::new(&layer).expect("a layer");
        let made = Shares::new(&influence, &Array::THESIS, Sampling::Area, Fineness::DEFAULT);
        let shares = made.expect("tables");
        let [x_mm, y_mm, rot_rad] = places;
        let ends = [-0.5 * length_mm, 0.5 * length_mm];
        let seen = |pin: &mut Pin, drive| {
            pin.release();
            let state = pin.press(drive, tilt_rad).expect("a contact");
            let mut image = vec![0.0; 256];
            pin.image(&shares, PlanarPose { x_mm, y_mm, rot_rad }, &mut image);
            (state.force_n, image)
        };
        let [mut pin, mut fine] = [Accuracy::Default, Accuracy::Fine]
            .map(|level| Pin::new(&layer, profile, ends, made_mm, level).expect("a pin"));
        let [found, exact] =
            [&mut pin, &mut fine].map(|pin| seen(pin, Prescribed::PenetrationMm(delta_mm)));
        let (_, by_force) = seen(&mut pin, Prescribed::ForceN(exact.0));
        let by_force = max_difference(&by_force, &exact.1) / peak(&exact.1);
        assert!(by_force < 8e-4, "{profile:?}: {by_force:e} by force");
        let [force, image] =
            [found.0 / exact.0 - 1.0, max_difference(&found.1, &exact.1) / peak(&exact.1)];
        assert!(peak(&exact.1) > 0.0 && force.abs() < 7e-4, "{profile:?}: {force:e}");
        assert!(image < 8e-4, "{profile:?}: {image:e}");
        println!("{profile:?}: force {force:.1e}, image {image:.1e}");
    }
}

/// Long pins whose end is over tactels of any size, at the default level beside the fine one: their
/// slices are a good part as long as the layer is thick.
#[test]
fn ends_of_long_pins_are_seen_at_their_place() {
    let mut draws = Draws(71);
    let mut bars = 0;
    for _ in 0..3 {
        let (rubber, pitch_mm) = (draws.rubber(), draws.pitch_mm());
        let drawn = draws.long(rubber, pitch_mm);
        bars += usize::from(drawn.is_bar());
        let array = Array { pitch_mm, ..Array::THESIS };
        let influence = Influence::new(&rubber).expect("a layer");
        let made = Shares::new(&influence, &array, Sampling::Area, Fineness::DEFAULT);
        let shares = made.expect("tables");
        let mut exact = vec![0.0; 256];
        let force = drawn.reference_solution(Accuracy::Fine, &shares, &mut exact);
        let mut pin = drawn.pin(Accuracy::Default);
        for drive in [Prescribed::PenetrationMm(drawn.delta_mm), Prescribed::ForceN(force)] {
            pin.release();
            let state = pin.press(drive, drawn.pose.tilt_rad).expect("a contact");
            let mut image = vec![0.0; 256];
            pin.image(&shares, drawn.pose.planar, &mut image);
            let off = max_difference(&image, &exact) / peak(&exact);
            assert!(off < 1e-3, "{drawn:?} {drive:?}: {off:e}");
            assert!((state.force_n / force - 1.0).abs() < 5e-4, "{drawn:?}: {state:?}");
        }
    }
    assert!((1..3).contains(&bars), "{bars} of 3 bars");
}

/// Pins shorter than the layer is thick have a converged contact or an error that says why not.
#[test]
fn short_pins_converge_or_are_refused() {
    let mut draws = Draws(11);
    let mut settled = 0;
    for _ in 0..60 {
        let t = draws.between(0.5, 13.0);
        let layer = Layer::new(t, 1.0, draws.between(0.0, 0.49)).expect("a layer");
        let length = t * draws.between(0.1, 1.0);
        let radius_mm = draws.between(3.0, 30.0);
        let (ends, deepest) = ([-0.5 * length, 0.5 * length], (0.45 * t).min(0.3 * radius_mm));
        let profile = Profile::Cylinder { radius_mm };
        let mut pin = Pin::new(&layer, profile, ends, deepest, Accuracy::Fast).expect("a pin");
        let drive = Prescribed::PenetrationMm(deepest * draws.between(0.02, 0.85));
        match pin.press(drive, draws.between(-0.1, 0.1)) {
            Ok(state) => {
                assert!(
                    state.residual <= 0.05 && state.force_n > 0.0,
                    "{length} on {t}: {state:?}"
                );
                settled += 1;
            }
            Err(bad) => {
                assert!(["length_mm", "penetration_mm"].contains(&bad.place), "{bad:?}")
            }
        }
    }
    println!("{settled} of 60 settled");
    assert!(settled >= 58, "{settled} of 60 settled");
}

#[test]
fn a_force_that_a_penetration_makes_is_reached() {
    for (width_mm, length_mm, t, part) in
        [(2.0, 1.3, 12.7, 0.6), (2.0, 0.2, 0.8, 0.5), (12.7, 25.0, 0.8, 0.3)]
    {
        let layer = Layer::new(t, 1.0, 0.3).expect("a layer");
        let profile = Profile::Bar { width_mm };
        let ends = [-0.5 * length_mm, 0.5 * length_mm];
        let mut pin = Pin::new(&layer, profile, ends, 0.9 * t, Accuracy::Fast).expect("a pin");
        let deep = pin.press(Prescribed::PenetrationMm(part * t), 0.0).expect("a contact");
        pin.release();
        let again = pin.press(Prescribed::ForceN(deep.force_n), 0.0).expect("the same contact");
        assert!((again.penetration_mm / deep.penetration_mm - 1.0).abs() < 0.01, "{again:?}");
        pin.release();
        let beyond = pin.press(Prescribed::ForceN(20.0 * deep.force_n), 0.0).expect_err("too much");
        assert_eq!(beyond.place, "force_n");
    }
}

/// The deeper end of what is tilted must not go through the base, whatever is prescribed.
#[test]
fn an_end_beyond_the_layer_is_refused() {
    let layer = Layer::new(0.8, 1.0, 0.3).expect("a layer");
    for profile in [Profile::Bar { width_mm: 3.0 }, Profile::Cylinder { radius_mm: 20.0 }] {
        for level in [Accuracy::Fast, Accuracy::Default] {
            let mut pin = Pin::new(&layer, profile, [-6.0, 6.0], 0.5, level).expect("a pin");
            for (delta_mm, tilt_rad) in [(0.05, 0.19), (0.05, -0.19), (0.4, 0.07)] {
                let deep = pin.press(Prescribed::PenetrationMm(delta_mm), tilt_rad);
                let deep = deep.expect_err("through the base");
                assert_eq!(deep.place, "penetration_mm", "{profile:?} {delta_mm} {tilt_rad}");
                let loaded = pin.press(Prescribed::ForceN(1e5), tilt_rad).expect_err("too much");
                assert_eq!(loaded.place, "force_n", "{profile:?} {tilt_rad}");
            }
            let deep = Prescribed::PenetrationMm(0.4 - 6.0 * libm::tan(0.19));
            assert!(pin.press(deep, 0.19).expect("a contact").force_n > 0.0);
        }
    }
}

/// A pin that lies along y has an image that does: what stands for long slices does not turn it.
#[test]
fn loads_of_long_pins_keep_their_direction() {
    for (thickness_mm, radius_mm) in [(0.8, 8.0), (0.8, 23.0), (0.8, 60.0), (0.4, 23.0)] {
        let layer = Layer::new(thickness_mm, 27.58, 0.49).expect("a layer");
        for profile in [Profile::Cylinder { radius_mm }, Profile::Bar { width_mm: 1.5 }] {
            let ends = [-0.5 * 56.0 * thickness_mm, 0.5 * 56.0 * thickness_mm];
            let mut pin = Pin::new(&layer, profile, ends, 0.1, Accuracy::Fast).expect("a pin");
            for tilt_rad in [0.0, 0.0005, -0.002] {
                pin.press(Prescribed::PenetrationMm(0.02), tilt_rad).expect("a contact");
                let (mut force, mut moment, mut along, mut across) = (0.0, 0.0, 0.0, 0.0);
                pin.loads(|[_, v], load| (force, moment) = (force + load, moment + load * v));
                pin.loads(|[u, v], load| {
                    let v = v - moment / force;
                    (along, across) = (along + load * v * v, across + load * u * v);
                });
                let yaw_deg = (across / along).to_degrees();
                assert!(yaw_deg.abs() < 0.015, "{profile:?} {thickness_mm} {tilt_rad}: {yaw_deg}");
            }
        }
    }
}

/// Beside a wide bar, rubber that keeps its volume bulges: it reaches the middle of slices that are
/// in tension on the whole. Such slices would toggle without end unless they stay out of contact.
#[test]
fn wide_bars_converge_at_the_fine_level() {
    for (t, width_mm, length_mm, depth_mm, tilt_rad) in [
        (0.658, 4.89, 5.06, 0.0076, 0.0024),
        (0.66, 7.6, 2.2, 0.02, 0.03),
        (0.77, 4.5, 12.0, 0.06, 0.007),
    ] {
        let layer = Layer::new(t, 27.58, 0.5).expect("a layer");
        let ends = [-length_mm, 0.0];
        let made = |level| Pin::new(&layer, Profile::Bar { width_mm }, ends, 0.2, level);
        let [mut fine, mut default] =
            [Accuracy::Fine, Accuracy::Default].map(|level| made(level).expect("a bar"));
        let found = fine.press(Prescribed::PenetrationMm(depth_mm), tilt_rad).expect("a contact");
        assert!(found.residual <= 1e-6 && found.steps <= 40, "{found:?}");
        let coarse =
            default.press(Prescribed::PenetrationMm(depth_mm), tilt_rad).expect("a contact");
        let off = (coarse.force_n / found.force_n - 1.0).abs();
        assert!(off < 3e-3, "{coarse:?} {found:?}");
        fine.release();
        let again = fine.press(Prescribed::ForceN(found.force_n), tilt_rad).expect("a contact");
        assert!(again.residual <= 1e-6 && again.steps <= 120, "{again:?}");
        let back = (again.penetration_mm - depth_mm).abs();
        assert!(back < 1e-3 * depth_mm, "{found:?} {again:?}");
    }
}

/// Contacts on an end that are wide for their length are read from the table as others are: they
/// need no search, by penetration and by force, from no contact, and their image agrees with the
/// default level.
#[test]
fn wide_contacts_on_an_end_are_read_from_the_table() {
    for (t, nu, radius_mm, length_mm, delta_mm, tilt_rad) in [
        (0.431, 0.5, 32.0, 5.0, -0.441, 0.19),
        (1.096, 0.418, 33.45, 36.6, -0.71, 0.0441),
        (0.35, 0.45, 44.0, 9.0, -0.65, 0.15),
    ] {
        let layer = Layer::new(t, 27.58, nu).expect("a layer");
        let influence = Influence::new(&layer).expect("a layer");
        let shares = Shares::new(&influence, &Array::THESIS, Sampling::Area, Fineness::DEFAULT);
        let shares = shares.expect("tables");
        let half = 0.5 * length_mm;
        let deepest = delta_mm + half * libm::tan(tilt_rad);
        // The end alone: slices as short as they are on a pin of a few thicknesses.
        let made = |from: f64, level| {
            let profile = Profile::Cylinder { radius_mm };
            Pin::new(&layer, profile, [from, half], 2.0 * deepest, level).expect("a pin")
        };
        let mut default = made(-half, Accuracy::Default);
        let mut fine = made((half - 4.5 * t).max(-half), Accuracy::Fine);
        let planar = PlanarPose { x_mm: 0.3, y_mm: -half, rot_rad: 0.2 };
        let mut images = [[0.0; 256]; 2];
        let exact = fine.press(Prescribed::PenetrationMm(delta_mm), tilt_rad).expect("a contact");
        fine.image(&shares, planar, &mut images[0]);
        for drive in [Prescribed::PenetrationMm(delta_mm), Prescribed::ForceN(exact.force_n)] {
            default.release();
            let state = default.press(drive, tilt_rad).expect("a contact");
            assert_eq!(state.steps, 1, "{drive:?}: {state:?}");
            images[1].fill(0.0);
            default.image(&shares, planar, &mut images[1]);
            let off = max_difference(&images[1], &images[0]) / peak(&images[0]);
            assert!(off < 1e-3, "{t} {radius_mm} {drive:?}: {off:e}");
            assert!((state.force_n / exact.force_n - 1.0).abs() < 1e-3, "{state:?} {exact:?}");
        }
    }
}

/// For wide contacts of many slices on rubber that keeps its volume, level or tilted, the force is
/// found together with the widths, from no contact and from one of slightly less force and tilt.
#[test]
fn a_force_takes_few_more_steps_than_a_penetration() {
    let mut draws = Draws(2101);
    let (mut by_depth, mut by_force, mut warm) = (0, 0, 0);
    for n in 0..30 {
        let t = draws.between(0.3, 0.8);
        let layer = Layer::new(t, 27.58, 0.5).expect("a sound layer");
        let profile = Profile::Cylinder { radius_mm: draws.between(15.0, 45.0) };
        let (length, depth) = (draws.between(6.0, 60.0), t * draws.between(0.02, 0.3));
        let tilt = if n % 3 == 0 { 0.0 } else { draws.between(-2.5, 2.5) * depth / length };
        let half = 0.5 * length;
        let made = Pin::new(&layer, profile, [-half, half], 1.1 * depth, Accuracy::Default);
        let mut pin = made.expect("a pin");
        let deep = Prescribed::PenetrationMm(depth - half * libm::tan(tilt.abs()));
        let exact = pin.press(deep, tilt).expect("a contact");
        pin.release();
        let found = pin.press(Prescribed::ForceN(exact.force_n), tilt).expect("the same contact");
        let off = (found.penetration_mm - exact.penetration_mm).abs();
        assert!(off < 2e-4 * depth, "{exact:?} {found:?}");
        by_depth += exact.steps;
        by_force += found.steps;
        let more = pin.press(Prescribed::ForceN(1.02 * exact.force_n), 1.01 * tilt);
        warm += more.expect("a contact a little further").steps;
    }
    assert!(by_force * 100 <= by_depth * 107, "{by_force} steps, {by_depth} by penetration");
    assert!(warm <= 30 * 5, "{warm} steps warm");
}

/// Tilted contacts nearly fill a row of slices, and the rubber bulges beside a slice that is
/// released: by force they converge as they do by penetration, without toggling slices.
#[test]
fn tilted_contacts_converge_by_force() {
    for (radius_mm, t, length_mm, part, tilt_rad) in [
        (45.0, 0.3, 40.0, 0.25, 0.004),
        (45.0, 0.3, 20.0, 0.25, 0.004),
        (45.0, 0.3, 40.0, 0.25, 0.008),
        (45.0, 0.3, 36.0, 0.25, 0.008),
        (45.0, 0.3, 60.0, 0.25, 0.008),
        (32.0, 0.3, 36.0, 0.25, -0.008),
        (45.0, 0.4, 60.0, 0.15, 0.004),
    ] {
        let layer = Layer::new(t, 27.58, 0.5).expect("a sound layer");
        let (half, depth) = (0.5 * length_mm, part * t);
        for room in [1.1, 1.15] {
            let profile = Profile::Cylinder { radius_mm };
            let made = Pin::new(&layer, profile, [-half, half], room * depth, Accuracy::Default);
            let mut pin = made.expect("a pin");
            let deep = Prescribed::PenetrationMm(depth - half * libm::tan(f64::abs(tilt_rad)));
            let exact = pin.press(deep, tilt_rad).expect("a contact");
            pin.release();
            let found = pin.press(Prescribed::ForceN(exact.force_n), tilt_rad);
            let found = found.expect("the same contact");
            let off = (found.penetration_mm - exact.penetration_mm).abs();
            assert!(off < 1e-4 * depth, "{exact:?} {found:?}");
            assert!(exact.steps <= 15 && found.steps <= 24, "{exact:?} {found:?}");
            assert!(found.residual < 3e-4, "{found:?}");
        }
    }
}
