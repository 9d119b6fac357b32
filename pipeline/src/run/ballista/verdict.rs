//! Jobs of a wave that take long: whether they are waited for, taken from the store, or begun again.

use std::time::Duration;

/// The longest time of a job without a worker at it.
pub const STALL: Duration = Duration::from_secs(600);

/// The observed state of a long job.
#[derive(Clone, Copy, Debug)]
pub struct JobObservation {
    /// All its results are in the store.
    pub there: bool,
    /// They were there when it was looked at before.
    pub were_there: bool,
    /// The scheduler reports that a worker has a part of it.
    pub is_handed: bool,
    /// A worker is at a unit of it.
    pub is_at_work: bool,
    /// The time without a worker at it.
    pub idle: Option<Duration>,
}

/// The action on a long job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobAction {
    /// It is being computed, or waits for its turn.
    Wait,
    /// Its answer was lost, and its results are there.
    Take,
    /// It was lost.
    Again,
}

impl JobObservation {
    /// Whether the scheduler reports it as running and no worker computes it. A job that waits for its turn is not
    /// idle.
    pub fn is_idle(&self) -> bool {
        self.is_handed && !self.is_at_work
    }

    /// The action on it.
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
    fn unit_an_answer_that_was_lost_is_taken_from_the_store_and_a_job_that_was_lost_begins_again() {
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
