//! Feature Jacobians in plane strain: how the features of the stress at a depth change as the
//! indenter is moved and turned, by exact differentiation.
//!
//! While a contact grows or recedes its edges carry no pressure, so the rate of the pressure is
//! that of the same interval with its edges held: a glued or frictionless punch that is moved as
//! the indenter is. No differences are taken. The rates of the moments are linear in that of the
//! pressure; those of centroid and peak follow by the rules for quotients and implicit functions.
//!
//! x is measured from the indenter's centre line. [`Motion::Z`] is into the layer, [`Motion::RotY`]
//! a right-handed turn about the centre of the indenter's face that lowers its side towards +x; a
//! round indenter turns about its own axis, which changes nothing unless it is glued. The other
//! motions are zero, and under proportional friction the ratio Q/P is constant.
//!
//! Derivatives are absent where nothing touches; those of the peak are absent for a stress without
//! compression. Differentiating allocates.

use super::features::{Compressive, Moments, compressive, compressive_rate, moments};
use super::spectrum::{PointForce, Spectrum};
use super::{Friction, Indenter, Mode, Refusal, Shape};
use crate::layer::Layer;

/// A motion of the indenter; mm and rad.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Along x: over the layer when it slides, taking the surface along when it is held.
    X,
    /// Into the layer.
    Z,
    /// About y.
    RotY,
}

/// A feature of the stress szz at one depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feature {
    /// Moment of this order, 0 to 3, over the infinite layer.
    Moment(usize),
    /// Centroid M1/M0.
    Centroid,
    /// Moment of the compressive part over the sensor.
    CompressiveMoment(usize),
    /// Its centroid.
    CompressiveCentroid,
    /// Place of the largest compression.
    PeakPlace,
    /// Stress there.
    PeakStress,
}

/// Rate of the tractions per unit of a motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TractionRate {
    /// Change of the concentrated forces, per mm or rad.
    pub forces: Vec<PointForce>,
    /// Shift of the whole traction along x, mm per mm or rad.
    pub shift: f64,
}

impl Indenter {
    /// The rate of the last contact's tractions under a motion, for stresses at `depth_mm` and
    /// below; none where nothing touches.
    ///
    /// # Errors
    /// See [`Refusal`]; none is expected after a solution.
    pub fn rate(&mut self, motion: Motion, depth_mm: f64) -> Result<Option<TractionRate>, Refusal> {
        let contact = self.contact;
        if contact.mode == Mode::Open || self.phi.is_empty() {
            return Ok(None);
        }
        let round = matches!(self.shape, Shape::Cylinder { .. } | Shape::Parabola { .. });
        match motion {
            Motion::X => return Ok(Some(TractionRate { forces: Vec::new(), shift: 1.0 })),
            Motion::RotY if round => return Ok(Some(TractionRate::default())),
            Motion::Z | Motion::RotY => {}
        }
        let t = self.layer.thickness_mm;
        let half = 0.5 * (contact.x_right_mm - contact.x_left_mm) / t;
        let centre = 0.5 * (contact.x_right_mm + contact.x_left_mm) / t;
        let load = super::Load { p_n_mm: contact.p_n_mm, q_n_mm: contact.q_n_mm };
        let ratio = self.ratio(&load);
        self.assemble(half, ratio)?;
        let (interval, [punch, tilted]) = (&mut self.interval, &mut self.work);
        interval.solve(1.0, |_| 0.0, punch);
        let per_force = interval.mean_descent(&self.kernels, punch);
        // Pressure per thickness of descent; per rad of tilt about x = 0 as the descent is x.
        let mut force = 1.0 / per_force;
        if motion == Motion::RotY {
            interval.solve(0.0, |_| 1.0, tilted);
            let wanted = centre + half * interval.mean(|xi| xi);
            force *= wanted - interval.mean_descent(&self.kernels, tilted);
        } else {
            tilted.clear();
            tilted.resize(punch.len(), 0.0);
        }
        // Per mm of descent, or per rad: the place of a tilt is in thicknesses too.
        let scale = if motion == Motion::Z { 1.0 / t } else { 1.0 };
        let phi: Vec<f64> =
            punch.iter().zip(tilted).map(|(p, d)| scale * (force * p + *d)).collect();
        let ratio = if self.friction == Friction::None { 0.0 } else { ratio };
        Ok(Some(TractionRate { forces: self.forces_of(&phi, ratio, depth_mm), shift: 0.0 }))
    }
}

/// The stress of a contact, its features and their derivatives.
pub struct StressFeatures {
    layer: Layer,
    stress: Spectrum,
    reach_mm: f64,
    full: Moments,
    part: Compressive,
}

impl StressFeatures {
    /// The stress at a depth under forces on the surface; `symmetric` as in [`compressive`].
    #[must_use]
    pub fn new(layer: &Layer, forces: &[PointForce], depth_mm: f64, symmetric: bool) -> Self {
        let far = forces.iter().map(|f| f[0].abs()).fold(super::features::SENSOR_HALF_MM, f64::max);
        let reach_mm = far + 20.0 * layer.thickness_mm;
        let stress = Spectrum::new(layer, forces, depth_mm, reach_mm);
        let part = compressive(&stress, symmetric, &[]);
        Self { layer: *layer, reach_mm, full: moments(layer, forces, depth_mm), part, stress }
    }

    /// The features themselves; absent where undefined.
    #[must_use]
    pub fn features(&self, features: &[Feature]) -> Vec<Option<f64>> {
        let peak = self.part.szz_peak_mpa < 0.0;
        let one = |feature: &Feature| match *feature {
            Feature::Moment(order) => self.full.m.get(order).copied(),
            Feature::Centroid => self.full.centroid_mm(),
            Feature::CompressiveMoment(order) => self.part.moments.m.get(order).copied(),
            Feature::CompressiveCentroid => self.part.moments.centroid_mm(),
            Feature::PeakPlace => peak.then_some(self.part.x_peak_mm),
            Feature::PeakStress => peak.then_some(self.part.szz_peak_mpa),
        };
        features.iter().map(one).collect()
    }

    /// Derivatives of features under a rate; absent where undefined.
    #[must_use]
    pub fn derivatives(&self, rate: &TractionRate, features: &[Feature]) -> Vec<Option<f64>> {
        let depth = self.stress.depth_mm();
        let change = Spectrum::new(&self.layer, &rate.forces, depth, self.reach_mm);
        let linear = moments(&self.layer, &rate.forces, depth).m;
        let powers = |m: &[f64; 4]| [0.0, m[0], 2.0 * m[1], 3.0 * m[2]];
        let shifted = powers(&self.full.m);
        let full: [f64; 4] = core::array::from_fn(|n| linear[n] + rate.shift * shifted[n]);
        let part = compressive_rate(&self.stress, &change, rate.shift, &self.part.moments);
        let quotient = |m: &[f64; 4], rate: &[f64; 4]| {
            (m[0] != 0.0).then(|| (rate[1] - m[1] / m[0] * rate[0]) / m[0])
        };
        let (x, peak) = (self.part.x_peak_mm, self.part.szz_peak_mpa < 0.0);
        let one = |feature: &Feature| match *feature {
            Feature::Moment(order) => full.get(order).copied(),
            Feature::Centroid => quotient(&self.full.m, &full),
            Feature::CompressiveMoment(order) => part.get(order).copied(),
            Feature::CompressiveCentroid => quotient(&self.part.moments.m, &part),
            Feature::PeakPlace => {
                let bend = self.stress.bend(x);
                (peak && bend > 0.0).then(|| rate.shift - change.slope(x) / bend)
            }
            Feature::PeakStress => peak.then(|| change.szz(x)),
        };
        let finite = |value: Option<f64>| value.filter(|value| value.is_finite());
        features.iter().map(one).map(finite).collect()
    }
}
