//! The fields of a frame with a line for each, made of what JSON is made of: serde_json writes, and this says
//! what stands between the values.

use std::io::{self, Write};

use serde::Serialize;
use serde_json::Serializer;
use serde_json::ser::{CharEscape, Formatter};

const INDENT: &str = "    ";

/// Writes the fields below a heading, which has no line end yet.
pub(super) fn write(fields: &impl Serialize, output: &mut impl Write) -> io::Result<()> {
    fields.serialize(&mut Serializer::with_formatter(&mut *output, Tree::default()))?;
    writeln!(output)
}

#[derive(Debug, Default)]
struct Tree {
    /// Where the next name stands.
    depth: usize,
    /// Open objects and lists, the innermost last. Their number has a bound: that of the structs.
    open: Vec<Open>,
    is_name: bool,
}

#[derive(Debug)]
enum Open {
    /// How much deeper its names stand than what is around it.
    Object { deeper: usize },
    /// How many items it has so far.
    List { items: usize },
}

impl Tree {
    fn line(&self, output: &mut (impl ?Sized + Write), depth: usize) -> io::Result<()> {
        writeln!(output)?;
        (0..depth).try_for_each(|_| output.write_all(INDENT.as_bytes()))
    }

    /// Comes before each value that stands behind its name, or in a list.
    fn scalar(&self, output: &mut (impl ?Sized + Write)) -> io::Result<()> {
        output.write_all(match self.open.last() {
            Some(Open::List { items: 2.. }) => b", ",
            _ => b" ",
        })
    }
}

/// Numbers are written as they are.
macro_rules! numbers {
    ($($name:ident: $number:ty),*) => {
        $(fn $name<W: ?Sized + Write>(&mut self, output: &mut W, value: $number) -> io::Result<()> {
            self.scalar(output)?;
            write!(output, "{value}")
        })*
    };
}

impl Formatter for Tree {
    numbers! {
        write_i8: i8, write_i16: i16, write_i32: i32, write_i64: i64,
        write_u8: u8, write_u16: u16, write_u32: u32, write_u64: u64, write_f64: f64
    }

    fn write_null<W: ?Sized + Write>(&mut self, output: &mut W) -> io::Result<()> {
        self.scalar(output)?;
        output.write_all(b"none")
    }

    fn write_bool<W: ?Sized + Write>(&mut self, output: &mut W, value: bool) -> io::Result<()> {
        self.scalar(output)?;
        output.write_all(if value { b"yes" } else { b"no" })
    }

    fn begin_string<W: ?Sized + Write>(&mut self, output: &mut W) -> io::Result<()> {
        if self.is_name { Ok(()) } else { self.scalar(output) }
    }

    fn end_string<W: ?Sized + Write>(&mut self, _: &mut W) -> io::Result<()> {
        Ok(())
    }

    fn write_string_fragment<W: ?Sized + Write>(
        &mut self,
        output: &mut W,
        fragment: &str,
    ) -> io::Result<()> {
        if !self.is_name {
            return output.write_all(fragment.as_bytes());
        }
        let mut words = fragment.split('_');
        output.write_all(words.next().unwrap_or_default().as_bytes())?;
        words.try_for_each(|word| write!(output, " {word}"))
    }

    /// What serde_json would escape. Control characters never come here: they are shown as `\x00`.
    fn write_char_escape<W: ?Sized + Write>(
        &mut self,
        output: &mut W,
        escape: CharEscape,
    ) -> io::Result<()> {
        match escape {
            CharEscape::Quote => output.write_all(b"\""),
            CharEscape::ReverseSolidus => output.write_all(b"\\"),
            CharEscape::Solidus => output.write_all(b"/"),
            _ => output.write_all(b"?"),
        }
    }

    fn begin_array<W: ?Sized + Write>(&mut self, _: &mut W) -> io::Result<()> {
        self.open.push(Open::List { items: 0 });
        Ok(())
    }

    fn end_array<W: ?Sized + Write>(&mut self, output: &mut W) -> io::Result<()> {
        match self.open.pop() {
            Some(Open::List { items: 0 }) => output.write_all(b" none"),
            _ => Ok(()),
        }
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, _: &mut W, _: bool) -> io::Result<()> {
        if let Some(Open::List { items }) = self.open.last_mut() {
            *items += 1;
        }
        Ok(())
    }

    fn begin_object<W: ?Sized + Write>(&mut self, output: &mut W) -> io::Result<()> {
        let deeper = match self.open.last() {
            Some(&Open::List { items }) => {
                self.line(output, self.depth + 1)?;
                write!(output, "{items}:")?;
                2
            }
            _ => 1,
        };
        self.depth += deeper;
        self.open.push(Open::Object { deeper });
        Ok(())
    }

    fn end_object<W: ?Sized + Write>(&mut self, _: &mut W) -> io::Result<()> {
        if let Some(Open::Object { deeper }) = self.open.pop() {
            self.depth -= deeper;
        }
        Ok(())
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, output: &mut W, _: bool) -> io::Result<()> {
        self.is_name = true;
        self.line(output, self.depth)
    }

    fn end_object_key<W: ?Sized + Write>(&mut self, _: &mut W) -> io::Result<()> {
        self.is_name = false;
        Ok(())
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, output: &mut W) -> io::Result<()> {
        output.write_all(b":")
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn names_and_values_have_lines_and_lists_have_numbers() {
        let fields = json!({
            "a_name": "some \"text\" \\x00",
            "b": {"c": 1, "deeper": {"d": null}},
            "e": [1, 2, true],
            "f": [],
            "g": [{"h": -1}, {"i": [{"j": 1.5}]}],
            "k": "last",
        });
        let mut text = b"heading".to_vec();
        write(&fields, &mut text).unwrap();
        assert_eq!(
            String::from_utf8(text).unwrap(),
            "\
heading
    a name: some \"text\" \\x00
    b:
        c: 1
        deeper:
            d: none
    e: 1, 2, yes
    f: none
    g:
        1:
            h: -1
        2:
            i:
                1:
                    j: 1.5
    k: last
"
        );
    }
}
