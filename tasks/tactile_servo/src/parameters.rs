//! The parameters of the servo that may be edited while it runs.

use taktil_rtcore::{Io, Param, Ports};

use crate::config::Config;
use crate::perception::M0_MAX_COUNTS;

/// The parameters that may be edited while the servo runs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parameters {
    m0: Param,
    roll: Param,
    press: Param,
}

impl Parameters {
    /// Declares them.
    pub(crate) fn new(config: &Config, ports: &mut Ports) -> Parameters {
        // Below these the load would never count as contact, or never roll.
        let least = config.contact_counts.max(config.roll_min_counts);
        let m0 = config.m0_counts;
        Parameters {
            m0: ports.parameter("m0_counts", m0, least..=(4.0 * m0).min(M0_MAX_COUNTS)),
            roll: ports.tunable("roll_mm_s", config.roll_mm_s),
            press: ports.tunable("press_mm_s", config.press_mm_s),
        }
    }

    /// Copies edited values into the configuration; true when a value changed.
    pub(crate) fn read(&self, io: &Io<'_>, config: &mut Config) -> bool {
        let now = io.parameters(&[self.m0, self.roll, self.press]);
        let before = [config.m0_counts, config.roll_mm_s, config.press_mm_s];
        [config.m0_counts, config.roll_mm_s, config.press_mm_s] = now;
        now != before
    }
}
