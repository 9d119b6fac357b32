//! Positions from a GNSS receiver or a barometer, as a filter takes them.

use numerics::navigation::position_fixes::PositionFixes;
use schemas::{Fault, Rule, params};

use super::filter::{Flight, Flown};
use crate::columns::floats;

params! {
    /// Positions that aid a filter beside the magnetic field.
    pub struct Aiding;
    /// When GNSS is lost and found again, in seconds from the first sample of the line: before and after, the position in
    /// the columns of `gnss` aids the filter. `[0.0, 600.0]` is a flight whose GNSS comes after ten minutes; an end beyond
    /// the line's is a loss for good.
    gnss_lost_s: Option<[f64; 2]>, unit "s", absent "GNSS is not used", rule Rule::NotNegative;
    /// Latitude, longitude and height above the ellipsoid by GNSS. The noise of `gnss_sigma_m` is expected of them, and not
    /// added.
    gnss: [String; 3], unit "", default ["lat", "lon", "alt"].map(str::to_owned);
    /// Time from one position by GNSS to the next.
    gnss_interval_s: f64, unit "s", default 1.0, rule Rule::Positive;
    /// One sigma of the position by GNSS, north and east each.
    gnss_sigma_m: f64, unit "m", default 2.0, rule Rule::Positive;
    /// One sigma of the height by GNSS.
    gnss_alt_sigma_m: f64, unit "m", default 5.0, rule Rule::Positive;
}

impl Aiding {
    /// The columns that are read.
    pub(super) fn reads(&self, flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
        let Some([lost_s, found_s]) = self.gnss_lost_s else { return Ok(vec![]) };
        let mut faults = vec![];
        if lost_s > found_s {
            let what = format!("GNSS is lost at {lost_s} s, after it is found at {found_s} s");
            faults.push(Fault::new(what).of_param("gnss_lost_s"));
        }
        for (column, unit) in self.gnss.iter().zip(["deg", "deg", "m"]) {
            faults.extend(flight.shape.number(column, unit).err().map(|fault| fault.of_param("gnss")));
        }
        if faults.is_empty() { Ok(self.gnss.to_vec()) } else { Err(faults) }
    }

    /// Why a key has no say.
    pub(super) fn idle(&self, key: &str) -> Option<Fault> {
        let of_gnss = ["gnss", "gnss_interval_s", "gnss_sigma_m", "gnss_alt_sigma_m"];
        let idle = self.gnss_lost_s.is_none() && of_gnss.contains(&key);
        idle.then(|| Fault::new(format!("`{key}` has no say without `gnss_lost_s`")))
    }

    /// The positions along the line.
    pub(super) fn fixes(&self, flown: &Flown) -> Result<Option<PositionFixes>, Fault> {
        let Some([lost_s, found_s]) = self.gnss_lost_s else { return Ok(None) };
        let [lat, lon, alt] = self.gnss.each_ref().map(|column| floats(flown.columns, column));
        let columns = [lat?, lon?, alt?];
        let mut fixes = PositionFixes {
            lat_deg: vec![f64::NAN; flown.ins.len()],
            lon_deg: vec![f64::NAN; flown.ins.len()],
            alt_m: vec![f64::NAN; flown.ins.len()],
            horizontal_sigma_m: self.gnss_sigma_m,
            vertical_sigma_m: self.gnss_alt_sigma_m,
        };
        let first_s = flown.ins.tt_s.first().copied().unwrap_or_default();
        let (mut due_s, mut expected, mut found) = (0.0, 0_usize, 0_usize);
        for (row, tt_s) in flown.ins.tt_s.iter().enumerate() {
            let at_s = tt_s - first_s;
            // Half a microsecond takes up the rounding of time stamps.
            if at_s < due_s - 5e-7 || (lost_s..found_s).contains(&at_s) {
                continue;
            }
            expected += 1;
            let [lat, lon, alt] = columns.map(|column| column[row]);
            if lat.is_finite() && lon.is_finite() {
                (fixes.lat_deg[row], fixes.lon_deg[row], fixes.alt_m[row]) = (lat, lon, alt);
                due_s = at_s + self.gnss_interval_s;
                found += 1;
            }
        }
        if expected > 0 && found == 0 {
            let what = format!("while GNSS is there, none of the {expected} samples has a position by it");
            return Err(Fault::data(what)
                .in_column(&self.gnss[0])
                .help("are these its columns? leave `gnss_lost_s` out"));
        }
        Ok(Some(fixes))
    }
}

/// What two parts of a filter read, each column once.
pub(super) fn both(
    one: Result<Vec<String>, Vec<Fault>>,
    other: Result<Vec<String>, Vec<Fault>>,
) -> Result<Vec<String>, Vec<Fault>> {
    match (one, other) {
        (Ok(mut one), Ok(other)) => {
            one.extend(other.into_iter().filter(|column| !one.contains(column)).collect::<Vec<_>>());
            Ok(one)
        }
        (Err(mut one), Err(other)) => {
            one.extend(other);
            Err(one)
        }
        (Err(faults), Ok(_)) | (Ok(_), Err(faults)) => Err(faults),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::navigate::testing::*;

    #[test]
    fn law_every_filter_that_gnss_aids_holds_the_position_until_it_is_lost() {
        let keys = "mag = 'mag_1_c'\ngnss_lost_s = [300.0, 1e6]\ngnss_sigma_m = 2.0\ngnss_interval_s = 5.0";
        for filter in ["ekf", "iekf", "ukf", "ekf_adaptive", "rts", "mpf", "fixed_lag", "ekf_online_tl"] {
            let own = match filter {
                "ekf_online_tl" => "\nwalk_per_hour = 0.0",
                "fixed_lag" => "\naircraft_sigma_nt = 0.0",
                _ => "",
            };
            let found = run(filter, &format!("{keys}{own}"));
            let worst = (20..300).map(|row| found.error_m(row)).fold(0.0, f64::max);
            assert!(worst < 5.0, "{filter}: {worst}");
            let sd = found.numbers("sd_n");
            assert!(sd[295] < 2.0 && sd[ROWS - 1] > sd[295], "{filter}: {} {}", sd[295], sd[ROWS - 1]);
        }
    }

    #[test]
    fn law_gnss_comes_at_its_own_rate() {
        let fixes = |interval: &str| {
            let keys = format!("gnss_lost_s = [100.0, 200.0]\ngnss_interval_s = {interval}\nmag = 'mag_1_c'");
            run("ins_only", &keys).numbers("sd_n")
        };
        let (dense, sparse) = (fixes("1.0"), fixes("50.0"));
        // A fix every second or every 50 s, none between 100 and 200 s.
        let falls = |sd: &[f64]| (1..ROWS).filter(|row| sd[*row] < sd[row - 1] - 1e-3).collect::<Vec<_>>();
        assert!(falls(&sparse).iter().all(|row| row % 50 == 0) && falls(&sparse).contains(&50), "{:?}", falls(&sparse));
        assert!(falls(&sparse).iter().chain(&falls(&dense)).all(|row| !(100..200).contains(row)));
        assert!(dense[99] < sparse[99]);
    }

    #[test]
    fn unit_gnss_without_a_position_is_an_error() {
        let blind = with(&flight(), "lat", |_, _| f64::NAN);
        let fault = flown("ekf", "mag = 'mag_1_c'\ngnss_lost_s = [300.0, 1e6]", &blind).unwrap_err();
        assert!(fault.what.contains("none of the 300 samples has a position"), "{fault:?}");
        // Lost from the first sample on there is nothing to expect.
        assert!(flown("ekf", "mag = 'mag_1_c'\ngnss_lost_s = [0.0, 1e6]", &blind).is_ok());
    }

    #[test]
    fn unit_two_lists_are_one_and_all_faults_are_told() {
        let of = |names: &[&str]| Ok(names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        assert_eq!(both(of(&["a", "b"]), of(&["b", "c"])).unwrap(), ["a", "b", "c"]);
        let fault = |what: &str| Err(vec![Fault::new(what)]);
        assert_eq!(both(fault("one"), fault("other")).unwrap_err().len(), 2);
        assert_eq!(both(fault("one"), of(&["a"])).unwrap_err().len(), 1);
    }
}
