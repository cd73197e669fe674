//! Requests of the calc filter, checked against the table of their operation. Unknown fields, wrong
//! types, wrong lengths and numbers that are not finite are errors. The mathematics checks the
//! values further.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::hint::black_box;

use serde_json::{Map, Value};
use taktil_mechanics::Joints;

use super::field::{COMMON, Failure, Field, Kind, Presence};

/// Largest number of values in a list.
const LIST_MAX: usize = 1 << 20;

#[derive(Debug)]
enum Parsed {
    Number(f64),
    Size(usize),
    Text(&'static str),
    Names(Vec<&'static str>),
    Request(Map<String, Value>),
    Numbers(Vec<f64>),
    Rows(Vec<Vec<f64>>),
    Counts([i32; 6]),
    Table(Args),
    Tables(Vec<Args>),
    Other,
}

/// A checked request with its defaults filled in.
#[derive(Debug)]
pub(super) struct Args {
    values: BTreeMap<&'static str, Parsed>,
    repeat: Option<usize>,
    best_ns: Cell<Option<u64>>,
}

impl Args {
    /// Checks a whole request against an operation's table.
    pub(super) fn from_request(
        object: &Map<String, Value>,
        fields: &'static [Field],
    ) -> Result<Args, Failure> {
        let known = |key: &str| COMMON.iter().chain(fields).any(|field| field.name == key);
        refuse_unknown(object, known, "", &|| fields.iter().map(|f| f.name).collect())?;
        let mut args = Args::empty();
        for field in fields {
            args.parse_field(object, field, field.name)?;
        }
        for field in &COMMON[2..] {
            args.parse_field(object, field, field.name)?;
        }
        let repeat = args.size("repeat")?;
        args.repeat = args.has("timing").then_some(repeat);
        Ok(args)
    }

    fn from_table(
        object: &Map<String, Value>,
        fields: &'static [Field],
        place: &str,
    ) -> Result<Args, Failure> {
        let known = |key: &str| fields.iter().any(|field| field.name == key);
        let prefix = format!("{place}.");
        refuse_unknown(object, known, &prefix, &|| fields.iter().map(|f| f.name).collect())?;
        let mut args = Args::empty();
        for field in fields {
            args.parse_field(object, field, &format!("{prefix}{}", field.name))?;
        }
        Ok(args)
    }

    fn empty() -> Args {
        Args { values: BTreeMap::new(), repeat: None, best_ns: Cell::new(None) }
    }

    fn parse_field(
        &mut self,
        object: &Map<String, Value>,
        field: &'static Field,
        place: &str,
    ) -> Result<(), Failure> {
        let value = match (object.get(field.name), field.presence) {
            (None | Some(Value::Null), Presence::Optional) => return Ok(()),
            (None, Presence::Required) => {
                let what = format!("`{place}` is missing: {}", field.kind.description());
                return Err(Failure::new("missing_field", Some(place), what));
            }
            (None, Presence::Default(text)) => {
                let value = serde_json::from_str(text).unwrap_or(Value::Null);
                parse(field, place, &value)?
            }
            (Some(value), _) => parse(field, place, value)?,
        };
        // A switch that is false counts as absent.
        if let Some(value) = value {
            self.values.insert(field.name, value);
        }
        Ok(())
    }

    /// True when an optional field is present or a switch is on.
    pub(super) fn has(&self, name: &str) -> bool {
        self.values.contains_key(name)
    }

    fn get(&self, name: &str) -> Result<&Parsed, Failure> {
        self.values.get(name).ok_or_else(|| {
            Failure::new("missing_field", Some(name), format!("`{name}` is missing"))
        })
    }

    /// A number.
    pub(super) fn number(&self, name: &str) -> Result<f64, Failure> {
        match self.get(name)? {
            Parsed::Number(x) => Ok(*x),
            _ => Err(internal_failure(name)),
        }
    }

    /// A number greater than zero.
    pub(super) fn positive(&self, name: &str) -> Result<f64, Failure> {
        let x = self.number(name)?;
        if x > 0.0 {
            return Ok(x);
        }
        Err(Failure::range(name, format!("`{name}` is {x:?}; it has to be above 0")))
    }

    /// An integer from 1 on.
    pub(super) fn size(&self, name: &str) -> Result<usize, Failure> {
        match self.get(name)? {
            Parsed::Size(n) => Ok(*n),
            _ => Err(internal_failure(name)),
        }
    }

    /// One word of a choice.
    pub(super) fn choice(&self, name: &str) -> Result<&'static str, Failure> {
        match self.get(name)? {
            Parsed::Text(text) => Ok(text),
            _ => Err(internal_failure(name)),
        }
    }

    /// A list of numbers.
    pub(super) fn numbers(&self, name: &str) -> Result<&[f64], Failure> {
        match self.get(name)? {
            Parsed::Numbers(list) => Ok(list),
            _ => Err(internal_failure(name)),
        }
    }

    /// A list of words of a choice.
    pub(super) fn names(&self, name: &str) -> Result<&[&'static str], Failure> {
        match self.get(name)? {
            Parsed::Names(list) => Ok(list),
            _ => Err(internal_failure(name)),
        }
    }

    /// A nested request, checked against the table of one of the operations that it may name.
    pub(super) fn request(
        &self,
        name: &str,
        known: &[(&'static str, &'static [Field])],
    ) -> Result<(&'static str, Args), Failure> {
        let Parsed::Request(object) = self.get(name)? else { return Err(internal_failure(name)) };
        let within = |failure: Failure| Failure {
            field: Some(failure.field.map_or(name.to_owned(), |field| format!("{name}.{field}"))),
            ..failure
        };
        let default = known.first().map(|(op, _)| Value::from(*op)).unwrap_or_default();
        let op = object.get("op").unwrap_or(&default);
        let found = known.iter().find(|(known, _)| op == known);
        let Some((op, fields)) = found else {
            let names: Vec<&str> = known.iter().map(|(op, _)| *op).collect();
            let what = format!("`{name}.op` is {op}; wanted: {}", names.join(" or "));
            return Err(within(Failure::new("unknown_op", Some("op"), what)));
        };
        Ok((op, Args::from_request(object, fields).map_err(within)?))
    }

    /// A list of exactly `N` numbers.
    pub(super) fn array<const N: usize>(&self, name: &str) -> Result<[f64; N], Failure> {
        <[f64; N]>::try_from(self.numbers(name)?).map_err(|_| internal_failure(name))
    }

    /// Six numbers, one for each joint.
    pub(super) fn joints(&self, name: &str) -> Result<Joints, Failure> {
        Ok(Joints::from(self.array::<6>(name)?))
    }

    /// Rows of six numbers.
    pub(super) fn joint_rows(&self, name: &str) -> Result<Vec<Joints>, Failure> {
        match self.get(name)? {
            Parsed::Rows(rows) => {
                let joints = |row: &Vec<f64>| <[f64; 6]>::try_from(row.as_slice()).ok();
                let all: Option<Vec<Joints>> =
                    rows.iter().map(|row| joints(row).map(Joints::from)).collect();
                all.ok_or_else(|| internal_failure(name))
            }
            _ => Err(internal_failure(name)),
        }
    }

    /// Six encoder counts.
    pub(super) fn counts(&self, name: &str) -> Result<[i32; 6], Failure> {
        match self.get(name)? {
            Parsed::Counts(counts) => Ok(*counts),
            _ => Err(internal_failure(name)),
        }
    }

    /// A nested object, if it is present.
    pub(super) fn table(&self, name: &str) -> Option<&Args> {
        match self.values.get(name) {
            Some(Parsed::Table(args)) => Some(args),
            _ => None,
        }
    }

    /// A list of nested objects.
    pub(super) fn tables(&self, name: &str) -> Result<&[Args], Failure> {
        match self.get(name)? {
            Parsed::Tables(list) => Ok(list),
            _ => Err(internal_failure(name)),
        }
    }

    /// Like [`Args::timed`], with a setup before each run that is not part of the time.
    pub(super) fn timed_with_setup<S, T>(
        &self,
        state: &mut S,
        mut prepare: impl FnMut(&mut S),
        mut compute: impl FnMut(&mut S) -> T,
    ) -> T {
        prepare(state);
        let Some(repeat) = self.repeat else { return compute(state) };
        let (mut result, mut best) = timed_call(&mut || compute(state));
        for _ in 1..repeat {
            prepare(state);
            let (again, ns) = timed_call(&mut || compute(state));
            if ns < best {
                (result, best) = (again, ns);
            }
        }
        self.best_ns.set(Some(best));
        result
    }

    /// Runs the computation; with `timing` as often as requested, and keeps the shortest time.
    pub(super) fn timed<T>(&self, mut compute: impl FnMut() -> T) -> T {
        let Some(repeat) = self.repeat else { return compute() };
        let (mut result, mut best) = timed_call(&mut compute);
        for _ in 1..repeat {
            let (again, ns) = timed_call(&mut compute);
            if ns < best {
                (result, best) = (again, ns);
            }
        }
        self.best_ns.set(Some(best));
        result
    }

    /// The shortest time that [`Args::timed`] measured.
    pub(super) fn best_ns(&self) -> Option<u64> {
        self.best_ns.get()
    }
}

#[expect(clippy::disallowed_methods, reason = "the request asks how long the computation takes")]
fn timed_call<T>(compute: &mut impl FnMut() -> T) -> (T, u64) {
    let start = std::time::Instant::now();
    let result = black_box(compute());
    (result, u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX))
}

fn internal_failure(name: &str) -> Failure {
    let what = format!("`{name}` is read as another type than its table says");
    Failure::new("internal", Some(name), what)
}

fn refuse_unknown(
    object: &Map<String, Value>,
    known: impl Fn(&str) -> bool,
    prefix: &str,
    names: &dyn Fn() -> Vec<&'static str>,
) -> Result<(), Failure> {
    match object.keys().find(|key| !known(key)) {
        None => Ok(()),
        Some(key) => {
            let place = format!("{prefix}{key}");
            let what = format!("unknown field `{place}`; known: {}", names().join(", "));
            Err(Failure::new("unknown_field", Some(&place), what))
        }
    }
}

/// Parses and checks one value; `None` for a switch that is false.
fn parse(field: &Field, place: &str, value: &Value) -> Result<Option<Parsed>, Failure> {
    let wrong = || {
        let what =
            format!("`{place}` is {}; wanted: {}", kind_name(value), field.kind.description());
        Failure::new("wrong_type", Some(place), what)
    };
    Ok(Some(match field.kind {
        Kind::Number => Parsed::Number(finite(value).ok_or_else(wrong)?),
        Kind::NumberOrInfinity if value == "inf" => Parsed::Number(f64::INFINITY),
        Kind::NumberOrInfinity => Parsed::Number(finite(value).ok_or_else(wrong)?),
        Kind::Size(most) => {
            let n = value.as_u64().and_then(|n| usize::try_from(n).ok());
            match n {
                Some(n) if (1..=most).contains(&n) => Parsed::Size(n),
                _ if value.is_number() => {
                    let what =
                        format!("`{place}` is {value}; wanted: {}", field.kind.description());
                    return Err(Failure::range(place, what));
                }
                _ => return Err(wrong()),
            }
        }
        Kind::Switch => match value.as_bool().ok_or_else(wrong)? {
            true => Parsed::Other,
            false => return Ok(None),
        },
        Kind::Choice(texts) => Parsed::Text(choice(texts, place, value, &wrong)?),
        Kind::Vector(n) => Parsed::Numbers(list(value, Some(n), place, &wrong)?),
        Kind::Numbers => Parsed::Numbers(list(value, None, place, &wrong)?),
        Kind::Rows(n) => {
            let rows = value.as_array().ok_or_else(wrong)?;
            refuse_long(rows.len().saturating_mul(n), place)?;
            let row = |(i, row)| {
                let place = format!("{place}[{i}]");
                let wrong = || {
                    let what = format!("`{place}` is {}; wanted: [{n}]", kind_name(row));
                    Failure::new("wrong_type", Some(&place), what)
                };
                list(row, Some(n), &place, &wrong)
            };
            Parsed::Rows(rows.iter().enumerate().map(row).collect::<Result<_, _>>()?)
        }
        Kind::Names(texts) => Parsed::Names(names(texts, place, value, &wrong)?),
        Kind::Request => Parsed::Request(value.as_object().ok_or_else(wrong)?.clone()),
        Kind::Counts => Parsed::Counts(counts(value, place, &wrong)?),
        Kind::Table(fields) => {
            let object = value.as_object().ok_or_else(wrong)?;
            Parsed::Table(Args::from_table(object, fields, place)?)
        }
        Kind::Tables(fields) => {
            let items = value.as_array().ok_or_else(wrong)?;
            refuse_long(items.len(), place)?;
            let table = |(i, item): (usize, &Value)| {
                let place = format!("{place}[{i}]");
                let object = item.as_object().ok_or_else(|| {
                    let what = format!("`{place}` is {}; wanted: object", kind_name(item));
                    Failure::new("wrong_type", Some(&place), what)
                })?;
                Args::from_table(object, fields, &place)
            };
            Parsed::Tables(items.iter().enumerate().map(table).collect::<Result<_, _>>()?)
        }
        Kind::ChoiceOrTable(texts, fields) => match value.as_object() {
            Some(object) => Parsed::Table(Args::from_table(object, fields, place)?),
            None => Parsed::Text(choice(texts, place, value, &wrong)?),
        },
        Kind::Any => Parsed::Other,
    }))
}

fn names(
    texts: &'static [&'static str],
    place: &str,
    value: &Value,
    wrong: &dyn Fn() -> Failure,
) -> Result<Vec<&'static str>, Failure> {
    let items = value.as_array().ok_or_else(wrong)?;
    let name = |(i, item): (usize, &Value)| {
        let place = format!("{place}[{i}]");
        let found = texts.iter().copied().find(|text| item == text);
        found.ok_or_else(|| {
            let what =
                format!("`{place}` is {item}; wanted: {}", Kind::Choice(texts).description());
            Failure::new("unknown_value", Some(&place), what)
        })
    };
    items.iter().enumerate().map(name).collect()
}

fn choice(
    texts: &'static [&'static str],
    place: &str,
    value: &Value,
    wrong: &dyn Fn() -> Failure,
) -> Result<&'static str, Failure> {
    let given = value.as_str().ok_or_else(wrong)?;
    texts.iter().copied().find(|text| *text == given).ok_or_else(|| {
        let what =
            format!("`{place}` is \"{given}\"; wanted: {}", Kind::Choice(texts).description());
        Failure::new("unknown_value", Some(place), what)
    })
}

fn finite(value: &Value) -> Option<f64> {
    value.as_f64().filter(|x| x.is_finite())
}

fn refuse_long(length: usize, place: &str) -> Result<(), Failure> {
    if length <= LIST_MAX {
        return Ok(());
    }
    let what = format!("`{place}` has {length} numbers; at most {LIST_MAX} are taken");
    Err(Failure::new("wrong_length", Some(place), what))
}

fn list(
    value: &Value,
    length: Option<usize>,
    place: &str,
    wrong: &dyn Fn() -> Failure,
) -> Result<Vec<f64>, Failure> {
    let items = value.as_array().ok_or_else(wrong)?;
    refuse_length(items.len(), length, place)?;
    refuse_long(items.len(), place)?;
    let number = |(i, item)| {
        finite(item).ok_or_else(|| {
            let place = format!("{place}[{i}]");
            let what = format!("`{place}` is {}; wanted: a finite number", kind_name(item));
            Failure::new("wrong_type", Some(&place), what)
        })
    };
    items.iter().enumerate().map(number).collect()
}

fn refuse_length(given: usize, wanted: Option<usize>, place: &str) -> Result<(), Failure> {
    match wanted {
        Some(wanted) if wanted != given => {
            let what = format!("`{place}` has {given} elements; wanted: {wanted}");
            Err(Failure::new("wrong_length", Some(place), what))
        }
        _ => Ok(()),
    }
}

fn counts(value: &Value, place: &str, wrong: &dyn Fn() -> Failure) -> Result<[i32; 6], Failure> {
    let items = value.as_array().ok_or_else(wrong)?;
    refuse_length(items.len(), Some(6), place)?;
    let mut out = [0; 6];
    for (i, (slot, item)) in out.iter_mut().zip(items).enumerate() {
        let whole = item.as_i64().and_then(|n| i32::try_from(n).ok());
        *slot = whole.ok_or_else(|| {
            let place = format!("{place}[{i}]");
            let what = format!("`{place}` is {item}; wanted: a whole number of 32 bits");
            Failure::new("wrong_type", Some(&place), what)
        })?;
    }
    Ok(out)
}

pub(super) fn kind_name(value: &Value) -> &'static str {
    match value {
        Value::Null => "null (which also stands for NaN and infinity)",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

/// A count in an error message: all digits while it is readable.
pub(super) fn format_count(x: f64) -> String {
    if x < 1e15 { format!("{x}") } else { format!("{x:e}") }
}

#[cfg(test)]
pub(super) fn is_default_valid(field: &Field) -> bool {
    let Presence::Default(text) = field.presence else { return true };
    serde_json::from_str(text).is_ok_and(|value| parse(field, field.name, &value).is_ok())
}
