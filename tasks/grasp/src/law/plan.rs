//! What is done with an object that is held: it is moved or turned between the fingers, and the
//! palm is moved by the arm that carries it.

use glam::DVec3;

/// A motion of the held object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plan {
    /// How long it is held before it moves (s).
    pub after_s: f64,
    /// Displacement (m), palm frame, and its speed (m/s).
    pub shift_m: DVec3,
    /// Speed of the displacement (m/s).
    pub shift_m_s: f64,
    /// Turn as a rotation vector (rad), palm frame.
    pub turn_rad: DVec3,
    /// Speed of the turn (rad/s).
    pub turn_rad_s: f64,
}

impl Plan {
    /// Displacement (m) and turn (rad) a time after the object was held (s).
    #[must_use]
    pub fn at(&self, held_s: f64) -> (DVec3, DVec3) {
        let t = (held_s - self.after_s).max(0.0);
        let part = |way: DVec3, speed: f64| {
            let length = way.length();
            if length > 0.0 { way * (speed * t / length).min(1.0) } else { DVec3::ZERO }
        };
        (part(self.shift_m, self.shift_m_s), part(self.turn_rad, self.turn_rad_s))
    }
}

/// A motion of the palm by the arm that carries it, while the object is held.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PalmPlan {
    /// How long the object is held before the palm moves (s).
    pub after_s: f64,
    /// Displacement of the palm (m), base frame.
    pub shift_m: DVec3,
    /// Largest speed of the displacement (m/s).
    pub shift_m_s: f64,
    /// Turn of the palm about its origin as a rotation vector (rad), base frame.
    pub turn_rad: DVec3,
    /// Largest speed of the turn (rad/s).
    pub turn_rad_s: f64,
    /// How long the palm stays there before it goes back (s); `None` where it stays for good.
    pub back_after_s: Option<f64>,
}

/// Largest speed of a motion with the least jerk, relative to that at constant speed: 15/8.
const LEAST_JERK_SPEED: f64 = 1.875;

impl PalmPlan {
    /// Whether the palm stays where it is.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.shift_m == DVec3::ZERO && self.turn_rad == DVec3::ZERO
    }

    /// How long one way takes (s).
    #[must_use]
    pub fn way_s(&self) -> f64 {
        let time_s =
            |way: f64, speed: f64| if way > 0.0 { LEAST_JERK_SPEED * way / speed } else { 0.0 };
        let shift_s = time_s(self.shift_m.length(), self.shift_m_s);
        shift_s.max(time_s(self.turn_rad.length(), self.turn_rad_s))
    }

    /// The part of the way, from 0 to 1, that has been gone a time `t` (s) after it began: a
    /// polynomial of fifth order in time, whose speed and acceleration are zero at both ends
    /// (T. Flash and N. Hogan, Journal of Neuroscience 5, 1985).
    fn share(&self, t: f64) -> f64 {
        let way_s = self.way_s();
        let part = if way_s > 0.0 { (t / way_s).clamp(0.0, 1.0) } else { 0.0 };
        part * part * part * (10.0 - part * (15.0 - 6.0 * part))
    }

    /// The part of the way that has been gone back a time after the object was held (s).
    #[must_use]
    pub fn share_back(&self, held_s: f64) -> f64 {
        let since_s = held_s - self.after_s - self.way_s();
        self.back_after_s.map_or(0.0, |stays_s| self.share(since_s - stays_s))
    }

    /// Whether the palm is to stand at the far end of its way a time after the object was held (s).
    #[must_use]
    pub fn stands_at_end(&self, held_s: f64) -> bool {
        let since_s = held_s - self.after_s - self.way_s();
        !self.is_still() && since_s >= 0.0 && self.back_after_s.is_none_or(|stay| since_s < stay)
    }

    /// Displacement (m) and turn (rad) a time after the object was held (s).
    #[must_use]
    pub fn at(&self, held_s: f64) -> (DVec3, DVec3) {
        let part = self.share(held_s - self.after_s) - self.share_back(held_s);
        (self.shift_m * part, self.turn_rad * part)
    }
}
