//! `[tactile_servo.contact_loss]`: what the finger does when it loses contact.

use serde::Deserialize;
use taktil_rtcore::Invalid;

taktil_rtcore::explained! {
    /// `[tactile_servo.contact_loss]`: what is done when contact is lost.
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ContactLoss {
        /// The finger stands still for this time once contact is lost (ms). Default 20.
        pub hold_ms: f64,
        /// Then it seeks contact again, this far (mm). Default 5.
        pub search_mm: f64,
        /// When nothing is found there it draws back by so much (mm). Default 5.
        pub retract_mm: f64,
    }
}

impl Default for ContactLoss {
    fn default() -> ContactLoss {
        ContactLoss { hold_ms: 20.0, search_mm: 5.0, retract_mm: 5.0 }
    }
}

impl ContactLoss {
    /// # Errors
    /// A number outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        let rows = [
            ("hold_ms", self.hold_ms, 0.0, 10_000.0),
            ("search_mm", self.search_mm, 0.0, 100.0),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_numbers_are_refused_with_their_place() {
        assert_eq!(ContactLoss::default().check(), Ok(()));
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            let place = |lost: ContactLoss| lost.check().unwrap_err().place;
            assert_eq!(place(ContactLoss { hold_ms: bad, ..ContactLoss::default() }), "hold_ms");
            assert_eq!(
                place(ContactLoss { search_mm: bad, ..ContactLoss::default() }),
                "search_mm"
            );
            assert_eq!(
                place(ContactLoss { retract_mm: bad, ..ContactLoss::default() }),
                "retract_mm"
            );
        }
    }
}
