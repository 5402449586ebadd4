//! `/api/v1/drop-reasons`: what each reason means, and what to do.

use std::collections::BTreeMap;

use axum::Json;
use axum::response::{IntoResponse, Response};

use crate::nat::Direction;

/// What the kernel drops before the relay sees it, by the causes of
/// [`KernelDrops`](crate::datapath::KernelDrops), with the names of the status page.
const KERNEL_DROPS: [(&str, &str); 4] = [
    (
        "kernel: overflow",
        "Lost before the relay saw it: the receive buffer of a public port was full. Raise \
         `receive_buffer` and sysctl net.core.rmem_max, add workers.",
    ),
    (
        "kernel: prefilter",
        "Dropped by the kernel because of length, header or password, while a public port was \
         flooded, or at any time with `prefilter = \"always\"`.",
    ),
    (
        "kernel: upstream overflow",
        "Answers of servers, lost before the relay saw them: the receive buffer of a socket \
         towards the plant was full. Raise `receive_buffer` and sysctl net.core.rmem_max, add workers.",
    ),
    (
        "kernel: upstream prefilter",
        "Dropped by the kernel on a socket towards the plant, while it was flooded by senders that \
         are not servers of the table. Find out who sends there; a firewall can keep them out.",
    ),
];

/// `GET /api/v1/drop-reasons`
pub(in crate::admin) async fn drop_reasons() -> Response {
    let reasons = Direction::ALL.iter().flat_map(|direction| direction.drop_reasons());
    let reasons = reasons.map(|reason| (reason.label(), reason.explanation()));
    let reasons = reasons.chain(KERNEL_DROPS);
    Json(reasons.collect::<BTreeMap<_, _>>()).into_response()
}
