#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use arrow_array::{Float64Array, RecordBatch, cast::AsArray, types::Float64Type};

use super::*;

fn features(names: &[&str]) -> Features {
    Features {
        features: names.iter().map(ToString::to_string).collect(),
        terms: None,
        bt_scale_nt: 50_000.0,
        vector: Some("flux_a".into()),
        mag: Some("mag_3_uc".into()),
        groups: vec![1, 2, 3],
        origin: None,
        position: PositionSource::Ins,
        allow_truth: false,
    }
}

const COLUMNS: [&str; 34] = [
    "tt",
    "mag_1_c",
    "mag_2_uc",
    "mag_3_uc",
    "mag_4_uc",
    "mag_5_uc",
    "flux_a_x",
    "flux_a_y",
    "flux_a_z",
    "flux_c_x",
    "flux_c_y",
    "flux_c_z",
    "flux_d_x",
    "flux_d_y",
    "flux_d_z",
    "ins_roll",
    "ins_pitch",
    "ins_yaw",
    "ins_lat",
    "ins_lon",
    "ins_alt",
    "baro",
    "igrf",
    "igrf_x",
    "igrf_y",
    "igrf_z",
    "cur_com_1",
    "cur_ac_hi",
    "cur_ac_lo",
    "cur_flap",
    "cur_strb",
    "cur_heat",
    "cur_acpwr",
    "cur_outpwr",
];

/// 60 samples at 10 Hz; every column is a different parabola.
fn line() -> LineInput {
    let one = |(k, name): (usize, &&str)| {
        let k = k as f64;
        let value = |i: i32| {
            let t = f64::from(i);
            if **name == *"tt" { 0.1 * t } else { 10.0 * k + (1.0 + k) * t + 0.1 * t * t }
        };
        (name.to_string(), Arc::new(Float64Array::from_iter_values((0..60).map(value))) as arrow_array::ArrayRef)
    };
    let mut columns: Vec<(String, arrow_array::ArrayRef)> = COLUMNS.iter().enumerate().map(one).collect();
    columns.push(("vol_bat_1".into(), Arc::new(Float64Array::from(vec![28.0; 60]))));
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None }
}

fn table() -> Table {
    let known = |name: &&str| {
        let d = schemas::flight::describe(name);
        Column::float(*name, d.unit, "").role(d.role)
    };
    let columns = COLUMNS.iter().chain(&["vol_bat_1"]).map(known).collect();
    Table::Lines(TableShape { columns, rate_hz: None })
}

/// The named entries of the list.
fn made(stage: &Features) -> (Vec<String>, Vec<f64>) {
    let yields = stage.yields(&[&table()]).unwrap();
    let ColumnType::List(names) = yields.columns[0].column_type.clone() else { unreachable!("a list") };
    let arrays = stage.run(&line(), &()).unwrap();
    let values = arrays[0].as_fixed_size_list().values().as_primitive::<Float64Type>().values().to_vec();
    assert_eq!(values.len(), 60 * names.len());
    (names, values)
}

fn entry(stage: &Features, name: &str, row: usize) -> f64 {
    let (names, values) = made(stage);
    values[row * names.len() + names.iter().position(|n| n == name).unwrap()]
}

#[test]
fn ref_the_feature_sets_have_the_sizes_of_the_thesis() {
    for (set, size) in [("down_selected", 77), ("small_1", 26), ("small_2", 15)] {
        assert_eq!(made(&features(&[set])).0.len(), size, "{set}");
    }
}

#[test]
fn law_differences_lags_and_gradients_of_a_parabola_are_exact() {
    let stage = features(&["mag_3_uc_dot", "mag_3_uc_dot4", "mag_3_uc_lag_2", "mag_2_4_uc", "lpf_cur_strb"]);
    // `mag_3_uc` is column 3: 30 + 4 t + 0.1 t².
    assert!((entry(&stage, "mag_3_uc_dot", 10) - (4.0 + 0.2 * 10.0)).abs() < 1e-12);
    assert!(entry(&stage, "mag_3_uc_dot4", 10).abs() < 1e-12, "the fourth difference of a parabola is 0");
    assert!((entry(&stage, "mag_3_uc_lag_2", 10) - (30.0 + 32.0 + 6.4)).abs() < 1e-12);
    assert!(entry(&stage, "mag_3_uc_lag_2", 1).is_nan());
    assert_eq!(entry(&stage, "mag_2_4_uc", 0), -20.0);
    assert!(entry(&stage, "lpf_cur_strb", 30).is_finite());
}

#[test]
fn law_inputs_are_projected_on_the_direction_of_the_vector() {
    let stage = features(&["ETL_cur_strb"]);
    let (names, _) = made(&stage);
    assert_eq!(names, (1..=7).map(|k| format!("cur_strb_{k}")).collect::<Vec<_>>());
    let at = |name: &str| entry(&stage, name, 20);
    let length = (2..=4).map(|k| at(&format!("cur_strb_{k}")).powi(2)).sum::<f64>().sqrt();
    assert!((length / at("cur_strb_1") - 1.0).abs() < 1e-12);
    // Column 30 changes by 31 + 0.2 t per sample.
    let change = (5..=7).map(|k| at(&format!("cur_strb_{k}")).powi(2)).sum::<f64>().sqrt();
    assert!((change - (31.0 + 0.2 * 20.0)).abs() < 1e-9);
    let raw = Features { groups: vec![1], vector: None, ..features(&["ETL_cur_strb"]) };
    assert_eq!(made(&raw).0, ["cur_strb_1"]);
}

#[test]
fn unit_terms_equal_those_of_a_matrix() {
    let (names, values) = made(&features(&["TL_A_flux_a", "core_flux_d", "slope"]));
    assert_eq!(names.len(), 18 + 21 + 2);
    assert_eq!(
        (names[0].as_str(), names[17].as_str(), names[39].as_str()),
        ("TL_A_flux_a_x", "TL_A_flux_a_zz_dot", "easting")
    );
    assert!((values[0].powi(2) + values[1].powi(2) + values[2].powi(2) - 1.0).abs() < 1e-12);
    assert!(values[..41].iter().all(|v| v.is_finite()));
}

#[test]
fn gold_invalid_features_are_reported_with_their_parameter() {
    let fault_texts = |stage: &Features| {
        let faults = stage.yields(&[&table()]).unwrap_err();
        faults.iter().map(|f| format!("{f} [{}]", f.param.clone().unwrap_or_default())).collect::<Vec<_>>().join("\n")
    };
    assert!(fault_texts(&features(&["mag_1_c"])).contains("`mag_1_c` is a truth column"));
    assert!(fault_texts(&features(&["mag_1_c_dot"])).contains("`mag_1_c` is a truth column"), "nor what is made of it");
    assert!(fault_texts(&features(&["cur_fan_dot"])).contains("there is no column `cur_fan`"));
    assert!(fault_texts(&Features { vector: None, ..features(&["ETL_cur_strb"]) }).contains("set `vector`"));
    assert!(fault_texts(&Features { mag: None, ..features(&["small_1"]) }).contains("requires `mag`"));
    assert!(fault_texts(&features(&["baro", "baro"])).contains("duplicate feature `baro`"));
    assert!(fault_texts(&Features { groups: vec![4], ..features(&["baro"]) }).contains("no group 4"));
    assert!(fault_texts(&features(&[])).contains("`features` is empty"));
}
