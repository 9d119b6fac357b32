//! Series of one line for drawing: raw rows, or the minimum and maximum of each interval of time.
//!
//! The result is an Arrow IPC stream. The metadata of a field name its source column and its part: `time`, `count`,
//! `value`, `min`, `max` or `present`.

use std::{collections::HashMap, ops::Range, sync::Arc};

use arrow_array::{ArrayRef, Float32Array, Float64Array, RecordBatch, UInt32Array};
use arrow_ipc::writer::StreamWriter;
use arrow_schema::{DataType, Field, Schema};
use schemas::{Fault, Role};

/// Maximum number of raw rows for each pixel.
const RAW_ROWS: usize = 2;
/// Largest accepted error of Float32, as a fraction of the range that contains 90 % of the values.
const COARSEST: f64 = 1e-5;

/// A column with its description.
#[derive(Clone, Debug)]
pub struct SeriesColumn {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Role, as in the metadata of a table's columns.
    pub role: String,
    /// Description.
    pub description: String,
    /// Values; a missing value is NaN.
    pub values: Arc<Vec<f64>>,
}

/// Column that is computed from others, row by row. The index is 0 for latitude or north, 1 for longitude or east.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DerivedColumn {
    /// Truth of the position.
    Truth(usize),
    /// Truth minus estimate.
    Estimate(usize),
    /// Truth minus INS.
    Ins(usize),
    /// Compensated field minus truth.
    Field,
}

/// Description of a derived column.
pub struct DerivedColumnText {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Role.
    pub role: Role,
    /// Description.
    pub description: &'static str,
}

impl DerivedColumn {
    /// All derived columns.
    pub const ALL: [DerivedColumn; 7] = [
        DerivedColumn::Truth(0),
        DerivedColumn::Truth(1),
        DerivedColumn::Estimate(0),
        DerivedColumn::Estimate(1),
        DerivedColumn::Ins(0),
        DerivedColumn::Ins(1),
        DerivedColumn::Field,
    ];

    /// The derived column with this name.
    pub fn named(name: &str) -> Option<DerivedColumn> {
        DerivedColumn::ALL.into_iter().find(|column| column.about().name == name)
    }

    /// Name, unit, role and description.
    pub fn about(self) -> DerivedColumnText {
        let (name, unit, role, description) = match self {
            DerivedColumn::Truth(0) => ("truth_lat", "deg", Role::Truth, "true latitude"),
            DerivedColumn::Truth(_) => ("truth_lon", "deg", Role::Truth, "true longitude"),
            DerivedColumn::Estimate(0) => ("north_error", "m", Role::Derived, "truth minus estimate, north"),
            DerivedColumn::Estimate(_) => ("east_error", "m", Role::Derived, "truth minus estimate, east"),
            DerivedColumn::Ins(0) => ("ins_north_error", "m", Role::Derived, "truth minus INS alone, north"),
            DerivedColumn::Ins(_) => ("ins_east_error", "m", Role::Derived, "truth minus INS alone, east"),
            DerivedColumn::Field => ("error", "nT", Role::Derived, "compensated field minus truth"),
        };
        DerivedColumnText { name, unit, role, description }
    }

    /// The column with its values.
    pub fn series(self, values: Vec<f64>) -> SeriesColumn {
        let DerivedColumnText { name, unit, role, description } = self.about();
        SeriesColumn {
            name: name.to_owned(),
            unit: unit.to_owned(),
            role: role.as_str().to_owned(),
            description: description.to_owned(),
            values: Arc::new(values),
        }
    }
}

/// The time span of a series, and its resolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeriesWindow {
    /// First time, in seconds; -∞ for the whole line.
    pub from: f64,
    /// Last time, in seconds; ∞ for the whole line.
    pub to: f64,
    /// Number of intervals.
    pub pixels: usize,
}

/// Type of the stored values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeriesPrecision {
    /// Float64.
    Full,
    /// Differences from an offset as Float32, if their error is below 10⁻⁵ of the range that contains 90 % of the
    /// values; otherwise Float64. Times are Float64.
    Compact,
}

/// A series for drawing.
pub struct Series {
    /// The columns.
    pub batch: RecordBatch,
    /// Whether the rows are minima and maxima.
    pub is_thinned: bool,
    /// Largest difference between a stored value and its original, for each column, in the unit of the column.
    pub errors: Vec<f64>,
}

/// Series of `columns` over the times `tt`, in seconds, within `window`. The nearest row on each side of the window is
/// included. If there are at most two rows per pixel, the rows are returned unchanged. Otherwise they are divided into
/// intervals of equal time; an interval without a row is omitted.
///
/// # Errors
/// Fails for columns of different lengths.
pub fn series(
    tt: &[f64],
    columns: &[SeriesColumn],
    window: SeriesWindow,
    precision: SeriesPrecision,
    about: HashMap<String, String>,
) -> Result<Series, Fault> {
    if let Some(other) = columns.iter().find(|c| c.values.len() != tt.len()) {
        return Err(Fault::machine(format!("the rows of `{}` differ from the rows of the line", other.name)));
    }
    let rows = selected(tt, window);
    let is_thinned = rows.len() > RAW_ROWS * window.pixels;
    let mut made = SeriesBuilder { precision, fields: vec![], arrays: vec![], errors: vec![] };
    if is_thinned {
        let parts = intervals(tt, rows.clone(), window.pixels);
        let count = |r: &Range<usize>| u32::try_from(r.len()).unwrap_or(u32::MAX);
        made.counts("n", &[("part", "count")], parts.iter().map(count).collect());
        made.times("tt_first", parts.iter().map(|r| tt[r.start]).collect());
        made.times("tt_last", parts.iter().map(|r| tt[r.end - 1]).collect());
        columns.iter().for_each(|column| made.extremes(column, &parts));
    } else {
        made.times("tt", tt[rows.clone()].to_vec());
        columns.iter().for_each(|column| made.raw(column, rows.clone()));
    }
    let mut about = about;
    about.extend([
        ("rows".to_owned(), tt.len().to_string()),
        ("selected".to_owned(), rows.len().to_string()),
        ("thinned".to_owned(), is_thinned.to_string()),
        ("pixels".to_owned(), window.pixels.to_string()),
    ]);
    let ends = [("first", tt.first()), ("last", tt.last())];
    about.extend(ends.iter().filter_map(|(k, t)| Some(((*k).to_owned(), t.filter(|t| t.is_finite())?.to_string()))));
    let schema = Arc::new(Schema::new_with_metadata(made.fields, about));
    let batch = RecordBatch::try_new(schema, made.arrays).map_err(|e| Fault::machine(e.to_string()))?;
    Ok(Series { batch, is_thinned, errors: made.errors })
}

impl Series {
    /// The series as an Arrow IPC stream.
    ///
    /// # Errors
    /// Fails if the stream cannot be encoded.
    pub fn stream(&self) -> Result<Vec<u8>, Fault> {
        let failed = |e: arrow_schema::ArrowError| Fault::machine(format!("cannot encode the series: {e}"));
        let mut writer = StreamWriter::try_new(vec![], self.batch.schema_ref()).map_err(failed)?;
        writer.write(&self.batch).map_err(failed)?;
        writer.into_inner().map_err(failed)
    }
}

/// The rows within a window, and the nearest row on each side.
fn selected(tt: &[f64], window: SeriesWindow) -> Range<usize> {
    let first = tt.iter().position(|t| *t >= window.from).unwrap_or(tt.len());
    let last = tt.iter().rposition(|t| *t <= window.to);
    let end = last.map_or(1, |last| last + 2).min(tt.len());
    let start = first.min(end).saturating_sub(1);
    start..end
}

/// Divides rows into at most `pixels` intervals of equal time. Rows with times that do not ascend are divided into
/// intervals of equal numbers of rows.
fn intervals(tt: &[f64], rows: Range<usize>, pixels: usize) -> Vec<Range<usize>> {
    let by_rows = |rows: Range<usize>| {
        let cut = move |k: usize| rows.start + k * rows.len() / pixels;
        (0..pixels).map(|k| cut(k)..cut(k + 1)).filter(|r| !r.is_empty()).collect()
    };
    let finite = tt[rows.clone()].iter().filter(|t| t.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(*t), high.max(*t)));
    let per_s = pixels as f64 / (high - low);
    if !(per_s.is_finite() && per_s > 0.0) {
        return by_rows(rows);
    }
    let mut found: Vec<Range<usize>> = vec![];
    let mut current = usize::MAX;
    for row in rows.clone() {
        // A row without a time stays in the interval of the previous row.
        let at = if tt[row].is_nan() { current } else { (((tt[row] - low) * per_s) as usize).min(pixels - 1) };
        match found.last_mut() {
            Some(last) if at == current => last.end = row + 1,
            _ => found.push(row..row + 1),
        }
        current = at;
    }
    if found.len() > pixels { by_rows(rows) } else { found }
}

/// Minimum, maximum and number of the finite values.
fn extremes(values: &[f64]) -> (f64, f64, u32) {
    let (mut low, mut high, mut count) = (f64::INFINITY, f64::NEG_INFINITY, 0);
    for value in values {
        if value.is_finite() {
            low = low.min(*value);
            high = high.max(*value);
            count += 1;
        }
    }
    if count == 0 { (f64::NAN, f64::NAN, 0) } else { (low, high, count) }
}

/// Columns of a series.
struct SeriesBuilder {
    precision: SeriesPrecision,
    fields: Vec<Field>,
    arrays: Vec<ArrayRef>,
    errors: Vec<f64>,
}

impl SeriesBuilder {
    fn add(&mut self, name: &str, about: &[(&str, &str)], array: ArrayRef) {
        let metadata = about.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        self.fields.push(Field::new(name, array.data_type().clone(), true).with_metadata(metadata));
        self.arrays.push(array);
    }

    fn times(&mut self, name: &str, values: Vec<f64>) {
        self.add(name, &[("part", "time"), ("unit", "s")], nullable(&values));
    }

    fn counts(&mut self, name: &str, about: &[(&str, &str)], values: Vec<u32>) {
        self.add(name, about, Arc::new(UInt32Array::from(values)));
    }

    fn raw(&mut self, column: &SeriesColumn, rows: Range<usize>) {
        let values = column.values[rows].iter().map(|v| if v.is_finite() { *v } else { f64::NAN }).collect();
        let error = self.numbers(column, &[(column.name.clone(), "value", values)]);
        self.errors.push(error);
    }

    fn extremes(&mut self, column: &SeriesColumn, parts: &[Range<usize>]) {
        let found: Vec<(f64, f64, u32)> = parts.iter().map(|r| extremes(&column.values[r.clone()])).collect();
        let name = &column.name;
        let error = self.numbers(
            column,
            &[
                (format!("{name}.min"), "min", found.iter().map(|f| f.0).collect()),
                (format!("{name}.max"), "max", found.iter().map(|f| f.1).collect()),
            ],
        );
        self.errors.push(error);
        if is_paired(name) {
            let first = parts.iter().map(|r| column.values[r.start]).collect();
            self.numbers(column, &[(format!("{name}.first"), "first", first)]);
        }
        if found.iter().zip(parts).any(|(f, r)| f.2 as usize != r.len()) {
            let about = [("column", name.as_str()), ("part", "present")];
            self.counts(&format!("{name}.n"), &about, found.iter().map(|f| f.2).collect());
        }
    }

    /// Adds arrays of one column, all of the same type. Returns the largest error.
    fn numbers(&mut self, column: &SeriesColumn, parts: &[(String, &str, Vec<f64>)]) -> f64 {
        let all: Vec<f64> = parts.iter().flat_map(|p| p.2.iter().copied()).collect();
        let offset = match self.precision {
            SeriesPrecision::Full => None,
            SeriesPrecision::Compact => compact_offset(&all),
        };
        for (name, part, values) in parts {
            let mut about = vec![
                ("column", column.name.as_str()),
                ("part", part),
                ("unit", &column.unit),
                ("role", &column.role),
                ("description", &column.description),
            ];
            let text = offset.map(|(offset, _)| offset.to_string());
            about.extend(text.as_deref().map(|text| ("offset", text)));
            let array = match offset {
                Some((offset, _)) => Arc::new(
                    values.iter().map(|v| v.is_finite().then_some((v - offset) as f32)).collect::<Float32Array>(),
                ),
                None => nullable(values),
            };
            self.add(name, &about, array);
        }
        offset.map_or(0.0, |(_, error)| error)
    }
}

/// Whether the column is drawn together with another column, as are positions and the elements of a list.
fn is_paired(name: &str) -> bool {
    name.ends_with("lat") || name.ends_with("lon") || list_element(name).is_some()
}

/// The list and the element that a name such as `modes[2]` refers to.
pub fn list_element(name: &str) -> Option<(&str, usize)> {
    let (list, rest) = name.strip_suffix(']')?.rsplit_once('[')?;
    Some((list, rest.parse().ok()?))
}

fn nullable(values: &[f64]) -> ArrayRef {
    Arc::new(values.iter().map(|v| v.is_finite().then_some(*v)).collect::<Float64Array>())
}

/// The offset that is subtracted before storage as Float32, and the resulting largest error; `None` if this error is
/// too large.
fn compact_offset(values: &[f64]) -> Option<(f64, f64)> {
    let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    finite.sort_by(f64::total_cmp);
    let (low, high) = (*finite.first()?, *finite.last()?);
    let offset = 0.5 * low + 0.5 * high;
    let error = |v: &f64| (f64::from((v - offset) as f32) + offset - v).abs();
    let largest = finite.iter().map(error).fold(0.0, f64::max);
    let at = |part: f64| finite[((finite.len() - 1) as f64 * part) as usize];
    (largest <= COARSEST * (at(0.95) - at(0.05))).then_some((offset, largest))
}

/// Whether the values of a column of this type can be drawn over time.
pub fn is_series(kind: &DataType) -> bool {
    match kind {
        DataType::FixedSizeList(item, _) => item.data_type().is_numeric(),
        kind => kind.is_numeric() || *kind == DataType::Boolean,
    }
}

#[cfg(test)]
mod tests;
