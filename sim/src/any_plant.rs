//! A plant with any of the numbers of coordinates that are compiled, as the world sees it. Which
//! one it is is decided when the bench is built; every call is then that of a plant whose number of
//! coordinates the compiler knows.

use taktil_hal::Nanos;

use crate::hash::Hash;
use crate::manipulator::Manipulator;
use crate::object::Objects;
use crate::rolling::RollingPin;
use crate::step::{Plant, StepStatistics};
use crate::surroundings::Surroundings;
use crate::table::Table;

/// Evaluates one expression with the plant of an [`AnyPlant`].
macro_rules! with_plant {
    ($any:expr, $plant:ident => $what:expr) => {
        match $any {
            AnyPlant::Six($plant) => $what,
            AnyPlant::Seven($plant) => $what,
        }
    };
}

/// A plant by the number of its finger's coordinates.
#[derive(Clone, Debug)]
pub(crate) enum AnyPlant {
    /// Six joints at most: the PUMA 260, a carriage, a chain of six.
    Six(Box<Plant<6, 12>>),
    /// A chain of seven joints.
    Seven(Box<Plant<7, 13>>),
}

impl From<Plant<6, 12>> for AnyPlant {
    fn from(plant: Plant<6, 12>) -> AnyPlant {
        AnyPlant::Six(Box::new(plant))
    }
}

impl From<Plant<7, 13>> for AnyPlant {
    fn from(plant: Plant<7, 13>) -> AnyPlant {
        AnyPlant::Seven(Box::new(plant))
    }
}

impl AnyPlant {
    /// What carries the fingertip.
    pub(crate) fn finger(&self) -> &dyn Manipulator {
        with_plant!(self, plant => plant.finger.as_ref())
    }

    /// What carries the fingertip, to be driven.
    pub(crate) fn finger_mut(&mut self) -> &mut dyn Manipulator {
        with_plant!(self, plant => plant.finger.as_mut())
    }

    /// The pin with its contacts.
    pub(crate) fn rolling(&self) -> Option<&RollingPin> {
        with_plant!(self, plant => plant.rolling.as_deref())
    }

    /// The objects on the table.
    pub(crate) fn objects(&self) -> Option<&Objects> {
        with_plant!(self, plant => plant.objects.as_deref())
    }

    /// The table.
    pub(crate) fn table(&self) -> &Table {
        with_plant!(self, plant => &plant.table)
    }

    /// What was computed since the start.
    pub(crate) fn statistics(&self) -> &StepStatistics {
        with_plant!(self, plant => &plant.statistics)
    }

    /// The same, to be counted on.
    pub(crate) fn statistics_mut(&mut self) -> &mut StepStatistics {
        with_plant!(self, plant => &mut plant.statistics)
    }

    /// Largest estimated error of a step that was taken (m).
    pub(crate) fn error_m(&self) -> f64 {
        with_plant!(self, plant => plant.error_m)
    }

    /// See [`Plant::integrate`].
    pub(crate) fn integrate(&mut self, from: Nanos, to: Nanos) {
        with_plant!(self, plant => plant.integrate(from, to));
    }

    /// See [`Plant::surroundings`].
    pub(crate) fn surroundings(&self, t_s: f64) -> Surroundings {
        with_plant!(self, plant => plant.surroundings(t_s))
    }

    /// See [`Plant::evaluate_contacts`].
    pub(crate) fn evaluate_contacts(&mut self, t_s: f64) {
        with_plant!(self, plant => plant.evaluate_contacts(t_s));
    }

    /// See [`Plant::image`].
    pub(crate) fn image(&mut self, t_s: f64, forces: &mut [f64]) {
        with_plant!(self, plant => plant.image(t_s, forces));
    }

    /// See [`Plant::opposed_image`].
    pub(crate) fn opposed_image(&mut self, t_s: f64, forces: &mut [f64]) {
        with_plant!(self, plant => plant.opposed_image(t_s, forces));
    }

    /// See [`Plant::hand_image`].
    pub(crate) fn hand_image(&mut self, finger: usize, forces: &mut [f64]) {
        with_plant!(self, plant => plant.hand_image(finger, forces));
    }

    /// Adds everything that the next instant depends on.
    pub(crate) fn digest(&self, hash: &mut Hash) {
        with_plant!(self, plant => plant.digest(hash));
    }
}
