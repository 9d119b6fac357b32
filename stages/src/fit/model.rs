//! Declarations of fit models.
//!
//! A model is one file with its declaration by [`model!`](crate::model!), its fit and its tests, and one line in
//! [`MODELS`](super::MODELS). The struct of a model holds only the keys of the model, so it cannot depend on a key of
//! another model.

use std::fmt;

use numerics::regression::least_squares::{LinearFit, ScaledFactor};
use schemas::{ChoiceDoc, ChoiceKeys, ChoiceKind, Fault, ParamDoc, ParamReader, collect_doc};

use super::{
    network::NetworkModel,
    problem::FitProblem,
    samples::{FitSamples, PointMonitor},
    settings::{Divisor, FitData, FitSettings, ModelSelection},
};
use crate::trained::{LearnedModel, TermValue};

/// Documentation of the keys of a model or filter.
pub type KeyDocsFn = dyn Fn() -> Vec<ParamDoc> + Send + Sync;
/// Reader of the keys of a model.
pub type ReadModelFn = dyn Fn(&mut ParamReader) -> Option<ChoiceKeys<dyn FitModel>> + Send + Sync;

/// Declaration of a model.
pub struct FitModelDecl {
    /// Value of `model`.
    pub name: &'static str,
    /// Version, raised whenever the results of the model change.
    pub version: u32,
    /// Hash of the source text of a model that is loaded at run time. `None` for a compiled model.
    pub source: Option<&'static str>,
    /// Lines of the model's documentation: the quantity minimised, when to use the model, source.
    pub doc: &'static [&'static str],
    /// Default of `scaling`.
    pub scaling: Divisor,
    /// Default of `intercept`.
    pub intercept: bool,
    /// Data to which the model is fitted.
    pub made_of: FitData,
    /// Permitted values of `choose`.
    pub choose: &'static [ModelSelection],
    /// Settings of the stage that this model accepts, although some models reject them.
    pub takes: &'static [&'static str],
    /// Keys that the stage's example with this model contains, one per line.
    pub example: &'static str,
    /// Documentation of the model's own keys.
    pub docs: &'static KeyDocsFn,
    /// Reads the model's own keys.
    pub read: &'static ReadModelFn,
}

impl fmt::Debug for FitModelDecl {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("FitModelDecl").field("name", &self.name).field("version", &self.version).finish_non_exhaustive()
    }
}

impl ChoiceKind for FitModelDecl {
    type Keys = dyn FitModel;
    const DEFAULT: Option<&'static str> = None;

    fn name(&self) -> &'static str {
        self.name
    }

    fn version(&self) -> u32 {
        self.version
    }

    fn source(&self) -> Option<&str> {
        self.source
    }

    fn docs(&self) -> Vec<ParamDoc> {
        (self.docs)()
    }

    fn takes(&self) -> &'static [&'static str] {
        self.takes
    }

    fn read(&self, reader: &mut ParamReader) -> Option<ChoiceKeys<dyn FitModel>> {
        (self.read)(reader)
    }
}

/// Result of a linear fit.
pub struct LinearFitResult {
    /// Coefficients in the units of the columns.
    pub fit: LinearFit,
    /// Standard deviation of each coefficient. NaN if the model provides none.
    pub std: Vec<f64>,
    /// Standard deviation of the residual of the filtered target.
    pub residual_std: f64,
    /// Ridge parameter or number of components used.
    pub chosen: f64,
}

impl LinearFitResult {
    /// Result of a model that does not compute the errors of its coefficients.
    pub fn without_errors(fit: LinearFit, residual_std: f64, chosen: f64) -> LinearFitResult {
        LinearFitResult { std: vec![f64::NAN; fit.coefficients.len()], fit, residual_std, chosen }
    }
}

/// Result of a model that learns from samples.
pub struct LearningResult {
    /// Learned model.
    pub model: LearnedModel,
    /// Epoch or number of trees used.
    pub chosen: f64,
    /// Course of the training: further rows of the table, such as `epoch_training[3]`.
    pub curve: Vec<TermValue>,
    /// Warning; empty if there is no warning.
    pub warning: String,
}

/// A model with its keys.
pub trait FitModel: Send + Sync {
    /// Fits the model to all lines of `problem`. `prepared` holds the columns with the scaling of `settings`.
    ///
    /// # Errors
    /// Fails if the data do not determine the model.
    fn fit(
        &self,
        _problem: &FitProblem,
        _settings: &FitSettings,
        _prepared: &ScaledFactor,
    ) -> Result<LinearFitResult, Fault> {
        Err(Fault::bug("the model is declared as linear, but has no `fit`"))
    }

    /// Fits a model of `FitSamples` that is not a network. Replaces [`FitModel::fit`].
    ///
    /// # Errors
    /// Fails if the data do not determine the model, or the run is interrupted.
    fn learn(
        &self,
        _samples: &FitSamples,
        _settings: &FitSettings,
        _work: &PointMonitor,
    ) -> Result<LearningResult, Fault> {
        Err(Fault::bug("the model is declared as fitted to samples, but has no `learn`"))
    }

    /// The network, if the model is one; otherwise `None`. For a network, training replaces the call of
    /// [`FitModel::learn`].
    fn network(&self) -> Option<NetworkModel<'_>> {
        None
    }

    /// Faults of incompatible keys and settings.
    fn faults(&self, _: &FitSettings) -> Vec<Fault> {
        self.network().map(|network| network.faults()).unwrap_or_default()
    }

    /// Reason why a key of the model has no effect. `None` if the key has an effect.
    fn unused_key(&self, key: &str) -> Option<Fault> {
        self.network()?.unused_key(key)
    }

    /// Cost of a sample in relative units; see `Stage::effort` of the crate `schemas`.
    fn effort(&self) -> f64 {
        self.network().map_or(1.0, |network| network.effort())
    }

    /// Columns that are fitted together with the target.
    fn with_targets(&self) -> &[String] {
        &[]
    }

    /// Ridge parameter, if the model has one.
    fn lambda(&self) -> Option<f64> {
        None
    }

    /// Returns whether the errors of the model's coefficients are computed. Otherwise [`ridge`](super::ridge()) returns
    /// NaN for the errors.
    fn wants_errors(&self) -> bool {
        self.is_ridge()
    }

    /// Warning about the result of a fit to `terms` columns. `None` if there is no warning.
    fn remark(&self, _answer: &LinearFitResult, _terms: usize) -> Option<String> {
        None
    }

    /// Returns whether the solution of the model lies on the ridge path that the points of a sweep share.
    fn is_ridge(&self) -> bool {
        false
    }
}

impl FitModelDecl {
    /// Reason why a key has no effect with this `choose`.
    pub(super) fn unchosen(&self, choose: ModelSelection, key: &str) -> Option<Fault> {
        // A key that the model does not have is a separate fault.
        if !self.choose.contains(&choose) {
            return None;
        }
        let given = choose == ModelSelection::Given;
        let lambda = (key == "lambda" && !given)
            .then(|| format!("`lambda` and `choose = \"{}\"` cannot be combined; remove one of them", choose.word()));
        let lambdas = (key == "lambdas" && given)
            .then(|| "`lambdas` has no effect without a selection method; set `choose`".to_owned());
        let error = (key == "one_standard_error" && !choose.leaves_out()).then(|| {
            "`one_standard_error` requires cross-validation; set `choose = \"leave_one_line_out\"`".to_owned()
        });
        lambda.or(lambdas).or(error).map(Fault::new)
    }

    /// Reason why a key has no effect for a model that is fitted to unfiltered samples.
    pub(super) fn unfiltered(&self, key: &str) -> Option<Fault> {
        const LINEAR: [&str; 6] = ["low_hz", "high_hz", "order", "trim", "scaling", "intercept"];
        (self.made_of == FitData::Samples && LINEAR.contains(&key)).then(|| {
            let what =
                format!("`{key}` applies to linear models only; `{}` is fitted to unfiltered samples", self.name);
            Fault::new(what).help("remove the key; to filter the samples, add a filter stage before the fit")
        })
    }

    /// Documentation for the reference.
    pub(super) fn document(&self) -> ChoiceDoc {
        let choose: Vec<String> = self.choose.iter().map(|c| format!("`{}`", c.word())).collect();
        let takes: Vec<String> = self.takes.iter().map(|key| format!("`{key}`")).collect();
        let mut facts = vec![
            format!("`scaling` unset: `{}`", self.scaling.word()),
            format!("`intercept` unset: `{}`", self.intercept),
            format!("`choose`: {}", choose.join(", ")),
        ];
        if self.made_of == FitData::Samples {
            facts = vec!["nonlinear model, fitted to unfiltered samples".to_owned()];
        }
        if !takes.is_empty() {
            facts.push(format!("also accepts {}", takes.join(", ")));
        }
        let (doc, params) = (collect_doc(self.doc), (self.docs)());
        ChoiceDoc { key: "model", name: self.name, doc, facts, params, example: self.example }
    }
}

/// Declares a model: its documentation, name and version, defaults of settings, permitted values of `choose`, settings
/// that it accepts, keys of an example, and its own keys as in [`params!`](schemas::params!).
///
/// ```
/// use schemas::{Fault, Rule};
/// use stages::fit::{LinearFitResult, FitModel, ScaledFactor, FitProblem, FitSettings, model};
/// model! {
/// /// Least squares with reduced coefficients.
///     Shrunk = "shrunk", version 1, scaling None, intercept false, made of Moments, choose [Given], takes [],
///     example "factor = 0.9";
/// /// Factor applied to the coefficients.
///     factor: f64, unit "1", default 0.5, rule Rule::Between(0.0, 1.0);
/// }
/// impl FitModel for Shrunk {
///     fn fit(
///         &self,
///         problem: &FitProblem,
///         settings: &FitSettings,
///         prepared: &ScaledFactor,
///     ) -> Result<LinearFitResult, Fault> {
///         let mut answer = stages::fit::ridge(problem, settings, prepared, 0.0)?;
///         answer.fit.coefficients.iter_mut().for_each(|b| *b *= self.factor);
///         Ok(answer)
///     }
/// }
/// assert_eq!(Shrunk::MODEL.name, "shrunk");
/// ```
#[macro_export]
macro_rules! model {
    (
        $(#[doc = $d:literal])*
        $Ty:ident = $name:literal, version $v:literal, scaling $scaling:ident, intercept $intercept:literal,
        made of $of:ident,
        choose [$($choose:ident),+ $(,)?], takes [$($setting:ident),* $(,)?],
        $(groups [$($g:ident : $gt:ty),* $(,)?],)? example $example:literal;
        $($keys:tt)*
    ) => {
        schemas::params! {
            $(#[doc = $d])*
            pub struct $Ty $(, groups [$($g: $gt),*])?;
            $($keys)*
        }

        impl $Ty {
            /// The declaration.
            pub const MODEL: $crate::fit::FitModelDecl = {
                fn docs() -> Vec<schemas::ParamDoc> {
                    // A name in `takes` that is not a key of the stage does not compile.
                    let _ = |fit: &$crate::fit::Fit| { let _ = fit; $( let _ = &fit.$setting; )* };
                    <$Ty as schemas::Params>::docs(&schemas::ChoiceRegistry::default())
                }
                $crate::fit::FitModelDecl {
                    name: $name,
                    version: $v,
                    source: None,
                    doc: &[$($d),*],
                    scaling: $crate::fit::Divisor::$scaling,
                    intercept: $intercept,
                    made_of: $crate::fit::FitData::$of,
                    choose: &[$($crate::fit::ModelSelection::$choose),+],
                    takes: &[$(stringify!($setting)),*],
                    example: $example,
                    docs: &docs,
                    read: &|reader| schemas::ChoiceKeys::read::<$Ty>(reader, |model| std::sync::Arc::new(model)),
                }
            };
        }
    };
}
pub use model;

#[cfg(test)]
mod tests {
    use schemas::Literal;

    use super::*;
    use crate::fit::MODELS;
    use crate::fit::testing::{fitted, number, stage, word};

    fn keys(model: &str, given: &[(String, Literal)]) -> Vec<&'static str> {
        stage(model, given).unwrap().canonical().into_iter().map(|(key, _)| key).collect()
    }

    #[test]
    fn unit_every_model_is_read_by_name() {
        let entry = crate::fit::entry(MODELS.to_vec());
        let params: Vec<&str> = entry.params.iter().map(|p| p.name).collect();
        for model in MODELS {
            assert!(stage(model.name, &[]).is_ok(), "{}", model.name);
            assert!((model.docs)().iter().all(|doc| params.contains(&doc.name)), "{}", model.name);
            assert!(model.takes.iter().all(|k| params.contains(k)), "{}", model.name);
            assert!(model.choose.contains(&ModelSelection::Given), "{}", model.name);
        }
    }

    #[test]
    fn unit_the_key_holds_only_parameters_that_the_model_uses() {
        let pls = keys("pls", &[]);
        assert!(["model", "target", "components", "scaling", "low_hz"].iter().all(|k| pls.contains(k)), "{pls:?}");
        assert!(!["lambda", "l1_ratio", "loss", "forgetting", "lambdas"].iter().any(|k| pls.contains(k)), "{pls:?}");
        let robust = keys("robust", &[word("loss", "student_t")]);
        assert!(robust.contains(&"degrees_of_freedom") && !robust.contains(&"threshold"), "{robust:?}");
        let chosen = keys("ridge", &[word("choose", "gcv")]);
        assert!(chosen.contains(&"lambdas") && !chosen.contains(&"lambda"), "{chosen:?}");
        let left_out = keys("ridge", &[word("choose", "leave_one_line_out")]);
        assert!(left_out.contains(&"one_standard_error"), "{left_out:?}");
    }

    #[test]
    fn gold_a_key_of_another_model_is_rejected_with_its_owners() {
        let why =
            |model: &str, key: &str| stage(model, &[]).unwrap().unused_key(key).map(|f| f.what).unwrap_or_default();
        assert_eq!(why("tolles_lawson", "l1_ratio"), "`l1_ratio` belongs to `elastic_net`");
        assert_eq!(why("ridge", "components"), "`components` belongs to `pls` and `truncated_svd`");
        assert_eq!(why("robust", "degrees_of_freedom"), "`degrees_of_freedom` belongs to the loss `student_t`");
        assert_eq!(why("elastic_net", "l1_ratio"), "");
    }

    #[test]
    fn unit_a_key_of_another_model_changes_nothing() {
        let others =
            [number("lambda", 0.0), number("l1_ratio", 0.1), number("forgetting", 0.95), number("whiten", 2.0)];
        let [plain, more] = [&others[..0], &others[..3]].map(|keys| fitted("pls", keys).value);
        assert_eq!(plain, more);
        let [plain, more] = [&others[..0], &others[1..]].map(|keys| fitted("robust", keys).value);
        assert_eq!(plain, more);
    }
}
