//! The lines that a survey stage went on without, kept beside its answer: who reuses the answer is told of them again.

use std::sync::Arc;

use arrow_array::{Array, ArrayRef, Int64Array, RecordBatch, StringArray, cast::AsArray, types::Int64Type};
use schemas::{Fault, Owner, Place};

use crate::{keys::Key, store::Store};

const TEXTS: [&str; 5] = ["flight", "line", "what", "help", "column"];

/// Where they are kept.
fn place(answer: Key) -> Key {
    Key::of(["lines left out".to_owned(), answer.to_string()])
}

/// Keeps them, if there are any. It must be done before the answer itself is kept.
///
/// # Errors
/// When the store cannot be written.
pub fn keep(store: &Store, answer: Key, faults: &[Fault]) -> Result<(), Fault> {
    if faults.is_empty() {
        return Ok(());
    }
    let text =
        |of: fn(&Fault) -> Option<&str>| -> ArrayRef { Arc::new(faults.iter().map(of).collect::<StringArray>()) };
    let columns = [
        text(|f| f.place.flight.as_deref()),
        text(|f| f.place.line.as_deref()),
        text(|f| Some(&f.what)),
        text(|f| f.help.as_deref()),
        text(|f| f.place.column.as_deref()),
    ];
    let rows = faults.iter().map(|f| f.place.row.and_then(|row| i64::try_from(row).ok()));
    let rows: ArrayRef = Arc::new(rows.collect::<Int64Array>());
    let named = TEXTS.into_iter().zip(columns).chain([("row", rows)]).map(|(name, column)| (name, column, true));
    let batch = RecordBatch::try_from_iter_with_nullable(named).map_err(|e| Fault::machine(e.to_string()))?;
    store.put(place(answer), &batch)
}

/// What was kept, each fault with its line.
///
/// # Errors
/// When the store is damaged.
pub fn kept(store: &Store, answer: Key) -> Result<Vec<Fault>, Fault> {
    if !store.has(place(answer)) {
        return Ok(vec![]);
    }
    let batch = store.whole(place(answer))?;
    let text = |name: &str, i: usize| {
        let column = batch.column_by_name(name).and_then(|c| c.as_string_opt::<i32>());
        column.filter(|c| c.is_valid(i)).map(|c| c.value(i).to_owned())
    };
    let rows = batch.column_by_name("row").and_then(|c| c.as_primitive_opt::<Int64Type>());
    let fault = |i: usize| {
        let row = rows.filter(|c| c.is_valid(i)).and_then(|c| u64::try_from(c.value(i)).ok());
        let place =
            Place { file: None, flight: text("flight", i), line: text("line", i), column: text("column", i), row };
        let what = text("what", i).unwrap_or_default();
        Fault { what, help: text("help", i), place, owner: Owner::Data, ..Fault::default() }
    };
    Ok((0..batch.num_rows()).map(fault).collect())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn law_what_is_kept_comes_back_and_nothing_is_nothing() {
        let folder = tempfile::TempDir::new().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let (one, other) = (Key::of(["one"]), Key::of(["other"]));
        let faults = [
            Fault::data("steps").help("resample first").in_line("1", "1.01").in_column("tt").in_row(7),
            Fault::data("short").in_line("1", "1.02"),
        ];
        keep(&store, one, &faults).unwrap();
        keep(&store, other, &[]).unwrap();
        assert_eq!(kept(&store, one).unwrap(), faults);
        assert_eq!(kept(&store, other).unwrap(), []);
    }
}
