//! Comparisons in the example specs: the compared methods have the same samples, terms and number of seeds, and
//! simulated measurements are independent of the map that a filter uses.

use std::{collections::BTreeSet, fs};

use toml::{Table, Value};

use crate::support::repository;

/// Example spec.
struct Example {
    name: String,
    table: Table,
}

fn example(name: &str) -> Example {
    let text = fs::read_to_string(repository().join("datasets/examples").join(name)).unwrap();
    Example { name: name.to_owned(), table: text.parse().unwrap() }
}

fn examples() -> Vec<Example> {
    let entries = fs::read_dir(repository().join("datasets/examples")).unwrap().flatten();
    let mut names: Vec<String> = entries.map(|e| e.file_name().into_string().unwrap()).collect();
    names.retain(|name| name.ends_with(".toml"));
    names.sort();
    names.iter().map(|name| example(name)).collect()
}

impl Example {
    fn stages(&self) -> Vec<&Table> {
        self.table.get("stages").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_table).collect()
    }

    fn stage(&self, name: &str) -> &Table {
        self.stages().into_iter().find(|s| text(s, "name") == name).unwrap_or_else(|| panic!("{}: {name}", self.name))
    }

    fn axis(&self, name: &str) -> &[Value] {
        self.table["axes"][name].as_array().unwrap()
    }
}

fn text<'a>(stage: &'a Table, key: &str) -> &'a str {
    stage.get(key).and_then(Value::as_str).unwrap_or_default()
}

/// Lines in the list of a `where` after `not in`.
fn excluded(predicate: &str) -> BTreeSet<String> {
    let list = predicate.split("not in (").nth(1).and_then(|rest| rest.split(')').next()).unwrap_or_default();
    list.split(',').map(|line| line.trim().trim_matches('\'').to_owned()).filter(|line| !line.is_empty()).collect()
}

/// Lines that select the epoch of a network.
fn validation(example: &Example, network: &Table) -> BTreeSet<String> {
    let own = network["validation"].as_array();
    let lines = own.unwrap_or_else(|| example.axis("validation")[0].as_array().unwrap());
    lines.iter().map(|line| line.as_str().unwrap().to_owned()).collect()
}

#[test]
fn unit_linear_models_and_networks_are_fitted_on_the_same_lines() {
    let mut compared = 0;
    for example in examples() {
        let fits: Vec<&Table> = example.stages().into_iter().filter(|s| text(s, "stage") == "fit").collect();
        for network in fits.iter().filter(|s| s.contains_key("validation")) {
            let kept = excluded(text(network, "where"));
            let lines = validation(&example, network);
            assert!(!lines.is_empty(), "{}", example.name);
            // Linear models with the same input have no `epochs`.
            for linear in fits.iter().filter(|s| !s.contains_key("epochs") && s["input"] == network["input"]) {
                let expected: BTreeSet<String> = kept.union(&lines).cloned().collect();
                assert_eq!(excluded(text(linear, "where")), expected, "{}: {}", example.name, text(linear, "name"));
                compared += 1;
            }
        }
    }
    // Two linear models of gnadt_2022_networks.toml, one with three networks; three of gnadt_2022_sweep.toml.
    assert_eq!(compared, 3 + 1 + 3);
}

#[test]
fn unit_networks_are_compared_over_ten_seeds() {
    for name in ["gnadt_2022_networks.toml", "gnadt_2022_network_navigation.toml"] {
        let example = example(name);
        assert!(example.axis("seed").len() >= 10, "{name}: {:?}", example.axis("seed"));
    }
    let sql = fs::read_to_string(repository().join("datasets/examples/gnadt_2022_networks.sql")).unwrap();
    assert!(sql.contains("better_than_pls"), "the query counts the seeds that are better than PLS");
}

#[test]
fn unit_the_calibration_of_a_cold_start_has_the_terms_of_the_online_filters() {
    let example = example("cold_start.toml");
    let (fit, online, lagged) = (example.stage("coefficients"), example.stage("online"), example.stage("lagged"));
    for key in ["input", "mag"] {
        assert_eq!(online[key], lagged[key]);
    }
    assert_eq!(fit["input"], online["input"]);
    assert_eq!(fit["target"], online["mag"]);
    // Both use the whole list of terms: 19 terms of Tolles and Lawson, and 11 currents in three directions.
    assert_eq!(fit["features"].as_array().unwrap(), &[Value::from("features")]);
    assert_eq!(text(online, "terms"), "features");
    let terms = example.stage(text(fit, "input"));
    let groups = terms["terms"].as_array().unwrap();
    assert!(groups.contains(&Value::from("bias")));
    assert_eq!(terms["features"].as_array().unwrap().len(), 1 + 11);
    // The tracks are compared on the same lines, map and height.
    for key in ["map", "map_interpolation", "map_levels_m", "remove_diurnal"] {
        assert_eq!(example.stage("static")[key], online[key], "{key}");
    }
    assert_eq!(example.stage("clean")["where"], online["where"]);
}

#[test]
fn unit_five_induced_terms_are_used_with_a_constant() {
    let mut found = 0;
    for example in examples() {
        for stage in example.stages() {
            let terms: Vec<&str> =
                stage.get("terms").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str).collect();
            if terms.contains(&"induced5") {
                assert!(terms.contains(&"bias"), "{}: {}", example.name, text(stage, "name"));
                found += 1;
            }
        }
    }
    assert!(found > 0);
}

#[test]
fn unit_the_difference_of_two_magnetometers_is_simulated_at_their_places() {
    let (spec, synth) = (example("aids.toml"), example("aids.synth.toml"));
    let arm = |name: &str| -> Vec<f64> {
        let all = synth.table["magnetometers"].as_array().unwrap();
        let one = all.iter().find(|m| m["name"].as_str() == Some(name)).unwrap();
        one["arm_m"].as_array().unwrap().iter().map(|x| x.as_float().unwrap()).collect()
    };
    let baseline: Vec<f64> = arm("mag_1_uc").iter().zip(arm("mag_2_uc")).map(|(a, b)| a - b).collect();
    let mut found = 0;
    for stage in spec.stages().into_iter().filter(|s| s.contains_key("gradient")) {
        let told: Vec<f64> =
            stage["gradient_baseline_m"].as_array().unwrap().iter().map(|x| x.as_float().unwrap()).collect();
        assert_eq!(told, baseline, "{}", text(stage, "name"));
        assert_eq!(stage["gradient"], Value::from(vec!["mag_1_uc", "mag_2_uc"]));
        // The map has a vertical gradient, and the error of its slope is estimated.
        assert!(!stage["map_levels_m"].as_array().unwrap().is_empty() && !stage.contains_key("gradient_slope_sigma"));
        found += 1;
    }
    assert_eq!(found, 2);
    // No stage computes a measurement from the map.
    let from_map = ["map_value", "map_gradient"];
    assert!(spec.stages().iter().all(|s| !from_map.contains(&text(s, "stage"))));
}
