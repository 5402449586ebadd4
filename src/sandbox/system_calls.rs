//! seccomp: restricts the process to the system calls of a relay.
//!
//! The list holds the calls that were observed in the relay, with glibc and with musl: at the
//! start, under traffic and floods, while somebody watches it, and at its end. It also holds the
//! calls that the C libraries use instead on other kernels. Any other call fails with EPERM, and
//! its caller reports the error: a new C library that tries a new call must not stop a plant. Calls
//! that no relay ever makes, but an intruder does, end the process at once, and the kernel's log
//! says so.

use std::collections::BTreeMap;
use std::env;
use std::process;

use seccompiler::{
    BackendError, BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition,
    SeccompFilter, SeccompRule,
};

/// Calls that are allowed with any arguments.
const ALLOWED: &[libc::c_long] = &[
    // Datagrams and connections
    libc::SYS_accept4,
    libc::SYS_bind,
    // Connects to the service manager. New sockets are datagram sockets, and Landlock forbids TCP
    // connections
    libc::SYS_connect,
    libc::SYS_getsockname,
    libc::SYS_getsockopt,
    libc::SYS_recvfrom,
    libc::SYS_recvmmsg,
    libc::SYS_recvmsg,
    libc::SYS_sendmmsg,
    libc::SYS_sendmsg,
    libc::SYS_sendto,
    libc::SYS_setsockopt,
    libc::SYS_shutdown,
    // Waiting
    libc::SYS_clock_nanosleep,
    libc::SYS_epoll_create1,
    libc::SYS_epoll_ctl,
    libc::SYS_epoll_pwait,
    libc::SYS_eventfd2,
    libc::SYS_futex,
    libc::SYS_restart_syscall,
    libc::SYS_sched_yield,
    libc::SYS_timerfd_settime,
    // Reading permitted files, writing to open ones
    libc::SYS_close,
    libc::SYS_fcntl,
    libc::SYS_fstat,
    libc::SYS_fstatfs,
    libc::SYS_getdents64,
    libc::SYS_lseek,
    libc::SYS_newfstatat,
    libc::SYS_read,
    libc::SYS_readlinkat,
    libc::SYS_readv,
    libc::SYS_statfs,
    libc::SYS_statx,
    libc::SYS_write,
    libc::SYS_writev,
    // Memory
    libc::SYS_brk,
    libc::SYS_madvise,
    libc::SYS_mremap,
    libc::SYS_munmap,
    // Threads, signals, time, end of the process
    libc::SYS_clock_gettime,
    libc::SYS_exit,
    libc::SYS_exit_group,
    libc::SYS_getegid,
    libc::SYS_geteuid,
    libc::SYS_getpid,
    libc::SYS_getrandom,
    libc::SYS_gettid,
    libc::SYS_rseq,
    libc::SYS_rt_sigaction,
    libc::SYS_rt_sigprocmask,
    libc::SYS_rt_sigreturn,
    libc::SYS_sched_getaffinity,
    libc::SYS_set_robust_list,
    libc::SYS_sigaltstack,
    // Another filter makes this call fail with ENOSYS, so that the C library uses `clone`
    libc::SYS_clone3,
];

/// Older forms of the calls above. Other processors do not have them.
#[cfg(target_arch = "x86_64")]
const ALLOWED_OLD: &[libc::c_long] =
    &[libc::SYS_epoll_wait, libc::SYS_lstat, libc::SYS_readlink, libc::SYS_stat];
#[cfg(not(target_arch = "x86_64"))]
const ALLOWED_OLD: &[libc::c_long] = &[];

/// The commands of bpf(2) that serve flows in the kernel. Each acts through descriptors that the
/// process has open. Any other command ends the process, as bpf(2) does without such flows.
const KERNEL_FLOW_COMMANDS: [libc::c_int; 3] =
    [BPF_MAP_UPDATE_ELEM, BPF_MAP_DELETE_ELEM, BPF_LINK_CREATE];
/// A flow is opened or renewed.
const BPF_MAP_UPDATE_ELEM: libc::c_int = 2;
/// A flow is closed.
const BPF_MAP_DELETE_ELEM: libc::c_int = 3;
/// An interface has come back.
const BPF_LINK_CREATE: libc::c_int = 28;

/// Calls that end the process. Of bpf(2), [`KERNEL_FLOW_COMMANDS`] may be excepted.
const DEADLY: &[libc::c_long] = &[
    libc::SYS_bpf,
    libc::SYS_execve,
    libc::SYS_execveat,
    libc::SYS_finit_module,
    libc::SYS_init_module,
    libc::SYS_mount,
    libc::SYS_perf_event_open,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_ptrace,
    libc::SYS_setns,
    libc::SYS_unshare,
    libc::SYS_userfaultfd,
];

/// Why there is no filter.
#[derive(Debug, thiserror::Error)]
pub(super) enum Error {
    #[error("not for this processor")]
    Processor,
    #[error(transparent)]
    Filter(#[from] BackendError),
    #[error(transparent)]
    Install(#[from] seccompiler::Error),
}

/// Installs the filters for every thread of the process. With `kernel_flows`, they leave what flows
/// in the kernel need.
pub(super) fn confine(kernel_flows: bool) -> Result<(), Error> {
    // The strictest result of all filters counts. The list of allowed calls comes last, because it
    // blocks the calls that install a filter.
    let refuse = |errno: libc::c_int| SeccompAction::Errno(errno as u32);
    let (allow, kill) = (SeccompAction::Allow, SeccompAction::KillProcess);
    let filters = [
        filter(unconditional(&[libc::SYS_clone3]), allow.clone(), refuse(libc::ENOSYS))?,
        filter(deadly(kernel_flows)?, allow.clone(), kill)?,
        filter(allowed(kernel_flows)?, refuse(libc::EPERM), allow)?,
    ];
    for filter in &filters {
        seccompiler::apply_filter_all_threads(filter)?;
    }
    Ok(())
}

type Rules = BTreeMap<i64, Vec<SeccompRule>>;

fn filter(rules: Rules, others: SeccompAction, these: SeccompAction) -> Result<BpfProgram, Error> {
    let processor = env::consts::ARCH.try_into().map_err(|_| Error::Processor)?;
    Ok(SeccompFilter::new(rules, others, these, processor)?.try_into()?)
}

fn unconditional(calls: &[libc::c_long]) -> Rules {
    calls.iter().map(|&call| (call, Vec::new())).collect()
}

fn deadly(kernel_flows: bool) -> Result<Rules, Error> {
    let mut rules = unconditional(DEADLY);
    if kernel_flows {
        let is_another = KERNEL_FLOW_COMMANDS.map(|command| is_not(0, command));
        let is_another = is_another.into_iter().collect::<Result<Vec<_>, _>>()?;
        rules.insert(libc::SYS_bpf, vec![rule(&is_another)?]);
    }
    Ok(rules)
}

fn allowed(kernel_flows: bool) -> Result<Rules, Error> {
    let mut rules = unconditional(ALLOWED);
    rules.extend(unconditional(ALLOWED_OLD));

    // Files can only be opened for reading. O_ACCMODE is no good for this check, because musl
    // includes O_PATH in it.
    let writing = libc::O_WRONLY | libc::O_RDWR | libc::O_CREAT | libc::O_TRUNC;
    rules.insert(libc::SYS_openat, vec![rule(&[none_of(2, writing)?])?]);
    #[cfg(target_arch = "x86_64")]
    rules.insert(libc::SYS_open, vec![rule(&[none_of(1, writing)?])?]);

    // No memory can become executable.
    let no_code = none_of(2, libc::PROT_EXEC)?;
    rules.insert(libc::SYS_mmap, vec![rule(std::slice::from_ref(&no_code))?]);
    rules.insert(libc::SYS_mprotect, vec![rule(&[no_code])?]);

    // New threads are allowed, new processes are not.
    let thread = libc::CLONE_THREAD;
    rules.insert(libc::SYS_clone, vec![rule(&[masked(0, thread, thread)?])?]);
    rules.insert(libc::SYS_prctl, vec![rule(&[is(0, libc::PR_SET_NAME)?])?]);

    // Allowed sockets: UDP, datagrams to the service manager, and the pair that carries signals to
    // the main thread.
    let kind = libc::SOCK_STREAM | libc::SOCK_DGRAM | libc::SOCK_RAW | libc::SOCK_SEQPACKET;
    let datagrams = |family| rule(&[is(0, family)?, masked(1, kind, libc::SOCK_DGRAM)?]);
    let families = [libc::AF_INET, libc::AF_INET6, libc::AF_UNIX];
    let mut sockets = families.into_iter().map(datagrams).collect::<Result<Vec<_>, _>>()?;
    if kernel_flows {
        // Without a capability, such a socket asks for interfaces and routes and changes nothing.
        let routes = is(2, libc::NETLINK_ROUTE)?;
        sockets.push(rule(&[is(0, libc::AF_NETLINK)?, masked(1, kind, libc::SOCK_RAW)?, routes])?);
        let commands = KERNEL_FLOW_COMMANDS.map(|command| rule(&[is(0, command)?]));
        rules.insert(libc::SYS_bpf, commands.into_iter().collect::<Result<_, _>>()?);
    }
    rules.insert(libc::SYS_socket, sockets);
    rules.insert(libc::SYS_socketpair, vec![rule(&[is(0, libc::AF_UNIX)?])?]);
    rules.insert(libc::SYS_ioctl, vec![rule(&[is(1, libc::FIONBIO as libc::c_int)?])?]);

    // The process may change its own limits, and abort itself after a panic.
    rules.insert(libc::SYS_prlimit64, vec![rule(&[is(0, 0)?])?]);
    let own = is(0, process::id() as libc::c_int)?;
    rules.insert(libc::SYS_tgkill, vec![rule(&[own, is(2, libc::SIGABRT)?])?]);
    rules.insert(libc::SYS_tkill, vec![rule(&[is(1, libc::SIGABRT)?])?]);
    Ok(rules)
}

/// A rule that needs all of these conditions.
fn rule(conditions: &[SeccompCondition]) -> Result<SeccompRule, BackendError> {
    SeccompRule::new(conditions.to_vec())
}

fn is(argument: u8, value: libc::c_int) -> Result<SeccompCondition, BackendError> {
    let value = u64::from(value as u32);
    SeccompCondition::new(argument, SeccompCmpArgLen::Dword, SeccompCmpOp::Eq, value)
}

fn is_not(argument: u8, value: libc::c_int) -> Result<SeccompCondition, BackendError> {
    let value = u64::from(value as u32);
    SeccompCondition::new(argument, SeccompCmpArgLen::Dword, SeccompCmpOp::Ne, value)
}

fn masked(
    argument: u8,
    mask: libc::c_int,
    value: libc::c_int,
) -> Result<SeccompCondition, BackendError> {
    let (mask, value) = (u64::from(mask as u32), u64::from(value as u32));
    SeccompCondition::new(argument, SeccompCmpArgLen::Dword, SeccompCmpOp::MaskedEq(mask), value)
}

fn none_of(argument: u8, flags: libc::c_int) -> Result<SeccompCondition, BackendError> {
    masked(argument, flags, 0)
}
