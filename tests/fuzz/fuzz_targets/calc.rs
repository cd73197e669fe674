//! Request lines of `taktil calc`: one answer for each, a JSON object that is a success or a
//! refusal, with no number that is not finite (JSON would say null). Requests about contact may be
//! as long as they ask to be; here only those about the arm are carried out.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let lines: Vec<&[u8]> =
        bytes.split(|byte| *byte == b'\n').filter(|line| !line.trim_ascii().is_empty()).collect();
    if lines.iter().any(|line| is_long(line)) {
        return;
    }
    let mut answers = Vec::new();
    taktil_lab_calc::filter(&mut &bytes[..], &mut answers)
        .expect("nothing here can fail to be read");
    let answers = String::from_utf8(answers).expect("answers are text");
    assert_eq!(answers.lines().count(), lines.len(), "one answer a line: {answers}");
    for answer in answers.lines() {
        assert!(answer.starts_with('{') && answer.ends_with('}'), "{answer}");
        assert!(answer.contains("\"ok\":true") != answer.contains("\"ok\":false"), "{answer}");
    }
});

/// Whether a line might ask for much work: of contact, or again and again.
fn is_long(line: &[u8]) -> bool {
    let has = |word: &[u8]| line.windows(word.len()).any(|part| part == word);
    [&b"repeat"[..], b"layer_line", b"contact", b"feature_jacobian", b"recover", b"\\u"]
        .into_iter()
        .any(has)
}
