//! Row groups of Parquet files of flight lines: each ends with a line.
//!
//! Parquet numbers row groups with 16 bits, so a file has at most 32,767 of them.

/// Lines of at least this number of rows have a row group each; shorter lines share a row group.
const LEAST_ROWS: usize = 256;
/// Number of row groups after which [`LEAST_ROWS_OF_MANY`] applies.
const MANY_GROUPS: usize = 16_384;
/// Minimum number of rows of the row groups after [`MANY_GROUPS`].
const LEAST_ROWS_OF_MANY: usize = 131_072;

/// Whether a row group ends after the line that was written last. `rows` is the number of rows of the unfinished row
/// group, `groups` the number of finished ones.
///
/// A line of 256 rows or more has a separate row group, so that reading it decodes no other line. After 16,384 row
/// groups, each has 131,072 rows or more, so a file can hold 2e9 rows.
pub fn ends_with_line(rows: usize, groups: usize) -> bool {
    rows >= if groups < MANY_GROUPS { LEAST_ROWS } else { LEAST_ROWS_OF_MANY }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The number of row groups in a file with `lines` lines, each of `rows` rows.
    fn groups(lines: usize, rows: usize) -> usize {
        let (mut groups, mut unfinished) = (0, 0);
        for _ in 0..lines {
            unfinished += rows;
            if ends_with_line(unfinished, groups) {
                (groups, unfinished) = (groups + 1, 0);
            }
        }
        groups + usize::from(unfinished > 0)
    }

    #[test]
    fn unit_no_file_exceeds_the_number_of_row_groups_of_parquet() {
        assert_eq!([groups(1000, 256), groups(1000, 36_000)], [1000, 1000]);
        assert_eq!([groups(40_000, 1), groups(1000, 100)], [157, 334]);
        assert!(groups(40_000, 36_000) < 32_767 && groups(1_000_000, 2000) < 32_767);
    }
}
