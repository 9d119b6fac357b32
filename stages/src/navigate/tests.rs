#![allow(clippy::unwrap_used)]
use super::tuning::AssumedNoise;
use schemas::{Literal, ParamReader, Params, SpecEntries, SpecEntry};

use super::*;

filter! {
    /// A second filter in addition to the built-in one.
    Still = "still", version 1, example "hold_s = 2.0";
    /// A key of this filter.
    hold_s: f64, unit "s", default 1.0;
}

impl NavigationFilter for Still {
    fn navigate(&self, _: &FilterInput) -> Result<FilterTrack, Fault> {
        Err(Fault::bug("no line is flown here"))
    }
}

fn text(word: &str) -> Literal {
    Literal::Text(word.to_owned())
}

/// The stage with these keys, with a choice of two filters.
fn navigate(given: &[(&str, Literal)]) -> Navigate {
    let filters = FILTERS.iter().copied().chain([&Still::FILTER]).collect();
    let lists = ChoiceRegistry::default().with::<FilterDecl>(filters);
    let magnav = ("tuning", text("magnav"));
    let args = given.iter().chain([&magnav]).map(|(key, value)| {
        let given = SpecEntry { value: value.clone(), key_at: 0..0, at: 0..0 };
        ((*key).to_owned(), given)
    });
    let args: SpecEntries = args.collect();
    let mut reader = ParamReader::new(Navigate::NAME, &args, None, &lists);
    let stage = Navigate::read(&mut reader, None);
    let faults = reader.into_faults();
    assert!(faults.is_empty(), "{faults:?}");
    stage.unwrap()
}

/// A flight with the compensated field, the position of the INS, and these columns.
fn flight(more: &[(&str, &str)]) -> Table {
    let usual = [("tt", "s"), ("mag_c", "nT"), ("ins_lat", "deg"), ("ins_lon", "deg"), ("ins_alt", "m")];
    let columns = usual.iter().chain(more).map(|(name, unit)| Column::float(*name, *unit, "")).collect();
    Table::Lines(TableShape { columns, rate_hz: None })
}

fn map() -> Table {
    Table::Map(schemas::map::shape())
}

fn batch(columns: &[(&str, &[f64])]) -> RecordBatch {
    RecordBatch::try_from_iter(columns.iter().map(|(name, values)| (*name, array(values.to_vec())))).unwrap()
}

#[test]
fn unit_all_missing_inputs_are_reported_with_their_parameters() {
    let bare = Table::Lines(TableShape { columns: vec![Column::float("ins_alt", "ft", "")].into(), rate_hz: None });
    let levels = Literal::List(vec![Literal::Float(400.0), Literal::Float(300.0)]);
    let wanting = navigate(&[
        ("measurement_sigma_nt", text("auto")),
        ("fogm_tau_s", text("auto")),
        ("remove_diurnal", Literal::Bool(true)),
        ("map_levels_m", levels),
    ]);
    let faults = wanting.yields(&[&bare, &map()]).unwrap_err();
    let expected = [
        ("`mag_c`", "mag"),
        ("`ins_lat`", "input"),
        ("`ins_lon`", "input"),
        ("`ins_alt` is in ft, but m is needed", "input"),
        ("ascend", "map_levels_m"),
        ("there is no column `mag_sigma`", "measurement_sigma_nt"),
        ("there is no column `mag_fogm_tau`", "fogm_tau_s"),
        ("`diurnal`", "remove_diurnal"),
        ("needs a date", "decimal_year"),
    ];
    assert_eq!(faults.len(), expected.len(), "{faults:?}");
    for (fault, (words, param)) in faults.iter().zip(expected) {
        assert!(fault.what.contains(words) && fault.param.as_deref() == Some(param), "{fault:?}");
    }
}

#[test]
fn unit_a_core_field_without_a_date_is_rejected_with_remedies() {
    let [undated, dated] = [flight(&[]), flight(&[("year", ""), ("doy", "")])];
    let faults = navigate(&[]).yields(&[&undated, &map()]).unwrap_err();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert!(faults[0].what.contains("needs a date"));
    let help = faults[0].help.as_deref().unwrap();
    assert!(["`decimal_year`", "`year` and `doy`", "`core_field = false`"].iter().all(|way| help.contains(way)));
    let of_spec = navigate(&[("decimal_year", Literal::Float(2021.25))]);
    let without = navigate(&[("core_field", Literal::Bool(false))]);
    let of_flight = navigate(&[]);
    let reads_date = |stage: &Navigate, table: &Table| {
        let reads = stage.yields(&[table, &map()]).unwrap().reads;
        ["year", "doy"].iter().all(|name| reads[0].iter().any(|read| read == name))
    };
    assert!(!reads_date(&of_spec, &undated) && !reads_date(&without, &undated));
    assert!(reads_date(&of_flight, &dated) && !reads_date(&of_spec, &dated) && !reads_date(&without, &dated));
    // Day 184 of a leap year begins at mid-year; the first sample has no value in `doy`.
    let line = batch(&[("tt", &[0.0, 0.0]), ("year", &[2020.0, 2020.0]), ("doy", &[f64::NAN, 184.0])]);
    assert_eq!(of_flight.core_year(&line).unwrap(), Some(2020.5));
    assert_eq!(of_spec.core_year(&line).unwrap(), Some(2021.25));
    assert_eq!(without.core_year(&line).unwrap(), None);
    let undated = of_flight.core_year(&batch(&[("tt", &[0.0])])).unwrap_err();
    assert_eq!(undated.help.as_deref(), Some(WAYS_OUT));
}

#[test]
fn unit_a_key_of_another_filter_has_no_effect() {
    let why = |filter: &str, key: &str| navigate(&[("filter", text(filter))]).unused_key(key).map(|fault| fault.what);
    assert_eq!(why("ekf", "hold_s").as_deref(), Some("`hold_s` belongs to `still`"));
    assert!(why("still", "gate_nis").is_some_and(|what| what.starts_with("`gate_nis` belongs to `ekf`, `iekf`")));
    assert_eq!(why("ekf", "tolerance_m").as_deref(), Some("`tolerance_m` belongs to `iekf` and `rts`"));
    for (filter, key) in [("ekf", "gate_nis"), ("still", "hold_s"), ("ekf", "mag"), ("still", "fogm_tau_s")] {
        assert_eq!(why(filter, key), None, "{filter} {key}");
    }
}

#[test]
fn unit_a_grade_sets_the_unset_errors_of_the_ins() {
    use numerics::navigation::ins_error::{InsErrors, InsGrade};
    assert_eq!(navigate(&[]).ins.sources, InsErrors::default());
    let graded = navigate(&[("ins_grade", text("tactical")), ("init_position_sigma_m", Literal::Float(20.0))]);
    let expected = InsErrors { init_position_sigma_m: 20.0, ..InsGrade::Tactical.errors() };
    assert_eq!(graded.ins.sources, expected);
    let why = |key: &str| graded.unused_key(key).map(|fault| fault.what);
    assert_eq!((why("ins_grade"), why("init_position_sigma_m")), (None, None));
}

#[test]
fn unit_automatic_derivations_and_corrections_are_noted() {
    let without = |more: &[(&str, Literal)]| {
        let no_core = [("core_field", Literal::Bool(false))];
        navigate(&no_core.into_iter().chain(more.iter().cloned()).collect::<Vec<_>>())
    };
    let velocity = VELOCITY.map(|name| (name, "m/s"));
    let rich: Vec<_> = velocity.into_iter().chain([("ins_roll", "deg"), ("diurnal", "nT")]).collect();
    let made = without(&[]).yields(&[&flight(&rich), &map()]).unwrap();
    let expected = [
        "`diurnal` is subtracted from the measurement; set `remove_diurnal = false` to keep it",
        "ins_fn, ins_fe, ins_fd missing: derived from INS velocities",
        "ins_pitch, ins_yaw missing: derived from the course, level",
    ];
    assert_eq!(made.notes, expected);
    let read = ["tt", "mag_c", "ins_lat", "ins_lon", "ins_alt", "ins_vn", "ins_ve", "ins_vd", "diurnal"];
    assert_eq!(made.reads[0], read, "a roll without the rest is not read");
    let line = batch(&[("mag_c", &[100.0, 100.0, 100.0]), ("diurnal", &[5.0, -5.0, f64::NAN])]);
    let measured = without(&[]).measured(&line, "mag_c").unwrap();
    assert!(measured[..2] == [95.0, 105.0] && measured[2].is_nan(), "{measured:?}");
    let kept = without(&[("remove_diurnal", Literal::Bool(false))]);
    assert_eq!(kept.measured(&line, "mag_c").unwrap(), [100.0; 3]);
    assert!(kept.yields(&[&flight(&rich), &map()]).unwrap().notes.iter().all(|note| !note.contains("diurnal")));
}

#[test]
fn law_an_offset_estimated_from_noise_doubles_its_variance_and_time() {
    let auto = ["measurement_sigma_nt", "fogm_sigma_nt", "fogm_tau_s"].map(|key| (key, text("auto")));
    let found: [(&str, &[f64]); 3] =
        [("mag_sigma", &[f64::NAN, 2.0]), ("mag_fogm_sigma", &[3.0, 3.0]), ("mag_fogm_tau", &[50.0, 50.0])];
    let noise = |given: &[(&str, Literal)]| {
        let AssumedNoise { sigma_nt, fogm_sigma_nt, fogm_tau_s } = navigate(given).expected(&batch(&found)).unwrap();
        [sigma_nt, fogm_sigma_nt.powi(2), fogm_tau_s]
    };
    let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a / b - 1.0).abs() < 1e-14);
    assert!(near(noise(&auto), [2.0, 9.0, 50.0]));
    let offset = ("offset_window_s", Literal::Float(1.0));
    let with_offset: Vec<_> = auto.iter().cloned().chain([offset.clone()]).collect();
    assert!(near(noise(&with_offset), [2.0, 18.0, 100.0]));
    let given = noise(&[offset, ("fogm_sigma_nt", Literal::Float(4.0)), ("fogm_tau_s", Literal::Float(30.0))]);
    assert!(near(given, [5.0, 16.0, 30.0]), "what is given stays as it is");
    let silent: [(&str, &[f64]); 3] = [("mag_sigma", &[f64::NAN]), found[1], found[2]];
    let fault = navigate(&auto).expected(&batch(&silent.map(|(name, x)| (name, &x[..1])))).err().unwrap();
    assert_eq!((fault.place.column.as_deref(), fault.owner), (Some("mag_sigma"), schemas::FaultOwner::Data));
}

#[test]
fn unit_the_noise_column_is_checked_in_the_plan_and_in_the_line() {
    let noisy = flight(&[("noise", "nT"), ("current", "A")]);
    let with = |column: &str, more: &[(&str, Literal)]| {
        let keys = [("core_field", Literal::Bool(false)), ("noise_column", text(column))];
        navigate(&keys.into_iter().chain(more.iter().cloned()).collect::<Vec<_>>())
    };
    let said = |stage: &Navigate| {
        let faults = stage.yields(&[&noisy, &map()]).unwrap_err();
        assert!(faults.iter().all(|f| f.param.as_deref() == Some("noise_column")), "{faults:?}");
        faults[0].what.clone()
    };
    assert!(with("noise", &[]).yields(&[&noisy, &map()]).unwrap().reads[0].iter().any(|name| name == "noise"));
    assert!(said(&with("current", &[])).contains("is in A, but nT is needed"));
    assert!(said(&with("nose", &[])).contains("`nose`"));
    assert!(said(&with("mag_c", &[])).contains("is the measurement"));
    let two = Literal::List(vec![text("mag_c"), text("noise")]);
    assert!(said(&with("noise", &[("mag", two)])).contains("a single magnetometer"));
    let why = with("noise", &[("filter", text("ins_only"))]).unused_key("noise_column").unwrap().what;
    assert_eq!(why, "the filter `ins_only` does not use `noise_column`");
    let sigma_nt = |values: &[f64]| with("noise", &[]).sample_sigma_nt(&batch(&[("noise", values)]));
    let found = sigma_nt(&[3.0, f64::INFINITY, f64::NAN, 0.0]).unwrap().unwrap();
    assert!(found[0] == 3.0 && found[1].is_nan() && found[2].is_nan() && found[3] == 0.0, "{found:?}");
    let fault = sigma_nt(&[3.0, -0.5]).unwrap_err();
    assert_eq!(fault.what, "the standard deviation is -0.5 nT in row 2");
    assert_eq!(fault.place.column.as_deref(), Some("noise"));
}
