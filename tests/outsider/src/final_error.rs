//! Example of a custom metric: position error at the end of a track.

use schemas::{Fault, metric::MetricDisplay};
use stages::score::{SampleStatistic, metric};

metric! {
    /// horizontal error of the track at the last sample with a finite error
    FINAL_ERROR = "final_error", version 1, unit "m", pool Rms, better Lower,
    shown MetricDisplay::column(105, 50), needs [Track, Position];
    |line| {
        let error = line.track_error()?;
        let mut sizes = error.north_m.iter().zip(&error.east_m).map(|(north, east)| north.hypot(*east));
        let last = sizes.rfind(|size: &f64| size.is_finite());
        let (value, n) = (last.unwrap_or(f64::NAN), usize::from(last.is_some()));
        Ok::<SampleStatistic, Fault>(SampleStatistic { value, n })
    }
}
