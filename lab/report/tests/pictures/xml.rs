//! A simple check that tags nest and text is escaped. It rejects what no XML parser accepts; of
//! HTML it knows only the doctype and the elements without an end tag.

/// Panics unless every element is closed in order and no bare `&` or `<` stands in text.
pub(crate) fn check(text: &str) {
    walk(text, &[]);
}

/// Like [`check`], for an HTML page.
pub(crate) fn check_html(text: &str) {
    let body = text.strip_prefix("<!doctype html>\n").expect("a page starts with its doctype");
    // A style sheet is not markup.
    let (before, rest) = body.split_once("<style>").expect("the page has a style sheet");
    let (style, after) = rest.split_once("</style>").expect("the style sheet ends");
    assert!(!style.contains('<'));
    walk(&format!("{before}{after}"), &["meta"]);
}

fn walk(text: &str, endless: &[&str]) {
    let mut open: Vec<String> = Vec::new();
    let mut rest = text;
    while let Some(start) = rest.find('<') {
        entities(&rest[..start]);
        let end = start + rest[start..].find('>').expect("a tag ends");
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        assert_eq!(tag.matches('"').count() % 2, 0, "quotes of <{tag}>");
        entities(tag);
        let name = tag.trim_matches('/').split_whitespace().next().expect("a tag has a name");
        assert!(name.chars().all(|c| c.is_ascii_alphanumeric()), "<{tag}>");
        if tag.starts_with('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "</{name}> closes nothing");
        } else if !tag.ends_with('/') && !endless.contains(&name) {
            open.push(name.to_owned());
        }
    }
    entities(rest);
    assert!(open.is_empty(), "left open: {open:?}");
}

fn entities(text: &str) {
    for (at, _) in text.match_indices('&') {
        let tail = &text[at + 1..];
        let name = tail.split(';').next().unwrap_or_default();
        let known = ["amp", "lt", "gt", "quot", "#39"];
        assert!(known.contains(&name), "bare & in {:?}", &text[at..text.len().min(at + 20)]);
    }
}
