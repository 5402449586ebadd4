//! A new password: 8 random octets that people can read out and type.
//!
//! 48 random bits. Characters that look like others are left out, and so is what [`guessable`] warns of.

use std::io;

use zeroize::Zeroizing;

use crate::pnet::wire::Password;

use super::guessable;

/// 64 characters, so that 6 random bits choose one: without `0`, `O`, `1`, `l` and `I`.
const CHARACTERS: &[u8; 64] = b"ABCDEFGHJKLMNPQRSTUVWXYZabcdefghijkmnopqrstuvwxyz23456789+-=.:_@";

/// Eight of the characters, by the kernel's randomness.
pub(crate) fn new_password() -> io::Result<Zeroizing<[u8; Password::LEN]>> {
    loop {
        let mut octets = Zeroizing::new([0; Password::LEN]);
        getrandom::fill(octets.as_mut_slice())?;
        for octet in octets.iter_mut() {
            *octet = CHARACTERS[usize::from(*octet % 64)];
        }
        if guessable::weakness(&Password::new(*octets)).is_none() {
            return Ok(octets);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeSet, HashSet};

    use super::*;
    use crate::config::odd::oddities;

    #[test]
    fn passwords_are_random_readable_and_never_warned_of() {
        let made: Vec<_> = (0..5_000).map(|_| new_password().unwrap()).collect();
        for octets in &made {
            let password = Password::new(**octets);
            assert_eq!((guessable::weakness(&password), oddities(&password)), (None, None));
        }
        assert_eq!(made.iter().map(|octets| **octets).collect::<HashSet<_>>().len(), made.len());
        let used: BTreeSet<u8> = made.iter().flat_map(|octets| **octets).collect();
        assert_eq!(used, CHARACTERS.iter().copied().collect());
        assert_eq!(used.len(), 64);
        assert!(
            used.iter().all(u8::is_ascii_graphic)
                && used.is_disjoint(&b"0O1lI".iter().copied().collect())
        );
    }
}
