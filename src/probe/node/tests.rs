use super::*;
use crate::config::fixture::{NODE_1, config};
use crate::probe::Verdict;

const SILENT: Outcome = Outcome::Lost(Loss::NoAnswer { waited: Duration::from_secs(1), sent: 1 });

fn asked() -> Asked {
    let config = config();
    Asked::of(&config, &config.table.mapping(NODE_1))
}

fn there() -> Neighbour {
    Neighbour::Answers { hardware: "02:00:00:00:00:01".into(), interface: "plant0".into() }
}

/// The verdicts and texts of what was seen with these passwords.
fn told(
    with: &[Outcome],
    without: Option<Outcome>,
    neighbour: Neighbour,
) -> Vec<(Verdict, String)> {
    let names = ["service", "team-b"].map(str::to_owned);
    let with = names.into_iter().zip(with.iter().cloned()).collect();
    let checks = asked().judge(Some(&Seen { with, without, neighbour }));
    assert!(checks.iter().all(|check| check.subject == "node 1 of section-1"));
    checks.into_iter().map(|check| (check.verdict, check.text)).collect()
}

#[test]
fn a_node_that_answers_has_one_line() {
    let fast = Outcome::Answered(Duration::from_micros(1234));
    assert_eq!(
        told(&[fast.clone(), fast.clone()], None, there()),
        [(Verdict::Good, "answers in 1.2 ms, to each of 2 passwords".into())]
    );
    assert_eq!(
        told(std::slice::from_ref(&fast), None, Neighbour::Unlisted),
        [(Verdict::Good, "answers in 1.2 ms".into())]
    );
    assert_eq!(
        told(&[fast, SILENT], None, there()),
        [(Verdict::Doubtful, "answers in 1.2 ms, but not to the password of \"team-b\"".into())]
    );
}

#[test]
fn each_silence_has_its_own_cause() {
    let lost = Outcome::Lost;
    let undelivered = |why| lost(Loss::Undelivered(why));
    let answered = Outcome::Answered(Duration::from_millis(1));
    for (with, without, neighbour, verdict, part) in [
        (
            undelivered(Undelivered::NothingListens),
            None,
            there(),
            Verdict::Bad,
            "port 34379 is closed",
        ),
        (undelivered(Undelivered::Forbidden), None, there(), Verdict::Bad, "a firewall forbids"),
        (
            undelivered(Undelivered::NetworkUnreachable),
            None,
            there(),
            Verdict::Bad,
            "network unreachable",
        ),
        (SILENT, None, Neighbour::Silent, Verdict::Bad, "nobody is at its address"),
        (
            SILENT,
            Some(SILENT),
            there(),
            Verdict::Doubtful,
            "there, but silent: the password or the port",
        ),
        (SILENT, Some(answered), there(), Verdict::Bad, "answers only without a password"),
        (SILENT, Some(SILENT), Neighbour::Unlisted, Verdict::Bad, "no ARP table tells"),
        (lost(Loss::WrongPassword), None, there(), Verdict::Bad, "another password"),
        (
            lost(Loss::OtherPort(([172, 17, 17, 1], 34378).into())),
            None,
            there(),
            Verdict::Bad,
            "answers from 172.17.17.1:34378, not from 172.17.17.1:34379",
        ),
        (Outcome::Failed("no descriptor".into()), None, there(), Verdict::Bad, "no descriptor"),
    ] {
        let checks = told(&[with], without, neighbour);
        let (found, text) = checks.last().unwrap();
        assert_eq!(*found, verdict, "{text}");
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn who_does_not_answer_arp_is_told_of() {
    let checks = told(&[SILENT], None, Neighbour::Silent);
    assert_eq!(checks[0], (Verdict::Bad, "172.17.17.1 does not answer ARP".into()));
    let checks = told(&[SILENT, SILENT], Some(SILENT), there());
    assert_eq!(checks[0].0, Verdict::Good);
    assert_eq!(checks.len(), 2);
}

#[test]
fn a_profinet_device_is_asked_by_another_command() {
    let checks = asked().judge(None);
    assert_eq!(checks[0].verdict, Verdict::Unknown);
    assert_eq!(checks[0].remedy.as_deref(), Some("ask it: pnet-nat inventory 172.17.17.1"));
}
