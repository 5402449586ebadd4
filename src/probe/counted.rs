//! What a running relay has counted of a node: whether it answers clients, and why their requests are
//! refused.

use std::collections::BTreeMap;

use strum::VariantArray;

use super::Check;
use crate::nat::DropReason;

/// The name of these checks.
const CHECK: &str = "clients";

/// The relay's figures of one node since its start.
#[derive(Clone, Debug, Default)]
pub struct Counted {
    /// Whether the node has answered nobody who asked it last.
    pub is_silent: bool,
    /// Seconds since its last answer; none: it has not answered yet.
    pub last_answer_seconds: Option<f64>,
    /// Dropped datagrams of both directions, by the label of their reason.
    pub dropped: BTreeMap<String, u64>,
}

impl Counted {
    /// The checks of these figures: one where requests or answers were dropped, one where the node is
    /// silent.
    pub fn judge(&self, subject: &str) -> Vec<Check> {
        let mut checks = Vec::new();
        if self.is_silent {
            let text = match self.last_answer_seconds {
                Some(seconds) => format!("the last answer to a client was {seconds:.0} s ago"),
                None => "no client has had an answer since the relay started".to_owned(),
            };
            checks.push(Check::doubtful(CHECK, subject, text));
        }
        let count = |reason: &DropReason| (self.dropped.get(reason.label()).copied(), *reason);
        let counts = DropReason::VARIANTS.iter().map(count);
        let mut counts: Vec<(u64, DropReason)> = counts
            .filter_map(|(count, reason)| Some((count.filter(|&n| n > 0)?, reason)))
            .collect();
        counts.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
        if let Some((_, most)) = counts.first() {
            let item = |&(count, reason): &(u64, DropReason)| {
                format!("{} ({})", reason.counted(count), reason.label())
            };
            let items: Vec<_> = counts.iter().map(item).collect();
            let text = format!("dropped since the relay started: {}", items.join(", "));
            checks.push(Check::doubtful(CHECK, subject, text).remedy(most.explanation()));
        }
        checks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_frequent_reason_has_the_remedy() {
        let dropped = [("source_not_allowed", 2), ("password_wrong", 37), ("none_such", 9)];
        let dropped = dropped.map(|(reason, count)| (reason.to_owned(), count)).into();
        let checks = Counted { dropped, ..Counted::default() }.judge("node 3 of section-1");
        assert_eq!(checks.len(), 1);
        assert_eq!(
            checks[0].text,
            "dropped since the relay started: 37 wrong passwords (password_wrong), \
             2 requests not allowed (source_not_allowed)"
        );
        assert_eq!(checks[0].remedy.as_deref(), Some(DropReason::PasswordWrong.explanation()));
    }

    #[test]
    fn a_node_without_clients_has_nothing_to_say() {
        assert_eq!(Counted::default().judge("node 3 of section-1"), []);
        let silent =
            Counted { is_silent: true, last_answer_seconds: Some(71.6), ..Counted::default() };
        assert_eq!(silent.judge("node 3")[0].text, "the last answer to a client was 72 s ago");
    }
}
