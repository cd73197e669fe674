//! `taktil run`: figures, exit code, recording, and the command that repeats the run. Wall time is
//! not tested.

use serde_json::Value;
use taktil_record::Log;

use crate::process::{Folder, scenes, taktil};

fn json(folder: &Folder, options: &[&str]) -> Value {
    let scene = scenes().join("roll-pin.toml");
    let mut arguments = vec!["run", scene.to_str().unwrap(), "--fast", "--json"];
    arguments.extend(options);
    let said = taktil(folder.path(), &arguments).expect_code(0);
    assert_eq!(said.out.lines().count(), 1, "one object on one line: {}", said.out);
    serde_json::from_str(&said.out).unwrap()
}

fn width(span: &Value) -> f64 {
    span[1].as_f64().unwrap() - span[0].as_f64().unwrap()
}

#[test]
fn the_pin_rolls_and_the_figures_say_so() {
    let folder = Folder::new();
    let s = json(&folder, &[]);
    assert_eq!((&s["ok"], &s["mode"], &s["seed"]), (&true.into(), &"fast".into(), &1.into()));
    assert!(s["strokes"].as_u64().unwrap() >= 3, "{}", s["strokes"]);
    let (low, high) = (s["x_c"][0].as_f64().unwrap(), s["x_c"][1].as_f64().unwrap());
    assert!(low > 2.0 && high < 15.0, "x_c from {low} to {high}");
    let p_x = width(&s["p_x_mm"]);
    assert!((30.0..=40.0).contains(&p_x), "p_x spans {p_x} mm");
    let ratio = p_x / ((high - low) * 25.4 / 16.0);
    assert!((ratio - 2.0).abs() <= 0.1, "{ratio}");
    assert!((s["rolling_ratio"].as_f64().unwrap() - ratio).abs() < 1e-9);
    assert_eq!(s["faults"], Value::Array(Vec::new()));
    assert_eq!(s["representative_timing"], false, "virtual time says nothing about timing");
    let lanes = s["lanes"].as_array().unwrap();
    assert_eq!(lanes.len(), 3);
    for lane in lanes {
        assert_eq!(lane["allocations"], 0, "{}", lane["name"]);
        assert_eq!((&lane["skipped"], &lane["records_dropped"]), (&0.into(), &0.into()));
    }
    assert_eq!(folder.listing(), [], "a run without --log and --report writes nothing");
}

#[test]
fn contacts_in_three_dimensions_are_counted_where_the_scene_asks_for_them() {
    let folder = Folder::new();
    assert!(json(&folder, &["--for", "0.1"])["truth"]["layer"].is_null());
    let text = std::fs::read_to_string(scenes().join("roll-pin.toml")).unwrap();
    let machine = scenes().join("machine/puma260.toml");
    let text = text.replace("machine/puma260.toml", machine.to_str().unwrap())
        + "\n[world.fidelity]\ncontact = \"layer-3d\"\n";
    std::fs::write(folder.join("scene.toml"), text).unwrap();
    let run = ["run", "scene.toml", "--fast", "--for", "2.2"];
    let said = taktil(folder.path(), &[&run[..], &["--json"]].concat()).expect_code(0);
    let s: Value = serde_json::from_str(&said.out).unwrap();
    let layer = &s["truth"]["layer"];
    assert!(layer["spatial_solutions"].as_u64().unwrap() > 20, "{layer}");
    assert_eq!(layer["spatial_failures"], 0, "{layer}");
    let table = taktil(folder.path(), &run).expect_code(0).out;
    let row = format!("contacts solved for images {}", layer["spatial_solutions"]);
    assert!(table.contains(&row) && table.contains("rows on their own"), "{table}");
}

#[test]
fn one_seed_gives_one_recording_and_another_seed_another() {
    let folder = Folder::new();
    let run = |name: &str, seed: &str| {
        let summary = json(&folder, &["--for", "1.5", "--seed", seed, "--log", name]);
        let log = Log::open(&folder.join(name)).unwrap();
        assert!(log.damage().is_none());
        (summary["digest"].as_str().unwrap().to_owned(), log)
    };
    let (a, b, c) = (run("a.mcap", "7"), run("b.mcap", "7"), run("c.mcap", "8"));
    let same = |a: &Log, b: &Log| {
        let mut pairs = a.messages().zip(b.messages());
        let equal = |a: taktil_record::Message<'_>, b: taktil_record::Message<'_>| {
            (a.channel, a.tick, a.release_ns, a.data) == (b.channel, b.tick, b.release_ns, b.data)
        };
        a.messages().count() == b.messages().count() && pairs.all(|(a, b)| equal(a, b))
    };
    assert!(a.0 == b.0 && same(&a.1, &b.1), "one seed, two recordings");
    assert!(a.0 != c.0 && !same(&a.1, &c.1), "two seeds, one recording");
    assert!(a.1.messages().count() > 5_000);
}

#[test]
fn the_command_that_repeats_a_run_repeats_it() {
    let folder = Folder::new();
    let first = json(&folder, &["--for", "0.4", "--seed", "11"]);
    let repeat = first["repeat"].as_str().unwrap();
    let mut words = repeat.split(' ');
    assert_eq!(words.next(), Some("taktil"));
    let mut arguments: Vec<&str> = words.collect();
    arguments.push("--json");
    let again = taktil(folder.path(), &arguments).expect_code(0);
    let again: Value = serde_json::from_str(&again.out).unwrap();
    assert_eq!(first["digest"], again["digest"], "{repeat}");
}

#[test]
fn the_table_contains_the_main_figures() {
    let folder = Folder::new();
    let scene = scenes().join("roll-pin.toml");
    let said = taktil(folder.path(), &["run", scene.to_str().unwrap(), "--fast"]).expect_code(0);
    for word in [
        "strokes (reversals)",
        "x_c, column",
        "p_x, mm",
        "finger / contact travel",
        "M0, counts",
        "theta_xx, deg",
        "theta_zz, deg",
        "joint tracking error",
        "x real time",
        "misses alloc fault",
        "faults                     none",
        "seed                       1",
        "digest",
        "repeat                     taktil run",
    ] {
        assert!(said.out.contains(word), "`{word}` is not in the table:\n{}", said.out);
    }
}

#[test]
fn a_report_is_one_page_beside_its_log() {
    let folder = Folder::new();
    let summary = json(&folder, &["--for", "1", "--report", "out"]);
    let page = std::fs::read_to_string(folder.join("out/report.html")).unwrap();
    assert!(page.contains("<svg") && page.contains(summary["digest"].as_str().unwrap()));
    for foreign in ["src=\"http", "href=\"http", "@import", "<script src"] {
        assert!(!page.contains(foreign), "the page asks for something else: {foreign}");
    }
    assert!(Log::open(&folder.join("out/run.mcap")).unwrap().damage().is_none());
}

#[test]
fn a_live_log_and_its_report_say_what_the_kernel_granted() {
    let folder = Folder::new();
    let scene = scenes().join("roll-pin.toml");
    let live = ["run", scene.to_str().unwrap(), "--for", "0.1", "--json", "--report", "out"];
    let said = taktil(folder.path(), &live).expect_code(0);
    let summary: Value = serde_json::from_str(&said.out).unwrap();
    let log = Log::open(&folder.join("out/run.mcap")).unwrap();
    let granted: Value =
        serde_json::from_str(&log.metadata()["taktil.attestation"]["json"]).unwrap();
    assert_eq!(granted, summary["attested"]);
    assert_eq!(granted["lanes"].as_array().unwrap().len(), 3);
    assert!(granted["facts"]["VmLck KiB"].is_string());
    let page = std::fs::read_to_string(folder.join("out/report.html")).unwrap();
    for short in granted["shortfalls"].as_array().unwrap() {
        assert!(page.contains(&format!("<td>{}</td>", short["item"].as_str().unwrap())), "{short}");
    }
    // The metadata come before the first message: a log that is cut after them still holds them.
    let bytes = std::fs::read(folder.join("out/run.mcap")).unwrap();
    let name = b"taktil.attestation";
    let at = bytes.windows(name.len()).position(|window| window == name).unwrap();
    let cut = Log::from_bytes(bytes[..at + 100_000.min(bytes.len() - at)].to_vec()).unwrap();
    let before = Log::from_bytes(bytes[..at].to_vec()).unwrap();
    assert!(cut.metadata().contains_key("taktil.attestation"));
    assert_eq!(before.messages().count(), 0, "no message in front of it");
}

#[test]
fn a_contract_that_does_not_hold_refuses_a_live_run_with_the_item() {
    let folder = Folder::new();
    let text = std::fs::read_to_string(scenes().join("roll-pin.toml")).unwrap();
    let machine = scenes().join("machine/puma260.toml");
    let text = text.replace("machine/puma260.toml", machine.to_str().unwrap());
    let with = |contract: &str| {
        text.replacen("seed = 1\n", &format!("seed = 1\ncontract = {contract}\n"), 1)
    };
    folder.write("firm.toml", with("\"firm\""));
    let said = taktil(folder.path(), &["run", "firm.toml"]).expect_code(2);
    assert!(said.err.contains("unknown variant `firm`"), "{}", said.err);
    folder.write("strict.toml", with("{ preempt_rt = \"hard\" }"));
    let said = taktil(folder.path(), &["run", "strict.toml", "--fast", "--for", "0.01"]);
    said.expect_code(0);
    if std::fs::read_to_string("/proc/version").unwrap().contains("PREEMPT_RT") {
        taktil_tests_script::report_skip("this kernel has what the scene demands");
        return;
    }
    let said = taktil(folder.path(), &["run", "strict.toml", "--for", "0.1"]).expect_code(1);
    assert!(said.err.contains("preempt_rt: the kernel is built without PREEMPT_RT; wanted"));
}

#[test]
fn a_run_of_many_that_ends_with_a_fault_names_it() {
    let folder = Folder::new();
    let text = std::fs::read_to_string(scenes().join("roll-pin.toml")).unwrap();
    let machine = scenes().join("machine/puma260.toml");
    let text = text.replace("machine/puma260.toml", machine.to_str().unwrap());
    let stopped = "\n[[world.fault]]\nkind = \"emergency_stop\"\nat_s = 0.3\n";
    folder.write("whole.toml", &text);
    folder.write("stopped.toml", text + stopped);
    let hash = |scene: &str, code: i32| {
        let words = ["sim", "hash", scene, "--for", "0.4", "--seeds", "3", "--beside", "2"];
        taktil(folder.path(), &words).expect_code(code)
    };
    let whole = hash("whole.toml", 0);
    let ends = |said: &str| -> Vec<String> {
        said.lines().map(|line| line.split_once("  ").unwrap().1.to_owned()).collect()
    };
    assert_eq!(ends(&whole.out), ["seed 1", "seed 2", "seed 3"]);
    assert!(whole.err.ends_with("; 0 with faults\n"), "{}", whole.err);
    let stopped = hash("stopped.toml", 1);
    let named = [1, 2, 3].map(|seed| format!("seed {seed}  EmergencyStop"));
    assert_eq!(ends(&stopped.out), named);
    assert!(stopped.err.ends_with("; 3 with faults\n"), "{}", stopped.err);
}
