//! Where a configuration comes from: a file, or the environment. Never both, so that nobody has to find
//! out which of two is in force.

use std::path::{Path, PathBuf};

use super::environment::Environment;
use super::host::{Host, ThisHost, Unknown};
use super::peek::AdminPlace;
use super::report::{Faults, Warning};
use super::{Config, Table, parse_on, peek, read_text};

/// The file when none is named, and no variable gives a configuration.
pub const USUAL_FILE: &str = "/etc/pnet-nat/pnet-nat.toml";

/// Where a configuration comes from.
#[derive(Clone, Debug)]
pub enum Source {
    /// This file.
    File(PathBuf),
    /// Environment variables.
    Environment(Environment),
}

/// There are two configurations.
#[derive(Debug, thiserror::Error)]
#[error(
    "there are two configurations: {}, and one of environment variables such as PNET_NAT_SUBNET; unset \
     those, or take the file away", .0.display()
)]
pub struct TwoSources(pub PathBuf);

impl Source {
    /// The file that was named, or what the environment gives, or the usual file.
    pub fn choose(named: Option<&Path>) -> Result<Self, TwoSources> {
        let environment = Environment::of_process();
        let usual = Path::new(USUAL_FILE);
        match (named, environment) {
            (Some(file), Some(_)) => Err(TwoSources(file.to_owned())),
            (None, Some(_)) if usual.exists() => Err(TwoSources(usual.to_owned())),
            (None, Some(environment)) => Ok(Self::Environment(environment)),
            (file, None) => Ok(Self::File(file.unwrap_or(usual).to_owned())),
        }
    }

    /// Reads the configuration and the password files that it names, and asks this host about the
    /// servers.
    pub fn load(&self) -> Result<(Config, Vec<Warning>), Faults> {
        self.read(&ThisHost, None)
    }

    /// The same without asking this host: for those who find out themselves what it lacks.
    pub fn load_without_host(&self) -> Result<(Config, Vec<Warning>), Faults> {
        self.read(&Unknown, None)
    }

    /// The same for a relay that has this table in force: the host is asked only about servers that are
    /// not in it.
    pub fn load_again(&self, in_force: &Table) -> Result<(Config, Vec<Warning>), Faults> {
        self.read(&ThisHost, Some(in_force))
    }

    fn read(
        &self,
        host: &dyn Host,
        in_force: Option<&Table>,
    ) -> Result<(Config, Vec<Warning>), Faults> {
        match self {
            Self::File(path) => parse_on(&read_text(path)?, path, host, in_force),
            Self::Environment(environment) => environment.load(host, in_force),
        }
    }

    /// Where the admin server of a relay with this configuration is, for those who ask it. The relay reports
    /// the faults of a file, and only its user may be able to read it.
    pub fn admin_place(&self) -> AdminPlace {
        match self {
            Self::File(path) => peek::admin_place(&read_text(path).unwrap_or_default()),
            Self::Environment(environment) => peek::admin_place(environment.text()),
        }
    }

    /// `[runtime] user`: the rest of the configuration is read with the rights of this user.
    pub fn user(&self) -> Result<Option<String>, Faults> {
        match self {
            Self::File(path) => Ok(peek::user(&read_text(path)?)),
            Self::Environment(_) => Ok(None), // a container says it itself
        }
    }
}
