//! Computes scales of axes and their ticks: steps of 1, 2 or 5 times a power of ten on linear axes,
//! powers of ten on logarithmic ones. A range of a single value is widened before it becomes a
//! scale.

/// A range of values that is shown on a length in px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Value at `from_px`.
    pub low: f64,
    /// Value at `to_px`.
    pub high: f64,
    /// Place of `low`.
    pub from_px: f64,
    /// Place of `high`.
    pub to_px: f64,
}

impl Scale {
    /// The position of a value on the scale (px); NaN for NaN.
    #[must_use]
    pub fn position_px(&self, value: f64) -> f64 {
        let share = (value - self.low) / (self.high - self.low);
        self.from_px + share * (self.to_px - self.from_px)
    }

    /// The position of a value (px), clamped to the ends of the scale.
    #[must_use]
    pub fn clamped_position_px(&self, value: f64) -> f64 {
        let (low, high) = (self.from_px.min(self.to_px), self.from_px.max(self.to_px));
        self.position_px(value).clamp(low, high)
    }
}

/// A labelled position on an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// Value.
    pub value: f64,
    /// Text.
    pub label: String,
}

/// The smallest and largest finite value; `None` when there is none.
#[must_use]
pub fn finite_range(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    values.into_iter().filter(|value| value.is_finite()).fold(None, |span, value| match span {
        None => Some((value, value)),
        Some((low, high)) => Some((low.min(value), high.max(value))),
    })
}

/// A range with a margin on both sides; it is never empty.
#[must_use]
pub fn padded_range(low: f64, high: f64) -> (f64, f64) {
    let (low, high) = (low.clamp(-1e300, 1e300), high.clamp(-1e300, 1e300));
    let smallest = 1e-9 * low.abs().max(high.abs());
    if high - low > smallest {
        let room = 0.06 * (high - low);
        return (low - room, high + room);
    }
    let room = if low == 0.0 { 1.0 } else { 0.02 * low.abs() };
    (low - room, high + room)
}

/// The step, 1, 2 or 5 times a power of ten, that divides a range into about `wanted` parts, and
/// the number of decimals that its multiples need.
fn tick_step(width: f64, wanted: f64) -> (f64, i32) {
    let rough = width / wanted;
    let exponent = libm::floor(libm::log10(rough));
    let power = libm::pow(10.0, exponent);
    let lead = rough / power;
    let (factor, carry) = match lead {
        lead if lead < 1.4 => (1.0, 0),
        lead if lead < 3.2 => (2.0, 0),
        lead if lead < 7.1 => (5.0, 0),
        _ => (1.0, 1),
    };
    #[expect(clippy::cast_possible_truncation, reason = "a decimal exponent of an f64")]
    let exponent = exponent as i32 + carry;
    (factor * libm::pow(10.0, f64::from(exponent)), -exponent)
}

/// Ticks on a linear axis, about `wanted` of them, inside `low..=high`.
#[must_use]
pub fn linear_ticks(low: f64, high: f64, wanted: f64) -> Vec<Tick> {
    let width = high - low;
    if !(width > 0.0 && width.is_finite()) {
        return Vec::new();
    }
    let (step, decimals) = tick_step(width, wanted);
    let first = libm::ceil(low / step - 1e-9);
    let mut out = Vec::new();
    let mut n = first;
    while n * step <= high + 1e-9 * width && out.len() < 100 {
        let value = n * step;
        out.push(Tick { value, label: tick_label(value, decimals) });
        n += 1.0;
    }
    out
}

/// A number with the given decimals; very large and very small numbers with a power of ten.
fn tick_label(value: f64, decimals: i32) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    if value.abs() >= 1e7 || decimals > 6 {
        return format!("{value:.2e}");
    }
    let decimals = usize::try_from(decimals).unwrap_or(0);
    format!("{value:.decimals$}")
}

/// Powers of ten inside `low..=high`, both above 0, thinned to about `wanted`.
#[must_use]
pub fn decade_ticks(low: f64, high: f64, wanted: f64) -> Vec<Tick> {
    if !(low > 0.0 && high > low && high.is_finite()) {
        return Vec::new();
    }
    let first = libm::ceil(libm::log10(low) - 1e-9);
    let last = libm::floor(libm::log10(high) + 1e-9);
    let stride = libm::ceil((last - first) / wanted).max(1.0);
    let mut out = Vec::new();
    let mut n = first;
    while n <= last {
        let value = libm::pow(10.0, n);
        let label =
            if (-3.0..=6.0).contains(&n) { format_number(value) } else { format!("{value:.0e}") };
        out.push(Tick { value, label });
        n += stride;
    }
    out
}

/// A number as text for people: three or four significant digits, no trailing zeros.
#[must_use]
pub fn format_number(value: f64) -> String {
    if !value.is_finite() {
        return "\u{2013}".to_owned();
    }
    let size = value.abs();
    let decimals = match size {
        size if size >= 1000.0 => 0_u8,
        size if size >= 100.0 => 1,
        size if size >= 10.0 => 2,
        size if size >= 0.1 => 3,
        size if size >= 0.01 => 4,
        size if size >= 0.001 => 5,
        size if size >= 1e-6 || size == 0.0 => 6,
        _ => return format!("{value:.2e}"),
    };
    format_fixed(value, f64::from(decimals))
}

/// A number with at most the given decimals (0 to 9), without trailing zeros and without minus
/// zero.
#[must_use]
pub fn format_fixed(value: f64, decimals: f64) -> String {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0..=9")]
    let decimals = decimals.clamp(0.0, 9.0) as usize;
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    };
    if text == "-0" { "0".to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &[Tick]) -> Vec<&str> {
        ticks.iter().map(|tick| tick.label.as_str()).collect()
    }

    #[test]
    fn ticks_have_round_steps_and_as_many_decimals_as_they_need() {
        assert_eq!(labels(&linear_ticks(0.0, 10.0, 5.0)), ["0", "2", "4", "6", "8", "10"]);
        let small = labels(&linear_ticks(-0.011, 0.012, 4.0)).join(" ");
        assert_eq!(small, "-0.010 -0.005 0 0.005 0.010");
        assert_eq!(labels(&linear_ticks(308.0, 342.0, 4.0)), ["310", "320", "330", "340"]);
        assert_eq!(labels(&linear_ticks(-149.6, -148.2, 3.0)), ["-149.5", "-149.0", "-148.5"]);
        assert!(linear_ticks(1.0, 1.0, 5.0).is_empty());
        assert!(linear_ticks(f64::NAN, 1.0, 5.0).is_empty());
        assert!(linear_ticks(0.0, f64::INFINITY, 5.0).is_empty());
        assert!(linear_ticks(1e300, 1.0000001e300, 5.0).len() < 100);
    }

    #[test]
    fn decades_and_plain_numbers() {
        assert_eq!(labels(&decade_ticks(0.5, 2000.0, 8.0)), ["1", "10", "100", "1000"]);
        assert!(decade_ticks(0.0, 1.0, 5.0).is_empty());
        for (value, text) in [(15000.0, "15000"), (3.25, "3.25"), (0.0, "0"), (-1e-9, "-1.00e-9")] {
            assert_eq!(format_number(value), text);
        }
        assert_eq!(format_number(170.123), "170.1");
        assert_eq!(format_number(f64::NAN), "\u{2013}");
    }

    #[test]
    fn spans_are_never_empty() {
        assert_eq!(finite_range([f64::NAN, 2.0, f64::INFINITY, -1.0]), Some((-1.0, 2.0)));
        assert_eq!(finite_range([f64::NAN]), None);
        for (low, high) in [(0.0, 0.0), (5.0, 5.0), (-1e308, 1e308), (1.0, 1.0 + 1e-15)] {
            let (a, b) = padded_range(low, high);
            assert!(b > a && a.is_finite() && b.is_finite(), "{low} {high}: {a} {b}");
        }
    }
}
