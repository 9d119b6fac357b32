//! After a power loss at any moment, or any flipped bit, another run restores the store.
//!
//! A preloaded library (`shim/power.c`) ends a run before a chosen rename, link or fsync. Before that, unsynced data
//! are dropped, as on a disk that loses power.
#![cfg(target_os = "linux")]

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{Read, Seek, SeekFrom, Write},
    os::unix::process::ExitStatusExt,
    path::{Path, PathBuf},
    process::Command,
};

use crate::support::{Bench, repository, stderr, stdout};

/// Short pipeline: a table by lines, a fit, and passthrough columns.
const SHORT: &str = r#"
name  = "small"
seed  = 1
store = "store"

[tables.flights]
path = "flights/"

[axes]
lambda = [0.0, 0.025]

[[stages]]
name    = "even"
stage   = "resample"
input   = "flights"
rate_hz = 10.0

[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "even"
vector = "flux_a"

[[stages]]
name   = "coefficients"
stage  = "fit"
input  = "terms"
where  = "line like '%.01'"
model  = "tolles_lawson"
target = "mag_4_uc"
lambda = "$lambda"

[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
model = "coefficients"
mag   = "mag_4_uc"
"#;

/// Sums of whole numbers, which do not depend on the row order. `lat` of `clean` is stored in an upstream table.
const QUESTION: &str = "
    SELECT 'even' AS name, count(*) AS n, sum(CAST(mag_4_uc * 1e6 AS BIGINT)) AS a, sum(CAST(tt * 1e3 AS BIGINT)) AS b
        FROM small.even
    UNION ALL SELECT 'clean', count(*), sum(CAST(mag_c * 1e6 AS BIGINT)), sum(CAST(lat * 1e9 AS BIGINT))
        FROM small.clean
    UNION ALL SELECT 'fit', count(*), sum(CAST(value * 1e6 AS BIGINT)), sum(n) FROM small.coefficients
    UNION ALL SELECT 'quality', count(*), sum(n), sum(first_row) FROM small.quality
    UNION ALL SELECT 'warnings', count(*), sum(length(text)), sum(length(stage)) FROM small.warnings
    UNION ALL SELECT 'failures', count(*), sum(length(error)), sum(length(stage)) FROM small.failures
    ORDER BY name";

/// Changed parameters of the second run of a store.
const CHANGED: [&str; 2] = ["--set", "axes.lambda=[0.5]"];

type Files = BTreeMap<String, Vec<u8>>;

/// Visible state of a store: the files of its tables, and the answer to [`QUESTION`].
#[derive(PartialEq)]
struct Shown {
    files: Files,
    answer: String,
}

struct Scene {
    bench: Bench,
    shim: PathBuf,
    folder: PathBuf,
}

/// End of a run: point, mode and seed.
#[derive(Clone, Copy, Debug)]
struct End {
    point: usize,
    mode: &'static str,
    seed: usize,
}

impl Scene {
    fn new() -> Scene {
        let bench = Bench::new();
        // The next run reads files of less than 2 s of age again, which would change its points.
        std::thread::sleep(std::time::Duration::from_millis(2100));
        bench.spec(SHORT);
        let shim = bench.path("power.so");
        let source = repository().join("tests/shim/power.c");
        let built = Command::new("cc").args(["-shared", "-fPIC", "-O1", "-o"]).args([&shim, &source]).output();
        let built = built.expect("the C compiler `cc`, which links Rust programs too, builds the library of this test");
        assert!(built.status.success(), "{}", stderr(&built));
        let folder = bench.folder.path().canonicalize().unwrap();
        Scene { bench, shim, folder }
    }

    /// Command of a run in `store` under the shim.
    fn shimmed(&self, store: &str, more: &[&str], end: Option<End>) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_magline"));
        command.args(["run", "spec.toml", "--quiet", "--threads", "2", "--set", &format!("store={store}")]).args(more);
        command.current_dir(&self.folder).env("LD_PRELOAD", &self.shim);
        command.env("MAGLINE_SHIM_ROOT", self.folder.join(store)).env("MAGLINE_SHIM_COUNT", self.folder.join("count"));
        if let Some(end) = end {
            command.env("MAGLINE_SHIM_AT", end.point.to_string()).env("MAGLINE_SHIM_MODE", end.mode);
            command.env("MAGLINE_SHIM_SEED", end.seed.to_string());
        }
        command
    }

    /// Number of points of an undisturbed run in `store`.
    fn points(&self, store: &str, more: &[&str]) -> usize {
        let output = self.shimmed(store, more, None).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        fs::read_to_string(self.folder.join("count")).unwrap().trim().parse().unwrap()
    }

    /// True if a run in `store` was ended at the selected point.
    fn dies(&self, store: &str, more: &[&str], end: End) -> bool {
        let output = self.shimmed(store, more, Some(end)).output().unwrap();
        assert!(output.status.signal() == Some(9) || output.status.success(), "{end:?}: {}", stderr(&output));
        output.status.signal().is_some()
    }

    fn run(&self, store: &str, more: &[&str]) -> Result<(), String> {
        let at = format!("store={store}");
        let args: Vec<&str> = ["run", "spec.toml", "--quiet", "--set", &at].iter().chain(more).copied().collect();
        let output = self.bench.magline(&args);
        if output.status.success() { Ok(()) } else { Err(format!("the run said: {}", stderr(&output))) }
    }

    fn verified(&self, store: &str) -> Result<(), String> {
        let output = self.bench.magline(&["verify", "--store", store]);
        if output.status.success() { Ok(()) } else { Err(format!("verify said: {}", stderr(&output))) }
    }

    fn dropped(&self, store: &str) -> Result<(), String> {
        let output = self.bench.magline(&["gc", "--yes", "--store", store]);
        if output.status.success() { Ok(()) } else { Err(format!("gc said: {}", stderr(&output))) }
    }

    /// Answer to [`QUESTION`], or the error message.
    fn ask(&self, store: &str) -> Result<String, String> {
        let output = self.bench.magline(&["sql", "--store", store, "--format", "csv", QUESTION]);
        if output.status.success() { Ok(stdout(&output)) } else { Err(stderr(&output)) }
    }

    fn files(&self, store: &str) -> Files {
        if self.folder.join(store).join("tables").is_dir() { self.bench.tables(store) } else { Files::new() }
    }

    fn shown(&self, store: &str) -> Shown {
        Shown { files: self.files(store), answer: self.ask(store).unwrap() }
    }

    /// Checks the published files after a loss: there are none, or they equal one item of `wholes`.
    fn is_one_of(&self, store: &str, wholes: &[&Shown]) -> Result<(), String> {
        let (files, answer) = (self.files(store), self.ask(store));
        if files.is_empty() {
            return answer.map_or(Ok(()), |answer| Err(format!("an answer from no tables:\n{answer}")));
        }
        let whole = wholes.iter().find(|w| w.files == files).ok_or("the tables are of no version")?;
        match answer {
            Ok(answer) if answer == whole.answer => Ok(()),
            Ok(answer) => Err(format!("another answer:\n{answer}")),
            // Passthrough columns are read from packs. Packs of the previous version may be gone.
            Err(message) => Err(format!("no answer: {message}")),
        }
    }

    /// Asserts after a loss that no partial data is readable and that one run completes the store.
    fn resumes(&self, store: &str, more: &[&str], wholes: &[&Shown], end: &Shown) -> Result<(), String> {
        self.is_one_of(store, wholes)?;
        self.run(store, more)?;
        if self.files(store) != end.files {
            return Err("the next run publishes something else".to_owned());
        }
        self.verified(store)
    }

    fn remove(&self, store: &str) {
        for name in [store.to_owned(), format!("{store}.kept")] {
            let _ = fs::remove_dir_all(self.folder.join(name));
        }
    }
}

/// Selected ends of a run with `points` points: every `step`-th point, with one kill in four, successive seeds, and
/// more ends near the last point. With `step` 1: all modes and seeds at every point.
fn ends(points: usize, step: usize, first: usize) -> Vec<End> {
    const SEEDS: usize = 4;
    if step == 1 {
        let at = |point| {
            let power = (0..SEEDS).map(move |seed| End { point, mode: "power", seed });
            power.chain([End { point, mode: "kill", seed: 0 }])
        };
        return (1..=points).flat_map(at).collect();
    }
    let one = |(i, point)| {
        let mode = if i % 4 == 3 { "kill" } else { "power" };
        End { point, mode, seed: i % (2 * SEEDS) }
    };
    // The last points follow the publication of the new version, which must stay complete.
    let last = [10, 7, 3]
        .into_iter()
        .flat_map(|back| (1..SEEDS).map(move |seed| End { point: points - back, mode: "power", seed: seed + back }));
    (first..=points).step_by(step).enumerate().map(one).chain(last).collect()
}

fn none_of(faults: Vec<String>) {
    assert!(faults.is_empty(), "{} went wrong:\n{}", faults.len(), faults.join("\n"));
}

/// Ends first runs in new stores.
fn end_first_runs(step: usize) {
    let scene = Scene::new();
    let points = scene.points("whole", &[]);
    assert!(points > 30, "only {points} points");
    let whole = scene.shown("whole");
    let mut faults = vec![];
    for end in ends(points, step, 3) {
        scene.remove("store");
        // The order of the points varies between runs; their number does not.
        assert!(scene.dies("store", &[], end), "{end:?}: it came to its end");
        if let Err(fault) = scene.resumes("store", &[], &[&whole], &whole) {
            faults.push(format!("{end:?}: {fault}"));
        }
    }
    none_of(faults);
}

/// Ends runs that change the published tables.
fn end_second_runs(step: usize) {
    let scene = Scene::new();
    scene.points("whole", &[]);
    let old = scene.shown("whole");
    let points = scene.points("whole", &CHANGED);
    let new = scene.shown("whole");
    assert!(old != new);
    let mut faults = vec![];
    for end in ends(points, step, 2) {
        scene.remove("store");
        scene.run("store", &[]).unwrap();
        assert!(scene.dies("store", &CHANGED, end), "{end:?}: it came to its end");
        if let Err(fault) = scene.resumes("store", &CHANGED, &[&old, &new], &new) {
            faults.push(format!("{end:?}: {fault}"));
        }
    }
    none_of(faults);
}

#[test]
fn user_power_may_fail_at_any_moment() {
    end_first_runs(8);
}

#[test]
fn user_power_may_fail_while_tables_change() {
    end_second_runs(7);
}

/// Ends a run before the first fsync, when nothing is on the disk.
#[test]
fn unit_the_shim_drops_unsynced_data() {
    let scene = Scene::new();
    let of = |store: &str, mode| {
        assert!(scene.dies(store, &[], End { point: 1, mode, seed: 0 }));
        fs::read_dir(scene.folder.join(store)).unwrap().count()
    };
    assert!(of("killed", "kill") > 5);
    assert_eq!(of("lost", "power"), 0);
    scene.run("killed", &[]).unwrap();
    scene.run("lost", &[]).unwrap();
    assert!(scene.files("killed") == scene.files("lost"));
}

/// Takes several minutes.
#[test]
#[ignore = "the same at every single moment"]
fn user_power_may_fail_at_every_moment() {
    end_first_runs(1);
    end_second_runs(1);
}

/// Files below `folder` whose path ends with `end`, in order.
fn found(folder: &Path, end: &str) -> Vec<PathBuf> {
    let mut entries: Vec<_> = fs::read_dir(folder).into_iter().flatten().flatten().collect();
    entries.sort_by_key(fs::DirEntry::file_name);
    let below = entries
        .into_iter()
        .flat_map(|e| if e.file_type().unwrap().is_dir() { found(&e.path(), end) } else { vec![e.path()] });
    below.filter(|p| p.to_string_lossy().ends_with(end)).collect()
}

/// Flips one bit of a file in place.
fn flip(path: &Path, random: u64, keep_time: bool) -> String {
    let about = fs::metadata(path).unwrap();
    let at = random / 8 % about.len();
    let mut file = File::options().read(true).write(true).open(path).unwrap();
    let mut byte = [0];
    file.seek(SeekFrom::Start(at)).unwrap();
    file.read_exact(&mut byte).unwrap();
    byte[0] ^= 1 << (random % 8);
    file.seek(SeekFrom::Start(at)).unwrap();
    file.write_all(&byte).unwrap();
    if keep_time {
        file.set_modified(about.modified().unwrap()).unwrap();
    }
    format!("{} bit {} of byte {at}, time {}", path.display(), random % 8, if keep_time { "kept" } else { "new" })
}

/// Flips bits in files of every kind and repairs the store each time.
fn flip_bits(positions: u64) {
    let scene = Scene::new();
    let fresh = || {
        scene.remove("store");
        scene.run("store", &[]).unwrap();
        scene.run("store", &[]).unwrap();
    };
    fresh();
    let whole = scene.shown("store");
    let store = scene.folder.join("store");
    let version = || {
        let newest = fs::read_link(store.join("tables/small")).unwrap();
        store.join("tables").join(newest.parent().unwrap())
    };
    let kinds: [(&str, &dyn Fn() -> Vec<PathBuf>); 13] = [
        ("pack", &|| found(&store.join("objects"), ".parquet")),
        ("index", &|| vec![store.join("index")]),
        ("sources json", &|| found(&store.join("sources"), ".json")),
        ("sources seen", &|| found(&store.join("sources"), ".seen")),
        ("version", &|| found(&version(), "version.json")),
        ("units", &|| found(&version().join("units"), ".parquet")),
        ("even", &|| found(&version().join("tables/even"), ".parquet")),
        ("clean", &|| found(&version().join("tables/clean"), ".parquet")),
        ("warnings", &|| found(&version().join("tables/warnings"), ".parquet")),
        ("plan", &|| found(&store.join("plans"), ".json")),
        ("run", &|| found(&store.join("runs"), ".json")),
        ("runs", &|| found(&store.join("runs"), ".jsonl")),
        ("mark", &|| vec![store.join("STORE")]),
    ];
    let mut faults = vec![];
    let mut random = 0x9E37_79B9_7F4A_7C15_u64;
    let mut next = || {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random >> 8
    };
    for (kind, files) in kinds {
        for position in 0..positions {
            for keep_time in [false, true] {
                let files = files();
                let file = &files[usize::try_from(next()).unwrap() % files.len()];
                let what = format!("{kind} {position}: {}", flip(file, next(), keep_time));
                if let Err(fault) = repairs_damage(&scene, &whole) {
                    faults.push(format!("{what}: {fault}"));
                    fresh();
                }
            }
        }
    }
    none_of(faults);
}

/// Asserts that a damaged store gives the correct answer or an error, and that two runs repair it.
fn repairs_damage(scene: &Scene, whole: &Shown) -> Result<(), String> {
    // True if the query succeeds.
    let asked = || match scene.ask("store") {
        Ok(answer) if answer != whole.answer => Err(format!("another answer:\n{answer}")),
        other => Ok(other.is_ok()),
    };
    asked()?;
    let first = scene.run("store", &[]);
    // Older versions stay damaged until `gc` removes them.
    scene.dropped("store")?;
    // Only `verify` checks files that neither a run nor a query reads, and whose size and time are unchanged.
    if first.is_err() || !asked()? || scene.verified("store").is_err() {
        scene.run("store", &[])?;
        scene.dropped("store")?;
    }
    if !asked()? || scene.files("store") != whole.files {
        return Err("two runs do not make it whole".to_owned());
    }
    scene.verified("store")
}

#[test]
fn user_a_flipped_bit_is_found_and_repaired() {
    flip_bits(1);
}

/// Takes several minutes.
#[test]
#[ignore = "the same with many bits"]
fn user_many_flipped_bits_are_found_and_repaired() {
    flip_bits(12);
}
