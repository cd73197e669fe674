//! The pin with both its contacts and the fixture that steadies it. It gives the forces at a
//! configuration; the integrators choose the configuration.

use glam::DVec3;
use taktil_hal::Nanos;

use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::spatial::spatial_vector;
use taktil_mechanics::{Joints, Pose};

use crate::contact::{BristleState, ContactLine, LoadFactor, Patch, Reaction, Tangent};
use crate::electronics::{add_tangential_image, tactel_forces};
use crate::fixture::PinFixture;
use crate::geometry::ArrayGeometry;
use crate::hash::Hash;
use crate::opposed::OpposedPad;
use crate::pin::Pin;
use crate::spatial::{SolveCounts, SpatialSolver, load_factor_of};
use crate::surroundings::Surroundings;

/// The pin, its contacts with the finger's pad and with its support, and the fixture.
#[derive(Clone, Debug)]
pub(crate) struct RollingPin {
    pub(crate) pin: Pin,
    pub(crate) pad: Patch,
    /// The finger's array.
    pub(crate) array: ArrayGeometry,
    pub(crate) support: Patch,
    /// The fingertip in the table's place; then its rubber is the support.
    pub(crate) opposed: Option<Box<OpposedPad>>,
    pub(crate) fixture: PinFixture,
    pub(crate) released: Option<Nanos>,
    /// Latest forces of finger and support on the pin.
    pub(crate) finger_reaction: Reaction,
    pub(crate) support_reaction: Reaction,
    /// Cosine between the sensor's x and the rolling direction at the latest evaluation.
    pub(crate) rolling_cosine: f64,
    /// The solver of the contact with the pad in three dimensions, for scenes that ask for it.
    pub(crate) spatial: Option<Box<SpatialSolver>>,
    /// Room for the bristles at the start of an evaluation, of pad and support.
    pub(crate) start: Box<[BristleState; 2]>,
}

/// Everything that the next instant depends on.
#[derive(Clone, Debug)]
pub(crate) struct PinState {
    pub(crate) pin: Pin,
    pub(crate) pad: BristleState,
    pub(crate) support: BristleState,
}

/// The contact lines and the derivatives of the forces on them with respect to the motion; none
/// without contact.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PinContacts {
    pub(crate) finger: Option<(ContactLine, Tangent)>,
    pub(crate) table: Option<(ContactLine, Tangent)>,
}

impl RollingPin {
    /// The present state. Allocates.
    pub(crate) fn state(&self) -> PinState {
        PinState {
            pin: self.pin,
            pad: self.pad.slices.bristles.clone(),
            support: self.support.slices.bristles.clone(),
        }
    }

    /// Writes the present state over an earlier one.
    pub(crate) fn save(&self, state: &mut PinState) {
        state.pin = self.pin;
        state.pad.copy_from(&self.pad.slices.bristles);
        state.support.copy_from(&self.support.slices.bristles);
    }

    pub(crate) fn restore(&mut self, state: &PinState) {
        self.pin = state.pin;
        self.pad.slices.bristles.copy_from(&state.pad);
        self.support.slices.bristles.copy_from(&state.support);
    }

    /// Evaluates both contacts and moves their bristles by `h` seconds.
    pub(crate) fn evaluate(&mut self, surroundings: &Surroundings, h: f64) {
        let [mut pad, mut support] = core::mem::take(&mut *self.start);
        pad.copy_from(&self.pad.slices.bristles);
        support.copy_from(&self.support.slices.bristles);
        self.evaluate_from(&pad, &support, surroundings, h, &mut PinContacts::default());
        *self.start = [pad, support];
    }

    /// Evaluates both contacts and moves their bristles by `h` seconds from earlier states of the
    /// bristles; writes the contact lines into `contacts`.
    pub(crate) fn evaluate_from(
        &mut self,
        pad_bristles: &BristleState,
        support: &BristleState,
        surroundings: &Surroundings,
        h: f64,
        contacts: &mut PinContacts,
    ) {
        let axis = self.pin.axis();
        (contacts.finger, contacts.table) = (None, None);
        let below = match self.opposed {
            Some(_) => ContactLine::on_pad(&self.pin, axis, &surroundings.table),
            None => ContactLine::on_table(&self.pin, axis, &surroundings.table),
        };
        let pitch_y_m = self.opposed.as_ref().map_or(self.array.pitch_y_m, |o| o.array.pitch_y_m);
        match below {
            Some(line) if line.is_clear(self.pin.length_m, pitch_y_m) => {
                self.support_reaction = self.support.release_above(&line)
            }
            Some(line) => {
                if let Some(opposed) = &mut self.opposed {
                    let pad = opposed.pad_under(&line, surroundings);
                    let geometry = &mut self.support.slices.geometry;
                    geometry.place_on_pad(&line, &pad, &opposed.array, self.pin.length_m);
                }
                let (reaction, tangent) = self.support.evaluate(&line, support, h);
                self.support_reaction = reaction;
                contacts.table = Some((line, tangent));
            }
            None => self.support_reaction = self.support.release(),
        }
        match ContactLine::on_pad(&self.pin, axis, &surroundings.finger) {
            Some(line) if line.is_clear(self.pin.length_m, self.array.pitch_y_m) => {
                self.finger_reaction = self.pad.release_above(&line)
            }
            Some(line) => {
                self.rolling_cosine = line.across.dot(surroundings.pad.rotation.x_axis);
                let (geometry, pad) = (&mut self.pad.slices.geometry, &surroundings.pad);
                geometry.place_on_pad(&line, pad, &self.array, self.pin.length_m);
                let (reaction, tangent) = self.pad.evaluate(&line, pad_bristles, h);
                self.finger_reaction = reaction;
                contacts.finger = Some((line, tangent));
            }
            None => self.finger_reaction = self.pad.release(),
        }
    }

    /// Writes the normal force on each tactel of the finger (N) at the latest evaluation. Solves
    /// the contact in three dimensions where the scene asks for that, and counts whether it
    /// succeeded.
    pub(crate) fn image(&mut self, surroundings: &Surroundings, forces: &mut [f64]) -> SolveCounts {
        let line = ContactLine::on_pad(&self.pin, self.pin.axis(), &surroundings.finger);
        let seen = SeenLine {
            line: line.as_ref(),
            pose: &surroundings.pad,
            array: &self.array,
            rolling_cosine: self.rolling_cosine,
            normal_n: self.finger_reaction.normal_n,
        };
        tactile_image(&mut self.pad, self.spatial.as_deref_mut(), seen, forces)
    }

    /// Writes the normal force on each tactel of the opposed fingertip (N); none without one.
    pub(crate) fn opposed_image(
        &mut self,
        surroundings: &Surroundings,
        forces: &mut [f64],
    ) -> SolveCounts {
        let Some(opposed) = &mut self.opposed else { return SolveCounts::default() };
        let line = ContactLine::on_pad(&self.pin, self.pin.axis(), &surroundings.table);
        let pose = opposed.pose(&surroundings.table_axes, &surroundings.table);
        let seen = SeenLine {
            line: line.as_ref(),
            pose: &pose,
            array: &opposed.array,
            rolling_cosine: opposed.rolling_cosine,
            normal_n: self.support_reaction.normal_n,
        };
        tactile_image(&mut self.support, opposed.spatial.as_deref_mut(), seen, forces)
    }

    /// Total force and moment about the centre on the pin at the latest evaluation (N, N m).
    pub(crate) fn net_load(&self, surroundings: &Surroundings) -> (DVec3, DVec3) {
        let (finger, support) = (&self.finger_reaction, &self.support_reaction);
        let weight = DVec3::new(0.0, 0.0, -self.pin.mass_kg * GRAVITY_M_S2);
        let (mut force, mut moment) =
            (finger.force + support.force + weight, finger.moment + support.moment);
        if self.fixture.holding {
            let (grip, twist) = self.fixture.force_and_moment(
                &self.pin,
                &surroundings.table_axes,
                &surroundings.table,
            );
            force += grip;
            moment += twist;
        }
        (force, moment)
    }

    /// Moves the pin by an explicit step of `h` seconds.
    pub(crate) fn step(&mut self, surroundings: &Surroundings, h: f64) {
        let (force, moment) = self.net_load(surroundings);
        let axis = self.pin.axis();
        self.pin.step(h, axis, force, moment);
    }

    /// Releases the fixture if the finger presses hard enough, and notes when.
    pub(crate) fn update_fixture(&mut self, now: Nanos) {
        let held = self.fixture.holding;
        self.fixture.update(self.finger_reaction.normal_n);
        if held && !self.fixture.holding {
            self.released = Some(now);
        }
    }

    /// Wrench of the pin on the tool about the tool point (N, N m, base axes).
    pub(crate) fn wrench(&self, tool: DVec3) -> Joints {
        let moment = self.finger_reaction.moment_about(tool, self.pin.position);
        spatial_vector(-self.finger_reaction.force, -moment)
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        self.pin.digest(hash);
        self.pad.digest(hash);
        self.support.digest(hash);
        if self.spatial.is_some() {
            hash.numbers(&[self.pad.load_factor.at_centre, self.pad.load_factor.per_m]);
            if self.opposed.is_some() {
                hash.numbers(&[self.support.load_factor.at_centre, self.support.load_factor.per_m]);
            }
        }
        hash.word(u64::from(self.fixture.holding));
    }
}

/// The contact line as a tactile sensor sees it.
struct SeenLine<'a> {
    /// None when the pin stands on end over the pad.
    line: Option<&'a ContactLine>,
    /// The sensor's frame.
    pose: &'a Pose,
    array: &'a ArrayGeometry,
    /// Cosine between the sensor's x and the rolling direction.
    rolling_cosine: f64,
    /// Normal force on the pad (N).
    normal_n: f64,
}

/// Writes the normal force on each tactel of a pad (N), and counts whether the contact was solved
/// in three dimensions where the scene asks for that.
fn tactile_image(
    pad: &mut Patch,
    spatial: Option<&mut SpatialSolver>,
    seen: SeenLine<'_>,
    forces: &mut [f64],
) -> SolveCounts {
    let SeenLine { line, pose, array, rolling_cosine, normal_n } = seen;
    let (Some(spatial), Some(line)) = (spatial, line) else {
        tactel_forces(pad, array, rolling_cosine, forces);
        return SolveCounts::default();
    };
    if normal_n <= 0.0 {
        spatial.release();
        pad.load_factor = LoadFactor::ONE;
        tactel_forces(pad, array, rolling_cosine, forces);
        return SolveCounts::default();
    }
    let Some(solved) = spatial.solve(line, pose).filter(|s| s.force_n > 0.0) else {
        pad.load_factor = LoadFactor::ONE;
        tactel_forces(pad, array, rolling_cosine, forces);
        return SolveCounts::UNSOLVED;
    };
    pad.load_factor = load_factor_of(pad, array, &solved);
    // Viscous loads have the same distribution as elastic loads.
    let scale = (normal_n / solved.force_n).clamp(0.0, 2.0);
    for (force, elastic) in forces.iter_mut().zip(spatial.tactel_forces_n()) {
        *force = elastic * scale;
    }
    add_tangential_image(forces, pad, array, rolling_cosine);
    SolveCounts::of(pad.load_factor)
}
