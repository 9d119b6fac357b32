//! Fits a compensation model to the lines that `where` selects.

mod aggregator;
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
#[cfg(test)]
mod m3_tests;
mod m3s;
mod m3sc;
mod m3tf;
mod m3tl;
mod m3v;
mod m3vc;
mod m3w;
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

use point::FitPoint;
use question::DesignMatrixKey;
use rows::MOST_WITH_ERRORS;
use schemas::{
    ChoiceRegistry, ChoiceSelection, Column, ColumnType, Fault, PassThroughColumns, Role, Rule, Stage, StageEntry,
    StageSchema, SurveyPoint, SurveyStage, Table, TableShape, stage,
};
use wide::EARTH;

pub use aggregator::FitAggregator;
pub use model::{FitModel, FitModelDecl, KeyDocsFn, LearningResult, LinearFitResult, ReadModelFn, model};
pub use models::MODELS;
pub use numerics::regression::least_squares::{LinearFit, ScaledFactor};
pub use problem::FitProblem;
pub use ridge::ridge;
pub use samples::{FitSamples, LineSamples, PointMonitor};
pub use settings::{Divisor, FitData, FitSettings, ModelSelection};

use crate::{
    columns::{band, faults_of, no_truth, shape},
    model_columns::RATE,
};

stage! {
    /// Fits a compensation model to all lines that `where` selects, as one data set.
    ///
    /// The same zero-phase filter band-passes terms and target (`low_hz = 0` and `high_hz = 0` switch it off). `trim`
    /// samples are removed at each end of every run of consecutive samples. The model is fitted to the remaining
    /// samples. Each model below has its own keys; a key of another model is rejected.
    ///
    /// `tolles_lawson` uses the feature `tl`, which `a_matrix` computes. The `features` stage computes all other
    /// features. The two-step model of van der Meer 2025 consists of two fits with a `compensate` stage between them.
    /// The target of the second fit is `mag_c`.
    ///
    /// `choose` selects `lambda` or the number of components. It uses generalised cross-validation, the corner of the
    /// L-curve, or cross-validation that omits one line or one flight at a time. If a whole line is omitted, the model
    /// was not fitted to neighbours of the predicted samples. If a whole flight is omitted, the model also cannot
    /// benefit from effects that last for a flight, such as a magnetisation or a temperature. The score of an omitted
    /// line is the variance (with divisor n) of the prediction error. The mean of the prediction error is ignored,
    /// because compensation does not determine constants. All lines have equal weight. The selected value is in the
    /// column `chosen`.
    ///
    /// All points of a sweep are solved together. Each line is reduced once to a triangular factor, which is used for
    /// all values of `lambda`, numbers of components and omitted lines. Normal equations are not used, because they
    /// square the condition number. Coefficients apply to the unscaled columns, even if `scaling` is set. The fitted
    /// constant is the term `intercept`.
    ///
    /// `std` is the standard deviation of a coefficient. It is computed from the spectra of the residual and of the
    /// terms, because the filter and coloured noise correlate the samples. It includes the effect of a residual that
    /// drifts over a run. The `std` of the intercept is an exception: it excludes this effect. `std` is null for models
    /// other than ridge models. It is also null for fits with 96 or more terms; a note reports this.
    ///
    /// `rate_hz` is the rate of the first line. On lines with other rates, terms that are differences per sample, such
    /// as `xx_dot`, are converted to this rate. All coefficients are therefore valid at this rate. Lagged values cannot
    /// be converted, so a line with another rate is rejected if a feature is a lagged value. Training that starts from
    /// `warm_start` keeps the rate of that table.
    ///
    /// A filter removes the mean of the target, so the constant part of the aircraft field is not determined.
    ///
    /// Rows with a NaN in a feature or the target, and rows that `where` omits, end a run. Each run is filtered
    /// separately. A run that is too short for filter and trim is omitted. `left_out` counts the omitted rows, `n` the
    /// used rows, and `lines` lists the lines of the used rows.
    ///
    /// `condition` is the condition number of the filtered matrix; if it is large, individual coefficients are poorly
    /// determined. With `lambda = 0`, the stage fails if the flight does not excite a term; the message names the term.
    /// `trivial_share` is the fraction of the total field that the fit attributes to the aircraft. A value of 1 means
    /// that a band-passed fit found the trivial solution: the whole total field is attributed to the aircraft.
    /// `warning` describes problems of the fit and is otherwise empty. Lines that failed in an earlier stage, or that
    /// lack a column, are omitted. Lines that are not evenly sampled, or whose rate is unsuitable for the filter, are
    /// omitted and listed in the table `failures`.
    ///
    /// `approximation_bound` is an upper bound on the error of the linear model, nT. The linear model approximates the
    /// change in the magnitude of the field by the projection of the aircraft field on the earth's field. Relative to
    /// the total field, the error is at most b^2/2, where b is the aircraft field divided by the earth's field. The
    /// bound is computed from the permanent and induced coefficients for the worst attitude. The bound is null if the
    /// terms do not determine it, or if the target is not a total field.
    ///
    /// `residual_sigma`, `residual_fogm_sigma` and `residual_fogm_tau` describe the noise of the unfiltered residual on
    /// the lines of the fit. They are the parameters of white noise and of first-order Gauss-Markov noise. Together,
    /// the two are the smallest noise whose Allan variance is nowhere below the Allan variance of the residual. If the
    /// target is a total field, `igrf` and `diurnal` are first subtracted from the residual if present. Without `igrf`,
    /// the core field is computed at the INS positions and the line's date. The crustal anomaly is unknown here and
    /// counts as noise. For a calibration at low height, the noise is therefore overestimated. A time constant longer
    /// than the lines cannot be resolved. The columns are null if the lines are shorter than 16 s.
    ///
    /// `warm_start` names the table of another fit of the same kind of network: a table of this pipeline, or a
    /// published table. Training starts from the weights in that table instead of random weights. The table may, for
    /// example, be from an aircraft with more flight data. Both fits must have the same inputs, layers, activation,
    /// linear terms and members. Inputs and target are scaled as in the earlier fit, because the weights depend on
    /// these scales. The constant is fitted to the new lines. Trained coefficients (`m2c`, `m3tl` to `m3tf`) start from
    /// the coefficients of the earlier fit. Coefficients that are not trained (`m2b`, `m2d`, `tlnn`, `etlnn`) are
    /// fitted to the new lines.
    ///
    /// Source: Gnadt 2022, (3.19) to (3.43), Figure 5-6 for `warm_start`; van der Meer 2025, sections 2.2 to 2.4, 4.1
    /// and 4.2.1.
    Fit = "fit", version 5, grain Survey, role FitsModel, inputs [input: Lines, warm_start: Model optional],
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
    /// Compensation model.
    model: ChoiceSelection<FitModelDecl>, unit "";
    /// Column to which the model is fitted, such as `mag_4_uc`, or `target`, which the `target` stage makes.
    target: String, unit "nT";
    /// Input columns of the model: lists such as `tl` and `features`, or single columns.
    features: Vec<String>, unit "", default ["tl"].map(String::from);
    /// Entries of the lists in `features` to use, in this order. A name selects one entry. A prefix such as
    /// `TL_A_flux_a` selects all entries whose names begin with `TL_A_flux_a_`. A row is used only if all entries of
    /// the lists are finite, including the unselected entries. The matrix of all entries is factored only once, so a
    /// sweep over `entries` is fast.
    entries: Option<Vec<String>>, unit "", absent "all entries";
    /// Method that selects `lambda` or `components`. The permitted values depend on the model.
    choose: ModelSelection, unit "", default ModelSelection::Given;
    /// With cross-validation: selects the simplest model whose error is within one standard error of the smallest.
    one_standard_error: bool, unit "", default false;
    /// Scaling of the columns before the penalty is applied. `standardise` divides by the standard deviation with
    /// divisor n - 1, as in MagNav.jl. scikit-learn uses this divisor in partial least squares and whitened components.
    /// Its `StandardScaler` uses the divisor n. Ridge regression in scikit-learn then requires the penalty `lambda` n /
    /// (n - 1) for the same solution.
    scaling: Option<Divisor>, unit "", absent "the default of the model";
    /// Fits the model to whitened principal components of the features, instead of the features themselves. A value of
    /// 1 or more is the number of components. A value below 1 is the fraction of the variance that the components
    /// explain. The table still holds coefficients of the features.
    whiten: Option<f64>, unit "", absent "no whitening", rule Rule::Positive;
    /// Also fits a constant, without a penalty.
    intercept: Option<bool>, unit "", absent "true with `whiten`, otherwise the default of the model";
    /// Lower corner frequency of the filter. With 0 the filter has no lower corner.
    low_hz: f64, unit "Hz", default 0.1, rule Rule::NotNegative;
    /// Upper corner frequency of the filter. With 0 the filter has no upper corner.
    high_hz: f64, unit "Hz", default 0.9, rule Rule::NotNegative;
    /// Order of the Butterworth prototype.
    order: usize, unit "", default 4usize, rule Rule::Between(1.0, 12.0);
    /// Number of samples removed at each end of a run after filtering.
    trim: usize, unit "samples", default 20usize;
    /// Allows truth columns as features.
    allow_truth: bool, unit "", default false;
}

/// Catalogue entry of the stage, with `models` as the permitted values of `model`.
pub fn entry(models: Vec<&'static FitModelDecl>) -> StageEntry {
    let kinds = models.iter().map(|model| model.document()).collect();
    StageEntry { kinds, ..Fit::entry_with(ChoiceRegistry::default().with(models)) }
}

impl Fit {
    /// Settings of the fit, including the defaults of the model.
    fn settings(&self) -> FitSettings {
        let (model, whiten) = (self.model.kind, self.whiten.filter(|_| self.model.takes("whiten")));
        FitSettings {
            scaling: self.scaling.unwrap_or(model.scaling).scaling(),
            // Components are computed from centred columns, so they require a constant.
            intercept: self.intercept.unwrap_or(model.intercept || whiten.is_some()),
            choose: self.choose,
            one_standard_error: self.one_standard_error,
            whiten,
        }
    }

    /// The fit, with names replaced by the declarations that they refer to.
    fn point(&self) -> FitPoint {
        // A nonlinear model does not commute with a filter.
        let (filter, trim) = match self.model.kind.made_of {
            FitData::Samples => ((0.0_f64.to_bits(), 0.0_f64.to_bits(), 1), 0),
            FitData::Moments | FitData::Rows => {
                ((self.low_hz.to_bits(), self.high_hz.to_bits(), self.order), self.trim)
            }
        };
        FitPoint {
            kind: self.model.kind,
            model: self.model.keys.clone(),
            settings: self.settings(),
            target: self.target.clone(),
            entries: self.entries.clone(),
            matrix: DesignMatrixKey { features: self.features.clone(), filter, trim },
        }
    }

    /// Faults of incompatible parameters.
    fn contradictions(&self) -> Vec<Fault> {
        let (point, mut faults) = (self.point(), vec![]);
        let mut wrong = |what: String, param: &'static str| faults.push(Fault::new(what).of_param(param));
        if !self.model.kind.choose.contains(&self.choose) {
            let words = self.model.kind.choose.iter().map(|c| format!("`{}`", c.word())).collect::<Vec<_>>().join(", ");
            wrong(format!("`choose` of the model `{}` must be {words}", self.model.kind.name), "choose");
        }
        let targets = point.targets();
        if targets.iter().enumerate().any(|(i, t)| targets[..i].contains(t)) {
            wrong("duplicate target".to_owned(), "with_targets");
        }
        if point.settings.whiten.is_some() && self.intercept == Some(false) {
            wrong("`whiten` requires `intercept = true`".to_owned(), "whiten");
        }
        if point.settings.whiten.is_some_and(|w| w > 1.0 && w.fract() != 0.0) {
            wrong(
                "`whiten` must be a whole number of components, or a fraction of the variance below 1".to_owned(),
                "whiten",
            );
        }
        faults.extend(point.model.faults(&point.settings));
        faults
    }

    /// Faults of the columns.
    fn column_faults(&self, shape: &TableShape) -> Vec<Fault> {
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
                    Some((_, stage)) => fault.help(format!("add a `{stage}` stage before this one")).of_param("input"),
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
            faults.push(Fault::new("`features` is empty; name at least one column").of_param("features"));
        }
        if faults.is_empty() {
            let terms: Vec<String> = self.features.iter().filter_map(|n| shape.get(n)).flat_map(terms_of).collect();
            faults.extend(point.places(&terms).err().map(|f| f.of_param("entries")));
        }
        faults
    }
}

impl Fit {
    /// Note that the standard deviations of the coefficients are not computed, if the fit has too many terms.
    fn too_wide_for_errors(&self, shape: &TableShape) -> Option<String> {
        let terms = self.features.iter().filter_map(|name| shape.get(name)).flat_map(terms_of).count();
        let none = terms >= MOST_WITH_ERRORS && self.model.keys.wants_errors();
        none.then(|| {
            format!(
                "`std` is null: the fit has {terms} terms, and `std` is computed for up to {}",
                MOST_WITH_ERRORS - 1
            )
        })
    }
}

/// Fault if `warm_start` or `model` is not a network.
fn warm_start_faults(model: &ChoiceSelection<FitModelDecl>, start: Option<&&Table>) -> Option<Fault> {
    let what = match start? {
        Table::Model { shape, .. } if shape.get("term").is_none() => "`warm_start` has no column `term`".to_owned(),
        Table::Model { .. } if model.keys.network().is_some() => return None,
        Table::Model { .. } => {
            format!("`warm_start` requires a network, and `{}` has no weights", model.kind.name)
        }
        Table::Lines(_) | Table::Scores(_) | Table::Map(_) => "`warm_start` is not a model table".to_owned(),
    };
    Some(
        Fault::new(what)
            .of_param("warm_start")
            .help("give the table of a `fit` stage with a network, and set `model` to a network"),
    )
}

/// Terms that a column provides.
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
        self.model.kind.made_of == FitData::Samples
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let own = || self.model.keys.unused_key(key);
        let model = self.model.kind;
        self.model
            .foreign(key)
            .or_else(|| model.unchosen(self.choose, key))
            .or_else(|| model.unfiltered(key))
            .or_else(own)
    }

    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
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
            made(Column::text("model", "name of the model").role(Role::Key)),
            made(Column::text("term", "name of the term").role(Role::Key)),
            made(Column::float("value", "nT", "coefficient of the term")),
            made(Column::float(
                "std",
                "nT",
                "standard deviation of the coefficient, from the spectra of residual and terms",
            )),
            made(Column::integer("n", "", "number of rows used")),
            made(Column::integer("left_out", "", "number of rows of the selected lines that were not used")),
            made(Column::float("condition", "1", "condition number of the filtered matrix")),
            made(Column::float("residual_std", "nT", "standard deviation of the residual of the filtered target")),
            made(Column::float("chosen", "", "ridge parameter or number of components used")),
            made(Column::float(
                "trivial_share",
                "1",
                "fraction of the total field that the fit attributes to the aircraft",
            )),
            made(Column::float(
                "approximation_bound",
                "nT",
                "upper bound on the error of the linear form of the model, in any attitude",
            )),
            made(Column::text("lines", "lines whose rows were used, as flight/line, separated by `, `")),
            made(Column::text("warning", "problems of the fit; empty if there are none")),
            made(Column::float("residual_sigma", "nT", "standard deviation of the white residual noise of one sample")),
            made(Column::float("residual_fogm_sigma", "nT", "standard deviation of the Gauss-Markov residual noise")),
            made(Column::float("residual_fogm_tau", "s", "time constant of the Gauss-Markov residual noise")),
            made(Column::float(RATE, "Hz", "sample rate of the first line, to which terms per sample refer")),
        ];
        let mut yields = StageSchema::append(columns, &reads);
        yields.passes = PassThroughColumns::None;
        yields.features = self.features.clone();
        yields.notes.extend(self.too_wide_for_errors(shape));
        if !warm.is_empty() {
            yields.reads.push(warm.iter().map(ToString::to_string).collect());
        }
        Ok(yields)
    }
}

impl SurveyStage for Fit {
    type Gather = FitAggregator;

    fn gather(points: Vec<SurveyPoint<Self>>) -> FitAggregator {
        FitAggregator::new(points)
    }
}
