//! Solves one contact, of the kind that a lane solves, over and over, so that its instructions can
//! be counted where clocks are not reliable: `valgrind --tool=callgrind
//! target/dist/examples/contact_count CASE N` for two N; the difference of the counts is that of
//! the additional solutions. `.ci/run` does that for all cases, against the most that each may
//! take. Without an argument it lists the cases. This is not lane code.

use std::hint::black_box;
use taktil_contact::Accuracy;
use taktil_contact::fem::{Elements, Kind, Mesh, Method};
use taktil_contact::layer::Layer;
use taktil_contact::plane::{Friction, Indenter, Load, Shape};
use taktil_contact::space::Prescribed;
use taktil_contact::space::pin::{Pin, PlanarPose, Profile};
use taktil_contact::space::radial::Influence;
use taktil_contact::space::sphere::Sphere;
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};

type Solve = Box<dyn FnMut(u32)>;
/// The name of a case and the constructor of its solver.
type Case = (&'static str, fn() -> Solve);

const CASES: [Case; 10] = [
    ("bar-warm", || plane(BAR, Friction::Proportional, Accuracy::Fast, 0.6, true)),
    ("bar-whole-warm", || plane(BAR, Friction::Proportional, Accuracy::Fast, 0.05, true)),
    ("bar-cold", || plane(BAR, Friction::Proportional, Accuracy::Default, 0.6, false)),
    ("cylinder-warm", || plane(CYLINDER, Friction::None, Accuracy::Fast, 0.0, true)),
    ("cylinder-cold", || plane(CYLINDER, Friction::None, Accuracy::Default, 0.0, false)),
    ("pin-warm", || pin(Accuracy::Fast, Fineness::FAST, true)),
    ("pin-cold", || pin(Accuracy::Default, Fineness::DEFAULT, false)),
    ("sphere-cold", || sphere(0.8, 10.0, 5.0)),
    ("sphere-wide-cold", || sphere(0.1, 100.0, 4000.0)),
    ("mesh-load", mesh),
];

const BAR: Shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
const CYLINDER: Shape = Shape::Cylinder { radius_mm: 23.0 };

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let case = |name: &String| CASES.iter().find(|(known, _)| known == name);
    let asked = match words.as_slice() {
        [name, count] => case(name).zip(count.parse::<u32>().ok()),
        _ => None,
    };
    let Some(((_, make), count)) = asked else {
        CASES.iter().for_each(|(name, _)| println!("{name}"));
        return;
    };
    let mut solve = make();
    (0..count).for_each(&mut solve);
}

/// The thesis's rubber.
fn rubber() -> Layer {
    Layer::new(0.8, 27.58, 0.49).expect("a sound layer")
}

/// Loads that change a little from one to the next, as between control periods.
fn plane(shape: Shape, friction: Friction, level: Accuracy, ratio: f64, warm: bool) -> Solve {
    let mut indenter = Indenter::new(&rubber(), shape, friction, level).expect("an indenter");
    Box::new(move |round| {
        if !warm {
            indenter.forget();
        }
        let p_n_mm = 2.0 + 0.02 * f64::from(round % 3);
        let q_n_mm = ratio * p_n_mm * (1.0 + 0.002 * f64::from(round % 2));
        black_box(indenter.press(&Load { p_n_mm, q_n_mm }).expect("a contact"));
    })
}

/// A pin of 8 mm over the whole array, a little tilted and turned, and its image.
fn pin(level: Accuracy, fineness: Fineness, warm: bool) -> Solve {
    let rubber = rubber();
    let influence = Influence::new(&rubber).expect("a layer");
    let shares = Shares::new(&influence, &Array::THESIS, Sampling::Area, fineness);
    let shares = shares.expect("tables");
    let profile = Profile::Cylinder { radius_mm: 4.0 };
    let mut pin = Pin::new(&rubber, profile, [-15.0, 15.0], 0.2, level).expect("a pin");
    let mut image = vec![0.0; Array::THESIS.len()];
    Box::new(move |round| {
        if !warm {
            pin.release();
        }
        let drive = Prescribed::ForceN(20.0 * (1.0 + 0.003 * f64::from(round % 3)));
        let tilt_rad = 0.002 * (1.0 + 0.01 * f64::from(round % 2));
        black_box(pin.press(drive, tilt_rad).expect("a contact"));
        let planar = PlanarPose { x_mm: 0.7, y_mm: -0.4, rot_rad: 0.35 };
        image.fill(0.0);
        pin.image(&shares, planar, black_box(&mut image));
    })
}

/// A sphere near the middle of the array, at the default level from no contact, and its image.
fn sphere(thickness_mm: f64, radius_mm: f64, force_n: f64) -> Solve {
    let rubber = Layer { thickness_mm, poisson: 0.5, ..rubber() };
    let mut sphere = Sphere::new(&rubber, radius_mm, Accuracy::Default).expect("a sphere");
    let mut image = vec![0.0; Array::THESIS.len()];
    Box::new(move |round| {
        sphere.release();
        let force = force_n * (1.0 + 0.003 * f64::from(round % 3));
        black_box(sphere.press(Prescribed::ForceN(force)).expect("a contact"));
        let place = [0.4, -0.3];
        sphere
            .image(&Array::THESIS, Sampling::Area, place, black_box(&mut image))
            .expect("an image");
    })
}

/// A load on the thesis's mesh, factored.
fn mesh() -> Solve {
    let mesh = Mesh::uniform(25.4, 0.8, 64, 4).expect("a mesh");
    let forces = vec![[0.0, -0.01]; mesh.columns()];
    let body = Elements::with_method(&rubber(), mesh, Kind::MeanDilatation, Method::Band);
    let body = body.expect("a factor");
    let mut out = body.response();
    Box::new(move |_| body.solve(black_box(&forces), &mut out))
}
