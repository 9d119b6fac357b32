//! Errors of a training.

/// Error of a training.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrainingError {
    /// There are no samples.
    #[error("there is no sample {what}")]
    NoSamples {
        /// Purpose of the rows: `to train on` or `to validate with`.
        what: &'static str,
    },
    /// The number of values does not match the rows.
    #[error("samples {what}: {given} values of {of} are given, but {rows} rows require {expected}")]
    Length {
        /// Purpose of the rows: `to train on` or `to validate with`.
        what: &'static str,
        /// Name of the values.
        of: &'static str,
        /// Given number.
        given: usize,
        /// Required number.
        expected: usize,
        /// The number of rows.
        rows: usize,
    },
    /// A value is NaN or infinite.
    #[error("{of} {column} in row {row} (both from 0) of the samples {what} is not finite; remove such rows")]
    NotFinite {
        /// Purpose of the rows: `to train on` or `to validate with`.
        what: &'static str,
        /// Name of the value.
        of: &'static str,
        /// The row, from 0.
        row: usize,
        /// The column, from 0.
        column: usize,
    },
    /// A setting is out of its valid range.
    #[error("{what} must be {wanted}, but is {given}")]
    Setting {
        /// The setting.
        what: &'static str,
        /// The valid range of the setting.
        wanted: &'static str,
        /// The given value.
        given: f64,
    },
    /// A setting requires validation samples.
    #[error("{what} requires lines or flights for validation")]
    NoValidation {
        /// The setting.
        what: &'static str,
    },
    /// The initial state does not match the network.
    #[error("there are {given} initial parameters, but this network requires {expected} finite ones")]
    Start {
        /// Number of finite parameters, or the wrong number of coefficients or moments.
        given: usize,
        /// Required number.
        expected: usize,
    },
    /// Loss or parameters are no longer finite.
    #[error(
        "training diverged in epoch {epoch}: loss or weights are no longer finite at a learning rate of \
         {learning_rate}; reduce the learning rate, and check that inputs, linear terms and target are scaled to \
         about 1"
    )]
    Diverged {
        /// The epoch, from 1.
        epoch: usize,
        /// The learning rate in this epoch.
        learning_rate: f64,
    },
}
