//! The errors of a track, and their consistency with the filter's covariance.

use std::collections::BTreeMap;

use figures::{
    chart::{ChartAxis, ChartBand, ChartLine, LineChart},
    decimate::{MOST, envelope, extremes},
};
use maud::Markup;
use numerics::regression::statistics;
use results::text::number;

use super::{
    signal::{minutes, time_axis},
    track::{LineTracks, TrackOffsets, nees},
    whiteness::Z95,
};

/// Maximum number of points of a band.
const BAND_POINTS: usize = 500;
/// Half the width of the band around a position error, in standard deviations.
const SIGMAS: f64 = 3.0;

/// The plots of one line at the point `place`. `outcomes` counts the outcomes of the line's measurements.
pub fn plots(line_tracks: &LineTracks, place: &str, outcomes: &BTreeMap<String, usize>) -> Vec<Markup> {
    let mut charts = vec![];
    if let Some(errors) = line_tracks.errors() {
        charts.extend(positions(line_tracks, place, &errors));
    }
    charts.extend(innovations(line_tracks, outcomes));
    if let (Some(errors), Some(sigma)) = (line_tracks.errors(), &line_tracks.sigma) {
        charts.push(nees_chart(&line_tracks.tt, &nees(&errors, sigma)));
    }
    charts.iter().filter_map(LineChart::draw).collect()
}

fn positions(line_tracks: &LineTracks, place: &str, errors: &TrackOffsets) -> Vec<LineChart> {
    let ins = line_tracks.ins_errors();
    let alone = |pick: fn(&TrackOffsets) -> &Vec<f64>| ins.as_ref().map(pick);
    let sigma = |i: usize| line_tracks.sigma.as_ref().map(|s| &s[i]);
    let mut both = vec![
        position(line_tracks, "North", &errors.north, alone(|o| &o.north), sigma(0)),
        position(line_tracks, "East", &errors.east, alone(|o| &o.east), sigma(1)),
    ];
    both.iter_mut().for_each(|chart| chart.title = format!("{}: {place}", chart.title));
    both
}

fn position(
    line_tracks: &LineTracks,
    way: &str,
    error: &[f64],
    ins: Option<&Vec<f64>>,
    sigma: Option<&Vec<f64>>,
) -> LineChart {
    let time = minutes(&line_tracks.tt);
    let rms = |x: &[f64]| number(Some(statistics::rms(x).value));
    let mut caption = format!("Truth minus estimate. The root mean square is {} m", rms(error));
    let mut lines = vec![];
    if let Some(ins) = ins {
        caption.push_str(&format!("; for the INS alone, it is {} m", rms(ins)));
        lines.push(ChartLine { name: "INS alone".into(), class: "ins", points: extremes(&time, ins, MOST) });
    }
    caption.push('.');
    lines.push(ChartLine { name: "estimate".into(), class: "after", points: extremes(&time, error, MOST) });
    let mut bands = vec![];
    if let Some(sigma) = sigma {
        caption.push_str(&format!(
            " The error is within ±3σ for {} of the time (expected value: 99.7 %).",
            share_inside(error, sigma)
        ));
        let ends = |(t, s): (f64, f64)| (t, -SIGMAS * s, SIGMAS * s);
        let points = envelope(&time, sigma, BAND_POINTS).into_iter().map(ends).collect();
        bands.push(ChartBand { name: "±3σ of the filter".into(), points });
    }
    let y = ChartAxis { range: frame(error, ins, sigma), ..ChartAxis::new(format!("error {}, m", way.to_lowercase())) };
    if y.range.is_some() {
        caption.push_str(" The errors of the INS alone exceed the range of the plot.");
    }
    let title = format!("{way} error");
    LineChart { title, caption, x: time_axis(), y, bands, lines, height: 250.0, ..LineChart::default() }
}

/// Range of the axis that shows the estimate and the band, if the much larger error of the INS would compress them to a
/// line.
fn frame(error: &[f64], ins: Option<&Vec<f64>>, sigma: Option<&Vec<f64>>) -> Option<(f64, f64)> {
    let largest = |x: &[f64]| x.iter().copied().filter(|v| v.is_finite()).fold(0.0, |a: f64, v| a.max(v.abs()));
    let own = largest(error).max(SIGMAS * sigma.map_or(0.0, |s| largest(s)));
    (largest(ins?) > 4.0 * own && own > 0.0).then_some((-1.25 * own, 1.25 * own))
}

/// The fraction of errors within the band, as text.
fn share_inside(error: &[f64], sigma: &[f64]) -> String {
    let known = error.iter().zip(sigma).filter(|(e, s)| e.is_finite() && s.is_finite());
    let (inside, all) = known.fold((0usize, 0usize), |(i, n), (e, s)| (i + usize::from(e.abs() <= SIGMAS * s), n + 1));
    if all == 0 {
        return "none".to_owned();
    }
    let share = 100.0 * inside as f64 / all as f64;
    // A share below 100 % is not rounded up to 100 %.
    if inside < all { format!("{:.1} %", share.min(99.9)) } else { "100 %".to_owned() }
}

fn innovations(line_tracks: &LineTracks, outcomes: &BTreeMap<String, usize>) -> Option<LineChart> {
    let (residual, time) = (line_tracks.residual.as_ref()?, minutes(&line_tracks.tt));
    let mut bands = vec![];
    if let Some(nis) = &line_tracks.nis {
        // S follows from the residual r and `nis`, which is r²/S; the filter does not store S.
        let half: Vec<f64> =
            residual.iter().zip(nis).map(|(r, n)| if *n > 0.0 { Z95 * r.abs() / n.sqrt() } else { f64::NAN }).collect();
        let points = envelope(&time, &half, BAND_POINTS).into_iter().map(|(t, s)| (t, -s, s)).collect();
        bands.push(ChartBand { name: "predicted 95 %".into(), points });
    }
    let counted: Vec<String> =
        outcomes.iter().map(|(outcome, n)| format!("{n} {}", outcome.replace('_', " "))).collect();
    let caption = format!(
        "Measurement minus prediction. The innovations of a consistent filter have zero mean and no trend, and are \
         within the band 95 % of the time. Samples: {}.",
        if counted.is_empty() { "not counted".to_owned() } else { counted.join(", ") }
    );
    Some(LineChart {
        title: "Innovations".into(),
        caption,
        x: time_axis(),
        y: ChartAxis::new("innovation, nT"),
        bands,
        lines: vec![ChartLine { name: "innovation".into(), class: "after", points: extremes(&time, residual, MOST) }],
        height: 230.0,
        ..LineChart::default()
    })
}

fn nees_chart(tt: &[f64], nees: &[f64]) -> LineChart {
    // Chi-square with two degrees of freedom is an exponential distribution.
    let (low, high) = (-2.0 * 0.975f64.ln(), -2.0 * 0.025f64.ln());
    let caption = format!(
        "Squared horizontal error in units of the filter's covariance. A consistent filter has a mean of 2 and 95 % \
         of the values between {} and {}. An overconfident filter has larger values. The mean here is {}. Position \
         errors are correlated over minutes, so a single line may stay outside the band for some time.",
        number(Some(low)),
        number(Some(high)),
        number(Some(statistics::mean(nees).value)),
    );
    let points = extremes(&minutes(tt), nees, MOST).into_iter().map(|(t, v)| (t, v.max(1e-3))).collect();
    LineChart {
        title: "NEES of the position".into(),
        caption,
        x: time_axis(),
        y: ChartAxis::new("NEES").log(),
        lines: vec![ChartLine { name: "NEES".into(), class: "after", points }],
        levels: vec![("95 % band".into(), low), (String::new(), high)],
        height: 220.0,
        ..LineChart::default()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_a_drifting_ins_does_not_flatten_the_estimate() {
        let sigma = vec![1.0, 2.0];
        assert_eq!(frame(&[1.0, -5.0], Some(&vec![0.0, 100.0]), Some(&sigma)), Some((-7.5, 7.5)));
        assert_eq!(frame(&[1.0, -5.0], Some(&vec![0.0, 24.0]), Some(&sigma)), None);
        assert_eq!(frame(&[1.0], None, None), None);
    }

    #[test]
    fn unit_the_share_inside_ignores_missing_values() {
        assert_eq!(share_inside(&[1.0, -5.0, f64::NAN, 3.0], &[1.0, 1.0, 1.0, 1.0]), "66.7 %");
        let (mut error, sigma) = (vec![0.0; 10_000], vec![1.0; 10_000]);
        assert_eq!(share_inside(&error, &sigma), "100 %");
        error[7] = 3.1;
        assert_eq!(share_inside(&error, &sigma), "99.9 %", "one sample outside is not rounded to none");
        assert_eq!(share_inside(&[f64::NAN], &[1.0]), "none");
    }

    /// North errors of 0 to 59 m with standard deviations of 10 to 15.9 m; no east errors.
    fn example_tracks() -> LineTracks {
        use crate::html::track::DegreeTrack;
        let metres = |north: f64| numerics::earth::geodesy::EarthModel::default().north_m_to_lat_rad(north, 0.0, 0.0);
        let track = |step: f64| DegreeTrack {
            lat: (0..60).map(|k| metres(step * f64::from(k)).to_degrees()).collect(),
            lon: vec![140.0; 60],
        };
        LineTracks {
            tt: (0..60).map(|k| 60.0 * f64::from(k)).collect(),
            truth: Some(track(1.0)),
            ins: Some(track(-2.0)),
            estimate: track(0.0),
            sigma: Some([(0..60).map(|k| 10.0 + 0.1 * f64::from(k)).collect(), vec![5.0; 60], vec![0.0; 60]]),
            residual: None,
            nis: None,
        }
    }

    #[test]
    fn law_the_band_is_three_sigma_and_errors_are_truth_minus_estimate() {
        let line_tracks = example_tracks();
        let charts = positions(&line_tracks, "flight 1, line 1.02, filter = ekf", &line_tracks.errors().unwrap());
        let (north, east) = (&charts[0], &charts[1]);
        assert_eq!(north.title, "North error: flight 1, line 1.02, filter = ekf");
        for (k, (minute, low, high)) in north.bands[0].points.iter().enumerate() {
            let sigma = 10.0 + 0.1 * k as f64;
            assert!((*minute - k as f64).abs() < 1e-12 && (high - 3.0 * sigma).abs() < 1e-12 && *low == -high);
        }
        // The truth is north of the estimate. The INS is three times as far south of the truth as the estimate.
        let last = |name: &str| north.lines.iter().find(|l| l.name == name).unwrap().points[59].1;
        assert!((last("estimate") - 59.0).abs() < 0.01 && (last("INS alone") - 177.0).abs() < 0.03);
        assert!(east.lines[1].points.iter().all(|p| p.1.abs() < 1e-9));
        // |k| <= 30 + 0.3 k holds from minute 0 to minute 42: 43 of 60 samples.
        assert!(north.caption.contains("within ±3σ for 71.7 % of the time"), "{}", north.caption);
        // In the picture, too, the highest point of the band is at three sigma of the last minute: 47.7 m.
        let drawn = north.draw().unwrap().into_string();
        let spots = |class: &str| -> Vec<(f64, f64)> {
            let path = drawn.split(&format!("class=\"{class}\"")).nth(1).unwrap();
            let d = path.split(" d=\"").nth(1).and_then(|d| d.split('"').next()).unwrap();
            let number = |s: &str| s.parse::<f64>().unwrap();
            let pair = |s: &str| s.split_once(' ').map(|(x, y)| (number(x), number(y))).unwrap();
            d.trim_end_matches('Z').split(['M', 'L']).filter(|s| !s.is_empty()).map(pair).collect()
        };
        let (error, band) = (spots("line after"), spots("area"));
        let per_metre = (error[0].1 - error[59].1) / 59.0;
        assert!((error[0].1 - band[60].1 - 3.0 * 15.9 * per_metre).abs() < 0.2, "{error:?} {band:?}");
    }

    #[test]
    fn unit_the_innovation_band_is_the_prediction_of_the_filter() {
        use crate::html::track::DegreeTrack;
        let estimate = DegreeTrack { lat: vec![0.0; 2], lon: vec![0.0; 2] };
        // r²/S = nis with S = 25: the band is 1.96 times 5.
        let (residual, nis) = (Some(vec![10.0, -2.5]), Some(vec![4.0, 0.25]));
        let line_tracks =
            LineTracks { tt: vec![0.0, 60.0], truth: None, ins: None, estimate, sigma: None, residual, nis };
        let chart = innovations(&line_tracks, &BTreeMap::new()).unwrap();
        assert!(chart.bands[0].points.iter().all(|p| (p.2 - 9.8).abs() < 1e-3 && p.1 == -p.2));
        assert!(line_tracks.errors().is_none());
    }
}
