//! Combines one rigid indenter with a layer, an array and an accuracy, chooses the solver that fits
//! the shape, presses the indenter and computes its image.
//!
//! The tables are made for penetrations near the first one prescribed. A deeper contact replaces
//! them by deeper ones, which allocates. Errors name the fields of the indenter.

mod cut;
mod rates;
mod room;

use super::super::layer::Layer;
use super::super::{Invalid, finite, positive};
use super::infinite::InfiniteIndenter;
use super::pin::{Pin, PlanarPose, Profile, TILT_MAX_RAD};
use super::radial::Influence;
use super::sphere::Sphere;
use super::tactels::{Array, Fineness, Sampling, Shares};
use super::{Accuracy, Prescribed, Refusal, Why};

/// Length of an infinite edge beyond the array, in thicknesses.
const EDGE_OVERHANG: f64 = 24.0;

/// Part of the force below which a tactel's share is only the rounding error of sums that cancel.
const ROUNDING_PART: f64 = 1e-13;

/// A rigid indenter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A sphere; its penetration is that of the lowest point.
    Sphere {
        /// Radius, mm.
        radius_mm: f64,
    },
    /// A cylinder with flat ends; its penetration is that of the lowest line at the middle.
    Cylinder {
        /// Radius, mm.
        radius_mm: f64,
        /// Length, mm; absent without ends. A tilted one without ends is cut at the array.
        length_mm: Option<f64>,
    },
    /// A knife edge: an even line load. It has no penetration: a line sinks without end.
    Edge {
        /// Length, mm; absent without ends.
        length_mm: Option<f64>,
    },
    /// A bar with a flat face.
    Bar {
        /// Width of the face, mm.
        width_mm: f64,
        /// Length, mm; absent without ends. A tilted one without ends is cut at the array.
        length_mm: Option<f64>,
    },
}

/// Place, direction and slope of the indenter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Place and direction over the array.
    pub planar: PlanarPose,
    /// Slope of the axis, rad: a positive one makes the indenter deeper towards its second end.
    pub tilt_rad: f64,
}

/// Force and penetration of a contact, and how well they were solved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SceneState {
    /// Normal force, N; N per mm for indenters without ends.
    pub force_n: f64,
    /// Penetration, mm; absent for an edge.
    pub penetration_mm: Option<f64>,
    /// Relative residual; its meaning is that of the solver of the shape.
    pub residual: f64,
}

/// The solver behind a scene.
#[derive(Clone, Debug)]
enum Solver {
    Empty,
    Sphere(Box<Sphere>),
    Infinite(Box<InfiniteIndenter>),
    Pin(Box<Pin>),
}

/// An indenter, a layer and an array.
#[derive(Clone, Debug)]
pub struct Scene {
    layer: Layer,
    shape: Shape,
    sampling: Sampling,
    level: Accuracy,
    array: Array,
    /// Whether the layer ends with the array, so that a cylinder or bar is cut there.
    is_cut: bool,
    /// Ends that stay fixed to the indenter when it moves, instead of being cut by the array.
    held_ends: Option<[f64; 2]>,
    shares: Option<Shares>,
    solver: Solver,
    /// Largest penetration and the ends for which the solver's tables were made.
    room: (f64, [f64; 2]),
    pose: Pose,
    state: SceneState,
}

impl Scene {
    /// Makes a scene and tabulates the shares of the array; allocates.
    ///
    /// # Errors
    /// An invalid layer, array or size of the shape.
    pub fn new(
        layer: &Layer,
        shape: Shape,
        array: &Array,
        sampling: Sampling,
        level: Accuracy,
    ) -> Result<Self, Invalid> {
        layer.check()?;
        array.check()?;
        let length = |length: Option<f64>| length.map_or(Ok(()), |l| positive("length_mm", l));
        let solver = match shape {
            Shape::Sphere { radius_mm } => {
                Solver::Sphere(Box::new(Sphere::new(layer, radius_mm, level)?))
            }
            Shape::Cylinder { radius_mm, length_mm } => {
                positive("radius_mm", radius_mm)?;
                length(length_mm)?;
                Solver::Empty
            }
            Shape::Bar { width_mm, length_mm } => {
                positive("width_mm", width_mm)?;
                length(length_mm)?;
                Solver::Empty
            }
            Shape::Edge { length_mm } => {
                length(length_mm)?;
                Solver::Empty
            }
        };
        let fineness = match level {
            Accuracy::Fast => Fineness::FAST,
            Accuracy::Default => Fineness::DEFAULT,
            Accuracy::Fine => Fineness::FINE,
        };
        let direct = matches!(shape, Shape::Sphere { .. });
        let shares = if direct {
            None
        } else {
            Some(Shares::new(&Influence::new(layer)?, array, sampling, fineness)?)
        };
        Ok(Self {
            layer: *layer,
            shape,
            sampling,
            level,
            array: *array,
            is_cut: false,
            held_ends: None,
            shares,
            solver,
            room: (0.0, [0.0; 2]),
            pose: Pose::default(),
            state: SceneState::default(),
        })
    }

    /// The scene over a pad that ends with the array: a cylinder or bar presses only with the part
    /// of its axis that is over the pad, as if it were cut there. The free edges of the pad are
    /// neglected. A sphere and an edge are not cut. A contact that hangs over the side of the pad
    /// with a part of its width is an error.
    #[must_use]
    pub fn cut_at_array(self) -> Self {
        Self { is_cut: true, ..self }
    }

    /// The array.
    #[must_use]
    pub fn array(&self) -> &Array {
        &self.array
    }

    /// Lifts the indenter off and forgets the contact; the tables stay.
    pub fn release(&mut self) {
        self.state = SceneState::default();
        match &mut self.solver {
            Solver::Empty => {}
            Solver::Sphere(sphere) => sphere.release(),
            Solver::Infinite(cylinder) => cylinder.release(),
            Solver::Pin(pin) => pin.release(),
        }
    }

    /// The indenter.
    #[must_use]
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// Presses the indenter; [`Scene::image`] then shows this contact. It allocates only when a
    /// contact needs deeper tables than all contacts before.
    ///
    /// # Errors
    /// The errors of the solver of the shape; a tilt of an edge; a penetration of an edge.
    pub fn press(&mut self, prescribed: Prescribed, pose: Pose) -> Result<SceneState, Invalid> {
        for (place, value) in [("x_mm", pose.planar.x_mm), ("y_mm", pose.planar.y_mm)] {
            finite(place, value)?;
        }
        finite("rot_rad", pose.planar.rot_rad)?;
        finite("tilt_rad", pose.tilt_rad)?;
        self.pose = pose;
        self.state = SceneState::default();
        self.state = match self.shape {
            Shape::Sphere { .. } => self.press_sphere(prescribed)?,
            Shape::Edge { .. } => self.press_edge(prescribed)?,
            Shape::Cylinder { length_mm: None, .. } | Shape::Bar { length_mm: None, .. }
                if pose.tilt_rad == 0.0 =>
            {
                self.press_infinite(prescribed)?
            }
            Shape::Cylinder { .. } | Shape::Bar { .. } => self.press_pin(prescribed)?,
        };
        Ok(self.state)
    }

    fn press_sphere(&mut self, prescribed: Prescribed) -> Result<SceneState, Invalid> {
        let Solver::Sphere(sphere) = &mut self.solver else { return Ok(SceneState::default()) };
        let state = sphere.press(prescribed)?;
        Ok(SceneState {
            force_n: state.force_n,
            penetration_mm: Some(
                penetration_without_contact(prescribed).unwrap_or(state.penetration_mm),
            ),
            residual: state.residual,
        })
    }

    fn press_edge(&mut self, prescribed: Prescribed) -> Result<SceneState, Invalid> {
        if self.pose.tilt_rad != 0.0 {
            let what = format!("{} rad for a line load", self.pose.tilt_rad);
            return Err(Invalid::new("tilt_rad", what, "an edge lies flat: give 0"));
        }
        let Prescribed::ForceN(force) = prescribed else {
            let what = "the penetration of a line load is infinite".to_owned();
            return Err(Invalid::new("penetration_mm", what, "give `force_n` for an edge"));
        };
        prescribed.check(self.layer.thickness_mm)?;
        Ok(SceneState { force_n: force, penetration_mm: None, residual: 0.0 })
    }

    fn press_infinite(&mut self, prescribed: Prescribed) -> Result<SceneState, Invalid> {
        let first = match prescribed {
            Prescribed::PenetrationMm(delta) => room::DEPTH_FACTOR * delta,
            Prescribed::ForceN(_) => 0.1 * self.layer.thickness_mm,
        };
        prescribed.check(self.layer.thickness_mm)?;
        let (layer, profile) = (self.layer, self.profile());
        self.press_with_tables(prescribed, first, [0.0; 2], |solver, most, fresh| {
            if fresh {
                let made = InfiniteIndenter::new(&layer, profile, most)?;
                *solver = Solver::Infinite(Box::new(made));
            }
            let Solver::Infinite(indenter) = solver else { return Ok(SceneState::default()) };
            let state = indenter.press(prescribed)?;
            Ok(SceneState {
                force_n: state.force_n_mm,
                penetration_mm: Some(
                    penetration_without_contact(prescribed).unwrap_or(state.penetration_mm),
                ),
                residual: state.residual,
            })
        })
    }

    fn press_pin(&mut self, prescribed: Prescribed) -> Result<SceneState, Invalid> {
        let tilt = self.pose.tilt_rad;
        let profile = self.profile();
        let ends = self.ends();
        let target = prescribed.check(self.layer.thickness_mm)?;
        // The width of a bar is known before it is solved; a cylinder is checked afterwards.
        if matches!(self.shape, Shape::Bar { .. }) && (target > 0.0 || tilt != 0.0) {
            self.check_overhang(ends, self.half_overlap_mm(0.0))?;
        }
        if ends[0] >= ends[1] {
            return self.press_beside_array(prescribed, target);
        }
        let reach = ends[0].abs().max(ends[1].abs());
        let more = libm::tan(tilt).abs() * reach;
        self.check_base_clearance(prescribed, ends)?;
        let first = match prescribed {
            Prescribed::PenetrationMm(delta) => room::DEPTH_FACTOR * (delta + more),
            // The other levels estimate the depth by the fast one, which cannot estimate its own.
            Prescribed::ForceN(_) if self.level == Accuracy::Fast => {
                0.1 * self.layer.thickness_mm + more
            }
            Prescribed::ForceN(_) => 0.1 * self.layer.thickness_mm,
        };
        let (layer, level) = (self.layer, self.level);
        let state = self.press_with_tables(prescribed, first, ends, |solver, most, fresh| {
            if fresh {
                *solver = Solver::Pin(Box::new(Pin::new(&layer, profile, ends, most, level)?));
            }
            let Solver::Pin(pin) = solver else { return Ok(SceneState::default()) };
            let state = pin.press(prescribed, tilt)?;
            Ok(SceneState {
                force_n: state.force_n,
                penetration_mm: Some(state.penetration_mm),
                residual: state.residual,
            })
        })?;
        if let Solver::Pin(pin) = &self.solver
            && let Err(refused) = self.check_overhang(ends, pin.state().half_width_mm)
        {
            self.release();
            return Err(refused);
        }
        Ok(state)
    }

    /// Checks what no table can solve: too steep a tilt, and an end that reaches the base.
    fn check_base_clearance(&self, prescribed: Prescribed, ends: [f64; 2]) -> Result<(), Invalid> {
        let tilt = self.pose.tilt_rad;
        if tilt.abs() > TILT_MAX_RAD {
            return Err(Refusal::new("tilt_rad", Why::Tilt(tilt)).into());
        }
        let Prescribed::PenetrationMm(delta) = prescribed else { return Ok(()) };
        let slope = libm::tan(tilt);
        let deepest = delta + (slope * ends[0]).max(slope * ends[1]);
        if deepest < self.layer.thickness_mm {
            return Ok(());
        }
        let what = format!("its deeper end would be {deepest} mm deep, the thickness or more");
        Err(Invalid::new(prescribed.place(), what, "press less, tilt less, or give a shorter one"))
    }

    /// The state of a pin that is entirely beside the pad.
    fn press_beside_array(
        &mut self,
        prescribed: Prescribed,
        target: f64,
    ) -> Result<SceneState, Invalid> {
        self.release();
        match prescribed {
            Prescribed::ForceN(_) if target > 0.0 => {
                let what = "nothing of the indenter is over the array".to_owned();
                Err(Invalid::new(prescribed.place(), what, "move it over the array"))
            }
            Prescribed::ForceN(_) => Ok(SceneState::default()),
            Prescribed::PenetrationMm(_) => {
                self.check_overhang([0.0; 2], self.half_overlap_mm(target))?;
                Ok(SceneState { penetration_mm: Some(target), ..SceneState::default() })
            }
        }
    }

    fn profile(&self) -> Profile {
        match self.shape {
            Shape::Bar { width_mm, .. } => Profile::Bar { width_mm },
            Shape::Cylinder { radius_mm, .. } | Shape::Sphere { radius_mm } => {
                Profile::Cylinder { radius_mm }
            }
            Shape::Edge { .. } => Profile::Bar { width_mm: 0.0 },
        }
    }

    /// Both ends of the indenter along its axis, mm from its origin. The second is not above the
    /// first when the indenter is entirely beside a pad.
    fn ends(&self) -> [f64; 2] {
        if let Some(held_ends) = self.held_ends {
            return held_ends;
        }
        let half = match self.shape {
            Shape::Cylinder { length_mm, .. }
            | Shape::Edge { length_mm }
            | Shape::Bar { length_mm, .. } => length_mm.map(|length| 0.5 * length),
            Shape::Sphere { .. } => Some(0.0),
        };
        if let Some(half) = half.filter(|_| !matches!(self.shape, Shape::Edge { .. })) {
            if !self.is_cut || matches!(self.shape, Shape::Sphere { .. }) {
                return [-half, half];
            }
            let chord = self.array.chord_mm(self.pose.planar);
            return chord.map_or([0.0; 2], |[from, to]| [from.max(-half), to.min(half)]);
        }
        if !matches!(self.shape, Shape::Edge { .. }) {
            // A pin that does not cross the array has no image, so any piece of it will do.
            return self.array.chord_mm(self.pose.planar).unwrap_or([-0.5, 0.5]);
        }
        let PlanarPose { x_mm, y_mm, .. } = self.pose.planar;
        // The length grows in steps, so that small motions do not need new tables.
        let array = self.array.half_diagonal_mm();
        let away = array * libm::ceil((x_mm * x_mm + y_mm * y_mm).sqrt() / array);
        // Loads further off do not act on the array.
        let reach = array + away + EDGE_OVERHANG * self.layer.thickness_mm;
        let half = half.map_or(reach, |half| half.min(reach));
        [-half, half]
    }

    /// Writes the image of the contact, row by row (row = y, column = x, both ascending), stresses
    /// in MPa, negative under compression.
    ///
    /// # Errors
    /// An image that does not have one value per tactel.
    pub fn image(&self, image: &mut [f64]) -> Result<(), Invalid> {
        self.array.check_image(image)?;
        image.fill(0.0);
        if self.state.force_n <= 0.0 {
            return Ok(());
        }
        let planar = self.pose.planar;
        if let Shape::Edge { .. } = self.shape {
            self.edge_image(image);
            return Ok(());
        }
        match (&self.solver, &self.shares) {
            (Solver::Sphere(sphere), _) => {
                sphere.image(&self.array, self.sampling, [planar.x_mm, planar.y_mm], image)?;
                let noise = ROUNDING_PART * self.state.force_n
                    / (self.array.pitch_mm * self.array.pitch_mm);
                image.iter_mut().filter(|szz| szz.abs() <= noise).for_each(|szz| *szz = 0.0);
                Ok(())
            }
            (Solver::Infinite(cylinder), _) => {
                cylinder.image(&self.array, self.sampling, planar, image)
            }
            (Solver::Pin(pin), Some(shares)) => {
                pin.image(shares, planar, image);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Adds the image of a line load: Gauss's rule of two points on short pieces of the line.
    fn edge_image(&self, image: &mut [f64]) {
        let (Some(shares), Shape::Edge { length_mm }) = (&self.shares, self.shape) else { return };
        let [from, to] = self.ends();
        let length = to - from;
        let pieces = libm::ceil(3.0 * length / self.layer.thickness_mm).max(1.0);
        let piece = length / pieces;
        let per_mm = self.state.force_n / length_mm.unwrap_or(1.0);
        let PlanarPose { x_mm, y_mm, rot_rad } = self.pose.planar;
        let (s, c) = (libm::sin(rot_rad), libm::cos(rot_rad));
        let gauss = 0.5 / 3.0_f64.sqrt();
        for n in 0..pieces as usize {
            for offset in [-gauss, gauss] {
                let v = from + piece * (n as f64 + 0.5 + offset);
                shares.add(image, [x_mm - v * s, y_mm + v * c], 0.5 * piece * per_mm);
            }
        }
    }
}

/// The penetration of an indenter that does not touch.
fn penetration_without_contact(prescribed: Prescribed) -> Option<f64> {
    match prescribed {
        Prescribed::PenetrationMm(delta) if delta <= 0.0 => Some(delta),
        _ => None,
    }
}
