//! A PROFINET IO device: the context manager of the crate `pnio` on UDP sockets. It writes down what
//! it receives.
//!
//! It knows requests in one piece and in either byte order, and answers big-endian. It has no
//! endpoint mapper, no fragments and no cancel: `tests/profinet/scapy_peer.py` plays those. Most
//! devices answer a request from another port than the one that was asked, so this one can, too.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use pnio::cm::{Cm, DeviceModel};
use pnio::eth::MacAddr;
use pnio::im::{INDEX_IM1, INDEX_IM2, INDEX_IM3, Im0, ImStore, SwRevision};
use pnio::rpc::Uuid;
use serde_json::{Value, json};

use super::eventually;

/// P-4: where devices and controllers listen.
pub const PNIO_PORT: u16 = 34964;

/// I&M0 to 3, as the device holds them.
pub const IDENTIFICATION: [(&str, &str); 9] = [
    ("vendor_id", "0x1f2e"),
    ("order_id", "PUMP-4711"),
    ("serial_number", "SN 0815"),
    ("hardware_revision", "3"),
    ("software_revision", "V1.20.3"),
    ("function", "Cooling water"),
    ("location", "Hall 2, row B"),
    ("installed", "2024-05-17 09:30"),
    ("descriptor", "Spare part in store"),
];
const VENDOR_ID: u16 = 0x1F2E;
/// The device's own number, which only the object UUID tells.
pub const DEVICE_ID: u16 = 0x0042;

/// The device at work. It ends when it is dropped.
#[derive(Debug)]
pub struct IoDevice {
    received: Arc<Mutex<Vec<Received>>>,
    over: Arc<AtomicBool>,
    listeners: Vec<JoinHandle<()>>,
}

/// A datagram that the device received.
#[derive(Clone, Debug)]
pub struct Received {
    /// Who sent it.
    pub from: SocketAddr,
    /// The port that it came to.
    pub port: u16,
    /// All of it.
    pub octets: Vec<u8>,
}

impl IoDevice {
    /// Starts a device in the calling thread's network namespace. It listens at port 34964 of this
    /// address and at the port that it answers from, which may be the same.
    pub fn start(address: IpAddr, answer_from: u16) -> io::Result<Self> {
        // A process that another scenario starts at this moment has a copy of every socket for a
        // short time, also of those of the device before.
        let bind = |port| {
            eventually("the device's port is free", || match UdpSocket::bind((address, port)) {
                Err(error) if error.kind() == ErrorKind::AddrInUse => None,
                bound => Some(bound.map(Arc::new)),
            })
        };
        let answers = bind(answer_from)?;
        let mut sockets = vec![Arc::clone(&answers)];
        if answer_from != PNIO_PORT {
            sockets.push(bind(PNIO_PORT)?);
        }
        let (received, over) = (Arc::default(), Arc::new(AtomicBool::new(false)));
        let cm = Arc::new(Mutex::new(context_manager()));
        let listener = |socket: Arc<UdpSocket>| {
            socket.set_read_timeout(Some(Duration::from_millis(20)))?;
            let listener = Listener {
                socket,
                answers: Arc::clone(&answers),
                cm: Arc::clone(&cm),
                received: Arc::clone(&received),
            };
            let over = Arc::clone(&over);
            Ok(thread::spawn(move || {
                while !over.load(Relaxed) {
                    listener.turn();
                }
            }))
        };
        let listeners = sockets.into_iter().map(listener).collect::<io::Result<_>>()?;
        Ok(Self { received, over, listeners })
    }

    /// What it has received so far, oldest first.
    pub fn received(&self) -> Vec<Received> {
        self.received.lock().unwrap().clone()
    }
}

impl Drop for IoDevice {
    fn drop(&mut self) {
        self.over.store(true, Relaxed);
        for listener in self.listeners.drain(..) {
            // What it panicked of is on stderr.
            let _ = listener.join();
        }
    }
}

/// One socket of the device.
struct Listener {
    socket: Arc<UdpSocket>,
    answers: Arc<UdpSocket>,
    cm: Arc<Mutex<Cm>>,
    received: Arc<Mutex<Vec<Received>>>,
}

impl Listener {
    /// Handles one datagram, or what is due when none came.
    fn turn(&self) {
        let mut octets = [0; 2048];
        let came = self.socket.recv_from(&mut octets);
        let mut cm = self.cm.lock().unwrap();
        let output = match came {
            Ok((length, from)) => {
                let octets = octets[..length].to_vec();
                let port = self.socket.local_addr().unwrap().port();
                let output = cm.handle_datagram(&octets, from, Instant::now());
                self.received.lock().unwrap().push(Received { from, port, octets });
                output.unwrap_or_default() // what it does not understand, it leaves
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => cm.tick(Instant::now()),
            // A controller that is gone, or the thread was stopped or traced.
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::ConnectionRefused | ErrorKind::Interrupted
                ) =>
            {
                return;
            }
            Err(error) => panic!("{error}"),
        };
        for outgoing in output.send {
            // A controller that cannot be reached asks again.
            let _ = self.answers.send_to(&outgoing.bytes, outgoing.to);
        }
    }
}

fn context_manager() -> Cm {
    let model = DeviceModel {
        vendor_id: VENDOR_ID,
        device_id: DEVICE_ID,
        ..DeviceModel::pnet_sample(MacAddr([0x02, 0, 0, 0, 0, 7]))
    };
    let im0 = Im0 {
        order_id: "PUMP-4711".to_owned(),
        serial_number: "SN 0815".to_owned(),
        hardware_revision: 3,
        software_revision: SwRevision { prefix: 'V', functional: 1, bug_fix: 20, internal: 3 },
        revision_counter: 2,
        profile_id: 0,
        profile_specific_type: 0,
    };
    let mut store = ImStore::new();
    let records = [
        (INDEX_IM1, 0x21, format!("{:32}{:22}", "Cooling water", "Hall 2, row B")),
        (INDEX_IM2, 0x22, format!("{:16}", "2024-05-17 09:30")),
        (INDEX_IM3, 0x23, format!("{:54}", "Spare part in store")),
    ];
    for (index, block_type, body) in records {
        let header = [0, block_type, 0, body.len() as u8 + 2, 1, 0];
        store.write(index, &[&header, body.as_bytes()].concat()).unwrap();
    }
    let mut cm = Cm::new(model, Uuid([0x5A; 16]));
    cm.set_im(im0, store);
    cm
}

impl Received {
    /// One line of the device's log: what kind of datagram this is, as its DCE/RPC header says. It is
    /// read here by hand, so that a fault of the codec cannot hide itself.
    pub fn log(&self) -> Value {
        const KINDS: [&str; 11] = [
            "request",
            "ping",
            "response",
            "fault",
            "working",
            "nocall",
            "reject",
            "ack",
            "cl_cancel",
            "fack",
            "cancel_ack",
        ];
        let mut line = json!({ "from": self.from, "port": self.port, "octets": self.octets.len() });
        if self.octets.len() < 80 || self.octets[0] != 4 {
            line["kind"] = "no DCE/RPC".into();
            return line;
        }
        let is_little = self.octets[4] & 0x10 != 0;
        let number = |at: usize, size: usize| {
            let octets = &self.octets[at..at + size];
            let add = |number: u64, octet: &u8| number << 8 | u64::from(*octet);
            if is_little { octets.iter().rev().fold(0, add) } else { octets.iter().fold(0, add) }
        };
        line["kind"] = KINDS.get(usize::from(self.octets[1])).copied().unwrap_or("unknown").into();
        line["little_endian"] = is_little.into();
        line["activity"] = format!(
            "{:08x}-{:04x}-{:04x}-{:02x}{:02x}-{:012x}",
            number(40, 4),
            number(44, 2),
            number(46, 2),
            self.octets[48],
            self.octets[49],
            self.octets[50..56].iter().fold(0_u64, |number, octet| number << 8 | u64::from(*octet))
        )
        .into();
        line["sequence"] = number(64, 4).into();
        line["opnum"] = number(68, 2).into();
        line["fragment"] = number(76, 2).into();
        line
    }
}
