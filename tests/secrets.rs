//! Credentials, and servers that try to make the program show them or send them elsewhere.

use std::{
    fs,
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread::spawn,
};

use crate::support::{Bench, stderr, stdout};

/// Strings that must not be shown: access key, secret key, session token, password.
const SECRETS: [&str; 4] = ["AKIAGEHEIM", "geheim-secret", "geheim-token", "geheim-password"];

/// Server that answers every request with this status and an echo of the request; returns its address and the number of
/// requests.
fn echoing(status: &'static str, header: String) -> (SocketAddr, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, asked) = (listener.local_addr().unwrap(), Arc::new(AtomicUsize::new(0)));
    let count = asked.clone();
    spawn(move || {
        for stream in listener.incoming() {
            let (header, count) = (header.clone(), count.clone());
            spawn(move || echo(stream.unwrap(), status, &header, &count));
        }
    });
    (address, asked)
}

fn echo(mut stream: TcpStream, status: &str, header: &str, count: &AtomicUsize) {
    let mut head = vec![];
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") && stream.read(&mut byte).is_ok_and(|n| n > 0) {
        head.push(byte[0]);
    }
    if head.is_empty() {
        return;
    }
    count.fetch_add(1, Ordering::Relaxed);
    let head = String::from_utf8_lossy(&head).into_owned();
    let body = format!("<Error><Code>AccessDenied</Code><Message>You sent {head} geheim-password</Message></Error>");
    let body = if head.starts_with("HEAD") { String::new() } else { body };
    let length = body.len();
    let _ = write!(stream, "HTTP/1.1 {status}\r\n{header}content-length: {length}\r\nconnection: close\r\n\r\n{body}");
}

/// Output and files of commands with a store at `endpoint`.
fn commands_and_files(bench: &Bench, endpoint: &str) -> String {
    let command = |args: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_magline"))
            .args(args)
            .current_dir(bench.folder.path())
            .env("HOME", bench.folder.path())
            .env("MAGLINE_CACHE", bench.path("cache"))
            .env("AWS_ENDPOINT_URL", endpoint)
            .env("AWS_ALLOW_HTTP", "true")
            .env("AWS_ACCESS_KEY_ID", SECRETS[0])
            .env("AWS_SECRET_ACCESS_KEY", SECRETS[1])
            .env("AWS_SESSION_TOKEN", SECRETS[2])
            .env("AWS_REGION", "us-east-1")
            .stdin(Stdio::null())
            .output()
            .unwrap();
        assert!(!output.status.success(), "{}", stdout(&output));
        stdout(&output) + &stderr(&output)
    };
    let printed = [
        command(&["run", "spec.toml", "--json", "--set", "store=s3://bucket/store"]),
        command(&["sql", "SELECT 1", "--store", "s3://bucket/store"]),
        command(&["verify", "s3://bucket/store"]),
        command(&["run", "spec.toml", "--set", "tables.flights.path=s3://bucket/flights/*.csv"]),
    ];
    printed.concat()
}

/// Contents of all files below a folder, without links.
fn written(folder: &std::path::Path) -> String {
    let mut all = String::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        match entry.file_type().unwrap().is_dir() {
            true => all.push_str(&written(&entry.path())),
            false => all.push_str(&String::from_utf8_lossy(&fs::read(entry.path()).unwrap_or_default())),
        }
    }
    all
}

fn assert_hidden(bench: &Bench, printed: &str) {
    let all = printed.to_owned() + &written(&bench.path("store")) + &written(&bench.path("cache"));
    for secret in SECRETS {
        assert!(!all.contains(secret), "{secret} is shown: {printed}");
    }
    assert!(!printed.contains("Credential=") && !printed.contains("You sent"), "{printed}");
}

#[test]
fn user_credentials_repeated_by_a_server_are_not_shown() {
    for status in ["403 Forbidden", "400 Bad Request", "401 Unauthorized"] {
        let bench = Bench::new();
        let (address, asked) = echoing(status, String::new());
        let printed = commands_and_files(&bench, &format!("http://{address}"));
        assert!(asked.load(Ordering::Relaxed) > 0);
        assert!(printed.contains(status.split(' ').next().unwrap()), "{status}: {printed}");
        assert_hidden(&bench, &printed);
    }
}

#[test]
fn user_a_redirect_to_another_server_is_not_followed() {
    for status in ["307 Temporary Redirect", "301 Moved Permanently", "308 Permanent Redirect"] {
        let bench = Bench::new();
        let (other, reached) = echoing("403 Forbidden", String::new());
        let (address, asked) = echoing(status, format!("location: http://{other}/elsewhere\r\n"));
        let printed = commands_and_files(&bench, &format!("http://{address}"));
        assert!(asked.load(Ordering::Relaxed) > 0);
        assert_eq!(reached.load(Ordering::Relaxed), 0, "{status}");
        assert_hidden(&bench, &printed);
    }
}

#[test]
fn user_an_endpoint_with_a_password_is_rejected_and_not_shown() {
    let bench = Bench::new();
    let (address, asked) = echoing("403 Forbidden", String::new());
    for endpoint in [
        format!("http://me:geheim-password@{address}"),
        format!("http://geheim-password@{address}/"),
        format!("http://{address}/?token=geheim-password"),
    ] {
        let printed = commands_and_files(&bench, &endpoint);
        assert!(printed.contains("contains a user, a password or a query"), "{printed}");
        assert_hidden(&bench, &printed);
    }
    assert_eq!(asked.load(Ordering::Relaxed), 0);
    // The password of the server for lineage events is also not shown.
    let to = format!("http://me:geheim-password@{address}/?key=geheim-password");
    let run = bench.magline(&["run", "spec.toml", "--openlineage", &to]);
    let printed = stdout(&run) + &stderr(&run);
    assert!(run.status.success(), "{printed}");
    assert_hidden(&bench, &printed);
}
