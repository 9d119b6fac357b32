//! The compensated signal of one line: its error over time and over frequency.

use figures::{
    chart::{ChartAxis, ChartLine, LineChart},
    decimate::{MOST, extremes},
};
use maud::Markup;
use numerics::{
    regression::statistics::{self, summary},
    signal::{
        filter::{FilterBand, ZeroPhaseFilter},
        segments::{RowMask, STEP_TOLERANCE, filter_column, sample_rate},
        spectrum::{SpectralTaper, welch},
    },
};
use plan::{LineId, TableRef};
use results::text::number;
use schemas::Fault;

use super::{source::ReportSource, subject::ReportSubject};

/// A signal before and after compensation, each about its mean.
struct CompensationSignal {
    tt: Vec<f64>,
    before: Vec<f64>,
    after: Vec<f64>,
    /// The column of the truth that was subtracted.
    truth: Option<String>,
    means: (f64, f64),
}

/// The plots of one line; no plots without compensation.
///
/// # Errors
/// Fails if the store is damaged.
pub fn plots(source: &ReportSource, subject: &ReportSubject, line: LineId) -> Result<Vec<Markup>, Fault> {
    let Some(signal) = read(source, subject, line)? else { return Ok(vec![]) };
    let band = pass_band(source, subject);
    let second = if signal.truth.is_some() { Some(after(&signal)) } else { band.and_then(|b| within(&signal, b)) };
    let charts = [Some(both(&signal, band)), second, spectra(&signal, band)];
    Ok(charts.into_iter().flatten().filter_map(|c| c.draw()).collect())
}

fn read(source: &ReportSource, subject: &ReportSubject, line: LineId) -> Result<Option<CompensationSignal>, Fault> {
    let Some(r) = subject.compensate else { return Ok(None) };
    let column = |name: &str| source.floats(r, line, name);
    let (Some(tt), Some(mut after), Some(aircraft)) = (column("tt")?, column("mag_c")?, column("mag_aircraft")?) else {
        return Ok(None);
    };
    let truth = match &subject.truth {
        Some(name) => column(name)?.map(|t| (name.clone(), t)),
        None => None,
    };
    if let Some((_, truth)) = &truth {
        after.iter_mut().zip(truth).for_each(|(m, t)| *m -= t);
    }
    let mut before: Vec<f64> = after.iter().zip(&aircraft).map(|(m, a)| m + a).collect();
    let means = (centre(&mut before), centre(&mut after));
    Ok(Some(CompensationSignal { tt, before, after, truth: truth.map(|t| t.0), means }))
}

/// Subtracts the mean from the values and returns the mean.
fn centre(x: &mut [f64]) -> f64 {
    let mean = statistics::mean(x).value;
    x.iter_mut().for_each(|x| *x -= mean);
    mean
}

/// Time since the first sample, in minutes.
pub fn minutes(tt: &[f64]) -> Vec<f64> {
    let start = tt.first().copied().unwrap_or(0.0);
    tt.iter().map(|t| (t - start) / 60.0).collect()
}

/// Horizontal axis of all plots over time.
pub fn time_axis() -> ChartAxis {
    ChartAxis::new("time since the start of the line, min")
}

impl CompensationSignal {
    fn quantity(&self) -> &'static str {
        if self.truth.is_some() { "error, nT" } else { "signal minus its mean, nT" }
    }

    fn line(&self, name: &str, class: &'static str, y: &[f64]) -> ChartLine {
        ChartLine { name: name.to_owned(), class, points: extremes(&minutes(&self.tt), y, MOST) }
    }
}

fn both(signal: &CompensationSignal, band: Option<PassBand>) -> LineChart {
    let (uncompensated, compensated) = (summary(&signal.before), summary(&signal.after));
    let of = match &signal.truth {
        Some(truth) => format!("Signal minus the truth {truth}, before and after compensation"),
        None => "Signal before and after compensation. There is no truth, so both include the anomaly".to_owned(),
    };
    let reason = if band.is_some() { ", because a fit to band-passed data does not determine the bias" } else { "" };
    let caption = format!(
        "{of}. Compensation changes the standard deviation from {} to {} nT. The means of {} and {} nT are \
         subtracted{reason}. The plot shows the minimum and maximum of each interval, so it keeps spikes.",
        number(Some(uncompensated.std)),
        number(Some(compensated.std)),
        number(Some(signal.means.0)),
        number(Some(signal.means.1)),
    );
    LineChart {
        title: "Before and after compensation".into(),
        caption,
        x: time_axis(),
        y: ChartAxis::new(signal.quantity()),
        lines: vec![
            signal.line("uncompensated", "before", &signal.before),
            signal.line("compensated", "after", &signal.after),
        ],
        height: 270.0,
        ..LineChart::default()
    }
}

fn after(signal: &CompensationSignal) -> LineChart {
    let caption =
        "The compensated signal of the plot above, enlarged. This residual is the measurement noise of navigation.";
    LineChart {
        title: "After compensation, enlarged".into(),
        caption: caption.into(),
        x: time_axis(),
        y: ChartAxis::new(signal.quantity()),
        lines: vec![signal.line("compensated", "after", &signal.after)],
        height: 220.0,
        ..LineChart::default()
    }
}

/// Pass band of the fit.
#[derive(Clone, Copy)]
struct PassBand {
    low_hz: f64,
    high_hz: f64,
    order: usize,
}

/// The pass band of the model's fit, if the filter has both corners.
fn pass_band(source: &ReportSource, subject: &ReportSubject) -> Option<PassBand> {
    let Some(TableRef::Stage(t, i)) = subject.fit else { return None };
    let params = source.graph.plan.instance(t, i).params();
    let value = |name: &str| params.iter().find(|(n, _)| *n == name).map(|(_, v)| v.as_str());
    let hz = |name: &str| value(name).and_then(|v| v.parse::<f64>().ok());
    let band = PassBand {
        low_hz: hz("low_hz")?,
        high_hz: hz("high_hz")?,
        order: value("order").and_then(|v| v.parse().ok())?,
    };
    Some(band).filter(|b| b.low_hz > 0.0 && b.low_hz < b.high_hz)
}

/// The signal before and after compensation within the pass band. Without a truth, only this band separates the
/// aircraft field from the anomaly.
fn within(signal: &CompensationSignal, band: PassBand) -> Option<LineChart> {
    let rate_hz = sample_rate(&signal.tt, STEP_TOLERANCE).ok()?;
    let filter =
        ZeroPhaseFilter::new(FilterBand::between(Some(band.low_hz), Some(band.high_hz)).ok()?, rate_hz, band.order)
            .ok()?;
    let passed = |x: &[f64]| {
        let runs = RowMask::all(x.len()).and_finite(x).runs_in_time(&signal.tt, rate_hz);
        filter_column(&filter, x, &runs).ok().map(|(y, _)| y)
    };
    let (before, after) = (passed(&signal.before)?, passed(&signal.after)?);
    let std = |x: &[f64]| number(Some(summary(x).std));
    let caption = format!(
        "The same signals between {} and {} Hz, the pass band of the fit. Without a truth, manoeuvres and anomaly are \
         separated best in this band. Compensation changes the standard deviation from {} to {} nT.",
        band.low_hz,
        band.high_hz,
        std(&before),
        std(&after)
    );
    Some(LineChart {
        title: "Before and after, in the pass band of the fit".into(),
        caption,
        x: time_axis(),
        y: ChartAxis::new("band-passed signal, nT"),
        lines: vec![signal.line("uncompensated", "before", &before), signal.line("compensated", "after", &after)],
        height: 250.0,
        ..LineChart::default()
    })
}

/// Segment length in samples: the largest power of two within a quarter of the line, but at most 1024 (about 100 s at
/// 10 Hz).
fn segment(rows: usize) -> usize {
    let quarter = (rows / 4).max(2);
    (1usize << quarter.ilog2()).min(1024)
}

fn spectra(signal: &CompensationSignal, band: Option<PassBand>) -> Option<LineChart> {
    let rate_hz = sample_rate(&signal.tt, STEP_TOLERANCE).ok()?;
    let length = segment(signal.tt.len());
    let of = |name: &str, class: &'static str, x: &[f64]| {
        let spectrum = welch(x, rate_hz, length, SpectralTaper::Hann).ok()?;
        let points = spectrum.frequency_hz.iter().copied().zip(spectrum.density).skip(1).collect();
        Some((ChartLine { name: name.to_owned(), class, points }, spectrum.segments))
    };
    let (before, segments) = of("uncompensated", "before", &signal.before)?;
    let (after, _) = of("compensated", "after", &signal.after)?;
    let what = if signal.truth.is_some() { "error" } else { "signal" };
    let shaded = if band.is_some() {
        " The shaded band is the pass band of the fit. Compensation should reduce the density in this band."
    } else {
        ""
    };
    Some(LineChart {
        title: format!("Power spectral density of the {what}"),
        caption: format!(
            "Welch's method: {segments} segments of {length} samples, Hann window, overlapping by half.{shaded}"
        ),
        x: ChartAxis::new("frequency, Hz").log(),
        y: ChartAxis::new("density, nT²/Hz").log(),
        lines: vec![before, after],
        stretch: band.map(|b| ("pass band of the fit".to_owned(), b.low_hz, b.high_hz)),
        height: 280.0,
        ..LineChart::default()
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::f64::consts::TAU;

    use super::*;

    const BAND: PassBand = PassBand { low_hz: 0.1, high_hz: 0.9, order: 4 };

    fn signal() -> CompensationSignal {
        let tt: Vec<f64> = (0..4000).map(|k| 100.0 + f64::from(k) / 10.0).collect();
        let before: Vec<f64> = tt.iter().map(|t| 50.0 * (TAU * 0.5 * t).sin()).collect();
        let after = before.iter().map(|x| x / 10.0).collect();
        CompensationSignal { tt, before, after, truth: None, means: (0.0, 0.0) }
    }

    #[test]
    fn law_a_tenth_of_the_signal_has_a_hundredth_of_the_density() {
        let chart = spectra(&signal(), Some(BAND)).unwrap();
        let peak = |l: &ChartLine| l.points.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        let (before, after) = (peak(&chart.lines[0]), peak(&chart.lines[1]));
        assert!((before.0 - 0.5).abs() < 0.02, "the line is at 0.5 Hz: {before:?}");
        // `after` is a tenth of `before`, so the ratio is exact except for rounding.
        assert!((before.1 / after.1 - 100.0).abs() < 1e-9);
    }

    #[test]
    fn unit_the_mean_is_removed_and_time_starts_at_zero() {
        let mut x = vec![1.0, f64::NAN, 3.0];
        assert_eq!(centre(&mut x), 2.0);
        assert_eq!((x[0], x[2]), (-1.0, 1.0));
        assert_eq!(minutes(&[60.0, 120.0]), [0.0, 1.0]);
        assert_eq!((segment(8000), segment(1000), segment(3)), (1024, 128, 2));
    }

    #[test]
    fn unit_the_caption_has_the_figures_of_the_drawn_lines() {
        let text = both(&signal(), Some(BAND)).caption;
        assert!(text.contains("band-passed data") && !both(&signal(), None).caption.contains("band-passed"), "{text}");
        assert!(text.contains("from 35.36 to 3.536 nT"), "{text}");
    }

    #[test]
    fn unit_the_pass_band_excludes_the_anomaly() {
        let mut slow = signal();
        let drift: Vec<f64> = slow.tt.iter().map(|t| 3.0 * t).collect();
        slow.before.iter_mut().zip(&drift).for_each(|(x, d)| *x += d);
        let drawn = within(&slow, BAND).unwrap();
        let highest = drawn.lines[0].points.iter().map(|p| p.1.abs()).fold(0.0, f64::max);
        // The filter removes a drift of 1200 nT and keeps the 50 nT at 0.5 Hz. The filter overshoots slightly at the
        // ends.
        assert!((49.0..70.0).contains(&highest), "{highest}");
    }
}
