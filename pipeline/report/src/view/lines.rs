//! Lines of a table and their series.

use std::{
    collections::{HashMap, HashSet, VecDeque},
    sync::Arc,
};

use numerics::earth::geodesy::EarthModel;
use schemas::Fault;
use serde_json::{Value, json};

use super::{PublishedPipeline, StoreView, ViewFault, ViewPoint, table::ViewTable};
use crate::series::{DerivedColumn, SeriesColumn, SeriesPrecision, SeriesWindow, series};

/// Maximum number of columns of a request.
const MOST_COLUMNS: usize = 64;
/// Maximum number of intervals of a request.
const MOST_PIXELS: usize = 20_000;
/// Maximum number of values of an answer, so that all open answers fit in memory.
const MOST_VALUES: usize = 400_000;
/// Maximum number of samples of a line.
const MOST_ROWS: usize = 20_000_000;

/// Columns of the position, and columns of the INS position.
const POSITION: [&str; 2] = ["lat", "lon"];
const INS: [&str; 2] = ["ins_lat", "ins_lon"];

/// Request of a series.
#[derive(Clone, Debug, Default)]
pub struct SeriesRequest {
    /// The table, as PIPELINE.TABLE.
    pub table: String,
    /// The flight.
    pub flight: String,
    /// The line.
    pub line: String,
    /// The columns.
    pub columns: Vec<String>,
    /// The sweep point.
    pub point: ViewPoint,
    /// First time, in seconds.
    pub from: Option<f64>,
    /// Last time, in seconds.
    pub to: Option<f64>,
    /// Number of intervals.
    pub pixels: Option<usize>,
}

/// The derived columns of a table.
pub fn derived(pipeline: &PublishedPipeline, table: &ViewTable) -> Vec<DerivedColumn> {
    let columns = table.provider.columns();
    let field = |name: &str| columns.field_with_name(name).ok();
    let upstream = truth_table(pipeline, table);
    let has_truth = upstream.is_some();
    let has = |table: &ViewTable, name: &str| table.provider.columns().field_with_name(name).is_ok();
    let has_ins = upstream.is_some_and(|upstream| INS.iter().all(|name| has(table, name) || has(&upstream, name)));
    let truth = pipeline.notes.truth(short(&table.name));
    let has_field = field("mag_c").is_some() && field("error").is_none() && truth.is_some_and(|t| field(t).is_some());
    let fits = |column: &DerivedColumn| match column {
        DerivedColumn::Truth(_) | DerivedColumn::Estimate(_) => has_truth,
        DerivedColumn::Ins(_) => has_truth && has_ins,
        DerivedColumn::Field => has_field,
    };
    DerivedColumn::ALL.into_iter().filter(|column| fits(column) && field(column.about().name).is_none()).collect()
}

/// Nearest table upstream that has the true position, if the position of `table` is an estimate.
fn truth_table(pipeline: &PublishedPipeline, table: &ViewTable) -> Option<Arc<ViewTable>> {
    let has_position = |table: &ViewTable, wanted: &str| {
        let role = |name: &str| {
            table.provider.columns().field_with_name(name).ok().and_then(|f| f.metadata().get("role").cloned())
        };
        POSITION.iter().all(|name| role(name).as_deref() == Some(wanted))
    };
    if !has_position(table, "derived") {
        return None;
    }
    let (mut open, mut seen) = (VecDeque::from([short(&table.name)]), HashSet::new());
    while let Some(noted) = open.pop_front().and_then(|name| pipeline.notes.table(name)) {
        for input in noted.inputs.iter().filter(|input| seen.insert(input.as_str())) {
            let found = pipeline.table(input).ok().filter(|found| found.is_by_sample());
            if let Some(found) = found.filter(|found| has_position(found, "truth")) {
                return Some(found);
            }
            if pipeline.notes.table(input).is_some() {
                open.push_back(input.as_str());
            }
        }
    }
    None
}

fn short(table: &str) -> &str {
    table.split_once('.').map_or(table, |(_, name)| name)
}

impl StoreView {
    /// The lines of a table at a point, with their numbers of rows.
    ///
    /// # Errors
    /// Fails for an unknown table or point. Also fails if the store is damaged.
    pub fn lines(&self, table: &str, point: &ViewPoint) -> Result<Value, ViewFault> {
        let (_, table) = self.table(table)?;
        let columns = table.provider.columns();
        if ["flight", "line"].iter().any(|name| columns.field_with_name(name).is_err()) {
            return Err(ViewFault::Wrong(Fault::new(format!("`{}` has no lines", table.name))));
        }
        let index = table.index()?;
        let full = first_point(&table, point)?;
        let mut lines: Vec<(&(String, String), Vec<usize>)> = vec![];
        let mut at: HashMap<usize, usize> = HashMap::new();
        for unit in table.units(&full, None)? {
            let line = table.line_of(index, unit);
            let next = lines.len();
            let place = *at.entry(line).or_insert(next);
            if place == next {
                lines.push((&index.lines[line], vec![]));
            }
            lines[place].1.push(unit);
        }
        lines.sort();
        let mut found = vec![];
        for ((flight, line), units) in lines {
            let rows: usize = units.iter().map(|unit| table.rows(index, *unit)).sum();
            found.push(json!({ "flight": flight, "line": line, "rows": rows }));
        }
        let point: serde_json::Map<String, Value> = full.into_iter().map(|(k, v)| (k, json!(v))).collect();
        Ok(json!({ "table": table.name, "point": point, "lines": found }))
    }

    /// The times of a line and all samples of the requested columns.
    ///
    /// # Errors
    /// Fails for an unknown table, line, point or column, or if a limit is exceeded. Also fails if the store is
    /// damaged.
    pub(super) fn samples(&self, request: &SeriesRequest) -> Result<(Arc<Vec<f64>>, Vec<SeriesColumn>), ViewFault> {
        window(request)?;
        let (pipeline, table) = self.table(&request.table)?;
        if !table.is_by_sample() {
            let fault = Fault::new(format!("`{}` has no samples of lines", table.name));
            return Err(ViewFault::Wrong(fault.help("name a table of kind `samples`, as listed by `api/catalogue`")));
        }
        let units = table.units(&request.point, Some((&request.flight, &request.line)))?;
        let index = table.index()?;
        let rows: usize = units.iter().map(|unit| table.rows(index, *unit)).sum();
        if rows > MOST_ROWS {
            let fault = Fault::new(format!("the line has {rows} samples; at most {MOST_ROWS} are drawn"));
            return Err(ViewFault::Wrong(fault.help("use `magline export` or `magline sql`")));
        }
        let reader = LineReader { view: self, pipeline: &pipeline, table: &table, units: &units, request };
        let tt = reader.read("tt")?;
        let columns = request.columns.iter().map(|name| reader.column(name)).collect::<Result<Vec<_>, _>>()?;
        Ok((tt, columns))
    }

    /// A series as an Arrow IPC stream.
    ///
    /// # Errors
    /// Fails for an unknown table, line, point or column, or if a limit is exceeded. Also fails if the store is
    /// damaged.
    pub fn series(&self, request: &SeriesRequest) -> Result<Vec<u8>, ViewFault> {
        let (window, (tt, columns)) = (window(request)?, self.samples(request)?);
        let point: serde_json::Map<String, Value> = request.point.iter().map(|(k, v)| (k.clone(), json!(v))).collect();
        let about = HashMap::from([
            ("table".to_owned(), request.table.clone()),
            ("flight".to_owned(), request.flight.clone()),
            ("line".to_owned(), request.line.clone()),
            ("point".to_owned(), Value::Object(point).to_string()),
        ]);
        Ok(series(&tt, &columns, window, SeriesPrecision::Full, about)?.stream()?)
    }
}

/// The point `point`, completed by the first value of each axis that it does not name.
fn first_point(table: &ViewTable, point: &ViewPoint) -> Result<ViewPoint, ViewFault> {
    let mut full = point.clone();
    for axis in &table.index()?.axes {
        if !full.iter().any(|(name, _)| *name == axis.name)
            && let Some(first) = axis.words.first()
        {
            full.push((axis.name.clone(), first.clone()));
        }
    }
    Ok(full)
}

/// The window of a request.
fn window(request: &SeriesRequest) -> Result<SeriesWindow, ViewFault> {
    let wrong = |what: String, help: &str| Err(ViewFault::Wrong(Fault::new(what).help(help)));
    let (from, to) = (request.from.unwrap_or(f64::NEG_INFINITY), request.to.unwrap_or(f64::INFINITY));
    let pixels = request.pixels.unwrap_or(2000);
    if request.columns.is_empty() || request.columns.len() > MOST_COLUMNS {
        return wrong(format!("{} columns are requested", request.columns.len()), "request 1 to 64 columns");
    }
    if from.is_nan() || to.is_nan() || from > to {
        return wrong(format!("the interval from {from} to {to} s is empty"), "give `from` below `to`, in seconds");
    }
    if !(1..=MOST_PIXELS).contains(&pixels) || pixels * request.columns.len() > MOST_VALUES {
        let what = format!("{pixels} pixels of {} columns are requested", request.columns.len());
        return wrong(what, "request 1 to 20000 pixels, and at most 400000 in all columns together");
    }
    Ok(SeriesWindow { from, to, pixels })
}

/// Reader of the columns of one line.
struct LineReader<'a> {
    view: &'a StoreView,
    pipeline: &'a PublishedPipeline,
    table: &'a ViewTable,
    units: &'a [usize],
    request: &'a SeriesRequest,
}

impl LineReader<'_> {
    fn read(&self, name: &str) -> Result<Arc<Vec<f64>>, ViewFault> {
        self.view.column(self.pipeline.version.number, self.table, self.units, name)
    }

    fn column(&self, name: &str) -> Result<SeriesColumn, ViewFault> {
        let own = self.table.column(name);
        if let (Err(ViewFault::Missing(_)), Some(column)) = (&own, DerivedColumn::named(name))
            && derived(self.pipeline, self.table).contains(&column)
        {
            return Ok(column.series(self.derive(column)?));
        }
        let (field, _) = own?;
        let about = |key: &str| field.metadata().get(key).cloned().unwrap_or_default();
        Ok(SeriesColumn {
            name: name.to_owned(),
            unit: about("unit"),
            role: about("role"),
            description: about("description"),
            values: self.read(name)?,
        })
    }

    fn derive(&self, column: DerivedColumn) -> Result<Vec<f64>, ViewFault> {
        let errors = |names: [&str; 2], way: usize| -> Result<Vec<f64>, ViewFault> {
            let truth = [self.upstream("lat")?, self.upstream("lon")?];
            let own = |name: &str| match self.table.column(name) {
                Ok(_) => self.read(name),
                Err(_) => self.upstream(name).map(Arc::new),
            };
            let own = [own(names[0])?, own(names[1])?];
            let rows = (truth[0].iter().zip(&truth[1])).zip(own[0].iter().zip(own[1].iter()));
            let offset = |((lat, lon), own): ((&f64, &f64), (&f64, &f64))| {
                let (north, east) = EarthModel::default().offset_ne_m((*own.0, *own.1), (*lat, *lon), 0.0);
                if way == 0 { north } else { east }
            };
            Ok(rows.map(offset).collect())
        };
        match column {
            DerivedColumn::Truth(way) => self.upstream(POSITION[way.min(1)]),
            DerivedColumn::Estimate(way) => errors(POSITION, way),
            DerivedColumn::Ins(way) => errors(INS, way),
            DerivedColumn::Field => {
                let name = self.pipeline.notes.truth(short(&self.table.name)).unwrap_or_default();
                let (own, truth) = (self.read("mag_c")?, self.read(name)?);
                Ok(own.iter().zip(truth.iter()).map(|(own, truth)| own - truth).collect())
            }
        }
    }

    /// A column of the table that has the true positions, at the times of this table; NaN at times that the other table
    /// lacks.
    fn upstream(&self, name: &str) -> Result<Vec<f64>, ViewFault> {
        let missing = || Fault::machine(format!("the store no longer contains the true positions of `{name}`"));
        let table = truth_table(self.pipeline, self.table).ok_or_else(missing)?;
        let SeriesRequest { flight, line, point, .. } = self.request;
        let point: ViewPoint = point.iter().filter(|(axis, _)| table.axes.contains(axis)).cloned().collect();
        let units = table.units(&point, Some((flight, line)))?;
        let read = |name: &str| self.view.column(self.pipeline.version.number, &table, &units, name);
        Ok(at_times(&read("tt")?, &read(name)?, &self.read("tt")?))
    }
}

/// Values at the times `wanted`, looked up in `values` with the ascending times `tt`; NaN at times without a value.
fn at_times(tt: &[f64], values: &[f64], wanted: &[f64]) -> Vec<f64> {
    if tt == wanted {
        return values.to_vec();
    }
    let at = |time: &f64| tt.binary_search_by(|own| own.total_cmp(time)).ok().and_then(|row| values.get(row));
    wanted.iter().map(|time| at(time).copied().unwrap_or(f64::NAN)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_values_are_taken_at_equal_times() {
        let found = at_times(&[0.0, 0.1, 0.3], &[5.0, 6.0, 7.0], &[0.1, 0.2, 0.3]);
        assert!(found[0] == 6.0 && found[1].is_nan() && found[2] == 7.0, "{found:?}");
    }

    #[test]
    fn unit_requests_beyond_the_limits_are_rejected() {
        let of = |columns: usize, from: f64, to: f64, pixels: usize| {
            let request = SeriesRequest {
                columns: vec!["x".to_owned(); columns],
                from: Some(from),
                to: Some(to),
                pixels: Some(pixels),
                ..SeriesRequest::default()
            };
            matches!(window(&request), Err(ViewFault::Wrong(_)))
        };
        assert!(!of(1, 0.0, 1.0, 20_000) && !of(64, -1.0, -1.0, 6000));
        assert!(of(0, 0.0, 1.0, 10) && of(65, 0.0, 1.0, 10) && of(1, 0.0, 1.0, 0) && of(1, 0.0, 1.0, 20_001));
        assert!(of(1, 1.0, 0.0, 10) && of(1, f64::NAN, 0.0, 10) && of(64, 0.0, 1.0, 20_000));
    }
}
