//! Two relays behind one address: the files of `deploy/keepalived`, run as they are but for the
//! path of the program, and for what each router has of its own.
//!
//! Needs root and keepalived. The Internet and the plant are a switch each, with both edges on it.

use std::fs::{self, Permissions};
use std::net::Ipv4Addr;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use nix::sys::signal::Signal;
use tempfile::TempDir;

use crate::harness::{
    ANNOTATED, Namespace, Peer, Process, Relay, eventually, left_out, pause, pnet_nat, request,
};

const KEEPALIVED: &str = include_str!("../../deploy/keepalived/keepalived.conf");

/// What a client waits for an answer before it asks again. A P-NET client has seconds.
const TIME_OUT: Duration = Duration::from_secs(3);

const VIRTUAL: &str = "198.51.100.10";

fn has_keepalived() -> bool {
    let has = Command::new("keepalived").arg("--version").output().is_ok();
    if !has {
        left_out("keepalived, of the package of that name");
    }
    has
}

/// The two edges between their two switches.
struct Site {
    internet: Namespace,
    plant: Namespace,
    edges: [Namespace; 2],
}

impl Site {
    fn build() -> Option<Self> {
        let made = Namespace::new("inet").and_then(|internet| {
            let (plant, first) = (Namespace::new("plant")?, Namespace::new("edge1")?);
            Ok(Self { internet, plant, edges: [first, Namespace::new("edge2")?] })
        });
        match made {
            Ok(site) => {
                site.cable();
                Some(site)
            }
            Err(error) => {
                left_out(&format!("network namespaces, which need root and iproute2: {error}"));
                None
            }
        }
    }

    fn cable(&self) {
        let switch = "link set lo up\nlink add eth0 type bridge\nlink set eth0 up";
        self.internet.ip(&format!("{switch}\naddress add 198.51.100.7/24 dev eth0"));
        self.plant.ip(&format!("{switch}\naddress add 172.17.17.4/24 dev eth0"));
        for (index, edge) in self.edges.iter().enumerate() {
            let name = edge.name();
            for (switch, far) in [(&self.internet, "eth0"), (&self.plant, "eth1")] {
                switch.ip(&format!(
                    "link add port{index} type veth peer name {far} netns {name}\n\
                     link set port{index} master eth0\n\
                     link set port{index} up"
                ));
            }
            let own = 251 + index;
            edge.ip(&format!(
                "link set lo up\nlink set eth0 up\nlink set eth1 up\n\
                 address add 198.51.100.{own}/24 dev eth0\n\
                 address add 172.17.17.{own}/24 dev eth1"
            ));
        }
    }
}

/// A router of the pair.
struct Edge<'a> {
    namespace: &'a Namespace,
    relay: Option<Relay>,
    keepalived: Option<Process>,
    priority: u8,
    programs: &'a Path,
    files: TempDir,
}

impl<'a> Edge<'a> {
    fn start(namespace: &'a Namespace, priority: u8, programs: &'a Path) -> Self {
        let files = tempfile::tempdir().unwrap();
        let mut edge = Self { namespace, relay: None, keepalived: None, priority, programs, files };
        edge.start_relay();
        edge.start_keepalived();
        edge
    }

    fn start_relay(&mut self) {
        let admin = (Ipv4Addr::LOCALHOST, 9378).into();
        let relay = self.namespace.enter(|| Relay::start(ANNOTATED, admin, None));
        self.relay = Some(relay);
    }

    fn start_keepalived(&mut self) {
        let program = self.programs.join("pnet-nat");
        let own = [
            ("/usr/bin/pnet-nat", program.to_str().unwrap()),
            ("router_id edge-1", &format!("router_id edge-{}", self.priority)),
            ("priority 100", &format!("priority {}", self.priority)),
        ];
        let fill = |text: String, (from, to): (&str, &str)| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        };
        let configuration = own.into_iter().fold(KEEPALIVED.to_owned(), fill);
        let file = |name: &str| self.files.path().join(name);
        fs::write(file("keepalived.conf"), configuration).unwrap();
        let mut command = Command::new("keepalived");
        command.args(["--dont-fork", "--log-console", "--log-detail", "--vrrp"]);
        command.arg("--use-file").arg(file("keepalived.conf"));
        command.arg("--pid").arg(file("pid")).arg("--vrrp_pid").arg(file("vrrp.pid"));
        self.keepalived = Some(self.namespace.enter(|| Process::start(command)));
    }

    fn has_the_address(&self) -> bool {
        self.namespace.output(&["ip", "-4", "address", "show", "dev", "eth0"]).contains(VIRTUAL)
    }

    fn get_relay(&self) -> &Relay {
        self.relay.as_ref().unwrap()
    }

    /// Requests that it passed on.
    fn passed_on(&self) -> u64 {
        self.namespace.enter(|| {
            let labels = [("direction", "request")];
            self.get_relay().metrics().sum("pnet_nat_forwarded_datagrams_total", &labels)
        })
    }

    fn finish(mut self) {
        self.namespace.enter(|| {
            self.relay.take().unwrap().finish();
        });
        self.end_keepalived(Signal::SIGTERM);
    }

    /// Its child, which holds the address, ends with it.
    fn end_keepalived(&mut self, signal: Signal) {
        let mut keepalived = self.keepalived.take().unwrap();
        keepalived.signal(signal);
        keepalived.status();
        eventually("the address is given up", || (!self.has_the_address()).then_some(()));
    }
}

/// A client that asks again and again; tells how many of its requests were lost until one was
/// answered as often as it wants.
fn poll(client: &Peer, answers: u32) -> u32 {
    let (public, mut lost) = (format!("{VIRTUAL}:20004").parse().unwrap(), 0);
    for _ in 0..answers {
        loop {
            client.send(public, &request(4));
            let Some((_, from)) = client.receive_within(TIME_OUT) else {
                lost += 1;
                assert!(lost < 10, "the address is not taken over");
                continue;
            };
            assert_eq!(from, public, "who answers");
            break;
        }
        pause(Duration::from_millis(20));
    }
    lost
}

/// What a client sees when the relay in charge dies, and when keepalived beside it does.
#[test]
fn a_polling_client_goes_on_after_its_own_time_out() {
    if !has_keepalived() {
        return;
    }
    let Some(site) = Site::build() else { return };
    // Root's alone down to the last folder, or keepalived does not run it.
    let programs = tempfile::tempdir_in("/run").unwrap();
    let program = programs.path().join("pnet-nat");
    fs::copy(pnet_nat(&[]).get_program(), &program).unwrap();
    for path in [programs.path(), &program] {
        fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
    }
    let client = site.internet.peer("198.51.100.7:0".parse().unwrap());
    let _node = site.plant.enter(|| {
        let files = crate::harness::folder("");
        let password = files.path().join("secrets/section-1");
        let password = password.to_str().unwrap();
        let arguments = ["node", "--listen", "172.17.17.4", "--password-file", password];
        let node = Process::start(pnet_nat(&arguments));
        eventually("the node is there", || (!node.stdout().is_empty()).then_some(()));
        node
    });

    let [first, second] = &site.edges;
    let mut first = Edge::start(first, 101, programs.path());
    eventually("the first has the address", || first.has_the_address().then_some(()));
    let mut second = Edge::start(second, 100, programs.path());
    assert_eq!(poll(&client, 50), 0);

    // The relay in charge dies: the request that meets this is lost, the next one is answered.
    let mut killed = first.relay.take().unwrap();
    killed.process.signal(Signal::SIGKILL);
    killed.process.end(); // so long, what the kernel carries goes on
    assert_eq!(poll(&client, 50), 1);
    assert!(second.has_the_address() && !first.has_the_address());
    drop(killed);

    // It comes back, and nothing changes.
    first.start_relay();
    assert_eq!(poll(&client, 150), 0);
    assert!(second.has_the_address() && !first.has_the_address());

    // keepalived of the one in charge dies.
    second.end_keepalived(Signal::SIGKILL);
    assert!(poll(&client, 50) <= 1);
    assert!(first.has_the_address());
    let passed_on = [&first, &second].map(Edge::passed_on);
    assert!(passed_on[0] >= 50 && passed_on[1] >= 200, "{passed_on:?}");
    second.start_keepalived();
    for edge in [first, second] {
        edge.finish();
    }
}
