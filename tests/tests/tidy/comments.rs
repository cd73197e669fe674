//! Rules about comments: a paragraph stands alone, says something, and the first sentence of a
//! module is a sentence. Sense and grammar are left to reviewers.

use crate::ratchet::Complaint;
use crate::source::Rust;

/// Words that the first sentence of a module has at least.
const FIRST_SENTENCE_WORDS_MIN: usize = 4;
/// Words of an item up to which a sentence of at least three such items is a bare list.
const LIST_ITEM_WORDS_MAX: usize = 3;

/// Text between blank lines of a comment.
#[derive(Clone, Debug, PartialEq)]
struct Paragraph {
    /// The first line, counted from one.
    line: usize,
    /// `//`, `///` or `//!`.
    marker: &'static str,
    /// The words, one blank between them.
    text: String,
}

/// Complaints about comments that refuse nothing, and say so.
pub(crate) fn refusing_nothing(files: &[Rust]) -> Vec<Complaint> {
    let says = |text: &str| text.to_lowercase().contains(concat!("refuses ", "nothing"));
    complaints(files, |paragraph| says(&paragraph.text), "says that nothing is refused; leave it")
}

/// Complaints about comments and paragraphs that begin in the middle of a thought.
pub(crate) fn fragments(files: &[Rust]) -> Vec<Complaint> {
    let begins = |text: &str| {
        let text = text.strip_prefix("- ").unwrap_or(text);
        let word = text.split(|c: char| !c.is_alphanumeric()).next();
        word == Some("So") || word == Some("Of")
    };
    let text = "begins with `So` or `Of`; write a sentence that stands alone";
    complaints(files, |paragraph| begins(&paragraph.text), text)
}

/// Complaints about modules whose first sentence is none.
pub(crate) fn first_sentences(files: &[Rust]) -> Vec<Complaint> {
    let mut found = Vec::new();
    for file in files {
        let all = paragraphs(file);
        let Some(first) = all.first().filter(|first| first.marker == "//!") else { continue };
        if let Err(text) = check_first_sentence(&first.text) {
            found.push(Complaint::new(&file.path, first.line, text));
        }
    }
    found
}

fn complaints(files: &[Rust], bad: impl Fn(&Paragraph) -> bool, text: &str) -> Vec<Complaint> {
    let mut found = Vec::new();
    for file in files {
        let bad = paragraphs(file).into_iter().filter(|paragraph| bad(paragraph));
        found.extend(bad.map(|paragraph| Complaint::new(&file.path, paragraph.line, text)));
    }
    found
}

/// What is checkable of "a sentence with a subject and a verb": capital letter, full stop, length,
/// and that it is more than a list of nouns.
fn check_first_sentence(paragraph: &str) -> Result<(), &'static str> {
    let Some((sentence, _)) = paragraph.split_once(". ").or(paragraph.rsplit_once('.')) else {
        return Err("the first paragraph of the module has no full stop");
    };
    if sentence.starts_with(|c: char| c.is_lowercase()) {
        return Err("the first sentence of the module does not begin with a capital letter");
    }
    if sentence.split_whitespace().count() < FIRST_SENTENCE_WORDS_MIN {
        return Err("the first sentence of the module is too short to say what it is for");
    }
    let list = sentence.rsplit_once(": ").map_or(sentence, |(_, list)| list);
    let items: Vec<&str> = list.split(", ").collect();
    let short = |item: &&str| item.split_whitespace().count() <= LIST_ITEM_WORDS_MAX;
    if items.len() > 2 && list.len() == sentence.len() && items.iter().all(short) {
        return Err("the first sentence of the module is a bare list");
    }
    Ok(())
}

/// The paragraphs of all comments of a file; examples of code between fences are left out.
fn paragraphs(file: &Rust) -> Vec<Paragraph> {
    let mut found: Vec<Paragraph> = Vec::new();
    let mut fenced = false;
    let mut open = false;
    for (number, line) in file.lines.iter().enumerate() {
        let Some((marker, text)) = marked_text(&line.comment) else {
            (open, fenced) = (false, false);
            continue;
        };
        let fence = text.starts_with("```");
        fenced ^= fence;
        let alone = line.code.trim().is_empty();
        if fence || fenced || text.is_empty() {
            open = false;
            continue;
        }
        let same = found.last().is_some_and(|last| last.marker == marker);
        let item = ["- ", "* ", "# ", "| "].iter().any(|start| text.starts_with(start));
        match found.last_mut().filter(|_| open && same && alone && !item) {
            Some(last) => {
                last.text.push(' ');
                last.text.push_str(text);
            }
            None => {
                found.push(Paragraph { line: number + 1, marker, text: text.to_string() });
            }
        }
        // A comment behind code ends with its line.
        open = alone;
    }
    found
}

/// The slashes and the text of a line of comment.
fn marked_text(comment: &str) -> Option<(&'static str, &str)> {
    let found = ["//!", "///", "//"]
        .into_iter()
        .find_map(|marker| comment.strip_prefix(marker).map(|text| (marker, text.trim())));
    found.filter(|(marker, text)| *marker != "//" || !text.starts_with('/'))
}

#[cfg(test)]
fn file(raw: &str) -> [Rust; 1] {
    [Rust::new("hal/src/a.rs", raw)]
}

#[test]
fn a_refusal_of_nothing_is_seen() {
    assert_eq!(refusing_nothing(&file("//! What for. Refuses\n//! nothing.\n")).len(), 1);
    assert!(refusing_nothing(&file("//! Refuses\n\n// nothing\n")).is_empty());
}

#[test]
fn a_fragment_is_seen() {
    for bad in ["// So it goes.", "/// A.\n///\n/// Of the arm.", "let x = 1; // Of y", "//! - So"]
    {
        assert_eq!(fragments(&file(bad)).len(), 1, "{bad}");
    }
    for good in ["// Software.", "// A\n// Of b.", "/// ```\n/// // So\n/// ```", "// Often."] {
        assert!(fragments(&file(good)).is_empty(), "{good}");
    }
}

#[test]
fn a_module_without_a_first_sentence_is_seen() {
    for bad in [
        "//! contact of a pin with rubber.\n",
        "//! Contact of a pin with rubber\n//!\n//! Ends here.\n",
        "//! Numbers. Then more of them follow here.\n",
        "//! Rows, tables, the solver, work.\n",
    ] {
        assert_eq!(first_sentences(&file(bad)).len(), 1, "{bad}");
    }
    for good in [
        "//! Computes the image of a pin\n//! on rubber. More.\n",
        "//! The state machine of a drive.\n",
        "//! Rules about words: names, rooms, tests.\n",
        "fn f() {}\n// contact\n",
    ] {
        assert!(first_sentences(&file(good)).is_empty(), "{good}");
    }
}
