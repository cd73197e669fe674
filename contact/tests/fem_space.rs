//! Tests the bricks of the layer: patch test, plane strain as a special case, orders of convergence
//! to the exact layer, locking and its cure, contact.

use taktil_contact::Accuracy;
use taktil_contact::fem::{Elements, Kind, Mesh, MeshContact, Method, graded_edges};
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::tactels::{Array, Sampling};

const E_MPA: f64 = 27.58;
const THICKNESS_MM: f64 = 0.8;

fn layer(nu: f64) -> Layer {
    Layer::new(THICKNESS_MM, E_MPA, nu).expect("a sound layer")
}

/// A quarter of a square block, with finer elements at x = y = 0, where it is on rollers.
fn quarter(half: f64, n: usize, nz: usize, grading: f64, order: usize) -> Mesh<3> {
    let x = graded_edges(half, n, grading).expect("edges");
    let z = graded_edges(THICKNESS_MM, nz, 0.0).expect("edges");
    Mesh::block(&x, &x, &z, order).expect("a mesh").with_rollers(0, 0).with_rollers(1, 0)
}

/// Any linear displacement is held by forces on the boundary alone, on distorted elements too.
#[test]
fn the_patch_test_is_passed() {
    for (kind, order) in
        [(Kind::MeanDilatation, 1), (Kind::Plain, 1), (Kind::MeanDilatation, 2), (Kind::Plain, 2)]
    {
        let edges = graded_edges(4.0, 4, 0.5).expect("edges");
        let heights = graded_edges(2.0, 3, 0.0).expect("edges");
        let mut mesh = Mesh::block(&edges, &edges, &heights, order).expect("a mesh");
        let counts = mesh.counts();
        let inner = |at: [usize; 3]| (0..3).all(|axis| at[axis] > 0 && at[axis] + 1 < counts[axis]);
        let mut state: u64 = 3;
        for node in 0..mesh.nodes.len() {
            if !inner(mesh.at(node)) {
                continue;
            }
            for place in &mut mesh.nodes[node] {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let unit = f64::from((state >> 33) as u32) / f64::from(1_u32 << 31);
                *place += 0.2 / order as f64 * (unit - 0.5);
            }
        }
        let body = Elements::new(&layer(0.49), mesh.clone(), kind).expect("elements");
        let linear = |[x, y, z]: &[f64; 3]| {
            [
                0.1 + 0.02 * x - 0.03 * z + 0.01 * y,
                -0.2 + 0.01 * x - 0.05 * z + 0.03 * y,
                0.3 - 0.02 * x + 0.04 * y + 0.05 * z,
            ]
        };
        let moved: Vec<[f64; 3]> = mesh.nodes.iter().map(linear).collect();
        let forces = body.holding_forces(&moved).expect("sound elements");
        for (node, force) in forces.iter().enumerate() {
            if inner(mesh.at(node)) {
                let most = force.iter().fold(0.0_f64, |most, f| most.max(f.abs()));
                assert!(most < 1e-11, "{kind:?} {order} {:?}: {most:e}", mesh.at(node));
            }
        }
    }
}

/// Bricks between rollers across y are the quadrilaterals of plane strain; both methods agree.
#[test]
fn between_rollers_it_is_plane_strain() {
    for (order, nu) in [(1, 0.49), (2, 0.49), (1, 0.5), (2, 0.5)] {
        let x = graded_edges(6.0, 8, 2.0).expect("edges");
        let y = [0.0, 0.7, 1.5];
        let z = graded_edges(THICKNESS_MM, 3, 0.0).expect("edges");
        let flat = Mesh::from_edges([&x, &z], order).expect("a mesh").with_rollers(0, 0);
        let mut deep = Mesh::block(&x, &y, &z, order).expect("a mesh").with_rollers(0, 0);
        deep = deep.with_rollers(1, 0).with_rollers(1, 1);
        let flat = Elements::new(&layer(nu), flat, Kind::MeanDilatation).expect("elements");
        let mut plane = flat.response();
        let forces: Vec<[f64; 2]> =
            (0..flat.mesh().columns()).map(|i| [0.02 * i as f64, -1.0 / (1 + i) as f64]).collect();
        flat.solve(&forces, &mut plane);
        let stress = flat.base_szz_mpa(&plane);
        for method in [Method::Band, Method::Sparse] {
            let body =
                Elements::with_method(&layer(nu), deep.clone(), Kind::MeanDilatation, method);
            let body = body.expect("elements");
            let across = body.mesh().counts()[1];
            // Shares of the nodes along y in a force per length.
            let shares: Vec<f64> = match order {
                1 => vec![0.35, 0.75, 0.4],
                _ => vec![0.7 / 6.0, 1.4 / 3.0, 0.25, 1.6 / 3.0, 0.8 / 6.0],
            };
            assert_eq!(across, shares.len());
            let spread = |i: usize| {
                let [q, p] = forces[i / across];
                [q, 0.0, p].map(|f| f * shares[i % across])
            };
            let loads: Vec<[f64; 3]> = (0..body.mesh().columns()).map(spread).collect();
            let mut out = body.response();
            body.solve(&loads, &mut out);
            for (i, s) in body.base_szz_mpa(&out).iter().enumerate() {
                let wanted = stress[i / across];
                assert!((s - wanted).abs() < 1e-9, "{order} {nu} {method:?} {i}: {s} {wanted}");
            }
            let inside = |z: f64| {
                let a = flat.stress_mpa(&plane, &[1.1, z]).expect("inside");
                let b = body.stress_mpa(&out, &[1.1, 0.9, z]).expect("inside");
                (a[0] - b[0]).abs().max((a[1] - b[2]).abs())
            };
            assert!(inside(0.3) < 1e-9 && inside(0.8) < 1e-9);
        }
    }
}

/// Width of the Gaussian pressure exp(-r^2/(2 s^2)) MPa.
const GAUSS_MM: f64 = 0.8;

/// Base stress of the exact layer under it: a Hankel integral over the transfer function.
fn exact(layer: &Layer, r_mm: f64) -> f64 {
    let transfer = layer.transfer();
    let (count, top) = (2000, 9.0 / GAUSS_MM);
    let step = top / f64::from(count);
    let wave = |i: u32| {
        let k = step * f64::from(i);
        let weight = if i == 0 || i == count {
            1.0
        } else if i % 2 == 1 {
            4.0
        } else {
            2.0
        };
        let square = GAUSS_MM * GAUSS_MM;
        weight
            * k
            * square
            * libm::exp(-0.5 * k * k * square)
            * libm::j0(k * r_mm)
            * transfer.base_normal(k * layer.thickness_mm)
    };
    -(0..=count).map(wave).sum::<f64>() * step / 3.0
}

/// Forces on the nodes of a line under the Gaussian: integrals with the shape functions.
fn line_forces(x: &[f64], order: usize) -> Vec<f64> {
    let mut out = vec![0.0; x.len()];
    for start in (0..x.len() - 1).step_by(order) {
        let (low, length) = (x[start], x[start + order] - x[start]);
        for k in 0..200 {
            let s = (f64::from(k) + 0.5) / 200.0;
            let at = low + s * length;
            let p = libm::exp(-0.5 * at * at / (GAUSS_MM * GAUSS_MM)) * length / 200.0;
            let shapes = match order {
                1 => [1.0 - s, s, 0.0],
                _ => [(1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)],
            };
            for (slot, shape) in out[start..].iter_mut().zip(shapes).take(order + 1) {
                *slot += p * shape;
            }
        }
    }
    out
}

/// Largest error of the base stress within 3 mm, in parts of the peak.
fn error(nu: f64, n: usize, nz: usize, order: usize, kind: Kind) -> f64 {
    let layer = layer(nu);
    let body = Elements::new(&layer, quarter(7.2, n, nz, 3.0, order), kind).expect("elements");
    let x = body.mesh().line_mm(0);
    let along = line_forces(&x, order);
    let forces: Vec<[f64; 3]> = (0..body.mesh().columns())
        .map(|c| [0.0, 0.0, -along[c / x.len()] * along[c % x.len()]])
        .collect();
    let mut out = body.response();
    body.solve(&forces, &mut out);
    let total: f64 = out.reactions.iter().map(|r| r[2]).sum();
    let whole = core::f64::consts::FRAC_PI_2 * GAUSS_MM * GAUSS_MM;
    assert!((total / whole - 1.0).abs() < 1e-4, "statics: {total} {whole}");
    let szz = body.base_szz_mpa(&out);
    let peak = exact(&layer, 0.0).abs();
    let mut worst = 0.0_f64;
    for (i, a) in x.iter().enumerate() {
        for (j, b) in x.iter().enumerate().take(i + 1) {
            let r = (a * a + b * b).sqrt();
            if r < 3.0 {
                let off = (szz[i * x.len() + j] - exact(&layer, r)).abs() / peak;
                worst = worst.max(off);
            }
        }
    }
    worst
}

#[test]
fn the_base_stress_converges_at_the_elements_order_at_any_poisson_ratio() {
    // Order 1 at second order, order 2, whose stress is recovered smoothly, towards fourth.
    for (nu, coarse) in [(-0.4, 8), (0.0, 8), (0.3, 8), (0.49, 8), (0.499_999, 8), (0.5, 8)] {
        let error = |n: usize, order| error(nu, n, n / 4, order, Kind::MeanDilatation);
        let (one, two) = (error(coarse, 1), error(2 * coarse, 1));
        let order = libm::log2(one / two);
        // A negative ratio makes the peak under the load sharper: a quarter more error on one mesh.
        let bound = if nu < 0.0 { 0.025 } else { 0.02 };
        assert!((1.9..2.1).contains(&order) && two < bound, "nu {nu}: {one} {two} {order}");
        let (one, two) = (error(coarse, 2), error(coarse + 4, 2));
        let order = libm::log(one / two) / libm::log(1.5);
        assert!(order > 3.4 && two < 0.005, "nu {nu}, order 2: {one} {two} {order}");
    }
}

#[test]
fn the_plain_brick_locks_and_ours_does_not() {
    let of = |kind| error(0.499_999, 16, 4, 1, kind);
    let (plain, ours) = (of(Kind::Plain), of(Kind::MeanDilatation));
    assert!(plain > 0.2 && ours < 0.1 * plain, "{plain} {ours}");
    let block = quarter(4.0, 2, 1, 0.0, 1);
    assert!(Elements::new(&layer(0.5), block, Kind::Plain).is_err());
}

const RADIUS_MM: f64 = 10.0;

fn ball(mesh: &Mesh<3>, middle: [f64; 2]) -> Vec<f64> {
    let height = |column: usize| {
        let [x, y, _] = mesh.nodes[mesh.surface_node(column)];
        let square = (x - middle[0]) * (x - middle[0]) + (y - middle[1]) * (y - middle[1]);
        if square < 0.9 * RADIUS_MM * RADIUS_MM {
            square / (RADIUS_MM + (RADIUS_MM * RADIUS_MM - square).sqrt())
        } else {
            f64::INFINITY
        }
    };
    (0..mesh.columns()).map(height).collect()
}

fn press(nu: f64, n: usize, order: usize, middle: [f64; 2]) -> MeshContact {
    let mesh = quarter(7.2, n, n / 5, 3.0, order);
    let body = Elements::new(&layer(nu), mesh, Kind::MeanDilatation).expect("elements");
    let heights = ball(body.mesh(), middle);
    MeshContact::new(body, heights).expect("a press")
}

#[test]
fn a_sphere_on_bricks_tends_to_the_exact_layer() {
    let shape = Shape::Sphere { radius_mm: RADIUS_MM };
    for (nu, order, meshes) in [(0.49, 1, [10, 20]), (0.5, 1, [10, 20]), (0.49, 2, [5, 10])] {
        let mut scene =
            Scene::new(&layer(nu), shape, &Array::THESIS, Sampling::Area, Accuracy::Fine)
                .expect("a scene");
        let exact =
            scene.press(Prescribed::PenetrationMm(0.05), Pose::default()).expect("a contact");
        let miss = meshes.map(|n| {
            let mut press = press(nu, n, order, [0.0; 2]);
            let quarter = press.press(Prescribed::PenetrationMm(0.05)).expect("a contact");
            assert!(press.forces_n().iter().all(|f| *f >= 0.0) && press.residual() < 1e-10);
            // The same by force, and the reactions carry it.
            let again = press.press(Prescribed::ForceN(quarter)).expect("a contact");
            assert!((again / quarter - 1.0).abs() < 1e-9);
            assert!((press.penetration_mm() / 0.05 - 1.0).abs() < 1e-9);
            let carried: f64 = press.response().reactions.iter().map(|r| r[2]).sum();
            assert!((carried / quarter - 1.0).abs() < 1e-9, "{carried} {quarter}");
            (4.0 * quarter / exact.force_n - 1.0).abs()
        });
        assert!(miss[1] < 0.5 * miss[0] && miss[1] < 0.07, "nu {nu} order {order}: {miss:?}");
    }
}

/// Bricks that are finer at the free end x = 7.2, with symmetry at y = 0 and free other sides.
fn mesh_finer_at_the_end(n: usize, across: usize, nz: usize) -> MeshContact {
    let x = graded_edges(7.2, n, 9.0).expect("edges");
    let x: Vec<f64> = x.iter().rev().map(|x| 7.2 - x).collect();
    let y = graded_edges(3.6, across, 3.0).expect("edges");
    let z = graded_edges(THICKNESS_MM, nz, 0.0).expect("edges");
    let mesh = Mesh::block(&x, &y, &z, 1).expect("a mesh").with_rollers(1, 0);
    let body = Elements::new(&layer(0.49), mesh, Kind::MeanDilatation).expect("elements");
    let heights = ball(body.mesh(), [0.0; 2]);
    MeshContact::new(body, heights).expect("a press")
}

#[test]
fn a_sphere_is_carried_by_less_and_less_towards_and_past_the_edge_of_the_layer() {
    let shape = Shape::Sphere { radius_mm: RADIUS_MM };
    let mut scene = Scene::new(&layer(0.49), shape, &Array::THESIS, Sampling::Area, Accuracy::Fine)
        .expect("a scene");
    let endless = scene.press(Prescribed::PenetrationMm(0.05), Pose::default()).expect("a contact");
    let places = [4.8, 5.4, 6.0, 6.6, 7.2, 7.5, 7.8];
    let [coarse, fine] = [(18, 15, 3), (24, 20, 4)].map(|(n, across, nz)| {
        let mut press = Some(mesh_finer_at_the_end(n, across, nz));
        places.map(|x| {
            let before = press.take().expect("a press");
            let heights = ball(before.body().mesh(), [x, 0.0]);
            let mut here = before.with_profile(heights).expect("a press");
            let half = here.press(Prescribed::PenetrationMm(0.05)).expect("a contact");
            press = Some(here);
            2.0 * half / endless.force_n
        })
    });
    for parts in [coarse, fine] {
        assert!(parts.windows(2).all(|pair| pair[1] > 0.0 && pair[1] < pair[0]), "{parts:?}");
    }
    // Three thicknesses from the end the mesh's own error is all there is.
    assert!((0.95..1.0).contains(&fine[0]) && fine[0] > coarse[0], "{coarse:?} {fine:?}");
    for (x, (a, b)) in places.iter().zip(coarse.iter().zip(fine)) {
        let bar = if *x < 6.0 { 0.03 } else { 0.01 };
        assert!((a / b - 1.0).abs() < bar, "{x}: {a} {b}");
    }
}

#[test]
fn a_press_past_the_layer_or_that_pulls_is_refused() {
    let mut press = press(0.49, 10, 1, [0.0; 2]);
    let far = ball(press.body().mesh(), [20.0, 0.0]);
    press = press.with_profile(far).expect("a press");
    let refused = press.press(Prescribed::PenetrationMm(0.05)).expect_err("no body over the layer");
    assert_eq!(refused.place, "penetration_mm");
    let heights = ball(press.body().mesh(), [0.0; 2]);
    let mut press = press.with_profile(heights).expect("a press");
    assert_eq!(press.press(Prescribed::PenetrationMm(-0.1)).expect("apart").to_bits(), 0);
    assert_eq!(press.press(Prescribed::ForceN(0.0)).expect("apart").to_bits(), 0);
    assert_eq!(press.press(Prescribed::ForceN(-1.0)).expect_err("pulls").place, "force_n");
    assert!(press.press(Prescribed::ForceN(f64::NAN)).is_err());
    // Three hundred contacts are made and released, and each equals the first one.
    let first = press.press(Prescribed::PenetrationMm(0.03)).expect("a contact");
    for k in 0..300 {
        let depth = 0.03 * f64::from(k % 5) / 4.0;
        let force = press.press(Prescribed::PenetrationMm(depth)).expect("a contact");
        assert!(k % 5 != 4 || (force / first - 1.0).abs() < 1e-12);
    }
}

#[test]
fn invalid_blocks_are_refused() {
    let edges = [0.0, 1.0, 2.0];
    assert_eq!(Mesh::block(&edges, &edges, &[0.0, 0.8], 3).expect_err("order 3").place, "order");
    assert!(Mesh::block(&edges, &[0.0], &[0.0, 0.8], 1).is_err());
    assert!(Mesh::block(&edges, &[0.0, f64::NAN], &[0.0, 0.8], 1).is_err());
    assert!(Mesh::block(&edges, &edges, &[0.1, 0.8], 1).is_err());
    assert!(graded_edges(1.0, 0, 0.0).is_err() && graded_edges(0.0, 3, 0.0).is_err());
    assert!(graded_edges(1.0, 3, f64::NAN).is_err());
    let many = graded_edges(1.0, 1000, 0.0).expect("edges");
    assert!(Mesh::block(&many, &many, &edges, 1).is_err());
    let body = Elements::new(&layer(0.49), quarter(4.0, 2, 1, 0.0, 1), Kind::MeanDilatation)
        .expect("elements");
    assert!(MeshContact::new(body.clone(), vec![0.0; 3]).is_err());
    assert!(MeshContact::new(body, vec![f64::NAN; 9]).is_err());
}
