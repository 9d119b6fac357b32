//! Text for a terminal: control characters in names from files are escaped.

use std::borrow::Cow;

/// Whether a terminal interprets a character instead of printing it: ASCII and Unicode controls, text direction marks,
/// and separators of lines and paragraphs. Tab and line feed are excluded.
fn is_obeyed(c: char) -> bool {
    c.is_control() && !matches!(c, '\n' | '\t')
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{061c}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn escaped(text: &str, is: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is(c) {
            // JSON escapes, so that a JSON string remains valid.
            shown.push_str(&format!("\\u{:04x}", u32::from(c)));
        } else {
            shown.push(c);
        }
    }
    Cow::Owned(shown)
}

/// The text with control characters escaped in the form `\u001b`. Line feeds and tabs are unchanged.
pub fn visible(text: &str) -> Cow<'_, str> {
    escaped(text, is_obeyed)
}

/// The text on one line, with control characters, tabs and line feeds escaped in the form `\u001b`.
pub fn one_line(text: &str) -> Cow<'_, str> {
    escaped(text, |c| is_obeyed(c) || matches!(c, '\n' | '\t'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_control_characters_are_escaped() {
        let hostile = "a\u{1b}[2J\u{7}\r\u{9b}b\u{202e}c\u{2066}\0d\u{7f}";
        assert_eq!(visible(hostile), "a\\u001b[2J\\u0007\\u000d\\u009bb\\u202ec\\u2066\\u0000d\\u007f");
        assert_eq!(visible("one\n\ttwo \u{e9} \u{65e5}"), "one\n\ttwo \u{e9} \u{65e5}");
        assert_eq!(one_line("one\n\ttwo"), "one\\u000a\\u0009two");
    }
}
