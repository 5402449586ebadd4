"""The systems that are compared: how each is told to relay the public ports to the nodes.

An entry of SYSTEMS has
    about      one line for people
    program    what has to be installed or built (none: the kernel does it)
    files      function(site) -> {name: text}, written before the start
    commands   function(site) -> list of argument lists, run in `edge`; they stay in the foreground
    setup      function(site) -> list of argument lists, run in `edge` before the start
    forward    True when the kernel has to route packets in `edge`
    targets    function(site) -> what the clients ask (otherwise PUBLIC : BASE_PORT and up)
"""
import base64
import os

from lab import PUBLIC, SERVER_PORT, find

BASE_PORT = 40001  # of node 1
SUBNET = "172.17.17."


class Site:
    """So many nodes, and a folder for the system's files."""

    def __init__(self, nodes, folder):
        self.nodes, self.folder = nodes, folder
        self.pairs = [(BASE_PORT + i, f"{SUBNET}{i + 1}") for i in range(nodes)]
        self.targets = f"{PUBLIC}:{BASE_PORT}-{BASE_PORT + nodes - 1}"


def nft(site):
    pairs = ", ".join(f"{port} : {node} . {SERVER_PORT}" for port, node in site.pairs)
    last = BASE_PORT + site.nodes - 1
    return {"nat.nft": f"""table ip side_by_side {{
  map nodes {{ type inet_service : ipv4_addr . inet_service; elements = {{ {pairs} }} }}
  chain pre {{ type nat hook prerouting priority dstnat;
    ip daddr {PUBLIC} udp dport {BASE_PORT}-{last} dnat ip to udp dport map @nodes;
  }}
  chain post {{ type nat hook postrouting priority srcnat; oifname "plant0" masquerade;
  }}
}}
"""}


def nginx(site):
    module = "/usr/lib/nginx/modules/ngx_stream_module.so"
    load = f"load_module {module};" if os.path.exists(module) else ""
    servers = "\n".join(
        f"  server {{ listen {PUBLIC}:{port} udp reuseport; proxy_pass {node}:{SERVER_PORT}; }}"
        for port, node in site.pairs)
    return {"nginx.conf": f"""{load}
worker_processes 2;
daemon off;
pid {site.folder.path('nginx.pid')};
error_log {site.folder.path('nginx.err')} warn;
worker_rlimit_nofile 65536;
events {{ worker_connections 16384; }}
stream {{
  proxy_timeout 30s;
  proxy_connect_timeout 1s;
  access_log off;
{servers}
}}
"""}


def realm(site):
    endpoints = "".join(
        f'[[endpoints]]\nlisten = "{PUBLIC}:{port}"\nremote = "{node}:{SERVER_PORT}"\n'
        for port, node in site.pairs)
    return {"realm.toml": f'[log]\nlevel = "warn"\n[network]\nno_tcp = true\nuse_udp = true\n{endpoints}'}


def quilkin(site):
    # It knows no map from ports to nodes: one port for all, and the first six octets, header and
    # node address, are the token that it routes by.
    endpoints = "".join(
        f"  - address: {node}:{SERVER_PORT}\n    metadata:\n      quilkin.dev:\n        tokens:\n"
        f"        - {base64.b64encode(bytes([2, 0, 0, 0, 2, i + 1])).decode()}\n"
        for i, (_, node) in enumerate(site.pairs))
    return {"quilkin.yaml": f"""version: v1alpha1
filters:
- name: quilkin.filters.capture.v1alpha1.Capture
  config:
    prefix:
      size: 6
      remove: false
- name: quilkin.filters.token_router.v1alpha1.TokenRouter
  config: {{}}
clusters:
- endpoints:
{endpoints}"""}


def pnet_nat(datapath=""):
    return lambda site: {"pnet-nat.toml": f"""[public]
listen = ["{PUBLIC}"]
[[udp_range_net]]
name = "bench"
start_port = {BASE_PORT - 1}
subnet = "{SUBNET}0"
nodes = ["1-{site.nodes}"]
allow = ["0.0.0.0/0"]
max_flows = 65536
  [[udp_range_net.password]]
  name = "bench"
  file = "password"
[datapath]
{datapath}
[admin]
listen = "127.0.0.1:9378"
""", "password": "PNETPASS"}


def ideal(*more):
    return lambda site: [[
        find("idealrelay"), "--listen", f"{PUBLIC}:{BASE_PORT}", "--node",
        f"{SUBNET}1:{SERVER_PORT}", "--count", str(site.nodes), *more]]


def run_pnet_nat(site):
    return [[find("pnet-nat"), "run", "--config", site.folder.path("pnet-nat.toml")]]


SYSTEMS = {
    "direct": dict(
        about="no relay and no NAT: the kernel only routes", forward=True,
        targets=lambda site: f"{SUBNET}1-{site.nodes}:{SERVER_PORT}"),
    "nft-nat": dict(
        about="the kernel's NAT: nftables, DNAT map and masquerade", forward=True, files=nft,
        setup=lambda site: [[find("nft"), "-f", site.folder.path("nat.nft")]]),
    "nginx": dict(
        about="nginx stream proxy, two workers, reuseport", program="nginx", files=nginx,
        commands=lambda site: [[find("nginx"), "-c", site.folder.path("nginx.conf"), "-p", site.folder.name]]),
    "realm": dict(
        about="realm, default worker threads", program="realm", files=realm,
        commands=lambda site: [[find("realm"), "-c", site.folder.path("realm.toml")]]),
    "quilkin": dict(
        about="Quilkin 0.10, two workers, one port, node chosen by token", program="quilkin",
        files=quilkin,
        commands=lambda site: [[
            find("quilkin"), "--service.udp", f"--service.udp.port={BASE_PORT}",
            "--service.udp.workers=2", "--provider.fs",
            f"--provider.fs.path={site.folder.path('quilkin.yaml')}"]],
        targets=lambda site: ",".join(f"{PUBLIC}:{BASE_PORT}@{i + 1}" for i in range(site.nodes))),
    "socat": dict(
        about="a socat for each port, which forks for each flow", program="socat",
        commands=lambda site: [
            [find("socat"), "-T5", f"UDP4-LISTEN:{port},bind={PUBLIC},fork,reuseaddr",
             f"UDP4:{node}:{SERVER_PORT}"] for port, node in site.pairs]),
    "ideal": dict(
        about="yardstick: a relay as lean as plain sockets allow, no checks",
        program="idealrelay", commands=ideal()),
    "ideal-filter": dict(
        about="the same with a filter in the kernel for header and password",
        program="idealrelay", commands=ideal("--filter")),
    "pnet-nat": dict(
        about="this project on sockets: every datagram checked", program="pnet-nat",
        files=pnet_nat('kernel = "off"'), commands=run_pnet_nat),
    "pnet-nat-kernel": dict(
        about="the same with open flows in the kernel", program="pnet-nat",
        files=pnet_nat('kernel = "required"'), commands=run_pnet_nat),
    "pnet-nat-busy": dict(
        about='on sockets with busy_poll = "100us"', program="pnet-nat",
        files=pnet_nat('kernel = "off"\nbusy_poll = "100us"'), commands=run_pnet_nat),
}
