//! Small flights over a small map, and functions that run the binary on them.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::Arc,
};

use arrow_array::{Array, ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::{ArrowWriter, arrow_reader::ParquetRecordBatchReaderBuilder};
use serde_json::Value;
use tempfile::TempDir;

/// A folder with flights, a map and a spec.
pub struct Bench {
    pub folder: TempDir,
}

/// Outcome of a run, from its last JSON event.
#[derive(Debug)]
pub struct Done {
    pub code: i32,
    pub last: Value,
    pub stderr: String,
}

impl Done {
    pub fn computed(&self, table: &str) -> u64 {
        self.last["tables"][table]["computed"].as_u64().unwrap_or_else(|| panic!("no {table} in {}", self.last))
    }

    pub fn total(&self, what: &str) -> u64 {
        self.last[what].as_u64().unwrap_or_else(|| panic!("no {what} in {}", self.last))
    }
}

/// Runs the binary with `args` in `folder`.
pub fn magline(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_magline")).args(args).current_dir(folder).output().unwrap()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Root folder of the repository.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

impl Bench {
    /// Two flights of two lines each, a map, and the spec of [`SPEC`].
    pub fn new() -> Bench {
        let bench = Bench { folder: TempDir::new().unwrap() };
        fs::create_dir(bench.path("flights")).unwrap();
        for flight in ["1", "2"] {
            let lines =
                [("01", 700), ("02", 500)].map(|(line, rows)| line_of(flight, &format!("{flight}.{line}"), rows));
            write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
        }
        write(&bench.path("map.parquet"), &[map()]);
        bench.spec(SPEC);
        bench
    }

    /// Adds three flights of four lines each to [`Bench::new`], so that some tables have several files.
    pub fn of_many_lines() -> Bench {
        let bench = Bench::new();
        for flight in ["3", "4", "5"] {
            let lines = ["01", "02", "03", "04"].map(|line| line_of(flight, &format!("{flight}.{line}"), 1200));
            write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
        }
        bench
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn spec(&self, text: &str) {
        fs::write(self.path("spec.toml"), text).unwrap();
    }

    pub fn magline(&self, args: &[&str]) -> Output {
        magline(self.folder.path(), args)
    }

    /// Runs `magline run spec.toml --json` with additional arguments.
    pub fn run(&self, more: &[&str]) -> Done {
        let args: Vec<&str> = ["run", "spec.toml", "--json"].iter().chain(more).copied().collect();
        let output = self.magline(&args);
        let text = stdout(&output);
        let last = text.lines().last().map(|l| serde_json::from_str(l).unwrap()).unwrap_or(Value::Null);
        Done { code: output.status.code().unwrap(), last, stderr: stderr(&output) }
    }

    /// Files of the tables of a store with their bytes.
    pub fn tables(&self, store: &str) -> BTreeMap<String, Vec<u8>> {
        let mut found = BTreeMap::new();
        collect(&self.path(store).join("tables"), "", &mut found);
        found
    }
}

fn collect(folder: &Path, prefix: &str, found: &mut BTreeMap<String, Vec<u8>>) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let name = format!("{prefix}/{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            collect(&entry.path(), &name, found);
        } else {
            found.insert(name, fs::read(entry.path()).unwrap());
        }
    }
}

/// Spec of two magnetometers, two vector magnetometers and two ridge parameters, up to scores.
pub const SPEC: &str = r#"
name  = "small"
seed  = 1
store = "store"

[tables.flights]
path = "flights/"

[tables.anomaly]
path = "map.parquet"

[axes]
mag    = ["mag_4_uc", "mag_5_uc"]
vector = ["flux_a", "flux_d"]
lambda = [0.0, 0.025]

[[stages]]
name    = "even"
stage   = "resample"
input   = "flights"
rate_hz = 10.0

[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "even"
vector = "$vector"

[[stages]]
name   = "coefficients"
stage  = "fit"
input  = "terms"
where  = "line like '%.01'"
model  = "tolles_lawson"
target = "$mag"
lambda = "$lambda"

[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
model = "coefficients"
mag   = "$mag"

[[stages]]
name            = "track"
stage           = "navigate"
tuning          = "magnav"
input           = "clean"
map             = "anomaly"
offset_window_s = 1.0
core_field      = false

[[stages]]
name  = "scores"
stage = "score"
input = ["clean", "track"]
truth = "mag_1_c"
"#;

/// Anomaly of the small map, in nT.
pub fn anomaly(lat: f64, lon: f64) -> f64 {
    120.0 * (220.0 * (lat - 45.0)).sin() + 90.0 * (180.0 * (lon - 10.0) + 50.0 * (lat - 45.0)).cos()
}

/// Map of 0.2 by 0.2 degrees around 45 degrees north, 10 degrees east.
pub fn map() -> RecordBatch {
    let axis = |from: f64| (0..81).map(move |i| from + f64::from(i) * 0.0025);
    let nodes: Vec<(f64, f64)> = axis(44.9).flat_map(|lat| axis(9.9).map(move |lon| (lat, lon))).collect();
    batch(&[
        ("lat", nodes.iter().map(|n| n.0).collect()),
        ("lon", nodes.iter().map(|n| n.1).collect()),
        ("alt", vec![300.0; nodes.len()]),
        ("anomaly", nodes.iter().map(|n| anomaly(n.0, n.1)).collect()),
    ])
}

/// Batch of number columns.
pub fn batch(columns: &[(&str, Vec<f64>)]) -> RecordBatch {
    let fields: Vec<Field> = columns.iter().map(|(n, _)| Field::new(*n, DataType::Float64, true)).collect();
    let arrays = columns.iter().map(|(_, v)| Arc::new(Float64Array::from(v.clone())) as ArrayRef).collect();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
}

/// Line with a straight track, pitch, roll and yaw manoeuvres, an exact Tolles-Lawson aircraft field, and a small slow
/// INS error.
pub fn line_of(flight: &str, line: &str, rows: usize) -> RecordBatch {
    let seed = line.bytes().map(u32::from).sum::<u32>() as f64;
    let t = |i: usize| i as f64 * 0.1;
    let each = |f: &dyn Fn(f64) -> f64| (0..rows).map(|i| f(t(i))).collect::<Vec<f64>>();
    let lat = each(&|t| 44.95 + 0.0004 * t + 0.0008 * (0.05 * t + seed).sin());
    let lon = each(&|t| 9.96 + 0.0006 * t + 0.0005 * (0.07 * t + seed).cos());
    let field = |i: usize| 48_000.0 + anomaly(lat[i], lon[i]);
    let (x, y, z): (Vec<f64>, Vec<f64>, Vec<f64>) = {
        let angle = |i: usize, w: f64, a: f64| a * (w * t(i) + seed).sin();
        let parts = |i: usize| {
            let (roll, pitch, yaw) = (angle(i, 1.3, 0.15), angle(i, 1.7, 0.1), angle(i, 0.9, 0.2) + 0.1 * seed);
            let north = [0.4, 0.0, (1.0f64 - 0.16).sqrt()];
            let level = [north[0] * yaw.cos(), -north[0] * yaw.sin(), north[2]];
            let pitched = [
                level[0] * pitch.cos() - level[2] * pitch.sin(),
                level[1],
                level[0] * pitch.sin() + level[2] * pitch.cos(),
            ];
            [
                pitched[0],
                pitched[1] * roll.cos() + pitched[2] * roll.sin(),
                -pitched[1] * roll.sin() + pitched[2] * roll.cos(),
            ]
        };
        let all: Vec<[f64; 3]> = (0..rows).map(parts).collect();
        let of = |k: usize| (0..rows).map(|i| all[i][k] * field(i)).collect();
        (of(0), of(1), of(2))
    };
    let aircraft = |scale: f64| {
        (0..rows)
            .map(|i| {
                let b = (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt();
                let (u, v, w) = (x[i] / b, y[i] / b, z[i] / b);
                scale * (60.0 * u - 35.0 * v + 20.0 * w + b / 50_000.0 * (15.0 * u * u - 9.0 * u * v + 12.0 * v * w))
            })
            .collect::<Vec<f64>>()
    };
    let wave = |i: usize, k: f64| 0.05 * (7.3 * t(i) * k + seed).sin();
    let truth: Vec<f64> = (0..rows).map(|i| field(i) - 48_000.0).collect();
    let sum = |a: Vec<f64>, k: f64| (0..rows).map(|i| truth[i] + a[i] + wave(i, k)).collect::<Vec<f64>>();
    let shifted = |x: &[f64], by: f64| x.iter().map(|v| v + by).collect::<Vec<f64>>();
    let numbers = batch(&[
        ("tt", each(&|t| 36_000.0 + t)),
        ("lat", lat.clone()),
        ("lon", lon.clone()),
        ("alt", vec![300.0; rows]),
        ("ins_lat", (0..rows).map(|i| lat[i] + 1e-5 + 2e-8 * t(i)).collect()),
        ("ins_lon", (0..rows).map(|i| lon[i] - 1e-5 - 3e-8 * t(i)).collect()),
        ("ins_alt", vec![300.0; rows]),
        ("mag_1_c", truth.clone()),
        ("mag_4_uc", sum(aircraft(1.0), 1.0)),
        ("mag_5_uc", sum(aircraft(2.5), 1.4)),
        ("flux_a_x", x.clone()),
        ("flux_a_y", y.clone()),
        ("flux_a_z", z.clone()),
        ("flux_d_x", shifted(&x, 25.0)),
        ("flux_d_y", shifted(&y, -40.0)),
        ("flux_d_z", z),
    ]);
    with_keys(flight, line, &numbers)
}

/// Batch with the leading columns `flight` and `line`.
pub fn with_keys(flight: &str, line: &str, numbers: &RecordBatch) -> RecordBatch {
    let text = |s: &str| Arc::new(StringArray::from(vec![s; numbers.num_rows()])) as ArrayRef;
    let keys = ["flight", "line"].map(|k| Arc::new(Field::new(k, DataType::Utf8, true)));
    let fields: Vec<_> = keys.into_iter().chain(numbers.schema().fields().iter().cloned()).collect();
    let arrays = [text(flight), text(line)].into_iter().chain(numbers.columns().iter().cloned()).collect();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
}

/// Batch with changed values of one column.
pub fn changed(batch: &RecordBatch, column: &str, change: impl Fn(usize, f64) -> f64) -> RecordBatch {
    let at = batch.schema().index_of(column).unwrap();
    let old = batch.column(at).as_any().downcast_ref::<Float64Array>().unwrap();
    let new: Float64Array = old.values().iter().enumerate().map(|(i, x)| change(i, *x)).collect();
    let mut columns = batch.columns().to_vec();
    columns[at] = Arc::new(new);
    RecordBatch::try_new(batch.schema(), columns).unwrap()
}

/// Batch without a column.
pub fn without(batch: &RecordBatch, column: &str) -> RecordBatch {
    let keep: Vec<usize> = (0..batch.num_columns()).filter(|i| batch.schema().field(*i).name() != column).collect();
    batch.project(&keep).unwrap()
}

/// Writes batches as one Parquet file.
pub fn write(path: &Path, batches: &[RecordBatch]) {
    let mut writer = ArrowWriter::try_new(fs::File::create(path).unwrap(), batches[0].schema(), None).unwrap();
    batches.iter().for_each(|b| writer.write(b).unwrap());
    writer.close().unwrap();
}

/// Rows of a published table.
pub fn read(folder: &Path) -> Vec<RecordBatch> {
    let mut files: Vec<PathBuf> = fs::read_dir(folder).unwrap().flatten().map(|e| e.path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "parquet"));
    files.sort();
    let open =
        |f: &PathBuf| ParquetRecordBatchReaderBuilder::try_new(fs::File::open(f).unwrap()).unwrap().build().unwrap();
    files.iter().flat_map(|f| open(f).map(Result::unwrap).collect::<Vec<_>>()).collect()
}

/// Numbers of a float or integer column over all batches.
pub fn numbers(batches: &[RecordBatch], column: &str) -> Vec<f64> {
    let one = |b: &RecordBatch| {
        let array = b.column_by_name(column).unwrap_or_else(|| panic!("no {column}"));
        if let Some(whole) = array.as_any().downcast_ref::<Int64Array>() {
            return whole.iter().map(|x| x.map_or(f64::NAN, |x| x as f64)).collect::<Vec<f64>>();
        }
        array
            .as_any()
            .downcast_ref::<Float64Array>()
            .unwrap()
            .iter()
            .map(|x| x.unwrap_or(f64::NAN))
            .collect::<Vec<f64>>()
    };
    batches.iter().flat_map(one).collect()
}

/// Strings of a column over all batches.
pub fn texts(batches: &[RecordBatch], column: &str) -> Vec<String> {
    let one = |b: &RecordBatch| {
        let array = b.column_by_name(column).unwrap_or_else(|| panic!("no {column}"));
        array
            .as_any()
            .downcast_ref::<StringArray>()
            .unwrap()
            .iter()
            .map(|x| x.unwrap_or("").to_owned())
            .collect::<Vec<String>>()
    };
    batches.iter().flat_map(one).collect()
}
