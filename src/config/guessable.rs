//! Passwords that are easily guessed. Only a warning: the standard leaves the choice to the plant.

use crate::pnet::wire::Password;

/// Words that many passwords contain, in lower case.
const WORDS: [&[u8]; 7] = [b"pass", b"pnet", b"admin", b"guest", b"qwert", b"welcome", b"letmein"];
/// A random password almost never has fewer different octets than this.
const FEW_OCTETS: usize = 4;

/// Why a password is easily guessed, if it is. The text contains nothing of the password.
pub(super) fn weakness(password: &Password) -> Option<&'static str> {
    let octets = password.octets();
    let all = |kind: fn(&u8) -> bool| octets.iter().all(kind);
    if all(u8::is_ascii_digit) {
        Some("it is a number")
    } else if all(u8::is_ascii_lowercase) || all(u8::is_ascii_uppercase) {
        Some("it has only letters of one case")
    } else if different(octets) < FEW_OCTETS {
        Some("it repeats a few octets")
    } else if WORDS.iter().any(|word| contains(octets, word)) {
        Some("it contains a word that many passwords contain")
    } else {
        None
    }
}

fn different(octets: &[u8]) -> usize {
    (0..octets.len()).filter(|&at| !octets[..at].contains(&octets[at])).count()
}

/// Whether the password contains the word, in any case and with the usual digits and signs for letters.
fn contains(octets: &[u8], word: &[u8]) -> bool {
    let is_letter = |(octet, letter): (&u8, &u8)| match octet {
        b'0' => *letter == b'o',
        b'1' | b'!' => matches!(letter, b'i' | b'l'),
        b'3' => *letter == b'e',
        b'4' | b'@' => *letter == b'a',
        b'5' | b'$' => *letter == b's',
        b'7' => *letter == b't',
        other => other.to_ascii_lowercase() == *letter,
    };
    octets.windows(word.len()).any(|part| part.iter().zip(word).all(is_letter))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_weak(octets: &[u8; 8]) -> bool {
        weakness(&Password::new(*octets)).is_some()
    }

    #[test]
    fn what_guessers_try_early_is_weak() {
        for octets in [
            b"PNETPASS",
            b"Password",
            b"Pa55word",
            b"p@$$w0rd",
            b"pnet-001",
            b"00000000",
            b"12345678",
            b"abcdefgh",
            b"ABCDEFGH",
            b"aaaaaaa1",
            b"        ",
            b"\0\0\0\0\0\0\0\0",
            b"Qwert!12",
            b"4dm1n-01",
            b"WELCOME1",
        ] {
            assert!(is_weak(octets), "{}", octets.escape_ascii());
        }
    }

    /// Both random octets and random characters. One in 700 of the latter has only letters of one case by
    /// chance.
    #[test]
    fn what_is_random_is_not() {
        const BASE64: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let mut random = fastrand::Rng::with_seed(7);
        let mut weak = 0;
        for _ in 0..20_000 {
            weak += u32::from(is_weak(&std::array::from_fn(|_| random.u8(..))));
            let letters = std::array::from_fn(|_| *random.choice(BASE64).unwrap());
            weak += u32::from(is_weak(&letters));
        }
        assert!(weak < 60, "{weak} of 40,000");
    }

    #[test]
    fn no_weakness_shows_the_password() {
        for octets in [b"12345678", b"abcdefgh", b"aaaaaaa1", b"PNETPASS"] {
            let weakness = weakness(&Password::new(*octets)).unwrap();
            assert!(!weakness.contains(str::from_utf8(octets).unwrap()));
        }
    }
}
