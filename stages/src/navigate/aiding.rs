//! Aiding positions from a GNSS receiver.

use std::sync::Arc;

use arrow_array::{ArrayRef, StringArray};
use numerics::{
    navigation::{fix_test, position_fixes::PositionFixes},
    random::NormalGenerator,
};
use schemas::{Column, Fault, Role, Rule, TableShape, choice, params};

use super::filter::{FilterFlight, FilterInput};
use super::start::gnss_columns;
use crate::columns::{data, floats, role_of};

params! {
    /// GNSS positions that aid a filter in addition to the magnetic field.
    pub struct Aiding;
    /// Times at which GNSS is lost and recovered, in seconds from the first sample of the line. Before the loss and
    /// after the recovery, the GNSS position (columns `gnss`) aids the filter. With `[0.0, 600.0]`, GNSS is missing for
    /// the first ten minutes of the line. If the recovery time is after the end of the line, GNSS is never recovered.
    gnss_lost_s: Option<[f64; 2]>, unit "s", absent "GNSS is not used", rule Rule::NotNegative;
    /// Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid (m).
    gnss: Option<[String; 3]>, unit "",
        absent "`gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`, `lon` and `alt`";
    /// Time between successive GNSS positions.
    gnss_interval_s: f64, unit "s", default 1.0, rule Rule::Positive;
    /// Standard deviation of the GNSS position along each horizontal axis.
    gnss_sigma_m: f64, unit "m", default 2.0, rule Rule::Positive;
    /// Standard deviation of the GNSS height.
    gnss_alt_sigma_m: f64, unit "m", default 5.0, rule Rule::Positive;
    /// Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and `gnss_alt_sigma_m`. The
    /// added noise of a line is the same in every run. True positions have no error: without added noise, the filter
    /// appears more accurate than with real GNSS.
    gnss_noise: Option<bool>, unit "", absent "true if the columns of `gnss` have the role `truth`";
    /// Tests each GNSS position against the INS position and does not use rejected positions. A chi-square test of each
    /// position detects a jump at once. A cumulative sum over earlier positions detects a drift of 1 m/s after about 10
    /// s. The test then also rejects the positions since the start of the drift. Positions are accepted again after ten
    /// consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected` or `none`) is appended
    /// even if this key is false.
    gnss_test: bool, unit "", default true;
}

choice! {
    /// Outcome of a GNSS position.
    pub enum GnssOutcome {
        /// Used by the filter.
        Used = "used",
        /// Position or height rejected by the test.
        Rejected = "rejected",
        /// No position.
        None = "none",
    }
}

/// GNSS positions along a line.
#[derive(Clone)]
pub struct GnssPositions {
    /// Positions that passed the test.
    pub accepted: PositionFixes,
    /// Outcome at each sample.
    updates: Vec<GnssOutcome>,
}

impl GnssPositions {
    /// Values of the column that [`Aiding::columns`] declares.
    pub(super) fn array(&self) -> ArrayRef {
        Arc::new(self.updates.iter().map(|update| Some(update.word())).collect::<StringArray>())
    }
}

/// Column with the outcome for each position.
pub(crate) const GNSS_UPDATE: &str = "gnss_update";

impl Aiding {
    /// Columns that are read.
    pub(super) fn reads(&self, flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        let Some([lost_s, found_s]) = self.gnss_lost_s else { return Ok(vec![]) };
        let mut faults = vec![];
        if lost_s > found_s {
            let what = format!("GNSS is lost at {lost_s} s but recovered earlier, at {found_s} s");
            faults.push(Fault::new(what).of_param("gnss_lost_s"));
        }
        let columns = gnss_columns(self.gnss.as_ref(), flight.shape);
        for (column, unit) in columns.iter().zip(["deg", "deg", "m"]) {
            faults.extend(flight.shape.number(column, unit).err().map(|fault| fault.of_param("gnss")));
        }
        if faults.is_empty() { Ok(columns.to_vec()) } else { Err(faults) }
    }

    /// Fault of a key that has no effect.
    pub(super) fn unused_key(&self, key: &str) -> Option<Fault> {
        let of_gnss = ["gnss", "gnss_interval_s", "gnss_sigma_m", "gnss_alt_sigma_m", "gnss_noise", "gnss_test"];
        let idle = self.gnss_lost_s.is_none() && of_gnss.contains(&key);
        idle.then(|| Fault::new(format!("`{key}` has no effect without `gnss_lost_s`")))
    }

    /// Columns that the aiding appends.
    pub(super) fn columns(&self) -> Vec<Column> {
        let column = || Column::text(GNSS_UPDATE, "outcome of the GNSS position: used, rejected or none");
        self.gnss_lost_s.map(|_| column()).into_iter().collect()
    }

    /// Tested positions along the line.
    pub(super) fn gnss(&self, flown: &FilterInput) -> Result<Option<GnssPositions>, Fault> {
        let Some(fixes) = self.fixes(flown)? else { return Ok(None) };
        let there = |row: usize| fixes.lat_deg[row].is_finite() && fixes.lon_deg[row].is_finite();
        let mut updates: Vec<GnssOutcome> =
            (0..flown.ins.len()).map(|row| if there(row) { GnssOutcome::Used } else { GnssOutcome::None }).collect();
        if !self.gnss_test {
            return Ok(Some(GnssPositions { accepted: fixes, updates }));
        }
        let tested = fix_test::run(&flown.ins, &flown.errors, &fixes).map_err(data)?;
        let rejected = updates.iter_mut().zip(&tested.rejected).filter(|(_, rejected)| **rejected);
        rejected.for_each(|(update, _)| *update = GnssOutcome::Rejected);
        Ok(Some(GnssPositions { accepted: tested.accepted, updates }))
    }

    fn fixes(&self, flown: &FilterInput) -> Result<Option<PositionFixes>, Fault> {
        let Some([lost_s, found_s]) = self.gnss_lost_s else { return Ok(None) };
        let shape = TableShape::from_schema(&flown.columns.schema());
        let names = gnss_columns(self.gnss.as_ref(), &shape);
        let [lat, lon, alt] = names.each_ref().map(|column| floats(flown.columns, column));
        let columns = [lat?, lon?, alt?];
        let mut fixes = PositionFixes {
            lat_deg: vec![f64::NAN; flown.ins.len()],
            lon_deg: vec![f64::NAN; flown.ins.len()],
            alt_m: vec![f64::NAN; flown.ins.len()],
            horizontal_sigma_m: self.gnss_sigma_m,
            vertical_sigma_m: self.gnss_alt_sigma_m,
        };
        let first_s = flown.ins.tt_s.first().copied().unwrap_or_default();
        let noisy = self.gnss_noise.unwrap_or_else(|| role_of(&shape, &names) == Role::Truth);
        let mut normals =
            NormalGenerator::new(flown.ins.lat_deg.first().map_or(0, |lat| lat.to_bits()) ^ first_s.to_bits());
        let (mut due_s, mut expected, mut found) = (0.0, 0_usize, 0_usize);
        for (row, tt_s) in flown.ins.tt_s.iter().enumerate() {
            let at_s = tt_s - first_s;
            // Half a microsecond allows for the rounding of time stamps.
            if at_s < due_s - 5e-7 || (lost_s..found_s).contains(&at_s) {
                continue;
            }
            expected += 1;
            let [lat, lon, alt] = columns.map(|column| column[row]);
            if lat.is_finite() && lon.is_finite() {
                let [north, east, up] = if noisy { [normals.draw(), normals.draw(), normals.draw()] } else { [0.0; 3] };
                let (north_m, east_m) = flown.errors.earth.north_east_m_per_rad(lat.to_radians(), flown.ins.alt_m[row]);
                fixes.lat_deg[row] = lat + (self.gnss_sigma_m * north / north_m).to_degrees();
                fixes.lon_deg[row] = lon + (self.gnss_sigma_m * east / east_m).to_degrees();
                fixes.alt_m[row] = alt + self.gnss_alt_sigma_m * up;
                due_s = at_s + self.gnss_interval_s;
                found += 1;
            }
        }
        if expected > 0 && found == 0 {
            let what = format!("while GNSS is available, none of the {expected} samples has a position");
            return Err(Fault::data(what)
                .in_column(&names[0])
                .help("set `gnss` to the columns of GNSS, or remove `gnss_lost_s`"));
        }
        Ok(Some(fixes))
    }
}

/// Union of the columns that two parts of a filter read.
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
    fn unit_gnss_bounds_the_error_of_every_aided_filter_until_its_loss() {
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
    fn unit_gnss_has_its_own_rate() {
        let fixes = |interval: &str| {
            let keys = format!("gnss_lost_s = [100.0, 200.0]\ngnss_interval_s = {interval}\nmag = 'mag_1_c'");
            run("ins_only", &keys).numbers("sd_n")
        };
        let (dense, sparse) = (fixes("1.0"), fixes("50.0"));
        // GNSS positions every second or every 50 s, none between 100 and 200 s.
        let falls = |sd: &[f64]| (1..ROWS).filter(|row| sd[*row] < sd[row - 1] - 1e-3).collect::<Vec<_>>();
        assert!(falls(&sparse).iter().all(|row| row % 50 == 0) && falls(&sparse).contains(&50), "{:?}", falls(&sparse));
        assert!(falls(&sparse).iter().chain(&falls(&dense)).all(|row| !(100..200).contains(row)));
        assert!(dense[99] < sparse[99]);
    }

    #[test]
    fn unit_drifting_gnss_is_rejected_in_every_aided_filter() {
        let drawn = with(&flight(), "lat", |row, lat| lat + (row as f64 - 300.0).max(0.0) / 111_130.0);
        let keys = "mag = 'mag_1_c'\ngnss_lost_s = [1e6, 1e6]\ngnss_sigma_m = 2.0";
        for filter in ["ekf", "ins_only", "ukf", "ekf_adaptive", "fixed_lag"] {
            let own = if filter == "fixed_lag" { "\naircraft_sigma_nt = 0.0" } else { "" };
            let found = flown(filter, &format!("{keys}{own}"), &drawn).unwrap();
            let updates = found.words("gnss_update");
            let first = updates.iter().position(|word| word == "rejected").unwrap();
            assert!((300..312).contains(&first), "{filter}: {first}");
            assert!(updates[312..].iter().all(|word| word == "rejected"), "{filter}");
            let taken = flown(filter, &format!("{keys}{own}\ngnss_test = false"), &drawn).unwrap();
            assert!(taken.words("gnss_update").iter().all(|word| word == "used"), "{filter}");
            let (held_m, taken_m) = (found.error_m(ROWS - 1), taken.error_m(ROWS - 1));
            assert!(held_m < 60.0 && taken_m > 200.0, "{filter}: {held_m} {taken_m}");
        }
        assert!(!run("ekf", "mag = 'mag_1_c'").has("gnss_update"));
    }

    #[test]
    fn unit_requested_noise_is_added() {
        let keys = "mag = 'mag_1_c'\ngnss_lost_s = [1e6, 1e6]\ngnss_sigma_m = 2.0";
        let of = |more: &str| run("ins_only", &format!("{keys}{more}")).numbers("lat");
        let (none, some) = (of(""), of("\ngnss_noise = true"));
        assert_eq!(some, of("\ngnss_noise = true"), "the same of one line");
        let off = none.iter().zip(&some).map(|(a, b)| (111_130.0 * (a - b)).abs()).fold(0.0, f64::max);
        assert!((0.3..10.0).contains(&off), "{off}");
    }

    #[test]
    fn unit_gnss_without_a_position_is_an_error() {
        let blind = with(&flight(), "lat", |_, _| f64::NAN);
        let fault = flown("ekf", "mag = 'mag_1_c'\ngnss_lost_s = [300.0, 1e6]", &blind).unwrap_err();
        assert!(fault.what.contains("none of the 300 samples has a position"), "{fault:?}");
        // After a loss at the first sample no fixes are expected.
        assert!(flown("ekf", "mag = 'mag_1_c'\ngnss_lost_s = [0.0, 1e6]", &blind).is_ok());
    }

    #[test]
    fn unit_lists_are_merged_and_all_faults_are_reported() {
        let of = |names: &[&str]| Ok(names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        assert_eq!(both(of(&["a", "b"]), of(&["b", "c"])).unwrap(), ["a", "b", "c"]);
        let fault = |what: &str| Err(vec![Fault::new(what)]);
        assert_eq!(both(fault("one"), fault("other")).unwrap_err().len(), 2);
        assert_eq!(both(fault("one"), of(&["a"])).unwrap_err().len(), 1);
    }
}
