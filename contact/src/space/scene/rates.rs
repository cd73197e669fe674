//! What derivatives of a scene are taken with: steps of its motions, the rate of a bar's roll, the
//! same scene at another level.

use super::super::motion::Motion;
use super::{Accuracy, Invalid, Scene, Shape, Solver};

impl Scene {
    /// The same at the level beside which this one's errors are judged, without contact: a finer
    /// one; the fast one for a pin, of which a finer one takes longer than all the rest.
    pub(crate) fn at_other_level(&self) -> Result<Self, Invalid> {
        let level = match self.level {
            Accuracy::Fast | Accuracy::Fine => Accuracy::Default,
            Accuracy::Default if self.is_pin() => Accuracy::Fast,
            Accuracy::Default => Accuracy::Fine,
        };
        let made = Self::new(&self.layer, self.shape, &self.array, self.sampling, level)?;
        Ok(Self { is_cut: self.is_cut, ..made })
    }

    /// Part of a derivative that the level of a pin may leave; 0 of other indenters, for which the
    /// other level tells it.
    pub(crate) fn accuracy(&self) -> f64 {
        match self.level {
            _ if !self.is_pin() => 0.0,
            Accuracy::Fast => 1e-2,
            Accuracy::Default => 3e-3,
            Accuracy::Fine => 6e-4,
        }
    }

    /// Whether the indenter is cut into slices.
    fn is_pin(&self) -> bool {
        match self.shape {
            Shape::Cylinder { length_mm, .. } | Shape::Bar { length_mm, .. } => {
                length_mm.is_some() || self.pose.tilt_rad != 0.0
            }
            Shape::Sphere { .. } | Shape::Edge { .. } => false,
        }
    }

    /// Whether the indenter has no ends and slopes.
    pub(super) fn is_cut_in_tilt(&self) -> bool {
        match self.shape {
            Shape::Cylinder { length_mm, .. } | Shape::Bar { length_mm, .. } => {
                length_mm.is_none() && self.pose.tilt_rad != 0.0
            }
            Shape::Sphere { .. } | Shape::Edge { .. } => false,
        }
    }

    /// A step for differences along a motion: a small part of what the contact spans. An indenter
    /// that slopes may touch with an end while its middle is in the air.
    pub(crate) fn step(&self, motion: Motion, penetration_mm: Option<f64>) -> f64 {
        let t = self.layer.thickness_mm;
        let slope = libm::tan(self.pose.tilt_rad);
        let [deeper, other] = self.ends().map(|end| slope * end);
        let deepest = penetration_mm.map(|middle| middle + deeper.max(other));
        let depth = deepest.unwrap_or(0.1 * t).abs().max(1e-6 * t);
        match motion {
            Motion::X | Motion::Y => 0.05 * t.min(self.array.pitch_mm),
            Motion::Z => 0.05 * depth,
            Motion::RotX | Motion::RotY => {
                let [from, to] = self.ends();
                0.02 * depth / (0.5 * (to - from)).max(t)
            }
            Motion::RotZ => 0.01,
        }
    }

    /// The image's rate per rad of roll of a bar about its own axis, the side towards +u lowered;
    /// of anything else 0.
    ///
    /// # Errors
    /// None is expected after a contact was found.
    pub(crate) fn rolled(&self) -> Result<Vec<f64>, Invalid> {
        let mut image = vec![0.0; self.array.len()];
        let planar = self.pose.planar;
        match (&self.solver, &self.shares) {
            (Solver::Infinite(bar), _) => {
                if let Some(rate) = bar.roll() {
                    rate.image(&self.array, self.sampling, planar, &mut image)?;
                }
            }
            (Solver::Pin(pin), Some(shares)) => {
                if let Some(rate) = pin.roll()? {
                    rate.image(shares, planar, &mut image);
                }
            }
            _ => {}
        }
        Ok(image)
    }
}
