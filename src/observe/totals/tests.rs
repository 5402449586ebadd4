use super::*;
use crate::nat::Writer;

const SECOND: u64 = 1_000_000_000;

/// The presence that follows from the counters of two workers. Each has the times of the last
/// request, the last response and the first unanswered request, in seconds.
fn presence_at(now: u64, workers: [[u64; 3]; 2]) -> Presence {
    let nodes = workers.map(|[request, response, since]| {
        let (node, writer) = (NodeCounters::default(), Writer::of_worker());
        node.last_request.set(&writer, request * SECOND);
        node.last_response.set(&writer, response * SECOND);
        node.unanswered_since.set(&writer, since * SECOND);
        node
    });
    NodeTotals::sum(nodes.iter()).presence(Duration::from_secs(now))
}

#[test]
fn a_node_is_silent_when_it_keeps_everybody_waiting() {
    use Presence::{Answering, NeverAsked, Silent};
    const IDLE: [u64; 3] = [0; 3];
    for (now, workers, expected) in [
        (99, [IDLE, IDLE], NeverAsked),
        (12, [[10, 0, 10], IDLE], NeverAsked), // it has some time for its first answer
        (16, [[10, 0, 10], IDLE], Silent),
        (99, [[10, 11, 0], IDLE], Answering),  // nobody asks
        (99, [[98, 50, 98], IDLE], Answering), // asked again after a pause
        (99, [[98, 50, 51], IDLE], Silent),
        (99, [[10, 0, 10], [97, 98, 0]], Answering), // one request was lost
        (99, [[98, 0, 10], [97, 97, 0]], Answering), // it answers others
        (99, [[98, 0, 10], [90, 91, 0]], Silent),
    ] {
        assert_eq!(presence_at(now, workers), expected, "{now}: {workers:?}");
    }
}

/// Median and 99 % quantile of nodes with these response times and numbers of answers.
fn quantiles(workers: &[&[(u64, u32)]]) -> [Option<Duration>; 2] {
    let nodes = workers.iter().map(|times| {
        let (node, writer) = (NodeCounters::default(), Writer::of_worker());
        for &(micros, answers) in *times {
            (0..answers)
                .for_each(|_| node.response_times.observe(&writer, Duration::from_micros(micros)));
        }
        node
    });
    let times = NodeTotals::sum(nodes.collect::<Vec<_>>().iter()).response_times;
    [0.5, 0.99].map(|share| times.quantile(share))
}

#[test]
fn quantiles_are_true_to_their_two_digits() {
    assert_eq!(quantiles(&[&[]]), [None; 2]);
    for (micros, shown) in [
        (3, 3),
        (53, 53),
        (5_240, 5_200),
        (7_490, 7_500),
        (9_960, 10_000),
        (26_500, 27_000),
        (199_000, 200_000),
        (3_140_000, 3_100_000),
        (62_000_000, 62_000_000),
    ] {
        let shown = [Some(Duration::from_micros(shown)); 2];
        assert_eq!(quantiles(&[&[(micros, 7)]]), shown, "{micros} µs");
        assert_eq!(quantiles(&[&[(micros, 3)], &[(micros, 90)]]), shown, "{micros} µs");
    }
    let [median, p99] = quantiles(&[&[(5_240, 60)], &[(26_500, 30), (820_000, 10)]]);
    assert_eq!(median, Some(Duration::from_micros(5_200)));
    assert_eq!(p99, Some(Duration::from_micros(820_000)));
}
