//! A queue that grows piece by piece. So room for one more entry never costs moving a million
//! others.

use std::collections::VecDeque;

/// Entries of one piece.
const PIECE: usize = 1024;

/// First in, first out.
#[derive(Debug)]
pub(super) struct Queue<T>(VecDeque<VecDeque<T>>);

impl<T> Queue<T> {
    pub(super) fn new() -> Self {
        Self(VecDeque::new())
    }

    pub(super) fn push(&mut self, entry: T) {
        match self.0.back_mut() {
            Some(last) if last.len() < PIECE => last.push_back(entry),
            _ => {
                let mut piece = VecDeque::with_capacity(PIECE);
                piece.push_back(entry);
                self.0.push_back(piece);
            }
        }
    }

    /// Removes and returns the first entry, if this is true of it.
    pub(super) fn pop_if(&mut self, is_so: impl FnOnce(&T) -> bool) -> Option<T> {
        let first = self.0.front_mut()?;
        if !first.front().is_some_and(is_so) {
            return None;
        }
        let entry = first.pop_front();
        if first.is_empty() {
            self.0.pop_front();
        }
        entry
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_came_first_goes_first_and_only_when_it_may() {
        let mut queue = Queue::new();
        let (mut next, mut count) = (0, 0);
        for round in 1..=5_u32 {
            (0..3000).for_each(|_| {
                queue.push({
                    count += 1;
                    count
                })
            });
            while let Some(entry) = queue.pop_if(|&entry| entry <= 2000 * round) {
                next += 1;
                assert_eq!(entry, next);
            }
            assert_eq!(next, 2000 * round);
        }
        while queue.pop_if(|_| true).is_some() {
            next += 1;
        }
        assert_eq!(next, count);
        assert!(queue.0.is_empty());
    }
}
