//! Child processes for queries of `sql` and `serve`. The processes end with their parent. The kernel limits their
//! memory, so that an oversized query fails alone.

use std::{
    fs,
    os::unix::process::ExitStatusExt,
    process::{Command, ExitStatus},
};

use nix::sys::resource::{Resource, getrlimit, setrlimit};
use schemas::Fault;

/// Environment variable that makes mimalloc commit memory on demand, so that the measured memory is the used memory.
const LAZY: (&str, &str) = ("MIMALLOC_ARENA_EAGER_COMMIT", "0");

/// The command of this program for a process whose memory will be limited.
pub fn command(program: &std::path::Path) -> Command {
    let mut command = Command::new(program);
    command.env(LAZY.0, LAZY.1);
    command
}

/// Ends this process when its parent ends, because nobody then waits for the result.
pub fn end_with_parent() {
    #[cfg(target_os = "linux")]
    let _ = nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGKILL);
}

/// Limits the memory of this process to its current size plus `bytes`. A larger allocation ends the process.
///
/// # Errors
/// Fails if the system rejects the limit.
pub fn limit_memory(bytes: usize) -> Result<(), Fault> {
    let refused = |e: nix::errno::Errno| Fault::machine(format!("cannot limit the memory of a process: {e}"));
    let (_, hard) = getrlimit(Resource::RLIMIT_DATA).map_err(refused)?;
    let most = (bytes_of("self", "VmData:").unwrap_or(0) as u64).saturating_add(bytes as u64).min(hard);
    setrlimit(Resource::RLIMIT_DATA, most, hard).map_err(refused)
}

/// Private memory of a process, without mapped files, in bytes.
pub fn used(process: u32) -> Option<usize> {
    bytes_of(&process.to_string(), "RssAnon:")
}

/// Amount of memory under a key in `/proc/<process>/status`, in bytes; `None` if the system does not report it.
pub fn bytes_of(process: &str, key: &str) -> Option<usize> {
    let text = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    line.trim().trim_end_matches("kB").trim().parse::<usize>().ok()?.checked_mul(1024)
}

/// Whether a process ended because it ran out of memory. A failed allocation aborts it; the kernel kills it if the
/// machine has no memory left.
pub fn ran_out(status: ExitStatus) -> bool {
    matches!(status.signal(), Some(libc_signal::ABORT | libc_signal::SEGV | libc_signal::KILL))
}

mod libc_signal {
    use nix::sys::signal::Signal;

    pub const ABORT: i32 = Signal::SIGABRT as i32;
    pub const SEGV: i32 = Signal::SIGSEGV as i32;
    pub const KILL: i32 = Signal::SIGKILL as i32;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_process_memory_is_reported() {
        let here = used(std::process::id());
        assert!(here.is_none_or(|bytes| bytes > 1 << 16));
        assert_eq!(used(u32::MAX), None);
    }
}
