//! The world of an arm, with a finger or without, and the signals in which it writes its truth.

use glam::DVec3;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::payload::FieldType;
use taktil_rtcore::record::Catalog;
use taktil_rtcore::{Cycle, FaultCode, Io, Output, Payload, Ports, StateHash, Task, payload};
use taktil_signal::JOINTS_MAX;
use taktil_sim::{Truth, World};

payload! {
    /// What the simulator knows, base frame unless stated: the signal `world.truth`.
    pub struct WorldTruth<const N: usize = 6> {
        /// The instant that the world has reached, ns.
        pub t_ns: i64,
        /// Hash of the whole simulated state.
        pub state_hash: u64,
        /// Joint angles.
        pub q_rad: [f64; N],
        /// Joint speeds.
        pub qd_rad_s: [f64; N],
        /// Tool point.
        pub tool_m: [f64; 3],
        /// Centre of the pin.
        pub pin_m: [f64; 3],
        /// Axis of the pin.
        pub pin_axis: [f64; 3],
        /// Turn of the pin about its axis since the start.
        pub pin_roll_rad: f64,
        /// Normal force between the finger and what it touches.
        pub finger_normal_n: f64,
        /// Normal force between table and pin.
        pub table_normal_n: f64,
        /// Place of the contact line on the sensor in column numbers; 0 without contact.
        pub contact_x: f64,
        /// Direction of the pin's axis on the sensor, 0 along y, positive from y towards -x.
        pub pin_yaw_rad: f64,
        /// Turn of the finger against the pin about the sensor's x axis.
        pub pin_tilt_rad: f64,
        /// Distance of the finger from the table along its normal, minus the pin's diameter: minus
        /// the total compression.
        pub gap_m: f64,
        /// Fastest sliding between finger and pin.
        pub finger_slip_m_s: f64,
        /// Fastest sliding between table and pin.
        pub table_slip_m_s: f64,
        /// Tilt of the table about its x axis.
        pub table_tilt_x_rad: f64,
        /// Rise of the table towards +x.
        pub table_tilt_y_rad: f64,
        /// Turn of the table about z0.
        pub table_pan_rad: f64,
        /// 1 while the finger touches pin or object.
        pub in_contact: u32,
        /// 1 while a hand steadies the pin.
        pub fixture_active: u32,
        /// 1 while the drives are enabled.
        pub enabled: u32,
        /// 1 while the brakes are on.
        pub braked: u32,
    }
}

impl<const N: usize> WorldTruth<N> {
    /// The same without the joints, which for another number of them would not fit.
    #[must_use]
    pub fn without_joints(&self) -> WorldTruth {
        WorldTruth {
            t_ns: self.t_ns,
            state_hash: self.state_hash,
            q_rad: [0.0; 6],
            qd_rad_s: [0.0; 6],
            tool_m: self.tool_m,
            pin_m: self.pin_m,
            pin_axis: self.pin_axis,
            pin_roll_rad: self.pin_roll_rad,
            finger_normal_n: self.finger_normal_n,
            table_normal_n: self.table_normal_n,
            contact_x: self.contact_x,
            pin_yaw_rad: self.pin_yaw_rad,
            pin_tilt_rad: self.pin_tilt_rad,
            gap_m: self.gap_m,
            finger_slip_m_s: self.finger_slip_m_s,
            table_slip_m_s: self.table_slip_m_s,
            table_tilt_x_rad: self.table_tilt_x_rad,
            table_tilt_y_rad: self.table_tilt_y_rad,
            table_pan_rad: self.table_pan_rad,
            in_contact: self.in_contact,
            fixture_active: self.fixture_active,
            enabled: self.enabled,
            braked: self.braked,
        }
    }
}

/// The numbers of a list with one number for each of so many joints, 0 behind the last. The list
/// stands in an encoded payload behind `skip` bytes.
#[must_use]
pub fn joint_list(body: &[u8], skip: usize, joints: usize) -> JointVector<JOINTS_MAX> {
    let size = f64::KIND.size();
    let mut list = JointVector::<JOINTS_MAX>::zeros();
    let numbers = body.get(skip..).unwrap_or_default().chunks_exact(size);
    for (out, number) in list.iter_mut().zip(numbers.take(joints)) {
        *out = f64::read_le(number);
    }
    list
}

/// The joint angles of a signal `world.truth` (rad), 0 behind the last.
#[must_use]
pub fn truth_joints(body: &[u8], joints: usize) -> JointVector<JOINTS_MAX> {
    // Before them stand the instant and the hash, 8 bytes each.
    joint_list(body, 16, joints)
}

/// Whether the signal `world.truth` is that of an arm that touches nothing.
#[must_use]
pub fn truth_is_of_free_arm(catalog: &Catalog) -> bool {
    let signal = catalog.find("world.truth").and_then(|id| catalog.signals.get(id));
    signal.is_some_and(|signal| signal.type_name.starts_with(<ArmTruth>::NAME))
}

/// The truth of a run with an arm of so many joints, without them; for an arm that moves freely,
/// the position of its tool.
#[must_use]
pub fn decode_truth(body: &[u8], joints: usize, moves_freely: bool) -> Option<WorldTruth> {
    fn of_finger<const N: usize>(body: &[u8]) -> Option<WorldTruth> {
        WorldTruth::<N>::decode(body).map(|truth| truth.without_joints())
    }
    fn of_free_arm<const N: usize>(body: &[u8]) -> Option<WorldTruth> {
        let ArmTruth { t_ns, tool_m, .. } = ArmTruth::<N>::decode(body)?;
        Some(WorldTruth { t_ns, tool_m, ..WorldTruth::ZERO })
    }
    match (moves_freely, joints) {
        (false, 7) => of_finger::<7>(body),
        (false, _) => of_finger::<6>(body),
        (true, 7) => of_free_arm::<7>(body),
        (true, _) => of_free_arm::<6>(body),
    }
}

payload! {
    /// What the simulator knows of an arm that moves freely, base frame: the signal `world.truth`
    /// of arms other than the PUMA 260 in scenes with nothing to touch.
    pub struct ArmTruth<const N: usize = 6> {
        /// The instant that the world has reached, ns.
        pub t_ns: i64,
        /// Hash of the whole simulated state.
        pub state_hash: u64,
        /// Joint angles.
        pub q_rad: [f64; N],
        /// Joint speeds.
        pub qd_rad_s: [f64; N],
        /// Tool point.
        pub tool_m: [f64; 3],
        /// Kinetic and gravitational energy.
        pub energy_j: f64,
        /// 1 while the drives are enabled.
        pub enabled: u32,
        /// 1 while the brakes are on.
        pub braked: u32,
    }
}

/// The task of the lane `world` for an arm that touches nothing; writes `truth`.
pub(crate) struct FreeArm<const N: usize> {
    world: World,
    truth: Output<ArmTruth<N>>,
    /// Hash of the world after the last job.
    state: u64,
}

impl<const N: usize> FreeArm<N> {
    /// Declares the port of the task.
    pub(crate) fn new(world: World, ports: &mut Ports) -> FreeArm<N> {
        FreeArm { world, truth: ports.output("truth"), state: 0 }
    }
}

impl<const N: usize> Task for FreeArm<N> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        self.world.advance(cycle.release + cycle.dt);
        let truth = self.world.truth();
        self.state = self.world.state_hash();
        let (q, qd) = self.world.joints();
        let value = ArmTruth {
            t_ns: truth.t.0,
            state_hash: self.state,
            q_rad: core::array::from_fn(|i| q.get(i).copied().unwrap_or(0.0)),
            qd_rad_s: core::array::from_fn(|i| qd.get(i).copied().unwrap_or(0.0)),
            tool_m: truth.tool.to_array(),
            energy_j: self.world.energy_j(),
            enabled: u32::from(truth.enabled),
            braked: u32::from(truth.braked),
        };
        io.write(&self.truth, value);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state);
    }
}

payload! {
    /// The object that the finger feels most, in sensor axes: the signal `world.object` of scenes
    /// that have objects. See [`taktil_sim::ObjectContact`].
    pub struct ObjectTruth {
        /// The instant that the world has reached, ns.
        pub t_ns: i64,
        /// Normal force.
        pub normal_n: f64,
        /// Middle of the load from the middle of the pad, along x and y; 0 without contact.
        pub centre_of_load_m: [f64; 2],
        /// Distance of an edge's line from the middle of the pad; only for edges.
        pub offset_m: f64,
        /// Direction of an edge on the sensor, 0 along y, positive from y towards -x.
        pub yaw_rad: f64,
        /// Length along an edge's curve from its origin.
        pub arc_length_m: f64,
        /// Turn of the finger against a face or an edge about the sensor's x and y.
        pub tilt_rad: [f64; 2],
        /// Speed of sliding.
        pub slip_m_s: f64,
    }
}

payload! {
    /// The fingertip opposed to the finger, and the pin as its sensor has it: the signal
    /// `world.opposed` of scenes that have one. See [`taktil_sim::OpposedFingertip`].
    pub struct OpposedTruth {
        /// The instant that the world has reached, ns.
        pub t_ns: i64,
        /// Middle of its face.
        pub face_m: [f64; 3],
        /// Its x axis.
        pub face_x: [f64; 3],
        /// Its z axis, out of its face.
        pub face_z: [f64; 3],
        /// Normal force between it and the pin.
        pub normal_n: f64,
        /// Place of the contact line on its sensor in column numbers; 0 without contact.
        pub contact_x: f64,
        /// Direction of the pin's axis on its sensor, 0 along y, positive from y towards -x.
        pub pin_yaw_rad: f64,
        /// Turn of this fingertip against the pin about its sensor's x axis.
        pub pin_tilt_rad: f64,
        /// Fastest sliding between it and the pin.
        pub slip_m_s: f64,
    }
}

payload! {
    /// How many images were what the scene asks for: the signal `world.layer` of scenes whose
    /// contact is solved in three dimensions. Counted since the start.
    pub struct LayerTruth {
        /// The instant that the world has reached, ns.
        pub t_ns: i64,
        /// Contacts solved in three dimensions.
        pub spatial_solutions: u64,
        /// Contacts after which rows stood on their own. See
        /// [`taktil_sim::StepStatistics::spatial_failures`].
        pub spatial_failures: u64,
    }
}

payload! {
    /// What the physics was asked to do since the start: the signal `world.statistics`, where
    /// somebody asked for it. See [`taktil_sim::StepStatistics`].
    pub struct WorldStatistics {
        /// The instant that the world has reached, ns.
        pub t_ns: i64,
        /// Steps of any integrator, halved ones included.
        pub steps: u64,
        /// Steps that were done again in halves.
        pub halved_steps: u64,
        /// Implicit steps that did not converge.
        pub unconverged_steps: u64,
        /// Iterations of implicit stages.
        pub newton_iterations: u64,
        /// Evaluations of the contacts.
        pub contact_evaluations: u64,
        /// Images computed from a contact.
        pub tactile_images: u64,
        /// Contacts solved in three dimensions.
        pub spatial_solutions: u64,
        /// Contacts after which rows stood on their own.
        pub spatial_failures: u64,
    }
}

impl WorldStatistics {
    fn of(world: &World) -> WorldStatistics {
        let work = world.statistics();
        WorldStatistics {
            t_ns: world.now().0,
            steps: work.steps,
            halved_steps: work.halved_steps,
            unconverged_steps: work.unconverged_steps,
            newton_iterations: work.newton_iterations,
            contact_evaluations: work.contact_evaluations,
            tactile_images: work.tactile_images,
            spatial_solutions: work.spatial_solutions,
            spatial_failures: work.spatial_failures,
        }
    }
}

impl OpposedTruth {
    fn of(truth: &Truth) -> Option<OpposedTruth> {
        let tip = truth.opposed?;
        Some(OpposedTruth {
            t_ns: truth.t.0,
            face_m: tip.face.to_array(),
            face_x: tip.face_x.to_array(),
            face_z: tip.face_z.to_array(),
            normal_n: truth.table_normal_n,
            contact_x: tip.contact_x_tactels.unwrap_or(0.0),
            pin_yaw_rad: tip.pin_yaw_rad,
            pin_tilt_rad: tip.tilt_rad,
            slip_m_s: truth.table_slip_m_s,
        })
    }
}

/// The task of the lane `world`; writes `truth`, writes `object`, `opposed` and `layer` where the
/// scene has them, and `statistics` where it is requested.
pub(crate) struct Simulation<const N: usize> {
    world: World,
    pin_radius_m: f64,
    pivot: DVec3,
    truth: Output<WorldTruth<N>>,
    object: Option<Output<ObjectTruth>>,
    opposed: Option<Output<OpposedTruth>>,
    layer: Option<Output<LayerTruth>>,
    work: Option<Output<WorldStatistics>>,
    /// Hash of the world after the last job.
    state: u64,
}

impl<const N: usize> Simulation<N> {
    /// Declares the ports of the task. `pivot_mm` is the table's pivot at rest.
    pub(crate) fn new(
        world: World,
        pin_radius_mm: f64,
        pivot_mm: [f64; 2],
        ports: &mut Ports,
    ) -> Simulation<N> {
        let pivot = DVec3::new(pivot_mm[0], pivot_mm[1], 0.0) * 1e-3;
        let truth = world.truth();
        let object = truth.object.map(|_| ports.output("object"));
        let opposed = truth.opposed.map(|_| ports.output("opposed"));
        let layer = world.solves_in_three_dimensions().then(|| ports.output("layer"));
        Simulation {
            world,
            pin_radius_m: pin_radius_mm * 1e-3,
            pivot,
            truth: ports.output("truth"),
            object,
            opposed,
            layer,
            work: None,
            state: 0,
        }
    }

    /// Adds the port `statistics`, in which the physics counts its steps and iterations.
    pub(crate) fn with_work_counts(mut self, ports: &mut Ports) -> Simulation<N> {
        self.work = Some(ports.output("statistics"));
        self
    }

    fn gap_m(&self, truth: &Truth) -> f64 {
        let table = &truth.table;
        let normal = taktil_mechanics::spatial::rotation_z(table.pan_rad)
            * taktil_mechanics::spatial::rotation_y(-table.tilt_y_rad)
            * taktil_mechanics::spatial::rotation_x(table.tilt_x_rad)
            * DVec3::Z;
        let pivot = self.pivot + DVec3::new(table.slide_m, 0.0, table.height_m);
        (truth.tool - pivot).dot(normal) - 2.0 * self.pin_radius_m
    }
}

impl<const N: usize> Task for Simulation<N> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        self.world.advance(cycle.release + cycle.dt);
        let truth = self.world.truth();
        self.state = self.world.state_hash();
        let (q, qd) = self.world.joints();
        let value = WorldTruth {
            t_ns: truth.t.0,
            state_hash: self.state,
            q_rad: core::array::from_fn(|i| q.get(i).copied().unwrap_or(0.0)),
            qd_rad_s: core::array::from_fn(|i| qd.get(i).copied().unwrap_or(0.0)),
            tool_m: truth.tool.to_array(),
            pin_m: truth.pin.to_array(),
            pin_axis: truth.pin_axis.to_array(),
            pin_roll_rad: truth.pin_roll_rad,
            finger_normal_n: truth.finger_normal_n,
            table_normal_n: truth.table_normal_n,
            contact_x: truth.contact_x_tactels.unwrap_or(0.0),
            pin_yaw_rad: truth.pin_yaw_rad,
            pin_tilt_rad: truth.tilt_rad,
            gap_m: self.gap_m(&truth),
            finger_slip_m_s: truth.finger_slip_m_s,
            table_slip_m_s: truth.table_slip_m_s,
            table_tilt_x_rad: truth.table.tilt_x_rad,
            table_tilt_y_rad: truth.table.tilt_y_rad,
            table_pan_rad: truth.table.pan_rad,
            in_contact: u32::from(truth.in_contact),
            fixture_active: u32::from(truth.fixture_active),
            enabled: u32::from(truth.enabled),
            braked: u32::from(truth.braked),
        };
        io.write(&self.truth, value);
        if let (Some(port), Some(felt)) = (&self.object, truth.object) {
            let object = ObjectTruth {
                t_ns: truth.t.0,
                normal_n: felt.normal_n,
                centre_of_load_m: felt.place_m.into(),
                offset_m: felt.off_m,
                yaw_rad: felt.yaw_rad,
                arc_length_m: felt.along_m,
                tilt_rad: felt.tilt_rad.into(),
                slip_m_s: felt.slip_m_s,
            };
            io.write(port, object);
        }
        if let (Some(port), Some(tip)) = (&self.opposed, OpposedTruth::of(&truth)) {
            io.write(port, tip);
        }
        if let Some(port) = &self.layer {
            let work = self.world.statistics();
            io.write(
                port,
                LayerTruth {
                    t_ns: truth.t.0,
                    spatial_solutions: work.spatial_solutions,
                    spatial_failures: work.spatial_failures,
                },
            );
        }
        if let Some(port) = &self.work {
            io.write(port, WorldStatistics::of(&self.world));
        }
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state);
    }
}
