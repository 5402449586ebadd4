//! What is left to chance in a core: the hashes that nobody outside shall foresee, and which open
//! socket a new client shares.
//!
//! It comes in from outside whole, so that a core does the same again when it is given the same.

use foldhash::SharedSeed;
use foldhash::fast::SeedableRandomState;

/// The randomness of one core.
#[derive(Debug)]
pub struct Chance {
    pub(super) hash: SeedableRandomState,
    pub(super) choice: fastrand::Rng,
}

impl Chance {
    /// Randomness that the system gives.
    pub fn of_the_system() -> Self {
        Self { hash: SeedableRandomState::random(), choice: fastrand::Rng::new() }
    }

    /// The same for the same seed, in every process. Who can guess the seed can make hashes collide.
    pub fn from_seed(seed: u64) -> Self {
        Self {
            hash: SeedableRandomState::with_seed(seed, SharedSeed::global_fixed()),
            choice: fastrand::Rng::with_seed(seed),
        }
    }
}
