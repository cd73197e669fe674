//! A run that is killed in its midst, and what the flight recorder kept of it; files that are none.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use taktil_record::Log;

use crate::process::{Folder, TAKTIL, scenes, taktil};

/// A file in memory, removed at the end of its test.
struct Shm(PathBuf);

impl Shm {
    fn new(name: &str) -> Shm {
        Shm(Path::new("/dev/shm").join(format!("taktil-cli-{name}-{}", std::process::id())))
    }

    fn path(&self) -> &str {
        self.0.to_str().unwrap()
    }
}

impl Drop for Shm {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Bytes of every message by topic and tick.
fn messages(log: &Log) -> BTreeMap<(String, u64), Vec<u8>> {
    let channels = log.channels();
    log.messages().map(|m| ((channels[m.channel].topic.clone(), m.tick), m.data.to_vec())).collect()
}

#[test]
fn what_a_killed_run_did_last_is_read_from_its_flight_recorder() {
    let (folder, memory) = (Folder::new(), Shm::new("killed"));
    let scene = scenes().join("roll-pin.toml");
    let mut child = Command::new(TAKTIL)
        .args(["run", scene.to_str().unwrap(), "--json", "--log", "killed.mcap", "--flight"])
        .arg(memory.path())
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let enough = || {
        let bytes = std::fs::read(&memory.0).unwrap_or_default();
        let found = taktil_rtcore::flight::read(&bytes);
        found.is_ok_and(|found| found.lanes[0].tick > 200)
    };
    let came = (0..600).any(|_| {
        std::thread::sleep(Duration::from_millis(50));
        enough()
    });
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(came, "half a second of jobs in half a minute");

    let arguments = ["postmortem", memory.path(), "--log", "after.mcap"];
    let said = taktil(folder.path(), &arguments).expect_code(0);
    for word in ["mode  ", "lane servo", "lane touch", "lane world", "servo.health", "last values"]
    {
        assert!(said.out.contains(word), "not `{word}` in\n{}", said.out);
    }
    let said = taktil(folder.path(), &["postmortem", memory.path(), "--json"]).expect_code(0);
    let summary: Value = serde_json::from_str(&said.out).unwrap();
    for lane in summary["lanes"].as_array().unwrap() {
        assert!(lane["damage"].is_null(), "{lane}");
        assert!(lane["jobs_kept"].as_u64().unwrap() > 50, "{lane}");
    }
    let last = &summary["last"]["servo.health"];
    let tick = summary["lanes"][0]["last_job"].as_u64().unwrap();
    let health = last["tick"].as_u64().unwrap();
    assert!(health == tick || health + 1 == tick, "the last whole job: {health} of {tick}");
    assert_eq!(last["value"]["jobs"].as_u64(), Some(health + 1));
    assert!(summary["age_s"].as_f64().is_some_and(|age| (0.0..600.0).contains(&age)), "{summary}");

    // Where both were kept they are the same bytes; the recorder goes further than the log.
    let logged = Log::open(&folder.join("killed.mcap")).unwrap();
    let after = Log::open(&folder.join("after.mcap")).unwrap();
    assert_eq!(after.damage(), None);
    let (logged, after) = (messages(&logged), messages(&after));
    let both = after.iter().filter(|(key, _)| logged.contains_key(*key)).count();
    assert!(both > 1000, "{both}");
    for (key, data) in &after {
        assert!(logged.get(key).is_none_or(|other| other == data), "{key:?}");
    }
    let newest = |all: &BTreeMap<(String, u64), Vec<u8>>| {
        all.keys().filter(|key| key.0 == "/servo/health").map(|key| key.1).max()
    };
    assert!(newest(&after) >= newest(&logged));
    let drawn = ["plot", "after.mcap", "--what", "torques", "--out", "drawn"];
    taktil(folder.path(), &drawn).expect_code(0);
}

#[test]
fn files_that_are_no_recording_are_refused_in_one_line() {
    let folder = Folder::new();
    folder.write("empty", "");
    folder.write("text", "dear diary");
    folder.write("zeros", vec![0; 1 << 16]);
    let memory = Shm::new("cut");
    let scene = scenes().join("roll-pin.toml");
    let run = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.1", "--flight", memory.path()];
    taktil(folder.path(), &run).expect_code(0);
    let whole = std::fs::read(&memory.0).unwrap();
    folder.write("cut", &whole[..whole.len() / 2]);
    folder.write("header", &whole[..4096]);
    let mut garbled = whole.clone();
    garbled[4096 + 20..4096 + 40].fill(b'x');
    folder.write("garbled", garbled);
    for (file, says) in [
        ("nowhere", "No such file"),
        (".", "is a directory"),
        ("empty", "it is empty"),
        ("text", "it is no flight recording"),
        ("zeros", "it is no flight recording"),
        ("cut", "it is cut"),
        ("header", "it is cut"),
        ("garbled", "is damaged"),
    ] {
        let said = taktil(folder.path(), &["postmortem", file]).expect_code(2);
        assert!(said.err.contains(says), "{file}: {}", said.err);
        assert_eq!(said.err.trim_end().lines().count(), 1, "{}", said.err);
    }
    let own = ["postmortem", memory.path(), "--log", memory.path()];
    assert!(taktil(folder.path(), &own).expect_code(2).err.contains("is what is read"));
    let disk = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.1", "--flight", "/proc/x"];
    let said = taktil(folder.path(), &disk).expect_code(2);
    assert!(said.err.contains("name a file in /run or /dev/shm"), "{}", said.err);
}
