//! Configuration text and errors in it: every error names the file, the line, what is wrong and
//! what to do, and shows the line with a mark under the place. Only the first error of a file is
//! reported.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use taktil_rtcore::Invalid;
use taktil_rtcore::printable::{PART_BYTES_MAX, excerpt, is_obeyed};
use toml::de::{DeTable, DeValue};

use crate::renamed::renamed_key;
use crate::shipped::{self, ShippedFile};
use crate::strict;

/// Largest configuration file that is read: anything bigger is not one.
const FILE_BYTES_MAX: u64 = 4 << 20;
/// Longest path that is shown (bytes).
const PATH_BYTES_MAX: usize = 256;
/// Characters of a line that are shown.
const LINE_CHARACTERS_MAX: usize = 100;

/// What a file is meant to be, for whoever names another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A scene.
    Scene,
    /// A machine file.
    Machine,
    /// The service's configuration.
    Service,
    /// A table of a motion.
    Motion,
    /// An arm's description.
    Arm,
    /// A key map.
    Keys,
    /// A plan of faults.
    Faults,
    /// A touch task.
    Task,
}

impl FileKind {
    /// What to name instead of `path`.
    fn remedy(self, path: &Path) -> String {
        let remedy = match self {
            FileKind::Scene => return suggest(path),
            FileKind::Machine => "name a machine file, such as sim/scenes/machine/puma260.toml",
            FileKind::Service => "name the service's configuration; systemd/taktild.toml is one",
            FileKind::Motion => "name a CSV file by its path from the scene's folder",
            FileKind::Arm => "name a URDF file, such as sim/arms/puma260.urdf",
            FileKind::Keys => "name a key map; `taktil keys --list` prints one",
            FileKind::Faults => {
                "name a plan of faults; `taktil hal emulate --help` shows how one looks"
            }
            FileKind::Task => "name a task, such as sim/scenes/touch/press.toml",
        };
        remedy.to_owned()
    }
}

/// A configuration file, read.
#[derive(Clone, Debug)]
pub struct Source {
    /// Where it came from.
    pub path: PathBuf,
    /// Its text.
    pub text: String,
}

/// A complaint about a place in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Located {
    /// The file.
    pub path: PathBuf,
    /// Line, column (both from 1), the line's text, and how many characters to mark; absent when
    /// the file could not be read.
    pub mark: Option<Mark>,
    /// What is wrong.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
}

/// A place in a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mark {
    /// Line number from 1.
    pub line: usize,
    /// Column from 1, in characters.
    pub column: usize,
    /// The line itself.
    pub text: String,
    /// Characters to mark, at least 1.
    pub width: usize,
}

impl fmt::Display for Located {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "error: {}", excerpt(&self.what, PART_BYTES_MAX))?;
        let path = excerpt(&self.path.display().to_string(), PATH_BYTES_MAX);
        match &self.mark {
            None => writeln!(f, "  --> {path}")?,
            Some(mark) => {
                let number = mark.line.to_string();
                let margin = " ".repeat(number.len());
                writeln!(f, "{margin} --> {path}:{}:{}", mark.line, mark.column)?;
                writeln!(f, "{margin} |")?;
                let window = mark.window();
                writeln!(f, "{number} | {}", window.text)?;
                let indent = " ".repeat(window.column - 1);
                writeln!(f, "{margin} | {indent}{}", "^".repeat(window.width))?;
            }
        }
        write!(f, "  = {}", excerpt(&self.remedy, PART_BYTES_MAX))
    }
}

impl Mark {
    /// The part of a long line around the marked characters. What a terminal would obey, or would
    /// show wider than one character, is a dot: the mark stands under its place.
    fn window(&self) -> Mark {
        let before = self.column.saturating_sub(1);
        let first = if before + self.width.min(LINE_CHARACTERS_MAX) <= LINE_CHARACTERS_MAX {
            0
        } else {
            before.saturating_sub(LINE_CHARACTERS_MAX / 2)
        };
        let (column, width) = (before - first + 1, self.width.min(LINE_CHARACTERS_MAX));
        let visible = |c: char| if c == '\t' || is_obeyed(c) { '\u{b7}' } else { c };
        let text = self.text.chars().skip(first).take(LINE_CHARACTERS_MAX).map(visible).collect();
        Mark { line: self.line, column, text, width: width.min(LINE_CHARACTERS_MAX + 1 - column) }
    }
}

impl std::error::Error for Located {}

impl From<ShippedFile> for Source {
    fn from(file: ShippedFile) -> Source {
        Source { path: PathBuf::from(file.path), text: file.text.to_owned() }
    }
}

impl Source {
    /// What a scene in the folder `folder` names: the file on disk, or else the one that a scene of
    /// the program's own would name so. `machine/puma260.toml` is thus found by a scene anywhere.
    ///
    /// # Errors
    /// As [`Source::read`], about the file on disk.
    pub fn read_beside(folder: &Path, name: &str, kind: FileKind) -> Result<Source, Located> {
        let path = folder.join(name);
        let below = Path::new(shipped::SCENES_FOLDER).join(name);
        match (path.exists(), shipped::find(&below, kind == FileKind::Scene)) {
            (false, Some(file)) => Ok(Source::from(file)),
            _ => Source::read(&path, kind),
        }
    }

    /// Reads a file that is meant to be something. Where none lies on disk, one that the program
    /// holds within itself is taken ([`shipped::find`]); its path is then the one in the
    /// repository.
    ///
    /// # Errors
    /// Missing, a directory, too big, not UTF-8, empty.
    pub fn read(path: &Path, kind: FileKind) -> Result<Source, Located> {
        let complain = |what: String, remedy: String| {
            Err(Located { path: path.to_owned(), mark: None, what, remedy })
        };
        let other = || kind.remedy(path);
        let shown = path.display();
        let refused = |error: std::io::Error| {
            complain(format!("`{shown}` cannot be read: {error}"), "check its rights".to_owned())
        };
        let about = match std::fs::metadata(path) {
            Ok(about) => about,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                if let Some(file) = shipped::find(path, kind == FileKind::Scene) {
                    return Ok(Source::from(file));
                }
                return complain(format!("there is no file `{shown}`"), other());
            }
            Err(error) => return refused(error),
        };
        if about.is_dir() {
            return complain(format!("`{shown}` is a directory"), other());
        }
        if !about.is_file() {
            return complain(format!("`{shown}` is not a regular file"), other());
        }
        if about.len() > FILE_BYTES_MAX {
            let what = format!("`{shown}` has {} bytes: too big for a configuration", about.len());
            return complain(what, other());
        }
        match std::fs::read(path).map(String::from_utf8) {
            Ok(Ok(text)) if text.trim().is_empty() => {
                complain(format!("`{shown}` is empty"), other())
            }
            Ok(Ok(text)) => Ok(Source { path: path.to_owned(), text }),
            // A comment in an older encoding says nothing about an arm.
            Ok(Err(bytes)) if kind == FileKind::Arm && !bytes.as_bytes().contains(&0) => {
                let text = String::from_utf8_lossy(bytes.as_bytes()).into_owned();
                Ok(Source { path: path.to_owned(), text })
            }
            Ok(Err(_)) => complain(format!("`{shown}` is not text"), other()),
            Err(error) => refused(error),
        }
    }

    /// The folder in which the file lies.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// Parses the text.
    ///
    /// # Errors
    /// Syntax, unknown keys, wrong types, missing keys: located.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, Located> {
        strict::read_text(&self.text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            let message = error.message().replace('\n', " ");
            let place = self.key_at(span.start);
            let (message, remedy) = in_words(place.as_deref().unwrap_or(""), message);
            let what = match place {
                Some(key) => format!("{key}: {message}"),
                None => message,
            };
            Located { path: self.path.clone(), mark: Some(self.mark(&span)), what, remedy }
        })
    }

    /// Whether a place (a dotted path) is written in this file, to its full depth.
    #[must_use]
    pub fn contains(&self, place: &str) -> bool {
        self.find(place).is_some_and(|(_, complete)| complete)
    }

    /// Puts a complaint at its place in this file, or at the deepest enclosing table that is there.
    #[must_use]
    pub fn locate(&self, invalid: Invalid) -> Located {
        let span = self.find(&invalid.place).map_or(0..0, |(span, _)| span);
        let what = if invalid.place.is_empty() {
            invalid.what
        } else {
            format!("{}: {}", invalid.place, invalid.what)
        };
        let (path, mark) = (self.path.clone(), Some(self.mark(&span)));
        Located { path, mark, what, remedy: invalid.remedy }
    }

    fn find(&self, place: &str) -> Option<(Range<usize>, bool)> {
        let table = DeTable::parse(&self.text).ok()?;
        let span = table.span();
        let value = DeValue::Table(table.into_inner());
        Some(descend(&value, place, span.start..span.start))
    }

    /// The dotted path of the innermost key or value that lies at a byte of the text.
    fn key_at(&self, at: usize) -> Option<String> {
        let table = DeTable::parse(&self.text).ok()?;
        path_at(&DeValue::Table(table.into_inner()), "", at)
    }

    /// The first line of some bytes of the text, with the bytes marked.
    pub(crate) fn mark(&self, span: &Range<usize>) -> Mark {
        let start = span.start.min(self.text.len());
        let before = &self.text[..char_boundary(&self.text, start)];
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        let line_end =
            self.text[line_start..].find('\n').map_or(self.text.len(), |n| line_start + n);
        let end = char_boundary(&self.text, span.end.clamp(start, line_end.max(start)));
        let text = self.text[line_start..line_end].trim_end().to_owned();
        let width = self.text.get(start..end).map_or(1, |marked| marked.chars().count()).max(1);
        Mark {
            line: before.matches('\n').count() + 1,
            column: self.text[line_start..before.len()].chars().count() + 1,
            text,
            width,
        }
    }
}

/// The path, under `place`, of the innermost key or value that holds a byte of the text.
fn path_at(value: &DeValue<'_>, place: &str, at: usize) -> Option<String> {
    let within = |span: Range<usize>| span.contains(&at);
    match value {
        DeValue::Table(table) => table.iter().find_map(|(key, inner)| {
            let dot = if place.is_empty() { "" } else { "." };
            let path = format!("{place}{dot}{}", key.get_ref());
            let here = within(key.span()) || within(inner.span());
            path_at(inner.get_ref(), &path, at).or_else(|| here.then_some(path))
        }),
        DeValue::Array(array) => array.iter().enumerate().find_map(|(index, inner)| {
            let path = format!("{place}[{index}]");
            let here = within(inner.span());
            path_at(inner.get_ref(), &path, at).or_else(|| here.then_some(path))
        }),
        _ => None,
    }
}

fn char_boundary(text: &str, mut at: usize) -> usize {
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

/// Follows a dotted path; keys may contain dots themselves, so the longest key that fits is tried
/// first.
fn descend(value: &DeValue<'_>, place: &str, here: Range<usize>) -> (Range<usize>, bool) {
    if place.is_empty() {
        return (here, true);
    }
    match value {
        DeValue::Table(table) => {
            let ends = place.len()..=place.len();
            let cuts =
                place.char_indices().filter(|(_, c)| matches!(c, '.' | '[')).map(|(at, _)| at);
            for cut in ends.chain(cuts.collect::<Vec<_>>().into_iter().rev()) {
                if let Some((key, inner)) =
                    table.iter().find(|(key, _)| key.get_ref().as_ref() == &place[..cut])
                {
                    let rest = place[cut..].trim_start_matches('.');
                    let span = if rest.is_empty() && !matches!(inner.get_ref(), DeValue::Table(_)) {
                        inner.span()
                    } else {
                        key.span()
                    };
                    return descend(inner.get_ref(), rest, span);
                }
            }
            (here, false)
        }
        DeValue::Array(array) => {
            let (index, rest) = match place.strip_prefix('[').and_then(|p| p.split_once(']')) {
                Some((index, rest)) => (index.parse::<usize>().ok(), rest.trim_start_matches('.')),
                None => {
                    let holds = |item: &DeValue<'_>| match item {
                        DeValue::String(text) => text.as_ref() == place,
                        _ => false,
                    };
                    let named = array.iter().position(|item| holds(item.get_ref()));
                    (named, "")
                }
            };
            match index.and_then(|index| array.get(index)) {
                Some(item) => descend(item.get_ref(), rest, item.span()),
                None => (here, false),
            }
        }
        _ => (here, false),
    }
}

/// Files that may have been kind.
fn suggest(path: &Path) -> String {
    let folder = if path.is_dir() { Some(path) } else { path.parent() };
    let folder = folder.filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|ext| ext == "toml") && is_scene(path))
        .map(|path| path.display().to_string())
        .collect();
    names.sort();
    names.truncate(8);
    if names.is_empty() {
        "name a scene, such as sim/scenes/roll-pin.toml".to_owned()
    } else {
        format!("name one of: {}", names.join(", "))
    }
}

/// Whether a file looks like a scene: it has a title.
fn is_scene(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|about| about.len() <= FILE_BYTES_MAX)
        && std::fs::read_to_string(path)
            .is_ok_and(|text| text.lines().any(|line| line.starts_with("title")))
}

/// A complaint of the TOML reader about the key at `place`, and what to do about it.
fn in_words(place: &str, message: String) -> (String, String) {
    let unknown = message.strip_prefix("unknown field `").and_then(|rest| rest.split_once('`'));
    match unknown.and_then(|(old, _)| Some((old, renamed_key(place, old)?))) {
        Some((old, new)) => {
            (format!("unknown key `{old}`; it is called `{new}` now"), format!("write `{new}`"))
        }
        None => {
            let remedy = remedy_for(&message);
            (message, remedy)
        }
    }
}

/// What to do about a complaint of the TOML reader.
fn remedy_for(what: &str) -> String {
    if let Some(rest) = what.strip_prefix("unknown field `")
        && let Some((found, expected)) = rest.split_once('`')
    {
        let mut known: Vec<&str> = expected.split('`').skip(1).step_by(2).collect();
        let is_word = found.len() <= WORD_BYTES_MAX;
        if is_word {
            known.sort_by_key(|candidate| distance(found, candidate));
        }
        return match known.first() {
            Some(best) if is_word && distance(found, best) <= found.len().max(best.len()) / 2 => {
                format!("did you mean `{best}`? otherwise take the key out")
            }
            Some(_) => format!("known keys: {}", known.join(", ")),
            None => "take the key out".to_owned(),
        };
    }
    if let Some(missing) = what.strip_prefix("missing field `") {
        return format!("add `{} = ...`", missing.trim_end_matches('`'));
    }
    if what.starts_with("invalid length") {
        return "give as many values as are expected".to_owned();
    }
    if what.starts_with("invalid type") {
        return "give a value of the expected type; keys end in their unit".to_owned();
    }
    "correct the TOML text here".to_owned()
}

/// Longest word to which similar ones are looked for (bytes): that takes time with its length and
/// with that of each known one.
const WORD_BYTES_MAX: usize = 64;

/// Levenshtein distance.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substitution = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substitution.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests;
