//! What a datagram says, with a line for each field.

use std::fmt::{self, Display};

use super::{Fields, Rest, RouteFields};

/// The fields as a tree. The first line is the type.
pub(in crate::cli::decode) struct Tree<'a>(pub(in crate::cli::decode) &'a Fields<'a>);

impl Display for Tree<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Fields { length, route, rest, fault, .. } = self.0;
        let kind = rest.as_ref().map(Rest::type_in_words);
        writeln!(f, "{}", kind.unwrap_or("malformed"))?;
        writeln!(f, "    length: {length}")?;
        if let Some(fault) = fault {
            writeln!(f, "    at octet {}: {}", fault.error_offset, fault.error)?;
        }
        if let Some(route) = route {
            self::route(f, route)?;
        }
        match rest {
            Some(rest) => self::rest(f, rest),
            None => Ok(()),
        }
    }
}

fn route(f: &mut fmt::Formatter<'_>, route: &RouteFields<'_>) -> fmt::Result {
    writeln!(f, "    header: {}", route.header)?;
    writeln!(f, "    route: {}, {}", route.route, route.route_format)?;
    if let Some(length) = route.remaining_route_length {
        writeln!(f, "        remaining route length: {length}")?;
    }
    writeln!(f, "        to: {}", route.destination())?;
    writeln!(f, "        from: {}", route.source())
}

fn rest(f: &mut fmt::Formatter<'_>, rest: &Rest<'_>) -> fmt::Result {
    writeln!(f, "    control-status: ${:02X}", rest.control_status)?;
    writeln!(f, "    data-field-format: ${:02X}", rest.data_field_format)?;
    writeln!(f, "        flags: ${:02X}", rest.data_field_flags)?;
    writeln!(f, "        data size: {}", rest.data_size)?;
    if rest.data_size > 0 {
        writeln!(f, "    data: {}", rest.data)?;
    }
    writeln!(f, "    password: {}", rest.password)
}
