//! `[hand]`: what the fingers of a hand find between them: a free rigid object, the support on
//! which it stands, and pushes from outside. A size that the shape does not have and pushes that
//! end before they begin are errors.

use serde::Deserialize;

use super::section::{Consistency, inside, names, section};
use super::{Invalid, invalid};

taktil_hal::explained! {
    /// The shape of the object.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum HeldShape {
        /// A sphere of `radius_mm`.
        #[default]
        Sphere,
        /// A cylinder of `radius_mm` and `length_mm`, its axis upright at the start.
        Cylinder,
        /// A box with the sides `size_mm`.
        Cuboid,
    }
}

names!(HeldShape);

/// The most pushes of a scene.
pub const PUSHES_MAX: usize = 32;

section! {
    /// `[hand]`: the object of a scene whose machine is a hand. The fingertips' rubber, friction
    /// and arrays are those of `[finger]` and `[tactile]`, the same for every finger.
    #[serde(default)]
    pub struct HandConfig {
        /// `sphere` (default), `cylinder` or `cuboid`.
        shape: HeldShape,
        /// Radius of a sphere or a cylinder (mm). Default 25.
        radius_mm: f64 [5.0, 200.0],
        /// Length of a cylinder (mm). Default 60.
        length_mm: f64 [5.0, 500.0],
        /// Sides of a box along its x, y and z (mm). Default 40, 40 and 60.
        size_mm: [f64; 3] [5.0, 500.0],
        /// Mass (kg), homogeneous. Default 0.1.
        mass_kg: f64 [1e-4, 10.0],
        /// Start of its centre along x0 (mm). Default 0.
        x_mm: f64 [-1000.0, 1000.0],
        /// Start of its centre along y0 (mm). Default 0.
        y_mm: f64 [-1000.0, 1000.0],
        /// Its turn about z0 at the start (deg). Default 0.
        yaw_deg: f64 [-180.0, 180.0],
        /// Height of the support's surface (mm, base frame), on which the object stands at the
        /// start. Default -150.
        support_mm: f64 [-2000.0, 2000.0],
        /// Stiffness of the support under each point of the object that touches it (N/mm). Default
        /// 20.
        support_n_mm: f64 [0.01, 10000.0],
        /// Coulomb coefficient of the support against the object. Default 0.4.
        support_friction: f64 [0.0, 5.0],
        /// When the support is taken away (s); never when absent.
        support_until_s: Option<f64> [0.0, 1e6],
        /// Pushes from outside. Default none; at most 32.
        push: Vec<PushConfig>,
    }
}

section! {
    /// `[[hand.push]]`: a force on the object.
    #[derive(Copy)]
    pub struct PushConfig {
        /// Start (s).
        from_s: f64 [0.0, 1e6],
        /// End (s).
        to_s: f64 [0.0, 1e6],
        /// The force (N), base frame.
        force_n: [f64; 3] [-1000.0, 1000.0],
        /// Where it acts, from the object's centre in its own axes (mm). Default its centre.
        #[serde(default)]
        at_mm: [f64; 3] [-1000.0, 1000.0],
        /// Time in which it grows after the start and dies away before the end, evenly (s). Default
        /// 0.05.
        #[serde(default = "ramp_s")]
        ramp_s: f64 [0.0, 1e3],
    }
}

fn ramp_s() -> f64 {
    0.05
}

impl PushConfig {
    /// The part of the force that acts at an instant (s).
    #[must_use]
    pub fn share(&self, t_s: f64) -> f64 {
        if !(t_s > self.from_s && t_s < self.to_s) {
            return 0.0;
        }
        if self.ramp_s == 0.0 {
            return 1.0;
        }
        ((t_s - self.from_s).min(self.to_s - t_s) / self.ramp_s).min(1.0)
    }
}

impl Consistency for PushConfig {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        if self.to_s <= self.from_s {
            let what = format!("is {}, not after from_s = {}", self.to_s, self.from_s);
            return Err(invalid(&inside(place, "to_s"), what, "end the push after its start"));
        }
        Ok(())
    }
}

impl Consistency for HandConfig {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        if self.push.len() > PUSHES_MAX {
            let what = format!("has {} pushes", self.push.len());
            let remedy = format!("give at most {PUSHES_MAX}");
            return Err(invalid(&inside(place, "push"), what, &remedy));
        }
        Ok(())
    }
}

impl Default for HandConfig {
    fn default() -> HandConfig {
        HandConfig {
            shape: HeldShape::Sphere,
            radius_mm: 25.0,
            length_mm: 60.0,
            size_mm: [40.0, 40.0, 60.0],
            mass_kg: 0.1,
            x_mm: 0.0,
            y_mm: 0.0,
            yaw_deg: 0.0,
            support_mm: -150.0,
            support_n_mm: 20.0,
            support_friction: 0.4,
            support_until_s: None,
            push: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn push(from_s: f64, to_s: f64, ramp_s: f64) -> PushConfig {
        PushConfig { from_s, to_s, force_n: [1.0, 0.0, 0.0], at_mm: [0.0; 3], ramp_s }
    }

    #[test]
    fn a_push_grows_and_dies_away() {
        let one = push(1.0, 2.0, 0.2);
        for (t_s, share) in [(0.5, 0.0), (1.1, 0.5), (1.5, 1.0), (1.9, 0.5), (2.5, 0.0)] {
            assert!((one.share(t_s) - share).abs() < 1e-12, "{t_s}");
        }
        assert_eq!(push(1.0, 2.0, 0.0).share(1.0001), 1.0);
        assert_eq!(push(1.0, 2.0, 0.0).share(f64::NAN), 0.0);
    }

    #[test]
    fn a_push_that_ends_before_it_begins_is_refused() {
        let bad = push(2.0, 1.0, 0.1).check_consistency("hand.push[0]").unwrap_err();
        assert_eq!(bad.place, "hand.push[0].to_s");
    }
}
