//! One published table: its units by sweep point, flight and line, and its columns as numbers.

use std::{collections::HashMap, sync::OnceLock};

use arrow_array::{Array, ArrayRef, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::{DataType, Field};
use schemas::Fault;

use super::{ViewFault, ViewPoint};
use crate::{
    series::{is_series, list_element},
    sql::PublishedTableProvider,
};

/// Maximum number of known values listed in the error for an unknown value.
const LISTED: usize = 5;

/// A published table, opened once per version.
pub struct ViewTable {
    /// The name, as PIPELINE.TABLE.
    pub name: String,
    /// The axes.
    pub axes: Vec<String>,
    /// The columns and rows.
    pub provider: PublishedTableProvider,
    index: OnceLock<Result<UnitIndex, Fault>>,
}

/// The values of one axis, and for each unit the position of its value.
#[derive(Debug)]
pub struct AxisIndex {
    /// Name.
    pub name: String,
    /// Distinct values as text, in the order of the units. An empty string is a missing value.
    pub words: Vec<String>,
    at: Vec<u32>,
}

/// Units of a table: each is a run of rows of one point and line.
#[derive(Debug)]
pub struct UnitIndex {
    /// The axes.
    pub axes: Vec<AxisIndex>,
    /// Distinct flights and lines.
    pub lines: Vec<(String, String)>,
    line: Vec<u32>,
    /// The row group, first row and number of rows of each run; empty for a table with a list of units.
    runs: Vec<(usize, usize, usize)>,
}

/// Distinct values in the order of their appearance.
#[derive(Default)]
pub struct Words {
    known: HashMap<String, u32>,
    /// The values.
    pub words: Vec<String>,
}

impl Words {
    /// The position of a known value.
    pub fn find(&self, word: &str) -> Option<u32> {
        self.known.get(word).copied()
    }

    /// The position of a value, which is added if it is new.
    pub fn position(&mut self, word: &str) -> u32 {
        if let Some(at) = self.known.get(word) {
            return *at;
        }
        let at = u32::try_from(self.words.len()).unwrap_or(u32::MAX);
        self.known.insert(word.to_owned(), at);
        self.words.push(word.to_owned());
        at
    }
}

/// The cell of a key column as text, in the spelling of a spec; empty for a missing value.
pub fn word(array: &dyn Array, row: usize) -> String {
    if array.is_null(row) {
        return String::new();
    }
    match array.as_primitive_opt::<Float64Type>() {
        Some(numbers) => numbers.value(row).to_string(),
        None => arrow_cast::display::array_value_to_string(array, row).unwrap_or_default(),
    }
}

/// Whether two spellings mean the same string or number.
fn is_same(own: &str, given: &str) -> bool {
    let number = |text: &str| text.parse::<f64>().ok();
    own == given || number(own).is_some_and(|own| number(given) == Some(own))
}

/// Positions of the values of a column in `words`. A value that equals the value of the previous row is not converted
/// to text.
pub fn positions(array: &ArrayRef, words: &mut Words) -> Vec<u32> {
    let same = |row: usize| -> bool {
        if array.is_null(row) || array.is_null(row - 1) {
            return array.is_null(row) && array.is_null(row - 1);
        }
        if let Some(texts) = array.as_string_opt::<i32>() {
            return texts.value(row) == texts.value(row - 1);
        }
        let numbers = array.as_primitive_opt::<Float64Type>();
        numbers.is_some_and(|a| a.value(row).to_bits() == a.value(row - 1).to_bits())
    };
    let mut found: Vec<u32> = Vec::with_capacity(array.len());
    for row in 0..array.len() {
        let at = match found.last() {
            Some(last) if same(row) => *last,
            _ => words.position(&word(array, row)),
        };
        found.push(at);
    }
    found
}

impl ViewTable {
    /// The table `name` with these axes.
    pub fn new(name: String, axes: Vec<String>, provider: PublishedTableProvider) -> ViewTable {
        ViewTable { name, axes, provider, index: OnceLock::new() }
    }

    /// Whether each row is a sample of a line.
    pub fn is_by_sample(&self) -> bool {
        ["flight", "line", "tt"].iter().all(|name| self.provider.columns().field_with_name(name).is_ok())
    }

    /// The units, read at first use.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn index(&self) -> Result<&UnitIndex, Fault> {
        self.index.get_or_init(|| UnitIndex::new(self)).as_ref().map_err(Clone::clone)
    }

    /// The units of a line at a point, or of all lines.
    ///
    /// # Errors
    /// Fails for an unknown or incomplete point, or for an unknown line.
    pub fn units(&self, point: &ViewPoint, line: Option<(&str, &str)>) -> Result<Vec<usize>, ViewFault> {
        let index = self.index()?;
        let mut wanted = vec![];
        for axis in &index.axes {
            wanted.push(axis.wanted(&self.name, point)?);
        }
        if let Some((name, _)) = point.iter().find(|(name, _)| !self.axes.contains(name)) {
            return Err(ViewFault::Wrong(
                Fault::new(format!("`{}` has no axis `{name}`", self.name)).nearest(name, &self.axes),
            ));
        }
        let at = match line {
            None => None,
            Some((flight, line)) => {
                let at = index.lines.iter().position(|(f, l)| f == flight && l == line);
                let missing = || Fault::new(format!("`{}` has no line `{line}` of flight `{flight}`", self.name));
                Some(at.and_then(|at| u32::try_from(at).ok()).ok_or_else(|| ViewFault::Missing(missing()))?)
            }
        };
        let fits = |unit: &usize| {
            at.is_none_or(|at| index.line[*unit] == at)
                && index.axes.iter().zip(&wanted).all(|(axis, at)| axis.at[*unit] == *at)
        };
        let found: Vec<usize> = (0..index.line.len()).filter(fits).collect();
        if found.is_empty() {
            let what = format!("`{}` has no rows of this line at this point", self.name);
            return Err(ViewFault::Missing(
                Fault::new(what).help("the unit may have failed; see the table `failures`"),
            ));
        }
        Ok(found)
    }

    /// The line of a unit, as a position among the lines of the index.
    pub fn line_of(&self, index: &UnitIndex, unit: usize) -> usize {
        index.line[unit] as usize
    }

    /// Number of rows of a unit.
    pub fn rows(&self, index: &UnitIndex, unit: usize) -> usize {
        index.runs.get(unit).map_or_else(|| self.provider.unit_rows(unit), |run| run.2)
    }

    /// The values of the column `name` in some units, one after another. A missing value is NaN, a Boolean is 1 or 0,
    /// and `name[i]` is an element of a list.
    ///
    /// # Errors
    /// Fails for an unknown column, or for a column without numbers. Also fails if the store is damaged.
    pub fn floats(&self, units: &[usize], name: &str) -> Result<Vec<f64>, ViewFault> {
        let index = self.index()?;
        let (column, element) = self.column(name)?;
        let mut values = vec![];
        for unit in units {
            let batch = match index.runs.get(*unit) {
                Some((group, first, rows)) => {
                    self.provider.read_group(*group, &[column.name().as_str()])?.slice(*first, *rows)
                }
                None => self.provider.read_unit(*unit, &[column.name().as_str()])?,
            };
            extend(&mut values, &batch, element).map_err(|fault| fault.in_column(name))?;
        }
        Ok(values)
    }

    /// The rows of a table without lines at a point.
    ///
    /// # Errors
    /// Fails for an unknown or incomplete point. Also fails if the store is damaged.
    pub fn rows_at(&self, point: &ViewPoint, columns: &[&str]) -> Result<RecordBatch, ViewFault> {
        let mut found = vec![];
        for group in 0..self.provider.groups() {
            let names: Vec<&str> = self.axes.iter().map(String::as_str).chain(columns.iter().copied()).collect();
            let batch = self.provider.read_group(group, &names)?;
            let keep = |row: usize| {
                self.axes.iter().zip(batch.columns()).all(|(axis, array)| {
                    let own = word(array, row);
                    point.iter().find(|(name, _)| name == axis).is_none_or(|(_, value)| is_same(&own, value))
                })
            };
            let mask: arrow_array::BooleanArray = (0..batch.num_rows()).map(|row| Some(keep(row))).collect();
            let kept =
                arrow_select::filter::filter_record_batch(&batch, &mask).map_err(|e| Fault::machine(e.to_string()))?;
            found.push(kept);
        }
        let schema = found.first().map(RecordBatch::schema);
        let all = schema.map(|schema| arrow_select::concat::concat_batches(&schema, &found)).transpose();
        let all = all.map_err(|e| Fault::machine(e.to_string()))?.filter(|all| all.num_rows() > 0);
        let all =
            all.ok_or_else(|| ViewFault::Missing(Fault::new(format!("`{}` has no rows at this point", self.name))))?;
        for (axis, array) in self.axes.iter().zip(all.columns()) {
            let mut words = Words::default();
            if positions(array, &mut words).iter().any(|at| *at > 0) {
                let fault = Fault::new(format!("`{}` needs a value of the axis `{axis}`", self.name));
                return Err(ViewFault::Wrong(fault.help(format!("add `axis.{axis}={}`", words.words[0]))));
            }
        }
        let own: Vec<usize> = (self.axes.len()..all.num_columns()).collect();
        Ok(all.project(&own).map_err(|e| Fault::machine(e.to_string()))?)
    }

    /// The column with this name; for a name such as `modes[2]`, the list column and the position of the element.
    ///
    /// # Errors
    /// Fails for an unknown column, or for a column without numbers.
    pub fn column(&self, name: &str) -> Result<(Field, Option<usize>), ViewFault> {
        let columns = self.provider.columns();
        let (column, element) = match columns.field_with_name(name) {
            Ok(_) => (name, None),
            Err(_) => list_element(name).map_or((name, None), |(list, at)| (list, Some(at))),
        };
        let known: Vec<&str> = columns.fields().iter().map(|f| f.name().as_str()).take(1000).collect();
        let missing = || Fault::new(format!("`{}` has no column `{name}`", self.name)).nearest(name, &known);
        let field = columns.field_with_name(column).map_err(|_| ViewFault::Missing(missing()))?;
        let fits = match (field.data_type(), element) {
            (DataType::FixedSizeList(_, length), Some(at)) => i32::try_from(at).is_ok_and(|at| at < *length),
            (DataType::FixedSizeList(..), None) | (_, Some(_)) => false,
            (kind, None) => is_series(kind),
        };
        if !fits {
            let fault = Fault::new(format!("the column `{name}` of `{}` has no numbers", self.name));
            return Err(ViewFault::Wrong(fault.help("give a numeric column, or an element of a list as `NAME[0]`")));
        }
        Ok((field.clone(), element))
    }
}

impl AxisIndex {
    /// The position of the value that `point` gives for this axis.
    fn wanted(&self, table: &str, point: &ViewPoint) -> Result<u32, ViewFault> {
        let Some((_, value)) = point.iter().find(|(name, _)| *name == self.name) else {
            if self.words.len() <= 1 {
                return Ok(0);
            }
            let fault = Fault::new(format!("`{table}` needs a value of the axis `{}`", self.name));
            return Err(ViewFault::Wrong(fault.help(format!("add `axis.{}={}`", self.name, self.words[0]))));
        };
        let exact = self.words.iter().position(|word| word == value);
        let at = exact
            .or_else(|| self.words.iter().position(|word| is_same(word, value)))
            .and_then(|at| u32::try_from(at).ok());
        at.ok_or_else(|| {
            let known = self.words.iter().take(LISTED).map(|w| format!("`{w}`")).collect::<Vec<_>>().join(", ");
            let more = if self.words.len() > LISTED { ", …" } else { "" };
            let fault = Fault::new(format!("the axis `{}` of `{table}` has no value `{value}`", self.name));
            ViewFault::Missing(fault.help(format!("its values are {known}{more}")))
        })
    }
}

impl UnitIndex {
    fn new(table: &ViewTable) -> Result<UnitIndex, Fault> {
        match table.provider.units() {
            Some(units) => UnitIndex::of_units(table, units),
            None => UnitIndex::of_rows(table),
        }
    }

    fn of_units(table: &ViewTable, units: &RecordBatch) -> Result<UnitIndex, Fault> {
        let column = |name: &str| {
            let found = units.column_by_name(name);
            found.ok_or_else(|| Fault::machine(format!("the list of units of `{}` has no `{name}`", table.name)))
        };
        let mut keys = KeyReader::default();
        let axes = table.axes.iter().map(|a| column(&format!("axis {a}"))).collect::<Result<Vec<_>, _>>()?;
        keys.add(&axes, column("flight")?, column("line")?);
        Ok(keys.index(&table.axes, vec![]))
    }

    /// The runs of equal keys in the files.
    fn of_rows(table: &ViewTable) -> Result<UnitIndex, Fault> {
        let names: Vec<&str> = table.axes.iter().map(String::as_str).chain(["flight", "line"]).collect();
        let (mut keys, mut runs) = (KeyReader::default(), vec![]);
        for group in 0..table.provider.groups() {
            let batch = table.provider.read_group(group, &names)?;
            let columns: Vec<&ArrayRef> = batch.columns().iter().collect();
            let Some((axes, [flight, line])) = columns.split_last_chunk::<2>() else { continue };
            let mut own = KeyReader {
                words: std::mem::take(&mut keys.words),
                lines: std::mem::take(&mut keys.lines),
                ..KeyReader::default()
            };
            own.add(axes, flight, line);
            let same =
                |row: usize| own.line[row] == own.line[row - 1] && own.at.iter().all(|at| at[row] == at[row - 1]);
            let mut start = 0;
            keys.at.resize_with(axes.len(), Vec::new);
            for row in 1..=batch.num_rows() {
                if row == batch.num_rows() || !same(row) {
                    runs.push((group, start, row - start));
                    keys.line.push(own.line[start]);
                    keys.at.iter_mut().zip(&own.at).for_each(|(to, from)| to.push(from[start]));
                    start = row;
                }
            }
            (keys.words, keys.lines) = (own.words, own.lines);
        }
        Ok(keys.index(&table.axes, runs))
    }
}

/// Distinct flights and lines.
#[derive(Default)]
struct Lines {
    known: HashMap<(u32, u32), u32>,
    flights: Words,
    lines: Words,
    pairs: Vec<(u32, u32)>,
}

/// Reader of the keys of rows.
#[derive(Default)]
struct KeyReader {
    words: Vec<Words>,
    lines: Lines,
    at: Vec<Vec<u32>>,
    line: Vec<u32>,
}

impl KeyReader {
    fn add(&mut self, axes: &[&ArrayRef], flight: &ArrayRef, line: &ArrayRef) {
        self.words.resize_with(axes.len(), Words::default);
        self.at = axes.iter().zip(&mut self.words).map(|(array, words)| positions(array, words)).collect();
        let all = &mut self.lines;
        let (flights, lines) = (positions(flight, &mut all.flights), positions(line, &mut all.lines));
        self.line.clear();
        for pair in flights.into_iter().zip(lines) {
            let next = u32::try_from(all.pairs.len()).unwrap_or(u32::MAX);
            let at = *all.known.entry(pair).or_insert(next);
            if at == next {
                all.pairs.push(pair);
            }
            self.line.push(at);
        }
    }

    fn index(mut self, axes: &[String], runs: Vec<(usize, usize, usize)>) -> UnitIndex {
        self.words.resize_with(axes.len(), Words::default);
        self.at.resize_with(axes.len(), Vec::new);
        let Lines { flights, lines, pairs, .. } = self.lines;
        let word = |words: &Words, at: u32| words.words.get(at as usize).cloned().unwrap_or_default();
        UnitIndex {
            axes: axes
                .iter()
                .zip(self.words)
                .zip(self.at)
                .map(|((name, words), at)| AxisIndex { name: name.clone(), words: words.words, at })
                .collect(),
            lines: pairs.into_iter().map(|(f, l)| (word(&flights, f), word(&lines, l))).collect(),
            line: self.line,
            runs,
        }
    }
}

/// Adds the values of the only column of a batch, or of an element of its lists.
///
/// # Errors
/// Fails for a column without numbers.
pub fn extend(values: &mut Vec<f64>, batch: &RecordBatch, element: Option<usize>) -> Result<(), Fault> {
    let array = batch.column(0);
    let Some(at) = element else { return numbers(values, array) };
    let list = array.as_fixed_size_list_opt().ok_or_else(|| Fault::machine("a list of another type"))?;
    let mut all = vec![];
    numbers(&mut all, list.values())?;
    let length = usize::try_from(list.value_length()).unwrap_or(0);
    let value = |row: usize| {
        let found = all.get((list.offset() + row) * length + at).copied();
        found.filter(|_| list.is_valid(row)).unwrap_or(f64::NAN)
    };
    values.extend((0..list.len()).map(value));
    Ok(())
}

fn numbers(values: &mut Vec<f64>, array: &ArrayRef) -> Result<(), Fault> {
    let cast = arrow_cast::cast(array, &DataType::Float64).map_err(|e| Fault::machine(e.to_string()))?;
    let numbers = cast.as_primitive::<Float64Type>();
    match numbers.null_count() {
        0 => values.extend_from_slice(numbers.values()),
        _ => values.extend(numbers.iter().map(|v| v.unwrap_or(f64::NAN))),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{BooleanArray, FixedSizeListArray, Float64Array, StringArray};

    use super::*;

    #[test]
    fn unit_key_cells_are_spelt_as_in_a_spec() {
        let numbers: ArrayRef = Arc::new(Float64Array::from(vec![Some(0.0), Some(0.0), None, Some(1e-3), Some(0.0)]));
        let mut words = Words::default();
        assert_eq!(positions(&numbers, &mut words), [0, 0, 1, 2, 0]);
        assert_eq!(words.words, ["0", "", "0.001"]);
        let texts: ArrayRef = Arc::new(StringArray::from(vec!["a", "<b>", "<b>", "a"]));
        assert_eq!(positions(&texts, &mut Words::default()), [0, 1, 1, 0]);
        let truths: ArrayRef = Arc::new(BooleanArray::from(vec![true, false]));
        let mut words = Words::default();
        assert_eq!(
            (positions(&truths, &mut words), words.words),
            (vec![0, 1], vec!["true".to_owned(), "false".to_owned()])
        );
    }

    #[test]
    fn unit_a_number_of_an_axis_matches_in_every_spelling() {
        let axis = AxisIndex { name: "lambda".to_owned(), words: vec!["0".into(), "0.025".into()], at: vec![] };
        let of = |value: &str| axis.wanted("a.b", &vec![("lambda".to_owned(), value.to_owned())]).ok();
        assert_eq!([of("0.0"), of("2.5e-2"), of("0.025"), of("x"), of("nan")], [Some(0), Some(1), Some(1), None, None]);
        assert!(axis.wanted("a.b", &vec![]).is_err());
    }

    #[test]
    fn unit_elements_of_a_list_are_read_from_a_slice() {
        let list = FixedSizeListArray::from_iter_primitive::<Float64Type, _, _>(
            [Some([1.0, 2.0]), Some([3.0, 4.0]), None, Some([7.0, 8.0])].map(|v| v.map(|v| v.map(Some))),
            2,
        );
        let batch = RecordBatch::try_from_iter([("x", Arc::new(list) as ArrayRef)]).unwrap().slice(1, 3);
        let mut values = vec![];
        extend(&mut values, &batch, Some(1)).unwrap();
        assert!(values[0] == 4.0 && values[1].is_nan() && values[2] == 8.0, "{values:?}");
    }
}
