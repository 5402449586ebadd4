//! What a server makes of the requests that it takes.
//!
//! The standard does not say which control-status reads and which one writes, nor how a request
//! names an object. So [`Memory`] is told the codes, and the form of its requests is our own.

use arrayvec::ArrayVec;

use super::Indicated;
use crate::pnet::wire::MAX_DATA;

/// The data of a response.
pub type Data = ArrayVec<u8, MAX_DATA>;

/// What a server makes of a request. A closure is one.
pub trait Service {
    /// The data of the response, or `None` to stay silent. An unconfirmed request is served too, but
    /// its data go to nobody.
    fn serve(&mut self, request: &Indicated<'_>) -> Option<Data>;
}

impl<F: FnMut(&Indicated<'_>) -> Option<Data>> Service for F {
    fn serve(&mut self, request: &Indicated<'_>) -> Option<Data> {
        self(request)
    }
}

/// Sends the data of each request back.
#[derive(Clone, Copy, Debug, Default)]
pub struct Echo;

impl Service for Echo {
    fn serve(&mut self, request: &Indicated<'_>) -> Option<Data> {
        request.data_octets.try_into().ok()
    }
}

/// One flat memory area, read and written by offset, as an endpoint with flat addressing has (R-44,
/// PAS 6.1.1.1.1.10).
///
/// A request begins with the offset in octets, two octets with the upper one first. To read, the
/// number of octets follows, in one octet; the response holds them. To write, the octets follow; the
/// response is empty. A request with another control-status, with another form, or past the end
/// changes nothing and gets no answer.
#[derive(Clone, Debug)]
pub struct Memory {
    octets: Vec<u8>,
    read: Option<u8>,
    write: Option<u8>,
}

impl Memory {
    /// A memory of `size` octets, all 0. `read` and `write` are the control-status of the two kinds
    /// of request. A kind without one is not served.
    pub fn new(size: u16, read: Option<u8>, write: Option<u8>) -> Self {
        Self { octets: vec![0; size.into()], read, write }
    }

    /// What is in the memory now.
    pub fn octets(&self) -> &[u8] {
        &self.octets
    }
}

impl Service for Memory {
    fn serve(&mut self, request: &Indicated<'_>) -> Option<Data> {
        let (&offset, rest) = request.data_octets.split_first_chunk()?;
        let octets = self.octets.get_mut(usize::from(u16::from_be_bytes(offset))..)?;
        let asked = Some(request.control_status);
        if asked == self.read {
            let &[size] = rest else { return None };
            Data::try_from(octets.get(..size.into())?).ok()
        } else if asked == self.write {
            octets.get_mut(..rest.len())?.copy_from_slice(rest);
            Some(Data::new())
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn serve(memory: &mut Memory, control_status: u8, data_octets: &[u8]) -> Option<Vec<u8>> {
        let request =
            Indicated { requester: None, beyond: ArrayVec::new(), control_status, data_octets };
        memory.serve(&request).map(|data| data.to_vec())
    }

    #[test]
    fn r44_what_was_written_is_read() {
        let mut memory = Memory::new(300, Some(1), Some(2));
        assert_eq!(serve(&mut memory, 2, &[1, 0, b'a', b'b']), Some(vec![]));
        assert_eq!(serve(&mut memory, 1, &[0, 255, 4]), Some(vec![0, b'a', b'b', 0]));
        assert_eq!(serve(&mut memory, 1, &[1, 44, 0]), Some(vec![]), "nothing, at the end");
        assert_eq!(serve(&mut memory, 1, &[0, 0, 63]), Some(vec![0; 63]));
    }

    #[test]
    fn what_is_not_in_the_memory_is_not_answered_and_changes_nothing() {
        let mut memory = Memory::new(300, Some(1), Some(2));
        for (control_status, data) in [
            (1, &[1, 43, 2][..]), // past the end
            (1, &[0xFF, 0xFF, 1]),
            (1, &[0, 0, 64]), // more than a response holds
            (1, &[0, 0]),     // no number of octets
            (1, &[0, 0, 1, 1]),
            (1, &[0]),
            (1, &[]),
            (2, &[1, 43, 7, 7]),
            (2, &[0]),
            (3, &[0, 0, 1]),
        ] {
            assert_eq!(serve(&mut memory, control_status, data), None, "{data:?}");
        }
        assert_eq!(memory.octets(), [0; 300]);
        let mut unset = Memory::new(300, None, None);
        assert!((0..=255).all(|code| serve(&mut unset, code, &[0, 0, 1]).is_none()));
    }
}
