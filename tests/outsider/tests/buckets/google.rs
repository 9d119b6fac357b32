//! In what the XML interface of Google Cloud Storage is another than that of S3, by its documentation: conditions and
//! versions are generations of an object, numbers that grow with each write and are microseconds there; names are
//! percent-encoded whole; who asks has a token, or nothing where anyone may.

use std::{fs, path::Path, time::UNIX_EPOCH};

use hyper::{
    header::{AUTHORIZATION, HeaderMap, HeaderName, HeaderValue},
    http::request::Parts,
};

/// The generation that an object must have to be written; 0 where there must be none.
pub const IF_GENERATION: HeaderName = HeaderName::from_static("x-goog-if-generation-match");
const GENERATION: HeaderName = HeaderName::from_static("x-goog-generation");

/// The generation of the object in a file; 0 where there is none.
fn generation(file: &Path) -> u128 {
    let modified = fs::metadata(file).ok().filter(fs::Metadata::is_file).map(|about| about.modified().unwrap());
    modified.map_or(0, |at| at.duration_since(UNIX_EPOCH).unwrap().as_micros())
}

/// Decodes the name in a request, and takes its token away, which is none of S3's.
pub fn decode(parts: &mut Parts) {
    parts.headers.remove(AUTHORIZATION);
    let uri = parts.uri.to_string();
    let (path, query) = uri.split_once('?').map_or((uri.as_str(), None), |(path, query)| (path, Some(query)));
    let mut pieces = path.split('%');
    let mut plain = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (code, rest) = piece.split_at(2);
        plain.push(char::from(u8::from_str_radix(code, 16).unwrap()));
        plain.push_str(rest);
    }
    parts.uri = query.map_or_else(|| plain.clone(), |query| format!("{plain}?{query}")).parse().unwrap();
}

/// Whether a request may be done as far as the object in `file` is concerned.
pub fn may(headers: &HeaderMap, file: &Path) -> bool {
    headers.get(IF_GENERATION).is_none_or(|wanted| wanted.to_str().unwrap() == generation(file).to_string())
}

/// Adds the generation of the object in `file` to an answer.
pub fn tell(headers: &mut HeaderMap, file: &Path) {
    let there = Some(generation(file)).filter(|n| *n > 0);
    there.into_iter().for_each(|n| drop(headers.insert(GENERATION, HeaderValue::from_str(&n.to_string()).unwrap())));
}
