//! `[arm.fingertip]`: where on an arm from a URDF file the fingertip is, and which way it looks.
//! Axes that are not of length one, or not at right angles, and places that no hand has are errors.

use glam::{DMat3, DVec3};
use serde::Deserialize;
use taktil_mechanics::Pose;
use taktil_rtcore::Invalid;

use super::{ArmConfig, ArmError};
use crate::source::Source;
use crate::urdf;

/// Farthest place of a fingertip from its link (mm).
const MOUNT_DISTANCE_MAX_MM: f64 = 1000.0;
/// Largest error of the length of an axis, and of the cosine between two.
const AXIS_TOLERANCE: f64 = 1e-6;

taktil_rtcore::explained! {
    /// `[arm.fingertip]`: the frame of the sensor on the arm. It is the tool's frame of all tasks.
    /// Rows, columns and rubber of the fingertip stand in `[tactile_servo.array]` and
    /// `[tactile_servo.model]`, its mass in the URDF file.
    #[derive(Clone, Debug, Default, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct FingertipConfig {
        /// Link of the URDF file that carries the fingertip; the chain ends there. Default: the
        /// arm's `tip`.
        pub link: Option<String>,
        /// Middle of the rubber's face in the frame of the link (mm). Default 0.
        pub at_mm: [f64; 3],
        /// Direction of the sensor's x axis, along which the columns are counted, in the frame of
        /// the link: of length 1. Default (1, 0, 0).
        pub x_axis: Option<[f64; 3]>,
        /// Direction of the sensor's z axis, out of the rubber's face, in the frame of the link: of
        /// length 1, at a right angle to `x_axis`. Default (0, 0, 1).
        pub z_axis: Option<[f64; 3]>,
    }
}

impl FingertipConfig {
    /// The sensor's frame in that of its link.
    ///
    /// # Errors
    /// A place or an axis that is not one; places are relative to the section.
    pub(super) fn pose(&self) -> Result<Pose, Invalid> {
        for (i, mm) in self.at_mm.iter().enumerate() {
            if !(0.0..=MOUNT_DISTANCE_MAX_MM).contains(&mm.abs()) {
                let remedy = format!("give at most {MOUNT_DISTANCE_MAX_MM} mm either way");
                return Err(Invalid::new(format!("at_mm[{i}]"), format!("is {mm}"), remedy));
            }
        }
        let x = unit_axis("x_axis", self.x_axis, DVec3::X)?;
        let z = unit_axis("z_axis", self.z_axis, DVec3::Z)?;
        if x.dot(z).abs() > AXIS_TOLERANCE {
            let what = format!("is {:.6} long in the direction of x_axis", x.dot(z));
            return Err(Invalid::new("z_axis", what, "give an axis at a right angle to x_axis"));
        }
        let x = (x - x.dot(z) * z).normalize();
        let axes = DMat3::from_cols(x, z.cross(x), z);
        Ok(Pose::new(axes, DVec3::from_array(self.at_mm) * 1e-3))
    }
}

/// That the file has the link on which the fingertip is mounted.
pub(super) fn check_mount(config: &ArmConfig, urdf: &Source) -> Result<(), ArmError> {
    let Some(link) = config.fingertip.as_ref().and_then(|fingertip| fingertip.link.as_ref()) else {
        return Ok(());
    };
    let refusal = |what: String, remedy: &str| {
        Err(ArmError::Section(Invalid::new("fingertip.link", what, remedy)))
    };
    if let Some(tip) = config.tip.as_ref().filter(|tip| *tip != link) {
        let what = format!("is `{link}`, but `tip` ends the chain at `{tip}`");
        return refusal(what, "leave one of them out");
    }
    let names = urdf::link_names(&urdf.text)
        .map_err(|bad| ArmError::File(Box::new(urdf::locate(urdf, bad))))?;
    if !names.contains(link) {
        let what = format!("`{}` has no link `{link}`", config.urdf);
        let known = names.iter().rev().take(3).map(String::as_str).collect::<Vec<_>>();
        let remedy = format!("name a link of the file; its last ones are {}", known.join(", "));
        return refusal(what, &remedy);
    }
    Ok(())
}

/// An axis of length one.
fn unit_axis(place: &str, given: Option<[f64; 3]>, default: DVec3) -> Result<DVec3, Invalid> {
    let axis = given.map_or(default, DVec3::from_array);
    let length = axis.length();
    if !(0.0..=AXIS_TOLERANCE).contains(&(length - 1.0).abs()) {
        let what = format!("has the length {length}");
        let remedy = match length > AXIS_TOLERANCE && length.is_finite() {
            true => {
                let [x, y, z] = (axis / length).to_array();
                format!("give a direction of length 1, such as [{x:.7}, {y:.7}, {z:.7}]")
            }
            false => "give a direction of length 1, such as [0.0, 0.0, 1.0]".to_owned(),
        };
        return Err(Invalid::new(place, what, remedy));
    }
    Ok(axis / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(change: impl Fn(&mut FingertipConfig)) -> Option<String> {
        let mut config = FingertipConfig::default();
        change(&mut config);
        config.pose().err().map(|bad| bad.place)
    }

    #[test]
    fn the_default_is_the_frame_of_the_link() {
        assert_eq!(FingertipConfig::default().pose().unwrap(), Pose::IDENTITY);
    }

    #[test]
    fn axes_give_a_right_handed_frame() {
        let config = FingertipConfig {
            at_mm: [1.0, 2.0, 3.0],
            x_axis: Some([0.0, 0.6, 0.8]),
            z_axis: Some([1.0, 0.0, 0.0]),
            ..FingertipConfig::default()
        };
        let pose = config.pose().unwrap();
        assert!(pose.translation.abs_diff_eq(DVec3::new(1e-3, 2e-3, 3e-3), 1e-15));
        assert!(pose.rotation.y_axis.abs_diff_eq(DVec3::new(0.0, -0.8, 0.6), 1e-15));
        assert!((pose.rotation.determinant() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn mounts_that_are_none_are_refused_with_their_place() {
        assert_eq!(place(|c| c.at_mm[1] = 1001.0), Some("at_mm[1]".to_owned()));
        assert_eq!(place(|c| c.at_mm[2] = f64::NAN), Some("at_mm[2]".to_owned()));
        for bad in [[0.0; 3], [0.0, 0.0, 2.0], [f64::NAN; 3], [f64::INFINITY, 0.0, 0.0]] {
            assert_eq!(place(|c| c.x_axis = Some(bad)), Some("x_axis".to_owned()), "{bad:?}");
            assert_eq!(place(|c| c.z_axis = Some(bad)), Some("z_axis".to_owned()), "{bad:?}");
        }
        assert_eq!(place(|c| c.z_axis = Some([1.0, 0.0, 0.0])), Some("z_axis".to_owned()));
        assert_eq!(place(|c| c.z_axis = Some([0.6, 0.0, 0.8])), Some("z_axis".to_owned()));
    }
}
