//! `[opposed]`: a second fingertip that faces the first, with rubber, array and electronics of its
//! own. It needs a pin, because nothing else is rolled between two fingers.

use super::rolling::RubberConfig;
use super::section::{Consistency, section};
use super::tactile::TactileConfig;

section! {
    /// `[opposed]`: a second fingertip, carried by the table's mount: its face replaces the table's
    /// surface, lies in the same plane, and moves as `[table]` says. The pin rolls between both
    /// fingertips, and falls when it leaves this one.
    #[serde(default)]
    pub struct OpposedConfig {
        /// Whether there is one. Default false.
        present: bool,
        /// Middle of its face along x0, counted from the finger's start (mm). Default 0.
        x_mm: f64 [-1000.0, 1000.0],
        /// Middle of its face along y0, counted from the finger's start (mm). Default 0.
        y_mm: f64 [-1000.0, 1000.0],
        /// Turn of its rows and columns about the face's normal, from x towards y (deg). Default 0:
        /// its columns run along the table's x, its rows count along y.
        yaw_deg: f64 [-180.0, 180.0],
        /// Layer over its tactels. Default 3 mm, 0.6 MPa, 0.49, 0.7 ms, softer than the finger's.
        /// Under a thick layer a part of the load acts beside the array, where no tactel measures
        /// it.
        rubber: RubberConfig,
        /// Coulomb coefficient against the pin. Default 0.8.
        friction: f64 [0.0, 5.0],
        /// Its array's electronics, as `[tactile]`.
        tactile: TactileConfig,
    }
}

impl Consistency for OpposedConfig {}

impl Default for OpposedConfig {
    fn default() -> OpposedConfig {
        OpposedConfig {
            present: false,
            x_mm: 0.0,
            y_mm: 0.0,
            yaw_deg: 0.0,
            rubber: RubberConfig {
                thickness_mm: 3.0,
                youngs_mpa: 0.6,
                poisson: 0.49,
                relaxation_ms: 0.7,
            },
            friction: 0.8,
            tactile: TactileConfig::default(),
        }
    }
}
