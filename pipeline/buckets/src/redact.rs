//! Removal of secrets from strings: answers of a server, addresses with passwords, credentials of the environment.

/// Maximum length of an error text, in characters.
const LONGEST: usize = 400;
/// Replacement of a secret.
const HIDDEN: &str = "***";
/// Minimum length of a secret: shorter values would occur in ordinary words.
const SHORTEST: usize = 6;
/// Words that occur in the names of variables with secrets, and prefixes of such names.
const SECRETS: [&str; 8] = ["SECRET", "TOKEN", "KEY", "PASSWORD", "SAS", "CREDENTIAL", "SIGNATURE", "AUTHORIZATION"];
const PROVIDERS: [&str; 6] = ["AWS_", "AZURE_", "GOOGLE_", "GCP_", "OPENLINEAGE_", "MAGLINE_"];
/// Phrases that precede the text of a server; the text may repeat parts of the request.
const ANSWERS: [&str; 2] = ["status code: ", "error response: "];

/// Removes secrets from an error. Keeps only status and error code of a server's answer, because its text may repeat
/// the headers of the request.
pub fn redacted(text: &str) -> String {
    let text = without_secrets(&without_answer(text));
    let words = text.split_whitespace().map(address).collect::<Vec<_>>().join(" ");
    words.chars().filter(|c| !c.is_control()).take(LONGEST).collect()
}

/// Removes user, password and query from an address; keeps any other word.
pub fn address(word: &str) -> String {
    let Some((scheme, rest)) = word.split_once("://") else { return word.to_owned() };
    let (whole, tail) = match rest.find(['?', '#']) {
        Some(at) => rest.split_at(at),
        None => (rest, ""),
    };
    let (authority, path) = whole.split_once('/').map_or((whole, None), |(a, p)| (a, Some(p)));
    let host = authority.rsplit_once('@').map_or(authority, |(_, host)| host);
    // Trailing brackets and punctuation are not part of an address.
    let end: String = if tail.is_empty() { String::new() } else { ending(tail) };
    format!("{scheme}://{host}{}{end}", path.map(|p| format!("/{p}")).unwrap_or_default())
}

fn ending(tail: &str) -> String {
    let end: Vec<char> = tail.chars().rev().take_while(|c| matches!(c, ')' | ',' | ':' | ';' | '"' | '\'')).collect();
    end.into_iter().rev().collect()
}

fn without_answer(text: &str) -> String {
    let Some((at, mark)) = ANSWERS.iter().filter_map(|mark| text.find(mark).map(|at| (at, *mark))).min() else {
        // An error without such a phrase may still contain an XML document from the server, which begins with `<`.
        return text.split('<').next().unwrap_or_default().to_owned();
    };
    let (before_answer, answer) = text.split_at(at + mark.len());
    // `403 Forbidden: BODY`
    let (status, body) = if mark == ANSWERS[0] { answer.split_once(':').unwrap_or((answer, "")) } else { ("", answer) };
    let status: String = status.chars().filter(|c| c.is_ascii_alphanumeric() || *c == ' ').take(40).collect();
    format!("{before_answer}{status}{}", code(body).map(|code| format!(" {code}")).unwrap_or_default())
}

/// Error code in an answer; `None` unless it is one plain word.
fn code(body: &str) -> Option<&str> {
    let (_, rest) = body.split_once("<Code>")?;
    let (code, _) = rest.split_once("</Code>")?;
    (code.len() <= 60 && code.chars().all(|c| c.is_ascii_alphabetic())).then_some(code)
}

/// Replaces the credentials of the environment.
fn without_secrets(text: &str) -> String {
    let named = |name: &str| {
        let name = name.to_ascii_uppercase();
        PROVIDERS.iter().any(|p| name.starts_with(p)) && SECRETS.iter().any(|s| name.contains(s))
    };
    let secrets =
        std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
    let secrets = secrets.filter(|(name, value)| named(name) && value.len() >= SHORTEST);
    secrets.fold(text.to_owned(), |text, (_, secret)| text.replace(&secret, HIDDEN))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_only_status_and_code_of_a_server_answer_are_shown() {
        let echo = "<Error><Code>AccessDenied</Code><Message>You sent {'authorization': 'geheim'}</Message></Error>";
        let text = format!("Generic S3 error: Server returned non-2xx status code: 403 Forbidden: {echo}");
        assert_eq!(
            redacted(&text),
            "Generic S3 error: Server returned non-2xx status code: 403 Forbidden AccessDenied"
        );
        for body in [
            "geheim",
            "<Code>geheim 1</Code>",
            "{\"error\": \"geheim\"}",
            "<Code>Access-geheim</Code>",
            "\u{1b}[31mgeheim",
        ] {
            for before in ["status code: 500 Internal Server Error: ", "Server returned error response: "] {
                let shown = redacted(&format!("{before}{body}"));
                assert!(!shown.contains("geheim") && !shown.contains('\u{1b}'), "{shown}");
            }
        }
        assert!(!redacted("got <html>geheim</html>").contains("geheim"));
    }

    #[test]
    fn unit_addresses_lose_user_password_and_query() {
        for (text, shown) in [
            ("http://me:geheim@host:1/b/k", "http://host:1/b/k"),
            ("(http://geheim@host)", "(http://host)"),
            ("https://host/a?X-Amz-Signature=geheim", "https://host/a"),
            ("https://host/a?sig=geheim):", "https://host/a):"),
            ("https://a:b@c:geheim@host", "https://host"),
            ("no address", "no address"),
        ] {
            assert_eq!(redacted(text), shown);
        }
    }
}
