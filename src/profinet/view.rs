//! Fields by name: how the parts of a block are read, and how they are shown.
//!
//! A [`View`] is read from octets. The macro `view!` makes one of a list of fields, in the order of the
//! wire; the same list gives what [`Show`] tells by name. Invariant: what was read once can be read again
//! the same way, so a [`List`] keeps octets and no elements.

use std::fmt;
use std::marker::PhantomData;
use std::net::Ipv4Addr;

use super::{MacAddress, Malformed, Octets, PnioStatus, Uuid};

/// What a field holds.
#[derive(Clone, Copy)]
pub enum Value<'v> {
    /// Padding.
    Nothing,
    /// A number.
    Number(u64),
    /// A number and the word for it; none where it has no word.
    Word(u64, Option<&'static str>),
    /// A number that is made of named parts: name, lowest bit, number of bits.
    Bits(u64, &'static [(&'static str, u32, u32)]),
    /// Characters, padded with spaces or zeros.
    Text(&'v [u8]),
    /// Octets whose meaning is somebody else's.
    Octets(&'v [u8]),
    /// Something that is text for everybody: a UUID, an address.
    Display(&'v dyn fmt::Display),
    /// Fields below this one.
    Fields(&'v dyn Show),
    /// Values that follow each other.
    List(&'v dyn Each),
    /// Why the rest cannot be read.
    Fault(Malformed),
}

/// Something that has fields.
pub trait Show {
    /// Calls `visit` with name and value of each field, in the order of the wire.
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>));
}

/// Something that has elements.
pub trait Each {
    /// Calls `visit` with each element, in the order of the wire.
    fn each(&self, visit: &mut dyn FnMut(Value<'_>));
}

/// Something that octets hold.
pub trait View<'a>: Sized {
    /// Reads it and checks it as a whole.
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed>;

    /// What it holds.
    fn value(&self) -> Value<'_>;
}

/// The part of a number that has these bits.
pub fn bits(number: u64, lowest: u32, count: u32) -> u64 {
    number.checked_shr(lowest).unwrap_or(0) & 1_u64.checked_shl(count).map_or(u64::MAX, |n| n - 1)
}

/// Why something inside cannot be read, the first of all reasons.
pub fn first_fault(show: &dyn Show) -> Option<Malformed> {
    let mut fault = None;
    show.show(&mut |_, value| fault = fault.or_else(|| fault_of(value)));
    fault
}

/// The same of a value.
pub fn fault_of(value: Value<'_>) -> Option<Malformed> {
    match value {
        Value::Fault(fault) => Some(fault),
        Value::Fields(show) => first_fault(show),
        Value::List(each) => {
            let mut fault = None;
            each.each(&mut |value| fault = fault.or_else(|| fault_of(value)));
            fault
        }
        _ => None,
    }
}

/// A number and its word in a table.
pub(super) fn word(number: u64, words: &[(u64, &'static str)]) -> Value<'static> {
    let word = words.iter().find(|(known, _)| *known == number).map(|(_, word)| *word);
    Value::Word(number, word)
}

/// Makes a view and its fields: `name: type`, with `=> function` where a number has words or parts.
macro_rules! view {
    ($(#[$doc:meta])* $public:vis struct $name:ident $(<$life:lifetime>)? {
        $($(#[$field_doc:meta])* $field:ident: $type:ty $(=> $words:expr)?,)*
    }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        $public struct $name $(<$life>)? {
            $($(#[$field_doc])* pub $field: $type,)*
        }

        impl<'a> $crate::profinet::view::View<'a> for $name $(<$life>)? {
            fn read(
                octets: &mut $crate::profinet::Octets<'a>,
            ) -> Result<Self, $crate::profinet::Malformed> {
                $(let $field = $crate::profinet::view::View::read(octets)?;)*
                Ok(Self { $($field),* })
            }

            fn value(&self) -> $crate::profinet::view::Value<'_> {
                $crate::profinet::view::Value::Fields(self)
            }
        }

        impl $(<$life>)? $crate::profinet::view::Show for $name $(<$life>)? {
            fn show(
                &self,
                visit: &mut dyn FnMut(&'static str, $crate::profinet::view::Value<'_>),
            ) {
                $(visit(stringify!($field), view!(@value self.$field $(=> $words)?));)*
            }
        }
    };
    (@value $self:ident.$field:ident) => {
        $crate::profinet::view::View::value(&$self.$field)
    };
    (@value $self:ident.$field:ident => $words:expr) => {
        $words(u64::from($self.$field))
    };
}
pub(super) use view;

macro_rules! numbers {
    ($($type:ident)*) => {
        $(impl<'a> View<'a> for $type {
            fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
                octets.$type()
            }

            fn value(&self) -> Value<'_> {
                Value::Number(u64::from(*self))
            }
        })*
    };
}
numbers!(u8 u16 u32 u64);

macro_rules! displays {
    ($($type:ident: $read:expr;)*) => {
        $(impl<'a> View<'a> for $type {
            fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
                $read(octets)
            }

            fn value(&self) -> Value<'_> {
                Value::Display(self)
            }
        })*
    };
}
displays! {
    Uuid: Uuid::read;
    MacAddress: |octets: &mut Octets<'a>| octets.array().map(MacAddress);
    Ipv4Addr: |octets: &mut Octets<'a>| octets.array::<4>().map(Ipv4Addr::from);
}

impl<'a> View<'a> for PnioStatus {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        octets.u32().map(Self::from)
    }

    fn value(&self) -> Value<'_> {
        Value::Fields(self)
    }
}

impl Show for PnioStatus {
    fn show(&self, visit: &mut dyn FnMut(&'static str, Value<'_>)) {
        visit("code", Value::Number(self.code.into()));
        visit("decode", Value::Number(self.decode.into()));
        visit("code1", Value::Number(self.code1.into()));
        visit("code2", Value::Number(self.code2.into()));
        visit("words", Value::Display(self));
    }
}

/// `N` octets that say nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Skip<const N: usize>;

impl<'a, const N: usize> View<'a> for Skip<N> {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        octets.take(N).map(|_| Self)
    }

    fn value(&self) -> Value<'_> {
        Value::Nothing
    }
}

/// Octets up to the next multiple of four since the beginning of the block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Align;

impl<'a> View<'a> for Align {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        octets.align().map(|()| Self)
    }

    fn value(&self) -> Value<'_> {
        Value::Nothing
    }
}

/// All octets that are left.
impl<'a> View<'a> for &'a [u8] {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        octets.take(octets.len())
    }

    fn value(&self) -> Value<'_> {
        Value::Octets(self)
    }
}

/// Characters: `N` octets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fixed<'a, const N: usize>(pub &'a [u8]);

impl<'a, const N: usize> View<'a> for Fixed<'a, N> {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        octets.take(N).map(Self)
    }

    fn value(&self) -> Value<'_> {
        Value::Text(self.0)
    }
}

/// Characters behind their number, which has `COUNT` octets: 1 or 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Text<'a, const COUNT: usize>(pub &'a [u8]);

impl<'a, const COUNT: usize> View<'a> for Text<'a, COUNT> {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        let len = count::<COUNT>(octets)?;
        octets.take(len).map(Self)
    }

    fn value(&self) -> Value<'_> {
        Value::Text(self.0)
    }
}

/// The `COUNT` of a [`List`] whose number has one octet, with padding before the first element.
pub(super) const PADDED: usize = 11;

fn count<const COUNT: usize>(octets: &mut Octets<'_>) -> Result<usize, Malformed> {
    match COUNT {
        1 => octets.u8().map(usize::from),
        PADDED => {
            let count = octets.u8()?;
            octets.align().map(|()| usize::from(count))
        }
        _ => octets.u16().map(usize::from),
    }
}

/// Elements behind their number, which has `COUNT` octets: 1 or 2. Without a number (0) there are as many
/// as the octets hold.
#[derive(Clone, Copy)]
pub struct List<'a, T, const COUNT: usize = 2> {
    octets: Octets<'a>,
    len: usize,
    elements: PhantomData<fn() -> T>,
}

/// Elements up to the end.
pub type Rest<'a, T> = List<'a, T, 0>;

impl<'a, T: View<'a>, const COUNT: usize> List<'a, T, COUNT> {
    /// The number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The elements, in the order of the wire.
    pub fn iter(&self) -> impl Iterator<Item = T> + use<'a, T, COUNT> {
        let mut octets = self.octets;
        (0..self.len).map_while(move |_| T::read(&mut octets).ok())
    }
}

impl<'a, T: View<'a>, const COUNT: usize> View<'a> for List<'a, T, COUNT> {
    fn read(octets: &mut Octets<'a>) -> Result<Self, Malformed> {
        let wanted = if COUNT == 0 { None } else { Some(count::<COUNT>(octets)?) };
        let beginning = *octets;
        let mut len = 0;
        while wanted.map_or(!octets.is_empty(), |wanted| len < wanted) {
            let before = octets.len();
            T::read(octets)?;
            if octets.len() == before {
                return Err(octets.wrong("an element without octets"));
            }
            len += 1;
        }
        Ok(Self { octets: beginning, len, elements: PhantomData })
    }

    fn value(&self) -> Value<'_> {
        Value::List(self)
    }
}

impl<'a, T: View<'a>, const COUNT: usize> Each for List<'a, T, COUNT> {
    fn each(&self, visit: &mut dyn FnMut(Value<'_>)) {
        self.iter().for_each(|element| visit(element.value()));
    }
}

impl<'a, T: View<'a> + fmt::Debug, const COUNT: usize> fmt::Debug for List<'a, T, COUNT> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

#[cfg(test)]
pub(super) mod tests;
