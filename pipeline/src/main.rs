//! The `magline` command.

use std::process::ExitCode;

// All threads allocate and free columns of many megabytes; this allocator returns their memory to the system.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    pipeline::main(&pipeline::catalogue())
}
