//! Whiteness of a filter's innovations, and their size relative to the size that the filter predicts.

use figures::chart::{ChartAxis, ChartBand, ChartLine, LineChart};
use maud::{Markup, html};
use numerics::regression::{
    consistency::{autocorrelation, normalised_innovations, whiteness},
    statistics::{self, SampleStatistic},
};
use results::text::number;

use super::{
    signal::{minutes, time_axis},
    track::LineTracks,
};

/// Two-sided 95 % quantile of the normal distribution.
pub const Z95: f64 = 1.959_963_985;
/// Number of lags that the metric `whiteness` evaluates.
const COUNTED: usize = 20;
/// Approximate number of lags of a plot.
const LAGS: usize = 80;
/// The height of both plots.
const HEIGHT: f64 = 250.0;

/// The plots of one line, with the title `place`; `None` without innovations.
pub fn plot(line_tracks: &LineTracks, place: &str) -> Option<Markup> {
    let found = normalised(line_tracks)?;
    let parts: Vec<Markup> =
        [found.correlogram(), found.nis()].into_iter().flatten().filter_map(|c| c.part()).collect();
    (!parts.is_empty()).then(|| {
        html! { figure { h4 { "Whiteness of the innovations: " (place) } div.pair { @for part in &parts { (part) } } } }
    })
}

/// Innovations divided by their predicted standard deviations, one for each update.
struct NormalisedInnovations {
    minutes: Vec<f64>,
    x: Vec<f64>,
    /// Seconds between updates.
    step_s: f64,
    /// The mean of the squared innovations over the line.
    nis: f64,
}

fn normalised(line_tracks: &LineTracks) -> Option<NormalisedInnovations> {
    let (residual, nis) = (line_tracks.residual.as_ref()?, line_tracks.nis.as_ref()?);
    let all = normalised_innovations(residual, nis);
    let there: Vec<usize> = (0..all.len()).filter(|k| all[*k].is_finite()).collect();
    // A filter with an update every n samples has no innovations in between, so lags are counted in updates.
    let mut gaps: Vec<usize> = there.windows(2).map(|w| w[1] - w[0]).collect();
    let middle = gaps.len() / 2;
    let every = if gaps.is_empty() { return None } else { *gaps.select_nth_unstable(middle).1 };
    let first = *there.first()?;
    let x = all.into_iter().skip(first).step_by(every).collect();
    let minutes = minutes(&line_tracks.tt).into_iter().skip(first).step_by(every).collect();
    let (from, to) = (line_tracks.tt.first()?, line_tracks.tt.last()?);
    let step_s = every as f64 * (to - from) / (line_tracks.tt.len() - 1) as f64;
    (step_s.is_finite() && step_s > 0.0).then_some(NormalisedInnovations {
        minutes,
        x,
        step_s,
        nis: statistics::mean(nis).value,
    })
}

/// Lags from 1 to `last`, in updates: first consecutive, then increasingly far apart.
fn lags(last: usize) -> Vec<usize> {
    let spread = |k: usize| (last as f64).powf(k as f64 / LAGS as f64).round() as usize;
    let mut lags: Vec<usize> = (0..=LAGS).map(spread).chain(1..=COUNTED.min(last)).collect();
    lags.sort_unstable();
    lags.dedup();
    lags
}

impl NormalisedInnovations {
    fn correlogram(&self) -> Option<LineChart> {
        let (x, step_s) = (&self.x, self.step_s);
        let last = (x.len() / 10).max(1);
        let found: Vec<(f64, SampleStatistic)> =
            lags(last).into_iter().map(|k| (k as f64 * step_s, autocorrelation(x, k))).collect();
        let known = || found.iter().filter(|(_, r)| r.value.is_finite()).copied();
        let points: Vec<(f64, f64)> = known().map(|(lag, r)| (lag, r.value)).collect();
        let half = |r: SampleStatistic| Z95 / (r.n as f64).sqrt();
        let band = known().map(|(lag, r)| (lag, -half(r), half(r))).collect();
        if points.len() < 2 {
            return None;
        }
        let white = known().filter(|(_, r)| r.value.abs() <= half(*r)).count();
        let counted = whiteness(x, COUNTED).value;
        let caption = format!(
            "Autocorrelation of the innovations divided by their predicted standard deviation, without subtracting \
             the mean; {} s between samples. For white innovations, 95 % of the lags are within ±1.96/√n. Here {:.0} \
             % of the plotted lags and {} of the first {COUNTED} lags are within this band. A positive \
             autocorrelation indicates correlated noise, or an error of the map or compensation, that the filter \
             treats as white.",
            number(Some(step_s)),
            100.0 * white as f64 / points.len() as f64,
            if counted.is_nan() { "too few".to_owned() } else { format!("{:.0} %", 100.0 * counted) },
        );
        Some(LineChart {
            title: "Autocorrelation".into(),
            caption,
            x: ChartAxis::new("lag, s").log(),
            y: ChartAxis::new("autocorrelation"),
            bands: vec![ChartBand { name: "95 % bounds for white noise".into(), points: band }],
            lines: vec![ChartLine { name: "innovations".into(), class: "after", points }],
            height: HEIGHT,
            half: true,
            ..LineChart::default()
        })
    }

    fn nis(&self) -> Option<LineChart> {
        let nis: Vec<f64> = self.x.iter().map(|x| x * x).collect();
        let window = (nis.len() / 200).max(10);
        let points = window_means(&self.minutes, &nis, window);
        let (low, high) = mean_square_band(window as f64);
        let largest = points.iter().map(|p| p.1).fold(0.0, f64::max);
        let caption = format!(
            "Normalised innovation squared: means over {window} updates. For independent innovations of the predicted \
             variance, 95 % of the means are between {} and {}. Means above this band indicate that the assumed noise \
             is too small. Means below it indicate that it is too large. The mean of the line is {}.",
            number(Some(low)),
            number(Some(high)),
            number(Some(self.nis)),
        );
        Some(LineChart {
            title: "NIS".into(),
            caption,
            x: time_axis(),
            // Means near the expected value need no logarithmic axis. If some means are much larger, the other means
            // and the band are visible only on a logarithmic axis.
            y: ChartAxis { log: largest > 4.0 * high, ..ChartAxis::new("mean NIS") },
            lines: vec![ChartLine { name: format!("mean over {window} updates"), class: "after", points }],
            levels: vec![("95 % band".into(), low), (String::new(), high)],
            height: HEIGHT,
            half: true,
            ..LineChart::default()
        })
    }
}

/// The 95 % band of the mean of `n` squared standard normal variables (Wilson and Hilferty 1931).
fn mean_square_band(n: f64) -> (f64, f64) {
    let spread = 2.0 / (9.0 * n);
    let at = |z: f64| (1.0 - spread + z * spread.sqrt()).max(0.0).powi(3);
    (at(-Z95), at(Z95))
}

/// Means over windows of `window` samples; NaN for a window in which fewer than half of the samples have values.
fn window_means(time: &[f64], x: &[f64], window: usize) -> Vec<(f64, f64)> {
    let mean = |(t, x): (&[f64], &[f64])| {
        let figure = statistics::mean(x);
        let there = 2 * figure.n >= window;
        (t.get(t.len() / 2).copied().unwrap_or(f64::NAN), if there { figure.value } else { f64::NAN })
    };
    time.chunks(window).zip(x.chunks(window)).map(mean).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use numerics::random::NormalGenerator;

    use super::*;
    use crate::html::track::DegreeTrack;

    /// Innovations with a standard deviation of 5 nT and a correlation of `decay` between successive innovations; there
    /// is one innovation in `every` samples, which are 0.1 s apart.
    fn example_tracks(updates: usize, decay: f64, every: usize) -> LineTracks {
        let mut normals = NormalGenerator::new(3);
        let (mut x, step) = (normals.draw(), (1.0 - decay * decay).sqrt());
        let rows = updates * every;
        let (mut residual, mut nis) = (vec![f64::NAN; rows], vec![f64::NAN; rows]);
        for k in (0..rows).step_by(every) {
            (residual[k], nis[k]) = (5.0 * x, x * x);
            x = decay * x + step * normals.draw();
        }
        LineTracks {
            tt: (0..rows).map(|k| k as f64 / 10.0).collect(),
            truth: None,
            ins: None,
            estimate: DegreeTrack { lat: vec![0.0; rows], lon: vec![0.0; rows] },
            sigma: None,
            residual: Some(residual),
            nis: Some(nis),
        }
    }

    #[test]
    fn law_white_innovations_are_within_the_band_and_correlated_ones_are_not() {
        let share = |decay: f64| {
            let chart = normalised(&example_tracks(10_000, decay, 1)).unwrap().correlogram().unwrap();
            let within = |(p, b): &(&(f64, f64), &(f64, f64, f64))| p.0 == b.0 && (b.1..=b.2).contains(&p.1);
            let (points, band) = (&chart.lines[0].points, &chart.bands[0].points);
            points.iter().zip(band).filter(within).count() as f64 / points.len() as f64
        };
        // For about 90 lags the expected share is 95 % with a standard deviation of 2 %. With a decay of 0.9 the
        // correlation is visible up to a lag of 40 samples, which is half of the lags plotted on a logarithmic axis.
        assert!(share(0.0) > 0.88, "{}", share(0.0));
        assert!(share(0.9) < 0.6, "{}", share(0.9));
    }

    #[test]
    fn unit_the_band_is_that_of_white_noise_and_lags_are_in_seconds() {
        let chart = normalised(&example_tracks(1000, 0.8, 1)).unwrap().correlogram().unwrap();
        assert_eq!(chart.lines[0].points[0].0, 0.1);
        assert!((chart.lines[0].points[0].1 - 0.8).abs() < 0.06, "{:?}", chart.lines[0].points[0]);
        let (lag, low, high) = chart.bands[0].points[0];
        // 1.96 / sqrt(999).
        assert!((lag - 0.1).abs() < 1e-12 && (high - 0.062_01).abs() < 1e-4 && low == -high);
        assert!((chart.lines[0].points.last().unwrap().0 - 10.0).abs() < 1e-9, "to a tenth of the line");
    }

    #[test]
    fn unit_an_update_a_second_has_lags_of_seconds() {
        let found = normalised(&example_tracks(1000, 0.5, 10)).unwrap();
        let (chart, nis) = (found.correlogram().unwrap(), found.nis().unwrap());
        assert!(nis.lines[0].points.len() == 100 && nis.lines[0].points.iter().all(|p| p.1 > 0.0), "ten updates each");
        assert!(
            (chart.lines[0].points[0].0 - 1.0).abs() < 1e-3 && chart.lines[0].points.iter().all(|p| p.1.is_finite())
        );
        assert!((chart.lines[0].points[0].1 - 0.5).abs() < 0.09);
        let mut none = example_tracks(100, 0.0, 1);
        none.residual = Some(vec![f64::NAN; 100]);
        none.nis = none.residual.clone();
        assert!(plot(&none, "").is_none());
        none.nis = None;
        assert!(plot(&none, "").is_none());
    }

    #[test]
    fn unit_both_plots_are_one_figure() {
        let drawn = plot(&example_tracks(1000, 0.0, 1), "flight 1, line 1.02").unwrap().into_string();
        assert_eq!((drawn.matches("<figure>").count(), drawn.matches("<h5>").count()), (1, 2), "{drawn}");
        assert!(drawn.contains("<h4>Whiteness of the innovations: flight 1, line 1.02</h4>"), "{drawn}");
    }

    #[test]
    fn ref_band_of_a_mean_square() {
        // Chi-square quantiles of 100 degrees of freedom: 74.222 and 129.561 (Abramowitz and Stegun, table 26.8).
        let (low, high) = mean_square_band(100.0);
        // For this number of degrees of freedom, the approximation of Wilson and Hilferty is accurate to 3e-4 of the
        // quantile.
        assert!((low - 0.742_22).abs() < 5e-4 && (high - 1.295_61).abs() < 5e-4, "{low} {high}");
    }

    #[test]
    fn unit_a_window_needs_half_of_its_samples() {
        let time: Vec<f64> = (0..6).map(f64::from).collect();
        let nan = f64::NAN;
        let means = window_means(&time, &[1.0, 3.0, nan, nan, nan, 5.0], 3);
        assert_eq!(means[0], (1.0, 2.0));
        assert!(means[1].1.is_nan());
    }
}
