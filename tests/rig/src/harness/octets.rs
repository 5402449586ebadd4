//! Datagrams written by hand, so that a fault of the codec cannot hide itself.

/// R-5, A1.
const HEADER: [u8; 4] = [0x02, 0, 0, 0];

/// The clients' password, in the file `secrets/section-1`.
pub const PASSWORD: &[u8; 8] = b"s3cr3t-A";
/// Another password, in the file `secrets/press`.
pub const SECOND: &[u8; 8] = b"s3cr3t-B";
/// The device password, in the file `secrets/section-1-device`.
pub const DEVICE: &[u8; 8] = b"d3v1c3-C";
/// A password that a stranger guesses.
pub const WRONG: &[u8; 8] = b"gu3ss3d!";

/// All passwords that the relay must never show.
pub const PASSWORDS: [&[u8; 8]; 4] = [PASSWORD, SECOND, DEVICE, WRONG];

/// The route of PAS Figure 10. It leads to node 4 of IP net 11, and on to 2 and 33 behind that
/// node. It comes from node 3 of IP net 11, endpoint 31.
pub const FIGURE_10: [u8; 8] = [0x0B, 0x04, 0x05, 0x02, 0x21, 0x8B, 0x83, 0x9F];

/// A datagram: header, route, control-status, data-field-format, data octets, and a password or
/// nothing.
pub fn datagram(route: &[u8], data_octets: &[u8], password: &[u8]) -> Vec<u8> {
    let control = [0x0C, data_octets.len() as u8];
    [&HEADER, route, &control, data_octets, password].concat()
}

/// The request of Figure 10, to this node.
pub fn request(node_address: u8) -> Vec<u8> {
    let mut route = FIGURE_10;
    route[1] = node_address;
    datagram(&route, &[0x11, 0x22, node_address], PASSWORD)
}

/// The answer of this node to such a request. The route is the way back, unconfirmed.
pub fn response(node_address: u8) -> Vec<u8> {
    let route = [0x0B, 0x03, 0x06, 0x1F, 0x8B, 0x80 | node_address, 0x82, 0xA1, 0x80];
    datagram(&route, &[0x33, node_address], PASSWORD)
}
