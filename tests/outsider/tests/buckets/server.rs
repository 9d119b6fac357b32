//! In-process S3 server with an optional interface of Google Cloud Storage and injected faults.

use std::{
    convert::Infallible,
    fs,
    future::{Future, pending, poll_fn},
    io,
    path::PathBuf,
    pin::{Pin, pin},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll},
    time::Duration,
};

use hyper::{
    Method, Request, Response, StatusCode,
    body::{Body, Bytes, Frame, Incoming, SizeHint},
    header::{AUTHORIZATION, CONTENT_LENGTH, HeaderMap, IF_MATCH, IF_NONE_MATCH, TRANSFER_ENCODING},
    server::conn::http1,
    service::service_fn,
};
use hyper_util::rt::TokioIo;
use s3s::{
    auth::SimpleAuth,
    service::{S3Service, S3ServiceBuilder},
};
use s3s_fs::FileSystem;
use tempfile::TempDir;
use tokio::{
    net::TcpListener,
    runtime::{Builder, Runtime},
    sync::RwLock,
    time::{Sleep, sleep},
};

use crate::google;

/// The bucket.
pub const BUCKET: &str = "lab";
/// Access keys of the permitted users.
pub const USERS: [&str; 3] = ["AKIAFIRST", "AKIASECOND", "AKIATHIRD"];

/// The secret key of a user.
pub fn secret(user: &str) -> String {
    format!("geheim-{user}")
}

/// A request.
#[derive(Clone, Debug)]
pub struct Asked {
    /// Number of the request, from 1.
    pub number: usize,
    /// Access key of the signature.
    pub user: String,
    pub method: Method,
    /// Name of the object in the bucket; empty for a listing.
    pub key: String,
    /// True if the request has `If-Match` or `If-None-Match`.
    pub on_condition: bool,
    /// Injected fault.
    pub fault: Fault,
}

impl Asked {
    /// True if the request writes a pack.
    pub fn writes_pack(&self) -> bool {
        self.method == Method::PUT && self.key.contains("/objects/")
    }

    /// True if the server executes the request.
    pub fn is_done(&self) -> bool {
        !matches!(self.fault, Fault::Silent | Fault::Status(_))
    }
}

/// Fault that the server injects into a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    None,
    /// Rejected with this status.
    Status(u16),
    /// Executed and answered with this status.
    Lost(u16),
    /// Executed with a truncated response.
    Cut,
    /// The request is executed, and the response is truncated with a matching length, as by a proxy.
    Short,
    /// Not executed and never answered.
    Silent,
    /// Executed and never answered.
    Late,
}

type Decide = Box<dyn FnMut(&Asked) -> Fault + Send>;

/// Interface of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    S3,
    /// Interface of Google Cloud Storage; [`google`] lists the differences from S3.
    Google,
}

struct Shared {
    kind: Kind,
    service: S3Service,
    folder: PathBuf,
    decide: Mutex<Decide>,
    asked: Mutex<Vec<Asked>>,
    /// Lock for one writer without readers, because `s3s-fs` writes an object and its version separately.
    one: RwLock<()>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Server with one bucket.
pub struct Server {
    shared: Arc<Shared>,
    /// Address of the server.
    pub endpoint: String,
    folder: TempDir,
    _runtime: Runtime,
}

impl Server {
    pub fn new() -> Server {
        Server::of(Kind::S3)
    }

    pub fn of(kind: Kind) -> Server {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join(BUCKET)).unwrap();
        let mut auth = SimpleAuth::new();
        for user in USERS {
            auth.register(user.to_owned(), secret(user).into());
        }
        let mut builder = S3ServiceBuilder::new(FileSystem::new(folder.path()).unwrap());
        if kind == Kind::S3 {
            builder.set_auth(auth);
        }
        let shared = Arc::new(Shared {
            kind,
            service: builder.build(),
            folder: folder.path().to_owned(),
            decide: Mutex::new(Box::new(|_| Fault::None)),
            asked: Mutex::default(),
            one: RwLock::new(()),
        });
        let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
        let endpoint = format!("http://{}", listener.local_addr().unwrap());
        runtime.spawn(serve(listener, shared.clone()));
        Server { shared, endpoint, folder, _runtime: runtime }
    }

    /// Sets the faults of later requests.
    pub fn faults(&self, decide: impl FnMut(&Asked) -> Fault + Send + 'static) {
        *locked(&self.shared.decide) = Box::new(decide);
    }

    /// Requests so far.
    pub fn asked(&self) -> Vec<Asked> {
        locked(&self.shared.asked).clone()
    }

    /// File of an object, or folder of several objects.
    pub fn path(&self, key: &str) -> PathBuf {
        self.folder.path().join(BUCKET).join(key)
    }

    /// Another writer.
    pub fn other(&self) -> Other {
        Other { folder: self.folder.path().to_owned() }
    }
}

/// Writer that bypasses requests.
#[derive(Clone)]
pub struct Other {
    folder: PathBuf,
}

impl Other {
    /// Writes an object.
    pub fn put(&self, key: &str, text: &str) {
        let file = self.folder.join(BUCKET).join(key);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
        // Removes the stored ETags of `s3s-fs`, which recomputes them from the bytes.
        for entry in fs::read_dir(&self.folder).unwrap().flatten() {
            if entry.file_name().to_string_lossy().ends_with(".internal.json") {
                let _ = fs::remove_file(entry.path());
            }
        }
    }
}

async fn serve(listener: TcpListener, shared: Arc<Shared>) {
    while let Ok((stream, _)) = listener.accept().await {
        let shared = shared.clone();
        tokio::spawn(async move {
            let service = service_fn(move |request| answered(shared.clone(), request));
            // The client may be gone.
            let _ = http1::Builder::new().serve_connection(TokioIo::new(stream), service).await;
        });
    }
}

fn header(headers: &HeaderMap, name: &hyper::header::HeaderName) -> String {
    headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default().to_owned()
}

async fn answered(shared: Arc<Shared>, request: Request<Incoming>) -> Result<Response<Answer>, Infallible> {
    let (mut parts, body) = request.into_parts();
    if shared.kind == Kind::Google {
        google::decode(&mut parts);
    }
    // An incomplete request of a killed client is discarded.
    let Some(body) = read(body).await else { return Ok(refused(400)) };
    let signed = header(&parts.headers, &AUTHORIZATION);
    let user = signed.split_once("Credential=").and_then(|(_, rest)| rest.split('/').next()).unwrap_or_default();
    let path = parts.uri.path().trim_start_matches('/');
    let key = path.strip_prefix(BUCKET).unwrap_or(path).trim_start_matches('/').to_owned();
    let conditions = [IF_MATCH, IF_NONE_MATCH, google::IF_GENERATION];
    let on_condition = conditions.iter().any(|name| parts.headers.contains_key(name));
    let (user, method) = (user.to_owned(), parts.method.clone());
    let asked = {
        let mut all = locked(&shared.asked);
        let mut asked = Asked { number: all.len() + 1, user, method, key, on_condition, fault: Fault::None };
        asked.fault = (locked(&shared.decide))(&asked);
        all.push(asked.clone());
        asked
    };
    match asked.fault {
        Fault::Status(status) => return Ok(refused(status)),
        Fault::Silent => pending().await,
        Fault::None | Fault::Lost(_) | Fault::Cut | Fault::Short | Fault::Late => {}
    }
    let whole = Request::from_parts(parts, s3s::Body::from(body));
    // A request that has arrived completely is processed to its end, even if the client has disconnected.
    let (own, of) = (shared.clone(), asked.clone());
    let (status, headers, data) = tokio::spawn(async move { done(&own, &of, whole).await }).await.unwrap();
    let in_two = |data: &Bytes| asked.method == Method::GET && status.is_success() && data.len() > 1;
    let answer = match asked.fault {
        Fault::Late => pending().await,
        Fault::Lost(status) => return Ok(refused(status)),
        Fault::Cut if in_two(&data) => Answer { data: data.slice(..data.len() / 2), cut: Some(None) },
        Fault::Short if in_two(&data) => Answer { data: data.slice(..data.len() / 2), cut: None },
        Fault::None | Fault::Cut | Fault::Short | Fault::Status(_) | Fault::Silent => {
            Answer { data: data.clone(), cut: None }
        }
    };
    let mut response = Response::new(answer);
    *response.status_mut() = status;
    *response.headers_mut() = headers;
    if asked.method != Method::HEAD {
        response.headers_mut().remove(CONTENT_LENGTH);
        response.headers_mut().remove(TRANSFER_ENCODING);
        if response.body().cut.is_some() {
            response.headers_mut().insert(CONTENT_LENGTH, data.len().into());
        }
    }
    Ok(response)
}

/// Response of the server without an injected fault.
async fn done(shared: &Shared, asked: &Asked, request: s3s::HttpRequest) -> (StatusCode, HeaderMap, Bytes) {
    let reads = matches!(asked.method, Method::GET | Method::HEAD);
    // A bucket has no folders, unlike the store of `s3s-fs`.
    if reads && !asked.key.is_empty() && shared.folder.join(BUCKET).join(&asked.key).is_dir() {
        return (StatusCode::NOT_FOUND, HeaderMap::new(), Bytes::new());
    }
    let (_reader, _writer);
    if reads {
        _reader = shared.one.read().await
    } else {
        _writer = shared.one.write().await
    }
    let file = shared.folder.join(BUCKET).join(&asked.key);
    if shared.kind == Kind::Google && !google::may(request.headers(), &file) {
        let text = "<Error><Code>PreconditionFailed</Code><Message>No</Message></Error>";
        return (StatusCode::PRECONDITION_FAILED, HeaderMap::new(), text.into());
    }
    match shared.service.call(request).await {
        Ok(response) => {
            let (mut parts, body) = response.into_parts();
            if shared.kind == Kind::Google {
                google::set_generation_header(&mut parts.headers, &file);
            }
            (parts.status, parts.headers, read(body).await.unwrap_or_default())
        }
        Err(_) => (StatusCode::INTERNAL_SERVER_ERROR, HeaderMap::new(), Bytes::new()),
    }
}

/// Error response in the format of S3, with text that must not be shown.
fn refused(status: u16) -> Response<Answer> {
    let code = match status {
        503 => "SlowDown",
        409 => "ConditionalRequestConflict",
        403 => "AccessDenied",
        _ => "InternalError",
    };
    let text = format!("<Error><Code>{code}</Code><Message>No</Message><AWSAccessKeyId>AKIA</AWSAccessKeyId></Error>");
    let mut response = Response::new(Answer { data: text.into(), cut: None });
    *response.status_mut() = StatusCode::from_u16(status).unwrap();
    response
}

/// Complete body; `None` if the request is truncated.
async fn read(body: impl Body<Data = Bytes>) -> Option<Bytes> {
    let (mut body, mut all) = (pin!(body), vec![]);
    while let Some(frame) = poll_fn(|cx| body.as_mut().poll_frame(cx)).await {
        if let Ok(data) = frame.ok()?.into_data() {
            all.extend_from_slice(&data);
        }
    }
    Some(all.into())
}

/// Body of a response.
struct Answer {
    data: Bytes,
    /// Set if the connection is closed after the body. The delay lets the sent bytes arrive.
    cut: Option<Option<Pin<Box<Sleep>>>>,
}

impl Body for Answer {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context) -> Poll<Option<Result<Frame<Bytes>, io::Error>>> {
        if !self.data.is_empty() {
            return Poll::Ready(Some(Ok(Frame::data(std::mem::take(&mut self.data)))));
        }
        let Some(cut) = &mut self.cut else { return Poll::Ready(None) };
        let timer = cut.get_or_insert_with(|| Box::pin(sleep(Duration::from_millis(20))));
        timer.as_mut().poll(cx).map(|()| Some(Err(io::ErrorKind::ConnectionAborted.into())))
    }

    fn is_end_stream(&self) -> bool {
        self.data.is_empty() && self.cut.is_none()
    }

    fn size_hint(&self) -> SizeHint {
        if self.cut.is_some() { SizeHint::default() } else { SizeHint::with_exact(self.data.len() as u64) }
    }
}
