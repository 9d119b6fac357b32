//! Appends the position accuracy that a map permits.

use arrow_array::RecordBatch;
use numerics::{
    maps::{
        information::{WindowInformation, sample_bound_m, window_bounds_m},
        map_stack::FieldMap,
        map_surface::MapInterpolation,
    },
    signal::segments::check_increasing,
};
use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, stage};

use crate::{
    columns::{array, data, faults_of, floats, role_of, shape},
    core_field::PositionSource,
    map_value::looked_up,
    maps::{check_levels, field_map},
};

stage! {
    /// Appends measures of a map's usefulness for navigation along a planned or flown track. `map_gradient_n` and
    /// `map_gradient_e` are the slopes of the map to the north and east, and `map_gradient` is the magnitude of the
    /// slope. `map_sd_sample` is the standard deviation of the position, along that slope, from one measurement.
    /// `map_sd_expected` is the expected root mean square horizontal error from the measurements within `window_s`
    /// about the sample. Use `map_quality` to plan flights over informative parts of a map, and to find where the map
    /// limits the accuracy of any filter.
    ///
    /// `map_sd_sample` is `sigma_nt` divided by `map_gradient`. `map_sd_expected` is the Cramér-Rao bound: the square
    /// root of the trace of the inverse Fisher information sum(g g')/`sigma_nt`^2 of the slopes g in the window. The
    /// bound holds for an unbiased filter that has exact knowledge of its motion within the window but no earlier
    /// position. The bound assumes independent sample errors with standard deviation `sigma_nt`. At ten samples per
    /// second, however, errors of the map and of the temporal variation are correlated. In this case, multiply
    /// `sigma_nt` by the square root of the number of samples within the correlation time. `unknown_constant` subtracts
    /// the mean slope, which gives the bound for a measurement with an unknown constant. `map_position_bound` of
    /// `score` is the bound with an unknown constant over the whole line.
    ///
    /// All columns are NaN for a sample off the map, in a cell with an unknown node, or without a position. Both
    /// standard deviations are NaN where the map is flat. `map_sd_expected` is also NaN where all slopes in the window
    /// have one direction. The slope of the core field is not included.
    ///
    /// A line is rejected if none of its samples is on the map, or if its times do not increase.
    ///
    /// Source: Kay 1993, section 3.7; Gnadt 2022, section 2.3.
    MapQuality = "map_quality", version 2, grain Line, inputs [input: Lines, map: Map],
    example r#"
[[stages]]
name     = "map_quality"
stage    = "map_quality"
input    = "resample"
map      = "anomaly"
window_s = 20.0
"#;
    /// Position at which the map is evaluated: the true position (`lat`, `lon`, `alt`) or the INS position. Columns
    /// computed at the true position have the role truth; a model can use them as features only with `allow_truth`.
    position: PositionSource, unit "", default PositionSource::Truth;
    /// Standard deviation of the error of each sample, including errors of the sensor, the map and the compensation.
    sigma_nt: f64, unit "nT", default 5.0, rule Rule::Positive;
    /// Length of the window about each sample.
    window_s: f64, unit "s", default 60.0, rule Rule::Positive;
    /// Assumes that the measurement contains an unknown constant.
    unknown_constant: bool, unit "", default false;
    /// Interpolation of the map. The field above its sources is smooth, so spline interpolation is more accurate than
    /// bilinear interpolation.
    map_interpolation: MapInterpolation, unit "", default MapInterpolation::Cubic;
    /// Heights above the WGS-84 ellipsoid, ascending, to which the map is continued.
    map_levels_m: Option<Vec<f64>>, unit "m", absent "the map is used at its own height";
}

impl Stage for MapQuality {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let place = self.position.columns();
        let units = ["deg", "deg", "m"];
        let mut faults = faults_of(place.iter().zip(units).map(|(c, unit)| shape.number(c, unit)), "position");
        faults.extend(check_levels(self.map_levels_m.as_ref(), "map_levels_m"));
        if !faults.is_empty() {
            return Err(faults);
        }
        // The slope of the map at the true position reveals the position, so it cannot be a feature.
        let role = role_of(shape, &place);
        let made = |name: &str, unit: &str, doc: &str| {
            Column::float(name, unit, doc).role(role).from(0, &place).from(1, &["anomaly"])
        };
        let columns = vec![
            made("map_gradient_n", "nT/m", "slope of the map to the north"),
            made("map_gradient_e", "nT/m", "slope of the map to the east"),
            made("map_gradient", "nT/m", "magnitude of the slope of the map"),
            made(
                "map_sd_sample",
                "m",
                "expected standard deviation of one position measurement along the slope; NaN on a flat map",
            ),
            made(
                "map_sd_expected",
                "m",
                "expected root mean square horizontal error of a position estimated from a window; NaN if the map does \
                 not determine a position",
            )
            .from(0, &["tt"]),
        ];
        let map = ["lat", "lon", "alt", "anomaly"].map(str::to_owned).to_vec();
        let reads: Vec<String> = ["tt"].into_iter().chain(place).map(str::to_owned).collect();
        Ok(StageSchema { reads: vec![reads.clone(), map], ..StageSchema::append(columns, &reads) })
    }
}

impl LineStage for MapQuality {
    type Prepared = FieldMap;

    fn run(&self, line: &LineInput, map: &FieldMap) -> LineOutput {
        let batch = &line.inputs[0];
        let tt = floats(batch, "tt")?;
        check_increasing(tt).map_err(|e| data(e).in_column("tt"))?;
        let [lat, lon, alt] = self.position.columns();
        let [_, north, east, _] = looked_up(map, floats(batch, lat)?, floats(batch, lon)?, floats(batch, alt)?)?;
        let MapQuality { window_s, sigma_nt, unknown_constant, .. } = *self;
        let slopes = || north.iter().zip(&east);
        let size = slopes().map(|(n, e)| n.hypot(*e)).collect();
        let sample = slopes().map(|(n, e)| sample_bound_m(*n, *e, sigma_nt)).collect();
        let window = window_bounds_m(tt, &north, &east, WindowInformation { window_s, sigma_nt, unknown_constant });
        Ok([north, east, size, sample, window].map(array).into())
    }

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<FieldMap, Fault> {
        let map = inputs.get(1).ok_or_else(|| Fault::data("the map is missing"))?;
        field_map(map, self.map_interpolation, self.map_levels_m.as_deref())
    }

    fn prepare_key(&self) -> String {
        format!("{} {:?}", self.map_interpolation.word(), self.map_levels_m)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{cast::AsArray, types::Float64Type};
    use schemas::TableShape;

    use super::*;

    /// Metres of a degree of latitude and of longitude at 45 degrees, on the ellipsoid (WGS-84).
    const DEGREE_M: [f64; 2] = [111_131.8, 78_846.8];

    fn map_quality() -> MapQuality {
        MapQuality {
            position: PositionSource::Truth,
            sigma_nt: 5.0,
            window_s: 60.0,
            unknown_constant: false,
            map_interpolation: MapInterpolation::Cubic,
            map_levels_m: None,
        }
    }

    fn batch(columns: Vec<(&str, Vec<f64>)>) -> RecordBatch {
        RecordBatch::try_from_iter(columns.into_iter().map(|(name, x)| (name, array(x)))).unwrap()
    }

    /// Map of a field defined in metres north and east of 45 degrees north, 75 degrees west: 121 by 121 nodes, 40 m
    /// apart.
    fn map(field: impl Fn(f64, f64) -> f64) -> RecordBatch {
        let nodes = || (-60..=60).flat_map(|row| (-60..=60).map(move |column| (f64::from(row), f64::from(column))));
        let step = DEGREE_M.map(|m| 40.0 / m);
        batch(vec![
            ("lat", nodes().map(|(row, _)| 45.0 + step[0] * row).collect()),
            ("lon", nodes().map(|(_, column)| -75.0 + step[1] * column).collect()),
            ("alt", vec![300.0; 121 * 121]),
            ("anomaly", nodes().map(|(row, column)| field(40.0 * row, 40.0 * column)).collect()),
        ])
    }

    /// A line through positions in metres north and east, one per second.
    fn run(stage: &MapQuality, map: &RecordBatch, places: &[[f64; 2]]) -> Result<Vec<Vec<f64>>, Fault> {
        let line_batch = batch(vec![
            ("tt", (0..places.len()).map(|k| 100.0 + k as f64).collect()),
            ("lat", places.iter().map(|p| 45.0 + p[0] / DEGREE_M[0]).collect()),
            ("lon", places.iter().map(|p| -75.0 + p[1] / DEGREE_M[1]).collect()),
            ("alt", vec![0.0; places.len()]),
        ]);
        let prepared = stage.prepare(&[line_batch.slice(0, 0), map.clone()]).unwrap();
        let line = LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![line_batch], keep: None };
        let arrays = stage.run(&line, &prepared)?;
        Ok(arrays.iter().map(|a| a.as_primitive::<Float64Type>().values().to_vec()).collect())
    }

    #[test]
    fn law_a_plane_has_a_slope_and_no_position_bound() {
        let plane = map(|north, east| 0.03 * north - 0.04 * east);
        let east: Vec<[f64; 2]> = (-30..=30).map(|k| [0.0, 60.0 * f64::from(k)]).collect();
        let made = run(&map_quality(), &plane, &east).unwrap();
        // From 45 degrees to the parallel of the line, the length of a degree of longitude changes by a fraction of
        // 7e-5.
        for (column, expected) in [(0, 0.03), (1, -0.04), (2, 0.05), (3, 100.0)] {
            assert!(made[column].iter().all(|x| (x / expected - 1.0).abs() < 1e-4), "{column}: {:?}", made[column][30]);
        }
        assert!(made[4].iter().all(|bound| bound.is_nan()), "{:?}", made[4]);
        let flat = run(&map_quality(), &map(|_, _| 7.0), &east).unwrap();
        assert!(flat[2].iter().all(|x| *x == 0.0) && flat[3].iter().chain(&flat[4]).all(|x| x.is_nan()));
    }

    #[test]
    fn law_the_bound_over_whole_periods_of_waves_is_exact() {
        // The field is A sin(k n) + A sin(2 k e) with a wavelength of 2400 m, flown on a diagonal. Over whole periods
        // the slopes north and east are uncorrelated, and J = N A² k²/2 diag(1, 4)/σ².
        let (a, k) = (50.0, std::f64::consts::TAU / 2400.0);
        let waves = map(|north, east| a * (k * north).sin() + a * (2.0 * k * east).sin());
        // A period has 96 steps of 25 m north and east: 48 before and 47 after a sample.
        let diagonal: Vec<[f64; 2]> = (-90..=90).map(|step| [25.0 * f64::from(step); 2]).collect();
        for unknown_constant in [false, true] {
            let stage = MapQuality { window_s: 95.0, unknown_constant, ..map_quality() };
            let made = run(&stage, &waves, &diagonal).unwrap();
            let n = 95.0;
            let expected = 5.0 * ((1.0 + 0.25) * 2.0 / (n * a * a * k * k)).sqrt();
            // The errors arise because a period has one sample more than the window, and because the nodes of the
            // spline are 40 m apart.
            assert!((made[4][90] / expected - 1.0).abs() < 0.02, "{} {expected}", made[4][90]);
            let slope = (a * k).hypot(2.0 * a * k);
            assert!((made[2][90] / slope - 1.0).abs() < 1e-2 && (made[3][90] * slope / 5.0 - 1.0).abs() < 1e-2);
        }
        // Four times the samples halve the bound, and so does half the noise.
        let of = |sigma_nt: f64, window_s: f64| {
            run(&MapQuality { sigma_nt, window_s, ..map_quality() }, &waves, &diagonal).unwrap()[4][90]
        };
        assert!((of(2.5, 95.0) / of(5.0, 95.0) - 0.5).abs() < 1e-12);
        assert!(of(5.0, 40.0) > of(5.0, 160.0));
    }

    #[test]
    fn unit_samples_off_the_map_are_nan() {
        let waves = map(|north, east| (0.01 * north).sin() + (0.02 * east).cos());
        let mut leaving: Vec<[f64; 2]> = (0..100).map(|k| [30.0 * f64::from(k), 10.0 * f64::from(k)]).collect();
        leaving[3][0] = f64::NAN;
        let made = run(&map_quality(), &waves, &leaving).unwrap();
        for column in &made {
            assert!(column[3].is_nan() && column[81..].iter().all(|x| x.is_nan()) && column[40].is_finite());
        }
        let fault = run(&map_quality(), &waves, &[[1e5, 0.0]]).unwrap_err();
        assert_eq!(fault.what, "no sample is on the map");
        let alone = run(&map_quality(), &waves, &[[10.0, 20.0]]).unwrap();
        assert!(alone[3][0].is_finite() && alone[4][0].is_nan(), "one sample has one slope");
    }

    #[test]
    fn unit_a_bound_at_the_true_position_is_truth() {
        let role = |position: PositionSource| {
            let place = position.columns();
            let of = |name: &str| if name.starts_with("ins") { schemas::Role::Sensor } else { schemas::Role::Truth };
            let mut columns: Vec<Column> = place
                .iter()
                .zip(["deg", "deg", "m"])
                .map(|(name, unit)| Column::float(*name, unit, "").role(of(name)))
                .collect();
            columns.push(Column::float("tt", "s", ""));
            let (lines, map) = (
                Table::Lines(TableShape { columns: columns.into(), rate_hz: None }),
                Table::Map(schemas::map::shape()),
            );
            let made = MapQuality { position, ..map_quality() }.yields(&[&lines, &map]).unwrap().columns;
            assert!(made.iter().all(|column| column.role == made[0].role));
            made[0].role
        };
        assert_eq!(role(PositionSource::Truth), schemas::Role::Truth);
        assert_eq!(role(PositionSource::Ins), schemas::Role::Derived);
    }

    #[test]
    fn unit_missing_positions_are_reported_and_time_must_ascend() {
        let lines =
            Table::Lines(TableShape { columns: vec![Column::float("ins_lat", "rad", "")].into(), rate_hz: None });
        let map_table = Table::Map(schemas::map::shape());
        let stage =
            MapQuality { position: PositionSource::Ins, map_levels_m: Some(vec![400.0, 300.0]), ..map_quality() };
        let faults = stage.yields(&[&lines, &map_table]).unwrap_err();
        let params: Vec<_> = faults.iter().filter_map(|f| f.param.as_deref()).collect();
        assert_eq!(params, ["position", "position", "position", "map_levels_m"], "{faults:?}");
        let twice =
            batch(vec![("tt", vec![1.0, 1.0]), ("lat", vec![45.0; 2]), ("lon", vec![-75.0; 2]), ("alt", vec![0.0; 2])]);
        let prepared = map_quality().prepare(&[twice.slice(0, 0), map(|_, _| 0.0)]).unwrap();
        let line = LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![twice], keep: None };
        assert_eq!(map_quality().run(&line, &prepared).unwrap_err().place.column.as_deref(), Some("tt"));
    }
}
