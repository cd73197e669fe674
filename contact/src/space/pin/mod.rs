//! A rigid pin or bar of finite length, with flat ends, tilted along its axis: a reduced model of
//! slices. Each slice carries a plane contact's pressure (few cosines over the square root's
//! singularity), the slices couple through the layer. What is solved is Galerkin's form of the
//! exact problem: error falls with the slice length and the number of cosines, and force and image
//! are of second order in what is left.
//!
//! The free width of each slice is found by Newton's method: a width that is not the right one
//! leaves a punch's singularity at the edge, and the plane problem says which penetration cures
//! it. Lifted slices leave the contact and come back when the layer would touch them. A contact is
//! the guess of the next one; pressing allocates nothing.
//!
//! A tilted pin touches from its deeper end on, so beside the row of slices over the whole pin
//! there are shorter rows over its end, each a fixed part as long as the one before; the shortest
//! that holds what touches is used, and a contact is always spread over a number of slices. At the
//! fast level a cylinder's contacts on its end (`corner`) and those on a good part of its length
//! (`lying`) are solved when its tables are made, a bar's all are (`nested`). On an end it is the
//! widths that are read, and the pressure is solved on them anew; so the default level reads them
//! from the fast one's tables, and takes them the rest of the way. Its bars are solved beforehand
//! too; its lying cylinders are searched for, as all is at the fine level. There the widths on an
//! end, which do not settle one by one, are settled together (`newton`).
//!
//! Ends: strips of constant pressure see an end inside of its place, by a part of their length that
//! a punch on the layer tells (`ends`). The slices are laid out for it, so that few of them do;
//! the default and the fine level put what is left over into force and image (`leftover`).
//!
//! It refuses what its tables do not cover: see [`Pin::new`] and [`Pin::press`].

mod corner;
mod cosines;
mod couple;
mod direct;
mod edge;
mod ends;
mod faint;
mod fineness;
mod gather;
mod gradients;
mod image;
mod leftover;
mod lengthened;
mod lines;
mod lying;
mod mixed;
mod nested;
mod newton;
mod profile;
mod roll;
mod row;
mod rows;
mod solve;
mod spread;
pub(super) mod strip;
mod work;

use super::super::kernel::SurfaceKernel;
use super::super::layer::Layer;
use super::super::{Invalid, finite, positive};
use super::{Drive, Refusal, Why};
use crate::Accuracy;
use corner::Corner;
use fineness::Fineness;
pub(crate) use lengthened::Reach;
use lying::Lying;
use newton::Newton;
pub use profile::Profile;
pub use roll::Roll;
use row::{Lie, Row, holding};
use strip::{Section, Strips};
use work::Trouble;

/// Steepest tilt in rad: beyond it the sections are not those of a cylinder any more.
pub(super) const TILT_MAX: f64 = 0.2;
/// Shortest pin in thicknesses.
const SHORTEST: f64 = 0.1;
/// Rows on which a contact is searched for from widths that were read.
const BEGINNINGS: usize = 3;
/// Room for the pressure's rise towards an end, in penetrations, on a row over an end and on the
/// whole pin, and the most there can be.
const ROOM: f64 = 1.6;
const WHOLE_ROOM: f64 = 1.3;
const DEEPEST: f64 = 0.98;
/// Shortest row in thicknesses.
const SHORTEST_ROW: f64 = 0.008;
/// A force below this part of the rubber's modulus times its thickness squared is none, and so is a
/// contact whose deepest place is less than a part of the thickness deep: its slices are so narrow
/// that they feel their neighbours more than themselves.
const NOTHING: f64 = 1e-9;
const FAINTEST: f64 = 1e-8;

/// Where the pin stands over the array.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stand {
    /// x of the pin's origin, mm.
    pub x_mm: f64,
    /// y of the pin's origin, mm.
    pub y_mm: f64,
    /// Direction of the axis: (-sin, cos).
    pub rot_rad: f64,
}

/// What a pressed pin says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PinState {
    /// Normal force of the whole pin, N.
    pub force_n: f64,
    /// Moment of the pressure about the origin, across the axis: force times place along it, N mm.
    pub moment_n_mm: f64,
    /// Penetration of the lowest line at the origin, mm.
    pub penetration_mm: f64,
    /// Slope of the axis, rad.
    pub tilt_rad: f64,
    /// Largest half-width of the contact, mm.
    pub half_width_mm: f64,
    /// Length of the pin in contact, mm.
    pub length_mm: f64,
    /// How far the contact is from complementarity: the largest change of the penetration that a
    /// slice's width belongs to by which the pressure at its edge would vanish, or by which a slice
    /// in the air is reached, over the largest penetration. Force and image are off by its square.
    /// A bar's slice that is pulled on the whole stays in the air, reached in its middle or not.
    /// Of a lying contact that was solved when the tables were made: of those that it lies between.
    pub residual: f64,
    /// Free-boundary steps taken; 1 for a contact that was solved when the tables were made.
    pub steps: usize,
}

/// The solver of one pin on one layer, with its memory.
#[derive(Clone, Debug)]
pub struct Pin {
    layer: Layer,
    level: Accuracy,
    /// Ends of the axis in thicknesses.
    ends: [f64; 2],
    /// The whole pin, then shorter and shorter rows over the end at `ends[1]`.
    rows: Vec<Row>,
    /// Contacts on the end of a cylinder, where they were solved beforehand.
    corner: Option<Corner>,
    /// Memory to settle all widths together, where the level has it.
    newton: Option<Box<Newton>>,
    /// The row of the last contact, and whether its axis runs the other way.
    at: usize,
    turned: bool,
    state: PinState,
}

impl Pin {
    /// Tabulates a pin whose axis spans `ends_mm` from its origin, for penetrations of its deepest
    /// slice up to `penetration_max_mm`, a bar for all below the thickness; allocates.
    ///
    /// # Errors
    /// A layer that [`Layer::check`] refuses, sizes that are not finite and above zero, ends that
    /// are reversed, a penetration of the thickness or more, contacts wider than 0.95 of the
    /// diameter or 80 thicknesses, pins longer than 4096 slices.
    pub fn new(
        layer: &Layer,
        profile: Profile,
        ends_mm: [f64; 2],
        penetration_max_mm: f64,
        level: Accuracy,
    ) -> Result<Self, Invalid> {
        let mut made = Self::cut(layer, profile, ends_mm, penetration_max_mm, level)?;
        if level == Accuracy::Fast && matches!(profile, Profile::Cylinder { .. }) {
            made.solve_lying(penetration_max_mm / layer.thickness_mm);
        }
        Ok(made)
    }

    /// The same without the contacts of a lying cylinder, which only the fast level reads.
    fn cut(
        layer: &Layer,
        profile: Profile,
        ends_mm: [f64; 2],
        penetration_max_mm: f64,
        level: Accuracy,
    ) -> Result<Self, Invalid> {
        layer.check()?;
        let t = layer.thickness_mm;
        let section = profile.section(t)?;
        let [from, to] = ends_mm;
        finite("length_mm", from)?;
        finite("length_mm", to)?;
        positive("length_mm", to - from)?;
        positive("penetration_max_mm", penetration_max_mm)?;
        if penetration_max_mm >= t {
            let what = format!("{penetration_max_mm} mm is the layer's thickness or more");
            return Err(Invalid::new("penetration_max_mm", what, "give less than the thickness"));
        }
        let fineness = Fineness::of(level);
        let length = (to - from) / t;
        if length < SHORTEST {
            let what = format!("{} mm is {length} thicknesses", to - from);
            return Err(Invalid::new("length_mm", what, "give at least a tenth of the thickness"));
        }
        let (least, more, flat) = fineness.cosines;
        let count = |b: f64| {
            let face = if matches!(section, Section::Flat(_)) { flat * b } else { 0.0 };
            (least + more * b + face) as usize
        };
        let transfer = layer.transfer();
        let kernel = SurfaceKernel::new(|a| transfer.normal_compliance(a));
        let (ends, deepest) = ([from / t, to / t], penetration_max_mm / t);
        let strips = Strips::new(&kernel, section, deepest, count)?;
        // Short slices see how the pressure rises towards an end, and so does what is tabulated.
        let deeper = (ROOM * deepest).min(DEEPEST);
        let risen = Strips::new(&kernel, section, deeper, count);
        let risen = risen.unwrap_or_else(|_| strips.clone());
        let over = match (section, level) {
            (Section::Circle(_), Accuracy::Fast) => risen.clone(),
            (Section::Circle(_), _) => {
                let deeper = (WHOLE_ROOM * deepest).min(DEEPEST);
                Strips::new(&kernel, section, deeper, count).unwrap_or(strips)
            }
            _ => strips,
        };
        let mut rows = vec![Row::new((layer, &kernel), (over, true), ends, fineness)?];
        let fineness = Fineness { tolerance: 0.5 * fineness.tolerance, ..fineness };
        let mut reach = fineness.next(length);
        while reach >= SHORTEST_ROW {
            let (over, end) = ((risen.clone(), false), [ends[1] - reach, ends[1]]);
            rows.push(Row::new((layer, &kernel), over, end, fineness)?);
            reach = fineness.next(reach);
        }
        for row in rows.iter_mut().filter(|row| row.fineness.lines.is_none()) {
            row.leftover = leftover::Leftover::new((layer, &kernel), (&risen, deepest), row);
        }
        let corner = match (section, level) {
            (Section::Circle(_), Accuracy::Fast) => Corner::new(&mut rows, ends[1], deepest),
            (Section::Circle(_), Accuracy::Default | Accuracy::Fine) => {
                let coarse = Self::cut(layer, profile, ends_mm, penetration_max_mm, Accuracy::Fast);
                coarse.ok().and_then(|coarse| coarse.corner)
            }
            _ => None,
        };
        let together = fineness.together > 0 && matches!(section, Section::Circle(_));
        let newton = together.then(|| Box::new(Newton::new(&rows, fineness.together)));
        let (at, turned, state) = (0, false, PinState::default());
        Ok(Self { layer: *layer, level, ends, rows, corner, newton, at, turned, state })
    }

    /// Solves the contacts on a good part of a cylinder, down to the deepest.
    fn solve_lying(&mut self, deepest: f64) {
        let shortest = self.corner.as_ref().map_or(0.0, Corner::longest);
        for (n, row) in self.rows.iter_mut().enumerate() {
            if n == 0 || row.length > shortest {
                row.lying = Lying::new(row, self.ends[1], deepest);
            }
        }
    }

    /// Presses the pin with its axis sloping down towards +v by `tilt_rad`: the penetration at a
    /// place v along the axis is that at the origin plus v tan(tilt).
    ///
    /// # Errors
    /// What is not finite, a pull, a tilt beyond 0.2 rad, a penetration beyond the table or of an
    /// end of the thickness or more, a force that no penetration of the table reaches, a contact of
    /// which more of the penetration is left after the level's steps than 5e-2 (fast), 1e-2
    /// (default) or 1e-3 (fine); what is left of less is in `residual`. The state is then that of
    /// no contact.
    pub fn press(&mut self, drive: Drive, tilt_rad: f64) -> Result<PinState, Refusal> {
        let outcome = self.try_press(drive, tilt_rad);
        match outcome {
            Ok(state) => self.state = state,
            Err(_) => self.release(),
        }
        outcome
    }

    fn try_press(&mut self, drive: Drive, tilt_rad: f64) -> Result<PinState, Refusal> {
        let t = self.layer.thickness_mm;
        let target = drive.check(t)?;
        Refusal::finite("tilt_rad", tilt_rad)?;
        if tilt_rad.abs() > TILT_MAX {
            return Err(Refusal::new("tilt_rad", Why::Tilt(tilt_rad)));
        }
        let slope = libm::tan(tilt_rad);
        let [from, to] = self.ends;
        // What lies at v lies at `mirror` - v along a turned row.
        let (turned, mirror) = (slope < 0.0, from + to);
        let raised = if turned { slope * mirror } else { 0.0 };
        let whole = &self.rows[0];
        let scale = whole.modulus_mpa() * t * t;
        let (wanted, guess) = match drive {
            Drive::ForceN(_) if target <= NOTHING * scale => {
                self.release();
                return Ok(self.state);
            }
            Drive::ForceN(force) => {
                let force = force / scale;
                let depth = whole.strips.depth_of(force, slope.abs(), to - from);
                (Some(force), depth)
            }
            Drive::PenetrationMm(_) => (None, target / t + raised + slope.abs() * to),
        };
        if wanted.is_none() && guess >= 1.0 {
            // Its deeper end would go through the base.
            return Err(Trouble::Beyond.refused(drive));
        }
        if wanted.is_none() && guess <= FAINTEST {
            self.release();
            return Ok(PinState { penetration_mm: target, tilt_rad, ..PinState::default() });
        }
        if let Some(state) = self.solved_before((wanted, guess), slope, turned) {
            return Ok(self.along_pin(state, (raised, mirror), tilt_rad));
        }
        let state = self.on_rows((wanted, guess), slope.abs(), turned);
        let state = state.map_err(|trouble| trouble.refused(drive))?;
        Ok(self.along_pin(state, (raised, mirror), tilt_rad))
    }

    /// The contact by what was solved when the tables were made, where that has it.
    fn solved_before(
        &mut self,
        sought: (Option<f64>, f64),
        slope: f64,
        turned: bool,
    ) -> Option<PinState> {
        self.on_corner(sought, slope, turned)
            .or_else(|| self.lying(sought, slope, turned))
            .or_else(|| self.begun(sought, slope, turned))
    }

    /// The contact on an end, searched for from widths that were solved beforehand, on the shortest
    /// of some rows that has it.
    fn begun(
        &mut self,
        (wanted, guess): (Option<f64>, f64),
        slope: f64,
        turned: bool,
    ) -> Option<PinState> {
        self.newton.as_ref()?;
        let (slope, to) = (slope.abs(), self.ends[1]);
        let corner = self.corner.as_ref()?;
        let widths = corner.begin((wanted, guess), slope)?;
        let shortest = holding(&self.rows, widths.reach).max(1);
        for at in (1..=shortest).rev().take(BEGINNINGS) {
            self.rows[self.at].release();
            (self.at, self.turned) = (at, turned);
            let Some(start) = self.rows[at].begin(&widths, to, slope) else { continue };
            let outcome = self.press_on(at, (wanted, start), slope);
            let row = &self.rows[at];
            let settled = |state: &PinState| state.residual <= row.fineness.settled;
            match outcome {
                Ok(state) if settled(&state) && !row.work.touches(0) => return Some(state),
                _ => {}
            }
        }
        None
    }

    /// The contact on an end by what was solved beforehand.
    fn on_corner(
        &mut self,
        (wanted, guess): (Option<f64>, f64),
        slope: f64,
        turned: bool,
    ) -> Option<PinState> {
        if self.newton.is_some() {
            return None;
        }
        let (corner, slope) = (self.corner.as_ref()?, (slope.abs(), self.ends[1]));
        let (at, state) = corner::read(corner, &mut self.rows, (wanted, guess), slope)?;
        (self.at, self.turned) = (at, turned);
        Some(state)
    }

    /// The contact on a good part of the pin by what was solved beforehand, on the shortest row
    /// that has it.
    fn lying(
        &mut self,
        (wanted, guess): (Option<f64>, f64),
        slope: f64,
        turned: bool,
    ) -> Option<PinState> {
        let along = (slope.abs(), self.ends[1]);
        let rows = self.rows.iter_mut().enumerate().rev();
        let (at, state) =
            rows.filter_map(|(at, row)| Some((at, row.lie((wanted, guess), along)?))).next()?;
        (self.at, self.turned) = (at, turned);
        Some(state)
    }

    /// A row's state as the pin's, whose origin is `raised`, mirrored when the row is turned.
    fn along_pin(&self, state: PinState, (raised, mirror): (f64, f64), tilt_rad: f64) -> PinState {
        let t = self.layer.thickness_mm;
        let moment_n_mm = if self.turned {
            mirror * t * state.force_n - state.moment_n_mm
        } else {
            state.moment_n_mm
        };
        PinState {
            penetration_mm: state.penetration_mm - raised * t,
            moment_n_mm,
            tilt_rad,
            ..state
        }
    }

    /// Lifts the pin off and forgets the contact.
    pub fn release(&mut self) {
        self.rows[self.at].release();
        self.state = PinState::default();
    }

    /// The contact last solved.
    #[must_use]
    pub fn state(&self) -> PinState {
        self.state
    }

    fn lie(&self) -> Lie {
        let mirror_mm = (self.ends[0] + self.ends[1]) * self.layer.thickness_mm;
        Lie { turned: self.turned, mirror_mm }
    }
}
