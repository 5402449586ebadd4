//! What datagrams of PROFINET say, as JSON and as text.

#![cfg_attr(not(test), expect(dead_code, reason = "the decoder does not call it yet"))]

mod rpc;
mod rpc_fragments;
mod rpc_value;
