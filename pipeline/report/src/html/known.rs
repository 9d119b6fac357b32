//! The map along a line, with the measured and the true anomaly.

use figures::{
    chart::{ChartAxis, ChartLine, LineChart},
    decimate::{MOST, extremes},
};
use maud::Markup;
use numerics::regression::statistics;
use plan::{LineId, TableRef};
use results::text::number;
use schemas::{Fault, MagneticCorrection, TableShape};

use super::{
    signal::{minutes, time_axis},
    source::ReportSource,
    subject::ReportSubject,
};

/// The map's value along a line, from a table of `map_value`, with the measured and the true anomaly if they exist;
/// `None` without such a table.
///
/// # Errors
/// Fails if the store is damaged.
pub fn plots(source: &ReportSource, subject: &ReportSubject, line: LineId) -> Result<Option<Markup>, Fault> {
    let Some(r) = subject.map_value else { return Ok(None) };
    let column = |name: &str| source.floats(r, line, name);
    let (Some(tt), Some(map)) = (column("tt")?, column("map_anomaly")?) else { return Ok(None) };
    let mut found = MapProfile { tt, map, measured: None, truth: column("anomaly_truth")? };
    found.measured = measured(source, subject, r, line, found.tt.len())?;
    Ok(found.chart().draw())
}

/// A signal minus core field and temporal variation, and the name of the signal. Parts that were already removed are
/// not subtracted again.
fn measured(
    source: &ReportSource,
    subject: &ReportSubject,
    r: TableRef,
    line: LineId,
    rows: usize,
) -> Result<Option<(String, Vec<f64>)>, Fault> {
    let names = std::iter::once("mag_c").chain(subject.truth.as_deref());
    for (from, name) in
        [Some(r), subject.compensate].into_iter().flatten().flat_map(|r| names.clone().map(move |n| (r, n)))
    {
        // A table that was cut or resampled has other samples.
        let Some(mut signal) = source.floats(from, line, name)?.filter(|x| x.len() == rows) else { continue };
        for known in remaining(source.shape(from), name) {
            if let Some(field) = source.floats(from, line, known)?.filter(|x| x.len() == rows) {
                signal.iter_mut().zip(&field).for_each(|(x, f)| *x -= f);
            }
        }
        return Ok(Some((name.to_owned(), signal)));
    }
    Ok(None)
}

/// The columns of the core field and the temporal variation that the signal `name` still contains.
fn remaining(shape: Option<&TableShape>, name: &str) -> Vec<&'static str> {
    let removed = shape.and_then(|shape| shape.get(name)).map(|column| &column.removed);
    let is_left = |known: &&str| match (MagneticCorrection::by_column(known), removed) {
        (Some(correction), Some(removed)) => !removed.contains(&correction),
        _ => true,
    };
    ["igrf", "diurnal"].into_iter().filter(is_left).collect()
}

struct MapProfile {
    tt: Vec<f64>,
    map: Vec<f64>,
    measured: Option<(String, Vec<f64>)>,
    truth: Option<Vec<f64>>,
}

impl MapProfile {
    fn chart(&self) -> LineChart {
        let time = minutes(&self.tt);
        let line =
            |name: &str, class, y: &[f64]| ChartLine { name: name.into(), class, points: extremes(&time, y, MOST) };
        let mut caption = "The anomaly of the map at the positions of the line.".to_owned();
        let mut lines = vec![];
        if let Some((name, signal)) = &self.measured {
            let (shifted, constant) = on_the_map(signal, &self.map);
            lines.push(line(&format!("{name} minus core field and temporal variation"), "before", &shifted));
            caption.push_str(&format!(
                " The standard deviation of {name} minus the map is {} nT. The mean difference of {} nT is \
                 subtracted, because compensation does not determine the bias.",
                number(Some(difference(signal, &self.map))),
                number(Some(constant)),
            ));
        }
        if let Some(truth) = &self.truth {
            lines.push(line("true anomaly", "reference", truth));
            let off = number(Some(difference(&self.map, truth)));
            caption.push_str(&format!(" The map differs from the true anomaly with a standard deviation of {off} nT."));
        }
        lines.push(line("map", "after", &self.map));
        LineChart {
            title: "The map along the line".into(),
            caption,
            x: time_axis(),
            y: ChartAxis::new("anomaly, nT"),
            lines,
            height: 260.0,
            ..LineChart::default()
        }
    }
}

/// The signal minus its mean difference from the map, and the mean difference.
fn on_the_map(signal: &[f64], map: &[f64]) -> (Vec<f64>, f64) {
    let constant = statistics::error_summary(signal, map).mean;
    (signal.iter().map(|x| x - constant).collect(), constant)
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    statistics::error_summary(a, b).std
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn bug_removed_parts_are_not_subtracted_again() {
        let column = |name: &str, removed: &[MagneticCorrection]| {
            schemas::Column::float(name, "nT", "").without(removed.iter().copied().collect())
        };
        let columns = vec![
            column("mag_c", &[]),
            column("target", &[MagneticCorrection::Diurnal]),
            column("both", &[MagneticCorrection::Core, MagneticCorrection::Diurnal, MagneticCorrection::Lag]),
        ];
        let shape = TableShape { columns: columns.into(), rate_hz: None };
        let of = |name: &str| remaining(Some(&shape), name);
        assert_eq!(of("mag_c"), ["igrf", "diurnal"]);
        assert_eq!(of("target"), ["igrf"]);
        assert!(of("both").is_empty());
    }

    #[test]
    fn unit_a_constant_difference_from_the_map_is_removed() {
        let map: Vec<f64> = (0..600).map(|i| (f64::from(i) / 50.0).sin() * 40.0).collect();
        let signal = map.iter().map(|x| x - 350.0).collect();
        let tt = (0..600).map(|i| 100.0 + f64::from(i)).collect();
        let along = MapProfile { tt, measured: Some(("mag_c".into(), signal)), truth: Some(map.clone()), map };
        let chart = along.chart();
        assert_eq!(chart.lines.len(), 3);
        assert!(chart.caption.contains("The mean difference of -350.0 nT"), "{}", chart.caption);
        for (a, b) in chart.lines[0].points.iter().zip(&chart.lines[2].points) {
            assert!((a.1 - b.1).abs() < 1e-9);
        }
        assert!(chart.draw().is_some());
    }
}
