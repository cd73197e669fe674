//! The tactile array under its rubber: from forces to counts, row by row, through as much
//! electronics as the scene names. Noise is not clipped at zero, because the rest level is five
//! standard deviations above it.
//!
//! The effects follow each other in this order: force on a tactel's square -> gain, hysteresis,
//! creep, threshold, power law -> network of rows and columns -> noise on the rest level ->
//! converter with saturation -> defects.

use taktil_hal::Nanos;

use super::network::Network;
use super::response::TactelResponse;
use crate::geometry::ArrayGeometry;
use crate::hash::Hash;
use crate::prng::{Prng, Stream};
use crate::scene::section::inside;
use crate::scene::{Defect, DefectKind, Electronics, Invalid, TactileConfig, Timing, invalid};

/// The fingertip that carries an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fingertip {
    /// The fingertip that the arm moves.
    Finger,
    /// The fingertip on the table's mount.
    Opposed,
    /// A finger of a hand, from 0.
    OfHand(usize),
}

impl Fingertip {
    /// The streams of random numbers for its noise and its gains, and its section of the scene.
    fn streams_and_section(self) -> (Stream, Stream, &'static str) {
        match self {
            Fingertip::Finger => (Stream::TactileNoise, Stream::TactelGains, "tactile"),
            Fingertip::Opposed => (Stream::OpposedNoise, Stream::OpposedGains, "opposed.tactile"),
            Fingertip::OfHand(0) => (Stream::TactileNoise, Stream::TactelGains, "tactile"),
            Fingertip::OfHand(1) => (Stream::OpposedNoise, Stream::OpposedGains, "tactile"),
            Fingertip::OfHand(_) => (Stream::ThirdNoise, Stream::ThirdGains, "tactile"),
        }
    }
}

/// The array and the scan in progress.
#[derive(Clone, Debug)]
pub(crate) struct TactileSensor {
    geometry: ArrayGeometry,
    counts_full: f64,
    per_newton: f64,
    rest: f64,
    noise: f64,
    full_scale: u16,
    response: Option<TactelResponse>,
    network: Option<Network>,
    defects: Vec<Defect>,
    prng: Prng,
    row: Nanos,
    period: Nanos,
    complete_at: Nanos,
    next_row: usize,
    /// Readings of the tactels relative to full scale, as of the latest reading of their rows.
    conductances: Box<[f64]>,
    values: Box<[u16]>,
    /// Normal force on each tactel (N), which whoever reads the array writes before.
    pub(crate) forces_n: Box<[f64]>,
    /// Room for one row: what the converter sees of it, and its noise.
    seen: Box<[f64]>,
    noises: Box<[f64]>,
}

impl TactileSensor {
    /// The array of a checked description.
    ///
    /// # Errors
    /// The rows together take longer than a scan.
    pub(crate) fn new(
        config: &TactileConfig,
        timing: &Timing,
        seed: u64,
        tip: Fingertip,
    ) -> Result<TactileSensor, Invalid> {
        let (noise, gains, place) = tip.streams_and_section();
        let row = Nanos((1e3 * config.row_us).round() as i64);
        let geometry = config.geometry();
        if row * geometry.rows as i64 > timing.scan_period {
            let what = format!("is {}: {} rows do not fit a scan", config.row_us, geometry.rows);
            let most = timing.scan_period.0 as f64 / (1e3 * geometry.rows as f64);
            let remedy = format!("give at most {most:.1}, or scan less often");
            return Err(invalid(&inside(place, "row_us"), what, &remedy));
        }
        let full_scale = config.full_counts();
        let network = (config.electronics >= Electronics::Network)
            .then(|| Network::new(&geometry, config.full_scale_ohm, config.driver_ohm))
            .flatten();
        let tactels = geometry.tactels();
        Ok(TactileSensor {
            geometry,
            counts_full: f64::from(full_scale),
            per_newton: 1.0 / config.full_scale_n,
            rest: config.rest_counts,
            noise: config.noise_counts,
            full_scale,
            response: TactelResponse::new(config, seed, gains),
            network,
            defects: config.defect.clone(),
            prng: Prng::new(seed, noise),
            row,
            period: timing.scan_period,
            complete_at: Nanos::ZERO,
            next_row: 0,
            conductances: vec![0.0; tactels].into(),
            values: vec![0; tactels].into(),
            forces_n: vec![0.0; tactels].into(),
            seen: vec![0.0; geometry.cols].into(),
            noises: vec![0.0; geometry.cols].into(),
        })
    }

    /// The instant at which rows are read next. The first scan, at the very start, is read all at
    /// once.
    pub(crate) fn next(&self) -> Nanos {
        if self.complete_at == Nanos::ZERO {
            return Nanos::ZERO;
        }
        self.complete_at - self.row * (self.geometry.rows - 1 - self.next_row) as i64
    }

    /// Reads the rows that are due, each tactel under its force (N). Returns the whole scan when
    /// its last row was among them.
    pub(crate) fn read(&mut self, now: Nanos) -> Option<&[u16]> {
        let at_once = self.row == Nanos::ZERO || self.complete_at == Nanos::ZERO;
        let rows = self.geometry.rows;
        let end = if at_once { rows } else { self.next_row + 1 };
        self.convert(self.next_row..end, now);
        self.next_row = end % rows;
        if end < rows {
            return None;
        }
        self.complete_at += self.period;
        Some(&self.values)
    }

    /// Converts the forces on the given rows. Every tactel draws its noise, loaded or not, so that
    /// the stream of random numbers does not depend on the load.
    fn convert(&mut self, rows: core::ops::Range<usize>, now: Nanos) {
        let (dt_s, cols) = (self.period.as_secs_f64(), self.geometry.cols);
        let tactels = rows.start * cols..rows.end * cols;
        for tactel in tactels {
            let load = self.per_newton * self.forces_n[tactel];
            self.conductances[tactel] = match &mut self.response {
                Some(response) => response.conductance(tactel, load, dt_s),
                None => load,
            };
        }
        if let Some(network) = &mut self.network {
            network.factorise(&self.conductances);
        }
        for row in rows {
            let tactels = row * cols..(row + 1) * cols;
            let seen = match &self.network {
                Some(network) => {
                    network.read(&self.conductances, row, &mut self.seen);
                    &self.seen
                }
                None => &self.conductances[tactels.clone()],
            };
            if self.noise > 0.0 {
                for noise in &mut self.noises {
                    *noise = self.noise * self.prng.normal();
                }
            }
            let most = f64::from(self.full_scale);
            let values = &mut self.values[tactels];
            for (value, (part, noise)) in values.iter_mut().zip(seen.iter().zip(&self.noises)) {
                let counts = self.rest + self.counts_full * part + noise;
                *value = round_to_u16(counts.clamp(0.0, most));
            }
            self.apply_defects(row, now);
        }
    }

    /// Overwrites the readings of defective tactels.
    fn apply_defects(&mut self, row: usize, now: Nanos) {
        let t_s = now.as_secs_f64();
        for defect in &self.defects {
            let here = defect.row.is_none_or(|r| r as usize == row);
            if !here || t_s < defect.from_s {
                continue;
            }
            let counts = match defect.kind {
                DefectKind::Dead => self.rest.round() as u16,
                DefectKind::Stuck => defect.counts.min(u32::from(u16::MAX)) as u16,
                DefectKind::Blinking => {
                    let phase = (t_s - defect.from_s) / defect.period_s;
                    if phase - phase.floor() < 0.5 {
                        continue;
                    }
                    defect.counts.min(u32::from(u16::MAX)) as u16
                }
            };
            let cols = self.geometry.cols;
            let columns = defect.column.map_or(0..cols, |c| c as usize..c as usize + 1);
            self.values[row * cols..][columns].fill(counts);
        }
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        self.prng.digest(hash);
        if self.row > Nanos::ZERO {
            hash.word(self.next_row as u64);
            self.values.iter().for_each(|value| hash.word(u64::from(*value)));
        }
        if let Some(response) = &self.response {
            response.digest(hash);
        }
    }
}

/// The integer nearest to a number between 0 and 65 535; 0 for NaN. Numbers above 2^52 are
/// integers: the sum carries the rounded number in its lowest bits.
#[inline(always)]
fn round_to_u16(x: f64) -> u16 {
    const INTEGER_OFFSET: f64 = (1_u64 << 52) as f64;
    (x + INTEGER_OFFSET).to_bits() as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_to_the_nearest_whole_one() {
        for whole in [0_u16, 1, 2, 299, 300, 4095, 32_768, 65_535] {
            let x = f64::from(whole);
            for off in [-0.49, -1e-6, 0.0, 1e-6, 0.49] {
                assert_eq!(round_to_u16((x + off).max(0.0)), whole, "{x} {off}");
            }
        }
        assert_eq!(round_to_u16(f64::NAN), 0);
    }

    fn array(edit: impl FnOnce(&mut TactileConfig)) -> TactileSensor {
        let mut config = TactileConfig { noise_counts: 0.0, ..TactileConfig::default() };
        edit(&mut config);
        TactileSensor::new(&config, &Timing::default(), 1, Fingertip::Finger).unwrap()
    }

    fn scan(array: &mut TactileSensor, forces: &[f64]) -> Box<[u16]> {
        array.forces_n.copy_from_slice(forces);
        array.convert(0..array.geometry.rows, Nanos::from_secs(1));
        array.values.clone()
    }

    #[test]
    fn an_unloaded_array_reads_its_rest_level() {
        for electronics in [Electronics::Ideal, Electronics::Memory, Electronics::Network] {
            let mut array = array(|c| c.electronics = electronics);
            assert!(scan(&mut array, &[0.0; 256]).iter().all(|v| *v == 300));
        }
    }

    #[test]
    fn counts_follow_the_scale_and_saturate() {
        let mut forces = [0.0; 256];
        (forces[0], forces[1], forces[2]) = (2.0, 1e9, -1e9);
        let seen = scan(&mut array(|_| ()), &forces);
        assert_eq!((seen[0], seen[1], seen[2]), (300 + 2048, 4095, 0));
        for (bits, full) in [(8, 255), (10, 1023)] {
            let seen = scan(&mut array(|c| (c.bits, c.rest_counts) = (bits, 20.0)), &forces);
            assert_eq!((seen[1], seen[3]), (full, 20), "{bits} bits");
        }
    }

    #[test]
    fn defective_tactels_read_their_defects() {
        let defect = |kind, row, column, counts| Defect {
            kind,
            row,
            column,
            counts,
            period_s: 0.1,
            from_s: 0.0,
        };
        let mut array = array(|c| {
            c.defect = vec![
                defect(DefectKind::Dead, Some(3), None, 0),
                defect(DefectKind::Stuck, Some(5), Some(6), 4000),
                defect(DefectKind::Blinking, None, Some(15), 7),
            ];
        });
        array.forces_n.fill(1.0);
        array.convert(0..16, Nanos::from_millis(30));
        let (pressed, seen) = (array.values[0], array.values.clone());
        assert!((3 * 16..4 * 16 - 1).all(|i| seen[i] == 300));
        assert_eq!((seen[5 * 16 + 6], seen[5 * 16 + 5]), (4000, pressed));
        assert_eq!(seen[15], pressed);
        array.convert(0..16, Nanos::from_millis(70));
        assert!((0..16).all(|row| array.values[row * 16 + 15] == 7));
    }

    #[test]
    fn arrays_of_any_size_read_every_tactel_through_every_electronics() {
        for (rows, cols) in [(1, 1), (1, 64), (64, 1), (12, 32), (64, 64)] {
            for electronics in [Electronics::Ideal, Electronics::Memory, Electronics::Network] {
                let mut array = array(|c| {
                    (c.rows, c.cols, c.electronics) = (rows, cols, electronics);
                    (c.gain_spread, c.driver_ohm) = (0.0, 0.01);
                });
                let mut forces = vec![0.0; (rows * cols) as usize];
                *forces.last_mut().unwrap() = 2.0;
                let seen = scan(&mut array, &forces);
                let (last, others) = seen.split_last().unwrap();
                assert!(*last > 300 + 1900, "{rows} x {cols} {electronics:?}: {last}");
                assert!(others.iter().all(|value| (300..304).contains(value)), "{rows} x {cols}");
            }
        }
    }

    #[test]
    fn rows_are_read_in_turn_and_the_scan_is_complete_at_its_instant() {
        let mut array = array(|c| c.row_us = 100.0);
        assert!(array.read(Nanos::ZERO).is_some());
        let mut instants = Vec::new();
        let whole = loop {
            let now = array.next();
            instants.push(now.0);
            if array.read(now).is_some() {
                break now;
            }
        };
        assert_eq!(whole, Nanos::from_millis(5));
        assert_eq!(instants.len(), 16);
        assert!(instants.windows(2).all(|pair| pair[1] - pair[0] == 100_000));
        let long = TactileConfig { row_us: 313.0, ..TactileConfig::default() };
        for (tip, place) in
            [(Fingertip::Finger, "tactile.row_us"), (Fingertip::Opposed, "opposed.tactile.row_us")]
        {
            let bad = TactileSensor::new(&long, &Timing::default(), 1, tip).unwrap_err();
            assert!(bad.place == place && bad.remedy.contains("312.5"), "{bad}");
        }
    }
}
