//! Tells whoever watches the workers that one of them is awake, so that it may sleep while they do.
//!
//! A worker only looks at a flag, and has to do more once for each time that the watcher asks. It waits for
//! nobody.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use tokio::sync::Notify;

/// What the workers share with their watcher.
#[derive(Debug, Default)]
pub(crate) struct Activity {
    /// The watcher has asked, and no worker was awake since.
    asked: AtomicBool,
    awake: Notify,
}

impl Activity {
    /// Notes that a worker has something to do.
    #[inline]
    pub(crate) fn note(&self) {
        if self.asked.load(Relaxed) && self.asked.swap(false, Relaxed) {
            self.awake.notify_one();
        }
    }

    /// Whether all workers have slept since the last call. There has to be time between two calls: a worker
    /// that wakes up now may see only the call before.
    pub(crate) fn slept(&self) -> bool {
        self.asked.swap(true, Relaxed)
    }

    /// Waits until a worker is awake that slept at the last call of [`slept`](Self::slept).
    pub(crate) async fn awaited(&self) {
        // It may have been told of an earlier one.
        while self.asked.load(Relaxed) {
            self.awake.notified().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::future::Future;
    use std::pin::pin;
    use std::task::{Context, Poll, Waker};

    use super::*;

    #[test]
    fn a_watcher_sleeps_until_a_worker_wakes_up() {
        let activity = Activity::default();
        assert!(!activity.slept(), "nobody knows what was before");
        assert!(activity.slept());
        activity.note();
        activity.note();
        assert!(!activity.slept());
        assert!(activity.slept());

        let mut context = Context::from_waker(Waker::noop());
        let mut awaited = pin!(activity.awaited());
        assert_eq!(awaited.as_mut().poll(&mut context), Poll::Pending, "that was an earlier one");
        activity.note();
        assert_eq!(awaited.as_mut().poll(&mut context), Poll::Ready(()));
    }
}
