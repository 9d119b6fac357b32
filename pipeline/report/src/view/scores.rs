//! The scores of a table for the explorer, from the published tables `scores_pooled`, `warnings` and the scores of
//! lines.

use std::{collections::HashMap, sync::Arc};

use arrow_array::{
    Array, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use plan::IN_SAMPLE;
use results::{
    pooled,
    scores::{InSampleScores, Scores},
    warnings::WarningKind,
};
use schemas::{Fault, metric::Metric};

use super::{
    PublishedPipeline, StoreView, ViewFault, locked,
    notes::NotedTable,
    table::{ViewTable, Words, positions},
};
use crate::html::{LineScores, MoreScores, ScoreBoard, score_block, score_rows};

/// Maximum size of an answer, in bytes.
const BUDGET: usize = 120_000_000;
/// The scores of single lines are read only if the table has at most this number of rows.
const MOST_ROWS: usize = 4_000_000;
/// Maximum total size of all cached answers, in bytes.
const HELD_BYTES: usize = 96 << 20;

/// Cached answers, each with its table, its version and its text.
pub type HeldBlocks = Vec<(String, u64, Arc<String>)>;

/// One metric at one point.
pub(super) struct PooledCell {
    /// Position of the point.
    pub point: usize,
    /// Position of the metric.
    pub metric: usize,
    /// Value over the held-out lines or, if there are none, over the in-sample lines.
    pub value: Option<f64>,
    /// Number of samples or pairs from which the value is computed.
    pub n: usize,
    /// Number of lines over which the value is pooled.
    pub lines: usize,
    /// Whether the value is computed from in-sample lines.
    pub in_sample: bool,
    value_in_sample: Option<f64>,
    lines_in_sample: usize,
}

/// Scores of a table by point.
#[derive(Default)]
pub(super) struct PooledScores {
    /// Values of each axis.
    pub axes: Vec<Words>,
    /// Points, each as the positions of its axis values in `axes`.
    pub points: Vec<Vec<u32>>,
    known: HashMap<Vec<u32>, usize>,
    /// Names of the metrics.
    pub metrics: Words,
    /// The scores.
    pub cells: Vec<PooledCell>,
}

/// The flagged lines of each point. The value is `true` if the filter is wrong on the line, and not only cautious.
pub(super) type FlaggedLines = HashMap<(usize, String, String), bool>;

impl StoreView {
    /// The block of the explorer for the scores of a table.
    ///
    /// # Errors
    /// Fails for a table without scores. Also fails if the store is damaged.
    pub fn scores(&self, name: &str) -> Result<Arc<String>, ViewFault> {
        let (pipeline, table) = self.table(name)?;
        let version = pipeline.version.number;
        let held =
            |blocks: &HeldBlocks| blocks.iter().find(|(n, v, _)| n == name && *v == version).map(|b| b.2.clone());
        if let Some(block) = held(&locked(&self.blocks)) {
            return Ok(block);
        }
        let short = name.split_once('.').map_or(name, |(_, short)| short);
        let columns = || pooled::COLUMNS.iter().map(|(column, _)| *column);
        let is_scores = pipeline.notes.table(short).is_some_and(NotedTable::is_scores);
        if !is_scores || table.axes.iter().any(|axis| columns().any(|column| column == axis)) {
            let fault = Fault::new(format!("`{name}` has no pooled scores"));
            return Err(ViewFault::Wrong(fault.help("name a table of kind `scores`, as listed by `api/catalogue`")));
        }
        let block = Arc::new(self.block(&pipeline, &table, short)?);
        let mut blocks = locked(&self.blocks);
        blocks.retain(|(n, ..)| n != name);
        let bytes: usize = blocks.iter().map(|b| b.2.len()).sum();
        if bytes + block.len() > HELD_BYTES {
            blocks.clear();
        }
        if block.len() <= HELD_BYTES {
            blocks.push((name.to_owned(), version, block.clone()));
        }
        Ok(block)
    }

    fn block(&self, pipeline: &PublishedPipeline, table: &ViewTable, short: &str) -> Result<String, ViewFault> {
        let pooled = PooledScores::read(&*pipeline.table(pooled::TABLE)?, &table.axes, short)?;
        let flagged = flagged(pipeline, &pooled, &table.axes, short)?;
        let board = pooled.board(table.axes.clone(), &self.metrics, &flagged);
        let rows = score_rows(&board, BUDGET);
        let mut kept: HashMap<usize, usize> = HashMap::new();
        kept.extend(rows.iter().enumerate().map(|(at, row)| (*row, at)));
        let all = (0..table.provider.groups()).map(|group| table.provider.group_rows(group)).sum::<usize>();
        let entries = if all > MOST_ROWS { usize::MAX } else { all.div_ceil(pooled.metrics.words.len().max(1)) };
        let lines = |metrics| lines(table, &pooled, &board, &kept, &flagged, metrics).map(Some);
        Ok(score_block(&board, &pipeline.version.manifest.pipeline, short, &rows, entries, BUDGET, lines)?)
    }
}

/// The column `name` of a batch; a column of another type is treated as damage.
pub(super) fn numbers<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a arrow_array::Float64Array, Fault> {
    let found = batch.column_by_name(name).and_then(|a| a.as_primitive_opt::<Float64Type>());
    found.ok_or_else(|| Fault::machine(format!("the scores have no numeric column `{name}`")))
}

/// The whole numbers of a column; a column of another type is treated as damage.
pub(super) fn counts<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a arrow_array::Int64Array, Fault> {
    let found = batch.column_by_name(name).and_then(|a| a.as_primitive_opt::<Int64Type>());
    found.ok_or_else(|| Fault::machine(format!("the scores have no column `{name}` of whole numbers")))
}

/// The Boolean values of a column; a column of another type is treated as damage.
pub(super) fn truths<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a arrow_array::BooleanArray, Fault> {
    let found = batch.column_by_name(name).and_then(|a| a.as_boolean_opt());
    found.ok_or_else(|| Fault::machine(format!("the scores have no Boolean column `{name}`")))
}

/// Positions of the values of a column in `words`.
pub(super) fn texts(batch: &RecordBatch, name: &str, words: &mut Words) -> Result<Vec<u32>, Fault> {
    let found = batch.column_by_name(name).map(|array| positions(array, words));
    found.ok_or_else(|| Fault::machine(format!("the scores have no column `{name}`")))
}

impl PooledScores {
    /// The pooled scores of the table of scores `stage`.
    pub fn read(table: &ViewTable, axes: &[String], stage: &str) -> Result<PooledScores, Fault> {
        const COLUMNS: [&str; 8] =
            ["stage", "metric", "value", "n", "lines", "in_sample", "value_in_sample", "lines_in_sample"];
        let names: Vec<&str> = axes.iter().map(String::as_str).chain(COLUMNS).collect();
        let mut found = PooledScores::default();
        found.axes.resize_with(axes.len(), Words::default);
        let mut stages = Words::default();
        let wanted = stages.position(stage);
        for group in 0..table.provider.groups() {
            let batch = table.provider.read_group(group, &names)?;
            let own = texts(&batch, "stage", &mut stages)?;
            let metric = texts(&batch, "metric", &mut found.metrics)?;
            let at: Vec<Vec<u32>> = axes
                .iter()
                .zip(&mut found.axes)
                .map(|(axis, words)| texts(&batch, axis, words))
                .collect::<Result<_, _>>()?;
            let (value, value_in_sample) = (numbers(&batch, "value")?, numbers(&batch, "value_in_sample")?);
            let n = counts(&batch, "n")?;
            let (lines, lines_in_sample) = (counts(&batch, "lines")?, counts(&batch, "lines_in_sample")?);
            let in_sample = truths(&batch, "in_sample")?;
            let number = |a: &arrow_array::Float64Array, row: usize| a.is_valid(row).then(|| a.value(row));
            let count = |a: &arrow_array::Int64Array, row: usize| usize::try_from(a.value(row)).unwrap_or(0);
            for row in (0..batch.num_rows()).filter(|row| own[*row] == wanted) {
                let point = found.point(at.iter().map(|axis| axis[row]));
                found.cells.push(PooledCell {
                    point,
                    metric: metric[row] as usize,
                    value: number(value, row),
                    n: count(n, row),
                    lines: count(lines, row),
                    in_sample: in_sample.value(row),
                    value_in_sample: number(value_in_sample, row),
                    lines_in_sample: count(lines_in_sample, row),
                });
            }
        }
        Ok(found)
    }

    /// The number of a point, which is added if it is new.
    fn point(&mut self, key: impl Iterator<Item = u32>) -> usize {
        let key: Vec<u32> = key.collect();
        if self.points.last() == Some(&key) {
            return self.points.len() - 1;
        }
        let next = self.points.len();
        let at = *self.known.entry(key.clone()).or_insert(next);
        if at == next {
            self.points.push(key);
        }
        at
    }

    /// The number of the point with these axis values.
    pub fn find(&self, words: &[String]) -> Option<usize> {
        let key: Vec<u32> = self.axes.iter().zip(words).map(|(axis, word)| axis.find(word)).collect::<Option<_>>()?;
        self.known.get(&key).copied()
    }

    /// The table of scores. Metrics that are not among `declared` are omitted.
    fn board(&self, axes: Vec<String>, declared: &[Metric], flagged: &FlaggedLines) -> ScoreBoard {
        let has_value = |name: &str| {
            let at = self.metrics.find(name).map(|at| at as usize);
            self.cells.iter().any(|cell| Some(cell.metric) == at && cell.value.is_some())
        };
        let with_value: Vec<Metric> = declared.iter().copied().filter(|m| has_value(m.name)).collect();
        let (mut metrics, others): (Vec<Metric>, Vec<Metric>) =
            with_value.into_iter().partition(|m| m.shown.column.is_some());
        metrics.sort_by_key(|m| m.shown.column);
        let place = |of: &[Metric]| -> Vec<Option<usize>> {
            self.metrics.words.iter().map(|word| of.iter().position(|m| m.name == word)).collect()
        };
        let (place, other_place) = (place(&metrics), place(&others));
        let points = self.points.len();
        let mut rows: Vec<(Vec<String>, Vec<Option<f64>>)> =
            self.points.iter().map(|key| self.row(key, metrics.len())).collect();
        let seen = InSampleScores {
            metrics: vec![false; metrics.len()],
            values: vec![None; metrics.len()],
            ..InSampleScores::default()
        };
        let mut in_sample = vec![seen; points];
        let more = |metric: &Metric| MoreScores {
            metric: *metric,
            values: vec![None; points],
            in_sample: vec![false; points],
        };
        let mut more: Vec<MoreScores> = others.iter().map(more).collect();
        let mut most = 0;
        for cell in &self.cells {
            let held_out = if cell.in_sample { 0 } else { cell.lines };
            most = most.max(held_out + cell.lines_in_sample);
            let own = &mut in_sample[cell.point];
            own.lines = own.lines.max(cell.lines_in_sample);
            own.held_out = own.held_out.max(held_out);
            if let Some(at) = place[cell.metric] {
                rows[cell.point].1[at] = cell.value;
                own.metrics[at] = cell.in_sample;
                own.values[at] = cell.value_in_sample;
            }
            if let Some(at) = other_place[cell.metric] {
                more[at].values[cell.point] = cell.value;
                more[at].in_sample[cell.point] = cell.in_sample;
            }
        }
        if in_sample.iter().all(|row| row.lines == 0) {
            in_sample.clear();
        }
        let (mut marks, mut wrong) = (vec![0; points], vec![false; points]);
        for ((point, ..), is_wrong) in flagged {
            marks[*point] += 1;
            wrong[*point] |= is_wrong;
        }
        let cautious = (0..points).filter(|r| marks[*r] > 0 && !wrong[*r]).collect();
        let scores = Scores { axes, metrics, rows, lines: most, marks, cautious, in_sample };
        ScoreBoard { table: 0, scores, instances: vec![], more }
    }

    fn row(&self, key: &[u32], metrics: usize) -> (Vec<String>, Vec<Option<f64>>) {
        let words = self.axes.iter().zip(key).map(|(axis, at)| axis.words[*at as usize].clone());
        (words.collect(), vec![None; metrics])
    }
}

/// The flagged lines of the points, from the table of warnings.
pub(super) fn flagged(
    pipeline: &PublishedPipeline,
    pooled: &PooledScores,
    axes: &[String],
    stage: &str,
) -> Result<FlaggedLines, ViewFault> {
    let mut found = FlaggedLines::new();
    let Ok(table) = pipeline.table("warnings") else { return Ok(found) };
    let names: Vec<&str> = axes.iter().map(String::as_str).chain(["stage", "kind", "flight", "line"]).collect();
    if names.iter().any(|name| table.provider.columns().field_with_name(name).is_err()) {
        return Ok(found);
    }
    for group in 0..table.provider.groups() {
        let batch = table.provider.read_group(group, &names)?;
        let cell = |row: usize, name: &str| {
            batch.column_by_name(name).map(|array| super::table::word(array, row)).unwrap_or_default()
        };
        let spoils = |row: usize| {
            let kind = cell(row, "kind");
            WarningKind::ALL.into_iter().find(|k| k.as_str() == kind).filter(|k| k.spoils())
        };
        let has_line = |row: usize| batch.column_by_name("line").is_some_and(|a| a.is_valid(row));
        for row in (0..batch.num_rows()).filter(|row| cell(*row, "stage") == stage && has_line(*row)) {
            let words: Vec<String> = axes.iter().map(|axis| cell(row, axis)).collect();
            if let (Some(kind), Some(point)) = (spoils(row), pooled.find(&words)) {
                *found.entry((point, cell(row, "flight"), cell(row, "line"))).or_default() |= !kind.is_cautious();
            }
        }
    }
    Ok(found)
}

/// The scores of single lines: the metrics `metrics` at the points in `kept`.
fn lines(
    table: &ViewTable,
    pooled: &PooledScores,
    board: &ScoreBoard,
    kept: &HashMap<usize, usize>,
    flagged: &FlaggedLines,
    metrics: Vec<usize>,
) -> Result<LineScores, Fault> {
    let seen = table.provider.columns().field_with_name(IN_SAMPLE).is_ok().then_some(IN_SAMPLE);
    let names: Vec<&str> =
        table.axes.iter().map(String::as_str).chain(["flight", "line", "metric", "value"]).chain(seen).collect();
    let mut found = LineScores { values: vec![vec![]; metrics.len()], metrics, ..LineScores::default() };
    let wanted: HashMap<&str, usize> =
        found.metrics.iter().enumerate().map(|(at, m)| (board.scores.metrics[*m].name, at)).collect();
    let mut entries: HashMap<(usize, usize), Option<usize>> = HashMap::new();
    let mut known: HashMap<(String, String), usize> = HashMap::new();
    for group in 0..table.provider.groups() {
        let batch = table.provider.read_group(group, &names)?;
        let (mut flights, mut lines, mut words) = (Words::default(), Words::default(), Words::default());
        let (flight, line) = (texts(&batch, "flight", &mut flights)?, texts(&batch, "line", &mut lines)?);
        let metric = texts(&batch, "metric", &mut words)?;
        let mut axes: Vec<Words> = vec![];
        axes.resize_with(table.axes.len(), Words::default);
        let at: Vec<Vec<u32>> =
            table.axes.iter().zip(&mut axes).map(|(axis, own)| texts(&batch, axis, own)).collect::<Result<_, _>>()?;
        let value = numbers(&batch, "value")?;
        let in_sample = seen.map(|name| truths(&batch, name)).transpose()?;
        let mut last: Option<(usize, Option<usize>)> = None;
        for row in 0..batch.num_rows() {
            let same = |other: usize| {
                flight[row] == flight[other] && line[row] == line[other] && at.iter().all(|a| a[row] == a[other])
            };
            let entry = match last {
                Some((other, entry)) if same(other) => entry,
                _ => {
                    let point: Vec<String> =
                        axes.iter().zip(&at).map(|(own, at)| own.words[at[row] as usize].clone()).collect();
                    let name = (flights.words[flight[row] as usize].clone(), lines.words[line[row] as usize].clone());
                    let point = pooled.find(&point);
                    point.and_then(|point| Some((point, *kept.get(&point)?))).and_then(|(point, shown)| {
                        let next = known.len();
                        let at = *known.entry(name.clone()).or_insert(next);
                        if at == next {
                            found.names.push(name.clone());
                        }
                        *entries.entry((shown, at)).or_insert_with(|| {
                            let entry = found.points.len();
                            found.points.push(shown);
                            found.lines.push(at);
                            found.values.iter_mut().for_each(|column| column.push(None));
                            if in_sample.is_some_and(|marks| marks.is_valid(row) && marks.value(row)) {
                                found.in_sample.push(entry);
                            }
                            if flagged.contains_key(&(point, name.0, name.1)) {
                                found.flagged.push(entry);
                            }
                            Some(entry)
                        })
                    })
                }
            };
            last = Some((row, entry));
            let column = wanted.get(words.words[metric[row] as usize].as_str());
            if let (Some(entry), Some(column)) = (entry, column) {
                found.values[*column][entry] = value.is_valid(row).then(|| value.value(row)).filter(|v| v.is_finite());
            }
        }
    }
    Ok(found)
}
