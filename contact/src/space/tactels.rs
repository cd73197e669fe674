//! Computes the image that point loads make on a rectangular array of square tactels at the base of
//! the layer: the normal stress averaged over the area of each tactel.
//!
//! The share of a point load that a tactel measures depends only on their offset. It is tabulated
//! on a grid finer than the thickness and arranged by the load's place within a tactel, so that any
//! load costs one weighted sum of blocks. A distributed pressure comes as point loads (the Gauss
//! points of its own representation). Adding loads neither allocates nor panics. Loads beside the
//! array count too, with their share on the array.

use super::super::Invalid;
pub use super::array::Array;
use super::cubic::CubicShares;
use super::ground::Sizes;
use super::radial::Influence;
use super::shear::Shear;
use super::straight::LinearShares;

/// Most numbers in a table of shares.
const TABLE_MAX: usize = 1 << 24;
/// Most cells along the axes of an array.
const CELLS_MAX: usize = 1 << 20;
/// Most grid points across one tactel.
const PHASES_MAX: usize = 256;

/// Largest tactel in thicknesses.
const PITCH_RATIO_MAX: f64 = 1000.0;

/// Thickness in tactels above which bilinear tables reach further: a thick layer's image is made of
/// few loads, whose errors do not average out.
const THICK_LAYER_RATIO: f64 = 0.7;
/// Factor on the reach of bilinear tables of normal loads on a thick layer.
const THICK_REACH_FACTOR: f64 = 1.25;
/// Factor on the reach of bilinear tables of tangential loads on a thick layer.
const SHEARED_REACH_FACTOR: f64 = 2.0;
/// Factor on the density of bilinear tables of tangential loads on any layer.
const SHEARED_DENSITY_FACTOR: f64 = 10.0 / 6.0;

/// What a tactel reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// The mean over its square: what a sensor measures.
    Area,
    /// The value under its centre.
    Centre,
}

/// How finely offsets are tabulated and read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fineness {
    /// Grid points per thickness.
    pub per_thickness: f64,
    /// Distance beyond which shares are neglected, in thicknesses.
    pub reach: f64,
    /// Whether the grid is interpolated by cubics; linearly otherwise.
    pub cubic: bool,
}

impl Fineness {
    /// About 1e-5 of a load's largest share.
    pub const DEFAULT: Self = Self { per_thickness: 10.0, reach: 14.0, cubic: true };
    /// Within 1e-2 of it, several times faster; the shares of a load still sum to its force.
    pub const FAST: Self = Self { per_thickness: 6.0, reach: 6.0, cubic: false };
    /// About 1e-7 of it.
    pub const FINE: Self = Self { per_thickness: 32.0, reach: 24.0, cubic: true };
}

/// The image that a [`Shares`] makes of point loads, for one array and one layer.
#[derive(Clone, Debug)]
pub struct Shares {
    array: Array,
    sampling: Sampling,
    reading: Reading,
}

/// How a load's shares are read.
#[derive(Clone, Debug)]
enum Reading {
    Cubic(CubicShares),
    Linear(LinearShares),
}

impl Shares {
    /// Tabulates the shares of normal loads; allocates.
    ///
    /// # Errors
    /// An array that [`Array::check`] refuses; a table that would not fit in memory.
    pub fn new(
        influence: &Influence,
        array: &Array,
        sampling: Sampling,
        fineness: Fineness,
    ) -> Result<Self, Invalid> {
        let base = Base {
            sizes: influence.sizes(),
            point: &|[x, y]| influence.base_point((x * x + y * y).sqrt()),
            cell: &|place, half| influence.base_cell(place, half),
            odd: false,
        };
        Self::of(&base, array, sampling, fineness)
    }

    /// Tabulates the shares of tangential loads along +x; allocates. [`Shares::add`] then takes the
    /// force along x.
    ///
    /// # Errors
    /// As [`Shares::new`].
    pub fn sheared(
        shear: &Shear,
        array: &Array,
        sampling: Sampling,
        fineness: Fineness,
    ) -> Result<Self, Invalid> {
        let base = Base {
            sizes: shear.sizes(),
            point: &|place| shear.base_point(place),
            cell: &|place, half| shear.base_cell(place, half),
            odd: true,
        };
        Self::of(&base, array, sampling, fineness)
    }

    fn of(
        base: &Base,
        array: &Array,
        sampling: Sampling,
        fineness: Fineness,
    ) -> Result<Self, Invalid> {
        array.check()?;
        let Sizes { thickness_mm: t, spread_mm, .. } = base.sizes;
        if array.pitch_mm > PITCH_RATIO_MAX * t {
            return Err(unrelated_sizes(array, t));
        }
        // The share of a tangential load is zero right below it. Its curvature and its far field
        // are therefore larger relative to its largest share, and need a finer, wider table.
        let thick = t > THICK_LAYER_RATIO * array.pitch_mm;
        let [finer, further] = match (fineness.cubic, base.odd, thick) {
            (true, ..) | (false, false, false) => [1.0; 2],
            (false, false, true) => [1.0, THICK_REACH_FACTOR],
            (false, true, false) => [SHEARED_DENSITY_FACTOR, 1.0],
            (false, true, true) => [SHEARED_DENSITY_FACTOR, SHEARED_REACH_FACTOR],
        };
        let per_tactel = finer * fineness.per_thickness * array.pitch_mm / t;
        let phases = 2 * (libm::ceil(0.5 * per_tactel).max(1.0) as usize).min(PHASES_MAX / 2);
        let reach = further * fineness.reach * spread_mm / array.pitch_mm;
        // The table is as wide as the reach even on a small array: a single tactel on a thick layer
        // is loaded by a contact wider than itself. With `half` tactels on each side of the load's
        // own tactel the next one is beyond the reach wherever the load lies in its tactel.
        let half = libm::ceil(reach) as usize;
        let side = LinearShares::side_for(reach);
        // Bilinear tables also list the cells along both axes.
        let cells = array.rows.saturating_add(array.cols).saturating_mul(phases);
        if !fineness.cubic && cells > CELLS_MAX {
            let what = format!("{} rows of {} tactels", array.rows, array.cols);
            return Err(Invalid::new("rows", what, "give fewer rows and columns"));
        }
        let numbers = if fineness.cubic {
            let side = half.saturating_mul(2).saturating_add(1);
            side.saturating_mul(side).saturating_mul((phases + 3) * (phases + 3))
        } else {
            LinearShares::len(phases, side)
        };
        if numbers > TABLE_MAX {
            return Err(unrelated_sizes(array, t));
        }
        let half = if fineness.cubic { half } else { side / 2 + 1 };
        let offsets = Offsets::new(base, array, sampling, phases, half);
        let reading = if fineness.cubic {
            Reading::Cubic(CubicShares::new(phases, half, |i, j| offsets.share(i, j)))
        } else {
            let kept = sampling == Sampling::Area && !base.odd;
            let whole = kept.then(|| 1.0 / (array.pitch_mm * array.pitch_mm));
            Reading::Linear(LinearShares::new(
                array,
                phases,
                side,
                |[i, j]| offsets.share(i, j),
                whole,
            ))
        };
        Ok(Self { array: *array, sampling, reading })
    }

    /// The array.
    #[must_use]
    pub fn array(&self) -> &Array {
        &self.array
    }

    /// Adds the stress (MPa, negative) of a load of `force_n` at `place_mm` to an image, row by
    /// row. Loads that are not finite, or further off the array than the table reaches, add
    /// nothing; so does an image of the wrong length.
    pub fn add(&self, image: &mut [f64], [x, y]: [f64; 2], force_n: f64) {
        let Array { rows, cols, pitch_mm } = self.array;
        if !force_n.is_finite() || force_n == 0.0 || image.len() != rows * cols {
            return;
        }
        match &self.reading {
            Reading::Cubic(shares) => {
                // Places in tactels from the lower left corner of the array.
                let place = [x / pitch_mm + 0.5 * cols as f64, y / pitch_mm + 0.5 * rows as f64];
                shares.add((image, cols), place, -force_n);
            }
            Reading::Linear(shares) => shares.add(image, [x, y], -force_n),
        }
    }
}

/// The error for a pitch and a thickness too different for one table. It names the size that is
/// further from a millimetre, which is more likely to be wrong.
fn unrelated_sizes(array: &Array, t: f64) -> Invalid {
    let pitch = array.pitch_mm;
    let far = |size: f64| libm::log(size).abs();
    let (place, what) = if far(t) > far(pitch) {
        ("thickness_mm", format!("{t:e} mm on tactels of {pitch:e} mm"))
    } else {
        ("pitch_mm", format!("{pitch:e} mm under a layer of {t:e} mm"))
    };
    Invalid::new(place, what, "give a pitch closer to the thickness, or choose a lower accuracy")
}

impl Shares {
    /// Side of the square that a tactel is the mean over, mm; absent for values under a centre.
    pub(super) fn mean_over_mm(&self) -> Option<f64> {
        (self.sampling == Sampling::Area).then_some(self.array.pitch_mm)
    }

    /// Tactels along each axis on which a load acts.
    pub(super) fn side(&self) -> usize {
        match &self.reading {
            Reading::Cubic(shares) => shares.side(),
            Reading::Linear(shares) => shares.side(),
        }
    }

    /// Whether a load within `about_mm` of a place may act on the array.
    pub(super) fn sees(&self, [x, y]: [f64; 2], about_mm: f64) -> bool {
        let Array { rows, cols, pitch_mm } = self.array;
        let near = |place: f64, count: usize| {
            place.abs() < about_mm + (0.5 * (count + self.side()) as f64 + 1.0) * pitch_mm
        };
        near(x, cols) && near(y, rows)
    }
}

/// Base stress of a unit load: its value at an offset from the load, and its integral over a
/// rectangle of given half-sides about that offset.
struct Base<'a> {
    sizes: Sizes,
    point: &'a dyn Fn([f64; 2]) -> f64,
    cell: &'a dyn Fn([f64; 2], [f64; 2]) -> f64,
    /// Whether both are odd along x; they are even along y.
    odd: bool,
}

/// Shares over offsets that are whole multiples of the grid's spacing, both at least 0.
struct Offsets {
    width: usize,
    shares: Vec<f64>,
    odd: bool,
}

impl Offsets {
    fn new(base: &Base, array: &Array, sampling: Sampling, phases: usize, half: usize) -> Self {
        let spacing = array.pitch_mm / phases as f64;
        let width = (half + 1) * phases + 2;
        let odd = base.odd;
        let pressure = |i: usize, j: usize| -(base.point)([i, j].map(|k| k as f64 * spacing));
        if sampling == Sampling::Centre {
            let shares = (0..width * width).map(|n| pressure(n % width, n / width)).collect();
            return Self { width, shares, odd };
        }
        // Integrals over the rectangle from the origin to each grid point, as running sums of
        // cells.
        let reach = width + phases / 2;
        let mut sums = vec![0.0; (reach + 1) * (reach + 1)];
        for j in 0..reach {
            let mut row = 0.0;
            for i in 0..reach {
                let at = |k: usize| (k as f64 + 0.5) * spacing;
                let cell = (base.cell)([at(i), at(j)], [0.5 * spacing; 2]);
                row -= cell;
                let below = sums[j * (reach + 1) + i + 1];
                sums[(j + 1) * (reach + 1) + i + 1] = below + row;
            }
        }
        // Symmetry extends the sums to negative indices, for tactels across the origin.
        let sum = |i: isize, j: isize| {
            let value = sums[j.unsigned_abs() * (reach + 1) + i.unsigned_abs()];
            if (i < 0 && !odd) == (j < 0) { value } else { -value }
        };
        let (h, area) = (phases as isize / 2, array.pitch_mm * array.pitch_mm);
        let share = |n: usize| {
            let (i, j) = ((n % width) as isize, (n / width) as isize);
            let whole = sum(i + h, j + h) - sum(i - h, j + h);
            (whole - sum(i + h, j - h) + sum(i - h, j - h)) / area
        };
        Self { width, shares: (0..width * width).map(share).collect(), odd }
    }

    fn share(&self, i: isize, j: isize) -> f64 {
        let (x, y) = (i.unsigned_abs(), j.unsigned_abs());
        if x >= self.width || y >= self.width {
            return 0.0;
        }
        let share = self.shares[y * self.width + x];
        if self.odd && i < 0 { -share } else { share }
    }
}
