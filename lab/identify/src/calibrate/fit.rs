//! Least squares over all images at once: the shared parameters, and gain and offset of each
//! tactel, by damped Gauss-Newton steps (Marquardt 1963). Standard deviations come from the same
//! equations at the optimum and from the residuals. Where the residuals of neighbouring images are
//! correlated, they come from the sums over segments of the log (Liang and Zeger 1986), whichever
//! is larger. A value that the images do not determine is not stated.
//!
//! Loads have to be known in newtons: a common factor on them would be a factor on all gains.

use super::equations::{
    EXPONENT_INDEX, Equations, Layers, MODULUS_INDEX, POISSON_INDEX, Parameters, Priors,
    SCALE_INDEX, SHARED_COUNT, SharedMatrix, SharedVector, THICKNESS_INDEX, THRESHOLD_INDEX,
    for_each_reading, inverse, inverse2,
};
use super::identifiability::{DEVIATION_MAX, Identifiability};
use super::press::{LoadedImage, Pad};

/// Smallest number of images for a fit.
const IMAGES_MIN: usize = 50;
/// Largest number of images; of more, evenly spaced ones are used.
const IMAGES_MAX: usize = 1500;
/// Number of images on which an initial value is tried.
const INITIAL_IMAGES_MAX: usize = 40;
/// Young's moduli that are tried as initial values (MPa).
const INITIAL_MODULI_MPA: [f64; 7] = [0.1, 0.4, 1.5, 5.0, 20.0, 80.0, 300.0];
/// Largest number of steps.
const ITERATIONS_MAX: usize = 60;
/// The search ends when an undamped step lowers the sum of squares by less than this fraction of
/// one reading's variance.
const COST_DECREASE_MIN: f64 = 1e-3;
/// Damping that counts as none. Stiffness, exponent and gains are almost interchangeable: along
/// this direction the cost rises 1e6 times more slowly than across it.
const DAMPING_NEGLIGIBLE: f64 = 1e-9;
/// Damping of the first step.
const INITIAL_DAMPING: f64 = 1e-3;
/// Damping at which the search fails.
const DAMPING_MAX: f64 = 1e8;
/// Number of segments of the log whose residuals count as independent of each other.
const SEGMENT_COUNT: usize = 20;
/// Largest number of times that the spread of the gains is estimated again.
const SPREAD_ITERATIONS_MAX: usize = 6;
/// Initial spread of the gains.
const INITIAL_GAIN_SPREAD: f64 = 0.1;
/// Smallest spread of the gains.
const GAIN_SPREAD_MIN: f64 = 3e-3;
/// Largest spread of the gains.
const GAIN_SPREAD_MAX: f64 = 0.5;
/// A gain is stated when its remaining variance is at most this fraction of the variance of all
/// gains.
const GAIN_VARIANCE_SHARE_MAX: f64 = 0.5;
/// Readings above this fraction of the converter's range may be clipped and are left out.
const CLIPPING_RATIO: f64 = 0.9;
/// Largest fraction of the pressed readings that may be clipped.
const CLIPPED_SHARE_MAX: f64 = 0.2;
/// Smallest reading, as a fraction of the range, that counts as pressed.
const PRESSED_RATIO_MIN: f64 = 0.05;

/// A value and its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// One standard deviation.
    pub deviation: f64,
}

/// The result of a calibration.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Images that were fitted.
    pub images: usize,
    /// Readings that were fitted.
    pub readings: usize,
    /// Readings that were left out because they may have been clipped.
    pub clipped: usize,
    /// Young's modulus of the rubber (MPa).
    pub youngs_mpa: Estimate,
    /// Force below which a tactel reads nothing (N).
    pub threshold_n: Estimate,
    /// Exponent of the response.
    pub exponent: Estimate,
    /// The layer's thickness (mm); `None` where it was given.
    pub thickness_mm: Option<Estimate>,
    /// Poisson's ratio; `None` where it was given.
    pub poisson: Option<Estimate>,
    /// Standard deviation of a reading about the model (counts).
    pub noise_counts: f64,
    /// Gain factor that all tactels share.
    pub scale: Estimate,
    /// Spread of the tactels' own factors about the shared one.
    pub gain_spread: f64,
    /// Gain of each tactel, row by row; `None` where it was not pressed enough.
    pub gains: Vec<Option<Estimate>>,
    /// Which shared parameters these images determine.
    pub identifiability: Identifiability,
}

/// What is estimated besides modulus, threshold and exponent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExtraUnknowns {
    /// The layer's thickness.
    pub thickness: bool,
    /// Its Poisson's ratio.
    pub poisson: bool,
}

/// The state of a search.
struct Search<'a> {
    presses: Vec<&'a LoadedImage>,
    pad: &'a Pad,
    free: [bool; SHARED_COUNT],
    parameters: Parameters,
    layers: Layers,
    here: Equations,
    priors: Priors,
    /// Damping of the next step.
    damping: f64,
}

/// Standard deviation of a reading (counts). A parameter with a prior uses only a part of a degree
/// of freedom.
fn spread(at: &Equations, free: &[bool; SHARED_COUNT], priors: &Priors) -> f64 {
    let (gains, offsets) = (priors.noise / priors.gains, 1.0 / priors.offsets);
    let taken = |own: &super::equations::TactelEquations| {
        let left = inverse2(&own.square);
        2.0 - gains * gains * left[0][0] - offsets * offsets * left[1][1]
    };
    let sought =
        at.own.iter().map(taken).sum::<f64>() + free.iter().filter(|free| **free).count() as f64;
    (at.squares / (at.readings as f64 - sought).max(1.0)).sqrt().max(1e-3)
}

impl<'a> Search<'a> {
    fn from(
        presses: Vec<&'a LoadedImage>,
        pad: &'a Pad,
        free: [bool; SHARED_COUNT],
        parameters: Parameters,
    ) -> Result<Search<'a>, String> {
        let layers = Layers::of(pad, &parameters.shared, &free)?;
        let offsets = 1.0 / pad.baseline_frames.sqrt();
        let mut priors = Priors { noise: 1.0, gains: INITIAL_GAIN_SPREAD, offsets };
        let mut here = Equations::of(&presses, pad, (&parameters, &layers), &priors);
        priors.noise = spread(&here, &free, &priors);
        here.apply_priors(&parameters.tactels, &priors);
        Ok(Search {
            presses,
            pad,
            free,
            parameters,
            layers,
            here,
            priors,
            damping: INITIAL_DAMPING,
        })
    }

    /// Descends, estimates the spread of the gains from the tactels, and repeats (MacKay 1992).
    fn solve(&mut self, told: &mut dyn FnMut()) -> Result<(), String> {
        for _ in 0..SPREAD_ITERATIONS_MAX {
            self.descend(ITERATIONS_MAX, told)?;
            let before = self.priors.gains;
            let (mut squares, mut determined) = (0.0, 0.0);
            for (own, tactel) in self.here.own.iter().zip(&self.parameters.tactels) {
                let left = self.priors.noise / before;
                determined += 1.0 - left * left * inverse2(&own.square)[0][0];
                squares += (tactel[0] - 1.0) * (tactel[0] - 1.0);
            }
            let next =
                (squares / determined.max(1e-3)).sqrt().clamp(GAIN_SPREAD_MIN, GAIN_SPREAD_MAX);
            self.priors.gains = next;
            self.here.apply_priors(&self.parameters.tactels, &self.priors);
            if (next / before - 1.0).abs() < 0.02 {
                break;
            }
        }
        self.descend(ITERATIONS_MAX, told)
    }

    /// Takes steps until the cost no longer falls; `told` is called after each.
    fn descend(&mut self, steps: usize, told: &mut dyn FnMut()) -> Result<(), String> {
        // Later rounds start near the optimum and need no strong damping.
        self.damping = self.damping.min(INITIAL_DAMPING);
        for _ in 0..steps {
            let damping = self.damping;
            let Some(next) = self.next_parameters(damping) else { break };
            // The layers are solved for these parameters; all others only scale the loads.
            let moved = self.free[THICKNESS_INDEX] || self.free[POISSON_INDEX];
            let anew =
                if moved { Some(Layers::of(self.pad, &next.shared, &self.free)?) } else { None };
            let layers = anew.as_ref().unwrap_or(&self.layers);
            let at = (&next, layers);
            let there = Equations::of(&self.presses, self.pad, at, &self.priors);
            told();
            if there.cost < self.here.cost {
                // A damped step may be short only because of its damping, so only an undamped step
                // ends the search.
                let gained = self.here.cost - there.cost;
                let noise = self.priors.noise;
                let done =
                    gained < COST_DECREASE_MIN * noise * noise && damping < DAMPING_NEGLIGIBLE;
                self.priors.noise = spread(&there, &self.free, &self.priors);
                (self.parameters, self.here, self.damping) = (next, there, 0.1 * damping);
                // The next comparison uses the new priors on both sides.
                self.here.apply_priors(&self.parameters.tactels, &self.priors);
                if let Some(layers) = anew {
                    self.layers = layers;
                }
                if done {
                    break;
                }
            } else {
                self.damping *= 10.0;
                if self.damping > DAMPING_MAX {
                    break;
                }
            }
        }
        Ok(())
    }

    /// The parameters after a step, limited to physical bounds.
    fn next_parameters(&self, damping: f64) -> Option<Parameters> {
        let (shared, tactels) = self.here.step(&self.free, damping)?;
        let mut next = self.parameters.clone();
        for (value, change) in next.shared.iter_mut().zip(shared) {
            *value += change;
        }
        let bound = |value: &mut f64, low: f64, high: f64| *value = value.clamp(low, high);
        let given = libm::log(self.pad.thickness_mm);
        bound(&mut next.shared[MODULUS_INDEX], -4.0, 7.0);
        bound(&mut next.shared[THRESHOLD_INDEX], -0.2, 0.5);
        bound(&mut next.shared[EXPONENT_INDEX], 0.2, 2.0);
        bound(&mut next.shared[THICKNESS_INDEX], given - 1.5, given + 1.5);
        bound(&mut next.shared[POISSON_INDEX], 0.0, 0.4995);
        bound(&mut next.shared[SCALE_INDEX], 0.05, 20.0);
        for (tactel, change) in next.tactels.iter_mut().zip(tactels) {
            (tactel[0], tactel[1]) =
                ((tactel[0] + change[0]).clamp(0.05, 5.0), tactel[1] + change[1]);
        }
        Some(next)
    }
}

fn parameters_at(pad: &Pad, youngs_mpa: f64) -> Parameters {
    let (log_e, log_t) = (libm::log(youngs_mpa), libm::log(pad.thickness_mm));
    let shared = [log_e, 1e-4, 1.0, log_t, pad.poisson, 1.0];
    Parameters { shared, tactels: vec![[1.0, 0.0]; pad.array.tactels()] }
}

/// The best of several initial values after a few steps on some of the images.
fn initial_parameters(
    presses: &[LoadedImage],
    pad: &Pad,
    told: &mut dyn FnMut(),
) -> Result<Parameters, String> {
    let stride = presses.len().div_ceil(INITIAL_IMAGES_MAX);
    let few: Vec<&LoadedImage> = presses.iter().step_by(stride).collect();
    let free = [true, true, true, false, false, true];
    let mut best: Option<(f64, Parameters)> = None;
    for youngs_mpa in INITIAL_MODULI_MPA {
        let mut search = Search::from(few.clone(), pad, free, parameters_at(pad, youngs_mpa))?;
        search.descend(6, told)?;
        if best.as_ref().is_none_or(|(cost, _)| search.here.squares < *cost) {
            best = Some((search.here.squares, search.parameters));
        }
    }
    best.map(|(_, parameters)| parameters).ok_or_else(|| "no beginning was found".to_owned())
}

/// Leaves out the readings that may be clipped, by the reading or by the model's value. A selection
/// by the reading alone would remove only the high ones of those near the bound and bias the rest.
fn without_clipped(
    presses: &[LoadedImage],
    pad: &Pad,
    by: Option<&Search<'_>>,
) -> (Vec<LoadedImage>, usize) {
    let (mut kept, bound) = (presses.to_vec(), CLIPPING_RATIO * pad.rail_counts);
    let mut out = 0;
    let mut drop = |count: &mut f64| {
        *count = f64::NAN;
        out += 1;
    };
    match by {
        None => kept
            .iter_mut()
            .flat_map(|press| &mut press.counts)
            .filter(|count| **count > bound)
            .for_each(&mut drop),
        Some(search) => {
            let all: Vec<&LoadedImage> = presses.iter().collect();
            for_each_reading(&all, pad, (&search.parameters, &search.layers), |image, seen| {
                if seen.value > bound {
                    drop(&mut kept[image].counts[seen.tactel]);
                }
            });
        }
    }
    (kept, out)
}

/// Fits the model of a pad to its images; `told` is called after each step of the search.
///
/// # Errors
/// Too few images, clipped images, or images that do not determine the parameters.
pub fn fit(
    presses: &[LoadedImage],
    pad: &Pad,
    also: ExtraUnknowns,
    told: &mut dyn FnMut(),
) -> Result<Fit, String> {
    if presses.len() < IMAGES_MIN {
        return Err(format!(
            "{} images under a load, {IMAGES_MIN} are needed; roll the pin for longer",
            presses.len()
        ));
    }
    let stride = presses.len().div_ceil(IMAGES_MAX);
    let presses: Vec<LoadedImage> = presses.iter().step_by(stride).cloned().collect();
    let (kept, mut clipped) = without_clipped(&presses, pad, None);
    let pressed = presses.iter().flat_map(|press| &press.counts);
    let pressed = pressed.filter(|count| **count > PRESSED_RATIO_MIN * pad.rail_counts).count();
    if clipped as f64 > CLIPPED_SHARE_MAX * pressed as f64 {
        return Err(format!(
            "{clipped} of {pressed} pressed readings are at the converter's end, {:.0} counts \
             above rest; press less, or give tactile.full_scale_n its true value",
            pad.rail_counts
        ));
    }
    let free = [true, true, true, also.thickness, also.poisson, true];
    let begin = initial_parameters(&kept, pad, told)?;
    let mut search = Search::from(kept.iter().collect(), pad, free, begin)?;
    search.solve(told)?;
    if clipped == 0 {
        return estimate(&search, 0);
    }
    let again;
    (again, clipped) = without_clipped(&presses, pad, Some(&search));
    let parameters = search.parameters.clone();
    let mut search = Search::from(again.iter().collect(), pad, free, parameters)?;
    search.solve(told)?;
    estimate(&search, clipped)
}

/// The coefficients by which each tactel's own equations are eliminated from the shared ones.
fn elimination_coefficients(here: &Equations) -> Vec<[SharedVector; 2]> {
    let one = |own: &super::equations::TactelEquations| {
        let alone = inverse2(&own.square);
        [0, 1].map(|a: usize| {
            core::array::from_fn(|c| (0..2).map(|b| alone[a][b] * own.cross[b][c]).sum())
        })
    };
    here.own.iter().map(one).collect()
}

/// Covariance of the shared parameters from the sums of the residuals over segments of the log.
fn segment_covariance(search: &Search<'_>, inverse: &SharedMatrix) -> SharedMatrix {
    let through = elimination_coefficients(&search.here);
    let mut middle = [[0.0; SHARED_COUNT]; SHARED_COUNT];
    let stretch = search.presses.len().div_ceil(SEGMENT_COUNT).max(1);
    for part in search.presses.chunks(stretch) {
        let mut score = [0.0; SHARED_COUNT];
        for_each_reading(part, search.pad, (&search.parameters, &search.layers), |_, seen| {
            let [gain, offset] = &through[seen.tactel];
            for (c, score) in score.iter_mut().enumerate() {
                *score += seen.residual * (seen.slopes[c] - seen.gain_slope * gain[c] - offset[c]);
            }
        });
        for c in 0..SHARED_COUNT {
            for d in 0..SHARED_COUNT {
                middle[c][d] += score[c] * score[d];
            }
        }
    }
    let product = |c: usize, d: usize| {
        let pairs = (0..SHARED_COUNT).flat_map(|e| (0..SHARED_COUNT).map(move |f| (e, f)));
        pairs.map(|(e, f)| inverse[c][e] * middle[e][f] * inverse[f][d]).sum::<f64>()
    };
    // A few segments underestimate the variance; this is the usual correction.
    let n = search.presses.len().div_ceil(stretch) as f64;
    let more = n / (n - 1.0).max(1.0);
    core::array::from_fn(|c| core::array::from_fn(|d| more * product(c, d)))
}

/// The optimum with its uncertainty.
fn estimate(search: &Search<'_>, clipped: usize) -> Result<Fit, String> {
    let Search { pad, parameters, here, priors, free, .. } = search;
    let (shared, noise) = (&parameters.shared, priors.noise);
    // One evaluation with all slopes shows what the images determine of the given parameters.
    let layers = Layers::of(pad, shared, &[true; SHARED_COUNT])?;
    let whole = Equations::of(&search.presses, pad, (parameters, &layers), priors);
    let identifiability = Identifiability::from_information(&whole.reduced(0.0).0, noise, free);
    let inverse = inverse(&here.reduced(0.0).0, free).ok_or_else(|| identifiability.refusal())?;
    let stretches = segment_covariance(search, &inverse);
    let deviation = |c: usize| {
        let alone = noise * inverse[c][c].max(0.0).sqrt();
        alone.max(stretches[c][c].max(0.0).sqrt())
    };
    let unsure = |c: usize| !deviation(c).is_finite() || deviation(c) > DEVIATION_MAX[c];
    if (0..SHARED_COUNT).any(|c| free[c] && unsure(c))
        || shared.iter().any(|value| !value.is_finite())
    {
        return Err(identifiability.refusal());
    }
    let (through, scale) = (elimination_coefficients(here), shared[SCALE_INDEX]);
    let gain = |(tactel, [own, _]): (usize, &[f64; 2])| {
        // The uncertainty of the shared parameters adds to that of the gain.
        let mut mine: SharedVector = core::array::from_fn(|c| -scale * through[tactel][0][c]);
        mine[SCALE_INDEX] += own;
        let pairs = (0..SHARED_COUNT).flat_map(|c| (0..SHARED_COUNT).map(move |d| (c, d)));
        let common: f64 = pairs.map(|(c, d)| mine[c] * inverse[c][d] * mine[d]).sum();
        let alone = inverse2(&here.own[tactel].square)[0][0];
        let deviation = noise * (scale * scale * alone + common).max(0.0).sqrt();
        let doubt = noise * alone.max(0.0).sqrt() / priors.gains;
        let known = doubt * doubt <= GAIN_VARIANCE_SHARE_MAX && (scale * own).is_finite();
        known.then_some(Estimate { value: scale * own, deviation })
    };
    let scaled =
        |c: usize, scale: f64, value: f64| Estimate { value, deviation: scale * deviation(c) };
    let (modulus, thickness) =
        (libm::exp(shared[MODULUS_INDEX]), libm::exp(shared[THICKNESS_INDEX]));
    let full = pad.full_scale_n;
    Ok(Fit {
        images: search.presses.len(),
        readings: here.readings,
        clipped,
        youngs_mpa: scaled(MODULUS_INDEX, modulus, modulus),
        threshold_n: scaled(THRESHOLD_INDEX, full, full * shared[THRESHOLD_INDEX]),
        exponent: scaled(EXPONENT_INDEX, 1.0, shared[EXPONENT_INDEX]),
        thickness_mm: free[THICKNESS_INDEX].then(|| scaled(THICKNESS_INDEX, thickness, thickness)),
        poisson: free[POISSON_INDEX].then(|| scaled(POISSON_INDEX, 1.0, shared[POISSON_INDEX])),
        noise_counts: noise,
        scale: scaled(SCALE_INDEX, 1.0, scale),
        gain_spread: priors.gains,
        gains: parameters.tactels.iter().enumerate().map(gain).collect(),
        identifiability,
    })
}
