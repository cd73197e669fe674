//! The resolution of each level: how finely a pin is cut and how finely its slices are coupled.

use super::super::Accuracy;
use super::coupling::ModeResolution;
use core::f64::consts::FRAC_1_SQRT_2;

/// Length (thicknesses) of a row below which the following rows are shortened by another ratio,
/// because contacts on them are wide for their length and fill few slices.
const SHORT_ROW_LENGTH: f64 = 9.0;

/// How a row is cut: the wanted slice length in thicknesses, the least number of slices, the number
/// above which slices become longer, and the length up to which they do.
#[derive(Clone, Copy, Debug)]
pub(super) struct SliceSpacing {
    pub(super) fewest: f64,
    pub(super) slice: f64,
    pub(super) enough: f64,
    pub(super) longest: f64,
}

impl SliceSpacing {
    /// Number of slices of a row of a length, if each slice is `longer` times as long as usual.
    pub(super) fn count(self, length: f64, longer: f64) -> f64 {
        let wanted = (length / (longer * self.slice)).clamp(self.fewest, self.enough);
        wanted.max(length / self.longest)
    }
}

/// Accuracy against time, per [`Accuracy`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Resolution {
    /// Ratio of the length of a row over the end to that of the row before: down to
    /// [`SHORT_ROW_LENGTH`] thicknesses, and below that length.
    pub(super) shorter: [f64; 2],
    /// How the whole pin and its end are cut into slices.
    pub(super) whole: SliceSpacing,
    pub(super) end: SliceSpacing,
    pub(super) modes: ModeResolution,
    /// Cosines at zero width, more per thickness of half-width, and more again for a flat face.
    pub(super) cosines: (f64, f64, f64),
    /// Wave number (times thickness) up to which the points of an image stand for the pressure, for
    /// a point of the base.
    pub(super) points: f64,
    /// The same if lines stand for slices. Without lines, the force of each slice is spread over
    /// its neighbours, and the ends get the end correction.
    pub(super) lines: Option<f64>,
    pub(super) tolerance: f64,
    pub(super) steps: usize,
    /// Largest error, in parts of the penetration, with which a contact is accepted after the last
    /// step.
    pub(super) residual_max: f64,
    /// The same for a contact whose widths are read from a table, before they are refined.
    pub(super) read_tolerance: f64,
    /// Most unknowns of a contact whose widths are solved together by Newton's method.
    pub(super) newton_unknowns: usize,
    /// Whether each slice of a short row has a relaxation factor of its own.
    pub(super) has_slice_relaxation: bool,
    /// Most unknowns of the dense system of a contact on an end whose widths are read from a table;
    /// wide contacts have fewer slices.
    pub(super) dense_unknowns: usize,
    /// The same for a bar, whose contacts are all solved when its tables are made.
    pub(super) bar: Option<BarResolution>,
}

/// How a bar is cut and how finely its slices are coupled. Its contacts are all solved in advance,
/// so time does not matter here.
#[derive(Clone, Copy, Debug)]
pub(super) struct BarResolution {
    pub(super) whole: SliceSpacing,
    pub(super) end: SliceSpacing,
    pub(super) modes: ModeResolution,
}

/// The default level's slices, of a cylinder and of a bar.
const CYLINDER_SPACING: SliceSpacing =
    SliceSpacing { fewest: 64.0, slice: 0.35, enough: 128.0, longest: 0.65 };
const BAR_SPACING: SliceSpacing = SliceSpacing { slice: 0.5, ..CYLINDER_SPACING };

impl Resolution {
    /// Length of the row after one of a length.
    pub(super) fn next_row_length(&self, length: f64) -> f64 {
        self.shorter[usize::from(length < SHORT_ROW_LENGTH)] * length
    }

    pub(super) fn for_accuracy(level: Accuracy) -> Self {
        let modes = |margin, cutoff, reach, grade| ModeResolution {
            margin,
            cutoff,
            least: cutoff,
            reach,
            grade,
        };
        match level {
            Accuracy::Fast => Self {
                shorter: [FRAC_1_SQRT_2; 2],
                whole: SliceSpacing { fewest: 20.0, slice: 0.42, enough: 42.0, longest: 1.0 },
                end: SliceSpacing { fewest: 14.0, slice: 0.3, enough: 42.0, longest: 1.0 },
                modes: modes(10.0, 10.0, 7.0, 0.2),
                cosines: (3.0, 0.0, 1.5),
                points: 4.5,
                lines: Some(7.497),
                tolerance: 5e-3,
                steps: 8,
                residual_max: 5e-2,
                read_tolerance: 5e-2,
                newton_unknowns: 0,
                has_slice_relaxation: false,
                dense_unknowns: 54,
                bar: Some(BarResolution {
                    whole: SliceSpacing { fewest: 28.0, slice: 0.42, enough: 60.0, longest: 0.45 },
                    end: SliceSpacing { fewest: 24.0, slice: 0.42, enough: 30.0, longest: 0.45 },
                    modes: modes(16.0, 10.0, 12.0, 0.2),
                }),
            },
            Accuracy::Default => Self {
                shorter: [0.5, FRAC_1_SQRT_2],
                whole: CYLINDER_SPACING,
                end: CYLINDER_SPACING,
                modes: ModeResolution { least: 6.0, ..modes(16.0, 10.0, 12.0, 0.1) },
                cosines: (4.0, 0.1, 2.0),
                points: 11.0,
                lines: None,
                tolerance: 1e-4,
                steps: 25,
                residual_max: 1e-2,
                read_tolerance: 7e-3,
                newton_unknowns: 0,
                has_slice_relaxation: true,
                dense_unknowns: 280,
                bar: Some(BarResolution {
                    whole: BAR_SPACING,
                    end: BAR_SPACING,
                    modes: modes(16.0, 20.0, 12.0, 0.2),
                }),
            },
            Accuracy::Fine => Self {
                shorter: [0.5; 2],
                whole: SliceSpacing { fewest: 100.0, slice: 0.25, enough: 4096.0, longest: 0.25 },
                end: SliceSpacing { fewest: 100.0, slice: 0.25, enough: 4096.0, longest: 0.25 },
                modes: modes(24.0, 20.0, 16.0, 0.05),
                cosines: (6.0, 1.0, 2.0),
                points: 18.0,
                lines: None,
                tolerance: 1e-6,
                steps: 60,
                residual_max: 1e-3,
                read_tolerance: 0.0,
                newton_unknowns: 900,
                has_slice_relaxation: true,
                dense_unknowns: 0,
                bar: None,
            },
        }
    }
}
