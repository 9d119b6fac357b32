//! Third-party decoders on bytes that may be damaged.

use std::{
    cell::Cell,
    panic::{self, AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::Once,
};

use crate::ReadError;

/// Runs a third-party decoder on bytes that may be damaged, and converts a panic to an error. The panic's message is
/// discarded.
pub(crate) fn guarded<T>(path: &Path, decode: impl FnOnce() -> Result<T, ReadError>) -> Result<T, ReadError> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let loud = panic::take_hook();
        panic::set_hook(Box::new(move |about| {
            if GUARDED.get() == 0 {
                loud(about);
            }
        }));
    });
    GUARDED.set(GUARDED.get() + 1);
    let outcome = catch_unwind(AssertUnwindSafe(decode));
    GUARDED.set(GUARDED.get() - 1);
    outcome.unwrap_or_else(|_| Err(ReadError::data(path, "the file is damaged: its decoder failed")))
}

thread_local! {
    /// Number of nested decoders that this thread is running.
    static GUARDED: Cell<u32> = const { Cell::new(0) };
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]

    use super::*;

    #[test]
    fn unit_a_decoder_panic_is_an_error_and_later_panics_are_still_reported() {
        let path = Path::new("a.parquet");
        let nested = guarded(path, || {
            let inner = guarded::<()>(path, || panic!("inner"));
            assert!(inner.unwrap_err().to_string().starts_with("a.parquet: the file is damaged"));
            assert_eq!(GUARDED.get(), 1);
            Ok(())
        });
        assert!(nested.is_ok() && GUARDED.get() == 0);
    }
}
