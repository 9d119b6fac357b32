//! The program and arguments of this process, from which its child processes are started.

use std::{env, ffi::OsString, io, path::PathBuf, sync::OnceLock};

/// Program and arguments of a command.
#[derive(Debug)]
pub struct Invocation {
    /// Path of the program that starts this command.
    pub program: PathBuf,
    /// Arguments after the program's name.
    pub arguments: Vec<OsString>,
}

static INVOCATION: OnceLock<Invocation> = OnceLock::new();

impl Invocation {
    /// Makes this the invocation of the process. Only the first call has an effect.
    pub fn set(self) {
        let _ = INVOCATION.set(self);
    }
}

/// Path of this program.
///
/// # Errors
/// Fails if the system does not report the path of this program.
pub fn program() -> io::Result<PathBuf> {
    INVOCATION.get().map_or_else(env::current_exe, |own| Ok(own.program.clone()))
}

/// Arguments of this process, after the program's name.
pub fn arguments() -> Vec<OsString> {
    INVOCATION.get().map_or_else(|| env::args_os().skip(1).collect(), |own| own.arguments.clone())
}
