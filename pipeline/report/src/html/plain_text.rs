//! Text of markup, without tags and character references.

/// The text of a markup, without tags.
pub fn plain_text(markup: &str) -> String {
    let mut plain = String::new();
    let mut in_tag = false;
    for c in markup.chars() {
        match c {
            '<' => in_tag = true,
            '>' if in_tag => in_tag = false,
            c if !in_tag => plain.push(c),
            _ => {}
        }
    }
    unescaped(&plain.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// A string with its character references replaced.
pub fn unescaped(text: &str) -> String {
    text.replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", "\"").replace("&#39;", "'").replace("&amp;", "&")
}
