//! The answer of each request.

use bytes::Bytes;
use report::view::ViewFault;
use serde_json::Value;

use crate::{
    ViewData,
    page::page,
    request::{DownloadFormat, ViewRequest},
    workers::AnswerBytes,
};

/// Media type of JSON.
pub const JSON: &str = "application/json";
/// Media type of an Arrow IPC stream.
const ARROW: &str = "application/vnd.apache.arrow.stream";
/// Media type of the page.
const HTML: &str = "text/html; charset=utf-8";

/// Text of a block, which several answers share.
struct SharedText(std::sync::Arc<String>);

impl AsRef<[u8]> for SharedText {
    fn as_ref(&self) -> &[u8] {
        self.0.as_bytes()
    }
}

fn json(value: &Value) -> AnswerBytes {
    (value.to_string().into(), JSON)
}

/// Answers a request.
///
/// # Errors
/// Fails for unknown tables and wrong values. Also fails if the store is damaged.
pub fn answer(data: &ViewData, request: &ViewRequest) -> Result<AnswerBytes, ViewFault> {
    let store = data.store;
    Ok(match request {
        ViewRequest::Page => (page(data).into(), HTML),
        ViewRequest::Catalogue => {
            let mut all = store.catalogue();
            all["mode"] = if data.run.is_some() { "spec".into() } else { "store".into() };
            all["pipeline"] = data.run.map(|run| run.pipeline()).into();
            all["spec"] = data.run.map(|run| run.spec()).into();
            json(&all)
        }
        ViewRequest::Lines(table, point) => json(&store.lines(table, point)?),
        ViewRequest::Series(series) => (store.series(series)?.into(), ARROW),
        ViewRequest::Scores(table) => (Bytes::from_owner(SharedText(store.scores(table)?)), JSON),
        ViewRequest::Against(table, against, run) => json(&store.against(table, against, run.as_deref())?),
        ViewRequest::Run => match data.run {
            Some(run) => {
                let mut state = run.json()?;
                state["changed"] = store.changed().into();
                json(&state)
            }
            None => json(&store.runs()),
        },
        ViewRequest::Map(table, point, pixels, band) => json(&store.map(table, point, *pixels, *band)?),
        ViewRequest::Profile(table, point, ends) => json(&store.profile(table, point, *ends)?),
        ViewRequest::Spectrum(series) => json(&store.spectrum(series)?),
        ViewRequest::Coast(region) => json(&store.coast(*region)?),
        ViewRequest::Lineage(table) => json(&store.lineage(table)?),
        ViewRequest::Download(table, format) => {
            let query = store.download_query(table, *format == DownloadFormat::Csv)?;
            let mut arguments = vec![if query.is_some() { "sql" } else { "export" }.to_owned(), "--store".to_owned()];
            arguments.push(store.root().to_string_lossy().into_owned());
            if query.is_some() {
                arguments.extend(["--format".to_owned(), format.extension().to_owned()]);
            }
            arguments.extend(["--".to_owned(), query.unwrap_or_else(|| table.clone())]);
            json(&arguments.into())
        }
    })
}
