//! `/api/v1/drop-reasons`: what each reason means, and what to do.

use std::collections::BTreeMap;

use axum::Json;
use axum::response::{IntoResponse, Response};

use crate::nat::Direction;

/// What the kernel drops before the relay sees it, as the status page names it, in plain words:
/// by the causes of [`KernelDrops`](crate::datapath::KernelDrops).
const KERNEL_DROPS: [(&str, &str); 4] = [
    (
        "kernel: overflow",
        "Never seen by the relay: the receive buffer of a public port was full. Raise \
         `receive_buffer` and sysctl net.core.rmem_max, add workers.",
    ),
    (
        "kernel: prefilter",
        "Refused by the kernel for their length, header or password, while a public port was \
         flooded, or with `prefilter = \"always\"` from the start on.",
    ),
    (
        "kernel: upstream overflow",
        "Answers of servers that the relay never saw: the receive buffer of a socket towards the \
         plant was full. Raise `receive_buffer` and sysctl net.core.rmem_max, add workers.",
    ),
    (
        "kernel: upstream prefilter",
        "Refused by the kernel on a socket towards the plant, while it was flooded by senders that \
         are no server of the table. Who sends there? A firewall can keep them out.",
    ),
];

/// `GET /api/v1/drop-reasons`
pub(in crate::admin) async fn drop_reasons() -> Response {
    let reasons = Direction::ALL.iter().flat_map(|direction| direction.drop_reasons());
    let reasons = reasons.map(|reason| (reason.label(), reason.explanation()));
    let reasons = reasons.chain(KERNEL_DROPS);
    Json(reasons.collect::<BTreeMap<_, _>>()).into_response()
}
