//! The values that may flow through a port: plain, fixed-size values with named fields, encoded the
//! same way everywhere.
//!
//! [`payload!`](macro@crate::payload) declares such a struct and derives its field table, so that a
//! log's schema, a report's columns and the bytes that are hashed come from one declaration. The
//! encoding is the body of a little-endian CDR message (each primitive aligned to its own size from
//! the start of the body), which is what `ros2msg` readers of MCAP files expect. There are no
//! strings, lists or pointers, nor anything else that would need the heap.

use core::fmt::Debug;

/// The primitive types of which a field may consist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names are the types")]
pub enum Primitive {
    F64,
    F32,
    I64,
    U64,
    I32,
    U32,
    I16,
    U16,
    U8,
}

impl Primitive {
    /// Every kind, for those who look one up by its name.
    pub const ALL: [Primitive; 9] = [
        Primitive::F64,
        Primitive::F32,
        Primitive::I64,
        Primitive::U64,
        Primitive::I32,
        Primitive::U32,
        Primitive::I16,
        Primitive::U16,
        Primitive::U8,
    ];

    /// Bytes of one element, which is also its alignment.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Primitive::F64 | Primitive::I64 | Primitive::U64 => 8,
            Primitive::F32 | Primitive::I32 | Primitive::U32 => 4,
            Primitive::I16 | Primitive::U16 => 2,
            Primitive::U8 => 1,
        }
    }

    /// The name in a `ros2msg` schema.
    #[must_use]
    pub const fn ros_name(self) -> &'static str {
        match self {
            Primitive::F64 => "float64",
            Primitive::F32 => "float32",
            Primitive::I64 => "int64",
            Primitive::U64 => "uint64",
            Primitive::I32 => "int32",
            Primitive::U32 => "uint32",
            Primitive::I16 => "int16",
            Primitive::U16 => "uint16",
            Primitive::U8 => "uint8",
        }
    }
}

/// One field of a payload: name (with its unit last), element type, number of elements (1 for a
/// scalar).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Name, unit last.
    pub name: &'static str,
    /// Element type.
    pub kind: Primitive,
    /// Elements; 1 for a scalar.
    pub count: usize,
    /// True for `[T; N]`, also when N is 1.
    pub array: bool,
}

impl Field {
    /// The offset just after this field when it starts at or after `offset`.
    #[must_use]
    pub const fn end_after(&self, offset: usize) -> usize {
        offset.next_multiple_of(self.kind.size()) + self.kind.size() * self.count
    }
}

/// A value that may flow through a port.
pub trait Payload: Copy + Debug + Send + 'static {
    /// Type name in schemas, `CamelCase`.
    const NAME: &'static str;
    /// Fields in order.
    const FIELDS: &'static [Field];
    /// Bytes of the encoded body.
    const SIZE: usize;
    /// All fields zero: what a reader holds before the first value arrives.
    const ZERO: Self;
    /// Writes the body; `out` holds exactly [`Payload::SIZE`] bytes, padding included.
    fn encode(&self, out: &mut [u8]);
    /// Reads a body back; `None` when the length is wrong.
    fn decode(body: &[u8]) -> Option<Self>;
    /// False when a floating-point field is NaN or infinite.
    fn is_finite(&self) -> bool;
}

/// A field type: a primitive or an array of one. Sealed in practice by the primitives listed in
/// [`Primitive`].
pub trait FieldType: Copy {
    /// Element type.
    const KIND: Primitive;
    /// Number of elements.
    const ELEMENT_COUNT: usize;
    /// Whether it is an array.
    const IS_ARRAY: bool;
    /// All zero.
    const ZERO: Self;
    /// Writes the elements at `out[0..]`, little-endian.
    fn write_le(&self, out: &mut [u8]);
    /// Reads the elements from `body[0..]`.
    fn read_le(body: &[u8]) -> Self;
    /// False when an element is NaN or infinite.
    fn has_finite_elements(&self) -> bool;
    /// Whether all elements are finite.
    #[inline]
    fn all_finite(all: &[Self]) -> bool {
        all.iter().all(Self::has_finite_elements)
    }
}

macro_rules! primitive {
    ($($ty:ty => $kind:ident, $size:literal, $numbers:ident;)*) => {$(
        impl FieldType for $ty {
            const KIND: Primitive = Primitive::$kind;
            const ELEMENT_COUNT: usize = 1;
            const IS_ARRAY: bool = false;
            const ZERO: Self = 0 as $ty;
            #[inline]
            fn write_le(&self, out: &mut [u8]) {
                // One store: a copy of slices would be a call for each element of an image.
                *out.first_chunk_mut().expect("room for an element") = self.to_le_bytes();
            }
            #[inline]
            fn read_le(body: &[u8]) -> Self {
                <$ty>::from_le_bytes(*body.first_chunk().expect("a whole element"))
            }
            primitive!($numbers, $ty);
        }
    )*};
    (whole, $ty:ty) => {
        #[inline]
        fn has_finite_elements(&self) -> bool {
            true
        }
    };
    (real, $ty:ty) => {
        #[inline]
        fn has_finite_elements(&self) -> bool {
            self.is_finite()
        }
        /// Zero times a number is NaN when the number is not finite, and so is every sum with it:
        /// two sums side by side and one comparison, without a way out in between.
        #[inline]
        fn all_finite(all: &[Self]) -> bool {
            let mut sums: [$ty; 2] = [-0.0; 2];
            let mut pairs = all.chunks_exact(2);
            for pair in &mut pairs {
                sums[0] += pair[0] * 0.0;
                sums[1] += pair[1] * 0.0;
            }
            for odd in pairs.remainder() {
                sums[0] += odd * 0.0;
            }
            !(sums[0].is_nan() | sums[1].is_nan())
        }
    };
}

primitive! {
    f64 => F64, 8, real;
    f32 => F32, 4, real;
    i64 => I64, 8, whole;
    u64 => U64, 8, whole;
    i32 => I32, 4, whole;
    u32 => U32, 4, whole;
    i16 => I16, 2, whole;
    u16 => U16, 2, whole;
    u8 => U8, 1, whole;
}

/// Writes elements one after the other, as many as there is room for.
#[inline]
pub(crate) fn write_elements<T: FieldType>(elements: &[T], out: &mut [u8]) {
    let mut chunks = out.chunks_exact_mut(T::KIND.size());
    for value in elements {
        let Some(chunk) = chunks.next() else { return };
        value.write_le(chunk);
    }
}

impl<T: FieldType, const N: usize> FieldType for [T; N] {
    const KIND: Primitive = T::KIND;
    const ELEMENT_COUNT: usize = N;
    const IS_ARRAY: bool = true;
    const ZERO: Self = [T::ZERO; N];
    #[inline]
    fn write_le(&self, out: &mut [u8]) {
        write_elements(self, out);
    }
    #[inline]
    fn read_le(body: &[u8]) -> Self {
        let mut all = Self::ZERO;
        for (value, chunk) in all.iter_mut().zip(body.chunks_exact(T::KIND.size())) {
            *value = T::read_le(chunk);
        }
        all
    }
    #[inline]
    fn has_finite_elements(&self) -> bool {
        T::all_finite(self)
    }
}

/// Total bytes of a body with these fields.
#[must_use]
pub const fn body_size(fields: &[Field]) -> usize {
    let mut offset = 0;
    let mut i = 0;
    while i < fields.len() {
        offset = fields[i].end_after(offset);
        i += 1;
    }
    offset
}

/// Declares a payload struct.
///
/// ```
/// taktil_rtcore::payload! {
///     /// Torque that a law asks for.
///     pub struct Torque {
///         /// Joint torque, N m.
///         pub tau_nm: [f64; 6],
///         /// 1 when a limit was hit.
///         pub limited: u32,
///     }
/// }
/// use taktil_rtcore::Payload;
/// assert_eq!(Torque::SIZE, 6 * 8 + 4);
/// ```
///
/// A number of elements may be left open, with a usual one: the struct of the usual number has the
/// plain name in schemas, the others (1 to 9, 12, 15, 16, 32) have the number behind it.
///
/// ```
/// taktil_rtcore::payload! {
///     /// Joint angles.
///     pub struct Angles<const N: usize = 6> {
///         /// Angles, rad.
///         pub q_rad: [f64; N],
///     }
/// }
/// use taktil_rtcore::Payload;
/// assert_eq!((<Angles>::NAME, <Angles<7>>::NAME), ("Angles", "Angles7"));
/// assert_eq!(<Angles<7>>::SIZE, 7 * 8);
/// ```
#[macro_export]
macro_rules! payload {
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $($(#[$fmeta:meta])* pub $field:ident : $ty:ty),+ $(,)?
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[allow(unreachable_pub, reason = "the payload may be declared in a private module")]
        pub struct $name { $($(#[$fmeta])* pub $field: $ty),+ }

        $crate::payload_body! {
            [] $name, stringify!($name), { $($field : $ty),+ }
        }
    };
    (
        $(#[$meta:meta])*
        pub struct $name:ident<const $n:ident: usize = $usual:literal> {
            $($(#[$fmeta:meta])* pub $field:ident : $ty:ty),+ $(,)?
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[allow(unreachable_pub, reason = "the payload may be declared in a private module")]
        pub struct $name<const $n: usize = $usual> { $($(#[$fmeta])* pub $field: $ty),+ }

        $crate::payload_body! {
            [const $n: usize] $name<$n>,
            match $n {
                n if n == $usual => stringify!($name),
                1 => concat!(stringify!($name), "1"),
                2 => concat!(stringify!($name), "2"),
                3 => concat!(stringify!($name), "3"),
                4 => concat!(stringify!($name), "4"),
                5 => concat!(stringify!($name), "5"),
                6 => concat!(stringify!($name), "6"),
                7 => concat!(stringify!($name), "7"),
                8 => concat!(stringify!($name), "8"),
                9 => concat!(stringify!($name), "9"),
                12 => concat!(stringify!($name), "12"),
                15 => concat!(stringify!($name), "15"),
                16 => concat!(stringify!($name), "16"),
                32 => concat!(stringify!($name), "32"),
                _ => panic!("a payload has 1 to 9, 12, 15, 16 or 32 elements a field of this kind"),
            },
            { $($field : $ty),+ }
        }
    };
}

/// What [`payload!`](macro@crate::payload) implements for a struct; of no use by itself.
#[doc(hidden)]
#[macro_export]
macro_rules! payload_body {
    ([$($generics:tt)*] $own:ty, $label:expr, { $($field:ident : $ty:ty),+ }) => {
        impl<$($generics)*> $crate::Payload for $own {
            const NAME: &'static str = $label;
            const FIELDS: &'static [$crate::payload::Field] = &[$($crate::payload::Field {
                name: stringify!($field),
                kind: <$ty as $crate::payload::FieldType>::KIND,
                count: <$ty as $crate::payload::FieldType>::ELEMENT_COUNT,
                array: <$ty as $crate::payload::FieldType>::IS_ARRAY,
            }),+];
            const SIZE: usize = $crate::payload::body_size(Self::FIELDS);
            const ZERO: Self = Self { $($field: <$ty as $crate::payload::FieldType>::ZERO),+ };

            fn encode(&self, out: &mut [u8]) {
                let mut end = 0usize;
                $(
                    let size = <$ty as $crate::payload::FieldType>::KIND.size();
                    let start = end.next_multiple_of(size);
                    out[end..start].fill(0);
                    end = start + size * <$ty as $crate::payload::FieldType>::ELEMENT_COUNT;
                    $crate::payload::FieldType::write_le(&self.$field, &mut out[start..end]);
                )+
                let _ = end;
            }

            fn decode(body: &[u8]) -> Option<Self> {
                if body.len() != Self::SIZE {
                    return None;
                }
                let mut end = 0usize;
                $(
                    let size = <$ty as $crate::payload::FieldType>::KIND.size();
                    let start = end.next_multiple_of(size);
                    end = start + size * <$ty as $crate::payload::FieldType>::ELEMENT_COUNT;
                    let $field = <$ty as $crate::payload::FieldType>::read_le(&body[start..end]);
                )+
                let _ = end;
                Some(Self { $($field),+ })
            }

            fn is_finite(&self) -> bool {
                true $(&& $crate::payload::FieldType::has_finite_elements(&self.$field))+
            }
        }

        impl<$($generics)*> $crate::state::Fold for $own {
            fn fold(&self, hash: &mut $crate::StateHash) {
                $($crate::state::Fold::fold(&self.$field, hash);)+
            }
        }

        impl<$($generics)*> Default for $own {
            fn default() -> Self {
                <Self as $crate::Payload>::ZERO
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    crate::payload! {
        /// Mixed alignments.
        pub struct Mixed {
            /// a
            pub flag: u8,
            /// b
            pub angles_rad: [f64; 2],
            /// c
            pub pixels: [f32; 3],
            /// d
            pub last: u16,
        }
    }

    #[test]
    fn fields_are_aligned_as_cdr_wants_and_read_back() {
        assert_eq!(Mixed::SIZE, 8 + 16 + 12 + 2);
        let value =
            Mixed { flag: 3, angles_rad: [0.5, -1.0], pixels: [1.0, 2.0, 4.0], last: 0xBEEF };
        let mut body = [0xAA; Mixed::SIZE];
        value.encode(&mut body);
        assert_eq!(&body[..8], &[3, 0, 0, 0, 0, 0, 0, 0], "padding is zero, so that hashes repeat");
        assert_eq!(body[8..16], 0.5f64.to_le_bytes());
        assert_eq!(Mixed::decode(&body), Some(value));
        assert_eq!(Mixed::decode(&body[1..]), None);
    }

    crate::payload! {
        /// A payload of any number of elements.
        pub struct Sized<const N: usize = 6> {
            /// a
            pub flag: u8,
            /// b
            pub angles_rad: [f64; N],
        }
    }

    #[test]
    fn a_payload_of_open_size_has_names_fields_and_bytes_of_its_own() {
        assert_eq!(
            (<Sized>::NAME, <Sized<7>>::NAME, <Sized<8>>::NAME),
            ("Sized", "Sized7", "Sized8")
        );
        assert_eq!((<Sized>::SIZE, <Sized<7>>::SIZE), (56, 64));
        assert_eq!((<Sized>::FIELDS[1].count, <Sized<7>>::FIELDS[1].count), (6, 7));
        let value = Sized { flag: 1, angles_rad: [0.5; 7] };
        let mut body = [0; 64];
        value.encode(&mut body);
        assert_eq!(<Sized<7>>::decode(&body), Some(value));
        assert_eq!(<Sized>::decode(&body), None, "another size is another type");
    }

    #[test]
    fn not_a_number_is_seen_in_any_element() {
        let mut value = Mixed::ZERO;
        assert!(value.is_finite());
        value.pixels[2] = f32::NAN;
        assert!(!value.is_finite());
        value.pixels[2] = 0.0;
        value.angles_rad[1] = f64::INFINITY;
        assert!(!value.is_finite());
    }

    #[test]
    fn every_place_of_an_array_counts_and_no_finite_number_is_taken_for_another() {
        let ordinary = [0.0, -0.0, f64::MAX, f64::MIN, f64::MIN_POSITIVE, 5e-324, 1.0];
        assert!(
            ordinary.has_finite_elements()
                && [f32::MAX, f32::MIN, -0.0].has_finite_elements()
                && [0.0_f64; 0].has_finite_elements()
        );
        for place in 0..ordinary.len() {
            for bad in [f64::NAN, -f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                let mut all = ordinary;
                all[place] = bad;
                assert!(!all.has_finite_elements(), "{bad} at {place}");
                let mut even = [1.0f32; 8];
                even[place] = bad as f32;
                assert!(!even.has_finite_elements(), "{bad} at {place}");
            }
        }
    }
}
