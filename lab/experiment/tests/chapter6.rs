//! Chapter 6 as it was measured: every line's verdict, and the sign of what a slope does to M0.

use std::path::{Path, PathBuf};

use clap::Parser;
use taktil_lab_experiment::Experiments;
use taktil_lab_experiment::LawName;
use taktil_lab_experiment::load_folder;
use taktil_lab_experiment::statistics::median;
use taktil_lab_experiment::thesis::rows::{ROWS, STEADY_S};
use taktil_lab_experiment::thesis::series::{Column, Series};
use taktil_lab_experiment::thesis::{
    MeasuredScene, figures, frames, lines, measured_scenes, page, run_scenes, sampled_run,
};
use taktil_lab_experiment::with_law;
use taktil_lab_scene::scene::Scene;

fn scenes_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes")
}

fn scenes_of_1994() -> Vec<MeasuredScene> {
    measured_scenes(&load_folder(&scenes_folder()).unwrap())
}

/// M0 while the finger rolls towards +x0 less M0 on the way back.
fn climbing_counts(run: &Series) -> f64 {
    let (forward, back) = run.by_direction(Column::M0, STEADY_S.0, STEADY_S.1).unwrap();
    forward - back
}

/// Lines without a reason are as the thesis, lines with one are not: neither a number that drifts
/// off nor a reason that no longer holds stays in the table.
#[test]
fn every_line_has_the_verdict_that_the_table_gives_it() {
    let scenes = scenes_of_1994();
    assert_eq!(scenes.len(), 9);
    let all = run_scenes(&scenes, 3, None).unwrap().unwrap();
    for runs in &all {
        let lost: u32 = runs.runs.iter().map(|run| run.contact_lost).sum();
        assert_eq!(lost, 0, "{}: contact lost", runs.id);
    }
    let lines = lines(&all);
    let text = page(&lines, 3, "taktil experiment chapter6");
    println!("{text}");
    assert_eq!(lines.len(), ROWS.len());
    for line in &lines {
        let row = line.row;
        assert_eq!(line.is_as_the_thesis(), row.why.is_empty(), "{} {}", row.experiment, row.what);
        assert!(text.contains(&line.verdict()));
    }
    let drawn = figures::figures(&all);
    assert_eq!(drawn.len(), 12, "a figure lacks a run");
    for (name, figure) in &drawn {
        let text = figure.svg_document();
        assert!(!text.contains("NaN") && text.len() > 10_000, "{name}");
        if ["fig-6-21", "fig-6-22", "fig-6-23", "fig-6-24", "fig-6-25"].contains(&name.as_str()) {
            for curve in ["(1) level", "(2) ", "(3) "] {
                assert!(text.contains(curve), "{name} lacks {curve}");
            }
        }
    }
}

/// Figure 6.13(c): a finger that stays level presses harder uphill, whatever the noise. A finger
/// along the slope, as in the clean scene, has nothing to make up for.
#[test]
fn a_level_finger_presses_harder_uphill_with_every_seed() {
    let tilted: Vec<MeasuredScene> =
        scenes_of_1994().into_iter().filter(|scene| scene.id == "E2").collect();
    let all = run_scenes(&tilted, 20, None).unwrap().unwrap();
    let level: Vec<f64> = all[0].runs.iter().map(climbing_counts).collect();
    println!("level finger: {level:.0?}");
    assert_eq!(level.iter().filter(|counts| **counts > 100.0).count(), 20, "{level:?}");

    let clean = Scene::load(&scenes_folder().join("tilted-y.toml")).unwrap();
    let mut clean = with_law(&clean, LawName::Thesis);
    clean.duration = taktil_rtcore::Nanos::from_secs(20);
    let along: Vec<f64> =
        (1..=3).map(|seed| climbing_counts(&sampled_run(&clean, seed).unwrap())).collect();
    println!("finger along the slope: {along:.0?}");
    assert!(along.iter().all(|counts| counts.abs() < 60.0), "{along:?}");
    assert!(median(&level).unwrap() > 5.0 * median(&along).unwrap().abs());
}

#[test]
fn the_frames_are_drawn() {
    let text = frames::picture().svg_document();
    for name in ["x0", "y0", "z0", "z_s of E1", "x_s of E1", "E3", "E4"] {
        assert!(text.contains(&format!(">{name}<")), "{name}");
    }
    assert!(!text.contains("NaN"));
}

/// `taktil experiment` without the rest of the command line.
#[derive(Parser)]
struct ExperimentCommand {
    #[command(subcommand)]
    what: Experiments,
}

/// A folder with E1 alone, clean for 2 s and as it was measured for 12 s: the table has the lines
/// of E1, and only its figure and the frames are drawn.
#[test]
fn the_command_writes_table_and_figures_of_what_was_run() {
    let folder = std::env::temp_dir().join(format!("taktil-chapter6-{}", std::process::id()));
    let [scenes, out] = ["scenes", "out"].map(|name| folder.join(name));
    std::fs::create_dir_all(&scenes).unwrap();
    let machine = scenes_folder().join("machine/puma260.toml").canonicalize().unwrap();
    for (name, long, short) in [("roll-pin", "10.0", "2.0"), ("roll-pin-1994", "22.0", "12.0")] {
        let file = format!("{name}.toml");
        let text = std::fs::read_to_string(scenes_folder().join(&file)).unwrap();
        let text = text.replace("machine/puma260.toml", machine.to_str().unwrap());
        let due = format!("duration_s = {long}");
        assert!(text.contains(&due), "{name}");
        let text = text.replace(&due, &format!("duration_s = {short}"));
        std::fs::write(scenes.join(file), text).unwrap();
    }
    let [scenes, shown] = [&scenes, &out].map(|path| path.to_str().unwrap().to_owned());
    let words = ["experiment", "chapter6", "--seeds", "1", "--law", "thesis", "--scenes"];
    let words = words.into_iter().map(str::to_owned).chain([scenes, "--out".to_owned(), shown]);
    let command = ExperimentCommand::try_parse_from(words).unwrap();
    taktil_lab_experiment::run(&command.what).unwrap();

    let table = std::fs::read_to_string(out.join("thesis.md")).unwrap();
    let rows = table.lines().filter(|line| line.starts_with("| E1 |")).count();
    assert_eq!(rows, ROWS.iter().filter(|row| row.experiment == "E1").count(), "{table}");
    assert!(!table.contains("| E2 |") && table.contains("| as the thesis |"), "{table}");
    let mut drawn: Vec<String> = std::fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(".svg"))
        .collect();
    drawn.sort();
    assert_eq!(drawn, ["fig-6-9-to-6-12.svg", "frames.svg"]);
    std::fs::remove_dir_all(&folder).unwrap();
}
