//! Fields of the calc filter's requests: what each may hold, its unit, its default, and the failure
//! of a request. One table of fields for each subject drives both the parser and the printed list.
//! The values are checked by the request.

/// Largest number of runs that `repeat` may ask for.
const REPEAT_MAX: usize = 1_000_000;

/// What a field holds.
#[derive(Clone, Copy)]
pub(super) enum Kind {
    /// A finite number.
    Number,
    /// A finite number, or the text "inf".
    NumberOrInfinity,
    /// An integer from 1 to this limit.
    Size(usize),
    /// True or false.
    Switch,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// Any number of these words.
    Names(&'static [&'static str]),
    /// A request of another operation.
    Request,
    /// A list of exactly this many finite numbers.
    Vector(usize),
    /// Any number of finite numbers.
    Numbers,
    /// Any number of rows, each of this many finite numbers.
    Rows(usize),
    /// Six integers of 32 bits.
    Counts,
    /// An object with these fields.
    Table(&'static [Field]),
    /// Any number of objects with these fields.
    Tables(&'static [Field]),
    /// One of these words, or an object with these fields.
    ChoiceOrTable(&'static [&'static str], &'static [Field]),
    /// Any JSON value; it is not stored.
    Any,
}

/// Whether a field may be absent.
#[derive(Clone, Copy)]
pub(super) enum Presence {
    /// The field is required.
    Required,
    /// The field may be absent or null.
    Optional,
    /// The field may be absent; it then has this value (JSON).
    Default(&'static str),
}

/// One field of a request.
pub(super) struct Field {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    pub(super) unit: &'static str,
    pub(super) presence: Presence,
    pub(super) doc: &'static str,
}

impl Field {
    pub(super) const fn new(
        name: &'static str,
        kind: Kind,
        unit: &'static str,
        presence: Presence,
        doc: &'static str,
    ) -> Field {
        Field { name, kind, unit, presence, doc }
    }
}

/// A required number.
pub(super) const fn number(name: &'static str, unit: &'static str, doc: &'static str) -> Field {
    Field::new(name, Kind::Number, unit, Presence::Required, doc)
}

/// Fields that every operation takes.
pub(super) const COMMON: &[Field] = &[
    Field::new("op", Kind::Any, "", Presence::Required, "Name of the operation."),
    Field::new("id", Kind::Any, "", Presence::Default("null"), "Comes back with the answer."),
    Field::new(
        "timing",
        Kind::Switch,
        "",
        Presence::Default("false"),
        "Adds `ns`, the time of the computation alone.",
    ),
    Field::new(
        "repeat",
        Kind::Size(REPEAT_MAX),
        "",
        Presence::Default("1"),
        "With `timing`: runs, of which the best counts.",
    ),
];

impl Kind {
    /// The type as text for people.
    pub(super) fn description(self) -> String {
        match self {
            Kind::Number => "number".to_owned(),
            Kind::NumberOrInfinity => "number or \"inf\"".to_owned(),
            Kind::Size(most) => format!("whole number 1..{most}"),
            Kind::Switch => "true or false".to_owned(),
            Kind::Choice(texts) => {
                let quoted: Vec<String> = texts.iter().map(|text| format!("\"{text}\"")).collect();
                quoted.join(" or ")
            }
            Kind::Names(texts) => format!("[{} ...]", Kind::Choice(texts).description()),
            Kind::Request => "request".to_owned(),
            Kind::Vector(n) => format!("[{n}]"),
            Kind::Numbers => "[...]".to_owned(),
            Kind::Rows(n) => format!("[[{n}]...]"),
            Kind::Counts => "[6] whole".to_owned(),
            Kind::Table(_) => "object".to_owned(),
            Kind::Tables(_) => "[object...]".to_owned(),
            Kind::ChoiceOrTable(texts, _) => {
                format!("{} or object", Kind::Choice(texts).description())
            }
            Kind::Any => "anything".to_owned(),
        }
    }
}

impl Presence {
    /// The default as text for people.
    pub(super) fn description(self) -> String {
        match self {
            Presence::Required => "required".to_owned(),
            Presence::Optional => "optional".to_owned(),
            Presence::Default(text) => format!("default {text}"),
        }
    }
}

/// Why a request failed.
#[derive(Debug)]
pub(super) struct Failure {
    pub(super) code: &'static str,
    pub(super) field: Option<String>,
    pub(super) message: String,
}

impl Failure {
    pub(super) fn new(
        code: &'static str,
        field: Option<&str>,
        message: impl Into<String>,
    ) -> Failure {
        Failure { code, field: field.map(str::to_owned), message: message.into() }
    }

    pub(super) fn range(field: &str, message: impl Into<String>) -> Failure {
        Failure::new("out_of_range", Some(field), message)
    }
}
