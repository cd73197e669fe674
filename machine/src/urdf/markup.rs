//! The markup of a robot description, without what no robot description says: texts between tags,
//! comments, document types and sections of characters become blanks, and the colon behind a prefix
//! that no `xmlns` declares becomes an underscore. A parser of XML refuses a file for two hyphens
//! in a comment, for an ampersand in a text, and for the prefix of another program's element; none
//! of them describes an arm. No byte moves and no line ends elsewhere, so that places in the result
//! are places in the file.

use std::collections::BTreeSet;

/// Prefixes that need no declaration.
const KNOWN_PREFIXES: [&[u8]; 2] = [b"xml", b"xmlns"];

/// The tags of a text.
pub(super) fn tags_of(text: &str) -> String {
    let mut bytes = text.as_bytes().to_vec();
    let declared = declared_prefixes(text.as_bytes());
    let mut at = 0;
    while at < bytes.len() {
        let open = find(&bytes, at, b"<").unwrap_or(bytes.len());
        blank(&mut bytes[at..open]);
        at = open + unparsed(&bytes[open..]).unwrap_or(0);
        if at > open {
            blank(&mut bytes[open..at]);
            continue;
        }
        let end = open + tag_length(&bytes[open..]);
        join_prefixes(&mut bytes[open..end], &declared);
        at = end;
    }
    // What is blanked is blanked by whole characters, and an underscore takes a colon's place.
    String::from_utf8(bytes).unwrap_or_else(|_| text.to_owned())
}

/// Where a word begins, not before `from`.
pub(super) fn find(bytes: &[u8], from: usize, word: &[u8]) -> Option<usize> {
    let found = bytes.get(from..)?.windows(word.len()).position(|window| window == word);
    found.map(|offset| from + offset)
}

/// Where a comment, a section of characters, an instruction or a document type ends, with which
/// these bytes begin.
pub(super) fn unparsed(rest: &[u8]) -> Option<usize> {
    let kinds: [(&[u8], &[u8]); 3] = [(b"<!--", b"-->"), (b"<![CDATA[", b"]]>"), (b"<?", b"?>")];
    if let Some((open, close)) = kinds.into_iter().find(|(open, _)| rest.starts_with(open)) {
        let end = find(rest, open.len(), close);
        return Some(end.map_or(rest.len(), |at| at + close.len()));
    }
    rest.starts_with(b"<!DOCTYPE").then(|| {
        let end = find(rest, 0, b">").unwrap_or(rest.len() - 1);
        // Declarations of its own stand in brackets.
        match find(&rest[..end], 0, b"[").and_then(|at| find(rest, at, b"]")) {
            Some(inner) => find(rest, inner, b">").map_or(rest.len(), |at| at + 1),
            None => end + 1,
        }
    })
}

/// Bytes of the tag with which these bytes begin, up to its end, the next tag, or the end of the
/// text.
fn tag_length(rest: &[u8]) -> usize {
    let mut quote = None;
    for (at, byte) in rest.iter().copied().enumerate().skip(1) {
        match (quote, byte) {
            (_, b'<') => return at,
            (Some(open), _) if byte == open => quote = None,
            (None, b'"' | b'\'') => quote = Some(byte),
            (None, b'>') => return at + 1,
            _ => {}
        }
    }
    rest.len()
}

/// Turns all but the ends of lines into blanks.
fn blank(bytes: &mut [u8]) {
    bytes.iter_mut().filter(|byte| !matches!(byte, b'\n' | b'\r')).for_each(|byte| *byte = b' ');
}

/// The prefixes that `xmlns:PREFIX=` declares anywhere.
fn declared_prefixes(bytes: &[u8]) -> BTreeSet<Vec<u8>> {
    let mut declared: BTreeSet<Vec<u8>> = KNOWN_PREFIXES.iter().map(|name| name.to_vec()).collect();
    let (mut at, word) = (0, b"xmlns:");
    while let Some(found) = find(bytes, at, word) {
        at = found + word.len();
        declared.insert(bytes[at..].iter().copied().take_while(|byte| is_name(*byte)).collect());
    }
    declared
}

fn is_name(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-' | b'.') || byte >= 0x80
}

/// Joins undeclared prefixes of a tag's names with what follows them.
fn join_prefixes(tag: &mut [u8], declared: &BTreeSet<Vec<u8>>) {
    let (mut quote, mut name) = (None, 1);
    for at in 1..tag.len() {
        let byte = tag[at];
        match quote {
            Some(open) if byte == open => quote = None,
            Some(_) => {}
            None if matches!(byte, b'"' | b'\'') => quote = Some(byte),
            None if byte == b':' && !declared.contains(&tag[name..at]) => tag[at] = b'_',
            None => {}
        }
        if quote.is_some() || !is_name(byte) {
            name = at + 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_tags_are_left_and_stay_where_they_are() {
        for (text, tags) in [
            ("<a>x & y</a>", "<a>     </a>"),
            ("<!-- a -- b --><a/>\n<!---\n--->", "               <a/>\n     \n    "),
            ("<a b='<![CDATA['/>", "<a b='            "),
            ("<a><![CDATA[<b>]]></a>", "<a>               </a>"),
            ("<?xml version='1.0'?>\r\n<a/>", "                     \r\n<a/>"),
            ("<!DOCTYPE a [<!ENTITY b 'c>d'>]><a/>", "                                <a/>"),
            ("<!DOCTYPE robot><a/>", "                <a/>"),
            ("<a:b c:d='e:f' xmlns:c='g'/></a:b>", "<a_b c:d='e:f' xmlns:c='g'/></a_b>"),
            ("<a:b xmlns:a='c'></a:b>", "<a:b xmlns:a='c'></a:b>"),
            ("<ä:ö/>", "<ä_ö/>"),
            ("é<a/>é", "  <a/>  "),
        ] {
            assert_eq!(tags_of(text), tags, "{text}");
            assert_eq!(tags_of(text).len(), text.len(), "{text}");
        }
        for text in ["", "<", "<a", "<a b='", "<!--", "<!DOCTYPE", "<!DOCTYPE [", "<![CDATA[", ">"]
        {
            assert_eq!(tags_of(text).len(), text.len(), "{text}");
        }
    }
}
