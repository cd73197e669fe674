//! Times the plane contact solver on this machine: `cargo run --release -p taktil-mechanics
//! --example contact_speed [-- NAME LEVEL]`. Prints microseconds a solution, best of several
//! rounds, of the cases whose names begin so. Not lane code.

use std::hint::black_box;
use std::time::Instant;
use taktil_mechanics::contact::layer::Layer;
use taktil_mechanics::contact::plane::{Friction, Indenter, Level, Load, Shape};

#[expect(clippy::disallowed_methods, reason = "a stopwatch for people, not lane code")]
fn best(mut call: impl FnMut(u32)) -> f64 {
    let mut best = f64::INFINITY;
    for round in 0..200 {
        let start = Instant::now();
        call(round);
        best = best.min(start.elapsed().as_secs_f64() * 1e6);
    }
    best
}

fn main() {
    let layer = Layer::new(0.8, 27.58, 0.49).expect("a sound layer");
    let bar = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
    let cylinder = Shape::Cylinder { radius_mm: 23.0 };
    let cases = [
        ("bar, whole face", bar, Friction::Proportional, 0.05),
        ("bar, lifted", bar, Friction::Proportional, 0.6),
        ("bar, frictionless", bar, Friction::None, 0.4),
        ("cylinder", cylinder, Friction::None, 0.0),
        ("cylinder, friction", cylinder, Friction::Proportional, 0.3),
    ];
    println!("{:<22} {:>8} {:>10} {:>10}", "us a solution", "level", "warm", "cold");
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let asked = |place: usize, name: &str| wanted.get(place).is_none_or(|w| name.starts_with(w));
    for (name, shape, friction, ratio) in cases {
        for level in [Level::Fast, Level::Default, Level::Fine] {
            if !asked(0, name) || !asked(1, &format!("{level:?}")) {
                continue;
            }
            let mut indenter =
                Indenter::new(&layer, shape, friction, level).expect("a sound indenter");
            let load = |round: u32| {
                let p = 2.0 + 0.02 * f64::from(round % 3);
                Load { p_n_mm: p, q_n_mm: ratio * p * (1.0 + 0.002 * f64::from(round % 2)) }
            };
            let warm = best(|round| {
                black_box(indenter.press(&load(round)).expect("a contact"));
            });
            let cold = best(|round| {
                indenter.forget();
                black_box(indenter.press(&load(round)).expect("a contact"));
            });
            println!("{name:<22} {:>8} {warm:10.1} {cold:10.1}", format!("{level:?}"));
        }
    }
}
