//! Comparison of runs, spectra, profiles of maps and coastlines.

use std::{f64::consts::TAU, fs};

use serde_json::Value;

use super::{Viewed, column, ran, sql};
use crate::support::{Bench, anomaly, changed, read, stderr, write};

const TABLE: &str = "small.scores";

/// Positions of the metric and of each shared point, with the reason why its rows are unequal.
fn reasons<'a>(block: &'a Value, metric: &str) -> Vec<&'a str> {
    let at = block["metrics"].as_array().unwrap().iter().position(|m| m["name"] == metric).unwrap();
    let code = |code: &Value| block["reasons"][code.as_u64().unwrap() as usize].as_str().unwrap();
    block["rows"][at].as_array().unwrap().iter().map(code).collect()
}

/// Values of a metric of one run, by the text of the point.
fn values(block: &Value, side: usize, metric: &str) -> Vec<(String, f64)> {
    let at = block["metrics"].as_array().unwrap().iter().position(|m| m["name"] == metric).unwrap();
    let word = |axis: usize, row: usize| {
        let code = block["at"][axis][row].as_u64().unwrap() as usize;
        block["axes"][axis]["values"][code].as_str().unwrap().to_owned()
    };
    let axes = block["axes"].as_array().unwrap().len();
    let cells = block["sides"][side]["values"][at].as_array().unwrap().iter().enumerate();
    let mut found: Vec<(String, f64)> = cells
        .map(|(row, v)| ((0..axes).map(|a| word(a, row)).collect::<Vec<_>>().join(" "), v.as_f64().unwrap()))
        .collect();
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}

/// The same from the published table.
fn stored(bench: &Bench, metric: &str) -> Vec<(String, f64)> {
    by_point(bench, &format!("SELECT mag, vector, lambda, value FROM small.scores_pooled WHERE metric = '{metric}'"))
}

/// The column `value` of a query, by the text of the point.
fn by_point(bench: &Bench, query: &str) -> Vec<(String, f64)> {
    let rows = sql(bench, query);
    let point =
        |row: &Value| format!("{} {} {}", row["mag"].as_str().unwrap(), row["vector"].as_str().unwrap(), row["lambda"]);
    let mut found: Vec<(String, f64)> =
        rows.iter().map(|row| (point(row).replace("0.0 ", "0 "), row["value"].as_f64().unwrap())).collect();
    found.iter_mut().for_each(|(point, _)| *point = point.strip_suffix(".0").unwrap_or(point).to_owned());
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}

#[test]
fn user_runs_are_compared_and_unequal_rows_are_marked() {
    let bench = ran();
    let first = stored(&bench, "std_error");
    let lines = "SELECT mag, vector, lambda, avg(value) AS value FROM small.scores WHERE metric = 'std_error' \
                 AND NOT in_sample GROUP BY mag, vector, lambda";
    let first_mean = by_point(&bench, lines);
    let run = |sets: &[&str]| {
        let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
        let done = bench.run(&sets);
        assert_eq!(done.code, 0, "{}", done.stderr);
    };
    run(&["stages.coefficients.trim=40"]);
    let second = stored(&bench, "std_error");
    let second_mean = by_point(&bench, lines);
    run(&["stages.clean.where=\"line <> '2.02'\""]);
    run(&["stages.even.rate_hz=5.0"]);
    run(&["stages.scores.truth=\"mag_4_uc\"", "axes.lambda=[0.0, 1.0]"]);
    let viewed = Viewed::new(&bench, &["store"]);
    let compare =
        |against: u64, run: u64| viewed.json(&format!("api/against?table={TABLE}&against={against}&run={run}"));

    let trim = compare(1, 2);
    assert_eq!((trim["points"].as_u64(), &trim["only"][0]["count"]), (Some(8), &0.into()));
    assert!(reasons(&trim, "std_error").iter().all(|reason| reason.is_empty()), "{}", trim["reasons"]);
    // The values are those that the runs published.
    for (side, stored) in [(0, &first), (1, &second)] {
        for ((point, shown), (same, value)) in values(&trim, side, "std_error").iter().zip(stored) {
            assert!(point == same && (shown - value).abs() <= 1e-12 * value.abs(), "{point} {same} {shown} {value}");
        }
    }
    assert_ne!(first, second);
    // The mean of the differences on single lines is the difference of the means.
    let at = trim["metrics"].as_array().unwrap().iter().position(|m| m["name"] == "std_error").unwrap();
    let mut means: Vec<f64> = vec![];
    for pairs in trim["pairs"][at].as_array().unwrap() {
        let pairs: Vec<f64> = pairs.as_array().unwrap().iter().map(|d| d.as_f64().unwrap()).collect();
        means.push(pairs.iter().sum::<f64>() / pairs.len() as f64);
    }
    let mut known: Vec<f64> = first_mean.iter().zip(&second_mean).map(|((_, a), (_, b))| b - a).collect();
    means.sort_by(f64::total_cmp);
    known.sort_by(f64::total_cmp);
    assert!(means.iter().zip(&known).all(|(a, b)| (a - b).abs() < 1e-9) && known.len() == 8, "{means:?} {known:?}");
    assert!(known.iter().any(|d| d.abs() > 1e-9));
    let changes = trim["changes"].as_array().unwrap();
    assert_eq!(changes.len(), 1, "{changes:?}");
    assert_eq!((&changes[0]["table"], &changes[0]["what"]), (&"coefficients".into(), &"trim".into()));
    assert_eq!((&changes[0]["before"], &changes[0]["after"]), (&"20".into(), &"40".into()));
    assert_eq!(changes[0]["points"].as_u64(), Some(8));

    let lines = compare(1, 3);
    assert!(
        reasons(&lines, "std_error").iter().all(|r| r.starts_with("different lines: run 1 only: ")),
        "{}",
        lines["reasons"]
    );
    assert!(lines["pairs"][at].as_array().unwrap().iter().all(|pairs| pairs.as_array().unwrap().is_empty()));
    assert!(lines["reasons"].to_string().contains("2.02"));
    let rate = compare(1, 4);
    assert!(
        reasons(&rate, "std_error").iter().all(|reason| reason.starts_with("different n: ")),
        "{}",
        rate["reasons"]
    );
    let truth = compare(4, 5);
    assert!(
        reasons(&truth, "std_error").iter().all(|r| r.starts_with("the scores were computed differently: ")),
        "{}",
        truth["reasons"]
    );
    // The points of one run only are listed.
    assert_eq!(
        (truth["points"].as_u64(), &truth["only"][0]["count"], &truth["only"][1]["count"]),
        (Some(4), &4.into(), &4.into())
    );
    assert!(truth["only"][1]["points"][0].as_str().unwrap().contains("lambda = 1"));
    // Without a number, the newest run is shown.
    assert_eq!(viewed.json(&format!("api/against?table={TABLE}&against=1"))["runs"][1]["number"], 5);

    viewed.refused(&format!("api/against?table={TABLE}&against=99"), 404);
    viewed.refused("api/against?table=small.clean&against=1", 404);
    viewed.refused("api/against?table=nobody.scores&against=1", 404);
    let gone = bench.magline(&["gc", "--store", "store", "--yes"]);
    assert!(gone.status.success(), "{}", stderr(&gone));
    let said = Viewed::new(&bench, &["store"]).refused(&format!("api/against?table={TABLE}&against=1"), 404);
    assert!(said.contains("no longer in the store"), "{said}");
}

#[test]
fn user_other_data_of_a_line_are_marked() {
    let bench = ran();
    let path = bench.path("flights");
    let file = fs::read_dir(&path).unwrap().flatten().map(|e| e.path()).find(|p| p.is_file()).unwrap();
    let rows = read(&path);
    let other: Vec<_> =
        rows.iter().map(|b| changed(b, "mag_1_c", |i, x| x + if i == 7 { 0.25 } else { 0.0 })).collect();
    for entry in fs::read_dir(&path).unwrap().flatten() {
        fs::remove_file(entry.path()).unwrap();
    }
    write(&file, &other);
    assert_eq!(bench.run(&[]).code, 0);
    let block = Viewed::new(&bench, &["store"]).json(&format!("api/against?table={TABLE}&against=1"));
    assert!(
        reasons(&block, "std_error").iter().any(|reason| reason.starts_with("different data on ")),
        "{}",
        block["reasons"]
    );
    let inputs = block["changes"].as_array().unwrap().iter().filter(|change| change["kind"] == "input");
    assert!(inputs.into_iter().any(|change| change["what"].as_str().unwrap().starts_with("data of line")));
}

#[test]
fn user_a_report_compares_with_an_earlier_run() {
    let bench = ran();
    assert_eq!(bench.run(&["--set", "stages.coefficients.trim=40"]).code, 0);
    let report = |args: &[&str]| {
        let set = ["--set", "stages.coefficients.trim=40"];
        bench.magline(&[&["report", "spec.toml", "-o", "page.html"][..], &set, args].concat())
    };
    let done = report(&["--against", "1"]);
    assert!(done.status.success(), "{}", stderr(&done));
    let page = fs::read_to_string(bench.path("page.html")).unwrap();
    let block =
        page.split("id=\"against\"").nth(1).unwrap().split("<script type=\"application/json\">").nth(1).unwrap();
    let block: Value = serde_json::from_str(block.split("</script>").next().unwrap()).unwrap();
    assert_eq!((&block[0]["runs"][0]["number"], &block[0]["runs"][1]["number"]), (&1.into(), &2.into()));
    let stored = stored(&bench, "std_error");
    for ((point, shown), (same, value)) in values(&block[0], 1, "std_error").iter().zip(&stored) {
        assert!(point == same && (shown - value).abs() <= 1e-12 * value.abs(), "{point} {same} {shown} {value}");
    }
    // An id names the newest run with it.
    let id = block[0]["runs"][0]["run"].as_str().unwrap();
    assert!(report(&["--against", id]).status.success());
    for (args, said) in [(&["--against", "9"][..], "no run 9"), (&["--against", "2"], "newest run")] {
        let failed = report(args);
        assert_eq!((failed.status.code(), stderr(&failed).contains(said)), (Some(2), true), "{}", stderr(&failed));
    }
    let tracks = bench.magline(&["report", "spec.toml", "-o", "t.kml", "--against", "1"]);
    assert_eq!((tracks.status.code(), stderr(&tracks).contains(".html")), (Some(2), true), "{}", stderr(&tracks));
    let stale = bench.magline(&["report", "spec.toml", "-o", "page.html", "--against", "1"]);
    assert_eq!(
        (stale.status.code(), stderr(&stale).contains("magline run spec.toml")),
        (Some(2), true),
        "{}",
        stderr(&stale)
    );
}

/// Welch's density at one bin, from its definition.
fn density(x: &[f64], rate_hz: f64, segment: usize, bin: usize) -> f64 {
    let taper = |k: usize| 0.5 - 0.5 * (TAU * k as f64 / segment as f64).cos();
    let power: f64 = (0..segment).map(|k| taper(k).powi(2)).sum();
    let (mut sum, mut count) = (0.0, 0.0);
    for part in x.windows(segment).step_by(segment / 2) {
        let mean = part.iter().sum::<f64>() / segment as f64;
        let angle = |k: usize| TAU * (bin * k % segment) as f64 / segment as f64;
        let of =
            |f: fn(f64) -> f64| part.iter().enumerate().map(|(k, x)| (x - mean) * taper(k) * f(angle(k))).sum::<f64>();
        sum += of(f64::cos).powi(2) + of(f64::sin).powi(2);
        count += 1.0;
    }
    let sides = if 2 * bin == segment { 1.0 } else { 2.0 };
    sides * sum / (rate_hz * power * count)
}

#[test]
fn law_a_spectrum_is_of_all_samples_in_the_interval() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    let query = "SELECT tt, mag_4_uc AS x FROM small.even WHERE line = '1.01' ORDER BY tt";
    let rows = sql(&bench, query);
    let (tt, x) = (column(&rows, "tt"), column(&rows, "x"));
    let flight = sql(&bench, "SELECT DISTINCT flight FROM small.even WHERE line = '1.01'")[0]["flight"].clone();
    let line = format!("table=small.even&flight={}&line=1.01", flight.as_str().unwrap());
    let (from, to) = (tt[60], tt[420]);
    for (part, range) in [(&x[..], String::new()), (&x[60..=420], format!("&from={from}&to={to}"))] {
        let found = viewed.json(&format!("api/spectrum?{line}&columns=mag_4_uc&pixels=1{range}"));
        let segment = found["segment"].as_u64().unwrap() as usize;
        assert_eq!((found["rows"].as_u64(), &found["rate_hz"]), (Some(part.len() as u64), &10.0.into()));
        assert_eq!(
            (&found["columns"][0]["unit"], found["frequency"].as_array().unwrap().len()),
            (&"nT".into(), segment / 2)
        );
        for bin in [1, 2, segment / 4, segment / 2] {
            let shown = found["columns"][0]["density"][bin - 1].as_f64().unwrap();
            let direct = density(part, 10.0, segment, bin).sqrt();
            // The text of the query may differ in the last bit of 50,000 nT.
            assert!((shown - direct).abs() < 1e-9 + 1e-6 * direct, "{bin}: {shown} {direct}");
            assert_eq!(found["frequency"][bin - 1].as_f64().unwrap(), bin as f64 * 10.0 / segment as f64);
        }
    }
    viewed.refused(&format!("api/spectrum?{line}&columns=nothing"), 404);
    viewed.refused(&format!("api/spectrum?{line}&columns=mag_4_uc&from={from}&to={from}"), 400);
}

#[test]
fn law_a_profile_is_bilinear_between_the_nodes() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    let of = |from: &str, to: &str| viewed.json(&format!("api/profile?table=small.anomaly&from={from}&to={to}"));
    let found = of("45.0,9.95", "45.0,10.2");
    let number = |key: &str, i: usize| found[key][i].as_f64();
    let node = |k: f64| 9.9 + 0.0025 * k;
    let mut known = 0;
    for i in 0..found["lon"].as_array().unwrap().len() {
        let lon = number("lon", i).unwrap();
        let (cell, part) = (((lon - 9.9) / 0.0025).floor(), ((lon - 9.9) / 0.0025).fract());
        let between = (1.0 - part) * anomaly(45.0, node(cell)) + part * anomaly(45.0, node(cell + 1.0));
        match number("value", i) {
            Some(value) => {
                known += 1;
                assert!((value - between).abs() < 1e-3, "{lon}: {value} {between}");
            }
            None => assert!(lon > 10.1 - 1e-9, "{lon}"),
        }
    }
    assert_eq!(found["known"].as_u64(), Some(known));
    assert!(known > 50 && found["unit"] == "nT");
    // A degree of longitude at 45 degrees north is 78,846.8 m long (WGS-84).
    let last = found["lon"].as_array().unwrap().len() - 1;
    assert!((number("distance_m", last).unwrap() / (0.25 * 78_846.8) - 1.0).abs() < 1e-5);
    for wrong in ["from=45,10&to=45,10", "from=95,10&to=45,10", "from=45&to=45,10", "from=45,10"] {
        viewed.refused(&format!("api/profile?table=small.anomaly&{wrong}"), 400);
    }
    viewed.refused("api/profile?table=small.clean&from=45,10&to=45,11", 400);
}

#[test]
fn user_coastlines_of_a_region_are_sent() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    let lines = viewed.json("api/coast?west=144&east=149&south=-44&north=-40")["lines"].clone();
    let first = lines[0].as_array().unwrap();
    assert!(!lines.as_array().unwrap().is_empty() && first.len().is_multiple_of(2));
    assert!(
        (130.0..160.0).contains(&first[0].as_f64().unwrap()) && (-50.0..-35.0).contains(&first[1].as_f64().unwrap())
    );
    assert_eq!(viewed.json("api/coast?west=9.9&east=10.1&south=44.95&north=45.05")["lines"], Value::Array(vec![]));
    viewed.refused("api/coast?west=2&east=1&south=0&north=1", 400);
}
