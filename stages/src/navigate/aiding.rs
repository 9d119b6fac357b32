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
        let mut due_s = 0.0;
        for (row, tt_s) in flown.ins.tt_s.iter().enumerate() {
            let at_s = tt_s - first_s;
            // Half a microsecond takes up the rounding of time stamps.
            if at_s < due_s - 5e-7 || (lost_s..found_s).contains(&at_s) {
                continue;
            }
            let [lat, lon, alt] = columns.map(|column| column[row]);
            if lat.is_finite() && lon.is_finite() {
                (fixes.lat_deg[row], fixes.lon_deg[row], fixes.alt_m[row]) = (lat, lon, alt);
                due_s = at_s + self.gnss_interval_s;
            }
        }
        Ok(Some(fixes))
    }
}
