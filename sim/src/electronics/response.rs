//! The conductance of a tactel as a function of its force: gain, hysteresis, creep, threshold,
//! power law. Conductances are relative to the conductance at full scale. Each tactel responds
//! independently of its neighbours.
//!
//! Hysteresis is a play operator on the logarithm of the force (Brokate and Sprekels 1996, ch. 2):
//! a decreasing load reads `1 + h` times an increasing one, at any size of load. Creep is a chain
//! of Kelvin elements whose time constants are a decade apart, so that the reading under a constant
//! load grows by the same part in each tenfold of time.

use crate::hash::Hash;
use crate::prng::{Prng, Stream};
use crate::scene::{Electronics, TactileConfig};

/// Number of Kelvin elements.
const KELVIN_ELEMENT_COUNT: usize = 4;
/// Time constant of the fastest element (s); the others are 10, 100 and 1000 times as slow.
const TIME_CONSTANT_MIN_S: f64 = 0.5;
/// Smallest gain of a tactel, relative to the nominal gain.
const GAIN_MIN: f64 = 0.2;

/// The gain of each tactel of the finger's array, row by row, for a seed.
#[must_use]
pub fn tactel_gains(config: &TactileConfig, seed: u64) -> Vec<f64> {
    gains(config, Prng::new(seed, Stream::TactelGains))
}

fn gains(config: &TactileConfig, mut prng: Prng) -> Vec<f64> {
    let gain = |_| (1.0 + config.gain_spread * prng.normal()).max(GAIN_MIN);
    (0..config.geometry().tactels()).map(gain).collect()
}

/// The response of all tactels.
#[derive(Clone, Debug)]
pub(crate) struct TactelResponse {
    gains: Vec<f64>,
    threshold: f64,
    exponent: f64,
    memory: Option<ViscoelasticState>,
}

/// The hysteresis and creep of all tactels.
#[derive(Clone, Debug)]
struct ViscoelasticState {
    hysteresis: f64,
    creep: f64,
    /// Middle of the play; negative infinity for a tactel that was unloaded.
    play: Vec<f64>,
    elements: Vec<[f64; KELVIN_ELEMENT_COUNT]>,
}

impl TactelResponse {
    /// The response; none for an ideal array.
    pub(crate) fn new(config: &TactileConfig, seed: u64, stream: Stream) -> Option<TactelResponse> {
        if config.electronics < Electronics::Response {
            return None;
        }
        let tactels = config.geometry().tactels();
        let memory = (config.electronics >= Electronics::Memory).then(|| ViscoelasticState {
            hysteresis: config.hysteresis,
            creep: config.creep_per_decade,
            play: vec![f64::NEG_INFINITY; tactels],
            elements: vec![[0.0; KELVIN_ELEMENT_COUNT]; tactels],
        });
        Some(TactelResponse {
            gains: gains(config, Prng::new(seed, stream)),
            threshold: config.threshold_n / config.full_scale_n,
            exponent: config.exponent,
            memory,
        })
    }

    /// Conductance of one tactel under a load (both relative to full scale), `dt_s` after its
    /// latest reading.
    pub(crate) fn conductance(&mut self, tactel: usize, load: f64, dt_s: f64) -> f64 {
        let load = self.gains[tactel] * load.max(0.0);
        let effective_load = match &mut self.memory {
            Some(memory) => memory.apply(tactel, load, dt_s),
            None => load,
        };
        let above = effective_load - self.threshold;
        if above <= 0.0 {
            return 0.0;
        }
        libm::pow(above / (1.0 - self.threshold), self.exponent)
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        hash.numbers(&self.gains);
        if let Some(memory) = &self.memory {
            hash.numbers(&memory.play);
            for elements in &memory.elements {
                hash.numbers(elements);
            }
        }
    }
}

impl ViscoelasticState {
    fn apply(&mut self, tactel: usize, load: f64, dt_s: f64) -> f64 {
        let mut strain = load;
        let mut slow_s = TIME_CONSTANT_MIN_S;
        for element in &mut self.elements[tactel] {
            *element += (load - *element) * (1.0 - libm::exp(-dt_s / slow_s));
            strain += self.creep * *element;
            slow_s *= 10.0;
        }
        if load <= 0.0 {
            self.play[tactel] = f64::NEG_INFINITY;
            return strain;
        }
        let half = 0.5 * libm::log1p(self.hysteresis);
        let size = libm::log(strain);
        let play = self.play[tactel].clamp(size - half, size + half);
        self.play[tactel] = play;
        // An increasing load is the reference: it reads the same as without hysteresis.
        libm::exp(play + half)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn response(edit: impl FnOnce(&mut TactileConfig)) -> TactelResponse {
        let mut config = TactileConfig {
            electronics: Electronics::Memory,
            gain_spread: 0.0,
            threshold_n: 0.0,
            exponent: 1.0,
            hysteresis: 0.0,
            creep_per_decade: 0.0,
            ..TactileConfig::default()
        };
        edit(&mut config);
        TactelResponse::new(&config, 1, Stream::TactelGains).unwrap()
    }

    #[test]
    fn a_falling_load_reads_higher_by_the_stated_part() {
        let mut response = response(|c| c.hysteresis = 0.1);
        let up: Vec<f64> =
            (1..=10).map(|i| response.conductance(0, 0.1 * f64::from(i), 0.005)).collect();
        for i in (1..10).rev() {
            let load = 0.1 * f64::from(i);
            let down = response.conductance(0, load, 0.005);
            assert!((down - 1.1 * load).abs() < 1e-9, "{load}: {down}");
        }
        assert!((up[4] - 0.5).abs() < 1e-12);
        // Wholly unloaded it starts anew.
        response.conductance(0, 0.0, 0.005);
        assert!((response.conductance(0, 0.3, 0.005) - 0.3).abs() < 1e-12);
    }

    #[test]
    fn a_constant_load_creeps_by_the_stated_part_a_decade() {
        let mut response = response(|c| c.creep_per_decade = 0.05);
        let (mut t, mut seen) = (0.0, Vec::new());
        for decade in [1.0, 10.0, 100.0] {
            while t < decade {
                response.conductance(7, 0.5, 0.01);
                t += 0.01;
            }
            seen.push(response.conductance(7, 0.5, 0.0) / 0.5);
        }
        for pair in seen.windows(2) {
            let grown = pair[1] - pair[0];
            assert!((0.03..0.06).contains(&grown), "{grown} {seen:?}");
        }
    }

    #[test]
    fn below_the_threshold_is_nothing_and_full_scale_is_full_scale() {
        let mut response = response(|c| (c.threshold_n, c.exponent) = (0.2, 0.8));
        assert_eq!(response.conductance(0, 0.049, 0.005), 0.0);
        assert!(response.conductance(0, 0.06, 0.005) > 0.0);
        assert!((response.conductance(0, 1.0, 0.005) - 1.0).abs() < 1e-12);
        assert_eq!(response.conductance(0, f64::NAN, 0.005), 0.0);
    }

    #[test]
    fn gains_have_the_stated_spread_and_their_own_stream() {
        let mut response = response(|c| c.gain_spread = 0.06);
        let read: Vec<f64> = (0..256).map(|i| response.conductance(i, 0.5, 0.0)).collect();
        let mean = read.iter().sum::<f64>() / 256.0;
        let variance = read.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / 255.0;
        assert!((mean / 0.5 - 1.0).abs() < 0.02, "{mean}");
        assert!((variance.sqrt() / 0.5 - 0.06).abs() < 0.01, "{}", variance.sqrt());
    }
}
