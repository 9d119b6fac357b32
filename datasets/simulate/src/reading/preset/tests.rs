#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;

use datasets::{ReadError, samples};
use tempfile::TempDir;

use super::{
    super::super::{CurrentControl, QuantitySpec, Simulation, SynthSpec},
    PRESETS,
};

fn read(top: &str, more: &str) -> Result<SynthSpec, ReadError> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("p.synth.toml");
    let map = samples::path("osborne/osborne_anomaly_100m_at_500m.tif");
    let flights = "[[flights]]\nname = '1'\n[[flights.lines]]\nname = '1.1'\nalt_m = 500.0\nduration_s = 60.0\n\
                   waypoints = [[-22.05, 140.6], [-21.9, 140.65]]\n";
    fs::write(&path, format!("{top}\n{more}\n[map]\npath = '{}'\n{flights}", map.display())).unwrap();
    Simulation::open(&path).map(|s| s.spec().clone())
}

#[test]
fn unit_every_preset_is_a_complete_aircraft() {
    for (name, _) in PRESETS {
        let spec = read(&format!("preset = '{name}'"), "").unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(spec.aircraft.scalars.len() > 2 && spec.aircraft.vectors.len() > 1, "{name}");
        assert!(spec.aircraft.wires.len() > 2 && !spec.aircraft.voltages.is_empty(), "{name}");
        assert_eq!(spec.flights.len(), 1);
    }
}

#[test]
fn ref_cessna_has_the_fields_of_table_a1() {
    // Gnadt 2022, Table A.1: currents and voltages; the table prints vol_servo where the files have vol_srvo.
    let fields = "cur_com_1 cur_ac_hi cur_ac_lo cur_tank cur_flap cur_strb cur_srvo_o cur_srvo_m cur_srvo_i cur_heat \
                  cur_acpwr cur_outpwr cur_bat_1 cur_bat_2 vol_acpwr vol_outpwr vol_bat_1 vol_bat_2 vol_res_p \
                  vol_res_n vol_back_p vol_back_n vol_gyro_1 vol_gyro_2 vol_acc_p vol_acc_n vol_block vol_back \
                  vol_srvo vol_cabt vol_fan mag_1_c mag_1_uc mag_2_uc mag_3_uc mag_4_uc mag_5_uc";
    let aircraft = read("preset = 'cessna'", "").unwrap().aircraft;
    let mut names: Vec<String> = aircraft.currents.iter().map(|c| c.name.clone()).collect();
    names.extend(aircraft.voltages.iter().map(|v| v.name.clone()));
    names.extend(aircraft.scalars.iter().map(|m| m.name.clone()));
    assert_eq!(names, fields.split_whitespace().collect::<Vec<_>>());
    let flux: Vec<&str> = aircraft.vectors.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(flux, ["flux_a", "flux_b", "flux_c", "flux_d"]);
}

#[test]
fn unit_the_spec_overrides_its_preset() {
    let plain = read("preset = 'cessna'", "").unwrap();
    let spec = read(
        "preset = 'cessna'\nrate_hz = 20.0\nwithout = ['mag_5_uc', 'cur_tank']",
        "[ins]\ninit_position_sigma_m = 50.0\n[[magnetometers]]\nname = 'mag_4_uc'\nnoise_nt = 7.0\n\
         permanent_nt = 5.0\n\
         [[magnetometers]]\nname = 'mag_9_uc'\n[[currents]]\nname = 'cur_strb'\nkind = 'steady'\non_a = 2.0\n\
         [[currents]]\nname = 'cur_flap'\non_a = 30.0\n",
    )
    .unwrap();
    assert_eq!((plain.rate_hz, spec.rate_hz), (10.0, 20.0));
    assert_eq!(spec.gusts_deg, plain.gusts_deg);
    assert_eq!(
        (spec.ins.model.sources.init_position_sigma_m, spec.ins.model.sources.init_attitude_sigma_deg),
        (50.0, 0.01)
    );
    let names: Vec<&str> = spec.aircraft.scalars.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["mag_1_c", "mag_1_uc", "mag_2_uc", "mag_3_uc", "mag_4_uc", "mag_9_uc"]);
    let (before, after) = (&plain.aircraft.scalars[4], &spec.aircraft.scalars[4]);
    assert_eq!((before.noise_nt, after.noise_nt), (0.1, 7.0));
    assert_eq!(after.source.induced, before.source.induced);
    // A size replaces the vector of the preset.
    assert_eq!(after.source.permanent, QuantitySpec::Size(5.0));
    let current = |spec: &SynthSpec, name: &str| spec.aircraft.currents.iter().find(|c| c.name == name).cloned();
    assert_eq!(current(&spec, "cur_strb").unwrap().kind, CurrentControl::Steady);
    assert_eq!(current(&spec, "cur_flap").unwrap().kind, current(&plain, "cur_flap").unwrap().kind);
    assert_eq!(current(&spec, "cur_flap").unwrap().off_on_a, (0.0, 30.0));
    assert!(current(&spec, "cur_tank").is_none());
    assert_eq!(spec.aircraft.wires.len(), plain.aircraft.wires.len() - 1, "its wire is gone with it");
}

#[test]
fn gold_faults_of_a_spec_with_a_preset_keep_their_places() {
    let fault_text = |top: &str, more: &str| read(top, more).unwrap_err().to_string();
    let unknown = fault_text("seed = 1\npreset = 'cesna'", "");
    assert!(unknown.contains("there is no preset `cesna`") && unknown.contains("p.synth.toml:2:10\n"), "{unknown}");
    assert!(unknown.contains("did you mean `cessna`?"), "{unknown}");
    let wrong = fault_text(
        "preset = 'cessna'\nwithout = ['mag_6_uc']",
        "[[magnetometers]]\nname = 'mag_4_uc'\nnoise = 7.0\nheading_nt = 'x'",
    );
    for (place, what) in [
        ("2:12", "the preset `cessna` has no `mag_6_uc`"),
        ("5:1", "`magnetometers` has no parameter `noise`"),
        ("6:14", "`heading_nt` of `magnetometers` must be a number, not a text"),
    ] {
        assert!(wrong.contains(what) && wrong.contains(&format!("p.synth.toml:{place}\n")), "{what}\n{wrong}");
    }
    let odd = fault_text("preset = 3", "");
    assert!(odd.contains("`preset` must be the name of a preset"), "{odd}");
    let alone = fault_text("without = ['mag_5_uc']", "");
    assert!(alone.contains("`without` removes entries of a preset; set `preset`"), "{alone}");
}
