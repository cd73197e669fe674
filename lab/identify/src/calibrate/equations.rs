//! The model of a reading and the normal equations of all of them. The tactels meet only in the
//! few numbers that the whole pad shares, so each tactel is eliminated by itself (Schur's
//! complement). Refuses to judge: what the equations tell is the business of the fit.
//!
//! A tactel of gain `g = s r` and offset `b` under a load `f` reads
//! `N ((g f/F - t) / (1 - t))^p + b` counts above its measured rest level: `N` counts at full scale
//! `F`, threshold `t F`, exponent `p`. The scale `s` is shared, `r` is the tactel's own; the offset
//! is what the measured rest level is wrong by: a mean of few frames.
//!
//! Hundreds of numbers of which each has few readings would bias those that all share (Neyman and
//! Scott 1948). So they are drawn towards what is known of them: an offset towards 0 by the spread
//! of a mean of the baseline's frames, `r` towards 1 by the spread of the pad's own gains.

use super::press::{Layer, LoadedImage, Pad, TACTEL_COUNT};

/// Numbers that the whole pad shares: logarithm of Young's modulus (MPa), threshold in parts of
/// full scale, exponent, logarithm of the thickness (mm), Poisson's ratio, scale of all gains.
pub const SHARED_COUNT: usize = 6;
/// Place of Young's modulus among them.
pub const MODULUS_INDEX: usize = 0;
/// Place of the threshold.
pub const THRESHOLD_INDEX: usize = 1;
/// Place of the exponent.
pub const EXPONENT_INDEX: usize = 2;
/// Place of the thickness.
pub const THICKNESS_INDEX: usize = 3;
/// Place of Poisson's ratio.
pub const POISSON_INDEX: usize = 4;
/// Place of the factor on all gains.
pub const SCALE_INDEX: usize = 5;

/// Change of the modulus' logarithm over which loads are differenced.
const MODULUS_STEP: f64 = 2e-3;
/// The same of the thickness' logarithm and of Poisson's ratio: the layers are solved anew.
const LAYER_STEPS: [f64; 2] = [0.02, 4e-3];
/// Smallest load above the threshold, in parts of full scale, whose slope is looked at.
const ABOVE_MIN: f64 = 1e-7;

/// One number for each of those that are shared.
pub type SharedVector = [f64; SHARED_COUNT];
/// One for each pair of them.
pub type SharedMatrix = [SharedVector; SHARED_COUNT];

/// Standard deviations that are assumed before a reading is seen (Bayesian priors).
#[derive(Clone, Copy, Debug)]
pub struct Priors {
    /// Standard deviation of a reading about the model (counts).
    pub noise: f64,
    /// Standard deviation of the tactels' own factors about 1.
    pub gains: f64,
    /// Standard deviation of the offsets about 0, in parts of the noise.
    pub offsets: f64,
}

/// Everything that is sought or given.
#[derive(Clone, Debug)]
pub struct Parameters {
    /// What the pad shares, see [`SHARED_COUNT`].
    pub shared: SharedVector,
    /// TactelEquations factor and offset of each tactel.
    pub tactels: Vec<[f64; 2]>,
}

/// The layer of a set of parameters, and those beside it in thickness and Poisson's ratio where
/// slopes by these are asked for.
pub struct Layers {
    here: Layer,
    beside: [Option<([Layer; 2], f64)>; 2],
}

impl Layers {
    /// Solves the layers of a parameters; `look` says by which shared numbers slopes are wanted.
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
            // Steps into the incompressible are refused by the layer.
            let h = LAYER_STEPS[1].min(0.4 * (0.5 - poisson)).max(1e-5);
            beside[1] = Some(([at(log_t, poisson - h)?, at(log_t, poisson + h)?], 2.0 * h));
        }
        Ok(Layers { here: at(log_t, poisson)?, beside })
    }

    /// Loads of a press (N), and their slopes by the shared numbers.
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
        // The mean of both sides is the middle to a part in a million.
        let mean = less.iter().zip(&more).map(|(less, more)| 0.5 * (less + more));
        (mean.collect(), slopes)
    }
}

/// What a reading says: its tactel, the model's value, what is left of the reading, and the slopes
/// by the shared numbers and by the tactel's own factor.
pub struct Reading {
    /// Number of the tactel, row by row.
    pub tactel: usize,
    /// Counts above the rest level by the model.
    pub value: f64,
    /// Counts that the model leaves.
    pub residual: f64,
    /// Slopes by the shared numbers.
    pub slopes: SharedVector,
    /// Slope by the tactel's own factor.
    pub gain_slope: f64,
}

/// Every reading that is used; NaN stands for one that is not.
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
            if above > ABOVE_MIN {
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

/// Normal equations of one tactel: its own, those with the shared numbers, the right side.
#[derive(Clone, Copy, Debug, Default)]
pub struct TactelEquations {
    /// By own factor and offset, with what is believed beforehand.
    pub square: [[f64; 2]; 2],
    /// By these and the shared numbers.
    pub cross: [SharedVector; 2],
    right: [f64; 2],
    /// The same of the readings alone.
    read: ([[f64; 2]; 2], [f64; 2]),
}

/// Normal equations at a parameters.
pub struct Equations {
    shared: SharedMatrix,
    right: SharedVector,
    /// Those of each tactel.
    pub own: Vec<TactelEquations>,
    /// Sum of squares of what is left.
    pub squares: f64,
    /// The same with what is believed beforehand.
    pub cost: f64,
    /// Readings used.
    pub readings: usize,
}

impl Equations {
    /// Sums over all readings, and what is believed beforehand, weighed as readings are.
    pub fn of(
        presses: &[&LoadedImage],
        pad: &Pad,
        at: (&Parameters, &Layers),
        priors: &Priors,
    ) -> Equations {
        let mut all = Equations {
            shared: [[0.0; SHARED_COUNT]; SHARED_COUNT],
            right: [0.0; SHARED_COUNT],
            own: vec![TactelEquations::default(); TACTEL_COUNT],
            squares: 0.0,
            cost: 0.0,
            readings: 0,
        };
        for_each_reading(presses, pad, at, |_, seen| all.add(&seen));
        all.apply_priors(&at.0.tactels, priors);
        all
    }

    /// The same readings under other priors, which the tactels are weighed by from here on: costs
    /// under different priors cannot be compared.
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

    /// The equations of the shared numbers once the tactels are eliminated, and their right side.
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

    /// The changes of a parameters that a damped step asks for; none when the equations have no
    /// solution.
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

/// Inverse of a tactel's own matrix.
pub fn inverse2(m: &[[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let det = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    [[m[1][1] / det, -m[0][1] / det], [-m[1][0] / det, m[0][0] / det]]
}

/// Inverse of the rows and columns that are free, zero elsewhere; none where it is singular in the
/// numbers' own scales.
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
