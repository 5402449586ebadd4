//! Any text as a configuration: it is read, or refused with faults and remedies that show no octet
//! of a password.

use std::collections::HashSet;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::LazyLock;

use pnet_nat::config::{self, Config, Faults};
use pnet_nat::nat::NetKind;
use tempfile::TempDir;

/// A folder with the secrets that the corpus names. One has an octet too many.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("secrets")).unwrap();
    for (name, octets) in [
        ("section-1", "s3cr3t-A"),
        ("section-1-device", "s3cr3t-B"),
        ("press", "s3cr3t-C"),
        ("press-device", "s3cr3t-D"),
        ("nine", "s3cr3t-AB"),
        ("admin", "s3cr3t-0123456789abcdef0123456789abcdef"),
    ] {
        let path = folder.path().join("secrets").join(name);
        fs::write(&path, octets).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
    }
    folder
});

/// Takes the octets as the text of a configuration.
pub fn holds(octets: &[u8]) {
    let Ok(text) = str::from_utf8(octets) else { return };
    let path = FOLDER.path().join("pnet-nat.toml");
    match config::parse(text, &path) {
        Ok((config, warnings)) => {
            warnings.iter().for_each(|warning| is_told_well(&warning.0, text, &path));
            is_sound(&config);
            assert!(!format!("{config:?}").contains("s3cr3t"));
        }
        Err(Faults(faults)) => {
            assert!(!faults.is_empty(), "refused without a word");
            faults.iter().for_each(|fault| is_told_well(fault, text, &path));
        }
    }
}

fn is_told_well(fault: &config::Fault, text: &str, path: &Path) {
    let told = fault.to_string();
    assert!(!fault.problem.is_empty() && !fault.remedy.is_empty(), "{told}");
    assert!(!told.contains(char::is_control), "one line of text: {told:?}");
    assert_eq!(fault.file, path);
    let lines = 1 + text.matches('\n').count();
    assert!((1..=lines).contains(&fault.line.expect("a line")), "{told}");
    // Unless the configuration itself contains it, where it does not belong.
    assert!(!told.contains("s3cr3t") || text.contains("s3cr3t"), "{told}");
}

/// What the core relies on.
fn is_sound(config: &Config) {
    let table = &config.table;
    assert!(!config.listen.is_empty() && !table.mappings().is_empty());
    let names: HashSet<_> = table.nets().iter().map(|net| &net.name).collect();
    assert_eq!(names.len(), table.nets().len(), "a name is unique");
    let [mut public_ports, mut servers] = [(); 2].map(|()| HashSet::new());
    for mapping in table.mappings() {
        let net = table.net(mapping.net);
        assert!((1..=125).contains(&mapping.node_address), "R-11");
        assert!(mapping.public_port > 0 && mapping.server.port() > 0);
        assert!(public_ports.insert(mapping.public_port.to_string()), "R-9");
        assert!(servers.insert(mapping.server.to_string()), "R-9");
        if let NetKind::UdpRange { start_port } = net.kind {
            let node_address = u16::from(mapping.node_address);
            assert_eq!(start_port.checked_add(node_address), Some(mapping.public_port), "R-10");
        }
    }
    for net in table.nets() {
        assert!(!net.allow.is_empty(), "nobody could use it");
        assert!(net.allow_without_password || !net.credentials.is_empty(), "R-3");
        assert!(net.max_flows > 0 && !net.idle_timeout.is_zero());
        let names: HashSet<_> = net.credentials.iter().map(|credential| &credential.name).collect();
        assert_eq!(names.len(), net.credentials.len(), "a password's name is unique in its net");
    }
    assert!(config.limits.max_flows > 0 && config.limits.wrong_password_burst > 0);
}
