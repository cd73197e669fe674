//! Determines which of the shared parameters the images identify separately, and which only in
//! combination. It uses the information of all readings on all parameters at once, whether these
//! were sought or given. These numbers are not the errors of the fit, which takes given parameters
//! as exact.

use super::equations::{
    MODULUS_INDEX, POISSON_INDEX, SHARED_COUNT, SharedMatrix, SharedVector, THICKNESS_INDEX,
    inverse,
};

/// Names of the shared parameters, and the unit of their standard deviations in texts.
pub const NAMES: [(&str, &str); SHARED_COUNT] = [
    ("modulus", "%"),
    ("threshold", "% of full scale"),
    ("exponent", ""),
    ("thickness", "%"),
    ("Poisson's ratio", ""),
    ("scale of gains", "%"),
];

/// Largest standard deviation of an identified parameter: relative for modulus, thickness and
/// scale, as a fraction of full scale for the threshold, absolute for exponent and Poisson's ratio.
pub const DEVIATION_MAX: SharedVector = [0.25, 0.1, 0.15, 0.25, 0.05, 0.25];
/// Correlation from which two parameters count as not separable.
const CORRELATION_MIN: f64 = 0.95;

/// Uncertainties that follow from the images alone.
#[derive(Clone, Debug)]
pub struct Identifiability {
    /// Standard deviations with the given parameters taken as exact; those of given parameters are
    /// 0.
    pub given: SharedVector,
    /// Standard deviations if the thickness was sought as well.
    pub with_thickness: Option<SharedVector>,
    /// Standard deviations if all parameters were sought; `None` where they cannot be.
    pub all: Option<SharedVector>,
    /// Correlations if all parameters were sought.
    pub correlation: Option<SharedMatrix>,
    /// Change of the modulus in percent when the given thickness is one percent too large, and when
    /// the given Poisson's ratio is 0.01 too large; `None` for a parameter that was sought.
    pub shift_percent: [Option<f64>; 2],
}

impl Identifiability {
    /// Evaluates the information on the shared parameters (the equations with the tactels
    /// eliminated) and the standard deviation of a reading (counts).
    pub(super) fn from_information(
        square: &SharedMatrix,
        noise: f64,
        free: &[bool; SHARED_COUNT],
    ) -> Identifiability {
        let deviations = |free: &[bool; SHARED_COUNT]| {
            let inverse = inverse(square, free)?;
            Some(core::array::from_fn(|c| noise * inverse[c][c].max(0.0).sqrt()))
        };
        let mut with = *free;
        with[THICKNESS_INDEX] = true;
        let all = inverse(square, &[true; SHARED_COUNT]);
        let correlation = all.map(|all| {
            let one = |c: usize, d: usize| all[c][d] / (all[c][c] * all[d][d]).sqrt();
            core::array::from_fn(|c| core::array::from_fn(|d| one(c, d)))
        });
        let held = inverse(square, free);
        let shift = |given: usize, step: f64| {
            let held = held.as_ref().filter(|_| !free[given])?;
            let per: f64 =
                (0..SHARED_COUNT).map(|c| held[MODULUS_INDEX][c] * square[c][given]).sum();
            Some(-100.0 * per * step)
        };
        Identifiability {
            given: deviations(free).unwrap_or([f64::INFINITY; SHARED_COUNT]),
            with_thickness: deviations(&with),
            all: deviations(&[true; SHARED_COUNT]),
            correlation,
            shift_percent: [shift(THICKNESS_INDEX, 0.01), shift(POISSON_INDEX, 0.01)],
        }
    }

    /// Pairs of strongly correlated parameters, with their correlations, when all are sought.
    #[must_use]
    pub fn correlated_pairs(&self) -> Vec<(usize, usize, f64)> {
        let Some(correlation) = &self.correlation else { return Vec::new() };
        let pairs = (0..SHARED_COUNT).flat_map(|c| (c + 1..SHARED_COUNT).map(move |d| (c, d)));
        let pairs = pairs.map(|(c, d)| (c, d, correlation[c][d]));
        pairs.filter(|(_, _, r)| r.abs() >= CORRELATION_MIN).collect()
    }

    /// Names of the parameters that the images do not identify by themselves.
    #[must_use]
    pub fn unidentifiable(&self) -> Vec<&'static str> {
        let all = self.all.unwrap_or([f64::INFINITY; SHARED_COUNT]);
        let unsure = |c: &usize| !all[*c].is_finite() || all[*c] > DEVIATION_MAX[*c];
        (0..SHARED_COUNT).filter(unsure).map(|c| NAMES[c].0).collect()
    }

    /// A standard deviation as text for people.
    #[must_use]
    pub fn deviation_text(c: usize, deviation: f64) -> String {
        match NAMES[c].1 {
            "" => format!("{deviation:.4}"),
            _ => format!("{:.2} %", 100.0 * deviation),
        }
    }

    /// The reason why the fit is not stated.
    pub(super) fn refusal(&self) -> String {
        let sought = |(c, deviation): (usize, &f64)| {
            (*deviation > 0.0).then(|| {
                format!("{} +- {}", NAMES[c].0, Identifiability::deviation_text(c, *deviation))
            })
        };
        let all: Vec<String> = self.given.iter().enumerate().filter_map(sought).collect();
        let pairs: Vec<String> = self
            .correlated_pairs()
            .iter()
            .map(|(c, d, r)| format!("{} and {} ({r:.3})", NAMES[*c].0, NAMES[*d].0))
            .collect();
        let pairs = if pairs.is_empty() {
            String::new()
        } else {
            format!("; they hang together: {}", pairs.join(", "))
        };
        format!(
            "these images do not tell stiffness and response apart: {}{pairs}; roll the pin over \
             the whole pad under several loads, or give what was sought with --also",
            all.join(", ")
        )
    }
}
