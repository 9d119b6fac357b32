//! Fits a compensation model to the lines that `where` selects.

use std::{any::Any, collections::BTreeMap, ops::Range, sync::Arc};

use arrow_array::{ArrayRef, Int64Array, RecordBatch, StringArray};
use schemas::{Column, ColumnType, Fault, Gather, LineIn, Passes, Role, Rule, Stage, Table, Yield, stage};

use crate::{
    bandpass::design,
    columns::{array, band, data, faults_of, floats, matrix, no_truth, shape},
    numerics::{
        filter::ConstantColumns,
        least_squares::{QrAccumulator, RidgePath},
        segments::{STEP_TOLERANCE, Usable, filter_matrix, sample_rate},
    },
};

stage! {
    /// Fits the coefficients of a compensation model on all lines that `where` selects together.
    ///
    /// `tolles_lawson`: the terms and the target are band-passed by the same zero-phase filter, `trim` samples are left
    /// out at each end of every run, and the coefficients b minimise |y - A b|^2 + `lambda` |b|^2. The factorisation is a
    /// QR of all rows, line by line, and a singular value decomposition of its triangle: never normal equations, which
    /// square the condition number. One factorisation serves every lambda and every magnetometer of a sweep.
    ///
    /// The filter takes the mean of the target off, so the constant part of the aircraft's field stays unknown.
    ///
    /// Rows with a NaN in a feature or the target, and rows that `where` leaves out, end a run; each run is filtered by
    /// itself, and one too short for filter and trim is left out. `left_out` counts such rows, `n` those used, and
    /// `condition` is the condition number of the filtered matrix: with a large one single coefficients mean little.
    /// With `lambda = 0` terms that the flight does not excite are an error that names them. A line that failed before, or
    /// lacks a column, is left out.
    ///
    /// Source: thesis 000, (3.19) to (3.24).
    Fit = "fit", version 1, grain Survey, inputs [input: Lines];
    /// The model.
    model: String, unit "", rule Rule::OneOf(&["tolles_lawson"]);
    /// The column whose aircraft part is to be explained, such as `mag_4_uc`.
    target: String, unit "nT";
    /// The columns that explain it: lists such as `tl`, or single columns.
    features: Vec<String>, unit "", default ["tl"].map(String::from);
    /// The ridge parameter.
    lambda: f64, unit "", default 0.025, rule Rule::NotNegative;
    /// The lower corner of the filter; 0 leaves it off.
    low_hz: f64, unit "Hz", default 0.1, rule Rule::NotNegative;
    /// The upper corner of the filter; 0 leaves it off.
    high_hz: f64, unit "Hz", default 0.9, rule Rule::NotNegative;
    /// The order of the Butterworth prototype.
    order: usize, unit "", default 4usize, rule Rule::Between(1.0, 12.0);
    /// Samples left out at each end of a run after filtering.
    trim: usize, unit "samples", default 20usize;
    /// Whether a truth column may be a feature.
    allow_truth: bool, unit "", default false;
}

impl Stage for Fit {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = faults_of([shape.number(&self.target, "nT")], "target");
        for name in &self.features {
            let fine = shape.need(name).and_then(|c| match c.column_type {
                ColumnType::Float | ColumnType::List(_) => no_truth(c, "features", self.allow_truth),
                _ => Err(Fault::new(format!("column `{name}` does not hold numbers"))),
            });
            if let Err(fault) = fine {
                let hint = name == "tl" && fault.what.starts_with("there is no column");
                let fault = if hint { fault.help("build the terms first, with `a_matrix`") } else { fault };
                faults.push(fault.of_param(if hint { "input" } else { "features" }));
            }
            if *name == self.target {
                faults.push(
                    Fault::new(format!("`{name}` is the target, so it cannot be a feature")).of_param("features"),
                );
            }
        }
        if self.features.is_empty() {
            faults.push(Fault::new("there is nothing to fit with").of_param("features"));
        }
        faults.extend(band(self.low_hz, self.high_hz, shape.rate_hz));
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = vec!["tt".to_owned(), self.target.clone()];
        reads.extend(self.features.iter().cloned());
        let made = |c: Column| c.from(0, &reads);
        let columns = vec![
            made(Column::text("model", "the model").role(Role::Key)),
            made(Column::text("term", "the term").role(Role::Key)),
            made(Column::float("value", "nT", "the coefficient")),
            made(Column::float("std", "nT", "one sigma of the coefficient, from the residual variance")),
            made(Column::integer("n", "", "rows that were used")),
            made(Column::integer("left_out", "", "rows of the selected lines that were not")),
            made(Column::float("condition", "1", "condition number of the filtered matrix")),
            made(Column::float(
                "residual_std",
                "nT",
                "standard deviation of what the fit leaves of the filtered target",
            )),
        ];
        let mut yields = Yield::append(columns, &reads);
        yields.passes = Passes::None;
        yields.features = self.features.clone();
        yields.tidy = true;
        Ok(yields)
    }

    fn run(&self, _: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        Err(Fault::machine("a fit works on all lines together"))
    }

    fn gather(points: Vec<&Self>) -> Option<Box<dyn Gather>> {
        Some(Box::new(FitGather { points: points.into_iter().cloned().collect() }))
    }
}

/// What the points of a sweep share: the same matrix, filtered in the same way.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Matrix {
    features: Vec<String>,
    filter: (u64, u64, usize),
    trim: usize,
}

impl Fit {
    fn matrix(&self) -> Matrix {
        let filter = (self.low_hz.to_bits(), self.high_hz.to_bits(), self.order);
        Matrix { features: self.features.clone(), filter, trim: self.trim }
    }
}

struct FitGather {
    points: Vec<Fit>,
}

/// One line's share of a fit: the triangle of its rows, and how many there were.
struct Share {
    factor: QrAccumulator,
    rows: usize,
}

/// One line's shares, by matrix and target, with the names of each matrix' terms.
#[derive(Default)]
struct Part {
    shares: BTreeMap<(Matrix, String), Share>,
    terms: BTreeMap<Matrix, Vec<String>>,
}

impl FitGather {
    /// The targets of each matrix.
    fn questions(&self) -> BTreeMap<Matrix, Vec<String>> {
        let mut all: BTreeMap<Matrix, Vec<String>> = BTreeMap::new();
        for point in &self.points {
            let targets = all.entry(point.matrix()).or_default();
            if !targets.contains(&point.target) {
                targets.push(point.target.clone());
            }
        }
        all
    }
}

impl Gather for FitGather {
    fn map(&self, line: &LineIn) -> Result<Box<dyn Any + Send>, Fault> {
        let batch = &line.inputs[0];
        let mut part = Part::default();
        for (key, targets) in self.questions() {
            // A line that lacks a column has no share in that fit.
            let Ok(features) = Features::new(batch, &key.features) else { continue };
            part.terms.insert(key.clone(), features.terms.clone());
            for (runs, rows, targets) in grouped(line, &features, &targets)? {
                let shares = shares(batch, &key, &features, &runs, &targets)?;
                for (target, factor) in targets.iter().zip(shares) {
                    part.shares.insert((key.clone(), target.clone()), Share { factor, rows });
                }
            }
        }
        Ok(Box::new(part))
    }

    fn finish(&self, parts: Vec<Box<dyn Any + Send>>) -> Vec<Result<Vec<ArrayRef>, Fault>> {
        let parts: Vec<&Part> = parts.iter().filter_map(|p| p.downcast_ref::<Part>()).collect();
        let mut solved: BTreeMap<(Matrix, String), Result<Solved, Fault>> = BTreeMap::new();
        for point in &self.points {
            let at = (point.matrix(), point.target.clone());
            solved.entry(at.clone()).or_insert_with(|| Solved::new(&parts, &at, &self.lambdas(&at)));
        }
        let one = |point: &Fit| match solved.get(&(point.matrix(), point.target.clone())) {
            Some(Ok(s)) => s.table(point),
            Some(Err(fault)) => Err(fault.clone()),
            None => Err(Fault::machine("a fit was lost")),
        };
        self.points.iter().map(one).collect()
    }
}

impl FitGather {
    fn lambdas(&self, at: &(Matrix, String)) -> Vec<f64> {
        let same = self.points.iter().filter(|p| p.matrix() == at.0 && p.target == at.1);
        same.map(|p| p.lambda).collect()
    }
}

/// The columns of a matrix, still where they are.
struct Features<'a> {
    blocks: Vec<(&'a [f64], usize)>,
    terms: Vec<String>,
}

impl<'a> Features<'a> {
    fn new(batch: &'a RecordBatch, names: &[String]) -> Result<Self, Fault> {
        let (mut blocks, mut terms) = (vec![], vec![]);
        for name in names {
            match matrix(batch, name) {
                Ok((values, names)) => {
                    blocks.push((values, names.len()));
                    terms.extend(names);
                }
                Err(_) => {
                    blocks.push((floats(batch, name)?, 1));
                    terms.push(name.clone());
                }
            }
        }
        Ok(Self { blocks, terms })
    }

    /// The rows of `runs`, one after the other, row-major.
    fn rows(&self, runs: &[Range<usize>]) -> Vec<f64> {
        let mut out = Vec::with_capacity(runs.iter().map(Range::len).sum::<usize>() * self.terms.len());
        for row in runs.iter().cloned().flatten() {
            for (values, width) in &self.blocks {
                out.extend_from_slice(&values[row * width..(row + 1) * width]);
            }
        }
        out
    }
}

type Group = (Vec<Range<usize>>, usize, Vec<String>);

/// The targets with the same usable rows, so that those share the filtering of the matrix.
fn grouped(line: &LineIn, features: &Features, targets: &[String]) -> Result<Vec<Group>, Fault> {
    let batch = &line.inputs[0];
    let tt = floats(batch, "tt")?;
    let rate_hz = sample_rate(tt, STEP_TOLERANCE).map_err(|e| data(e).in_column("tt").help("resample first"))?;
    let selected = match &line.keep {
        Some(keep) => Usable::selected(keep),
        None => Usable::all(tt.len()),
    };
    let rows = selected.rows().iter().filter(|k| **k).count();
    let usable = features.blocks.iter().fold(selected, |u, (values, width)| u.and_finite_rows(values, *width));
    let mut groups: Vec<Group> = vec![];
    for target in targets {
        let Ok(y) = floats(batch, target) else { continue };
        let runs = usable.clone().and_finite(y).runs_in_time(tt, rate_hz);
        match groups.iter_mut().find(|(r, _, _)| *r == runs) {
            Some((_, _, names)) => names.push(target.clone()),
            None => groups.push((runs, rows, vec![target.clone()])),
        }
    }
    Ok(groups)
}

/// The triangle of each target's filtered and trimmed rows.
fn shares(
    batch: &RecordBatch,
    key: &Matrix,
    features: &Features,
    runs: &[Range<usize>],
    targets: &[String],
) -> Result<Vec<QrAccumulator>, Fault> {
    let (low_hz, high_hz, order) = (f64::from_bits(key.filter.0), f64::from_bits(key.filter.1), key.filter.2);
    let rate_hz = sample_rate(floats(batch, "tt")?, STEP_TOLERANCE).map_err(data)?;
    let filter = design(low_hz, high_hz, order, rate_hz)?;
    let least = filter.as_ref().map_or(1, |f| f.least_rows()).max(2 * key.trim + 1);
    let runs: Vec<Range<usize>> = runs.iter().filter(|r| r.len() >= least).cloned().collect();
    let (width, count) = (features.terms.len(), targets.len());
    let mut a = features.rows(&runs);
    let columns = targets.iter().map(|t| floats(batch, t)).collect::<Result<Vec<_>, _>>()?;
    let mut y: Vec<f64> = runs.iter().cloned().flatten().flat_map(|row| columns.iter().map(move |c| c[row])).collect();
    // The same runs, in rows of what was taken together.
    let mut start = 0;
    let packed: Vec<Range<usize>> = runs
        .iter()
        .map(|r| {
            start += r.len();
            start - r.len()..start
        })
        .collect();
    if let Some(filter) = &filter {
        filter_matrix(filter, &mut a, width, &packed, ConstantColumns::Keep).map_err(data)?;
        filter_matrix(filter, &mut y, count, &packed, ConstantColumns::Filter).map_err(data)?;
    }
    let kept: Vec<Range<usize>> = packed.iter().map(|r| r.start + key.trim..r.end - key.trim).collect();
    let columns: Vec<Vec<f64>> = (0..count).map(|i| y.iter().skip(i).step_by(count).copied().collect()).collect();
    let mut factor = QrAccumulator::new(width, count);
    for run in kept {
        let targets: Vec<&[f64]> = columns.iter().map(|c| &c[run.clone()]).collect();
        factor.push(&a[run.start * width..run.end * width], &targets).map_err(data)?;
    }
    Ok((0..count).map(|i| factor.select(&[i])).collect())
}

/// The path that a fit is on, and its place there.
type OnPath = (Arc<RidgePath>, usize);

/// The fits of one target, for each lambda.
struct Solved {
    fits: Vec<(f64, Result<OnPath, Fault>)>,
    n: usize,
    left_out: usize,
}

impl Solved {
    fn new(parts: &[&Part], at: &(Matrix, String), lambdas: &[f64]) -> Result<Solved, Fault> {
        let terms = parts.iter().find_map(|p| p.terms.get(&at.0));
        let terms = terms.ok_or_else(|| Fault::data("no selected line has the features of the fit"))?;
        let mut all = QrAccumulator::new(terms.len(), 1);
        let mut rows = 0;
        // In the order of the lines, so that the last bits do not depend on the threads.
        for share in parts.iter().filter_map(|p| p.shares.get(at)) {
            all.merge(share.factor.clone()).map_err(data)?;
            rows += share.rows;
        }
        let n = all.rows();
        if n == 0 {
            let what =
                format!("no run of samples with `{}` and all features is long enough to be filtered and trimmed", at.1);
            return Err(Fault::data(what).help("select longer lines, or take a smaller `trim` or `order`"));
        }
        let fits = match all.solve(lambdas, terms) {
            Ok(path) => {
                let path = Arc::new(path);
                lambdas.iter().enumerate().map(|(i, l)| (*l, Ok((path.clone(), i)))).collect()
            }
            // One that cannot be solved, such as 0 with terms that nothing excites, must not take the others with it.
            Err(_) => {
                let alone = |l: &f64| all.solve(&[*l], terms).map(|path| (Arc::new(path), 0)).map_err(data);
                lambdas.iter().map(|l| (*l, alone(l))).collect()
            }
        };
        Ok(Solved { fits, n, left_out: rows - n })
    }

    fn table(&self, point: &Fit) -> Result<Vec<ArrayRef>, Fault> {
        let found = self.fits.iter().find(|(l, _)| l.to_bits() == point.lambda.to_bits());
        let (_, fit) = found.ok_or_else(|| Fault::machine("a fit was lost"))?;
        let (path, at) = fit.as_ref().map_err(Clone::clone)?;
        let solution = path.solutions.get(*at).ok_or_else(|| Fault::machine("a fit was lost"))?;
        let values = solution.coefficients.first().cloned().unwrap_or_default();
        let rows = values.len();
        let covariance = path.covariance(*at, 0).unwrap_or_default();
        let std: Vec<f64> = (0..rows).map(|i| covariance.get(i * rows + i).map_or(f64::NAN, |v| v.sqrt())).collect();
        let same = |text: &str| -> ArrayRef { Arc::new(StringArray::from(vec![text; rows])) };
        let count = |n: usize| -> ArrayRef { Arc::new(Int64Array::from(vec![n as i64; rows])) };
        let left = solution.residual_variances.first().map_or(f64::NAN, |v| v.sqrt());
        Ok(vec![
            same(&point.model),
            Arc::new(path.terms.iter().map(Some).collect::<StringArray>()),
            array(values),
            array(std),
            count(self.n),
            count(self.left_out),
            array(vec![path.condition; rows]),
            array(vec![left; rows]),
        ])
    }
}
