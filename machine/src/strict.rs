//! Reads configuration strictly: a list of fixed length has to be used up, and a table is no list.
//! The visitors that `serde` derives leave what follows the last element to the format, and the
//! reader of TOML drops it; they also take a list for the fields of a structure, in their order.
//!
//! Texts and tables are read by one deserializer, `Item`, which is no generic type: each type of
//! configuration is compiled for it once, wherever its values come from.

use std::fmt;
use std::ops::Range;

use serde::de::value::StringDeserializer;
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, Error as _, IntoDeserializer,
    MapAccess, SeqAccess, Unexpected, VariantAccess, Visitor,
};
use toml::Value;
use toml::de::{DeTable, DeValue};
use toml::value::Datetime;

/// The key under which the types of `toml` look for a date.
const DATE_KEY: &str = "$__toml_private_datetime";

/// What is wrong with a configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadError {
    message: String,
    span: Option<Range<usize>>,
}

impl ReadError {
    /// What is wrong, on one line or several.
    #[must_use]
    pub fn message(&self) -> &str {
        &self.message
    }

    /// The bytes of the text that are wrong; nothing for a table that has no text.
    #[must_use]
    pub fn span(&self) -> Option<Range<usize>> {
        self.span.clone()
    }

    /// The same error, at these bytes unless it has a place.
    fn at(mut self, span: &Option<Range<usize>>) -> ReadError {
        if self.span.is_none() {
            self.span.clone_from(span);
        }
        self
    }
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for ReadError {}

impl serde::de::Error for ReadError {
    fn custom<T: fmt::Display>(message: T) -> ReadError {
        ReadError { message: message.to_string(), span: None }
    }
}

impl From<toml::de::Error> for ReadError {
    fn from(error: toml::de::Error) -> ReadError {
        ReadError { message: error.message().to_owned(), span: error.span() }
    }
}

/// Reads a text.
///
/// # Errors
/// What is no TOML; what does not fit the type; a list that is longer than what is made of it; a
/// list where a table is meant.
pub fn read_text<T: DeserializeOwned>(text: &str) -> Result<T, ReadError> {
    T::deserialize(Item::of_text(text)?)
}

/// Reads a value that was read before.
///
/// # Errors
/// As [`read_text`], without places in a text.
pub fn read_value<T: DeserializeOwned>(value: Value) -> Result<T, ReadError> {
    T::deserialize(Item::of_value(value))
}

/// A value, and the bytes of the text in which it stands.
struct Item {
    node: Node,
    span: Option<Range<usize>>,
}

/// What a value is.
enum Node {
    Text(String),
    Integer(i128),
    Float(f64),
    Boolean(bool),
    Date(Datetime),
    List(Vec<Item>),
    Table(Vec<(Key, Item)>),
}

/// The name of a value in a table.
struct Key {
    name: String,
    span: Option<Range<usize>>,
}

impl Item {
    fn of_text(text: &str) -> Result<Item, ReadError> {
        let table = DeTable::parse(text)?;
        let span = Some(table.span());
        Ok(Item { node: Node::of_text(DeValue::Table(table.into_inner()), &span)?, span })
    }

    fn of_value(value: Value) -> Item {
        let node = match value {
            Value::String(text) => Node::Text(text),
            Value::Integer(number) => Node::Integer(i128::from(number)),
            Value::Float(number) => Node::Float(number),
            Value::Boolean(truth) => Node::Boolean(truth),
            Value::Datetime(date) => Node::Date(date),
            Value::Array(list) => Node::List(list.into_iter().map(Item::of_value).collect()),
            Value::Table(table) => {
                let entry = |(name, value)| (Key { name, span: None }, Item::of_value(value));
                Node::Table(table.into_iter().map(entry).collect())
            }
        };
        Item { node, span: None }
    }
}

impl Node {
    /// The value that stands in these bytes of a text.
    fn of_text(value: DeValue<'_>, span: &Option<Range<usize>>) -> Result<Node, ReadError> {
        let overflow = |what: &str| ReadError::custom(what).at(span);
        let item = |value: toml::Spanned<DeValue<'_>>| {
            let span = Some(value.span());
            Ok(Item { node: Node::of_text(value.into_inner(), &span)?, span })
        };
        Ok(match value {
            DeValue::String(text) => Node::Text(text.into_owned()),
            DeValue::Integer(number) => Node::Integer(
                i128::from_str_radix(number.as_str(), number.radix())
                    .map_err(|_| overflow("integer number overflowed"))?,
            ),
            DeValue::Float(number) => match number.as_str().parse::<f64>() {
                Ok(x)
                    if x.is_finite() || !number.as_str().contains(|c: char| c.is_ascii_digit()) =>
                {
                    Node::Float(x)
                }
                _ => return Err(overflow("floating-point number overflowed")),
            },
            DeValue::Boolean(truth) => Node::Boolean(truth),
            DeValue::Datetime(date) => Node::Date(date),
            DeValue::Array(list) => {
                Node::List(list.into_iter().map(item).collect::<Result<_, ReadError>>()?)
            }
            DeValue::Table(table) => {
                let entry = |(name, value): (toml::Spanned<std::borrow::Cow<'_, str>>, _)| {
                    let span = Some(name.span());
                    Ok((Key { name: name.into_inner().into_owned(), span }, item(value)?))
                };
                Node::Table(table.into_iter().map(entry).collect::<Result<_, ReadError>>()?)
            }
        })
    }

    /// Its kind, for people.
    fn kind(&self) -> &'static str {
        match self {
            Node::Text(_) => "string",
            Node::Integer(_) => "integer",
            Node::Float(_) => "float",
            Node::Boolean(_) => "boolean",
            Node::Date(_) => "datetime",
            Node::List(_) => "array",
            Node::Table(_) => "table",
        }
    }

    fn visit<'de, V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ReadError> {
        match self {
            Node::Text(text) => visitor.visit_string(text),
            Node::Integer(number) => match (i64::try_from(number), u64::try_from(number)) {
                (Ok(number), _) => visitor.visit_i64(number),
                (_, Ok(number)) => visitor.visit_u64(number),
                _ => visitor.visit_i128(number),
            },
            Node::Float(number) => visitor.visit_f64(number),
            Node::Boolean(truth) => visitor.visit_bool(truth),
            Node::Date(date) => visitor.visit_map(DateAccess(Some(date))),
            Node::List(list) => visit_list(list, visitor),
            Node::Table(table) => {
                visitor.visit_map(TableAccess { entries: table.into_iter(), value: None })
            }
        }
    }
}

/// Visits a list, all of it.
fn visit_list<'de, V: Visitor<'de>>(list: Vec<Item>, visitor: V) -> Result<V::Value, ReadError> {
    let length = list.len();
    let mut rest = ListAccess(list.into_iter());
    let value = visitor.visit_seq(&mut rest)?;
    match rest.0.len() {
        0 => Ok(value),
        left => {
            let wanted = format!("an array of length {}", length - left);
            Err(ReadError::invalid_length(length, &wanted.as_str()))
        }
    }
}

impl<'de> Deserializer<'de> for Item {
    type Error = ReadError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ReadError> {
        let Item { node, span } = self;
        node.visit(visitor).map_err(|error| error.at(&span))
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, ReadError> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, ReadError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ReadError> {
        match self.node {
            Node::List(_) => {
                Err(ReadError::invalid_type(Unexpected::Seq, &"a table").at(&self.span))
            }
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ReadError> {
        let Item { node, span } = self;
        let choice = match node {
            Node::Text(name) => Ok(Choice { name: Key { name, span: None }, content: None }),
            Node::Table(mut table) if table.len() == 1 => table
                .pop()
                .map(|(name, content)| Choice { name, content: Some(content) })
                .ok_or_else(|| ReadError::custom("an empty table")),
            Node::Table(table) => Err(ReadError::custom(format!(
                "wanted exactly 1 element, found {} elements",
                table.len()
            ))),
            _ => Err(ReadError::custom("wanted string or table")),
        };
        choice.and_then(|choice| visitor.visit_enum(choice)).map_err(|error| error.at(&span))
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit
        unit_struct seq tuple tuple_struct map identifier ignored_any
    }
}

/// The elements of a list that are left.
struct ListAccess(std::vec::IntoIter<Item>);

impl<'de> SeqAccess<'de> for &mut ListAccess {
    type Error = ReadError;

    fn next_element_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, ReadError> {
        self.0.next().map(|item| seed.deserialize(item)).transpose()
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.0.len())
    }
}

/// The entries of a table that are left.
struct TableAccess {
    entries: std::vec::IntoIter<(Key, Item)>,
    value: Option<Item>,
}

impl<'de> MapAccess<'de> for TableAccess {
    type Error = ReadError;

    fn next_key_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, ReadError> {
        let Some((key, value)) = self.entries.next() else { return Ok(None) };
        self.value = Some(value);
        key.read(seed).map(Some)
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, ReadError> {
        match self.value.take() {
            Some(item) => seed.deserialize(item),
            None => Err(ReadError::custom("a value without its key")),
        }
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.entries.len())
    }
}

impl Key {
    fn read<'de, S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, ReadError> {
        let name: StringDeserializer<ReadError> = self.name.into_deserializer();
        seed.deserialize(name).map_err(|error| error.at(&self.span))
    }
}

/// A date as the types of `toml` read it.
struct DateAccess(Option<Datetime>);

impl<'de> MapAccess<'de> for DateAccess {
    type Error = ReadError;

    fn next_key_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, ReadError> {
        let key = self.0.map(|_| Key { name: DATE_KEY.to_owned(), span: None });
        key.map(|key| key.read(seed)).transpose()
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, ReadError> {
        let text = self.0.take().map(|date| date.to_string()).unwrap_or_default();
        let text: StringDeserializer<ReadError> = text.into_deserializer();
        seed.deserialize(text)
    }
}

/// A variant by its name, with what it holds.
struct Choice {
    name: Key,
    content: Option<Item>,
}

impl<'de> EnumAccess<'de> for Choice {
    type Error = ReadError;
    type Variant = Content;

    fn variant_seed<S: DeserializeSeed<'de>>(
        self,
        seed: S,
    ) -> Result<(S::Value, Content), ReadError> {
        Ok((self.name.read(seed)?, Content(self.content)))
    }
}

/// What a variant holds; nothing where its name stands alone.
struct Content(Option<Item>);

impl Content {
    /// The value of a variant that has one.
    fn item(self, kind: &str) -> Result<Item, ReadError> {
        self.0.ok_or_else(|| ReadError::invalid_type(Unexpected::UnitVariant, &kind))
    }
}

impl<'de> VariantAccess<'de> for Content {
    type Error = ReadError;

    fn unit_variant(self) -> Result<(), ReadError> {
        let Some(item) = self.0 else { return Ok(()) };
        let complaint = match &item.node {
            Node::List(list) if list.is_empty() => return Ok(()),
            Node::Table(table) if table.is_empty() => return Ok(()),
            Node::List(_) => "expected empty array".to_owned(),
            Node::Table(_) => "expected empty table".to_owned(),
            other => format!("expected table, found {}", other.kind()),
        };
        Err(ReadError::custom(complaint).at(&item.span))
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, ReadError> {
        seed.deserialize(self.item("newtype variant")?)
    }

    fn tuple_variant<V: Visitor<'de>>(
        self,
        _length: usize,
        visitor: V,
    ) -> Result<V::Value, ReadError> {
        self.item("tuple variant")?.deserialize_any(visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, ReadError> {
        let item = self.item("struct variant")?;
        if let Node::Table(table) = &item.node {
            let unknown = table.iter().find(|(key, _)| !fields.contains(&&*key.name));
            if let Some((key, _)) = unknown {
                return Err(ReadError::unknown_field(&key.name, fields).at(&key.span));
            }
        }
        item.deserialize_struct("", fields, visitor)
    }
}

#[cfg(test)]
mod tests;
