//! What a flight recorder's file says in JSON beside the records: the machine, and what the kernel
//! granted. Whoever writes such a file and whoever reads it use these types.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use taktil_rtcore::Machine;
use taktil_rtcore::live::Attestation;
use taktil_rtcore::payload::Field;
use taktil_rtcore::record::Signal;

/// A machine, for a reader that does not have the program that ran it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MachineDescription {
    /// Version of the program.
    pub taktil: String,
    /// Number of the process.
    pub process: u32,
    /// Lanes in the order of the catalog.
    pub lanes: Vec<LaneDescription>,
    /// Signals in the order of the catalog.
    pub signals: Vec<SignalDescription>,
    /// Configuration files, seed and the like, name by name.
    pub texts: BTreeMap<String, String>,
}

/// A lane of the machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaneDescription {
    /// Its name.
    pub name: String,
    /// From one release to the next (ns).
    pub period_ns: i64,
    /// The first release (ns).
    pub phase_ns: i64,
    /// Names of its tasks in the order in which they run.
    pub tasks: Vec<String>,
}

/// A signal of the machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SignalDescription {
    /// Its name.
    pub name: String,
    /// Index of the lane that writes it.
    pub lane: usize,
    /// Name of its payload.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Size of a record's body (bytes).
    pub size: usize,
    /// Fields in the order of the body.
    pub fields: Vec<FieldDescription>,
}

/// A field of a payload.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldDescription {
    /// Its name.
    pub name: String,
    /// Its primitive, by the name that ROS has for it.
    pub kind: String,
    /// Number of values.
    pub count: usize,
    /// Whether it is an array, even one of a single value.
    pub array: bool,
}

/// What the kernel granted, in short.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FlightGrants {
    /// Whether everything that was asked for was granted.
    pub granted: bool,
    /// The items of the contract that were not met, in words.
    pub shortfalls: Vec<String>,
    /// What else is worth knowing, in words.
    pub notes: Vec<String>,
    /// Whether the kernel is a `PREEMPT_RT` one.
    pub preempt_rt: bool,
    /// Whether the kernel runs in a virtual machine.
    pub virtual_machine: bool,
    /// Wall time of logical time zero (ns since 1970), once it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zero_unix_ns: Option<i64>,
    /// Whether the process ended the recording itself: it was not killed.
    #[serde(skip_serializing_if = "is_false")]
    pub ended: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks by reference")]
fn is_false(value: &bool) -> bool {
    !value
}

impl MachineDescription {
    /// Describes a machine, with texts for whoever reads its recording.
    pub(super) fn new(machine: &Machine, texts: &[(&str, &str)]) -> MachineDescription {
        let catalog = machine.catalog();
        let lanes = catalog.lanes.iter().zip(machine.task_names());
        MachineDescription {
            taktil: env!("CARGO_PKG_VERSION").to_owned(),
            process: std::process::id(),
            lanes: lanes
                .map(|(lane, tasks)| LaneDescription {
                    name: lane.name.clone(),
                    period_ns: lane.period.0,
                    phase_ns: lane.phase.0,
                    tasks: tasks.into_iter().map(|name| name.to_string()).collect(),
                })
                .collect(),
            signals: catalog.signals.iter().map(SignalDescription::new).collect(),
            texts: texts
                .iter()
                .map(|(name, text)| ((*name).to_owned(), (*text).to_owned()))
                .collect(),
        }
    }
}

impl SignalDescription {
    fn new(signal: &Signal) -> SignalDescription {
        let field = |field: &Field| FieldDescription {
            name: field.name.to_owned(),
            kind: field.kind.ros_name().to_owned(),
            count: field.count,
            array: field.array,
        };
        SignalDescription {
            name: signal.name.clone(),
            lane: signal.lane,
            type_name: signal.type_name.clone().into_owned(),
            size: signal.size,
            fields: signal.fields.iter().map(field).collect(),
        }
    }
}

impl FlightGrants {
    /// The part of an attestation that a recording holds.
    pub(super) fn new(attestation: &Attestation) -> FlightGrants {
        FlightGrants {
            granted: attestation.is_granted(),
            shortfalls: attestation.shortfalls.iter().map(ToString::to_string).collect(),
            notes: attestation.notes.clone(),
            preempt_rt: attestation.preempt_rt,
            virtual_machine: attestation.virtual_machine,
            zero_unix_ns: None,
            ended: false,
        }
    }
}

/// A JSON object whose keys are sorted.
pub(super) fn sorted_json(object: &impl Serialize) -> String {
    serde_json::to_value(object).unwrap_or_default().to_string()
}
