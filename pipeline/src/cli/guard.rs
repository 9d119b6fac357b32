//! Child process of a `sql` query. The parent monitors the memory of the child, and the kernel limits it.
//!
//! DataFusion accounts for the memory of sorts, joins and aggregates, but not for results of functions and windows. A
//! failed allocation aborts the process. A query therefore runs in a child process, and the parent reports how the
//! child ended.

use std::{
    env, fs, io,
    path::{Path, PathBuf},
    process::{Child, ExitStatus},
    sync::atomic::{AtomicI32, Ordering},
    thread::{available_parallelism, sleep},
    time::Duration,
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use report::sql::memory;
use run::confine;
use schemas::Fault;

use super::{ExitReason, invocation};

/// Environment variable with the folder for temporary files. The variable is set only in the child.
const CHILD: &str = "MAGLINE_QUERY_FOLDER";
/// Memory of the program and of allocations that DataFusion does not account for, in bytes.
const OWN: usize = 256 << 20;
/// Reserved and mostly unused memory of the stack and the allocator's arenas, in bytes.
const RESERVED: usize = 4 << 30;
/// Reserved memory of each thread's stack and arenas, in bytes.
const THREAD: usize = 128 << 20;
/// Initial and maximum interval between checks of the child's memory.
const LOOK: [Duration; 2] = [Duration::from_millis(1), Duration::from_millis(8)];

/// Process id of the child, for the interrupt handler; 0 without a child.
static CHILD_PID: AtomicI32 = AtomicI32::new(0);

/// Folder for temporary files; `None` if this process is not the child.
pub fn folder() -> Option<PathBuf> {
    env::var_os(CHILD).map(PathBuf::from)
}

/// Maximum total memory of a query with the limit `memory`, in bytes.
fn most(memory: usize) -> usize {
    memory.saturating_add(OWN.max(memory / 2))
}

/// Limits this child process: it ends with its parent, an allocation far beyond the limit fails immediately, and a
/// panic is reported only as the query's error.
pub fn limit(memory: usize) {
    std::panic::set_hook(Box::new(|_| {}));
    confine::end_with_parent();
    let threads = available_parallelism().map_or(8, usize::from);
    let reserved = RESERVED.saturating_add(THREAD.saturating_mul(threads));
    // Without a kernel limit, the parent still monitors the memory.
    let _ = confine::limit_memory(most(memory).saturating_add(reserved));
}

/// Runs this command again as a child process with `folder` for temporary files, and waits for its end. Given the
/// process id of the child, `unfinished` returns the file that a killed child leaves behind.
///
/// # Errors
/// Fails if the child fails. The child has already printed its message.
pub fn run(memory: usize, folder: &Path, unfinished: impl Fn(u32) -> Option<PathBuf>) -> Result<(), ExitReason> {
    let failed = |e: &io::Error| Fault::machine(format!("cannot start the process of the query: {e}"));
    let program = invocation::program().map_err(|e| failed(&e))?;
    let started = confine::command(&program).args(invocation::arguments()).env(CHILD, folder).spawn();
    let mut child = started.map_err(|e| failed(&e))?;
    let number = i32::try_from(child.id()).unwrap_or(0);
    CHILD_PID.store(number, Ordering::SeqCst);
    // If no handler can be set, an interrupt ends both processes at once.
    let _ = ctrlc::set_handler(|| {
        let number = CHILD_PID.load(Ordering::SeqCst);
        if number > 0 {
            let _ = kill(Pid::from_raw(number), Signal::SIGINT);
        }
    });
    let ended = watch(&mut child, most(memory)).map_err(|e| failed(&e))?;
    CHILD_PID.store(0, Ordering::SeqCst);
    match ended.code() {
        Some(0) => return Ok(()),
        Some(code) if code != PANICKED => return Err(ExitReason::Printed(u8::try_from(code).unwrap_or(1))),
        _ => {}
    }
    if let Some(file) = unfinished(child.id()) {
        let _ = fs::remove_file(file);
    }
    if ended.code().is_none() && !confine::ran_out(ended) {
        return Err(Fault::machine(format!("the process of the query was killed: {ended}")).into());
    }
    Err(memory::fault(memory).into())
}

/// The exit status of a panic.
const PANICKED: i32 = 101;

/// Waits for the child, and kills it when it uses more than `most` bytes.
fn watch(child: &mut Child, most: usize) -> io::Result<ExitStatus> {
    let [mut wait, longest] = LOOK;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if confine::used(child.id()).is_some_and(|bytes| bytes > most) {
            child.kill()?;
        }
        sleep(wait);
        wait = (wait * 2).min(longest);
    }
}
