//! Number of tasks of a job.

/// Overhead of a job at its worker and the scheduler, in seconds. Source: `pipeline/CLUSTER.md`.
const JOB_S: f64 = 0.06;
/// Maximum overhead as a fraction of the work, during a wave and at the end of a wave. At the end, jobs are smaller, so
/// that all cores finish together.
const MAX_OVERHEAD: f64 = 0.03;
const MOST_AT_THE_END: f64 = 0.05;
/// Time that the scheduler needs for a job, in seconds; the scheduler handles jobs one after another.
const SCHEDULING_S: f64 = 0.02;
/// Jobs per core: one running, one waiting.
pub const JOBS_A_CORE: usize = 2;
/// Maximum number of tasks of a job.
const MOST_TASKS: usize = 256;

/// Number of tasks of the next job of a wave. The wave has `all` tasks of `task_s` seconds each, and `waiting` of them
/// are not dispatched yet. A job contains enough work that its overhead is a small share of the work and that the
/// scheduler keeps up with all cores. Towards the end of a wave, jobs become smaller, as long as the overhead remains a
/// small share. A wave with less work per core is divided evenly.
pub fn size(task_s: f64, all: usize, waiting: usize, cores: usize) -> usize {
    let of = |seconds: f64| (seconds / task_s.max(1e-6)).clamp(1.0, MOST_TASKS as f64) as usize;
    let wanted = of((JOB_S / MAX_OVERHEAD).max(SCHEDULING_S * cores as f64));
    let least = of(JOB_S / MOST_AT_THE_END).min(all.div_ceil(cores));
    wanted.min(waiting.div_ceil(JOBS_A_CORE * cores).max(least))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_jobs_keep_their_overhead_small_and_all_cores_busy() {
        for (task_s, all) in [(0.036, 111), (0.25, 400), (0.01, 20_000), (5.0, 60), (60.0, 3)] {
            for cores in [1, 2, 64] {
                let (mut waiting, mut jobs, mut first) = (all, 0, 0);
                while waiting > 0 {
                    let size = size(task_s, all, waiting, cores);
                    assert!((1..=MOST_TASKS).contains(&size), "{task_s} {all} {cores}: {size}");
                    first = if jobs == 0 { size } else { first };
                    waiting -= size.min(waiting);
                    jobs += 1;
                }
                let work_s = task_s * all as f64;
                let cost = JOB_S * f64::from(jobs) / work_s;
                // With too little work for all cores, one job per core is better than a smaller overhead.
                let few = usize::try_from(jobs).unwrap() <= 2 * cores;
                let largest = MOST_TASKS as f64 * task_s < JOB_S / MOST_AT_THE_END;
                assert!(cost < 0.062 || few || largest, "{task_s} {all} {cores}: {jobs} jobs cost {cost}");
                assert!(first <= all.div_ceil(cores), "{task_s} {all} {cores}: {first} at first");
            }
        }
    }
}
