//! Comparison of the report's run with an earlier run, as a block of JSON from which the script of the page draws.

use maud::{Markup, PreEscaped, html};
use serde_json::Value;

use super::explorer::escaped;

/// Comparison of the scores of a report with the scores of an earlier run.
pub struct ReportComparison {
    /// The earlier run, as the user named it.
    pub run: String,
    /// A block for each table of scores, made by [`report_against`](crate::view::report_against).
    pub blocks: Vec<Value>,
}

/// The section of a comparison.
pub fn section(comparison: &ReportComparison) -> Markup {
    let ReportComparison { run, blocks } = comparison;
    html! {
        section.against id="against" {
            h2 { "Comparison with run " (run) }
            noscript { p.note { "The comparison needs JavaScript." } }
            script type="application/json" { (PreEscaped(escaped(&Value::from(blocks.clone()).to_string()))) }
        }
    }
}
