//! Connections to a port. An unauthenticated client is disconnected after ten seconds. If there are too many such
//! clients, an earlier one is disconnected when the next one connects. Idle connections thus cannot lock others out.

use std::{
    collections::BTreeMap,
    io,
    net::{IpAddr, SocketAddr},
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll},
    time::{Duration, Instant},
};

use futures::{Stream, future::FutureExt, stream};
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    sync::{mpsc, oneshot},
    time::{interval, sleep},
};
use tokio_rustls::{TlsAcceptor, rustls::ServerConfig, server::TlsStream};
use tonic::transport::server::Connected;

/// Time that a client has for authentication.
const PATIENCE: Duration = Duration::from_secs(10);
/// Interval of checks for expired clients.
const LOOKS_EVERY: Duration = Duration::from_millis(500);
/// Pause after a failed accept, for example for lack of file descriptors.
const AGAIN_AFTER: Duration = Duration::from_millis(50);
/// Maximum number of unauthenticated connections, and of authenticated connections.
const MOST_STRANGERS: usize = 128;
const MOST_KNOWN: usize = 1024;
/// Maximum number of connections that wait for a server.
const WAITING: usize = 16;

/// Limits of a port.
#[derive(Clone, Copy, Debug)]
struct ConnectionLimits {
    strangers: usize,
    /// Maximum number of unauthenticated clients of one address.
    of_address: usize,
    known: usize,
    patience: Duration,
}

impl ConnectionLimits {
    /// Limits for a process with this number of file descriptors; half of them are for connections.
    fn from_descriptors(descriptors: usize) -> ConnectionLimits {
        let strangers = (descriptors / 8).clamp(4, MOST_STRANGERS);
        let known = (descriptors * 3 / 8).clamp(4, MOST_KNOWN);
        ConnectionLimits { strangers, of_address: (strangers / 2).max(2), known, patience: PATIENCE }
    }

    /// Limits of this process; first raises its limit of file descriptors to the maximum.
    fn of_process() -> ConnectionLimits {
        let (soft, hard) = getrlimit(Resource::RLIMIT_NOFILE).unwrap_or((256, 256));
        let raised = setrlimit(Resource::RLIMIT_NOFILE, hard, hard).is_ok();
        ConnectionLimits::from_descriptors(usize::try_from(if raised { hard } else { soft }).unwrap_or(usize::MAX / 8))
    }
}

/// Unauthenticated client: address, time of connection, and the signal that disconnects it.
struct UnverifiedClient {
    address: IpAddr,
    since: Instant,
    out: oneshot::Sender<()>,
}

/// Connected clients of a port and their limits.
struct ConnectionRegistry {
    limits: ConnectionLimits,
    entries: Mutex<RegistryEntries>,
}

#[derive(Default)]
struct RegistryEntries {
    next: u64,
    strangers: BTreeMap<u64, UnverifiedClient>,
    known: usize,
}

impl ConnectionRegistry {
    fn entries(&self) -> MutexGuard<'_, RegistryEntries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an unauthenticated client. If there are too many unauthenticated connections, disconnects the oldest
    /// connection of the address with the most connections.
    fn enter(self: &Arc<ConnectionRegistry>, address: IpAddr) -> (PortClient, oneshot::Receiver<()>) {
        let (out, evicted) = oneshot::channel();
        let mut entries = self.entries();
        let mut of: BTreeMap<IpAddr, usize> = BTreeMap::new();
        entries.strangers.values().for_each(|s| *of.entry(s.address).or_default() += 1);
        let own = of.get(&address).copied().unwrap_or(0);
        let crowd = match () {
            () if own >= self.limits.of_address => Some(address),
            () if entries.strangers.len() >= self.limits.strangers => {
                of.into_iter().max_by_key(|(_, n)| *n).map(|(address, _)| address)
            }
            () => None,
        };
        // The oldest client has the smallest number.
        let oldest = crowd.and_then(|c| entries.strangers.iter().find(|(_, s)| s.address == c).map(|(n, _)| *n));
        if let Some(stranger) = oldest.and_then(|n| entries.strangers.remove(&n)) {
            let _ = stranger.out.send(());
        }
        entries.next += 1;
        let number = entries.next;
        entries.strangers.insert(number, UnverifiedClient { address, since: Instant::now(), out });
        let about = ClientRecord { number, book: self.clone(), known: AtomicBool::new(false) };
        (PortClient(Arc::new(about)), evicted)
    }

    /// Disconnects expired clients.
    fn sweep(&self) {
        let mut entries = self.entries();
        let late = |s: &UnverifiedClient| s.since.elapsed() > self.limits.patience;
        let late: Vec<u64> = entries.strangers.iter().filter(|(_, s)| late(s)).map(|(n, _)| *n).collect();
        for stranger in late.iter().filter_map(|n| entries.strangers.remove(n)).collect::<Vec<_>>() {
            let _ = stranger.out.send(());
        }
    }
}

struct ClientRecord {
    number: u64,
    book: Arc<ConnectionRegistry>,
    known: AtomicBool,
}

impl Drop for ClientRecord {
    fn drop(&mut self) {
        let mut entries = self.book.entries();
        entries.strangers.remove(&self.number);
        entries.known -= usize::from(self.known.load(Ordering::Relaxed));
    }
}

/// Client of a connection, stored in the extensions of the connection's requests.
#[derive(Clone)]
pub struct PortClient(Arc<ClientRecord>);

impl PortClient {
    /// Marks the client as authenticated, so that it stays connected. Returns `false` if there are too many
    /// authenticated clients.
    pub fn admit(&self) -> bool {
        if self.0.known.load(Ordering::Relaxed) {
            return true;
        }
        let mut entries = self.0.book.entries();
        if entries.known >= self.0.book.limits.known {
            return false;
        }
        if !self.0.known.swap(true, Ordering::Relaxed) {
            entries.known += 1;
            // The sender is dropped, so the client is no longer disconnected after the time limit.
            entries.strangers.remove(&self.0.number);
        }
        true
    }
}

/// TCP listener with limits on clients, with optional TLS.
pub struct PortListener {
    listener: TcpListener,
    encryption: Option<Arc<ServerConfig>>,
    /// Whether the TLS handshake authenticates a client.
    by_handshake: bool,
    limits: ConnectionLimits,
}

impl PortListener {
    /// Port whose clients are authenticated by their requests: [`PortClient::admit`].
    pub fn new(listener: TcpListener, encryption: Option<Arc<ServerConfig>>) -> PortListener {
        PortListener { listener, encryption, by_handshake: false, limits: ConnectionLimits::of_process() }
    }

    /// Port whose clients are authenticated by their certificates. Without encryption all clients are accepted.
    pub fn by_handshake(listener: TcpListener, encryption: Option<Arc<ServerConfig>>) -> PortListener {
        PortListener { by_handshake: true, ..PortListener::new(listener, encryption) }
    }

    /// Address of the port.
    ///
    /// # Errors
    /// Fails if the system does not report the address.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Stream of the connections.
    pub fn open(self) -> impl Stream<Item = io::Result<Connection>> {
        let (send, connections) = mpsc::channel(WAITING);
        tokio::spawn(self.accept(send));
        stream::unfold(connections, |mut connections| async move {
            let next: Connection = connections.recv().await?;
            Some((Ok(next), connections))
        })
    }

    async fn accept(self, send: mpsc::Sender<Connection>) {
        let book = Arc::new(ConnectionRegistry { limits: self.limits, entries: Mutex::default() });
        let encryption = self.encryption.map(TlsAcceptor::from);
        let mut looks = interval(LOOKS_EVERY);
        loop {
            let accepted = tokio::select! {
                () = send.closed() => return,
                _ = looks.tick() => {
                    book.sweep();
                    continue;
                }
                accepted = self.listener.accept() => accepted,
            };
            let Ok((plain, from)) = accepted else {
                sleep(AGAIN_AFTER).await;
                continue;
            };
            let _ = plain.set_nodelay(true);
            let (guest, out) = book.enter(from.ip());
            let (send, encryption, by_handshake) = (send.clone(), encryption.clone(), self.by_handshake);
            tokio::spawn(async move {
                if let Some(connection) = received(plain, encryption, guest, out, by_handshake).await {
                    // Sending fails only if the server has ended.
                    let _ = send.send(connection).await;
                }
            });
        }
    }
}

/// Connection after its handshake; `None` if the handshake fails or takes too long.
async fn received(
    plain: TcpStream,
    encryption: Option<TlsAcceptor>,
    guest: PortClient,
    mut out: oneshot::Receiver<()>,
    by_handshake: bool,
) -> Option<Connection> {
    let bytes = match encryption {
        None => TransportStream::Plain(plain),
        Some(encryption) => tokio::select! {
            _ = &mut out => return None,
            encrypted = encryption.accept(plain) => TransportStream::Encrypted(Box::new(encrypted.ok()?)),
        },
    };
    (!by_handshake || guest.admit()).then_some(Connection { bytes, guest, out: Some(out) })
}

enum TransportStream {
    Plain(TcpStream),
    Encrypted(Box<TlsStream<TcpStream>>),
}

/// Connection of a client; it returns no data after a disconnection.
pub struct Connection {
    bytes: TransportStream,
    guest: PortClient,
    out: Option<oneshot::Receiver<()>>,
}

impl Connected for Connection {
    type ConnectInfo = PortClient;

    fn connect_info(&self) -> PortClient {
        self.guest.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.out.as_mut().map(|out| out.poll_unpin(cx)) {
            Some(Poll::Ready(Ok(()))) => return Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Some(Poll::Ready(Err(_))) => self.out = None,
            Some(Poll::Pending) | None => {}
        }
        match &mut self.bytes {
            TransportStream::Plain(bytes) => Pin::new(bytes).poll_read(cx, buffer),
            TransportStream::Encrypted(bytes) => Pin::new(bytes).poll_read(cx, buffer),
        }
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, data: &[u8]) -> Poll<io::Result<usize>> {
        match &mut self.bytes {
            TransportStream::Plain(bytes) => Pin::new(bytes).poll_write(cx, data),
            TransportStream::Encrypted(bytes) => Pin::new(bytes).poll_write(cx, data),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.bytes {
            TransportStream::Plain(bytes) => Pin::new(bytes).poll_flush(cx),
            TransportStream::Encrypted(bytes) => Pin::new(bytes).poll_flush(cx),
        }
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.bytes {
            TransportStream::Plain(bytes) => Pin::new(bytes).poll_shutdown(cx),
            TransportStream::Encrypted(bytes) => Pin::new(bytes).poll_shutdown(cx),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::net::Ipv4Addr;

    use super::*;

    fn book(patience: Duration) -> Arc<ConnectionRegistry> {
        let limits = ConnectionLimits { strangers: 4, of_address: 2, known: 2, patience };
        Arc::new(ConnectionRegistry { limits, entries: Mutex::default() })
    }

    fn address(last: u8) -> IpAddr {
        IpAddr::V4(Ipv4Addr::new(10, 0, 0, last))
    }

    #[test]
    fn unit_new_clients_displace_only_unauthenticated_ones() {
        let book = book(Duration::from_secs(3600));
        let is_out = |evicted: &mut oneshot::Receiver<()>| evicted.try_recv() == Ok(());
        let (known, mut known_evicted) = book.enter(address(1));
        assert!(known.admit() && known.admit());
        let mut guests: Vec<_> = (0..3).map(|_| book.enter(address(1))).collect();
        let out: Vec<bool> = guests.iter_mut().map(|(_, evicted)| is_out(evicted)).collect();
        assert_eq!(out, [true, false, false], "the oldest of an address with too many gives way");
        // Clients of other addresses stay, unless there are too many in total.
        let mut others: Vec<_> = (2..5).map(|n| book.enter(address(n))).collect();
        assert!(is_out(&mut guests[1].1) && others.iter_mut().all(|(_, evicted)| !is_out(evicted)));
        assert!(!is_out(&mut known_evicted));
        assert!(others[0].0.admit() && !others[1].0.admit(), "too many are known");
        drop(known);
        assert!(others[1].0.admit(), "one has left");
        drop((guests, others));
        let entries = book.entries();
        assert!(entries.strangers.is_empty() && entries.known == 0);
    }

    #[test]
    fn unit_unauthenticated_client_expires() {
        let book = book(Duration::ZERO);
        let (stranger, mut evicted) = book.enter(address(1));
        let (known, mut known_evicted) = book.enter(address(2));
        known.admit();
        std::thread::sleep(Duration::from_millis(2));
        book.sweep();
        assert!(evicted.try_recv() == Ok(()) && known_evicted.try_recv() != Ok(()));
        drop(stranger);
    }

    #[test]
    fn unit_connections_use_half_of_the_file_descriptors() {
        for descriptors in [64, 256, 1024, 1 << 20] {
            let ConnectionLimits { strangers, known, of_address, .. } = ConnectionLimits::from_descriptors(descriptors);
            assert!(strangers + known <= descriptors / 2 && of_address <= strangers, "{descriptors}");
        }
    }
}
