//! One quadrilateral: its stiffness, its dilatation and its forces.

/// Strain-displacement pieces of one Gauss point.
struct Point {
    /// d N/dx and d N/dz of the four shape functions.
    slopes: [[f64; 2]; 4],
    /// Weight times area.
    area: f64,
}

/// The element's matrices for a shear modulus of 1.
#[derive(Clone, Debug)]
pub(super) struct Element {
    /// Deviatoric stiffness, to be taken times G.
    pub(super) shear: [[f64; 8]; 8],
    /// Mean dilatation per displacement.
    pub(super) mean: [f64; 8],
    /// Volumetric stiffness of full integration, to be taken times the bulk modulus.
    pub(super) volume: [[f64; 8]; 8],
    /// Area.
    pub(super) area: f64,
}

const GAUSS: f64 = 0.577_350_269_189_625_8;

/// `None` where the quadrilateral folds.
fn point(corners: &[[f64; 2]; 4], xi: f64, eta: f64) -> Option<Point> {
    let natural = [
        [-(1.0 - eta), -(1.0 - xi)],
        [1.0 - eta, -(1.0 + xi)],
        [1.0 + eta, 1.0 + xi],
        [-(1.0 + eta), 1.0 - xi],
    ];
    let mut jacobian = [[0.0; 2]; 2];
    for (n, corner) in natural.iter().zip(corners) {
        for a in 0..2 {
            for b in 0..2 {
                jacobian[a][b] += 0.25 * n[a] * corner[b];
            }
        }
    }
    let [[a, b], [c, d]] = jacobian;
    let determinant = a * d - b * c;
    if determinant.is_nan() || determinant <= 0.0 {
        return None;
    }
    let slopes = natural.map(|[u, v]| {
        let (u, v) = (0.25 * u, 0.25 * v);
        [(d * u - b * v) / determinant, (a * v - c * u) / determinant]
    });
    Some(Point { slopes, area: determinant })
}

/// From the corners, anticlockwise; `None` where the element folds.
pub(super) fn element(corners: &[[f64; 2]; 4]) -> Option<Element> {
    let mut out =
        Element { shear: [[0.0; 8]; 8], mean: [0.0; 8], volume: [[0.0; 8]; 8], area: 0.0 };
    for (xi, eta) in [(-GAUSS, -GAUSS), (GAUSS, -GAUSS), (GAUSS, GAUSS), (-GAUSS, GAUSS)] {
        let point = point(corners, xi, eta)?;
        out.area += point.area;
        // Rows: e_xx, e_zz, shear; the deviatoric energy is
        // G (2 e:e - (2/3) theta^2), e_yy = 0.
        let mut strains = [[0.0; 8]; 3];
        for (k, [x, z]) in point.slopes.iter().enumerate() {
            strains[0][2 * k] = *x;
            strains[1][2 * k + 1] = *z;
            strains[2][2 * k] = *z;
            strains[2][2 * k + 1] = *x;
        }
        for i in 0..8 {
            let theta_i = strains[0][i] + strains[1][i];
            out.mean[i] += point.area * theta_i;
            for j in 0..8 {
                let theta_j = strains[0][j] + strains[1][j];
                let energy = 2.0 * (strains[0][i] * strains[0][j] + strains[1][i] * strains[1][j])
                    + strains[2][i] * strains[2][j]
                    - 2.0 / 3.0 * theta_i * theta_j;
                out.shear[i][j] += point.area * energy;
                out.volume[i][j] += point.area * theta_i * theta_j;
            }
        }
    }
    let (mean, area) = (&mut out.mean, out.area);
    mean.iter_mut().for_each(|m| *m /= area);
    Some(out)
}
