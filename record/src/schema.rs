//! Writes a payload's field table as text (`ros2msg`) and reads it back. Strings, lists and nested
//! types are errors, because a payload has none.

use std::collections::BTreeSet;
use std::fmt;

use serde_json::{Value, json};
use taktil_rtcore::payload::{Field, Primitive};

/// One field of a logged message, with its place in the body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldInfo {
    /// Name, unit last.
    pub name: String,
    /// Element type.
    pub kind: Primitive,
    /// Elements; 1 for a scalar.
    pub count: usize,
    /// True for `type[N]`.
    pub array: bool,
    /// Bytes from the start of the body (after the encapsulation header) to the first element.
    pub offset: usize,
}

/// Why a schema text was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SchemaError {
    /// Line, from 1; 0 when the text as a whole is wrong.
    pub line: usize,
    /// What is wrong.
    pub what: String,
}

impl fmt::Display for SchemaError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(f, "{}", self.what),
            line => write!(f, "line {line}: {}", self.what),
        }
    }
}

impl std::error::Error for SchemaError {}

impl FieldInfo {
    /// The value of the field in a message's stamp, payload and CRC, exact also for integers of 64
    /// bits: a number, or an array of numbers. Numbers that JSON does not know, and what lies
    /// behind the end of `data`, are null.
    #[must_use]
    pub fn value(&self, data: &[u8]) -> Value {
        let size = self.kind.size();
        let element = |index: usize| {
            let at = self.offset + index * size;
            data.get(at..at + size).map_or(Value::Null, |bytes| number(self.kind, bytes))
        };
        if self.array { (0..self.count).map(element).collect() } else { element(0) }
    }
}

impl FieldInfo {
    /// The numbers of the field in the same bytes, as floating point; NaN for what lies behind
    /// their end. Integers of more than 53 bits are rounded.
    #[must_use]
    pub fn numbers(&self, data: &[u8]) -> Vec<f64> {
        let size = self.kind.size();
        let element = |index: usize| {
            let at = self.offset + index * size;
            data.get(at..at + size).map_or(f64::NAN, |bytes| float(self.kind, bytes))
        };
        (0..self.count).map(element).collect()
    }
}

/// A number as floating point, from its little-endian bytes.
#[expect(clippy::cast_precision_loss, reason = "counts stay below 2^53")]
fn float(kind: Primitive, bytes: &[u8]) -> f64 {
    let mut word = [0; 8];
    word[..bytes.len()].copy_from_slice(bytes);
    let unsigned = u64::from_le_bytes(word);
    match kind {
        Primitive::F64 => f64::from_bits(unsigned),
        Primitive::F32 => f64::from(f32::from_bits((unsigned & u64::from(u32::MAX)) as u32)),
        Primitive::I64 | Primitive::I32 | Primitive::I16 => {
            let unused = 64 - 8 * bytes.len();
            ((unsigned << unused).cast_signed() >> unused) as f64
        }
        _ => unsigned as f64,
    }
}

/// A number from its little-endian bytes, of which there are as many as its type has.
#[must_use]
pub fn number(kind: Primitive, bytes: &[u8]) -> Value {
    let mut word = [0; 8];
    let length = bytes.len().min(word.len());
    word[..length].copy_from_slice(&bytes[..length]);
    let unsigned = u64::from_le_bytes(word);
    let unused = 64 - 8 * u32::try_from(length).unwrap_or(8);
    match kind {
        Primitive::F64 => json!(f64::from_bits(unsigned)),
        Primitive::F32 => json!(f32::from_bits((unsigned & u64::from(u32::MAX)) as u32)),
        Primitive::I64 | Primitive::I32 | Primitive::I16 if unused < 64 => {
            json!((unsigned << unused).cast_signed() >> unused)
        }
        _ => json!(unsigned),
    }
}

/// No body is longer (bytes): keeps a damaged schema from asking for the whole memory.
const BODY_BYTES_MAX: usize = 1 << 24;

/// The topic of a signal: `task.port` becomes `/task/port`; what ROS 2 does not allow in a name
/// becomes `_`.
#[must_use]
pub fn topic(signal: &str) -> String {
    let mut out = String::with_capacity(signal.len() + 1);
    out.push('/');
    for c in signal.chars() {
        out.push(match c {
            '.' => '/',
            c if c.is_ascii_alphanumeric() || c == '_' => c,
            _ => '_',
        });
    }
    out
}

/// The `ros2msg` text of a payload as it is logged: stamp, fields, CRC.
#[must_use]
pub fn schema_text(fields: &[Field]) -> String {
    let mut out = String::from("uint64 tick\nint64 release_ns\n");
    for field in fields {
        out.push_str(field.kind.ros_name());
        if field.array {
            out.push_str(&format!("[{}]", field.count));
        }
        out.push_str(&format!(" {}\n", field.name));
    }
    out.push_str("uint32 crc\n");
    out
}

/// Reads a schema text back, with the offsets that CDR gives the fields.
///
/// # Errors
/// A type that no payload has, an array without a length, a name twice, a first pair or last field
/// that is not the stamp or the CRC.
pub fn parse_schema(text: &str) -> Result<Vec<FieldInfo>, SchemaError> {
    let mut fields: Vec<FieldInfo> = Vec::new();
    let (mut end, mut names) = (0, BTreeSet::new());
    for (index, raw) in text.lines().enumerate() {
        let line = raw.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let field = parse_line(line, end).map_err(|what| SchemaError { line: index + 1, what })?;
        if !names.insert(field.name.clone()) {
            let what = format!("field `{}` stands there twice", field.name);
            return Err(SchemaError { line: index + 1, what });
        }
        end = field.offset + field.kind.size() * field.count;
        fields.push(field);
    }
    let is = |field: Option<&FieldInfo>, name: &str, kind: Primitive| {
        field.is_some_and(|f| f.name == name && f.kind == kind && !f.array)
    };
    let has_stamp_and_crc = is(fields.first(), "tick", Primitive::U64)
        && is(fields.get(1), "release_ns", Primitive::I64)
        && fields.len() > 2
        && is(fields.last(), "crc", Primitive::U32);
    if !has_stamp_and_crc {
        let what = "a Taktil message starts with `uint64 tick`, `int64 release_ns` and ends with \
                    `uint32 crc`"
            .to_owned();
        return Err(SchemaError { line: 0, what });
    }
    Ok(fields)
}

fn parse_line(line: &str, end: usize) -> Result<FieldInfo, String> {
    let mut words = line.split_whitespace();
    let (Some(kind_text), Some(name), None) = (words.next(), words.next(), words.next()) else {
        return Err(format!("`{line}` is not `type name`"));
    };
    let (base, count, array) = match kind_text.split_once('[') {
        None => (kind_text, 1, false),
        Some((base, rest)) => {
            let count = rest.strip_suffix(']').and_then(|digits| digits.parse::<usize>().ok());
            let count = count.filter(|n| (1..=BODY_BYTES_MAX).contains(n));
            (base, count.ok_or_else(|| format!("`{kind_text}` has no fixed length"))?, true)
        }
    };
    let kind = Primitive::ALL.into_iter().find(|kind| kind.ros_name() == base);
    let kind = kind.ok_or_else(|| format!("type `{base}` is not a number of fixed size"))?;
    let offset = end.next_multiple_of(kind.size());
    if offset + kind.size() * count > BODY_BYTES_MAX {
        return Err(format!("the message is longer than {BODY_BYTES_MAX} bytes"));
    }
    Ok(FieldInfo { name: name.to_owned(), kind, count, array, offset })
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_rtcore::Payload;

    taktil_rtcore::payload! {
        /// Mixed alignments.
        pub struct Mixed {
            /// a
            pub flag: u8,
            /// b
            pub angles_rad: [f64; 2],
            /// c
            pub pixel: [f32; 1],
            /// d
            pub last: u16,
        }
    }

    #[test]
    fn text_reads_back_with_the_offsets_of_the_encoder() {
        let text = schema_text(Mixed::FIELDS);
        let fields = parse_schema(&text).unwrap();
        let inner = &fields[2..fields.len() - 1];
        let mut end = 0;
        for (ours, theirs) in inner.iter().zip(Mixed::FIELDS) {
            assert_eq!((ours.name.as_str(), ours.kind), (theirs.name, theirs.kind));
            assert_eq!((ours.count, ours.array), (theirs.count, theirs.array));
            end = theirs.end_after(end);
            let bytes = ours.kind.size() * ours.count;
            assert_eq!(ours.offset, 16 + end - bytes, "{}", ours.name);
        }
        assert_eq!(inner.len(), Mixed::FIELDS.len());
        assert_eq!(fields.last().unwrap().offset, 48, "46 bytes, aligned to 4");
    }

    #[test]
    fn topics_are_names_that_ros_accepts() {
        assert_eq!(topic("joint_servo.torque"), "/joint_servo/torque");
        assert_eq!(topic("a b-c.\u{e9}"), "/a_b_c/_");
    }

    #[test]
    fn wrong_texts_are_refused_with_their_line() {
        let frame = |line: &str| format!("uint64 tick\nint64 release_ns\n{line}\nuint32 crc\n");
        for bad in [
            "string name",
            "float64[] q",
            "float64[0] q",
            "float64[99999999999999999999] q",
            "float64[4000000] q",
            "float64",
            "float64 a b",
            "uint8 tick",
            "float64[3 q",
        ] {
            let error = parse_schema(&frame(bad)).unwrap_err();
            assert_eq!(error.line, 3, "{bad}: {error}");
        }
        assert_eq!(parse_schema("").unwrap_err().line, 0);
        assert_eq!(parse_schema("uint64 tick\nint64 release_ns\nuint8 a\n").unwrap_err().line, 0);
        assert!(parse_schema(&frame("uint8 a # remark")).is_ok());
    }
}
