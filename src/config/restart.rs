//! Settings that only a restart changes.

use super::{Config, NotInForce};

/// Copies from `old` to `new` the settings that cannot change while the relay runs, and returns those
/// that differed. Everything else in `new` stays.
pub fn keep_settled(old: &Config, new: &mut Config) -> Vec<NotInForce> {
    let mut kept = Vec::new();
    let mut keep = |what: &str, changed| {
        if changed {
            let why = "cannot change while the relay runs; it stays as it was until a restart";
            kept.push(NotInForce { what: what.to_owned(), why: why.to_owned() });
        }
    };
    let (was, is) = (&old.runtime, &mut new.runtime);
    keep("[runtime] user", was.user != is.user);
    keep("[runtime] workers", was.workers != is.workers);
    (is.user, is.workers) = (was.user.clone(), was.workers);
    keep("[datapath] kernel", old.datapath.kernel != new.datapath.kernel);
    new.datapath.kernel = old.datapath.kernel;
    keep("[admin] control", old.control != new.control);
    new.control.clone_from(&old.control);
    keep("[admin] enabled", old.admin.is_some() != new.admin.is_some());
    match (&old.admin, &mut new.admin) {
        (Some(was), Some(is)) => {
            keep("[admin] listen", was.listen != is.listen);
            // The old address may need a token although the new one does not.
            if was.listen != is.listen && is.token.is_none() {
                is.token.clone_from(&was.token);
            }
            is.listen = was.listen;
        }
        (was, is) => is.clone_from(was),
    }
    kept
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;
    use crate::config::fixture::config;
    use crate::config::{KernelFlows, Token};

    #[test]
    fn what_needs_a_restart_stays_and_all_else_changes() {
        let old = config();
        let mut new = old.clone();
        new.runtime.user = Some("relay".into());
        new.runtime.workers = NonZeroUsize::new(7);
        new.datapath.receive_buffer += 1;
        new.datapath.kernel = KernelFlows::Off;
        new.limits.max_flows += 1;
        new.control = Some("control.sock".into());
        let admin = new.admin.as_mut().unwrap();
        admin.listen.set_port(1);
        admin.reload = !admin.reload;
        let kept = keep_settled(&old, &mut new);
        let kept: Vec<_> = kept.iter().map(|kept| kept.what.as_str()).collect();
        assert_eq!(
            kept,
            [
                "[runtime] user",
                "[runtime] workers",
                "[datapath] kernel",
                "[admin] control",
                "[admin] listen"
            ]
        );
        assert_eq!((new.control, new.datapath.kernel), (None, KernelFlows::Auto));
        let (was, is) = (old.admin.as_ref().unwrap(), new.admin.as_ref().unwrap());
        assert_eq!((was.listen, !was.reload), (is.listen, is.reload));
        assert_eq!(new.runtime.workers, old.runtime.workers);
        assert_eq!(new.datapath.receive_buffer, old.datapath.receive_buffer + 1);
        assert_eq!(new.limits.max_flows, old.limits.max_flows + 1);

        assert_eq!(keep_settled(&old, &mut Config { admin: None, ..old.clone() }).len(), 1);
        assert_eq!(keep_settled(&old, &mut old.clone()), []);
    }

    /// The new address may be one that needs no token; the one in force does.
    #[test]
    fn an_admin_address_that_stays_keeps_its_token() {
        let (mut old, mut new) = (config(), config());
        let token = Token::new(b"s3cr3t-0123456789").unwrap();
        old.admin.as_mut().unwrap().token = Some(token);
        let admin = new.admin.as_mut().unwrap();
        (admin.listen, admin.token) = (([127, 0, 0, 1], 1).into(), None);
        keep_settled(&old, &mut new);
        assert!(new.admin.unwrap().token.is_some());
    }
}
