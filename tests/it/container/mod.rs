//! `deploy/container` and `deploy/compose.yaml`, run by a Docker engine.

mod compose;
mod engine;

use std::fs;
use std::os::unix::fs::chown;
use std::path::Path;
use std::process::Command;

use self::engine::{Bridge, COMMIT, Container, Image, docker};
use crate::harness::{
    FIGURE_10, Peer, Place, Process, Relay, Settings, Site, WRONG, datagram, eventually, exchange,
    folder, resident,
};

/// As docs/container.md starts it.
const CONFINED: [&str; 6] =
    ["--read-only", "--cap-drop", "ALL", "--security-opt", "no-new-privileges", "--rm"];
const USER: u32 = 65532;
const MOST_OCTETS: u64 = 25_000_000;
/// Of memory, at five public ports.
const MOST_RESIDENT: u64 = 6_000_000;

/// `docker run`, by the command line that a user types.
fn docker_run(container: &Container, image: &Image, folder: &Path, options: &[&str]) -> Command {
    for entry in ["", "pnet-nat.toml", "secrets", "secrets/section-1"] {
        chown(folder.join(entry), Some(USER), Some(USER)).unwrap();
    }
    let volume = format!("{}:/etc/pnet-nat:ro", folder.to_str().unwrap());
    let mut run = Command::new("docker");
    run.args(["run", "--name", &container.0, "--user", "65532:65532", "--volume", &volume]);
    // Not to wait for 10 s.
    run.args(["--health-interval", "200ms"]).args(CONFINED).args(options).arg(&image.0);
    run
}

#[test]
fn the_image_is_small_and_says_what_it_is() {
    let Some(image) = Image::prebuilt() else { return };
    let of = |field: &str| docker(&["image", "inspect", "--format", field, &image.0]);
    let octets: u64 = of("{{.Size}}").parse().unwrap();
    assert!(octets < MOST_OCTETS, "{octets}");
    assert_eq!(of("{{.Config.User}}"), "65532:65532");
    for (label, text) in [
        ("title", "pnet-nat"),
        ("licenses", env!("CARGO_PKG_LICENSE")),
        ("version", env!("CARGO_PKG_VERSION")),
        ("revision", COMMIT),
    ] {
        let label = format!("{{{{index .Config.Labels \"org.opencontainers.image.{label}\"}}}}");
        assert_eq!(of(&label), text, "{label}");
    }
    println!("the image has {octets} octets");

    // Nobody is there to be asked.
    let asked = Command::new("docker").args(["run", "--rm", &image.0, "healthcheck"]).output();
    assert_eq!(asked.unwrap().status.code(), Some(1));
}

/// What nothing here can build, for no image can be pulled, and what the tests run are the same.
#[test]
fn both_dockerfiles_make_the_same_image() {
    let text = |name| {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/container");
        fs::read_to_string(format!("{folder}/{name}")).unwrap()
    };
    let image = |text: &str| text.split_once("\nFROM scratch\n").unwrap().1.to_owned();
    let rest = |text: &str| image(text).split_once('\n').unwrap().1.to_owned();
    let (built, prebuilt) = (text("Dockerfile"), text("prebuilt.Dockerfile"));
    let copied = "COPY --from=build /pnet-nat/target/dist/pnet-nat /usr/bin/pnet-nat";
    assert_eq!(image(&built).lines().next(), Some(copied));
    assert_eq!(image(&prebuilt).lines().next(), Some("COPY pnet-nat /usr/bin/pnet-nat"));
    assert_eq!(rest(&built), rest(&prebuilt));
}

/// The network of the host, as on an edge router.
#[test]
fn it_relays_on_the_hosts_network() {
    let Some(image) = Image::prebuilt() else { return };
    let (site, container) = (Site::claim(), Container::name());
    let configuration = site.configuration(&Settings::default());
    let health = format!("PNET_NAT_HEALTHCHECK_URL=http://{}/-/ready", site.admin());
    let relay = Relay::start_as(&configuration, site.admin(), |arguments| {
        let folder = Path::new(arguments[2]).parent().unwrap();
        docker_run(&container, &image, folder, &["--network", "host", "--env", &health])
    });
    is_confined(&relay.process);
    container.expect_healthy();

    let (client, node) = (site.client(), site.node(4));
    exchange(&client, site.public(4), &node, 4);
    let process = docker(&["inspect", "--format", "{{.State.Pid}}", &container.0]);
    let resident = resident(process.parse().unwrap());
    println!("it takes {resident} octets of memory");
    assert!(resident < MOST_RESIDENT, "{resident}; see link/record.sh");
    client.send(site.public(4), &datagram(&FIGURE_10, &[], WRONG));
    exchange(&client, site.public(4), &node, 4);
    relay.expect_drops(&[("request", "password_wrong", 1)]);

    // Node 5 is new.
    relay.configure(&configuration.replace("\"1-4\"", "\"1-5\""));
    docker(&["kill", "--signal", "HUP", &container.0]);
    eventually("it has reloaded", || relay.process.logged("reload").pop());
    exchange(&client, site.public(4), &node, 4);
    exchange(&client, site.public(5), &site.node(5), 5);

    relay.finish();
}

/// Nothing is mounted but its secret.
#[test]
fn it_relays_without_a_configuration_file() {
    let Some(image) = Image::prebuilt() else { return };
    let (site, container) = (Site::claim(), Container::name());
    let relay = Relay::start_as("", site.admin(), |arguments| {
        let secrets = Path::new(arguments[2]).parent().unwrap().join("secrets");
        for entry in ["", "section-1"] {
            chown(secrets.join(entry), Some(USER), Some(USER)).unwrap();
        }
        let mut run = Command::new("docker");
        run.args(["run", "--name", &container.0, "--network", "host"]).args(CONFINED);
        run.arg("--volume").arg(format!("{}:/run/secrets:ro", secrets.display()));
        let subnet = site.address(0);
        for variable in [
            format!("PNET_NAT_LISTEN={}", site.public_address()),
            format!("PNET_NAT_START_PORT={}", site.start_port()),
            format!("PNET_NAT_SUBNET={subnet}"),
            "PNET_NAT_NODES=1-4,33".to_owned(),
            format!("PNET_NAT_ALLOW={subnet}/24"),
            format!("PNET_NAT_ADMIN_LISTEN={}", site.admin()),
        ] {
            run.args(["--env", &variable]);
        }
        run.arg(&image.0);
        run
    });
    is_confined(&relay.process);
    exchange(&site.client(), site.public(4), &site.node(4), 4);
    relay.finish();
}

/// All that the kernel and the engine let it give up is given up, and it is nobody special.
fn is_confined(relay: &Process) {
    // The engine hands the log on a little late.
    let tells = || relay.log().find(|line| line["memory"].is_string());
    let line = eventually("a line that tells", tells);
    assert_eq!(line["user"], USER);
    for layer in ["memory", "no_new_privs", "capabilities", "landlock", "seccomp"] {
        assert_eq!(line[layer], "on", "{line}");
    }
}

/// Ports of the host, from where the engine hands datagrams on.
#[test]
fn it_relays_through_a_published_port_range() {
    let Some(image) = Image::prebuilt() else { return };
    let (bridge, site) = (Bridge::create(), Site::claim());
    let container = Container::name();
    let gateway = bridge.gateway();
    let configuration = Place {
        listen: r#"["0.0.0.0"]"#,
        admin: "127.0.0.1:9378".parse().unwrap(),
        start_port: site.start_port(),
        subnet: gateway.strip_suffix(".1").map(|net| format!("{net}.0").parse().unwrap()).unwrap(),
        allow: &format!("[\"{gateway}\"]"),
    }
    .configuration(&Settings::default());
    let folder = folder(&configuration);
    // To this host's loopback, the engine's own relay forwards; elsewhere the kernel does.
    let published = [site.public_address().to_string(), gateway.clone()]
        .map(|address| format!("{address}:20001-20004:20001-20004/udp"));
    let options = ["--network", &bridge.0, "--publish", &published[0], "--publish", &published[1]];
    let mut relay = Process::start(docker_run(&container, &image, folder.path(), &options));
    container.expect_healthy();
    is_confined(&relay);

    // This host is node 1 of the bridge's network.
    let node = Peer::bind(format!("{gateway}:34379").parse().unwrap());
    exchange(&site.client(), site.public(1), &node, 1);
    let from_outside = Peer::bind(format!("{gateway}:0").parse().unwrap());
    exchange(&from_outside, format!("{gateway}:20001").parse().unwrap(), &node, 1);

    let flows = eventually("both flows are told of", || {
        let flows = relay.logged("flow opened");
        (flows.len() == 2).then_some(flows)
    });
    let clients: Vec<_> = flows.iter().map(|flow| flow["client"].as_str().unwrap()).collect();
    // Of whom the engine's own relay forwards, the address is lost.
    assert!(clients[0].starts_with(&format!("{gateway}:")), "{clients:?}");
    assert_eq!(clients[1], from_outside.address().to_string());

    docker(&["stop", &container.0]);
    assert_eq!(relay.end(), Some(0), "{}", relay.stderr());
    assert!(!relay.logged("stopped").is_empty());
}
