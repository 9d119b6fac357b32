//! List of all metrics.

use super::{map, metric::Scorer, signal, track};

/// All metrics, in the order of the table of scores.
pub const SCORERS: &[&Scorer] = &[
    &signal::STD_ERROR,
    &signal::BIAS_ERROR,
    &signal::RMS_ERROR,
    &signal::STD_UNCOMPENSATED,
    &signal::IMPROVEMENT_RATIO,
    &signal::IMPROVEMENT_RATIO_BAND,
    &signal::SNR,
    &signal::ANOMALY_RETENTION,
    &signal::ANOMALY_RETENTION_SE,
    &signal::FIGURE_OF_MERIT,
    &signal::FIGURE_OF_MERIT_CROSSINGS,
    &track::DRMS,
    &track::DRMS_BOUND,
    &track::CEP,
    &track::R95,
    &track::RMS_NORTH,
    &track::RMS_EAST,
    &track::RMS_DOWN,
    &track::MRSE,
    &track::RMS_VN,
    &track::RMS_VE,
    &track::RMS_VD,
    &track::RMS_SPEED,
    &track::INS_DRMS,
    &track::NEES,
    &track::NIS,
    &track::NEES_CONSISTENT,
    &track::NIS_CONSISTENT,
    &track::WHITENESS,
    &track::CORRELATED_NIS,
    &track::ERROR_WITHIN_3SIGMA,
    &track::DIVERGENCE,
    &track::SAMPLES_USED,
    &track::SAMPLES_MISSING,
    &track::SAMPLES_OFF_MAP,
    &track::SAMPLES_GATED,
    &track::SAMPLES_FLAT,
    &track::GNSS_REJECTED,
    &map::MAP_HEIGHT_ERROR,
    &map::MAP_STD_ERROR,
    &map::MAP_BIAS_ERROR,
    &map::MAP_GRADIENT_ALONG_TRACK,
    &map::MAP_POSITION_BOUND,
];

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use schemas::{
        LineInput, Stage, Table, TableShape, is_unit,
        metric::{Metric, PoolingRule},
    };

    use super::*;
    use crate::score::{SampleStatistic, ScoreLine};
    use crate::score::{
        Score,
        source::ScoreSourceIndex,
        testing::{TRUE_POSITION, line, only, score, seconds, shapes, track},
    };

    #[test]
    fn unit_every_metric_has_a_unique_name_a_known_unit_and_a_meaning() {
        let names: BTreeSet<&str> = SCORERS.iter().map(|s| s.metric.name).collect();
        assert_eq!(names.len(), SCORERS.len());
        for Metric { name, unit, meaning, .. } in SCORERS.iter().map(|s| s.metric) {
            assert!(is_unit(unit) || ["1", "nT/m"].contains(&unit), "{name}: {unit}");
            assert!(!meaning.is_empty() && !meaning.starts_with(' ') && !meaning.ends_with('.'), "{name}: {meaning}");
        }
    }

    #[test]
    fn unit_display_positions_are_unique_and_ranking_metrics_have_a_column() {
        for place in [|m: &Metric| m.shown.column, |m: &Metric| m.shown.rank] {
            let taken: Vec<u16> = SCORERS.iter().map(|s| &s.metric).filter_map(place).collect();
            assert_eq!(taken.iter().collect::<BTreeSet<_>>().len(), taken.len(), "{taken:?}");
        }
        for m in SCORERS.iter().map(|s| &s.metric).filter(|m| m.shown.rank.is_some() || m.shown.heat_map) {
            assert!(m.shown.column.is_some() && m.better.cost(1.0).is_some(), "{}", m.name);
        }
    }

    #[test]
    fn unit_pooling_rules_match_the_kinds_of_errors() {
        for (m, spread) in SCORERS.iter().map(|s| (&s.metric, s.spread)) {
            let pool = match m.name {
                "cep" => PoolingRule::Quantile(50),
                "r95" => PoolingRule::Quantile(95),
                "bias_error" | "map_bias_error" => PoolingRule::Mean,
                "anomaly_retention_se" => PoolingRule::Error,
                name if name.starts_with("samples_") || name == "gnss_rejected" => PoolingRule::Sum,
                _ if m.unit == "1" => PoolingRule::Mean,
                _ => PoolingRule::Rms,
            };
            assert_eq!(m.pool, pool, "{}", m.name);
            assert_eq!(spread.is_some(), matches!(pool, PoolingRule::Quantile(_)), "{}", m.name);
        }
    }

    /// A calibration box on four headings and its track, with all columns that metrics read.
    fn everything() -> LineInput {
        let angle = |at: usize| seconds(400, move |t| (t as usize / 10 % 3 == at) as u8 as f64 * 5.0 * (0.9 * t).sin());
        let heading = seconds(400, |t| 90.0 * (t / 100.0).floor());
        let yaw = angle(2).iter().zip(&heading).map(|(y, h)| y + h).collect();
        let (lat, lon) = (seconds(400, |t| 50.0 + 1e-6 * t), seconds(400, |t| 8.0 + 1e-4 * (t % 100.0)));
        let wave = |f: f64| seconds(400, move |t| 10.0 * (f * t).cos());
        let field = |f: f64| wave(f).iter().map(|w| 52_000.0 + w).collect::<Vec<f64>>();
        let truth = vec![
            ("mag_c", field(1.1)),
            ("mag_aircraft", wave(1.3)),
            ("mag_1_c", field(0.2)),
            ("igrf", field(0.01)),
            ("diurnal", wave(0.02)),
            ("anomaly_truth", wave(0.2)),
            ("roll", angle(0)),
            ("pitch", angle(1)),
            ("yaw", yaw),
            ("map_anomaly", wave(0.3)),
            ("map_grad_n", wave(0.4)),
            ("map_grad_e", wave(0.5)),
            (TRUE_POSITION[0], lat.clone()),
            (TRUE_POSITION[1], lon.clone()),
            ("true alt", seconds(400, |t| 299.0 + (0.3 * t).sin())),
            ("true vn", seconds(400, |_| 50.0)),
            ("true ve", seconds(400, |t| 3.0 * (0.1 * t).sin())),
            ("true vd", seconds(400, |_| 0.0)),
            ("ins_lat", lat.iter().map(|x| x + 1e-3).collect()),
            ("ins_lon", lon.clone()),
        ];
        let mut track = track(lat.iter().map(|x| x + 1e-4).collect(), lon);
        track.extend([("map_height_error", wave(0.6)), ("residual", wave(0.7)), ("map_slope", wave(0.8))]);
        let velocity = [("vn", seconds(400, |_| 51.0)), ("ve", wave(0.1)), ("vd", wave(0.2))];
        track.extend(velocity);
        line(&[truth, track])
    }

    /// The scores of `stage`, which receives only the columns that it declares.
    fn scored(stage: &Score, line: &LineInput) -> Vec<(&'static str, SampleStatistic)> {
        let tables: Vec<Table> = shapes(line).into_iter().map(Table::Lines).collect();
        let reads = stage.yields(&tables.iter().collect::<Vec<_>>()).unwrap().reads;
        let only = |(batch, names): (&arrow_array::RecordBatch, &Vec<String>)| {
            let places: Vec<usize> = names.iter().map(|n| batch.schema().index_of(n).unwrap()).collect();
            batch.project(&places).unwrap()
        };
        let line = LineInput { inputs: line.inputs.iter().zip(&reads).map(only).collect(), ..line.clone() };
        let shapes: Vec<TableShape> = shapes(&line);
        let places = ScoreSourceIndex::find(stage, &shapes.iter().collect::<Vec<_>>());
        let columns = ScoreLine::new(stage, &line, &places);
        stage.chosen(&places).iter().map(|s| (s.metric.name, (s.score)(&columns).unwrap())).collect()
    }

    #[test]
    fn unit_a_metric_does_not_depend_on_the_other_metrics() {
        let line = everything();
        let all = scored(&score(), &line);
        // A track has errors or is a bound, not both.
        let names: Vec<&str> = SCORERS.iter().map(|s| s.metric.name).filter(|name| *name != "drms_bound").collect();
        assert_eq!(all.iter().map(|(name, _)| *name).collect::<Vec<_>>(), names);
        for (name, figure) in all {
            let alone = scored(&Score { metrics: only(name), ..score() }, &line);
            // `anomaly_retention` is always scored with its standard error.
            assert_eq!(alone.len(), if name == "anomaly_retention" { 2 } else { 1 }, "{name}");
            let own = alone.iter().find(|(of, _)| *of == name).unwrap().1;
            assert_eq!((own.value.to_bits(), own.n), (figure.value.to_bits(), figure.n), "{name}");
        }
    }

    /// The value of every metric to seven digits. A changed value needs a new version of `score`.
    #[test]
    fn gold_metric_values_are_unchanged() {
        let mut now = format!("version {}\n", Score::entry().version);
        for (name, SampleStatistic { value, n }) in scored(&score(), &everything()) {
            now += &format!("{name} {value:.6e} {n}\n");
        }
        let kept = include_str!("versions.txt");
        assert!(now == kept, "a metric moved: raise the version and write into stages/src/score/versions.txt\n{now}");
    }
}
