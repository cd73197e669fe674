//! Writes the page of `taktil experiment chapter6`: HTML with figures, Markdown with the tables.
//! All runs are included: medians are over all seeds, and differences are paired seed by seed.

use std::path::{Path, PathBuf};

use anyhow::Context;
use taktil_tasks_tactile_servo::config::law_name::LawName;

use super::ExperimentRuns;
use super::chapter6::{MEASURES, Measure, PanelSpec};
use super::comparison::{self, LEGEND, SeedValues};
use super::evaluation::{Evaluation, TRACE_COLUMNS};
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

/// Rows of a table: the measure, a cell for each law, and the differences of the later laws to the
/// first.
fn table_rows(runs: &ExperimentRuns) -> Vec<Vec<String>> {
    let of_law = |verdicts: &Vec<Option<Evaluation>>| {
        let of = |measure: &Measure| {
            let value = |verdict: &Option<Evaluation>| (measure.of)(verdict.as_ref()?);
            verdicts.iter().map(value).collect()
        };
        MEASURES.iter().map(of).collect()
    };
    let values: Vec<Vec<SeedValues>> = runs.verdicts.iter().map(of_law).collect();
    comparison::rows(&values)
}

fn table_head(laws: &[LawName]) -> Vec<String> {
    let names: Vec<&str> = laws.iter().map(|law| law.text()).collect();
    comparison::heading(&names)
}

fn markdown_page(
    all: &[ExperimentRuns],
    &PageContext { laws, command, lacks }: &PageContext<'_>,
) -> String {
    let mut out = format!("# Chapter 6, law by law\n\n`{command}`\n\n{LEGEND}\n");
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
        out += &comparison::markdown(&head, &table_rows(runs));
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
         <p>Lines: the run with seed 1. Shaded: what the thesis prints. {LEGEND} Errors are judged \
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
