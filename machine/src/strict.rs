//! Reads configuration strictly: a list of fixed length has to be used up, and a table is no list.
//! The visitors that `serde` derives leave what follows the last element to the format, and the
//! reader of TOML drops it; they also take a list for the fields of a structure, in their order.

use std::fmt;

use serde::de::{
    Deserialize, DeserializeSeed, Deserializer, EnumAccess, Error, IgnoredAny, MapAccess,
    SeqAccess, Unexpected, VariantAccess, Visitor,
};

/// Reads a value.
///
/// # Errors
/// What the deserializer complains of; a list that is longer than what is made of it; a list where
/// a table is meant.
pub fn read<'de, T: Deserialize<'de>, D: Deserializer<'de>>(source: D) -> Result<T, D::Error> {
    T::deserialize(Strict(source))
}

/// Whatever reads or is read, with strict lists below it.
struct Strict<T>(T);

/// A visitor with strict lists below it.
struct StrictVisitor<V> {
    visitor: V,
    /// Whether a structure with named fields is read.
    is_structure: bool,
}

/// A list of which the elements are counted.
struct CountedSeq<'a, A> {
    list: &'a mut A,
    count: usize,
}

impl<V> StrictVisitor<V> {
    fn new(visitor: V) -> StrictVisitor<V> {
        StrictVisitor { visitor, is_structure: false }
    }

    fn of_structure(visitor: V) -> StrictVisitor<V> {
        StrictVisitor { visitor, is_structure: true }
    }
}

/// The methods of a deserializer that take nothing but a visitor.
macro_rules! deserialize {
    ($($method:ident)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, D::Error> {
            self.0.$method(StrictVisitor::new(visitor))
        })*
    };
}

impl<'de, D: Deserializer<'de>> Deserializer<'de> for Strict<D> {
    type Error = D::Error;

    deserialize! {
        deserialize_any deserialize_bool deserialize_char deserialize_str deserialize_string
        deserialize_i8 deserialize_i16 deserialize_i32 deserialize_i64 deserialize_i128
        deserialize_u8 deserialize_u16 deserialize_u32 deserialize_u64 deserialize_u128
        deserialize_f32 deserialize_f64 deserialize_bytes deserialize_byte_buf deserialize_option
        deserialize_unit deserialize_seq deserialize_map deserialize_identifier
        deserialize_ignored_any
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        self.0.deserialize_unit_struct(name, StrictVisitor::new(visitor))
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        self.0.deserialize_newtype_struct(name, StrictVisitor::new(visitor))
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        self.0.deserialize_tuple(length, StrictVisitor::new(visitor))
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        self.0.deserialize_tuple_struct(name, length, StrictVisitor::new(visitor))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        self.0.deserialize_struct(name, fields, StrictVisitor::of_structure(visitor))
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        self.0.deserialize_enum(name, variants, StrictVisitor::new(visitor))
    }

    fn is_human_readable(&self) -> bool {
        self.0.is_human_readable()
    }
}

/// The methods of a visitor that take one value with nothing below it.
macro_rules! visit {
    ($($method:ident: $value:ty),* $(,)?) => {
        $(fn $method<E: Error>(self, value: $value) -> Result<V::Value, E> {
            self.visitor.$method(value)
        })*
    };
}

impl<'de, V: Visitor<'de>> Visitor<'de> for StrictVisitor<V> {
    type Value = V::Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.visitor.expecting(f)
    }

    visit! {
        visit_bool: bool, visit_char: char,
        visit_i8: i8, visit_i16: i16, visit_i32: i32, visit_i64: i64, visit_i128: i128,
        visit_u8: u8, visit_u16: u16, visit_u32: u32, visit_u64: u64, visit_u128: u128,
        visit_f32: f32, visit_f64: f64,
        visit_str: &str, visit_borrowed_str: &'de str, visit_string: String,
        visit_bytes: &[u8], visit_borrowed_bytes: &'de [u8], visit_byte_buf: Vec<u8>,
    }

    fn visit_none<E: Error>(self) -> Result<V::Value, E> {
        self.visitor.visit_none()
    }

    fn visit_unit<E: Error>(self) -> Result<V::Value, E> {
        self.visitor.visit_unit()
    }

    fn visit_some<D: Deserializer<'de>>(self, source: D) -> Result<V::Value, D::Error> {
        self.visitor.visit_some(Strict(source))
    }

    fn visit_newtype_struct<D: Deserializer<'de>>(self, source: D) -> Result<V::Value, D::Error> {
        self.visitor.visit_newtype_struct(Strict(source))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<V::Value, A::Error> {
        if self.is_structure {
            return Err(A::Error::invalid_type(Unexpected::Seq, &"a table"));
        }
        let mut counted = CountedSeq { list: &mut list, count: 0 };
        let value = self.visitor.visit_seq(&mut counted)?;
        let wanted = counted.count;
        let mut length = wanted;
        while list.next_element::<IgnoredAny>()?.is_some() {
            length += 1;
        }
        if length > wanted {
            return Err(A::Error::invalid_length(
                length,
                &&*format!("an array of length {wanted}"),
            ));
        }
        Ok(value)
    }

    fn visit_map<A: MapAccess<'de>>(self, table: A) -> Result<V::Value, A::Error> {
        self.visitor.visit_map(Strict(table))
    }

    fn visit_enum<A: EnumAccess<'de>>(self, variant: A) -> Result<V::Value, A::Error> {
        self.visitor.visit_enum(Strict(variant))
    }
}

impl<'de, S: DeserializeSeed<'de>> DeserializeSeed<'de> for Strict<S> {
    type Value = S::Value;

    fn deserialize<D: Deserializer<'de>>(self, source: D) -> Result<S::Value, D::Error> {
        self.0.deserialize(Strict(source))
    }
}

impl<'de, A: SeqAccess<'de>> SeqAccess<'de> for CountedSeq<'_, A> {
    type Error = A::Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, A::Error> {
        let element = self.list.next_element_seed(Strict(seed))?;
        self.count += usize::from(element.is_some());
        Ok(element)
    }

    fn size_hint(&self) -> Option<usize> {
        self.list.size_hint()
    }
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for Strict<A> {
    type Error = A::Error;

    fn next_key_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, A::Error> {
        self.0.next_key_seed(seed)
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, A::Error> {
        self.0.next_value_seed(Strict(seed))
    }

    fn size_hint(&self) -> Option<usize> {
        self.0.size_hint()
    }
}

impl<'de, A: EnumAccess<'de>> EnumAccess<'de> for Strict<A> {
    type Error = A::Error;
    type Variant = Strict<A::Variant>;

    fn variant_seed<S: DeserializeSeed<'de>>(
        self,
        seed: S,
    ) -> Result<(S::Value, Self::Variant), A::Error> {
        self.0.variant_seed(seed).map(|(name, variant)| (name, Strict(variant)))
    }
}

impl<'de, A: VariantAccess<'de>> VariantAccess<'de> for Strict<A> {
    type Error = A::Error;

    fn unit_variant(self) -> Result<(), A::Error> {
        self.0.unit_variant()
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, A::Error> {
        self.0.newtype_variant_seed(Strict(seed))
    }

    fn tuple_variant<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, A::Error> {
        self.0.tuple_variant(length, StrictVisitor::new(visitor))
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, A::Error> {
        self.0.struct_variant(fields, StrictVisitor::of_structure(visitor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Place {
        p_mm: [f64; 3],
        pair: Option<(f64, String)>,
        #[serde(default)]
        rows: Vec<[f64; 2]>,
        #[serde(default)]
        named: BTreeMap<String, [u8; 2]>,
        #[serde(default)]
        shape: Shape,
        inner: Option<Box<Place>>,
    }

    #[derive(Debug, Default, PartialEq, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Shape {
        #[default]
        Plane,
        Box([f64; 3]),
        Ball {
            at_mm: [f64; 3],
        },
    }

    fn refusal<T: serde::de::DeserializeOwned>(text: &str) -> Option<String> {
        let source = toml::Deserializer::parse(text).unwrap();
        let of_text = read::<T, _>(source).err().map(|bad| bad.message().to_owned());
        let table: toml::Table = toml::from_str(text).unwrap();
        let of_table = read::<T, _>(table).err();
        assert_eq!(of_text.is_some(), of_table.is_some(), "{text}: {of_text:?}, {of_table:?}");
        of_text
    }

    #[test]
    fn lists_are_used_up_wherever_they_stand() {
        for (text, length) in [
            ("p_mm = [1, 2, 3, 4]", "4, expected an array of length 3"),
            ("p_mm = [1, 2, 3]\npair = [1.0, \"a\", 2]", "3, expected an array of length 2"),
            ("p_mm = [1, 2, 3]\nrows = [[1, 2], [1, 2, 3]]", "3, expected an array of length 2"),
            ("p_mm = [1, 2, 3]\nnamed.a = [1, 2, 3, 4]", "4, expected an array of length 2"),
            ("p_mm = [1, 2, 3]\nshape.box = [1, 2, 3, 4]", "4, expected an array of length 3"),
            ("p_mm = [1, 2, 3]\nshape.ball.at_mm = [1, 2, 3, 4]", "4, expected an array of"),
            ("p_mm = [1, 2, 3]\ninner.p_mm = [1, 2, 3, 4]", "4, expected an array of length 3"),
            ("p_mm = [1, 2]", "2, expected an array of length 3"),
        ] {
            let said = refusal::<Place>(text).unwrap_or_else(|| panic!("{text} was read"));
            assert!(said.contains(&format!("invalid length {length}")), "{text}: {said}");
        }
    }

    #[test]
    fn a_list_is_no_table() {
        for text in
            ["p_mm = [1, 2, 3]\ninner = [[1, 2, 3]]", "p_mm = [1, 2, 3]\nshape.ball = [[1, 2, 3]]"]
        {
            let said = refusal::<Place>(text).unwrap_or_else(|| panic!("{text} was read"));
            assert!(said.contains("invalid type"), "{text}: {said}");
        }
    }

    #[test]
    fn what_fits_is_read_as_it_was() {
        let text = "p_mm = [1, 2, 3]\npair = [1.5, \"a\"]\nrows = [[1, 2]]\nnamed.a = [1, 2]\n\
                    shape.ball.at_mm = [1, 2, 3]\n[inner]\np_mm = [4, 5, 6]\nshape = \"plane\"\n";
        let plain: Place = toml::from_str(text).unwrap();
        assert_eq!(read::<Place, _>(toml::Deserializer::parse(text).unwrap()).unwrap(), plain);
        assert_eq!(plain.inner.unwrap().p_mm, [4.0, 5.0, 6.0]);
    }
}
