//! Metadata of the file that describes the logical table of a published table.

/// Metadata key of the schema of the logical table, an Arrow message in hexadecimal digits.
pub const SCHEMA: &str = "magline.logical_schema";
/// Metadata key of the patterns, in JSON: each holds the number of steps upstream to the table of each column.
pub const PATTERNS: &str = "magline.patterns";
