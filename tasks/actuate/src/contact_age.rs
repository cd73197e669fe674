//! For how long the fingertip's contact has lasted as one: until it is lost, or its load jumps to
//! another place of the pad. A finger that rocks on a long thing touches it with one end of the pad
//! and then with the other, and swings on the rubber there as at a first touch.

/// For so many readings a contact that has ended may still show in the motion of a motor that it
/// has pushed: half of the longest window in which a motor that runs away is looked for.
const PUSHED_READINGS: u32 = 4;
/// The load has jumped when it is so far from where it was in the last images (m): a quarter of the
/// pad.
const JUMP_MIN_M: f64 = 6e-3;
/// Time constant by which that place is smoothed (s): four images.
const PLACE_FILTER_S: f64 = 0.02;

/// The fingertip's contact as the last reading found it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ContactAge {
    /// Readings since something was touched.
    readings_free: u32,
    /// Smoothed place of the load along the sensor's x and y axes (m), since it is known.
    place_m: Option<[f64; 2]>,
    /// For how long it has lasted, short gaps included (s).
    age_s: f64,
}

impl ContactAge {
    /// A fingertip that has touched nothing yet.
    pub(crate) const fn new() -> ContactAge {
        ContactAge { readings_free: u32::MAX, place_m: None, age_s: 0.0 }
    }

    /// Takes the place of the load (m), if there is one, `after_s` after the last reading (s); true
    /// where the load has jumped.
    pub(crate) fn update(&mut self, load_m: Option<[f64; 2]>, after_s: f64) -> bool {
        let Some([x_m, y_m]) = load_m else {
            self.readings_free = self.readings_free.saturating_add(1);
            if self.lasts() {
                self.age_s += after_s;
            } else {
                (self.age_s, self.place_m) = (0.0, None);
            }
            return false;
        };
        self.readings_free = 0;
        let place_m = self.place_m.get_or_insert([x_m, y_m]);
        let [along_x_m, along_y_m] = [x_m - place_m[0], y_m - place_m[1]];
        let has_jumped = along_x_m * along_x_m + along_y_m * along_y_m > JUMP_MIN_M * JUMP_MIN_M;
        let part = if has_jumped { 1.0 } else { (after_s / PLACE_FILTER_S).min(1.0) };
        place_m[0] += part * along_x_m;
        place_m[1] += part * along_y_m;
        self.age_s = if has_jumped { after_s } else { self.age_s + after_s };
        has_jumped
    }

    /// Whether something is touched, or was until a moment ago.
    pub(crate) const fn lasts(&self) -> bool {
        self.readings_free <= PUSHED_READINGS
    }

    /// For how long the contact has lasted (s); 0 without one.
    pub(crate) const fn age_s(&self) -> f64 {
        self.age_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 1.0 / 512.0;

    /// The age after so many readings of the same load, and whether the load jumped in one.
    fn after(readings: u32, load_m: Option<[f64; 2]>, age: &mut ContactAge) -> (f64, bool) {
        let has_jumped =
            (0..readings).fold(false, |jumped, _| age.update(load_m, PERIOD_S) | jumped);
        (age.age_s(), has_jumped)
    }

    #[test]
    fn a_contact_lasts_over_short_gaps_and_begins_anew_after_long_ones() {
        let mut age = ContactAge::new();
        assert!(!age.lasts());
        assert_eq!(after(10, Some([8e-3, 8e-3]), &mut age), (10.0 * PERIOD_S, false));
        assert_eq!(after(4, None, &mut age), (14.0 * PERIOD_S, false));
        assert!(age.lasts());
        assert_eq!(after(1, None, &mut age), (0.0, false));
        assert!(!age.lasts());
        // What is touched next may be touched anywhere.
        assert_eq!(after(2, Some([2e-3, 20e-3]), &mut age), (2.0 * PERIOD_S, false));
    }

    #[test]
    fn a_load_that_rolls_is_the_same_contact_and_one_that_jumps_is_another() {
        let mut age = ContactAge::new();
        let mut rolls = |speed_m_s: f64| {
            (0..80).any(|job| {
                age.update(Some([4e-3, 2e-3 + speed_m_s * PERIOD_S * f64::from(job)]), PERIOD_S)
            })
        };
        assert!(!rolls(0.05), "8 mm in 0.16 s");
        let mut rocks = ContactAge::new();
        after(100, Some([4e-3, 22e-3]), &mut rocks);
        // From one end of the pad to the other, within four images.
        let jumps = [17e-3, 12e-3, 7e-3, 2e-3].map(|y_m| after(2, Some([4e-3, y_m]), &mut rocks).1);
        assert!(jumps.contains(&true), "{jumps:?}");
        assert!(rocks.age_s() < 9.0 * PERIOD_S);
        assert_eq!(
            after(1, Some([14e-3, 2e-3]), &mut rocks),
            (PERIOD_S, true),
            "along the other axis"
        );
    }
}
