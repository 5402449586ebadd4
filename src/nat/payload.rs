//! The octets of a datagram on their way through the NAT, in the buffer that received them.

use std::ops::{Deref, DerefMut};

/// The octets of a datagram, and room behind them for what the NAT adds.
#[derive(Debug)]
pub struct Payload<'a> {
    room: &'a mut [u8],
    len: usize,
}

impl<'a> Payload<'a> {
    /// The first `len` octets of `room`, or all of it when it has fewer.
    #[inline]
    pub fn new(room: &'a mut [u8], len: usize) -> Self {
        let len = len.min(room.len());
        Self { room, len }
    }

    /// Adds octets at the end. False, and no change, when there is no room for them.
    #[inline]
    #[must_use]
    pub(super) fn append(&mut self, octets: &[u8]) -> bool {
        let Some(free) = self.room.get_mut(self.len..self.len + octets.len()) else { return false };
        free.copy_from_slice(octets);
        self.len += octets.len();
        true
    }

    /// Takes octets from the end.
    #[inline]
    pub(super) fn cut(&mut self, octets: usize) {
        self.len = self.len.saturating_sub(octets);
    }
}

impl<'a> From<&'a mut [u8]> for Payload<'a> {
    /// All of these octets, without room behind them.
    fn from(octets: &'a mut [u8]) -> Self {
        let len = octets.len();
        Self::new(octets, len)
    }
}

impl Deref for Payload<'_> {
    type Target = [u8];

    #[inline]
    fn deref(&self) -> &[u8] {
        &self.room[..self.len]
    }
}

impl DerefMut for Payload<'_> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [u8] {
        &mut self.room[..self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grows_into_its_room_and_no_further() {
        let mut room = *b"answer....";
        let mut payload = Payload::new(&mut room, 6);
        assert!(payload.append(b"abc"));
        assert!(!payload.append(b"de"), "one octet is left");
        assert_eq!(&*payload, b"answerabc");
        payload.cut(4);
        assert_eq!(&*payload, b"answe");
        payload.cut(9);
        assert!(payload.is_empty());
        assert!(!Payload::from(&mut room[..]).append(b"x"));
    }
}
