//! The page: empty sections, which its scripts fill from the API.

use maud::{DOCTYPE, html};
use report::html::{SCRIPTS, page_foot, page_head};

use crate::ViewData;

/// The page as HTML. The page contains no data of the store; its scripts read the data afterwards.
pub fn page(data: &ViewData) -> String {
    let pipeline = data.spec.map(|spec| spec.pipeline);
    let title = pipeline.unwrap_or("Store");
    let mode = if data.spec.is_some() { "spec" } else { "store" };
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
                        @if let Some(spec) = data.spec { p.lead { "magline view of " code { (spec.file) } } }
                    }
                    noscript { p.note { "This page needs JavaScript. `magline report` writes a page that works without \
                                         JavaScript." } }
                    @if data.spec.is_some() { section.live id="live" data-src="api/run" { h2 { "Run" } } }
                    p.note id="sections" role="status" data-src="api/sections" { "The list of tables is loading." }
                    section.series id="series" { h2 { "Lines" } }
                    section.models id="models" { h2 { "Models" } }
                    section.maps id="maps" { h2 { "Maps" } }
                    section.lineage id="lineage" { h2 { "Lineage" } }
                    (page_foot(&[]))
                }
            }
        }
    };
    markup.into_string()
}
