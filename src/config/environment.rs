//! The main keys of a small relay as environment variables, for containers without a configuration file.
//!
//! The variables become a configuration in TOML, which the one reader reads. What it says of a line and a
//! key is then said of the variable. Secrets stay in files: a variable names the file.

use std::env;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::host::Host;
use super::report::{Fault, Faults, Warning};
use super::{Config, Table, parse_on};

/// What a variable becomes.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Text,
    /// A whole number, or true or false.
    Plain,
    /// Texts with commas between them.
    List,
}

/// A key that can be given as a variable.
#[derive(Clone, Copy, Debug)]
struct Variable {
    name: &'static str,
    key: &'static str,
    kind: Kind,
    /// No other command has a variable of this name.
    is_ours: bool,
}

const fn variable(name: &'static str, key: &'static str, kind: Kind, is_ours: bool) -> Variable {
    Variable { name, key, kind, is_ours }
}

/// A section: its header, the path of its keys, and those that can be given.
type Section = (&'static str, &'static str, &'static [Variable]);

const SECTIONS: [Section; 4] = [
    ("[public]", "public", &[variable("PNET_NAT_LISTEN", "listen", Kind::List, false)]),
    (
        "[[udp_range_net]]",
        "udp_range_net[0]",
        &[
            variable(NET, "name", Kind::Text, false),
            variable("PNET_NAT_START_PORT", "start_port", Kind::Plain, false),
            variable("PNET_NAT_SUBNET", "subnet", Kind::Text, true),
            variable("PNET_NAT_NODES", "nodes", Kind::List, true),
            variable("PNET_NAT_ALLOW", "allow", Kind::List, true),
            variable(
                "PNET_NAT_SERVERS_BEYOND_GATEWAY",
                "servers_beyond_gateway",
                Kind::Plain,
                true,
            ),
        ],
    ),
    (
        "[[udp_range_net.password]]\nname = \"service\"",
        "udp_range_net[0].password[0]",
        &[
            variable("PNET_NAT_PASSWORD_FILE", "file", Kind::Text, false),
            variable("PNET_NAT_DEVICE_PASSWORD_FILE", "device_file", Kind::Text, true),
        ],
    ),
    (
        "[admin]",
        "admin",
        &[
            variable("PNET_NAT_ADMIN_LISTEN", "listen", Kind::Text, true),
            variable("PNET_NAT_TOKEN_FILE", "token_file", Kind::Text, false),
        ],
    ),
];

const NET: &str = "PNET_NAT_NET";
/// The net's name when no variable tells it.
const USUAL_NET: &str = "section-1";
/// Where containers find their secrets. The usual password file has the name of the net.
const SECRETS: &str = "/run/secrets";

/// A configuration that environment variables give.
#[derive(Clone, Debug)]
pub struct Environment {
    text: String,
}

impl Environment {
    /// That of this process; none when no variable is set that is for this purpose alone.
    pub fn of_process() -> Option<Self> {
        Self::of(|name| Some(env::var_os(name)?.to_string_lossy().into_owned()))
    }

    fn of(value: impl Fn(&str) -> Option<String>) -> Option<Self> {
        // A variable that is empty is one that somebody left open.
        let value = |name: &str| value(name).filter(|value| !value.is_empty());
        let mut variables = SECTIONS.iter().flat_map(|(_, _, variables)| *variables);
        variables.find(|variable| variable.is_ours && value(variable.name).is_some())?;
        let usual = |name: &str| match name {
            "PNET_NAT_LISTEN" => Some("0.0.0.0".to_owned()),
            NET => Some(USUAL_NET.to_owned()),
            "PNET_NAT_PASSWORD_FILE" => {
                let net = value(NET).unwrap_or_else(|| USUAL_NET.to_owned());
                Some(format!("{SECRETS}/{net}"))
            }
            _ => None,
        };
        let mut text = String::new();
        for (header, _, variables) in &SECTIONS {
            text += &format!("{header}\n");
            for Variable { name, key, kind, .. } in *variables {
                if let Some(value) = value(name).or_else(|| usual(name)) {
                    text += &format!("{key} = {}\n", in_toml(&value, *kind));
                }
            }
        }
        Some(Self { text })
    }

    /// The names of all variables that can be set.
    pub fn names() -> impl Iterator<Item = &'static str> {
        SECTIONS.iter().flat_map(|(_, _, variables)| *variables).map(|variable| variable.name)
    }

    /// The configuration in TOML.
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// Reads it, and the files that it names, and asks this host about the servers that the table in force
    /// does not have.
    pub(super) fn load(&self, host: &dyn Host, in_force: Option<&Table>) -> Read {
        let read = parse_on(&self.text, Path::new(""), host, in_force);
        let (mut config, warnings) =
            read.map_err(|Faults(faults)| Faults(faults.into_iter().map(of_variable).collect()))?;
        config.files.retain(|file| !file.as_os_str().is_empty());
        let warnings = warnings.into_iter().map(|Warning(fault)| Warning(of_variable(fault)));
        Ok((config, warnings.collect()))
    }
}

type Read = Result<(Config, Vec<Warning>), Faults>;

/// A value as TOML has it. What is not of its kind becomes a text, which the reader refuses.
fn in_toml(value: &str, kind: Kind) -> String {
    match kind {
        Kind::Text => quoted(value),
        Kind::Plain => match (value.parse::<u32>(), value) {
            (Ok(number), _) => number.to_string(),
            (_, "true" | "false") => value.to_owned(),
            _ => quoted(value),
        },
        Kind::List => {
            let elements = value.split(',').map(str::trim).filter(|element| !element.is_empty());
            format!("[{}]", elements.map(quoted).collect::<Vec<_>>().join(", "))
        }
    }
}

fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        // A String takes all that is written to it.
        let _ = match c {
            '"' | '\\' => write!(quoted, "\\{c}"),
            c if c.is_control() => write!(quoted, "\\u{:04X}", u32::from(c)),
            c => write!(quoted, "{c}"),
        };
    }
    quoted + "\""
}

/// The same fault, of a variable in place of a line and a key.
fn of_variable(fault: Fault) -> Fault {
    let all = || {
        SECTIONS.iter().flat_map(|(_, path, variables)| variables.iter().map(move |v| (*path, *v)))
    };
    let is_its = |(path, variable): &(&str, Variable)| {
        let rest = fault.key.strip_prefix(&format!("{path}.{}", variable.key));
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('['))
    };
    let own = all().find(is_its).map(|(_, variable)| variable);
    let others = all().map(|(_, variable)| variable);
    let in_words = |text: String| own.into_iter().chain(others.clone()).fold(text, named);
    Fault {
        file: PathBuf::from(own.map_or("environment", |own| own.name)),
        line: None,
        key: String::new(),
        problem: in_words(fault.problem.clone()),
        remedy: in_words(fault.remedy.clone()),
        ..fault
    }
}

/// A text that names the variable where it has the key: `` `subnet` ``, `` `subnet = "172.17.17.0"` ``.
fn named(text: String, variable: Variable) -> String {
    let text = text.replace(&format!("`{}`", variable.key), &format!("`{}`", variable.name));
    let setting = format!("`{} = ", variable.key);
    let Some((before, rest)) = text.split_once(&setting) else { return text };
    let Some((value, after)) = rest.split_once('`') else { return text };
    let value = value.replace(['"', '[', ']', ' '], "");
    format!("{before}`{}={value}`{after}", variable.name)
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt;

    use super::super::host::Unknown;
    use super::*;

    fn of(variables: &[(&str, &str)]) -> Option<Environment> {
        let variables: HashMap<_, _> = variables.iter().copied().collect();
        Environment::of(|name| variables.get(name).map(|value| (*value).to_owned()))
    }

    /// What is read where these are set, beside a sound rest.
    fn read(variables: &[(&str, &str)]) -> Read {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("section-1");
        fs::write(&file, "k7Zq+4Lx").unwrap();
        fs::set_permissions(&file, Permissions::from_mode(0o600)).unwrap();
        let file = file.to_str().unwrap();
        let sound = [
            ("PNET_NAT_START_PORT", "20000"),
            ("PNET_NAT_SUBNET", "172.17.17.0"),
            ("PNET_NAT_NODES", "1-4, 33"),
            ("PNET_NAT_ALLOW", "198.51.100.0/24,203.0.113.7"),
            ("PNET_NAT_PASSWORD_FILE", file),
        ];
        of(&[&sound, variables].concat()).unwrap().load(&Unknown, None)
    }

    #[test]
    fn the_variables_are_a_configuration() {
        let (config, warnings) = read(&[]).unwrap();
        assert_eq!(warnings, []);
        assert_eq!(config.listen, ["0.0.0.0".parse::<std::net::IpAddr>().unwrap()]);
        let net = &config.table.nets()[0];
        assert_eq!((net.name.as_str(), net.allow.len()), ("section-1", 2));
        let nodes = config.table.mappings().iter().map(|mapping| mapping.node_address);
        assert!(nodes.eq([1, 2, 3, 4, 33]));
        assert_eq!(config.files.len(), 1, "the password file alone");

        let all = [
            ("PNET_NAT_LISTEN", "192.0.2.1,2001:db8::1"),
            ("PNET_NAT_NET", "press"),
            ("PNET_NAT_SERVERS_BEYOND_GATEWAY", "true"),
            ("PNET_NAT_ADMIN_LISTEN", "127.0.0.1:9400"),
            ("PNET_NAT_TOKEN_FILE", ""),
        ];
        let (config, _) = read(&all).unwrap();
        assert_eq!(config.listen.len(), 2);
        assert_eq!(config.table.nets()[0].name, "press");
        let admin = config.admin.unwrap();
        assert_eq!((admin.listen.port(), admin.token), (9400, None));
    }

    #[test]
    fn what_other_commands_have_too_is_not_enough() {
        let of_request = [("PNET_NAT_START_PORT", "20000"), ("PNET_NAT_PASSWORD_FILE", "a")];
        assert!(of(&of_request).is_none());
        assert!(of(&[("PNET_NAT_SUBNET", "")]).is_none());
        assert!(of(&[("PNET_NAT_SUBNET", "172.17.17.0")]).is_some());
    }

    #[test]
    fn the_usual_password_file_is_the_secret_of_the_net() {
        let usual = of(&[("PNET_NAT_SUBNET", "172.17.17.0")]).unwrap();
        assert!(usual.text.contains("file = \"/run/secrets/section-1\"\n"));
        let press = of(&[("PNET_NAT_SUBNET", "172.17.17.0"), ("PNET_NAT_NET", "press")]).unwrap();
        assert!(press.text.contains("file = \"/run/secrets/press\"\n"));
    }

    #[test]
    fn a_fault_names_the_variable_and_what_to_set() {
        for (variable, value, told) in [
            (
                "PNET_NAT_START_PORT",
                "20k",
                "PNET_NAT_START_PORT: expected a whole number, found a text; write it like \
                 `PNET_NAT_START_PORT=20000`",
            ),
            (
                "PNET_NAT_START_PORT",
                "",
                "PNET_NAT_START_PORT: missing; add `PNET_NAT_START_PORT=20000`",
            ),
            (
                "PNET_NAT_NODES",
                "1-4,126",
                "PNET_NAT_NODES: \"126\" is not a range of node addresses; node addresses are 1 to \
                 125: write one like \"4\", or a range like \"1-4\"",
            ),
            (
                "PNET_NAT_NODES",
                ",",
                "PNET_NAT_NODES: the list is empty; write it like `PNET_NAT_NODES=1-4,33`",
            ),
            (
                "PNET_NAT_SUBNET",
                "a\"\n[admin]",
                "PNET_NAT_SUBNET: \"a\\\"\\n[admin]\" cannot be read: not an IPv4 address; write it \
                 like `PNET_NAT_SUBNET=172.17.17.0`",
            ),
            (
                "PNET_NAT_ADMIN_LISTEN",
                "0.0.0.0:9378",
                "PNET_NAT_ADMIN_LISTEN: 0.0.0.0:9378 can be reached from other hosts, and every \
                 request would be answered; set `PNET_NAT_TOKEN_FILE`, or listen on \
                 \"127.0.0.1:9378\"",
            ),
        ] {
            let Err(faults) = read(&[(variable, value)]) else { panic!("{variable}={value}") };
            assert_eq!(faults.to_string(), told);
        }
        let gateway = "set `servers_beyond_gateway = true`".to_owned();
        let variables = SECTIONS.iter().flat_map(|(_, _, variables)| *variables);
        let said = variables.copied().fold(gateway, named);
        assert_eq!(said, "set `PNET_NAT_SERVERS_BEYOND_GATEWAY=true`");
    }
}
