//! Tactile images as maps of colour: columns to the right, rows upwards, as the finger feels them.
//! Refuses to hide tactels that may not be believed: they are grey.

use super::axis::plain;
use super::svg::{Anchor, Figure};

/// One tactile image with what was read from it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Touch {
    /// What is written above it.
    pub title: String,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
    /// Counts, row by row.
    pub counts: Vec<f64>,
    /// Which tactels may be believed; all when empty.
    pub valid: Vec<bool>,
    /// Centroid in column and row numbers, and the direction of the long axis from y towards -x.
    pub axis: Option<(f64, f64, f64)>,
}

/// Colours from no load to the most: dark blue to yellow, even in lightness, told apart by people
/// who see red and green alike (cividis, Nunez, Anderton and Renslow 2018, sampled).
const RAMP: [[u8; 3]; 9] = [
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

/// The colour of a share of the largest value; outside 0..=1 the nearer end.
#[must_use]
pub fn colour(share: f64) -> String {
    let share = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
    let place = share * 8.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0..=7")]
    let index = (place.floor() as usize).min(7);
    let part = place - index as f64;
    let mut text = String::from("#");
    for (a, b) in RAMP[index].iter().zip(RAMP[index + 1]) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0..=255")]
        let value = (f64::from(*a) + part * (f64::from(b) - f64::from(*a))).round() as u8;
        text.push_str(&format!("{value:02x}"));
    }
    text
}

const CELL: f64 = 12.0;
const TOP: f64 = 44.0;
const LEFT: f64 = 30.0;
const GAP: f64 = 24.0;
const FOOT: f64 = 44.0;
/// Height of a remark.
const LINE: f64 = 17.0;

/// Images side by side on one scale of counts.
#[must_use]
pub fn heat_maps(title: &str, images: &[Touch]) -> Figure {
    maps(title, "counts", &[], LEFT, images)
}

/// [`heat_maps`] of another unit, with the rows numbered and remarks below.
#[must_use]
pub fn heat_maps_of(title: &str, unit: &str, remarks: &[String], images: &[Touch]) -> Figure {
    const ROOM: f64 = 64.0;
    let mut figure = maps(title, unit, remarks, ROOM, images);
    if let Some(first) = images.first() {
        let (place, bottom) = (ROOM - 6.0, TOP + CELL * first.rows as f64);
        let middle = 0.5 * (TOP + bottom) + 4.0;
        figure.text(place, bottom, Anchor::End, "small dim", "1");
        figure.text(place, middle, Anchor::End, "small dim", "y (row)");
        figure.text(place, TOP + 9.0, Anchor::End, "small dim", &format!("{}", first.rows));
    }
    figure
}

fn maps(title: &str, unit: &str, remarks: &[String], from: f64, images: &[Touch]) -> Figure {
    let most = images.iter().flat_map(|image| &image.counts).copied();
    let most = most.filter(|count| count.is_finite()).fold(1.0, f64::max);
    let wide = |image: &Touch| CELL * image.cols as f64;
    let width = from + images.iter().map(|image| wide(image) + GAP).sum::<f64>() + 70.0;
    let tallest = images.iter().map(|image| image.rows).max().unwrap_or(1);
    let height = TOP + CELL * tallest as f64 + FOOT + LINE * remarks.len() as f64;
    let mut figure = Figure::new(width.max(300.0), height, title);
    figure.text(from, 18.0, Anchor::Start, "head", title);
    let mut left = from;
    for image in images {
        draw(&mut figure, image, left, most);
        left += wide(image) + GAP;
    }
    let (steps, bottom) = (32_u8, TOP + CELL * tallest as f64);
    let step = (bottom - TOP) / f64::from(steps);
    for i in 0..steps {
        let y = bottom - step * f64::from(i + 1);
        figure.tile(left, y, 12.0, step + 0.2, &colour(f64::from(i) / f64::from(steps - 1)));
    }
    figure.text(left + 16.0, bottom, Anchor::Start, "small", "0");
    figure.text(left + 16.0, TOP + 9.0, Anchor::Start, "small", &plain(most));
    figure.text(left, bottom + 16.0, Anchor::Start, "small dim", unit);
    for (i, remark) in remarks.iter().enumerate() {
        let at = bottom + FOOT - 8.0 + LINE * i as f64;
        figure.text(from, at, Anchor::Start, "small", remark);
    }
    figure
}

fn draw(figure: &mut Figure, image: &Touch, left: f64, most: f64) {
    let bottom = TOP + CELL * image.rows as f64;
    figure.text(left, TOP - 8.0, Anchor::Start, "small", &image.title);
    for row in 0..image.rows {
        for col in 0..image.cols {
            let index = row * image.cols + col;
            let (x, y) = (left + CELL * col as f64, bottom - CELL * (row + 1) as f64);
            if image.valid.get(index).copied().unwrap_or(true) {
                let count = image.counts.get(index).copied().unwrap_or(0.0);
                figure.tile(x, y, CELL + 0.2, CELL + 0.2, &colour(count / most));
            } else {
                figure.rect(x, y, CELL, CELL, "cell");
            }
        }
    }
    if let Some((x_c, y_c, theta)) = image.axis.filter(|(x, y, _)| x.is_finite() && y.is_finite()) {
        let (x, y) = (left + CELL * (x_c - 0.5), bottom - CELL * (y_c - 0.5));
        let (s, c) = libm::sincos(theta);
        // The axis (-sin, cos), y upwards on the sensor and downwards in the picture.
        let (dx, dy) = (-s * 3.0 * CELL, -c * 3.0 * CELL);
        for class in ["markback", "mark"] {
            if theta.is_finite() {
                figure.line((x - dx, y - dy), (x + dx, y + dy), class);
            }
            figure.circle(x, y, 3.5, class);
        }
    }
    let right = left + CELL * image.cols as f64;
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
        assert_eq!(colour(0.0), "#00224e");
        assert_eq!(colour(-3.0), "#00224e");
        assert_eq!(colour(f64::NAN), "#00224e");
        assert_eq!(colour(1.0), "#fee838");
        assert_eq!(colour(7.0), "#fee838");
        let lightness = |share: f64| {
            let text = colour(share);
            let part = |i| f64::from(u8::from_str_radix(&text[i..i + 2], 16).unwrap());
            0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5)
        };
        let shares: Vec<f64> = (0..=100).map(|i| lightness(f64::from(i) / 100.0)).collect();
        assert!(shares.windows(2).all(|pair| pair[1] >= pair[0] - 0.5));
    }
}
