//! The level support on which the object stands until the hand holds it: points of the object on
//! springs with dampers, with Coulomb friction that is regularised by a small speed. An object that
//! is pushed along the support therefore creeps, by at most [`CREEP_SPEED_M_S`] at the limit.

use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, SMatrix};
use taktil_mechanics::Matrix6;
use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::spatial::to_nalgebra_vector;

use super::object::{Motion, SUPPORT_POINTS_MAX, Solid};
use crate::scene::HandConfig;

/// Speed at which friction of the support reaches 0.71 of its limit (m/s).
const CREEP_SPEED_M_S: f64 = 1e-4;
/// Damping of a point over its stiffness (s).
const DAMPING_S: f64 = 2e-3;

/// The support of a scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Support {
    height_m: f64,
    stiffness_n_m: f64,
    friction: f64,
    /// When it is taken away (s).
    until_s: f64,
}

/// Forces of the support on an object about its centre, base axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct SupportLoad {
    pub(super) force: DVec3,
    pub(super) moment: DVec3,
    /// Derivative of force and moment per velocity and spin at the step's end.
    pub(super) derivative: Matrix6,
    pub(super) normal_n: f64,
}

impl Support {
    pub(super) fn new(config: &HandConfig) -> Support {
        Support {
            height_m: 1e-3 * config.support_mm,
            stiffness_n_m: 1e3 * config.support_n_mm,
            friction: config.support_friction,
            until_s: config.support_until_s.unwrap_or(f64::INFINITY),
        }
    }

    /// Height of the centre of a body that rests on the support (m): its lowest points carry it.
    pub(super) fn rest_z_m(&self, solid: &Solid, rotation: &DMat3, mass_kg: f64) -> f64 {
        let mut points = [DVec3::ZERO; SUPPORT_POINTS_MAX];
        let count = solid.support_points(rotation, &mut points);
        let height = solid.rest_height_m(rotation);
        let touching = points[..count].iter().filter(|point| point.z < 1e-9 - height).count();
        let sunk = mass_kg * GRAVITY_M_S2 / (self.stiffness_n_m * touching.max(1) as f64);
        self.height_m + height - sunk
    }

    /// The forces at the end, at `end_s`, of a step of `h` seconds; none once it is taken away.
    pub(super) fn evaluate(
        &self,
        solid: &Solid,
        object: &Motion,
        end_s: f64,
        h: f64,
    ) -> Option<SupportLoad> {
        let centre = object.pose.translation;
        if end_s > self.until_s || centre.z - solid.bound_m() > self.height_m {
            return None;
        }
        let mut points = [DVec3::ZERO; SUPPORT_POINTS_MAX];
        let count = solid.support_points(&object.pose.rotation, &mut points);
        let mut load = SupportLoad {
            force: DVec3::ZERO,
            moment: DVec3::ZERO,
            derivative: Matrix6::zeros(),
            normal_n: 0.0,
        };
        for point in &points[..count] {
            let depth = self.height_m - (centre.z + point.z);
            let speed = object.velocity + object.spin.cross(*point);
            let normal = self.stiffness_n_m * (depth - DAMPING_S * speed.z);
            if depth <= 0.0 || normal <= 0.0 {
                continue;
            }
            let (x, y) = (speed.x, speed.y);
            let size = (x * x + y * y + CREEP_SPEED_M_S * CREEP_SPEED_M_S).sqrt();
            let most = self.friction * normal;
            let force = DVec3::new(-most * x / size, -most * y / size, normal);
            let rise = -self.stiffness_n_m * (h + DAMPING_S);
            let bend = most / (size * size * size);
            let own = Matrix3::new(
                -most / size + bend * x * x,
                bend * x * y,
                -self.friction * rise * x / size,
                bend * x * y,
                -most / size + bend * y * y,
                -self.friction * rise * y / size,
                0.0,
                0.0,
                rise,
            );
            load.force += force;
            load.moment += point.cross(force);
            load.normal_n += normal;
            let cross = to_nalgebra_vector(*point).cross_matrix();
            // A point's velocity is v - [p]x w, its moment [p]x f.
            let mut pick = SMatrix::<f64, 3, 6>::zeros();
            pick.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
            pick.fixed_columns_mut::<3>(3).copy_from(&(-cross));
            load.derivative += pick.transpose() * own * pick;
        }
        Some(load)
    }
}
