//! Models at a sample rate that differs from the rate of the fit.

use std::collections::HashMap;

use arrow_array::RecordBatch;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use crate::support::{Bench, batch, numbers, read, texts, with_keys, write};

const RATE_HZ: f64 = 40.0;
const FIELD_NT: f64 = 52_000.0;

/// Line at 40 Hz with slow manoeuvres. The magnetometer measures permanent and induced fields, and eddy currents from
/// the exact rate of change.
fn line(name: &str, seed: f64) -> RecordBatch {
    let rows = 6000;
    let vector = |t: f64| {
        let angle = |f: f64, a: f64, phase: f64| a * (std::f64::consts::TAU * f * t + phase + seed).sin();
        let (roll, pitch, yaw) =
            (angle(0.11, 0.25, 0.0), angle(0.14, 0.2, 1.0), angle(0.13, 0.3, 2.0) + 0.02 * t + seed);
        let level = [0.45 * yaw.cos(), -0.45 * yaw.sin(), (1.0f64 - 0.45 * 0.45).sqrt()];
        let z = level[0] * pitch.sin() + level[2] * pitch.cos();
        let body = [
            level[0] * pitch.cos() - level[2] * pitch.sin(),
            level[1] * roll.cos() + z * roll.sin(),
            z * roll.cos() - level[1] * roll.sin(),
        ];
        body.map(|b| FIELD_NT * b)
    };
    let mag = |t: f64| {
        let (b, after, before) = (vector(t), vector(t + 1e-3), vector(t - 1e-3));
        let rate: Vec<f64> = (0..3).map(|k| (after[k] - before[k]) / 2e-3 / FIELD_NT).collect();
        let u = b.map(|x| x / FIELD_NT);
        let eddy = 90.0 * u[0] * rate[1] - 60.0 * u[2] * rate[0] + 120.0 * u[1] * rate[2];
        FIELD_NT + 30.0 * u[0] - 20.0 * u[1] + 8.0 * u[0] * u[1] - 5.0 * u[1] * u[2] + eddy
    };
    let t = |i: usize| 36_000.0 + i as f64 / RATE_HZ;
    let each = |f: &dyn Fn(f64) -> f64| (0..rows).map(|i| f(t(i))).collect::<Vec<f64>>();
    let numbers = batch(&[
        ("tt", each(&|t| t)),
        ("mag_1_c", vec![FIELD_NT; rows]),
        ("mag_4_uc", each(&mag)),
        ("flux_a_x", each(&|t| vector(t)[0])),
        ("flux_a_y", each(&|t| vector(t)[1])),
        ("flux_a_z", each(&|t| vector(t)[2])),
    ]);
    with_keys("1", name, &numbers)
}

/// Every nth row.
fn thinned(line: &RecordBatch, n: usize) -> RecordBatch {
    let rows: Vec<RecordBatch> = (0..line.num_rows()).step_by(n).map(|row| line.slice(row, 1)).collect();
    arrow_select::concat::concat_batches(&line.schema(), &rows).unwrap()
}

fn bench(lines: &[RecordBatch]) -> Bench {
    let bench = Bench::new();
    std::fs::remove_dir_all(bench.path("flights")).unwrap();
    std::fs::create_dir(bench.path("flights")).unwrap();
    for (i, line) in lines.iter().enumerate() {
        write(&bench.path(&format!("flights/{i}.parquet")), std::slice::from_ref(line));
    }
    bench
}

fn resampled(rate_hz: u32) -> String {
    format!(
        "[[stages]]\nname = \"even_{rate_hz}\"\nstage = \"resample\"\ninput = \"flights\"\nrate_hz = {rate_hz}.0\n\
         [[stages]]\nname = \"terms_{rate_hz}\"\nstage = \"a_matrix\"\ninput = \"even_{rate_hz}\"\n\
         vector = \"flux_a\"\n\
         terms = [\"permanent\", \"induced5\", \"eddy8\"]\n"
    )
}

const HEAD: &str = "name = \"rates\"\nseed = 1\nstore = \"store\"\n[tables.flights]\npath = \"flights/\"\n";

fn fit(name: &str, input: &str, lines: &str) -> String {
    format!(
        "[[stages]]\nname = \"{name}\"\nstage = \"fit\"\ninput = \"{input}\"\nwhere = \"line in ({lines})\"\n\
         model = \"tolles_lawson\"\ntarget = \"mag_4_uc\"\nlambda = 0.0\n"
    )
}

fn applied(name: &str, input: &str, model: &str) -> String {
    format!(
        "[[stages]]\nname = \"{name}\"\nstage = \"compensate\"\ninput = \"{input}\"\nmodel = \"{model}\"\n\
         mag = \"mag_4_uc\"\n[[stages]]\nname = \"scores_{name}\"\nstage = \"score\"\ninput = \"{name}\"\n\
         truth = \"mag_1_c\"\nmetrics = [\"std_error\"]\n"
    )
}

/// Standard deviation of the error of each line, in nT.
fn errors(bench: &Bench, table: &str) -> HashMap<String, f64> {
    let scores = read(&bench.path(&format!("store/tables/rates/scores_{table}")));
    texts(&scores, "line").into_iter().zip(numbers(&scores, "value")).collect()
}

#[test]
fn law_a_model_fitted_at_10_hz_is_valid_at_other_rates() {
    let bench = bench(&[line("1.01", 0.0), line("1.02", 1.7)]);
    let mut spec = HEAD.to_owned();
    for rate_hz in [5, 10, 40] {
        spec += &resampled(rate_hz);
    }
    spec += &fit("model", "terms_10", "'1.01'");
    for rate_hz in [5, 10, 40] {
        spec += &applied(&format!("clean_{rate_hz}"), &format!("terms_{rate_hz}"), "model");
    }
    // Terms computed before thinning are treated as differences at the new rate.
    spec += "[[stages]]\nname = \"late\"\nstage = \"resample\"\ninput = \"terms_40\"\nrate_hz = 5.0\n";
    spec += &applied("clean_late", "late", "model");
    bench.spec(&spec);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    for (table, most_nt) in [("clean_5", 0.5), ("clean_10", 0.1), ("clean_40", 0.1), ("clean_late", 0.1)] {
        let found = errors(&bench, table)["1.02"];
        // Without conversion of the coefficients the error is 10 nT.
        assert!(found < most_nt, "{table}: {found} nT");
    }
    let rate = numbers(&read(&bench.path("store/tables/rates/model")), "rate_hz");
    assert!(rate.iter().all(|hz| *hz == 10.0), "{rate:?}");
    for (table, rate_hz) in [("terms_10", "10"), ("late", "5")] {
        let folder = bench.path(&format!("store/tables/rates/{table}"));
        let mut file = std::fs::read_dir(folder).unwrap().flatten().map(|e| e.path());
        let file = file.find(|f| f.extension().is_some_and(|e| e == "parquet")).unwrap();
        let schema = ParquetRecordBatchReaderBuilder::try_new(std::fs::File::open(file).unwrap()).unwrap();
        assert_eq!(schema.schema().field_with_name("tl").unwrap().metadata()["rate_hz"], rate_hz, "{table}");
    }
}

#[test]
fn law_lines_of_different_rates_give_one_model() {
    let (one, other) = (line("1.01", 0.0), line("1.02", 1.7));
    let again = line("1.03", 3.1);
    let bench = bench(&[thinned(&one, 4), other, thinned(&again, 8)]);
    let terms = "[[stages]]\nname = \"terms\"\nstage = \"a_matrix\"\ninput = \"flights\"\nvector = \"flux_a\"\n\
                 terms = [\"permanent\", \"induced5\", \"eddy8\"]\n";
    let learnt = "[[stages]]\nname = \"trees\"\nstage = \"fit\"\ninput = \"terms\"\n\
                  where = \"line in ('1.01', '1.02')\"\n\
                  model = \"recursive_least_squares\"\ntarget = \"mag_4_uc\"\nforgetting = 1.0\n";
    let spec = format!(
        "{HEAD}{terms}{}{}{learnt}{}",
        fit("model", "terms", "'1.01', '1.02'"),
        applied("clean", "terms", "model"),
        applied("clean_rows", "terms", "trees")
    );
    bench.spec(&spec);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    for table in ["clean", "clean_rows"] {
        let found = errors(&bench, table);
        assert!(found["1.01"] < 0.2 && found["1.02"] < 0.2 && found["1.03"] < 0.6, "{table}: {found:?}");
    }
    let rate = numbers(&read(&bench.path("store/tables/rates/model")), "rate_hz");
    assert!(rate.iter().all(|hz| *hz == 10.0), "that of the first line: {rate:?}");
}

#[test]
fn user_a_model_of_differences_without_a_rate_is_rejected() {
    let bench = bench(&[line("1.01", 0.0)]);
    let spec = format!("{HEAD}{}{}", resampled(10), fit("model", "terms_10", "'1.01'"));
    bench.spec(&spec);
    assert_eq!(bench.run(&[]).code, 0);
    // Table in the format of an earlier version.
    let old = read(&bench.path("store/tables/rates/model"));
    let old = old.iter().map(|b| crate::support::without(b, "rate_hz")).collect::<Vec<_>>();
    write(&bench.path("old.parquet"), &old);
    let head = HEAD.replace("[tables.flights]", "[tables.old]\npath = \"old.parquet\"\n[tables.flights]");
    let run = |terms: &str| {
        let stages = resampled(10).replace("[\"permanent\", \"induced5\", \"eddy8\"]", terms);
        bench.spec(&format!("{head}{stages}{}", applied("clean", "terms_10", "old")));
        bench.run(&[])
    };
    let done = run("[\"permanent\", \"induced5\", \"eddy8\"]");
    let message = format!("{}{}", done.stderr, done.last);
    assert!(done.code != 0 && message.contains("no `rate_hz`") && message.contains("fit"), "{message}");
}
