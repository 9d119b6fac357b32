//! A table that `magline run` publishes opens as a lazy frame. The test uses the binary that a build of magline left in
//! `target/debug`.

use std::{path::Path, process::Command};

use polars::prelude::{DataType, col, lit};

#[test]
fn a_store_opens_table_by_table() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = tempfile::tempdir().unwrap();
    let done = Command::new(root.join("target/debug/magline"))
        .args(["run", "datasets/examples/tolles_lawson.toml", "--set"])
        .arg(format!("store={}", folder.path().display()))
        .current_dir(&root)
        .output()
        .expect("build magline first: cargo build");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let tables = frames::tables(folder.path()).unwrap();
    assert!(tables.iter().any(|name| name.ends_with(".scores")), "{tables:?}");
    for name in &tables {
        let frame = frames::scan(folder.path(), name).unwrap().collect().unwrap();
        assert!(frame.width() > 0, "{name}");
    }
    let scores = tables.iter().find(|name| name.ends_with(".scores")).unwrap();
    let ratios = frames::scan(folder.path(), scores).unwrap().filter(col("metric").eq(lit("improvement_ratio")));
    let ratios = ratios.select([col("lambda"), col("value")]).collect().unwrap();
    assert!(ratios.height() > 0);
    assert_eq!(ratios.column("lambda").unwrap().dtype(), &DataType::Float64);
    assert!(ratios.column("value").unwrap().f64().unwrap().iter().all(|x| x.is_some_and(|x| x > 0.0)));
    let missing = frames::scan(folder.path(), "nothing.scores").err().unwrap().to_string();
    assert!(missing.contains(scores.as_str()), "{missing}");
}
