//! The bounds of a robot description's text, held before it is parsed: what a parser of XML does
//! with elements, their depth, attributes and namespaces takes more than linear time in some of
//! them. A text that is no XML passes here, because the parser says what is wrong with it.

use std::ops::Range;

use super::markup::{find, unparsed};

/// Elements, comments and other markup; a dual-arm robot with its shapes has some 2,000.
const MARKUP_MAX: usize = 100_000;
/// Elements within each other; URDF needs 6.
const DEPTH_MAX: usize = 256;
/// Attributes of one element: the parser compares each with those before it.
const ATTRIBUTES_MAX: usize = 256;
/// Namespaces that a text declares: each element compares those around it.
const NAMESPACES_MAX: usize = 64;

/// A place at which a text is larger than a robot description.
pub(super) struct Excess {
    /// The bytes to mark.
    pub(super) span: Range<usize>,
    /// What there is too much of.
    pub(super) what: String,
}

/// Looks at every mark once.
///
/// # Errors
/// The first place at which a bound is passed.
pub(super) fn check(text: &str) -> Result<(), Excess> {
    let bytes = text.as_bytes();
    let excess = |at: usize, count: usize, of: &str| {
        let end = bytes.len().min(at + 1);
        Err(Excess { span: at..end, what: format!("has more than {count} {of}") })
    };
    let (mut at, mut marks, mut depth, mut namespaces) = (0, 0, 0_usize, 0);
    while let Some(start) = find(bytes, at, b"<") {
        marks += 1;
        if marks > MARKUP_MAX {
            return excess(start, MARKUP_MAX, "elements and comments");
        }
        let rest = &bytes[start..];
        if let Some(end) = unparsed(rest) {
            at = start + end;
            continue;
        }
        let tag = Tag::at(rest);
        at = start + tag.bytes;
        if tag.attributes > ATTRIBUTES_MAX {
            return excess(start, ATTRIBUTES_MAX, "attributes in one element");
        }
        namespaces += tag.namespaces;
        if namespaces > NAMESPACES_MAX {
            return excess(start, NAMESPACES_MAX, "declarations of namespaces");
        }
        match (rest.get(1), tag.is_empty) {
            (Some(b'/'), _) => depth = depth.saturating_sub(1),
            (_, true) => {}
            (_, false) => depth += 1,
        }
        if depth > DEPTH_MAX {
            return excess(start, DEPTH_MAX, "elements within each other");
        }
    }
    Ok(())
}

/// A tag.
struct Tag {
    bytes: usize,
    attributes: usize,
    namespaces: usize,
    /// Whether it closes itself.
    is_empty: bool,
}

impl Tag {
    /// The tag with which these bytes begin, up to its end, the next tag, or the end of the text.
    fn at(rest: &[u8]) -> Tag {
        let mut tag = Tag { bytes: rest.len(), attributes: 0, namespaces: 0, is_empty: false };
        let mut quote = None;
        for (at, byte) in rest.iter().copied().enumerate().skip(1) {
            match (quote, byte) {
                (_, b'<') => {
                    tag.bytes = at;
                    break;
                }
                (Some(open), _) if byte == open => quote = None,
                (Some(_), _) => {}
                (None, b'"' | b'\'') => quote = Some(byte),
                (None, b'=') => tag.attributes += 1,
                (None, b'x') if rest[at..].starts_with(b"xmlns") => tag.namespaces += 1,
                (None, b'>') => {
                    (tag.bytes, tag.is_empty) = (at + 1, rest[at - 1] == b'/');
                    break;
                }
                (None, _) => {}
            }
        }
        tag
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(text: &str) -> Option<(usize, String)> {
        check(text).err().map(|excess| (excess.span.start, excess.what))
    }

    #[test]
    fn what_is_in_comments_and_quotes_does_not_count() {
        let rule = format!("<!-- {} > <a> -->", "=".repeat(10_000));
        let quoted = format!("<a b='{}'/>", "x=/>".repeat(10_000));
        let section = format!("<![CDATA[{}]]>", "<a>".repeat(1_000));
        for text in [rule, quoted, section, "<a>".repeat(256), "<a><b/></a>".repeat(9_000)] {
            assert_eq!(refusal(&text), None, "{}", &text[..40]);
        }
    }

    #[test]
    fn each_bound_is_held_at_its_place() {
        let (deep, many) = ("<a>".repeat(257), "<a/>".repeat(100_001));
        let wide = format!("<r>\n<a {}/>", " b='1'".repeat(257));
        let spaces = "<a xmlns:b='c'/>".repeat(65);
        for (text, at, what) in [
            (&deep, 3 * 256, "256 elements within each other"),
            (&many, 4 * 100_000, "100000 elements and comments"),
            (&wide, 4, "256 attributes in one element"),
            (&spaces, 16 * 64, "64 declarations of namespaces"),
        ] {
            assert_eq!(refusal(text), Some((at, format!("has more than {what}"))));
        }
    }

    #[test]
    fn texts_that_are_no_xml_pass_to_the_parser() {
        for text in ["", "<", "<a", "<a b='", "<!--", "</a></a>", ">", "<a b=\"<c>"] {
            assert_eq!(refusal(text), None, "{text}");
        }
    }
}
