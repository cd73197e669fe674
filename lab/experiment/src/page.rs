//! The page of `taktil experiment chapter6`: HTML with figures, Markdown with the tables. Refuses
//! to leave a run out: spreads are over all seeds, ratios are paired seed by seed.

use std::path::{Path, PathBuf};

use anyhow::Context;
use taktil_tasks_tactile_servo::config::law_name::LawName;

use super::Runs;
use super::chapter6::{MEASURES, Measure, Shown};
use super::judge::{TRACED, Verdict};
use taktil_lab_plot::axis::plain;
use taktil_lab_plot::chart::{Line, Panel, Strip, stack};
use taktil_lab_plot::svg::{DARK, LIGHT, escape};
use taktil_lab_report::STYLE;

/// Height of a panel, px.
const PANEL: f64 = 110.0;

/// What the page says besides its runs.
pub(super) struct About<'a> {
    /// The laws, in the order of the verdicts.
    pub(super) laws: &'a [LawName],
    /// The command that makes the same page.
    pub(super) command: &'a str,
    /// What was asked for and is not there.
    pub(super) lacks: &'a [String],
}

/// Writes both files under this name; returns where they are.
pub(super) fn write(
    (folder, name): (&Path, &str),
    all: &[Runs],
    about: &About<'_>,
) -> anyhow::Result<(PathBuf, PathBuf)> {
    let [html, markdown] = ["html", "md"].map(|kind| folder.join(format!("{name}.{kind}")));
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    write(&html, page(all, about))?;
    write(&markdown, text(all, about))?;
    Ok((html, markdown))
}

/// Mean and standard deviation.
fn spread(values: &[f64]) -> Option<(f64, f64)> {
    if values.is_empty() {
        return None;
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>();
    Some((mean, (square / (n - 1.0).max(1.0)).sqrt()))
}

fn values(runs: &[Option<Verdict>], measure: &Measure) -> Vec<f64> {
    runs.iter().flatten().filter_map(measure.of).collect()
}

/// Mean and spread in words; how many runs had no such number.
fn cell(runs: &[Option<Verdict>], measure: &Measure) -> String {
    let found = values(runs, measure);
    let Some((mean, deviation)) = spread(&found) else { return "\u{2013}".to_owned() };
    let mut text = plain(mean);
    if found.len() > 1 {
        text += &format!(" \u{b1} {}", plain(deviation));
    }
    if found.len() < runs.len() {
        text += &format!(" ({} of {})", found.len(), runs.len());
    }
    text
}

/// Ratio to the first law on the same seed: least and most.
fn ratio(first: &[Option<Verdict>], other: &[Option<Verdict>], measure: &Measure) -> String {
    let pairs = first.iter().zip(other).filter_map(|(a, b)| {
        let (a, b) = ((measure.of)(a.as_ref()?)?, (measure.of)(b.as_ref()?)?);
        (a.abs() > 1e-9).then_some(b / a)
    });
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for ratio in pairs {
        (low, high) = (low.min(ratio), high.max(ratio));
    }
    if low > high { String::new() } else { format!("{} .. {}", plain(low), plain(high)) }
}

/// Rows of a table: what, a cell for each law, ratios of the later ones to the first.
fn rows(runs: &Runs) -> Vec<Vec<String>> {
    let shown = |measure: &&Measure| runs.verdicts.iter().any(|v| !values(v, measure).is_empty());
    MEASURES
        .iter()
        .filter(shown)
        .map(|measure| {
            let mut row = vec![measure.what.to_owned()];
            row.extend(runs.verdicts.iter().map(|verdicts| cell(verdicts, measure)));
            let later = runs.verdicts.iter().skip(1);
            row.extend(later.map(|other| ratio(&runs.verdicts[0], other, measure)));
            row
        })
        .collect()
}

fn head(laws: &[LawName]) -> Vec<String> {
    let mut head = vec!["measure".to_owned()];
    head.extend(laws.iter().map(|law| law.text().to_owned()));
    let first = laws[0].text();
    head.extend(laws.iter().skip(1).map(|law| format!("{} / {first}", law.text())));
    head
}

fn text(all: &[Runs], &About { laws, command, lacks }: &About<'_>) -> String {
    let mut out = format!("# Chapter 6, law by law\n\n`{command}`\n");
    lacks.iter().for_each(|lack| out += &format!("\n**{lack}**\n"));
    for runs in all {
        let about = runs.experiment;
        out += &format!(
            "\n## {}\n\nFigures {} of the thesis: {}. Reported: {}. Scene `{}`.\n\n",
            runs.title,
            about.figures,
            about.about,
            about.reported,
            runs.scene.display(),
        );
        let head = head(laws);
        out += &format!("| {} |\n|{}\n", head.join(" | "), "---|".repeat(head.len()));
        for row in rows(runs) {
            out += &format!("| {} |\n", row.join(" | "));
        }
    }
    out
}

fn table(runs: &Runs, laws: &[LawName]) -> String {
    let cells = |row: &[String], tag: &str| -> String {
        row.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape(cell))).collect()
    };
    let mut out = format!("<table>\n<tr>{}</tr>\n", cells(&head(laws), "th"));
    for row in rows(runs) {
        out += &format!("<tr>{}</tr>\n", cells(&row, "td"));
    }
    out + "</table>\n"
}

fn panel(runs: &Runs, laws: &[LawName], shown: &Shown) -> Option<Panel> {
    let column = TRACED.iter().position(|name| *name == shown.column)?;
    let lines = laws.iter().zip(&runs.verdicts).enumerate().filter_map(|(colour, (law, all))| {
        let trace = &all.first()?.as_ref()?.trace;
        let values = trace.columns[column].clone();
        let label = law.text().to_owned();
        Some(Line { label, t_s: trace.t_s.clone(), values, colour, dashed: false })
    });
    let panel = Panel { title: shown.title.to_owned(), lines: lines.collect(), ..Panel::default() };
    Some(match shown.stated {
        Some((low, high)) => panel.stated(low, high),
        None => panel,
    })
}

fn page(all: &[Runs], &About { laws, command, lacks }: &About<'_>) -> String {
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <title>Chapter 6, law by law</title>\n<style>\n{STYLE}{LIGHT}\n\
         @media screen and (prefers-color-scheme:dark){{{DARK}}}\n</style>\n</head>\n<body>\n\
         <h1>Chapter 6, law by law</h1>\n<p class=\"lead\"><code>{}</code></p>\n\
         <p>Lines: the run with seed 1. Shaded: what the thesis prints. Tables: mean and standard \
         deviation over the seeds; ratios are taken seed by seed, least to most. Errors are judged \
         by the simulator's truth from one second after the finger first presses.</p>\n",
        escape(command)
    );
    lacks.iter().for_each(|lack| out += &format!("<p><b>{}</b></p>\n", escape(lack)));
    for runs in all {
        let about = runs.experiment;
        out += &format!(
            "<h2>{}</h2>\n<p>Figures {} of the thesis: {}. <i>Reported:</i> {}. Scene \
             <code>{}</code>.</p>\n",
            escape(&runs.title),
            about.figures,
            escape(about.about),
            escape(about.reported),
            escape(&runs.scene.display().to_string()),
        );
        let panels: Vec<Panel> =
            about.panels.iter().filter_map(|shown| panel(runs, laws, shown)).collect();
        let title = format!("{}: {}", about.id, about.about);
        out += &format!(
            "<figure>\n{}</figure>\n",
            stack(&title, &panels, &Strip::default(), PANEL).part()
        );
        out += &table(runs, laws);
    }
    out + "</body>\n</html>\n"
}
