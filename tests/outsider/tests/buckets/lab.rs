//! Flights, a spec, a server, and processes of this program as its clients.

use std::{
    collections::BTreeMap,
    env, fs,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
};

use serde_json::Value;
use tempfile::TempDir;

use crate::server::{Asked, BUCKET, Fault, Kind, Server, USERS, secret};

/// Spec with each line on an even time grid and three low-pass filters.
pub const SPEC: &str = r#"
name  = "small"
store = "store"

[tables.flights]
path = "flights/*.csv"

[axes]
corner = [0.5, 0.9, 1.5]

[[stages]]
name    = "even"
stage   = "resample"
input   = "flights"
rate_hz = 10.0

[[stages]]
name      = "smooth"
stage     = "lowpass"
input     = "even"
columns   = ["mag_1_uc"]
corner_hz = "$corner"

[publish]
title       = "A test"
description = "Lines of a test"
licence     = "CC-BY-4.0"
contact     = "a@example.org"
date        = "2026-01-01"
authors     = [{ name = "A B" }]
"#;

/// Service account without a token, as accepted by servers other than Google's.
const WITHOUT_TOKEN: &str =
    r#"{"private_key": "geheim", "private_key_id": "1", "client_email": "a@example.org", "disable_oauth": true}"#;

/// Flight of two lines with `rows` samples each.
pub fn flight(number: usize, rows: usize) -> String {
    let mut text = "tt,flight,line,mag_1_uc\n".to_owned();
    for line in 1..=2 {
        for i in 0..rows {
            let tt = i as f64 / 10.0 + 1000.0 * f64::from(line);
            let mag = 50_000.0 + (i * i * number % 97) as f64 + 30.0 * (0.3 * tt + number as f64).sin();
            text.push_str(&format!("{tt:.1},{number},{number}.0{line},{mag:.3}\n"));
        }
    }
    text
}

/// Files by their names.
pub type Files = BTreeMap<String, Vec<u8>>;

/// Server, and folder with flights and a spec.
pub struct Lab {
    pub folder: TempDir,
    pub server: Server,
    caches: AtomicUsize,
}

/// Outcome of a process.
pub struct Done {
    pub code: i32,
    pub out: String,
    pub err: String,
}

impl Done {
    /// Number in the last event.
    pub fn total(&self, what: &str) -> u64 {
        let last = self.out.lines().last().and_then(|line| serde_json::from_str::<Value>(line).ok());
        last.and_then(|last| last[what].as_u64()).unwrap_or_else(|| panic!("no {what} in {} {}", self.out, self.err))
    }

    /// Exit status, number of computed units, and number of reused units.
    pub fn counts(&self) -> (i32, u64, u64) {
        (self.code, self.total("computed"), self.total("reused"))
    }
}

/// Exit code and output of a child process, after its end.
pub fn ended(child: Child) -> Done {
    let output = child.wait_with_output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let done = Done { code: output.status.code().unwrap(), out: text(&output.stdout), err: text(&output.stderr) };
    let printed = format!("{}{}", done.out, done.err);
    assert!(!printed.contains("geheim") && !printed.contains("AKIA"), "a credential is shown: {printed}");
    done
}

impl Lab {
    /// Four flights of 300 samples per line.
    pub fn new() -> Lab {
        Lab::of(4, 300, SPEC)
    }

    /// Four flights of 300 samples per line, with Google's interface.
    pub fn google() -> Lab {
        Lab::with(Server::of(Kind::Google), 4, 300, SPEC)
    }

    pub fn of(flights: usize, rows: usize, spec: &str) -> Lab {
        Lab::with(Server::new(), flights, rows, spec)
    }

    fn with(server: Server, flights: usize, rows: usize, spec: &str) -> Lab {
        let lab = Lab { folder: tempfile::tempdir().unwrap(), server, caches: AtomicUsize::new(0) };
        fs::create_dir(lab.path("flights")).unwrap();
        for number in 1..=flights {
            fs::write(lab.path(&format!("flights/{number}.csv")), flight(number, rows)).unwrap();
        }
        fs::write(lab.path("spec.toml"), spec).unwrap();
        lab
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Path of a new cache folder.
    pub fn cache(&self) -> PathBuf {
        self.path(&format!("cache{}", self.caches.fetch_add(1, Ordering::Relaxed)))
    }

    /// Environment variables of a user with a cache.
    pub fn env(&self, user: &str, cache: &Path) -> Vec<(String, String)> {
        let cache = cache.display().to_string();
        let home = self.folder.path().display().to_string();
        let (endpoint, secret) = (self.server.endpoint.as_str(), secret(user));
        let pairs = [
            ("MAGLINE_CACHE", cache.as_str()),
            ("HOME", &home),
            ("AWS_ENDPOINT_URL", endpoint),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_ACCESS_KEY_ID", user),
            ("AWS_SECRET_ACCESS_KEY", &secret),
            ("AWS_REGION", "us-east-1"),
            ("AWS_TIMEOUT", "3 seconds"),
            ("GOOGLE_BASE_URL", endpoint),
            ("GOOGLE_ALLOW_HTTP", "true"),
            ("GOOGLE_SERVICE_ACCOUNT_KEY", WITHOUT_TOKEN),
            ("GOOGLE_TIMEOUT", "3 seconds"),
        ];
        pairs.map(|(name, value)| (name.to_owned(), value.to_owned())).to_vec()
    }

    /// Starts a process.
    pub fn start(&self, args: &[&str], env: &[(String, String)]) -> Child {
        let is_ours = |name: &str| ["AWS_", "GOOGLE_", "MAGLINE_"].iter().any(|start| name.starts_with(start));
        let others = env::vars().filter(|(name, _)| !is_ours(name));
        Command::new(env!("CARGO_BIN_EXE_outsider"))
            .args(args)
            .env_clear()
            .envs(others)
            .envs(env.iter().cloned())
            .current_dir(self.folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// Runs a process of the first user with an empty cache to its end.
    pub fn magline(&self, args: &[&str]) -> Done {
        self.magline_with(args, &self.cache())
    }

    pub fn magline_with(&self, args: &[&str], cache: &Path) -> Done {
        ended(self.start(args, &self.env(USERS[0], cache)))
    }

    /// Starts a run of the spec with the store at `store`.
    pub fn begun(&self, store: &str, user: &str, cache: &Path, more: &[&str]) -> Child {
        let set = format!("store={store}");
        self.start(&[&["run", "spec.toml", "--json", "--set", &set], more].concat(), &self.env(user, cache))
    }

    /// Runs the spec as the first user to its end.
    pub fn run(&self, store: &str, cache: &Path, more: &[&str]) -> Done {
        ended(self.begun(store, USERS[0], cache, more))
    }

    /// Files and number of units of a run with its store in a folder.
    pub fn local(&self) -> (Files, u64) {
        let run = self.run("whole", &self.cache(), &[]);
        assert_eq!(run.code, 0, "{}", run.err);
        (files(&self.path("whole")), run.total("computed"))
    }

    /// Sets the faults of later requests and returns their counter.
    pub fn faults(&self, mut decide: impl FnMut(&Asked) -> Fault + Send + 'static) -> Arc<AtomicUsize> {
        let count = Arc::new(AtomicUsize::new(0));
        let counted = count.clone();
        self.server.faults(move |asked| {
            let fault = decide(asked);
            counted.fetch_add(usize::from(fault != Fault::None), Ordering::Relaxed);
            fault
        });
        count
    }

    /// Number of writes of each pack.
    pub fn packs_written(&self) -> BTreeMap<String, usize> {
        let mut found = BTreeMap::new();
        for asked in self.server.asked().into_iter().filter(|a: &Asked| a.writes_pack() && a.is_done()) {
            *found.entry(asked.key).or_default() += 1;
        }
        found
    }

    /// Asserts that the store below `prefix` has exactly the files `expected` of a store in a folder.
    pub fn assert_bucket(&self, prefix: &str, expected: &Files, what: &str) {
        let (own, plain) = files(&self.server.path(prefix)).into_iter().partition(|(n, _)| n.starts_with("versions/"));
        let (mut ours, theirs): (Files, Files) = (expected.clone(), own);
        ours.retain(|name, _| !name.starts_with("versions/"));
        assert_same(&ours, &plain, what);
        for (name, bytes) in &theirs {
            // Versions in a bucket refer to packs without copies. Version numbers depend on the store.
            let name = name.splitn(4, '/').nth(3).unwrap();
            assert_eq!(expected.get(&format!("versions/small/1/{name}")), Some(bytes), "{what}: {name}");
        }
        let [here, there] = [self.path("whole"), self.server.path(prefix)].map(|root| tables(&root));
        assert!(here.len() >= 5);
        assert_same(&here, &there, what);
    }

    /// Asserts that the store below `prefix` has the packs `expected`; further packs are permitted.
    pub fn assert_packs(&self, prefix: &str, expected: &Files) {
        let found = files(&self.server.path(prefix));
        for (name, bytes) in expected.iter().filter(|(name, _)| name.starts_with("objects/")) {
            assert!(found.get(name) == Some(bytes), "{name} differs or is missing");
        }
    }
}

/// Files with times or machine-specific content.
const TIMED: [&str; 11] =
    ["locks/", "tmp/", "costs/", "plans/", "runs/", "attempts/", "checkpoints/", "tables/", "index", "STORE", "REMOTE"];

/// Files of a store that are independent of its location.
pub fn files(root: &Path) -> Files {
    let mut found = Files::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap().map(Result::unwrap) {
            let (path, kind) = (entry.path(), entry.file_type().unwrap());
            let name = path.strip_prefix(root).unwrap().display().to_string();
            if kind.is_dir() {
                folders.push(path);
            } else if kind.is_file()
                && !TIMED.iter().any(|start| name.starts_with(start))
                && !name.ends_with(".seen")
                && !name.ends_with("version.json")
            {
                found.insert(name, fs::read(path).unwrap());
            }
        }
    }
    found
}

pub fn assert_same(expected: &Files, found: &Files, what: &str) {
    assert_eq!(expected.keys().collect::<Vec<_>>(), found.keys().collect::<Vec<_>>(), "{what}");
    for (name, bytes) in expected {
        assert!(found[name] == *bytes, "{what}: {name} differs");
    }
}

/// Files of the newest version of the pipeline `small` according to its manifest, in a folder or a bucket.
pub fn tables(root: &Path) -> Files {
    let pointer = root.join("tables/small");
    let target = match fs::read_link(&pointer) {
        Ok(link) => link.display().to_string(),
        Err(_) => fs::read_to_string(&pointer).unwrap().lines().next().unwrap().to_owned(),
    };
    let version = root.join(target.strip_prefix("../").unwrap().strip_suffix("/tables").unwrap());
    let list: Value = serde_json::from_slice(&fs::read(version.join("version.json")).unwrap()).unwrap();
    let mut found = Files::new();
    for table in list["tables"].as_array().unwrap() {
        let units = Some(&table["units"]).filter(|units| units.is_object());
        for file in table["files"].as_array().unwrap().iter().chain(units) {
            let name = file["name"].as_str().unwrap();
            let path = match file["pack"].as_str() {
                Some(pack) => root.join(format!("objects/{}/{pack}.parquet", &pack[..2])),
                None => version.join(name),
            };
            found.insert(name.to_owned(), fs::read(path).unwrap());
        }
    }
    found
}

/// The only store of a cache.
pub fn store_of(cache: &Path) -> PathBuf {
    let all: Vec<PathBuf> = fs::read_dir(cache.join("stores")).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(all.len(), 1, "{all:?}");
    all[0].clone()
}

/// The address of a key of the bucket.
pub fn address(key: &str) -> String {
    format!("s3://{BUCKET}/{key}")
}

/// Address of a key of the bucket at Google's interface.
pub fn google_address(key: &str) -> String {
    format!("gs://{BUCKET}/{key}")
}
