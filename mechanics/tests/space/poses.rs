//! Pins and bars in any pose against a much finer solution: force and centroid at the fast level,
//! the image at the default one. Refuses to time anything; the example `pin_sweep` does, over more.

use crate::draws::{Drawn, Draws};
use crate::{apart, peak};
use taktil_mechanics::contact::features::{Part, image_features};
use taktil_mechanics::contact::space::pin::Pin;
use taktil_mechanics::contact::space::radial::Influence;
use taktil_mechanics::contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_mechanics::contact::space::{Drive, Level};

/// Reached by pins longer than the array, whose slices are a thickness long.
const AWAY_MM: f64 = 0.035;

fn centroid(image: &[f64]) -> [f64; 2] {
    let found = image_features(&Array::THESIS, image, Part::Full).expect("features");
    [found.xc.expect("x"), found.yc.expect("y")]
}

/// Force over the exact one, distance of the centroids, image's error over the peak.
fn off(
    drawn: &Drawn,
    pin: &mut Pin,
    shares: &Shares,
    drive: Drive,
    (force, exact): (f64, &[f64]),
) -> [f64; 3] {
    pin.release();
    let state = pin.press(drive, drawn.pose.tilt_rad).expect("a contact");
    let mut image = vec![0.0; 256];
    pin.image(shares, drawn.pose.stand, &mut image);
    let away = apart(&centroid(&image), &centroid(exact));
    [(state.force_n / force - 1.0).abs(), away, apart(&image, exact) / peak(exact)]
}

#[test]
fn any_pose_keeps_force_centroid_and_image() {
    let mut draws = Draws(5);
    for _ in 0..3 {
        let rubber = draws.rubber();
        let influence = Influence::new(&rubber).expect("a layer");
        let [quick, shares] = [Fineness::FAST, Fineness::DEFAULT].map(|fineness| {
            Shares::new(&influence, &Array::THESIS, Sampling::Area, fineness).expect("tables")
        });
        for n in 0..10 {
            let drawn = draws.pin(rubber);
            let mut exact = vec![0.0; 256];
            let force = drawn.exact(Level::Default, &shares, &mut exact);
            let truth = (force, &exact[..]);
            let deep = Drive::PenetrationMm(drawn.delta_mm);
            let mut pin = drawn.pin(Level::Fast);
            let [force_off, away, _] = off(&drawn, &mut pin, &quick, deep, truth);
            let most = if drawn.on_corner() { 3e-2 } else { 1e-2 };
            assert!(force_off < most && away < AWAY_MM, "{drawn:?}: {force_off:e} {away}");
            let [force_off, away, _] = off(&drawn, &mut pin, &quick, Drive::ForceN(force), truth);
            assert!(force_off < 4e-3 && away < AWAY_MM, "by force {drawn:?}: {force_off:e} {away}");
            if n % 5 == 0 {
                let mut pin = drawn.pin(Level::Default);
                let [force_off, away, image] = off(&drawn, &mut pin, &shares, deep, truth);
                assert!(force_off < 3e-3 && away < 3e-3, "{drawn:?}: {force_off:e} {away}");
                assert!(image < 5e-3, "{drawn:?}: {image:e}");
            }
        }
    }
}
