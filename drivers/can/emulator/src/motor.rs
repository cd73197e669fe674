//! A motor: inertia and friction that grows with its speed.

use taktil_hal::Nanos;

/// The motor behind a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// Acceleration for one newton metre (turn/s^2).
    pub acceleration_per_nm: f64,
    /// Part of the speed that friction takes in a second.
    pub friction_per_s: f64,
    /// Where it is (turns).
    pub turns: f64,
    /// How fast it turns (turn/s).
    pub speed: f64,
}

/// Longest step of the integration.
const STEP_TIME_S: f64 = 1e-3;

impl Default for Motor {
    fn default() -> Motor {
        Motor { acceleration_per_nm: 100.0, friction_per_s: 5.0, turns: 0.0, speed: 0.0 }
    }
}

impl Motor {
    /// Turns for `span` under a torque (Nm), by the semi-implicit rule.
    pub(crate) fn turn(&mut self, span: Nanos, torque_nm: f64) {
        // Whoever did not look for a minute need not see each of its milliseconds.
        let mut left = span.as_secs_f64().min(60.0);
        while left > 0.0 {
            let step = left.min(STEP_TIME_S);
            let force = self.acceleration_per_nm * torque_nm - self.friction_per_s * self.speed;
            self.speed += step * force;
            self.turns += step * self.speed;
            left -= step;
        }
    }
}
