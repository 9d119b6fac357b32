//! `magline serve`, as clients of Arrow Flight SQL see it.

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
use pipeline::serve::{Settings, Token, serve};
use tokio::{runtime::Runtime, sync::watch};
use tonic::transport::{Certificate, Channel, ClientTlsConfig};

use crate::support::{Bench, numbers, read, repository, stderr};

type Client = FlightSqlServiceClient<Channel>;

const TOKEN: &str = "0123456789abcdef0123";

/// A server in this process.
struct Served {
    address: SocketAddr,
    stop: watch::Sender<bool>,
    thread: Option<thread::JoinHandle<()>>,
    runtime: Runtime,
}

fn settings(bench: &Bench) -> Settings {
    fs::create_dir_all(bench.path("spill")).unwrap();
    Settings {
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

/// Why a server does not start.
fn refused(settings: Settings) -> String {
    let (_keep, stopped) = watch::channel(false);
    serve(settings, |address| panic!("it serves at {address}"), stopped).unwrap_err().to_string()
}

impl Served {
    fn new(bench: &Bench, change: impl FnOnce(&mut Settings)) -> Served {
        let mut settings = settings(bench);
        change(&mut settings);
        let (stop, stopped) = watch::channel(false);
        let (tell, told) = mpsc::channel();
        let thread = thread::spawn(move || serve(settings, |address| tell.send(address).unwrap(), stopped).unwrap());
        let address = told.recv().unwrap();
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
fn user_answers_are_what_the_files_hold() {
    let bench = ran();
    let served = Served::new(&bench, |_| {});
    let client = &mut served.client();
    let files = read(&bench.path("store/tables/small/clean"));
    let rows = served.ask(client, "SELECT flight, line, tt, mag_c FROM small.clean").unwrap();
    assert!(rows.len() > 1, "pieces of an answer");
    assert_eq!(rows.iter().map(RecordBatch::num_rows).sum::<usize>(), 19_200);
    let sum = |batches: &[RecordBatch]| numbers(batches, "mag_c").iter().sum::<f64>();
    assert!((sum(&rows) / sum(&files) - 1.0).abs() < 1e-12);
    // A column that passes through is there too, with unit and role.
    let lon = served.ask(client, "SELECT lon FROM small.clean WHERE line = '1.01' AND tt < 36010").unwrap();
    assert_eq!(lon.iter().map(RecordBatch::num_rows).sum::<usize>(), 8 * 100);
    assert_eq!(lon[0].schema().field(0).metadata()["unit"], "deg");
    let none = served.ask(client, "SELECT * FROM small.clean WHERE line = 'none'").unwrap();
    assert_eq!(none.iter().map(RecordBatch::num_rows).sum::<usize>(), 0);
    let wrong = served.ask(client, "SELECT * FROM small.cleen").unwrap_err();
    assert!(wrong.contains("did you mean `small.clean`"), "{wrong}");
}

#[test]
fn user_whatever_writes_is_refused() {
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
        assert!(wrong.contains("refused"), "{query}: {wrong}");
        let updated = served.runtime.block_on(client.execute_update(query.clone(), None));
        assert!(updated.unwrap_err().to_string().contains("read-only"), "{query}");
    }
    let file = served.ask(client, "SELECT * FROM '/etc/passwd'").unwrap_err();
    assert!(file.contains("there is no table"), "{file}");
    assert!(!bench.path("out.parquet").exists());
    assert_eq!(bench.tables("store"), before);
}

#[test]
fn user_only_who_knows_the_token_is_answered() {
    let bench = ran();
    let served = Served::new(&bench, |s| s.token = Some(Token::read(TOKEN).unwrap()));
    let one = "SELECT count(*) FROM small.scores";
    let is_refused = |client: &mut Client| {
        let wrong = served.ask(client, one).unwrap_err();
        assert!(wrong.contains("the token is missing or wrong"), "{wrong}");
    };
    is_refused(&mut served.client());
    let mut client = served.client();
    client.set_token(TOKEN.replace('3', "4"));
    is_refused(&mut client);
    client.set_token(TOKEN.to_owned());
    assert!(served.count(&mut client, one) > 0);
    // As the password of any user, which a handshake turns into the token.
    let mut client = served.client();
    assert!(served.runtime.block_on(client.handshake("anyone", "wrong password")).is_err());
    is_refused(&mut client);
    served.runtime.block_on(client.handshake("anyone", TOKEN)).unwrap();
    assert_eq!(client.token().unwrap(), TOKEN);
    assert!(served.count(&mut client, one) > 0);
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
    // A text is a value, whatever it looks like.
    statement.set_parameters(values(vec!["' OR '1' = '1"], -1.0)).unwrap();
    let info = served.runtime.block_on(statement.execute()).unwrap();
    assert_eq!(served.rows(client, info).unwrap()[0].column(0).as_primitive::<Int64Type>().value(0), 0);
    // Too few values, a query without any, and whole numbers for others.
    let one = |name: &str, column: Arc<dyn Array>| RecordBatch::try_from_iter([(name, column)]).unwrap();
    statement.set_parameters(one("$1", Arc::new(StringArray::from(vec!["1.01"])))).unwrap();
    let wrong = served.runtime.block_on(statement.execute()).unwrap_err().to_string();
    assert!(wrong.contains("takes 2 parameters, and there are 1 values"), "{wrong}");
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
    assert!(refused.is_err_and(|e| e.to_string().contains("refused")));
}

#[test]
fn user_a_client_can_ask_what_there_is() {
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
fn user_a_query_sees_the_tables_of_one_moment() {
    let bench = ran();
    let served = Served::new(&bench, |_| {});
    let client = &mut served.client();
    let query = "SELECT count(*), count(lon) FROM small.clean";
    let before = served.plan(client, query).unwrap();
    assert_eq!(served.count(client, query), 19_200);
    let done = bench.run(&["--set", "axes.lambda=[0.0, 0.025, 0.25]"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!(served.count(client, query), 28_800, "what was published is seen");
    // What was planned before is answered from what there was then, as often as it is asked for.
    for _ in 0..2 {
        let rows = served.rows(client, before.clone()).unwrap();
        assert_eq!(rows[0].column(0).as_primitive::<Int64Type>().value(0), 19_200);
        assert_eq!(rows[0].column(1).as_primitive::<Int64Type>().value(0), 19_200);
    }
}

#[test]
fn user_a_query_that_takes_too_long_is_ended_and_makes_room() {
    let bench = ran();
    let served = Served::new(&bench, |s| (s.queries, s.timeout) = (1, Duration::from_secs(2)));
    let client = &mut served.client();
    // On a machine at work a small question may be late too; it is asked again.
    let counted = |client: &mut Client| {
        let answer = (0..30).find_map(|_| served.ask(client, "SELECT count(*) FROM small.clean").ok());
        answer.unwrap()[0].column(0).as_primitive::<Int64Type>().value(0)
    };
    // Ten thousand million rows.
    let slow = "SELECT sum(sqrt(a.value * b.value)) FROM generate_series(1, 100000) a, generate_series(1, 100000) b";
    let wrong = served.ask(client, slow).unwrap_err();
    assert!(wrong.contains("longer than 2 s"), "{wrong}");
    assert_eq!(counted(client), 19_200);
    // One whose rows nobody takes gives its place back as well, and its rows do not just end.
    let info = served.plan(client, "SELECT a.mag_c FROM small.clean a, small.clean b").unwrap();
    let ticket = info.endpoint[0].ticket.clone().unwrap();
    let mut rows = served.runtime.block_on(client.do_get(ticket)).unwrap();
    thread::sleep(Duration::from_secs(3));
    assert_eq!(counted(client), 19_200);
    let end = served.runtime.block_on(async {
        while rows.try_next().await?.is_some() {}
        Ok::<_, arrow_flight::error::FlightError>(())
    });
    assert!(end.unwrap_err().to_string().contains("longer than 2 s"));
}

#[test]
fn user_an_answer_of_mixed_types_has_the_columns_that_were_told() {
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
fn user_what_one_server_handed_out_is_nothing_to_the_next() {
    let bench = ran();
    let first = Served::new(&bench, |_| {});
    let info = first.plan(&mut first.client(), "SELECT 1").unwrap();
    drop(first);
    let second = Served::new(&bench, |_| {});
    let client = &mut second.client();
    second.plan(client, "SELECT 2").unwrap();
    let wrong = second.rows(client, info).unwrap_err();
    assert!(wrong.contains("not known any more"), "{wrong}");
}

#[test]
fn user_fifty_clients_at_once_are_all_answered() {
    let bench = ran();
    let served = Served::new(&bench, |s| s.token = Some(Token::read(TOKEN).unwrap()));
    let address = served.address;
    let ask = |i: usize| async move {
        let channel = Channel::from_shared(format!("http://{address}"))?.connect().await?;
        let mut client = FlightSqlServiceClient::new(channel);
        client.set_token(TOKEN.to_owned());
        let line = ["1.01", "1.02", "2.01", "2.02"][i % 4];
        let query = format!("SELECT count(*) FROM small.clean WHERE line = '{line}'");
        let info = client.execute(query, None).await?;
        let ticket = info.endpoint.into_iter().next().and_then(|e| e.ticket).ok_or("no ticket")?;
        let rows: Vec<RecordBatch> = client.do_get(ticket).await?.try_collect().await?;
        Ok::<i64, Box<dyn std::error::Error>>(rows[0].column(0).as_primitive::<Int64Type>().value(0))
    };
    let all = served.runtime.block_on(futures::future::join_all((0..50).map(ask)));
    for (i, rows) in all.into_iter().enumerate() {
        assert_eq!(rows.unwrap(), [5600, 4000][i % 2], "client {i}");
    }
}

#[test]
fn user_a_client_that_goes_away_makes_room_for_others() {
    let bench = ran();
    let served = Served::new(&bench, |s| (s.queries, s.timeout) = (1, Duration::from_secs(600)));
    let client = &mut served.client();
    let begun = Instant::now();
    // 368 million rows, of which three messages are taken: they are neither computed at once nor kept.
    let info = served.plan(client, "SELECT a.mag_c, b.tt FROM small.clean a, small.clean b").unwrap();
    let ticket = info.endpoint[0].ticket.clone().unwrap();
    let mut rows = served.runtime.block_on(client.do_get(ticket)).unwrap();
    for _ in 0..3 {
        assert!(served.runtime.block_on(rows.try_next()).unwrap().unwrap().num_rows() > 0);
    }
    drop(rows);
    // Long before the limit of time gives the place back.
    assert_eq!(served.count(client, "SELECT count(*) FROM small.clean"), 19_200);
    assert!(begun.elapsed() < Duration::from_secs(500));
}

#[test]
fn user_a_query_that_needs_too_much_says_so_and_damage_is_named() {
    let bench = ran();
    let served = Served::new(&bench, |s| s.memory = 16 << 20);
    let client = &mut served.client();
    let large = "SELECT array_length(array_agg(a.mag_c + b.mag_c)) FROM small.clean a, small.clean b";
    let wrong = served.ask(client, large).unwrap_err();
    assert!(wrong.contains("needs more memory than the 16.8 MB"), "{wrong}");
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
fn user_a_server_that_cannot_serve_says_why() {
    let bench = ran();
    let pem = |name: &str| fs::read(repository().join("tests/reference/serve").join(name)).unwrap();
    let served = Served::new(&bench, |_| {});
    let taken = refused(Settings { bind: served.address, ..settings(&bench) });
    assert!(taken.contains(&format!("cannot listen at {}", served.address)), "{taken}");
    let open = refused(Settings { bind: "0.0.0.0:0".parse().unwrap(), ..settings(&bench) });
    assert!(open.contains("there is no token"), "{open}");
    let (certificate, key) = (pem("localhost.pem"), pem("localhost.key"));
    let half = |pem: &[u8]| pem[..pem.len() / 2].to_vec();
    for (what, certificate, key) in [
        ("a cut certificate", half(&certificate), key.clone()),
        ("a cut key", certificate.clone(), half(&key)),
        ("no certificate", vec![], key.clone()),
        ("the certificate of another key", pem("ca.pem"), key.clone()),
        ("keys in place of certificates", key.clone(), key.clone()),
    ] {
        let wrong = refused(Settings { tls: Some((certificate, key)), ..settings(&bench) });
        assert!(wrong.contains("the certificate or its key cannot be used"), "{what}: {wrong}");
    }
}

#[test]
fn user_connections_can_be_encrypted() {
    let bench = ran();
    let pem = |name: &str| fs::read(repository().join("tests/reference/serve").join(name)).unwrap();
    let served = Served::new(&bench, |s| s.tls = Some((pem("localhost.pem"), pem("localhost.key"))));
    let at = || Channel::from_shared(format!("https://localhost:{}", served.address.port())).unwrap();
    let trust = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem("ca.pem"))).domain_name("localhost");
    let channel = served.runtime.block_on(at().tls_config(trust).unwrap().connect()).unwrap();
    let mut client = FlightSqlServiceClient::new(channel);
    assert_eq!(served.count(&mut client, "SELECT count(*) FROM small.clean"), 19_200);
    let plain = Channel::from_shared(format!("http://{}", served.address)).unwrap();
    let plain = served.runtime.block_on(async {
        FlightSqlServiceClient::new(plain.connect().await?)
            .execute("SELECT 1".to_owned(), None)
            .await
            .map_err(|e| e.to_string())
            .map_err(std::io::Error::other)?;
        Ok::<_, Box<dyn std::error::Error>>(())
    });
    assert!(plain.is_err(), "unencrypted connections are not served");
}

#[test]
fn user_planning_has_its_time_too() {
    let bench = ran();
    let served = Served::new(&bench, |s| (s.queries, s.timeout) = (1, Duration::from_secs(2)));
    let client = &mut served.client();
    let begun = Instant::now();
    // Constants are folded while it is planned: 9e10 steps that nothing interrupts.
    let slow = "SELECT levenshtein(repeat('a', 300000), repeat('b', 300000))";
    let wrong = served.ask(client, slow).unwrap_err();
    assert!(wrong.contains("longer than 2 s"), "{wrong}");
    let prepared = served.runtime.block_on(client.prepare(slow.to_owned(), None)).map(drop).unwrap_err().to_string();
    assert!(prepared.contains("longer than 2 s"), "{prepared}");
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    // The place is free again, and nothing computes any more.
    let answer = (0..30).find_map(|_| served.ask(client, "SELECT count(*) FROM small.clean").ok());
    assert_eq!(answer.unwrap()[0].column(0).as_primitive::<Int64Type>().value(0), 19_200);
}

#[test]
fn user_no_query_takes_more_memory_than_it_may_or_ends_the_server() {
    let bench = ran();
    let served = Served::new(&bench, |s| s.memory = 128 << 20);
    // Texts that are made by functions, while a query is planned and while it is computed.
    let queries = [
        "SELECT length(repeat('a', 2000000000))",
        "SELECT max(length(repeat(flight, 1000000 + CAST(tt AS INT)))) FROM small.clean",
        "SELECT length(lpad('a', 2000000000, 'b'))",
        "SELECT length(string_agg(repeat('x', 1000000), ',')) FROM small.clean",
    ];
    let ask = |query: &'static str| {
        let address = served.address;
        async move {
            let channel = Channel::from_shared(format!("http://{address}"))?.connect().await?;
            let mut client = FlightSqlServiceClient::new(channel);
            let info = client.execute(query.to_owned(), None).await?;
            let ticket = info.endpoint.into_iter().next().and_then(|e| e.ticket).ok_or("no ticket")?;
            let rows: Vec<RecordBatch> = client.do_get(ticket).await?.try_collect().await?;
            Ok::<usize, Box<dyn std::error::Error>>(rows.len())
        }
    };
    let all = served.runtime.block_on(futures::future::join_all(queries.map(ask)));
    for (query, done) in queries.iter().zip(all) {
        let wrong = done.err().map(|e| e.to_string()).unwrap_or_default();
        assert!(wrong.contains("memory"), "{query}: {wrong}");
    }
    assert_eq!(served.count(&mut served.client(), "SELECT count(*) FROM small.clean"), 19_200);
}

#[test]
fn user_connections_that_say_nothing_lock_nobody_out() {
    let bench = ran();
    fs::write(bench.path("token"), TOKEN).unwrap();
    // A server with few file descriptors.
    let serve =
        format!("ulimit -n 256; exec '{}' serve --bind 127.0.0.1:0 --token-file token", env!("CARGO_BIN_EXE_magline"));
    let mut child = Command::new("bash")
        .args(["-c", &serve])
        .current_dir(bench.folder.path())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("serving store at") {
        line.clear();
        assert!(errors.read_line(&mut line).unwrap() > 0, "it does not serve");
    }
    let address: SocketAddr = line.split("grpc://").nth(1).unwrap().split(',').next().unwrap().parse().unwrap();
    // More sockets than the server may have files.
    let silent: Vec<_> = (0..400).filter_map(|_| std::net::TcpStream::connect(address).ok()).collect();
    assert!(silent.len() > 300, "{}", silent.len());
    let begun = Instant::now();
    let answered = Runtime::new().unwrap().block_on(async {
        let channel = Channel::from_shared(format!("http://{address}")).unwrap().connect().await.unwrap();
        let mut client = FlightSqlServiceClient::new(channel);
        client.set_token(TOKEN.to_owned());
        let info = client.execute("SELECT count(*) FROM small.clean".to_owned(), None).await?;
        let ticket = info.endpoint[0].ticket.clone().unwrap();
        let rows: Vec<RecordBatch> = client.do_get(ticket).await?.try_collect().await?;
        Ok::<i64, Box<dyn std::error::Error>>(rows[0].column(0).as_primitive::<Int64Type>().value(0))
    });
    let took = begun.elapsed();
    drop(silent);
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    assert!(child.wait().unwrap().success());
    assert_eq!(answered.unwrap(), 19_200);
    assert!(took < Duration::from_secs(15), "{took:?}");
}

#[test]
fn user_a_client_that_reads_slowly_keeps_no_place() {
    let bench = ran();
    let served = Served::new(&bench, |s| s.queries = 1);
    let client = &mut served.client();
    // Some megabytes that nobody reads, and another query meanwhile.
    let info = served
        .plan(client, "SELECT a.tt, b.tt AS u FROM small.clean a, (SELECT tt FROM small.clean LIMIT 50) b")
        .unwrap();
    let ticket = info.endpoint[0].ticket.clone().unwrap();
    let mut rows = served.runtime.block_on(client.do_get(ticket)).unwrap();
    let begun = Instant::now();
    assert_eq!(served.count(&mut served.client(), "SELECT count(*) FROM small.clean"), 19_200);
    assert!(begun.elapsed() < Duration::from_secs(60));
    // The answer is whole all the same.
    let all = served.runtime.block_on(async {
        let mut all = 0;
        while let Some(batch) = rows.try_next().await.unwrap() {
            all += batch.num_rows();
        }
        all
    });
    assert_eq!(all, 19_200 * 50);
}

#[test]
fn user_the_command_says_where_it_serves_and_ends_when_it_is_told() {
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

    let says = |args: &[&str]| {
        let output = bench.magline(&[&["serve"], args].concat());
        (output.status.code(), stderr(&output))
    };
    let (code, text) = says(&["--bind", "0.0.0.0:0"]);
    assert!(code == Some(2) && text.contains("there is no token"), "{text}");
    fs::write(bench.path("short"), "secret").unwrap();
    let (code, text) = says(&["--token-file", "short"]);
    assert!(code == Some(2) && text.contains("at least 16"), "{text}");
    let (code, text) = says(&["--store", "flights"]);
    assert!(code == Some(2) && text.contains("is not a store"), "{text}");
    let (code, text) = says(&["--tls-cert", "token"]);
    assert!(code == Some(2) && text.contains("--tls-key"), "{text}");
    let (code, text) = says(&["--tls-cert", "token", "--tls-key", "token", "--bind", "127.0.0.1:0"]);
    assert!(code == Some(2) && text.contains("certificate"), "{text}");
}
