//! Finds out which keys and types a type reads, with a deserializer that answers every request with
//! a generated value and records what was requested. A schema that is made of it cannot differ from
//! the parser. A type that inspects the input before it requests a type cannot be probed.

use serde::de::value::StrDeserializer;
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, Error as _, IntoDeserializer,
    MapAccess, SeqAccess, VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;

/// The values that a key accepts.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A number; integers are numbers too.
    Number,
    /// An integer; the flag allows negative ones.
    Integer(bool),
    /// `true` or `false`.
    Boolean,
    /// Any text.
    Text,
    /// One of these words.
    Names(&'static [&'static str]),
    /// A list; of fixed length where that is given.
    List(Box<Shape>, Option<usize>),
    /// A table with arbitrary names as keys.
    Map(Box<Shape>),
    /// A table with exactly these keys.
    Section(Vec<Field>),
    /// The type decides from the input; the schema has to be stated elsewhere.
    Any,
}

/// A key of a section.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Name of the key.
    pub name: &'static str,
    /// The values that it accepts.
    pub shape: Shape,
    /// Whether the section cannot be read without the key.
    pub required: bool,
}

/// The shape of a type.
///
/// # Errors
/// The error of the type when it was given generated values.
pub fn shape<T: DeserializeOwned>() -> Result<Shape, String> {
    let mut shape = Shape::Text;
    read::<T>(&mut shape, "").map_err(|error| error.to_string())?;
    require(&mut shape, "", &|omitted| read::<T>(&mut Shape::Text, omitted).is_err());
    Ok(shape)
}

fn read<T: DeserializeOwned>(shape: &mut Shape, omitted: &str) -> Result<T, Error> {
    T::deserialize(Probe { shape, place: String::new(), omitted })
}

/// Marks the keys without which reading fails.
fn require(shape: &mut Shape, place: &str, fails_without: &dyn Fn(&str) -> bool) {
    match shape {
        Shape::List(inner, _) | Shape::Map(inner) => require(inner, place, fails_without),
        Shape::Section(fields) => {
            for field in fields {
                let place = format!("{place}/{}", field.name);
                field.required = fails_without(&place);
                require(&mut field.shape, &place, fails_without);
            }
        }
        _ => {}
    }
}

/// The error of a type that rejects generated values.
#[derive(Debug)]
struct Error(String);

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

impl serde::de::Error for Error {
    fn custom<T: std::fmt::Display>(message: T) -> Error {
        Error(message.to_string())
    }
}

/// The deserializer of one value; it records the requested type in `shape`.
struct Probe<'a> {
    shape: &'a mut Shape,
    place: String,
    omitted: &'a str,
}

impl Probe<'_> {
    /// A list of `len` generated elements, or of one element where any number is accepted.
    fn list<'de, V: Visitor<'de>>(self, len: Option<usize>, visitor: V) -> Result<V::Value, Error> {
        let mut inner = Shape::Text;
        let Probe { shape, place, omitted } = self;
        let left = len.unwrap_or(1);
        let value = visitor.visit_seq(Items { inner: &mut inner, place, omitted, left });
        *shape = Shape::List(Box::new(inner), len);
        value
    }
}

/// Answers all requests of one kind with one value.
macro_rules! answer {
    ($($ask:ident => $shape:expr, $visit:ident($value:expr);)*) => { $(
        fn $ask<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            *self.shape = $shape;
            visitor.$visit($value)
        }
    )* };
}

impl<'de> Deserializer<'de> for Probe<'_> {
    type Error = Error;

    answer! {
        deserialize_f64 => Shape::Number, visit_f64(1.0);
        deserialize_f32 => Shape::Number, visit_f32(1.0);
        deserialize_u8 => Shape::Integer(false), visit_u8(1);
        deserialize_u16 => Shape::Integer(false), visit_u16(1);
        deserialize_u32 => Shape::Integer(false), visit_u32(1);
        deserialize_u64 => Shape::Integer(false), visit_u64(1);
        deserialize_i32 => Shape::Integer(true), visit_i32(1);
        deserialize_i64 => Shape::Integer(true), visit_i64(1);
        deserialize_bool => Shape::Boolean, visit_bool(true);
        deserialize_str => Shape::Text, visit_str("name");
        deserialize_string => Shape::Text, visit_str("name");
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let Probe { shape, place, omitted } = self;
        *shape = Shape::Any;
        let mut none =
            Entries { names: &[], fields: Vec::new(), place, omitted, at: 0, whole: false };
        visitor.visit_map(&mut none)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        self.list(None, visitor)
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, len: usize, visitor: V) -> Result<V::Value, Error> {
        self.list(Some(len), visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let Probe { shape, place, omitted } = self;
        let names = &["name"];
        let mut entries = Entries { names, fields: Vec::new(), place, omitted, at: 0, whole: true };
        let value = visitor.visit_map(&mut entries);
        let inner = entries.fields.pop().map_or(Shape::Text, |field| field.shape);
        *shape = Shape::Map(Box::new(inner));
        value
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        names: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        let Probe { shape, place, omitted } = self;
        let mut entries =
            Entries { names, fields: Vec::new(), place, omitted, at: 0, whole: false };
        let value = visitor.visit_map(&mut entries);
        *shape = Shape::Section(entries.fields);
        value
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        *self.shape = Shape::Names(variants);
        visitor.visit_enum(Choice(variants.first().copied().unwrap_or_default()))
    }

    forward_to_deserialize_any! {
        i8 i16 i128 u128 char bytes byte_buf unit unit_struct tuple_struct identifier ignored_any
    }
}

/// The elements of a list.
struct Items<'a> {
    inner: &'a mut Shape,
    place: String,
    omitted: &'a str,
    left: usize,
}

impl<'de> SeqAccess<'de> for Items<'_> {
    type Error = Error;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Error> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        let (place, omitted) = (self.place.clone(), self.omitted);
        seed.deserialize(Probe { shape: self.inner, place, omitted }).map(Some)
    }
}

/// The entries of a section, or one generated entry of a map.
struct Entries<'a> {
    names: &'static [&'static str],
    fields: Vec<Field>,
    place: String,
    omitted: &'a str,
    at: usize,
    /// The names are generated, so they are not part of the place.
    whole: bool,
}

impl Entries<'_> {
    fn place_of(&self, name: &str) -> String {
        if self.whole { self.place.clone() } else { format!("{}/{name}", self.place) }
    }
}

impl<'de> MapAccess<'de> for &mut Entries<'_> {
    type Error = Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, Error> {
        if self.names.get(self.at).is_some_and(|name| self.place_of(name) == self.omitted)
            && !self.whole
        {
            self.at += 1;
        }
        let Some(name) = self.names.get(self.at) else { return Ok(None) };
        let name: StrDeserializer<'_, Error> = name.into_deserializer();
        seed.deserialize(name).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Error> {
        let name = self.names[self.at];
        self.at += 1;
        let (place, omitted, mut shape) = (self.place_of(name), self.omitted, Shape::Text);
        let value = seed.deserialize(Probe { shape: &mut shape, place, omitted });
        self.fields.push(Field { name, shape, required: false });
        value
    }
}

/// Selects the first of the words.
struct Choice(&'static str);

impl<'de> EnumAccess<'de> for Choice {
    type Error = Error;
    type Variant = Choice;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Choice), Error> {
        let name: StrDeserializer<'_, Error> = self.0.into_deserializer();
        Ok((seed.deserialize(name)?, self))
    }
}

impl<'de> VariantAccess<'de> for Choice {
    type Error = Error;

    fn unit_variant(self) -> Result<(), Error> {
        Ok(())
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, _seed: T) -> Result<T::Value, Error> {
        Err(Error::custom(format!("`{}` is more than a word", self.0)))
    }

    fn tuple_variant<V: Visitor<'de>>(self, _len: usize, _visitor: V) -> Result<V::Value, Error> {
        Err(Error::custom(format!("`{}` is more than a word", self.0)))
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        _fields: &'static [&'static str],
        _visitor: V,
    ) -> Result<V::Value, Error> {
        Err(Error::custom(format!("`{}` is more than a word", self.0)))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Deserialize;

    use super::*;

    #[derive(Deserialize)]
    #[allow(dead_code, reason = "only its shape matters")]
    struct Outer {
        a: f64,
        #[serde(default)]
        b: Vec<Inner>,
        c: Option<[i64; 3]>,
        d: BTreeMap<String, u32>,
    }

    #[derive(Deserialize)]
    #[allow(dead_code, reason = "only its shape matters")]
    struct Inner {
        kind: Kind,
        name: Option<String>,
    }

    #[derive(Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Kind {
        Red,
        Green,
    }

    #[test]
    fn the_keys_of_a_type_and_the_required_ones_are_found() {
        let Ok(Shape::Section(fields)) = shape::<Outer>() else { panic!("a section") };
        let seen: Vec<_> = fields.iter().map(|f| (f.name, f.required)).collect();
        assert_eq!(seen, [("a", true), ("b", false), ("c", false), ("d", true)]);
        assert_eq!(fields[2].shape, Shape::List(Box::new(Shape::Integer(true)), Some(3)));
        assert_eq!(fields[3].shape, Shape::Map(Box::new(Shape::Integer(false))));
        let inner = |name, shape, required| Field { name, shape, required };
        let kind = inner("kind", Shape::Names(&["red", "green"]), true);
        let due = Shape::Section(vec![kind, inner("name", Shape::Text, false)]);
        assert_eq!(fields[1].shape, Shape::List(Box::new(due), None));
    }
}
