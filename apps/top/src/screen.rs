//! The picture of a machine on a terminal, for 80 by 24 characters and more. Colours repeat what
//! characters say, so that a terminal without them is enough.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph};
use taktil_machine_client::Value;

use crate::view::MachineView;

/// Rows and columns of the image on the screen.
const IMAGE_CELLS: usize = 16;
/// Characters of the bar that shows a joint's angle within its limits.
const BAR_CHARACTERS: usize = 12;
/// Characters for counts, from none to the largest.
const SHADES: [&str; 5] = ["  ", "░░", "▒▒", "▓▓", "██"];

/// Draws the machine.
pub fn draw(frame: &mut Frame<'_>, view: &MachineView) {
    let [head, middle, foot] =
        Layout::vertical([Constraint::Length(2), Constraint::Min(18), Constraint::Length(4)])
            .areas(frame.area());
    let [left, right] =
        Layout::horizontal([Constraint::Min(46), Constraint::Length(34)]).areas(middle);
    let joint_lines = u16::try_from(view.status["joints"].as_array().map_or(0, Vec::len));
    let [joints, lanes] =
        Layout::vertical([Constraint::Length(joint_lines.unwrap_or(0) + 3), Constraint::Min(5)])
            .areas(left);
    frame.render_widget(Paragraph::new(head_lines(view)), head);
    frame.render_widget(Paragraph::new(joint_table(&view.status)).block(titled("joints")), joints);
    frame.render_widget(Paragraph::new(lane_table(view)).block(titled("lanes")), lanes);
    draw_image(frame, view, right);
    frame.render_widget(Paragraph::new(foot_lines(view)), foot);
}

fn titled(title: &str) -> Block<'_> {
    Block::bordered().title(title)
}

fn text_of<'a>(value: &'a Value, otherwise: &'a str) -> &'a str {
    value.as_str().unwrap_or(otherwise)
}

fn head_lines(view: &MachineView) -> Vec<Line<'static>> {
    let status = &view.status;
    let bold = Style::new().add_modifier(Modifier::BOLD);
    if status.is_null() {
        return vec![Line::styled("taktil-top", bold), Line::from(view.message.clone())];
    }
    let kind = match status["machine"]["simulated"].as_bool() {
        Some(true) => "SIMULATED",
        _ => "REAL BOARDS",
    };
    let kernel = &status["kernel"];
    let is_virtual = kernel["notes"].as_array().into_iter().flatten();
    let is_virtual = is_virtual.filter_map(Value::as_str).any(|n| n.contains("virtual machine"));
    let grant = match kernel["granted"].as_bool() {
        Some(true) => "real time granted",
        Some(false) => "NOT REAL TIME",
        None => "kernel not asked yet",
    };
    let kernel = text_of(&kernel["facts"]["kernel"], "");
    let host = if is_virtual { "VIRTUAL MACHINE" } else { "" };
    let t_s = status["t_ns"].as_f64().unwrap_or(0.0) * 1e-9;
    let state = text_of(&status["state"], "?").to_owned();
    let mode = text_of(&status["mode"], "?").to_owned();
    let lost = if view.is_connected() { "" } else { "  GONE" };
    vec![
        Line::from(format!("taktil-top  {kind}  {host}  {grant}  {kernel}")),
        Line::from(vec![
            Span::styled(state, bold),
            Span::from(format!("  mode {mode}  {t_s:.1} s{lost}  {}", control(status))),
        ]),
    ]
}

fn control(status: &Value) -> String {
    let holder = &status["control"]["holder"];
    match holder["pid"].as_i64() {
        Some(pid) => format!("control: process {pid}"),
        None => "control: free".into(),
    }
}

fn joint_table(status: &Value) -> Vec<Line<'static>> {
    let head = format!("     {:<14}{:>8}{:>8}{:>8}", "in its limits", "deg", "error", "N m");
    let mut lines = vec![Line::styled(head, Style::new().add_modifier(Modifier::DIM))];
    for (at, joint) in status["joints"].as_array().into_iter().flatten().enumerate() {
        let number = |name: &str| joint[name].as_f64();
        let share = number("q_deg").zip(number("low_deg")).zip(number("high_deg"));
        let share = share.map(|((q, low), high)| ((q - low) / (high - low)).clamp(0.0, 1.0));
        let shown = |value: Option<f64>, digits: usize| match value {
            Some(value) => format!("{value:>8.digits$}"),
            None => format!("{:>8}", "-"),
        };
        lines.push(Line::from(format!(
            "  {} [{}]{}{}{}",
            at + 1,
            bar(share),
            shown(number("q_deg"), 2),
            shown(number("error_deg"), 3),
            shown(number("torque_nm"), 2),
        )));
    }
    lines
}

/// A mark between the limits of a joint.
fn bar(share: Option<f64>) -> String {
    let Some(share) = share else { return " ".repeat(BAR_CHARACTERS) };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "a place on a dozen characters"
    )]
    let at = (share * (BAR_CHARACTERS - 1) as f64).round() as usize;
    (0..BAR_CHARACTERS).map(|i| if i == at { '|' } else { '-' }).collect()
}

fn lane_table(view: &MachineView) -> Vec<Line<'static>> {
    let head = format!("{:<8}{:>8}{:>10}{:>8}{:>8}", "", "ms", "jobs", "jobs/s", "missed");
    let mut lines = vec![Line::styled(head, Style::new().add_modifier(Modifier::DIM))];
    for (at, lane) in view.status["timing"].as_array().into_iter().flatten().enumerate() {
        let name: String = text_of(&lane["lane"], "?").chars().take(8).collect();
        let period_ms = lane["period_ns"].as_f64().unwrap_or(0.0) * 1e-6;
        let rate = view.rates_per_s.get(at).map_or("-".to_owned(), |rate| format!("{rate:.0}"));
        let missed = lane["missed"].as_u64();
        let text = format!(
            "{name:<8}{period_ms:>8.2}{:>10}{rate:>8}{:>8}",
            lane["jobs"].as_u64().map_or("-".to_owned(), |jobs| jobs.to_string()),
            missed.map_or("-".to_owned(), |missed| missed.to_string()),
        );
        let late = lane["lateness"]["max_ns"].as_f64();
        let late = late.map_or(String::new(), |ns| format!(" late {:.0} us", ns * 1e-3));
        let is_bad = missed.is_some_and(|missed| missed > 0);
        let style = if is_bad { Style::new().fg(Color::Yellow) } else { Style::new() };
        lines.push(Line::styled(text + &late, style));
    }
    lines
}

fn draw_image(frame: &mut Frame<'_>, view: &MachineView, area: Rect) {
    let image = view.image(IMAGE_CELLS);
    let mut lines: Vec<Line<'_>> = Vec::new();
    // The first row is the lowest, as the sensor's y runs upwards.
    for row in image.iter().rev() {
        let cells = row.iter().map(|share| Span::styled(shade(*share), colour(*share)));
        lines.push(Line::from(cells.collect::<Vec<_>>()));
    }
    let features = &view.status["touch"]["features"];
    let title = match (image.is_empty(), features["m0_counts"].as_f64()) {
        (true, _) => "touch: no image".to_owned(),
        // A set of marks, one for each feature that has a meaning now.
        (false, Some(m0)) if features["defined"].as_u64().is_some_and(|marks| marks != 0) => {
            let x = features["x_c"].as_f64().unwrap_or(0.0);
            format!("touch: M0 {m0:.0}, x {x:.1}")
        }
        (false, _) => "touch: no contact".to_owned(),
    };
    frame.render_widget(Paragraph::new(lines).block(Block::bordered().title(title)), area);
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share between 0 and 1"
)]
fn shade(share: f64) -> &'static str {
    SHADES[((share * 4.999) as usize).min(SHADES.len() - 1)]
}

/// Blue to yellow, which colour-blind people tell apart.
fn colour(share: f64) -> Style {
    Style::new().fg(if share > 0.6 {
        Color::Yellow
    } else if share > 0.2 {
        Color::Gray
    } else {
        Color::Blue
    })
}

fn foot_lines(view: &MachineView) -> Vec<Line<'static>> {
    let status = &view.status;
    let faults: Vec<&Value> = status["faults"].as_array().into_iter().flatten().collect();
    let fault = match faults.iter().find(|fault| fault["first"] == true).or(faults.first()) {
        None => Line::from("no fault"),
        Some(fault) => Line::styled(
            format!(
                "FAULT {}: {}; {} ({} in all)",
                text_of(&fault["name"], "?"),
                text_of(&fault["text"], ""),
                text_of(&fault["clear"], ""),
                faults.len()
            ),
            Style::new().fg(Color::Red).add_modifier(Modifier::BOLD),
        ),
    };
    let allowed = status["allowed"].as_object().into_iter().flatten();
    let allowed: Vec<&str> =
        allowed.filter(|(_, why)| why.is_null()).map(|(verb, _)| verb.as_str()).collect();
    vec![
        fault,
        Line::from(format!("allowed: {}", allowed.join(" "))),
        Line::from(view.message.clone()),
        Line::styled(
            "space: stop request, not the safety circuit   q: end",
            Style::new().add_modifier(Modifier::DIM),
        ),
    ]
}
