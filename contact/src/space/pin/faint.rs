//! What a lying cylinder carries that touches more lightly than all its tables hold. It refuses
//! nothing: where the tables do not look like narrow contacts it goes on as they end.

/// Steps by which the force is found, and how well, in its logarithm.
const STEPS: usize = 40;
const FOUND: f64 = 1e-7;

/// Logarithm of the force at a depth, from two deeper ones, all in logarithms: of a narrow contact
/// the depth over the force goes with the logarithm of the width, and so with the force's.
pub(super) fn fainter([deeper, known]: [(f64, f64); 2], depth: f64) -> f64 {
    let per = |(depth, force): (f64, f64)| libm::exp(depth - force);
    let growth = (per(known) - per(deeper)) / (deeper.1 - known.1);
    let mut force = known.1 + (deeper.1 - known.1) / (deeper.0 - known.0) * (depth - known.0);
    for _ in 0..STEPS {
        let compliance = per(known) + growth * (known.1 - force);
        if !(growth > 0.0 && compliance > 2.0 * growth) {
            break;
        }
        let step = (depth - force - libm::log(compliance)) / (1.0 - growth / compliance);
        force += step;
        if step.abs() < FOUND {
            break;
        }
    }
    force
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Narrow contacts' own law, and tables that bend the other way.
    #[test]
    fn a_narrow_contact_follows_the_logarithm_of_its_width() {
        let depth = |force: f64| libm::log(libm::exp(force) * (2.0 - 0.3 * force));
        let known = [-4.0, -5.0].map(|force| (depth(force), force));
        for force in [-5.0, -6.0, -12.0, -40.0] {
            let found = fainter(known, depth(force));
            assert!((found - force).abs() < 1e-6, "{force}: {found}");
        }
        let stiffer = [(-4.0, -4.0), (-5.0, -4.9)];
        assert!((fainter(stiffer, -6.0) + 5.8).abs() < 1e-12);
    }
}
