//! Arithmetic of this machine, on which the last bits of results depend.

use std::sync::LazyLock;

use numerics::arithmetic;
use schemas::keys::HashKey;

/// Hash of [`arithmetic::probe`] on this machine, a part of the key of every result. The last bits of results depend on
/// it as well as on inputs, version and parameters.
pub static ARITHMETIC: LazyLock<HashKey> =
    LazyLock::new(|| HashKey::from_parts(arithmetic::probe().iter().map(|x| x.to_bits().to_le_bytes())));

/// Readable description of this machine's arithmetic: the processor and its [`ARITHMETIC`].
pub fn arithmetic_in_words() -> String {
    format!("{} {}", arithmetic::processor(), *ARITHMETIC)
}
