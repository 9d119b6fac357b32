//! Band-pass filters columns.

use numerics::signal::filter::{FilterBand, ZeroPhaseFilter};
use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Role, Rule, Stage, StageSchema, Table, stage};

use crate::{
    columns::{band, data, faults_of, shape},
    corrections::like,
    filtered::{AngleTreatment, filtered},
};

stage! {
    /// Removes frequencies outside the pass band, without lag, and appends `<column>_bp`.
    ///
    /// A Butterworth filter of second-order sections runs forwards and backwards over each line. It uses odd reflection
    /// at the ends and steady-state initial conditions. Each of the two passes halves the power at a corner frequency.
    ///
    /// A run is a stretch of samples without a missing value (NaN) or a gap in time. The filter restarts at each run.
    /// Missing values stay NaN and do not spread. A run that is not longer than the filter's padding becomes NaN. The
    /// padding is 6 samples per second-order section: 24 samples for the default order. A line is rejected if all its
    /// runs are too short. Samples must be evenly spaced.
    ///
    /// Source: F. Gustafsson, Determining the initial states in forward-backward filtering, 1996. The defaults are
    /// taken from Gnadt 2022, section 3.1.2.
    Bandpass = "bandpass", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name    = "bandpass"
stage   = "bandpass"
input   = "resample"
columns = ["mag_4_uc"]
"#;
    /// Columns to filter.
    columns: Vec<String>, unit "";
    /// Lower corner frequency. 0 gives a low-pass filter.
    low_hz: f64, unit "Hz", default 0.1, rule Rule::NotNegative;
    /// Upper corner frequency. 0 gives a high-pass filter.
    high_hz: f64, unit "Hz", default 0.9, rule Rule::NotNegative;
    /// Order of the Butterworth prototype. A band-pass filter has twice as many poles.
    order: usize, unit "", default 4usize, rule Rule::Between(1.0, 12.0);
}

/// Filter for two corner frequencies, in Hz. 0 removes a corner. `None` if both are 0.
///
/// # Errors
/// Returns the errors of [`ZeroPhaseFilter::new`].
pub fn design(low_hz: f64, high_hz: f64, order: usize, rate_hz: f64) -> Result<Option<ZeroPhaseFilter>, Fault> {
    let band = match (low_hz > 0.0, high_hz > 0.0) {
        (true, true) => FilterBand::Band { low_hz, high_hz },
        (true, false) => FilterBand::High { low_hz },
        (false, true) => FilterBand::Low { high_hz },
        (false, false) => return Ok(None),
    };
    ZeroPhaseFilter::new(band, rate_hz, order).map(Some).map_err(data)
}

impl Stage for Bandpass {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults =
            faults_of(self.columns.iter().map(|c| shape.need(c).and_then(|x| shape.number(c, &x.unit))), "columns");
        faults.extend(band(self.low_hz, self.high_hz, shape.rate_hz));
        if self.low_hz == 0.0 && self.high_hz == 0.0 {
            faults.push(
                Fault::new("both corners are 0, so the filter has no effect; set `low_hz` or `high_hz`")
                    .of_param("low_hz"),
            );
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let made = self.columns.iter().map(|c| {
            let unit = shape.get(c).map(|x| x.unit.clone()).unwrap_or_default();
            // A filtered truth column keeps its role.
            let role = shape.get(c).map(|x| x.role).filter(|r| *r == Role::Truth).unwrap_or(Role::Derived);
            let column = Column::float(format!("{c}_bp"), unit, format!("{c}, band-passed"));
            like(column, shape, c).role(role).from(0, &["tt", c])
        });
        let reads: Vec<&str> = std::iter::once("tt").chain(self.columns.iter().map(String::as_str)).collect();
        Ok(StageSchema::append(made.collect(), &reads))
    }
}

impl LineStage for Bandpass {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        filtered(&line.inputs[0], &self.columns, AngleTreatment::AsNumbers, |rate_hz| {
            design(self.low_hz, self.high_hz, self.order, rate_hz)?
                .ok_or_else(|| Fault::new("the filter has no corner frequency"))
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::{f64::consts::TAU, sync::Arc};

    use arrow_array::{ArrayRef, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
    use schemas::TableShape;

    use super::*;

    const RATE_HZ: f64 = 10.0;
    const ROWS: i32 = 2000;

    fn bandpass(columns: &[&str]) -> Bandpass {
        let columns = columns.iter().map(ToString::to_string).collect();
        Bandpass { columns, low_hz: 0.1, high_hz: 0.9, order: 4 }
    }

    fn run(stage: &Bandpass, tt: Vec<f64>, x: Vec<f64>) -> Result<Vec<f64>, Fault> {
        let column = |values: Vec<f64>| Arc::new(Float64Array::from(values)) as ArrayRef;
        let batch = RecordBatch::try_from_iter([("tt", column(tt)), ("x", column(x))]).unwrap();
        let line = LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None };
        stage.run(&line, &()).map(|arrays| arrays[0].as_primitive::<Float64Type>().values().to_vec())
    }

    /// Evenly spaced samples.
    fn samples(rows: i32, of: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..rows).map(|k| of(f64::from(k) / RATE_HZ)).collect()
    }

    #[test]
    fn law_a_sine_in_the_band_passes_and_one_outside_is_removed() {
        // Butterworth's squared gain is 1/2 at a corner after two passes.
        for (hz, gain) in [(0.3, 1.0), (0.1, 0.5), (0.9, 0.5), (0.01, 0.0), (3.0, 0.0)] {
            let sine = |t: f64| 10.0 * (TAU * hz * t).sin();
            let x = samples(ROWS, |t| 50_000.0 + sine(t));
            let y = run(&bandpass(&["x"]), samples(ROWS, |t| t), x).unwrap();
            assert_eq!(y.len(), ROWS as usize);
            // At 80 s from the ends, transients have decayed: the slowest pole decays by a factor of e in 5 s.
            let middle = 800..1200;
            let worst = middle.map(|k| (y[k] - gain * sine(k as f64 / RATE_HZ)).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-3, "{hz} Hz: {worst} nT");
        }
    }

    #[test]
    fn law_a_constant_is_removed_and_gaps_are_kept() {
        let mut x = vec![52_345.6; 600];
        x[300] = f64::NAN;
        let tt = samples(600, |t| t);
        for (low_hz, high_hz, left) in [(0.1, 0.9, 0.0), (0.5, 0.0, 0.0), (0.0, 0.9, 52_345.6)] {
            let y = run(&Bandpass { low_hz, high_hz, ..bandpass(&["x"]) }, tt.clone(), x.clone()).unwrap();
            assert!(y[300].is_nan());
            // Rounding error of 50,000 nT (7e-12), amplified some hundred times by a low corner frequency.
            let rest = y.iter().enumerate().filter(|(k, _)| *k != 300);
            assert!(rest.map(|(_, y)| (y - left).abs()).fold(0.0, f64::max) < 1e-6, "{low_hz} to {high_hz} Hz");
        }
    }

    #[test]
    fn unit_an_unfilterable_line_is_rejected_with_the_reason() {
        let stage = bandpass(&["x"]);
        assert!(run(&stage, samples(25, |t| t), vec![1.0; 25]).is_ok());
        let short = run(&stage, samples(24, |t| t), vec![1.0; 24]).unwrap_err();
        assert!(short.what.contains("25 samples"), "{short}");
        assert_eq!(short.place.column.as_deref(), Some("x"));
        let mut tt = samples(100, |t| t);
        tt[40] += 0.02;
        let uneven = run(&stage, tt, vec![1.0; 100]).unwrap_err();
        assert_eq!(
            (uneven.place.column.as_deref(), uneven.help.as_deref()),
            (Some("tt"), Some("add a `resample` stage before this one"))
        );
    }

    #[test]
    fn unit_a_corner_above_nyquist_is_rejected_before_the_run() {
        let columns = vec![
            Column::float("tt", "s", ""),
            Column::float("mag_4_uc", "nT", ""),
            Column::float("mag_1_c", "nT", "").role(Role::Truth),
        ];
        let table = |rate_hz| Table::Lines(TableShape { columns: columns.clone().into(), rate_hz });
        let fault_texts = |stage: &Bandpass, rate_hz: Option<f64>| {
            let faults = stage.yields(&[&table(rate_hz)]).unwrap_err();
            faults.iter().map(|f| format!("{} [{}]", f.what, f.param.clone().unwrap_or_default())).collect::<Vec<_>>()
        };
        let wide = Bandpass { high_hz: 6.0, ..bandpass(&["mag_4_uc"]) };
        let expected = "a corner of 6 Hz is not below the Nyquist frequency of 5 Hz [high_hz]";
        assert_eq!(fault_texts(&wide, Some(RATE_HZ)), [expected]);
        assert!(wide.yields(&[&table(None)]).is_ok(), "the rate is not known");
        assert!(fault_texts(&Bandpass { low_hz: 0.9, ..bandpass(&["mag_4_uc"]) }, None)[0].ends_with("[low_hz]"));
        assert!(
            fault_texts(&Bandpass { low_hz: 0.0, high_hz: 0.0, ..bandpass(&["mag_4_uc"]) }, None)[0]
                .ends_with("[low_hz]")
        );
        assert_eq!(fault_texts(&bandpass(&["mag_5_uc"]), None), ["there is no column `mag_5_uc` [columns]"]);
        let made = bandpass(&["mag_4_uc", "mag_1_c"]).yields(&[&table(Some(RATE_HZ))]).unwrap().columns;
        let made: Vec<_> = made.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.role)).collect();
        assert_eq!(made, [("mag_4_uc_bp", "nT", Role::Derived), ("mag_1_c_bp", "nT", Role::Truth)]);
    }
}
