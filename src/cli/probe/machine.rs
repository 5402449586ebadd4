//! The checks of the machine: file descriptors, receive buffers, the clock.

use std::time::{Duration, SystemTime};

use crate::probe::Check;

/// What these checks are of.
const ROUTER: &str = "this router";
/// No clock that is right shows an earlier time: 2026-01-01.
const EARLIEST: Duration = Duration::from_secs(1_767_225_600);

/// Whether the relay may open as many descriptors as it needs. `limits` is the text of the process's limits
/// in /proc; without a relay, those of this process.
pub(super) fn descriptors(needed: usize, limits: Option<&str>, is_of_relay: bool) -> Check {
    const CHECK: &str = "descriptors";
    let line =
        limits.and_then(|text| text.lines().find_map(|line| line.strip_prefix("Max open files")));
    let hard = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<usize>().ok());
    let Some(hard) = hard else {
        return Check::unknown(CHECK, ROUTER, format!("needs {needed}; the limit cannot be read"));
    };
    let whose = if is_of_relay { "the relay" } else { "a process started here" };
    let text = format!("{whose} may open {hard}, and {needed} are needed");
    if hard >= needed {
        return Check::good(CHECK, ROUTER, text);
    }
    let check = if is_of_relay { Check::bad } else { Check::doubtful };
    check(CHECK, ROUTER, text)
        .remedy("raise the hard limit: LimitNOFILE= in the unit, `ulimit -Hn` in a shell")
}

/// Whether sockets get the receive buffer that is configured.
pub(super) fn receive_buffer(wanted: usize, most: Option<u64>) -> Check {
    const CHECK: &str = "buffers";
    match most {
        None => Check::unknown(CHECK, ROUTER, "net.core.rmem_max cannot be read"),
        Some(most) if most >= wanted as u64 => Check::good(
            CHECK,
            ROUTER,
            format!("sockets get the {wanted} octets of `receive_buffer`"),
        ),
        Some(most) => {
            let text = format!("sockets get {most} octets, not the {wanted} of `receive_buffer`");
            Check::doubtful(CHECK, ROUTER, text)
                .remedy(format!("sysctl net.core.rmem_max={wanted}"))
        }
    }
}

/// Whether the clock can be right. `synchronised` is what timedatectl printed.
pub(super) fn clock(now: SystemTime, synchronised: Option<&str>) -> Check {
    const CHECK: &str = "clock";
    let remedy = "set it, and start a time service: timedatectl set-ntp true";
    if now < SystemTime::UNIX_EPOCH + EARLIEST {
        let text = "it shows a time before this program was made: log and events are dated wrong";
        return Check::bad(CHECK, ROUTER, text).remedy(remedy);
    }
    match synchronised.map(str::trim) {
        Some("yes") => Check::good(CHECK, ROUTER, "it is synchronised"),
        Some("no") => {
            Check::doubtful(CHECK, ROUTER, "it is not synchronised: times in the log may be off")
                .remedy(remedy)
        }
        _ => Check::unknown(CHECK, ROUTER, "timedatectl does not tell whether it is synchronised"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::Verdict;

    #[test]
    fn descriptors_are_compared_with_the_need() {
        let limits = "Limit                     Soft Limit           Hard Limit           Units\n\
                      Max open files            1024                 4096                 files\n";
        assert_eq!(descriptors(4096, Some(limits), true).verdict, Verdict::Good);
        assert_eq!(descriptors(4097, Some(limits), true).verdict, Verdict::Bad);
        assert_eq!(descriptors(4097, Some(limits), false).verdict, Verdict::Doubtful);
        assert_eq!(descriptors(1, Some("odd"), true).verdict, Verdict::Unknown);
        assert_eq!(descriptors(1, None, true).verdict, Verdict::Unknown);
    }

    #[test]
    fn a_short_buffer_is_told_with_both_figures() {
        assert_eq!(receive_buffer(1 << 20, Some(1 << 20)).verdict, Verdict::Good);
        assert_eq!(receive_buffer(1 << 20, None).verdict, Verdict::Unknown);
        let check = receive_buffer(1 << 20, Some(212_992));
        assert_eq!(check.verdict, Verdict::Doubtful);
        assert_eq!(check.remedy.as_deref(), Some("sysctl net.core.rmem_max=1048576"));
    }

    #[test]
    fn a_clock_that_begins_at_1970_is_bad() {
        let now = SystemTime::UNIX_EPOCH + EARLIEST;
        assert_eq!(clock(SystemTime::UNIX_EPOCH, Some("yes")).verdict, Verdict::Bad);
        assert_eq!(clock(now, Some("yes\n")).verdict, Verdict::Good);
        assert_eq!(clock(now, Some("no\n")).verdict, Verdict::Doubtful);
        assert_eq!(clock(now, None).verdict, Verdict::Unknown);
    }
}
