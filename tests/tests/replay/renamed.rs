//! A log from before ports, payload fields and keys were renamed: it is read under the names of
//! today, and its run is repeated.

use std::sync::atomic::AtomicBool;

use taktil_lab_command::replay;
use taktil_machine::renamed::RENAMED_KEYS;
use taktil_record::{Log, McapLog};
use taktil_rtcore::payload::Field;
use taktil_rtcore::record::{Catalog, Signal};
use taktil_rtcore::virtual_time;
use taktil_signal::renamed::{RENAMED_FIELDS, RENAMED_PAYLOADS, RENAMED_PORTS, earlier_port};
use taktil_tests::bench::machine;

/// The signal under the names that it had before.
fn earlier_signal(signal: &Signal) -> Signal {
    let name_before = |table: &[(&str, &'static str, &str)], name: &str| {
        let renamed = table.iter().find(|row| row.0 == signal.name && row.2 == name);
        renamed.map_or_else(|| name.to_owned(), |row| row.1.to_owned())
    };
    let field = |field: &Field| Field {
        name: String::leak(name_before(RENAMED_FIELDS, field.name)),
        ..*field
    };
    let fields: Vec<Field> = signal.fields.iter().map(field).collect();
    Signal {
        name: earlier_port(&signal.name).to_owned(),
        type_name: name_before(RENAMED_PAYLOADS, &signal.type_name).into(),
        fields: fields.into(),
        ..signal.clone()
    }
}

fn earlier_catalog(catalog: &Catalog) -> Catalog {
    let mut lanes = catalog.lanes.clone();
    for signal in lanes.iter_mut().flat_map(|lane| &mut lane.reads) {
        *signal = earlier_port(signal).to_owned();
    }
    Catalog { signals: catalog.signals.iter().map(earlier_signal).collect(), lanes }
}

/// The text with the ports and the keys that it had before.
fn earlier_text(text: &str) -> String {
    let mut text = format!("\n{text}");
    for (old, new) in RENAMED_PORTS {
        text = text.replace(&format!("\"{new}\""), &format!("\"{old}\""));
    }
    for key in RENAMED_KEYS {
        text = text.replace(&format!("\n{} =", key.new), &format!("\n{} =", key.old));
    }
    text
}

#[test]
fn a_log_under_the_old_names_is_read_under_the_new_ones_and_replayed() {
    let scene = super::scene(0.5);
    let mut machine = machine(&scene, 1);
    let catalog = earlier_catalog(machine.catalog());
    assert!(catalog.find("trajectory.typed").is_some());
    let mut about = super::run_metadata(&scene, "fast");
    let text = earlier_text(scene.machine_text());
    for old in ["\"operator.typed\" = \"trajectory.typed\"", "learned_turn_rad ="] {
        assert!(text.contains(old), "{old} is not in the machine file of before");
    }
    about.insert("machine_text".into(), text);
    let mut log = McapLog::in_memory(&catalog, &about).unwrap();
    virtual_time::run(&mut machine, scene.duration, &AtomicBool::new(false), &mut log).unwrap();
    let bytes = log.into_bytes().unwrap();

    let log = Log::from_bytes(bytes.clone()).unwrap();
    for signal in &machine.catalog().signals {
        let channel = &log.channels()[log.find(&signal.name).expect(&signal.name)];
        let names: Vec<&str> = channel.payload_fields().iter().map(|f| f.name.as_str()).collect();
        let due: Vec<&str> = signal.fields.iter().map(|field| field.name).collect();
        assert_eq!((names, channel.type_name.as_str()), (due, &*signal.type_name));
        assert_eq!(channel.topic, taktil_record::topic(&signal.name));
    }
    let moves = log.find("trajectory.queue");
    assert!(moves.is_some() && log.find("trajectory.typed") == moves);

    let (outcome, _) = replay::repeat(Log::from_bytes(bytes).unwrap()).unwrap();
    assert!(outcome.equal() && outcome.gap.is_none(), "{}", replay::text(&outcome));
    let compared = outcome.comparison.compared.iter();
    assert!(compared.clone().any(|signal| signal.signal == "trajectory.queue"));
}
