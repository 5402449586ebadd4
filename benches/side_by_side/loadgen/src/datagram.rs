//! The one datagram that is sent, 38 octets: header, route, control-status, data-field-format,
//! 16 data octets with a number and a time, password.

/// Octets in the datagram.
pub const LEN: usize = 38;
/// What the relay is told to let pass.
pub const PASSWORD: [u8; 8] = *b"PNETPASS";
/// What it is told to refuse.
pub const WRONG_PASSWORD: [u8; 8] = *b"BADPASS!";
/// Where the route has the node address.
pub const NODE_ADDRESS: usize = 5;

const DATA: usize = 14;

/// Writes a request for this node.
pub fn write(octets: &mut [u8], node_address: u8, number: u64, time: u64, password: [u8; 8]) {
    let route = [0x02, node_address, 0x05, 0x02, 0x33, 0xfd, 0x81, 0xb1];
    octets[..4].copy_from_slice(&[0x02, 0, 0, 0]);
    octets[4..12].copy_from_slice(&route);
    octets[12..DATA].copy_from_slice(&[0x02, 16]);
    octets[DATA..DATA + 8].copy_from_slice(&number.to_le_bytes());
    octets[DATA + 8..DATA + 16].copy_from_slice(&time.to_le_bytes());
    octets[DATA + 16..LEN].copy_from_slice(&password);
}

/// Number and time of an answer; none when it has another length than the request.
pub fn read(octets: &[u8]) -> Option<(u64, u64)> {
    let octets: &[u8; LEN] = octets.try_into().ok()?;
    let word = |at: usize| octets[at..at + 8].try_into().map(u64::from_le_bytes).ok();
    Some((word(DATA)?, word(DATA + 8)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_gives_back_what_was_asked() {
        let mut octets = [0; LEN];
        write(&mut octets, 7, 5, 6, PASSWORD);
        assert_eq!(octets[..14], [2, 0, 0, 0, 2, 7, 5, 2, 0x33, 0xfd, 0x81, 0xb1, 2, 16]);
        assert!(octets.ends_with(b"PNETPASS"));
        assert_eq!(read(&octets), Some((5, 6)));
        assert_eq!(read(&octets[1..]), None);
    }
}
