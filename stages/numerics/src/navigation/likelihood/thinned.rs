//! Line at a subset of its samples.

use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::position_fixes::PositionFixes;

/// Rows of a line at least `interval_s` apart, including the first.
pub fn rows_at(tt_s: &[f64], interval_s: f64) -> Vec<usize> {
    let mut rows = vec![];
    let mut due_s = f64::NEG_INFINITY;
    for (row, tt) in tt_s.iter().enumerate() {
        // The tolerance of half a microsecond covers the rounding of time stamps.
        if *tt >= due_s - 5e-7 {
            rows.push(row);
            due_s = tt + interval_s;
        }
    }
    rows
}

/// INS, measurements and position fixes at a subset of rows. The specific force is the mean up to the next row, so that
/// a step has the velocity change of the samples within it.
pub(super) struct ThinnedLine {
    columns: [Vec<f64>; 13],
    pub(super) measurement_nt: Vec<f64>,
    pub(super) fixes: Option<PositionFixes>,
}

impl ThinnedLine {
    pub(super) fn new(line: &NavigationLine<'_>, rows: &[usize]) -> Self {
        let ins = line.ins;
        let at = |column: &[f64]| -> Vec<f64> { rows.iter().map(|row| column[*row]).collect() };
        let mean = |column: &[f64]| -> Vec<f64> {
            let ends = rows.iter().skip(1).copied().chain([ins.len()]);
            let spans = rows.iter().zip(ends);
            spans.map(|(from, to)| column[*from..to].iter().sum::<f64>() / (to - from) as f64).collect()
        };
        let columns = [
            at(ins.tt_s),
            at(ins.lat_deg),
            at(ins.lon_deg),
            at(ins.alt_m),
            at(ins.vn_mps),
            at(ins.ve_mps),
            at(ins.vd_mps),
            mean(ins.fn_mps2),
            mean(ins.fe_mps2),
            mean(ins.fd_mps2),
            at(ins.roll_deg),
            at(ins.pitch_deg),
            at(ins.yaw_deg),
        ];
        let fixes = line.fixes.map(|fixes| PositionFixes {
            lat_deg: at(&fixes.lat_deg),
            lon_deg: at(&fixes.lon_deg),
            alt_m: at(&fixes.alt_m),
            ..*fixes
        });
        Self { columns, measurement_nt: at(line.measurement_nt), fixes }
    }

    pub(super) fn ins(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }
}
