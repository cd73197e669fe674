//! Tests contact on several bonded layers: one layer in parts, limits, statics, and an independent
//! sum.

use taktil_contact::Accuracy;
use taktil_contact::field::LineLoad;
use taktil_contact::layer::Layer;
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::features::{moments, stack_moments};
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::{Contact, Friction, Indenter, Load, Shape, Spectrum};
use taktil_contact::stack::Stack;

const E_MPA: f64 = 27.58;
const BAR: Shape = Shape::Flat { width_mm: 6.0, height_mm: 6.35 };
const ROLL: Shape = Shape::Cylinder { radius_mm: 20.0 };

fn layer(t: f64, e: f64, nu: f64) -> Layer {
    Layer::new(t, e, nu).expect("a sound layer")
}

fn stack(layers: &[Layer]) -> Stack {
    Stack::new(layers).expect("a sound stack")
}

fn on(stack: &Stack, shape: Shape, friction: Friction) -> Indenter {
    Indenter::on_stack(stack, shape, friction, Accuracy::Fine).expect("a sound indenter")
}

fn close(a: &Contact, b: &Contact, bar: f64) {
    for (x, y) in [
        (a.delta_mm, b.delta_mm),
        (a.slope, b.slope),
        (a.x_left_mm, b.x_left_mm),
        (a.x_right_mm, b.x_right_mm),
    ] {
        assert!((x - y).abs() <= bar * y.abs().max(1e-9), "{a:?} {b:?}");
    }
    assert_eq!(a.mode, b.mode);
}

#[test]
fn two_equal_layers_are_one() {
    for nu in [0.3, 0.49, 0.5] {
        let whole = layer(0.8, E_MPA, nu);
        let parted = stack(&[layer(0.3, E_MPA, nu), layer(0.5, E_MPA, nu)]);
        for (shape, friction, q) in [
            (BAR, Friction::None, 0.0),
            (BAR, Friction::Proportional, 0.35),
            (ROLL, Friction::None, 0.0),
            (ROLL, Friction::Proportional, 0.3),
        ] {
            let load = Load { p_n_mm: 1.0, q_n_mm: q };
            let mut one = Indenter::new(&whole, shape, friction, Accuracy::Fine).expect("sound");
            let mut two = on(&parted, shape, friction);
            let (a, b) = (one.press(&load), two.press(&load));
            close(&b.expect("a contact"), &a.expect("a contact"), 1e-7);
            for depth in [0.05, 0.3, 0.8] {
                let (p, q) = (one.point_forces(depth), two.point_forces(depth));
                let whole_stress = Spectrum::new(&whole, &p, depth, 20.0);
                let parted_stress = Spectrum::of_stack(&parted, &q, depth, 20.0).expect("a sum");
                let peak = whole_stress.szz(0.0).abs();
                for x in [-4.0, -2.1, 0.0, 0.7, 2.9, 6.0] {
                    let off = parted_stress.szz(x) - whole_stress.szz(x);
                    assert!(off.abs() < 1e-7 * peak, "{nu} {depth} {x}: {off:e}");
                }
                let (m, n) = (moments(&whole, &p, depth).m, stack_moments(&parted, &q, depth).m);
                for (a, b) in m.iter().zip(n) {
                    assert!((a - b).abs() < 1e-7 * (1.0 + a.abs()), "{nu} {depth}: {a} {b}");
                }
            }
        }
    }
}

#[test]
fn a_stiff_layer_below_is_a_base_and_a_soft_one_on_top_is_all_there_is() {
    let rubber = layer(0.8, E_MPA, 0.49);
    let load = Load { p_n_mm: 1.0, q_n_mm: 0.1 };
    for shape in [BAR, ROLL] {
        let alone = Indenter::new(&rubber, shape, Friction::None, Accuracy::Fine);
        let alone = alone.expect("sound").press(&load).expect("a contact");
        let mut last = f64::INFINITY;
        for stiffer in [1e2, 1e4, 1e6] {
            let two = stack(&[rubber, layer(2.0, E_MPA * stiffer, 0.3)]);
            let found = on(&two, shape, Friction::None).press(&load).expect("a contact");
            let off = (found.delta_mm / alone.delta_mm - 1.0).abs();
            assert!(off < 20.0 / stiffer && off < last, "{stiffer}: {off}");
            last = off;
        }
    }
    // A very soft thin skin on the same rubber, a thousandth as stiff and a thirteenth as thick.
    let skin = layer(0.06, 1e-3 * E_MPA, 0.4);
    let two = stack(&[skin, layer(0.8, E_MPA, 0.49)]);
    let little = Load { p_n_mm: 0.01, q_n_mm: 0.0 };
    let found = on(&two, ROLL, Friction::None).press(&little).expect("a contact");
    let alone = Indenter::new(&skin, ROLL, Friction::None, Accuracy::Fine);
    let alone = alone.expect("sound").press(&little).expect("a contact");
    assert!((found.delta_mm / alone.delta_mm - 1.0).abs() < 0.02, "{found:?} {alone:?}");
}

/// A wide bar on compressible layers squeezes each like a spring.
#[test]
fn under_a_wide_bar_the_layers_are_springs_in_series() {
    let layers = [layer(0.2, 3.0, 0.3), layer(0.1, 40.0, 0.2), layer(0.3, 1.0, 0.35)];
    let mut bar =
        on(&stack(&layers), Shape::Flat { width_mm: 24.0, height_mm: 0.0 }, Friction::None);
    bar.descend(0.01).expect("a contact");
    let give = |l: &Layer| {
        let nu = l.poisson;
        l.thickness_mm * (1.0 + nu) * (1.0 - 2.0 * nu) / (l.youngs_mpa * (1.0 - nu))
    };
    let springs = 0.01 / layers.iter().map(give).sum::<f64>();
    assert!(
        (bar.pressure_mpa(0.0) / springs - 1.0).abs() < 1e-4,
        "{} {springs}",
        bar.pressure_mpa(0.0)
    );
}

/// Recovers the rigid shape by summing the line loads of the stack one by one.
#[test]
fn the_surface_takes_the_indenters_shape() {
    for layers in [
        vec![layer(0.4, 27.58, 0.49), layer(0.4, 5.0, 0.4)],
        vec![layer(0.3, 5.0, 0.5), layer(0.5, 27.58, 0.3), layer(0.4, 2.0, 0.45)],
    ] {
        let stack = stack(&layers);
        let mut roll = on(&stack, ROLL, Friction::None);
        let contact = roll.press(&Load { p_n_mm: 0.5, q_n_mm: 0.0 }).expect("a contact");
        let forces = roll.point_forces(0.02);
        // A sixth of the way between two places the sum over a logarithm is its integral.
        let unit = LineLoad { p_n_mm: 1.0, q_n_mm: 0.0 };
        for i in [forces.len() / 4, forces.len() / 2, 2 * forces.len() / 3] {
            let x = (5.0 * forces[i][0] + forces[i + 1][0]) / 6.0;
            let away: Vec<f64> = forces.iter().map(|f| x - f[0]).collect();
            let lines = stack.line(&unit, 0.0, &away).expect("points");
            let sink: f64 =
                lines.iter().zip(&forces).map(|(l, f)| -f[1] * l.uz_mm.expect("finite")).sum();
            let wanted = contact.delta_mm - (20.0 - (400.0 - x * x).sqrt());
            assert!((sink - wanted).abs() < 2e-3 * contact.delta_mm, "{x}: {sink} {wanted}");
        }
        let m = stack_moments(&stack, &roll.point_forces(0.7), 0.7).m;
        assert!((m[0] + 0.5).abs() < 1e-9);
        let mut rubbed = on(&stack, ROLL, Friction::Proportional);
        rubbed.press(&Load { p_n_mm: 0.5, q_n_mm: 0.1 }).expect("a contact");
        let forces = rubbed.point_forces(0.7);
        // Statics at any depth, and the stress itself summed.
        let first: f64 = forces.iter().map(|f| -f[0] * f[1] - 0.7 * f[2]).sum();
        let m = stack_moments(&stack, &forces, 0.7).m;
        assert!((m[1] - first).abs() < 1e-12);
        let stress = Spectrum::of_stack(&stack, &forces, 0.7, 85.0).expect("a sum");
        let sum = |n: i32| -> f64 {
            let place = |i: i32| 0.05 * f64::from(i);
            let power = |x: f64| (0..n).fold(1.0, |power, _| power * x);
            (-1600..=1600).map(|i| 0.05 * power(place(i)) * stress.szz(place(i))).sum()
        };
        for (n, m) in m.iter().enumerate() {
            let sum = sum(n as i32);
            assert!((sum - m).abs() < 1e-6 * (1.0 + m.abs()), "M{n}: {sum} {m}");
        }
    }
}

#[test]
fn cells_stand_on_a_stack_too() {
    let parted = stack(&[layer(0.3, E_MPA, 0.49), layer(0.5, E_MPA, 0.49)]);
    let edges: Vec<f64> = (0..=40).map(|i| -3.0 + 0.15 * f64::from(i)).collect();
    let step = |bed: SurfaceCompliance| {
        let heights = vec![0.0; bed.count()];
        let mut grip =
            FrictionalContact::new(bed, heights, FrictionLaw::Coulomb(0.4)).expect("a grip");
        grip.step(&LoadStep::Upright(Load { p_n_mm: 1.0, q_n_mm: 0.2 })).expect("a contact");
        grip.rigid()
    };
    let one = step(SurfaceCompliance::of_layer(&layer(0.8, E_MPA, 0.49), &edges).expect("a bed"));
    let two = step(SurfaceCompliance::of_stack(&parted, &edges).expect("a bed"));
    for (a, b) in one.iter().zip(two) {
        assert!((a - b).abs() < 1e-8 * a.abs().max(1e-6), "{a} {b}");
    }
}

#[test]
fn a_skin_too_thin_for_its_stack_is_refused_by_name() {
    let thin = stack(&[layer(1e-3, E_MPA, 0.49), layer(2.0, E_MPA, 0.49)]);
    let refused = Indenter::on_stack(&thin, ROLL, Friction::None, Accuracy::Default);
    assert_eq!(refused.expect_err("too thin").place, "layers");
    assert_eq!(
        SurfaceCompliance::of_stack(&thin, &[0.0, 1.0, 2.0]).expect_err("too thin").place,
        "layers"
    );
}

#[test]
fn the_stress_under_a_skin_too_thin_for_its_stack_is_refused_by_name() {
    // Near the surface the waves are as short as the skin is thin; deep down they are few.
    let thin = stack(&[layer(1e-9, E_MPA, 0.49), layer(2.0, E_MPA, 0.49)]);
    let forces = [[0.0, 1.0, 0.0]];
    for depth in [1e-12, 1e-10, 1e-9, 1e-6] {
        let refused = Spectrum::of_stack(&thin, &forces, depth, 20.0).err().expect("too many");
        assert_eq!(refused.place, "thickness_mm", "{depth}: {refused}");
    }
    for depth in [0.0, -1.0, f64::NAN] {
        let refused = Spectrum::of_stack(&thin, &forces, depth, 20.0).err().expect("no depth");
        assert_eq!(refused.place, "depth_mm", "{depth}: {refused}");
    }
    let deep = Spectrum::of_stack(&thin, &forces, 1.0, 20.0).expect("a sum");
    let whole = Spectrum::new(&layer(2.0, E_MPA, 0.49), &forces, 1.0, 20.0);
    assert!((deep.szz(0.0) - whole.szz(0.0)).abs() < 1e-7 * whole.szz(0.0).abs());
}
