//! Whatever stands in a file that the program reads: it refuses it in a few words with place and
//! remedy, or takes it. It never panics, never aborts, never hangs, and nothing of a file reaches
//! the terminal as a command. The inputs are made here, the same ones every time.

mod arms;
mod case;
mod content;
mod draws;
mod logs;
#[path = "../cli/process.rs"]
#[expect(dead_code, reason = "other tests use more of it")]
mod process;
mod texts;

use std::path::Path;
use std::process::{Command, Stdio};

use case::Case;
use content::{Content, Verdict};
use draws::Draws;
use process::{Folder, TAKTIL, scenes};
use taktil_tests_script::report_skip;

/// Where flight recordings can be made.
const MEMORY: &str = "/dev/shm";

/// Runs every case; all complaints at once.
fn survive(folder: &Folder, cases: &[Case], count_min: usize) {
    assert!(cases.len() >= count_min, "{} cases are too few", cases.len());
    let complaints: Vec<String> = cases.iter().filter_map(|case| case.complaint(folder)).collect();
    let (found, all) = (complaints.len(), cases.len());
    assert!(complaints.is_empty(), "{found} of {all}:\n{}", complaints.join("\n\n"));
}

/// A folder with the scenes, machines and arms of the repository.
fn folder_of_scenes() -> Folder {
    let folder = Folder::new();
    for part in ["scenes", "arms"] {
        copy(&scenes().join("..").join(part), &folder.join(part));
    }
    folder
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        match entry.file_type().unwrap().is_dir() {
            true => copy(&entry.path(), &target),
            false => drop(std::fs::copy(entry.path(), target).unwrap()),
        }
    }
}

fn text(folder: &Folder, name: &str) -> String {
    std::fs::read_to_string(folder.join(name)).unwrap()
}

const PLAN: &str = "[[fault]]\nkind = \"loss\"\ntarget = \"mesa\"\nat = 0.5\nfor = 0.5\n\
                    value = 0.01\n[[fault]]\nkind = \"delay\"\nvalue = 0.001\n";
const RUN: [&str; 5] = ["run", "FILE", "--fast", "--for", "0.01"];
const EMULATE: [&str; 9] =
    ["hal", "emulate", "mesa", "--scene", "scenes/hold.toml", "--for", "0.001", "--fault", "FILE"];

#[test]
fn what_is_no_file_is_refused_by_every_command_that_reads_one() {
    let folder = folder_of_scenes();
    let commands: [&[&str]; 17] = [
        &RUN,
        &["run", "FILE", "--plan"],
        &["scene", "check", "FILE"],
        &["sim", "hash", "FILE", "--for", "0.01"],
        &["arm", "FILE", "--poses", "1"],
        &EMULATE,
        &["keys", "--map", "FILE", "--stdin", "--at", "nowhere"],
        &["commission", "FILE"],
        &["hal", "check", "FILE"],
        &["log", "info", "FILE"],
        &["log", "cat", "FILE"],
        &["log", "recover", "FILE", "--out", "out.mcap"],
        &["replay", "FILE"],
        &["plot", "FILE", "--out", "out"],
        &["diff", "FILE", "FILE"],
        &["postmortem", "FILE"],
        &["identify", "friction", "FILE"],
    ];
    let mut cases = Vec::new();
    for command in commands {
        for (name, content) in texts::no_files() {
            cases.push(Case::in_file(name, command, "hostile", content, Verdict::Refused));
        }
    }
    survive(&folder, &cases, 17 * 18);
}

#[test]
fn texts_of_toml_are_taken_or_refused() {
    let folder = folder_of_scenes();
    let mut cases = Vec::new();
    let plan: &[&str] = &EMULATE;
    let machine = "scenes/machine/puma260.toml";
    let keys = include_str!("../../../../lab/command/src/keys/default.toml");
    let sources: [(&str, String, &[&str]); 4] = [
        ("scenes/hostile.toml", text(&folder, "scenes/roll-pin.toml"), &RUN[..]),
        (machine, text(&folder, machine), &["run", "scenes/hold.toml", "--fast", "--for", "0.01"]),
        ("plan.toml", PLAN.to_owned(), plan),
        ("keys.toml", keys.to_owned(), &["keys", "--map", "FILE", "--stdin", "--at", "nowhere"]),
    ];
    for (file, text, command) in sources {
        for (name, bytes, verdict) in texts::toml_kinds(&text) {
            let name = format!("{file}: {name}");
            cases.push(Case::in_file(name, command, file, Content::Bytes(bytes), verdict));
        }
    }
    survive(&folder, &cases, 4 * 40);
}

#[test]
fn other_values_are_taken_or_refused() {
    let folder = folder_of_scenes();
    let mut cases = Vec::new();
    let command = ["run", "scenes/hostile.toml", "--fast", "--for", "0.01"];
    let bytes = |text: String| Content::Bytes(text.into_bytes());
    for (seed, scene) in [(1, "roll-pin"), (2, "two-fingers"), (3, "lines"), (4, "follow-edge")] {
        let text = text(&folder, &format!("scenes/{scene}.toml"));
        for (name, text) in texts::hostile_values(&text, 1, seed) {
            let name = format!("{scene}: {name}");
            let file = "scenes/hostile.toml";
            cases.push(Case::in_file(name, &command, file, bytes(text), Verdict::Any));
        }
    }
    for (seed, machine) in [(5, "puma260"), (6, "ur5e-like")] {
        let text = text(&folder, &format!("scenes/machine/{machine}.toml"));
        for (name, text) in texts::hostile_values(&text, 1, seed) {
            let scene = "title = \"t\"\nmachine = \"machine/hostile.toml\"\n".to_owned();
            let mut case = Case::in_file(
                format!("{machine}: {name}"),
                &command,
                "scenes/machine/hostile.toml",
                bytes(text),
                Verdict::Any,
            );
            case.files.push(("scenes/hostile.toml".to_owned(), bytes(scene)));
            cases.push(case);
        }
    }
    for (name, text) in texts::hostile_values(PLAN, 6, 7) {
        cases.push(Case::in_file(name, &EMULATE, "plan.toml", bytes(text), Verdict::Any));
    }
    survive(&folder, &cases, 150);
}

/// The paths to all values that the schema of scenes has.
fn paths_of(schema: &serde_json::Value, here: &mut Vec<String>, found: &mut Vec<Vec<String>>) {
    let mut into = |key: &str, inner: &serde_json::Value, found: &mut Vec<Vec<String>>| {
        here.push(key.to_owned());
        paths_of(inner, here, found);
        here.pop();
    };
    let (properties, items) = (schema.get("properties"), schema.get("items"));
    for (key, inner) in properties.and_then(serde_json::Value::as_object).into_iter().flatten() {
        into(key, inner, found);
    }
    items.into_iter().for_each(|inner| into("[]", inner, found));
    let more = schema.get("additionalProperties").filter(|more| more.is_object());
    more.into_iter().for_each(|inner| into("x", inner, found));
    for alternative in schema.get("anyOf").and_then(|any| any.as_array()).into_iter().flatten() {
        paths_of(alternative, here, found);
    }
    if properties.is_none() && !here.is_empty() {
        found.push(here.clone());
    }
}

#[test]
fn every_key_of_a_scene_survives_values_that_are_none() {
    let folder = folder_of_scenes();
    let output = Command::new(TAKTIL).args(["scene", "--schema"]).output().unwrap();
    let schema: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut paths = Vec::new();
    paths_of(&schema, &mut Vec::new(), &mut paths);
    let mut draws = Draws::new(11);
    let mut cases = Vec::new();
    for path in paths {
        let value = texts::drawn_value(&mut draws);
        let Some(entry) = texts::added_key(&path, value) else { continue };
        let head = "title = \"t\"\nmachine = \"machine/puma260.toml\"\n";
        let bytes = Content::Bytes(format!("{head}{entry}").into_bytes());
        let name = format!("{} = {value}", path.join("."));
        cases.push(Case::in_file(name, &RUN, "scenes/hostile.toml", bytes, Verdict::Any));
    }
    survive(&folder, &cases, 300);
}

#[test]
fn lists_with_a_number_too_many_are_refused() {
    let folder = folder_of_scenes();
    let mut cases = Vec::new();
    for entry in [
        "[start]\nfinger_mm = [310.0, -127.0, -134.0, 0.0, 0.0]",
        "[[operator]]\njog = [0, 0, 0, 0, 0, 0, 0]\nfor_s = 1.0",
        "[[robot.trajectory.moves]]\nby_mm = [0.0, 0.0, 1.0, 9.0]",
        "[world.arm]\nhome_deg = [0, 40, -153, -180, 67, 180, 0]",
        "[world.pin]\nradius_mm = [23.0]",
        "[[world.table.motion]]\naxis = \"slide\"\npoints_mm = [[0, 0, 0], [1, 1, 1]]",
        "start = [[310.0, -127.0, -134.0]]",
    ] {
        let head = "title = \"t\"\nmachine = \"machine/puma260.toml\"\n";
        let bytes = Content::Bytes(format!("{head}{entry}\n").into_bytes());
        cases.push(Case::in_file(entry, &RUN, "scenes/hostile.toml", bytes, Verdict::Refused));
    }
    survive(&folder, &cases, 7);
}

#[test]
fn recorded_motions_are_taken_or_refused() {
    let folder = folder_of_scenes();
    let scene = "title = \"t\"\nmachine = \"machine/puma260.toml\"\n[[world.table.motion]]\n\
                 axis = \"slide\"\nfile = \"hostile.csv\"\n";
    let many: String = (0..200_000).map(|n| format!("{n},0\n")).collect();
    let mut tables: Vec<(String, Content)> =
        texts::no_files().into_iter().map(|(name, content)| (name.to_owned(), content)).collect();
    for (name, rows) in [
        ("nan", "0,0\n1,nan\n".to_owned()),
        ("infinite", "0,0\ninf,1\n".to_owned()),
        ("three columns", "0,0,0\n1,1,1\n".to_owned()),
        ("backwards", "1,0\n0,0\n".to_owned()),
        ("twice the same instant", "0,0\n0,1\n".to_owned()),
        ("an instant below 0", "-1,0\n1,1\n".to_owned()),
        ("many rows", many),
        ("a unit", "0,0\n1,1 mm\n".to_owned()),
        ("a long cell", format!("0,0\n1,{}\n", "1".repeat(1 << 20))),
        ("quotes", "0,\"0\"\n1,\"1\"\n".to_owned()),
        ("escape sequences", "0,0\n\u{1b}[2J,1\n".to_owned()),
    ] {
        tables.push((name.to_owned(), Content::Bytes(format!("t_s,x_mm\n{rows}").into_bytes())));
    }
    let mut cases = Vec::new();
    for (name, content) in tables {
        let mut case =
            Case::in_file(name, &RUN, "scenes/hostile.toml", Content::Nothing, Verdict::Refused);
        case.files = vec![
            ("scenes/hostile.toml".to_owned(), Content::Bytes(scene.into())),
            ("scenes/hostile.csv".to_owned(), content),
        ];
        cases.push(case);
    }
    survive(&folder, &cases, 25);
}

#[test]
fn robot_descriptions_are_taken_or_refused() {
    let folder = folder_of_scenes();
    let command = ["arm", "FILE", "--poses", "1"];
    let mut cases = Vec::new();
    for (name, text, verdict) in arms::kinds() {
        let content = Content::Bytes(text.into_bytes());
        cases.push(Case::in_file(name, &command, "hostile.urdf", content, verdict));
    }
    let good = text(&folder, "arms/ur5e-like.urdf").into_bytes();
    for (name, bytes) in logs::altered(&good, 21) {
        let content = Content::Bytes(bytes);
        cases.push(Case::in_file(name, &command, "hostile.urdf", content, Verdict::Any));
    }
    survive(&folder, &cases, 90);
}

/// Everything that reads a log.
const READERS: [&[&str]; 12] = [
    &["log", "info", "FILE"],
    &["log", "info", "FILE", "--json"],
    &["log", "cat", "FILE"],
    &["log", "recover", "FILE", "--out", "out.mcap"],
    &["log", "pack", "FILE", "--out", "out.mcap"],
    &["log", "filter", "FILE", "--from", "0.01", "--out", "out.mcap"],
    &["replay", "FILE"],
    &["plot", "FILE", "--out", "out"],
    &["plot", "FILE", "--csv", "--out", "out"],
    &["diff", "FILE", "FILE"],
    &["identify", "friction", "FILE"],
    &["calibrate", "tactile", "FILE"],
];

/// Has the program run a scene for a moment.
fn run_scene(folder: &Folder, arguments: &[&str]) -> bool {
    let mut command = Command::new(TAKTIL);
    command.args(["run", "scenes/hold.toml", "--fast", "--for", "0.05"]).args(arguments);
    let output = command.current_dir(folder.path()).stdin(Stdio::null()).output().unwrap();
    output.status.success()
}

#[test]
fn logs_are_read_as_far_as_they_go() {
    let folder = folder_of_scenes();
    assert!(run_scene(&folder, &["--log", "good.mcap"]));
    let good = std::fs::read(folder.join("good.mcap")).unwrap();
    let mut cases = Vec::new();
    for (at, (name, bytes)) in logs::altered(&good, 31).into_iter().enumerate() {
        for offset in [0, 5] {
            let reader = READERS[(at + offset) % READERS.len()];
            let content = Content::Bytes(bytes.clone());
            cases.push(Case::in_file(&*name, reader, "hostile.mcap", content, Verdict::Any));
        }
    }
    for (name, bytes) in logs::misleading(folder.path()) {
        for reader in READERS {
            let content = Content::Bytes(bytes.clone());
            cases.push(Case::in_file(&*name, reader, "hostile.mcap", content, Verdict::Any));
        }
    }
    survive(&folder, &cases, 200);
}

#[test]
fn flight_recordings_are_read_as_far_as_they_go() {
    let folder = folder_of_scenes();
    let place = Path::new(MEMORY).join(format!("taktil-hostile-{}", std::process::id()));
    let shown = place.display().to_string();
    if !run_scene(&folder, &["--flight", &shown]) {
        report_skip(format_args!("no flight recording can be made in {MEMORY}"));
        return;
    }
    let good = std::fs::read(&place).unwrap();
    std::fs::remove_file(&place).unwrap();
    let mut cases = Vec::new();
    // Such a file has twenty megabytes: half of the alterations are enough.
    let altered = logs::altered(&good, 41).into_iter().step_by(2);
    let all = altered.chain(logs::misleading_flights(&good));
    for (at, (name, bytes)) in all.enumerate() {
        let readers: [&[&str]; 3] = [
            &["postmortem", "FILE"],
            &["postmortem", "FILE", "--json"],
            &["postmortem", "FILE", "--log", "out.mcap"],
        ];
        let content = Content::Bytes(bytes);
        cases.push(Case::in_file(name, readers[at % 3], "hostile.flight", content, Verdict::Any));
    }
    survive(&folder, &cases, 70);
}

#[test]
fn options_are_taken_or_refused() {
    let folder = folder_of_scenes();
    let numbers = ["nan", "inf", "-1", "0", "1e308", "1e-320", "99999999999999999999", "", "x"];
    let mut cases = Vec::new();
    for number in numbers {
        let commands: [&[&str]; 7] = [
            &["run", "scenes/hold.toml", "--fast", "--for", number],
            &["run", "scenes/hold.toml", "--fast", "--for", "0.01", "--seed", number],
            &["sim", "hash", "scenes/hold.toml", "--for", "0.01", "--seeds", number],
            &["arm", "arms/ur5e-like.urdf", "--poses", number],
            &["hal", "emulate", "mesa", "--scene", "scenes/hold.toml", "--for", number],
            &["hal", "emulate", "mesa", "--for", "0.001", "--fault", number],
            &["hal", "emulate", "mesa", "--for", "0.001", "--address", number],
        ];
        for command in commands {
            let name = format!("an option of `{number}`");
            cases.push(Case::in_file(name, command, "FILE", Content::Nothing, Verdict::Any));
        }
    }
    survive(&folder, &cases, 60);
}

#[test]
fn places_that_cannot_be_written_are_refused() {
    let folder = folder_of_scenes();
    let mut cases = Vec::new();
    let commands: [&[&str]; 5] = [
        &["run", "scenes/hold.toml", "--fast", "--for", "0.01", "--log", "FILE"],
        &["run", "scenes/hold.toml", "--fast", "--for", "0.01", "--report", "FILE"],
        &["run", "scenes/hold.toml", "--fast", "--for", "0.01", "--flight", "FILE"],
        &["run", "scenes/hold.toml", "--fast", "--for", "0.01", "--operator", "FILE/x"],
        &["jitter", "--for", "0.1", "--svg", "FILE"],
    ];
    for command in commands {
        for (name, content) in [
            ("a pipe", Content::Pipe),
            ("a link to itself", Content::Link("hostile")),
            ("a link into a folder that is not there", Content::Link("nowhere/x")),
            ("a link to a full disk", Content::Link("/dev/full")),
            ("a link to the kernel", Content::Link("/proc/version")),
        ] {
            cases.push(Case::in_file(name, command, "hostile", content, Verdict::Any));
        }
    }
    survive(&folder, &cases, 25);
}
