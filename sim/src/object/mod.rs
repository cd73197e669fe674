//! Bodies fixed to the table against the finger's pad: a sphere, an edge, a flat bar. The normal
//! load of each comes from `taktil_contact`, with Kelvin-Voigt damping that never pulls;
//! one brush of bristles in the middle of its load resists sliding (Kalker's one-point form, as
//! under the pin). Refuses to move the bodies: they ride on the table, and the pin does not feel
//! them. Left out: friction against turning about the pad's normal, energy under objects.
//!
//! Everything in here is seen from the pad: its axes, metres, z out of its face. An object's own
//! frame stands at its top with z out of the table, so that its z runs against the pad's.

mod bar;
mod edge;
mod sphere;
#[cfg(test)]
mod tests;

use glam::{DMat3, DVec2, DVec3};
use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::space::radial::Influence;
use taktil_contact::space::tactels::{Array, Fineness, Sampling, Shares};
use taktil_hal::MAX_TACTELS;
use taktil_mechanics::spatial::{rotation_x, rotation_y, rotation_z, spatial_vector};
use taktil_mechanics::{Joints, Matrix6, Pose};

use crate::contact::{Lean, PAD_HALF_M, PITCH_M, yields_m_n};
use crate::fidelity::ContactModel;
use crate::hash::Hash;
use crate::rolling::Around;
use crate::rubber;
use crate::scene::{Invalid, OBJECTS_MAX, ObjectConfig, ObjectKind, RubberConfig, WorldConfig};
use crate::spatial::Tally;
use crate::table::Table;
use bar::Face;
use edge::Ridge;
use sphere::Ball;

/// Over this distance the load fades out as a place leaves the pad (m).
const EDGE_M: f64 = 0.5e-3;
/// Narrowest contact through which bristles travel (m).
const HALF_WIDTH_MIN_M: f64 = 1e-9;

/// Penetration in thicknesses up to which strain is small.
const SMALL: f64 = 0.2;

/// The bristles of one object's contact, all that it remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Grip {
    /// Mean deflection along the pad's x and y (m).
    pub(crate) brush: DVec2,
    /// Stiffness (N/m).
    pub(crate) shear_n_m: f64,
}

/// What all objects remember.
pub(crate) type Grips = [Grip; OBJECTS_MAX];

/// An object as the pad sees it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Meeting {
    /// The object's frame (m).
    pub(crate) place: DVec3,
    pub(crate) turn: DMat3,
    /// Motion of the pad over the object's material, about the pad's middle (m/s, rad/s).
    pub(crate) velocity: DVec3,
    pub(crate) spin: DVec3,
    /// The step that the motion belongs to (s).
    pub(crate) h: f64,
}

impl Meeting {
    /// Speed at which a place on the pad and the object close in (m/s).
    fn closing(&self, x: f64, y: f64) -> f64 {
        self.velocity.z + self.spin.x * y - self.spin.y * x
    }
}

/// A contact's loads, summed over its places.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sums {
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

impl Sums {
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

/// How a place on the pad takes load: 1 well inside, 0 outside.
fn on_pad(at: DVec2) -> f64 {
    let part = |u: f64| ((PAD_HALF_M - u.abs()) / EDGE_M + 0.5).clamp(0.0, 1.0);
    part(at.x) * part(at.y)
}

/// The shape of an object with what its contact needs.
#[derive(Clone, Debug)]
enum Shape {
    Ball(Box<Ball>),
    Ridge(Box<Ridge>),
    Face(Box<Face>),
}

/// How a shape lies under the pad, see [`crate::truth::Felt`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Lie {
    pub(crate) off_m: f64,
    pub(crate) yaw_rad: f64,
    pub(crate) along_m: f64,
    pub(crate) tilt_rad: DVec2,
}

/// One object.
#[derive(Clone, Debug)]
pub(crate) struct Object {
    shape: Shape,
    /// Its frame, seen from the table's.
    place: DVec3,
    axes: DMat3,
    friction: f64,
    relaxation_s: f64,
    /// Deepest penetration that small strain covers (m).
    small_m: f64,
    pub(crate) grip: Grip,
    /// Of the latest evaluation.
    pub(crate) sums: Sums,
    pub(crate) slip_m_s: f64,
    force: DVec3,
    moment: DVec3,
    drag: DVec2,
}

impl Object {
    fn new(config: &ObjectConfig, index: usize, world: &WorldConfig) -> Result<Object, Invalid> {
        let rubber = &world.finger.rubber;
        let place = format!("object[{index}]");
        let shape = match config.kind {
            ObjectKind::Sphere => Shape::Ball(Box::new(Ball::new(config, rubber, &place)?)),
            ObjectKind::Edge => {
                Shape::Ridge(Box::new(Ridge::new(config, rubber, level_of(world), &place)?))
            }
            ObjectKind::Bar => Shape::Face(Box::new(Face::new(config, rubber, &place)?)),
        };
        let [yaw, x, y] =
            [config.yaw_deg, config.tilt_x_deg, -config.tilt_y_deg].map(f64::to_radians);
        Ok(Object {
            shape,
            place: DVec3::ZERO,
            axes: rotation_z(yaw) * rotation_x(x) * rotation_y(y),
            friction: config.friction.unwrap_or(world.finger.friction),
            relaxation_s: 1e-3 * rubber.relaxation_ms,
            small_m: 1e-3 * SMALL * rubber.thickness_mm,
            grip: Grip::default(),
            sums: Sums::default(),
            slip_m_s: 0.0,
            force: DVec3::ZERO,
            moment: DVec3::ZERO,
            drag: DVec2::ZERO,
        })
    }

    /// The object from the pad.
    fn meeting(&self, around: &Around, h: f64) -> Meeting {
        let (table, axes) = (&around.table, &around.table_axes);
        let back = around.pad.rotation.transpose();
        let origin = around.pad.translation;
        let material = table.velocity + table.spin.cross(origin - table.origin);
        Meeting {
            place: back * (table.origin + *axes * self.place - origin),
            turn: back * (*axes * self.axes),
            velocity: back * (around.finger.velocity - material),
            spin: back * (around.finger.spin - table.spin),
            h,
        }
    }

    /// Evaluates the contact and moves its bristles on by `h` seconds.
    fn touch(&mut self, around: &Around, h: f64) {
        let meeting = self.meeting(around, h);
        self.sums = match &mut self.shape {
            Shape::Ball(ball) => ball.press(&meeting, self.relaxation_s),
            Shape::Ridge(ridge) => ridge.press(&meeting, self.relaxation_s),
            Shape::Face(face) => face.press(&meeting, self.relaxation_s),
        };
        let Some(middle) = self.sums.middle() else {
            self.grip = Grip::default();
            (self.force, self.moment) = (DVec3::ZERO, DVec3::ZERO);
            (self.drag, self.slip_m_s) = (DVec2::ZERO, 0.0);
            return;
        };
        let pull = self.rub(&meeting, middle);
        let load = self.sums.load_n;
        self.force = DVec3::new(pull.x, pull.y, -load);
        self.moment = DVec3::new(
            -self.sums.lever_nm.y,
            self.sums.lever_nm.x,
            middle.x * pull.y - middle.y * pull.x,
        );
    }

    /// Tangential force on the finger (N).
    fn rub(&mut self, meeting: &Meeting, middle: DVec2) -> DVec2 {
        let (sums, grip) = (&self.sums, &mut self.grip);
        if sums.shear_n_m > grip.shear_n_m {
            grip.brush *= grip.shear_n_m / sums.shear_n_m;
        }
        grip.shear_n_m = sums.shear_n_m;
        let turn = meeting.spin.z;
        let creep = meeting.velocity.truncate() + turn * DVec2::new(-middle.y, middle.x);
        let half = sums.half_width_m.max(HALF_WIDTH_MIN_M);
        let (h, damping) = (meeting.h, self.relaxation_s);
        let keep = half / (half + h * sums.travel_m_s.abs());
        grip.brush = (grip.brush + h * creep) * keep;
        let force = -grip.shear_n_m * (grip.brush + damping * creep);
        let weight = grip.shear_n_m * (h * keep + damping);
        let (limit, size) = (self.friction * sums.load_n, force.length());
        if size <= limit {
            (self.drag, self.slip_m_s) = (DVec2::splat(weight), 0.0);
            return force;
        }
        let scale = limit / size;
        grip.brush += (1.0 - scale) * yields_m_n(grip.shear_n_m, weight, damping) * force;
        // Only the direction of a sliding force depends on the motion.
        let turns = |f: f64| weight * scale * (1.0 - f * f / (size * size));
        self.drag = DVec2::new(turns(force.x), turns(force.y));
        self.slip_m_s = creep.length();
        scale * force
    }

    fn lie(&self, around: &Around) -> Lie {
        let meeting = self.meeting(around, 0.0);
        match &self.shape {
            Shape::Ball(_) => Lie::default(),
            Shape::Ridge(ridge) => ridge.lie(&meeting),
            Shape::Face(face) => face.lie(&meeting),
        }
    }

    /// Calls with a weight (N s/m, N m s/rad) and a row over the pad's twist in its own axes, for
    /// every direction in which the forces resist motion.
    fn tangent(&self, mut of: impl FnMut(f64, [f64; 6])) {
        let Some(middle) = self.sums.middle() else { return };
        let [w, wx, wy, wxx, wxy, wyy] = self.sums.weights;
        if w > 0.0 {
            let (x, y) = (wx / w, wy / w);
            let [cxx, cxy, cyy] = [wxx - wx * x, wxy - wx * y, wyy - wy * y];
            of(w, [0.0, 0.0, 1.0, y, -x, 0.0]);
            if cyy > 0.0 {
                of(cyy, [0.0, 0.0, 0.0, 1.0, -cxy / cyy, 0.0]);
                of((cxx - cxy * cxy / cyy).max(0.0), [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
            } else {
                of(cxx.max(0.0), [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
            }
        }
        of(self.drag.x, [1.0, 0.0, 0.0, 0.0, 0.0, -middle.y]);
        of(self.drag.y, [0.0, 1.0, 0.0, 0.0, 0.0, middle.x]);
    }
}

/// All objects of a scene that has some.
#[derive(Clone, Debug)]
pub(crate) struct Objects {
    all: Vec<Object>,
    /// What tactels see of loads, for shapes that are made of them.
    shares: Option<Shares>,
    stresses_mpa: [f64; MAX_TACTELS],
}

impl Objects {
    /// Solves the contacts and puts the objects on the table; none for a scene without. `finger` is
    /// the finger's start.
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
            // Over that place on the surface, by its height along the normal.
            let z = o.z - (n.x * (x - o.x) + n.y * (y - o.y)) / n.z;
            let top = DVec3::new(x, y, z) + 1e-3 * one.top_mm * n;
            object.place = axes.transpose() * (top - o);
            all.push(object);
        }
        let shares = match all.iter().all(|object| matches!(object.shape, Shape::Ball(_))) {
            true => None,
            false => Some(shares_of(&config.finger.rubber)?),
        };
        Ok(Some(Box::new(Objects { all, shares, stresses_mpa: [0.0; MAX_TACTELS] })))
    }

    pub(crate) fn memory(&self) -> Grips {
        let mut grips = Grips::default();
        for (grip, object) in grips.iter_mut().zip(&self.all) {
            *grip = object.grip;
        }
        grips
    }

    pub(crate) fn remember(&mut self, grips: &Grips) {
        for (object, grip) in self.all.iter_mut().zip(grips) {
            object.grip = *grip;
        }
    }

    /// Evaluates every contact and moves the bristles on by `h` seconds.
    pub(crate) fn touch(&mut self, around: &Around, h: f64) {
        for object in &mut self.all {
            object.touch(around, h);
        }
    }

    /// What resists the finger's motion, three numbers an object: along its normal and against
    /// sliding (N s/m).
    pub(crate) fn holds(&self, into: &mut [f64]) {
        for (three, object) in into.chunks_exact_mut(3).zip(&self.all) {
            if object.sums.middle().is_some() {
                three.copy_from_slice(&[object.sums.weights[0], object.drag.x, object.drag.y]);
            }
        }
    }

    /// Whether one is to be solved in three dimensions.
    pub(crate) fn asked(&self) -> bool {
        self.all.iter().any(|one| matches!(&one.shape, Shape::Ridge(ridge) if ridge.asked))
    }

    /// Which objects touch, as bits.
    pub(crate) fn touched(&self) -> u8 {
        let bit = |(i, object): (usize, &Object)| u8::from(object.sums.load_n > 0.0) << i;
        self.all.iter().enumerate().map(bit).sum()
    }

    /// Sum of the normal forces (N).
    pub(crate) fn normal_n(&self) -> f64 {
        self.all.iter().map(|object| object.sums.load_n).sum()
    }

    /// Whether one is pressed in deeper than the theory covers.
    pub(crate) fn beyond_small_strain(&self) -> bool {
        self.too_deep().is_some()
    }

    /// The first one that is, and how deep it is pressed in (m).
    pub(crate) fn too_deep(&self) -> Option<(usize, f64)> {
        let deep = |object: &Object| object.sums.deepest_m > object.small_m;
        self.all.iter().position(deep).map(|i| (i, self.all[i].sums.deepest_m))
    }

    /// Wrench on the finger about the pad's middle, base axes.
    pub(crate) fn wrench(&self, pad: &Pose) -> Joints {
        let (mut force, mut moment) = (DVec3::ZERO, DVec3::ZERO);
        for object in &self.all {
            force += object.force;
            moment += object.moment;
        }
        spatial_vector(pad.rotation * force, pad.rotation * moment)
    }

    /// Calls with a weight and a row over the finger's speeds, see [`Object::tangent`];
    /// `jacobian` gives the twist of the pad in base axes.
    pub(crate) fn tangent(&self, pad: &Pose, jacobian: &Matrix6, mut of: impl FnMut(f64, Joints)) {
        for object in &self.all {
            object.tangent(|weight, row| {
                let linear = pad.rotation * DVec3::new(row[0], row[1], row[2]);
                let angular = pad.rotation * DVec3::new(row[3], row[4], row[5]);
                of(weight, jacobian.tr_mul(&spatial_vector(linear, angular)));
            });
        }
    }

    /// Adds the normal force on each tactel (N) at the latest evaluation; how many of the contacts
    /// were solved in three dimensions where that is asked for.
    pub(crate) fn image(&mut self, forces: &mut [f64; MAX_TACTELS]) -> Tally {
        let (area_mm2, mut all) = (1e6 * PITCH_M * PITCH_M, Tally::default());
        for object in &mut self.all {
            if object.sums.load_n <= 0.0 {
                // Here and not where it is pressed: an iterate that lifts off is no step.
                if let Shape::Ridge(ridge) = &mut object.shape {
                    ridge.lean = Lean::NONE;
                }
                continue;
            }
            let image = &mut self.stresses_mpa;
            *image = [0.0; MAX_TACTELS];
            match (&mut object.shape, &self.shares) {
                (Shape::Ball(ball), _) => ball.image(image),
                (Shape::Ridge(ridge), Some(shares)) => all.add(ridge.image(shares, image)),
                (Shape::Face(face), Some(shares)) => face.image(shares, image),
                (Shape::Ridge(_) | Shape::Face(_), None) => {}
            }
            for (force, stress) in forces.iter_mut().zip(image.iter()) {
                *force -= area_mm2 * stress;
            }
        }
        all
    }

    /// The object that presses most, or the first one: with how it lies.
    pub(crate) fn felt(&self, around: &Around) -> Option<(&Object, Lie)> {
        let mut most = self.all.first()?;
        for object in &self.all {
            if object.sums.load_n > most.sums.load_n {
                most = object;
            }
        }
        Some((most, most.lie(around)))
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        for object in &self.all {
            let grip = &object.grip;
            if let Shape::Ridge(ridge) = &object.shape {
                hash.numbers(&[ridge.lean.0, ridge.lean.1]);
            }
            hash.numbers(&[grip.brush.x, grip.brush.y, grip.shear_n_m, object.sums.load_n]);
        }
    }
}

/// How finely edges are solved in three dimensions, if they are.
fn level_of(world: &WorldConfig) -> Option<Accuracy> {
    match world.fidelity.contact {
        ContactModel::Layer3d => Some(Accuracy::Fast),
        ContactModel::Layer3dFine => Some(Accuracy::Default),
        ContactModel::Line | ContactModel::Layer2d => None,
    }
}

/// Where complaints about the pad's rubber belong.
const RUBBER: &str = "finger.rubber";

fn layer_of(config: &RubberConfig) -> Result<Layer, Invalid> {
    rubber::layer(config).map_err(rubber::located(RUBBER))
}

/// What tactels see of point loads on the pad; allocates and takes its time.
fn shares_of(config: &RubberConfig) -> Result<Shares, Invalid> {
    let located = rubber::located(RUBBER);
    let influence = Influence::new(&layer_of(config)?).map_err(&located)?;
    Shares::new(&influence, &Array::THESIS, Sampling::Area, Fineness::FAST).map_err(&located)
}
