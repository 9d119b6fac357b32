//! How many threads work.

use std::thread::available_parallelism;

use rayon::{ThreadPool, ThreadPoolBuilder};

use super::Stop;

/// So many threads are harmless on any machine, and a script made for a larger one still runs.
const ALWAYS: usize = 64;
/// More threads than this for each core only take memory.
const PER_CORE: usize = 4;

fn cores() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// The most threads that may be asked for.
fn most() -> usize {
    ALWAYS.max(PER_CORE * cores())
}

/// Reads the value of `--threads`.
///
/// # Errors
/// When it is no number from 1 to the most that make sense here.
pub fn count(text: &str) -> Result<usize, String> {
    match text.parse::<u64>() {
        Ok(0) => Err("it must be 1 or more; leave `--threads` out for all cores".to_owned()),
        Ok(n) if n <= most() as u64 => Ok(n as usize),
        Ok(_) => Err(format!("this machine has {} cores; ask for at most {} threads", cores(), most())),
        Err(_) => Err("it must be a whole number".to_owned()),
    }
}

/// A pool of `threads`, all cores where nothing is said.
///
/// # Errors
/// When the system refuses the threads.
pub fn pool(threads: Option<usize>) -> Result<ThreadPool, Stop> {
    let pool = ThreadPoolBuilder::new().num_threads(threads.unwrap_or_else(cores)).build();
    pool.map_err(|e| Stop::Failed(format!("error: cannot start threads: {e}")))
}
