//! Draws tactile images as heat maps: columns to the right, rows upwards. Tactels that are marked
//! as invalid are grey.

use super::axis::format_number;
use super::svg::{Anchor, Figure, Point};

/// The centroid of an image and the direction of its long axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrincipalAxis {
    /// Column number of the centroid, from 1.
    pub x_c: f64,
    /// Row number of the centroid, from 1.
    pub y_c: f64,
    /// Direction of the long axis, from y towards -x (rad).
    pub theta_rad: f64,
}

/// One tactile image with the features that were computed from it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImagePanel {
    /// Text above the image.
    pub title: String,
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub cols: usize,
    /// Counts, row by row.
    pub counts: Vec<f64>,
    /// Which tactels are valid; all of them when the list is empty.
    pub valid: Vec<bool>,
    /// Centroid and long axis; absent when the image has none.
    pub axis: Option<PrincipalAxis>,
}

/// Samples of the colour map cividis (Nunez, Anderton and Renslow 2018), from dark blue at no load
/// to yellow at the largest. Its lightness rises evenly, also for people with colour blindness.
const CIVIDIS_RGB: [[u8; 3]; 9] = [
    [0x00, 0x22, 0x4e],
    [0x12, 0x35, 0x70],
    [0x3b, 0x49, 0x6c],
    [0x57, 0x5d, 0x6d],
    [0x70, 0x71, 0x73],
    [0x8a, 0x86, 0x79],
    [0xa5, 0x9c, 0x74],
    [0xc3, 0xb3, 0x69],
    [0xfe, 0xe8, 0x38],
];

/// The colour (`#rrggbb`) of a share of the largest value; a share outside 0..=1 is clamped.
#[must_use]
pub fn cividis_colour(share: f64) -> String {
    let share = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
    let place = share * 8.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0..=7")]
    let index = (place.floor() as usize).min(7);
    let part = place - index as f64;
    let mut text = String::from("#");
    for (a, b) in CIVIDIS_RGB[index].iter().zip(CIVIDIS_RGB[index + 1]) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0..=255")]
        let value = (f64::from(*a) + part * (f64::from(b) - f64::from(*a))).round() as u8;
        text.push_str(&format!("{value:02x}"));
    }
    text
}

/// Side of the square of one tactel.
const CELL_SIDE_PX: f64 = 12.0;
/// Space above the images, with the titles.
const TOP_MARGIN_PX: f64 = 44.0;
/// Space to the left of the first image.
const LEFT_MARGIN_PX: f64 = 30.0;
/// Space between two images.
const IMAGE_GAP_PX: f64 = 24.0;
/// Space below the images, with the column numbers.
const FOOT_HEIGHT_PX: f64 = 44.0;
/// Height of one line of remarks.
const REMARK_HEIGHT_PX: f64 = 17.0;

/// Images side by side on one colour scale in counts.
#[must_use]
pub fn heat_maps(title: &str, images: &[ImagePanel]) -> Figure {
    heat_map_row(title, "counts", &[], LEFT_MARGIN_PX, images)
}

/// Images side by side as [`heat_maps`] draws them, in a given unit, with numbered rows and with
/// remarks below.
#[must_use]
pub fn labelled_heat_maps(
    title: &str,
    unit: &str,
    remarks: &[String],
    images: &[ImagePanel],
) -> Figure {
    /// Space to the left of the first image when its rows are numbered.
    const NUMBERED_MARGIN_PX: f64 = 64.0;
    let mut figure = heat_map_row(title, unit, remarks, NUMBERED_MARGIN_PX, images);
    if let Some(first) = images.first() {
        let (place, bottom) =
            (NUMBERED_MARGIN_PX - 6.0, TOP_MARGIN_PX + CELL_SIDE_PX * first.rows as f64);
        let middle = 0.5 * (TOP_MARGIN_PX + bottom) + 4.0;
        figure.text(place, bottom, Anchor::End, "small dim", "1");
        figure.text(place, middle, Anchor::End, "small dim", "y (row)");
        figure.text(
            place,
            TOP_MARGIN_PX + 9.0,
            Anchor::End,
            "small dim",
            &format!("{}", first.rows),
        );
    }
    figure
}

fn heat_map_row(
    title: &str,
    unit: &str,
    remarks: &[String],
    from: f64,
    images: &[ImagePanel],
) -> Figure {
    let most = images.iter().flat_map(|image| &image.counts).copied();
    let most = most.filter(|count| count.is_finite()).fold(1.0, f64::max);
    let wide = |image: &ImagePanel| CELL_SIDE_PX * image.cols as f64;
    let width = from + images.iter().map(|image| wide(image) + IMAGE_GAP_PX).sum::<f64>() + 70.0;
    let tallest = images.iter().map(|image| image.rows).max().unwrap_or(1);
    let height = TOP_MARGIN_PX
        + CELL_SIDE_PX * tallest as f64
        + FOOT_HEIGHT_PX
        + REMARK_HEIGHT_PX * remarks.len() as f64;
    let mut figure = Figure::new(width.max(300.0), height, title);
    figure.text(from, 18.0, Anchor::Start, "head", title);
    let mut left = from;
    for image in images {
        draw_image(&mut figure, image, left, most);
        left += wide(image) + IMAGE_GAP_PX;
    }
    let (steps, bottom) = (32_u8, TOP_MARGIN_PX + CELL_SIDE_PX * tallest as f64);
    let step = (bottom - TOP_MARGIN_PX) / f64::from(steps);
    for i in 0..steps {
        let y = bottom - step * f64::from(i + 1);
        figure.coloured_rect(
            left,
            y,
            12.0,
            step + 0.2,
            &cividis_colour(f64::from(i) / f64::from(steps - 1)),
        );
    }
    figure.text(left + 16.0, bottom, Anchor::Start, "small", "0");
    figure.text(left + 16.0, TOP_MARGIN_PX + 9.0, Anchor::Start, "small", &format_number(most));
    figure.text(left, bottom + 16.0, Anchor::Start, "small dim", unit);
    for (i, remark) in remarks.iter().enumerate() {
        let at = bottom + FOOT_HEIGHT_PX - 8.0 + REMARK_HEIGHT_PX * i as f64;
        figure.text(from, at, Anchor::Start, "small", remark);
    }
    figure
}

fn draw_image(figure: &mut Figure, image: &ImagePanel, left: f64, most: f64) {
    let bottom = TOP_MARGIN_PX + CELL_SIDE_PX * image.rows as f64;
    figure.text(left, TOP_MARGIN_PX - 8.0, Anchor::Start, "small", &image.title);
    for row in 0..image.rows {
        for col in 0..image.cols {
            let index = row * image.cols + col;
            let (x, y) =
                (left + CELL_SIDE_PX * col as f64, bottom - CELL_SIDE_PX * (row + 1) as f64);
            if image.valid.get(index).copied().unwrap_or(true) {
                let count = image.counts.get(index).copied().unwrap_or(0.0);
                figure.coloured_rect(
                    x,
                    y,
                    CELL_SIDE_PX + 0.2,
                    CELL_SIDE_PX + 0.2,
                    &cividis_colour(count / most),
                );
            } else {
                figure.rect(x, y, CELL_SIDE_PX, CELL_SIDE_PX, "cell");
            }
        }
    }
    let axis = image.axis.filter(|axis| axis.x_c.is_finite() && axis.y_c.is_finite());
    if let Some(PrincipalAxis { x_c, y_c, theta_rad }) = axis {
        let (x, y) = (left + CELL_SIDE_PX * (x_c - 0.5), bottom - CELL_SIDE_PX * (y_c - 0.5));
        let (s, c) = libm::sincos(theta_rad);
        // The axis (-sin, cos), y upwards on the sensor and downwards in the picture.
        let (dx, dy) = (-s * 3.0 * CELL_SIDE_PX, -c * 3.0 * CELL_SIDE_PX);
        for class in ["markback", "mark"] {
            if theta_rad.is_finite() {
                figure.line(Point::new(x - dx, y - dy), Point::new(x + dx, y + dy), class);
            }
            figure.circle(x, y, 3.5, class);
        }
    }
    let right = left + CELL_SIDE_PX * image.cols as f64;
    figure.text(left + 2.0, bottom + 14.0, Anchor::Start, "small dim", "1");
    figure.text(0.5 * (left + right), bottom + 14.0, Anchor::Middle, "small dim", "x (column)");
    let last = format!("{}", image.cols);
    figure.text(right - 2.0, bottom + 14.0, Anchor::End, "small dim", &last);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_run_from_dark_to_bright() {
        assert_eq!(cividis_colour(0.0), "#00224e");
        assert_eq!(cividis_colour(-3.0), "#00224e");
        assert_eq!(cividis_colour(f64::NAN), "#00224e");
        assert_eq!(cividis_colour(1.0), "#fee838");
        assert_eq!(cividis_colour(7.0), "#fee838");
        let lightness = |share: f64| {
            let text = cividis_colour(share);
            let part = |i| f64::from(u8::from_str_radix(&text[i..i + 2], 16).unwrap());
            0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5)
        };
        let shares: Vec<f64> = (0..=100).map(|i| lightness(f64::from(i) / 100.0)).collect();
        assert!(shares.windows(2).all(|pair| pair[1] >= pair[0] - 0.5));
    }
}
