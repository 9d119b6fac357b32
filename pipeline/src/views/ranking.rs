//! Which of two scores is better, and which metric a sweep is ranked by.

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

/// Which values of `metric` are good.
pub fn better(metric: &str) -> Better {
    match metric {
        "std_error" | "figure_of_merit" | "figure_of_merit_crossings" | "drms" | "map_std_error" => Better::Lower,
        "improvement_ratio" | "improvement_ratio_band" | "snr" => Better::Higher,
        "nees" => Better::Near(2.0),
        "nis" | "anomaly_retention" => Better::Near(1.0),
        _ => Better::Neither,
    }
}

/// The metrics that points are ranked by, the most telling first.
pub const RANKING: [&str; 7] = [
    "drms",
    "std_error",
    "improvement_ratio_band",
    "improvement_ratio",
    "figure_of_merit_crossings",
    "map_std_error",
    "nis",
];

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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_ratio_is_as_far_from_its_law_above_as_below() {
        assert_eq!(better("nees").cost(8.0), better("nees").cost(0.5));
        assert_eq!(better("ins_drms").cost(1.0), None);
        assert_eq!(Better::Lower.cost(f64::NAN), None);
    }
}
