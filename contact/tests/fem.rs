//! Tests the finite elements of the layer: patch test, orders of convergence, locking and its cure,
//! contact.

use taktil_contact::Accuracy;
use taktil_contact::fem::{Elements, Kind, Mesh};
use taktil_contact::layer::Layer;
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::plane::{Friction, Indenter, Load, PointForce, Shape, Spectrum};

const E_MPA: f64 = 27.58;

fn layer(nu: f64) -> Layer {
    Layer::new(0.8, E_MPA, nu).expect("a sound layer")
}

fn elements(nu: f64, nx: usize, nz: usize, kind: Kind) -> Elements {
    let mesh = Mesh::uniform(25.4, 0.8, nx, nz).expect("a mesh");
    Elements::new(&layer(nu), mesh, kind).expect("elements")
}

/// Any linear displacement is held by forces on the boundary alone, on distorted elements too.
#[test]
fn the_patch_test_is_passed() {
    for kind in [Kind::MeanDilatation, Kind::Plain] {
        let mut mesh = Mesh::uniform(6.0, 2.0, 6, 4).expect("a mesh");
        let mut state: u64 = 3;
        for i in 1..6 {
            for j in 1..4 {
                let node = mesh.node([i, j]);
                for axis in 0..2 {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    let unit = f64::from((state >> 33) as u32) / f64::from(1_u32 << 31);
                    mesh.nodes[node][axis] += 0.25 * (unit - 0.5);
                }
            }
        }
        let body = Elements::new(&layer(0.49), mesh.clone(), kind).expect("elements");
        let linear = |[x, z]: &[f64; 2]| [0.1 + 0.02 * x - 0.03 * z, -0.2 + 0.01 * x - 0.05 * z];
        let moved: Vec<[f64; 2]> = mesh.nodes.iter().map(linear).collect();
        let forces = body.holding_forces(&moved).expect("sound elements");
        for i in 1..6 {
            for j in 1..4 {
                let [x, z] = forces[mesh.node([i, j])];
                assert!(x.abs() < 1e-12 && z.abs() < 1e-12, "{kind:?} {i} {j}: {x:e} {z:e}");
            }
        }
    }
}

/// A smooth pressure (1 + cos)/2 over |x| < 3 mm, as nodal forces and as points.
fn smooth_pressure(x: f64) -> f64 {
    if x.abs() < 3.0 { 0.5 + 0.5 * libm::cos(core::f64::consts::PI * x / 3.0) } else { 0.0 }
}

fn smooth_pressure_forces() -> Vec<PointForce> {
    (0..600)
        .map(|i| (f64::from(i) + 0.5) * 0.01 - 3.0)
        .map(|x| [x, 0.01 * smooth_pressure(x), 0.0])
        .collect()
}

/// Largest error of the base stress in |x| < 8 mm, in parts of the peak.
fn error(nu: f64, nx: usize, nz: usize, kind: Kind) -> f64 {
    let layer = layer(nu);
    let body = elements(nu, nx, nz, kind);
    let x = body.mesh().row_mm(nz);
    let h = x[1] - x[0];
    // Consistent forces by a fine rule on the hat functions.
    let hat = |middle: f64| -> f64 {
        (0..200)
            .map(|k| {
                let s = (f64::from(k) + 0.5) / 100.0 - 1.0;
                (1.0 - s.abs()) * smooth_pressure(middle + s * h) * h / 100.0
            })
            .sum()
    };
    let forces: Vec<[f64; 2]> = x.iter().map(|x| [0.0, -hat(*x)]).collect();
    let mut response = body.response();
    body.solve(&forces, &mut response);
    let total: f64 = response.reactions.iter().map(|r| r[1]).sum();
    assert!((total - 3.0).abs() < 1e-6, "statics: {total}");
    let exact = Spectrum::new(&layer, &smooth_pressure_forces(), 0.8, 20.0);
    let peak = exact.szz(0.0).abs();
    let found = body.base_szz_mpa(&response);
    let near = x.iter().zip(&found).filter(|(x, _)| x.abs() < 8.0);
    near.map(|(x, s)| (s - exact.szz(*x)).abs() / peak).fold(0.0, f64::max)
}

#[test]
fn the_base_stress_converges_at_second_order_at_any_poisson_ratio() {
    for nu in [-0.9, -0.4, 0.0, 0.3, 0.49, 0.499_999, 0.5] {
        let e: Vec<f64> =
            [1, 2, 4].map(|k| error(nu, 64 * k, 4 * k, Kind::MeanDilatation)).to_vec();
        let orders = [libm::log2(e[0] / e[1]), libm::log2(e[1] / e[2])];
        assert!(e[2] < 2e-3, "nu {nu}: {e:?}");
        assert!(orders[1] > 1.7 && orders[1] < 2.6, "nu {nu}: {e:?} {orders:?}");
    }
}

#[test]
fn the_plain_element_locks_and_ours_does_not() {
    let (plain, ours) =
        (error(0.499_999, 128, 8, Kind::Plain), error(0.499_999, 128, 8, Kind::MeanDilatation));
    assert!(plain > 0.05 && ours < 0.05 * plain, "{plain} {ours}");
    let mesh = Mesh::uniform(25.4, 0.8, 8, 2).expect("a mesh");
    assert!(Elements::new(&layer(0.5), mesh, Kind::Plain).is_err());
}

#[test]
fn factored_once_it_answers_many_loads() {
    let body = elements(0.49, 64, 4, Kind::MeanDilatation);
    assert_eq!(body.unknowns(), 520);
    let mut response = body.response();
    for i in [0, 13, 32, 64] {
        let mut forces = vec![[0.0; 2]; 65];
        forces[i] = [0.3, -1.0];
        body.solve(&forces, &mut response);
        let sum = |axis: usize| response.reactions.iter().map(|r| r[axis]).sum::<f64>();
        assert!((sum(0) + 0.3).abs() < 1e-12 && (sum(1) - 1.0).abs() < 1e-12);
        // Moments about the base's middle: each node's force times its place.
        let x = body.mesh().row_mm(0);
        let moment: f64 = x.iter().zip(&response.reactions).map(|(x, r)| -x * r[1]).sum();
        assert!((moment + x[i] + 0.3 * 0.8).abs() < 1e-11, "{moment}");
    }
}

const BAR: Shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
const ROLL: Shape = Shape::Cylinder { radius_mm: 22.9 };

/// Errors of a contact on a mesh: of its force, of the base's peak, of the base's stress anywhere
/// in parts of the peak.
struct MeshErrors([f64; 3]);

/// The contact of the exact layer.
struct ExactContact {
    /// Stress at the base.
    stress: Spectrum,
    /// Largest pressure at the base (MPa).
    peak_mpa: f64,
    /// Descent (mm).
    delta_mm: f64,
}

fn exact(nu: f64, shape: Shape, friction: Friction, load: &Load) -> ExactContact {
    let mut exact = Indenter::new(&layer(nu), shape, friction, Accuracy::Fine).expect("sound");
    let delta_mm = exact.press(load).expect("a contact").delta_mm;
    let stress = Spectrum::new(&layer(nu), &exact.point_forces(0.8), 0.8, 30.0);
    let peak_mpa = (-1400..1400).map(|i| -stress.szz(0.005 * f64::from(i))).fold(0.0, f64::max);
    ExactContact { stress, peak_mpa, delta_mm }
}

/// Errors of the base's peak and stress under the forces of a contact.
fn base_errors(
    body: &Elements,
    grip: &FrictionalContact,
    middle: f64,
    exact: &ExactContact,
) -> [f64; 2] {
    let ExactContact { stress, peak_mpa, .. } = exact;
    let response =
        body.response_to_contact(grip.normal_n_mm(), grip.tangential_n_mm()).expect("finite");
    let szz = body.base_szz_mpa(&response);
    let most = szz.iter().fold(0.0_f64, |most, s| most.max(-s));
    let x = body.mesh().row_mm(0);
    let off = x.iter().zip(&szz).map(|(x, s)| (s - stress.szz(x - middle)).abs() / peak_mpa);
    [(most / peak_mpa - 1.0).abs(), off.fold(0.0, f64::max)]
}

/// An upright bar, or the cylinder at the worst of four places in an element.
fn upright_errors(nu: f64, shape: Shape, k: usize) -> MeshErrors {
    let load = Load { p_n_mm: if shape == BAR { 0.7 } else { 2.0 }, q_n_mm: 0.0 };
    let exact = exact(nu, shape, Friction::None, &load);
    let body = elements(nu, 64 * k, 4 * k, Kind::MeanDilatation);
    let quarter = 25.4 / 64.0 / k as f64 / 4.0;
    let mut worst = [0.0_f64; 3];
    for part in 0..if shape == BAR { 1 } else { 4 } {
        let middle = quarter * f64::from(part);
        let press = if shape == BAR { bar_at } else { cylinder_at };
        let mut grip = press(&body, middle);
        grip.step(&LoadStep::Move { dz_mm: exact.delta_mm, dx_mm: 0.0 }).expect("a contact");
        let force = (grip.load().p_n_mm / load.p_n_mm - 1.0).abs();
        grip.step(&LoadStep::Upright(load)).expect("a contact");
        let [peak, stress] = base_errors(&body, &grip, middle, &exact);
        for (worst, one) in worst.iter_mut().zip([force, peak, stress]) {
            *worst = worst.max(one);
        }
    }
    MeshErrors(worst)
}

/// The edge of a bar stays at a node, and its error is of first order, because the infinite
/// pressure at the corner is spread over an element. The edge of a cylinder moves from node to
/// node, so that its error is of second order but jumps; the order is therefore measured over two
/// halvings of the mesh.
#[test]
fn contact_on_the_mesh_tends_to_the_exact_layer() {
    for nu in [0.49, 0.3, 0.5, 0.0, -0.4] {
        // Force, peak and stress: least order, and error at most on the finest mesh.
        for (shape, bars) in [
            (BAR, [(0.98, 0.006), (0.87, 0.004), (1.05, 0.03)]),
            (ROLL, [(1.85, 0.0065), (1.8, 0.0065), (1.7, 0.0055)]),
        ] {
            let miss = [1, 2, 4].map(|k| upright_errors(nu, shape, k).0);
            for (i, (order, bar)) in bars.into_iter().enumerate() {
                let found = 0.5 * libm::log2(miss[0][i] / miss[2][i]);
                let all = [0, 1, 2].map(|k| miss[k][i]);
                assert!(found > order && all[2] < bar, "nu {nu} {shape:?} {i}: {found} {all:?}");
                assert!(all[1] < all[0] && all[2] < all[1], "nu {nu} {shape:?} {i}: {all:?}");
            }
        }
    }
}

/// The same holds for bars that tilt, some of them with a lifted edge, with friction in proportion
/// to the pressure.
#[test]
fn a_tilted_bar_on_the_mesh_tends_to_the_exact_layer() {
    for (nu, ratio) in [(0.49, 0.1), (0.49, 0.7), (0.5, 0.3), (0.0, 0.3), (-0.4, 0.3)] {
        let load = Load { p_n_mm: 0.7, q_n_mm: 0.7 * ratio };
        let exact = exact(nu, BAR, Friction::Proportional, &load);
        let miss = [1, 2, 4].map(|k| {
            let body = elements(nu, 64 * k, 4 * k, Kind::MeanDilatation);
            let bed = body.compliance().expect("a bed");
            let face = |x: &f64| if x.abs() < 6.351 { 0.0 } else { f64::INFINITY };
            let heights = bed.x_mm.iter().map(face).collect();
            let mut grip = FrictionalContact::new(bed, heights, FrictionLaw::Proportional(ratio))
                .expect("a grip");
            grip.step(&LoadStep::Loads { load, height_mm: 6.35 }).expect("a contact");
            base_errors(&body, &grip, 0.0, &exact)
        });
        for (i, (order, bar)) in [(1.0, 0.008), (1.05, 0.03)].into_iter().enumerate() {
            let all = miss.map(|miss| miss[i]);
            let found = 0.5 * libm::log2(all[0] / all[2]);
            assert!(found > order && all[2] < bar, "nu {nu} ratio {ratio} {i}: {found} {all:?}");
            assert!(all[1] < all[0] && all[2] < all[1], "nu {nu} ratio {ratio} {i}: {all:?}");
        }
    }
}

/// Prescribed displacement of every surface node found inside the cylinder, step by step.
#[test]
fn a_cylinder_moved_in_small_steps_grows_its_contact_without_slip() {
    let shape = Shape::Cylinder { radius_mm: 22.9 };
    let exact = NoSlip::descend(&layer(0.49), shape, 0.0326).expect("a contact");
    let body = elements(0.49, 192, 12, Kind::MeanDilatation);
    let bed = body.compliance().expect("a bed");
    let round = |x: &f64| x * x / (22.9 + (22.9_f64 * 22.9 - x * x).sqrt());
    let heights = bed.x_mm.iter().map(round).collect();
    let mut grip =
        FrictionalContact::new(bed, heights, FrictionLaw::Coulomb(f64::INFINITY)).expect("a grip");
    for k in 1..=30 {
        let dz_mm = 0.0326 * f64::from(k) / 30.0;
        grip.step(&LoadStep::Move { dz_mm, dx_mm: 0.0 }).expect("a contact");
    }
    let p = grip.load().p_n_mm;
    assert!((p / exact.p_n_mm - 1.0).abs() < 0.03, "{p} {}", exact.p_n_mm);
}

/// Descent of the indenters at the edge of the layer.
const PENETRATION_MM: f64 = 0.02;

/// The thesis's cylinder at a place, pressed without friction: forces on the surface's nodes.
fn cylinder_at(body: &Elements, middle: f64) -> FrictionalContact {
    let bed = body.compliance().expect("a bed");
    let round = |x: &f64| {
        let square = (x - middle) * (x - middle);
        let under = 22.9_f64 * 22.9 - square;
        if under > 0.0 { square / (22.9 + under.sqrt()) } else { f64::INFINITY }
    };
    let heights = bed.x_mm.iter().map(round).collect();
    let mut grip = FrictionalContact::new(bed, heights, FrictionLaw::Free).expect("a grip");
    grip.step(&LoadStep::Move { dz_mm: PENETRATION_MM, dx_mm: 0.0 }).expect("a contact");
    grip
}

/// A bar of 12.7 mm at a place.
fn bar_at(body: &Elements, middle: f64) -> FrictionalContact {
    let bed = body.compliance().expect("a bed");
    let face = |x: &f64| if (x - middle).abs() < 6.36 { 0.0 } else { f64::INFINITY };
    let heights: Vec<f64> = bed.x_mm.iter().map(face).collect();
    let mut grip = FrictionalContact::new(bed, heights, FrictionLaw::Free).expect("a grip");
    grip.step(&LoadStep::Move { dz_mm: PENETRATION_MM, dx_mm: 0.0 }).expect("a contact");
    grip
}

/// The base carries the force, and its moment about the middle of the base is the force's.
fn check_statics(body: &Elements, grip: &FrictionalContact, place: &str) {
    let response =
        body.response_to_contact(grip.normal_n_mm(), grip.tangential_n_mm()).expect("finite");
    let p = grip.load().p_n_mm;
    let carried: f64 = response.reactions.iter().map(|r| r[1]).sum();
    let along: f64 = response.reactions.iter().map(|r| r[0]).sum();
    assert!((carried - p).abs() < 1e-9 * p && along.abs() < 1e-9 * p, "{place}: {carried} {p}");
    let lever = |x: &[f64], forces: &[f64]| x.iter().zip(forces).map(|(x, f)| x * f).sum::<f64>();
    let up: Vec<f64> = response.reactions.iter().map(|r| r[1]).collect();
    let below = lever(&body.mesh().row_mm(0), &up);
    let above = lever(&grip.compliance().x_mm, grip.normal_n_mm());
    assert!((below - above).abs() < 1e-9 * p * 12.7, "{place}: moments {below} {above}");
}

#[test]
fn an_indenter_at_and_past_the_edge_of_the_layer() {
    let body = elements(0.49, 128, 4, Kind::MeanDilatation);
    let step = 25.4 / 128.0;
    type MeshContact = fn(&Elements, f64) -> FrictionalContact;
    // At the last place the cylinder touches one node only; its half-width is 0.957 mm where the
    // rigid profile meets the undeformed surface.
    let places =
        [(bar_at as MeshContact, [0, 40, 60, 76, 90, 95]), (cylinder_at, [0, 50, 60, 64, 66, 68])];
    for (press, nodes) in places {
        let mut last = f64::INFINITY;
        for node in nodes {
            let middle = step * f64::from(node);
            let (right, left) = (press(&body, middle), press(&body, -middle));
            let p = right.load().p_n_mm;
            assert!(p > 0.0 && p < last, "{middle}: {p} after {last}");
            last = p;
            for (a, b) in right.normal_n_mm().iter().zip(left.normal_n_mm().iter().rev()) {
                assert!(*a >= 0.0 && (a - b).abs() < 1e-10 * p, "{middle}: {a} mirrored is {b}");
            }
            check_statics(&body, &right, "right");
            check_statics(&body, &left, "left");
        }
    }
    let bed = body.compliance().expect("a bed");
    let nothing = vec![f64::INFINITY; bed.count()];
    let mut past = FrictionalContact::new(bed, nothing, FrictionLaw::Free).expect("a grip");
    assert!(past.step(&LoadStep::Move { dz_mm: 0.01, dx_mm: 0.0 }).is_err());
}

/// Ten thicknesses from an end the layer might as well be infinite; over the end it is softer. Ends
/// of the contact fall between nodes, so that the worst of four places in an element counts.
#[test]
fn far_from_the_edge_the_force_is_the_infinite_layers() {
    let shape = Shape::Cylinder { radius_mm: 22.9 };
    let mut exact =
        Indenter::new(&layer(0.49), shape, Friction::None, Accuracy::Fine).expect("sound");
    let exact = exact.descend(PENETRATION_MM).expect("a contact").p_n_mm;
    let bodies = [1, 2, 4].map(|k| elements(0.49, 64 * k, 4 * k, Kind::MeanDilatation));
    for place in [0.0, 4.7] {
        let miss = [0, 1, 2].map(|k| {
            let h = 25.4 / 64.0 / f64::from(1 << k);
            let miss = |part: i32| {
                let force = cylinder_at(&bodies[k], place + 0.25 * f64::from(part) * h);
                (force.load().p_n_mm / exact - 1.0).abs()
            };
            (0..4).map(miss).fold(0.0, f64::max)
        });
        assert!(miss[1] < 0.6 * miss[0] && miss[2] < 0.6 * miss[1], "{place}: {miss:?}");
        assert!(miss[2] < 0.01, "{place}: {miss:?}");
    }
    // At the end only half of the cylinder is over the layer, which has a free side there; the part
    // of the force has converged.
    let edge = bodies.each_ref().map(|body| cylinder_at(body, 12.7).load().p_n_mm / exact);
    assert!(edge.iter().all(|part| (0.218..0.225).contains(part)), "{edge:?}");
    let bar = bodies.each_ref().map(|body| bar_at(body, 12.7).load().p_n_mm);
    let [first, second] = [bar[0] - bar[1], bar[1] - bar[2]];
    assert!(first > 2.0 * second && second > 0.0 && second < 0.01 * bar[2], "{bar:?}");
}

/// A path with stick remembers how far the surface had moved when a step first found a place in
/// contact. Therefore the error of converting a load to its descent and back is proportional to the
/// length of the steps.
#[test]
fn a_load_turned_into_its_descent_and_back_is_the_load_as_the_steps_get_shorter() {
    let body = elements(0.49, 64, 4, Kind::MeanDilatation);
    let fresh = || {
        let bed = body.compliance().expect("a bed");
        let round = |x: &f64| x * x / (22.9 + (22.9_f64 * 22.9 - x * x).sqrt());
        let heights = bed.x_mm.iter().map(round).collect();
        FrictionalContact::new(bed, heights, FrictionLaw::Coulomb(f64::INFINITY)).expect("a grip")
    };
    let back = |steps: u32| {
        let mut by_load = fresh();
        for k in 1..=steps {
            let p_n_mm = 0.8 * f64::from(k) / f64::from(steps);
            by_load.step(&LoadStep::Upright(Load { p_n_mm, q_n_mm: 0.0 })).expect("a contact");
        }
        let (mut by_move, half) = (fresh(), steps / 2);
        for k in 1..=half {
            let dz_mm = by_load.rigid()[0] * f64::from(k) / f64::from(half);
            by_move.step(&LoadStep::Move { dz_mm, dx_mm: 0.0 }).expect("a contact");
        }
        (by_move.load().p_n_mm / 0.8 - 1.0).abs()
    };
    // 16 of a load and 8 of a move is what `taktil calc` takes.
    let off = [16, 64, 256].map(back);
    assert!(off[0] < 0.02 && off[1] < 0.3 * off[0] && off[2] < 1e-3, "{off:?}");
}

#[test]
fn a_tall_mesh_is_numbered_along_its_shorter_side() {
    for (nx, nz) in [(2, 4000), (40, 3), (3, 40)] {
        let body = elements(0.49, nx, nz, Kind::MeanDilatation);
        let narrow = 2 * nx.min(nz) + 8;
        assert!(body.factor_entries() <= body.unknowns() * narrow, "{nx} {nz}");
    }
    let body = elements(0.49, 3, 40, Kind::MeanDilatation);
    let mut response = body.response();
    body.solve(&[[0.0, -1.0], [0.2, -1.0], [0.0, -1.0], [0.0, -1.0]], &mut response);
    let sum = |axis: usize| response.reactions.iter().map(|r| r[axis]).sum::<f64>();
    assert!((sum(0) + 0.2).abs() < 1e-12 && (sum(1) - 4.0).abs() < 1e-12);
}

#[test]
fn a_factor_that_would_not_fit_is_refused_before_it_is_made() {
    for (nx, nz) in [(600, 600), (300, 300), (2000, 200)] {
        let mesh = Mesh::uniform(25.4, 0.8, nx, nz).expect("a mesh");
        let refused = Elements::new(&layer(0.49), mesh, Kind::MeanDilatation).expect_err("large");
        assert_eq!(refused.place, "mesh", "{refused}");
        assert!(refused.remedy.contains("fewer elements"), "{refused}");
    }
    let edges: Vec<f64> = (0..=60).map(|i| 0.1 * f64::from(i)).collect();
    let block = Mesh::block(&edges, &edges, &edges, 1).expect("a mesh");
    assert!(Elements::new(&layer(0.49), block, Kind::MeanDilatation).is_err());
}

/// Eight loads solved side by side give the compliances of single loads.
#[test]
fn compliances_equal_those_of_single_loads() {
    for nu in [0.49, 0.5] {
        let body = elements(nu, 14, 3, Kind::MeanDilatation);
        let (bed, mut response) = (body.compliance().expect("a bed"), body.response());
        let n = bed.count();
        for j in 0..n {
            for (force, down, along) in [
                ([0.0, -1.0], &bed.down_per_p, &bed.along_per_p),
                ([1.0, 0.0], &bed.down_per_q, &bed.along_per_q),
            ] {
                let mut forces = vec![[0.0; 2]; n];
                forces[j] = force;
                body.solve(&forces, &mut response);
                for i in 0..n {
                    let [x, z] = response.nodes_mm[body.mesh().surface_node(i)];
                    let off = (down[i * n + j] + z).abs().max((along[i * n + j] - x).abs());
                    assert!(off < 1e-12 * down[j * n + j].abs().max(1e-2), "{nu} {i} {j}: {off:e}");
                }
            }
        }
    }
}

#[test]
fn an_edited_mesh_is_refused_and_invalid_sides_change_nothing() {
    let mesh = Mesh::uniform(2.0, 1.0, 4, 2).expect("a mesh");
    let odd =
        mesh.clone().with_rollers(2, 0).with_rollers(0, 2).with_rollers(usize::MAX, usize::MAX);
    assert_eq!(odd, mesh);
    assert!(mesh.line_mm(2).is_empty() && mesh.row_mm(3).is_empty());
    let changes: [fn(&mut Mesh); 8] = [
        |mesh| mesh.elements = [400, 2],
        |mesh| mesh.elements = [usize::MAX, usize::MAX],
        |mesh| mesh.elements = [0, 0],
        |mesh| mesh.order = 2,
        |mesh| mesh.order = 0,
        |mesh| mesh.order = usize::MAX,
        |mesh| mesh.nodes.clear(),
        |mesh| mesh.nodes[3] = [f64::NAN, 0.0],
    ];
    for (i, change) in changes.into_iter().enumerate() {
        let mut mesh = mesh.clone();
        change(&mut mesh);
        let _ = (mesh.counts(), mesh.line_mm(0), mesh.row_mm(0));
        let refused = Elements::new(&layer(0.49), mesh, Kind::Plain).expect_err("changed by hand");
        assert!(refused.place == "mesh" || refused.place == "order", "{i}: {refused}");
    }
}

#[test]
fn invalid_meshes_are_refused() {
    assert!(Mesh::uniform(25.4, 0.8, 1, 4).is_err());
    assert!(Mesh::uniform(25.4, 0.8, 64, 0).is_err());
    assert!(Mesh::uniform(25.4, 0.8, 1 << 40, 1 << 40).is_err());
    assert!(Mesh::uniform(-1.0, 0.8, 64, 4).is_err());
    assert!(Mesh::uniform(25.4, f64::NAN, 64, 4).is_err());
    assert!(Mesh::graded(25.4, 0.8, 64, 4, -1.0).is_err());
    assert!(Mesh::rectangle(&[0.0, 1.0, 0.5], &[0.0, 1.0]).is_err());
    assert!(Mesh::rectangle(&[0.0, 1.0, 2.0], &[0.1, 1.0]).is_err());
    let mut folded = Mesh::uniform(2.0, 1.0, 2, 1).expect("a mesh");
    folded.nodes[0][0] = 5.0;
    assert_eq!(Elements::new(&layer(0.49), folded, Kind::Plain).expect_err("folds").place, "mesh");
}
