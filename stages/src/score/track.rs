//! Metrics of a track, of the INS alone, and of the consistency of the filter.
//!
//! Limits of `nees` and `nis`. The mean over a line of the normalised estimation error squared (NEES, of the horizontal
//! position, two degrees of freedom) is 2 for a consistent filter. The mean of the normalised innovation squared (NIS,
//! one degree of freedom) is 1 [Bar-Shalom, Li & Kirubarajan 2001, section 5.4]. The textbook interval for such a mean
//! assumes independent samples, but the samples of a line are correlated:
//!
//! - Position errors are correlated over minutes, so a line holds few independent samples, at worst a single one.
//!   NEES/2 of a single sample is exponentially distributed. It exceeds ten times its expected value with probability
//!   e⁻¹⁰ (once in 22,000 lines). It is below a tenth of its expected value with probability 1 − e⁻⁰·¹ (10 %), or 0.4 %
//!   for the mean of three independent samples. A mean beyond a factor of ten therefore shows an inconsistent filter;
//!   it is hardly ever due to chance.
//! - Innovations are correlated over seconds. A line thus has dozens of independent samples, and chance stays within a
//!   factor of two. The limit is a factor of four, which matters in practice: the predicted sigma is then half or twice
//!   its correct value.
//!
//! Limitation of `whiteness`: four or fewer of 20 lags are outside their band with probability 0.997.
//!
//! Limitation of `correlated_nis`: if the assumed noise is increased to account for the correlation, its value is 1
//! although the innovations are still correlated. On 45 lines of nine simulated flights with estimated noise,
//! correlated innovations and a median NEES of 1.9, the statistic is 0.76 to 1.40. With a magnetometer that lags by 0.6
//! s it is 2.2 to 2.9. On a map made from sparse lines, used without its error, it is above 200.

use arrow_array::Array;
use numerics::regression::{
    consistency,
    statistics::{self, SampleStatistic},
};
use schemas::{Fault, metric::MetricDisplay};

use crate::navigate::{GnssOutcome, UpdateOutcome};

use super::{line::ScoreLine, metric::metric, source::ScoreSource};

metric! {
    /// distance root mean square: square root of the mean squared horizontal error of the track
    DRMS = "drms", unit "m", pool Rms, better Lower,
    shown MetricDisplay::column(100, 150).rank(10).heat_map(), baseline INS_DRMS "INS alone",
    needs [Track, Position], uses [Bound];
    |line| line.track_error().map(|e| statistics::drms(&e.north_m, &e.east_m))
}

metric! {
    /// lower bound on the `drms` of any filter with the models of `crlb`; not the result of a filter
    DRMS_BOUND = "drms_bound", unit "m", pool Rms, better Neither,
    shown MetricDisplay::column(105, 105), needs [Bound];
    |line| Ok(statistics::rms(line.column(ScoreSource::Bound)?))
}

metric! {
    /// circular error probable: radius about the truth that contains half of the samples of the track
    CEP = "cep", unit "m", pool Quantile(50), better Lower, spread radii,
    needs [Track, Position], uses [Bound];
    |line| radius(line, 0.5)
}

metric! {
    /// radius about the truth that contains 95 % of the samples of the track
    R95 = "r95", unit "m", pool Quantile(95), better Lower, spread radii,
    needs [Track, Position], uses [Bound];
    |line| radius(line, 0.95)
}

metric! {
    /// root mean square position error north
    RMS_NORTH = "rms_north", unit "m", pool Rms, better Lower, needs [Track, Position], uses [Bound];
    |line| line.track_error().map(|e| statistics::rms(&e.north_m))
}

metric! {
    /// root mean square position error east
    RMS_EAST = "rms_east", unit "m", pool Rms, better Lower, needs [Track, Position], uses [Bound];
    |line| line.track_error().map(|e| statistics::rms(&e.east_m))
}

metric! {
    /// root mean square error of the height
    RMS_DOWN = "rms_down", unit "m", pool Rms, better Lower, needs [Track, Height], uses [Bound];
    |line| down_error(line).map(|down_m| statistics::rms(&down_m))
}

metric! {
    /// mean radial spherical error: square root of the mean squared three-dimensional position error
    MRSE = "mrse", unit "m", pool Rms, better Lower, needs [Track, Position, Height], uses [Bound];
    |line| {
        let (e, down_m) = (line.track_error()?, down_error(line)?);
        let horizontal: Vec<f64> = e.north_m.iter().zip(&e.east_m).map(|(n, e)| n.hypot(*e)).collect();
        Ok(statistics::drms(&horizontal, &down_m))
    }
}

metric! {
    /// root mean square error of the velocity north
    RMS_VN = "rms_vn", unit "m/s", pool Rms, better Lower, needs [TrackVelocity, Velocity], uses [Bound];
    |line| velocity_error(line, 0)
}

metric! {
    /// root mean square error of the velocity east
    RMS_VE = "rms_ve", unit "m/s", pool Rms, better Lower, needs [TrackVelocity, Velocity], uses [Bound];
    |line| velocity_error(line, 1)
}

metric! {
    /// root mean square error of the velocity down
    RMS_VD = "rms_vd", unit "m/s", pool Rms, better Lower, needs [TrackVelocity, Velocity], uses [Bound];
    |line| velocity_error(line, 2)
}

metric! {
    /// root mean square error of the ground speed
    RMS_SPEED = "rms_speed", unit "m/s", pool Rms, better Lower, needs [TrackVelocity, Velocity], uses [Bound];
    |line| {
        let [track, truth] = [ScoreSource::TrackVelocity, ScoreSource::Velocity].map(|source| line.columns(source));
        let (track, truth) = (track?, truth?);
        let speed = |v: &[&[f64]], i: usize| v[0][i].hypot(v[1][i]);
        let error = |i: usize| speed(&track, i) - speed(&truth, i);
        Ok(statistics::rms(&line.unless_bound((0..truth[0].len()).map(error).collect())))
    }
}

metric! {
    /// `drms` of the INS alone, the baseline of the filter
    INS_DRMS = "ins_drms", unit "m", pool Rms, better Neither,
    shown MetricDisplay::column(90, 140), needs [Position, Ins];
    |line| {
        let e = line.offsets(line.named(ScoreSource::Ins, "ins_lat")?, line.named(ScoreSource::Ins, "ins_lon")?)?;
        Ok(statistics::drms(&e.north_m, &e.east_m))
    }
}

metric! {
    /// mean normalised estimation error squared e'P^-1e of the horizontal position; 2 for a consistent filter, more for
    /// an overconfident one, less for a cautious one
    NEES = "nees", unit "1", pool Mean, better Near(2.0),
    shown MetricDisplay::column(110, 110), limit Factor(10.0), needs [Track, Position], uses [Bound];
    |line| Ok(statistics::mean(&position_nees(line)?))
}

metric! {
    /// mean normalised innovation squared of the measurements that the gate accepted; 1 for a consistent filter, more
    /// for an overconfident one, less for a cautious one
    NIS = "nis", unit "1", pool Mean, better Near(1.0),
    shown MetricDisplay::column(120, 120).rank(70), limit Factor(4.0), needs [Track];
    |line| Ok(statistics::mean(&ungated(line, line.named(ScoreSource::Track, "nis")?)?))
}

metric! {
    /// 1 for a line whose mean `nees` is within its 95 % chi-square band for the number of independent samples, else 0;
    /// 0.95 on average for a consistent filter. The band is too narrow for a line that lasts only a few correlation
    /// times of the error
    NEES_CONSISTENT = "nees_consistent", unit "1", pool Mean, better Higher,
    needs [Track, Position], uses [Bound];
    |line| Ok(consistency::within_chi_square_band(&position_nees(line)?, 2.0))
}

metric! {
    /// 1 for a line whose mean `nis` is within its 95 % chi-square band for the number of independent samples, else 0;
    /// 0.95 on average for a consistent filter
    NIS_CONSISTENT = "nis_consistent", unit "1", pool Mean, better Higher, needs [Track];
    |line| {
        Ok(consistency::within_chi_square_band(&ungated(line, line.named(ScoreSource::Track, "nis")?)?, 1.0))
    }
}

metric! {
    /// share of the autocorrelations of the normalised innovations, at lags of 1 to 20 samples, that are within
    /// 1.96/sqrt(n) of 0; 0.95 on average for white innovations, less for correlated ones
    WHITENESS = "whiteness", unit "1", pool Mean, better Near(0.95), limit AtLeast(0.8), needs [Innovations];
    |line| Ok(consistency::whiteness(&normalised_innovations(line)?, 20))
}

metric! {
    /// `nis` multiplied by the statistical inefficiency of the innovations (1 plus twice the sum of their
    /// autocorrelations). If the assumed noise is increased for correlated innovations, the value is near 1
    /// although `whiteness` is low. A value above 1 means that the covariance of the position is too small
    CORRELATED_NIS = "correlated_nis", unit "1", pool Mean, better Near(1.0), limit AtMost(1.5), needs [Innovations];
    |line| Ok(consistency::correlated_nis(&normalised_innovations(line)?))
}

metric! {
    /// share of the samples whose true position is within the track's three-sigma ellipse; 0.989 for a consistent
    /// filter
    ERROR_WITHIN_3SIGMA = "error_within_3sigma", unit "1", pool Mean, better Near(0.989),
    needs [Track, Position], uses [Bound];
    |line| Ok(share(&position_nees(line)?, |nees| nees <= 9.0))
}

metric! {
    /// fraction of the samples whose true position is outside the track's five-sigma ellipse, which indicates an
    /// undetected loss of position; 0.000004 for a consistent filter
    DIVERGENCE = "divergence", unit "1", pool Mean, better Lower,
    needs [Track, Position], uses [Bound];
    |line| Ok(share(&position_nees(line)?, |nees| nees > 25.0))
}

metric! {
    /// number of measurements that the filter used
    SAMPLES_USED = "samples_used", unit "1", pool Sum, better Neither, needs [Track];
    |line| count(line, UpdateOutcome::Used)
}

metric! {
    /// number of samples without a measurement
    SAMPLES_MISSING = "samples_missing", unit "1", pool Sum, better Neither, needs [Track];
    |line| count(line, UpdateOutcome::Missing)
}

metric! {
    /// number of samples off the map or in a cell with an unknown node
    SAMPLES_OFF_MAP = "samples_off_map", unit "1", pool Sum, better Neither, needs [Track];
    |line| count(line, UpdateOutcome::OffMap)
}

metric! {
    /// number of measurements that the innovation gate rejected
    SAMPLES_GATED = "samples_gated", unit "1", pool Sum, better Neither, needs [Track];
    |line| count(line, UpdateOutcome::Gated)
}

metric! {
    /// number of samples where the map is too flat to observe the position (`flat_over_m` of `navigate`)
    SAMPLES_FLAT = "samples_flat", unit "1", pool Sum, better Neither, needs [Track, Slope];
    |line| count(line, UpdateOutcome::Flat)
}

metric! {
    /// number of GNSS positions that the test against the INS rejected
    GNSS_REJECTED = "gnss_rejected", unit "1", pool Sum, better Neither, needs [Gnss];
    |line| {
        let updates = line.texts(ScoreSource::Gnss)?;
        let of = |word: GnssOutcome| updates.iter().filter(|update| *update == Some(word.word())).count();
        let rejected = of(GnssOutcome::Rejected);
        Ok(SampleStatistic { value: rejected as f64, n: rejected + of(GnssOutcome::Used) })
    }
}

/// Normalised estimation error squared of the horizontal position of each sample.
fn position_nees(line: &ScoreLine) -> Result<Vec<f64>, Fault> {
    let (e, of_track) = (line.track_error()?, |name| line.named(ScoreSource::Track, name));
    let (sd_n, sd_e, cov_ne) = (of_track("sd_n")?, of_track("sd_e")?, of_track("cov_ne")?);
    Ok(statistics::position_nees(&e.north_m, &e.east_m, sd_n, sd_e, cov_ne))
}

/// Sorted samples. A radius is a quantile of these samples.
fn radii<'l>(line: &'l ScoreLine) -> Result<&'l [f64], Fault> {
    line.radii()
}

/// Radius about the truth that contains a fraction of the samples.
fn radius(line: &ScoreLine, part: f64) -> Result<SampleStatistic, Fault> {
    let radii = line.radii()?;
    Ok(SampleStatistic { value: statistics::quantile(radii, part), n: radii.len() })
}

/// Height of the track minus the true height, in metres.
fn down_error(line: &ScoreLine) -> Result<Vec<f64>, Fault> {
    let (track, truth) = (line.named(ScoreSource::Track, "alt")?, line.column(ScoreSource::Height)?);
    Ok(line.unless_bound(track.iter().zip(truth).map(|(track, truth)| track - truth).collect()))
}

/// Error of one component of the velocity: north, east or down.
fn velocity_error(line: &ScoreLine, component: usize) -> Result<SampleStatistic, Fault> {
    let (track, truth) = (line.columns(ScoreSource::TrackVelocity)?, line.columns(ScoreSource::Velocity)?);
    let error = track[component].iter().zip(truth[component]).map(|(track, truth)| track - truth);
    Ok(statistics::rms(&line.unless_bound(error.collect())))
}

/// Innovations divided by their predicted standard deviations, without rejected measurements.
fn normalised_innovations(line: &ScoreLine) -> Result<Vec<f64>, Fault> {
    let of = |name| line.named(ScoreSource::Innovations, name);
    ungated(line, &consistency::normalised_innovations(of("residual")?, of("nis")?))
}

/// Values, with NaN where the gate rejected the measurement.
fn ungated(line: &ScoreLine, values: &[f64]) -> Result<Vec<f64>, Fault> {
    let gated = |word: Option<&str>| word == Some(UpdateOutcome::Gated.word());
    let known = |(value, word): (&f64, Option<&str>)| if gated(word) { f64::NAN } else { *value };
    Ok(values.iter().zip(line.updates()?).map(known).collect())
}

/// Fraction of the finite values that satisfy `so`.
fn share(values: &[f64], so: fn(f64) -> bool) -> SampleStatistic {
    let known = || values.iter().filter(|x| x.is_finite());
    let n = known().count();
    SampleStatistic { value: known().filter(|x| so(**x)).count() as f64 / n as f64, n }
}

/// Number of samples with this `update`.
fn count(line: &ScoreLine, update: UpdateOutcome) -> Result<SampleStatistic, Fault> {
    let updates = line.updates()?;
    let n = updates.iter().filter(|word| *word == Some(update.word())).count();
    Ok(SampleStatistic { value: n as f64, n: updates.len() })
}

#[cfg(test)]
mod tests {
    use numerics::random::NormalGenerator;

    use super::*;
    use crate::score::testing::{ScoreTestColumns, TRUE_POSITION, seconds, track, value};

    /// A flight along the equator. The INS error is half the track error: 0.001 deg north and 0.002 deg east.
    fn tables() -> [ScoreTestColumns; 2] {
        let truth = vec![
            (TRUE_POSITION[0], seconds(10, |_| 0.0)),
            (TRUE_POSITION[1], seconds(10, |t| 0.001 * t)),
            ("ins_lat", seconds(10, |_| 0.0005)),
            ("ins_lon", seconds(10, |t| 0.001 * t + 0.001)),
        ];
        [truth, track(seconds(10, |_| 0.001), seconds(10, |t| 0.001 * t + 0.002))]
    }

    #[test]
    fn law_the_drms_of_a_constant_offset_is_its_length() {
        let tables = tables();
        let [north, east, both, ins] = [RMS_NORTH, RMS_EAST, DRMS, INS_DRMS].map(|m| value(&m, &tables));
        // On the WGS-84 equator a degree is 110.574 km north and 111.320 km east.
        assert!((north.value - 110.574).abs() < 0.001 && (east.value - 222.639).abs() < 0.001, "{north:?} {east:?}");
        assert!((both.value - north.value.hypot(east.value)).abs() < 1e-9 && both.n == 10);
        assert!((ins.value - both.value / 2.0).abs() < 1e-3, "{ins:?}");
    }

    #[test]
    fn law_constant_offsets_give_vertical_spherical_and_velocity_errors() {
        let mut tables = tables();
        tables[0].push(("true alt", seconds(10, |_| 260.0)));
        tables[0].extend([("true vn", 30.0), ("true ve", 40.0), ("true vd", 1.0)].map(|(n, v)| (n, vec![v; 10])));
        tables[1].extend([("vn", 33.0), ("ve", 44.0), ("vd", -1.0)].map(|(n, v)| (n, vec![v; 10])));
        let all = [RMS_DOWN, MRSE, RMS_VN, RMS_VE, RMS_VD, RMS_SPEED].map(|m| value(&m, &tables));
        assert!(all.iter().all(|f| f.n == 10), "{all:?}");
        // The track is 40 m too high. Its speed over ground is 55 m/s (33 and 44 m/s); the true speed is 50 m/s.
        let horizontal = value(&DRMS, &tables).value;
        let law = [40.0, horizontal.hypot(40.0), 3.0, 4.0, 2.0, 5.0];
        assert!(all.iter().zip(law).all(|(f, law)| (f.value - law).abs() < 1e-9), "{all:?}");
    }

    #[test]
    fn unit_gated_measurements_are_not_in_the_nis() {
        let mut tables = tables();
        // The updates repeat every ten samples. The fourth update is `gated`, and its innovation is an outlier.
        let nis = seconds(10, |t| if [3.0, 7.0].contains(&t) { 900.0 } else { 0.5 });
        tables[1].iter_mut().filter(|column| column.0 == "nis").for_each(|column| column.1 = nis.clone());
        tables[1].push(("residual", vec![1.0; 10]));
        assert_eq!(value(&NIS, &tables), SampleStatistic { value: 0.5, n: 8 });
        assert_eq!(value(&SAMPLES_GATED, &tables), SampleStatistic { value: 2.0, n: 10 });
    }

    #[test]
    fn unit_a_bound_has_no_error() {
        let mut tables = tables();
        tables[1].push(("drms_bound", vec![7.0; 10]));
        assert_eq!(value(&DRMS_BOUND, &tables), SampleStatistic { value: 7.0, n: 10 });
        let errors = [DRMS, CEP, R95, RMS_NORTH, RMS_EAST, NEES].map(|m| value(&m, &tables));
        assert!(errors.iter().all(|f| f.value.is_nan() && f.n == 0), "{errors:?}");
        assert!(value(&INS_DRMS, &tables).value > 0.0);
    }

    #[test]
    fn law_one_standard_deviation_in_each_direction_is_a_nees_of_two() {
        let mut tables = tables();
        let (north, east) = (value(&RMS_NORTH, &tables).value, value(&RMS_EAST, &tables).value);
        for (name, column) in &mut tables[1] {
            match *name {
                "sd_n" => column.fill(north),
                "sd_e" => column.fill(east),
                _ => {}
            }
        }
        assert!((value(&NEES, &tables).value - 2.0).abs() < 1e-9);
        // Two of the ten samples are gated.
        assert_eq!(value(&NIS, &tables), SampleStatistic { value: 0.5, n: 8 });
    }

    /// A track of `n` samples along the equator with these errors north in m and a standard deviation of 10 m in each
    /// direction.
    fn erring(n: u32, north_m: impl Fn(f64) -> f64) -> [ScoreTestColumns; 2] {
        let truth = vec![(TRUE_POSITION[0], seconds(n, |_| 0.0)), (TRUE_POSITION[1], seconds(n, |t| 1e-5 * t))];
        [truth, track(seconds(n, |t| north_m(t) / 110_574.3), seconds(n, |t| 1e-5 * t))]
    }

    #[test]
    fn law_radii_and_shares_of_a_ramp_are_exact() {
        // The errors are 0, 1, ... 100 m. Half of them are at most 50 m, and 95 % are at most 95 m. 31 errors are
        // within three standard deviations (30 m), and 50 are outside five (50 m).
        let ramp = erring(101, |t| t);
        assert!((value(&CEP, &ramp).value - 50.0).abs() < 1e-3 && (value(&R95, &ramp).value - 95.0).abs() < 1e-3);
        let (within, lost) = (value(&ERROR_WITHIN_3SIGMA, &ramp), value(&DIVERGENCE, &ramp));
        assert!((30.0..=31.0).contains(&(within.value * 101.0)), "{within:?}");
        assert!((50.0..=51.0).contains(&(lost.value * 101.0)), "{lost:?}");
        let mut gap = ramp;
        gap[1][0].1[70] = f64::NAN;
        assert_eq!([CEP, R95, ERROR_WITHIN_3SIGMA, DIVERGENCE].map(|m| value(&m, &gap).n), [100; 4]);
    }

    /// Consistency of the position and of the innovations, whiteness, shares within three and beyond five standard
    /// deviations, and `correlated_nis`: each as the mean of twenty tracks. The errors of the tracks are `scale` times
    /// their standard deviations, with correlated or white innovations.
    fn of_tracks(scale: f64, correlated: bool) -> [f64; 6] {
        let mut sums = [0.0; 6];
        for seed in 0..20 {
            let mut normals = NormalGenerator::new(seed);
            let drawn: Vec<[f64; 3]> = (0..1000).map(|_| [normals.draw(), normals.draw(), normals.draw()]).collect();
            let [truth, mut track] = erring(1000, |t| 10.0 * scale * drawn[t as usize][0]);
            track[1].1 = seconds(1000, |t| 1e-5 * t + 10.0 * scale * drawn[t as usize][1] / 111_319.5);
            let mut before = 0.0;
            let innovations: Vec<f64> = drawn
                .iter()
                .map(|d| {
                    before = if correlated { 0.9 * before + 0.19f64.sqrt() * d[2] } else { d[2] };
                    scale * before
                })
                .collect();
            let nis = track.iter_mut().filter(|column| column.0 == "nis");
            nis.for_each(|column| column.1 = innovations.iter().map(|i| i * i).collect());
            track.push(("residual", innovations.iter().map(|i| 2.0 * i).collect()));
            let tables = [truth, track];
            let metrics = [NEES_CONSISTENT, NIS_CONSISTENT, WHITENESS, ERROR_WITHIN_3SIGMA, DIVERGENCE, CORRELATED_NIS];
            sums.iter_mut().zip(metrics).for_each(|(sum, metric)| *sum += value(&metric, &tables).value / 20.0);
        }
        sums
    }

    #[test]
    fn law_consistency_separates_consistent_and_overconfident_tracks() {
        let [nees, nis, white, within, lost, of_averages] = of_tracks(1.0, false);
        // At 95 %, one of twenty tests fails on average; more than five fail with a probability of 1/3000.
        assert!(nees >= 0.75 && nis >= 0.75, "{nees} {nis}");
        // The standard deviation of the whiteness over 400 lags is 1.1 %. The standard deviation of the share 0.989
        // over 20,000 samples is 0.07 %.
        assert!(
            (white - 0.95).abs() < 0.05 && (within - 0.989).abs() < 0.004 && lost < 1e-3,
            "{white} {within} {lost}"
        );
        // The estimated inefficiency of white noise is 1.02 to 1.07 on average.
        assert!((of_averages - 1.0).abs() < 0.15, "{of_averages}");
        let [nees, nis, white, within, lost, of_averages] = of_tracks(3.0, false);
        assert_eq!([nees, nis], [0.0, 0.0]);
        assert!((of_averages / 9.0 - 1.0).abs() < 0.15, "{of_averages}");
        assert!((white - 0.95).abs() < 0.05, "whiteness is of the order, not of the size: {white}");
        // If the standard deviation is a third of the true one, a fraction exp(-9/18) of the errors is outside three
        // standard deviations, and a fraction exp(-25/18) is outside five.
        assert!((1.0 - within - (-0.5f64).exp()).abs() < 0.02 && (lost - (-25.0f64 / 18.0).exp()).abs() < 0.02);
        // With a decay of the autocorrelation by 0.9 per sample, the inefficiency is (1 + 0.9)/(1 - 0.9) = 19, with a
        // standard error of 10 %. The same innovations are consistent if they are small enough.
        let [.., white, _, _, of_averages] = of_tracks(1.0, true);
        assert!(white < 0.5 && (of_averages / 19.0 - 1.0).abs() < 0.35, "{white} {of_averages}");
        let [.., white, _, _, of_averages] = of_tracks(19f64.sqrt().recip(), true);
        assert!(white < 0.5 && (of_averages - 1.0).abs() < 0.35, "{white} {of_averages}");
    }

    #[test]
    fn unit_every_sample_has_one_outcome() {
        let counted = [SAMPLES_USED, SAMPLES_MISSING, SAMPLES_OFF_MAP, SAMPLES_GATED, SAMPLES_FLAT];
        let mut tables = tables();
        tables[1].push(("map_slope", vec![0.1; 10]));
        let counted = counted.map(|m| value(&m, &tables));
        assert_eq!(counted.map(|f| f.value), [3.0, 2.0, 2.0, 2.0, 1.0]);
        assert!(counted.iter().all(|f| f.n == 10));
        let rejected = value(&GNSS_REJECTED, &tables);
        assert_eq!((rejected.value, rejected.n), (2.0, 4));
    }
}
