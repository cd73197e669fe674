//! Chooses how deep the tables of a scene are: as deep as the contact needs. A contact beyond the
//! deepest tables is an error.

use super::super::pin::Pin;
use super::{Accuracy, Invalid, Prescribed, Scene, SceneState, Solver};

/// Largest part of the thickness that tables are made for.
const TABLE_DEPTH_MAX: f64 = 0.98;
/// Part of a force that the fast accuracy has to reach: its error is certainly smaller than the
/// rest.
const CERTAIN_FORCE_PART: f64 = 0.95;
/// Factor from the depth that the fast accuracy needs for that part to the depth of the tables.
/// Much deeper tables would need more cosines in every contact.
const ESTIMATE_FACTOR: f64 = 1.15;
/// The search for the depth of the tables ends when the deepest too shallow tables and the
/// shallowest impossible ones are this close, in thicknesses.
const DEPTH_RESOLUTION: f64 = 2e-3;
/// Factor from a prescribed penetration to the depth of its tables.
pub(super) const DEPTH_FACTOR: f64 = 1.1;

impl Scene {
    /// Presses with tables that reach deeper and deeper until they suffice.
    pub(super) fn press_with_tables(
        &mut self,
        prescribed: Prescribed,
        first_mm: f64,
        ends: [f64; 2],
        mut press: impl FnMut(&mut Solver, f64, bool) -> Result<SceneState, Invalid>,
    ) -> Result<SceneState, Invalid> {
        let t = self.layer.thickness_mm;
        let same = self.room.1 == ends && !matches!(self.solver, Solver::Empty);
        let fits = same
            && (matches!(prescribed, Prescribed::ForceN(_))
                || first_mm <= DEPTH_FACTOR * self.room.0);
        if fits {
            match press(&mut self.solver, self.room.0, false) {
                Err(error) if !is_beyond_table(&error) => return Err(error),
                Ok(state) => return Ok(state),
                Err(_) => {}
            }
        }
        let mut most = first_mm.max(0.02 * t).min(TABLE_DEPTH_MAX * t);
        // Depths of tables known to be too shallow (for a penetration without trying), and of
        // tables that cannot be made.
        let known =
            if matches!(prescribed, Prescribed::ForceN(_)) { 0.0 } else { most / DEPTH_FACTOR };
        let (mut shallow, mut limit) = (known, f64::INFINITY);
        let mut asked = false;
        loop {
            self.room = (most, ends);
            let apart = DEPTH_RESOLUTION * t;
            match press(&mut self.solver, most, true) {
                Err(error)
                    if is_beyond_table(&error)
                        && most < (limit - apart).min(TABLE_DEPTH_MAX * t) =>
                {
                    shallow = most;
                }
                Err(error) if cannot_be_made(&error) && most > shallow + apart => limit = most,
                Err(error) => return Err(as_unreachable(error, prescribed)),
                Ok(state) => return Ok(state),
            }
            let asks = shallow > 0.0 && !core::mem::replace(&mut asked, true);
            let estimated_depth =
                if asks { self.estimated_depth(prescribed, ends) } else { Ok(0.0) };
            let estimated_depth =
                estimated_depth.map_err(|error| as_unreachable(error, prescribed))?;
            most =
                if estimated_depth > most { ESTIMATE_FACTOR * estimated_depth } else { 2.0 * most };
            if most >= limit {
                most = 0.5 * (shallow + limit);
            }
            most = most.min(TABLE_DEPTH_MAX * t);
        }
    }

    /// Lower bound of the depth (mm) that the tables of a pin need for a force, found at the fast
    /// accuracy, whose tables are cheap; 0 where there is none.
    ///
    /// # Errors
    /// A force that is certainly beyond all tables.
    fn estimated_depth(&self, prescribed: Prescribed, ends: [f64; 2]) -> Result<f64, Invalid> {
        let (Prescribed::ForceN(force), Solver::Pin(_)) = (prescribed, &self.solver) else {
            return Ok(0.0);
        };
        if self.level == Accuracy::Fast {
            return Ok(0.0);
        }
        let deepest = TABLE_DEPTH_MAX * self.layer.thickness_mm;
        // Tables this deep may be impossible for a small indenter or a thin layer.
        let made = Pin::new(&self.layer, self.profile(), ends, deepest, Accuracy::Fast);
        let Ok(mut pin) = made else { return Ok(0.0) };
        let slope = libm::tan(self.pose.tilt_rad);
        match pin
            .press(Prescribed::ForceN(CERTAIN_FORCE_PART * force), self.pose.tilt_rad)
            .map_err(Invalid::from)
        {
            Ok(state) => Ok(state.penetration_mm + (slope * ends[0]).max(slope * ends[1])),
            Err(error) if is_beyond_table(&error) => Err(error),
            Err(_) => Ok(0.0),
        }
    }
}

/// Whether a larger table would help.
fn is_beyond_table(error: &Invalid) -> bool {
    error.what == super::super::BEYOND_TABLE
}

/// Whether a shallower table would help.
fn cannot_be_made(error: &Invalid) -> bool {
    error.place == "penetration_max_mm"
}

/// Replaces an error about the tables by one about the prescribed quantity, which the caller knows.
fn as_unreachable(error: Invalid, prescribed: Prescribed) -> Invalid {
    if is_beyond_table(&error) || cannot_be_made(&error) {
        let what = "no contact of this indenter on this layer reaches it".to_owned();
        return Invalid::new(
            prescribed.place(),
            what,
            "press less, or use another size of indenter",
        );
    }
    error
}

#[cfg(test)]
mod tests {
    use super::super::super::super::layer::Layer;
    use super::super::super::tactels::{Array, Sampling};
    use super::super::{Accuracy, Invalid, Pose, Prescribed, Scene, SceneState, Shape};

    fn scene(level: Accuracy) -> Scene {
        let layer = Layer::new(0.8, 27.58, 0.49).expect("a layer");
        let shape = Shape::Cylinder { radius_mm: 6.0, length_mm: Some(5.0) };
        Scene::new(&layer, shape, &Array::THESIS, Sampling::Area, level).expect("a scene")
    }

    /// At the scene's own accuracy only the first tables are made.
    #[test]
    fn the_fast_accuracy_refuses_a_force_far_beyond_the_tables() {
        for level in [Accuracy::Default, Accuracy::Fine] {
            let mut scene = scene(level);
            let refused =
                scene.press(Prescribed::ForceN(1e6), Pose::default()).expect_err("too much");
            assert_eq!(refused.place, "force_n");
            assert!((scene.room.0 - 0.08).abs() < 1e-12, "{level:?} {}", scene.room.0);
        }
    }

    /// The tables are not much deeper than the force needs, for level and tilted pins.
    #[test]
    fn a_force_gets_tables_just_deep_enough() {
        for tilt_rad in [0.0, 0.03, -0.1] {
            let mut direct = scene(Accuracy::Default);
            let pose = Pose { tilt_rad, ..Pose::default() };
            let delta = 0.2 - 2.5 * libm::tan(f64::abs(tilt_rad));
            let deep = direct.press(Prescribed::PenetrationMm(delta), pose).expect("a contact");
            let mut by_force = scene(Accuracy::Default);
            let found = by_force.press(Prescribed::ForceN(deep.force_n), pose).expect("the same");
            assert!((0.2..0.24).contains(&by_force.room.0), "{tilt_rad}: {}", by_force.room.0);
            let off = found.penetration_mm.expect("a depth") - delta;
            assert!(off.abs() < 2e-4, "{found:?} {deep:?}");
        }
    }

    /// Small indenters, and layers much thinner than their contacts are wide, have no contacts as
    /// deep as tables may be. The tables for a force are found nevertheless.
    #[test]
    fn a_force_is_reached_where_the_deepest_tables_cannot_be_made() {
        for (t, poisson, radius_mm, part) in [
            (0.8, 0.3, 0.3, 0.18),
            (0.8, 0.5, 1.0, 0.18),
            (0.8, 0.5, 0.3, 0.3),
            (0.05, 0.5, 45.0, 0.2),
        ] {
            for tilt_rad in [0.0, 0.02, -0.04] {
                if t < 0.1 && tilt_rad != 0.0 {
                    continue;
                }
                let layer = Layer::new(t, 27.58, poisson).expect("a layer");
                let shape = Shape::Cylinder { radius_mm, length_mm: Some(5.0) };
                let made = || {
                    let array = Array::THESIS;
                    Scene::new(&layer, shape, &array, Sampling::Area, Accuracy::Default)
                };
                let pose = Pose { tilt_rad, ..Pose::default() };
                let delta = part * t - 2.5 * libm::tan(f64::abs(tilt_rad));
                let mut direct = made().expect("a scene");
                let deep = direct.press(Prescribed::PenetrationMm(delta), pose).expect("a contact");
                let found = made().expect("a scene").press(Prescribed::ForceN(deep.force_n), pose);
                let found = found.unwrap_or_else(|error| panic!("{t} {radius_mm}: {error}"));
                let off = found.penetration_mm.expect("a depth") - delta;
                assert!(off.abs() < 1e-3 * part * t, "{found:?} {deep:?}");
            }
        }
    }
    /// The bisection between too shallow tables and impossible ones takes few steps, whether the
    /// force can be reached or not.
    #[test]
    fn few_tables_are_tried_below_those_that_cannot_be_made() {
        let mut tried = Vec::new();
        let mut grown = |enough_mm: f64| {
            tried.clear();
            let found = scene(Accuracy::Default).press_with_tables(
                Prescribed::ForceN(1.0),
                0.08,
                [-2.5, 2.5],
                |_, most, _| {
                    tried.push(most);
                    if most > 0.3 {
                        Err(Invalid::new("penetration_max_mm", String::new(), ""))
                    } else if most < enough_mm {
                        Err(Invalid::new(
                            "force_n",
                            super::super::super::BEYOND_TABLE.to_owned(),
                            "",
                        ))
                    } else {
                        Ok(SceneState::default())
                    }
                },
            );
            (found.is_ok(), tried.len())
        };
        let (found, count) = grown(0.297);
        assert!(found && count <= 10, "{count}");
        let (found, count) = grown(f64::INFINITY);
        assert!(!found && count <= 12, "{count}");
    }
}
