//! Datagrams as hex text, one a line.

use std::io::{BufRead, Read};

use anyhow::bail;

/// Octets in the longest line: enough for any UDP datagram with spaces and a comment.
const LONGEST_LINE: u64 = 256 * 1024;

/// Calls `each` with the number and the octets of every line that has any.
///
/// Fails at a line that is not hex text. The error does not show the line: it may be a password.
pub(super) fn read(
    mut input: impl BufRead,
    mut each: impl FnMut(u64, &[u8]) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        if input.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line)? == 0 {
            break;
        }
        let Some(octets) = octets(&line).filter(|_| line.len() < LONGEST_LINE as usize) else {
            bail!(
                "line {number} is not hex text, and the input is not a capture: write a datagram as \
                 pairs of hexadecimal digits, or give a pcap or pcapng file"
            );
        };
        if !octets.is_empty() {
            each(number, &octets)?;
        }
    }
    Ok(())
}

/// The octets of a line without its comment.
pub(in crate::cli) fn octets(line: &[u8]) -> Option<Vec<u8>> {
    let text = line.split(|&octet| octet == b'#').next()?;
    let words = text.split(|octet| octet.is_ascii_whitespace() || *octet == b':');
    let mut octets = Vec::new();
    for word in words {
        let (pairs, rest) = word.as_chunks::<2>();
        if !rest.is_empty() {
            return None;
        }
        for &[high, low] in pairs {
            let digit = |digit: u8| char::from(digit).to_digit(16);
            octets.push((digit(high)? * 16 + digit(low)?) as u8);
        }
    }
    Some(octets)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is read up to the end or a fault, and the fault.
    fn all(text: &[u8]) -> (Vec<(u64, Vec<u8>)>, Option<String>) {
        let mut lines = Vec::new();
        let end = read(text, |number, octets| {
            lines.push((number, octets.to_vec()));
            Ok(())
        });
        (lines, end.err().map(|error| error.to_string()))
    }

    #[test]
    fn a_datagram_a_line_with_blanks_colons_and_remarks() {
        let text = b"02000000 0483\n\n# nothing\n  0A:0b:FF  # three\r\n00";
        let (lines, fault) = all(text);
        assert_eq!(fault, None);
        let right = [(1, vec![2, 0, 0, 0, 4, 0x83]), (4, vec![10, 11, 255]), (5, vec![0])];
        assert_eq!(lines, right);
    }

    #[test]
    fn what_is_not_hex_is_told_by_its_line_and_not_repeated() {
        for bad in ["s3cr3t-A", "020", "02 0", "0x02", "+2", "\u{e9}1"] {
            let (lines, fault) = all(format!("0200\n{bad}\n0201\n").as_bytes());
            assert_eq!(lines.len(), 1);
            let fault = fault.unwrap();
            assert!(fault.contains("line 2") && !fault.contains(bad), "{fault}");
        }
    }

    #[test]
    fn a_line_without_end_is_given_up() {
        let endless = std::io::BufReader::new(std::io::repeat(b'0'));
        let fault = read(endless, |_, _| panic!("that is no line")).unwrap_err();
        assert!(fault.to_string().contains("line 1"));
    }
}
