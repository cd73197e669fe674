//! From forces to counts: the tactile array's image, the gauges' codes, the echo of the motor
//! currents. First version: linear tactels, white noise, ideal gauges. Refuses to clip at zero: the
//! rest level lies five standard deviations above it.

use taktil_hal::{AXES, AdcCode, CHANNELS, MAX_TACTELS};
use taktil_mechanics::Joints;

use crate::contact::{PITCH_M, Patch, SLICES, tactel_middle_m};
use crate::devices::ADC_MAX;
use crate::prng::Prng;
use crate::scene::TactileConfig;

/// Gauge codes per newton.
pub const GAUGE_CODES_PER_N: f64 = 20.0;
/// Gauge codes per newton metre.
pub const GAUGE_CODES_PER_NM: f64 = 1000.0;
/// Base loads below this part of a row's load are not looked for (the field dies exponentially).
const REACH_M: f64 = 12e-3;

/// Normal force on each tactel at the rubber's base (N), row by row: each row's load, spread as the
/// layer spreads it and integrated over the tactels' squares, and what its tangential load presses
/// and lifts when the rubber knows it. `across` is the cosine between the sensor's x and the
/// rolling direction.
pub(crate) fn base_forces(pad: &Patch, across: f64) -> [f64; MAX_TACTELS] {
    let mut forces = [0.0; MAX_TACTELS];
    let turned = across.abs();
    for (row, slice) in pad.slices.iter().enumerate() {
        if slice.load_n <= 0.0 {
            continue;
        }
        let share = |edge: usize| {
            let u_m = tactel_middle_m(edge) - 0.5 * PITCH_M - slice.strip.x_m;
            let u_m = (turned * u_m).clamp(-REACH_M, REACH_M);
            pad.rubber.base_share(slice.delta_m, u_m)
        };
        let mut left = share(0);
        for column in 0..SLICES {
            let right = share(column + 1);
            forces[row * SLICES + column] = slice.load_n * (right - left);
            left = right;
        }
    }
    add_drag(&mut forces, pad, across);
    forces
}

/// Adds what the rows' tangential loads press and lift at the base, when the rubber knows it.
pub(crate) fn add_drag(forces: &mut [f64; MAX_TACTELS], pad: &Patch, across: f64) {
    let Some(trace) = pad.rubber.trace() else { return };
    for (row, slice) in pad.slices.iter().enumerate() {
        if slice.load_n <= 0.0 {
            continue;
        }
        // The bristles' force on the rubber, along the rolling direction.
        let drag_n = slice.shear_n_m * slice.brush.0;
        let half_width_m = pad.rubber.at(slice.delta_m).half_width_m;
        let part = |edge: usize| {
            let u_m = tactel_middle_m(edge) - 0.5 * PITCH_M - slice.strip.x_m;
            trace.left_of(half_width_m, across * u_m)
        };
        let mut left = part(0);
        for column in 0..SLICES {
            let right = part(column + 1);
            // The rolling direction may run against the sensor's x.
            let signed = if across < 0.0 { left - right } else { right - left };
            forces[row * SLICES + column] += drag_n * signed;
            left = right;
        }
    }
}

/// The converter behind the tactels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Converter {
    counts_per_n: f64,
    rest: f64,
    noise: f64,
    full_scale: u16,
}

impl Converter {
    pub(crate) fn new(config: &TactileConfig) -> Converter {
        let full_scale = u16::try_from((1_u32 << config.bits) - 1).unwrap_or(u16::MAX);
        Converter {
            counts_per_n: f64::from(full_scale) / config.full_scale_n,
            rest: config.rest_counts,
            noise: config.noise_counts,
            full_scale,
        }
    }

    pub(crate) fn full_scale(&self) -> u16 {
        self.full_scale
    }

    /// One scan: every tactel draws its noise, loaded or not, so that the stream keeps step.
    pub(crate) fn scan(&self, forces: &[f64; MAX_TACTELS], prng: &mut Prng) -> [u16; MAX_TACTELS] {
        let mut values = [0; MAX_TACTELS];
        for (value, force) in values.iter_mut().zip(forces) {
            let noise = if self.noise > 0.0 { self.noise * prng.normal() } else { 0.0 };
            let counts = (self.rest + self.counts_per_n * force + noise).round();
            *value = counts.clamp(0.0, f64::from(self.full_scale)) as u16;
        }
        values
    }
}

/// Gauge codes of a wrench on the tool in tool axes (N, N m).
pub(crate) fn gauges(wrench: &Joints) -> [AdcCode; AXES] {
    core::array::from_fn(|i| {
        let scale = if i < 3 { GAUGE_CODES_PER_N } else { GAUGE_CODES_PER_NM };
        AdcCode(saturate(scale * wrench[i]))
    })
}

/// What the A/D reads of the motor currents.
pub(crate) fn currents(codes: &[i32; CHANNELS]) -> [AdcCode; CHANNELS] {
    codes.map(|code| AdcCode(code.clamp(-ADC_MAX - 1, ADC_MAX)))
}

fn saturate(x: f64) -> i32 {
    let max = f64::from(ADC_MAX);
    x.round().clamp(-max - 1.0, max) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prng::Stream;

    #[test]
    fn an_unloaded_array_reads_its_rest_level() {
        let config = TactileConfig { noise_counts: 0.0, ..TactileConfig::default() };
        let mut prng = Prng::new(1, Stream::TactileNoise);
        let scan = Converter::new(&config).scan(&[0.0; MAX_TACTELS], &mut prng);
        assert!(scan.iter().all(|v| *v == 300));
    }

    #[test]
    fn counts_follow_the_scale_and_saturate() {
        let config = TactileConfig { noise_counts: 0.0, ..TactileConfig::default() };
        let mut forces = [0.0; MAX_TACTELS];
        (forces[0], forces[1], forces[2]) = (2.0, 1e9, -1e9);
        let mut prng = Prng::new(1, Stream::TactileNoise);
        let scan = Converter::new(&config).scan(&forces, &mut prng);
        assert_eq!((scan[0], scan[1], scan[2]), (300 + 2048, 4095, 0));
    }

    #[test]
    fn gauges_saturate_and_survive_nonsense() {
        let wrench = Joints::new(1.0, -1.0, 1e9, 0.5, f64::NAN, -1e9);
        let codes = gauges(&wrench).map(|c| c.0);
        assert_eq!(codes, [20, -20, 2047, 500, 0, -2048]);
    }
}
