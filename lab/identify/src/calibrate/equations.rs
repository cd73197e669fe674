//! The model of a reading, and the normal equations of all readings. The tactels are coupled only
//! by the few parameters that the whole pad shares, so each tactel is eliminated by itself (Schur's
//! complement). The fit evaluates the equations.
//!
//! A tactel of gain `g = s r` and offset `b` under a load `f` reads `N ((g f/F - t) / (1 - t))^p +
//! b` counts above its measured rest level: `N` counts at full scale `F`, threshold `t F`, exponent
//! `p`. The scale `s` is shared, `r` is the tactel's own. The offset `b` is the error of the
//! measured rest level, which is a mean of few frames.
//!
//! Hundreds of parameters with few readings each would bias the shared ones (Neyman and Scott
//! 1948). Priors prevent this: an offset is drawn towards 0 by the standard deviation of a mean of
//! the baseline's frames, and `r` towards 1 by the spread of the pad's own gains.

use super::press::{Layer, LoadedImage, Pad};

/// Number of parameters that the whole pad shares: logarithm of Young's modulus (MPa), threshold as
/// a fraction of full scale, exponent, logarithm of the thickness (mm), Poisson's ratio, scale of
/// all gains.
pub const SHARED_COUNT: usize = 6;
/// Index of Young's modulus among the shared parameters.
pub const MODULUS_INDEX: usize = 0;
/// Index of the threshold.
pub const THRESHOLD_INDEX: usize = 1;
/// Index of the exponent.
pub const EXPONENT_INDEX: usize = 2;
/// Index of the thickness.
pub const THICKNESS_INDEX: usize = 3;
/// Index of Poisson's ratio.
pub const POISSON_INDEX: usize = 4;
/// Index of the scale of all gains.
pub const SCALE_INDEX: usize = 5;

/// Step of the logarithm of the modulus for the differences of loads.
const MODULUS_STEP: f64 = 2e-3;
/// Steps of the logarithm of the thickness and of Poisson's ratio; the layer is solved again for
/// each.
const LAYER_STEPS: [f64; 2] = [0.02, 4e-3];
/// Smallest load above the threshold, as a fraction of full scale, at which the slope is used.
const LOAD_ABOVE_THRESHOLD_MIN: f64 = 1e-7;

/// One value for each shared parameter.
pub type SharedVector = [f64; SHARED_COUNT];
/// One value for each pair of shared parameters.
pub type SharedMatrix = [SharedVector; SHARED_COUNT];

/// Standard deviations that are assumed before any reading (Bayesian priors).
#[derive(Clone, Copy, Debug)]
pub struct Priors {
    /// Standard deviation of a reading about the model (counts).
    pub noise: f64,
    /// Standard deviation of the tactels' own factors about 1.
    pub gains: f64,
    /// Standard deviation of the offsets about 0, as a fraction of the noise.
    pub offsets: f64,
}

/// All parameters of a pad, sought or given.
#[derive(Clone, Debug)]
pub struct Parameters {
    /// The shared parameters, see [`SHARED_COUNT`].
    pub shared: SharedVector,
    /// Gain factor and offset of each tactel.
    pub tactels: Vec<[f64; 2]>,
}

/// The layer of a set of parameters, and the layers with a changed thickness or Poisson's ratio
/// where the slopes by these are needed.
pub struct Layers {
    here: Layer,
    beside: [Option<([Layer; 2], f64)>; 2],
}

impl Layers {
    /// Solves the layers of a set of parameters; `look` selects the shared parameters whose slopes
    /// are needed.
    ///
    /// # Errors
    /// A layer that cannot be solved.
    pub fn of(
        pad: &Pad,
        shared: &SharedVector,
        look: &[bool; SHARED_COUNT],
    ) -> Result<Layers, String> {
        let at = |log_t: f64, poisson: f64| pad.layer(libm::exp(log_t), poisson);
        let (log_t, poisson) = (shared[THICKNESS_INDEX], shared[POISSON_INDEX]);
        let mut beside = [None, None];
        if look[THICKNESS_INDEX] {
            let h = LAYER_STEPS[0];
            beside[0] = Some(([at(log_t - h, poisson)?, at(log_t + h, poisson)?], 2.0 * h));
        }
        if look[POISSON_INDEX] {
            // The layer rejects a Poisson's ratio beyond the incompressible 0.5.
            let h = LAYER_STEPS[1].min(0.4 * (0.5 - poisson)).max(1e-5);
            beside[1] = Some(([at(log_t, poisson - h)?, at(log_t, poisson + h)?], 2.0 * h));
        }
        Ok(Layers { here: at(log_t, poisson)?, beside })
    }

    /// Loads of an image (N), and their slopes by the shared parameters.
    fn loads(
        &self,
        press: &LoadedImage,
        shared: &SharedVector,
    ) -> (Vec<f64>, [Vec<f64>; SHARED_COUNT]) {
        let at = |way: f64| libm::exp(shared[MODULUS_INDEX] + way * MODULUS_STEP);
        let (less, more) = (self.here.loads(press, at(-1.0)), self.here.loads(press, at(1.0)));
        let differences = |less: &[f64], more: &[f64], over: f64| -> Vec<f64> {
            less.iter().zip(more).map(|(less, more)| (more - less) / over).collect()
        };
        let mut slopes: [Vec<f64>; SHARED_COUNT] = Default::default();
        slopes[MODULUS_INDEX] = differences(&less, &more, 2.0 * MODULUS_STEP);
        for (place, beside) in [THICKNESS_INDEX, POISSON_INDEX].into_iter().zip(&self.beside) {
            if let Some(([less, more], over)) = beside {
                let mpa = at(0.0);
                let (less, more) = (less.loads(press, mpa), more.loads(press, mpa));
                slopes[place] = differences(&less, &more, *over);
            }
        }
        // The mean of both sides equals the middle to one part in a million.
        let mean = less.iter().zip(&more).map(|(less, more)| 0.5 * (less + more));
        (mean.collect(), slopes)
    }
}

/// A reading: its tactel, the model's value, the residual, and the slopes by the shared parameters
/// and by the tactel's own factor.
pub struct Reading {
    /// Index of the tactel, row by row.
    pub tactel: usize,
    /// Counts above the rest level according to the model.
    pub value: f64,
    /// Residual: measured minus modelled counts.
    pub residual: f64,
    /// Slopes by the shared parameters.
    pub slopes: SharedVector,
    /// Slope by the tactel's own factor.
    pub gain_slope: f64,
}

/// Calls a function with every reading that is used; NaN marks a reading that is not.
pub fn for_each_reading(
    presses: &[&LoadedImage],
    pad: &Pad,
    (parameters, layers): (&Parameters, &Layers),
    mut see: impl FnMut(usize, Reading),
) {
    let [_, threshold, exponent, _, _, scale] = parameters.shared;
    let (full, rest) = (pad.full_scale_n, 1.0 - threshold);
    for (image, press) in presses.iter().enumerate() {
        let (loads, slopes) = layers.loads(press, &parameters.shared);
        for (tactel, &load) in loads.iter().enumerate() {
            if press.counts[tactel].is_nan() {
                continue;
            }
            let [own, offset] = parameters.tactels[tactel];
            let gain = scale * own;
            let above = (gain * load / full - threshold) / rest;
            let (mut by, mut gain_slope, mut value) = ([0.0; SHARED_COUNT], 0.0, 0.0);
            if above > LOAD_ABOVE_THRESHOLD_MIN {
                value = pad.full_counts * libm::pow(above, exponent);
                let per_load = exponent * value / above * gain / (full * rest);
                for (by, slopes) in by.iter_mut().zip(&slopes) {
                    *by = slopes.get(tactel).map_or(0.0, |slope| per_load * slope);
                }
                let per_above = exponent * value / above;
                by[THRESHOLD_INDEX] = per_above * (gain * load / full - 1.0) / (rest * rest);
                by[EXPONENT_INDEX] = value * libm::log(above);
                gain_slope = per_above * scale * load / (full * rest);
                by[SCALE_INDEX] = per_above * own * load / (full * rest);
            }
            let residual = press.counts[tactel] - value - offset;
            see(image, Reading { tactel, value: value + offset, residual, slopes: by, gain_slope });
        }
    }
}

/// Normal equations of one tactel: its own block, the block shared with the pad, and the right
/// side.
#[derive(Clone, Copy, Debug, Default)]
pub struct TactelEquations {
    /// Block of its own factor and offset, priors included.
    pub square: [[f64; 2]; 2],
    /// Block that couples these to the shared parameters.
    pub cross: [SharedVector; 2],
    right: [f64; 2],
    /// The right side without the priors.
    read: ([[f64; 2]; 2], [f64; 2]),
}

/// Normal equations at a set of parameters.
pub struct Equations {
    shared: SharedMatrix,
    right: SharedVector,
    /// The equations of each tactel.
    pub own: Vec<TactelEquations>,
    /// Sum of the squared residuals.
    pub squares: f64,
    /// The same sum with the priors added.
    pub cost: f64,
    /// Number of readings used.
    pub readings: usize,
}

impl Equations {
    /// Sums over all readings and the priors; a prior is weighted like readings.
    pub fn of(
        presses: &[&LoadedImage],
        pad: &Pad,
        at: (&Parameters, &Layers),
        priors: &Priors,
    ) -> Equations {
        let mut all = Equations {
            shared: [[0.0; SHARED_COUNT]; SHARED_COUNT],
            right: [0.0; SHARED_COUNT],
            own: vec![TactelEquations::default(); pad.array.tactels()],
            squares: 0.0,
            cost: 0.0,
            readings: 0,
        };
        for_each_reading(presses, pad, at, |_, seen| all.add(&seen));
        all.apply_priors(&at.0.tactels, priors);
        all
    }

    /// Replaces the priors. Costs under different priors cannot be compared.
    pub fn apply_priors(&mut self, tactels: &[[f64; 2]], priors: &Priors) {
        let (gains, offsets) = (priors.noise / priors.gains, 1.0 / priors.offsets);
        let (gains, offsets) = (gains * gains, offsets * offsets);
        self.cost = self.squares;
        for (own, [gain, offset]) in self.own.iter_mut().zip(tactels) {
            (own.square, own.right) = own.read;
            own.square[0][0] += gains;
            own.square[1][1] += offsets;
            own.right[0] += gains * (1.0 - gain);
            own.right[1] -= offsets * offset;
            self.cost += gains * (1.0 - gain) * (1.0 - gain) + offsets * offset * offset;
        }
    }

    fn add(&mut self, seen: &Reading) {
        self.readings += 1;
        self.squares += seen.residual * seen.residual;
        let own = &mut self.own[seen.tactel];
        let mine = [seen.gain_slope, 1.0];
        let (square, right) = &mut own.read;
        for a in 0..2 {
            right[a] += mine[a] * seen.residual;
            for b in 0..2 {
                square[a][b] += mine[a] * mine[b];
            }
            for c in 0..SHARED_COUNT {
                own.cross[a][c] += mine[a] * seen.slopes[c];
            }
        }
        for c in 0..SHARED_COUNT {
            self.right[c] += seen.slopes[c] * seen.residual;
            for d in 0..SHARED_COUNT {
                self.shared[c][d] += seen.slopes[c] * seen.slopes[d];
            }
        }
    }

    /// The equations of the shared parameters after the tactels are eliminated, and their right
    /// side.
    pub fn reduced(&self, damping: f64) -> (SharedMatrix, SharedVector) {
        let (mut square, mut right) = (self.shared, self.right);
        for (c, row) in square.iter_mut().enumerate() {
            row[c] *= 1.0 + damping;
        }
        for own in &self.own {
            let inverse = inverse2(&damped(own, damping));
            for c in 0..SHARED_COUNT {
                for (a, row) in inverse.iter().enumerate() {
                    let through: f64 = (0..2).map(|b| own.cross[b][c] * row[b]).sum();
                    right[c] -= through * own.right[a];
                    for (d, entry) in square[c].iter_mut().enumerate() {
                        *entry -= through * own.cross[a][d];
                    }
                }
            }
        }
        (square, right)
    }

    /// The changes of the parameters in a damped step; `None` when the equations are singular.
    pub fn step(
        &self,
        free: &[bool; SHARED_COUNT],
        damping: f64,
    ) -> Option<(SharedVector, Vec<[f64; 2]>)> {
        let (square, right) = self.reduced(damping);
        let inverse = inverse(&square, free)?;
        let shared: SharedVector =
            core::array::from_fn(|c| (0..SHARED_COUNT).map(|d| inverse[c][d] * right[d]).sum());
        let own = |own: &TactelEquations| {
            let inverse = inverse2(&damped(own, damping));
            let rest: [f64; 2] = core::array::from_fn(|a| {
                own.right[a] - (0..SHARED_COUNT).map(|c| own.cross[a][c] * shared[c]).sum::<f64>()
            });
            inverse.map(|row| row[0] * rest[0] + row[1] * rest[1])
        };
        Some((shared, self.own.iter().map(own).collect()))
    }
}

fn damped(own: &TactelEquations, damping: f64) -> [[f64; 2]; 2] {
    let mut square = own.square;
    square[0][0] *= 1.0 + damping;
    square[1][1] *= 1.0 + damping;
    square
}

/// Inverse of a tactel's own block.
pub fn inverse2(m: &[[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let det = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    [[m[1][1] / det, -m[0][1] / det], [-m[1][0] / det, m[0][0] / det]]
}

/// Inverse over the free rows and columns, zero elsewhere; `None` where the matrix is singular
/// relative to its own diagonal.
pub fn inverse(square: &SharedMatrix, free: &[bool; SHARED_COUNT]) -> Option<SharedMatrix> {
    let size: SharedVector = core::array::from_fn(|c| square[c][c].max(0.0).sqrt());
    if (0..SHARED_COUNT).any(|c| free[c] && !(size[c].is_finite() && size[c] > 0.0)) {
        return None;
    }
    let scaled = nalgebra::SMatrix::<f64, SHARED_COUNT, SHARED_COUNT>::from_fn(|c, d| {
        if free[c] && free[d] {
            square[c][d] / (size[c] * size[d])
        } else {
            f64::from(u8::from(c == d))
        }
    });
    let inverse = scaled.cholesky()?.inverse();
    let entry = |c: usize, d: usize| {
        if free[c] && free[d] { inverse[(c, d)] / (size[c] * size[d]) } else { 0.0 }
    };
    Some(core::array::from_fn(|c| core::array::from_fn(|d| entry(c, d))))
}
