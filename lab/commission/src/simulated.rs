//! A simulated robot that is commissioned: its world as the pace, and an observer who sees in it
//! what somebody beside a robot would see.

use std::cell::RefCell;
use std::rc::Rc;

use taktil_hal::{Devices, Nanos};
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_machine::source::Located;
use taktil_sim::World;

use crate::cell::Pace;
use crate::stop::Stop;
use crate::witness::{Answer, Shown, Witness};

/// Motions below this nobody sees (rad): a hundredth of a millimetre at an arm's length of 0.1 m.
const VISIBLE_RAD: f64 = 1e-4;

/// What the world and its observer share.
struct Watched {
    world: World,
    start: Vec<f64>,
    looked_at: Vec<f64>,
    /// Largest motion of each joint before its direction was known (rad), and whether it is.
    excursions: Vec<f64>,
    known: Vec<bool>,
    /// The same whether its direction was known or not (rad).
    travels: Vec<f64>,
}

impl Watched {
    fn joints(&self) -> Vec<f64> {
        self.world.joints().0[..self.start.len()].to_vec()
    }
}

/// The robot of a scene, wired as its `[world_joints]` say.
#[derive(Clone)]
pub struct SimulatedRobot(Rc<RefCell<Watched>>);

impl SimulatedRobot {
    /// The robot at its start, and its halves.
    ///
    /// # Errors
    /// An error in the scene, located.
    pub fn new(scene: &Scene, seed: u64) -> Result<(SimulatedRobot, Devices), Located> {
        let (world, devices) = Assembly::new(scene).with_seed(seed).build_world()?;
        let start = world.joints().0[..scene.robot.joints()].to_vec();
        let (excursions, known) = (vec![0.0; start.len()], vec![false; start.len()]);
        let (looked_at, travels) = (start.clone(), excursions.clone());
        let watched = Watched { world, start, looked_at, excursions, known, travels };
        Ok((SimulatedRobot(Rc::new(RefCell::new(watched))), devices))
    }

    /// Time between two cycles of its boards.
    #[must_use]
    pub fn period(&self) -> Nanos {
        self.0.borrow().world.timing().control_period
    }

    /// The largest motion of each joint from its start before its direction was known (rad), as the
    /// world has it.
    #[must_use]
    pub fn excursions(&self) -> Vec<f64> {
        self.0.borrow().excursions.clone()
    }

    /// The largest motion of each joint from its start so far (rad), as the world has it: for a
    /// joint whose encoder does not count, all of it is motion that nobody sees.
    #[must_use]
    pub fn travels(&self) -> Vec<f64> {
        self.0.borrow().travels.clone()
    }

    /// The instant that the world has reached.
    #[must_use]
    pub fn now(&self) -> Nanos {
        self.0.borrow().world.now()
    }

    /// Whether drives are off and brakes on.
    #[must_use]
    pub fn is_safe(&self) -> bool {
        let truth = self.0.borrow().world.truth();
        truth.braked && !truth.enabled
    }

    /// Lets the world go on without anybody.
    pub fn wait(&self, span: Nanos) {
        let watched = &mut self.0.borrow_mut();
        let to = watched.world.now() + span;
        watched.world.advance(to);
    }
}

impl Pace for SimulatedRobot {
    fn wait_until(&mut self, release: Nanos) -> Nanos {
        let watched = &mut *self.0.borrow_mut();
        watched.world.advance(release);
        let joints = watched.joints();
        for (i, q) in joints.into_iter().enumerate() {
            let moved = (q - watched.start[i]).abs();
            watched.travels[i] = watched.travels[i].max(moved);
            if !watched.known[i] {
                watched.excursions[i] = watched.excursions[i].max(moved);
            }
        }
        release
    }
}

impl Witness for SimulatedRobot {
    fn look(&mut self) -> Result<bool, Stop> {
        let watched = &mut *self.0.borrow_mut();
        watched.looked_at = watched.joints();
        Ok(true)
    }

    fn seen(&mut self, _: &Shown) -> Result<Option<Answer>, Stop> {
        let watched = &mut *self.0.borrow_mut();
        let joints = watched.joints();
        let moved = joints.iter().zip(&watched.looked_at).map(|(now, then)| now - then);
        let most = moved.enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        let Some((joint, moved)) = most else {
            return Err(Stop::new("the robot has no joints", "take another scene"));
        };
        if moved.abs() < VISIBLE_RAD {
            return Ok(Some(Answer::Again));
        }
        watched.known[joint] = true;
        Ok(Some(Answer::Moved { joint, grew: moved > 0.0 }))
    }

    fn allow(&mut self, _: usize, _: &str) -> Result<bool, Stop> {
        Ok(true)
    }
}
