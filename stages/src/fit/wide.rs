//! Summary of the unfiltered rows of a line, from which the residual of any model is computed. It holds means over
//! about a second, and some differences between neighbouring samples (steps).

use std::{collections::BTreeMap, ops::Range};

use arrow_array::RecordBatch;
use arrow_schema::Field;
use numerics::{
    earth::core_field::{CoreFieldModel, CoreFieldTrack},
    signal::noise::{BlockMeans, samples_a_block},
};
use schemas::{CorrectionSet, MagneticCorrection, describe_field};

use crate::{
    columns::floats,
    dates::{first_year, years},
};

/// Number of steps between neighbours kept per line, evenly spaced.
const STEPS: usize = 1000;
/// Range of a target that is a total field, in nT. Core field and diurnal variation of such a target are not noise.
const TOTAL_NT: Range<f64> = 15_000.0..80_000.0;

/// Columns that are subtracted, if the line has them, before the noise is estimated: the core field, or the inputs from
/// which it is computed, and the diurnal variation.
pub const EARTH: [&str; 7] = ["igrf", "diurnal", "ins_lat", "ins_lon", "ins_alt", "year", "doy"];

/// Values of columns over blocks and steps of a line, in the order of [`WidebandLayout`].
type WidebandValues = Vec<f64>;

/// Positions of the blocks and steps on a line.
struct WidebandLayout {
    /// Rows of each run, in blocks of equal length.
    runs: Vec<Range<usize>>,
    block: usize,
    /// First row of each step.
    steps: Vec<usize>,
    rate_hz: f64,
}

impl WidebandLayout {
    fn new(runs: &[Range<usize>], rate_hz: f64) -> Self {
        let block = samples_a_block(rate_hz);
        let whole = |r: &Range<usize>| r.start..r.start + r.len() / block * block;
        let all: Vec<usize> = match block {
            1 => vec![],
            _ => runs.iter().flat_map(|r| r.start..r.end.saturating_sub(1).max(r.start)).collect(),
        };
        let stride = all.len().div_ceil(STEPS).max(1);
        let steps = all.into_iter().step_by(stride).collect();
        Self { runs: runs.iter().map(whole).filter(|r| !r.is_empty()).collect(), block, steps, rate_hz }
    }

    /// Means of a column over the blocks, followed by the steps of the column. `at` returns the value in a row.
    fn values(&self, at: impl Fn(usize) -> f64) -> WidebandValues {
        let blocks = self.runs.iter().flat_map(|r| r.clone().step_by(self.block));
        let mean = |first: usize| (first..first + self.block).map(&at).sum::<f64>() / self.block as f64;
        blocks.map(mean).chain(self.steps.iter().map(|s| at(s + 1) - at(*s))).collect()
    }

    /// Residual in the order of [`WidebandLayout::values`].
    fn blocks(&self, values: &[f64]) -> BlockMeans {
        let mut rest = values;
        let mut runs = vec![];
        for run in &self.runs {
            let (own, after) = rest.split_at((run.len() / self.block).min(rest.len()));
            runs.push(own.to_vec());
            rest = after;
        }
        let (block_s, step_s) = (self.block as f64 / self.rate_hz, 1.0 / self.rate_hz);
        BlockMeans { block_s, step_s, runs, steps: rest.to_vec() }
    }
}

/// Summary of the unfiltered rows of a line, for one set of usable rows.
pub struct WidebandSummary {
    layout: WidebandLayout,
    features: BTreeMap<String, Vec<WidebandValues>>,
    targets: BTreeMap<String, (WidebandValues, CorrectionSet)>,
    /// Core field and diurnal variation of a total field.
    earth: Vec<(MagneticCorrection, WidebandValues)>,
}

impl WidebandSummary {
    /// Summary of the rows `runs` of a line.
    pub fn new(batch: &RecordBatch, runs: &[Range<usize>], rate_hz: f64) -> Self {
        let layout = WidebandLayout::new(runs, rate_hz);
        let core = floats(batch, "igrf").ok().map(|x| layout.values(|row| x[row]));
        let core = core.filter(|x| x.iter().all(|x| x.is_finite())).or_else(|| computed(batch, &layout));
        let diurnal = floats(batch, "diurnal").ok().map(|x| layout.values(|row| x[row]));
        let diurnal = diurnal.filter(|x| x.iter().all(|x| x.is_finite()));
        let earth = [(MagneticCorrection::Core, core), (MagneticCorrection::Diurnal, diurnal)];
        let earth = earth.into_iter().filter_map(|(which, part)| Some((which, part?))).collect();
        Self { layout, features: BTreeMap::new(), targets: BTreeMap::new(), earth }
    }

    /// Adds a feature: a column, or a list of `width` entries per row.
    pub fn feature(&mut self, name: &str, values: &[f64], width: usize) {
        let layout = &self.layout;
        let entry = |at: usize| layout.values(|row| values[row * width + at]);
        self.features.entry(name.to_owned()).or_insert_with(|| (0..width).map(entry).collect());
    }

    /// Adds a target, with the corrections in the metadata of its column.
    pub fn target(&mut self, name: &str, values: &[f64], field: Option<&Field>) {
        let (layout, removed) = (&self.layout, field.map(|field| describe_field(field).removed).unwrap_or_default());
        self.targets.entry(name.to_owned()).or_insert_with(|| (layout.values(|row| values[row]), removed));
    }

    /// Residual of the target. `terms` are the names of all entries of the features, in order. `coefficients` are the
    /// coefficients of the model, with their names.
    pub fn residual<'a>(
        &self,
        target: &str,
        features: &[String],
        terms: &[String],
        coefficients: impl Iterator<Item = (&'a String, &'a f64)>,
    ) -> Option<BlockMeans> {
        let all: Vec<&WidebandValues> = features.iter().filter_map(|f| self.features.get(f)).flatten().collect();
        let (mut left, removed) = self.targets.get(target)?.clone();
        let blocks = left.len() - self.layout.steps.len();
        let mean = left[..blocks].iter().sum::<f64>() / blocks as f64;
        if TOTAL_NT.contains(&mean) {
            for (_, part) in self.earth.iter().filter(|(which, _)| !removed.contains(which)) {
                left.iter_mut().zip(part).for_each(|(l, e)| *l -= e);
            }
        }
        for (term, value) in coefficients {
            let column = all.get(terms.iter().position(|t| t == term)?)?;
            left.iter_mut().zip(*column).for_each(|(l, x)| *l -= value * x);
        }
        left.iter().all(|x| x.is_finite()).then(|| self.layout.blocks(&left))
    }
}

/// Core field at the positions of the INS and the date of the flight.
fn computed(batch: &RecordBatch, layout: &WidebandLayout) -> Option<WidebandValues> {
    first_year(batch).ok()?;
    let [lat, lon, alt] = ["ins_lat", "ins_lon", "ins_alt"].map(|name| floats(batch, name).ok());
    let (lat, lon, alt) = (lat?, lon?, alt?);
    let field =
        CoreFieldTrack::new(CoreFieldModel::Igrf14).field(lat, lon, alt, &years(batch).ok()?).ok()?.magnitude_nt();
    let values = layout.values(|row| field[row]);
    values.iter().all(|x| x.is_finite()).then_some(values)
}
