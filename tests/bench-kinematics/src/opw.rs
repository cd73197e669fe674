//! The library rs-opw-kinematics on the same arm. It is timed only when its forward kinematics are
//! ours.

use anyhow::{Result, ensure};
use glam_opw::{DMat3, DQuat, DVec3};
use rs_opw_kinematics::kinematic_traits::{Kinematics, Pose as OpwPose};
use rs_opw_kinematics::kinematics_impl::OPWKinematics;
use rs_opw_kinematics::parameters::opw_kinematics::Parameters;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::{Joints, Pose};

/// The arm in its terms: upright at its zero, turns of joints 2, 3 and 5 the other way round.
pub fn arm() -> OPWKinematics {
    let arm = Puma260::reference();
    let half = core::f64::consts::FRAC_PI_2;
    OPWKinematics::new(Parameters {
        a1: 0.0,
        a2: 0.0,
        b: -arm.d3_m,
        c1: 0.0,
        c2: arm.a2_m,
        c3: arm.d4_m,
        c4: 0.0,
        offsets: [0.0, -half, half, 0.0, 0.0, 0.0],
        sign_corrections: [1, -1, -1, 1, -1, 1],
        dof: 6,
    })
}

/// A pose in its type.
pub fn pose(pose: &Pose) -> OpwPose {
    let rotation = DQuat::from_mat3(&DMat3::from_cols_array(&pose.rotation.to_cols_array()));
    OpwPose::from_parts(DVec3::from_array(pose.translation.to_array()), rotation)
}

/// Entries by which a pose of its type misses one of ours.
pub fn miss(got: &OpwPose, want: &Pose) -> f64 {
    let rotation = DMat3::from_quat(got.rotation).to_cols_array();
    let place = (got.translation - DVec3::from_array(want.translation.to_array())).length();
    let entries = rotation.iter().zip(want.rotation.to_cols_array());
    entries.fold(place, |most, (a, b)| most.max((a - b).abs()))
}

/// That both mean the same arm.
///
/// # Errors
/// They do not.
pub fn check(opw: &OPWKinematics, q: &[Joints]) -> Result<()> {
    let arm = Puma260::reference();
    for q in q {
        let off = miss(&opw.forward(&(*q).into()), &arm.wrist_pose(q));
        ensure!(off < 1e-12, "rs-opw-kinematics is another arm: off by {off:e}");
    }
    Ok(())
}
