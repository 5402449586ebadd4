//! Node addresses as people write them: `4`, or `1-4`.

use std::ops::RangeInclusive;
use std::str::FromStr;

use crate::pnet::wire::LAST_NODE;

use super::report::quoted;
use super::toml_table::Entry;

/// One node address or a run of them, each within 1..=125 (R-11, PAS 8 and 10).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeRange(pub RangeInclusive<u8>);

/// A text that is neither a node address nor a range of them.
#[derive(Debug, thiserror::Error)]
#[error("node addresses are 1 to {LAST_NODE}: write one like \"4\", or a range like \"1-4\"")]
pub struct NotANodeRange;

impl FromStr for NodeRange {
    type Err = NotANodeRange;

    fn from_str(text: &str) -> Result<Self, NotANodeRange> {
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        let (first, last) = (node_address(first)?, node_address(last)?);
        if first > last {
            return Err(NotANodeRange);
        }
        Ok(Self(first..=last))
    }
}

fn node_address(text: &str) -> Result<u8, NotANodeRange> {
    text.parse()
        .ok()
        .filter(|node_address| (1..=LAST_NODE).contains(node_address))
        .ok_or(NotANodeRange)
}

/// Node addresses, in their order.
pub(super) fn nodes(entry: &Entry<'_>) -> Vec<u8> {
    // One bit for each node: a list may repeat all of them very often.
    let mut nodes = 0_u128;
    for element in entry.list() {
        let Some((first, last)) = node_range(&element) else { continue };
        let these = u128::MAX >> (127 - last) & u128::MAX << first;
        if nodes & these != 0 {
            let node = (nodes & these).trailing_zeros();
            element.fault(format!("node {node} is listed twice"), "name each node once");
        }
        nodes |= these;
    }
    (1..=LAST_NODE).filter(|node| nodes >> node & 1 == 1).collect()
}

/// `33` or `"1-4"`.
fn node_range(entry: &Entry<'_>) -> Option<(u8, u8)> {
    if entry.is_integer() {
        return entry.integer(1..=LAST_NODE).map(|node| (node, node));
    }
    let text = entry.text()?;
    match text.parse::<NodeRange>() {
        Ok(NodeRange(range)) => Some(range.into_inner()),
        Err(error) => {
            let problem = format!("{} is not a range of node addresses", quoted(text));
            entry.fault(problem, error.to_string());
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_address_or_a_rising_range_within_1_to_125() {
        assert_eq!("4".parse::<NodeRange>().unwrap(), NodeRange(4..=4));
        assert_eq!("1-125".parse::<NodeRange>().unwrap(), NodeRange(1..=125));
        for bad in ["", "0", "126", "0-4", "4-1", "1-126", "1-2-3", "-4", "four"] {
            assert!(bad.parse::<NodeRange>().is_err(), "{bad:?}");
        }
    }
}
