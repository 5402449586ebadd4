//! How commands ask a relay's admin server: straight, without proxies of the environment and without
//! redirects, and also where the system has no thread left.

use std::net::IpAddr;
use std::sync::mpsc;
use std::time::Duration;

use ureq::config::Config;
use ureq::http::Uri;
use ureq::unversioned::resolver::{DefaultResolver, ResolvedSocketAddrs, Resolver};
use ureq::unversioned::transport::{DefaultConnector, NextTimeout, time};
use ureq::{Agent, Error};

use crate::thread;

/// Asks, and gives up after this time.
pub(super) fn agent(timeout: Duration) -> Agent {
    let config = Agent::config_builder()
        .timeout_global(Some(timeout))
        .http_status_as_error(false)
        .max_redirects(0)
        .proxy(None)
        .build();
    Agent::with_parts(config, DefaultConnector::default(), Names)
}

/// Looks names up in a thread, for a name server may take longer than there is time. Addresses and
/// `localhost` need none; nor does anything else where there is none.
#[derive(Debug)]
struct Names;

impl Resolver for Names {
    fn resolve(
        &self,
        uri: &Uri,
        config: &Config,
        timeout: NextTimeout,
    ) -> Result<ResolvedSocketAddrs, Error> {
        let endless = NextTimeout { after: time::Duration::NotHappening, ..timeout };
        let here = || DefaultResolver::default().resolve(uri, config, endless);
        if uri.host().is_none_or(is_known) {
            return here();
        }
        let (reply, found) = mpsc::sync_channel(1);
        let (uri, config) = (uri.clone(), config.clone());
        let look_up = move || {
            // Who asked may have gone; then nobody wants to know.
            let _ = reply.send(DefaultResolver::default().resolve(&uri, &config, endless));
        };
        match thread::start("names", look_up) {
            Err(_) => here(),
            Ok(()) => found
                .recv_timeout(*timeout.after)
                .unwrap_or_else(|_| Err(Error::Timeout(timeout.reason))),
        }
    }
}

/// Whether no name server is asked for it.
fn is_known(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']');
    address.parse::<IpAddr>().is_ok() || host.eq_ignore_ascii_case("localhost")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_and_localhost_are_known() {
        for known in ["127.0.0.1", "[::1]", "[fe80::7]", "localhost", "LocalHost"] {
            assert!(is_known(known), "{known}");
        }
        for asked in ["relay.example", "localhost.example", "127.0.0.1.example", "1"] {
            assert!(!is_known(asked), "{asked}");
        }
    }
}
