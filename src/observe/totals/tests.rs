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
    NodeTotals::sum(nodes.iter()).contact.presence(Duration::from_secs(now))
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
        (53, 53),
        (5_240, 5_200),
        (7_490, 7_500),
        (9_960, 10_000),
        (26_510, 27_000),
        (199_000, 200_000),
        (3_140_000, 3_100_000),
        (62_000_000, 10_000_000),
    ] {
        let shown = [Some(Duration::from_micros(shown)); 2];
        assert_eq!(quantiles(&[&[(micros, 7)]]), shown, "{micros} µs");
        assert_eq!(quantiles(&[&[(micros, 3)], &[(micros, 90)]]), shown, "{micros} µs");
    }
    let [median, p99] = quantiles(&[&[(5_240, 60)], &[(26_500, 30), (820_000, 10)]]);
    assert_eq!(median, Some(Duration::from_micros(5_200)));
    assert_eq!(p99, Some(Duration::from_micros(820_000)));
}

/// Even, exponential and log-normal times of one node, and all of them together.
#[test]
fn the_error_of_a_quantile_is_under_5_percent() {
    let mut random = 7_u64;
    let mut uniform = || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        ((random >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    };
    let mut nodes: Vec<Vec<u64>> = Vec::new();
    for scale in [120e3, 1.02e6, 5.24e6, 26.5e6, 0.4e9] {
        nodes.push((0..3000).map(|_| (scale * (1.0 + uniform())) as u64).collect());
        nodes.push((0..3000).map(|_| (scale * (1.0 - uniform().ln())) as u64).collect());
        let normal =
            |(a, b): (f64, f64)| (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos();
        nodes.push(
            (0..3000)
                .map(|_| (scale * (0.3 * normal((uniform(), uniform()))).exp()) as u64)
                .collect(),
        );
    }
    nodes.push(nodes.concat());
    for mut node in nodes {
        let (times, writer) = (NodeCounters::default(), Writer::of_worker());
        for &nanos in &node {
            times.response_times.observe(&writer, Duration::from_nanos(nanos));
        }
        let totals = NodeTotals::sum([&times].into_iter()).response_times;
        node.sort_unstable();
        for share in [0.01, 0.25, 0.5, 0.75, 0.9, 0.99, 0.999] {
            let exact = node[(share * node.len() as f64).ceil() as usize - 1] as f64;
            let read = totals.quantile(share).unwrap().as_nanos() as f64;
            let error = (read / exact - 1.0).abs();
            assert!(error < 0.05, "{share}: {read} for {exact}");
        }
    }
}

#[test]
fn times_of_a_while_are_a_difference() {
    let mut earlier = ResponseTotals::default();
    earlier.observe(Duration::from_millis(3));
    let mut later = earlier.clone();
    later.observe(Duration::from_millis(7));
    let between = later.since(&earlier);
    assert_eq!((between.count(), between.sum()), (1, Duration::from_millis(7)));
    assert_eq!(between.quantile(0.5), Some(Duration::from_millis(7)));
    assert_eq!(ResponseTotals::default().since(&later).count(), 0, "never less than none");
}
