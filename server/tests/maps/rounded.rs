//! Text without the last digits of its numbers.

/// Decimals kept: sines and roots differ between machines in the last digits.
const N_DECIMALS: usize = 9;

/// Numbers with more decimals than are the same everywhere, shortened.
pub fn rounded(text: &str) -> String {
    let is_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+' | 'e');
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while !rest.is_empty() {
        let n_word = rest.find(|c: char| !is_number(c)).unwrap_or(rest.len());
        let (word, after) = rest.split_at(n_word);
        match word.parse::<f64>() {
            Ok(number) if word.contains('.') && !word.ends_with('.') => out.push_str(&shortened(number)),
            _ => out.push_str(word),
        }
        let n_between = after.find(is_number).unwrap_or(after.len());
        let (between, next) = after.split_at(n_between);
        out.push_str(between);
        rest = next;
    }
    out
}

fn shortened(number: f64) -> String {
    let text = format!("{number:.N_DECIMALS$}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

#[test]
fn only_long_numbers_are_shortened() {
    assert_eq!(rounded("a1 -0.1234567894999,2.50 x-7 1.2.3"), "a1 -0.123456789,2.5 x-7 1.2.3");
    assert_eq!(rounded("{\"x\":-1.3e-17}"), "{\"x\":0}");
    assert_eq!(rounded("keyframe_000002.png"), "keyframe_000002.png");
}
