//! The SGL surveys: the meaning of their fields, and their conversion. The HDF5 and the `.xyz` reader share this
//! module. [MagNav.jl, readmes/sgl_2020_fields_readme.txt]

use std::path::Path;

use schemas::canonical::{as_written, identifier};

use super::RowFault;
use crate::{
    ReadError,
    motion::GeodeticTrack,
    table::{ColumnTable, ColumnValues, whole},
};

/// Names in `.xyz` headers, names in HDF5 files, and the unit if it is not the canonical one. A canonical name is used
/// only if the field has exactly the canonical meaning.
const FIELDS: &[(&str, &str, &str)] = &[
    ("LINE", "line", ""),
    ("FLT", "flight", ""),
    ("YEAR", "year", ""),
    ("DOY", "doy", ""),
    ("TIME", "tt", ""),
    ("UTM-X", "utm_x", "m"),
    ("UTM-Y", "utm_y", "m"),
    ("UTM-Z", "utm_z", "m"),
    ("MSL-Z", "msl", ""),
    ("LAT", "lat", ""),
    ("LONG", "lon", ""),
    ("BARO", "baro", ""),
    ("RADAR", "radar", ""),
    ("TOPO", "topo", ""),
    ("DEM", "dem", ""),
    ("DRAPE", "drape", ""),
    ("PITCH", "ins_pitch", ""),
    ("ROLL", "ins_roll", ""),
    ("AZIMUTH", "ins_yaw", ""),
    ("DIURNAL", "diurnal", ""),
    ("COMPMAG1", "mag_1_c", ""),
    ("LAGMAG1", "mag_1_lag", "nT"),
    ("DCMAG1", "mag_1_dc", "nT"),
    ("IGRFMAG1", "mag_1_igrf", "nT"),
    ("OGS_MAG", "ogs_mag", "nT"),
    ("OGS_HGT", "ogs_alt", "m"),
    ("INS_ACC_X", "ins_acc_x", "m/s2"),
    ("INS_ACC_Y", "ins_acc_y", "m/s2"),
    ("INS_ACC_Z", "ins_acc_z", "m/s2"),
    ("INS_WANDER", "ins_wander", "rad"),
    ("INS_LAT", "ins_lat", "rad"),
    ("INS_LON", "ins_lon", "rad"),
    ("INS_HGT", "ins_alt", ""),
    ("INS_VEL_N", "ins_vn", ""),
    ("INS_VEL_W", "ins_vw", "m/s"),
    ("INS_VEL_V", "ins_vu", "m/s"),
    ("PITCHRT", "pitch_rate", "deg/s"),
    ("ROLLRT", "roll_rate", "deg/s"),
    ("YAWRT", "yaw_rate", "deg/s"),
    // Standard gravity is spelt out, because the converter interprets `g` as gauss.
    ("LONG_ACC", "lgtl_acc", "standard gravity"),
    ("LAT_ACC", "ltrl_acc", "standard gravity"),
    ("NORM_ACC", "nrml_acc", "standard gravity"),
    ("TRUE_AS", "tas", "m/s"),
    ("PITOT_P", "pitot_p", "kPa"),
    ("STATIC_P", "static_p", "kPa"),
    ("TOT_P", "total_p", "kPa"),
    ("CUR_COM1", "cur_com_1", ""),
    ("CUR_ACHI", "cur_ac_hi", ""),
    ("CUR_ACLO", "cur_ac_lo", ""),
    ("CUR_IHTR", "cur_heat", ""),
    ("CUR_BAT1", "cur_bat_1", ""),
    ("CUR_BAT2", "cur_bat_2", ""),
    ("V_BAT1", "vol_bat_1", ""),
    ("V_BAT2", "vol_bat_2", ""),
    ("V_RESP", "vol_res_p", ""),
    ("V_RESN", "vol_res_n", ""),
    ("V_BACKP", "vol_back_p", ""),
    ("V_BACKN", "vol_back_n", ""),
    ("V_GYRO1", "vol_gyro_1", ""),
    ("V_GYRO2", "vol_gyro_2", ""),
    ("V_ACCP", "vol_acc_p", ""),
    ("V_ACCN", "vol_acc_n", ""),
    ("V_SERVO", "vol_srvo", ""),
];

/// The HDF5 name of a column of an `.xyz` header.
pub(super) fn name_of_header(header: &str) -> String {
    let upper = header.to_ascii_uppercase();
    if let Some((_, name, _)) = FIELDS.iter().find(|(h, _, _)| *h == upper) {
        return (*name).to_owned();
    }
    let lower = header.to_ascii_lowercase();
    // FLUXB_TOT -> flux_b_t, UNCOMPMAG3 -> mag_3_uc, V_CABT -> vol_cabt; other names become lower case.
    if let Some(n) = lower.strip_prefix("uncompmag") {
        format!("mag_{n}_uc")
    } else if let Some(rest) = lower.strip_prefix("flux") {
        format!("flux_{}", rest.replace("_tot", "_t"))
    } else if let Some(rest) = lower.strip_prefix("v_") {
        format!("vol_{rest}")
    } else {
        lower
    }
}

/// The unit of the values of a field; empty for the canonical unit.
pub(super) fn unit_of(name: &str, ins_angle: &'static str) -> &'static str {
    match name {
        "ins_lat" | "ins_lon" => ins_angle,
        _ => FIELDS.iter().find(|(_, n, _)| *n == name).map_or("", |(_, _, unit)| unit),
    }
}

/// The unit of `ins_lat` and `ins_lon`, which differs between the readme and the files. The unit that agrees with the
/// GNSS latitude is used; without a GNSS latitude it is radians.
pub(super) fn ins_angle(lat_deg: Option<f64>, ins_lat: Option<f64>) -> &'static str {
    match (lat_deg, ins_lat) {
        // INS errors are below one degree. At latitudes above 1.02 degrees, the number of degrees and the number of
        // radians differ by more than 1, so only one of them can agree with the GNSS latitude.
        (Some(lat), Some(ins)) if (ins - lat).abs() < 1.0 && (ins.to_degrees() - lat).abs() > 1.0 => "deg",
        _ => "rad",
    }
}

/// One line of the survey with the canonical columns, from the columns of the file.
///
/// - `utm_z` is the height above the ellipsoid, `alt`.
/// - `ins_vw` (west) and `ins_vu` (up) become `ins_ve` and `ins_vd`.
/// - `ins_fn`, `ins_fe`, `ins_fd` are the accelerations, rotated by the wander angle.
/// - `vn`, `ve`, `vd` follow from the differences of the positions on the ellipsoid along the line.
/// - `igrf` is `mag_1_dc - mag_1_igrf`.
///
/// A column that the file lacks is absent.
///
/// Faults of single rows are returned with the table.
pub(super) fn finish(path: &Path, mut table: ColumnTable) -> Result<(ColumnTable, Vec<RowFault>), ReadError> {
    let mut faults = vec![];
    for (from, to, sign) in [("utm_z", "alt", 1.0), ("ins_vw", "ins_ve", -1.0), ("ins_vu", "ins_vd", -1.0)] {
        if let Some(ColumnValues::Number(x)) = table.take(from) {
            table.push(to, "", ColumnValues::Number(x.iter().map(|x| sign * x).collect()));
        }
    }
    push_velocity(&mut table);
    push_specific_force(&mut table);
    if let (Some(dc), Some(anomaly)) = (table.numbers("mag_1_dc"), table.numbers("mag_1_igrf")) {
        let igrf = dc.iter().zip(anomaly).map(|(dc, anomaly)| dc - anomaly).collect();
        table.push("igrf", "", ColumnValues::Number(igrf));
    }
    for name in ["year", "doy"] {
        if let Some(ColumnValues::Number(x)) = table.take(name) {
            let (values, wrong) = whole(path, name, &x);
            faults.extend(wrong);
            table.push(name, "", values);
        }
    }
    for (name, spell) in [("line", line_text as fn(f64) -> String), ("flight", identifier)] {
        match table.take(name) {
            Some(ColumnValues::Number(x)) => {
                // The merge of the lines reports a missing identifier.
                let text = |x: &f64| if x.is_finite() { spell(*x) } else { String::new() };
                table.push_front(name, ColumnValues::Text(x.iter().map(text).collect()));
            }
            Some(values) => table.push_front(name, values),
            None => {}
        }
    }
    Ok((table, faults))
}

/// `1003.1` is line `1003.10`: the surveys number lines with two decimals.
fn line_text(x: f64) -> String {
    let x = as_written(x);
    let hundredths = x * 100.0;
    if (hundredths - hundredths.round()).abs() < 1e-6 { format!("{x:.2}") } else { x.to_string() }
}

fn push_velocity(table: &mut ColumnTable) {
    let columns = ["tt", "lat", "lon", "alt"].map(|n| table.numbers(n));
    let [Some(tt), Some(lat_deg), Some(lon_deg), Some(alt_m)] = columns else { return };
    let velocity = GeodeticTrack { tt, lat_deg, lon_deg, alt_m }.velocity_mps();
    for (name, values) in ["vn", "ve", "vd"].into_iter().zip(velocity) {
        table.push_described(name, "m/s", "velocity, from differences of the positions", ColumnValues::Number(values));
    }
}

/// The accelerometers' x axis points `wander` counter-clockwise from north, y 90° further, z up.
fn push_specific_force(table: &mut ColumnTable) {
    let columns = ["ins_acc_x", "ins_acc_y", "ins_acc_z", "ins_wander"].map(|n| table.numbers(n));
    let [Some(x), Some(y), Some(z), Some(wander)] = columns else { return };
    let north = (0..x.len()).map(|i| x[i] * wander[i].cos() - y[i] * wander[i].sin()).collect();
    let east = (0..x.len()).map(|i| -x[i] * wander[i].sin() - y[i] * wander[i].cos()).collect();
    let down = z.iter().map(|z| -z).collect();
    for (name, values) in [("ins_fn", north), ("ins_fe", east), ("ins_fd", down)] {
        table.push(name, "", ColumnValues::Number(values));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_header_names() {
        for (header, name) in [
            ("UNCOMPMAG5", "mag_5_uc"),
            ("FLUXB_TOT", "flux_b_t"),
            ("FLUXD_X", "flux_d_x"),
            ("V_BACKp", "vol_back_p"),
            ("CUR_ACHi", "cur_ac_hi"),
            ("CUR_SRVO_O", "cur_srvo_o"),
            ("V_CABT", "vol_cabt"),
            ("COMPMAG1", "mag_1_c"),
            ("SOMETHING", "something"),
        ] {
            assert_eq!(name_of_header(header), name);
        }
    }

    #[test]
    fn unit_line_numbers_keep_their_trailing_zero() {
        assert_eq!(line_text(1003.1), "1003.10");
        assert_eq!(line_text(1003.0), "1003.00");
        assert_eq!(line_text(1003.125), "1003.125");
    }
}
