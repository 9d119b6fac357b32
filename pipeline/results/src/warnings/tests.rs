#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;

use schemas::Literal;

use super::*;

fn facts<'a>(row: &'a LineMetrics, settings: NavigationSettings) -> LineFacts<'a> {
    LineFacts { row, settings: Some(settings) }
}

fn given(sigma_nt: f64) -> NavigationSettings {
    NavigationSettings { sigma_nt: Some(sigma_nt), ..NavigationSettings::default() }
}

fn kinds(found: &[WarningDraft]) -> Vec<&'static str> {
    found.iter().map(|f| f.kind.as_str()).collect()
}

#[test]
fn unit_divergent_and_cautious_filters_are_flagged() {
    // mag_4 of the main example, and a filter that is 300 times too cautious.
    let row = LineMetrics::from([("drms", 8199.0), ("ins_drms", 967.0), ("nees", 161_284.0), ("nis", 22.0)]);
    let found = judge(&facts(&row, given(5.0)));
    assert_eq!(kinds(&found), ["worse_than_ins", "nees_high", "nis_high"]);
    assert_eq!(found[0].text, "the filter is worse than the INS alone: drms 8199 m against 967.0 m");
    assert_eq!((found[1].value, found[1].limit), (161_284.0, 20.0));
    let row = LineMetrics::from([("drms", 90.0), ("ins_drms", 967.0), ("nees", 1.1), ("nis", 0.004)]);
    let found = judge(&facts(&row, given(100.0)));
    assert_eq!(kinds(&found), ["nis_low"]);
    // Nothing explains it but the assumed noise, which is tried with the whole run.
    assert_eq!(found[0].cause, None);
    let row = LineMetrics::from([("nis", 0.004), ("std_error", 4.0)]);
    let cause = judge(&facts(&row, given(100.0))).remove(0).cause.unwrap();
    assert_eq!(cause, "the residual of compensation is 4.000 nT (std_error), but `measurement_sigma_nt` is 100.0 nT");
}

#[test]
fn unit_figures_within_their_limits_are_not_flagged() {
    for (nees, nis) in [(2.0, 1.0), (0.21, 0.26), (19.9, 3.9)] {
        let row = LineMetrics::from([("drms", 10.0), ("ins_drms", 10.0), ("nees", nees), ("nis", nis)]);
        assert!(judge(&facts(&row, given(5.0))).is_empty(), "{nees} {nis}");
    }
    assert!(judge(&LineFacts { row: &LineMetrics::default(), settings: None }).is_empty());
}

#[test]
fn unit_correlated_innovations_are_flagged_unless_the_noise_includes_the_correlation() {
    let flagged = |correlated: f64| {
        let row = LineMetrics::from([("nis", 0.6), ("whiteness", 0.0), ("correlated_nis", correlated)]);
        kinds(&judge(&facts(&row, given(2.0))))
    };
    assert_eq!(flagged(1.1), Vec::<&str>::new());
    assert_eq!(flagged(1.6), ["not_white"]);
}

#[test]
fn unit_correlated_innovations_are_flagged_without_truth_and_a_low_nis_is_cautious() {
    // The adaptive filter on a map of sparse lines, a magnetometer that is 0.6 s late, and a healthy filter.
    for (nis, white, expected) in
        [(1.64, 0.21, vec!["not_white"]), (1.09, 0.56, vec!["not_white"]), (1.0, 0.97, vec![]), (1.0, 0.8, vec![])]
    {
        let row = LineMetrics::from([("nis", nis), ("whiteness", white)]);
        assert_eq!(kinds(&judge(&facts(&row, given(2.0)))), expected, "{nis} {white}");
    }
    let low = judge(&facts(&LineMetrics::from([("nis", 0.1)]), given(5.0))).remove(0);
    assert!(low.text.starts_with("the filter is cautious"), "{}", low.text);
}

#[test]
fn unit_rejected_positions_are_reported_with_their_time() {
    let row = LineMetrics::from([("gnss_rejected", 893.0)]);
    let settings = NavigationSettings { gnss_rejected_s: Some(603.0), ..given(2.0) };
    let found = judge(&facts(&row, settings)).remove(0);
    assert!(found.text.contains("893 of") && found.text.contains("the first one 603 s after"), "{}", found.text);
    assert!(found.cause.is_some_and(|cause| cause.contains("jammed, spoofed or faulty")));
    assert!(judge(&facts(&LineMetrics::from([("gnss_rejected", 0.0)]), given(2.0))).is_empty());
}

#[test]
fn unit_a_lost_anomaly_is_flagged_with_and_without_navigation() {
    let cases = [(1.02, 0.01), (0.9, 0.0), (0.89, 0.01), (0.3, 0.35), (0.89, 0.004), (-0.3, 0.2)];
    for (kept, error) in cases {
        let remarked = kept + 2.0 * error < 0.9;
        let row = LineMetrics::from([("anomaly_retention", kept), ("anomaly_retention_se", error)]);
        for settings in [None, Some(given(5.0))] {
            let found = judge(&LineFacts { row: &row, settings });
            assert_eq!(kinds(&found), if remarked { vec!["retention"] } else { vec![] }, "{kept}");
            assert!(found.iter().all(|f| f.cause.as_deref().is_some_and(|c| c.contains("strong anomalies"))));
        }
    }
}

#[test]
fn law_a_consistent_nees_is_rarely_beyond_ten_times_its_mean() {
    // NEES/2 of a single sample is exponentially distributed with mean 1.
    let exceeded = (-track::NEES.metric.accepted().unwrap().1 / 2.0).exp();
    assert!(exceeded < 1.0 / 22_000.0, "{exceeded}");
    // For three lines, NEES·3/2 has a gamma distribution of shape 3: 1 − e^(−x)(1 + x + x²/2).
    let x = 3.0 * track::NEES.metric.accepted().unwrap().0 / 2.0;
    let undercut = 1.0 - (-x).exp() * (1.0 + x + x * x / 2.0);
    assert!(undercut < 0.004, "{undercut}");
}

#[test]
fn unit_causes_follow_from_known_facts() {
    let bad = |more: &[(&'static str, f64)]| {
        let base = [("drms", 300.0), ("ins_drms", 100.0), ("nees", 90.0), ("nis", 1.0)];
        let all: BTreeMap<&'static str, f64> = base.iter().chain(more).copied().collect();
        all
    };
    let cause = |more: &[(&'static str, f64)], settings: NavigationSettings| {
        let figures = bad(more);
        let mut row = LineMetrics::default();
        figures.iter().for_each(|(m, v)| row.put(m, *v));
        judge(&facts(&row, settings))[0].cause.clone().unwrap_or_default()
    };
    let off = cause(&[("bias_error", -353.0)], given(5.0));
    assert!(off.contains("the measurement has a bias (bias_error -353.0 nT)"), "{off}");
    let taken = NavigationSettings { offset_window_s: 60.0, ..given(5.0) };
    assert!(!cause(&[("bias_error", -353.0)], taken).contains("bias_error"));
    let left = cause(&[("std_error", 14.0)], given(5.0));
    assert!(
        left.contains("the residual of compensation is 14.00 nT (std_error), but `measurement_sigma_nt` is 5.000 nT"),
        "{left}"
    );
    let height = cause(&[("map_height_error", 12.0)], given(5.0));
    assert!(height.contains("at a different height from the flight (12.00 nT rms)"), "{height}");
    let map = cause(&[("samples_off_map", 40.0)], given(5.0));
    assert!(map.contains("40 % of the measurements are off the map"), "{map}");
    let date = cause(&[], NavigationSettings { dates: Some((2015.5, 2020.4)), ..given(5.0) });
    assert!(date.contains("`decimal_year` is 2015.50, but the date in the flight is 2020.40"), "{date}");
    assert_eq!(cause(&[], given(5.0)), "");
}

#[test]
fn unit_shares_are_of_the_measurements_that_a_filter_considers() {
    // Of 100 samples, the filter considers 20.
    let row = LineMetrics::from([("samples_used", 4.0), ("samples_gated", 1.0), ("samples_off_map", 15.0)]);
    assert_eq!((row.off_map(), row.gated()), (Some(0.75), Some(0.2)));
    assert_eq!(LineMetrics::from([("samples_off_map", 15.0)]).off_map(), Some(0.15));
    let nothing = LineMetrics::from([("samples_used", 0.0), ("samples_off_map", 0.0)]);
    assert_eq!(nothing.off_map(), Some(0.0));
}

#[test]
fn unit_the_truth_is_not_flagged() {
    let bound = LineMetrics::from([("drms", 0.0), ("ins_drms", 900.0), ("nees", 0.0), ("nis", 1.0)]);
    assert!(judge(&facts(&bound, given(5.0))).is_empty());
}

#[test]
fn unit_a_filter_that_rejects_many_measurements_is_flagged_without_truth() {
    let of = |gated: f64| {
        let row = LineMetrics::from([("nis", 1.0), ("samples_gated", gated), ("samples_used", 100.0 - gated)]);
        kinds(&judge(&facts(&row, given(5.0))))
    };
    assert!(of(4.0).is_empty());
    assert_eq!(of(38.0), ["gated"]);
    assert!(WarningKind::Gated.spoils());
}

#[test]
fn unit_a_map_at_another_height_is_flagged() {
    let row = LineMetrics::from([("map_height_error", 3.0)]);
    // Half of 5 nT is 2.5 nT; for 20 nT, the limit is the 5 nT of a good map.
    assert_eq!(kinds(&judge(&facts(&row, given(5.0)))), ["map_height"]);
    assert!(judge(&facts(&row, given(20.0))).is_empty());
    assert_eq!(limits::map_height_nt(None), 5.0);
    assert!(!WarningKind::MapHeight.spoils() && WarningKind::NisLow.spoils() && WarningKind::NotWhite.spoils());
}

#[test]
fn unit_a_wide_start_is_flagged() {
    let row = LineMetrics::from([("nis", 1.0)]);
    let of = |start_m| judge(&facts(&row, NavigationSettings { start_m, ..given(5.0) }));
    let found = of(Some((1500.0, 285.0)));
    assert_eq!(kinds(&found), ["wide_start"]);
    assert_eq!((found[0].value, found[0].limit, found[0].unit), (1500.0, 285.0, "m"));
    assert!(found[0].text.contains("1500 m") && found[0].text.contains("285 m"), "{}", found[0].text);
    assert_eq!(found[0].cause, None);
    // A start known to tens of metres, an unknown range, and a filter that does not linearise the map.
    assert!(
        [Some((30.0, 285.0)), Some((300.0, 285.0)), Some((1500.0, f64::NAN)), None]
            .into_iter()
            .all(|start| of(start).is_empty())
    );
    // A filter that diverged from a wide start has this cause first.
    let lost = LineMetrics::from([("drms", 9000.0), ("ins_drms", 900.0), ("nis", 1.0)]);
    let found = judge(&facts(&lost, NavigationSettings { start_m: Some((1500.0, 285.0)), ..given(5.0) }));
    assert_eq!(kinds(&found), ["worse_than_ins", "wide_start"]);
    assert!(found[0].cause.as_ref().unwrap().starts_with("the standard deviation of the initial position is 1500 m"));
}

#[test]
fn unit_a_significant_lag_is_flagged() {
    let row = LineMetrics::from([("nis", 1.0)]);
    let of = |lag_s| judge(&facts(&row, NavigationSettings { lag_s, ..given(5.0) }));
    let found = of(Some((0.6, 0.04)));
    assert_eq!(kinds(&found), ["late"]);
    assert_eq!((found[0].value, found[0].unit), (0.6, "s"));
    assert!(found[0].text.contains("0.60 s late (standard deviation 0.04 s)"), "{}", found[0].text);
    assert!(of(Some((-0.3, 0.02)))[0].text.contains("0.30 s early"));
    assert!(
        [Some((0.1, 0.04)), Some((0.03, 0.001)), Some((0.0, f64::NAN)), None].into_iter().all(|lag| of(lag).is_empty())
    );
}

#[test]
fn unit_a_significant_height_bias_is_flagged() {
    let row = LineMetrics::from([("nis", 1.0)]);
    let of = |height_bias_m| judge(&facts(&row, NavigationSettings { height_bias_m, ..given(5.0) }));
    let found = of(Some((61.0, 4.0)));
    assert_eq!(kinds(&found), ["height_bias"]);
    assert_eq!((found[0].value, found[0].limit, found[0].unit), (61.0, 16.0, "m"));
    assert!(found[0].text.contains("61 m above the height of the INS"), "{}", found[0].text);
    assert!(found[0].cause.as_ref().unwrap().contains("add 61 m to `ins_alt`"), "{:?}", found[0].cause);
    let low = of(Some((-30.0, 2.0)));
    assert!(low[0].text.contains("30 m below") && low[0].cause.as_ref().unwrap().contains("add -30 m"));
    assert!(
        [Some((30.0, 8.0)), Some((9.0, 0.5)), Some((0.0, f64::NAN)), None].into_iter().all(|bias| of(bias).is_empty())
    );
}

#[test]
fn unit_a_constant_estimated_on_a_lost_line_has_no_remedy_of_its_own() {
    let rows = [
        (LineMetrics::from([("drms", 9000.0), ("ins_drms", 900.0)]), None),
        (LineMetrics::from([("drms", 90.0), ("ins_drms", 900.0), ("nees", 80.0)]), None),
        (LineMetrics::from([("nis", 1.0)]), Some((1500.0, 285.0))),
    ];
    for (row, start_m) in rows {
        let settings =
            NavigationSettings { lag_s: Some((0.6, 0.04)), height_bias_m: Some((610.0, 4.0)), start_m, ..given(5.0) };
        let found = judge(&facts(&row, settings));
        for kind in [WarningKind::Late, WarningKind::HeightBias] {
            let cause = found.iter().find(|w| w.kind == kind).unwrap().cause.clone().unwrap();
            assert!(cause.starts_with("the filter lost the position") && !cause.contains("`ins_alt`"), "{cause}");
        }
    }
    let consistent = LineMetrics::from([("drms", 90.0), ("ins_drms", 900.0), ("nees", 2.1)]);
    let found = judge(&facts(&consistent, NavigationSettings { lag_s: Some((0.6, 0.04)), ..given(5.0) }));
    assert!(found[0].cause.as_ref().unwrap().contains("`lag_s` of `resample`"));
}

fn warning(kind: WarningKind, value: f64, limit: f64, line: &str) -> Warning {
    Warning {
        stage: "scores".into(),
        point: [("mag".to_owned(), Literal::Text("mag_4_uc".into()))].into(),
        line: Some(("1".into(), line.into())),
        kind,
        value: Some(value),
        limit: Some(limit),
        unit: "m",
        text: format!("{}: drms {value}", kind.of_many()),
        cause: Some("a cause".into()),
    }
}

#[test]
fn gold_many_warnings_are_summarised_by_the_worst_of_each_kind() {
    let all = [
        warning(WarningKind::WorseThanIns, 20.0, 10.0, "1.01"),
        warning(WarningKind::NisLow, 0.004, 0.25, "1.01"),
        warning(WarningKind::WorseThanIns, 90.0, 10.0, "1.02"),
    ];
    let lines = summary_lines(&all, "p.warnings");
    assert_eq!(
        lines,
        [
            "scores: the filter is worse than the INS alone at 2 places, worst (mag = mag_4_uc, flight 1, line 1.02): \
             drms 90\n  likely cause: a cause",
            "scores (mag = mag_4_uc, flight 1, line 1.01): the filter is cautious: the innovations are far smaller \
             than it predicts: drms 0.004\n  likely cause: a cause",
            "3 warnings; the table `p.warnings` lists all",
        ]
    );
    assert!(super::summary_lines(&[], "p.warnings").is_empty());
}

#[test]
fn unit_only_spoiling_warnings_flag_a_row() {
    use crate::scores::Scores;
    let rows = vec![(vec!["mag_4_uc".to_owned()], vec![]), (vec!["mag_5_uc".to_owned()], vec![])];
    let mut scores = Scores {
        axes: vec!["mag".into()],
        metrics: vec![],
        rows,
        lines: 2,
        marks: vec![],
        cautious: vec![],
        in_sample: vec![],
    };
    let map = warning(WarningKind::MapHeight, 9.0, 2.5, "1.03");
    scores.mark(
        "scores",
        &[
            warning(WarningKind::WorseThanIns, 20.0, 10.0, "1.01"),
            warning(WarningKind::NeesHigh, 90.0, 20.0, "1.01"),
            warning(WarningKind::NisLow, 0.004, 0.25, "1.02"),
            map,
        ],
    );
    // Two lines are flagged, one of them for two reasons.
    assert_eq!(scores.marks, [2, 0]);
    assert!(!scores.is_cautious(0) && !scores.is_cautious(1));
    scores.mark("scores", &[warning(WarningKind::NisLow, 0.004, 0.25, "1.02")]);
    assert!(scores.marks == [1, 0] && scores.is_cautious(0) && !scores.is_cautious(1));
    scores.mark("other", &[warning(WarningKind::WorseThanIns, 20.0, 10.0, "1.01")]);
    assert_eq!(scores.marks, [0, 0]);
}

#[test]
fn unit_a_line_over_a_flat_map_is_flagged() {
    let mut row = LineMetrics::from([("drms", 20.0), ("ins_drms", 30.0), ("samples_flat", 40.0)]);
    assert!(judge(&facts(&row, given(5.0))).is_empty());
    row.put("samples_flat", 60.0);
    let warnings = judge(&facts(&row, given(5.0)));
    assert_eq!((warnings.len(), warnings[0].kind, warnings[0].value), (1, WarningKind::Flat, 0.6));
    assert!(
        warnings[0].text.contains("60 % of the measurements") && warnings[0].cause.is_some(),
        "{}",
        warnings[0].text
    );
}

#[test]
fn unit_settings_follow_from_parameters_and_columns() {
    let params = |pairs: &[(&'static str, &str)]| -> Vec<(&'static str, String)> {
        pairs.iter().map(|(name, value)| (*name, (*value).to_owned())).collect()
    };
    let first = |side: NavigationSide, name: &str| {
        Ok(match (side, name) {
            (NavigationSide::Flight, "mag_sigma") => Some(7.0),
            (NavigationSide::Track, "noise_sigma") => Some(2.5),
            (NavigationSide::Flight, "year") => Some(2020.0),
            (NavigationSide::Flight, "doy") => Some(183.0),
            _ => None,
        })
    };
    let given = [
        ("measurement_sigma_nt", "auto"),
        ("fogm_sigma_nt", "3.0"),
        ("offset_window_s", "1.0"),
        ("map_levels_m", "none"),
        ("core_field", "true"),
        ("decimal_year", "2015.5"),
    ];
    let settings = NavigationSettings::new(&params(&given), first).unwrap();
    // An estimate of the track replaces the parameter.
    assert_eq!(settings.sigma_nt, Some(2.5));
    assert!(settings.found && !settings.levels && settings.offset_window_s == 1.0);
    let (declared, flight) = settings.dates.unwrap();
    assert!(declared == 2015.5 && (flight - 2020.5).abs() < 0.01, "{flight}");
    let fixed = params(&[("measurement_sigma_nt", "4.0"), ("core_field", "false"), ("decimal_year", "2015.5")]);
    let settings = NavigationSettings::new(&fixed, |_, _| Ok(None)).unwrap();
    assert_eq!((settings.sigma_nt, settings.dates), (Some(4.0), None));
}

#[test]
fn unit_warnings_of_a_navigation_have_no_place() {
    let row = LineMetrics::from([("nis", 9.0)]);
    let found = of_navigation(&row, given(2.0));
    assert_eq!(found.iter().map(|one| one.kind).collect::<Vec<_>>(), [WarningKind::NisHigh]);
    assert!(found[0].place().is_empty() && found[0].cause.is_none());
}
