//! Where the admin server listens: on a TCP port, on the control socket, or on both.

use std::future;
use std::io;
use std::net::{IpAddr, TcpListener as StdTcpListener};
use std::os::unix::net::UnixListener as StdUnixListener;

use socket2::SockRef;
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixStream};

use super::connections::Source;

/// How many octets may wait unsent in the kernel. With few, it shows how fast a client reads.
const UNSENT: u32 = 16 * 1024;

/// The sockets that the admin server accepts connections from.
#[derive(Debug)]
pub struct Listeners {
    tcp: Option<TcpListener>,
    control: Option<UnixListener>,
}

/// A connection that was accepted.
#[derive(Debug)]
pub(super) enum Connection {
    Tcp(TcpStream, IpAddr),
    Control(UnixStream),
}

impl Listeners {
    /// Takes over sockets that do not block.
    pub fn from_std(
        tcp: Option<StdTcpListener>,
        control: Option<StdUnixListener>,
    ) -> io::Result<Self> {
        Ok(Self {
            tcp: tcp.map(TcpListener::from_std).transpose()?,
            control: control.map(UnixListener::from_std).transpose()?,
        })
    }

    /// Waits for the next connection.
    pub(super) async fn accept(&self) -> io::Result<Connection> {
        let tcp = async {
            match &self.tcp {
                Some(listener) => listener.accept().await,
                None => future::pending().await,
            }
        };
        let control = async {
            match &self.control {
                Some(listener) => listener.accept().await,
                None => future::pending().await,
            }
        };
        tokio::select! {
            accepted = tcp => accepted.map(|(stream, from)| Connection::Tcp(stream, from.ip())),
            accepted = control => accepted.map(|(stream, _)| Connection::Control(stream)),
        }
    }
}

impl Connection {
    /// Whom it is counted for.
    pub(super) fn source(&self) -> Source {
        match self {
            Self::Tcp(_, from) => Source::of(*from),
            Self::Control(_) => Source::Control,
        }
    }

    /// If this fails, a slow client is cut a little early.
    pub(super) fn keep_little_unsent(&self) {
        let _ = match self {
            Self::Tcp(stream, _) => SockRef::from(stream).set_tcp_notsent_lowat(UNSENT),
            Self::Control(stream) => SockRef::from(stream).set_send_buffer_size(UNSENT as usize),
        };
    }
}
