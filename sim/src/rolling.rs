//! The pin with both its contacts and the hand that steadies it. Refuses to integrate: it gives the
//! forces at a configuration, whoever chose that.

use glam::DVec3;
use taktil_hal::{MAX_TACTELS, Nanos};
use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::spatial::spatial_vector;
use taktil_mechanics::{Joints, Pose};

use crate::contact::{Bristles, Lean, Line, Patch, Reaction, Tangent};
use crate::electronics::{add_drag, base_forces};
use crate::hand::Hand;
use crate::hash::Hash;
use crate::opposed::Opposed;
use crate::pin::Pin;
use crate::spatial::{Spatial, Tally, lean_of};
use crate::surroundings::Surroundings;

/// The pin with both its contacts.
#[derive(Clone, Debug)]
pub(crate) struct Rolling {
    pub(crate) pin: Pin,
    pub(crate) pad: Patch,
    pub(crate) bed: Patch,
    /// The fingertip in the table's place, whose rubber the bed is then.
    pub(crate) opposed: Option<Box<Opposed>>,
    pub(crate) hand: Hand,
    pub(crate) released: Option<Nanos>,
    /// Latest forces of finger and table on the pin.
    pub(crate) by_finger: Reaction,
    pub(crate) by_table: Reaction,
    /// Cosine between the sensor's x and the rolling direction at the latest evaluation.
    pub(crate) across: f64,
    /// The contact with the pad in three dimensions, for scenes that ask for it.
    pub(crate) spatial: Option<Box<Spatial>>,
}

/// What the next instant depends on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Memory {
    pub(crate) pin: Pin,
    pub(crate) pad: Bristles,
    pub(crate) bed: Bristles,
}

/// The lines of contact and how the forces on them depend on the motion.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Touching {
    pub(crate) finger: Option<(Line, Tangent)>,
    pub(crate) table: Option<(Line, Tangent)>,
}

impl Rolling {
    pub(crate) fn memory(&self) -> Memory {
        Memory { pin: self.pin, pad: self.pad.slices.bristles, bed: self.bed.slices.bristles }
    }

    pub(crate) fn remember(&mut self, memory: &Memory) {
        self.pin = memory.pin;
        self.pad.slices.bristles = memory.pad;
        self.bed.slices.bristles = memory.bed;
    }

    /// Evaluates both contacts and moves their bristles on by `h` seconds.
    pub(crate) fn touch(&mut self, around: &Surroundings, h: f64) {
        let (pad, bed) = (self.pad.slices.bristles, self.bed.slices.bristles);
        self.touch_from((&pad, &bed), around, h, &mut Touching::default());
    }

    /// The same with bristles, of pad and table, that were before; says how it touches.
    pub(crate) fn touch_from(
        &mut self,
        (pad, bed): (&Bristles, &Bristles),
        around: &Surroundings,
        h: f64,
        touching: &mut Touching,
    ) {
        let axis = self.pin.axis();
        (touching.finger, touching.table) = (None, None);
        let below = match self.opposed {
            Some(_) => Line::between(&self.pin, axis, &around.table),
            None => Line::on_table(&self.pin, axis, &around.table),
        };
        match below {
            Some(line) if line.clear(self.pin.length_m) => self.by_table = self.bed.pass(&line),
            Some(line) => {
                if let Some(opposed) = &mut self.opposed {
                    let pad = opposed.under(&line, around);
                    self.bed.slices.strips.lie_on_pad(&line, &pad, self.pin.length_m);
                }
                let (reaction, tangent) = self.bed.act(&line, bed, h);
                self.by_table = reaction;
                touching.table = Some((line, tangent));
            }
            None => self.by_table = self.bed.release(),
        }
        match Line::between(&self.pin, axis, &around.finger) {
            Some(line) if line.clear(self.pin.length_m) => self.by_finger = self.pad.pass(&line),
            Some(line) => {
                self.across = line.across.dot(around.pad.rotation.x_axis);
                self.pad.slices.strips.lie_on_pad(&line, &around.pad, self.pin.length_m);
                let (reaction, tangent) = self.pad.act(&line, pad, h);
                self.by_finger = reaction;
                touching.finger = Some((line, tangent));
            }
            None => self.by_finger = self.pad.release(),
        }
    }

    /// Normal force on each tactel of the finger (N) at the latest evaluation; solves the contact
    /// in three dimensions where that is asked for and says whether it did.
    pub(crate) fn image(&mut self, around: &Surroundings) -> ([f64; MAX_TACTELS], Tally) {
        let line = Line::between(&self.pin, self.pin.axis(), &around.finger);
        let lie = (line.as_ref(), &around.pad, self.across);
        seen(&mut self.pad, self.spatial.as_deref_mut(), lie, self.by_finger.normal_n)
    }

    /// The same of the opposed fingertip; nothing where there is none.
    pub(crate) fn opposed_image(&mut self, around: &Surroundings) -> ([f64; MAX_TACTELS], Tally) {
        let none = ([0.0; MAX_TACTELS], Tally::default());
        let Some(opposed) = &mut self.opposed else { return none };
        let line = Line::between(&self.pin, self.pin.axis(), &around.table);
        let pose = opposed.pose(&around.table_axes, &around.table);
        let lie = (line.as_ref(), &pose, opposed.across);
        seen(&mut self.bed, opposed.spatial.as_deref_mut(), lie, self.by_table.normal_n)
    }

    /// Everything that acts on the pin at the latest evaluation: force and moment about its centre.
    pub(crate) fn load(&self, around: &Surroundings) -> (DVec3, DVec3) {
        let (finger, bed) = (&self.by_finger, &self.by_table);
        let weight = DVec3::new(0.0, 0.0, -self.pin.mass_kg * GRAVITY_M_S2);
        let (mut force, mut moment) =
            (finger.force + bed.force + weight, finger.moment + bed.moment);
        if self.hand.holding {
            let (grip, twist) = self.hand.grip(&self.pin, &around.table_axes, &around.table);
            force += grip;
            moment += twist;
        }
        (force, moment)
    }

    /// Moves the pin on by an explicit step.
    pub(crate) fn step(&mut self, around: &Surroundings, h: f64) {
        let (force, moment) = self.load(around);
        let axis = self.pin.axis();
        self.pin.step(h, axis, force, moment);
    }

    /// The hand feels the finger's latest force and may let go.
    pub(crate) fn feel(&mut self, now: Nanos) {
        let held = self.hand.holding;
        self.hand.feel(self.by_finger.normal_n);
        if held && !self.hand.holding {
            self.released = Some(now);
        }
    }

    /// Wrench of the pin on the tool about the tool point (base axes).
    pub(crate) fn wrench(&self, tool: DVec3) -> Joints {
        let moment = self.by_finger.moment_about(tool, self.pin.position);
        spatial_vector(-self.by_finger.force, -moment)
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        self.pin.digest(hash);
        self.pad.digest(hash);
        self.bed.digest(hash);
        if self.spatial.is_some() {
            hash.numbers(&[self.pad.lean.0, self.pad.lean.1]);
            if self.opposed.is_some() {
                hash.numbers(&[self.bed.lean.0, self.bed.lean.1]);
            }
        }
        hash.word(u64::from(self.hand.holding));
    }
}

/// Normal force on each tactel of a pad (N) whose pin lies along `line`, under a load of
/// `normal_n`, and whether it was solved in three dimensions where that is asked for. With the line
/// come the sensor's frame and the cosine between its x and the rolling direction.
fn seen(
    pad: &mut Patch,
    spatial: Option<&mut Spatial>,
    (line, pose, across): (Option<&Line>, &Pose, f64),
    normal_n: f64,
) -> ([f64; MAX_TACTELS], Tally) {
    let (Some(spatial), Some(line)) = (spatial, line) else {
        return (base_forces(pad, across), Tally::default());
    };
    if normal_n <= 0.0 {
        spatial.release();
        pad.lean = Lean::NONE;
        return (base_forces(pad, across), Tally::default());
    }
    let Some(solved) = spatial.solve(line, pose).filter(|s| s.force_n > 0.0) else {
        pad.lean = Lean::NONE;
        return (base_forces(pad, across), Tally::PLAIN);
    };
    pad.lean = lean_of(pad, &solved);
    let mut forces = spatial.forces_n();
    // Viscous loads are spread as the elastic ones.
    let scale = (normal_n / solved.force_n).clamp(0.0, 2.0);
    forces.iter_mut().for_each(|force| *force *= scale);
    add_drag(&mut forces, pad, across);
    (forces, Tally::of(pad.lean))
}
