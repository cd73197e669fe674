//! Normal stress at any depth under a traction on the layer's surface, given as the points and
//! weights of a quadrature rule.
//!
//! Its Fourier transform times the layer's transfer function is summed in the wave number. From a
//! fifth of the thickness downwards the trapezoidal rule converges exponentially. At smaller depths
//! the closed form of the half plane is subtracted first, and the rest, which decays as exp(-2a + k
//! d), is summed by Gauss's rule. Lengths are in mm. The construction allocates.

use crate::layer::{Layer, Transfer};
use crate::stack::Stack;
use crate::wave_grid::{
    DECAY_EXPONENT, FIELD_REACH, GAUSS_POINTS, gauss_grid, gauss_panels, trapezoidal_grid,
    trapezoidal_steps,
};
use crate::{Invalid, positive};
use core::f64::consts::PI;

/// Depth, in parts of the thickness, above which the half plane's part is taken out.
const SHALLOW_DEPTH_MAX: f64 = 0.2;
/// Widest stretch on which Gauss's rule of ten points is exact to 1e-11: in distances of the force
/// behind it, of that ahead, in thicknesses.
const SMOOTH_STRETCH: [f64; 3] = [1.2, 0.75, 1.5];

/// A concentrated force on the surface: place, normal and tangential part (mm, N/mm).
pub type PointForce = [f64; 3];

/// The stress szz at one depth.
pub struct Spectrum {
    /// a/t, weight times the transformed stress: for cos and for sin.
    waves: Vec<[f64; 3]>,
    /// Forces whose half-plane part is added in closed form.
    shallow: Vec<PointForce>,
    /// Where the forces act, ascending.
    places: Vec<f64>,
    thickness_mm: f64,
    depth_mm: f64,
    reach_mm: f64,
    middle_mm: f64,
}

impl Spectrum {
    /// Prepares the stress at a depth above 0 and up to the thickness, for places up to `reach_mm`
    /// from x = 0. A large reach costs nothing: the number of waves grows with the width (in
    /// thicknesses) over which forces act, because 40 thicknesses beyond the forces the stress has
    /// decayed.
    #[must_use]
    pub fn new(layer: &Layer, forces: &[PointForce], depth_mm: f64, reach_mm: f64) -> Self {
        let t = layer.thickness_mm;
        let depth = (depth_mm / t).min(1.0);
        let transfer = layer.transfer();
        let of = |a: f64| transforms(&transfer, a, depth);
        Self::from_transforms(
            &of,
            [t, depth_mm, FIELD_REACH * t],
            depth < SHALLOW_DEPTH_MAX,
            forces,
            reach_mm,
        )
    }

    /// The same in a stack of layers.
    ///
    /// # Errors
    /// A depth that is not above 0; one so small, or a first layer so thin, that it takes more
    /// waves than [`Stack::line`] allows.
    pub fn of_stack(
        stack: &Stack,
        forces: &[PointForce],
        depth_mm: f64,
        reach_mm: f64,
    ) -> Result<Self, Invalid> {
        positive("depth_mm", depth_mm)?;
        let t = stack.surface_layer().thickness_mm;
        let depth_mm = depth_mm.min(stack.thickness_mm());
        let of = |a: f64| stack.stress_transforms(a / t, depth_mm);
        let (shallow, far) = (depth_mm < SHALLOW_DEPTH_MAX * t, stack.reach_mm());
        let [half, _, reach] = extent(forces, reach_mm, far);
        let (span, depth) = ((reach + half) / t, depth_mm / t);
        stack.check_wave_count(if shallow {
            GAUSS_POINTS as f64 * gauss_panels(span, depth)
        } else {
            trapezoidal_steps(span, far / t, DECAY_EXPONENT / depth)
        })?;
        Ok(Self::from_transforms(&of, [t, depth_mm, far], shallow, forces, reach_mm))
    }

    /// The stress from the transforms F and H at a wave number over t; t, the depth, and the
    /// distance at which fields have decayed are in mm.
    fn from_transforms(
        of: &dyn Fn(f64) -> (f64, f64),
        [t, depth_mm, far_mm]: [f64; 3],
        is_shallow: bool,
        forces: &[PointForce],
        reach_mm: f64,
    ) -> Self {
        let depth = depth_mm / t;
        let [half, middle, reach] = extent(forces, reach_mm, far_mm);
        let span = (reach + half) / t;
        let grid = if is_shallow {
            gauss_grid(span, depth)
        } else {
            trapezoidal_grid(span, far_mm / t, DECAY_EXPONENT / depth)
        };
        let wave = |&[a, weight]: &[f64; 2]| {
            let (mut f, mut h) = of(a);
            if is_shallow {
                let (y, decay) = (a * depth, libm::exp(-a * depth));
                f -= (1.0 + y) * decay;
                h += y * decay;
            }
            let k = a / t;
            let mut sums = [0.0; 4];
            for &[x, p, q] in forces {
                let (s, c) = libm::sincos(k * (x - middle));
                sums[0] += p * c;
                sums[1] += p * s;
                sums[2] += q * c;
                sums[3] += q * s;
            }
            // szz = (1/pi) int [-F (p_hat) + H ...]: real and odd parts of both tractions.
            let scale = weight / (PI * t);
            [k, scale * (-f * sums[0] - h * sums[3]), scale * (-f * sums[1] + h * sums[2])]
        };
        let mut places: Vec<f64> = forces.iter().map(|f| f[0]).collect();
        places.sort_by(f64::total_cmp);
        Self {
            waves: grid.iter().map(wave).collect(),
            places,
            thickness_mm: t,
            shallow: if is_shallow { forces.to_vec() } else { Vec::new() },
            depth_mm,
            reach_mm: reach,
            middle_mm: middle,
        }
    }

    /// Depth in mm.
    #[must_use]
    pub fn depth_mm(&self) -> f64 {
        self.depth_mm
    }

    /// The interval in which the stress has not decayed, within the reach.
    pub(super) fn span_mm(&self) -> [f64; 2] {
        [self.middle_mm - self.reach_mm, self.middle_mm + self.reach_mm]
    }

    /// Length from `x_mm` on over which the stress is smooth. Its singularities lie as far above
    /// the depth as the forces are; towards +x, or towards -x where `side` is -1.
    pub(super) fn smooth_stretch_mm(&self, x_mm: f64, side: f64) -> f64 {
        let right = self.places.partition_point(|place| *place < x_mm);
        let place = |i: Option<usize>| i.and_then(|i| self.places.get(i)).copied();
        let below = place(right.checked_sub(1)).map_or(f64::INFINITY, |place| x_mm - place);
        let above = place(Some(right)).map_or(f64::INFINITY, |place| place - x_mm);
        let (behind, ahead) = if side < 0.0 { (above, below) } else { (below, above) };
        let wanted = (SMOOTH_STRETCH[0] * behind)
            .min(SMOOTH_STRETCH[1] * ahead)
            .min(SMOOTH_STRETCH[2] * self.thickness_mm);
        wanted.max(SMOOTH_STRETCH[0] * self.depth_mm)
    }

    /// Derivative of [`Self::szz`] along x in MPa/mm.
    #[must_use]
    pub fn slope(&self, x_mm: f64) -> f64 {
        let x = x_mm - self.middle_mm;
        if x.abs() > self.reach_mm * (1.0 + 1e-12) {
            return 0.0;
        }
        let wave = |w: &[f64; 3]| {
            let (s, c) = libm::sincos(w[0] * x);
            w[0] * (w[2] * c - w[1] * s)
        };
        let half_plane = |f: &PointForce| {
            let (r, d) = (x_mm - f[0], self.depth_mm);
            let r2 = r * r + d * d;
            let along = f[1] * d + f[2] * r;
            -2.0 / PI * d * d / (r2 * r2) * (f[2] - 4.0 * r * along / r2)
        };
        self.waves.iter().map(wave).sum::<f64>() + self.shallow.iter().map(half_plane).sum::<f64>()
    }

    /// Second derivative of [`Self::szz`] along x in MPa/mm^2.
    #[must_use]
    pub fn bend(&self, x_mm: f64) -> f64 {
        let x = x_mm - self.middle_mm;
        if x.abs() > self.reach_mm * (1.0 + 1e-12) {
            return 0.0;
        }
        let wave = |w: &[f64; 3]| {
            let (s, c) = libm::sincos(w[0] * x);
            -w[0] * w[0] * (w[1] * c + w[2] * s)
        };
        let half_plane = |f: &PointForce| {
            let (r, d) = (x_mm - f[0], self.depth_mm);
            let r2 = r * r + d * d;
            let along = f[1] * d + f[2] * r;
            let bent = 24.0 * r * r * along / r2 - 8.0 * r * f[2] - 4.0 * along;
            -2.0 / PI * d * d / (r2 * r2 * r2) * bent
        };
        self.waves.iter().map(wave).sum::<f64>() + self.shallow.iter().map(half_plane).sum::<f64>()
    }

    /// szz in MPa at x, within the reach given; 0 far outside all forces.
    #[must_use]
    pub fn szz(&self, x_mm: f64) -> f64 {
        let x = x_mm - self.middle_mm;
        if x.abs() > self.reach_mm * (1.0 + 1e-12) {
            return 0.0;
        }
        let wave = |w: &[f64; 3]| {
            let (s, c) = libm::sincos(w[0] * x);
            w[1] * c + w[2] * s
        };
        let half_plane = |f: &PointForce| {
            let (r, d) = (x_mm - f[0], self.depth_mm);
            let r2 = r * r + d * d;
            -2.0 / PI * (f[1] * d + f[2] * r) * d * d / (r2 * r2)
        };
        self.waves.iter().map(wave).sum::<f64>() + self.shallow.iter().map(half_plane).sum::<f64>()
    }
}

/// Half the span of the forces, its middle, and the distance from there up to which the stress is
/// computed.
fn extent(forces: &[PointForce], reach_mm: f64, far_mm: f64) -> [f64; 3] {
    let low = forces.iter().map(|f| f[0]).fold(f64::INFINITY, f64::min);
    let high = forces.iter().map(|f| f[0]).fold(f64::NEG_INFINITY, f64::max);
    let middle = if low <= high { 0.5 * (low + high) } else { 0.0 };
    let half = if low <= high { 0.5 * (high - low) } else { 0.0 };
    // Far from the nearest force the stress has decayed.
    [half, middle, (reach_mm + middle.abs()).min(half + far_mm)]
}

/// F and H of szz = -(P F + i Q H)/E, each over E.
pub(crate) fn transforms(transfer: &Transfer, a: f64, depth: f64) -> (f64, f64) {
    let Transfer { m, n, kap } = *transfer;
    let (dl, e) = (a * depth, a * (1.0 - depth));
    let over = 0.5 / transfer.determinant_scaled(a);
    let (large, small) = (libm::exp(-dl), libm::exp(dl - 4.0 * a));
    let (near, far) = (libm::exp(dl - 2.0 * a), libm::exp(-dl - 2.0 * a));
    let (cp, sp) = (over * (large + small), over * (large - small));
    let (cm, sm) = (over * (near + far), over * (near - far));
    let mu = m * m + n * n;
    let f = a * e * cm + 0.5 * (kap * dl * sp + (a + e) * sm + kap * cp + mu * cm);
    let h = -(a * e + m * n) * sm - 0.5 * dl * (kap * cp + cm);
    (f, h)
}
