//! What the workers work from.

use std::sync::Arc;

use super::budget::Budget;
use super::table::{Limits, Table};

/// Bounds that hold for the router as a whole, with that of addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// Those of flows and of senders.
    pub basic: Limits,
    /// Wrong passwords that an address as a whole (of IPv6, its /64) may send before it is throttled.
    /// All of them are forgiven in the time in which all of a sender's are.
    pub wrong_password_address_burst: u32,
}

impl From<Limits> for Bounds {
    /// An address may send as many wrong passwords as 512 of its ports.
    fn from(basic: Limits) -> Self {
        let wrong_password_address_burst = 512 * u32::from(basic.wrong_password_burst);
        Self { basic, wrong_password_address_burst }
    }
}

/// What every worker works from; replaced whole by a new configuration.
#[derive(Clone, Debug)]
pub struct Rules {
    /// The NAT table.
    pub table: Arc<Table>,
    /// Bounds of the router as a whole.
    pub limits: Bounds,
    /// Places for flows and requests of nets, shared by all workers.
    pub budget: Arc<Budget>,
}

impl Rules {
    /// Rules with all places for flows free and all requests untouched.
    pub fn new(table: Arc<Table>, limits: impl Into<Bounds>) -> Self {
        let limits = limits.into();
        let budget = Arc::new(Budget::new(&table, &limits.basic));
        Self { table, limits, budget }
    }
}
