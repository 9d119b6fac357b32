//! Parts of a line to which the figures of a column refer.

use super::{QualityFigure, dropouts, noise, quantisation, sampling, saturation, spikes, stuck};

/// Start and end times, in seconds, of the parts of a column to which a figure refers; empty if the figure refers to
/// the whole column. Infinities, readings of 0 and impossible values count as missing.
pub fn stretches(figure: QualityFigure, values: &[f64], tt: &[f64]) -> Vec<(f64, f64)> {
    let rows = match figure {
        QualityFigure::Dropouts => dropouts::stretches(values),
        QualityFigure::Stuck => stuck::stretches(values),
        QualityFigure::Saturation => saturation::stretches(values),
        QualityFigure::Spikes => {
            let fourth = noise::fourth_differences(values, &sampling::breaks(tt));
            let resolution = quantisation::ValueResolution::new(values, quantisation::step(values));
            let known = noise::noise(&fourth, &resolution).is_some();
            spikes::peaks(&fourth, &resolution).into_iter().filter(|_| known).map(|(row, _)| row..row + 1).collect()
        }
        QualityFigure::Rate
        | QualityFigure::Jitter
        | QualityFigure::Gaps
        | QualityFigure::LongestGap
        | QualityFigure::RepeatedTime
        | QualityFigure::BackwardTime
        | QualityFigure::Midnight
        | QualityFigure::Quantisation
        | QualityFigure::Noise
        | QualityFigure::Preferred
        | QualityFigure::DeadZone
        | QualityFigure::PolarDeadZone
        | QualityFigure::EquatorialDeadZone
        | QualityFigure::Lag
        | QualityFigure::Found(_) => vec![],
    };
    rows.into_iter().filter_map(|run| Some((*tt.get(run.start)?, *tt.get(run.end.checked_sub(1)?)?))).collect()
}

/// Gaps in time, each from the sample before the gap to the sample after it.
pub fn gaps(tt: &[f64]) -> Vec<(f64, f64)> {
    let breaks = sampling::breaks(tt);
    let before = |i: usize| Some((*tt.get(i.checked_sub(1)?)?, *tt.get(i)?));
    (0..tt.len()).filter(|i| breaks.get(*i) == Some(&true)).filter_map(before).filter(|(a, b)| b > a).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_each_part_has_its_times() {
        let tt: Vec<f64> = (0..2000).map(|i| f64::from(i) * 0.1 + if i >= 1000 { 7.0 } else { 0.0 }).collect();
        let wave = |i: usize| (i as f64 * 1.7).sin() + (i as f64 * 2.9 + 0.3).cos() * 0.7;
        let mut x: Vec<f64> = (0..2000).map(wave).collect();
        x[100..140].fill(f64::NAN);
        let held = x[400];
        x[400..460].fill(held);
        x[700] += 400.0;
        let near = |found: Vec<(f64, f64)>, expected: &[(f64, f64)]| {
            let close = found.iter().zip(expected).all(|(a, b)| (a.0 - b.0).abs() < 1e-9 && (a.1 - b.1).abs() < 1e-9);
            assert!(found.len() == expected.len() && close, "{found:?} {expected:?}");
        };
        near(stretches(QualityFigure::Dropouts, &x, &tt), &[(10.0, 13.9)]);
        near(stretches(QualityFigure::Stuck, &x, &tt), &[(40.0, 45.9)]);
        near(stretches(QualityFigure::Spikes, &x, &tt), &[(70.0, 70.0)]);
        near(gaps(&tt), &[(99.9, 107.0)]);
        assert!(stretches(QualityFigure::Noise, &x, &tt).is_empty());
        // A sine of amplitude 2, measured by a sensor that saturates at 1.2.
        let clipped: Vec<f64> = (0..2000).map(|i| (2.0 * (i as f64 * 0.013).sin()).min(1.2)).collect();
        let found = stretches(QualityFigure::Saturation, &clipped, &tt);
        assert!(!found.is_empty());
        let within = |t: f64| found.iter().any(|(a, b)| (*a..=*b).contains(&t));
        assert!(tt.iter().zip(&clipped).all(|(t, x)| within(*t) == (*x == 1.2)));
    }
}
