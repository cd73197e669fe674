//! Answers of the calc filter. An answer keeps its results in the order in which they were added. A
//! number that is not finite is an error, unless its field may be undefined; an undefined number is
//! written as null.

use serde_json::{Map, Value, json};

use super::field::Failure;

/// The results of one request.
#[derive(Debug, Default)]
pub(super) struct Answer {
    entries: Vec<(&'static str, Value)>,
    not_finite: Option<&'static str>,
}

impl Answer {
    pub(super) fn new() -> Answer {
        Answer::default()
    }

    fn number_as_json(&mut self, name: &'static str, x: f64) -> Value {
        if !x.is_finite() {
            self.not_finite.get_or_insert(name);
        }
        Value::from(x)
    }

    fn list_as_json<'a>(
        &mut self,
        name: &'static str,
        list: impl IntoIterator<Item = &'a f64>,
    ) -> Value {
        Value::Array(list.into_iter().map(|x| self.number_as_json(name, *x)).collect())
    }

    /// A number that has to be finite.
    pub(super) fn number(&mut self, name: &'static str, x: f64) {
        let value = self.number_as_json(name, x);
        self.entries.push((name, value));
    }

    /// A number that may be undefined.
    pub(super) fn optional_number(&mut self, name: &'static str, x: Option<f64>) {
        match x {
            Some(x) => self.number(name, x),
            None => self.entries.push((name, Value::Null)),
        }
    }

    /// An integer.
    pub(super) fn integer(&mut self, name: &'static str, n: u64) {
        self.entries.push((name, Value::from(n)));
    }

    /// Numbers that have to be finite.
    pub(super) fn number_list<'a>(
        &mut self,
        name: &'static str,
        list: impl IntoIterator<Item = &'a f64>,
    ) {
        let value = self.list_as_json(name, list);
        self.entries.push((name, value));
    }

    /// Numbers that may be undefined one by one.
    pub(super) fn optional_numbers(
        &mut self,
        name: &'static str,
        list: impl IntoIterator<Item = Option<f64>>,
    ) {
        let one = |x: Option<f64>| x.map_or(Value::Null, |x| self.number_as_json(name, x));
        let value = Value::Array(list.into_iter().map(one).collect());
        self.entries.push((name, value));
    }

    /// Rows of numbers that have to be finite.
    pub(super) fn number_rows<'a, R: IntoIterator<Item = &'a f64>>(
        &mut self,
        name: &'static str,
        rows: impl IntoIterator<Item = R>,
    ) {
        let value =
            Value::Array(rows.into_iter().map(|row| self.list_as_json(name, row)).collect());
        self.entries.push((name, value));
    }

    /// An inner object of numbers that have to be finite.
    pub(super) fn number_object(&mut self, name: &'static str, inner: &[(&'static str, f64)]) {
        let fields: Map<String, Value> = inner
            .iter()
            .map(|(field, x)| ((*field).to_owned(), self.number_as_json(name, *x)))
            .collect();
        self.entries.push((name, Value::Object(fields)));
    }

    /// A result of any other form; the caller ensures that its numbers are finite.
    pub(super) fn value(&mut self, name: &'static str, value: Value) {
        self.entries.push((name, value));
    }

    /// The first result that should be finite and is not.
    pub(super) fn first_not_finite(&self) -> Option<&'static str> {
        self.not_finite
    }
}

/// The line of a request that was answered.
pub(super) fn success(id: &Value, answer: &Answer) -> String {
    let mut out = format!("{{\"id\":{id},\"ok\":true");
    for (name, value) in &answer.entries {
        out.push_str(&format!(",\"{name}\":{value}"));
    }
    out.push('}');
    out
}

/// The line that answers a request which failed.
pub(super) fn refusal(id: &Value, failure: &Failure) -> String {
    let error = json!({"code": failure.code, "message": failure.message, "field": failure.field});
    format!("{{\"id\":{id},\"ok\":false,\"error\":{error}}}")
}
