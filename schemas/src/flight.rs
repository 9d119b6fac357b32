//! The flight table: one row per sample, sorted by flight, line, tt.
//!
//! Names follow the SGL and MagNav.jl communities; units are canonical.

use crate::{ColumnDescription, Role};

/// The version of the flight table's contract.
pub const VERSION: u32 = 1;

/// The columns that every flight table has.
pub const KEYS: [&str; 3] = ["flight", "line", "tt"];

/// Column with the grade of the INS, and the error sources that differ from this grade.
pub const INS_GRADE: &str = "ins_grade";

/// Columns with the position from a GNSS receiver.
pub const GNSS_POSITION: [&str; 3] = ["gnss_lat", "gnss_lon", "gnss_alt"];

/// Columns with the velocity from a GNSS receiver.
pub const GNSS_VELOCITY: [&str; 3] = ["gnss_vn", "gnss_ve", "gnss_vd"];

const fn d(unit: &'static str, role: Role, description: &'static str) -> ColumnDescription {
    ColumnDescription { unit, role, description }
}

/// The columns with fixed names, in the contract's order.
pub const COLUMNS: &[(&str, ColumnDescription)] = &[
    ("flight", d("", Role::Key, "flight identifier")),
    ("line", d("", Role::Key, "line identifier")),
    ("tt", d("s", Role::Time, "seconds past midnight UTC")),
    ("lat", d("deg", Role::Truth, "GNSS latitude, WGS-84")),
    ("lon", d("deg", Role::Truth, "GNSS longitude, WGS-84")),
    ("alt", d("m", Role::Truth, "GNSS height above the WGS-84 ellipsoid")),
    ("vn", d("m/s", Role::Truth, "velocity north")),
    ("ve", d("m/s", Role::Truth, "velocity east")),
    ("vd", d("m/s", Role::Truth, "velocity down")),
    ("roll", d("deg", Role::Truth, "roll, right wing down positive")),
    ("pitch", d("deg", Role::Truth, "pitch, nose up positive")),
    ("yaw", d("deg", Role::Truth, "yaw, clockwise from true north")),
    (
        "roll_rate",
        d("deg/s", Role::Aux, "angular rate of the body relative to the north-east-down frame, about the nose axis"),
    ),
    (
        "pitch_rate",
        d(
            "deg/s",
            Role::Aux,
            "angular rate of the body relative to the north-east-down frame, about the right-wing axis",
        ),
    ),
    (
        "yaw_rate",
        d("deg/s", Role::Aux, "angular rate of the body relative to the north-east-down frame, about the down axis"),
    ),
    ("msl", d("m", Role::Aux, "height above mean sea level")),
    ("baro", d("m", Role::Aux, "barometric altitude")),
    ("radar", d("m", Role::Aux, "radar altitude above ground")),
    ("topo", d("m", Role::Aux, "ground height from radar altitude and GNSS")),
    ("dem", d("m", Role::Aux, "ground height from an elevation model")),
    ("drape", d("m", Role::Aux, "planned drape surface")),
    ("ins_lat", d("deg", Role::Sensor, "INS latitude")),
    ("ins_lon", d("deg", Role::Sensor, "INS longitude")),
    ("ins_alt", d("m", Role::Sensor, "INS height above the WGS-84 ellipsoid")),
    ("ins_vn", d("m/s", Role::Sensor, "INS velocity north")),
    ("ins_ve", d("m/s", Role::Sensor, "INS velocity east")),
    ("ins_vd", d("m/s", Role::Sensor, "INS velocity down")),
    ("ins_roll", d("deg", Role::Sensor, "INS roll")),
    ("ins_pitch", d("deg", Role::Sensor, "INS pitch")),
    ("ins_yaw", d("deg", Role::Sensor, "INS yaw, clockwise from true north")),
    ("ins_fn", d("m/s2", Role::Sensor, "specific force north, navigation frame")),
    ("ins_fe", d("m/s2", Role::Sensor, "specific force east, navigation frame")),
    ("ins_fd", d("m/s2", Role::Sensor, "specific force down, navigation frame")),
    ("ins_aligned", d("s", Role::Aux, "time of the last alignment of the INS, seconds past midnight UTC")),
    (
        "ins_grade",
        d(
            "",
            Role::Aux,
            "grade of the INS, followed by the error sources whose values differ from this grade, such as `tactical, \
             init_position_sigma_m = 3`",
        ),
    ),
    ("gnss_lat", d("deg", Role::Sensor, "WGS-84 latitude from a GNSS receiver, including the receiver's noise")),
    ("gnss_lon", d("deg", Role::Sensor, "WGS-84 longitude from a GNSS receiver, including the receiver's noise")),
    (
        "gnss_alt",
        d("m", Role::Sensor, "height above the WGS-84 ellipsoid from a GNSS receiver, including the receiver's noise"),
    ),
    ("gnss_vn", d("m/s", Role::Sensor, "north velocity from a GNSS receiver, including the receiver's noise")),
    ("gnss_ve", d("m/s", Role::Sensor, "east velocity from a GNSS receiver, including the receiver's noise")),
    ("gnss_vd", d("m/s", Role::Sensor, "down velocity from a GNSS receiver, including the receiver's noise")),
    ("diurnal", d("nT", Role::Sensor, "temporal variation of the earth's field")),
    ("igrf", d("nT", Role::Sensor, "core-field magnitude")),
    (
        "anomaly_truth",
        d("nT", Role::Truth, "total field anomaly: change of the field magnitude caused by the crustal field"),
    ),
    ("mag_1_c", d("nT", Role::Truth, "compensated tail-stinger magnetometer")),
    ("mag_1_lag", d("nT", Role::Truth, "compensated tail stinger, lag-corrected")),
    ("mag_1_dc", d("nT", Role::Truth, "compensated tail stinger minus diurnal variation")),
    ("mag_1_igrf", d("nT", Role::Truth, "compensated tail stinger minus diurnal variation and core field")),
    ("year", d("", Role::Aux, "calendar year, UTC")),
    ("doy", d("", Role::Aux, "day of the year, UTC; 1 January is 1")),
];

/// Unit, role and meaning of the column `name` of a flight table; unknown columns are auxiliary, without unit.
pub fn describe(name: &str) -> ColumnDescription {
    if let Some((_, known)) = COLUMNS.iter().find(|(n, _)| *n == name) {
        return *known;
    }
    if magnetometer(name, "_uc").is_some() {
        return d("nT", Role::Sensor, "uncompensated scalar magnetometer");
    }
    if magnetometer(name, "_c").is_some() {
        return d("nT", Role::Truth, "compensated scalar magnetometer");
    }
    if name.starts_with("flux_") && [("_x"), ("_y"), ("_z"), ("_t")].iter().any(|s| name.ends_with(s)) {
        return d("nT", Role::Sensor, "vector magnetometer, body frame");
    }
    if name.starts_with("cur_") {
        return d("A", Role::Aux, "current sensor");
    }
    if name.starts_with("vol_") {
        return d("V", Role::Aux, "voltage sensor");
    }
    if name.starts_with("part_") {
        return d("nT", Role::Truth, "contribution to a simulated reading");
    }
    d("", Role::Aux, "")
}

/// Whether the column `name` is the reading of a scalar magnetometer.
pub fn is_scalar_reading(name: &str) -> bool {
    magnetometer(name, "_uc").is_some()
}

/// Whether the column `name` is a compensated scalar magnetometer.
pub fn is_compensated(name: &str) -> bool {
    magnetometer(name, "_c").is_some()
}

/// The vector magnetometer of the column `name`, and the part: `x`, `y`, `z`, or `t` for the magnitude.
pub fn vector_part(name: &str) -> Option<(&str, char)> {
    let (vector, part) = name.rsplit_once('_')?;
    let letter = match part {
        "x" => 'x',
        "y" => 'y',
        "z" => 'z',
        "t" => 't',
        _ => return None,
    };
    (vector.starts_with("flux_") && vector.len() > "flux_".len()).then_some((vector, letter))
}

/// The part N of a name `mag_N<suffix>`.
fn magnetometer<'a>(name: &'a str, suffix: &str) -> Option<&'a str> {
    let n = name.strip_prefix("mag_")?.strip_suffix(suffix)?;
    (!n.is_empty() && n.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit())).then_some(n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_contract_names_units_and_roles() {
        assert_eq!(describe("mag_4_uc").unit, "nT");
        assert_eq!(describe("mag_4_uc").role, Role::Sensor);
        assert_eq!(describe("mag_1_c").role, Role::Truth);
        assert_eq!(describe("mag_c").role, Role::Aux);
        assert_eq!(describe("flux_a_x").unit, "nT");
        assert_eq!(describe("cur_flap").unit, "A");
        assert_eq!(describe("vol_bat_1").unit, "V");
        assert_eq!(describe("ins_fd").unit, "m/s2");
        assert_eq!(describe("part_eddy_mag_4_uc").role, Role::Truth);
        assert_eq!(describe("something_else").role, Role::Aux);
    }
}
