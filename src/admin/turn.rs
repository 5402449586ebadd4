//! Large answers are made piece by piece, and between two pieces of any answers the runtime looks at the
//! sockets. So a probe waits for one piece at most.

use std::sync::Arc;

use axum::body::{Body, Bytes};
use futures_util::stream;
use tokio::sync::Mutex;
use tokio::task::yield_now;

/// The turn to work on a large answer; only one answer has it at a time.
#[derive(Clone, Debug, Default)]
pub(super) struct Turn(Arc<Mutex<()>>);

impl Turn {
    /// Waits for the turn and does a piece of work.
    pub(super) async fn take<T>(&self, work: impl FnOnce() -> T) -> T {
        let _turn = self.0.lock().await;
        let done = work();
        // Goes on only after the runtime has looked for events and handled them.
        yield_now().await;
        done
    }

    /// A body that is made piece by piece as the client reads it. An error cuts it off.
    pub(super) fn body<P, E>(
        &self,
        pieces: impl Iterator<Item = Result<P, E>> + Send + 'static,
    ) -> Body
    where
        P: Into<Bytes> + Send + 'static,
        E: std::error::Error + Send + Sync + 'static,
    {
        Body::from_stream(stream::unfold((pieces, self.clone()), async |(mut pieces, turn)| {
            let piece = turn.take(|| pieces.next()).await?;
            Some((piece, (pieces, turn)))
        }))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

    use tokio::task::JoinSet;

    use super::*;

    /// However many answers are made, other tasks run after each piece.
    #[tokio::test]
    async fn between_two_pieces_others_get_on() {
        let turn = Turn::default();
        let pieces = Arc::new(AtomicUsize::new(0));
        let mut answers = JoinSet::new();
        for _ in 0..64 {
            let (turn, pieces) = (turn.clone(), Arc::clone(&pieces));
            answers.spawn(async move {
                for _ in 0..10 {
                    turn.take(|| pieces.fetch_add(1, Relaxed)).await;
                }
            });
        }
        let mut before = 0;
        while answers.try_join_next().is_some() || !answers.is_empty() {
            yield_now().await;
            let now = pieces.load(Relaxed);
            assert!(now <= before + 1, "{} pieces at once", now - before);
            before = now;
        }
        assert_eq!(before, 640);
    }
}
