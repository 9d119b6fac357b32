//! Definition of a metric.

use std::sync::Arc;

use numerics::regression::statistics::SampleStatistic;
use schemas::{ChoiceKeys, ChoiceKind, Fault, ParamReader, metric::Metric};

use super::{line::ScoreLine, source::ScoreSource};

/// A metric and its computation on a line.
#[derive(Clone, Copy, Debug)]
pub struct Scorer {
    /// Properties that do not depend on a line.
    pub metric: Metric,
    /// Version of a metric that is not built in, raised whenever its value changes. Built-in metrics share the version
    /// of `score`.
    pub version: u32,
    /// Required sources.
    pub needs: &'static [ScoreSource],
    /// Sources used if available.
    pub uses: &'static [ScoreSource],
    /// Computation of the value.
    pub score: fn(&ScoreLine) -> Result<SampleStatistic, Fault>,
    /// Sorted samples of which the metric is a quantile. The samples are used to pool lines.
    pub spread: Option<QuantileSamplesFn>,
}

/// Sorted samples of a line of which a metric is a quantile.
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

    fn read(&self, _: &mut ParamReader) -> Option<ChoiceKeys<()>> {
        Some(ChoiceKeys { keys: Arc::new(()), spelt: vec![] })
    }
}

impl Scorer {
    /// Whether the metric reads a source.
    pub fn reads(&self, source: ScoreSource) -> bool {
        self.needs.contains(&source) || self.uses.contains(&source)
    }
}

/// Declares a [`Scorer`]: its meaning (a sentence without its full stop), name, unit, pooling over lines, preferred
/// values, place in tables (default: none), samples of which it is a quantile (default: none), required and used
/// sources, and computation.
#[macro_export]
macro_rules! metric {
    (
        $(#[doc = $doc:literal])+
        $NAME:ident = $name:literal, $(version $v:literal,)? unit $unit:literal, pool $pool:ident $(($percent:literal))?, better $better:ident $(($target:literal))?,
        $(shown $shown:expr,)? $(spread $spread:expr,)? needs [$($need:ident $(($need_column:literal))?),+]
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
            },
            version: [$($v,)? 1][0],
            needs: &[$($crate::score::ScoreSource::$need $(($need_column))?),+],
            uses: &[$($($crate::score::ScoreSource::$use $(($use_column))?),+)?],
            score: $score,
            spread: [$(Some($spread as $crate::score::QuantileSamplesFn),)? None][0],
        };
    };
}
pub use metric;
