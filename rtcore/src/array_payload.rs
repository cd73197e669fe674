//! Payloads that carry arrays whose lengths are known only when the machine is loaded, such as the
//! image of a tactile array: their records and copies are as long as the array in use.
//!
//! [`array_payload!`](macro@crate::array_payload) declares such a struct. Its boxed slices get
//! their lengths where the output or the tape is declared, and keep them: no job allocates. The
//! encoding is that of a [`Payload`] with arrays of these lengths.

use core::fmt::Debug;
use std::borrow::Cow;

use crate::payload::{Field, FieldType, Payload, Primitive, write_elements};

/// A value with arrays of lengths that are constant from load on. It flows through the ports that
/// [`crate::Ports::array_output`] and [`crate::Ports::array_input`] declare.
pub trait ArrayPayload: Debug + Send + Sized + 'static {
    /// Type name in schemas, `CamelCase`, of the usual lengths.
    const NAME: &'static str;
    /// A value, all zero, whose slices have the lengths that `length` gives for their names; `None`
    /// where it gives none. Allocates.
    fn with_lengths(length: &dyn Fn(&str) -> Option<usize>) -> Option<Self>;
    /// The type name of this value's lengths: [`ArrayPayload::NAME`] for the usual ones, with the
    /// lengths behind it for others, such as `TactileImage384x12`.
    fn type_name(&self) -> Cow<'static, str>;
    /// Fields in order, with the lengths of this value.
    fn fields(&self) -> Vec<Field>;
    /// Bytes of the encoded body.
    fn size(&self) -> usize;
    /// A value with the same lengths, all zero; allocates.
    #[must_use]
    fn zeroed(&self) -> Self;
    /// Copies `other`; an array of another length is copied as far as both reach.
    fn copy_from(&mut self, other: &Self);
    /// Whether all arrays of `other` have the lengths of this value's.
    fn has_lengths_of(&self, other: &Self) -> bool;
    /// Writes the body; `out` holds exactly [`ArrayPayload::size`] bytes, padding included.
    fn encode(&self, out: &mut [u8]);
    /// Reads a body of this value's lengths; false, and nothing changed, when it has another size.
    fn decode_into(&mut self, body: &[u8]) -> bool;
    /// False when a floating-point field is NaN or infinite.
    fn is_finite(&self) -> bool;
}

/// A value that can be read back from a record, of fixed lengths or not.
pub trait FromRecord: Sized {
    /// Reads a body that was written with these fields; `None` when it is not of this type.
    fn from_record(fields: &[Field], body: &[u8]) -> Option<Self>;
}

impl<T: Payload> FromRecord for T {
    fn from_record(_: &[Field], body: &[u8]) -> Option<T> {
        T::decode(body)
    }
}

/// A field of an array payload: a primitive, an array, or a boxed slice of primitives.
pub trait ArrayField {
    /// Element type.
    const KIND: Primitive;
    /// Whether it is an array.
    const IS_ARRAY: bool;
    /// Whether its length is known only at load.
    const IS_SLICE: bool;
    /// All zero, of this length where [`ArrayField::IS_SLICE`].
    #[must_use]
    fn of_length(length: usize) -> Self;
    /// Number of elements; 1 for a scalar.
    fn element_count(&self) -> usize;
    /// The same number of elements, all zero; allocates.
    #[must_use]
    fn zeroed(&self) -> Self;
    /// Copies the elements that both have.
    fn copy_from(&mut self, other: &Self);
    /// Writes the elements at `out[0..]`, little-endian.
    fn write_le(&self, out: &mut [u8]);
    /// Reads the elements from `body[0..]`.
    fn read_le(&mut self, body: &[u8]);
    /// False when an element is NaN or infinite.
    fn is_finite(&self) -> bool;
}

impl<T: FieldType> ArrayField for T {
    const KIND: Primitive = T::KIND;
    const IS_ARRAY: bool = T::IS_ARRAY;
    const IS_SLICE: bool = false;
    fn of_length(_: usize) -> T {
        T::ZERO
    }
    #[inline]
    fn element_count(&self) -> usize {
        T::ELEMENT_COUNT
    }
    #[inline]
    fn zeroed(&self) -> T {
        T::ZERO
    }
    #[inline]
    fn copy_from(&mut self, other: &T) {
        *self = *other;
    }
    #[inline]
    fn write_le(&self, out: &mut [u8]) {
        FieldType::write_le(self, out);
    }
    #[inline]
    fn read_le(&mut self, body: &[u8]) {
        *self = FieldType::read_le(body);
    }
    #[inline]
    fn is_finite(&self) -> bool {
        self.has_finite_elements()
    }
}

impl<T: FieldType> ArrayField for Box<[T]> {
    const KIND: Primitive = T::KIND;
    const IS_ARRAY: bool = true;
    const IS_SLICE: bool = true;
    fn of_length(length: usize) -> Box<[T]> {
        vec![T::ZERO; length].into()
    }
    #[inline]
    fn element_count(&self) -> usize {
        self.len()
    }
    fn zeroed(&self) -> Box<[T]> {
        vec![T::ZERO; self.len()].into()
    }
    #[inline]
    fn copy_from(&mut self, other: &Box<[T]>) {
        let common = self.len().min(other.len());
        self[..common].copy_from_slice(&other[..common]);
    }
    #[inline]
    fn write_le(&self, out: &mut [u8]) {
        write_elements(self, out);
    }
    #[inline]
    fn read_le(&mut self, body: &[u8]) {
        for (value, chunk) in self.iter_mut().zip(body.chunks_exact(T::KIND.size())) {
            *value = T::read_le(chunk);
        }
    }
    #[inline]
    fn is_finite(&self) -> bool {
        T::all_finite(self)
    }
}

/// The type name of a payload whose slices have these lengths: the plain one where `usual`, else
/// with each length behind it that differs from the one before.
#[doc(hidden)]
#[must_use]
pub fn name_with_lengths(name: &'static str, usual: bool, lengths: &[usize]) -> Cow<'static, str> {
    if usual {
        return name.into();
    }
    let mut distinct = lengths.to_vec();
    distinct.dedup();
    let lengths: Vec<String> = distinct.iter().map(ToString::to_string).collect();
    format!("{name}{}", lengths.join("x")).into()
}

/// Declares an [`ArrayPayload`]: a struct of primitives, arrays, and boxed slices of primitives.
/// The lengths in the braces after it are the usual ones, one for each slice in order; a value with
/// these has the plain name in schemas.
///
/// ```
/// taktil_rtcore::array_payload! {
///     /// A row of pressures.
///     pub struct Pressures {
///         /// When it was read, ns.
///         pub acquired_ns: i64,
///         /// Pressures (kPa).
///         pub pressure_kpa: Box<[f32]>,
///     }
///     usual [16]
/// }
/// use taktil_rtcore::ArrayPayload;
/// let of = |tactels: usize| Pressures { acquired_ns: 0, pressure_kpa: vec![0.0; tactels].into() };
/// assert_eq!((of(16).type_name(), of(16).size()), ("Pressures".into(), 8 + 16 * 4));
/// assert_eq!((of(20).type_name(), of(20).size()), ("Pressures20".into(), 8 + 20 * 4));
/// ```
#[macro_export]
macro_rules! array_payload {
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $($(#[$fmeta:meta])* pub $field:ident : $ty:ty),+ $(,)?
        }
        usual [$($usual:expr),* $(,)?]
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq)]
        #[allow(unreachable_pub, reason = "the payload may be declared in a private module")]
        pub struct $name { $($(#[$fmeta])* pub $field: $ty),+ }

        impl $crate::ArrayPayload for $name {
            const NAME: &'static str = stringify!($name);

            fn with_lengths(
                length: &dyn Fn(&str) -> ::core::option::Option<usize>,
            ) -> ::core::option::Option<Self> {
                Some(Self {
                    $($field: {
                        let slice = <$ty as $crate::array_payload::ArrayField>::IS_SLICE;
                        let length = if slice { length(stringify!($field))? } else { 1 };
                        <$ty as $crate::array_payload::ArrayField>::of_length(length)
                    }),+
                })
            }

            fn type_name(&self) -> ::std::borrow::Cow<'static, str> {
                let mut lengths = ::std::vec::Vec::new();
                $(if <$ty as $crate::array_payload::ArrayField>::IS_SLICE {
                    lengths.push($crate::array_payload::ArrayField::element_count(&self.$field));
                })+
                let usual: &[usize] = &[$($usual),*];
                $crate::array_payload::name_with_lengths(Self::NAME, lengths == usual, &lengths)
            }

            fn fields(&self) -> ::std::vec::Vec<$crate::payload::Field> {
                ::std::vec![$($crate::payload::Field {
                    name: stringify!($field),
                    kind: <$ty as $crate::array_payload::ArrayField>::KIND,
                    count: $crate::array_payload::ArrayField::element_count(&self.$field),
                    array: <$ty as $crate::array_payload::ArrayField>::IS_ARRAY,
                }),+]
            }

            fn size(&self) -> usize {
                let mut end = 0usize;
                $(
                    let size = <$ty as $crate::array_payload::ArrayField>::KIND.size();
                    let count = $crate::array_payload::ArrayField::element_count(&self.$field);
                    end = end.next_multiple_of(size) + size * count;
                )+
                end
            }

            fn zeroed(&self) -> Self {
                Self { $($field: $crate::array_payload::ArrayField::zeroed(&self.$field)),+ }
            }

            fn copy_from(&mut self, other: &Self) {
                $($crate::array_payload::ArrayField::copy_from(&mut self.$field, &other.$field);)+
            }

            fn has_lengths_of(&self, other: &Self) -> bool {
                true $(&& $crate::array_payload::ArrayField::element_count(&self.$field)
                    == $crate::array_payload::ArrayField::element_count(&other.$field))+
            }

            fn encode(&self, out: &mut [u8]) {
                let mut end = 0usize;
                $(
                    let size = <$ty as $crate::array_payload::ArrayField>::KIND.size();
                    let start = end.next_multiple_of(size);
                    out[end..start].fill(0);
                    end = start
                        + size * $crate::array_payload::ArrayField::element_count(&self.$field);
                    $crate::array_payload::ArrayField::write_le(
                        &self.$field,
                        &mut out[start..end],
                    );
                )+
                let _ = end;
            }

            fn decode_into(&mut self, body: &[u8]) -> bool {
                if body.len() != $crate::ArrayPayload::size(self) {
                    return false;
                }
                let mut end = 0usize;
                $(
                    let size = <$ty as $crate::array_payload::ArrayField>::KIND.size();
                    let start = end.next_multiple_of(size);
                    end = start
                        + size * $crate::array_payload::ArrayField::element_count(&self.$field);
                    $crate::array_payload::ArrayField::read_le(
                        &mut self.$field,
                        &body[start..end],
                    );
                )+
                let _ = end;
                true
            }

            fn is_finite(&self) -> bool {
                true $(&& $crate::array_payload::ArrayField::is_finite(&self.$field))+
            }
        }

        impl $crate::array_payload::FromRecord for $name {
            fn from_record(
                fields: &[$crate::payload::Field],
                body: &[u8],
            ) -> ::core::option::Option<Self> {
                let length = |name: &str| {
                    fields.iter().find(|field| field.name == name).map(|field| field.count)
                };
                let mut value = <Self as $crate::ArrayPayload>::with_lengths(&length)?;
                $crate::ArrayPayload::decode_into(&mut value, body).then_some(value)
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    crate::payload! {
        /// Fixed lengths.
        pub struct Fixed {
            /// a
            pub flag: u8,
            /// b
            pub angles: [f64; 2],
            /// c
            pub pixels: [f32; 3],
            /// d
            pub last: u16,
        }
    }

    crate::array_payload! {
        /// The same with a slice.
        pub struct Loaded {
            /// a
            pub flag: u8,
            /// b
            pub angles: [f64; 2],
            /// c
            pub pixels: Box<[f32]>,
            /// d
            pub last: u16,
        }
        usual [3]
    }

    fn loaded(pixels: &[f32]) -> Loaded {
        Loaded { flag: 3, angles: [0.5, -1.0], pixels: pixels.into(), last: 0xBEEF }
    }

    #[test]
    fn the_body_is_that_of_a_payload_with_these_lengths() {
        let fixed = Fixed { flag: 3, angles: [0.5, -1.0], pixels: [1.0, 2.0, 4.0], last: 0xBEEF };
        let value = loaded(&[1.0, 2.0, 4.0]);
        assert_eq!((value.size(), &value.fields()[..]), (Fixed::SIZE, Fixed::FIELDS));
        let (mut a, mut b) = ([0xAA; Fixed::SIZE], [0xAA; Fixed::SIZE]);
        fixed.encode(&mut a);
        value.encode(&mut b);
        assert_eq!(a, b);
        let mut read = Loaded::with_lengths(&|name| (name == "pixels").then_some(3)).unwrap();
        assert_eq!((&read, Loaded::with_lengths(&|_| None)), (&value.zeroed(), None));
        assert!(read.decode_into(&b) && !read.decode_into(&b[1..]));
        assert_eq!(read, value);
        assert_eq!(Loaded::from_record(Fixed::FIELDS, &a), Some(value));
        assert_eq!(Fixed::from_record(Fixed::FIELDS, &a), Some(fixed));
    }

    #[test]
    fn other_lengths_have_another_name_and_only_their_own_bodies() {
        let (usual, longer) = (loaded(&[0.0; 3]), loaded(&[0.0; 5]));
        assert_eq!((usual.type_name(), longer.type_name()), ("Loaded".into(), "Loaded5".into()));
        assert!(usual.has_lengths_of(&usual.zeroed()) && !usual.has_lengths_of(&longer));
        let mut body = vec![0; longer.size()];
        longer.encode(&mut body);
        assert!(!usual.zeroed().decode_into(&body));
        assert_eq!(name_with_lengths("Image", false, &[384, 384, 12]), "Image384x12");
    }

    #[test]
    fn one_number_that_is_not_finite_is_found_wherever_it_is() {
        assert!(loaded(&[1.0; 7]).is_finite());
        for at in 0..7 {
            let mut value = loaded(&[1.0; 7]);
            value.pixels[at] = f32::NAN;
            assert!(!value.is_finite(), "{at}");
        }
    }
}
