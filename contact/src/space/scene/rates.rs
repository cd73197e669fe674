//! Supports the derivatives of a scene: the steps of its motions, the derivative by the roll of a
//! bar, and the same scene at another accuracy, which gives the error.

use super::super::motion::Motion;
use super::{Accuracy, Invalid, Scene, Shape, Solver};

impl Scene {
    /// The scene, without contact, at the accuracy from which the error is estimated: a finer one,
    /// but the fast one for a pin at default accuracy, because a finer pin would take longer than
    /// all the rest.
    pub(crate) fn at_other_level(&self) -> Result<Self, Invalid> {
        let level = match self.level {
            Accuracy::Fast | Accuracy::Fine => Accuracy::Default,
            Accuracy::Default if self.is_pin() => Accuracy::Fast,
            Accuracy::Default => Accuracy::Fine,
        };
        let made = Self::new(&self.layer, self.shape, &self.array, self.sampling, level)?;
        Ok(Self { is_cut: self.is_cut, ..made })
    }

    /// Relative error of a derivative due to the accuracy of a pin; 0 for other indenters, whose
    /// error the other accuracy shows.
    pub(crate) fn accuracy(&self) -> f64 {
        match self.level {
            _ if !self.is_pin() => 0.0,
            Accuracy::Fast => 1e-2,
            Accuracy::Default => 3e-3,
            Accuracy::Fine => 6e-4,
        }
    }

    /// Whether the indenter is solved in slices.
    fn is_pin(&self) -> bool {
        match self.shape {
            Shape::Cylinder { length_mm, .. } | Shape::Bar { length_mm, .. } => {
                length_mm.is_some() || self.pose.tilt_rad != 0.0
            }
            Shape::Sphere { .. } | Shape::Edge { .. } => false,
        }
    }

    /// Whether the indenter is an infinite one with a slope, which the array cuts.
    pub(super) fn is_cut_in_tilt(&self) -> bool {
        match self.shape {
            Shape::Cylinder { length_mm, .. } | Shape::Bar { length_mm, .. } => {
                length_mm.is_none() && self.pose.tilt_rad != 0.0
            }
            Shape::Sphere { .. } | Shape::Edge { .. } => false,
        }
    }

    /// The step of differences along a motion: a small part of the size of the contact. Its depth
    /// is taken at the deeper end, because a tilted indenter may touch with an end only.
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

    /// The derivative of the image by the roll of a bar about its own axis, per rad, where a
    /// positive roll lowers the side towards +u; 0 for other indenters.
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
