//! A run that is killed at any moment leaves nothing half-written, and resumes.

use std::{
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use crate::support::{Bench, read};

/// Ends runs at many moments, resumes the last run, and expects the tables of an undisturbed run.
pub fn same_after(bench: &Bench, end: impl Fn(&mut Child)) {
    let started = Instant::now();
    assert_eq!(bench.run(&["--set", "store=whole"]).code, 0);
    let mut longest = started.elapsed() / 2;
    let whole = bench.tables("whole");
    const KILLS: u32 = 12;
    let mut died = 0;
    for i in 1..=KILLS {
        let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
            .args(["run", "spec.toml", "--json", "--set", "store=killed"])
            .current_dir(bench.folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        sleep(longest * i / KILLS);
        end(&mut child);
        let finished = child.wait().unwrap().success();
        died += u32::from(!finished);
        // Every file with a final name is readable.
        for table in ["even", "terms", "clean", "track", "scores"] {
            let folder = bench.path("killed/tables/small").join(table);
            if folder.exists() {
                read(&folder);
            }
        }
        // A run that was faster than its end leaves no work for the next.
        if finished {
            std::fs::remove_dir_all(bench.path("killed")).unwrap();
            longest /= 2;
        }
    }
    assert!(died >= KILLS / 3, "only {died} of {KILLS} were killed at work");
    let done = bench.run(&["--set", "store=killed"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let killed = bench.tables("killed");
    assert_eq!(whole.keys().collect::<Vec<_>>(), killed.keys().collect::<Vec<_>>());
    for (name, bytes) in &whole {
        assert!(killed[name] == *bytes, "{name} differs");
    }
    let left: Vec<_> = std::fs::read_dir(bench.path("killed/tmp")).unwrap().flatten().collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn user_runs_killed_at_many_moments_resume_to_the_same_bytes() {
    // SIGKILL: no handler runs.
    same_after(&Bench::new(), |child| child.kill().unwrap());
}

#[test]
fn user_runs_interrupted_at_many_moments_resume_to_the_same_bytes() {
    let interrupt = |child: &mut Child| {
        Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    };
    // Tables of several files, of which an interrupt omits some lines.
    same_after(&Bench::of_many_lines(), interrupt);
}

#[test]
fn user_an_interrupt_keeps_finished_results() {
    let bench = Bench::new();
    let child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["run", "spec.toml", "--threads", "1", "--set", "store=store"])
        .current_dir(bench.folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let started = Instant::now();
    while !bench.path("store/objects").is_dir() && started.elapsed() < Duration::from_secs(20) {
        sleep(Duration::from_millis(2));
    }
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stderr).contains("again to resume"));
    assert_eq!(bench.run(&[]).code, 0);
}
