//! What holds across the crates of magline: end to end, validation, the version gate.
