#![allow(clippy::unwrap_used)]

use std::{fs, path::Path, sync::Arc};

use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use schemas::{Fault, Role, field, keys::HashKey};
use tempfile::TempDir;

use super::{
    NewUnit, Remarks, SealedFile, Store,
    sealed::{self, StoreFileFault},
    verify,
};

fn batch(rows: usize, from: f64) -> RecordBatch {
    let numbers: ArrayRef = Arc::new((0..rows).map(|i| Some(from + i as f64)).collect::<Float64Array>());
    let texts: ArrayRef = Arc::new(StringArray::from(vec!["a line"; rows]));
    let fields = vec![
        field("line", DataType::Utf8, "", Role::Key, "line"),
        field("x", DataType::Float64, "nT", Role::Derived, "x"),
    ];
    RecordBatch::try_new(Arc::new(Schema::new(fields)), vec![texts, numbers]).unwrap()
}

fn unit(name: &str, rows: Result<RecordBatch, Fault>, left_out: Vec<Fault>) -> NewUnit {
    let remarks = Remarks { warnings: left_out.iter().map(|fault| fault.what.clone()).collect(), left_out };
    NewUnit { key: HashKey::from_parts([name]), passthrough_hash: 7, rows, remarks }
}

fn all(file: &Path) -> Result<Vec<RecordBatch>, StoreFileFault> {
    let sealed = SealedFile::open(file)?;
    let columns = 0..sealed.schema().fields().len();
    let group = |g: usize| -> Result<RecordBatch, StoreFileFault> {
        let arrays = columns.clone().map(|c| sealed.column(g, c)).collect::<Result<Vec<_>, _>>()?;
        Ok(RecordBatch::try_new(sealed.schema().clone(), arrays).unwrap())
    };
    (0..sealed.starts().len() - 1).map(group).collect()
}

#[test]
fn unit_reads_reject_and_verify_reports_every_flipped_bit() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.parquet");
    let (one, other) = (batch(50, 0.0), batch(30, 9.5));
    sealed::write(&file, &one.schema(), &[("a".to_owned(), "b".to_owned())], [Ok(one.clone()), Ok(other.clone())])
        .unwrap();
    let bytes = fs::read(&file).unwrap();
    assert_eq!(all(&file).unwrap(), [one.clone(), other.clone()]);
    verify(&file).unwrap();
    for i in 0..bytes.len() {
        let mut wrong = bytes.clone();
        wrong[i] ^= 1 << (i % 8);
        fs::write(&file, &wrong).unwrap();
        if let Ok(read) = all(&file) {
            assert!(read == [one.clone(), other.clone()], "byte {i} of {}", bytes.len());
        }
        assert!(matches!(verify(&file), Err(StoreFileFault::Damaged(_))), "byte {i} of {}", bytes.len());
    }
    for length in 0..bytes.len() {
        fs::write(&file, &bytes[..length]).unwrap();
        assert!(matches!(SealedFile::open(&file), Err(StoreFileFault::Damaged(_))), "{length} bytes");
    }
}

#[test]
fn unit_packs_return_units_with_their_faults() {
    let folder = TempDir::new().unwrap();
    let left = vec![Fault::data("short").in_line("1", "1.02")];
    let long = batch(super::GROUP_ROWS + 10, 100.0);
    {
        let store = Store::open(folder.path()).unwrap();
        let units = vec![
            unit("a", Ok(batch(3, 1.0)), vec![]),
            unit("b", Err(Fault::data("flat").help("fly").in_line("1", "1.01").in_row(4)), vec![]),
            unit("c", Ok(batch(0, 0.0)), vec![]),
            unit("d", Ok(long.clone()), left.clone()),
            unit("e", Ok(batch(5, 2.0)), vec![]),
        ];
        store
            .pack(HashKey::from_parts(["pack"]), HashKey::from_parts(["kind"]), &batch(0, 0.0).schema(), &[], units)
            .unwrap();
        store.write_index().unwrap();
    }
    // Reads with the index, without it, and with an index that is damaged at any place.
    let index = fs::read(folder.path().join("index")).unwrap();
    for wrong in (0..index.len()).step_by(7).map(Some).chain([None]) {
        match wrong {
            Some(i) => {
                let mut bytes = index.clone();
                bytes[i] ^= 16;
                fs::write(folder.path().join("index"), bytes).unwrap();
            }
            None => fs::remove_file(folder.path().join("index")).unwrap(),
        }
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(
            store.get(HashKey::from_parts(["a"]), &["x", "line"]).unwrap(),
            batch(3, 1.0).project(&[1, 0]).unwrap()
        );
        assert_eq!(store.whole(HashKey::from_parts(["d"])).unwrap(), long);
        assert_eq!(store.whole(HashKey::from_parts(["e"])).unwrap(), batch(5, 2.0));
        assert_eq!(store.whole(HashKey::from_parts(["c"])).unwrap().num_rows(), 0);
        assert!(!store.has(HashKey::from_parts(["b"])) && !store.has(HashKey::from_parts(["f"])));
        let remarks = store.remarks(HashKey::from_parts(["d"])).unwrap();
        assert_eq!((remarks.warnings.len(), remarks.left_out), (left.len(), left.clone()));
        let fault = store.failed(HashKey::from_parts(["b"])).unwrap().unwrap();
        assert_eq!((fault.what.as_str(), fault.place.row), ("flat", Some(4)));
        assert!(store.damaged().is_empty());
    }
}

#[test]
fn unit_stored_faults_are_faults_of_the_data() {
    let folder = TempDir::new().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let spec = || Fault::new("too short").at(3..5);
    let units = vec![unit("a", Err(spec()), vec![]), unit("b", Ok(batch(1, 1.0)), vec![spec()])];
    store
        .pack(HashKey::from_parts(["pack"]), HashKey::from_parts(["kind"]), &batch(0, 0.0).schema(), &[], units)
        .unwrap();
    let expected = Fault::data("too short");
    assert_eq!(store.failed(HashKey::from_parts(["a"])).unwrap(), Some(expected.clone()));
    assert_eq!(store.remarks(HashKey::from_parts(["b"])).unwrap().left_out, [expected]);
}

#[test]
fn unit_damaged_pack_is_quarantined_and_replaced_by_another_with_its_units() {
    let folder = TempDir::new().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let schema = batch(0, 0.0).schema();
    let both = |id: &str, names: &[&str]| {
        let units = names.iter().map(|n| unit(n, Ok(batch(4, 1.0)), vec![])).collect();
        store.pack(HashKey::from_parts([id]), HashKey::from_parts(["kind"]), &schema, &[], units).unwrap();
        store.file(HashKey::from_parts([id]))
    };
    both("one", &["a"]);
    let damaged = both("two", &["a", "b"]);
    let mut bytes = fs::read(&damaged).unwrap();
    bytes[40] ^= 1;
    fs::write(&damaged, bytes).unwrap();
    drop(store);
    let store = Store::open(folder.path()).unwrap();
    assert_eq!(store.whole(HashKey::from_parts(["a"])).unwrap(), batch(4, 1.0));
    assert!(!store.has(HashKey::from_parts(["b"])));
    assert_eq!(store.damaged().len(), 1);
    assert!(!damaged.exists() && folder.path().join("damaged").join(damaged.file_name().unwrap()).is_file());
}

#[test]
fn unit_lists_and_texts_round_trip_and_row_groups_end_with_a_unit() {
    let folder = TempDir::new().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let item = Arc::new(Field::new("item", DataType::Float64, false));
    let lists = |n: usize| -> RecordBatch {
        let values: ArrayRef = Arc::new(Float64Array::from_iter_values((0..2 * n).map(|i| i as f64)));
        let list = arrow_array::FixedSizeListArray::try_new(item.clone(), 2, values, None).unwrap();
        let kind = list.data_type().clone();
        RecordBatch::try_new(Arc::new(Schema::new(vec![Field::new("tl", kind, true)])), vec![Arc::new(list)]).unwrap()
    };
    let sizes = [60_000, 30_000, 30_000, 5];
    let units = sizes.iter().map(|n| unit(&n.to_string(), Ok(lists(*n)), vec![]));
    let id = HashKey::from_parts(["lists"]);
    // Two units have the same name; the later one is found, and both are written.
    store.pack(id, HashKey::from_parts(["kind"]), &lists(0).schema(), &[], units.collect()).unwrap();
    let sealed = SealedFile::open(&store.file(id)).unwrap();
    assert_eq!(sealed.starts(), [0, 90_000, 120_005]);
    for n in [60_000, 30_000, 5] {
        assert_eq!(store.whole(HashKey::from_parts([n.to_string()])).unwrap(), lists(n));
    }
}
