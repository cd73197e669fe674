//! The step of the active-set method that changes the status of places: which places violate the
//! condition of their status, and which of those change it in this round.

use super::super::load_step::{ContactStatus, FrictionLaw, status_on_contact};
use super::FrictionalContact;

/// Rounds that may change many places at once; later ones change a single place.
const SIMULTANEOUS_ROUNDS: usize = 40;
/// Round from which every other round changes the first violating place (Murty's rule), which
/// cannot cycle.
const MURTY_ROUND: usize = 500;
/// Violation above which a place changes its status, in parts of the largest force and of the
/// descent; the larger value holds in late rounds, for places that nearly touch.
const VIOLATION_TOLERANCE: [f64; 2] = [1e-11, 5e-10];

impl FrictionalContact {
    /// Changes the status of places that violate its condition; returns how many violated it.
    pub(super) fn update_status(&mut self, round: usize) -> usize {
        let n = self.compliance.count();
        let largest = self.p.iter().fold(0.0_f64, |most, p| most.max(p.abs()));
        let [descent, tilt, place] = self.rigid;
        let depth = descent.abs() + tilt.abs() * self.compliance.x_mm[n - 1].abs();
        let (mut changed, mut worst) = (0, 0.0_f64);
        let slack = VIOLATION_TOLERANCE[usize::from(round >= 2 * MURTY_ROUND)];
        for i in 0..n {
            let was = self.status[i];
            let sum = |a: &[f64], b: &[f64]| -> f64 {
                let forces = self.p.iter().zip(&self.q);
                let pairs = a[i * n..][..n].iter().zip(&b[i * n..][..n]);
                pairs.zip(forces).map(|((a, b), (p, q))| a * p + b * q).sum()
            };
            // Places apart must not overlap, those in contact not pull; slip must oppose shear.
            let now = if was == ContactStatus::Apart {
                let surface = sum(&self.compliance.down_per_p, &self.compliance.down_per_q);
                let gap = self.height_mm[i] - descent - tilt * self.compliance.x_mm[i] + surface;
                worst = worst.max(-gap / depth.max(f64::MIN_POSITIVE));
                if gap < -slack * depth { status_on_contact(&self.status, i) } else { was }
            } else if self.p[i] < -slack * largest {
                worst = worst.max(-self.p[i] / largest);
                ContactStatus::Apart
            } else if let FrictionLaw::Coulomb(mu) = self.law {
                let limit = mu * self.p[i].max(0.0);
                if was == ContactStatus::Stick {
                    let over = self.q[i].abs() - limit;
                    worst = worst.max(over / largest);
                    match over > slack * largest {
                        true if self.q[i] > 0.0 => ContactStatus::SlipForward,
                        true => ContactStatus::SlipBack,
                        false => was,
                    }
                } else {
                    let along = sum(&self.compliance.along_per_p, &self.compliance.along_per_q);
                    let moved = along - place - self.stick_offset[i];
                    let wrong = if was == ContactStatus::SlipForward { moved } else { -moved };
                    if wrong > slack * depth { ContactStatus::Stick } else { was }
                }
            } else {
                was
            };
            changed += usize::from(now != was);
            self.next[i] = now;
        }
        // Contact is settled before slip: changing both at once makes the active set cycle.
        let turns = |a: &ContactStatus, b: &ContactStatus| {
            (*a == ContactStatus::Apart) != (*b == ContactStatus::Apart)
        };
        let normal = self.status.iter().zip(&self.next).any(|(was, now)| turns(was, now));
        // Late rounds change a single place, drawn at random; from MURTY_ROUND on every other round
        // changes the first one.
        if round < SIMULTANEOUS_ROUNDS || changed == 0 {
            for (was, now) in self.status.iter_mut().zip(&self.next) {
                if !normal || turns(was, now) {
                    *was = *now;
                }
            }
        } else {
            let drawn = (round as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
            let first = round >= MURTY_ROUND && round.is_multiple_of(2);
            let chosen = if first { 0 } else { drawn as usize % changed };
            let pairs = self.status.iter_mut().zip(&self.next);
            if let Some((was, now)) = pairs.filter(|(was, now)| was != now).nth(chosen) {
                *was = *now;
            }
        }
        self.residual = worst.max(0.0);
        changed
    }
}
