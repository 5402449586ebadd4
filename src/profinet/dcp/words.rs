//! The numbers of DCP in words.

/// An option.
pub fn option_name(option: u8) -> &'static str {
    match option {
        1 => "IP",
        2 => "device properties",
        3 => "DHCP",
        5 => "control",
        6 => "device initiative",
        7 => "TSN domain",
        128..=254 => "manufacturer",
        255 => "all",
        _ => "reserved",
    }
}

/// A suboption of an option.
pub fn suboption_name(option: u8, suboption: u8) -> &'static str {
    match (option, suboption) {
        (1, 1) => "MAC address",
        (1, 2) => "IP parameter",
        (1, 3) => "full IP suite",
        (2, 1) => "type of station",
        (2, 2) => "name of station",
        (2, 3) => "device ID",
        (2, 4) => "device role",
        (2, 5) => "device options",
        (2, 6) => "alias name",
        (2, 7) => "device instance",
        (2, 8) => "OEM device ID",
        (2, 9) => "standard gateway",
        (2, 10) => "RSI properties",
        (3, 12) => "DHCP host name",
        (3, 43) => "DHCP vendor information",
        (3, 54) => "DHCP server",
        (3, 55) => "DHCP parameter list",
        (3, 60) => "DHCP class",
        (3, 61) => "DHCP client ID",
        (3, 81) => "DHCP domain name",
        (3, 97) => "DHCP client UUID",
        (3, 255) => "DHCP control",
        (5, 1) => "start transaction",
        (5, 2) => "end transaction",
        (5, 3) => "signal",
        (5, 4) => "response",
        (5, 5) => "factory settings",
        (5, 6) => "reset to factory",
        (6, 1) => "device initiative",
        (7, 1) => "TSN domain name",
        (7, 2) => "NME manager",
        (7, 3) => "NME parameter UUID",
        (7, 4) => "NME agent",
        (7, 5) => "CIM interface",
        (255, 255) => "all",
        (128..=254, _) => "manufacturer's",
        _ => "unknown",
    }
}

/// What has become of a block of a set request.
pub fn block_error_name(error: u8) -> &'static str {
    match error {
        0 => "done",
        1 => "option not supported",
        2 => "suboption not supported, or nothing stored",
        3 => "suboption not set",
        4 => "out of resources",
        5 => "cannot be set in this device",
        6 => "cannot be set during operation",
        _ => "unknown error",
    }
}

/// Where an IP address comes from, and whether somebody else has it too.
pub fn ip_block_info_name(info: u16) -> &'static str {
    match info {
        0x00 => "not set",
        0x01 => "set",
        0x02 => "set by DHCP",
        0x80 => "not set, address conflict",
        0x81 => "set, address conflict",
        0x82 => "set by DHCP, address conflict",
        _ => "unknown",
    }
}

/// What a reset to factory resets, by its qualifier.
pub fn reset_name(qualifier: u16) -> &'static str {
    match qualifier >> 1 {
        0 => "default",
        1 => "application data",
        2 => "communication parameters",
        3 => "engineering parameters",
        4 => "all stored data",
        8 => "everything, as delivered",
        9 => "everything, and restore",
        _ => "reserved",
    }
}

/// The roles of a device, whose bits are set.
pub fn role_names(roles: u8) -> impl Iterator<Item = &'static str> {
    const ROLES: [(u8, &str); 5] = [
        (0x01, "IO device"),
        (0x02, "IO controller"),
        (0x04, "IO multidevice"),
        (0x08, "IO supervisor"),
        (0xF0, "reserved"),
    ];
    ROLES.into_iter().filter(move |(bits, _)| roles & bits != 0).map(|(_, name)| name)
}
