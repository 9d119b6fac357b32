//! Bench placeholder while the numerics below it are written.
fn main() {}
