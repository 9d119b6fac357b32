//! Jobs of a wave that take long: whether they are waited for, taken from the store, or begun again.

use std::time::Duration;

/// The longest time of a job without a worker at it.
pub const STALL: Duration = Duration::from_secs(600);

/// The state of a job that takes long.
#[derive(Clone, Copy, Debug)]
pub struct Facts {
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

/// The action on a job that takes long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is being computed, or waits for its turn.
    Wait,
    /// Its answer was lost, and its results are there.
    Take,
    /// It was lost.
    Again,
}

impl Facts {
    /// Whether the scheduler reports it as running and no worker computes it. A job that waits for its turn is not idle.
    pub fn is_idle(&self) -> bool {
        self.is_handed && !self.is_at_work
    }

    /// The action on it.
    pub fn verdict(&self) -> Verdict {
        match (self.there && self.were_there, self.is_idle() && self.idle.is_some_and(|idle| idle > STALL)) {
            (true, _) => Verdict::Take,
            (false, true) => Verdict::Again,
            (false, false) => Verdict::Wait,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_an_answer_that_was_lost_is_taken_from_the_store_and_a_job_that_was_lost_begins_again() {
        let work = Facts { there: false, were_there: false, is_handed: true, is_at_work: true, idle: None };
        let late = Some(STALL + Duration::from_secs(1));
        assert_eq!(work.verdict(), Verdict::Wait, "a unit may take hours");
        assert_eq!(Facts { there: true, ..work }.verdict(), Verdict::Wait, "its answer may be on its way");
        assert_eq!(Facts { there: true, were_there: true, ..work }.verdict(), Verdict::Take);
        let idle = Facts { is_at_work: false, ..work };
        assert!(idle.is_idle() && !work.is_idle());
        assert_eq!(idle.verdict(), Verdict::Wait, "it may have begun just now");
        assert_eq!(Facts { idle: late, ..idle }.verdict(), Verdict::Again);
        let waits = Facts { is_handed: false, idle: late, ..idle };
        assert_eq!(waits.verdict(), Verdict::Wait, "other runs have their turn");
        assert_eq!(Facts { there: true, were_there: true, idle: late, ..idle }.verdict(), Verdict::Take);
    }
}
