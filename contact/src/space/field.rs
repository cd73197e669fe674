//! Computes the stresses and displacements under a normal and tangential point load, at any depth
//! of one bonded layer or of a stack.
//!
//! A plane wave of tractions along its wave vector is the plane problem of [`super::super::stack`];
//! a wave across its wave vector puts every layer into pure shear. Their sum over all directions
//! gives Hankel transforms of order 0 to 3. These are integrated by Gauss's rule on panels no
//! longer than one period of the Bessel functions, up to wave numbers at which the fields have
//! decayed. The error is about 1e-12 of the largest value, near the load and far from it. The
//! functions allocate.
//!
//! The frame is that of [`super`]. The depth must be above 0, because the fields are singular on
//! the surface itself; [`super::radial`] and [`super::shear`] give the displacements there.

use super::super::Invalid;
use super::super::stack::{Amplitudes, Stack};
use super::super::{finite, positive};
use crate::numeric::quadrature::legendre;
use crate::wave_grid::FIELD_REACH;
use core::f64::consts::PI;

/// Gauss points of a panel.
const PANEL_POINTS: usize = 16;
/// Waves have decayed at a wave number of this over the depth.
const CUTOFF_TIMES_DEPTH: f64 = 44.0;
/// Bounds on the length of a panel: the first panel times the decay length, a panel over its own
/// wave number, and a panel times the depth.
const PANEL_LENGTHS: [f64; 3] = [0.5, 0.5, 4.0];
/// Most waves times layers, and most waves times places: they bound the time that a call takes.
const WORK_MAX: [f64; 2] = [2_097_152.0, 67_108_864.0];

/// A point load in N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointLoad {
    /// Normal force into the layer.
    pub p_n: f64,
    /// Tangential force on the layer along +x.
    pub q_n: f64,
}

/// Stress and displacement at one place under a point load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointField {
    /// Stresses xx, yy, zz, yz, xz, xy in MPa, tension above 0.
    pub stress_mpa: [f64; 6],
    /// Displacement along x, y and z (up) in mm.
    pub moved_mm: [f64; 3],
}

/// The fields of one wave number at a depth, per unit traction on the surface.
struct Wave {
    k: f64,
    /// Weight of the transform: dk k/(2 pi).
    weight: f64,
    /// Amplitudes under a pressure.
    normal: Amplitudes,
    /// Amplitudes under a tangential traction along the wave vector.
    along: Amplitudes,
    /// Displacement and shear stress under a tangential traction across the wave vector.
    across: [f64; 2],
    /// Poisson's ratio: the stress across the wave vector over the sum of those along it and along
    /// z.
    poisson: f64,
    shear_mpa: f64,
}

/// Fields at `depth_mm` and each of `places_mm` (x, y) from the load.
///
/// # Errors
/// Anything not finite; a depth that is not above 0 or below the base; places so far off against
/// the depth, or so many, that it takes too long.
pub fn point(
    stack: &Stack,
    load: &PointLoad,
    depth_mm: f64,
    places_mm: &[[f64; 2]],
) -> Result<Vec<PointField>, Invalid> {
    finite("p_n", load.p_n)?;
    finite("q_n", load.q_n)?;
    places_mm.iter().flatten().try_for_each(|at| finite("x_mm", *at))?;
    positive("depth_mm", depth_mm)?;
    if depth_mm > stack.thickness_mm() {
        let what = format!("{depth_mm:?} is outside the layers");
        return Err(Invalid::new("depth_mm", what, "give above 0 to the whole thickness"));
    }
    let far = stack.reach_mm();
    let distance = |[x, y]: &[f64; 2]| (x * x + y * y).sqrt();
    let near = places_mm.iter().map(distance).filter(|r| *r <= far).fold(0.0, f64::max);
    let waves = waves(stack, depth_mm, near, far / FIELD_REACH, places_mm.len())?;
    let at = |place: &[f64; 2]| {
        if distance(place) > far { PointField::default() } else { field_sum(&waves, load, *place) }
    };
    Ok(places_mm.iter().map(at).collect())
}

/// The waves whose sum gives the fields at places within `near` mm of the load.
fn waves(
    stack: &Stack,
    depth_mm: f64,
    near: f64,
    spread_mm: f64,
    places: usize,
) -> Result<Vec<Wave>, Invalid> {
    let [first, growing, deep] = PANEL_LENGTHS;
    let end = CUTOFF_TIMES_DEPTH / depth_mm;
    let widest = (deep / depth_mm).min(if near > 0.0 { 2.0 * PI / near } else { f64::INFINITY });
    let count = PANEL_POINTS as f64 * (end / widest + 64.0);
    if count * stack.count() as f64 > WORK_MAX[0] || count * places as f64 > WORK_MAX[1] {
        let what = format!("{depth_mm:?} with {places} places up to {near:?} mm away");
        let remedy = "the sum would take too long: give a greater depth, or fewer or nearer places";
        return Err(Invalid::new("depth_mm", what, remedy));
    }
    let rule = legendre(PANEL_POINTS);
    let mut waves = Vec::new();
    let mut from = 0.0;
    while from < end {
        let half = 0.5 * (first / spread_mm + growing * from).min(widest);
        for (place, weight) in &rule {
            let k = from + half * (1.0 + place);
            waves.push(wave(stack, depth_mm, k, half * weight * k / (2.0 * PI)));
        }
        from += 2.0 * half;
    }
    Ok(waves)
}

fn wave(stack: &Stack, depth_mm: f64, k: f64, weight: f64) -> Wave {
    let layer = stack.layer_at(depth_mm);
    Wave {
        k,
        weight,
        normal: stack.amplitudes(k, depth_mm, -1.0, 0.0),
        along: stack.amplitudes(k, depth_mm, 0.0, 1.0),
        across: stack.across(k, depth_mm),
        poisson: layer.poisson,
        shear_mpa: layer.shear_mpa(),
    }
}

/// Bessel functions of order 0 to 3.
fn bessel(y: f64) -> [f64; 4] {
    let (zero, one) = (libm::j0(y), libm::j1(y));
    if y < 4.0 {
        return [zero, one, libm::jn(2, y), libm::jn(3, y)];
    }
    let two = 2.0 * one / y - zero;
    [zero, one, two, 4.0 * two / y - one]
}

fn field_sum(waves: &[Wave], load: &PointLoad, [x, y]: [f64; 2]) -> PointField {
    let r = (x * x + y * y).sqrt();
    // Cosine and sine of the angle of the place, and of twice and three times that angle.
    let [c, s] = if r > 0.0 { [x / r, y / r] } else { [1.0, 0.0] };
    let [c2, s2] = [c * c - s * s, 2.0 * c * s];
    let [c3, s3] = [c * c2 - s * s2, s * c2 + c * s2];
    let (mut stress, mut moved) = ([0.0; 6], [0.0; 3]);
    for wave in waves {
        let [j0, j1, j2, j3] = bessel(wave.k * r);
        let inner = |a: &Amplitudes| {
            let aside = wave.poisson * (a.sxx + a.szz);
            [0.5 * (a.sxx + aside), 0.5 * (a.sxx - aside)]
        };
        let (p, q) = (wave.weight * load.p_n, wave.weight * load.q_n);
        let (a, [mean, apart]) = (&wave.normal, inner(&wave.normal));
        stress[0] += p * (mean * j0 - apart * j2 * c2);
        stress[1] += p * (mean * j0 + apart * j2 * c2);
        stress[2] += p * a.szz * j0;
        stress[3] += p * a.sxz * j1 * s;
        stress[4] += p * a.sxz * j1 * c;
        stress[5] -= p * apart * j2 * s2;
        moved[0] += p * a.ux * j1 * c;
        moved[1] += p * a.ux * j1 * s;
        moved[2] += p * a.uz * j0;
        if q == 0.0 {
            continue;
        }
        // Under a tangential traction the fields are shifted by a quarter of a wave: a term that
        // went as the cosine goes as minus the sine.
        let (a, [mean, apart], [v, w]) = (&wave.along, inner(&wave.along), wave.across);
        let turned = 0.5 * wave.shear_mpa * wave.k * v;
        let [even, odd] = [0.5 * (j1 * c - j3 * c3), 0.5 * (j1 * s - j3 * s3)];
        let [wide, aside] = [j1 * c + j3 * c3, j1 * s + j3 * s3];
        stress[0] -= q * (mean * j1 * c + apart * even + turned * wide);
        stress[1] -= q * (mean * j1 * c - apart * even - turned * wide);
        stress[2] -= q * a.szz * j1 * c;
        stress[3] -= q * 0.5 * (a.sxz - w) * j2 * s2;
        stress[4] += q * 0.5 * ((a.sxz + w) * j0 - (a.sxz - w) * j2 * c2);
        stress[5] -= q * (apart * odd + turned * aside);
        moved[0] += q * 0.5 * ((a.ux + v) * j0 - (a.ux - v) * j2 * c2);
        moved[1] -= q * 0.5 * (a.ux - v) * j2 * s2;
        moved[2] -= q * a.uz * j1 * c;
    }
    PointField { stress_mpa: stress, moved_mm: moved }
}
