//! Reads the part of TOML in which descriptions are written: sections, lists of sections, and keys
//! with a number, a word or a truth value, one on a line.

use std::collections::BTreeMap;

use taktil_hal::Invalid;

/// What stands behind a key.
#[derive(Clone, Debug, PartialEq)]
enum Value {
    Integer(i64),
    Real(f64),
    Word(String),
    Truth(bool),
}

/// The keys of one section that have not been asked for yet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Section {
    name: String,
    keys: BTreeMap<String, Value>,
}

/// A text by its sections; the keys before the first one are in that without a name.
#[derive(Debug, Default)]
pub(crate) struct Text {
    sections: Vec<Section>,
}

fn bad(line: usize, what: impl Into<String>) -> Invalid {
    Invalid::new(format!("line {line}"), what, "write `[section]`, `[[list]]` or `key = value`")
}

/// The line without what follows a `#` outside of quotes.
fn without_comment(line: &str) -> &str {
    let mut quoted = false;
    for (at, c) in line.char_indices() {
        match c {
            '"' => quoted = !quoted,
            '#' if !quoted => return &line[..at],
            _ => {}
        }
    }
    line
}

fn value(text: &str) -> Option<Value> {
    if let Some(word) = text.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')) {
        return (!word.contains('"')).then(|| Value::Word(word.to_owned()));
    }
    let digits = text.replace('_', "");
    let radix = |prefix: &str, radix: u32| {
        digits.strip_prefix(prefix).and_then(|rest| i64::from_str_radix(rest, radix).ok())
    };
    match text {
        "true" => Some(Value::Truth(true)),
        "false" => Some(Value::Truth(false)),
        _ => radix("0x", 16)
            .or_else(|| radix("0b", 2))
            .or_else(|| digits.parse().ok())
            .map(Value::Integer)
            .or_else(|| digits.parse().ok().map(Value::Real)),
    }
}

impl Text {
    /// Reads a text.
    pub(crate) fn parse(text: &str) -> Result<Text, Invalid> {
        let mut sections = vec![Section::default()];
        for (number, line) in (1..).zip(text.lines()) {
            let line = without_comment(line).trim();
            if line.is_empty() {
                continue;
            }
            let name = line.strip_prefix("[[").and_then(|rest| rest.strip_suffix("]]"));
            let single = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
            if let Some(name) = name.or(single) {
                let name = name.trim_matches(['[', ']', ' ']).to_owned();
                if line.starts_with("[[") || sections.iter().all(|known| known.name != name) {
                    sections.push(Section { name, keys: BTreeMap::new() });
                    continue;
                }
                return Err(bad(number, format!("section `{name}` stands there twice")));
            }
            let (key, rest) = line.split_once('=').ok_or_else(|| bad(number, "has no `=`"))?;
            let found = value(rest.trim())
                .ok_or_else(|| bad(number, format!("`{}` is no value", rest.trim())))?;
            let last = sections.len() - 1;
            let key = key.trim().to_owned();
            if sections[last].keys.insert(key.clone(), found).is_some() {
                return Err(bad(number, format!("key `{key}` stands there twice")));
            }
        }
        Ok(Text { sections })
    }

    /// Takes out the sections of a name, in their order.
    pub(crate) fn take(&mut self, name: &str) -> Vec<Section> {
        let (found, rest) = self.sections.drain(..).partition(|section| section.name == name);
        self.sections = rest;
        found
    }

    /// Refuses what nobody has asked for.
    pub(crate) fn finish(&self) -> Result<(), Invalid> {
        match self.sections.first() {
            None => Ok(()),
            Some(section) => {
                let remedy = "correct the name of the section";
                Err(Invalid::new(section.name.clone(), "is no part of a board", remedy))
            }
        }
    }
}

impl Section {
    fn place(&self, key: &str) -> String {
        if self.name.is_empty() { key.to_owned() } else { format!("{}.{key}", self.name) }
    }

    fn missing(&self, key: &str) -> Invalid {
        Invalid::new(self.place(key), "is missing", "give it")
    }

    fn wrong(&self, key: &str, kind: &str) -> Invalid {
        Invalid::new(self.place(key), format!("is no {kind}"), "correct the value")
    }

    /// A whole number of at least 0.
    pub(crate) fn optional<T: TryFrom<i64>>(&mut self, key: &str) -> Result<Option<T>, Invalid> {
        match self.keys.remove(key) {
            None => Ok(None),
            Some(Value::Integer(number)) => {
                T::try_from(number).map(Some).map_err(|_| self.wrong(key, "number of its kind"))
            }
            Some(_) => Err(self.wrong(key, "whole number")),
        }
    }

    /// A whole number that has to be there.
    pub(crate) fn number<T: TryFrom<i64>>(&mut self, key: &str) -> Result<T, Invalid> {
        self.optional(key)?.ok_or_else(|| self.missing(key))
    }

    /// A whole number or what stands for it.
    pub(crate) fn number_or<T: TryFrom<i64>>(
        &mut self,
        key: &str,
        default: T,
    ) -> Result<T, Invalid> {
        Ok(self.optional(key)?.unwrap_or(default))
    }

    /// A truth value; false where it is not given.
    pub(crate) fn truth(&mut self, key: &str) -> Result<bool, Invalid> {
        match self.keys.remove(key) {
            None => Ok(false),
            Some(Value::Truth(truth)) => Ok(truth),
            Some(_) => Err(self.wrong(key, "truth value")),
        }
    }

    /// A word, one of those given.
    pub(crate) fn word(&mut self, key: &str, words: &[&str]) -> Result<Option<usize>, Invalid> {
        match self.keys.remove(key) {
            None => Ok(None),
            Some(Value::Word(word)) => match words.iter().position(|known| *known == word) {
                Some(at) => Ok(Some(at)),
                None => Err(self.wrong(key, &format!("word of: {}", words.join(", ")))),
            },
            Some(_) => Err(self.wrong(key, "word")),
        }
    }

    /// Passes over a key that means nothing to the board itself.
    pub(crate) fn skip(&mut self, key: &str) {
        self.keys.remove(key);
    }

    /// Refuses keys that nobody has asked for.
    pub(crate) fn finish(self) -> Result<(), Invalid> {
        match self.keys.keys().next() {
            None => Ok(()),
            Some(key) => {
                Err(Invalid::new(self.place(key), "is no key of a board", "correct its name"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_keys_and_comments_are_told_apart() {
        let text =
            "name = \"a # b\" # c\n[x]\nn = 0x_10\nr = -1.5\nt = true\n[[y]]\na=1\n[[y]]\na=2";
        let mut text = Text::parse(text).unwrap();
        let head = text.take("").pop().unwrap();
        assert_eq!(head.keys["name"], Value::Word("a # b".to_owned()));
        let mut x = text.take("x").pop().unwrap();
        assert_eq!(x.number::<usize>("n"), Ok(16));
        assert_eq!(x.keys["r"], Value::Real(-1.5));
        assert_eq!(x.truth("t"), Ok(true));
        assert_eq!(x.clone().finish().unwrap_err().place, "x.r");
        let all: Vec<u32> =
            text.take("y").iter_mut().map(|section| section.number("a").unwrap()).collect();
        assert_eq!(all, [1, 2]);
        assert_eq!(text.finish(), Ok(()));
    }

    #[test]
    fn what_is_no_description_is_refused_at_its_line() {
        for (text, line) in [
            ("a = 1\nb", "line 2"),
            ("a =", "line 1"),
            ("a=1\na=2", "line 2"),
            ("[x]\n[x]", "line 2"),
        ] {
            assert_eq!(Text::parse(text).unwrap_err().place, line, "{text}");
        }
        let mut section = Text::parse("a = -1\nb = 1.5").unwrap().take("").pop().unwrap();
        assert_eq!(section.number::<usize>("a").unwrap_err().place, "a");
        assert_eq!(section.number::<usize>("b").unwrap_err().place, "b");
        assert_eq!(section.number::<usize>("c").unwrap_err().place, "c");
    }
}
