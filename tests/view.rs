//! `magline view` with a plain HTTP client.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Child, Command, Stdio},
    thread,
    time::Duration,
};

use arrow_array::{Array, RecordBatch};
use arrow_ipc::reader::StreamReader;
use base64::{Engine, prelude::BASE64_STANDARD};
use serde_json::Value;

use crate::support::{Bench, SPEC, anomaly, changed, line_of, numbers, read, stderr, stdout, write};

mod first;
mod runs;
mod strangers;

/// A server of the program, and the parts of its address.
struct Viewed {
    child: Child,
    host: String,
    token: String,
}

/// Answer of a server.
#[derive(Debug)]
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn read(bytes: &[u8]) -> Answer {
        let end = bytes.windows(4).position(|w| w == b"\r\n\r\n").unwrap_or_else(|| panic!("{bytes:?}"));
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        Answer { status, head: head.to_lowercase(), body: bytes[end + 4..].to_vec() }
    }

    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {self:?}"))
    }

    fn rows(&self) -> RecordBatch {
        assert_eq!(self.status, 200, "{}", String::from_utf8_lossy(&self.body));
        let mut reader = StreamReader::try_new(self.body.as_slice(), None).unwrap();
        let batch = reader.next().unwrap().unwrap();
        assert!(reader.next().is_none());
        batch
    }
}

impl Viewed {
    fn new(bench: &Bench, args: &[&str]) -> Viewed {
        let mut command = Command::new(env!("CARGO_BIN_EXE_magline"));
        command.arg("view").args(args).current_dir(bench.folder.path());
        let mut child = command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stderr.take().unwrap()).read_line(&mut line).unwrap();
        let rest = line.trim().strip_prefix("http://").unwrap_or_else(|| panic!("{line}"));
        let (host, token) = rest.trim_end_matches('/').split_once('/').unwrap();
        Viewed { child, host: host.to_owned(), token: token.to_owned() }
    }

    /// The answer to the bytes of a request.
    fn send(&self, request: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        stream.write_all(request).unwrap();
        let mut bytes = vec![];
        stream.read_to_end(&mut bytes).unwrap();
        Answer::read(&bytes)
    }

    fn ask(&self, method: &str, path: &str, host: &str) -> Answer {
        self.send(format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").as_bytes())
    }

    fn get(&self, rest: &str) -> Answer {
        self.ask("GET", &format!("/{}/{rest}", self.token), &self.host)
    }

    fn json(&self, rest: &str) -> Value {
        let answer = self.get(rest);
        assert_eq!(answer.status, 200, "{rest}: {}", String::from_utf8_lossy(&answer.body));
        answer.json()
    }

    /// The state of the runs, when the plan of the spec is made.
    fn run_state(&self) -> Value {
        for _ in 0..600 {
            let state = self.json("api/run");
            if state["state"] != "planning" {
                return state;
            }
            thread::sleep(Duration::from_millis(100));
        }
        panic!("the plan is not made");
    }

    /// Checks that a request is rejected with this status, and with an explanation.
    fn refused(&self, rest: &str, status: u16) -> String {
        let answer = self.get(rest);
        assert_eq!(answer.status, status, "{rest}: {answer:?}");
        let text = answer.json()["error"].as_str().unwrap().to_owned();
        assert!(!text.is_empty() && answer.json().get("help").is_some());
        text
    }
}

impl Drop for Viewed {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn ran() -> Bench {
    let bench = Bench::new();
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    bench
}

/// The rows of a query of `magline sql`, as JSON. Its reader may change the last bit of a number.
fn sql(bench: &Bench, query: &str) -> Vec<Value> {
    let output = bench.magline(&["sql", query, "--format", "json"]);
    let text = stdout(&output);
    assert!(output.status.success(), "{}", stderr(&output));
    match serde_json::from_str::<Vec<Value>>(&text) {
        Ok(rows) => rows,
        Err(_) => text.lines().map(|line| serde_json::from_str(line).unwrap()).collect(),
    }
}

fn column(rows: &[Value], name: &str) -> Vec<f64> {
    rows.iter().map(|row| row[name].as_f64().unwrap()).collect()
}

/// The columns of a query of `magline sql`, with the bits of the table.
fn sql_columns<const N: usize>(bench: &Bench, query: &str) -> [Vec<f64>; N] {
    let output = bench.magline(&["sql", query, "--format", "csv"]);
    let text = stdout(&output);
    assert!(output.status.success(), "{}", stderr(&output));
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
    std::array::from_fn(|at| rows.iter().map(|row| row[at]).collect())
}

const POINT: &str = "axis.mag=mag_4_uc&axis.vector=flux_a&axis.lambda=0.025";
const WHERE: &str = "mag = 'mag_4_uc' AND vector = 'flux_a' AND lambda = 0.025";

#[test]
fn user_a_series_equals_the_answer_of_sql() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    let rows = viewed
        .get(&format!("api/series?table=small.clean&flight=1&line=1.01&columns=mag_c,mag_1_c,lat&{POINT}"))
        .rows();
    let known: [Vec<f64>; 4] = sql_columns(
        &bench,
        &format!("SELECT tt, mag_c, mag_1_c, lat FROM small.clean WHERE {WHERE} AND line = '1.01' ORDER BY tt"),
    );
    assert_eq!(rows.num_rows(), 700);
    for (name, known) in ["tt", "mag_c", "mag_1_c", "lat"].into_iter().zip(known) {
        assert_eq!(numbers(std::slice::from_ref(&rows), name), known, "{name}");
    }
    let schema = rows.schema();
    assert_eq!((schema.metadata()["rows"].as_str(), schema.metadata()["thinned"].as_str()), ("700", "false"));
    let unit = |name: &str| schema.field_with_name(name).unwrap().metadata()["unit"].clone();
    assert_eq!((unit("mag_c").as_str(), unit("lat").as_str(), unit("tt").as_str()), ("nT", "deg", "s"));
    // Elements of a list, another spelling of a number, and a part of the line with its neighbours.
    let part = viewed.get(
        "api/series?table=small.terms&flight=2&line=2.02&columns=tl[0],flux_a_x&axis.vector=flux_a&from=36010.02\
         &to=36010.38",
    );
    let part = part.rows();
    let [_, first] = sql_columns(
        &bench,
        "SELECT tt, tl[1] AS first FROM small.terms WHERE line = '2.02' AND vector = 'flux_a' AND tt > 36009.95 AND tt \
         < 36010.45 ORDER BY tt",
    );
    assert_eq!(numbers(std::slice::from_ref(&part), "tt").len(), 5);
    assert_eq!(numbers(std::slice::from_ref(&part), "tl[0]"), first);
    let zero = viewed.get(
        "api/series?table=small.clean&flight=1&line=1.01&columns=mag_c&axis.mag=mag_4_uc&axis.vector=flux_a\
         &axis.lambda=0.0",
    );
    assert_eq!(zero.rows().num_rows(), 700);
}

#[test]
fn user_a_thinned_series_keeps_the_extremes_of_a_direct_computation() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    let thin =
        viewed.get(&format!("api/series?table=small.clean&flight=1&line=1.01&columns=mag_c&pixels=40&{POINT}")).rows();
    assert_eq!((thin.num_rows(), thin.schema().metadata()["thinned"].as_str()), (40, "true"));
    let query = format!("SELECT tt, mag_c FROM small.clean WHERE {WHERE} AND line = '1.01' ORDER BY tt");
    let [tt, mag_c] = sql_columns(&bench, &query);
    let all: Vec<(f64, f64)> = tt.into_iter().zip(mag_c).collect();
    let of = |name: &str| numbers(std::slice::from_ref(&thin), name);
    let mut counted = 0;
    for i in 0..40 {
        let inside = |p: &&(f64, f64)| (of("tt_first")[i]..=of("tt_last")[i]).contains(&p.0);
        let values: Vec<f64> = all.iter().filter(inside).map(|p| p.1).collect();
        assert_eq!(of("mag_c.min")[i], values.iter().copied().fold(f64::INFINITY, f64::min));
        assert_eq!(of("mag_c.max")[i], values.iter().copied().fold(f64::NEG_INFINITY, f64::max));
        counted += values.len();
    }
    assert_eq!(counted, 700);
}

#[test]
fn law_the_errors_of_a_track_agree_with_its_score() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    let names = "north_error,east_error,ins_north_error,ins_east_error,truth_lat,lat";
    let rows = viewed.get(&format!("api/series?table=small.track&flight=1&line=1.02&columns={names}&{POINT}")).rows();
    let of = |name: &str| numbers(std::slice::from_ref(&rows), name);
    let drms = |north: &str, east: &str| {
        let squares: f64 = of(north).iter().zip(of(east)).map(|(n, e)| n * n + e * e).sum();
        (squares / rows.num_rows() as f64).sqrt()
    };
    let query = |metric: &str| {
        format!("SELECT value FROM small.scores WHERE {WHERE} AND line = '1.02' AND metric = '{metric}'")
    };
    let score = |metric: &str| column(&sql(&bench, &query(metric)), "value")[0];
    let (own, ins) = (drms("north_error", "east_error"), drms("ins_north_error", "ins_east_error"));
    assert!((own / score("drms") - 1.0).abs() < 1e-3, "{own} {}", score("drms"));
    assert!((ins / score("ins_drms") - 1.0).abs() < 1e-3, "{ins} {}", score("ins_drms"));
    // A degree of latitude is about 111 km.
    let last = rows.num_rows() - 1;
    let metres = (of("truth_lat")[last] - of("lat")[last]) * 111_000.0;
    assert!((metres - of("north_error")[last]).abs() < 0.01 * of("north_error")[last].abs().max(1.0));
    let error = viewed
        .get(&format!("api/series?table=small.clean&flight=1&line=1.02&columns=error,mag_c,mag_1_c&{POINT}"))
        .rows();
    let of = |name: &str| numbers(std::slice::from_ref(&error), name);
    assert!((0..error.num_rows()).all(|i| of("error")[i] == of("mag_c")[i] - of("mag_1_c")[i]));
}

#[test]
fn user_the_catalogue_lists_tables_axes_columns_and_lines() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["spec.toml"]);
    let all = viewed.json("api/catalogue");
    assert_eq!((&all["mode"], &all["pipeline"], &all["spec"]), (&"spec".into(), &"small".into(), &"spec.toml".into()));
    let pipeline = &all["pipelines"][0];
    let axis = |name: &str| pipeline["axes"].as_array().unwrap().iter().find(|a| a["name"] == name).unwrap().clone();
    assert_eq!(axis("lambda")["values"], serde_json::json!(["0", "0.025"]));
    assert_eq!((&axis("lambda")["numeric"], &axis("mag")["numeric"]), (&true.into(), &false.into()));
    let table = |name: &str| pipeline["tables"].as_array().unwrap().iter().find(|t| t["name"] == name).unwrap().clone();
    let kinds = ["even", "terms", "coefficients", "clean", "track", "scores", "scores_pooled"]
        .map(|n| table(n)["kind"].clone());
    assert_eq!(kinds, ["samples", "samples", "model", "samples", "samples", "scores", "scores_pooled"]);
    assert_eq!(
        (&table("clean")["rows"], &table("clean")["points"], &table("clean")["lines"]),
        (&19_200.into(), &8.into(), &4.into())
    );
    let column =
        |table: &Value, name: &str| table["columns"].as_array().unwrap().iter().find(|c| c["name"] == name).cloned();
    let truth = column(&table("clean"), "mag_1_c").unwrap();
    assert_eq!((&truth["unit"], &truth["role"], &truth["series"]), (&"nT".into(), &"truth".into(), &true.into()));
    assert!(column(&table("track"), "north_error").is_some() && column(&table("even"), "north_error").is_none());
    assert!(
        column(&table("clean"), "error").is_some()
            && column(&table("terms"), "tl").unwrap()["length"].as_u64() == Some(18)
    );
    assert_eq!(pipeline["sources"][1]["kind"], "map");
    let lines = viewed.json("api/lines?table=small.track");
    assert_eq!(lines["lines"].as_array().unwrap().len(), 4);
    let first = &lines["lines"][0];
    assert_eq!((&first["line"], &first["rows"]), (&"1.01".into(), &700.into()));
    let output = bench.magline(&["lineage", "small.scores", "--format", "json"]);
    // The page needs the numbers of points and of lines only: a sweep may have 100,000 points.
    let mut known: Value = serde_json::from_str(&stdout(&output)).unwrap();
    let counted = |of: &mut Value, list: &str, key: &str| {
        for one in of[list].as_array_mut().unwrap() {
            let count = one[key].as_array().map(Vec::len).or(one[key].as_object().map(|map| map.len()));
            one[key] = count.unwrap().into();
            one.as_object_mut().unwrap().retain(|key, _| !["tidy", "cost", "restricted"].contains(&key.as_str()));
        }
    };
    counted(&mut known, "tables", "points");
    counted(&mut known, "sources", "lines");
    assert_eq!(viewed.json("api/lineage?table=small.scores"), known);
}

#[test]
fn bug_a_sweep_of_a_parameter_stores_its_columns_once() {
    let bench = Bench::new();
    bench.spec(
        "name = \"small\"\nstore = \"store\"\n[tables.flights]\npath = \"flights/\"\n[axes]\nshift = [0.5, 1.5, 2.5]\n\
         [[stages]]\nname = \"moved\"\nstage = \"derive\"\ninput = \"flights\"\n\
         columns = { mag_c = \"mag_1_c + $shift\" }\nunits = { mag_c = \"nT\" }\n",
    );
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let bytes = fs::read(bench.path("store/versions/small/1/units/moved.parquet")).unwrap();
    let name = b"\"mag_1_c\":";
    assert_eq!(bytes.windows(name.len()).filter(|part| part == name).count(), 1);
    let rows =
        sql(&bench, "SELECT shift, max(mag_c - mag_1_c) AS moved FROM small.moved GROUP BY shift ORDER BY shift");
    assert!(column(&rows, "moved").iter().zip([0.5, 1.5, 2.5]).all(|(found, shift)| (found - shift).abs() < 1e-9));
}

#[test]
fn user_the_scores_of_a_view_equal_those_of_the_report() {
    let bench = ran();
    let output = bench.magline(&["report", "spec.toml", "-o", "page.html"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let page = fs::read_to_string(bench.path("page.html")).unwrap();
    let block = page.split("<script type=\"application/json\">").nth(1).unwrap().split("</script>").next().unwrap();
    let known: Value = serde_json::from_str(block).unwrap();
    for source in ["store", "spec.toml"] {
        let viewed = Viewed::new(&bench, &[source]);
        let block = viewed.json("api/scores?table=small.scores");
        for (name, value) in known.as_object().unwrap() {
            assert_eq!(&block[name], value, "{source}: {name}");
        }
    }
    assert!(known["points"] == 8 && known["lines"]["points"].as_array().unwrap().len() == 32);
}

#[test]
fn user_the_progress_of_a_run_is_followed() {
    let bench = Bench::new();
    bench.spec(&SPEC.replace(
        "input = [\"clean\", \"track\"]",
        "input = [\"clean\", \"track\"]\nmetrics = [\"drms\", \"ins_drms\", \"std_error\"]",
    ));
    let missing = bench.magline(&["view", "spec.toml"]);
    assert_eq!((missing.status.code(), stderr(&missing).contains("magline run spec.toml")), (Some(2), true));
    assert!(!bench.path("store").exists(), "a view creates no store");
    let done = bench.run(&["--set", "axes.lambda=[0.025]"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let viewed = Viewed::new(&bench, &["spec.toml"]);
    let state = Viewed::run_state;
    let first = state(&viewed);
    let units = |state: &Value, key: &str| state["units"][key].as_u64().unwrap();
    assert_eq!((&first["state"], &first["current"]), (&"incomplete".into(), &false.into()));
    assert!(units(&first, "done") < units(&first, "total"));
    assert_eq!(bench.run(&[]).code, 0);
    let last = (0..60)
        .find_map(|_| {
            thread::sleep(Duration::from_millis(500));
            Some(state(&viewed)).filter(|state| state["state"] == "done")
        })
        .unwrap();
    assert_eq!((units(&last, "done"), &last["current"]), (units(&last, "total"), &true.into()));
    assert_ne!(first["changed"], last["changed"]);
    assert_eq!(last["runs"].as_array().unwrap().len(), 2);
    // The best point is that of the published scores.
    let pooled = sql(
        &bench,
        "SELECT value FROM small.scores_pooled WHERE metric = 'drms' AND NOT in_sample ORDER BY value LIMIT 1",
    );
    assert_eq!(last["best"][0]["metric"], "drms");
    assert!(
        (last["best"][0]["value"].as_f64().unwrap() - column(&pooled, "value")[0]).abs() < 1e-9
            || last["best"][0]["flagged"] == true
    );
    assert_eq!(last["best"][0]["baseline"]["metric"], "ins_drms");
    assert_eq!(state(&Viewed::new(&bench, &[]))["pipelines"][0]["pipeline"], "small");
}

#[test]
fn user_failures_of_a_run_are_counted_by_kind() {
    let bench = Bench::new();
    // A constant magnetometer on one line cannot be fitted.
    let lines = ["1.01", "1.02"].map(|line| changed(&line_of("1", line, 600), "mag_4_uc", |_, _| f64::NAN));
    write(&bench.path("flights/1.parquet"), &lines);
    assert_eq!(bench.run(&[]).code, 1);
    let viewed = Viewed::new(&bench, &["spec.toml"]);
    let state = viewed.run_state();
    assert!(state["units"]["failed"].as_u64().unwrap() > 0, "{state}");
    let failures = state["failures"].as_array().unwrap();
    let times: u64 = failures.iter().map(|f| f["times"].as_u64().unwrap()).sum();
    assert_eq!(times, state["units"]["failed"].as_u64().unwrap());
    assert!(failures.iter().all(|f| !f["error"].as_str().unwrap().is_empty()), "{state}");
}

#[test]
fn user_a_map_is_sent_as_a_raster() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    let map = viewed.json("api/map?table=small.anomaly");
    let bytes = BASE64_STANDARD.decode(map["values"].as_str().unwrap()).unwrap();
    let values: Vec<f32> = bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(
        (&map["width"], &map["height"], &map["unit"], values.len()),
        (&81.into(), &81.into(), &"nT".into(), 81 * 81)
    );
    // The first value is in the north-west.
    assert!(
        (f64::from(values[0]) - anomaly(45.1, 9.9)).abs() < 1e-3
            && (f64::from(values[80]) - anomaly(45.1, 10.1)).abs() < 1e-3
    );
    assert!((map["west"].as_f64().unwrap() - (9.9 - 0.00125)).abs() < 1e-9);
    assert_eq!(viewed.json("api/map?table=small.anomaly&pixels=10")["thinned"], true);
    viewed.refused("api/map?table=small.clean", 400);
    viewed.refused("api/map?table=small.anomaly&pixels=0", 400);
    // A map of this format has no errors.
    assert_eq!((&map["band"], &map["has_error"]), (&"anomaly".into(), &false.into()));
    viewed.refused("api/map?table=small.anomaly&band=error", 400);
    viewed.refused("api/map?table=small.anomaly&band=%3Cb%3E", 400);
}

#[test]
fn user_tables_are_downloaded_as_export_writes_them() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    for (table, format) in [("coefficients", "csv"), ("coefficients", "parquet"), ("clean", "csv")] {
        let (table, file) = (format!("small.{table}"), format!("{table}.{format}"));
        let output = bench.magline(&["export", &table, "-o", &file]);
        assert!(output.status.success(), "{}", stderr(&output));
        let answer = viewed.get(&format!("download?table={table}&format={format}"));
        assert_eq!((answer.status, &answer.body), (200, &fs::read(bench.path(&file)).unwrap()));
        assert!(answer.head.contains(&format!("filename=\"{table}.{format}\"")), "{}", answer.head);
    }
    // Scores have a list of varying length, which a CSV file omits.
    let scores = String::from_utf8(viewed.get("download?table=small.scores&format=csv").body).unwrap();
    let count = sql(&bench, "SELECT count(*) AS n FROM small.scores")[0]["n"].as_u64().unwrap();
    assert_eq!(scores.lines().count() as u64, count + 1);
    assert!(!scores.lines().next().unwrap().contains("spread") && scores.contains("drms"));
    fs::write(bench.path("scores.parquet"), viewed.get("download?table=small.scores&format=parquet").body).unwrap();
    fs::create_dir(bench.path("one")).unwrap();
    fs::rename(bench.path("scores.parquet"), bench.path("one/scores.parquet")).unwrap();
    let rows = read(&bench.path("one"));
    assert_eq!(rows.iter().map(RecordBatch::num_rows).sum::<usize>() as u64, count);
    assert!(rows[0].column_by_name("spread").is_some());
    viewed.refused("download?table=small.none&format=csv", 404);
    viewed.refused("download?table=small.scores&format=xlsx", 400);
}
