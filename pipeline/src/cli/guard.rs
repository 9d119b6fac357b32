//! A process of its own for queries, whose memory is watched by the process that starts it and limited by the kernel.
//!
//! DataFusion accounts for the memory of sorts, joins and aggregates. Results of functions and windows are not accounted for, and an
//! allocation that fails ends the process. So a query runs in a child process, and its end is reported in words.

use std::{
    env, fs, io,
    path::{Path, PathBuf},
    process::{Child, Command},
    sync::atomic::{AtomicI32, Ordering},
    thread::{available_parallelism, sleep},
    time::Duration,
};

use nix::{
    sys::{
        resource::{Resource, setrlimit},
        signal::{Signal, kill},
    },
    unistd::Pid,
};
use schemas::Fault;

use super::Stop;
use crate::{confine, views::sql::memory};

/// The variable that names the folder for temporary files, and marks the child.
const CHILD: &str = "MAGLINE_QUERY_FOLDER";
/// Memory of the program itself, and of what DataFusion does not account for, bytes.
const OWN: usize = 256 << 20;
/// Address space that is reserved and mostly not used: a deep stack, and arenas of the allocator.
const RESERVED: u64 = 4 << 30;
/// Address space of each thread: its stack and its arenas.
const THREAD: u64 = 128 << 20;
/// The interval at which the memory of the child is looked at: at first, and at most.
const LOOK: [Duration; 2] = [Duration::from_millis(1), Duration::from_millis(8)];

/// The number of the child, for the handler of interrupts; 0 without one.
static CHILD_PID: AtomicI32 = AtomicI32::new(0);

/// The folder for temporary files, where this process is the child.
pub fn folder() -> Option<PathBuf> {
    env::var_os(CHILD).map(PathBuf::from)
}

/// The bytes that a query with the limit `memory` may take in all.
fn most(memory: usize) -> usize {
    memory.saturating_add(OWN.max(memory / 2))
}

/// Limits this process, the child: it ends with its parent, a failed allocation ends it early, and panics are reported by the
/// error of the query alone.
pub fn limit(memory: usize) {
    std::panic::set_hook(Box::new(|_| {}));
    #[cfg(target_os = "linux")]
    let _ = nix::sys::prctl::set_pdeathsig(Signal::SIGKILL);
    let threads = available_parallelism().map_or(8, usize::from) as u64;
    if let Some(now) = confine::bytes_of("self", "VmSize:") {
        let all = (now as u64).saturating_add(most(memory) as u64).saturating_add(RESERVED + THREAD * threads);
        // Where the kernel has no such limit, the parent watches all the same.
        let _ = setrlimit(Resource::RLIMIT_AS, all, all);
    }
}

/// Runs this command again as a child process, in which `folder` is for temporary files, and waits for its end. `unfinished` is
/// the file that the child of a number leaves behind when it is killed.
///
/// # Errors
/// The end of the child, where it is not that of success. Its own message is out already.
pub fn run(memory: usize, folder: &Path, unfinished: impl Fn(u32) -> Option<PathBuf>) -> Result<(), Stop> {
    let failed = |e: &io::Error| Fault::machine(format!("cannot start the process of the query: {e}"));
    let program = env::current_exe().map_err(|e| failed(&e))?;
    let started = Command::new(program).args(env::args_os().skip(1)).env(CHILD, folder).spawn();
    let mut child = started.map_err(|e| failed(&e))?;
    let number = i32::try_from(child.id()).unwrap_or(0);
    CHILD_PID.store(number, Ordering::SeqCst);
    // Where no handler can be set, an interrupt ends both at once.
    let _ = ctrlc::set_handler(|| {
        let number = CHILD_PID.load(Ordering::SeqCst);
        if number > 0 {
            let _ = kill(Pid::from_raw(number), Signal::SIGINT);
        }
    });
    let ended = watch(&mut child, most(memory)).map_err(|e| failed(&e))?;
    CHILD_PID.store(0, Ordering::SeqCst);
    match ended {
        Some(0) => Ok(()),
        Some(code) if code != PANICKED => Err(Stop::Told(u8::try_from(code).unwrap_or(1))),
        _ => {
            if let Some(file) = unfinished(child.id()) {
                let _ = fs::remove_file(file);
            }
            Err(exceeded(memory).into())
        }
    }
}

/// The exit status of a panic.
const PANICKED: i32 = 101;

/// The fault of a query that takes too much memory.
pub fn exceeded(memory: usize) -> Fault {
    let limit = memory::shown(memory);
    Fault::machine(format!("the query needs more memory than the {limit} it may take"))
        .help("`--memory-limit` gives it more; a narrower WHERE, a LIMIT or fewer columns make it smaller")
}

/// Waits for the end of the child; its exit status, and `None` where a signal ended it, or it took more than `most` bytes.
fn watch(child: &mut Child, most: usize) -> io::Result<Option<i32>> {
    let [mut wait, longest] = LOOK;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status.code());
        }
        if confine::used(child.id()).is_some_and(|bytes| bytes > most) {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        sleep(wait);
        wait = (wait * 2).min(longest);
    }
}
