//! Builds a world around an arm from a description: a chain with as many joints as are compiled.
//! A chain in a scene with nothing to touch moves by a method of its own.

use taktil_hal::Devices;
use taktil_mechanics::robot::ChainRobot;

use super::assemble;
use crate::any_plant::AnyPlant;
use crate::chain_arm::ChainArm;
use crate::devices::BoardSpec;
use crate::scene::fidelity::Integrator;
use crate::scene::{Invalid, Timing, WorldConfig, invalid};
use crate::step::Plant;
use crate::world::World;

/// An arm that is simulated as a chain: one of as many joints as are compiled.
pub trait SimulatedChain {
    /// Builds the bench with this arm; see [`build_with_chain`].
    ///
    /// # Errors
    /// Those of [`build_with_chain`].
    fn build_bench(
        &self,
        config: &WorldConfig,
        timing: &Timing,
        seed: u64,
        start: &[f64],
    ) -> Result<(World, Devices), Invalid>;
}

impl SimulatedChain for ChainRobot<6> {
    fn build_bench(
        &self,
        config: &WorldConfig,
        timing: &Timing,
        seed: u64,
        start: &[f64],
    ) -> Result<(World, Devices), Invalid> {
        build_chain::<6, 12>(config, timing, seed, self, start)
    }
}

impl SimulatedChain for ChainRobot<7> {
    fn build_bench(
        &self,
        config: &WorldConfig,
        timing: &Timing,
        seed: u64,
        start: &[f64],
    ) -> Result<(World, Devices), Invalid> {
        build_chain::<7, 13>(config, timing, seed, self, start)
    }
}

/// Builds the bench with another arm, which starts at `start` (rad). It carries the fingertip at
/// its tool: x of the tool frame along the columns of the array, z out of the rubber.
///
/// # Errors
/// The errors of [`build`](crate::build); also, for a scene with nothing to touch, a named
/// integrator, because the arm then has its own method, and for one with something, the integrator
/// `euler`.
pub fn build_with_chain(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    robot: &impl SimulatedChain,
    start: &[f64],
) -> Result<(World, Devices), Invalid> {
    robot.build_bench(config, timing, seed, start)
}

/// The bench with a chain of `N` joints.
fn build_chain<const N: usize, const U: usize>(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    robot: &ChainRobot<N>,
    start: &[f64],
) -> Result<(World, Devices), Invalid>
where
    Plant<N, U>: Into<AnyPlant>,
{
    config.check()?;
    timing.check()?;
    let can_touch = config.pin.present || !config.object.is_empty();
    if !can_touch && config.fidelity.integrator != Integrator::Auto {
        let what = "is named, but this arm has a method of its own".to_owned();
        return Err(invalid("fidelity.integrator", what, "say auto"));
    }
    let arm = ChainArm::new(robot, start, &config.arm, config.fidelity.arm, can_touch)?;
    let (code_min, code_max) = robot.drive.code_range();
    let board = BoardSpec { joints: N, code_min, code_max };
    assemble::<N, U>(config, timing, seed, Box::new(arm), None, board)
}
