//! Rows of one line, which are selected, filtered, trimmed and reduced to moments.

use std::{collections::BTreeMap, ops::Range};

use arrow_array::RecordBatch;
use numerics::{
    regression::{
        cross_spectra::{CrossSpectra, ResidualDrift},
        least_squares::{MomentsAccumulator, RegressionMoments},
    },
    signal::{
        filter::ConstantColumns,
        segments::{RowMask, filter_matrix},
    },
};
use schemas::{Fault, LineInput, RateDependence, RateLaw};

use super::{
    question::{DesignMatrixKey, FitRequest, TargetColumns},
    wide::WidebandSummary,
};
use crate::{
    bandpass::design,
    columns::{data, even_rate_hz, floats, matrix, sampling},
};

/// Number of unfiltered rows kept per line, evenly spaced. This number suffices to recognise a total field.
const THINNED: usize = 500;
/// Errors of coefficients are computed only for fits with fewer columns than this number, because the cost of the
/// cross-spectra grows with the square of the number of columns.
pub const MOST_WITH_ERRORS: usize = 96;

/// Dependence of a term on the sample rate, and the rate at which the term was computed, in Hz. `None` if the term does
/// not depend on the rate.
pub type TermRate = Option<(RateLaw, f64)>;

/// Contribution of one line to a fit.
pub struct LineContribution {
    /// Moments of the filtered and trimmed rows.
    pub moments: RegressionMoments,
    /// Moments of some unfiltered rows.
    pub unfiltered: Option<RegressionMoments>,
    /// Rows, if the model requires rows.
    pub rows: Option<FitRows>,
    /// Cross-spectra of these rows, the target last, if errors of coefficients are requested.
    pub spectra: Option<CrossSpectra>,
    /// Number of rows of the line that `where` selects.
    pub selected: usize,
    /// Number of rows of the longest run, and the smallest number that is enough for filter and trim.
    pub longest: (usize, usize),
}

/// Filtered and trimmed rows of a line.
pub struct FitRows {
    /// Terms, row-major.
    pub a: Vec<f64>,
    /// Target of each row.
    pub y: Vec<f64>,
    /// Runs of consecutive samples.
    pub runs: Vec<Range<usize>>,
    /// Sample rate, in Hz.
    pub rate_hz: f64,
}

/// Summary of the unfiltered rows of a line, and the requests that use these rows.
pub struct WidebandContribution {
    pub asked: Vec<(DesignMatrixKey, TargetColumns)>,
    pub wide: WidebandSummary,
}

/// Contributions of one line, by matrix and targets, with the names of the terms of each matrix.
#[derive(Default)]
pub struct FitLineSummary {
    pub flight: String,
    pub line: String,
    /// Sample rate, in Hz.
    pub rate_hz: f64,
    pub shares: BTreeMap<(DesignMatrixKey, TargetColumns), LineContribution>,
    /// Fault for each request to which this line cannot contribute.
    pub refused: BTreeMap<(DesignMatrixKey, TargetColumns), Fault>,
    pub terms: BTreeMap<DesignMatrixKey, Vec<String>>,
    /// Dependence of each term in `terms` on the sample rate.
    pub rates: BTreeMap<DesignMatrixKey, Vec<TermRate>>,
    pub wide: Vec<WidebandContribution>,
}

/// Column, or list column with several entries per row, borrowed from a table.
struct FeatureBlock<'a> {
    values: &'a [f64],
    names: Vec<String>,
    sampling: RateDependence,
}

impl<'a> FeatureBlock<'a> {
    fn new(batch: &'a RecordBatch, name: &str) -> Result<Self, Fault> {
        match matrix(batch, name) {
            Ok((values, names)) => Ok(Self { values, names, sampling: sampling(batch, name)? }),
            Err(_) => {
                let (values, names) = (floats(batch, name)?, vec![name.to_owned()]);
                Ok(Self { values, names, sampling: RateDependence::default() })
            }
        }
    }

    fn rates(&self) -> impl Iterator<Item = TermRate> + '_ {
        self.names.iter().map(|name| self.sampling.law(name).zip(self.sampling.rate_hz))
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.names.len()..(row + 1) * self.names.len()]
    }
}

/// Requests with the same filter, for which the same rows of a line can be used.
struct FitRequestGroup<'a> {
    runs: Vec<Range<usize>>,
    selected: usize,
    asked: Vec<(&'a DesignMatrixKey, Vec<TargetColumns>)>,
}

impl FitLineSummary {
    /// Reduces a line to its contributions. A request for a column that the line lacks has no contribution.
    ///
    /// Columns that several requests share are filtered once. The moments of each request are bit-identical to the
    /// moments computed for that request alone.
    ///
    /// # Errors
    /// Fails if the line has no numeric column `tt`, or no sample rate follows from its times. A fault that concerns a
    /// single request is stored in the result instead.
    pub fn new(line: &LineInput, questions: &BTreeMap<DesignMatrixKey, FitRequest>) -> Result<FitLineSummary, Fault> {
        let batch = &line.inputs[0];
        let tt = floats(batch, "tt")?;
        let rate_hz = even_rate_hz(tt)?;
        let mut part = FitLineSummary {
            flight: line.flight.clone(),
            line: line.line.clone(),
            rate_hz,
            ..FitLineSummary::default()
        };
        let mut blocks: BTreeMap<&str, FeatureBlock> = BTreeMap::new();
        let mut groups: Vec<FitRequestGroup> = vec![];
        for (key, question) in questions {
            for name in &key.features {
                if let (false, Ok(block)) = (blocks.contains_key(name.as_str()), FeatureBlock::new(batch, name)) {
                    blocks.insert(name, block);
                }
            }
            let own: Option<Vec<&FeatureBlock>> = key.features.iter().map(|n| blocks.get(n.as_str())).collect();
            let Some(own) = own else { continue };
            part.terms.insert(key.clone(), own.iter().flat_map(|b| b.names.clone()).collect());
            part.rates.insert(key.clone(), own.iter().flat_map(|b| b.rates()).collect());
            let selected = line.keep.as_ref().map_or_else(|| RowMask::all(tt.len()), |keep| RowMask::selected(keep));
            let count = selected.rows().iter().filter(|k| **k).count();
            let usable = own.iter().fold(selected, |u, b| u.and_finite_rows(b.values, b.names.len()));
            for targets in &question.targets {
                let columns: Result<Vec<_>, _> = targets.iter().map(|t| floats(batch, t)).collect();
                let Ok(columns) = columns else { continue };
                let runs = columns.iter().fold(usable.clone(), |u, y| u.and_finite(y)).runs_in_time(tt, rate_hz);
                join(&mut groups, runs, count, key, targets);
            }
        }
        for group in &groups {
            // A fault in the filter of one group of requests does not affect the other groups.
            if let Err(fault) = fold(&mut part, batch, &blocks, group, questions, rate_hz) {
                let asked = group.asked.iter().flat_map(|(k, all)| all.iter().map(move |t| ((*k).clone(), t.clone())));
                for at in asked {
                    part.shares.remove(&at);
                    part.refused.insert(at, fault.clone());
                }
            }
        }
        Ok(part)
    }
}

fn join<'a>(
    groups: &mut Vec<FitRequestGroup<'a>>,
    runs: Vec<Range<usize>>,
    selected: usize,
    key: &'a DesignMatrixKey,
    together: &TargetColumns,
) {
    let same = |g: &FitRequestGroup| {
        g.runs == runs && g.asked.first().is_some_and(|(k, _)| k.filter == key.filter && k.trim == key.trim)
    };
    let group = match groups.iter().position(same) {
        Some(i) => &mut groups[i],
        None => {
            groups.push(FitRequestGroup { runs, selected, asked: vec![] });
            let last = groups.len() - 1;
            &mut groups[last]
        }
    };
    match group.asked.iter_mut().find(|(k, _)| *k == key) {
        Some((_, asked)) => asked.push(together.clone()),
        None => group.asked.push((key, vec![together.clone()])),
    }
}

/// Columns joined into one row-major matrix.
struct FeatureMatrix {
    values: Vec<f64>,
    width: usize,
}

impl FeatureMatrix {
    fn column(&self, at: usize) -> impl Iterator<Item = f64> + '_ {
        self.values.iter().skip(at).step_by(self.width.max(1)).copied()
    }

    /// The columns `columns` in the rows of `runs`, row-major.
    fn part(&self, columns: &[usize], runs: &[Range<usize>]) -> Vec<f64> {
        let mut out = Vec::with_capacity(runs.iter().map(Range::len).sum::<usize>() * columns.len());
        for row in runs.iter().cloned().flatten() {
            let row = &self.values[row * self.width..(row + 1) * self.width];
            out.extend(columns.iter().map(|&c| row[c]));
        }
        out
    }
}

fn fold(
    part: &mut FitLineSummary,
    batch: &RecordBatch,
    blocks: &BTreeMap<&str, FeatureBlock>,
    group: &FitRequestGroup,
    questions: &BTreeMap<DesignMatrixKey, FitRequest>,
    rate_hz: f64,
) -> Result<(), Fault> {
    let Some((first, _)) = group.asked.first() else { return Ok(()) };
    let (low_hz, high_hz, order) = (f64::from_bits(first.filter.0), f64::from_bits(first.filter.1), first.filter.2);
    let filter = design(low_hz, high_hz, order, rate_hz)?;
    let least = filter.as_ref().map_or(1, |f| f.least_rows()).max(2 * first.trim + 1);
    let runs: Vec<Range<usize>> = group.runs.iter().filter(|r| r.len() >= least).cloned().collect();
    part.wide.push(unfiltered(batch, blocks, group, &runs, rate_hz)?);
    let (whole, kept) = packed(&runs, first.trim);
    let (sheet, places) = features(blocks, group, &runs);
    let names = targets(group);
    let y = names.iter().map(|n| floats(batch, n)).collect::<Result<Vec<_>, _>>()?;
    let y: Vec<f64> = runs.iter().cloned().flatten().flat_map(|row| y.iter().map(move |c| c[row])).collect();
    let y = FeatureMatrix { values: y, width: names.len() };
    let raw = if filter.is_some() { thinned(&sheet, &y) } else { None };
    let (mut sheet, mut y) = (sheet, y);
    if let Some(filter) = &filter {
        filter_matrix(filter, &mut sheet.values, sheet.width, &whole, ConstantColumns::Keep).map_err(data)?;
        filter_matrix(filter, &mut y.values, y.width, &whole, ConstantColumns::Filter).map_err(data)?;
    }
    for (key, wanted) in &group.asked {
        let columns: Vec<usize> = key.features.iter().flat_map(|n| places[n.as_str()].clone()).collect();
        let place = |name: &String| names.iter().position(|n| n == name);
        let mut at: Vec<usize> = vec![];
        for column in wanted.iter().flatten().filter_map(place) {
            if !at.contains(&column) {
                at.push(column);
            }
        }
        let mut folded = MomentsAccumulator::new(columns.len(), at.len());
        for run in &kept {
            let run = std::slice::from_ref(run);
            let ys: Vec<Vec<f64>> = at.iter().map(|c| y.part(&[*c], run)).collect();
            let ys: Vec<&[f64]> = ys.iter().map(Vec::as_slice).collect();
            folded.push(&sheet.part(&columns, run), &ys).map_err(data)?;
        }
        let question = questions.get(*key);
        let keeps = question.map(|q| q.keeps_rows.as_slice()).unwrap_or_default();
        let errors = question.map(|q| q.wants_errors.as_slice()).unwrap_or_default();
        let with_errors = columns.len() < MOST_WITH_ERRORS && wanted.iter().any(|t| errors.contains(t));
        let ends = if low_hz > 0.0 { ResidualDrift::Bound } else { ResidualDrift::Wandering };
        let spectra = with_errors.then(|| spectra((&sheet, &columns), (&y, &at), &kept, (rate_hz, ends)));
        for together in wanted {
            let own: Vec<usize> = together.iter().filter_map(place).collect();
            let chosen: Vec<usize> = own.iter().filter_map(|c| at.iter().position(|a| a == c)).collect();
            let rows = keeps.contains(together).then(|| {
                let (a, y) = (sheet.part(&columns, &kept), y.part(&own, &kept));
                FitRows { a, y, runs: packed(&kept, 0).0, rate_hz }
            });
            let unfiltered = raw.as_ref().map(|(a, y)| {
                let all = 0..a.values.len() / a.width.max(1);
                let rows = a.part(&columns, std::slice::from_ref(&all));
                let ys: Vec<Vec<f64>> = own.iter().map(|c| y.column(*c).collect()).collect();
                RegressionMoments::from_matrix(&rows, columns.len(), &ys.iter().map(Vec::as_slice).collect::<Vec<_>>())
            });
            let share = LineContribution {
                moments: folded.select(&chosen).finish(),
                spectra: spectra.as_ref().filter(|_| errors.contains(together)).map(|spectra| {
                    let target = chosen.iter().map(|target| columns.len() + target);
                    let own: Vec<(usize, f64)> = (0..columns.len()).chain(target.take(1)).map(|c| (c, 1.0)).collect();
                    spectra.select(&own)
                }),
                unfiltered: unfiltered.transpose().map_err(data)?,
                rows,
                selected: group.selected,
                longest: (group.runs.iter().map(Range::len).max().unwrap_or(0), least),
            };
            part.shares.insert(((*key).clone(), together.clone()), share);
        }
    }
    Ok(())
}

/// Cross-spectra of columns and targets over runs of rows.
fn spectra(
    (sheet, columns): (&FeatureMatrix, &[usize]),
    (y, at): (&FeatureMatrix, &[usize]),
    kept: &[Range<usize>],
    (rate_hz, ends): (f64, ResidualDrift),
) -> CrossSpectra {
    let mut spectra = CrossSpectra::new(columns.len() + at.len(), ends);
    for run in kept {
        let run = std::slice::from_ref(run);
        let (a, y) = (sheet.part(columns, run), y.part(at, run));
        let rows = a.chunks_exact(columns.len().max(1)).zip(y.chunks_exact(at.len().max(1)));
        spectra.push(&rows.flat_map(|(a, y)| a.iter().chain(y).copied()).collect::<Vec<f64>>(), rate_hz);
    }
    spectra
}

/// Data from which the residual noise of the group's models is estimated.
fn unfiltered(
    batch: &RecordBatch,
    blocks: &BTreeMap<&str, FeatureBlock>,
    group: &FitRequestGroup,
    runs: &[Range<usize>],
    rate_hz: f64,
) -> Result<WidebandContribution, Fault> {
    let mut wide = WidebandSummary::new(batch, runs, rate_hz);
    for name in group.asked.iter().flat_map(|(key, _)| &key.features) {
        if let Some(block) = blocks.get(name.as_str()) {
            wide.feature(name, block.values, block.names.len());
        }
    }
    for name in targets(group) {
        wide.target(&name, floats(batch, &name)?, batch.schema().field_with_name(&name).ok());
    }
    let asked = group.asked.iter().flat_map(|(key, all)| all.iter().map(|t| ((*key).clone(), t.clone())));
    Ok(WidebandContribution { asked: asked.collect(), wide })
}

/// Ranges of the runs after they are joined into one sequence: the whole runs, and the runs without `trim` rows at each
/// end.
fn packed(runs: &[Range<usize>], trim: usize) -> (Vec<Range<usize>>, Vec<Range<usize>>) {
    let mut start = 0;
    let mut whole = vec![];
    for run in runs {
        whole.push(start..start + run.len());
        start += run.len();
    }
    let kept = whole.iter().map(|r| r.start + trim..r.end - trim).collect();
    (whole, kept)
}

/// Matrix of all features of a group without duplicates, and the columns of each feature in this matrix.
fn features<'a>(
    blocks: &BTreeMap<&'a str, FeatureBlock>,
    group: &FitRequestGroup,
    runs: &[Range<usize>],
) -> (FeatureMatrix, BTreeMap<&'a str, Range<usize>>) {
    let mut places: BTreeMap<&str, Range<usize>> = BTreeMap::new();
    let (mut used, mut width): (Vec<&FeatureBlock>, usize) = (vec![], 0);
    for name in group.asked.iter().flat_map(|(key, _)| &key.features) {
        let Some((name, block)) = blocks.get_key_value(name.as_str()) else { continue };
        if places.contains_key(name) {
            continue;
        }
        places.insert(name, width..width + block.names.len());
        width += block.names.len();
        used.push(block);
    }
    let mut values = Vec::with_capacity(runs.iter().map(Range::len).sum::<usize>() * width);
    for row in runs.iter().cloned().flatten() {
        used.iter().for_each(|block| values.extend_from_slice(block.row(row)));
    }
    (FeatureMatrix { values, width }, places)
}

fn targets(group: &FitRequestGroup) -> Vec<String> {
    let mut names: Vec<String> = vec![];
    for target in group.asked.iter().flat_map(|(_, asked)| asked.iter().flatten()) {
        if !names.contains(target) {
            names.push(target.clone());
        }
    }
    names
}

/// Evenly spaced rows of features and targets. `None` if there are no rows.
fn thinned(a: &FeatureMatrix, y: &FeatureMatrix) -> Option<(FeatureMatrix, FeatureMatrix)> {
    let rows = y.values.len() / y.width.max(1);
    let step = rows.div_ceil(THINNED).max(1);
    let of = |sheet: &FeatureMatrix| {
        let chosen =
            (0..rows).step_by(step).flat_map(|r| sheet.values[r * sheet.width..(r + 1) * sheet.width].to_vec());
        FeatureMatrix { values: chosen.collect(), width: sheet.width }
    };
    (rows > 0).then(|| (of(a), of(y)))
}
