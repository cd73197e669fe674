//! The law that the configuration names. It is held by value, so that choosing it does not need
//! the heap, and used through [`Law`].

use core::ops::{Deref, DerefMut};

use taktil_rtcore::{Fold, Invalid, StateHash};

use super::Law;
use super::hybrid_force::HybridForceLaw;
use super::model::ModelLaw;
use super::phases::PhasesLaw;
use super::projector_pid::ProjectorPidLaw;
use super::task_frame::TaskFrameLaw;
use super::thesis::ThesisLaw;
use crate::config::Config;
use crate::config::law_name::LawName;

/// One of the laws.
#[expect(clippy::large_enum_variant, reason = "one of it exists, and the lane path has no heap")]
#[derive(Clone, Debug)]
pub enum ActiveLaw {
    /// See [`super::thesis`].
    Thesis(ThesisLaw),
    /// See [`super::projector_pid`].
    ProjectorPid(ProjectorPidLaw),
    /// See [`super::model`].
    Model(ModelLaw),
    /// See [`super::hybrid_force`].
    HybridForce(HybridForceLaw),
    /// See [`super::task_frame`].
    TaskFrame(TaskFrameLaw),
    /// See [`super::phases`].
    Phases(PhasesLaw),
}

impl ActiveLaw {
    /// Builds the law that the configuration names; allocates.
    ///
    /// # Errors
    /// Parameters that the named law cannot take.
    pub fn new(config: &Config) -> Result<ActiveLaw, Invalid> {
        Ok(match config.law {
            LawName::Thesis => ActiveLaw::Thesis(ThesisLaw::new(config)),
            LawName::ProjectorPid => ActiveLaw::ProjectorPid(ProjectorPidLaw::default()),
            LawName::Model => ActiveLaw::Model(ModelLaw::new(config)?),
            LawName::HybridForce | LawName::HybridForceTouch => {
                ActiveLaw::HybridForce(HybridForceLaw::default())
            }
            LawName::TaskFrame => ActiveLaw::TaskFrame(TaskFrameLaw::new(config)?),
            LawName::Phases => ActiveLaw::Phases(PhasesLaw::new(config)?),
        })
    }

    /// The law of a task in phases, if that is the one.
    #[must_use]
    pub fn phases(&self) -> Option<&PhasesLaw> {
        match self {
            ActiveLaw::Phases(law) => Some(law),
            _ => None,
        }
    }

    /// The same, to be changed.
    pub fn phases_mut(&mut self) -> Option<&mut PhasesLaw> {
        match self {
            ActiveLaw::Phases(law) => Some(law),
            _ => None,
        }
    }
}

impl Deref for ActiveLaw {
    type Target = dyn Law;

    fn deref(&self) -> &(dyn Law + 'static) {
        match self {
            ActiveLaw::Thesis(law) => law,
            ActiveLaw::ProjectorPid(law) => law,
            ActiveLaw::Model(law) => law,
            ActiveLaw::HybridForce(law) => law,
            ActiveLaw::TaskFrame(law) => law,
            ActiveLaw::Phases(law) => law,
        }
    }
}

impl DerefMut for ActiveLaw {
    fn deref_mut(&mut self) -> &mut (dyn Law + 'static) {
        match self {
            ActiveLaw::Thesis(law) => law,
            ActiveLaw::ProjectorPid(law) => law,
            ActiveLaw::Model(law) => law,
            ActiveLaw::HybridForce(law) => law,
            ActiveLaw::TaskFrame(law) => law,
            ActiveLaw::Phases(law) => law,
        }
    }
}

impl Fold for ActiveLaw {
    fn fold(&self, hash: &mut StateHash) {
        (**self).fold(hash);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::TouchFeatures;
    use taktil_signal::Wrench;

    #[test]
    fn losing_contact_clears_the_integral_of_the_wrench_law() {
        let config = Config { law: LawName::HybridForce, ..Config::default() };
        let wrench = |press_n: f64| Wrench {
            force_n: [0.0, 0.0, -press_n],
            baseline_ready: 1,
            ..taktil_rtcore::Payload::ZERO
        };
        let image = TouchFeatures::default();
        let mut law = ActiveLaw::new(&config).unwrap();
        let mut steps = Vec::new();
        for press_n in [14.6, 14.6, 0.0, 14.6] {
            let features = law.observe_wrench(&config, Some(&wrench(press_n)), &image).unwrap();
            // As in the task: the law is asked only while the finger is in contact.
            steps.extend(features.contact.then(|| law.command(&config, 8.5, 0.0025).unwrap()));
        }
        assert_ne!(steps[0], steps[1], "the law has an integral");
        assert_eq!(steps[0], steps[2], "the integral begins at zero again");
    }
}
