//! Invalid scenes: each ends with exit code 2, the file, line and column, the error and its remedy,
//! and leaves no files. The tests check the exact position.

use std::path::Path;

use crate::process::{Folder, scenes, taktil};

/// A valid scene; `@` stands for the machine file.
const VALID_SCENE: &str = r#"title = "a scene to spoil"
machine = "@"
duration_s = 0.05
seed = 1
actuation_delay_us = 1250

[start]
finger_mm = [325.0, -127.0, -134.0]

[world.pin]
radius_mm = 23.0

[[operator]]
verb = "enable"

[[operator]]
verb = "calibrate"

[[robot.trajectory.moves]]
by_mm = [0.0, 0.0, 13.5]
"#;

/// One change of the scene: the first text is replaced by the second (an empty first text: the
/// second is appended). The error points at the third text, searched from there on, and contains
/// the fourth.
struct Case(&'static str, &'static str, &'static str, &'static str);

const fn swap(
    from: &'static str,
    to: &'static str,
    mark: &'static str,
    says: &'static str,
) -> Case {
    Case(from, to, mark, says)
}

const fn add(text: &'static str, mark: &'static str, says: &'static str) -> Case {
    Case("", text, mark, says)
}

/// Keys, types and numbers of the scene.
const VALUES: &[Case] = &[
    swap("title", "titel", "titel", "unknown field `titel`"),
    swap("radius_mm", "radius_m", "radius_m", "unknown field `radius_m`"),
    add("[world.table]\ntilt_z_deg = 4\n", "tilt_z_deg", "unknown field `tilt_z_deg`"),
    add("[robot.joint_servo]\nkp = 1\n", "kp", "unknown field `kp`"),
    add("[robot.nothing]\n", "nothing", "unknown field `nothing`"),
    swap("23.0", "\"wide\"", "\"wide\"", "invalid type: string \"wide\""),
    swap("-127.0, -134.0]", "-127.0]", "[325.0", "invalid length 2"),
    swap("seed = 1", "seed = true", "true", "invalid type: boolean"),
    swap("seed = 1", "seed = -1", "-1\n", "integer `-1`"),
    swap(
        "seed = 1",
        "seed = 99999999999999999999999",
        "99999999999999999999999",
        "99999999999999999999999",
    ),
    swap("23.0", "nan", "nan", "world.pin.radius_mm: is NaN"),
    swap("23.0", "inf", "inf", "world.pin.radius_mm: is inf"),
    swap("23.0", "-inf", "-inf", "world.pin.radius_mm: is -inf"),
    swap("23.0", "-3.0", "-3.0", "world.pin.radius_mm: is -3"),
    swap("23.0", "0.0", "0.0\n", "world.pin.radius_mm: is 0"),
    swap("23.0", "1e308", "1e308", "world.pin.radius_mm: is 1"),
    swap("0.05", "0.0", "0.0", "duration_s: 0 s is not a duration"),
    swap("0.05", "-1.0", "-1.0", "duration_s: -1 s is not a duration"),
    swap("0.05", "nan", "nan", "duration_s: NaN s is not a duration"),
    swap("0.05", "inf", "inf", "duration_s: inf s is not a duration"),
    swap("0.05", "1e300", "1e300", "is not a duration"),
    swap("325.0", "9999.0", "[9999.0", "start.finger_mm: the arm cannot put its finger"),
    swap("325.0", "nan", "start]", "start: a number is not finite"),
    swap("13.5", "nan", "nan", "robot.trajectory.moves[0].by_mm[2]: is NaN"),
    swap("13.5", "13500.0", "13500.0", "robot.trajectory.moves[0].by_mm[2]: is 13500"),
    swap("\"calibrate\"", "\"fly\"", "\"fly\"", "operator[1].verb: there is no verb `fly`"),
    swap("\"calibrate\"", "\"none\"", "\"none\"", "there is no verb `none`"),
    swap("\"calibrate\"", "\"idle\"\nat_s = nan", "nan", "operator[1].at_s: NaN s"),
    swap("\"calibrate\"", "\"idle\"\nat_s = -1", "-1\n", "operator[1].at_s: -1 s"),
    swap("us = 1250", "us = 0", "0\n", "actuation_delay_us: a delay of 0 ms"),
    swap("us = 1250", "us = 2501", "2501", "actuation_delay_us: a delay of 2501 us"),
    swap("us = 1250", "us = -5", "-5", "actuation_delay_us: a delay of"),
    swap("seed = 1", "world_priority = 0", "0\n", "world_priority: 0 is not a SCHED_FIFO"),
    swap("seed = 1", "world_priority = 100", "100", "world_priority: 100 is not a SCHED_FIFO"),
    add("[world.tactile]\nbits = 99\n", "99", "world.tactile.bits: is 99"),
    add("[world.table]\nfriction = -0.1\n", "-0.1", "world.table.friction: is -0.1"),
    add(
        "[[world.table.motion]]\naxis = \"tilt_y\"\nrate_deg_s = 1\nfrom_s = 2\nto_s = 1.5\n",
        "1.5",
        "world.table.motion[0].to_s: is 1.5, not after from_s",
    ),
    add(
        "[robot.joint_servo]\nbandwidth_rad_s = [1, 2, 3, 4, 5, nan]\n",
        "nan",
        "robot.joint_servo.bandwidth_rad_s[5]: NaN",
    ),
    add("[world.tab\n", "\n", "unclosed table"),
];

/// Lanes and wiring: rates, producers, readers.
const LANES: &[Case] = &[
    add("@touch period_us = -5000\n", "-5000", "touch.period_us: a period of -5 ms"),
    add("@touch period_us = 0\n", "0\npri", "touch.period_us: a period of 0 ms"),
    add("@touch period_us = 9223372036854775807\n", "9223", "9223372036854775807 us is out of"),
    add("@touch period_us = 5000\ndelivery_us = 7500\n", "7500", "a delivery of 7500 us"),
    add("@touch period_us = 5000\ndelivery_us = 0\n", "0\npri", "a delivery of 0 ms"),
    add("@touch period_us = 5000\nphase_us = 5001\n", "5001", "touch.phase_us: a phase of 5001 us"),
    add("@touch period_us = 5000\nphase_us = -1\n", "-1\npri", "touch.phase_us: a phase of -1 us"),
    add(
        "[robot.lane.touch]\nperiod_us = 5000\npriority = 100\ntasks = [\"tactile_scan\"]\n",
        "100",
        "robot.lane.touch.priority: 100 is not a SCHED_FIFO priority",
    ),
    add(
        "[robot.lane.touch]\nperiod_us = 5000\npriority = 0\ntasks = [\"tactile_scan\"]\n",
        "0\ntas",
        "robot.lane.touch.priority: 0 is not a SCHED_FIFO priority",
    ),
    add(
        "[robot.lane.touch]\nperiod_us = 5000\npriority = 75\ntasks = [\"tactile_scam\"]\n",
        "\"tactile_scam",
        "robot.lane.touch.tasks.tactile_scam: there is no task `tactile_scam`",
    ),
    add(
        "[robot.lane.touch]\nperiod_us = 5000\npriority = 75\n\
         tasks = [\"tactile_scan\", \"tactile_scan\"]\n",
        "\"tactile_scan\", \"",
        "two producers of `tactile_scan.image`",
    ),
    add(
        "[robot.wiring]\n\"setpoint.joints\" = \"sense.jointz\"\n",
        "\"sense.jointz",
        "nobody produces `sense.jointz`: missing producer of `setpoint.joints`",
    ),
    add(
        "[robot.wiring]\n\"setpoint.jointz\" = \"sense.joints\"\n",
        "\"sense.joints",
        "there is no input `setpoint.jointz`",
    ),
    add(
        "[robot.wiring]\n\"setpoint.joints\" = \"sense.lines\"\n",
        "\"sense.lines",
        "takes JointState, but `sense.lines` carries Lines",
    ),
    add("[robot.wiring]\n\"setpoint.joints\" = 3\n", "3\n", "invalid type: integer `3`"),
    add(
        "[robot.own.sway]\njoint = 6\n",
        "sway",
        "robot.own.sway: this program has no task `sway` of its own",
    ),
    add("[robot.own]\nsway = 6\n", "6\n", "invalid type: integer `6`"),
    add(
        "[robot.lane.idle]\nperiod_us = 5000\npriority = 60\ntasks = []\n",
        "[]\n",
        "a lane without a task",
    ),
];

/// Errors that are in the machine file although the scene causes them: their text, and the line at
/// which they point.
const MACHINE_FILE_ERRORS: &[(&str, &str, &str)] = &[
    (
        "[robot.lane.second]\nperiod_us = 2500\npriority = 60\ntasks = [\"setpoint\"]\n",
        "two producers of `setpoint.desired`",
        "\"setpoint\",",
    ),
    (
        "[robot.lane.touch]\nperiod_us = 5000\npriority = 75\ntasks = [\"wrist_scan\"]\n",
        "nobody produces `tactile_scan.image`: missing producer of `tactile_servo.image`",
        "\"tactile_servo.image\" = \"tactile_scan.image\"",
    ),
];

fn spoil(good: &str, Case(from, to, ..): &Case) -> String {
    let to = to.replace("@touch ", "[robot.lane.touch]\n");
    let lane = "priority = 75\ntasks = [\"tactile_scan\"]\n";
    let to =
        if to.contains("[robot.lane.touch]") && !to.contains("priority") { to + lane } else { to };
    if from.is_empty() {
        return format!("{good}\n{to}");
    }
    assert_eq!(good.matches(from).count(), 1, "`{from}` is not unique");
    good.replacen(from, &to, 1)
}

/// Line and column of `mark`: the first after the change, or else the last before it.
fn place(text: &str, changed: usize, mark: &str) -> (usize, usize) {
    let after = text[changed..].find(mark).map(|at| changed + at);
    let at = after.or_else(|| text.rfind(mark));
    let before = &text[..at.unwrap_or_else(|| panic!("`{mark}` is not in the scene"))];
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    (before.matches('\n').count() + 1, column)
}

fn good() -> String {
    let machine = scenes().join("machine/puma260.toml");
    VALID_SCENE.replace('@', &machine.display().to_string())
}

/// Runs a scene that has to be rejected, and returns the error.
fn refused(folder: &Folder, scene: &Path, what: &str) -> String {
    let before = folder.listing();
    let scene = scene.to_str().unwrap();
    let said = taktil(folder.path(), &["run", scene, "--fast", "--log", "run.mcap"]);
    assert_eq!(said.code, Some(2), "{what}\n{}{}", said.out, said.err);
    assert_eq!(said.out, "", "{what}: something on standard output");
    assert_eq!(folder.listing(), before, "{what}: something was written");
    assert!(said.err.starts_with("error: "), "{what}\n{}", said.err);
    let remedy = said.err.trim_end().lines().last().unwrap().trim_start();
    assert!(remedy.starts_with("= ") && remedy.len() > 8, "{what}: no remedy\n{}", said.err);
    said.err
}

fn check(cases: &[Case]) {
    let folder = Folder::new();
    for case in cases {
        let Case(from, to, mark, says) = case;
        let what = format!("`{from}` to `{to}`");
        let good = good();
        let text = spoil(&good, case);
        let changed = good.find(from).filter(|_| !from.is_empty()).unwrap_or(good.len() + 1);
        let scene = folder.write("scene.toml", &text);
        let err = refused(&folder, &scene, &what);
        assert!(err.contains(says), "{what}: not `{says}` in\n{err}");
        let (line, column) = place(&text, changed, mark);
        let place = format!("--> {}:{line}:{column}\n", scene.display());
        assert!(err.contains(&place), "{what}: not {place} in\n{err}");
        let shown = text.lines().nth(line - 1).unwrap();
        assert!(err.contains(&format!("{line} | {shown}\n")), "{what}: line not shown\n{err}");
    }
}

#[test]
fn the_scene_that_is_spoiled_is_good() {
    let folder = Folder::new();
    let scene = folder.write("scene.toml", good());
    taktil(folder.path(), &["run", scene.to_str().unwrap(), "--fast"]).expect_code(0);
}

#[test]
fn keys_types_and_numbers_are_refused_at_their_place() {
    check(VALUES);
}

#[test]
fn lanes_and_wiring_are_refused_at_their_place() {
    check(LANES);
}

#[test]
fn conflicts_with_the_machine_file_are_located_there() {
    let folder = Folder::new();
    let machine = scenes().join("machine/puma260.toml");
    let text = std::fs::read_to_string(&machine).unwrap();
    for (added, says, shown) in MACHINE_FILE_ERRORS {
        let scene = folder.write("scene.toml", format!("{}\n{added}", good()));
        let err = refused(&folder, &scene, says);
        assert!(err.contains(says), "{err}");
        let line = text.lines().position(|line| line.trim() == *shown).unwrap() + 1;
        assert!(err.contains(&format!("--> {}:{line}:", machine.display())), "{err}");
    }
}

#[test]
fn the_machine_file_is_read_as_strictly() {
    let folder = Folder::new();
    let machine = std::fs::read_to_string(scenes().join("machine/puma260.toml")).unwrap();
    let scene = folder.write("scene.toml", VALID_SCENE.replace('@', "machine.toml"));
    for (from, to, says) in [
        ("\"setpoint.joints\" = \"sense.joints\"\n", "", "setpoint.joints"),
        ("  \"sense\",\n", "", "no task `sense`"),
        ("  \"actuate\",\n", "", "no lane runs `actuate`"),
        ("period_us = 2500", "period_us = nan", "invalid type: floating point `NaN`"),
        ("period_us = 2500", "periods_us = 2500", "unknown field `periods_us`"),
        ("[lane.servo]", "[lane.servo", "unclosed table"),
    ] {
        assert_eq!(machine.matches(from).count(), 1, "`{from}` is not unique");
        let path = folder.write("machine.toml", machine.replacen(from, to, 1));
        let err = refused(&folder, &scene, &format!("`{}` to `{to}`", from.trim()));
        assert!(err.contains(says), "not `{says}` in\n{err}");
        let named = format!("--> {}:", path.display());
        let in_scene = format!("--> {}:", scene.display());
        assert!(err.contains(&named) || err.contains(&in_scene), "no file and line in\n{err}");
    }
}

#[test]
fn a_machine_file_that_is_none_is_refused_in_the_scene() {
    let folder = Folder::new();
    folder.write("empty.toml", "");
    for (name, says) in [
        ("nowhere.toml", "machine: there is no file"),
        (".", "is a directory"),
        ("empty.toml", "is empty"),
    ] {
        let text = VALID_SCENE.replace('@', name);
        let scene = folder.write("scene.toml", &text);
        let err = refused(&folder, &scene, name);
        assert!(err.contains(says), "{err}");
        assert!(err.contains(&format!("--> {}:2:11\n", scene.display())), "{err}");
    }
    let scene = folder.write("scene.toml", VALID_SCENE.replace("machine = \"@\"\n", ""));
    let err = refused(&folder, &scene, "no machine");
    assert!(err.contains("no lane runs `actuate`"), "{err}");
}

#[test]
fn files_that_are_no_scene_are_refused_by_name() {
    let folder = Folder::new();
    let garbage: Vec<u8> =
        (0..4096_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let big = "# nothing\n".repeat(500_000);
    for (name, bytes, says) in [
        ("empty.toml", &b""[..], "is empty"),
        ("blank.toml", b"  \n\n\t\n", "is empty"),
        ("garbage.toml", &garbage, "is not text"),
        ("latin.toml", b"title = \"\xff\xfe\"\n", "is not text"),
        ("zeros.toml", &[0; 64], ":1:"),
        ("elf.toml", b"\x7fELF\x02\x01\x01\0\0", ":1:"),
        ("prose.toml", b"roll the pin, please\n", ":1:"),
        ("big.toml", big.as_bytes(), "too big"),
        ("only-a-comment.toml", b"# a scene\n", "missing field `title`"),
    ] {
        let path = folder.write(name, bytes);
        let err = refused(&folder, &path, name);
        assert!(err.contains(says), "{name}: not `{says}` in\n{err}");
        assert!(err.contains(&format!("--> {}", path.display())), "{err}");
    }
    let err = refused(&folder, &folder.join("nowhere.toml"), "a missing file");
    assert!(err.contains("there is no file"), "{err}");
    let err = refused(&folder, folder.path(), "a directory");
    assert!(err.contains("is a directory"), "{err}");
}
