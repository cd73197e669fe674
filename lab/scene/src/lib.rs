//! Reads a scene, builds its machine over the simulated robot, and evaluates a run of it. Either
//! executor can run the machine; this crate does not depend on which.

pub mod assembly;
mod budgets;
pub mod moves;
pub mod operator;
pub mod origin;
pub mod probe;
pub mod release_order;
pub mod scene;
pub mod schema;
pub mod score;
pub mod seek;
mod statistics;
pub mod summary;

use std::sync::atomic::AtomicBool;

use taktil_machine::with_robot;
use taktil_record::digest::Digest;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{FaultSet, Machine, Nanos, Payload, virtual_time};
use taktil_signal::ControlState;
use taktil_tasks_joint_servo::Tuning;

use scene::Scene;
use score::Targets;

/// Prefix of the metadata of a log that hold the files that a scene's motions name; the file's own
/// name follows it.
pub const RECORDED_FILE_PREFIX: &str = "recorded:";

/// Runs a machine to its end in virtual time.
///
/// # Errors
/// A task that does not start.
pub fn run_virtual(
    machine: &mut Machine,
    until: Nanos,
    observer: &mut dyn Observer,
) -> anyhow::Result<()> {
    let stop = AtomicBool::new(false);
    virtual_time::run(machine, until, &stop, observer).map(|_| ()).map_err(|(task, fault)| {
        anyhow::anyhow!("task `{task}` refused to start: {}", fault.text())
    })
}

/// What is told of a run among many.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct RunOutcome {
    /// Hexadecimal digest of all that the run recorded.
    pub digest: String,
    /// Faults that are latched at its end.
    pub faults: FaultSet,
}

/// Makes the digest of a run and keeps the newest latched faults.
struct OutcomeObserver {
    digest: Digest,
    control_id: Option<usize>,
    faults: FaultSet,
}

impl Observer for OutcomeObserver {
    fn record(&mut self, record: &Record<'_>) {
        self.digest.record(record);
        if Some(record.signal) == self.control_id
            && let Some(control) = ControlState::decode(record.body)
        {
            self.faults = FaultSet(control.faults);
        }
    }
}

/// Runs a machine in virtual time without other observers.
///
/// # Errors
/// A task that does not start.
pub fn outcome_of_run(machine: &mut Machine, until: Nanos) -> anyhow::Result<RunOutcome> {
    let catalog = machine.catalog();
    let mut observer = OutcomeObserver {
        digest: Digest::new(catalog),
        control_id: catalog.find("supervisor.control"),
        faults: FaultSet::default(),
    };
    run_virtual(machine, until, &mut observer)?;
    Ok(RunOutcome { digest: observer.digest.hex(), faults: observer.faults })
}

/// The set points of a scene's features.
#[must_use]
pub fn targets(scene: &Scene) -> Targets {
    let servo = scene.machine.tactile_servo.clone().unwrap_or_default();
    let tactile = &scene.world.tactile;
    let full_scale_counts = f64::from((1u32 << tactile.bits.min(31)) - 1);
    let joint_servo = scene.machine.joint_servo.clone().unwrap_or_default();
    let plain = with_robot!(&scene.robot, robot => joint_servo.tuning(robot).ok().map(kp));
    Targets {
        m0: servo.m0_counts,
        pitch_x_mm: servo.array.pitch_x_mm,
        pitch_y_mm: servo.array.pitch_y_mm,
        counts_per_n: full_scale_counts / tactile.full_scale_n,
        pin: scene.world.pin.present,
        plain_kp_nm_rad: plain.filter(|_| !joint_servo.gravity),
        phase_names: servo
            .phases
            .map(|task| task.phase.into_iter().map(|phase| phase.name).collect())
            .unwrap_or_default(),
    }
}

fn kp<const N: usize>(tuning: Tuning<N>) -> Vec<f64> {
    tuning.gains().kp_nm_rad.as_slice().to_vec()
}
