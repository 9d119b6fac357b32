//! The `magline` command.

use std::process::ExitCode;

// Columns of many megabytes come and go on all threads; this allocator gives their memory back.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    pipeline::main(&pipeline::catalogue())
}
