//! The names by which a scene chooses a control law.

use serde::Deserialize;

taktil_rtcore::explained! {
    /// The laws that a scene may name.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum LawName {
        /// The diagonal Jacobian of 1994.
        #[default]
        Thesis,
        /// PID on selected features (Li et al. 2013).
        ProjectorPid,
        /// The coupled Jacobian of the contact, delay and table motion observed.
        Model,
        /// The wrist's force and centre of pressure.
        HybridForce,
        /// The wrist's force, with the centre of pressure and the direction from touch.
        HybridForceTouch,
        /// The task that the scene describes.
        TaskFrame,
        /// The task that is a sequence of phases.
        Phases,
    }
}

impl LawName {
    /// Every law that rolls a pin.
    pub const ALL: [LawName; 5] = [
        LawName::Thesis,
        LawName::ProjectorPid,
        LawName::Model,
        LawName::HybridForce,
        LawName::HybridForceTouch,
    ];

    /// As a scene writes it.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            LawName::Thesis => "thesis",
            LawName::ProjectorPid => "projector-pid",
            LawName::Model => "model",
            LawName::HybridForce => "hybrid-force",
            LawName::HybridForceTouch => "hybrid-force-touch",
            LawName::TaskFrame => "task-frame",
            LawName::Phases => "phases",
        }
    }

    /// The law reads the port `wrench`.
    #[must_use]
    pub const fn uses_wrench(self) -> bool {
        matches!(self, LawName::HybridForce | LawName::HybridForceTouch)
    }
}
