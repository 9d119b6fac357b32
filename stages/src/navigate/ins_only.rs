//! The INS by itself.

use numerics::navigation::{ins_only, output::NavigationOutput};
use schemas::Fault;

use super::filter::{Flown, NavigationFilter, Track, Update, filter};
use crate::columns::data;

filter! {
    /// The INS by itself, with the covariance that its error sources give it: what the others are held against. It takes
    /// no measurement, so that `residual` and `nis` are NaN and `update` is `unused`, and needs no map.
    InsOnly = "ins_only", version 1, example "";
}

impl NavigationFilter for InsOnly {
    fn needs_map(&self) -> bool {
        false
    }

    fn takes_map(&self) -> bool {
        true
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
        let out: NavigationOutput = ins_only::run(&flown.ins, &flown.errors).map_err(data)?;
        let update = vec![Update::Unused; flown.ins.len()];
        Ok(Track { update, ..Track::without_updates(out) })
    }
}
