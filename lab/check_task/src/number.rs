//! Numbers of encoded values: where they stand, and how those are drawn that a law has to bear at
//! its limits.

use taktil_hal::fault::SplitMix;
use taktil_rtcore::payload::{Field, Primitive};

/// Real numbers at the limits of their kind and of what laws compute with.
const LIMIT_VALUES: [f64; 20] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    f64::MIN_POSITIVE,
    -f64::MIN_POSITIVE,
    5e-324,
    1e-12,
    1e9,
    -1e9,
    1e17,
    -1e17,
    1e154,
    1e155,
    -1e155,
    1e300,
    f64::MAX,
    -f64::MAX,
    4_294_967_296.0,
    -2_147_483_649.0,
];
/// Numbers that no port lets through.
const NOT_FINITE_VALUES: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
/// Whole numbers at the limits of every kind.
const LIMIT_NUMBERS: [i128; 16] = [
    0,
    1,
    -1,
    2,
    127,
    255,
    256,
    32_767,
    -32_768,
    65_535,
    i32::MAX as i128,
    i32::MIN as i128,
    u32::MAX as i128,
    i64::MAX as i128,
    i64::MIN as i128,
    u64::MAX as i128,
];

/// A number of a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Number {
    Real(f64),
    Whole(i128),
}

impl core::fmt::Display for Number {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Number::Real(real) => write!(f, "{real:?}"),
            Number::Whole(whole) => write!(f, "{whole}"),
        }
    }
}

/// Where the elements of a field stand in an encoded value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub(crate) offset: usize,
    pub(crate) kind: Primitive,
    pub(crate) count: usize,
}

/// The places of fields, in order.
pub(crate) fn places(fields: &[Field]) -> Vec<Place> {
    let mut end = 0_usize;
    let place = |field: &Field| {
        let offset = end.next_multiple_of(field.kind.size());
        end = field.end_after(end);
        Place { offset, kind: field.kind, count: field.count }
    };
    fields.iter().map(place).collect()
}

impl Place {
    fn range(&self, element: usize) -> core::ops::Range<usize> {
        let begin = self.offset + element * self.kind.size();
        begin..begin + self.kind.size()
    }

    /// Whether the elements are floating-point numbers.
    pub(crate) fn is_real(&self) -> bool {
        matches!(self.kind, Primitive::F64 | Primitive::F32)
    }

    /// Writes an element; a number beyond its kind becomes the nearest one of it.
    pub(crate) fn put(&self, body: &mut [u8], element: usize, number: Number) {
        let real = match number {
            Number::Real(real) => real,
            Number::Whole(whole) => whole as f64,
        };
        let whole = match number {
            Number::Real(real) => real as i128,
            Number::Whole(whole) => whole,
        };
        let f32_max = f64::from(f32::MAX);
        let narrow =
            if real.is_finite() { real.clamp(-f32_max, f32_max) as f32 } else { real as f32 };
        let out = &mut body[self.range(element)];
        macro_rules! whole {
            ($ty:ty) => {{
                let nearest = whole.clamp(<$ty>::MIN as i128, <$ty>::MAX as i128) as $ty;
                out.copy_from_slice(&nearest.to_le_bytes());
            }};
        }
        match self.kind {
            Primitive::F64 => out.copy_from_slice(&real.to_le_bytes()),
            Primitive::F32 => out.copy_from_slice(&narrow.to_le_bytes()),
            Primitive::I64 => whole!(i64),
            Primitive::U64 => whole!(u64),
            Primitive::I32 => whole!(i32),
            Primitive::U32 => whole!(u32),
            Primitive::I16 => whole!(i16),
            Primitive::U16 => whole!(u16),
            Primitive::U8 => whole!(u8),
        }
    }

    /// Reads an element.
    pub(crate) fn get(&self, body: &[u8], element: usize) -> Number {
        let bytes = &body[self.range(element)];
        macro_rules! read {
            ($ty:ty) => {
                <$ty>::from_le_bytes(bytes.try_into().unwrap_or_default())
            };
        }
        match self.kind {
            Primitive::F64 => Number::Real(read!(f64)),
            Primitive::F32 => Number::Real(f64::from(read!(f32))),
            Primitive::I64 => Number::Whole(i128::from(read!(i64))),
            Primitive::U64 => Number::Whole(i128::from(read!(u64))),
            Primitive::I32 => Number::Whole(i128::from(read!(i32))),
            Primitive::U32 => Number::Whole(i128::from(read!(u32))),
            Primitive::I16 => Number::Whole(i128::from(read!(i16))),
            Primitive::U16 => Number::Whole(i128::from(read!(u16))),
            Primitive::U8 => Number::Whole(i128::from(read!(u8))),
        }
    }

    /// Draws a number for an element: at a limit, or of any magnitude; with `not_finite` sometimes
    /// NaN or infinite.
    pub(crate) fn draw_extreme(&self, random: &mut SplitMix, not_finite: bool) -> Number {
        if !self.is_real() {
            return Number::Whole(match random.below(3) {
                0 => i128::from(random.next_u64()) - i128::from(i64::MAX),
                _ => LIMIT_NUMBERS[random.below(LIMIT_NUMBERS.len())],
            });
        }
        if not_finite && random.below(3) == 0 {
            return Number::Real(NOT_FINITE_VALUES[random.below(NOT_FINITE_VALUES.len())]);
        }
        Number::Real(match random.below(3) {
            // Every exponent is as likely as any other: the bits of a finite number.
            0 => {
                let bits = random.next_u64();
                let real = f64::from_bits(bits);
                if real.is_finite() { real } else { f64::from_bits(bits & !(1 << 62)) }
            }
            _ => LIMIT_VALUES[random.below(LIMIT_VALUES.len())],
        })
    }
}

/// Every number of an encoded value by its field: `q_rad = [0.1, 0.2], valid = 1`. Of long arrays
/// the first `elements_max` elements.
pub(crate) fn text(fields: &[Field], body: &[u8], elements_max: usize) -> String {
    let field = |(field, place): (&Field, Place)| {
        if !field.array {
            return format!("{} = {}", field.name, place.get(body, 0));
        }
        let some = (0..place.count.min(elements_max)).map(|at| place.get(body, at).to_string());
        let rest = if place.count > elements_max { ", ..." } else { "" };
        format!("{} = [{}{rest}]", field.name, some.collect::<Vec<_>>().join(", "))
    };
    fields.iter().zip(places(fields)).map(field).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIELDS: [Field; 3] = [
        Field { name: "flag", kind: Primitive::U8, count: 1, array: false },
        Field { name: "q_rad", kind: Primitive::F64, count: 3, array: true },
        Field { name: "noise", kind: Primitive::F32, count: 1, array: false },
    ];

    #[test]
    fn numbers_are_read_back_and_limited_to_their_kind() {
        let places = places(&FIELDS);
        assert_eq!(places.iter().map(|place| place.offset).collect::<Vec<_>>(), [0, 8, 32]);
        let mut body = vec![0; 36];
        places[0].put(&mut body, 0, Number::Whole(-4));
        places[1].put(&mut body, 1, Number::Real(-0.25));
        places[2].put(&mut body, 0, Number::Real(f64::MAX));
        assert_eq!(places[0].get(&body, 0), Number::Whole(0));
        assert_eq!(places[2].get(&body, 0), Number::Real(f64::from(f32::MAX)), "still finite");
        let shown = text(&FIELDS, &body, 2);
        assert_eq!(shown, "flag = 0, q_rad = [0.0, -0.25, ...], noise = 3.4028234663852886e38");
    }

    #[test]
    fn extremes_are_finite_unless_others_are_asked_for() {
        let mut random = SplitMix::new(3);
        let place = places(&FIELDS)[1];
        let mut draw = |not_finite| match place.draw_extreme(&mut random, not_finite) {
            Number::Real(real) => real,
            Number::Whole(_) => panic!("a field of real numbers"),
        };
        let finite: Vec<f64> = (0..10_000).map(|_| draw(false)).collect();
        assert!(finite.iter().all(|real| real.is_finite()));
        for limit in LIMIT_VALUES {
            assert!(finite.iter().any(|real| real.to_bits() == limit.to_bits()), "{limit}");
        }
        let mixed: Vec<f64> = (0..1000).map(|_| draw(true)).collect();
        assert!(mixed.iter().any(|real| real.is_nan()) && mixed.iter().any(|real| *real > 0.0));
    }
}
