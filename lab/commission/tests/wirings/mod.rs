//! Robots whose wiring is drawn, for tests that find it out.

use std::path::Path;

use taktil_lab_scene::scene::Scene;
use taktil_machine::joints::JointsConfig;

/// A deterministic draw (SplitMix64, Steele, Lea and Flood 2014).
pub(crate) struct Draw(u64);

impl Draw {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn permutation(&mut self) -> Vec<f64> {
        let mut all: Vec<f64> = (0..6).map(f64::from).collect();
        for i in (1..all.len()).rev() {
            all.swap(i, (self.next() % (i as u64 + 1)) as usize);
        }
        all
    }

    fn signs(&mut self) -> Vec<f64> {
        (0..6).map(|_| if self.next().is_multiple_of(2) { 1.0 } else { -1.0 }).collect()
    }
}

/// The scene of a first power-up.
pub(crate) fn scene() -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/commission.toml");
    Scene::load(&path).unwrap_or_else(|bad| panic!("{bad}"))
}

/// A wiring of its joints, drawn from the number of the case.
pub(crate) fn drawn(case: u64) -> JointsConfig {
    let mut draw = Draw(case);
    let gears = [46.72, 69.9733, 42.9867, 43.5111, 39.3846, 31.7692];
    let constants = [0.055, 0.055, 0.055, 0.030, 0.030, 0.030];
    JointsConfig {
        encoder_channel: Some(draw.permutation()),
        motor_channel: Some(draw.permutation()),
        encoder_sign: Some(draw.signs()),
        motor_sign: Some(draw.signs()),
        counts_per_rev: Some((0..6).map(|_| 4.0 * draw.between(100.0, 512.0).round()).collect()),
        gear: Some(gears.iter().map(|gear| gear * draw.between(0.8, 1.5)).collect()),
        torque_constant_nm_a: Some(constants.iter().map(|k| k * draw.between(0.7, 1.6)).collect()),
        ..JointsConfig::default()
    }
}

/// The first `count` cases, or those that the environment names: one number, or `FIRST..END`.
pub(crate) fn cases(count: u64) -> std::ops::Range<u64> {
    let Ok(named) = std::env::var("TAKTIL_COMMISSION_CASE") else { return 0..count };
    let number = |text: &str| text.parse::<u64>().expect("a number, or FIRST..END");
    match named.split_once("..") {
        Some((first, end)) => number(first)..number(end),
        None => number(&named)..number(&named) + 1,
    }
}
