//! The number of threads.

use std::thread::available_parallelism;

use rayon::{ThreadPool, ThreadPoolBuilder};

use super::ExitReason;

/// Number of threads that every machine accepts, so that scripts written for larger machines run.
const ALWAYS: usize = 64;
/// Maximum number of threads per core; more threads only use memory.
const PER_CORE: usize = 4;

/// Number of cores of this machine that this process may use.
pub fn cores() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// The maximum number of threads.
fn most() -> usize {
    ALWAYS.max(PER_CORE * cores())
}

/// Reads the value of `--threads`.
///
/// # Errors
/// Fails if it is not a number from 1 to the maximum on this machine.
pub fn count(text: &str) -> Result<usize, String> {
    match text.parse::<u64>() {
        Ok(0) => Err("the value must be 1 or more; without `--threads` all cores are used".to_owned()),
        Ok(n) if n <= most() as u64 => Ok(n as usize),
        Ok(_) => Err(format!("this machine has only {} cores; use at most {} threads", cores(), most())),
        Err(_) => Err("the value must be a whole number".to_owned()),
    }
}

/// A pool of `threads`, all cores by default.
///
/// # Errors
/// Fails if the system cannot start the threads.
pub fn pool(threads: Option<usize>) -> Result<ThreadPool, ExitReason> {
    let pool = ThreadPoolBuilder::new().num_threads(threads.unwrap_or_else(cores)).build();
    pool.map_err(|e| ExitReason::Failed(format!("error: cannot start threads: {e}")))
}
