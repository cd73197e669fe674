//! Presses a pin: checks the prescribed force or penetration, and solves the contact on rows of
//! slices.

use super::super::super::kernel::SurfaceKernel;
use super::super::super::layer::Layer;
use super::super::super::{Invalid, finite, positive};
use super::super::{Accuracy, Prescribed, Refusal, Why};
use super::contact::RowContact;
use super::failure::SolveFailure;
use super::newton_system::NewtonSystem;
use super::pose::{PinState, RowOrientation};
use super::profile::Profile;
use super::resolution::Resolution;
use super::row::{RowPlan, TILT_MAX_RAD};
use super::row_search::{PinRows, PinSlope};
use super::strip::{Section, StripTable};
use super::tables::end::EndTable;
use super::tabulate::end::end_table;
use super::tabulate::end_correction::end_correction;
use super::tabulate::full_length::full_length_table;
use super::target::Target;

/// Shortest pin in thicknesses.
const LENGTH_MIN: f64 = 0.1;
/// Factors of the deepest penetration up to which strips are tabulated, on a row over an end and on
/// the whole pin, since the pressure of short slices rises towards an end; and the deepest
/// tabulated penetration in thicknesses.
const END_DEPTH_FACTOR: f64 = 1.6;
const WHOLE_DEPTH_FACTOR: f64 = 1.3;
const TABLE_DEPTH_MAX: f64 = 0.98;
/// Shortest row in thicknesses.
const ROW_LENGTH_MIN: f64 = 0.008;
/// A force up to this part of the rubber's modulus times its thickness squared is no contact.
const FORCE_MIN: f64 = 1e-9;
/// A contact up to this depth in thicknesses is none: its slices are so narrow that they act on
/// their neighbours more than on themselves.
const DEPTH_MIN: f64 = 1e-8;

/// The solver of one pin on one layer, with its memory.
#[derive(Clone, Debug)]
pub struct Pin {
    layer: Layer,
    level: Accuracy,
    /// Ends of the axis in thicknesses.
    ends: [f64; 2],
    rows: PinRows,
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
        let mut pin =
            Self::without_full_length_tables(layer, profile, ends_mm, penetration_max_mm, level)?;
        if level == Accuracy::Fast && matches!(profile, Profile::Cylinder { .. }) {
            pin.tabulate_full_length(penetration_max_mm / layer.thickness_mm);
        }
        Ok(pin)
    }

    /// A pin without the tables of a cylinder in contact on a good part of its length, which only
    /// the fast level reads.
    fn without_full_length_tables(
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
        let length = (to - from) / t;
        if length < LENGTH_MIN {
            let what = format!("{} mm is {length} thicknesses", to - from);
            return Err(Invalid::new("length_mm", what, "give at least a tenth of the thickness"));
        }
        let (ends, deepest) = ([from / t, to / t], penetration_max_mm / t);
        let transfer = layer.transfer();
        let kernel = SurfaceKernel::new(|a| transfer.normal_compliance(a));
        let size = PinSize { ends, length, deepest };
        let mut rows = pin_rows(layer, &kernel, section, size, level)?;
        let end_table = match (section, level) {
            (Section::Circle(_), Accuracy::Fast) => end_table(&mut rows, ends[1], deepest),
            (Section::Circle(_), Accuracy::Default | Accuracy::Fine) => {
                Self::fast_end_table(layer, profile, ends_mm, penetration_max_mm)
            }
            _ => None,
        };
        let unknowns = Resolution::for_accuracy(level).newton_unknowns;
        let has_newton = unknowns > 0 && matches!(section, Section::Circle(_));
        let slices = rows.iter().map(|contact| &contact.row);
        let newton = has_newton.then(|| Box::new(NewtonSystem::new(slices, unknowns)));
        let to = ends[1];
        let rows = PinRows { rows, to, end_table, newton, used: 0, is_turned: false };
        Ok(Self { layer: *layer, level, ends, rows, state: PinState::default() })
    }

    /// The table of the fast level, whose widths finer slices read.
    fn fast_end_table(
        layer: &Layer,
        profile: Profile,
        ends_mm: [f64; 2],
        penetration_max_mm: f64,
    ) -> Option<EndTable> {
        let level = Accuracy::Fast;
        let fast =
            Self::without_full_length_tables(layer, profile, ends_mm, penetration_max_mm, level);
        fast.ok().and_then(|fast| fast.rows.end_table)
    }

    /// Solves the contacts on a good part of a cylinder, down from the deepest.
    fn tabulate_full_length(&mut self, deepest: f64) {
        let shortest = self.rows.end_table.as_ref().map_or(0.0, |table| table.longest);
        for (n, contact) in self.rows.rows.iter_mut().enumerate() {
            if n == 0 || contact.row.length > shortest {
                contact.tables.full_length = full_length_table(contact, self.ends[1], deepest);
            }
        }
    }

    /// The same pin on one row, without a contact and without tables of contacts on its end; the
    /// row spans the whole pin.
    pub(super) fn with_row(&self, ends: [f64; 2], contact: RowContact, newton: usize) -> Self {
        let has_newton = self.rows.newton.is_some();
        let slices = core::iter::once(&contact.row);
        let newton = has_newton.then(|| Box::new(NewtonSystem::new(slices, newton)));
        let (rows, to, end_table) = (vec![contact], ends[1], None);
        let rows = PinRows { rows, to, end_table, newton, used: 0, is_turned: false };
        Self { layer: self.layer, level: self.level, ends, rows, state: PinState::default() }
    }

    /// Presses the pin with its axis sloping down towards +v by `tilt_rad`: the penetration at a
    /// place v along the axis is that at the origin plus v tan(tilt).
    ///
    /// # Errors
    /// A value that is not finite, a tensile force, a tilt beyond 0.2 rad, a penetration beyond the
    /// table or of an end of the thickness or more, a force that no penetration of the table
    /// reaches, a contact whose residual after the level's steps exceeds 5e-2 (fast), 1e-2
    /// (default) or 1e-3 (fine). The state is then that of no contact.
    pub fn press(&mut self, prescribed: Prescribed, tilt_rad: f64) -> Result<PinState, Refusal> {
        let outcome = self.try_press(prescribed, tilt_rad);
        match outcome {
            Ok(state) => self.state = state,
            Err(_) => self.release(),
        }
        outcome
    }

    fn try_press(&mut self, prescribed: Prescribed, tilt_rad: f64) -> Result<PinState, Refusal> {
        let t = self.layer.thickness_mm;
        let value = prescribed.check(t)?;
        Refusal::finite("tilt_rad", tilt_rad)?;
        if tilt_rad.abs() > TILT_MAX_RAD {
            return Err(Refusal::new("tilt_rad", Why::Tilt(tilt_rad)));
        }
        let slope = libm::tan(tilt_rad);
        let [from, to] = self.ends;
        // A place v of the pin is at `mirror` - v along a turned row.
        let (is_turned, mirror) = (slope < 0.0, from + to);
        let raised = if is_turned { slope * mirror } else { 0.0 };
        let whole = &self.rows.rows[0].row;
        let scale = whole.modulus_mpa() * t * t;
        let target = match prescribed {
            Prescribed::ForceN(_) if value <= FORCE_MIN * scale => {
                self.release();
                return Ok(self.state);
            }
            Prescribed::ForceN(force) => {
                let force = force / scale;
                let depth = whole.strips.depth_of(force, slope.abs(), to - from);
                Target { force: Some(force), penetration: depth }
            }
            Prescribed::PenetrationMm(_) => {
                Target::at_penetration(value / t + raised + slope.abs() * to)
            }
        };
        if target.force.is_none() && target.penetration >= 1.0 {
            // The deeper end would go through the base.
            return Err(SolveFailure::BeyondTable.refusal(prescribed));
        }
        if target.force.is_none() && target.penetration <= DEPTH_MIN {
            self.release();
            return Ok(PinState { penetration_mm: value, tilt_rad, ..PinState::default() });
        }
        let along = PinSlope { slope: slope.abs(), is_turned };
        let state = self.rows.solve(target, along, &self.state);
        let state = state.map_err(|failure| failure.refusal(prescribed))?;
        // The row's state becomes the pin's, whose origin is raised where the row is turned.
        let moment_n_mm = if is_turned {
            mirror * t * state.force_n - state.moment_n_mm
        } else {
            state.moment_n_mm
        };
        let penetration_mm = state.penetration_mm - raised * t;
        Ok(PinState { penetration_mm, moment_n_mm, tilt_rad, ..state })
    }

    /// Lifts the pin off and forgets the contact.
    pub fn release(&mut self) {
        self.rows.release();
        self.state = PinState::default();
    }

    /// The contact last solved.
    #[must_use]
    pub fn state(&self) -> PinState {
        self.state
    }

    /// The row of the contact last solved.
    pub(super) fn used_row(&self) -> &RowContact {
        self.rows.used_row()
    }

    /// How the row of the contact last solved lies along the pin.
    pub(super) fn orientation(&self) -> RowOrientation {
        let mirror_mm = (self.ends[0] + self.ends[1]) * self.layer.thickness_mm;
        RowOrientation { is_turned: self.rows.is_turned, mirror_mm }
    }

    /// The layer.
    pub(super) fn layer(&self) -> &Layer {
        &self.layer
    }

    /// Accuracy against time.
    pub(super) fn level(&self) -> Accuracy {
        self.level
    }

    /// Ends of the axis in thicknesses.
    pub(super) fn ends(&self) -> [f64; 2] {
        self.ends
    }

    /// The rows of slices, for tests that change what they solve with.
    #[cfg(test)]
    pub(super) fn rows_mut(&mut self) -> &mut PinRows {
        &mut self.rows
    }

    /// The rows of slices.
    pub(super) fn rows(&self) -> &PinRows {
        &self.rows
    }
}

/// Sizes of a pin in thicknesses.
#[derive(Clone, Copy, Debug)]
struct PinSize {
    /// Ends of the axis.
    ends: [f64; 2],
    length: f64,
    /// Deepest penetration asked for.
    deepest: f64,
}

/// Cuts the whole pin, and shorter and shorter parts over its end, into slices, and solves their
/// end corrections where the level adds them.
fn pin_rows(
    layer: &Layer,
    kernel: &SurfaceKernel,
    section: Section,
    size: PinSize,
    level: Accuracy,
) -> Result<Vec<RowContact>, Invalid> {
    let PinSize { ends, length, deepest } = size;
    let resolution = Resolution::for_accuracy(level);
    let (least, more, flat) = resolution.cosines;
    let count = |b: f64| {
        let face = if matches!(section, Section::Flat(_)) { flat * b } else { 0.0 };
        (least + more * b + face) as usize
    };
    let strips = StripTable::new(kernel, section, deepest, count)?;
    // The pressure of short slices rises towards an end, and the table of their strips covers it.
    let deeper = (END_DEPTH_FACTOR * deepest).min(TABLE_DEPTH_MAX);
    let end_strips = StripTable::new(kernel, section, deeper, count);
    let end_strips = end_strips.unwrap_or_else(|_| strips.clone());
    let whole_strips = match (section, level) {
        (Section::Circle(_), Accuracy::Fast) => end_strips.clone(),
        (Section::Circle(_), _) => {
            let deeper = (WHOLE_DEPTH_FACTOR * deepest).min(TABLE_DEPTH_MAX);
            StripTable::new(kernel, section, deeper, count).unwrap_or(strips)
        }
        _ => strips,
    };
    let (strips, is_whole) = (whole_strips, true);
    let whole = RowPlan { layer, kernel, strips, is_whole, ends, resolution };
    let mut rows = vec![RowContact::new(whole)?];
    let resolution = Resolution { tolerance: 0.5 * resolution.tolerance, ..resolution };
    let mut length = resolution.next_row_length(length);
    while length >= ROW_LENGTH_MIN {
        let (strips, ends) = (end_strips.clone(), [ends[1] - length, ends[1]]);
        let end = RowPlan { layer, kernel, strips, is_whole: false, ends, resolution };
        rows.push(RowContact::new(end)?);
        length = resolution.next_row_length(length);
    }
    // Where an image consists of lines, no correction is added.
    for contact in rows.iter_mut().filter(|contact| contact.row.resolution.lines.is_none()) {
        contact.tables.end_correction =
            end_correction(layer, kernel, &end_strips, deepest, &contact.row);
    }
    Ok(rows)
}
