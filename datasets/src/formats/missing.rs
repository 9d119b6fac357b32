//! Words and numbers that mark a missing value.

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, ArrowPrimitiveType, PrimitiveArray,
    cast::AsArray,
    types::{Float32Type, Float64Type, Int32Type, Int64Type},
};
use arrow_schema::DataType;

use super::FlightOptions;

/// Words that mark missing values in every file; case is ignored. An empty cell is also missing.
pub(super) const WORDS: [&str; 9] = ["*", "-", "--", "n/a", "#n/a", "na", "nan", "null", "none"];

/// Numbers that mark missing values in every file: the usual filler of loggers, and Geosoft's dummy. They cannot be
/// values of a flight: -99999 is below every length, angle and field. -9999 is not included, because a component of the
/// field can have this value.
pub(super) const NUMBERS: [f64; 2] = [-99_999.0, -1e32];

/// Markers of missing values in one file: the usual words, and those of the options.
#[derive(Clone, Debug)]
pub(super) struct MissingMarkers {
    words: Vec<String>,
    numbers: Vec<f64>,
}

impl MissingMarkers {
    pub(super) fn from_options(options: &FlightOptions) -> MissingMarkers {
        let words = options.missing.iter().map(|w| w.0.trim().to_owned()).collect();
        let given = options.missing.iter().filter_map(|w| w.0.trim().parse::<f64>().ok());
        MissingMarkers { words, numbers: NUMBERS.into_iter().chain(given).filter(|x| !x.is_nan()).collect() }
    }

    /// A number, or NaN for a missing value; `None` for any other word.
    pub(super) fn number(&self, text: &str) -> Option<f64> {
        match text.parse::<f64>() {
            Ok(x) if self.numbers.contains(&x) => Some(f64::NAN),
            Ok(x) => Some(x),
            Err(_) => self.is_word(text).then_some(f64::NAN),
        }
    }

    /// A whole number; `Some(None)` for a missing value, and `None` for a number with a fraction or any other word.
    pub(super) fn whole(&self, text: &str) -> Option<Option<i64>> {
        let x = self.number(text)?;
        if x.is_nan() {
            return Some(None);
        }
        // Beyond 2^53, integers may not be exact as f64.
        (x.fract() == 0.0 && x.abs() < 9e15).then_some(Some(x as i64))
    }

    /// Whether a text marks a missing value.
    pub(super) fn is_text(&self, text: &str) -> bool {
        self.number(text.trim()).is_some_and(f64::is_nan)
    }

    fn is_word(&self, text: &str) -> bool {
        is_usual_word(text) || self.words.iter().any(|w| w == text)
    }

    /// The number, or NaN if it marks a missing value.
    pub(super) fn kept(&self, x: f64) -> f64 {
        if self.numbers.contains(&x) { f64::NAN } else { x }
    }

    /// The highest number that marks a missing value.
    pub(super) fn highest(&self) -> f64 {
        self.numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// A column of a Parquet file from another program, with nulls for the numbers that mark missing values.
    pub(super) fn nulled(&self, column: &ArrayRef) -> ArrayRef {
        fn one<T: ArrowPrimitiveType>(column: &ArrayRef, is: impl Fn(T::Native) -> bool) -> ArrayRef {
            let values = column.as_primitive::<T>();
            if !values.values().iter().any(|x| is(*x)) {
                return column.clone();
            }
            let kept: PrimitiveArray<T> = values.unary_opt(|x| (!is(x)).then_some(x));
            Arc::new(kept)
        }
        let is = |x: f64| self.numbers.contains(&x);
        match column.data_type() {
            DataType::Float64 => one::<Float64Type>(column, is),
            DataType::Float32 => one::<Float32Type>(column, |x| self.numbers.iter().any(|n| *n as f32 == x)),
            DataType::Int64 => one::<Int64Type>(column, |x| is(x as f64)),
            DataType::Int32 => one::<Int32Type>(column, |x| is(f64::from(x))),
            _ => column.clone(),
        }
    }
}

/// Whether a word marks a missing value for any options.
pub(super) fn is_usual_word(text: &str) -> bool {
    text.is_empty() || WORDS.iter().any(|w| w.eq_ignore_ascii_case(text))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use arrow_array::{Float64Array, Int32Array};

    use super::*;

    #[test]
    fn ref_usual_words_and_those_of_the_options() {
        let usual = MissingMarkers::from_options(&FlightOptions::default());
        for word in ["", "*", "-", "N/A", "n/a", "NA", "null", "None", "NaN", "-99999", "-99999.00", "-1e32"] {
            assert!(usual.number(word).is_some_and(f64::is_nan), "{word}");
        }
        for (word, number) in [("-9999", Some(-9999.0)), ("0", Some(0.0)), ("high", None), ("-1.5e2", Some(-150.0))] {
            assert_eq!(usual.number(word), number, "{word}");
        }
        let given = FlightOptions { missing: vec!["-9999".into(), "dropout".into()], ..FlightOptions::default() };
        let given = MissingMarkers::from_options(&given);
        for word in ["-9999", "-9999.0", "dropout", "N/A", "-99999"] {
            assert!(given.is_text(word), "{word}");
        }
        assert_eq!(
            (given.whole("2020"), given.whole("-9999"), given.whole("1.5")),
            (Some(Some(2020)), Some(None), None)
        );
    }

    #[test]
    fn unit_fillers_of_other_programs_are_missing_values() {
        let missing = MissingMarkers::from_options(&FlightOptions::default());
        let floats = missing.nulled(&(Arc::new(Float64Array::from(vec![1.0, -99_999.0])) as ArrayRef));
        let whole = missing.nulled(&(Arc::new(Int32Array::from(vec![-99_999, 7])) as ArrayRef));
        assert_eq!((floats.is_null(0), floats.is_null(1)), (false, true));
        assert_eq!((whole.is_null(0), whole.is_null(1)), (true, false));
    }
}
