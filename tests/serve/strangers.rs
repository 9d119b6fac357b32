//! Protection of clients from each other: tokens, encryption, limits of time and memory.

use super::*;

#[test]
fn user_only_clients_with_the_token_are_answered() {
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
    // The token is also accepted as the password with any user name, and the handshake returns it.
    let mut client = served.client();
    assert!(served.runtime.block_on(client.handshake("anyone", "wrong password")).is_err());
    is_refused(&mut client);
    served.runtime.block_on(client.handshake("anyone", TOKEN)).unwrap();
    assert_eq!(client.token().unwrap(), TOKEN);
    assert!(served.count(&mut client, one) > 0);
}

#[test]
fn user_a_ticket_of_one_server_is_invalid_at_the_next() {
    let bench = ran();
    let first = Served::new(&bench, |_| {});
    let info = first.plan(&mut first.client(), "SELECT 1").unwrap();
    drop(first);
    let second = Served::new(&bench, |_| {});
    let client = &mut second.client();
    second.plan(client, "SELECT 2").unwrap();
    let wrong = second.rows(client, info).unwrap_err();
    assert!(wrong.contains("has expired"), "{wrong}");
}

#[test]
fn user_a_query_past_its_timeout_is_ended_and_frees_its_slot() {
    let bench = ran();
    let served = Served::new(&bench, |s| (s.queries, s.timeout) = (1, Duration::from_secs(2)));
    let client = &mut served.client();
    // On a busy machine even a small query may exceed the limit, so it is retried.
    let counted = |client: &mut Client| {
        let answer = (0..30).find_map(|_| served.ask(client, "SELECT count(*) FROM small.clean").ok());
        answer.unwrap()[0].column(0).as_primitive::<Int64Type>().value(0)
    };
    // 1e10 rows.
    let slow = "SELECT sum(sqrt(a.value * b.value)) FROM generate_series(1, 100000) a, generate_series(1, 100000) b";
    let wrong = served.ask(client, slow).unwrap_err();
    assert!(wrong.contains("exceeded its time limit of 2 s"), "{wrong}");
    assert_eq!(counted(client), 19_200);
    // A query with unread rows also releases its slot, and the stream of rows ends with an error.
    let info = served.plan(client, "SELECT a.mag_c FROM small.clean a, small.clean b").unwrap();
    let ticket = info.endpoint[0].ticket.clone().unwrap();
    let mut rows = served.runtime.block_on(client.do_get(ticket)).unwrap();
    thread::sleep(Duration::from_secs(3));
    assert_eq!(counted(client), 19_200);
    let end = served.runtime.block_on(async {
        while rows.try_next().await?.is_some() {}
        Ok::<_, arrow_flight::error::FlightError>(())
    });
    assert!(end.unwrap_err().to_string().contains("exceeded its time limit of 2 s"));
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
fn user_a_disconnected_client_frees_its_slot() {
    let bench = ran();
    let served = Served::new(&bench, |s| (s.queries, s.timeout) = (1, Duration::from_secs(600)));
    let client = &mut served.client();
    let begun = Instant::now();
    // 368 million rows, but only three messages are read. The rows are neither computed at once nor stored.
    let info = served.plan(client, "SELECT a.mag_c, b.tt FROM small.clean a, small.clean b").unwrap();
    let ticket = info.endpoint[0].ticket.clone().unwrap();
    let mut rows = served.runtime.block_on(client.do_get(ticket)).unwrap();
    for _ in 0..3 {
        assert!(served.runtime.block_on(rows.try_next()).unwrap().unwrap().num_rows() > 0);
    }
    drop(rows);
    // The slot is free long before the timeout.
    assert_eq!(served.count(client, "SELECT count(*) FROM small.clean"), 19_200);
    assert!(begun.elapsed() < Duration::from_secs(500));
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
fn user_planning_is_subject_to_the_timeout() {
    let bench = ran();
    let served = Served::new(&bench, |s| (s.queries, s.timeout) = (1, Duration::from_secs(2)));
    let client = &mut served.client();
    let begun = Instant::now();
    // Planning folds constants: 9e10 steps that cannot be interrupted.
    let slow = "SELECT levenshtein(repeat('a', 300000), repeat('b', 300000))";
    let wrong = served.ask(client, slow).unwrap_err();
    assert!(wrong.contains("exceeded its time limit of 2 s"), "{wrong}");
    let prepared = served.runtime.block_on(client.prepare(slow.to_owned(), None)).map(drop).unwrap_err().to_string();
    assert!(prepared.contains("exceeded its time limit of 2 s"), "{prepared}");
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    // The slot is free again, and the computation has ended.
    let answer = (0..30).find_map(|_| served.ask(client, "SELECT count(*) FROM small.clean").ok());
    assert_eq!(answer.unwrap()[0].column(0).as_primitive::<Int64Type>().value(0), 19_200);
}

#[test]
fn user_no_query_exceeds_its_memory_limit_or_ends_the_server() {
    let bench = ran();
    let served = Served::new(&bench, |s| s.memory = 128 << 20);
    // Functions that create long strings, during planning and during execution.
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
fn user_silent_connections_do_not_block_other_clients() {
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
    // More sockets than the limit of file descriptors of the server.
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
fn user_a_slow_client_does_not_hold_a_query_slot() {
    let bench = ran();
    let served = Served::new(&bench, |s| s.queries = 1);
    let client = &mut served.client();
    // Several megabytes that stay unread during another query.
    let info = served
        .plan(client, "SELECT a.tt, b.tt AS u FROM small.clean a, (SELECT tt FROM small.clean LIMIT 50) b")
        .unwrap();
    let ticket = info.endpoint[0].ticket.clone().unwrap();
    let mut rows = served.runtime.block_on(client.do_get(ticket)).unwrap();
    let begun = Instant::now();
    assert_eq!(served.count(&mut served.client(), "SELECT count(*) FROM small.clean"), 19_200);
    assert!(begun.elapsed() < Duration::from_secs(60));
    // The answer is still complete.
    let all = served.runtime.block_on(async {
        let mut all = 0;
        while let Some(batch) = rows.try_next().await.unwrap() {
            all += batch.num_rows();
        }
        all
    });
    assert_eq!(all, 19_200 * 50);
}
