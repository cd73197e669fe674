//! The world of a hand, and the signal in which it writes the truth of the object and of the
//! fingers' contacts.

use taktil_mechanics::hand::Hand;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::{Cycle, FaultCode, Io, Output, Payload, Ports, StateHash, Task, payload};
use taktil_sim::World;

use crate::arm::WorldTruth;

payload! {
    /// What the simulator knows of a hand and its object, base frame: the signal `world.truth` of
    /// machines that are hands.
    pub struct HandTruth<const N: usize = 9> {
        /// The instant that the world has reached, ns.
        pub t_ns: i64,
        /// Hash of the whole simulated state.
        pub state_hash: u64,
        /// Joint angles.
        pub q_rad: [f64; N],
        /// Joint speeds.
        pub qd_rad_s: [f64; N],
        /// Middle of the first fingertip's face.
        pub tool_m: [f64; 3],
        /// Centre of the object.
        pub object_m: [f64; 3],
        /// Axes of the object, its x, then its y, then its z.
        pub object_axes: [f64; 9],
        /// Velocity of the object's centre.
        pub object_m_s: [f64; 3],
        /// Angular velocity of the object.
        pub object_rad_s: [f64; 3],
        /// Force of the pushes from outside.
        pub push_n: [f64; 3],
        /// Normal force of each finger; zero for fingers that the hand lacks.
        pub normal_n: [f64; 3],
        /// Tangential force of each finger.
        pub tangential_n: [f64; 3],
        /// Friction of each contact relative to what it bears: above 1 it slides.
        pub effort: [f64; 3],
        /// Speed of sliding of each contact.
        pub slip_m_s: [f64; 3],
        /// Normal force of the support.
        pub support_n: f64,
        /// 1 while a rubber is pressed deeper than small strain covers.
        pub beyond_small_strain: u32,
        /// 1 while the drives are enabled.
        pub enabled: u32,
        /// 1 while the brakes are on.
        pub braked: u32,
    }
}

/// The instant and the first fingertip of a hand's truth, of which scores know no more; absent when
/// the bytes are not such a truth.
#[must_use]
pub fn truth_of_hand<const F: usize, const N: usize>(
    _: &Robot<N, Hand<F, N>>,
    body: &[u8],
) -> Option<WorldTruth> {
    let HandTruth { t_ns, tool_m, .. } = HandTruth::<N>::decode(body)?;
    Some(WorldTruth { t_ns, tool_m, ..WorldTruth::ZERO })
}

/// The task of the lane `world` for a hand; writes `truth`.
pub(crate) struct HandWorld<const N: usize> {
    world: World,
    truth: Output<HandTruth<N>>,
    /// Hash of the world after the last job.
    state: u64,
}

impl<const N: usize> HandWorld<N> {
    /// Declares the port of the task.
    pub(crate) fn new(world: World, ports: &mut Ports) -> HandWorld<N> {
        HandWorld { world, truth: ports.output("truth"), state: 0 }
    }

    fn truth(&self) -> HandTruth<N> {
        let (truth, (q, qd)) = (self.world.truth(), self.world.joints());
        let mut out = HandTruth {
            t_ns: truth.t.0,
            state_hash: self.state,
            q_rad: core::array::from_fn(|i| q.get(i).copied().unwrap_or(0.0)),
            qd_rad_s: core::array::from_fn(|i| qd.get(i).copied().unwrap_or(0.0)),
            tool_m: truth.tool.to_array(),
            enabled: u32::from(truth.enabled),
            braked: u32::from(truth.braked),
            ..HandTruth::default()
        };
        let Some(hand) = self.world.hand() else { return out };
        out.object_m = hand.object_m.to_array();
        out.object_axes = hand.object_axes.to_cols_array();
        out.object_m_s = hand.object_m_s.to_array();
        out.object_rad_s = hand.object_rad_s.to_array();
        out.push_n = hand.push_n.to_array();
        for (f, finger) in hand.fingers.iter().enumerate() {
            let [x, y, _] = finger.friction;
            out.normal_n[f] = finger.normal_n;
            out.tangential_n[f] = (x * x + y * y).sqrt();
            (out.effort[f], out.slip_m_s[f]) = (finger.effort, finger.slip_m_s);
        }
        out.support_n = hand.support_n;
        out.beyond_small_strain = u32::from(hand.beyond_small_strain);
        out
    }
}

impl<const N: usize> Task for HandWorld<N> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        self.world.advance(cycle.release + cycle.dt);
        self.state = self.world.state_hash();
        let truth = self.truth();
        io.write(&self.truth, truth);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state);
    }
}
