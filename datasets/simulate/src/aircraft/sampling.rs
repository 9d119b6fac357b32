//! The sampling of a sensor, and its values in the table.

use super::spec::SensorSampling;

/// Timing of a sensor's readings relative to the rows of a table.
pub(super) struct SensorClock {
    rows: usize,
    /// Number of rows between two readings; `None` if the sensor is at least as fast as the table.
    rows_per_reading: Option<f64>,
    lag_rows: f64,
    hold: bool,
}

impl SensorClock {
    /// The sampling for a table of `rows` rows at `rate_hz`; a sensor whose delays are switched off reads without
    /// delay.
    pub(super) fn new(sampling: &SensorSampling, rows: usize, rate_hz: f64, on: bool) -> SensorClock {
        let own_hz = sampling.rate_hz.filter(|own| on && *own < rate_hz * (1.0 - 1e-9));
        let lag_rows = if on { sampling.lag_s * rate_hz } else { 0.0 };
        SensorClock { rows, rows_per_reading: own_hz.map(|own| rate_hz / own), lag_rows, hold: sampling.hold }
    }

    /// Whether the rows of the table are the readings of the sensor, without lag.
    pub(super) fn is_the_tables(&self) -> bool {
        self.rows_per_reading.is_none() && self.lag_rows == 0.0
    }

    /// Values of `x` in the table, as the sensor reads them. `x` has one value per row of the table.
    pub(super) fn read(&self, x: &[f64]) -> Vec<f64> {
        self.spread(|row| interpolate(x, row - self.lag_rows))
    }

    /// The values in the table. `sample` returns the reading at a row, which may be fractional; it is called for the
    /// readings in order.
    pub(super) fn spread(&self, mut sample: impl FnMut(f64) -> f64) -> Vec<f64> {
        let Some(step) = self.rows_per_reading else { return (0..self.rows).map(|i| sample(i as f64)).collect() };
        let readings = (self.rows as f64 / step).ceil() as usize + 2;
        let y: Vec<f64> = (0..readings).map(|k| sample(k as f64 * step)).collect();
        let at = |i: usize| {
            // Because of rounding, a row could otherwise be placed before the time of its reading.
            let place = i as f64 / step + 1e-9;
            let (k, share) = (place.floor() as usize, place.fract());
            if self.hold || share < 1e-8 { y[k] } else { y[k] + (y[k + 1] - y[k]) * share }
        };
        (0..self.rows).map(at).collect()
    }
}

/// Value of `x` between two samples, from the cubic polynomial through four samples. Beyond the ends, the value at the
/// end is used.
fn interpolate(x: &[f64], at: f64) -> f64 {
    let last = x.len().saturating_sub(1);
    let at = at.clamp(0.0, last as f64);
    let (k, t) = (at.floor() as usize, at.fract());
    if t == 0.0 {
        return x[k];
    }
    if k == 0 || k + 2 > last {
        return x[k] + t * (x[k + 1] - x[k]);
    }
    let weights = [
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -(t + 1.0) * t * (t - 2.0) / 2.0,
        (t + 1.0) * t * (t - 1.0) / 6.0,
    ];
    weights.iter().zip(&x[k - 1..]).map(|(w, x)| w * x).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clock(rate_hz: Option<f64>, lag_s: f64, hold: bool) -> SensorClock {
        SensorClock::new(&SensorSampling { rate_hz, lag_s, hold }, 201, 10.0, true)
    }

    #[test]
    fn law_a_lagging_sensor_reads_the_past() {
        let x: Vec<f64> = (0..201).map(|i| (0.07 * f64::from(i)).sin()).collect();
        let late = clock(None, 0.25, false).read(&x);
        for (i, late) in late.iter().enumerate().take(195).skip(5) {
            // The cubic's error: 0.07⁴ / 24 times 9/16.
            assert!((late - (0.07 * (i as f64 - 2.5)).sin()).abs() < 1e-6, "{i}");
        }
        assert_eq!(clock(None, 0.0, false).read(&x), x);
        assert!(clock(Some(10.0), 0.0, false).is_the_tables() && !clock(Some(9.0), 0.0, false).is_the_tables());
    }

    #[test]
    fn law_a_slow_sensor_is_held_or_interpolated() {
        let x: Vec<f64> = (0..201).map(f64::from).collect();
        let held = clock(Some(2.0), 0.0, true).read(&x);
        let between = clock(Some(2.0), 0.0, false).read(&x);
        for i in 0..201 {
            assert_eq!(held[i], f64::from(u32::try_from(i / 5 * 5).unwrap_or(0)), "{i}");
            // A straight line is interpolated exactly, except at the end, where the last reading is repeated.
            assert!(i > 195 || (between[i] - x[i]).abs() < 1e-6, "{i}");
        }
        // One random number per reading, and no random numbers between readings.
        let mut draws = 0;
        clock(Some(2.0), 0.0, true).spread(|_| {
            draws += 1;
            0.0
        });
        assert_eq!(draws, 43);
    }
}
