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
    joined_log_holds_both(&folder, &memory, &logged, &after);
    let drawn = ["plot", "after.mcap", "--what", "torques", "--out", "drawn"];
    taktil(folder.path(), &drawn).expect_code(0);
}

/// The log of the killed run goes on, without a hole, to the recorder's last record.
fn joined_log_holds_both(
    folder: &Folder,
    memory: &Shm,
    logged: &BTreeMap<(String, u64), Vec<u8>>,
    after: &BTreeMap<(String, u64), Vec<u8>>,
) {
    let join = ["postmortem", memory.path(), "--join", "killed.mcap", "--log", "whole.mcap"];
    let said = taktil(folder.path(), &join).expect_code(0);
    let whole = Log::open(&folder.join("whole.mcap")).unwrap();
    assert_eq!(whole.damage(), None);
    assert_eq!(whole.metadata()["taktil.run"]["mode"], "live");
    let all = messages(&whole);
    let added = after.keys().filter(|key| !logged.contains_key(*key)).count();
    assert_eq!(all.len(), logged.len() + added);
    assert!(said.out.contains(&format!("{} messages, {added} of them only here", all.len())));
    for (key, data) in logged.iter().chain(after) {
        assert_eq!(all.get(key), Some(data), "{key:?}");
    }
    let ticks: Vec<u64> =
        all.keys().filter(|key| key.0 == "/servo/health").map(|key| key.1).collect();
    assert!(ticks.iter().copied().eq(0..ticks.len() as u64), "ticks are missing");
    let missing = ticks.len() - logged.keys().filter(|key| key.0 == "/servo/health").count();
    println!("the log of the killed run lacked {missing} jobs of the servo lane");
    // One that is of another run shares no message with it.
    let scene = scenes().join("roll-pin.toml");
    let other = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.2", "--seed", "77"];
    let other: Vec<&str> = other.into_iter().chain(["--log", "other.mcap"]).collect();
    taktil(folder.path(), &other).expect_code(0);
    let join = ["postmortem", memory.path(), "--join", "other.mcap", "--log", "no.mcap"];
    let said = taktil(folder.path(), &join).expect_code(2);
    assert!(said.err.contains("two runs") || said.err.contains("one run"), "{}", said.err);
    assert!(!folder.join("no.mcap").exists());
    let alone = ["postmortem", memory.path(), "--join", "killed.mcap"];
    assert!(taktil(folder.path(), &alone).expect_code(2).err.contains("--log"));
}

#[test]
fn a_flight_file_and_a_log_survive_starts_that_fail() {
    let (folder, memory) = (Folder::new(), Shm::new("kept"));
    let scene = scenes().join("roll-pin.toml");
    let scene = scene.to_str().unwrap();
    let files = ["--log", "kept.mcap", "--flight", memory.path()];
    let with = |words: &[&'static str]| -> Vec<String> {
        let first = ["run", scene, "--fast", "--for", "0.3"];
        first.iter().chain(words).chain(&files).map(|word| (*word).to_owned()).collect()
    };
    let words = |words: &[String]| words.iter().map(String::as_str).collect::<Vec<_>>().join(" ");
    let run = |arguments: &[String], code: i32| {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        taktil(folder.path(), &arguments).expect_code(code)
    };
    run(&with(&[]), 0);
    let kept = || {
        let log = std::fs::read(folder.join("kept.mcap")).unwrap();
        (log, std::fs::read(&memory.0).unwrap())
    };
    let before = kept();
    for failing in [&["--operator", "op"][..], &["--for", "x"], &["--report", "kept.mcap"]] {
        let arguments = with(failing);
        run(&arguments, 2);
        assert!(kept() == before, "{}", words(&arguments));
    }
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
