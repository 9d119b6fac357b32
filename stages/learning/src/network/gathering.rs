//! Copies rows of a matrix in any order into consecutive memory.
//!
//! The rows of a shuffled batch are scattered in memory, so each copy would wait for a cache miss. Rows are therefore
//! prefetched.

/// Number of rows between the row that is read and the row that is prefetched.
const AHEAD: usize = 8;

/// Number of values in a cache line.
const LINE: usize = 8;

/// Appends the listed rows of a matrix with `columns` columns.
pub(super) fn gather(from: &[f64], columns: usize, rows: &[u32], to: &mut Vec<f64>) {
    let row = |row: &u32| &from[*row as usize * columns..][..columns];
    for (place, now) in rows.iter().enumerate() {
        if let Some(then) = rows.get(place + AHEAD) {
            row(then).chunks(LINE).for_each(prefetch);
        }
        to.extend_from_slice(row(now));
    }
}

/// Prefetches the cache line that holds the first of these numbers.
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "the standard library has no other way to prefetch")]
fn prefetch(numbers: &[f64]) {
    use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
    // SAFETY: a prefetch is a hint that reads and writes nothing, and every processor of this architecture supports it.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(numbers.as_ptr().cast()) }
}

/// Stable Rust has no prefetch hint for this architecture.
#[cfg(not(target_arch = "x86_64"))]
fn prefetch(_: &[f64]) {}

#[cfg(test)]
mod tests {
    use super::gather;

    #[test]
    fn unit_rows_are_gathered_in_the_given_order() {
        let from: Vec<f64> = (0..600).map(f64::from).collect();
        let rows: Vec<u32> = (0..20).map(|k| (k * 7) % 20).collect();
        let mut to = vec![-1.0];
        gather(&from, 30, &rows, &mut to);
        assert_eq!((to.len(), to[0]), (601, -1.0));
        for (row, found) in rows.iter().zip(to[1..].chunks_exact(30)) {
            let first = *row as usize * 30;
            assert_eq!(found, &from[first..first + 30]);
        }
        // There are neither columns nor rows, so nothing is appended.
        gather(&[], 0, &rows, &mut to);
        gather(&from, 30, &[], &mut to);
        assert_eq!(to.len(), 601);
    }
}
