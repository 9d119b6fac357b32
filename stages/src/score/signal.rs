//! Metrics of a compensated signal.

use numerics::{
    compensation::figure_of_merit::{figure_of_merit, manoeuvres},
    earth::geodesy::EarthModel,
    maps::{
        anomaly_retention::{RetentionError, anomaly_retention},
        crossings::figure_of_merit_crossings,
    },
    regression::statistics::{self, SampleStatistic},
    signal::segments::{RowMask, filter_column},
};
use schemas::{Fault, metric::MetricDisplay};

use super::{
    line::{CompensationSignals, ScoreLine},
    metric::metric,
    source::ScoreSource,
};
use crate::{
    bandpass::design,
    columns::{data, even_rate_hz},
};

metric! {
    /// standard deviation (divisor n - 1) of compensated minus truth; a constant error has no effect
    STD_ERROR = "std_error", unit "nT", pool Rms, better Lower,
    shown MetricDisplay::column(20, 130).rank(20).heat_map(), baseline STD_UNCOMPENSATED "uncompensated",
    needs [Signal, Truth];
    |line| line.error().map(|e| SampleStatistic { value: e.std, n: e.n })
}

metric! {
    /// mean of compensated minus truth
    BIAS_ERROR = "bias_error", unit "nT", pool Mean, better Neither, needs [Signal, Truth];
    |line| line.error().map(|e| SampleStatistic { value: e.mean, n: e.n })
}

metric! {
    /// root mean square (divisor n) of compensated minus truth, including a constant error
    RMS_ERROR = "rms_error", unit "nT", pool Rms, better Lower, needs [Signal, Truth];
    |line| line.error().map(|e| SampleStatistic { value: e.rms, n: e.n })
}

metric! {
    /// standard deviation (divisor n - 1) of uncompensated minus truth or, without `truth`, of the uncompensated signal
    /// itself
    STD_UNCOMPENSATED = "std_uncompensated", unit "nT", pool Rms, better Neither,
    shown MetricDisplay::column(10, 20), needs [Signal, Aircraft], uses [Truth];
    |line| Ok(statistics::std(&line.signals()?.before_nt))
}

metric! {
    /// `std_uncompensated` divided by the same quantity for the compensated signal; a value above 1 means that
    /// compensation reduces the error
    IMPROVEMENT_RATIO = "improvement_ratio", unit "1", pool Mean, better Higher,
    shown MetricDisplay::column(30, 90).rank(40), needs [Signal, Aircraft], uses [Truth];
    |line| line.signals().map(|s| statistics::improvement_ratio(&s.before_nt, &s.after_nt))
}

metric! {
    /// `improvement_ratio` of both signals after a band-pass filter from `low_hz` to `high_hz`
    IMPROVEMENT_RATIO_BAND = "improvement_ratio_band", unit "1", pool Mean, better Higher,
    shown MetricDisplay::column(40, 60).rank(30), needs [Signal, Aircraft], uses [Truth];
    improvement_ratio_band
}

metric! {
    /// standard deviation of the true anomaly (truth minus `igrf` and `diurnal`; without `igrf`, truth minus a straight
    /// line fitted over time) divided by the standard deviation of compensated minus truth
    SNR = "snr", unit "1", pool Mean, better Higher,
    shown MetricDisplay::column(50, 30), needs [Signal, Truth], uses [Core, Diurnal];
    |line| {
        let (mag, truth) = (line.column(ScoreSource::Signal)?, line.column(ScoreSource::Truth)?);
        Ok(statistics::signal_to_noise(mag, truth, &line.true_anomaly()?))
    }
}

metric! {
    /// slope of a straight line fitted to the compensated signal (minus core field and diurnal variation) as a function
    /// of the true anomaly; 1 if compensation keeps the whole anomaly; `n`, the weight of the line, is the sum of
    /// squares of the anomaly about its mean, in nT^2; null for a line with at most two independent samples
    ANOMALY_RETENTION = "anomaly_retention", unit "1", pool Mean, better Near(1.0),
    shown MetricDisplay::column(60, 80), limit AtLeast(0.9), needs [Signal, Anomaly, Core], uses [Diurnal];
    |line| Ok(retention(line)?.0)
}

metric! {
    /// standard error of `anomaly_retention`, which allows for the autocorrelation of the residual and the anomaly;
    /// pooled: standard error of the pooled slope; retentions within two standard errors of each other are
    /// indistinguishable
    ANOMALY_RETENTION_SE = "anomaly_retention_se", unit "1", pool Error, better Neither,
    shown MetricDisplay::column(62, 78), needs [Signal, Anomaly, Core], uses [Diurnal];
    |line| Ok(retention(line)?.1)
}

metric! {
    /// Noriega's index of a calibration box: mean peak-to-peak amplitude of the band-passed compensated signal, summed
    /// over the twelve manoeuvres (pitch, roll and yaw on four headings); null unless all twelve are present
    FIGURE_OF_MERIT = "figure_of_merit", unit "nT", pool Rms, better Lower,
    shown MetricDisplay::column(70, 40), needs [Signal, Attitude];
    of_manoeuvres
}

metric! {
    /// crossing error of Lee 2019: root mean square difference of the compensated signal between samples at most 1 m
    /// and more than 1 s apart, where the track crosses itself; n counts pairs
    FIGURE_OF_MERIT_CROSSINGS = "figure_of_merit_crossings", unit "nT", pool Rms, better Lower,
    shown MetricDisplay::column(80, 50).rank(50), needs [Signal, Position];
    at_crossings
}

fn improvement_ratio_band(line: &ScoreLine) -> Result<SampleStatistic, Fault> {
    let tt = line.tt()?;
    let CompensationSignals { before_nt, after_nt } = line.signals()?;
    let rate_hz = even_rate_hz(tt)?;
    let Some(filter) = design(line.stage.low_hz, line.stage.high_hz, line.stage.order, rate_hz)? else {
        return Ok(statistics::improvement_ratio(before_nt, after_nt));
    };
    let runs = RowMask::all(tt.len()).and_finite(before_nt).and_finite(after_nt).runs_in_time(tt, rate_hz);
    let banded = |x: &[f64]| filter_column(&filter, x, &runs).map(|(y, _)| y).map_err(data);
    Ok(statistics::improvement_ratio(&banded(before_nt)?, &banded(after_nt)?))
}

/// Retention and its standard error, weighted by the energy of the anomaly.
fn retention(line: &ScoreLine) -> Result<(SampleStatistic, SampleStatistic), Fault> {
    let anomaly = line.column(ScoreSource::Anomaly)?;
    // The true reading minus core field and diurnal variation is the anomaly.
    let found = match anomaly_retention(&line.measured_anomaly()?, anomaly, anomaly) {
        Ok(found) if found.standard_error.is_finite() => found,
        Ok(_) | Err(RetentionError::TooFew { .. } | RetentionError::NoAnomaly { .. }) => {
            let none = || SampleStatistic { value: f64::NAN, n: 0 };
            return Ok((none(), none()));
        }
        Err(other) => return Err(data(other)),
    };
    let energy_nt2 = (found.n as f64 * found.anomaly_nt * found.anomaly_nt).round().max(1.0) as usize;
    let figure = |value: f64| SampleStatistic { value, n: energy_nt2 };
    Ok((figure(found.slope), figure(found.standard_error)))
}

fn of_manoeuvres(line: &ScoreLine) -> Result<SampleStatistic, Fault> {
    let (tt, angles) = (line.tt()?, line.columns(ScoreSource::Attitude)?);
    let found = manoeuvres(tt, [angles[0], angles[1], angles[2]]);
    if found.len() < 12 {
        return Ok(SampleStatistic { value: f64::NAN, n: found.len() });
    }
    let mag = line.column(ScoreSource::Signal)?;
    let rate_hz = even_rate_hz(tt)?;
    let runs = RowMask::all(tt.len()).and_finite(mag).runs_in_time(tt, rate_hz);
    match design(line.stage.low_hz, line.stage.high_hz, line.stage.order, rate_hz)? {
        None => Ok(figure_of_merit(mag, &found)),
        Some(filter) => Ok(figure_of_merit(&filter_column(&filter, mag, &runs).map_err(data)?.0, &found)),
    }
}

fn at_crossings(line: &ScoreLine) -> Result<SampleStatistic, Fault> {
    let (lat, lon) = line.position()?;
    let Some(start) = (0..lat.len()).find(|i| lat[*i].is_finite() && lon[*i].is_finite()) else {
        return Ok(SampleStatistic { value: f64::NAN, n: 0 });
    };
    let place = |i: usize| EarthModel::default().offset_ne_m((lat[start], lon[start]), (lat[i], lon[i]), 0.0);
    let (north, east): (Vec<f64>, Vec<f64>) = (0..lat.len()).map(place).unzip();
    Ok(figure_of_merit_crossings(&north, &east, line.column(ScoreSource::Signal)?, line.tt()?).figure)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::testing::{TRUE_POSITION, seconds, value};

    const TURN: [f64; 4] = [1.0, -1.0, -1.0, 1.0];

    #[test]
    fn law_a_constant_error_has_a_bias_and_no_standard_deviation() {
        let truth = seconds(40, |t| 52_000.0 + t);
        let mag = seconds(40, |t| 52_003.0 + t);
        let tables = [vec![("mag_c", mag), ("mag_1_c", truth)]];
        assert_eq!(value(&BIAS_ERROR, &tables), SampleStatistic { value: 3.0, n: 40 });
        assert_eq!(value(&RMS_ERROR, &tables), SampleStatistic { value: 3.0, n: 40 });
        assert_eq!(value(&STD_ERROR, &tables), SampleStatistic { value: 0.0, n: 40 });
    }

    #[test]
    fn law_an_error_reduced_to_a_fifth_has_an_improvement_ratio_of_five() {
        // The error has no mean and no slope over four samples, so it does not affect the estimated truth.
        let error = |scale: f64| seconds(40, move |t| scale * TURN[t as usize % 4]);
        let truth = seconds(40, |t| 52_000.0 + 10.0 * TURN[t as usize / 10]);
        let mag = truth.iter().zip(error(1.0)).map(|(t, e)| t + e).collect();
        let tables = [vec![("mag_c", mag), ("mag_1_c", truth), ("mag_aircraft", error(4.0))]];
        assert!((value(&IMPROVEMENT_RATIO, &tables).value - 5.0).abs() < 1e-12);
        assert!((value(&STD_UNCOMPENSATED, &tables).value / value(&STD_ERROR, &tables).value - 5.0).abs() < 1e-12);
        // The amplitudes are 10 (anomaly) and 1 (error). The truth has no linear trend.
        assert!((value(&SNR, &tables).value - 10.0).abs() < 1e-12);
    }

    #[test]
    fn law_half_of_the_anomaly_is_a_retention_of_one_half() {
        let anomaly = seconds(200, |t| 30.0 * (0.2 * t).sin());
        let core = seconds(200, |t| 52_000.0 + 0.1 * t);
        let mag = anomaly.iter().zip(&core).map(|(a, c)| c + 0.5 * a).collect();
        let tables = [vec![("mag_c", mag), ("igrf", core), ("anomaly_truth", anomaly)]];
        // Rounding error at 52,000 nT.
        assert!((value(&ANOMALY_RETENTION, &tables).value - 0.5).abs() < 1e-9);
    }

    #[test]
    fn law_the_crossing_error_is_the_difference_of_repeated_signals() {
        let there = seconds(40, |t| 0.0001 * (t % 20.0));
        let mag = seconds(40, |t| if t < 20.0 { 52_000.0 } else { 52_004.0 });
        let tables = [vec![("mag_c", mag), (TRUE_POSITION[0], there), (TRUE_POSITION[1], seconds(40, |_| 8.0))]];
        assert_eq!(value(&FIGURE_OF_MERIT_CROSSINGS, &tables), SampleStatistic { value: 4.0, n: 20 });
    }

    #[test]
    fn unit_without_all_manoeuvres_there_is_no_figure_of_merit() {
        let level = || seconds(40, |_| 0.0);
        let tables = [vec![("mag_c", level()), ("roll", level()), ("pitch", level()), ("yaw", level())]];
        assert!(value(&FIGURE_OF_MERIT, &tables).value.is_nan());
    }
}
