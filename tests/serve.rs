//! `magline serve` with clients of Arrow Flight SQL.

use std::{
    fs,
    io::{BufRead, BufReader},
    net::SocketAddr,
    os::unix::fs::PermissionsExt,
    process::{Command, Stdio},
    sync::{Arc, mpsc},
    thread,
    time::{Duration, Instant},
};

use arrow_array::{Array, Float64Array, Int64Array, RecordBatch, StringArray, cast::AsArray, types::Int64Type};
use arrow_flight::{
    FlightInfo,
    sql::{
        CommandGetDbSchemas, CommandGetExportedKeys, CommandGetPrimaryKeys, CommandGetTables, SqlInfo,
        client::FlightSqlServiceClient,
    },
};
use arrow_schema::{DataType, Field, Schema};
use futures::TryStreamExt;
use pipeline::serve::{ServerSettings, Token, serve};
use tokio::{runtime::Runtime, sync::watch};
use tonic::transport::{Certificate, Channel, ClientTlsConfig};

use crate::support::{Bench, numbers, read, repository, stderr};

mod strangers;

type Client = FlightSqlServiceClient<Channel>;

const TOKEN: &str = "0123456789abcdef0123";

/// Server in this process.
struct Served {
    address: SocketAddr,
    stop: watch::Sender<bool>,
    thread: Option<thread::JoinHandle<()>>,
    runtime: Runtime,
}

fn settings(bench: &Bench) -> ServerSettings {
    fs::create_dir_all(bench.path("spill")).unwrap();
    ServerSettings {
        program: env!("CARGO_BIN_EXE_magline").into(),
        store: bench.path("store"),
        bind: "127.0.0.1:0".parse().unwrap(),
        token: None,
        tls: None,
        memory: 256 << 20,
        spill: bench.path("spill"),
        queries: 4,
        timeout: Duration::from_secs(120),
    }
}

/// Error of a server that does not start.
fn refused(settings: ServerSettings) -> String {
    let (_keep, stopped) = watch::channel(false);
    serve(settings, |address| panic!("it serves at {address}"), stopped).unwrap_err().to_string()
}

impl Served {
    fn new(bench: &Bench, change: impl FnOnce(&mut ServerSettings)) -> Served {
        let mut settings = settings(bench);
        change(&mut settings);
        let (stop, stopped) = watch::channel(false);
        let (sender, address_receiver) = mpsc::channel();
        let thread = thread::spawn(move || serve(settings, |address| sender.send(address).unwrap(), stopped).unwrap());
        let address = address_receiver.recv().unwrap();
        Served { address, stop, thread: Some(thread), runtime: Runtime::new().unwrap() }
    }

    fn client(&self) -> Client {
        let at = Channel::from_shared(format!("http://{}", self.address)).unwrap();
        FlightSqlServiceClient::new(self.runtime.block_on(at.connect()).unwrap())
    }

    fn rows(&self, client: &mut Client, info: FlightInfo) -> Result<Vec<RecordBatch>, String> {
        self.runtime.block_on(async {
            let mut all = vec![];
            for endpoint in info.endpoint {
                let rows = client.do_get(endpoint.ticket.unwrap()).await.map_err(|e| e.to_string())?;
                all.extend(rows.try_collect::<Vec<RecordBatch>>().await.map_err(|e| e.to_string())?);
            }
            Ok(all)
        })
    }

    fn plan(&self, client: &mut Client, query: &str) -> Result<FlightInfo, String> {
        self.runtime.block_on(client.execute(query.to_owned(), None)).map_err(|e| e.to_string())
    }

    fn ask(&self, client: &mut Client, query: &str) -> Result<Vec<RecordBatch>, String> {
        let info = self.plan(client, query)?;
        self.rows(client, info)
    }

    fn count(&self, client: &mut Client, query: &str) -> i64 {
        self.ask(client, query).unwrap()[0].column(0).as_primitive::<Int64Type>().value(0)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.send_replace(true);
        let ended = self.thread.take().unwrap().join();
        if !thread::panicking() {
            ended.unwrap();
        }
    }
}

fn ran() -> Bench {
    let bench = Bench::new();
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    bench
}

fn words(batches: &[RecordBatch], column: usize) -> Vec<String> {
    let one =
        |b: &RecordBatch| b.column(column).as_string::<i32>().iter().map(|x| x.unwrap().to_owned()).collect::<Vec<_>>();
    batches.iter().flat_map(one).collect()
}

#[test]
fn user_answers_equal_the_published_files() {
    let bench = ran();
    let served = Served::new(&bench, |_| {});
    let client = &mut served.client();
    let files = read(&bench.path("store/tables/small/clean"));
    let rows = served.ask(client, "SELECT flight, line, tt, mag_c FROM small.clean").unwrap();
    assert!(rows.len() > 1, "pieces of an answer");
    assert_eq!(rows.iter().map(RecordBatch::num_rows).sum::<usize>(), 19_200);
    let sum = |batches: &[RecordBatch]| numbers(batches, "mag_c").iter().sum::<f64>();
    assert!((sum(&rows) / sum(&files) - 1.0).abs() < 1e-12);
    // A passthrough column is included, with unit and role.
    let lon = served.ask(client, "SELECT lon FROM small.clean WHERE line = '1.01' AND tt < 36010").unwrap();
    assert_eq!(lon.iter().map(RecordBatch::num_rows).sum::<usize>(), 8 * 100);
    assert_eq!(lon[0].schema().field(0).metadata()["unit"], "deg");
    let none = served.ask(client, "SELECT * FROM small.clean WHERE line = 'none'").unwrap();
    assert_eq!(none.iter().map(RecordBatch::num_rows).sum::<usize>(), 0);
    let wrong = served.ask(client, "SELECT * FROM small.cleen").unwrap_err();
    assert!(wrong.contains("did you mean `small.clean`"), "{wrong}");
}

#[test]
fn user_every_query_that_writes_is_rejected() {
    let bench = ran();
    let before = bench.tables("store");
    let served = Served::new(&bench, |_| {});
    let client = &mut served.client();
    let out = bench.path("out.parquet").display().to_string();
    for query in [
        "DROP TABLE small.clean".to_owned(),
        "CREATE TABLE small.new AS SELECT * FROM small.clean".to_owned(),
        "INSERT INTO small.clean SELECT * FROM small.clean".to_owned(),
        "DELETE FROM small.clean".to_owned(),
        format!("COPY small.clean TO '{out}'"),
        format!("CREATE EXTERNAL TABLE x STORED AS PARQUET LOCATION '{out}'"),
        "SET datafusion.execution.batch_size = 1".to_owned(),
    ] {
        let wrong = served.ask(client, &query).unwrap_err();
        assert!(wrong.contains("rejected"), "{query}: {wrong}");
        let updated = served.runtime.block_on(client.execute_update(query.clone(), None));
        assert!(updated.unwrap_err().to_string().contains("read-only"), "{query}");
    }
    let file = served.ask(client, "SELECT * FROM '/etc/passwd'").unwrap_err();
    assert!(file.contains("there is no table"), "{file}");
    assert!(!bench.path("out.parquet").exists());
    assert_eq!(bench.tables("store"), before);
}

#[test]
fn user_prepared_statements_take_parameters() {
    let bench = ran();
    let served = Served::new(&bench, |_| {});
    let client = &mut served.client();
    let query = "SELECT count(*) FROM small.clean WHERE line = $1 AND lambda > $2";
    let mut statement = served.runtime.block_on(client.prepare(query.to_owned(), None)).unwrap();
    let asked = statement.parameter_schema().unwrap();
    assert_eq!(asked.fields().iter().map(|f| f.name().as_str()).collect::<Vec<_>>(), ["$1", "$2"]);
    let values = |lines: Vec<&str>, lambda: f64| {
        let fields = vec![Field::new("$1", DataType::Utf8, false), Field::new("$2", DataType::Float64, false)];
        let lambdas = Arc::new(Float64Array::from(vec![lambda; lines.len()]));
        RecordBatch::try_new(Arc::new(Schema::new(fields)), vec![Arc::new(StringArray::from(lines)), lambdas]).unwrap()
    };
    for (line, lambda, rows) in [("1.01", 0.01, 4 * 700), ("2.02", -1.0, 8 * 500), ("none", 0.0, 0)] {
        statement.set_parameters(values(vec![line], lambda)).unwrap();
        let info = served.runtime.block_on(statement.execute()).unwrap();
        let found = served.rows(client, info).unwrap();
        assert_eq!(found[0].column(0).as_any().downcast_ref::<Int64Array>().unwrap().value(0), rows, "{line}");
    }
    // Any text is treated as a value.
    statement.set_parameters(values(vec!["' OR '1' = '1"], -1.0)).unwrap();
    let info = served.runtime.block_on(statement.execute()).unwrap();
    assert_eq!(served.rows(client, info).unwrap()[0].column(0).as_primitive::<Int64Type>().value(0), 0);
    // Too few values, no values, and whole numbers for other types.
    let one = |name: &str, column: Arc<dyn Array>| RecordBatch::try_from_iter([(name, column)]).unwrap();
    statement.set_parameters(one("$1", Arc::new(StringArray::from(vec!["1.01"])))).unwrap();
    let wrong = served.runtime.block_on(statement.execute()).unwrap_err().to_string();
    assert!(wrong.contains("has 2 parameters, but 1 values were bound"), "{wrong}");
    let wrong = served.ask(client, query).unwrap_err();
    assert!(wrong.contains("without a value: `$1`, `$2`"), "{wrong}");
    for named in ["lambda > $least AND line = '1.01'", "lambda > ? AND line = '1.01'"] {
        let query = format!("SELECT count(*) FROM small.clean WHERE {named}");
        let mut statement = served.runtime.block_on(client.prepare(query, None)).unwrap();
        statement.set_parameters(one("least", Arc::new(Int64Array::from(vec![0])))).unwrap();
        let info = served.runtime.block_on(statement.execute()).unwrap();
        let found = served.rows(client, info).unwrap();
        assert_eq!(found[0].column(0).as_primitive::<Int64Type>().value(0), 4 * 700, "{named}");
    }
    statement.set_parameters(values(vec!["1.01", "1.02"], 0.0)).unwrap();
    let wrong = served.runtime.block_on(statement.execute()).unwrap_err().to_string();
    assert!(wrong.contains("2 rows of parameters"), "{wrong}");
    served.runtime.block_on(statement.close()).unwrap();
    let refused = served.runtime.block_on(client.prepare("DROP TABLE small.clean".to_owned(), None));
    assert!(refused.is_err_and(|e| e.to_string().contains("rejected")));
}

#[test]
fn user_a_client_can_list_schemas_tables_and_keys() {
    let bench = ran();
    let served = Served::new(&bench, |_| {});
    let client = &mut served.client();
    let run = &served.runtime;
    let info = run.block_on(client.get_catalogs()).unwrap();
    assert_eq!(words(&served.rows(client, info).unwrap(), 0), ["datafusion"]);
    let all = CommandGetDbSchemas { catalog: None, db_schema_filter_pattern: None };
    let info = run.block_on(client.get_db_schemas(all)).unwrap();
    assert_eq!(words(&served.rows(client, info).unwrap(), 1), ["small"]);
    let tables = CommandGetTables {
        catalog: None,
        db_schema_filter_pattern: Some("sm%".to_owned()),
        table_name_filter_pattern: Some("c%".to_owned()),
        table_types: vec![],
        include_schema: true,
    };
    let info = run.block_on(client.get_tables(tables)).unwrap();
    let tables = served.rows(client, info).unwrap();
    assert_eq!(words(&tables, 2), ["clean", "coefficients"]);
    assert!(tables[0].column_by_name("table_schema").unwrap().as_binary::<i32>().value(0).len() > 100);
    let info = run.block_on(client.get_table_types()).unwrap();
    assert_eq!(words(&served.rows(client, info).unwrap(), 0), ["TABLE"]);
    let keys = |table: &str| CommandGetPrimaryKeys { catalog: None, db_schema: None, table: table.to_owned() };
    let info = run.block_on(client.get_primary_keys(keys("clean"))).unwrap();
    let mut names = words(&served.rows(client, info).unwrap(), 3);
    names.sort();
    assert_eq!(names, ["flight", "lambda", "line", "mag", "tt", "vector"]);
    let distinct = "(SELECT DISTINCT mag, vector, lambda, flight, line, tt FROM small.clean)";
    assert_eq!(served.count(client, &format!("SELECT count(*) FROM {distinct}")), 19_200);
    let info = run.block_on(client.get_primary_keys(keys("scores"))).unwrap();
    assert!(words(&served.rows(client, info).unwrap(), 3).is_empty());
    let none = CommandGetExportedKeys { catalog: None, db_schema: None, table: "clean".to_owned() };
    let info = run.block_on(client.get_exported_keys(none)).unwrap();
    assert_eq!(served.rows(client, info).unwrap().iter().map(RecordBatch::num_rows).sum::<usize>(), 0);
    let asked = vec![SqlInfo::FlightSqlServerName, SqlInfo::FlightSqlServerReadOnly];
    let info = run.block_on(client.get_sql_info(asked)).unwrap();
    assert_eq!(served.rows(client, info).unwrap()[0].num_rows(), 2);
}

#[test]
fn user_a_query_reads_one_snapshot() {
    let bench = ran();
    let served = Served::new(&bench, |_| {});
    let client = &mut served.client();
    let query = "SELECT count(*), count(lon) FROM small.clean";
    let before = served.plan(client, query).unwrap();
    assert_eq!(served.count(client, query), 19_200);
    let done = bench.run(&["--set", "axes.lambda=[0.0, 0.025, 0.25]"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!(served.count(client, query), 28_800, "what was published is seen");
    // An earlier plan is answered from its snapshot, any number of times.
    for _ in 0..2 {
        let rows = served.rows(client, before.clone()).unwrap();
        assert_eq!(rows[0].column(0).as_primitive::<Int64Type>().value(0), 19_200);
        assert_eq!(rows[0].column(1).as_primitive::<Int64Type>().value(0), 19_200);
    }
}

#[test]
fn user_an_answer_of_mixed_types_has_the_planned_columns() {
    let bench = ran();
    let served = Served::new(&bench, |_| {});
    let client = &mut served.client();
    for (query, kind, sum) in [
        ("SELECT 1 AS x UNION ALL SELECT 1.5", DataType::Float64, 2.5),
        ("SELECT CASE WHEN tt > 36000 THEN 1 ELSE 0.5 END AS x FROM small.clean LIMIT 2", DataType::Float64, 1.5),
        ("SELECT arrow_cast(2.5, 'Dictionary(Int32, Float64)') AS x", DataType::Float64, 2.5),
    ] {
        let info = served.plan(client, query).unwrap();
        assert_eq!(info.clone().try_decode_schema().unwrap().field(0).data_type(), &kind, "{query}");
        let rows = served.rows(client, info).unwrap();
        assert_eq!(numbers(&rows, "x").iter().sum::<f64>(), sum, "{query}");
    }
}

#[test]
fn user_exceeded_limits_and_damage_are_reported_to_the_client() {
    let bench = ran();
    let served = Served::new(&bench, |s| s.memory = 16 << 20);
    let client = &mut served.client();
    let large = "SELECT array_length(array_agg(a.mag_c + b.mag_c)) FROM small.clean a, small.clean b";
    let wrong = served.ask(client, large).unwrap_err();
    assert!(wrong.contains("exceeds its memory limit of 16.8 MB"), "{wrong}");
    let long = format!("SELECT '{}'", "x".repeat(2 << 20));
    let wrong = served.ask(client, &long).unwrap_err();
    assert!(wrong.contains("bytes long"), "{wrong}");
    let longer = format!("SELECT '{}'", "x".repeat(5 << 20));
    assert!(served.ask(client, &longer).is_err());
    let wrong = served.ask(client, "SELECT * FROM nowhere.nothing").unwrap_err();
    assert!(wrong.contains("there is no table `nowhere.nothing`"), "{wrong}");
    // Flipped bits in a published file.
    let folder = bench.path("store/tables/small/scores");
    let file = fs::read_dir(folder).unwrap().flatten().next().unwrap().path();
    let mut bytes = fs::read(&file).unwrap();
    bytes.iter_mut().skip(4).step_by(64).for_each(|b| *b ^= 1);
    fs::write(&file, bytes).unwrap();
    let wrong = served.ask(client, "SELECT sum(value) FROM small.scores").unwrap_err();
    assert!(wrong.contains("cannot read") && wrong.contains("scores"), "{wrong}");
    assert_eq!(served.count(client, "SELECT count(*) FROM small.clean"), 19_200);
}

#[test]
fn user_a_server_that_cannot_start_reports_the_reason() {
    let bench = ran();
    let pem = |name: &str| fs::read(repository().join("tests/reference/serve").join(name)).unwrap();
    let served = Served::new(&bench, |_| {});
    let taken = refused(ServerSettings { bind: served.address, ..settings(&bench) });
    assert!(taken.contains(&format!("cannot listen on {}", served.address)), "{taken}");
    let open = refused(ServerSettings { bind: "0.0.0.0:0".parse().unwrap(), ..settings(&bench) });
    assert!(open.contains("the server has no token"), "{open}");
    let (certificate, key) = (pem("localhost.pem"), pem("localhost.key"));
    let half = |pem: &[u8]| pem[..pem.len() / 2].to_vec();
    for (what, certificate, key) in [
        ("a cut certificate", half(&certificate), key.clone()),
        ("a cut key", certificate.clone(), half(&key)),
        ("no certificate", vec![], key.clone()),
        ("the certificate of another key", pem("ca.pem"), key.clone()),
        ("keys in place of certificates", key.clone(), key.clone()),
    ] {
        let wrong = refused(ServerSettings { tls: Some((certificate, key)), ..settings(&bench) });
        assert!(wrong.contains("the certificate or its key is invalid"), "{what}: {wrong}");
    }
}

#[test]
fn user_serve_prints_its_address_and_ends_on_a_signal() {
    let bench = ran();
    fs::write(bench.path("token"), TOKEN).unwrap();
    fs::set_permissions(bench.path("token"), fs::Permissions::from_mode(0o600)).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_magline"));
    command.args(["serve", "--bind", "127.0.0.1:0", "--token-file", "token"]).current_dir(bench.folder.path());
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    errors.read_line(&mut line).unwrap();
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    let status = child.wait().unwrap();
    assert!(line.starts_with("serving store at grpc://127.0.0.1:") && line.contains("with a token"), "{line}");
    assert_eq!(status.code(), Some(0));

    let rejected = |args: &[&str]| {
        let output = bench.magline(&[&["serve"], args].concat());
        (output.status.code(), stderr(&output))
    };
    let (code, text) = rejected(&["--bind", "0.0.0.0:0"]);
    assert!(code == Some(2) && text.contains("the server has no token"), "{text}");
    fs::write(bench.path("short"), "secret").unwrap();
    let (code, text) = rejected(&["--token-file", "short"]);
    assert!(code == Some(2) && text.contains("at least 16"), "{text}");
    let (code, text) = rejected(&["--store", "flights"]);
    assert!(code == Some(2) && text.contains("is not a store"), "{text}");
    let (code, text) = rejected(&["--tls-cert", "token"]);
    assert!(code == Some(2) && text.contains("--tls-key"), "{text}");
    let (code, text) = rejected(&["--tls-cert", "token", "--tls-key", "token", "--bind", "127.0.0.1:0"]);
    assert!(code == Some(2) && text.contains("certificate"), "{text}");
}
