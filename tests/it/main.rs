//! What crosses modules, shown on the real binary: one file a subject, and the
//! harness of `tests/rig` for all.
//!
//! Nothing leaves the machine: every address is of 127/8 or of a network namespace that the test
//! made. Each scenario has a /24 of loopback to itself, so they run side by side. A scenario that
//! needs what the machine lacks says so and is left out; with `PNET_NAT_TESTS=all` it fails.

mod adapter;
mod admin;
mod audit;
mod bad_input;
mod bgp;
mod causes;
mod check;
mod client_sheet;
mod command_line;
mod commands;
mod confinement;
mod container;
mod control;
mod decode;
mod decode_profinet;
mod drops;
mod early_signals;
mod environment;
mod events;
mod fail2ban;
mod failover;
mod faults;
mod figure_11;
mod floods;
mod forged;
mod init;
mod inventory;
mod killed;
mod kubernetes;
mod loops;
mod moving;
mod namespaces;
mod nat;
mod offload;
mod package;
mod password;
mod probe;
mod profinet;
mod profinet_judge;
mod prometheus;
mod refused;
mod relaying;
mod reloading;
mod request;
mod rotation;
mod scale;
mod schema;
mod side_by_side;
mod status;
mod status_page;
mod status_reach;
mod status_views;
mod stopping;
mod translate;
mod tunnel;
mod unicast;
mod upstream_ports;
mod watching;
mod wireshark;

use pnet_nat_rig::harness;
