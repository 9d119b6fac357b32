//! What a fit model declares of itself, and the list of all models.
//!
//! A model is one file: its declaration by [`model!`], its fit, its tests; and one line in [`MODELS`]. The struct of a
//! model holds the keys that it declares and nothing else, so that it cannot depend on a key of another model.

use std::{fmt::Write, sync::Arc};

use numerics::regression::least_squares::{LineScores, LinearFit, Prepared, Scaling};
use schemas::{Entry, Fault, Literal, Rule, Value, choice};

use super::{
    Fit, elastic_net::ElasticNet, extended_tolles_lawson::ExtendedTollesLawson, pls::PartialLeastSquares,
    problem::Problem, recursive_least_squares::RecursiveLeastSquares, ridge::Ridge, robust::Robust,
    tolles_lawson::TollesLawson, truncated_svd::TruncatedSvd,
};

/// Every model, in the order of the reference.
pub const MODELS: &[&Model] = &[
    &TollesLawson::MODEL,
    &ExtendedTollesLawson::MODEL,
    &Ridge::MODEL,
    &ElasticNet::MODEL,
    &PartialLeastSquares::MODEL,
    &TruncatedSvd::MODEL,
    &Robust::MODEL,
    &RecursiveLeastSquares::MODEL,
];

const NAMES: [&str; MODELS.len()] = {
    let mut names = [""; MODELS.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = MODELS[i].name;
        i += 1;
    }
    names
};

choice! {
    /// How `lambda` or the number of components is found.
    pub enum Choose {
        /// It is given.
        Given = "given",
        /// By generalised cross-validation.
        Gcv = "gcv",
        /// At the corner of the L-curve.
        LCurve = "l_curve",
        /// By leaving each line out in turn.
        LeaveOneLineOut = "leave_one_line_out",
        /// By leaving each flight out in turn, with all its lines.
        LeaveOneFlightOut = "leave_one_flight_out",
    }
}

impl Choose {
    /// Whether lines or flights are left out.
    pub fn leaves_out(self) -> bool {
        matches!(self, Choose::LeaveOneLineOut | Choose::LeaveOneFlightOut)
    }
}

choice! {
    /// What columns are divided by before they are penalised, as the spec says it.
    pub enum Divisor {
        /// Nothing.
        None = "none",
        /// Their standard deviation over n - 1.
        Standardise = "standardise",
        /// Their largest absolute value.
        MaxAbs = "max_abs",
        /// Their largest less their smallest value.
        MinMax = "min_max",
    }
}

impl Divisor {
    /// As the numerics call it.
    pub const fn scaling(self) -> Scaling {
        match self {
            Divisor::None => Scaling::None,
            Divisor::Standardise => Scaling::Standardise,
            Divisor::MaxAbs => Scaling::MaxAbs,
            Divisor::MinMax => Scaling::MinMax,
        }
    }
}

/// What a model is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MadeOf {
    /// The moments of the lines, whose factors a whole sweep shares.
    Moments,
    /// The rows themselves.
    Rows,
}

/// A model as it declares itself.
#[derive(Debug)]
pub struct Model {
    /// The word after `model =`.
    pub name: &'static str,
    /// What it minimises, when you want it, source.
    pub doc: fn() -> String,
    /// What columns are divided by where `scaling` is left out.
    pub scaling: Divisor,
    /// Whether a constant is fitted where `intercept` is left out.
    pub intercept: bool,
    /// What it is made of.
    pub made_of: MadeOf,
    /// What `choose` may be.
    pub choose: &'static [Choose],
    /// The keys that it takes, beside those that every model takes.
    pub keys: &'static [&'static str],
    /// The model with its keys.
    pub make: fn(&Fit) -> Arc<dyn FitModel>,
}

/// What most models have in common, with the defaults of the model put in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// What columns are divided by before they are penalised.
    pub scaling: Scaling,
    /// Whether a constant is fitted too.
    pub intercept: bool,
    /// How `lambda` or the number of components is found.
    pub choose: Choose,
    /// Whether the simplest model within one standard error of the best is taken.
    pub one_standard_error: bool,
    /// How many whitened components take the place of the features, or what part of the variance they hold.
    pub whiten: Option<f64>,
}

/// What a model finds.
pub struct Answer {
    /// Coefficients in the units of the columns.
    pub fit: LinearFit,
    /// One sigma of each coefficient; NaN where the model knows none.
    pub std: Vec<f64>,
    /// Standard deviation of what is left of the filtered target.
    pub residual_std: f64,
    /// The ridge parameter or number of components that was used.
    pub chosen: f64,
}

impl Answer {
    /// Of a model that does not know the errors of its coefficients.
    pub fn without_errors(fit: LinearFit, residual_std: f64, chosen: f64) -> Answer {
        Answer { std: vec![f64::NAN; fit.coefficients.len()], fit, residual_std, chosen }
    }
}

impl Settings {
    /// Whether columns stand on the same scale in both.
    pub fn same_scale(&self, other: &Settings) -> bool {
        (self.scaling, self.intercept) == (other.scaling, other.intercept)
    }

    /// The place of the solution to take.
    pub fn pick(&self, scores: &LineScores) -> usize {
        if self.one_standard_error { scores.within_one_error } else { scores.best }
    }
}

/// A model with the keys that it was given.
pub trait FitModel: Send + Sync {
    /// Fits it to all lines of `problem`, whose columns on the scale of `settings` are `prepared`.
    ///
    /// # Errors
    /// When the data do not determine it.
    fn fit(&self, problem: &Problem, settings: &Settings, prepared: &Prepared) -> Result<Answer, Fault>;

    /// What is wrong with its keys and the settings among themselves.
    fn faults(&self, _: &Settings) -> Vec<Fault> {
        vec![]
    }

    /// Why one of its own keys has no say beside the others; `None` where it has.
    fn idle(&self, _key: &str) -> Option<Fault> {
        None
    }

    /// Columns that are explained together with the target.
    fn with_targets(&self) -> &[String] {
        &[]
    }

    /// The strength of its penalty, where it has one.
    fn lambda(&self) -> Option<f64> {
        None
    }

    /// Whether it is one point on the path of ridges that the points of a sweep share.
    fn is_ridge(&self) -> bool {
        false
    }
}

impl Model {
    /// Whether `key` is not another model's alone.
    pub fn takes(&self, key: &str) -> bool {
        self.keys.contains(&key) || owners(key).next().is_none()
    }

    /// Why `key` has no say in `fit`, a fit of this model; `None` where it has.
    pub fn idle(&self, fit: &Fit, key: &str) -> Option<Fault> {
        if !self.takes(key) {
            return Some(self.foreign(key));
        }
        let own = || self.keys.contains(&key).then(|| (self.make)(fit).idle(key)).flatten();
        self.unchosen(fit.choose, key).or_else(own)
    }

    /// The fault of giving a key of other models.
    fn foreign(&self, key: &str) -> Fault {
        let names: Vec<String> = owners(key).map(|m| format!("`{}`", m.name)).collect();
        let names = match names.split_last() {
            Some((last, rest)) if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
            _ => names.concat(),
        };
        Fault::new(format!("`{key}` belongs to {names}"))
            .help(format!("`{}` does not take it: leave it out", self.name))
    }

    /// Why a key has no say with this `choose`.
    fn unchosen(&self, choose: Choose, key: &str) -> Option<Fault> {
        // What the model does not know is a fault of its own.
        if !self.choose.contains(&choose) {
            return None;
        }
        let what = match (key, choose) {
            ("lambda", Choose::Given) => return None,
            ("lambda", _) => format!("`lambda` is found by `choose = \"{}\"`: give one of them", choose.word()),
            ("lambdas", Choose::Given) => {
                "`lambdas` are for choosing a `lambda` among them: say how in `choose`".to_owned()
            }
            ("one_standard_error", _) if !choose.leaves_out() => {
                "`one_standard_error` is for leaving lines or flights out: say so in `choose`".to_owned()
            }
            _ => return None,
        };
        Some(Fault::new(what))
    }

    /// The settings of a fit with this model.
    pub fn settings(&self, fit: &Fit) -> Settings {
        let whiten = fit.whiten.filter(|_| self.takes("whiten"));
        Settings {
            scaling: fit.scaling.unwrap_or(self.scaling).scaling(),
            // Components are made of columns without their means, so a constant belongs to them.
            intercept: fit.intercept.unwrap_or(self.intercept || whiten.is_some()),
            choose: fit.choose,
            one_standard_error: fit.one_standard_error,
            whiten,
        }
    }

    /// Its part of the reference; `all` is the stage's entry, which knows the defaults of keys.
    fn section(&self, all: &Entry) -> String {
        let params = (all.params)();
        let default = |key: &&str| params.iter().find(|p| p.name == *key).and_then(|p| p.default.clone());
        let key = |key: &&str| match default(key).filter(|d| d != "none") {
            Some(default) => format!("`{key}` ({default})"),
            None => format!("`{key}`"),
        };
        let keys: Vec<String> = self.keys.iter().map(key).collect();
        let choose: Vec<String> = self.choose.iter().map(|c| format!("`{}`", c.word())).collect();
        format!(
            "### The model `{}`\n\n{}\n\n- its keys: {}\n- `scaling` left out: `{}`\n- `intercept` left out: `{}`\n\
             - `choose`: {}\n",
            self.name,
            (self.doc)(),
            keys.join(", "),
            self.scaling.word(),
            self.intercept,
            choose.join(", ")
        )
    }
}

/// The models that declare `key` as theirs.
fn owners(key: &str) -> impl Iterator<Item = &'static Model> + '_ {
    MODELS.iter().copied().filter(move |m| m.keys.contains(&key))
}

/// The models, for the reference.
pub fn reference() -> String {
    let mut out = String::new();
    for model in MODELS {
        // Writing into a String cannot fail.
        let _ = writeln!(out, "{}", model.section(&Fit::entry()));
    }
    out.trim_end().to_owned() + "\n"
}

impl Value for &'static Model {
    const TYPE: &'static str = "text";
    const WORDS: &'static [&'static str] = &NAMES;

    fn read(literal: &Literal) -> Option<&'static Model> {
        let name = literal.as_text()?;
        MODELS.iter().copied().find(|m| m.name == name)
    }

    fn check(&self, _: &Rule) -> Result<(), Fault> {
        Ok(())
    }

    fn canonical(&self) -> String {
        format!("{:?}", self.name)
    }
}

/// Declares a model: its documentation and name, the defaults of settings, what `choose` may be, which settings it takes
/// that some models do not, and its own keys with their types. The keys themselves, with unit, default and rule, are
/// declared by the stage, as several models share most of them.
macro_rules! model {
    (
        $(#[doc = $d:literal])*
        $Ty:ident = $name:literal, scaling $scaling:ident, intercept $intercept:literal, made of $of:ident,
        choose [$($choose:ident),+ $(,)?], takes [$($setting:ident),* $(,)?];
        $( $key:ident : $kt:ty ),* $(,)?
    ) => {
        $(#[doc = $d])*
        #[derive(Clone, Debug)]
        pub struct $Ty { $( $key: $kt, )* }

        impl $Ty {
            /// The declaration.
            pub const MODEL: $crate::fit::model::Model = {
                fn doc() -> String {
                    schemas::collect_doc(&[$($d),*])
                }
                fn make(fit: &$crate::fit::Fit) -> std::sync::Arc<dyn $crate::fit::model::FitModel> {
                    // A name in `takes` that is no key of the stage does not compile.
                    $( let _ = &fit.$setting; )*
                    std::sync::Arc::new($Ty { $( $key: fit.$key.clone(), )* })
                }
                $crate::fit::model::Model {
                    name: $name,
                    doc,
                    scaling: $crate::fit::model::Divisor::$scaling,
                    intercept: $intercept,
                    made_of: $crate::fit::model::MadeOf::$of,
                    choose: &[$($crate::fit::model::Choose::$choose),+],
                    keys: &[$(stringify!($key),)* $(stringify!($setting)),*],
                    make,
                }
            };
        }
    };
}
pub(super) use model;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::testing::{fitted, number, stage, word};

    fn keys(model: &str, given: &[(String, Literal)]) -> Vec<&'static str> {
        stage(model, given).unwrap().canonical().into_iter().map(|(key, _)| key).collect()
    }

    #[test]
    fn law_every_model_is_read_by_its_name_and_declares_keys_of_the_stage() {
        let params: Vec<&str> = (Fit::entry().params)().iter().map(|p| p.name).collect();
        for model in MODELS {
            assert_eq!(<&Model>::read(&Literal::Text(model.name.to_owned())).map(|m| m.name), Some(model.name));
            assert!(model.keys.iter().all(|k| params.contains(k)), "{}", model.name);
            assert!(model.choose.contains(&Choose::Given), "{}", model.name);
        }
    }

    #[test]
    fn law_the_key_holds_what_the_model_takes_and_no_more() {
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
    fn gold_a_key_of_another_model_names_its_owners() {
        let why = |model: &str, key: &str| stage(model, &[]).unwrap().idle(key).map(|f| f.what).unwrap_or_default();
        assert_eq!(why("tolles_lawson", "l1_ratio"), "`l1_ratio` belongs to `elastic_net`");
        assert_eq!(why("ridge", "components"), "`components` belongs to `pls` and `truncated_svd`");
        assert_eq!(why("robust", "degrees_of_freedom"), "`degrees_of_freedom` belongs to the loss `student_t`");
        assert_eq!(why("elastic_net", "l1_ratio"), "");
    }

    #[test]
    fn law_a_key_of_another_model_changes_nothing() {
        let others =
            [number("lambda", 0.0), number("l1_ratio", 0.1), number("forgetting", 0.95), number("whiten", 2.0)];
        let [plain, more] = [&others[..0], &others[..3]].map(|keys| fitted("pls", keys).value);
        assert_eq!(plain, more);
        let [plain, more] = [&others[..0], &others[1..]].map(|keys| fitted("robust", keys).value);
        assert_eq!(plain, more);
    }
}
