//! `taktil replay` and `taktil diff` as processes: exit codes, the log of the repeated run, and
//! repeated edits of a scene. The comparison itself is tested in `tests/tests/replay`.

use std::path::PathBuf;

use serde_json::Value;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_machine::tape::EncoderEntry;
use taktil_record::{Log, METADATA_RUN, McapLog};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{Nanos, Payload};

use crate::process::{Folder, ProcessOutput, scenes, taktil};

/// A short rolling scene whose gains are edited during the run.
fn edited(folder: &Folder) -> PathBuf {
    let text = std::fs::read_to_string(scenes().join("roll-pin.toml")).unwrap();
    let machine = scenes().join("machine/puma260.toml");
    let text = text.replace("machine/puma260.toml", machine.to_str().unwrap());
    let edits = "[[edit]]\nat_s = 0.3\nset = { \"joint_servo.damping\" = 0.6 }\n\n\
                 [[edit]]\nat_s = 0.4\nset = { \"joint_servo.damping[2]\" = 0.4 }\n\n";
    folder.write("edited.toml", text.replacen("[start]", &format!("{edits}[start]"), 1))
}

/// Its log of half a second in virtual time.
fn logged(folder: &Folder) -> PathBuf {
    edited(folder);
    let run = ["run", "edited.toml", "--fast", "--for", "0.5", "--log", "run.mcap"];
    taktil(folder.path(), &run).expect_code(0);
    folder.join("run.mcap")
}

fn object(said: &ProcessOutput) -> Value {
    serde_json::from_str(&said.out).unwrap_or_else(|why| panic!("{why}: {}", said.out))
}

#[test]
fn an_edited_run_is_repeated_with_exit_0_and_its_repetition_is_a_log_of_its_own() {
    let folder = Folder::new();
    let log = Log::open(&logged(&folder)).unwrap();
    let edits = log.find("servo.edit").expect("the lane says what it took");
    let taken: Vec<i64> =
        log.messages().filter(|m| m.channel == edits).map(|m| m.release_ns).collect();
    assert_eq!(taken, [300_000_000, 400_000_000]);
    let said = taktil(folder.path(), &["replay", "run.mcap", "--out", "again.mcap"]).expect_code(0);
    assert!(said.out.contains("\nequal: "), "{}", said.out);
    let said = taktil(folder.path(), &["replay", "run.mcap", "--json"]).expect_code(0);
    assert_eq!(object(&said)["equal"], true);
    let again = Log::open(&folder.join("again.mcap")).unwrap();
    assert!(again.damage().is_none());
    assert_eq!(again.messages().count(), log.messages().count());
    taktil(folder.path(), &["diff", "run.mcap", "again.mcap"]).expect_code(0);
    // Without the edits the run differs, and the first difference is in the task that was edited.
    let scene = scenes().join("roll-pin.toml");
    let plain = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.5", "--log", "plain.mcap"];
    taktil(folder.path(), &plain).expect_code(0);
    let said = taktil(folder.path(), &["diff", "run.mcap", "plain.mcap"]).expect_code(1);
    for word in ["tick   120", "time   0.300000000 s", "task   joint_servo"] {
        assert!(said.out.contains(word), "{}", said.out);
    }
}

#[test]
fn a_run_that_does_not_repeat_ends_with_1_and_says_where() {
    let folder = Folder::new();
    let log = Log::open(&logged(&folder)).unwrap();
    // One bit of one recorded answer of a device is flipped, in a log whose checksums are correct
    // again.
    let scene = Scene::load(&folder.join("edited.toml")).unwrap();
    let catalog = Assembly::new(&scene).build().unwrap().catalog().clone();
    let about = &log.metadata()[METADATA_RUN];
    let mut out = McapLog::create(&folder.join("altered.mcap"), &catalog, about).unwrap();
    for message in log.messages() {
        let signal = catalog.find(&log.channels()[message.channel].signal).unwrap();
        let mut body = message.body[..catalog.signals[signal].size].to_vec();
        if catalog.signals[signal].name == "hal.encoders" && message.tick == 150 {
            let mut entry = <EncoderEntry>::decode(&body).unwrap();
            entry.counts[1] ^= 1;
            entry.encode(&mut body);
        }
        let release = Nanos(message.release_ns);
        out.record(&Record { signal, tick: message.tick, release, body: &body });
    }
    out.finish().unwrap();
    let said = taktil(folder.path(), &["replay", "altered.mcap"]).expect_code(1);
    assert!(said.out.contains("\ndifferent: ") && said.out.contains("sense"), "{}", said.out);
    let said = taktil(folder.path(), &["replay", "altered.mcap", "--json"]).expect_code(1);
    assert_eq!(object(&said)["equal"], false);
}

#[test]
fn a_log_that_is_cut_or_none_ends_with_2() {
    let folder = Folder::new();
    let bytes = std::fs::read(logged(&folder)).unwrap();
    folder.write("cut.mcap", &bytes[..bytes.len() / 2]);
    let said = taktil(folder.path(), &["replay", "cut.mcap"]).expect_code(2);
    assert!(said.out.contains("equal until there"), "{}", said.out);
    assert!(said.out.contains("not whole: "), "{}", said.out);
    folder.write("none.mcap", "tick,release\n");
    for log in ["none.mcap", "nowhere.mcap"] {
        let said = taktil(folder.path(), &["replay", log]).expect_code(2);
        assert!(said.out.is_empty() && said.err.contains(log), "{}", said.err);
    }
    let said =
        taktil(folder.path(), &["replay", "run.mcap", "--out", "no/such/place"]).expect_code(2);
    assert!(said.err.contains("--out no/such/place: "), "{}", said.err);
}

#[test]
fn a_bit_that_changed_outside_the_messages_is_reported() {
    let folder = Folder::new();
    let bytes = std::fs::read(logged(&folder)).unwrap();
    let flipped = |name: &str, at: usize| {
        let mut bad = bytes.clone();
        bad[at] ^= 1;
        folder.write(name, &bad);
        taktil(folder.path(), &["diff", "run.mcap", name]).expect_code(1);
        taktil(folder.path(), &["replay", name])
    };
    // A number that no task reads, after its key and its length.
    let key = b"phase_ns";
    let at = bytes.windows(key.len()).position(|found| found == key).unwrap() + key.len() + 4;
    let said = flipped("channel.mcap", at).expect_code(2);
    assert!(said.out.contains("the checksum over all of it fails"), "{}", said.out);
    assert!(said.out.contains("equal until there"), "{}", said.out);
    // The footer is not part of the run.
    let said = flipped("footer.mcap", bytes.len() - 30).expect_code(0);
    assert!(said.out.contains("the file is damaged all the same: "), "{}", said.out);
    assert!(said.out.contains("the closing summary fails its checksum"), "{}", said.out);
}
