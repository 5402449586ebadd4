use std::path::PathBuf;

use clap::Parser;

use super::*;

#[derive(Parser)]
struct Init {
    #[command(flatten)]
    args: Args,
}

fn args(options: &[&str]) -> Args {
    Init::try_parse_from(["init"].iter().chain(options)).unwrap().args
}

/// The plan and what was printed, at a terminal where this is typed.
fn typed(options: &[&str], typed: &str) -> (Option<Plan>, String) {
    let mut printed = Vec::new();
    let plan =
        Answers::new(typed.as_bytes(), &mut printed, By::Asking).plan(args(options)).unwrap();
    (plan, String::from_utf8(printed).unwrap())
}

const ALL: [&str; 8] = [
    "--listen",
    "203.0.113.5",
    "--subnet",
    "172.17.17.0",
    "--nodes",
    "1-4,33",
    "--allow",
    "198.51.100.0/24",
];

#[test]
fn options_are_enough_without_a_terminal() {
    let mut answers = Answers::new(&b""[..], Vec::new(), By::Default);
    let plan = answers.plan(args(&ALL)).unwrap().unwrap();
    assert_eq!(plan.nodes.to_string(), "1-4,33");
    assert_eq!((plan.name.to_string().as_str(), answers.missing()), ("section-1", &[][..]));
    assert!(plan.start_port >= 20000);
}

#[test]
fn what_is_missing_without_a_terminal_is_named() {
    let mut answers = Answers::new(&b"yes\n"[..], Vec::new(), By::Default);
    assert!(answers.plan(args(&[])).unwrap().is_none());
    assert_eq!(answers.missing(), ["--listen", "--subnet", "--nodes", "--allow"]);
    assert!(answers.output.is_empty());
}

/// Of what is offered for the host's own side something fits, or else it is missing; for the rest nothing is.
#[test]
fn who_agrees_to_all_that_is_offered_is_not_asked() {
    let mut answers = Answers::new(&b""[..], Vec::new(), By::Consent);
    assert!(answers.plan(args(&[])).unwrap().is_none());
    assert!(answers.missing().ends_with(&["--nodes", "--allow"]), "{:?}", answers.missing());
    let mut answers = Answers::new(&b""[..], Vec::new(), By::Consent);
    let offer = || Offer::Hint("172.17.17.0".to_owned());
    let taken = answers.answer(None, "--subnet", "Subnet", offer, str::parse::<Subnet>).unwrap();
    assert_eq!(taken, Some(Subnet([172, 17, 17, 0].into())));
    assert!(answers.output.is_empty() && answers.missing().is_empty());
}

#[test]
fn a_terminal_is_asked_until_the_answer_can_be_read() {
    let (plan, printed) = typed(
        &["--start-port", "21000"],
        "everywhere\n203.0.113.5\n172.17.17.3\n172.17.17.0/24\n0\n 33, 1-4 4\n\n198.51.100.7 10.0.0.0/8\n\
         none\nline-a\n",
    );
    let plan = plan.unwrap_or_else(|| panic!("{printed}"));
    assert_eq!(plan.listen, ["203.0.113.5".parse::<IpAddr>().unwrap()]);
    assert_eq!(plan.subnet.to_string(), "172.17.17.0");
    assert_eq!(plan.nodes.to_string(), "1-4,33", "each once, in order");
    assert_eq!(
        plan.allow.iter().map(ToString::to_string).collect::<Vec<_>>(),
        ["198.51.100.7/32", "10.0.0.0/8"]
    );
    assert_eq!((plan.start_port, plan.name.to_string().as_str()), (21000, "line-a"));
    for told in ["ends with .0", "node addresses are 1 to 125", "[section-1]", "Enter takes"] {
        assert!(printed.contains(told), "{told}: {printed}");
    }
    assert!(!printed.contains("Start port"), "it was given");
}

#[test]
fn enter_takes_what_is_offered_and_the_end_of_input_takes_nothing() {
    let (plan, _) = typed(&ALL, "\n\n");
    assert_eq!(plan.unwrap().name, Name::default());
    let (plan, printed) = typed(&ALL[..4], "1-4\n");
    assert!(plan.is_none(), "{printed}");
}

#[test]
fn nodes_are_written_as_node_and_request_take_them() {
    let nodes = Nodes::of(&[NodeRange(33..=33), NodeRange(1..=3), NodeRange(3..=4)]);
    assert_eq!(nodes.to_string(), "1-4,33");
    assert_eq!(subnet_of([127, 17, 17, 9].into()).of_nodes(&nodes), "127.17.17.1-4,127.17.17.33");
}

#[test]
fn a_folder_is_no_option() {
    assert_eq!(args(&["plant"]).folder, Some(PathBuf::from("plant")));
    assert!(Init::try_parse_from(["init", "--try", "--subnet", "172.17.17.0"]).is_err());
}
