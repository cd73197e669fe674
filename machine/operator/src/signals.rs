//! The newest value of every signal, and its fields by their names: `sense.joints.q_rad[2]`.

use serde_json::{Map, Value, json};
use taktil_rtcore::payload::{Field, Primitive};
use taktil_rtcore::record::{Catalog, Record, Signal};
use taktil_rtcore::{Invalid, Nanos, Payload};

/// A field of a signal, with its place in the body.
#[derive(Clone, Copy, Debug)]
struct FieldPlace {
    field: Field,
    offset: usize,
}

/// The newest value of one signal.
#[derive(Debug)]
struct NewestValue {
    name: String,
    fields: Vec<FieldPlace>,
    size: usize,
    body: Vec<u8>,
    release: Nanos,
}

/// A signal, a field of it, or an element of a field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SignalPath {
    /// As it was named.
    pub(crate) name: String,
    /// Index into the catalog.
    pub(crate) signal: usize,
    field: Option<usize>,
    element: Option<usize>,
}

/// The newest value of each signal of a machine.
#[derive(Debug, Default)]
pub(crate) struct SignalTable(Vec<NewestValue>);

impl SignalTable {
    /// No value has come yet.
    pub(crate) fn new(catalog: &Catalog) -> SignalTable {
        SignalTable(catalog.signals.iter().map(newest_value).collect())
    }

    /// Takes over the value of a record.
    pub(crate) fn record(&mut self, record: &Record<'_>) {
        let Some(newest) = self.0.get_mut(record.signal) else { return };
        if record.body.len() == newest.size {
            newest.body.clear();
            newest.body.extend_from_slice(record.body);
            newest.release = record.release;
        }
    }

    /// Finds what a path names.
    ///
    /// # Errors
    /// A name that no signal, field or element has; the place is the path.
    pub(crate) fn find(&self, path: &str) -> Result<SignalPath, Invalid> {
        let begins = |newest: &&(usize, &NewestValue)| {
            path.strip_prefix(&newest.1.name)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        let found = self.0.iter().enumerate().collect::<Vec<_>>();
        let Some(&(signal, newest)) =
            found.iter().filter(begins).max_by_key(|newest| newest.1.name.len())
        else {
            let remedy = "say `signals` for all of them";
            return Err(Invalid::new(path, "there is no such signal", remedy));
        };
        let path_to = |field, element| SignalPath { name: path.to_owned(), signal, field, element };
        let Some(rest) = path[newest.name.len()..].strip_prefix('.') else {
            return Ok(path_to(None, None));
        };
        let (name, index) = match rest.split_once('[') {
            None => (rest, None),
            Some((name, index)) => (name, Some(index.strip_suffix(']').unwrap_or(""))),
        };
        let names = || newest.fields.iter().map(|p| p.field.name).collect::<Vec<_>>().join(", ");
        let Some(field) = newest.fields.iter().position(|place| place.field.name == name) else {
            let what = format!("`{}` has no such field", newest.name);
            return Err(Invalid::new(path, what, format!("its fields are: {}", names())));
        };
        let count = newest.fields[field].field.count;
        let Some(index) = index else { return Ok(path_to(Some(field), None)) };
        match index.parse::<usize>().ok().filter(|index| *index < count) {
            Some(element) => Ok(path_to(Some(field), Some(element))),
            None => {
                let remedy = format!("give [0] to [{}]", count.saturating_sub(1));
                Err(Invalid::new(path, "there is no such element", remedy))
            }
        }
    }

    /// Finds a path to a single number.
    ///
    /// # Errors
    /// As [`SignalTable::find`], and a path to several numbers.
    pub(crate) fn find_number(&self, name: &str) -> Result<SignalPath, Invalid> {
        let path = self.find(name)?;
        let count = path.field.map(|field| self.0[path.signal].fields[field].field.count);
        match (count, path.element) {
            (Some(1), _) | (Some(_), Some(_)) => Ok(path),
            _ => {
                let remedy = "name one number, such as sense.joints.q_rad[0]";
                Err(Invalid::new(name, "is not a single number", remedy))
            }
        }
    }

    /// The newest value that a path names; `None` before the first one.
    pub(crate) fn value(&self, path: &SignalPath) -> Option<Value> {
        let newest = self.0.get(path.signal).filter(|newest| !newest.body.is_empty())?;
        Some(newest.value(path))
    }

    /// The number that a path names, in the body of a record of its signal.
    pub(crate) fn number_in(&self, path: &SignalPath, body: &[u8]) -> Option<f64> {
        let newest = self.0.get(path.signal).filter(|newest| newest.size == body.len())?;
        let place = newest.fields.get(path.field?)?;
        number(place, path.element.unwrap_or(0), body)
    }

    /// The newest value of a signal by its name, as the payload that it is.
    pub(crate) fn decoded<T: Payload>(&self, name: &str) -> Option<T> {
        let newest = self.0.iter().find(|newest| newest.name == name)?;
        T::decode(&newest.body)
    }

    /// The newest numbers of a field; empty before the first value.
    pub(crate) fn numbers(&self, path: &str) -> Vec<f64> {
        let Ok(path) = self.find(path) else { return Vec::new() };
        let newest = &self.0[path.signal];
        let Some(place) = path.field.and_then(|field| newest.fields.get(field)) else {
            return Vec::new();
        };
        (0..place.field.count).map_while(|at| number(place, at, &newest.body)).collect()
    }

    /// The newest single number of a field.
    pub(crate) fn single(&self, path: &str) -> Option<f64> {
        self.numbers(path).first().copied()
    }

    /// The release of the newest value of any signal.
    pub(crate) fn newest_release(&self) -> Nanos {
        self.0.iter().map(|newest| newest.release).max().unwrap_or(Nanos::ZERO)
    }

    /// Every signal with its fields.
    pub(crate) fn list(&self) -> Value {
        let mut all = Map::new();
        for newest in &self.0 {
            let fields = newest.fields.iter().map(|place| {
                let Field { name, kind, count, .. } = place.field;
                json!({ "name": name, "type": kind.ros_name(), "count": count })
            });
            all.insert(newest.name.clone(), fields.collect());
        }
        Value::Object(all)
    }
}

fn newest_value(signal: &Signal) -> NewestValue {
    let mut end = 0usize;
    let mut fields = Vec::with_capacity(signal.fields.len());
    for field in signal.fields.iter() {
        let offset = end.next_multiple_of(field.kind.size());
        end = field.end_after(end);
        fields.push(FieldPlace { field: *field, offset });
    }
    let (name, size) = (signal.name.clone(), signal.size);
    NewestValue { name, fields, size, body: Vec::with_capacity(size), release: Nanos::ZERO }
}

impl NewestValue {
    fn value(&self, path: &SignalPath) -> Value {
        let of_field = |place: &FieldPlace| match place.field.array {
            false => element(place, 0, &self.body),
            true => (0..place.field.count).map(|at| element(place, at, &self.body)).collect(),
        };
        match (path.field.and_then(|field| self.fields.get(field)), path.element) {
            (None, _) => self
                .fields
                .iter()
                .map(|place| (place.field.name.to_owned(), of_field(place)))
                .collect::<Map<_, _>>()
                .into(),
            (Some(place), None) => of_field(place),
            (Some(place), Some(at)) => element(place, at, &self.body),
        }
    }
}

/// The bytes of an element.
fn bytes<'a>(place: &FieldPlace, at: usize, body: &'a [u8]) -> Option<&'a [u8]> {
    let size = place.field.kind.size();
    let begin = place.offset + at * size;
    body.get(begin..begin + size)
}

fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut all = [0; N];
    all.copy_from_slice(bytes);
    all
}

/// An element as JSON; a number that is not finite is null.
fn element(place: &FieldPlace, at: usize, body: &[u8]) -> Value {
    let Some(bytes) = bytes(place, at, body) else { return Value::Null };
    match place.field.kind {
        Primitive::F64 => json!(f64::from_le_bytes(array(bytes))),
        Primitive::F32 => json!(f32::from_le_bytes(array(bytes))),
        Primitive::I64 => json!(i64::from_le_bytes(array(bytes))),
        Primitive::U64 => json!(u64::from_le_bytes(array(bytes))),
        Primitive::I32 => json!(i32::from_le_bytes(array(bytes))),
        Primitive::U32 => json!(u32::from_le_bytes(array(bytes))),
        Primitive::I16 => json!(i16::from_le_bytes(array(bytes))),
        Primitive::U16 => json!(u16::from_le_bytes(array(bytes))),
        Primitive::U8 => json!(bytes[0]),
    }
}

/// An element as a number.
#[expect(clippy::cast_precision_loss, reason = "for a picture; counts of jobs stay below 2^53")]
fn number(place: &FieldPlace, at: usize, body: &[u8]) -> Option<f64> {
    let bytes = bytes(place, at, body).filter(|_| at < place.field.count)?;
    Some(match place.field.kind {
        Primitive::F64 => f64::from_le_bytes(array(bytes)),
        Primitive::F32 => f32::from_le_bytes(array(bytes)).into(),
        Primitive::I64 => i64::from_le_bytes(array(bytes)) as f64,
        Primitive::U64 => u64::from_le_bytes(array(bytes)) as f64,
        Primitive::I32 => i32::from_le_bytes(array(bytes)).into(),
        Primitive::U32 => u32::from_le_bytes(array(bytes)).into(),
        Primitive::I16 => i16::from_le_bytes(array(bytes)).into(),
        Primitive::U16 => u16::from_le_bytes(array(bytes)).into(),
        Primitive::U8 => bytes[0].into(),
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use taktil_rtcore::payload;

    payload! {
        /// A payload with fields of several kinds.
        pub struct Mixed {
            /// One byte.
            pub one: u8,
            /// Three numbers.
            pub three: [f64; 3],
            /// A count.
            pub count: u32,
        }
    }

    /// A catalog with the signals `a.mixed` and `a.mixed_more`.
    pub(crate) fn catalog() -> Catalog {
        let signal = |name: &str| Signal {
            name: name.into(),
            lane: 0,
            type_name: Mixed::NAME.into(),
            fields: Mixed::FIELDS.into(),
            size: Mixed::SIZE,
        };
        Catalog { signals: vec![signal("a.mixed"), signal("a.mixed_more")], lanes: Vec::new() }
    }

    /// The body of a value.
    pub(crate) fn body(three: [f64; 3], count: u32) -> Vec<u8> {
        let mut bytes = vec![0; Mixed::SIZE];
        Mixed { one: 7, three, count }.encode(&mut bytes);
        bytes
    }

    #[test]
    fn values_are_found_by_signal_field_and_element() {
        let mut table = SignalTable::new(&catalog());
        let whole = table.find("a.mixed").unwrap();
        assert_eq!(table.value(&whole), None, "nothing has come yet");
        let bytes = body([1.5, f64::NAN, -2.0], 9);
        let release = Nanos(5);
        table.record(&Record { signal: 0, tick: 1, release, body: &bytes });
        let value = json!({ "one": 7, "three": [1.5, null, -2.0], "count": 9 });
        assert_eq!(table.value(&whole), Some(value));
        assert_eq!(table.value(&table.find("a.mixed.count").unwrap()), Some(json!(9)));
        assert_eq!(table.value(&table.find("a.mixed.three[2]").unwrap()), Some(json!(-2.0)));
        assert_eq!(table.find("a.mixed_more").unwrap().signal, 1);
        let path = table.find_number("a.mixed.three[0]").unwrap();
        assert_eq!(table.number_in(&path, &bytes), Some(1.5));
        assert_eq!(table.number_in(&path, &bytes[1..]), None, "a body of another length");
        assert_eq!(table.numbers("a.mixed.three").len(), 3);
        assert_eq!((table.single("a.mixed.count"), table.newest_release()), (Some(9.0), release));
    }

    #[test]
    fn unknown_names_are_refused_with_those_that_exist() {
        let table = SignalTable::new(&catalog());
        for (path, says) in [
            ("b", "no such signal"),
            ("a.mixe", "no such signal"),
            ("a.mixed.four", "no such field"),
            ("a.mixed.three[3]", "no such element"),
            ("a.mixed.three[", "no such element"),
            ("a.mixed.three[-1]", "no such element"),
            ("", "no such signal"),
        ] {
            let bad = table.find(path).unwrap_err();
            assert!(bad.what.contains(says), "{path}: {bad:?}");
        }
        assert!(table.find_number("a.mixed.three").unwrap_err().what.contains("single"));
        assert!(table.find_number("a.mixed").unwrap_err().what.contains("single"));
        assert!(table.find_number("a.mixed.count").is_ok());
    }
}
