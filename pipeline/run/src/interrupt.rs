//! State of a run for interrupts.

use std::sync::atomic::AtomicBool;

/// Set to stop a run after the current units.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Whether the sources were read and units are being computed.
pub static STARTED: AtomicBool = AtomicBool::new(false);
