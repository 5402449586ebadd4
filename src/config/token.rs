//! The token of the admin server: a file with one line.

use std::fmt;
use std::io;
use std::ops::RangeInclusive;

use subtle::ConstantTimeEq;
use zeroize::{ZeroizeOnDrop, Zeroizing};

use super::file;
use super::secret::{self, SecretError};
use super::toml_table::Entry;

/// The token. Compared in constant time, wiped when dropped, and not shown by `Debug`.
#[derive(Clone, ZeroizeOnDrop)]
pub struct Token(Vec<u8>);

/// A text that cannot be a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a token has 16 to 256 letters, digits and -._~+/=")]
pub struct NotAToken;

impl Token {
    const LEN: RangeInclusive<usize> = 16..=256;

    /// The token made of these characters, of which there are 16 to 256: letters, digits, and
    /// `-._~+/=` (RFC 6750, 2.1).
    pub fn new(characters: &[u8]) -> Result<Self, NotAToken> {
        let fit = |c: &u8| c.is_ascii_alphanumeric() || b"-._~+/=".contains(c);
        let sound = Self::LEN.contains(&characters.len()) && characters.iter().all(fit);
        if sound { Ok(Self(characters.to_vec())) } else { Err(NotAToken) }
    }

    /// Whether `given` is the token. The time that this takes depends only on the length.
    pub fn matches(&self, given: &[u8]) -> bool {
        self.0.ct_eq(given).into()
    }
}

impl PartialEq for Token {
    fn eq(&self, other: &Self) -> bool {
        self.matches(&other.0)
    }
}

impl Eq for Token {}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(hidden)")
    }
}

/// The token in the file that `entry` names, relative to the folder of the configuration. A line break at
/// the end does not belong to it.
pub(super) fn token_file(entry: &Entry<'_>) -> Option<Token> {
    let path = secret::path(entry)?;
    let write = || format!("make one: {}", secret::make(&path, "openssl rand -hex 16"));
    // One octet more than the longest token with its line break.
    let mut octets = Zeroizing::new([0; *Token::LEN.end() + 3]);
    let read = secret::open(&path).and_then(|mut file| {
        let unreadable =
            |error: io::Error| SecretError::File { path: path.clone(), source: error.into() };
        file::fill(&mut file, octets.as_mut_slice()).map_err(unreadable)
    });
    match read {
        Ok(read) => {
            let line = &octets[..read];
            let line = line.strip_suffix(b"\n").unwrap_or(line);
            let token = Token::new(line.strip_suffix(b"\r").unwrap_or(line));
            token.map_err(|error| entry.fault(format!("{path:?}: {error}"), write())).ok()
        }
        Err(error) => {
            let remedy = if error.is_absent() { write() } else { error.remedy() };
            entry.fault(error.to_string(), remedy);
            None
        }
    }
}
