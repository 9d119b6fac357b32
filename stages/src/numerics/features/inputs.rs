//! The extended Tolles-Lawson columns of on-board inputs: currents, throttles, accelerations, anything that is measured.
//!
//! Thesis 004, 2.3.1 (2.34)-(2.35), 2.3.2 (2.38): an input I draws a current whose field turns with the aircraft, so
//! that along the earth's field it appears times the direction cosines, and its eddy currents follow its change.

use std::ops::Range;

use super::{Columns, FeatureError, difference_in_runs, same_length};
use crate::numerics::difference::Scheme;

/// Which columns an input gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Groups {
    /// Group 1: the input itself, `_1`.
    pub raw: bool,
    /// Group 2: the input times the three direction cosines, `_2`, `_3`, `_4`.
    pub projected: bool,
    /// Group 3: its difference per sample times the three direction cosines, `_5`, `_6`, `_7`.
    pub change: bool,
}

impl Groups {
    /// Groups 2 and 3: on-board electronics, thesis 004 (2.34).
    pub const ELECTRONICS: Self = Self { raw: false, projected: true, change: true };
    /// All three: its feature set FS0.
    pub const ALL: Self = Self { raw: true, projected: true, change: true };
    /// Without group 3: its feature set FS1.
    pub const WITHOUT_CHANGE: Self = Self { raw: true, projected: true, change: false };

    /// How many columns an input gives.
    pub fn len(self) -> usize {
        usize::from(self.raw) + 3 * usize::from(self.projected) + 3 * usize::from(self.change)
    }

    /// Whether an input gives no column.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }
}

/// The columns of one input, in its own unit: `name_1` to `name_7`.
///
/// `cosines` are the components of the vector magnetometer over its magnitude.
pub fn input_terms(
    name: &str,
    input: &[f64],
    cosines: [&[f64]; 3],
    groups: Groups,
    runs: &[Range<usize>],
) -> Result<Columns, FeatureError> {
    for cosine in cosines {
        same_length("a direction cosine", cosine.len(), input.len())?;
    }
    let mut columns = Vec::with_capacity(groups.len());
    if groups.raw {
        columns.push((format!("{name}_1"), input.to_vec()));
    }
    let mut project = |x: &[f64], first: usize| {
        for (k, cosine) in cosines.into_iter().enumerate() {
            columns.push((format!("{name}_{}", first + k), x.iter().zip(cosine).map(|(x, c)| x * c).collect()));
        }
    };
    if groups.projected {
        project(input, 2);
    }
    if groups.change {
        project(&difference_in_runs(input, Scheme::Central, runs), 5);
    }
    Ok(columns)
}

/// The components of a vector over its length; NaN where it is zero.
pub fn direction_cosines(vector: [&[f64]; 3]) -> Result<[Vec<f64>; 3], FeatureError> {
    let [x, y, z] = vector;
    same_length("the component y", y.len(), x.len())?;
    same_length("the component z", z.len(), x.len())?;
    let length = |i: usize| (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt();
    Ok([x, y, z].map(|c| (0..x.len()).map(|i| if length(i) > 0.0 { c[i] / length(i) } else { f64::NAN }).collect()))
}
