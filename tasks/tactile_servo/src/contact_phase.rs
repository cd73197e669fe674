//! The state machine of contact: the finger seeks, follows the law while it is in contact, holds
//! still when contact is lost, seeks again a short way, and retracts when nothing is there. Every
//! search ends after a bounded way and a bounded time.
//!
//! ```text
//! SEEK --gained--> TOUCH --lost--> HOLD --gained--> TOUCH
//!   |                               | after hold_ms
//!   | seek_max_mm                   v
//!   v                             AGAIN --gained--> TOUCH
//! REST <--drawn back-- RETRACT <----| search_mm
//! ```

use taktil_rtcore::{Fold, StateHash};
use taktil_signal::{Contact, contact};

use crate::config::Config;
use crate::perception::TouchFeatures;

/// A motion is given up after this many times the time that it takes at its speed: the finger may
/// be held up by something that the array does not see.
const TRAVEL_TIME_FACTOR: f64 = 3.0;
/// Time that is added to it for the start of the motion (s).
const TRAVEL_TIME_MARGIN_S: f64 = 0.1;

/// The phase of the contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum State {
    /// Nothing has been touched since the state TACTILE-SERVO was entered.
    #[default]
    Seek,
    InContact,
    /// The finger stands still because contact was lost.
    Hold,
    /// Seeking after a loss.
    SeekAgain,
    Retract,
    Rest,
}

/// The state machine, which is advanced once a job.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactPhase {
    state: State,
    /// Time in the state (s) and way along z in it (mm).
    time_s: f64,
    way_mm: f64,
    gained: u32,
    lost: u32,
}

impl Fold for ContactPhase {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&(self.state as u32)).add(&self.time_s).add(&self.way_mm);
        hash.add(&self.gained).add(&self.lost);
    }
}

impl ContactPhase {
    /// Advances by one job of `dt_s` with the newest features; returns the event of this job, if
    /// there was one.
    pub fn advance(&mut self, config: &Config, seen: &TouchFeatures, dt_s: f64) -> Option<Contact> {
        if !seen.trusted {
            return None;
        }
        self.time_s += dt_s;
        let loss = &config.contact_loss;
        let is_travelled = |way_mm: f64, most_mm: f64| {
            way_mm >= most_mm
                || self.time_s
                    > TRAVEL_TIME_FACTOR * most_mm / config.seek_mm_s + TRAVEL_TIME_MARGIN_S
        };
        let (next, kind) = match (self.state, seen.contact) {
            (State::InContact, true) => return None,
            (_, true) => (State::InContact, contact::GAINED),
            (State::InContact, false) => (State::Hold, contact::LOST),
            (State::Seek, false) if is_travelled(self.way_mm, config.seek_max_mm) => {
                (State::Rest, contact::GIVEN_UP)
            }
            (State::Hold, false) if self.time_s >= 1e-3 * loss.hold_ms => {
                (State::SeekAgain, contact::SOUGHT)
            }
            (State::SeekAgain, false) if is_travelled(self.way_mm, loss.search_mm) => {
                (State::Retract, contact::RETRACTED)
            }
            (State::Retract, false) if is_travelled(-self.way_mm, loss.retract_mm) => {
                (State::Rest, contact::GIVEN_UP)
            }
            _ => return None,
        };
        self.gained += u32::from(kind == contact::GAINED);
        self.lost += u32::from(kind == contact::LOST);
        (self.state, self.time_s, self.way_mm) = (next, 0.0, 0.0);
        let ContactPhase { gained, lost, .. } = *self;
        Some(Contact { kind, gained, lost, m0: seen.m0, ..taktil_rtcore::Payload::ZERO })
    }

    /// The law drives.
    #[must_use]
    pub fn is_touching(&self) -> bool {
        self.state == State::InContact
    }

    /// Speed along the sensor's z while the law does not drive (mm/s).
    #[must_use]
    pub fn speed_mm_s(&self, config: &Config) -> f64 {
        match self.state {
            State::Seek | State::SeekAgain => config.seek_mm_s,
            State::Retract => -config.seek_mm_s,
            State::InContact | State::Hold | State::Rest => 0.0,
        }
    }

    /// Adds a displacement along z that was made in the present state (mm).
    pub fn add_travel(&mut self, z_mm: f64) {
        self.way_mm += z_mm;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features_with(contact: bool) -> TouchFeatures {
        TouchFeatures { trusted: true, contact, ..TouchFeatures::default() }
    }

    /// Number of jobs of 2.5 ms, at most 1000, until an event; every motion is taken as carried
    /// out.
    fn until(
        phase: &mut ContactPhase,
        config: &Config,
        touch: &TouchFeatures,
    ) -> Option<(u32, u32)> {
        for job in 1..=1000 {
            if let Some(event) = phase.advance(config, touch, 0.0025) {
                return Some((event.kind, job));
            }
            phase.add_travel(phase.speed_mm_s(config) * 0.0025);
        }
        None
    }

    #[test]
    fn a_loss_is_held_sought_again_and_drawn_back_from() {
        let config = Config::default();
        let mut phase = ContactPhase::default();
        assert_eq!(phase.speed_mm_s(&config), 6.0);
        assert_eq!(until(&mut phase, &config, &features_with(true)), Some((contact::GAINED, 1)));
        assert!(phase.is_touching());
        assert_eq!(until(&mut phase, &config, &features_with(true)), None);
        assert_eq!(until(&mut phase, &config, &features_with(false)), Some((contact::LOST, 1)));
        assert_eq!((phase.is_touching(), phase.speed_mm_s(&config)), (false, 0.0));
        let (kind, jobs) = until(&mut phase, &config, &features_with(false)).unwrap();
        assert!(kind == contact::SOUGHT && (8..=9).contains(&jobs), "20 ms: {jobs}");
        // 5 mm at 6 mm/s are 334 jobs.
        let (kind, jobs) = until(&mut phase, &config, &features_with(false)).unwrap();
        assert!(kind == contact::RETRACTED && (334..=336).contains(&jobs), "{jobs}");
        assert_eq!(phase.speed_mm_s(&config), -6.0);
        let (kind, jobs) = until(&mut phase, &config, &features_with(false)).unwrap();
        assert!(kind == contact::GIVEN_UP && (334..=336).contains(&jobs), "{jobs}");
        assert_eq!(phase.speed_mm_s(&config), 0.0);
        assert_eq!(until(&mut phase, &config, &features_with(true)), Some((contact::GAINED, 1)));
        assert_eq!((phase.gained, phase.lost), (2, 1));
    }

    #[test]
    fn a_blocked_finger_stops() {
        let config = Config::default();
        let mut phase = ContactPhase::default();
        let s = TRAVEL_TIME_FACTOR * config.seek_max_mm / config.seek_mm_s + TRAVEL_TIME_MARGIN_S;
        assert_eq!(phase.advance(&config, &features_with(false), s), None);
        let event = phase.advance(&config, &features_with(false), 0.0025).unwrap();
        assert_eq!((event.kind, phase.speed_mm_s(&config)), (contact::GIVEN_UP, 0.0));
        let mut phase = ContactPhase::default();
        let mut kinds = Vec::new();
        for contact in [true, false, false, false, false] {
            kinds.extend(
                phase.advance(&config, &features_with(contact), 10.0).map(|event| event.kind),
            );
        }
        let due = [contact::GAINED, contact::LOST, contact::SOUGHT, contact::RETRACTED];
        assert_eq!(kinds, [&due[..], &[contact::GIVEN_UP]].concat());
    }

    #[test]
    fn contact_that_comes_back_while_it_is_held_for_is_followed_at_once() {
        let config = Config::default();
        let mut phase = ContactPhase::default();
        phase.advance(&config, &features_with(true), 0.0025);
        phase.advance(&config, &features_with(false), 0.0025);
        assert_eq!(phase.advance(&config, &TouchFeatures::default(), 1.0), None, "not believed");
        assert!(
            phase.advance(&config, &features_with(true), 0.0025).is_some() && phase.is_touching()
        );
    }
}
