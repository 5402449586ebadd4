//! seccomp: restricts the process to the system calls of a relay.
//!
//! The list holds the calls that were observed in the relay, with glibc and with musl: at the
//! start, under traffic and floods, while somebody watches it, and at its end. It also holds the
//! calls that the C libraries use instead on other kernels. Any other call fails with EPERM, and
//! its caller reports the error: a new C library that tries a new call must not stop a plant. Calls
//! that no relay ever makes, but an intruder does, end the process at once, and the kernel's log
//! says so.

mod filter;
mod processor;

use std::process;

use self::filter::{Action, Rules, any_arguments, is, is_not, masked, none_of, program};

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
    #[cfg(not(all(target_arch = "arm", target_env = "musl")))] // which makes no such call
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
    Install(#[from] seccompiler::Error),
}

/// Installs the filters for every thread of the process. With `kernel_flows`, they leave what flows
/// in the kernel need.
pub(super) fn confine(kernel_flows: bool) -> Result<(), Error> {
    let processor = processor::NUMBER.ok_or(Error::Processor)?;
    // The strictest result of all filters counts. The list of allowed calls comes last, because it
    // blocks the calls that install a filter.
    let no_clone3 = any_arguments(&[libc::SYS_clone3]).collect();
    for (rules, meant, others) in [
        (no_clone3, Action::Refuse(libc::ENOSYS), Action::Allow),
        (deadly(kernel_flows), Action::KillProcess, Action::Allow),
        (allowed(kernel_flows), Action::Allow, Action::Refuse(libc::EPERM)),
    ] {
        seccompiler::apply_filter_all_threads(&program(processor, &rules, meant, others))?;
    }
    Ok(())
}

fn deadly(kernel_flows: bool) -> Rules {
    let mut rules: Rules = any_arguments(DEADLY).collect();
    if kernel_flows {
        let another = KERNEL_FLOW_COMMANDS.map(|command| is_not(0, command));
        rules.insert(libc::SYS_bpf, vec![another.to_vec()]);
    }
    rules
}

fn allowed(kernel_flows: bool) -> Rules {
    let mut rules: Rules =
        any_arguments(ALLOWED).chain(any_arguments(processor::ALLOWED)).collect();

    // Files can only be opened for reading. O_ACCMODE is no good for this check, because musl
    // includes O_PATH in it.
    let writing = libc::O_WRONLY | libc::O_RDWR | libc::O_CREAT | libc::O_TRUNC;
    rules.insert(libc::SYS_openat, vec![vec![none_of(2, writing)]]);
    if let Some(open) = processor::OPEN {
        rules.insert(open, vec![vec![none_of(1, writing)]]);
    }

    // No memory can become executable.
    for call in [processor::MMAP, libc::SYS_mprotect] {
        rules.insert(call, vec![vec![none_of(2, libc::PROT_EXEC)]]);
    }

    // New threads are allowed, new processes are not.
    let thread = libc::CLONE_THREAD;
    rules.insert(libc::SYS_clone, vec![vec![masked(0, thread, thread)]]);
    rules.insert(libc::SYS_prctl, vec![vec![is(0, libc::PR_SET_NAME)]]);

    // Allowed sockets: UDP, datagrams to the service manager, and the pair that carries signals to
    // the main thread.
    let kind = libc::SOCK_STREAM | libc::SOCK_DGRAM | libc::SOCK_RAW | libc::SOCK_SEQPACKET;
    let families = [libc::AF_INET, libc::AF_INET6, libc::AF_UNIX];
    let datagrams = |family| vec![is(0, family), masked(1, kind, libc::SOCK_DGRAM)];
    let mut sockets = families.map(datagrams).to_vec();
    if kernel_flows {
        // Without a capability, such a socket asks for interfaces and routes and changes nothing.
        let routes = is(2, libc::NETLINK_ROUTE);
        sockets.push(vec![is(0, libc::AF_NETLINK), masked(1, kind, libc::SOCK_RAW), routes]);
        let commands = KERNEL_FLOW_COMMANDS.map(|command| vec![is(0, command)]);
        rules.insert(libc::SYS_bpf, commands.to_vec());
    }
    rules.insert(libc::SYS_socket, sockets);
    rules.insert(libc::SYS_socketpair, vec![vec![is(0, libc::AF_UNIX)]]);
    rules.insert(libc::SYS_ioctl, vec![vec![is(1, libc::FIONBIO as libc::c_int)]]);

    // The process may change its own limits, and abort itself after a panic.
    rules.insert(libc::SYS_prlimit64, vec![vec![is(0, 0)]]);
    let own = is(0, process::id() as libc::c_int);
    rules.insert(libc::SYS_tgkill, vec![vec![own, is(2, libc::SIGABRT)]]);
    rules.insert(libc::SYS_tkill, vec![vec![is(1, libc::SIGABRT)]]);
    rules
}
