//! The answer to a look-up: what a node offers.
//!
//! Entries stand behind each other, and their towers behind all of them.

use super::super::view::{Each, Show, Value};
use super::super::{Malformed, Octets, Uuid};
use super::{Handle, Tower, end};

/// The most entries that one call may ask for.
const MAX_ENTRIES: u32 = 500;

/// The answer to ept_lookup.
#[derive(Clone, Copy, Debug)]
pub struct LookupAnswer<'a> {
    /// Where the look-up stands; nil: there are no more entries.
    pub handle: Handle,
    /// 0: it succeeded; 0x16C9A0D6: there are no more entries.
    pub status: u32,
    entries: Octets<'a>,
    towers: Octets<'a>,
    len: u32,
}

/// One thing that a node offers.
#[derive(Clone, Copy, Debug)]
pub struct Entry<'a> {
    /// The object that can be called.
    pub object: Uuid,
    /// Interface, protocol, address and port.
    pub tower: Option<Tower<'a>>,
    /// What it is, in words of its vendor.
    pub annotation: &'a [u8],
}

impl<'a> LookupAnswer<'a> {
    /// The status that says that there are no more entries.
    pub const NO_MORE_ENTRIES: u32 = 0x16C9_A0D6;

    /// Reads whole stub data in the byte order of the header.
    pub fn read(mut stub: Octets<'a>) -> Result<Self, Malformed> {
        let handle = Handle::read(&mut stub)?;
        let wrong = stub.wrong("the numbers of entries contradict each other");
        let len = stub.u32()?;
        let [maximum_count, offset, actual_count] = [stub.u32()?, stub.u32()?, stub.u32()?];
        if offset != 0 || actual_count != len || len > maximum_count || len > MAX_ENTRIES {
            return Err(wrong);
        }
        let entries = stub;
        let mut with_tower = 0;
        for _ in 0..len {
            with_tower += u32::from(Entry::read(&mut stub)?.1);
        }
        // What the entries point to follows behind all of them.
        let towers = stub;
        for _ in 0..with_tower {
            Tower::read(&mut stub)?;
        }
        let status = stub.u32()?;
        end(stub)?;
        Ok(Self { handle, status, entries, towers, len })
    }

    /// Its entries.
    pub fn entries(&self) -> impl Iterator<Item = Entry<'a>> + use<'a> {
        let (mut entries, mut towers) = (self.entries, self.towers);
        (0..self.len).map_while(move |_| {
            let (entry, has_tower) = Entry::read(&mut entries).ok()?;
            let tower = if has_tower { Some(Tower::read(&mut towers).ok()?) } else { None };
            Some(Entry { tower, ..entry })
        })
    }
}

impl<'a> Entry<'a> {
    /// An entry without its tower, and whether it has one.
    fn read(stub: &mut Octets<'a>) -> Result<(Self, bool), Malformed> {
        let object = Uuid::read(stub)?;
        let has_tower = stub.u32()? != 0;
        let wrong = stub.wrong("an annotation is too long");
        let [offset, len] = [stub.u32()?, stub.u32()?];
        if offset != 0 || len > 64 {
            return Err(wrong);
        }
        let annotation = stub.take(len as usize)?;
        stub.align()?;
        let end = annotation.iter().position(|octet| *octet == 0).unwrap_or(annotation.len());
        Ok((Self { object, tower: None, annotation: &annotation[..end] }, has_tower))
    }
}

impl Show for LookupAnswer<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("handle", Value::Display(&self.handle.uuid));
        visit("entries", Value::List(self));
        let word = match self.status {
            0 => Some("OK"),
            Self::NO_MORE_ENTRIES => Some("no more entries"),
            _ => None,
        };
        visit("mapper_status", Value::Word(self.status.into(), word));
    }
}

impl Each for LookupAnswer<'_> {
    fn each(&self, visit: &mut dyn FnMut(Value<'_>)) {
        self.entries().for_each(|entry| visit(Value::Fields(&entry)));
    }
}

impl Show for Entry<'_> {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("object", Value::Display(&self.object));
        visit("annotation", Value::Text(self.annotation));
        if let Some(tower) = &self.tower {
            visit("tower", Value::List(tower));
        }
    }
}
