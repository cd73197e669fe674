//! Draws arm, pin and table of a run on the simulated PUMA 260: from the side, from above, and the
//! pin close up, at several instants. The arm is drawn at the true joint angles; table and pin are
//! where the simulator has them.

use glam::DVec3;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_record::Log;
use taktil_record::series::Series;

use crate::svg::{Anchor, COLOUR_COUNT, Figure, Point};

/// Width of a view of the whole arm (px).
const VIEW_WIDTH_PX: f64 = 330.0;
/// Height of a view (px).
const VIEW_HEIGHT_PX: f64 = 300.0;
/// Room for the heading of a view and for the numbers of its axes (px).
const MARGIN_PX: f64 = 34.0;
/// Half of the width that the close-up shows (mm).
const CLOSE_UP_HALF_WIDTH_MM: f64 = 30.0;
/// Half of the width of the tactile array, 16 columns of 1.5875 mm (mm).
const ARRAY_HALF_WIDTH_MM: f64 = 12.7;
/// How far table and finger are drawn from the pin (mm).
const TABLE_HALF_WIDTH_MM: f64 = 120.0;

/// What stands where at one instant; mm, base frame.
#[derive(Clone, Debug)]
struct SceneInstant {
    t_s: f64,
    /// Base, shoulder, elbow, wrist and tool point.
    arm: Vec<DVec3>,
    /// Directions of the sensor's columns and of its approach.
    columns: DVec3,
    approach: DVec3,
    pin: Option<PinInstant>,
}

#[derive(Clone, Copy, Debug)]
struct PinInstant {
    centre: DVec3,
    axis: DVec3,
    roll_rad: f64,
    radius: f64,
    /// Normal of the table, and its direction of the columns.
    normal: DVec3,
    along: DVec3,
}

/// The picture; `None` when the log is not one of the simulated PUMA 260.
#[must_use]
pub fn figure(log: &Log, times_s: &[f64]) -> Option<Figure> {
    let truth = log.series("world.truth").filter(|series| series.column("pin_m").is_some())?;
    let radius = pin_radius_mm(&truth);
    let instants: Vec<SceneInstant> =
        times_s.iter().filter_map(|t_s| instant(&truth, *t_s, radius)).collect();
    let last = instants.last()?;
    let width = if last.pin.is_some() { 3.0 } else { 2.0 } * VIEW_WIDTH_PX;
    let height = VIEW_HEIGHT_PX + 24.0;
    let mut figure = Figure::new(width, height, "arm, pin and table from the side and from above");
    let side = ViewDirection { right: DVec3::X, up: DVec3::Z, label: "from the side: x0, z0 (mm)" };
    let top = ViewDirection { right: DVec3::X, up: DVec3::Y, label: "from above: x0, y0 (mm)" };
    for (at, direction) in [side, top].into_iter().enumerate() {
        let view = ViewFrame::around(direction, &instants, at as f64 * VIEW_WIDTH_PX);
        view.draw_grid(&mut figure, 100.0);
        for (index, instant) in instants.iter().enumerate() {
            draw_arm(&mut figure, &view, instant, index);
        }
    }
    if let Some(pin) = last.pin {
        let view = ViewFrame::close_up(side, pin.centre, 2.0 * VIEW_WIDTH_PX);
        view.draw_grid(&mut figure, 10.0);
        for (index, instant) in instants.iter().enumerate() {
            draw_contact(&mut figure, &view, instant, index);
        }
    }
    for (index, instant) in instants.iter().enumerate() {
        let x = 8.0 + 90.0 * index as f64;
        let colour = index % COLOUR_COUNT;
        figure.rect(x, height - 14.0, 12.0, 4.0, &format!("f{colour}"));
        figure.text(
            x + 17.0,
            height - 8.0,
            Anchor::Start,
            "small",
            &format!("{:.2} s", instant.t_s),
        );
    }
    Some(figure)
}

/// Radius of the pin (mm): half of the distance from finger to table, without the compression,
/// where the finger touches; 0 where it never does.
fn pin_radius_mm(truth: &Series) -> f64 {
    let contact = truth.values("in_contact", 0);
    let Some(row) = contact.iter().position(|touched| *touched != 0.0) else { return 0.0 };
    let (tool, pin) = (vector(truth, "tool_m", row), vector(truth, "pin_m", row));
    let distance = (tool - pin).dot(table_normal(truth, row));
    (1e3 * distance).max(0.0)
}

fn vector(series: &Series, field: &str, row: usize) -> DVec3 {
    match series.column(field).map(|column| column.row(row)).unwrap_or_default() {
        [x, y, z] => DVec3::new(*x, *y, *z),
        _ => DVec3::ZERO,
    }
}

fn scalar(series: &Series, field: &str, row: usize) -> f64 {
    let values = series.column(field).map(|column| column.row(row)).unwrap_or_default();
    values.first().copied().unwrap_or(0.0)
}

/// Normal of the table: turned about x by its tilt, about y by its rise, about z by its pan.
fn table_normal(truth: &Series, row: usize) -> DVec3 {
    let tilt = glam::DQuat::from_rotation_z(scalar(truth, "table_pan_rad", row))
        * glam::DQuat::from_rotation_y(-scalar(truth, "table_tilt_y_rad", row))
        * glam::DQuat::from_rotation_x(scalar(truth, "table_tilt_x_rad", row));
    tilt * DVec3::Z
}

fn instant(truth: &Series, t_s: f64, radius: f64) -> Option<SceneInstant> {
    let row = truth.row_at(t_s)?;
    let q = truth.column("q_rad").map(|column| column.row(row)).filter(|q| q.len() == 6)?;
    let joints = Joints::from_column_slice(q);
    let arm = Puma260::reference();
    let tool = arm.tool_pose(&joints);
    let points = arm.joint_centres(&joints).map(|point| 1e3 * point);
    let normal = table_normal(truth, row);
    let axis = vector(truth, "pin_axis", row);
    let pin = (radius > 0.0).then(|| PinInstant {
        centre: 1e3 * vector(truth, "pin_m", row),
        axis,
        roll_rad: scalar(truth, "pin_roll_rad", row),
        radius,
        normal,
        along: (DVec3::X - DVec3::X.dot(normal) * normal).normalize_or_zero(),
    });
    Some(SceneInstant {
        t_s: truth.t_s.get(row).copied()?,
        arm: points.to_vec(),
        columns: tool.rotation.x_axis,
        approach: tool.rotation.z_axis,
        pin,
    })
}

#[derive(Clone, Copy, Debug)]
struct ViewDirection {
    right: DVec3,
    up: DVec3,
    label: &'static str,
}

/// Where a view stands in the picture, and what it shows.
#[derive(Clone, Copy, Debug)]
struct ViewFrame {
    direction: ViewDirection,
    left_px: f64,
    /// Middle of what is shown (mm), and pixels a millimetre.
    centre: [f64; 2],
    scale: f64,
}

impl ViewFrame {
    /// All of the arm and the pin.
    fn around(direction: ViewDirection, instants: &[SceneInstant], left_px: f64) -> ViewFrame {
        let pins = instants.iter().filter_map(|instant| instant.pin).map(|pin| pin.centre);
        let points = instants.iter().flat_map(|instant| instant.arm.iter().copied()).chain(pins);
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for point in points.filter(|point| point.is_finite()) {
            for (axis, along) in [direction.right, direction.up].into_iter().enumerate() {
                low[axis] = low[axis].min(point.dot(along));
                high[axis] = high[axis].max(point.dot(along));
            }
        }
        let centre = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
        let room = |pixels: f64| pixels - 2.0 * MARGIN_PX;
        let scale = (room(VIEW_WIDTH_PX) / (high[0] - low[0] + 60.0))
            .min(room(VIEW_HEIGHT_PX) / (high[1] - low[1] + 60.0));
        ViewFrame { direction, left_px, centre, scale }
    }

    fn close_up(direction: ViewDirection, centre: DVec3, left_px: f64) -> ViewFrame {
        ViewFrame {
            direction: ViewDirection { label: "the pin, from the side (mm)", ..direction },
            left_px,
            centre: [centre.dot(direction.right), centre.dot(direction.up)],
            scale: (0.5 * VIEW_WIDTH_PX - MARGIN_PX) / CLOSE_UP_HALF_WIDTH_MM,
        }
    }

    fn place(&self, point: DVec3) -> Point {
        let right = point.dot(self.direction.right) - self.centre[0];
        let up = point.dot(self.direction.up) - self.centre[1];
        Point::new(
            self.left_px + 0.5 * VIEW_WIDTH_PX + self.scale * right,
            0.5 * VIEW_HEIGHT_PX - self.scale * up,
        )
    }

    fn draw_grid(&self, figure: &mut Figure, spacing_mm: f64) {
        let left = self.left_px + MARGIN_PX;
        let right = self.left_px + VIEW_WIDTH_PX - 8.0;
        let (upper, lower) = (24.0, VIEW_HEIGHT_PX - MARGIN_PX + 8.0);
        figure.text(left, 15.0, Anchor::Start, "head", self.direction.label);
        let middle_px = [self.left_px + 0.5 * VIEW_WIDTH_PX, 0.5 * VIEW_HEIGHT_PX];
        let first = |low_mm: f64| (low_mm / spacing_mm).ceil() * spacing_mm;
        let mut x_mm = first(self.centre[0] + (left - middle_px[0]) / self.scale);
        loop {
            let x = middle_px[0] + self.scale * (x_mm - self.centre[0]);
            if x.is_nan() || x > right {
                break;
            }
            figure.line(Point::new(x, upper), Point::new(x, lower), "grid");
            figure.text(
                x,
                lower + 13.0,
                Anchor::Middle,
                "dim small",
                &format!("{:.0}", x_mm + 0.0),
            );
            x_mm += spacing_mm;
        }
        let mut y_mm = first(self.centre[1] - (lower - middle_px[1]) / self.scale);
        loop {
            let y = middle_px[1] - self.scale * (y_mm - self.centre[1]);
            if y.is_nan() || y < upper {
                break;
            }
            figure.line(Point::new(left, y), Point::new(right, y), "grid");
            figure.text(
                left - 4.0,
                y + 4.0,
                Anchor::End,
                "dim small",
                &format!("{:.0}", y_mm + 0.0),
            );
            y_mm += spacing_mm;
        }
    }
}

fn draw_arm(figure: &mut Figure, view: &ViewFrame, instant: &SceneInstant, index: usize) {
    let colour = index % COLOUR_COUNT;
    let points: Vec<Point> = instant.arm.iter().map(|point| view.place(*point)).collect();
    figure.polyline(&points, &format!("line key s{colour}"));
    for point in points.iter().rev().skip(1) {
        figure.circle(point.x, point.y, 3.0, &format!("f{colour}"));
    }
    let Some(pin) = &instant.pin else { return };
    let centre = view.place(pin.centre);
    figure.circle(centre.x, centre.y, (view.scale * pin.radius).max(2.0), &format!("f{colour}"));
    // From above the table has no edge to draw.
    if view.direction.up == DVec3::Z {
        let foot = pin.centre - pin.radius * pin.normal;
        let end = |side: f64| view.place(foot + side * TABLE_HALF_WIDTH_MM * pin.along);
        figure.line(end(-1.0), end(1.0), "axis");
    }
}

fn draw_contact(figure: &mut Figure, view: &ViewFrame, instant: &SceneInstant, index: usize) {
    let Some(pin) = &instant.pin else { return };
    let class = format!("line s{}", index % COLOUR_COUNT);
    // A circle in the plane across the pin's axis, seen from the side, with a spoke that turns.
    let across = (pin.along - pin.along.dot(pin.axis) * pin.axis).normalize_or_zero();
    let third = pin.axis.cross(across);
    let rim = |angle: f64| {
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        view.place(pin.centre + pin.radius * (cos * across + sin * third))
    };
    let circle: Vec<Point> = (0..=48).map(|step| rim(f64::from(step) * 0.130_9)).collect();
    figure.polyline(&circle, &class);
    figure.line(view.place(pin.centre), rim(pin.roll_rad), &class);
    let foot = pin.centre - pin.radius * pin.normal;
    let table =
        [-1.0, 1.0].map(|side| view.place(foot + side * CLOSE_UP_HALF_WIDTH_MM * pin.along));
    figure.line(table[0], table[1], "axis");
    let Some(tool) = instant.arm.last() else { return };
    let corners = [(-1.0, 6.0), (-1.0, 0.0), (1.0, 0.0), (1.0, 6.0)].map(|(side, back)| {
        let along = side * ARRAY_HALF_WIDTH_MM * instant.columns;
        view.place(*tool + along - back * instant.approach)
    });
    figure.polyline(&corners, &format!("{class} key"));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instant_at(q: [f64; 6]) -> SceneInstant {
        let arm = Puma260::reference();
        let joints = Joints::from_column_slice(&q);
        let tool = arm.tool_pose(&joints);
        SceneInstant {
            t_s: 0.0,
            arm: arm.joint_centres(&joints).map(|point| 1e3 * point).to_vec(),
            columns: tool.rotation.x_axis,
            approach: tool.rotation.z_axis,
            pin: None,
        }
    }

    #[test]
    fn the_whole_arm_stands_inside_its_view_at_one_scale() {
        let instants = [instant_at([0.0; 6]), instant_at([1.0, 0.7, -2.7, -3.1, 1.2, 3.1])];
        for up in [DVec3::Z, DVec3::Y] {
            let direction = ViewDirection { right: DVec3::X, up, label: "" };
            let view = ViewFrame::around(direction, &instants, 330.0);
            for point in instants.iter().flat_map(|instant| &instant.arm) {
                let Point { x, y } = view.place(*point);
                assert!((330.0 + MARGIN_PX..660.0 - MARGIN_PX + 1.0).contains(&x), "{x}");
                assert!((MARGIN_PX..VIEW_HEIGHT_PX - MARGIN_PX + 1.0).contains(&y), "{y}");
            }
        }
    }

    #[test]
    fn up_is_up_and_a_millimetre_is_as_long_both_ways() {
        let direction = ViewDirection { right: DVec3::X, up: DVec3::Z, label: "" };
        let view = ViewFrame::close_up(direction, DVec3::new(300.0, 5.0, -150.0), 0.0);
        let origin = view.place(DVec3::new(300.0, 9.0, -150.0));
        let right = view.place(DVec3::new(310.0, 9.0, -150.0));
        let above = view.place(DVec3::new(300.0, 9.0, -140.0));
        assert!(right.x > origin.x && above.y < origin.y);
        assert!((right.x - origin.x - (origin.y - above.y)).abs() < 1e-9);
    }
}
