//! Stores and published sets from elsewhere: damage, links, special files.

use super::*;

#[test]
fn user_sets_with_special_files_verify_at_once() {
    let bench = ran();
    assert!(publish(&bench, &["scores", "coefficients"], "set").status.success());
    let files = ["data/scores/part-0.parquet", "README.md", "SHA256SUMS", "dictionary.json", "pipeline/lock.json"];
    let pipe = |at: &Path| assert!(Command::new("mkfifo").arg(at).status().unwrap().success());
    let device = |at: &Path| symlink("/dev/zero", at).unwrap();
    let sparse = |at: &Path| fs::File::create(at).unwrap().set_len(1 << 40).unwrap();
    let socket = |at: &Path| drop(std::os::unix::net::UnixListener::bind(at).unwrap());
    type Make = dyn Fn(&Path);
    let kinds: [(&str, &Make); 4] = [("pipe", &pipe), ("device", &device), ("sparse", &sparse), ("socket", &socket)];
    for (kind, make) in kinds {
        for file in files {
            let copy = bench.path("copy");
            let copied = Command::new("cp").args(["-r", "set", "copy"]).current_dir(bench.folder.path()).status();
            assert!(copied.unwrap().success());
            fs::remove_file(copy.join(file)).unwrap();
            // The name of a socket is limited to 108 bytes.
            if kind == "socket" && copy.join(file).as_os_str().len() > 100 {
                fs::remove_dir_all(&copy).unwrap();
                continue;
            }
            make(&copy.join(file));
            let begun = Instant::now();
            let output = Command::new("timeout")
                .args(["20", env!("CARGO_BIN_EXE_magline"), "verify", "copy"])
                .current_dir(bench.folder.path())
                .output()
                .unwrap();
            assert!(begun.elapsed() < Duration::from_secs(10), "{kind} {file}");
            assert_eq!(output.status.code(), Some(1), "{kind} {file}: {}", stderr(&output));
            assert!(stderr(&output).contains(file), "{kind} {file}: {}", stderr(&output));
            fs::remove_dir_all(&copy).unwrap();
        }
    }
}

#[test]
fn user_each_damaged_file_of_a_store_is_reported() {
    let bench = ran();
    let verify = || bench.magline(&["verify", "--store", "store"]);
    assert!(verify().status.success(), "{}", stderr(&verify()));
    let mut files = vec![];
    let mut waiting = vec![bench.path("store")];
    while let Some(folder) = waiting.pop() {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            let kind = entry.file_type().unwrap();
            if kind.is_dir() {
                waiting.push(entry.path());
            } else if kind.is_file() && entry.metadata().unwrap().len() > 0 {
                files.push(entry.path());
            }
        }
    }
    for part in ["STORE", "index", "objects", "sources", "quality", "versions", "plans", "runs", "costs", "locks"] {
        assert!(files.iter().any(|f| f.starts_with(bench.path("store").join(part))), "{part}");
    }
    files.sort();
    // Packs have several names; each pack is damaged through one of them.
    files.retain(|f| !f.starts_with(bench.path("store/versions")) || !f.to_string_lossy().contains("part-"));
    for (i, file) in files.iter().enumerate() {
        let whole = fs::read(file).unwrap();
        let modified = fs::metadata(file).unwrap().modified().unwrap();
        let mut damaged = whole.clone();
        let at = (i * 7919 + 13) % whole.len();
        damaged[at] ^= 1 << (i % 7);
        let put = |bytes: &[u8]| {
            // Packs have several hard links, so their bytes are changed in place.
            fs::write(file, bytes).unwrap();
            fs::File::options().append(true).open(file).unwrap().set_modified(modified).unwrap();
        };
        put(&damaged);
        let output = verify();
        assert_eq!(output.status.code(), Some(1), "{} byte {at}: {}", file.display(), stdout(&output));
        // Files that were moved aside or rewritten are restored.
        fs::remove_file(file).ok();
        let aside = bench.path("store/damaged").join(file.file_name().unwrap());
        if aside.exists() {
            fs::rename(&aside, file).unwrap();
        }
        put(&whole);
    }
    assert!(verify().status.success(), "{}", stderr(&verify()));
    fs::remove_file(bench.path("store/locks/small.lock")).unwrap();
    assert!(Command::new("mkfifo").arg(bench.path("store/locks/small.lock")).status().unwrap().success());
    assert!(fs::metadata(bench.path("store/locks/small.lock")).unwrap().file_type().is_fifo());
    assert_eq!(verify().status.code(), Some(1));
}

/// Hash of a record in the format of a store.
fn sum(parts: &[u8]) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(parts.len() as u64).to_le_bytes());
    hasher.update(parts);
    hasher.finalize().as_bytes()[..16].iter().map(|b| format!("{b:02x}")).collect()
}

#[test]
fn user_a_manifest_cannot_name_files_elsewhere() {
    let bench = ran();
    let secret = bench.path("secret");
    assert!(
        Command::new("cp").args(["-a", "store", "secret"]).current_dir(bench.folder.path()).status().unwrap().success()
    );
    let file = bench.path("store/versions/small/1/version.json");
    let text = fs::read_to_string(&file).unwrap();
    let signed = |text: &str| {
        let at = text.rfind("\"sum\":\"").unwrap() + 7;
        let bare = format!("{}{}", &text[..at], &text[at + 32..]);
        format!("{}{}{}", &text[..at], sum(bare.as_bytes()), &text[at + 32..])
    };
    assert_eq!(signed(&text), text, "the checksum of this test is that of the store");
    let read = || bench.magline(&["sql", "SELECT count(*) FROM small.scores", "--format", "csv"]);
    assert!(read().status.success());
    let at = text.find("tables/scores/").unwrap();
    let name = &text[at..at + text[at..].find('"').unwrap()];
    let other = fs::read_dir(secret.join("tables/small/coefficients")).unwrap().flatten().next().unwrap().path();
    let elsewhere = other.display().to_string();
    let up = format!("../../../../secret/tables/small/coefficients/{}", other.file_name().unwrap().to_string_lossy());
    for wrong in [
        elsewhere.as_str(),
        up.as_str(),
        "tables/scores/../../../../../../secret/STORE",
        "STORE",
        "tables/scores/a\\\\b",
    ] {
        fs::write(&file, signed(&text.replace(name, wrong))).unwrap();
        assert_ne!(read().status.code(), Some(0), "{wrong}: {}", stdout(&read()));
        assert_eq!(bench.magline(&["verify", "--store", "store"]).status.code(), Some(1), "{wrong}");
    }
    for wrong in ["../../x", "/tmp/x", "CON", "a b"] {
        fs::write(&file, signed(&text.replace("\"name\":\"scores\"", &format!("\"name\":\"{wrong}\"")))).unwrap();
        assert_ne!(read().status.code(), Some(0), "{wrong}: {}", stdout(&read()));
        assert!(bench.magline(&["ls"]).status.code() != Some(101), "{wrong}");
    }
    fs::write(&file, &text).unwrap();
    assert!(read().status.success());
    // Links in place of a file, a table's folder and a version.
    for part in [name, "tables/scores", ""] {
        let at = bench.path("store/versions/small/1").join(part);
        let at = PathBuf::from(at.to_string_lossy().trim_end_matches('/').to_owned());
        let aside = bench.path("aside");
        fs::rename(&at, &aside).unwrap();
        symlink(&aside, &at).unwrap();
        assert_ne!(read().status.code(), Some(0), "{part}: {}", stdout(&read()));
        fs::remove_file(&at).unwrap();
        fs::rename(&aside, &at).unwrap();
    }
    assert!(read().status.success());
}

#[test]
fn user_a_file_size_limit_is_reported_as_an_error() {
    let bench = Bench::new();
    bench.spec(SPEC);
    let run = format!("ulimit -f 20; exec '{}' run spec.toml -q", env!("CARGO_BIN_EXE_magline"));
    let output = Command::new("sh").args(["-c", &run]).current_dir(bench.folder.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{:?} {}", output.status, stderr(&output));
    assert!(stderr(&output).contains("File too large"), "{}", stderr(&output));
}

#[test]
fn user_a_read_only_store_can_be_listed_queried_and_verified() {
    let bench = ran();
    // Root ignores permissions, so a file in place of the folder prevents writing.
    fs::remove_dir_all(bench.path("store/tmp")).unwrap();
    fs::write(bench.path("store/tmp"), "").unwrap();
    for command in [
        &["ls"][..],
        &["runs"],
        &["sql", "SELECT count(*) FROM small.scores"],
        &["lineage", "small.scores"],
        &["verify"],
    ] {
        let output = bench.magline(command);
        assert!(output.status.success(), "{command:?}: {}", stderr(&output));
    }
}

/// Files below a folder with their contents.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = vec![];
    for entry in fs::read_dir(folder).unwrap().flatten() {
        if entry.file_type().unwrap().is_dir() {
            found.extend(contents(&entry.path()));
        } else if entry.file_type().unwrap().is_file() {
            found.push((entry.path(), fs::read(entry.path()).unwrap()));
        }
    }
    found.sort();
    found
}

#[test]
fn user_targets_of_links_in_a_store_are_neither_written_nor_removed() {
    let bench = ran();
    let home = bench.path("home");
    for (name, text) in [("diary", "dear"), ("empty", ""), ("docs/letter", "sir"), ("2024/tax", "much")] {
        fs::create_dir_all(home.join(name).parent().unwrap()).unwrap();
        fs::write(home.join(name), text).unwrap();
    }
    let before = contents(&home);
    let old = |path: &str| {
        let args = ["-h", "-d", "2020-01-01", path];
        assert!(Command::new("touch").args(args).current_dir(bench.folder.path()).status().unwrap().success());
    };
    old("home/docs");
    old("home/2024");
    // Position of the link, target of the link, and whether a run succeeds.
    for (at, target, runs) in [
        ("damaged", "home", false),
        ("tmp", "home", false),
        ("objects", "home", false),
        ("locks/store", "home/diary", false),
        ("locks/small.lock", "home/diary", false),
        ("runs/small.jsonl", "home/empty", false),
        ("runs/small.jsonl", "home/diary", false),
        ("tmp/host-1-1", "home", true),
        ("tmp/host-1-1", "home/docs", true),
        ("versions/other", "home", true),
        ("versions/small", "home", false),
        ("versions/small/2024", "home/2024", true),
    ] {
        let (place, aside) = (bench.path("store").join(at), bench.path("aside"));
        let there = fs::rename(&place, &aside).is_ok();
        symlink(bench.path(target), &place).unwrap();
        old(&format!("store/{at}"));
        let run = bench.magline(&["run", "spec.toml", "-q", "--set", "seed=2"]);
        assert_eq!(run.status.success(), runs, "{at}: {}", stderr(&run));
        assert!(runs || stderr(&run).contains("link"), "{at}: {}", stderr(&run));
        for args in [&["gc", "--yes"][..], &["verify"], &["rm", "small.warnings"]] {
            assert_ne!(bench.magline(args).status.code(), Some(101), "{at}: {args:?}");
        }
        assert_eq!(contents(&home), before, "{at} -> {target}");
        let copied = contents(&bench.path("store")).into_iter().any(|(_, bytes)| bytes == b"dear" || bytes == b"much");
        assert!(!copied, "{at} -> {target}");
        let _ = fs::remove_file(&place);
        if there {
            fs::rename(&aside, &place).unwrap();
        }
    }
    let run = bench.magline(&["run", "spec.toml", "-q"]);
    assert!(run.status.success(), "{}", stderr(&run));
}

#[test]
fn user_pipes_in_a_store_block_no_command() {
    let bench = ran();
    for at in ["STORE", "index", "runs/small.jsonl", "plans/small.json", "locks/store", "locks/small.lock"] {
        let (place, aside) = (bench.path("store").join(at), bench.path("aside"));
        fs::rename(&place, &aside).unwrap();
        assert!(Command::new("mkfifo").arg(&place).status().unwrap().success());
        for args in [&["ls"][..], &["runs"], &["lineage", "small.scores"], &["verify"], &["gc"], &["run", "spec.toml"]]
        {
            let output = Command::new("timeout")
                .args(["60", env!("CARGO_BIN_EXE_magline")])
                .args(args)
                .current_dir(bench.folder.path())
                .output()
                .unwrap();
            let code = output.status.code();
            assert!(code.is_some_and(|code| code < 3), "{at}: {args:?} {code:?} {}", stderr(&output));
        }
        fs::remove_file(&place).unwrap();
        fs::rename(&aside, &place).unwrap();
    }
}

#[test]
fn user_names_in_a_set_cannot_read_other_files_or_forge_output_lines() {
    let bench = ran();
    let published = bench.magline(&["publish", "spec.toml", "scores", "--to", "set"]);
    assert!(published.status.success(), "{}", stderr(&published));
    // The schema file of a table has the name of the table.
    fs::write(bench.path("private.json"), "a password\n").unwrap();
    let dictionary = bench.path("set/dictionary.json");
    let text = fs::read_to_string(&dictionary).unwrap();
    fs::write(&dictionary, text.replace("\"name\": \"scores\"", "\"name\": \"../../private\"")).unwrap();
    let verified = bench.magline(&["verify", "set"]);
    assert_eq!(verified.status.code(), Some(1));
    assert!(stderr(&verified).contains("leads outside the folder"), "{}", stderr(&verified));
    assert!(!stderr(&verified).contains("password"), "{}", stderr(&verified));
    fs::write(&dictionary, text).unwrap();
    fs::write(bench.path("set/data/a\n12 files: all verified"), "x").unwrap();
    let verified = bench.magline(&["verify", "set"]);
    assert_eq!(verified.status.code(), Some(1));
    assert!(!stderr(&verified).lines().any(|line| line.starts_with("12 files")), "{}", stderr(&verified));
}
