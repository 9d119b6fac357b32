//! Work on several items at once, with the results in the order of the items.

use std::{
    collections::BTreeMap,
    sync::{Condvar, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

/// Results shared by the threads, by position.
struct InOrderState<O, E> {
    results: BTreeMap<usize, Result<O, E>>,
    failed: bool,
}

/// Applies `work` to each item of `next` on the threads of the pool, to at most `most` items at once. `next` is called
/// on this thread, with at most `most` unfinished items. `done` is called after each item with the number of finished
/// items.
///
/// # Errors
/// Fails with the first error in the order of the items, which may differ from the order in time.
pub fn in_order<I: Send, O: Send, E: Send>(
    most: usize,
    mut next: impl FnMut() -> Option<Result<I, E>>,
    work: impl Fn(I) -> Result<O, E> + Sync,
    done: &dyn Fn(usize),
) -> Result<Vec<O>, E> {
    if most <= 1 {
        let mut results = vec![];
        while let Some(item) = next() {
            results.push(work(item?)?);
            done(results.len());
        }
        return Ok(results);
    }
    let state = Mutex::new(InOrderState { results: BTreeMap::new(), failed: false });
    let (one_more, work) = (Condvar::new(), &work);
    let mut reported = 0;
    let mut report_done = |results: usize| {
        (reported + 1..=results).for_each(done);
        reported = reported.max(results);
    };
    let mut error = None;
    rayon::in_place_scope(|scope| {
        for i in 0.. {
            loop {
                let now = locked(&state);
                let (results, failed) = (now.results.len(), now.failed);
                drop(now);
                report_done(results);
                if failed {
                    return;
                }
                if i - results < most {
                    break;
                }
                // With a single thread, this thread does the work.
                if rayon::yield_now() != Some(rayon::Yield::Executed) {
                    let now = locked(&state);
                    if now.results.len() == results {
                        // Other code may also add work to the pool, so this thread does not sleep for long.
                        drop(one_more.wait_timeout(now, Duration::from_millis(5)));
                    }
                }
            }
            match next() {
                Some(Ok(item)) => scope.spawn({
                    let (state, one_more) = (&state, &one_more);
                    move |_| {
                        let result = work(item);
                        let mut now = locked(state);
                        now.failed |= result.is_err();
                        now.results.insert(i, result);
                        one_more.notify_all();
                    }
                }),
                Some(Err(e)) => {
                    error = Some(e);
                    return;
                }
                None => return,
            }
        }
    });
    let results = state.into_inner().unwrap_or_else(PoisonError::into_inner).results;
    let all = results.into_values().collect::<Result<Vec<O>, E>>()?;
    report_done(all.len());
    error.map_or(Ok(all), Err)
}

fn locked<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    // The state is consistent even after a panic.
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::{
        cell::RefCell,
        sync::atomic::{AtomicUsize, Ordering},
    };

    use super::*;

    #[test]
    fn unit_results_and_errors_do_not_depend_on_the_threads() {
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            for most in [1, 2, 3, 8] {
                let (given, finished) = (AtomicUsize::new(0), AtomicUsize::new(0));
                let run = |bad: Vec<usize>, end: Option<usize>| {
                    let reported = RefCell::new(vec![]);
                    given.store(0, Ordering::SeqCst);
                    finished.store(0, Ordering::SeqCst);
                    let next = || {
                        let i = given.fetch_add(1, Ordering::SeqCst);
                        assert!(i - finished.load(Ordering::SeqCst) < most, "bounded");
                        if end == Some(i) { Some(Err(1000 + i)) } else { (i < 40).then_some(Ok(i)) }
                    };
                    let work = |i: usize| {
                        std::thread::sleep(Duration::from_micros(((i * 37) % 11) as u64 * 50));
                        finished.fetch_add(1, Ordering::SeqCst);
                        if bad.contains(&i) { Err(i) } else { Ok(i * i) }
                    };
                    let out = in_order(most, next, work, &|n| reported.borrow_mut().push(n));
                    (out, reported.into_inner())
                };
                let squares: Vec<usize> = (0..40).map(|i| i * i).collect();
                let (all, reported) = run(vec![], None);
                assert_eq!((all, reported), (Ok(squares), (1..=40).collect()), "outside of a pool");
                // The same on a thread of the pool, without and with errors.
                let reported = pool.install(|| [run(vec![], None).1.len(), run(vec![7, 8], None).0.unwrap_err()]);
                assert_eq!(reported, [40, 7]);
                assert_eq!(run(vec![9], Some(12)).0, Err(9));
                assert_eq!(run(vec![], Some(12)).0, Err(1012));
            }
        }
    }
}
