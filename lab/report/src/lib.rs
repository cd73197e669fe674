//! The report of a run: one HTML file that needs no other file, no network and no script. Faults, a
//! damaged log and figures that are not representative are stated at the top.

mod budgets;
pub mod closing_table;
mod html_tables;
mod moves;

use std::path::{Path, PathBuf};

use anyhow::Context;
use taktil_lab_plot::chart::{Panel, stacked_panels};
use taktil_lab_plot::svg::{DARK_STYLE, Figure, LIGHT_STYLE, escape};
use taktil_lab_plot::views::{self, FeaturePanels, THESIS_E1, ThesisRanges};
use taktil_lab_plot::{arm_figure, snapshot_figure, timing};
use taktil_record::summary::{RunMode, Summary};
use taktil_record::{Log, METADATA_RUN};

/// The style sheet of reports.
pub const STYLE: &str = include_str!("report.css");
/// Height of a panel (px).
const PANEL_HEIGHT_PX: f64 = 150.0;

/// The rolling is shown from shortly before the sum of the counts first reaches this fraction of
/// its set point.
const PRESSED_SHARE: f64 = 0.9;

/// Writes `report.html` into a directory, which is created when it does not exist.
///
/// # Errors
/// A directory that cannot be created or written; the text names it.
pub fn write(directory: &Path, log: &Log, summary: &Summary) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(directory)
        .with_context(|| format!("cannot make the directory {}", directory.display()))?;
    let path = directory.join("report.html");
    std::fs::write(&path, html(log, summary))
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

/// The report as text.
#[must_use]
pub fn html(log: &Log, summary: &Summary) -> String {
    let title = title(summary);
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}{LIGHT_STYLE}\n\
         @media screen and (prefers-color-scheme:dark){{{DARK_STYLE}}}\n</style>\n</head>\n<body>\n"
    );
    header(&mut out, log, summary, &title);
    out.push_str("<h2>Closing table</h2>\n");
    out.push_str(&html_tables::closing(summary, &THESIS_E1));
    arm(&mut out, log);
    rolling(&mut out, log, &THESIS_E1);
    touch(&mut out, log);
    joints(&mut out, log);
    timing_section(&mut out, summary);
    repeat(&mut out, log, summary);
    out.push_str("</body>\n</html>\n");
    out
}

/// The heading, already escaped.
fn title(summary: &Summary) -> String {
    let named = [&summary.title, &summary.scene].into_iter().find(|text| !text.is_empty());
    escape(named.map_or("a run", String::as_str))
}

fn header(out: &mut String, log: &Log, summary: &Summary, title: &str) {
    out.push_str(&format!("<h1>{title}</h1>\n<p class=\"lead\">"));
    let mut facts = Vec::new();
    if !summary.scene.is_empty() {
        facts.push(format!("scene <code>{}</code>", escape(&summary.scene)));
    }
    facts.push(format!("seed {}", summary.seed));
    let mode = match summary.mode {
        RunMode::Live => "live",
        RunMode::Fast => "virtual time",
    };
    facts.push(mode.to_owned());
    if let Some(taktil) = log.metadata().get(METADATA_RUN).and_then(|about| about.get("taktil")) {
        facts.push(format!("taktil {}", escape(taktil)));
    }
    out.push_str(&facts.join(" \u{b7} "));
    out.push_str("</p>\n");
    out.push_str(&html_tables::verdict(summary));
    if let Some(damage) = log.damage() {
        let damage = escape(&damage.to_string());
        out.push_str(&format!("<p class=\"warn\">The log is incomplete: {damage}.</p>\n"));
    }
}

fn figure(out: &mut String, figure: &Figure, caption: &str) {
    let caption = escape(caption);
    out.push_str("<figure>\n");
    out.push_str(&figure.svg_fragment());
    out.push_str(&format!("<figcaption>{caption}</figcaption>\n</figure>\n"));
}

/// The panels of figures 6.9 to 6.12 of the thesis, two per figure.
fn rolling(out: &mut String, log: &Log, stated: &ThesisRanges) {
    let (Some(f), Some(finger)) = (views::feature_panels(log), views::finger_of_log(log)) else {
        out.push_str("<p class=\"dim\">The log holds no tactile features or no joints.</p>\n");
        return;
    };
    let FeaturePanels { x_c, m0, m_x, theta_z } = f;
    let of = |title, label, values: &[f64]| views::finger_panel(title, label, &finger.t_s, values);
    let range = |panel: Panel, [low, high]: [f64; 2]| panel.with_stated_range(low, high);
    let theta = stated.theta_z_deg;
    let figures = [
        (
            "Centroid and finger along x0",
            [range(x_c, stated.x_c), range(of("p_x (mm)", "p_x", &finger.p_mm[0]), stated.p_x_mm)],
            "As figure 6.9: the finger travels twice as far as the contact.",
        ),
        (
            "Sum of the image and finger along z0",
            [
                m0.with_stated_range(stated.m0, stated.m0),
                range(of("p_z (mm)", "p_z", &finger.p_mm[2]), stated.p_z_mm),
            ],
            "As figure 6.10: M0 stands for the normal force.",
        ),
        (
            "Moment about the middle line and tilt of the finger",
            [
                m_x.with_stated_range(0.0, 0.0),
                range(of("theta_zz (deg)", "theta_zz", &finger.theta_zz_deg), stated.theta_zz_deg),
            ],
            "As figure 6.11: theta_zz is the angle of the sensor's z axis about x0.",
        ),
        (
            "Direction of the pin and turn of the finger",
            [
                range(theta_z, [-theta, theta]),
                range(of("theta_xx (deg)", "theta_xx", &finger.theta_xx_deg), stated.theta_xx_deg),
            ],
            "As figure 6.12: theta_xx is the angle of the sensor's x axis about z0.",
        ),
    ];
    out.push_str(
        "<h2>Rolling</h2>\n<p class=\"dim\">Shaded: what the thesis reports for its first \
         experiment, the table aligned with the base frame. Levels: set points. The strip names \
         the state of the control program.</p>\n",
    );
    let strip = views::state_strip(log);
    let (begin_s, end_s) = views::rolling_span_s(log, PRESSED_SHARE * stated.m0);
    for (title, panels, caption) in figures {
        let panels = panels.map(|panel| panel.clipped_to(begin_s, end_s));
        figure(out, &stacked_panels(title, &panels, &strip, PANEL_HEIGHT_PX), caption);
    }
}

/// Arm, pin and table.
fn arm(out: &mut String, log: &Log) {
    let Some(picture) = arm_figure(log) else { return };
    out.push_str("<h2>Arm</h2>\n");
    let caption = "The simulated arm at four moments, from the side and from above; the line is \
                   the table. Close up: the finger's tactile array, the pin with a spoke that \
                   turns with it, and the table.";
    figure(out, &picture, caption);
}

fn touch(out: &mut String, log: &Log) {
    let Some(picture) = snapshot_figure(log) else { return };
    out.push_str("<h2>Touch</h2>\n");
    let caption = "Counts above the baseline at four moments of the rolling; x along the sensor's \
                   columns, y upwards. Marked: centroid and direction of the pin as read from the \
                   image. Grey tactels are not believed.";
    figure(out, &picture, caption);
}

fn joints(out: &mut String, log: &Log) {
    let sections = [
        ("angles", "From the encoders."),
        ("tracking", "Desired minus measured angle, joint by joint."),
        ("torques", "What the servo asked for, and what the D/A words stand for."),
        ("truth", "What the simulator knows and no sensor tells."),
    ];
    let strip = views::state_strip(log);
    let mut first = true;
    for (name, caption) in sections {
        let Some(mut view) = views::view(log, name) else { continue };
        if first {
            out.push_str("<h2>Joints</h2>\n");
            first = false;
        }
        if name == "angles" {
            view.panels.truncate(1);
            "joint angles".clone_into(&mut view.title);
        }
        figure(out, &stacked_panels(&view.title, &view.panels, &strip, PANEL_HEIGHT_PX), caption);
    }
}

fn timing_section(out: &mut String, summary: &Summary) {
    let table = html_tables::lanes(summary);
    if table.is_empty() {
        return;
    }
    out.push_str("<h2>Timing</h2>\n");
    out.push_str(&html_tables::timing_caution(summary));
    out.push_str(&table);
    out.push_str(&html_tables::contract(summary));
    let figures = timing::figures(summary);
    if !figures.is_empty() {
        out.push_str("<div class=\"pair\">\n");
        for picture in &figures {
            out.push_str(&picture.svg_fragment());
        }
        out.push_str("</div>\n");
        out.push_str(
            "<p class=\"dim\">Jobs by how late they started and how long they took, both axes \
             logarithmic.</p>\n",
        );
    }
}

fn repeat(out: &mut String, log: &Log, summary: &Summary) {
    out.push_str("<h2>Repeat this run</h2>\n");
    if !summary.repeat.is_empty() {
        out.push_str(&format!("<pre>{}</pre>\n", escape(&summary.repeat)));
    }
    if !summary.digest.is_empty() {
        let digest = escape(&summary.digest);
        out.push_str(&format!(
            "<p>In virtual time the same scene and seed end with the same digest: \
             <code>{digest}</code>.</p>\n"
        ));
    }
    let Some(about) = log.metadata().get(METADATA_RUN) else { return };
    for (key, value) in about {
        let (key, value) = (escape(key), escape(value));
        if value.contains('\n') || value.len() > 100 {
            out.push_str(&format!(
                "<details><summary>{key}</summary><pre>{value}</pre></details>\n"
            ));
        } else {
            out.push_str(&format!("<p class=\"dim\">{key}: <code>{value}</code></p>\n"));
        }
    }
}
