//! Pictures, tables and the report of a generated run: they are complete, well-formed and the same
//! bytes twice, and a log that lacks the data yields a plain message.

mod made_up;
mod xml;

use std::path::{Path, PathBuf};

use taktil_lab_plot::{PlotArgs, run, view_names};
use taktil_record::Log;
use taktil_record::summary::{RunMode, Summary};

fn directory(name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pictures").join(name);
    let _ = std::fs::remove_dir_all(&directory);
    std::fs::create_dir_all(&directory).unwrap();
    directory
}

fn plot(args: &PlotArgs) -> anyhow::Result<String> {
    let mut out = Vec::new();
    run(args, &mut out)?;
    Ok(String::from_utf8(out).unwrap())
}

fn refusal(args: &PlotArgs) -> String {
    format!("{:#}", plot(args).unwrap_err())
}

#[test]
fn every_view_becomes_a_well_formed_picture_twice_the_same() {
    let place = directory("views");
    let log = made_up::log(&place, 10.0);
    let mut texts = Vec::new();
    for turn in ["a", "b"] {
        let out = place.join(turn);
        let args = PlotArgs { log: log.clone(), out: Some(out.clone()), ..PlotArgs::default() };
        let said = plot(&args).unwrap();
        assert_eq!(said.lines().count(), view_names().len());
        let mut all = Vec::new();
        for name in view_names() {
            let file = out.join(format!("{name}.svg"));
            assert!(said.contains(&file.display().to_string()), "{said}");
            let text = std::fs::read_to_string(&file).unwrap();
            xml::check(text.strip_prefix("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n").unwrap());
            assert!(text.contains("class=\"paper\""), "{name} has no ground");
            assert!(!text.contains("NaN") && !text.contains("inf"), "{name}");
            all.push(text);
        }
        texts.push(all);
    }
    assert_eq!(texts[0], texts[1]);
    let features = &texts[0][0];
    for text in ["x_c (tactels)", "M0 (counts)", "theta_z (deg)", "time (s)", "TACTILE-SERVO"] {
        assert!(features.contains(text), "{text}");
    }
}

#[test]
fn tables_hold_the_numbers_of_the_log() {
    let place = directory("tables");
    let log = made_up::log(&place, 1.0);
    let of = |what: &str| PlotArgs {
        log: log.clone(),
        what: vec![what.to_owned()],
        csv: true,
        out: Some("-".into()),
    };
    let series = Log::open(&log).unwrap().series("sense.joints").unwrap();
    let text = plot(&of("sense.joints.q_rad")).unwrap();
    let mut lines = text.lines();
    let heading = "t_s,q_rad[0],q_rad[1],q_rad[2],q_rad[3],q_rad[4],q_rad[5]";
    assert_eq!(lines.next(), Some(heading));
    for (row, line) in lines.enumerate() {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        assert_eq!(cells[0].to_bits(), series.t_s[row].to_bits());
        assert_eq!(cells[1..], *series.column("q_rad").unwrap().row(row), "bit for bit");
    }
    let text = plot(&of("positions")).unwrap();
    assert!(text.starts_with("t_s,p_x_mm,p_y_mm,p_z_mm\n"));
    let text = plot(&of("features")).unwrap();
    assert!(text.starts_with("t_s,set point,x_c,m0,m_x,theta_z_deg\n"), "{}", &text[..60]);
    let text = plot(&of("image")).unwrap();
    assert!(text.starts_with("t_s,r1c1,r1c2,"));
    assert_eq!(text.lines().nth(1).unwrap().split(',').count(), 257);
    let text = plot(&of("timing")).unwrap();
    assert!(text.starts_with("lane,what,up_to_us,jobs\nservo,release_late,"));
}

#[test]
fn missing_data_of_a_log_are_reported() {
    let place = directory("refusals");
    let log = made_up::log(&place, 0.2);
    let of = |what: &str| PlotArgs {
        log: log.clone(),
        what: vec![what.to_owned()],
        out: Some(place.join("out")),
        ..PlotArgs::default()
    };
    let said = refusal(&of("feelings"));
    assert!(said.contains("features") && said.contains("sense.joints"), "{said}");
    assert!(refusal(&of("sense.joints.nothing")).contains("neither a view"));
    assert!(refusal(&of("tactile_scan.image.counts")).contains("--csv"));
    let two = PlotArgs { out: Some("-".into()), ..of("features") };
    let two = PlotArgs { what: vec!["features".into(), "angles".into()], ..two };
    assert!(refusal(&two).contains("takes one view"));
    let missing = PlotArgs { log: place.join("no.mcap"), ..PlotArgs::default() };
    assert!(refusal(&missing).contains("cannot read the log"));
    let bare = made_up::bare_log(&place);
    let args = PlotArgs { log: bare.clone(), what: vec!["timing".into()], ..PlotArgs::default() };
    assert!(refusal(&args).contains("no timing figures"));
    let args = PlotArgs { log: bare.clone(), what: vec!["torques".into()], ..PlotArgs::default() };
    assert!(refusal(&args).contains("lacks the signals"));
    assert!(refusal(&PlotArgs { log: bare, ..PlotArgs::default() }).contains("nothing"));
}

#[test]
fn the_report_is_one_well_formed_page_with_everything_in_it() {
    let place = directory("report");
    let path = made_up::log(&place, 10.0);
    let log = Log::open(&path).unwrap();
    let summary = made_up::summary();
    let file = taktil_lab_report::write(&place.join("made/on/the/way"), &log, &summary).unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    xml::check_html(&text);
    for needed in [
        "Closing table",
        "As figure 6.9",
        "As figure 6.10",
        "As figure 6.11",
        "As figure 6.12",
        "Touch",
        "Joints",
        "Timing",
        "Repeat this run",
        "taktil run",
        "308 .. 342",
        "not representative",
        "seed 7",
        "prefers-color-scheme:dark",
        "@media print",
        "&lt;script&gt;",
    ] {
        assert!(text.contains(needed), "{needed}");
    }
    for foreign in ["http://", "https://", "<script", "<link", "<img"] {
        let text = text.replace("http://www.w3.org/2000/svg", "");
        assert!(!text.contains(foreign), "the page is not self-contained: {foreign}");
    }
    assert!(!text.contains("NaN"));
    assert!(text.len() < 3_000_000, "{} bytes", text.len());
    assert_eq!(text, taktil_lab_report::html(&log, &summary));
}

#[test]
fn virtual_time_shows_no_lateness() {
    let place = directory("virtual");
    let log = Log::open(&made_up::log(&place, 0.1)).unwrap();
    let mut summary = made_up::summary();
    assert!(taktil_lab_report::html(&log, &summary).contains("servo: release lateness"));
    summary.mode = RunMode::Fast;
    let text = taktil_lab_report::html(&log, &summary);
    xml::check_html(&text);
    assert!(text.contains("Virtual time") && text.contains("servo: execution"));
    assert!(!text.contains("release lateness") && !text.contains("240.5"));
}

#[test]
fn a_report_is_written_from_incomplete_data() {
    let place = directory("bare");
    let log = Log::open(&made_up::bare_log(&place)).unwrap();
    let text = taktil_lab_report::html(&log, &Summary::default());
    xml::check_html(&text);
    assert!(text.contains("no tactile features"));
}

#[test]
fn a_summary_read_back_from_a_log_is_the_one_that_was_written() {
    let place = directory("summary");
    let log = Log::open(&made_up::log(&place, 0.1)).unwrap();
    assert_eq!(Summary::from_log(&log).unwrap(), Some(made_up::summary()));
    let bare = Log::open(&made_up::bare_log(&place)).unwrap();
    assert_eq!(Summary::from_log(&bare).unwrap(), None);
}
