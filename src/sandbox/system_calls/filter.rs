//! Translates rules about system calls into the program that the kernel runs before each call.

use std::collections::BTreeMap;

use libc::{
    BPF_ABS, BPF_ALU, BPF_AND, BPF_JEQ, BPF_JMP, BPF_K, BPF_LD, BPF_RET, BPF_W, c_int, c_long,
};
use seccompiler::{BpfProgram, sock_filter};

/// What the kernel does about a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    Allow,
    /// The call fails with this error.
    Refuse(c_int),
    KillProcess,
}

impl Action {
    fn value(self) -> u32 {
        match self {
            Self::Allow => libc::SECCOMP_RET_ALLOW,
            Self::Refuse(errno) => libc::SECCOMP_RET_ERRNO | errno as u32,
            Self::KillProcess => libc::SECCOMP_RET_KILL_PROCESS,
        }
    }
}

/// What the lower 32 bits of an argument have to be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Condition {
    argument: u8,
    mask: u32,
    value: u32,
    is_equal: bool,
}

/// The argument has this value.
pub(super) fn is(argument: u8, value: c_int) -> Condition {
    masked(argument, -1, value)
}

/// The argument has another value than this.
pub(super) fn is_not(argument: u8, value: c_int) -> Condition {
    Condition { is_equal: false, ..is(argument, value) }
}

/// The bits of this mask have this value in the argument.
pub(super) fn masked(argument: u8, mask: c_int, value: c_int) -> Condition {
    Condition { argument, mask: mask as u32, value: value as u32, is_equal: true }
}

/// None of these flags is set in the argument.
pub(super) fn none_of(argument: u8, flags: c_int) -> Condition {
    masked(argument, flags, 0)
}

/// A rule holds if all of its conditions do.
pub(super) type Rule = Vec<Condition>;

/// Calls, each with its rules. A call is meant if one of its rules holds, or if it has none.
pub(super) type Rules = BTreeMap<c_long, Vec<Rule>>;

/// Rules that mean these calls with any arguments.
pub(super) fn any_arguments(calls: &[c_long]) -> impl Iterator<Item = (c_long, Vec<Rule>)> {
    calls.iter().map(|&call| (call, Vec::new()))
}

// Places in `struct seccomp_data` of linux/seccomp.h. Arguments have 64 bits, little-endian.
const NUMBER: u32 = 0;
const PROCESSOR: u32 = 4;
const ARGUMENTS: u32 = 16;

/// The program that takes one action for the calls that are meant, and another for all others. It
/// ends a process that makes calls of another processor than this one: they have other numbers.
pub(super) fn program(processor: u32, rules: &Rules, meant: Action, others: Action) -> BpfProgram {
    let mut program =
        vec![load(PROCESSOR), compare(processor, 1, 0), end(Action::KillProcess), load(NUMBER)];
    for (&call, rules) in rules {
        let mut steps: BpfProgram = rules.iter().flat_map(|rule| steps(rule, meant)).collect();
        steps.push(end(if rules.is_empty() { meant } else { others }));
        program.push(compare(call as u32, 0, steps.len()));
        program.extend(steps);
    }
    program.push(end(others));
    program
}

/// The steps that act if a rule holds, and else go on behind them.
fn steps(rule: &Rule, meant: Action) -> BpfProgram {
    const STEPS: usize = 3; // of a condition
    let steps = rule.iter().enumerate().flat_map(|(place, condition)| {
        let fails = (rule.len() - place - 1) * STEPS + 1;
        let (equal, other) = if condition.is_equal { (0, fails) } else { (fails, 0) };
        let argument = ARGUMENTS + 8 * u32::from(condition.argument);
        let steps: [_; STEPS] = [
            load(argument),
            step(BPF_ALU | BPF_AND | BPF_K, condition.mask),
            compare(condition.value, equal, other),
        ];
        steps
    });
    steps.chain([end(meant)]).collect()
}

fn step(code: u32, k: u32) -> sock_filter {
    sock_filter { code: code as u16, jt: 0, jf: 0, k }
}

fn load(place: u32) -> sock_filter {
    step(BPF_LD | BPF_W | BPF_ABS, place)
}

fn end(action: Action) -> sock_filter {
    step(BPF_RET | BPF_K, action.value())
}

/// Goes on over this number of steps, where the loaded value is equal to this one and where it is not.
fn compare(value: u32, equal: usize, other: usize) -> sock_filter {
    let [jt, jf] = [equal, other].map(|steps| u8::try_from(steps).expect("few rules for a call"));
    sock_filter { jt, jf, ..step(BPF_JMP | BPF_JEQ | BPF_K, value) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PROCESSOR: u32 = 0xc000_00b7;
    const NOWHERE: i64 = 0x1234_5678 << 32; // upper halves do not count

    /// What the kernel makes of a call: the program, carried out step by step.
    fn outcome(program: &[sock_filter], processor: u32, call: u32, arguments: &[i64]) -> u32 {
        let mut data = [call, processor].map(u32::to_le_bytes).concat();
        data.extend([0; 8]); // where the call was made
        data.extend(arguments.iter().flat_map(|argument| argument.to_le_bytes()));
        data.resize(64, 0);
        let (mut at, mut accumulator) = (0, 0);
        loop {
            let step = &program[at];
            at += 1;
            let jump = |is_taken| usize::from(if is_taken { step.jt } else { step.jf });
            match u32::from(step.code) {
                code if code == BPF_LD | BPF_W | BPF_ABS => {
                    let octets = &data[step.k as usize..][..4];
                    accumulator = u32::from_le_bytes(octets.try_into().unwrap());
                }
                code if code == BPF_ALU | BPF_AND | BPF_K => accumulator &= step.k,
                code if code == BPF_JMP | BPF_JEQ | BPF_K => at += jump(accumulator == step.k),
                code if code == BPF_RET | BPF_K => return step.k,
                code => panic!("{code}"),
            }
        }
    }

    #[test]
    fn a_call_is_meant_if_one_of_its_rules_holds() {
        let mut rules: Rules = any_arguments(&[7, 9]).collect();
        rules.insert(8, vec![vec![is(0, 3), masked(1, 0xf, 2)], vec![is_not(2, -1)]]);
        let program = program(PROCESSOR, &rules, Action::Allow, Action::Refuse(libc::EPERM));
        let is_allowed = |call, arguments: &[i64]| {
            let outcome = outcome(&program, PROCESSOR, call, arguments);
            assert!(
                [Action::Allow, Action::Refuse(libc::EPERM)].map(Action::value).contains(&outcome)
            );
            outcome == Action::Allow.value()
        };
        for call in [7, 9] {
            assert!(is_allowed(call, &[1, 2, 3]));
        }
        for call in [0, 6, 10, 7 + 0x4000_0000] {
            assert!(!is_allowed(call, &[3, 2, 0]), "{call}");
        }
        let no = i64::from(u32::MAX);
        for (arguments, expected) in [
            ([3, 0x12, no], true),
            ([NOWHERE | 3, NOWHERE | 2, NOWHERE | no], true),
            ([3, 3, no], false),
            ([4, 2, no], false),
            ([4, 2, 0], true),
            ([4, 2, NOWHERE | no], false),
        ] {
            assert_eq!(is_allowed(8, &arguments), expected, "{arguments:x?}");
        }
    }

    #[test]
    fn calls_of_another_processor_end_the_process() {
        let rules = any_arguments(&[7]).collect();
        let program = program(PROCESSOR, &rules, Action::Allow, Action::Refuse(libc::EPERM));
        let outcome = outcome(&program, PROCESSOR + 1, 7, &[]);
        assert_eq!(outcome, libc::SECCOMP_RET_KILL_PROCESS);
    }
}
