//! The states from which the stages of a step start, in room that is made with the bench.

use glam::{DQuat, DVec3};

use super::SavedState;
use crate::manipulator::{ArmState, RotorState};
use crate::object::ObjectBristle;

/// Room for the states of a step's stages.
#[derive(Clone, Debug)]
pub(in crate::step) struct StageRoom<const J: usize> {
    pub(super) first: StageStart<J>,
    /// The state at the end of the first stage.
    pub(super) reached: SavedState<J>,
    pub(super) second: StageStart<J>,
}

impl<const J: usize> StageRoom<J> {
    /// Room for states like the ones that `state` makes. Allocates.
    pub(in crate::step) fn new(state: impl Fn() -> SavedState<J>) -> StageRoom<J> {
        let start = || StageStart { state: state(), angular_momentum: DVec3::ZERO };
        StageRoom { first: start(), reached: state(), second: start() }
    }
}

/// State at the start of a stage.
#[derive(Clone, Debug)]
pub(super) struct StageStart<const J: usize> {
    pub(super) state: SavedState<J>,
    /// Angular momentum of the pin (kg m^2/s), which differs from inertia times spin after an
    /// extrapolation.
    pub(super) angular_momentum: DVec3,
}

impl<const J: usize> StageStart<J> {
    /// Makes this the start of the first stage of a step.
    pub(super) fn begin_at(&mut self, saved: &SavedState<J>) {
        self.angular_momentum =
            saved.pin.as_ref().map_or(DVec3::ZERO, |state| state.pin.angular_momentum());
        (self.state.arm, self.state.bristles) = (saved.arm, saved.bristles);
        if let (Some(pin), Some(from)) = (&mut self.state.pin, &saved.pin) {
            pin.pin = from.pin;
            pin.pad.copy_from(&from.pad);
            pin.support.copy_from(&from.support);
        }
    }

    /// Makes this the state on the straight line from the start `from` to `to`, at `reach` times
    /// the distance.
    pub(super) fn extrapolate(&mut self, from: &StageStart<J>, to: &SavedState<J>, reach: f64) {
        let (a, b) = (&from.state.arm, &to.arm);
        self.state.arm = ArmState {
            q: a.q + (b.q - a.q) * reach,
            qd: a.qd + (b.qd - a.qd) * reach,
            bristle: a.bristle + (b.bristle - a.bristle) * reach,
            rotors: RotorState {
                q: a.rotors.q + (b.rotors.q - a.rotors.q) * reach,
                qd: a.rotors.qd + (b.rotors.qd - a.rotors.qd) * reach,
            },
        };
        let mix = |x: f64, y: f64| x + reach * (y - x);
        self.state.bristles = core::array::from_fn(|i| {
            let (a, b): (&ObjectBristle, &ObjectBristle) =
                (&from.state.bristles[i], &to.bristles[i]);
            let shear_n_m = mix(a.shear_n_m, b.shear_n_m).max(0.0);
            ObjectBristle {
                deflection: a.deflection + reach * (b.deflection - a.deflection),
                shear_n_m,
            }
        });
        let (Some(state), Some(a), Some(b)) = (&mut self.state.pin, &from.state.pin, &to.pin)
        else {
            return;
        };
        let mix3 = |x: DVec3, y: DVec3| x + reach * (y - x);
        state.pin = a.pin;
        let pin = &mut state.pin;
        pin.position = mix3(a.pin.position, b.pin.position);
        pin.velocity = mix3(a.pin.velocity, b.pin.velocity);
        pin.spin = mix3(a.pin.spin, b.pin.spin);
        pin.roll_rad = mix(a.pin.roll_rad, b.pin.roll_rad);
        let (start, end) = (a.pin.orientation, b.pin.orientation);
        let near = if start.dot(end) < 0.0 { -end } else { end };
        pin.orientation = DQuat::normalize(start + (near - start) * reach);
        state.pad.extrapolate(&a.pad, &b.pad, reach);
        state.support.extrapolate(&a.support, &b.support, reach);
        self.angular_momentum = mix3(from.angular_momentum, b.pin.angular_momentum());
    }
}
