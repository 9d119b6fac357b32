//! Protection of a view: address, host, methods, names and idle clients.

use super::*;

#[test]
fn user_only_the_own_page_reads_a_view() {
    let bench = ran();
    let before = bench.tables("store");
    let viewed = Viewed::new(&bench, &["store"]);
    let page = viewed.get("");
    assert_eq!(page.status, 200);
    for head in [
        "content-security-policy: default-src 'none'; script-src 'self'",
        "referrer-policy: no-referrer",
        "x-content-type-options: nosniff",
        "cache-control: no-store",
        "cross-origin-resource-policy: same-origin",
    ] {
        assert!(page.head.contains(head), "{}", page.head);
    }
    assert!(!page.head.contains("access-control"));
    assert!(
        !String::from_utf8_lossy(&page.body).contains("http:")
            && !String::from_utf8_lossy(&page.body).contains(&viewed.token)
    );
    assert!(viewed.host.starts_with("127.0.0.1:") && viewed.token.len() >= 32);
    // The token.
    for path in ["/", "/api/run", "/x/", &format!("/{}x/", viewed.token), &format!("/{}", viewed.token), "//"] {
        assert_eq!(viewed.ask("GET", path, &viewed.host).status, 404, "{path}");
    }
    let other = Viewed::new(&bench, &["store"]);
    assert_eq!(viewed.ask("GET", &format!("/{}/", other.token), &viewed.host).status, 404);
    // The host: a name that resolves to this machine is another site.
    let path = format!("/{}/api/run", viewed.token);
    let port = viewed.host.split_once(':').unwrap().1;
    for host in ["example.com", &format!("example.com:{port}"), "127.0.0.1", "localhost", "127.0.0.1:1", ""] {
        assert_eq!(viewed.ask("GET", &path, host).status, 421, "{host}");
    }
    assert_eq!(viewed.ask("GET", &path, &format!("LocalHost:{port}")).status, 200);
    let twice =
        format!("GET {path} HTTP/1.1\r\nHost: {}\r\nHost: example.com\r\nConnection: close\r\n\r\n", viewed.host);
    assert!([400, 421].contains(&viewed.send(twice.as_bytes()).status));
    let absolute = format!("http://example.com{path}");
    assert_eq!(viewed.ask("GET", &absolute, &viewed.host).status, 421);
    // Only reading.
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "PATCH"] {
        let answer = viewed.ask(method, &path, &viewed.host);
        assert_eq!((answer.status, answer.head.contains("allow: get, head")), (405, true), "{method}");
    }
    let head = viewed.ask("HEAD", &format!("/{}/web/style.css", viewed.token), &viewed.host);
    assert_eq!((head.status, head.body.len()), (200, 0));
    assert_eq!(bench.tables("store"), before);
}

#[test]
fn user_hostile_requests_are_rejected_with_a_reason() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    for path in [
        "web/../page.rs",
        "web/%2e%2e/page.rs",
        "web/",
        "web/none.js",
        "..",
        "%2e%2e/",
        "api/",
        "api/../",
        "download/x",
    ] {
        viewed.refused(path, 404);
    }
    let table = |name: &str| format!("api/lines?table={name}");
    for name in [
        "small.none",
        "none.clean",
        "..%2f..%2fetc.passwd",
        "small.%00",
        "small.clean%00",
        "%2fetc.passwd",
        "small.%E2%80%AEclean",
        "%FF.%FE",
        "small.../clean",
        "small.%3Cscript%3E",
    ] {
        viewed.refused(&table(name), 404);
    }
    viewed.refused(&table("small"), 400);
    viewed.refused(&table(""), 400);
    viewed.refused(&table(&"x".repeat(1001)), 400);
    viewed.refused(&format!("api/lineage?table={}", "a.".repeat(300)), 404);
    let series = |rest: &str| format!("api/series?table=small.clean&flight=1&line=1.01&{rest}");
    viewed.refused(&series(&format!("columns=none&{POINT}")), 404);
    viewed.refused(&series(&format!("columns=tl[99]&{POINT}")), 400);
    viewed.refused(&series(&format!("columns=tl&{POINT}")), 400);
    viewed.refused(&series(&format!("columns=line&{POINT}")), 400);
    let needed = viewed.refused(&series("columns=mag_c"), 400);
    assert!(needed.contains("needs a value of the axis"), "{needed}");
    viewed.refused(&series(&format!("columns=mag_c&{POINT}&axis.none=1")), 400);
    viewed.refused(&series("columns=mag_c&axis.mag=none&axis.vector=flux_a&axis.lambda=0"), 404);
    viewed.refused(&series(&format!("columns=mag_c&{POINT}&pixels=20001")), 400);
    viewed.refused(&series(&format!("columns=mag_c&{POINT}&from=nan")), 400);
    viewed.refused(&series(&format!("columns=mag_c&{POINT}&from=2&to=1")), 400);
    viewed.refused(&series(&format!("columns={}&{POINT}", "mag_c,".repeat(65))), 400);
    viewed.refused(&format!("api/series?table=small.scores&flight=1&line=1.01&columns=value&{POINT}"), 400);
    viewed.refused("api/scores?table=small.clean", 400);
    let text = viewed.refused(&table("small.%3Cb%3E%22%1b[31m"), 404);
    assert!(!text.contains('\u{1b}'), "{text:?}");
    // A head that is too large.
    let long = format!("GET /{}/?{} HTTP/1.1\r\nHost: {}\r\n\r\n", viewed.token, "x".repeat(100_000), viewed.host);
    let answer = viewed.send(long.as_bytes());
    assert!([400, 414, 431].contains(&answer.status), "{answer:?}");
    assert_eq!(viewed.get("api/run").status, 200);
}

#[test]
fn user_names_of_any_text_are_escaped() {
    let bench = Bench::new();
    let hostile = "a\"</script><b>\\ \u{1b}[31m\u{202e}'é";
    write(&bench.path("flights/1.parquet"), &[line_of(hostile, "1.01", 700), line_of(hostile, hostile, 500)]);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let viewed = Viewed::new(&bench, &["store"]);
    let lines = viewed.json(&format!("api/lines?table=small.clean&{POINT}"));
    let found = lines["lines"].as_array().unwrap().iter().find(|l| l["line"] == hostile).unwrap().clone();
    assert_eq!((found["flight"].as_str(), &found["rows"]), (Some(hostile), &500.into()));
    let coded: String = hostile.bytes().map(|b| format!("%{b:02X}")).collect();
    let rows =
        viewed.get(&format!("api/series?table=small.clean&flight={coded}&line={coded}&columns=mag_c&{POINT}")).rows();
    assert_eq!((rows.num_rows(), rows.schema().metadata()["line"].as_str()), (500, hostile));
    assert!(!rows.column_by_name("mag_c").unwrap().is_null(0));
    let scores = viewed.json("api/scores?table=small.scores");
    assert!(scores["lines"]["names"].as_array().unwrap().iter().any(|n| n[1] == hostile));
}

#[test]
fn user_idle_clients_do_not_block_a_view() {
    let bench = ran();
    let viewed = Viewed::new(&bench, &["store"]);
    let mut idle: Vec<TcpStream> = (0..40).map(|_| TcpStream::connect(&viewed.host).unwrap()).collect();
    // Clients that ask and never read.
    for stream in &mut idle[..20] {
        let request = format!("GET /{}/web/web/explorer.js HTTP/1.1\r\nHost: {}\r\n\r\n", viewed.token, viewed.host);
        stream.write_all(request.repeat(200).as_bytes()).unwrap();
    }
    let asked: Vec<_> = (0..8).map(|_| viewed.get(&format!("api/lines?table=small.clean&{POINT}")).status).collect();
    assert_eq!(asked, [200; 8]);
    drop(idle);
}
