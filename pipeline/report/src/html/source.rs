//! The inputs of the page: single columns of single lines, read from the store one at a time.

use std::{
    collections::{BTreeMap, HashMap},
    sync::{Mutex, PoisonError},
};

use arrow_array::{Array, RecordBatch, StringArray, cast::AsArray, types::Float64Type};
use numerics::maps::map_surface::GeographicGrid;
use plan::{LineId, PlanGraph, PlanUnit, TableRef};
use schemas::{Fault, TableShape, keys::HashKey};
use store::{Store, published};

/// Reader of result columns by their keys, so that only results of this spec are shown.
pub struct ReportSource<'a> {
    /// The plan with its lines and keys.
    pub graph: &'a PlanGraph<'a>,
    /// The store of the columns.
    pub store: &'a Store,
    /// The number of available units of each requested table.
    counted: Mutex<HashMap<usize, usize>>,
}

/// A failure, with its number of occurrences.
#[derive(Clone, Debug, PartialEq)]
pub struct FailureCount {
    /// The table.
    pub stage: String,
    /// Reason of the failure.
    pub error: String,
    /// First occurrence: axis values, flight, line.
    pub example: String,
    /// The number of occurrences.
    pub times: usize,
}

impl<'a> ReportSource<'a> {
    /// The columns of `graph` that are in `store`.
    pub fn new(graph: &'a PlanGraph<'a>, store: &'a Store) -> ReportSource<'a> {
        ReportSource { graph, store, counted: Mutex::default() }
    }

    /// The columns of a table.
    pub fn shape(&self, r: TableRef) -> Option<&TableShape> {
        let plan = self.graph.plan;
        match r {
            TableRef::Flights(i) => plan.flights.get(i).map(|f| &f.shape),
            TableRef::Stage(t, i) => Some(plan.instance(t, i).variant.table.shape()),
            TableRef::Map(_) => None,
        }
    }

    /// The numbers of a column of one line; `None` if the table or the line has no such column, or the column is not
    /// computed yet.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn floats(&self, r: TableRef, line: LineId, name: &str) -> Result<Option<Vec<f64>>, Fault> {
        let Some(batch) = self.column(r, line, name)? else { return Ok(None) };
        let numbers = batch.column(0).as_primitive_opt::<Float64Type>();
        Ok(numbers.map(|a| a.iter().map(|v| v.unwrap_or(f64::NAN)).collect()))
    }

    /// The values of each element of a list of numbers on one line; `None` in the cases of [`ReportSource::floats`]. A
    /// missing value is NaN.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn elements(&self, r: TableRef, line: LineId, name: &str) -> Result<Option<Vec<Vec<f64>>>, Fault> {
        let Some(batch) = self.column(r, line, name)? else { return Ok(None) };
        let list = batch.column(0).as_fixed_size_list_opt();
        let numbers = list.and_then(|list| Some((list, list.values().as_primitive_opt::<Float64Type>()?)));
        Ok(numbers.map(|(list, numbers)| {
            let width = usize::try_from(list.value_length()).unwrap_or(0);
            let value = |row: usize, element: usize| {
                let at = row * width + element;
                if list.is_valid(row) && numbers.is_valid(at) { numbers.value(at) } else { f64::NAN }
            };
            (0..width).map(|element| (0..list.len()).map(|row| value(row, element)).collect()).collect()
        }))
    }

    /// The number of occurrences of each text in a column of one line.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn tally(&self, r: TableRef, line: LineId, name: &str) -> Result<BTreeMap<String, usize>, Fault> {
        let mut counts = BTreeMap::new();
        let batch = self.column(r, line, name)?;
        let words: Option<&StringArray> = batch.as_ref().and_then(|b| b.column(0).as_string_opt::<i32>());
        for word in words.into_iter().flatten().flatten() {
            if let Some(n) = counts.get_mut(word) {
                *n += 1;
            } else {
                counts.insert(word.to_owned(), 1);
            }
        }
        Ok(counts)
    }

    fn column(&self, r: TableRef, line: LineId, name: &str) -> Result<Option<RecordBatch>, Fault> {
        if self.shape(r).is_none_or(|s| s.get(name).is_none()) {
            return Ok(None);
        }
        let origin = self.graph.origin(r, name);
        if let TableRef::Flights(i) = origin.made_by {
            let record = self.graph.records.get(i).and_then(|r| r.get(&line));
            if record.is_none_or(|l| l.fault.is_some() || !l.columns.contains_key(&origin.column)) {
                return Ok(None);
            }
        }
        match self.graph.object(origin.made_by, line) {
            Ok(key) if self.store.has(key) => self.store.get(key, &[&origin.column]).map(Some),
            _ => Ok(None),
        }
    }

    /// A small table of one unit; `None` if the table does not exist.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn tidy(&self, unit: PlanUnit, columns: &[&str]) -> Result<Option<RecordBatch>, Fault> {
        match self.graph.key(unit) {
            Ok(key) if self.store.has(key) => self.store.get(key, columns).map(Some),
            _ => Ok(None),
        }
    }

    /// The map `r` in latitude and longitude, for drawing; `None` if the table is missing.
    ///
    /// # Errors
    /// Fails if the store is damaged.
    pub fn map(&self, r: TableRef) -> Result<Option<GeographicGrid>, Fault> {
        let there = |key: HashKey| self.store.find(key).is_some_and(|place| place.rows.is_some());
        if !self.graph.whole(r).is_ok_and(there) {
            return Ok(None);
        }
        // A map around a pole has no picture, because no grid of latitude and longitude can hold it.
        let Ok(map) = datasets::geographic(&self.graph.map(self.store, r)?) else { return Ok(None) };
        Ok(GeographicGrid::from_rows(map.column("lat"), map.column("lon"), map.column("anomaly")).ok())
    }

    /// The number of units of the table `t` in the store, and their total.
    pub fn present(&self, t: usize) -> (usize, usize) {
        let mut counted = self.counted.lock().unwrap_or_else(PoisonError::into_inner);
        let there = *counted.entry(t).or_insert_with(|| {
            self.graph.units(t).filter(|u| self.graph.key(*u).is_ok_and(|k| self.store.has(k))).count()
        });
        (there, self.graph.unit_count(t))
    }

    /// The failures of the last run, equal reasons of a table merged.
    ///
    /// # Errors
    /// Fails if the table of failures cannot be read.
    pub fn failures(&self) -> Result<Vec<FailureCount>, Fault> {
        let spec = &self.graph.plan.spec;
        let folder = self.store.table(&spec.name, "failures");
        let axes: Vec<&str> = spec.axes.iter().map(|a| a.name.as_str()).collect();
        let names: Vec<&str> = axes.iter().copied().chain(["flight", "line", "stage", "error"]).collect();
        published(&folder, &names)?.map_or(Ok(vec![]), |failures| grouped(&failures, &axes))
    }
}

/// Rows of failures, equal failures merged, in the order of first occurrence.
fn grouped(batch: &RecordBatch, axes: &[&str]) -> Result<Vec<FailureCount>, Fault> {
    let unreadable = |e: &dyn std::fmt::Display| Fault::machine(format!("cannot read the failures: {e}"));
    let mut found: Vec<FailureCount> = vec![];
    let mut known: HashMap<(String, String), usize> = HashMap::new();
    let cell = |row: usize, name: &str| -> Result<Option<String>, Fault> {
        let array = batch.column_by_name(name).filter(|a| a.is_valid(row));
        array.map(|a| arrow_cast::display::array_value_to_string(a, row).map_err(|e| unreadable(&e))).transpose()
    };
    for row in 0..batch.num_rows() {
        let (stage, error) = (cell(row, "stage")?.unwrap_or_default(), cell(row, "error")?.unwrap_or_default());
        let next = found.len();
        let at = *known.entry((stage.clone(), error.clone())).or_insert(next);
        if let Some(known) = found.get_mut(at) {
            known.times += 1;
            continue;
        }
        let mut place = vec![];
        for name in axes.iter().copied().chain(["flight", "line"]) {
            place.extend(cell(row, name)?.map(|v| format!("{name} {v}")));
        }
        found.push(FailureCount { stage, error, example: place.join(", "), times: 1 });
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float64Array};

    use super::*;

    #[test]
    fn unit_the_same_failure_is_listed_once() {
        let text = |v: Vec<Option<&str>>| Arc::new(StringArray::from(v)) as ArrayRef;
        let batch = RecordBatch::try_from_iter_with_nullable([
            ("lambda", Arc::new(Float64Array::from(vec![Some(0.5), None, Some(0.5)])) as ArrayRef, true),
            ("flight", text(vec![Some("1"), Some("2"), Some("3")]), true),
            ("line", text(vec![Some("1.01"), None, Some("3.01")]), true),
            ("stage", text(vec![Some("fit"), Some("track"), Some("fit")]), true),
            ("error", text(vec![Some("singular"), Some("off the map"), Some("singular")]), true),
        ])
        .unwrap();
        let found = grouped(&batch, &["lambda"]).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].times, found[0].example.as_str()), (2, "lambda 0.5, flight 1, line 1.01"));
        assert_eq!((found[1].times, found[1].example.as_str()), (1, "flight 2"));
    }
}
