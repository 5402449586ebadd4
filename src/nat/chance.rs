//! The randomness of a core: hashes that no attacker can foresee, and the choice of the open socket
//! that a new client shares.
//!
//! The core has no other source of randomness. With the same `Chance` and the same input, it does
//! the same.

use foldhash::SharedSeed;
use foldhash::fast::SeedableRandomState;

/// The randomness of one core.
#[derive(Debug)]
pub struct Chance {
    pub(super) hash: SeedableRandomState,
    pub(super) choice: fastrand::Rng,
}

impl Chance {
    /// Randomness from the system.
    pub fn of_the_system() -> Self {
        Self { hash: SeedableRandomState::random(), choice: fastrand::Rng::new() }
    }

    /// The same randomness for the same seed, in every process: for tests. Whoever knows the seed
    /// can make hashes collide.
    pub fn from_seed(seed: u64) -> Self {
        Self {
            hash: SeedableRandomState::with_seed(seed, SharedSeed::global_fixed()),
            choice: fastrand::Rng::with_seed(seed),
        }
    }
}
