//! The recorded signals of one line over frequency, with published spectra: noise floors of sensors, the spectrum of an
//! observatory, the band of manoeuvres.

use figures::chart::{ChartAxis, ChartLine, LineChart};
use maud::Markup;
use numerics::signal::segments::{STEP_TOLERANCE, sample_rate};
use plan::{LineId, TableRef};
use schemas::{Column, Fault, TableShape};

use super::{source::ReportSource, subject::ReportSubject};
use crate::spectrum::amplitude_spectrum;

/// The spectrum of Boulder's record, made by `datasets/reference/make_observatory_spectrum.py`.
const OBSERVATORY: &str = include_str!("observatory_spectrum.csv");

/// Sensitivities in nT/√Hz: the published noise of sensors.
/// [Lee 2019, Table 3; van der Meer 2025, Table 3.3]
const FLOORS: [(&str, f64); 3] =
    [("MicroSAM 20 pT/√Hz", 0.02), ("VMR vector 300 pT/√Hz", 0.3), ("G-823A 4 pT/√Hz", 0.004)];

/// Manoeuvres of calibration boxes have periods of 4 to 20 s. [Gnadt 2022, Table 5.7]
const MANOEUVRES_HZ: (f64, f64) = (0.05, 0.25);

/// The number of colours.
const MOST: usize = 8;

/// The spectra of one line's recorded signals; no spectra without recorded signals.
///
/// # Errors
/// Fails if the store is damaged.
pub fn plots(source: &ReportSource, subject: &ReportSubject, line: LineId) -> Result<Vec<Markup>, Fault> {
    let Some(flights) = subject.compensate.or(subject.navigate).and_then(|r| flights(source, r)) else {
        return Ok(vec![]);
    };
    let Some(tt) = source.floats(flights, line, "tt")? else { return Ok(vec![]) };
    let Ok(rate_hz) = sample_rate(&tt, STEP_TOLERANCE) else { return Ok(vec![]) };
    let Some(shape) = source.shape(flights) else { return Ok(vec![]) };
    let mut lines = vec![];
    for (class, name) in CLASSES.into_iter().zip(recorded(shape)) {
        let Some(x) = source.floats(flights, line, &name)? else { continue };
        lines.extend(amplitude(&tt, &x).map(|points| ChartLine { name, class, points }));
    }
    Ok(chart(lines, rate_hz).and_then(|c| c.draw()).into_iter().collect())
}

const CLASSES: [&str; MOST] = ["s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7"];

/// Table of flights from which `r` was computed.
fn flights(source: &ReportSource, r: TableRef) -> Option<TableRef> {
    let plan = source.graph.plan;
    let mut at = r;
    while let TableRef::Stage(t, i) = at {
        at = plan.instance(t, i).first_input()?;
    }
    matches!(at, TableRef::Flights(_)).then_some(at)
}

/// The drawn signals: the temporal variation, the crustal anomaly if known, and the scalar magnetometers.
fn recorded(shape: &TableShape) -> Vec<String> {
    let columns = &shape.columns;
    let scalar = |c: &&Column| c.unit == "nT" && c.name.starts_with("mag_");
    let named = |name: &str| columns.iter().find(|c| c.name == name).map(|c| c.name.clone());
    let first = ["diurnal", "anomaly_truth"].into_iter().filter_map(named);
    first.chain(columns.iter().filter(scalar).map(|c| c.name.clone())).take(MOST).collect()
}

/// Amplitude density in nT/√Hz; `None` for a signal that does not vary.
fn amplitude(tt: &[f64], x: &[f64]) -> Option<Vec<(f64, f64)>> {
    let spectrum = amplitude_spectrum(tt, &[x]).ok()?;
    let density = spectrum.columns.into_iter().next()?.density;
    let points: Vec<(f64, f64)> = spectrum.frequency_hz.into_iter().zip(density).filter(|p| p.1 > 0.0).collect();
    (!points.is_empty()).then_some(points)
}

/// The spectrum of one record of the observatory: frequency in Hz and density in nT/√Hz.
fn observatory(record: &str) -> Vec<(f64, f64)> {
    let point = |row: &str| {
        let mut cells = row.split(',');
        let kept = cells.next()? == record;
        let (f, d): (f64, f64) = (cells.next()?.parse().ok()?, cells.next()?.parse().ok()?);
        kept.then(|| (f, d.sqrt()))
    };
    OBSERVATORY.lines().skip(1).filter_map(point).collect()
}

fn chart(mut lines: Vec<ChartLine>, rate_hz: f64) -> Option<LineChart> {
    let lowest = lines.iter().filter_map(|l| l.points.first()).map(|p| p.0).fold(f64::INFINITY, f64::min);
    if !lowest.is_finite() {
        return None;
    }
    for (name, record) in
        [("Boulder, 3 days with a magnetic storm", "minutes"), ("Boulder, 15 min without disturbance", "seconds")]
    {
        let points: Vec<(f64, f64)> =
            observatory(record).into_iter().filter(|p| p.0 >= lowest && p.0 <= 0.5 * rate_hz).collect();
        if points.len() > 1 {
            lines.push(ChartLine { name: name.to_owned(), class: "reference", points });
        }
    }
    let caption = "The recorded signals, including core field and anomaly, compared with published spectra: the \
                   temporal variation of the total field at the Boulder observatory (INTERMAGNET; 3 to 5 November \
                   2014 and 1 January 2020), and the sensitivity stated by manufacturers of magnetometers. The \
                   shaded band contains the frequencies of the manoeuvres in a calibration box. Anomaly and temporal \
                   variation dominate below it, sensor noise dominates above it.";
    Some(LineChart {
        title: "Spectra of the recorded signals".into(),
        caption: caption.into(),
        x: ChartAxis::new("frequency, Hz").log(),
        y: ChartAxis::new("amplitude density, nT/√Hz").log(),
        lines,
        levels: FLOORS.map(|(name, nt)| (name.to_owned(), nt)).to_vec(),
        stretch: Some(("manoeuvres".to_owned(), MANOEUVRES_HZ.0.max(lowest), MANOEUVRES_HZ.1.min(0.5 * rate_hz))),
        height: 340.0,
        ..LineChart::default()
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::f64::consts::TAU;

    use super::*;

    fn times(rows: u32) -> Vec<f64> {
        (0..rows).map(|k| f64::from(k) / 10.0).collect()
    }

    #[test]
    fn unit_white_noise_has_the_floor_of_its_sigma() {
        // A pseudo-random sequence of +s and -s is white, with the density s² / (rate / 2).
        let mut state = 1u64;
        let x: Vec<f64> = (0..40_000)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                if state >> 63 == 0 { 0.2 } else { -0.2 }
            })
            .collect();
        let points = amplitude(&times(40_000), &x).unwrap();
        let mean = points.iter().map(|p| p.1 * p.1).sum::<f64>() / points.len() as f64;
        assert!((mean.sqrt() / (0.2 / 5f64.sqrt()) - 1.0).abs() < 0.02, "{}", mean.sqrt());
    }

    #[test]
    fn unit_the_observatorys_spectrum_falls_with_frequency() {
        let (minutes, seconds) = (observatory("minutes"), observatory("seconds"));
        assert_eq!((minutes.len(), seconds.len()), (15, 11));
        assert!(minutes.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 > w[1].1));
        assert!(seconds[0].1 < minutes[14].1, "a quiet record has less than a storm");
    }

    #[test]
    fn unit_only_varying_signals_are_drawn() {
        let wave: Vec<f64> = (0..4000).map(|k| (TAU * 0.1 * f64::from(k)).sin()).collect();
        let line = ChartLine { name: "mag_1_uc".into(), class: "s0", points: amplitude(&times(4000), &wave).unwrap() };
        assert!(amplitude(&times(4000), &[5.0; 4000]).is_none());
        let drawn = chart(vec![line], 10.0).unwrap().draw().unwrap().into_string();
        for part in ["mag_1_uc", "Boulder", "G-823A", "manoeuvres"] {
            assert!(drawn.contains(part), "{part}");
        }
        assert!(chart(vec![], 10.0).is_none());
    }
}
