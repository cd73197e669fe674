//! `[[object]]`: rigid bodies that stand on the table and move with it, for the finger to touch. A
//! size that belongs to another kind and a shape that crosses itself are errors.

use serde::Deserialize;

use super::section::{Consistency, inside, names, section};
use super::{Invalid, invalid};

taktil_hal::explained! {
    /// The kind of an object.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum ObjectKind {
        /// A sphere, of which the finger reaches the upper side.
        Sphere,
        /// A plate on its edge: a rounded ridge along a curve.
        Edge,
        /// A bar with a flat face and sharp edges.
        Bar,
    }
}

taktil_hal::explained! {
    /// The curve along which an edge runs, seen from above.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum EdgeProfile {
        /// Straight from end to end.
        #[default]
        Straight,
        /// Straight to its origin, from there on an arc.
        Arc,
        /// Straight to its origin, straight on from there in another direction.
        Corner,
    }
}

names!(ObjectKind, EdgeProfile);

/// Largest number of objects in a scene.
pub const OBJECTS_MAX: usize = 4;

section! {
    /// `[[object]]`: a rigid body fixed to the table. Its own frame stands at its top, z out of the
    /// table; ridges and bars run along its y. It has no contact with the pin.
    #[derive(Copy)]
    pub struct ObjectConfig {
        /// `sphere`, `edge` or `bar`.
        kind: ObjectKind,
        /// Place along x0, counted from the finger's start (mm). Default 0.
        #[serde(default)]
        x_mm: f64 [-1000.0, 1000.0],
        /// Place along y0, counted from the finger's start (mm). Default 0.
        #[serde(default)]
        y_mm: f64 [-1000.0, 1000.0],
        /// Height of its top over the table's surface (mm). Default 46, as high as the default pin.
        #[serde(default = "top_mm")]
        top_mm: f64 [0.0, 1000.0],
        /// Turn about the table's normal, from x towards y (deg). Default 0.
        #[serde(default)]
        yaw_deg: f64 [-180.0, 180.0],
        /// Turn about its own x after `yaw_deg`: the top rises towards +y (deg). Default 0.
        #[serde(default)]
        tilt_x_deg: f64 [-30.0, 30.0],
        /// Turn about its own y after `tilt_x_deg`: the top rises towards +x (deg). Default 0.
        #[serde(default)]
        tilt_y_deg: f64 [-30.0, 30.0],
        /// Radius of a sphere (default 20), or of the rounding of an edge (default 1.5) (mm).
        radius_mm: Option<f64> [0.2, 2000.0],
        /// Length of an edge along its curve, half of it before the origin (default 120), or of a
        /// bar (default 20) (mm).
        length_mm: Option<f64> [1.0, 600.0],
        /// Width of a bar's face (mm). Default 4.
        width_mm: Option<f64> [0.2, 25.0],
        /// Curve of an edge: `straight` (default), `arc` or `corner`.
        profile: Option<EdgeProfile>,
        /// Radius of an arc (mm); a positive one bends from y towards -x, a negative one to +x.
        arc_radius_mm: Option<f64> [-2000.0, 2000.0],
        /// Turn of the edge's direction at a corner, from y towards -x (deg).
        corner_deg: Option<f64> [-120.0, 120.0],
        /// Coulomb coefficient against the finger. Default that of `[finger]`.
        friction: Option<f64> [0.0, 5.0],
    }
}

fn top_mm() -> f64 {
    46.0
}

/// Smallest radius of an edge's arc, in radii of its rounding.
const BEND_RADIUS_MIN_RADII: f64 = 3.0;

impl ObjectConfig {
    /// An object of this kind with default values: under the finger's start, as high as the default
    /// pin.
    #[must_use]
    pub fn of(kind: ObjectKind) -> ObjectConfig {
        ObjectConfig {
            kind,
            x_mm: 0.0,
            y_mm: 0.0,
            top_mm: top_mm(),
            yaw_deg: 0.0,
            tilt_x_deg: 0.0,
            tilt_y_deg: 0.0,
            radius_mm: None,
            length_mm: None,
            width_mm: None,
            profile: None,
            arc_radius_mm: None,
            corner_deg: None,
            friction: None,
        }
    }

    /// The keys that belong to some kinds only: name, whether it is given, and those kinds.
    fn kind_specific_keys(&self) -> [(&'static str, bool, &'static [ObjectKind]); 6] {
        use ObjectKind::{Bar, Edge, Sphere};
        [
            ("radius_mm", self.radius_mm.is_some(), &[Sphere, Edge]),
            ("length_mm", self.length_mm.is_some(), &[Edge, Bar]),
            ("width_mm", self.width_mm.is_some(), &[Bar]),
            ("profile", self.profile.is_some(), &[Edge]),
            ("arc_radius_mm", self.arc_radius_mm.is_some(), &[Edge]),
            ("corner_deg", self.corner_deg.is_some(), &[Edge]),
        ]
    }

    /// Radius of the sphere or of the edge's rounding (mm).
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.radius_mm.unwrap_or(if self.kind == ObjectKind::Sphere { 20.0 } else { 1.5 })
    }

    /// Length of the edge or the bar (mm).
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length_mm.unwrap_or(if self.kind == ObjectKind::Edge { 120.0 } else { 20.0 })
    }

    fn check_curve(&self, place: &str) -> Result<(), Invalid> {
        let profile = self.profile.unwrap_or_default();
        let rows = [
            ("arc_radius_mm", self.arc_radius_mm.is_some(), EdgeProfile::Arc, "arc"),
            ("corner_deg", self.corner_deg.is_some(), EdgeProfile::Corner, "corner"),
        ];
        for (key, given, of, name) in rows {
            if given && profile != of {
                let what = format!("belongs to the profile {name}");
                let remedy = format!("leave it out, or say profile = \"{name}\"");
                return Err(invalid(&inside(place, key), what, &remedy));
            }
            if !given && profile == of {
                let what = format!("is {name}, but has no {key}");
                return Err(invalid(&inside(place, "profile"), what, "state it"));
            }
        }
        let Some(arc_radius_mm) = self.arc_radius_mm else { return Ok(()) };
        let least = BEND_RADIUS_MIN_RADII * self.radius();
        if arc_radius_mm.abs() < least {
            let what = format!(
                "is {arc_radius_mm}, sharper than {BEND_RADIUS_MIN_RADII} times the rounding"
            );
            let remedy = format!("give at least {least} either way, or a corner");
            return Err(invalid(&inside(place, "arc_radius_mm"), what, &remedy));
        }
        // An arc of more than half a circle would meet the straight part again.
        if 0.5 * self.length() > core::f64::consts::PI * arc_radius_mm.abs() {
            let what = format!("is {}: the arc would close", self.length());
            return Err(invalid(&inside(place, "length_mm"), what, "shorten it, or bend less"));
        }
        Ok(())
    }
}

impl Consistency for ObjectConfig {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        for (key, given, kinds) in self.kind_specific_keys() {
            if given && !kinds.contains(&self.kind) {
                let what = format!("is not for a {:?}", self.kind).to_lowercase();
                return Err(invalid(&inside(place, key), what, "leave it out"));
            }
        }
        self.check_curve(place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::section::Value;

    fn place(kind: ObjectKind, change: impl Fn(&mut ObjectConfig)) -> Option<String> {
        let mut config = ObjectConfig::of(kind);
        change(&mut config);
        config.check("object[0]", None).err().map(|bad| bad.place)
    }

    #[test]
    fn every_kind_is_sound_as_it_comes() {
        for kind in [ObjectKind::Sphere, ObjectKind::Edge, ObjectKind::Bar] {
            assert_eq!(place(kind, |_| {}), None);
        }
    }

    #[test]
    fn wrong_values_are_refused_with_their_place() {
        use ObjectKind::{Bar, Edge, Sphere};
        let at = |key: &str| Some(format!("object[0].{key}"));
        for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0] {
            assert_eq!(place(Sphere, |c| c.radius_mm = Some(bad)), at("radius_mm"));
            assert_eq!(place(Edge, |c| c.length_mm = Some(bad)), at("length_mm"));
            assert_eq!(place(Bar, |c| c.width_mm = Some(bad)), at("width_mm"));
        }
        assert_eq!(place(Sphere, |c| c.top_mm = f64::NAN), at("top_mm"));
        assert_eq!(place(Sphere, |c| c.friction = Some(-0.1)), at("friction"));
        assert_eq!(place(Sphere, |c| c.width_mm = Some(3.0)), at("width_mm"));
        assert_eq!(place(Bar, |c| c.radius_mm = Some(3.0)), at("radius_mm"));
        assert_eq!(place(Sphere, |c| c.profile = Some(EdgeProfile::Arc)), at("profile"));
        assert_eq!(place(Edge, |c| c.arc_radius_mm = Some(50.0)), at("arc_radius_mm"));
        assert_eq!(place(Edge, |c| c.profile = Some(EdgeProfile::Arc)), at("profile"));
        let arc = |bend: f64| {
            place(Edge, move |c| {
                (c.profile, c.arc_radius_mm) = (Some(EdgeProfile::Arc), Some(bend))
            })
        };
        assert_eq!(arc(50.0), None);
        assert_eq!(arc(-50.0), None);
        assert_eq!(arc(2.0), at("arc_radius_mm"));
        assert_eq!(arc(15.0), at("length_mm"));
    }
}
