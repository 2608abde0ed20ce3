//! Connections: accepted, limited in number, and served until they end.
//!
//! A client that opens connections and says nothing loses them to the next ones; a client that has shown a right
//! keeps its own.

use super::access::Caller;
use super::app::App;
use super::peer;
use super::routes;
use axum::Router;
use hyper::server::conn::http1;
use hyper::service::Service as _;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rustix::net::sockopt;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::AbortHandle;

/// Most connections at the same time.
const CONNECTIONS: usize = 128;
/// Time for the head of a request, also for the next one of a connection.
const HEAD_PATIENCE: Duration = Duration::from_secs(10);
/// Largest head of a request, bytes.
const HEAD_BYTES: usize = 32 << 10;
/// Time after which a connection whose client takes nothing is closed.
const UNREAD_MS: u32 = 10_000;
/// Pause when the system refuses a connection.
const PAUSE: Duration = Duration::from_millis(100);

/// A connection, as handlers see it.
pub struct Connection {
    local: SocketAddr,
    peer: SocketAddr,
    user: OnceLock<Option<u32>>,
    /// Set when a request has shown a right.
    is_trusted: Arc<AtomicBool>,
}

impl Connection {
    /// Where it comes from. The user is looked up at the first call.
    pub fn caller(&self) -> Caller {
        let is_here = self.peer.ip().to_canonical().is_loopback();
        let look_up = || is_here.then(|| peer::user_of(self.peer, self.local)).flatten();
        Caller { local: self.local, peer: self.peer, user: *self.user.get_or_init(look_up) }
    }

    /// A request has shown a right.
    pub fn trust(&self) {
        self.is_trusted.store(true, Ordering::Relaxed);
    }
}

struct Served {
    task: AbortHandle,
    is_trusted: Arc<AtomicBool>,
}

/// Accepts and serves connections, as long as the process runs.
pub async fn serve(listener: TcpListener, app: Arc<App>) {
    let router = routes::router(app);
    let mut served: Vec<Served> = Vec::new();
    loop {
        // Descriptors may have run out.
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(PAUSE).await;
            continue;
        };
        served.retain(|it| !it.task.is_finished());
        if served.len() >= CONNECTIONS {
            let is_stranger = |it: &Served| !it.is_trusted.load(Ordering::Relaxed);
            // Without one, the new connection is closed.
            let Some(oldest) = served.iter().position(is_stranger) else { continue };
            served.remove(oldest).task.abort();
        }
        let Ok(local) = stream.local_addr() else { continue };
        let is_trusted = Arc::new(AtomicBool::new(false));
        let connection =
            Connection { local, peer, user: OnceLock::new(), is_trusted: Arc::clone(&is_trusted) };
        let task = tokio::spawn(converse(stream, connection, router.clone()));
        served.push(Served { task: task.abort_handle(), is_trusted });
    }
}

async fn converse(stream: TcpStream, connection: Connection, router: Router) {
    // Both only make the answer better.
    let _ = stream.set_nodelay(true);
    let _ = sockopt::set_tcp_user_timeout(&stream, UNREAD_MS);
    let connection = Arc::new(connection);
    let inner = TowerToHyperService::new(router);
    let service = hyper::service::service_fn(move |mut request: hyper::Request<_>| {
        request.extensions_mut().insert(Arc::clone(&connection));
        inner.call(request)
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_PATIENCE)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades()
        .await;
    // A connection that fails concerns its client alone.
    drop(served);
}
