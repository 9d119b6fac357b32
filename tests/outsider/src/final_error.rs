//! A metric of one's own: how far off a track ends.

use schemas::{Fault, metric::Shown};
use stages::score::{Figure, metric};

metric! {
    /// horizontal error of the track at the last sample that has one
    FINAL_ERROR = "final_error", version 1, unit "m", pool Rms, better Lower,
    shown Shown::column(105, 50), needs [Track, Position];
    |line| {
        let error = line.track_error()?;
        let sizes = error.north_m.iter().zip(&error.east_m).map(|(north, east)| north.hypot(*east));
        let last = sizes.filter(|size| size.is_finite()).next_back();
        Ok::<Figure, Fault>(Figure { value: last.unwrap_or(f64::NAN), n: usize::from(last.is_some()) })
    }
}
