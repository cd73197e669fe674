//! Several layers of different rubber, bonded to each other and to a rigid base: stresses and
//! displacements under a line load at any depth.
//!
//! For each wave number the compliance of the layers below is carried up from the base, layer by
//! layer: two conditions at a layer's lower face, two tractions at its upper one, four
//! functions inside. Those are exponentials that die away from either face where the layer is
//! thick against the wave, so nothing overflows, and hyperbolic combinations that stay apart where
//! it is thin, so nothing cancels; nu = 0.5 is an ordinary value. Sums in the wave number are those
//! of
//! [`super::field`]. An empty stack is refused. Summing allocates.

use super::field::{LineLoad, LinePoint, line};
use super::layer::Layer;
use super::numeric::product::dot_in_order;
use super::wave_grid::FIELD_REACH;
use super::{Invalid, finite, positive};
use core::f64::consts::PI;
use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};

/// Most layers.
pub const LAYERS_MAX: usize = 64;
/// Most waves of a line load.
const WAVES_MAX: f64 = 1_048_576.0;
/// Most waves times layers, of which each takes about 0.7 us: some six seconds.
const WORK_MAX: f64 = 8_388_608.0;
/// Wave number times thickness above which a layer counts as thick against the wave.
const THICK_LAYER_WAVE_NUMBER: f64 = 1.0;
/// Smallest wave number, in units of one over the thickness, which stands for 0.
const WAVE_NUMBER_MIN: f64 = 1e-6;
/// Furthest that fields may reach, in thicknesses of the surface layer, where they are tabulated.
const REACH_MAX_THICKNESSES: f64 = 640.0;

/// Layers from the surface down to the base.
#[derive(Clone, Debug, PartialEq)]
pub struct Stack {
    layers: Vec<Layer>,
}

/// Amplitudes at one wave number k: u_x sin kx, u_z cos kx, s_zz cos kx, s_xz sin kx, s_xx cos kx.
/// Displacements in mm and stresses in MPa per MPa on the surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Amplitudes {
    /// Displacement along x.
    pub ux: f64,
    /// Displacement up.
    pub uz: f64,
    /// Normal stress along z.
    pub szz: f64,
    /// Shear stress.
    pub sxz: f64,
    /// Normal stress along x.
    pub sxx: f64,
}

/// The four functions of a layer at one height: rows u_x, u_z, s_zz, s_xz, s_xx.
type Functions = [[f64; 4]; 5];

/// Functions at height z (in mm over the layer's lower face) for wave number k.
fn layer_functions(layer: &Layer, k: f64, z: f64) -> Functions {
    let transfer = layer.transfer();
    let (m, n, kap) = (transfer.m, transfer.n, transfer.kap);
    let (g2, nu2) = (2.0 * layer.shear_mpa(), 2.0 * layer.poisson);
    let y = k * z;
    if k * layer.thickness_mm > THICK_LAYER_WAVE_NUMBER {
        let (up, down) = (libm::exp(k * (z - layer.thickness_mm)), libm::exp(-y));
        let h = k * layer.thickness_mm - y;
        // grad(e^{kz} cos kx) and 2(1-nu) psi-fields counted from the upper face; the same from the
        // lower face for the decaying ones. Stresses over 2 G k, displacements times 1.
        return [
            [-up, -h * up, -down, y * down],
            [up, (kap + h) * up, -down, (kap + y) * down],
            [up, (m + h) * up, down, -(m + y) * down],
            [-up, -(n + h) * up, down, -(n + y) * down],
            [-up, (nu2 - h) * up, -down, (y - nu2) * down],
        ]
        .map_stress(g2 * k);
    }
    // sinh y/y, cosh y, and their difference without cancellation.
    let (sinhc, cosh) = (sinh_over(y), libm::cosh(y));
    let less = sinh_less(y);
    let sinh = y * sinhc;
    [
        [-sinh, -cosh, z * (cosh + kap * sinhc), z * sinh],
        [cosh, sinh, -z * sinh, z * ((kap - 1.0) * sinhc + less)],
        [g2 * k * sinh, g2 * k * cosh, g2 * (-n * sinh - y * cosh), g2 * (m * cosh - y * sinh)],
        [-g2 * k * cosh, -g2 * k * sinh, g2 * (m * cosh + y * sinh), g2 * (y * cosh - n * sinh)],
        [
            -g2 * k * sinh,
            -g2 * k * cosh,
            g2 * ((1.0 + m) * sinh + y * cosh),
            g2 * (nu2 * cosh + y * sinh),
        ],
    ]
}

/// Scaling of the stress rows.
trait StressScaling {
    fn map_stress(self, scale: f64) -> Self;
}

impl StressScaling for Functions {
    fn map_stress(mut self, scale: f64) -> Self {
        self[2..].iter_mut().flatten().for_each(|value| *value *= scale);
        self
    }
}

/// sinh(y)/y.
fn sinh_over(y: f64) -> f64 {
    if y < 1e-4 { 1.0 + y * y / 6.0 } else { libm::sinh(y) / y }
}

/// sinh(y)/y - cosh(y), by its series: -sum 2 j y^(2j)/(2 j + 1)!.
fn sinh_less(y: f64) -> f64 {
    let s = y * y;
    let (mut term, mut sum) = (1.0, 0.0);
    for j in 1..12 {
        let j = f64::from(j);
        term *= s / ((2.0 * j) * (2.0 * j + 1.0));
        sum -= 2.0 * j * term;
    }
    sum
}

impl Stack {
    /// Keeps the layers, surface first.
    ///
    /// # Errors
    /// None or more than [`LAYERS_MAX`] layers, and a layer that its check refuses.
    pub fn new(layers: &[Layer]) -> Result<Self, Invalid> {
        if layers.is_empty() || layers.len() > LAYERS_MAX {
            let what = format!("{} layers", layers.len());
            return Err(Invalid::new("layers", what, "give 1 to 64 layers, surface first"));
        }
        layers.iter().try_for_each(Layer::check)?;
        Ok(Self { layers: layers.to_vec() })
    }

    /// Thickness of all layers in mm.
    #[must_use]
    pub fn thickness_mm(&self) -> f64 {
        self.layers.iter().map(|layer| layer.thickness_mm).sum()
    }

    /// The layer at the surface.
    #[must_use]
    pub fn surface_layer(&self) -> &Layer {
        &self.layers[0]
    }

    /// The layers, surface first.
    pub(crate) fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Number of layers.
    pub(crate) fn count(&self) -> usize {
        self.layers.len()
    }

    /// The layer at a depth; the upper one at an interface.
    pub(crate) fn layer_at(&self, depth_mm: f64) -> &Layer {
        let mut bottom = 0.0;
        let within = |layer: &&Layer| {
            bottom += layer.thickness_mm;
            depth_mm <= bottom
        };
        self.layers.iter().find(within).unwrap_or(&self.layers[self.layers.len() - 1])
    }

    /// Refuses more waves than [`WAVES_MAX`] and, times the layers, [`WORK_MAX`].
    pub(crate) fn check_wave_count(&self, waves: f64) -> Result<(), Invalid> {
        if waves <= WAVES_MAX && waves * self.layers.len() as f64 <= WORK_MAX {
            return Ok(());
        }
        let [first, whole] = [self.surface_layer().thickness_mm, self.thickness_mm()];
        let what =
            format!("{first:?} under the surface, of {whole:?} in {} layers", self.layers.len());
        let remedy = "that takes more than a million waves, or eight million in all layers: give a \
                      thicker first layer, a greater depth, or fewer layers";
        Err(Invalid::new("thickness_mm", what, remedy))
    }

    /// Where fields have died: a stiff layer on a softer one spreads a load as a plate does.
    pub(crate) fn reach_mm(&self) -> f64 {
        let (mut stiffest, mut contrast) = (0.0_f64, 1.0_f64);
        for layer in &self.layers {
            // As a plate, and along itself as a membrane.
            let stiffness = layer.youngs_mpa / (1.0 - layer.poisson * layer.poisson);
            stiffest = stiffest.max(stiffness);
            contrast = contrast.max(stiffest / stiffness);
        }
        // A base that does not give ends the spreading: contrasts beyond 1e6 count as that.
        FIELD_REACH * self.thickness_mm() * libm::cbrt(contrast.min(1e6))
    }

    /// The same in thicknesses of the surface layer, for tables.
    ///
    /// # Errors
    /// A surface layer too thin against that distance.
    pub(crate) fn reach(&self) -> Result<f64, Invalid> {
        let reach =
            libm::ceil(self.reach_mm() / self.surface_layer().thickness_mm).max(FIELD_REACH);
        if reach <= REACH_MAX_THICKNESSES {
            return Ok(reach);
        }
        let what = format!("fields die after {reach} thicknesses of the surface layer");
        let remedy = "give a thicker surface layer, or one less stiff against those below";
        Err(Invalid::new("layers", what, remedy))
    }

    /// At the wave number a over the surface layer's thickness, in that layer's units: M/a, T/a and
    /// N of [`super::layer::Transfer`].
    pub(crate) fn surface_compliances(&self, a: f64) -> [f64; 3] {
        let layer = self.surface_layer();
        let k = a.max(WAVE_NUMBER_MIN) / layer.thickness_mm;
        let (p, q) = (self.amplitudes(k, 0.0, -1.0, 0.0), self.amplitudes(k, 0.0, 0.0, 1.0));
        let g = layer.shear_mpa();
        let unit = g / ((1.0 - layer.poisson) * layer.thickness_mm);
        [-unit * p.uz, unit * q.ux, 2.0 * g * k * q.uz]
    }

    /// F and H of the stress s_zz = -(P F + i Q H) at a depth, for wave number `k` in 1/mm.
    pub(crate) fn stress_transforms(&self, k: f64, depth_mm: f64) -> (f64, f64) {
        let k = k.max(WAVE_NUMBER_MIN / self.thickness_mm());
        let p = self.amplitudes(k, depth_mm, -1.0, 0.0);
        let q = self.amplitudes(k, depth_mm, 0.0, 1.0);
        (-p.szz, -q.szz)
    }

    /// Compliance of the face below each layer, surface layer first.
    fn compliances(&self, k: f64) -> Vec<Matrix2<f64>> {
        let mut below = Matrix2::zeros();
        let mut all = Vec::with_capacity(self.layers.len());
        for layer in self.layers.iter().rev() {
            all.push(below);
            let column = |traction: Vector2<f64>| {
                let c = coefficients(layer, k, &below, traction);
                let top = layer_functions(layer, k, layer.thickness_mm);
                Vector2::from_fn(|i, _| dot_in_order(&top[i], c.as_ref()))
            };
            below = Matrix2::from_columns(&[
                column(Vector2::new(1.0, 0.0)),
                column(Vector2::new(0.0, 1.0)),
            ]);
        }
        all.reverse();
        all
    }

    /// Amplitudes at a depth for wave number `k` (1/mm, above 0) under s_zz = `normal` cos kx and
    /// s_xz = `shear` sin kx on the surface.
    #[must_use]
    pub fn amplitudes(&self, k: f64, depth_mm: f64, normal: f64, shear: f64) -> Amplitudes {
        let compliances = self.compliances(k);
        let mut traction = Vector2::new(normal, shear);
        let mut top = 0.0;
        for (i, (layer, below)) in self.layers.iter().zip(&compliances).enumerate() {
            let c = coefficients(layer, k, below, traction);
            let bottom = top + layer.thickness_mm;
            if depth_mm <= bottom || i + 1 == self.layers.len() {
                let f = layer_functions(layer, k, (bottom - depth_mm).max(0.0));
                let [ux, uz, szz, sxz, sxx] = f.map(|row| dot_in_order(&row, c.as_ref()));
                return Amplitudes { ux, uz, szz, sxz, sxx };
            }
            let f = layer_functions(layer, k, 0.0);
            traction = Vector2::from_fn(|i, _| dot_in_order(&f[2 + i], c.as_ref()));
            top = bottom;
        }
        Amplitudes::default()
    }

    /// Stresses and displacements at `depth_mm` and `x_mm` from a line load, one for each x.
    /// Allocates; the error is that of [`line`](fn@line).
    ///
    /// # Errors
    /// Anything not finite; a depth below 0 or above the thickness; a first layer thousands
    /// of times thinner than the stack.
    pub fn line(
        &self,
        load: &LineLoad,
        depth_mm: f64,
        x_mm: &[f64],
    ) -> Result<Vec<LinePoint>, Invalid> {
        finite("p_n_mm", load.p_n_mm)?;
        finite("q_n_mm", load.q_n_mm)?;
        x_mm.iter().try_for_each(|x| finite("x_mm", *x))?;
        let (first, whole) = (&self.layers[0], self.thickness_mm());
        if depth_mm != 0.0 {
            positive("depth_mm", depth_mm)?;
            if depth_mm > whole {
                let what = format!("{depth_mm:?} is outside the layers");
                return Err(Invalid::new("depth_mm", what, "give 0 to the whole thickness"));
            }
        }
        // Near the surface the surface layer alone, on a base of its own, is taken out: what is
        // left dies as exp(-2 k t).
        let alone = depth_mm < 0.5 * first.thickness_mm;
        let single = Self { layers: vec![*first] };
        let decay = if alone { 2.0 * first.thickness_mm - depth_mm } else { depth_mm };
        let far = self.reach_mm();
        let reach = x_mm.iter().map(|x| x.abs()).filter(|x| *x <= 2.0 * far);
        let span = reach.fold(0.0, f64::max) + 1.2 * far;
        let step = 2.0 * PI / span;
        let count = libm::ceil(44.0 / decay / step);
        self.check_wave_count(count)?;
        let count = count as usize;
        let mut modes = Vec::with_capacity(count + 1);
        for i in 0..=count {
            let k = if i == 0 { WAVE_NUMBER_MIN / whole } else { i as f64 * step };
            let weight = if i == 0 { 0.5 * step / PI } else { step / PI };
            let at = |normal: f64, shear: f64| {
                let own = self.amplitudes(k, depth_mm, normal, shear);
                if !alone {
                    return own;
                }
                let less = single.amplitudes(k, depth_mm, normal, shear);
                Amplitudes {
                    ux: own.ux - less.ux,
                    uz: own.uz - less.uz,
                    szz: own.szz - less.szz,
                    sxz: own.sxz - less.sxz,
                    sxx: own.sxx - less.sxx,
                }
            };
            modes.push((if i == 0 { 0.0 } else { k }, weight, at(-1.0, 0.0), at(0.0, 1.0)));
        }
        let base = if alone { line(first, load, depth_mm, x_mm)? } else { Vec::new() };
        let point = |(i, x): (usize, &f64)| {
            let sum = if x.abs() > 2.0 * far { zero_point() } else { sum(&modes, load, *x) };
            if alone { sum_of_points(&sum, &base[i]) } else { sum }
        };
        Ok(x_mm.iter().enumerate().map(point).collect())
    }
}

/// Weights of a layer's functions for tractions on its upper face over a compliance below.
fn coefficients(
    layer: &Layer,
    k: f64,
    below: &Matrix2<f64>,
    traction: Vector2<f64>,
) -> Vector4<f64> {
    let bottom = layer_functions(layer, k, 0.0);
    let top = layer_functions(layer, k, layer.thickness_mm);
    // Displacements over the thickness, stresses over G: rows and columns of one size.
    let (length, stress) = (1.0 / layer.thickness_mm, 1.0 / layer.shear_mpa());
    let mut matrix = Matrix4::zeros();
    for j in 0..4 {
        let (s, t) = (bottom[2][j], bottom[3][j]);
        for i in 0..2 {
            let under = below[(i, 0)] * s + below[(i, 1)] * t;
            matrix[(i, j)] = length * (bottom[i][j] - under);
            matrix[(2 + i, j)] = stress * top[2 + i][j];
        }
    }
    let mut scales = [1.0; 4];
    for (j, scale) in scales.iter_mut().enumerate() {
        *scale = 1.0 / matrix.column(j).amax().max(f64::MIN_POSITIVE);
        matrix.column_mut(j).scale_mut(*scale);
    }
    let side = Vector4::new(0.0, 0.0, stress * traction[0], stress * traction[1]);
    let solution = matrix.full_piv_lu().solve(&side).unwrap_or_else(Vector4::zeros);
    Vector4::from_fn(|j, _| solution[j] * scales[j])
}

fn zero_point() -> LinePoint {
    LinePoint {
        szz_mpa: Some(0.0),
        sxx_mpa: Some(0.0),
        sxz_mpa: Some(0.0),
        uz_mm: Some(0.0),
        ux_mm: Some(0.0),
    }
}

fn sum(modes: &[(f64, f64, Amplitudes, Amplitudes)], load: &LineLoad, x: f64) -> LinePoint {
    let mut total = [0.0; 5];
    for (k, weight, p, q) in modes {
        let (s, c) = libm::sincos(k * x);
        let (p_load, q_load) = (weight * load.p_n_mm, weight * load.q_n_mm);
        // Shear in cos kx is the shear in sin kx a quarter of a wave further on.
        total[0] += p_load * p.szz * c - q_load * q.szz * s;
        total[1] += p_load * p.sxx * c - q_load * q.sxx * s;
        total[2] += p_load * p.sxz * s + q_load * q.sxz * c;
        total[3] += p_load * p.uz * c - q_load * q.uz * s;
        total[4] += p_load * p.ux * s + q_load * q.ux * c;
    }
    let [szz, sxx, sxz, uz, ux] = total.map(Some);
    LinePoint { szz_mpa: szz, sxx_mpa: sxx, sxz_mpa: sxz, uz_mm: uz, ux_mm: ux }
}

fn sum_of_points(a: &LinePoint, b: &LinePoint) -> LinePoint {
    let both = |a: Option<f64>, b: Option<f64>| Some(a? + b?);
    LinePoint {
        szz_mpa: both(a.szz_mpa, b.szz_mpa),
        sxx_mpa: both(a.sxx_mpa, b.sxx_mpa),
        sxz_mpa: both(a.sxz_mpa, b.sxz_mpa),
        uz_mm: both(a.uz_mm, b.uz_mm),
        ux_mm: both(a.ux_mm, b.ux_mm),
    }
}
