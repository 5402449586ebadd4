//! The files that `init` writes: each one new, so that none that is there can be lost.

use std::fmt::{self, Display};
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{self, Path, PathBuf};

use anyhow::Context;

use super::answers::Name;
use super::{Plan, host};
use crate::cli::check::{SheetFormat, sheet};
use crate::cli::password;
use crate::config;

/// Where they are.
#[derive(Debug)]
pub(super) struct Files {
    pub(super) folder: PathBuf,
    pub(super) config: PathBuf,
    pub(super) secret: PathBuf,
    sheet: PathBuf,
}

impl Display for Files {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (path, what) in [
            (&self.config, "the configuration"),
            (&self.secret, "the password: 8 random characters, for its owner alone"),
            (&self.sheet, "for whoever sets up the clients, without the password"),
        ] {
            let path = path.strip_prefix(&self.folder).unwrap_or(path).display().to_string();
            writeln!(f, "  {path:<20} {what}")?;
        }
        Ok(())
    }
}

impl Files {
    /// Those in a folder, with the usual name of the password. Whole paths: the commands with them are typed in
    /// other terminals, too.
    pub(super) fn of(folder: &Path) -> Self {
        let folder = path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        Self {
            config: folder.join("pnet-nat.toml"),
            secret: folder.join("secrets").join(Name::default().to_string()),
            sheet: folder.join("client-sheet.html"),
            folder,
        }
    }

    pub(super) fn with_secret(self, name: &Name) -> Self {
        Self { secret: self.secret.with_file_name(name.to_string()), ..self }
    }

    /// The first that is there, whatever it is.
    pub(super) fn already_there(&self) -> Option<&Path> {
        let all = [&self.config, &self.secret, &self.sheet].into_iter();
        all.map(PathBuf::as_path).find(|path| fs::symlink_metadata(path).is_ok())
    }

    /// Writes them all. The configuration has no secret: the relay's own user may have to read it.
    pub(super) fn write(&self, plan: &Plan) -> anyhow::Result<()> {
        let folder = &self.folder;
        fs::create_dir_all(folder)
            .with_context(|| format!("the folder {folder:?} cannot be made"))?;
        let (secret, text) = (&self.secret, plan.toml());
        password::make(secret).with_context(|| format!("{secret:?} cannot be written"))?;
        write_new(&self.config, &text)?;
        // What is not sound has no sheet; `check` comes next and says why.
        match config::parse(&text, &self.config) {
            Ok((config, _)) => write_new(&self.sheet, &sheet(&config, SheetFormat::Html)),
            Err(_) => Ok(()),
        }
    }
}

fn write_new(path: &Path, text: &str) -> anyhow::Result<()> {
    let write = || -> io::Result<()> {
        let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()
    };
    write().with_context(|| format!("{path:?} cannot be written"))
}

impl Plan {
    /// The configuration, with a word on each key.
    fn toml(&self) -> String {
        let list = |list: Vec<String>| format!("[{}]", list.join(", "));
        let quoted = |text: String| format!("\"{text}\"");
        let listen = list(self.listen.iter().map(|it| quoted(it.to_string())).collect());
        let nodes = list(self.nodes.runs().map(quoted).collect());
        let allow = list(self.allow.iter().map(|it| quoted(it.to_string())).collect());
        let Self { subnet, start_port, name, .. } = self;
        let example = self.nodes.iter().next().unwrap_or(1);
        let port = start_port + example;
        let [a, b, c, _] = subnet.0.octets();
        let server = format!("{a}.{b}.{c}.{example}");
        let admin = self.admin_port.map_or(String::new(), |port| {
            let usual = host::ADMIN_PORT;
            format!("\n[admin]\nlisten = \"127.0.0.1:{port}\" # {usual} is in use on this host\n")
        });
        format!(
            "# The configuration of pnet-nat, made by `pnet-nat init`. Keys that are not here have their \
             defaults:\n# docs/configuration.md has all of them. After a change:\n#\n\
             #   pnet-nat check --config pnet-nat.toml     shows every fault, or the NAT table\n\
             #   pnet-nat reload                           brings it into force, and loses nothing\n\n\
             [public]\n\
             # Addresses of this host that clients send to. \"0.0.0.0\" stands for every IPv4 address.\n\
             listen = {listen}\n\n\
             # A plant section. Node {example} is reached at port {port} and is the server {server}.\n\
             [[udp_range_net]]\n\
             name = \"{name}\"\n\
             start_port = {start_port} # UDPPort in the clients' IPNetTable\n\
             subnet = \"{subnet}\"\n\
             nodes = {nodes} # the others cannot be reached\n\
             # Networks that clients send from. Whatever comes from elsewhere is dropped.\n\
             allow = {allow}\n\n\
             # What a client's request has to carry. One block for each password.\n\
             [[udp_range_net.password]]\n\
             name = \"service\" # in metrics and logs\n\
             file = \"secrets/{name}\" # `pnet-nat password` makes another one\n{admin}"
        )
    }
}
