//! Band-pass filters columns.

use arrow_array::RecordBatch;
use numerics::signal::{
    filter::{Band, ZeroPhase},
    segments::{STEP_TOLERANCE, Usable, filter_column, sample_rate},
};
use schemas::{Arrays, Column, Fault, LineIn, LineStage, Role, Rule, Stage, Table, Yield, stage};

use crate::columns::{array, band, data, faults_of, floats, shape};

stage! {
    /// Removes what is slower or faster than the pass band, without lag, and appends `<column>_bp`.
    ///
    /// A Butterworth filter of second-order sections runs forwards and backwards over each line, with odd reflection at
    /// the ends and steady-state initial conditions; half of the power is gone at a corner after each of the two passes.
    ///
    /// A run of NaN, or a gap in time, ends the filter and a new one starts behind it: gaps stay NaN and do not spread.
    /// A run of samples shorter than the filter's padding (6 samples for each second-order section, so 25 samples for
    /// the default) becomes NaN; a line with no longer run is an error, as are samples that are not evenly spaced.
    ///
    /// Source: F. Gustafsson, Determining the initial states in forward-backward filtering, 1996; the defaults are
    /// those of thesis 000, section 3.4.
    Bandpass = "bandpass", version 1, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name    = "bandpass"
stage   = "bandpass"
input   = "resample"
columns = ["mag_4_uc"]
"#;
    /// The columns to filter.
    columns: Vec<String>, unit "";
    /// The lower corner; 0 leaves it off, which makes a low-pass.
    low_hz: f64, unit "Hz", default 0.1, rule Rule::NotNegative;
    /// The upper corner; 0 leaves it off, which makes a high-pass.
    high_hz: f64, unit "Hz", default 0.9, rule Rule::NotNegative;
    /// The order of the Butterworth prototype; a band-pass has twice as many poles.
    order: usize, unit "", default 4usize, rule Rule::Between(1.0, 12.0);
}

/// The filter for two corners of which 0 means none; `None` where nothing is to be filtered.
///
/// # Errors
/// As [`ZeroPhase::new`].
pub fn design(low_hz: f64, high_hz: f64, order: usize, rate_hz: f64) -> Result<Option<ZeroPhase>, Fault> {
    let band = match (low_hz > 0.0, high_hz > 0.0) {
        (true, true) => Band::Band { low_hz, high_hz },
        (true, false) => Band::High { low_hz },
        (false, true) => Band::Low { high_hz },
        (false, false) => return Ok(None),
    };
    ZeroPhase::new(band, rate_hz, order).map(Some).map_err(data)
}

impl Stage for Bandpass {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults =
            faults_of(self.columns.iter().map(|c| shape.need(c).and_then(|x| shape.number(c, &x.unit))), "columns");
        faults.extend(band(self.low_hz, self.high_hz, shape.rate_hz));
        if self.low_hz == 0.0 && self.high_hz == 0.0 {
            faults.push(Fault::new("both corners are 0, so nothing would be filtered").of_param("low_hz"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let made = self.columns.iter().map(|c| {
            let unit = shape.get(c).map(|x| x.unit.clone()).unwrap_or_default();
            // The truth stays the truth through a filter.
            let role = shape.get(c).map(|x| x.role).filter(|r| *r == Role::Truth).unwrap_or(Role::Derived);
            Column::float(format!("{c}_bp"), unit, format!("{c}, band-passed")).role(role).from(0, &["tt", c])
        });
        let reads: Vec<&str> = std::iter::once("tt").chain(self.columns.iter().map(String::as_str)).collect();
        Ok(Yield::append(made.collect(), &reads))
    }
}

impl LineStage for Bandpass {
    type Prepared = ();

    fn prepare(&self, _: &[RecordBatch]) -> Result<(), Fault> {
        Ok(())
    }

    fn run(&self, line: &LineIn, (): &()) -> Arrays {
        let batch = &line.inputs[0];
        let tt = floats(batch, "tt")?;
        let rate_hz = sample_rate(tt, STEP_TOLERANCE).map_err(|e| data(e).in_column("tt").help("resample first"))?;
        let filter = design(self.low_hz, self.high_hz, self.order, rate_hz)?.ok_or_else(|| Fault::new("no corner"))?;
        let one = |name: &String| {
            let x = floats(batch, name)?;
            let runs = Usable::all(x.len()).and_finite(x).runs_in_time(tt, rate_hz);
            let (y, report) = filter_column(&filter, x, &runs).map_err(|e| data(e).in_column(name))?;
            if report.rows == 0 {
                let what =
                    format!("no run of samples is as long as the filter needs ({} samples)", filter.least_rows());
                return Err(Fault::data(what).in_column(name));
            }
            Ok(array(y))
        };
        self.columns.iter().map(one).collect()
    }
}
