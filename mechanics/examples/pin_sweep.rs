//! Error and time of the image of drawn pins and bars in any pose: `cargo run --release -p
//! taktil-mechanics --example pin_sweep [-- LAYERS [PINS [SEED [1]]]]`. The truth is the default
//! level on slices laid over what touches; with a fourth number the fine one, and the default
//! level is judged as well. Prints median, ninth decile and worst, with the pose. Not lane code.

#[path = "../tests/space/draws.rs"]
mod draws;

use draws::{Drawn, Draws};
use std::hint::black_box;
use std::time::Instant;
use taktil_mechanics::contact::features::{Part, image_features};
use taktil_mechanics::contact::space::pin::Pin;
use taktil_mechanics::contact::space::radial::Influence;
use taktil_mechanics::contact::space::scene::Pose;
use taktil_mechanics::contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_mechanics::contact::space::{Drive, Level};

/// Rounds of a timing; the best counts.
const ROUNDS: u32 = 20;

#[derive(Clone, Copy, Default)]
struct Row {
    force: f64,
    centroid_mm: f64,
    by_force_mm: f64,
    image: f64,
    cold_us: f64,
    warm_us: f64,
}

fn main() {
    let asked: Vec<usize> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let (layers, pins) = (*asked.first().unwrap_or(&8), *asked.get(1).unwrap_or(&12));
    let mut draws = Draws(*asked.get(2).unwrap_or(&11) as u64);
    let mut rows: [Vec<(Row, String)>; 4] = Default::default();
    let truth = if asked.len() > 3 { Level::Fine } else { Level::Default };
    for _ in 0..layers {
        let rubber = draws.rubber();
        let influence = Influence::new(&rubber).expect("a layer");
        let [quick, shares] = [Fineness::FAST, Fineness::DEFAULT].map(|fineness| {
            Shares::new(&influence, &Array::THESIS, Sampling::Area, fineness).expect("tables")
        });
        for _ in 0..pins {
            let drawn = draws.pin(rubber);
            let mut exact = vec![0.0; 256];
            let force = drawn.exact(truth, &shares, &mut exact);
            let corner = usize::from(drawn.on_corner());
            let levels = [Level::Fast, Level::Default].into_iter().enumerate();
            for (n, level) in levels.take(if truth == Level::Fine { 2 } else { 1 }) {
                let shares = if level == Level::Fast { &quick } else { &shares };
                let row = measured(&drawn, level, shares, (&exact, force));
                rows[2 * n + corner].push((row, format!("{drawn:?}")));
            }
        }
    }
    let names = ["fast", "fast, on a corner", "default", "default, on a corner"];
    for (name, rows) in names.into_iter().zip(&mut rows) {
        if rows.is_empty() {
            continue;
        }
        println!("{name}: {} poses", rows.len());
        summary("force", rows, |row| row.force);
        summary("centroid mm", rows, |row| row.centroid_mm);
        summary("centroid mm, by force", rows, |row| row.by_force_mm);
        summary("image/peak", rows, |row| row.image);
        summary("cold us", rows, |row| row.cold_us);
        summary("warm us", rows, |row| row.warm_us);
    }
}

fn summary(name: &str, rows: &mut [(Row, String)], of: impl Fn(&Row) -> f64) {
    rows.sort_by(|a, b| of(&a.0).total_cmp(&of(&b.0)));
    let at = |part: f64| of(&rows[((rows.len() - 1) as f64 * part) as usize].0);
    let worst = &rows[rows.len() - 1].1;
    println!("{name:<22} {:9.2e} {:9.2e} {:9.2e}", at(0.5), at(0.9), at(1.0));
    println!("    {worst}");
}

#[expect(clippy::disallowed_methods, reason = "a stopwatch for people, not lane code")]
fn best(mut call: impl FnMut(u32)) -> f64 {
    let mut best = f64::INFINITY;
    for round in 0..ROUNDS {
        let start = Instant::now();
        call(round);
        best = best.min(start.elapsed().as_secs_f64() * 1e6);
    }
    best
}

fn measured(drawn: &Drawn, level: Level, shares: &Shares, (exact, force): (&[f64], f64)) -> Row {
    let mut pin = drawn.pin(level);
    let mut image = vec![0.0; 256];
    let Pose { stand, tilt_rad } = drawn.pose;
    let mut one = |pin: &mut Pin, drive, tilt_rad| {
        let state = pin.press(drive, tilt_rad).expect("a contact");
        image.fill(0.0);
        pin.image(shares, stand, &mut image);
        (state.force_n, image.clone())
    };
    let (found, seen) = one(&mut pin, Drive::PenetrationMm(drawn.delta_mm), tilt_rad);
    let mut row = Row { force: (found / force - 1.0).abs(), ..Row::default() };
    row.centroid_mm = apart(&seen, exact);
    let peak = exact.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    let off = seen.iter().zip(exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    row.image = off / peak;
    pin.release();
    row.by_force_mm = apart(&one(&mut pin, Drive::ForceN(force), tilt_rad).1, exact);
    // Contacts a control period apart: pressed a little more, tilted a little further.
    let mut nudged = |pin: &mut Pin, round: u32| {
        let f = f64::from(round % 3);
        let tilt_rad = tilt_rad * (1.0 + 0.005 * f);
        black_box(one(pin, Drive::ForceN(force * (1.0 + 0.003 * f)), tilt_rad));
    };
    row.warm_us = best(|round| nudged(&mut pin, round));
    row.cold_us = best(|round| {
        pin.release();
        nudged(&mut pin, round);
    });
    row
}

/// Distance of the centroids, mm.
fn apart(image: &[f64], exact: &[f64]) -> f64 {
    let of = |image: &[f64]| {
        let found = image_features(&Array::THESIS, image, Part::Full).expect("features");
        [found.xc.expect("x"), found.yc.expect("y")]
    };
    let (a, b) = (of(image), of(exact));
    (a[0] - b[0]).abs().max((a[1] - b[1]).abs())
}
