//! Inputs of the network at a sample: the innovation of the sample before, and the state of flight.

use crate::navigation::field::PredictedField;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::Innovation;

/// Names of the inputs that the filter computes, in the order of the inputs. For the previous sample, v is the
/// innovation, s its predicted variance, and σ² the assumed variance of the measurement:
///
/// | Input | Value |
/// |:--|:--|
/// | `innovation` | asinh(v/σ) |
/// | `innovation_size` | ln(1 + v²/σ²) |
/// | `prediction` | ln(1 + (s − R)/σ²), where R is the noise that the filter used |
/// | `missing` | 1 if the previous sample has no innovation (the three inputs above are then 0), else 0 |
/// | `map_slope` | asinh(horizontal map slope in nT/km over σ in nT), at the INS position plus the last error |
/// | `speed` | ground speed of the INS, m/s |
/// | `turn_rate` | absolute rate of change of the INS course, deg/s |
/// | `specific_force` | magnitude of the specific force of the INS, m/s² |
pub const FILTER_INPUTS: [&str; 8] =
    ["innovation", "innovation_size", "prediction", "missing", "map_slope", "speed", "turn_rate", "specific_force"];

const M_PER_KM: f64 = 1000.0;

/// Sample before the present one.
#[derive(Clone, Copy, Debug)]
pub(super) struct SampleBefore {
    /// Estimated error of latitude and longitude (rad) and height (m).
    pub(super) error: [f64; 3],
    pub(super) innovation: Innovation,
    /// Assumed variance of the measurement, and the variance that the filter used, in nT².
    pub(super) assumed_nt2: f64,
    pub(super) used_nt2: f64,
}

impl SampleBefore {
    /// Before the first sample.
    pub(super) const NONE: Self =
        Self { error: [0.0; 3], innovation: Innovation::NONE, assumed_nt2: f64::NAN, used_nt2: f64::NAN };
}

/// Inputs along a line.
pub(super) struct InputSource<'a> {
    line: &'a NavigationLine<'a>,
    map: PredictedField<'a>,
    /// Further inputs, row-major.
    further: &'a [f64],
    width: usize,
    /// For tests: inputs of all rows, used instead of the computed inputs.
    #[cfg(test)]
    pub(super) frozen: Option<Vec<f64>>,
}

impl<'a> InputSource<'a> {
    pub(super) fn new(line: &'a NavigationLine<'a>, further: &'a [f64]) -> Self {
        let width = further.len() / line.ins.len().max(1);
        Self {
            line,
            map: PredictedField::new(line.map, None),
            further,
            width,
            #[cfg(test)]
            frozen: None,
        }
    }

    /// Number of inputs.
    pub(super) fn count(&self) -> usize {
        FILTER_INPUTS.len() + self.width
    }

    /// Inputs at a row.
    pub(super) fn at(&mut self, row: usize, before: &SampleBefore) -> Vec<f64> {
        #[cfg(test)]
        if let Some(frozen) = &self.frozen {
            return frozen[row * self.count()..][..self.count()].to_vec();
        }
        let ins = self.line.ins;
        let mut inputs = Vec::with_capacity(self.count());
        inputs.extend(of_innovation(before));
        let slope_nt_per_m = self.map.at_error(ins, row, before.error).map(|at| self.line.slope_nt_per_m(row, &at));
        inputs.push(slope_nt_per_m.map_or(f64::NAN, |slope| (M_PER_KM * slope / self.line.sigma_nt[row]).asinh()));
        inputs.push(ins.vn_mps[row].hypot(ins.ve_mps[row]));
        inputs.push(self.turn_rate(row));
        inputs.push(ins.fn_mps2[row].hypot(ins.fe_mps2[row]).hypot(ins.fd_mps2[row]));
        inputs.extend_from_slice(&self.further[row * self.width..][..self.width]);
        inputs
    }

    /// Absolute rate of change of the course since the previous sample, in deg/s; 0 at the first sample.
    fn turn_rate(&self, row: usize) -> f64 {
        let ins = self.line.ins;
        let Some(last) = row.checked_sub(1) else { return 0.0 };
        let (vn, ve, last_vn, last_ve) = (ins.vn_mps[row], ins.ve_mps[row], ins.vn_mps[last], ins.ve_mps[last]);
        let turn_rad = (last_vn * ve - last_ve * vn).atan2(last_vn * vn + last_ve * ve);
        turn_rad.to_degrees().abs() / (ins.tt_s[row] - ins.tt_s[last])
    }
}

/// The first four inputs.
fn of_innovation(before: &SampleBefore) -> [f64; 4] {
    let SampleBefore { innovation: Innovation { residual_nt, nis }, assumed_nt2, used_nt2, .. } = *before;
    if !(residual_nt.is_finite() && nis.is_finite() && assumed_nt2 > 0.0) {
        return [0.0, 0.0, 0.0, 1.0];
    }
    let size = residual_nt / assumed_nt2.sqrt();
    // The predicted variance is undetermined for an innovation of exactly 0.
    let excess_nt2 = if nis > 0.0 { (residual_nt * residual_nt / nis - used_nt2).max(0.0) } else { 0.0 };
    [size.asinh(), (size * size).ln_1p(), (excess_nt2 / assumed_nt2).ln_1p(), 0.0]
}
