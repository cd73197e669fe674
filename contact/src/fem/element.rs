//! One quadrilateral or brick of Lagrange's shape functions, order 1 or 2: its stiffness and the
//! modes of its dilatation. Isoparametric, Gauss's rule of order + 1 points along each axis.

use super::mesh::Kind;
use crate::numeric::cholesky::inverse_factor;
use crate::numeric::elimination::inverse_and_determinant;
use crate::numeric::quadrature::{THREE_POINT_NODE, TWO_POINT_NODE};

/// Most modes of the dilatation: 1, x, y, z.
pub(super) const DILATATION_MODES: usize = 4;

/// Shear and bulk modulus in MPa.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moduli {
    pub(super) shear: f64,
    pub(super) bulk: f64,
}

/// Modes of an element's dilatation, orthonormal over its volume: constants with order 1, linear
/// functions of the place with order 2.
#[derive(Clone, Debug)]
pub(super) struct Modes<const D: usize> {
    /// Coefficient of each mode in the dilatation, per displacement; mode after mode.
    pub(super) rows: Vec<f64>,
    /// Number of modes.
    pub(super) count: usize,
    middle: [f64; D],
    /// Inverse of the Cholesky factor of the raw functions' products.
    basis: [[f64; DILATATION_MODES]; DILATATION_MODES],
}

impl<const D: usize> Modes<D> {
    /// Values of the modes at a place in mm.
    pub(super) fn at(&self, place: &[f64; D]) -> [f64; DILATATION_MODES] {
        let raw = raw(place, &self.middle);
        self.basis.map(|row| row.iter().zip(raw).map(|(a, b)| a * b).sum())
    }
}

/// Contribution of an element to the system, displacements node by node.
#[derive(Clone, Debug)]
pub(super) struct Element<const D: usize> {
    pub(super) stiffness: Vec<f64>,
    pub(super) modes: Modes<D>,
}

/// Shape functions at one place.
pub(super) struct Point<const D: usize> {
    /// Derivatives along the axes, per mm.
    pub(super) slopes: Vec<[f64; D]>,
    /// Place in mm.
    pub(super) place: [f64; D],
    /// Determinant of the map.
    pub(super) volume: f64,
}

/// Value and slope of the shape functions of a line at `s` in -1..1.
fn line(order: usize, s: f64) -> [[f64; 2]; 3] {
    if order == 1 {
        return [[0.5 * (1.0 - s), -0.5], [0.5 * (1.0 + s), 0.5], [0.0; 2]];
    }
    [[0.5 * s * (s - 1.0), s - 0.5], [1.0 - s * s, -2.0 * s], [0.5 * s * (s + 1.0), s + 0.5]]
}

/// Gauss's nodes and weights.
fn gauss(order: usize) -> &'static [[f64; 2]] {
    if order == 1 {
        return &[[-TWO_POINT_NODE, 1.0], [TWO_POINT_NODE, 1.0]];
    }
    &[[-THREE_POINT_NODE, 5.0 / 9.0], [0.0, 8.0 / 9.0], [THREE_POINT_NODE, 5.0 / 9.0]]
}

/// Shape functions at natural coordinates; `None` where the element folds.
pub(super) fn point<const D: usize>(
    corners: &[[f64; D]],
    order: usize,
    natural: &[f64; D],
) -> Option<Point<D>> {
    let lines = natural.map(|s| line(order, s));
    let wide = order + 1;
    let mut values = vec![1.0; corners.len()];
    let mut slopes = vec![[1.0; D]; corners.len()];
    for (local, (value, slope)) in values.iter_mut().zip(&mut slopes).enumerate() {
        let mut rest = local;
        for axis in (0..D).rev() {
            let [v, s] = lines[axis][rest % wide];
            rest /= wide;
            *value *= v;
            for (other, part) in slope.iter_mut().enumerate() {
                *part *= if other == axis { s } else { v };
            }
        }
    }
    let (mut map, mut place) = ([[0.0; D]; D], [0.0; D]);
    for ((value, slope), corner) in values.iter().zip(&slopes).zip(corners) {
        for a in 0..D {
            place[a] += value * corner[a];
            for b in 0..D {
                map[a][b] += slope[a] * corner[b];
            }
        }
    }
    let (back, volume) = inverse_and_determinant(map)?;
    for slope in &mut slopes {
        let natural = *slope;
        *slope = core::array::from_fn(|b| (0..D).map(|a| back[b][a] * natural[a]).sum());
    }
    Some(Point { slopes, place, volume })
}

/// 1 and the place from the element's middle.
fn raw<const D: usize>(place: &[f64; D], middle: &[f64; D]) -> [f64; DILATATION_MODES] {
    let mut raw = [0.0; DILATATION_MODES];
    raw[0] = 1.0;
    for axis in 0..D {
        raw[axis + 1] = place[axis] - middle[axis];
    }
    raw
}

/// From its nodes; `None` where the element folds.
pub(super) fn element<const D: usize>(
    corners: &[[f64; D]],
    order: usize,
    kind: Kind,
    moduli: Moduli,
) -> Option<Element<D>> {
    let dofs = D * corners.len();
    let mut stiffness = vec![0.0; dofs * dofs];
    let count = if order == 1 { 1 } else { D + 1 };
    let middle = core::array::from_fn(|axis| {
        corners.iter().map(|c| c[axis]).sum::<f64>() / corners.len() as f64
    });
    let mut products = [[0.0; DILATATION_MODES]; DILATATION_MODES];
    let mut rows = vec![0.0; count * dofs];
    let rule = gauss(order);
    for step in 0..rule.len().pow(D as u32) {
        let (mut rest, mut weight, mut natural) = (step, 1.0, [0.0; D]);
        for slot in &mut natural {
            let [s, w] = rule[rest % rule.len()];
            rest /= rule.len();
            *slot = s;
            weight *= w;
        }
        let here = point(corners, order, &natural)?;
        let volume = weight * here.volume;
        let plain = if kind == Kind::Plain { moduli.bulk } else { 0.0 };
        add_energy(&mut stiffness, &here.slopes, volume, moduli.shear, plain);
        let raw = raw(&here.place, &middle);
        for i in 0..count {
            for j in 0..count {
                products[i][j] += volume * raw[i] * raw[j];
            }
            for (a, slope) in here.slopes.iter().enumerate() {
                for axis in 0..D {
                    rows[i * dofs + a * D + axis] += volume * raw[i] * slope[axis];
                }
            }
        }
    }
    let basis = inverse_factor(&products, count);
    let modes = Modes { rows: orthonormal(&rows, &basis, count), count, middle, basis };
    if kind == Kind::MeanDilatation {
        for row in modes.rows.chunks_exact(dofs) {
            for (i, a) in row.iter().enumerate() {
                let line = &mut stiffness[i * dofs..][..dofs];
                line.iter_mut().zip(row).for_each(|(entry, b)| *entry += moduli.bulk * a * b);
            }
        }
    }
    Some(Element { stiffness, modes })
}

/// Energy density G (2 e:e - (2/3) theta^2) + (bulk/2) theta^2 times 2, at one point: in plane
/// strain the same, since e_yy = 0.
fn add_energy<const D: usize>(
    stiffness: &mut [f64],
    slopes: &[[f64; D]],
    volume: f64,
    shear: f64,
    bulk: f64,
) {
    let dofs = D * slopes.len();
    let lame = volume * (bulk - 2.0 / 3.0 * shear);
    let shear = volume * shear;
    for (a, na) in slopes.iter().enumerate() {
        for (b, nb) in slopes.iter().enumerate() {
            let both: f64 = shear * na.iter().zip(nb).map(|(x, y)| x * y).sum::<f64>();
            for i in 0..D {
                let line = &mut stiffness[(a * D + i) * dofs + b * D..][..D];
                for (j, entry) in line.iter_mut().enumerate() {
                    *entry += shear * na[j] * nb[i] + lame * na[i] * nb[j];
                }
                line[i] += both;
            }
        }
    }
}

fn orthonormal(
    rows: &[f64],
    basis: &[[f64; DILATATION_MODES]; DILATATION_MODES],
    count: usize,
) -> Vec<f64> {
    let dofs = rows.len() / count;
    let mut out = vec![0.0; rows.len()];
    for i in 0..count {
        for j in 0..=i {
            let from = &rows[j * dofs..][..dofs];
            let to = &mut out[i * dofs..][..dofs];
            to.iter_mut().zip(from).for_each(|(o, r)| *o += basis[i][j] * r);
        }
    }
    out
}
