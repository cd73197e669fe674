//! The asymptote of a light load: the force of a cylinder that touches more lightly than every
//! contact in its table. Where the table does not follow the law of narrow contacts, its last slope
//! is extrapolated.

/// Most Newton steps to the force, and the change of its logarithm at which they end.
const NEWTON_STEPS_MAX: usize = 40;
const LOG_FORCE_TOLERANCE: f64 = 1e-7;

/// A contact of known force.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LogContact {
    /// Logarithm of the depth.
    pub(crate) depth: f64,
    /// Logarithm of the force.
    pub(crate) force: f64,
}

/// Logarithm of the force at the logarithm of a depth, from two deeper contacts. In a narrow
/// contact the ratio of depth and force is linear in the logarithm of the width, and therefore in
/// that of the force.
pub(crate) fn light_load_force([deeper, known]: [LogContact; 2], depth: f64) -> f64 {
    let per = |contact: LogContact| libm::exp(contact.depth - contact.force);
    let growth = (per(known) - per(deeper)) / (deeper.force - known.force);
    let slope = (deeper.force - known.force) / (deeper.depth - known.depth);
    let mut force = known.force + slope * (depth - known.depth);
    for _ in 0..NEWTON_STEPS_MAX {
        let compliance = per(known) + growth * (known.force - force);
        if !(growth > 0.0 && compliance > 2.0 * growth) {
            break;
        }
        let step = (depth - force - libm::log(compliance)) / (1.0 - growth / compliance);
        force += step;
        if step.abs() < LOG_FORCE_TOLERANCE {
            break;
        }
    }
    force
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tests the law of narrow contacts, and a table that contradicts it.
    #[test]
    fn a_narrow_contact_follows_the_logarithm_of_its_width() {
        let depth = |force: f64| libm::log(libm::exp(force) * (2.0 - 0.3 * force));
        let known = [-4.0, -5.0].map(|force| LogContact { depth: depth(force), force });
        for force in [-5.0, -6.0, -12.0, -40.0] {
            let found = light_load_force(known, depth(force));
            assert!((found - force).abs() < 1e-6, "{force}: {found}");
        }
        let stiffer = [(-4.0, -4.0), (-5.0, -4.9)];
        let stiffer = stiffer.map(|(depth, force)| LogContact { depth, force });
        assert!((light_load_force(stiffer, -6.0) + 5.8).abs() < 1e-12);
    }
}
