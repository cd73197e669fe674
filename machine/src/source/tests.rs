//! Complaints show their line and their place, whatever stands in the file.

use super::*;

fn source(text: &str) -> Source {
    Source { path: PathBuf::from("a.toml"), text: text.to_owned() }
}

#[derive(serde::Deserialize, Debug)]
#[serde(deny_unknown_fields)]
struct Pin {
    #[expect(dead_code)]
    radius_mm: f64,
}

#[test]
fn a_complaint_shows_its_line_and_marks_the_place() {
    let s = source("[pin]\nradius_mm = -3.0\n[wiring]\n\"a.b\" = \"c.d\"\n");
    let shown =
        s.locate(Invalid::new("pin.radius_mm", "is negative", "give more than 0")).to_string();
    assert_eq!(
        shown,
        "error: pin.radius_mm: is negative\n  --> a.toml:2:13\n  |\n2 | radius_mm = -3.0\n  \
         |             ^^^^\n  = give more than 0"
    );
    let mark = s.locate(Invalid::new("wiring.a.b", "x", "y")).mark.unwrap();
    assert_eq!((mark.line, mark.column, mark.width), (4, 9, 5));
}

#[test]
fn arrays_are_found_by_index_and_by_content_and_what_is_absent_by_its_table() {
    let s = source("[lane.servo]\ntasks = [\"sense\", \"actuate\"]\nq_deg = [1.0,\n 2.0]\n");
    let at = |place: &str| {
        let mark = s.locate(Invalid::new(place, "", "")).mark.unwrap();
        (mark.line, mark.column)
    };
    assert_eq!(at("lane.servo.tasks.actuate"), (2, 19));
    assert_eq!(at("lane.servo.q_deg[1]"), (4, 2));
    assert_eq!(at("lane.servo.missing"), (1, 7));
    assert!(s.contains("lane.servo.q_deg") && !s.contains("lane.servo.missing"));
    assert_eq!(at("nowhere"), (1, 1));
}

#[test]
fn the_reader_s_own_complaints_get_a_remedy() {
    let deep = source("[[a]]\nb = [1, { c = 2 }]\n");
    assert_eq!(deep.key_at(deep.text.find('2').unwrap()).as_deref(), Some("a[0].b[1].c"));
    let unknown = source("radius_m = 1.0\n").parse::<Pin>().unwrap_err();
    assert!(unknown.remedy.contains("did you mean `radius_mm`?"), "{unknown}");
    assert_eq!(unknown.mark.as_ref().map(|m| m.line), Some(1));
    let wrong = source("radius_mm = \"wide\"\n").parse::<Pin>().unwrap_err();
    assert!(wrong.what.starts_with("radius_mm: invalid type"), "{wrong}");
    let broken = source("radius_mm = \n").parse::<Pin>().unwrap_err();
    assert_eq!(broken.mark.map(|m| m.line), Some(1));
    let missing = source("# nothing\n").parse::<Pin>().unwrap_err();
    assert_eq!(missing.remedy, "add `radius_mm = ...`");
}

#[test]
fn files_that_are_none_are_refused_in_words() {
    let gone = Source::read(Path::new("no/such/file.toml"), FileKind::Scene).unwrap_err();
    assert!(gone.what.contains("there is no file"), "{gone}");
    let folder = Source::read(Path::new("src"), FileKind::Arm).unwrap_err();
    assert!(folder.what.contains("is a directory"), "{folder}");
    assert!(folder.remedy.contains("sim/arms/puma260.urdf"), "{folder}");
    let device = Source::read(Path::new("/dev/zero"), FileKind::Keys).unwrap_err();
    assert!(device.what.contains("is not a regular file"), "{device}");
}

#[test]
fn whatever_stands_in_a_file_a_complaint_is_short_and_obeyed_by_no_terminal() {
    let long = "\u{1b}\u{1f600}".repeat(100_000);
    for text in [
        format!("title = \"{}\" x", "a".repeat(1_000_000)),
        format!("{} = 1", "a".repeat(1_000_000)),
        format!("\"{}\" = 1", "\u{1f600}".repeat(100_000)),
        format!("radius_mm = \"{}\"", "\u{20ac}".repeat(100_000)),
        format!("#{}\nradius_mm = {}", "\n".repeat(100_000), "[".repeat(1_000_000)),
        long.clone(),
    ] {
        let mut bad = source(&text).parse::<Pin>().unwrap_err();
        bad.path = PathBuf::from(&long);
        let shown = bad.to_string();
        assert!(shown.len() <= 2048, "{} bytes: {shown}", shown.len());
        assert!(!shown.contains('\u{1b}') && shown.lines().count() == 6, "{shown}");
    }
}

#[test]
fn a_mark_far_to_the_right_stays_under_its_place() {
    let text = format!("{}x = 1", " ".repeat(5_000));
    let shown = source(&text).parse::<Pin>().unwrap_err().to_string();
    let lines: Vec<&str> = shown.lines().collect();
    assert_eq!(lines[3].find('x'), lines[4].find('^'), "{shown}");
}

#[test]
fn marks_survive_characters_of_several_bytes() {
    let s = source("# Gr\u{f6}\u{df}e\n\u{fc} = 1\n");
    let error = s.parse::<Pin>().unwrap_err();
    assert_eq!(error.mark.map(|m| m.line), Some(2));
}

#[test]
fn a_mark_that_anybody_made_shows_nothing_that_a_terminal_would_obey() {
    let text = "\u{1b}]0;x\u{7}\tt_s\u{202e},\0".to_owned();
    let mark = Some(Mark { line: 1, column: 7, text, width: 3 });
    let (path, what) = (PathBuf::from("hand.csv"), "is not two columns".to_owned());
    let shown = Located { path, mark, what, remedy: "write two".to_owned() }.to_string();
    assert_eq!(
        shown,
        "error: is not two columns\n  --> hand.csv:1:7\n  |\n\
         1 | \u{b7}]0;x\u{b7}\u{b7}t_s\u{b7},\u{b7}\n  |       ^^^\n  = write two"
    );
}
