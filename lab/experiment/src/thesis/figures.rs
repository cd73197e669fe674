//! The figures of chapter 6 from the runs with seed 1. Where the thesis draws three curves into one
//! plot (6.21 to 6.25), so does this: the level table, the moving one and the one that stands
//! turned.

use taktil_lab_plot::chart::{Line, Panel, StateStrip, stacked_panels};
use taktil_lab_plot::svg::Figure;

use super::MeasuredRuns;
use super::rows::STEADY_S;
use super::series::{Column, Series};

/// Height of a panel (px).
const PANEL_HEIGHT_PX: f64 = 120.0;
/// Length of a figure (s).
const FIGURE_S: f64 = 10.0;
/// Time before the table begins to move at which a figure of a moving table begins (s).
const LEAD_S: f64 = 0.2;

/// A panel: its heading, its column, the experiments with their curves' names, and what the thesis
/// prints.
struct PanelSpec {
    title: &'static str,
    column: Column,
    curves: &'static [(&'static str, &'static str)],
    stated: &'static [(f64, f64)],
}

/// A figure: the name of its file, its heading, its panels.
struct FigureSpec {
    name: &'static str,
    title: &'static str,
    panels: &'static [PanelSpec],
}

const fn panel(
    title: &'static str,
    column: Column,
    curves: &'static [(&'static str, &'static str)],
    stated: &'static [(f64, f64)],
) -> PanelSpec {
    PanelSpec { title, column, curves, stated }
}

const E1: &[(&str, &str)] = &[("E1", "E1")];
const E2: &[(&str, &str)] = &[("E2", "E2")];
const E3: &[(&str, &str)] = &[("E3", "E3")];
const E4: &[(&str, &str)] = &[("E4", "E4")];
const E5: &[(&str, &str)] = &[("E5", "E5")];
const E6: &[(&str, &str)] = &[("E6", "E6")];
const E7: &[(&str, &str)] = &[("E7", "E7")];
const E8: &[(&str, &str)] = &[("E8", "E8")];
const E9: &[(&str, &str)] = &[("E9", "E9")];
const ABOUT_Y: &[(&str, &str)] =
    &[("E1", "(1) level"), ("E6", "(2) turning"), ("E2", "(3) tilted")];
const ABOUT_X: &[(&str, &str)] =
    &[("E1", "(1) level"), ("E7", "(2) turning"), ("E3", "(3) tilted")];
const ABOUT_Z: &[(&str, &str)] =
    &[("E1", "(1) level"), ("E8", "(2) panning"), ("E4", "(3) panned")];
const SET_POINT: &[(f64, f64)] = &[(15_000.0, 15_000.0)];

/// All figures, in the order of the thesis.
const FIGURES: &[FigureSpec] = &[
    FigureSpec {
        name: "fig-6-9-to-6-12",
        title: "Figures 6.9 to 6.12: a table aligned with the base frame (E1)",
        panels: &[
            panel("x_c (column)", Column::Xc, E1, &[(3.0, 14.0)]),
            panel("p_x (mm)", Column::Px, E1, &[(308.0, 342.0)]),
            panel("M0 (counts)", Column::M0, E1, SET_POINT),
            panel("p_z (mm)", Column::Pz, E1, &[(-149.6, -148.2)]),
            panel("M_x (counts x rows)", Column::Mx, E1, &[]),
            panel("theta_zz (deg)", Column::ThetaZz, E1, &[(170.85, 171.25)]),
            panel("theta_z as read (deg)", Column::ThetaZ, E1, &[(-5.0, 5.0)]),
            panel("theta_xx (deg)", Column::ThetaXx, E1, &[(178.1, 178.3)]),
        ],
    },
    FigureSpec {
        name: "fig-6-13",
        title: "Figure 6.13: a table tilted about y0 (E2)",
        panels: &[
            panel("x_c (column)", Column::Xc, E2, &[(3.0, 14.0)]),
            panel("p_x (mm)", Column::Px, E2, &[(285.0, 318.0)]),
            panel("M0 (counts)", Column::M0, E2, SET_POINT),
            panel("p_z (mm)", Column::Pz, E2, &[(-156.5, -152.0)]),
        ],
    },
    FigureSpec {
        name: "fig-6-15",
        title: "Figure 6.15: a table tilted about x0 (E3)",
        panels: &[
            panel("M_x (counts x rows)", Column::Mx, E3, &[]),
            panel("theta_zz (deg)", Column::ThetaZz, E3, &[(185.0, 185.5)]),
        ],
    },
    FigureSpec {
        name: "fig-6-16",
        title: "Figure 6.16: a panned table (E4)",
        panels: &[
            panel("theta_z as read (deg)", Column::ThetaZ, E4, &[]),
            panel("theta_xx (deg)", Column::ThetaXx, E4, &[(198.5, 200.0)]),
        ],
    },
    FigureSpec {
        name: "fig-6-17-to-6-20",
        title: "Figures 6.17 to 6.20: a table rotated about all three axes (E5)",
        panels: &[
            panel("x_c (column)", Column::Xc, E5, &[(3.0, 14.0)]),
            panel("p_x (mm)", Column::Px, E5, &[(286.0, 318.0)]),
            panel("M0 (counts)", Column::M0, E5, SET_POINT),
            panel("p_z (mm)", Column::Pz, E5, &[(-116.5, -111.5)]),
            panel("theta_zz (deg)", Column::ThetaZz, E5, &[(171.6, 172.0)]),
            panel("theta_z as read (deg)", Column::ThetaZ, E5, &[]),
            panel("theta_xx (deg)", Column::ThetaXx, E5, &[(197.3, 197.8)]),
        ],
    },
    FigureSpec {
        name: "fig-6-21",
        title: "Figure 6.21: p_x on a table (1) level, (2) turning about y0, (3) tilted about y0",
        panels: &[panel("p_x (mm)", Column::Px, ABOUT_Y, &[])],
    },
    FigureSpec {
        name: "fig-6-22",
        title: "Figure 6.22: p_z and M0 on a table level, turning about y0, tilted about y0",
        panels: &[
            panel("(a) p_z (mm)", Column::Pz, ABOUT_Y, &[(-149.5, -134.5)]),
            panel("(b) M0 (counts), level", Column::M0, E1, SET_POINT),
            panel("(c) M0 (counts), turning", Column::M0, E6, SET_POINT),
            panel("(d) M0 (counts), tilted", Column::M0, E2, SET_POINT),
        ],
    },
    FigureSpec {
        name: "fig-6-23",
        title: "Figure 6.23: theta_zz and M_x on a table level, turning about x0, tilted about x0",
        panels: &[
            panel("(a) theta_zz (deg)", Column::ThetaZz, ABOUT_X, &[(170.0, 185.0)]),
            panel("(b) M_x (counts x rows), level", Column::Mx, E1, &[]),
            panel("(c) M_x (counts x rows), turning", Column::Mx, E7, &[]),
            panel("(d) M_x (counts x rows), tilted", Column::Mx, E3, &[]),
        ],
    },
    FigureSpec {
        name: "fig-6-24",
        title: "Figure 6.24: p_x on a table (1) level, (2) panning, (3) panned",
        panels: &[panel("p_x (mm)", Column::Px, ABOUT_Z, &[])],
    },
    FigureSpec {
        name: "fig-6-25",
        title: "Figure 6.25: theta_xx and theta_z on a table level, panning, panned",
        panels: &[
            panel("(a) theta_xx (deg)", Column::ThetaXx, ABOUT_Z, &[(177.0, 197.0)]),
            panel("(b) theta_z as read (deg), level", Column::ThetaZ, E1, &[]),
            panel("(c) theta_z as read (deg), panning", Column::ThetaZ, E8, &[]),
            panel("(d) theta_z as read (deg), panned", Column::ThetaZ, E4, &[]),
        ],
    },
    FigureSpec {
        name: "fig-6-26",
        title: "Figure 6.26: theta_zz while the table pans (E8)",
        panels: &[panel("theta_zz (deg)", Column::ThetaZz, E8, &[])],
    },
    FigureSpec {
        name: "fig-6-27",
        title: "Figure 6.27: a table slid by hand (E9)",
        panels: &[
            panel("p_x (mm)", Column::Px, E9, &[(320.0, 400.0)]),
            panel("x_c (column)", Column::Xc, E9, &[]),
        ],
    },
];

/// When the figure of a run begins (s): a table that moves at its motion's start, E9 at the first
/// press, another run when the finger has adjusted.
fn begin_s(run: &Series, id: &str) -> f64 {
    match (run.table_moves_s, id) {
        (Some((start_s, _)), _) => start_s - LEAD_S,
        (None, "E9") => run.pressed_s.unwrap_or(0.0),
        (None, _) => STEADY_S.0,
    }
}

fn drawn_panel(all: &[MeasuredRuns], spec: &PanelSpec) -> Panel {
    let curve = |(colour, (id, label)): (usize, &(&str, &str))| {
        let run = all.iter().find(|runs| runs.id == *id)?.runs.first()?;
        let begin = begin_s(run, id);
        let length = if *id == "E9" { FIGURE_S + 3.0 } else { FIGURE_S };
        let first = run.t_s.partition_point(|t| *t < begin);
        let last = run.t_s.partition_point(|t| *t < begin + length).max(first);
        let t_s = run.t_s[first..last].iter().map(|t| t - begin).collect();
        let values = run.column(spec.column)[first..last].to_vec();
        Some(Line { label: (*label).to_owned(), t_s, values, colour, dashed: false })
    };
    let lines = spec.curves.iter().enumerate().filter_map(curve).collect();
    let panel = Panel { title: spec.title.to_owned(), lines, ..Panel::default() };
    spec.stated.iter().fold(panel, |panel, (low, high)| panel.with_stated_range(*low, *high))
}

/// The names and the pictures of all figures for which there is a run of each curve.
#[must_use]
pub fn figures(all: &[MeasuredRuns]) -> Vec<(String, Figure)> {
    let drawn = |spec: &FigureSpec| {
        let panels: Vec<Panel> = spec.panels.iter().map(|one| drawn_panel(all, one)).collect();
        let whole = panels
            .iter()
            .zip(spec.panels)
            .all(|(panel, spec)| panel.lines.len() == spec.curves.len());
        let height = if panels.len() == 1 { 2.0 * PANEL_HEIGHT_PX } else { PANEL_HEIGHT_PX };
        let figure = || stacked_panels(spec.title, &panels, &StateStrip::default(), height);
        whole.then(|| (spec.name.to_owned(), figure()))
    };
    FIGURES.iter().filter_map(drawn).collect()
}
