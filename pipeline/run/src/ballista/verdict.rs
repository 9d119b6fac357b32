//! Decisions on long jobs of a wave: wait, take the results from the store, or restart.

use std::time::Duration;

/// Maximum time for which a job may remain without a worker.
pub const STALL: Duration = Duration::from_secs(600);

/// Observed state of a long job.
#[derive(Clone, Copy, Debug)]
pub struct JobObservation {
    /// Whether all results of the job are in the store.
    pub there: bool,
    /// Whether all results were in the store at the previous check.
    pub were_there: bool,
    /// Whether the scheduler reports that a worker has a part of the job.
    pub is_handed: bool,
    /// Whether a worker computes a unit of the job.
    pub is_at_work: bool,
    /// Time without a worker.
    pub idle: Option<Duration>,
}

/// Action on a long job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobAction {
    /// Wait: the job is running or queued.
    Wait,
    /// Take the results from the store: the answer was lost.
    Take,
    /// Restart: the job was lost.
    Again,
}

impl JobObservation {
    /// Whether the scheduler reports the job as running but no worker computes it. A queued job is not idle.
    pub fn is_idle(&self) -> bool {
        self.is_handed && !self.is_at_work
    }

    /// Action on the job.
    pub fn verdict(&self) -> JobAction {
        match (self.there && self.were_there, self.is_idle() && self.idle.is_some_and(|idle| idle > STALL)) {
            (true, _) => JobAction::Take,
            (false, true) => JobAction::Again,
            (false, false) => JobAction::Wait,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_lost_answer_is_read_from_the_store_and_lost_job_restarts() {
        let work = JobObservation { there: false, were_there: false, is_handed: true, is_at_work: true, idle: None };
        let late = Some(STALL + Duration::from_secs(1));
        assert_eq!(work.verdict(), JobAction::Wait, "a unit may take hours");
        assert_eq!(JobObservation { there: true, ..work }.verdict(), JobAction::Wait, "its answer may be on its way");
        assert_eq!(JobObservation { there: true, were_there: true, ..work }.verdict(), JobAction::Take);
        let idle = JobObservation { is_at_work: false, ..work };
        assert!(idle.is_idle() && !work.is_idle());
        assert_eq!(idle.verdict(), JobAction::Wait, "it may have begun just now");
        assert_eq!(JobObservation { idle: late, ..idle }.verdict(), JobAction::Again);
        let waits = JobObservation { is_handed: false, idle: late, ..idle };
        assert_eq!(waits.verdict(), JobAction::Wait, "other runs have their turn");
        assert_eq!(JobObservation { there: true, were_there: true, idle: late, ..idle }.verdict(), JobAction::Take);
    }
}
