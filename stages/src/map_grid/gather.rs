//! Lines of a survey, gathered for the points of a sweep.

use std::collections::BTreeMap;

use arrow_array::{RecordBatch, cast::AsArray, types::Int64Type};
use grids::SurveyPointSet;
use schemas::{CheckpointMonitor, Fault, LineInput, StageOutput, SurveyAggregator};

use super::{MapGrid, columns, points};
use crate::columns::floats;

/// Points of a sweep over the same lines.
pub struct MapGridAggregator {
    stages: Vec<MapGrid>,
}

/// Rows of a line that are selected and have a position.
pub struct MapGridLine {
    name: String,
    /// Rows of the line.
    rows: Vec<u64>,
    columns: BTreeMap<String, Vec<f64>>,
}

impl MapGridAggregator {
    /// Gathers survey lines for these points of a sweep.
    pub fn new(stages: Vec<&MapGrid>) -> MapGridAggregator {
        MapGridAggregator { stages: stages.into_iter().cloned().collect() }
    }
}

impl SurveyAggregator for MapGridAggregator {
    type Part = MapGridLine;

    fn map(&self, line: &LineInput) -> Result<MapGridLine, Fault> {
        let batch = line.inputs.first().ok_or_else(|| Fault::bug("a survey without lines"))?;
        let (lat, lon) = (floats(batch, "lat")?, floats(batch, "lon")?);
        let kept = |row: &usize| {
            let selected = line.keep.as_ref().is_none_or(|keep| keep.get(*row).copied().unwrap_or(false));
            selected && lat[*row].is_finite() && lon[*row].is_finite()
        };
        let rows: Vec<usize> = (0..batch.num_rows()).filter(kept).collect();
        let mut columns = BTreeMap::new();
        for field in batch.schema().fields() {
            let values = numbers(batch, field.name())?;
            columns.insert(field.name().clone(), rows.iter().map(|row| values[*row]).collect());
        }
        let name = format!("{} {}", line.flight, line.line);
        Ok(MapGridLine { name, rows: rows.into_iter().map(|row| row as u64).collect(), columns })
    }

    fn refused(&self, part: &MapGridLine) -> Vec<(usize, Fault)> {
        let lacks = |stage: &MapGrid| {
            let lacking = stage.reads().into_iter().find(|name| !part.columns.contains_key(*name))?;
            Some(Fault::data(format!("the line has no column `{lacking}`")).in_column(lacking))
        };
        self.stages.iter().enumerate().filter_map(|(i, stage)| Some((i, lacks(stage)?))).collect()
    }

    fn finish(&self, parts: Vec<MapGridLine>, _: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>> {
        let parts: Vec<&MapGridLine> = parts.iter().collect();
        self.stages.iter().map(|stage| mapped(stage, &parts)).collect()
    }
}

/// Map of one point of the sweep.
fn mapped(stage: &MapGrid, parts: &[&MapGridLine]) -> Result<StageOutput, Fault> {
    let reads = stage.reads();
    let usable =
        |part: &&&MapGridLine| !part.rows.is_empty() && reads.iter().all(|name| part.columns.contains_key(*name));
    let parts: Vec<&MapGridLine> = parts.iter().filter(usable).copied().collect();
    let column = |name: &str| -> Option<Vec<f64>> {
        let one = |part: &&MapGridLine| part.columns.get(name).cloned();
        parts.iter().map(one).collect::<Option<Vec<Vec<f64>>>>().map(|all| all.concat())
    };
    let read = |name: &str| reads.contains(&name).then(|| column(name)).flatten();
    let (lat, lon) = (column("lat").unwrap_or_default(), column("lon").unwrap_or_default());
    let mut survey = SurveyPointSet::at(lat, lon, stage.epsg()?)?;
    let unknown = || vec![f64::NAN; survey.value_nt.len()];
    let (height_m, value_nt) = (column("alt").unwrap_or_else(unknown), column(&stage.value).unwrap_or_else(unknown));
    (survey.height_m, survey.value_nt) = (height_m, value_nt);
    survey.lines = parts.iter().map(|part| part.name.clone()).collect();
    survey.types = vec![None; survey.lines.len()];
    survey.line = parts.iter().zip(0u32..).flat_map(|(part, i)| vec![i; part.rows.len()]).collect();
    survey.row = parts.iter().flat_map(|part| part.rows.clone()).collect();
    survey.extra.diurnal_nt = read("diurnal");
    survey.extra.igrf_nt = read("igrf");
    survey.extra.year = read("year");
    survey.extra.doy = read("doy");
    survey.extra.tt_s = read("tt");
    let far = if stage.keep_outliers { vec![] } else { points::without_far(&mut survey) };
    let mut warnings: Vec<String> =
        far.first().map(|first| outlier_warning(far.len(), *first, &survey)).into_iter().collect();
    let unknown_height = survey.height_m.iter().all(|h| h.is_nan());
    warnings.extend(unknown_height.then(|| super::NO_HEIGHTS.to_owned()));
    Ok(StageOutput { columns: columns(&stage.apply(&mut survey, &|_, _, _| ())?)?, warnings })
}

/// Warning about omitted points that are far from all others.
fn outlier_warning(far: usize, first: usize, survey: &SurveyPointSet) -> String {
    let many = if far == 1 { "1 point is".to_owned() } else { format!("{far} points are") };
    let line = survey.line.get(first).and_then(|line| survey.lines.get(*line as usize));
    let line = line.map_or(String::new(), |line| format!(" of line {line}"));
    format!(
        "{many} far from all others and omitted, the first in row {}{line} at latitude {:.5}, longitude {:.5}; \
         `keep_outliers = true` keeps such points",
        survey.row.get(first).copied().unwrap_or_default(),
        survey.lat_deg.get(first).copied().unwrap_or(f64::NAN),
        survey.lon_deg.get(first).copied().unwrap_or(f64::NAN),
    )
}

/// Values of a column of numbers or integers. NaN for null.
fn numbers(batch: &RecordBatch, name: &str) -> Result<Vec<f64>, Fault> {
    let whole = batch.column_by_name(name).and_then(|array| array.as_primitive_opt::<Int64Type>());
    match whole {
        Some(whole) => Ok(whole.iter().map(|x| x.map_or(f64::NAN, |x| x as f64)).collect()),
        None => floats(batch, name).map(<[f64]>::to_vec),
    }
}
