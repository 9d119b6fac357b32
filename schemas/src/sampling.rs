//! The dependence of list entries on the sample rate of their line.
//!
//! Some terms of a model are differences per sample, so their coefficients are valid at one rate only. A list column
//! names such entries in its metadata. A stage that applies a model at another rate converts them or reports an error.

use std::collections::HashMap;

/// Relative difference below which two rates are equal.
const SAME_RATE: f64 = 1e-4;

/// The metadata key that names the entries, such as `xx_dot:1,mag_4_uc_dot4:4,mag_4_uc_lag_3:lag`.
const PER_SAMPLE: &str = "per_sample";
/// Metadata key of the rate at which the entries were computed, in Hz.
const RATE: &str = "rate_hz";

/// Dependence of one entry on the sample rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RateLaw {
    /// A difference of this order per sample, proportional to the time between samples to the power of the order.
    Difference(i32),
    /// The value of an earlier sample, which has no equivalent at another rate.
    Lag,
}

impl RateLaw {
    /// The rate dependence that a name implies: `x_dot` and `x_dot4` are differences, `x_lag_3` is an earlier sample.
    fn of_name(name: &str) -> Option<RateLaw> {
        let lag = |(_, samples): (&str, &str)| samples.parse::<u32>().ok().map(|_| RateLaw::Lag);
        match name {
            _ if name.ends_with("_dot") => Some(RateLaw::Difference(1)),
            _ if name.ends_with("_dot4") => Some(RateLaw::Difference(4)),
            _ => name.rsplit_once("_lag_").and_then(lag),
        }
    }

    /// The factor that converts an entry made at `from_hz` to `to_hz`; `None` if there is none.
    ///
    /// To first order, a difference of order p is the derivative times the sample interval to the power p. A central
    /// difference at the frequency f is too small by the fraction (2 pi f / rate)^2 / 6.
    pub fn factor(self, from_hz: f64, to_hz: f64) -> Option<f64> {
        match self {
            _ if is_same_rate(from_hz, to_hz) => Some(1.0),
            RateLaw::Difference(order) => Some((from_hz / to_hz).powi(order)),
            RateLaw::Lag => None,
        }
    }

    fn word(self) -> String {
        match self {
            RateLaw::Difference(order) => order.to_string(),
            RateLaw::Lag => "lag".to_owned(),
        }
    }

    fn parse(word: &str) -> Option<RateLaw> {
        if word == "lag" { Some(RateLaw::Lag) } else { word.parse().ok().map(RateLaw::Difference) }
    }
}

/// Whether two rates are equal within the rounding of times.
pub fn is_same_rate(one_hz: f64, other_hz: f64) -> bool {
    (one_hz / other_hz - 1.0).abs() <= SAME_RATE
}

/// The entries of a list column that depend on the sample rate.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RateDependence {
    /// Rate at which the entries were computed, in Hz; `None` if it differs between lines or is unknown before the run.
    pub rate_hz: Option<f64>,
    /// Each entry with its rate dependence; all others do not depend on the rate.
    pub entries: Vec<(String, RateLaw)>,
}

impl RateDependence {
    /// The rate dependence that the names of entries imply.
    pub fn of_names(names: &[String]) -> RateDependence {
        let law = |name: &String| Some((name.clone(), RateLaw::of_name(name)?));
        RateDependence { rate_hz: None, entries: names.iter().filter_map(law).collect() }
    }

    /// The rate dependence of an entry; `None` if there is none.
    pub fn law(&self, entry: &str) -> Option<RateLaw> {
        self.entries.iter().find(|(name, _)| name == entry).map(|(_, law)| *law)
    }

    /// Writes the sampling to the metadata of a field with these entries.
    pub(crate) fn write(&self, names: &[String], metadata: &mut HashMap<String, String>) {
        if *self == RateDependence::default() && RateDependence::of_names(names).entries.is_empty() {
            return;
        }
        let entries: Vec<String> = self.entries.iter().map(|(name, law)| format!("{name}:{}", law.word())).collect();
        metadata.insert(PER_SAMPLE.to_owned(), entries.join(","));
        metadata.extend(self.rate_hz.map(|rate_hz| (RATE.to_owned(), rate_hz.to_string())));
    }

    /// Reads the sampling from the metadata of a field with these entries. Without metadata, it follows from the names
    /// of the entries.
    pub(crate) fn read(names: &[String], metadata: &HashMap<String, String>) -> RateDependence {
        let rate_hz = metadata.get(RATE).and_then(|rate| rate.parse().ok()).filter(|rate: &f64| *rate > 0.0);
        let Some(listed) = metadata.get(PER_SAMPLE) else {
            return RateDependence { rate_hz, ..RateDependence::of_names(names) };
        };
        let one = |entry: &str| {
            let (name, law) = entry.rsplit_once(':')?;
            Some((name.to_owned(), RateLaw::parse(law)?))
        };
        RateDependence { rate_hz, entries: listed.split(',').filter_map(one).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Column, describe_field};

    #[test]
    fn law_a_difference_scales_with_its_order_and_a_lag_has_no_equivalent() {
        assert_eq!(RateLaw::Difference(1).factor(10.0, 5.0), Some(2.0));
        assert_eq!(RateLaw::Difference(4).factor(10.0, 40.0), Some(1.0 / 256.0));
        assert_eq!(RateLaw::Difference(1).factor(10.0, 10.0001), Some(1.0));
        assert_eq!(RateLaw::Lag.factor(10.0, 10.0), Some(1.0));
        assert_eq!(RateLaw::Lag.factor(10.0, 5.0), None);
    }

    #[test]
    fn unit_metadata_override_names() {
        let names = ["x", "xx_dot", "m_dot4", "m_lag_3", "a_lag_b"].map(str::to_owned).to_vec();
        let mut column = Column::list("tl", "", "", names);
        let laws = [("xx_dot", RateLaw::Difference(1)), ("m_dot4", RateLaw::Difference(4)), ("m_lag_3", RateLaw::Lag)];
        assert_eq!(column.sampling.entries, laws.map(|(name, law)| (name.to_owned(), law)));
        assert_eq!(describe_field(&column.field()).sampling, column.sampling);
        column.sampling =
            RateDependence { rate_hz: Some(10.0), entries: vec![("x".to_owned(), RateLaw::Difference(1))] };
        assert_eq!(describe_field(&column.field()).sampling, column.sampling);
        assert_eq!(column.field().metadata()["rate_hz"], "10");
        // A column with misleading names can override the implied dependence.
        column.sampling = RateDependence::default();
        assert_eq!(describe_field(&column.field()).sampling, RateDependence::default());
    }
}
