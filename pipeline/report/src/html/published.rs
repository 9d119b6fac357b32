//! Comparison of the published tables with this plan.

use std::collections::BTreeMap;

use results::{Snapshot, SnapshotTable, snapshots};

use super::source::ReportSource;

/// Whether the last run used exactly this plan and data. Otherwise, the published tables may contain different scores
/// for the same axis values.
pub fn is_current(source: &ReportSource) -> bool {
    let plan = source.graph.plan;
    let recorded = snapshots(source.store.root()).into_iter().find(|s| s.pipeline == plan.spec.name);
    recorded.is_some_and(|old| same_sources(source, &old) && same_tables(source, &old))
}

fn same_sources(source: &ReportSource, old: &Snapshot) -> bool {
    let (plan, graph) = (source.graph.plan, source.graph);
    let recorded = |name: &str| old.sources.iter().find(|s| s.name == name).map(|s| &s.lines);
    let flights = plan.flights.iter().zip(&graph.records).all(|(flights, records)| {
        let now: BTreeMap<String, String> =
            records.values().map(|l| (format!("{}/{}", l.flight, l.line), l.object.to_string())).collect();
        recorded(&flights.name) == Some(&now)
    });
    let same_map = |(name, key): (&String, String)| recorded(name).is_some_and(|l| l.values().eq([&key]));
    flights && plan.maps.iter().zip(&graph.maps).all(|(m, key)| same_map((&m.name, key.to_string())))
}

fn same_tables(source: &ReportSource, old: &Snapshot) -> bool {
    let plan = source.graph.plan;
    let same = |t: usize| {
        let old = old.tables.iter().find(|o| o.name == plan.tables[t].name);
        old.is_some_and(|old| same_table(source, t, old))
    };
    (0..plan.tables.len()).all(same)
}

fn same_table(source: &ReportSource, t: usize, old: &SnapshotTable) -> bool {
    let plan = source.graph.plan;
    let node = &plan.tables[t];
    let mut inputs: Vec<&str> = node.sources().into_iter().map(|r| plan.name_of(r)).collect();
    let mut before: Vec<&str> = old.inputs.iter().map(String::as_str).collect();
    for names in [&mut inputs, &mut before] {
        names.sort_unstable();
        names.dedup();
    }
    let predicate = plan.decl(t).and_then(|d| d.predicate.as_ref()).map(|(text, _)| text);
    let points = plan.instances(t).map(|i| {
        let point: BTreeMap<String, String> = i.point().iter().map(|(k, v)| (k.clone(), v.to_string())).collect();
        (point, i.params().into_iter().map(|(k, v)| (k.to_owned(), v)).collect())
    });
    (node.entry.name, node.entry.version) == (old.stage.as_str(), old.version)
        && inputs == before
        && predicate == old.predicate.as_ref()
        && points.eq(old.points.iter())
}
