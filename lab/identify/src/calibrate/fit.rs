//! Least squares over all images at once: what the pad shares, gain and offset of each tactel, by
//! damped Gauss-Newton steps (Marquardt 1963). Standard deviations come from the same equations at
//! the optimum and from what the residuals leave; where the residuals of neighbouring images hang
//! together, from the sums over stretches of the log (Liang and Zeger 1986), whichever is larger.
//! Refuses to state what the images do not tell.
//!
//! Loads have to be known in newtons: a common factor on them would be one on all gains.

use super::equations::{
    Beliefs, EXPONENT, Equations, Layers, MODULUS, POISSON, Point, SCALE, SHARED, Shared, Square,
    THICKNESS, THRESHOLD, each, inverse, inverse2,
};
use super::press::{Pad, Press, TACTELS};
use super::told::{DOUBT_MAX, Told};

/// Fewest images that are fitted.
const IMAGES_MIN: usize = 50;
/// Most images: evenly chosen ones beyond it.
const IMAGES_MAX: usize = 1500;
/// Images on which a beginning is tried.
const IMAGES_TRIED: usize = 40;
/// Young's moduli that are tried as a beginning (MPa).
const BEGINNINGS_MPA: [f64; 7] = [0.1, 0.4, 1.5, 5.0, 20.0, 80.0, 300.0];
/// Steps at most.
const STEPS_MAX: usize = 60;
/// The search is over when an undamped step lowers the sum of squares by less than this part of one
/// reading's variance.
const STILL: f64 = 1e-3;
/// Damping that counts as none: the valley of stiffness, exponent and gains is 1e-6 as steep as its
/// walls.
const FREE: f64 = 1e-9;
/// Damping of the first step.
const DAMPED: f64 = 1e-3;
/// Damping at which the search gives up.
const STUCK: f64 = 1e8;
/// Stretches of the log whose residuals are taken for independent of each other's.
const STRETCHES: usize = 20;
/// Times that the spread of the gains is found anew.
const ROUNDS: usize = 6;
/// The spread to begin with, and its bounds.
const SPREAD: f64 = 0.1;
const SPREADS: (f64, f64) = (3e-3, 0.5);
/// A gain is stated when the images leave this part of the variance at most that the spread of all
/// gains has.
const GAIN_DOUBT_MAX: f64 = 0.5;
/// Readings above this part of the converter's range may be clipped and are left out.
const CLIPPED: f64 = 0.9;
/// Part of the pressed readings that may be clipped.
const CLIPPED_MAX: f64 = 0.2;
/// Counts above which a reading counts as pressed, in parts of the range.
const PRESSED: f64 = 0.05;

/// A number and its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// One standard deviation.
    pub deviation: f64,
}

/// What the images tell.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Images that were fitted.
    pub images: usize,
    /// Readings that were fitted.
    pub readings: usize,
    /// Readings that may have been clipped, left out.
    pub clipped: usize,
    /// Young's modulus of the rubber (MPa).
    pub youngs_mpa: Estimate,
    /// Force below which a tactel reads nothing (N).
    pub threshold_n: Estimate,
    /// Exponent of the response.
    pub exponent: Estimate,
    /// The layer's thickness (mm); none where it was given.
    pub thickness_mm: Option<Estimate>,
    /// Poisson's ratio; none where it was given.
    pub poisson: Option<Estimate>,
    /// Spread of a reading about the model (counts).
    pub noise_counts: f64,
    /// Factor that all tactels share.
    pub scale: Estimate,
    /// Spread of the tactels' own factors about it.
    pub gain_spread: f64,
    /// Factor of each tactel on its load, row by row; none where it was not pressed enough.
    pub gains: Vec<Option<Estimate>>,
    /// Which of the shared numbers these images tell apart.
    pub told: Told,
}

/// What is sought beside modulus, threshold and exponent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Also {
    /// The layer's thickness.
    pub thickness: bool,
    /// Its Poisson's ratio.
    pub poisson: bool,
}

/// A search under way.
struct Search<'a> {
    presses: Vec<&'a Press>,
    pad: &'a Pad,
    free: [bool; SHARED],
    point: Point,
    layers: Layers,
    here: Equations,
    beliefs: Beliefs,
    /// Damping of the next step.
    damping: f64,
}

/// Spread of a reading (counts): a number that is drawn towards what is believed of it takes only a
/// part of a reading.
fn spread(at: &Equations, free: &[bool; SHARED], beliefs: &Beliefs) -> f64 {
    let (gains, offsets) = (beliefs.noise / beliefs.gains, 1.0 / beliefs.offsets);
    let taken = |own: &super::equations::Own| {
        let left = inverse2(&own.square);
        2.0 - gains * gains * left[0][0] - offsets * offsets * left[1][1]
    };
    let sought =
        at.own.iter().map(taken).sum::<f64>() + free.iter().filter(|free| **free).count() as f64;
    (at.squares / (at.readings as f64 - sought).max(1.0)).sqrt().max(1e-3)
}

impl<'a> Search<'a> {
    fn from(
        presses: Vec<&'a Press>,
        pad: &'a Pad,
        free: [bool; SHARED],
        point: Point,
    ) -> Result<Search<'a>, String> {
        let layers = Layers::of(pad, &point.shared, &free)?;
        let offsets = 1.0 / pad.baseline_frames.sqrt();
        let mut beliefs = Beliefs { noise: 1.0, gains: SPREAD, offsets };
        let mut here = Equations::of(&presses, pad, (&point, &layers), &beliefs);
        beliefs.noise = spread(&here, &free, &beliefs);
        here.weigh(&point.tactels, &beliefs);
        Ok(Search { presses, pad, free, point, layers, here, beliefs, damping: DAMPED })
    }

    /// Descends, finds the spread of the gains that the tactels show, and again (MacKay 1992).
    fn settle(&mut self) -> Result<(), String> {
        for _ in 0..ROUNDS {
            self.descend(STEPS_MAX)?;
            let before = self.beliefs.gains;
            let (mut squares, mut told) = (0.0, 0.0);
            for (own, tactel) in self.here.own.iter().zip(&self.point.tactels) {
                let left = self.beliefs.noise / before;
                told += 1.0 - left * left * inverse2(&own.square)[0][0];
                squares += (tactel[0] - 1.0) * (tactel[0] - 1.0);
            }
            let next = (squares / told.max(1e-3)).sqrt().clamp(SPREADS.0, SPREADS.1);
            self.beliefs.gains = next;
            self.here.weigh(&self.point.tactels, &self.beliefs);
            if (next / before - 1.0).abs() < 0.02 {
                break;
            }
        }
        self.descend(STEPS_MAX)
    }

    /// Steps until it stands still.
    fn descend(&mut self, steps: usize) -> Result<(), String> {
        // Once it stood still it does not begin anew from far away.
        self.damping = self.damping.min(DAMPED);
        for _ in 0..steps {
            let damping = self.damping;
            let Some(next) = self.stepped(damping) else { break };
            // What the layers are solved for; all else scales what they say.
            let moved = self.free[THICKNESS] || self.free[POISSON];
            let anew =
                if moved { Some(Layers::of(self.pad, &next.shared, &self.free)?) } else { None };
            let layers = anew.as_ref().unwrap_or(&self.layers);
            let at = (&next, layers);
            let there = Equations::of(&self.presses, self.pad, at, &self.beliefs);
            if there.cost < self.here.cost {
                // A damped step may be short for its damping: only free ones end the search.
                let gained = self.here.cost - there.cost;
                let noise = self.beliefs.noise;
                let done = gained < STILL * noise * noise && damping < FREE;
                self.beliefs.noise = spread(&there, &self.free, &self.beliefs);
                (self.point, self.here, self.damping) = (next, there, 0.1 * damping);
                // The next comparison is under what is believed from here on, on both its sides.
                self.here.weigh(&self.point.tactels, &self.beliefs);
                if let Some(layers) = anew {
                    self.layers = layers;
                }
                if done {
                    break;
                }
            } else {
                self.damping *= 10.0;
                if self.damping > STUCK {
                    break;
                }
            }
        }
        Ok(())
    }

    /// The point after a step, inside the bounds of the physics.
    fn stepped(&self, damping: f64) -> Option<Point> {
        let (shared, tactels) = self.here.step(&self.free, damping)?;
        let mut next = self.point.clone();
        for (value, change) in next.shared.iter_mut().zip(shared) {
            *value += change;
        }
        let bound = |value: &mut f64, low: f64, high: f64| *value = value.clamp(low, high);
        let given = libm::log(self.pad.thickness_mm);
        bound(&mut next.shared[MODULUS], -4.0, 7.0);
        bound(&mut next.shared[THRESHOLD], -0.2, 0.5);
        bound(&mut next.shared[EXPONENT], 0.2, 2.0);
        bound(&mut next.shared[THICKNESS], given - 1.5, given + 1.5);
        bound(&mut next.shared[POISSON], 0.0, 0.4995);
        bound(&mut next.shared[SCALE], 0.05, 20.0);
        for (tactel, change) in next.tactels.iter_mut().zip(tactels) {
            (tactel[0], tactel[1]) =
                ((tactel[0] + change[0]).clamp(0.05, 5.0), tactel[1] + change[1]);
        }
        Some(next)
    }
}

fn beginning(pad: &Pad, youngs_mpa: f64) -> Point {
    let (log_e, log_t) = (libm::log(youngs_mpa), libm::log(pad.thickness_mm));
    let shared = [log_e, 1e-4, 1.0, log_t, pad.poisson, 1.0];
    Point { shared, tactels: vec![[1.0, 0.0]; TACTELS] }
}

/// The best of some beginnings after a few steps on some of the images.
fn begun(presses: &[Press], pad: &Pad) -> Result<Point, String> {
    let stride = presses.len().div_ceil(IMAGES_TRIED);
    let few: Vec<&Press> = presses.iter().step_by(stride).collect();
    let free = [true, true, true, false, false, true];
    let mut best: Option<(f64, Point)> = None;
    for youngs_mpa in BEGINNINGS_MPA {
        let mut search = Search::from(few.clone(), pad, free, beginning(pad, youngs_mpa))?;
        search.descend(6)?;
        if best.as_ref().is_none_or(|(cost, _)| search.here.squares < *cost) {
            best = Some((search.here.squares, search.point));
        }
    }
    best.map(|(_, point)| point).ok_or_else(|| "no beginning was found".to_owned())
}

/// Leaves out the readings that may be clipped, by what they read or by what the model says: chosen
/// by themselves the high ones of those near the bound would be missing.
fn unclipped(presses: &[Press], pad: &Pad, by: Option<&Search<'_>>) -> (Vec<Press>, usize) {
    let (mut kept, bound) = (presses.to_vec(), CLIPPED * pad.rail_counts);
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
            let all: Vec<&Press> = presses.iter().collect();
            each(&all, pad, (&search.point, &search.layers), |image, seen| {
                if seen.value > bound {
                    drop(&mut kept[image].counts[seen.tactel]);
                }
            });
        }
    }
    (kept, out)
}

/// Fits a pad to its presses.
///
/// # Errors
/// Too few images, images that were clipped or do not tell the parameters apart.
pub fn fit(presses: &[Press], pad: &Pad, also: Also) -> Result<Fit, String> {
    if presses.len() < IMAGES_MIN {
        return Err(format!(
            "{} images under a load, {IMAGES_MIN} are needed; roll the pin for longer",
            presses.len()
        ));
    }
    let stride = presses.len().div_ceil(IMAGES_MAX);
    let presses: Vec<Press> = presses.iter().step_by(stride).cloned().collect();
    let (kept, mut clipped) = unclipped(&presses, pad, None);
    let pressed = presses.iter().flat_map(|press| &press.counts);
    let pressed = pressed.filter(|count| **count > PRESSED * pad.rail_counts).count();
    if clipped as f64 > CLIPPED_MAX * pressed as f64 {
        return Err(format!(
            "{clipped} of {pressed} pressed readings are at the converter's end, {:.0} counts \
             above rest; press less, or give tactile.full_scale_n its true value",
            pad.rail_counts
        ));
    }
    let free = [true, true, true, also.thickness, also.poisson, true];
    let begin = begun(&kept, pad)?;
    let mut search = Search::from(kept.iter().collect(), pad, free, begin)?;
    search.settle()?;
    if clipped == 0 {
        return state(&search, 0);
    }
    let again;
    (again, clipped) = unclipped(&presses, pad, Some(&search));
    let point = search.point.clone();
    let mut search = Search::from(again.iter().collect(), pad, free, point)?;
    search.settle()?;
    state(&search, clipped)
}

/// What the tactels' own equations take out of the shared ones, per tactel.
fn through(here: &Equations) -> Vec<[Shared; 2]> {
    let one = |own: &super::equations::Own| {
        let alone = inverse2(&own.square);
        [0, 1].map(|a: usize| {
            core::array::from_fn(|c| (0..2).map(|b| alone[a][b] * own.cross[b][c]).sum())
        })
    };
    here.own.iter().map(one).collect()
}

/// Covariance of the shared numbers by the sums of what is left over stretches of the log.
fn by_stretches(search: &Search<'_>, inverse: &Square) -> Square {
    let through = through(&search.here);
    let mut middle = [[0.0; SHARED]; SHARED];
    let stretch = search.presses.len().div_ceil(STRETCHES).max(1);
    for part in search.presses.chunks(stretch) {
        let mut score = [0.0; SHARED];
        each(part, search.pad, (&search.point, &search.layers), |_, seen| {
            let [gain, offset] = &through[seen.tactel];
            for (c, score) in score.iter_mut().enumerate() {
                *score += seen.left * (seen.by[c] - seen.by_gain * gain[c] - offset[c]);
            }
        });
        for c in 0..SHARED {
            for d in 0..SHARED {
                middle[c][d] += score[c] * score[d];
            }
        }
    }
    let product = |c: usize, d: usize| {
        let pairs = (0..SHARED).flat_map(|e| (0..SHARED).map(move |f| (e, f)));
        pairs.map(|(e, f)| inverse[c][e] * middle[e][f] * inverse[f][d]).sum::<f64>()
    };
    // Few stretches know their own spread badly: the usual correction.
    let n = search.presses.len().div_ceil(stretch) as f64;
    let more = n / (n - 1.0).max(1.0);
    core::array::from_fn(|c| core::array::from_fn(|d| more * product(c, d)))
}

/// The optimum with its uncertainty.
fn state(search: &Search<'_>, clipped: usize) -> Result<Fit, String> {
    let Search { pad, point, here, beliefs, free, .. } = search;
    let (shared, noise) = (&point.shared, beliefs.noise);
    // Once with all slopes, so that it can be said what the images would tell of what was given.
    let layers = Layers::of(pad, shared, &[true; SHARED])?;
    let whole = Equations::of(&search.presses, pad, (point, &layers), beliefs);
    let told = Told::of(&whole.reduced(0.0).0, noise, free);
    let inverse = inverse(&here.reduced(0.0).0, free).ok_or_else(|| told.refusal())?;
    let stretches = by_stretches(search, &inverse);
    let deviation = |c: usize| {
        let alone = noise * inverse[c][c].max(0.0).sqrt();
        alone.max(stretches[c][c].max(0.0).sqrt())
    };
    let unsure = |c: usize| !deviation(c).is_finite() || deviation(c) > DOUBT_MAX[c];
    if (0..SHARED).any(|c| free[c] && unsure(c)) || shared.iter().any(|value| !value.is_finite()) {
        return Err(told.refusal());
    }
    let (through, scale) = (through(here), shared[SCALE]);
    let gain = |(tactel, [own, _]): (usize, &[f64; 2])| {
        // What is not known of the shared numbers is not known of the gain either.
        let mut mine: Shared = core::array::from_fn(|c| -scale * through[tactel][0][c]);
        mine[SCALE] += own;
        let pairs = (0..SHARED).flat_map(|c| (0..SHARED).map(move |d| (c, d)));
        let common: f64 = pairs.map(|(c, d)| mine[c] * inverse[c][d] * mine[d]).sum();
        let alone = inverse2(&here.own[tactel].square)[0][0];
        let deviation = noise * (scale * scale * alone + common).max(0.0).sqrt();
        let doubt = noise * alone.max(0.0).sqrt() / beliefs.gains;
        let known = doubt * doubt <= GAIN_DOUBT_MAX && (scale * own).is_finite();
        known.then_some(Estimate { value: scale * own, deviation })
    };
    let scaled =
        |c: usize, scale: f64, value: f64| Estimate { value, deviation: scale * deviation(c) };
    let (modulus, thickness) = (libm::exp(shared[MODULUS]), libm::exp(shared[THICKNESS]));
    let full = pad.full_scale_n;
    Ok(Fit {
        images: search.presses.len(),
        readings: here.readings,
        clipped,
        youngs_mpa: scaled(MODULUS, modulus, modulus),
        threshold_n: scaled(THRESHOLD, full, full * shared[THRESHOLD]),
        exponent: scaled(EXPONENT, 1.0, shared[EXPONENT]),
        thickness_mm: free[THICKNESS].then(|| scaled(THICKNESS, thickness, thickness)),
        poisson: free[POISSON].then(|| scaled(POISSON, 1.0, shared[POISSON])),
        noise_counts: noise,
        scale: scaled(SCALE, 1.0, scale),
        gain_spread: beliefs.gains,
        gains: point.tactels.iter().enumerate().map(gain).collect(),
        told,
    })
}
