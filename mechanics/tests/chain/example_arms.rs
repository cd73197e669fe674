//! Arms for the tests, and repeatable random numbers. Dimensions come from public data sheets and
//! documentation where a maker is named; masses there are estimates.

pub(crate) use core::f64::consts::{FRAC_PI_2, PI};

use crate::dh_rows::UR5E_ROWS;
use glam::{DMat3, DVec3};
use taktil_mechanics::chain::{Chain, DhRow, JointKind, JointSpec};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::rigid_body::Body;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::spatial::{Pose, rotation_from_vector};

/// A linear congruential generator, constants of Knuth's MMIX.
pub(crate) struct Lcg(pub(crate) u64);

impl Lcg {
    pub(crate) fn word(&mut self) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 ^ (self.0 >> 33)
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit")]
        let unit = (self.word() >> 11) as f64 / 9_007_199_254_740_992.0;
        low + (high - low) * unit
    }

    pub(crate) fn inside<const N: usize>(&mut self, arm: &Chain<N>) -> JointVector<N> {
        let limits = arm.limits();
        JointVector::from_fn(|i, _| self.between(limits.q_min[i], limits.q_max[i]))
    }

    pub(crate) fn vector<const N: usize>(&mut self, size: f64) -> JointVector<N> {
        JointVector::from_fn(|_, _| self.between(-size, size))
    }

    pub(crate) fn point(&mut self, size: f64) -> DVec3 {
        DVec3::new(self.between(-size, size), self.between(-size, size), self.between(-size, size))
    }

    pub(crate) fn rotation(&mut self) -> DMat3 {
        rotation_from_vector(self.point(3.0))
    }
}

/// The PUMA 260 as a chain of Denavit-Hartenberg rows, with its bodies and tool.
pub(crate) fn puma() -> Chain<6> {
    puma_with(&Dynamics::reference())
}

/// The same chain with the bodies of `dynamics`.
pub(crate) fn puma_with(dynamics: &Dynamics) -> Chain<6> {
    let arm = Puma260::reference();
    let row = |i: usize, a_m: f64, d_m: f64, alpha_rad: f64| DhRow {
        a_m,
        d_m,
        alpha_rad,
        theta_rad: 0.0,
        spec: JointSpec {
            body: dynamics.bodies()[i],
            q_min: arm.q_min_rad[i],
            q_max: arm.q_max_rad[i],
            speed_max: arm.speed_max_rad_s[i],
            acceleration_max: arm.acceleration_max_rad_s2[i],
            reflected_inertia: dynamics.reflected_inertia_kg_m2[i],
            ..JointSpec::default()
        },
    };
    let rows = [
        row(0, 0.0, 0.0, FRAC_PI_2),
        row(1, arm.a2_m, 0.0, 0.0),
        row(2, 0.0, arm.d3_m, -FRAC_PI_2),
        row(3, 0.0, arm.d4_m, FRAC_PI_2),
        row(4, 0.0, 0.0, -FRAC_PI_2),
        row(5, 0.0, 0.0, 0.0),
    ];
    let tool = Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, arm.tool_z_m));
    Chain::from_dh(&rows, &tool).unwrap()
}

fn body(mass_kg: f64, com_m: [f64; 3]) -> Body {
    let size = 0.01 * mass_kg;
    Body::diagonal(mass_kg, com_m, [size, 1.2 * size, 0.7 * size])
}

/// Six revolute joints, 2 to 4 parallel, no spherical wrist.
pub(crate) fn ur5e_like() -> Chain<6> {
    let masses = [
        (3.761, [0.0, -0.02561, 0.00193], 2.0 * PI),
        (8.058, [0.2125, 0.0, 0.11336], 2.0 * PI),
        (2.846, [0.15, 0.0, 0.0265], PI),
        (1.37, [0.0, -0.0018, 0.01634], 2.0 * PI),
        (1.3, [0.0, 0.0018, 0.01634], 2.0 * PI),
        (0.365, [0.0, 0.0, -0.001159], 2.0 * PI),
    ];
    let row = |i: usize| {
        let ((a_m, d_m, alpha_rad), (mass_kg, com_m, range)) = (UR5E_ROWS[i], masses[i]);
        let spec = JointSpec {
            body: body(mass_kg, com_m),
            q_min: -range,
            q_max: range,
            speed_max: PI,
            acceleration_max: 13.0,
            effort_max: 28.0,
            ..JointSpec::default()
        };
        DhRow { a_m, d_m, alpha_rad, theta_rad: 0.0, spec }
    };
    Chain::from_dh(&core::array::from_fn::<_, 6, _>(row), &Pose::IDENTITY).unwrap()
}

/// Seven revolute joints with offsets at elbow and wrist: rows and limits that Franka Robotics
/// publishes for its arm, which are modified ones, so that each row is the origin of its joint.
pub(crate) fn seven() -> Chain<7> {
    let rows = [
        (0.0, 0.333, 0.0, -2.8973, 2.8973),
        (0.0, 0.0, -FRAC_PI_2, -1.7628, 1.7628),
        (0.0, 0.316, FRAC_PI_2, -2.8973, 2.8973),
        (0.0825, 0.0, FRAC_PI_2, -3.0718, -0.0698),
        (-0.0825, 0.384, -FRAC_PI_2, -2.8973, 2.8973),
        (0.0, 0.0, FRAC_PI_2, -0.0175, 3.7525),
        (0.088, 0.0, FRAC_PI_2, -2.8973, 2.8973),
    ];
    let joints = rows.map(|(a, d, alpha, q_min, q_max)| {
        let twist = taktil_mechanics::spatial::rotation_x(alpha);
        JointSpec {
            origin: Pose::new(twist, DVec3::new(a, 0.0, 0.0) + twist * DVec3::new(0.0, 0.0, d)),
            body: body(2.0, [0.01, -0.03, 0.04]),
            q_min,
            q_max,
            ..JointSpec::default()
        }
    });
    Chain::new(&joints, &Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, 0.107))).unwrap()
}

/// Axes and points of an arm of the family with a spherical wrist, in the base frame at zero.
pub(crate) struct WristArmGeometry {
    pub(crate) axes: [DVec3; 6],
    pub(crate) points: [DVec3; 6],
}

/// Any arm of that family: all offsets, either sign of parallel axes, six_joint_start at zero.
pub(crate) fn random_wrist_arm(lcg: &mut Lcg) -> WristArmGeometry {
    let sign = |lcg: &mut Lcg| if lcg.word() >> 63 == 0 { 1.0 } else { -1.0 };
    let (z, y) = (DVec3::Z, DVec3::Y);
    let shoulder = DVec3::new(lcg.between(-0.2, 0.2), lcg.between(-0.1, 0.1), 0.3);
    let elbow = shoulder + lcg.point(0.2) + DVec3::new(0.1, 0.0, 0.4);
    let centre = elbow + lcg.point(0.15) + DVec3::new(0.4, 0.0, 0.1);
    let wrist = lcg.rotation();
    let six_joint_start = lcg.between(-PI, PI);
    let (s, c) = (libm::sin(six_joint_start), libm::cos(six_joint_start));
    let axes = [
        z * sign(lcg),
        y * sign(lcg),
        y * sign(lcg),
        wrist.z_axis,
        wrist.y_axis * sign(lcg),
        s * wrist.x_axis + c * wrist.z_axis,
    ];
    let on = |lcg: &mut Lcg, point: DVec3, axis: DVec3| point + axis * lcg.between(-0.3, 0.3);
    let points = [
        on(lcg, DVec3::ZERO, axes[0]),
        on(lcg, shoulder, axes[1]),
        on(lcg, elbow, axes[2]),
        on(lcg, centre, axes[3]),
        on(lcg, centre, axes[4]),
        on(lcg, centre, axes[5]),
    ];
    WristArmGeometry { axes, points }
}

impl WristArmGeometry {
    /// The chain, every joint in a frame with a random rotation, on a base with a random pose.
    pub(crate) fn chain(&self, lcg: &mut Lcg) -> Chain<6> {
        let base = Pose::new(lcg.rotation(), lcg.point(0.5));
        let mut before = Pose::IDENTITY;
        let joints: [JointSpec; 6] = core::array::from_fn(|i| {
            let frame = base.compose(&Pose::new(lcg.rotation(), self.points[i]));
            let mount = before.inverse().compose(&frame);
            before = frame;
            JointSpec {
                origin: square(&mount),
                axis: frame.rotation.transpose() * (base.rotation * self.axes[i]),
                q_min: -PI,
                q_max: PI,
                ..JointSpec::default()
            }
        });
        Chain::new(&joints, &Pose::new(lcg.rotation(), lcg.point(0.2))).unwrap()
    }
}

/// The pose with its rotation made orthonormal to rounding.
fn square(pose: &Pose) -> Pose {
    let r = pose.rotation;
    let x = r.x_axis.normalize();
    let z = x.cross(r.y_axis).normalize();
    Pose::new(DMat3::from_cols(x, z.cross(x), z), pose.translation)
}

/// Revolute and prismatic joints in alternation.
pub(crate) fn slider() -> Chain<5> {
    let mut lcg = Lcg(7);
    let joints: [JointSpec; 5] = core::array::from_fn(|i| JointSpec {
        origin: Pose::new(lcg.rotation(), lcg.point(0.4)),
        axis: lcg.point(1.0),
        kind: if i % 2 == 1 { JointKind::Prismatic } else { JointKind::Revolute },
        body: body(1.0 + lcg.between(0.0, 2.0), lcg.point(0.1).to_array()),
        q_min: -0.8,
        q_max: 0.9,
        reflected_inertia: 0.01,
        ..JointSpec::default()
    });
    Chain::new(&joints, &Pose::new(lcg.rotation(), lcg.point(0.2))).unwrap()
}
