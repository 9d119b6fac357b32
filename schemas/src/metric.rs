//! The declaration of a metric: what a stage that scores says of a line, and what is made of it afterwards.
//!
//! Pooling over lines, the columns of a table of scores, the ranking of a sweep, its heat maps and the reference are all
//! derived from it.

/// One metric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// The name in a spec and in a table of scores.
    pub name: &'static str,
    /// The unit of its values.
    pub unit: &'static str,
    /// What it is, in a sentence without its full stop.
    pub meaning: &'static str,
    /// How the values of several lines become one.
    pub pool: Pool,
    /// Which values are good.
    pub better: Better,
    /// Where it is shown beside the table of scores itself.
    pub shown: Shown,
}

/// How the values of several lines become one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pool {
    /// As a root mean square weighted by samples: errors.
    Rms,
    /// As a mean weighted by samples: ratios.
    Mean,
    /// As a sum: numbers of samples.
    Sum,
    /// As the standard error of the mean of independent figures, weighted as that mean.
    Error,
}

impl Pool {
    /// The value of all, of pairs of value and weight (a sum has no weights); NaN of no weight.
    pub fn value(self, figures: impl Iterator<Item = (f64, f64)>) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (value, n) in figures {
            weight += n;
            sum += match self {
                Self::Rms => n * value * value,
                Self::Mean => n * value,
                Self::Sum => value,
                Self::Error => (n * value).powi(2),
            };
        }
        match self {
            _ if weight == 0.0 => f64::NAN,
            Self::Rms => (sum / weight).sqrt(),
            Self::Mean => sum / weight,
            Self::Sum => sum,
            Self::Error => sum.sqrt() / weight,
        }
    }

    /// The word for it.
    pub fn words(self) -> &'static str {
        match self {
            Self::Rms => "root mean square",
            Self::Mean => "mean",
            Self::Sum => "sum",
            Self::Error => "standard error of the mean",
        }
    }
}

/// Which values of a metric are good.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Better {
    /// Small ones.
    Lower,
    /// Large ones.
    Higher,
    /// Those near a target, by ratio.
    Near(f64),
    /// It describes the data, not the answer.
    Neither,
}

impl Better {
    /// A cost that is smaller for the better of two values; `None` where there is no better.
    pub fn cost(self, value: f64) -> Option<f64> {
        let cost = match self {
            Better::Lower => value,
            Better::Higher => -value,
            Better::Near(target) => (value / target).ln().abs(),
            Better::Neither => return None,
        };
        cost.is_finite().then_some(cost)
    }

    /// Which values are good, in words; empty for [`Better::Neither`].
    pub fn words(self) -> String {
        match self {
            Better::Lower => "smaller".to_owned(),
            Better::Higher => "larger".to_owned(),
            Better::Near(target) => format!("near {target}"),
            Better::Neither => String::new(),
        }
    }
}

/// Where a metric is shown. Places count in tens, so that there is room between two for another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shown {
    /// Its place among the columns of pooled scores, from the left; `None` for a metric that is none.
    pub column: Option<u16>,
    /// Where a terminal is too narrow for all columns, those of least weight give way first.
    pub weight: u16,
    /// Its place among the metrics that rank the points of a sweep, the most telling first: the first that has a value
    /// does. `None` for a metric that never does.
    pub rank: Option<u16>,
    /// Whether it is drawn over two axes of a sweep.
    pub heat_map: bool,
}

impl Shown {
    /// In the table of scores only.
    pub const NOWHERE: Self = Self { column: None, weight: 0, rank: None, heat_map: false };

    /// As a column of the pooled scores.
    pub const fn column(place: u16, weight: u16) -> Self {
        Self { column: Some(place), weight, ..Self::NOWHERE }
    }

    /// And as what ranks the points of a sweep.
    pub const fn rank(self, place: u16) -> Self {
        Self { rank: Some(place), ..self }
    }

    /// And over two axes of a sweep.
    pub const fn heat_map(self) -> Self {
        Self { heat_map: true, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_errors_pool_by_squares_ratios_by_means_and_numbers_add_up() {
        let lines = || [(3.0, 100.0), (4.0, 300.0)].into_iter();
        assert_eq!(Pool::Rms.value(lines()), ((9.0 * 100.0 + 16.0 * 300.0) / 400.0f64).sqrt());
        assert_eq!((Pool::Mean.value(lines()), Pool::Sum.value(lines())), (3.75, 7.0));
        // Equal errors of equal weights fall with the root of their number.
        assert_eq!(Pool::Error.value([(0.4, 9.0); 4].into_iter()), 0.2);
        assert!([Pool::Rms, Pool::Mean, Pool::Sum].iter().all(|p| p.value(std::iter::empty()).is_nan()));
    }

    #[test]
    fn unit_a_ratio_is_as_far_from_its_target_above_as_below() {
        assert_eq!(Better::Near(2.0).cost(8.0), Better::Near(2.0).cost(0.5));
        assert!(Better::Higher.cost(3.0) < Better::Higher.cost(2.0));
        assert_eq!((Better::Neither.cost(1.0), Better::Lower.cost(f64::NAN)), (None, None));
    }
}
