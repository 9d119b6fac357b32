//! HTTP client of object stores. It follows no redirect to another server, because the headers of a request contain
//! credentials.

use std::time::Duration;

use object_store::{
    ClientConfigKey, ClientOptions, Result,
    client::{HttpClient, HttpConnector},
};
use reqwest::{Client, Proxy, redirect::Policy};

/// Time limits of a request and of establishing its connection.
const LONGEST: Duration = Duration::from_secs(60);
const CONNECTED: Duration = Duration::from_secs(5);
/// Maximum number of redirects within a server.
const MOST_REDIRECTS: usize = 5;

/// Connector for HTTP clients that follow no redirect to another server.
#[derive(Debug)]
pub struct SameOriginConnector;

impl HttpConnector for SameOriginConnector {
    fn connect(&self, options: &ClientOptions) -> Result<HttpClient> {
        let set = |key: ClientConfigKey| options.get_config_value(&key);
        let is = |key| set(key).is_some_and(|v| v == "true");
        let time = |key, other: Duration| set(key).and_then(|text| duration(&text)).unwrap_or(other);
        let same = Policy::custom(|attempt| {
            let origin = |url: &url::Url| {
                (url.scheme().to_owned(), url.host_str().map(str::to_owned), url.port_or_known_default())
            };
            let stays = attempt.previous().last().is_some_and(|from| origin(from) == origin(attempt.url()));
            if stays && attempt.previous().len() <= MOST_REDIRECTS { attempt.follow() } else { attempt.stop() }
        });
        let mut builder = Client::builder()
            .user_agent(concat!("magline/", env!("CARGO_PKG_VERSION")))
            .redirect(same)
            .timeout(time(ClientConfigKey::Timeout, LONGEST))
            .connect_timeout(time(ClientConfigKey::ConnectTimeout, CONNECTED))
            .https_only(!is(ClientConfigKey::AllowHttp));
        let generic =
            |source: reqwest::Error| object_store::Error::Generic { store: "HTTP client", source: source.into() };
        if let Some(proxy) = set(ClientConfigKey::ProxyUrl) {
            builder = builder.proxy(Proxy::all(proxy).map_err(generic)?);
        }
        if is(ClientConfigKey::AllowInvalidCertificates) {
            builder = builder.danger_accept_invalid_certs(true);
        }
        if is(ClientConfigKey::Http1Only) {
            builder = builder.http1_only();
        }
        Ok(HttpClient::new(builder.build().map_err(generic)?))
    }
}

/// Reads a time such as `60 seconds`, `1m 30s` or `500ms`.
fn duration(text: &str) -> Option<Duration> {
    let compact: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    let (mut rest, mut all) = (compact.as_str(), Duration::ZERO);
    while !rest.is_empty() {
        let digits = rest.find(|c: char| !c.is_ascii_digit()).filter(|n| *n > 0)?;
        let (number, unit) = rest.split_at(digits);
        let letters = unit.find(|c: char| c.is_ascii_digit()).unwrap_or(unit.len());
        let (unit, more) = unit.split_at(letters);
        let ms: u64 = match unit {
            "ms" | "msec" | "millis" | "milliseconds" => 1,
            "s" | "sec" | "secs" | "second" | "seconds" => 1_000,
            "m" | "min" | "mins" | "minute" | "minutes" => 60_000,
            "h" | "hr" | "hrs" | "hour" | "hours" => 3_600_000,
            _ => return None,
        };
        all += Duration::from_millis(number.parse::<u64>().ok()?.checked_mul(ms)?);
        rest = more;
    }
    (!all.is_zero()).then_some(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_durations_are_parsed() {
        for (text, ms) in
            [("60 seconds", 60_000), ("1m", 60_000), ("1m 30s", 90_000), ("500ms", 500), ("2h", 7_200_000)]
        {
            assert_eq!(duration(text), Some(Duration::from_millis(ms)), "{text}");
        }
        for wrong in ["", "s", "5", "5 parsecs", "0s"] {
            assert_eq!(duration(wrong), None, "{wrong}");
        }
    }
}
