//! Fisher information of the measurements along a line about a position.

/// Lower bound, in metres, on the standard deviation of a position from one measurement with error `sigma_nt`, along
/// the slope `north`, `east` (nT/m) of a map: σ/|g|. Across the slope the position is undetermined. NaN where the slope
/// is 0 or unknown.
pub fn sample_bound_m(north: f64, east: f64, sigma_nt: f64) -> f64 {
    let slope = north.hypot(east);
    if slope > 0.0 { sigma_nt / slope } else { f64::NAN }
}

/// Settings of [`window_bounds_m`] for the measurements within a time window.
#[derive(Clone, Copy, Debug)]
pub struct WindowInformation {
    /// The length of the window, in seconds.
    pub window_s: f64,
    /// Standard deviation of the error of a measurement, independent of the others, in nT.
    pub sigma_nt: f64,
    /// Whether a constant bias of the measurements is also unknown.
    pub unknown_constant: bool,
}

/// Lower bound, in metres, on the root mean square horizontal error of a position from the measurements within half a
/// window before and after each sample. The map has the slopes `north` and `east` (nT/m) at the samples, and the motion
/// within the window is known. The bound is √ trace(J⁻¹) with the Fisher information J = Σ g gᵀ/σ². If a constant is
/// unknown, the mean is subtracted from the slopes g. [Cramér-Rao bound; Kay 1993, section 3.7]
///
/// The times `tt_s` ascend, with even or uneven steps. Samples without a slope are excluded from all windows. NaN if
/// the sample itself has no slope, or if J is singular. J is singular if the map is flat or slopes in one direction
/// only, or if there are too few samples (two, three with a constant). J is treated as singular if its smaller
/// eigenvalue is below about 2.5e-13 of the larger one, the level of rounding.
pub fn window_bounds_m(tt_s: &[f64], north: &[f64], east: &[f64], of: WindowInformation) -> Vec<f64> {
    let n = tt_s.len().min(north.len()).min(east.len());
    let half_s = 0.5 * of.window_s;
    let (mut first, mut end) = (0, 0);
    let one = |i: usize| {
        while tt_s[i] - tt_s[first] > half_s {
            first += 1;
        }
        while end < n && tt_s[end] - tt_s[i] <= half_s {
            end += 1;
        }
        if north[i].is_finite() && east[i].is_finite() {
            bound_m(&north[first..end], &east[first..end], of)
        } else {
            f64::NAN
        }
    };
    (0..n).map(one).collect()
}

fn bound_m(north: &[f64], east: &[f64], of: WindowInformation) -> f64 {
    let known = || north.iter().zip(east).filter(|(n, e)| n.is_finite() && e.is_finite());
    let count = known().count() as f64;
    let mean = |slope: fn((&f64, &f64)) -> f64| known().map(slope).sum::<f64>() / count;
    let (mean_n, mean_e) = if of.unknown_constant { (mean(|s| *s.0), mean(|s| *s.1)) } else { (0.0, 0.0) };
    let (mut nn, mut ne, mut ee) = (0.0, 0.0, 0.0);
    for (n, e) in known().map(|(n, e)| (n - mean_n, e - mean_e)) {
        nn += n * n;
        ne += n * e;
        ee += e * e;
    }
    let (determinant, trace) = (nn * ee - ne * ne, nn + ee);
    let least = if of.unknown_constant { 3.0 } else { 2.0 };
    let regular = count >= least && determinant > 1e-12 * 0.25 * trace * trace;
    if regular { of.sigma_nt * (trace / determinant).sqrt() } else { f64::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regression::statistics::offset_bound;

    const OF: WindowInformation = WindowInformation { window_s: 20.0, sigma_nt: 5.0, unknown_constant: false };

    #[test]
    fn law_alternating_slopes_each_determine_one_direction() {
        // Half of the samples have a slope of 0.02 nT/m north, the others of 0.05 nT/m east: J = diag(n 0.02², m
        // 0.05²)/σ².
        let tt: Vec<f64> = (0..200).map(f64::from).collect();
        let of_parity = |parity: u32, slope: f64| (0..200).map(move |k| if k % 2 == parity { slope } else { 0.0 });
        let (north, east): (Vec<f64>, Vec<f64>) = (of_parity(0, 0.02).collect(), of_parity(1, 0.05).collect());
        let bounds = window_bounds_m(&tt, &north, &east, OF);
        // Within 10 s of a sample with even index, there are 11 samples with even index and 10 with odd index. Within
        // 10 s of the first sample of the line, there are 6 and 5.
        let expected = |n: f64, m: f64| 5.0 * (1.0 / (n * 0.02f64.powi(2)) + 1.0 / (m * 0.05f64.powi(2))).sqrt();
        for (k, n, m) in [(100, 11.0, 10.0), (101, 10.0, 11.0), (0, 6.0, 5.0), (199, 5.0, 6.0)] {
            assert!((bounds[k] / expected(n, m) - 1.0).abs() < 1e-12, "{k}: {} {}", bounds[k], expected(n, m));
        }
    }

    #[test]
    fn law_an_unknown_constant_gives_the_offset_bound_of_a_line() {
        let tt: Vec<f64> = (0..50).map(f64::from).collect();
        let north: Vec<f64> = tt.iter().map(|t| 0.03 * (0.4 * t).sin() + 0.02).collect();
        let east: Vec<f64> = tt.iter().map(|t| 0.02 * (0.7 * t).cos()).collect();
        let with = WindowInformation { window_s: 200.0, unknown_constant: true, ..OF };
        let whole = offset_bound(&north, &east, 5.0).value;
        assert!(window_bounds_m(&tt, &north, &east, with).iter().all(|b| (b / whole - 1.0).abs() < 1e-12));
        let without = window_bounds_m(&tt, &north, &east, WindowInformation { window_s: 200.0, ..OF });
        assert!(without[0] < whole, "what is known helps");
    }

    #[test]
    fn law_a_flat_map_or_a_single_slope_determines_no_position() {
        let tt: Vec<f64> = (0..50).map(|k| 0.1 * f64::from(k)).collect();
        for (north, east) in [(0.0, 0.0), (0.02, 0.0), (0.013, -0.07)] {
            let (north, east) = ([north; 50], [east; 50]);
            assert!(window_bounds_m(&tt, &north, &east, OF).iter().all(|b| b.is_nan()));
        }
        assert!(sample_bound_m(0.0, 0.0, 5.0).is_nan() && sample_bound_m(f64::NAN, 0.1, 5.0).is_nan());
        assert_eq!(sample_bound_m(0.3, 0.4, 5.0), 10.0);
    }

    #[test]
    fn unit_samples_without_a_slope_are_excluded() {
        let tt: Vec<f64> = (0..50).map(f64::from).collect();
        let mut north: Vec<f64> = tt.iter().map(|t| 0.03 * (0.4 * t).sin()).collect();
        let east: Vec<f64> = tt.iter().map(|t| 0.02 * (0.7 * t).cos()).collect();
        let before = window_bounds_m(&tt, &north, &east, OF);
        north[20] = f64::NAN;
        let after = window_bounds_m(&tt, &north, &east, OF);
        assert!(after[20].is_nan() && after[31].to_bits() == before[31].to_bits());
        assert!(after[19] >= before[19] && after[19].is_finite());
        assert!(window_bounds_m(&tt[..1], &north[..1], &east[..1], OF)[0].is_nan());
    }
}
