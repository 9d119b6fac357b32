//! The page as a whole, made of the examples.

#![allow(clippy::unwrap_used)]

use plan::{Plan, read_spec};
use schemas::metric::Metric;
use stages::catalogue;

use super::*;

/// Metrics of the stage `score`.
pub(super) fn declared<const N: usize>(names: [&str; N]) -> [Metric; N] {
    names.map(|name| stages::score::metrics::SCORERS.iter().find(|s| s.metric.name == name).unwrap().metric)
}

/// Runs an example in a separate store with the assignments `ran`, and views it with the assignments `asked`.
fn looked_at<T>(
    example: &str,
    ran: &[&str],
    asked: &[&str],
    look: impl Fn(&PlanGraph, &Store) -> Result<T, Fault>,
) -> Result<T, Fault> {
    let store = tempfile::tempdir().unwrap();
    let place = format!("store={}", store.path().display());
    let plan = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(ToString::to_string).chain([place.clone()]).collect();
        let file = format!("../../datasets/examples/{example}.toml");
        Plan::new(read_spec(Path::new(&file), &sets).unwrap(), &catalogue()).unwrap()
    };
    let (first, second) = (plan(ran), plan(asked));
    let held = Store::open(store.path()).unwrap();
    run::run(&first, &held, run::RunOptions::default(), &run::SilentListener).unwrap();
    let graph = PlanGraph::new(&second, &held, &|_, _| ()).unwrap();
    look(&graph, &held)
}

/// The report on an example.
fn page(example: &str, ran: &[&str], asked: &[&str]) -> Result<String, Fault> {
    let (html, folder) =
        looked_at(example, ran, asked, |graph, store| Ok((report(graph, store)?, store.root().display().to_string())))?;
    assert!(!html.contains(&folder), "the page names a folder of this machine");
    assert_eq!(unclosed(&html), None);
    Ok(html)
}

/// The first tag that is not closed, or closed without having been opened.
fn unclosed(html: &str) -> Option<String> {
    const VOID: [&str; 4] = ["link", "meta", "wbr", "!DOCTYPE"];
    // The content of style and script elements is not markup.
    let bare = html.split("<style>").flat_map(|p| p.split("<script>"));
    let bare: String =
        bare.map(|p| p.split_once("</style>").or(p.split_once("</script>")).map_or(p, |x| x.1)).collect();
    let mut open: Vec<&str> = vec![];
    for tag in bare.split('<').skip(1).filter_map(|t| t.split_once('>')).map(|t| t.0) {
        let name = tag.split_whitespace().next().unwrap_or_default();
        match name.strip_prefix('/') {
            Some(name) if open.pop() != Some(name) => return Some(tag.to_owned()),
            Some(_) => {}
            None if VOID.contains(&name) => {}
            None => open.push(name),
        }
    }
    open.pop().map(str::to_owned)
}

#[test]
fn unit_the_same_data_give_the_same_bytes() {
    let html = page("tolles_lawson", &[], &[]).unwrap();
    assert_eq!(html, page("tolles_lawson", &[], &[]).unwrap());
    let vendored = SCRIPTS.iter().filter(|script| script.name.contains("vendor/"));
    let own = vendored.fold(html, |html, script| html.replace(script.text, ""));
    for address in ["http:", "https:", "file:", "//cdn"] {
        assert!(!own.contains(address), "the page asks for {address}");
    }
}

#[test]
fn unit_compensation_alone_has_no_map() {
    let html = page("tolles_lawson", &[], &[]).unwrap();
    for part in [
        "Power spectral density",
        "in the pass band of the fit",
        "The model: table coefficients",
        "aria-label=\"The plan",
    ] {
        assert!(html.contains(part), "{part}");
    }
    for part in ["anomaly map", "North error", "id=\"failures\"", "id=\"missing\"", "id=\"outdated\""] {
        assert!(!html.contains(part), "{part}");
    }
}

#[test]
fn unit_navigation_alone_has_no_model() {
    let html = page("navigation", &[], &[]).unwrap();
    for part in [
        "data:image/png;base64",
        "North error",
        "East error",
        "Innovations",
        "NIS",
        "NEES",
        "Enlarged: the largest error of the INS",
    ] {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains("The model: ") && !html.contains("Before and after"));
    // Two points of the sweep, the better point first; then the other navigation, over a separate map.
    assert!(html.contains("id=\"best\"") && html.contains("id=\"worst\"") && html.contains("id=\"table-held\""));
    assert_eq!(
        (html.matches("<image id=\"map-anomaly\"").count(), html.matches("<image id=\"map-osborne\"").count()),
        (1, 1)
    );
    for part in [
        "North error: held, flight 1, line 1.02",
        "±3σ of the filter",
        "Whiteness of the innovations: held",
        "95 % bounds for white noise",
    ] {
        assert!(html.contains(part), "{part}");
    }
}

#[test]
fn unit_google_earth_tracks_are_those_of_the_page_or_the_selection() {
    let names = |words: &[&str]| words.iter().map(ToString::to_string).collect::<Vec<String>>();
    let (all, held, line) = (names(&[]), names(&["held"]), names(&["1.02"]));
    let (wrong, off) = (names(&["holt"]), names(&["1.09"]));
    let look = |graph: &PlanGraph, store: &Store| {
        let of = |tables: &[String], lines: &[String]| kml(graph, store, &TrackSelection { tables, lines }, "tracks");
        Ok((of(&all, &all)?, of(&held, &line)?, of(&wrong, &all).unwrap_err(), of(&held, &off).unwrap_err()))
    };
    let (page, one, no_table, no_line) = looked_at("navigation", &[], &[], look).unwrap();
    for made in [&page, &one] {
        assert_eq!(unclosed(made.document.split_once("?>").unwrap().1), None);
        assert!(made.files.iter().all(|(name, _)| made.document.contains(&format!("<href>{name}</href>"))));
    }
    let count = |text: &str, what: &str| text.matches(what).count();
    // The best and the worst point of `track`, and `held`, each on one line.
    assert_eq!((count(&page.document, "<name>truth</name>"), count(&page.document, "<LineString>")), (3, 9));
    assert_eq!((count(&one.document, "<name>truth</name>"), count(&one.document, "<Polygon>")), (1, 60));
    assert!(one.document.contains("<name>flight 1, line 1.02</name>") && one.files.len() == 2, "map and colour bar");
    assert!(no_table.help.is_some_and(|h| h.contains("held")), "{}", no_table.what);
    assert!(no_line.what.contains("no table of `navigate` has a line `1.09`"), "{}", no_line.what);
}

#[test]
fn unit_scores_of_another_spec_are_not_shown() {
    let html = page("tolles_lawson", &[], &["coefficients.low_hz=0.2"]).unwrap();
    assert!(html.contains("changed since the last run") && html.contains("4 of 4 missing"));
    assert!(!html.contains("id=\"scores-scores\""));
}

#[test]
fn unit_failures_are_at_the_top() {
    let sets = ["coefficients.trim=600"];
    let html = page("tolles_lawson", &sets, &sets).unwrap();
    let failed = html.find("<h2>4 failed</h2>").unwrap();
    assert!(failed < html.find("id=\"plan\"").unwrap());
    assert!(html.contains("long enough to be filtered"));
}

#[test]
fn unit_a_store_without_the_plan_is_an_error() {
    let other = ["tables.flights.line=\"2\""];
    let fault = page("tolles_lawson", &[], &other).unwrap_err();
    assert!(fault.what.contains("has not been run"), "{fault}");
}

#[test]
fn unit_a_page_replaces_the_old_one_without_leftovers() {
    let folder = std::env::temp_dir().join(format!("magline-report-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let file = folder.join("a.html");
    write(&file, b"old").unwrap();
    write(&file, b"new").unwrap();
    assert_eq!(fs::read_to_string(&file).unwrap(), "new");
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
    assert!(write(&folder.join("none").join("a.html"), b"x").is_err());
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn gold_without_a_run_there_is_nothing_to_report() {
    let text = "name = \"a\"\n[[stages]]\nname = \"s\"\nstage = \"score\"\n";
    let spec = Spec::parse("dir/a.toml", "no-such-folder".into(), text.to_owned(), &[]).unwrap();
    let fault = was_run(&spec).unwrap_err();
    assert_eq!(fault.what, "there is nothing to report: dir/a.toml has not been run");
    assert_eq!(fault.help.as_deref(), Some("run the spec first: `magline run dir/a.toml`"));
}

#[test]
fn unit_the_page_loads_no_external_resources() {
    // Vendored scripts contain addresses of their licences, and scripts of series ask the server of a view.
    let (vendored, own): (Vec<&PageScript>, Vec<&PageScript>) =
        SCRIPTS.iter().partition(|s| s.name.contains("vendor/"));
    let found = |text: &str, words: &[&str]| words.iter().any(|word| text.contains(word));
    for script in own {
        assert!(!found(script.text, &["http", "@import", "XMLHttp", "</", "<!--", "eval("]), "{}", script.name);
    }
    for script in vendored {
        assert!(!found(script.text, &["@import", "XMLHttp", "fetch(", "</", "<!--", "import("]), "{}", script.name);
    }
    assert!(!found(STYLE, &["http", "url(", "@import", "</"]));
}

#[test]
fn unit_several_models_are_compared() {
    // The ridge parameter is the only axis: the coefficients of the four models.
    let html = page("tolles_lawson", &[], &[]).unwrap();
    assert!(html.contains("id=\"variation\"") && html.contains("over lambda, 4 models"));
    assert_eq!(html.matches("coefficient of variation is").count(), 1);
}

#[test]
fn unit_the_warnings_of_a_run_are_restored() {
    let store = tempfile::tempdir().unwrap();
    let sets = [format!("store={}", store.path().display())];
    let spec = read_spec(Path::new("../../datasets/examples/tolles_lawson.toml"), &sets).unwrap();
    let plan = Plan::new(spec, &catalogue()).unwrap();
    let held = Store::open(store.path()).unwrap();
    run::run(&plan, &held, run::RunOptions::default(), &run::SilentListener).unwrap();
    let graph = PlanGraph::new(&plan, &held, &|_, _| ()).unwrap();
    let written = warnings::written(&plan, &held).unwrap().unwrap();
    assert_eq!(written, warnings::present(&graph, &held).unwrap());
}

#[test]
fn law_embedded_series_have_the_extremes_of_the_store() {
    use std::io::Read;

    use arrow_array::{cast::AsArray, types::Float32Type};
    use base64::{Engine, prelude::BASE64_STANDARD};

    let read = |graph: &PlanGraph, store: &Store| {
        let source = ReportSource::new(graph, store);
        let boards = scored(&source)?.boards;
        let mut left = explorer::BUDGET;
        let html = series::section(&source, &boards, &mut left)?.unwrap().into_string();
        let index = html.split("class=\"series-index\">").nth(1).unwrap().split("</script>").next().unwrap();
        let index: serde_json::Value = serde_json::from_str(index).unwrap();
        let blocks = index["blocks"].as_array().unwrap();
        assert!(!blocks.is_empty() && left < explorer::BUDGET);
        let described = &blocks[0];
        assert_eq!((&described["table"], &described["why"][0]), (&"clean".into(), &"best point".into()));
        let id = described["id"].as_str().unwrap();
        let text = html.split(&format!("id=\"{id}\">")).nth(1).unwrap().split("</script>").next().unwrap();
        assert_eq!(described["bytes"], text.len());
        let mut bytes = vec![];
        let packed = BASE64_STANDARD.decode(text).unwrap();
        flate2::read::GzDecoder::new(packed.as_slice()).read_to_end(&mut bytes).unwrap();
        let batch = arrow_ipc::reader::StreamReader::try_new(bytes.as_slice(), None).unwrap().next().unwrap().unwrap();
        // Only the flights' column has one source for all points.
        let (t, line) = (graph.plan.table("clean")?, described["line"].as_str().unwrap());
        let line = graph.lines.iter().position(|(_, l)| l == line).unwrap();
        let truth = source.floats(TableRef::Stage(t, 0), line, "mag_1_uc")?.unwrap();
        let schema = batch.schema();
        let part = |part: &str| {
            let own = |f: &&std::sync::Arc<arrow_schema::Field>| {
                f.metadata().get("column").is_some_and(|c| c == "mag_1_uc") && f.metadata()["part"] == part
            };
            let field = schema.fields().iter().find(own).unwrap();
            let offset: f64 = field.metadata()["offset"].parse().unwrap();
            let values = batch.column_by_name(field.name()).unwrap().as_primitive::<Float32Type>().clone();
            values.iter().flatten().map(|v| f64::from(v) + offset).collect::<Vec<f64>>()
        };
        let columns = described["columns"].as_array().unwrap();
        let column = columns.iter().find(|c| c["name"] == "mag_1_uc").unwrap();
        let (error, thinned) = (column["resolution"].as_f64().unwrap(), described["thinned"] == true);
        let (low, high) = if thinned { (part("min"), part("max")) } else { (part("value"), part("value")) };
        let least = |x: &[f64]| x.iter().copied().fold(f64::INFINITY, f64::min);
        let most = |x: &[f64]| x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        assert!((least(&low) - least(&truth)).abs() <= error && (most(&high) - most(&truth)).abs() <= error);
        assert!(error < 1e-3, "{error}");
        assert_eq!(described["rows"], truth.len());
        // A page without space has no series, and says so nowhere else.
        let mut none = 10;
        assert!(series::section(&source, &boards, &mut none)?.is_none() && none == 10);
        Ok(())
    };
    looked_at("tolles_lawson", &[], &[], read).unwrap();
}
