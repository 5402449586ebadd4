//! The eight octets at the end of every package to a Secure port.

use std::fmt;

use subtle::{Choice, ConstantTimeEq};
use zeroize::ZeroizeOnDrop;

/// A password: 8 opaque octets (PAS 11). It is compared in constant time, wiped from memory when
/// dropped, and never shown by `Debug`.
#[derive(Clone, ZeroizeOnDrop)]
pub struct Password([u8; Password::LEN]);

impl Password {
    /// Octets in a password.
    pub const LEN: usize = 8;

    /// The password made of these octets.
    pub const fn new(octets: [u8; Self::LEN]) -> Self {
        Self(octets)
    }

    /// The octets, as they stand at the end of a package.
    pub const fn octets(&self) -> &[u8; Self::LEN] {
        &self.0
    }

    /// Whether `octets` are this password. The time does not depend on them.
    pub fn matches(&self, octets: &[u8; Self::LEN]) -> Choice {
        u64::from_ne_bytes(self.0).ct_eq(&u64::from_ne_bytes(*octets))
    }
}

impl fmt::Debug for Password {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Password(hidden)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_itself_alone_and_hides() {
        let password = Password::new(*b"PNETPASS");
        assert!(bool::from(password.matches(b"PNETPASS")));
        for octet in 0..Password::LEN {
            let mut other = *b"PNETPASS";
            other[octet] ^= 1;
            assert!(!bool::from(password.matches(&other)));
        }
        assert_eq!(format!("{password:?}"), "Password(hidden)");
    }
}
