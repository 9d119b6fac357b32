//! The page: empty sections, which its scripts fill from the API.

use maud::{DOCTYPE, html};
use report::html::{SCRIPTS, page_foot, page_head};

use crate::ViewData;

/// The page as HTML.
pub fn page(data: &ViewData) -> String {
    let title = data.run.map_or("Store", |run| run.pipeline());
    let scores = match data.run {
        Some(run) => run.score_tables(),
        None => data.store.score_tables(),
    };
    let mode = if data.run.is_some() { "spec" } else { "store" };
    let pipeline = data.run.map(|run| run.pipeline());
    let all = data.store.pipelines();
    let runs = match pipeline {
        Some(name) => data.store.last_runs([name].into_iter()),
        None => data.store.last_runs(all.iter().map(String::as_str)),
    };
    let source = |table: &str| {
        let query = url::form_urlencoded::Serializer::new(String::new()).append_pair("table", table).finish();
        format!("api/scores?{query}")
    };
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                (page_head(&format!("{title} – magline view")))
                link rel="stylesheet" href="web/style.css";
                @for script in SCRIPTS { script src=(format!("web/{}", script.name)) defer {} }
            }
            body data-api="api/" data-mode=(mode) data-pipeline=[pipeline] {
                main {
                    header {
                        h1 { (title) }
                        @if let Some(run) = data.run { p.lead { "magline view of " code { (run.spec()) } } }
                    }
                    noscript { p.note { "This page needs JavaScript. `magline report` writes a page that works \
                                         without it." } }
                    @if data.run.is_some() { section.live id="live" data-src="api/run" { h2 { "Run" } } }
                    @for table in &scores {
                        section.explorer id=(format!("explore-{table}")) data-table=(table) data-src=(source(table)) {
                            h2 { "Explore: " (table) }
                        }
                    }
                    @if !scores.is_empty() { section.against id="against" { h2 { "Compare runs" } } }
                    section.series id="series" { h2 { "Lines" } }
                    section.maps id="maps" { h2 { "Maps" } }
                    section.lineage id="lineage" { h2 { "Lineage" } }
                    (page_foot(&runs))
                }
            }
        }
    };
    markup.into_string()
}
