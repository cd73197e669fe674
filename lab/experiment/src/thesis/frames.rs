//! The frames of chapter 6 as a picture: which way theta_zz and theta_xx are counted, which way the
//! tables of E3, E4 and E7 turn, and how a level finger climbs a tilted table (E2).
//!
//! The thesis (section 6.3, figure 6.8) calls theta_zz the angle formed by the sensor's z axis and
//! the plane x0-z0, and theta_xx the angle formed by its x axis and the same plane: the sine of
//! both is the axis's share along y0. theta_zz is counted from z0 towards y0, theta_xx from x0
//! towards y0.

use taktil_lab_plot::svg::{Anchor, Figure, Point};

/// Width of a view (px).
const VIEW_WIDTH_PX: f64 = 330.0;
/// Height of the picture (px).
const PICTURE_HEIGHT_PX: f64 = 330.0;
/// Length of an axis (px).
const AXIS_PX: f64 = 62.0;
/// Cosine of a direction from which on the name stands beside the tip.
const BESIDE_COSINE: f64 = 0.08;
/// Points of an arc.
const ARC_POINTS: usize = 60;

/// An arrow with a name at its tip. The direction is an angle from the right, positive upwards
/// (deg).
struct Arrow<'a> {
    from: Point,
    direction_deg: f64,
    length_px: f64,
    class: &'a str,
    name: &'a str,
}

fn tip(from: Point, direction_deg: f64, length_px: f64) -> Point {
    let angle = direction_deg.to_radians();
    Point::new(from.x + length_px * libm::cos(angle), from.y - length_px * libm::sin(angle))
}

fn arrow(figure: &mut Figure, arrow: &Arrow<'_>) {
    let end = tip(arrow.from, arrow.direction_deg, arrow.length_px);
    figure.line(arrow.from, end, arrow.class);
    for side in [155.0, -155.0] {
        figure.line(end, tip(end, arrow.direction_deg + side, 8.0), arrow.class);
    }
    let name = tip(end, arrow.direction_deg, 10.0);
    // Beside the tip, away from the arrow, so that names of neighbours do not meet.
    let anchor = match libm::cos(arrow.direction_deg.to_radians()) {
        right if right > BESIDE_COSINE => Anchor::Start,
        left if left < -BESIDE_COSINE => Anchor::End,
        _ => Anchor::Middle,
    };
    figure.text(name.x, name.y + 4.0, anchor, "small", arrow.name);
}

/// An arc from one direction to another one, with an arrow head at its end.
struct Arc<'a> {
    centre: Point,
    radius_px: f64,
    from_deg: f64,
    to_deg: f64,
    class: &'a str,
}

fn arc(figure: &mut Figure, arc: &Arc<'_>) {
    let at = |i: usize| {
        let share = i as f64 / ARC_POINTS as f64;
        tip(arc.centre, arc.from_deg + share * (arc.to_deg - arc.from_deg), arc.radius_px)
    };
    let points: Vec<Point> = (0..=ARC_POINTS).map(at).collect();
    figure.polyline(&points, arc.class);
    let forward = if arc.to_deg > arc.from_deg { 90.0 } else { -90.0 };
    for side in [150.0, -150.0] {
        let end = points[ARC_POINTS];
        figure.line(end, tip(end, arc.to_deg + forward + side, 7.0), arc.class);
    }
}

/// A straight line through a point, `angle_deg` from the horizontal.
fn surface(figure: &mut Figure, middle: Point, angle_deg: f64, half_px: f64, class: &str) {
    figure.line(tip(middle, angle_deg, half_px), tip(middle, angle_deg + 180.0, half_px), class);
}

fn heading(figure: &mut Figure, left: f64, lines: [&str; 2]) {
    figure.text(left + 12.0, 22.0, Anchor::Start, "name", lines[0]);
    figure.text(left + 12.0, 39.0, Anchor::Start, "small dim", lines[1]);
}

/// Two axes of the base from a point: to the right and up.
fn axes(figure: &mut Figure, from: Point, names: [&str; 2]) {
    for (direction_deg, name) in [0.0, 90.0].into_iter().zip(names) {
        let length_px = AXIS_PX;
        arrow(figure, &Arrow { from, direction_deg, length_px, class: "axis", name });
    }
}

/// Along -x0: y0 to the right, z0 up. theta_zz is counted clockwise from z0 towards y0.
fn about_x(figure: &mut Figure, left: f64) {
    heading(
        figure,
        left,
        ["theta_zz: seen against x0", "E1 at 171 deg, E3 and E7 14 and 15 deg further"],
    );
    let centre = Point::new(left + 165.0, 175.0);
    axes(figure, centre, ["y0", "z0"]);
    for (theta, class, name, radius) in
        [(171.0, "line key s0", "z_s of E1", 34.0), (185.3, "line key s1", "E3", 46.0)]
    {
        let direction_deg = 90.0 - theta;
        arrow(figure, &Arrow { from: centre, direction_deg, length_px: 92.0, class, name });
        let (from_deg, to_deg) = (90.0, direction_deg);
        arc(figure, &Arc { centre, radius_px: radius, from_deg, to_deg, class });
    }
    let below = Point::new(centre.x, 300.0);
    surface(figure, below, 4.4, 120.0, "line key s0");
    surface(figure, below, -9.6, 120.0, "line key s1");
    figure.text(left + 20.0, 322.0, Anchor::Start, "small dim", "tables; x0 points at the reader");
}

/// From above: x0 to the right, y0 up. theta_xx is counted from x0 towards y0.
fn about_z(figure: &mut Figure, left: f64) {
    heading(figure, left, ["theta_xx: seen from above", "E1 at 178 deg, E4 about 21 deg further"]);
    let centre = Point::new(left + 180.0, 175.0);
    axes(figure, centre, ["x0", "y0"]);
    for (theta, class, name, radius) in
        [(178.2, "line key s0", "x_s of E1", 34.0), (199.2, "line key s1", "E4", 46.0)]
    {
        arrow(figure, &Arrow { from: centre, direction_deg: theta, length_px: 92.0, class, name });
        let (from_deg, to_deg) = (0.0, theta);
        arc(figure, &Arc { centre, radius_px: radius, from_deg, to_deg, class });
    }
    let below = Point::new(centre.x, 275.0);
    surface(figure, below, 90.0, 32.0, "line key s0");
    surface(figure, below, 111.0, 32.0, "line key s1");
    figure.text(left + 20.0, 322.0, Anchor::Start, "small dim", "axes of the pin");
}

/// From the side: x0 to the right, z0 up: a level finger on a pin on a tilted table.
fn about_y(figure: &mut Figure, left: f64) {
    heading(
        figure,
        left,
        [
            "E2: a level finger on a tilted table",
            "the finger climbs by tan(A / 2) of its way, A = 14.4 deg",
        ],
    );
    let (tilt_deg, radius) = (14.4, 46.0);
    let foot = Point::new(left + 140.0, 250.0);
    surface(figure, foot, tilt_deg, 125.0, "line key s1");
    let centre = tip(foot, 90.0 + tilt_deg, radius);
    let circle: Vec<Point> =
        (0..=ARC_POINTS).map(|i| tip(centre, 6.0 * i as f64, radius)).collect();
    figure.polyline(&circle, "axis");
    let top = tip(centre, 90.0, radius);
    surface(figure, Point::new(top.x + 15.0, top.y), 0.0, 75.0, "line key s0");
    figure.text(top.x + 96.0, top.y + 4.0, Anchor::Start, "small", "finger");
    let rolls = |from, direction_deg, class, name| Arrow {
        from,
        direction_deg,
        length_px: 55.0,
        class,
        name,
    };
    arrow(figure, &rolls(centre, tilt_deg, "line key s2", "pin"));
    let above = Point::new(top.x, top.y - 24.0);
    arrow(figure, &rolls(above, 0.5 * tilt_deg, "line key s0", "way"));
    let corner = tip(foot, tilt_deg + 180.0, 118.0);
    surface(figure, Point::new(corner.x + 40.0, corner.y), 0.0, 40.0, "grid");
    figure.text(corner.x + 84.0, corner.y - 4.0, Anchor::Start, "small", "A");
    let note = "between the two the wedge closes uphill: M0 rises";
    figure.text(left + 20.0, 322.0, Anchor::Start, "small dim", note);
}

/// The picture of the three views.
#[must_use]
pub fn picture() -> Figure {
    let about = "frames and signs of chapter 6: theta_zz, theta_xx, and the level finger of E2";
    let mut figure = Figure::new(3.0 * VIEW_WIDTH_PX, PICTURE_HEIGHT_PX, about);
    about_x(&mut figure, 0.0);
    about_z(&mut figure, VIEW_WIDTH_PX);
    about_y(&mut figure, 2.0 * VIEW_WIDTH_PX);
    figure
}
