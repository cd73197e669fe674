//! Faults of a plan in a scene: `[[world.fault]]` puts them into halves, lanes and tasks, and what
//! cannot befall them is refused in its line.

use std::path::Path;

use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::run_virtual;
use taktil_lab_scene::scene::Scene;
use taktil_machine::source::{FileKind, Located, Source};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{FaultCode, Nanos, Payload};
use taktil_signal::ControlState;

/// The scene of the arm in the air that an operator enables, with this fault.
fn scene(fault: &str) -> Result<Scene, Located> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes");
    let path = folder.join("storm/free.toml");
    let machine = Source::read(&folder.join("machine/puma260.toml"), FileKind::Machine)?;
    let text = std::fs::read_to_string(&path).unwrap();
    let text = format!("{text}\n[[operator]]\nverb = \"enable\"\n\n[[world.fault]]\n{fault}\n");
    let none = |file: &str| Err(format!("no file {file}"));
    Scene::of(Source { path, text }, Some(machine), &none)
}

/// The first fault that was latched.
#[derive(Default)]
struct FirstFault {
    control: Option<usize>,
    code: u32,
}

impl Observer for FirstFault {
    fn record(&mut self, record: &Record<'_>) {
        if Some(record.signal) == self.control && self.code == 0 {
            self.code = ControlState::decode(record.body).unwrap().first_fault;
        }
    }
}

#[test]
fn a_scene_names_faults_of_halves_lanes_and_tasks() {
    for (fault, code) in [
        ("kind = \"jump\"\ntarget = \"encoders.3\"\nvalue = 5000.0", FaultCode::EncoderJump),
        ("kind = \"failing\"\ntarget = \"analog_out\"\nvalue = 1.0", FaultCode::AnalogOutLost),
        ("kind = \"overrun\"\ntarget = \"lane.servo\"\nvalue = 0.01", FaultCode::OverrunStorm),
        ("kind = \"panic\"\ntarget = \"task.setpoint\"", FaultCode::TaskPanicked),
    ] {
        let scene = scene(&format!("at_s = 0.5\nfor_s = 0.1\n{fault}")).unwrap();
        let mut machine = Assembly::new(&scene).build().unwrap();
        let control = machine.catalog().find("supervisor.control");
        let mut first = FirstFault { control, code: 0 };
        run_virtual(&mut machine, Nanos::from_secs(1), &mut first).unwrap();
        assert_eq!(first.code, code as u32, "{fault}");
    }
}

#[test]
fn what_cannot_befall_the_machine_is_refused_in_its_line() {
    for (fault, key) in [
        ("at_s = 0.5\nkind = \"jump\"\nvalue = 5.0", "no target"),
        ("at_s = 0.5\nkind = \"jump\"\ntarget = \"encoders\"", "missing for `jump`"),
        ("at_s = 0.5\nkind = \"hot\"\ntarget = \"encoders\"", "cannot befall"),
        ("at_s = 0.5\nkind = \"dead\"\ntarget = \"encoders.9\"", "channels"),
        ("at_s = 0.5\nkind = \"panic\"\ntarget = \"task.nobody\"", "there is no task"),
        ("at_s = 0.5\nkind = \"power_loss\"\ntarget = \"encoders\"", "does not belong"),
    ] {
        let refused = scene(fault).and_then(|scene| Assembly::new(&scene).build().map(drop));
        let refused = refused.unwrap_err();
        assert!(refused.what.contains(key), "{fault}: {refused}");
        assert!(refused.mark.is_some(), "{fault}: {refused}");
    }
}
