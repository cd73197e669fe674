//! Work against precision in space: a sphere on the layer by the exact layer's solver and by
//! bricks, point values of the base stress. Refuses to be a gate: times differ from run to run.

use std::fmt::Write;
use std::hint::black_box;

use taktil_contact::Accuracy;
use taktil_contact::fem::{Elements, Kind, Mesh, MeshContact, graded_edges};
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::scene::{Pose, Scene, Shape};
use taktil_contact::space::tactels::{Array, Sampling};

use super::statements::{layer, plainly};
use super::work::best_us;

const RADIUS: f64 = 10.0;
const DEPTH: Prescribed = Prescribed::PenetrationMm(0.05);
/// Points where the stress is compared: a square around the sphere, on nodes of every mesh.
const POINTS: Array = Array { rows: 15, cols: 15, pitch_mm: 0.4 };
/// Half the width of the block, of which a quarter is meshed.
const HALF_MM: f64 = 6.0;

/// Adds the table.
pub(super) fn table(out: &mut String) -> anyhow::Result<()> {
    writeln!(
        out,
        "\nsphere R = 10, t = 0.8, nu = 0.49, 0.05 mm deep: base s_zz at 15 x 15 points\n\
        method | error/peak | error of force | us warm | us cold | us tables or factor"
    )?;
    let layer = layer(0.8, 0.49)?;
    let (exact, force) = by_scene(&layer, Accuracy::Fine)?;
    for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
        let shape = Shape::Sphere { radius_mm: RADIUS };
        let (image, found) = by_scene(&layer, level)?;
        let mut scene = Scene::new(&layer, shape, &POINTS, Sampling::Centre, level)?;
        let mut room = image.clone();
        scene.press(DEPTH, Pose::default())?;
        let mut once = |cold: bool| {
            best_us(20, |round| {
                if cold {
                    scene.release();
                }
                let pressed = scene.press(near(round), Pose::default()).is_ok();
                black_box(pressed && scene.image(&mut room).is_ok());
            })
        };
        let (warm, cold) = (once(false), once(true));
        let (off, miss) = (apart(&image, &exact), (found / force - 1.0).abs());
        writeln!(
            out,
            "integral equation {level:?} | {off:.1e} | {miss:.1e} | {warm:.1} | {cold:.1} | -"
        )?;
    }
    for (n, nz, order) in [(15, 2, 1), (30, 4, 1), (15, 2, 2)] {
        on_bricks(out, &layer, [n, nz, order], (&exact, force))?;
    }
    Ok(())
}

/// Never twice the same depth, and never that of the table.
fn near(round: u32) -> Prescribed {
    Prescribed::PenetrationMm(0.0501 + 1e-4 * f64::from(round % 3))
}

fn by_scene(layer: &Layer, level: Accuracy) -> anyhow::Result<(Vec<f64>, f64)> {
    let shape = Shape::Sphere { radius_mm: RADIUS };
    let mut scene = Scene::new(layer, shape, &POINTS, Sampling::Centre, level)?;
    let touch = scene.press(DEPTH, Pose::default())?;
    let mut image = vec![0.0; POINTS.len()];
    scene.image(&mut image)?;
    Ok((image, touch.force_n))
}

fn on_bricks(
    out: &mut String,
    layer: &Layer,
    [n, nz, order]: [usize; 3],
    (exact, force): (&[f64], f64),
) -> anyhow::Result<()> {
    let x = graded_edges(HALF_MM, n, 0.0).map_err(plainly)?;
    let z = graded_edges(layer.thickness_mm, nz, 0.0).map_err(plainly)?;
    let mesh = Mesh::block(&x, &x, &z, order).map_err(plainly)?;
    let mesh = mesh.with_rollers(0, 0).with_rollers(1, 0);
    let mut bodies = Vec::new();
    let factor = best_us(1, |_| {
        bodies.push(Elements::new(layer, mesh.clone(), Kind::MeanDilatation));
    });
    let body = bodies.pop().ok_or_else(|| anyhow::anyhow!("no body"))?.map_err(plainly)?;
    let height = |column: usize| {
        let [x, y, _] = mesh.nodes[mesh.surface_node(column)];
        let square = x * x + y * y;
        square / (RADIUS + (RADIUS * RADIUS - square).max(0.0).sqrt())
    };
    let heights = (0..mesh.columns()).map(height).collect();
    let mut press = MeshContact::new(body, heights).map_err(plainly)?;
    let mut found = f64::NAN;
    let mut szz = Vec::new();
    let cold = best_us(1, |_| {
        found = 4.0 * press.press(DEPTH).unwrap_or(f64::NAN);
        szz = press.body().base_szz_mpa(&press.response());
    });
    let warm = best_us(5, |round| {
        let pressed = press.press(near(round)).is_ok();
        black_box(pressed.then(|| press.body().base_szz_mpa(&press.response())));
    });
    // Nodes are a whole part of the points' pitch apart.
    let line = mesh.line_mm(0);
    let image: Vec<f64> = (0..POINTS.len())
        .map(|point| {
            let node = |i: usize| {
                let place = POINTS.pitch_mm * i.abs_diff(POINTS.cols / 2) as f64;
                line.partition_point(|x| *x < place - 1e-9)
            };
            let (row, column) = (point / POINTS.cols, point % POINTS.cols);
            szz[node(column) * line.len() + node(row)]
        })
        .collect();
    let (off, miss) = (apart(&image, exact), (found / force - 1.0).abs());
    writeln!(
        out,
        "bricks {n} x {n} x {nz}, order {order}, a quarter | {off:.1e} | {miss:.1e} | {warm:.0} | \
         {cold:.0} | {factor:.0}"
    )?;
    Ok(())
}

/// Largest difference over the peak.
fn apart(image: &[f64], exact: &[f64]) -> f64 {
    let peak = exact.iter().fold(0.0_f64, |most, s| most.max(s.abs()));
    image.iter().zip(exact).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs())) / peak
}
