//! `--openlineage`: delivery of events. A failed delivery causes a warning and never fails a run.

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError, mpsc},
    thread::sleep,
    time::{Duration, Instant},
};

use buckets::{redacted, without_password};
use schemas::Fault;
use serde_json::Value;
use url::Url;

use super::file;
use crate::cli::say::err;

/// Time limit of a request.
const REQUEST: Duration = Duration::from_secs(5);
/// Delay between two attempts.
const AGAIN_AFTER: Duration = Duration::from_millis(500);
/// Number of consecutive failures after which no more events are sent.
const ENOUGH: usize = 3;
/// Maximum time that a run waits at its end for events to be sent.
const FLUSH: Duration = Duration::from_secs(15);
/// Path of the events below the address of a server.
const ENDPOINT: &str = "/api/v1/lineage";

/// Destination of OpenLineage events.
enum LineageTarget {
    File(PathBuf),
    Http { url: Url, agent: Box<ureq::Agent>, key: Option<String> },
}

/// Sender of OpenLineage events, which are delivered in order by one thread.
pub struct LineageSink {
    sender: Mutex<Option<mpsc::Sender<Value>>>,
    done: Mutex<mpsc::Receiver<()>>,
}

impl LineageSink {
    /// Opens a file or an address.
    ///
    /// # Errors
    /// Fails for a missing folder, or for an unsupported address.
    pub fn open(to: &str) -> Result<LineageSink, Fault> {
        let target = target(to)?;
        let (sender, events) = mpsc::channel();
        let (done, over) = mpsc::channel();
        std::thread::spawn(move || {
            deliver(&target, &events);
            // The thread that waits for this message may have ended.
            let _ = done.send(());
        });
        Ok(LineageSink { sender: Mutex::new(Some(sender)), done: Mutex::new(over) })
    }

    /// Queues an event.
    pub fn send(&self, event: Value) {
        if let Some(sender) = self.sender.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
            // A thread that has ended has already reported the reason.
            let _ = sender.send(event);
        }
    }

    /// Waits until all events are delivered, at most `FLUSH`.
    pub fn flush(&self) {
        self.sender.lock().unwrap_or_else(PoisonError::into_inner).take();
        let done = self.done.lock().unwrap_or_else(PoisonError::into_inner);
        if done.recv_timeout(FLUSH) == Err(mpsc::RecvTimeoutError::Timeout) {
            warn("the last events were not sent within the time limit");
        }
    }
}

fn warn(why: &str) {
    err!("warning: OpenLineage events are lost: {why}");
}

fn target(to: &str) -> Result<LineageTarget, Fault> {
    if !to.contains("://") {
        file::check("--openlineage", Path::new(to))?;
        return Ok(LineageTarget::File(PathBuf::from(to)));
    }
    let wrong = |why: &str| {
        Fault::new(format!("`--openlineage`: cannot send to `{}`", without_password(to))).help(why.to_owned())
    };
    let mut url = Url::parse(to).map_err(|e| wrong(&e.to_string()))?;
    match url.scheme() {
        "http" => {}
        "https" => return Err(wrong("TLS is not supported: give an `http://` proxy on this host, or a file")),
        "file" => {
            let path = url.to_file_path().map_err(|()| wrong("give a file on this host"))?;
            file::check("--openlineage", &path)?;
            return Ok(LineageTarget::File(path));
        }
        _ => return Err(wrong("give a path or `http://host:port`")),
    }
    if url.path() == "/" {
        url.set_path(ENDPOINT);
    }
    let agent = ureq::Agent::config_builder().timeout_global(Some(REQUEST)).max_redirects(0).build().into();
    let key = std::env::var("OPENLINEAGE_API_KEY").ok().filter(|k| !k.is_empty());
    Ok(LineageTarget::Http { url, agent: Box::new(agent), key })
}

/// Delivers events until the channel closes. After `ENOUGH` consecutive failures, events are dropped.
fn deliver(target: &LineageTarget, events: &mpsc::Receiver<Value>) {
    let (mut lost, mut in_a_row) = (0, 0);
    let mut why = String::new();
    for event in events {
        if in_a_row >= ENOUGH {
            lost += 1;
            continue;
        }
        match one(target, &event) {
            Ok(()) => in_a_row = 0,
            Err(e) => {
                (lost, in_a_row) = (lost + 1, in_a_row + 1);
                why = e;
            }
        }
    }
    if lost > 0 {
        warn(&format!("{lost} events: {why}"));
    }
}

fn one(target: &LineageTarget, event: &Value) -> Result<(), String> {
    let text = event.to_string();
    match target {
        LineageTarget::File(path) => {
            let line = format!("{text}\n");
            // One write per event, so that lines of several runs do not mix.
            let file = File::options().create(true).append(true).open(path);
            file.and_then(|mut f| f.write_all(line.as_bytes())).map_err(|e| format!("{}: {e}", path.display()))
        }
        LineageTarget::Http { url, agent, key } => {
            let (begun, shown) = (Instant::now(), without_password(url.as_str()));
            let sent = post(agent, url, key.as_deref(), &text);
            match sent {
                Err(ureq::Error::StatusCode(code)) if code < 500 => Err(format!("{shown} returned status {code}")),
                Err(_) if begun.elapsed() < REQUEST => {
                    sleep(AGAIN_AFTER);
                    post(agent, url, key.as_deref(), &text)
                        .map_err(|e| format!("{shown}: {}", redacted(&e.to_string())))
                }
                Err(e) => Err(format!("{shown}: {}", redacted(&e.to_string()))),
                Ok(()) => Ok(()),
            }
        }
    }
}

fn post(agent: &ureq::Agent, url: &Url, key: Option<&str>, text: &str) -> Result<(), ureq::Error> {
    let mut request = agent.post(url.as_str()).header("Content-Type", "application/json");
    if let Some(key) = key {
        request = request.header("Authorization", format!("Bearer {key}"));
    }
    // Redirects are not followed, because the key must be sent to this server only.
    match request.send(text)?.status() {
        status if status.is_success() => Ok(()),
        status => Err(ureq::Error::StatusCode(status.as_u16())),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_addresses_are_checked_before_anything_runs() {
        let url = |to: &str| match target(to) {
            Ok(LineageTarget::Http { url, .. }) => url.to_string(),
            Ok(LineageTarget::File(path)) => path.display().to_string(),
            Err(fault) => fault.what,
        };
        assert_eq!(url("http://localhost:5000"), "http://localhost:5000/api/v1/lineage");
        assert_eq!(url("http://localhost:5000/other?x=1"), "http://localhost:5000/other?x=1");
        assert_eq!(url("events.jsonl"), "events.jsonl");
        assert_eq!(url("file:///tmp/events.jsonl"), "/tmp/events.jsonl");
        let secret = url("https://me:geheim@host/?key=geheim");
        assert!(secret.contains("host") && !secret.contains("geheim"), "{secret}");
        for wrong in ["https://host", "ftp://host", "http://", "no/folder/of/this/name/x"] {
            assert!(url(wrong).starts_with("`--openlineage`"), "{wrong}: {}", url(wrong));
        }
    }
}
