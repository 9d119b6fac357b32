//! `magline report`: a run as one page of tables and plots that needs only a browser, or the run's tracks for Google
//! Earth.
//!
//! Data are read column by column and line by line, so that memory use does not grow with the sweep. The page contains
//! no time, host name or path, so the same store and spec give the same bytes.

mod against;
mod answer;
mod atlas;
mod beeswarm;
mod board;
mod by_line;
mod earth;
mod errors;
mod explorer;
mod figure_files;
mod figure_legend;
mod flow;
mod importance;
mod intervals;
mod known;
mod model;
mod page;
mod plain_text;
mod published;
mod quality;
mod scripts;
mod search;
mod series;
mod signal;
mod source;
mod spectra;
mod subject;
mod table;
mod timeline;
mod track;
mod training;
mod variation;
mod whiteness;

use std::{fs, path::Path};

use maud::{Markup, html};
use plan::{PlanGraph, TableRef, spec::Spec};
use results::warnings::{self, Warning};
use schemas::{Fault, InputKind};
use store::Store;

pub use against::ReportComparison;
use atlas::{Atlas, AtlasTracks, atlases};
pub(crate) use board::{MoreScores, ScoreBoard};
pub use earth::{TrackSelection, kml};
pub(crate) use explorer::{LineScores, block as score_block, metric_json, rows as score_rows};
pub use figure_files::{FigureFile, figure_files, figure_list};
pub use page::{page_foot, page_head};
pub use scripts::{PageScript, SCRIPTS, STYLE};
use source::ReportSource;
use subject::{ReportLine, ReportSubject};
use track::LineTracks;
pub(crate) use training::LossCurve;

/// Checks that `spec` has a store to report on, without creating one.
///
/// # Errors
/// Fails if it has not been run.
pub fn was_run(spec: &Spec) -> Result<(), Fault> {
    store::pulled(&spec.store)?;
    if spec.store.join("tables").join(&spec.name).is_dir() { Ok(()) } else { Err(not_run(spec)) }
}

/// Whether the last run in `store` was of exactly this plan and data.
pub fn is_current(graph: &PlanGraph, store: &Store) -> bool {
    published::is_current(&ReportSource::new(graph, store))
}

fn not_run(spec: &Spec) -> Fault {
    let what = format!("there is nothing to report: {} has not been run", spec.file);
    Fault::new(what).help(format!("run the spec first: `magline run {}`", spec.file))
}

/// The report of the plan's results in `store`, as HTML.
///
/// # Errors
/// Fails if there are no results of the plan, or the store is damaged.
pub fn report(graph: &PlanGraph, store: &Store) -> Result<String, Fault> {
    report_with(graph, store, None)
}

/// The report with a comparison of its scores with the scores of an earlier run.
///
/// # Errors
/// Returns the errors of [`report`].
pub fn report_with(graph: &PlanGraph, store: &Store, against: Option<&ReportComparison>) -> Result<String, Fault> {
    let source = ReportSource::new(graph, store);
    let RunScores { current, warnings, boards } = scored(&source)?;
    let mut sections: Vec<Markup> = vec![];
    let mut left = explorer::BUDGET;
    for board in &boards {
        sections.push(explorer::section(&source, board, &warnings, &mut left)?);
    }
    if let Some(against) = against {
        sections.push(against::section(against));
    }
    sections.extend(series::section(&source, &boards, &mut left)?);
    if current {
        sections.extend(search::section(&source)?);
    }
    for board in &boards {
        sections.push(table::section(&source, board, by_line::tables(&source, board, &warnings)?));
    }
    sections.extend(intervals::sections(&source)?);
    sections.extend(training::section(&source)?);
    sections.extend(importance::section(&source)?);
    let (groups, more) = groups(&source, &boards, NAVIGATIONS)?;
    let over = groups.iter().map(|g| over(&source, g)).collect::<Result<Vec<AtlasTracks>, Fault>>()?;
    let (atlases, defs) = atlases(&source, &over)?;
    for (group, atlas) in groups.iter().zip(&atlases) {
        for subject in &group.subjects {
            let best = group.subjects.first().unwrap_or(subject);
            let labels = group.lines.iter().map(|l| subject::label(&source, subject, l, best));
            let labels = labels.collect::<Result<Vec<String>, Fault>>()?;
            sections.extend(detail(&source, subject, &group.lines, &labels, atlas.as_ref())?);
        }
    }
    if more > 0 {
        sections.push(html! { p.note { "Navigation: " (more) " more tables are not shown in detail." } });
    }
    let subjects = groups.first().map(|g| g.subjects.as_slice()).unwrap_or_default();
    sections.extend(variation::section(&source, subjects.first().and_then(|s| s.fit))?);
    sections.extend(quality::section(&source)?);
    // Like the published tables, the recorded failures belong to the last run.
    let failures = if current { source.failures()? } else { vec![] };
    let answer = answer::section(&source, &boards, &warnings, failures.iter().map(|f| f.times).sum())?;
    let alerts = page::ReportAlerts { answer, failures, warnings, outdated: !current };
    Ok(page::page(&source, &alerts, defs, &sections))
}

/// The scores of a run.
struct RunScores {
    /// Whether the published tables are of this spec and its data.
    current: bool,
    warnings: Vec<Warning>,
    boards: Vec<ScoreBoard>,
}

/// Reads the scores.
fn scored(source: &ReportSource) -> Result<RunScores, Fault> {
    let (graph, store) = (source.graph, source.store);
    if (0..graph.plan.tables.len()).all(|t| source.present(t).0 == 0) && source.failures()?.is_empty() {
        return Err(not_run(&graph.plan.spec));
    }
    let current = published::is_current(source);
    let written = if current { warnings::written(graph.plan, store)? } else { None };
    // Results are read by key, so they belong to this plan even if the published tables do not.
    let warnings = written.map_or_else(|| warnings::present(graph, store), Ok)?;
    let boards = if current { ScoreBoard::all(source, &warnings)? } else { vec![] };
    Ok(RunScores { current, warnings, boards })
}

/// Writes `bytes` to `path`: under a temporary name first, so that it appears complete.
///
/// # Errors
/// Fails on errors of the file system.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Fault> {
    let refused = |e: std::io::Error| Fault::machine(format!("cannot write {}: {e}", path.display()));
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.tmp", std::process::id()));
    let tmp = path.with_file_name(name);
    fs::write(&tmp, bytes).and_then(|()| fs::rename(&tmp, path)).map_err(|e| {
        let _ = fs::remove_file(&tmp);
        refused(e)
    })
}

/// Maximum number of tables of `navigate` that are shown in addition to the table from which the first scores were
/// computed.
const NAVIGATIONS: usize = 4;

/// Sweep points shown over the same lines.
struct SubjectGroup {
    subjects: Vec<ReportSubject>,
    lines: Vec<ReportLine>,
}

/// The best and the worst point of the first score table, then at most `most` other navigations; and the number of
/// omitted navigations.
fn groups(source: &ReportSource, boards: &[ScoreBoard], most: usize) -> Result<(Vec<SubjectGroup>, usize), Fault> {
    let subjects = subject::subjects(source, boards);
    let (others, more) = subject::navigations(source, boards, &subjects, most);
    let lines = subjects.first().map_or(Ok(vec![]), |first| subject::lines(source, first))?;
    let mut groups = vec![SubjectGroup { subjects, lines }];
    for subject in others {
        let lines = subject::few_lines(source, &subject)?;
        groups.push(SubjectGroup { subjects: vec![subject], lines });
    }
    Ok((groups, more))
}

/// The map under the lines of a group, and the tracks of the lines.
fn over(source: &ReportSource, group: &SubjectGroup) -> Result<AtlasTracks, Fault> {
    let Some((subject, TableRef::Stage(t, i))) = group.subjects.iter().find_map(|s| s.navigate.map(|r| (s, r))) else {
        return Ok((None, vec![]));
    };
    let mut tracks = vec![];
    for shown in &group.lines {
        if let Some(line_tracks) = LineTracks::read(source, subject, shown.line)? {
            tracks.push(line_tracks.truth.or(line_tracks.ins).unwrap_or(line_tracks.estimate));
        }
    }
    let node = &source.graph.plan.tables[t];
    Ok((node.inputs(i).find(|(kind, _)| *kind == InputKind::Map).map(|(_, r)| r), tracks))
}

/// One sweep point: its plots, a panel per line, and its model; `None` if the point has none of these.
fn detail(
    source: &ReportSource,
    subject: &ReportSubject,
    lines: &[ReportLine],
    labels: &[String],
    atlas: Option<&Atlas>,
) -> Result<Option<Markup>, Fault> {
    let mut panels = vec![];
    for (shown, label) in lines.iter().zip(labels) {
        let plots = line(source, subject, shown, atlas)?;
        if !plots.is_empty() {
            panels.push((label, plots));
        }
    }
    let model = model::table(source, subject)?;
    if panels.is_empty() && model.is_none() {
        return Ok(None);
    }
    Ok(Some(html! {
        section.detail id=(&subject.id) {
            h2 { (subject.title) }
            p.lead { @if !subject.point.is_empty() { strong { (subject.point) } ": " } (subject.why) "." }
            div.panels {
                @if panels.len() > 1 { div.tabs { @for (label, _) in &panels { button type="button" { (label) } } } }
                @for (label, plots) in &panels { div.panel { h3 { (label) } @for plot in plots { (plot) } }
                }
            }
            @if let Some(model) = model { (model) }
        }
    }))
}

/// The plots of one line.
fn line(
    source: &ReportSource,
    subject: &ReportSubject,
    shown: &ReportLine,
    atlas: Option<&Atlas>,
) -> Result<Vec<Markup>, Fault> {
    let mut plots = signal::plots(source, subject, shown.line)?;
    plots.extend(known::plots(source, subject, shown.line)?);
    if let Some(line_tracks) = LineTracks::read(source, subject, shown.line)? {
        plots.extend(atlas.map(|a| a.plots(&line_tracks)));
        let updates = match subject.navigate {
            Some(r) => source.tally(r, shown.line, "update")?,
            None => Default::default(),
        };
        let place = subject::place(source, subject, shown.line);
        plots.extend(errors::plots(&line_tracks, &place, &updates));
        plots.extend(whiteness::plot(&line_tracks, &place));
    }
    plots.extend(spectra::plots(source, subject, shown.line)?);
    Ok(plots)
}

#[cfg(test)]
mod tests;
