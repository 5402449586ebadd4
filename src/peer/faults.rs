//! Faults that a node makes on purpose, so that others can be tried out against them.

use std::str::FromStr;
use std::time::Duration;

use fastrand::Rng;

/// How much longer a response takes that others are to overtake.
const OVERTAKEN_AFTER: Duration = Duration::from_millis(50);

/// What a node does wrong. The default does nothing wrong.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// How long every response takes.
    pub delay: Duration,
    /// The longest further time that chance adds to a response.
    pub jitter: Duration,
    /// The share of responses that are lost.
    pub drop: Share,
    /// The share of responses that leave twice.
    pub duplicate: Share,
    /// The share of responses that take 50 ms longer, so that later ones overtake them.
    pub reorder: Share,
    /// Whether responses leave from another port than the one that was asked (against A14).
    pub answer_from_other_port: bool,
    /// Whether responses have another password than their requests (against R-39).
    pub wrong_password: bool,
}

/// What becomes of one response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fate {
    /// How often it leaves.
    pub(super) copies: usize,
    /// How long it takes.
    pub(super) delay: Duration,
}

impl Faults {
    /// Throws the dice for a response.
    pub(super) fn fate(&self, dice: &mut Rng) -> Fate {
        let copies = match () {
            () if self.drop.hits(dice) => 0,
            () if self.duplicate.hits(dice) => 2,
            () => 1,
        };
        let overtaken = if self.reorder.hits(dice) { OVERTAKEN_AFTER } else { Duration::ZERO };
        Fate { copies, delay: self.delay + self.jitter.mul_f64(dice.f64()) + overtaken }
    }
}

/// A part of all responses, from none to all.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Share(f64);

/// A text that is no share.
#[derive(Debug, thiserror::Error)]
#[error("write a share from \"0%\" to \"100%\"")]
pub struct NotAShare;

impl Share {
    /// Every response.
    pub const ALL: Self = Self(1.0);

    fn hits(self, dice: &mut Rng) -> bool {
        dice.f64() < self.0
    }

    /// The share as a number from 0 to 1.
    pub fn get(self) -> f64 {
        self.0
    }
}

impl FromStr for Share {
    type Err = NotAShare;

    fn from_str(text: &str) -> Result<Self, NotAShare> {
        let percent = text.strip_suffix('%').ok_or(NotAShare)?;
        let percent: f64 = percent.parse().map_err(|_| NotAShare)?;
        if (0.0..=100.0).contains(&percent) { Ok(Self(percent / 100.0)) } else { Err(NotAShare) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_a_percentage() {
        for (text, share) in [("0%", 0.0), ("12.5%", 0.125), ("100%", 1.0)] {
            assert_eq!(text.parse::<Share>().unwrap(), Share(share));
        }
        for bad in ["", "%", "10", "-1%", "101%", "NaN%", "ten%", "1%%"] {
            assert!(bad.parse::<Share>().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn none_all_and_some() {
        let mut dice = Rng::with_seed(7);
        let count = |faults: Faults, dice: &mut Rng| -> Vec<usize> {
            let copies: Vec<_> = (0..1000).map(|_| faults.fate(dice).copies).collect();
            (0..3).map(|n| copies.iter().filter(|copies| **copies == n).count()).collect()
        };
        assert_eq!(count(Faults::default(), &mut dice), [0, 1000, 0]);
        assert_eq!(
            count(Faults { drop: Share::ALL, ..Faults::default() }, &mut dice),
            [1000, 0, 0]
        );
        let twice = Faults { duplicate: Share::ALL, ..Faults::default() };
        assert_eq!(count(twice, &mut dice), [0, 0, 1000]);
        let some = count(Faults { drop: Share(0.3), ..Faults::default() }, &mut dice)[0];
        assert!((200..400).contains(&some), "{some}");
    }

    #[test]
    fn a_delay_is_within_its_bounds() {
        let millis = Duration::from_millis;
        let mut dice = Rng::with_seed(7);
        let faults = Faults { delay: millis(20), jitter: millis(5), ..Faults::default() };
        let delays: Vec<_> = (0..1000).map(|_| faults.fate(&mut dice).delay).collect();
        assert!(delays.iter().all(|delay| (millis(20)..=millis(25)).contains(delay)));
        assert!(delays.iter().max() > delays.iter().min());
        let faults = Faults { reorder: Share::ALL, ..faults };
        assert!(faults.fate(&mut dice).delay >= millis(70));
    }
}
