//! Differences of the XML interface of Google Cloud Storage from S3, by its documentation. Conditions and versions are
//! generations of an object. A generation grows with each write; here it is a time in microseconds. Names are
//! percent-encoded as a whole. Requests have a bearer token, or no token for public buckets.

use std::{fs, path::Path, time::UNIX_EPOCH};

use hyper::{
    header::{AUTHORIZATION, HeaderMap, HeaderName, HeaderValue},
    http::request::Parts,
};

/// Header with the required generation of an object for a write; 0 requires that the object is absent.
pub const IF_GENERATION: HeaderName = HeaderName::from_static("x-goog-if-generation-match");
const GENERATION: HeaderName = HeaderName::from_static("x-goog-generation");

/// Generation of the object in a file; 0 if the file is absent.
fn generation(file: &Path) -> u128 {
    let modified = fs::metadata(file).ok().filter(fs::Metadata::is_file).map(|about| about.modified().unwrap());
    modified.map_or(0, |at| at.duration_since(UNIX_EPOCH).unwrap().as_micros())
}

/// Decodes the name in a request and removes its token, which S3 does not support.
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

/// True if the condition of a request holds for the object in `file`.
pub fn may(headers: &HeaderMap, file: &Path) -> bool {
    headers.get(IF_GENERATION).is_none_or(|wanted| wanted.to_str().unwrap() == generation(file).to_string())
}

/// Adds the generation of the object in `file` to a response.
pub fn set_generation_header(headers: &mut HeaderMap, file: &Path) {
    let there = Some(generation(file)).filter(|n| *n > 0);
    there.into_iter().for_each(|n| drop(headers.insert(GENERATION, HeaderValue::from_str(&n.to_string()).unwrap())));
}
