//! A message of a page: the token, words for the machine, signals to send, or how far it has read.

use serde_json::Value;

/// Deepest nesting of a message.
const DEPTH_MAX: usize = 8;
/// Longest words (bytes), as the machine takes them.
const WORDS_BYTES_MAX: usize = 1024;
/// Signals that one page may ask for beyond those that all pages get.
pub(crate) const TRACES_MAX: usize = 12;
/// Longest name of a signal (bytes).
const NAME_BYTES_MAX: usize = 128;

/// What a page says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PageMessage {
    /// It knows the control token.
    Token {
        /// The number under which to answer.
        id: u64,
        /// What it takes for the token.
        token: String,
    },
    /// It says words to the machine.
    Say {
        /// The number under which to answer.
        id: u64,
        /// The words.
        words: String,
    },
    /// It wants these signals with the others.
    Trace {
        /// The number under which to answer.
        id: u64,
        /// Signals, fields or elements by their names.
        paths: Vec<String>,
    },
    /// It has taken the update with this number.
    Seen(u64),
}

/// Reads a message.
///
/// # Errors
/// What is wrong with it, as a sentence for people.
pub fn read_message(text: &str) -> Result<PageMessage, &'static str> {
    if depth(text) > DEPTH_MAX {
        return Err("nested too deeply");
    }
    let Ok(Value::Object(object)) = serde_json::from_str::<Value>(text) else {
        return Err("a message is a JSON object");
    };
    if let Some(seen) = object.get("seen").filter(|_| object.len() == 1) {
        return seen.as_u64().map(PageMessage::Seen).ok_or("`seen` is no number of an update");
    }
    let Some(id) = object.get("id").and_then(Value::as_u64) else {
        return Err("`id` is no whole number");
    };
    if object.len() != 2 {
        return Err("a message has `id` and one of `token`, `say` and `trace`");
    }
    let text_of = |key: &str| object.get(key).and_then(Value::as_str);
    if let Some(token) = text_of("token") {
        return Ok(PageMessage::Token { id, token: token.to_owned() });
    }
    if let Some(words) = text_of("say") {
        let is_one_line = !words.contains(['\n', '\r']);
        return match words.len() <= WORDS_BYTES_MAX && is_one_line {
            true => Ok(PageMessage::Say { id, words: words.trim().to_owned() }),
            false => Err("say one thing, in at most 1024 bytes"),
        };
    }
    let Some(Value::Array(paths)) = object.get("trace") else {
        return Err("a message has `id` and one of `token`, `say` and `trace`");
    };
    let name = |path: &Value| {
        let path = path.as_str()?;
        let is_name = |c: char| c.is_ascii_alphanumeric() || "_.[]".contains(c);
        let fits = !path.is_empty() && path.len() <= NAME_BYTES_MAX;
        (fits && path.chars().all(is_name)).then(|| path.to_owned())
    };
    if paths.len() > TRACES_MAX {
        return Err("at most 12 signals are sent to one page beyond the usual ones");
    }
    match paths.iter().map(name).collect::<Option<Vec<String>>>() {
        Some(paths) => Ok(PageMessage::Trace { id, paths }),
        None => Err("a signal is named as in `sense.joints.q_rad[0]`"),
    }
}

/// How deep brackets are nested outside texts; wrong for what is no JSON, which is refused anyway.
fn depth(text: &str) -> usize {
    let (mut depth, mut deepest, mut in_text, mut escaped) = (0usize, 0, false, false);
    for byte in text.bytes() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_text => escaped = true,
            b'"' => in_text = !in_text,
            b'{' | b'[' if !in_text => {
                depth += 1;
                deepest = deepest.max(depth);
            }
            b'}' | b']' if !in_text => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    deepest
}

/// Whether words only ask, or stop: what a page may say that does not know the token.
pub(crate) fn is_for_viewers(words: &str) -> bool {
    let mut all = words.split('#').next().unwrap_or_default().split_whitespace();
    let (first, second) = (all.next().unwrap_or_default(), all.next());
    match first {
        "state" | "status" | "model" | "signals" | "parameters" | "control" | "help"
        | "version" | "stop" => second.is_none(),
        "scope" => true,
        "fault" => second == Some("list"),
        _ => false,
    }
}

/// Whether words say `stop` and nothing else.
pub(crate) fn is_stop(words: &str) -> bool {
    let mut all = words.split('#').next().unwrap_or_default().split_whitespace();
    all.next() == Some("stop") && all.next().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_read_and_anything_else_is_refused_with_a_reason() {
        let read = |text: &str| read_message(text);
        assert_eq!(read("{\"seen\":7}"), Ok(PageMessage::Seen(7)));
        let say = PageMessage::Say { id: 1, words: "jog joints 0 0 1 0 0 0".into() };
        assert_eq!(read("{\"id\":1,\"say\":\" jog joints 0 0 1 0 0 0 \"}"), Ok(say));
        let trace = PageMessage::Trace { id: 2, paths: vec!["a.b_c[3]".into()] };
        assert_eq!(read("{\"id\":2,\"trace\":[\"a.b_c[3]\"]}"), Ok(trace));
        let deep = format!("{{\"id\":1,\"say\":{}{}}}", "[".repeat(9), "]".repeat(9));
        let long = format!("{{\"id\":1,\"say\":\"{}\"}}", "x".repeat(1025));
        let many = format!("{{\"id\":1,\"trace\":[{}]}}", ["\"a\""; 13].join(","));
        for bad in [
            "",
            "[]",
            "null",
            "{\"id\":1}",
            "{\"id\":-1,\"say\":\"stop\"}",
            "{\"id\":1e999,\"say\":\"stop\"}",
            "{\"say\":\"stop\"}",
            "{\"id\":1,\"say\":\"a\\nstop\"}",
            "{\"id\":1,\"say\":\"a\\rb\"}",
            "{\"id\":1,\"say\":7}",
            "{\"id\":1,\"say\":\"state\",\"more\":1}",
            "{\"id\":1,\"trace\":[\"a b\"]}",
            "{\"id\":1,\"trace\":[\"\"]}",
            "{\"seen\":-1}",
            &deep,
            &long,
            &many,
        ] {
            assert!(read(bad).is_err_and(|why| !why.is_empty()), "{bad}");
        }
    }

    #[test]
    fn who_does_not_know_the_token_may_ask_and_stop_and_nothing_else() {
        for words in ["stop", "status", "scope off", "fault list", "stop # now", "control"] {
            assert!(is_for_viewers(words), "{words}");
        }
        for words in [
            "",
            "enable",
            "jog joints 0 0 0 0 0 0",
            "release",
            "set a 1",
            "move by 0 0 1",
            "watch 1 a",
            "control take",
            "control release",
            "fault reset",
            "record start",
            "reset",
            "stop now",
            "#stop",
            "pause",
            "wait",
        ] {
            assert!(!is_for_viewers(words), "{words}");
        }
        assert!(is_stop("stop") && is_stop(" stop # x") && !is_stop("stopp") && !is_stop(""));
    }
}
