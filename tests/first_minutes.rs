//! The commands of the first minutes: examples, checks of the installation, help for editors and shells.

use std::fs;

use crate::support::{magline, stderr, stdout};

#[test]
fn user_a_new_example_is_complete_and_runs() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let listed = stdout(&magline(folder, &["new"]));
    let names: Vec<&str> = listed.lines().filter_map(|line| line.split_once("  ")).map(|(name, _)| name).collect();
    assert!(names.contains(&"osborne") && names.len() > 5, "{listed}");
    for name in &names {
        let output = magline(folder, &["new", name]);
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(stdout(&output).ends_with(&format!("next: magline run {name}/{name}.toml\n")), "{}", stdout(&output));
        let output = magline(folder, &["check", &format!("{name}/{name}.toml")]);
        assert!(output.status.success(), "{name}: {}", stderr(&output));
    }
    let output = magline(folder, &["run", "tolles_lawson/tolles_lawson.toml", "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(folder.join("tolles_lawson/store/STORE").is_file());

    let output = magline(folder, &["new", "osborne"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("osborne exists and is not overwritten"), "{}", stderr(&output));
    let output = magline(folder, &["new", "osbourne"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("did you mean `osborne`"), "{}", stderr(&output));
    let output = magline(folder, &["new", "osborne", "deep/below/it s"]);
    assert!(stdout(&output).ends_with("next: magline run 'deep/below/it s/osborne.toml'\n"), "{}", stdout(&output));
    assert!(fs::read_dir(folder.join("deep/below")).unwrap().count() == 1, "no partial folder stays");
}

#[test]
fn user_doctor_reports_what_would_prevent_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let output = magline(folder, &["doctor"]);
    let text = stdout(&output);
    assert!(output.status.success(), "{text}{}", stderr(&output));
    for check in ["magline", "processor", "memory", "temporary files", "open files", "file size", "store"] {
        assert!(text.lines().any(|line| line.get(9..).is_some_and(|rest| rest.starts_with(check))), "{check}: {text}");
    }
    assert!(text.contains("none at store; the first run makes it"), "{text}");

    fs::write(folder.join("wrong.toml"), "[[stages]]\nname = \"a\"\nstage = \"resampel\"\n").unwrap();
    let output = magline(folder, &["doctor", "wrong.toml"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stdout(&output).contains("error    spec"), "{}", stdout(&output));
    assert!(stdout(&output).contains("resample"), "the nearest name: {}", stdout(&output));

    assert!(magline(folder, &["new", "tolles_lawson", "x"]).status.success());
    assert!(magline(folder, &["run", "x/tolles_lawson.toml", "--quiet"]).status.success());
    let output = magline(folder, &["doctor", "x/tolles_lawson.toml"]);
    assert!(output.status.success(), "{}", stdout(&output));
    // A store whose mark is damaged does not open.
    fs::write(folder.join("x/store/STORE"), "noise").unwrap();
    let output = magline(folder, &["doctor", "--store", "x/store"]);
    assert_eq!(output.status.code(), Some(1), "{}", stdout(&output));

    // A temporary folder that does not exist.
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_magline"))
        .arg("doctor")
        .env("TMPDIR", folder.join("absent"))
        .current_dir(folder)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(stdout(&output).contains("set TMPDIR"), "{}", stdout(&output));
}

#[test]
fn user_every_command_of_the_help_has_a_manual_page_and_completions() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let help = stdout(&magline(folder, &["--help"]));
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let names: Vec<&str> =
        commands.filter(|line| !line.starts_with("    ")).filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.contains(&"run") && names.len() > 20, "{help}");
    assert!(magline(folder, &["man", "--to", "pages"]).status.success());
    for name in names.iter().filter(|name| **name != "help") {
        let page = fs::read_to_string(folder.join(format!("pages/magline-{name}.1"))).unwrap();
        assert!(page.starts_with(".ie") && page.contains(".SH NAME"), "{name}");
        assert_eq!(stdout(&magline(folder, &["man", name])), page, "{name}");
        for shell in ["bash", "zsh", "fish"] {
            let script = stdout(&magline(folder, &["completions", shell]));
            assert!(script.contains(name), "{shell}: {name}");
        }
    }
    let hidden =
        fs::read_dir(folder.join("pages")).unwrap().flatten().any(|e| e.file_name() == "magline-answer-query.1");
    assert!(!hidden, "an internal command has no page");
    let output = magline(folder, &["man", "rnu"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("did you mean `run`"), "{}", stderr(&output));
}
