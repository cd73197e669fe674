//! The number of points with which an interval is solved: by accuracy, by width, and more for soft
//! wide layers and steep circles. Bars that are too wide for the most points are refused; for other
//! contacts callers compare with [`PointCounts::half_width_max`].

use super::Shape;
use crate::Accuracy;
use crate::Invalid;
use crate::layer::Transfer;

/// Most points of an interval unless a bar needs more: enough for contacts 120 thicknesses wide.
const POINTS_MAX: usize = 400;
/// A wide incompressible contact descends by a small part of what its pressure does nearby, which
/// enlarges relative errors. From this gain on there are more points.
const ERROR_GAIN_MIN: f64 = 8.0;
/// Half-width in radii of a circle from which on its slope needs points of its own.
const STEEP_HALF_WIDTH_RADII: f64 = 0.66;

/// Points of an indenter's intervals.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointCounts {
    accuracy: Accuracy,
    /// Compliance under uniform pressure, of wave number 0.
    uniform_compliance: f64,
    /// Radius of a circle in thicknesses; infinite for other shapes.
    radius: f64,
    capacity: usize,
    half_width_max: f64,
}

impl PointCounts {
    /// # Errors
    /// A bar too wide for the points.
    pub(super) fn new(
        accuracy: Accuracy,
        transfer: &Transfer,
        shape: Shape,
        thickness_mm: f64,
    ) -> Result<Self, Invalid> {
        let radius = match shape {
            Shape::Cylinder { radius_mm } => radius_mm / thickness_mm,
            Shape::Flat { .. } | Shape::Parabola { .. } => f64::INFINITY,
        };
        let uniform_compliance = transfer.normal_compliance(0.0);
        let mut density = Self {
            accuracy,
            uniform_compliance,
            radius,
            capacity: POINTS_MAX,
            half_width_max: 0.0,
        };
        if let Shape::Flat { width_mm, .. } = shape {
            let half = 0.5 * width_mm / thickness_mm;
            let wanted = density.points(half);
            if wanted > 2 * POINTS_MAX {
                let what = format!("{width_mm} is {:.0} thicknesses", 2.0 * half);
                return Err(Invalid::new(
                    "width_mm",
                    what,
                    "give a narrower bar or a thicker layer",
                ));
            }
            density.capacity = wanted.max(40);
        }
        density.half_width_max = density.half_width_max_for(density.capacity);
        Ok(density)
    }

    /// Number of points available.
    pub(super) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Largest half-width in thicknesses that these points resolve.
    pub(super) fn half_width_max(&self) -> f64 {
        self.half_width_max
    }

    /// Points at least, and for each thickness of half-width: the kernel's nearest singularities
    /// lie 2i thicknesses away, so the error falls as exp(-4 n/half) where that is the slower.
    fn base_and_slope(&self) -> [f64; 2] {
        match self.accuracy {
            Accuracy::Fast => [5.0, 3.2],
            Accuracy::Default => [10.0, 4.9],
            Accuracy::Fine => [14.0, 6.4],
        }
    }

    /// Points for a half-width of `half` thicknesses.
    pub(super) fn points(&self, half: f64) -> usize {
        let [least, each] = self.base_and_slope();
        let wanted = (least + each * half + self.incompressible_points(half))
            .max(self.steep_points(half))
            .min(1e6);
        // The number changes in steps, so that the nodes can often be kept while an edge is
        // searched.
        let step = if self.accuracy == Accuracy::Fast { 2 } else { 4 };
        (libm::ceil(wanted) as usize).next_multiple_of(step)
    }

    /// Additional points where the layer is nearly incompressible: errors of the kernel are
    /// enlarged by the ratio of its compliance nearby to that of the whole contact.
    fn incompressible_points(&self, half: f64) -> f64 {
        if self.uniform_compliance * ERROR_GAIN_MIN >= 1.0 || half * half * half <= ERROR_GAIN_MIN {
            return 0.0;
        }
        let enlarged = 1.0 / (self.uniform_compliance + 1.0 / (half * half * half));
        0.4 * half * libm::log(enlarged / ERROR_GAIN_MIN).max(0.0)
    }

    /// Points that a circle's slope needs, which is infinite a radius away from the middle.
    fn steep_points(&self, half: f64) -> f64 {
        if half < STEEP_HALF_WIDTH_RADII * self.radius {
            return 0.0;
        }
        let away = (self.radius / half).max(1.01);
        let digits = match self.accuracy {
            Accuracy::Fast => 6.0,
            Accuracy::Default => 11.5,
            Accuracy::Fine => 16.0,
        };
        digits / libm::log(away + (away * away - 1.0).sqrt())
    }

    fn half_width_max_for(&self, points: usize) -> f64 {
        let [least, each] = self.base_and_slope();
        let mut half = (points as f64 - 4.0 - least) / each;
        while self.incompressible_points(half) > 0.0 && self.points(half) > points {
            half *= 0.99;
        }
        half
    }
}
