//! The text of a file in TOML, or why there is none.

use std::io::Read;
use std::path::Path;

use super::file::{self, FileError};
use super::report::{Fault, Faults};

/// The largest file that is read, in octets. A server for each port takes less.
pub(super) const MOST_OCTETS: u64 = 16 << 20;

/// What a file is meant to be, for remedies.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    Configuration,
    IpNetTable,
}

impl Kind {
    fn remedy_if_absent(self) -> &'static str {
        match self {
            Self::Configuration => "name a configuration file that pnet-nat may read with --config",
            Self::IpNetTable => {
                "name a file with an IPNetTable that pnet-nat may read with --table"
            }
        }
    }

    fn remedy_if_large(self) -> &'static str {
        match self {
            Self::Configuration => "name a configuration file: 65,535 servers fit into less",
            Self::IpNetTable => "name a file with an IPNetTable: 124 nets fit into less",
        }
    }
}

/// The text of a configuration file.
pub fn read_text(path: &Path) -> Result<String, Faults> {
    read(path, Kind::Configuration)
}

pub(super) fn read(path: &Path, kind: Kind) -> Result<String, Faults> {
    let unreadable = |line, problem, remedy: &str| {
        let (file, key, remedy) = (path.to_owned(), String::new(), remedy.to_owned());
        Faults(vec![Fault { file, line, key, problem, remedy, excerpt: None, passes: false }])
    };
    let cannot_be_read = |error: FileError| {
        let remedy = match error.is_absent() {
            true => kind.remedy_if_absent().to_owned(),
            false => error.remedy(path),
        };
        unreadable(None, error.to_string(), &remedy)
    };
    let mut octets = Vec::new();
    let (file, _) = file::open(path).map_err(cannot_be_read)?;
    let read = file.take(MOST_OCTETS + 1).read_to_end(&mut octets);
    read.map_err(|error| cannot_be_read(error.into()))?;
    if octets.len() as u64 > MOST_OCTETS {
        let problem = format!("has more than {} MiB", MOST_OCTETS >> 20);
        return Err(unreadable(None, problem, kind.remedy_if_large()));
    }
    if let Some(encoding) = utf_16(&octets) {
        let remedy = format!("save the file as UTF-8; `iconv -f {encoding} -t UTF-8` converts it");
        return Err(unreadable(Some(1), "is UTF-16 text".into(), &remedy));
    }
    String::from_utf8(octets).map_err(|err| {
        let sound = &err.as_bytes()[..err.utf8_error().valid_up_to()];
        let line = 1 + sound.iter().filter(|&&octet| octet == b'\n').count();
        unreadable(Some(line), "is not UTF-8 text".into(), "save the file as UTF-8")
    })
}

/// The encoding, where some editors of Windows saved the file as UTF-16: with a mark at its beginning,
/// or with every second octet zero.
fn utf_16(octets: &[u8]) -> Option<&'static str> {
    match octets {
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => Some("UTF-16"),
        [first, 0, second, 0, ..] if *first != 0 && *second != 0 => Some("UTF-16LE"),
        [0, first, 0, second, ..] if *first != 0 && *second != 0 => Some("UTF-16BE"),
        _ => None,
    }
}
