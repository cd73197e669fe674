//! Writes the few SVG elements that pictures consist of.
//!
//! The same log yields the same bytes: coordinates have one decimal, and colours are names of
//! classes. A picture in a file of its own carries its style sheet and a white background. Inside a
//! report the page provides the style sheet, for light and for dark displays.

use std::fmt::Write;

/// Number of colours for lines and bars, classes `s0`.. and `f0`...
pub const COLOUR_COUNT: usize = 6;

/// Style sheet of a picture on white. The colours of lines and bars are those of Okabe and Ito
/// (2008), which people with red-green colour blindness can distinguish.
pub const LIGHT_STYLE: &str = "\
.fig text{font:12px system-ui,'Segoe UI',Helvetica,Arial,sans-serif;fill:#1a1a1a}\
.fig .paper{fill:#ffffff}.fig .head{font-weight:600;font-size:13px}.fig .name{font-weight:600}\
.fig .dim{fill:#595959}.fig .small{font-size:11px}.fig .strip{font-size:10px}\
.fig .axis{stroke:#4d4d4d;fill:none}.fig .grid{stroke:#e4e4e4;fill:none}\
.fig .level{stroke:#6b6b6b;stroke-dasharray:5 4;fill:none}\
.fig .band{fill:#e69f00;fill-opacity:.16}.fig .cell{fill:#8a8a8a}\
.fig .state0{fill:#ececec}.fig .state1{fill:#d6e6f2}\
.fig .mark{stroke:#ffffff;stroke-width:2;fill:none}\
.fig .markback{stroke:#000000;stroke-width:4;fill:none}\
.fig .tile{shape-rendering:crispEdges}\
.fig .line{fill:none;stroke-width:1.2;stroke-linejoin:round}\
.fig .s0{stroke:#0072b2}.fig .s1{stroke:#d55e00}.fig .s2{stroke:#009e73}.fig .s3{stroke:#b8558f}\
.fig .s4{stroke:#c98500}.fig .s5{stroke:#3a9bd9}\
.fig .f0{fill:#0072b2}.fig .f1{fill:#d55e00}.fig .f2{fill:#009e73}.fig .f3{fill:#b8558f}\
.fig .f4{fill:#c98500}.fig .f5{fill:#3a9bd9}.fig .dash{stroke-dasharray:6 3}\
.fig .key{stroke-width:2}";

/// Rules that replace those of [`LIGHT_STYLE`] on a dark page.
pub const DARK_STYLE: &str = "\
.fig text{fill:#e8e8e8}.fig .paper{fill:#16181c}.fig .dim{fill:#a9adb3}.fig .axis{stroke:#9a9ea5}\
.fig .grid{stroke:#2b2f36}.fig .level{stroke:#9a9ea5}.fig .band{fill-opacity:.2}\
.fig .state0{fill:#24272d}.fig .state1{fill:#1d3a50}\
.fig .s0{stroke:#56b4e9}.fig .s1{stroke:#ff8a4c}.fig .s2{stroke:#2fc79b}.fig .s3{stroke:#e79ac6}\
.fig .s4{stroke:#f0b73f}.fig .s5{stroke:#9bd3f5}\
.fig .f0{fill:#56b4e9}.fig .f1{fill:#ff8a4c}.fig .f2{fill:#2fc79b}.fig .f3{fill:#e79ac6}\
.fig .f4{fill:#f0b73f}.fig .f5{fill:#9bd3f5}";

/// Which part of a text stands at its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// The point is its left end.
    Start,
    /// The point is its middle.
    Middle,
    /// The point is its right end.
    End,
}

/// A point of a picture (px), y downwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Distance from the left edge.
    pub x: f64,
    /// Distance from the upper edge.
    pub y: f64,
}

impl Point {
    /// The point at `x` and `y` (px).
    #[must_use]
    pub const fn new(x: f64, y: f64) -> Point {
        Point { x, y }
    }
}

/// A picture to which elements are appended; lengths in px, y downwards.
#[derive(Clone, Debug)]
pub struct Figure {
    width: f64,
    height: f64,
    about: String,
    body: String,
}

impl Figure {
    /// An empty picture; screen readers read out `about`.
    #[must_use]
    pub fn new(width: f64, height: f64, about: &str) -> Figure {
        let mut figure = Figure { width, height, about: about.to_owned(), body: String::new() };
        figure.rect(0.0, 0.0, width, height, "paper");
        figure
    }

    /// Width (px).
    #[must_use]
    pub fn width(&self) -> f64 {
        self.width
    }

    /// Height (px).
    #[must_use]
    pub fn height(&self) -> f64 {
        self.height
    }

    /// Appends a filled rectangle.
    pub fn rect(&mut self, x: f64, y: f64, width: f64, height: f64, class: &str) {
        let (x, y, width, height) =
            (coordinate(x), coordinate(y), coordinate(width), coordinate(height));
        self.append(&format!(
            "<rect class=\"{class}\" x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\"/>\n"
        ));
    }

    /// Appends a filled rectangle with an explicit colour (`#rrggbb`).
    pub fn coloured_rect(&mut self, x: f64, y: f64, width: f64, height: f64, colour: &str) {
        let (x, y, width, height) =
            (coordinate(x), coordinate(y), coordinate(width), coordinate(height));
        self.append(&format!(
            "<rect class=\"tile\" x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" \
             fill=\"{colour}\"/>\n"
        ));
    }

    /// Appends a straight line.
    pub fn line(&mut self, from: Point, to: Point, class: &str) {
        let (x1, y1, x2, y2) =
            (coordinate(from.x), coordinate(from.y), coordinate(to.x), coordinate(to.y));
        self.append(&format!(
            "<line class=\"{class}\" x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\"/>\n"
        ));
    }

    /// Appends a circle.
    pub fn circle(&mut self, x: f64, y: f64, radius: f64, class: &str) {
        let (x, y, radius) = (coordinate(x), coordinate(y), coordinate(radius));
        self.append(&format!("<circle class=\"{class}\" cx=\"{x}\" cy=\"{y}\" r=\"{radius}\"/>\n"));
    }

    /// Appends a text on one line.
    pub fn text(&mut self, x: f64, y: f64, anchor: Anchor, class: &str, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let (x, y, text) = (coordinate(x), coordinate(y), escape(text));
        self.append(&format!(
            "<text class=\"{class}\" x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\">{text}</text>\n"
        ));
    }

    /// Appends line segments through points; a point that is not finite interrupts the line.
    pub fn polyline(&mut self, points: &[Point], class: &str) {
        let mut d = String::new();
        let mut pen_down = false;
        for &Point { x, y } in points {
            if !(x.is_finite() && y.is_finite()) {
                pen_down = false;
                continue;
            }
            let letter = if pen_down { 'L' } else { 'M' };
            // Writing to a String cannot fail.
            let _ = write!(d, "{letter}{} {}", coordinate(x), coordinate(y));
            pen_down = true;
        }
        if !d.is_empty() {
            self.append(&format!("<path class=\"{class}\" d=\"{d}\"/>\n"));
        }
    }

    /// Appends another picture with its top left corner at `x`, `y`.
    pub fn embed(&mut self, x: f64, y: f64, figure: &Figure) {
        let (x, y, body) = (coordinate(x), coordinate(y), &figure.body);
        self.append(&format!("<g transform=\"translate({x} {y})\">\n{body}</g>\n"));
    }

    fn append(&mut self, element: &str) {
        self.body.push_str(element);
    }

    fn opening_tag(&self) -> String {
        let (width, height) = (coordinate(self.width), coordinate(self.height));
        let about = escape(&self.about);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"fig\" \
             viewBox=\"0 0 {width} {height}\" \
             width=\"{width}\" height=\"{height}\" role=\"img\">\n<title>{about}</title>\n"
        )
    }

    /// The picture as a complete SVG document.
    #[must_use]
    pub fn svg_document(&self) -> String {
        let (open, body) = (self.opening_tag(), &self.body);
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{open}<style>{LIGHT_STYLE}</style>\n\
             {body}</svg>\n"
        )
    }

    /// The picture as a fragment of a page that has [`LIGHT_STYLE`] and [`DARK_STYLE`] in its style
    /// sheet.
    #[must_use]
    pub fn svg_fragment(&self) -> String {
        let (open, body) = (self.opening_tag(), &self.body);
        format!("{open}{body}</svg>\n")
    }
}

/// A coordinate as text with at most one decimal; a value that is not finite becomes 0.
fn coordinate(x: f64) -> String {
    let tenths = if x.is_finite() { (x * 10.0).round() } else { 0.0 };
    let rounded = tenths / 10.0;
    // Adding 0 turns -0 into 0.
    format!("{}", rounded + 0.0)
}

/// The text with escaped markup, for use between tags and inside quotes; control characters, which
/// are invalid in XML, become spaces.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(c),
            c if c.is_control() || matches!(c, '\u{FFFE}' | '\u{FFFF}') => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_short_and_never_minus_zero() {
        assert_eq!(coordinate(12.0), "12");
        assert_eq!(coordinate(12.345), "12.3");
        assert_eq!(coordinate(-0.01), "0");
        assert_eq!(coordinate(f64::NAN), "0");
    }

    #[test]
    fn strips_break_where_a_point_is_missing() {
        let mut figure = Figure::new(10.0, 10.0, "a < b");
        let points = [(0.0, 0.0), (1.0, 1.0), (2.0, f64::NAN), (3.0, 3.0)];
        figure.polyline(&points.map(|(x, y)| Point::new(x, y)), "line s0");
        figure.polyline(&[Point::new(f64::NAN, 0.0)], "line s1");
        let text = figure.svg_document();
        assert!(text.contains("d=\"M0 0L1 1M3 3\""));
        assert!(!text.contains("line s1"));
        assert!(text.contains("<title>a &lt; b</title>"));
        assert_eq!(escape("\u{1}x\u{0}"), " x ");
    }
}
