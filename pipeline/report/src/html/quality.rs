//! The quality of the data: clocks, figures by column with flags, and a picture over time.

use std::collections::{BTreeMap, BTreeSet};

use intake::checks::{
    FigureContext, QualityFigure, QualityMeasure, gaps, needs_a_look, stretches,
    table::{COLUMNS, LineMeasure, figures},
};
use maud::{Markup, html};
use plan::{LineId, TableRef};
use results::text::number;
use schemas::{Fault, flight};
use store::published;

use super::{
    source::ReportSource,
    timeline::{Timeline, TimelineLane},
};

/// Maximum number of rows of a table.
const ROWS: usize = 400;
/// Maximum number of flights with a picture, and of columns in each picture.
const PICTURES: usize = 4;
const LANES: usize = 14;

/// Quality measures of one column of a flight in a table.
#[derive(Clone, Debug)]
struct QualityColumn {
    source: usize,
    flight: String,
    column: String,
    /// Worst value over the lines, with the number of affected samples on all lines.
    figures: BTreeMap<QualityFigure, QualityMeasure>,
    /// The flagged values.
    marks: BTreeSet<QualityFigure>,
}

impl QualityColumn {
    fn figure(&self, figure: QualityFigure) -> Option<&QualityMeasure> {
        self.figures.get(&figure)
    }

    fn is_clock(&self) -> bool {
        self.column == "tt"
    }
}

/// The section; `None` if no data were read.
///
/// # Errors
/// Fails if the store is damaged.
pub fn section(source: &ReportSource) -> Result<Option<Markup>, Fault> {
    let (columns, unreadable) = columns(source);
    if columns.is_empty() && unreadable == 0 {
        return Ok(None);
    }
    let (clocks, columns): (Vec<&QualityColumn>, Vec<&QualityColumn>) = columns.iter().partition(|c| c.is_clock());
    let marked = columns.iter().chain(&clocks).filter(|c| !c.marks.is_empty()).count();
    let several = QualityKeyColumns::from_columns(&clocks, &columns);
    let pictures = pictures(source, &clocks, &columns)?;
    Ok(Some(html! {
        section id="quality" {
            h2 { "Quality of the data" }
            p.lead { "The data as read, before any stage. "
                @if marked == 0 { "No figure is flagged." }
                @else {
                    (marked) " of " (clocks.len() + columns.len()) " columns have a flagged figure, shown with a "
                    strong { "!" } ". The worst columns are first."
                }
            }
            @if unreadable > 0 {
                p.warning {
                    "The quality measures of " (unreadable) (if unreadable == 1 { " file" } else { " files" })
                    " in the store are damaged and are not shown. The next run recomputes them."
                }
            }
            @for picture in pictures { (picture) }
            (clock_table(source, &several, &clocks))
            (column_table(source, &several, &columns))
            (glossary())
        }
    }))
}

/// Key columns that the quality table needs, because their values differ.
struct QualityKeyColumns {
    tables: bool,
    flights: bool,
}

impl QualityKeyColumns {
    fn from_columns(clocks: &[&QualityColumn], columns: &[&QualityColumn]) -> QualityKeyColumns {
        let all = || clocks.iter().chain(columns);
        let tables: BTreeSet<usize> = all().map(|c| c.source).collect();
        let flights: BTreeSet<&str> = all().map(|c| c.flight.as_str()).collect();
        QualityKeyColumns { tables: tables.len() > 1, flights: flights.len() > 1 }
    }
}

/// All columns with a quality measure, the worst first, and the number of files with unreadable quality measures.
fn columns(source: &ReportSource) -> (Vec<QualityColumn>, usize) {
    let mut unreadable = 0;
    let mut found: BTreeMap<(usize, String, String), BTreeMap<QualityFigure, QualityMeasure>> = BTreeMap::new();
    for (table, folders) in source.graph.quality.iter().enumerate() {
        for folder in folders {
            let Ok(rows) = published(folder, &COLUMNS) else {
                unreadable += 1;
                continue;
            };
            let rows = rows.map(|rows| figures(&rows)).unwrap_or_default();
            for LineMeasure { flight, measure, .. } in rows {
                let of = found.entry((table, flight, measure.column.clone())).or_default();
                match of.get_mut(&measure.check) {
                    Some(known) => pool(known, &measure),
                    None => {
                        of.insert(measure.check, measure);
                    }
                }
            }
        }
    }
    let mut samples: BTreeMap<(usize, &str), u64> = BTreeMap::new();
    for (table, records) in source.graph.records.iter().enumerate() {
        for record in records.values() {
            *samples.entry((table, record.flight.as_str())).or_default() += record.rows as u64;
        }
    }
    let mut rates: BTreeMap<(usize, String), f64> = BTreeMap::new();
    let mut quietest: BTreeMap<(usize, String), f64> = BTreeMap::new();
    for ((table, flight, column), figures) in &found {
        let key = (*table, flight.clone());
        if let Some(rate) = figures.get(&QualityFigure::Rate) {
            rates.insert(key.clone(), rate.value);
        }
        if let Some(noise) = figures.get(&QualityFigure::Noise).filter(|_| flight::is_scalar_reading(column)) {
            let least = quietest.entry(key).or_insert(f64::INFINITY);
            *least = least.min(noise.value);
        }
    }
    let one =
        |((source, flight, column), figures): ((usize, String, String), BTreeMap<QualityFigure, QualityMeasure>)| {
            let key = (source, flight.clone());
            let around = FigureContext {
                samples: samples.get(&(source, flight.as_str())).copied().unwrap_or(0),
                rate_hz: rates.get(&key).copied().unwrap_or(f64::NAN),
                quietest_nt: quietest.get(&key).copied().unwrap_or(f64::NAN),
                noise: figures.get(&QualityFigure::Noise).map_or(f64::NAN, |m| m.value),
            };
            let marks = figures.values().filter(|m| needs_a_look(m, &around)).map(|m| m.check).collect();
            QualityColumn { source, flight, column, figures, marks }
        };
    let mut all: Vec<QualityColumn> = found.into_iter().map(one).collect();
    let lost = |c: &QualityColumn| c.figure(QualityFigure::Dropouts).map_or(0, |m| m.count);
    all.sort_by(|a, b| {
        let worse = b.marks.len().cmp(&a.marks.len()).then(lost(b).cmp(&lost(a)));
        worse.then_with(|| (a.source, &a.flight, &a.column).cmp(&(b.source, &b.flight, &b.column)))
    });
    (all, unreadable)
}

/// Combines two lines: the worse value, and the sum of the samples.
fn pool(known: &mut QualityMeasure, other: &QualityMeasure) {
    known.count += other.count;
    let sums = match known.check {
        QualityFigure::Gaps => true,
        QualityFigure::Rate
        | QualityFigure::Jitter
        | QualityFigure::LongestGap
        | QualityFigure::RepeatedTime
        | QualityFigure::BackwardTime
        | QualityFigure::Midnight
        | QualityFigure::Dropouts
        | QualityFigure::Stuck
        | QualityFigure::Saturation
        | QualityFigure::Quantisation
        | QualityFigure::Noise
        | QualityFigure::Spikes
        | QualityFigure::Preferred
        | QualityFigure::DeadZone
        | QualityFigure::PolarDeadZone
        | QualityFigure::EquatorialDeadZone
        | QualityFigure::Lag
        | QualityFigure::Found(_) => false,
    };
    if sums {
        known.value += other.value;
    } else if other.value.abs() > known.value.abs() || !known.value.is_finite() {
        (known.value, known.first_tt) = (other.value, other.first_tt);
    }
}

/// A value in a table, flagged if it exceeds a limit.
fn cell(
    column: &QualityColumn,
    figure: QualityFigure,
    text: &dyn Fn(&QualityMeasure) -> String,
    sorted: fn(&QualityMeasure) -> f64,
) -> Markup {
    let Some(measure) = column.figure(figure) else { return html! { td.n { "-" } } };
    let bad = column.marks.contains(&figure);
    html! { td.n.bad[bad] data-v=(sorted(measure)) { @if bad { "! " } (text(measure)) } }
}

fn keys(source: &ReportSource, several: &QualityKeyColumns, column: &QualityColumn) -> Markup {
    let table = source.graph.plan.flights.get(column.source).map_or("", |f| f.name.as_str());
    html! {
        @if several.tables { td { (table) } }
        @if several.flights { td { (column.flight) } }
    }
}

fn key_heads(several: &QualityKeyColumns) -> Markup {
    html! {
        @if several.tables { th scope="col" { button { "table" } } }
        @if several.flights { th scope="col" { button { "flight" } } }
    }
}

fn value(measure: &QualityMeasure) -> String {
    number(Some(measure.value).filter(|x| x.is_finite()))
}

/// One row for each clock.
fn clock_table(source: &ReportSource, several: &QualityKeyColumns, clocks: &[&QualityColumn]) -> Markup {
    let text = |m: &QualityMeasure| value(m);
    let times = |m: &QualityMeasure| m.count.to_string();
    let count: fn(&QualityMeasure) -> f64 = |m| m.count as f64;
    let size: fn(&QualityMeasure) -> f64 = |m| m.value;
    html! {
        h3.lines { "Clocks" }
        div.scroll.wide { table.sortable.lines {
            thead { tr { (key_heads(several))
                @for name in [
                    "rate [Hz]", "jitter [s]", "gaps", "missing [s]", "longest gap [s]", "repeated times", "times back",
                    "midnights",
                ] {
                    th.n scope="col" { button { (name) } }
                }
            } }
            tbody { @for c in clocks.iter().take(ROWS) { tr { (keys(source, several, c))
                (cell(c, QualityFigure::Rate, &text, size))
                (cell(c, QualityFigure::Jitter, &text, size))
                (cell(c, QualityFigure::Gaps, &times, count))
                (cell(c, QualityFigure::Gaps, &text, size))
                (cell(c, QualityFigure::LongestGap, &text, size))
                (cell(c, QualityFigure::RepeatedTime, &times, count))
                (cell(c, QualityFigure::BackwardTime, &times, count))
                (cell(c, QualityFigure::Midnight, &times, count))
            } } }
        } }
        @if clocks.len() > ROWS { p.note { "and " (clocks.len() - ROWS) " more" } }
    }
}

/// One row for each column: the flagged columns first, then the other columns, folded.
fn column_table(source: &ReportSource, several: &QualityKeyColumns, columns: &[&QualityColumn]) -> Markup {
    let (marked, others): (Vec<&QualityColumn>, Vec<&QualityColumn>) =
        columns.iter().partition(|c| !c.marks.is_empty());
    html! {
        @if !marked.is_empty() {
            h3.lines { "Columns" }
            (rows(source, several, &marked))
        }
        @if !others.is_empty() {
            details {
                summary {
                    (others.len()) @if !marked.is_empty() { " more" }
                    (if others.len() == 1 { " column" } else { " columns" }) ", not flagged"
                }
                (rows(source, several, &others))
            }
        }
    }
}

fn rows(source: &ReportSource, several: &QualityKeyColumns, columns: &[&QualityColumn]) -> Markup {
    let count: fn(&QualityMeasure) -> f64 = |m| m.count as f64;
    let size: fn(&QualityMeasure) -> f64 = |m| m.value;
    let unit = |m: &QualityMeasure| {
        if m.unit.is_empty() || m.unit == "1" { value(m) } else { format!("{} {}", value(m), m.unit) }
    };
    let lasting = |m: &QualityMeasure| format!("{}, {} s", m.count, value(m));
    let many = |m: &QualityMeasure| format!("{}, {}", m.count, unit(m));
    html! {
        div.scroll.wide { table.sortable.lines {
            thead { tr { (key_heads(several)) th scope="col" { button { "column" } }
                @for name in ["dropouts, longest", "spikes, largest", "stuck, longest", "saturated, at", "step",
                    "preferred values, spacing", "dead zone", "lag", "noise"] {
                    th.n scope="col" { button { (name) } }
                }
                th scope="col" { button { "findings" } }
            } }
            tbody { @for c in columns.iter().take(ROWS) { tr { (keys(source, several, c)) td { (c.column) }
                (cell(c, QualityFigure::Dropouts, &lasting, count))
                (cell(c, QualityFigure::Spikes, &many, count))
                (cell(c, QualityFigure::Stuck, &lasting, size))
                (cell(c, QualityFigure::Saturation, &many, count))
                (cell(c, QualityFigure::Quantisation, &unit, size))
                (cell(c, QualityFigure::Preferred, &many, count))
                (cell(c, dead_zone(c), &many, count))
                (cell(c, QualityFigure::Lag, &unit, size))
                (cell(c, QualityFigure::Noise, &unit, size))
                (findings(c))
            } } }
        } }
        @if columns.len() > ROWS { p.note { "and " (columns.len() - ROWS) " more" } }
    }
}

/// The quality figure for a column's dead zone: for a zone of known shape, the figure of that shape, otherwise the dead
/// zone as reported by the sensor.
fn dead_zone(column: &QualityColumn) -> QualityFigure {
    let shapes = [QualityFigure::PolarDeadZone, QualityFigure::EquatorialDeadZone];
    shapes.into_iter().find(|figure| column.figure(*figure).is_some()).unwrap_or(QualityFigure::DeadZone)
}

/// Findings of the examination of a column.
fn findings(column: &QualityColumn) -> Markup {
    let found: Vec<&QualityMeasure> =
        column.figures.values().filter(|m| matches!(m.check, QualityFigure::Found(_))).collect();
    let bad = found.iter().any(|m| column.marks.contains(&m.check));
    let words: Vec<String> = found
        .iter()
        .map(|m| {
            let mark = if column.marks.contains(&m.check) { "! " } else { "" };
            format!("{mark}{} {}", m.count, m.check.as_str().replace('_', " "))
        })
        .collect();
    html! { td.bad[bad] { @if words.is_empty() { "-" } @else { (words.join(", ")) } } }
}

fn glossary() -> Markup {
    html! {
        details { summary { "Meaning of the columns, and limits for flags" }
            dl {
                dt { "jitter" } dd { "robust standard deviation of the time steps; flagged above a tenth of the \
                                      median step" }
                dt { "gaps" } dd { "number of time steps above 1.75 times the median step, and the total missing time; \
                                    flagged above 1 s, or if 1 % of the samples are missing" }
                dt { "repeated times, times back" } dd { "rows with the same time as the previous row, and rows with \
                                                          an earlier time; always flagged" }
                dt { "dropouts" } dd { "missing samples, and the longest time without a sample; flagged above 1 s or \
                                        1 % of the samples. Infinities and readings of exactly 0 nT are missing \
                                        samples" }
                dt { "spikes" } dd { "samples whose fourth difference exceeds 8 robust standard deviations of the \
                                      fourth differences around it; always flagged for sensors" }
                dt { "stuck" } dd { "number of samples in the longest stretch with a constant value, if this stretch \
                                     is far longer than usual for the column" }
                dt { "saturated" } dd { "number of samples at the minimum or maximum value, if that value is far more \
                    frequent than the neighbouring values" }
                dt { "step" } dd { "resolution: every difference between samples is a whole multiple of the step. For \
                                    magnetometers, the step is flagged above two standard deviations of the noise, or \
                                    if it masks the noise" }
                dt { "preferred values" } dd { "number of samples of a scalar magnetometer at evenly spaced, \
                    over-represented values, minus the number expected there without over-representation, and the \
                    spacing of these values; flagged above a tenth of the samples" }
                dt { "dead zone" } dd { "number of missing samples of a scalar magnetometer at which the field \
                                         direction lies in a cone or belt, and the half width of the cone or belt. \
                                         The first vector magnetometer gives the directions in the body frame. If the \
                                         sensor itself reports its dead zone: the number of samples in the dead zone, \
                                         and the longest stretch of such samples. Always flagged" }
                dt { "lag" } dd { "delay relative to the first magnetometer of the same kind, from cross-correlation, \
                    if the correlation is high enough; flagged above half a sample" }
                dt { "noise" } dd { "standard deviation of white noise, from fourth differences; for scalar \
                                     magnetometers, flagged above ten times the lowest noise of the flight" }
            }
        }
    }
}

/// A picture of each of the worst flights: missing, stuck and saturated samples and spikes over time.
fn pictures(
    source: &ReportSource,
    clocks: &[&QualityColumn],
    columns: &[&QualityColumn],
) -> Result<Vec<Markup>, Fault> {
    const SEEN: [QualityFigure; 4] =
        [QualityFigure::Dropouts, QualityFigure::Stuck, QualityFigure::Saturation, QualityFigure::Spikes];
    let gappy =
        |c: &QualityColumn| c.marks.contains(&QualityFigure::Gaps) || c.marks.contains(&QualityFigure::LongestGap);
    let seen = |c: &QualityColumn| SEEN.iter().any(|f| c.marks.contains(f));
    let mut by_flight: BTreeMap<&str, (Vec<&QualityColumn>, Vec<&QualityColumn>)> = BTreeMap::new();
    for column in columns.iter().filter(|c| seen(c)) {
        by_flight.entry(&column.flight).or_default().1.push(column);
    }
    for clock in clocks {
        let there = by_flight.contains_key(clock.flight.as_str());
        if there || gappy(clock) {
            by_flight.entry(&clock.flight).or_default().0.push(clock);
        }
    }
    let marks = |(clocks, columns): &(Vec<&QualityColumn>, Vec<&QualityColumn>)| {
        clocks.iter().chain(columns).map(|c| c.marks.len()).sum::<usize>()
    };
    let mut flights: Vec<_> = by_flight.into_iter().collect();
    // The sort is stable, so equal values stay in the order of names.
    flights.sort_by_key(|(_, all)| std::cmp::Reverse(marks(all)));
    let more = flights.len().saturating_sub(PICTURES);
    let mut drawn = vec![];
    for (flight, (clocks, columns)) in flights.into_iter().take(PICTURES) {
        let lines = lines_of(source, flight);
        let mut lanes = vec![];
        for clock in clocks {
            lanes.push(lane(source, clock, &lines, &[])?);
        }
        for column in columns.iter().take(LANES) {
            let figures: Vec<QualityFigure> = SEEN.into_iter().filter(|f| column.figures.contains_key(f)).collect();
            lanes.push(lane(source, column, &lines, &figures)?);
        }
        let hidden = columns.len().saturating_sub(LANES);
        drawn.extend(Timeline { flight, lanes, hidden }.draw());
    }
    if more > 0 {
        drawn.push(html! { p.note { (more) " more flagged flights are not drawn." } });
    }
    Ok(drawn)
}

/// The lines of a flight.
fn lines_of(source: &ReportSource, flight: &str) -> Vec<LineId> {
    let lines = source.graph.lines.iter().enumerate();
    lines.filter(|(_, (of, _))| of == flight).map(|(id, _)| id).collect()
}

/// Times at which a column has samples, and times at which the samples are faulty.
fn lane(
    source: &ReportSource,
    column: &QualityColumn,
    lines: &[LineId],
    figures: &[QualityFigure],
) -> Result<TimelineLane, Fault> {
    let plan = source.graph.plan;
    let table = plan.flights.get(column.source).map_or("", |f| f.name.as_str());
    let name = if column.is_clock() { "samples" } else { &column.column };
    let name = if plan.flights.len() > 1 { format!("{table}.{name}") } else { name.to_owned() };
    let mut lane = TimelineLane { name, ..TimelineLane::default() };
    let r = TableRef::Flights(column.source);
    for line in lines {
        let Some(tt) = source.floats(r, *line, "tt")? else { continue };
        lane.lines.extend(tt.first().zip(tt.last()).map(|(a, b)| (*a, *b)));
        lane.gaps.extend(gaps(&tt));
        if figures.is_empty() {
            continue;
        }
        // For a vector magnetometer, the components are checked instead.
        let Some(values) = source.floats(r, *line, &column.column)? else { continue };
        for figure in figures {
            lane.parts.extend(stretches(*figure, &values, &tt).into_iter().map(|(from, to)| (*figure, from, to)));
        }
    }
    Ok(lane)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn measure(check: QualityFigure, value: f64, count: u64) -> QualityMeasure {
        QualityMeasure { column: "mag_1_uc".into(), check, value, unit: "s".into(), count, first_tt: 5.0 }
    }

    #[test]
    fn unit_several_lines_show_the_worst_value_and_all_samples() {
        let mut known = measure(QualityFigure::Dropouts, 0.5, 10);
        pool(&mut known, &measure(QualityFigure::Dropouts, 2.0, 3));
        assert_eq!((known.value, known.count), (2.0, 13));
        let mut gaps = measure(QualityFigure::Gaps, 0.5, 10);
        pool(&mut gaps, &measure(QualityFigure::Gaps, 2.0, 3));
        assert_eq!((gaps.value, gaps.count), (2.5, 13));
        let mut low = measure(QualityFigure::Saturation, -400.0, 1);
        pool(&mut low, &measure(QualityFigure::Saturation, 100.0, 1));
        assert_eq!(low.value, -400.0);
    }

    #[test]
    fn unit_a_flagged_figure_is_labelled_and_sorts_by_its_number() {
        let mut column = QualityColumn {
            source: 0,
            flight: "1".into(),
            column: "mag_1_uc".into(),
            figures: [(QualityFigure::Dropouts, measure(QualityFigure::Dropouts, 2.0, 13))].into(),
            marks: [QualityFigure::Dropouts].into(),
        };
        let text =
            |c: &QualityColumn| cell(c, QualityFigure::Dropouts, &|m| value(m), |m| m.count as f64).into_string();
        assert_eq!(text(&column), "<td class=\"n bad\" data-v=\"13\">! 2.000</td>");
        column.marks.clear();
        assert_eq!(text(&column), "<td class=\"n\" data-v=\"13\">2.000</td>");
        assert_eq!(
            cell(&column, QualityFigure::Stuck, &|m| value(m), |m| m.value).into_string(),
            "<td class=\"n\">-</td>"
        );
    }
}
