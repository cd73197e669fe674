//! Compares plane strain with a layer 25.4 mm long with free ends (figures 3.5 and 3.6 of the
//! thesis). Both use the same elements of order 2, in the plane and in space, so that their
//! difference is that of the ends. A quarter of the layer is meshed; it is 25.4 mm wide and its
//! sides are free.

use taktil_contact::fem::{Elements, Kind, Mesh, graded_edges};
use taktil_contact::field::{LineLoad, line};

use super::curves::{Chart, Curve, stacked_charts};
use super::statements::{LB_PER_IN, contact_error, thesis_layer};
use taktil_lab_plot::svg::Figure;

/// Half the width and half the length of the layer.
const HALF_LENGTH_MM: f64 = 12.7;
/// Depth at which the stresses are compared.
const DEPTH_MM: f64 = 0.8;

/// Stresses in kPa on the middle section at the depth of the sensor.
pub(super) struct FreeEndStresses {
    pub(super) thickness_mm: f64,
    x_mm: Vec<f64>,
    /// s_xx and s_zz in plane strain and in space.
    plane: [Vec<f64>; 2],
    space: [Vec<f64>; 2],
    /// s_xx and s_zz under the load of the exact layer, infinite along x.
    exact: [f64; 2],
}

impl FreeEndStresses {
    /// Largest difference and the peak of s_xx and s_zz in kPa.
    pub(super) fn differences(&self) -> [[f64; 2]; 2] {
        core::array::from_fn(|which| {
            let pairs = || self.plane[which].iter().zip(&self.space[which]);
            let off = pairs().map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            [off, pairs().map(|(a, _)| a.abs()).fold(0.0, f64::max)]
        })
    }
}

/// Edges along x, y and z of a quarter of the layer. Where the layer is thick, the sensor's depth
/// is in the middle of an element.
fn edges(thickness_mm: f64) -> anyhow::Result<[Vec<f64>; 3]> {
    const LOAD_DISTANCE_EDGES_MM: [f64; 11] =
        [0.0, 0.32, 0.64, 0.96, 1.4, 2.0, 3.0, 4.6, 6.8, 9.6, HALF_LENGTH_MM];
    const DEPTH_EDGES_MM: [f64; 11] = [0.0, 0.32, 0.64, 0.96, 1.4, 2.1, 3.4, 5.6, 9.5, 16.0, 25.4];
    // The edges are closer together at the free end.
    let y = graded_edges(HALF_LENGTH_MM, 5, 4.0).map_err(contact_error)?;
    let y: Vec<f64> = y.iter().rev().map(|y| HALF_LENGTH_MM - y).collect();
    if thickness_mm <= DEPTH_MM {
        let x = graded_edges(HALF_LENGTH_MM, 22, 9.0).map_err(contact_error)?;
        let z = graded_edges(thickness_mm, 4, 0.0).map_err(contact_error)?;
        return Ok([x, y, z]);
    }
    let z = DEPTH_EDGES_MM.iter().rev().map(|z| (25.4 - z) * thickness_mm / 25.4).collect();
    Ok([LOAD_DISTANCE_EDGES_MM.to_vec(), y, z])
}

/// A knife edge of 0.5 lb/in across the middle, from end to end.
pub(super) fn free_end_stresses(thickness_mm: f64) -> anyhow::Result<FreeEndStresses> {
    let layer = thesis_layer(thickness_mm, 0.49)?;
    let [x, y, z] = edges(thickness_mm)?;
    let flat = Mesh::from_edges([&x, &z], 2).map_err(contact_error)?.with_rollers(0, 0);
    let flat = Elements::new(&layer, flat, Kind::MeanDilatation).map_err(contact_error)?;
    let block = Mesh::block(&x, &y, &z, 2).map_err(contact_error)?;
    let block = block.with_rollers(0, 0).with_rollers(1, 0);
    let block = Elements::new(&layer, block, Kind::MeanDilatation).map_err(contact_error)?;
    // Half of the load acts on the mesh, because the other half is beyond the plane of symmetry.
    let half = 0.25 * LB_PER_IN;
    let mut plane = flat.response();
    flat.solve(&[[0.0, -half]], &mut plane);
    let mut space = block.response();
    let rows = block.mesh().counts()[1];
    // Only the shares of the nodes along y are needed, so their width along x is divided out.
    let sliver = x[1] / 6.0;
    let shares = block.mesh().base_weights();
    let forces: Vec<[f64; 3]> =
        shares.iter().take(rows).map(|share| [0.0, 0.0, -half * share / sliver]).collect();
    block.solve(&forces, &mut space);
    let none: [Vec<f64>; 2] = Default::default();
    let load = LineLoad { p_n_mm: 0.5 * LB_PER_IN, q_n_mm: 0.0 };
    let under = &line(&layer, &load, DEPTH_MM, &[0.0]).map_err(contact_error)?[0];
    let exact = [under.sxx_mpa, under.szz_mpa].map(|s| 1e3 * s.unwrap_or(f64::NAN));
    let mut out =
        FreeEndStresses { thickness_mm, x_mm: Vec::new(), plane: none.clone(), space: none, exact };
    if thickness_mm <= DEPTH_MM {
        let ratio = layer.poisson / (1.0 - layer.poisson);
        let (flat_szz, block_szz) = (flat.base_szz_mpa(&plane), block.base_szz_mpa(&space));
        for (i, x) in flat.mesh().row_mm(0).into_iter().enumerate() {
            let both = |szz: f64| [ratio * szz, szz];
            out.add(x, both(flat_szz[i]), both(block_szz[i * rows]));
        }
        return Ok(out);
    }
    // Stresses of these elements are most accurate at the two Gauss points. The point under the
    // load is added.
    let gauss = |cell: &[f64]| {
        let (middle, off) = (0.5 * (cell[0] + cell[1]), (cell[1] - cell[0]) / 12.0_f64.sqrt());
        [middle - off, middle + off]
    };
    for x in core::iter::once(0.0).chain(x.windows(2).flat_map(gauss)) {
        let height = thickness_mm - DEPTH_MM;
        let a = flat.stress_mpa(&plane, &[x, height]);
        let b = block.stress_mpa(&space, &[x, 0.0, height]);
        if let (Some([xx, zz]), Some([block_xx, _, block_zz])) = (a, b) {
            out.add(x, [xx, zz], [block_xx, block_zz]);
        }
    }
    Ok(out)
}

impl FreeEndStresses {
    fn add(&mut self, x_mm: f64, plane: [f64; 2], space: [f64; 2]) {
        self.x_mm.push(x_mm);
        for which in 0..2 {
            self.plane[which].push(1e3 * plane[which]);
            self.space[which].push(1e3 * space[which]);
        }
    }
}

/// Figure 3.5 for the thin layer, 3.6 for the thick one.
pub(super) fn figure(ends: &FreeEndStresses) -> Figure {
    let apart = ends.differences();
    let chart = |which: usize, name: &str| {
        let curve = |label: &str, y: &[f64]| Curve::new(label, &ends.x_mm, y.iter().copied());
        let [off, peak] = apart[which];
        Chart {
            title: format!(
                "{name} on the middle section, depth 0.8 mm: knife edge, {} mm thick",
                ends.thickness_mm
            ),
            x: "x (mm)",
            y: "stress (kPa)",
            curves: vec![
                curve("plane strain", &ends.plane[which]),
                curve("25.4 mm long, free ends", &ends.space[which]).with_dashes(),
            ],
            remarks: vec![
                format!(
                    "thesis: minimal effect at the centre; here {} kPa at most, {:.1e} of the peak",
                    format_kpa(off),
                    off / peak
                ),
                format!(
                    "the mesh's own error is in both: {:.2} under the load in plane strain, \
                     exactly {:.2} kPa",
                    ends.plane[which][0], ends.exact[which]
                ),
            ],
        }
    };
    let less = |which: usize, name: &str| {
        let pairs = ends.space[which].iter().zip(&ends.plane[which]);
        Curve::new(name, &ends.x_mm, pairs.map(|(space, plane)| space - plane))
    };
    let change = Chart {
        title: "(c) What the free ends change: the two above, one less the other".to_owned(),
        x: "x (mm)",
        y: "change of stress (kPa)",
        curves: vec![less(0, "s_xx"), less(1, "s_zz")],
        remarks: vec!["both on one mesh, whose error falls out".to_owned()],
    };
    let charts = [chart(0, "(a) s_xx"), chart(1, "(b) s_zz"), change];
    stacked_charts("Plane strain and free ends", &charts)
}

/// A stress (kPa) as text: three decimals, or a power of ten when it is small.
fn format_kpa(x: f64) -> String {
    if x >= 0.01 { format!("{x:.3}") } else { format!("{x:.1e}") }
}

/// Line of the table for statement C4 of the thesis.
pub(super) fn statement(ends: &FreeEndStresses) -> String {
    let [[xx, peak_xx], [zz, peak_zz]] = ends.differences();
    format!(
        "C4 free ends, t = {}: largest change of s_zz, s_xx at the centre, kPa (of the peak) | \
         minimal | {} ({:.1e}), {} ({:.1e})\n",
        ends.thickness_mm,
        format_kpa(zz),
        zz / peak_zz,
        format_kpa(xx),
        xx / peak_xx
    )
}
