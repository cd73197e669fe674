//! The simulated world in a lane of its own: a task for each kind of robot integrates ahead to the
//! next instant at which a D/A word can change, and writes the simulated truth. The controller is
//! connected to it only through the device halves.

mod arm;
mod hand;

use taktil_hal::Devices;
use taktil_machine::robot::AnyRobot;
use taktil_machine::with_robot;
use taktil_mechanics::hand::Hand;
use taktil_mechanics::robot::{ChainRobot, Robot};
use taktil_rtcore::{Invalid, Ports, Task};
use taktil_sim::{Timing, World, WorldConfig};

use arm::{FreeArm, Simulation};
use hand::HandWorld;

pub use arm::{
    ArmTruth, LayerTruth, ObjectTruth, OpposedTruth, WorldStatistics, WorldTruth, decode_truth,
    joint_list, truth_is_of_free_arm, truth_joints,
};
pub use hand::{HandTruth, truth_of_hand};

/// What the finger of an arm has to touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finger {
    /// Radius of the pin (mm).
    pub pin_radius_mm: f64,
    /// The table's pivot at rest (mm, base frame, along x and y).
    pub pivot_mm: [f64; 2],
    /// Whether the scene has anything to touch; a chain without that has no finger.
    pub has_contact: bool,
    /// Whether the physics counts its steps and iterations in the port `statistics`.
    pub counts_work: bool,
}

/// The world with a robot in it that starts at `start` (rad), and the devices through which it is
/// driven and sensed. A hand's dynamics come into being here, in a crate that is optimised.
///
/// # Errors
/// What the simulator says of the world, with its place in it.
pub fn build(
    robot: &AnyRobot,
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    start: &[f64],
) -> Result<(World, Devices), Invalid> {
    with_robot!(robot,
        puma260: _robot => taktil_sim::build(config, timing, seed),
        chain: robot => taktil_sim::build_with_chain(config, timing, seed, robot.as_ref(), start),
        hand: robot => taktil_sim::build_with_hand(config, timing, seed, robot, start)
    )
}

/// The task that simulates the world of a robot; it writes `truth`, and what else the world has.
pub fn task(robot: &AnyRobot, finger: &Finger, world: World, ports: &mut Ports) -> Box<dyn Task> {
    with_robot!(robot,
        puma260: _robot => finger_task::<6>(finger, world, ports),
        chain: robot => chain_task(robot, finger, world, ports),
        hand: robot => hand_task(robot, world, ports)
    )
}

fn finger_task<const N: usize>(finger: &Finger, world: World, ports: &mut Ports) -> Box<dyn Task> {
    let task = Simulation::<N>::new(world, finger.pin_radius_mm, finger.pivot_mm, ports);
    Box::new(if finger.counts_work { task.with_work_counts(ports) } else { task })
}

/// The task that simulates a hand with its object, with as many joints as `robot` has.
fn hand_task<const F: usize, const N: usize>(
    _robot: &Robot<N, Hand<F, N>>,
    world: World,
    ports: &mut Ports,
) -> Box<dyn Task> {
    Box::new(HandWorld::<N>::new(world, ports))
}

/// The task that simulates a chain with as many joints as `robot` has.
fn chain_task<const N: usize>(
    _robot: &ChainRobot<N>,
    finger: &Finger,
    world: World,
    ports: &mut Ports,
) -> Box<dyn Task> {
    if finger.has_contact {
        return finger_task::<N>(finger, world, ports);
    }
    Box::new(FreeArm::<N>::new(world, ports))
}
