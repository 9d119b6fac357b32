//! Survey stages: the lines of a unit are gathered, and the result is then concluded from them.

use std::{
    collections::HashMap,
    ops::ControlFlow,
    sync::{Mutex, atomic::Ordering},
    time::{Duration, Instant},
};

use plan::{LineId, PlanUnit};
use rayon::prelude::*;
use schemas::{
    AnyLinePart, AnySurveyPoint, CheckpointMonitor, Fault, InputKind, LineInput, StageOutput, keys::HashKey,
};
use store::Remarks;

use super::{
    super::{Event, held::LineColumnCache, interrupt::INTERRUPTED},
    LineUsability, UnitResult, UnitWorker, guarded,
};

/// Minimum interval between progress reports of a unit.
const REPORT_EVERY: Duration = Duration::from_secs(1);

/// Result of a survey stage for a point: the faults of skipped lines, and the table that the stage made.
type SurveyUnitResult = (Vec<Fault>, Result<StageOutput, Fault>);

/// Inputs of a survey stage for its units, one per point.
struct SurveyUnitInputs<'a> {
    worker: &'a UnitWorker<'a>,
    units: &'a [PlanUnit],
    /// Time of the last progress report.
    last_report: Mutex<Option<Instant>>,
}

impl SurveyUnitInputs<'_> {
    /// Whether the next progress report is due.
    fn is_due(&self) -> bool {
        let Ok(mut last_report) = self.last_report.lock() else { return false };
        let due = last_report.is_none_or(|last| last.elapsed() >= REPORT_EVERY);
        if due {
            *last_report = Some(Instant::now());
        }
        due
    }

    fn key(&self, point: usize) -> Option<HashKey> {
        self.units.get(point).and_then(|unit| self.worker.graph.key(*unit).ok())
    }
}

impl CheckpointMonitor for SurveyUnitInputs<'_> {
    fn kept(&self, point: usize) -> Option<Vec<u8>> {
        self.worker.store.checkpoint(self.key(point)?)
    }

    fn keep(&self, point: usize, state: &[u8]) {
        // If a checkpoint is lost, an interrupted unit only has to start again. A disk fault is reported when results
        // are written.
        let _ = self.key(point).map(|key| self.worker.store.set_checkpoint(key, state));
    }

    fn report_progress(&self, point: usize, progress: &str) -> ControlFlow<()> {
        if let Some(unit) = self.units.get(point).filter(|_| self.is_due()) {
            let table = &self.worker.graph.plan.tables[unit.table].name;
            let point = &self.worker.instance(*unit).point();
            self.worker.listener.on_event(&Event::Working { table, point, progress });
        }
        if INTERRUPTED.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl UnitWorker<'_> {
    /// Groups of points that use the same lines of the same tables.
    pub(super) fn by_lines_seen(&self, units: &[PlanUnit]) -> Vec<Vec<PlanUnit>> {
        let mut groups: Vec<Vec<PlanUnit>> = vec![];
        let mut at: HashMap<String, usize> = HashMap::new();
        for unit in units {
            let group = *at.entry(self.seen(*unit)).or_insert_with(|| {
                groups.push(vec![]);
                groups.len() - 1
            });
            groups[group].push(*unit);
        }
        groups
    }

    /// Lines, tables and rows that a survey stage uses.
    pub fn seen(&self, unit: PlanUnit) -> String {
        let it = self.instance(unit);
        let rows = it.predicate.as_ref().map(|p| p.canonical.clone());
        format!("{:?} {rows:?} {:?}", self.graph.line_inputs(&it), self.graph.line_set(unit.table, unit.instance))
    }

    /// An unusable line is skipped and reported; the other lines are gathered.
    pub(super) fn survey(&self, units: &[PlanUnit], usable: &LineUsability) -> Vec<UnitResult> {
        let all = |fault: Fault| units.iter().map(|u| UnitResult::failed(*u, fault.clone())).collect();
        let stages = match units.iter().map(|u| self.instance(*u).stage()).collect::<Result<Vec<_>, Fault>>() {
            Ok(stages) => stages,
            Err(fault) => return all(fault),
        };
        let whole = match units.iter().map(|u| self.whole_inputs(&self.instance(*u))).collect::<Result<Vec<_>, Fault>>()
        {
            Ok(whole) => whole,
            Err(fault) => return all(fault),
        };
        let points = stages.iter().zip(&whole);
        let points: Result<Vec<AnySurveyPoint>, Fault> =
            points.map(|(stage, inputs)| Ok(AnySurveyPoint { stage: stage.of_surveys()?, inputs })).collect();
        let gather = points.and_then(|points| match points.first() {
            Some(first) => first.stage.gather(&points),
            None => Err(Fault::bug("a survey without points")),
        });
        let gather = match gather {
            Ok(gather) => gather,
            Err(fault) => return all(fault),
        };
        let first = units[0];
        let lines: Vec<LineId> =
            self.graph.lines_of(first.table, first.instance).iter().copied().filter(|l| usable(*l, first)).collect();
        let mapped: Vec<Result<AnyLinePart, Fault>> = lines
            .par_iter()
            .with_max_len(1)
            .map(|line| {
                let mut held = LineColumnCache::new(self);
                let input = self.gathered(units, *line, &mut held)?;
                guarded(|| gather.map(&input)).map_err(|f| f.in_line(&input.flight, &input.line))
            })
            .collect();
        if let Some(fault) = mapped.iter().filter_map(|m| m.as_ref().err()).find(|f| !f.owner.is_lasting()) {
            return all(fault.clone());
        }
        let mut left_out: Vec<Vec<Fault>> = units.iter().map(|_| vec![]).collect();
        let mut parts = vec![];
        for (line, part) in lines.iter().zip(mapped) {
            let (flight, name) = &self.graph.lines[*line];
            match part {
                Ok(part) => {
                    for (point, fault) in gather.refused(&part) {
                        left_out[point].push(fault.in_line(flight, name));
                    }
                    parts.push(part);
                }
                Err(fault) => {
                    let fault = fault.in_line(flight, name);
                    left_out.iter_mut().for_each(|faults| faults.push(fault.clone()));
                }
            }
        }
        let mut tables = match guarded(|| {
            gather.finish(parts, &SurveyUnitInputs { worker: self, units, last_report: Mutex::default() })
        }) {
            Ok(tables) => tables,
            Err(fault) => return all(fault),
        };
        for (table, left_out) in tables.iter_mut().zip(&left_out).filter(|(_, l)| l.len() == lines.len()) {
            *table = Err(nothing_left(left_out));
        }
        let made = |(unit, (left_out, table)): (&PlanUnit, SurveyUnitResult)| {
            let (rows, warnings) = match table {
                Ok(StageOutput { columns, warnings }) => (self.batch(&self.instance(*unit), columns), warnings),
                Err(fault) => (Err(fault), vec![]),
            };
            UnitResult { unit: *unit, rows, remarks: Remarks { left_out, warnings } }
        };
        let made = units.iter().zip(left_out.into_iter().zip(tables)).map(made);
        // A unit that an interrupt stopped has no outcome yet.
        let stopped = |m: &UnitResult| {
            INTERRUPTED.load(Ordering::Relaxed) && m.rows.as_ref().is_err_and(|f| !f.owner.is_lasting())
        };
        made.filter(|m| !stopped(m)).collect()
    }

    /// Gathers one line for all points of a survey task, with the columns of all points.
    fn gathered(&self, units: &[PlanUnit], line: LineId, held: &mut LineColumnCache) -> Result<LineInput, Fault> {
        let first = units[0];
        let mut input = self.line_in(first, line, held)?;
        for (i, r) in self.graph.line_inputs(&self.instance(first)) {
            let mut columns: Vec<String> = vec![];
            for unit in units {
                for c in self.instance(*unit).variant.yields.reads.get(i).into_iter().flatten() {
                    if !columns.contains(c) {
                        columns.push(c.clone());
                    }
                }
            }
            let of_scores = self.instance(first).kinds().get(i) == Some(&InputKind::Scores);
            input.inputs[i] =
                if of_scores { self.scores(r, line, &columns, held)? } else { held.batch(r, line, &columns)? };
        }
        Ok(input)
    }
}

/// The fault of a survey stage without usable lines.
fn nothing_left(faults: &[Fault]) -> Fault {
    let Some(first) = faults.first() else { return Fault::data("none of the selected lines could be computed") };
    Fault::data(format!(
        "none of the {} selected lines can be used; the reason for the first line: {first}",
        faults.len()
    ))
}
