//! bpf(2): maps, programs and their places at the interfaces.
//!
//! The layouts are those of `union bpf_attr` in the kernel's `linux/bpf.h`; what follows the members that
//! are set here is zero, as the kernel wants it.

use std::ffi::CStr;
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

/// One instruction of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub(in crate::datapath) struct Instruction {
    code: u8,
    registers: u8,
    pub(in crate::datapath) offset: i16,
    number: i32,
}

impl Instruction {
    pub(in crate::datapath) fn new(code: u8, to: u8, from: u8, offset: i16, number: i32) -> Self {
        let (low, high) = if cfg!(target_endian = "little") { (to, from) } else { (from, to) };
        Self { code, registers: low | high << 4, offset, number }
    }
}

/// What a map is for.
#[derive(Clone, Copy, Debug)]
pub(in crate::datapath) enum MapKind {
    /// Entries that come and go, by their keys.
    Hash,
    /// Elements that the process shares as memory.
    SharedArray,
    Array,
    /// One array that stands for the others.
    ArrayOfMaps,
}

/// Where a program runs.
#[derive(Clone, Copy, Debug)]
pub(in crate::datapath) enum Place {
    Incoming = 46,
    Outgoing = 47,
}

// The sandbox leaves these commands to a confined process, and no other.
const UPDATE: libc::c_int = 2;
const DELETE: libc::c_int = 3;
const LINK: libc::c_int = 28;

const CREATE_MAP: libc::c_int = 0;
const LOAD: libc::c_int = 5;
#[cfg(any(test, fuzzing))]
const TEST_RUN: libc::c_int = 10;

#[derive(Default)]
#[repr(C)]
struct CreateMap {
    kind: u32,
    key_size: u32,
    value_size: u32,
    max_entries: u32,
    flags: u32,
    inner: u32,
    numa_node: u32,
    name: [u8; 16],
}

#[derive(Default)]
#[repr(C)]
struct Element {
    map: u32,
    _unused: u32,
    key: u64,
    value: u64,
    flags: u64,
}

#[derive(Default)]
#[repr(C)]
struct Load {
    kind: u32,
    instructions: u32,
    code: u64,
    license: u64,
    log_level: u32,
    log_size: u32,
    log: u64,
    kernel_version: u32,
    flags: u32,
    name: [u8; 16],
    interface: u32,
    place: u32,
}

#[derive(Default)]
#[repr(C)]
struct CreateLink {
    program: u32,
    interface: u32,
    place: u32,
    flags: u32,
    relative: u32,
    _unused: u32,
    revision: u64,
}

fn call<T>(command: libc::c_int, arguments: &mut T) -> io::Result<libc::c_long> {
    let (command, size) = (libc::c_long::from(command), size_of::<T>() as libc::c_long);
    // SAFETY: `arguments` is a prefix of `union bpf_attr` with its size beside it. What its pointers lead to
    // outlives the call: each caller below keeps it borrowed.
    let result =
        unsafe { libc::syscall(libc::SYS_bpf, command, std::ptr::from_mut(arguments), size) };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}

fn descriptor(result: libc::c_long) -> OwnedFd {
    // SAFETY: the kernel has just made this descriptor for the caller.
    unsafe { OwnedFd::from_raw_fd(result as libc::c_int) }
}

fn name(name: &str) -> [u8; 16] {
    let mut octets = [0; 16];
    octets[..name.len()].copy_from_slice(name.as_bytes());
    octets
}

fn number(descriptor: BorrowedFd<'_>) -> u32 {
    descriptor.as_raw_fd() as u32 // never negative
}

fn address<T: ?Sized>(of: &T) -> u64 {
    std::ptr::from_ref(of).cast::<u8>().addr() as u64
}

/// Makes a map. `inner` is an example of what is in an [`ArrayOfMaps`](MapKind::ArrayOfMaps).
pub(in crate::datapath) fn create_map(
    kind: MapKind,
    key_size: usize,
    value_size: usize,
    max_entries: usize,
    inner: Option<BorrowedFd<'_>>,
) -> io::Result<OwnedFd> {
    const NO_PREALLOCATION: u32 = 1;
    const SHARED: u32 = 1 << 10;
    let (kind, flags) = match kind {
        MapKind::Hash => (1, NO_PREALLOCATION),
        MapKind::SharedArray => (2, SHARED),
        MapKind::Array => (2, 0),
        MapKind::ArrayOfMaps => (12, 0),
    };
    let mut arguments = CreateMap {
        kind,
        key_size: key_size as u32,
        value_size: value_size as u32,
        max_entries: u32::try_from(max_entries).map_err(io::Error::other)?,
        flags,
        inner: inner.map_or(0, number),
        name: name("pnet_nat"),
        ..CreateMap::default()
    };
    call(CREATE_MAP, &mut arguments).map(descriptor)
}

/// Puts an entry into a map whose keys and values have these lengths, or replaces it.
pub(in crate::datapath) fn update(map: BorrowedFd<'_>, key: &[u8], value: &[u8]) -> io::Result<()> {
    let mut arguments = Element {
        map: number(map),
        key: address(key),
        value: address(value),
        ..Element::default()
    };
    call(UPDATE, &mut arguments).map(drop)
}

/// Takes an entry out of a map.
pub(in crate::datapath) fn delete(map: BorrowedFd<'_>, key: &[u8]) -> io::Result<()> {
    let mut arguments = Element { map: number(map), key: address(key), ..Element::default() };
    call(DELETE, &mut arguments).map(drop)
}

/// Has the kernel check and take a program for this place. An error has the end of the verifier's log, if
/// there is one.
pub(in crate::datapath) fn load(
    code: &[Instruction],
    place: Place,
    called: &str,
) -> io::Result<OwnedFd> {
    const LICENSE: &CStr = c"MIT OR Apache-2.0";
    let mut arguments = Load {
        kind: 3, // BPF_PROG_TYPE_SCHED_CLS
        instructions: code.len() as u32,
        code: address(code),
        license: LICENSE.as_ptr().addr() as u64,
        name: name(called),
        place: place as u32,
        ..Load::default()
    };
    let error = match call(LOAD, &mut arguments) {
        Ok(program) => return Ok(descriptor(program)),
        Err(error) => error,
    };
    if !matches!(error.raw_os_error(), Some(libc::EACCES | libc::EINVAL)) {
        return Err(error);
    }
    let mut log = vec![0_u8; 1 << 20];
    (arguments.log_level, arguments.log_size) = (1, log.len() as u32);
    arguments.log = log.as_mut_ptr().addr() as u64;
    let error = match call(LOAD, &mut arguments) {
        Ok(program) => return Ok(descriptor(program)),
        Err(error) => error,
    };
    let end = log.iter().position(|octet| *octet == 0).unwrap_or(log.len());
    let log = String::from_utf8_lossy(&log[..end]);
    let lines: Vec<_> = log.lines().rev().take(4).collect();
    let lines: Vec<_> = lines.into_iter().rev().collect();
    Err(io::Error::new(error.kind(), format!("{error}: {}", lines.join("; "))))
}

/// Has a program run at an interface, beside those of others, until the link is closed.
pub(in crate::datapath) fn link(
    program: BorrowedFd<'_>,
    interface: u32,
    place: Place,
) -> io::Result<OwnedFd> {
    let mut arguments = CreateLink {
        program: number(program),
        interface,
        place: place as u32,
        ..CreateLink::default()
    };
    call(LINK, &mut arguments).map(descriptor)
}

/// Runs a program on a frame that came in by the loopback interface. Returns its result and the frame as the
/// program has left it.
#[cfg(any(test, fuzzing))]
pub(in crate::datapath) fn test_run(
    program: BorrowedFd<'_>,
    frame: &[u8],
) -> io::Result<(i32, Vec<u8>)> {
    #[derive(Default)]
    #[repr(C)]
    struct TestRun {
        program: u32,
        result: u32,
        size_in: u32,
        size_out: u32,
        data_in: u64,
        data_out: u64,
        repeat: u32,
        duration: u32,
        context_size_in: u32,
        context_size_out: u32,
        context_in: u64,
        context_out: u64,
    }
    let mut out = vec![0; 2048];
    let mut arguments = TestRun {
        program: number(program),
        size_in: frame.len() as u32,
        size_out: out.len() as u32,
        data_in: address(frame),
        data_out: out.as_mut_ptr().addr() as u64,
        repeat: 1,
        ..TestRun::default()
    };
    call(TEST_RUN, &mut arguments)?;
    out.truncate(arguments.size_out as usize);
    Ok((arguments.result as i32, out))
}
