//! What holds the fingertip, the arm or a carriage, as the integrators see it: a state of up to six
//! degrees of freedom, and what an implicit stage has to know about its end. Refuses to know what
//! touches the finger.

use taktil_mechanics::spatial::{SinCos, linear_and_angular};
use taktil_mechanics::{Joints, Matrix6, Pose};

use crate::arm::{Arm, Rub};
use crate::carriage::Riding;
use crate::chained::Loose;
use crate::contact::Surface;
use crate::hash::Hash;

/// Coordinates, their speeds and the deflections of the bristles that rub on them: joints (rad), or
/// a floating carriage's height (m) in the first place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Swing {
    pub(crate) q: Joints,
    pub(crate) qd: Joints,
    pub(crate) bristle: Joints,
    /// Rotors that turn beside their joints, on the joints' side.
    pub(crate) motor: Rotors,
}

/// Angles and speeds of the rotors behind gears that give way (rad, rad/s); zero behind stiff ones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Rotors {
    pub(crate) q: Joints,
    pub(crate) qd: Joints,
}

impl Swing {
    pub(crate) fn digest(&self, hash: &mut Hash) {
        hash.numbers(self.q.as_slice());
        hash.numbers(self.qd.as_slice());
        hash.numbers(self.bristle.as_slice());
    }
}

/// The finger at the end of an implicit stage, if it ends at the speeds `guess`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ahead {
    /// Degrees of freedom that move: the first so many.
    pub(crate) degrees: usize,
    pub(crate) inertia: Matrix6,
    /// Generalised forces beside friction and contact.
    pub(crate) push: Joints,
    /// Twist of the tool per speed.
    pub(crate) jacobian: Matrix6,
    pub(crate) pose: Pose,
    /// Twist that is prescribed; within a stage also that of `guess`.
    pub(crate) carried: Joints,
    pub(crate) guess: Joints,
    /// Sines and cosines of the joints there.
    pub(crate) at: SinCos,
}

impl Ahead {
    /// A finger whose motion is prescribed.
    pub(crate) fn fixed(pose: Pose, carried: Joints) -> Ahead {
        Ahead {
            degrees: 0,
            inertia: Matrix6::identity(),
            push: Joints::zeros(),
            jacobian: Matrix6::zeros(),
            pose,
            carried,
            guess: Joints::zeros(),
            at: SinCos { s: [0.0; 6], c: [1.0; 6] },
        }
    }
}

/// What holds the fingertip.
#[derive(Clone, Debug)]
pub(crate) enum Finger {
    Arm(Box<Arm>),
    Carriage(Box<Riding>),
    Chained(Box<Unheld>),
}

/// An arm that touches nothing: it steps by itself, and the integrators hold none of its state.
#[derive(Clone, Debug)]
pub(crate) struct Unheld {
    pub(crate) arm: Box<dyn Loose>,
    nothing: Swing,
}

impl Unheld {
    pub(crate) fn new(arm: Box<dyn Loose>) -> Unheld {
        Unheld { arm, nothing: Swing::default() }
    }
}

impl Finger {
    pub(crate) fn pose(&self) -> &Pose {
        match self {
            Finger::Arm(arm) => arm.pose(),
            Finger::Carriage(riding) => riding.pose(),
            Finger::Chained(unheld) => unheld.arm.pose(),
        }
    }

    pub(crate) fn twist(&self) -> Joints {
        match self {
            Finger::Arm(arm) => arm.twist(),
            Finger::Carriage(riding) => riding.twist(),
            Finger::Chained(unheld) => unheld.arm.twist(),
        }
    }

    pub(crate) fn swing(&self) -> &Swing {
        match self {
            Finger::Arm(arm) => &arm.now,
            Finger::Carriage(riding) => &riding.now,
            Finger::Chained(unheld) => &unheld.nothing,
        }
    }

    pub(crate) fn swing_mut(&mut self) -> &mut Swing {
        match self {
            Finger::Arm(arm) => &mut arm.now,
            Finger::Carriage(riding) => &mut riding.now,
            Finger::Chained(unheld) => &mut unheld.nothing,
        }
    }

    /// One explicit step under a wrench on the tool.
    pub(crate) fn step(&mut self, h: f64, wrench: &Joints) {
        match self {
            Finger::Arm(arm) => arm.step(h, wrench),
            Finger::Carriage(riding) => riding.step(h, linear_and_angular(wrench).0),
            Finger::Chained(unheld) => unheld.arm.step(h),
        }
    }

    /// See [`Ahead`]; the stage ends at `end_s`.
    pub(crate) fn ahead(&self, base: &Swing, guess: &Joints, h: f64, end_s: f64) -> Ahead {
        match self {
            Finger::Arm(arm) => arm.ahead(base, guess, h, end_s),
            Finger::Carriage(riding) => riding.ahead(base, guess, h, end_s),
            Finger::Chained(unheld) => Ahead::fixed(*unheld.arm.pose(), Joints::zeros()),
        }
    }

    /// The generalised forces of [`Ahead`] for other speeds.
    pub(crate) fn push(&self, ahead: &Ahead, speeds: &Joints) -> Joints {
        match self {
            Finger::Arm(arm) if ahead.degrees > 0 => arm.push(&ahead.at, speeds),
            _ => ahead.push,
        }
    }

    /// Friction on degree of freedom `i` at the end of a stage.
    pub(crate) fn rub(&self, base: &Swing, i: usize, speed: f64, h: f64) -> Rub {
        match self {
            Finger::Arm(arm) => arm.rub(base, i, speed, h),
            Finger::Carriage(riding) => riding.rub(speed),
            Finger::Chained(_) => Rub::default(),
        }
    }

    /// Frame and twist of the tool for the present state at `t_s`.
    pub(crate) fn settle(&mut self, t_s: f64) {
        match self {
            Finger::Arm(arm) => arm.settle(t_s),
            Finger::Carriage(riding) => riding.settle(t_s),
            Finger::Chained(_) => {}
        }
    }

    /// Whether it goes its way by the clock alone, so that an explicit step's time adds up in it.
    pub(crate) fn is_led(&self) -> bool {
        match self {
            Finger::Arm(arm) => arm.is_led(),
            Finger::Carriage(_) => true,
            Finger::Chained(_) => false,
        }
    }

    /// Whether a joint stands beyond its stops.
    pub(crate) fn beyond_limits(&self) -> bool {
        matches!(self, Finger::Arm(arm) if arm.beyond_limits())
    }

    /// Puts joints that went beyond their stops back, at rest.
    pub(crate) fn stop_at_limits(&mut self) {
        if let Finger::Arm(arm) = self {
            arm.stop_at_limits();
        }
    }

    pub(crate) fn surface(&self) -> Surface {
        Surface::of_pad(self.pose(), &self.twist())
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        match self {
            Finger::Arm(arm) => arm.digest(hash),
            Finger::Carriage(riding) => riding.digest(hash),
            Finger::Chained(unheld) => unheld.arm.digest(hash),
        }
    }
}
