//! PROFINET, as far as a program beside a P-NET plant meets it: checked views over octets, without
//! I/O.
//!
//! Invariants: nothing here panics or allocates, whatever the octets are, and a view borrows what it
//! shows. What cannot be read is [`Malformed`], with the place. A block or an option that is not
//! known keeps its number and its octets.

mod octets;

pub use octets::{ByteOrder, Malformed, Octets};
