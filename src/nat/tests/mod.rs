//! The NAT as a whole: a simulation of everything that happens to it, and scenes played one by one.

mod attackers;
mod handover;
mod silence;
mod simulation;
