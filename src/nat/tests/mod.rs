//! The NAT as a whole: a simulation of everything that happens to it, and scenarios played one by
//! one.

mod attackers;
mod fixture;
mod handover;
mod offload;
mod order;
mod profinet;
mod remote;
mod silence;
mod simulation;
