//! Whatever stands in a scene, a machine file, a robot description, a key map, a motion's table, a
//! plan of faults, the description of a board, or is said by an operator in words or in JSON:
//! understood, or refused with a place and a remedy; never a panic.
//! The first byte says which it is.
#![no_main]

use std::path::PathBuf;

use libfuzzer_sys::fuzz_target;
use taktil_drivers_regmap::Description;
use taktil_fuzz::{finite, rigid};
use taktil_hal::fault::Fault;
use taktil_lab_emulate::faults_of_text;
use taktil_lab_command::keys::map::MapFile;
use taktil_lab_scene::scene::Scene;
use taktil_machine::operator::command::CommandContext;
use taktil_machine::source::Source;
use taktil_machine_operator::check_line;
use taktil_mechanics::spatial::JointVector;

const MACHINE: &str = include_str!("../../../sim/scenes/machine/puma260.toml");
const SCENE: &str = include_str!("../../../sim/scenes/hold.toml");
const SCENE_WITH_TABLE: &str = "title = \"t\"\nmachine = \"machine/puma260.toml\"\n\
                                [[world.table.motion]]\naxis = \"slide\"\nfile = \"hand.csv\"\n";
const TABLE: &str = "t_s,slide_mm\n0,0\n1,2\n";

fn source(name: &str, text: &str) -> Source {
    Source { path: PathBuf::from(name), text: text.to_owned() }
}

fn scene(scene: &str, machine: &str, table: &str) {
    let beside = |name: &str| match name.rsplit('.').next() {
        Some("urdf") => Ok(source(name, include_str!("../../../sim/arms/ur5e-like.urdf"))),
        Some("csv") => Ok(source(name, table)),
        _ => Err(format!("there is no file `{name}`")),
    };
    let machine = Some(source("machine.toml", machine));
    match Scene::of(source("scene.toml", scene), machine, &beside) {
        Ok(scene) => finite("start", &scene.start_deg),
        Err(refused) => {
            assert!(!refused.what.is_empty() && !refused.remedy.is_empty());
            // It is shown to people: with a mark that stands in its line, and in a few words.
            let shown = refused.to_string();
            assert!(shown.contains("error: ") && shown.len() <= 2048, "{} bytes", shown.len());
            assert!(!shown.contains('\u{1b}'), "{shown}");
        }
    }
}

fn arm(text: &str) {
    let whole = taktil_machine::urdf::Selection::default();
    let Ok(described) = taktil_machine::urdf::read(text, &whole) else { return };
    if let Ok(chain) = described.chain::<6>() {
        let q = JointVector::<6>::repeat(0.3);
        rigid("pose", &chain.tool_pose(&q));
        finite("gravity", chain.gravity_torque(&q).iter());
    }
    if let Ok(chain) = described.chain::<7>() {
        rigid("pose", &chain.tool_pose(&JointVector::<7>::repeat(0.3)));
    }
}

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, text)) = bytes.split_first() else { return };
    let Ok(text) = std::str::from_utf8(text) else { return };
    match kind % 8 {
        0 => scene(text, MACHINE, TABLE),
        1 => scene(SCENE, text, TABLE),
        2 => arm(text),
        5 => scene(SCENE_WITH_TABLE, MACHINE, text),
        6 => {
            let _ = text.lines().next().map(str::parse::<Fault>);
            if let Err(refused) = faults_of_text(&source("plan.toml", text)) {
                assert!(!refused.what.is_empty() && refused.to_string().len() <= 2048);
            }
        }
        7 => {
            if let Err(refused) = Description::from_toml(text) {
                assert!(!refused.what.is_empty() && refused.to_string().len() <= 2048);
            }
        }
        3 => {
            let _ = toml::from_str::<MapFile>(text).map(|file| file.check());
        }
        _ => {
            for line in text.lines() {
                if let Err(bad) = check_line(line, &CommandContext::default()) {
                    assert!(!bad.what.is_empty() && !bad.remedy.is_empty(), "{line}");
                }
            }
        }
    }
});
