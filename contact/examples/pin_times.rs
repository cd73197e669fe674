//! Measures the time of contact and image at the fast level in randomly drawn poses: `cargo run
//! --profile dist -p taktil-contact --example pin_times [-- LAYERS PINS SEED...]`. Pins up to 60 mm
//! long and bars up to 12 mm wide, arrays of 8 x 8 to 32 x 32 tactels of 1.0 to 2.5 mm in turn, the
//! thesis's every other layer. It prints the median, the 90th percentile and the largest time, then
//! the slowest ten with their geometry. A time is the least of several rounds, in each of which the
//! contact differs as between control periods. This is not lane code.

#[path = "../tests/space/draws.rs"]
#[expect(dead_code, reason = "the sweep and the test judge what is only timed here")]
mod draws;

use draws::{Drawn, Draws};
use std::hint::black_box;
use std::time::Instant;
use taktil_contact::Accuracy;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::Pin;
use taktil_contact::space::radial::Influence;
use taktil_contact::space::scene::Pose;
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};

/// Rounds of a timing; the least counts.
const TIMING_ROUNDS: u32 = 30;
/// Longest pin and widest bar, mm.
const PIN_SIZE_MAX_MM: [f64; 2] = [60.0, 12.0];
/// Rows, columns and pitch (mm) in turn with the thesis's array.
const ARRAY_SIZES: [(usize, usize, f64); 4] =
    [(16, 16, 1.0), (8, 8, 2.5), (16, 16, 2.5), (32, 32, 1.0)];

/// Microseconds of pressing, and of pressing and the image, warm and cold.
struct Timed {
    press: f64,
    warm: f64,
    cold: f64,
    loads: usize,
    what: String,
}

fn main() {
    let words: Vec<usize> = std::env::args().skip(1).filter_map(|word| word.parse().ok()).collect();
    let (layers, pins) = (*words.first().unwrap_or(&8), *words.get(1).unwrap_or(&10));
    let seeds = words.get(2..).filter(|seeds| !seeds.is_empty()).unwrap_or(&[11]);
    let (mut thesis, mut others) = (Vec::new(), Vec::new());
    for seed in seeds {
        let mut draws = Draws(*seed as u64);
        for layer in 0..layers {
            let (own, array) = match ARRAY_SIZES[layer / 2 % ARRAY_SIZES.len()] {
                _ if layer.is_multiple_of(2) => (&mut thesis, Array::THESIS),
                (rows, cols, pitch_mm) => (&mut others, Array { rows, cols, pitch_mm }),
            };
            let rubber = draws.rubber();
            let influence = Influence::new(&rubber).expect("a layer");
            let shares = Shares::new(&influence, &array, Sampling::Area, Fineness::FAST);
            let shares = shares.expect("tables");
            own.extend(
                (0..pins).map(|_| timed(&draws.pin_within(rubber, PIN_SIZE_MAX_MM), &shares)),
            );
        }
    }
    report("16 x 16 of 1.5875 mm", thesis);
    report("other arrays", others);
}

fn report(name: &str, mut all: Vec<Timed>) {
    for (what, of) in [
        ("pressed", (|one| one.press) as fn(&Timed) -> f64),
        ("warm", |one| one.warm),
        ("cold", |one| one.cold),
    ] {
        all.sort_by(|a, b| of(b).total_cmp(&of(a)));
        let Some(last) = all.len().checked_sub(1) else { return };
        let at = |part: f64| of(&all[(last as f64 * part) as usize]);
        let (count, median, nine, largest) = (all.len(), at(0.5), at(0.1), at(0.0));
        println!("{name} ({count}), {what}, us: {median:.1} | {nine:.1} | {largest:.1}");
    }
    all.sort_by(|a, b| b.warm.max(b.cold).total_cmp(&a.warm.max(a.cold)));
    for Timed { press, warm, cold, loads, what } in all.iter().take(10) {
        println!("{press:.1} pressed, {warm:.1} warm, {cold:.1} cold, {loads} loads: {what}");
    }
}

#[expect(clippy::disallowed_methods, reason = "a stopwatch for people, not lane code")]
fn least_us(mut call: impl FnMut(u32)) -> f64 {
    let times = (0..TIMING_ROUNDS).map(|round| {
        let start = Instant::now();
        call(round);
        start.elapsed().as_secs_f64() * 1e6
    });
    times.fold(f64::INFINITY, f64::min)
}

fn timed(drawn: &Drawn, shares: &Shares) -> Timed {
    let mut pin = drawn.pin(Accuracy::Fast);
    let mut image = vec![0.0; shares.array().len()];
    let Pose { planar, tilt_rad } = drawn.pose;
    let state = pin.press(Prescribed::PenetrationMm(drawn.delta_mm), tilt_rad).expect("a contact");
    let mut loads = 0;
    pin.loads(|_, _| loads += 1);
    let mut nudged = |pin: &mut Pin, round: u32, seen: bool| {
        let f = f64::from(round % 3);
        let drive = Prescribed::ForceN(state.force_n * (1.0 + 0.003 * f));
        let pressed = pin.press(drive, tilt_rad * (1.0 + 0.005 * f)).expect("a contact");
        if seen {
            image.fill(0.0);
            pin.image(shares, planar, &mut image);
        }
        black_box((pressed, &mut image));
    };
    let press = least_us(|round| nudged(&mut pin, round, false));
    let warm = least_us(|round| nudged(&mut pin, round, true));
    let cold = least_us(|round| {
        pin.release();
        nudged(&mut pin, round, true);
    });
    let Array { rows, cols, pitch_mm } = *shares.array();
    let what = format!("{rows} x {cols} of {pitch_mm}, {drawn:?}");
    Timed { press, warm, cold, loads, what }
}
