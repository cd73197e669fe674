//! Times the plane contact solver on this machine: `cargo run --profile dist -p taktil-contact
//! --example plane_speed [-- NAME LEVEL]`. It prints the microseconds that one solution takes, best
//! of several rounds, for the cases whose names begin with NAME. This is not lane code.

use std::hint::black_box;
use std::time::Instant;
use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::contact_table::ContactTable;
use taktil_contact::plane::{Friction, Indenter, Load, Shape};
use taktil_contact::space::Prescribed;
use taktil_contact::space::infinite::InfiniteIndenter;
use taktil_contact::space::pin::{PlanarPose, Profile};
use taktil_contact::space::tactels::{Array, Sampling};

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
        for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
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
    if asked(0, "endless") {
        time_endless_images(&layer);
    }
    if asked(0, "chart") {
        time_contact_table(&layer);
    }
}

/// The image of a cylinder and of a bar without ends, 16 by 16 tactels, and what it starts from.
fn time_endless_images(layer: &Layer) {
    let bar = Profile::Bar { width_mm: 12.7 };
    for (name, profile) in [("cylinder", Profile::Cylinder { radius_mm: 23.0 }), ("bar", bar)] {
        let mut body = InfiniteIndenter::new(layer, profile, 0.1).expect("a body");
        let mut image = vec![0.0; Array::THESIS.len()];
        let mut one = |round: u32, rot_rad: f64| {
            let force = 0.7 * (1.0 + 0.003 * f64::from(round % 3));
            body.press(Prescribed::ForceN(force)).expect("a contact");
            let stand = PlanarPose { x_mm: 0.7, y_mm: -0.4, rot_rad };
            body.image(&Array::THESIS, Sampling::Area, stand, &mut image).expect("an image");
            black_box(&mut image);
        };
        let [slanted, upright] = [0.35, 0.0].map(|rot_rad| best(|round| one(round, rot_rad)));
        println!("{name} without ends, image: {slanted:.1} us slanted, {upright:.1} us upright");
    }
}

/// The bar's chart: a thousand readings a round, since one is near the clock's own resolution.
fn time_contact_table(layer: &Layer) {
    let x_mm: Vec<f64> = (-80..=80).map(|i| 0.125 * f64::from(i)).collect();
    for friction in [Friction::None, Friction::Proportional] {
        let mut chart = ContactTable::new(layer, 12.7, 6.35, friction, &x_mm).expect("a chart");
        let mut szz = vec![0.0; x_mm.len()];
        let mut many = |stress: bool| {
            best(|_| {
                for k in 0..1000 {
                    let q_n_mm = 0.25 + 0.0001 * f64::from(k);
                    black_box(chart.press(&Load { p_n_mm: 0.7, q_n_mm }).expect("a contact"));
                    if stress {
                        chart.base_szz_mpa(black_box(&mut szz));
                    }
                }
            }) / 1000.0
        };
        let (alone, all) = (many(false), many(true));
        println!("chart, {friction:?}: {alone:.3} us, with the stress at 161 places {all:.3} us");
    }
}
