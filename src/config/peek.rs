//! Single keys of a configuration that may have faults. [`parse`](super::parse) reports those.

use std::net::SocketAddr;
use std::path::PathBuf;

use toml::de::DeTable;

use super::defaults::ADMIN_LISTEN;

/// `[runtime] user`: the rest of the configuration is read with the rights of this user.
pub(super) fn user(text: &str) -> Option<String> {
    let (document, _) = DeTable::parse_recoverable(text);
    let runtime = document.get_ref().get("runtime")?.get_ref().as_table()?;
    let user = runtime.get("user")?.get_ref();
    let number = || Some(user.as_integer()?.as_str().to_owned());
    user.as_str().map(str::to_owned).or_else(number)
}

/// Where the admin server of a running relay is, for those who ask it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdminPlace {
    /// Whether there is one.
    pub enabled: bool,
    /// Where it listens.
    pub listen: SocketAddr,
    /// The control socket, relative to the configuration.
    pub control: Option<PathBuf>,
    /// The file with its token, relative to the configuration.
    pub token_file: Option<PathBuf>,
}

impl Default for AdminPlace {
    fn default() -> Self {
        Self { enabled: true, listen: ADMIN_LISTEN, control: None, token_file: None }
    }
}

/// Reads `[admin]`; what cannot be read is the default.
pub(super) fn admin_place(text: &str) -> AdminPlace {
    let usual = AdminPlace::default();
    let (document, _) = DeTable::parse_recoverable(text);
    let admin = document.get_ref().get("admin").and_then(|admin| admin.get_ref().as_table());
    let value = |key: &str| Some(admin?.get(key)?.get_ref());
    let text = |key: &str| value(key).and_then(|value| value.as_str());
    let listen = text("listen").and_then(|listen| listen.parse().ok());
    AdminPlace {
        enabled: value("enabled").and_then(|enabled| enabled.as_bool()).unwrap_or(usual.enabled),
        listen: listen.unwrap_or(usual.listen),
        control: text("control").map(PathBuf::from),
        token_file: text("token_file").map(PathBuf::from),
    }
}
