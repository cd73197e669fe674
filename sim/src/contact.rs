//! Line contact between the pin and a flat rubber surface, in slices along the pin's axis: normal
//! load with Kelvin-Voigt damping that never pulls, and per slice a brush against tangential
//! motion. Rolling, slip, yaw torque and tilting moments are what comes out of it; none of them is
//! written anywhere. Refuses pins that stand on end (axis within 11.5 deg of the normal).
//!
//! Brush (Kalker's simplified theory in its one-point form): bristles enter the contact unstressed
//! at its leading edge and are carried through its width `2b`, so their mean deflection `xi` obeys
//! `d xi/dt = v - (u / b) xi`, with `v` the velocity of the pin's surface over the rubber and `u`
//! the speed at which the contact line travels over it. Growing contact adds unstressed bristles
//! (the force stays, `xi` shrinks); the force is returned to Coulomb's cone when it leaves it.

use glam::DVec3;
use taktil_mechanics::spatial::split;
use taktil_mechanics::{Joints, Pose};

use crate::hash::Hash;
use crate::pin::Pin;
use crate::rubber::{Response, Rubber};

/// Slices of either contact; on the finger they are the tactile array's rows.
pub const SLICES: usize = 16;
/// Tactel pitch (m).
pub const PITCH_M: f64 = 1.5875e-3;
/// Half the tactile pad's side (m): 16 tactels, 25.4 mm.
pub const PAD_HALF_M: f64 = 0.5 * SLICES as f64 * PITCH_M;

/// Over this distance the load fades out as the contact line leaves the pad (m).
const EDGE_M: f64 = 0.5e-3;
/// Smallest sine between axis and normal for which there is a contact line.
const SINE_MIN: f64 = 0.2;
/// Narrowest contact through which bristles travel (m).
const HALF_WIDTH_MIN_M: f64 = 1e-9;
/// Spin at which rolling resistance has come up fully (rad/s).
const ROLLING_SPIN_RAD_S: f64 = 0.1;

/// A plane of rubber that moves as a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// A point of the undeformed surface (m, base frame).
    pub origin: DVec3,
    /// Unit normal out of the rubber.
    pub normal: DVec3,
    /// Velocity of the material at the origin (m/s).
    pub velocity: DVec3,
    /// Angular velocity (rad/s).
    pub spin: DVec3,
}

impl Surface {
    /// The face of a pad with a frame and a twist of its origin.
    pub(crate) fn of_pad(pose: &Pose, twist: &Joints) -> Surface {
        let (velocity, spin) = split(twist);
        Surface { origin: pose.translation, normal: pose.rotation.z_axis, velocity, spin }
    }
}

/// The pin's generatrix nearest to a surface and everything that varies linearly along it: pairs of
/// (value at s = 0, change per metre of s), s along the pin's axis from its centre.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    /// The generatrix at s = 0 (m).
    pub(crate) foot: DVec3,
    /// From the pin's centre to there (m).
    pub(crate) radius: DVec3,
    pub(crate) axis: DVec3,
    pub(crate) normal: DVec3,
    /// Rolling direction in the surface.
    pub(crate) across: DVec3,
    /// The axis laid into the surface.
    pub(crate) along: DVec3,
    height: (f64, f64),
    closing: (f64, f64),
    creep_across: (f64, f64),
    creep_along: (f64, f64),
    travel: (f64, f64),
    /// Spin of the pin over the surface about `along` (rad/s).
    roll: f64,
}

impl Line {
    pub(crate) fn between(pin: &Pin, axis: DVec3, surface: &Surface) -> Option<Line> {
        let normal = surface.normal;
        let dip = axis.dot(normal);
        let sine2 = 1.0 - dip * dip;
        if sine2 < SINE_MIN * SINE_MIN {
            return None;
        }
        let inverse = 1.0 / sine2.sqrt();
        let along = (axis - dip * normal) * inverse;
        let across = along.cross(normal);
        let radius = (dip * axis - normal) * (inverse * pin.radius_m);
        let foot = pin.position + radius;
        let lever = foot - surface.origin;
        let rubber = surface.velocity + surface.spin.cross(lever);
        let relative = pin.velocity + pin.spin.cross(radius) - rubber;
        let slope = (pin.spin - surface.spin).cross(axis);
        // The line follows the pin's axis and, when the surface turns, walks round the pin.
        let walk = pin.velocity - rubber - pin.radius_m * surface.spin.cross(normal);
        Some(Line {
            foot,
            radius,
            axis,
            normal,
            across,
            along,
            height: (lever.dot(normal), dip),
            closing: (-relative.dot(normal), -slope.dot(normal)),
            creep_across: (relative.dot(across), slope.dot(across)),
            creep_along: (relative.dot(along), slope.dot(along)),
            travel: (walk.dot(across), slope.dot(across)),
            roll: (pin.spin - surface.spin).dot(along),
        })
    }
}

impl Line {
    /// Height of the generatrix over the surface at s = 0 (m) and its change per metre of s.
    pub(crate) fn height(&self) -> (f64, f64) {
        self.height
    }
}

fn linear(pair: (f64, f64), s: f64) -> f64 {
    pair.0 + pair.1 * s
}

/// Where a slice lies along the pin and how much of it there is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Strip {
    /// Middle, along the pin's axis (m).
    pub(crate) s_m: f64,
    /// Width, along the pin's axis (m).
    pub(crate) width_m: f64,
    /// Part that is there: 0 off the pad or off the pin, 1 wholly on both.
    pub(crate) cover: f64,
    /// On the pad: where the contact line crosses the row, along the sensor's x (m).
    pub(crate) x_m: f64,
}

/// Slices over the whole length of a pin: places and widths of Gauss's rule of eight points, which
/// has all moments of a smooth load up to the fifteenth; the slices behind them are none.
pub(crate) fn strips_of_pin(length_m: f64) -> [Strip; SLICES] {
    const HALF_RULE: [(f64, f64); 4] = [
        (0.183_434_642_495_649_8, 0.362_683_783_378_362),
        (0.525_532_409_916_329, 0.313_706_645_877_887_3),
        (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
        (0.960_289_856_497_536_2, 0.101_228_536_290_376_3),
    ];
    let mut strips = [Strip::default(); SLICES];
    let half_m = 0.5 * length_m;
    for (i, (place, weight)) in HALF_RULE.into_iter().enumerate() {
        for (at, sign) in [(4 + i, 1.0), (3 - i, -1.0)] {
            strips[at] = Strip {
                s_m: sign * place * half_m,
                width_m: weight * half_m,
                cover: 1.0,
                x_m: 0.0,
            };
        }
    }
    strips
}

/// Middle of a tactel row or column (m) from the pad's centre.
pub(crate) fn tactel_middle_m(index: usize) -> f64 {
    (index as f64 - 0.5 * (SLICES - 1) as f64) * PITCH_M
}

/// Slices at the pad's rows. A pin across the rows has none, and neither has one whose middle is
/// behind the face: the plane of the face goes on for ever, the finger does not.
pub(crate) fn strips_of_pad(line: &Line, pad: &Pose, pin_length_m: f64) -> [Strip; SLICES] {
    let mut strips = [Strip::default(); SLICES];
    let (x_axis, y_axis) = (pad.rotation.x_axis, pad.rotation.y_axis);
    let per_row = line.axis.dot(y_axis);
    if per_row.abs() < SINE_MIN {
        return strips;
    }
    let lever = line.foot - pad.translation;
    let (x0, y0) = (lever.dot(x_axis), lever.dot(y_axis));
    let (per_y, dx) = (1.0 / per_row, line.axis.dot(x_axis));
    let width_m = PITCH_M * per_y.abs();
    let (per_width, half) = (1.0 / width_m, 0.5 * pin_length_m);
    let behind_m = -line.radius.length();
    for (row, strip) in strips.iter_mut().enumerate() {
        let s_m = (tactel_middle_m(row) - y0) * per_y;
        let x_m = x0 + s_m * dx;
        let on_pin = ((half - s_m.abs()) * per_width + 0.5).clamp(0.0, 1.0);
        let on_pad = ((PAD_HALF_M - x_m.abs()) * (1.0 / EDGE_M)).clamp(0.0, 1.0);
        let before = linear(line.height, s_m) > behind_m;
        let cover = if before { on_pin * on_pad } else { 0.0 };
        *strip = Strip { s_m, width_m, cover, x_m };
    }
    strips
}

/// One slice's memory and its latest forces.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Slice {
    /// Mean deflection of the bristles, across and along (m).
    pub(crate) brush: (f64, f64),
    /// Their stiffness (N/m).
    pub(crate) shear_n_m: f64,
    /// Normal force (N).
    pub(crate) load_n: f64,
    /// Penetration (m).
    pub(crate) delta_m: f64,
    /// Where it was.
    pub(crate) strip: Strip,
}

/// What a contact does to the pin; the surface feels the opposite.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Reaction {
    /// Force on the pin (N).
    pub(crate) force: DVec3,
    /// Moment on the pin about its centre (N m).
    pub(crate) moment: DVec3,
    /// Sum of the normal forces (N).
    pub(crate) normal_n: f64,
    /// Tangential force on the pin across and along its axis (N).
    pub(crate) tangential_n: (f64, f64),
    /// Fastest motion of a slice that slides (m/s), 0 when all stick.
    pub(crate) slip_m_s: f64,
    /// Motion of the pin's surface over the rubber at the pin's middle, across and along (m/s).
    pub(crate) creep_m_s: (f64, f64),
    /// Speed at which the contact line travels over the rubber there (m/s).
    pub(crate) travel_m_s: f64,
}

impl Reaction {
    /// The moment about another point (N m).
    pub(crate) fn moment_about(&self, point: DVec3, pin_centre: DVec3) -> DVec3 {
        self.moment + (pin_centre - point).cross(self.force)
    }
}

/// The contact of the pin with one rubber.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    pub(crate) rubber: Rubber,
    friction: f64,
    rolling_m: f64,
    /// What the rows carry over their plane solutions.
    pub(crate) lean: Lean,
    pub(crate) slices: [Slice; SLICES],
}

/// A factor that varies linearly along the pin's axis: at its middle and per metre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lean(pub(crate) f64, pub(crate) f64);

impl Lean {
    /// Rows on their own.
    pub(crate) const NONE: Lean = Lean(1.0, 0.0);

    pub(crate) fn at(self, s_m: f64) -> f64 {
        (self.0 + self.1 * s_m).max(0.0)
    }
}

/// How a reaction depends on the motion that a step ends with: per direction (normal, across,
/// along) the sums over the slices of w, w s and w s^2, w being the force per speed of approach
/// (N s/m) and s the place along the axis (m); and the moment per spin of rolling (N m s/rad).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Tangent {
    pub(crate) weights: [[f64; 3]; 3],
    pub(crate) rolling: f64,
}

/// What the bristles of one slice obey.
struct Grip {
    half_width_m: f64,
    relaxation_s: f64,
    friction: f64,
}

/// Sums over the slices: force and first moment along the axis, each as (normal, across, along).
#[derive(Default)]
struct Sums {
    force: [f64; 3],
    lever: [f64; 3],
    slip_m_s: f64,
    tangent: Tangent,
}

impl Sums {
    fn add(&mut self, s_m: f64, force: [f64; 3], weights: [f64; 3]) {
        for i in 0..3 {
            self.force[i] += force[i];
            self.lever[i] += s_m * force[i];
            let row = &mut self.tangent.weights[i];
            row[0] += weights[i];
            row[1] += s_m * weights[i];
            row[2] += s_m * s_m * weights[i];
        }
    }
}

impl Patch {
    pub(crate) fn new(rubber: Rubber, friction: f64, rolling_m: f64) -> Patch {
        let lean = Lean::NONE;
        Patch { rubber, friction, rolling_m, lean, slices: [Slice::default(); SLICES] }
    }

    /// Nothing touches: bristles spring back.
    pub(crate) fn release(&mut self) -> Reaction {
        self.slices = [Slice::default(); SLICES];
        Reaction::default()
    }

    /// Moves the bristles on by `h` seconds and returns the forces, and how they depend on the
    /// motion if `line` is that of the step's end. With `h` = 0 only the forces.
    pub(crate) fn act(
        &mut self,
        line: &Line,
        strips: &[Strip; SLICES],
        h: f64,
    ) -> (Reaction, Tangent) {
        let mut sums = Sums::default();
        for (slice, strip) in self.slices.iter_mut().zip(strips) {
            if strip.width_m <= 0.0 {
                // A slice that there is not keeps nothing.
                *slice = Slice::default();
                continue;
            }
            let delta_m = -linear(line.height, strip.s_m);
            if delta_m <= 0.0 || strip.cover <= 0.0 {
                *slice = Slice { strip: *strip, ..Slice::default() };
                continue;
            }
            slice.strip = *strip;
            let response = self.rubber.at(delta_m);
            slice.delta_m = delta_m;
            let lean = self.lean.at(strip.s_m);
            let w_n = slice.press(&response, lean, self.rubber.relaxation_s, line, h);
            let grip = Grip {
                half_width_m: response.half_width_m.max(HALF_WIDTH_MIN_M),
                relaxation_s: self.rubber.relaxation_s,
                friction: self.friction,
            };
            let (force, weights, slip_m_s) = slice.shear(&grip, line, h);
            sums.slip_m_s = sums.slip_m_s.max(slip_m_s);
            let force = [slice.load_n, force.0, force.1];
            sums.add(strip.s_m, force, [w_n, weights.0, weights.1]);
        }
        let [normal, across, along] = sums.force;
        let turning = (line.roll / ROLLING_SPIN_RAD_S).clamp(-1.0, 1.0);
        let most = self.rolling_m * normal;
        if turning.abs() < 1.0 {
            sums.tangent.rolling = most / ROLLING_SPIN_RAD_S;
        }
        let frame = |v: [f64; 3]| v[0] * line.normal + v[1] * line.across + v[2] * line.along;
        let force = frame(sums.force);
        let moment = line.radius.cross(force) + line.axis.cross(frame(sums.lever));
        let reaction = Reaction {
            force,
            moment: moment - most * turning * line.along,
            normal_n: normal,
            tangential_n: (across, along),
            slip_m_s: sums.slip_m_s,
            creep_m_s: (line.creep_across.0, line.creep_along.0),
            travel_m_s: line.travel.0,
        };
        (reaction, sums.tangent)
    }

    /// Energy in the rubber and its bristles (J).
    pub(crate) fn stored_j(&self) -> f64 {
        let slice_j = |slice: &Slice| {
            let strip = &slice.strip;
            let length_m = strip.width_m * strip.cover * self.lean.at(strip.s_m);
            let (x, y) = slice.brush;
            self.rubber.stored_j_m(slice.delta_m) * length_m
                + 0.5 * slice.shear_n_m * (x * x + y * y)
        };
        self.slices.iter().map(slice_j).sum()
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        for slice in &self.slices {
            hash.numbers(&[slice.brush.0, slice.brush.1, slice.shear_n_m, slice.load_n]);
        }
    }
}

impl Slice {
    /// Normal load and the stiffness of the bristles at a penetration, `lean` times what the table
    /// says; returns the load's change per speed of approach over a step of `h`.
    fn press(
        &mut self,
        response: &Response,
        lean: f64,
        relaxation_s: f64,
        line: &Line,
        h: f64,
    ) -> f64 {
        let length_m = self.strip.width_m * self.strip.cover * lean;
        let rate = linear(line.closing, self.strip.s_m);
        let damping_n_m = response.stiffness_n_m2 * relaxation_s * rate;
        let load_n = (response.load_n_m + damping_n_m) * length_m;
        self.load_n = load_n.max(0.0);
        let shear_n_m = response.shear_n_m2 * length_m;
        if shear_n_m > self.shear_n_m {
            let kept = self.shear_n_m / shear_n_m;
            self.brush = (self.brush.0 * kept, self.brush.1 * kept);
        }
        self.shear_n_m = shear_n_m;
        if load_n > 0.0 { response.stiffness_n_m2 * length_m * (h + relaxation_s) } else { 0.0 }
    }

    /// Tangential force of the bristles (across, along), its change per speed, the speed of sliding
    /// (0 when it sticks).
    fn shear(&mut self, grip: &Grip, line: &Line, h: f64) -> ((f64, f64), (f64, f64), f64) {
        let s = self.strip.s_m;
        let creep = (linear(line.creep_across, s), linear(line.creep_along, s));
        let travel = linear(line.travel, s).abs();
        let keep = grip.half_width_m / (grip.half_width_m + h * travel);
        self.brush = ((self.brush.0 + h * creep.0) * keep, (self.brush.1 + h * creep.1) * keep);
        let damping = grip.relaxation_s;
        let force = (
            -self.shear_n_m * (self.brush.0 + damping * creep.0),
            -self.shear_n_m * (self.brush.1 + damping * creep.1),
        );
        let weight = self.shear_n_m * (h * keep + damping);
        let limit = grip.friction * self.load_n;
        let size2 = force.0 * force.0 + force.1 * force.1;
        if size2 <= limit * limit {
            return (force, (weight, weight), 0.0);
        }
        let scale = limit / size2.sqrt();
        let slid = (force.0 * scale, force.1 * scale);
        let per_force = if self.shear_n_m > 0.0 { -1.0 / self.shear_n_m } else { 0.0 };
        self.brush = (slid.0 * per_force, slid.1 * per_force);
        let speed2 = creep.0 * creep.0 + creep.1 * creep.1;
        // Only the direction of a sliding force depends on the motion.
        let part = weight * scale;
        let turns = |f: f64| part * (1.0 - f * f / size2);
        (slid, (turns(force.0), turns(force.1)), speed2.sqrt())
    }
}
