//! Defines the views of a log: which signals share a page, under which names and in which units. A
//! view whose signals are not in the log is absent.

use taktil_signal::State;

use super::chart::{Band, Line, Panel, StateStrip, format_range};
use super::finger::{FingerTrajectory, finger_trajectory};
use super::heat::{ImagePanel, PrincipalAxis};
use taktil_record::Log;
use taktil_record::series::Series;

/// Panels over time that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Name, as given to `--what`.
    pub name: String,
    /// Heading.
    pub title: String,
    /// Panels.
    pub panels: Vec<Panel>,
}

/// Views over time by name, with what they show.
pub const VIEWS: [(&str, &str); 6] = [
    ("features", "features of the tactile image"),
    ("positions", "finger in the base frame"),
    ("angles", "joint angles and the angles of the finger"),
    ("tracking", "desired minus measured joint angles"),
    ("torques", "torques asked for and applied"),
    ("truth", "what the simulator knows"),
];

/// The ranges that the thesis reports of an experiment, which are drawn behind the lines of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThesisRanges {
    /// Finger along x0 (mm).
    pub p_x_mm: [f64; 2],
    /// Finger along z0 (mm).
    pub p_z_mm: [f64; 2],
    /// Centroid (column numbers).
    pub x_c: [f64; 2],
    /// Set point of M0 (counts).
    pub m0: f64,
    /// Angle of the sensor's z axis about x0 (deg).
    pub theta_zz_deg: [f64; 2],
    /// Angle of the sensor's x axis about z0 (deg).
    pub theta_xx_deg: [f64; 2],
    /// Noise of theta_z (deg), both ways.
    pub theta_z_deg: f64,
}

/// Experiment E1, figures 6.9 to 6.12: table aligned with the base frame.
pub const THESIS_E1: ThesisRanges = ThesisRanges {
    p_x_mm: [308.0, 342.0],
    p_z_mm: [-149.6, -148.2],
    x_c: [3.0, 14.0],
    m0: 15_000.0,
    theta_zz_deg: [170.85, 171.25],
    theta_xx_deg: [178.1, 178.3],
    theta_z_deg: 5.0,
};

fn line(label: &str, t_s: &[f64], values: Vec<f64>, colour: usize) -> Line {
    Line { label: label.to_owned(), t_s: t_s.to_vec(), values, colour, dashed: false }
}

fn panel(title: &str, lines: Vec<Line>) -> Panel {
    Panel { title: title.to_owned(), lines, ..Panel::default() }
}

impl Panel {
    /// The same panel with a range that the thesis states; a range without width is a set point.
    #[must_use]
    pub fn with_stated_range(mut self, low: f64, high: f64) -> Panel {
        let what = if low == high { "set point" } else { "thesis" };
        self.note = format!("{what}: {}", format_range(low, high));
        self.bands.push(Band { low, high });
        self
    }

    /// The same panel with only the points of a time span (s).
    #[must_use]
    pub fn clipped_to(mut self, begin_s: f64, end_s: f64) -> Panel {
        for line in &mut self.lines {
            let first = line.t_s.partition_point(|t| *t < begin_s);
            let last = line.t_s.partition_point(|t| *t <= end_s).max(first);
            line.t_s = line.t_s.get(first..last).unwrap_or_default().to_vec();
            line.values = line.values.get(first..last).unwrap_or_default().to_vec();
        }
        self
    }
}

/// A scalar feature while its bit in `defined` is set, and NaN where it is not.
fn masked_values(features: &Series, name: &str, bit: u32) -> Vec<f64> {
    let flags = features.values("defined", 0);
    let values = features.values(name, 0);
    let flag = |row: usize| flags.get(row).copied().unwrap_or(0.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a u32 field")]
    let defined = |row: usize| (flag(row) as u32) & bit != 0;
    let kept = |(row, value)| if defined(row) { value } else { f64::NAN };
    values.into_iter().enumerate().map(kept).collect()
}

/// The panels of the four servoed features.
#[derive(Clone, Debug, PartialEq)]
pub struct FeaturePanels {
    /// Centroid with its set point (tactels).
    pub x_c: Panel,
    /// Sum of the image, M0 (counts).
    pub m0: Panel,
    /// Moment about the middle line, M_x (counts tactels).
    pub m_x: Panel,
    /// Direction of the pin, theta_z (deg).
    pub theta_z: Panel,
}

/// The four servoed features; `None` when the log has none.
#[must_use]
pub fn feature_panels(log: &Log) -> Option<FeaturePanels> {
    use taktil_signal::defined::{CENTROID, CONTACT, THETA_Z};
    let features = log.series("tactile_servo.features").filter(|series| !series.is_empty())?;
    let t = &features.t_s;
    let active = features.values("active", 0);
    let wish = features.values("x_c_desired", 0);
    let wish = wish.into_iter().zip(&active);
    let wish = wish.map(|(value, on)| if *on != 0.0 { value } else { f64::NAN }).collect();
    let goal = Line { dashed: true, ..line("set point", t, wish, 1) };
    let theta = masked_values(&features, "theta_z_rad", THETA_Z);
    let theta = theta.into_iter().map(f64::to_degrees).collect();
    let x_c = line("x_c", t, masked_values(&features, "x_c", CENTROID), 0);
    Some(FeaturePanels {
        x_c: panel("x_c (tactels)", vec![goal, x_c]),
        m0: panel("M0 (counts)", vec![line("m0", t, features.values("m0", 0), 0)]),
        m_x: panel(
            "M_x about the middle line (counts tactels)",
            vec![line("m_x", t, masked_values(&features, "m_x", CONTACT), 0)],
        ),
        theta_z: panel("theta_z (deg)", vec![line("theta_z_deg", t, theta, 0)]),
    })
}

/// The finger of a log; `None` when the log has no joints.
#[must_use]
pub fn finger_of_log(log: &Log) -> Option<FingerTrajectory> {
    log.series("sense.joints")
        .filter(|series| !series.is_empty())
        .map(|series| finger_trajectory(&series))
}

/// A panel of one column of the finger.
#[must_use]
pub fn finger_panel(title: &str, label: &str, t_s: &[f64], values: &[f64]) -> Panel {
    panel(title, vec![line(label, t_s, values.to_vec(), 0)])
}

fn joint_lines(series: &Series, field: &str, name: &str, unit: f64) -> Vec<Line> {
    let one = |joint: usize| {
        let values = series.values(field, joint).into_iter().map(|x| x * unit).collect();
        line(&format!("{name}{}", joint + 1), &series.t_s, values, joint)
    };
    (0..6).map(one).collect()
}

fn features(log: &Log) -> Option<Vec<Panel>> {
    let f = feature_panels(log)?;
    Some(vec![f.x_c, f.m0, f.m_x, f.theta_z])
}

fn positions(log: &Log) -> Option<Vec<Panel>> {
    let finger = finger_of_log(log)?;
    let of =
        |title, label, axis: usize| finger_panel(title, label, &finger.t_s, &finger.p_mm[axis]);
    Some(vec![
        of("p_x (mm)", "p_x_mm", 0),
        of("p_y (mm)", "p_y_mm", 1),
        of("p_z (mm)", "p_z_mm", 2),
    ])
}

fn angles(log: &Log) -> Option<Vec<Panel>> {
    let joints = log.series("sense.joints").filter(|series| !series.is_empty())?;
    let finger = finger_trajectory(&joints);
    let degrees = 1.0_f64.to_degrees();
    let of = |title, label, values: &[f64]| finger_panel(title, label, &finger.t_s, values);
    Some(vec![
        panel("joint angles (deg)", joint_lines(&joints, "q_rad", "q", degrees)),
        of("theta_zz (deg)", "theta_zz_deg", &finger.theta_zz_deg),
        of("theta_xx (deg)", "theta_xx_deg", &finger.theta_xx_deg),
    ])
}

fn tracking(log: &Log) -> Option<Vec<Panel>> {
    let torque = log.series("joint_servo.torque").filter(|series| !series.is_empty())?;
    let lines = joint_lines(&torque, "error_rad", "e", 1.0_f64.to_degrees());
    Some(vec![
        panel("error of joints 1 to 3 (deg)", lines[..3].to_vec()),
        panel("error of joints 4 to 6 (deg)", lines[3..].to_vec()),
    ])
}

fn torques(log: &Log) -> Option<Vec<Panel>> {
    let asked = log.series("joint_servo.torque").filter(|series| !series.is_empty());
    let applied = log.series("actuate.applied").filter(|series| !series.is_empty());
    let mut panels = Vec::new();
    for (series, what) in [(asked, "asked for"), (applied, "applied")] {
        let Some(series) = series else { continue };
        let lines = joint_lines(&series, "tau_nm", "tau", 1.0);
        panels.push(panel(&format!("torque {what}, joints 1 to 3 (N m)"), lines[..3].to_vec()));
        panels.push(panel(&format!("torque {what}, joints 4 to 6 (N m)"), lines[3..].to_vec()));
    }
    (!panels.is_empty()).then_some(panels)
}

fn truth(log: &Log) -> Option<Vec<Panel>> {
    let truth = log.series("world.truth").filter(|series| !series.is_empty())?;
    let t = &truth.t_s;
    let of = |field: &str, label: &str, unit: f64, colour| {
        let values = truth.values(field, 0).into_iter().map(|x| x * unit).collect();
        line(label, t, values, colour)
    };
    let degrees = 1.0_f64.to_degrees();
    Some(vec![
        panel(
            "normal force (N)",
            vec![of("finger_normal_n", "finger", 1.0, 0), of("table_normal_n", "table", 1.0, 1)],
        ),
        panel("contact line (tactels)", vec![of("contact_x", "contact_x", 1.0, 0)]),
        panel("pin on the sensor (deg)", vec![of("pin_yaw_rad", "pin_yaw_deg", degrees, 0)]),
    ])
}

/// A view by its name; `None` when the log lacks its signals or the name is not one of [`VIEWS`].
#[must_use]
pub fn view(log: &Log, name: &str) -> Option<View> {
    let panels = match name {
        "features" => features(log),
        "positions" => positions(log),
        "angles" => angles(log),
        "tracking" => tracking(log),
        "torques" => torques(log),
        "truth" => truth(log),
        _ => None,
    }?;
    let title = VIEWS.iter().find(|known| known.0 == name)?.1.to_owned();
    Some(View { name: name.to_owned(), title, panels })
}

/// A view of a signal with a panel for each field: all fields (`task.port`), or one
/// (`task.port.field`).
#[must_use]
pub fn signal_view(log: &Log, name: &str) -> Option<View> {
    let (signal, wanted) = match log.find(name) {
        Some(_) => (name, None),
        None => name.rsplit_once('.').map(|(signal, field)| (signal, Some(field)))?,
    };
    let series = log.series(signal)?;
    let mut panels = Vec::new();
    for column in series.columns.iter().filter(|c| wanted.is_none_or(|field| c.name == field)) {
        let one = |index: usize| {
            let label = if column.array {
                format!("{}[{index}]", column.name)
            } else {
                column.name.clone()
            };
            line(&label, &series.t_s, column.element(index), index)
        };
        panels.push(panel(&column.name, (0..column.width).map(one).collect()));
    }
    (!panels.is_empty()).then(|| View { name: name.to_owned(), title: name.to_owned(), panels })
}

/// The states that the supervisor went through.
#[must_use]
pub fn state_strip(log: &Log) -> StateStrip {
    let mut strip = StateStrip::default();
    let Some(series) = log.series("supervisor.control") else { return strip };
    for (t_s, code) in series.t_s.iter().zip(series.values("state", 0)) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a u32 field")]
        let name = State::from_code(code as u32).map_or("?", State::name);
        if strip.states.last().is_none_or(|last| last.1 != name) {
            strip.states.push((*t_s, name.to_owned()));
        }
    }
    strip
}

/// The newest image at or before each time, with the features that were read from it.
#[must_use]
pub fn image_panels(log: &Log, times_s: &[f64]) -> Vec<ImagePanel> {
    let Some(series) = log.series("tactile_scan.image") else { return Vec::new() };
    let features = log.series("tactile_servo.features").unwrap_or_default();
    let (rows, cols) = (series.values("rows", 0), series.values("cols", 0));
    use taktil_signal::defined::{CENTROID, THETA_Z};
    let x_c = masked_values(&features, "x_c", CENTROID);
    let y_c = masked_values(&features, "y_c", CENTROID);
    let theta = masked_values(&features, "theta_z_rad", THETA_Z);
    let mut out = Vec::new();
    for &t_s in times_s {
        let Some(row) = series.row_at(t_s) else { continue };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "u16 fields")]
        let (rows, cols) = (rows[row] as usize, cols[row] as usize);
        let field = |name| series.column(name).map(|column| column.row(row)).unwrap_or_default();
        let used = rows * cols;
        let axis = features.row_at(t_s).and_then(|at| {
            let (x_c, y_c) = (*x_c.get(at)?, *y_c.get(at)?);
            Some(PrincipalAxis { x_c, y_c, theta_rad: *theta.get(at)? })
        });
        out.push(ImagePanel {
            title: format!("t = {t_s:.2} s"),
            rows,
            cols,
            counts: field("counts").iter().copied().take(used).collect(),
            valid: field("valid").iter().take(used).map(|mark| *mark != 0.0).collect(),
            axis,
        });
    }
    out
}

/// The time span (s) in which the tactile servo was active; the whole log when it never was.
fn active_span_s(log: &Log, features: &Series) -> (f64, f64) {
    let active = features.values("active", 0);
    let mut on = features.t_s.iter().zip(&active).filter(|(_, on)| **on != 0.0).map(|(t, _)| *t);
    match (on.next(), on.next_back()) {
        (Some(begin), Some(end)) => (begin, end),
        _ => (0.0, log.end_s()),
    }
}

/// Time that is shown before the finger first presses (s).
const LEAD_TIME_S: f64 = 0.1;

/// The time span (s) of the rolling: while the servo is active, from shortly before the sum of the
/// image first reaches `pressed` (counts).
#[must_use]
pub fn rolling_span_s(log: &Log, pressed: f64) -> (f64, f64) {
    let features = log.series("tactile_servo.features").unwrap_or_default();
    let (begin, end) = active_span_s(log, &features);
    let sums = features.values("m0", 0);
    let mut loaded =
        features.t_s.iter().zip(&sums).filter(|(t, m0)| **t >= begin && **m0 >= pressed);
    let first = loaded.next().map_or(begin, |(t, _)| *t);
    ((first - LEAD_TIME_S).max(begin), end)
}

/// Four instants (s) spread over the time in which the tactile servo was active.
#[must_use]
pub fn snapshot_times_s(log: &Log) -> Vec<f64> {
    let features = log.series("tactile_servo.features").unwrap_or_default();
    let (begin, end) = active_span_s(log, &features);
    [0.1, 0.35, 0.65, 0.95].map(|share| begin + share * (end - begin)).to_vec()
}
