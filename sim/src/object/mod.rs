//! Contacts of the finger's pad with bodies fixed to the table: a sphere, an edge, a flat bar. The
//! normal load of each comes from `taktil_contact`, with Kelvin-Voigt damping that never pulls; one
//! brush of bristles in the middle of the load resists sliding (Kalker's one-point form, as under
//! the pin). The bodies move with the table only, and the pin does not touch them. Friction against
//! turning about the pad's normal and the energy under objects are left out.
//!
//! All quantities in this module are in the pad's frame: its axes, metres, z out of its face. An
//! object's own frame stands at its top with z out of the table, so that its z is opposite to the
//! pad's.

mod bar;
mod edge;
mod pad;
mod sphere;
#[cfg(test)]
mod tests;

use glam::{DMat3, DVec2, DVec3};
use taktil_contact::space::tactels::{Fineness, Shares};
use taktil_mechanics::spatial::{
    Jacobian, JointVector, rotation_x, rotation_y, rotation_z, spatial_vector,
};
use taktil_mechanics::{Joints, Pose};

use crate::contact::{LoadFactor, slip_compliance_m_n};
use crate::geometry::ArrayGeometry;
use crate::hash::Hash;
use crate::scene::{Invalid, OBJECTS_MAX, ObjectConfig, ObjectKind, WorldConfig};
use crate::spatial::SolveCounts;
use crate::square_cells::SquareCells;
use crate::surroundings::Surroundings;
use crate::table::Table;
use bar::BarContact;
use edge::EdgeContact;
use pad::{finger_pad, spatial_accuracy};
use sphere::SphereContact;

/// Distance over which the load fades out as a place leaves the pad (m).
const EDGE_FADE_M: f64 = 0.5e-3;
/// Half-width of the narrowest contact through which bristles travel (m).
const HALF_WIDTH_MIN_M: f64 = 1e-9;

/// Penetration up to which strain is small, in thicknesses of the layer.
const SMALL_STRAIN_THICKNESSES: f64 = 0.2;

/// The bristles of one object's contact: everything that the next instant depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ObjectBristle {
    /// Mean deflection along the pad's x and y (m).
    pub(crate) deflection: DVec2,
    /// Stiffness (N/m).
    pub(crate) shear_n_m: f64,
}

/// The bristles of all objects.
pub(crate) type ObjectBristles = [ObjectBristle; OBJECTS_MAX];

/// Place and motion of an object relative to the pad.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RelativeMotion {
    /// The object's frame (m).
    pub(crate) place: DVec3,
    pub(crate) turn: DMat3,
    /// Motion of the pad over the object's material, about the pad's middle (m/s, rad/s).
    pub(crate) velocity: DVec3,
    pub(crate) spin: DVec3,
    /// Length of the step that the motion belongs to (s).
    pub(crate) h: f64,
}

impl RelativeMotion {
    /// Speed of approach of a place on the pad and the object (m/s).
    fn closing(&self, x: f64, y: f64) -> f64 {
        self.velocity.z + self.spin.x * y - self.spin.y * x
    }
}

/// A contact's loads, summed over its places.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ContactLoad {
    /// Normal load (N).
    pub(crate) load_n: f64,
    /// Its first moments about the pad's middle (N m).
    pub(crate) lever_nm: DVec2,
    /// Load per speed of approach w (N s/m), summed as w, w x, w y, w x^2, w x y, w y^2.
    weights: [f64; 6],
    /// Stiffness against a tangential shift (N/m).
    shear_n_m: f64,
    /// Half the contact's width (m).
    half_width_m: f64,
    /// Speed at which the contact travels over the pad (m/s).
    travel_m_s: f64,
    /// Deepest penetration (m).
    pub(crate) deepest_m: f64,
}

impl ContactLoad {
    fn add(&mut self, at: DVec2, load_n: f64, weight: f64) {
        self.load_n += load_n;
        self.lever_nm += load_n * at;
        let (x, y) = (at.x, at.y);
        let parts = [1.0, x, y, x * x, x * y, y * y];
        for (sum, part) in self.weights.iter_mut().zip(parts) {
            *sum += weight * part;
        }
    }

    /// Middle of the load on the pad (m).
    pub(crate) fn middle(&self) -> Option<DVec2> {
        (self.load_n > 0.0).then(|| self.lever_nm / self.load_n)
    }
}

/// Factor on the load at a place of a pad with half the sides `half_m`: 1 well inside, 0 outside.
fn on_pad(at: DVec2, half_m: DVec2) -> f64 {
    let part = |u: f64, half: f64| ((half - u.abs()) / EDGE_FADE_M + 0.5).clamp(0.0, 1.0);
    part(at.x, half_m.x) * part(at.y, half_m.y)
}

/// The shape of an object with what its contact needs.
#[derive(Clone, Debug)]
enum Shape {
    Sphere(Box<SphereContact>),
    Edge(Box<EdgeContact>),
    Bar(Box<BarContact>),
}

/// Placement of a shape under the pad, see [`crate::truth::ObjectContact`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ObjectPlacement {
    pub(crate) off_m: f64,
    pub(crate) yaw_rad: f64,
    pub(crate) along_m: f64,
    pub(crate) tilt_rad: DVec2,
}

/// One object with its contact.
#[derive(Clone, Debug)]
pub(crate) struct Object {
    shape: Shape,
    /// Its frame, relative to the table's.
    place: DVec3,
    axes: DMat3,
    friction: f64,
    relaxation_s: f64,
    /// Deepest penetration that small strain covers (m).
    small_strain_m: f64,
    pub(crate) bristle: ObjectBristle,
    /// Loads of the latest evaluation.
    pub(crate) sums: ContactLoad,
    pub(crate) slip_m_s: f64,
    force: DVec3,
    moment: DVec3,
    tangential_weight: DVec2,
}

impl Object {
    fn new(config: &ObjectConfig, index: usize, world: &WorldConfig) -> Result<Object, Invalid> {
        let (rubber, array) = (&world.finger.rubber, world.tactile.geometry());
        let pad = finger_pad(rubber, &array);
        let place = format!("object[{index}]");
        let shape = match config.kind {
            ObjectKind::Sphere => {
                Shape::Sphere(Box::new(SphereContact::new(config, &pad, &place)?))
            }
            ObjectKind::Edge => {
                let level = spatial_accuracy(world);
                Shape::Edge(Box::new(EdgeContact::new(config, &pad, level, &place)?))
            }
            ObjectKind::Bar => Shape::Bar(Box::new(BarContact::new(config, &pad, &place)?)),
        };
        let [yaw, x, y] =
            [config.yaw_deg, config.tilt_x_deg, -config.tilt_y_deg].map(f64::to_radians);
        Ok(Object {
            shape,
            place: DVec3::ZERO,
            axes: rotation_z(yaw) * rotation_x(x) * rotation_y(y),
            friction: config.friction.unwrap_or(world.finger.friction),
            relaxation_s: 1e-3 * rubber.relaxation_ms,
            small_strain_m: 1e-3 * SMALL_STRAIN_THICKNESSES * rubber.thickness_mm,
            bristle: ObjectBristle::default(),
            sums: ContactLoad::default(),
            slip_m_s: 0.0,
            force: DVec3::ZERO,
            moment: DVec3::ZERO,
            tangential_weight: DVec2::ZERO,
        })
    }

    /// The place and motion of the object relative to the pad.
    fn relative_motion(&self, surroundings: &Surroundings, h: f64) -> RelativeMotion {
        let (table, axes) = (&surroundings.table, &surroundings.table_axes);
        let back = surroundings.pad.rotation.transpose();
        let origin = surroundings.pad.translation;
        let material = table.velocity + table.spin.cross(origin - table.origin);
        RelativeMotion {
            place: back * (table.origin + *axes * self.place - origin),
            turn: back * (*axes * self.axes),
            velocity: back * (surroundings.finger.velocity - material),
            spin: back * (surroundings.finger.spin - table.spin),
            h,
        }
    }

    /// Evaluates the contact and moves its bristles by `h` seconds.
    fn evaluate(&mut self, surroundings: &Surroundings, h: f64) {
        let motion = self.relative_motion(surroundings, h);
        self.sums = match &mut self.shape {
            Shape::Sphere(sphere) => sphere.evaluate(&motion, self.relaxation_s),
            Shape::Edge(edge) => edge.evaluate(&motion, self.relaxation_s),
            Shape::Bar(bar) => bar.evaluate(&motion, self.relaxation_s),
        };
        let Some(middle) = self.sums.middle() else {
            self.bristle = ObjectBristle::default();
            (self.force, self.moment) = (DVec3::ZERO, DVec3::ZERO);
            (self.tangential_weight, self.slip_m_s) = (DVec2::ZERO, 0.0);
            return;
        };
        let pull = self.tangential_force(&motion, middle);
        let load = self.sums.load_n;
        self.force = DVec3::new(pull.x, pull.y, -load);
        self.moment = DVec3::new(
            -self.sums.lever_nm.y,
            self.sums.lever_nm.x,
            middle.x * pull.y - middle.y * pull.x,
        );
    }

    /// Tangential force on the finger (N).
    fn tangential_force(&mut self, motion: &RelativeMotion, middle: DVec2) -> DVec2 {
        let (sums, bristle) = (&self.sums, &mut self.bristle);
        if sums.shear_n_m > bristle.shear_n_m {
            bristle.deflection *= bristle.shear_n_m / sums.shear_n_m;
        }
        bristle.shear_n_m = sums.shear_n_m;
        let turn = motion.spin.z;
        let creep = motion.velocity.truncate() + turn * DVec2::new(-middle.y, middle.x);
        let half = sums.half_width_m.max(HALF_WIDTH_MIN_M);
        let (h, damping) = (motion.h, self.relaxation_s);
        let keep = half / (half + h * sums.travel_m_s.abs());
        bristle.deflection = (bristle.deflection + h * creep) * keep;
        let force = -bristle.shear_n_m * (bristle.deflection + damping * creep);
        let weight = bristle.shear_n_m * (h * keep + damping);
        let (limit, size) = (self.friction * sums.load_n, force.length());
        if size <= limit {
            (self.tangential_weight, self.slip_m_s) = (DVec2::splat(weight), 0.0);
            return force;
        }
        let scale = limit / size;
        bristle.deflection +=
            (1.0 - scale) * slip_compliance_m_n(bristle.shear_n_m, weight, damping) * force;
        // A sliding force depends on the motion by its direction only.
        let direction_weight = |f: f64| weight * scale * (1.0 - f * f / (size * size));
        self.tangential_weight = DVec2::new(direction_weight(force.x), direction_weight(force.y));
        self.slip_m_s = creep.length();
        scale * force
    }

    fn placement(&self, surroundings: &Surroundings) -> ObjectPlacement {
        let motion = self.relative_motion(surroundings, 0.0);
        match &self.shape {
            Shape::Sphere(_) => ObjectPlacement::default(),
            Shape::Edge(edge) => edge.placement(&motion),
            Shape::Bar(bar) => bar.placement(&motion),
        }
    }

    /// Calls `visit` with a weight (N s/m, N m s/rad) and a row over the pad's twist in its own
    /// axes, for every direction in which the forces resist motion.
    fn for_each_tangent(&self, mut visit: impl FnMut(f64, [f64; 6])) {
        let Some(middle) = self.sums.middle() else { return };
        let [w, wx, wy, wxx, wxy, wyy] = self.sums.weights;
        if w > 0.0 {
            let (x, y) = (wx / w, wy / w);
            let [cxx, cxy, cyy] = [wxx - wx * x, wxy - wx * y, wyy - wy * y];
            visit(w, [0.0, 0.0, 1.0, y, -x, 0.0]);
            if cyy > 0.0 {
                visit(cyy, [0.0, 0.0, 0.0, 1.0, -cxy / cyy, 0.0]);
                visit((cxx - cxy * cxy / cyy).max(0.0), [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
            } else {
                visit(cxx.max(0.0), [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
            }
        }
        visit(self.tangential_weight.x, [1.0, 0.0, 0.0, 0.0, 0.0, -middle.y]);
        visit(self.tangential_weight.y, [0.0, 1.0, 0.0, 0.0, 0.0, middle.x]);
    }
}

/// All objects of a scene that has any.
#[derive(Clone, Debug)]
pub(crate) struct Objects {
    all: Vec<Object>,
    /// Responses of the tactels to point loads, for shapes whose image is made of point loads.
    shares: Option<Shares>,
    array: ArrayGeometry,
    cells: SquareCells,
    stresses_mpa: Box<[f64]>,
}

impl Objects {
    /// Solves the contacts and puts the objects on the table; none for a scene without objects.
    /// `finger` is the finger's start (m, base frame).
    pub(crate) fn new(
        config: &WorldConfig,
        table: &Table,
        finger: DVec3,
    ) -> Result<Option<Box<Objects>>, Invalid> {
        if config.object.is_empty() {
            return Ok(None);
        }
        let (_, axes, surface) = table.at(0.0);
        let mut all = Vec::with_capacity(config.object.len());
        for (index, one) in config.object.iter().enumerate() {
            let mut object = Object::new(one, index, config)?;
            let (x, y) = (finger.x + 1e-3 * one.x_mm, finger.y + 1e-3 * one.y_mm);
            let (n, o) = (surface.normal, surface.origin);
            // The top is over that place on the surface, by its height along the normal.
            let z = o.z - (n.x * (x - o.x) + n.y * (y - o.y)) / n.z;
            let top = DVec3::new(x, y, z) + 1e-3 * one.top_mm * n;
            object.place = axes.transpose() * (top - o);
            all.push(object);
        }
        let array = config.tactile.geometry();
        let pad = finger_pad(&config.finger.rubber, &array);
        let cells = SquareCells::new(&array, pad.array_place)?;
        let shares = match all.iter().all(|object| matches!(object.shape, Shape::Sphere(_))) {
            true => None,
            false => Some(pad.shares(&cells, Fineness::FAST)?),
        };
        let stresses_mpa = vec![0.0; array.tactels()].into();
        Ok(Some(Box::new(Objects { all, shares, array, cells, stresses_mpa })))
    }

    pub(crate) fn bristles(&self) -> ObjectBristles {
        let mut bristles = ObjectBristles::default();
        for (bristle, object) in bristles.iter_mut().zip(&self.all) {
            *bristle = object.bristle;
        }
        bristles
    }

    pub(crate) fn restore(&mut self, bristles: &ObjectBristles) {
        for (object, bristle) in self.all.iter_mut().zip(bristles) {
            object.bristle = *bristle;
        }
    }

    /// Evaluates every contact and moves the bristles by `h` seconds.
    pub(crate) fn evaluate(&mut self, surroundings: &Surroundings, h: f64) {
        for object in &mut self.all {
            object.evaluate(surroundings, h);
        }
    }

    /// Writes the resistances to the finger's motion, three numbers for each object: along its
    /// normal and against sliding in two directions (N s/m).
    pub(crate) fn resistances(&self, into: &mut [f64]) {
        for (three, object) in into.chunks_exact_mut(3).zip(&self.all) {
            if object.sums.middle().is_some() {
                three.copy_from_slice(&[
                    object.sums.weights[0],
                    object.tangential_weight.x,
                    object.tangential_weight.y,
                ]);
            }
        }
    }

    /// Whether an object is to be solved in three dimensions.
    pub(crate) fn is_spatial(&self) -> bool {
        self.all.iter().any(|one| matches!(&one.shape, Shape::Edge(edge) if edge.is_spatial))
    }

    /// The objects that touch the finger, as bits.
    pub(crate) fn contact_bits(&self) -> u8 {
        let bit = |(i, object): (usize, &Object)| u8::from(object.sums.load_n > 0.0) << i;
        self.all.iter().enumerate().map(bit).sum()
    }

    /// Sum of the normal forces (N).
    pub(crate) fn normal_n(&self) -> f64 {
        self.all.iter().map(|object| object.sums.load_n).sum()
    }

    /// Whether an object is pressed in deeper than the theory of small strain covers.
    pub(crate) fn beyond_small_strain(&self) -> bool {
        self.first_beyond_small_strain().is_some()
    }

    /// The first object that is pressed in deeper than that, and its penetration (m).
    pub(crate) fn first_beyond_small_strain(&self) -> Option<(usize, f64)> {
        let deep = |object: &Object| object.sums.deepest_m > object.small_strain_m;
        self.all.iter().position(deep).map(|i| (i, self.all[i].sums.deepest_m))
    }

    /// Wrench on the finger about the pad's middle (N, N m, base axes).
    pub(crate) fn wrench(&self, pad: &Pose) -> Joints {
        let (mut force, mut moment) = (DVec3::ZERO, DVec3::ZERO);
        for object in &self.all {
            force += object.force;
            moment += object.moment;
        }
        spatial_vector(pad.rotation * force, pad.rotation * moment)
    }

    /// Calls `visit` with a weight and a row over the finger's speeds, see
    /// [`Object::for_each_tangent`]; `jacobian` gives the twist of the pad in base axes.
    pub(crate) fn for_each_tangent<const J: usize>(
        &self,
        pad: &Pose,
        jacobian: &Jacobian<J>,
        mut visit: impl FnMut(f64, JointVector<J>),
    ) {
        for object in &self.all {
            object.for_each_tangent(|weight, row| {
                let linear = pad.rotation * DVec3::new(row[0], row[1], row[2]);
                let angular = pad.rotation * DVec3::new(row[3], row[4], row[5]);
                visit(weight, jacobian.tr_mul(&spatial_vector(linear, angular)));
            });
        }
    }

    /// Adds the normal force on each tactel (N) at the latest evaluation, and counts the contacts
    /// that were solved in three dimensions.
    pub(crate) fn image(&mut self, forces: &mut [f64]) -> SolveCounts {
        let (area_mm2, mut all) = (self.array.tactel_mm2(), SolveCounts::default());
        for object in &mut self.all {
            if object.sums.load_n <= 0.0 {
                // The factor is reset here and not in the evaluation, because an iterate that lifts
                // off is not a step.
                if let Shape::Edge(edge) = &mut object.shape {
                    edge.load_factor = LoadFactor::ONE;
                }
                continue;
            }
            let (cells, image) = (&mut self.cells, &mut self.stresses_mpa);
            image.fill(0.0);
            match (&mut object.shape, &self.shares) {
                (Shape::Sphere(sphere), _) => sphere.image(cells, image),
                (Shape::Edge(edge), Some(shares)) => all.add(edge.image(shares, cells, image)),
                (Shape::Bar(bar), Some(shares)) => bar.image(shares, cells, image),
                (Shape::Edge(_) | Shape::Bar(_), None) => {}
            }
            for (force, stress) in forces.iter_mut().zip(image.iter()) {
                *force -= area_mm2 * stress;
            }
        }
        all
    }

    /// The object that presses most, or the first object, with its placement.
    pub(crate) fn most_loaded(
        &self,
        surroundings: &Surroundings,
    ) -> Option<(&Object, ObjectPlacement)> {
        let mut most = self.all.first()?;
        for object in &self.all {
            if object.sums.load_n > most.sums.load_n {
                most = object;
            }
        }
        Some((most, most.placement(surroundings)))
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        for object in &self.all {
            let bristle = &object.bristle;
            if let Shape::Edge(edge) = &object.shape {
                hash.numbers(&[edge.load_factor.at_centre, edge.load_factor.per_m]);
            }
            hash.numbers(&[
                bristle.deflection.x,
                bristle.deflection.y,
                bristle.shear_n_m,
                object.sums.load_n,
            ]);
        }
    }
}
