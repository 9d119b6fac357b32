//! Lines of a log: from a table of times, detected along the track, shown and used. Quality of a log in the report.

use std::{collections::BTreeMap, fs, path::Path};

use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use tempfile::TempDir;

use crate::{
    ingest::{bench, file, files, sample},
    support::{Bench, line_of, magline, numbers, read, stderr, stdout, texts, write},
};

#[test]
fn user_lines_are_divided_by_a_table_of_times() {
    let bench = Bench::new();
    write(&bench.path("flown.parquet"), &[line_of("1", "1.01", 700)]);
    let tt = numbers(&file(&bench.path("flown.parquet")), "tt");
    let spec = "name = \"small\"\nstore = \"store\"\n[tables.flights]\npath = \"flown.parquet\"\n\
                lines = \"lines.csv\"\n\
                [[stages]]\nname = \"made\"\nstage = \"derive\"\ninput = \"flights\"\n\
                columns = { x = \"mag_4_uc - mag_5_uc\" }\n";
    bench.spec(spec);
    let table = |rows: &str| fs::write(bench.path("lines.csv"), format!("flight,line,t_start,t_end\n{rows}")).unwrap();
    let lines = || {
        let made = read(&bench.path("store/tables/small/made"));
        texts(&made, "line").into_iter().fold(BTreeMap::<String, usize>::new(), |mut counts, line| {
            *counts.entry(line).or_default() += 1;
            counts
        })
    };
    table(&format!("Flt1,out,{},{}\n1,home,{},{}\n", tt[10], tt[99], tt[200], tt[249]));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!(lines(), BTreeMap::from([("out".to_owned(), 90), ("home".to_owned(), 50)]));
    // The table of times is part of the key.
    table(&format!("1,out,{},{}\n", tt[10], tt[19]));
    assert_eq!(bench.run(&[]).code, 0);
    assert_eq!(lines(), BTreeMap::from([("out".to_owned(), 10)]));
    for (rows, expected) in [
        (format!("1,out,{},{}\n", 1000.0 * tt[10], 1000.0 * tt[19]), "no sample is within a line of"),
        (format!("1,out,{},{}\n1,far,900000,900001\n", tt[10], tt[19]), "within the times of 1/far"),
        (format!("1,out,{},{}\n1,in,{},{}\n", tt[10], tt[19], tt[15], tt[30]), "overlap"),
    ] {
        table(&rows);
        let run = bench.magline(&["run", "spec.toml"]);
        assert_eq!(run.status.code(), Some(2), "{}", stdout(&run));
        assert!(stderr(&run).contains(expected) && stderr(&run).contains("lines.csv"), "{}", stderr(&run));
    }
}

/// Simulated flight of a calibration box and three survey lines, with the line names `a` and `b`.
fn simulated(folder: &Path) {
    let map = sample("osborne/osborne_anomaly_100m_at_500m.tif");
    let text = format!(
        "seed = 3\nyear = 2020\ndoy = 185\n[map]\npath = '{map}'\n[[magnetometers]]\nname = 'mag_2_uc'\n[[flights]]\n\
         name = '7'\n\
         start_tt_s = 40000.0\n[[flights.lines]]\nname = 'a'\nkind = 'box'\nalt_m = 600.0\nstart = [-22.0, 140.6]\n\
         [[flights.lines]]\nname = 'b'\nkind = 'free'\nalt_m = 600.0\n\
         waypoints = [[-22.0, 140.6], [-21.95, 140.6], [-21.95, 140.65], [-22.0, 140.65]]\n"
    );
    fs::write(folder.join("s.synth.toml"), text).unwrap();
    let output = magline(folder, &["synth", "s.synth.toml", "--to", "flown"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[test]
fn user_lines_are_found_shown_edited_and_used() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    simulated(at);
    let run = |args: &[&str], code: i32| {
        let output = magline(at, args);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {}", stderr(&output));
        (stdout(&output), stderr(&output))
    };
    // Detection without an output folder.
    let look = ["ingest", "flown/7.parquet", "--lines", "auto", "--picture", "look.svg", "--write-lines", "lines.csv"];
    let (printed, _) = run(&look, 0);
    for word in ["box1", "line3", "40000.0", "look.svg", "lines.csv"] {
        assert!(printed.contains(word), "no {word} in {printed}");
    }
    let picture = fs::read_to_string(at.join("look.svg")).unwrap();
    assert!(
        picture.starts_with("<?xml") && picture.matches("box1").count() == 2 && picture.contains("calibration box")
    );
    let found = fs::read_to_string(at.join("lines.csv")).unwrap();
    assert_eq!(found.lines().count(), 5, "{found}");
    assert!(found.starts_with("flight,line,t_start,t_end,kind,") && found.contains("\n7,box1,40000.0,"), "{found}");
    assert!(found.contains(",roll pitch yaw"), "{found}");

    // Detected lines, their table, the spec and the ingested file give the same result.
    run(&["ingest", "flown/7.parquet", "--lines", "auto", "--to", "auto", "--picture", "auto.png"], 0);
    assert_eq!(fs::read_to_string(at.join("auto/_lines/7.csv")).unwrap(), found);
    assert!(fs::read(at.join("auto.png")).unwrap().starts_with(b"\x89PNG"));
    run(&["ingest", "flown/7.parquet", "--lines", "lines.csv", "--to", "table"], 0);
    let spec = |path: &str, lines: &str| {
        format!(
            "name = 'small'\nstore = 'store'\n[tables.flights]\npath = '{path}'\n{lines}\n[[stages]]\nname = 'even'\n\
             stage = 'resample'\n\
             input = 'flights'\nrate_hz = 5.0\n"
        )
    };
    let tables = |name: &str, text: String| {
        fs::write(at.join(format!("{name}.toml")), text).unwrap();
        run(&["run", &format!("{name}.toml"), "--set", &format!("store=s_{name}"), "-q"], 0);
        read(&at.join(format!("s_{name}/tables/small/even")))
    };
    let auto = tables("auto", spec("flown/7.parquet", "lines = 'auto'"));
    let counts = texts(&auto, "line").into_iter().fold(BTreeMap::<String, usize>::new(), |mut counts, line| {
        *counts.entry(line).or_default() += 1;
        counts
    });
    assert_eq!(counts.keys().map(String::as_str).collect::<Vec<_>>(), ["box1", "line1", "line2", "line3"]);
    for (name, text) in [
        ("table", spec("flown/7.parquet", "lines = 'lines.csv'")),
        ("in_auto", spec("auto", "")),
        ("in_table", spec("table", "")),
    ] {
        let same = tables(name, text);
        for column in ["tt", "mag_2_uc"] {
            assert_eq!(numbers(&same, column), numbers(&auto, column), "{name} {column}");
        }
        assert_eq!(texts(&same, "line"), texts(&auto, "line"), "{name}");
    }

    // An edited file is not replaced, and is used.
    let edited = found.lines().take(2).collect::<Vec<_>>().join("\n").replace("box1", "first") + "\n";
    fs::write(at.join("lines.csv"), &edited).unwrap();
    assert!(run(&look, 2).1.contains("already contains other lines"));
    assert_eq!(fs::read_to_string(at.join("lines.csv")).unwrap(), edited);
    let args = ["ingest", "flown/7.parquet", "--lines", "lines.csv", "--to", "edited", "--picture", "edited.svg"];
    assert!(run(&args, 0).1.contains("edited.svg"));
    assert!(fs::read_to_string(at.join("edited.svg")).unwrap().contains("first"));
    assert!(file(&at.join("edited/7.parquet")).iter().all(|b| texts(std::slice::from_ref(b), "line")[0] == "first"));
    run(&[&look[..], &["--replace"]].concat(), 0);
    assert_eq!(fs::read_to_string(at.join("lines.csv")).unwrap(), found);
}

#[test]
fn user_unusable_lines_are_rejected_before_anything_is_written() {
    let folder = bench(600);
    let at = folder.path();
    let log = ["ingest", "log.csv", "--mapping", "m.toml", "--to", "out"];
    let refused = |more: &[&str], code: i32, words: &str| {
        let output = magline(at, &[&log[..], more].concat());
        assert_eq!(output.status.code(), Some(code), "{more:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(words), "{more:?}: {}", stderr(&output));
        assert!(!at.join("out").exists() || files(&at.join("out")).is_empty(), "{more:?}");
    };
    refused(&["--lines", "auto"], 2, "neither positions nor headings");
    refused(&["--lines", "gone.csv"], 2, "gone.csv");
    refused(&["--lines", "auto", "--picture", "lines.jpg"], 2, "use the extension .svg or .png");
    refused(&["--picture", "lines.svg"], 2, "--lines");
    fs::write(at.join("lines.csv"), "flight,line,t_start,t_end\nlog,far,1,2\n").unwrap();
    refused(&["--lines", "lines.csv"], 2, "no sample is within a line of");
    refused(&["--lines", "lines.csv", "--write-lines", "x.csv"], 2, "`--lines auto`");
    // A spec reports the same error at the position of the key.
    fs::write(
        at.join("spec.toml"),
        "name = 'small'\nstore = 'store'\n[tables.log]\npath = 'log.csv'\nmapping = 'm.toml'\nlines = 'auto'\n\
         [[stages]]\n\
         name = 'even'\nstage = 'resample'\ninput = 'log'\nrate_hz = 5.0\n",
    )
    .unwrap();
    let output = magline(at, &["run", "spec.toml"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("neither positions nor headings"), "{}", stderr(&output));
    // A line without samples is reported, and the others are written.
    fs::write(at.join("lines.csv"), "flight,line,t_start,t_end\nlog,one,43201,43230\nlog,far,1,2\n").unwrap();
    let output = magline(at, &[&log[..], &["--lines", "lines.csv"]].concat());
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("within the times of log/far"), "{}", stderr(&output));
    assert_eq!(texts(&file(&at.join("out/log.parquet")), "line").first().map(String::as_str), Some("one"));
}

#[test]
fn user_the_report_shows_the_quality_of_the_data() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let mut text = "flight,line,tt,mag_1_uc,mag_2_uc,cur_1\n".to_owned();
    for line in 1..=2 {
        for i in 0..3000_u32 {
            let tt = f64::from(line) * 1000.0 + f64::from(i) * 0.1 + if i >= 2000 { 7.0 } else { 0.0 };
            let noise = f64::from((i * 7919) % 101) * 0.001;
            let mag = if line == 2 && (500..620).contains(&i) { 50_000.0 } else { 50_000.0 + noise };
            let other = if (100..160).contains(&i) { "N/A".to_owned() } else { format!("{}", 51_000.0 + noise) };
            text += &format!("7,7.0{line},{tt},{mag},{other},{}\n", f64::from(i % 50) * 0.5);
        }
    }
    fs::write(at.join("a.csv"), text).unwrap();
    fs::write(
        at.join("spec.toml"),
        "name = 'small'\nstore = 'store'\n[tables.flights]\npath = 'a.csv'\n[[stages]]\nname = 'made'\n\
         stage = 'derive'\n\
         input = 'flights'\ncolumns = { x = \"mag_1_uc - mag_2_uc\" }\n",
    )
    .unwrap();
    assert_eq!(magline(at, &["run", "spec.toml", "-q"]).status.code(), Some(0));
    let page = || {
        let output = magline(at, &["report", "spec.toml", "-o", "report.html"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        fs::read_to_string(at.join("report.html")).unwrap()
    };
    let first = page();
    let section = first.split("id=\"quality\"").nth(1).unwrap().split("</section>").next().unwrap();
    for part in [
        // Two gaps of 7 s in one flight: total missing time.
        "! 2</td>",
        "! 14.00</td>",
        // 120 equal samples last 11.9 s.
        "! 120, 11.90 s</td>",
        // Two gaps of 60 missing values. Each lasts 6.1 s, from the last value before the gap to the first value after
        // it.
        "! 120, 6.100 s</td>",
        "Flight 7: flagged samples over time",
        "class=\"stuck\"",
        "class=\"missing\"",
        "class=\"gap\"",
    ] {
        assert!(section.contains(part), "no {part} in {section}");
    }
    // The worst line is first, and unremarkable lines are folded.
    let place = |word: &str| section.find(&format!("<td>{word}</td>")).unwrap();
    assert!(place("mag_1_uc") < place("cur_1") && section.find("not flagged").unwrap() < place("cur_1"));
    // The figures are stored; the log is not read again.
    assert_eq!(first, page());
}

#[test]
fn user_a_file_with_more_lines_than_parquet_row_groups_is_ingested() {
    let folder = TempDir::new().unwrap();
    let lines = 33_000;
    let text: String = (0..lines).map(|i| format!("1,{i},{i},50000\n")).collect();
    fs::write(folder.path().join("m.csv"), format!("flight,line,tt,mag_1_c\n{text}")).unwrap();
    let output = magline(folder.path(), &["ingest", "m.csv", "--to", "o"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let back = file(&folder.path().join("o/m.parquet"));
    let (names, tt) = (texts(&back, "line"), numbers(&back, "tt"));
    assert_eq!(names.len(), lines);
    assert!(names.iter().zip(&tt).all(|(name, tt)| *name == tt.to_string()));
    // Lines of 256 rows or more have a row group each.
    let long: String = (0..3).flat_map(|i| (0..300).map(move |k| format!("1,{i},{k},50000\n"))).collect();
    fs::write(folder.path().join("long.csv"), format!("flight,line,tt,mag_1_c\n{long}")).unwrap();
    let output = magline(folder.path(), &["ingest", "long.csv", "--to", "o"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let whole = fs::File::open(folder.path().join("o/long.parquet")).unwrap();
    let metadata = ParquetRecordBatchReaderBuilder::try_new(whole).unwrap().metadata().clone();
    assert_eq!(metadata.row_groups().iter().map(|g| g.num_rows()).collect::<Vec<_>>(), [300; 3]);
}
