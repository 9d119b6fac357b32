//! The errors of a track, and their consistency with the filter's covariance.

use std::collections::BTreeMap;

use figures::{
    chart::{Band, Chart, Dim, Line},
    decimate::{MOST, envelope, extremes},
};
use maud::Markup;
use numerics::regression::statistics;

use super::{
    signal::{minutes, time_axis},
    track::{Flown, Offsets, nees},
};
use crate::views::text::number;

/// Points of a band.
const BAND_POINTS: usize = 500;
/// The two-sided 95 % of a normal distribution.
const Z95: f64 = 1.959_963_985;

/// The plots of one line. `outcomes` counts the outcomes of its measurements.
pub fn plots(flown: &Flown, outcomes: &BTreeMap<String, usize>) -> Vec<Markup> {
    let mut charts = vec![];
    if let Some(errors) = flown.errors() {
        charts.extend(positions(flown, &errors));
    }
    charts.extend(innovations(flown, outcomes));
    charts.extend(nis(flown));
    if let (Some(errors), Some(sigma)) = (flown.errors(), &flown.sigma) {
        charts.push(nees_chart(&flown.tt, &nees(&errors, sigma)));
    }
    charts.iter().filter_map(Chart::draw).collect()
}

fn positions(flown: &Flown, errors: &Offsets) -> Vec<Chart> {
    let ins = flown.ins_errors();
    let alone = |pick: fn(&Offsets) -> &Vec<f64>| ins.as_ref().map(pick);
    let sigma = |i: usize| flown.sigma.as_ref().map(|s| &s[i]);
    vec![
        position(flown, "North", &errors.north, alone(|o| &o.north), sigma(0)),
        position(flown, "East", &errors.east, alone(|o| &o.east), sigma(1)),
    ]
}

fn position(flown: &Flown, way: &str, error: &[f64], ins: Option<&Vec<f64>>, sigma: Option<&Vec<f64>>) -> Chart {
    let time = minutes(&flown.tt);
    let rms = |x: &[f64]| number(Some(statistics::rms(x).value));
    let mut caption = format!("Estimate less truth: {} m root mean square", rms(error));
    let mut lines = vec![];
    if let Some(ins) = ins {
        caption.push_str(&format!("; the INS alone has {} m", rms(ins)));
        lines.push(Line { name: "INS alone".into(), class: "ins", points: extremes(&time, ins, MOST) });
    }
    caption.push('.');
    lines.push(Line { name: "estimate".into(), class: "after", points: extremes(&time, error, MOST) });
    let mut bands = vec![];
    if let Some(sigma) = sigma {
        caption.push_str(&format!(
            " The error is inside of ±2σ for {} of the time; 95 % is right.",
            share_inside(error, sigma)
        ));
        let points = envelope(&time, sigma, BAND_POINTS).into_iter().map(|(t, s)| (t, -2.0 * s, 2.0 * s)).collect();
        bands.push(Band { name: "±2σ of the filter".into(), points });
    }
    let y = Dim { range: frame(error, ins, sigma), ..Dim::new(format!("error {}, m", way.to_lowercase())) };
    if y.range.is_some() {
        caption.push_str(" The INS alone soon leaves the plot.");
    }
    let title = format!("{way} error");
    Chart { title, caption, x: time_axis(), y, bands, lines, height: 250.0, ..Chart::default() }
}

/// The part of the axis that shows estimate and band, where the INS alone would compress them to a line.
fn frame(error: &[f64], ins: Option<&Vec<f64>>, sigma: Option<&Vec<f64>>) -> Option<(f64, f64)> {
    let largest = |x: &[f64]| x.iter().copied().filter(|v| v.is_finite()).fold(0.0, |a: f64, v| a.max(v.abs()));
    let own = largest(error).max(2.0 * sigma.map_or(0.0, |s| largest(s)));
    (largest(ins?) > 4.0 * own && own > 0.0).then_some((-1.6 * own, 1.6 * own))
}

/// The fraction of errors within two sigma, as text.
fn share_inside(error: &[f64], sigma: &[f64]) -> String {
    let known = error.iter().zip(sigma).filter(|(e, s)| e.is_finite() && s.is_finite());
    let (inside, all) = known.fold((0usize, 0usize), |(i, n), (e, s)| (i + usize::from(e.abs() <= 2.0 * s), n + 1));
    if all == 0 { "none".to_owned() } else { format!("{:.0} %", 100.0 * inside as f64 / all as f64) }
}

fn innovations(flown: &Flown, outcomes: &BTreeMap<String, usize>) -> Option<Chart> {
    let (residual, time) = (flown.residual.as_ref()?, minutes(&flown.tt));
    let mut bands = vec![];
    if let Some(nis) = &flown.nis {
        // The filter keeps r²/S, not S.
        let half: Vec<f64> =
            residual.iter().zip(nis).map(|(r, n)| if *n > 0.0 { Z95 * r.abs() / n.sqrt() } else { f64::NAN }).collect();
        let points = envelope(&time, &half, BAND_POINTS).into_iter().map(|(t, s)| (t, -s, s)).collect();
        bands.push(Band { name: "predicted 95 %".into(), points });
    }
    let counted: Vec<String> =
        outcomes.iter().map(|(outcome, n)| format!("{n} {}", outcome.replace('_', " "))).collect();
    let caption = format!(
        "Measurement less prediction. A consistent filter has them about zero, without a trend, inside of the band for 95 % of \
         the time. Samples: {}.",
        if counted.is_empty() { "not counted".to_owned() } else { counted.join(", ") }
    );
    Some(Chart {
        title: "Innovations".into(),
        caption,
        x: time_axis(),
        y: Dim::new("innovation, nT"),
        bands,
        lines: vec![Line { name: "innovation".into(), class: "after", points: extremes(&time, residual, MOST) }],
        height: 230.0,
        ..Chart::default()
    })
}

/// The 95 % band of the mean of `n` squared standard normals (Wilson and Hilferty 1931).
fn mean_square_band(n: f64) -> (f64, f64) {
    let spread = 2.0 / (9.0 * n);
    let at = |z: f64| (1.0 - spread + z * spread.sqrt()).max(0.0).powi(3);
    (at(-Z95), at(Z95))
}

/// Means over windows of `window` samples; a NaN where fewer than half have values.
fn window_means(time: &[f64], x: &[f64], window: usize) -> Vec<(f64, f64)> {
    let mean = |(t, x): (&[f64], &[f64])| {
        let figure = statistics::mean(x);
        let there = 2 * figure.n >= window;
        (t.get(t.len() / 2).copied().unwrap_or(f64::NAN), if there { figure.value } else { f64::NAN })
    };
    time.chunks(window).zip(x.chunks(window)).map(mean).collect()
}

fn nis(flown: &Flown) -> Option<Chart> {
    let nis = flown.nis.as_ref()?;
    let window = (nis.len() / 200).max(10);
    let points = window_means(&minutes(&flown.tt), nis, window);
    let (low, high) = mean_square_band(window as f64);
    let caption = format!(
        "Normalised innovation squared, mean over {window} samples at a time. For independent innovations of the predicted \
         size 95 % are between {} and {}: above it the measurements are worse than the filter believes, below it they are \
         better. The mean of the line is {}.",
        number(Some(low)),
        number(Some(high)),
        number(Some(statistics::mean(nis).value)),
    );
    Some(Chart {
        title: "NIS".into(),
        caption,
        x: time_axis(),
        y: Dim::new("mean NIS").log(),
        lines: vec![Line { name: format!("mean over {window} samples"), class: "after", points }],
        levels: vec![("95 % band".into(), low), (String::new(), high)],
        height: 220.0,
        ..Chart::default()
    })
}

fn nees_chart(tt: &[f64], nees: &[f64]) -> Chart {
    // Chi-square with two degrees of freedom is an exponential distribution.
    let (low, high) = (-2.0 * 0.975f64.ln(), -2.0 * 0.025f64.ln());
    let caption = format!(
        "Squared horizontal error in units of the filter's covariance. A consistent filter has a mean of 2 and 95 % between \
         {} and {}; above, it is overconfident. Here the mean is {}. Errors of a position last for minutes, so a single \
         line may stay outside for a while.",
        number(Some(low)),
        number(Some(high)),
        number(Some(statistics::mean(nees).value)),
    );
    let points = extremes(&minutes(tt), nees, MOST).into_iter().map(|(t, v)| (t, v.max(1e-3))).collect();
    Chart {
        title: "NEES of the position".into(),
        caption,
        x: time_axis(),
        y: Dim::new("NEES").log(),
        lines: vec![Line { name: "NEES".into(), class: "after", points }],
        levels: vec![("95 % band".into(), low), (String::new(), high)],
        height: 220.0,
        ..Chart::default()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn ref_band_of_a_mean_square() {
        // Chi-square quantiles of 100 degrees of freedom: 74.222 and 129.561 (Abramowitz and Stegun, table 26.8).
        let (low, high) = mean_square_band(100.0);
        // Wilson and Hilferty are good to 3e-4 of the quantile there.
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

    #[test]
    fn unit_a_drifting_ins_does_not_flatten_the_estimate() {
        let sigma = vec![1.0, 2.0];
        assert_eq!(frame(&[1.0, -5.0], Some(&vec![0.0, 100.0]), Some(&sigma)), Some((-8.0, 8.0)));
        assert_eq!(frame(&[1.0, -5.0], Some(&vec![0.0, 15.0]), Some(&sigma)), None);
        assert_eq!(frame(&[1.0], None, None), None);
    }

    #[test]
    fn unit_the_share_inside_counts_what_is_known() {
        assert_eq!(share_inside(&[1.0, -5.0, f64::NAN, 2.0], &[1.0, 1.0, 1.0, 1.0]), "67 %");
        assert_eq!(share_inside(&[f64::NAN], &[1.0]), "none");
    }

    #[test]
    fn unit_the_innovation_band_is_what_the_filter_predicted() {
        use crate::views::report::track::Track;
        let estimate = Track { lat: vec![0.0; 2], lon: vec![0.0; 2] };
        // r²/S = nis with S = 25: the band is 1.96 times 5.
        let (residual, nis) = (Some(vec![10.0, -2.5]), Some(vec![4.0, 0.25]));
        let flown = Flown { tt: vec![0.0, 60.0], truth: None, ins: None, estimate, sigma: None, residual, nis };
        let chart = innovations(&flown, &BTreeMap::new()).unwrap();
        assert!(chart.bands[0].points.iter().all(|p| (p.2 - 9.8).abs() < 1e-3 && p.1 == -p.2));
        assert!(flown.errors().is_none());
    }
}
