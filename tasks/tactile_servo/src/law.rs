//! The trait of a control law, which converts the features of an image to a displacement (dx, dz,
//! dtheta_x, dtheta_z) of the sensor in its own frame (mm, mm, mrad, mrad). Each law stands in a
//! file of its own, as a pure function of its observation and its state; a scene names one of them.
//! A law sees no device, no joint and no clock: everything that it depends on is an argument.
//!
//! Signs follow from geometry ([`JACOBIAN_SIGNS`]):
//! - x: a sensor that moves by +x over a pin that rolls takes the pin along by half of it, so the
//!   contact moves by -1/2 in the sensor: x_c falls.
//! - z: points out of the face; +z presses and M0 grows.
//! - theta_x: a turn about x moves the face at +y along +z (x cross y = z), so the load grows
//!   there: M_x grows.
//! - theta_z: a turn of the sensor by +a about z turns the image by -a: theta_z falls.

pub mod active;
pub mod hybrid_force;
pub mod model;
pub mod phases;
pub mod projector_pid;
pub mod task_frame;
pub mod thesis;

use taktil_mechanics::{Joints, Pose};
use taktil_rtcore::Fold;
use taktil_signal::{TactileImage, Wrench};

use crate::config::Config;
use crate::config::opposed::OpposedFingertip;
use crate::encoder_hold::EncoderMotions;
use crate::perception::TouchFeatures;
use crate::perception::line::Line;

/// Signs of the diagonal of the feature Jacobian for (x_c, M0, M_x, theta_z).
pub const JACOBIAN_SIGNS: [f64; 4] = [-1.0, 1.0, 1.0, -1.0];

/// The features of one image and its age.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// Features of the whole image.
    pub features: &'a TouchFeatures,
    /// Line of load in the image, when the law goes by lines and the image has one.
    pub line: Option<&'a Line>,
    /// The features of the second fingertip's image at the same time, if there is one.
    pub opposed: Option<OpposedObservation<'a>>,
    /// Age of the image (s).
    pub age_s: f64,
    /// Time between two jobs (s).
    pub dt_s: f64,
}

impl<'a> Observation<'a> {
    /// An image of the carried finger alone, without a second fingertip.
    #[must_use]
    pub fn new(
        features: &'a TouchFeatures,
        line: Option<&'a Line>,
        age_s: f64,
        dt_s: f64,
    ) -> Observation<'a> {
        Observation { features, line, opposed: None, age_s, dt_s }
    }
}

/// The observation by the fingertip on the other side of the pin.
#[derive(Clone, Copy, Debug)]
pub struct OpposedObservation<'a> {
    /// The response of its array.
    pub fingertip: &'a OpposedFingertip,
    /// Line of load in its image.
    pub line: &'a Line,
    /// Pose of the arm's finger at that time (base frame).
    pub tool: &'a Pose,
}

/// Which of the two fingertips an image comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fingertip {
    /// The one that the arm carries.
    Carried,
    /// The one on the other side of the pin.
    Opposed,
}

/// A control law with its state. No method allocates.
///
/// Displacements are (dx, dz, dtheta_x, dtheta_z) of the sensor (mm, mm, mrad, mrad). A law answers
/// either images ([`Law::observe`]) or jobs ([`Law::command`]).
pub trait Law: Fold {
    /// Takes over set points and speeds that were edited while the law runs.
    fn retune(&mut self, _config: &Config) {}

    /// Resets the state, when the task takes over the arm.
    fn reset(&mut self, config: &Config);

    /// Takes in a new image. A law that answers images returns its displacement towards column
    /// `x_c_desired`, to be carried out until the next image.
    fn observe(
        &mut self,
        config: &Config,
        observation: &Observation<'_>,
        x_c_desired: f64,
    ) -> Option<[f64; 4]>;

    /// Takes in the newest wrench. A law that goes by the wrench returns its features, which then
    /// stand for those of the image.
    fn observe_wrench(
        &mut self,
        _config: &Config,
        _wrench: Option<&Wrench>,
        _image: &TouchFeatures,
    ) -> Option<TouchFeatures> {
        None
    }

    /// The displacement for one job of `dt_s` towards column `x_c_desired`, of a law that answers
    /// jobs.
    fn command(&mut self, _config: &Config, _x_c_desired: f64, _dt_s: f64) -> Option<[f64; 4]> {
        None
    }

    /// Takes in the displacement that was carried out in a job of `dt_s`, after all limits.
    fn record_executed(&mut self, _config: &Config, _displacement: &[f64; 4], _dt_s: f64) {}

    /// The line of load in an image, for a law that goes by lines.
    fn line(
        &mut self,
        _config: &Config,
        _image: &TactileImage,
        _features: &TouchFeatures,
        _fingertip: Fingertip,
    ) -> Option<Line> {
        None
    }

    /// The column that decides when the direction of rolling reverses.
    fn column(&self, features: &TouchFeatures) -> Option<f64> {
        features.x_c
    }

    /// What the law leaves to the encoders of the motions along x, along y and about y, with the
    /// tool at `tool` (base frame), for a step that lasts `span_s`. The default leaves y and
    /// theta_y to them.
    fn encoder_motions(&mut self, _config: &Config, _tool: &Pose, _span_s: f64) -> EncoderMotions {
        EncoderMotions::default()
    }
}

/// A displacement (mm, mm, mrad, mrad) as a small motion of the tool frame `[v; w]` (m, rad); its
/// parts along and about y are zero.
#[must_use]
pub fn tool_motion(displacement: &[f64; 4]) -> Joints {
    let [x, z, theta_x, theta_z] = displacement.map(|value| value * 1e-3);
    Joints::new(x, 0.0, z, theta_x, 0.0, theta_z)
}

#[cfg(test)]
mod tests;
