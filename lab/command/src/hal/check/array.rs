//! What was seen of a tactile array: rate and age of its frames, how many are missing, and of each
//! tactel rest level, noise and whether it answers at all.

use taktil_hal::{Nanos, TactileFrame};
use taktil_lab_plot::heat::ImagePanel;

use super::spread::Spread;

/// Looks that are further apart than this share of the interval of frames may see two at once.
const LOOK_SHARE_MAX: f64 = 0.8;

/// What is wrong with a tactel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TactelState {
    /// It answers.
    Good,
    /// The device never vouched for it.
    Invalid,
    /// It stood at 0 or at full scale in every frame.
    AtAnEnd,
    /// It stood still while most others did not.
    Still,
}

/// What was seen of an array.
#[derive(Clone, Debug)]
pub(super) struct ArrayRecord {
    pub(super) rows: usize,
    pub(super) cols: usize,
    full_scale: u16,
    tactels: Vec<Spread>,
    valid: Vec<u64>,
    /// Times between two frames that follow each other (s).
    pub(super) intervals: Spread,
    pub(super) frames: u64,
    /// Frames that the device numbered and that were never there.
    pub(super) missing: u64,
    /// Frames that this program came too late for.
    pub(super) overtaken: u64,
    last: Option<(u32, Nanos)>,
    /// The release before the newest one.
    looked: Option<Nanos>,
    /// The longest time between two looks since the newest frame.
    longest_pause: Nanos,
}

impl ArrayRecord {
    pub(super) fn new(rows: usize, cols: usize, full_scale: u16) -> ArrayRecord {
        ArrayRecord {
            rows,
            cols,
            full_scale,
            tactels: vec![Spread::default(); rows * cols],
            valid: vec![0; rows * cols],
            intervals: Spread::default(),
            frames: 0,
            missing: 0,
            overtaken: 0,
            last: None,
            looked: None,
            longest_pause: Nanos::ZERO,
        }
    }

    pub(super) fn has_frame(&self) -> bool {
        self.last.is_some()
    }

    /// Notes that the array was asked at a release.
    pub(super) fn looked(&mut self, release: Nanos) {
        if let Some(before) = self.looked {
            self.longest_pause = self.longest_pause.max(release - before);
        }
        self.looked = Some(release);
    }

    /// Takes a new frame.
    pub(super) fn add(&mut self, frame: &TactileFrame, release: Nanos, records: bool) {
        let before = self.last.replace((frame.sequence, frame.acquired));
        self.looked(release);
        let pause = core::mem::take(&mut self.longest_pause);
        if !records {
            return;
        }
        self.frames += 1;
        if let Some((sequence, acquired)) = before {
            let steps = frame.sequence.wrapping_sub(sequence);
            let span_s = (frame.acquired - acquired).as_secs_f64();
            if steps == 1 {
                self.intervals.add(span_s);
            } else {
                let lost = u64::from(steps.saturating_sub(1));
                // A frame that came while nobody looked may have been there.
                let interval = if self.intervals.count > 0 { self.intervals.mean } else { span_s };
                if pause.as_secs_f64() > LOOK_SHARE_MAX * interval {
                    self.overtaken += lost;
                } else {
                    self.missing += lost;
                }
            }
        }
        for ((spread, known), (value, valid)) in
            self.tactels.iter_mut().zip(&mut self.valid).zip(frame.values.iter().zip(&frame.valid))
        {
            spread.add(f64::from(*value));
            *known += u64::from(*valid);
        }
    }

    /// The share of frames that were missing, of those that could have been seen.
    pub(super) fn missing_share(&self) -> f64 {
        let all = self.frames + self.missing;
        if all == 0 { 1.0 } else { self.missing as f64 / all as f64 }
    }

    /// Frames a second.
    pub(super) fn rate_hz(&self) -> f64 {
        if self.intervals.mean > 0.0 { 1.0 / self.intervals.mean } else { 0.0 }
    }

    pub(super) fn states(&self) -> Vec<TactelState> {
        let moving = self.tactels.iter().filter(|spread| spread.high > spread.low).count();
        let most_move = 2 * moving > self.tactels.len();
        let state = |(spread, valid): (&Spread, &u64)| {
            let still = spread.high <= spread.low;
            let at_end = spread.high <= 0.0 || spread.low >= f64::from(self.full_scale);
            match (*valid > 0, still) {
                (false, _) => TactelState::Invalid,
                (true, true) if at_end => TactelState::AtAnEnd,
                (true, true) if most_move => TactelState::Still,
                _ => TactelState::Good,
            }
        };
        self.tactels.iter().zip(&self.valid).map(state).collect()
    }

    /// Numbers of tactels that do not answer, with row and column from 1.
    pub(super) fn dead(&self) -> Vec<String> {
        let states = self.states();
        let dead = states.iter().enumerate().filter(|(_, state)| **state != TactelState::Good);
        dead.map(|(at, state)| {
            let why = match state {
                TactelState::Invalid => "not valid",
                TactelState::AtAnEnd => "at an end of its range",
                _ => "stands still",
            };
            format!("row {} column {}: {why}", at / self.cols + 1, at % self.cols + 1)
        })
        .collect()
    }

    /// Whether no tactel has changed at all.
    pub(super) fn is_still(&self) -> bool {
        self.tactels.iter().all(|spread| spread.high <= spread.low)
    }

    /// Mean of the tactels' standard deviations (counts).
    pub(super) fn noise_counts(&self) -> f64 {
        let sum: f64 = self.tactels.iter().map(Spread::deviation).sum();
        sum / self.tactels.len().max(1) as f64
    }

    /// Rest level, or noise, of each tactel; those that do not answer are grey.
    pub(super) fn panel(&self, title: &str, value: fn(&Spread) -> f64) -> ImagePanel {
        ImagePanel {
            title: title.to_owned(),
            rows: self.rows,
            cols: self.cols,
            counts: self.tactels.iter().map(value).collect(),
            valid: self.states().iter().map(|state| *state == TactelState::Good).collect(),
            axis: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(sequence: u32, ms: i64, values: [u16; 4]) -> TactileFrame {
        let mut frame = TactileFrame::new(2, 2);
        frame.sequence = sequence;
        frame.acquired = Nanos::from_millis(ms);
        frame.values.copy_from_slice(&values);
        frame.valid.fill(true);
        frame.valid[3] = false;
        frame
    }

    #[test]
    fn tactels_that_stand_still_at_an_end_or_are_not_vouched_for_do_not_answer() {
        let mut record = ArrayRecord::new(2, 2, 4_095);
        for n in 0..10 {
            let n16 = u16::try_from(n).unwrap();
            let values = [300 + n16 % 3, 4_095, 300 + n16, 0];
            record.add(&frame(n, 10 * i64::from(n), values), Nanos::from_millis(10), true);
        }
        let dead = record.dead();
        assert_eq!(dead, ["row 1 column 2: at an end of its range", "row 2 column 2: not valid"]);
        assert!(!record.is_still());
        assert!((record.rate_hz() - 100.0).abs() < 1e-6);
    }

    #[test]
    fn a_tactel_that_stands_still_is_dead_only_beside_others_that_move() {
        let mut record = ArrayRecord::new(2, 2, 255);
        for n in 0..5 {
            record.add(&frame(n, 0, [18, 18, 18, 18]), Nanos::ZERO, true);
        }
        assert!(record.is_still());
        assert_eq!(record.dead().len(), 1);
    }

    #[test]
    fn a_gap_is_a_missing_frame_only_where_somebody_looked() {
        let mut record = ArrayRecord::new(2, 2, 255);
        let mut show = |sequence: u32, ms: i64, looks_ms: &[i64]| {
            for look in looks_ms {
                record.looked(Nanos::from_millis(*look));
            }
            record.add(&frame(sequence, ms, [1; 4]), Nanos::from_millis(ms), true);
            (record.missing, record.overtaken)
        };
        assert_eq!(show(1, 10, &[0, 5]), (0, 0));
        assert_eq!(show(2, 20, &[15]), (0, 0));
        assert_eq!(show(4, 40, &[25, 30, 35]), (1, 0));
        assert_eq!(show(7, 70, &[45]), (1, 2));
        assert_eq!(show(u32::MAX, 80, &[75]).0, 1 + u64::from(u32::MAX - 8));
    }
}
