//! The lazy plan compared with a plan that lists every point.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::{collections::HashSet, fmt::Write, fs};

use schemas::Literal;
use stages::catalogue;
use store::Store;
use tempfile::TempDir;

use super::*;

/// A flight of two short lines.
fn flights(folder: &TempDir) {
    let mut text = "flight,line,tt,lat,lon,alt,mag_1_c,mag_4_uc,mag_5_uc,flux_a_x,flux_a_y,flux_a_z\n".to_owned();
    for line in ["1.01", "1.02"] {
        for i in 0..40 {
            let t = f64::from(i) * 0.1;
            let (slow, x, y, z) = ((t / 5.0).sin(), (1.3 * t).sin(), (0.9 * t).cos(), (1.7 * t).sin());
            let place = format!("{},{}", 45.0 + 1e-4 * t, 10.0 + 1e-4 * t);
            let flux = format!("{},{},{}", 20_000.0 + 900.0 * x, 3_000.0 * y, 45_000.0 + 500.0 * z);
            writeln!(text, "1,{line},{},{place},300,{slow},{},{},{flux}", 36_000.0 + t, slow + x, slow + z).unwrap();
        }
    }
    fs::write(folder.path().join("flights.csv"), text).unwrap();
}

fn spec(folder: &TempDir, text: &str) -> Spec {
    let head = "name = 'lazy'\nstore = 'store'\n[tables.flights]\npath = 'flights.csv'\n";
    Spec::parse("lazy.toml", folder.path().into(), format!("{head}{text}"), &[]).unwrap_or_else(|f| panic!("{f}"))
}

fn planned(spec: Spec) -> Plan {
    Plan::new(spec, &catalogue()).unwrap_or_else(|f| panic!("{f}"))
}

/// Stages with an axis in an input's name, in a `where`, in column names and in numbers, and one stage without an axis.
const MIXED: &str = "
[axes]
from   = ['even', 'raw']
mag    = ['mag_4_uc', 'mag_5_uc']
over   = ['1.01', '1.02']
lambda = [0.0, 0.5, 2.5]
[[stages]]
name = 'even'
stage = 'resample'
input = 'flights'
rate_hz = 10.0
[[stages]]
name = 'raw'
stage = 'bandpass'
input = 'flights'
columns = ['$mag']
[[stages]]
name = 'terms'
stage = 'a_matrix'
input = '$from'
vector = 'flux_a'
[[stages]]
name = 'coefficients'
stage = 'fit'
input = 'terms'
where = \"line = '$over'\"
model = 'tolles_lawson'
target = '$mag'
lambda = '$lambda'
[[stages]]
name = 'clean'
stage = 'compensate'
input = 'terms'
model = 'coefficients'
mag = '$mag'
[[stages]]
name = 'one'
stage = 'bandpass'
input = 'clean'
where = \"line = '$over'\"
columns = ['mag_c']
[[stages]]
name = 'scores'
stage = 'score'
input = ['one']
truth = 'mag_1_c'
[[stages]]
name = 'all'
stage = 'summary'
input = 'scores'
";

#[test]
fn unit_points_equal_points_that_are_planned_alone() {
    let folder = TempDir::new().unwrap();
    flights(&folder);
    let store = Store::open(&folder.path().join("store")).unwrap();
    let whole = planned(spec(&folder, MIXED));
    let graph = PlanGraph::new(&whole, &store, &|_, _| ()).unwrap_or_else(|f| panic!("{f}"));
    let all = SweepGrid::new(&[0, 1, 2, 3], &whole.spec);
    assert_eq!(all.len(), 24);
    let mut seen = HashSet::new();
    for p in 0..all.len() {
        let point = all.point(p, &whole.spec);
        let mut one = whole.spec.clone();
        one.axes.iter_mut().for_each(|a| a.values = vec![point[&a.name].clone()]);
        let alone = planned(one);
        let graph_alone = PlanGraph::new(&alone, &store, &|_, _| ()).unwrap_or_else(|f| panic!("{f}"));
        for (s, node) in alone.tables.iter().enumerate() {
            let t = whole.table(&node.name).unwrap();
            let same = |i: &StageInstance| i.point().iter().all(|(axis, value)| point[axis] == *value);
            let there: Vec<StageInstance> = whole.instances(t).filter(same).collect();
            // A name that is the same at all points depends on fewer axes than other names.
            let (here, there) = (alone.instance(s, 0), there[0]);
            assert_eq!(node.len(), 1);
            assert!(here.point().iter().all(|(axis, value)| there.point().get(axis) == Some(value)));
            assert_eq!(here.params(), there.params());
            assert_eq!(here.question(), there.question());
            assert_eq!(here.yields, there.yields);
            assert_eq!(here.table.shape(), there.table.shape());
            assert_eq!(here.kinds(), there.kinds());
            let canonical = |i: &StageInstance| i.predicate.as_ref().map(|p| p.canonical.clone());
            assert_eq!(canonical(&here), canonical(&there));
            let names = |plan: &Plan, i: &StageInstance| -> Vec<String> {
                i.inputs().into_iter().map(|r| plan.name_of(r).to_owned()).collect()
            };
            assert_eq!(names(&alone, &here), names(&whole, &there));
            for r in there.inputs() {
                if let TableRef::Stage(u, k) = r {
                    assert!(whole.instance(u, k).point().iter().all(|(axis, value)| point[axis] == *value));
                }
            }
            assert_eq!(graph_alone.lines_of(s, 0), graph.lines_of(t, there.index));
            assert_eq!(graph_alone.unit_count(s), graph_alone.units(s).count());
            for unit in graph_alone.units(s) {
                let key = graph.key(PlanUnit { table: t, instance: there.index, ..unit }).unwrap();
                assert_eq!(graph_alone.key(unit).unwrap(), key, "{} at {point:?}", node.name);
                for column in here.table.shape().columns.iter().filter(|_| unit.line.is_some()) {
                    let of = |g: &PlanGraph, t, i| {
                        g.column(TableRef::Stage(t, i), unit.line.unwrap(), &column.name).unwrap()
                    };
                    assert_eq!(of(&graph_alone, s, 0), of(&graph, t, there.index), "{}", column.name);
                }
                seen.insert((t, unit.line, key));
            }
        }
    }
    // Every unit of the plan occurs, and different units have different keys.
    let units: HashSet<_> = (0..whole.tables.len())
        .flat_map(|t| graph.units(t))
        .map(|u| (u.table, u.line, graph.key(u).unwrap()))
        .collect();
    assert_eq!(units, seen);
    for t in 0..whole.tables.len() {
        assert_eq!(graph.units(t).count(), graph.unit_count(t));
    }
}

#[test]
fn unit_equal_data_are_stored_once() {
    let folder = TempDir::new().unwrap();
    flights(&folder);
    let plan = planned(spec(&folder, MIXED));
    let sizes = |name: &str| {
        let node = &plan.tables[plan.table(name).unwrap()];
        (node.len(), node.variants.len())
    };
    assert_eq!(sizes("even"), (1, 1));
    assert_eq!(sizes("raw"), (2, 2));
    assert_eq!(sizes("terms"), (4, 3));
    // The variants cover two targets, two inputs and two predicates, but not the three ridge parameters.
    assert_eq!(sizes("coefficients"), (24, 8));
    let terms = plan.table("terms").unwrap();
    let names = |t: usize| plan.tables[t].sources().into_iter().map(|r| plan.name_of(r)).collect::<Vec<_>>();
    assert_eq!(names(terms), ["even", "raw"]);
    assert_eq!(plan.rests_on(terms).len(), 3);
}

/// A sweep over three axes of `side` values, each mentioned by one stage, and two stages without an axis.
fn cube(side: usize) -> String {
    let axis = |name: &str, from: f64| {
        let values: Vec<String> = (0..side).map(|i| format!("{:?}", from + i as f64 * 1e-3)).collect();
        format!("{name} = [{}]\n", values.join(", "))
    };
    let mut text = format!("[axes]\n{}{}{}", axis("a", 0.1), axis("b", 0.1), axis("c", 1.0));
    let band = |name: &str, input: &str, column: &str, low: &str, high: &str| {
        format!(
            "[[stages]]\nname = '{name}'\nstage = 'bandpass'\ninput = '{input}'\ncolumns = ['{column}']\n\
             low_hz = {low}\nhigh_hz = {high}\n"
        )
    };
    text.push_str(&band("one", "flights", "mag_4_uc", "'$a'", "1.5"));
    text.push_str(&band("two", "one", "mag_4_uc_bp", "'$b'", "1.5"));
    text.push_str(&band("three", "two", "mag_4_uc_bp_bp", "0.1", "'$c'"));
    text.push_str(&band("four", "three", "mag_4_uc_bp_bp_bp", "0.1", "1.5"));
    text.push_str(
        "[[stages]]\nname = 'scores'\nstage = 'score'\ninput = 'four'\ntruth = 'mag_1_c'\n\
         mag = 'mag_4_uc_bp_bp_bp_bp'\n",
    );
    text
}

#[test]
fn unit_a_million_points_are_counted_without_being_listed() {
    let folder = TempDir::new().unwrap();
    flights(&folder);
    let plan = planned(spec(&folder, &cube(100)));
    let lens: Vec<usize> = plan.tables.iter().map(TableNode::len).collect();
    assert_eq!(lens, [100, 10_000, 1_000_000, 1_000_000, 1_000_000]);
    assert!(plan.tables.iter().all(|t| t.variants.len() == 1));
    let store = Store::open(&folder.path().join("store")).unwrap();
    let graph = PlanGraph::new(&plan, &store, &|_, _| ()).unwrap_or_else(|f| panic!("{f}"));
    assert_eq!(graph.unit_count(4), 2_000_000);
    let last = graph.units(4).nth(1_999_999).unwrap();
    assert_eq!(last, PlanUnit { table: 4, instance: 999_999, line: Some(1) });
    let it = plan.instance(4, 123_456);
    let value = |x: f64| Literal::Float(x);
    let point = SweepPoint::from(
        [("a", 0.1 + 12.0 * 1e-3), ("b", 0.1 + 34.0 * 1e-3), ("c", 1.0 + 56.0 * 1e-3)]
            .map(|(n, x)| (n.to_owned(), value(x))),
    );
    assert_eq!(it.point(), point);
    // Two points with different values of any axis have different keys.
    let keys: HashSet<_> = [0, 1, 100, 10_000, 123_456, 999_999]
        .map(|instance| graph.key(PlanUnit { table: 4, instance, line: Some(0) }).unwrap().to_string())
        .into();
    assert_eq!(keys.len(), 6);
}

#[test]
#[ignore = "a measurement: cargo test --workspace --lib -- --ignored --nocapture measure_keys"]
fn measure_keys_of_a_million_units() {
    let folder = TempDir::new().unwrap();
    flights(&folder);
    let started = std::time::Instant::now();
    let plan = planned(spec(&folder, &cube(80)));
    let store = Store::open(&folder.path().join("store")).unwrap();
    let graph = PlanGraph::new(&plan, &store, &|_, _| ()).unwrap_or_else(|f| panic!("{f}"));
    eprintln!("planned in {:.3} s", started.elapsed().as_secs_f64());
    for t in 0..plan.tables.len() {
        let started = std::time::Instant::now();
        let made = graph.units(t).filter(|u| graph.key(*u).is_ok()).count();
        let seconds = started.elapsed().as_secs_f64();
        eprintln!("{}: {made} keys in {seconds:.3} s, {:.2} us each", plan.tables[t].name, 1e6 * seconds / made as f64);
    }
}

/// Result for [`MIXED`] with a line added to the stage `name`.
fn carry_or_faults(name: &str, line: &str) -> String {
    let folder = TempDir::new().unwrap();
    flights(&folder);
    let head = format!("name = '{name}'\n");
    assert!(MIXED.contains(&head));
    let text = MIXED.replace(&head, &format!("{head}{line}\n"));
    match Plan::new(spec(&folder, &text), &catalogue()) {
        Ok(plan) => format!("{:?}", plan.tables[plan.table(name).unwrap()].carry),
        Err(faults) => faults.to_string(),
    }
}

#[test]
fn gold_carry_names_columns_that_pass_through() {
    // Columns that the stage makes, keys, the time and axes are always written.
    assert_eq!(carry_or_faults("clean", "carry = ['lat', 'lon', 'lat']"), "[\"lat\", \"lon\"]");
    assert_eq!(carry_or_faults("clean", "carry = ['mag_c', 'flight', 'line', 'tt', 'lambda', 'alt']"), "[\"alt\"]");
    for (name, line, expected_text) in [
        ("clean", "carry = ['lat', 'lom']", "`clean` has no column `lom` to carry"),
        ("clean", "carry = ['lat', 'lom']", "did you mean `lon`?"),
        ("coefficients", "carry = ['lat']", "tables of flight lines, and `coefficients` is not one"),
        ("scores", "carry = ['lat']", "tables of flight lines, and `scores` is not one"),
    ] {
        let text = carry_or_faults(name, line);
        assert!(text.contains(expected_text) && text.contains("--> lazy.toml:"), "{text}");
    }
}

#[test]
fn gold_keep_applies_only_to_unpublished_tables_of_lines() {
    assert_eq!(carry_or_faults("clean", "publish = false\nkeep = false"), "[]");
    assert_eq!(carry_or_faults("clean", "keep = true"), "[]");
    for (name, line, expected_text) in [
        ("clean", "keep = false", "add `publish = false`, or remove `keep`"),
        ("coefficients", "publish = false\nkeep = false", "tables of flight lines, and `coefficients` is not one"),
        ("scores", "keep = false", "remove `keep`"),
    ] {
        let text = carry_or_faults(name, line);
        assert!(text.contains(expected_text) && text.contains("--> lazy.toml:"), "{text}");
    }
}
