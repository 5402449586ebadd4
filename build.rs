//! Tells the program which commit it is built from: `--version`, API and metrics show it.
//!
//! `PNET_NAT_COMMIT` says it, for builds without the repository; else git is asked. Where neither
//! knows, the version stands alone.
//!
//! And has the linker of an optimised program put what a relay uses side by side: see
//! `link/record.sh`.

use std::env;
use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-env-changed=PNET_NAT_COMMIT");
    println!("cargo::rerun-if-changed=build.rs");
    let said = env::var("PNET_NAT_COMMIT").ok().filter(|commit| !commit.is_empty());
    let version = env!("CARGO_PKG_VERSION");
    let commit = said.or_else(commit);
    match &commit {
        Some(commit) => println!("cargo::rustc-env=PNET_NAT_VERSION={version} ({commit})"),
        None => println!("cargo::rustc-env=PNET_NAT_VERSION={version}"),
    }
    println!("cargo::rustc-env=PNET_NAT_COMMIT={}", commit.unwrap_or_default());
    put_the_relay_first();
}

fn put_the_relay_first() {
    let said = |name| env::var(name).unwrap_or_default();
    // Where it was tried.
    let is_tried = matches!(&*said("CARGO_CFG_TARGET_ARCH"), "x86_64" | "aarch64" | "arm");
    if said("PROFILE") == "release" && said("CARGO_CFG_TARGET_OS") == "linux" && is_tried {
        let script = Path::new(&said("CARGO_MANIFEST_DIR")).join("link/relay-first.ld");
        println!("cargo::rerun-if-changed={}", script.display());
        println!("cargo::rustc-link-arg-bins=-T");
        println!("cargo::rustc-link-arg-bins={}", script.display());
    }
}

/// The commit that is checked out, if this is a repository of its own: a copy of the sources may
/// lie in somebody else's.
fn commit() -> Option<String> {
    let top = git(&["rev-parse", "--show-toplevel"])?;
    let here = env::var("CARGO_MANIFEST_DIR").ok()?;
    if Path::new(&top).canonicalize().ok()? != Path::new(&here).canonicalize().ok()? {
        return None;
    }
    // Another commit is another HEAD, or another value of the branch that it names; the log of HEAD
    // grows with each.
    let branch = git(&["symbolic-ref", "--quiet", "HEAD"]);
    for name in ["HEAD", "packed-refs", "logs/HEAD"].into_iter().chain(branch.as_deref()) {
        if let Some(path) = git(&["rev-parse", "--git-path", name])
            && Path::new(&path).exists()
        {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    git(&["rev-parse", "--short=12", "HEAD"])
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_owned())
}
