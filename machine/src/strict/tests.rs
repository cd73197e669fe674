//! What is read and what is refused, compared with the plain reader of TOML.

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
    let of_text = read_text::<T>(text).err().map(|bad| bad.message().to_owned());
    let table: toml::Table = toml::from_str(text).unwrap();
    let of_table = read_value::<T>(Value::Table(table)).err();
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
    assert_eq!(read_text::<Place>(text).unwrap(), plain);
    assert_eq!(plain.inner.unwrap().p_mm, [4.0, 5.0, 6.0]);
}

#[derive(Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Wide {
    seed: Option<u64>,
    gain: Option<f64>,
    any: Option<toml::Value>,
    section: Option<toml::Table>,
    choice: Option<Shape>,
}

/// What the reader of `toml` itself makes of the same text.
fn plainly(text: &str) -> Result<Wide, Option<Range<usize>>> {
    toml::from_str(text).map_err(|error| error.span())
}

#[test]
fn values_and_places_are_those_of_the_plain_reader() {
    for text in [
        "seed = 18446744073709551615\ngain = -inf",
        "seed = 0xff\ngain = 1_000.5",
        "gain = 3",
        "any = 1979-05-27T07:32:00Z",
        "any = [1, 'two', { three = 3.5, four = [] }]\nsection = { at = 07:32:00 }",
        "[section]\na = 1\n[section.b]\nc = [true]",
        "choice = 'plane'",
        "choice = { plane = {} }",
        "choice.ball.at_mm = [1, 2, 3]",
    ] {
        assert_eq!(read_text::<Wide>(text).unwrap(), plainly(text).unwrap(), "{text}");
    }
    for text in [
        "seed = -1",
        "seed = 1.5",
        "seed = 99999999999999999999",
        "seed = 9999999999999999999999999999999999999999999",
        "gain = 1e999",
        "gain = 'wide'",
        "gain = 1979-05-27",
        "sead = 1",
        "choice = 3",
        "choice = 'cone'",
        "choice = { plane = 3 }",
        "choice = { plane = {}, ball = {} }",
        "choice = 'ball'",
        "choice.ball.at_mm = [1, 2]",
        "choice.ball = 3",
        "choice.ball.at_m = [1, 2, 3]",
        "seed = 1\nseed = 2",
        "seed = ",
        "[section",
    ] {
        let wrong = read_text::<Wide>(text).unwrap_err();
        assert_eq!(wrong.span(), plainly(text).unwrap_err(), "{text}: {wrong}");
    }
}

#[test]
fn places_below_sections_are_marked() {
    let text = "p_mm = [1, 2, 3]\n[inner]\np_mm = [1, 'x', 3]\n";
    let span = read_text::<Place>(text).unwrap_err().span().unwrap();
    assert_eq!(&text[span], "'x'");
    let text = "p_mm = [1, 2, 3]\n[inner]\nrows = [[1, 2]]\n";
    let wrong = read_text::<Place>(text).unwrap_err();
    assert_eq!(wrong.message(), "missing field `p_mm`");
    assert!(text[wrong.span().unwrap()].contains("inner"));
}
