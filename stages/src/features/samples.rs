//! The values of features on the samples of one line.

use std::cell::OnceCell;

use arrow_array::RecordBatch;
use numerics::{
    compensation::{
        attitude_terms::AttitudeColumns,
        model_terms::{AnomalySlopeModel, CORE_TERMS, ExtendedTermGroup, core_terms, cosines, extended_terms},
        tolles_lawson::{BodyFieldColumns, TermSelection, matrix_in_runs},
    },
    signal::{
        difference::difference,
        segments::{RowMask, filter_column},
    },
};
use schemas::Fault;

use super::{ATTITUDE, CORE, FeatureDefinition, Features, LOW_PASS};
use crate::{
    bandpass::design,
    columns::{data, even_rate_hz, floats, vector_axes},
};

/// The samples of one line.
pub(super) struct FeatureSamples<'a> {
    pub(super) stage: &'a Features,
    pub(super) batch: &'a RecordBatch,
    pub(super) tt: &'a [f64],
    pub(super) terms: TermSelection,
    /// Direction cosines of the vector magnetometer that inputs are projected on, computed on first use.
    pub(super) direction: OnceCell<[Vec<f64>; 3]>,
}

impl FeatureSamples<'_> {
    pub(super) fn columns(&self, recipe: &FeatureDefinition) -> Result<Vec<Vec<f64>>, Fault> {
        let column = |name: &String| floats(self.batch, name);
        let one = |x: Vec<f64>| Ok(vec![x]);
        match recipe {
            FeatureDefinition::Plain(c) => one(column(c)?.to_vec()),
            FeatureDefinition::Difference(c, scheme) => one(self.in_runs(column(c)?, |x| difference(x, *scheme))?),
            FeatureDefinition::Lag(c, n) => one(self.in_runs(column(c)?, |x| Some(lagged(x, *n)))?),
            FeatureDefinition::Between(_, [a, b]) => {
                one(column(a)?.iter().zip(column(b)?).map(|(a, b)| a - b).collect())
            }
            FeatureDefinition::LowPass(c) => one(self.low_passed(c)?),
            FeatureDefinition::Dcm(k) => {
                let made = self.attitude()?.direction_cosine(*k);
                one(made.ok_or_else(|| Fault::data(format!("there is no direction cosine {k}")))?)
            }
            FeatureDefinition::Product(name) => {
                let made = self.attitude()?.product(name);
                one(made.ok_or_else(|| Fault::data(format!("there is no product {name}")))?)
            }
            FeatureDefinition::TollesLawson(v) => self.tolles_lawson(v),
            FeatureDefinition::Extended(c, group) => self.extended(column(c)?, *group),
            FeatureDefinition::Core(v) => self.core(v),
            FeatureDefinition::Slope(slope) => self.slope(*slope),
        }
    }

    fn attitude(&self) -> Result<AttitudeColumns<'_>, Fault> {
        let [roll, pitch, yaw] = ATTITUDE;
        let angle = |name| floats(self.batch, name);
        Ok(AttitudeColumns { roll_deg: angle(roll)?, pitch_deg: angle(pitch)?, yaw_deg: angle(yaw)? })
    }

    fn rate_hz(&self) -> Result<f64, Fault> {
        even_rate_hz(self.tt)
    }

    /// Applies `of` to each gap-free run. The result is NaN outside the runs, and in runs for which `of` returns
    /// `None`.
    fn in_runs(&self, x: &[f64], of: impl Fn(&[f64]) -> Option<Vec<f64>>) -> Result<Vec<f64>, Fault> {
        let mut out = vec![f64::NAN; x.len()];
        for run in RowMask::all(x.len()).and_finite(x).runs_in_time(self.tt, self.rate_hz()?) {
            if let Some(made) = of(&x[run.clone()]) {
                out[run].copy_from_slice(&made);
            }
        }
        Ok(out)
    }

    fn low_passed(&self, name: &str) -> Result<Vec<f64>, Fault> {
        let (x, rate_hz) = (floats(self.batch, name)?, self.rate_hz()?);
        let filter = design(0.0, LOW_PASS.0, LOW_PASS.1, rate_hz)?
            .ok_or_else(|| Fault::new("the filter has no corner frequency"))?;
        let runs = RowMask::all(x.len()).and_finite(x).runs_in_time(self.tt, rate_hz);
        filter_column(&filter, x, &runs).map(|(y, _)| y).map_err(|e| data(e).in_column(name))
    }

    fn vector(&self, name: &str) -> Result<[&[f64]; 3], Fault> {
        let [x, y, z] = vector_axes(name);
        Ok([floats(self.batch, &x)?, floats(self.batch, &y)?, floats(self.batch, &z)?])
    }

    fn tolles_lawson(&self, name: &str) -> Result<Vec<Vec<f64>>, Fault> {
        let [x, y, z] = self.vector(name)?;
        let usable = RowMask::all(self.tt.len()).and_finite(x).and_finite(y).and_finite(z);
        let runs = usable.runs_in_time(self.tt, self.rate_hz()?);
        let rows = matrix_in_runs(&BodyFieldColumns { x, y, z, bt: None }, &self.terms, self.stage.bt_scale_nt, &runs);
        Ok(transposed(&rows.map_err(data)?, self.terms.len()))
    }

    fn extended(&self, input: &[f64], group: ExtendedTermGroup) -> Result<Vec<Vec<f64>>, Fault> {
        let Some(vector) = self.stage.vector.as_ref().filter(|_| group != ExtendedTermGroup::Raw) else {
            return Ok(vec![input.to_vec()]);
        };
        let u = match self.direction.get() {
            Some(known) => known,
            None => {
                let made = cosines(self.vector(vector)?);
                self.direction.get_or_init(|| made)
            }
        };
        let mut out = vec![vec![f64::NAN; input.len()]; group.suffixes().len()];
        for run in RowMask::all(input.len()).and_finite(input).runs_in_time(self.tt, self.rate_hz()?) {
            let of_run = u.each_ref().map(|u| &u[run.clone()]);
            for (column, term) in
                out.iter_mut().zip(extended_terms(&input[run.clone()], of_run, group).unwrap_or_default())
            {
                column[run.clone()].copy_from_slice(&term);
            }
        }
        Ok(out)
    }

    fn core(&self, name: &str) -> Result<Vec<Vec<f64>>, Fault> {
        let vector = self.vector(name)?;
        let core = [floats(self.batch, CORE[0])?, floats(self.batch, CORE[1])?, floats(self.batch, CORE[2])?];
        let usable = vector.iter().chain(&core).fold(RowMask::all(self.tt.len()), |u, x| u.and_finite(x));
        let mut out = vec![vec![f64::NAN; self.tt.len()]; CORE_TERMS];
        for run in usable.runs_in_time(self.tt, self.rate_hz()?) {
            let of_run = |v: [&'_ [f64]; 3]| v.map(|x| x[run.clone()].to_vec());
            let (v, c) = (of_run(vector), of_run(core));
            let rows =
                core_terms(v.each_ref().map(Vec::as_slice), c.each_ref().map(Vec::as_slice), self.stage.bt_scale_nt);
            for (column, made) in out.iter_mut().zip(transposed(&rows.unwrap_or_default(), CORE_TERMS)) {
                if made.len() == run.len() {
                    column[run.clone()].copy_from_slice(&made);
                }
            }
        }
        Ok(out)
    }

    fn slope(&self, slope: AnomalySlopeModel) -> Result<Vec<Vec<f64>>, Fault> {
        let [lat, lon] = self.stage.place();
        let (lat, lon) = (floats(self.batch, lat)?, floats(self.batch, lon)?);
        let first = || lat.iter().zip(lon).find(|(a, b)| a.is_finite() && b.is_finite()).map(|(a, b)| (*a, *b));
        let given = self.stage.origin.as_ref().and_then(|o| o.first().copied().zip(o.get(1).copied()));
        let origin = given.or_else(first).ok_or_else(|| Fault::data("no sample has a position"))?;
        Ok(slope.terms(lat, lon, origin))
    }
}

/// A row-major matrix as columns.
fn transposed(rows: &[f64], width: usize) -> Vec<Vec<f64>> {
    (0..width).map(|k| rows.iter().skip(k).step_by(width).copied().collect()).collect()
}

/// The value `n` samples earlier; NaN if there is none.
fn lagged(x: &[f64], n: usize) -> Vec<f64> {
    (0..x.len()).map(|i| i.checked_sub(n).and_then(|k| x.get(k)).copied().unwrap_or(f64::NAN)).collect()
}
