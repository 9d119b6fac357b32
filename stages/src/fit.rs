//! Fits a compensation model to the lines that `where` selects.

mod boosted_trees;
mod components;
mod elastic_net;
mod etlnn;
mod extended_tolles_lawson;
mod gru;
mod learning;
mod lstm;
mod m1;
mod m2a;
mod m2b;
mod m2c;
mod m2d;
mod model;
mod models;
mod network;
mod pls;
mod point;
mod problem;
mod question;
mod random_features;
mod recursive_least_squares;
mod residual;
mod ridge;
mod robust;
mod rows;
mod samples;
mod settings;
mod solve;
mod tcn;
#[cfg(test)]
mod testing;
mod tlnn;
mod tolles_lawson;
mod truncated_svd;
mod wide;

use std::{collections::BTreeMap, sync::Arc};

use arrow_array::{ArrayRef, Int64Array, RecordBatch, StringArray};
use point::Point;
use question::{Matrix, Question, Targets};
use rayon::prelude::*;
use residual::residual_noise;
use rows::{MOST_WITH_ERRORS, Part};
use schemas::{
    Chosen, Column, ColumnType, Entry, Fault, Gather, LineIn, Lists, Passes, Product, Role, Rule, Shape, Stage,
    SurveyPoint, SurveyStage, Table, Work, Yield, stage,
};
use solve::{Row, Solved, solve};
use wide::EARTH;

pub use model::{Answer, FitModel, Learnt, Model, model};
pub use models::MODELS;
pub use numerics::regression::least_squares::{LinearFit, Prepared};
pub use problem::Problem;
pub use ridge::ridge;
pub use samples::Samples;
pub use settings::{Choose, Divisor, MadeOf, Settings};

use crate::{
    columns::{array, band, faults_of, no_truth, shape},
    fitted::{Body, Fitted},
    model_columns::RATE,
    trained::Learned,
};

stage! {
    /// Fits the coefficients of a compensation model on all lines that `where` selects together.
    ///
    /// Terms and target are band-passed by the same zero-phase filter (`low_hz = 0` and `high_hz = 0` leave it off),
    /// `trim` samples are left out at each end of every run, and the model is fitted to what remains. Each of the models below
    /// has keys of its own; a key of another model is refused.
    ///
    /// The model of Tolles and Lawson has the feature `tl`, of `a_matrix`; those of all other names are made by `features`.
    /// The two-step model of thesis 004 is two fits with a `compensate` between them, the second with target `mag_c`.
    ///
    /// `choose` finds `lambda` or the number of components: by generalised cross-validation, at the corner of the L-curve,
    /// or by leaving each line, or each flight with all its lines, out in turn and predicting it. Lines are left out whole,
    /// so that no sample of a line helps to predict its neighbours; flights whole, so that what lasts from take-off to
    /// landing, such as a magnetisation or a temperature, does not help either. A line left out is scored by the variance
    /// (over n) of what the prediction misses: its mean does not count, for a filter takes constants off and compensation
    /// leaves them undetermined; all lines count alike. What was found stands in the column `chosen`.
    ///
    /// A sweep is solved together. Each line has one triangular factor, never normal equations, which square the
    /// condition number. Every lambda, number of components and omitted line is solved on these factors. Coefficients
    /// are in the units of the columns for every `scaling`, with the intercept as the term `intercept`.
    ///
    /// `std` is one sigma of a coefficient, of the spectrum of the residual and those of the terms, in bands: the filter
    /// and coloured noise make samples depend on each other, which counts. A residual that wanders, as a random walk does without
    /// a filter, counts with its ramp from the first sample to the last; the intercept's `std` does not hold what the walk
    /// itself moves the mean by. It is null with 96 or more terms, which is noted, and of models other than ridges.
    ///
    /// `rate_hz` is the rate of the first line. Terms that are differences per sample, such as `xx_dot`, are brought to it on
    /// lines of other rates, so that coefficients hold at this rate; values of earlier samples have no equivalent at
    /// another rate and are refused there. A training that begins with `warm_start` keeps the rate of that table.
    ///
    /// A filter takes the mean of the target off, so the constant part of the aircraft's field stays unknown.
    ///
    /// Rows with a NaN in a feature or the target, and rows that `where` leaves out, end a run; each run is filtered by
    /// itself, and one too short for filter and trim is left out. `left_out` counts such rows, `n` those used, `lines`
    /// names the lines that these are of, and
    /// `condition` is the condition number of the filtered matrix: with a large one single coefficients mean little.
    /// With `lambda = 0` terms that the flight does not excite are an error that names them. `trivial_share` is the part of
    /// the total field that the fit calls the aircraft's, 1 for the trivial solution of band-passed fits; `warning` says
    /// what is wrong with a fit, and is empty where nothing is. A line that failed before, or lacks a column, is left out;
    /// so is one that is not evenly sampled or whose rate the filter does not fit, which the table `failures` then names.
    ///
    /// `approximation_bound` is what the model's form alone can miss at most: it takes the aircraft's field along the
    /// earth's for the change of the magnitude, which leaves out up to b^2/2 of the field, b being the ratio of the two. It
    /// is worked out from the permanent and induced coefficients for the worst attitude; null where the terms or the
    /// target, which must be a total field, do not give it.
    ///
    /// `residual_sigma`, `residual_fogm_sigma` and `residual_fogm_tau` are the noise of what the model compensates, over all
    /// frequencies: the white and the first-order Gauss-Markov part, the least that bound the Allan variance of the unfiltered
    /// target less the model on the lines of the fit. Of a total field the columns `igrf` and `diurnal` are taken off where
    /// the line has them; without `igrf` the core field is that at the positions of the INS and the line's date. Geology
    /// is not known here and counts as noise, so that calibrating low over it makes these figures larger than they need be;
    /// a time constant beyond the length of the lines cannot be told from that length. They are null where the lines are
    /// too short, less than 16 s.
    ///
    /// `warm_start` names the table of another fit of the same kind of network, or a published one: the training begins with
    /// its weights in place of random ones, such as those of another aircraft of which more was flown. Inputs, layers,
    /// activation, linear terms and members must be the same. Inputs and target keep the scales of that network, so that its
    /// weights mean what they meant; its constant does not count and becomes that of the new lines. Coefficients that are
    /// trained (`m2c`) begin as its own; those that are not (`m2b`, `m2d`, `tlnn`, `etlnn`) are fitted to the new lines as ever.
    ///
    /// Source: thesis 000, (3.19) to (3.43), Figure 5-6 of `warm_start`; thesis 004, sections 2.2 to 2.4, 4.2.1 and Figure 4.2.
    Fit = "fit", version 5, grain Survey, inputs [input: Lines, warm_start: Model optional],
    example r#"
[[stages]]
name   = "fit"
stage  = "fit"
input  = "a_matrix"
where  = "line like '%.01'"
model  = "tolles_lawson"
target = "mag_4_uc"
lambda = 0.025
"#;
    /// The model.
    model: Chosen<Model>, unit "";
    /// The column to explain, such as `mag_4_uc`, or `target` of the stage of that name.
    target: String, unit "nT";
    /// The columns that explain it: lists such as `tl` and `features`, or single columns.
    features: Vec<String>, unit "", default ["tl"].map(String::from);
    /// Which entries of the lists among `features` are used, in this order: their names, or what several names have before
    /// a `_`, such as `TL_A_flux_a`. A row must be finite in the whole lists. The lists are factored once
    /// for all such choices, so that a sweep over them costs next to nothing.
    entries: Option<Vec<String>>, unit "", absent "all";
    /// How `lambda` or `components` is found; what it may be depends on the model.
    choose: Choose, unit "", default Choose::Given;
    /// With `choose` by lines or flights, takes the simplest model whose error is within one standard error of the
    /// least.
    one_standard_error: bool, unit "", default false;
    /// Divisor of the columns before they are penalised. `standardise` is by the standard deviation over n - 1, as in
    /// MagNav.jl and in the partial least squares and whitened components of scikit-learn. Its `StandardScaler` divides
    /// by that over n: the same ridge takes `lambda` n / (n - 1) there.
    scaling: Option<Divisor>, unit "", absent "that of the model";
    /// Fit to the whitened principal components of the features in place of the features: how many of them, or below 1 the
    /// part of the variance that they hold. Coefficients are still those of the features.
    whiten: Option<f64>, unit "", absent "the features themselves", rule Rule::Positive;
    /// Whether a constant is fitted too, without a penalty.
    intercept: Option<bool>, unit "", absent "that of the model, and true with `whiten`";
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

/// The row of the catalogue, with `models` to choose from.
pub fn entry(models: Vec<&'static Model>) -> Entry {
    let kinds = models.iter().map(|model| model.document()).collect();
    Entry { kinds, ..Fit::entry_with(Lists::default().with(models)) }
}

impl Fit {
    /// The defaults of the model put in.
    fn settings(&self) -> Settings {
        let (model, whiten) = (self.model.kind, self.whiten.filter(|_| self.model.takes("whiten")));
        Settings {
            scaling: self.scaling.unwrap_or(model.scaling).scaling(),
            // Components are made of columns without their means, so a constant belongs to them.
            intercept: self.intercept.unwrap_or(model.intercept || whiten.is_some()),
            choose: self.choose,
            one_standard_error: self.one_standard_error,
            whiten,
        }
    }

    /// The fit with its words resolved.
    fn point(&self) -> Point {
        // A nonlinear model does not commute with a filter.
        let (filter, trim) = match self.model.kind.made_of {
            MadeOf::Samples => ((0.0_f64.to_bits(), 0.0_f64.to_bits(), 1), 0),
            MadeOf::Moments | MadeOf::Rows => ((self.low_hz.to_bits(), self.high_hz.to_bits(), self.order), self.trim),
        };
        Point {
            kind: self.model.kind,
            model: self.model.keys.clone(),
            settings: self.settings(),
            target: self.target.clone(),
            entries: self.entries.clone(),
            matrix: Matrix { features: self.features.clone(), filter, trim },
        }
    }

    /// Contradictions among the parameters.
    fn contradictions(&self) -> Vec<Fault> {
        let (point, mut faults) = (self.point(), vec![]);
        let mut wrong = |what: String, param: &'static str| faults.push(Fault::new(what).of_param(param));
        if !self.model.kind.choose.contains(&self.choose) {
            let words = self.model.kind.choose.iter().map(|c| format!("`{}`", c.word())).collect::<Vec<_>>().join(", ");
            wrong(format!("`choose` of the model `{}` can be {words}", self.model.kind.name), "choose");
        }
        let targets = point.targets();
        if targets.iter().enumerate().any(|(i, t)| targets[..i].contains(t)) {
            wrong("duplicate target".to_owned(), "with_targets");
        }
        if point.settings.whiten.is_some() && self.intercept == Some(false) {
            wrong("`whiten` goes with an intercept".to_owned(), "whiten");
        }
        if point.settings.whiten.is_some_and(|w| w > 1.0 && w.fract() != 0.0) {
            wrong("`whiten` is a whole number of components, or a part of the variance below 1".to_owned(), "whiten");
        }
        faults.extend(point.model.faults(&point.settings));
        faults
    }

    /// Everything that is wrong with the columns.
    fn column_faults(&self, shape: &Shape) -> Vec<Fault> {
        let point = self.point();
        let more = point.model.with_targets();
        let mut faults = faults_of([shape.number(&self.target, "nT")], "target");
        faults.extend(faults_of(more.iter().map(|name| shape.number(name, "nT")), "with_targets"));
        for name in &self.features {
            let fine = shape.need(name).and_then(|c| match c.column_type {
                ColumnType::Float | ColumnType::List(_) => no_truth(c, "features", self.allow_truth),
                ColumnType::Text | ColumnType::Other(_) => {
                    Err(Fault::new(format!("column `{name}` does not hold numbers")))
                }
            });
            if let Err(fault) = fine {
                let maker = [("tl", "a_matrix"), ("features", "features")].iter().find(|(n, _)| n == name);
                faults.push(match maker.filter(|_| shape.get(name).is_none()) {
                    Some((_, stage)) => fault.help(format!("build it first, with `{stage}`")).of_param("input"),
                    None => fault.of_param("features"),
                });
            }
            if point.targets().contains(name) {
                faults.push(
                    Fault::new(format!("`{name}` is the target, so it cannot be a feature")).of_param("features"),
                );
            }
        }
        if self.features.is_empty() {
            faults.push(Fault::new("there is nothing to fit with").of_param("features"));
        }
        if faults.is_empty() {
            let terms: Vec<String> = self.features.iter().filter_map(|n| shape.get(n)).flat_map(terms_of).collect();
            faults.extend(point.places(&terms).err().map(|f| f.of_param("entries")));
        }
        faults
    }
}

impl Fit {
    /// A note that a fit which has errors of coefficients with fewer terms has none.
    fn too_wide_for_errors(&self, shape: &Shape) -> Option<String> {
        let terms = self.features.iter().filter_map(|name| shape.get(name)).flat_map(terms_of).count();
        let none = terms >= MOST_WITH_ERRORS && self.model.keys.wants_errors();
        none.then(|| {
            format!(
                "`std` is null: coefficients of {terms} terms have no errors, those of up to {} have",
                MOST_WITH_ERRORS - 1
            )
        })
    }
}

/// Error of the model that a training starts from, if any.
fn warm_start_faults(model: &Chosen<Model>, start: Option<&&Table>) -> Option<Fault> {
    let what = match start? {
        Table::Model { shape, .. } if shape.get("term").is_none() => "`warm_start` has no terms".to_owned(),
        Table::Model { .. } if model.keys.network().is_some() => return None,
        Table::Model { .. } => {
            format!("`warm_start` is for networks, and `{}` has no weights to begin with", model.kind.name)
        }
        Table::Lines(_) | Table::Scores(_) | Table::Map(_) => "`warm_start` is not a model table".to_owned(),
    };
    Some(Fault::new(what).of_param("warm_start").help("name the table of a fit of a network, and fit one"))
}

/// The terms that a column makes.
fn terms_of(column: &Column) -> Vec<String> {
    match &column.column_type {
        ColumnType::List(names) => names.clone(),
        _ => vec![column.name.clone()],
    }
}

impl Stage for Fit {
    fn effort(&self) -> f64 {
        self.model.keys.effort()
    }

    fn manner(&self) -> &'static str {
        if self.choose.leaves_out() { "leaving out" } else { "" }
    }

    fn memorises(&self) -> bool {
        self.model.kind.made_of == MadeOf::Samples
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        let own = || self.model.keys.idle(key);
        let model = self.model.kind;
        self.model
            .foreign(key)
            .or_else(|| model.unchosen(self.choose, key))
            .or_else(|| model.unfiltered(key))
            .or_else(own)
    }

    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = self.column_faults(shape);
        faults.extend(self.contradictions());
        faults.extend(warm_start_faults(&self.model, inputs.get(1)));
        faults.extend(band(self.low_hz, self.high_hz, shape.rate_hz));
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = vec!["tt".to_owned()];
        reads.extend(self.point().targets());
        reads.extend(self.features.iter().cloned());
        let earth = EARTH.into_iter().filter(|name| shape.get(name).is_some());
        let more: Vec<String> = earth.map(str::to_owned).filter(|name| !reads.contains(name)).collect();
        reads.extend(more);
        let warm: Vec<&str> = match inputs.get(1) {
            Some(start) if start.shape().get(RATE).is_some() => vec!["term", "value", RATE],
            Some(_) => vec!["term", "value"],
            None => vec![],
        };
        let made = |c: Column| c.from(0, &reads).from(1, &warm);
        let columns = vec![
            made(Column::text("model", "the model").role(Role::Key)),
            made(Column::text("term", "the term").role(Role::Key)),
            made(Column::float("value", "nT", "the coefficient")),
            made(Column::float("std", "nT", "one sigma of the coefficient, from the spectra of residual and terms")),
            made(Column::integer("n", "", "rows that were used")),
            made(Column::integer("left_out", "", "rows of the selected lines that were not")),
            made(Column::float("condition", "1", "condition number of the filtered matrix")),
            made(Column::float(
                "residual_std",
                "nT",
                "standard deviation of what the fit leaves of the filtered target",
            )),
            made(Column::float("chosen", "", "the ridge parameter or number of components that was used")),
            made(Column::float("trivial_share", "1", "part of the total field that the fit calls the aircraft's")),
            made(Column::float(
                "approximation_bound",
                "nT",
                "what the linear form of the model misses at most, in any attitude",
            )),
            made(Column::text("lines", "the lines whose rows were used, as flight/line, separated by `, `")),
            made(Column::text("warning", "what is wrong with the fit; empty where nothing is")),
            made(Column::float("residual_sigma", "nT", "white part of the noise that the model leaves, a sample")),
            made(Column::float("residual_fogm_sigma", "nT", "Gauss-Markov part of that noise")),
            made(Column::float("residual_fogm_tau", "s", "time constant of that part")),
            made(Column::float(RATE, "Hz", "rate at which terms are differences per sample: that of the first line")),
        ];
        let mut yields = Yield::append(columns, &reads);
        yields.passes = Passes::None;
        yields.features = self.features.clone();
        yields.notes.extend(self.too_wide_for_errors(shape));
        if !warm.is_empty() {
            yields.reads.push(warm.iter().map(ToString::to_string).collect());
        }
        Ok(yields)
    }
}

impl SurveyStage for Fit {
    type Gather = FitGather;

    fn gather(points: Vec<SurveyPoint<Self>>) -> FitGather {
        let starts = points.iter().map(|point| point.inputs.get(1).map(start).transpose()).collect();
        let points: Vec<Point> = points.into_iter().map(|point| point.stage.point()).collect();
        FitGather { questions: questions(&points), points, starts }
    }
}

/// The model that a training begins with.
struct Start {
    model: Learned,
    /// The rate at which its inputs are differences per sample, Hz; `None` of a table that does not say.
    rate_hz: Option<f64>,
}

/// The model of a table that a training begins with.
fn start(table: &RecordBatch) -> Result<Start, Fault> {
    let Fitted { body, rate_hz } = Fitted::read(table, &[]).map_err(|fault| fault.of_param("warm_start"))?;
    match body {
        Body::Learned(learned) => Ok(Start { model: *learned, rate_hz }),
        Body::Linear { .. } => {
            let fault = Fault::data("the model of `warm_start` is linear, and has no weights to begin with");
            Err(fault.of_param("warm_start").help("name the table of a fit of a network"))
        }
    }
}

/// The points of a sweep that are fitted to the same lines.
pub struct FitGather {
    points: Vec<Point>,
    questions: BTreeMap<Matrix, Question>,
    /// Start of the training of each point, where one is given.
    starts: Vec<Result<Option<Start>, Fault>>,
}

/// The questions to each line.
fn questions(points: &[Point]) -> BTreeMap<Matrix, Question> {
    let mut all: BTreeMap<Matrix, Question> = BTreeMap::new();
    for point in points {
        let question = all.entry(point.matrix.clone()).or_default();
        let targets = point.targets();
        if point.kind.made_of != MadeOf::Moments && !question.keeps_rows.contains(&targets) {
            question.keeps_rows.push(targets.clone());
        }
        if point.model.wants_errors() && point.settings.whiten.is_none() && !question.wants_errors.contains(&targets) {
            question.wants_errors.push(targets.clone());
        }
        if !question.targets.contains(&targets) {
            question.targets.push(targets);
        }
    }
    all
}

impl FitGather {
    /// The models of the points at `places`, which have one matrix, one target, the same entries and one kind of components.
    fn solved(&self, whole: &Result<Problem, Fault>, places: &[usize], work: &dyn Work) -> Vec<Result<Solved, Fault>> {
        let Some(first) = places.first().map(|i| &self.points[*i]) else { return vec![] };
        let cut = whole.as_ref().map_err(Clone::clone).and_then(|whole| whole.cut(first.places(&whole.terms)?));
        if first.kind.made_of == MadeOf::Samples {
            return self.learnt(&cut, places, work);
        }
        let mut problem = match cut.and_then(|p| p.whitened(first.settings.whiten)) {
            Ok(problem) => problem,
            Err(fault) => return places.iter().map(|_| Err(fault.clone())).collect(),
        };
        let ridge = |i: &usize| Some((self.points[*i].settings, self.points[*i].given_ridge()?));
        let ridges: Vec<(Settings, f64)> = places.iter().filter_map(ridge).collect();
        let mut done: Vec<Settings> = vec![];
        for (settings, _) in &ridges {
            if !done.iter().any(|d| d.same_scale(settings)) {
                done.push(*settings);
                let same = ridges.iter().filter(|(s, _)| s.same_scale(settings)).map(|(_, lambda)| *lambda);
                if let Err(fault) = problem.solve_ridges(settings, &same.collect::<Vec<_>>()) {
                    return places.iter().map(|_| Err(fault.clone())).collect();
                }
            }
        }
        places.iter().map(|i| solve(&mut problem, &self.points[*i])).collect()
    }
}

impl Gather for FitGather {
    type Part = Part;

    fn map(&self, line: &LineIn) -> Result<Part, Fault> {
        Part::new(line, &self.questions)
    }

    fn refused(&self, part: &Part) -> Vec<(usize, Fault)> {
        let why = |point: &Point| part.refused.get(&(point.matrix.clone(), point.targets())).cloned();
        self.points.iter().enumerate().filter_map(|(i, point)| Some((i, why(point)?))).collect()
    }

    fn finish(&self, parts: Vec<Part>, work: &dyn Work) -> Vec<Result<Product, Fault>> {
        let parts: Vec<&Part> = parts.iter().collect();
        type At = (Matrix, Targets);
        type Kind = (Option<Vec<String>>, Option<u64>, bool);
        let mut problems: BTreeMap<At, BTreeMap<Kind, Vec<usize>>> = BTreeMap::new();
        for (i, point) in self.points.iter().enumerate() {
            let of_matrix = problems.entry((point.matrix.clone(), point.targets())).or_default();
            let learns = point.kind.made_of == MadeOf::Samples;
            let kind = (point.entries.clone(), point.settings.whiten.map(f64::to_bits), learns);
            of_matrix.entry(kind).or_default().push(i);
        }
        let problems: Vec<(At, Vec<Vec<usize>>)> =
            problems.into_iter().map(|(at, cuts)| (at, cuts.into_values().collect())).collect();
        let solved: Vec<(usize, Result<Solved, Fault>)> = problems
            .into_par_iter()
            .flat_map(|(at, cuts)| {
                let whole = Problem::new(&parts, &at);
                let answers = |places: Vec<usize>| {
                    let answers = self.solved(&whole, &places, work);
                    places.into_iter().zip(answers).collect::<Vec<_>>()
                };
                cuts.into_par_iter().with_max_len(1).flat_map_iter(answers).collect::<Vec<_>>()
            })
            .collect();
        let mut tables: Vec<_> = self.points.iter().map(|_| Err(Fault::bug("a fit was lost"))).collect();
        for (i, answer) in solved {
            tables[i] = answer.map(|s| s.columns(&self.points[i], residual_noise(&parts, &self.points[i], &s)).into());
        }
        tables
    }
}

impl Solved {
    fn columns(&self, point: &Point, [white, lasting, tau]: [f64; 3]) -> Vec<ArrayRef> {
        let rows = self.table.len();
        let each = |of: &dyn Fn(&Row) -> f64| -> ArrayRef { array(self.table.iter().map(of).collect()) };
        let text = |x: &str| -> ArrayRef { Arc::new(StringArray::from(vec![x; rows])) };
        let count = |n: usize| -> ArrayRef { Arc::new(Int64Array::from(vec![n as i64; rows])) };
        let number = |x: f64| -> ArrayRef { array(vec![x; rows]) };
        let names = self.table.iter().map(|row| row.term.name.as_str());
        vec![
            text(point.kind.name),
            Arc::new(names.map(Some).collect::<StringArray>()),
            each(&|row| row.term.value),
            each(&|row| row.std),
            count(self.rows.0),
            count(self.rows.1),
            number(self.condition),
            number(self.residual_std),
            number(self.chosen),
            number(self.trivial_share),
            number(self.approximation_bound_nt),
            text(&self.lines),
            text(&self.warning),
            number(white),
            number(lasting),
            number(tau),
            number(self.rate_hz),
        ]
    }
}
