//! Whether the kernel still translates addresses for a public port: entries of an old rule take requests
//! past the relay, for as long as a client goes on asking.

use std::collections::BTreeSet;

use crate::config::runs;
use crate::probe::Check;

/// The check of the public ports of a net. `entries` is what /proc/net/nf_conntrack or `conntrack -L` has;
/// none: it cannot be read.
pub(super) fn judge(net: &str, ports: &[u16], entries: Option<&str>) -> Check {
    const CHECK: &str = "conntrack";
    let Some(entries) = entries else {
        return Check::unknown(
            CHECK,
            net,
            "the kernel's entries of address translation cannot be read",
        )
        .remedy("run the probe as root, with conntrack there");
    };
    let taken: BTreeSet<u16> = entries.lines().filter_map(translated).collect();
    let taken: Vec<_> = taken.into_iter().filter(|port| ports.contains(port)).collect();
    let Some(first) = taken.first() else {
        return Check::good(CHECK, net, "the kernel translates none of the public ports");
    };
    let text = format!(
        "an address translation of the kernel takes requests to UDP {} past the relay",
        runs(&taken)
    );
    Check::bad(CHECK, net, text).remedy(format!(
        "remove its rule, and delete its entries for each port: conntrack -D -p udp --orig-port-dst {first}"
    ))
}

/// The port that an entry translates to another address or port.
fn translated(entry: &str) -> Option<u16> {
    let words: Vec<_> = entry.split_whitespace().collect();
    if !words.contains(&"udp") {
        return None;
    }
    let values = |key: &str| {
        let values = words.iter().filter_map(|word| word.strip_prefix(key)?.strip_prefix('='));
        values.map(str::to_owned).collect::<Vec<_>>()
    };
    // The first of each is of the request, the second of the answer.
    let [sources, destinations, from, to] = ["src", "dst", "sport", "dport"].map(values);
    let is_same = sources.get(1) == destinations.first() && from.get(1) == to.first();
    if is_same { None } else { to.first()?.parse().ok() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::Verdict;

    #[test]
    fn entries_of_an_old_rule_are_found() {
        let plain = "udp 17 29 src=198.51.100.7 dst=203.0.113.5 sport=5000 dport=20004 [UNREPLIED] \
                     src=203.0.113.5 dst=198.51.100.7 sport=20004 dport=5000 mark=0 use=1\n";
        let other = "ipv4 2 tcp 6 29 src=198.51.100.7 dst=203.0.113.5 sport=5000 dport=20004 \
                     src=172.17.17.4 dst=198.51.100.7 sport=34379 dport=5000\n";
        let old = "ipv4     2 udp      17 29 src=198.51.100.7 dst=203.0.113.5 sport=5000 dport=20004 \
                   src=172.17.17.4 dst=198.51.100.7 sport=34379 dport=5000 mark=0 zone=0 use=2\n";
        let judge = |entries: &str| judge("section-1", &[20003, 20004], Some(entries)).verdict;
        assert_eq!(judge(""), Verdict::Good);
        assert_eq!(judge(&(plain.to_owned() + other + "udp odd dport=x\n")), Verdict::Good);
        assert_eq!(judge(&(plain.to_owned() + old)), Verdict::Bad);
        assert_eq!(judge(&old.replace("dport=20004", "dport=20005")), Verdict::Good);
        assert_eq!(super::judge("n", &[1], None).verdict, Verdict::Unknown);
    }
}
