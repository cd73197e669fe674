//! Describes why a contact cannot be solved, as numbers and constants: a real-time task gets such
//! an error without allocating. Whoever shows it to a person converts it into [`Invalid`], whose
//! texts allocate.

use super::super::{Invalid, MAGNITUDE_MAX, finite};
use super::Prescribed;
use core::fmt;

/// Why a press is refused: the number at fault and what is wrong with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refusal {
    /// Name of the number at fault.
    pub place: &'static str,
    /// What is wrong with it.
    pub why: Why,
}

/// What is wrong with what was asked of an indenter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Why {
    /// Not finite, or beyond 1e30 either way.
    OutOfRange(f64),
    /// A force below 0, N.
    Tension(f64),
    /// A penetration of the layer's thickness or more, mm.
    Thickness(f64),
    /// Steeper than a section is that of a cylinder, rad.
    Tilt(f64),
    /// More than the tables were made for.
    BeyondTable,
    /// The contact has not converged after the last step; the remaining part of the penetration.
    Unconverged(f64),
    /// The slices' system is not positive.
    Indefinite,
    /// No contact that fits the indenter and the layer reaches it.
    Unreachable,
    /// Heights that are not one number a cell.
    HeightCount {
        /// Heights given.
        given: usize,
        /// Cells of the grid.
        cells: usize,
    },
    /// The gaps of a body on cells have not converged after the last iteration; the largest one
    /// over the penetration.
    MissedSurface(f64),
    /// The contact reaches the border of the grid of cells.
    GridBorder,
}

impl Refusal {
    pub(crate) fn new(place: &'static str, why: Why) -> Self {
        Self { place, why }
    }

    /// Checks that a number is finite and not absurdly large.
    pub(crate) fn finite(place: &'static str, value: f64) -> Result<(), Self> {
        if value.abs() <= MAGNITUDE_MAX {
            Ok(())
        } else {
            Err(Self::new(place, Why::OutOfRange(value)))
        }
    }

    /// The refusal as a text with a remedy.
    #[must_use]
    pub fn to_invalid(&self) -> Invalid {
        let tell = |what: String, remedy| Invalid::new(self.place, what, remedy);
        match self.why {
            Why::OutOfRange(value) => match finite(self.place, value) {
                Err(invalid) => invalid,
                Ok(()) => tell(format!("{value} is refused"), "give another number"),
            },
            Why::Tension(force) => tell(
                format!("{force} N pulls, but the rubber does not adhere to the body"),
                "give 0 or more",
            ),
            Why::Thickness(depth) => {
                tell(format!("{depth} mm is the layer's thickness or more"), "press less")
            }
            Why::Tilt(tilt) => tell(format!("{tilt} rad"), "give at most 0.2 rad either way"),
            Why::BeyondTable => {
                let remedy = "press less, or tabulate a larger penetration";
                tell(super::BEYOND_TABLE.to_owned(), remedy)
            }
            Why::Unconverged(left) => {
                let what =
                    format!("the contact does not converge: {left:.1e} of the penetration is left");
                tell(what, "choose a higher accuracy, or a pin longer than the layer is thick")
            }
            Why::Indefinite => tell(
                "the equations of the slices are not positive definite".to_owned(),
                "press less",
            ),
            Why::Unreachable => {
                let what = "no contact that fits the indenter and the layer reaches it";
                tell(what.to_owned(), "press less, or use another size of indenter")
            }
            Why::HeightCount { given, cells } => {
                tell(format!("{given} heights for {cells} cells"), "give one number a cell")
            }
            Why::MissedSurface(left) => tell(
                format!("the gap does not converge: {left} of the penetration is left"),
                "give a smoother body or finer cells",
            ),
            Why::GridBorder => {
                let what = "the contact reaches the grid's border";
                tell(what.to_owned(), "give a larger grid, or press less")
            }
        }
    }
}

impl From<Refusal> for Invalid {
    fn from(refusal: Refusal) -> Self {
        refusal.to_invalid()
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.to_invalid().fmt(f)
    }
}

impl core::error::Error for Refusal {}

impl Prescribed {
    /// The prescribed number, if it is one that can be reached in principle.
    pub(super) fn check(self, thickness_mm: f64) -> Result<f64, Refusal> {
        match self {
            Self::ForceN(force) => {
                Refusal::finite(self.place(), force)?;
                if force < 0.0 {
                    return Err(Refusal::new(self.place(), Why::Tension(force)));
                }
                Ok(force)
            }
            Self::PenetrationMm(delta) => {
                Refusal::finite(self.place(), delta)?;
                if delta >= thickness_mm {
                    return Err(Refusal::new(self.place(), Why::Thickness(delta)));
                }
                Ok(delta)
            }
        }
    }

    /// Name of the prescribed quantity.
    pub(super) fn place(self) -> &'static str {
        match self {
            Self::ForceN(_) => "force_n",
            Self::PenetrationMm(_) => "penetration_mm",
        }
    }
}
