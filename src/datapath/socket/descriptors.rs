//! Computes how many workers and upstream sockets the limit of file descriptors allows.

use std::num::NonZeroUsize;
use std::thread;

use nix::sys::resource::{Resource, getrlimit, setrlimit};

/// File descriptors for everything except the sockets of the datapath: logs, and connections of the
/// admin server.
const RESERVE: usize = 128;
/// A worker's own file descriptors: epoll, wake-up, tick.
const OWN: usize = 3;
/// File descriptors that a worker needs besides its public sockets: its own, and those of its first
/// upstream sockets.
const FOR_A_WORKER: usize = OWN + 31;

/// What fits into the limit of file descriptors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::datapath) struct Plan {
    pub workers: usize,
    /// How many upstream sockets each worker may have open.
    pub upstreams: usize,
}

/// What a running worker may have of the limit, whatever a configuration asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::datapath) struct Share {
    pub public_sockets: usize,
    pub upstreams: usize,
    /// The error, when the worker may have fewer public sockets than wanted.
    pub lack: Option<TooFewDescriptors>,
}

/// The configuration needs more file descriptors than the process may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{public_sockets} public sockets and {workers} worker(s) need {needed} file descriptors, but the \
     hard limit is {limit}; raise it (ulimit -Hn, LimitNOFILE=, --ulimit nofile=) or listen on \
     fewer ports or addresses"
)]
pub struct TooFewDescriptors {
    public_sockets: usize,
    workers: usize,
    needed: usize,
    limit: usize,
}

/// Raises the soft limit to the hard one and divides it among the workers. Where the configuration
/// does not set the number of workers, there is one for every two cores, or as many as the limit
/// allows. The kernel spends more time on a datagram than the worker does, so it needs cores too.
pub(in crate::datapath) fn plan(
    addresses: usize,
    workers: Option<NonZeroUsize>,
) -> Result<Plan, TooFewDescriptors> {
    divide(addresses, workers, half_the_cores(), raise_limit())
}

/// Divides the limit among this many workers. Each of them wants public sockets for this many
/// addresses.
pub(in crate::datapath) fn share(addresses: usize, workers: usize) -> Share {
    allot(addresses, workers.max(1), raise_limit())
}

/// What a configuration needs: with this many workers, or else with one.
#[cfg(feature = "cli")]
pub(in crate::datapath) fn needed(addresses: usize, workers: Option<NonZeroUsize>) -> usize {
    for_workers(addresses, workers.map_or(1, NonZeroUsize::get))
}

fn for_workers(addresses: usize, workers: usize) -> usize {
    RESERVE + workers * (addresses + FOR_A_WORKER)
}

fn allot(addresses: usize, workers: usize, limit: usize) -> Share {
    let each = (limit.saturating_sub(RESERVE) / workers).saturating_sub(OWN);
    let public_sockets = addresses.min(each.saturating_sub(FOR_A_WORKER - OWN));
    let lack = (public_sockets < addresses).then(|| TooFewDescriptors {
        public_sockets: workers * addresses,
        workers,
        needed: for_workers(addresses, workers),
        limit,
    });
    Share { public_sockets, upstreams: each - public_sockets, lack }
}

fn half_the_cores() -> NonZeroUsize {
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    NonZeroUsize::new(cores / 2).unwrap_or(NonZeroUsize::MIN)
}

fn raise_limit() -> usize {
    let Ok((soft, hard)) = getrlimit(Resource::RLIMIT_NOFILE) else { return 1024 };
    let limit = if setrlimit(Resource::RLIMIT_NOFILE, hard, hard).is_ok() { hard } else { soft };
    usize::try_from(limit).unwrap_or(usize::MAX)
}

fn divide(
    addresses: usize,
    wish: Option<NonZeroUsize>,
    usual: NonZeroUsize,
    limit: usize,
) -> Result<Plan, TooFewDescriptors> {
    let each = addresses + FOR_A_WORKER;
    let fitting = limit.saturating_sub(RESERVE) / each;
    let workers = wish
        .unwrap_or_else(|| usual.min(NonZeroUsize::new(fitting).unwrap_or(NonZeroUsize::MIN)))
        .get();
    let Share { upstreams, lack, .. } = allot(addresses, workers, limit);
    if let Some(lack) = lack {
        return Err(lack);
    }
    if wish.is_none() && workers < usual.get() {
        tracing::warn!(
            workers,
            usual = usual.get(),
            limit,
            "the hard limit of file descriptors allows fewer workers than usual"
        );
    }
    Ok(Plan { workers, upstreams })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn n(n: usize) -> NonZeroUsize {
        NonZeroUsize::new(n).unwrap()
    }

    #[test]
    fn all_the_usual_workers_when_the_limit_allows() {
        let plan = divide(8000, None, n(2), 20_000).unwrap();
        assert_eq!(plan, Plan { workers: 2, upstreams: 1933 });
        assert!(RESERVE + 2 * (8000 + OWN + plan.upstreams) <= 20_000);
    }

    #[test]
    fn fewer_workers_before_no_router() {
        assert_eq!(divide(8000, None, n(16), 20_000).unwrap().workers, 2);
        assert_eq!(divide(8000, None, n(16), 9_000).unwrap().workers, 1);
    }

    #[test]
    fn a_worker_that_runs_has_as_many_public_sockets_as_fit() {
        let share = allot(8000, 2, 20_000);
        assert_eq!(share, Share { public_sockets: 8000, upstreams: 1933, lack: None });
        let share = allot(8000, 2, 9_000);
        assert_eq!((share.public_sockets, share.upstreams), (4402, 31));
        assert!(RESERVE + 2 * (share.public_sockets + FOR_A_WORKER) <= 9_000);
        assert!(share.lack.unwrap().to_string().contains("16196"));
        assert_eq!(allot(8000, 2, 10).public_sockets, 0);
    }

    #[test]
    fn too_few_is_said_with_both_figures() {
        let error = divide(8000, None, n(2), 8_000).unwrap_err().to_string();
        assert!(error.contains("8162") && error.contains("8000"), "{error}");
        let error = divide(8000, Some(n(2)), n(2), 9_000).unwrap_err().to_string();
        assert!(error.contains("16196") && error.contains("9000"), "{error}");
    }
}
