//! `taktil log`: what is in a log, as text, and new logs made of old ones.

use serde_json::Value;
use taktil_record::{Log, Message};

use crate::process::{Folder, scenes, taktil};

/// A folder with `run.mcap`: half a second of the rolling scene.
fn folder_with_log() -> Folder {
    let folder = Folder::new();
    let scene = scenes().join("roll-pin.toml");
    let run = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.5", "--log", "run.mcap"];
    taktil(folder.path(), &run).expect_code(0);
    folder
}

fn open(folder: &Folder, name: &str) -> Log {
    Log::open(&folder.join(name)).unwrap()
}

fn object(folder: &Folder, arguments: &[&str], code: i32) -> Value {
    let said = taktil(folder.path(), arguments).expect_code(code);
    serde_json::from_str(&said.out).unwrap()
}

fn data<'a>(message: &Message<'a>) -> (usize, &'a [u8]) {
    (message.channel, message.data)
}

#[test]
fn info_and_cat_show_what_is_there() {
    let folder = folder_with_log();
    let log = open(&folder, "run.mcap");
    assert!(log.chunks() >= 4, "{} chunks of half a second", log.chunks());
    let info = object(&folder, &["log", "info", "run.mcap", "--json"], 0);
    assert_eq!(info["messages"].as_u64(), Some(log.messages().count() as u64));
    assert!(info["damage"].is_null() && info["gaps"] == Value::Array(Vec::new()), "{info}");
    let joints = info["signals"].as_array().unwrap();
    let joints = joints.iter().find(|signal| signal["signal"] == "sense.joints").unwrap();
    assert_eq!(joints["messages"].as_u64(), Some(200));
    assert!((joints["rate_hz"].as_f64().unwrap() - 400.0).abs() < 1e-6, "{joints}");
    let said = taktil(folder.path(), &["log", "info", "run.mcap"]).expect_code(0).out;
    assert!(
        said.contains("damage                     none") && said.contains("400.0 Hz"),
        "{said}"
    );

    let part = ["--signal", "sense.joints", "--from", "0.1", "--to", "0.2"];
    let cat = |more: &[&str]| {
        let words: Vec<&str> =
            ["log", "cat", "run.mcap"].iter().chain(&part).chain(more).copied().collect();
        taktil(folder.path(), &words).expect_code(0).out
    };
    assert_eq!(cat(&[]).lines().count(), 40);
    assert!(cat(&[]).starts_with("0.100000 sense.joints 40 q_rad=["), "{}", cat(&[]));
    let series = log.series("sense.joints").unwrap();
    let json = cat(&["--json"]);
    let first: Value = serde_json::from_str(json.lines().next().unwrap()).unwrap();
    assert_eq!(first["tick"], 40);
    assert_eq!(first["value"]["q_rad"][2].as_f64(), Some(series.values("q_rad", 2)[40]));
    let csv = cat(&["--csv"]);
    let mut lines = csv.lines();
    assert!(lines.next().unwrap().starts_with("t_s,tick,q_rad[0],"));
    let cells: Vec<&str> = lines.next().unwrap().split(',').collect();
    assert_eq!(cells[4].parse::<f64>().unwrap(), series.values("q_rad", 2)[40]);
    let states = taktil(folder.path(), &["log", "cat", "run.mcap", "--signal", "servo.state"]);
    assert_eq!(states.expect_code(0).out.lines().count(), 200);
    for (bad, says) in [
        (&["--signal", "nobody.nothing"][..], "has no such signal"),
        (&["--csv"], "name one --signal"),
        (&["--from", "2", "--to", "1"], "no time before"),
        (&["--from", "nan"], "give a number"),
    ] {
        let words: Vec<&str> = ["log", "cat", "run.mcap"].iter().chain(bad).copied().collect();
        let said = taktil(folder.path(), &words).expect_code(2);
        assert!(said.err.contains(says), "{bad:?}: {}", said.err);
    }
}

#[test]
fn a_cut_log_becomes_whole_and_says_what_is_lost() {
    let folder = folder_with_log();
    let bytes = std::fs::read(folder.join("run.mcap")).unwrap();
    folder.write("cut.mcap", &bytes[..bytes.len() * 2 / 3]);
    let info = object(&folder, &["log", "info", "cut.mcap", "--json"], 1);
    let cut = open(&folder, "cut.mcap");
    assert_eq!(info["damage"]["what"], cut.damage().unwrap().what);
    let out = ["log", "recover", "cut.mcap", "--out", "whole.mcap", "--json"];
    let said = object(&folder, &out, 0);
    assert!(said["lost"].as_str().unwrap().contains("readable up to byte"), "{said}");
    let whole = open(&folder, "whole.mcap");
    assert_eq!(whole.damage(), None);
    assert!(whole.messages().map(|m| data(&m)).eq(cut.messages().map(|m| data(&m))));
    assert!(whole.metadata()["taktil.recovered"]["damage"].contains("readable up to"));
    let said = taktil(folder.path(), &["log", "info", "whole.mcap"]).expect_code(0).out;
    assert!(said.contains("recovered"), "{said}");
    let same = ["log", "recover", "cut.mcap", "--out", "./cut.mcap"];
    assert!(taktil(folder.path(), &same).expect_code(2).err.contains("is what is read"));
    assert!(taktil(folder.path(), &["log", "info", "nowhere"]).expect_code(2).err.contains("read"));
}

#[test]
fn parts_are_logs_and_parts_packed_are_the_whole() {
    let folder = folder_with_log();
    let filter = |out: &str, more: &[&str]| {
        let words: Vec<&str> =
            ["log", "filter", "run.mcap", "--out", out].iter().chain(more).copied().collect();
        taktil(folder.path(), &words).expect_code(0)
    };
    filter("a.mcap", &["--to", "0.3"]);
    filter("b.mcap", &["--from", "0.25"]);
    filter("joints.mcap", &["--signal", "sense.joints"]);
    assert_eq!(open(&folder, "joints.mcap").messages().count(), 200);
    let pack = ["log", "pack", "b.mcap", "a.mcap", "--out", "all.mcap"];
    taktil(folder.path(), &pack).expect_code(0);
    let equal = ["diff", "run.mcap", "all.mcap"];
    taktil(folder.path(), &equal).expect_code(0);
    taktil(folder.path(), &["replay", "all.mcap"]).expect_code(0);
    let scene = scenes().join("roll-pin.toml");
    let other = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.1", "--seed", "9"];
    let other: Vec<&str> = other.into_iter().chain(["--log", "other.mcap"]).collect();
    taktil(folder.path(), &other).expect_code(0);
    let pack = ["log", "pack", "a.mcap", "other.mcap", "--out", "no.mcap"];
    let said = taktil(folder.path(), &pack).expect_code(2);
    assert!(said.err.contains("different recordings"), "{}", said.err);
}

#[test]
fn a_log_for_viewers_begins_with_its_first_message_and_not_in_1970() {
    let folder = folder_with_log();
    let said = object(&folder, &["log", "export", "run.mcap", "--out", "view.mcap", "--json"], 0);
    let bytes = std::fs::read(folder.join("view.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let stats = summary.stats.unwrap();
    let all = said["messages"].as_u64().unwrap() + said["for_viewers"].as_u64().unwrap();
    assert_eq!((stats.message_count, stats.attachment_count), (all, 1));
    let begin = summary.chunk_indexes.iter().map(|chunk| chunk.message_start_time).min();
    assert_eq!(begin, Some(stats.message_start_time));
    assert!(begin > Some(0), "{begin:?}");
}
