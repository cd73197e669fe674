//! Writes the page of `taktil experiment chapter6`: HTML with figures, Markdown with the tables.
//! All runs are included: deviations are over all seeds, and ratios are paired seed by seed.

use std::path::{Path, PathBuf};

use anyhow::Context;
use taktil_tasks_tactile_servo::config::law_name::LawName;

use super::ExperimentRuns;
use super::chapter6::{MEASURES, Measure, PanelSpec};
use super::evaluation::{Evaluation, TRACE_COLUMNS};
use taktil_lab_plot::axis::format_number;
use taktil_lab_plot::chart::{Line, Panel, StateStrip, stacked_panels};
use taktil_lab_plot::svg::{DARK_STYLE, LIGHT_STYLE, escape};
use taktil_lab_report::STYLE;

/// Height of a panel, px.
const PANEL_HEIGHT_PX: f64 = 110.0;

/// The texts of the page besides its runs.
pub(super) struct PageContext<'a> {
    /// The laws, in the order of the results.
    pub(super) laws: &'a [LawName],
    /// The command that repeats the experiment.
    pub(super) command: &'a str,
    /// The requested items that are missing.
    pub(super) lacks: &'a [String],
}

/// Writes both files under this name and returns their paths.
pub(super) fn write(
    (folder, name): (&Path, &str),
    all: &[ExperimentRuns],
    about: &PageContext<'_>,
) -> anyhow::Result<(PathBuf, PathBuf)> {
    let [html, markdown] = ["html", "md"].map(|kind| folder.join(format!("{name}.{kind}")));
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    write(&html, html_page(all, about))?;
    write(&markdown, markdown_page(all, about))?;
    Ok((html, markdown))
}

/// Mean and standard deviation.
fn mean_and_deviation(values: &[f64]) -> Option<(f64, f64)> {
    if values.is_empty() {
        return None;
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>();
    Some((mean, (square / (n - 1.0).max(1.0)).sqrt()))
}

fn measured_values(runs: &[Option<Evaluation>], measure: &Measure) -> Vec<f64> {
    runs.iter().flatten().filter_map(measure.of).collect()
}

/// Mean and standard deviation as text, with the number of runs without a value.
fn mean_cell(runs: &[Option<Evaluation>], measure: &Measure) -> String {
    let found = measured_values(runs, measure);
    let Some((mean, deviation)) = mean_and_deviation(&found) else { return "\u{2013}".to_owned() };
    let mut text = format_number(mean);
    if found.len() > 1 {
        text += &format!(" \u{b1} {}", format_number(deviation));
    }
    if found.len() < runs.len() {
        text += &format!(" ({} of {})", found.len(), runs.len());
    }
    text
}

/// Smallest and largest ratio to the first law on the same seed.
fn ratio_cell(
    first: &[Option<Evaluation>],
    other: &[Option<Evaluation>],
    measure: &Measure,
) -> String {
    let pairs = first.iter().zip(other).filter_map(|(a, b)| {
        let (a, b) = ((measure.of)(a.as_ref()?)?, (measure.of)(b.as_ref()?)?);
        (a.abs() > 1e-9).then_some(b / a)
    });
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for ratio in pairs {
        (low, high) = (low.min(ratio), high.max(ratio));
    }
    if low > high {
        String::new()
    } else {
        format!("{} .. {}", format_number(low), format_number(high))
    }
}

/// Rows of a table: the measure, a cell for each law, and the ratios of the later laws to the
/// first.
fn table_rows(runs: &ExperimentRuns) -> Vec<Vec<String>> {
    let shown =
        |measure: &&Measure| runs.verdicts.iter().any(|v| !measured_values(v, measure).is_empty());
    MEASURES
        .iter()
        .filter(shown)
        .map(|measure| {
            let mut row = vec![measure.what.to_owned()];
            row.extend(runs.verdicts.iter().map(|verdicts| mean_cell(verdicts, measure)));
            let later = runs.verdicts.iter().skip(1);
            row.extend(later.map(|other| ratio_cell(&runs.verdicts[0], other, measure)));
            row
        })
        .collect()
}

fn table_head(laws: &[LawName]) -> Vec<String> {
    let mut head = vec!["measure".to_owned()];
    head.extend(laws.iter().map(|law| law.text().to_owned()));
    let first = laws[0].text();
    head.extend(laws.iter().skip(1).map(|law| format!("{} / {first}", law.text())));
    head
}

fn markdown_page(
    all: &[ExperimentRuns],
    &PageContext { laws, command, lacks }: &PageContext<'_>,
) -> String {
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
        let head = table_head(laws);
        out += &format!("| {} |\n|{}\n", head.join(" | "), "---|".repeat(head.len()));
        for row in table_rows(runs) {
            out += &format!("| {} |\n", row.join(" | "));
        }
    }
    out
}

fn html_table(runs: &ExperimentRuns, laws: &[LawName]) -> String {
    let cells = |row: &[String], tag: &str| -> String {
        row.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape(cell))).collect()
    };
    let mut out = format!("<table>\n<tr>{}</tr>\n", cells(&table_head(laws), "th"));
    for row in table_rows(runs) {
        out += &format!("<tr>{}</tr>\n", cells(&row, "td"));
    }
    out + "</table>\n"
}

fn trace_panel(runs: &ExperimentRuns, laws: &[LawName], shown: &PanelSpec) -> Option<Panel> {
    let column = TRACE_COLUMNS.iter().position(|name| *name == shown.column)?;
    let lines = laws.iter().zip(&runs.verdicts).enumerate().filter_map(|(colour, (law, all))| {
        let trace = &all.first()?.as_ref()?.trace;
        let values = trace.columns[column].clone();
        let label = law.text().to_owned();
        Some(Line { label, t_s: trace.t_s.clone(), values, colour, dashed: false })
    });
    let panel = Panel { title: shown.title.to_owned(), lines: lines.collect(), ..Panel::default() };
    Some(match shown.stated {
        Some((low, high)) => panel.with_stated_range(low, high),
        None => panel,
    })
}

fn html_page(
    all: &[ExperimentRuns],
    &PageContext { laws, command, lacks }: &PageContext<'_>,
) -> String {
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <title>Chapter 6, law by law</title>\n<style>\n{STYLE}{LIGHT_STYLE}\n\
         @media screen and (prefers-color-scheme:dark){{{DARK_STYLE}}}\n</style>\n</head>\n<body>\n\
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
            about.panels.iter().filter_map(|shown| trace_panel(runs, laws, shown)).collect();
        let title = format!("{}: {}", about.id, about.about);
        out += &format!(
            "<figure>\n{}</figure>\n",
            stacked_panels(&title, &panels, &StateStrip::default(), PANEL_HEIGHT_PX).svg_fragment()
        );
        out += &html_table(runs, laws);
    }
    out + "</body>\n</html>\n"
}
