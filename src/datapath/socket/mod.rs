//! A datapath of UDP sockets: workers that share nothing, each with its epoll.

pub(in crate::datapath) mod busy_poll;
pub(in crate::datapath) mod descriptors;
pub(in crate::datapath) mod event_key;
pub(in crate::datapath) mod filtered;
pub(in crate::datapath) mod flood_guard;
pub(in crate::datapath) mod handle;
pub(in crate::datapath) mod port_pool;
pub(in crate::datapath) mod public;
pub(in crate::datapath) mod receive_quota;
pub(in crate::datapath) mod setup;
pub(in crate::datapath) mod sys;
pub(in crate::datapath) mod ticker;
pub(in crate::datapath) mod upstream;
pub(in crate::datapath) mod way_back;
pub(in crate::datapath) mod worker;
