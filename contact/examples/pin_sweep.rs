//! Measures error and time of the image of randomly drawn pins and bars in any pose: `cargo run
//! --profile dist -p taktil-contact --example pin_sweep [-- LAYERS PINS SEED... [fine|long]
//! [wide|shallow]]`. The reference is the default level on slices that cover only the contact. With
//! `fine` the reference is the fine level, and the default level is compared with it as well,
//! separately for each shape; `long` draws long pins with an end over tactels of any size, each on
//! a layer of its own; `wide` draws lengths up to 60 mm and bars up to 12 mm; `shallow` presses
//! pins whose tables are made for 0.1 to 0.3 of the thickness only 5e-4 to 5e-2 of it deep. The
//! words may stand anywhere among the numbers; `wide`, `shallow` and `long` exclude each other. It
//! prints the rows of the tables in docs/measurements/contact-3d.md (median, 90th percentile,
//! largest; times are each pose's median), then the worst poses. This is not lane code.

#[path = "../tests/space/draws.rs"]
mod draws;

use draws::{Drawn, Draws};
use std::hint::black_box;
use std::time::Instant;
use taktil_contact::Accuracy;
use taktil_contact::features::{Part, image_features};
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::Pin;
use taktil_contact::space::radial::Influence;
use taktil_contact::space::scene::Pose;
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};

/// Rounds of a timing; their median counts.
const TIMING_ROUNDS: u32 = 21;

#[derive(Clone, Copy, Default)]
struct Row {
    force: f64,
    centroid_mm: f64,
    by_force_mm: f64,
    image: f64,
    by_force: f64,
    cold_us: f64,
    warm_us: f64,
}

type Rows = Vec<(Row, String)>;
type Draw = fn(&mut Draws, Layer) -> Drawn;
type What = (&'static str, fn(&Row) -> f64);

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if let Err(what) = check_words(&words) {
        eprintln!("pin_sweep: {what}");
        std::process::exit(2);
    }
    let asked: Vec<usize> = words.iter().filter_map(|word| word.parse().ok()).collect();
    let (layers, pins) = (*asked.first().unwrap_or(&7), *asked.get(1).unwrap_or(&10));
    let seeds = asked.get(2..).filter(|seeds| !seeds.is_empty()).unwrap_or(&[11]);
    let said = |word: &str| words.iter().any(|other| other == word);
    let fine = said("fine");
    let draw: Draw = match (said("wide"), said("shallow")) {
        (true, _) => |draws, rubber| draws.pin_within(rubber, [60.0, 12.0]),
        (false, true) => Draws::shallow,
        (false, false) => Draws::pin,
    };
    let mut rows: [Rows; 4] = Default::default();
    for seed in seeds {
        let draws = Draws(*seed as u64);
        if said("long") {
            sweep_long(layers * pins, draws, &mut rows);
        } else {
            sweep([layers, pins], draws, (fine, draw), &mut rows);
        }
    }
    println!("| level, contact (poses): what | median | nine in ten | largest |");
    println!("|---|---|---|---|");
    let mut worst = String::new();
    let names = ["fast, a thickness or more", "fast, less", "default, cylinders"];
    for (name, rows) in names.into_iter().chain(["default, bars"]).zip(&mut rows) {
        if !rows.is_empty() {
            let name = format!("{name} ({})", rows.len());
            summary(&name, rows, &mut worst);
        }
    }
    println!("\n{worst}");
}

/// Whether all words are known and none are given together that exclude each other.
fn check_words(words: &[String]) -> Result<(), String> {
    let known = ["fine", "long", "wide", "shallow"];
    let is_number = |word: &str| word.parse::<usize>().is_ok();
    if let Some(word) = words.iter().find(|w| !is_number(w) && !known.contains(&w.as_str())) {
        return Err(format!("`{word}` is no number and no word; words are {}", known.join(", ")));
    }
    let exclusive = ["wide", "shallow", "long"];
    let given: Vec<&str> =
        exclusive.into_iter().filter(|word| words.iter().any(|other| other == word)).collect();
    match given[..] {
        [a, b, ..] => Err(format!("`{a}` and `{b}` draw different pins: give one of them")),
        _ => Ok(()),
    }
}

fn sweep(
    [layers, pins]: [usize; 2],
    mut draws: Draws,
    (fine, draw): (bool, Draw),
    rows: &mut [Rows; 4],
) {
    let truth = if fine { Accuracy::Fine } else { Accuracy::Default };
    for _ in 0..layers {
        let rubber = draws.rubber();
        let influence = Influence::new(&rubber).expect("a layer");
        let [quick, shares] = [Fineness::FAST, Fineness::DEFAULT].map(|fineness| {
            Shares::new(&influence, &Array::THESIS, Sampling::Area, fineness).expect("tables")
        });
        for _ in 0..pins {
            let drawn = draw(&mut draws, rubber);
            let mut exact = vec![0.0; 256];
            let force = drawn.reference_solution(truth, &shares, &mut exact);
            let kinds = [drawn.on_corner(), drawn.is_bar()].map(usize::from);
            let levels = [Accuracy::Fast, Accuracy::Default].into_iter().enumerate();
            for (n, level) in levels.take(if fine { 2 } else { 1 }) {
                let shares = if level == Accuracy::Fast { &quick } else { &shares };
                let row = measured(&drawn, level, shares, (&exact, force));
                rows[2 * n + kinds[n]].push((row, format!("{drawn:?}")));
            }
        }
    }
}

/// Compares long pins at the default level with the fine level.
fn sweep_long(count: usize, mut draws: Draws, rows: &mut [Rows; 4]) {
    for _ in 0..count {
        let (rubber, pitch_mm) = (draws.rubber(), draws.pitch_mm());
        let drawn = draws.long(rubber, pitch_mm);
        let influence = Influence::new(&rubber).expect("a layer");
        let array = Array { pitch_mm, ..Array::THESIS };
        let made = Shares::new(&influence, &array, Sampling::Area, Fineness::DEFAULT);
        let shares = made.expect("tables");
        let mut exact = vec![0.0; 256];
        // A bar that the fine level cannot solve has no reference.
        let mut truth = drawn.pin(Accuracy::Fine);
        let deep = Prescribed::PenetrationMm(drawn.delta_mm);
        let Ok(state) = truth.press(deep, drawn.pose.tilt_rad) else {
            println!("refused by the fine level: {drawn:?}");
            continue;
        };
        truth.image(&shares, drawn.pose.planar, &mut exact);
        let row = measured(&drawn, Accuracy::Default, &shares, (&exact, state.force_n));
        rows[2 + usize::from(drawn.is_bar())].push((row, format!("{pitch_mm} {drawn:?}")));
    }
}

fn summary(name: &str, rows: &mut [(Row, String)], worst: &mut String) {
    let whats: [What; 7] = [
        ("force", |row| row.force),
        ("centroid by penetration, mm", |row| row.centroid_mm),
        ("centroid by force, mm", |row| row.by_force_mm),
        ("image over its peak", |row| row.image),
        ("the same by force", |row| row.by_force),
        ("cold, us", |row| row.cold_us),
        ("warm, us", |row| row.warm_us),
    ];
    for (what, of) in whats {
        rows.sort_by(|a, b| of(&a.0).total_cmp(&of(&b.0)));
        let at = |part: f64| formatted(of(&rows[((rows.len() - 1) as f64 * part) as usize].0));
        println!("| {name}: {what} | {} | {} | {} |", at(0.5), at(0.9), at(1.0));
        worst.push_str(&format!("{name}, {what}: {}\n", rows[rows.len() - 1].1));
    }
}

fn formatted(value: f64) -> String {
    if value >= 1.0 { format!("{value:.0}") } else { format!("{value:.1e}") }
}

#[expect(clippy::disallowed_methods, reason = "a stopwatch for people, not lane code")]
fn median_us(mut call: impl FnMut(u32)) -> f64 {
    let mut times: Vec<f64> = (0..TIMING_ROUNDS)
        .map(|round| {
            let start = Instant::now();
            call(round);
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn measured(drawn: &Drawn, level: Accuracy, shares: &Shares, (exact, force): (&[f64], f64)) -> Row {
    let mut pin = drawn.pin(level);
    let mut image = vec![0.0; 256];
    let Pose { planar, tilt_rad } = drawn.pose;
    let mut one = |pin: &mut Pin, drive, tilt_rad| {
        let state = pin.press(drive, tilt_rad).expect("a contact");
        image.fill(0.0);
        pin.image(shares, planar, &mut image);
        (state.force_n, image.clone())
    };
    let (found, seen) = one(&mut pin, Prescribed::PenetrationMm(drawn.delta_mm), tilt_rad);
    let mut row = Row { force: (found / force - 1.0).abs(), ..Row::default() };
    row.centroid_mm = centroid_distance(shares.array(), &seen, exact);
    let peak = exact.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    let off = |seen: &[f64]| {
        seen.iter().zip(exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / peak
    };
    row.image = off(&seen);
    pin.release();
    let (_, seen) = one(&mut pin, Prescribed::ForceN(force), tilt_rad);
    row.by_force_mm = centroid_distance(shares.array(), &seen, exact);
    row.by_force = off(&seen);
    // Consecutive contacts differ as those of consecutive control periods do: pressed a little
    // more, tilted a little further.
    let mut nudged = |pin: &mut Pin, round: u32| {
        let f = f64::from(round % 3);
        let tilt_rad = tilt_rad * (1.0 + 0.005 * f);
        black_box(one(pin, Prescribed::ForceN(force * (1.0 + 0.003 * f)), tilt_rad));
    };
    row.warm_us = median_us(|round| nudged(&mut pin, round));
    row.cold_us = median_us(|round| {
        pin.release();
        nudged(&mut pin, round);
    });
    row
}

/// Distance of the centroids, mm.
fn centroid_distance(array: &Array, image: &[f64], exact: &[f64]) -> f64 {
    let of = |image: &[f64]| {
        let found = image_features(array, image, Part::Full).expect("features");
        [found.xc.expect("x"), found.yc.expect("y")]
    };
    let (a, b) = (of(image), of(exact));
    (a[0] - b[0]).abs().max((a[1] - b[1]).abs())
}
