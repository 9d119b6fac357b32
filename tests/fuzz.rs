//! Mutated names, paths, specs, manifests, published sets and cluster plans: the validators of foreign data accept or
//! reject them, and accepted data stay in their folder.
//!
//! Each case is a function of its seed, so that a finding is repeated by its seed. A test runs a fixed number of cases.
//! The variable `MAGLINE_FUZZ_S` sets a time in seconds instead, and `MAGLINE_FUZZ_SEED` the first seed.

use std::{
    collections::BTreeMap,
    env, fs,
    os::unix::fs::symlink,
    path::{Component, Path},
    process::{Command, abort},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use pipeline::{
    plan::{Plan, spec::Spec},
    release,
    store::Version,
};
use serde_json::Value;

use crate::{
    security::{FACTS, publish, ran},
    support::{Bench, SPEC, repository},
};
use mutation::{PIECES, Random, mutated_json, mutated_text};

mod mutation;
#[cfg(feature = "cluster")]
mod plans;

/// Maximum processor time of a case when a time is set, in seconds.
const LONGEST_CPU_S: u64 = 10;
/// Maximum time of a case when a time is set.
const LONGEST_CASE: Duration = Duration::from_secs(1200);

/// Numbers of cases.
#[derive(Debug, Default)]
struct Tally {
    accepted: u64,
    rejected: u64,
    slowest_ms: u128,
}

/// Prints the seed of a case that panics.
struct Case<'a>(&'a str, u64);

impl Drop for Case<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            eprintln!("fuzz {}: seed {} failed", self.0, self.1);
        }
    }
}

/// Processor time of this process, in seconds.
fn cpu_s() -> u64 {
    let text = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = text.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |at: usize| fields.get(at).and_then(|n| n.parse::<u64>().ok()).unwrap_or(0);
    (ticks(11) + ticks(12)) / 100
}

/// Ends the process if a case takes too long.
fn watch(target: &'static str, seed: Arc<AtomicU64>) {
    thread::spawn(move || {
        let (mut last, mut begun, mut cpu) = (u64::MAX, Instant::now(), cpu_s());
        loop {
            thread::sleep(Duration::from_secs(1));
            let now = seed.load(Ordering::Relaxed);
            if now != last || now == u64::MAX {
                (last, begun, cpu) = (now, Instant::now(), cpu_s());
            } else if cpu_s() - cpu > LONGEST_CPU_S || begun.elapsed() > LONGEST_CASE {
                eprintln!("fuzz {target}: seed {now} takes {} s of processor time", cpu_s() - cpu);
                abort();
            }
        }
    });
}

/// Largest resident memory of this process, MB.
fn peak_mb() -> u64 {
    let text = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|kb| kb.trim().trim_end_matches(" kB").parse::<u64>().ok()).unwrap_or(0) / 1024
}

/// Runs `case` on `cases` seeds, or for the time in `MAGLINE_FUZZ_S`. `case` returns whether its input was accepted.
fn fuzz(target: &'static str, cases: u64, mut case: impl FnMut(&mut Random) -> bool) {
    let number = |name: &str| env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let limit = number("MAGLINE_FUZZ_S").map(Duration::from_secs);
    let first = number("MAGLINE_FUZZ_SEED").unwrap_or(0);
    let current = Arc::new(AtomicU64::new(u64::MAX));
    if limit.is_some() {
        watch(target, current.clone());
    }
    let (begun, mut tally, mut shown) = (Instant::now(), Tally::default(), Instant::now());
    let show = |seed: u64, tally: &Tally| {
        println!("fuzz {target}: {} s, next seed {seed}, {tally:?}, {} MB", begun.elapsed().as_secs(), peak_mb());
    };
    let mut seed = first;
    while limit.map_or(seed - first < cases, |limit| begun.elapsed() < limit) {
        let (guard, start) = (Case(target, seed), Instant::now());
        current.store(seed, Ordering::Relaxed);
        if case(&mut Random::new(seed)) {
            tally.accepted += 1;
        } else {
            tally.rejected += 1;
        }
        drop(guard);
        tally.slowest_ms = tally.slowest_ms.max(start.elapsed().as_millis());
        seed += 1;
        if limit.is_some() && shown.elapsed() > Duration::from_secs(30) {
            shown = Instant::now();
            show(seed, &tally);
        }
    }
    current.store(u64::MAX, Ordering::Relaxed);
    show(seed, &tally);
    assert!(tally.accepted > 0 && tally.rejected > 0, "{target}: the cases reach only one answer: {tally:?}");
}

/// Whether a path has a normal part and no other.
fn stays_inside(path: &str) -> bool {
    let parts: Vec<Component> = Path::new(path).components().collect();
    !parts.is_empty() && parts.iter().all(|part| matches!(part, Component::Normal(_)))
}

#[test]
fn user_mutated_names_and_paths_stay_in_their_folder() {
    let seeds = ["clean", "data/t/flight_id=flight-1/part-0.parquet", "tables/scores/part-00000-0a1b2c3d.parquet"];
    fuzz("names", 20_000, |random| {
        let text = if random.chance(2) {
            (0..random.below(7)).map(|_| *random.pick(&PIECES)).collect()
        } else {
            let seed = *random.pick(&seeds);
            String::from_utf8_lossy(&mutated_text(random, seed.as_bytes(), &seeds)).into_owned()
        };
        let (name, path) = (schemas::paths::check_name(&text), schemas::paths::check_path(&text));
        if name.is_ok() {
            assert!(stays_inside(&text) && !text.contains(['/', '\\', '.', ':', ' ']) && text.is_ascii(), "{text:?}");
        }
        if path.is_ok() {
            assert!(stays_inside(&text) && !text.contains(['\\', '\0', '\n']), "{text:?}");
            assert!(text.split('/').all(|part| stays_inside(part) && part.len() <= 255), "{text:?}");
        }
        let shown = schemas::visible(&text);
        assert!(!shown.contains(|c: char| c.is_control() && c != '\n' && c != '\t'), "{text:?}");
        assert!(!schemas::one_line(&text).contains(char::is_control), "{text:?}");
        name.is_ok() || path.is_ok()
    });
}

/// Whether planning a spec could read a folder outside that of the spec, which a spec may do.
fn names_other_folders(text: &str) -> bool {
    ["\"/", "'/", "..", "://", "*", "~"].iter().any(|part| text.contains(part))
}

#[test]
fn user_mutated_specs_are_planned_or_rejected() {
    let bench = Bench::new();
    let own = SPEC.to_owned() + FACTS;
    let mut donors = vec![own.clone()];
    for entry in fs::read_dir(repository().join("datasets/examples")).unwrap().flatten() {
        if entry.path().extension().is_some_and(|e| e == "toml") {
            donors.push(fs::read_to_string(entry.path()).unwrap());
        }
    }
    donors.sort();
    let donors: Vec<&str> = donors.iter().map(String::as_str).collect();
    let catalogue = pipeline::catalogue();
    fuzz("specs", 150, |random| {
        let base = if random.chance(3) { *random.pick(&donors) } else { own.as_str() };
        let text = String::from_utf8_lossy(&mutated_text(random, base.as_bytes(), &donors)).into_owned();
        let sets: Vec<String> = if random.chance(4) { vec![set_of(random)] } else { vec![] };
        let spec = match Spec::parse("spec.toml", bench.folder.path().to_owned(), text.clone(), &sets) {
            Ok(spec) => spec,
            Err(faults) => {
                assert!(!faults.faults.is_empty() && !faults.to_string().is_empty(), "{text}");
                return false;
            }
        };
        let names = spec.stages.iter().map(|s| &s.name).chain(spec.tables.iter().map(|t| &t.name));
        for name in names.chain([&spec.name]).chain(spec.axes.iter().map(|a| &a.name)) {
            assert!(stays_inside(name) && name.is_ascii() && !name.contains(['/', '\\', '.']), "{name:?}");
        }
        if names_other_folders(&text) || sets.iter().any(|set| names_other_folders(set)) {
            return true;
        }
        match Plan::new(spec, &catalogue) {
            Ok(_) => true,
            Err(faults) => {
                assert!(!faults.faults.is_empty() && !faults.to_string().is_empty(), "{text}");
                false
            }
        }
    });
}

/// Mutated argument of `--set`.
fn set_of(random: &mut Random) -> String {
    const SETS: [&str; 8] = [
        "axes.lambda=[0.0, 1.0]",
        "axes.mag=[\"mag_4_uc\"]",
        "even.rate_hz=5.0",
        "stages.track.filter=\"ekf\"",
        "tables.flights.path=\"flights/\"",
        "store=\"other\"",
        "seed=2",
        "publish.licence=\"MIT\"",
    ];
    let base = random.pick(&SETS).as_bytes();
    String::from_utf8_lossy(&mutated_text(random, base, &SETS)).into_owned()
}

/// Manifest with the checksum of its fields.
fn signed(text: &str) -> String {
    let Some(at) = text.rfind("\"sum\":\"").map(|at| at + 7) else { return text.to_owned() };
    let Some(end) = text[at..].find('"').map(|n| at + n) else { return text.to_owned() };
    let bare = format!("{}{}", &text[..at], &text[end..]);
    format!("{}{}{}", &text[..at], schemas::keys::HashKey::from_parts([bare.as_bytes()]), &text[end..])
}

#[test]
fn user_mutated_manifests_name_only_files_of_their_version() {
    let bench = ran();
    let folder = bench.path("store/versions/small/1");
    let file = folder.join("version.json");
    let text = fs::read_to_string(&file).unwrap();
    assert_eq!(signed(&text), text, "the checksum of this test is that of the store");
    let whole: Value = serde_json::from_str(&text).unwrap();
    fuzz("manifests", 400, |random| {
        let mut changed = whole.clone();
        (0..=random.below(3)).for_each(|_| mutated_json(random, &mut changed));
        let mut bytes = signed(&changed.to_string()).into_bytes();
        if random.chance(8) {
            bytes = mutated_text(random, &bytes, &[&text]);
        }
        fs::write(&file, &bytes).unwrap();
        let Some(version) = Version::open(&folder) else { return false };
        for table in &version.manifest.tables {
            assert!(stays_inside(&table.name) && !table.name.contains('/'), "{}", table.name);
            for listed in table.files.iter().chain(&table.units) {
                let start = listed.name.split('/').next().unwrap();
                assert!(stays_inside(&listed.name) && ["tables", "units"].contains(&start), "{}", listed.name);
            }
        }
        true
    });
}

/// Files of a folder by their paths below it.
fn files(root: &Path, below: &str, found: &mut BTreeMap<String, Vec<u8>>) {
    for entry in fs::read_dir(root.join(below)).unwrap().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = if below.is_empty() { name } else { format!("{below}/{name}") };
        if entry.path().is_dir() {
            files(root, &path, found);
        } else {
            found.insert(path, fs::read(entry.path()).unwrap());
        }
    }
}

const SUMS: &str = "SHA256SUMS";
const DICTIONARY: &str = "dictionary.json";

/// Mutates the file `name` of a set.
fn mutate_file(random: &mut Random, name: &str, bytes: &[u8], donors: &[&str]) -> Vec<u8> {
    match serde_json::from_slice::<Value>(bytes) {
        Ok(mut value) if !random.chance(4) => {
            mutated_json(random, &mut value);
            let text =
                if random.chance(2) { serde_json::to_string_pretty(&value) } else { serde_json::to_string(&value) };
            text.unwrap().into_bytes()
        }
        _ if name == SUMS && random.chance(2) => {
            let line =
                format!("{}  {}\n", "0".repeat(64), random.pick(&["../pipe", "/dev/zero", "a/../../pipe", "pipe"]));
            [bytes, line.as_bytes()].concat()
        }
        _ => mutated_text(random, bytes, donors),
    }
}

/// Gives the changed data file `name` its size and checksum in the dictionary.
fn described_anew(dictionary: &[u8], name: &str, bytes: &[u8]) -> Option<Vec<u8>> {
    let mut value: Value = serde_json::from_slice(dictionary).ok()?;
    let tables = value["tables"].as_array_mut()?;
    let file = tables.iter_mut().filter_map(|t| t["files"].as_array_mut()).flatten().find(|f| f["path"] == name)?;
    file["bytes"] = bytes.len().into();
    file["sha256"] = sha256(bytes).into();
    serde_json::to_vec_pretty(&value).ok()
}

fn sha256(bytes: &[u8]) -> String {
    use sha2::{Digest, Sha256};
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

#[test]
fn user_mutated_sets_are_verified_or_reported() {
    let bench = ran();
    assert!(publish(&bench, &["scores", "coefficients"], "set").status.success());
    assert!(Command::new("mkfifo").arg(bench.path("pipe")).status().unwrap().success());
    let set = bench.path("set");
    let mut whole = BTreeMap::new();
    files(&set, "", &mut whole);
    assert!(release::verify(&set).unwrap().faults.is_empty());
    let names: Vec<&String> = whole.keys().collect();
    fuzz("sets", 40, |random| {
        let mut changed: BTreeMap<String, Vec<u8>> = BTreeMap::new();
        // An unchanged set is accepted.
        let changes = if random.chance(8) { 0 } else { 1 + random.below(2) };
        for _ in 0..changes {
            let name = *random.pick(&names);
            let old = changed.get(name).unwrap_or(&whole[name]).clone();
            let new = mutate_file(random, name, &old, &["../pipe", "/dev/zero"]);
            if name.ends_with(".parquet") && random.chance(2) {
                let dictionary = changed.get(DICTIONARY).unwrap_or(&whole[DICTIONARY]);
                if let Some(text) = described_anew(dictionary, name, &new) {
                    changed.insert(DICTIONARY.to_owned(), text);
                }
            }
            changed.insert(name.clone(), new);
        }
        let consistent = random.chance(2) && !changed.contains_key(SUMS);
        if consistent {
            let now = |name: &String| changed.get(name).unwrap_or(&whole[name]);
            let listed = names.iter().filter(|name| **name != SUMS);
            let text: String = listed.map(|name| format!("{}  {name}\n", sha256(now(name)))).collect();
            changed.insert(SUMS.to_owned(), text.into_bytes());
        }
        let special = (changes > 0 && random.chance(16)).then(|| (*random.pick(&names)).clone());
        changed.iter().for_each(|(name, bytes)| fs::write(set.join(name), bytes).unwrap());
        if let Some(name) = &special {
            fs::remove_file(set.join(name)).unwrap();
            let target = random.pick(&["/dev/zero", "../pipe", "../../pipe", "/proc/self/mem"]);
            symlink(target, set.join(name)).unwrap();
        }
        let answer = release::verify(&set);
        if let Some(name) = special {
            fs::remove_file(set.join(&name)).unwrap();
            fs::write(set.join(&name), &whole[&name]).unwrap();
        }
        changed.keys().for_each(|name| fs::write(set.join(name), &whole[name]).unwrap());
        let clean = answer.is_ok_and(|found| found.faults.is_empty());
        let differs = changed.iter().any(|(name, bytes)| name != SUMS && *bytes != whole[name]);
        assert!(!clean || consistent || !differs, "a change of {:?} is not reported", changed.keys());
        assert!(clean || changes > 0, "an unchanged set is rejected");
        clean
    });
}
