//! Texts without secrets: what a server answers, addresses with passwords, credentials of the environment.

/// The longest text.
const LONGEST: usize = 400;
/// The text in place of a secret.
const HIDDEN: &str = "***";
/// Shorter values are not looked for: they would be found in ordinary words.
const SHORTEST: usize = 6;
/// The words in the names of variables that hold secrets, and how the names of such variables begin.
const SECRETS: [&str; 8] = ["SECRET", "TOKEN", "KEY", "PASSWORD", "SAS", "CREDENTIAL", "SIGNATURE", "AUTHORIZATION"];
const PROVIDERS: [&str; 6] = ["AWS_", "AZURE_", "GOOGLE_", "GCP_", "OPENLINEAGE_", "MAGLINE_"];
/// After these a server's own words follow, which may repeat what it was sent.
const ANSWERS: [&str; 2] = ["status code: ", "error response: "];

/// An error without secrets. Of a server's answer the status and the code of the error are kept: all else may repeat
/// the headers of the request.
pub fn redacted(text: &str) -> String {
    let text = without_secrets(&without_answer(text));
    let words = text.split_whitespace().map(address).collect::<Vec<_>>().join(" ");
    words.chars().filter(|c| !c.is_control()).take(LONGEST).collect()
}

/// An address without user, password and query; any other word as it is.
pub fn address(word: &str) -> String {
    let Some((scheme, rest)) = word.split_once("://") else { return word.to_owned() };
    let (whole, tail) = match rest.find(['?', '#']) {
        Some(at) => rest.split_at(at),
        None => (rest, ""),
    };
    let (authority, path) = whole.split_once('/').map_or((whole, None), |(a, p)| (a, Some(p)));
    let host = authority.rsplit_once('@').map_or(authority, |(_, host)| host);
    // Brackets and the like that an address ends with are not part of it.
    let end: String = if tail.is_empty() { String::new() } else { ending(tail) };
    format!("{scheme}://{host}{}{end}", path.map(|p| format!("/{p}")).unwrap_or_default())
}

fn ending(tail: &str) -> String {
    let end: Vec<char> = tail.chars().rev().take_while(|c| matches!(c, ')' | ',' | ':' | ';' | '"' | '\'')).collect();
    end.into_iter().rev().collect()
}

fn without_answer(text: &str) -> String {
    let Some((at, mark)) = ANSWERS.iter().filter_map(|mark| text.find(mark).map(|at| (at, *mark))).min() else {
        // A document all the same.
        return text.split('<').next().unwrap_or_default().to_owned();
    };
    let (said, answer) = text.split_at(at + mark.len());
    // `403 Forbidden: BODY`
    let (status, body) = if mark == ANSWERS[0] { answer.split_once(':').unwrap_or((answer, "")) } else { ("", answer) };
    let status: String = status.chars().filter(|c| c.is_ascii_alphanumeric() || *c == ' ').take(40).collect();
    format!("{said}{status}{}", code(body).map(|code| format!(" {code}")).unwrap_or_default())
}

/// The code of the error in an answer, which is one plain word.
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
    fn unit_of_a_servers_answer_status_and_code_are_shown() {
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
