//! What the finger does about contact: it seeks, follows the law while it touches, holds still when
//! contact is lost, seeks again a short way, and draws back when nothing is there. Refuses to seek
//! without end.
//!
//! ```text
//! SEEK --gained--> TOUCH --lost--> HOLD --gained--> TOUCH
//!   |                               | after hold_ms
//!   | seek_max_mm                   v
//!   v                             AGAIN --gained--> TOUCH
//! REST <--drawn back-- RETRACT <----| again_mm
//! ```

use serde::Deserialize;
use taktil_rtcore::{Fold, Invalid, StateHash};
use taktil_signal::{Contact, contact};

use crate::config::Config;
use crate::perception::Touch;

/// A way is given up after so many times the time that it takes, and a moment to set out: what
/// holds the finger up may be something that the array does not see.
const PATIENCE: f64 = 3.0;
const WAIT_S: f64 = 0.1;

taktil_rtcore::explained! {
    /// `[tactile_servo.lost]`: what is done when contact is lost.
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Lost {
        /// The finger stands still for this time once contact is lost (ms). Default 20.
        pub hold_ms: f64,
        /// Then it seeks contact again, this far (mm). Default 5.
        pub again_mm: f64,
        /// When nothing is found there it draws back by so much (mm). Default 5.
        pub retract_mm: f64,
    }
}

impl Default for Lost {
    fn default() -> Lost {
        Lost { hold_ms: 20.0, again_mm: 5.0, retract_mm: 5.0 }
    }
}

impl Lost {
    /// # Errors
    /// A number outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        let rows = [
            ("hold_ms", self.hold_ms, 0.0, 10_000.0),
            ("again_mm", self.again_mm, 0.0, 100.0),
            ("retract_mm", self.retract_mm, 0.0, 100.0),
        ];
        for (place, value, low, high) in rows {
            if !(low <= value && value <= high) {
                let remedy = format!("give {low} to {high}");
                return Err(Invalid::new(place, format!("is {value}"), remedy));
            }
        }
        Ok(())
    }
}

/// Where the finger is with its contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum State {
    /// Nothing was touched in this stay.
    #[default]
    Seek,
    Touch,
    /// Still, since contact was lost.
    Hold,
    /// Seeking after a loss.
    Again,
    Retract,
    Rest,
}

/// The machine of states, by job.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Phase {
    state: State,
    /// Time in the state (s) and way along z in it (mm).
    time_s: f64,
    way_mm: f64,
    gained: u32,
    lost: u32,
}

impl Fold for Phase {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&(self.state as u32)).add(&self.time_s).add(&self.way_mm);
        hash.add(&self.gained).add(&self.lost);
    }
}

impl Phase {
    /// One job of `dt_s` further, with what was seen last; what happened, if anything did.
    pub fn advance(&mut self, config: &Config, seen: &Touch, dt_s: f64) -> Option<Contact> {
        if !seen.trusted {
            return None;
        }
        self.time_s += dt_s;
        let lost = &config.lost;
        let past = |way_mm: f64, most_mm: f64| {
            way_mm >= most_mm || self.time_s > PATIENCE * most_mm / config.seek_mm_s + WAIT_S
        };
        let (next, kind) = match (self.state, seen.contact) {
            (State::Touch, true) => return None,
            (_, true) => (State::Touch, contact::GAINED),
            (State::Touch, false) => (State::Hold, contact::LOST),
            (State::Seek, false) if past(self.way_mm, config.seek_max_mm) => {
                (State::Rest, contact::GIVEN_UP)
            }
            (State::Hold, false) if self.time_s >= 1e-3 * lost.hold_ms => {
                (State::Again, contact::SOUGHT)
            }
            (State::Again, false) if past(self.way_mm, lost.again_mm) => {
                (State::Retract, contact::RETRACTED)
            }
            (State::Retract, false) if past(-self.way_mm, lost.retract_mm) => {
                (State::Rest, contact::GIVEN_UP)
            }
            _ => return None,
        };
        self.gained += u32::from(kind == contact::GAINED);
        self.lost += u32::from(kind == contact::LOST);
        (self.state, self.time_s, self.way_mm) = (next, 0.0, 0.0);
        let Phase { gained, lost, .. } = *self;
        Some(Contact { kind, gained, lost, m0: seen.m0, ..taktil_rtcore::Payload::ZERO })
    }

    /// The law drives.
    #[must_use]
    pub fn touches(&self) -> bool {
        self.state == State::Touch
    }

    /// Speed along the sensor's z while the law does not drive (mm/s).
    #[must_use]
    pub fn speed_mm_s(&self, config: &Config) -> f64 {
        match self.state {
            State::Seek | State::Again => config.seek_mm_s,
            State::Retract => -config.seek_mm_s,
            State::Touch | State::Hold | State::Rest => 0.0,
        }
    }

    /// Way along z that was made in the state (mm).
    pub fn went(&mut self, z_mm: f64) {
        self.way_mm += z_mm;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(contact: bool) -> Touch {
        Touch { trusted: true, contact, ..Touch::default() }
    }

    /// Jobs of 2.5 ms until something happens, at most 1000; the way made is taken as carried out.
    fn until(phase: &mut Phase, config: &Config, touch: &Touch) -> Option<(u32, u32)> {
        for job in 1..=1000 {
            if let Some(event) = phase.advance(config, touch, 0.0025) {
                return Some((event.kind, job));
            }
            phase.went(phase.speed_mm_s(config) * 0.0025);
        }
        None
    }

    #[test]
    fn a_loss_is_held_sought_again_and_drawn_back_from() {
        let config = Config::default();
        let mut phase = Phase::default();
        assert_eq!(phase.speed_mm_s(&config), 6.0);
        assert_eq!(until(&mut phase, &config, &seen(true)), Some((contact::GAINED, 1)));
        assert!(phase.touches());
        assert_eq!(until(&mut phase, &config, &seen(true)), None);
        assert_eq!(until(&mut phase, &config, &seen(false)), Some((contact::LOST, 1)));
        assert_eq!((phase.touches(), phase.speed_mm_s(&config)), (false, 0.0));
        let (kind, jobs) = until(&mut phase, &config, &seen(false)).unwrap();
        assert!(kind == contact::SOUGHT && (8..=9).contains(&jobs), "20 ms: {jobs}");
        // 5 mm at 6 mm/s are 334 jobs.
        let (kind, jobs) = until(&mut phase, &config, &seen(false)).unwrap();
        assert!(kind == contact::RETRACTED && (334..=336).contains(&jobs), "{jobs}");
        assert_eq!(phase.speed_mm_s(&config), -6.0);
        let (kind, jobs) = until(&mut phase, &config, &seen(false)).unwrap();
        assert!(kind == contact::GIVEN_UP && (334..=336).contains(&jobs), "{jobs}");
        assert_eq!(phase.speed_mm_s(&config), 0.0);
        assert_eq!(until(&mut phase, &config, &seen(true)), Some((contact::GAINED, 1)));
        assert_eq!((phase.gained, phase.lost), (2, 1));
    }

    #[test]
    fn a_finger_that_is_held_up_gives_up() {
        let config = Config::default();
        let mut phase = Phase::default();
        let s = PATIENCE * config.seek_max_mm / config.seek_mm_s + WAIT_S;
        assert_eq!(phase.advance(&config, &seen(false), s), None);
        let event = phase.advance(&config, &seen(false), 0.0025).unwrap();
        assert_eq!((event.kind, phase.speed_mm_s(&config)), (contact::GIVEN_UP, 0.0));
        let mut phase = Phase::default();
        let mut kinds = Vec::new();
        for contact in [true, false, false, false, false] {
            kinds.extend(phase.advance(&config, &seen(contact), 10.0).map(|event| event.kind));
        }
        let due = [contact::GAINED, contact::LOST, contact::SOUGHT, contact::RETRACTED];
        assert_eq!(kinds, [&due[..], &[contact::GIVEN_UP]].concat());
    }

    #[test]
    fn contact_that_comes_back_while_it_is_held_for_is_followed_at_once() {
        let config = Config::default();
        let mut phase = Phase::default();
        phase.advance(&config, &seen(true), 0.0025);
        phase.advance(&config, &seen(false), 0.0025);
        assert_eq!(phase.advance(&config, &Touch::default(), 1.0), None, "not believed");
        assert!(phase.advance(&config, &seen(true), 0.0025).is_some() && phase.touches());
    }

    #[test]
    fn bad_numbers_are_refused_with_their_place() {
        assert_eq!(Lost::default().check(), Ok(()));
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            let place = |lost: Lost| lost.check().unwrap_err().place;
            assert_eq!(place(Lost { hold_ms: bad, ..Lost::default() }), "hold_ms");
            assert_eq!(place(Lost { again_mm: bad, ..Lost::default() }), "again_mm");
            assert_eq!(place(Lost { retract_mm: bad, ..Lost::default() }), "retract_mm");
        }
    }
}
