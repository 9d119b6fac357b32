//! Authenticates clients by the token, which is given as `Bearer TOKEN`, or as the password with any user name.

use base64::{Engine, prelude::BASE64_STANDARD_NO_PAD};
use schemas::Fault;
use tonic::{Request, Status, metadata::MetadataMap, service::Interceptor};

use super::PortClient;

/// Minimum number of characters of a token.
const SHORTEST: usize = 16;

const WRONG: &str =
    "the token is missing or wrong; send it as `authorization: Bearer TOKEN`, or as the password with any user name";

/// Secret that clients must present. The secret is compared by its hash, in constant time.
#[derive(Clone)]
pub struct Token {
    text: String,
    hash: blake3::Hash,
}

impl Token {
    /// Reads the text of a token file: one word of at least 16 visible ASCII characters.
    ///
    /// # Errors
    /// Fails for any other text.
    pub fn read(text: &str) -> Result<Token, Fault> {
        let text = text.trim();
        let fault = |what: String| Fault::new(what).help("create one with `openssl rand -hex 32`");
        if !text.chars().all(|c| c.is_ascii_graphic()) {
            return Err(fault("the token must be one word of visible ASCII characters".to_owned()));
        }
        if text.len() < SHORTEST {
            return Err(fault(format!("the token has {} characters; at least {SHORTEST} are required", text.len())));
        }
        Ok(Token { text: text.to_owned(), hash: blake3::hash(text.as_bytes()) })
    }

    /// Value of the header that carries the token.
    pub fn bearer(&self) -> String {
        format!("Bearer {}", self.text)
    }

    fn is(&self, text: &[u8]) -> bool {
        // The comparison of two hashes takes constant time.
        blake3::hash(text) == self.hash
    }

    /// Whether the headers of a request contain the token.
    pub fn admits(&self, headers: &MetadataMap) -> bool {
        let Some(header) = headers.get("authorization").and_then(|h| h.to_str().ok()) else { return false };
        let Some((scheme, rest)) = header.split_once(' ') else { return false };
        if scheme.eq_ignore_ascii_case("bearer") {
            return self.is(rest.trim().as_bytes());
        }
        // Padding of the base64 text is optional, because not all clients write it.
        let pair = || BASE64_STANDARD_NO_PAD.decode(rest.trim().trim_end_matches('=')).ok();
        let known = scheme.eq_ignore_ascii_case("basic").then(pair).flatten();
        known.is_some_and(|pair| pair.splitn(2, |b| *b == b':').nth(1).is_some_and(|password| self.is(password)))
    }
}

/// Interceptor that rejects requests without the token.
#[derive(Clone)]
pub struct TokenInterceptor(Option<Token>);

impl TokenInterceptor {
    /// Interceptor for `token`; without a token all requests pass.
    pub fn new(token: Option<Token>) -> TokenInterceptor {
        TokenInterceptor(token)
    }
}

impl Interceptor for TokenInterceptor {
    fn call(&mut self, request: Request<()>) -> Result<Request<()>, Status> {
        if self.0.as_ref().is_some_and(|token| !token.admits(request.metadata())) {
            return Err(Status::unauthenticated(WRONG));
        }
        // The connection now counts as authenticated.
        if request.extensions().get::<PortClient>().is_some_and(|guest| !guest.admit()) {
            return Err(Status::resource_exhausted("too many clients are connected; try again later"));
        }
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use base64::prelude::BASE64_STANDARD;

    use super::*;

    fn with(header: &str) -> MetadataMap {
        let mut headers = MetadataMap::new();
        headers.insert("authorization", header.parse().unwrap());
        headers
    }

    #[test]
    fn unit_only_the_token_is_admitted() {
        let token = Token::read(" 0123456789abcdef\n").unwrap();
        let basic = |pair: &str| format!("Basic {}", BASE64_STANDARD.encode(pair));
        let unpadded = basic("me:0123456789abcdef").trim_end_matches('=').to_owned();
        for right in [token.bearer(), "bearer 0123456789abcdef".to_owned(), basic("anyone:0123456789abcdef"), unpadded]
        {
            assert!(token.admits(&with(&right)), "{right}");
        }
        let wrong =
            ["Bearer 0123456789abcdeg", "Bearer", "Bearer ", "0123456789abcdef", "Basic !!", "Digest 0123456789abcdef"];
        for wrong in wrong.map(str::to_owned).into_iter().chain([basic("0123456789abcdef"), basic("a:b"), basic("a:")])
        {
            assert!(!token.admits(&with(&wrong)), "{wrong}");
        }
        assert!(!token.admits(&MetadataMap::new()));
    }

    #[test]
    fn unit_short_or_invalid_tokens_are_rejected() {
        for wrong in ["", "  \n", "short", "0123456789 abcdef", "0123456789abcd\u{e9}f"] {
            assert!(Token::read(wrong).is_err(), "{wrong:?}");
        }
    }
}
