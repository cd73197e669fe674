//! Measures work against precision in space: a sphere on the layer, by the solver of the exact
//! layer and by brick elements. The methods are compared by point values of the base stress. Times
//! differ from run to run, so the table is not tested.

use std::fmt::Write;
use std::hint::black_box;

use taktil_contact::Accuracy;
use taktil_contact::fem::{Elements, Kind, Mesh, MeshContact, graded_edges};
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::tactels::{Array, Sampling};

use super::methods::fastest_run_us;
use super::statements::{contact_error, thesis_layer};

/// Radius of the sphere.
const SPHERE_RADIUS_MM: f64 = 10.0;
/// Penetration at which the methods are compared.
const PENETRATION: Prescribed = Prescribed::PenetrationMm(0.05);
/// Points where the stress is compared: a square around the sphere, on nodes of every mesh.
const COMPARISON_POINTS: Array = Array { rows: 15, cols: 15, pitch_mm: 0.4 };
/// Half the width of the block; a quarter of the block is meshed.
const BLOCK_HALF_WIDTH_MM: f64 = 6.0;

/// Adds the table.
pub(super) fn table(out: &mut String) -> anyhow::Result<()> {
    writeln!(
        out,
        "\nsphere R = 10, t = 0.8, nu = 0.49, 0.05 mm deep: base s_zz at 15 x 15 points\n\
        method | error/peak | error of force | us warm | us cold | us tables or factor"
    )?;
    let layer = thesis_layer(0.8, 0.49)?;
    let (exact, force) = scene_solution(&layer, Accuracy::Fine)?;
    for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
        let shape = Shape::Sphere { radius_mm: SPHERE_RADIUS_MM };
        let (image, found) = scene_solution(&layer, level)?;
        let mut scene = Scene::new(&layer, shape, &COMPARISON_POINTS, Sampling::Centre, level)?;
        let mut room = image.clone();
        scene.press(PENETRATION, Pose::default())?;
        let mut once = |cold: bool| {
            fastest_run_us(20, |round| {
                if cold {
                    scene.release();
                }
                let pressed = scene.press(perturbed_depth(round), Pose::default()).is_ok();
                black_box(pressed && scene.image(&mut room).is_ok());
            })
        };
        let (warm, cold) = (once(false), once(true));
        let (off, miss) = (relative_error(&image, &exact), (found / force - 1.0).abs());
        writeln!(
            out,
            "integral equation {level:?} | {off:.1e} | {miss:.1e} | {warm:.1} | {cold:.1} | -"
        )?;
    }
    for (n, nz, order) in [(15, 2, 1), (30, 4, 1), (15, 2, 2)] {
        brick_row(out, &layer, [n, nz, order], (&exact, force))?;
    }
    Ok(())
}

/// A penetration that differs from the previous one and from [`PENETRATION`], so that no result is
/// reused.
fn perturbed_depth(round: u32) -> Prescribed {
    Prescribed::PenetrationMm(0.0501 + 1e-4 * f64::from(round % 3))
}

fn scene_solution(layer: &Layer, level: Accuracy) -> anyhow::Result<(Vec<f64>, f64)> {
    let shape = Shape::Sphere { radius_mm: SPHERE_RADIUS_MM };
    let mut scene = Scene::new(layer, shape, &COMPARISON_POINTS, Sampling::Centre, level)?;
    let touch = scene.press(PENETRATION, Pose::default())?;
    let mut image = vec![0.0; COMPARISON_POINTS.len()];
    scene.image(&mut image)?;
    Ok((image, touch.force_n))
}

fn brick_row(
    out: &mut String,
    layer: &Layer,
    [n, nz, order]: [usize; 3],
    (exact, force): (&[f64], f64),
) -> anyhow::Result<()> {
    let x = graded_edges(BLOCK_HALF_WIDTH_MM, n, 0.0).map_err(contact_error)?;
    let z = graded_edges(layer.thickness_mm, nz, 0.0).map_err(contact_error)?;
    let mesh = Mesh::block(&x, &x, &z, order).map_err(contact_error)?;
    let mesh = mesh.with_rollers(0, 0).with_rollers(1, 0);
    let mut bodies = Vec::new();
    let factor = fastest_run_us(1, |_| {
        bodies.push(Elements::new(layer, mesh.clone(), Kind::MeanDilatation));
    });
    let body = bodies.pop().ok_or_else(|| anyhow::anyhow!("no body"))?.map_err(contact_error)?;
    let height = |column: usize| {
        let [x, y, _] = mesh.nodes[mesh.surface_node(column)];
        let square = x * x + y * y;
        square / (SPHERE_RADIUS_MM + (SPHERE_RADIUS_MM * SPHERE_RADIUS_MM - square).max(0.0).sqrt())
    };
    let heights = (0..mesh.columns()).map(height).collect();
    let mut press = MeshContact::new(body, heights).map_err(contact_error)?;
    let mut found = f64::NAN;
    let mut szz = Vec::new();
    let cold = fastest_run_us(1, |_| {
        found = 4.0 * press.press(PENETRATION).unwrap_or(f64::NAN);
        szz = press.body().base_szz_mpa(&press.response());
    });
    let warm = fastest_run_us(5, |round| {
        let pressed = press.press(perturbed_depth(round)).is_ok();
        black_box(pressed.then(|| press.body().base_szz_mpa(&press.response())));
    });
    // The pitch of the points is a multiple of the spacing of the nodes.
    let line = mesh.line_mm(0);
    let image: Vec<f64> = (0..COMPARISON_POINTS.len())
        .map(|point| {
            let node = |i: usize| {
                let place =
                    COMPARISON_POINTS.pitch_mm * i.abs_diff(COMPARISON_POINTS.cols / 2) as f64;
                line.partition_point(|x| *x < place - 1e-9)
            };
            let (row, column) = (point / COMPARISON_POINTS.cols, point % COMPARISON_POINTS.cols);
            szz[node(column) * line.len() + node(row)]
        })
        .collect();
    let (off, miss) = (relative_error(&image, exact), (found / force - 1.0).abs());
    writeln!(
        out,
        "bricks {n} x {n} x {nz}, order {order}, a quarter | {off:.1e} | {miss:.1e} | {warm:.0} | \
         {cold:.0} | {factor:.0}"
    )?;
    Ok(())
}

/// Largest difference of two images, as a fraction of the peak of the exact one.
fn relative_error(image: &[f64], exact: &[f64]) -> f64 {
    let peak = exact.iter().fold(0.0_f64, |most, s| most.max(s.abs()));
    image.iter().zip(exact).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs())) / peak
}
