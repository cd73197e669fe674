//! Somebody who looks at the robot. Counts alone do not tell which joint a motor moves, nor which
//! way its angle grew: a vertical axis looks the same from either side.

use crate::stop::Stop;

/// What was done when the witness is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shown {
    /// Channel of the converter that got a pulse.
    pub motor_channel: usize,
    /// Channel of the encoder that moved.
    pub encoder_channel: usize,
    /// Counts that it moved by.
    pub counts: i64,
}

/// What the witness saw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// A joint moved.
    Moved {
        /// Which one, counted from 0.
        joint: usize,
        /// Whether its angle grew.
        grew: bool,
    },
    /// It was not seen well: the pulse is given once more.
    Again,
}

/// Looks at the robot and says what moved. Who has no answer yet is asked again: the boards are fed
/// meanwhile, with the brakes on.
pub trait Witness {
    /// Something is about to move: whether he looks where everything stands.
    ///
    /// # Errors
    /// Nobody wants to go on.
    fn look(&mut self) -> Result<bool, Stop>;

    /// What moved since [`Witness::look`]; `None` while he thinks.
    ///
    /// # Errors
    /// Nobody can say, or wants to go on.
    fn seen(&mut self, shown: &Shown) -> Result<Option<Answer>, Stop>;

    /// Whether the joint may be moved now, between its limits or as far as `what` says; false while
    /// he thinks.
    ///
    /// # Errors
    /// It may not.
    fn allow(&mut self, joint: usize, what: &str) -> Result<bool, Stop>;
}
