//! A datapath of UDP sockets. The workers share no socket and no flow, and each has its own epoll.

pub(in crate::datapath) mod busy_poll;
pub(in crate::datapath) mod descriptors;
mod effects;
pub(in crate::datapath) mod event_key;
pub(in crate::datapath) mod filtered;
pub(in crate::datapath) mod flood_guard;
pub(in crate::datapath) mod handle;
pub(in crate::datapath) mod port_pool;
pub(in crate::datapath) mod public;
pub(in crate::datapath) mod receive_quota;
pub(in crate::datapath) mod setup;
mod stray_guard;
pub(in crate::datapath) mod sys;
pub(in crate::datapath) mod ticker;
mod upstream;
pub(in crate::datapath) mod way_back;
pub(in crate::datapath) mod worker;
