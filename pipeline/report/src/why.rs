//! `magline why`: changes since a table was last computed.

use std::collections::BTreeMap;

use plan::{PlanGraph, TableRef};
use results::snapshots;
use schemas::Fault;
use store::Store;

/// Units of `table` that a run would compute, with the parameter, line or input that changed each key.
///
/// # Errors
/// Fails if the plan has no such table.
pub fn why(graph: &PlanGraph, store: &Store, table: &str) -> Result<String, Fault> {
    let plan = graph.plan;
    let t = plan.table(table)?;
    let units = graph.unit_count(t);
    let missing = graph.units(t).filter(|u| !graph.key(*u).is_ok_and(|k| store.has(k))).count();
    if missing == 0 {
        return Ok(format!("{table}: nothing to compute, all {units} units are in the store\n"));
    }
    let mut out = format!("{table}: {missing} of {units} units to compute\n");
    let Some(before) = snapshots(store.root()).into_iter().find(|s| s.pipeline == plan.spec.name) else {
        return Ok(out + "  this store has no earlier run of the pipeline\n");
    };
    let mut reasons = vec![];
    for node in plan.rests_on(t) {
        let now = &plan.tables[node];
        let Some(old) = before.tables.iter().find(|o| o.name == now.name) else {
            reasons.push(format!("{} is new", now.name));
            continue;
        };
        if (old.stage.as_str(), old.version) != (now.entry.name, now.entry.version) {
            reasons.push(format!(
                "{}: {} v{} -> {} v{}",
                now.name, old.stage, old.version, now.entry.name, now.entry.version
            ));
        }
        let predicate = plan.decl(node).and_then(|d| d.predicate.clone()).map(|p| p.0);
        if predicate != old.predicate {
            let word = |p: &Option<String>| p.clone().unwrap_or_else(|| "(all)".to_owned());
            reasons.push(format!("{}: where {} -> {}", now.name, word(&old.predicate), word(&predicate)));
        }
        let known: BTreeMap<_, _> = old.points.iter().collect();
        for it in plan.instances(node) {
            let point: BTreeMap<String, String> = it.point().iter().map(|(k, v)| (k.clone(), v.to_string())).collect();
            let spelt: Vec<String> = point.iter().map(|(k, v)| format!("{k}={v}")).collect();
            match known.get(&point) {
                None => reasons.push(format!("{}: the point {} is new", now.name, spelt.join(" "))),
                Some(params) => {
                    for (name, value) in it.params() {
                        let was = params.get(name).map_or("(absent)", String::as_str);
                        if was != value {
                            reasons.push(format!("{}: {name} {was} -> {value}", now.name));
                        }
                    }
                }
            }
        }
    }
    reasons.extend(sources(graph, t, &before));
    reasons.dedup();
    if reasons.is_empty() {
        reasons.push("results are missing from the store: a run was interrupted, or they were removed".to_owned());
    }
    const SHOWN: usize = 40;
    for reason in reasons.iter().take(SHOWN) {
        out.push_str(&format!("  {reason}\n"));
    }
    if reasons.len() > SHOWN {
        out.push_str(&format!("  and {} more\n", reasons.len() - SHOWN));
    }
    Ok(out)
}

/// Lines and maps whose bytes have changed.
fn sources(graph: &PlanGraph, t: usize, before: &results::Snapshot) -> Vec<String> {
    let plan = graph.plan;
    let mut used: Vec<TableRef> = plan.rests_on(t).into_iter().flat_map(|n| plan.tables[n].sources()).collect();
    used.sort();
    used.dedup();
    let mut reasons = vec![];
    for r in used {
        let name = graph.plan.name_of(r);
        let empty = BTreeMap::new();
        let old = before.sources.iter().find(|s| s.name == name).map_or(&empty, |s| &s.lines);
        match r {
            TableRef::Flights(i) => {
                for record in graph.records[i].values() {
                    let line = format!("{}/{}", record.flight, record.line);
                    match old.get(&line) {
                        None => reasons.push(format!("{name}: line {line} is new")),
                        Some(key) if *key != record.object.to_string() => {
                            reasons.push(format!("{name}: line {line} has changed"))
                        }
                        Some(_) => {}
                    }
                }
            }
            TableRef::Map(i) if old.get("map").is_some_and(|k| *k != graph.maps[i].to_string()) => {
                reasons.push(format!("{name}: the {} has changed", plan.maps[i].word()));
            }
            TableRef::Map(_) | TableRef::Stage(..) => {}
        }
    }
    reasons
}
