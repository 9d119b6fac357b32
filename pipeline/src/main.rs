//! The `magline` command.
fn main() {}
