//! Processor time.

use std::{hint::black_box, time::Instant};

/// Processor time of this thread for `work`, in seconds, and its result. Elapsed time if the system does not report
/// processor time.
pub fn processor_s<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let on_processor_s = || -> Option<f64> {
        let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        Some(told.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
    };
    let (clock, before) = (Instant::now(), on_processor_s());
    let answer = black_box(work());
    let time_s = before.zip(on_processor_s()).map_or_else(|| clock.elapsed().as_secs_f64(), |(a, b)| b - a);
    (time_s, answer)
}
