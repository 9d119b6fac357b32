//! Definition of a metric.

use std::sync::Arc;

use numerics::regression::statistics::Figure;
use schemas::{Fault, Kind, Own, Reader, metric::Metric};

use super::{line::Line, source::Source};

/// A metric and its computation on a line.
#[derive(Clone, Copy, Debug)]
pub struct Scorer {
    /// Properties that do not depend on a line.
    pub metric: Metric,
    /// Version, raised whenever the value changes, of a metric that is not built in. Built-in metrics share the version
    /// of `score`.
    pub version: u32,
    /// Required sources.
    pub needs: &'static [Source],
    /// Sources used if available.
    pub uses: &'static [Source],
    /// Computation of the value.
    pub score: fn(&Line) -> Result<Figure, Fault>,
    /// Sorted samples whose quantile the metric is. Lines are pooled over them.
    pub spread: Option<Spread>,
}

/// Sorted samples of a line whose quantile a metric is.
pub type Spread = for<'l> fn(&'l Line) -> Result<&'l [f64], Fault>;

impl Kind for Scorer {
    type Keys = ();
    const DEFAULT: Option<&'static str> = None;

    fn name(&self) -> &'static str {
        self.metric.name
    }

    fn version(&self) -> u32 {
        self.version
    }

    fn read(&self, _: &mut Reader) -> Option<Own<()>> {
        Some(Own { keys: Arc::new(()), spelt: vec![] })
    }
}

impl Scorer {
    /// Whether it reads a source.
    pub fn reads(&self, source: Source) -> bool {
        self.needs.contains(&source) || self.uses.contains(&source)
    }
}

/// Declares a [`Scorer`]: its meaning (a sentence without its full stop), name, unit, pooling over lines, preferred
/// values, place in tables (default: none), samples whose quantile it is (default: none), required and used sources,
/// and computation.
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
                pool: schemas::metric::Pool::$pool $(($percent))?,
                better: schemas::metric::Better::$better $(($target))?,
                shown: [$($shown,)? schemas::metric::Shown::NOWHERE][0],
            },
            version: [$($v,)? 1][0],
            needs: &[$($crate::score::Source::$need $(($need_column))?),+],
            uses: &[$($($crate::score::Source::$use $(($use_column))?),+)?],
            score: $score,
            spread: [$(Some($spread as $crate::score::Spread),)? None][0],
        };
    };
}
pub use metric;
