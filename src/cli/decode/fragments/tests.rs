//! Fragments that fit, and those that somebody made up.

use std::time::UNIX_EPOCH;

use proptest::prelude::*;

use super::*;

/// What was sent, behind its UDP header from port 50000 to 34379.
fn udp(payload: &[u8]) -> Vec<u8> {
    let words = [50000, 34379, 8 + payload.len() as u16, 0].map(u16::to_be_bytes);
    [words.as_flattened(), payload].concat()
}

fn fragment(identification: u32, place: usize, octets: &[u8], more_follow: bool) -> Fragment<'_> {
    let [from, to] = ["198.51.100.20", "203.0.113.5"].map(|text| text.parse().unwrap());
    let offset = IpFragOffset::try_new(place as u16 / 8).unwrap();
    let whole = Identity { from, to, identification };
    Fragment { whole, offset, more_follow, octets, is_complete: true }
}

/// The pieces of a datagram, cut at these places.
fn pieces<'a>(datagram: &'a [u8], cuts: &[usize]) -> Vec<Fragment<'a>> {
    let starts = [0].into_iter().chain(cuts.iter().copied());
    let ends = cuts.iter().copied().chain([datagram.len()]);
    starts
        .zip(ends)
        .map(|(start, end)| fragment(7, start, &datagram[start..end], end < datagram.len()))
        .collect()
}

/// The payload and its number of fragments, once these make it whole.
fn joined(fragments: &mut Fragments, pieces: &[Fragment<'_>]) -> Option<(Vec<u8>, u64)> {
    pieces.iter().zip(1..).find_map(|(piece, packet)| match fragments.add(packet, None, piece) {
        Outcome::Whole(whole) => {
            let udp = whole.udp().unwrap();
            assert_eq!(
                (udp.from.port(), udp.to.port(), udp.length),
                (50000, 34379, udp.octets.len())
            );
            Some((udp.octets.to_vec(), whole.fragments))
        }
        Outcome::Waits => None,
        Outcome::Broken(partial, why) => panic!("{partial:?} {why}"),
    })
}

#[test]
fn fragments_in_any_order_and_twice_make_the_datagram() {
    let payload: Vec<u8> = (0..MAX_DATAGRAM as u8).collect();
    let datagram = udp(&payload);
    let right = Some((payload, 3));
    for order in [[0, 1, 2], [2, 1, 0], [1, 0, 2], [1, 2, 0]] {
        let mut fragments = Fragments::default();
        let pieces = || pieces(&datagram, &[16, 64]);
        let shuffled: Vec<_> = order.into_iter().map(|at| pieces().swap_remove(at)).collect();
        assert_eq!(joined(&mut fragments, &shuffled), right, "{order:?}");
        assert!(fragments.0.is_empty());
        let twice: Vec<_> =
            order.into_iter().flat_map(|at| [at, at]).map(|at| pieces().swap_remove(at)).collect();
        assert_eq!(joined(&mut fragments, &twice), right, "{order:?}");
    }
}

#[test]
fn what_contradicts_itself_is_no_datagram() {
    let (datagram, other) = (udp(&[1; 90]), udp(&[2; 90]));
    let cases = [
        // The same place with other octets.
        vec![fragment(7, 16, &datagram[16..32], true), fragment(7, 24, &other[24..40], true)],
        // Overlapping, although with the same octets.
        vec![fragment(7, 16, &datagram[16..32], true), fragment(7, 24, &datagram[24..40], true)],
        // Two ends, or something behind the end.
        vec![fragment(7, 40, &datagram[40..50], false), fragment(7, 56, &datagram[56..60], false)],
        vec![fragment(7, 40, &datagram[40..50], false), fragment(7, 56, &datagram[56..64], true)],
        vec![fragment(7, 56, &datagram[56..64], true), fragment(7, 40, &datagram[40..50], false)],
        // A length that is no multiple of eight, and not the last.
        vec![fragment(7, 16, &datagram[16..31], true)],
    ];
    for case in cases {
        let mut fragments = Fragments::default();
        let outcomes: Vec<_> = case.iter().map(|each| fragments.add(1, None, each)).collect();
        let broken = matches!(outcomes.last(), Some(Outcome::Broken(_, Broken::Contradictory)));
        assert!(broken, "{outcomes:?}");
        assert!(fragments.0.is_empty());
    }
}

#[test]
fn a_larger_datagram_is_told_by_its_first_fragment_and_not_kept() {
    let datagram = udp(&[3; 1600]);
    let mut fragments = Fragments::default();
    for place in [1480, 120, 112] {
        let part = fragment(7, place, &datagram[place..place + 16], true);
        assert!(matches!(fragments.add(1, None, &part), Outcome::Waits));
    }
    assert!(fragments.0.is_empty());
    match fragments.add(2, None, &fragment(7, 0, &datagram[..1480], true)) {
        Outcome::Broken(partial, Broken::TooLong) => {
            let head = partial.head.unwrap();
            assert_eq!((head.length, head.captured, head.to.port()), (1600, 1472, 34379));
        }
        other => panic!("{other:?}"),
    }
    assert!(fragments.0.is_empty());
}

#[test]
fn a_fragment_that_was_captured_in_part_breaks_its_datagram() {
    let datagram = udp(&[4; 90]);
    let mut first = fragment(7, 0, &datagram[..16], true);
    first.is_complete = false;
    let outcome = Fragments::default().add(1, None, &first);
    assert!(matches!(outcome, Outcome::Broken(_, Broken::Missing)), "{outcome:?}");
}

#[test]
fn datagrams_do_not_wait_for_ever_and_not_without_number() {
    let datagram = udp(&[5; 90]);
    let mut fragments = Fragments::default();
    let at = |seconds| Some(UNIX_EPOCH + Duration::from_secs(seconds));
    for number in 0..1000 {
        let evicted = fragments.overdue(at(10));
        assert_eq!(evicted.is_some(), number >= MOST as u32);
        fragments.add(number.into(), at(10), &fragment(number, 0, &datagram[..16], true));
        assert!(fragments.0.len() <= MOST);
    }
    assert!(fragments.overdue(at(40)).is_some(), "there is no room");
    assert!(fragments.overdue(at(40)).is_none());
    assert!(fragments.overdue(at(9)).is_none());
    let oldest = fragments.overdue(at(41)).unwrap();
    assert_eq!((oldest.packet, oldest.time), (1000 - MOST as u64 + 1, at(10)));
    assert!(oldest.head.is_some());
}

proptest! {
    #[test]
    fn whatever_comes_memory_has_its_bound(
        parts in prop::collection::vec(
            (0_u32..3, 0_u16..20, prop::collection::vec(any::<u8>(), 0..150), any::<[bool; 2]>()),
            0..60,
        )
    ) {
        let mut fragments = Fragments::default();
        for (identification, place, octets, [more, is_complete]) in parts {
            let mut part = fragment(identification, usize::from(place) * 8, &octets, more);
            part.is_complete = is_complete;
            if let Outcome::Whole(whole) = fragments.add(1, None, &part) {
                let _ = whole.udp();
            }
            prop_assert!(fragments.0.len() <= 3);
            prop_assert!(fragments.0.iter().all(|partial| partial.buffer.data().len() <= LARGEST));
        }
    }
}
