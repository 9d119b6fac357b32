//! Definition of a metric.

use std::{fmt, sync::Arc};

use numerics::regression::statistics::SampleStatistic;
use schemas::{ChoiceKeys, ChoiceKind, Fault, ParamReader, metric::Metric};

use super::{line::ScoreLine, source::ScoreSource};

/// A metric and its computation on a line.
#[derive(Clone, Copy)]
pub struct Scorer {
    /// Properties that do not depend on a line.
    pub metric: Metric,
    /// Version of a metric that is not built in, raised whenever its value changes. Built-in metrics share the version
    /// of `score`.
    pub version: u32,
    /// Hash of the source text of a metric that is loaded at run time. `None` for a compiled metric.
    pub source: Option<&'static str>,
    /// Required sources.
    pub needs: &'static [ScoreSource],
    /// Sources used if available.
    pub uses: &'static [ScoreSource],
    /// Computation of the value.
    pub score: &'static ScoreFn,
    /// Sorted samples, if the metric is a quantile of samples. Lines are pooled with these samples.
    pub spread: Option<QuantileSamplesFn>,
}

/// Computation of a metric on a line.
pub type ScoreFn = dyn Fn(&ScoreLine) -> Result<SampleStatistic, Fault> + Send + Sync;

/// Sorted samples of a line. The metric is a quantile of these samples.
pub type QuantileSamplesFn = for<'l> fn(&'l ScoreLine) -> Result<&'l [f64], Fault>;

impl ChoiceKind for Scorer {
    type Keys = ();
    const DEFAULT: Option<&'static str> = None;

    fn name(&self) -> &'static str {
        self.metric.name
    }

    fn version(&self) -> u32 {
        self.version
    }

    fn source(&self) -> Option<&str> {
        self.source
    }

    fn read(&self, _: &mut ParamReader) -> Option<ChoiceKeys<()>> {
        Some(ChoiceKeys { keys: Arc::new(()), spelt: vec![] })
    }
}

impl fmt::Debug for Scorer {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Scorer { metric, version, needs, uses, .. } = self;
        let mut shown = f.debug_struct("Scorer");
        shown.field("metric", metric).field("version", version).field("needs", needs).field("uses", uses);
        shown.finish_non_exhaustive()
    }
}

impl Scorer {
    /// Returns whether the metric reads a source.
    pub fn reads(&self, source: ScoreSource) -> bool {
        self.needs.contains(&source) || self.uses.contains(&source)
    }
}

/// Declares a [`Scorer`]: its meaning (a sentence without its full stop), name, unit, pooling over lines, preferred
/// values, place in tables (default: none), baseline with its label (default: none), limit beyond which a value is
/// flagged (default: none), samples of which it is a quantile (default: none), required and used sources, and
/// computation.
#[macro_export]
macro_rules! metric {
    (
        $(#[doc = $doc:literal])+
        $NAME:ident = $name:literal, $(version $v:literal,)? unit $unit:literal,
        pool $pool:ident $(($percent:literal))?, better $better:ident $(($target:literal))?,
        $(shown $shown:expr,)? $(baseline $baseline:ident $label:literal,)? $(limit $limit:ident ($bound:literal),)?
        $(spread $spread:expr,)? needs [$($need:ident $(($need_column:literal))?),+]
        $(, uses [$($use:ident $(($use_column:literal))?),+])?;
        $score:expr
    ) => {
        $(#[doc = $doc])+
        pub const $NAME: $crate::score::Scorer = $crate::score::Scorer {
            metric: schemas::metric::Metric {
                name: $name,
                unit: $unit,
                meaning: concat!($($doc),+).trim_ascii(),
                pool: schemas::metric::PoolingRule::$pool $(($percent))?,
                better: schemas::metric::MetricPreference::$better $(($target))?,
                shown: [$($shown,)? schemas::metric::MetricDisplay::NOWHERE][0],
                baseline: [
                    $(Some(schemas::metric::MetricBaseline { metric: $baseline.metric.name, label: $label }),)? None
                ][0],
                limit: [$(Some(schemas::metric::MetricLimit::$limit($bound)),)? None][0],
            },
            version: [$($v,)? 1][0],
            source: None,
            needs: &[$($crate::score::ScoreSource::$need $(($need_column))?),+],
            uses: &[$($($crate::score::ScoreSource::$use $(($use_column))?),+)?],
            score: &$score,
            spread: [$(Some($spread as $crate::score::QuantileSamplesFn),)? None][0],
        };
    };
}
pub use metric;
