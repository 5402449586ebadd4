//! The Docker engine: images made on the spot, containers, networks. Invariant: what a scenario made
//! is gone when it ends, also when it fails.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{self, Command};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::harness::{eventually, left_out};

const REPOSITORY: &str = env!("CARGO_MANIFEST_DIR");
/// The commit that an image is told.
pub(super) const COMMIT: &str = "0123456789ab";
/// What the Dockerfile's build gets to see.
const IGNORE: &str = include_str!("../../../deploy/container/Dockerfile.dockerignore");

/// Whether there is an engine; says so where there is none.
pub(super) fn has_docker() -> bool {
    let has = Command::new("docker").arg("info").output().is_ok_and(|out| out.status.success());
    if !has {
        left_out("a Docker engine, of the package docker.io");
    }
    has
}

/// What a command of the engine prints on stdout.
#[track_caller]
pub(super) fn docker(arguments: &[&str]) -> String {
    output(Command::new("docker").args(arguments))
}

#[track_caller]
pub(super) fn output(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{stderr}", output.status);
    String::from_utf8(output.stdout).unwrap().trim_end().to_owned()
}

/// A name that nothing else of the engine has.
fn name() -> String {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    format!("pnet-nat-{}-{}", process::id(), NEXT.fetch_add(1, Relaxed))
}

/// An image.
#[derive(Debug)]
pub(super) struct Image(pub(super) String);

impl Image {
    /// pnet-nat's own, by `prebuilt.Dockerfile`; says so where there is no engine.
    pub(super) fn prebuilt() -> Option<Self> {
        let program = has_docker().then(program)?;
        let context = tempfile::tempdir().unwrap();
        fs::copy(program, context.path().join("pnet-nat")).unwrap();
        let dockerfile = format!("{REPOSITORY}/deploy/container/prebuilt.Dockerfile");
        let commit = format!("PNET_NAT_COMMIT={COMMIT}");
        Some(Self::build_with(&["--build-arg", &commit], Path::new(&dockerfile), context.path()))
    }

    pub(super) fn build(dockerfile: &Path, context: &Path) -> Self {
        Self::build_with(&[], dockerfile, context)
    }

    fn build_with(options: &[&str], dockerfile: &Path, context: &Path) -> Self {
        let image = Self(name());
        let mut build = Command::new("docker");
        build.args(["build", "--quiet", "--tag", &image.0]).args(options);
        build.arg("--file").arg(dockerfile).arg(context);
        output(&mut build);
        image
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        let _ = Command::new("docker").args(["image", "rm", "--force", &self.0]).output();
    }
}

/// A container, by the name that it gets.
#[derive(Debug)]
pub(super) struct Container(pub(super) String);

impl Container {
    pub(super) fn name() -> Self {
        Self(name())
    }

    /// Waits until its health is good.
    #[track_caller]
    pub(super) fn expect_healthy(&self) {
        let inspect = ["inspect", "--format", "{{.State.Health.Status}}", &self.0];
        eventually("the container is healthy", || {
            // It may not be there yet.
            let health = Command::new("docker").args(inspect).output().unwrap();
            (health.stdout == b"healthy\n").then_some(())
        });
    }
}

impl Drop for Container {
    fn drop(&mut self) {
        let _ = Command::new("docker").args(["rm", "--force", "--volumes", &self.0]).output();
    }
}

/// A bridge between containers and this host.
#[derive(Debug)]
pub(super) struct Bridge(pub(super) String);

impl Bridge {
    pub(super) fn create() -> Self {
        let bridge = Self(name());
        docker(&["network", "create", &bridge.0]);
        bridge
    }

    /// This host's address in it.
    pub(super) fn gateway(&self) -> String {
        let field = "{{(index .IPAM.Config 0).Gateway}}";
        docker(&["network", "inspect", "--format", field, &self.0])
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        let _ = Command::new("docker").args(["network", "rm", &self.0]).output();
    }
}

/// The static program, as the image has it. It is built from what the Dockerfile's build gets to see,
/// and takes minutes when the code has changed.
fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(build)
}

fn build() -> PathBuf {
    let linux = |library| format!("{}-unknown-linux-{library}", std::env::consts::ARCH);
    let musl = linux("musl");
    let mut libraries = Command::new("rustc");
    let has_musl =
        Path::new(&output(libraries.args(["--print", "target-libdir", "--target", &musl])))
            .exists();
    // Where Rust's part of musl cannot be had, the machine's own C library does, put in whole.
    let (target, flags) =
        if has_musl { (musl, "") } else { (linux("gnu"), "-C target-feature=+crt-static") };
    // Always the same place, and files as old as they are: cargo knows what it has built.
    let temporary = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let context = temporary.join("container");
    let _ = fs::remove_dir_all(&context);
    fs::create_dir(&context).unwrap();
    for seen in IGNORE.lines().filter_map(|line| line.strip_prefix('!')) {
        output(Command::new("cp").args(["--archive", seen]).arg(&context).current_dir(REPOSITORY));
    }
    let all = temporary.parent().unwrap();
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["build", "--profile", "dist", "--locked", "--target", &target, "--target-dir"]);
    let variable = target.to_uppercase().replace('-', "_");
    // It would take the place of both that variable and the repository's own flags.
    cargo.env_remove("RUSTFLAGS");
    cargo.env(format!("CARGO_TARGET_{variable}_RUSTFLAGS"), flags);
    output(cargo.arg(all).current_dir(&context));
    all.join(target).join("dist/pnet-nat")
}
