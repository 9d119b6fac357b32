//! A scheduler and workers as processes on this machine, one cluster at a time.

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{Mutex, MutexGuard, PoisonError},
    thread::{sleep, spawn},
    time::{Duration, Instant},
};

/// Longest wait. The limit allows for machines that build and test at the same time.
const LONGEST: Duration = Duration::from_secs(240);

/// Key file in the folder of a cluster.
pub const KEY_FILE: &str = "cluster.key";
/// The key.
pub const KEY: &str = "a-key-of-a-test-7d1e4b0c9a2f5863";

static ONE: Mutex<()> = Mutex::new(());

/// A cluster. The processes are killed when the cluster is dropped.
pub struct Cluster {
    program: PathBuf,
    folder: PathBuf,
    /// HOST:PORT of the scheduler.
    pub at: String,
    pub scheduler: Child,
    /// Workers, each with its file of receipts.
    pub workers: Vec<(Child, PathBuf)>,
    _one: MutexGuard<'static, ()>,
}

/// Writes a key file that only its owner can read.
pub fn write_key(file: &Path, key: &str) {
    fs::write(file, key).unwrap();
    fs::set_permissions(file, fs::Permissions::from_mode(0o600)).unwrap();
}

/// Waits until `is` returns true.
pub fn until(what: &str, mut is: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is() {
        assert!(begun.elapsed() < LONGEST, "waited too long until {what}");
        sleep(Duration::from_millis(20));
    }
}

/// Starts a scheduler of `program` and returns its address.
fn scheduler(program: &Path, folder: &Path, bind: &str) -> (Child, String) {
    let mut child = Command::new(program)
        .args(["scheduler", "--bind", bind, "--worker-timeout", "6s", "--key-file", KEY_FILE])
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr_reader = BufReader::new(child.stderr.take().unwrap());
    let (mut line, mut all) = (String::new(), String::new());
    let at = loop {
        line.clear();
        assert!(stderr_reader.read_line(&mut line).unwrap() > 0, "the scheduler ended: {all}");
        all.push_str(&line);
        if let Some(at) = line.trim().strip_prefix("note: the scheduler listens on ") {
            break at.to_owned();
        }
    };
    // A full pipe would block the scheduler.
    spawn(move || stderr_reader.read_to_end(&mut vec![]));
    (child, at)
}

impl Cluster {
    /// Starts a scheduler and `workers` workers of one core in `folder`, with the store `store` in it.
    pub fn new(program: &str, folder: &Path, workers: usize) -> Cluster {
        let one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        let program = PathBuf::from(program);
        write_key(&folder.join(KEY_FILE), KEY);
        let (scheduler, at) = scheduler(&program, folder, "127.0.0.1:0");
        let folder = folder.to_owned();
        let mut cluster = Cluster { program, folder, at, scheduler, workers: vec![], _one: one };
        (0..workers).for_each(|_| cluster.add("store"));
        cluster
    }

    /// The argument of `--engine`.
    pub fn engine(&self) -> String {
        format!("ballista://{}", self.at)
    }

    /// Adds a worker with the store `store` and waits until it runs.
    pub fn add(&mut self, store: &str) {
        self.add_with(store, &[]);
    }

    /// Adds a worker with environment variables.
    pub fn add_with(&mut self, store: &str, env: &[(String, String)]) {
        self.add_at(store, env, 0);
    }

    /// Adds a worker at `port` and the next port, or at two free ports if `port` is 0.
    pub fn add_at(&mut self, store: &str, env: &[(String, String)], port: u16) {
        let path = |ending: &str| self.folder.join(format!("worker{}.{ending}", self.workers.len()));
        let (receipts, log) = (path("jsonl"), path("log"));
        let child = Command::new(&self.program)
            .args(["worker", "--scheduler", &self.at, "--store", store, "--cores", "1", "--heartbeat", "1s"])
            .args(["--key-file", KEY_FILE, "--port", &port.to_string()])
            .current_dir(&self.folder)
            .env("RUST_BACKTRACE", "0")
            .envs(env.iter().cloned())
            .stdin(Stdio::null())
            .stdout(fs::File::create(&receipts).unwrap())
            .stderr(fs::File::create(&log).unwrap())
            .spawn()
            .unwrap();
        self.workers.push((child, receipts));
        until("a worker has registered", || {
            fs::read_to_string(&log).unwrap().contains("registered with the scheduler")
        });
    }

    /// Kills a worker as the kernel does when memory is exhausted.
    pub fn kill(&mut self, worker: usize) {
        let (child, _) = &mut self.workers[worker];
        child.kill().unwrap();
        child.wait().unwrap();
    }

    /// Kills the scheduler and starts another one at the same address after `after`.
    pub fn another_scheduler(&mut self, after: Duration) {
        self.kill_scheduler();
        sleep(after);
        self.start_scheduler();
    }

    /// Kills the scheduler.
    pub fn kill_scheduler(&mut self) {
        self.scheduler.kill().unwrap();
        self.scheduler.wait().unwrap();
    }

    /// Starts a scheduler at the address of the last one.
    pub fn start_scheduler(&mut self) {
        let (scheduler, at) = scheduler(&self.program, &self.folder, &self.at);
        assert_eq!(at, self.at);
        self.scheduler = scheduler;
    }

    /// Receipts of all workers, one per line.
    pub fn receipts(&self) -> Vec<String> {
        let of = |file: &PathBuf| fs::read_to_string(file).unwrap().lines().map(str::to_owned).collect::<Vec<_>>();
        self.workers.iter().flat_map(|(_, file)| of(file)).collect()
    }

    /// Standard error of the workers.
    pub fn worker_stderr(&self) -> String {
        let of = |(_, file): &(Child, PathBuf)| fs::read_to_string(file.with_extension("log")).unwrap();
        self.workers.iter().map(of).collect()
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        for child in self.workers.iter_mut().map(|(child, _)| child).chain([&mut self.scheduler]) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
