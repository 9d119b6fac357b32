//! The page around the sections: heading, failures, the plan, style and script.

use std::collections::BTreeMap;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use plan::{
    LineId,
    spec::{Spec, SweepAxis},
};

use results::history;

use super::{
    answer::with_unit,
    flow,
    scripts::{SCRIPTS, STYLE},
    source::{FailureCount, ReportSource},
    table::spelt,
    warnings::Warning,
};

/// The maximum number of failures listed.
const MOST: usize = 50;

/// Alerts that precede the other sections.
pub struct ReportAlerts {
    /// The best points.
    pub answer: Option<Markup>,
    /// The failures.
    pub failures: Vec<FailureCount>,
    /// The warnings.
    pub warnings: Vec<Warning>,
    /// Whether the published tables were made with another version of the spec or of its data.
    pub outdated: bool,
}

/// The first elements of the head of a page.
pub fn page_head(title: &str) -> Markup {
    html! {
        meta charset="utf-8";
        meta name="viewport" content="width=device-width, initial-scale=1";
        meta name="color-scheme" content="light dark";
        meta name="generator" content="magline";
        link rel="icon" href="data:,";
        title { (title) }
    }
}

/// The foot of a page: the hash of the last run of each pipeline, and the citation of `CITATION.cff`.
pub fn page_foot(runs: &[(String, String)]) -> Markup {
    html! {
        footer {
            @for (pipeline, run) in runs {
                p.note { "Run " code data-run=(pipeline) { (run) } " of " bdi { (spelt(pipeline)) } "." }
            }
            p.note {
                "Please cite: The magline developers. " cite {
                    "magline: a batch pipeline for airborne magnetometry and magnetic navigation"
                } ". Version " (env!("CARGO_PKG_VERSION")) "."
            }
        }
    }
}

/// The page.
pub fn page(source: &ReportSource, alerts: &ReportAlerts, defs: Markup, sections: &[Markup]) -> String {
    let spec = &source.graph.plan.spec;
    // Outdated tables are from another spec or other data, so the last run is not the run of this page.
    let last = history::past(source.store.root(), &spec.name).pop().filter(|_| !alerts.outdated);
    let runs: Vec<(String, String)> = last.into_iter().map(|run| (spec.name.clone(), run.run)).collect();
    let has_series = sections.iter().any(|s| s.0.contains("class=\"series-index\""));
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                (page_head(&format!("{} – magline report", spec.name)))
                style { (PreEscaped(STYLE)) }
            }
            body data-pipeline=(spec.name) {
                (defs)
                main {
                    (heading(source))
                    @if let Some(answer) = &alerts.answer { (answer) }
                    (alert_sections(source, alerts))
                    @for section in sections { (section) }
                    (plan(source))
                    (page_foot(&runs))
                }
                @for script in SCRIPTS.iter().filter(|s| has_series || !s.of_series) {
                    script { (PreEscaped(script.text)) }
                }
            }
        }
    };
    markup.into_string()
}

fn heading(source: &ReportSource) -> Markup {
    let plan = source.graph.plan;
    let axes = &plan.spec.axes;
    // A table need not have all axes, so the largest table gives the number of computed points.
    let points = plan.tables.iter().map(|t| t.len()).max().unwrap_or(0);
    let mut flights: Vec<&str> = source.graph.lines.iter().map(|l| l.0.as_str()).collect();
    flights.dedup();
    let samples = samples(source.graph.records.iter().flat_map(|r| r.iter().map(|(line, r)| (*line, r.rows))));
    html! {
        header {
            h1 { (plan.spec.name) }
            p.lead { "magline report of " code { (plan.spec.file) } }
            div.figures {
                (figure(flights.len(), "flight"))
                (figure(source.graph.lines.len(), "line"))
                (figure(samples, "sample"))
                (figure(points, if axes.is_empty() { "run" } else { "sweep point" }))
            }
            @if !axes.is_empty() {
                dl.axes { @for axis in axes {
                    dt { (axis.name) }
                    dd { (axis_words(&plan.spec, axis)) }
                } }
            }
        }
    }
}

/// The number of samples of all lines. For a line that several tables hold, only the longest table counts.
fn samples(rows: impl Iterator<Item = (LineId, usize)>) -> usize {
    let mut longest: BTreeMap<LineId, usize> = BTreeMap::new();
    for (line, rows) in rows {
        let known = longest.entry(line).or_default();
        *known = rows.max(*known);
    }
    longest.values().sum()
}

/// The values of an axis; of a searched axis, its range.
fn axis_words(spec: &Spec, axis: &SweepAxis) -> String {
    let searched = spec.search.iter().flat_map(|s| &s.axes).find(|a| a.name == axis.name);
    searched.map_or_else(|| listed(&axis.values), |a| format!("searched: {}", a.words()))
}

/// The values of an axis; of a long list, the first values and the last value.
fn listed<T: ToString>(values: &[T]) -> String {
    const SHOWN: usize = 24;
    let words: Vec<String> = values.iter().take(SHOWN).map(T::to_string).collect();
    match values.last() {
        Some(last) if values.len() > SHOWN => {
            format!("{} … {} ({} values)", words.join(", "), last.to_string(), values.len())
        }
        _ => words.join(", "),
    }
}

fn figure(n: usize, what: &str) -> Markup {
    html! { div { strong { (grouped(n)) } (what) @if n != 1 { "s" } } }
}

/// A whole number with thin spaces between thousands.
fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(c);
    }
    out
}

/// The failures and missing results, if any.
fn alert_sections(source: &ReportSource, ReportAlerts { failures, warnings, outdated, .. }: &ReportAlerts) -> Markup {
    let plan = source.graph.plan;
    let missing: Vec<(&str, usize, usize)> = plan
        .tables
        .iter()
        .enumerate()
        .map(|(t, node)| (node.name.as_str(), source.present(t)))
        .filter(|(_, (there, all))| there < all)
        .map(|(name, (there, all))| (name, all - there, all))
        .collect();
    let times: usize = failures.iter().map(|f| f.times).sum();
    html! {
        @if !failures.is_empty() {
            section.trouble id="failures" {
                h2 { (times) " failed" }
                p { "All other results are computed. The table " code { (plan.spec.name) ".failures" } " lists all \
                    failures." }
                div.scroll { table {
                    thead {
                        tr {
                            th scope="col" { "table" } th scope="col" { "why" } th scope="col" { "first at" }
                            th.n scope="col" { "times" }
                        }
                    }
                    tbody {
                        @for f in failures.iter().take(MOST) {
                            tr { td { (f.stage) } td { (f.error) } td { (f.example) } td.n { (f.times) } }
                        }
                    }
                } }
                @if failures.len() > MOST { p.note { "and " (failures.len() - MOST) " more reasons" } }
            }
        }
        (warned(&plan.spec.name, warnings))
        @if *outdated {
            section.trouble id="outdated" {
                h2 { "The spec or its data have changed since the last run" }
                p { "The stored scores belong to the earlier spec or data and are omitted. The page shows only \
                     results of the current spec and data. "
                    code { "magline run " (plan.spec.file) } " updates the tables." }
            }
        }
        @if !missing.is_empty() {
            section.trouble id="missing" {
                h2 { "Results are missing from the store" }
                p {
                    @for (i, (name, n, all)) in missing.iter().enumerate() {
                        @if i > 0 { ", " } code { (name) } ": " (n) " of " (all) " missing"
                    }
                    "."
                }
                @if !failures.is_empty() { p { "Results that depend on a failed result are also missing." } }
            }
        }
    }
}

/// The warnings, folded by kind, the worst of each kind first.
fn warned(pipeline: &str, warnings: &[Warning]) -> Markup {
    let mut worst: Vec<&Warning> = warnings.iter().collect();
    worst.sort_by(|a, b| a.kind.cmp(&b.kind).then(b.excess().total_cmp(&a.excess())));
    let kinds: Vec<&[&Warning]> = worst.chunk_by(|a, b| a.kind == b.kind).collect();
    html! {
        @if !warnings.is_empty() {
            section.trouble id="warnings" {
                h2 { (warnings.len()) (if warnings.len() == 1 { " warning" } else { " warnings" }) }
                @for kind in &kinds {
                    details {
                        summary {
                            (kind.len()) " × " (kind[0].kind.of_many()) " (" code { (kind[0].kind.as_str()) } ")"
                        }
                        (listed_warnings(&kind[..kind.len().min(MOST)]))
                        @if kind.len() > MOST { p.note { "and " (kind.len() - MOST) " more" } }
                    }
                }
                p.note { "The table " code { (pipeline) ".warnings" } " lists all warnings with their likely causes." }
            }
        }
    }
}

fn listed_warnings(warnings: &[&Warning]) -> Markup {
    let figure = |w: &Warning, of: Option<f64>| of.map(|value| with_unit(Some(value), w.unit)).unwrap_or_default();
    html! {
        div.scroll { table {
            thead {
                tr {
                    @for head in ["where", "what", "likely cause"] { th scope="col" { (head) } }
                    th.n scope="col" { "value" } th.n scope="col" { "limit" }
                }
            }
            tbody { @for w in warnings { tr data-kind=(w.kind.as_str()) {
                td { (w.stage) @if !w.place().is_empty() { ": " (w.place()) } }
                td { (w.text) } td { (w.cause.as_deref().unwrap_or("")) }
                td.n { (figure(w, w.value)) } td.n { (figure(w, w.limit)) }
            } } }
        } }
    }
}

fn plan(source: &ReportSource) -> Markup {
    let plan = source.graph.plan;
    html! {
        section id="plan" {
            h2 { "The plan" }
            p.lead { "Each box is a table: its name, its stage, its sweep points, and the number of its units in the \
                      store. A unit is one line, or one fit, at one point." }
            (flow::drawing(source))
            @if !plan.notes.is_empty() { ul.note { @for note in &plan.notes { li { (spelt(note)) } } } }
            details { summary { "The spec, " (plan.spec.file) } pre { code { (plan.spec.text) } } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gold_thousands_are_grouped() {
        assert_eq!([grouped(7), grouped(1000), grouped(1_234_567)], ["7", "1\u{202f}000", "1\u{202f}234\u{202f}567"]);
    }

    #[test]
    fn bug_samples_of_a_line_in_several_tables_were_added() {
        assert_eq!(samples([(0, 100), (1, 40), (0, 90), (0, 100)].into_iter()), 140);
    }

    #[test]
    fn gold_long_axes_are_cut_short() {
        assert_eq!(listed(&[1, 2, 3]), "1, 2, 3");
        let long = listed(&(1..=3000).collect::<Vec<i32>>());
        assert!(long.starts_with("1, 2, 3") && long.ends_with("23, 24 … 3000 (3000 values)"), "{long}");
    }
}
