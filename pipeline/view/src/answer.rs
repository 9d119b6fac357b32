//! The answer of each request.

use bytes::Bytes;
use report::view::ViewFault;
use serde_json::Value;

use crate::{
    ViewData,
    request::{DownloadFormat, ViewRequest},
    workers::AnswerBytes,
};

/// Media type of JSON.
pub const JSON: &str = "application/json";
/// Media type of an Arrow IPC stream.
const ARROW: &str = "application/vnd.apache.arrow.stream";

/// Text of a block; several answers can share the text.
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
        ViewRequest::Sections => json(&store.sections(data.spec.map(|spec| spec.pipeline))),
        ViewRequest::Catalogue => {
            let mut all = store.catalogue();
            all["mode"] = if data.spec.is_some() { "spec".into() } else { "store".into() };
            all["pipeline"] = data.spec.map(|spec| spec.pipeline).into();
            all["spec"] = data.spec.map(|spec| spec.file).into();
            json(&all)
        }
        ViewRequest::Lines(table, point) => json(&store.lines(table, point)?),
        ViewRequest::Series(series) => (store.series(series)?.into(), ARROW),
        ViewRequest::Scores(table) => (Bytes::from_owner(SharedText(store.scores(table)?)), JSON),
        ViewRequest::Against(table, against, run) => json(&store.against(table, against, run.as_deref())?),
        ViewRequest::Run => match (data.run, data.spec) {
            (Some(run), _) => {
                let mut state = run.json()?;
                state["changed"] = store.changed().into();
                json(&state)
            }
            (None, Some(spec)) => json(&store.before_plan(spec.pipeline, spec.file)),
            (None, None) => json(&store.runs()),
        },
        ViewRequest::Map(table, point, pixels, band) => json(&store.map(table, point, *pixels, *band)?),
        ViewRequest::Profile(table, point, ends) => json(&store.profile(table, point, *ends)?),
        ViewRequest::Spectrum(series) => json(&store.spectrum(series)?),
        ViewRequest::Coast(region) => json(&store.coast(*region)?),
        ViewRequest::Lineage(table) => json(&store.lineage(table)?),
        ViewRequest::Training(table, point) => json(&store.training(table, point)?),
        ViewRequest::Importance(table, point) => json(&store.importance(table, point)?),
        ViewRequest::Parameters(pipeline) => json(&store.parameters(pipeline)?),
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
