//! Series of the most important points and lines, embedded in the page: the best point on its worst, median and best
//! line, flagged points on their worst line, and the first point on its median line.
//!
//! Each block is an Arrow IPC stream, compressed with gzip and written in base64. A block has the format of the series
//! of `magline view`.

use std::{
    collections::{BTreeMap, HashMap},
    io::Write,
    sync::Arc,
};

use base64::{Engine, prelude::BASE64_STANDARD};
use flate2::{Compression, write::GzEncoder};
use maud::{Markup, PreEscaped, html};
use numerics::earth::geodesy::EarthModel;
use plan::{LineId, TableRef};
use schemas::{Column, ColumnType, Fault, Role};
use serde_json::{Value, json};

use super::{
    board::ScoreBoard,
    source::ReportSource,
    subject::{self, ReportSubject},
    track::DegreeTrack,
};
use crate::coast::{GeographicRegion, flat_coastlines};
use crate::series::{DerivedColumn, SeriesColumn, SeriesPrecision, SeriesWindow, list_element, series};

/// Minimum margin around the tracks in which coastlines are embedded, in degrees.
const COAST_MARGIN: f64 = 0.2;
/// Maximum size of the coastlines, in bytes.
const COAST_BYTES: usize = 120_000;
/// Number of intervals into which the rows of a block are divided.
const INTERVALS: usize = 2000;
/// Maximum number of flagged points.
const FLAGGED: usize = 2;
/// Maximum number of currents; the currents with the largest ranges are embedded.
const CURRENTS: usize = 3;
/// Name of the list entry with the weight of the most probable mode.
const FIRST_WEIGHT: &str = "weight_1";
/// Columns of the attitude; the first group that a table has is shown.
const ATTITUDE: [[&str; 3]; 2] = [["roll", "pitch", "yaw"], ["ins_roll", "ins_pitch", "ins_yaw"]];

/// The section; `None` without a line. Subtracts the size of the section from `left`, in bytes.
///
/// # Errors
/// Fails if the store is damaged.
pub fn section(source: &ReportSource, boards: &[ScoreBoard], left: &mut usize) -> Result<Option<Markup>, Fault> {
    let (mut blocks, mut omitted, mut described) = (vec![], vec![], vec![]);
    let mut places: Vec<(f64, f64)> = vec![];
    for choice in choices(source, boards)? {
        for table in [compensation(source, &choice)?, navigation(source, &choice)?].into_iter().flatten() {
            let id = format!("series-{}", blocks.len());
            let (mut text, mut about) = block(source, &choice, &table, &id)?;
            if text.len() > *left && table.has_elements() {
                let name = source.graph.plan.name_of(table.at);
                omitted.push(format!("modes of {name} at {}: no space left", choice.words(source)));
                (text, about) = block(source, &choice, &table.without_elements(), &id)?;
            }
            if text.len() > *left {
                omitted.push(format!(
                    "{} at {}: no space left",
                    source.graph.plan.name_of(table.at),
                    choice.words(source)
                ));
                continue;
            }
            *left -= text.len();
            places.extend(table.places());
            blocks.push((id, text));
            described.push(about);
        }
    }
    let region = GeographicRegion::around(places.into_iter()).map(|region| region.widened(COAST_MARGIN));
    let coast = region.map(flat_coastlines).filter(|lines| !lines.is_empty()).map(|lines| json!(lines).to_string());
    let fits = coast.as_ref().is_none_or(|text| text.len() <= (*left).min(COAST_BYTES));
    let coast = coast.filter(|_| fits);
    *left -= coast.as_ref().map_or(0, String::len);
    if !fits {
        omitted.push("coastlines: the region of the tracks is too large".to_owned());
    }
    let index = json!({ "blocks": described, "omitted": omitted }).to_string().replace('<', "\\u003c");
    Ok((!blocks.is_empty()).then(|| {
        html! {
            section.series id="series" {
                h2 { "Lines" }
                script type="application/json" class="series-index" { (PreEscaped(index)) }
                @if let Some(coast) = &coast { script type="application/json" class="coast" { (PreEscaped(coast)) } }
                @for (id, text) in &blocks {
                    script type="application/vnd.apache.arrow.stream+gzip" id=(id) { (PreEscaped(text)) }
                }
            }
        }
    }))
}

/// A line at a sweep point, and the reasons for its choice.
struct SeriesChoice {
    subject: ReportSubject,
    point: BTreeMap<String, String>,
    line: LineId,
    why: Vec<String>,
}

impl SeriesChoice {
    fn words(&self, source: &ReportSource) -> String {
        subject::place(source, &self.subject, self.line)
    }
}

/// The columns of one table.
struct SeriesTable {
    at: TableRef,
    tt: Vec<f64>,
    columns: Vec<SeriesColumn>,
}

impl SeriesTable {
    /// Whether the table has columns that are elements of lists.
    fn has_elements(&self) -> bool {
        self.columns.iter().any(|c| list_element(&c.name).is_some())
    }

    /// The table without columns that are elements of lists.
    fn without_elements(&self) -> SeriesTable {
        let columns = self.columns.iter().filter(|c| list_element(&c.name).is_none()).cloned().collect();
        SeriesTable { at: self.at, tt: self.tt.clone(), columns }
    }

    /// Latitudes and longitudes of the table's rows in degrees: the truth or, without a truth, the estimates; empty
    /// without these columns. The truth is preferred because a diverged estimate may be anywhere.
    fn places(&self) -> Vec<(f64, f64)> {
        let values = |name: &str| self.columns.iter().find(|c| c.name == name).map(|c| &c.values);
        let pair = |lat, lon| values(lat).zip(values(lon));
        let pair = pair("truth_lat", "truth_lon").or_else(|| pair("lat", "lon"));
        pair.map(|(lat, lon)| lat.iter().copied().zip(lon.iter().copied()).collect()).unwrap_or_default()
    }
}

/// The names of the elements of a list.
fn terms(column: &Column) -> Option<&Vec<String>> {
    match &column.column_type {
        ColumnType::List(terms) => Some(terms),
        _ => None,
    }
}

/// The lines and points of the page, each once, the most important first.
fn choices(source: &ReportSource, boards: &[ScoreBoard]) -> Result<Vec<SeriesChoice>, Fault> {
    let mut found: Vec<((usize, usize), SeriesChoice)> = vec![];
    for (b, board) in boards.iter().enumerate() {
        let Some(metric) = board.headline() else { continue };
        let ranked = board.ranked(metric);
        let Some(best) = ranked.first().copied() else { continue };
        let flagged = ranked.iter().copied().filter(|row| *row != best && board.marked(*row) > 0).take(FLAGGED);
        let rows = [(best, "best point", vec!["median line", "best line", "worst line"])].into_iter();
        let rows = rows.chain(flagged.map(|row| (row, "flagged point", vec!["worst line"])));
        let rows = rows.chain(ranked.contains(&0).then(|| (0, "first point", vec!["median line"])));
        for (row, point, places) in rows {
            let scored = subject::subject(source, (board, metric), "", "", row);
            let lines = subject::scored_lines(source, &scored)?;
            for place in places {
                let at = match place {
                    "median line" => lines.len() / 2,
                    "best line" => 0,
                    _ => lines.len().saturating_sub(1),
                };
                let Some(line) = lines.get(at).copied() else { continue };
                let why = [point.to_owned(), place.to_owned()];
                if let Some((_, known)) = found.iter_mut().find(|(at, c)| *at == (b, row) && c.line == line) {
                    let new: Vec<String> = why.into_iter().filter(|w| !known.why.contains(w)).collect();
                    known.why.extend(new);
                    continue;
                }
                let subject = subject::subject(source, (board, metric), "", "", row);
                let key = board.scores.rows.get(row).map(|(key, _)| key.clone()).unwrap_or_default();
                let point = board.scores.axes.iter().cloned().zip(key).collect();
                found.push(((b, row), SeriesChoice { subject, point, line, why: why.to_vec() }));
            }
        }
    }
    Ok(found.into_iter().map(|(_, choice)| choice).collect())
}

/// Reader of the columns of one table and line.
struct ColumnReader<'a> {
    source: &'a ReportSource<'a>,
    at: TableRef,
    line: LineId,
    rows: usize,
    columns: Vec<SeriesColumn>,
}

impl<'a> ColumnReader<'a> {
    /// The reader, and the times; `None` if the line has no times.
    fn new(source: &'a ReportSource<'a>, at: TableRef, line: LineId) -> Result<Option<(Self, Vec<f64>)>, Fault> {
        let Some(tt) = source.floats(at, line, "tt")? else { return Ok(None) };
        Ok(Some((ColumnReader { source, at, line, rows: tt.len(), columns: vec![] }, tt)))
    }

    /// The values of a column with one value per row.
    fn read(&self, name: &str) -> Result<Option<Vec<f64>>, Fault> {
        Ok(self.source.floats(self.at, self.line, name)?.filter(|values| values.len() == self.rows))
    }

    /// Adds a column of the table, if the table has it.
    fn add(&mut self, name: &str) -> Result<(), Fault> {
        if self.columns.iter().any(|c| c.name == name) {
            return Ok(());
        }
        let about = self.source.shape(self.at).and_then(|shape| shape.get(name)).cloned();
        if let (Some(values), Some(about)) = (self.read(name)?, about) {
            self.push(&about, values);
        }
        Ok(())
    }

    fn push(&mut self, about: &Column, values: Vec<f64>) {
        self.columns.push(SeriesColumn {
            name: about.name.clone(),
            unit: about.unit.clone(),
            role: about.role.as_str().to_owned(),
            description: about.doc.clone(),
            values: Arc::new(values),
        });
    }

    /// Adds a column that is computed from others.
    fn derived(&mut self, column: DerivedColumn, values: Vec<f64>) {
        if values.len() == self.rows {
            self.columns.push(column.series(values));
        }
    }

    /// Adds a coordinate of the INS, which is a column of another table.
    fn ins(&mut self, name: &str, description: &str, values: &[f64]) {
        if values.len() == self.rows {
            self.columns.push(SeriesColumn {
                name: name.to_owned(),
                unit: "deg".to_owned(),
                role: Role::Sensor.as_str().to_owned(),
                description: description.to_owned(),
                values: Arc::new(values.to_vec()),
            });
        }
    }

    /// Adds the modes of a particle filter that exist on this line, if the filter saves them.
    fn modes(&mut self) -> Result<(), Fault> {
        let mut listed = self.source.shape(self.at).into_iter().flat_map(|shape| shape.columns.iter());
        let has_modes = |c: &&Column| terms(c).is_some_and(|terms| terms.iter().any(|t| t == FIRST_WEIGHT));
        let Some(column) = listed.find(has_modes).cloned() else { return Ok(()) };
        let elements = self.source.elements(self.at, self.line, &column.name)?.unwrap_or_default();
        for (i, values) in elements.into_iter().enumerate() {
            if values.len() == self.rows && values.iter().any(|v| v.is_finite()) {
                self.push(&Column { name: format!("{}[{i}]", column.name), ..column.clone() }, values);
            }
        }
        Ok(())
    }

    /// Adds the attitude and the currents with the largest ranges.
    fn surroundings(&mut self) -> Result<(), Fault> {
        let Some(shape) = self.source.shape(self.at) else { return Ok(()) };
        let names: Vec<String> = shape.columns.iter().map(|c| c.name.clone()).collect();
        if let Some(attitude) = ATTITUDE.iter().find(|all| all.iter().all(|name| names.iter().any(|n| n == name))) {
            attitude.iter().try_for_each(|name| self.add(name))?;
        }
        let mut currents = vec![];
        for name in names.iter().filter(|name| name.starts_with("cur_")) {
            let values = self.read(name)?.unwrap_or_default();
            let finite = values.iter().filter(|v| v.is_finite());
            let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
            if high > low {
                currents.push((high - low, name));
            }
        }
        currents.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(b.1)));
        currents.iter().take(CURRENTS).try_for_each(|(_, name)| self.add(name))
    }
}

/// The signal before and after compensation, with the truth, the attitude and the currents.
fn compensation(source: &ReportSource, choice: &SeriesChoice) -> Result<Option<SeriesTable>, Fault> {
    let Some(at @ TableRef::Stage(t, i)) = choice.subject.compensate else { return Ok(None) };
    let Some((mut reader, tt)) = ColumnReader::new(source, at, choice.line)? else { return Ok(None) };
    let params = source.graph.plan.instance(t, i).params();
    let mag = params.iter().find(|(name, _)| *name == "mag").and_then(|(_, value)| subject::word(value));
    let truth = choice.subject.truth.clone();
    for name in mag.iter().chain(truth.iter()).map(String::as_str).chain(["mag_c"]) {
        reader.add(name)?;
    }
    if let (Some(truth), Some(own)) =
        (truth.map(|name| reader.read(&name)).transpose()?.flatten(), reader.read("mag_c")?)
    {
        let error = own.iter().zip(&truth).map(|(own, truth)| own - truth).collect();
        reader.derived(DerivedColumn::Field, error);
    }
    reader.surroundings()?;
    Ok(Some(SeriesTable { at, tt, columns: reader.columns }))
}

/// The track with its errors and the innovations.
fn navigation(source: &ReportSource, choice: &SeriesChoice) -> Result<Option<SeriesTable>, Fault> {
    let Some(at) = choice.subject.navigate else { return Ok(None) };
    let Some((mut reader, tt)) = ColumnReader::new(source, at, choice.line)? else { return Ok(None) };
    ["lat", "lon", "sd_n", "sd_e", "residual", "nis"].iter().try_for_each(|name| reader.add(name))?;
    reader.modes()?;
    let Some(tracks) = super::track::LineTracks::read(source, &choice.subject, choice.line)? else {
        return Ok(Some(SeriesTable { at, tt, columns: reader.columns }));
    };
    if let Some(DegreeTrack { lat, lon }) = &tracks.truth {
        reader.derived(DerivedColumn::Truth(0), lat.clone());
        reader.derived(DerivedColumn::Truth(1), lon.clone());
    }
    if let Some(DegreeTrack { lat, lon }) = &tracks.ins {
        reader.ins("ins_lat", "INS latitude", lat);
        reader.ins("ins_lon", "INS longitude", lon);
    }
    if let Some(truth) = &tracks.truth {
        let from = |track: &DegreeTrack| -> (Vec<f64>, Vec<f64>) {
            let pairs = track.places().zip(truth.places());
            pairs.map(|(own, truth)| EarthModel::default().offset_ne_m(own, truth, 0.0)).unzip()
        };
        let (north, east) = from(&tracks.estimate);
        reader.derived(DerivedColumn::Estimate(0), north);
        reader.derived(DerivedColumn::Estimate(1), east);
        if let Some(ins) = &tracks.ins {
            let (north, east) = from(ins);
            reader.derived(DerivedColumn::Ins(0), north);
            reader.derived(DerivedColumn::Ins(1), east);
        }
    }
    if choice.subject.compensate.is_none() {
        reader.surroundings()?;
    }
    Ok(Some(SeriesTable { at, tt, columns: reader.columns }))
}

/// The text of a block, and its entry in the index.
fn block(
    source: &ReportSource,
    choice: &SeriesChoice,
    table: &SeriesTable,
    id: &str,
) -> Result<(String, Value), Fault> {
    let plan = source.graph.plan;
    let (name, (flight, line)) = (plan.name_of(table.at), &source.graph.lines[choice.line]);
    let about = HashMap::from([
        ("table".to_owned(), name.to_owned()),
        ("flight".to_owned(), flight.clone()),
        ("line".to_owned(), line.clone()),
        ("point".to_owned(), json!(choice.point).to_string()),
    ]);
    let window = SeriesWindow { from: f64::NEG_INFINITY, to: f64::INFINITY, pixels: INTERVALS };
    let made = series(&table.tt, &table.columns, window, SeriesPrecision::Compact, about)?;
    let stream = made.stream()?;
    let failed = |e: std::io::Error| Fault::machine(format!("cannot compress a series: {e}"));
    let mut encoder = GzEncoder::new(vec![], Compression::default());
    encoder.write_all(&stream).map_err(failed)?;
    let text = BASE64_STANDARD.encode(encoder.finish().map_err(failed)?);
    let shape = source.shape(table.at);
    let column = |(c, error): (&SeriesColumn, &f64)| {
        let SeriesColumn { name, unit, role, description, .. } = c;
        let mut made =
            json!({ "name": name, "unit": unit, "role": role, "description": description, "resolution": error });
        if let Some((list, at)) = list_element(name)
            && let Some(term) = shape.and_then(|shape| terms(shape.get(list)?)?.get(at))
        {
            made["term"] = json!(term);
        }
        made
    };
    let stage = match table.at {
        TableRef::Stage(t, _) => plan.tables[t].entry.name,
        TableRef::Flights(_) | TableRef::Map(_) => "",
    };
    let end = |t: Option<&f64>| t.copied().filter(|t| t.is_finite());
    let described = json!({
        "id": id, "table": name, "kind": "samples", "stage": stage, "flight": flight, "line": line,
        "point": choice.point, "why": choice.why, "rows": table.tt.len(), "thinned": made.is_thinned,
        "bytes": text.len(),
        "first": end(table.tt.first()), "last": end(table.tt.last()),
        "columns": table.columns.iter().zip(&made.errors).map(column).collect::<Vec<_>>(),
    });
    Ok((text, described))
}
