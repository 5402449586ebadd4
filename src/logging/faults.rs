//! The faults of a configuration, as events and as text.

use std::sync::atomic::Ordering::Relaxed;

use super::{COMPLAINS_IN_JSON, complain};
use crate::config::Faults;

/// Tells the user all faults of a configuration that cannot be used.
pub fn complain_of_faults(faults: &Faults) {
    if COMPLAINS_IN_JSON.load(Relaxed) {
        log_faults(faults);
        complain("the configuration is not sound");
    } else {
        complain(faults);
    }
}

/// Logs one event for each fault.
pub(crate) fn log_faults(faults: &Faults) {
    for fault in &faults.0 {
        tracing::error!(
            file = %fault.file.display(),
            line = fault.line,
            key = fault.key,
            problem = fault.problem,
            remedy = fault.remedy,
            "configuration fault"
        );
    }
}
