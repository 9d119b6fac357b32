//! Connections: protection of the address, headers, time limits, and maximum numbers.

use std::{
    convert::Infallible,
    fs::File,
    io::{self, Read},
    path::Path,
    pin::Pin,
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use hyper::{
    Method, Request, Response, StatusCode,
    body::Incoming,
    header::{self, HeaderName, HeaderValue},
    server::conn::http1,
    service::service_fn,
};
use hyper_util::rt::{TokioIo, TokioTimer};
use report::{
    html::{SCRIPTS, STYLE},
    view::ViewFault,
};
use schemas::{Fault, visible};
use serde_json::json;
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    sync::Semaphore,
    time::{Instant, Sleep, sleep, timeout},
};
use uuid::Uuid;

use crate::{
    ViewSettings,
    answer::JSON,
    body::{AnswerBody, counted},
    request::{DownloadFormat, ViewQuery, ViewRequest},
    workers::ComputeQueue,
};

/// Time that a client has to send a request.
const HEAD: Duration = Duration::from_secs(15);
/// Time that a client has to read the next part of an answer.
const READS: Duration = Duration::from_secs(30);
/// Time limit for an answer.
const ANSWERS: Duration = Duration::from_secs(30);
/// Time limit for the first byte of a download.
const DOWNLOADS: Duration = Duration::from_secs(600);
/// Interval at which the file of a download is checked for completeness.
const LOOKS_EVERY: Duration = Duration::from_millis(20);
/// Pause after a failed accept, for example for lack of file descriptors.
const AGAIN_AFTER: Duration = Duration::from_millis(50);
/// Maximum size of the error message of a failed download, in bytes.
const MESSAGE: u64 = 10_000;
/// Maximum size of the head of a request, in bytes.
const HEAD_BYTES: usize = 32 << 10;

const TEXT: &str = "text/javascript; charset=utf-8";
const HTML: &str = "text/html; charset=utf-8";

/// Policy of the page: nothing from another origin. Inline styles are permitted, because charts set the styles of their
/// elements.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; \
                      img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'";

/// State of a server.
pub struct ServerState {
    /// Hash of the token.
    pub token: blake3::Hash,
    /// Values of the header `Host` that the server accepts.
    pub hosts: [String; 2],
    /// The page. It contains no data of the store, so it can be sent without delay.
    pub page: Bytes,
    /// Queue of the workers.
    pub queue: ComputeQueue,
    /// Queue of the workers that compute the progress of a run.
    pub progress: ComputeQueue,
    /// Whether the plan of the spec is complete.
    pub is_planned: AtomicBool,
    /// Permits of downloads.
    pub downloads: Arc<Semaphore>,
    /// Settings.
    pub settings: ViewSettings,
    /// Number of unsent bytes.
    pub open_bytes: Arc<AtomicUsize>,
}

type Answer = Response<AnswerBody>;

/// Accepts connections, each with a permit of `connections`.
pub async fn accept(listener: TcpListener, connections: Arc<Semaphore>, state: Arc<ServerState>) {
    loop {
        let Ok(permit) = connections.clone().acquire_owned().await else { return };
        let Ok((stream, _)) = listener.accept().await else {
            sleep(AGAIN_AFTER).await;
            continue;
        };
        let state = state.clone();
        tokio::spawn(async move {
            let _permit = permit;
            let service = service_fn(move |request| {
                let state = state.clone();
                async move { Ok::<_, Infallible>(respond(&state, &request).await) }
            });
            let io = TokioIo::new(ImpatientStream { stream, late: None });
            let mut server = http1::Builder::new();
            server.timer(TokioTimer::new()).header_read_timeout(HEAD).max_buf_size(HEAD_BYTES);
            // An error means that the client has disconnected or is too slow.
            let _ = server.serve_connection(io, service).await;
        });
    }
}

/// Refusal of a request.
struct Refusal {
    status: StatusCode,
    fault: Fault,
}

impl Refusal {
    fn new(status: StatusCode, what: &str) -> Refusal {
        Refusal { status, fault: Fault::new(what) }
    }

    fn help(self, help: &str) -> Refusal {
        Refusal { fault: self.fault.help(help), ..self }
    }
}

impl From<Fault> for Refusal {
    fn from(fault: Fault) -> Refusal {
        Refusal { status: StatusCode::BAD_REQUEST, fault }
    }
}

impl From<ViewFault> for Refusal {
    fn from(fault: ViewFault) -> Refusal {
        let (status, fault) = match fault {
            ViewFault::Missing(fault) => (StatusCode::NOT_FOUND, fault),
            ViewFault::Wrong(fault) => (StatusCode::BAD_REQUEST, fault),
            ViewFault::Failed(fault) => (StatusCode::INTERNAL_SERVER_ERROR, fault),
        };
        Refusal { status, fault }
    }
}

async fn respond(state: &ServerState, request: &Request<Incoming>) -> Answer {
    let mut answer = match route(state, request).await {
        Ok(answer) => answer,
        Err(Refusal { status, fault }) => {
            let (what, help) = (Fault { help: None, ..fault.clone() }.to_string(), fault.help);
            let help = help.as_deref().map(visible);
            let text = json!({ "error": visible(&what), "help": help }).to_string();
            let mut answer = whole(Bytes::from(text), JSON);
            *answer.status_mut() = status;
            if status == StatusCode::METHOD_NOT_ALLOWED {
                answer.headers_mut().insert(header::ALLOW, HeaderValue::from_static("GET, HEAD"));
            }
            if status == StatusCode::SERVICE_UNAVAILABLE {
                answer.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
            }
            answer
        }
    };
    let fixed = [
        (header::CACHE_CONTROL, "no-store"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in fixed {
        answer.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    answer
}

fn whole(bytes: Bytes, kind: &'static str) -> Answer {
    let mut answer = Response::new(AnswerBody::Whole(Some(bytes)));
    answer.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    answer
}

/// The segments of a path below the token; `None` for a wrong token. Hashes are compared in constant time.
fn below(token: blake3::Hash, path: &str) -> Option<&str> {
    let (given, rest) = path.strip_prefix('/')?.split_once('/')?;
    (blake3::hash(given.as_bytes()) == token).then_some(rest)
}

async fn route(state: &ServerState, request: &Request<Incoming>) -> Result<Answer, Refusal> {
    if !is_own_host(state, request) {
        let refusal = Refusal::new(StatusCode::MISDIRECTED_REQUEST, "the request is for another host");
        return Err(refusal.help("open the address that `magline view` printed"));
    }
    let unknown = || Refusal::new(StatusCode::NOT_FOUND, "there is no such page");
    let rest = below(state.token, request.uri().path()).ok_or_else(unknown)?;
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        return Err(Refusal::new(StatusCode::METHOD_NOT_ALLOWED, "a view is read-only").help("use GET or HEAD"));
    }
    let query = ViewQuery::read(request.uri().query().unwrap_or_default())?;
    if rest.is_empty() {
        return Ok(whole(state.page.clone(), HTML));
    }
    if let Some(name) = rest.strip_prefix("web/") {
        if name == "style.css" {
            return Ok(whole(Bytes::from_static(STYLE.as_bytes()), "text/css; charset=utf-8"));
        }
        let script = SCRIPTS.iter().find(|script| script.name == name).ok_or_else(unknown)?;
        return Ok(whole(Bytes::from_static(script.text.as_bytes()), TEXT));
    }
    if rest == "download" {
        let (table, format) = query.download()?;
        return download(state, table, format).await;
    }
    let name = rest.strip_prefix("api/").ok_or_else(unknown)?;
    compute(state, query.request(name)?.ok_or_else(unknown)?).await
}

/// Whether the request is for the address of this server. Another site whose name resolves to the loopback interface
/// has another `Host`.
fn is_own_host(state: &ServerState, request: &Request<Incoming>) -> bool {
    let own = |host: &str| state.hosts.iter().any(|own| own.eq_ignore_ascii_case(host));
    let mut hosts = request.headers().get_all(header::HOST).iter();
    let (first, more) = (hosts.next(), hosts.next());
    let named = first.and_then(|host| host.to_str().ok()).is_some_and(own);
    named && more.is_none() && request.uri().authority().is_none_or(|authority| own(authority.as_str()))
}

async fn compute(state: &ServerState, request: ViewRequest) -> Result<Answer, Refusal> {
    let (bytes, kind) = answered(state, request).await?;
    let bytes = counted(&state.open_bytes, bytes).ok_or_else(busy)?;
    Ok(whole(bytes, kind))
}

async fn answered(state: &ServerState, request: ViewRequest) -> Result<(Bytes, &'static str), Refusal> {
    let late = || Refusal::new(StatusCode::GATEWAY_TIMEOUT, "the answer takes longer than 30 s");
    let is_progress = matches!(request, ViewRequest::Run) && state.is_planned.load(Ordering::Acquire);
    let queue = if is_progress { &state.progress } else { &state.queue };
    let answer = timeout(ANSWERS, queue.ask(request)).await;
    let answer = answer.map_err(|_| late().help("ask for fewer columns, or a shorter part of the line"))?;
    Ok(answer.ok_or_else(busy)??)
}

fn busy() -> Refusal {
    Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "too many requests at once").help("repeat the request")
}

/// Writes the file of a table in a separate process with limited memory, and sends it.
async fn download(state: &ServerState, table: String, format: DownloadFormat) -> Result<Answer, Refusal> {
    let permit = state.downloads.clone().try_acquire_owned().map_err(|_| busy())?;
    let arguments = answered(state, ViewRequest::Download(table.clone(), format)).await?.0;
    let arguments: Vec<String> = serde_json::from_slice(&arguments).unwrap_or_default();
    let path = state.settings.temporary.join(format!("{}.{}", Uuid::new_v4().simple(), format.extension()));
    let written = write(&state.settings.program, &arguments, &path).await;
    let opened = written.and_then(|()| {
        let failed =
            |e: io::Error| Refusal::from(ViewFault::Failed(Fault::machine(format!("cannot read the file: {e}"))));
        let file = File::open(&path).map_err(failed)?;
        let size = file.metadata().map_err(failed)?.len();
        Ok((file, size))
    });
    // The open file stays readable.
    let _ = std::fs::remove_file(&path);
    let (file, size) = opened?;
    let mut answer = Response::new(AnswerBody::of_file(file, size, permit));
    let plain = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '_' };
    let name: String = table.chars().take(200).map(plain).collect();
    let shown = format!("attachment; filename=\"{name}.{}\"", format.extension());
    let shown = HeaderValue::from_str(&shown).unwrap_or(HeaderValue::from_static("attachment"));
    answer.headers_mut().insert(header::CONTENT_DISPOSITION, shown);
    answer.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    Ok(answer)
}

/// Runs `magline export` or `magline sql` with the output `path`.
async fn write(program: &Path, arguments: &[String], path: &Path) -> Result<(), Refusal> {
    let failed = |what: String| Refusal::from(ViewFault::Failed(Fault::machine(what)));
    let (verb, arguments) = arguments.split_at(1.min(arguments.len()));
    let mut command = Command::new(program);
    command.args(verb).arg("--output").arg(path).args(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    let started = command.spawn().map_err(|e| failed(format!("cannot start the process of the download: {e}")))?;
    let mut child = ChildGuard(started);
    let late = Instant::now() + DOWNLOADS;
    loop {
        match child.0.try_wait() {
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(status)) => {
                let mut text = String::new();
                let reader = child.0.stderr.take();
                let _ = reader.map(|reader| reader.take(MESSAGE).read_to_string(&mut text));
                let why = text.lines().find_map(|line| line.strip_prefix("error: ")).map(str::to_owned);
                return Err(failed(why.unwrap_or_else(|| format!("the file cannot be written: {status}"))));
            }
            Ok(None) if Instant::now() < late => sleep(LOOKS_EVERY).await,
            Ok(None) => return Err(Refusal::new(StatusCode::GATEWAY_TIMEOUT, "the download takes longer than 600 s")),
            Err(e) => return Err(failed(format!("cannot wait for the process of the download: {e}"))),
        }
    }
}

/// Child process that is killed when its request ends.
struct ChildGuard(std::process::Child);

impl Drop for ChildGuard {
    fn drop(&mut self) {
        // The process may have ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Connection that ends when the client does not read for [`READS`].
struct ImpatientStream {
    stream: TcpStream,
    late: Option<Pin<Box<Sleep>>>,
}

impl ImpatientStream {
    /// The result of a write, or an error if the client has not read for [`READS`].
    fn waited<T>(&mut self, cx: &mut Context, done: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if done.is_ready() {
            self.late = None;
            return done;
        }
        let late = self.late.get_or_insert_with(|| Box::pin(sleep(READS)));
        late.as_mut().poll(cx).map(|()| Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for ImpatientStream {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context, buf: &mut ReadBuf) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_read(cx, buf)
    }
}

impl AsyncWrite for ImpatientStream {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let own = self.get_mut();
        let done = Pin::new(&mut own.stream).poll_write(cx, bytes);
        own.waited(cx, done)
    }

    fn poll_write_vectored(self: Pin<&mut Self>, cx: &mut Context, bytes: &[io::IoSlice]) -> Poll<io::Result<usize>> {
        let own = self.get_mut();
        let done = Pin::new(&mut own.stream).poll_write_vectored(cx, bytes);
        own.waited(cx, done)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context) -> Poll<io::Result<()>> {
        let own = self.get_mut();
        let done = Pin::new(&mut own.stream).poll_flush(cx);
        own.waited(cx, done)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context) -> Poll<io::Result<()>> {
        let own = self.get_mut();
        let done = Pin::new(&mut own.stream).poll_shutdown(cx);
        own.waited(cx, done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_only_the_token_opens_a_path() {
        let token = blake3::hash(b"secret");
        assert_eq!((below(token, "/secret/"), below(token, "/secret/api/run")), (Some(""), Some("api/run")));
        for wrong in ["", "/", "/secret", "//secret/", "/secre/", "/secret2/", "/%73ecret/", "/SECRET/", "secret/"] {
            assert_eq!(below(token, wrong), None, "{wrong}");
        }
    }
}
