//! Server in memory, and hosts with one cache each. The tests of the crate `run` use it too.

use std::{
    fmt,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use async_trait::async_trait;
use buckets::{Bucket, StorageLocation, place};
use bytes::Bytes;
use futures::{StreamExt, stream::BoxStream};
use object_store::{
    CopyOptions, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, memory::InMemory, path::Path as Name,
};
use tempfile::TempDir;

use super::attach;

/// Server in memory that counts requests, truncates answers and rejects requests.
#[derive(Debug, Default)]
pub struct Server {
    objects: InMemory,
    /// Number of answers to truncate from now on.
    pub cut: AtomicUsize,
    pub down: AtomicBool,
    written: Mutex<Vec<String>>,
    pub read: Mutex<Vec<String>>,
}

impl fmt::Display for Server {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "a server in memory")
    }
}

impl Server {
    fn up(&self) -> object_store::Result<()> {
        match self.down.load(Ordering::SeqCst) {
            true => Err(object_store::Error::Generic { store: "S3", source: "500 Internal Server Error".into() }),
            false => Ok(()),
        }
    }

    /// Objects written so far whose names begin with `start`.
    #[allow(dead_code, reason = "only the tests of `run` call it")]
    pub fn writes(&self, start: &str) -> Vec<String> {
        self.written.lock().unwrap().iter().filter(|name| name.starts_with(start)).cloned().collect()
    }
}

#[async_trait]
impl ObjectStore for Server {
    async fn put_opts(&self, at: &Name, payload: PutPayload, how: PutOptions) -> object_store::Result<PutResult> {
        self.up()?;
        let done = self.objects.put_opts(at, payload, how).await?;
        self.written.lock().unwrap().push(at.to_string());
        Ok(done)
    }

    async fn put_multipart_opts(
        &self,
        at: &Name,
        how: PutMultipartOptions,
    ) -> object_store::Result<Box<dyn MultipartUpload>> {
        self.up()?;
        self.objects.put_multipart_opts(at, how).await
    }

    async fn get_opts(&self, at: &Name, how: GetOptions) -> object_store::Result<GetResult> {
        self.up()?;
        let whole = !how.head;
        let found = self.objects.get_opts(at, how).await?;
        if whole {
            self.read.lock().unwrap().push(at.to_string());
        }
        let cut = |n: usize| n.checked_sub(1);
        if !whole || self.cut.fetch_update(Ordering::SeqCst, Ordering::SeqCst, cut).is_err() {
            return Ok(found);
        }
        let (meta, range, attributes) = (found.meta.clone(), found.range.clone(), found.attributes.clone());
        let bytes = found.bytes().await?;
        let short: Bytes = bytes.slice(..bytes.len() / 2);
        let payload = GetResultPayload::Stream(futures::stream::once(async move { Ok(short) }).boxed());
        Ok(GetResult { payload, meta, range, attributes })
    }

    fn delete_stream(
        &self,
        all: BoxStream<'static, object_store::Result<Name>>,
    ) -> BoxStream<'static, object_store::Result<Name>> {
        self.objects.delete_stream(all)
    }

    fn list(&self, prefix: Option<&Name>) -> BoxStream<'static, object_store::Result<ObjectMeta>> {
        match self.up() {
            Ok(()) => self.objects.list(prefix),
            Err(e) => futures::stream::once(async move { Err(e) }).boxed(),
        }
    }

    async fn list_with_delimiter(&self, prefix: Option<&Name>) -> object_store::Result<ListResult> {
        self.up()?;
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Name, to: &Name, how: CopyOptions) -> object_store::Result<()> {
        self.objects.copy_opts(from, to, how).await
    }
}

/// Bucket, and hosts with one cache each.
pub struct Lab {
    pub server: Arc<Server>,
    pub bucket: Bucket,
}

impl Lab {
    pub fn new() -> Lab {
        let server = Arc::new(Server::default());
        let Ok(StorageLocation::Object(address)) = place("s3://bucket/lab/store") else { unreachable!("an address") };
        Lab { bucket: Bucket::new(server.clone(), address), server }
    }

    /// Cache of one more host.
    pub fn host(&self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        attach(folder.path(), self.bucket.clone()).unwrap();
        folder
    }

    pub fn put(&self, key: &str, change: impl Fn(&mut Vec<u8>)) {
        let mut bytes = self.bucket.get(key).unwrap().unwrap();
        change(&mut bytes);
        self.bucket.put(key, bytes).unwrap();
    }
}
